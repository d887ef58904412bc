# SPDX-License-Identifier: MIT
"""Linear systems with PETSc's KSP, set up by size and by the options database."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import Protocol

import numpy as np
from petsc4py import PETSc

from ..errors import InputError, SolverError

PREFIX = "cruciform_"
# Up to here a sparse Cholesky factorisation is faster than any general iteration (planar graphs
# fill in little), and its memory stays below some 2 GiB.
DIRECT_LIMIT = 400_000

# Least energy of a motion, over that of the matrix diagonal, of a matrix that is not singular.
# Sound networks have 1e-10 and more (E/G = 1e6, or strips of 1 : 50), mechanisms some 1e-16.
SOFTEST = 1e-13

DIRECT = {
    "ksp_type": "preonly",
    "pc_type": "cholesky",
    "pc_factor_mat_solver_type": "mumps",
}
ITERATIVE = {
    "ksp_type": "cg",
    "ksp_rtol": 1e-9,
    "ksp_max_it": 2000,
    "ksp_norm_type": "unpreconditioned",
    "pc_type": "gamg",
    # Smoothers for GAMG and for the yarn multigrid: stiff yarns (E/G of hundreds and more) need
    # more than Jacobi, and the ordering by yarn makes ICC a good one.
    "mg_levels_ksp_type": "chebyshev",
    "mg_levels_ksp_max_it": 2,
    "mg_levels_pc_type": "bjacobi",
    "mg_levels_sub_pc_type": "icc",
    "mg_levels_sub_pc_factor_shift_type": "positive_definite",
}
_STEPS = "mg_levels_ksp_max_it"
YARN_MULTIGRID = {key: value for key, value in ITERATIVE.items() if key != _STEPS} | {
    "pc_type": "mg",
    "pc_mg_cycle_type": "v",
    "mg_coarse_ksp_type": "preonly",
    "mg_coarse_pc_type": "cholesky",
    "mg_coarse_pc_factor_mat_solver_type": "mumps",
    # Room for MUMPS' work arrays, per cent: in parallel it sometimes needs more than it foresees.
    "mg_coarse_mat_mumps_icntl_14": 300,
}
# What the paper's separate systems need: singular matrices and loads that they cannot carry whole.
# LSQR from zero gives the solution of least squares with the smallest norm.
LEAST_NORM = {
    "ksp_type": "lsqr",
    "ksp_rtol": 1e-10,
    "ksp_max_it": 100_000,
    "pc_type": "none",
}


class Smoother(Protocol):
    """A smoother of the finest level that is not PETSc's own: yarns.YarnSmoother."""

    def attach(self, pc: PETSc.PC, level: int, sweeps: int) -> None:
        """Make it the smoother of a level of a PCMG."""


@dataclass
class Hierarchy:
    """A geometric multigrid's coarse levels. LinearSolver frees all of it.

    Attributes
    ----------
    interpolations, matrices : lists of PETSc.Mat
        Finest first; matrices of the coarse levels.
    smoother : Smoother, optional
        Of the finest level; without it PETSc's, by options.
    sweeps : int
        Of this smoother, before and after; -mg_yarn_sweeps overrules it, 0 takes PETSc's.
    """

    interpolations: list[PETSc.Mat]
    matrices: list[PETSc.Mat]
    smoother: Smoother | None = None
    sweeps: int = 1


@dataclass
class SolverInfo:
    """How a system was solved; times of set-up and solution in seconds."""

    ksp: str
    pc: str
    iterations: int
    reason: str
    relative_residual: float
    unknowns: int
    history: list[float] = field(default_factory=list, repr=False)
    setup_s: float = 0.0
    solution_s: float = 0.0


@contextmanager
def petsc_options(prefix: str, options: Mapping[str, object]) -> Iterator[None]:
    """Options under a prefix for a while; what the user has set on the command line wins."""
    database = PETSc.Options()
    mine = {f"{prefix}{name}": value for name, value in options.items()}
    mine = {name: value for name, value in mine.items() if not database.hasName(name)}
    for name, value in mine.items():
        database[name] = value
    try:
        yield
    finally:
        for name in mine:
            database.delValue(name)


def set_from_options(
    solver: PETSc.KSP | PETSc.SNES, prefix: str, options: Mapping[str, object]
) -> None:
    """Set a solver up from the options database, in which the options are by now. Collective.

    Raises InputError on every rank if PETSc does not know a type, or does not understand a value.
    """
    try:
        solver.setFromOptions()
        return
    except PETSc.Error as error:
        refused = error
    database = PETSc.Options(prefix)
    source = "solver.options or the command line" if prefix == PREFIX else "the command line"
    for name, kind in (("snes_type", PETSc.SNES), ("ksp_type", PETSc.KSP), ("pc_type", PETSc.PC)):
        given = database.getString(name, str(options.get(name, "")))
        if not given or (kind is PETSc.SNES and not isinstance(solver, PETSc.SNES)):
            continue
        probe = kind().create(PETSc.COMM_SELF)
        try:
            probe.setType(given)
        except PETSc.Error as error:
            known = {"snes_type": "newtonls", "ksp_type": "cg", "pc_type": "cholesky"}[name]
            raise InputError(
                f"-{prefix}{name} (from {source}) is '{given}', which this PETSc does not have: "
                f"'{known}' would do"
            ) from error
        finally:
            probe.destroy()
    raise InputError(
        f"PETSc does not accept one of the options -{prefix}... (from {source}; PETSc error "
        f"{refused.ierr}): correct it or leave it out"
    ) from refused


