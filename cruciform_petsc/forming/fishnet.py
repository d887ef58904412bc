# SPDX-License-Identifier: MIT
"""A pin-jointed net laid on a surface (the fishnet of Van West, Pipes and Keefe 1990).

Links keep their lengths and pivot where yarns cross; every joint lies at one distance from the
surface. Two yarns, the generators, are laid first. Then each joint x follows from the joints before
it along both yarns,

    |x - a| = p,    |x - b| = q,    d(x) = g

The two spheres meet in a circle about the line from a to b, so one unknown is left, the angle on
that circle: Newton's method on it, kept between bounds, where the three equations lose their rank
as the net locks. p, q and |b - a| are the sides of the cell's triangle: its shear angle s follows
before anything is solved,

    sin s = (p^2 + q^2 - |b - a|^2)/(2 p q)

and the net locks where it goes beyond a limit. All joints of an anti-diagonal, of all four
quadrants, are laid at once. Everything is in the frame of the surface; nothing knows of ranks.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from ..tools.surface import Surface

MOST_STEPS = 60  # of a root: Newton takes four, halving the bounds takes the rest
ROUNDING = 1e-12  # of a link: how exactly a joint lies at its distance
LOCKED = math.radians(89.0)  # beyond, rounding decides where a joint goes
WAITS, LAID, LOCKS, OFF = 0, 1, 2, 3  # a joint: not yet, is, cannot for shear, finds no surface


def on_circles(
    surface: Surface, gap: float, centre: np.ndarray, ahead: np.ndarray, up: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Points of circles at a distance from a surface, the first before or behind ``ahead``.

    Parameters
    ----------
    surface : Surface
    gap : float, m
    centre, ahead, up : float (n, 3), m
        Points are centre + cos(t) ahead + sin(t) up, t between -90 and 90 degrees; ``up`` points
        away from the surface.

    Returns
    -------
    points : float (n, 3)
    found : bool (n,)
    """
    n = len(centre)
    t, low, high = np.zeros(n), np.full(n, -0.5 * np.pi), np.full(n, 0.5 * np.pi)
    points, found, left = centre + ahead, np.zeros(n, bool), np.arange(n)
    small = ROUNDING * np.sqrt((ahead**2).sum(axis=1))
    for _ in range(MOST_STEPS):
        if not len(left):
            break
        c, s = np.cos(t[left])[:, None], np.sin(t[left])[:, None]
        points[left] = centre[left] + c * ahead[left] + s * up[left]
        distance, normal, _ = surface.look(points[left])
        off = distance - gap
        slope = ((c * up[left] - s * ahead[left]) * normal).sum(axis=1)
        low[left] = np.where(off < 0.0, t[left], low[left])
        high[left] = np.where(off > 0.0, t[left], high[left])
        with np.errstate(divide="ignore", invalid="ignore"):
            step = t[left] - off / slope
        inside = (step > low[left]) & (step < high[left])
        t[left] = np.where(inside, step, 0.5 * (low[left] + high[left]))
        good = abs(off) <= small[left]
        found[left[good]] = True
        left = left[~good & (high[left] - low[left] > 1e-15)]
    return points, found


def unit(vectors: np.ndarray) -> np.ndarray:
    """Vectors (..., 3) of length 1."""
    return vectors / np.linalg.norm(vectors, axis=-1, keepdims=True)


