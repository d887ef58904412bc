# SPDX-License-Identifier: MIT
"""The paper's element matrices to the letter. Tests show their faults; no solver uses them.

Numbers in brackets are the paper's equations; docs/formulation.md lists the faults, and small.py
has the consistent forms. ``t`` holds unit vectors, lengths are in m.
"""

from __future__ import annotations

import numpy as np


def tension(a, t, modulus_warp, modulus_weft, poisson_warp, poisson_weft) -> np.ndarray:
    """Matrix [15] on the 8 arm-end displacements (with L^T read as Omega^T), (n, 8, 8) in N/m.

    Its sign is that of the force the element exerts: a network assembles its negative. The direct
    stiffness of [2], [5], [8] is E instead of E/(1 - nu_w nu_e), and with unequal arms it is not
    symmetric. a (n, 4), t (n, 4, 2).
    """
    n = len(a)
    mu_w = poisson_warp / (1 - poisson_warp * poisson_weft)  # [3]
    mu_e = poisson_weft / (1 - poisson_warp * poisson_weft)
    k1 = (a[:, 1] + a[:, 3]) * modulus_warp  # [8]
    k2 = (a[:, 0] + a[:, 2]) * modulus_weft
    big_k, big_c, omega = np.zeros((n, 4, 4)), np.zeros((n, 4, 4)), np.zeros((n, 4, 8))
    for row, (k, mu) in enumerate([(k1, mu_e), (k2, mu_w)] * 2):
        big_k[:, row, row] = k
        big_k[:, row, (row + 1) % 4] = big_k[:, row, (row + 3) % 4] = 0.5 * k * mu
        big_c[:, row, row] = 1 / a[:, row]
        omega[:, row, 2 * row : 2 * row + 2] = t[:, row]
    dt = np.swapaxes(t, 1, 2)  # the paper's D is t, rows (l_i, m_i)
    psi = dt @ big_k @ big_c @ t  # [11], [12]
    inner = np.eye(4) - big_c @ t @ np.linalg.inv(psi) @ dt @ big_k  # [13]
    return -np.swapaxes(omega, 1, 2) @ big_k @ inner @ big_c @ omega  # [15]


def shear(half_length, t, area, shear_modulus: float) -> np.ndarray:
    """Matrix [21] with [22] of one straight yarn on its two end displacements, (n, 4, 4) in N/m.

    Its energy is [16]: each yarn's own rotation costs 1/2 G A (rotation)^2. A rigid rotation is not
    free, and a pure shear shared evenly by two yarns costs half of 1/2 G A gamma^2.
    half_length (n,), the paper's L; t (n, 2); area (n,), m^2.
    """
    across = np.stack([-t[:, 1], t[:, 0]], axis=1)
    turned = np.concatenate([across, -across], axis=1)  # 2 L times the yarn's rotation
    factor = area * shear_modulus / (4 * half_length**2)  # [22]
    return factor[:, None, None] * turned[:, :, None] * turned[:, None, :]


def bending(half_length, t, rigidity, coupling=3.0, axial_block=True) -> np.ndarray:
    """Matrix [26] of one yarn on (u_1, phi_1, phi_2, u_3, phi_3), (n, 7, 7).

    Two faults: the coupling 3 L^2 in [25], [28] (should be 2 L^2) makes a rigid rotation leave end
    moments, and the second block of [27], (m, l; -l, m), takes the axial direction at node 3 for
    the transverse one. ``coupling`` 2 mends the first, ``axial_block`` false the second.
    half_length (n,), the paper's L; t (n, 2); rigidity (n,), N m^2.
    """
    n, length = len(half_length), half_length
    upper = {
        (1, 1): 12, (1, 2): 6 * length, (1, 3): 6 * length,
        (2, 2): 4 * length**2, (2, 3): coupling * length**2,
        (3, 3): 8 * length**2, (3, 5): -6 * length, (3, 6): 2 * length**2,
        (5, 5): 12, (5, 6): -6 * length, (6, 6): 4 * length**2,
    }  # fmt: skip
    local = np.zeros((n, 7, 7))  # [28]
    for (row, column), value in upper.items():
        local[:, row, column] = local[:, column, row] = value * rigidity / length**3
    q = np.zeros((n, 7, 7))  # [27]
    q[:, 2, 2] = q[:, 3, 3] = q[:, 6, 6] = 1.0
    block = np.stack([t, np.stack([-t[:, 1], t[:, 0]], axis=1)], axis=1)  # (l, m; -m, l)
    q[:, :2, :2] = block
    q[:, 4:6, 4:6] = np.stack([t[:, ::-1], -block[:, 1, ::-1]], axis=1) if axial_block else block
    return np.swapaxes(q, 1, 2) @ local @ q
