# SPDX-License-Identifier: MIT
"""Which rank owns which crossovers: recursive bisection of the lattice."""

from __future__ import annotations

import numpy as np

from .lattice import YarnLines, whole_numbers


class Partition:
    """Recursive bisection of the lattice into one box per rank, balanced by crossovers.

    Not collective: it follows from the outline alone, so every rank computes the same boxes and
    can tell the owner of any crossover without asking.
    """

    def __init__(self, yarns: YarnLines, size: int):
        low = np.array([yarns.first.min(), yarns.line.min()])
        high = np.array([yarns.last.max(), yarns.line.max()]) + 1
        self.box = np.empty((size, 2, 2), np.int64)
        # Of ranks first to stop - 1: those below ``middle`` get positions below ``at`` on an axis.
        self._cuts: dict[tuple[int, int], tuple[int, int, int]] = {}
        self._split(yarns, low, high, 0, size)

    def _split(self, yarns: YarnLines, low, high, first: int, stop: int) -> None:
        if stop - first == 1:
            self.box[first] = low, high
            return
        middle = first + (stop - first) // 2
        share = (middle - first) / (stop - first)
        begin = np.maximum(yarns.first, low[0])
        end = np.minimum(yarns.last + 1, high[0])
        keep = (yarns.line >= low[1]) & (yarns.line < high[1]) & (end > begin)
        begin, end, line = begin[keep], end[keep], yarns.line[keep] - low[1]
        width, height = high - low
        starts, ends = (np.bincount(x - low[0], minlength=width + 1) for x in (begin, end))
        counts = [
            np.cumsum(starts - ends)[:-1],
            np.bincount(line, weights=end - begin, minlength=height),
        ]
        choices = []
        for axis in (1, 0):
            total = np.concatenate([[0], np.cumsum(counts[axis])])
            at = int(np.argmin(np.abs(total - share * total[-1])))
            # The yarns cut are about as many as crossovers stand in the row beside the cut.
            cost = counts[axis][min(at, len(counts[axis]) - 1)] if len(counts[axis]) else 0
            off = abs(total[at] - share * total[-1])
            choices.append((off + cost, axis, at + int(low[axis])))
        _, axis, at = min(choices, key=lambda choice: choice[0])
        self._cuts[first, stop] = axis, at, middle
        left_high, right_low = high.copy(), low.copy()
        left_high[axis] = right_low[axis] = at
        self._split(yarns, low, left_high, first, middle)
        self._split(yarns, right_low, high, middle, stop)

    def in_box(self, ij: np.ndarray, rank: int) -> np.ndarray:
        """Whether lattice points (..., 2) lie in the box of a rank."""
        low, high = self.box[rank]
        return ((ij >= low) & (ij < high)).all(axis=-1)

    def owner(self, ij: np.ndarray) -> np.ndarray:
        """Rank of each lattice point (n, 2), the nearest box's outside all; int32 (n,)."""
        owner = np.zeros(len(ij), np.int32)
        todo = [(0, len(self.box), np.arange(len(ij)))]
        while todo:
            first, stop, rows = todo.pop()
            if stop - first == 1 or len(rows) == 0:
                owner[rows] = first
                continue
            axis, at, middle = self._cuts[first, stop]
            left = ij[rows, axis] < at
            todo.append((first, middle, rows[left]))
            todo.append((middle, stop, rows[~left]))
        return owner

    def crossovers(self, yarns: YarnLines, rank: int) -> np.ndarray:
        """Lattice positions (n, 2) of a rank's crossovers, along each warp yarn in turn."""
        low, high = self.box[rank]
        begin = np.maximum(yarns.first, low[0])
        count = np.minimum(yarns.last + 1, high[0]) - begin
        count[(yarns.line < low[1]) | (yarns.line >= high[1])] = 0
        part, i = whole_numbers(begin, count)
        return np.stack([i, yarns.line[part]], axis=1)
