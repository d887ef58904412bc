# SPDX-License-Identifier: MIT
"""What an inextensible net does in a bias-extension test, and the load it takes.

Cao et al. 2008, Composites A 39:1037, eqs. 12-18. For a strip of length H >= 2 W and width W cut at
45 degrees (shorter ones are locked: yarns of both clamps cross), with L0 = H - W and the clamps
moved apart by d:

    g = 90deg - 2 arccos((L0 + d)/(sqrt(2) L0))       shear in the middle, half of it beside
    (2 H - 3 W) C(g) = (H/W - 1) F (cos g/2 - sin g/2) - W C(g/2)

C, a torque per area, is psi' of docs/laws.md, and C(g)/cos(g) the normalised shear force, per
length: with the zones' areas, W (2 H - 3 W)/2 in the middle and W^2 beside, work is F dd =
W (2 H - 3 W)/2 C(g) dg + W^2 C(g/2) dg/2, and dd = L0/2 (cos g/2 - sin g/2) dg.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np


def net_angle(displacement: np.ndarray, gauge: float) -> np.ndarray:
    """Shear angle in the middle of a strip of an inextensible net, rad; NaN beyond its reach.

    Eq. 12, for displacements d (n,) of one clamp from the other and the gauge length L0 = H - W, m.
    """
    cosine = (gauge + np.asarray(displacement, float)) / (np.sqrt(2.0) * gauge)
    return 0.5 * np.pi - 2.0 * np.arccos(np.where(cosine <= 1.0, cosine, np.nan))


def net_reach(gauge: float) -> float:
    """Displacement (m) at which the yarns of such a strip lie along the pull."""
    return float((np.sqrt(2.0) - 1.0) * gauge)


def net_load(
    angle: np.ndarray, torque: Callable[[np.ndarray], np.ndarray], width: float, length: float
) -> np.ndarray:
    """Load F, N, of such a strip, m, at angles g (n,), rad, of cloth with a torque C(g), N/m."""
    half = 0.5 * np.asarray(angle, float)
    inside = (2.0 * length - 3.0 * width) * torque(2.0 * half) + width * torque(half)
    return inside / ((length / width - 1.0) * (np.cos(half) - np.sin(half)))


def net_torque(angle: np.ndarray, force: np.ndarray, width: float, length: float) -> np.ndarray:
    """C(g), N/m, from loads (n,), N, of such a strip, m, at angles g (n,), rad: `net_load` undone.

    C(g/2) comes from the points before, straight lines between them. NaN at angles that are none
    (NaN) or no larger than one before, where a test goes back.
    """
    known, torque, count = np.zeros(len(angle) + 1), np.zeros(len(angle) + 1), 1
    found = np.full(len(angle), np.nan)
    for i, (g, load) in enumerate(zip(angle, force, strict=True)):
        last = known[count - 1]
        if not g > last:
            continue
        half = 0.5 * g
        share = max(0.0, (half - last) / (g - last))  # of C(g) in C(g/2)
        before = np.interp(half, known[:count], torque[:count]) * (1.0 - share)
        right = (length / width - 1.0) * load * (np.cos(half) - np.sin(half))
        found[i] = (right - width * before) / (2.0 * length - 3.0 * width + width * share)
        known[count], torque[count], count = g, found[i], count + 1
    return found
