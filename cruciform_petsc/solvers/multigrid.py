# SPDX-License-Identifier: MIT
"""Multigrid that follows the yarns: PETSc's PCMG on lattices of twice, four times ... the pitch.

The paper, after Torbe, calls the cruciform "a coarser representative grid than that formed by
yarns". Here the coarse spaces are those grids: displacements along warp and weft on the points of a
lattice of twice the pitch, interpolated bilinearly; yarn rotations are taken from the slope of the
interpolated displacement. Coarse matrices are Galerkin products. On the finest level yarns are
solved whole, one family after the other (yarns.py). On the coarse ones the component along the warp
is numbered along warp lines and the one along the weft along weft lines, so that the stiff
couplings are neighbours and incomplete factorisations keep them.

Without yarn bending a third component is kept: crossovers that turn to and fro in a chequerboard
cost no energy, whatever the fine matrix's smoother does, and no smooth displacement resembles them.

Any matrix whose unknowns can be told as `Unknowns` can be solved so; `unknowns_of` does it for a
LinearNetwork.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial

import numba
import numpy as np
from mpi4py import MPI
from petsc4py import PETSc

from ..assembly import LinearNetwork
from ..network import Network, Partition
from .linear import Hierarchy
from .yarns import YarnLines, YarnSmoother

# The smallest weight of a corner of a bilinear cell that has the largest one.
_STRONG = 0.25 - 1e-9
# Sweeps through both families before and after the coarse grids.
SWEEPS = 2
# Pitches of the first coarse lattice, and how much coarser each further one is.
FIRST, FACTOR = 2, 2


@dataclass
class Unknowns:
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
    lines : YarnLines, optional
        On which yarns they lie: for the smoother of the finest level.
    """

    point: np.ndarray
    values: np.ndarray
    slopes: np.ndarray
    lines: YarnLines | None = None


def yarn_multigrid(linear: LinearNetwork, coarsest: int = 3000) -> Hierarchy:
    """Interpolations and smoother for a LinearNetwork's stiffness. Collective.

    The caller destroys the matrices (LinearSolver does).
    """
    return hierarchy(linear.network.comm, linear.network.partition, unknowns_of(linear), coarsest)


def hierarchy(
    comm: MPI.Intracomm, partition: Partition, unknowns: Unknowns, coarsest: int = 3000
) -> Hierarchy:
    """Interpolations, finest first, down to about ``coarsest`` unknowns, and smoother. Collective.

    Parameters
    ----------
    comm : mpi4py communicator
    partition : Partition
        Says which rank owns a point of the lattice.
    unknowns : Unknowns
        In the order of the matrix's rows. What is prescribed has factors of zero.
    """
    level, step, matrices = unknowns, FIRST, []
    size = comm.allreduce(len(unknowns.point))
    while size > coarsest:
        matrix, level = _interpolation(comm, partition, level, step)
        coarse = matrix.getSize()[1]
        if coarse > 0.7 * size:  # a network of few yarns across: nothing to gain
            matrix.destroy()
            break
        matrices.append(matrix)
        size, step = coarse, FACTOR * step
    smoother = None
    if unknowns.lines is not None:
        smoother = partial(YarnSmoother, lines=unknowns.lines)
    return Hierarchy(matrices, smoother, SWEEPS)


def interpolations(linear: LinearNetwork, coarsest: int = 3000) -> list[PETSc.Mat]:
    """Interpolation matrices of yarn_multigrid alone; the caller destroys them. Collective."""
    return yarn_multigrid(linear, coarsest).interpolations


def unknowns_of(linear: LinearNetwork) -> Unknowns:
    """What the unknowns of a LinearNetwork are to the multigrid."""
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
    line, place = _lines(network, lattice, warp)
    return Unknowns(
        np.repeat(lattice, d, axis=0),
        values.reshape(-1, 3),
        slopes.reshape(-1, 2),
        YarnLines(np.repeat(line, d, axis=0), np.repeat(place, d, axis=0)),
    )


