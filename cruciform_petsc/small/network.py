# SPDX-License-Identifier: MIT
"""From element arrays to distributed PETSc matrices and vectors, and back to crossover fields."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from petsc4py import PETSc

from ..elements import small as kernels
from ..errors import InputError
from ..net.edges import Constraints
from ..net.supports import Supports, find_supports, pass_on_loads
from ..parallel import most
from ..solvers.multigrid import Hierarchy, Unknowns, hierarchy
from ..solvers.pattern import BlockPattern, Layout
from ..solvers.yarns import OnYarns

MODES = ("tension", "shear", "bending")
# Entries of an element this small beside its largest are rounding: true ones are 1e-5 and more
# where no mode is softer than another, rounding is 1e-15 and less.
STRUCTURE = 1e-11


@dataclass
class _Group:
    """Cruciforms handled together: all regular ones share one matrix, each cut one has its own.

    An element's own unknowns (n of them) are those of its four nodes, in their frames, then the
    hinge's. Arrays over elements have length len(rows), or 1 where all are alike.
    """

    rows: np.ndarray  # owned crossovers
    area: np.ndarray  # (., 4)
    parts: dict[str, np.ndarray]  # mode -> (., n, n)
    measures: dict[str, np.ndarray]  # field -> (., k, n), the rows that give it
    tail_load: np.ndarray  # (., n), loads on tails that follow their yarn


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
        self._kept = 4 * self.unknowns_per_node  # of an element's unknowns, by condensation
        self.groups = [self._regular_group(), self._boundary_group()]
        self._condensed: dict[tuple[str, ...], list] = {}
        self.free = self.supports.active & ~constraints.fixed
        unknowns = self.unknowns_per_node * self.network.num_nodes_global
        if unknowns > np.iinfo(PETSc.IntType).max:
            raise InputError(f"{unknowns} unknowns need a PETSc with 64-bit indices")

    @property
    def modes(self) -> tuple[str, ...]:
        """Names of the modes of deformation there are."""
        return MODES if self.bending else MODES[:2]

    # -- elements -------------------------------------------------------------------------------

    def _group(self, rows, a, area, strain, rotation, own) -> _Group:
        """Elements of some arms; own (., m, n): the yarn frame's unknowns from their own."""
        fabric, pitch = self.network.fabric, self.network.pitch
        u = own[:, kernels.DISPLACEMENTS] if self.bending else own
        tension = kernels.tension(strain, area, fabric.c11, fabric.c22, fabric.c12)
        shear = kernels.shear(rotation, area, fabric.shear_modulus)
        parts = {"tension": _through(u, tension), "shear": _through(u, shear)}
        if self.bending:
            # [23]: the yarns within the cruciform's width, whole ones also where it is cut.
            warp = fabric.warp.yarn_bending * fabric.warp.yarns * pitch[1]
            weft = fabric.weft.yarn_bending * fabric.weft.yarns * pitch[0]
            rigidity = np.broadcast_to([warp, weft, warp, weft], (len(a), 4))
            t = np.broadcast_to(self.network.arm_directions, (len(a), 4, 2))
            parts["bending"] = _through(own, kernels.bending(a, t, rigidity, self.length_scale))
        measures = {
            "displacement": u[:, 8:],
            "arm_strain": strain @ u,
            "arm_rotation": rotation @ u,
        }
        return _Group(rows, area, parts, measures, np.zeros((len(a), own.shape[2])))

    def _regular_group(self) -> _Group:
        network = self.network
        regular = np.ones(network.num_crossovers_owned, bool)
        regular[network.boundary_crossovers] = False
        a = np.tile(0.5 * network.pitch, 2)[None]
        area = np.full((1, 4), 0.25 * network.pitch.prod())
        own = np.eye(16 if self.bending else 10)[None]
        strain, rotation = kernels.arm_rows(a, network.arm_directions[None])
        return self._group(np.flatnonzero(regular), a, area, strain, rotation, own)

    def _boundary_group(self) -> _Group:
        network, supports, d = self.network, self.supports, self.unknowns_per_node
        keep = supports.carrying[network.boundary_crossovers]
        rows = network.boundary_crossovers[keep]
        a, nodes = network.arm_length[rows], network.arm_node[rows]
        strain, rotation = kernels.arm_rows(
            a,
            np.broadcast_to(network.arm_directions, (len(rows), 4, 2)),
            supports.strain_source[keep],
            supports.rotation_source[keep],
        )
        own = np.tile(np.eye(16 if self.bending else 10), (len(rows), 1, 1))
        for k in range(4):
            frame = self.constraints.frame[nodes[:, k]]
            own[:, d * k : d * k + 2, d * k : d * k + 2] = np.swapaxes(frame, 1, 2)
        # A hinge on the outline is a node: the one of the arm that is missing.
        tied = np.flatnonzero((a == 0).any(axis=1))
        slot = (a[tied] == 0).argmax(axis=1)
        for c in range(2):
            own[tied, 4 * d + c] = own[tied, d * slot + c]
        if self.bending:
            # A clamp holds the direction of both yarns of a crossover that lies on it.
            own[tied[self.constraints.held[nodes[tied, slot]]], 14:] = 0.0
        group = self._group(rows, a, supports.quadrant_area[keep], strain, rotation, own)

        for k in range(4):  # u_tail across the yarn = u_0 + a theta, theta the yarn's rotation
            normal = network.arm_directions[(k + 1) % 4]
            slaved = supports.slaved[keep][:, k]
            across = np.where(slaved, self.force[nodes[:, k]] @ normal, 0.0)
            group.tail_load += across[:, None] * (normal @ group.measures["displacement"])
            turn = group.measures["arm_rotation"][:, k]
            group.tail_load += (across * a[:, k])[:, None] * turn
        return group

    def _condense(self, modes: tuple[str, ...]) -> list[tuple[np.ndarray, np.ndarray]]:
        """(stiffness on node unknowns, recovery of the hinge) of each group, cached."""
        modes = modes or self.modes
        if modes not in self._condensed:
            self._condensed[modes] = [
                kernels.condense(np.sum([group.parts[mode] for mode in modes], 0), self._kept)
                for group in self.groups
            ]
        return self._condensed[modes]

    def _element_values(self, group: _Group, local: np.ndarray) -> np.ndarray:
        """Values of local nodes (n_local, d) at the four arm ends of each element, (m, 4 d)."""
        width = 4 * (local.shape[1] if local.ndim > 1 else 1)
        return local[self.network.arm_node[group.rows]].reshape(len(group.rows), width)

    def _sum_at_nodes(self, group: _Group, values: np.ndarray) -> np.ndarray:
        """What the elements (m, 4 d) contribute to local nodes together, (n_local, d)."""
        shape = self.free.shape
        places = self._element_values(group, np.arange(self.free.size).reshape(shape))
        size = self.free.size
        return np.bincount(places.ravel(), values.ravel(), minlength=size).reshape(shape)

    # -- distributed matrices and vectors -------------------------------------------------------

    def matrix(self, *modes: str, reuse: PETSc.Mat | None = None) -> PETSc.Mat:
        """Stiffness of the given modes together (all of them if none is given). Collective.

        Symmetric; prescribed and non-existing unknowns have a diagonal entry only. With ``reuse``
        (a matrix made here before) only values change. The caller destroys the matrix.
        """
        which, matrices = self._stack([matrix for matrix, _ in self._condense(modes)])
        owned = self.network.num_nodes_owned
        idle = np.where(self.free[:owned], 0.0, self.typical_stiffness)
        result = self._pattern.sum(self._layout, which, matrices, idle, reuse)
        result.setOption(PETSc.Mat.Option.SYMMETRIC, True)
        result.setOption(PETSc.Mat.Option.SYMMETRY_ETERNAL, True)
        result.setOption(PETSc.Mat.Option.SPD, set(modes or self.modes) == set(self.modes))
        return result

    def _stack(self, matrices: Sequence[np.ndarray]) -> tuple[np.ndarray, np.ndarray]:
        """Number of each owned crossover's matrix, -1 for none, and the matrices.

        ``matrices`` are those of the groups. The one of all regular crossovers comes first; where
        some unknowns are not free there is another without them.
        """
        which, masks = self._distinct
        held = [matrix * mask for matrix, mask in zip(matrices, masks, strict=True)]
        return which, np.concatenate([matrices[0], *held])

    @cached_property
    def _distinct(self) -> tuple[np.ndarray, list[np.ndarray]]:
        """See _stack; masks (m, k, k) of the matrices beside the first, by group."""
        which = np.full(self.network.num_crossovers_owned, -1, np.int32)
        regular, boundary = (group.rows for group in self.groups)
        which[regular] = 0
        whole = self.free.all(axis=1)[self.network.arm_node[regular]].all(axis=1)
        rows, masks, end = (regular[~whole], boundary), [], 1
        for part in rows:
            which[part] = np.arange(end, end + len(part))
            end += len(part)
            free = self.free[self.network.arm_node[part]].reshape(len(part), self._kept)
            masks.append(free[:, :, None] & free[:, None, :])
        return which, masks

    @cached_property
    def _pattern(self) -> BlockPattern:
        return BlockPattern(self.network, [self.network.arm_node], self.unknowns_per_node)

    @cached_property
    def _layout(self) -> Layout:
        """Entries that are not zero where the matrix of all modes or of any one may be. Collective.

        In the yarn frame two fifths of the entries are zero, whatever the moduli. Modes count alike
        here, so that a soft one's entries stand clear of the rounding of a stiff one's.
        """
        there = []
        for group in self.groups:
            alike = {mode: part / _largest(part) for mode, part in group.parts.items()}
            sums = [np.sum([*alike.values()], 0), *alike.values()]
            matrices = [kernels.condense(part, self._kept)[0] for part in sums]
            stands_clear = [abs(matrix) > STRUCTURE * _largest(matrix) for matrix in matrices]
            there.append(np.any(stands_clear, axis=0))
        return self._pattern.layout(*self._stack(there))

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
        force = np.zeros(local.shape)
        for group, (matrix, _) in zip(self.groups, self._condense(modes), strict=True):
            force += self._sum_at_nodes(group, _times(matrix, self._element_values(group, local)))
        return self.network.halo.share(force)

    def loads(self, *modes: str) -> np.ndarray:
        """Loads on the node unknowns, (n_local, d); those on tails passed on to their yarns."""
        loads = np.zeros(self.free.shape)
        loads[:, :2] = np.einsum("nij,nj->ni", self.constraints.frame, self.force)
        group, (_, recovery) = self.groups[1], self._condense(modes)[1]
        kept, hinge = group.tail_load[:, : self._kept], group.tail_load[:, self._kept :]
        passed = kept + _times(np.swapaxes(recovery, 1, 2), hinge)
        loads += self.network.halo.share(self._sum_at_nodes(group, passed))
        loads[~self.supports.active] = 0.0
        return loads

    def rigid_motions(self) -> np.ndarray:
        """Two translations and the rotation of all nodes, (n_local, d, 3), in node frames."""
        network, d = self.network, self.unknowns_per_node
        place = network.to_yarn(network.node_position - network.origin)
        motion = np.zeros((network.num_nodes_local, d, 3))
        motion[:, 0, 0] = motion[:, 1, 1] = 1.0
        motion[:, 0, 2], motion[:, 1, 2] = -place[:, 1], place[:, 0]
        motion[:, :2] = np.einsum("nij,njk->nik", self.constraints.frame, motion[:, :2])
        if d == 3:
            motion[:, 2, 2] = self.length_scale
        return motion

    def turning_squares(self) -> np.ndarray:
        """Motion (n_local, 2), in node frames, that costs nothing without yarn bending. Collective.

        Every crossover turns by one angle, its neighbours by the opposite one, and the arm ends
        between them move across their yarns. Nothing deforms; only clamps, which keep the
        crossovers beside them from turning, and at a distance shear, withstand it.
        """
        network = self.network
        squares = np.zeros((network.num_nodes_local, 2))
        turn = np.where(network.crossover_ij.sum(axis=1) % 2 == 0, 1.0, -1.0)
        for k in range(4):
            across = network.arm_directions[(k + 1) % 4]
            squares[network.arm_node[:, k]] = (turn * network.arm_length[:, k])[:, None] * across
        return np.einsum("nij,nj->ni", self.constraints.frame, network.halo.forward(squares))

    def soft_motions(self) -> np.ndarray:
        """What algebraic multigrid must know of, (n_local, d, 3 or 4), zero where not free.

        The rigid motions and, without yarn bending, the turning squares.
        """
        motions = self.rigid_motions()
        if not self.bending:
            motions = np.concatenate([motions, self.turning_squares()[:, :, None]], axis=2)
        return motions * self.free[:, :, None]

    # -- multigrid ------------------------------------------------------------------------------

    def multigrid(self, matrix: PETSc.Mat) -> Hierarchy:
        """Coarse levels and smoother for a stiffness made here. Collective."""
        return hierarchy(matrix, self.unknowns())

    def unknowns(self) -> Unknowns:
        """Points, coarse fields and yarns of the unknowns that this rank owns. Collective."""
        network, d = self.network, self.unknowns_per_node
        owned = slice(0, network.num_nodes_owned)
        frame, pitch = self.constraints.frame[owned], network.pitch
        place = network.node_position[owned] - network.origin
        lattice = network.to_yarn(place) / pitch
        warp = network.node_family[owned] == 0
        values, slopes = np.zeros((len(warp), d, 3)), np.zeros((len(warp), d, 2))
        values[:, :2, :2] = frame
        if d == 3:
            # Rotation of a warp yarn: d u_weft/d warp; of a weft yarn: -d u_warp/d weft.
            slopes[warp, 2, 0] = self.length_scale / pitch[0]
            slopes[~warp, 2, 1] = -self.length_scale / pitch[1]
        else:
            values[:, :, 2] = self.turning_squares()[owned] / (0.5 * pitch.mean())
        values[~self.free[owned]] = 0.0
        slopes[~self.free[owned]] = 0.0

        line = np.full((len(warp), 2), -1, np.int32)
        low = network.partition.box[:, 0].min(axis=0)  # numbers of yarns from 0 up
        number = np.round(lattice).astype(np.int32) - low
        line[warp, 0], line[~warp, 1] = number[warp, 1], number[~warp, 0]
        # Ends on the outline lie on the crossing yarn, too, at its crossover.
        edge = network.boundary_crossovers
        for arm in range(4):
            ends = edge[~network.arm_is_shared[edge, arm]]
            line[network.arm_node[ends, arm]] = (network.crossover_ij[ends] - low)[:, ::-1]
        return Unknowns(
            np.repeat(lattice, d, axis=0),
            values.reshape(-1, 3),
            slopes.reshape(-1, 2),
            network.partition.owner,
            OnYarns(np.repeat(line, d, axis=0), np.repeat(lattice, d, axis=0)),
        )

    # -- results --------------------------------------------------------------------------------

    def crossover_fields(self, local: np.ndarray, *modes: str) -> dict[str, np.ndarray]:
        """Fields at the crossovers from node values (ghosts filled). Collective.

        Returns
        -------
        dict with, in metres, radians, N/m and J:
            displacement (n, 2) in x, y; arm_strain (n, 4); arm_rotation (n, 4);
            warp_strain, weft_strain, warp_tension, weft_tension (n,), means over the quadrants;
            shear_angle (n,) of the yarns at the hinge, see Supports.hinge_share; tension_energy,
            shear_energy, bending_energy (n,); carrying (n,) bool.
        """
        network, fabric = self.network, self.network.fabric
        n = network.num_crossovers_owned
        fields = {"displacement": np.zeros((n, 2))}
        fields |= {name: np.zeros((n, 4)) for name in ("arm_strain", "arm_rotation")}
        area = np.zeros((n, 4))
        energy = {mode: np.zeros(n) for mode in MODES}
        for group, (_, recovery) in zip(self.groups, self._condense(modes), strict=True):
            kept = self._element_values(group, local)
            u = np.concatenate([kept, _times(recovery, kept)], axis=1)
            for mode, matrix in group.parts.items():
                energy[mode][group.rows] = 0.5 * np.einsum("ej,ej->e", _times(matrix, u), u)
            for name, measure in group.measures.items():
                fields[name][group.rows] = _times(measure, u)
            area[group.rows] = group.area
        shares = area / np.maximum(area.sum(axis=1, keepdims=True), 1e-300)
        strain = fields["arm_strain"]
        share = np.full((n, 4), 0.5)
        share[network.boundary_crossovers] = self.supports.hinge_share
        turned = share * fields["arm_rotation"]
        warp = np.einsum("eq,eq->e", shares, strain[:, [0, 2, 2, 0]])
        weft = np.einsum("eq,eq->e", shares, strain[:, [1, 1, 3, 3]])
        self._follow(fields["displacement"], fields["arm_rotation"], local)
        fields["displacement"] = network.to_lab(fields["displacement"])
        return fields | {
            "warp_strain": warp,
            "weft_strain": weft,
            "warp_tension": fabric.c11 * warp + fabric.c12 * weft,
            "weft_tension": fabric.c22 * weft + fabric.c12 * warp,
            "shear_angle": turned[:, ::2].sum(axis=1) - turned[:, 1::2].sum(axis=1),
            **{f"{mode}_energy": value for mode, value in energy.items()},
            "carrying": self.supports.carrying.copy(),
        }

    def node_displacement(self, local: np.ndarray, fields: dict) -> np.ndarray:
        """Displacement of all local nodes in x, y (n_local, 2), those without unknowns included.

        Collective. ``fields`` as returned by crossover_fields.
        """
        hinge = self.network.to_yarn(fields["displacement"])
        return self.network.to_lab(self._follow(hinge, fields["arm_rotation"].copy(), local))

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

        rounds = most(network.comm, supports.round_, initial=0)
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


def _largest(matrix: np.ndarray) -> np.ndarray:
    """Size of each matrix's largest entry, (m, 1, 1); not zero."""
    return np.maximum(abs(matrix).max(axis=(1, 2), keepdims=True), np.finfo(float).tiny)


def _through(rows: np.ndarray, matrix: np.ndarray) -> np.ndarray:
    """Matrices (m, k, k) on what ``rows`` (m, k, n) give of other unknowns, on these; (m, n, n)."""
    return np.swapaxes(rows, 1, 2) @ matrix @ rows


def _times(matrix: np.ndarray, u: np.ndarray) -> np.ndarray:
    """Products of matrices (m or 1, i, j) and vectors (m, j); (m, i)."""
    return u @ matrix[0].T if len(matrix) == 1 else np.einsum("eij,ej->ei", matrix, u)
