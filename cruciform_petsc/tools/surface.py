# SPDX-License-Identifier: MIT
"""What contact has to know of a tool's surface, and where a moving one first touches."""

from __future__ import annotations

from abc import ABC, abstractmethod

import numpy as np

Look = tuple[np.ndarray, np.ndarray, np.ndarray]
Facets = tuple[np.ndarray, np.ndarray]

_MOST_STEPS = 2000  # of sphere tracing; points that graze the surface take many
_ROUNDING = 1e-11  # of a tool's size: what counts as touching


class Surface(ABC):
    """A rigid tool's surface, in a frame of the tool's own, metres.

    Attributes
    ----------
    closest_radius : (float, float)
        Smallest radius of curvature where the tool bulges, and where it is hollow: 0 of a sharp
        edge, infinite where there is none.
    cell : float
        How finely the surface is known; 0 of exact shapes.
    reach : float
        Distances up to this are exact, m; farther away they may be rough, and are larger than it.
    remarks : tuple of str
        What its user should know, a sentence each.
    endless : (bool, bool, bool)
        Along which of its axes it goes on beyond its box as it is.
    skin_axis : int
        Of an open skin, with walls of the program's own where it ends, the axis that the cloth lies
        along; else -1.
    """

    closest_radius: tuple[float, float] = (np.inf, np.inf)
    cell: float = 0.0
    reach: float = np.inf
    remarks: tuple[str, ...] = ()
    endless: tuple[bool, bool, bool] = (False, False, False)
    skin_axis: int = -1

    @abstractmethod
    def look(self, points: np.ndarray) -> Look:
        """Signed distance, its gradient and its second derivatives.

        Parameters
        ----------
        points : float (n, 3)

        Returns
        -------
        distance : float (n,), positive where the cloth is
        normal : float (n, 3), towards the cloth, 1
        curvature : float (n, 3, 3), 1/m
        """

    @property
    @abstractmethod
    def box(self) -> np.ndarray:
        """Least and largest coordinates of what `facets` draws, float (2, 3)."""

    @abstractmethod
    def facets(self, chord: float | None = None) -> Facets:
        """Triangles for pictures: points (m, 3) and, counter-clockwise from outside, (k, 3) int32.

        Arcs are off by at most `chord`; the default is a thousandth of the tool's size.
        """

    def _chord(self, chord: float | None) -> float:
        return 1e-3 * float(np.ptp(self.box, axis=0).max()) if chord is None else chord


def touch(
    surface: Surface, points: np.ndarray, axis: np.ndarray, gap: float = 0.0
) -> tuple[float, int] | None:
    """How far points may travel along an axis until the first of them is `gap` from a surface.

    A tool that moves along its travel meets the cloth as the cloth, moving the other way, meets the
    tool. The answer is negative where the points have to go back to come free.

    Parameters
    ----------
    surface : Surface
    points : float (n, 3)
        In the tool's frame, m.
    axis : float (3,)
        Of any length.
    gap : float
        Distance at which they touch, m: half the thickness of the cloth.

    Returns
    -------
    (travel, index of the point), m; None if no point meets the surface.

    Notes
    -----
    Sphere tracing from outside all: no point can be nearer to the surface than its distance, so
    each may step by it. Distances never grow faster than the way; steps end at rounding.
    """
    axis = np.asarray(axis, float) / np.linalg.norm(axis)
    points = np.atleast_2d(np.asarray(points, float))
    low, high = surface.box
    size = float(np.linalg.norm(high - low)) + gap
    # From one side to the other of a ball around the box; those that start in the tool step back.
    ahead = (0.5 * (low + high) - points) @ axis
    way, end = ahead - 0.51 * size, ahead + 0.51 * size
    best, index, left = np.inf, -1, np.arange(len(points))
    for _ in range(_MOST_STEPS):
        distance = surface.look(points[left] + way[left, None] * axis)[0] - gap
        way[left] += distance
        there = left[np.abs(distance) <= _ROUNDING * size]
        if len(there) and way[there].min() < best:
            index = int(there[np.argmin(way[there])])
            best = float(way[index])
        on_the_way = (way[left] < np.minimum(end[left], best)) & (
            way[left] > ahead[left] - 5 * size
        )
        left = left[on_the_way & (np.abs(distance) > _ROUNDING * size)]
        if len(left) == 0:
            break
    return None if index < 0 else (best, index)
