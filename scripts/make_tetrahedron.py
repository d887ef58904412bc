#!/usr/bin/env python3
# SPDX-License-Identifier: MIT
"""Make demos/tools/tetrahedron.stl: a punch of 60 mm whose edges and corners have a radius of 6 mm.

    python3 scripts/make_tetrahedron.py [FILE]

It is the convex hull of four balls, in mm, its tip up at z = 0.
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
from scipy.spatial import ConvexHull

RADIUS, HEIGHT, BASE = 6.0, 60.0, 70.0  # of edges; from base to tip; from the axis to a corner; mm
AROUND = 24  # points of a ball's equator


def corners() -> np.ndarray:
    """Centres of the balls at the four corners, (4, 3), mm; the tip is the first."""
    turn = np.deg2rad([90.0, 210.0, 330.0])
    reach, depth = BASE - RADIUS, HEIGHT - RADIUS
    base = np.column_stack([reach * np.cos(turn), reach * np.sin(turn), np.full(3, -depth)])
    return np.vstack([[0.0, 0.0, -RADIUS], base])


def hull_of_balls(centres: np.ndarray, radius: float) -> tuple[np.ndarray, np.ndarray]:
    """Points (n, 3) and triangles (m, 3), counter-clockwise from outside."""
    up = np.linspace(-0.5 * np.pi, 0.5 * np.pi, AROUND // 2 + 1)[:, None]
    around = 2.0 * np.pi * np.arange(AROUND) / AROUND
    ball = [np.cos(up) * np.cos(around), np.cos(up) * np.sin(around), np.sin(up) + 0.0 * around]
    points = (centres[:, None] + radius * np.stack(ball, axis=-1).reshape(-1, 3)).reshape(-1, 3)
    hull = ConvexHull(np.unique(points.round(9), axis=0))
    triangles = hull.simplices.copy()
    a, b, c = (hull.points[triangles[:, k]] for k in range(3))
    inwards = (np.cross(b - a, c - a) * hull.equations[:, :3]).sum(axis=1) < 0.0
    triangles[inwards] = triangles[inwards, ::-1]
    return hull.points, triangles


def write(path: Path) -> None:
    """Write a binary STL."""
    points, triangles = hull_of_balls(corners(), RADIUS)
    facets = np.zeros(len(triangles), [("f", "<f4", (4, 3)), ("more", "<u2")])
    facets["f"][:, 1:] = points[triangles]
    head = b"tetrahedron, edges of 6 mm".ljust(80) + np.uint32(len(facets)).tobytes()
    path.write_bytes(head + facets.tobytes())


if __name__ == "__main__":
    here = Path(__file__).resolve().parents[1] / "demos" / "tools" / "tetrahedron.stl"
    write(Path(sys.argv[1]) if len(sys.argv) > 1 else here)
