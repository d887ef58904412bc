# SPDX-License-Identifier: MIT
"""Closed lines of usual shapes, with corners on the curves; x from -w/2 to w/2, y from 0 to l."""

from __future__ import annotations

import math

import numpy as np

CORNERS = 240  # of a whole turn: an area is 0.01 % less than its circle's


def ellipse(width: float, length: float) -> np.ndarray:
    """Corners from the largest x on, counter-clockwise, float (n, 2)."""
    angle = 2.0 * np.pi * np.arange(CORNERS) / CORNERS
    x, y = 0.5 * width * np.cos(angle), 0.5 * length * np.sin(angle)
    return np.stack([x, y + 0.5 * length], axis=1)


def rounded(width: float, length: float, radius: float) -> tuple[np.ndarray, list[np.ndarray]]:
    """A rectangle whose corners are arcs of a radius; and these arcs.

    Corners, float (n, 2), and segments of each arc (m, 2, 2), from the one at the largest x and y
    on, counter-clockwise. A radius of half the width or the length makes a slot.
    """
    quarter = CORNERS // 4
    arcs = []
    for turn, (x, y) in enumerate([(1, 1), (-1, 1), (-1, -1), (1, -1)]):
        angle = 0.5 * np.pi * (turn + np.arange(quarter + 1) / quarter)
        middle = [x * (0.5 * width - radius), 0.5 * length + y * (0.5 * length - radius)]
        arcs.append(middle + radius * np.stack([np.cos(angle), np.sin(angle)], axis=1))
    ring = np.concatenate(arcs)
    repeated = np.linalg.norm(ring - np.roll(ring, 1, axis=0), axis=1) < 1e-12 * math.hypot(
        width, length
    )
    return ring[~repeated], [np.stack([arc[:-1], arc[1:]], axis=1) for arc in arcs]
