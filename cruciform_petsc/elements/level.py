# SPDX-License-Identifier: MIT
"""What the kernels of finite deformation share: how much to work out, and room for it."""

from __future__ import annotations

import numpy as np

ENERGY, FORCE, STIFFNESS = 0, 1, 2  # how much a kernel works out

# Liberties of the compiler that keep NaN and infinity what they are: what is no state must show.
FREE = {"contract", "reassoc", "nsz", "arcp"}


def room(n: int, parts: int, points: int, dim: int, level: int):
    """Arrays for energy, force and stiffness; those that are not worked out have no rows."""
    forces = n if level >= FORCE else 0
    matrices = n if level >= STIFFNESS else 0
    return (
        np.empty((n, parts)),
        np.empty((forces, points, dim)),
        np.empty((matrices, points, dim, points, dim)),
    )
