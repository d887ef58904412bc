# SPDX-License-Identifier: MIT
"""Finite deformation of cruciforms and of yarns that bend: energy, force and exact stiffness.

Compiled kernels, in the plane and in space from one source. Positions come in, element by element;
energies, their gradients and their second derivatives go out. Nothing is small here but the step.

Cruciform, points 1 to 4 the arm ends and 5 the hinge (docs/formulation.md, "Finite deformation"):

    W = sum over quadrants ij of A_ij [ Phi_w(e_i) + Phi_e(e_j) + c12 e_i e_j + psi(gamma_ij) ]
    e = effective strain of the stretch |x_i - x_0| / a_i (laws.effective_strain)
    gamma_ij = s_ij (90 deg - angle(t_i, t_j)),  s_ij = +1, -1, +1, -1 around the hinge

Turn of a yarn at a point between two straight pieces d_1, d_2 (Hencky's bar-chain):

    W = B kappa^2 l / 2,  kappa = 2 tan(theta / 2) / l

with theta the angle from d_1 to d_2 and l the mean of the two rest lengths. In space kappa is a
vector, 2 d_1 x d_2 / (|d_1| |d_2| + d_1 . d_2) / l; its part along the cloth's normal is bending in
the tangent plane and has one rigidity, the rest (bending out of it) another.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from zlib import crc32

import numba
import numpy as np

from .. import laws
from ..laws import effective_strain, evaluate_law
from ..net.lattice import HELD, QUADRANTS

_WARP_ARM = tuple(int(i) for i in QUADRANTS[:, 0])
_WEFT_ARM = tuple(int(j) for j in QUADRANTS[:, 1])
_SIGN = (1.0, -1.0, 1.0, -1.0)

# Liberties of the compiler that keep NaN and infinity what they are: what is no state must show.
FREE = {"contract", "reassoc", "nsz", "arcp"}

# Numba's cache on disk does not notice that the laws compiled in have changed in their own file; a
# variable of the kernel's closure is part of the cache's key.
LAWS = crc32(Path(laws.__file__).read_bytes())

ENERGY, FORCE, STIFFNESS = 0, 1, 2  # how much a kernel works out


@dataclass(frozen=True)
class Cloth:
    """What the kernels need to know of a fabric.

    Attributes
    ----------
    warp, weft, shear : float arrays
        Laws, Potential.packed.
    c12 : float
        N/m.
    log_strain : bool
    compression : float
        Stiffness in compression over that in tension.
    compression_width : float
        Strain over which it changes.
    """

    warp: np.ndarray
    weft: np.ndarray
    shear: np.ndarray
    c12: float
    log_strain: bool = False
    compression: float = 1.0
    compression_width: float = 1e-4


@lru_cache(maxsize=2)
def _cruciform_kernel(dim: int) -> Callable[..., None]:
    """Compile the cruciform for positions in ``dim`` dimensions."""
    warp_arm, weft_arm, signs, held_source = _WARP_ARM, _WEFT_ARM, _SIGN, int(HELD)
    compiled_laws = LAWS

    @numba.njit(cache=True, error_model="numpy", fastmath=FREE)
    def kernel(
        x, before, a, area, strain_source, turn_source, held, warp, weft, shear, c12, log_strain,
        ratio, width, level, energy, force, stiffness,
    ):  # fmt: skip
        foretold = before.shape[0] > 0 and level == 2 and compiled_laws >= 0  # it never is below
        # The commonest case by a shorter way, for speed.
        plain = not log_strain and ratio == 1.0
        straight = shear[0] == 0.0  # a linear law
        t, inverse = np.zeros((4, dim)), np.zeros(4)
        # Phi and the effective strain q of each arm, and their derivatives by its length.
        w, w1, w2 = np.zeros(4), np.zeros(4), np.zeros(4)
        q, q1, q2 = np.zeros(4), np.zeros(4), np.zeros(4)
        v1, p, p1 = np.zeros(4), np.zeros(4), np.zeros(4)  # Phi', q, q' at the strain foretold
        # dW/dlength of the arms and its slope: of each arm, and between a warp and a weft arm.
        pull, told, slope_own = np.zeros(4), np.zeros(4), np.zeros(4)
        slope_mixed = np.zeros((2, 2))
        # Gradient and second derivatives by the arms as vectors; arms of one family do not couple.
        g, own, mixed = np.zeros((4, dim)), np.zeros((4, dim, dim)), np.zeros((2, 2, dim, dim))
        ti, tj, pi, pj = np.zeros(dim), np.zeros(dim), np.zeros(dim), np.zeros(dim)
        normal = np.zeros(dim)
        for n in range(x.shape[0]):
            for arm in range(4):
                inverse[arm] = pull[arm] = told[arm] = slope_own[arm] = 0.0
                w[arm] = w1[arm] = w2[arm] = q[arm] = q1[arm] = q2[arm] = 0.0
                v1[arm] = p[arm] = p1[arm] = 0.0
                for i in range(dim):
                    t[arm, i] = g[arm, i] = 0.0
                if a[n, arm] == 0.0:
                    continue
                length = 0.0
                for i in range(dim):
                    t[arm, i] = x[n, arm, i] - x[n, 4, i]
                    length += t[arm, i] * t[arm, i]
                length = np.sqrt(length)
                inverse[arm] = 1.0 / length
                for i in range(dim):
                    t[arm, i] *= inverse[arm]
                b = 1.0 / a[n, arm]
                law = warp if arm % 2 == 0 else weft
                if plain:
                    z, z1, z2 = length * b - 1.0, b, 0.0
                else:
                    z, z1, z2 = effective_strain(length * b, log_strain, ratio, width)
                    z1, z2 = z1 * b, z2 * b * b
                if law[0] == 0.0:
                    y2 = law[1]
                    y1 = y2 * z
                    y = 0.5 * y1 * z
                else:
                    y, y1, y2 = evaluate_law(law, z)
                w[arm], w1[arm], w2[arm] = y, y1 * z1, y2 * z1 * z1 + y1 * z2
                q[arm], q1[arm], q2[arm] = z, z1, z2
                if foretold:
                    old, grown = 0.0, 0.0
                    for i in range(dim):
                        d = before[n, arm, i] - before[n, 4, i]
                        old += d * d
                        grown += d * (x[n, arm, i] - x[n, 4, i] - d)
                    old = np.sqrt(old)
                    stretch = max(b * (old + grown / old), 1e-3)
                    z, z1, z2 = effective_strain(stretch, log_strain, ratio, width)
                    z1, z2 = z1 * b, z2 * b * b
                    y, y1, y2 = evaluate_law(law, z)
                    v1[arm], w2[arm] = y1 * z1, y2 * z1 * z1 + y1 * z2
                    p[arm], p1[arm], q2[arm] = z, z1, z2
            if level == 2:
                for i in range(dim):
                    for j in range(dim):
                        for arm in range(4):
                            own[arm, i, j] = 0.0
                        mixed[0, 0, i, j] = mixed[0, 1, i, j] = 0.0
                        mixed[1, 0, i, j] = mixed[1, 1, i, j] = 0.0
            slope_mixed[0, 0] = slope_mixed[0, 1] = slope_mixed[1, 0] = slope_mixed[1, 1] = 0.0
            stretching, shearing = 0.0, 0.0
            for quadrant in range(4):
                part = area[n, quadrant]
                if part == 0.0:
                    continue
                i_arm, j_arm = warp_arm[quadrant], weft_arm[quadrant]
                # Tension of the two arms, or of those whose strain they take.
                si, sj = strain_source[n, i_arm], strain_source[n, j_arm]
                qi, qj, fi, fj = 0.0, 0.0, 0.0, 0.0
                if si != held_source:
                    qi, fi = q[si], p[si] if foretold else q[si]
                if sj != held_source:
                    qj, fj = q[sj], p[sj] if foretold else q[sj]
                stretching += part * c12 * qi * qj
                if si != held_source:
                    stretching += part * w[si]
                    pull[si] += part * (w1[si] + c12 * qj * q1[si])
                    told[si] += part * (v1[si] + c12 * fj * p1[si])
                    slope_own[si] += part * (w2[si] + c12 * fj * q2[si])
                if sj != held_source:
                    stretching += part * w[sj]
                    pull[sj] += part * (w1[sj] + c12 * qi * q1[sj])
                    told[sj] += part * (v1[sj] + c12 * fi * p1[sj])
                    slope_own[sj] += part * (w2[sj] + c12 * fi * q2[sj])
                    if si != held_source:
                        both = p1[si] * p1[sj] if foretold else q1[si] * q1[sj]
                        slope_mixed[si // 2, sj // 2] += part * c12 * both
                # Shear between the directions of the two arms, or of those they take theirs from.
                ri, rj = turn_source[n, i_arm], turn_source[n, j_arm]
                sign_i, sign_j = 1.0, 1.0
                if ri != held_source and ri != i_arm:
                    sign_i = -1.0
                if rj != held_source and rj != j_arm:
                    sign_j = -1.0
                c = 0.0
                for i in range(dim):
                    ti[i] = held[n, i_arm, i] if ri == held_source else sign_i * t[ri, i]
                    tj[i] = held[n, j_arm, i] if rj == held_source else sign_j * t[rj, i]
                    c += ti[i] * tj[i]
                c = min(1.0, max(-1.0, c))
                sine = max(np.sqrt(1.0 - c * c), 1e-12)
                s = signs[quadrant]
                gamma = s * np.arcsin(c)
                if straight:
                    psi2 = shear[1]
                    psi1 = psi2 * gamma
                    psi = 0.5 * psi1 * gamma
                else:
                    psi, psi1, psi2 = evaluate_law(shear, gamma)
                shearing += part * psi
                if level == 0:
                    continue
                slope_angle, curve_angle = -s * part * psi1, part * psi2
                hi = 0.0 if ri == held_source else inverse[ri] * sign_i
                hj = 0.0 if rj == held_source else inverse[rj] * sign_j
                for i in range(dim):
                    # Unit vectors across each direction towards the other: d angle/d t_i = -p_i.
                    pi[i] = (tj[i] - c * ti[i]) / sine
                    pj[i] = (ti[i] - c * tj[i]) / sine
                # A held arm has h = 0 and adds nothing to whichever arm it is counted with.
                ri, rj = max(ri, i_arm % 2), max(rj, j_arm % 2)
                for i in range(dim):
                    g[ri, i] -= slope_angle * hi * pi[i]
                    g[rj, i] -= slope_angle * hj * pj[i]
                if level == 1:
                    continue
                out_own, out_mixed = 0.0, 0.0
                if dim == 3:  # across the plane of both directions
                    for i in range(dim):
                        following, last = (i + 1) % 3, (i + 2) % 3
                        normal[i] = (ti[following] * tj[last] - ti[last] * tj[following]) / sine
                    out_own, out_mixed = slope_angle * c / sine, -slope_angle / sine
                hii, hjj, hij = hi * hi, hj * hj, hi * hj
                m, o = ri // 2, rj // 2
                for i in range(dim):
                    si_ = hii * (curve_angle * pi[i] + slope_angle * ti[i])
                    sj_ = hjj * (curve_angle * pj[i] + slope_angle * tj[i])
                    mi_ = hij * curve_angle * pi[i]
                    ui_, uj_ = hii * slope_angle * pi[i], hjj * slope_angle * pj[i]
                    oi_, oj_ = hii * out_own * normal[i], hjj * out_own * normal[i]
                    om_ = hij * out_mixed * normal[i]
                    for j in range(i, dim):  # symmetric: the upper half will do
                        own[ri, i, j] += si_ * pi[j] + ui_ * ti[j] + oi_ * normal[j]
                        own[rj, i, j] += sj_ * pj[j] + uj_ * tj[j] + oj_ * normal[j]
                    for j in range(dim):
                        mixed[m, o, i, j] += mi_ * pj[j] + om_ * normal[j]
            energy[n, 0], energy[n, 1] = stretching, shearing
            if level == 0:
                continue
            for i in range(dim):
                force[n, 4, i] = 0.0
                for arm in range(4):
                    force[n, arm, i] = g[arm, i] + pull[arm] * t[arm, i]
                    force[n, 4, i] -= force[n, arm, i]
            if level == 1:
                continue
            for arm in range(4):
                across = (told[arm] if foretold else pull[arm]) * inverse[arm]
                along = slope_own[arm] - across
                for i in range(dim):
                    own[arm, i, i] += across
                    for j in range(i, dim):
                        own[arm, i, j] += along * t[arm, i] * t[arm, j]
                        own[arm, j, i] = own[arm, i, j]
            if c12 != 0.0:
                for m in range(2):
                    for o in range(2):
                        for i in range(dim):
                            for j in range(dim):
                                mixed[m, o, i, j] += (
                                    slope_mixed[m, o] * t[2 * m, i] * t[2 * o + 1, j]
                                )
            for i in range(dim):
                for j in range(dim):
                    total = 0.0
                    for m in range(2):
                        warp_arm_, weft_arm_ = 2 * m, 2 * m + 1
                        row = own[warp_arm_, i, j] + mixed[m, 0, i, j] + mixed[m, 1, i, j]
                        stiffness[n, warp_arm_, i, warp_arm_, j] = own[warp_arm_, i, j]
                        stiffness[n, warp_arm_, i, 1, j] = mixed[m, 0, i, j]
                        stiffness[n, warp_arm_, i, 3, j] = mixed[m, 1, i, j]
                        stiffness[n, warp_arm_, i, 2 - warp_arm_, j] = 0.0
                        stiffness[n, warp_arm_, i, 4, j] = -row
                        stiffness[n, 4, j, warp_arm_, i] = -row
                        total += row
                        row = own[weft_arm_, i, j] + mixed[0, m, j, i] + mixed[1, m, j, i]
                        stiffness[n, weft_arm_, i, weft_arm_, j] = own[weft_arm_, i, j]
                        stiffness[n, weft_arm_, i, 0, j] = mixed[0, m, j, i]
                        stiffness[n, weft_arm_, i, 2, j] = mixed[1, m, j, i]
                        stiffness[n, weft_arm_, i, 4 - weft_arm_, j] = 0.0
                        stiffness[n, weft_arm_, i, 4, j] = -row
                        stiffness[n, 4, j, weft_arm_, i] = -row
                        total += row
                    stiffness[n, 4, i, 4, j] = total

    return kernel


def cruciforms(
    x, a, area, cloth: Cloth, level: int = STIFFNESS, strain_source=None, turn_source=None,
    held=None, before=None, out=None,
):  # fmt: skip
    """Energy, force and stiffness of cruciforms.

    Parameters
    ----------
    x : float (n, 5, dim)
        Positions of the arm ends 1 to 4 and of the hinge, dim 2 or 3, metres.
    a : float (n, 4)
        Rest lengths of the arms, metres; 0 for a missing one (its point is not looked at).
    area : float (n, 4)
        Of the quadrants, in the order of lattice.QUADRANTS, square metres.
    cloth : Cloth
    level : int
        ENERGY, FORCE or STIFFNESS.
    strain_source, turn_source : int (n, 4), optional
        Arm whose strain, and whose direction (reversed), an arm takes; HELD for no strain, and for
        the direction in ``held``. By default its own.
    held : float (n, 4, dim), optional
        Unit vectors.
    before : float (n, 5, dim), optional
        Positions from which the last step led to x. The tensions in the stiffness are then those
        that were foretold there to first order, which is Newton's method on the mixed problem with
        tensions as unknowns (Magisano, Leonetti and Garcea 2017: "mixed integration points").
        Stiff yarns that turn in a step stretch to second order; their true tensions would spoil
        the stiffness by far more than the step has changed it. Energy and force do not change.
    out : tuple of arrays, optional
        Where to put the results.

    Returns
    -------
    energy : float (n, 2), J, of tension and of shear
    force : float (n, 5, dim), N, the gradient of their sum
    stiffness : float (n, 5, dim, 5, dim), N/m, the gradient of force
    """
    n, _, dim = x.shape
    own = np.broadcast_to(np.arange(4), (n, 4))
    if out is None:
        out = _room(n, 2, 5, dim, level)
    _cruciform_kernel(dim)(
        x, np.empty((0, 5, dim)) if before is None else before, a, area,
        np.ascontiguousarray(own if strain_source is None else strain_source, np.int64),
        np.ascontiguousarray(own if turn_source is None else turn_source, np.int64),
        np.zeros((n, 4, dim)) if held is None else held,
        cloth.warp, cloth.weft, cloth.shear, cloth.c12, cloth.log_strain,
        cloth.compression, cloth.compression_width, level, *out,
    )  # fmt: skip
    return out


def _room(n: int, parts: int, points: int, dim: int, level: int):
    """Arrays for the results; those not asked for have no rows."""
    force = n if level >= FORCE else 0
    matrices = n if level >= STIFFNESS else 0
    return (
        np.empty((n, parts)),
        np.empty((force, points, dim)),
        np.empty((matrices, points, dim, points, dim)),
    )


@numba.njit(cache=True, error_model="numpy", fastmath=FREE)
def _turns_in_plane(x, length, rigidity, level, energy, force, stiffness):
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


def turns(x, length, rigidity, level: int = STIFFNESS, out=None):
    """Energy, force and stiffness of turns of yarns in the plane.

    Parameters
    ----------
    x : float (n, 3, 2)
        Positions of the point before, of the turn, of the point after, metres.
    length : float (n,)
        Mean rest length of the two pieces of yarn, metres.
    rigidity : float (n,)
        Flexural rigidity of the yarns together, N m^2.
    level, out
        As for cruciforms.

    Returns
    -------
    energy : float (n, 1), J
    force : float (n, 3, 2), N
    stiffness : float (n, 3, 2, 3, 2), N/m
    """
    if out is None:
        out = _room(len(x), 1, 3, 2, level)
    _turns_in_plane(x, length, rigidity, level, *out)
    return out


@numba.njit(cache=True, error_model="numpy", fastmath=FREE)
def _turns_in_space(x, chord, length, in_plane, out_of_plane, level, energy, force, stiffness):
    # All follows from the products of d_1, d_2 and the chord c, in this order:
    # A = d_1.d_1, B = d_2.d_2, D = d_1.d_2, u = d_1.c, v = d_2.c, C = c.c
    first = (0, 1, 0, 0, 1, 2)  # which vectors each product is of
    second = (0, 1, 1, 2, 2, 2)
    f, h = np.zeros(6), np.zeros((6, 6))  # derivatives of the energy by the products
    q1, m1, n1 = np.zeros(6), np.zeros(6), np.zeros(6)
    b1, q2, m2, n2 = np.zeros(6), np.zeros((6, 6)), np.zeros((6, 6)), np.zeros((6, 6))
    t1, t2 = np.zeros(6), np.zeros((6, 6))
    z = np.zeros((3, 3))
    g, k = np.zeros((3, 3)), np.zeros((3, 3, 3, 3))
    for e in range(x.shape[0]):
        for i in range(3):
            z[0, i] = x[e, 1, i] - x[e, 0, i]
            z[1, i] = x[e, 2, i] - x[e, 1, i]
            z[2, i] = chord[e, i]
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
        inner, outer = in_plane[e] / length[e], out_of_plane[e] / length[e]
        energy[e, 0] = 0.5 * inner * beta * beta
        energy[e, 1] = 0.5 * outer * max(whole - beta * beta, 0.0)
        if level == 0:
            continue
        n1[0], n1[1], n1[2], n1[3], n1[4], n1[5] = v, -u, v - u, -(b + d), a + d, 0.0
        q1[0], q1[1], q1[2] = 0.5 * size / a, 0.5 * size / b, 1.0
        w1 = (c, c, 2.0 * c, -2.0 * (u + v), -2.0 * (u + v), a + b + 2.0 * d)
        for i in range(6):
            m1[i] = 0.5 * w1[i] / m
            b1[i] = (2.0 * n1[i] / m - beta * (q1[i] + q * m1[i] / m)) / q
        # |b|^2 = 8 size/q - 4
        s1 = (0.5 * size / a, 0.5 * size / b, 0.0, 0.0, 0.0, 0.0)
        for i in range(6):
            t1[i] = 8.0 * (s1[i] * q - size * q1[i]) / (q * q)
            f[i] = (inner - outer) * beta * b1[i] + 0.5 * outer * t1[i]
        for p in range(3):
            for i in range(3):
                g[p, i] = 0.0
        for r in range(6):
            for i in range(3):
                g[first[r], i] += f[r] * z[second[r], i]
                g[second[r], i] += f[r] * z[first[r], i]
        for i in range(3):
            force[e, 0, i], force[e, 1, i] = -g[0, i], g[0, i] - g[1, i]
            force[e, 2, i], force[e, 3, i] = g[1, i], g[2, i]
        if level == 1:
            continue
        n2[:] = 0.0
        n2[0, 4] = n2[4, 0] = n2[2, 4] = n2[4, 2] = 1.0
        n2[1, 3] = n2[3, 1] = n2[2, 3] = n2[3, 2] = -1.0
        q2[:] = 0.0
        q2[0, 0], q2[1, 1] = -0.25 * size / (a * a), -0.25 * size / (b * b)
        q2[0, 1] = q2[1, 0] = 0.25 * size / (a * b)
        m2[:] = 0.0
        m2[0, 5] = m2[5, 0] = m2[1, 5] = m2[5, 1] = 1.0
        m2[2, 5] = m2[5, 2] = 2.0
        m2[3, 3] = m2[4, 4] = m2[3, 4] = m2[4, 3] = -2.0
        for i in range(6):
            for j in range(6):
                mm = (0.5 * m2[i, j] - m1[i] * m1[j]) / m  # second derivative of |m|
                # beta q m = 2 N differentiated twice
                bb = (
                    2.0 * n2[i, j]
                    - b1[i] * (q1[j] * m + q * m1[j])
                    - b1[j] * (q1[i] * m + q * m1[i])
                    - beta * (q2[i, j] * m + q1[i] * m1[j] + q1[j] * m1[i] + q * mm)
                ) / (q * m)
                # t = 8 size/q - 4, so (t + 4) q = 8 size; size has q's second derivatives
                t2[i, j] = (
                    8.0 * q2[i, j] - t1[i] * q1[j] - t1[j] * q1[i] - (whole + 4.0) * q2[i, j]
                ) / q
                h[i, j] = (inner - outer) * (b1[i] * b1[j] + beta * bb) + 0.5 * outer * t2[i, j]
        for p in range(3):
            for r in range(3):
                for i in range(3):
                    for j in range(3):
                        k[p, r, i, j] = 0.0
        for r in range(6):
            for i in range(3):
                k[first[r], second[r], i, i] += f[r]
                k[second[r], first[r], i, i] += f[r]
            for o in range(6):
                for i in range(3):
                    for j in range(3):
                        k[first[r], first[o], i, j] += h[r, o] * z[second[r], i] * z[second[o], j]
                        k[first[r], second[o], i, j] += h[r, o] * z[second[r], i] * z[first[o], j]
                        k[second[r], first[o], i, j] += h[r, o] * z[first[r], i] * z[second[o], j]
                        k[second[r], second[o], i, j] += h[r, o] * z[first[r], i] * z[first[o], j]
        for i in range(3):
            for j in range(3):
                for p in range(4):
                    for r in range(4):
                        stiffness[e, p, i, r, j] = 0.0
                for p in range(3):
                    for r in range(3):
                        # d_1 = x_1 - x_0, d_2 = x_2 - x_1, c by itself
                        value = k[p, r, i, j]
                        stiffness[e, p + 1, i, r + 1, j] += value
                        if p < 2:
                            stiffness[e, p, i, r + 1, j] -= value
                        if r < 2:
                            stiffness[e, p + 1, i, r, j] -= value
                        if p < 2 and r < 2:
                            stiffness[e, p, i, r, j] += value


def turns_in_space(x, chord, length, in_plane, out_of_plane, level: int = STIFFNESS, out=None):
    """Energy, force and stiffness of turns of yarns in space, in and out of the cloth's plane.

    With b = 2 d_1 x d_2/(|d_1| |d_2| + d_1 . d_2) and the cloth's normal n along (d_1 + d_2) x c, c
    the direction of the crossing yarns,

        W = [ B_in (b . n)^2 + B_out (|b|^2 - (b . n)^2) ] / (2 l)

    Parameters
    ----------
    x : float (n, 3, 3)
        Positions of the point before, of the turn, of the point after, metres.
    chord : float (n, 3)
        Vector along the crossing yarns (between their arm ends, of any length).
    length : float (n,)
        Mean rest length of the two pieces of yarn, metres.
    in_plane, out_of_plane : float (n,)
        Flexural rigidities for bending in the tangent plane and out of it, N m^2.
    level, out
        As for cruciforms.

    Returns
    -------
    energy : float (n, 2), J, in and out of plane
    force : float (n, 4, 3), N, on the three points and by the chord
    stiffness : float (n, 4, 3, 4, 3), N/m
    """
    if out is None:
        out = _room(len(x), 2, 4, 3, level)
    _turns_in_space(x, chord, length, in_plane, out_of_plane, level, *out)
    return out
