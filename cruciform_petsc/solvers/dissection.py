# SPDX-License-Identifier: MIT
"""Nested dissection of nets by where their nodes lie, and how MUMPS is handed it.

A net is cut in two across its longer side, along yarns, by nodes that are factored last; each half
likewise (George, SIAM J. Numer. Anal. 10, 1973, p. 345). Nodes that are joined to very many others,
as tools are, go last of all. (Of some lines near the middle the one with the fewest nodes would
make more work in all, by 29 per cent with three on either side.)

MUMPS takes an ordering (PERM_IN, ICNTL(7) = 1), PETSc has no call for it where the matrix is
symmetric. It is written where MUMPS looks for it, which is done only if all that can be read there
is what PETSc says of it: with another PETSc or MUMPS than those known here (3.22, 5.7) MUMPS's own
ordering stays.
"""

from __future__ import annotations

import ctypes
from functools import lru_cache

import numba
import numpy as np
from mpi4py import MPI
from petsc4py import PETSc

from ..parallel import on_all

SMALLEST = 20_000  # unknowns; below, nothing is gained
LEAF = 8  # nodes that are not cut any more
DENSE = 10.0  # times the square root of the number of nodes, as in AMD: neighbours of a tool

_PETSC = ctypes.CDLL(PETSc.__file__)
_KNOWN = 3, 22  # PETSc's version
_SYMBOLIC = 1  # MUMPS's job
_ORDERING, _BLOCKS = 7, 15  # numbers of ICNTL
_TOLD = 38  # of its 60, those that PETSc tells
_WORDS = 256  # of PETSc's struct of a matrix, which is longer, that are looked through
_INT, _LONG, _REAL, _PTR = ctypes.c_int, ctypes.c_int64, ctypes.c_double, ctypes.c_void_p


class _Mumps(ctypes.Structure):
    """DMUMPS_STRUC_C of MUMPS 5.7 (dmumps_c.h), up to its version."""

    _fields_ = (
        ("sym", _INT), ("par", _INT), ("job", _INT), ("comm_fortran", _INT),
        ("icntl", _INT * 60), ("keep", _INT * 500), ("cntl", _REAL * 15),
        ("dkeep", _REAL * 230), ("keep8", _LONG * 150), ("n", _INT), ("nblk", _INT),
        ("nz_alloc", _INT), ("nz", _INT), ("nnz", _LONG), ("entries", _PTR * 3), ("nz_loc", _INT),
        ("nnz_loc", _LONG), ("entries_loc", _PTR * 3), ("nelt", _INT), ("elements", _PTR * 3),
        ("blocks", _PTR * 2), ("perm_in", _PTR), ("permutations", _PTR * 2), ("scaling", _PTR * 2),
        ("scaling_from_mumps", _INT * 2), ("scaling_loc", _PTR * 2), ("after", _PTR * 3),
        ("right_sides", _PTR * 12), ("sizes", _INT * 16), ("info", _INT * 80), ("infog", _INT * 80),
        ("rinfo", _REAL * 40), ("rinfog", _REAL * 40), ("deficiency", _INT), ("null", _PTR * 3),
        ("size_schur", _INT), ("schur", _PTR * 3), ("version", ctypes.c_char * 32),
    )  # fmt: skip


def dissected(place: np.ndarray, start: np.ndarray, column: np.ndarray) -> np.ndarray:
    """Order in which nodes are factored: int64 (n,), the number of each.

    Parameters
    ----------
    place : float (n, dim)
    start, column : int
        Compressed rows of the nodes' neighbours.
    """
    n = len(place)
    last = np.diff(start) > max(16.0, DENSE * np.sqrt(n))
    nodes = np.concatenate([np.flatnonzero(~last), np.flatnonzero(last)])
    size = int((~last).sum())
    if size:
        # Lines of yarns, the same to rounding.
        extent = float(np.ptp(place[~last], axis=0).max())
        _dissect(np.round(place / (1e-6 * extent or 1.0)), start, column, nodes[:size])
    number = np.empty(n, np.int64)
    number[nodes] = np.arange(n)
    return number


