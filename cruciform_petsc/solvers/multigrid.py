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

Any matrix whose unknowns can be told as `Unknowns` can be solved so.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numba
import numpy as np
from mpi4py import MPI
from petsc4py import PETSc

from ..parallel import ask, find_sorted, most
from .csr import aij, sort_rows
from .galerkin import Corners, galerkin
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
    """

    point: np.ndarray  # float (n, 2), lattice coordinates, in fine pitches
    values: np.ndarray  # float (n, 3), factors of the fields' values; zero where prescribed
    slopes: np.ndarray  # float (n, 2), factors of the slopes, per fine pitch
    # Ranks that own lattice points, int (m, 2) -> int (m,); also of points outside the cloth.
    owner: Callable[[np.ndarray], np.ndarray]
    lines: OnYarns | None = None  # on which yarns they lie: for the finest level's smoother


@dataclass
class Hierarchy:
    """A geometric multigrid's coarse levels. LinearSolver frees all of it."""

    interpolations: list[PETSc.Mat]  # finest first
    matrices: list[PETSc.Mat]  # of the coarse levels
    smoother: YarnSmoother | None = None  # of the finest level; without it PETSc's, by options
    sweeps: int = SWEEPS  # of it, before and after; -mg_yarn_sweeps overrules, 0 takes PETSc's


def hierarchy(matrix: PETSc.Mat, unknowns: Unknowns, coarsest: int = COARSEST) -> Hierarchy:
    """Interpolations, coarse matrices and smoother for a matrix. Collective.

    The matrix is symmetric and couples points of the lattice that are less than two pitches apart;
    ``unknowns`` are in the order of its rows, ``coarsest`` of them few enough for a factorisation.
    """
    comm = matrix.comm.tompi4py()
    # Chequerboards are a field of their own, if any unknown takes part in them.
    components = 3 if comm.allreduce(bool(unknowns.values[:, 2].any()), MPI.LOR) else 2
    interpolations, matrices = [], []
    level, coarse, step = matrix, unknowns, 2
    while level.getSize()[0] > coarsest:
        prolongation, coarse, corners = interpolation(comm, coarse, step)
        if prolongation.getSize()[1] > 0.7 * prolongation.getSize()[0]:
            prolongation.destroy()  # a network of few yarns across: nothing to gain
            break
        product = galerkin(level, corners, len(coarse.point), components)
        if product is None:
            product = level.ptap(prolongation)
        for option in (PETSc.Mat.Option.SYMMETRIC, PETSc.Mat.Option.SPD):
            product.setOption(option, True)
        interpolations.append(prolongation)
        matrices.append(product)
        level, step = product, 2 * step
    smoother = None if unknowns.lines is None else YarnSmoother(matrix, unknowns.lines)
    sweeps = STIFF_SWEEPS if contrast(matrix) > STIFF else SWEEPS
    return Hierarchy(interpolations, matrices, smoother, sweeps)


def contrast(matrix: PETSc.Mat) -> float:
    """Large entries of the diagonal over small ones, without a tenth at either end. Collective."""
    diagonal = matrix.getDiagonal()
    stride = diagonal.getLocalSize() // 60_000 * 6 + 1  # does not pass over 1 of 2 or of 3 for good
    entries = abs(diagonal.getArray(readonly=True))[::stride]
    low, high = np.percentile(entries, (10, 90)) if len(entries) else (1.0, 1.0)
    diagonal.destroy()
    contrast = high / low if low > 0.0 else np.inf
    return most(matrix.comm.tompi4py(), contrast)


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
    size, part = 0, np.empty(4)
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
                    part[size - first] = 1.0 if turn != 0.0 else abs(value + turn)
                    total += part[size - first]
                    column[size], weight[size] = at, value + turn
                    code[size] = 4 * c + 2 * di + dj
                    size += 1
            if lost != 0.0:
                for k in range(first, size):
                    weight[k] += lost * part[k - first] / total
        pointer[r + 1] = size
    return size


def interpolation(
    comm: MPI.Intracomm, fine: Unknowns, step: int
) -> tuple[PETSc.Mat, Unknowns, Corners]:
    """Interpolation from the lattice of ``step`` pitches to a finer level. Collective."""
    n = len(fine.point)
    cell = np.floor(fine.point / step).astype(np.int64)
    share = fine.point / step - cell
    # Ghosts may lie in cells beside those of this rank.
    low = (cell.min(axis=0) if n else np.zeros(2, np.int64)) - _RIM
    cell -= low
    shape = cell.max(axis=0, initial=0) + 2 + _RIM
    grid = np.zeros((3, *shape), np.uint8)
    geometry = cell, share, float(step), fine.values, fine.slopes
    _mark(*geometry, grid)
    component, i, j = np.nonzero(grid)
    strong = grid[component, i, j] == 3
    point = np.stack([i, j], axis=1) + low
    number = np.full((3, *shape), -1, np.int64)
    number[component, i, j], component_owned, point_owned = _number(
        comm, fine.owner(point * step), component, point, strong
    )
    room = 4 * (np.count_nonzero(fine.values) + np.count_nonzero(fine.slopes))
    pointer = np.zeros(n + 1, np.int64)
    entries = np.empty(room, _INT), np.empty(room, np.uint8), np.empty(room)
    size = _rows(*geometry, number, pointer, *entries)
    column, code, weight = (part[:size] for part in entries)
    by_corner = Corners(cell, pointer, code, weight.copy(), number, low)
    sort_rows(pointer, column, weight)
    matrix = aij(comm, (n, len(point_owned)), pointer, column, weight)
    values, slopes = np.eye(3)[component_owned], np.zeros((len(point_owned), 2))
    return matrix, Unknowns(point_owned * float(step), values, slopes, fine.owner), by_corner


def _number(comm, owner, component, point, strong):
    """Global numbers of the coarse unknowns asked for. Collective.

    Returns int64 (n,), -1 for those that no strong weight asks for, and components (n_owned,) and
    points (n_owned, 2) of this rank's coarse unknowns.
    """
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
