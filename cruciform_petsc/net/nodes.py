# SPDX-License-Identifier: MIT
"""Arm ends and hinges of a network as one distributed set of nodes."""

from __future__ import annotations

import numpy as np

from ..parallel import DistributedNodes, send_by_rank
from .lattice import ARM_STEP, pack_key
from .network import Network

# Steps to the eight crossovers around one.
AROUND = np.array([(i, j) for i in (-1, 0, 1) for j in (-1, 0, 1) if i or j])


class Nodes(DistributedNodes):
    """Arm ends and hinges of a network as one distributed set of nodes. Collective.

    Owned nodes are numbered by yarn, the hinges along the warp yarns between their arm ends.

    Parameters
    ----------
    dim : int
        In space (3) the ends of yarns that cross at next hinges are known, on other ranks too.
    around : bool
        The hinges of all eight crossovers around this rank's are known.
    slides : bool
        Whether crossovers have a second node each, which lies there at rest and is no place: its
        components along warp and weft are how far these yarns have slid through the hinge.
    near : int (m, 2), optional
        Crossovers, on any rank, whose nodes this one needs, too.

    Attributes
    ----------
    of_network_node : int (n network nodes,)
        This set's local number of each local node of the network.
    of_hinge : int (n_owned crossovers,)
    after_hinge : int (n_owned crossovers, 2)
        Hinge of the next crossover along the warp and along the weft yarn; -1 where none is joined.
    of_slide : int (n_owned crossovers,)
        With ``slides``: the second nodes.
    beside_slide : int (n_owned crossovers, 4)
        With ``slides``: those of the crossovers that arms 1 to 4 are joined to, else -1.
    crossing : int (2, n_local, 2)
        At hinges: the ends of the yarn that crosses the warp, and the weft, there, in its
        direction; -1 at other nodes. Next hinges that are ghosts have them in space only. Where
        that yarn has no arm, the two are one node; or in space those of the crossover beside it.
    edge_cells : int (m, 8)
        In space: what is left of cells between four crossovers that the outline cuts, as polygons
        through arm ends and hinges, anticlockwise, -1 behind the last; each on one rank.
    rest : float (n_local, dim)
        Positions at rest, lab frame, m; z = 0.
    frame : float (n_local, dim, dim)
        Rows: axes of a node's unknowns, along warp and weft at rest (and z). Edges may turn them.
    """

    def __init__(
        self,
        network: Network,
        dim: int = 2,
        around: bool = False,
        slides: bool = False,
        near: np.ndarray | None = None,
    ):
        ij = network.crossover_ij.astype(np.int64)
        hinge_key = pack_key(0, ij[:, 1], 4 * ij[:, 0])
        joined = network.arm_is_shared[:, :2]
        there = ij[:, None] + ARM_STEP[:2]
        next_key = pack_key(0, there[..., 1], 4 * there[..., 0])
        away = joined & ~network.partition.in_box(there, network.comm.rank)
        owned_key, end_ghost = np.split(network.node_key, [network.num_nodes_owned])
        owned_key = np.union1d(owned_key, hinge_key)
        ghost_key = np.concatenate([end_ghost, next_key[away]])
        ghost_owner = np.concatenate([network.ghost_owner, network.partition.owner(there[away])])
        slide_key, beside_key = hinge_key[:0], np.zeros((0, 4), np.int64)
        if slides:
            # The crossovers as places on their weft yarns; hinges are those on the warp yarns.
            beside = ij[:, None] + ARM_STEP
            slide_key = pack_key(1, ij[:, 0], 4 * ij[:, 1])
            beside_key = pack_key(1, beside[..., 0], 4 * beside[..., 1])
            away = network.arm_is_shared & ~network.partition.in_box(beside, network.comm.rank)
            owned_key = np.union1d(owned_key, slide_key)
            ghost_key = np.concatenate([ghost_key, beside_key[away]])
            ghost_owner = np.concatenate([ghost_owner, network.partition.owner(beside[away])])
        super().__init__(network.comm, owned_key, ghost_key, ghost_owner)
        if near is not None:
            key, owner = network.ends_at(near)
            hinge = pack_key(0, near[:, 1].astype(np.int64), 4 * near[:, 0].astype(np.int64))
            ours = network.partition.owner(near)
            key, owner = np.append(key, hinge), np.append(owner, ours)
            away = owner != network.comm.rank
            ghost_key = np.concatenate([ghost_key, key[away]])
            ghost_owner = np.concatenate([ghost_owner, owner[away]])
            super().__init__(network.comm, owned_key, ghost_key, ghost_owner)
        ends = network.node_key[network.arm_node[:, [[3, 1], [2, 0]]]]
        cells = np.zeros((0, 8), np.int64)
        if dim == 3:
            more = self._crossing_elsewhere(network, hinge_key, next_key, joined, ends)
            cells, of_cells = _cells_cut(network)
            more = np.concatenate([more, of_cells])
            ghost_key = np.concatenate([ghost_key, more[:, 0]])
            ghost_owner = np.concatenate([ghost_owner, more[:, 1]])
            super().__init__(network.comm, owned_key, ghost_key, ghost_owner)
        if around:
            more_ij = (ij[:, None] + AROUND).reshape(-1, 2)
            more_ij = more_ij[~network.partition.in_box(more_ij, network.comm.rank)]
            more_ij = more_ij[network.has_crossover(more_ij)]
            ghost_key = np.concatenate([ghost_key, pack_key(0, more_ij[:, 1], 4 * more_ij[:, 0])])
            ghost_owner = np.concatenate([ghost_owner, network.partition.owner(more_ij)])
            super().__init__(network.comm, owned_key, ghost_key, ghost_owner)
        self.of_network_node = self.find(network.node_key)
        self.of_hinge = self.find(hinge_key)
        self.after_hinge = np.where(joined, self.find(next_key), np.int32(-1))
        self.of_slide = self.find(slide_key)
        joined = network.arm_is_shared[: len(beside_key)]
        self.beside_slide = np.where(joined, self.find(beside_key), np.int32(-1))
        crossing = np.full((self.num_nodes_local, 2, 2), np.int64(-1))
        crossing[self.of_hinge] = ends
        if dim == 3:
            self.halo.forward(crossing)
        found = self.find(crossing)
        self.edge_cells = np.where(cells >= 0, self.find(cells), np.int32(-1))
        self.crossing = np.where(crossing >= 0, found, -1).swapaxes(0, 1)
        self.rest = np.zeros((self.num_nodes_local, dim))
        self.rest[self.of_network_node, :2] = network.node_position
        self.rest[self.of_hinge, :2] = network.crossover_position
        self.rest[self.of_slide, :2] = network.crossover_position[: len(self.of_slide)]
        self.halo.forward(self.rest)
        self.frame = np.tile(np.eye(dim), (self.num_nodes_local, 1, 1))
        self.frame[:, :2, :2] = network.to_lab(np.eye(2))

    def find_hinges(self, ij: np.ndarray) -> np.ndarray:
        """Local nodes of the crossovers at lattice points (n, 2); -1 where unknown here."""
        return self.find(pack_key(0, ij[:, 1], 4 * ij[:, 0]))

    def _crossing_elsewhere(self, network, hinge_key, next_key, joined, ends) -> np.ndarray:
        """Keys and owners (m, 2) of other ranks' arm ends that cross at next hinges. Collective.

        Owners of hinges know what crosses there, and whose it is. Where the crossing yarn has no
        arm (the tip of a corner), what crosses next to it along the yarn stands for it in ``ends``.
        """
        owner = np.full(network.num_nodes_local, network.comm.rank, np.int64)
        owner[network.num_nodes_owned :] = network.ghost_owner
        known = np.full((self.num_nodes_local, 2, 2, 2), np.int64(-1))
        hinge, after = self.find(hinge_key), self.find(next_key)
        known[hinge] = np.stack([ends, owner[network.arm_node[:, [[3, 1], [2, 0]]]]], axis=-1)
        self.halo.forward(known)
        beside = np.full_like(known, -1)
        for family in (0, 1):
            rows = np.flatnonzero(joined[:, family])
            beside[after[rows, family], family] = known[hinge[rows], family]
        self.halo.reverse(beside, np.maximum)
        for family in (0, 1):
            lacking = np.flatnonzero(ends[:, family, 0] == ends[:, family, 1])
            before = beside[hinge[lacking], family]
            at = np.where(joined[lacking, family], after[lacking, family], hinge[lacking])
            found = np.where(before[:, :1, :1] >= 0, before, known[at, family])
            known[hinge[lacking], family] = found
            ends[lacking, family] = found[..., 0]
        needed = self.halo.forward(known).reshape(-1, 2)
        return needed[(needed[:, 0] >= 0) & (needed[:, 1] != network.comm.rank)]


