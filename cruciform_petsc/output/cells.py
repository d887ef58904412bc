# SPDX-License-Identifier: MIT
"""The cloth as a mesh: a cell of the lattice between its four crossovers, or three of them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..net.lattice import ARM_STEP
from ..net.network import Network
from ..parallel import ask

CORNERS = np.array([[0, 0], [1, 0], [1, 1], [0, 1]])
# The piece of yarn from corner k to the next: the crossover it starts from, and its family.
_PIECES = ((0, 0), (1, 1), (3, 0), (0, 1))


@dataclass
class Cells:
    """Cells of this rank, each on one rank.

    Attributes
    ----------
    key : int64 (n,)
        Names that are the same on any number of ranks, below 2 x the number of crossovers.
    corner : int64 (n, 4)
        Global numbers of the crossovers at the corners, anticlockwise from the one that comes first
        along both yarns; -1 where there is none.
    area_ratio : float (n,)
        Area now over area at rest.
    warp, weft : float (n, 2)
        Unit vectors along the yarns in the middle of the cell, now; of a triangle, along its legs.
    zone : int8 (n,)
        Zone of the corners, -1 if they are not all in one.
    """

    key: np.ndarray
    corner: np.ndarray
    area_ratio: np.ndarray
    warp: np.ndarray
    weft: np.ndarray
    zone: np.ndarray


def lattice_cells(
    network: Network, position: np.ndarray, carrying: np.ndarray, zone: np.ndarray
) -> Cells:
    """Find the cells between joined crossovers that carry load. Collective.

    A cell with all four crossovers is one if all four pieces of yarn around it are whole. Where the
    outline has cut one crossover off, the other three make a triangle if both its legs are whole.

    Parameters
    ----------
    network : Network
    position : float (n_owned, 2)
        Of this rank's crossovers now, m.
    carrying : bool (n_owned,)
    zone : int (n_owned,)
    """
    # A cell belongs to the crossover with the lowest number at its corners: the first corner, or
    # the second where there is no first.
    own = network.crossover_ij.astype(np.int64)
    number = network.crossover_number_global
    before = own + ARM_STEP[2]
    alone = ~network.has_crossover(before)
    base = np.concatenate([own, before[alone]])
    key = np.concatenate([2 * number + 1, 2 * number[alone]])
    lattice = base[:, None] + CORNERS
    corner = network.crossover_number(lattice)
    missing = corner < 0
    whole = np.column_stack([_joined(network, lattice[:, at], family) for at, family in _PIECES])
    # Of a cell without corner k the pieces k - 1 and k are none, the others are its legs.
    legs = np.column_stack([whole[:, (k + 1) % 4] & whole[:, (k + 2) % 4] for k in range(4)])
    triangle = (missing.sum(axis=1) == 1) & (legs & missing).any(axis=1)
    good = whole.all(axis=1) | triangle
    key, corner, lattice = key[good], corner[good], lattice[good]

    value = _of_crossovers(
        network, corner, lattice, np.column_stack([position, carrying, zone, zone])
    )
    missing = corner < 0
    good = ((value[..., 2] == 1.0) | missing).all(axis=1)
    key, corner, missing, value = key[good], corner[good], missing[good], value[good]
    place = value[..., :2]
    # The fourth corner of the parallelogram stands for what a triangle lacks.
    row, k = np.nonzero(missing)
    place[row, k] = place[row, (k + 1) % 4] + place[row, k - 1] - place[row, (k + 2) % 4]
    value[row, k, 3], value[row, k, 4] = np.inf, -np.inf
    low, high = value[..., 3].min(axis=1), value[..., 4].max(axis=1)
    across, down = place[:, 2] - place[:, 0], place[:, 3] - place[:, 1]
    area = 0.5 * (across[:, 0] * down[:, 1] - across[:, 1] * down[:, 0])
    return Cells(
        key,
        corner,
        area / network.pitch.prod(),
        _unit(place[:, 1] - place[:, 0] + place[:, 2] - place[:, 3]),
        _unit(place[:, 3] - place[:, 0] + place[:, 2] - place[:, 1]),
        np.where(low == high, low, -1).astype(np.int8),
    )


def _joined(network: Network, ij: np.ndarray, family: int) -> np.ndarray:
    """Whether the yarn is whole from crossovers at (n, 2) to the next ones along it."""
    yarns = (network.warp_yarns, network.weft_yarns)[family]
    there = ij + ARM_STEP[family]
    part = yarns.find(ij[:, 1 - family], ij[:, family])
    same = (part >= 0) & (part == yarns.find(there[:, 1 - family], there[:, family]))
    return same & network.has_crossover(ij) & network.has_crossover(there)


def _of_crossovers(
    network: Network, number: np.ndarray, lattice: np.ndarray, values: np.ndarray
) -> np.ndarray:
    """Values at crossovers of any rank, zero where the number is -1. Collective.

    Parameters
    ----------
    number : int64 (n, m)
    lattice : int64 (n, m, 2)
        Where they are.
    values : float (n_owned, k)

    Returns
    -------
    float (n, m, k)
    """
    own = network.crossover_number_global
    there = number >= 0
    wanted, first, inverse = np.unique(number[there], return_index=True, return_inverse=True)
    owner = network.partition.owner(lattice[there][first])
    found = ask(network.comm, owner, wanted, lambda asked: values[np.searchsorted(own, asked)])
    result = np.zeros((*number.shape, values.shape[1]))
    result[there] = found[inverse]
    return result


def _unit(vectors: np.ndarray) -> np.ndarray:
    return vectors / np.hypot(vectors[:, 0], vectors[:, 1])[:, None]
