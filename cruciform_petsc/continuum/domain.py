# SPDX-License-Identifier: MIT
"""A preform's mesh, its edges and what is measured on it, whatever the membrane's mechanics."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import suppress
from functools import cached_property
from typing import Any

import dolfinx.fem
import dolfinx.fem.petsc
import dolfinx.mesh
import numpy as np
import shapely
import ufl
from mpi4py import MPI
from petsc4py import PETSc

from ..errors import InputError
from ..solvers import linear
from ..solvers.options import DIRECT as CHOLESKY
from ..solvers.options import ITERATIVE as CG
from .mesh import edge_ends, outline_mesh
from .points import evaluate
from .sizes import default_size, outline_width

# Triangles that rank 0 may make; a finer mesh is that of all ranks, by refinement.
MAX_TRIANGLES_RANK_0 = 100_000
# The mesh is graded within this part of the outline's width, around corners that turn inwards by
# more than this angle and around the ends of clamps.
GRADING_RADIUS = 1 / 6
RE_ENTRANT = np.radians(20.0)
# How far from the outline, in its larger side, an edge may lie.
ON_OUTLINE = 2e-6
# Unknowns up to which the matrix is factorised. Measured on 2 ranks, 2 million unknowns: 21 s and
# 2.1 GiB per rank against 118 s and 1.8 GiB for multigrid.
MAX_DOFS_DIRECT = 2_000_000

DIRECT = {**CHOLESKY, "mat_mumps_icntl_14": 50}
ITERATIVE = {
    **CG,
    "ksp_rtol": 1e-11,
    "pc_gamg_threshold": 0.03,
    "mg_levels_pc_type": "jacobi",
}

Value = float | Sequence[float] | Callable[[np.ndarray], np.ndarray]
Dirichlet = tuple[str, int | None, Value]
UPPER = {"grip": None, "centre-line": 1}


class MembraneDomain:
    """Mesh, displacement space and edges of a membrane cut from a preform. Collective.

    Parameters
    ----------
    comm : mpi4py communicator
    preform : Preform
        Its edges may end between corners of the outline.
    fabric : Fabric
    size : float, optional
        Mesh size in metres; by default `default_size`.
    degree : int
        Of the Lagrange elements.
    grading : int
        How often the mesh size is halved towards `singular_points`; 0 for a uniform mesh.
    share_facets : bool
        See `outline_mesh`.

    Attributes
    ----------
    mesh, space : dolfinx's mesh and displacement space
    size, width : float
        Of the triangles, and of the outline (`outline_width`), metres.
    nodes : float (n_local, 2)
        Of this rank, the `num_nodes_owned` ones first, then ghosts; metres.
    directions : two dolfinx.fem.Constant
        Of warp and weft at rest.
    singular_points : float (n, 2)
        Where strains are singular: ends of the edges "lower" and "upper" and of edges that end
        between corners, and re-entrant corners; metres.
    cells, dofs : int
        Global numbers of triangles and unknowns.

    Raises InputError on every rank.
    """

    def __init__(
        self,
        comm: MPI.Intracomm,
        preform: Any,
        fabric: Any,
        size: float | None = None,
        degree: int = 3,
        grading: int = 6,
        share_facets: bool = False,
    ):
        warp, weft = preform.warp_direction, preform.weft_direction
        if not np.allclose(weft, [-warp[1], warp[0]], atol=1e-12):
            raise InputError("the membrane needs a weft at right angles to the warp")
        self.comm, self.preform, self.fabric, self.degree = comm, preform, fabric, degree
        outline, ends_between = split_outline(preform)
        self.width = outline_width(outline)
        self.size = default_size(outline, fabric, degree) if size is None else float(size)
        self.singular_points = np.concatenate([singular_points(preform), ends_between])
        triangles = 4 * outline.area / self.size**2
        levels = max(0, int(np.ceil(np.log2(triangles / MAX_TRIANGLES_RANK_0) / 2)))
        singular = (self.singular_points, GRADING_RADIUS * self.width, grading)
        self.mesh = outline_mesh(comm, outline, self.size, levels, singular, share_facets)
        self.space = dolfinx.fem.functionspace(self.mesh, ("Lagrange", degree, (2,)))
        index_map = self.space.dofmap.index_map
        self.num_nodes_owned = index_map.size_local
        count = index_map.size_local + index_map.num_ghosts
        self.nodes = self.space.tabulate_dof_coordinates()[:count, :2]
        self.cells = self.mesh.topology.index_map(2).size_global
        self.dofs = 2 * index_map.size_global
        self.directions = (self.constant(warp), self.constant(weft))
        self._edges: dict[str, np.ndarray] = {}

    def __repr__(self) -> str:
        name = type(self).__name__
        return f"{name}({self.cells} triangles of {self.size:.3g} m, {self.dofs} unknowns)"

    def constant(self, value: Any) -> dolfinx.fem.Constant:
        """Value of a UFL form that is the same everywhere."""
        return dolfinx.fem.Constant(self.mesh, np.asarray(value, PETSc.ScalarType))

    # -- edges ----------------------------------------------------------------------------------

    def edge_facets(self, name: str) -> np.ndarray:
        """Facets of this rank on an edge of the preform. Collective.

        Raises InputError on every rank if facets do not cover the edge.
        """
        if name in self._edges:
            return self._edges[name]
        edge = shapely.multilinestrings(np.reshape(self.preform.edge(name), (-1, 2, 2)))
        self.mesh.topology.create_connectivity(1, 2)
        facets = dolfinx.mesh.exterior_facet_indices(self.mesh.topology)
        ends = edge_ends(self.mesh, facets)
        probes = np.concatenate([ends, ends.mean(axis=1, keepdims=True)], axis=1)
        off = shapely.distance(edge, shapely.points(probes))
        is_on = (off <= _on_outline(self.preform.outline)).all(axis=1)
        length = np.linalg.norm(ends[is_on, 1] - ends[is_on, 0], axis=1).sum()
        length = self.comm.allreduce(float(length))
        if not abs(length - edge.length) <= 1e-4 * edge.length:
            raise InputError(
                f"edge {name!r} is {edge.length:.6g} m long, but the mesh has {length:.6g} m of it"
            )
        self._edges[name] = np.sort(facets[is_on])
        return self._edges[name]

    def edge_nodes(self, name: str) -> np.ndarray:
        """Local nodes on an edge, ghosts too. Collective."""
        return dolfinx.fem.locate_dofs_topological(self.space, 1, self.edge_facets(name))

    def edge_measure(self, names: Sequence[str]) -> Any:
        """Integration measure ds in which names[i] has number i. Collective."""
        facets = [self.edge_facets(name) for name in names]
        number = np.repeat(np.arange(len(names), dtype=np.int32), [len(f) for f in facets])
        every = np.concatenate(facets)
        order = np.argsort(every, kind="stable")
        tags = dolfinx.mesh.meshtags(self.mesh, 1, every[order], number[order])
        return ufl.Measure("ds", domain=self.mesh, subdomain_data=tags)

    # -- constraints ----------------------------------------------------------------------------

    def prescribe(self, given: Sequence[Dirichlet]) -> tuple[np.ndarray, np.ndarray]:
        """Given displacements of edges. Collective.

        Parameters
        ----------
        given : sequence of (edge name, component, value)
            Component 0, 1 or None for both. Metres: a number (two for None), or a callable that
            takes x of shape (2, n) and returns (n,) or, for None, (2, n). Later ones win.

        Returns
        -------
        Which components are given, bool (n_local, 2), and their values, else 0, (n_local, 2).
        """
        fixed, values = np.zeros(self.nodes.shape, bool), np.zeros(self.nodes.shape)
        for name, component, value in given:
            nodes = self.edge_nodes(name)
            columns = slice(None) if component is None else component
            fixed[nodes, columns] = True
            values[nodes, columns] = np.transpose(
                value(self.nodes[nodes].T) if callable(value) else value
            )
        return fixed, values

    def pin(self, fixed: np.ndarray) -> None:
        """Hold both components of the lowest corner, and one of the corner farthest from it."""
        corners = shapely.get_coordinates(self.preform.outline.exterior)
        first = corners[(corners[:, 1] + 1e-3 * corners[:, 0]).argmin()]
        second = corners[np.linalg.norm(corners - first, axis=1).argmax()]
        across = int(abs(second - first).argmin())
        near = _on_outline(self.preform.outline)
        for corner, components in ((first, slice(None)), (second, across)):
            fixed[np.linalg.norm(self.nodes - corner, axis=1) <= near, components] = True

    def conditions(self, fixed: np.ndarray) -> list[dolfinx.fem.DirichletBC]:
        """No change of the fixed components. Raises unless they rule out rigid motion. Collective.

        A blocked space's part numbers its unknowns like the whole space, ghosts included.
        """
        held = self.rigid_modes()[: self.num_nodes_owned][fixed[: self.num_nodes_owned]]
        gram = self.comm.allreduce(held.T @ held)
        if np.linalg.eigvalsh(gram)[0] <= 1e-9 * max(np.trace(gram), 1.0):
            raise InputError("nothing holds the membrane: it can move as a rigid body")
        conditions = []
        for component in (0, 1):
            dofs = 2 * np.flatnonzero(fixed[:, component]).astype(np.int32) + component
            space = self.space.sub(component)
            conditions.append(dolfinx.fem.dirichletbc(PETSc.ScalarType(0.0), dofs, space))
        return conditions

    def rigid_modes(self) -> np.ndarray:
        """Return the rigid motions at this rank's nodes, (n_local, 2, 3), turn about the middle."""
        low, high = np.reshape(self.preform.outline.bounds, (2, 2))
        x, y = (self.nodes - 0.5 * (low + high)).T / (high - low).max()
        zero, one = np.zeros(len(x)), np.ones(len(x))
        return np.moveaxis(np.array([[one, zero, -y], [zero, one, x]]), 2, 0)

    # -- linear algebra -------------------------------------------------------------------------

    def nodal_forces(self, form: dolfinx.fem.Form) -> np.ndarray:
        """Assembled linear form at the nodes that this rank owns, (num_nodes_owned, 2)."""
        vector = dolfinx.fem.petsc.assemble_vector(form)
        vector.ghostUpdate(PETSc.InsertMode.ADD, PETSc.ScatterMode.REVERSE)
        forces = vector.array.reshape(-1, 2).copy()
        vector.destroy()
        return forces

    def solver(self, matrix: PETSc.Mat, prefix: str, **extra: Any) -> linear.LinearSolver:
        """Solver of a matrix over the nodes; `extra` are options of a factorisation. Collective."""
        options = DIRECT | extra if self.dofs <= MAX_DOFS_DIRECT else ITERATIVE
        modes = self.rigid_modes()[: self.num_nodes_owned].reshape(-1, 3)
        return linear.LinearSolver(matrix, modes, options, prefix=prefix)

    def solve_into(
        self,
        function: dolfinx.fem.Function,
        solver: linear.LinearSolver,
        force: np.ndarray,
        fixed: np.ndarray,
    ) -> linear.SolverInfo:
        """Displacement under forces (num_nodes_owned, 2) at the free components. Collective."""
        right = solver.matrix.createVecRight()
        right.array[:] = np.where(fixed[: len(force)], 0.0, force).ravel()
        try:
            solution, info = solver.solve(right)
        finally:
            right.destroy()
        function.x.array[: force.size] = solution.array
        solution.destroy()
        function.x.scatter_forward()
        return info


