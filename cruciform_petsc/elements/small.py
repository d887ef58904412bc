# SPDX-License-Identifier: MIT
"""The cruciform of small displacements: consistent forms of the paper's tension, shear and bending.

Equation numbers in brackets are those of the paper "Mechanics of woven fabrics using cruciform
elements"; what is at fault in the print is told in docs/formulation.md, and its forms to the letter
are in printed.py. All functions take n cruciforms at once:

    a (n, 4)             arm lengths, m; 0 for a missing arm
    t (n, 4, 2)          unit vectors from the hinge to the arm ends
    quadrant_area (n, 4) m^2, in the order of lattice.QUADRANTS

Displacements are components in one frame (the network's: along warp, along weft). Unknowns:

- displacements only, 10: u_1 (2), u_2 (2), u_3 (2), u_4 (2), hinge u_0 (2);
- with yarn rotations, 16: for each arm end (u, u, psi), then hinge u_0 (2), psi of the warp yarn
  and psi of the weft yarn at the hinge; psi is a rotation times a length, so that all have one
  unit.
"""

from __future__ import annotations

import numpy as np

from ..net.lattice import HELD, QUADRANTS

# Where the 10 displacement unknowns stand among the 16 with rotations.
DISPLACEMENTS = np.array([0, 1, 3, 4, 6, 7, 9, 10, 12, 13])
# An Euler-Bernoulli beam on (w_0, phi_0, w_k, phi_k), for length and rigidity 1.
_BEAM = np.array([[12, 6, -12, 6], [6, 4, -6, 2], [-12, -6, 12, -6], [6, 2, -6, 4]], float)


def normals(t: np.ndarray) -> np.ndarray:
    """Arm directions turned by +90 degrees; (..., 2) -> (..., 2)."""
    return np.stack([-t[..., 1], t[..., 0]], axis=-1)


def arm_rows(a, t, strain_source=None, rotation_source=None):
    """Rows that give arm strains [6] and arm rotations from the 10 displacements.

    eps_k = t_k . (u_k - u_0)/a_k,  theta_k = n_k . (u_k - u_0)/a_k.

    ``strain_source``, ``rotation_source`` (n, 4): arm whose strain (rotation) an arm takes, by
    default its own; the opposite arm for one that has none of its own, HELD for none at all.
    Returns two float (n, 4, 10).
    """
    inverse = np.divide(1.0, a, out=np.zeros_like(a), where=a > 0)
    rows = []
    for direction, source in ((t, strain_source), (normals(t), rotation_source)):
        row = np.zeros((len(a), 4, 10))
        for k in range(4):
            row[:, k, 2 * k : 2 * k + 2] = inverse[:, k, None] * direction[:, k]
            row[:, k, 8:] = -row[:, k, 2 * k : 2 * k + 2]
        if source is not None:
            taken = np.take_along_axis(row, np.maximum(source, 0)[..., None], axis=1)
            row = np.asarray(np.where((source == HELD)[..., None], 0.0, taken))
        rows.append(row)
    return rows[0], rows[1]


def tension(strain_rows, quadrant_area, c11: float, c22: float, c12: float) -> np.ndarray:
    """Stiffness of biaxial tension on the 10 displacements, (n, 10, 10) in N/m; moduli in N/m.

    W = sum over quadrants of area (1/2 c11 eps_i^2 + 1/2 c22 eps_j^2 + c12 eps_i eps_j), i the
    quadrant's warp arm and j its weft arm: [1] inverted, with 1/(1 - nu_w nu_e) on every term (the
    printed [2] lacks it on the direct one) and the coupling weighted by area (the printed [8] is
    symmetric for equal arms only).
    """
    d = np.zeros((len(quadrant_area), 4, 4))  # W = 1/2 eps^T d eps, eps the four arm strains
    for q, (i, j) in enumerate(QUADRANTS):
        area = quadrant_area[:, q]
        d[:, i, i] += c11 * area
        d[:, j, j] += c22 * area
        d[:, i, j] += c12 * area
        d[:, j, i] += c12 * area
    return np.swapaxes(strain_rows, 1, 2) @ d @ strain_rows


def shear(rotation_rows, quadrant_area, modulus: float) -> np.ndarray:
    """Stiffness of shear on the 10 displacements, (n, 10, 10) in N/m; modulus in N/m.

    W = sum over quadrants of 1/2 G area gamma^2 with gamma = theta_i - theta_j, the rotation of the
    warp arm less that of the weft arm: tension's form with other moduli. (In [16] each yarn's own
    turning costs energy, so that a rigid rotation does, too.)
    """
    return tension(rotation_rows, quadrant_area, modulus, modulus, -modulus)


def bending(a, t, rigidity, length_scale: float) -> np.ndarray:
    """Stiffness of yarn bending on the 16 unknowns, (n, 16, 16) in N/m.

    Each arm is an Euler-Bernoulli beam from the hinge to its end: the cubic of [24] with
    deflections measured from the hinge, which moves (the printed element suppresses its
    deflection), and the coupling 2 L^2 where [25] prints 3 L^2.

    ``rigidity`` (n, 4) is the flexural rigidity of the arms, [23]: yarn rigidity x yarns per length
    x width, N m^2. Rotations are stored times ``length_scale``, m.
    """
    normal = normals(t)
    result = np.zeros((len(a), 16, 16))
    for k in range(4):
        factor = np.divide(rigidity[:, k], a[:, k] ** 3, out=np.zeros(len(a)), where=a[:, k] > 0)
        rows = np.zeros((len(a), 4, 16))  # (w_0, phi_0 a, w_k, phi_k a) from the unknowns
        rows[:, 0, 12:14] = rows[:, 2, 3 * k : 3 * k + 2] = normal[:, k]
        rows[:, 1, 14 + k % 2] = rows[:, 3, 3 * k + 2] = a[:, k] / length_scale
        result += factor[:, None, None] * (np.swapaxes(rows, 1, 2) @ _BEAM @ rows)
    return result


def condense(stiffness: np.ndarray, keep: int) -> tuple[np.ndarray, np.ndarray]:
    """Eliminate the unknowns behind the first ``keep`` (paper [9]-[15] for the hinge).

    Free directions of the eliminated unknowns (a matrix of one mode alone may leave the hinge free)
    are given the value of smallest norm. Returns the condensed matrices (n, keep, keep), symmetric,
    and (n, m - keep, keep): the eliminated unknowns from the kept ones, without loads on them.
    """
    side = stiffness[:, keep:, :keep]
    recovery = -np.linalg.pinv(stiffness[:, keep:, keep:], rcond=1e-13, hermitian=True) @ side
    condensed = stiffness[:, :keep, :keep] + np.swapaxes(side, 1, 2) @ recovery
    return 0.5 * (condensed + np.swapaxes(condensed, 1, 2)), recovery
