# SPDX-License-Identifier: MIT
"""Multigrid for cloth in space: splines on lattices of twice the pitch, whole yarns as smoother.

Cloth bends a thousand times more softly than it stretches, and on a curved surface the one goes
with the other: a displacement along a yarn that is not to stretch it needs one along the normal,
which turns as the yarn does. Two things follow.

Coarse displacements have to be smooth: bilinear ones have kinks, and stretch yarns between coarse
points wherever these are curved. Here all three components, the normal one as well as those along
warp and weft, are quadratic B-splines (continuous slopes, so that bending is the coarse cloth's
own) on lattices of twice, four times ... the pitch, along the axes that the cloth had when it lay
flat: translations are among them exactly, and turns of any state nearly. Hoellig, Reif and Wipper
2001, SIAM J. Numer. Anal. 39:442, take B-splines on a lattice for finite elements.

The smoother takes yarns whole, in all unknowns at once: two neighbouring yarns with all that lies
between them make a strip, in which stretch, bending in and out of the plane, contact and friction
are solved exactly; strips of both families add up (additive Schwarz, PETSc's PCASM), scaled by the
largest eigenvalue. Patches of some yarns each way took three times as many iterations: what is
stiff reaches along a whole yarn. Where ranks meet strips are cut, with an overlap of what the
matrix couples. Rigid bodies, which tools' nodes stand for, are strips and coarse unknowns of their
own.

Coarse matrices are Galerkin products. A matrix of which a strip's part or the coarsest one has a
negative eigenvalue has one itself (Cauchy's interlacing): that is told; PETSc's CG tells of what it
meets besides.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numba
import numpy as np
from mpi4py import MPI
from petsc4py import PETSc

from ..errors import SolverError
from ..parallel import Halo, ask, find_sorted
from .callbacks import callback
from .csr import aij, local_rows
from .options import petsc_options

COARSEST = 60_000  # unknowns that are left to a direct solver
_EDGE = 1e-6  # of a step: points lie on a yarn
_SMALL = 1e-9  # of an axis: what is less is none
_HALF = 1 << 27  # of lattice coordinates
_INT = np.dtype(PETSc.IntType).type
SMOOTHER = {
    "mg_levels_ksp_type": "chebyshev",  # a step of it: what PCASM gives, scaled
    "mg_levels_ksp_max_it": 1,
    # Six steps of CG find the largest eigenvalue to a tenth; up to twice as large would do no harm.
    "mg_levels_ksp_chebyshev_esteig_steps": 6,
    "mg_levels_ksp_chebyshev_esteig": "0,0.5,0,1.1",
    "mg_levels_esteig_ksp_type": "cg",
    "mg_levels_pc_asm_type": "basic",
    "mg_levels_sub_pc_type": "cholesky",
}


@dataclass
class Points:
    """Nodes of one level that this rank owns, three unknowns each, in the order of matrix rows."""

    # Ranks that own points of each lattice, int (m, 2) -> int (m,), also outside the cloth.
    owners: Sequence[Callable[[np.ndarray], np.ndarray]]
    lattice: np.ndarray  # int (n,), which one each lies on; -1 for a body, which lies on none
    place: np.ndarray  # float (n, 2), on its lattice, in fine steps
    axes: np.ndarray  # float (n, 3, 3): rows, axes of its unknowns, along those of its lattice


@dataclass
class InSpace:
    """A multigrid in space, as a model has it: what gives the Points of its matrices' rows."""

    points: Callable[[], Points]


