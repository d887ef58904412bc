# SPDX-License-Identifier: MIT
"""The folder that results go to: one run at a time, and nothing of the user's is touched.

A file ``.cruciform-petsc.json`` in it names what the program has written there. Only that is ever
removed or replaced; a folder in which something else has such a name is refused.
"""

from __future__ import annotations

import fcntl
import json
import logging
import os
import secrets
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

from ..errors import InputError
from ..parallel import on_root
from ..reading import read_json

if TYPE_CHECKING:
    from mpi4py import MPI

MANIFEST, PROGRAM = ".cruciform-petsc.json", "cruciform_petsc"
CHECKPOINT, PUT_ASIDE = "checkpoint", "checkpoint.old"
PATIENCE = 10.0  # s, with a run that was killed in the same folder: it takes a while to end
# What each command may leave. A run removes what an earlier one left, lest it looks like its own.
_OF_RUN = (
    "summary.json", "report.html", "curve.csv", "increments.csv", "centre_line.csv",
    "continuum.csv", "ladder.csv", "load_and_measured.csv", "network.vtkhdf", "series.vtkhdf",
    "crossovers.csv", "cells.csv", "preform.inp", "preform_ccx.inp", "preform_0000.rad",
    "forces.csv", "fields.csv", "tools.vtkhdf",
    "outline.csv", "outline.svg", "outline.dxf", "net_pattern.csv",
    "net_pattern.dxf",
    "animation.gif", "formed.png", "wrinkles.png", "tool_forces.png", "draw_in.png", "shadow.png",
    "mode.vtkhdf", "mode.png", "lowest_stiffness.png",
    "scene.png", "yarns.png", "stages.png", "energy.png", "tension_surface.png",
    "zones.png", "shear_map.png", "tension_map.png", "height_map.png", "wrinkle_map.png",
    "centre_line.png",
    "ladder.png", "shear_against_load.png", "shear_force.png",
    "with_and_without_bending.png", "tension_against_strain.png",
    "load_against_deflection.png", "load_against_extension.png", "load_against_angle.png",
    "load_against_crosshead.png",
)  # fmt: skip
_OF_PLIES = tuple(  # of each of several
    f"{stem}_ply{number}{rest}"
    for number in range(1, 9)
    for stem, rest in (
        ("fields", ".csv"), ("series", ".vtkhdf"), ("outline", ".csv"), ("outline", ".svg"),
        ("outline", ".dxf"), ("cells", ".csv"), ("preform", ".inp"), ("preform", "_ccx.inp"),
        ("preform", "_0000.rad"), ("formed", ".png"), ("wrinkles", ".png"),
    )
)  # fmt: skip
OF_RUN: tuple[str, ...] = (*_OF_RUN, *_OF_PLIES)
OF_CALIBRATION = (
    "calibration.json", "calibration.csv", "calibration.png", "law.toml", "hold_out.csv",
)  # fmt: skip
OF_COMPARISON = ("comparison.json", "comparison.png")
OF_SWEEP = ("sweep.csv", "sweep.png")
OF_KILBY = ("kilby.json", "kilby.csv", "kilby.png")
LOG = "run.log"  # of each command that solves; the next one of its kind begins it anew
KNOWN = (*OF_RUN, *OF_CALIBRATION, *OF_COMPARISON, *OF_SWEEP, *OF_KILBY, LOG, CHECKPOINT, PUT_ASIDE)

# Folders that this process (of rank 0) has locked, by their real paths: handle, and names of what
# the program has written there.
_locked: dict[str, tuple[int, set[str]]] = {}


@contextmanager
def explaining(
    problem: str, error: type[InputError] = InputError, also: type[Exception] = OSError
) -> Iterator[None]:
    """Make an OSError, and ``also``, an error that tells what it prevents; decorates, too."""
    try:
        yield
    except (OSError, also) as reason:
        raise error(f"{problem}: {getattr(reason, 'strerror', None) or reason}") from None


# -- whose files they are --------------------------------------------------------------------------


def _names_in(directory: Path) -> set[str]:
    """Names of what this program has written into a folder."""
    manifest = read_json(directory / MANIFEST)
    if manifest.get("program") == PROGRAM and isinstance(manifest.get("files"), list):
        return {name for name in manifest["files"] if name in KNOWN}
    versions = read_json(directory / OF_RUN[0]).get("versions")
    if not (isinstance(versions, dict) and PROGRAM in versions):
        return set()
    # Results of version 0.1.0, which had no manifest.
    return {name for name in OF_RUN if os.path.lexists(directory / name)}


def _save(directory: Path, names: set[str]) -> None:
    """Write a folder's manifest; OSError if that cannot be."""
    new = directory / f"{MANIFEST}.{secrets.token_hex(4)}"
    with new.open("x", encoding="utf-8") as file:
        try:
            json.dump({"program": PROGRAM, "files": sorted(names)}, file, indent=1)
            file.flush()
            os.fsync(file.fileno())
            new.replace(directory / MANIFEST)
        except OSError:
            new.unlink(missing_ok=True)
            raise


