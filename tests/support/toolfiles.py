# SPDX-License-Identifier: MIT
"""Tools for tests: bodies of facets, files of them."""

import struct

import numpy as np

STL = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")])


def torus(major, minor, around, across):
    """Points and facets of a torus about z, counter-clockwise from outside."""
    u = np.linspace(0.0, 2.0 * np.pi, around, endpoint=False)[:, None]
    v = np.linspace(0.0, 2.0 * np.pi, across, endpoint=False)
    r = major + minor * np.cos(v)
    points = np.stack(np.broadcast_arrays(r * np.cos(u), r * np.sin(u), minor * np.sin(v)), -1)
    i, j = (k.ravel() for k in np.mgrid[:around, :across])
    a, b = i * across + j, (i + 1) % around * across + j
    c, d = (i + 1) % around * across + (j + 1) % across, i * across + (j + 1) % across
    return points.reshape(-1, 3), np.concatenate([np.stack([a, b, c], 1), np.stack([a, c, d], 1)])


def torus_distance(points, major, minor):
    return np.hypot(np.hypot(points[:, 0], points[:, 1]) - major, points[:, 2]) - minor


def write_stl(path, points, facets, text=False):
    corners = np.asarray(points)[facets]
    if not text:
        rows = np.zeros(len(corners), STL)
        rows["corners"] = corners
        path.write_bytes(bytes(80) + struct.pack("<I", len(rows)) + rows.tobytes())
        return
    lines = ["solid tool"]
    for triangle in corners.tolist():
        lines += ["facet normal 0 0 0", "outer loop"]
        lines += [f"vertex {x!r} {y!r} {z!r}" for x, y, z in triangle]
        lines += ["endloop", "endfacet"]
    path.write_text("\n".join([*lines, "endsolid tool", ""]))


def write_obj(path, points, facets):
    lines = [f"v {x!r} {y!r} {z!r}" for x, y, z in np.asarray(points).tolist()]
    lines += ["f {} {} {}".format(*row) for row in (np.asarray(facets) + 1).tolist()]
    path.write_text("\n".join(lines) + "\n")


def write_ply(path, points, facets, text=True):
    points, facets = np.asarray(points, "<f4"), np.asarray(facets, "<i4")
    kind = "ascii" if text else "binary_little_endian"
    head = f"ply\nformat {kind} 1.0\nelement vertex {len(points)}\n"
    head += "".join(f"property float {axis}\n" for axis in "xyz")
    head += f"element face {len(facets)}\nproperty list uchar int vertex_indices\nend_header\n"
    if text:
        rows = [f"{x!r} {y!r} {z!r}" for x, y, z in points.tolist()]
        rows += ["3 {} {} {}".format(*row) for row in facets.tolist()]
        path.write_text(head + "\n".join(rows) + "\n")
        return
    rows = np.zeros(len(facets), np.dtype([("n", "u1"), ("corners", "<i4", 3)]))
    rows["n"], rows["corners"] = 3, facets
    path.write_bytes(head.encode() + points.tobytes() + rows.tobytes())
