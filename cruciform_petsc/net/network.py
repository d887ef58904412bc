# SPDX-License-Identifier: MIT
"""The distributed network: crossovers, arm ends, who owns them and how they are numbered.

Every rank cuts the yarns of the whole lattice with the outline (cost: the outline's length), deals
the lattice out by recursive bisection, and then makes its own crossovers only. No rank ever holds
more of the network than its own part and the arm ends on its border.

*Nodes* are what displacement unknowns sit on: the arm ends (one between two neighbouring crossovers
of a yarn, one where a yarn meets the outline) and the hinges of crossovers that lie on the outline.
"""

from __future__ import annotations

import numpy as np
import shapely
from mpi4py import MPI

from ..cloth.fabric import Fabric
from ..cloth.preform import Preform
from ..errors import InputError
from ..memory import check_memory
from ..parallel import DistributedNodes, find_sorted
from .lattice import (
    ARM_STEP,
    BETWEEN,
    SHORTEST_ARM,
    TAIL,
    boundary_segments,
    cells_cut,
    pack_key,
    pair_key,
    quadrant_areas,
    snapped,
    yarn_lines,
)
from .partition import Partition

# Bytes while a network is made, as measured: of a crossover, on one rank (330), and of a crossing
# of the outline with a lattice line, on every rank.
_BYTES, _OUTLINE_BYTES = 330.0, 1000.0
# Lattice lines count from the outline's middle and must fit into keys (pack_key).
_FARTHEST = 2**23 - 4


