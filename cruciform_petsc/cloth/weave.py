# SPDX-License-Identifier: MIT
"""Weaves by name: which yarn is above where a warp and a weft cross.

The net knows no weave; pictures of yarns in space and the estimate of crimp do.
"""

from __future__ import annotations

import math
import re
from dataclasses import dataclass

import numpy as np

from ..errors import InputError, shown

_MOST = 32  # harnesses of a loom, about
KNOWN = 'write "plain", "twill 2/2" (over 2, under 2) or "satin 5" (5 harnesses)'


@dataclass(frozen=True, eq=False)
class Weave:
    """A repeat of n warps and n wefts.

    Attributes
    ----------
    warp_above : bool (n, n)
        By warp and weft, both modulo n: whether the warp is above.
    """

    warp_above: np.ndarray

    @classmethod
    def named(cls, name: str) -> Weave:
        """Make one of "plain", "twill m/n", "satin n"; InputError for any other name.

        A twill's warps pass over m and under n wefts, each one weft later than its neighbour. A
        satin's warps pass under one weft of n, which moves by the smallest step that leaves no two
        of them side by side; 4 harnesses are the broken twill (crowfoot), with 6 there is none
        (Grosicki 1975, Watson's Textile Design and Colour).

        >>> Weave.named("twill 2/1").warp_above.astype(int)
        array([[1, 1, 0],
               [0, 1, 1],
               [1, 0, 1]])
        """
        twill = re.fullmatch(r"twill (\d{1,2})/(\d{1,2})", name)
        satin = re.fullmatch(r"satin (\d{1,2})", name)
        over, under = map(int, twill.groups()) if twill else (1, 1)
        n = int(satin[1]) if satin else over + under
        if not (twill or satin or name == "plain") or min(over, under) < 1:
            raise InputError(f"must be a weave, {KNOWN}, got {shown(name)}")
        if n > _MOST:
            raise InputError(f"has a repeat of {n} yarns, at most {_MOST} are possible")
        warp, weft = np.indices((n, n))
        if not satin:
            return cls((weft - warp) % n < over)
        steps = [s for s in range(2, n - 1) if math.gcd(s, n) == 1]
        if not steps and n != 4:
            raise InputError(
                f'= "{name}" is no regular satin: 4, 5 and all from 7 harnesses up are possible'
            )
        below = np.array([0, 1, 3, 2]) if n == 4 else steps[0] * np.arange(n) % n
        return cls(weft != below[warp])

    @property
    def float_length(self) -> float:
        """Crossings for each change of a yarn from one side to the other: 1 plain, n/2 satin."""
        changes = self.warp_above != np.roll(self.warp_above, 1, axis=1)
        return self.warp_above.size / changes.sum()

    def heights(self, family: int, line: int, along: np.ndarray) -> np.ndarray:
        """Waves of a yarn's middle line, from -1 below to 1 above, float (k,).

        ``line`` is the yarn's number, ``along`` float (k,) runs along it and is whole where yarns
        of the other ``family`` cross (0 warp, 1 weft). Half a cosine joins two crossings of which
        one is above, a straight line two of a float.
        """
        above = self.warp_above if family == 0 else ~self.warp_above.T
        n, before = len(above), np.floor(along).astype(int)
        low, high = (np.where(above[line % n, at % n], 1.0, -1.0) for at in (before, before + 1))
        return low + 0.5 * (high - low) * (1.0 - np.cos(np.pi * (along - before)))
