# SPDX-License-Identifier: MIT
"""Dead loads: forces on nodes that keep their direction and size, whatever the cloth does."""

from __future__ import annotations

import numpy as np

from ..elements.level import FORCE, room
from .item import Item, Placed, Work


class DeadLoads(Item):
    """Energy - f F . (x - X), f the factor of the state for this item.

    Parameters
    ----------
    force : float (n_local, dim)
        F, lab frame, N; looked at on owned nodes.
    rest : float (n_local, dim)
        X.
    num_owned : int
    name : str
    """

    is_load = True
    modes = ("loads",)

    def __init__(self, force: np.ndarray, rest: np.ndarray, num_owned: int, name: str = "loads"):
        self.name = name
        at = np.flatnonzero(force[:num_owned].any(axis=1))
        self.nodes = at[:, None].astype(np.int32)
        self.force, self.rest = force[at], rest[at]

    def work(self, state: Placed, level: int, rows=slice(None), before=None) -> Work:
        """See Item.work."""
        pull = state.factors.get(self.name, 0.0) * self.force[rows]
        energy, force, stiffness = room(len(pull), 1, 1, pull.shape[1], level)
        moved = state.x[self.nodes[rows, 0]] - self.rest[rows]
        energy[:, 0] = -(pull * moved).sum(axis=1)
        if level >= FORCE:
            force[:, 0] = -pull
        stiffness[:] = 0.0
        return energy, force, stiffness
