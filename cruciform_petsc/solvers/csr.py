# SPDX-License-Identifier: MIT
"""Arrays of a distributed AIJ matrix in NumPy."""

from __future__ import annotations

import ctypes
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

import numba
import numpy as np
from mpi4py import MPI
from petsc4py import PETSc

_INT, _SCALAR = np.dtype(PETSc.IntType), np.dtype(PETSc.ScalarType)


@dataclass
class LocalRows:
    """Rows of a matrix that this rank owns. Columns: own ones first, then the ghosts.

    pointer, column, value and ghost_pointer, ghost_column, ghost_value are the two halves of an AIJ
    matrix in compressed rows; ghost columns count from 0. ghost : int64, their global numbers.
    """

    pointer: np.ndarray
    column: np.ndarray
    value: np.ndarray
    ghost_pointer: np.ndarray
    ghost_column: np.ndarray
    ghost_value: np.ndarray
    ghost: np.ndarray


@numba.njit(cache=True)
def gather(values, source, result):
    """Write values[source] to result: ten times faster than numpy.take, which buffers."""
    for k in range(len(source)):
        result[k] = values[source[k]]
    return result


def aij(
    comm: MPI.Intracomm,
    shape: tuple[int, int],
    pointer: np.ndarray,
    column: np.ndarray,
    value: np.ndarray,
    block: int = 1,
) -> PETSc.Mat:
    """AIJ matrix from this rank's rows, columns ascending in each. Collective.

    On one rank PETSc uses the arrays as they are, which saves a copy made row by row.

    Parameters
    ----------
    shape : (int, int)
        Local rows and columns.
    pointer, column, value
        Compressed rows; columns are global.
    block : int
        Block size.
    """
    csr = (pointer.astype(_INT, copy=False), column.astype(_INT, copy=False), value)
    if comm.size == 1:
        matrix = PETSc.Mat().createAIJWithArrays(shape, csr, comm=comm)
        matrix.setBlockSize(block)  # petsc4py would not
        return matrix
    matrix = PETSc.Mat().create(comm=comm)
    matrix.setSizes(((shape[0], None), (shape[1], None)))
    matrix.setBlockSize(block)
    matrix.setType(PETSc.Mat.Type.AIJ)
    matrix.setPreallocationCSR(csr)
    return matrix


def write_values(
    matrix: PETSc.Mat, values: np.ndarray, columns: np.ndarray, source: np.ndarray
) -> None:
    """Overwrite all values of an AIJ matrix, row by row: values.flat[source]. Collective.

    ``columns`` are the global columns of its entries. Ten times faster than MatSetValues.
    """
    values = values.reshape(-1)
    with local_rows(matrix, write=True) as local:
        if local.ghost_value.size:
            begin, end = matrix.getOwnershipRangeColumn()
            own = (columns >= begin) & (columns < end)
            gather(values, source[own], local.value)
            gather(values, source[~own], local.ghost_value)
        else:
            gather(values, source, local.value)
    matrix.stateIncrease()
    matrix.assemble()


@contextmanager
def local_rows(matrix: PETSc.Mat, write: bool = False) -> Iterator[LocalRows]:
    """Look at the arrays of a SeqAIJ or MPIAIJ matrix without copying them, for a while.

    With ``write`` values may be changed.

    petsc4py copies row by row, which takes as long as twenty products of the matrix; PETSc's own
    functions are therefore called through ctypes.
    """
    n = matrix.getLocalSize()[0]
    if matrix.getType() == PETSc.Mat.Type.SEQAIJ:
        own, off, ghost = ctypes.c_void_p(matrix.handle), None, np.zeros(0, np.int64)
    else:
        own, off, garray = ctypes.c_void_p(), ctypes.c_void_p(), ctypes.c_void_p()
        handle = ctypes.c_void_p(matrix.handle)
        _call("MatMPIAIJGetSeqAIJ", handle, *map(ctypes.byref, (own, off, garray)))
        columns = ctypes.c_int64() if _INT.itemsize == 8 else ctypes.c_int32()
        rows = type(columns)()
        _call("MatGetSize", off, ctypes.byref(rows), ctypes.byref(columns))
        ghost = _view(garray.value, columns.value, _INT).astype(np.int64)
    parts = [_Sequential(part, write) for part in (own, off) if part is not None]
    try:
        arrays = [part.arrays(n) for part in parts]
        if off is None:
            arrays.append((np.zeros(n + 1, _INT), np.zeros(0, _INT), np.zeros(0, _SCALAR)))
        yield LocalRows(*arrays[0], *arrays[1], ghost)
    finally:
        for part in parts:
            part.restore()


class _Sequential:
    """Borrowed arrays of a SeqAIJ matrix."""

    def __init__(self, handle: ctypes.c_void_p, write: bool):
        self.handle, self.access = handle, "" if write else "Read"
        self.i, self.j, self.a = ctypes.c_void_p(), ctypes.c_void_p(), ctypes.c_void_p()

    def arrays(self, n: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        rows = ctypes.c_int64() if _INT.itemsize == 8 else ctypes.c_int32()
        done = ctypes.c_int()
        no = ctypes.c_int(0)
        _call("MatGetRowIJ", self.handle, type(rows)(0), no, no, ctypes.byref(rows),
              ctypes.byref(self.i), ctypes.byref(self.j), ctypes.byref(done))  # fmt: skip
        _call(f"MatSeqAIJGetArray{self.access}", self.handle, ctypes.byref(self.a))
        pointer = _view(self.i.value, n + 1, _INT)
        size = int(pointer[-1])
        return pointer, _view(self.j.value, size, _INT), _view(self.a.value, size, _SCALAR)

    def restore(self) -> None:
        if self.a.value is not None:
            _call(f"MatSeqAIJRestoreArray{self.access}", self.handle, ctypes.byref(self.a))


def _call(name: str, *arguments) -> None:
    error = getattr(_library(), name)(*arguments)
    if error:
        raise PETSc.Error(error)


_LIBRARY: list[ctypes.CDLL] = []


def _library() -> ctypes.CDLL:
    """The PETSc that petsc4py is linked with: its symbols are found through the extension."""
    if not _LIBRARY:
        _LIBRARY.append(ctypes.CDLL(PETSc.__file__))
    return _LIBRARY[0]


def _view(address: int | None, size: int, dtype: np.dtype) -> np.ndarray:
    if not size or address is None:
        return np.zeros(0, dtype)
    buffer: Any = (ctypes.c_char * (size * dtype.itemsize)).from_address(address)
    return np.frombuffer(buffer, dtype)
