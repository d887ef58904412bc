# SPDX-License-Identifier: MIT
"""Multigrid that follows the yarns: PETSc's PCMG on lattices of twice, four times ... the pitch.

The paper, after Torbe, calls the cruciform "a coarser representative grid than that formed by
yarns". Here the coarse spaces are those grids: displacements along warp and weft on the points of a
lattice of twice the pitch, interpolated bilinearly; yarn rotations are taken from the slope of the
interpolated displacement. Coarse matrices are Galerkin products. On every level the component along
the warp is numbered along warp lines and the one along the weft along weft lines, so that the stiff
couplings are neighbours and incomplete factorisations keep them.

Without yarn bending a third component is kept: crossovers that turn to and fro in a chequerboard
cost no energy, whatever the fine matrix's smoother does, and no smooth displacement resembles them.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from petsc4py import PETSc

from ..assembly import LinearNetwork

# The smallest weight of a corner of a bilinear cell that has the largest one.
_STRONG = 0.25 - 1e-9


@dataclass
class _Level:
    """Unknowns of one level that this rank owns, and what they are made of on the next.

    Each is a combination of the next level's fields (u_warp, u_weft, chequerboard) and slopes
    (d u_weft/d warp, d u_warp/d weft), interpolated at a point.

    Attributes
    ----------
    point : float (n, 2)
        Lattice coordinates, in fine pitches.
    values : float (n, 3)
        Factors of the fields' values.
    slopes : float (n, 2)
        Factors of the slopes, per fine pitch.
    """

    point: np.ndarray
    values: np.ndarray
    slopes: np.ndarray


def interpolations(linear: LinearNetwork, coarsest: int = 3000) -> list[PETSc.Mat]:
    """Interpolation matrices, finest first, down to about ``coarsest`` unknowns. Collective.

    The caller destroys them.
    """
    level, step, matrices = _finest(linear), 2, []
    size = linear.unknowns_per_node * linear.network.num_nodes_global
    while size > coarsest:
        matrix, level = _interpolation(linear, level, step)
        coarse = matrix.getSize()[1]
        if coarse > 0.7 * size:  # a network of few yarns across: nothing to gain
            matrix.destroy()
            break
        matrices.append(matrix)
        size, step = coarse, 2 * step
    return matrices


def _finest(linear: LinearNetwork) -> _Level:
    network, d = linear.network, linear.unknowns_per_node
    owned = network.num_nodes_owned
    lattice = (
        (network.node_position[:owned] - network.preform.lattice_origin)
        @ network.preform.rotation.T
    ) / network.pitch
    warp = network.node_family[:owned] == 0
    values, slopes = np.zeros((owned, d, 3)), np.zeros((owned, d, 2))
    values[:, :2, :2] = linear.constraints.frame[:owned]
    if d == 3:
        # Rotation of a warp yarn: d u_weft/d warp; of a weft yarn: -d u_warp/d weft.
        slopes[warp, 2, 0] = linear.length_scale / network.pitch[0]
        slopes[~warp, 2, 1] = -linear.length_scale / network.pitch[1]
    else:
        # Crossover (i, j) turns by (-1)^(i + j): its arm ends move across their yarns.
        sign = 1.0 - 2.0 * (np.floor(lattice + 1e-9).sum(axis=1) % 2)
        length = 2 * abs(lattice - np.round(lattice)).max(axis=1) * network.pitch[1 - warp]
        turned = sign * length / network.pitch.mean()
        across = np.where(warp[:, None], [0.0, 1.0], [-1.0, 0.0]) * turned[:, None]
        values[:, :2, 2] = np.einsum("nij,nj->ni", linear.constraints.frame[:owned], across)
    values[~linear.free[:owned]] = 0.0
    slopes[~linear.free[:owned]] = 0.0
    return _Level(np.repeat(lattice, d, axis=0), values.reshape(-1, 3), slopes.reshape(-1, 2))


def _interpolation(linear: LinearNetwork, fine: _Level, step: int) -> tuple[PETSc.Mat, _Level]:
    """Interpolation from the lattice of ``step`` pitches to a finer level. Collective."""
    network, n = linear.network, len(fine.point)
    cell = np.floor(fine.point / step).astype(np.int64)
    share = fine.point / step - cell
    parts: list[tuple[np.ndarray, ...]] = []
    for di in (0, 1):
        for dj in (0, 1):
            corner = cell + [di, dj]
            wi, wj = np.abs(np.array([1 - di, 1 - dj]) - share).T
            d_warp, d_weft = (2 * di - 1) * wj / step, (2 * dj - 1) * wi / step
            for c in range(3):
                value = wi * wj * fine.values[:, c]
                turn = np.zeros(n)
                if c < 2:
                    turn = (d_weft if c == 0 else d_warp) * fine.slopes[:, 1 - c]
                use = np.flatnonzero((value != 0) | (turn != 0))
                weight = wi * wj
                parts.append(
                    (use, _pack(c, corner[use]), (value + turn)[use], (turn != 0)[use],
                     corner[use], weight[use] >= _STRONG)
                )  # fmt: skip
    rows, keys, weights, slope, corners, strong = map(np.concatenate, zip(*parts, strict=True))
    number, owned_key = _number(linear, keys, corners * step, strong)
    # Corners that nothing strong hangs on do not exist. Their weight goes to the others of the same
    # field, so that constants are kept.
    there = number >= 0
    group = 3 * rows + (keys >> 60)
    lost = np.bincount(group[~there], weights[~there], minlength=3 * n)
    shares = np.where(slope, 1.0, abs(weights))
    total = np.bincount(group[there], shares[there], minlength=3 * n)
    rows, number, group = rows[there], number[there], group[there]
    weights = weights[there] + lost[group] * shares[there] / total[group]

    order = np.lexsort((number, rows))
    rows, number, weights = rows[order], number[order], weights[order]
    pointer = np.searchsorted(rows, np.arange(n + 1)).astype(PETSc.IntType)
    matrix = PETSc.Mat().create(comm=network.comm)
    matrix.setSizes(((n, None), (len(owned_key), None)))
    matrix.setType(PETSc.Mat.Type.AIJ)
    matrix.setPreallocationCSR((pointer, number.astype(PETSc.IntType), weights))
    component, point = _unpack(owned_key)
    coarse = _Level(point * float(step), np.eye(3)[component], np.zeros((len(point), 2)))
    return matrix, coarse


def _pack(component: int, point: np.ndarray) -> np.ndarray:
    """Key that sorts by component, then along lines of the component's own yarns."""
    line, along = (point[:, 0], point[:, 1]) if component == 1 else (point[:, 1], point[:, 0])
    return (np.int64(component) << 60) + ((line + 2**29) << 30) + (along + 2**29)


