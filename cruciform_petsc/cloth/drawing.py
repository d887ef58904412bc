# SPDX-License-Identifier: MIT
"""Outlines from drawings, DXF (ezdxf) and SVG (svgelements): closed lines, and names of edges.

Lines, arcs and curves are joined where their ends meet. The closed line around all others is the
outline, those within it are holes. What is drawn on a layer (DXF; not "0") or has a label or an id
(SVG) is an edge of that name, with - for what is neither letter nor digit.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import shapely
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from ..errors import InputError, shown
from ..units import format_si

GAP = 1e-4  # of the drawing's size: ends that are nearer to each other meet
_CHORD = 1e-4  # of the drawing's size: how far chords of a curve may be from it
_POINTS = 48  # on each curve of an SVG
_INSUNITS = {1: 0.0254, 2: 0.3048, 4: 1e-3, 5: 1e-2, 6: 1.0, 10: 0.9144, 13: 1e-6, 14: 0.1}  # m
_CSS = {"mm": 1e-3, "cm": 1e-2, "in": 0.0254, "pt": 0.0254 / 72, "pc": 0.0254 / 6}  # m
_PPI = 96.0  # pixels to the inch, of SVG
_INKSCAPE = "{http://www.inkscape.org/namespaces/inkscape}label"

Lines = list[tuple[str, np.ndarray]]  # name of the edge or "", points (n, 2)


def read_drawing(
    path: str | Path, unit: float | None = None
) -> tuple[shapely.Polygon, dict[str, np.ndarray]]:
    """Outline [m] of a DXF or SVG file, and its named edges, segments (n, 2, 2).

    ``unit``: one unit of the drawing [m]; by default the file's own.

    Raises
    ------
    InputError
        The file cannot be read, has no unit or no closed line, several bodies, or loose ends; the
        package that reads it is missing.
    """
    kinds = {".dxf": _dxf, ".svg": _svg}
    read = kinds.get(Path(path).suffix.lower())
    if read is None:
        raise InputError(f'"{path}" is no drawing that can be read, which are .dxf and .svg')
    try:
        lines, scale = read(Path(path))
    except OSError as error:
        raise InputError(f'"{path}" cannot be read: {error.strerror or error}') from None
    if unit is None and scale is None:
        raise InputError(f'"{path}" does not tell its unit, write for example unit = "mm"')
    try:
        return outline_of([(name, points * (unit or scale)) for name, points in lines])
    except InputError as error:
        raise InputError(f'"{path}" {error}') from None


def outline_of(lines: Lines) -> tuple[shapely.Polygon, dict[str, np.ndarray]]:
    """Join lines [m] to an outline with holes, and sort their pieces by names."""
    lines = [(name, points) for name, points in lines if len(points) > 1]
    if not lines:
        raise InputError("shows no lines")
    size = np.ptp(np.concatenate([points for _, points in lines]), axis=0).max()
    lines = _met(lines, GAP * size)
    strings = shapely.linestrings
    pieces = shapely.node(shapely.multilinestrings([strings(points) for _, points in lines]))
    faces, cuts, dangles, _ = (list(g.geoms) for g in shapely.polygonize_full(pieces.geoms))
    if loose := [*cuts, *dangles]:
        x, y = loose[0].coords[0]
        raise InputError(
            f"has a loose end near x = {_mm(x)}, y = {_mm(y)}: lines of an outline end where "
            "others begin, and nothing else is drawn"
        )
    around = max(faces, key=lambda face: shapely.Polygon(face.exterior).area)
    whole = shapely.Polygon(around.exterior)
    if sum(face.area for face in faces if not whole.contains(face)) > 0.0 or not (
        np.isclose(sum(face.area for face in faces), whole.area)
    ):
        raise InputError(
            "shows several outlines, or a line across one: one body, with holes within it, can be "
            "cut"
        )
    edges: dict[str, list[np.ndarray]] = {}
    boundary = around.boundary.buffer(0.01 * GAP * size)
    for name, points in lines:
        name = re.sub(r"\W+", "-", name)[:50]
        if name and boundary.covers(strings(points)):
            edges.setdefault(name, []).append(np.stack([points[:-1], points[1:]], axis=1))
    return around, {name: np.concatenate(parts) for name, parts in edges.items()}


def _met(lines: Lines, gap: float) -> Lines:
    """The same with ends that nearly meet in one point, without points that repeat."""
    ends = np.concatenate([points[[0, -1]] for _, points in lines])
    pairs = cKDTree(ends).query_pairs(gap, output_type="ndarray")
    graph = coo_array((np.ones(len(pairs)), pairs.T), shape=2 * (len(ends),))
    group = connected_components(graph, directed=False)[1]
    count = np.bincount(group)
    middle = np.stack([np.bincount(group, weights=x) / count for x in ends.T], axis=1)[group]
    met = []
    for i, (name, points) in enumerate(lines):
        moved = np.concatenate([middle[2 * i, None], points[1:-1], middle[2 * i + 1, None]])
        keep = np.append(True, np.linalg.norm(np.diff(moved, axis=0), axis=1) > 0.0)
        if keep.sum() > 1:
            met.append((name, moved[keep]))
    return met


def _mm(x: float) -> str:
    return format_si(float(f"{x:.4g}"), "m")


def _needs(package: str, path: Path, error: ImportError) -> InputError:
    return InputError(
        f'"{path}" needs {package} (pip install {package}), which is missing here: {error}'
    )


def _dxf(path: Path) -> tuple[Lines, float | None]:
    """Lines of the model space, blocks taken apart, and metres per unit."""
    try:
        import ezdxf
        from ezdxf import disassemble
        from ezdxf import path as curves
    except ImportError as error:
        raise _needs("ezdxf", path, error) from None
    try:
        drawing = ezdxf.readfile(path)
    except OSError as error:
        if error.errno is not None:
            raise
        raise InputError(f'"{path}" is no DXF file: {error}') from None
    except (ezdxf.DXFError, ValueError) as error:
        raise InputError(f'"{path}" is no DXF file, or is damaged: {error}') from None
    found = []
    for entity in disassemble.recursive_decompose(drawing.modelspace()):
        try:
            curve = curves.make_path(entity)
        except TypeError:  # a text, a dimension
            continue
        layer = entity.dxf.layer
        found += [("" if layer == "0" else layer, part) for part in curve.sub_paths()]
    corners = [(v.x, v.y) for _, part in found for v in part.control_vertices()]
    chord = _CHORD * np.ptp(np.array(corners or [(0.0, 0.0)]), axis=0).max()
    lines = [
        (layer, np.array([(v.x, v.y) for v in part.flattening(chord)])) for layer, part in found
    ]
    return lines, _INSUNITS.get(drawing.units)


def _svg(path: Path) -> tuple[Lines, float | None]:
    """Lines of all shapes with their transforms, y upwards, and metres per user unit."""
    try:
        from svgelements import SVG, Close, Line, Matrix, Shape
        from svgelements import Path as Curve
    except ImportError as error:
        raise _needs("svgelements", path, error) from None
    path.open("rb").close()
    try:
        drawing = SVG.parse(str(path), reify=True, ppi=_PPI)
        shapes = [shape for shape in drawing.elements() if isinstance(shape, Shape)]
        pixels = abs(Matrix(drawing.viewbox_transform or "").a)  # of a user unit
        unit = _svg_unit(drawing.values["attributes"])
    except Exception as error:  # a parser's, of XML, numbers or paths
        raise InputError(f'"{path}" is no SVG file, or is damaged: {error}') from None
    lines: Lines = []
    for shape in shapes:
        own = shape.values["attributes"]
        name = own.get(_INKSCAPE) or own.get("id") or ""
        for part in map(Curve, Curve(shape).as_subpaths()):
            points = np.array(list(_points(part, (Line, Close)))) / pixels
            lines.append((name, points * (1.0, -1.0)))
    return lines, unit


def _points(curve: Sequence[Any], straight: tuple[type, ...]) -> Iterator[tuple[float, float]]:
    """Points of a curve in order; its first piece is the move to where it begins."""
    yield curve[0].end
    for piece in curve[1:]:
        if piece.end is not None:
            steps = 1 if isinstance(piece, straight) else _POINTS
            yield from (piece.point((i + 1) / steps) for i in range(steps))


def _svg_unit(root: Mapping[str, Any]) -> float | None:
    """Metres per user unit, by a width with a unit and the viewBox, if there is one."""
    width = re.fullmatch(r"\s*([\d.]+(?:e-?\d+)?)\s*(mm|cm|in|pt|pc)\s*", str(root.get("width")))
    box = [float(x) for x in str(root.get("viewBox", "")).replace(",", " ").split()]
    if len(box) not in (0, 4) or (box and not box[2] > 0.0):
        raise ValueError(f"its viewBox is {shown(root['viewBox'])}")
    if width is None:
        return None
    return float(width[1]) * _CSS[width[2]] / box[2] if box else 0.0254 / _PPI
