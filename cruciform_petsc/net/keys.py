# SPDX-License-Identifier: MIT
"""Names of places on yarns that do not depend on the ranks."""

from __future__ import annotations

import numpy as np

# Places on a yarn, in quarters of a pitch, counted from its crossovers: see Network.node_key.
HINGE, TAIL_AFTER, BETWEEN, TAIL_BEFORE = 0, 1, 2, -1


def pack_key(family: int, line: np.ndarray, place: np.ndarray) -> np.ndarray:
    """Key of a place on a yarn: sorts by family, then yarn, then along the yarn."""
    return (np.int64(family) << 62) + ((line + 2**29) << 32) + (place + 2**31)


def pair_key(line: np.ndarray, position: np.ndarray) -> np.ndarray:
    """Key of a crossover position on a yarn: sorts by yarn, then along it."""
    return (np.asarray(line, np.int64) << 32) + (np.asarray(position, np.int64) + 2**31)
