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

import numba
import numpy as np
from mpi4py import MPI
from petsc4py import PETSc

from ..net.network import Network, Partition
from ..parallel import Halo, ask, find_sorted, send_by_rank
from ..small.network import LinearNetwork
from .csr import LocalRows, aij, local_rows
from .linear import Hierarchy
from .yarns import OnYarns, YarnSmoother

# The smallest weight of a corner of a bilinear cell that has the largest one.
_STRONG = 0.25 - 1e-9
_RIM = 2  # cells around those of a rank's own unknowns
_INT = np.dtype(PETSc.IntType).type
# Sweeps through both families before and after the coarse grids. The stiffer the yarns, the less
# do smooth displacements resemble what is left at re-entrant corners: sweep more often, there.
SWEEPS, STIFF_SWEEPS = 2, 4
# From which contrast of the diagonal on yarns are stiff: E/G of some 10^4.
STIFF = 3e4
COARSEST = 3000


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
    lines : OnYarns, optional
        On which yarns they lie: for the smoother of the finest level.
    """

    point: np.ndarray
    values: np.ndarray
    slopes: np.ndarray
    lines: OnYarns | None = None


def yarn_multigrid(linear: LinearNetwork, matrix: PETSc.Mat) -> Hierarchy:
    """Coarse levels and smoother for a LinearNetwork's stiffness. Collective."""
    return hierarchy(matrix, linear.network.partition, unknowns_of(linear))


def hierarchy(
    matrix: PETSc.Mat, partition: Partition, unknowns: Unknowns, coarsest: int = COARSEST
) -> Hierarchy:
    """Interpolations, coarse matrices and smoother for a matrix. Collective.

    Parameters
    ----------
    matrix : PETSc.Mat (AIJ)
        Symmetric; it couples points of the lattice that are less than two pitches apart.
    partition : Partition
        Says which rank owns a point of the lattice.
    unknowns : Unknowns
        In the order of the matrix's rows. What is prescribed has factors of zero.
    coarsest : int
        Unknowns that are few enough for a factorisation.
    """
    comm = matrix.comm.tompi4py()
    # Chequerboards are a field of their own, if any unknown takes part in them.
    components = 3 if comm.allreduce(bool(unknowns.values[:, 2].any()), MPI.LOR) else 2
    interpolations, matrices = [], []
    level, coarse, step = matrix, unknowns, 2
    while level.getSize()[0] > coarsest:
        interpolation, coarse, corners = _interpolation(comm, partition, coarse, step)
        if interpolation.getSize()[1] > 0.7 * interpolation.getSize()[0]:
            interpolation.destroy()  # a network of few yarns across: nothing to gain
            break
        interpolations.append(interpolation)
        product = _galerkin(level, corners, coarse, components)
        if product is None:
            product = level.ptap(interpolation)
        for option in (PETSc.Mat.Option.SYMMETRIC, PETSc.Mat.Option.SPD):
            product.setOption(option, True)
        matrices.append(product)
        level, step = product, 2 * step
    smoother = None
    if unknowns.lines is not None:
        smoother = YarnSmoother(matrix, unknowns.lines)
    sweeps = STIFF_SWEEPS if _contrast(matrix) > STIFF else SWEEPS
    return Hierarchy(interpolations, matrices, smoother, sweeps)


def _contrast(matrix: PETSc.Mat) -> float:
    """Large entries of the diagonal over small ones, without a tenth at either end. Collective."""
    diagonal = matrix.getDiagonal()
    stride = diagonal.getLocalSize() // 60_000 * 6 + 1  # does not pass over 1 of 2 or of 3 for good
    entries = abs(diagonal.getArray(readonly=True))[::stride]
    low, high = np.percentile(entries, (10, 90)) if len(entries) else (1.0, 1.0)
    diagonal.destroy()
    contrast = high / low if low > 0.0 else np.inf
    return float(matrix.comm.tompi4py().allreduce(contrast, MPI.MAX))


