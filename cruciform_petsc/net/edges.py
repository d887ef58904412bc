# SPDX-License-Identifier: MIT
"""Clamps, prescribed motion and loads on the edges of a network, by name.

Unknowns of a node are its displacement along warp and weft and, with yarn bending, its rotation
times a length. Where an edge prescribes motion along one direction only, the node's displacement is
kept in the frame (that direction, across it) instead, so that every prescribed quantity is one
unknown and the matrix stays symmetric.
"""

from __future__ import annotations

import numpy as np
import shapely

from ..errors import InputError
from .lattice import SHORTEST_ARM
from .network import Network


class Constraints:
    """What is known about the nodes of a network before it is solved; with bending they rotate.

    One that ``floats`` needs no clamp: tools hold it.
    """

    def __init__(self, network: Network, bending: bool, floats: bool = False):
        n, d = network.num_nodes_local, 3 if bending else 2
        self.network, self.bending, self.floats = network, bending, floats
        self.fixed = np.zeros((n, d), bool)  # prescribed unknowns
        self.value = np.zeros((n, d))  # their values, m
        # Rows: a node's displacement axes in the yarn frame.
        self.frame = np.tile(np.eye(2), (n, 1, 1))
        # Clamped: both displacements and the yarn's direction are prescribed.
        self.held = np.zeros(n, bool)
        # Directions (arms 1 to 4) in which a yarn leaves the preform through a clamp at this node.
        self.held_arm = np.zeros((n, 4), bool)
        # Directions in which a yarn crosses a plane of symmetry at this node, at right angles.
        self.mirrored_arm = np.zeros((n, 4), bool)
        self.tied = np.zeros(n, bool)  # the first displacement is one common unknown of all
        self.guided = np.zeros(n, bool)  # the first displacement is prescribed, by a guide
        self.fixed_z = np.zeros(n, bool)  # in space: not to leave the plane
        # Loads in the yarn frame, N; complete on every rank that has the node.
        self.force = np.zeros((n, 2))

    def nodes_on(self, edge: str) -> np.ndarray:
        """Local nodes that lie on an edge; int array. Collective.

        Raises InputError if the preform has no such edge or no yarn reaches it.
        """
        network = self.network
        candidates = np.flatnonzero(network.node_is_boundary)
        on = np.zeros(network.num_nodes_local, bool)
        line = shapely.multilinestrings(network.preform.edge(edge))
        on[candidates] = self.near(candidates, line)
        network.halo.forward(on)
        if not network.comm.allreduce(int(on[: network.num_nodes_owned].sum())):
            raise InputError(f"no yarn reaches the edge '{edge}': choose a finer pitch (refine)")
        return np.flatnonzero(on)

    def near(self, nodes: np.ndarray, line: shapely.Geometry) -> np.ndarray:
        """Which nodes lie on a line, but for the shortest arm; bool (n,)."""
        points = shapely.points(self.network.node_position[nodes])
        return shapely.distance(line, points) <= SHORTEST_ARM * self.network.pitch.max()

    def clamp(self, edge: str, displacement=(0.0, 0.0)) -> np.ndarray:
        """Hold an edge: yarns keep their direction; it may move by (x, y) metres. Collective.

        Returns the local nodes.
        """
        nodes = self.nodes_on(edge)
        self.fixed[nodes] = self.fixed_z[nodes] = True
        self.frame[nodes] = np.eye(2)  # also where another edge had turned it
        self.tied[nodes] = False
        self.value[nodes, :2] = self.network.to_yarn(np.asarray(displacement, float))
        self._hold(edge, nodes)
        return nodes

    def _hold(self, edge: str, nodes: np.ndarray) -> None:
        """Note which nodes are clamped and which of their yarns leave through the clamp."""
        self.held[nodes] = True
        arms = self.network.to_lab(self.network.arm_directions)
        for segment in self.network.preform.edge(edge):
            tangent = (segment[1] - segment[0]) / np.hypot(*(segment[1] - segment[0]))
            leaves = arms @ np.array([tangent[1], -tangent[0]]) > 1e-6  # along the outward normal
            self.held_arm[nodes[self.near(nodes, shapely.linestrings(segment))]] |= leaves
        self.network.halo.forward(self.held_arm)

    def guide(self, edge: str, direction, displacement: float, in_plane=True) -> np.ndarray:
        """Move an edge along a direction (x, y) by metres, free across it. Collective.

        In space it leaves the plane only if not ``in_plane``. Nodes that are clamped already stay
        so; those that are guided along another direction, too, are held in both by the two
        displacements. Returns the local nodes.
        """
        nodes = self.nodes_on(edge)
        guided = np.intersect1d(nodes, np.flatnonzero(self.guided & ~self.held))
        before, moved = self.frame[guided, 0], self.value[guided, 0]
        nodes = self._turn(edge, direction)
        self.fixed[nodes, 0] = self.guided[nodes] = True
        self.fixed_z[nodes] |= in_plane
        self.value[nodes, 0] = displacement
        along, across = self.frame[guided, 0], self.frame[guided, 1]
        sine = (before * across).sum(axis=1)  # of the angle from this direction to that one
        other = abs(sine) > 1e-9
        both, sine = guided[other], sine[other]
        cosine = (before * along).sum(axis=1)[other]
        self.fixed[both, 1] = True
        self.value[both, 1] = (moved[other] - cosine * displacement) / sine
        return nodes

    def symmetry(self, edge: str) -> np.ndarray:
        """Make a straight edge lie in a plane of symmetry that stands on the cloth. Collective.

        Nodes slide in that plane, in space up and down, too; yarns that meet it at right angles at
        rest cross it at right angles always, as they go on as their own mirror images. (Yarns that
        meet it otherwise slide as if hinged there: right where the cloth's mirror image is the same
        cloth.) Where two planes meet, or a clamp, both hold. Returns the local nodes. Raises
        InputError if the edge is not straight.
        """
        ends = self.network.preform.edge(edge)
        tangent = ends[:, 1] - ends[:, 0]
        tangent /= np.hypot(*tangent.T)[:, None]
        normal = np.array([tangent[0, 1], -tangent[0, 0]])
        if abs((ends - ends[0, 0]) @ normal).max() > SHORTEST_ARM * self.network.pitch.max():
            raise InputError(f"the edge '{edge}' is not straight, so it cannot be a symmetry plane")
        nodes = self.guide(edge, normal, 0.0, in_plane=False)
        square = self.network.to_lab(self.network.arm_directions) @ normal > 1.0 - 1e-9
        self.mirrored_arm[nodes] |= square
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
        along = self.network.to_yarn(np.asarray(direction, float))
        along = along / np.hypot(*along)
        self.frame[nodes] = [[along[0], along[1]], [-along[1], along[0]]]
        return nodes

    def pin(self, node_key: int, components: tuple[int, ...]) -> None:
        """Fix single displacement components (0 along warp, 1 along weft) of the node with a key.

        For bodies under loads alone: three of them take away the rigid motions.
        """
        here = np.flatnonzero(self.network.node_key == node_key)
        self.fixed[here[:, None], np.array(components)] = True

    def line_load(self, edge: str, traction) -> None:
        """Put a force per length (x, y), N/m, on an edge, straight or not. Collective.

        Each yarn end carries its length of the edge (`lengths`); what that changes of the load's
        moment is leaned back in (which takes two ends).
        """
        traction = np.asarray(traction, float)
        length = self.lengths(edge, traction)[:, None]
        self.force += length * self.network.to_yarn(traction)
        self.network.halo.forward(self.force)

    def lengths(self, edge: str, traction=(0.0, 0.0)) -> np.ndarray:
        """Length of an edge [m] that each yarn end there stands for, (n_local,). Collective.

        The share (normal . yarn direction)^2 goes to the ends of the warp yarns, the rest to the
        weft's: then a uniform stress loads each yarn end with just its own force. Within a family
        each end takes the edge up to halfway to its neighbours, as its quadrants do, but for what
        keeps the moment of a traction (x, y). Of nodes that this rank owns, else 0.
        """
        network = self.network
        traction = np.asarray(traction, float)
        nodes = self.nodes_on(edge)
        owned = nodes[nodes < network.num_nodes_owned]
        total = np.zeros(network.num_nodes_local)
        for chain in chains(network.preform.edge(edge)):
            line = shapely.linestrings(np.concatenate([chain[:1, 0], chain[:, 1]]))
            here = owned[self.near(owned, line)]
            position, is_hinge = network.node_position[here], network.node_is_hinge[here]
            # A hinge on the edge is an end of both families.
            ends = [is_hinge | (network.node_family[here] == family) for family in (0, 1)]
            along = shapely.line_locate_point(line, shapely.points(position))
            parts = network.comm.allgather(np.stack([along, _lever(position, traction), *ends]))
            begin = sum(part.shape[1] for part in parts[: network.comm.rank])
            along, lever, *ends = np.concatenate(parts, axis=1)
            ends = [part > 0 for part in ends]
            found = np.array([part.any() for part in ends])
            if not found.any():
                raise InputError(f"no yarn ends on a part of the edge '{edge}' that carries a load")
            piece = chain[:, 1] - chain[:, 0]
            length = np.hypot(piece[:, 0], piece[:, 1])
            normal = np.stack([piece[:, 1], -piece[:, 0]], axis=1) / length[:, None]
            share = np.where(found.all(), network.to_yarn(normal) ** 2, found).T
            knots = np.concatenate([[0.0], np.cumsum(length)])
            lumped = [lumped_lengths(along[ends[f]], knots, share[f]) for f in (0, 1)]
            moment = float(length @ _lever(chain.mean(axis=1), traction))
            keep_moment(lumped, [lever[part] for part in ends], moment)
            carried = np.zeros(len(along))
            for f in (0, 1):
                carried[ends[f]] += lumped[f]
            total[here] += carried[begin : begin + len(here)]
        return total

    def outwards(self, edge: str, nodes: np.ndarray) -> np.ndarray:
        """Unit normals (n, 2) of an edge, x and y, out of the cloth at some nodes on it."""
        segments = self.network.preform.edge(edge)
        points = shapely.points(self.network.node_position[nodes])
        distance = shapely.distance(points[:, None], shapely.linestrings(segments))
        along = (segments[:, 1] - segments[:, 0])[distance.argmin(axis=1)]
        return np.stack([along[:, 1], -along[:, 0]], axis=1) / np.hypot(*along.T)[:, None]


