# SPDX-License-Identifier: MIT
"""Arm ends and hinges of a network as one distributed set of nodes."""

from __future__ import annotations

import numpy as np

from ..parallel import GhostExchange
from .keys import pack_key
from .lattice import ARM_STEP
from .network import Network


class Nodes:
    """Arm ends and hinges of a network as one distributed set of nodes. Collective.

    Owned nodes are numbered by yarn, the hinges along the warp yarns between their arm ends.

    Attributes
    ----------
    node_key, node_number_global, num_nodes_owned, num_nodes_local, num_nodes_global, node_offset,
    exchange
        As of a Network.
    of_network_node : int (n network nodes,)
        This set's local number of each local node of the network.
    of_hinge : int (n_owned crossovers,)
    after_hinge : int (n_owned crossovers, 2)
        Hinge of the next crossover along the warp and along the weft yarn; -1 where none is joined.
    """

    def __init__(self, network: Network):
        self.comm = network.comm
        ij = network.crossover_ij.astype(np.int64)
        hinge_key = pack_key(0, ij[:, 1], 4 * ij[:, 0])
        owned_nodes = network.num_nodes_owned
        owned_key = np.union1d(network.node_key[:owned_nodes], hinge_key)
        joined = network.arm_is_shared[:, :2]
        next_key = np.full((len(ij), 2), np.int64(-1))
        ghost_hinge, ghost_owner = [], []
        for family in (0, 1):
            there = ij + ARM_STEP[family]
            next_key[:, family] = pack_key(0, there[:, 1], 4 * there[:, 0])
            away = joined[:, family] & ~network.partition.in_box(there, self.comm.rank)
            ghost_hinge.append(next_key[away, family])
            ghost_owner.append(network.partition.owner(there[away]))
        ghost_end = network.node_key[owned_nodes:]
        key = np.concatenate([ghost_end, *ghost_hinge])
        owner = np.concatenate([network.ghost_owner, *ghost_owner])
        ghost_key, first = np.unique(key, return_index=True)
        self.node_key = np.concatenate([owned_key, ghost_key])
        self.num_nodes_owned = len(owned_key)
        self.num_nodes_local = len(self.node_key)
        self.node_offset = self.comm.exscan(self.num_nodes_owned) or 0
        self.num_nodes_global = self.comm.allreduce(self.num_nodes_owned)
        self.exchange = GhostExchange(self.comm, owned_key, ghost_key, owner[first])
        number = np.zeros(self.num_nodes_local, np.int64)
        number[: self.num_nodes_owned] = self.node_offset + np.arange(self.num_nodes_owned)
        self.node_number_global = self.exchange.forward(number)

        def local(keys: np.ndarray) -> np.ndarray:
            at = np.searchsorted(owned_key, keys)
            mine = at < len(owned_key)
            mine[mine] = owned_key[at[mine]] == keys[mine]
            return np.where(mine, at, len(owned_key) + np.searchsorted(ghost_key, keys))

        self.of_network_node = local(network.node_key).astype(np.int32)
        self.of_hinge = local(hinge_key).astype(np.int32)
        self.after_hinge = np.where(joined, local(next_key), -1).astype(np.int32)
