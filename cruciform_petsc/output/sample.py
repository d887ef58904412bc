# SPDX-License-Identifier: MIT
"""What pictures are drawn from: parts of the network, small enough for one rank to hold.

A network of up to ``limit`` crossovers is taken as it is. Of a larger one, every k-th yarn is taken
and every k-th crossover along it, or blocks of k x k crossovers are averaged: about ``limit`` then.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from ..net.network import Network

YARN_LIMIT = 3_000  # crossovers whose yarns can still be told apart on a page
MAP_LIMIT = 20_000  # cells that can
YARNS = 40  # of each family, of a surface in space


@dataclass
class YarnSample:
    """Yarns as polylines: the points of all of them, one yarn after the other; lengths in metres.

    Attributes
    ----------
    before, after, lattice : float (n, 2)
        Places at rest, now (NaN: the yarn has slid out of there), and in the lattice (i, j).
    values : float (n,)
        For the points' colours; NaN where a crossover carries nothing.
    family : int8 (n,)
        0 warp, 1 weft.
    first : int64 (m,)
        Where each polyline begins.
    every : int
        One in so many yarns was taken.
    spacing : float
        Mean distance between those.
    """

    before: np.ndarray
    after: np.ndarray
    lattice: np.ndarray
    values: np.ndarray
    family: np.ndarray
    first: np.ndarray
    every: int
    spacing: float

    @property
    def segment(self) -> np.ndarray:
        """Pairs of points that are joined by a piece of yarn, int64 (s, 2)."""
        end = np.delete(np.arange(len(self.before)), self.first)
        return np.column_stack([end - 1, end])


@dataclass
class MapSample:
    """Values on the cells of the lattice at rest, or on blocks of cells; lengths in metres.

    Attributes
    ----------
    centre : float (m, 2)
    sides : float (2, 2)
        The two sides of a cell, along warp and weft, as vectors.
    values : dict of float (m,)
        Means over the crossovers of each block; NaN where none has a value.
    at_outline : bool (m,)
        Cells that the outline may cut.
    outline : list of float (k, 2)
        Closed rings: the exterior, then the holes.
    """

    centre: np.ndarray
    sides: np.ndarray
    values: dict[str, np.ndarray]
    at_outline: np.ndarray
    outline: list[np.ndarray]

    def cells(self, size: float = 1.0) -> np.ndarray:
        """Corners of the cells blown up by ``size``, float (m, 4, 2)."""
        corner = np.array([(-0.5, -0.5), (0.5, -0.5), (0.5, 0.5), (-0.5, 0.5)])
        return self.centre[:, None] + size * corner @ self.sides


@dataclass
class Surface:
    """Crossovers as points of a surface in space; lengths in metres.

    Attributes
    ----------
    points : float (n, 3)
    values : dict of float (n,)
        NaN where a crossover has none.
    triangles, yarns : int64 (m, 3), (k, 2)
        Between the points; pieces of yarns, of about `YARNS` of each family.
    """

    points: np.ndarray
    values: dict[str, np.ndarray]
    triangles: np.ndarray
    yarns: np.ndarray


def sample_surface(
    network: Network, place: np.ndarray, values: Mapping[str, np.ndarray]
) -> Surface:
    """Gather crossovers, or every k-th of both families, on rank 0; none on others. Collective.

    ``place`` (n_owned, 3) is where this rank's crossovers are, m; ``values`` (n_owned,) are theirs.
    The order is the same in each state of a network; those without a place, NaN, are left out.
    """
    every = int(np.ceil(np.sqrt(network.num_crossovers_global / MAP_LIMIT)))
    taken = (network.crossover_ij % every == 0).all(axis=1) & ~np.isnan(place[:, 0])
    own = np.column_stack([network.crossover_ij, place, *values.values()])[taken]
    rows = np.concatenate(network.comm.gather(own) or [own[:0]])
    i, j = (rows[:, :2] // every).astype(np.int64).T
    i, j = i - i.min(initial=0), j - j.min(initial=0)
    grid = np.full((i.max(initial=0) + 2, j.max(initial=0) + 2), -1)
    grid[i, j] = np.arange(len(rows))
    a, b, c, d = grid[i, j], grid[i + 1, j], grid[i + 1, j + 1], grid[i, j + 1]
    triangles = np.concatenate([np.column_stack(three) for three in ((a, b, c), (a, c, d))])
    lines = max(1, round(max(grid.shape) / YARNS))
    pieces = [
        np.column_stack(ends)[across % lines == 0] for ends, across in (((a, b), j), ((a, d), i))
    ]
    yarns = np.concatenate(pieces)
    return Surface(
        rows[:, 2:5],
        dict(zip(values, rows[:, 5:].T, strict=True)),
        triangles[(triangles >= 0).all(axis=1)],
        yarns[(yarns >= 0).all(axis=1)],
    )


def together(surfaces: Sequence[Surface]) -> Surface:
    """Several surfaces with the same values, of plies, as one."""
    first = np.cumsum([0, *(len(surface.points) for surface in surfaces)])
    return Surface(
        np.concatenate([surface.points for surface in surfaces]),
        {
            name: np.concatenate([surface.values[name] for surface in surfaces])
            for name in surfaces[0].values
        },
        np.concatenate([s.triangles + n for s, n in zip(surfaces, first, strict=False)]),
        np.concatenate([s.yarns + n for s, n in zip(surfaces, first, strict=False)]),
    )


def sample_yarns(
    network: Network,
    node_displacement: np.ndarray,
    fields: Mapping[str, np.ndarray],
    limit: int = YARN_LIMIT,
    values: Sequence[np.ndarray] | None = None,
) -> YarnSample | None:
    """Gather yarns, or every k-th of them, on rank 0; None on the others. Collective.

    Parameters
    ----------
    network : Network
    node_displacement : float (n_local, dim)
        In x and y (and z, which is not looked at), metres, ghosts filled.
    fields : dict
        Of this rank's crossovers, see LinearNetwork.crossover_fields.
    limit : int
        Each family's yarns are taken with about so many crossovers.
    values : two of float (n,), optional
        Of warp and weft at the crossovers; by default the shear angle in degrees, of both.
    """
    if values is None:
        values = 2 * [np.where(fields["carrying"], np.rad2deg(fields["shear_angle"]), np.nan)]
    rest = np.concatenate([network.crossover_position, network.node_position])
    place = rest + np.concatenate([fields["displacement"], node_displacement])[:, :2]
    every = _stride(network, limit)
    own = []
    for family, of_crossovers in enumerate(values):
        value = np.concatenate([of_crossovers, node_means(network, of_crossovers)])
        moved = place
        if "slid_out" in fields:
            out = fields["slid_out"][:, family].astype(float)
            gone = np.concatenate([out, node_means(network, out)]) > 1.0 - 1e-9
            moved = np.where(gone[:, None], np.nan, place)
        *order, point = _points(network, family, every)
        families = np.full(len(point), family)
        own.append(np.column_stack([families, *order, rest[point], moved[point], value[point]]))
    gathered = network.comm.gather(np.concatenate(own))
    if gathered is None:
        return None
    rows = np.concatenate(gathered)
    rows = rows[np.lexsort(rows[:, 2::-1].T)]
    before = rows[:, 4:6]
    return YarnSample(
        before=before,
        after=rows[:, 6:8],
        lattice=network.to_yarn(before - network.origin) / network.pitch,
        values=rows[:, 8],
        family=rows[:, 0].astype(np.int8),
        first=np.flatnonzero(rows[:, 3]),
        every=every,
        spacing=every * float(network.pitch.mean()),
    )


def _points(network: Network, family: int, every: int) -> np.ndarray:
    """What is taken of one family's yarns: crossovers and arm ends, int64 (4, n).

    Line of the yarn, place along it in quarters of a pitch (as in Network.node_key), whether a
    yarn begins there; and the crossover, or the local node after all of this rank's crossovers.
    """
    ij, count = network.crossover_ij.astype(np.int64), network.num_crossovers_owned
    line, along = ij[:, 1 - family], ij[:, family]
    after, before = network.arm_is_shared[:, [family, family + 2]].T
    has_after, has_before = network.arm_length[:, [family, family + 2]].T > 0
    node_after, node_before = count + network.arm_node[:, [family, family + 2]].T
    chosen = line % every == 0
    whole = (along % every == 0) | ~after | ~before
    parts = [
        (chosen & whole, 0, ~(before | has_before), np.arange(count)),
        (chosen & ~before & has_before, -1, True, node_before),
        (chosen & ~after & has_after, 1, False, node_after),
        (chosen & after & (every == 1), 2, False, node_after),
    ]
    columns = [
        np.array(np.broadcast_arrays(line, 4 * along + shift, begins, point))[:, taken]
        for taken, shift, begins, point in parts
    ]
    return np.concatenate(columns, axis=1)


def sample_map(
    network: Network, values: Mapping[str, np.ndarray], limit: int = MAP_LIMIT
) -> MapSample | None:
    """Gather values at the crossovers, or means over blocks, on rank 0; None on others. Collective.

    ``values`` (n_owned,) by name; those that are not finite are left out of the means. There are
    up to ``limit`` blocks, and some more at the outline.
    """
    ij = network.crossover_ij.astype(np.int64)
    cut = np.zeros(len(ij), bool)
    cut[network.boundary_crossovers] = True
    table = np.column_stack(list(values.values()))
    good = np.isfinite(table)
    columns = np.column_stack([np.ones(len(ij)), cut, good, np.where(good, table, 0.0)])
    every = _stride(network, limit)
    gathered = network.comm.gather(_summed(ij // every, columns))
    if gathered is None:
        return None
    block, total = _summed(*(np.concatenate(part) for part in zip(*gathered, strict=True)))
    count, sums = np.split(total[:, 2:], 2, axis=1)
    mean = _mean(sums, count)
    sides, outline = network.to_lab(np.diag(network.pitch)), network.preform.outline
    return MapSample(
        centre=(every * block + 0.5 * (every - 1)) @ sides + network.origin,
        sides=every * sides,
        values=dict(zip(values, mean.T, strict=True)),
        at_outline=(total[:, 0] < every**2) | (total[:, 1] > 0),
        outline=[np.asarray(ring.coords)[:, :2] for ring in (outline.exterior, *outline.interiors)],
    )


def _summed(block: np.ndarray, columns: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Sum rows (n, c) that have the same block (n, 2); returns unique blocks and the sums."""
    key = (block[:, 1] << 32) + block[:, 0]
    _, first, inverse = np.unique(key, return_index=True, return_inverse=True)
    sums = [np.bincount(inverse, weights=column, minlength=len(first)) for column in columns.T]
    return block[first], np.column_stack(sums)


def node_means(network: Network, values: np.ndarray) -> np.ndarray:
    """Mean (n_local,) at the nodes over the crossovers whose arms end there. Collective.

    Values (n_owned,) that are not finite are left out, NaN where none is left. The same on every
    rank that knows the node.
    """
    total = np.zeros((network.num_nodes_local, 2))
    good = np.isfinite(values)
    for node in network.arm_node[good].T:
        total[:, 0] += np.bincount(node, weights=values[good], minlength=len(total))
        total[:, 1] += np.bincount(node, minlength=len(total))
    network.halo.share(total)
    return _mean(*total.T)


def _mean(total: np.ndarray, count: np.ndarray) -> np.ndarray:
    """NaN of none."""
    return np.divide(total, count, out=np.full(total.shape, np.nan), where=count > 0)


def _stride(network: Network, limit: int) -> int:
    """Smallest k of which k-th crossovers of k-th yarns are at most about so many."""
    return int(np.ceil(np.sqrt(network.num_crossovers_global / limit)))
