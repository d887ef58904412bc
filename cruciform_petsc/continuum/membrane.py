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
from contextlib import ExitStack
from typing import Any

import dolfinx.fem
import dolfinx.fem.petsc
import numpy as np
import ufl
from petsc4py import PETSc

from ..errors import InputError
from ..solvers import linear
from .domain import Dirichlet, MembraneDomain, MembraneFields, check_upper

Traction = tuple[str, Sequence[float]]


class Membrane(MembraneDomain):
    """Mesh and equations of the membrane that a preform is cut from. Collective.

    Parameters and attributes as of MembraneDomain; the fabric has `c12`, too.
    """

    def strain(self, u: Any) -> tuple[Any, Any, Any]:
        """Warp strain, weft strain and shear angle of a displacement, as UFL expressions."""
        gradient = ufl.grad(u)
        w, e = self.directions
        return (
            ufl.inner(w, gradient * w),
            ufl.inner(e, gradient * e),
            ufl.inner(e, gradient * w) + ufl.inner(w, gradient * e),
        )

    def energies(self, u: Any) -> tuple[Any, Any]:
        """Strain energy of tension and of shear, as UFL forms."""
        warp, weft, shear = self.strain(u)
        fabric = self.fabric
        c11, c22, c12 = (self.constant(c) for c in (fabric.c11, fabric.c22, fabric.c12))
        tension = 0.5 * (c11 * warp**2 + c22 * weft**2) + c12 * warp * weft
        return tension * ufl.dx, 0.5 * self.constant(fabric.shear_modulus) * shear**2 * ufl.dx

    def solve_bias_extension(
        self, extension: float, upper: str = "grip", prefix: str = "membrane_"
    ) -> MembraneResult:
        """Clamp the edge "lower" and pull the edge "upper" along y by metres. Collective.

        With upper = "grip" it keeps its x, with "centre-line" it is free to move along x.
        """
        component = check_upper(upper)
        pulled = (0.0, extension) if component is None else extension
        return self.solve([("lower", None, 0.0), ("upper", component, pulled)], prefix=prefix)

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
            See MembraneDomain.prescribe.
        tractions : sequence of (edge name, (tx, ty))
            Force per length of the edge, N/m.
        prefix : str
            Of the PETSc options; defaults: DIRECT up to MAX_DOFS_DIRECT, beyond it ITERATIVE
            (domain.py). The options database, command line included, wins over both.

        Raises
        ------
        InputError
            On every rank: unknown edge, a membrane that can float, loads out of balance.
        SolverError
            On every rank, with PETSc's reason and the residual history.
        """
        displacement = dolfinx.fem.Function(self.space, name="displacement")
        trial, test = ufl.TrialFunction(self.space), ufl.TestFunction(self.space)
        internal = ufl.derivative(sum(self.energies(displacement)), displacement, test)
        stiffness = dolfinx.fem.form(ufl.derivative(internal, displacement, trial))
        internal = dolfinx.fem.form(internal)
        work = ufl.inner(self.constant((0.0, 0.0)), test) * ufl.dx
        if tractions:
            ds = self.edge_measure([name for name, _ in tractions])
            for number, (_, traction) in enumerate(tractions):
                work += ufl.inner(self.constant(traction), test) * ds(number)
        load = self.nodal_forces(dolfinx.fem.form(work))
        fixed, given = self.prescribe(dirichlet)
        if not dirichlet:
            resultant = np.einsum("nij,ni->j", self.rigid_modes()[: len(load)], load)
            *resultant, size = self.comm.allreduce(np.append(resultant, abs(load).sum()))
            if max(map(abs, resultant)) > 1e-9 * size:
                raise InputError(
                    "nothing holds the membrane, and the loads on it are not in balance"
                )
            self.pin(fixed)
        matrix = dolfinx.fem.petsc.assemble_matrix(stiffness, self.conditions(fixed))
        matrix.assemble()
        matrix.setOption(PETSc.Mat.Option.SPD, True)
        # Linear: one step from where the edges are moved and nothing else.
        displacement.x.array[:] = given.ravel()
        rest = load - self.nodal_forces(internal)
        step = dolfinx.fem.Function(self.space)
        with ExitStack() as stack:
            stack.callback(matrix.destroy)
            solver = self.solver(matrix, prefix)
            stack.callback(solver.destroy)
            info = self.solve_into(step, solver, rest, fixed)
        displacement.x.array[:] += step.x.array
        return MembraneResult(self, displacement, self.nodal_forces(internal), info)


class MembraneResult(MembraneFields):
    """Solution of a membrane; see MembraneFields.

    Attributes
    ----------
    ksp : SolverInfo
        How the linear system was solved.
    energy_tension, energy_shear : float
        Parts of the energy, joules.
    """

    def __init__(self, membrane: Membrane, displacement, nodal_force: np.ndarray, ksp):
        super().__init__(membrane, displacement, nodal_force)
        self.ksp: linear.SolverInfo = ksp
        self.energy_tension, self.energy_shear = map(self.integral, membrane.energies(displacement))
        self.energy = self.energy_tension + self.energy_shear
