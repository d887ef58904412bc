# SPDX-License-Identifier: MIT
"""Drawings to cut by: the flat blank, its warp, its draw-in, a part's outline mapped back."""

from __future__ import annotations

import logging
from collections.abc import Mapping
from html import escape
from pathlib import Path

import numpy as np
import shapely

from ..equilibrium.state import State
from ..errors import InputError
from ..forming.kind import Forming
from ..forming.measures import outline
from ..parallel import on_root
from ..units import format_si
from .cells import lattice_cells
from .log import INDENT
from .tables import write_csv, written_whole

MM = 1e3  # in m
FINE = 0.25  # of a pitch: how far apart points of a part's outline are at most
FLAT, DRAWN_IN, PART = "flat blank", "draw-in in plan", "part on the flat blank"
WARP = "warp direction"
STYLE = {FLAT: "", DRAWN_IN: ' stroke-dasharray="2 1"', WARP: "", PART: ' stroke="red"'}
COLOURS = {FLAT: 7, DRAWN_IN: 8, WARP: 7, PART: 1}  # of DXF
ARROW, HEAD = 0.2, 0.03  # of the blank's smaller side
Rings = Mapping[str, list[np.ndarray]]  # by layer, mm (n, 2); closed ones end where they begin


def write_pattern(
    directory: Path,
    forming: Forming,
    state: State,
    log: logging.Logger,
    part: shapely.Polygon | None = None,
) -> list[str]:
    """Write outline.csv, .svg and .dxf; with a part net_pattern.csv and .dxf. Collective.

    ``part`` is the outline that the formed cloth is trimmed to, in plan (x, y), m. Mapped back it
    is the blank to cut: a net pattern. Without ezdxf there is no DXF, and the log says so.

    Returns
    -------
    list of str
        Where the cloth does not reach the part's outline, or lies over itself there.
    """
    comm, table = forming.network.comm, outline(forming.blank, state)
    names = ("x_rest_mm", "y_rest_mm", "x_mm", "y_mm", "z_mm")
    columns = {name: MM * table[:, 1 + k] for k, name in enumerate(names)}
    write_csv(
        comm,
        directory / f"outline{forming.suffix}.csv",
        {"ring": table[:, 0].astype(int), **columns},
    )
    polygon = forming.network.preform.outline
    flat = [MM * np.asarray(r.coords)[:, :2] for r in (polygon.exterior, *polygon.interiors)]
    now = [MM * table[table[:, 0] == ring][:, 3:5] for ring in range(len(flat))]
    rings = {FLAT: flat, DRAWN_IN: [np.concatenate([r, r[:1]]) for r in now]}
    rings[WARP] = [_arrow(flat[0], forming.network.to_lab(np.eye(2))[0])]
    remarks: list[str] = []
    if part is not None:
        net, remarks = mapped_back(forming, state, part)
        columns = {name: MM * net[:, 1 + k] for k, name in enumerate(names)}
        ring = net[:, 0].astype(int)
        write_csv(comm, directory / f"net_pattern{forming.suffix}.csv", {"ring": ring, **columns})
        rings[PART] = [piece for k in np.unique(ring) for piece in _pieces(MM * net[ring == k])]
    on_root(comm, lambda: _write_svg(directory / f"outline{forming.suffix}.svg", rings))
    missing = on_root(comm, lambda: _write_dxf(directory / f"outline{forming.suffix}.dxf", rings))
    if part is not None and not missing:  # nothing but what is cut, as a blank can be read from
        on_root(comm, lambda: _write_dxf(directory / "net_pattern.dxf", {PART: rings[PART]}))
    if missing:
        log.info("%sno outline.dxf: %s", INDENT, missing)
    return remarks


