# SPDX-License-Identifier: MIT
"""Sparsity of network matrices, found once and filled as often as wanted.

The pattern is kept by node: a dense d x d block for each pair of nodes that share a cruciform. With
four nodes on each cruciform and two cruciforms on each node, a row has at most seven blocks.

A worked example: two cruciforms with nodes (0 1 2 3) and (4 5 0 6) on one rank give the block rows
0: 0..6, 1 to 3: 0..3, 4 to 6: 0 4 5 6.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numba
import numpy as np
from petsc4py import PETSc

from ..parallel import DistributedNodes, Halo, send_by_rank
from .csr import aij, gather, write_values

_INT = np.dtype(PETSc.IntType).type


@dataclass
class Layout:
    """Which entries of the blocks a matrix holds, in compressed rows.

    rows, columns : PETSc's integers; columns are global.
    source : uint32 (uint64 if need be), place of each entry in the flattened array of blocks.
    """

    rows: np.ndarray
    columns: np.ndarray
    source: np.ndarray


class BlockPattern:
    """Pattern of a matrix over distributed nodes, d unknowns each. Collective.

    Parameters
    ----------
    nodes : DistributedNodes
    connectivities : sequence of int (m, k) arrays
        Local nodes of the elements, one array for each kind of element.
    block : int
        Unknowns per node, d.

    Attributes
    ----------
    slots : list of int32 (m, k, k)
        Place in the array of blocks of each element's pairs of nodes, for each connectivity.
    diagonal : int (n_owned,)
        Places of the blocks of owned nodes with themselves.
    """

    def __init__(self, nodes: DistributedNodes, connectivities: Sequence[np.ndarray], block: int):
        self.nodes, self.block = nodes, block
        owned = nodes.num_nodes_owned
        number = nodes.node_number_global
        size = len(number)
        mesh = _Mesh(connectivities, size)
        # Rows of ghosts first: what they hold goes to their owners.
        none = np.zeros(size + 1, np.int64), np.zeros(0, np.int64)
        ghost_start, ghost_column = mesh.rows(owned, size, False, number, *none)
        ghost_row = np.repeat(np.arange(owned, size), np.diff(ghost_start))
        pairs = np.stack([number[ghost_row], ghost_column], axis=1)
        owner = nodes.ghost_owner[ghost_row - owned]
        (received,) = send_by_rank(nodes.comm, owner, pairs)
        place = received[:, 0] - nodes.node_offset
        by_row = np.argsort(place, kind="stable")
        extra_start = np.searchsorted(place[by_row], np.arange(size + 1))
        start, column = mesh.rows(0, owned, True, number, extra_start, received[by_row, 1])
        self._start, self._column = start, column
        self.num_blocks = len(column)
        self._num_ghost_blocks = len(ghost_column)
        self._halo = Halo(
            nodes.comm,
            self.num_blocks,
            owner,
            pairs,
            lambda pair: _find(pair[:, 0] - nodes.node_offset, pair[:, 1], start, column),
        )
        every_start = np.concatenate([start, start[-1] + ghost_start[1:]])
        every_column = np.concatenate([column, ghost_column])
        self.slots = [
            _slots(np.ascontiguousarray(part), number, every_start, every_column)
            for part in connectivities
        ]
        self.diagonal = _find(np.arange(owned), number[:owned], start, column)
        self.comm = nodes.comm
        self._dense: Layout | None = None

    def layout(self, keep: np.ndarray | None = None) -> Layout:
        """Layout of all entries, or of those that are kept.

        keep : bool (num_blocks, d, d) or array of that size whose entries count if not zero.
        """
        if keep is not None:
            return self._new_layout(keep, False)
        if self._dense is None:
            self._dense = self._new_layout(np.ones((1, self.block, self.block), bool), True)
        return self._dense

    def _new_layout(self, keep: np.ndarray, whole: bool) -> Layout:
        d = self.block
        small = self.num_blocks * d * d < 2**32
        source = np.zeros(0, np.uint32 if small else np.uint64)
        return Layout(*_layout(self._start, self._column, d, keep, whole, source))

    def empty_blocks(self, dtype: type = float) -> np.ndarray:
        """Zero blocks (owned ones, then ghost rows) to add element matrices to."""
        d = self.block
        return np.zeros((self.num_blocks + self._num_ghost_blocks, d, d), dtype)

    def add(self, blocks: np.ndarray, rows: np.ndarray, matrices: np.ndarray) -> None:
        """Add matrices (m or 1, k d, k d) of elements ``rows`` of the first kind, in place.

        To blocks of type bool: note which entries are not zero.
        """
        add = _mark if blocks.dtype == bool else _add
        add(blocks, self.slots[0], rows, np.ascontiguousarray(matrices), self.block)

    def collect(self, blocks: np.ndarray) -> np.ndarray:
        """Move ghost rows to their owners, in place. Collective."""
        self._halo.reverse(blocks)
        blocks[self.num_blocks :] = 0.0
        return blocks

    def matrix(
        self, blocks: np.ndarray, reuse: PETSc.Mat | None = None, layout: Layout | None = None
    ) -> PETSc.Mat:
        """AIJ matrix from blocks; ghost rows are sent to their owners. Collective.

        With ``reuse`` (a matrix made here before with the same layout) only its values change.
        Entries outside the layout (by default there are none) are left out.
        """
        self.collect(blocks)
        layout = layout or self.layout()
        if reuse is not None:
            write_values(reuse, blocks, layout.columns, layout.source)
            return reuse
        local = self.block * self.nodes.num_nodes_owned
        values = gather(blocks.reshape(-1), layout.source, np.empty(len(layout.source)))
        return aij(self.comm, (local, local), layout.rows, layout.columns, values, self.block)


class _Mesh:
    """Elements of several kinds, and which of them each local node belongs to."""

    def __init__(self, connectivities: Sequence[np.ndarray], size: int):
        lengths = [np.full(len(part), part.shape[1], np.int64) for part in connectivities]
        self._begin = np.concatenate([[0], np.cumsum(np.concatenate(lengths))])
        self._nodes = np.concatenate([part.ravel() for part in connectivities]).astype(np.int32)
        self._start, self._element = _incidence(self._begin, self._nodes, size)

    def rows(
        self, first, stop, diagonal, number, extra_start, extra
    ) -> tuple[np.ndarray, np.ndarray]:
        """Block rows of nodes first to stop: pointer and columns (global numbers, ascending)."""
        given = (
            first, stop, diagonal, number, self._begin, self._nodes, self._start, self._element,
            extra_start, extra,
        )  # fmt: skip
        start = np.zeros(stop - first + 1, np.int64)
        _block_rows(*given, start, np.zeros(0, np.int64))
        column = np.empty(start[-1], np.int64)
        if len(column):
            _block_rows(*given, start, column)
        return start, column


@numba.njit(cache=True)
def _incidence(begin, nodes, size):
    """Elements of each node, in compressed rows."""
    start = np.zeros(size + 1, np.int64)
    for node in nodes:
        start[node + 1] += 1
    start = np.cumsum(start)
    at, element = start[:-1].copy(), np.empty(len(nodes), np.int32)
    for e in range(len(begin) - 1):
        for k in range(begin[e], begin[e + 1]):
            element[at[nodes[k]]] = e
            at[nodes[k]] += 1
    return start, element


@numba.njit(cache=True)
def _block_rows(first, stop, diagonal, number, begin, nodes, start, element, extra_start, extra,
                pointer, column):  # fmt: skip
    """Columns of each row: every node it shares an element with, itself, and extra ones.

    With an empty ``column`` only the pointer is found.
    """
    longest = 1
    for r in range(first, stop):
        length = 1 + extra_start[r + 1] - extra_start[r]
        for k in range(start[r], start[r + 1]):
            length += begin[element[k] + 1] - begin[element[k]]
        longest = max(longest, length)
    found = np.empty(longest, np.int64)
    size = 0
    for r in range(first, stop):
        count = 0
        if diagonal:  # every owned node has its own block, also if no element uses it
            found[0], count = number[r], 1
        for k in range(extra_start[r], extra_start[r + 1]):
            count = _insert(found, count, extra[k])
        for k in range(start[r], start[r + 1]):
            e = element[k]
            for q in range(begin[e], begin[e + 1]):
                count = _insert(found, count, number[nodes[q]])
        if len(column):
            column[size : size + count] = found[:count]
        size += count
        pointer[r - first + 1] = size


@numba.njit(cache=True)
def _insert(found, count, value):
    """Put a value into ascending ones unless it is there; returns how many there are then."""
    at = count
    while at > 0 and found[at - 1] >= value:
        at -= 1
    if at < count and found[at] == value:
        return count
    for k in range(count, at, -1):
        found[k] = found[k - 1]
    found[at] = value
    return count + 1


@numba.njit(cache=True)
def _place(row, value, start, column):
    """Where an ascending row has a column."""
    low, high = start[row], start[row + 1]
    while high - low > 1:
        middle = (low + high) // 2
        if column[middle] <= value:
            low = middle
        else:
            high = middle
    return low


@numba.njit(cache=True)
def _find(rows, columns, start, column):
    """Places of (row, column) pairs."""
    places = np.empty(len(rows), np.int64)
    for k in range(len(rows)):
        places[k] = _place(rows[k], columns[k], start, column)
    return places


@numba.njit(cache=True)
def _slots(connectivity, number, start, column):
    """Places of all pairs of nodes of each element, int32 (m, k, k)."""
    m, k = connectivity.shape
    slots = np.empty((m, k, k), np.int32)
    for e in range(m):
        for p in range(k):
            for q in range(k):
                slots[e, p, q] = _place(
                    connectivity[e, p], number[connectivity[e, q]], start, column
                )
    return slots


@numba.njit(cache=True)
def _layout(start, column, d, keep, whole, like):
    """Scalar compressed rows of block rows, and the place of each entry among the blocks."""
    n = len(start) - 1
    rows = np.zeros(n * d + 1, np.int64)
    for r in range(n):
        for i in range(d):
            count = 0
            for b in range(start[r], start[r + 1]):
                for j in range(d):
                    count += whole or keep[b, i, j] != 0
            rows[r * d + i + 1] = rows[r * d + i] + count
    columns, source = np.empty(rows[-1], _INT), np.empty(rows[-1], like.dtype)
    e = 0
    for r in range(n):
        for i in range(d):
            for b in range(start[r], start[r + 1]):
                for j in range(d):
                    if whole or keep[b, i, j] != 0:
                        columns[e] = column[b] * d + j
                        source[e] = (b * d + i) * d + j
                        e += 1
    return rows.astype(_INT), columns, source


@numba.njit(cache=True)
def _add(blocks, slots, rows, matrices, d):
    """Add element matrices (m or 1, k d, k d) to the blocks of elements ``rows``."""
    k = slots.shape[1]
    for e in range(len(rows)):
        m = e if len(matrices) > 1 else 0
        for p in range(k):
            for q in range(k):
                block = blocks[slots[rows[e], p, q]]
                for i in range(d):
                    for j in range(d):
                        block[i, j] += matrices[m, d * p + i, d * q + j]


@numba.njit(cache=True)
def _mark(blocks, slots, rows, matrices, d):
    """Note in blocks which entries of element matrices (m or 1, k d, k d) are not zero."""
    k = slots.shape[1]
    for e in range(len(rows)):
        m = e if len(matrices) > 1 else 0
        for p in range(k):
            for q in range(k):
                slot = slots[rows[e], p, q]
                for i in range(d):
                    for j in range(d):
                        if matrices[m, d * p + i, d * q + j]:
                            blocks[slot, i, j] = True