def chains(segments: np.ndarray) -> list[np.ndarray]:
    """Segments (n, 2, 2) of an edge, parted where one does not begin where the last one ends."""
    breaks = np.flatnonzero((segments[1:, 0] != segments[:-1, 1]).any(axis=1)) + 1
    return np.split(segments, breaks)


def _lever(points: np.ndarray, force: np.ndarray) -> np.ndarray:
    """Moments about the origin of one force acting at each of some points (n, 2); (n,)."""
    return points[:, 0] * force[1] - points[:, 1] * force[0]


def lumped_lengths(where: np.ndarray, knots: np.ndarray, share: np.ndarray) -> np.ndarray:
    """Part of a line that each of the points on it stands for, times a weight along the line.

    Points stand for the line up to halfway to their neighbours, the outer ones up to its ends;
    points that coincide share. ``where`` (n,) are their places along the line, ``knots`` (k + 1,)
    those where the weight changes, first and last its ends; ``share`` (k,) the weights between.
    """
    if len(where) == 0:
        return np.zeros(0)
    length = knots[-1]
    point, inverse, count = np.unique(
        np.round(where / length, 9), return_inverse=True, return_counts=True
    )
    border = length * np.concatenate([[0.0], 0.5 * (point[1:] + point[:-1]), [1.0]])
    weight = np.interp(border, knots, np.concatenate([[0.0], np.cumsum(share * np.diff(knots))]))
    return (np.diff(weight) / count)[inverse]


def keep_moment(lengths: list[np.ndarray], levers: list[np.ndarray], moment: float) -> None:
    """Lean the lengths of the family with the widest spread until all have a moment together.

    In place; an edge with a single yarn end, or a load along it, stays as it is. ``lengths`` of
    each family are what the yarn ends stand for, ``levers`` the moments of the traction there;
    ``moment`` is what the sum over all ends of length times lever is to be.
    """
    excess = sum(part @ lever for part, lever in zip(lengths, levers, strict=True)) - moment
    size = max(abs(lever).max(initial=0.0) for lever in levers)
    lean = [lever - lever.mean() if len(lever) else lever for lever in levers]
    widest = max((0, 1), key=lambda f: lean[f] @ lean[f])
    spread = lean[widest] @ lean[widest]
    if spread > (1e-9 * size) ** 2:
        lengths[widest] -= excess / spread * lean[widest]
