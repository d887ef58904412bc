# SPDX-License-Identifier: MIT
"""How far to go along a step that leads downhill."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np


def step_length(
    at: Callable[[float], tuple[float, float]],
    energy: float,
    slope: float,
    first: float = 1.0,
    noise: float = 0.0,
    highest: float | None = None,
) -> float:
    """A length at which the energy has fallen, or is as low and flatter than at the start.

    Parameters
    ----------
    at : callable
        length -> energy there, and by how much it falls there per length.
    energy, slope : float
        The same at length 0.
    first : float
        Tried first.
    noise : float
        Energies that differ by less are the same.
    highest : float, optional
        What the energy need but stay below (Grippo, Lampariello and Lucidi 1986): tensions foretold
        run ahead of it while stiff yarns turn. Without it a tenth of the fall foreseen is asked
        for, and that it does not rise as steeply there; else contact and friction that switch may
        go to and fro between two states for ever.
    """
    length = first
    for _ in range(25):
        there, along = at(length)
        if np.isfinite(there):
            if highest is not None:
                low = there <= highest - 1e-4 * length * slope
            else:
                low = there <= energy - 0.1 * length * slope and -along <= 0.9 * slope
            if low or (there <= energy + noise and abs(along) <= 0.9 * slope):
                break
            # Minimum of the cubic with the values and slopes at both ends (Nocedal and Wright
            # 2006, Numerical Optimization, eq. 3.59).
            d1 = -slope - along - 3.0 * (energy - there) / -length
            root = d1 * d1 - slope * along
            root = np.sqrt(root) if root > 0.0 else 0.0
            better = length - length * (-along + root - d1) / (-along + slope + 2.0 * root)
            if not np.isfinite(better):
                better = 0.3 * length
            length = float(np.clip(better, 0.1 * length, 0.6 * length))
        else:
            length *= 0.2
    return length
