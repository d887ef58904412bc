# SPDX-License-Identifier: MIT
"""Any triangulated surface as a tool: its signed distance, sampled once, read as a smooth spline.

Facets' own normals jump, which makes forces of contact oscillate; the spline of the distance has a
continuous curvature. It rounds edges by about a cell of its grid. Grids are kept in a cache, beside
the tool's file or, where that cannot be written to, in the user's folder of caches.
"""

from __future__ import annotations

import contextlib
import hashlib
import math
import os
import tempfile
from collections.abc import Callable
from pathlib import Path

import numpy as np
from scipy import ndimage

from ..errors import InputError
from ..reading import open_regular
from ..units import format_si
from .distance import BAND, read_spline, sample, worst_jump
from .facets import SIDES, Body, checked, height_facets, radii, read
from .surface import Facets, Look, Surface

CELLS = 256  # along the longest side, by default
MOST_POINTS = 4_000_000  # of a grid by default: 32 MB on each rank
_LIMIT = 32_000_000  # of any: 256 MB on each rank, and 1.5 GB on rank 0 while it is made
REACH = 2e-3  # m from the surface, within which distances are exact by default
_DOUBTFUL = 1.25  # cells: a jump of the sign that is more than rounding
_VERSION = 2  # of what the cache holds: a change here makes new ones


class Sampled(Surface):
    """A surface by its signed distance on a grid.

    Parameters
    ----------
    coefficients : float (nx, ny, nz)
        Of the cubic B-spline, m.
    origin : float (3,)
        The grid's first point, m.
    cell, reach : float, m
    points, triangles
        The facets, for pictures: float (m, 3), m, and int32 (k, 3).
    axis, towards
        As of a facets.Body.
    closest_radius, remarks
        As of any Surface.
    """

    def __init__(
        self,
        coefficients,
        origin,
        cell,
        reach,
        points,
        triangles,
        axis,
        towards,
        closest_radius,
        remarks,
    ):
        self.reach = float(reach)
        self._coefficients, self._origin, self.cell = coefficients, origin, float(cell)
        self._facets = points, triangles
        self._axis, self._towards = int(axis), float(towards)
        self.skin_axis = self._axis
        self.closest_radius = (float(closest_radius[0]), float(closest_radius[1]))
        self.remarks = tuple(str(remark) for remark in remarks)
        self._box = np.array([points.min(axis=0), points.max(axis=0)])
        shape = np.array(coefficients.shape)
        self._low, self._high = origin + cell, origin + (shape - 2) * cell

    def look(self, points: np.ndarray) -> Look:
        """See Surface.look; the normal is the distance's gradient, of about unit length.

        Beyond the grid, which ends farther than `reach` from the tool, it is that to a box
        around the tool.
        """
        points = np.array(points, float)
        if self._axis >= 0:  # behind, a skin goes on as it is
            i = self._axis
            if self._towards > 0.0:
                points[:, i] = np.maximum(points[:, i], self._low[i])
            else:
                points[:, i] = np.minimum(points[:, i], self._high[i])
        n = len(points)
        distance, normal, curvature = np.empty(n), np.empty((n, 3)), np.empty((n, 3, 3))
        inside = ((points >= self._low) & (points <= self._high)).all(axis=1)
        grid = self._coefficients, self._origin, self.cell
        if inside.all():
            read_spline(points, *grid, distance, normal, curvature)
            return distance, normal, curvature
        m = int(inside.sum())
        there = np.empty(m), np.empty((m, 3)), np.empty((m, 3, 3))
        read_spline(points[inside], *grid, *there)
        distance[inside], normal[inside], curvature[inside] = there
        out = points[~inside]
        away = out - np.clip(out, *self._reach)
        size = np.linalg.norm(away, axis=1)
        distance[~inside], normal[~inside] = size, away / size[:, None]
        curvature[~inside] = 0.0
        return distance, normal, curvature

    @property
    def _reach(self) -> np.ndarray:
        """The box that all of the tool lies in, the end behind a skin included."""
        reach = self._box.copy()
        if self._axis >= 0:
            reach[0 if self._towards > 0.0 else 1, self._axis] = -self._towards * math.inf
        return reach

    @property
    def box(self) -> np.ndarray:
        """See Surface.box."""
        return self._box

    def facets(self, chord: float | None = None) -> Facets:
        """The file's own, whatever the chord."""
        return self._facets

    @classmethod
    def of_body(
        cls,
        body: Body,
        cell: float | None = None,
        reach: float = REACH,
        name: str = "the surface",
    ) -> Sampled:
        """Sample a body.

        `cell` [m] by default: the longest side over 256, more where the grid would take over 32 MB;
        `reach` [m]: how far from the surface distances are wanted exactly.
        Raises InputError for a grid of more than 256 MB, and for facets that cross each other.
        """
        low, high = body.points.min(axis=0), body.points.max(axis=0)
        size = high - low
        if cell is not None and not 0.0 < cell < math.inf:
            raise InputError(f"cell must be positive, got {format_si(cell, 'm')}")
        if cell is None:
            cell = _coarser(size, float(size.max()) / CELLS, reach, MOST_POINTS)
        most = _coarser(size, cell, reach, _LIMIT)
        if most > cell:
            raise InputError(
                f"cell = {format_si(cell, 'm')} makes a grid of over 256 MB for {name}, "
                f"take at least {format_si(most, 'm')}"
            )
        shape = tuple(int(n) for n in _count(size, cell, reach))
        origin = 0.5 * (low + high) - 0.5 * (np.array(shape) - 1) * cell
        depth = (2.5 * _margin(cell, reach) + 4.0) * cell  # of walls, beyond the grid
        distance = sample(body.with_rim(depth), origin, shape, cell, reach + 2.0 * cell)
        jump, place = worst_jump(distance)
        if jump > _DOUBTFUL * cell:
            where = ", ".join(format_si(x, "m") for x in origin + cell * np.array(place))
            raise InputError(
                f"what is inside of {name} is doubtful near ({where}): its facets cross each "
                "other, bodies overlap or are turned against each other; make it one clean surface"
            )
        coefficients = ndimage.spline_filter(distance, order=3, output=float)
        closest = radii(body)
        surface = cls(
            coefficients, origin, cell, reach, body.points, body.triangles, body.axis, body.towards,
            closest, (),
        )  # fmt: skip
        surface.remarks = _remarks(name, min(closest), cell)
        return surface


