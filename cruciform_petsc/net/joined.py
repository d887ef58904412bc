# SPDX-License-Identifier: MIT
"""Several distributed sets of nodes as one: plies, and the tools that touch them."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ..parallel import DistributedNodes, Halo
from .lattice import PART_BIT


class ToolNodes(DistributedNodes):
    """A node for each of some rigid bodies, on rank 0, with copies everywhere. Collective.

    Parameters
    ----------
    rest : float (n, dim)
        Where they are at the start, m; the same on every rank.
    """

    def __init__(self, comm, rest: np.ndarray):
        key = np.arange(len(rest))
        mine, none = comm.rank == 0, key[:0]
        super().__init__(comm, key if mine else none, none if mine else key, np.zeros_like(key))
        self.rest = np.array(rest, float)
        self.frame = np.tile(np.eye(rest.shape[1]), (len(rest), 1, 1))


class JoinedNodes(DistributedNodes):
    """Sets of nodes, at most 64, with ``rest`` and ``frame`` as one set. Collective.

    Attributes
    ----------
    maps : list of int32 (n_local of the part,)
        Local numbers here of each part's local nodes.
    node_key
        The parts' keys, which leave room for the number of the part.
    comm, num_nodes_owned, num_nodes_local, num_nodes_global, node_offset, node_number_global,
    ghost_owner, halo
        As of DistributedNodes; owned nodes go part by part.
    rest, frame
        Those of the parts.
    """

    def __init__(self, parts: Sequence):
        self.comm = comm = parts[0].comm
        owned = [part.num_nodes_owned for part in parts]
        ghosts = [part.num_nodes_local - part.num_nodes_owned for part in parts]
        self.num_nodes_owned = sum(owned)
        self.num_nodes_local = self.num_nodes_owned + sum(ghosts)
        self.num_nodes_global = comm.allreduce(self.num_nodes_owned)
        self.node_offset = comm.exscan(self.num_nodes_owned) or 0
        self.node_number_global = np.empty(self.num_nodes_local, np.int64)
        self.maps = []
        begin, ghost = 0, self.num_nodes_owned
        for part, n, m in zip(parts, owned, ghosts, strict=True):
            at = np.concatenate([begin + np.arange(n), ghost + np.arange(m)]).astype(np.int32)
            number = self.node_offset + at.astype(np.int64)
            self.node_number_global[at] = part.halo.forward(number)
            self.maps.append(at)
            begin, ghost = begin + n, ghost + m
        self.ghost_owner = np.concatenate([part.ghost_owner for part in parts])
        numbers = self.node_number_global[self.num_nodes_owned :]
        self.halo = Halo.of_numbers(comm, self.num_nodes_owned, numbers)
        self.rest = self.join([part.rest for part in parts])
        self.frame = self.join([part.frame for part in parts])
        keys = [part.node_key + (n << PART_BIT) for n, part in enumerate(parts)]
        self.node_key = self.join(keys)

    def join(self, values: Sequence[np.ndarray]) -> np.ndarray:
        """Values of the parts' local nodes (n_local, ...) -> of all local nodes."""
        joined = np.empty((self.num_nodes_local, *values[0].shape[1:]), values[0].dtype)
        for at, part in zip(self.maps, values, strict=True):
            joined[at] = part
        return joined