def mapped_back(
    forming: Forming, state: State, part: shapely.Polygon
) -> tuple[np.ndarray, list[str]]:
    """Where a curve in plan lies on the flat blank. Collective.

    Cells between crossovers are taken as two triangles; where cloth lies over itself the upper one
    counts.

    Returns
    -------
    float (n, 6)
        Number of the ring, x and y on the flat blank, and x, y, z formed, m, in order along the
        rings, which end where they begin; NaN where there is no cloth. On rank 0; else none.
    list of str
        Remarks, on every rank.
    """
    network, blank, comm = forming.network, forming.blank, forming.network.comm
    pitch = float(network.pitch.min())
    lines = [shapely.segmentize(r, FINE * pitch) for r in (part.exterior, *part.interiors)]
    curve = np.concatenate([np.asarray(line.coords)[:, :2] for line in lines])
    ring = np.repeat(np.arange(len(lines)), [len(line.coords) for line in lines])
    cloth = blank.of_cloth(state)
    place = cloth.x[blank.ply.nodes.of_hinge]
    cells = lattice_cells(network, place, blank.ply.carrying(cloth))
    full = (cells.corner >= 0).all(axis=1)
    halves = [(cells.corner[:, at] >= 0).all(axis=1) for at in _TRIANGLES]
    halves = [good & (full if k < 2 else ~full) for k, good in enumerate(halves)]
    now, rest = (
        np.concatenate([p[good][:, at] for at, good in zip(_TRIANGLES, halves, strict=True)])
        for p in (cells.place, cells.rest)
    )
    tree = shapely.STRtree(shapely.polygons(now[..., :2]))
    point, triangle = tree.query(shapely.points(curve), "intersects")
    share, sound = _barycentric(curve[point], now[triangle][..., :2])
    point, triangle, share = point[sound], triangle[sound], share[sound]
    back = np.einsum("nk,nkd->nd", share, rest[triangle])
    height = np.einsum("nk,nk->n", share, now[triangle][..., 2])
    away = np.full(len(curve), np.inf)
    if len(tree.geometries):
        nearest = tree.geometries[tree.nearest(shapely.points(curve))]
        away = shapely.distance(shapely.points(curve), nearest)
    away = np.min(comm.allgather(away), axis=0)
    hits = np.concatenate(comm.allgather(np.column_stack([point, back, height])))
    hits = hits[np.lexsort(hits[:, [3, 0]].T)]  # of each point the highest last
    found = np.full((len(curve), 3), np.nan)
    found[hits[:, 0].astype(int)] = hits[:, 1:]
    remarks = []
    lost = np.isnan(found[:, 0])
    if lost.any():
        at = int(np.argmax(np.where(lost, away, -1.0)))
        x, y = (format_si(float(f"{v:.4g}"), "m") for v in curve[at])
        remarks.append(
            f"output.part_outline: the formed cloth's outermost crossovers do not reach it on "
            f"{100.0 * lost.mean():.3g} % of its length, by up to "
            f"{format_si(float(f'{away[at]:.3g}'), 'm')} at x = {x}, y = {y}: the blank is too "
            "small there, and net_pattern.csv has gaps"
        )
    apart = np.linalg.norm(hits[:, 1:3] - found[hits[:, 0].astype(int), :2], axis=1)
    if (apart > pitch).any():
        x, y = (format_si(float(f"{v:.4g}"), "m") for v in curve[int(hits[apart.argmax(), 0])])
        remarks.append(
            f"output.part_outline: in plan the formed cloth lies over itself there, at x = {x}, "
            f"y = {y} for one; the upper layer was taken"
        )
    table = np.column_stack([ring, found[:, :2], curve, found[:, 2]])
    return table[: len(table) if comm.rank == 0 else 0], remarks


# Corners of the two halves of a cell, and of cells that lack one.
_TRIANGLES = np.array([[0, 1, 2], [0, 2, 3], [1, 2, 3], [2, 3, 0], [3, 0, 1], [0, 1, 2]])


