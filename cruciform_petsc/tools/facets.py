# SPDX-License-Identifier: MIT
"""Triangulated surfaces: read from files, checked, turned one way, closed where they are skins."""

from __future__ import annotations

import math
import tempfile
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import Delaunay

from ..errors import InputError
from ..reading import MIB, read_given
from ..units import format_si
from .profile import ROUNDING, clean

SIDES = {f"{sign}{axis}": k for k, axis in enumerate("xyz") for sign in "+-"}
_LARGEST, _SMALLEST = 20.0, 2e-3  # m, of a tool
_LARGEST_FILE = 512 * MIB
SHARP = math.radians(40.0)  # beyond it two facets meet at an edge and are not one smooth surface
_AROUND, _CHORD = 48, 0.05  # facets of a STEP file: so many around a circle; off by so many mm
_AWAY = 1e-3  # share of a skin that may face away from its side


@dataclass(frozen=True, eq=False)
class Body:
    """Triangles that bound a tool, seen counter-clockwise from the cloth.

    Attributes
    ----------
    points : float (m, 3), m
    triangles : int32 (k, 3)
    skin : int
        So many of the triangles, the first, are the file's own; the others close a skin at its rim.
    axis : int
        0, 1, 2: a skin goes on behind along x, y, z without an end; -1: all of it is there.
    towards : float
        +1 or -1, the side of the axis on which the cloth lies.
    """

    points: np.ndarray
    triangles: np.ndarray
    skin: int
    axis: int = -1
    towards: float = 1.0

    def with_rim(self, depth: float) -> Body:
        """Walls from the rim of a skin down to `depth` [m] behind its farthest point."""
        if self.axis < 0:
            return self
        count = len(self.points)
        bottom = self.points.copy()
        ends = self.towards * self.points[:, self.axis]
        bottom[:, self.axis] = self.towards * (ends.min() - depth)
        a, b = _directed(self.triangles)[_open(self.triangles)].T
        walls = np.concatenate(
            [np.stack([b, a, a + count], 1), np.stack([b, a + count, b + count], 1)]
        )
        return replace(
            self,
            points=np.vstack([self.points, bottom]),
            triangles=np.vstack([self.triangles, walls]).astype(np.int32),
        )


def read(path: Path, unit: float | None) -> tuple[np.ndarray, np.ndarray]:
    """Points [m] and triangles of an STL, OBJ, PLY or STEP file, or of heights in a CSV file.

    ``unit`` is how many metres one in the file is; None for STEP, which says so itself. Raises
    InputError for a file that is not there, cannot be read or has nothing in it.
    """
    kind = path.suffix.lower()
    readers = {
        ".stl": _vtk,
        ".obj": _vtk,
        ".ply": _vtk,
        ".csv": _heights,
        ".step": _step,
        ".stp": _step,
    }
    if kind not in readers:
        raise InputError(f'"{path}" must be an STL, OBJ, PLY, STEP or CSV file by its ending')
    if (unit is None) != (readers[kind] is _step):
        need = "needs" if unit is None else "says it itself and must not have"
        raise InputError(f'"{path}" {need} the key unit, for example "mm"')
    data = read_given(path, "file", kind[1:].upper(), _LARGEST_FILE, zeros=True)
    if not data:
        raise InputError(f'"{path}" is empty')
    points, triangles = readers[kind](path, data)
    if len(triangles) == 0:
        raise InputError(f'"{path}" has no facets, or is no {kind[1:].upper()} file')
    if triangles.min() < 0 or triangles.max() >= len(points):
        raise InputError(f'"{path}" is damaged: a facet has a corner that is not in the file')
    used, inverse = np.unique(triangles, return_inverse=True)
    points = np.asarray(points, float)[used] * (1.0 if unit is None else unit)
    triangles = inverse.reshape(-1, 3)
    if not np.isfinite(points).all():
        raise InputError(f'"{path}" has a point that is not finite')
    size = float(np.ptp(points, axis=0).max())
    if not _SMALLEST <= size <= _LARGEST:
        fitting = [
            f'"{name}" makes it {_long(size * si / (unit or 1.0))}'
            for name, si in (("mm", 1e-3), ("cm", 1e-2), ("m", 1.0), ("in", 0.0254))
            if unit is not None and 2.0 * _SMALLEST < size * si / unit < 0.25 * _LARGEST
        ]
        hint = f": is its unit right? {', '.join(fitting)}" if fitting else ""
        raise InputError(
            f'"{path}" is a tool of {_long(size)}, which must be between {_long(_SMALLEST)} and '
            f"{_long(_LARGEST)}{hint}"
        )
    return clean(points, triangles)


