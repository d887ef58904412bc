# SPDX-License-Identifier: MIT
"""Linear systems with PETSc's KSP, and refusal of what can move without deforming."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

import numpy as np
from petsc4py import PETSc

from ..errors import SolverError
from .callbacks import calling_back
from .failures import check_factor
from .multigrid import Hierarchy
from .options import (
    CYCLE,
    DIRECT,
    DIRECT_LIMIT,
    ITERATIVE,
    PREFIX,
    STEPS,
    YARN_MULTIGRID,
    near_null_space,
    petsc_options,
    reason_name,
    set_from_options,
)

# Least energy of a motion, over that of the matrix diagonal, of a matrix that is not singular.
# Sound networks have 1e-10 and more (E/G = 1e6, or strips of 1 : 50), mechanisms some 1e-16.
SOFTEST = 1e-13


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


class LinearSolver:
    """A KSP on one matrix. Collective; call destroy when done.

    Parameters
    ----------
    near_null : float (n_owned_unknowns, m) or callable that gives it, optional
        Motions that cost (nearly) no energy; asked for by algebraic multigrid only.
    options : mapping, optional
        PETSc options under the prefix. By default: DIRECT for small systems, YARN_MULTIGRID (or
        ITERATIVE where there are no interpolations) for large ones.
    extra : mapping, optional
        Further options (of a case file) that overrule these; ``-cruciform_ksp_type ...`` on the
        command line overrules all.
    multigrid : callable, optional
        Gives the Hierarchy of a geometric multigrid; called for PETSc's ``mg`` only.
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
        extra, database = dict(extra or {}), PETSc.Options(prefix)
        if options is None:
            by_size = "cholesky" if matrix.getSize()[0] <= DIRECT_LIMIT else "mg"
            kind = database.getString("pc_type", str(extra.get("pc_type", by_size)))
            if kind in ("cholesky", "lu"):
                options = DIRECT
            else:
                options = YARN_MULTIGRID if kind == "mg" and multigrid is not None else ITERATIVE
        options = {**options, **extra}
        kind = database.getString("pc_type", str(options.get("pc_type", "")))
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
        if kind == "mg":
            # Coarse levels: incomplete factors that are cut between ranks take a second step, and
            # are not gone through as often as a W cycle does, for the messages.
            alone = matrix.comm.size == 1
            options = {STEPS: 1 if alone else 2, CYCLE: "w" if alone else "v"} | options
        with petsc_options(prefix, options):
            set_from_options(self.ksp, prefix, options)
            if kind == "mg" and multigrid is not None:
                self._attach(multigrid(matrix), prefix)
            with calling_back(self.ksp):
                self.ksp.setUp()
        self._setup_s = time.perf_counter() - begin

    def _attach(self, hierarchy: Hierarchy, prefix: str) -> None:
        """Hand the levels to PCMG."""
        pc, top = self.ksp.getPC(), len(hierarchy.interpolations)
        for matrix in hierarchy.matrices:
            _lift(matrix)
        pc.setType(PETSc.PC.Type.MG)
        pc.setMGLevels(top + 1)
        for level, (interpolation, matrix) in enumerate(
            zip(reversed(hierarchy.interpolations), reversed(hierarchy.matrices), strict=True)
        ):
            pc.setMGInterpolation(level + 1, interpolation)
            (pc.getMGSmoother(level) if level else pc.getMGCoarseSolve()).setOperators(matrix)
            interpolation.destroy()  # PETSc keeps its own references
            matrix.destroy()
        sweeps = PETSc.Options(prefix).getInt("mg_yarn_sweeps", hierarchy.sweeps)
        if hierarchy.smoother is not None and sweeps > 0 and top:
            hierarchy.smoother.attach(pc, top, sweeps)

    def solve(self, rhs: PETSc.Vec, singular: bool = False) -> tuple[PETSc.Vec, SolverInfo]:
        """Solution and how it was reached. Collective.

        With ``singular`` the residual may keep a part that the matrix cannot carry.
        Raises SolverError on every rank, with reason and history, if the iteration fails.
        """
        x = rhs.duplicate()
        begin = time.perf_counter()
        self.ksp.setInitialGuessNonzero(False)
        self._apply(rhs, x)
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
            check_factor(self.ksp.getPC())
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

    def _apply(self, b: PETSc.Vec, x: PETSc.Vec) -> None:
        with calling_back(self.ksp):
            self.ksp.solve(b, x)

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
            self._apply(y, x)
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
    """Add a little of its own to the diagonal of a coarse matrix. Collective.

    Two coarse unknowns at the outline may hang on the same finer ones. Their difference moves
    nothing: the matrix is singular, and right sides have no part in it but rounding, which a pivot
    of a factor, complete or not, that is rounding, too, would make as large as the rest.
    """
    diagonal = matrix.getDiagonal()
    diagonal.scale(1e-10)
    matrix.setDiagonal(diagonal, PETSc.InsertMode.ADD_VALUES)
    diagonal.destroy()
