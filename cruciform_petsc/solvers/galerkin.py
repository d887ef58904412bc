# SPDX-License-Identifier: MIT
"""Coarse matrices P^T A P on lattices.

PETSc's product takes as long as eighty products with A, since it knows nothing of lattices. Here
a row of A P lies in a window of 4 x 4 coarse points, and a row of P^T A P in one of 5 x 5.
"""

from __future__ import annotations

from dataclasses import dataclass

import numba
import numpy as np
from petsc4py import PETSc
from scipy.sparse import csr_array

from ..parallel import Halo, send_by_rank
from .csr import LocalRows, aij, local_rows, sort_rows


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
def _compress(num_components, component, point, number, stencils, column, value):
    """Columns and values of the rows of stencils, what is not zero."""
    size = 0
    for r in range(len(component)):
        for c in range(num_components):
            for a in range(5):
                for b in range(5):
                    # In the order of the numbers: along the lines of the component.
                    i, j = (a, b) if c == 1 else (b, a)
                    entry = stencils[r, (i * 5 + j) * num_components + c]
                    if entry != 0.0:
                        column[size] = number[c, point[r, 0] + i - 2, point[r, 1] + j - 2]
                        value[size] = entry
                        size += 1


def galerkin(fine: PETSc.Mat, corners: Corners, n: int, components: int) -> PETSc.Mat | None:
    """P^T A P, of which this rank owns n rows. Collective.

    None if A couples unknowns further apart than the lattices allow.
    """
    comm = fine.comm.tompi4py()
    with local_rows(fine) as rows:
        if comm.size > 1:
            corners = _with_ghosts(comm, rows, corners)
        number = corners.number
        component, i, j = np.nonzero(number >= 0)
        row = np.full(number.shape, -1, np.int64)
        row[component, i, j] = np.arange(len(component))
        stencils = np.zeros((len(component), 25 * components))
        far = _stencils(
            components, corners.cell, corners.pointer, corners.code, corners.weight,
            rows.pointer, rows.column, rows.value,
            rows.ghost_pointer, rows.ghost_column, rows.ghost_value, row, stencils,
        )  # fmt: skip
    if comm.allreduce(int(far)):
        return None
    row_number, point = number[component, i, j], np.stack([i, j], axis=1)
    order = np.argsort(row_number, kind="stable")
    ends = np.cumsum(comm.allgather(n))
    offset = ends[comm.rank] - n
    begin, end = np.searchsorted(row_number, [offset, offset + n], sorter=order)

    def compressed(which: np.ndarray):
        """Pointer, columns and values of some rows of the stencils."""
        rows = stencils[which]
        pointer = np.concatenate([[0], np.cumsum(np.count_nonzero(rows, axis=1))])
        column, value = np.empty(pointer[-1], np.int64), np.empty(pointer[-1])
        _compress(components, component[which], point[which], number, rows, column, value)
        return pointer, column, value

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