def march(
    surface: Surface,
    gap: float,
    start: np.ndarray,
    along: np.ndarray,
    link: np.ndarray,
    counts: Sequence[int],
    upright: np.ndarray | None = None,
) -> list[np.ndarray]:
    """Joints along lines from a point, straight on the surface, or in planes.

    A straight line is a geodesic: the next link lies in the plane of the last one and the normal
    where they meet. Second order in the links.

    Parameters
    ----------
    start : float (3,) or (m, 3)
        Of all lines, or of each, m.
    along : float (m, 3)
        Directions at the start; what points off the surface does not count.
    link : float (m,), m
    counts : m numbers of joints
    upright : float (3,), optional
        Lines lie in the planes of this direction and their own.

    Returns
    -------
    list of float (n, 3), m, the start first; shorter than asked where the surface ends
    """
    m = len(along)
    lines = [[point] for point in np.broadcast_to(start, (m, 3))]
    direction = unit(np.asarray(along, float))
    across = None if upright is None else unit(np.cross(direction, upright))
    left = np.flatnonzero(np.asarray(counts) > 0)
    while len(left):
        here = np.array([lines[k][-1] for k in left])
        normal = unit(surface.look(here)[1])
        if across is not None:
            normal = unit(normal - (normal * across[left]).sum(axis=1)[:, None] * across[left])
        ahead = direction[left] - (direction[left] * normal).sum(axis=1)[:, None] * normal
        ahead = unit(ahead)
        points, found = on_circles(
            surface, gap, here, link[left, None] * ahead, link[left, None] * normal
        )
        for k, point, good in zip(left, points, found, strict=True):
            if good:
                direction[k] = (point - lines[k][-1]) / link[k]
                lines[k].append(point)
        left = left[found & (np.array([len(lines[k]) <= counts[k] for k in left]))]
    return [np.array(line) for line in lines]


def walk(points: np.ndarray, link: float, count: int) -> np.ndarray:
    """Joints on a line of points (m, 3), from the first one on, a link's length apart each.

    Returns
    -------
    float (n, 3), the first point and at most ``count`` more
    """
    joints, piece, at = [points[0]], 0, 0.0
    along = np.diff(points, axis=0)
    while len(joints) <= count:
        while piece < len(along):
            # |points + t along - joint| = link
            away = points[piece] - joints[-1]
            a, b = along[piece] @ along[piece], away @ along[piece]
            c = away @ away - link**2
            root = b * b - a * c
            t = (-b + math.sqrt(root)) / a if root >= 0.0 and a > 0.0 else math.inf
            if at <= t <= 1.0:
                joints.append(points[piece] + t * along[piece])
                at = t
                break
            piece, at = piece + 1, 0.0
        else:
            break
    return np.array(joints)