def _long(size: float) -> str:
    """A length in the unit that suits it."""
    unit, si = ("km", 1e3) if size >= 1e3 else ("m", 1.0) if size >= 2.0 else ("mm", 1e-3)
    return f"{size / si:.4g} {unit}"


def _vtk(path: Path, data: bytes) -> tuple[np.ndarray, np.ndarray]:
    """Read what VTK reads: STL, OBJ, PLY, and GLB with all its parts as one."""
    try:
        from vtkmodules.util.numpy_support import vtk_to_numpy
        from vtkmodules.vtkFiltersCore import vtkTriangleFilter
        from vtkmodules.vtkFiltersGeometry import vtkCompositeDataGeometryFilter
        from vtkmodules.vtkIOGeometry import vtkGLTFReader, vtkOBJReader, vtkSTLReader
        from vtkmodules.vtkIOPLY import vtkPLYReader
    except ImportError:
        raise InputError(f'"{path}" is read by VTK, which is missing here') from None
    kind = path.suffix.lower()
    {".stl": _check_stl, ".ply": _check_ply}.get(kind, lambda path, data: None)(path, data)
    readers = {
        ".stl": vtkSTLReader,
        ".obj": vtkOBJReader,
        ".ply": vtkPLYReader,
        ".glb": vtkGLTFReader,
    }
    reader, join = readers[kind](), vtkCompositeDataGeometryFilter()
    problems: list[str] = []
    triangulate = vtkTriangleFilter()
    for step in (reader, reader.GetExecutive(), join, triangulate):
        for event in ("ErrorEvent", "WarningEvent"):  # else they go to the terminal
            step.AddObserver(event, lambda *_: problems.append("error"))
    reader.SetFileName(str(path))
    join.SetInputConnection(reader.GetOutputPort())
    triangulate.SetInputConnection((join if kind == ".glb" else reader).GetOutputPort())
    triangulate.PassVertsOff()
    triangulate.PassLinesOff()
    triangulate.Update()
    found = triangulate.GetOutput()
    if problems or found.GetNumberOfPolys() == 0:
        raise InputError(f'"{path}" is no {kind[1:].upper()} file, is cut off or has no facets')
    cells = vtk_to_numpy(found.GetPolys().GetConnectivityArray()).reshape(-1, 3)
    return vtk_to_numpy(found.GetPoints().GetData()).astype(float), cells.astype(np.int64)


def _check_stl(path: Path, data: bytes) -> None:
    """A binary STL is as long as its count of facets says; VTK takes what there is."""
    size, head = len(data), data[:84]
    count = int.from_bytes(head[80:84], "little")
    text = head.lstrip()[:5].lower() == b"solid" and b"\0" not in head
    if size == 84 + 50 * count or (not text and 84 + 50 * count < size < 84 + 50 * count + 1024):
        return
    if not text:
        raise InputError(
            f'"{path}" is no STL file, or is cut off: it tells of {count} facets, which take '
            f"{84 + 50 * count} bytes, and has {size}"
        )
    if b"endsolid" not in data[-512:].lower():
        raise InputError(f'"{path}" is cut off: an STL file in text ends with "endsolid"')


def _check_ply(path: Path, data: bytes) -> None:
    """A PLY file's head tells what follows; VTK takes what there is."""
    head, end, body = data.partition(b"end_header")
    sizes = {b"char": 1, b"short": 2, b"int": 4, b"float": 4, b"double": 8, b"int8": 1}
    sizes |= {b"int16": 2, b"int32": 4, b"float32": 4, b"float64": 8}
    bytes_least = lines = count = 0
    for words in map(bytes.split, head.splitlines()):
        if words[:1] == [b"element"] and len(words) == 3 and words[2].isdigit():
            count = int(words[2])
            lines += count
        elif words[:1] == [b"property"] and len(words) > 2:
            each = [sizes.get(word.removeprefix(b"u"), 1) for word in words[1:-1]]
            bytes_least += count * (each[1] + 3 * each[2] if words[1] == b"list" else each[0])
    least, there = bytes_least, len(body)
    if b"ascii" in head:
        least, there = lines, len(body.split(b"\n")) - 1
    if not end or there < least:
        raise InputError(f'"{path}" is no PLY file, or is cut off')