def interpolations(linear: LinearNetwork, coarsest: int = COARSEST) -> list[PETSc.Mat]:
    """Interpolation matrices for a LinearNetwork, finest first. Collective.

    The caller destroys them.
    """
    comm, partition = linear.network.comm, linear.network.partition
    coarse, step, matrices = unknowns_of(linear), 2, []
    size = comm.allreduce(len(coarse.point))
    while size > coarsest:
        matrix, coarse, _ = _interpolation(comm, partition, coarse, step)
        matrices.append(matrix)
        size, step = matrix.getSize()[1], 2 * step
    return matrices


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
        OnYarns(np.repeat(line, d, axis=0), np.repeat(place, d, axis=0)),
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
    """Weights of a corner of row r's cell for component c: bilinear, the value's, the slope's."""
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
def _rows(cell, share, step, values, slopes, number, pointer, column, code, weight):
    """Rows of the interpolation; number (3, ni, nj) of a corner, -1 where it does not exist.

    Entries come by component and corner; code is 4 component + 2 di + dj.

    The weights of corners that do not exist go to the others of the same field, so that constants
    are kept. Returns the number of entries.
    """
    size = 0
    for r in range(len(cell)):
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
                    column[size], weight[size] = at, value + turn
                    code[size] = 4 * c + 2 * di + dj
                    size += 1
            if lost == 0.0:
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
    return size


@numba.njit(cache=True)
def _sort_rows(pointer, column, value):
    """Put the entries of each row in the order of their columns, in place."""
    for r in range(len(pointer) - 1):
        begin = pointer[r]
        for a in range(begin + 1, pointer[r + 1]):
            col, w, b = column[a], value[a], a
            while b > begin and column[b - 1] > col:
                column[b], value[b] = column[b - 1], value[b - 1]
                b -= 1
            column[b], value[b] = col, w


@dataclass
class _Step:
    """Interpolation of a rank's unknowns, by corners of the coarse lattice's cells.

    Attributes
    ----------
    cell : int64 (n, 2)
        The cell of each unknown, in this rank's window of the coarse lattice.
    pointer, code, weight
        Compressed rows; code is 4 component + 2 di + dj.
    number : int64 (3, ni, nj)
        Global numbers of the window's unknowns, -1 for none.
    low : int64 (2,)
        First cell of the window.
    """

    cell: np.ndarray
    pointer: np.ndarray
    code: np.ndarray
    weight: np.ndarray
    number: np.ndarray
    low: np.ndarray


def _interpolation(
    comm: MPI.Intracomm, partition: Partition, fine: Unknowns, step: int
) -> tuple[PETSc.Mat, Unknowns, _Step]:
    """Interpolation from the lattice of ``step`` pitches to a finer level. Collective."""
    n = len(fine.point)
    cell = np.floor(fine.point / step).astype(np.int64)
    share = fine.point / step - cell
    # Ghosts may lie in cells beside those of this rank.
    low = (cell.min(axis=0) if n else np.zeros(2, np.int64)) - _RIM
    cell -= low
    shape = cell.max(axis=0, initial=0) + 2 + _RIM
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
    most = 4 * (np.count_nonzero(fine.values) + np.count_nonzero(fine.slopes))
    pointer = np.zeros(n + 1, np.int64)
    column: np.ndarray = np.empty(most, _INT)
    code: np.ndarray = np.empty(most, np.uint8)
    weight: np.ndarray = np.empty(most)
    size = _rows(*given, number, pointer, column, code, weight)
    column, code, weight = column[:size], code[:size], weight[:size]
    by_corner = _Step(cell, pointer, code, weight.copy(), number, low)
    _sort_rows(pointer, column, weight)
    matrix = aij(comm, (n, len(point)), pointer, column, weight)
    coarse = Unknowns(point * float(step), np.eye(3)[component_owned], np.zeros((len(point), 2)))
    return matrix, coarse, by_corner


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
    owned = np.zeros(0, np.int64)

    def numbers(asked: np.ndarray) -> np.ndarray:
        nonlocal owned
        owned = np.unique(asked[asked[:, 1] > 0, 0])
        place = find_sorted(owned, asked[:, 0])
        return np.where(place >= 0, place + (comm.exscan(len(owned)) or 0), -1)

    number = ask(comm, owner, np.column_stack([_pack(component, point), strong]), numbers)
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


# -- Galerkin products -------------------------------------------------------------------------
#
# PETSc's P^T A P takes as long as eighty products with A, since it knows nothing of lattices. Here
# a row of A P lies in a window of 4 x 4 coarse points, and a row of P^T A P in one of 5 x 5.


