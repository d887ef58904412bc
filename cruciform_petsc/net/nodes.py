# SPDX-License-Identifier: MIT
"""Arm ends and hinges of a network as one distributed set of nodes."""

from __future__ import annotations

import numpy as np

from ..parallel import DistributedNodes
from .keys import pack_key
from .lattice import ARM_STEP
from .network import Network


class Nodes(DistributedNodes):
    """Arm ends and hinges of a network as one distributed set of nodes. Collective.

    Owned nodes are numbered by yarn, the hinges along the warp yarns between their arm ends.

    Attributes
    ----------
    of_network_node : int (n network nodes,)
        This set's local number of each local node of the network.
    of_hinge : int (n_owned crossovers,)
    after_hinge : int (n_owned crossovers, 2)
        Hinge of the next crossover along the warp and along the weft yarn; -1 where none is joined.
    """

    def __init__(self, network: Network):
        ij = network.crossover_ij.astype(np.int64)
        hinge_key = pack_key(0, ij[:, 1], 4 * ij[:, 0])
        joined = network.arm_is_shared[:, :2]
        there = ij[:, None] + ARM_STEP[:2]
        next_key = pack_key(0, there[..., 1], 4 * there[..., 0])
        away = joined & ~network.partition.in_box(there, network.comm.rank)
        end_key = network.node_key
        owned, ghost = np.split(end_key, [network.num_nodes_owned])
        super().__init__(
            network.comm,
            np.union1d(owned, hinge_key),
            np.concatenate([ghost, next_key[away]]),
            np.concatenate([network.ghost_owner, network.partition.owner(there[away])]),
        )
        self.of_network_node = self.find(end_key)
        self.of_hinge = self.find(hinge_key)
        self.after_hinge = np.where(joined, self.find(next_key), np.int32(-1))