def interpolation(
    comm: MPI.Intracomm, fine: Points, free: np.ndarray, step: int
) -> tuple[PETSc.Mat, Points]:
    """Interpolation from the splines on lattices of ``step`` to the points. Collective.

    Of unknowns that are not ``free``, bool (n, 3), rows are zero; they have the same entries.
    """
    body = np.flatnonzero(fine.lattice < 0)
    cloth = np.flatnonzero(fine.lattice >= 0)
    nearest = np.round(fine.place[cloth] / step).astype(np.int64)
    weight, around = _quadratic(fine.place[cloth] / step - nearest)
    asked = _pack(fine.lattice[cloth, None], nearest[:, None] + around)
    # Bodies go by a name that no other rank has.
    names = _pack(-1, np.column_stack([np.full(len(body), comm.rank), body]))
    keys, at = np.unique(np.concatenate([asked.ravel(), names]), return_inverse=True)
    number, owned = _number(comm, keys, _owners(comm, fine.owners, keys, step))
    lattice, coarse = _unpack(owned)
    points = Points(
        fine.owners,
        lattice,
        np.where(lattice[:, None] >= 0, coarse * float(step), 0.0),
        np.tile(np.eye(3), (len(owned), 1, 1)),
    )
    node = np.concatenate([np.repeat(cloth, 9), body])
    share = np.concatenate([weight.ravel(), np.ones(len(body))])
    axes = np.where(abs(fine.axes) > _SMALL, fine.axes, 0.0)[node]
    entry, row, column = np.nonzero(axes)
    value = share[entry] * axes[entry, row, column] * free[node[entry], row]
    rows, columns = 3 * node[entry] + row, 3 * number[at[entry]] + column
    shape = 3 * len(fine.place), 3 * comm.allreduce(len(owned))
    # Zeros are kept: the pattern does not depend on what is free.
    order = np.lexsort((columns, rows))
    pointer = np.searchsorted(rows[order], np.arange(shape[0] + 1))
    local = shape[0], 3 * len(owned)
    return aij(comm, local, pointer, columns[order], value[order], 3), points


