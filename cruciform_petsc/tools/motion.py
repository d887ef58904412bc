# SPDX-License-Identifier: MIT
"""Where a tool is, and how it moves during a stage."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from scipy.spatial.transform import Rotation


@dataclass(frozen=True, eq=False)
class Pose:
    """Place and turn of a tool: x in the lab = place + turn @ x in the tool's frame.

    Attributes
    ----------
    place : float (3,), m
    turn : float (3, 3), a rotation
    """

    place: np.ndarray = field(default_factory=lambda: np.zeros(3))
    turn: np.ndarray = field(default_factory=lambda: np.eye(3))

    def to_tool(self, x: np.ndarray) -> np.ndarray:
        """Points (..., 3) of the lab, m, in the tool's frame."""
        return (x - self.place) @ self.turn

    def to_lab(self, x: np.ndarray) -> np.ndarray:
        """Points (..., 3) of the tool's frame, m, in the lab."""
        return self.place + x @ self.turn.T

    def vector_to_tool(self, v: np.ndarray) -> np.ndarray:
        """Vectors (..., 3) of the lab in the tool's frame."""
        return v @ self.turn

    def vector_to_lab(self, v: np.ndarray) -> np.ndarray:
        """Vectors (..., 3) of the tool's frame in the lab."""
        return v @ self.turn.T

    def matrix_to_lab(self, h: np.ndarray) -> np.ndarray:
        """Second derivatives (..., 3, 3) of the tool's frame in the lab."""
        return self.turn @ h @ self.turn.T

    def moved(self, way: np.ndarray) -> Pose:
        """The same pose `way` (3,) farther, m."""
        return Pose(self.place + way, self.turn)


@dataclass(frozen=True, eq=False)
class Motion:
    """Travel and rotation of a tool from its pose at the beginning of a stage.

    Attributes
    ----------
    start : Pose
    travel : float (3,), m, in the lab
    axis, through : float (3,)
        It turns about an axis, of any length, through a point [m]; both travel with it.
    angle : float, rad
    curve : float (n, 2), optional
        Share of the way, from 0 to 1, over share of the stage, from 0 to 1: linear between. The
        default: at one speed.
    """

    start: Pose
    travel: np.ndarray = field(default_factory=lambda: np.zeros(3))
    axis: np.ndarray = field(default_factory=lambda: np.array([0.0, 0.0, 1.0]))
    through: np.ndarray = field(default_factory=lambda: np.zeros(3))
    angle: float = 0.0
    curve: np.ndarray | None = None

    def share(self, s: float) -> float:
        """Share of the way that is behind at the share s of the stage."""
        if self.curve is None:
            return float(s)
        return float(np.interp(s, *np.transpose(self.curve)))

    def at(self, s: float) -> Pose:
        """Pose at the share s of the stage, from 0 to 1."""
        share = self.share(s)
        if self.angle == 0.0:
            return self.start.moved(share * np.asarray(self.travel))
        axis = np.asarray(self.axis, float) / np.linalg.norm(self.axis)
        turn = Rotation.from_rotvec(share * self.angle * axis).as_matrix()
        place = self.through + turn @ (self.start.place - self.through)
        return Pose(place + share * np.asarray(self.travel), turn @ self.start.turn)