def _unpack(key: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    component = key >> 60
    line = ((key >> 30) & (2**30 - 1)) - 2**29
    along = (key & (2**30 - 1)) - 2**29
    weft = (component == 1)[:, None]
    return component, np.where(weft, np.stack([line, along], 1), np.stack([along, line], 1))


def _number(linear, keys, point, strong):
    """Global numbers of coarse unknowns; -1 for those that no strong weight asks for. Collective.

    Returns
    -------
    number : int64 (n,), one for each key
    owned_key : int64, this rank's coarse unknowns, ascending
    """
    network = linear.network
    comm, partition = network.comm, network.partition
    unique, first, inverse = np.unique(keys, return_index=True, return_inverse=True)
    asked = np.zeros(len(unique), bool)
    np.logical_or.at(asked, inverse, strong)
    box = partition.box
    low, high = box[:, 0].min(axis=0), box[:, 1].max(axis=0) - 1
    owner = partition.owner(np.clip(point[first], low, high))
    order = np.argsort(owner, kind="stable")
    send_count = np.bincount(owner, minlength=comm.size).astype(np.int32)
    receive_count = network.exchange.counts(send_count)
    out = np.column_stack([unique[order], asked[order]])
    received = network.exchange.alltoall(out, send_count, receive_count)
    owned_key = np.unique(received[received[:, 1] > 0, 0])
    offset = comm.exscan(len(owned_key)) or 0
    at = np.searchsorted(owned_key, received[:, 0])
    known = at < len(owned_key)
    known[known] = owned_key[at[known]] == received[known, 0]
    reply = np.where(known, at + offset, -1)
    answers = network.exchange.alltoall(reply, receive_count, send_count)
    number = np.empty(len(unique), np.int64)
    number[order] = answers
    return number[inverse], owned_key