def reason_name(reason: int) -> str:
    """PETSc's name of a converged (or diverged) reason."""
    for name, value in vars(PETSc.KSP.ConvergedReason).items():
        if value == reason and name.isupper() and name not in ("ITERATING", "CONVERGED_ITERATING"):
            return name
    return str(reason)


class LinearSolver:
    """A KSP on one matrix. Collective; call destroy when done.

    Parameters
    ----------
    matrix : PETSc.Mat
    near_null : float (n_owned_unknowns, m) or callable that gives it, optional
        Motions that cost (nearly) no energy; asked for by algebraic multigrid only.
    options : mapping, optional
        PETSc options under the prefix. By default: DIRECT for small systems, YARN_MULTIGRID (or
        ITERATIVE where there are no interpolations) for large ones.
    extra : mapping, optional
        Further options (of a case file) that overrule these.
    prefix : str
        Options prefix: ``-cruciform_ksp_type ...`` on the command line overrules all.
    multigrid : callable, optional
        Gives the Hierarchy of a geometric multigrid for the matrix; called if the preconditioner
        is PETSc's ``mg``.
    """

    def __init__(
        self,
        matrix: PETSc.Mat,
        near_null: np.ndarray | Callable[[], np.ndarray] | None = None,
        options: Mapping[str, object] | None = None,
        extra: Mapping[str, object] | None = None,
        prefix: str = PREFIX,
        multigrid: Callable[[PETSc.Mat], Hierarchy] | None = None,
    ):
        self.matrix = matrix
        begin = time.perf_counter()
        extra = dict(extra or {})
        if options is None:
            kinds: dict[str, dict] = {"mg": YARN_MULTIGRID, "cholesky": DIRECT, "lu": DIRECT}
            default = "cholesky" if matrix.getSize()[0] <= DIRECT_LIMIT else "mg"
            # What is asked for on the command line brings its own defaults, too.
            asked = PETSc.Options(prefix).getString("pc_type", str(extra.get("pc_type", default)))
            options = kinds.get(asked, ITERATIVE)
            if asked == "mg" and multigrid is None:
                options = ITERATIVE
        options = {**(options or {}), **extra}
        kind = PETSc.Options(prefix).getString("pc_type", str(options.get("pc_type", "")))
        if near_null is not None and kind == "gamg":
            columns = near_null() if callable(near_null) else near_null
            space = near_null_space(columns, matrix.comm.tompi4py())
            matrix.setNearNullSpace(space)
            space.destroy()
        self.ksp = PETSc.KSP().create(matrix.comm)
        self.ksp.setOptionsPrefix(prefix)
        self.ksp.setOperators(matrix)
        self.ksp.setConvergenceHistory(length=10_000)
        self._checked = False
        self._smoother: Smoother | None = None
        if kind == "mg":
            # Coarse levels: incomplete factors that are cut between ranks take a second step.
            options.setdefault(_STEPS, 1 if matrix.comm.size == 1 else 2)
        with petsc_options(prefix, options):
            set_from_options(self.ksp, prefix, options)
            if kind == "mg" and multigrid is not None:
                self._attach(multigrid(matrix), prefix)
            try:
                self.ksp.setUp()
            except PETSc.Error as error:
                raise SolverError(
                    f"the preconditioner '{self.ksp.getPC().getType()}' could not be set up "
                    f"(PETSc error {error.ierr})",
                    "SETUP",
                ) from error
        self._setup_s = time.perf_counter() - begin

    def _attach(self, hierarchy: Hierarchy, prefix: str) -> None:
        """Hand the levels to PCMG."""
        pc, top = self.ksp.getPC(), len(hierarchy.interpolations)
        if hierarchy.matrices:
            _lift(hierarchy.matrices[-1])
        pc.setType(PETSc.PC.Type.MG)
        pc.setMGLevels(top + 1)
        for level, (interpolation, matrix) in enumerate(
            zip(reversed(hierarchy.interpolations), reversed(hierarchy.matrices), strict=True)
        ):
            pc.setMGInterpolation(level + 1, interpolation)
            (pc.getMGSmoother(level) if level else pc.getMGCoarseSolve()).setOperators(matrix)
            interpolation.destroy()  # PETSc keeps its own references
            matrix.destroy()
        self._smoother = hierarchy.smoother
        sweeps = PETSc.Options(prefix).getInt("mg_yarn_sweeps", hierarchy.sweeps)
        if self._smoother is not None and sweeps > 0 and top:
            self._smoother.attach(pc, top, sweeps)

    def solve(self, rhs: PETSc.Vec, singular: bool = False) -> tuple[PETSc.Vec, SolverInfo]:
        """Solution and how it was reached. Collective.

        With ``singular`` the residual may keep a part that the matrix cannot carry.
        Raises SolverError on every rank, with reason and history, if the iteration fails.
        """
        x = rhs.duplicate()
        begin = time.perf_counter()
        self.ksp.setInitialGuessNonzero(False)
        self.ksp.solve(rhs, x)
        solution_s = time.perf_counter() - begin
        reason = self.ksp.getConvergedReason()
        history = [float(value) for value in self.ksp.getConvergenceHistory()]
        residual = rhs.duplicate()
        self.matrix.mult(x, residual)
        residual.aypx(-1.0, rhs)
        norm = rhs.norm()
        relative = residual.norm() / norm if norm != 0 else 0.0  # a norm may be NaN
        residual.destroy()
        info = SolverInfo(
            self.ksp.getType(),
            self.ksp.getPC().getType(),
            self.ksp.getIterationNumber(),
            reason_name(reason),
            float(relative),
            int(self.matrix.getSize()[0]),
            history,
            self._setup_s,
            solution_s,
        )
        if not singular and info.ksp == PETSc.KSP.Type.PREONLY:
            if info.reason == "DIVERGED_PCSETUP_FAILED":  # rounding left a pivot of just zero
                raise _mechanism("a pivot of zero")
            if reason >= 0:
                self._refuse_mechanism()
        # A direct solver knows no residual: look at the true one.
        if reason < 0 or not np.isfinite(relative) or (relative > 1e-3 and not singular):
            what = f"{info.ksp} with {info.pc} did not converge ({info.reason}"
            raise SolverError(
                f"{what} after {info.iterations} iterations, relative residual {relative:.2e}): "
                "is a part of the preform free to move? Try yarn bending or another solver",
                info.reason,
                history,
            )
        return x, info

    def _refuse_mechanism(self) -> None:
        """Raise SolverError if some motion costs no energy. Collective.

        A factorisation with rounded pivots goes through a singular matrix and adds any amount of
        such a motion to the solution. Two inverse iterations find it.
        """
        if self._checked:
            return
        diagonal = self.matrix.getDiagonal()
        diagonal.abs()
        x, y = diagonal.duplicate(), diagonal.duplicate()
        begin, end = x.getOwnershipRange()
        x.setArray(np.cos(np.arange(begin, end) ** 2))  # some of every motion
        for _ in range(2):
            y.pointwiseMult(diagonal, x)
            self.ksp.solve(y, x)
            y.pointwiseMult(diagonal, x)
            x.scale(1.0 / np.sqrt(x.dot(y)))
        self.matrix.mult(x, y)
        stiffness = x.dot(y)
        for vector in (x, y, diagonal):
            vector.destroy()
        if not stiffness > SOFTEST:
            raise _mechanism(f"stiffness {stiffness:.0e} of the diagonal's")
        self._checked = True

    def destroy(self) -> None:
        """Free the KSP (not the matrix)."""
        self.ksp.destroy()


