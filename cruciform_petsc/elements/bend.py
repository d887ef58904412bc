# SPDX-License-Identifier: MIT
"""Finite deformation of yarns that bend: energy, force and exact stiffness.

A yarn bends at a point between two straight pieces d_1, d_2 (Hencky's bar-chain):

    W = B kappa^2 l / 2,  kappa = 2 tan(theta / 2) / l

with theta the angle from d_1 to d_2 and l the mean of the two rest lengths. In space kappa is a
vector, 2 d_1 x d_2 / (|d_1| |d_2| + d_1 . d_2) / l. With n the cloth's normal, along
(d_1 + d_2) x c, c the direction of the crossing yarns,

    W = [ B_in (kappa . n)^2 + B_out (|kappa|^2 - (kappa . n)^2) ] l / 2

or, out of the plane, l times the energy per length of a law of moment over curvature.
"""

from __future__ import annotations

from collections.abc import Sequence

import numba
import numpy as np

from ..laws import Potential
from .level import FREE, STIFFNESS, room


@numba.njit(cache=True, error_model="numpy", fastmath=FREE)
def _bends_in_plane(x, length, rigidity, level, energy, force, stiffness):
    g = np.zeros((2, 2))  # of b, on (d_1, d_2)
    h = np.zeros((2, 2, 2, 2))
    dq = np.zeros((2, 2))
    dn = np.zeros((2, 2))
    t = np.zeros((2, 2))
    d = np.zeros((2, 2))
    for m in range(x.shape[0]):
        size = np.zeros(2)
        for p in range(2):
            for i in range(2):
                d[p, i] = x[m, p + 1, i] - x[m, p, i]
            size[p] = np.sqrt(d[p, 0] ** 2 + d[p, 1] ** 2)
            for i in range(2):
                t[p, i] = d[p, i] / size[p]
        # b = 2 tan(theta/2) = 2 N / q, N = d_1 x d_2, q = |d_1| |d_2| + d_1 . d_2
        number = d[0, 0] * d[1, 1] - d[0, 1] * d[1, 0]
        q = size[0] * size[1] + d[0, 0] * d[1, 0] + d[0, 1] * d[1, 1]
        b = 2.0 * number / q
        factor = rigidity[m] / length[m]
        energy[m, 0] = 0.5 * factor * b * b
        if level == 0:
            continue
        dn[0, 0], dn[0, 1], dn[1, 0], dn[1, 1] = d[1, 1], -d[1, 0], -d[0, 1], d[0, 0]
        for p in range(2):
            for i in range(2):
                dq[p, i] = t[p, i] * size[1 - p] + d[1 - p, i]
                g[p, i] = (2.0 * dn[p, i] - b * dq[p, i]) / q
        for i in range(2):
            g1, g2 = factor * b * g[0, i], factor * b * g[1, i]
            force[m, 0, i], force[m, 1, i], force[m, 2, i] = -g1, g1 - g2, g2
        if level == 1:
            continue
        for p in range(2):
            for r in range(2):
                for i in range(2):
                    for j in range(2):
                        same = 1.0 if i == j else 0.0
                        if p == r:
                            ddq = size[1 - p] / size[p] * (same - t[p, i] * t[p, j])
                            ddn = 0.0
                        else:
                            ddq = t[p, i] * t[r, j] + same
                            ddn = 0.0 if i == j else (1.0 if (i < j) == (p < r) else -1.0)
                        bent = (2.0 * ddn - b * ddq - g[r, j] * dq[p, i] - g[p, i] * dq[r, j]) / q
                        h[p, r, i, j] = factor * (g[p, i] * g[r, j] + b * bent)
        for i in range(2):
            for j in range(2):
                k11, k12, k21, k22 = h[0, 0, i, j], h[0, 1, i, j], h[1, 0, i, j], h[1, 1, i, j]
                stiffness[m, 0, i, 0, j] = k11
                stiffness[m, 0, i, 1, j] = k12 - k11
                stiffness[m, 0, i, 2, j] = -k12
                stiffness[m, 1, i, 0, j] = k21 - k11
                stiffness[m, 1, i, 1, j] = k11 - k12 - k21 + k22
                stiffness[m, 1, i, 2, j] = k12 - k22
                stiffness[m, 2, i, 0, j] = -k21
                stiffness[m, 2, i, 1, j] = k21 - k22
                stiffness[m, 2, i, 2, j] = k22


