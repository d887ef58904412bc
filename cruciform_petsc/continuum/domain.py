# SPDX-License-Identifier: MIT
"""A preform's mesh, its edges and what is measured on it, whatever the membrane's mechanics."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import cached_property
from itertools import pairwise
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
from .mesh import edge_ends, grade_mesh, outline_mesh, with_shared_facets
from .points import evaluate

# Triangles that rank 0 may make; a finer mesh is that of all ranks, by refinement.
MAX_TRIANGLES_RANK_0 = 100_000
# The mesh is graded within this part of the outline's width, around corners that turn inwards by
# more than this angle and around the ends of clamps.
GRADING_RADIUS = 1 / 6
RE_ENTRANT = np.radians(20.0)
# How far from the outline, in its larger side, an edge may lie.
ON_OUTLINE = 2e-6

Value = float | Sequence[float] | Callable[[np.ndarray], np.ndarray]
Dirichlet = tuple[str, int | None, Value]
Traction = tuple[str, Sequence[float]]


class MembraneDomain:
    """Mesh, displacement space and edges of a membrane cut from a preform. Collective.

    Parameters
    ----------
    comm : mpi4py communicator
    preform
        Has `outline` (shapely Polygon), `warp_direction` and `weft_direction` (unit vectors at
        right angles, the weft 90 degrees ahead), `edge(name)` (segments (n, 2, 2)) and, where an
        edge ends between corners, `edges` (a mapping of all of them).
    fabric
        Has `c11`, `c22` and `shear_modulus` in N/m, for the mesh size.
    size : float, optional
        Mesh size in metres; by default `default_size`.
    degree : int
        Of the Lagrange elements.
    grading : int
        How often the mesh size is halved towards the ends of the edges "lower" and "upper" and
        towards re-entrant corners, where the strains are singular; 0 for a uniform mesh.
    share_facets : bool
        Ranks know the triangles beside theirs, for integrals over the mesh's inner edges.

    Attributes
    ----------
    mesh : dolfinx.mesh.Mesh
    space : dolfinx.fem.FunctionSpace
    size : float
    singular_points : float (n, 2)
        Ends of the edges "lower" and "upper", re-entrant corners, and ends of edges between two
        corners, metres.
    cells, dofs : int
        Global numbers of triangles and unknowns.

    Raises
    ------
    InputError
        On every rank.
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
        warp = np.asarray(preform.warp_direction, float)
        weft = np.asarray(preform.weft_direction, float)
        if not np.allclose(weft, [-warp[1], warp[0]], atol=1e-12):
            raise InputError("the membrane needs a weft at right angles to the warp")
        self.comm, self.preform, self.fabric = comm, preform, fabric
        outline, ends_between = split_outline(preform)
        self.width = outline_width(outline)
        self.size = default_size(outline, fabric, degree) if size is None else float(size)
        self.singular_points = np.concatenate([singular_points(preform), ends_between])
        levels = _refine_levels(outline, self.size)
        mesh = outline_mesh(comm, outline, self.size, levels)
        radius = GRADING_RADIUS * outline_width(outline)
        self.mesh = grade_mesh(mesh, self.singular_points, radius, grading)
        if share_facets:
            self.mesh = with_shared_facets(self.mesh)
        self.space = dolfinx.fem.functionspace(self.mesh, ("Lagrange", degree, (2,)))
        self.degree = degree
        self.cells = self.mesh.topology.index_map(2).size_global
        self.dofs = 2 * self.space.dofmap.index_map.size_global
        self._warp, self._weft = (
            dolfinx.fem.Constant(self.mesh, PETSc.ScalarType(tuple(d))) for d in (warp, weft)
        )
        self._edges: dict[str, np.ndarray] = {}

    def __repr__(self) -> str:
        name = type(self).__name__
        return f"{name}({self.cells} triangles of {self.size:.3g} m, {self.dofs} unknowns)"

    def strain(self, u: Any) -> tuple[Any, Any, Any]:
        """Warp strain, weft strain and shear angle of a displacement, as UFL expressions."""
        raise NotImplementedError

    # -- edges ----------------------------------------------------------------------------------

    def edge_facets(self, name: str) -> np.ndarray:
        """Boundary facets of the mesh on an edge of the preform, those of this rank. Collective.

        Raises
        ------
        InputError
            On every rank, if facets do not cover the edge.
        """
        if name not in self._edges:
            segments = np.asarray(self.preform.edge(name), float).reshape(-1, 2, 2)
            self._edges[name] = self._find_facets(name, segments)
        return self._edges[name]

    def _find_facets(self, name: str, segments: np.ndarray) -> np.ndarray:
        topology = self.mesh.topology
        topology.create_connectivity(1, 2)
        facets = dolfinx.mesh.exterior_facet_indices(topology)
        ends = edge_ends(self.mesh, facets)
        probes = np.concatenate([ends, ends.mean(axis=1, keepdims=True)], axis=1)
        tolerance = (
            ON_OUTLINE * np.ptp(np.reshape(self.preform.outline.bounds, (2, 2)), axis=0).max()
        )
        on_edge = np.zeros(probes.shape[:2], bool)
        for start, end in segments:
            along = end - start
            t = np.clip((probes - start) @ along / (along @ along), 0.0, 1.0)
            off = np.linalg.norm(probes - start - t[..., None] * along, axis=-1)
            on_edge |= off <= tolerance
        found = on_edge.all(axis=1)
        length = np.linalg.norm(ends[found, 1] - ends[found, 0], axis=1).sum()
        length = self.comm.allreduce(float(length))
        wanted = float(np.linalg.norm(segments[:, 1] - segments[:, 0], axis=1).sum())
        if not abs(length - wanted) <= 1e-4 * wanted:
            raise InputError(
                f"edge {name!r} is {wanted:.6g} m long, but the mesh has {length:.6g} m of it"
            )
        return np.sort(facets[found])

    def _measure(self, names: Sequence[str]) -> Any:
        """Integration measure ds in which names[i] has number i."""
        facets = [self.edge_facets(name) for name in names]
        number = np.repeat(np.arange(len(names), dtype=np.int32), [len(f) for f in facets])
        every = np.concatenate(facets)
        order = np.argsort(every, kind="stable")
        tags = dolfinx.mesh.meshtags(self.mesh, 1, every[order], number[order])
        return ufl.Measure("ds", domain=self.mesh, subdomain_data=tags)

    # -- constraints ----------------------------------------------------------------------------

    def _constraints(self, dirichlet: Sequence[Dirichlet]) -> list[dolfinx.fem.DirichletBC]:
        conditions = []
        for name, component, value in dirichlet:
            facets = self.edge_facets(name)
            for i in (0, 1) if component is None else (component,):
                space = self.space.sub(i)
                if callable(value):
                    scalar, _ = space.collapse()
                    given = dolfinx.fem.Function(scalar)
                    pick = i if component is None else None
                    given.interpolate(lambda x, f=value, p=pick: _component(f(x), p))
                    pairs = dolfinx.fem.locate_dofs_topological((space, scalar), 1, facets)
                    conditions.append(dolfinx.fem.dirichletbc(given, pairs, space))
                else:
                    number = float(np.broadcast_to(np.asarray(value, float), 2)[i])
                    dofs = dolfinx.fem.locate_dofs_topological(space, 1, facets)
                    condition = dolfinx.fem.dirichletbc(PETSc.ScalarType(number), dofs, space)
                    conditions.append(condition)
        return conditions

    def _pins(self) -> list[dolfinx.fem.DirichletBC]:
        """Hold both components at the lowest node, and one of them at the node farthest from it."""
        owned = self.space.dofmap.index_map.size_local
        x = self.space.tabulate_dof_coordinates()[:owned, :2]
        first, first_x = self._extreme_node(-x[:, 1] - 1e-3 * x[:, 0], x)
        second, second_x = self._extreme_node(np.linalg.norm(x - first_x, axis=1), x)
        across = int(np.argmin(abs(second_x - first_x)))
        pins = []
        for block, component in ((first, 0), (first, 1), (second, across)):
            # dofs of a blocked space's part are numbered in the whole space; ghosts count too
            dofs = (2 * block + component).astype(np.int32)
            space = self.space.sub(component)
            pins.append(dolfinx.fem.dirichletbc(PETSc.ScalarType(0.0), dofs, space))
        return pins

    def _extreme_node(self, measure: np.ndarray, x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Find the node of largest measure: its number on ranks that know it, and its x, y."""
        index_map = self.space.dofmap.index_map
        best = int(np.argmax(measure)) if len(measure) else -1
        value = float(measure[best]) if best >= 0 else -np.inf
        _, rank = self.comm.allreduce((value, self.comm.rank), MPI.MAXLOC)
        mine = (index_map.local_range[0] + best, x[best]) if self.comm.rank == rank else None
        number, position = self.comm.bcast(mine, rank)
        local = index_map.global_to_local(np.array([number], np.int64))
        return local[local >= 0], position

    def _rigid_modes(self) -> np.ndarray:
        """Return the rigid motions at this rank's nodes, (nodes, 2, 3), turn about the middle."""
        x = self.space.tabulate_dof_coordinates()[:, :2]
        low, high = np.reshape(self.preform.outline.bounds, (2, 2))
        x = (x - 0.5 * (low + high)) / (high - low).max()
        modes = np.zeros((len(x), 2, 3))
        modes[:, 0, 0] = modes[:, 1, 1] = 1.0
        modes[:, 0, 2], modes[:, 1, 2] = -x[:, 1], x[:, 0]
        return modes

    def _check_held(self, conditions: Sequence[dolfinx.fem.DirichletBC]) -> None:
        """Raise unless the constraints rule out every rigid motion."""
        modes = self._rigid_modes().reshape(-1, 3)
        gram = np.zeros((3, 3))
        for condition in conditions:
            dofs, number_owned = condition.dof_indices()
            held = modes[dofs[:number_owned]]
            gram += held.T @ held
        gram = self.comm.allreduce(gram)
        if np.linalg.eigvalsh(gram)[0] <= 1e-9 * max(np.trace(gram), 1.0):
            raise InputError("nothing holds the membrane: it can move as a rigid body")

    def _check_balance(self, load: dolfinx.fem.Form) -> None:
        """Raise unless the nodal forces of a linear form have no resultant."""
        force = self._nodal_forces(load)
        modes = self._rigid_modes()[: len(force)]
        resultant = self.comm.allreduce(np.einsum("nij,ni->j", modes, force))
        if abs(resultant).max() > 1e-9 * self.comm.allreduce(float(abs(force).sum())):
            raise InputError("nothing holds the membrane, and the loads on it are not in balance")

    def _nodal_forces(self, form: dolfinx.fem.Form) -> np.ndarray:
        """Assembled linear form at the nodes that this rank owns, (nodes, 2)."""
        vector = dolfinx.fem.petsc.assemble_vector(form)
        vector.ghostUpdate(PETSc.InsertMode.ADD, PETSc.ScatterMode.REVERSE)
        forces = vector.array.reshape(-1, 2).copy()
        vector.destroy()
        return forces


class MembraneFields:
    """A membrane's displacement and what is measured on it.

    Attributes
    ----------
    membrane : MembraneDomain
    displacement : dolfinx.fem.Function
        Metres.
    energy : float
        Strain energy in joules.
    load : float
        Force on the edge "upper" along y in newtons; nan where the preform has no such edge.
    extension : float
        Mean displacement along y of the edge "upper" less that of "lower", metres; nan likewise.
    """

    energy: float

    def __init__(
        self,
        membrane: MembraneDomain,
        displacement: dolfinx.fem.Function,
        internal_force: np.ndarray,
    ):
        self.membrane, self.displacement = membrane, displacement
        self.size, self.cells, self.dofs = membrane.size, membrane.cells, membrane.dofs
        self._internal_force = internal_force
        # Here and not on demand: a script that prints them on rank 0 alone must not hang.
        try:
            self.load = float(self.edge_force("upper")[1])
            mean = [self.mean_displacement(name)[1] for name in ("lower", "upper")]
            self.extension = float(mean[1] - mean[0])
        except InputError:
            self.load = self.extension = float("nan")

    def __repr__(self) -> str:
        return f"{type(self).__name__}({self.membrane!r}, energy {self.energy:.6g} J)"

    def _integral(self, form: Any) -> float:
        local = dolfinx.fem.assemble_scalar(dolfinx.fem.form(form))
        return float(self.membrane.comm.allreduce(local))

    def edge_force(self, name: str) -> np.ndarray:
        """Force on an edge, (2,) in newtons: the sum of its nodes' internal forces. Collective."""
        facets = self.membrane.edge_facets(name)
        nodes = dolfinx.fem.locate_dofs_topological(self.membrane.space, 1, facets)
        own = nodes[nodes < len(self._internal_force)]
        return self.membrane.comm.allreduce(self._internal_force[own].sum(axis=0))

    def mean_displacement(self, name: str) -> np.ndarray:
        """Mean displacement of an edge, (2,) in metres. Collective."""
        ds = self.membrane._measure([name])(0)
        one = dolfinx.fem.Constant(self.membrane.mesh, PETSc.ScalarType(1.0))
        length = self._integral(one * ds)
        return np.array([self._integral(self.displacement[i] * ds) for i in (0, 1)]) / length

    @cached_property
    def strains(self) -> dolfinx.fem.Function:
        """Warp strain, weft strain and shear angle, one degree lower and discontinuous."""
        membrane = self.membrane
        space = dolfinx.fem.functionspace(membrane.mesh, ("DG", membrane.degree - 1, (3,)))
        strains = dolfinx.fem.Function(space, name="strains")
        expression = ufl.as_vector(membrane.strain(self.displacement))
        points = _interpolation_points(space.element)
        strains.interpolate(dolfinx.fem.Expression(expression, points))
        strains.x.scatter_forward()
        return strains

    def evaluate(self, points: np.ndarray) -> dict[str, np.ndarray]:
        """Fields at points, each rank its own; see `points.evaluate`. Collective.

        Parameters
        ----------
        points : float (n, 2)
            Metres.

        Returns
        -------
        dict
            displacement (n, 2) in metres; warp_strain, weft_strain and shear_angle (n,), the last
            in radians.
        """
        u, strain = evaluate(self.membrane.mesh, [self.displacement, self.strains], points)
        names = ("warp_strain", "weft_strain", "shear_angle")
        return {"displacement": u, **dict(zip(names, strain.T.copy(), strict=True))}


# -- small parts --------------------------------------------------------------------------------


def outline_width(outline: shapely.Polygon) -> float:
    """How wide an outline is in metres: its narrower side, less if it is slender or has holes."""
    low, high = np.reshape(outline.bounds, (2, 2))
    return float(min((high - low).min(), 4 * outline.area / outline.length))


def default_size(outline: shapely.Polygon, fabric: Any, degree: int) -> float:
    """Mesh size in metres that leaves load and displacement within about 0.1 %.

    A part, by measurement, of the width of the layers that follow the yarns from the ends of
    clamps, which goes with the root of the shear modulus over the yarns' modulus; within limits.
    """
    layer = (fabric.shear_modulus / max(fabric.c11, fabric.c22)) ** 0.5
    part = {1: 0.05, 2: 0.35}.get(degree, 0.67)
    return outline_width(outline) * float(np.clip(part * layer, 1 / 96, 1 / 24))


def singular_points(preform: Any) -> np.ndarray:
    """Find the ends of the edges "lower" and "upper", and re-entrant corners, (n, 2)."""
    points = [np.empty((0, 2))]
    for name in ("lower", "upper"):
        try:
            ends = np.reshape(preform.edge(name), (-1, 2))
        except InputError:  # not every outline has them
            continue
        _, first, count = np.unique(
            np.round(ends, 12), axis=0, return_index=True, return_counts=True
        )
        points.append(ends[first[count == 1]])
    outline = shapely.geometry.polygon.orient(preform.outline)
    for ring in (outline.exterior, *outline.interiors):
        corner = np.asarray(shapely.remove_repeated_points(ring).coords)[:-1, :2]
        before, after = corner - np.roll(corner, 1, axis=0), np.roll(corner, -1, axis=0) - corner
        cross = before[:, 0] * after[:, 1] - before[:, 1] * after[:, 0]
        turn = np.arctan2(cross, (before * after).sum(axis=1))
        points.append(corner[turn < -RE_ENTRANT])
    return np.concatenate(points)


def split_outline(preform: Any) -> tuple[shapely.Polygon, np.ndarray]:
    """Outline with a corner wherever a named edge ends, and the corners (n, 2) that this added."""
    outline = preform.outline
    edges = getattr(preform, "edges", {})
    ends = [np.reshape(segments, (-1, 2)) for segments in edges.values()]
    points = np.unique(np.concatenate([np.empty((0, 2)), *ends]), axis=0)
    near = ON_OUTLINE * np.ptp(np.reshape(outline.bounds, (2, 2)), axis=0).max()
    added = []
    rings = []
    for ring in (outline.exterior, *outline.interiors):
        corners = np.asarray(ring.coords)[:, :2]
        split = [corners[:1]]
        for start, end in pairwise(corners):
            along = end - start
            t = (points - start) @ along / (along @ along)
            on_line = np.linalg.norm(points - start - t[:, None] * along, axis=1) <= near
            gap = near / np.linalg.norm(along)
            t = np.sort(t[on_line & (t > gap) & (t < 1 - gap)])
            t = t[np.diff(t, prepend=0.0) > gap]
            split += [start + t[:, None] * along, end[None]]
            added.append(split[-2])
        rings.append(np.concatenate(split))
    return shapely.Polygon(rings[0], rings[1:]), np.concatenate(added)


def _refine_levels(outline: shapely.Polygon, size: float) -> int:
    triangles = 4 * outline.area / size**2
    return max(0, int(np.ceil(np.log2(triangles / MAX_TRIANGLES_RANK_0) / 2)))


def _component(values: np.ndarray, component: int | None) -> np.ndarray:
    values = np.asarray(values)
    return values.reshape(-1) if component is None else values[component]


def _interpolation_points(element: Any) -> np.ndarray:
    """Of an element of dolfinx 0.9, where it is a method, or later, where it is a property."""
    points = element.interpolation_points
    return points() if callable(points) else points