def _barycentric(points: np.ndarray, corners: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Shares (n, 3) of corners (n, 3, 2) in points (n, 2); whether the triangle has an area."""
    a, b = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    p = points - corners[:, 0]

    def cross(u: np.ndarray, v: np.ndarray) -> np.ndarray:
        return u[:, 0] * v[:, 1] - u[:, 1] * v[:, 0]

    area = cross(a, b)
    sound = abs(area) > 1e-6 * ((a**2).sum(axis=1) + (b**2).sum(axis=1))
    area = np.where(sound, area, 1.0)
    second, third = cross(p, b) / area, cross(a, p) / area
    return np.column_stack([1.0 - second - third, second, third]), sound


def _arrow(around: np.ndarray, along: np.ndarray) -> np.ndarray:
    """An arrow in the middle of a ring (n, 2), along a unit vector (2,), in one stroke (5, 2)."""
    low, high = around.min(axis=0), around.max(axis=0)
    side, across = float((high - low).min()), np.array([-along[1], along[0]])
    tip = 0.5 * (low + high) + 0.5 * ARROW * side * along
    barbs = [tip - HEAD * side * (along + sign * 0.5 * across) for sign in (1.0, -1.0)]
    return np.array([tip - ARROW * side * along, tip, barbs[0], tip, barbs[1]])


def _pieces(ring: np.ndarray) -> list[np.ndarray]:
    """What is known of a ring (n, 6), on the flat blank."""
    points = ring[:, 1:3]
    lost = np.isnan(points[:, 0])
    return [p for p in np.split(points, np.flatnonzero(np.diff(lost)) + 1) if not np.isnan(p[0, 0])]


def _write_svg(path: Path, rings: Rings) -> None:
    """In mm, y upwards; a group for each layer."""
    points = np.concatenate([ring for layer in rings.values() for ring in layer])
    low, size = points.min(axis=0) - 5.0, np.ptp(points, axis=0) + 10.0
    lines = [
        f'<svg xmlns="http://www.w3.org/2000/svg" width="{size[0]:.6g}mm" '
        f'height="{size[1]:.6g}mm" viewBox="{low[0]:.6g} {-low[1] - size[1]:.6g} '
        f'{size[0]:.6g} {size[1]:.6g}" fill="none" stroke="black" stroke-width="0.3">'
    ]
    for layer, curves in rings.items():
        lines.append(f'<g id="{escape(layer)}"{STYLE[layer]}>')
        for ring in curves:
            text = " ".join(f"{x:.4f},{-y:.4f}" for x, y in ring)
            lines.append(f'<polyline points="{text}"/>')
        if layer == WARP:
            x, y = curves[0][1]
            size = np.linalg.norm(np.ptp(curves[0][:2], axis=0)) / 8.0
            lines.append(
                f'<text x="{x:.4f}" y="{-y:.4f}" dx="2" font-size="{size:.4g}" '
                'font-family="sans-serif" fill="black" stroke="none">warp</text>'
            )
        lines.append("</g>")
    with written_whole(path) as temporary:
        temporary.write_text("\n".join([*lines, "</svg>", ""]))


def _write_dxf(path: Path, rings: Rings) -> str:
    """In mm; a layer each. Returns why there is none, if so."""
    try:
        import ezdxf
    except ImportError:
        return "it needs ezdxf (pip install ezdxf)"
    document = ezdxf.new("R2000", units=ezdxf.units.MM)
    for layer in rings:
        document.layers.add(layer, color=COLOURS[layer])
        for ring in rings[layer]:
            closed = bool((ring[0] == ring[-1]).all())
            points = ring[: len(ring) - closed].tolist()
            document.modelspace().add_lwpolyline(points, close=closed, dxfattribs={"layer": layer})
    try:
        with written_whole(path) as temporary:
            document.saveas(temporary)
    except ezdxf.DXFError as error:
        raise InputError(f'"{path}" cannot be written: {error}') from None
    return ""
