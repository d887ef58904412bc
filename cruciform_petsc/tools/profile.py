# SPDX-License-Identifier: MIT
"""Surfaces that a profile of straight pieces and fillets makes when it is turned or extruded.

A profile is a path in the plane of r (or x) and z with the cloth on its left. Its signed distance d
is that to the closest point of any piece, exactly:

    straight piece  d = n . (q - p)               grad d = n           no curvature
    fillet          d = +-(|q - c| - R)           grad d = +-e         +-1/|q - c| across e

with e = (q - c)/|q - c|, and the sign + where the tool is inside of the circle. As the path has a
tangent everywhere, the normal is continuous, and the curvature jumps from piece to piece. Turned
about z, a surface has a second curvature, n_r/r, around the axis.
"""

from __future__ import annotations

import math

import numba
import numpy as np

from ..errors import InputError
from ..units import format_si
from .surface import Facets, Look, Surface

# Columns of a piece. Straight: p, direction, normal, first and last t. Arc: c, towards its middle,
# +1 (bulges) or -1 (hollow), R, sine of half its angle (_ALL: a circle).
_WIDTH = 9
_LINE, _ARC = 0.0, 1.0
_ALL = 2.0
ROUNDING = 1e-6  # of the size of some facets: points this close are one
EDGE = 0.02  # default radius of an edge, of the tool's smaller side; of a smooth profile's rims


@numba.njit(cache=True, error_model="numpy")
def _look(points, pieces, turned, spine, distance, normal, curvature):
    for m in range(points.shape[0]):
        x, y, z = points[m, 0], points[m, 1], points[m, 2]
        y -= min(max(y, -spine), spine)
        r = np.sqrt(x * x + y * y) if turned else x
        least, across = np.inf, 0.0
        d = nr = nz = np.nan  # stays so where the point is
        for k in range(pieces.shape[0]):
            piece = pieces[k]
            u, v = r - piece[1], z - piece[2]
            if piece[0] == _LINE:
                t = u * piece[3] + v * piece[4]
                high = u * piece[5] + v * piece[6]
                beyond = t - min(max(t, piece[7]), piece[8])
                away = np.sqrt(high * high + beyond * beyond)
                if away < least:
                    least, d, nr, nz, across = away, high, piece[5], piece[6], 0.0
            else:
                size = np.sqrt(u * u + v * v)
                if size <= 1e-300:  # in the very centre, where no normal is better than another
                    u, v, size = piece[3], piece[4], 1.0
                    off = 0.0
                else:
                    off = size
                beside = abs(u * piece[4] - v * piece[3])
                if piece[7] != _ALL and (
                    u * piece[3] + v * piece[4] < 0.0
                    or beside > (piece[7] * (1.0 + 1e-9) + 1e-12) * size
                ):
                    continue  # its ends are ends of the neighbours
                away = abs(off - piece[6])
                if away < least:
                    least = away
                    d = piece[5] * (off - piece[6])
                    nr, nz = piece[5] * u / size, piece[5] * v / size
                    across = piece[5] / size
        distance[m] = d
        ex, ey = 1.0, 0.0
        if turned and r > 0.0:
            ex, ey = x / r, y / r
        # On the axis of a surface with a level tangent there, n_r/r is the curvature along r.
        around = 0.0
        if turned and (y != 0.0 or spine == 0.0):
            around = nr / r if r > 0.0 else across
        normal[m, 0], normal[m, 1], normal[m, 2] = nr * ex, nr * ey, nz
        for i in range(3):
            along_i = (nz * ex, nz * ey, -nr)[i]
            round_i = (-ey, ex, 0.0)[i]
            for j in range(3):
                along_j = (nz * ex, nz * ey, -nr)[j]
                round_j = (-ey, ex, 0.0)[j]
                curvature[m, i, j] = across * along_i * along_j + around * round_i * round_j


