# SPDX-License-Identifier: MIT
"""In-plane shear of cruciforms: the consistent element, and the matrix [21], [22] as printed."""

from __future__ import annotations

import numpy as np

from ..net.lattice import QUADRANTS


def moduli(quadrant_area, shear_modulus: float) -> np.ndarray:
    """Matrix D of W = 1/2 theta^T D theta, with theta the four arm rotations.

    W = sum over quadrants of 1/2 G area gamma^2 with gamma = theta_i - theta_j, the rotation of the
    warp arm less that of the weft arm. (In [16] each yarn's own turning costs energy, so that a
    rigid rotation does, too.)

    Parameters
    ----------
    quadrant_area : float (n, 4), m^2
    shear_modulus : float, N/m

    Returns
    -------
    float (n, 4, 4), N m
    """
    d = np.zeros((len(quadrant_area), 4, 4))
    for q, (i, j) in enumerate(QUADRANTS):
        stiff = shear_modulus * quadrant_area[:, q]
        d[:, i, i] += stiff
        d[:, j, j] += stiff
        d[:, i, j] -= stiff
        d[:, j, i] -= stiff
    return d


def stiffness(rotation_rows, quadrant_area, shear_modulus: float) -> np.ndarray:
    """Stiffness on the 10 displacements, (n, 10, 10) in N/m; see moduli."""
    d = moduli(quadrant_area, shear_modulus)
    return np.swapaxes(rotation_rows, 1, 2) @ d @ rotation_rows


def quadrant_angles(rotation: np.ndarray) -> np.ndarray:
    """Shear angle of each quadrant in radians from the arm rotations; (n, 4) -> (n, 4)."""
    return rotation[:, QUADRANTS[:, 0]] - rotation[:, QUADRANTS[:, 1]]


def printed(half_length, t, area, shear_modulus: float) -> np.ndarray:
    """Matrix [21] with [22] of one straight yarn on its two end displacements, to the letter.

    Its energy is [16]: each yarn's own rotation costs 1/2 G A (rotation)^2. A rigid rotation is not
    free, and a pure shear shared evenly by two yarns costs half of 1/2 G A gamma^2. Shown by tests;
    no solver uses it.

    Parameters
    ----------
    half_length : float (n,), the paper's L in m
    t : float (n, 2), unit vector of the yarn
    area : float (n,), the paper's A in m^2

    Returns
    -------
    float (n, 4, 4), N/m
    """
    n = len(half_length)
    local = np.zeros((n, 4, 4))
    local[:, 1, 1] = local[:, 3, 3] = 1.0
    local[:, 1, 3] = local[:, 3, 1] = -1.0
    local *= (area * shear_modulus / (4 * half_length**2))[:, None, None]  # [22]
    q = np.zeros((n, 4, 4))
    block = np.stack([t, np.stack([-t[:, 1], t[:, 0]], axis=1)], axis=1)  # (l, m; -m, l)
    q[:, :2, :2] = q[:, 2:, 2:] = block
    return np.swapaxes(q, 1, 2) @ local @ q  # [21]
