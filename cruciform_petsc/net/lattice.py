# SPDX-License-Identifier: MIT
"""Where the yarns of a lattice meet an outline: plain geometry, no ranks.

Everything here is in *lattice coordinates*: crossover (i, j) lies at (i, j), warp yarn j runs
along the first coordinate, weft yarn i along the second. The outline is a polygon with holes,
given by its boundary segments. Memory and time grow with the length of the outline, not with its
area: each rank can afford to know all of it.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import shapely

# Points this close to a lattice line, in pitches, lie on it: rounding of the outline's coordinates.
SNAP = 1e-6
# A shorter arm, in pitches, is left out and its crossover counts as lying on the outline: stiffness
# goes with 1/length, and 1 % of a pitch is far below what the discrete model resolves.
SHORTEST_ARM = 1e-2

# Arms in the order of the paper's figure 3: 1 and 3 along the warp, 2 and 4 along the weft.
ARM_STEP = np.array([[1, 0], [0, 1], [-1, 0], [0, -1]])
OPPOSITE = np.array([2, 3, 0, 1])
HELD = -1  # source of a missing arm at a clamp: no strain, no rotation
# Quadrants as (warp arm, weft arm), counted from zero, anticlockwise from the first.
QUADRANTS = np.array([[0, 1], [2, 1], [2, 3], [0, 3]])

# Where arms 1 to 4 of a crossover end, in quarters of a pitch from it: shared ends, and tails. The
# crossovers, or hinges, are at multiples of 4: the last two bits of a key tell these three apart.
BETWEEN, TAIL = np.array([2, 2, -2, -2]), np.array([1, 1, -1, -1])
PART_BIT = 56  # of a key: where the number of a set of nodes among others begins, see pack_key


def pack_key(family: int, line, place):
    """Key of a place on a yarn, int64: sorts by family, then yarn, then along the yarn.

    Bit 62 is the family, then come 6 bits for the number of a set of nodes among others
    (net.joined), 24 of the yarn's number and 32 of the place, in quarters of a pitch: places are
    added to keys.
    """
    return (np.int64(family) << 62) + ((line + 2**23) << 32) + (place + 2**31)


def pair_key(line: np.ndarray, position: np.ndarray) -> np.ndarray:
    """Key of a crossover position on a yarn: sorts by yarn, then along it."""
    return (np.asarray(line, np.int64) << 32) + (np.asarray(position, np.int64) + 2**31)


def snapped(coordinates: np.ndarray) -> np.ndarray:
    """Move coordinates that are within SNAP of a lattice line onto it."""
    nearest = np.round(coordinates)
    return np.where(np.abs(coordinates - nearest) < SNAP, nearest, coordinates)


def boundary_segments(outline: shapely.Polygon) -> np.ndarray:
    """All boundary segments of a polygon with holes, shape (n, 2, 2)."""
    rings = [outline.exterior, *outline.interiors]
    points = [np.asarray(ring.coords)[:, :2] for ring in rings]
    return np.concatenate([np.stack([p[:-1], p[1:]], axis=1) for p in points])


@dataclass
class YarnLines:
    """Parts of the yarns of one family that lie inside the outline, by yarn and along it."""

    line: np.ndarray  # int64 (n,), number of the yarn
    start: np.ndarray  # float (n,), where the part begins along the yarn
    end: np.ndarray
    first: np.ndarray  # int64 (n,), first and last crossover on it; first > last for none
    last: np.ndarray

    def find(self, line: np.ndarray, position: np.ndarray) -> np.ndarray:
        """Index of the part that holds a crossover position, or -1; shape as given."""
        if len(self.line) == 0:
            return np.full(np.shape(line), -1)
        key = pair_key(self.line, self.first)
        index = np.searchsorted(key, pair_key(line, position), side="right") - 1
        at = np.maximum(index, 0)
        good = (index >= 0) & (self.line[at] == line) & (self.last[at] >= position)
        return np.where(good, at, -1)


def whole_numbers(first: np.ndarray, count: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """For each k the numbers first[k], first[k] + 1 ..., count[k] of them: all k, and all numbers.

    Both int64 (n,); no numbers where the count is not positive.
    """
    count = np.maximum(count, 0).astype(np.int64)
    k = np.repeat(np.arange(len(count)), count)
    return k, np.arange(len(k)) - (np.cumsum(count) - count)[k] + first[k].astype(np.int64)


def yarn_lines(segments: np.ndarray, family: int) -> YarnLines:
    """Cut all yarns of a family with the outline.

    A yarn that runs along an edge counts as inside, and so does one that touches a corner: each is
    the union of what lines infinitely close on either side of it keep.

    ``segments`` (n, 2, 2) bound the outline, in lattice coordinates, already snapped; ``family`` is
    0 for the warp yarns (second coordinate constant), 1 for the weft yarns.
    """
    along, across = segments[..., family], segments[..., 1 - family]
    low, high = across.min(axis=1), across.max(axis=1)
    sides = []
    for from_above in (True, False):
        # Half-open ranges: a corner is counted with exactly one of its two segments.
        begin = np.ceil(low) if from_above else np.floor(low) + 1
        stop = np.ceil(high) if from_above else np.floor(high) + 1
        seg, line = whole_numbers(begin, np.where(high > low, stop - begin, 0))
        share = (line - across[seg, 0]) / (across[seg, 1] - across[seg, 0])
        where = snapped(along[seg, 0] + share * (along[seg, 1] - along[seg, 0]))
        order = np.lexsort((where, line))
        line, where = line[order], where[order]
        sides.append((line[::2], where[::2], where[1::2]))
    line, start, end = (np.concatenate(part) for part in zip(*sides, strict=True))
    line, start, end = union_of_intervals(line, start, end)
    # Both ends are snapped: a second tolerance here would let one family see crossovers that the
    # other does not.
    first = np.ceil(start).astype(np.int64)
    last = np.floor(end).astype(np.int64)
    return YarnLines(line, start, end, first, last)


def union_of_intervals(line, start, end):
    """Merge overlapping intervals on each line; returns them sorted by line and start."""
    if len(line) == 0:
        return line, start, end
    order = np.lexsort((start, line))
    line, start, end = line[order], start[order], end[order]
    # Running maximum of the ends within each line, exact because it runs over ranks, not values.
    values, rank = np.unique(end, return_inverse=True)
    lift = (line - line[0]) * len(values)
    reach = np.maximum.accumulate(rank + lift)
    reach_value = values[np.clip(reach - lift, 0, len(values) - 1)]
    new = np.ones(len(line), bool)
    new[1:] = (line[1:] != line[:-1]) | (start[1:] > reach_value[:-1])
    begin = np.flatnonzero(new)
    last = np.append(begin[1:], len(line)) - 1
    return line[begin], start[begin], reach_value[last]


def cells_cut(segments: np.ndarray) -> np.ndarray:
    """Lattice cells (squares of side 1 around the crossovers) that the outline passes through.

    Of a piece that runs along the border of two cells one of them is found, neither at a corner
    where it only touches them: those left out are beside one that is found. Returns int64 (n, 2),
    unique (i, j).
    """
    n = len(segments)
    begin, delta = segments[:, 0], segments[:, 1] - segments[:, 0]
    # Parameters at which each segment begins, ends, and crosses the cells' borders k + 1/2.
    owner, share = [np.tile(np.arange(n), 2)], [np.repeat([0.0, 1.0], n)]
    for axis in (0, 1):
        ends = segments[:, :, axis] - 0.5
        first, last = np.ceil(ends.min(axis=1)), np.floor(ends.max(axis=1))
        seg, k = whole_numbers(first, np.where(delta[:, axis] != 0, last - first + 1, 0))
        owner.append(seg)
        share.append((k + 0.5 - begin[seg, axis]) / delta[seg, axis])
    seg, t = np.concatenate(owner), np.clip(np.concatenate(share), 0, 1)
    order = np.lexsort((t, seg))
    seg, t = seg[order], t[order]
    middle = 0.5 * (t[1:] + t[:-1])[seg[1:] == seg[:-1]]
    seg = seg[1:][seg[1:] == seg[:-1]]
    return np.unique(
        np.floor(begin[seg] + middle[:, None] * delta[seg] + 0.5).astype(np.int64), axis=0
    )


def areas_within(outline: shapely.Geometry, boxes: np.ndarray) -> np.ndarray:
    """Areas of an outline within many small boxes, float (n,).

    Each box would look at every corner of the outline: it is cut in halves first, each with the
    boxes there, until pieces have few corners.
    """
    if len(boxes) < 16 or shapely.get_num_coordinates(outline) < 64:
        return shapely.area(shapely.intersection(outline, boxes))
    bounds = shapely.bounds(boxes)
    area, axis = np.zeros(len(boxes)), int(np.ptp(bounds[:, :2], axis=0).argmax())
    for rows in np.array_split(np.argsort(bounds[:, axis], kind="stable"), 2):
        part = shapely.intersection(outline, shapely.box(*shapely.total_bounds(boxes[rows])))
        parts = shapely.get_parts(part)
        polygons = parts[shapely.get_dimensions(parts) == 2]
        area[rows] = areas_within(shapely.multipolygons(polygons), boxes[rows])
    return area


def quadrant_areas(ij, present, outline: shapely.Polygon) -> np.ndarray:
    """Area inside the outline that each quadrant of the given crossovers stands for.

    A quadrant is the quarter of the lattice cell between two arms, cut by the outline. Quarters of
    cells that lie inside the outline while their crossover lies outside go to the neighbours across
    the quarter's two borders (half each if both exist), else to the one across its corner: every
    bit of the outline is then carried by the nearest arms (mechanics: tails of yarns).

    ``ij`` (n, 2) are crossovers near the outline, present(ij) (..., 2) -> bool (...) tells which
    lattice points are crossovers, ``outline`` is in lattice coordinates. Returns float (n, 4), in
    squared pitches, order of QUADRANTS.
    """
    area = np.zeros((len(ij), 4))
    if len(ij) == 0:
        return area
    taken = []  # (row and quadrant, weight, lower left corner of a quarter in half pitches)
    for q, (warp_arm, weft_arm) in enumerate(QUADRANTS):
        warp, weft = ARM_STEP[warp_arm], ARM_STEP[weft_arm]
        diagonal = warp + weft
        has_warp, has_weft, has_both = (present(ij + step) for step in (warp, weft, diagonal))
        half = np.where(has_both, 0.5, 1.0)
        # (cell, share of its quarter that faces this quadrant)
        takes = [
            (0 * diagonal, np.ones(len(ij))),
            (warp, ~has_warp * half),
            (weft, ~has_weft * half),
            (diagonal, 1.0 * ~(has_both | has_warp | has_weft)),
        ]
        for step, weight in takes:
            rows = np.flatnonzero(weight)
            # The quarter of the cell at ij + step that touches this crossover's own quarter.
            corner = 2 * (ij[rows] + step)
            other = corner + np.where(step == 0, 1, -1) * diagonal
            taken.append((4 * rows + q, weight[rows], np.minimum(corner, other)))
    place, weight, low = (np.concatenate(part) for part in zip(*taken, strict=True))
    quarters, which = np.unique(low, axis=0, return_inverse=True)
    boxes = shapely.box(*0.5 * quarters.T, *0.5 * (quarters.T + 1))
    shapely.prepare(outline)
    piece = np.full(len(boxes), 0.25)
    cut = ~shapely.contains_properly(outline, boxes)
    piece[cut] = areas_within(outline, boxes[cut])
    np.add.at(area.reshape(-1), place, weight * piece[which.ravel()])
    return area
