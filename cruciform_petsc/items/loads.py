# SPDX-License-Identifier: MIT
"""Loads: dead ones (an edge's, gravity, an imperfection's), and pressures that follow the cloth."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np

from ..elements.level import FORCE, STIFFNESS, room
from ..parallel import most
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
        Of the item, and of its energy.
    factor : float
        f of states that say nothing of this item.
    """

    is_load = True

    def __init__(self, force, rest, num_owned: int, name: str = "loads", factor: float = 0.0):
        self.name, self.modes, self.factor = name, (name,), factor
        at = np.flatnonzero(force[:num_owned].any(axis=1))
        self.nodes = at[:, None].astype(np.int32)
        self.force, self.rest = force[at], rest[at]

    def work(self, state: Placed, level: int, rows=slice(None), before=None) -> Work:
        """See Item.work."""
        pull = state.factors.get(self.name, self.factor) * self.force[rows]
        energy, force, stiffness = room(len(pull), 1, 1, pull.shape[1], level)
        moved = state.x[self.nodes[rows, 0]] - self.rest[rows]
        energy[:, 0] = -(pull * moved).sum(axis=1)
        if level >= FORCE:
            force[:, 0] = -pull
        stiffness[:] = 0.0
        return energy, force, stiffness


WAVES = 16  # of an imperfection


def imperfection(ply, height: float, seed: int) -> DeadLoads:
    """Loads that bend a ply in space as if it were not flat at rest, but wavy. Collective.

    They are those that hold the waves against the bending alone: free of all else the cloth has
    them, however much it stretches or shears. Waves of random direction, phase and length (from a
    sixth of the cloth's largest side to all of it) depend on the place only, so that they are the
    same on any number of ranks and for any pitch.

    Parameters
    ----------
    ply : Ply
    height : float
        Of the highest wave, m.
    seed : int
    """
    nodes, rest = ply.nodes, ply.nodes.rest
    size = ply.network.preform.size.max()
    random = np.random.default_rng(seed)
    angle, phase = 2.0 * np.pi * random.random((2, WAVES))
    number = 2.0 * np.pi / size * 6.0 ** random.random(WAVES)
    place = rest[:, :2] - ply.network.preform.middle
    along = place @ np.stack([np.cos(angle), np.sin(angle)])
    waves = np.zeros_like(rest)
    waves[:, 2] = np.cos(number * along + phase).sum(axis=1)
    waves *= height / most(ply.comm, abs(waves), 0.0)
    force = np.zeros_like(rest)
    held = SimpleNamespace(turn=np.tile(np.eye(3), (len(ply.clamped), 1, 1)))
    at_rest: Any = SimpleNamespace(x=rest, hold=held)
    for rows in ply.bends.chunks():
        at = ply.bends.nodes[rows]
        tangent = ply.bends.work(at_rest, STIFFNESS, rows)[2]
        np.add.at(force, at, np.einsum("mkilj,mlj->mki", tangent, waves[at]))
    force = nodes.halo.share(force)
    force[~ply.active] = 0.0
    return DeadLoads(force, rest, nodes.num_nodes_owned, "imperfection", 1.0)
