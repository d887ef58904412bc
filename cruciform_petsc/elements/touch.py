# SPDX-License-Identifier: MIT
"""A point of one ply against a smooth patch of another: distance, and its exact derivatives.

The point is x = sum alpha_j x_j, the patch y(u, v) = sum w_j(u, v) x_j, biquadratic B-splines over
nine control points, |u|, |v| <= 1/2, going on smoothly, at last straight, beyond. At the closest
place r = x - y is along the normal n there, r = d n. With c_j = alpha_j of the point's nodes and
-w_j of the patch's, c_j,a the derivatives by u and v, a_ab = y_a . y_b, b_ab = n . y_ab,
A = a - d b,

    d_j = c_j n
    d_jk = c_j,a A^ab c_k n y_b + c_j c_k,b A^ab y_a n - d c_j,a A^ab c_k,b n n
           - c_j c_k y_a (A^-1 b a^-1)^ab y_b

(the second derivative of a least distance: Phi = r^2/2, d d_jk = Phi_jk - Phi_ja Phi^ab Phi_bk
- d_j d_k; Konyukhov and Schweizerhof, Computational Contact Mechanics, 2013, chapter 7).
"""

from __future__ import annotations

import numba
import numpy as np

from .level import FREE

STRAIGHT = 1.0  # from a patch's middle: as far as it is bent
FARTHEST = 20.0  # from a patch's middle: beyond nothing lies on it
_ROUNDS = 30
_NEAR = 1e-13  # of a patch: closest places are known as well as this


@numba.njit(cache=True)
def _splines(u, n):
    """Values, slopes and curvatures (3, 3) of the three quadratic B-splines at u.

    Beyond STRAIGHT they go straight on.
    """
    beyond = u - min(max(u, -STRAIGHT), STRAIGHT)
    u -= beyond
    n[0, 0], n[0, 1], n[0, 2] = 0.5 * (0.5 - u) ** 2, 0.75 - u * u, 0.5 * (0.5 + u) ** 2
    n[1, 0], n[1, 1], n[1, 2] = u - 0.5, -2.0 * u, u + 0.5
    n[2, 0], n[2, 1], n[2, 2] = 1.0, -2.0, 1.0
    if beyond != 0.0:
        for a in range(3):
            n[0, a] += beyond * n[1, a]
            n[2, a] = 0.0


@numba.njit(cache=True)
def _on_patch(y, uv, nu, nv, s):
    """Place, two tangents, three second derivatives (6, 3); control points y (9, 3)."""
    _splines(uv[0], nu)
    _splines(uv[1], nv)
    s[:] = 0.0
    for a in range(3):
        for b in range(3):
            for i in range(3):
                at = y[3 * a + b, i]
                s[0, i] += nu[0, a] * nv[0, b] * at
                s[1, i] += nu[1, a] * nv[0, b] * at
                s[2, i] += nu[0, a] * nv[1, b] * at
                s[3, i] += nu[2, a] * nv[0, b] * at
                s[4, i] += nu[1, a] * nv[1, b] * at
                s[5, i] += nu[0, a] * nv[2, b] * at


@numba.njit(cache=True)
def _control(x, weight, y):
    """Control points (9, 3) of nodes (k, 3)."""
    y[:] = 0.0
    for c in range(9):
        for j in range(x.shape[0]):
            w = weight[c, j]
            if w != 0.0:
                for i in range(3):
                    y[c, i] += w * x[j, i]


@numba.njit(cache=True)
def _closest(x, y, uv, nu, nv, s):
    """Put the closest place on a patch to x into uv, from where it is; whether there is one.

    Newton's method, by the tangents alone where the patch is bent away too much.
    """
    for _ in range(_ROUNDS):
        _on_patch(y, uv, nu, nv, s)
        g0 = g1 = a00 = a01 = a11 = b00 = b01 = b11 = 0.0
        for i in range(3):
            r = x[i] - s[0, i]
            g0, g1 = g0 + r * s[1, i], g1 + r * s[2, i]
            a00, a01, a11 = a00 + s[1, i] ** 2, a01 + s[1, i] * s[2, i], a11 + s[2, i] ** 2
            b00, b01, b11 = b00 + r * s[3, i], b01 + r * s[4, i], b11 + r * s[5, i]
        h00, h01, h11 = a00 - b00, a01 - b01, a11 - b11
        det = h00 * h11 - h01 * h01
        if not (h00 > 0.0 and det > 1e-3 * a00 * a11):
            h00, h01, h11 = a00, a01, a11
            det = h00 * h11 - h01 * h01
        if not det > 0.0:
            return False
        d0, d1 = (h11 * g0 - h01 * g1) / det, (h00 * g1 - h01 * g0) / det
        size = max(abs(d0), abs(d1))
        if size > 1.0:
            d0, d1 = d0 / size, d1 / size
        uv[0] += d0
        uv[1] += d1
        if not max(abs(uv[0]), abs(uv[1])) < FARTHEST:  # nor if they are no numbers
            return False
        if size < _NEAR:
            _on_patch(y, uv, nu, nv, s)
            return True
    return size < 1e-6


