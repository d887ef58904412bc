# SPDX-License-Identifier: MIT
"""Finite deformation of cruciforms: energy, force and exact stiffness.

Compiled kernels, in the plane and in space from one source. Positions come in, element by element;
energies, their gradients and their second derivatives go out. Nothing is small here but the step.

Cruciform, points 1 to 4 the arm ends and 5 the hinge (docs/formulation.md, "Finite deformation"):

    W = sum over quadrants ij of A_ij [ Phi_w(e_i) + Phi_e(e_j) + c12 e_i e_j + psi(gamma_ij) ]
    e = effective strain of the stretch |x_i - x_0| / a_i (laws.effective_strain)

or, with a biaxial law (tension.evaluate_tension), of A_ij [ w(e_i, e_j) + psi(gamma_ij) ];

    gamma_ij = s_ij (90 deg - angle(t_i, t_j)),  s_ij = +1, -1, +1, -1 around the hinge

Cloth whose shear flows or rubs adds an incremental potential to psi, see laws.shear_resistance.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from functools import lru_cache
from pathlib import Path
from zlib import crc32

import numba
import numpy as np

from .. import laws, tension
from ..laws import effective_strain, evaluate_law, shear_resistance
from ..net.lattice import HELD, QUADRANTS
from ..tension import evaluate_tension
from .level import FREE, STIFFNESS, room

_WARP_ARM = tuple(int(i) for i in QUADRANTS[:, 0])
_WEFT_ARM = tuple(int(j) for j in QUADRANTS[:, 1])
_SIGN = (1.0, -1.0, 1.0, -1.0)

# Numba's cache on disk does not notice that the laws compiled in have changed in their own file; a
# variable of the kernel's closure is part of the cache's key.
LAWS = crc32(Path(laws.__file__).read_bytes() + Path(tension.__file__).read_bytes())


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
    biaxial : float array
        A law of both tensions, BiaxialLaw.packed, beside which warp and weft are zero and c12 is
        not looked at; empty for none.
    """

    warp: np.ndarray
    weft: np.ndarray
    shear: np.ndarray
    c12: float
    log_strain: bool = False
    compression: float = 1.0
    compression_width: float = 1e-4
    biaxial: np.ndarray = field(default_factory=lambda: np.zeros(0))


@lru_cache(maxsize=2)
def _cruciform_kernel(dim: int) -> Callable[..., None]:
    """Compile the cruciform for positions in ``dim`` dimensions."""
    warp_arm, weft_arm, signs, held_source = _WARP_ARM, _WEFT_ARM, _SIGN, int(HELD)
    compiled_laws = LAWS

    @numba.njit(cache=True, error_model="numpy", fastmath=FREE)
    def kernel(
        x, before, a, area, strain_source, turn_source, held, past, warp, weft, shear, resistance,
        c12, log_strain, ratio, width, biaxial, level, energy, force, stiffness,
    ):  # fmt: skip
        foretold = before.shape[0] > 0 and level == 2 and compiled_laws >= 0  # it never is below
        # The commonest case by a shorter way, for speed.
        coupled = biaxial.shape[0] > 0
        arm_ratio = 1.0 if coupled else ratio  # a biaxial law sees to compression itself
        plain = not log_strain and arm_ratio == 1.0
        straight = shear[0] == 0.0  # a linear law
        resists = past.shape[0] > 0
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
                    z, z1, z2 = effective_strain(length * b, log_strain, arm_ratio, width)
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
                    z, z1, z2 = effective_strain(stretch, log_strain, arm_ratio, width)
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
                # What both do together, its derivatives by either strain; and those, with the
                # second ones, where they were foretold.
                both, by_i, by_j = c12 * qi * qj, c12 * qj, c12 * qi
                to_i, to_j, to_ii, to_ij, to_jj = c12 * fj, c12 * fi, 0.0, c12, 0.0
                if coupled:
                    both, by_i, by_j, to_ii, to_ij, to_jj = evaluate_tension(
                        biaxial, qi, qj, ratio, width
                    )
                    to_i, to_j = by_i, by_j
                    if foretold:
                        _, to_i, to_j, to_ii, to_ij, to_jj = evaluate_tension(
                            biaxial, fi, fj, ratio, width
                        )
                stretching += part * both
                if si != held_source:
                    first = p1[si] if foretold else q1[si]
                    stretching += part * w[si]
                    pull[si] += part * (w1[si] + by_i * q1[si])
                    told[si] += part * (v1[si] + to_i * p1[si])
                    slope_own[si] += part * (w2[si] + to_i * q2[si] + to_ii * first * first)
                if sj != held_source:
                    second = p1[sj] if foretold else q1[sj]
                    stretching += part * w[sj]
                    pull[sj] += part * (w1[sj] + by_j * q1[sj])
                    told[sj] += part * (v1[sj] + to_j * p1[sj])
                    slope_own[sj] += part * (w2[sj] + to_j * q2[sj] + to_jj * second * second)
                    if si != held_source:
                        slope_mixed[si // 2, sj // 2] += part * to_ij * first * second
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
                if resists:
                    more, more1, more2 = shear_resistance(
                        gamma, past[n, quadrant, 0], past[n, quadrant, 1], resistance
                    )
                    psi, psi1, psi2 = psi + more, psi1 + more1, psi2 + more2
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
            if c12 != 0.0 or coupled:
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
    held=None, before=None, past=None, resistance=None, out=None,
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
    past : float (n, 4, 2), optional
        Of each quadrant, the shear angle of the last accepted state and the angle at which friction
        has its anchor, with ``resistance`` (5,): what laws.shear_resistance takes.
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
        out = room(n, 2, 5, dim, level)
    _cruciform_kernel(dim)(
        x, np.empty((0, 5, dim)) if before is None else before, a, area,
        np.ascontiguousarray(own if strain_source is None else strain_source, np.int64),
        np.ascontiguousarray(own if turn_source is None else turn_source, np.int64),
        np.zeros((n, 4, dim)) if held is None else held,
        np.empty((0, 4, 2)) if past is None else past,
        cloth.warp, cloth.weft, cloth.shear, np.zeros(5) if resistance is None else resistance,
        cloth.c12, cloth.log_strain,
        cloth.compression, cloth.compression_width, cloth.biaxial, level, *out,
    )  # fmt: skip
    return out