class MembraneFields:
    """A membrane's displacement and what is measured on it. Collective when made.

    Attributes
    ----------
    membrane : MembraneDomain
        Its method `strain` gives warp strain, weft strain and shear angle as UFL expressions.
    displacement : dolfinx.fem.Function
        Metres.
    nodal_force : float (num_nodes_owned, 2)
        Derivative of the strain `energy` (joules), newtons.
    load, extension : float
        Force on the edge "upper" along y in newtons, and its mean displacement along y less that
        of "lower" in metres; nan where the preform has no such edge.
    """

    energy: float

    def __init__(self, membrane: Any, displacement: dolfinx.fem.Function, nodal_force: np.ndarray):
        self.membrane, self.displacement, self.nodal_force = membrane, displacement, nodal_force
        self.size, self.cells, self.dofs = membrane.size, membrane.cells, membrane.dofs
        # Here and not on demand: a script that prints them on rank 0 alone must not hang.
        try:
            self.load = float(self.edge_force("upper")[1])
            lower, upper = (self.mean_displacement(name)[1] for name in ("lower", "upper"))
            self.extension = float(upper - lower)
        except InputError:
            self.load = self.extension = float("nan")

    def __repr__(self) -> str:
        return f"{type(self).__name__}({self.membrane!r}, energy {self.energy:.6g} J)"

    def integral(self, form: Any) -> float:
        """Integral of a UFL form over the whole membrane. Collective."""
        local = dolfinx.fem.assemble_scalar(dolfinx.fem.form(form))
        return float(self.membrane.comm.allreduce(local))

    def edge_force(self, name: str) -> np.ndarray:
        """Force on an edge, (2,) in newtons: the sum of its nodes' internal forces. Collective."""
        nodes = self.membrane.edge_nodes(name)
        owned = nodes[nodes < len(self.nodal_force)]
        return self.membrane.comm.allreduce(self.nodal_force[owned].sum(axis=0))

    def mean_displacement(self, name: str) -> np.ndarray:
        """Mean displacement of an edge, (2,) in metres. Collective."""
        ds = self.membrane.edge_measure([name])(0)
        length = self.integral(self.membrane.constant(1.0) * ds)
        return np.array([self.integral(self.displacement[i] * ds) for i in (0, 1)]) / length

    @cached_property
    def strains(self) -> dolfinx.fem.Function:
        """Warp strain, weft strain and shear angle, one degree lower and discontinuous."""
        membrane = self.membrane
        space = dolfinx.fem.functionspace(membrane.mesh, ("DG", membrane.degree - 1, (3,)))
        strains = dolfinx.fem.Function(space, name="strains")
        points = space.element.interpolation_points  # a method in dolfinx 0.9, a property later
        expression = ufl.as_vector(membrane.strain(self.displacement))
        strains.interpolate(
            dolfinx.fem.Expression(expression, points() if callable(points) else points)
        )
        strains.x.scatter_forward()
        return strains

    def evaluate(self, points: np.ndarray) -> dict[str, np.ndarray]:
        """Fields at points (n, 2), metres, each rank its own; see `points.evaluate`. Collective.

        They are displacement (n, 2) in metres, warp_strain, weft_strain and shear_angle (n,), the
        last in radians.
        """
        u, strain = evaluate(self.membrane.mesh, [self.displacement, self.strains], points)
        warp, weft, shear = strain.T.copy()
        return {"displacement": u, "warp_strain": warp, "weft_strain": weft, "shear_angle": shear}