@numba.njit(cache=True)
def _dissect(place, start, column, nodes):
    """Put nodes in order, in place: halves, then what separates them."""
    side = np.zeros(len(place), np.int8)
    todo = [(0, len(nodes))]
    while len(todo) > 0:
        begin, end = todo.pop()
        part = nodes[begin:end].copy()
        if len(part) <= LEAF:
            continue
        axis, longest = 0, -1.0
        for k in range(place.shape[1]):
            along = place[part, k]
            if along.max() - along.min() > longest:
                axis, longest = k, along.max() - along.min()
        along = place[part, axis]
        cut = np.sort(along)[len(part) // 2]
        if cut == along.min():
            for value in np.sort(along)[len(part) // 2 :]:
                if value > cut:
                    cut = value
                    break
            else:
                continue  # all in one place
        for i in range(len(part)):
            side[part[i]] = 1 if along[i] < cut else 2
        for node in part:
            if side[node] == 1:
                for e in range(start[node], start[node + 1]):
                    if side[column[e]] == 2:
                        side[node] = 3
                        break
        at = begin
        for kind in (1, 2, 3):
            first = at
            for node in part:
                if side[node] == kind:
                    nodes[at] = node
                    at += 1
            if kind < 3:
                todo.append((first, at))
        for node in part:
            side[node] = 0


def order(
    pc: PETSc.PC, matrix: PETSc.Mat, place: np.ndarray, start: np.ndarray, column: np.ndarray
) -> bool:
    """Analyse a matrix for MUMPS with nodes in the order of a nested dissection. Collective.

    For a PC of type cholesky that has not been set up since it has the matrix. MUMPS gathers the
    pattern on the first rank to analyse it; nodes' places and neighbours go there, too.

    Parameters
    ----------
    place : float (n_owned, dim)
    start, column
        Compressed rows of the owned nodes' neighbours, global numbers.

    Returns
    -------
    bool
        Whether it was done. If not, MUMPS's own ordering stays.
    """
    comm, block = matrix.comm.tompi4py(), matrix.getBlockSize()
    pc.setFactorSetUpSolverType()
    factor = pc.getFactorMatrix()
    factor.setMumpsIcntl(_ORDERING, 0)  # a first time with AMD, which takes least
    factor.setMumpsIcntl(_BLOCKS, 0)
    info = (ctypes.c_double * 64)()  # MatFactorInfo, which is shorter
    _call("MatFactorInfoInitialize", info)
    _call("MatCholeskyFactorSymbolic", _PTR(factor.handle), _PTR(matrix.handle), None, info)
    mumps = _mumps(factor)
    if not comm.allreduce(mumps is not None, MPI.LAND):
        pc.reset()  # the factor made here, too
        return False
    assert mumps is not None
    parts = comm.gather((place, np.diff(start), column))

    def numbers() -> np.ndarray:
        places, counts, columns = map(np.concatenate, zip(*parts, strict=True))
        new = dissected(places, np.concatenate([[0], np.cumsum(counts)]), columns)
        return (new[:, None] * block + np.arange(1, block + 1)).astype(np.int32).ravel()

    given = on_all(comm, lambda: numbers() if comm.rank == 0 else np.zeros(0, np.int32))
    mumps.icntl[_ORDERING - 1], mumps.job = 1, _SYMBOLIC
    mumps.perm_in = given.ctypes.data if comm.rank == 0 else None
    _library().dmumps_c(ctypes.byref(mumps))
    mumps.perm_in = None
    if mumps.infog[0] < 0:
        pc.reset()
        return False
    return True


@lru_cache(maxsize=1)
def _library() -> ctypes.CDLL:
    """MUMPS, which PETSc has loaded."""
    return ctypes.CDLL("libdmumps-5.7.so")


def _mumps(factor: PETSc.Mat) -> _Mumps | None:
    """MUMPS's own struct of a factor that has been analysed, if it is the one known here.

    PETSc keeps its address behind those of the layouts of rows and columns.
    """
    rows, columns = _PTR(), _PTR()
    _call("MatGetLayouts", _PTR(factor.handle), ctypes.byref(rows), ctypes.byref(columns))
    words = np.ctypeslib.as_array((ctypes.c_uint64 * _WORDS).from_address(factor.handle))
    at = np.flatnonzero((words[:-2] == rows.value) & (words[1:-1] == columns.value))
    try:
        _library()
    except OSError:
        return None
    if len(at) != 1 or PETSc.Sys.getVersion()[:2] != _KNOWN:
        return None
    mumps = _Mumps.from_address(int(words[at[0] + 2]))
    known = all(factor.getMumpsIcntl(k + 1) == mumps.icntl[k] for k in range(_TOLD))
    sizes = mumps.n == factor.getSize()[0] and mumps.infog[6] == factor.getMumpsInfog(7)
    return mumps if known and sizes and mumps.version.startswith(b"5.7") else None


def _call(name: str, *arguments) -> None:
    error = getattr(_PETSC, name)(*arguments)
    if error:
        raise PETSc.Error(error)