def _lines(network: Network, lattice: np.ndarray, warp: np.ndarray):
    """Yarns that owned nodes lie on, int32 (n, 2), and where on them, float (n, 2)."""
    owned = network.num_nodes_owned
    line = np.full((owned, 2), -1, np.int32)
    low = network.partition.box[:, 0].min(axis=0)  # numbers of yarns from 0 up
    line[warp, 0] = np.round(lattice[warp, 1]) - low[1]
    line[~warp, 1] = np.round(lattice[~warp, 0]) - low[0]
    # Ends on the outline lie on the crossing yarn, too, at its crossover.
    edge = network.boundary_crossovers
    for arm in range(4):
        ends = edge[~network.arm_is_shared[edge, arm]]
        nodes, ij = network.arm_node[ends, arm], network.crossover_ij[ends]
        line[nodes] = (ij - low)[:, ::-1]
    return line, lattice


@numba.njit(cache=True)
def _corner(r, di, dj, c, step, share, values, slopes):
    """Weight of a corner of row r's cell for component c: (bilinear, of the value, of the slope)."""
    wi = share[r, 0] if di else 1.0 - share[r, 0]
    wj = share[r, 1] if dj else 1.0 - share[r, 1]
    turn = 0.0
    if c == 0:
        turn = (2 * dj - 1) * wi / step * slopes[r, 1]
    elif c == 1:
        turn = (2 * di - 1) * wj / step * slopes[r, 0]
    return wi * wj, wi * wj * values[r, c], turn


@numba.njit(cache=True)
def _mark(cell, share, step, values, slopes, grid):
    """Note in grid (3, ni, nj) which corners are asked for: 1, and by a strong weight: 3."""
    for r in range(len(cell)):
        for c in range(3):
            for di in range(2):
                for dj in range(2):
                    bilinear, value, turn = _corner(r, di, dj, c, step, share, values, slopes)
                    if value != 0.0 or turn != 0.0:
                        grid[c, cell[r, 0] + di, cell[r, 1] + dj] |= 3 if bilinear >= _STRONG else 1


@numba.njit(cache=True)
def _rows(cell, share, step, values, slopes, number, pointer, column, weight):
    """Rows of the interpolation; number (3, ni, nj) of a corner, -1 where it does not exist.

    The weights of corners that do not exist go to the others of the same field, so that constants
    are kept. Called with empty ``column`` it finds the pointer only.
    """
    size = 0
    for r in range(len(cell)):
        begin = size
        for c in range(3):
            lost, total, first = 0.0, 0.0, size
            for di in range(2):
                for dj in range(2):
                    _, value, turn = _corner(r, di, dj, c, step, share, values, slopes)
                    if value == 0.0 and turn == 0.0:
                        continue
                    at = number[c, cell[r, 0] + di, cell[r, 1] + dj]
                    if at < 0:
                        lost += value + turn
                        continue
                    total += 1.0 if turn != 0.0 else abs(value + turn)
                    if len(column):
                        column[size], weight[size] = at, value + turn
                    size += 1
            if not len(column) or lost == 0.0:
                continue
            k = first
            for di in range(2):
                for dj in range(2):
                    _, value, turn = _corner(r, di, dj, c, step, share, values, slopes)
                    at = number[c, cell[r, 0] + di, cell[r, 1] + dj]
                    if (value != 0.0 or turn != 0.0) and at >= 0:
                        own = 1.0 if turn != 0.0 else abs(value + turn)
                        weight[k] += lost * own / total
                        k += 1
        pointer[r + 1] = size
        if len(column):  # by ascending column
            for a in range(begin + 1, size):
                col, w, b = column[a], weight[a], a
                while b > begin and column[b - 1] > col:
                    column[b], weight[b] = column[b - 1], weight[b - 1]
                    b -= 1
                column[b], weight[b] = col, w


