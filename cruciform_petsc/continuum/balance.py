# SPDX-License-Identifier: MIT
"""Equilibrium of a hyperelastic membrane with some of its edges moved: state, forms and Newton.

The laws act on scalars only, so they are worked out by NumPy at the quadrature points, where they
leave

    stress  S = (dW/dlambda_w, dW/dlambda_e, dW/dgamma)
    moduli  C = second derivatives of W with respect to the same

and forms compiled once do the rest, whatever the laws (measures and energy: fibres.py):

    force    int S . dq(v)                                q = (lambda_w, lambda_e, gamma)
    tangent  int dq(v) . C dq(du) + S . ddq(v, du)
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import partial

import basix
import basix.ufl
import dolfinx.fem
import dolfinx.fem.petsc
import numpy as np
import scipy.linalg
import ufl
from mpi4py import MPI
from petsc4py import PETSc

from ..errors import LibraryError, SolverError
from ..solvers import linear
from ..solvers.callbacks import calling_back
from .domain import MembraneDomain
from .fibres import bending_energy, convex_part, measures, resultants, times

# Euclidean norm of the nodal forces out of balance over that of the reactions. Below the second,
# over that of the tangent's diagonal times (displacement + size of the triangles), they are
# rounding: of the displacement, and of F = I + grad u (stiff yarns, small triangles that bend).
TOLERANCE = 1e-9
ROUNDING = 5e-16
MAX_MIXED, MAX_DESCENT = 12, 40
# Parts of an increment, and of a radian that an edge may turn at a time.
SMALLEST_STEP = 2.0**-12
LARGEST_TURN = 0.2
# Least cosine of the shear angle on the way. Beyond 90 degrees cloth is folded over. At the ends of
# clamps, where strains have no bound, laws without locking allow that in the smallest triangles;
# to forbid it there would stop a test whose load does not depend on them.
LEAST_COSINE = -0.7

Motions = Mapping[str, np.ndarray]  # of edges: x = A X + b as (3, 3), [[A, b], [0, 1]]


class Balance:
    """A membrane's state, and the way from one equilibrium to the next. Collective.

    Parameters
    ----------
    membrane : MembraneDomain
    rigidity : float (2,)
        Of warp and weft in bending, per width, N m; 0 for none.
    held : dict
        Edge name -> the component that is prescribed, or None for both.
    prefix : str
        Of the linear solver's PETSc options.

    Attributes
    ----------
    u : dolfinx.fem.Function
        Displacement now.
    fixed : bool (n_local, 2)
        Prescribed components of the membrane's nodes.
    measures, energies : float (cells, points, 3), (3,)
        Stretches and shear angle at the quadrature points; joules of tension, shear and bending;
        after `update`.
    history : list of float
        Forces out of balance over the reactions, at each iteration of the last step.
    iterations, cuts : int
        Linear systems solved in this increment, and steps that failed.
    """

    def __init__(
        self,
        membrane: MembraneDomain,
        rigidity: np.ndarray,
        held: Mapping[str, int | None],
        prefix: str,
    ):
        self.membrane, self.comm, self.held, self.prefix = membrane, membrane.comm, held, prefix
        self.fixed, _ = membrane.prescribe([(name, c, 0.0) for name, c in held.items()])
        self._conditions = membrane.conditions(self.fixed)
        self.u = dolfinx.fem.Function(membrane.space, name="displacement")
        self._step = dolfinx.fem.Function(membrane.space)
        self._make_quadrature()
        self._make_forms(rigidity)
        self._matrix = dolfinx.fem.petsc.create_matrix(self._tangent)
        self._solver: linear.LinearSolver | None = None
        self._floor = 0.0
        self.history: list[float] = []
        self.iterations = self.cuts = 0
        self.update()

    def destroy(self) -> None:
        """Free the matrix and its solver."""
        if self._solver is not None:
            self._solver.destroy()
        self._matrix.destroy()

    # -- set-up ---------------------------------------------------------------------------------

    def _make_quadrature(self) -> None:
        membrane, mesh = self.membrane, self.membrane.mesh
        degree = 2 * membrane.degree - 1  # exact for the small-strain tangent, and one to spare
        metadata = {"quadrature_degree": degree, "quadrature_rule": "default"}
        self._dx = ufl.dx(domain=mesh, metadata=metadata)
        points, weights = basix.make_quadrature(basix.CellType.triangle, degree)
        # What the forms see: stress, stress in the geometric part of the tangent, moduli.
        self._s, self._g, self._c = (
            dolfinx.fem.Function(
                dolfinx.fem.functionspace(
                    mesh,
                    basix.ufl.quadrature_element(mesh.basix_cell(), (size,), degree=degree),
                )
            )
            for size in (3, 3, 4)
        )
        owned = mesh.topology.index_map(2).size_local
        self._cells = np.arange(owned, dtype=np.int32)
        self._slot = self._s.function_space.dofmap.list[:owned]
        corners = mesh.geometry.x[mesh.geometry.dofmap[:owned]][..., :2]
        twice_area = abs(np.linalg.det(np.diff(corners, axis=1)))
        self._weight = twice_area[:, None] * weights
        # Size of the largest triangle at each node.
        self._size = np.zeros(len(membrane.nodes))
        at = membrane.space.dofmap.list[:owned]
        np.maximum.at(self._size, at, np.sqrt(twice_area)[:, None])
        self._q = measures(self.u, membrane.directions)
        self._measures = dolfinx.fem.Expression(self._q, points)
        self._changes = dolfinx.fem.Expression(ufl.derivative(self._q, self.u, self._step), points)

    def _make_forms(self, rigidity: np.ndarray) -> None:
        membrane, u, q, c = self.membrane, self.u, self._q, self._c
        v, du = ufl.TestFunction(membrane.space), ufl.TrialFunction(membrane.space)
        dq, q_du = ufl.derivative(q, u, v), ufl.derivative(q, u, du)
        moduli = ufl.as_matrix([[c[0], c[3], 0], [c[3], c[1], 0], [0, 0, c[2]]])
        force = ufl.dot(self._s, dq) * self._dx
        geometric = ufl.dot(self._g, ufl.derivative(dq, u, du))
        tangent = (ufl.dot(dq, moduli * q_du) + geometric) * self._dx
        # Directions in which clamps hold the fibres.
        self._clamps: dict[str, list[dolfinx.fem.Constant]] = {}
        self._bending_energy = None
        if rigidity.any():
            for name, component in self.held.items():
                if component is None:
                    rest = membrane.directions
                    self._clamps[name] = [membrane.constant(d.value) for d in rest]
            ds = membrane.edge_measure(list(self._clamps))
            energy = 0.0
            for family in np.flatnonzero(rigidity):
                clamps = [(held[family], ds(i)) for i, held in enumerate(self._clamps.values())]
                direction, size = membrane.directions[family], membrane.constant(rigidity[family])
                energy += bending_energy(u, direction, size, membrane.degree, self._dx, clamps)
            self._bending_energy = dolfinx.fem.form(energy)
            bending_force = ufl.derivative(energy, u, v)
            force, tangent = force + bending_force, tangent + ufl.derivative(bending_force, u, du)
        self._force, self._tangent = dolfinx.fem.form(force), dolfinx.fem.form(tangent)
        self._times_step = dolfinx.fem.form(ufl.action(tangent, self._step))

    # -- state ----------------------------------------------------------------------------------

    def _at_points(self, expression: dolfinx.fem.Expression) -> np.ndarray:
        """Values (cells, points, 3) at the quadrature points."""
        some = len(self._cells) > 0
        values = expression.eval(self.membrane.mesh, self._cells) if some else np.zeros(0)
        return np.reshape(values, (*self._weight.shape, 3))

    def _put(self, function: dolfinx.fem.Function, values: np.ndarray) -> None:
        function.x.array.reshape(-1, values.shape[-1])[self._slot] = values

    def turn_clamps(self, motions: Motions) -> None:
        """Have the fibres' directions in clamps move with them, from rest."""
        for name, directions in self._clamps.items():
            for direction, rest in zip(directions, self.membrane.directions, strict=True):
                direction.value[:] = motions[name][:2, :2] @ rest.value

    def update(self) -> bool:
        """Work out energies, stress and moduli of the displacement now. Collective.

        Returns whether it can be: finite, and no fibres turned past each other by far.
        """
        self.u.x.scatter_forward()
        self.measures = self._at_points(self._measures)
        good = np.isfinite(self.measures).all()
        good &= (np.cos(self.measures[..., 2]) > LEAST_COSINE).all()
        if not self.comm.allreduce(bool(good), MPI.LAND):
            return False
        energy, self.stress, self.moduli = resultants(self.membrane.fabric, self.measures)
        form = self._bending_energy
        bending = 0.0 if form is None else dolfinx.fem.assemble_scalar(form)
        local = np.append(np.einsum("cq,cqe->e", self._weight, energy), bending)
        self.energies = self.comm.allreduce(local)
        return bool(np.isfinite(self.energies).all())

    def force(self) -> np.ndarray:
        """Gradient of the energy at this rank's nodes, (owned nodes, 2), N; after `update`."""
        self._put(self._s, self.stress)
        return self.membrane.nodal_forces(self._force)

    def assemble(
        self, geometric: np.ndarray | None = None, moduli: np.ndarray | None = None
    ) -> PETSc.Mat:
        """Tangent, with rows and columns of prescribed components those of the unit matrix.

        Stress of its geometric part and moduli (see `resultants`) are the state's if not given.
        """
        self._put(self._g, self.stress if geometric is None else geometric)
        self._put(self._c, self.moduli if moduli is None else moduli)
        self._matrix.zeroEntries()
        dolfinx.fem.petsc.assemble_matrix(self._matrix, self._tangent, self._conditions)
        self._matrix.assemble()
        self._matrix.setOption(PETSc.Mat.Option.SYMMETRIC, True)
        diagonal = self._matrix.getDiagonal()
        moved = abs(self.u.x.array) + np.repeat(self._size, 2)
        free = ~self.fixed.ravel()[: diagonal.local_size]
        rounding = (diagonal.array * moved[: diagonal.local_size])[free]
        diagonal.destroy()
        self._floor = ROUNDING * float(np.sqrt(self.comm.allreduce((rounding**2).sum())))
        return self._matrix

    def is_stable(self) -> bool | None:
        """Whether the energy has a minimum here; None if the solver cannot tell. Collective."""
        self._set_up(self.assemble())
        return self._is_definite()

    def folded_area(self) -> float:
        """Area at rest whose shear angle is beyond 90 degrees, m^2. Collective."""
        folded = np.cos(self.measures[..., 2]) <= 0
        return float(self.comm.allreduce(self._weight[folded].sum()))

    # -- from one equilibrium to the next -------------------------------------------------------

    def advance(self, start: Motions, target: Motions, number: int = 1) -> None:
        """Go from the equilibrium at one motion of the edges to that at another. Collective.

        In one step if that works, else in smaller ones; SolverError when they get too small. On the
        way rigid bodies stay rigid: edges move by a part of the logarithm of what leads from one
        motion to the other.
        """
        ways = {
            name: scipy.linalg.logm(np.linalg.solve(motion, target[name])).real
            for name, motion in start.items()
        }

        def at(part: float) -> Motions:
            if part == 1.0:
                return target
            return {name: start[name] @ scipy.linalg.expm(part * way) for name, way in ways.items()}

        self.iterations = self.cuts = 0
        turn = max((abs(way[1, 0] - way[0, 1]) / 2 for way in ways.values()), default=0.0)
        largest = min(1.0, LARGEST_TURN / turn) if turn > 0 else 1.0
        done, step = 0.0, largest
        while done < 1.0:
            part = 1.0 if done + step > 1.0 - 1e-9 else done + step
            kept, before = self.u.x.array.copy(), self.iterations
            if self._step_to(at(part)):
                done = part
                quick = self.iterations - before <= 6
                step = min(largest, step * (2.0 if quick else 1.0))
                continue
            self.u.x.array[:] = kept
            self.turn_clamps(at(done))
            self.update()
            self.cuts += 1
            step *= 0.5
            if step < SMALLEST_STEP:
                raise SolverError(
                    f"the membrane has no equilibrium beyond {100 * done:.3g} % of increment "
                    f"{number}, not even in steps of {100 * 2 * step:.2g} %: does a law lose its "
                    "stability there, or is the motion of the edges impossible?",
                    "NO_EQUILIBRIUM",
                    self.history,
                )

    def _step_to(self, motions: Motions) -> bool:
        """Move the edges and find equilibrium; False, and any state, if there is none to be found.

        First along the tangent, as the edges move. Then by mixed Newton steps: the geometric
        stiffness takes the stress that the last step was to lead to, not that of where it led,
        which for stiff yarns is far larger as turning by small displacements stretches them ("mixed
        integration point" method: Magisano, Leonetti and Garcea 2017, Comput. Methods Appl. Mech.
        Eng. 313). Should these go astray, by descent of the energy from where the edges were moved.
        """
        given = [
            (name, component, partial(_displacement, motions[name], component))
            for name, component in self.held.items()
        ]
        moved = self.membrane.prescribe(given)[1].ravel()
        gap = np.where(self.fixed.ravel(), moved - self.u.x.array, 0.0)
        self.turn_clamps(motions)
        self._step.x.array[:] = gap
        try:
            self._set_up(self.assemble())
            # Also if not in balance yet, for the directions of fibres turn with their clamps.
            force = self.force() + self.membrane.nodal_forces(self._times_step)
            if not self._go(self._solve(force) + gap, 1.0):
                return False
            moved = self.u.x.array.copy()
            if self._iterate(MAX_MIXED, self._mixed_step):
                return True
            self.u.x.array[:] = moved
            return self.update() and self._iterate(MAX_DESCENT, self._descend)
        except LibraryError:
            raise
        except SolverError:
            return False

    def _go(self, step: np.ndarray, least: float, most: float = np.inf, slope: float = 0.0) -> bool:
        """Add a step, or a part down to `least`, and predict the stress by the tangent.

        The energy must not exceed `most` + part * `slope`.
        """
        self._step.x.array[:] = step
        change = times(self.moduli, self._at_points(self._changes))
        base, stress, part = self.u.x.array.copy(), self.stress, 1.0
        while part >= least:
            self.u.x.array[:] = base + part * step
            if self.update() and self.energies.sum() <= most + part * slope:
                self._predicted = stress + part * change
                return True
            part *= 0.5
        return False

    def _iterate(self, limit: int, take_step: Callable[[np.ndarray], bool]) -> bool:
        """Take steps, each from the force out of balance, until there is none; if that comes."""
        self.history = []
        for _ in range(limit):
            force = self.force()
            if self._is_balanced(force):
                return True
            if not (np.isfinite(self.history[-1]) and take_step(force)):
                return False
        return self._is_balanced(self.force())

    def _mixed_step(self, force: np.ndarray) -> bool:
        if len(self.history) > 5 and self.history[-1] > self.history[-4]:
            return False
        self._set_up(self.assemble(self._predicted))
        return self._go(self._solve(force), 0.1)

    def _descend(self, force: np.ndarray) -> bool:
        """Go along a Newton step as far as the energy falls."""
        self._set_up(self.assemble())
        if self._is_definite() is False:  # iterations fail by themselves
            convex = convex_part(self.membrane.fabric, self.stress, self.moduli)
            self._set_up(self.assemble(*convex))
        step = self._solve(force)
        free = ~self.fixed[: len(force)]
        slope = (force * step.reshape(-1, 2)[: len(force)])[free].sum()
        slope = self.comm.allreduce(float(slope))
        most = self.energies.sum() * (1 + 1e-13)
        return slope < 0.0 and self._go(step, 1e-6, most, 1e-4 * slope)

    def _is_balanced(self, force: np.ndarray) -> bool:
        """Whether the force at free components is nothing beside that at prescribed ones."""
        fixed = self.fixed[: len(force)]
        local = np.array([(force[~fixed] ** 2).sum(), (force[fixed] ** 2).sum()])
        free, held = np.sqrt(self.comm.allreduce(local))
        scale = max(held, self._floor / TOLERANCE, np.finfo(float).tiny)
        self.history.append(float(free / scale))
        return bool(free <= TOLERANCE * scale)

    # -- linear systems -------------------------------------------------------------------------

    def _set_up(self, matrix: PETSc.Mat) -> None:
        if self._solver is None:
            # For the inertia: the root on one rank, null pivots told apart.
            inertia = {"mat_mumps_icntl_13": 1, "mat_mumps_icntl_24": 1}
            self._solver = self.membrane.solver(matrix, self.prefix, **inertia)
        else:
            self._solver.ksp.setOperators(matrix)  # or it would not look at the new values yet
            with calling_back(self._solver.ksp):
                self._solver.ksp.setUp()

    def _is_definite(self) -> bool | None:
        """Whether the factorised tangent is positive definite; None if the solver cannot tell."""
        assert self._solver is not None
        pc = self._solver.ksp.getPC()
        if pc.getType() != "cholesky" or pc.getFactorSolverType() != "mumps":
            return None
        if pc.getFailedReason():
            return False
        return bool(pc.getFactorMatrix().getInertia()[0] == 0)

    def _solve(self, force: np.ndarray) -> np.ndarray:
        """Displacement (local unknowns, ghosts filled) against a force at free components."""
        assert self._solver is not None
        self.iterations += 1
        self.membrane.solve_into(self._step, self._solver, -force, self.fixed)
        return self._step.x.array.copy()


def _displacement(motion: np.ndarray, component: int | None, x: np.ndarray) -> np.ndarray:
    """Displacement (2, n), or a component of it, of points (2, n) that move with an edge."""
    displacement = motion[:2, :2] @ x + motion[:2, 2:] - x
    return displacement if component is None else displacement[component]
