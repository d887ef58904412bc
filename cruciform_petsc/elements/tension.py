# SPDX-License-Identifier: MIT
"""Biaxial tension of cruciforms: the consistent element, and the matrix [15] as printed.

Equation numbers in brackets are those of the paper "Mechanics of woven fabrics using cruciform
elements"; "notes" are the misprints told in docs/formulation.md.
"""

from __future__ import annotations

import numpy as np

from ..net.lattice import QUADRANTS


def moduli(quadrant_area, c11: float, c22: float, c12: float) -> np.ndarray:
    """Matrix D of W = 1/2 eps^T D eps, with eps the four arm strains.

    W = sum over quadrants of area (1/2 c11 eps_i^2 + 1/2 c22 eps_j^2 + c12 eps_i eps_j), i the
    quadrant's warp arm and j its weft arm: [1] inverted, with 1/(1 - nu_w nu_e) on every term (the
    printed [2] lacks it on the direct one) and the coupling weighted by area (the printed [8] is
    symmetric for equal arms only).

    Parameters
    ----------
    quadrant_area : float (n, 4), m^2
    c11, c22, c12 : float, N/m

    Returns
    -------
    float (n, 4, 4), N m
    """
    d = np.zeros((len(quadrant_area), 4, 4))
    for q, (i, j) in enumerate(QUADRANTS):
        area = quadrant_area[:, q]
        d[:, i, i] += c11 * area
        d[:, j, j] += c22 * area
        d[:, i, j] += c12 * area
        d[:, j, i] += c12 * area
    return d


def stiffness(strain_rows, quadrant_area, c11: float, c22: float, c12: float) -> np.ndarray:
    """Stiffness on the 10 displacements, (n, 10, 10) in N/m; see moduli."""
    d = moduli(quadrant_area, c11, c22, c12)
    return np.swapaxes(strain_rows, 1, 2) @ d @ strain_rows


def printed(a, t, modulus_warp, modulus_weft, poisson_warp, poisson_weft) -> np.ndarray:
    """Matrix [15] on the 8 arm-end displacements, to the letter (with L^T read as Omega^T).

    Its sign is that of the force the element exerts: a network assembles its negative. The direct
    stiffness of [2], [5], [8] is E instead of E/(1 - nu_w nu_e), and with unequal arms it is not
    symmetric. Shown by tests; no solver uses it.

    Parameters
    ----------
    a : float (n, 4), arm lengths in m
    t : float (n, 4, 2), unit vectors hinge -> arm end

    Returns
    -------
    float (n, 8, 8), N/m
    """
    n = len(a)
    mu_w = poisson_warp / (1 - poisson_warp * poisson_weft)  # [3]
    mu_e = poisson_weft / (1 - poisson_warp * poisson_weft)
    k1 = (a[:, 1] + a[:, 3]) * modulus_warp  # [8]
    k2 = (a[:, 0] + a[:, 2]) * modulus_weft
    alpha1, alpha2 = 0.5 * k1 * mu_e, 0.5 * k2 * mu_w
    big_k = np.zeros((n, 4, 4))
    for row, (k, alpha) in enumerate([(k1, alpha1), (k2, alpha2)] * 2):
        big_k[:, row, row] = k
        big_k[:, row, (row + 1) % 4] = big_k[:, row, (row + 3) % 4] = alpha
    big_c = np.zeros((n, 4, 4))
    omega = np.zeros((n, 4, 8))
    for k in range(4):
        big_c[:, k, k] = 1 / a[:, k]
        omega[:, k, 2 * k : 2 * k + 2] = t[:, k]
    d = t  # (n, 4, 2): the paper's D, rows (l_i, m_i)
    dt = np.swapaxes(d, 1, 2)
    psi = dt @ big_k @ big_c @ d  # [11], [12]
    inner = np.eye(4) - big_c @ d @ np.linalg.inv(psi) @ dt @ big_k  # [13]
    return -np.swapaxes(omega, 1, 2) @ big_k @ inner @ big_c @ omega  # [15]
