# SPDX-License-Identifier: MIT
"""Arrays of a distributed AIJ matrix in NumPy."""

from __future__ import annotations

import ctypes
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

import numba
import numpy as np
from mpi4py import MPI
from petsc4py import PETSc

_INT, _SCALAR = np.dtype(PETSc.IntType), np.dtype(PETSc.ScalarType)
_C_INT = ctypes.c_int64 if _INT.itemsize == 8 else ctypes.c_int32
_PETSC = ctypes.CDLL(PETSc.__file__)  # what petsc4py is linked with is found through it


@dataclass
class LocalRows:
    """Rows of a matrix that this rank owns, in compressed rows: own columns, and the ghosts'."""

    pointer: np.ndarray
    column: np.ndarray
    value: np.ndarray
    ghost_pointer: np.ndarray
    ghost_column: np.ndarray  # counted from 0
    ghost_value: np.ndarray
    ghost: np.ndarray  # int64, global numbers of the ghosts' columns


@numba.njit(cache=True)
def sort_rows(pointer, column, value):
    """Put the entries of each row in the order of their columns, in place."""
    for r in range(len(pointer) - 1):
        begin = pointer[r]
        for a in range(begin + 1, pointer[r + 1]):
            col, w, b = column[a], value[a], a
            while b > begin and column[b - 1] > col:
                column[b], value[b] = column[b - 1], value[b - 1]
                b -= 1
            column[b], value[b] = col, w


def aij(
    comm: MPI.Intracomm,
    shape: tuple[int, int],
    pointer: np.ndarray,
    column: np.ndarray,
    value: np.ndarray,
    block: int = 1,
) -> PETSc.Mat:
    """AIJ matrix of a block size, from this rank's compressed rows. Collective.

    ``shape`` is local; columns are global and ascend in each row. On one rank PETSc uses the arrays
    as they are; on several, arrays that each rank's own and the others' columns are split into.
    """
    csr: Any = (pointer.astype(_INT, copy=False), column.astype(_INT, copy=False), value)
    if comm.size > 1:
        end = comm.scan(shape[1])
        own = (column >= end - shape[1]) & (column < end)
        here = np.concatenate([[0], np.cumsum(own)])[pointer].astype(_INT)
        csr = (
            (here, (csr[1][own] - (end - shape[1])).astype(_INT, copy=False), value[own]),
            (csr[0] - here, csr[1][~own], value[~own]),
        )
    sizes = ((shape[0], None), (shape[1], None))
    matrix = PETSc.Mat().createAIJWithArrays(sizes, csr, comm=comm)
    matrix.setBlockSize(block)  # petsc4py would not
    return matrix


def write_values(
    matrix: PETSc.Mat, fill: Callable[[np.ndarray], None], columns: np.ndarray
) -> None:
    """Overwrite all values of an AIJ matrix, row by row. Collective.

    ``fill`` writes them to an array; ``columns`` are the global columns of its entries. Ten times
    faster than MatSetValues.
    """
    with local_rows(matrix, write=True) as local:
        if local.ghost_value.size:
            begin, end = matrix.getOwnershipRangeColumn()
            values = np.empty(len(columns))
            fill(values)
            _split(columns, values, begin, end, local.value, local.ghost_value)
        else:
            fill(local.value)
    matrix.stateIncrease()
    matrix.assemble()


@numba.njit(cache=True)
def _split(columns, values, begin, end, own, other):
    """Write values of columns from ``begin`` to ``end`` to an array, others to another."""
    a = b = 0
    for k in range(len(columns)):
        if begin <= columns[k] < end:
            own[a] = values[k]
            a += 1
        else:
            other[b] = values[k]
            b += 1


@contextmanager
def local_rows(matrix: PETSc.Mat, write: bool = False) -> Iterator[LocalRows]:
    """Arrays of a SeqAIJ or MPIAIJ matrix for a while; with ``write`` values may be changed.

    petsc4py copies row by row, which takes as long as twenty products of the matrix; PETSc's own
    functions are therefore called through ctypes.
    """
    n, whole = matrix.getLocalSize()[0], ctypes.c_void_p(matrix.handle)
    halves, ghost = [whole], np.zeros(0, np.int64)
    if matrix.getType() != PETSc.Mat.Type.SEQAIJ:
        own, off, garray = ctypes.c_void_p(), ctypes.c_void_p(), ctypes.c_void_p()
        _call("MatMPIAIJGetSeqAIJ", whole, *map(ctypes.byref, (own, off, garray)))
        halves, rows, columns = [own, off], _C_INT(), _C_INT()
        _call("MatGetSize", off, ctypes.byref(rows), ctypes.byref(columns))
        ghost = _view(garray, columns.value, _INT).astype(np.int64)
    access = "" if write else "Read"
    arrays, borrowed = [], []
    try:
        for half in halves:
            i, j, a = ctypes.c_void_p(), ctypes.c_void_p(), ctypes.c_void_p()
            outputs = map(ctypes.byref, (_C_INT(), i, j, ctypes.c_int()))
            _call("MatGetRowIJ", half, _C_INT(0), ctypes.c_int(0), ctypes.c_int(0), *outputs)
            _call(f"MatSeqAIJGetArray{access}", half, ctypes.byref(a))
            borrowed.append((half, a))
            pointer = _view(i, n + 1, _INT)
            column, value = _view(j, pointer[-1], _INT), _view(a, pointer[-1], _SCALAR)
            arrays.append((pointer, column, value))
        if len(halves) == 1:
            arrays.append((np.zeros(n + 1, _INT), np.zeros(0, _INT), np.zeros(0, _SCALAR)))
        yield LocalRows(*arrays[0], *arrays[1], ghost)
    finally:
        for half, a in borrowed:
            _call(f"MatSeqAIJRestoreArray{access}", half, ctypes.byref(a))


def _call(name: str, *arguments) -> None:
    error = getattr(_PETSC, name)(*arguments)
    if error:
        raise PETSc.Error(error)


def _view(pointer: ctypes.c_void_p, size: int, dtype: np.dtype) -> np.ndarray:
    if not size or pointer.value is None:
        return np.zeros(0, dtype)
    buffer: Any = (ctypes.c_char * (int(size) * dtype.itemsize)).from_address(pointer.value)
    return np.frombuffer(buffer, dtype)