class Fishnet:
    """Joints of a block of the lattice, counted from the seed; axis 0 along the warp.

    Parameters
    ----------
    surface : Surface
    gap : float
        Of all joints from the surface, m.
    link : (float, float)
        Lengths along the warp and along the weft, m.
    first, shape : int (2,)
        The block's first joint, and how many there are.
    below : bool
        Whether the surface lies below the cloth: warp x weft points away from it.
    locking : float
        Largest shear angle, rad.

    Attributes
    ----------
    x : float (n0, n1, 3), m, NaN where nothing is laid
    status : int8 (n0, n1)
        WAITS, LAID, LOCKS or OFF.
    """

    def __init__(self, surface, gap, link, first, shape, below=True, locking=LOCKED):
        self.surface, self.gap, self.link = surface, float(gap), np.asarray(link, float)
        self.first, self.shape = np.asarray(first), tuple(int(n) for n in shape)
        self.up = 1.0 if below else -1.0
        self.most = math.sin(min(locking, LOCKED))
        self.x = np.full((*self.shape, 3), np.nan)
        self.status = np.zeros(self.shape, np.int8)
        self._groups: list[np.ndarray] | None = None

    def at(self, joints: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Where joints (n, 2) of the block stand in its arrays."""
        i, j = (np.asarray(joints) - self.first).T
        return i, j

    def place(self, axis: int, sign: int, line: np.ndarray, needed: int) -> None:
        """Lay a generator, float (n, 3), from the seed along an axis: of it what the block has.

        Joints that are laid already stay. Where it is shorter than is ``needed``, it has come off
        the surface.
        """
        count = np.arange(max(len(line), needed + 1))
        joints = np.zeros((len(count), 2), np.int64)
        joints[:, axis] = sign * count
        here = ((joints >= self.first) & (joints < self.first + self.shape)).all(axis=1)
        rows = np.flatnonzero(here)
        rows = rows[self.status[self.at(joints[rows])] == WAITS]
        ends, rows = rows[rows == len(line)], rows[rows < len(line)]
        at = self.at(joints[rows])
        self.x[at], self.status[at] = line[rows], LAID
        self.status[self.at(joints[ends])] = OFF

    def sweep(self, wanted: np.ndarray) -> int:
        """Lay what is wanted, bool (n0, n1), as far as joints before it are laid; how many were.

        What joints before it wait for, may be put into ``x`` and ``status`` between sweeps; what is
        wanted stays the same.
        """
        if self._groups is None:
            self._groups = self._wavefronts(wanted)
        x, status = self.x.reshape(-1, 3), self.status.reshape(-1)
        stride, done = self.shape[1], 0
        left = []
        for group in self._groups:
            index, signs = group[:, 0], group[:, 1:]
            before = index - signs[:, 0] * stride
            beside = index - signs[:, 1]
            ready = (status[before] == LAID) & (status[beside] == LAID)
            ready &= status[before - signs[:, 1]] == LAID
            if ready.any():
                at = index[ready]
                done += self._lay(
                    x, status, at, before[ready], beside[ready],
                    (before - signs[:, 1])[ready], signs[ready].prod(axis=1),
                )  # fmt: skip
            if not ready.all():
                left.append(group[~ready])
        self._groups = left
        return done

    def _wavefronts(self, wanted: np.ndarray) -> list[np.ndarray]:
        """Joints to lay by their distance from the seed: rows of flat index and signs of i, j."""
        i, j = np.nonzero(wanted & (self.status == WAITS))
        signs = np.sign(np.column_stack([i, j]) + self.first)
        i, j, signs = (part[(signs != 0).all(axis=1)] for part in (i, j, signs))
        away = np.abs(np.column_stack([i, j]) + self.first).sum(axis=1)
        order = np.argsort(away, kind="stable")
        rows = np.column_stack([i * self.shape[1] + j, signs])[order]
        return np.split(rows, np.flatnonzero(np.diff(away[order])) + 1) if len(rows) else []

    def _lay(self, x, status, at, before, beside, corner, side) -> int:
        """One wavefront; indices (n,) into x (m, 3) and status (m,)."""
        (p, q), a, b = self.link, x[before], x[beside]
        chord = b - a
        square = (chord**2).sum(axis=1)
        locks = abs(p**2 + q**2 - square) > 2.0 * p * q * self.most
        status[at[locks]] = LOCKS
        at, a, b, chord, square = (part[~locks] for part in (at, a, b, chord, square))
        corner, side = corner[~locks], side[~locks]
        if not len(at):
            return 0
        # The circle's centre is where the height of the triangle meets the chord.
        share = 0.5 * (1.0 + (p**2 - q**2) / square)
        centre = a + share[:, None] * chord
        radius = np.sqrt(np.maximum(p**2 - share**2 * square, 0.0))[:, None]
        ahead = centre - x[corner]
        ahead -= ((ahead * chord).sum(axis=1) / square)[:, None] * chord
        ahead = radius * unit(ahead)
        up = (self.up * side / np.sqrt(square))[:, None] * np.cross(chord, ahead)
        points, found = on_circles(self.surface, self.gap, centre, ahead, up)
        x[at[found]], status[at[found]], status[at[~found]] = points[found], LAID, OFF
        return int(found.sum())

    def shear(self) -> np.ndarray:
        """Shear angles of the cells, float (n0 - 1, n1 - 1), rad; NaN where a corner is missing.

        Positive where warp and weft have come closer.
        """
        x, (p, q) = self.x, self.link
        square = ((x[1:, :-1] - x[:-1, 1:]) ** 2).sum(axis=2)
        sine = (p**2 + q**2 - square) / (2.0 * p * q)
        sine = np.where(np.isnan(x[1:, 1:, 0] + x[:-1, :-1, 0]), np.nan, sine)
        return np.arcsin(np.clip(sine, -1.0, 1.0))
