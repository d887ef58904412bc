# SPDX-License-Identifier: MIT
"""Shear law from a bias test in closed form, by the kinematics of an inextensible net.

Cao et al. 2008, Composites A 39:1037, eqs. 12-18. For a strip of length H >= 2 W and width W cut at
45 degrees (shorter ones are locked: yarns of both clamps cross), with L0 = H - W and the clamps
moved apart by d:

    g = 90deg - 2 arccos((L0 + d)/(sqrt(2) L0))       shear in the middle, half of it beside
    (2 H - 3 W) C(g) = (H/W - 1) F (cos g/2 - sin g/2) - W C(g/2)

C, a torque per area, is psi' of docs/laws.md: with the zones' areas, W (2 H - 3 W)/2 in the middle
and W^2 beside, work is F dd = W (2 H - 3 W)/2 C(g) dg + W^2 C(g/2) dg/2, and dd = L0/2 (cos g/2 -
sin g/2) dg.

A picture frame with sides a and b along the yarns, its longer diagonal D pulled by the force F,
shears all of the cloth by the angle g of the frame: D^2 = a^2 + b^2 + 2 a b sin g, work is F dD =
a b C(g) dg, hence C = F cos(g)/D; for a square of side L that is F sin(theta)/L, 2 theta = 90deg -
g being the angle of the frame.
"""

from __future__ import annotations

import numpy as np

from ..experiments.net_kinematics import net_angle

# Where the net is all but stretched out, a little yarn strain is much shear: g there is made up.
LARGEST_ANGLE = np.deg2rad(75.0)


def torque_from_loads(
    displacement: np.ndarray, force: np.ndarray, width: float, length: float
) -> tuple[np.ndarray, np.ndarray]:
    """Angles g, rad, and C(g), N/m, at the measured points that the net's kinematics reach.

    C(g/2) comes from the points before, straight lines between them; these are neither smoothed nor
    made to rise, and are the law only as far as the kinematics hold, some 30 to 35 degrees.

    Parameters
    ----------
    displacement, force : float (n,)
        Ascending from above zero.
    width, length : float
        Of the whole specimen, m; length >= 2 width.
    """
    g = net_angle(displacement, length - width)
    reached = g <= LARGEST_ANGLE  # NaN is not
    g, force = g[reached], np.asarray(force, float)[reached]
    half, known = 0.5 * g, np.append(0.0, g)
    # Of C(g/2) by the values C(g).
    between = [np.interp(half, known, one) for one in np.eye(len(known))[1:]]
    matrix = (2.0 * length - 3.0 * width) * np.eye(len(g))
    matrix += width * np.reshape(between, matrix.shape).T
    right = (length / width - 1.0) * force * (np.cos(half) - np.sin(half))
    return g, np.linalg.solve(matrix, right)


def frame_angle(displacement: np.ndarray | float, sides: tuple[float, float]) -> np.ndarray:
    """Shear angle of a picture frame, rad; NaN from where it is closed.

    ``displacement`` is the growth of the longer diagonal, ``sides`` are between the hinges, m.
    """
    a, b = sides
    diagonal = np.hypot(a, b) + np.asarray(displacement, float)
    sine = (diagonal**2 - a * a - b * b) / (2.0 * a * b)
    return np.arcsin(np.where(sine < 1.0, sine, np.nan))


def torque_from_frame(
    displacement: np.ndarray, force: np.ndarray, sides: tuple[float, float]
) -> tuple[np.ndarray, np.ndarray]:
    """Angles g, rad, and C(g), N/m, of a frame full of cloth; see frame_angle."""
    g = frame_angle(displacement, sides)
    diagonal = np.hypot(*sides) + np.asarray(displacement, float)
    return g, np.asarray(force, float) * np.cos(g) / diagonal
