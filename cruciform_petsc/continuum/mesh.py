# SPDX-License-Identifier: MIT
"""Triangle meshes of an outline, distributed over the ranks."""

from __future__ import annotations

from typing import Any

import basix.ufl
import dolfinx.mesh
import numpy as np
import shapely
import ufl
from mpi4py import MPI

from ..errors import InputError

# Growth of the triangles away from outline edges that are shorter than the mesh size.
_GROWTH = 0.4


def outline_mesh(
    comm: MPI.Intracomm, outline: shapely.Polygon, size: float, refine_levels: int = 0
) -> dolfinx.mesh.Mesh:
    """Mesh a polygon with triangles. Collective.

    An axis-aligned rectangle gets the symmetric crossed pattern, anything else an unstructured
    mesh made by gmsh on rank 0. Every vertex of the polygon is a vertex of the mesh. Edges shorter
    than `size` are one triangle wide, and the triangles grow to `size` away from them.

    Parameters
    ----------
    comm : mpi4py communicator
    outline : shapely.Polygon
        Metres; any simple polygon, holes allowed. The same on every rank.
    size : float
        Edge length of the finished mesh in metres.
    refine_levels : int
        Rank 0 makes a mesh 2**refine_levels times as coarse; every rank then refines its part.

    Returns
    -------
    dolfinx.mesh.Mesh
        Affine triangles in the plane, without ghost cells.

    Raises
    ------
    InputError
        On every rank, if gmsh is missing or fails, or the arguments make no sense.
    """
    if not size > 0 or refine_levels < 0:
        raise InputError(f"mesh size {size!r} and refinement {refine_levels!r} must be positive")
    coarse = size * 2**refine_levels
    mesh = _rectangle(comm, outline, coarse) or _unstructured(comm, outline, coarse)
    for level in range(refine_levels):
        mesh.topology.create_entities(1)
        mesh = _refine(mesh, None, is_last=level + 1 == refine_levels)
    return mesh


def grade_mesh(
    mesh: dolfinx.mesh.Mesh, points: np.ndarray, radius: float, levels: int
) -> dolfinx.mesh.Mesh:
    """Refine towards points where the solution is singular. Collective.

    Each level halves the triangles within a radius, and then the radius, so that their size falls
    in proportion to the distance from the nearest point.

    Parameters
    ----------
    mesh : dolfinx.mesh.Mesh
        Without ghost cells.
    points : float (n, 2)
        Metres; the same on every rank.
    radius : float
        Metres.
    levels : int

    Returns
    -------
    dolfinx.mesh.Mesh
        A new mesh, repartitioned; the given one if there is nothing to do.
    """
    points = np.reshape(points, (-1, 2))
    for level in range(levels if len(points) else 0):
        topology = mesh.topology
        topology.create_entities(1)
        topology.create_connectivity(1, 2)
        index_map = topology.index_map(1)
        edges = np.arange(index_map.size_local + index_map.num_ghosts, dtype=np.int32)
        middle = edge_ends(mesh, edges).mean(axis=1)
        near = np.zeros(len(edges), bool)
        for point in points:
            near |= np.linalg.norm(middle - point, axis=1) < radius / 2**level
        mesh = _refine(mesh, edges[near], is_last=level + 1 == levels)
    return mesh


def with_shared_facets(mesh: dolfinx.mesh.Mesh) -> dolfinx.mesh.Mesh:
    """Deal a mesh out afresh, each rank with copies of the triangles beside its own. Collective.

    For integrals over inner edges; such a mesh cannot be refined any further.
    """
    geometry = mesh.geometry
    owned = mesh.topology.index_map(2).size_local
    nodes = geometry.index_map()
    cells = nodes.local_to_global(geometry.dofmap[:owned].ravel()).reshape(-1, 3)
    return dolfinx.mesh.create_mesh(
        mesh.comm,
        cells=cells,
        x=geometry.x[: nodes.size_local, :2].copy(),
        e=ufl.Mesh(basix.ufl.element("Lagrange", "triangle", 1, shape=(2,))),
        partitioner=_partitioner(dolfinx.mesh.GhostMode.shared_facet),
    )


def edge_ends(mesh: dolfinx.mesh.Mesh, edges: np.ndarray) -> np.ndarray:
    """Coordinates of the ends of edges of the mesh, (n, 2, 2): edge, end, x or y."""
    if len(edges) == 0:  # dolfinx 0.9 divides by their number
        return np.empty((0, 2, 2))
    ends = dolfinx.mesh.entities_to_geometry(mesh, 1, edges)
    return mesh.geometry.x[ends.reshape(-1, 2)][..., :2]


def _refine(mesh: dolfinx.mesh.Mesh, edges: np.ndarray | None, is_last: bool) -> dolfinx.mesh.Mesh:
    """Split edges (None: all); the last of several refinements deals the mesh out afresh."""
    return dolfinx.mesh.refine(mesh, edges, _partitioner() if is_last else None)[0]


def _partitioner(ghosts: Any = dolfinx.mesh.GhostMode.none) -> Any:
    """Partition, by default without ghost cells; dolfinx 0.11 has a second argument, 0.9 none."""
    try:
        return dolfinx.mesh.create_cell_partitioner(ghosts)
    except TypeError:
        return dolfinx.mesh.create_cell_partitioner(ghosts, 2)