@numba.njit(cache=True)
def _normal(s, n):
    """Unit normal of a patch, along warp times weft; the length of the tangents' product."""
    n[0] = s[1, 1] * s[2, 2] - s[1, 2] * s[2, 1]
    n[1] = s[1, 2] * s[2, 0] - s[1, 0] * s[2, 2]
    n[2] = s[1, 0] * s[2, 1] - s[1, 1] * s[2, 0]
    size = np.sqrt(n[0] ** 2 + n[1] ** 2 + n[2] ** 2)
    for i in range(3):
        n[i] /= size


@numba.njit(cache=True)
def closest(point, x, weight, uv, distance, normal):
    """Closest places on patches, in place.

    Parameters
    ----------
    point : float (m, 3), m
    x : float (m, k, 3)
        Nodes of the patches.
    weight : float (m, 9, k)
    uv : float (m, 2)
        Where to look first; then the place. NaN where there is none.
    distance : float (m,), m
        Positive on the side of the normal.
    normal : float (m, 3)
        Along warp times weft.
    """
    y, s, n = np.zeros((9, 3)), np.zeros((6, 3)), np.zeros(3)
    nu, nv = np.zeros((3, 3)), np.zeros((3, 3))
    for m in range(len(point)):
        _control(x[m], weight[m], y)
        if not _closest(point[m], y, uv[m], nu, nv, s):
            uv[m] = np.nan
            distance[m] = np.nan
            normal[m] = np.nan
            continue
        _normal(s, n)
        distance[m] = 0.0
        for i in range(3):
            distance[m] += (point[m, i] - s[0, i]) * n[i]
            normal[m, i] = n[i]


