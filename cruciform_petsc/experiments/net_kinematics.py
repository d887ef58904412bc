# SPDX-License-Identifier: MIT
"""What an inextensible net does in a bias-extension test."""

from __future__ import annotations

import numpy as np


def net_angle(displacement: np.ndarray, gauge: float) -> np.ndarray:
    """Shear angle in the middle of a strip of an inextensible net, rad; NaN beyond its reach.

    90deg - 2 arccos((L0 + d)/(sqrt(2) L0)), Cao et al. 2008, Composites A 39:1037, eq. 12, for a
    strip of length H >= 2 W and width W cut at 45 degrees, gripped at both ends: displacement d
    (n,) of one clamp from the other, gauge length L0 = H - W, m.
    """
    cosine = (gauge + np.asarray(displacement, float)) / (np.sqrt(2.0) * gauge)
    return 0.5 * np.pi - 2.0 * np.arccos(np.where(cosine <= 1.0, cosine, np.nan))


def net_reach(gauge: float) -> float:
    """Displacement (m) at which the yarns of such a strip lie along the pull."""
    return float((np.sqrt(2.0) - 1.0) * gauge)
