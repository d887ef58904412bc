# SPDX-License-Identifier: MIT
"""What pictures are drawn from: parts of the network, small enough for one rank to hold.

A network of up to ``limit`` crossovers is taken as it is. Of a larger one, every k-th yarn is taken
and every k-th crossover along it, or blocks of k x k crossovers are averaged.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from ..net.network import Network

YARN_LIMIT = 3_000  # crossovers whose yarns can still be told apart on a page
MAP_LIMIT = 20_000  # cells that can


@dataclass
class YarnSample:
    """Yarns as polylines: the points of all of them, one yarn after the other.

    Attributes
    ----------
    before, displacement : float (n, 2)
        Metres.
    shear_angle_deg : float (n,)
        NaN where a crossover carries nothing. Or what `sample_yarns` was given in its place.
    family : int8 (n,)
        0 warp, 1 weft.
    first : int64 (m,)
        Where each polyline begins.
    every : int
        One in so many yarns was taken.
    spacing : float
        Mean distance between those, metres.
    outline : list of float (k, 2)
        Closed rings before the deformation, metres: the exterior, then the holes.
    """

    before: np.ndarray
    displacement: np.ndarray
    shear_angle_deg: np.ndarray
    family: np.ndarray
    first: np.ndarray
    every: int
    spacing: float
    outline: list[np.ndarray]

    def after(self, scale: float = 1.0) -> np.ndarray:
        """Deformed positions, displacement times ``scale``; (n, 2) in metres."""
        return self.before + scale * self.displacement

    @property
    def segment(self) -> np.ndarray:
        """Pairs of points that are joined by a piece of yarn, int64 (s, 2)."""
        joined = np.ones(len(self.before), bool)
        joined[self.first] = False
        end = np.flatnonzero(joined)
        return np.column_stack([end - 1, end])


@dataclass
class MapSample:
    """Values on the cells of the lattice, or on blocks of cells.

    Attributes
    ----------
    centre : float (m, 2)
        Metres, before the deformation.
    sides : float (2, 2)
        The two sides of a cell, along warp and weft, as vectors; metres.
    values : dict of float (m,)
        Means over the crossovers of each block; NaN where none has a value.
    at_outline : bool (m,)
        Cells that the outline may cut.
    outline : list of float (k, 2)
        Closed rings, metres: the exterior, then the holes.
    """

    centre: np.ndarray
    sides: np.ndarray
    values: dict[str, np.ndarray]
    at_outline: np.ndarray
    outline: list[np.ndarray]

    def cells(self, size: float = 1.0) -> np.ndarray:
        """Corners of the cells blown up by ``size``, float (m, 4, 2), metres."""
        corner = np.array([(-0.5, -0.5), (0.5, -0.5), (0.5, 0.5), (-0.5, 0.5)])
        return self.centre[:, None] + size * corner @ self.sides


def sample_yarns(
    network: Network,
    node_displacement: np.ndarray,
    fields: Mapping[str, np.ndarray],
    limit: int = YARN_LIMIT,
    values: Sequence[np.ndarray] | None = None,
) -> YarnSample | None:
    """Gather yarns, or every k-th of them, on rank 0. Collective.

    Parameters
    ----------
    network : Network
    node_displacement : float (n_local, 2)
        In x and y, metres, ghosts filled.
    fields : dict
        ``displacement``, ``shear_angle`` and ``carrying`` at this rank's crossovers, see
        LinearNetwork.crossover_fields.
    limit : int
        Each family's yarns are taken with at most so many crossovers.
    values : two of float (n,), optional
        Of warp and weft at the crossovers, to be taken in place of the shear angle.

    Returns
    -------
    YarnSample on rank 0, None on the others.
    """
    if values is None:
        values = 2 * [np.where(fields["carrying"], np.rad2deg(fields["shear_angle"]), np.nan)]
    hinge = np.column_stack([network.crossover_position, fields["displacement"], *values])
    means = [node_means(network, value) for value in values]
    node = np.column_stack([network.node_position, node_displacement, *means])
    every = _stride(network, limit)
    while True:
        taken = [_places(network, family, every) for family in (0, 1)]
        largest = [network.comm.allreduce(len(rows)) for rows, *_ in taken]
        if every == 1 or max(largest) <= limit:
            break
        every += 1 + every // 4
    parts = []
    for family, (hinges, place, starts, nodes, node_place, node_starts) in enumerate(taken):
        line = network.crossover_ij[:, 1 - family]
        for points, rows, at, start in (
            (hinge[hinges], hinges, place, starts),
            (node[nodes[0]], nodes[1], node_place, node_starts),
        ):
            key = [np.full(len(rows), family), line[rows], at, start]
            parts.append(np.column_stack([*key, points[:, [0, 1, 2, 3, 4 + family]]]))
    gathered = network.comm.gather(np.concatenate(parts))
    if gathered is None:
        return None
    table = np.concatenate(gathered)
    table = table[np.lexsort((table[:, 2], table[:, 1], table[:, 0]))]
    return YarnSample(
        before=table[:, 4:6],
        displacement=table[:, 6:8],
        shear_angle_deg=table[:, 8],
        family=table[:, 0].astype(np.int8),
        first=np.flatnonzero(table[:, 3]),
        every=every,
        spacing=every * float(network.pitch.mean()),
        outline=_rings(network),
    )


def _places(network: Network, family: int, every: int):
    """What is taken of one family's yarns: crossovers, then arm ends. Not collective.

    Returns
    -------
    rows, place, start
        Crossovers, their places along the yarn in quarters of a pitch (as in Network.node_key) and
        whether a yarn begins there.
    (node, row), place, start
        The same for arm ends: local nodes and the crossovers they belong to.
    """
    ij = network.crossover_ij.astype(np.int64)
    line, along = ij[:, 1 - family], ij[:, family]
    after, before = network.arm_is_shared[:, [family, family + 2]].T
    has_after, has_before = network.arm_length[:, [family, family + 2]].T > 0
    chosen = line % every == 0
    rows = np.flatnonzero(chosen & ((along % every == 0) | ~after | ~before))
    ends = [
        (family + 2, np.flatnonzero(chosen & ~before & has_before), -1, True),
        (family, np.flatnonzero(chosen & ~after & has_after), 1, False),
        (family, np.flatnonzero(chosen & after & (every == 1)), 2, False),
    ]
    node = np.concatenate([network.arm_node[at, arm] for arm, at, _, _ in ends])
    node_row = np.concatenate([at for _, at, _, _ in ends])
    node_place = np.concatenate([4 * along[at] + shift for _, at, shift, _ in ends])
    node_start = np.concatenate([np.full(len(at), start) for _, at, _, start in ends])
    start = ~(before | has_before)[rows]
    return rows, 4 * along[rows], start, (node, node_row), node_place, node_start


def sample_map(
    network: Network, values: Mapping[str, np.ndarray], limit: int = MAP_LIMIT
) -> MapSample | None:
    """Gather values at the crossovers, or their means over blocks, on rank 0. Collective.

    Parameters
    ----------
    network : Network
    values : dict of float (n_owned,)
        By name, on this rank's crossovers; entries that are not finite are left out of the means.
    limit : int
        Largest number of blocks.

    Returns
    -------
    MapSample on rank 0, None on the others.
    """
    ij = network.crossover_ij.astype(np.int64)
    cut = np.zeros(len(ij), bool)
    cut[network.boundary_crossovers] = True
    given = np.column_stack([np.asarray(value, float) for value in values.values()])
    given = given.reshape(len(ij), len(values))
    good = np.isfinite(given)
    columns = np.column_stack([np.ones(len(ij)), cut, good, np.where(good, given, 0.0)])
    every = _stride(network, limit)
    while True:
        block, total = _summed(ij // every, columns)
        if every == 1 or network.comm.allreduce(len(block)) <= limit:
            break
        every += 1 + every // 4
    gathered = network.comm.gather((block, total))
    if gathered is None:
        return None
    block, total = _summed(*(np.concatenate(part) for part in zip(*gathered, strict=True)))
    count, sums = np.split(total[:, 2:], 2, axis=1)
    mean = np.divide(sums, count, out=np.full(sums.shape, np.nan), where=count > 0)
    sides = network.pitch[:, None] * network.preform.rotation
    return MapSample(
        centre=(every * block + 0.5 * (every - 1)) @ sides + network.preform.lattice_origin,
        sides=every * sides,
        values=dict(zip(values, mean.T, strict=True)),
        at_outline=(total[:, 0] < every**2) | (total[:, 1] > 0),
        outline=_rings(network),
    )


def _summed(block: np.ndarray, columns: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Sum rows (n, c) that have the same block (n, 2); returns unique blocks and the sums."""
    key = (block[:, 1] << 32) + block[:, 0]
    _, first, inverse = np.unique(key, return_index=True, return_inverse=True)
    sums = [np.bincount(inverse, weights=column, minlength=len(first)) for column in columns.T]
    return block[first], np.column_stack(sums)


def node_means(network: Network, values: np.ndarray) -> np.ndarray:
    """Mean at each local node over the crossovers whose arms end there. Collective.

    Values (n_owned,) that are not finite are left out; (n_local,), NaN where none is left. The
    same on every rank that knows the node.
    """
    total = np.zeros((network.num_nodes_local, 2))
    good = np.isfinite(values)
    for node in network.arm_node[good].T:
        total[:, 0] += np.bincount(node, weights=values[good], minlength=len(total))
        total[:, 1] += np.bincount(node, minlength=len(total))
    network.halo.share(total)
    mean = np.full(len(total), np.nan)
    return np.divide(total[:, 0], total[:, 1], out=mean, where=total[:, 1] > 0)


def _stride(network: Network, limit: int) -> int:
    """Smallest k such that k-th crossovers of k-th yarns can be within the limit."""
    return max(1, int(np.ceil(np.sqrt(network.num_crossovers_global / limit))))


def _rings(network: Network) -> list[np.ndarray]:
    outline = network.preform.outline
    return [np.asarray(r.coords)[:, :2] for r in (outline.exterior, *outline.interiors)]
