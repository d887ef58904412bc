# SPDX-License-Identifier: MIT
"""Finite deformation of a constrained network: energy, force and stiffness on distributed nodes.

The nodes are the arm ends of a Network and the hinges of its crossovers, all of them (the small
displacements of assembly.py eliminate the hinges; here they stay). Their unknowns are positions in
the yarn frame at rest, along warp and weft; where an edge is guided, along the guide and across.
"""

from __future__ import annotations

from dataclasses import dataclass

import numba
import numpy as np
from mpi4py import MPI
from petsc4py import PETSc

from ..elements import cruciform as kernels
from ..elements.cruciform import ENERGY, FORCE, STIFFNESS, Cloth
from ..errors import InputError
from ..net.edges import Constraints
from ..net.lattice import HELD, OPPOSITE, QUADRANTS
from ..net.nodes import Nodes
from ..net.supports import Supports, find_supports, pass_on_loads
from ..solvers.pattern import BlockPattern

MODES = ("tension", "shear", "bending")
# Elements worked on at a time: their matrices stay in the processor's cache until they are added.
CHUNK = 2048


@dataclass
class _Cruciforms:
    """Carrying crossovers of a rank."""

    nodes: np.ndarray  # (m, 5) arm ends, hinge
    rows: np.ndarray  # (m,) owned crossovers
    arm_length: np.ndarray
    area: np.ndarray
    strain_source: np.ndarray
    turn_source: np.ndarray
    held_rows: np.ndarray  # elements with a held arm
    held_node: np.ndarray  # (len(held_rows), 4) network nodes at whose clamp an arm is held
    held: np.ndarray  # (m, 4, 2)


@dataclass
class _Turns:
    """Points at which yarns bend: before, at, after; at a clamp a direction stands for 'before'."""

    nodes: np.ndarray  # (m, 3); at a clamp the first two are one node
    length: np.ndarray
    rigidity: np.ndarray
    crossover: np.ndarray  # (m, 2) owned crossovers that the energy belongs to, half each, or -1
    offset: np.ndarray  # (m, 2) from the node 'before' to the point before; zero away from clamps
    clamp_node: np.ndarray  # (m,) network node of the clamp, or -1
    clamp_direction: np.ndarray  # (m, 2) direction of the held yarn at rest, towards the turn


