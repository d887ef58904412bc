# SPDX-License-Identifier: MIT
"""How Newton's linear systems are solved: directly, by the yarn multigrid, or as PETSc is told."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Union

from petsc4py import PETSc

from ..solvers.callbacks import callback
from ..solvers.dissection import SMALLEST, order
from ..solvers.failures import check_factor
from ..solvers.linear import LinearSolver
from ..solvers.multigrid import Hierarchy
from ..solvers.options import (
    COUNTING,
    DIRECT_LIMIT,
    DIRECT_LIMIT_IN_SPACE,
    ITERATIVE,
    YARN_MULTIGRID,
    near_null_space,
)
from ..solvers.splines import SMOOTHER, InSpace, SplineMultigrid, check_iterations
from .model import PATTERN, Model
from .state import State

ORDERED = "ordered"  # of a matrix: that it has been looked at
OWN_ORDERING = ("mat_mumps_icntl_7", "mat_mumps_icntl_28")
STEP = 1e-6  # relative residual of iterative solvers: Newton's last step is one
Multigrid = Union["TangentMultigrid", SplineMultigrid]
IN_SPACE = {
    "ksp_type": "cg",
    "ksp_rtol": STEP,
    "ksp_max_it": 300,
    "ksp_norm_type": "unpreconditioned",
    "pc_mg_cycle_type": "v",
    **SMOOTHER,
    **{f"mg_coarse_{key}": value for key, value in COUNTING.items()},
}


def tangent_settings(
    model: Model, like: PETSc.Vec, options: Mapping[str, object] | None, prefix: str
) -> tuple[dict[str, object], Multigrid | None]:
    """Options for SNES by size and by what the preconditioner is to be; and a multigrid for it.

    ``like``: a vector of unknowns; ``options`` overrule the defaults, the database overrules all.
    """
    options = dict(options or {})
    limit = DIRECT_LIMIT_IN_SPACE if model.dim == 3 else DIRECT_LIMIT
    small = like.getSize() <= limit or model.multigrid is None
    default = str(options.get("pc_type", "cholesky" if small else "mg"))
    kind = PETSc.Options(prefix).getString("pc_type", default)
    settings: dict[str, object] = {"snes_type": "newtonls", "snes_linesearch_type": "basic"}
    if kind in ("cholesky", "lu"):
        return {**settings, **COUNTING, **options}, None
    if kind == "mg" and isinstance(model.multigrid, InSpace):
        settings |= IN_SPACE | options
        return settings, SplineMultigrid(model.multigrid.points, settings, prefix)
    if kind == "mg" and callable(model.multigrid):
        settings |= YARN_MULTIGRID | {"ksp_rtol": STEP}
        return {**settings, **options}, TangentMultigrid(model.multigrid, prefix)
    return {**settings, **ITERATIVE, "ksp_rtol": STEP, **options}, None


def fitting(snes: PETSc.SNES, matrix: PETSc.Mat, model: Model, state: State) -> PETSc.Mat:
    """The matrix, or a new one where elements have come to join other nodes. Collective."""
    if matrix.getAttr(PATTERN) is not model.pattern(state):
        space, jacobian = matrix.getNearNullSpace(), snes.getJacobian()[2][0]
        matrix.destroy()
        matrix, _ = model.stiffness(state)
        if space.handle:
            matrix.setNearNullSpace(space)
        snes.setJacobian(jacobian, matrix)
    if not matrix.getAttr(ORDERED):
        matrix.setAttr(ORDERED, True)
        _order(snes.ksp, matrix, model)
    return matrix


def _order(ksp: PETSc.KSP, matrix: PETSc.Mat, model: Model) -> None:
    """Hand MUMPS an ordering that knows where nodes lie, if none is asked for. Collective."""
    pc = ksp.getPC()
    if pc.getType() != PETSc.PC.Type.CHOLESKY or pc.getFactorSolverType() != "mumps":
        return
    wishes = PETSc.Options(ksp.getOptionsPrefix())
    if matrix.getSize()[0] < SMALLEST or any(map(wishes.hasName, OWN_ORDERING)):
        return
    pc.reset()  # what it has of another pattern
    ksp.setOperators(matrix)
    place = model.nodes.rest[: model.nodes.num_nodes_owned]
    order(pc, matrix, place, *matrix.getAttr(PATTERN).neighbours)


def prepare(ksp: PETSc.KSP, matrix: PETSc.Mat, model: Model, multigrid: Multigrid | None) -> None:
    """Attach the multigrid, or tell GAMG the motions that cost next to nothing. Collective."""
    pc = ksp.getPC()
    if multigrid is not None:
        pc.setType(PETSc.PC.Type.PYTHON)
        pc.setPythonContext(multigrid)
    elif pc.getType() == PETSc.PC.Type.GAMG:
        space = near_null_space(model.rigid_motions(), model.comm)
        matrix.setNearNullSpace(space)
        space.destroy()
    ksp.setErrorIfNotConverged(False)


def check_solved(ksp: PETSc.KSP, multigrid: Multigrid | None) -> None:
    """Raise SolverError if a factor had too little memory, or a multigrid did not converge."""
    if isinstance(multigrid, SplineMultigrid):
        check_iterations(ksp)
    else:
        check_factor(ksp.getPC())


class TangentMultigrid:
    """Preconditioner of type python: a cycle of the yarn multigrid, made anew for each tangent.

    Levels are set up by what is in the options database then.
    """

    def __init__(self, make: Callable[[PETSc.Mat], Hierarchy], prefix: str):
        self._make, self.prefix = make, prefix
        self._solver: LinearSolver | None = None

    @callback
    def setUp(self, pc: PETSc.PC) -> None:
        """Coarse levels and smoother for the matrix that the preconditioner has now."""
        self.free()
        matrix, _ = pc.getOperators()
        extra = {"pc_type": "mg"}
        self._solver = LinearSolver(matrix, extra=extra, prefix=self.prefix, multigrid=self._make)

    @callback
    def apply(self, _pc: PETSc.PC, x: PETSc.Vec, y: PETSc.Vec) -> None:
        """One cycle."""
        assert self._solver is not None
        self._solver.ksp.getPC().apply(x, y)

    def free(self) -> None:
        """Free the levels."""
        if self._solver is not None:
            self._solver.destroy()
            self._solver = None

    def destroy(self, _pc: PETSc.PC) -> None:
        """Free the levels."""
        self.free()
