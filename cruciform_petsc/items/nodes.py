# SPDX-License-Identifier: MIT
"""The nodes of a ply: where they lie at rest, what holds them, how those that carry nothing go."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import shapely

from ..laws import Potential, linear
from ..net.edges import Constraints
from ..net.lattice import QUADRANTS
from ..net.nodes import Nodes
from ..net.supports import Supports, find_supports, pass_on_loads
from ..parallel import most
from .item import Placed


@dataclass(frozen=True)
class Slip:
    """How yarns slide through crossovers, see items.slip.

    Attributes
    ----------
    force : float
        At which a yarn slides across one crossing yarn, N.
    coefficient : float
        Share of the mean tension of both yarns there that adds to it.
    families : tuple of bool
        Whether warp and weft slide.
    region : shapely.Polygon, optional
        At which crossovers, by where they are at rest, m; by default at all.
    elastic : float, optional
        Up to which friction gives like a spring, m; by default a thousandth of the pitch.
    closest : float
        How close crossing yarns come to each other, as a share of the pitch.
    """

    force: float
    coefficient: float = 0.0
    families: tuple[bool, bool] = (True, True)
    region: shapely.Polygon | None = None
    elastic: float | None = None
    closest: float = 0.2


class PlyNodes:
    """Nodes of a constrained network at finite deformation, in the plane or in space. Collective.

    Parameters
    ----------
    constraints : Constraints
        Edges as they are clamped, guided and loaded.
    out_of_plane : pair of float or Potential, optional
        Rigidity of warp and weft for bending out of the plane, per width, N m; or the moment per
        width over the curvature. The ply lies in space then, its rest in the plane z = 0.
    flat : bool
        In space: hold z of all nodes, not only on clamps and guides.
    prestretch : pair of float
        Length of warp and weft yarns as the network is drawn over that without tension.
    slip : Slip, optional
        Yarns slide through crossovers, which have a second node each (Nodes).
    near : int (m, 2), optional
        Crossovers whose nodes this rank needs besides, see Nodes.

    Attributes
    ----------
    nodes : Nodes
        Arm ends and hinges; where an edge is guided their frames are along the guide and across.
    supports : Supports
    active : bool (n_local,)
        Nodes that carry something.
    fixed : bool (n_local, dim)
        Unknowns that edges prescribe.
    clamped : int (c,)
        Local nodes of the network on edges that prescribe something.
    gripped : bool (network nodes,)
        Where something holds or pulls the yarn that ends there.
    """

    def __init__(
        self,
        constraints: Constraints,
        out_of_plane: tuple[float | Potential, float | Potential] | None = None,
        flat: bool = True,
        prestretch: tuple[float, float] = (1.0, 1.0),
        slip: Slip | None = None,
        near: np.ndarray | None = None,
    ):
        self.slip = slip
        self.constraints, self.network = constraints, constraints.network
        self.prestretch = prestretch
        self.bending, self.comm = constraints.bending, constraints.network.comm
        self.dim = 2 if out_of_plane is None else 3
        self.out_of_plane = [
            law if isinstance(law, Potential) else linear(law) for law in out_of_plane or (0.0, 0.0)
        ]
        self.supports: Supports = find_supports(constraints)
        self.near = near
        self.nodes = self._nodes()
        self.arm_directions = self._in_space(self.network.to_lab(self.network.arm_directions))
        self._place_nodes(flat)
        self._name_crossovers()

    def _nodes(self) -> Nodes:
        return Nodes(self.network, self.dim, slides=self.slip is not None, near=self.near)

    def _in_space(self, vectors: np.ndarray) -> np.ndarray:
        """Vectors (..., 2) in the plane z = 0, if the ply lies in space; (..., dim)."""
        wide = np.zeros((*vectors.shape[:-1], self.dim))
        wide[..., :2] = vectors
        return wide

    def _place_nodes(self, flat: bool) -> None:
        network, nodes, constraints = self.network, self.nodes, self.constraints
        n, dim = nodes.num_nodes_local, self.dim
        nodes.frame[nodes.of_network_node, :2, :2] = network.to_lab(constraints.frame)
        nodes.halo.forward(nodes.frame)
        active = np.zeros(n, bool)
        active[nodes.of_hinge[self.supports.carrying]] = True
        active[nodes.of_network_node] |= self.supports.active[:, :2].any(axis=1)
        slides = self._slides()
        active[nodes.of_slide] = slides.any(axis=1)
        nodes.halo.reverse(active, np.logical_or)
        self.active = nodes.halo.forward(active)
        self.fixed = np.zeros((n, dim), bool)
        self.fixed[nodes.of_network_node, :2] = constraints.fixed[:, :2]
        if dim == 3:
            self.fixed[:, 2] = flat
            self.fixed[nodes.of_network_node, 2] |= constraints.fixed_z
            self.fixed[nodes.of_slide, 2] = True
        self.fixed[nodes.of_slide, :2] = ~slides
        nodes.halo.forward(self.fixed)
        self.clamped = np.flatnonzero(constraints.fixed[:, :2].any(axis=1))
        self.clamp_of = np.full(network.num_nodes_local, -1)
        self.clamp_of[self.clamped] = np.arange(len(self.clamped))

    def _slides(self) -> np.ndarray:
        """Whether warp and weft slide through this rank's crossovers, bool (n_owned or 0, 2).

        Not where a yarn ends on an edge that holds it, nor in a clamp.
        """
        network, constraints, slip = self.network, self.constraints, self.slip
        prescribed = constraints.fixed[:, :2].any(axis=1) | constraints.tied
        self.gripped = prescribed | (constraints.force != 0.0).any(axis=1)
        if slip is None:
            return np.zeros((0, 2), bool)
        missing = network.arm_length == 0
        ends = missing & self.gripped[network.arm_node]
        held = ends[:, :2] | ends[:, 2:]
        held |= (missing & constraints.held[network.arm_node]).any(axis=1)[:, None]
        slides = self.supports.carrying[:, None] & ~held & np.array(slip.families)
        if slip.region is not None:
            inside = shapely.contains_xy(slip.region, *network.crossover_position.T)
            slides &= inside[:, None]
        return slides

    def _name_crossovers(self) -> None:
        """Tables over local nodes: which hinges carry, and whose they are."""
        network, nodes, hinge = self.network, self.nodes, self.nodes.of_hinge
        self.carries = np.zeros(nodes.num_nodes_local, bool)
        self.carries[hinge[self.supports.carrying]] = True
        nodes.halo.forward(self.carries)
        self.crossover_of = np.full(nodes.num_nodes_local, -1)
        self.crossover_of[hinge] = np.arange(network.num_crossovers_owned)

    # -- what is prescribed ---------------------------------------------------------------------

    def prescribed(self, motions: list) -> tuple[np.ndarray, np.ndarray]:
        """Places and turns under motions of edges. Collective.

        Parameters
        ----------
        motions : list of (network nodes (m,), gradient (2, 2), shift (2,))
            Affine motions X -> gradient X + shift of edges in x, y; of the unknowns there, the
            prescribed ones follow. Where edges meet the last one counts.

        Returns
        -------
        place : float (n_local, dim)
            Lab frame, m; unknowns that are not prescribed stay at rest.
        turn : float (clamped, dim, dim)
        """
        nodes = self.nodes
        place = nodes.rest.copy()
        turn = np.tile(np.eye(self.dim), (len(self.clamped), 1, 1))
        for network_nodes, gradient, shift in motions:
            at = nodes.of_network_node[network_nodes]
            target = place[at]
            target[:, :2] = nodes.rest[at, :2] @ gradient.T + shift
            gap = np.einsum("nij,nj->ni", nodes.frame[at], target - place[at])
            gap[~self.fixed[at]] = 0.0
            place[at] += np.einsum("nji,nj->ni", nodes.frame[at], gap)
            turn[self.clamp_of[network_nodes], :2, :2] = gradient
        return nodes.halo.forward(place), turn  # hinges on a clamp may be ghosts elsewhere

    def areas(self, at_hinge: float = 0.0) -> np.ndarray:
        """Area of cloth at rest that each node stands for, (n_local,), m^2. Collective.

        Each quadrant is shared out: ``at_hinge`` of it, and half of the rest to either arm's end
        (with 0, as each quadrant's centre has it); the sum is the outline's area.
        """
        network, nodes, carrying = self.network, self.nodes, self.supports.carrying
        share = at_hinge * carrying[:, None]
        area = np.zeros((network.num_nodes_local, 1))
        for arms in QUADRANTS.T:
            at = network.arm_node[:, arms]
            np.add.at(area[:, 0], at, 0.5 * (1.0 - share) * network.quadrant_area)
        area = pass_on_loads(self.constraints, self.supports, network.halo.share(area))
        whole = np.zeros(nodes.num_nodes_local)
        whole[nodes.of_hinge] = (share * network.quadrant_area).sum(axis=1)
        whole[nodes.of_network_node] += area[:, 0]
        return nodes.halo.forward(whole)

    # -- results --------------------------------------------------------------------------------

    def displacement(self, state: Placed) -> tuple[np.ndarray, np.ndarray]:
        """Displacements (., dim) of this rank's crossovers and of the network's nodes. Collective.

        Crossovers that carry nothing, and their arm ends, follow straight what they hang on.
        """
        moved = self._follow(state.x) - self.nodes.rest
        return moved[self.nodes.of_hinge], moved[self.nodes.of_network_node]

    def _follow(self, x: np.ndarray) -> np.ndarray:
        """Positions with crossovers that carry nothing moved like a rigid body. Collective."""
        network, supports, nodes = self.network, self.supports, self.nodes
        rounds = most(self.comm, supports.round_, 0)
        if rounds == 0:
            return x
        x = x.copy()
        ends = nodes.of_network_node[network.arm_node]
        known = self.active | self.fixed[:, :2].any(axis=1)
        done = supports.carrying.copy()
        for number in range(rounds, 0, -1):
            turn = np.zeros((nodes.num_nodes_local, 3))  # cosine, sine, count
            for arm in range(4):
                rows = np.flatnonzero(done & (network.arm_length[:, arm] > 0))
                t = unit((x[ends[rows, arm]] - x[nodes.of_hinge[rows]])[:, :2])
                t0 = self.arm_directions[arm, :2]
                np.add.at(turn[:, 0], ends[rows, arm], t @ t0)
                np.add.at(turn[:, 1], ends[rows, arm], t0[0] * t[:, 1] - t0[1] * t[:, 0])
                np.add.at(turn[:, 2], ends[rows, arm], 1.0)
            nodes.halo.share(turn)
            placed = np.zeros((nodes.num_nodes_local, self.dim + 1))  # where, count
            for e in np.flatnonzero(supports.round_ == number):  # a handful, at sharp corners
                joints = ends[e][known[ends[e]]]
                if not len(joints):
                    continue  # a crossover joined to nothing
                joint = joints[0]
                c, s = (1.0, 0.0) if turn[joint, 2] == 0 else unit(turn[joint, :2])
                rigid = np.eye(self.dim)
                rigid[:2, :2] = [[c, -s], [s, c]]
                others = np.append(ends[e][ends[e] != joint], nodes.of_hinge[e])
                x[others] = x[joint] + (nodes.rest[others] - nodes.rest[joint]) @ rigid.T
                placed[others, :-1], placed[others, -1] = x[others], 1.0
            done |= supports.round_ == number
            nodes.halo.share(placed)
            new = placed[:, -1] > 0
            x[new] = placed[new, :-1] / placed[new, -1:]
            known = known | new
        return nodes.halo.forward(x)


def unit(vectors: np.ndarray) -> np.ndarray:
    """Vectors (..., dim) over their length."""
    return vectors / np.linalg.norm(vectors, axis=-1, keepdims=True)