class FiniteNetwork:
    """A constrained network at finite deformation. Collective.

    Parameters
    ----------
    constraints : Constraints
        Edges as they are clamped, guided and loaded; prescribed values are taken from `prescribe`.

    Attributes
    ----------
    nodes : Nodes
    rest : float (n_local, 2)
        Positions of the nodes at rest in the yarn frame, metres from the lattice's origin.
    free : bool (n_local, 2)
        Unknowns; the others are prescribed, or belong to nodes that carry nothing.
    frame : float (n_local, 2, 2)
        Rows: axes of a node's unknowns in the yarn frame.
    load : float (n_local, 2)
        Dead loads at full size, in the nodes' axes, newtons; ghosts filled.
    """

    dim = 2

    def __init__(self, constraints: Constraints):
        self.constraints, self.network = constraints, constraints.network
        self.bending = constraints.bending
        network = self.network
        self.comm = network.comm
        self.supports: Supports = find_supports(constraints)
        self.nodes = Nodes(network)
        self._place_nodes()
        self.cloth = cloth(network.fabric)
        self._make_cruciforms()
        self._make_turns()
        # How clamps have moved the directions they hold: gradient of the motion at network nodes.
        self._clamp_gradient = np.tile(np.eye(2), (network.num_nodes_local, 1, 1))
        self._make_pattern()
        unknowns = 2 * self.nodes.num_nodes_global
        if unknowns > np.iinfo(PETSc.IntType).max:
            raise InputError(f"{unknowns} unknowns need a PETSc with 64-bit indices")

    # -- set-up ---------------------------------------------------------------------------------

    def _place_nodes(self) -> None:
        network, nodes, constraints = self.network, self.nodes, self.constraints
        rotation, origin = network.preform.rotation, network.preform.lattice_origin
        self.rest = np.zeros((nodes.num_nodes_local, 2))
        self.rest[nodes.of_network_node] = (network.node_position - origin) @ rotation.T
        self.rest[nodes.of_hinge] = (network.crossover_position - origin) @ rotation.T
        nodes.halo.forward(self.rest)

        active = np.zeros(nodes.num_nodes_local, bool)
        active[nodes.of_hinge[self.supports.carrying]] = True
        active[nodes.of_network_node] |= self.supports.active[:, :2].any(axis=1)
        nodes.halo.reverse(active, np.logical_or)
        self.active = nodes.halo.forward(active)
        self.fixed = np.zeros((nodes.num_nodes_local, 2), bool)
        self.fixed[nodes.of_network_node] = constraints.fixed[:, :2]
        nodes.halo.forward(self.fixed)
        self.free = self.active[:, None] & ~self.fixed
        self.frame = np.tile(np.eye(2), (nodes.num_nodes_local, 1, 1))
        self.frame[nodes.of_network_node] = constraints.frame
        nodes.halo.forward(self.frame)
        self._turned = np.flatnonzero((self.frame != np.eye(2)).any(axis=(1, 2)))
        self.load = np.zeros((nodes.num_nodes_local, 2))
        self.load[nodes.of_network_node] = np.einsum(
            "nij,nj->ni", constraints.frame, pass_on_loads(constraints, self.supports)
        )
        nodes.halo.forward(self.load)
        self.load[~self.active] = 0.0

    def _make_cruciforms(self) -> None:
        network, supports = self.network, self.supports
        rows = np.flatnonzero(supports.carrying)
        n = network.num_crossovers_owned
        strain = np.tile(np.arange(4), (n, 1))
        turn = strain.copy()
        area = network.quadrant_area.copy()
        boundary = network.boundary_crossovers
        strain[boundary] = supports.strain_source
        turn[boundary] = supports.rotation_source
        area[boundary] = supports.quadrant_area
        is_held = (turn[rows] == HELD).any(axis=1)
        held_rows = np.flatnonzero(is_held)
        crossing = network.arm_node[rows[held_rows]]
        # A tail that follows a held arm takes its direction from that arm's clamp.
        other = crossing[:, OPPOSITE]
        missing = network.arm_length[rows[held_rows]] == 0
        self.cruciforms = _Cruciforms(
            np.column_stack([
                self.nodes.of_network_node[network.arm_node[rows]], self.nodes.of_hinge[rows]
            ]),
            rows, network.arm_length[rows], area[rows], strain[rows], turn[rows], held_rows,
            np.where(missing, crossing, other),
            np.tile(network.arm_directions, (len(rows), 1, 1)),
        )  # fmt: skip

    def _make_turns(self) -> None:
        network, supports, nodes = self.network, self.supports, self.nodes
        fabric, constraints = network.fabric, self.constraints
        yarn = np.array([
            fabric.warp.yarn_bending * fabric.warp.yarns * network.pitch[1],
            fabric.weft.yarn_bending * fabric.weft.yarns * network.pitch[0],
        ])  # fmt: skip
        # Straightens tails when yarns do not bend: at equilibrium it is at rest, whatever its size.
        straightener = fabric.shear_modulus * network.pitch.prod() * network.pitch.mean()
        carrying = supports.carrying
        node, length = network.arm_node, network.arm_length
        ends = nodes.of_network_node[node]
        direction = network.arm_directions
        held = constraints.held[node] & constraints.held_arm[node, np.arange(4)]
        slaved = np.zeros(node.shape, bool)
        slaved[network.boundary_crossovers] = supports.slaved
        parts: list[tuple] = []

        def put(
            rows, before, at, after, mean_length, rigidity, second=None, clamp=None, along=None
        ):  # fmt: skip
            """Turns of crossovers ``rows``, each array of that length."""
            if len(rows) == 0:
                return
            zero, none = np.zeros((len(rows), 2)), np.full(len(rows), -1)
            parts.append((
                np.column_stack([before, at, after]), mean_length,
                np.broadcast_to(rigidity, len(rows)),
                np.column_stack([rows, rows if second is None else second]),
                none if clamp is None else clamp,
                zero if along is None else np.broadcast_to(along, zero.shape),
            ))  # fmt: skip

        for family in (0, 1):
            first, second = family, family + 2
            present = length[:, [first, second]] > 0
            stiff = yarn[family] if self.bending else straightener
            wanted = carrying & (self.bending | slaved[:, first] | slaved[:, second])
            rows = np.flatnonzero(wanted & present.all(axis=1))
            put(rows, ends[rows, second], nodes.of_hinge[rows], ends[rows, first],
                0.5 * (length[rows, first] + length[rows, second]), stiff)  # fmt: skip
            for arm, other in ((first, second), (second, first)):
                # The crossover lies on a clamp that holds the other arm's direction.
                rows = np.flatnonzero(
                    wanted & (length[:, arm] > 0) & (length[:, other] == 0) & held[:, other]
                )
                hinge = nodes.of_hinge[rows]
                put(rows, hinge, hinge, ends[rows, arm], 0.5 * length[rows, arm], stiff,
                    clamp=node[rows, other], along=direction[arm])  # fmt: skip
                if not self.bending:
                    continue
                # The arm ends on a clamp.
                rows = np.flatnonzero(carrying & (length[:, arm] > 0) & held[:, arm])
                put(rows, ends[rows, arm], ends[rows, arm], nodes.of_hinge[rows],
                    0.5 * length[rows, arm], stiff, clamp=node[rows, arm],
                    along=direction[other])  # fmt: skip
            if not self.bending:
                continue
            # Between this crossover and the next one, if that carries, too.
            after = nodes.after_hinge[:, family]
            carries = np.zeros(nodes.num_nodes_local, bool)
            carries[nodes.of_hinge[carrying]] = True
            nodes.halo.forward(carries)
            rows = np.flatnonzero(carrying & (after >= 0) & carries[after])
            crossover = np.full(nodes.num_nodes_local, -1)
            crossover[nodes.of_hinge] = np.arange(len(node))
            put(rows, nodes.of_hinge[rows], ends[rows, first], after[rows],
                0.5 * network.pitch[[family]].repeat(len(rows)), stiff,
                second=crossover[after[rows]])  # fmt: skip
        if not parts:
            parts.append((
                np.empty((0, 3), np.int32), np.empty(0), np.empty(0), np.empty((0, 2), int),
                np.empty(0, int), np.empty((0, 2)),
            ))  # fmt: skip
        columns = [np.concatenate(part) for part in zip(*parts, strict=True)]
        nodes_, mean_length, rigidity, crossover, clamp, along = columns
        self.turns = _Turns(
            nodes_.astype(np.int32), mean_length, rigidity, crossover, -along, clamp, along
        )

    # -- prescribed motion ----------------------------------------------------------------------

    def prescribe(self, x: np.ndarray, motions: list[tuple[np.ndarray, np.ndarray, np.ndarray]]):
        """Put prescribed unknowns of positions in place and turn the clamps' held directions.

        Collective: hinges on a clamp may be ghosts here of which the network does not know.

        Parameters
        ----------
        x : float (n_local, 2)
            Positions in the yarn frame, changed in place.
        motions : list of (network nodes (m,), gradient (2, 2), shift (2,))
            Affine motions X -> gradient X + shift in the axes x, y, of each edge; of the unknowns
            there, the prescribed ones follow it.
        """
        rotation, origin = self.network.preform.rotation, self.network.preform.lattice_origin
        for network_nodes, gradient, shift in motions:
            nodes = self.nodes.of_network_node[network_nodes]
            place = self.rest[nodes] @ rotation + origin
            target = (place @ gradient.T + shift - origin) @ rotation.T
            # Along the node's own axes, only what is prescribed.
            gap = np.einsum("nij,nj->ni", self.frame[nodes], target - x[nodes])
            gap[~self.fixed[nodes]] = 0.0
            x[nodes] += np.einsum("nji,nj->ni", self.frame[nodes], gap)
            self._clamp_gradient[network_nodes] = rotation @ gradient @ rotation.T
        self.nodes.halo.forward(x)
        crossing = self.cruciforms.held_node
        rows = self.cruciforms.held_rows
        directions = self.network.arm_directions
        self.cruciforms.held[rows] = _unit(
            np.einsum("mkij,kj->mki", self._clamp_gradient[crossing], directions)
        )
        turns = self.turns
        at = np.flatnonzero(turns.clamp_node >= 0)
        turns.offset[at] = -_unit(
            np.einsum(
                "mij,mj->mi", self._clamp_gradient[turns.clamp_node[at]], turns.clamp_direction[at]
            )
        )

    # -- energy, force, stiffness ---------------------------------------------------------------

    def _chunks(self, x: np.ndarray, level: int, before: np.ndarray | None = None):
        """Results of the kernels, chunk by chunk: kind (0 cruciforms, 1 turns), rows, results."""
        c, t = self.cruciforms, self.turns
        for begin in range(0, len(c.rows), CHUNK):
            part = slice(begin, begin + CHUNK)
            yield 0, part, kernels.cruciforms(
                x[c.nodes[part]], c.arm_length[part], c.area[part], self.cloth, level,
                c.strain_source[part], c.turn_source[part], c.held[part],
                None if before is None else before[c.nodes[part]],
            )  # fmt: skip
        for begin in range(0, len(t.nodes), CHUNK):
            part = slice(begin, begin + CHUNK)
            place = x[t.nodes[part]]
            place[:, 0] += t.offset[part]
            yield 1, part, kernels.turns(place, t.length[part], t.rigidity[part], level)

    def energies(self, x: np.ndarray) -> np.ndarray:
        """Strain energy of tension, shear and bending, J; (3,). Collective."""
        total = np.zeros(3)
        for kind, _, (energy, _, _) in self._chunks(x, ENERGY):
            total[2 * kind : 2 * kind + 2 - kind] += energy.sum(axis=0)
        return self.comm.allreduce(total)

    def force(self, x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Gradient of the strain energy, (n_local, 2) in the nodes' axes, and the energies (3,).

        Collective; forces are complete on owned nodes, ghosts filled. ``x`` has its ghosts filled.
        """
        total, force = np.zeros(3), np.zeros_like(x)
        for kind, part, (energy, forces, _) in self._chunks(x, FORCE):
            total[2 * kind : 2 * kind + 2 - kind] += energy.sum(axis=0)
            _add_forces(force, self._connectivity[kind][part], forces)
        force = self.nodes.halo.share(force)
        force[self._turned] = np.einsum("nij,nj->ni", self.frame[self._turned], force[self._turned])
        return force, self.comm.allreduce(total)

    @property
    def _connectivity(self) -> list[np.ndarray]:
        return [self.cruciforms.nodes, self.turns.nodes]

    @property
    def typical_stiffness(self) -> float:
        """Of the size of an arm's stiffness, N/m: for idle diagonal entries and for scales."""
        return self.network.fabric.c11 + self.network.fabric.c22

    def stiffness(
        self, x: np.ndarray, reuse: PETSc.Mat | None = None, before: np.ndarray | None = None
    ) -> tuple[PETSc.Mat, np.ndarray]:
        """Tangent matrix on the free unknowns, and the coupling to prescribed ones. Collective.

        Symmetric; unknowns that are not free have a diagonal entry only.

        Parameters
        ----------
        x : float (n_local, 2)
        reuse : PETSc.Mat, optional
            A matrix made here before, of which only the values change.
        before : float (n_local, 2), optional
            Positions before the step that led to x, see elements.energy.cruciforms.

        Returns
        -------
        PETSc.Mat
            The caller destroys it.
        blocks : float (m, 2, 2)
            The whole tangent, see `times`.
        """
        pattern = self._pattern
        blocks = pattern.empty_blocks()
        for kind, part, (_, _, matrices) in self._chunks(x, STIFFNESS, before):
            _add_blocks(blocks, pattern.slots[kind][part], matrices)
        at = self._turned_blocks
        row, column = self.frame[self._block_row[at]], self.frame[self._block_column[at]]
        blocks[at] = row @ blocks[at] @ np.swapaxes(column, 1, 2)
        masked = blocks.copy()
        at = self._masked_blocks
        row, column = self.free[self._block_row[at]], self.free[self._block_column[at]]
        masked[at] *= np.logical_and(row[:, :, None], column[:, None, :])
        owned = self.nodes.num_nodes_owned
        idle = np.where(self.free[:owned], 0.0, self.typical_stiffness)
        for axis in (0, 1):
            masked[pattern.diagonal, axis, axis] += idle[:, axis]
        matrix = pattern.matrix(masked, reuse)
        matrix.setOption(PETSc.Mat.Option.SYMMETRIC, True)
        matrix.setOption(PETSc.Mat.Option.SYMMETRY_ETERNAL, True)
        return matrix, blocks

    def _make_pattern(self) -> None:
        self._pattern = pattern = BlockPattern(self.nodes, self._connectivity, 2)
        # Local nodes of each block that elements of this rank add to.
        size = len(pattern.empty_blocks())
        self._block_row = np.zeros(size, np.int32)
        self._block_column = np.zeros(size, np.int32)
        own = np.arange(self.nodes.num_nodes_owned)
        self._block_row[pattern.diagonal] = self._block_column[pattern.diagonal] = own
        for nodes, slots in zip(self._connectivity, pattern.slots, strict=True):
            self._block_row[slots] = nodes[:, :, None]
            self._block_column[slots] = nodes[:, None, :]
        pair = (self._block_row, self._block_column)
        turned = np.zeros(self.nodes.num_nodes_local, bool)
        turned[self._turned] = True
        bound = ~self.free.all(axis=1)
        self._turned_blocks = np.flatnonzero(turned[pair[0]] | turned[pair[1]])
        self._masked_blocks = np.flatnonzero(bound[pair[0]] | bound[pair[1]])

    def times(self, blocks: np.ndarray, values: np.ndarray) -> np.ndarray:
        """Whole tangent times node values (n_local, 2), both in the nodes' axes. Collective.

        Complete on owned nodes, ghosts filled.
        """
        product = np.zeros_like(values)
        _multiply(blocks, self._block_row, self._block_column, values, product)
        return self.nodes.halo.share(product)

    # -- vectors --------------------------------------------------------------------------------

    def to_axes(self, values: np.ndarray) -> np.ndarray:
        """Components in the yarn frame -> in the nodes' axes, in place; (n_local, 2)."""
        at = self._turned
        values[at] = np.einsum("nij,nj->ni", self.frame[at], values[at])
        return values

    def from_axes(self, values: np.ndarray) -> np.ndarray:
        """Components in the nodes' axes -> in the yarn frame, in place; (n_local, 2)."""
        at = self._turned
        values[at] = np.einsum("nji,nj->ni", self.frame[at], values[at])
        return values

    def local(self, vector: PETSc.Vec) -> np.ndarray:
        """Node values (n_local, 2) of a vector, zero where not free, ghosts filled. Collective."""
        values = np.zeros((self.nodes.num_nodes_local, 2))
        owned = self.nodes.num_nodes_owned
        values[:owned] = vector.getArray(readonly=True).reshape(-1, 2)
        values[~self.free] = 0.0
        return self.nodes.halo.forward(values)

    # -- results --------------------------------------------------------------------------------

    def displacement(self, x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Displacements in x, y of this rank's crossovers and of the network's nodes. Collective.

        Crossovers that carry nothing, and their arm ends, follow straight what they hang on.
        """
        x = self._follow(x)
        moved = (x - self.rest) @ self.network.preform.rotation
        return moved[self.nodes.of_hinge], moved[self.nodes.of_network_node]

    def _follow(self, x: np.ndarray) -> np.ndarray:
        """Positions with crossovers that carry nothing moved like a rigid body. Collective."""
        network, supports, nodes = self.network, self.supports, self.nodes
        rounds = self.comm.allreduce(int(supports.round_.max(initial=0)), MPI.MAX)
        if rounds == 0:
            return x
        x = x.copy()
        ends = nodes.of_network_node[network.arm_node]
        known = self.active | self.fixed.any(axis=1)
        done = supports.carrying.copy()
        for number in range(rounds, 0, -1):
            turn = np.zeros((nodes.num_nodes_local, 3))  # cosine, sine, count
            for arm in range(4):
                rows = np.flatnonzero(done & (network.arm_length[:, arm] > 0))
                t = _unit(x[ends[rows, arm]] - x[nodes.of_hinge[rows]])
                t0 = network.arm_directions[arm]
                np.add.at(turn[:, 0], ends[rows, arm], t @ t0)
                np.add.at(turn[:, 1], ends[rows, arm], t0[0] * t[:, 1] - t0[1] * t[:, 0])
                np.add.at(turn[:, 2], ends[rows, arm], 1.0)
            nodes.halo.share(turn)
            told = np.zeros((nodes.num_nodes_local, 3))
            for e in np.flatnonzero(supports.round_ == number):  # a handful, at sharp corners
                joints = ends[e][known[ends[e]]]
                if not len(joints):
                    continue  # a crossover joined to nothing
                joint = joints[0]
                c, s = (1.0, 0.0) if turn[joint, 2] == 0 else _unit(turn[joint, :2])
                rigid = np.array([[c, -s], [s, c]])
                others = np.append(ends[e][ends[e] != joint], nodes.of_hinge[e])
                x[others] = x[joint] + (self.rest[others] - self.rest[joint]) @ rigid.T
                told[others, :2], told[others, 2] = x[others], 1.0
            done |= supports.round_ == number
            nodes.halo.share(told)
            new = told[:, 2] > 0
            x[new] = told[new, :2] / told[new, 2:]
            known = known | new
        return nodes.halo.forward(x)

    def most_sheared(self, x: np.ndarray) -> np.ndarray | None:
        """Place at rest (x, y) of a crossover whose warp and weft passed each other. Collective.

        None where there is none: yarns, from one arm end of a crossover to the other, cross the way
        they did at rest. Beyond 90 degrees of shear the kernels' angle would come back, which no
        cloth does.
        """
        network, c = self.network, self.cruciforms
        hinge = x[c.nodes[:, 4]]
        warp, weft = (x[c.nodes[:, f]] - x[c.nodes[:, f + 2]] for f in (0, 1))
        for family, chord in ((0, warp), (1, weft)):  # where one arm is missing, the other counts
            for arm, sign in ((family, 1.0), (family + 2, -1.0)):
                gone = c.arm_length[:, (arm + 2) % 4] == 0
                chord[gone] = sign * (x[c.nodes[gone, arm]] - hinge[gone])
        turn = warp[:, 0] * weft[:, 1] - warp[:, 1] * weft[:, 0]
        both = (c.arm_length[:, :2] + c.arm_length[:, 2:] > 0).all(axis=1)
        worst = int(np.where(both, turn, np.inf).argmin()) if len(turn) else 0
        value = float(turn[worst]) if len(turn) and both[worst] else np.inf
        place = network.crossover_position[c.rows[worst]].tolist() if len(turn) else []
        value, place = min(self.comm.allgather((value, place)))
        return np.array(place) if value <= 0.0 else None

    def most_stretched(self, x: np.ndarray, limit: float) -> np.ndarray | None:
        """Place at rest (x, y) of a crossover with an arm stretched beyond a limit. Collective.

        None where there is none.
        """
        c = self.cruciforms
        arms = x[c.nodes[:, :4]] - x[c.nodes[:, 4:]]
        size = np.hypot(arms[..., 0], arms[..., 1])
        stretch = np.where(c.arm_length > 0, size / np.maximum(c.arm_length, 1e-300), 0.0)
        most = stretch.max(axis=1, initial=0.0)
        worst = int(most.argmax()) if len(most) else 0
        value = float(most[worst]) if len(most) else 0.0
        place = self.network.crossover_position[c.rows[worst]].tolist() if len(most) else []
        value, place = max(self.comm.allgather((value, place)))
        return np.array(place) if value > limit else None

    def _arms(self, x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Stretch and rotation from rest (radians) of the arms of this rank's cruciforms, (m, 4).

        What has no arm of its own there takes its yarn's other one, or the clamp's.
        """
        c = self.cruciforms
        place = x[c.nodes]
        arms = place[:, :4] - place[:, 4:]
        size = np.hypot(arms[..., 0], arms[..., 1])
        present = c.arm_length > 0
        stretch = np.where(present, size / np.where(present, c.arm_length, 1.0), 1.0)
        t = np.where(present[..., None], arms / np.where(present, size, 1.0)[..., None], 0.0)
        at = np.arange(len(c.rows))[:, None]
        source = np.maximum(c.strain_source, 0)
        stretch = np.where(c.strain_source == HELD, 1.0, stretch[at, source])
        source = np.maximum(c.turn_source, 0)
        reverse = np.where(source == np.arange(4), 1.0, -1.0)[..., None]
        t = np.where((c.turn_source == HELD)[..., None], c.held, reverse * t[at, source])
        t0 = self.network.arm_directions
        rotation = np.arctan2(
            t0[:, 0] * t[..., 1] - t0[:, 1] * t[..., 0], np.einsum("mki,ki->mk", t, t0)
        )
        return stretch, rotation

    def _shares(self) -> np.ndarray:
        """Share of each quadrant in its cruciform's area, (m, 4)."""
        area = self.cruciforms.area
        return area / np.maximum(area.sum(axis=1, keepdims=True), 1e-300)

    def _shear_angles(self, rotation: np.ndarray) -> np.ndarray:
        """Mean shear angle of each cruciform (m,) from its arms' rotations (m, 4), radians."""
        gamma = rotation[:, QUADRANTS[:, 0]] - rotation[:, QUADRANTS[:, 1]]
        return np.einsum("mq,mq->m", self._shares(), gamma)

    def shear_angle_max(self, x: np.ndarray) -> float:
        """Largest shear angle of a crossover, radians. Collective."""
        angles = np.abs(self._shear_angles(self._arms(x)[1]))
        carrying = self.supports.carrying[self.cruciforms.rows]
        return max(self.comm.allgather(float(angles[carrying].max(initial=0.0))))

    def crossover_fields(self, x: np.ndarray) -> dict[str, np.ndarray]:
        """Fields at this rank's crossovers; the same as LinearNetwork.crossover_fields. Collective.

        Strains are engineering strains of the arms, rotations those of the arms from rest, tensions
        first Piola-Kirchhoff, N per metre of cloth at rest.
        """
        fabric, c = self.network.fabric, self.cruciforms
        n = self.network.num_crossovers_owned
        stretch, rotation = self._arms(x)
        shares = self._shares()
        warp = np.einsum("mq,mq->m", shares, (stretch - 1.0)[:, QUADRANTS[:, 0]])
        weft = np.einsum("mq,mq->m", shares, (stretch - 1.0)[:, QUADRANTS[:, 1]])
        e, e1, _ = fabric.effective_strain(1.0 + np.stack([warp, weft]))
        tension = (
            (fabric.warp_tension.evaluate(e[0])[1] + fabric.c12 * e[1]) * e1[0],
            (fabric.weft_tension.evaluate(e[1])[1] + fabric.c12 * e[0]) * e1[1],
        )
        energy = {mode: np.zeros(n) for mode in MODES}
        bending = np.zeros(self.nodes.num_nodes_local)
        for kind, part, (values, _, _) in self._chunks(x, ENERGY):
            if kind == 0:
                energy["tension"][c.rows[part]] = values[:, 0]
                energy["shear"][c.rows[part]] = values[:, 1]
                continue
            for of in self.turns.crossover[part].T:
                # The second crossover of a joint may be another rank's: its hinge is a ghost here.
                hinge = np.where(of >= 0, self.nodes.of_hinge[of], self.turns.nodes[part][:, 2])
                np.add.at(bending, hinge, 0.5 * values[:, 0])
        energy["bending"] += self.nodes.halo.reverse(bending)[self.nodes.of_hinge]

        def spread(values: np.ndarray) -> np.ndarray:
            wide = np.zeros((n, *values.shape[1:]))
            wide[c.rows] = values
            return wide

        return {
            "displacement": self.displacement(x)[0],
            "arm_strain": spread(stretch - 1.0),
            "arm_rotation": spread(rotation),
            "warp_strain": spread(warp),
            "weft_strain": spread(weft),
            "warp_tension": spread(tension[0]),
            "weft_tension": spread(tension[1]),
            "shear_angle": spread(self._shear_angles(rotation)),
            **{f"{mode}_energy": value for mode, value in energy.items()},
            "carrying": self.supports.carrying.copy(),
        }


def cloth(fabric) -> Cloth:
    """A Fabric in the kernels' terms."""
    return Cloth(
        fabric.warp_tension.packed,
        fabric.weft_tension.packed,
        fabric.shear.packed,
        float(fabric.c12),
        bool(fabric.log_strain),
        float(fabric.compression),
        float(fabric.compression_width),
    )


def _unit(vectors: np.ndarray) -> np.ndarray:
    """Vectors (..., 2) over their length."""
    return vectors / np.hypot(vectors[..., 0], vectors[..., 1])[..., None]


@numba.njit(cache=True, error_model="numpy")
def _add_forces(total, nodes, forces):
    """Add element forces (m, k, dim) to nodes (m, k), in place."""
    for n in range(nodes.shape[0]):
        for p in range(nodes.shape[1]):
            for i in range(forces.shape[2]):
                total[nodes[n, p], i] += forces[n, p, i]


@numba.njit(cache=True, error_model="numpy")
def _add_blocks(blocks, slots, matrices):
    """Add element matrices (m, k, dim, k, dim) to node blocks, in place."""
    for n in range(slots.shape[0]):
        for p in range(slots.shape[1]):
            for q in range(slots.shape[2]):
                at = slots[n, p, q]
                for i in range(matrices.shape[2]):
                    for j in range(matrices.shape[4]):
                        blocks[at, i, j] += matrices[n, p, i, q, j]


@numba.njit(cache=True, error_model="numpy")
def _multiply(blocks, row, column, values, product):
    """Add node blocks (m, dim, dim) times node values to ``product``, in place."""
    for b in range(len(row)):
        for i in range(blocks.shape[1]):
            for j in range(blocks.shape[2]):
                product[row[b], i] += blocks[b, i, j] * values[column[b], j]
