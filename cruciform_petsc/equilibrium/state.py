# SPDX-License-Identifier: MIT
"""States as values: where the nodes are and what holds them, for whoever asks about them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np


@dataclass(frozen=True)
class Hold:
    """What is prescribed: places of nodes along axes, and directions of yarns that clamps hold.

    Attributes
    ----------
    nodes : int32 (m,)
        Local nodes of which something is prescribed.
    axes : float (m, dim, dim)
        Rows: the axes of their unknowns.
    fixed : bool (m, dim)
        Which components along these are prescribed. Stages of one test share this array.
    place : float (m, dim)
        Lab frame, m; only components that are fixed count.
    turn : float (c, dim, dim)
        Gradients of the motions of clamped nodes: they turn the directions of the yarns held there.
    rotations : mapping
        How tools are turned, (3, 3), by name; none by default.
    """

    nodes: np.ndarray
    axes: np.ndarray
    fixed: np.ndarray
    place: np.ndarray
    turn: np.ndarray
    rotations: Mapping[str, np.ndarray] = field(default_factory=dict)


@dataclass(frozen=True)
class State:
    """A state of a model; its arrays are not to be written to.

    Attributes
    ----------
    x : float (n_local, dim)
        Positions in the lab frame, m, ghosts filled.
    hold : Hold
    time : float
        What drives the stage: an extension, an angle, a strain, a load, a share of a stroke.
    factors : mapping
        Sizes of loads by the names of their items.
    memory : mapping
        By item: what it remembers of states accepted before (see Item.accepted).
    """

    x: np.ndarray
    hold: Hold
    time: float = 0.0
    factors: Mapping[str, float] = field(default_factory=dict)
    memory: Mapping[str, Mapping[str, np.ndarray]] = field(default_factory=dict)

    def moved(self, change: np.ndarray) -> State:
        """Positions changed by (n_local, dim), all else the same."""
        return replace(self, x=self.x + change)

    def at(self, hold: Hold, time: float, factors: Mapping[str, float]) -> State:
        """Under another hold: what is prescribed is put there, the rest stays where it is."""
        x = self.x.copy()
        gap = np.einsum("nij,nj->ni", hold.axes, hold.place - x[hold.nodes])
        gap[~hold.fixed] = 0.0
        x[hold.nodes] += np.einsum("nji,nj->ni", hold.axes, gap)
        return replace(self, x=x, hold=hold, time=time, factors=factors)


@dataclass
class Found:
    """A state of equilibrium and how it was found.

    Attributes
    ----------
    state : State
    energies : dict
        By the names of the items' modes, J.
    force : float (n_local, dim)
        Gradient of the energy, lab frame, N: what holds nodes that are not free.
    iterations : int
        Newton steps.
    residual, tolerance : float
        N.
    history : list of float
        Residual before each Newton step, and the last one.
    shifted : int
        Steps for which the tangent was indefinite, or did not lead downhill, and was mended.
    linear_iterations : int
    seconds : float
    rounds : int
        How often it was sought, as what items take as given was brought up to date.
    factorisations, evaluations : int
        Tangents solved with, those that were mended included; and how often forces were looked at.
    """

    state: State
    energies: dict[str, float]
    force: np.ndarray = field(repr=False)
    iterations: int
    residual: float
    tolerance: float
    history: list[float] = field(repr=False)
    shifted: int
    linear_iterations: int
    seconds: float
    rounds: int = 1
    factorisations: int = 0
    evaluations: int = 0