@numba.njit(cache=True)
def shares(uv, weight, value):
    """Shares (m, k) of nodes in places (m, 2) on patches, in place."""
    nu, nv = np.zeros((3, 3)), np.zeros((3, 3))
    for m in range(len(uv)):
        _splines(uv[m, 0], nu)
        _splines(uv[m, 1], nv)
        for j in range(weight.shape[2]):
            value[m, j] = 0.0
            for c in range(9):
                value[m, j] += nu[0, c // 3] * nv[0, c % 3] * weight[m, c, j]


@numba.njit(cache=True, error_model="numpy", fastmath=FREE)
def touch(x, alpha, weight, start, side, area, offset, k, width, level, energy, force, stiffness):
    """Energy of contact of points with patches, and its derivatives, in place.

    Parameters
    ----------
    x : float (m, a + k, 3)
        Nodes of the points, then of the patches.
    alpha : float (a,)
    weight : float (m, 9, k)
    start : float (m, 2)
        u, v where to look first.
    side : float
        1 where points lie on the side of warp times weft, -1 on the other.
    area : float (m,), m^2
    offset : float
        Distance at which they touch, m.
    k, width : float
        N/m^3, m, see items.contact.compaction.
    level : int
    energy : float (m,)
    force : float (m, p, 3), stiffness : float (m, p, 3, p, 3)
        p at least a + k; what is not of these nodes is not written to.
    """
    count = len(alpha)
    nodes = count + weight.shape[2]
    y, s, n = np.zeros((9, 3)), np.zeros((6, 3)), np.zeros(3)
    nu, nv = np.zeros((3, 3)), np.zeros((3, 3))
    uv, at = np.zeros(2), np.zeros(3)
    c, c1 = np.zeros(nodes), np.zeros((2, nodes))
    a, b, inverse, bent = np.zeros((2, 2)), np.zeros((2, 2)), np.zeros((2, 2)), np.zeros((2, 2))
    along, t = np.zeros((2, nodes)), np.zeros((2, 3))
    for m in range(x.shape[0]):
        energy[m] = 0.0
        if level >= 1:
            force[m, :nodes] = 0.0
        if level >= 2:
            stiffness[m, :nodes, :, :nodes] = 0.0
        _control(x[m, count:], weight[m], y)
        at[:] = 0.0
        for j in range(count):
            for i in range(3):
                at[i] += alpha[j] * x[m, j, i]
        uv[:] = start[m]
        if not _closest(at, y, uv, nu, nv, s):
            continue
        _normal(s, n)
        d = 0.0
        for i in range(3):
            n[i] *= side
            d += (at[i] - s[0, i]) * n[i]
        p = offset - d
        if p <= 0.0:
            continue
        if p < width:
            energy[m] = area[m] * k * p**3 / (6.0 * width)
            q, stiff = k * p * p / (2.0 * width), k * p / width
        else:
            over = p - width
            energy[m] = area[m] * k * (width**2 / 6.0 + 0.5 * over * width + 0.5 * over**2)
            q, stiff = k * (p - 0.5 * width), k
        if level < 1:
            continue
        q, stiff = q * area[m], stiff * area[m]
        for j in range(count):
            c[j] = alpha[j]
        for j in range(weight.shape[2]):
            w = w0 = w1 = 0.0
            for e in range(9):
                share = weight[m, e, j]
                if share != 0.0:
                    f, g = e // 3, e % 3
                    w += share * nu[0, f] * nv[0, g]
                    w0 += share * nu[1, f] * nv[0, g]
                    w1 += share * nu[0, f] * nv[1, g]
            c[count + j] = -w
            c1[0, count + j], c1[1, count + j] = -w0, -w1
        for j in range(nodes):
            for i in range(3):
                force[m, j, i] = -q * c[j] * n[i]
        if level < 2:
            continue
        for e in range(2):
            for f in range(2):
                a[e, f] = b[e, f] = 0.0
                for i in range(3):
                    a[e, f] += s[1 + e, i] * s[1 + f, i]
                    b[e, f] += n[i] * s[3 + e + f, i]
        det_a = a[0, 0] * a[1, 1] - a[0, 1] ** 2
        h00, h01, h11 = a[0, 0] - d * b[0, 0], a[0, 1] - d * b[0, 1], a[1, 1] - d * b[1, 1]
        det = h00 * h11 - h01 * h01
        inverse[0, 0], inverse[1, 1] = h11 / det, h00 / det
        inverse[0, 1] = inverse[1, 0] = -h01 / det
        # A^-1 b a^-1, twice from the left
        for e in range(2):
            bent[e, 0] = (b[e, 0] * a[1, 1] - b[e, 1] * a[0, 1]) / det_a
            bent[e, 1] = (b[e, 1] * a[0, 0] - b[e, 0] * a[0, 1]) / det_a
        m00 = inverse[0, 0] * bent[0, 0] + inverse[0, 1] * bent[1, 0]
        m01 = inverse[0, 0] * bent[0, 1] + inverse[0, 1] * bent[1, 1]
        m11 = inverse[1, 0] * bent[0, 1] + inverse[1, 1] * bent[1, 1]
        # t_a = A^ab y_b, along_a = A^ab c_,b
        for e in range(2):
            for i in range(3):
                t[e, i] = inverse[e, 0] * s[1, i] + inverse[e, 1] * s[2, i]
            for j in range(nodes):
                along[e, j] = inverse[e, 0] * c1[0, j] + inverse[e, 1] * c1[1, j]
        for i in range(3):
            for g in range(3):
                turn = m00 * s[1, i] * s[1, g] + m11 * s[2, i] * s[2, g]
                turn += m01 * (s[1, i] * s[2, g] + s[2, i] * s[1, g])
                nn = n[i] * n[g]
                both = stiff * nn + q * turn
                for j in range(nodes):
                    left = n[i] * (c1[0, j] * t[0, g] + c1[1, j] * t[1, g])
                    for o in range(nodes):
                        right = n[g] * (c1[0, o] * t[0, i] + c1[1, o] * t[1, i])
                        second = left * c[o] + right * c[j]
                        second -= d * nn * (along[0, j] * c1[0, o] + along[1, j] * c1[1, o])
                        stiffness[m, j, i, o, g] = both * c[j] * c[o] - q * second
