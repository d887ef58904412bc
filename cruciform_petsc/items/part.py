# SPDX-License-Identifier: MIT
"""An item of one set of nodes within several that are solved together."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import replace
from typing import Any, cast

import numpy as np

from .item import Item, Placed, Work


class OfPart(Item):
    """An item that knows its own part's nodes only, in a model of several parts.

    Parameters
    ----------
    item : Item
    at : int32 (n_local of the part,)
        The model's local numbers of the part's local nodes.
    name : str, optional
        In the model, where another part has an item of the same name: memory goes by it, sizes of
        loads by the item's own.
    """

    def __init__(self, item: Item, at: np.ndarray, name: str | None = None):
        self.item, self.name, self.lags = item, name or item.name, item.lags
        self.modes, self.is_load, self.patience = item.modes, item.is_load, item.patience
        self.nodes, self._at = at[item.nodes].astype(np.int32), at
        self._last: tuple[Placed, Placed] | None = None

    @property
    def keepers(self) -> np.ndarray:
        """See Item.keepers."""
        return self._at[self.item.keepers]

    def _view(self, state: Placed) -> Placed:
        """The state as its part sees it."""
        if self._last is None or self._last[0] is not state:
            view = part_of(state, self._at)
            if self.name != self.item.name:
                memory = {self.item.name: state.memory.get(self.name, {})}
                view = replace(cast(Any, view), memory=memory)
            self._last = (state, view)
        return self._last[1]

    def work(self, state: Placed, level: int, rows=slice(None), before=None) -> Work:
        """See Item.work."""
        before = None if before is None else before[self._at]
        return self.item.work(self._view(state), level, rows, before)

    def chunks(self) -> Iterator[slice]:
        """See Item.chunks."""
        return self.item.chunks()

    def lagged(self, state: Placed) -> tuple[Mapping[str, np.ndarray], float, float]:
        """See Item.lagged."""
        return self.item.lagged(self._view(state))

    def carried(self, before: Placed, after: Placed) -> tuple[np.ndarray, np.ndarray] | None:
        """See Item.carried."""
        found = self.item.carried(self._view(before), self._view(after))
        return None if found is None else (self._at[found[0]], found[1])

    def accepted(self, state: Placed) -> Mapping[str, np.ndarray]:
        """See Item.accepted."""
        return self.item.accepted(self._view(state))

    def broken(self, state: Placed) -> tuple[np.ndarray, str, str] | None:
        """See Item.broken."""
        return self.item.broken(self._view(state))


def part_of(state: Placed, at: np.ndarray) -> Placed:
    """A state as a part with the local nodes ``at`` sees it."""
    return replace(cast(Any, state), x=state.x[at])
