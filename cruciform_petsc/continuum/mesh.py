# SPDX-License-Identifier: MIT
"""Triangle meshes of an outline, distributed over the ranks."""

from __future__ import annotations

from itertools import pairwise
from typing import Any

import basix.ufl
import dolfinx.mesh
import numpy as np
import shapely
import ufl
from mpi4py import MPI

from ..errors import InputError
from ..parallel import on_all

# Growth of the triangles away from outline edges that are shorter than the mesh size.
GROWTH = 0.4
# In parts of the outline's size: corners nearer to each other lie on one yarn line.
SAME = 1e-6


def outline_mesh(
    comm: MPI.Intracomm,
    outline: shapely.Polygon,
    size: float,
    refine_levels: int = 0,
    singular: tuple[np.ndarray, float, int] | None = None,
    share_facets: bool = False,
) -> dolfinx.mesh.Mesh:
    """Affine triangles that fill a polygon. Collective.

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
    singular : (points (n, 2), radius, levels), optional
        Points where the solution is singular. Each level halves the triangles within the radius
        in metres, and then the radius, so that their size falls in proportion to the distance.
    share_facets : bool
        Each rank has copies of the triangles beside its own, for integrals over inner edges.

    Raises InputError on every rank if gmsh is missing or fails, or the arguments make no sense.
    """
    if not size > 0 or refine_levels < 0:
        raise InputError(f"mesh size {size!r} and refinement {refine_levels!r} must be positive")
    points, radius, grading = singular or (np.empty((0, 2)), 0.0, 0)
    radii = [np.inf] * refine_levels
    radii += [radius / 2**level for level in range(grading if len(points) else 0)]
    ghosts = dolfinx.mesh.GhostMode.shared_facet if share_facets else dolfinx.mesh.GhostMode.none
    first = dolfinx.mesh.GhostMode.none if radii else ghosts
    coarse = size * 2**refine_levels
    mesh = _rectangle(comm, outline, coarse, first) or _unstructured(comm, outline, coarse, first)
    for number, radius in enumerate(radii, 1):
        mesh.topology.create_entities(1)
        near = None if np.isinf(radius) else _edges_near(mesh, points, radius)
        # Dealt out afresh at the end; halving all triangles leaves the ranks' shares as they were.
        partitioner = _partitioner(ghosts) if number == len(radii) else None
        mesh = dolfinx.mesh.refine(mesh, near, partitioner)[0]
    return mesh


def _edges_near(mesh: dolfinx.mesh.Mesh, points: np.ndarray, radius: float) -> np.ndarray:
    """Edges whose middle lies within a radius of any of the points (n, 2)."""
    mesh.topology.create_connectivity(1, 2)
    index_map = mesh.topology.index_map(1)
    edges = np.arange(index_map.size_local + index_map.num_ghosts, dtype=np.int32)
    middle = shapely.points(edge_ends(mesh, edges).mean(axis=1))
    return edges[shapely.distance(shapely.multipoints(points), middle) < radius]


def edge_ends(mesh: dolfinx.mesh.Mesh, edges: np.ndarray) -> np.ndarray:
    """Coordinates of the ends of edges of the mesh, (n, 2, 2): edge, end, x or y."""
    if len(edges) == 0:  # dolfinx 0.9 divides by their number
        return np.empty((0, 2, 2))
    ends = dolfinx.mesh.entities_to_geometry(mesh, 1, edges)
    return mesh.geometry.x[ends.reshape(-1, 2)][..., :2]


def _partitioner(ghosts: Any) -> Any:
    """Partitioner with such ghost cells; dolfinx 0.11 has a second argument, 0.9 none."""
    try:
        return dolfinx.mesh.create_cell_partitioner(ghosts)
    except TypeError:
        return dolfinx.mesh.create_cell_partitioner(ghosts, 2)


def _rectangle(
    comm: MPI.Intracomm, outline: shapely.Polygon, size: float, ghosts: Any
) -> dolfinx.mesh.Mesh | None:
    """Crossed mesh if the outline has four corners and they are those of its bounding box."""
    lower, upper = np.reshape(outline.bounds, (2, 2))
    corners = np.asarray(outline.exterior.coords)[:-1, :2]
    is_corner = ((corners == lower) | (corners == upper)).all(axis=1)
    if outline.interiors or len(corners) != 4 or not is_corner.all():
        return None
    number = np.maximum(np.ceil((upper - lower) / size * (1 - 1e-9)), 1).astype(int)
    diagonal = dolfinx.mesh.DiagonalType.crossed
    return dolfinx.mesh.create_rectangle(
        comm, [lower, upper], number.tolist(), ghost_mode=ghosts, diagonal=diagonal
    )


def _unstructured(
    comm: MPI.Intracomm, outline: shapely.Polygon, size: float, ghosts: Any
) -> dolfinx.mesh.Mesh:
    def triangles_of_rank() -> tuple[np.ndarray, np.ndarray]:
        if comm.rank != 0:
            return np.empty((0, 2)), np.empty((0, 3), np.int64)
        try:
            return gmsh_triangles(outline, size)
        except ImportError:
            problem = "the outline needs gmsh for its mesh, and gmsh is not installed"
            raise InputError(problem) from None
        except Exception as error:
            raise InputError(f"gmsh could not mesh the outline: {error}") from error

    points, triangles = on_all(comm, triangles_of_rank)
    element = ufl.Mesh(basix.ufl.element("Lagrange", "triangle", 1, shape=(2,)))
    return dolfinx.mesh.create_mesh(
        comm, cells=triangles, x=points, e=element, partitioner=_partitioner(ghosts)
    )


