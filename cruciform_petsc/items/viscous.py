# SPDX-License-Identifier: MIT
"""A little viscosity, which chooses one way where cloth wrinkles."""

from __future__ import annotations

import numpy as np

from ..elements.level import FORCE, STIFFNESS, room
from .item import Item, Placed, Work


class Viscous(Item):
    """Energy c A |x - x_n|^2 / (2 h) from the last accepted state x_n, a time h ago.

    What it dissipates in a step is twice its energy (forming.md section 1).

    Parameters
    ----------
    nodes : int (m,)
        Local nodes that this rank owns.
    rest : float (m, dim)
        Where they start, m.
    weight : float (m,)
        c A, N s/m.
    """

    name = "viscosity"
    modes = ("viscous",)

    def __init__(self, nodes: np.ndarray, rest: np.ndarray, weight: np.ndarray):
        self.nodes = np.asarray(nodes, np.int32)[:, None]
        self.rest, self.weight = rest, weight

    def work(self, state: Placed, level: int, rows=slice(None), before=None) -> Work:
        """See Item.work."""
        memory = state.memory.get(self.name, {})
        place = memory.get("place", self.rest)[rows]
        nodes = self.nodes[rows]
        energy, force, stiffness = room(len(nodes), 1, 1, place.shape[1], level)
        rate = self._rate(state)[rows]
        moved = state.x[nodes[:, 0]] - place
        energy[:, 0] = 0.5 * rate * (moved**2).sum(axis=1)
        if level >= FORCE:
            force[:, 0] = rate[:, None] * moved
        if level >= STIFFNESS:
            stiffness[:, 0, :, 0] = rate[:, None, None] * np.eye(place.shape[1])
        return energy, force, stiffness

    def accepted(self, state: Placed) -> dict[str, np.ndarray]:
        """See Item.accepted; ``spent``: what each node has dissipated, J."""
        memory = state.memory.get(self.name, {})
        spent = memory["spent"] if memory else np.zeros(len(self.nodes))
        place, rate = state.x[self.nodes[:, 0]], self._rate(state)
        moved = place - memory.get("place", self.rest)
        spent = spent + rate * (moved**2).sum(axis=1)
        return {"place": place, "time": np.full(len(place), state.time), "spent": spent}

    def _rate(self, state: Placed) -> np.ndarray:
        """Of each node, c A/h, N/m, (m,); none at the time of the last step itself."""
        memory = state.memory.get(self.name, {})
        passed = state.time - (memory["time"] if memory else np.zeros(len(self.nodes)))
        return np.where(passed > 0.0, self.weight / np.where(passed > 0.0, passed, 1.0), 0.0)
