# SPDX-License-Identifier: MIT
r"""Membrane at finite deformation: the continuum that the finite network is a net of.

With F = I + grad u and yarn directions d_w, d_e at rest, at right angles, the energy per area is

    W = Phi_w(e_w) + Phi_e(e_e) + c12 e_w e_e + psi(gamma)
    lambda = |F d|,  e = Fabric.effective_strain(lambda)
    gamma = 90 deg - angle(F d_w, F d_e) = theta_w - theta_e + 90 deg

theta being the direction angle of F d. The laws act on scalars only, so they are worked out by
NumPy at the quadrature points, where they leave

    stress  S = (dW/dlambda_w, dW/dlambda_e, dW/dgamma)
    moduli  C = second derivatives of W with respect to the same

and forms compiled once do the rest, whatever the laws:

    force    int S . dq(v)                                q = (lambda_w, lambda_e, gamma)
    tangent  int dq(v) . C dq(du) + S . ddq(v, du)

With yarn bending there is besides, per area, D_w kappa_w^2/2 + D_e kappa_e^2/2, where kappa is
d(theta)/ds along the yarn at rest and D the yarns' flexural rigidity times their number per length.
Lagrange elements have kinks across facets, so its energy is that of C0 interior penalty (Engel et
al. 2002, doi 10.1016/S0045-7825(02)00286-4, for beams and plates), of which force and tangent are
exact derivatives: with the kink j = [theta] (n . d) of a fibre that passes a facet,

    E_b = sum over yarns of  int_cells D kappa^2/2  +  int_facets D {kappa} j + eta D/h j^2/2

A clamped edge holds the direction of the fibres in the same way.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any, cast

import basix
import basix.ufl
import dolfinx.fem
import dolfinx.fem.petsc
import numpy as np
import ufl
from mpi4py import MPI
from petsc4py import PETSc

from ..errors import InputError, SolverError
from ..solvers import linear
from .domain import MembraneDomain, MembraneFields, default_size, outline_width
from .membrane import DIRECT, ITERATIVE, MAX_DOFS_DIRECT

# Euclidean norm of the nodal forces out of balance over that of the reactions. Below the second,
# over that of the tangent's diagonal times (displacement + size of the triangles), they are
# rounding: of the displacement, and of F = I + grad u (stiff yarns, small triangles that bend).
TOLERANCE = 1e-9
ROUNDING = 5e-16
MAX_MIXED, MAX_DESCENT = 12, 40
# Parts of an increment, and of a radian that an edge may turn at a time.
SMALLEST_STEP = 2.0**-12
LARGEST_TURN = 0.2
# Moduli that the convex tangent keeps at least, in parts of those at rest.
CONVEX_FLOOR = 0.05
# Least cosine of the shear angle on the way. Beyond 90 degrees cloth is folded over. At the ends of
# clamps, where strains have no bound, laws without locking allow that in the smallest triangles;
# to forbid it there would stop a test whose load does not depend on them.
LEAST_COSINE = -0.7

Motion = tuple[Any, Any] | tuple[Any, Any, int | None]


class HyperelasticMembrane(MembraneDomain):
    """Membrane of any strains and rotations, with a fabric's laws. Collective.

    Parameters
    ----------
    comm, preform, size, degree, grading
        See MembraneDomain. Bending needs degree 2 or more.
    fabric
        A Fabric: its laws `shear`, `warp_tension` and `weft_tension`, `c12`, and its
        `effective_strain` (engineering or logarithmic, softened in compression).
    bending : bool
        Whether yarns resist bending in the plane (a second-gradient membrane).

    Without a given size the triangles are 1/40 to 1/15 of the width, as the layers along yarns or,
    with bending, beside clamps ask for.
    """

    def __init__(
        self,
        comm: MPI.Intracomm,
        preform: Any,
        fabric: Any,
        size: float | None = None,
        degree: int = 3,
        grading: int = 3,
        bending: bool = False,
    ):
        if bending and degree < 2:
            raise InputError("a membrane whose yarns bend needs elements of degree 2 or more")
        self.bending = bending
        self.rigidity = np.array(
            [family.yarn_bending * family.yarns for family in (fabric.warp, fabric.weft)]
        )
        if size is None:
            # Coarser than for the linear membrane: a solution takes dozens of its steps.
            width = outline_width(preform.outline)
            layer = default_size(preform.outline, fabric, degree)
            if bending and self.rigidity.any():  # yarns that bend spread whatever is sharper
                layer = (self.rigidity[self.rigidity > 0].min() / fabric.shear_modulus) ** 0.5
            size = float(np.clip(layer, width / 40, width / 15))
        super().__init__(comm, preform, fabric, size, degree, grading, share_facets=bending)
        self._directions = (self._warp, self._weft)

    # -- kinematics -----------------------------------------------------------------------------

    def measures(self, u: Any) -> tuple[Any, Any, Any]:
        """Stretches of warp and weft and the shear angle, as UFL expressions."""
        warp, weft = self._fibres(u)
        return (
            ufl.sqrt(ufl.dot(warp, warp)),
            ufl.sqrt(ufl.dot(weft, weft)),
            ufl.atan2(ufl.dot(warp, weft), _cross(warp, weft)),
        )

    def strain(self, u: Any) -> tuple[Any, Any, Any]:
        """Warp strain, weft strain (stretch less one) and shear angle, as UFL expressions."""
        warp, weft, shear = self.measures(u)
        return warp - 1.0, weft - 1.0, shear

    def _fibres(self, u: Any) -> list[Any]:
        gradient = ufl.grad(u)
        return [d + gradient * d for d in self._directions]

    def _first(self, u: Any, v: Any) -> tuple[Any, Any, Any]:
        """First variation of the measures along v."""
        stretch, turn = [], []
        for a, d in zip(self._fibres(u), self._directions, strict=True):
            b = ufl.grad(v) * d
            size = ufl.sqrt(ufl.dot(a, a))
            stretch.append(ufl.dot(a, b) / size)
            turn.append(ufl.dot(_perp(a), b) / ufl.dot(a, a))
        return stretch[0], stretch[1], turn[0] - turn[1]

    def _second(self, u: Any, v: Any, w: Any) -> tuple[Any, Any, Any]:
        """Second variation of the measures along v and w: of b, c along (t) and across (n) a fibre.

        That of its length is b_n c_n/lambda, that of its angle -(b_t c_n + b_n c_t)/lambda^2.
        """
        stretch, turn = [], []
        for a, d in zip(self._fibres(u), self._directions, strict=True):
            square = ufl.dot(a, a)
            size = ufl.sqrt(square)
            t, n = a / size, _perp(a) / size
            b, c = ufl.grad(v) * d, ufl.grad(w) * d
            stretch.append(ufl.dot(b, n) * ufl.dot(c, n) / size)
            turn.append(-(ufl.dot(b, t) * ufl.dot(c, n) + ufl.dot(b, n) * ufl.dot(c, t)) / square)
        return stretch[0], stretch[1], turn[0] - turn[1]

    # -- tests ----------------------------------------------------------------------------------

    def solve_bias_extension(
        self,
        extensions: Sequence[float],
        upper: str = "grip",
        prefix: str = "membrane_",
        report: Callable[[HyperelasticResult], None] | None = None,
    ) -> list[HyperelasticResult]:
        """Clamp the edge "lower" and pull the edge "upper" along y, step by step. Collective.

        Parameters
        ----------
        extensions : sequence of float
            Metres, in the order in which they are gone to; intermediate steps are taken as needed.
        upper : {"grip", "centre-line"}
            The upper edge keeps its x, or is free to move along x.
        prefix, report
            See solve_motions.
        """
        if upper not in ("grip", "centre-line"):
            raise InputError(f"upper = {upper!r} is not one of centre-line, grip")
        component = None if upper == "grip" else 1
        motions: list[dict[str, Motion]] = [
            {
                "lower": (np.eye(2), np.zeros(2), None),
                "upper": (np.eye(2), np.array([0.0, float(extension)]), component),
            }
            for extension in extensions
        ]
        return self.solve_motions(motions, prefix, report)

    def solve_motions(
        self,
        motions: Sequence[Mapping[str, Motion]],
        prefix: str = "membrane_",
        report: Callable[[HyperelasticResult], None] | None = None,
    ) -> list[HyperelasticResult]:
        """Move edges like rigid or homogeneously deformed bodies, from rest. Collective.

        Parameters
        ----------
        motions : sequence of dict
            For each increment: edge name -> (A, b) for x = A X + b with A (2, 2) and b (2,) in
            metres, or (A, b, component) where only that component is prescribed. The same edges
            and components in all increments. Where edges meet, later ones win.
        prefix : str
            Of the PETSc options of the linear solver; defaults as in Membrane.solve.
        report : callable, optional
            Is given each result as soon as it is there.

        Returns
        -------
        list of HyperelasticResult
            One for each increment.

        Raises
        ------
        InputError
            On every rank: unknown edge, edges that differ between increments, a membrane that can
            float.
        SolverError
            On every rank: no equilibrium was found, even in very small steps. Its `history` has
            the last relative residuals.
        """
        results: list[HyperelasticResult] = []
        if not motions:
            return results
        parsed = [
            {name: _Affine.of(motion) for name, motion in increment.items()}
            for increment in motions
        ]
        held = {name: motion.component for name, motion in parsed[0].items()}
        for increment in parsed:
            if {name: motion.component for name, motion in increment.items()} != held:
                raise InputError("every increment must move the same edges in the same components")
        equilibrium = Equilibrium(self, held, prefix)
        try:
            start = {name: _Affine(np.eye(2), np.zeros(2), c) for name, c in held.items()}
            for target in parsed:
                equilibrium.advance(start, target, len(results) + 1)
                results.append(equilibrium.result())
                if report is not None:
                    report(results[-1])
                start = target
        finally:
            equilibrium.destroy()
        return results


class _Affine:
    """x = A X + b, prescribed in one component or (None) in both."""

    def __init__(self, gradient: np.ndarray, shift: np.ndarray, component: int | None = None):
        self.gradient, self.shift, self.component = gradient, shift, component

    @classmethod
    def of(cls, motion: Motion) -> _Affine:
        gradient = np.array(motion[0], float)
        shift = np.array(motion[1], float)
        component = motion[2] if len(motion) == 3 else None
        if gradient.shape != (2, 2) or shift.shape != (2,) or component not in (None, 0, 1):
            raise InputError("the motion of an edge is (A (2, 2), b (2,)) and perhaps a component")
        return cls(gradient, shift, component)

    def _polar(self) -> tuple[float, np.ndarray, np.ndarray]:
        """Angle, stretch U and shift seen by the turned body: A = R U, b = R beta."""
        a = self.gradient
        angle = float(np.arctan2(a[1, 0] - a[0, 1], a[0, 0] + a[1, 1]))
        turn = _rotation(angle)
        return angle, turn.T @ a, turn.T @ self.shift

    def turn_to(self, other: _Affine) -> float:
        """Angle by which the body turns on the way to another motion, radians."""
        difference = other._polar()[0] - self._polar()[0]
        return float((difference + np.pi) % (2 * np.pi) - np.pi)

    def towards(self, other: _Affine, part: float) -> _Affine:
        """A part of the way, on which rigid bodies stay rigid."""
        angle, stretch, shift = self._polar()
        _, stretch_1, shift_1 = other._polar()
        turn = _rotation(angle + part * self.turn_to(other))
        return _Affine(
            turn @ (stretch + part * (stretch_1 - stretch)),
            turn @ (shift + part * (shift_1 - shift)),
            self.component,
        )


class Equilibrium:
    """A hyperelastic membrane with some of its edges moved: state, forms and Newton. Collective.

    Attributes
    ----------
    u : dolfinx.fem.Function
        Displacement now.
    fixed : bool (nodes of this rank with ghosts, 2)
        Prescribed components.
    energies : float (3,)
        Of tension, shear and bending, joules, after `update`.
    history : list of float
        Forces out of balance over the reactions, at each iteration of the last step.
    newton_iterations, cuts : int
        Linear systems solved in this increment, and steps that failed.
    """

    def __init__(self, membrane: HyperelasticMembrane, held: Mapping[str, int | None], prefix: str):
        self.membrane, self.prefix, self.comm = membrane, prefix, membrane.comm
        self._solver: linear.LinearSolver | None = None
        self._hold(held)
        self.u = dolfinx.fem.Function(membrane.space, name="displacement")
        self._step = dolfinx.fem.Function(membrane.space)
        self._make_quadrature()
        self._make_forms([name for name, component in held.items() if component is None])
        self._matrix = dolfinx.fem.petsc.create_matrix(self._tangent)
        self._floor = 0.0
        self.history: list[float] = []
        self.newton_iterations = self.cuts = 0
        self.update()

    def destroy(self) -> None:
        """Free the matrix and its solver."""
        if self._solver is not None:
            self._solver.destroy()
        self._matrix.destroy()

    # -- set-up ---------------------------------------------------------------------------------

    def _hold(self, held: Mapping[str, int | None]) -> None:
        membrane = self.membrane
        space = membrane.space
        index_map = space.dofmap.index_map
        self._owned = index_map.size_local
        count = index_map.size_local + index_map.num_ghosts
        self._x = space.tabulate_dof_coordinates()[:count, :2]
        self._edge = np.full((count, 2), -1)
        self._names = list(held)
        for number, (name, component) in enumerate(held.items()):
            nodes = dolfinx.fem.locate_dofs_topological(space, 1, membrane.edge_facets(name))
            columns = (0, 1) if component is None else (component,)
            for column in columns:
                self._edge[nodes, column] = number
        self.fixed = self._edge >= 0
        self._conditions = []
        for component in (0, 1):
            dofs = (2 * np.flatnonzero(self.fixed[:, component]) + component).astype(np.int32)
            self._conditions.append(
                dolfinx.fem.dirichletbc(PETSc.ScalarType(0.0), dofs, space.sub(component))
            )
        membrane._check_held(self._conditions)

    def _make_quadrature(self) -> None:
        membrane = self.membrane
        mesh, cell = membrane.mesh, membrane.mesh.basix_cell()
        # Exact for the small-strain tangent, with one degree to spare.
        degree = max(2 * membrane.degree - 1, 1)
        self._metadata = {"quadrature_degree": degree, "quadrature_rule": "default"}
        points, weights = basix.make_quadrature(basix.CellType.triangle, degree)

        def function(size: int) -> dolfinx.fem.Function:
            element = basix.ufl.quadrature_element(cell, value_shape=(size,), degree=degree)
            return dolfinx.fem.Function(dolfinx.fem.functionspace(mesh, element))

        # What the forms see: stress, stress in the geometric part of the tangent, moduli.
        self._s, self._g, self._c = function(3), function(3), function(4)
        owned = mesh.topology.index_map(2).size_local
        self._cells = np.arange(owned, dtype=np.int32)
        self._slot = self._s.function_space.dofmap.list[:owned]
        corners = mesh.geometry.x[mesh.geometry.dofmap[:owned]][..., :2]
        a, b = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
        twice_area = abs(a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0])
        self._weight = twice_area[:, None] * weights
        nodes = membrane.space.dofmap.list[:owned]
        largest = np.zeros(len(self._x))
        np.maximum.at(largest, nodes, np.broadcast_to(np.sqrt(twice_area)[:, None], nodes.shape))
        self._size = largest[: self._owned]
        self._measures = dolfinx.fem.Expression(ufl.as_vector(membrane.measures(self.u)), points)
        increments = ufl.as_vector(membrane._first(self.u, self._step))
        self._increments = dolfinx.fem.Expression(increments, points)

    def _make_forms(self, clamped: Sequence[str]) -> None:
        membrane, u, s, g, c = self.membrane, self.u, self._s, self._g, self._c
        v, du = ufl.TestFunction(membrane.space), ufl.TrialFunction(membrane.space)
        dx = ufl.dx(domain=membrane.mesh, metadata=self._metadata)
        dv, dd, second = membrane._first(u, v), membrane._first(u, du), membrane._second(u, v, du)
        force = (s[0] * dv[0] + s[1] * dv[1] + s[2] * dv[2]) * dx
        tangent = (
            c[0] * dv[0] * dd[0]
            + c[1] * dv[1] * dd[1]
            + c[2] * (dv[0] * dd[1] + dv[1] * dd[0])
            + c[3] * dv[2] * dd[2]
            + g[0] * second[0]
            + g[1] * second[1]
            + g[2] * second[2]
        ) * dx
        # 0 leaves out what makes bending's tangent indefinite.
        self._geometric = dolfinx.fem.Constant(membrane.mesh, PETSc.ScalarType(1.0))
        self._directions_held: dict[str, list[dolfinx.fem.Constant]] = {}
        self._bending_energy = None
        if membrane.bending and membrane.rigidity.any():
            energy, bending_force, bending_tangent = self._bending(clamped, v, du)
            self._bending_energy = dolfinx.fem.form(energy)
            force, tangent = force + bending_force, tangent + bending_tangent
        self._force = dolfinx.fem.form(force)
        self._tangent = dolfinx.fem.form(tangent)
        self._times_step = dolfinx.fem.form(ufl.action(tangent, self._step))

    def _bending(self, clamped: Sequence[str], v: Any, du: Any) -> tuple[Any, Any, Any]:
        """Energy, force and tangent of yarn bending as UFL forms."""
        membrane, u = self.membrane, self.u
        mesh = membrane.mesh
        for name in clamped:
            self._directions_held[name] = [
                dolfinx.fem.Constant(mesh, PETSc.ScalarType(tuple(d.value)))
                for d in membrane._directions
            ]
        p = membrane.degree
        # Bound of a polynomial of degree p - 2 on a side by that in its triangle (Warburton and
        # Hesthaven 2003, doi 10.1016/S0045-7825(03)00294-9) times |side|/|triangle|; then 4 where
        # 3/2 would do for three equal sides, as neighbours may be twice as small.
        penalty = 4.0 * max(p * (p - 1) / 2, 1.0)
        metadata = {"quadrature_degree": 2 * p - 2}
        dx, inner = ufl.dx(domain=mesh, metadata=self._metadata), ufl.dS(mesh, metadata=metadata)
        n = ufl.FacetNormal(mesh)
        slenderness = ufl.FacetArea(mesh) / ufl.CellVolume(mesh)
        on_edge: Any = membrane._measure(clamped)(metadata=metadata) if clamped else None
        energy, force, tangent = [], [], []

        def d(form: Any, direction: Any) -> Any:
            return ufl.derivative(form, u, direction)

        def add(kappa: Any, kink: Any, eta: Any, rigidity: float, measure: Any, sides: Any) -> None:
            """Facets: D ({kappa} j + eta j^2/2), with its variations."""
            k, k_v, k_d = sides(kappa), sides(d(kappa, v)), sides(d(kappa, du))
            k_vd = sides(d(d(kappa, v), du))
            j, j_v, j_d, j_vd = kink, d(kink, v), d(kink, du), d(d(kink, v), du)
            energy.append(rigidity * (k * j + 0.5 * eta * j * j) * measure)
            force.append(rigidity * (k * j_v + k_v * j + eta * j * j_v) * measure)
            material = k_v * j_d + k_d * j_v + eta * j_v * j_d
            geometric = k * j_vd + k_vd * j + eta * j * j_vd
            tangent.append(rigidity * (material + self._geometric * geometric) * measure)

        for family, direction in enumerate(membrane._directions):
            rigidity = float(membrane.rigidity[family])
            if rigidity == 0.0:
                continue
            size = dolfinx.fem.Constant(mesh, PETSc.ScalarType(rigidity))
            along = ufl.grad(u) * direction
            a = direction + along
            kappa = ufl.dot(_perp(a), ufl.grad(along) * direction) / ufl.dot(a, a)
            kappa_v, kappa_d = d(kappa, v), d(kappa, du)
            energy.append(0.5 * size * kappa * kappa * dx)
            force.append(size * kappa * kappa_v * dx)
            tangent.append(
                size * (kappa_v * kappa_d + self._geometric * kappa * d(kappa_v, du)) * dx
            )
            before, after = a("+"), a("-")
            kink = ufl.atan2(_cross(before, after), ufl.dot(before, after))
            add(
                kappa, kink * ufl.dot(n("+"), direction), penalty * ufl.avg(slenderness), size,
                inner, ufl.avg,
            )  # fmt: skip
            for number, name in enumerate(clamped):
                held = self._directions_held[name][family]
                kink = ufl.atan2(_cross(a, held), ufl.dot(a, held)) * ufl.dot(n, direction)
                # kappa is of one side only, so twice the penalty.
                add(
                    kappa, kink, 2.0 * penalty * slenderness, size, on_edge(number), lambda f: f,
                )  # fmt: skip
        return sum(energy), sum(force), sum(tangent)

    # -- state ----------------------------------------------------------------------------------

    def _at_points(self, expression: dolfinx.fem.Expression) -> np.ndarray:
        """Values (cells, points, 3) at the quadrature points."""
        shape = (*self._weight.shape, 3)
        if len(self._cells) == 0:
            return np.zeros(shape)
        return np.reshape(expression.eval(self.membrane.mesh, self._cells), shape)

    def _put(self, function: dolfinx.fem.Function, values: np.ndarray) -> None:
        function.x.array.reshape(-1, values.shape[-1])[self._slot] = values

    def update(self) -> bool:
        """Work out energies, stress and moduli of the displacement now. Collective.

        Returns whether it can be: finite, and no fibres turned past each other by far.
        """
        self.u.x.scatter_forward()
        self._q = measures = self._at_points(self._measures)
        good = np.isfinite(measures).all() and (np.cos(measures[..., 2]) > LEAST_COSINE).all()
        if not self.comm.allreduce(bool(good), MPI.LAND):
            return False
        energy, self.stress, self.moduli = resultants(self.membrane.fabric, measures)
        local = np.zeros(3)
        local[:2] = np.einsum("cq,cqe->e", self._weight, energy)
        if self._bending_energy is not None:
            local[2] = dolfinx.fem.assemble_scalar(self._bending_energy)
        self.energies = self.comm.allreduce(local)
        return bool(np.isfinite(self.energies).all())

    def force(self) -> np.ndarray:
        """Gradient of the energy at this rank's nodes, (owned nodes, 2), N; after `update`."""
        self._put(self._s, self.stress)
        return self.membrane._nodal_forces(self._force)

    def assemble(self, geometric: np.ndarray | None = None, convex: bool = False) -> PETSc.Mat:
        """Tangent, with rows and columns of prescribed components those of the unit matrix.

        Parameters
        ----------
        geometric : float (cells, points, 3), optional
            Stress of its geometric part; that of the state if not given.
        convex : bool
            Leave out what can make it indefinite.
        """
        stress = self.stress if geometric is None else geometric
        moduli = self.moduli
        if convex:
            stress = np.maximum(stress, 0.0)
            stress[..., 2] = 0.0
            fabric = self.membrane.fabric
            rest = resultants(fabric, np.array([1.0, 1.0, 0.0]))[2]
            moduli = moduli.copy()
            stiff = [0, 1, 3]
            moduli[..., stiff] = np.maximum(moduli[..., stiff], CONVEX_FLOOR * rest[stiff])
            bad = moduli[..., 2] ** 2 >= 0.999 * moduli[..., 0] * moduli[..., 1]
            moduli[bad, 2] = 0.0
        self._put(self._g, stress)
        self._put(self._c, moduli)
        self._geometric.value = 0.0 if convex else 1.0
        self._matrix.zeroEntries()
        dolfinx.fem.petsc.assemble_matrix(self._matrix, self._tangent, self._conditions)
        self._matrix.assemble()
        self._matrix.setOption(PETSc.Mat.Option.SYMMETRIC, True)
        diagonal = self._matrix.getDiagonal()
        free = ~self.fixed[: self._owned].ravel()
        size = abs(self.u.x.array[: len(free)]) + np.repeat(self._size, 2)
        rounding = (diagonal.array * size)[free]
        diagonal.destroy()
        self._floor = ROUNDING * float(np.sqrt(self.comm.allreduce((rounding**2).sum())))
        return self._matrix

    def result(self) -> HyperelasticResult:
        """Take the state down."""
        displacement = dolfinx.fem.Function(self.membrane.space, name="displacement")
        displacement.x.array[:] = self.u.x.array
        folded = float(self._weight[np.cos(self._q[..., 2]) <= 0].sum())
        force = self.force()
        self._set_up(self.assemble())
        return HyperelasticResult(
            self.membrane, displacement, force, self.energies, self.comm.allreduce(folded),
            self._is_definite(), self.newton_iterations, self.cuts, list(self.history),
        )  # fmt: skip

    # -- equilibrium ----------------------------------------------------------------------------

    def advance(
        self, start: Mapping[str, _Affine], target: Mapping[str, _Affine], number: int = 1
    ) -> None:
        """Go from the equilibrium at one motion of the edges to that at another. Collective.

        In one step if that works, else in smaller ones; raises SolverError when they get too small.
        The state is then the last equilibrium.
        """
        self.newton_iterations = self.cuts = 0
        turn = max((abs(m.turn_to(target[name])) for name, m in start.items()), default=0.0)
        largest = min(1.0, LARGEST_TURN / turn) if turn > 0 else 1.0
        done, step = 0.0, largest
        while done < 1.0:
            part = 1.0 if done + step > 1.0 - 1e-9 else done + step
            motion = {name: m.towards(target[name], part) for name, m in start.items()}
            kept = self.u.x.array.copy()
            held = {n: [c.value.copy() for c in cs] for n, cs in self._directions_held.items()}
            before = self.newton_iterations
            if self._step_to(motion):
                done = part
                quick = self.newton_iterations - before <= 6
                step = min(largest, step * (2.0 if quick else 1.0))
                continue
            self.u.x.array[:] = kept
            for name, values in held.items():
                for constant, value in zip(self._directions_held[name], values, strict=True):
                    constant.value[:] = value
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

    def _step_to(self, motion: Mapping[str, _Affine]) -> bool:
        """Move the edges and find equilibrium; False, and any state, if there is none to be found.

        First by mixed Newton steps: the geometric stiffness takes the stress that the last step
        was to lead to, not that of where it led, which for stiff yarns is far larger as turning by
        small displacements stretches them ("mixed integration point" method: Magisano, Leonetti
        and Garcea 2017, Comput. Methods Appl. Mech. Eng. 313). Should these go astray, by descent
        of the energy from where the edges were moved.
        """
        gap = np.zeros_like(self._x)
        gap[self.fixed] = (self._prescribed(motion) - self.u.x.array.reshape(-1, 2))[self.fixed]
        for name, constants in self._directions_held.items():
            for constant, rest in zip(constants, self.membrane._directions, strict=True):
                constant.value[:] = motion[name].gradient @ rest.value
        try:
            predicted = self._predict(gap)
            if predicted is None:
                return False
            moved = self.u.x.array.copy()
            if self._newton(predicted):
                return True
            self.u.x.array[:] = moved
            return self.update() and self._newton(None)
        except SolverError:
            return False

    def _prescribed(self, motion: Mapping[str, _Affine]) -> np.ndarray:
        """Displacement (nodes, 2) where it is prescribed, else zero."""
        given = np.zeros_like(self._x)
        for number, name in enumerate(self._names):
            m = motion[name]
            moved = self._x @ (m.gradient - np.eye(2)).T + m.shift
            mine = self._edge == number
            given[mine] = moved[mine]
        return given

    def _predict(self, gap: np.ndarray) -> np.ndarray | None:
        """Move along the tangent as the prescribed components do by `gap`; the stress predicted."""
        self._step.x.array[:] = gap.ravel()
        # Also if not in balance yet, for the directions of fibres turn with their clamps.
        self.force()
        self._factorise(self.stress)
        out_of_balance = self.force() + self.membrane._nodal_forces(self._times_step)
        step = self._solve(out_of_balance)
        step += gap.ravel()
        return self._go(step, 1.0)

    def _go(self, step: np.ndarray, fraction: float) -> np.ndarray | None:
        """Add a part of a step; the stress predicted by the tangent, None if it cannot be done."""
        self._step.x.array[:] = fraction * step
        increment = self._at_points(self._increments)
        c = self.moduli
        predicted = self.stress.copy()
        predicted[..., 0] += c[..., 0] * increment[..., 0] + c[..., 2] * increment[..., 1]
        predicted[..., 1] += c[..., 1] * increment[..., 1] + c[..., 2] * increment[..., 0]
        predicted[..., 2] += c[..., 3] * increment[..., 2]
        self.u.x.array[:] += self._step.x.array
        return predicted if self.update() else None

    def _newton(self, predicted: np.ndarray | None) -> bool:
        """Newton's method with the prescribed components in place: mixed steps, or (None) descent.

        Whether it has converged.
        """
        mixed = predicted is not None
        self.history = []
        limit = MAX_MIXED if mixed else MAX_DESCENT
        for iteration in range(limit + 1):
            force = self.force()
            out, scale = self._out_of_balance(force)
            self.history.append(out / scale)
            if out <= TOLERANCE * scale:
                return True
            if iteration == limit or not np.isfinite(out):
                return False
            if mixed and iteration > 4 and self.history[-1] > self.history[-4]:
                return False
            self._factorise(self.stress if predicted is None or not mixed else predicted)
            step = self._solve(force)
            energy = self.energies.sum()
            slope = self._dot(force, step)
            if not mixed and not slope < 0.0:
                return False
            base = self.u.x.array.copy()
            stress, moduli = self.stress, self.moduli
            fraction = 1.0
            while True:
                predicted = self._go(step, fraction)
                if predicted is not None and (
                    mixed
                    or self.energies.sum() <= energy + 1e-4 * fraction * slope + 1e-13 * energy
                ):
                    break
                self.u.x.array[:] = base
                self.stress, self.moduli = stress, moduli
                fraction *= 0.5
                if fraction < (0.1 if mixed else 1e-6):
                    return False
        return False

    def _out_of_balance(self, force: np.ndarray) -> tuple[float, float]:
        """Norm of the force at free components, and what it is to be compared with."""
        fixed = self.fixed[: self._owned]
        local = np.array([(force[~fixed] ** 2).sum(), (force[fixed] ** 2).sum()])
        free, held = np.sqrt(self.comm.allreduce(local))
        return float(free), float(max(held, self._floor / TOLERANCE, np.finfo(float).tiny))

    def _dot(self, force: np.ndarray, step: np.ndarray) -> float:
        free = ~self.fixed[: self._owned]
        mine = step[: 2 * self._owned].reshape(-1, 2)
        return float(self.comm.allreduce((force[free] * mine[free]).sum()))

    def _factorise(self, geometric: np.ndarray) -> None:
        """Set the solver up for the tangent, or its convex part if it is not positive definite."""
        self._set_up(self.assemble(geometric))
        if self._is_definite() is False:  # iterations fail by themselves
            self._set_up(self.assemble(geometric, convex=True))

    def _set_up(self, matrix: PETSc.Mat) -> None:
        if self._solver is None:
            membrane = self.membrane
            options = DIRECT if membrane.dofs <= MAX_DOFS_DIRECT else ITERATIVE
            if options is DIRECT:
                # For the inertia: the root on one rank, null pivots told apart.
                options = {**options, "mat_mumps_icntl_13": 1, "mat_mumps_icntl_24": 1}
            modes = membrane._rigid_modes()[: self._owned].reshape(-1, 3)
            self._solver = linear.LinearSolver(matrix, modes, options, prefix=self.prefix)
        else:
            self._solver.ksp.setOperators(matrix)  # or it would not look at the new values yet
            self._solver.ksp.setUp()

    def _is_definite(self) -> bool | None:
        """Whether the factorised tangent is positive definite; None if the solver cannot tell."""
        pc = cast(linear.LinearSolver, self._solver).ksp.getPC()
        if pc.getType() != "cholesky" or pc.getFactorSolverType() != "mumps":
            return None
        if pc.getFailedReason():
            return False
        return bool(pc.getFactorMatrix().getInertia()[0] == 0)

    def _solve(self, force: np.ndarray) -> np.ndarray:
        """Displacement (local unknowns, ghosts filled) against a force at free components."""
        right = self._matrix.createVecRight()
        right.array[:] = np.where(self.fixed[: self._owned], 0.0, -force).ravel()
        self.newton_iterations += 1
        try:
            solution, self.ksp = cast(linear.LinearSolver, self._solver).solve(right)
        finally:
            right.destroy()
        self._step.x.array[: 2 * self._owned] = solution.array
        solution.destroy()
        self._step.x.scatter_forward()
        return self._step.x.array.copy()