def _rectangle(
    comm: MPI.Intracomm, outline: shapely.Polygon, size: float
) -> dolfinx.mesh.Mesh | None:
    """Crossed mesh if the outline has four corners and they are those of its bounding box."""
    lower, upper = np.reshape(outline.bounds, (2, 2))
    corners = np.asarray(outline.exterior.coords)[:-1, :2]
    is_corner = ((corners == lower) | (corners == upper)).all(axis=1)
    if outline.interiors or len(corners) != 4 or not is_corner.all():
        return None
    number = np.maximum(np.ceil((upper - lower) / size * (1 - 1e-9)), 1).astype(int)
    return dolfinx.mesh.create_rectangle(
        comm,
        [lower, upper],
        [int(n) for n in number],
        ghost_mode=dolfinx.mesh.GhostMode.none,
        diagonal=dolfinx.mesh.DiagonalType.crossed,
    )


def _unstructured(comm: MPI.Intracomm, outline: shapely.Polygon, size: float) -> dolfinx.mesh.Mesh:
    points, triangles, problem = np.empty((0, 2)), np.empty((0, 3), np.int64), ""
    if comm.rank == 0:
        try:
            points, triangles = gmsh_triangles(outline, size)
        except ImportError:
            problem = "the outline needs gmsh for its mesh, and gmsh is not installed"
        except Exception as error:  # whatever it is, the other ranks wait for the news
            problem = f"gmsh could not mesh the outline: {error}"
    problem = comm.bcast(problem)
    if problem:
        raise InputError(problem)
    element = basix.ufl.element("Lagrange", "triangle", 1, shape=(2,))
    return dolfinx.mesh.create_mesh(
        comm,
        cells=triangles,
        x=points,
        e=ufl.Mesh(element),
        partitioner=_partitioner(),
    )


def gmsh_triangles(outline: shapely.Polygon, size: float) -> tuple[np.ndarray, np.ndarray]:
    """Triangles of a polygon by gmsh, on the calling rank alone.

    Returns
    -------
    points : float (n, 2), metres
    triangles : int64 (m, 3)
    """
    import gmsh

    outline = shapely.remove_repeated_points(outline)
    low = np.array(outline.bounds[:2])
    scale = float(np.linalg.norm(np.array(outline.bounds[2:]) - low))
    was_running = gmsh.isInitialized()
    if not was_running:
        gmsh.initialize(interruptible=False)
    gmsh.option.setNumber("General.Terminal", 0)
    gmsh.model.add("outline")
    try:
        lines, lengths, loops = [], [], []
        for ring in (outline.exterior, *outline.interiors):
            corners = (np.asarray(ring.coords)[:-1, :2] - low) / scale
            tags = [gmsh.model.geo.addPoint(x, y, 0.0) for x, y in corners]
            ring_lines = [
                gmsh.model.geo.addLine(a, b) for a, b in zip(tags, tags[1:] + tags[:1], strict=True)
            ]
            lengths.append(np.linalg.norm(corners - np.roll(corners, -1, axis=0), axis=1))
            loops.append(gmsh.model.geo.addCurveLoop(ring_lines))
            lines += ring_lines
        gmsh.model.geo.addPlaneSurface(loops)
        gmsh.model.geo.synchronize()
        for name in ("FromPoints", "FromCurvature", "ExtendFromBoundary"):
            gmsh.option.setNumber(f"Mesh.MeshSize{name}", 0)
        gmsh.option.setNumber("Mesh.MeshSizeMax", size / scale)
        gmsh.option.setNumber("Mesh.Algorithm", 6)
        _grow_from_short_lines(np.array(lines), np.concatenate(lengths), size / scale)
        gmsh.model.mesh.generate(2)
        node_tags, coordinates, _ = gmsh.model.mesh.getNodes()
        corner_tags = gmsh.model.mesh.getElementsByType(2)[1]
    finally:
        gmsh.model.remove()
        if not was_running:
            gmsh.finalize()
    used, triangles = np.unique(np.asarray(corner_tags, np.int64), return_inverse=True)
    order = np.argsort(node_tags)
    node = order[np.searchsorted(node_tags, used, sorter=order)]
    points = np.reshape(coordinates, (-1, 3))[node, :2] * scale + low
    return points, triangles.reshape(-1, 3).astype(np.int64)


def _grow_from_short_lines(lines: np.ndarray, lengths: np.ndarray, size: float) -> None:
    """Let gmsh's mesh size grow linearly away from lines shorter than it, grouped by octaves."""
    import gmsh

    octave = np.floor(np.log2(np.maximum(size / lengths, 1.0))).astype(int)
    field = gmsh.model.mesh.field
    thresholds = []
    for k in np.unique(octave[octave > 0]):
        smallest = size / 2.0 ** (k + 1)
        distance = field.add("Distance")
        field.setNumbers(distance, "CurvesList", lines[octave == k].tolist())
        field.setNumber(distance, "Sampling", 3)
        threshold = field.add("Threshold")
        field.setNumber(threshold, "InField", distance)
        field.setNumber(threshold, "SizeMin", smallest)
        field.setNumber(threshold, "SizeMax", size)
        field.setNumber(threshold, "DistMin", 0.0)
        field.setNumber(threshold, "DistMax", (size - smallest) / _GROWTH)
        thresholds.append(threshold)
    if thresholds:
        least = field.add("Min")
        field.setNumbers(least, "FieldsList", thresholds)
        field.setAsBackgroundMesh(least)
