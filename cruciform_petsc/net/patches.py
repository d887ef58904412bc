# SPDX-License-Identifier: MIT
"""A smooth surface through the arm ends of a ply, by which others touch it.

The arm ends of a regular net, half a pitch from each crossover along its two yarns, are a square
lattice themselves, turned by 45 degrees: of numbers (p, q), p along warp and weft together, q along
the weft against the warp. They are the control points of a surface of biquadratic B-splines, one
patch around each: position and normal go on from patch to patch without a jump, nine arm ends tell
the position. With pitch h it lies by h^2/16 times the sum of both curvatures beside the cloth, to
its hollow side; the points that touch it, of crossovers of the other ply, by h^2/48 beside theirs.
As both plies touch each other, what one has too much the other has too little.

A crossover touches as 2/3 of its hinge and 1/12 of each arm end: as half of all force comes in
there, and half through the patches, an even pressure loads hinges and arm ends as one of a tool
does (forming.blank.AT_HINGE), and bends nothing.

Where yarns end, control points come of the tails, straight on; beyond, of those within, straight
on, the mean of all that are as near.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import product

import numpy as np
import shapely
from scipy.sparse import coo_array, csr_array

from ..parallel import find_sorted
from .lattice import BETWEEN, TAIL, pack_key
from .network import Network
from .nodes import Nodes

AT_HINGE = 2 / 3  # of the point by which a crossover touches
LEAST_TAIL = 0.25  # pitches: a shorter tail tells no direction
AROUND = np.array(list(product((-1, 0, 1), repeat=2)))  # control points of a patch, p slowest
# From a control point that there is not: steps, in half pitches, to two of which it lies beyond.
_BEYOND = [
    [(m, step) for step in steps]
    for m, steps in (
        (1, ((1, 1), (1, -1), (-1, 1), (-1, -1))),
        (1, ((2, 0), (-2, 0), (0, 2), (0, -2))),
        (2, ((1, 1), (1, -1), (-1, 1), (-1, -1))),
        (2, ((2, 0), (-2, 0), (0, 2), (0, -2))),
        (3, ((1, 1), (1, -1), (-1, 1), (-1, -1))),
    )
]
_NONE = np.int64(-1)


class Patches:
    """Patches of a ply whose control points this rank knows. Not collective.

    Parameters
    ----------
    network : Network
    nodes : Nodes
        Its, in space.

    Attributes
    ----------
    number : int64 (n, 2)
        p, q of each patch's middle.
    nodes : int32 (n, k)
        Local nodes that its control points are made of; the first one again behind the last.
    weight : float (n, 9, k)
        Their shares in the control points, in the order of AROUND.
    points, shares : int32 (m, 5), float (5,)
        Of this rank's crossovers: nodes of the point by which a crossover touches, and their shares
        in it: of its hinge and its arms' ends.
    """

    def __init__(self, network: Network, nodes: Nodes):
        self._network, self._nodes = network, nodes
        half = 2.0 * network.to_yarn(nodes.rest[:, :2] - network.origin) / network.pitch
        at = np.floor(half).astype(np.int64)
        low, high = at.min(axis=0, initial=0) - 4, at.max(axis=0, initial=0) + 5
        grid = np.stack(np.meshgrid(*map(np.arange, low, high), indexing="ij"), -1).reshape(-1, 2)
        grid = grid[grid.sum(axis=1) % 2 == 1]
        self._control, known = self._controls(grid)
        number = _turned(grid)
        order = np.lexsort(number.T[::-1])
        number, known = number[order], known[order]
        self._control = self._control[order]
        self._key = _packed(number)
        near = find_sorted(self._key, _packed(number[:, None] + AROUND))
        whole = (near >= 0).all(axis=1) & known[near].all(axis=1)
        self.number, near = number[whole], near[whole]
        self._middle = np.flatnonzero(whole)
        self._patch_key = self._key[whole]
        self._make(near)
        self._make_points()

    def flat(self, place: np.ndarray) -> np.ndarray:
        """Where places (n, 2), as numbers p, q, lie on the flat ply: x, y, m."""
        p, q = place.T
        net = self._network
        return net.to_lab(0.5 * np.column_stack([p - q, p + q + 1.0]) * net.pitch) + net.origin

    # -- control points ---------------------------------------------------------------------------

    def _controls(self, grid: np.ndarray) -> tuple[csr_array, np.ndarray]:
        """Shares (n, n_local) of nodes in control points (n, 2), in half pitches; which are known.

        Known is one that there is, or that lies beyond others, and all of whose nodes are here.
        """
        size = (len(grid), self._nodes.num_nodes_local)
        key, share = self._of_yarns(grid)
        local = np.where(key >= 0, self._nodes.find(key), np.int32(-1))
        there = (share != 0.0).any(axis=1)
        here = ((local >= 0) | (share == 0.0)).all(axis=1)
        row, column = np.nonzero((local >= 0) & (share != 0.0))
        direct = coo_array((share[row, column], (row, local[row, column])), size).tocsr()
        order = np.lexsort(grid.T[::-1])
        sorted_key = _packed(grid[order])

        def find(points: np.ndarray) -> np.ndarray:
            found = find_sorted(sorted_key, _packed(points))
            return np.where(found >= 0, order[found], -1)

        known, todo, pieces = there & here, ~there, [(np.arange(len(grid)), np.arange(len(grid)),
                                                     np.where(there, 1.0, 0.0))]  # fmt: skip
        for ways in _BEYOND:
            rows = np.flatnonzero(todo)
            first = [find(grid[rows] + m * np.array(step)) for m, step in ways]
            second = [find(grid[rows] + (m + 1) * np.array(step)) for m, step in ways]
            good = np.array([
                (a >= 0) & (b >= 0) & there[a] & there[b]
                for a, b in zip(first, second, strict=True)
            ])  # fmt: skip
            count = good.sum(axis=0)
            for (m, _), a, b, g in zip(ways, first, second, good, strict=True):
                pieces.append((rows[g], a[g], (m + 1.0) / count[g]))
                pieces.append((rows[g], b[g], -m / count[g]))
            complete = np.array([
                ~g | (here[a] & here[b]) for a, b, g in zip(first, second, good, strict=True)
            ]).all(axis=0)  # fmt: skip
            known[rows[(count > 0) & complete]] = True
            todo[rows[count > 0]] = False
        row, column, value = map(np.concatenate, zip(*pieces, strict=True))
        mix = coo_array((value, (row, column)), (len(grid), len(grid))).tocsr()
        return csr_array(mix @ direct), known

    def _of_yarns(self, grid: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Keys and shares (n, 2) of the nodes of arm ends (n, 2); no share where there is none.

        A hinge and its tail, where that is the yarn's end; else the arm end alone.
        """
        network = self._network
        key = np.full((len(grid), 2), _NONE)
        share = np.zeros((len(grid), 2))
        for family in (0, 1):
            rows = np.flatnonzero(grid[:, family] % 2 == 1)
            before = grid[rows].copy()
            before[:, family] -= 1
            before //= 2
            after = before.copy()
            after[:, family] += 1
            for crossover, arm in ((before, family), (after, family + 2)):
                is_there = network.has_crossover(crossover)
                length, shared = (part[:, arm] for part in network.arms_at(crossover))
                along, line = crossover[:, family], crossover[:, 1 - family]
                yarn = pack_key(family, line, 4 * along)
                hinge = pack_key(0, crossover[:, 1], 4 * crossover[:, 0])
                joins = is_there & shared
                key[rows[joins], 0] = yarn[joins] + BETWEEN[arm]
                share[rows[joins]] = 1.0, 0.0
                ends = is_there & ~shared & (length >= LEAST_TAIL)
                ends &= share[rows, 0] == 0.0
                key[rows[ends], 0], key[rows[ends], 1] = yarn[ends] + TAIL[arm], hinge[ends]
                tail = 0.5 / length[ends]
                share[rows[ends]] = np.column_stack([tail, 1.0 - tail])
        return key, share

    def _make(self, near: np.ndarray) -> None:
        """Nodes and shares of patches with control points (n, 9)."""
        n, control = len(near), self._control
        start, stop = control.indptr[near.ravel()], control.indptr[near.ravel() + 1]
        entry = np.repeat(np.arange(near.size), stop - start)
        place = np.arange(len(entry)) - np.repeat(np.cumsum(stop - start) - (stop - start),
                                                  stop - start)  # fmt: skip
        source = start[entry] + place
        patch, corner = entry // 9, entry % 9
        node, value = control.indices[source].astype(np.int64), control.data[source]
        both, inverse = np.unique(
            patch * np.int64(self._nodes.num_nodes_local) + node, return_inverse=True
        )
        of = both // max(self._nodes.num_nodes_local, 1)
        begin = np.searchsorted(of, np.arange(n + 1))
        width = int(np.diff(begin).max(initial=1))
        column = np.arange(len(both)) - begin[of]
        self.nodes = np.zeros((n, width), np.int32)
        if n:
            self.nodes[:] = (both[begin[:-1]] % self._nodes.num_nodes_local)[:, None]
        self.nodes[of, column] = both % max(self._nodes.num_nodes_local, 1)
        self.weight = np.zeros((n, 9, width))
        np.add.at(self.weight, (patch, corner, column[inverse.ravel()]), value)

    def _make_points(self) -> None:
        network, nodes = self._network, self._nodes
        ends = nodes.of_network_node[network.arm_node]
        self.points = np.column_stack([nodes.of_hinge, ends]).astype(np.int32)
        self.shares = np.array([AT_HINGE, *4 * [0.25 * (1.0 - AT_HINGE)]])

    # -- states -----------------------------------------------------------------------------------

    def middles(self, x: np.ndarray) -> np.ndarray:
        """Control points in the middle of patches, (n, 3), of nodes at x (n_local, 3)."""
        return (self._control @ x)[self._middle]

    def find(self, number: np.ndarray) -> np.ndarray:
        """Patches of numbers (m, 2), -1 where this rank knows none."""
        return find_sorted(self._patch_key, _packed(number))

    def elsewhere(self, number: np.ndarray) -> np.ndarray:
        """Which of the numbers (m, 2) are arm ends of the ply whose patches this rank has not."""
        p, q = number.T
        is_there = (self._of_yarns(np.column_stack([p - q, p + q + 1]))[1] != 0.0).any(axis=1)
        return is_there & (self.find(number) < 0)

    def covers(self, number: np.ndarray) -> np.ndarray:
        """How far outside the outline places (m, 2), as p, q, lie on the flat ply, m; 0 within."""
        outline = self._network.preform.outline
        shapely.prepare(outline)
        return shapely.distance(outline, shapely.points(self.flat(number)))


