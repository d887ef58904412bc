# SPDX-License-Identifier: MIT
"""Signed distances of grid points to triangles, and a grid of them read as a cubic B-spline.

The sign is that of the normal at the closest point; on an edge that is the sum of its two facets'
normals, at a corner that of all facets weighted by their angles (Baerentzen and Aanaes, IEEE
Transactions on Visualization and Computer Graphics 11, 2005). Facets stand for a smooth surface:
between them and it distances are corrected, or forces of contact would show every facet.
"""

from __future__ import annotations

import numba
import numpy as np
from scipy import ndimage

from .facets import SHARP, Body, normals, pairs, vectors

BAND = 4  # cells
MOST_BULGE = 0.35  # of the angle of two facets times the smaller one's width


@numba.njit(cache=True, error_model="numpy")
def _closest(p, a, b, c, point, share):
    """Write the closest point of a triangle and its shares of b and c.

    It lies in: 0 to 2, a corner; 3 to 5, the edge after that; 6, inside.

    The regions of C. Ericson, Real-Time Collision Detection, 2005, section 5.1.5.
    """
    ab0, ab1, ab2 = b[0] - a[0], b[1] - a[1], b[2] - a[2]
    ac0, ac1, ac2 = c[0] - a[0], c[1] - a[1], c[2] - a[2]
    ap0, ap1, ap2 = p[0] - a[0], p[1] - a[1], p[2] - a[2]
    d1 = ab0 * ap0 + ab1 * ap1 + ab2 * ap2
    d2 = ac0 * ap0 + ac1 * ap1 + ac2 * ap2
    v, w, where = 0.0, 0.0, 6
    bp0, bp1, bp2 = p[0] - b[0], p[1] - b[1], p[2] - b[2]
    d3 = ab0 * bp0 + ab1 * bp1 + ab2 * bp2
    d4 = ac0 * bp0 + ac1 * bp1 + ac2 * bp2
    cp0, cp1, cp2 = p[0] - c[0], p[1] - c[1], p[2] - c[2]
    d5 = ab0 * cp0 + ab1 * cp1 + ab2 * cp2
    d6 = ac0 * cp0 + ac1 * cp1 + ac2 * cp2
    vc, vb, va = d1 * d4 - d3 * d2, d5 * d2 - d1 * d6, d3 * d6 - d5 * d4
    if d1 <= 0.0 and d2 <= 0.0:
        where = 0
    elif d3 >= 0.0 and d4 <= d3:
        v, where = 1.0, 1
    elif d6 >= 0.0 and d5 <= d6:
        w, where = 1.0, 2
    elif vc <= 0.0 and d1 >= 0.0 and d3 <= 0.0:
        v, where = d1 / (d1 - d3), 3
    elif va <= 0.0 and d4 - d3 >= 0.0 and d5 - d6 >= 0.0:
        w = (d4 - d3) / ((d4 - d3) + (d5 - d6))
        v, where = 1.0 - w, 4
    elif vb <= 0.0 and d2 >= 0.0 and d6 <= 0.0:
        w, where = d2 / (d2 - d6), 5
    else:
        total = va + vb + vc
        v, w = vb / total, vc / total
    share[0], share[1] = v, w
    point[0] = a[0] + v * ab0 + w * ac0
    point[1] = a[1] + v * ab1 + w * ac1
    point[2] = a[2] + v * ab2 + w * ac2
    return where


@numba.njit(cache=True, error_model="numpy")
def _nearest(points, triangles, normal, origin, cell, band, distance, facet):
    """Closest facet of each grid point within a band, and its distance."""
    p, q, low, high = np.empty(3), np.empty(3), np.empty(3, np.int64), np.empty(3, np.int64)
    centre, share = np.empty(3), np.empty(2)
    for k in range(triangles.shape[0]):
        if normal[k, 0] == 0.0 and normal[k, 1] == 0.0 and normal[k, 2] == 0.0:
            continue  # nothing but its edges, which are those of others
        a, b, c = points[triangles[k, 0]], points[triangles[k, 1]], points[triangles[k, 2]]
        for i in range(3):
            least, most = min(a[i], b[i], c[i]), max(a[i], b[i], c[i])
            low[i] = max(0, int(np.ceil((least - band - origin[i]) / cell)))
            high[i] = min(distance.shape[i] - 1, int(np.floor((most + band - origin[i]) / cell)))
            centre[i] = 0.5 * (least + most)
        around = 0.0  # square of the radius of a ball around the facet
        for corner in (a, b, c):
            size = 0.0
            for i in range(3):
                size += (corner[i] - centre[i]) ** 2
            around = max(around, size)
        around = np.sqrt(around)
        for i in range(low[0], high[0] + 1):
            p[0] = origin[0] + i * cell
            for j in range(low[1], high[1] + 1):
                p[1] = origin[1] + j * cell
                for m in range(low[2], high[2] + 1):
                    p[2] = origin[2] + m * cell
                    away = 0.0
                    for r in range(3):
                        away += (p[r] - centre[r]) ** 2
                    if away >= (around + min(distance[i, j, m], band)) ** 2:
                        continue
                    _closest(p, a, b, c, q, share)
                    away = 0.0
                    for r in range(3):
                        away += (p[r] - q[r]) ** 2
                    away = np.sqrt(away)
                    if away < distance[i, j, m] and away <= band:
                        distance[i, j, m], facet[i, j, m] = away, k