@numba.njit(cache=True, fastmath={"contract"})
def _stencils(num_components, cell, pointer, code, weight, a_pointer, a_column, a_value,
              ghost_pointer, ghost_column, ghost_value, row, stencils):  # fmt: skip
    """Add P^T A P to ``stencils``; returns the number of couplings that reach too far.

    cell, pointer, code, weight: P of own unknowns, then ghosts. row (3, ni, nj): row of stencils
    (rows, 5 * 5 * num_components) of each coarse unknown, -1 for none.
    """
    nc = num_components
    n = len(a_pointer) - 1
    line, window = 4 * nc, np.zeros(16 * nc)
    at4, far = np.empty(12, np.int64), 0
    for k in range(12):
        at4[k] = ((k // 2) % 2 * 4 + k % 2) * nc + k // 4
    for r in range(n):
        if pointer[r] == pointer[r + 1]:
            continue
        window[:] = 0.0
        ci, cj = cell[r, 0], cell[r, 1]
        for half in range(2):
            if half == 0:
                begin, end, shift = a_pointer[r], a_pointer[r + 1], 0
            else:
                begin, end, shift = ghost_pointer[r], ghost_pointer[r + 1], n
            for e in range(begin, end):
                if half == 0:
                    c, value = np.int64(a_column[e]), a_value[e]
                else:
                    c, value = np.int64(ghost_column[e]) + shift, ghost_value[e]
                oi, oj = cell[c, 0] - ci + 1, cell[c, 1] - cj + 1
                if oi < 0 or oi > 2 or oj < 0 or oj > 2:
                    far += pointer[c + 1] > pointer[c] and value != 0.0
                    continue
                base = (oi * 4 + oj) * nc
                for t in range(pointer[c], pointer[c + 1]):
                    window[np.uint64(base + at4[code[t]])] += value * weight[t]
        for t in range(pointer[r], pointer[r + 1]):
            corner = np.int64(code[t])
            di, dj = (corner // 2) % 2, corner % 2
            stencil = row[corner // 4, ci + di, cj + dj]
            w = weight[t]
            for oi in range(4):
                begin = np.uint64(((oi - di + 1) * 5 + 1 - dj) * nc)
                source = np.uint64(oi * line)
                for q in range(np.uint64(line)):
                    stencils[stencil, begin + q] += w * window[source + q]
    return far


@numba.njit(cache=True)
def _compress(num_components, component, point, number, stencils, pointer, column, value):
    """Compressed rows of stencils; with empty ``column`` the pointer only."""
    size = 0
    for r in range(len(component)):
        for c in range(num_components):
            for a in range(5):
                for b in range(5):
                    # In the order of the numbers: along the lines of the component.
                    i, j = (a, b) if c == 1 else (b, a)
                    entry = stencils[r, (i * 5 + j) * num_components + c]
                    if entry == 0.0:
                        continue
                    if len(column):
                        column[size] = number[c, point[r, 0] + i - 2, point[r, 1] + j - 2]
                        value[size] = entry
                    size += 1
        pointer[r + 1] = size


def _galerkin(fine: PETSc.Mat, step: _Step, coarse: Unknowns, components: int) -> PETSc.Mat | None:
    """P^T A P. Collective; None if A couples unknowns further apart than the lattices allow."""
    comm = fine.comm.tompi4py()
    number = step.number
    with local_rows(fine) as rows:
        cell, pointer, code, weight = step.cell, step.pointer, step.code, step.weight
        if comm.size > 1:
            ghosts = _ghost_rows(comm, rows, step)
            number = number.copy()
            cell = np.concatenate([cell, ghosts[0]])
            pointer = np.concatenate([pointer, pointer[-1] + ghosts[1][1:]])
            code, weight = np.concatenate([code, ghosts[2]]), np.concatenate([weight, ghosts[3]])
            i, j, k = ghosts[4]
            number[k // 4, i, j] = ghosts[5]
        there = np.argwhere(number >= 0)
        component, point = there[:, 0], there[:, 1:]
        row = np.full(number.shape, -1, np.int64)
        row[component, point[:, 0], point[:, 1]] = np.arange(len(there))
        stencils = np.zeros((len(there), 25 * components))
        far = _stencils(
            components, cell, pointer, code, weight, rows.pointer, rows.column, rows.value,
            rows.ghost_pointer, rows.ghost_column, rows.ghost_value, row, stencils,
        )  # fmt: skip
    if comm.allreduce(int(far)):
        return None
    own_number = number[component, point[:, 0], point[:, 1]]
    n = len(coarse.point)
    offset = comm.exscan(n) or 0
    order = np.argsort(own_number, kind="stable")
    begin, end = np.searchsorted(own_number[order], [offset, offset + n])
    mine = order[begin:end]
    part = _compressed(components, component[mine], point[mine], number, stencils[mine])
    if comm.size > 1:
        other = np.concatenate([order[:begin], order[end:]])
        sent = _compressed(components, component[other], point[other], number, stencils[other])
        part = _with_contributions(comm, n, offset, own_number[mine], part, own_number[other], sent)
    else:
        _sort_rows(*part)
    return aij(comm, (n, n), *part)


def _compressed(components, component, point, number, stencils):
    pointer = np.zeros(len(component) + 1, np.int64)
    given = components, component, point, number, stencils, pointer
    _compress(*given, np.zeros(0, np.int64), np.zeros(0))
    column, value = np.empty(pointer[-1], np.int64), np.empty(pointer[-1])
    if len(column):
        _compress(*given, column, value)
    return pointer, column, value


def _ghost_rows(comm, rows: LocalRows, step: _Step):
    """Rows of P of the matrix's ghosts, and the numbers of the corners they hang on. Collective."""
    n = len(rows.pointer) - 1
    halo = Halo.of_numbers(comm, n, rows.ghost)
    sent = halo.exported
    # A row as a record: cell, weights by code, numbers by code.
    record = np.zeros((len(sent), 26))
    record[:, 14:] = -1
    lengths = np.diff(step.pointer)[sent]
    which = np.repeat(np.arange(len(sent)), lengths)
    entry = np.repeat(step.pointer[sent], lengths) + (
        np.arange(len(which)) - np.repeat(np.cumsum(lengths) - lengths, lengths)
    )
    code = step.code[entry].astype(np.int64)
    corner = step.cell[sent][which] + np.stack([(code // 2) % 2, code % 2], axis=1)
    record[:, :2] = step.cell[sent] + step.low
    record[which, 2 + code] = step.weight[entry]
    record[which, 14 + code] = step.number[code // 4, corner[:, 0], corner[:, 1]]
    received = halo.to_ghosts(record)
    cell = received[:, :2].astype(np.int64) - step.low
    which, code = np.nonzero(received[:, 14:] >= 0)
    pointer = np.searchsorted(which, np.arange(len(received) + 1))
    weight = received[which, 2 + code]
    i, j = cell[which, 0] + (code // 2) % 2, cell[which, 1] + code % 2
    numbers = received[which, 14 + code].astype(np.int64)
    return cell, pointer, code.astype(np.uint8), weight, (i, j, code), numbers


def _with_contributions(comm, n, offset, row_number, part, other_number, sent):
    """Own rows with what other ranks have found of them added. Collective."""
    pointer, column, value = sent
    rows = np.repeat(other_number, np.diff(pointer))
    ends = np.cumsum(comm.allgather(n))
    owner = np.searchsorted(ends, rows, side="right")
    places, values = send_by_rank(comm, owner, np.stack([rows, column], axis=1), value)
    _sort_rows(*part)
    lengths = np.zeros(n, np.int64)  # rows that only others know of are empty here
    lengths[row_number - offset] = np.diff(part[0])
    part = np.concatenate([[0], np.cumsum(lengths)]), *part[1:]
    order = np.lexsort((places[:, 1], places[:, 0]))
    start = np.searchsorted(places[order, 0], offset + np.arange(n + 1))
    return _merge_rows(*part, start, places[order, 1], values[order])


@numba.njit(cache=True)
def _merge_rows(pointer, column, value, extra_pointer, extra_column, extra_value):
    """Sum of two matrices in compressed rows, columns ascending; the second's may repeat."""
    n, size = len(pointer) - 1, 0
    columns = np.empty(len(column) + len(extra_column), np.int64)
    values = np.empty(len(columns))
    start = np.zeros(n + 1, np.int64)
    for r in range(n):
        a, b = pointer[r], extra_pointer[r]
        while a < pointer[r + 1] or b < extra_pointer[r + 1]:
            own = b == extra_pointer[r + 1] or (a < pointer[r + 1] and column[a] <= extra_column[b])
            c, v = (column[a], value[a]) if own else (extra_column[b], extra_value[b])
            if own:
                a += 1
            else:
                b += 1
            if size > start[r] and columns[size - 1] == c:
                values[size - 1] += v
            else:
                columns[size], values[size] = c, v
                size += 1
        start[r + 1] = size
    return start, columns[:size], values[:size]