def _margin(cell: float, reach: float) -> float:
    """Cells around the tool."""
    return max(BAND, math.ceil(reach / cell) + 2) + 2


def _count(size: np.ndarray, cell: float, reach: float) -> np.ndarray:
    """Points of a grid along x, y, z."""
    return np.ceil(size / cell) + 2 * _margin(cell, reach) + 1


def _coarser(size: np.ndarray, cell: float, reach: float, most: int) -> float:
    """The cell, or a larger one whose grid has at most so many points."""
    while _count(size, cell, reach).prod() > most:
        cell *= 1.02
    return cell


def _remarks(name: str, radius: float, cell: float) -> tuple[str, ...]:
    if radius >= 2.0 * cell:
        return ()
    what = "has sharp edges" if radius == 0.0 else f"has radii down to {format_si(radius, 'm')}"
    cure = f'; cell = "{0.5e3 * radius:.2g} mm" resolves them' if radius > 0.1 * cell else ""
    return (
        f"{name} {what}, which its grid, of cells of {format_si(cell, 'm')}, rounds by about a "
        f"cell{cure}",
    )


def height_field(
    height: Callable[[np.ndarray, np.ndarray], np.ndarray],
    x,
    y,
    cell: float | None = None,
    reach: float = REACH,
) -> Sampled:
    """The surface z = height(x, y) with the cloth above, sampled as if it came from a file.

    Parameters
    ----------
    height : function of two arrays, m
    x, y : float (n,), (m,)
        Where it is asked, m; between, it is made of triangles, off by (step)^2/8 of its curvature.
        Beyond them it ends, with a wall.
    cell, reach
        As of Sampled.of_body.
    """
    grid = np.meshgrid(np.asarray(x, float), np.asarray(y, float), indexing="ij")
    points = np.column_stack([part.ravel() for part in (*grid, height(*grid))])
    body = checked("height field", *height_facets(points), "+z")
    return Sampled.of_body(body, cell, reach, "the height field")


