# SPDX-License-Identifier: MIT
"""The folder that results go to."""

from __future__ import annotations

import json
import tempfile
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING

from ..case import on_root
from ..errors import InputError

if TYPE_CHECKING:
    from mpi4py import MPI

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
