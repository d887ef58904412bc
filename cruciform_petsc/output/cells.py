# SPDX-License-Identifier: MIT
"""The cloth as a mesh: a cell of the lattice between its four crossovers, or three of them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from ..net.lattice import ARM_STEP
from ..net.network import Network
from ..parallel import ask

CORNERS = np.array([[0, 0], [1, 0], [1, 1], [0, 1]])
# The piece of yarn from corner k to the next: the crossover it starts from, and its family.
_PIECES = ((0, 0), (1, 1), (3, 0), (0, 1))


@dataclass(frozen=True)
class Cells:
    """Cells between crossovers, those of this rank.

    Attributes
    ----------
    key : int64 (n,)
        Names that are the same on any number of ranks, below 2 x the number of crossovers.
    corner : int64 (n, 4)
        Global numbers of the crossovers at the corners, anticlockwise from the one that comes first
        along both yarns; -1 where there is none.
    rest, place : float (n, 4, 2), (n, 4, dim)
        Where the corners are at rest and now, m; of a triangle's missing one, where it would make
        a parallelogram.
    warp, weft : float (n, dim)
        Unit vectors along the yarns in the middle of the cell, now; of a triangle, along its legs.
    area_ratio : float (n,)
        Area now over area at rest.
    zone : float (n,)
        Zone of the corners, -1 if they are not all in one.
    """

    key: np.ndarray
    corner: np.ndarray
    rest: np.ndarray
    place: np.ndarray
    warp: np.ndarray
    weft: np.ndarray
    area_ratio: np.ndarray
    zone: np.ndarray


def lattice_cells(
    network: Network, position: np.ndarray, carrying: np.ndarray, zone: np.ndarray | None = None
) -> Cells:
    """Find the cells between joined crossovers that carry load, each on one rank. Collective.

    A cell with all four crossovers is one if all four pieces of yarn around it are whole. Where the
    outline has cut one crossover off, the other three make a triangle if both its legs are whole.

    ``position`` (n_owned, dim) of this rank's crossovers now, m; whether they are ``carrying`` and
    in which ``zone``, (n_owned,).
    """
    dim = position.shape[1]
    zone = np.zeros(len(position)) if zone is None else zone
    # A cell belongs to the crossover with the lowest number at its corners: the first corner, or
    # the second where there is no first.
    own = network.crossover_ij.astype(np.int64)
    number = network.crossover_number_global
    before = own + ARM_STEP[2]
    alone = ~network.has_crossover(before)
    key = np.concatenate([2 * number + 1, 2 * number[alone]])
    lattice = np.concatenate([own, before[alone]])[:, None] + CORNERS
    corner = network.crossover_number(lattice)
    missing = corner < 0
    whole = np.column_stack([_joined(network, lattice[:, at], family) for at, family in _PIECES])
    # Of a cell without corner k the pieces k - 1 and k are none, the others are its legs.
    legs = np.roll(whole, -1, axis=1) & np.roll(whole, -2, axis=1)
    triangle = (missing.sum(axis=1) == 1) & (legs & missing).any(axis=1)
    good = whole.all(axis=1) | triangle
    key, corner, missing, lattice = (array[good] for array in (key, corner, missing, lattice))

    data = np.column_stack([position, zone, carrying])
    value = _of_crossovers(network, corner, lattice, data)
    good = ((value[..., -1] == 1.0) | missing).all(axis=1)
    key, corner, missing, lattice, value = (
        array[good] for array in (key, corner, missing, lattice, value)
    )
    place, zones = value[..., :dim], value[..., dim]
    # The fourth corner of the parallelogram stands for what a triangle lacks.
    row, k = np.nonzero(missing)
    place[row, k] = place[row, (k + 1) % 4] + place[row, k - 1] - place[row, (k + 2) % 4]
    zones[row, k] = zones[row, k - 1]
    across, down = place[:, 2] - place[:, 0], place[:, 3] - place[:, 1]
    area = 0.5 * (across[:, 0] * down[:, 1] - across[:, 1] * down[:, 0])
    if dim == 3:
        area = 0.5 * np.linalg.norm(np.cross(across, down), axis=1)
    yarns = across - down, across + down
    warp, weft = (along / np.linalg.norm(along, axis=1, keepdims=True) for along in yarns)
    same = (zones == zones[:, :1]).all(axis=1)
    rest = network.origin + network.to_lab(lattice * network.pitch)
    ratio, zone = area / network.pitch.prod(), np.where(same, zones[:, 0], -1)
    return Cells(key, corner, rest, place, warp, weft, ratio, zone)


def area_ratio(fields: Mapping[str, np.ndarray]) -> np.ndarray:
    """Area of the cloth now over that at rest at crossovers, (n,): J of docs/exports.md."""
    stretched = (1.0 + fields["warp_strain"]) * (1.0 + fields["weft_strain"])
    return stretched * np.cos(fields["shear_angle"])


def thickening(area_ratio: np.ndarray, hold: str) -> np.ndarray:
    """Thickness over that at rest where the area is ``area_ratio`` times that at rest.

    ``hold``: see exports.export.
    """
    return np.ones_like(area_ratio) if hold == "thickness" else 1.0 / area_ratio


def _joined(network: Network, ij: np.ndarray, family: int) -> np.ndarray:
    """Whether the yarn is whole from crossovers at (n, 2) to the next ones along it."""
    yarns = (network.warp_yarns, network.weft_yarns)[family]
    there = ij + ARM_STEP[family]
    part, next_part = (yarns.find(at[:, 1 - family], at[:, family]) for at in (ij, there))
    same = (part >= 0) & (part == next_part)
    return same & network.has_crossover(ij) & network.has_crossover(there)


def _of_crossovers(
    network: Network, number: np.ndarray, lattice: np.ndarray, values: np.ndarray
) -> np.ndarray:
    """Values (n_owned, k) at crossovers (n, m) of any rank, as float (n, m, k). Collective.

    ``lattice`` (n, m, 2) says where they are. Zero where the number is -1.
    """
    own = network.crossover_number_global
    there = number >= 0
    wanted, first, inverse = np.unique(number[there], return_index=True, return_inverse=True)
    owner = network.partition.owner(lattice[there][first])
    found = ask(network.comm, owner, wanted, lambda asked: values[np.searchsorted(own, asked)])
    result = np.zeros((*number.shape, values.shape[1]))
    result[there] = found[inverse]
    return result