def _mechanism(sign: str) -> SolverError:
    return SolverError(
        f"a part of the preform can move without deforming ({sign}): without yarn bending a net "
        "does where it is one or two crossovers wide, and as a whole where no clamp keeps its "
        "crossovers from turning; switch bending on, refine, or clamp more",
        "MECHANISM",
    )


def _lift(matrix: PETSc.Mat) -> None:
    """Add a little of its own to the diagonal of the coarsest matrix. Collective.

    Two coarse unknowns at the outline may hang on the same finer ones. Their difference moves
    nothing: the matrix is singular, and right sides have no part in it.
    """
    diagonal = matrix.getDiagonal()
    diagonal.scale(1e-10)
    matrix.setDiagonal(diagonal, PETSc.InsertMode.ADD_VALUES)
    diagonal.destroy()


def near_null_space(columns: np.ndarray, comm) -> PETSc.NullSpace:
    """Space of motions that cost (nearly) no energy, for algebraic multigrid. Collective.

    columns : float (n_owned_unknowns, m); the caller destroys the space.
    """
    vectors = [
        PETSc.Vec().createWithArray(column.copy(), comm=comm)
        for column in _orthonormal(columns, comm)
    ]
    space = PETSc.NullSpace().create(vectors=vectors, comm=comm)
    for vector in vectors:
        vector.destroy()
    return space


def _orthonormal(columns: np.ndarray, comm) -> np.ndarray:
    """Orthonormal rows that span the distributed columns (n, m); Cholesky of the Gram matrix."""
    scaled = columns / np.sqrt(comm.allreduce((columns**2).sum(axis=0)))
    gram = comm.allreduce(scaled.T @ scaled)
    return np.linalg.solve(np.linalg.cholesky(gram), scaled.T)