def _interpolation(
    comm: MPI.Intracomm, partition: Partition, fine: Unknowns, step: int
) -> tuple[PETSc.Mat, Unknowns]:
    """Interpolation from the lattice of ``step`` pitches to a finer level. Collective."""
    n = len(fine.point)
    cell = np.floor(fine.point / step).astype(np.int64)
    share = fine.point / step - cell
    low = cell.min(axis=0) if n else np.zeros(2, np.int64)
    cell -= low
    shape = cell.max(axis=0, initial=0) + 2
    grid = np.zeros((3, *shape), np.uint8)
    given = cell, share, float(step), fine.values, fine.slopes
    _mark(*given, grid)
    # Components along warp and chequerboards by warp lines, along weft by weft lines.
    asked = []
    for c in range(3):
        lines = np.argwhere(grid[c].T if c != 1 else grid[c])
        asked.append(lines[:, ::-1] if c != 1 else lines)
    component = np.repeat(np.arange(3), [len(part) for part in asked])
    i, j = np.concatenate(asked).T
    strong = grid[component, i, j] == 3
    answer, component_owned, point = _number(
        comm, partition, step, component, np.stack([i, j], axis=1) + low, strong
    )
    number = np.full((3, *shape), -1, np.int64)
    number[component, i, j] = answer
    pointer = np.zeros(n + 1, np.int64)
    nothing = np.zeros(0, PETSc.IntType), np.zeros(0)
    _rows(*given, number, pointer, *nothing)
    column, weight = np.empty(pointer[-1], PETSc.IntType), np.empty(pointer[-1])
    if len(column):
        _rows(*given, number, pointer, column, weight)
    matrix = PETSc.Mat().create(comm=comm)
    matrix.setSizes(((n, None), (len(point), None)))
    matrix.setType(PETSc.Mat.Type.AIJ)
    matrix.setPreallocationCSR((pointer.astype(PETSc.IntType), column, weight))
    coarse = Unknowns(point * float(step), np.eye(3)[component_owned], np.zeros((len(point), 2)))
    return matrix, coarse


def _number(comm, partition, step, component, point, strong):
    """Global numbers of coarse unknowns; -1 for those that no strong weight asks for. Collective.

    Returns
    -------
    number : int64 (n,), one for each unknown asked for
    component : int (n_owned,), point : int64 (n_owned, 2)
        This rank's coarse unknowns.
    """
    box = partition.box
    low, high = box[:, 0].min(axis=0), box[:, 1].max(axis=0) - 1
    owner = partition.owner(np.clip(point * step, low, high))
    order = np.argsort(owner, kind="stable")
    send = np.bincount(owner, minlength=comm.size).astype(np.int32)
    receive = np.empty_like(send)
    comm.Alltoall(send, receive)
    out = np.column_stack([_pack(component, point), strong])[order]
    received = np.empty((int(receive.sum()), 2), np.int64)
    comm.Alltoallv([np.ascontiguousarray(out), 2 * send], [received, 2 * receive])
    owned = np.unique(received[received[:, 1] > 0, 0])
    offset = comm.exscan(len(owned)) or 0
    at = np.searchsorted(owned, received[:, 0])
    known = at < len(owned)
    known[known] = owned[at[known]] == received[known, 0]
    reply = np.where(known, at + offset, -1)
    answers = np.empty(len(order), np.int64)
    comm.Alltoallv([reply, receive], [answers, send])
    number = np.empty(len(order), np.int64)
    number[order] = answers
    return number, *_unpack(owned)


def _pack(component: np.ndarray, point: np.ndarray) -> np.ndarray:
    """Keys that sort by component, then along lines of the component's own yarns."""
    weft = component == 1
    line, along = np.where(weft, point.T, point.T[::-1])
    return (component.astype(np.int64) << 60) + ((line + 2**29) << 30) + (along + 2**29)


def _unpack(key: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    component = key >> 60
    line = ((key >> 30) & (2**30 - 1)) - 2**29
    along = (key & (2**30 - 1)) - 2**29
    weft = (component == 1)[:, None]
    return component, np.where(weft, np.stack([line, along], 1), np.stack([along, line], 1))
