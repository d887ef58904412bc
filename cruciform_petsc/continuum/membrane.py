# SPDX-License-Identifier: MIT
r"""Orthotropic plane-stress membrane in yarn axes: the continuum that the network is a net of.

With the displacement along the warp and the weft, u_w and u_e, stress resultants in N/m are

    sigma_w = c11 eps_w + c12 eps_e      eps_w = du_w/dw
    sigma_e = c12 eps_w + c22 eps_e      eps_e = du_e/de
    tau     = G gamma                    gamma = du_e/dw + du_w/de

gamma is the rotation of the warp less the rotation of the weft. The virtual work

    a(u, v) = int sigma_w(u) eps_w(v) + sigma_e(u) eps_e(v) + tau(u) gamma(v) dA = int_edges t.v ds

is solved with Lagrange elements on triangles, and loads are sums of consistent nodal forces.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import dolfinx.fem
import dolfinx.fem.petsc
import numpy as np
import ufl
from mpi4py import MPI
from petsc4py import PETSc

from ..errors import InputError
from ..solvers import linear
from ..solvers.options import DIRECT as CHOLESKY
from .domain import (
    Dirichlet,
    MembraneDomain,
    MembraneFields,
    Traction,
    default_size,
    outline_width,
    singular_points,
)

__all__ = ["Membrane", "MembraneResult", "default_size", "outline_width", "singular_points"]

# Unknowns up to which the matrix is factorised. Measured on 2 ranks, 2 million unknowns: 21 s and
# 2.1 GiB per rank against 118 s and 1.8 GiB for multigrid.
MAX_DOFS_DIRECT = 2_000_000

DIRECT = {**CHOLESKY, "mat_mumps_icntl_14": 50}
ITERATIVE = {
    "ksp_type": "cg",
    "ksp_norm_type": "unpreconditioned",
    "ksp_rtol": 1e-11,
    "ksp_max_it": 2000,
    "pc_type": "gamg",
    "pc_gamg_threshold": 0.03,
    "mg_levels_ksp_type": "chebyshev",
    "mg_levels_pc_type": "jacobi",
}


class Membrane(MembraneDomain):
    """Mesh and equations of the membrane that a preform is cut from. Collective.

    Parameters and attributes as of MembraneDomain; the fabric has `c12`, too.
    """

    def __init__(
        self,
        comm: MPI.Intracomm,
        preform: Any,
        fabric: Any,
        size: float | None = None,
        degree: int = 3,
        grading: int = 6,
    ):
        super().__init__(comm, preform, fabric, size, degree, grading)
        self._c11, self._c22, self._c12, self._shear_modulus = (
            dolfinx.fem.Constant(self.mesh, PETSc.ScalarType(value))
            for value in (fabric.c11, fabric.c22, fabric.c12, fabric.shear_modulus)
        )

    # -- mechanics ------------------------------------------------------------------------------

    def strain(self, u: Any) -> tuple[Any, Any, Any]:
        """Warp strain, weft strain and shear angle of a displacement, as UFL expressions."""
        gradient = ufl.grad(u)
        w, e = self._warp, self._weft
        return (
            ufl.inner(w, gradient * w),
            ufl.inner(e, gradient * e),
            ufl.inner(e, gradient * w) + ufl.inner(w, gradient * e),
        )

    def _tension_work(self, u: Any, v: Any) -> Any:
        warp, weft, _ = self.strain(u)
        test_warp, test_weft, _ = self.strain(v)
        return (
            (self._c11 * warp + self._c12 * weft) * test_warp
            + (self._c22 * weft + self._c12 * warp) * test_weft
        ) * ufl.dx

    def _shear_work(self, u: Any, v: Any) -> Any:
        return self._shear_modulus * self.strain(u)[2] * self.strain(v)[2] * ufl.dx

    # -- solution -------------------------------------------------------------------------------

    def solve_bias_extension(
        self, extension: float, upper: str = "grip", prefix: str = "membrane_"
    ) -> MembraneResult:
        """Clamp the edge "lower" and pull the edge "upper" along y. Collective.

        Parameters
        ----------
        extension : float
            Metres.
        upper : {"grip", "centre-line"}
            The upper edge keeps its x, or is free to move along x.
        prefix : str
            Of the PETSc options of the solver.
        """
        pulled: dict[str, Dirichlet] = {
            "grip": ("upper", None, (0.0, extension)),
            "centre-line": ("upper", 1, extension),
        }
        if upper not in pulled:
            raise InputError(f"upper = {upper!r} is not one of {', '.join(sorted(pulled))}")
        return self.solve([("lower", None, (0.0, 0.0)), pulled[upper]], prefix=prefix)

    def solve(
        self,
        dirichlet: Sequence[Dirichlet] = (),
        tractions: Sequence[Traction] = (),
        prefix: str = "membrane_",
    ) -> MembraneResult:
        """Solve for given displacements and tractions on edges. Collective.

        Without any given displacement the tractions must be in balance; three unknowns are then
        held (without reaction) to rule out rigid motion.

        Parameters
        ----------
        dirichlet : sequence of (edge name, component, value)
            Component 0, 1 or None for both. Metres: a number (two for None), or a callable that
            takes x of shape (3, n) and returns (n,) or, for None, (2, n). Later ones win.
        tractions : sequence of (edge name, (tx, ty))
            Force per length of the edge, N/m.
        prefix : str
            Of the PETSc options. Up to MAX_DOFS_DIRECT unknowns the defaults are DIRECT, beyond
            it ITERATIVE; the options database, command line included, wins over both.

        Raises
        ------
        InputError
            On every rank: unknown edge, a membrane that can float, loads out of balance.
        SolverError
            On every rank, with PETSc's reason and the residual history.
        """
        trial, test = ufl.TrialFunction(self.space), ufl.TestFunction(self.space)
        work = self._tension_work(trial, test) + self._shear_work(trial, test)
        stiffness = dolfinx.fem.form(work)
        load = dolfinx.fem.form(self._load(tractions, test))
        if not dirichlet:
            self._check_balance(load)
        conditions = self._constraints(dirichlet) if dirichlet else self._pins()
        self._check_held(conditions)

        right_side = dolfinx.fem.petsc.assemble_vector(load)
        dolfinx.fem.petsc.apply_lifting(right_side, [stiffness], [conditions])
        right_side.ghostUpdate(PETSc.InsertMode.ADD, PETSc.ScatterMode.REVERSE)
        dolfinx.fem.petsc.set_bc(right_side, conditions)
        matrix = dolfinx.fem.petsc.assemble_matrix(stiffness, conditions)
        matrix.assemble()
        matrix.setOption(PETSc.Mat.Option.SPD, True)
        displacement = dolfinx.fem.Function(self.space, name="displacement")
        try:
            info = self._solve_into(displacement, matrix, right_side, prefix)
        finally:
            matrix.destroy()
            right_side.destroy()
        internal = self._nodal_forces(dolfinx.fem.form(ufl.action(work, displacement)))
        return MembraneResult(self, displacement, internal, info)

    def _solve_into(
        self,
        displacement: dolfinx.fem.Function,
        matrix: PETSc.Mat,
        right_side: PETSc.Vec,
        prefix: str,
    ) -> linear.SolverInfo:
        options = DIRECT if self.dofs <= MAX_DOFS_DIRECT else ITERATIVE
        owned = self.space.dofmap.index_map.size_local
        modes = self._rigid_modes()[:owned].reshape(-1, 3)
        solver = linear.LinearSolver(matrix, modes, options, prefix=prefix)
        try:
            solution, info = solver.solve(right_side)
        finally:
            solver.destroy()
        displacement.x.array[: 2 * owned] = solution.array
        displacement.x.scatter_forward()
        solution.destroy()
        return info

    def _load(self, tractions: Sequence[Traction], test: Any) -> Any:
        nothing = dolfinx.fem.Constant(self.mesh, PETSc.ScalarType((0.0, 0.0)))
        form = ufl.inner(nothing, test) * ufl.dx
        if tractions:
            ds = self._measure([name for name, _ in tractions])
            for number, (_, traction) in enumerate(tractions):
                value = PETSc.ScalarType(tuple(float(t) for t in traction))
                form += ufl.inner(dolfinx.fem.Constant(self.mesh, value), test) * ds(number)
        return form


class MembraneResult(MembraneFields):
    """Solution of a membrane, with what is measured on it.

    Attributes
    ----------
    membrane, displacement, load, extension
        See MembraneFields.
    ksp : SolverInfo
        How the linear system was solved.
    energy, energy_tension, energy_shear : float
        Strain energy in joules.
    """

    def __init__(
        self,
        membrane: Membrane,
        displacement: dolfinx.fem.Function,
        internal_force: np.ndarray,
        ksp: linear.SolverInfo,
    ):
        super().__init__(membrane, displacement, internal_force)
        self.ksp = ksp
        self.energy_tension = self._integral(membrane._tension_work(displacement, displacement)) / 2
        self.energy_shear = self._integral(membrane._shear_work(displacement, displacement)) / 2
        self.energy = self.energy_tension + self.energy_shear