# In space all follows from the products of d_1, d_2 and the chord c, in this order:
# A = d_1.d_1, B = d_2.d_2, D = d_1.d_2, u = d_1.c, v = d_2.c, C = c.c; which is of which vectors:
_FIRST, _SECOND = np.array([0, 1, 0, 0, 1, 2]), np.array([0, 1, 1, 2, 2, 2])
_PRODUCT = np.array([[0, 2, 3], [2, 1, 4], [3, 4, 5]])
_TWICE = np.eye(3) + 1.0  # a product's gradient by a vector is the other one, or twice itself


@numba.njit(cache=True, error_model="numpy", fastmath=FREE)
def _bends_in_space(x, length, in_plane, slopes, curves, level, energy, force, stiffness):
    f, h = np.zeros(6), np.zeros((6, 6))  # derivatives of the energy by the products
    q1, m1, n1 = np.zeros(6), np.zeros(6), np.zeros(6)
    b1, q2, m2, n2 = np.zeros(6), np.zeros((6, 6)), np.zeros((6, 6)), np.zeros((6, 6))
    m2[0, 5] = m2[1, 5] = 1.0  # upper halves
    m2[2, 5] = 2.0
    m2[3, 3] = m2[4, 4] = m2[3, 4] = -2.0
    n2[0, 4] = n2[2, 4] = 1.0
    n2[1, 3] = n2[2, 3] = -1.0
    t1, s1 = np.zeros(6), np.zeros(6)
    z = np.zeros((3, 3))
    g, k, row = np.zeros((3, 3)), np.zeros((3, 3, 3, 3)), np.zeros((3, 3))
    points = x.shape[1]
    for e in range(x.shape[0]):
        for i in range(3):
            z[0, i] = x[e, 1, i] - x[e, 0, i]
            z[1, i] = x[e, 2, i] - x[e, 1, i]
            z[2, i] = 0.0
            for p in range(3, x.shape[1], 2):
                z[2, i] += x[e, p + 1, i] - x[e, p, i]
        a = z[0, 0] ** 2 + z[0, 1] ** 2 + z[0, 2] ** 2
        b = z[1, 0] ** 2 + z[1, 1] ** 2 + z[1, 2] ** 2
        d = z[0, 0] * z[1, 0] + z[0, 1] * z[1, 1] + z[0, 2] * z[1, 2]
        u = z[0, 0] * z[2, 0] + z[0, 1] * z[2, 1] + z[0, 2] * z[2, 2]
        v = z[1, 0] * z[2, 0] + z[1, 1] * z[2, 1] + z[1, 2] * z[2, 2]
        c = z[2, 0] ** 2 + z[2, 1] ** 2 + z[2, 2] ** 2
        size = np.sqrt(a * b)
        q = size + d
        # |b|^2 = 4 |d_1 x d_2|^2 / q^2 = 4 (size - d)/q, size - d = |d_1 x d_2|^2/q without loss.
        cross = (
            (z[0, 1] * z[1, 2] - z[0, 2] * z[1, 1]) ** 2
            + (z[0, 2] * z[1, 0] - z[0, 0] * z[1, 2]) ** 2
            + (z[0, 0] * z[1, 1] - z[0, 1] * z[1, 0]) ** 2
        )
        whole = 4.0 * cross / (q * q)
        # Part along the normal m = (d_1 + d_2) x c: beta = 2 (d_1 x d_2).m / (q |m|)
        number = v * (a + d) - u * (b + d)
        across = (a + b + 2.0 * d) * c - (u + v) ** 2
        m = np.sqrt(across)
        beta = 2.0 * number / (q * m)
        inner, slope, curve = in_plane[e] / length[e], slopes[e], curves[e]
        energy[e, 0] = 0.5 * inner * beta * beta
        # Out of the plane by s = |b|^2 - beta^2, of which slope and curve are the derivatives.
        energy[e, 1] = slope * max(whole - beta * beta, 0.0)
        if level == 0:
            continue
        n1[0], n1[1], n1[2], n1[3], n1[4], n1[5] = v, -u, v - u, -(b + d), a + d, 0.0
        q1[0], q1[1], q1[2] = 0.5 * size / a, 0.5 * size / b, 1.0
        w1 = (c, c, 2.0 * c, -2.0 * (u + v), -2.0 * (u + v), a + b + 2.0 * d)
        for i in range(6):
            m1[i] = 0.5 * w1[i] / m
            b1[i] = (2.0 * n1[i] / m - beta * (q1[i] + q * m1[i] / m)) / q
        # |b|^2 = 8 size/q - 4
        z1 = (0.5 * size / a, 0.5 * size / b, 0.0, 0.0, 0.0, 0.0)
        for i in range(6):
            t1[i] = 8.0 * (z1[i] * q - size * q1[i]) / (q * q)
            s1[i] = t1[i] - 2.0 * beta * b1[i]
            f[i] = inner * beta * b1[i] + slope * s1[i]
        for p in range(3):
            for i in range(3):
                g[p, i] = 0.0
        for r in range(6):
            for i in range(3):
                g[_FIRST[r], i] += f[r] * z[_SECOND[r], i]
                g[_SECOND[r], i] += f[r] * z[_FIRST[r], i]
        for i in range(3):
            force[e, 0, i], force[e, 1, i], force[e, 2, i] = -g[0, i], g[0, i] - g[1, i], g[1, i]
            for p in range(3, x.shape[1], 2):
                force[e, p, i], force[e, p + 1, i] = -g[2, i], g[2, i]
        if level == 1:
            continue
        q2[0, 0], q2[1, 1] = -0.25 * size / (a * a), -0.25 * size / (b * b)
        q2[0, 1] = 0.25 * size / (a * b)
        per_m, per_q = 1.0 / m, 1.0 / q
        per_qm = per_q * per_m
        for i in range(6):
            for j in range(i, 6):
                mm = (0.5 * m2[i, j] - m1[i] * m1[j]) * per_m  # second derivative of |m|
                # beta q m = 2 N differentiated twice
                bb = (
                    2.0 * n2[i, j]
                    - b1[i] * (q1[j] * m + q * m1[j])
                    - b1[j] * (q1[i] * m + q * m1[i])
                    - beta * (q2[i, j] * m + q1[i] * m1[j] + q1[j] * m1[i] + q * mm)
                ) * per_qm
                # t = 8 size/q - 4, so (t + 4) q = 8 size; size has q's second derivatives
                t2 = ((4.0 - whole) * q2[i, j] - t1[i] * q1[j] - t1[j] * q1[i]) * per_q
                bent = b1[i] * b1[j] + beta * bb
                h[i, j] = inner * bent + slope * (t2 - 2.0 * bent) + curve * s1[i] * s1[j]
                h[j, i] = h[i, j]
        # By the vectors
        for p in range(3):
            for r in range(p, 3):
                for t in range(3):
                    for j in range(3):
                        row[t, j] = 0.0
                        for o in range(3):
                            factor = h[_PRODUCT[p, t], _PRODUCT[r, o]] * _TWICE[r, o]
                            row[t, j] += factor * z[o, j]
                        row[t, j] *= _TWICE[p, t]
                for i in range(3):
                    for j in range(3):
                        k[p, r, i, j] = (
                            z[0, i] * row[0, j] + z[1, i] * row[1, j] + z[2, i] * row[2, j]
                        )
                    k[p, r, i, i] += f[_PRODUCT[p, r]] * _TWICE[p, r]
        # By the points: of each of the first three with all, and of one on the crossing yarn; the
        # others there are like it, or its negative.
        for i in range(3):
            for j in range(3):
                k00, k01, k11 = k[0, 0, i, j], k[0, 1, i, j], k[1, 1, i, j]
                k10, k02, k12 = k[0, 1, j, i], k[0, 2, i, j], k[1, 2, i, j]
                stiffness[e, 0, i, 0, j] = k00
                stiffness[e, 0, i, 1, j] = k01 - k00
                stiffness[e, 0, i, 2, j] = -k01
                stiffness[e, 1, i, 0, j] = k10 - k00
                stiffness[e, 1, i, 1, j] = k00 - k01 - k10 + k11
                stiffness[e, 1, i, 2, j] = k01 - k11
                stiffness[e, 2, i, 0, j] = -k10
                stiffness[e, 2, i, 1, j] = k10 - k11
                stiffness[e, 2, i, 2, j] = k11
                k20, k21, k22 = k[0, 2, j, i], k[1, 2, j, i], k[2, 2, i, j]
                for p in range(3, points, 2):
                    stiffness[e, 0, i, p, j], stiffness[e, 0, i, p + 1, j] = k02, -k02
                    stiffness[e, 1, i, p, j], stiffness[e, 1, i, p + 1, j] = k12 - k02, k02 - k12
                    stiffness[e, 2, i, p, j], stiffness[e, 2, i, p + 1, j] = -k12, k12
                    stiffness[e, p, i, 0, j], stiffness[e, p + 1, i, 0, j] = k20, -k20
                    stiffness[e, p, i, 1, j], stiffness[e, p + 1, i, 1, j] = k21 - k20, k20 - k21
                    stiffness[e, p, i, 2, j], stiffness[e, p + 1, i, 2, j] = -k21, k21
                    for r in range(3, points, 2):
                        stiffness[e, p, i, r, j] = stiffness[e, p + 1, i, r + 1, j] = k22
                        stiffness[e, p, i, r + 1, j] = stiffness[e, p + 1, i, r, j] = -k22


