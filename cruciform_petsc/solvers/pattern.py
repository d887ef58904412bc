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
from functools import cached_property

import numba
import numpy as np
from petsc4py import PETSc
from scipy.sparse import csr_array

from ..parallel import DistributedNodes, Halo, send_by_rank
from .csr import aij, gather, write_values

_INT = np.dtype(PETSc.IntType).type


@dataclass
class Layout:
    """Which entries of the blocks a matrix holds, in compressed rows."""

    rows: np.ndarray  # PETSc's integers
    columns: np.ndarray  # global
    source: np.ndarray  # uint32 (uint64 if need be), their places in the flattened array of blocks


class BlockPattern:
    """Pattern of a matrix over distributed nodes, d unknowns each. Collective.

    Parameters
    ----------
    connectivities : sequence of int (m, k) arrays
        Local nodes of the elements, one array for each kind of element.
    block : int
        Unknowns per node, d.

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
        # Every owned node has its own block, also if no element uses it.
        rows = _neighbours([*connectivities, np.arange(owned)[:, None]], len(number))
        rows = csr_array(
            (rows.data, number[rows.indices], rows.indptr), (len(number), nodes.num_nodes_global)
        )
        rows.sort_indices()
        # What rows of ghosts hold goes to their owners.
        ghost = rows[owned:].tocoo()
        owner = nodes.ghost_owner[ghost.row]
        pairs = np.stack([number[owned + ghost.row], ghost.col], axis=1)
        (received,) = send_by_rank(nodes.comm, owner, pairs)
        places = received[:, 0] - nodes.node_offset, received[:, 1]
        rows = rows + csr_array((np.ones(len(received), bool), places), rows.shape)
        start, column = rows.indptr, rows.indices
        self._start, self._column = start[: owned + 1], column
        self.num_blocks, self._num_ghost_blocks = int(start[owned]), ghost.nnz
        self._halo = Halo(
            nodes.comm,
            self.num_blocks,
            owner,
            pairs,
            lambda pair: _find(pair[:, 0] - nodes.node_offset, pair[:, 1], start, column),
        )
        self.slots = [_find(*_pairs(part, number), start, column) for part in connectivities]
        self.diagonal = _find(np.arange(owned), number[:owned], start, column)

    @cached_property
    def _whole(self) -> Layout:
        return self.layout(np.ones((1, self.block, self.block), bool))

    def layout(self, keep: np.ndarray) -> Layout:
        """Layout of the entries to keep: array (num_blocks or 1, d, d), those that are not zero."""
        small = self.num_blocks * self.block**2 < 2**32
        source = np.zeros(0, np.uint32 if small else np.uint64)
        return Layout(*_layout(self._start, self._column, keep, source))

    def empty_blocks(self, dtype: type = float) -> np.ndarray:
        """Zero blocks (owned ones, then ghost rows) to add element matrices to."""
        d = self.block
        return np.zeros((self.num_blocks + self._num_ghost_blocks, d, d), dtype)

    def add(self, blocks: np.ndarray, rows: np.ndarray, matrices: np.ndarray) -> None:
        """Add matrices (m or 1, k d, k d) of elements ``rows`` of the first kind, in place.

        Of type bool, both: note which entries are not zero.
        """
        _add(blocks, self.slots[0], rows, np.ascontiguousarray(matrices), self.block)

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
        layout = layout or self._whole
        if reuse is not None:
            write_values(reuse, blocks, layout.columns, layout.source)
            return reuse
        local = self.block * self.nodes.num_nodes_owned
        values = gather(blocks.reshape(-1), layout.source, np.empty(len(layout.source)))
        return aij(self.nodes.comm, (local, local), layout.rows, layout.columns, values, self.block)


def _neighbours(connectivities: Sequence[np.ndarray], size: int) -> csr_array:
    """Which of ``size`` nodes share an element with which, bool (size, size)."""
    lengths = np.concatenate([np.full(len(part), part.shape[1]) for part in connectivities])
    nodes = np.concatenate([part.ravel() for part in connectivities])
    pointer = np.concatenate([[0], np.cumsum(lengths)])
    elements = csr_array((np.ones(len(nodes), bool), nodes, pointer), (len(lengths), size))
    return elements.T.tocsr() @ elements


def _pairs(nodes: np.ndarray, number: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Rows and columns (m, k, k) of each element's pairs of nodes."""
    shape = (*nodes.shape, nodes.shape[1])
    columns = number[nodes][:, None, :]
    return np.broadcast_to(nodes[:, :, None], shape), np.broadcast_to(columns, shape)


@numba.njit(cache=True)
def _find(rows, columns, start, column):
    """Places of (row, column) pairs, arrays of one shape, in rows with ascending columns."""
    places = np.empty(rows.shape, np.int32)
    for k in np.ndindex(rows.shape):
        low, high = start[rows[k]], start[rows[k] + 1]
        while high - low > 1:
            middle = (low + high) // 2
            if column[middle] <= columns[k]:
                low = middle
            else:
                high = middle
        places[k] = low
    return places


@numba.njit(cache=True)
def _layout(start, column, keep, like):
    """Scalar compressed rows of block rows, and the place of each entry among the blocks."""
    n, d = len(start) - 1, keep.shape[1]
    rows = np.zeros(n * d + 1, _INT)
    longest = start[-1] * d * d
    columns, source = np.empty(longest, _INT), np.empty(longest, like.dtype)
    e = 0
    for r in range(n):
        for i in range(d):
            for b in range(start[r], start[r + 1]):
                kept = keep[b if len(keep) > 1 else 0]
                for j in range(d):
                    if kept[i, j] != 0:
                        columns[e] = column[b] * d + j
                        source[e] = (b * d + i) * d + j
                        e += 1
            rows[r * d + i + 1] = e
    return rows, columns[:e], source[:e]


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
                        block[i, j] = block[i, j] + matrices[m, d * p + i, d * q + j]
