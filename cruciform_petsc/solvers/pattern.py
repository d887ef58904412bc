# SPDX-License-Identifier: MIT
"""Sparsity of network matrices, found once and filled as often as wanted.

The pattern is kept by node: a d x d block for each pair of nodes that share an element. With four
nodes on each cruciform and two cruciforms on each node, a row has at most seven blocks.

A worked example: two cruciforms with nodes (0 1 2 3) and (4 5 0 6) on one rank give the block rows
0: 0..6, 1 to 3: 0..3, 4 to 6: 0 4 5 6.

Values go straight to where PETSc keeps them, row by row, with no dense blocks in between where
elements share few matrices (`BlockPattern.sum`): a row that is like the one before is a copy of it.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property

import numba
import numpy as np
from petsc4py import PETSc

from ..parallel import DistributedNodes, Halo, send_by_rank
from .csr import aij, write_values

_INT = np.dtype(PETSc.IntType)
_FEW = 64  # numbers that are faster put in order one by one


@dataclass
class Layout:
    """Which entries of the blocks a matrix holds, in compressed rows."""

    keep: np.ndarray  # uint16 (blocks,), bit i d + j: whether entry (i, j) is held
    rows: np.ndarray  # PETSc's integers
    columns: np.ndarray  # global
    alike: np.ndarray  # bool (n_owned,), block rows that differ from the one before in values only


class BlockPattern:
    """Pattern of a matrix over distributed nodes, d unknowns each. Collective.

    Parameters
    ----------
    connectivities : sequence of int (m, k) arrays
        Local nodes of the elements, one array for each kind of element.
    block : int
        Unknowns per node, d, 3 at most.

    Attributes
    ----------
    slots : list of int32 (m, k, k)
        Places in the array of blocks of each element's pairs of nodes, by kind.
    diagonal : int32 (n_owned,)
        Places of the blocks of owned nodes with themselves.
    """

    def __init__(self, nodes: DistributedNodes, connectivities: Sequence[np.ndarray], block: int):
        self.nodes, self.block = nodes, block
        owned, number = nodes.num_nodes_owned, nodes.node_number_global
        parts = [np.ascontiguousarray(part, np.int32) for part in connectivities]
        sizes = np.concatenate([np.full(len(part), part.shape[1], np.int32) for part in parts])
        flat = np.concatenate([part.ravel() for part in parts])
        self._elements = elements = (*_by_node(flat, len(number)), sizes, flat)
        # What rows of ghosts hold goes to their owners.
        none = np.zeros(len(number) - owned + 1, np.int64), np.zeros(0, _INT)
        begin, ghost = _rows(owned, len(number), *elements, number, *none)
        row = np.repeat(np.arange(owned, len(number)), np.diff(begin))
        owner = nodes.ghost_owner[row - owned]
        pairs = np.stack([number[row], ghost], axis=1)
        (received,) = send_by_rank(nodes.comm, owner, pairs)
        received = received[np.argsort(received[:, 0], kind="stable")]
        more = np.searchsorted(received[:, 0], nodes.node_offset + np.arange(owned + 1))
        # Every owned node has its own block, also if no element uses it.
        start, column = _rows(0, owned, *elements, number, more, received[:, 1].astype(_INT))
        self.num_blocks, self._num_ghost_blocks = len(column), len(ghost)
        self._start = start = np.concatenate([start, start[-1] + begin[1:]])
        self._column = column = np.concatenate([column, ghost])
        self._halo = Halo(
            nodes.comm,
            self.num_blocks,
            owner,
            pairs,
            lambda pair: _find(pair[:, 0] - nodes.node_offset, pair[:, 1], start, column),
        )
        self.slots = [_places(part, number, start, column) for part in parts]
        self.diagonal = _find(np.arange(owned), number[:owned], start, column)

    @property
    def neighbours(self) -> tuple[np.ndarray, np.ndarray]:
        """Compressed rows of the nodes that owned nodes share elements with, global numbers."""
        return self._start[: self.nodes.num_nodes_owned + 1], self._column[: self.num_blocks]

    @cached_property
    def _whole(self) -> Layout:
        every = np.full(self.num_blocks, (1 << self.block**2) - 1, np.uint16)
        return self._layout(every, np.zeros(self.nodes.num_nodes_owned, bool))

    def _layout(self, keep: np.ndarray, alike: np.ndarray) -> Layout:
        owned, d = self.nodes.num_nodes_owned, self.block
        rows = np.zeros(owned * d + 1, _INT)
        _count(self._start[: owned + 1], keep, d, rows)
        columns = np.empty(rows[-1], _INT)
        _columns(self._start[: owned + 1], self._column, keep, d, columns)
        return Layout(keep, rows, columns, alike)

    def layout(self, which: np.ndarray, there: np.ndarray) -> Layout:
        """Layout of what elements of the first kind put there, and of the diagonal. Collective.

        ``which`` as for `sum`; ``there``: bool, shape of its matrices.
        """
        d, k = self.block, self.slots[0].shape[1]
        bit = 1 << np.arange(d * d).reshape(d, 1, d)
        bits = (there.reshape(-1, k, d, k, d) * bit).sum(axis=(2, 4), dtype=np.uint16)
        keep = np.zeros(len(self._column), np.uint16)
        keep[self.diagonal] = np.diag(bit[:, 0]).sum()
        _note(self.slots[0], which, bits, keep)
        self._halo.reverse(keep, np.bitwise_or)
        alike = np.zeros(self.nodes.num_nodes_owned, bool)
        _compare(*self._elements[:2], self.slots[0], self._start, keep, alike)
        return self._layout(keep[: self.num_blocks], alike)

    def empty_blocks(self) -> np.ndarray:
        """Zero blocks (owned ones, then ghost rows) to add element matrices to."""
        return np.zeros((len(self._column), self.block, self.block))

    def matrix(self, blocks: np.ndarray, reuse: PETSc.Mat | None = None) -> PETSc.Mat:
        """AIJ matrix from blocks; ghost rows are sent to their owners. Collective.

        With ``reuse`` (a matrix made here before) only its values change.
        """
        self._halo.reverse(blocks)
        start = self._start[: self.nodes.num_nodes_owned + 1]
        return self._filled(lambda values: _put(start, blocks, values), self._whole, reuse)

    def sum(
        self,
        layout: Layout,
        which: np.ndarray,
        matrices: np.ndarray,
        idle: np.ndarray,
        reuse: PETSc.Mat | None = None,
    ) -> PETSc.Mat:
        """AIJ matrix of elements of the first kind, of which many have the same. Collective.

        Parameters
        ----------
        layout : Layout
            What it holds; the rest is left out.
        which : int32 (m,)
            Number of each element's matrix, -1 for none.
        matrices : float (., k d, k d)
        idle : float (n_owned, d)
            To add to the diagonal.
        reuse : PETSc.Mat, optional
            A matrix made here before with the same layout, of which only the values change.
        """
        d, owned = self.block, self.nodes.num_nodes_owned
        common = *self._elements[:2], self.slots[0], which, np.ascontiguousarray(matrices)
        ghost = np.zeros((self._num_ghost_blocks, d, d))
        _ghosts(owned, *common, self._start, ghost)
        received = self._halo.to_owners(ghost)
        at = self._halo.exported
        row = np.searchsorted(self._start, at, side="right") - 1

        def fill(values: np.ndarray) -> None:
            _rows_of_elements(
                *common, self._start[: owned + 1], layout.keep, layout.alike, idle, self.diagonal,
                values,
            )  # fmt: skip
            _add(at, row, received, self._start, layout.keep, layout.rows, values)

        return self._filled(fill, layout, reuse)

    def _filled(
        self, fill: Callable[[np.ndarray], None], layout: Layout, reuse: PETSc.Mat | None
    ) -> PETSc.Mat:
        """A matrix with the values that a function writes to an array."""
        if reuse is not None:
            write_values(reuse, fill, layout.columns)
            return reuse
        values = np.empty(len(layout.columns))
        fill(values)
        local = self.block * self.nodes.num_nodes_owned
        comm = self.nodes.comm
        return aij(comm, (local, local), layout.rows, layout.columns, values, self.block)


# -- structure ---------------------------------------------------------------------------------


@numba.njit(cache=True)
def _by_node(flat, size):
    """Where each of ``size`` nodes stands in an array: begin (size + 1,), place (len(flat),)."""
    begin, place = np.zeros(size + 1, np.int32), np.empty(len(flat), np.int32)
    for node in flat:
        begin[node + 1] += 1
    for r in range(size):
        begin[r + 1] += begin[r]
    free = begin[:-1].copy()
    for t in range(len(flat)):
        place[free[flat[t]]] = t
        free[flat[t]] += 1
    return begin, place


@numba.njit(cache=True)
def _rows(first, last, begin, place, sizes, flat, number, more_begin, more):
    """Global numbers of the nodes that share an element with nodes first to last, ascending.

    ``sizes``: nodes of each element, one after the other in ``flat``; ``more`` numbers by row. Each
    owned node (the first of all) is its own neighbour. Returns compressed rows.
    """
    of, at = np.empty(len(flat), np.int32), np.empty(len(sizes) + 1, np.int64)
    at[0], longest, total = 0, 0, len(more)
    for e in range(len(sizes)):
        at[e + 1] = at[e] + sizes[e]
        of[at[e] : at[e + 1]] = e
    for r in range(last - first):
        here = 1 + more_begin[r + 1] - more_begin[r]
        for t in range(begin[first + r], begin[first + r + 1]):
            here += sizes[of[place[t]]]
        longest, total = max(longest, here), total + here
    start, column = np.zeros(last - first + 1, np.int64), np.empty(total, more.dtype)
    found, end = np.empty(longest, more.dtype), 0
    for r in range(last - first):
        n = 0
        if first == 0:
            found[0], n = number[r], 1
        for t in range(begin[first + r], begin[first + r + 1]):
            e = of[place[t]]
            for s in range(at[e], at[e + 1]):
                found[n] = number[flat[s]]
                n += 1
        for s in range(more_begin[r], more_begin[r + 1]):
            found[n] = more[s]
            n += 1
        if n <= _FEW:
            for a in range(1, n):
                value, b = found[a], a
                while b > 0 and found[b - 1] > value:
                    found[b] = found[b - 1]
                    b -= 1
                found[b] = value
        else:
            found[:n] = np.sort(found[:n])
        for a in range(n):
            if a == 0 or found[a] != found[a - 1]:
                column[end] = found[a]
                end += 1
        start[r + 1] = end
    return start, column[:end].copy()


@numba.njit(cache=True)
def _search(wanted, low, high, column):
    """Place of a number among ascending ones from ``low`` to ``high``."""
    while high - low > 1:
        middle = (low + high) // 2
        if column[middle] <= wanted:
            low = middle
        else:
            high = middle
    return low


@numba.njit(cache=True)
def _find(rows, columns, start, column):
    """Places of (row, column) pairs."""
    places = np.empty(len(rows), np.int32)
    for k in range(len(rows)):
        places[k] = _search(columns[k], start[rows[k]], start[rows[k] + 1], column)
    return places


@numba.njit(cache=True)
def _places(nodes, number, start, column):
    """Places (m, k, k) of each element's pairs of nodes."""
    m, k = nodes.shape
    places = np.empty((m, k, k), np.int32)
    for e in range(m):
        for p in range(k):
            low, high = start[nodes[e, p]], start[nodes[e, p] + 1]
            for q in range(k):
                places[e, p, q] = _search(number[nodes[e, q]], low, high, column)
    return places