def _by_law(squared, length, rigidity, moment, family):
    """Energy out of the plane, and its derivatives by s = (l kappa)^2 (n,); see bends."""
    energy, slope, curve = np.empty((3, len(squared)))
    kappa = np.maximum(np.sqrt(squared), 1e-10) / length
    for i, law in enumerate(moment):
        at = np.flatnonzero(family == i)
        psi, psi1, psi2 = rigidity[at] / law.stiffness0 * np.array(law.evaluate(kappa[at]))
        energy[at] = length[at] * psi
        slope[at] = psi1 / (2.0 * kappa[at] * length[at])
        curve[at] = (psi2 - psi1 / kappa[at]) / (4.0 * kappa[at] ** 2 * length[at] ** 3)
    curve[squared < 1e-16] = 0.0
    return energy, slope, curve


def bends(
    x, length, in_plane, out_of_plane=None, level: int = STIFFNESS, out=None,
    moment: Sequence[Potential] = (), family=None,
):  # fmt: skip
    """Energy, force and stiffness of yarns that bend at a point, in the plane or in space.

    Parameters
    ----------
    x : float (n, 3, 2) or (n, 5, 3) or (n, 7, 3)
        Positions of the point before, of the bend and of the point after, metres; in space also of
        one or two pairs of points on crossing yarns: c is the sum of the vectors from the first to
        the second of each pair, of any length.
    length : float (n,)
        Mean rest length of the two pieces of yarn, metres.
    in_plane, out_of_plane : float (n,)
        Flexural rigidity of the yarns together for bending in the cloth's plane, and in space for
        bending out of it, N m^2.
    level, out
        As for cruciform.cruciforms.
    moment : sequence of Potential, optional
        Laws of the moment out of the plane over the curvature (1/m), of which only the shape
        counts: the rigidity is that at rest.
    family : int (n,), optional
        Which of the laws each bend has.

    Returns
    -------
    energy : float (n, 1), in space (n, 2): in and out of plane, J
    force : float, shape of x, N
    stiffness : float (n, k, dim, k, dim), N/m
    """
    n, points, dim = x.shape
    if out is None:
        out = room(n, dim - 1, points, dim, level)
    if dim == 2:
        _bends_in_plane(x, length, in_plane, level, *out)
    else:
        slope, curve = 0.5 * np.asarray(out_of_plane) / length, np.zeros(n)
        if moment:
            bare = room(n, 2, points, dim, 0)
            _bends_in_space(x, length, in_plane, np.ones(n), curve, 0, *bare)
            told, slope, curve = _by_law(bare[0][:, 1], length, out_of_plane, moment, family)
        _bends_in_space(x, length, in_plane, slope, curve, level, *out)
        if moment:
            out[0][:, 1] = told
    return out