def _quadratic(offset: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Of points (n, 2) by their offsets from the nearest lattice points: values of nine splines.

    Returns (n, 9) and the splines' centres (9, 2) as seen from the nearest points. De Boor 1978,
    A Practical Guide to Splines, chapter IX: uniform knots half-way between lattice points.
    """
    low, high = 0.5 * (0.5 - offset) ** 2, 0.5 * (0.5 + offset) ** 2
    each = np.stack([low, 0.75 - offset**2, high], axis=-1)
    weight = each[:, 0, :, None] * each[:, 1, None, :]
    around = np.stack(np.meshgrid((-1, 0, 1), (-1, 0, 1), indexing="ij"), axis=-1)
    return weight.reshape(-1, 9), around.reshape(9, 2)


def _pack(lattice, point: np.ndarray) -> np.ndarray:
    """Keys of lattice points (..., 2)."""
    i, j = point[..., 0] + _HALF, point[..., 1] + _HALF
    return (np.asarray(lattice, np.int64) + 1 << 56) + (i << 28) + j


def _unpack(key: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    i, j = (key >> 28) & (2 * _HALF - 1), key & (2 * _HALF - 1)
    return (key >> 56) - 1, np.stack([i, j], axis=-1) - _HALF


def _owners(comm, lattices: Sequence[Callable], keys: np.ndarray, step: int) -> np.ndarray:
    """Ranks that own splines; bodies stay where they are."""
    lattice, point = _unpack(keys)
    owner = np.full(len(keys), comm.rank)
    for k, each in enumerate(lattices):
        mine = lattice == k
        owner[mine] = each(point[mine] * step)
    return owner


def _number(comm, keys: np.ndarray, owner: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Global numbers of keys (n,), and this rank's keys, in their order. Collective."""
    owned = np.zeros(0, np.int64)

    def numbers(asked: np.ndarray) -> np.ndarray:
        nonlocal owned
        owned = np.unique(asked)
        return find_sorted(owned, asked) + (comm.exscan(len(owned)) or 0)

    return ask(comm, owner, keys, numbers), owned


# -- strips ------------------------------------------------------------------------------------


def strips(matrix: PETSc.Mat, points: Points, step: int) -> list[PETSc.IS]:
    """Rows of the strips that this rank solves, in which each of its own is at least once.

    Collective. Strips go on over the points of other ranks that the matrix couples to.
    """
    comm, n = matrix.comm.tompi4py(), len(points.place)
    cloth = points.lattice >= 0
    with local_rows(matrix) as rows:
        # Bodies are coupled to all that touches them.
        own = np.repeat(np.repeat(cloth, 3), np.diff(rows.ghost_pointer))
        ghost = np.unique(rows.ghost[np.unique(rows.ghost_column[own])] // 3)
    halo = Halo.of_numbers(comm, n, ghost)
    number = np.arange(n + len(ghost)) + (comm.exscan(n) or 0)
    number[n:] = ghost
    lattice, place = np.full(len(number), -1), np.zeros((len(number), 2))
    lattice[:n], place[:n] = points.lattice, points.place / step
    halo.forward(lattice)
    halo.forward(place)
    # Each point lies between two yarns, or on one and then in two strips.
    names = [
        _pack(2 * lattice + family, np.column_stack([line, 0 * line]).astype(np.int64))
        for family in (0, 1)
        for along in [place[:, 1 - family]]
        for line in (np.floor(along + _EDGE), np.ceil(along - _EDGE) - 1)
    ]
    point = np.tile(np.arange(len(number)), len(names))
    name = np.concatenate(names)
    here = np.flatnonzero(lattice[point] >= 0)
    pair = np.unique(np.column_stack([name[here], number[point[here]]]), axis=0)
    mine = here[point[here] < n]
    pair = pair[np.isin(pair[:, 0], name[mine])]
    found = np.split(pair[:, 1], np.flatnonzero(np.diff(pair[:, 0])) + 1) if len(pair) else []
    found += [number[k : k + 1] for k in np.flatnonzero(~cloth)]
    return [
        PETSc.IS().createGeneral(
            (3 * part[:, None] + np.arange(3)).ravel().astype(_INT), comm=MPI.COMM_SELF
        )
        for part in found
    ]


# -- levels ------------------------------------------------------------------------------------


@numba.njit(cache=True)
def _coupled(pointer, column, value, ghost_pointer, ghost_value, result):
    """Note of each row whether it has an entry beside the diagonal."""
    for r in range(len(result)):
        found = False
        for e in range(pointer[r], pointer[r + 1]):
            if value[e] != 0.0 and column[e] != r:
                found = True
                break
        if not found:
            for e in range(ghost_pointer[r], ghost_pointer[r + 1]):
                if ghost_value[e] != 0.0:
                    found = True
                    break
        result[r] = found


class SplineMultigrid:
    """Preconditioner of type python: a cycle of the multigrid; levels are made once. Collective.

    Where what is prescribed changes, or the pattern of the matrix, they are made anew; else only
    their values are. ``definite`` is false if the matrix is known to have a negative eigenvalue.

    Parameters
    ----------
    points : callable
        Gives the Points of the matrix's rows.
    options : mapping
        PETSc's, of which those of the levels count.
    prefix : str
    """

    def __init__(self, points: Callable[[], Points], options, prefix: str):
        self._points, self._options, self.prefix = points, options, prefix
        self.definite = True
        self._pc: PETSc.PC | None = None
        self._fine: PETSc.Mat | None = None
        self._free = np.zeros((0, 3), bool)
        self._interpolations: list[PETSc.Mat] = []
        self._matrices: list[PETSc.Mat] = []

    @callback
    def setUp(self, pc: PETSc.PC) -> None:
        """Coarse levels and smoothers for the matrix that the preconditioner has now."""
        matrix, _ = pc.getOperators()
        comm = matrix.comm.tompi4py()
        free = np.empty(matrix.getLocalSize()[0], bool)
        with local_rows(matrix) as rows:
            _coupled(rows.pointer, rows.column, rows.value, rows.ghost_pointer,
                     rows.ghost_value, free)  # fmt: skip
        free = free.reshape(-1, 3)
        same = self._fine is not None and self._fine == matrix and np.array_equal(self._free, free)
        with petsc_options(self.prefix, self._options):
            if comm.allreduce(same, MPI.LAND):
                level = matrix
                for prolongation, coarse in zip(self._interpolations, self._matrices, strict=True):
                    level.ptap(prolongation, coarse)
                    _lift(coarse)
                    level = coarse
            else:
                self.free()
                self._fine, self._free = matrix, free
                self._make(comm, matrix, free)
            assert self._pc is not None
            self._pc.setUp()
            # Factors, which PETSc would make when they are asked for first.
            for inner in self._inner():
                inner.setUp()
                inner.setUpOnBlocks()
        self.definite = self._is_definite(comm)
        reasons = PETSc.PC.FailedReason
        pc.setFailedReason(reasons.NOERROR if self.definite else reasons.FACTOR_OTHER)

    def _make(self, comm: MPI.Intracomm, matrix: PETSc.Mat, free: np.ndarray) -> None:
        points, level, step = self._points(), matrix, 1
        parts = []
        while not self._matrices or level.getSize()[0] > COARSEST:
            prolongation, coarse = interpolation(comm, points, free, 2 * step)
            rows, columns = prolongation.getSize()
            if self._matrices and columns > 0.7 * rows:
                prolongation.destroy()  # cloth of few yarns: nothing to gain
                break
            parts.append(strips(level, points, step))
            product = level.ptap(prolongation)
            product.setOption(PETSc.Mat.Option.SYMMETRIC, True)
            product.setOption(PETSc.Mat.Option.SYMMETRY_ETERNAL, True)
            _lift(product)
            self._interpolations.append(prolongation)
            self._matrices.append(product)
            points, level, step = coarse, product, 2 * step
            free = np.ones((len(points.place), 3), bool)
        self._pc = pc = PETSc.PC().create(comm)
        pc.setOptionsPrefix(self.prefix)
        pc.setType(PETSc.PC.Type.MG)
        pc.setMGLevels(len(parts) + 1)
        pc.setOperators(matrix)
        levels = [matrix, *self._matrices]
        for k, (operator, prolongation, part) in enumerate(
            zip(levels, self._interpolations, parts, strict=False)
        ):
            at = len(parts) - k
            pc.setMGInterpolation(at, prolongation)
            smoother = pc.getMGSmoother(at)
            smoother.setOperators(operator)
            inner = smoother.getPC()
            inner.setType(PETSc.PC.Type.ASM)
            inner.setASMLocalSubdomains(len(part), part)
            for rows in part:
                rows.destroy()
        pc.getMGCoarseSolve().setOperators(levels[-1])
        pc.setFromOptions()

    def _inner(self) -> list[PETSc.PC]:
        """Preconditioners of the coarsest level and of the others' smoothers."""
        pc = self._pc
        assert pc is not None
        smoothers = (pc.getMGSmoother(level) for level in range(1, pc.getMGLevels()))
        return [ksp.getPC() for ksp in (pc.getMGCoarseSolve(), *smoothers)]

    def _is_definite(self, comm: MPI.Intracomm) -> bool:
        """Whether no strip, nor the coarsest level, has a negative eigenvalue, if that is told."""
        coarse, *smoothers = self._inner()
        negative = 0
        for inner in smoothers:
            if inner.getType() != PETSc.PC.Type.ASM:
                continue
            for sub in inner.getASMSubKSP():
                each = sub.getPC()
                if each.getType() == PETSc.PC.Type.CHOLESKY:
                    negative += each.getFactorMatrix().getInertia()[0]
        if coarse.getType() == "cholesky" and coarse.getFactorSolverType() == "mumps":
            negative += coarse.getFactorMatrix().getMumpsInfog(12)
        return comm.allreduce(negative) == 0

    @callback
    def apply(self, _pc: PETSc.PC, x: PETSc.Vec, y: PETSc.Vec) -> None:
        """One cycle."""
        assert self._pc is not None
        self._pc.apply(x, y)

    def free(self) -> None:
        """Free the levels."""
        for thing in (self._pc, *self._interpolations, *self._matrices):
            if thing is not None:
                thing.destroy()
        self._pc, self._interpolations, self._matrices, self._fine = None, [], [], None

    def destroy(self, _pc: PETSc.PC) -> None:
        """Free the levels."""
        self.free()


def check_iterations(ksp: PETSc.KSP) -> None:
    """Raise SolverError if CG with the multigrid has used up its steps. Collective."""
    if ksp.getConvergedReason() == PETSc.KSP.ConvergedReason.DIVERGED_MAX_IT:
        raise SolverError(
            f"the multigrid has not converged in {ksp.getIterationNumber()} iterations "
            "(-cruciform_ksp_max_it): a direct solver may do (-cruciform_pc_type cholesky)",
            "DIVERGED_MAX_IT",
        )


def _lift(matrix: PETSc.Mat) -> None:
    """Add a little of its own to the diagonal of a coarse matrix; what is zero gets the mean.

    Splines that reach the cloth with their outermost parts only are nearly combinations of others.
    Collective.
    """
    diagonal = matrix.getDiagonal()
    mean = diagonal.sum() / diagonal.getSize()
    entries = diagonal.getArray()
    entries[:] = np.where(entries != 0.0, 1e-10 * abs(entries), mean)
    matrix.setDiagonal(diagonal, PETSc.InsertMode.ADD_VALUES)
    diagonal.destroy()
