# SPDX-License-Identifier: MIT
"""Coarse matrices P^T A P on lattices.

PETSc's product takes as long as eighty products with A, since it knows nothing of lattices. Here
a row of A P lies in a window of 4 x 4 coarse points, and a row of P^T A P in one of 5 x 5. Of A
only the half that is to the right of the diagonal is read.
"""

from __future__ import annotations

from dataclasses import dataclass

import numba
import numpy as np
from petsc4py import PETSc
from scipy.sparse import csr_array

from ..parallel import Halo, send_by_rank
from .csr import LocalRows, aij, local_rows, sort_rows

_INT = np.dtype(PETSc.IntType).type


@dataclass
class Corners:
    """Interpolation of a rank's unknowns, by corners of the coarse lattice's cells."""

    cell: np.ndarray  # int64 (n, 2), of each unknown, in this rank's window of the coarse lattice
    pointer: np.ndarray  # compressed rows
    code: np.ndarray  # 4 component + 2 di + dj
    weight: np.ndarray
    number: np.ndarray  # int64 (3, ni, nj), global, of the window's unknowns; -1 for none
    low: np.ndarray  # int64 (2,), first cell of the window


@numba.njit(cache=True, fastmath={"contract"})
def _stencils(fields, cell, pointer, code, weight, a_pointer, a_column, a_value,
              ghost_pointer, ghost_column, ghost_value, above, row, stencils):  # fmt: skip
    """Add P^T U P to ``stencils``; returns the number of couplings that reach too far.

    U has what A has to the right of its diagonal, and half of that: A = U + U^T. fields: a tuple as
    long as a coarse point has unknowns, which the compiler counts. cell, pointer, code, weight: P
    of own unknowns, then ghosts; above: which ghosts come after own ones. row (3, ni, nj): row of
    stencils (rows, 5 * 5 * len(fields)) of each coarse unknown, -1 for none.
    """
    nc = len(fields)
    n = len(a_pointer) - 1
    line, window = 4 * nc, np.zeros(16 * nc)
    at4, far = np.empty(12, np.int64), 0
    for k in range(12):
        at4[k] = ((k // 2) % 2 * 4 + k % 2) * nc + k // 4
    for r in range(n):
        if pointer[r] == pointer[r + 1]:
            continue
        ci, cj = cell[r, 0], cell[r, 1]
        low, high = 2, 0
        for half in range(2):
            if half == 0:
                begin, end, shift = a_pointer[r], a_pointer[r + 1], 0
            else:
                begin, end, shift = ghost_pointer[r], ghost_pointer[r + 1], n
            for e in range(begin, end):
                if half == 0:
                    c, value = np.int64(a_column[e]), a_value[e]
                    if c < r:
                        continue
                    if c == r:
                        value *= 0.5
                else:
                    c, value = np.int64(ghost_column[e]), ghost_value[e]
                    if not above[c]:
                        continue
                    c += shift
                oi, oj = cell[c, 0] - ci + 1, cell[c, 1] - cj + 1
                if oi < 0 or oi > 2 or oj < 0 or oj > 2:
                    far += pointer[c + 1] > pointer[c] and value != 0.0
                    continue
                low, high = min(low, oi), max(high, oi)
                base = (oi * 4 + oj) * nc
                for t in range(pointer[c], pointer[c + 1]):
                    window[np.uint64(base + at4[code[t]])] += value * weight[t]
        for t in range(pointer[r], pointer[r + 1]):
            corner = np.int64(code[t])
            di, dj = (corner // 2) % 2, corner % 2
            stencil = row[corner // 4, ci + di, cj + dj]
            w = weight[t]
            for oi in range(low, high + 2):
                begin = np.uint64(((oi - di + 1) * 5 + 1 - dj) * nc)
                source = np.uint64(oi * line)
                for q in range(np.uint64(line)):
                    stencils[stencil, begin + q] += w * window[source + q]
        window[low * line : (high + 2) * line] = 0.0
    return far


@numba.njit(cache=True)
def _compress(fields, which, component, point, number, row, stencils, pointer, column, value):
    """Some rows of a matrix of stencils and its transpose together, what is not zero.

    Fills pointer, columns and values; returns how many.
    """
    nc, size = len(fields), 0
    for k in range(len(which)):
        r = which[k]
        i, j, own = point[r, 0] - 2, point[r, 1] - 2, component[r]
        for c in range(nc):
            for a in range(5):
                for b in range(5):
                    # In the order of the numbers: along the lines of the component.
                    di, dj = (a, b) if c == 1 else (b, a)
                    # Points that only ghosts know of may lie at the window's rim.
                    if not (0 <= i + di < row.shape[1] and 0 <= j + dj < row.shape[2]):
                        continue
                    other = row[c, i + di, j + dj]
                    if other < 0:
                        continue
                    entry = stencils[r, (di * 5 + dj) * nc + c]
                    entry += stencils[other, (24 - di * 5 - dj) * nc + own]
                    if entry != 0.0:
                        column[size] = number[other]
                        value[size] = entry
                        size += 1
        pointer[k + 1] = size
    return size


def galerkin(fine: PETSc.Mat, corners: Corners, n: int, components: int) -> PETSc.Mat | None:
    """P^T A P, of which this rank owns n rows. Collective.

    None if A couples unknowns further apart than the lattices allow.
    """
    comm = fine.comm.tompi4py()
    with local_rows(fine) as rows:
        if comm.size > 1:
            corners = _with_ghosts(comm, rows, corners)
        number, fields = corners.number, (0,) * components
        component, i, j = np.nonzero(number >= 0)
        row = np.full(number.shape, -1, np.int64)
        row[component, i, j] = np.arange(len(component))
        stencils = np.zeros((len(component), 25 * components))
        far = _stencils(
            fields, corners.cell, corners.pointer, corners.code, corners.weight,
            rows.pointer, rows.column, rows.value,
            rows.ghost_pointer, rows.ghost_column, rows.ghost_value,
            rows.ghost >= fine.getOwnershipRange()[1], row, stencils,
        )  # fmt: skip
    if comm.allreduce(int(far)):
        return None
    row_number, point = number[component, i, j], np.stack([i, j], axis=1)
    order = np.argsort(row_number, kind="stable")
    ends = np.cumsum(comm.allgather(n))
    offset = ends[comm.rank] - n
    begin, end = np.searchsorted(row_number, [offset, offset + n], sorter=order)

    def compressed(which: np.ndarray):
        """Pointer, columns and values of some rows."""
        room = len(which) * stencils.shape[1]
        pointer, column, value = (
            np.zeros(len(which) + 1, _INT),
            np.empty(room, _INT),
            np.empty(room),
        )
        size = _compress(
            fields, which, component, point, row_number, row, stencils, pointer, column, value
        )
        return pointer, column[:size], value[:size]

    own, other = order[begin:end], np.concatenate([order[:begin], order[end:]])
    pointer, column, value = compressed(own)
    # Rows that only other ranks know of are empty here.
    pointer = pointer[np.searchsorted(row_number[own], np.arange(offset, offset + n + 1))]
    sort_rows(pointer, column, value)
    if comm.size > 1:  # what other ranks have found of this one's rows
        lengths, *theirs = compressed(other)
        place = np.repeat(row_number[other], np.diff(lengths))
        owner = np.searchsorted(ends, place, side="right")
        place, *theirs = send_by_rank(comm, owner, place, *theirs)
        shape = n, ends[-1]
        total = csr_array((value, column, pointer), shape)
        total = total + csr_array((theirs[1], (place - offset, theirs[0])), shape)
        pointer, column, value = total.indptr, total.indices, total.data
    return aij(comm, (n, n), pointer, column, value)


def _with_ghosts(comm, rows: LocalRows, corners: Corners) -> Corners:
    """Corners with those of the matrix's ghosts, and their numbers, added. Collective."""
    n = len(rows.pointer) - 1
    halo = Halo.of_numbers(comm, n, rows.ghost)
    sent = halo.exported
    # A row as a record: cell, weights by code, numbers by code.
    record = np.zeros((len(sent), 26))
    record[:, 14:] = -1
    entries = np.arange(len(corners.code)), corners.code, corners.pointer
    picked = csr_array(entries, (n, 12))[sent].tocoo()
    which, code, entry = picked.row, picked.col, picked.data
    corner = corners.cell[sent][which] + np.stack([(code // 2) % 2, code % 2], axis=1)
    record[:, :2] = corners.cell[sent] + corners.low
    record[which, 2 + code] = corners.weight[entry]
    record[which, 14 + code] = corners.number[code // 4, corner[:, 0], corner[:, 1]]
    received = halo.to_ghosts(record)
    cell = received[:, :2].astype(np.int64) - corners.low
    which, code = np.nonzero(received[:, 14:] >= 0)
    pointer = np.searchsorted(which, np.arange(1, len(received) + 1))
    i, j = cell[which, 0] + (code // 2) % 2, cell[which, 1] + code % 2
    number = corners.number.copy()
    number[code // 4, i, j] = received[which, 14 + code]
    return Corners(
        np.concatenate([corners.cell, cell]),
        np.concatenate([corners.pointer, corners.pointer[-1] + pointer]),
        np.concatenate([corners.code, code.astype(np.uint8)]),
        np.concatenate([corners.weight, received[which, 2 + code]]),
        number,
        corners.low,
    )
