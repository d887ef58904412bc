# SPDX-License-Identifier: MIT
"""Shear law from a bias test or a picture frame in closed form.

Of a bias test by the kinematics of an inextensible net, see experiments.net_kinematics.

A picture frame with sides a and b along the yarns, its longer diagonal D pulled by the force F,
shears all of the cloth by the angle g of the frame: D^2 = a^2 + b^2 + 2 a b sin g, work is F dD =
a b C(g) dg, hence C = F cos(g)/D; for a square of side L that is F sin(theta)/L, 2 theta = 90deg -
g being the angle of the frame.
"""

from __future__ import annotations

import numpy as np

from ..experiments.net_kinematics import net_angle, net_torque

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
    return g, net_torque(g, force, width, length)


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
