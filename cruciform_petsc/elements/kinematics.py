# SPDX-License-Identifier: MIT
"""Arm strains and arm rotations of cruciforms, and the elimination of the hinge."""

from __future__ import annotations

import numpy as np

from ..net.lattice import HELD

# Where the 10 displacement unknowns stand among the 16 with rotations.
DISPLACEMENTS = np.array([0, 1, 3, 4, 6, 7, 9, 10, 12, 13])


def normals(t: np.ndarray) -> np.ndarray:
    """Arm directions turned by +90 degrees; (..., 2) -> (..., 2)."""
    return np.stack([-t[..., 1], t[..., 0]], axis=-1)


def arm_rows(a, t, strain_source=None, rotation_source=None):
    """Rows that give arm strains [6] and arm rotations from the 10 displacements.

    eps_k = t_k . (u_k - u_0)/a_k  (paper [6]),  theta_k = n_k . (u_k - u_0)/a_k.

    Parameters
    ----------
    a : float (n, 4)
        Arm lengths; 0 for a missing arm.
    t : float (n, 4, 2)
        Unit vectors from the hinge to the arm ends.
    strain_source, rotation_source : int (n, 4), optional
        Arm whose strain (rotation) an arm takes: its own number normally, the opposite arm's for
        an arm that has none of its own, HELD for none at all.

    Returns
    -------
    strain, rotation : float (n, 4, 10)
    """
    n = len(a)
    present = a > 0
    inverse = np.where(present, 1.0 / np.where(present, a, 1.0), 0.0)
    rows = []
    for direction, source in ((t, strain_source), (normals(t), rotation_source)):
        row = np.zeros((n, 4, 10))
        for k in range(4):
            row[:, k, 2 * k : 2 * k + 2] = inverse[:, k, None] * direction[:, k]
            row[:, k, 8:] = -inverse[:, k, None] * direction[:, k]
        if source is not None:
            taken = np.take_along_axis(row, np.maximum(source, 0)[..., None], axis=1)
            row = np.asarray(np.where((source == HELD)[..., None], 0.0, taken))
        rows.append(row)
    return rows[0], rows[1]


def with_rotations(stiffness: np.ndarray) -> np.ndarray:
    """Matrices on the 10 displacements as matrices on the 16 unknowns."""
    wide = np.zeros((len(stiffness), 16, 16))
    wide[np.ix_(np.arange(len(stiffness)), DISPLACEMENTS, DISPLACEMENTS)] = stiffness
    return wide


def condense(stiffness: np.ndarray, keep: int) -> tuple[np.ndarray, np.ndarray]:
    """Eliminate the unknowns behind the first ``keep`` (paper [9]-[15] for the hinge).

    Free directions of the eliminated unknowns (a matrix of one mode alone may leave the hinge free)
    are given the value of smallest norm.

    Returns
    -------
    condensed : float (n, keep, keep), symmetric
    recovery : float (n, m - keep, keep)
        Eliminated unknowns from the kept ones (without loads on them).
    """
    corner = stiffness[:, keep:, keep:]
    side = stiffness[:, keep:, :keep]
    recovery = -np.linalg.pinv(corner, rcond=1e-13, hermitian=True) @ side
    condensed = stiffness[:, :keep, :keep] + np.swapaxes(side, 1, 2) @ recovery
    return 0.5 * (condensed + np.swapaxes(condensed, 1, 2)), recovery


def net_angle(displacement: np.ndarray, gauge: float) -> np.ndarray:
    """Shear angle in the middle of a strip of an inextensible net, rad; NaN beyond its reach.

    90deg - 2 arccos((L0 + d)/(sqrt(2) L0)), Cao et al. 2008, Composites A 39:1037, eq. 12, for a
    strip of length H >= 2 W and width W cut at 45 degrees, gripped at both ends.

    Parameters
    ----------
    displacement : float (n,)
        Of one clamp from the other, d, m.
    gauge : float
        L0 = H - W, m.
    """
    cosine = (gauge + np.asarray(displacement, float)) / (np.sqrt(2.0) * gauge)
    return 0.5 * np.pi - 2.0 * np.arccos(np.where(cosine <= 1.0, cosine, np.nan))


def net_reach(gauge: float) -> float:
    """Displacement (m) at which the yarns of such a strip lie along the pull."""
    return float((np.sqrt(2.0) - 1.0) * gauge)
