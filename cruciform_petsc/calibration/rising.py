# SPDX-License-Identifier: MIT
"""Tables psi'(gamma) that rise and keep within bounds, as functions of parameters in a box."""

from __future__ import annotations

from typing import Any

import numpy as np

from ..errors import InputError
from ..laws import Potential, table

# Angles of the table, degrees: close where friction makes the first rise, then six degrees apart.
LADDER = (2.0, 4.0, 7.0, 11.0, 16.0, 22.0, *np.arange(28.0, 89.0, 6.0))
# A first point as much below the ladder has a knot of its own; such knots are APART.
CLOSE, APART = 1.25, 2.0
# A law may not fall, and must rise at least by this part of its mean slope, for a stable cloth.
LEAST_SLOPE = 0.02

Bounds = tuple[Potential | None, Potential | None]


class RisingTable:
    """Values v_k of psi' at given angles from parameters z_k in a box, and back.

    Each value lies above the one before by at least d_k, and between the bounds l_k and u_k:

        f_k = max(v_(k-1) + d_k, l_k)                          the least that v_k can be
        c_k = min over j >= k of (u_j - d_(k+1) - ... - d_j)   the most
        v_k = f_k + s_k z_k (1 - (f_k - f0_k)/(c_k - f0_k)),   0 <= z_k <= (c_k - f0_k)/s_k

    with f0 that of the start, and s the size of its rises. Without an upper bound the v_k are plain
    sums of rises. InputError if no rising table lies within the bounds.

    Attributes
    ----------
    angles : float (m,)
        Ascending from above zero, rad.
    start, box : float (m,), (2, m)
        Parameters of the table that follows the law to start from; least and largest ones.
    bends : float (m - 2, m)
        Second differences over ln(angle) at the inner angles, times the mean step.
    """

    def __init__(self, angles: np.ndarray, first: Potential, bounds: Bounds = (None, None)):
        self.angles = angles
        wanted = np.maximum.accumulate(first.evaluate(angles)[1])
        even = wanted[-1] * np.diff(angles, prepend=0.0) / angles[-1]
        self._least = LEAST_SLOPE * even
        rises = np.maximum(np.diff(wanted, prepend=0.0), 2.0 * self._least)
        self._scale = np.maximum(rises, 0.2 * even)
        low, high = (
            np.full(len(angles), none) if law is None else law.evaluate(angles)[1]
            for law, none in zip(bounds, (-np.inf, np.inf), strict=True)
        )
        total = np.cumsum(self._least)
        most = np.minimum.accumulate((high - total)[::-1])[::-1] + total
        if (np.maximum.accumulate(np.maximum(low - total, 0.0)) + total > most).any():
            raise InputError(
                "no rising law lies within the bounds: the lower must be below the upper"
            )
        self._low, self._floor, before = low, np.zeros(len(angles)), 0.0
        values = np.cumsum(rises)
        for k in range(len(angles)):
            self._floor[k] = max(before + self._least[k], low[k])
            # Not onto the upper bound, which would leave no room for what follows.
            last = 0.9 * most[k] + 0.1 * self._floor[k]
            before = values[k] = np.clip(values[k], self._floor[k], last)
        self._room = np.maximum(most - self._floor, 1e-300)
        self.start = (values - self._floor) / self._scale
        self.box = np.array([np.zeros(len(angles)), self._room / self._scale])
        step = np.diff(np.log(angles))[:, None]
        slopes = np.diff(np.eye(len(angles)), axis=0) / step
        self.bends = np.diff(slopes, axis=0) * 0.5 * (step[1:] + step[:-1])

    def values(self, z: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """The table's values, (m,) N/m, and their derivatives by z, (m, m)."""
        values, slopes = np.zeros(len(z)), np.zeros((len(z), len(z)))
        before, slope = 0.0, np.zeros(len(z))
        for k, scale in enumerate(self._scale):
            floor = before + self._least[k]
            if floor < self._low[k]:
                floor, slope = self._low[k], np.zeros(len(z))
            share = 1.0 - (floor - self._floor[k]) / self._room[k]
            before = values[k] = floor + scale * z[k] * share
            slope = slope * (1.0 - scale * z[k] / self._room[k])
            slope[k] = scale * share
            slopes[k] = slope
        return values, slopes


def rising_law(angles: np.ndarray, torque: np.ndarray) -> Potential:
    """Law through points of a formula, made to rise; rad and N/m."""
    torque = np.maximum.accumulate(np.maximum(torque, 0.0))
    return table(angles, torque + LEAST_SLOPE * torque[-1] * angles / angles[-1])


def value_changes(angles: np.ndarray, values: np.ndarray, at: np.ndarray) -> np.ndarray:
    """Derivatives of psi' at shear angles (k,) by the values of a table (m,); (m, k)."""
    result = []
    rises = np.diff(values, prepend=0.0)
    for k, one in enumerate(np.eye(len(values))):
        # PCHIP's slopes are smooth in the values where these rise.
        h = 1e-5 * rises[k : k + 2].min()
        up, down = (table(angles, values + s * h * one).evaluate(at)[1] for s in (1, -1))
        result.append((up - down) / (2.0 * h))
    return np.array(result)


def table_angles(angles: Any, reached: np.ndarray) -> np.ndarray:
    """Check the angles given for a table; or make a ladder for the angles reached (n,), rad.

    It begins where the data do: between zero and its first knot a table is a curve of its own.
    """
    if angles is None:
        degrees = np.rad2deg(np.sort(reached))
        last = max(np.ceil(degrees[-1] - 1e-6), 1.0)
        inner = [rung for rung in LADDER if rung <= last - 2.0]
        ladder = [*inner, last] if inner else list(last * np.array([0.25, 0.5, 1.0]))
        first: list[float] = []
        for angle in degrees[degrees < ladder[0] / CLOSE]:
            if not first or angle > APART * first[-1]:
                first.append(float(angle))
        return np.minimum(np.deg2rad([*first, *ladder]), np.deg2rad(89.0))
    result = np.array(angles, float)
    good = result.ndim == 1 and len(result) >= 2
    # NaN is not.
    if not (good and (np.diff(result, prepend=0.0, append=0.5 * np.pi) > 0.0).all()):
        raise InputError(
            "angles must be two or more, ascending from above zero to less than 90 degrees"
        )
    return result
