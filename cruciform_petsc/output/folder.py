# SPDX-License-Identifier: MIT
"""The folder that results go to."""

from __future__ import annotations

import fcntl
import json
import os
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import TYPE_CHECKING

from ..errors import InputError
from ..parallel import on_root

if TYPE_CHECKING:
    from mpi4py import MPI

PATIENCE = 3.0  # s, with a run that is just being ended in the same folder
# Folders that this process (of rank 0) has taken for itself, and their handles.
_locks: dict[str, int] = {}
# All that a run may leave but its checkpoint. What stays of an earlier one would look like the
# results of the next.
RESULTS = (
    "summary.json", "report.html", "curve.csv", "increments.csv", "centre_line.csv",
    "continuum.csv", "ladder.csv", "load_and_measured.csv", "network.vtkhdf", "series.vtkhdf",
    "crossovers.csv", "preform.inp", "scene.png", "yarns.png", "stages.png", "energy.png",
    "zones.png", "shear_map.png", "tension_map.png", "centre_line.png", "ladder.png",
    "shear_against_load.png", "with_and_without_bending.png", "tension_against_strain.png",
    "load_against_deflection.png", "load_against_extension.png", "load_against_angle.png",
    "load_against_crosshead.png",
)  # fmt: skip


def remove_results(comm: MPI.Intracomm, folder: Path) -> str:
    """Remove what an earlier run left in its folder; other files stay. Collective.

    Returns
    -------
    str
        What it was, for the log; empty if there was nothing.

    Raises
    ------
    InputError
        On every rank: something cannot be removed.
    """

    def remove() -> str:
        told = ""
        with suppress(OSError, ValueError, KeyError, TypeError):
            old = json.loads((folder / "summary.json").read_text(encoding="utf-8"))
            told = f'"{old["title"]}" of {old["date"]}'
        for name in RESULTS:
            try:
                (folder / name).unlink(missing_ok=True)
            except OSError as error:
                raise InputError(
                    f'"{folder / name}" of an earlier run cannot be removed: {error.strerror}'
                ) from None
        return told

    return on_root(comm, remove)


def prepare_directory(comm: MPI.Intracomm, path: str | Path) -> Path:
    """Make the folder if need be and make sure, before hours of work, that it can be written.

    Collective; rank 0 touches the file system.

    Parameters
    ----------
    comm : mpi4py communicator
    path : str or Path
        Made with its parents.

    Returns
    -------
    Path

    Raises
    ------
    InputError
        On every rank: a file is in the way, or the folder cannot be made or written to.
    """

    def prepare() -> Path:
        folder = Path(path)
        try:
            folder.mkdir(parents=True, exist_ok=True)
            with tempfile.NamedTemporaryFile(dir=folder, prefix=".cruciform-petsc-"):
                pass
        except (FileExistsError, NotADirectoryError):
            raise InputError(
                f'output folder "{folder}" cannot be made because a file is in its way'
            ) from None
        except (OSError, ValueError) as error:  # ValueError: a null byte in the path
            reason = getattr(error, "strerror", None) or error
            raise InputError(f'output folder "{folder}" cannot be written: {reason}') from None
        return folder

    return on_root(comm, prepare)


def lock_directory(directory: Path) -> None:
    """Take a folder for this process until it ends; not collective.

    Two runs that write to one folder would each take the other's files for its own.

    Raises
    ------
    InputError
        Another process has it and keeps it for some seconds more, or it cannot be opened.
    """
    name = os.path.realpath(directory)
    if name in _locks:
        return
    try:
        handle = os.open(name, os.O_RDONLY)
    except OSError as error:
        raise InputError(f'"{directory}" cannot be used: {error.strerror}') from None
    deadline = time.monotonic() + PATIENCE
    while True:
        try:
            fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            if time.monotonic() > deadline:
                os.close(handle)
                raise InputError(
                    f'another run is writing to "{directory}": wait for it to end, or give this '
                    "one another folder with --output"
                ) from None
            time.sleep(0.05)
            continue
        except OSError:
            pass  # a file system without locks
        _locks[name] = handle
        return


def unlock_directory(directory: Path) -> None:
    """Give a folder back; not collective."""
    handle = _locks.pop(os.path.realpath(directory), None)
    if handle is not None:
        os.close(handle)


@contextmanager
def locked(comm: MPI.Intracomm, directory: Path) -> Iterator[None]:
    """Have a folder for this run alone while the block runs. Collective."""
    on_root(comm, lambda: lock_directory(directory))
    try:
        yield
    finally:  # on rank 0, wherever the others are
        unlock_directory(directory)
