# SPDX-License-Identifier: MIT
"""Tools of simple shape, exactly. Flats lie at z = 0, and the tool below."""

from __future__ import annotations

import math

import numba
import numpy as np

from ..errors import InputError
from ..units import format_si
from .profile import EDGE, Profile, join, pieces_of_arc
from .surface import Facets, Look, Surface


@numba.njit(cache=True, error_model="numpy")
def _look_at_box(points, centre, inner, radius, distance, normal, curvature):
    q, out = np.empty(3), np.empty(3)
    for m in range(points.shape[0]):
        far, nearest = -np.inf, 0
        if np.isnan(points[m, 0] + points[m, 1] + points[m, 2]):
            distance[m], normal[m], curvature[m] = np.nan, np.nan, np.nan
            continue
        for i in range(3):
            q[i] = abs(points[m, i] - centre[i]) - inner[i]
            if q[i] > far:
                far, nearest = q[i], i
        size = 0.0
        for i in range(3):
            out[i] = max(q[i], 0.0)
            size += out[i] ** 2
        size = np.sqrt(size)
        if size <= 0.0:  # deep inside: the nearest face
            distance[m] = far - radius
            for i in range(3):
                out[i] = 1.0 if i == nearest else 0.0
        else:
            distance[m] = size - radius
            for i in range(3):
                out[i] /= size
        for i in range(3):
            s = 1.0 if points[m, i] >= centre[i] else -1.0
            normal[m, i] = s * out[i]
        for i in range(3):
            for j in range(3):
                own = 1.0 if i == j and q[i] > 0.0 else 0.0
                curvature[m, i, j] = 0.0
                if size > 0.0 and q[i] > 0.0 and q[j] > 0.0:
                    curvature[m, i, j] = (own - normal[m, i] * normal[m, j]) / size


class Box(Surface):
    """A box along the axes of its frame, with round edges.

    Parameters
    ----------
    size : (x, y, z), m
    edge_radius : float, optional
        m; the default is EDGE of the smallest side.
    centre : float (3,)
        m.
    """

    def __init__(self, size, edge_radius: float | None = None, centre=(0.0, 0.0, 0.0)):
        half = 0.5 * np.asarray(size, float)
        radius = _edge(edge_radius, 2.0 * float(half.min()))
        self._half, self._radius, self._centre = half, radius, np.asarray(centre, float)
        self.closest_radius = (radius, math.inf)

    def look(self, points: np.ndarray) -> Look:
        """See Surface.look. Exact everywhere."""
        n = len(points)
        out = np.empty(n), np.empty((n, 3)), np.empty((n, 3, 3))
        points = np.ascontiguousarray(points, float)
        _look_at_box(points, self._centre, self._half - self._radius, self._radius, *out)
        return out

    @property
    def box(self) -> np.ndarray:
        """See Surface.box."""
        return np.array([self._centre - self._half, self._centre + self._half])

    def facets(self, chord: float | None = None) -> Facets:
        """See Surface.facets."""
        inner = self._half - self._radius
        quarter = np.linspace(
            0.0, 0.5 * math.pi, pieces_of_arc(self._radius, 0.5 * math.pi, self._chord(chord)) + 1
        )
        up = np.concatenate([quarter[::-1], -quarter])
        over = np.repeat([1.0, -1.0], len(quarter))
        around = np.concatenate([quarter + k * 0.5 * math.pi for k in range(4)])
        sx, sy = (np.repeat(s, len(quarter)) for s in ([1, -1, -1, 1], [1, 1, -1, -1]))
        points = np.empty((len(up), len(around), 3))
        points[..., 0] = sx * inner[0] + self._radius * np.outer(np.cos(up), np.cos(around))
        points[..., 1] = sy * inner[1] + self._radius * np.outer(np.cos(up), np.sin(around))
        points[..., 2] = (over * inner[2] + self._radius * np.sin(up))[:, None]
        # Lids: from the ring of four corners to the middle.
        lid = np.broadcast_to(np.array([[[0.0, 0.0, 1.0]]]), (1, len(around), 3)) * self._half[2]
        points, triangles = join(np.concatenate([lid, points, -lid]), around=True)
        return points + self._centre, triangles


def _edge(radius: float | None, smallest: float) -> float:
    radius = EDGE * smallest if radius is None else float(radius)
    if not 0.0 < radius <= 0.5 * smallest * (1.0 + 1e-12):
        raise InputError(
            f"edge_radius must be positive and at most half of {format_si(smallest, 'm')}, "
            f"got {format_si(radius, 'm')}"
        )
    return min(radius, 0.5 * smallest)


