# SPDX-License-Identifier: MIT
"""Small files that rank 0 writes, curves as CSV, summaries as JSON; and how any file is written.

A file gets its name when it is whole. Where a place cannot be written to, every rank raises an
InputError, and nothing is left there. Text files of many ranks have their rows in one order on any
number of ranks: a row is made into text on the rank whose share of the numbers it belongs to, and
one rank after the other writes.
"""

from __future__ import annotations

import csv
import json
import math
import secrets
from collections.abc import Callable, Container, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ..errors import InputError
from ..parallel import on_all, on_root, send_by_rank
from ..reading import LARGEST, read_given
from .folder import claim, explaining

if TYPE_CHECKING:
    from mpi4py import MPI

    from ..net.network import Network


def write_csv(
    comm: MPI.Intracomm, path: str | Path, columns: Mapping[str, Sequence | np.ndarray]
) -> None:
    """Write columns of equal length under their names. Collective; rank 0 writes.

    Names carry the units: ``extension_mm``, ``load_N``. Numbers, needed on rank 0 only, are written
    so that they read back exactly, those that are not finite as an empty field.
    """

    def write() -> None:
        rows = zip(*(_plain(list(column)) for column in columns.values()), strict=True)
        with written_whole(path) as temporary, temporary.open("w", newline="") as file:
            table = csv.writer(file, lineterminator="\n")
            table.writerow(columns)
            table.writerows(rows)

    on_root(comm, write)


def read_csv(path: Path) -> dict[str, np.ndarray]:
    """Columns of a table that `write_csv` has written; not collective.

    Float (n,), an empty field being NaN; texts where a column has any. InputError for another file.
    """
    data = read_given(path, "table", "CSV", LARGEST)
    try:
        header, *rows = list(csv.reader(data.decode("utf-8-sig").splitlines()))
        cells = list(zip(*rows, strict=True)) if rows else [()] * len(header)
        if len(set(header)) < len(header):
            raise ValueError
        return {name: _column(column) for name, column in zip(header, cells, strict=True)}
    except (ValueError, csv.Error):
        raise InputError(f'"{path}" is not a table that cruciform-petsc has written') from None


def _column(cells: Sequence[str]) -> np.ndarray:
    """Numbers if all are, else texts."""
    try:
        return np.array([float(cell or "nan") for cell in cells], float)
    except ValueError:
        return np.array(cells, str)


def write_json(comm: MPI.Intracomm, path: str | Path, data: Mapping[str, Any]) -> None:
    """Write nested dicts and sequences of plain or numpy values. Collective; rank 0 writes.

    They are needed on rank 0 only. JSON knows no NaN and no infinity: they become null.
    """

    def write() -> None:
        text = json.dumps(_plain(data), indent=2, ensure_ascii=False, allow_nan=False)
        with written_whole(path) as temporary:
            temporary.write_text(text + "\n", encoding="utf-8")

    on_root(comm, write)


@contextmanager
def written_whole(path: str | Path) -> Iterator[Path]:
    """Give a temporary name beside ``path``; it becomes ``path`` when the block ends well.

    Not collective. What was there before stays until then, or for good if the block fails. An
    OSError, in the block too, becomes an InputError.
    """
    temporary = _start(path)
    try:
        with explaining(f'"{path}" cannot be written'):
            yield temporary
            temporary.replace(path)
    finally:
        _remove(temporary)


@contextmanager
def written_by_all(
    comm: MPI.Intracomm, path: str | Path
) -> Iterator[Callable[[Callable[[Path], object] | None], None]]:
    """Give what writes to a file of all ranks; it gets its name when the block ends well.

    Collective, as is what the block gets: to be called with a function of the temporary file, or
    with None on ranks that have nothing to write. An OSError or a RuntimeError on any rank becomes
    an InputError on all, and nothing is left there.
    """
    temporary = on_root(comm, lambda: _start(path))

    def together(write: Callable[[Path], object] | None) -> None:
        @explaining(f'"{path}" cannot be written', also=RuntimeError)
        def attempt() -> None:
            if write is not None:
                write(temporary)

        on_all(comm, attempt)

    try:
        yield together
        together((lambda temporary: temporary.replace(path)) if comm.rank == 0 else None)
    except InputError:
        on_root(comm, lambda: _remove(temporary))
        raise


def _start(path: str | Path) -> Path:
    """Make an empty file beside ``path`` and return its name; InputError if that cannot be."""
    path = Path(path)
    temporary = path.with_name(f".{path.name}.{secrets.token_hex(4)}.part")
    with explaining(f'"{path}" cannot be written', also=ValueError):  # a null byte in the path
        if path.is_dir():
            raise OSError("a folder has that name")
        claim(path)
        temporary.touch(exist_ok=False)  # which follows no link
    return temporary


def _remove(temporary: Path) -> None:
    with suppress(OSError):
        temporary.unlink(missing_ok=True)


def _plain(value: Any) -> Any:
    """The same with Python's own numbers, lists and dicts; None for what is not finite."""
    if isinstance(value, np.ndarray | np.generic):
        value = value.tolist()
    if isinstance(value, Mapping):
        return {str(key): _plain(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(item) for item in value]
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return str(value) if isinstance(value, Path) else value


# -- rows of many ranks ----------------------------------------------------------------------------


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

    There are as many pieces on every rank; they are made as they are needed.
    """
    with written_by_all(comm, path) as together:
        for piece in pieces:
            for turn in range(comm.size):
                mine = turn == comm.rank and piece
                together(partial(_append, piece=piece) if mine else None)


def write_rows(
    comm: MPI.Intracomm,
    path: str | Path,
    first: str,
    number: np.ndarray,
    columns: Mapping[str, np.ndarray],
    whole: Container[str] = (),
) -> None:
    """Write a table of all ranks' rows: their numbers, under ``first``, and columns. Collective.

    Of the columns (m,) those named in ``whole`` are whole numbers, others have ten digits, and an
    empty field where there is no value.
    """
    head = ",".join([first, *columns]) + "\n" if comm.rank == 0 else ""
    template = ",".join(["%d", *("%d" if name in whole else "%.10g" for name in columns)])
    text = lines(template, number, *columns.values()).replace(b"nan", b"")
    write_pieces(comm, path, [head.encode(), text])


def write_crossovers(network: Network, path: str | Path, columns: Mapping[str, np.ndarray]) -> None:
    """Write a row for each crossover, in one order on any number of ranks. Collective.

    ``columns`` are those of this rank's crossovers, (n_owned,).
    """
    number, rows = in_order(
        network.comm,
        network.crossover_number_global,
        network.num_crossovers_global,
        np.column_stack(list(columns.values())),
    )
    whole = {name for name, values in columns.items() if values.dtype.kind in "bi"}
    own = dict(zip(columns, rows.T, strict=True))
    write_rows(network.comm, path, "crossover", number, own, whole)


def _append(path: Path, piece: bytes) -> None:
    with path.open("ab") as file:
        file.write(piece)