def claim(path: Path, *, adopt: bool = False) -> None:
    """Note that the program is about to write a file or folder of its own; not collective.

    Only where this process has locked the folder. ``adopt``: what is there is the program's.
    Raises InputError if it is not, OSError if it cannot be noted.
    """
    written = _written(path.parent)
    if written is None or path.name in written or path.name not in KNOWN:
        return
    if os.path.lexists(path) and not adopt:
        raise foreign(path)
    _save(path.parent, written | {path.name})
    written.add(path.name)


def _written(directory: Path) -> set[str] | None:
    """Names of what the program has written into a folder that this process has locked."""
    return _locked.get(os.path.realpath(directory), (0, None))[1]


def foreign(path: Path) -> InputError:
    """Make the error for something in the way that is not the program's."""
    return InputError(
        f'"{path}" was not written by this version of cruciform-petsc, which therefore leaves it '
        "alone: move it elsewhere, or have the results go to another folder with --output"
    )


def remove_results(comm: MPI.Intracomm, directory: Path) -> str:
    """Remove what an earlier run left in a locked folder; all else stays. Collective.

    Returns what it was, for the log; empty if it is not known. An InputError on every rank if
    something cannot be removed.
    """

    def remove() -> str:
        old = read_json(directory / OF_RUN[0])
        names = _written(directory) or set()
        removed = names.intersection(OF_RUN)
        names -= removed
        for name in removed:
            with explaining(f'"{directory / name}" of an earlier run cannot be removed'):
                (directory / name).unlink(missing_ok=True)
        if removed:
            with explaining(f'"{directory / MANIFEST}" of an earlier run cannot be removed'):
                _save(directory, names)
        return f'"{old.get("title")}" of {old["date"]}' if removed and "date" in old else ""

    return on_root(comm, remove)


# -- one run at a time -----------------------------------------------------------------------------


def prepare_directory(comm: MPI.Intracomm, path: str | Path) -> Path:
    """Make a folder with its parents and make sure, before hours of work, that it can be written.

    It may be a link to one. Collective; an InputError on every rank if a file is in the way, or if
    it cannot be made or written to.
    """
    if not str(path).strip():
        raise InputError(f"--output must be a name that is not empty, got {str(path)!r}")
    folder = Path(path)

    @explaining(f'output folder "{folder}" cannot be written', also=ValueError)  # a null byte
    def prepare() -> None:
        try:
            folder.mkdir(parents=True, exist_ok=True)
        except (FileExistsError, NotADirectoryError):
            raise InputError(
                f'output folder "{folder}" cannot be made because a file is in its way'
            ) from None
        tempfile.NamedTemporaryFile(dir=folder, prefix=".cruciform-petsc-").close()

    on_root(comm, prepare)
    return folder


def lock_directory(directory: Path) -> str:
    """Take a folder for this process until it ends; not collective.

    Two runs that write to one folder would each take the other's files for its own. Returns a
    warning if it cannot be locked, else an empty text; an InputError if it cannot be opened, or if
    another process has it and keeps it for `PATIENCE`.
    """
    name = os.path.realpath(directory)
    if name in _locked:
        return ""
    warning = ""
    with explaining(f'"{directory}" cannot be used'):
        handle = os.open(name, os.O_RDONLY)
    deadline = time.monotonic() + PATIENCE
    while True:
        try:
            fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
            break
        except BlockingIOError:
            if time.monotonic() > deadline:
                os.close(handle)
                raise InputError(
                    f'another run is writing to "{directory}": wait for it to end, or give this '
                    "one another folder with --output"
                ) from None
            time.sleep(0.05)
        except OSError as error:
            warning = (
                f'"{directory}" cannot be locked ({error.strerror}), so see to it that no other '
                "run writes to it"
            )
            break
    _locked[name] = handle, _names_in(directory)
    return warning


def unlock_directory(directory: Path) -> None:
    """Give a folder back; not collective."""
    name = os.path.realpath(directory)
    if name in _locked:
        os.close(_locked.pop(name)[0])


@contextmanager
def locked(
    comm: MPI.Intracomm, directory: str | Path, names: tuple[str, ...], log: logging.Logger
) -> Iterator[Path]:
    """Have a folder, made if need be, for one command while the block runs. Collective.

    An InputError on every rank if it cannot be used, if another run is writing to it, or if
    something in it that is not the program's has one of the names, those of what the command may
    write. The log is warned where the file system cannot lock.
    """
    folder = prepare_directory(comm, directory)

    def lock() -> str:
        warning = lock_directory(folder)
        written = _written(folder) or set()
        for name in names:
            if name not in written and os.path.lexists(folder / name):
                raise foreign(folder / name)
        return warning

    try:
        warning = on_root(comm, lock)
        if warning:
            log.warning("warning       %s", warning)
        yield folder
    finally:  # on rank 0, wherever the others are
        unlock_directory(folder)