class HyperelasticResult(MembraneFields):
    """Equilibrium of a hyperelastic membrane, with what is measured on it.

    Attributes
    ----------
    membrane, displacement, load, extension
        See MembraneFields; `edge_force` gives the force on any edge.
    energy, energy_tension, energy_shear, energy_bending : float
        Strain energy in joules.
    folded_area : float
        Area at rest whose shear angle is beyond 90 degrees, m^2.
    stable : bool or None
        Whether the energy has a minimum here; an equilibrium without one is left by a real cloth
        (its yarns buckle, see `Fabric.compression`). None if the linear solver does not factorise.
    newton_iterations, cuts : int
        Linear systems solved from the increment before, and steps that failed on the way.
    history : list of float
        Forces out of balance over the reactions, at each iteration of the last step.
    """

    def __init__(
        self,
        membrane: HyperelasticMembrane,
        displacement: dolfinx.fem.Function,
        internal_force: np.ndarray,
        energies: np.ndarray,
        folded_area: float,
        stable: bool | None,
        newton_iterations: int,
        cuts: int,
        history: list[float],
    ):
        super().__init__(membrane, displacement, internal_force)
        self.energy_tension, self.energy_shear, self.energy_bending = map(float, energies)
        self.energy = float(sum(energies))
        self.folded_area, self.stable = folded_area, stable
        self.newton_iterations, self.cuts, self.history = newton_iterations, cuts, history