def _heights(path: Path, data: bytes) -> tuple[np.ndarray, np.ndarray]:
    """Points x, y, z in three columns, joined to triangles as seen from above."""
    try:
        text = data.decode("utf-8-sig").splitlines()
        first = 0 if text and _numbers(text[0]) else 1
        points = np.loadtxt(text, delimiter=",", skiprows=first, ndmin=2)
    except (ValueError, UnicodeDecodeError) as error:
        raise InputError(f'"{path}" must have three columns of numbers, x, y, z: {error}') from None
    if points.shape[1:] != (3,) or len(points) < 3:
        raise InputError(f'"{path}" must have three columns of numbers, x, y, z, and three rows')
    return height_facets(points)


def _numbers(line: str) -> bool:
    try:
        return bool([float(part) for part in line.split(",")])
    except ValueError:
        return False


def height_facets(points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Triangles between points (n, 3) that are above each other nowhere, Delaunay's in plan."""
    points = np.asarray(points, float)
    if not np.isfinite(points).all():
        raise InputError("heights must be finite")
    if len(np.unique(points[:, :2], axis=0)) < len(points):
        raise InputError("heights tell of one place twice")
    try:
        triangles = Delaunay(points[:, :2]).simplices
    except Exception:  # Qhull's, of points in one line
        raise InputError("heights lie in one line") from None
    return points, triangles


def _step(path: Path, data: bytes) -> tuple[np.ndarray, np.ndarray]:
    """Facets of a STEP file, which OpenCASCADE makes, in cascadio or in gmsh; in metres."""
    if not data.lstrip().startswith(b"ISO-10303-21"):
        raise InputError(f'"{path}" is no STEP file: it does not begin with "ISO-10303-21"')
    try:
        import cascadio
    except ImportError:
        return _step_by_gmsh(path)
    glb = cascadio.load(data, "step", tol_linear=_CHORD, tol_angular=2.0 * math.pi / _AROUND)
    if not glb:
        raise InputError(f'"{path}" cannot be read as STEP: it is damaged or has no surface')
    with tempfile.TemporaryDirectory() as folder:
        place = Path(folder) / "tool.glb"
        place.write_bytes(glb)
        try:
            return _vtk(place, glb)
        except InputError as error:
            raise InputError(str(error).replace(str(place), str(path))) from None


def _step_by_gmsh(path: Path) -> tuple[np.ndarray, np.ndarray]:
    """Read it where there is gmsh in place of cascadio."""
    try:
        import gmsh
    except ImportError:
        raise InputError(
            f'"{path}" needs cascadio (pip install cascadio) or gmsh, which are missing here: '
            "install one, or save the tool as STL"
        ) from None
    begun = not gmsh.isInitialized()
    if begun:
        gmsh.initialize(interruptible=False)
    try:
        gmsh.option.setNumber("General.Terminal", 0)
        gmsh.model.add("tool")
        gmsh.option.setString("Geometry.OCCTargetUnit", "M")
        gmsh.model.occ.importShapes(str(path))
        gmsh.model.occ.synchronize()
        low, high = np.reshape(gmsh.model.getBoundingBox(-1, -1), (2, 3))
        gmsh.option.setNumber("Mesh.MeshSizeFromCurvature", _AROUND)
        gmsh.option.setNumber("Mesh.MeshSizeMax", float(np.ptp([low, high], axis=0).max()) / 20.0)
        gmsh.model.mesh.generate(2)
        tags, coordinates, _ = gmsh.model.mesh.getNodes()
        _, nodes = gmsh.model.mesh.getElementsByType(2)
    except Exception as error:  # gmsh raises nothing narrower
        raise InputError(f'"{path}" cannot be read as STEP: {error}') from None
    finally:
        if begun:
            gmsh.finalize()
        else:
            gmsh.model.remove()
    number = np.zeros(int(tags.max(initial=0)) + 1, np.int64)
    number[tags.astype(np.int64)] = np.arange(len(tags))
    return coordinates.reshape(-1, 3), number[nodes.astype(np.int64)].reshape(-1, 3)


# -- checks ----------------------------------------------------------------------------------------


def _directed(triangles: np.ndarray) -> np.ndarray:
    """Edges (3 k, 2) of the triangles, as each runs along them."""
    return triangles[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2)


def _edges(triangles: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Number of each directed edge's edge, and how many triangles each edge has."""
    ends = np.sort(_directed(triangles).astype(np.int64), axis=1)
    key = ends[:, 0] * (int(triangles.max()) + 1) + ends[:, 1]
    _, number, count = np.unique(key, return_inverse=True, return_counts=True)
    return number.reshape(-1), count


def _open(triangles: np.ndarray) -> np.ndarray:
    """Which directed edges have one triangle only, bool (3 k,)."""
    number, count = _edges(triangles)
    return count[number] == 1


def pairs(triangles: np.ndarray) -> np.ndarray:
    """Directed edges that two triangles share: int (n, 2), numbers 3 triangle + edge."""
    number, count = _edges(triangles)
    order = np.argsort(number, kind="stable")
    order = order[count[number[order]] == 2]
    return order.reshape(-1, 2)


def vectors(points: np.ndarray, triangles: np.ndarray) -> np.ndarray:
    """Twice the area of each triangle along its normal, (k, 3) m^2."""
    a, b, c = (points[triangles[:, k]] for k in range(3))
    return np.cross(b - a, c - a)


def normals(points: np.ndarray, triangles: np.ndarray) -> np.ndarray:
    """Unit normals (k, 3) of the triangles; zero of those without a width, which close cracks."""
    area = vectors(points, triangles)
    size = np.linalg.norm(area, axis=1, keepdims=True)
    edges = points[triangles[:, [1, 2, 0]]] - points[triangles]
    longest = np.linalg.norm(edges, axis=2).max(axis=1, keepdims=True)
    flat = size <= ROUNDING * np.ptp(points, axis=0).max() * longest
    return np.divide(area, size, out=np.zeros_like(area), where=~flat)


def _at(point: np.ndarray) -> str:
    return "(" + ", ".join(format_si(float(x), "m") for x in point) + ")"


def checked(path: str, points: np.ndarray, triangles: np.ndarray, side: str | None) -> Body:
    """Turn all facets towards the cloth.

    Parameters
    ----------
    path : str
        For messages.
    points, triangles
        As `read` gives them.
    side : str, optional
        Where the cloth lies: "+x" to "-z", necessary of an open skin; of a closed body "outside",
        the default, or "inside".

    Raises InputError for what is not a surface: edges of three facets or a side that cannot be
    told; for an open one without a side, one that faces away from it, and a closed one that is
    inside out.
    """
    number, count = _edges(triangles)
    if (count > 2).any():
        edge = _directed(triangles)[np.flatnonzero(count[number] > 2)[0]]
        raise InputError(
            f'"{path}" is not a surface: {count.max()} facets meet in one edge at '
            f"{_at(points[edge].mean(axis=0))}"
        )
    triangles, body = _oriented(path, points, triangles)
    rim = count[number] == 1
    area = vectors(points, triangles)
    if not rim.any():
        volume = (
            float(np.einsum("ij,ij->", points[triangles[:, 0]] - points.mean(axis=0), area)) / 6.0
        )
        if volume < 0.0 and side is None:
            raise InputError(
                f'"{path}" is inside out, its facets look inwards: say side = "outside" or '
                '"inside", where the cloth lies'
            )
        if (volume < 0.0) != (side == "inside"):
            triangles = triangles[:, ::-1]
        return Body(points, np.ascontiguousarray(triangles), len(triangles))
    if side not in SIDES:
        edge = _directed(triangles)[np.flatnonzero(rim)[0]]
        raise InputError(
            f'"{path}" is open: {int(rim.sum())} edges have one facet only, the first at '
            f'{_at(points[edge].mean(axis=0))}; mend it, or, of a skin, say side = "+z" (or '
            "another axis): where the cloth lies"
        )
    axis, towards = SIDES[side], 1.0 if side[0] == "+" else -1.0
    along = towards * area[:, axis]
    wrong = np.bincount(body, along) < 0.0
    triangles = np.where(wrong[body][:, None], triangles[:, ::-1], triangles)
    along = np.where(wrong[body], -along, along)
    size = np.linalg.norm(area, axis=1)
    away = along < -1e-3 * size
    if size[away].sum() > _AWAY * size.sum():
        worst = int(np.argmin(along))
        percent = 100.0 * size[away].sum() / size.sum()
        raise InputError(
            f'"{path}" is an open skin of which {percent:.2g} % faces away from side = "{side}", '
            f"for example at {_at(points[triangles[worst]].mean(axis=0))}: name another side, or "
            "cut that part off"
        )
    return Body(points, np.ascontiguousarray(triangles), len(triangles), axis, towards)


def _oriented(
    path: str, points: np.ndarray, triangles: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Turn facets the way most of their body is turned; also the number of each one's body."""
    first, second = pairs(triangles).T
    directed = _directed(triangles)
    alike = directed[first, 0] == directed[second, 1]  # neighbours run along an edge oppositely
    f, g, n = first // 3, second // 3, len(triangles)
    # Each facet twice, as it is and turned: what must be turned alike is connected.
    rows = np.concatenate([f, f + n])
    columns = np.concatenate([np.where(alike, g, g + n), np.where(alike, g + n, g)])
    graph = coo_array((np.ones(len(rows), np.int8), (rows, columns)), shape=(2 * n, 2 * n))
    _, label = connected_components(graph, directed=False)
    if (label[:n] == label[n:]).any():
        where = int(np.argmax(label[:n] == label[n:]))
        raise InputError(
            f'"{path}" has no two sides, like a Moebius strip, near '
            f"{_at(points[triangles[where]].mean(axis=0))}"
        )
    body = np.unique(np.minimum(label[:n], label[n:]), return_inverse=True)[1].reshape(-1)
    turned = label[:n] > label[n:]
    area = np.linalg.norm(vectors(points, triangles), axis=1)
    mostly = np.bincount(body, np.where(turned, area, -area)) > 0.0
    turn = turned ^ mostly[body]
    return np.where(turn[:, None], triangles[:, ::-1], triangles), body


def radii(body: Body) -> tuple[float, float]:
    """Smallest radii where a body bulges and where it is hollow, m, as its facets tell them.

    Two facets at an angle a whose far corners are h_1 and h_2 from the edge between them approach
    a radius of (h_1 + h_2)/(4 tan(a/2)); beyond 40 degrees they make a sharp edge, of radius 0.
    Angles that rounding of the points (to 1e-6 of the size) could make do not count; nor does the
    sharpest half percent of all edges.
    """
    triangles = body.triangles[: body.skin]
    area = vectors(body.points, triangles)
    size = np.linalg.norm(area, axis=1)
    normal = normals(body.points, triangles)
    first, second = pairs(triangles).T
    ends = body.points[_directed(triangles)[first]]
    length = np.linalg.norm(ends[:, 1] - ends[:, 0], axis=1)
    f, g = first // 3, second // 3
    sine = np.linalg.norm(np.cross(normal[f], normal[g]), axis=1)
    angle = np.arctan2(sine, np.einsum("ij,ij->i", normal[f], normal[g]))
    far = triangles[g, (second % 3 + 2) % 3]
    hollow = np.einsum("ij,ij->i", body.points[far] - ends[:, 0], normal[f]) > 0.0
    height = (size[f] + size[g]) / length
    radius = np.where(angle > SHARP, 0.0, height / (4.0 * np.tan(0.5 * angle) + 1e-300))
    rounding = ROUNDING * np.ptp(body.points, axis=0).max() * length
    counts = (angle - math.radians(0.05)) * np.minimum(size[f], size[g]) > rounding

    def smallest(which: np.ndarray) -> float:
        chosen = which & counts
        if not chosen.any():
            return math.inf
        order = np.argsort(radius[chosen])
        share = np.cumsum(length[chosen][order])
        number = np.searchsorted(share, 5e-3 * length.sum())
        return float(radius[chosen][order][number]) if number < len(order) else math.inf

    return smallest(~hollow), smallest(hollow)
