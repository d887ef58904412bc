# SPDX-License-Identifier: MIT
"""Text files of many ranks: rows in one order on any number of ranks, and no rank holds them all.

Rows are sent to the rank whose share of the numbers they belong to, made into text there, and
written by one rank after the other.
"""

from __future__ import annotations

from collections.abc import Iterable
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from mpi4py import MPI

from ..parallel import on_root, send_by_rank
from .tables import finish_file, start_file


def in_order(
    comm: MPI.Intracomm, number: np.ndarray, total: int, rows: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Deal rows out by their numbers: rank r gets the r-th part of 0 ... total - 1. Collective.

    Parameters
    ----------
    comm : mpi4py communicator
    number : int64 (n,)
        No two alike, on whatever rank; not all need be there.
    total : int
    rows : float (n, k)

    Returns
    -------
    number : int64 (m,), ascending
    rows : float (m, k)
    """
    first = np.arange(1, comm.size + 1) * total // comm.size
    rank = np.searchsorted(first, number, side="right")
    number, rows = send_by_rank(comm, rank, np.asarray(number, np.int64), np.asarray(rows, float))
    order = np.argsort(number)
    return number[order], rows[order]


def lines(template: str, *columns: np.ndarray) -> bytes:
    """A line for each row of the columns, (n,) or (n, k), by a template like "%d, %.9g"."""
    # Adding zero makes plain zeros of negative ones.
    table = np.column_stack([np.asarray(column, float) for column in columns]) + 0.0
    rows: Any = table.tolist()
    return "".join([template % tuple(row) + "\n" for row in rows]).encode()


def write_pieces(comm: MPI.Intracomm, path: str | Path, pieces: Iterable[bytes]) -> None:
    """Write a file piece by piece, of each piece all ranks' parts in their order. Collective.

    The file gets its name when it is whole.

    Parameters
    ----------
    comm : mpi4py communicator
    path : str or Path
    pieces : iterable of bytes
        As many on every rank; made as they are needed.

    Raises
    ------
    InputError
        On every rank: the place cannot be written to.
    """
    path = Path(path)
    temporary = on_root(comm, lambda: start_file(path))
    for piece in pieces:
        for turn in range(comm.size):
            problem = None
            if turn == comm.rank and piece:
                try:
                    with temporary.open("ab") as file:
                        file.write(piece)
                except OSError as error:
                    problem = error.strerror or str(error)
            problem = comm.bcast(problem, root=turn)
            if problem:
                on_root(comm, partial(finish_file, path, temporary, problem))
    on_root(comm, lambda: finish_file(path, temporary))
