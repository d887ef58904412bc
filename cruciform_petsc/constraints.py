# SPDX-License-Identifier: MIT
"""Clamps, prescribed motion and loads on the edges of a network, by name.

Unknowns of a node are its displacement along warp and weft and, with yarn bending, its rotation
times a length. Where an edge prescribes motion along one direction only, the node's displacement is
kept in the frame (that direction, across it) instead, so that every prescribed quantity is one
unknown and the matrix stays symmetric.
"""

from __future__ import annotations

import numpy as np

from .errors import InputError
from .lattice import SHORTEST_ARM
from .network import Network


class Constraints:
    """What is known about the nodes of a network before it is solved.

    Parameters
    ----------
    network : Network
    bending : bool
        Whether nodes carry yarn rotations.

    Attributes
    ----------
    fixed : bool (n_local, d)
        Prescribed unknowns; d = 3 with bending, else 2.
    value : float (n_local, d)
        Their values in m.
    frame : float (n_local, 2, 2)
        Rows: the node's displacement axes in the yarn frame.
    held : bool (n_local,)
        Clamped: both displacements and the yarn's direction are prescribed.
    held_arm : bool (n_local, 4)
        Directions (arms 1 to 4) in which a yarn leaves the preform through a clamp at this node.
    tied : bool (n_local,)
        The first displacement is one common unknown of all tied nodes.
    force : float (n_local, 2)
        Loads in the yarn frame, N; complete on every rank that has the node.
    """

    def __init__(self, network: Network, bending: bool):
        n, d = network.num_nodes_local, 3 if bending else 2
        self.network, self.bending = network, bending
        self.fixed = np.zeros((n, d), bool)
        self.value = np.zeros((n, d))
        self.frame = np.tile(np.eye(2), (n, 1, 1))
        self.held = np.zeros(n, bool)
        self.held_arm = np.zeros((n, 4), bool)
        self.tied = np.zeros(n, bool)
        self.force = np.zeros((n, 2))

    def nodes_on(self, edge: str) -> np.ndarray:
        """Local nodes that lie on an edge; int array. Collective.

        Raises InputError if the preform has no such edge or no yarn reaches it.
        """
        network = self.network
        segments = network.preform.edge(edge)
        candidates = np.flatnonzero(network.node_is_boundary)
        distance = _distance_to_segments(network.node_position[candidates], segments)
        on = np.zeros(network.num_nodes_local, bool)
        on[candidates[distance <= self._tolerance]] = True
        network.exchange.forward(on)
        found = network.comm.allreduce(int(on[: network.num_nodes_owned].sum()))
        if found == 0:
            raise InputError(f"no yarn reaches the edge '{edge}': choose a finer pitch (refine)")
        return np.flatnonzero(on)

    @property
    def _tolerance(self) -> float:
        """How far a node may be from an edge that it lies on, m."""
        return SHORTEST_ARM * float(self.network.pitch.max())

    def clamp(self, edge: str, displacement=(0.0, 0.0)) -> np.ndarray:
        """Hold an edge: yarns keep their direction; it may move by (x, y) metres. Collective.

        Returns the local nodes.
        """
        nodes = self.nodes_on(edge)
        self.fixed[nodes] = True
        self.value[nodes, :2] = self.network.preform.rotation @ np.asarray(displacement, float)
        self._hold(edge, nodes)
        return nodes

    def _hold(self, edge: str, nodes: np.ndarray) -> None:
        """Note which nodes are clamped and which of their yarns leave through the clamp."""
        self.held[nodes] = True
        arms = self.network.arm_directions @ self.network.preform.rotation
        for segment in self.network.preform.edge(edge):
            tangent = (segment[1] - segment[0]) / np.hypot(*(segment[1] - segment[0]))
            leaves = arms @ np.array([tangent[1], -tangent[0]]) > 1e-6  # along the outward normal
            distance = _distance_to_segments(self.network.node_position[nodes], segment[None])
            self.held_arm[nodes[distance <= self._tolerance]] |= leaves
        self.network.exchange.forward(self.held_arm)

    def guide(self, edge: str, direction, displacement: float) -> np.ndarray:
        """Move an edge along a direction (x, y) by metres, free across it. Collective.

        Nodes that are clamped already stay so. Returns the local nodes.
        """
        nodes = self._turn(edge, direction)
        self.fixed[nodes, 0] = True
        self.value[nodes, 0] = displacement
        return nodes

    def tie(self, edge: str, direction, gripped: bool) -> np.ndarray:
        """Let an edge move along a direction as one, by an unknown amount. Collective.

        Across it the edge is free, or with ``gripped`` held like a clamp. Returns the local nodes.
        """
        nodes = self._turn(edge, direction)
        self.tied[nodes] = True
        if gripped:
            self.fixed[nodes, 1:] = True
            self._hold(edge, nodes)
        return nodes

    def _turn(self, edge: str, direction) -> np.ndarray:
        nodes = self.nodes_on(edge)
        nodes = nodes[~self.held[nodes]]
        along = self.network.preform.rotation @ np.asarray(direction, float)
        along = along / np.hypot(*along)
        self.frame[nodes] = [[along[0], along[1]], [-along[1], along[0]]]
        return nodes

    def pin(self, node_key: int, components: tuple[int, ...]) -> None:
        """Fix single displacement components (0 along warp, 1 along weft) of the node with a key.

        For bodies under loads alone: three of them take away the rigid motions.
        """
        here = np.flatnonzero(self.network.node_key == node_key)
        for component in components:
            self.fixed[here, component] = True

    def line_load(self, edge: str, traction) -> None:
        """Put a force per length (x, y), N/m, on a straight or broken edge. Collective.

        The share (normal . yarn direction)^2 of the traction goes to the ends of the warp yarns,
        the rest to the weft's: then a uniform stress loads each yarn end with just its own force.
        Within a family each end takes the edge up to halfway to its neighbours, as its quadrants
        do; what that changes of the load's moment is leaned back in (which takes two ends).
        """
        network = self.network
        nodes = self.nodes_on(edge)
        owned = nodes[nodes < network.num_nodes_owned]
        traction = network.preform.rotation @ np.asarray(traction, float)
        family = network.node_family[owned]
        hinge = network.node_is_hinge[owned]
        for segment in network.preform.edge(edge):
            length = np.hypot(*(segment[1] - segment[0]))
            tangent = (segment[1] - segment[0]) / length
            normal = network.preform.rotation @ np.array([tangent[1], -tangent[0]])
            where = (network.node_position[owned] - segment[0]) @ tangent
            near = (
                _distance_to_segments(network.node_position[owned], segment[None])
                <= self._tolerance
            )
            counts = []
            for f in (0, 1):
                # A hinge on the edge is an end of both families.
                mine = np.flatnonzero(near & ((family == f) | hinge) & (abs(normal[f]) > 1e-9))
                counts.append((mine, network.comm.allgather(where[mine])))
            share = normal**2
            empty = [sum(len(part) for part in parts) == 0 for _, parts in counts]
            if all(empty):
                raise InputError(f"no yarn ends on a part of the edge '{edge}' that carries a load")
            share = np.where(empty, 0.0, share)
            share = share / share.sum()
            where_all = [np.concatenate(parts) for _, parts in counts]
            lengths = [
                weight * _lumped_lengths(x, length)
                for x, weight in zip(where_all, share, strict=True)
            ]
            _keep_moment(lengths, where_all, length)
            for (mine, parts), lumped in zip(counts, lengths, strict=True):
                before = sum(len(part) for part in parts[: network.comm.rank])
                self.force[owned[mine]] += lumped[before : before + len(mine), None] * traction
        network.exchange.forward(self.force)