# Around a cell: its crossovers' steps from the first, and the arms that lead in and out of each.
_AROUND = ((0, 0, 1, 0), (1, 0, 2, 1), (1, 1, 3, 2), (0, 1, 0, 3))


def _cells_cut(network: Network) -> tuple[np.ndarray, np.ndarray]:
    """Polygons (m, 8) of cut cells, as keys of nodes; other ranks' keys and owners. Collective.

    Each crossover sends the ends of its two arms on a cell to the rank whose the cell's first
    lattice point is. Between them the polygons go straight.
    """
    comm, edge = network.comm, network.boundary_crossovers
    owner = np.full(network.num_nodes_local, comm.rank, np.int64)
    owner[network.num_nodes_owned :] = network.ghost_owner
    records = []
    for number, (i, j, *arms) in enumerate(_AROUND):
        corner = network.crossover_ij[edge].astype(np.int64) - [i, j]
        whole = np.ones(len(edge), bool)
        for step, arm in (((0, 0), 0), ((0, 0), 1), ((1, 0), 1), ((0, 1), 0)):
            whole &= network.has_arm(corner + step, arm)
        nodes = network.arm_node[edge][:, arms]
        row = [corner, np.full((len(edge), 1), number), network.node_key[nodes], owner[nodes]]
        records.append(np.concatenate(row, axis=1)[~whole])
    record = np.concatenate(records)
    (record,) = send_by_rank(comm, network.partition.owner(record[:, :2]), record)
    record = record[np.lexsort(record[:, 2::-1].T)]
    _, first, cell = np.unique(record[:, :2], axis=0, return_index=True, return_inverse=True)
    key = record[:, 3:5].ravel()
    cell = np.repeat(cell.ravel(), 2)
    begin = 2 * first[cell]
    before = np.where(np.arange(len(key)) == begin, 0, np.arange(len(key)) - 1)
    last = np.append(begin[1:] == np.arange(1, len(key)), True) if len(key) else np.zeros(0, bool)
    new = key != np.where(np.arange(len(key)) == begin, -1, key[before])
    new &= ~(last & (key == key[begin]) & (np.arange(len(key)) > begin))
    place = np.cumsum(new) - 1
    place -= place[begin]
    cells = np.full((len(first), 8), np.int64(-1))
    cells[cell[new], place[new]] = key[new]
    ghosts = np.stack([key, record[:, 5:].ravel()], axis=1)
    return cells, ghosts[ghosts[:, 1] != comm.rank]
