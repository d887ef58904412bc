# SPDX-License-Identifier: MIT
"""What adds to equilibrium: an item has an energy of the state, and its derivatives.

A model sums items and knows none by name. Cruciforms, yarns that bend, loads are items; so are a
pressure, a tool in contact, another ply. An item is anything with the members of `Item`.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any, Protocol

import numpy as np


class Placed(Protocol):
    """What items look at: equilibrium.state.State."""

    @property
    def x(self) -> np.ndarray:
        """Positions, float (n_local, dim), m."""

    @property
    def hold(self) -> Any:
        """What is prescribed; ``hold.turn`` (c, dim, dim) turns the yarns that clamps hold."""

    @property
    def time(self) -> float:
        """What drives the stage."""

    @property
    def factors(self) -> Mapping[str, float]:
        """Sizes of loads by item."""

    @property
    def memory(self) -> Mapping[str, Mapping[str, np.ndarray]]:
        """What items remember, by item."""


# Elements worked on at a time: their matrices stay in the processor's cache until they are added.
CHUNK = 1024
Work = tuple[np.ndarray, np.ndarray, np.ndarray]


class Item:
    """Base class with what most items have in common.

    Attributes
    ----------
    name : str
    modes : tuple of str
        Names of its parts of the energy.
    nodes : int32 (m, k)
        Local nodes of its elements.
    is_load : bool
        Whether it pushes from outside: its forces then count in what balance is measured by, and
        its energy is none of the cloth's strain energy.
    lags : bool
        Whether it takes something as given while equilibrium is sought, see `lagged`.
    patience : float
        For how many Newton steps what it takes as given may do, before it is looked at again.
    """

    name: str = ""
    modes: Sequence[str] = ()
    nodes: np.ndarray
    is_load = False
    lags = False
    patience = np.inf

    @property
    def keepers(self) -> np.ndarray:
        """Local nodes (m,), this rank's own and all different: checkpoints keep memory by them."""
        return self.nodes[:, 0]

    def work(
        self, state: Placed, level: int, rows: slice = slice(None), before: np.ndarray | None = None
    ) -> Work:
        """Energy, force and stiffness of the elements ``rows``; not collective.

        Parameters
        ----------
        state : State
        level : int
            elements.level.ENERGY, FORCE or STIFFNESS: what is beyond it has no rows.
        rows : slice
        before : float (n_local, dim), optional
            Positions from which Newton's last step led to the state (see cruciform.cruciforms).

        Returns
        -------
        energy : float (m, modes), J
        force : float (m, k, dim), N, the gradient of the energy
        stiffness : float (m, k, dim, k, dim), N/m, the gradient of the force
        """
        raise NotImplementedError

    def chunks(self) -> Iterator[slice]:
        """Slices of its elements, one at least, to work on one after the other."""
        for begin in range(0, max(len(self.nodes), 1), CHUNK):
            yield slice(begin, begin + CHUNK)

    def joined(self, state: Placed) -> np.ndarray:
        """Local nodes of its elements at a state, int32 (m, k): those whose energies `work` tells.

        By default `nodes`. Those of an item whose elements change follow from what it remembers;
        the same memory gives the same array. Rows of the memory are those of `nodes` all the same.
        """
        return self.nodes

    def lagged(self, state: Placed) -> tuple[Mapping[str, np.ndarray], float, float]:
        """What the item takes as given while equilibrium is sought, as it is at a state.

        Returns
        -------
        memory : mapping
            To seek equilibrium with again.
        change, size : float
            Forces of this rank's elements, N: by how much those taken as given were wrong, and
            their sum.
        """
        return state.memory.get(self.name, {}), 0.0, 0.0

    def accepted(self, state: Placed) -> Mapping[str, np.ndarray]:
        """What to remember of a state that was accepted: arrays (m, ...), a row an element.

        Checkpoints keep a row by its element's node in ``keepers``.
        """
        return {}

    def carried(self, before: Placed, after: Placed) -> tuple[np.ndarray, np.ndarray] | None:
        """Local nodes that would go along with a tool, as it has moved, and their places.

        A guess, of this rank's nodes. None, on every rank alike, where nothing has moved.
        """
        return None

    def broken(self, state: Placed) -> tuple[np.ndarray, str, str] | None:
        """Where, by what name and in what words a state is none of cloth. Collective."""
        return None