@numba.njit(cache=True)
def _count(start, keep, d, rows):
    """Scalar compressed rows of block rows whose blocks hold the entries ``keep``."""
    for r in range(len(start) - 1):
        for i in range(d):
            n = 0
            for b in range(start[r], start[r + 1]):
                for j in range(d):
                    n += (keep[b] >> (i * d + j)) & 1
            rows[r * d + i + 1] = rows[r * d + i] + n


@numba.njit(cache=True)
def _columns(start, column, keep, d, columns):
    """Scalar columns of the entries that are kept."""
    e = 0
    for r in range(len(start) - 1):
        for i in range(d):
            for b in range(start[r], start[r + 1]):
                for j in range(d):
                    if (keep[b] >> (i * d + j)) & 1:
                        columns[e] = column[b] * d + j
                        e += 1


@numba.njit(cache=True)
def _note(slots, which, bits, keep):
    """Add the entries that elements have to those that are kept."""
    for e in range(slots.shape[0]):
        if which[e] >= 0:
            for p in range(slots.shape[1]):
                for q in range(slots.shape[2]):
                    keep[slots[e, p, q]] |= bits[which[e], p, q]


@numba.njit(cache=True)
def _compare(begin, place, slots, start, keep, alike):
    """Note block rows with elements, blocks and entries in the same places as the one before."""
    k = slots.shape[1]
    for r in range(1, len(alike)):
        n, m = begin[r + 1] - begin[r], start[r + 1] - start[r]
        same = n == begin[r] - begin[r - 1] and m == start[r] - start[r - 1]
        for b in range(m if same else 0):
            same &= keep[start[r] + b] == keep[start[r - 1] + b]
        for t in range(n if same else 0):
            here, there = place[begin[r] + t], place[begin[r - 1] + t]
            same &= here % k == there % k
            for q in range(k if same else 0):
                one = slots[here // k, here % k, q] - start[r]
                same &= one == slots[there // k, there % k, q] - start[r - 1]
        alike[r] = same


# -- values --------------------------------------------------------------------------------------


@numba.njit(cache=True)
def _put(start, blocks, values):
    """Write whole blocks as scalar rows."""
    e, d = 0, blocks.shape[1]
    for r in range(len(start) - 1):
        for i in range(d):
            for b in range(start[r], start[r + 1]):
                for j in range(d):
                    values[e] = blocks[b, i, j]
                    e += 1


@numba.njit(cache=True)
def _add_row(begin, end, place, slots, which, matrices, first, blocks, d):
    """Add what elements have of a node's row to its blocks, of which ``first`` is number 0."""
    k = slots.shape[1]
    for t in range(begin, end):
        e, p = place[t] // k, place[t] % k
        if which[e] < 0:
            continue
        for q in range(k):
            b = slots[e, p, q] - first
            for i in range(d):
                for j in range(d):
                    blocks[b, i, j] += matrices[which[e], p * d + i, q * d + j]


@numba.njit(cache=True)
def _ghosts(owned, begin, place, slots, which, matrices, start, ghost):
    """Rows of ghosts, as blocks."""
    first = start[owned]
    for r in range(owned, len(start) - 1):
        _add_row(
            begin[r], begin[r + 1], place, slots, which, matrices, first, ghost, ghost.shape[1]
        )


@numba.njit(cache=True)
def _rows_of_elements(
    begin, place, slots, which, matrices, start, keep, alike, idle, diagonal, values
):
    """Write the rows of owned nodes; one that is like the one before is a copy of it."""
    k, d, longest = slots.shape[1], idle.shape[1], 0
    for r in range(len(start) - 1):
        longest = max(longest, start[r + 1] - start[r])
    blocks = np.zeros((longest, d, d))
    e = length = 0
    for r in range(len(start) - 1):
        same = alike[r]
        if same:
            before, here = begin[r - 1], begin[r]
            for t in range(begin[r + 1] - here):
                same &= which[place[here + t] // k] == which[place[before + t] // k]
            for i in range(d):
                same &= idle[r, i] == idle[r - 1, i]
        if same:
            for s in range(e, e + length):
                values[s] = values[s - length]
            e += length
            continue
        n = start[r + 1] - start[r]
        blocks[:n] = 0.0
        _add_row(begin[r], begin[r + 1], place, slots, which, matrices, start[r], blocks, d)
        for i in range(d):
            blocks[diagonal[r] - start[r], i, i] += idle[r, i]
        length = e
        for i in range(d):
            for b in range(n):
                for j in range(d):
                    if (keep[start[r] + b] >> (i * d + j)) & 1:
                        values[e] = blocks[b, i, j]
                        e += 1
        length = e - length


@numba.njit(cache=True)
def _add(at, row, blocks, start, keep, rows, values):
    """Add blocks of places ``at`` in block rows ``row`` to the entries that are kept."""
    d = blocks.shape[1]
    for m in range(len(at)):
        for i in range(d):
            e = rows[row[m] * d + i]
            for b in range(start[row[m]], at[m]):
                for j in range(d):
                    e += (keep[b] >> (i * d + j)) & 1
            for j in range(d):
                if (keep[at[m]] >> (i * d + j)) & 1:
                    values[e] += blocks[m, i, j]
                    e += 1