def from_file(
    path: str | Path,
    unit: float | None = None,
    side: str | None = None,
    cell: float | None = None,
    reach: float = REACH,
    *,
    cache: bool = True,
) -> Sampled:
    """A tool from a file; rank 0 does this alone, see tool.load.

    Parameters
    ----------
    path
        STL (binary or text), OBJ, PLY; STEP, through cascadio or gmsh; CSV: points x, y, z of
        a height field.
    unit : float
        Metres in one of the file's unit; None for STEP, which says so itself.
    side : str, optional
        Where the cloth lies. Closed bodies: "outside" (the default) or "inside". Open skins: "+x",
        "-x", "+y", "-y", "+z" or "-z", along which no part of them may lie behind another.
    cell, reach : float, optional
        Of the grid, m; see Sampled.of_body.
    cache : bool
        Read the grid if it has been made before, else keep it. One that is damaged is made anew.

    Raises
    ------
    InputError
        A file that cannot be read or is none of these; no surface, open without a side, inside out,
        crossing itself; smaller than 2 mm or larger than 20 m; a grid of more than 256 MB.
    """
    path = Path(path)
    if side is not None and side not in (*SIDES, "outside", "inside"):
        known = ", ".join(f'"{one}"' for one in (*SIDES, "outside", "inside"))
        raise InputError(f'side must be one of {known}, got "{side}"')
    if path.suffix.lower() == ".csv" and side is None:
        side = "+z"
    places: list[Path] = []
    if cache:
        with contextlib.suppress(OSError, ValueError):  # read says what is wrong
            places = _caches(path, repr((_VERSION, unit, side, cell, reach)))
    for place in places:
        with contextlib.suppress(Exception):  # damaged in any way
            return _load(place)
    name = f'"{path}"'
    surface = Sampled.of_body(checked(str(path), *read(path, unit), side), cell, reach, name)
    for place in places:
        with contextlib.suppress(OSError):
            _save(surface, place)
            break
    return surface


def _caches(path: Path, how: str) -> list[Path]:
    """Where the grid of a file may be kept, first choice first."""
    with open_regular(path, follow=True) as file:
        content = hashlib.file_digest(file, "sha256").hexdigest()[:12]
    name = f"{path.name}.{content}-{hashlib.sha256(how.encode()).hexdigest()[:8]}.distance.npz"
    home = os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache"
    return [path.parent / f".{name}", Path(home) / "cruciform_petsc" / "tools" / name]


def _load(place: Path) -> Sampled:
    with np.load(place, allow_pickle=False) as data:
        return Sampled(**dict(data))


def _save(surface: Sampled, place: Path) -> None:
    """Write a grid, whole or not at all; those of the file's former contents go."""
    place.parent.mkdir(parents=True, exist_ok=True)
    points, triangles = surface._facets
    handle, temporary = tempfile.mkstemp(dir=place.parent, prefix=".distance", suffix=".part")
    try:
        with os.fdopen(handle, "wb") as file:
            np.savez(
                file,
                coefficients=surface._coefficients,
                origin=surface._origin,
                cell=surface.cell,
                reach=surface.reach,
                points=points,
                triangles=triangles,
                axis=surface._axis,
                towards=surface._towards,
                closest_radius=surface.closest_radius,
                remarks=np.array(surface.remarks, dtype=str),
            )
        os.replace(temporary, place)
    except BaseException:
        with contextlib.suppress(OSError):
            os.unlink(temporary)
        raise
    stem, _, key = place.name.removesuffix(".distance.npz").rpartition(".")
    for former in place.parent.glob("*.distance.npz"):
        other, _, other_key = former.name.removesuffix(".distance.npz").rpartition(".")
        if other == stem and other_key[:12] != key[:12]:
            with contextlib.suppress(OSError):
                former.unlink()