class Profile(Surface):
    """A profile turned about z, or extruded along y.

    Parameters
    ----------
    path : float (n, 2)
        Corners, m: distance r from the axis (turned) or x (extruded), and z. Given in either order;
        the cloth lies above. At its ends the path goes straight down, but where it meets the axis.
    fillets : float, or one for each corner
        Radii of the corners, m; None: as large as they can be, for points of a smooth curve, and
        EDGE of its size at its rims.
    turned : bool
        Else it is extruded, without an end.
    spine : float
        A turned profile goes half around each end of a line of this length along y, m, and straight
        beside it; 0: around the axis.
    depth, width : float, optional
        What is drawn of walls that go down, and of an extruded profile along y, m.

    Raises
    ------
    InputError
        Fewer than two points, a corner without a radius, a fillet without room, points that repeat,
        r below 0, a path that turns back on itself.
    """

    _drawn: list

    def __init__(
        self,
        path,
        fillets=None,
        *,
        turned: bool = True,
        spine: float = 0.0,
        depth: float | None = None,
        width: float | None = None,
    ):
        path = np.array(path, float)
        if path.ndim != 2 or path.shape[1:] != (2,) or len(path) < 2:
            raise InputError("a profile needs at least two points, each of two lengths")
        if not np.isfinite(path).all():
            raise InputError("a profile has a point that is not finite")
        reverse = path[-1, 0] < path[0, 0]
        radii: np.ndarray | None = None
        if fillets is not None:
            radii = np.ravel(np.asarray(fillets, float))
            if len(radii) not in (1, len(path)):
                raise InputError(
                    f"a profile of {len(path)} points needs one fillet, or {len(path)}, "
                    f"got {len(radii)}"
                )
            radii = np.broadcast_to(radii, len(path))
            radii = radii[::-1] if reverse else radii
        path = path[::-1] if reverse else path
        if turned and path[:, 0].min() < 0.0:
            raise InputError("a profile that is turned about z cannot have r below 0")
        self.turned, self.spine = turned, 0.5 * spine if turned else math.inf
        self.endless = (False, not turned, False)
        size = float(np.ptp(path, axis=0).max())
        self.depth = 0.25 * size if depth is None else depth
        self.width = size if width is None else width
        self._build(path, radii, size)

    @classmethod
    def circle(cls, radius: float, *, turned: bool, width: float | None = None) -> Profile:
        """A sphere about the origin (turned), or a cylinder about y without ends."""
        self = cls.__new__(cls)
        self.turned, self.spine = turned, 0.0 if turned else math.inf
        self.endless = (False, not turned, False)
        self.depth, self.width = 0.0, 4.0 * radius if width is None else width
        self.pieces = np.array([[_ARC, 0.0, 0.0, 1.0, 0.0, 1.0, radius, _ALL, 0.0]])
        self.closest_radius = (radius, math.inf)
        middle = 0.5 * math.pi
        last = -middle if turned else middle - 2.0 * math.pi
        self._drawn = [(np.zeros(2), radius, (middle, last))]
        return self

    @classmethod
    def level(cls, width: float = 0.5) -> Profile:
        """The plane z = 0, without an end; `width` of it is drawn."""
        self = cls.__new__(cls)
        self.turned, self.spine, self.depth, self.width = False, math.inf, 0.0, width
        self.endless = (True, True, False)
        self.pieces = np.array([[_LINE, 0.0, 0.0, 1.0, 0.0, 0.0, 1.0, -math.inf, math.inf]])
        self._drawn = [np.array([-0.5 * width, 0.0]), np.array([0.5 * width, 0.0])]
        return self

    def _build(self, path: np.ndarray, radii: np.ndarray | None, size: float) -> None:
        legs = np.diff(path, axis=0)
        length = np.linalg.norm(legs, axis=1)
        if (length <= 1e-9 * length.max()).any():
            raise InputError(
                f"point {int(length.argmin()) + 2} of a profile repeats the one before"
            )
        along = legs / length[:, None]
        on_axis = self.turned and path[0, 0] == 0.0
        before = along[0] * (1.0, -1.0) if on_axis else np.array([0.0, 1.0])
        along = np.vstack([before, along, [0.0, -1.0]])
        length = np.concatenate([[length[0] if on_axis else np.inf], length, [np.inf]])
        # Angle by which the path turns at each point: to the left, +, it is hollow.
        turn = np.arctan2(
            along[:-1, 0] * along[1:, 1] - along[:-1, 1] * along[1:, 0],
            (along[:-1] * along[1:]).sum(axis=1),
        )
        corner = np.abs(turn) > 1e-9
        if (np.abs(turn) > math.radians(179.0)).any():
            number = int(np.abs(turn).argmax()) + 1
            raise InputError(f"a profile turns back on itself at its point {number}")
        half = np.tan(0.5 * np.abs(turn))
        if radii is None:
            room = 0.5 * np.minimum(length[:-1], length[1:])
            radii = np.divide(room, half, out=np.zeros_like(room), where=corner)
            rims = [-1] if on_axis else [0, -1]
            radii[rims] = np.minimum(radii[rims], EDGE * size)
        if (corner & ~(radii > 0.0)).any():
            number = int(np.argmax(corner & ~(radii > 0.0))) + 1
            raise InputError(
                f"point {number} of a profile is a sharp corner, which has no normal: "
                "give it a fillet, however small"
            )
        taken = np.where(corner, radii * half, 0.0)
        need = taken[:-1] + taken[1:]
        lacking = need > length[1:-1] * (1.0 + 1e-9)
        if on_axis and taken[0] + taken[1] > length[1] * (1.0 + 1e-9):
            lacking[0] = True
        if lacking.any():
            k = int(lacking.argmax())
            raise InputError(
                f"the fillets at points {k + 1} and {k + 2} of a profile take "
                f"{format_si(need[k], 'm')} of the {format_si(length[k + 1], 'm')} between them, "
                "make them smaller"
            )
        normal = along[:, ::-1] * (-1.0, 1.0)
        rows: list[list[float]] = []
        drawn: list = []  # a corner, or centre, radius and angles of an arc
        bulging, hollow = [math.inf], [math.inf]
        for k in range(len(along)):  # the straight piece, then the fillet at its end
            if 0 < k < len(along) - 1:
                t0, t1 = taken[k - 1], length[k] - taken[k]
                if t1 - t0 > 1e-9 * length[k]:  # else the fillets meet
                    rows.append([_LINE, *path[k - 1], *along[k], *normal[k], t0, t1])
            elif k == 0 and not on_axis:
                rows.append([_LINE, *path[0], *along[0], *normal[0], -np.inf, -taken[0]])
                drawn.append(path[0] - [0.0, max(self.depth, taken[0])])
            elif k > 0:
                rows.append([_LINE, *path[-1], *along[k], *normal[k], taken[-1], np.inf])
            if k == len(along) - 1:
                drawn.append(path[-1] - [0.0, max(self.depth, taken[-1])])
            elif corner[k]:
                convex = 1.0 if turn[k] < 0.0 else -1.0
                (bulging if convex > 0.0 else hollow).append(float(radii[k]))
                centre = path[k] - taken[k] * along[k] - convex * radii[k] * normal[k]
                middle = normal[k] + normal[k + 1]
                middle *= convex / np.linalg.norm(middle)
                sine = math.sin(0.5 * abs(turn[k]))
                rows.append([_ARC, *centre, *middle, convex, radii[k], sine, 0.0])
                first = math.atan2(*(convex * normal[k])[::-1])
                start = first + 0.5 * turn[k] if k == 0 and on_axis else first
                drawn.append((centre, float(radii[k]), (start, first + turn[k])))
            else:
                drawn.append(path[k])
        self.pieces = np.array(rows)
        self.closest_radius = (min(bulging), min(hollow))
        self._drawn = drawn

    def look(self, points: np.ndarray) -> Look:
        """See Surface.look. Exact everywhere."""
        n = len(points)
        out = np.empty(n), np.empty((n, 3)), np.empty((n, 3, 3))
        points = np.ascontiguousarray(points, float)
        _look(points, self.pieces, self.turned, self.spine, *out)
        return out

    def outline(self, chord: float) -> np.ndarray:
        """The profile as a chain of points (m, 2), walls down to `depth`; m."""
        parts: list[np.ndarray] = []
        for part in self._drawn:
            if isinstance(part, tuple):
                centre, radius, (first, last) = part
                angle = np.linspace(first, last, pieces_of_arc(radius, last - first, chord) + 1)
                part = centre + radius * np.column_stack([np.cos(angle), np.sin(angle)])
            parts.append(np.atleast_2d(part))
        return np.vstack(parts)

    @property
    def box(self) -> np.ndarray:
        """See Surface.box."""
        outline = self.outline(0.02 * max(self.width, 1e-12))
        r = np.abs(outline[:, 0]).max() if self.turned else 0.0
        low, high = outline.min(axis=0), outline.max(axis=0)
        if self.turned:
            y = r + self.spine
            return np.array([[-r, -y, low[1]], [r, y, high[1]]])
        y = 0.5 * self.width
        return np.array([[low[0], -y, low[1]], [high[0], y, high[1]]])

    def facets(self, chord: float | None = None) -> Facets:
        """See Surface.facets."""
        chord = self._chord(chord)
        outline = self.outline(chord)
        r, z = outline.T
        if self.turned:
            quarter = pieces_of_arc(float(r.max()), 0.5 * math.pi, chord)
            angle = np.linspace(0.0, math.pi, 2 * quarter + 1)
            angle = np.concatenate([angle, angle + math.pi])
            offset = np.repeat([self.spine, -self.spine], len(angle) // 2)
            x = np.outer(r, np.cos(angle))
            y = np.outer(r, np.sin(angle)) + offset
        else:
            y = np.tile(np.array([-0.5, 0.5]) * self.width, (len(r), 1))
            x = np.repeat(r[:, None], 2, axis=1)
        points = np.stack([x, y, np.broadcast_to(z[:, None], x.shape)], axis=-1)
        return join(points, around=self.turned)


def pieces_of_arc(radius: float, angle: float, chord: float) -> int:
    """How many straight pieces an arc needs; its chords are off by radius (1 - cos(half step))."""
    step = 2.0 * math.acos(max(1.0 - chord / radius, 0.5)) if radius > chord else math.pi / 3.0
    return max(1, min(2000, math.ceil(abs(angle) / step)))


def join(points: np.ndarray, around: bool) -> Facets:
    """Triangles of a net of points (n, m, 3), seen from the left of its rows; `around`: closed."""
    n, m, _ = points.shape
    number: np.ndarray = np.arange(n * m).reshape(n, m)
    if around:
        number = np.column_stack([number, number[:, 0]])
    a, b = number[:-1, :-1], number[:-1, 1:]
    c, d = number[1:, 1:], number[1:, :-1]
    triangles = np.concatenate(
        [np.stack([a, d, c], -1).reshape(-1, 3), np.stack([a, c, b], -1).reshape(-1, 3)]
    )
    return clean(points.reshape(-1, 3), triangles)


def clean(points: np.ndarray, triangles: np.ndarray) -> Facets:
    """Make points that coincide one, and leave out triangles without an area."""
    size = float(np.ptp(points, axis=0).max())
    keys = np.round((points - points.min(axis=0)) / (ROUNDING * size)).astype(np.int64)
    _, first, inverse = np.unique(keys, axis=0, return_index=True, return_inverse=True)
    triangles = inverse.reshape(-1)[triangles]
    a, b, c = triangles.T
    triangles = triangles[(a != b) & (b != c) & (c != a)].astype(np.int32)
    return points[first], triangles
