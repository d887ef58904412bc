# SPDX-License-Identifier: MIT
"""Names of places on yarns that do not depend on the ranks."""

from __future__ import annotations

import numpy as np

# Where arms 1 to 4 of a crossover end, in quarters of a pitch from it: shared ends, and tails. The
# crossovers, or hinges, are at multiples of 4: the last two bits of a key tell these three apart.
BETWEEN, TAIL = np.array([2, 2, -2, -2]), np.array([1, 1, -1, -1])


def pack_key(family: int, line, place):
    """Key of a place on a yarn, int64: sorts by family, then yarn, then along the yarn.

    Bit 62 is the family, then come 30 bits of the yarn's number and 32 of the place, in quarters of
    a pitch: places are added to keys.
    """
    return (np.int64(family) << 62) + ((line + 2**29) << 32) + (place + 2**31)


def pair_key(line: np.ndarray, position: np.ndarray) -> np.ndarray:
    """Key of a crossover position on a yarn: sorts by yarn, then along it."""
    return (np.asarray(line, np.int64) << 32) + (np.asarray(position, np.int64) + 2**31)