# -- laws ---------------------------------------------------------------------------------------


def resultants(fabric: Any, measures: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Energy, stress and moduli of a fabric at given stretches and shear angles.

    Parameters
    ----------
    fabric : Fabric
    measures : float (..., 3)
        lambda_w, lambda_e, gamma (radians).

    Returns
    -------
    energy : float (..., 2)
        Of tension and of shear, J/m^2.
    stress : float (..., 3)
        Derivatives with respect to the measures, N/m.
    moduli : float (..., 4)
        Second derivatives: ww, ee, we, gamma gamma, N/m.
    """
    a, a1, a2 = fabric.effective_strain(measures[..., 0])
    b, b1, b2 = fabric.effective_strain(measures[..., 1])
    c12 = float(fabric.c12)
    wa, wa1, wa2 = fabric.warp_tension.evaluate(a)
    wb, wb1, wb2 = fabric.weft_tension.evaluate(b)
    shear, tau, shear_modulus = fabric.shear.evaluate(measures[..., 2])
    pull_a, pull_b = wa1 + c12 * b, wb1 + c12 * a
    return (
        np.stack([wa + wb + c12 * a * b, shear], axis=-1),
        np.stack([pull_a * a1, pull_b * b1, tau], axis=-1),
        np.stack(
            [
                wa2 * a1**2 + pull_a * a2,
                wb2 * b1**2 + pull_b * b2,
                c12 * a1 * b1,
                shear_modulus,
            ],
            axis=-1,
        ),
    )


# -- small parts --------------------------------------------------------------------------------


def _perp(a: Any) -> Any:
    """Turn a vector anticlockwise by 90 degrees."""
    return ufl.as_vector((-a[1], a[0]))


def _cross(a: Any, b: Any) -> Any:
    return a[0] * b[1] - a[1] * b[0]


def _rotation(angle: float) -> np.ndarray:
    return np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
