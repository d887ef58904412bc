# SPDX-License-Identifier: MIT
"""The fishnet of least energy of shear (Long, Souter and Robitaille 2000).

A fishnet follows from its seed and the directions of two yarns; of all of them the one whose cloth
takes the least energy to shear is sought, by the fabric's own law. Seeds on a grid are tried first,
at a few directions each; from the best ones the simplex of Nelder and Mead goes on. What is tried
are coarse nets, the same ones on any number of ranks, which share them: the network itself is laid
once, from the crossover nearest to the best seed.

What a net cannot reach, as it locks before, counts as sheared to the limit.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import shapely
from mpi4py import MPI
from scipy.optimize import minimize

from ..cloth.fabric import Fabric
from ..cloth.preform import Preform
from ..errors import InputError
from ..net.network import Network
from .fishnet import Fishnet
from .generators import Seed
from .lay import place_of, seed_crossover

CELLS = 1500  # of a coarse net, about
BEST = 3  # of the grid from which the search goes on
TRIES = 60  # nets in each of these searches
NEAR = 1e-3  # of the blank's size, and in rad: where they end


@dataclass(frozen=True)
class Search:
    """What was found.

    Attributes
    ----------
    seed : Seed
    flat : float (2,)
        Place of the seed on the flat blank, m.
    energy, before : float
        Of the coarse nets: of the best one, and of that begun with, J.
    nets : int
        That were tried.
    """

    seed: Seed
    flat: np.ndarray
    energy: float
    before: float
    nets: int

    def nearest(self, network: Network) -> tuple[np.ndarray, Seed]:
        """The crossover nearest to it, (2,) int64, and the seed moved by as much."""
        first = seed_crossover(network, self.flat)
        moved = place_of(network, first) - self.flat
        return first, replace(self.seed, place=self.seed.place + moved)


class CoarseNet:
    """Fishnets of a blank on a net of some CELLS; not collective."""

    def __init__(self, preform: Preform, fabric: Fabric, locking: float):
        self.preform, self.law, self.locking = preform, fabric.shear, locking
        pitch = np.array(preform.pitch(fabric))
        cells = float(preform.outline.area / pitch.prod())
        self.pitch = pitch * max(np.sqrt(cells / CELLS), 1.0)
        self.axes = np.array([preform.warp_direction, preform.weft_direction])
        shapely.prepare(preform.outline)
        self.corners = shapely.get_coordinates(preform.outline.envelope)[:4]

    def energy(self, flat: np.ndarray, seed: Seed) -> float:
        """Energy of shear [J] of the blank laid from a place (2,) of the flat one at a seed."""
        p = self.preform
        along = (self.corners - flat) @ self.axes.T / self.pitch
        low, high = np.floor(along.min(axis=0)).astype(int), np.ceil(along.max(axis=0)).astype(int)
        low, high = np.minimum(low, -1), np.maximum(high, 1)
        shape = high - low + 1
        net = Fishnet(seed.tool.surface, seed.gap, self.pitch, low, shape, seed.below, self.locking)
        middle = np.argwhere(np.ones(shape - 1)) + low + 0.5
        x, y = (flat + (middle * self.pitch) @ self.axes).T
        inside = shapely.contains_xy(p.outline, x, y).reshape(shape - 1)
        wanted = _before(inside, low)
        counts = [int(n) for n in (high[0], high[1], -low[0], -low[1])]
        for k, line in enumerate(seed.generators(self.pitch, counts)):
            net.place(k % 2, 1 if k < 2 else -1, line, counts[k])
        net.sweep(wanted)
        shear = net.shear()[inside]
        shear = np.where(np.isnan(shear), self.locking, shear)
        return float(self.law.evaluate(shear)[0].sum() * self.pitch.prod())


def _before(inside: np.ndarray, low: np.ndarray) -> np.ndarray:
    """Joints (n0 + 1, n1 + 1) that cells (n0, n1) need: theirs, and all before these."""
    wanted = np.zeros(np.array(inside.shape) + 1, bool)
    for i, j in ((0, 0), (0, 1), (1, 0), (1, 1)):
        wanted[i : i + inside.shape[0], j : j + inside.shape[1]] |= inside
    # From the far ends towards the seed, in each quadrant.
    a, b = -low
    for rows, columns in (
        (slice(None, None, -1), slice(None, None, -1)), (slice(None), slice(None))
    ):  # fmt: skip
        half = wanted[a:] if rows.step else wanted[: a + 1]
        half[rows] = np.logical_or.accumulate(half[rows], axis=0)
        half = wanted[:, b:] if columns.step else wanted[:, : b + 1]
        half[:, columns] = np.logical_or.accumulate(half[:, columns], axis=1)
    return wanted


def search(
    comm: MPI.Intracomm,
    net: CoarseNet,
    flat: np.ndarray,
    seed: Seed,
    places: int,
    turn: float,
    shear: float,
) -> Search:
    """Seek the seed of least energy. Collective; the same on any number of ranks.

    Parameters
    ----------
    comm : communicator
        Of ranks that share the work.
    net : CoarseNet
    flat : float (2,)
        Place on the flat blank that the seed begins with, m; other seeds are moved with it.
    seed : Seed
    places : int
        Of the grid along each side of the blank.
    turn, shear : float
        Bounds of the directions, rad; 0 leaves them as they are.

    Raises
    ------
    InputError
        If the net can be laid from none of the places that were tried.
    """
    low, high = np.reshape(net.preform.outline.bounds, (2, 2))
    size = float((high - low).max())
    span = np.array([turn, shear])

    def energy(x: np.ndarray) -> float:
        """Of places of the flat blank over its size, and turns over their bounds."""
        place = size * x[:2]
        place_on_tool = seed.place + place - flat
        heading, between = np.array([seed.heading, seed.between]) + span * x[2:]
        if not shapely.contains_xy(net.preform.outline.envelope, *place):
            return np.inf
        try:
            return net.energy(place, seed.turned(place_on_tool, heading, between))
        except InputError:
            return np.inf  # no tool there

    share = (np.arange(places) + 0.5) / places
    grid = [np.append(flat / size, [0.0, 0.0])]
    grid += [
        np.append((low + np.array([a, b]) * (high - low)) / size, [0.0, 0.0])
        for a in share
        for b in share
    ]
    tried = [
        start + np.array([0.0, 0.0, t, s])
        for start in grid
        for t in ((0.0, -0.5, 0.5) if turn else (0.0,))
        for s in ((0.0, -0.5, 0.5) if shear else (0.0,))
    ]
    found = _shared(comm, tried, lambda x: (energy(x), x, 1))
    begun = found[0][0]
    ranked = sorted(range(len(found)), key=lambda k: (found[k][0], k))
    # The best of each place, of as many places.
    starts: list[np.ndarray] = []
    for k in ranked:
        if np.isfinite(found[k][0]) and not any((tried[k][:2] == s[:2]).all() for s in starts):
            starts.append(tried[k])
    free = np.array([True, True, turn > 0.0, shear > 0.0])

    def refine(x: np.ndarray) -> tuple[float, np.ndarray, int]:
        steps = np.diag(
            np.array(
                [
                    0.5 / places * (high - low)[0] / size,
                    0.5 / places * (high - low)[1] / size,
                    0.25,
                    0.25,
                ]
            )
        )[free][:, free]

        def part(y: np.ndarray) -> float:
            whole = x.copy()
            whole[free] = y
            return energy(whole)

        begin = x[free]
        bounds = np.array(
            [[low[0] / size, high[0] / size], [low[1] / size, high[1] / size], [-1, 1], [-1, 1]]
        )[free]
        simplex = np.clip(np.vstack([begin, begin + steps]), bounds[:, 0], bounds[:, 1])
        options = {
            "initial_simplex": simplex,
            "maxfev": TRIES,
            "xatol": NEAR,
            "fatol": 1e-4 * part(begin),
        }
        best = minimize(part, begin, method="Nelder-Mead", bounds=bounds, options=options)
        whole = x.copy()
        whole[free] = best.x
        return float(best.fun), whole, int(best.nfev) + 1

    if not starts:
        raise InputError("the net cannot be laid from any of the places of test.least_energy")
    refined = _shared(comm, starts[:BEST], refine)
    best = min(range(len(refined)), key=lambda k: (refined[k][0], k))
    least_energy, x, _ = refined[best]
    place = size * x[:2]
    heading, between = np.array([seed.heading, seed.between]) + span * x[2:]
    nets = len(tried) + sum(count for _, _, count in refined)
    turned = seed.turned(seed.place + place - flat, float(heading), float(between))
    return Search(turned, place, least_energy, begun, nets)


def _shared(comm: MPI.Intracomm, work, function) -> list:
    """Results of a function of each piece of work, in order, shared out by turns. Collective."""
    mine = [function(piece) for piece in work[comm.rank :: comm.size]]
    every = comm.allgather(mine)
    return [every[k % comm.size][k // comm.size] for k in range(len(work))]
