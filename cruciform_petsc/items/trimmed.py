# SPDX-License-Identifier: MIT
"""Items of cloth of which parts are cut off."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import shapely

from ..elements.level import FORCE, STIFFNESS
from .item import Item, Placed, Work

LEFT = 1e-3  # of all that acts: scrap lies where it fell, held by viscosity and between tools


class Trimmed:
    """An item whose elements beyond cuts fade: energy times the factor of the cut's name.

    Down to LEFT, so that no node is without any stiffness. All else is the item's own.

    Parameters
    ----------
    item : Item
    places : float (n_local, 2)
        Of nodes at rest.
    cuts : mapping
        By name: the part of the flat cloth that stays, shapely polygon.
    points : slice
        Of its elements' nodes; an element stays where all of these do.
    """

    def __init__(
        self,
        item: Item,
        places: np.ndarray,
        cuts: Mapping[str, shapely.Polygon],
        points: slice = slice(0, 1),
    ):
        self.item, self._names = item, list(cuts)
        corners = places[item.nodes[:, points]]
        # By cut: elements beyond it.
        self._gone = np.array([
            ~shapely.contains_xy(keep, corners[..., 0], corners[..., 1]).all(axis=1)
            for keep in cuts.values()
        ])  # fmt: skip

    def __getattr__(self, name: str) -> Any:
        return getattr(self.item, name)

    def work(self, state: Placed, level: int, rows=slice(None), before=None) -> Work:
        """See Item.work."""
        energy, force, stiffness = self.item.work(state, level, rows, before)
        share = self._share(state)[rows]
        energy *= share[:, None]
        if level >= FORCE:
            force *= share[:, None, None]
        if level >= STIFFNESS:
            stiffness *= share[:, None, None, None, None]
        return energy, force, stiffness

    def accepted(self, state: Placed) -> Mapping[str, np.ndarray]:
        """See Item.accepted; what is spent from here on fades, too."""
        memory = dict(self.item.accepted(state))
        if "spent" in memory:
            before = state.memory.get(self.item.name, {}).get("spent", 0.0)
            memory["spent"] = before + self._share(state) * (memory["spent"] - before)
        return memory

    def _share(self, state: Placed) -> np.ndarray:
        """What of each element acts, (m,)."""
        share: np.ndarray = np.ones(self._gone.shape[1])
        for name, gone in zip(self._names, self._gone, strict=True):
            share[gone] *= state.factors.get(name, 1.0)
        return np.maximum(share, LEFT)


def kept(
    places: np.ndarray, cuts: Mapping[str, shapely.Polygon], factors: Mapping[str, float]
) -> np.ndarray:
    """Which places (n, 2) at rest are on what cuts that are done have left; bool (n,)."""
    stays = np.ones(len(places), bool)
    for name, keep in cuts.items():
        if factors.get(name, 1.0) == 0.0:
            stays &= shapely.contains_xy(keep, *places.T)
    return stays