@numba.njit(cache=True, error_model="numpy")
def _spread(points, triangles, origin, cell, exact, limit, distance, facet):
    """Try the facets of each grid point's neighbours, in eight sweeps; `exact` ones stay."""
    p, q, share = np.empty(3), np.empty(3), np.empty(2)
    n0, n1, n2 = distance.shape
    for sweep in range(8):
        s0, s1, s2 = 1 - 2 * (sweep & 1), 1 - (sweep & 2), 1 - (sweep & 4) // 2
        for i in range(n0) if s0 > 0 else range(n0 - 1, -1, -1):
            p[0] = origin[0] + i * cell
            for j in range(n1) if s1 > 0 else range(n1 - 1, -1, -1):
                p[1] = origin[1] + j * cell
                for m in range(n2) if s2 > 0 else range(n2 - 1, -1, -1):
                    if distance[i, j, m] <= exact or (sweep and distance[i, j, m] > limit):
                        continue
                    p[2] = origin[2] + m * cell
                    for neighbour in range(0 if sweep == 0 else 1, 8):  # 0: itself
                        x = i - s0 * (neighbour & 1)
                        y = j - s1 * ((neighbour & 2) // 2)
                        z = m - s2 * ((neighbour & 4) // 4)
                        if not (0 <= x < n0 and 0 <= y < n1 and 0 <= z < n2):
                            continue
                        k = facet[x, y, z]
                        if neighbour and k == facet[i, j, m]:
                            continue
                        corners = triangles[k]
                        a, b, c = points[corners[0]], points[corners[1]], points[corners[2]]
                        _closest(p, a, b, c, q, share)
                        away = np.sqrt((p[0] - q[0]) ** 2 + (p[1] - q[1]) ** 2 + (p[2] - q[2]) ** 2)
                        if away < distance[i, j, m]:
                            distance[i, j, m], facet[i, j, m] = away, k


@numba.njit(cache=True, error_model="numpy")
def _signed(points, triangles, normal, at_edge, at_corner, bulge, origin, cell, facet, distance):
    """Signed distance of each grid point to a facet of its own."""
    p, q, n, share = np.empty(3), np.empty(3), np.empty(3), np.empty(2)
    for i in range(distance.shape[0]):
        p[0] = origin[0] + i * cell
        for j in range(distance.shape[1]):
            p[1] = origin[1] + j * cell
            for m in range(distance.shape[2]):
                p[2] = origin[2] + m * cell
                k = facet[i, j, m]
                corners = triangles[k]
                a, b, c = points[corners[0]], points[corners[1]], points[corners[2]]
                where = _closest(p, a, b, c, q, share)
                if where < 3:
                    n[:] = at_corner[corners[where]]
                elif where < 6:
                    n[:] = at_edge[k, where - 3]
                else:
                    n[:] = normal[k]
                away, side = 0.0, 0.0
                for r in range(3):
                    away += (p[r] - q[r]) ** 2
                    side += n[r] * (p[r] - q[r])
                v, w = share[0], share[1]
                u = 1.0 - v - w
                distance[i, j, m] = np.sqrt(away) if side >= 0.0 else -np.sqrt(away)
                distance[i, j, m] -= u * v * bulge[k, 0] + v * w * bulge[k, 1] + w * u * bulge[k, 2]


@numba.njit(cache=True, error_model="numpy")
def _smooth_normals(triangles, first, around, area, normal, least, result):
    """Normal of each facet's corners: that of all facets there that are no sharp edge away."""
    n = np.empty(3)
    for k in range(triangles.shape[0]):
        for i in range(3):
            n[:] = 0.0
            for g in around[first[triangles[k, i]] : first[triangles[k, i] + 1]]:
                cosine = 0.0
                for r in range(3):
                    cosine += normal[k, r] * normal[g, r]
                if cosine > least:
                    for r in range(3):
                        n[r] += area[g, r]
            size = np.sqrt(n[0] ** 2 + n[1] ** 2 + n[2] ** 2)
            for r in range(3):
                result[k, i, r] = n[r] / size if size > 0.0 else 0.0


def _bulge(points, triangles, area, normal) -> np.ndarray:
    """How facets have to bulge to be smooth, float (k, 3) m: four times the height over each edge.

    With n_i the normals at its corners p_i and l_i a point's shares of them, a facet is raised by
    sum l_i l_j c_ij, c_ij = (p_j - p_i).(n_j - n_i)/2: the quadratic part of A. Vlachos et al.,
    Curved PN triangles, 2001. Where facets meet at more than 40 degrees, the edge stays sharp.

    Long thin facets, as along a fillet, would bulge far by a small difference between the normals
    at their ends. On a sphere of equal facets the height over an edge is a quarter of the width
    across it times the angle between the two there: no facet bulges by much more than its edges,
    with the smaller width of the two, tell.
    """
    order = np.argsort(triangles.ravel(), kind="stable")
    first = np.searchsorted(triangles.ravel()[order], np.arange(len(points) + 1))
    at = np.empty((len(triangles), 3, 3))
    size = np.linalg.norm(area, axis=1)
    area = area * size[:, None]
    _smooth_normals(triangles, first, order // 3, area, normal, np.cos(SHARP), at)
    corners = points[triangles]
    along = corners[:, [1, 2, 0]] - corners
    bulge = 0.5 * (along * (at[:, [1, 2, 0]] - at)).sum(axis=2)
    one, other = pairs(triangles).T  # directed edges, 3 facet + edge
    turn = np.linalg.norm(normal[one // 3] - normal[other // 3], axis=1)
    turn[turn > 2.0 * np.sin(0.5 * SHARP)] = 0.0
    width = (size[:, None] / np.linalg.norm(along, axis=2)).ravel()
    most = np.zeros(len(triangles))
    sag = np.tile(turn * np.minimum(width[one], width[other]), 2)
    np.maximum.at(most, np.concatenate([one, other]) // 3, sag)
    height = MOST_BULGE * np.repeat(most, 3)
    height[one] = height[other] = np.minimum(height[one], height[other])
    return np.clip(bulge, -4.0 * height.reshape(-1, 3), 4.0 * height.reshape(-1, 3))


def sample(
    body: Body, origin: np.ndarray, shape: tuple[int, ...], cell: float, reach: float
) -> np.ndarray:
    """Signed distance to a body at the points of a grid, float `shape`, m.

    Within BAND cells of the surface all facets are tried; beyond, those that were closest to the
    nearest such grid point and, within `reach` [m], to any neighbour. Farther away it is the truth
    or at most a cell more.
    """
    area = vectors(body.points, body.triangles)
    normal = normals(body.points, body.triangles)
    triangles = np.ascontiguousarray(body.triangles, np.int32)
    at_edge: np.ndarray = np.repeat(normal[:, None], 3, axis=1).reshape(-1, 3)
    first, second = pairs(triangles).T
    at_edge[first] = at_edge[second] = normal[first // 3] + normal[second // 3]
    at_corner = np.zeros_like(body.points)
    corners = body.points[triangles]
    for k in range(3):
        u, v = (corners[:, (k + s) % 3] - corners[:, k] for s in (1, 2))
        sine = np.linalg.norm(np.cross(u, v), axis=1)
        angle = np.arctan2(sine, np.einsum("ij,ij->i", u, v))
        np.add.at(at_corner, triangles[:, k], angle[:, None] * normal)
    bulge = _bulge(body.points, triangles, area, normal)
    distance: np.ndarray = np.full(shape, np.inf)
    facet: np.ndarray = np.full(shape, -1, np.int32)
    exact = BAND * cell
    _nearest(body.points, triangles, normal, origin, cell, exact, distance, facet)
    far = facet < 0
    nearest = ndimage.distance_transform_edt(far, return_distances=False, return_indices=True)
    facet = facet[tuple(nearest)]
    if reach > exact:
        _spread(body.points, triangles, origin, cell, exact, reach + 2 * exact, distance, facet)
    at_edge = at_edge.reshape(-1, 3, 3)
    _signed(
        body.points, triangles, normal, at_edge, at_corner, bulge, origin, cell, facet, distance
    )
    # Between a far point and the band there is no surface: they lie on the same side.
    near = distance[tuple(axis[far] for axis in nearest)]
    distance[far] = np.copysign(distance[far], near)
    return distance


def worst_jump(distance: np.ndarray) -> tuple[float, tuple[int, ...]]:
    """Largest sum of two neighbours' distances where the sign changes, and where that is.

    Between neighbours on two sides of a surface it is at most their distance from each other, a
    cell; more means that the sign is wrong: facets cross each other or are turned the wrong way.
    """
    worst, place = 0.0, tuple[int, ...]((0, 0, 0))
    for axis in range(3):
        ahead = np.moveaxis(distance, axis, 0)[1:]
        behind = np.moveaxis(distance, axis, 0)[:-1]
        jump = np.where((ahead < 0.0) != (behind < 0.0), np.abs(ahead - behind), 0.0)
        k = int(jump.argmax())
        if jump.flat[k] > worst:
            worst = float(jump.flat[k])
            index = list(np.unravel_index(k, jump.shape))
            index.insert(axis, index.pop(0))
            place = tuple(int(i) for i in index)
    return worst, place


@numba.njit(cache=True, error_model="numpy")
def read_spline(points, coefficients, origin, cell, distance, normal, curvature):
    """Value, gradient and second derivatives of a cubic B-spline.

    Each point, (n, 3), has two grid points or more to every side.
    """
    w, start = np.empty((3, 3, 4)), np.empty(3, np.int64)
    for m in range(points.shape[0]):
        for i in range(3):
            place = (points[m, i] - origin[i]) / cell
            index = int(np.floor(place))
            index = min(max(index, 1), coefficients.shape[i] - 3)
            t = place - index
            s = 1.0 - t
            start[i] = index - 1
            w[0, i, 0], w[0, i, 3] = s * s * s / 6.0, t * t * t / 6.0
            w[0, i, 1] = (4.0 - 6.0 * t * t + 3.0 * t * t * t) / 6.0
            w[0, i, 2] = (4.0 - 6.0 * s * s + 3.0 * s * s * s) / 6.0
            w[1, i, 0], w[1, i, 3] = -0.5 * s * s / cell, 0.5 * t * t / cell
            w[1, i, 1] = (-2.0 * t + 1.5 * t * t) / cell
            w[1, i, 2] = (2.0 * s - 1.5 * s * s) / cell
            w[2, i, 0], w[2, i, 3] = s / cell**2, t / cell**2
            w[2, i, 1], w[2, i, 2] = (3.0 * t - 2.0) / cell**2, (3.0 * s - 2.0) / cell**2
        d = gx = gy = gz = hxx = hyy = hzz = hxy = hxz = hyz = 0.0
        for i in range(4):
            a = b = c = bb = cc = bc = 0.0  # of y and z together: value, by y, by z ...
            for j in range(4):
                v0 = v1 = v2 = 0.0
                for k in range(4):
                    value = coefficients[start[0] + i, start[1] + j, start[2] + k]
                    v0 += w[0, 2, k] * value
                    v1 += w[1, 2, k] * value
                    v2 += w[2, 2, k] * value
                a += w[0, 1, j] * v0
                b += w[1, 1, j] * v0
                c += w[0, 1, j] * v1
                bb += w[2, 1, j] * v0
                cc += w[0, 1, j] * v2
                bc += w[1, 1, j] * v1
            d += w[0, 0, i] * a
            gx += w[1, 0, i] * a
            gy += w[0, 0, i] * b
            gz += w[0, 0, i] * c
            hxx += w[2, 0, i] * a
            hyy += w[0, 0, i] * bb
            hzz += w[0, 0, i] * cc
            hxy += w[1, 0, i] * b
            hxz += w[1, 0, i] * c
            hyz += w[0, 0, i] * bc
        distance[m] = d
        normal[m, 0], normal[m, 1], normal[m, 2] = gx, gy, gz
        curvature[m, 0, 0], curvature[m, 1, 1], curvature[m, 2, 2] = hxx, hyy, hzz
        curvature[m, 0, 1] = curvature[m, 1, 0] = hxy
        curvature[m, 0, 2] = curvature[m, 2, 0] = hxz
        curvature[m, 1, 2] = curvature[m, 2, 1] = hyz