def check_upper(upper: str) -> int | None:
    """Component in which the edge "upper" is held: both (None), or 1 where it is free along x."""
    if upper not in UPPER:
        raise InputError(f"upper = {upper!r} is not one of {', '.join(sorted(UPPER))}")
    return UPPER[upper]


def singular_points(preform: Any) -> np.ndarray:
    """Find the ends of the edges "lower" and "upper", and re-entrant corners, (n, 2)."""
    points = [np.empty((0, 2))]
    for name in ("lower", "upper"):
        with suppress(InputError):  # not every outline has them
            edge = shapely.multilinestrings(np.reshape(preform.edge(name), (-1, 2, 2)))
            points.append(shapely.get_coordinates(shapely.boundary(edge)))
    outline = shapely.geometry.polygon.orient(preform.outline)
    for ring in (outline.exterior, *outline.interiors):
        corner = shapely.get_coordinates(shapely.remove_repeated_points(ring))[:-1]
        side = (np.roll(corner, -1, axis=0) - corner) @ [1, 1j]
        turn = np.angle(side / np.roll(side, 1))
        points.append(corner[turn < -RE_ENTRANT])
    return np.concatenate(points)


def split_outline(preform: Any) -> tuple[shapely.Polygon, np.ndarray]:
    """Outline with a corner wherever a named edge ends, and the corners (n, 2) that this added."""
    outline, near = preform.outline, _on_outline(preform.outline)
    ends = shapely.points(np.concatenate([np.reshape(s, (-1, 2)) for s in preform.edges.values()]))
    corners = shapely.multipoints(shapely.get_coordinates(outline))
    is_new = shapely.distance(outline.boundary, ends) <= near
    is_new &= shapely.distance(corners, ends) > near
    new = shapely.multipoints(ends[is_new])
    split = shapely.remove_repeated_points(shapely.snap(outline, new, near), near)
    return split, shapely.get_coordinates(new)


def _on_outline(outline: shapely.Polygon) -> float:
    return ON_OUTLINE * np.ptp(np.reshape(outline.bounds, (2, 2)), axis=0).max()
