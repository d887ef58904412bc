# SPDX-License-Identifier: MIT
"""A sector of a flat ring, exactly: one segment of a blank holder."""

from __future__ import annotations

import math

import numpy as np

from ..errors import InputError
from ..units import format_si
from .profile import EDGE, join, pieces_of_arc
from .surface import Facets, Look, Surface

_WIDEST = math.pi * (1.0 + 1e-12)


class Sector(Surface):
    """The part of a flat ring, z = 0, between two angles; below it goes on without an end.

    All that is `edge_radius` or more within its sides (the *core*) is rounded by that radius:
    distances are those to the core less the radius.

    Parameters
    ----------
    inner_radius, outer_radius : float, m
    begin, end : float
        Angles from x towards y, rad; half a turn between them at most.
    edge_radius : float, optional
        m; the default is EDGE of the ring's width.

    Raises
    ------
    InputError
        If the edges leave no core, or angles are out of order.
    """

    def __init__(
        self,
        inner_radius: float,
        outer_radius: float,
        begin: float,
        end: float,
        edge_radius: float | None = None,
    ):
        if not 0.0 < inner_radius < outer_radius:
            raise InputError(
                f"outer_radius ({format_si(outer_radius, 'm')}) must be larger than inner_radius "
                f"({format_si(inner_radius, 'm')}), which a sector needs"
            )
        if not 0.0 < end - begin <= _WIDEST:
            raise InputError(
                "a sector goes from an angle to a larger one, by half a turn at most, got "
                f"{format_si(begin, 'rad')} to {format_si(end, 'rad')}"
            )
        width = outer_radius - inner_radius
        self.edge = EDGE * width if edge_radius is None else float(edge_radius)
        self.inner, self.outer = inner_radius + self.edge, outer_radius - self.edge
        half, middle = 0.5 * (end - begin), 0.5 * (begin + end)
        if not (self.edge > 0.0 and self.inner < self.outer) or (
            self.edge > self.inner * math.sin(half)
        ):
            raise InputError(
                f"edge_radius ({format_si(self.edge, 'm')}) must be positive and leave a flat "
                "between the sides of the sector"
            )
        # Of the sides, turned so that the sector's middle lies along x: that with y > 0.
        self._along = np.array([math.cos(half), math.sin(half)])
        self._normal = np.array([math.sin(half), -math.cos(half)])  # into the sector
        self._turn = np.array(
            [[math.cos(middle), -math.sin(middle)], [math.sin(middle), math.cos(middle)]]
        )
        self._corners = [
            self.edge * self._normal + math.sqrt(r**2 - self.edge**2) * self._along
            for r in (self.inner, self.outer)
        ]
        self.closest_radius = (self.edge, math.inf)

    def _in_plan(self, p: np.ndarray) -> Look:
        """Distance to the core's outline (negative inside) of points (n, 2), and derivatives."""
        n = len(p)
        mirror = np.where(p[:, 1] < 0.0, -1.0, 1.0)
        p = p * np.column_stack([np.ones(n), mirror])
        r = np.linalg.norm(p, axis=1)
        radial = p / np.maximum(r, 1e-300)[:, None]
        bent = (np.eye(2) - radial[:, :, None] * radial[:, None]) / np.maximum(r, 1e-300)[
            :, None, None
        ]
        within = p @ self._normal - self.edge  # of the side
        # By piece of the outline: distance from within or without, gradient, curvature, whether
        # the nearest point of the piece is one of the outline.
        on_arc = np.clip(r, self.inner, self.outer)
        foot = p - within[:, None] * self._normal
        reach = np.linalg.norm(foot, axis=1)
        pieces = [
            (r - self.outer, radial, bent, radial * on_arc[:, None] @ self._normal >= self.edge),
            (self.inner - r, -radial, -bent, radial * on_arc[:, None] @ self._normal >= self.edge),
            (
                -within,
                np.tile(-self._normal, (n, 1)),
                np.zeros((n, 2, 2)),
                (reach >= self.inner) & (reach <= self.outer),
            ),
        ]
        inside = (within >= 0.0) & (r >= self.inner) & (r <= self.outer)
        distance = np.max([d for d, *_ in pieces], axis=0)
        which = np.argmax([d for d, *_ in pieces], axis=0)
        far = np.where(inside, distance, np.inf)
        gradient, curvature = np.zeros((n, 2)), np.zeros((n, 2, 2))
        for k, (d, g, h, there) in enumerate(pieces):
            take = np.where(inside, which == k, there & (d > 0.0) & (d < far))
            far = np.where(take, d, far)
            gradient[take], curvature[take] = g[take], h[take]
        for corner in self._corners:
            gap = p - corner
            d = np.linalg.norm(gap, axis=1)
            take = ~inside & (d < far)
            far = np.where(take, d, far)
            d = np.maximum(d[take], 1e-300)
            g = gap[take] / d[:, None]
            gradient[take] = g
            curvature[take] = (np.eye(2) - g[:, :, None] * g[:, None]) / d[:, None, None]
        gradient[:, 1] *= mirror
        curvature[:, 0, 1] *= mirror
        curvature[:, 1, 0] *= mirror
        return np.where(np.isnan(r), np.nan, far), gradient, curvature

    def look(self, points: np.ndarray) -> Look:
        """See Surface.look. Exact outside and within the edges' radius of the surface."""
        points = np.asarray(points, float)
        a, g, h = self._in_plan(points[:, :2] @ self._turn)
        b = points[:, 2] + self.edge
        p, q = np.maximum(a, 0.0), np.maximum(b, 0.0)
        size = np.hypot(p, q)
        deep = size <= 0.0
        p = np.where(deep, (a >= b) * 1.0, p)
        q = np.where(deep, (a < b) * 1.0, q)
        s = np.where(deep, 1.0, size)
        slope_a, slope_b = p / s, q / s
        normal = np.column_stack([slope_a[:, None] * (g @ self._turn.T), slope_b])
        curvature = np.zeros((len(points), 3, 3))
        curvature[:, :2, :2] = slope_a[:, None, None] * (self._turn @ h @ self._turn.T)
        # On the rim both change: the direction from the core's edge turns.
        rim = (a > 0.0) & (b > 0.0)
        across = np.column_stack([slope_b[:, None] * (g @ self._turn.T), -slope_a])[rim]
        curvature[rim] += across[:, :, None] * across[:, None] / s[rim, None, None]
        distance = np.where(deep, np.maximum(a, b), size) - self.edge
        return np.where(np.isnan(points).any(axis=1), np.nan, distance), normal, curvature

    @property
    def box(self) -> np.ndarray:
        """See Surface.box."""
        chain, out = self._outline(1e-4 * self.outer)
        edge = chain + self.edge * out
        low, high = edge.min(axis=0), edge.max(axis=0)
        return np.array([[*low, -self._depth], [*high, 0.0]])

    @property
    def _depth(self) -> float:
        return max(2.0 * self.edge, 0.1 * self.outer)

    def _outline(self, chord: float) -> tuple[np.ndarray, np.ndarray]:
        """Points of the core's outline, counter-clockwise, and normals outwards, two (m, 2)."""
        ends = [math.atan2(*corner[::-1]) for corner in self._corners]
        quarter = pieces_of_arc(self.edge, 0.5 * math.pi, chord) + 1
        count = pieces_of_arc(self.outer, 2.0 * ends[1], chord) + 1
        base, out = [], []
        for angle in np.linspace(-ends[1], ends[1], count):
            out.append([math.cos(angle), math.sin(angle)])
            base.append(self.outer * np.array(out[-1]))
        side = math.atan2(*-self._normal[::-1])
        for corner, first, last in (
            (self._corners[1], ends[1], side),
            (self._corners[0], side, ends[0] + math.pi),
        ):
            for angle in np.linspace(first, last, quarter):
                out.append([math.cos(angle), math.sin(angle)])
                base.append(corner)
        for angle in np.linspace(ends[0], -ends[0], count)[1:-1]:
            out.append([-math.cos(angle), -math.sin(angle)])
            base.append(self.inner * -np.array(out[-1]))
        lower = list(range(count, count + 2 * quarter))[::-1]
        base += [base[k] * np.array([1.0, -1.0]) for k in lower]
        out += [[out[k][0], -out[k][1]] for k in lower]
        return np.array(base) @ self._turn.T, np.array(out) @ self._turn.T

    def facets(self, chord: float | None = None) -> Facets:
        """See Surface.facets."""
        chord = self._chord(chord)
        base, out = self._outline(chord)
        quarter = pieces_of_arc(self.edge, 0.5 * math.pi, chord)
        rows = [
            (self.edge * math.sin(t), self.edge * (math.cos(t) - 1.0))
            for t in np.linspace(0.0, 0.5 * math.pi, quarter + 1)
        ]
        rows.append((self.edge, -self._depth))
        net = np.stack([np.column_stack([base + r * out, np.full(len(base), z)]) for r, z in rows])
        points, triangles = join(net, around=True)
        # The top, from its inner to its outer arc.
        ends = [math.atan2(*corner[::-1]) for corner in self._corners]
        count = pieces_of_arc(self.outer, 2.0 * ends[1], chord) + 1
        arcs = []
        for r, end in zip((self.inner, self.outer), ends, strict=True):
            angle = np.linspace(-end, end, count)
            flat = r * np.column_stack([np.cos(angle), np.sin(angle)]) @ self._turn.T
            arcs.append(np.column_stack([flat, np.zeros(count)]))
        more, lid = join(np.stack(arcs), around=False)
        return np.vstack([points, more]), np.vstack([triangles, lid + len(points)]).astype(np.int32)
