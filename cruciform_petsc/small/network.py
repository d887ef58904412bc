# SPDX-License-Identifier: MIT
"""From element arrays to distributed PETSc matrices and vectors, and back to crossover fields."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from mpi4py import MPI
from petsc4py import PETSc

from ..elements import bending, shear, tension
from ..elements.kinematics import DISPLACEMENTS, arm_rows, condense, with_rotations
from ..errors import InputError
from ..net.edges import Constraints
from ..net.supports import Supports, find_supports, pass_on_loads
from ..solvers.pattern import BlockPattern, Layout

MODES = ("tension", "shear", "bending")


@dataclass
class _Group:
    """Cruciforms handled together: all regular ones share one matrix, each cut one has its own.

    Arrays over elements have length len(rows), or 1 where all are alike.
    """

    rows: np.ndarray  # owned crossovers
    strain: np.ndarray  # (., 4, 10) arm strains from displacements
    rotation: np.ndarray  # (., 4, 10) arm rotations
    area: np.ndarray  # (., 4)
    parts: dict[str, np.ndarray]  # mode -> (., m, m) on all element unknowns, hinge included
    # Of cruciforms at the outline only:
    turn: Any = None  # (., k, k) node frames, kept unknowns
    hinge_slot: Any = None  # (.,) arm whose node is the hinge, or -1
    tail_load: Any = None  # (., m) loads on slaved tails


class LinearNetwork:
    """Small displacements of a constrained network: its stiffness, loads and energies. Collective.

    The hinge's displacement and the two yarn rotations at it are eliminated element by element
    (paper [9]-[15], with all modes of deformation together), so that the unknowns are those of the
    nodes. They are kept in the yarn frame (constraints.frame where an edge is guided).

    Parameters
    ----------
    constraints : Constraints

    Attributes
    ----------
    unknowns_per_node : int
        2, or 3 with yarn bending.
    length_scale : float
        Rotations are stored times this length (the mean pitch), m.
    force : float (n_local, 2)
        constraints.force as it was when this object was made, with the loads on crossovers that
        carry nothing moved to the arm ends they hang on.
    """

    def __init__(self, constraints: Constraints):
        self.constraints, self.network = constraints, constraints.network
        self.bending = constraints.bending
        self.unknowns_per_node = 3 if self.bending else 2
        self.supports: Supports = find_supports(constraints)
        self.length_scale = float(self.network.pitch.mean())
        self.force = pass_on_loads(constraints, self.supports)
        self.groups = [self._regular_group(), self._boundary_group()]
        self._condensed: dict[tuple[str, ...], list] = {}
        self.free = self.supports.active & ~constraints.fixed
        self._pattern: BlockPattern | None = None
        self._layout: Layout | None = None
        unknowns = self.unknowns_per_node * self.network.num_nodes_global
        if unknowns > np.iinfo(PETSc.IntType).max:
            raise InputError(f"{unknowns} unknowns need a PETSc with 64-bit indices")

    @property
    def modes(self) -> tuple[str, ...]:
        """Names of the modes of deformation there are."""
        return MODES if self.bending else MODES[:2]

    # -- elements -------------------------------------------------------------------------------

    def _parts(self, a, strain, rotation, area) -> dict[str, np.ndarray]:
        fabric = self.network.fabric
        parts = {
            "tension": tension.stiffness(strain, area, fabric.c11, fabric.c22, fabric.c12),
            "shear": shear.stiffness(rotation, area, fabric.shear_modulus),
        }
        if not self.bending:
            return parts
        parts = {mode: with_rotations(matrix) for mode, matrix in parts.items()}
        t = np.broadcast_to(self.network.arm_directions, (len(a), 4, 2))
        # [23]: the yarns within the cruciform's width, whole yarns also where the outline cuts it.
        along_warp, along_weft = self.network.pitch
        warp = fabric.warp.yarn_bending * fabric.warp.yarns * along_weft
        weft = fabric.weft.yarn_bending * fabric.weft.yarns * along_warp
        rigidity = np.broadcast_to([warp, weft, warp, weft], (len(a), 4))
        parts["bending"] = bending.stiffness(a, t, rigidity, self.length_scale)
        return parts

    def _regular_group(self) -> _Group:
        network = self.network
        regular = np.ones(network.num_crossovers_owned, bool)
        regular[network.boundary_crossovers] = False
        a = np.tile(0.5 * network.pitch, 2)[None]
        t = network.arm_directions[None]
        strain, rotation = arm_rows(a, t)
        area = np.full((1, 4), 0.25 * network.pitch.prod())
        parts = self._parts(a, strain, rotation, area)
        return _Group(np.flatnonzero(regular), strain, rotation, area, parts)

    def _boundary_group(self) -> _Group:
        network, supports = self.network, self.supports
        keep = supports.carrying[network.boundary_crossovers]
        rows = network.boundary_crossovers[keep]
        a, nodes = network.arm_length[rows], network.arm_node[rows]
        t = np.broadcast_to(network.arm_directions, (len(rows), 4, 2))
        strain, rotation = arm_rows(
            a, t, supports.strain_source[keep], supports.rotation_source[keep]
        )
        area = supports.quadrant_area[keep]
        parts = self._parts(a, strain, rotation, area)

        missing = a == 0
        hinge_slot = np.where(missing.any(axis=1), missing.argmax(axis=1), -1)
        d = self.unknowns_per_node
        tied_rows = np.flatnonzero(hinge_slot >= 0)
        held = self.constraints.held[nodes[tied_rows, hinge_slot[tied_rows]]]
        for matrix in parts.values():
            _tie_hinge(matrix, tied_rows, hinge_slot[tied_rows], d)
            if self.bending:
                # A clamp holds the direction of both yarns of a crossover that lies on it.
                for psi in (14, 15):
                    matrix[tied_rows[held], psi, :] = 0.0
                    matrix[tied_rows[held], :, psi] = 0.0

        turn = np.tile(np.eye(4 * d), (len(rows), 1, 1))
        for k in range(4):
            turn[:, d * k : d * k + 2, d * k : d * k + 2] = self.constraints.frame[nodes[:, k]]

        push = np.zeros((len(rows), 10))
        for k in range(4):  # u_tail across the yarn = u_0 + a theta, theta the yarn's rotation
            normal = network.arm_directions[(k + 1) % 4]
            slaved = supports.slaved[keep][:, k]
            across = np.where(slaved, self.force[nodes[:, k]] @ normal, 0.0)
            push[:, 8:] += across[:, None] * normal
            push += (across * a[:, k])[:, None] * rotation[:, k]
        load = np.zeros((len(rows), matrix.shape[1]))
        load[:, DISPLACEMENTS if self.bending else slice(None)] = push
        tie = np.zeros((len(rows), 1, load.shape[1]))
        tie[:, 0] = load
        _tie_hinge_rows(tie, tied_rows, hinge_slot[tied_rows], d)
        load = tie[:, 0]
        return _Group(rows, strain, rotation, area, parts, turn, hinge_slot, load)

    def _condense(self, modes: tuple[str, ...]) -> list[tuple[np.ndarray, np.ndarray]]:
        """(stiffness on node unknowns, recovery of the hinge) of each group, cached."""
        if modes not in self._condensed:
            pairs = []
            for group in self.groups:
                total = np.sum([group.parts[mode] for mode in modes], axis=0)
                matrix, recovery = condense(total, 4 * self.unknowns_per_node)
                if group.turn is not None:
                    matrix = group.turn @ matrix @ np.swapaxes(group.turn, 1, 2)
                    recovery = recovery @ np.swapaxes(group.turn, 1, 2)
                pairs.append((matrix, recovery))
            self._condensed[modes] = pairs
        return self._condensed[modes]

    def _element_values(self, group: _Group, local: np.ndarray) -> np.ndarray:
        """Values of local nodes (n_local, d) at the four arm ends of each element, (m, 4 d)."""
        width = 4 * (local.shape[1] if local.ndim > 1 else 1)
        return local[self.network.arm_node[group.rows]].reshape(len(group.rows), width)

    # -- distributed matrices and vectors -------------------------------------------------------

    def matrix(self, *modes: str, reuse: PETSc.Mat | None = None) -> PETSc.Mat:
        """Stiffness of the given modes together (all of them if none is given). Collective.

        Symmetric; prescribed and non-existing unknowns have a diagonal entry only. With ``reuse``
        (a matrix made here before) only values change. The caller destroys the matrix.
        """
        modes = tuple(modes or self.modes)
        if self._pattern is None:
            self._pattern = BlockPattern(
                self.network, [self.network.arm_node], self.unknowns_per_node
            )
            self._layout = self._pattern.layout(self._nonzero(self._pattern))
        pattern = self._pattern
        blocks = pattern.empty_blocks()
        for group, (matrix, _) in zip(self.groups, self._condense(modes), strict=True):
            self._add(pattern, blocks, group, matrix)
        d, owned = self.unknowns_per_node, self.network.num_nodes_owned
        diagonal = np.arange(d)
        blocks[pattern.diagonal[:, None], diagonal, diagonal] += np.where(
            self.free[:owned], 0.0, self.typical_stiffness
        )
        result = pattern.matrix(blocks, reuse, self._layout)
        result.setOption(PETSc.Mat.Option.SYMMETRIC, True)
        result.setOption(PETSc.Mat.Option.SYMMETRY_ETERNAL, True)
        result.setOption(PETSc.Mat.Option.SPD, set(modes) == set(self.modes))
        return result

    def _add(
        self, pattern: BlockPattern, blocks: np.ndarray, group: _Group, matrix: np.ndarray
    ) -> None:
        """Add a group's matrices (m or 1, k, k) to blocks, without what is not free."""
        free = self._element_values(group, self.free)
        masked = np.ones(len(free), bool)
        if group.turn is None:  # away from the outline few, if any, unknowns are not free
            masked[:] = ~free.all(axis=1)
            pattern.add(blocks, group.rows[~masked], matrix)
            free = free[masked]
        free = free.astype(matrix.dtype)
        matrix = matrix * free[:, :, None] * free[:, None, :]
        pattern.add(blocks, group.rows[masked], matrix)

    def _nonzero(self, pattern: BlockPattern) -> np.ndarray:
        """Blocks that are not zero where the matrix of all modes or of any one may be. Collective.

        In the yarn frame two fifths of the entries are zero, whatever the moduli.
        """
        blocks = pattern.empty_blocks(bool)
        blocks[pattern.diagonal] = np.eye(self.unknowns_per_node, dtype=bool)
        each = [self._condense(modes) for modes in (self.modes, *((m,) for m in self.modes))]
        for group, *pairs in zip(self.groups, *each, strict=True):
            self._add(pattern, blocks, group, np.any([matrix != 0 for matrix, _ in pairs], axis=0))
        return pattern.collect(blocks)

    @property
    def typical_stiffness(self) -> float:
        """A stiffness of the size of the regular cruciform's, N/m: for idle diagonal entries."""
        return float(np.trace(self.groups[0].parts["tension"][0]))

    def vector(self, local: np.ndarray) -> PETSc.Vec:
        """PETSc vector of the owned part of node values (n_local, d). Collective."""
        values = np.ascontiguousarray(local[: self.network.num_nodes_owned]).ravel()
        return PETSc.Vec().createWithArray(values.copy(), comm=self.network.comm)

    def local(self, vector: PETSc.Vec) -> np.ndarray:
        """Node values (n_local, d) of a solution, prescribed ones in, ghosts filled. Collective."""
        d = self.unknowns_per_node
        values = np.zeros((self.network.num_nodes_local, d))
        values[: self.network.num_nodes_owned] = vector.getArray(readonly=True).reshape(-1, d)
        values[~self.supports.active] = 0.0
        values[self.constraints.fixed] = self.constraints.value[self.constraints.fixed]
        return self.network.halo.forward(values)

    def element_forces(self, local: np.ndarray, *modes: str) -> np.ndarray:
        """Forces K u of the elements on the nodes, complete on owned nodes; (n_local, d).

        Collective. ``local`` has its ghosts filled.
        """
        shape = local.shape
        force = np.zeros(local.size)
        for group, (matrix, _) in zip(
            self.groups, self._condense(tuple(modes or self.modes)), strict=True
        ):
            u = self._element_values(group, local)
            f = u @ matrix[0] if len(matrix) == 1 else np.einsum("eij,ej->ei", matrix, u)
            places = self._element_values(group, np.arange(local.size).reshape(shape))
            force += np.bincount(places.ravel(), weights=f.ravel(), minlength=local.size)
        force = force.reshape(shape)
        self.network.halo.reverse(force)
        return self.network.halo.forward(force)

    def loads(self, *modes: str) -> np.ndarray:
        """Loads on the node unknowns, (n_local, d); those on tails passed on to their yarns."""
        constraints, d = self.constraints, self.unknowns_per_node
        loads = np.zeros((self.network.num_nodes_local, d))
        loads[:, :2] = np.einsum("nij,nj->ni", constraints.frame, self.force)
        group = self.groups[1]
        if self.network.comm.allreduce(float(abs(self.force).max(initial=0.0))) == 0.0:
            return loads
        _, recovery = self._condense(tuple(modes or self.modes))[1]
        keep = 4 * d
        kept = group.tail_load[:, :keep] if self.bending else group.tail_load[:, :8]
        passed = np.einsum("eij,ej->ei", group.turn, kept)
        passed += np.einsum("eji,ej->ei", recovery, group.tail_load[:, keep:])
        places = self._element_values(group, np.arange(loads.size).reshape(loads.shape))
        extra = np.bincount(places.ravel(), weights=passed.ravel(), minlength=loads.size)
        extra = self.network.halo.reverse(extra.reshape(loads.shape))
        loads += self.network.halo.forward(extra)
        loads[~self.supports.active] = 0.0
        return loads

    def rigid_motions(self) -> np.ndarray:
        """Two translations and the rotation of all nodes, (n_local, d, 3), in node frames."""
        network, d = self.network, self.unknowns_per_node
        lattice = (
            network.node_position - network.preform.lattice_origin
        ) @ network.preform.rotation.T
        motion = np.zeros((network.num_nodes_local, d, 3))
        motion[:, 0, 0] = motion[:, 1, 1] = 1.0
        motion[:, 0, 2], motion[:, 1, 2] = -lattice[:, 1], lattice[:, 0]
        motion[:, :2] = np.einsum("nij,njk->nik", self.constraints.frame, motion[:, :2])
        if d == 3:
            motion[:, 2, 2] = self.length_scale
        return motion

    def soft_motions(self) -> np.ndarray:
        """What algebraic multigrid must know of, (n_local, d, 3 or 4), zero where not free.

        The rigid motions and, without yarn bending, the turning squares: every crossover turns by
        one angle, its neighbours by the opposite one, and the arm ends between them move across
        their yarns. Nothing deforms; only clamps, which keep the crossovers beside them from
        turning, and at a distance shear, withstand it.
        """
        network = self.network
        if self.bending:
            return self.rigid_motions() * self.free[:, :, None]
        squares = np.zeros((network.num_nodes_local, 2))
        turn = np.where(network.crossover_ij.sum(axis=1) % 2 == 0, 1.0, -1.0)
        for k in range(4):
            node = network.arm_node[:, k]
            across = network.arm_directions[(k + 1) % 4]
            squares[node] = (turn * network.arm_length[:, k])[:, None] * across
        squares = network.halo.forward(squares)
        squares = np.einsum("nij,nj->ni", self.constraints.frame, squares)
        motions = np.concatenate([self.rigid_motions(), squares[:, :, None]], axis=2)
        return motions * self.free[:, :, None]

    # -- results --------------------------------------------------------------------------------

    def crossover_fields(self, local: np.ndarray, *modes: str) -> dict[str, np.ndarray]:
        """Fields at the crossovers from node values (ghosts filled). Collective.

        Returns
        -------
        dict with, in metres, radians, N/m and J:
            displacement (n, 2) in x, y; arm_strain (n, 4); arm_rotation (n, 4);
            warp_strain, weft_strain, warp_tension, weft_tension, shear_angle (n,), means over the
            quadrants; tension_energy, shear_energy, bending_energy (n,); carrying (n,) bool.
        """
        network, fabric = self.network, self.network.fabric
        n = network.num_crossovers_owned
        hinge = np.zeros((n, 2))
        fields = {name: np.zeros((n, 4)) for name in ("arm_strain", "arm_rotation")}
        mean_area = np.zeros((n, 4))
        energy = {mode: np.zeros(n) for mode in MODES}
        modes = tuple(modes or self.modes)
        for group, (_, recovery) in zip(self.groups, self._condense(modes), strict=True):
            full = self._element_unknowns(group, recovery, local)
            for mode, matrix in group.parts.items():
                energy[mode][group.rows] = 0.5 * _quadratic(matrix, full)
            u = full if full.shape[1] == 10 else full[:, DISPLACEMENTS]
            hinge[group.rows] = u[:, 8:]
            for name, rows in (("arm_strain", group.strain), ("arm_rotation", group.rotation)):
                fields[name][group.rows] = (
                    u @ rows[0].T if len(rows) == 1 else np.einsum("ekj,ej->ek", rows, u)
                )
            mean_area[group.rows] = group.area
        shares = mean_area / np.maximum(mean_area.sum(axis=1, keepdims=True), 1e-300)
        strain = fields["arm_strain"]
        gamma = shear.quadrant_angles(fields["arm_rotation"])
        warp = np.einsum("eq,eq->e", shares, strain[:, [0, 2, 2, 0]])
        weft = np.einsum("eq,eq->e", shares, strain[:, [1, 1, 3, 3]])
        self._follow(hinge, fields["arm_rotation"], local)
        return {
            "displacement": hinge @ network.preform.rotation,
            "arm_strain": strain,
            "arm_rotation": fields["arm_rotation"],
            "warp_strain": warp,
            "weft_strain": weft,
            "warp_tension": fabric.c11 * warp + fabric.c12 * weft,
            "weft_tension": fabric.c22 * weft + fabric.c12 * warp,
            "shear_angle": np.einsum("eq,eq->e", shares, gamma),
            **{f"{mode}_energy": value for mode, value in energy.items()},
            "carrying": self.supports.carrying.copy(),
        }

    def _element_unknowns(self, group: _Group, recovery, local) -> np.ndarray:
        """All unknowns of each element in the yarn frame, hinge recovered; (m, 10 or 16)."""
        u = self._element_values(group, local)
        if group.turn is None:
            hinge = u @ recovery[0].T
        else:
            hinge = np.einsum("eij,ej->ei", recovery, u)
            u = np.einsum("eji,ej->ei", group.turn, u)
            d, tied = self.unknowns_per_node, np.flatnonzero(group.hinge_slot >= 0)
            slot = group.hinge_slot[tied]
            for c in (0, 1):
                hinge[tied, c] = u[tied, d * slot + c]
        return np.concatenate([u, hinge], axis=1)

    def node_displacement(self, local: np.ndarray, fields: dict) -> np.ndarray:
        """Displacement of all local nodes in x, y (n_local, 2), those without unknowns included.

        Collective. ``fields`` as returned by crossover_fields.
        """
        rotation = self.network.preform.rotation
        hinge = fields["displacement"] @ rotation.T
        return self._follow(hinge, fields["arm_rotation"].copy(), local) @ rotation

    def _follow(self, hinge, rotation, local) -> np.ndarray:
        """Move what has no unknowns of its own straight along with what it hangs on. Collective.

        These are tails that follow their yarn, and crossovers that carry nothing: their rows of
        ``hinge`` (n_owned, 2) and ``rotation`` (n_owned, 4) are filled in.

        Returns
        -------
        float (n_local, 2)
            Displacement of all nodes in the yarn frame.
        """
        network, supports = self.network, self.supports
        yarn = np.einsum("nji,nj->ni", self.constraints.frame, local[:, :2])
        normal = network.arm_directions[(np.arange(4) + 1) % 4]

        def tell(nodes: np.ndarray) -> None:
            """Give what has been found for some nodes to the other ranks that have them."""
            found = np.zeros((network.num_nodes_local, 3))
            found[nodes, :2], found[nodes, 2] = yarn[nodes], 1.0
            network.halo.share(found)
            told = found[:, 2] > 0
            yarn[told] = found[told, :2] / found[told, 2:]

        boundary = network.boundary_crossovers
        row, arm = np.nonzero(supports.slaved & supports.carrying[boundary][:, None])
        element = boundary[row]
        tails = network.arm_node[element, arm]
        turned = network.arm_length[element, arm] * rotation[element, arm]
        across = np.einsum("ei,ei->e", hinge[element] - yarn[tails], normal[arm]) + turned
        yarn[tails] += across[:, None] * normal[arm]
        tell(tails)

        rounds = network.comm.allreduce(int(supports.round_.max(initial=0)), MPI.MAX)
        known: np.ndarray = (supports.active | self.constraints.fixed)[:, :2].any(axis=1)
        done = supports.carrying.copy()
        for number in range(rounds, 0, -1):
            # Rotation of the arms that end at each node, where a crossover there is known.
            turn = np.zeros((network.num_nodes_local, 2))
            for k in range(4):
                np.add.at(turn[:, 0], network.arm_node[done, k], rotation[done, k])
                np.add.at(turn[:, 1], network.arm_node[done, k], 1.0)
            network.halo.share(turn)
            new = np.zeros(network.num_nodes_local, bool)
            for e in np.flatnonzero(supports.round_ == number):  # a handful, at sharp corners
                nodes, length = network.arm_node[e], network.arm_length[e]
                joints = np.flatnonzero(known[nodes])
                if not len(joints):
                    continue  # a crossover joined to nothing
                k = joints[0]
                angle = turn[nodes[k], 0] / max(turn[nodes[k], 1], 1.0)  # none beside a clamp
                rotation[e] = angle
                hinge[e] = yarn[nodes[k]] - length[k] * angle * normal[k]
                others = np.flatnonzero(nodes != nodes[k])
                yarn[nodes[others]] = hinge[e] + (length * angle)[others, None] * normal[others]
                new[nodes[others]] = True
            done |= supports.round_ == number
            tell(np.flatnonzero(new))
            network.halo.share(new, np.logical_or)
            known |= new
        return network.halo.forward(yarn)


def _quadratic(matrix: np.ndarray, u: np.ndarray) -> np.ndarray:
    """u^T K u of each element; matrix (m or 1, k, k), u (m, k)."""
    product = u @ matrix[0] if len(matrix) == 1 else np.einsum("eij,ej->ei", matrix, u)
    return np.einsum("ej,ej->e", product, u)


def _tie_hinge_rows(matrix: np.ndarray, rows, slot, d: int) -> None:
    """Move the columns of the hinge's displacement to the node that is the hinge, in place."""
    hinge = 4 * d
    for c in (0, 1):
        matrix[rows, :, d * slot + c] += matrix[rows, :, hinge + c]
        matrix[rows, :, hinge + c] = 0.0


def _tie_hinge(matrix: np.ndarray, rows, slot, d: int) -> None:
    """The same for rows and columns of a symmetric matrix, in place."""
    _tie_hinge_rows(matrix, rows, slot, d)
    transposed = np.swapaxes(matrix, 1, 2)
    _tie_hinge_rows(transposed, rows, slot, d)