def _distance_to_segments(points: np.ndarray, segments: np.ndarray) -> np.ndarray:
    """Distance of each point (n, 2) to the nearest of some segments (m, 2, 2); (n,)."""
    nearest = np.full(len(points), np.inf)
    for begin, end in segments:  # an edge has few segments, nodes are many
        along = end - begin
        share = np.clip((points - begin) @ along / (along @ along), 0.0, 1.0)
        gap = points - begin - share[:, None] * along
        nearest = np.minimum(nearest, np.hypot(gap[:, 0], gap[:, 1]))
    return nearest


def _lumped_lengths(where: np.ndarray, length: float) -> np.ndarray:
    """Share of a line [0, length] that each of the points ``where`` stands for: up to halfway to
    its neighbours, the outer ones up to the ends of the line. Points that coincide share.
    """
    if len(where) == 0:
        return np.zeros(0)
    point, inverse, count = np.unique(
        np.round(where / length, 9), return_inverse=True, return_counts=True
    )
    border = np.concatenate([[0.0], 0.5 * (point[1:] + point[:-1]), [1.0]])
    return (length * np.diff(border) / count)[inverse]


def _keep_moment(lengths: list[np.ndarray], where: list[np.ndarray], length: float) -> None:
    """Lean the lengths of the family with the widest spread until all keep the load's moment.

    In place; an edge with a single yarn end stays as it is.
    """
    excess = sum(lump @ x for lump, x in zip(lengths, where, strict=True)) - 0.5 * length**2
    lever = [x - x.mean() if len(x) else x for x in where]
    widest = max(range(len(lever)), key=lambda f: lever[f] @ lever[f])
    spread = lever[widest] @ lever[widest]
    if spread > (1e-9 * length) ** 2:
        lengths[widest] -= excess / spread * lever[widest]
