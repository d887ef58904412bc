# SPDX-License-Identifier: MIT
"""In-plane bending of the yarns of cruciforms: consistent beams, and [25]-[28] as printed."""

from __future__ import annotations

import numpy as np

from .kinematics import normals


def stiffness(a, t, rigidity, length_scale: float) -> np.ndarray:
    """Stiffness on the 16 unknowns: each arm an Euler-Bernoulli beam from the hinge to its end.

    The cubic of [24] with deflections measured from the hinge, which moves (the printed element
    suppresses its deflection), and the coupling 2 L^2 where [25] prints 3 L^2.

    Parameters
    ----------
    a : float (n, 4)
        Arm lengths in m; 0 for a missing arm.
    t : float (n, 4, 2)
    rigidity : float (n, 4)
        Flexural rigidity of the arms, [23]: yarn rigidity x yarns per length x width, N m^2.
    length_scale : float
        Rotations are stored times this length, m.

    Returns
    -------
    float (n, 16, 16), N/m
    """
    n = len(a)
    normal = normals(t)
    result = np.zeros((n, 16, 16))
    for k in range(4):
        present = a[:, k] > 0
        length = np.where(present, a[:, k], 1.0)
        factor = np.where(present, rigidity[:, k] / length**3, 0.0)
        beam = np.empty((n, 4, 4))  # on (w_0, phi_0, w_k, phi_k)
        one, half, full = np.ones(n), length / length_scale, (length / length_scale) ** 2
        beam[:, 0] = np.stack([12 * one, 6 * half, -12 * one, 6 * half], axis=1)
        beam[:, 1] = np.stack([6 * half, 4 * full, -6 * half, 2 * full], axis=1)
        beam[:, 2] = -beam[:, 0]
        beam[:, 3] = np.stack([6 * half, 2 * full, -6 * half, 4 * full], axis=1)
        beam *= factor[:, None, None]
        place = np.zeros((n, 4, 16))
        place[:, 0, 12:14] = place[:, 2, 3 * k : 3 * k + 2] = normal[:, k]
        place[:, 1, 14 + k % 2] = place[:, 3, 3 * k + 2] = 1.0
        result += np.swapaxes(place, 1, 2) @ beam @ place
    return result


def printed(half_length, t, rigidity) -> np.ndarray:
    """Matrix [26] of one yarn on (u_1, phi_1, phi_2, u_3, phi_3), to the letter.

    Two faults: the coupling 3 L^2 in [25], [28] (should be 2 L^2) makes a rigid rotation leave end
    moments, and the second block of [27], (m, l; -l, m), takes the axial direction at node 3 for
    the transverse one. Shown by tests; no solver uses it.

    Parameters
    ----------
    half_length : float (n,), the paper's L in m
    t : float (n, 2), unit vector of the yarn
    rigidity : float (n,), N m^2

    Returns
    -------
    float (n, 7, 7)
    """
    return _three_node(half_length, t, rigidity, 3.0, wrong_block=True)


def corrected(half_length, t, rigidity) -> np.ndarray:
    """Matrix [26] with both faults of the print mended; arguments as in printed."""
    return _three_node(half_length, t, rigidity, 2.0, wrong_block=False)


def _three_node(half_length, t, rigidity, coupling: float, wrong_block: bool) -> np.ndarray:
    n = len(half_length)
    one, length, square = np.ones(n), half_length, half_length**2
    upper = {
        (1, 1): 12 * one, (1, 2): 6 * length, (1, 3): 6 * length,
        (2, 2): 4 * square, (2, 3): coupling * square,
        (3, 3): 8 * square, (3, 5): -6 * length, (3, 6): 2 * square,
        (5, 5): 12 * one, (5, 6): -6 * length, (6, 6): 4 * square,
    }  # fmt: skip
    local = np.zeros((n, 7, 7))  # [28]
    for (row, column), value in upper.items():
        local[:, row, column] = local[:, column, row] = value
    local *= (rigidity / half_length**3)[:, None, None]
    q = np.zeros((n, 7, 7))  # [27]
    el, em = t[:, 0], t[:, 1]
    q[:, 0, 0], q[:, 0, 1], q[:, 1, 0], q[:, 1, 1] = el, em, -em, el
    q[:, 2, 2] = q[:, 3, 3] = q[:, 6, 6] = 1.0
    if wrong_block:
        q[:, 4, 4], q[:, 4, 5], q[:, 5, 4], q[:, 5, 5] = em, el, -el, em
    else:
        q[:, 4, 4], q[:, 4, 5], q[:, 5, 4], q[:, 5, 5] = el, em, -em, el
    return np.swapaxes(q, 1, 2) @ local @ q
