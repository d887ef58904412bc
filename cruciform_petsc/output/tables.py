# SPDX-License-Identifier: MIT
"""Small files that rank 0 writes, curves as CSV, summaries as JSON; and how any file is written.

A file gets its name when it is whole. Where a place cannot be written to, every rank raises an
InputError, and nothing is left there.
"""

from __future__ import annotations

import csv
import json
import math
import secrets
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ..errors import InputError
from ..parallel import on_all, on_root
from .folder import claim

if TYPE_CHECKING:
    from mpi4py import MPI


def write_csv(
    comm: MPI.Intracomm, path: str | Path, columns: Mapping[str, Sequence | np.ndarray]
) -> None:
    """Write columns of equal length under their names. Collective; rank 0 writes.

    Parameters
    ----------
    comm : mpi4py communicator
    path : str or Path
    columns : dict of sequences
        Names carry the units: ``extension_mm``, ``load_N``. Needed on rank 0 only. Numbers are
        written so that they read back exactly, those that are not finite as an empty field.
    """

    def write() -> None:
        rows = zip(*(_plain(list(column)) for column in columns.values()), strict=True)
        with written_whole(path) as temporary, temporary.open("w", newline="") as file:
            table = csv.writer(file, lineterminator="\n")
            table.writerow(columns)
            table.writerows(rows)

    on_root(comm, write)


def write_json(comm: MPI.Intracomm, path: str | Path, data: Mapping[str, Any]) -> None:
    """Write nested dicts and sequences of plain or numpy values. Collective; rank 0 writes.

    Parameters
    ----------
    comm : mpi4py communicator
    path : str or Path
    data : dict
        Needed on rank 0 only. JSON knows no NaN and no infinity: they become null.
    """

    def write() -> None:
        text = json.dumps(_plain(data), indent=2, ensure_ascii=False, allow_nan=False)
        with written_whole(path) as temporary:
            temporary.write_text(text + "\n", encoding="utf-8")

    on_root(comm, write)


@contextmanager
def written_whole(path: str | Path) -> Iterator[Path]:
    """Give a temporary name beside ``path``; it becomes ``path`` when the block ends well.

    Not collective. What was there before stays until then, or for good if the block fails.

    Raises
    ------
    InputError
        The place cannot be written to, or the block raised an OSError.
    """
    temporary = start_file(path)
    try:
        yield temporary
        temporary.replace(path)
    except OSError as error:
        raise _cannot_write(path, error) from None
    finally:
        _remove(temporary)


@contextmanager
def written_by_all(
    comm: MPI.Intracomm, path: str | Path
) -> Iterator[Callable[[Callable[[Path], object] | None], None]]:
    """Give what writes to a file of all ranks; it gets its name when the block ends well.

    Collective, as is what the block gets: to be called with a function of the temporary file, or
    with None on ranks that have nothing to write.

    Raises
    ------
    InputError
        On every rank: the place cannot be written to, or a function raised an OSError or a
        RuntimeError on one of them. Nothing is left there then.
    """
    temporary = on_root(comm, lambda: start_file(path))

    def together(write: Callable[[Path], object] | None) -> None:
        def attempt() -> None:
            try:
                if write is not None:
                    write(temporary)
            except (OSError, RuntimeError) as error:
                raise _cannot_write(path, error) from None

        on_all(comm, attempt)

    try:
        yield together
        together((lambda temporary: temporary.replace(path)) if comm.rank == 0 else None)
    except InputError:
        on_root(comm, lambda: _remove(temporary))
        raise


def start_file(path: str | Path) -> Path:
    """Make an empty file beside ``path`` and return its name; InputError if that cannot be."""
    path = Path(path)
    temporary = path.with_name(f".{path.name}.{secrets.token_hex(4)}.part")
    try:
        if path.is_dir():
            raise OSError("a folder has that name")
        claim(path)
        temporary.touch(exist_ok=False)  # which follows no link
    except (OSError, ValueError) as error:  # ValueError: a null byte in the path
        raise _cannot_write(path, error) from None
    return temporary


def _remove(temporary: Path) -> None:
    with suppress(OSError):
        temporary.unlink(missing_ok=True)


def _cannot_write(path: str | Path, error: Exception) -> InputError:
    reason = getattr(error, "strerror", None) or str(error)
    return InputError(f'"{path}" cannot be written: {reason}')


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