def plane(size: tuple[float, float] | None = None, edge_radius: float | None = None) -> Surface:
    """The plane z = 0 without an end, or a plate of some size along x and y [m] whose top it is."""
    if size is None:
        return Profile.level()
    depth = min(size)
    return Box((*size, depth), edge_radius, (0.0, 0.0, -0.5 * depth))


def sphere(radius: float, *, shaft: bool = False) -> Profile:
    """A sphere about the origin [m], or its upper half on a shaft of the same radius."""
    if not shaft:
        return Profile.circle(radius, turned=True)
    return Profile([[0.0, radius], [radius, radius]], radius, depth=2.0 * radius)


def cylinder(
    radius: float, length: float | None = None, edge_radius: float | None = None
) -> Surface:
    """A cylinder about y, without ends, or of some length with round rims; m."""
    if length is None:
        return Profile.circle(radius, turned=False)
    return _Lying(radius, length, _edge(edge_radius, min(2.0 * radius, length)))


def ring(inner_radius: float, outer_radius: float, edge_radius: float | None = None) -> Profile:
    """A flat ring at z = 0, a disc if the inner radius is 0; m.

    It goes on below without an end. `edge_radius` is that of its rims.
    """
    if not 0.0 <= inner_radius < outer_radius:
        raise InputError(
            f"outer_radius ({format_si(outer_radius, 'm')}) must be larger than inner_radius "
            f"({format_si(inner_radius, 'm')}), which must not be negative"
        )
    width = outer_radius - inner_radius
    # Of a disc the whole radius may be round: half a sphere.
    rim = _edge(edge_radius, width if inner_radius > 0.0 else 2.0 * width)
    depth = 0.1 * outer_radius
    return Profile([[inner_radius, 0.0], [outer_radius, 0.0]], rim, depth=max(rim, depth))


def opening(
    opening_radius: float, fillet: float, outer_radius: float, spine: float = 0.0
) -> Profile:
    """A die: the flat z = 0 with a round hole, a fillet around the hole and the outer rim; m.

    `opening_radius` is that of the hole's wall, where the fillet ends. With a `spine` the hole is
    oblong, longer by that along y.
    """
    if not opening_radius + 2.0 * fillet <= outer_radius:
        raise InputError(
            f"outer_radius ({format_si(outer_radius, 'm')}) must leave room for the opening and "
            f"two fillets ({format_si(opening_radius + 2.0 * fillet, 'm')})"
        )
    path = [[opening_radius, 0.0], [outer_radius, 0.0]]
    return Profile(path, fillet, spine=spine, depth=2.0 * fillet)


class _Lying(Surface):
    """A cylinder with ends about y: a closed profile turned about z, laid down."""

    def __init__(self, radius: float, length: float, edge: float):
        # Two halves, each without an end, meet in the middle: the nearer rim decides.
        self._half = Profile(
            [[0.0, 0.5 * length], [radius, 0.5 * length]], edge, depth=0.5 * length
        )
        self.closest_radius = (edge, math.inf)

    def look(self, points: np.ndarray) -> Look:
        """See Surface.look. Exact everywhere."""
        points = np.asarray(points, float)
        end = np.where(points[:, 1] < 0.0, -1.0, 1.0)
        # (x, y, z) = (x', -+z', +-y'): the upright half is turned so that z' points to this end.
        upright = np.column_stack([points[:, 0], -end * points[:, 2], end * points[:, 1]])
        distance, normal, curvature = self._half.look(upright)
        turn = np.zeros((len(points), 3, 3))
        turn[:, 0, 0], turn[:, 1, 2], turn[:, 2, 1] = 1.0, end, -end
        return (
            distance,
            np.einsum("nij,nj->ni", turn, normal),
            turn @ curvature @ turn.transpose(0, 2, 1),
        )

    @property
    def box(self) -> np.ndarray:
        """See Surface.box."""
        radius, _, half = self._half.box[1]
        return np.array([[-radius, -half, -radius], [radius, half, radius]])

    def facets(self, chord: float | None = None) -> Facets:
        """See Surface.facets."""
        points, triangles = self._half.facets(self._chord(chord))
        here = points[:, [0, 2, 1]] * (1.0, 1.0, -1.0)
        there = here * (-1.0, -1.0, 1.0)
        return np.vstack([here, there]), np.vstack([triangles, triangles + len(points)])