def yarn_mesh(network: Any, size: float) -> dolfinx.mesh.Mesh:
    """Rectangles along a network's yarns, each cut into two triangles, to and fro. Collective.

    Yarn lines through all corners of the outline, and between them an even number of rectangles at
    most `size` wide: a mesh as symmetric as the outline is. Each rank makes a strip of it, and then
    they are dealt out.

    Raises InputError on every rank if a side of the outline does not run along yarns.
    """
    comm, outline = network.comm, network.preform.along_yarns("a membrane among tools")
    corners, near = shapely.get_coordinates(outline), SAME * network.preform.size.max()
    s, t = (_between(corners[:, axis], size, near) for axis in (0, 1))

    def strip(count: int) -> np.ndarray:
        return np.arange(count * comm.rank // comm.size, count * (comm.rank + 1) // comm.size)

    points = np.stack(np.meshgrid(s[strip(len(s))], t, indexing="ij"), axis=-1).reshape(-1, 2)
    i, j = (n.ravel() for n in np.meshgrid(strip(len(s) - 1), np.arange(len(t) - 1), indexing="ij"))
    inside = shapely.contains_xy(outline, 0.5 * (s[i] + s[i + 1]), 0.5 * (t[j] + t[j + 1]))
    i, j = i[inside].astype(np.int64), j[inside]
    a, b = len(t) * i + j, len(t) * (i + 1) + j
    c, d, even = b + 1, a + 1, ((i + j) % 2 == 0)[:, None]
    first = np.where(even, np.column_stack([a, b, c]), np.column_stack([a, b, d]))
    second = np.where(even, np.column_stack([a, c, d]), np.column_stack([b, c, d]))
    return dolfinx.mesh.create_mesh(
        comm,
        cells=np.concatenate([first, second]),
        x=network.to_lab(points),
        e=ufl.Mesh(basix.ufl.element("Lagrange", "triangle", 1, shape=(2,))),
        partitioner=_partitioner(dolfinx.mesh.GhostMode.none),
    )


def _between(corners: np.ndarray, size: float, near: float) -> np.ndarray:
    """Coordinates of corners, those within ``near`` as one, and evenly spaced ones between them."""
    known = np.sort(corners)
    known = known[np.append(True, np.diff(known) > near)]
    parts = [
        np.linspace(low, high, 2 * max(int(np.ceil((high - low) / (2 * size) - 1e-9)), 1) + 1)[:-1]
        for low, high in pairwise(known)
    ]
    return np.append(np.concatenate(parts), known[-1])


def gmsh_triangles(outline: shapely.Polygon, size: float) -> tuple[np.ndarray, np.ndarray]:
    """Points (n, 2) in metres and triangles (m, 3), int64, of a polygon by gmsh. Not collective."""
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
        geo, lines, lengths, loops = gmsh.model.geo, [], [], []
        for ring in (outline.exterior, *outline.interiors):
            corners = (np.asarray(ring.coords)[:-1, :2] - low) / scale
            tags = [geo.addPoint(x, y, 0.0) for x, y in corners]
            sides = [geo.addLine(a, b) for a, b in zip(tags, np.roll(tags, -1), strict=True)]
            lengths.append(np.linalg.norm(corners - np.roll(corners, -1, axis=0), axis=1))
            loops.append(geo.addCurveLoop(sides))
            lines += sides
        geo.addPlaneSurface(loops)
        geo.synchronize()
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
    order = np.argsort(node_tags)
    points = np.reshape(coordinates, (-1, 3))[order, :2] * scale + low
    triangles = np.searchsorted(node_tags, corner_tags, sorter=order)
    return points, triangles.reshape(-1, 3).astype(np.int64)


def _grow_from_short_lines(lines: np.ndarray, lengths: np.ndarray, size: float) -> None:
    """Let gmsh's mesh size grow linearly away from lines shorter than it, grouped by octaves."""
    import gmsh

    octave = np.floor(np.log2(np.maximum(size / lengths, 1.0))).astype(int)
    field = gmsh.model.mesh.field
    thresholds = []
    for k in np.unique(octave[octave > 0]):
        smallest = size / 2.0 ** (k + 1)
        distance, threshold = field.add("Distance"), field.add("Threshold")
        field.setNumbers(distance, "CurvesList", lines[octave == k].tolist())
        field.setNumber(distance, "Sampling", 3)
        field.setNumber(threshold, "InField", distance)
        field.setNumber(threshold, "SizeMin", smallest)
        field.setNumber(threshold, "SizeMax", size)
        field.setNumber(threshold, "DistMin", 0.0)
        field.setNumber(threshold, "DistMax", (size - smallest) / GROWTH)
        thresholds.append(threshold)
    if thresholds:
        least = field.add("Min")
        field.setNumbers(least, "FieldsList", thresholds)
        field.setAsBackgroundMesh(least)