class Network(DistributedNodes):
    """Net of crossovers and arm ends of a fabric inside an outline, dealt out over the ranks.

    Collective. Raises InputError on every rank if the outline holds no crossover.

    Attributes
    ----------
    origin : float (2,)
        Crossover (0, 0) of the lattice, x, y in metres: the preform's; one far from the outline
        is moved by whole pitches to its middle.
    crossover_ij : int32 (n_owned, 2)
        Lattice position of this rank's crossovers: i counts along the warp, j along the weft.
    crossover_number_global : int64 (n_owned,)
        Their numbers along the warp yarns, the same on any number of ranks.
    crossover_position : float (n_owned, 2)
        x, y in metres.
    arm_length : float (n_owned, 4)
        Metres, arms 1 to 4; 0 where the crossover lies on the outline.
    quadrant_area : float (n_owned, 4)
        Square metres inside the outline, order of lattice.QUADRANTS.
    arm_node : int32 (n_owned, 4)
        Local node at the end of each arm; the hinge's own node where the arm has no length.
    arm_is_shared : bool (n_owned, 4)
        Whether the arm end joins two crossovers.
    boundary_crossovers : int32
        Owned crossovers that differ from the regular cruciform (cut arms or quadrants).
    node_position : float (n_local, 2)
    node_is_boundary : bool (n_local,)
        Ends on the outline, or lies close to it.
    """

    def __init__(self, comm: MPI.Intracomm, preform: Preform, fabric: Fabric):
        self.comm, self.preform, self.fabric = comm, preform, fabric
        self.pitch = np.array(preform.pitch(fabric))
        preform.check_size(fabric)
        self.origin = preform.lattice_origin
        # Far away, numbers of yarns would be large and places rounded with them.
        if (abs(self.origin - preform.middle) > preform.size).any():
            pitches = np.round(self._to_lattice(preform.middle))
            self.origin = self.origin + self.to_lab(pitches * self.pitch)
        self._check_fits()
        outline = shapely.transform(preform.outline, lambda xy: snapped(self._to_lattice(xy)))
        segments = boundary_segments(outline)
        self.warp_yarns, self.weft_yarns = (yarn_lines(segments, family) for family in (0, 1))
        count = np.maximum(self.warp_yarns.last - self.warp_yarns.first + 1, 0)
        self.num_crossovers_global = int(count.sum())
        if self.num_crossovers_global == 0:
            raise InputError(
                "the outline holds no crossover of the lattice: make it larger, choose a finer "
                "pitch (refine) or move the lattice (origin)"
            )
        self._first_number = np.cumsum(count) - count
        self.partition = Partition(self.warp_yarns, comm.size)
        self._make_crossovers(segments, outline)
        self._make_nodes()

    def _check_fits(self) -> None:
        """Refuse in words, before anything is made, what has no room. Collective."""
        outline = self.preform.outline
        with np.errstate(over="ignore", divide="ignore"):
            crossovers = float(np.float64(outline.area) / self.pitch[0] / self.pitch[1])
            crossings = float(np.float64(outline.length) / self.pitch.min())
        check_memory(
            self.comm,
            _BYTES * crossovers + _OUTLINE_BYTES * crossings * self.comm.size,
            f"the outline holds about {crossovers:.3g} crossovers",
            "choose a coarser pitch (refine, yarns_per_cruciform) or a smaller outline",
        )
        corners = shapely.get_coordinates(outline.envelope)
        farthest = float(np.abs(self._to_lattice(corners)).max())
        if not farthest < _FARTHEST:
            raise InputError(
                f"the outline reaches {farthest:.3g} yarns from its middle, at most {_FARTHEST} "
                "can be counted: choose a coarser pitch (yarns_per_cruciform) or a smaller outline"
            )

    # -- geometry -------------------------------------------------------------------------------

    def _to_lattice(self, xy: np.ndarray) -> np.ndarray:
        return self.to_yarn(xy - self.origin) / self.pitch

    def to_yarn(self, vectors: np.ndarray) -> np.ndarray:
        """Components in x, y (..., 2) -> along warp and weft at rest."""
        return vectors @ self.preform.rotation.T

    def to_lab(self, vectors: np.ndarray) -> np.ndarray:
        """Components along warp and weft at rest (..., 2) -> in x, y."""
        return vectors @ self.preform.rotation

    def has_crossover(self, ij: np.ndarray) -> np.ndarray:
        """Whether lattice points (..., 2) are crossovers of the network, on whichever rank."""
        return self.warp_yarns.find(ij[..., 1], ij[..., 0]) >= 0

    def crossover_number(self, ij: np.ndarray) -> np.ndarray:
        """Global numbers of the crossovers at lattice points (..., 2), -1 where there is none."""
        part = self.warp_yarns.find(ij[..., 1], ij[..., 0])
        number = self._first_number[part] + ij[..., 0] - self.warp_yarns.first[part]
        return np.where(part >= 0, number, -1)

    def _make_crossovers(self, segments: np.ndarray, outline: shapely.Polygon) -> None:
        ij = self.partition.crossovers(self.warp_yarns, self.comm.rank)
        n = len(ij)
        self.crossover_ij = ij.astype(np.int32)
        self.crossover_position = self.to_lab(ij * self.pitch) + self.origin
        self.crossover_number_global = self.crossover_number(ij)
        around = np.indices((3, 3)).reshape(2, -1).T - 1
        near_i, near_j = (cells_cut(segments)[:, None] + around).reshape(-1, 2).T
        near_key = np.unique(pair_key(near_j, near_i))
        is_near = find_sorted(near_key, pair_key(ij[:, 1], ij[:, 0])) >= 0
        self.boundary_crossovers = np.flatnonzero(is_near).astype(np.int32)

        half = np.tile(0.5 * self.pitch, 2)
        self.arm_length = np.tile(half, (n, 1))
        self.quadrant_area = np.full((n, 4), 0.25 * self.pitch.prod())
        self.arm_is_shared = np.ones((n, 4), bool)
        edge = ij[is_near]
        length, shared = self.arms_at(edge)
        self.arm_length[is_near] = length * np.tile(self.pitch, 2)
        self.arm_is_shared[is_near] = shared
        area = quadrant_areas(edge, self.has_crossover, outline)
        self.quadrant_area[is_near] = area * self.pitch.prod()

    def arms_at(self, ij: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Arm lengths in pitches (n, 4), whether each ends at a next crossover; of any rank's."""
        length = np.zeros((len(ij), 4))
        shared = np.zeros((len(ij), 4), bool)
        for family, yarns in enumerate((self.warp_yarns, self.weft_yarns)):
            along, line = ij[:, family], ij[:, 1 - family]
            part = yarns.find(line, along)
            for arm, ends, sign in ((family, yarns.end, 1), (family + 2, yarns.start, -1)):
                step = ARM_STEP[arm]
                next_part = yarns.find(line, along + sign)
                shared[:, arm] = (part >= 0) & (next_part == part) & self.has_crossover(ij + step)
                tail = np.where(part >= 0, sign * (ends[part] - along), 0.0)
                tail = np.where(tail < SHORTEST_ARM, 0.0, tail)
                length[:, arm] = np.where(shared[:, arm], 0.5, tail)
        return length, shared

    def has_arm(self, ij: np.ndarray, arm: int) -> np.ndarray:
        """Whether arms of lattice points (n, 2) join two crossovers, on whichever rank; bool."""
        yarns, family = (self.warp_yarns, self.weft_yarns)[arm % 2], arm % 2
        there = ij + ARM_STEP[arm]
        parts = [yarns.find(at[:, 1 - family], at[:, family]) for at in (ij, there)]
        joined = (parts[0] >= 0) & (parts[0] == parts[1])
        return joined & self.has_crossover(ij) & self.has_crossover(there)

    # -- nodes ----------------------------------------------------------------------------------

    def ends_at(self, ij: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Keys of the ends of arms 1 to 4 of crossovers (n, 2), and their owners, (n, 4) each.

        On whichever rank; where an arm has no length, the hinge's.
        """
        return self._ends(ij.astype(np.int64), *self.arms_at(ij))

    def _ends(self, ij: np.ndarray, length: np.ndarray, shared: np.ndarray):
        i, j = ij.T
        warp, weft = pack_key(0, j, 4 * i), pack_key(1, i, 4 * j)  # the crossovers on their yarns
        keys = np.where(shared, BETWEEN, TAIL)
        keys += np.stack([warp, weft, warp, weft], axis=1)
        keys = np.where(length == 0, warp[:, None], keys)  # the hinge's
        own = self.partition.in_box(ij, self.comm.rank)
        owner = np.full(keys.shape, self.comm.rank, np.int32)
        owner[~own] = self.partition.owner(ij[~own])[:, None]
        for arm in (2, 3):  # an end shared by two crossovers belongs to the lower one
            behind = ij + ARM_STEP[arm]
            ask = shared[:, arm] & ~(own & self.partition.in_box(behind, self.comm.rank))
            owner[ask, arm] = self.partition.owner(behind[ask])
        return keys, owner

    def _make_nodes(self) -> None:
        ij = self.crossover_ij.astype(np.int64)
        keys, owner = self._ends(ij, self.arm_length, self.arm_is_shared)
        foreign = owner != self.comm.rank
        owned = np.unique(keys[~foreign])
        super().__init__(self.comm, owned, keys[foreign], owner[foreign])
        self.arm_node = self.find(keys)
        self.node_position = np.empty((self.num_nodes_local, 2))
        self.node_is_boundary = np.zeros(self.num_nodes_local, bool)
        self.node_is_boundary[self.arm_node[self.boundary_crossovers]] = True
        for arm, direction in enumerate(self.to_lab(ARM_STEP)):
            self.node_position[self.arm_node[:, arm]] = (
                self.crossover_position + self.arm_length[:, arm, None] * direction
            )
        self.halo.forward(self.node_position)
        self.halo.share(self.node_is_boundary, np.logical_or)

    @property
    def num_crossovers_owned(self) -> int:
        """Crossovers of this rank."""
        return len(self.crossover_ij)

    @property
    def node_family(self) -> np.ndarray:
        """0 for ends of warp yarns (and hinges), 1 for ends of weft yarns; (n_local,)."""
        return (self.node_key >> 62).astype(np.int8)

    @property
    def node_is_hinge(self) -> np.ndarray:
        """Nodes that are the hinge of a crossover on the outline; bool (n_local,)."""
        return (self.node_key & 3) == 0

    @property
    def arm_directions(self) -> np.ndarray:
        """Unit vectors of arms 1 to 4 in the yarn frame (components along warp, weft); (4, 2)."""
        return ARM_STEP.astype(float)

    def covered_area(self) -> float:
        """Area in square metres that all quadrants stand for. Collective."""
        return self.comm.allreduce(float(self.quadrant_area.sum()))

    def statistics(self) -> dict:
        """Sizes, load balance and cut yarns of the partition. Collective.

        ``imbalance`` is the largest rank's share of crossovers over the mean; a yarn is cut once
        wherever two neighbouring crossovers of it belong to different ranks.
        """
        counts = self.comm.allgather(self.num_crossovers_owned)
        ghosts = self.num_nodes_local - self.num_nodes_owned
        single = int((self.arm_is_shared.sum(axis=1) == 1).sum())
        return {
            "crossovers": self.num_crossovers_global,
            "nodes": self.num_nodes_global,
            "warp_yarns": len(np.unique(self.warp_yarns.line)),
            "weft_yarns": len(np.unique(self.weft_yarns.line)),
            "covered_area_m2": self.covered_area(),
            "outline_area_m2": float(self.preform.outline.area),
            "crossovers_per_rank_min": min(counts),
            "crossovers_per_rank_max": max(counts),
            "imbalance": max(counts) * len(counts) / sum(counts),
            "cut_yarns": self.comm.allreduce(ghosts),
            "joined_by_one_arm": self.comm.allreduce(single),
        }

    def __repr__(self) -> str:
        return (
            f"Network({self.num_crossovers_global} crossovers, {self.num_nodes_global} nodes, "
            f"pitch {1e3 * self.pitch[0]:.4g} x {1e3 * self.pitch[1]:.4g} mm, "
            f"{self.comm.size} rank{'s' if self.comm.size > 1 else ''})"
        )
