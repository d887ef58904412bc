# SPDX-License-Identifier: MIT
"""Sparsity of network matrices, found once and filled as often as wanted.

The pattern is kept by node: a dense d x d block for each pair of nodes that share a cruciform. With
four nodes on each cruciform and two cruciforms on each node, a row has at most seven blocks.

A worked example: two cruciforms with nodes (0 1 2 3) and (4 5 0 6) on one rank give the block rows
0: 0..6, 1 to 3: 0..3, 4 to 6: 0 4 5 6.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Protocol

import numpy as np
from mpi4py import MPI
from petsc4py import PETSc

from .exchange import GhostExchange


class Nodes(Protocol):
    """What a pattern must know of nodes that are dealt out over ranks: a Network's, for example."""

    comm: MPI.Intracomm
    exchange: GhostExchange
    num_nodes_owned: int
    num_nodes_global: int
    node_offset: int
    node_number_global: np.ndarray


class BlockPattern:
    """Pattern of a matrix over distributed nodes, d unknowns each. Collective.

    Parameters
    ----------
    nodes : Network or other Nodes
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

    def __init__(self, nodes: Nodes, connectivities: Sequence[np.ndarray], block: int):
        self.nodes, self.block = nodes, block
        comm, exchange, owned = nodes.comm, nodes.exchange, nodes.num_nodes_owned
        span = np.int64(nodes.num_nodes_global)
        number = nodes.node_number_global
        # Every node has its own block, also if no element of this rank uses it.
        pairs = [
            part[:, :, None].astype(np.int64) * span + number[part][:, None, :]
            for part in connectivities
        ]
        own = np.arange(owned, dtype=np.int64) * span + number[:owned]
        key = np.unique(np.concatenate([*(part.ravel() for part in pairs), own]))
        # Rows of ghosts come last; what they hold goes to their owners.
        split = np.searchsorted(key, owned * span)
        ghost_row = (key[split:] // span).astype(np.int64)
        self._send_count, order, row_key = exchange.route(ghost_row, number[ghost_row])
        self._send_slot = split + order
        out = np.ascontiguousarray(np.stack([row_key, key[split:][order] % span], axis=1))
        self._receive_count = exchange.counts(self._send_count)
        received = exchange.alltoall(out, self._send_count, self._receive_count)
        extra = (received[:, 0] - nodes.node_offset) * span + received[:, 1]
        owned_key = np.union1d(key[:split], extra)
        self._receive_slot = np.searchsorted(owned_key, extra)
        self._num_ghost_blocks = len(key) - split
        row, self._column = np.divmod(owned_key, span)
        self.num_blocks = len(owned_key)
        self._block_pointer = np.searchsorted(row, np.arange(owned + 1))

        in_owned = np.searchsorted(owned_key, key[:split])
        ghost = self.num_blocks + np.arange(self._num_ghost_blocks)
        place = np.concatenate([in_owned, ghost]).astype(np.int32)
        self.slots = [place[np.searchsorted(key, part)] for part in pairs]
        self.diagonal = np.searchsorted(owned_key, own)
        self._send_slot += self.num_blocks - split
        self.comm = comm
        self._rows, self._columns, self._place = self._scalar_rows()

    def _scalar_rows(self):
        """Scalar CSR (pointer, columns) and the block entry behind each scalar entry's row."""
        d, pointer = self.block, self._block_pointer
        per_row = np.diff(pointer)
        rows = np.concatenate([[0], np.cumsum(np.repeat(per_row * d, d))])
        # Entry (i, j) of block b in row r stands at
        # d*d*pointer[r] + i*d*per_row[r] + d*(b - pointer[r]) + j.
        blocks = np.arange(self.num_blocks)
        r = np.repeat(np.arange(len(per_row)), per_row)
        base = d * d * pointer[r] + d * (blocks - pointer[r])
        place = base[:, None, None] + (
            np.arange(d)[:, None] * (d * per_row[r])[:, None, None] + np.arange(d)
        )
        columns = np.empty(self.num_blocks * d * d, PETSc.IntType)
        columns[place.ravel()] = np.broadcast_to(
            (self._column[:, None, None] * d + np.arange(d)), place.shape
        ).ravel()
        return rows.astype(PETSc.IntType), columns, place.astype(np.int64)

    def empty_blocks(self) -> np.ndarray:
        """Zero blocks (owned ones, then ghost rows) to add element matrices to."""
        d = self.block
        return np.zeros((self.num_blocks + self._num_ghost_blocks, d, d))

    def add(self, blocks: np.ndarray, rows: np.ndarray, matrices: np.ndarray) -> None:
        """Add matrices (m or 1, k d, k d) of elements ``rows`` of the first kind, in place.

        No two of these elements may meet in the same block with the same place (p, q), as is so
        for cruciforms on their four arm ends.
        """
        d = self.block
        slot = self.slots[0][rows]
        for p in range(slot.shape[1]):
            for q in range(slot.shape[1]):
                part = matrices[:, d * p : d * p + d, d * q : d * q + d]
                blocks[slot[:, p, q]] += part

    def matrix(self, blocks: np.ndarray, reuse: PETSc.Mat | None = None) -> PETSc.Mat:
        """AIJ matrix from blocks; ghost rows are sent to their owners. Collective.

        With ``reuse`` (a matrix made here before) only its values change.
        """
        received = self.nodes.exchange.alltoall(
            blocks[self._send_slot], self._send_count, self._receive_count
        )
        np.add.at(blocks, self._receive_slot, received)
        values = np.empty(self.num_blocks * self.block**2)
        values[self._place.ravel()] = blocks[: self.num_blocks].ravel()
        if reuse is None:
            local = self.block * self.nodes.num_nodes_owned
            reuse = PETSc.Mat().create(comm=self.comm)
            reuse.setSizes(((local, None), (local, None)))
            reuse.setBlockSize(self.block)
            reuse.setType(PETSc.Mat.Type.AIJ)
            reuse.setPreallocationCSR((self._rows, self._columns, values))
            return reuse
        reuse.setValuesCSR(self._rows, self._columns, values, PETSc.InsertMode.INSERT_VALUES)
        reuse.assemble()
        return reuse
