# SPDX-License-Identifier: MIT
"""A specimen, the test done on it, and what was measured."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from ..elements.kinematics import net_reach
from ..errors import InputError
from ..net.network import Network
from ..units import format_si
from .curve import MeasuredCurve
from .formula import frame_angle, torque_from_frame, torque_from_loads
from .load_curve import KINDS, OFF_RECTANGLE, LoadCurve, frame_sides

LARGEST_FRAME_ANGLE = np.deg2rad(85.0)


@dataclass(frozen=True, eq=False)
class Specimen:
    """A network and the load curve measured of it.

    Attributes
    ----------
    network : Network
        Of any outline and size; a picture frame's fills the frame between its hinges.
    curve : MeasuredCurve
        Its displacement is the extension, or the growth of a picture frame's longer diagonal.
    kind : "bias-extension" or "picture-frame"
    upper : "grip" or "centre-line"
        See BiasExtension; for "centre-line" the displacement is that of half a specimen. Not looked
        at for a picture frame.
    bending : bool
        Whether yarns resist bending.
    weight : float
        Of this curve's mean square relative error among those of others.
    """

    network: Network
    curve: MeasuredCurve
    kind: str = KINDS[0]
    upper: str = "grip"
    bending: bool = True
    weight: float = 1.0

    @classmethod
    def measured(
        cls, network: Network, displacement: Any, force: Any, user: str, **test: Any
    ) -> Specimen:
        """Put together what a function called ``user`` was given; a curve may stand for points."""
        curve = displacement
        if not isinstance(curve, MeasuredCurve):
            if force is None:
                raise InputError(f"{user} needs the forces beside the displacements")
            curve = MeasuredCurve.from_points(displacement, force)
        return cls(network, curve, **test)

    def load_curve(self, options: dict | None) -> LoadCurve:
        """The network's load at the measured displacements. Collective; to be destroyed."""
        return LoadCurve(
            self.network, self.curve.displacement, self.kind, self.upper, self.bending, options
        )

    def _strip(self) -> tuple[float, float, float] | None:
        """Width and length of a whole strip cut at 45 degrees, m, and how many of these it is.

        None for anything else.
        """
        preform = self.network.preform
        size = preform.sides(OFF_RECTANGLE)
        if size is None or abs(np.cos(2.0 * preform.bias_angle)) > 0.05:
            return None
        halves = 2.0 if self.upper == "centre-line" else 1.0
        return size[0], halves * size[1], halves

    def check(self) -> None:
        """Raise InputError for a kind or weight that is none, and for data beyond the specimen.

        That is far past where the yarns of a strip lie along the pull, or a frame all but closed.
        """
        if not (np.isfinite(self.weight) and self.weight > 0.0):
            raise InputError(
                f"the weight of a curve must be positive and finite, got {self.weight:g}"
            )
        if self.kind not in KINDS:
            raise InputError(f"kind is '{self.kind}'; it can be '{KINDS[0]}' or '{KINDS[1]}'")
        last = float(np.max(self.curve.displacement))
        if self.kind == "picture-frame":
            a, b = frame_sides(self.network)
            if not frame_angle(last, (a, b)) < LARGEST_FRAME_ANGLE:
                raise InputError(
                    f"the data go to {format_si(last, 'm')}, but a frame of {format_si(a, 'm')} x "
                    f"{format_si(b, 'm')} is closed at {format_si(a + b - float(np.hypot(a, b)), 'm')}: "
                    "check the frame's size, the unit of the displacement and that it is that of "
                    "the corner along the diagonal"
                )
        elif strip := self._strip():
            width, length, halves = strip
            reach = net_reach(length - width) / halves
            if 0.0 < 1.5 * reach < last:
                raise InputError(
                    f"the data go to {format_si(last, 'm')}, but the yarns of a specimen of "
                    f"{format_si(width, 'm')} x {format_si(length / halves, 'm')} lie along the "
                    f"pull at {format_si(reach, 'm')}: check the specimen's size and the unit of "
                    "the displacement"
                )

    def closed_formula(self) -> tuple[np.ndarray, np.ndarray] | None:
        """Angles, rad, and torques, N/m, by the closed formula; None where it does not hold."""
        d, f = self.curve.displacement, self.curve.force
        if self.kind == "picture-frame":
            return torque_from_frame(d, f, frame_sides(self.network))
        strip = self._strip()
        if strip is None:
            return None
        width, length, halves = strip
        if length < 2.0 * width * (1.0 - 1e-6):
            return None
        angle, torque = torque_from_loads(halves * d, f, width, length)
        return (angle, torque) if len(angle) >= 2 and (torque > 0.0).any() else None