def crossovers_near(network: Network, others: Sequence[Network], reach: float) -> np.ndarray:
    """Crossovers (m, 2) of a network, on any rank, near to this rank's of others on the flat.

    Not collective; ``reach`` in m.
    """
    around = shapely.unary_union([
        shapely.MultiPoint(other.crossover_position).convex_hull.buffer(reach) for other in others
    ])  # fmt: skip
    shapely.prepare(around)
    low, high = (bounds for bounds in np.array(network.partition.box).swapaxes(0, 1))
    low, high = low.min(axis=0), high.max(axis=0)
    found = []
    for line in range(int(low[1]), int(high[1])):
        ij = np.column_stack([np.arange(low[0], high[0]), np.full(high[0] - low[0], line)])
        place = network.to_lab(ij * network.pitch) + network.origin
        found.append(ij[shapely.contains_xy(around, *place.T) & network.has_crossover(ij)])
    return np.concatenate(found)


def _turned(grid: np.ndarray) -> np.ndarray:
    """Numbers p, q of arm ends (n, 2) in half pitches."""
    a, b = grid.T
    return np.column_stack([(a + b - 1) // 2, (b - a - 1) // 2])


def _packed(number: np.ndarray) -> np.ndarray:
    """Numbers (..., 2) as one, int64, ascending as they do."""
    return (number[..., 0].astype(np.int64) << 32) + (number[..., 1] + 2**31)
