# SPDX-License-Identifier: MIT
"""The folder that results go to."""

from __future__ import annotations

import tempfile
from pathlib import Path
from typing import TYPE_CHECKING

from ..case import on_root
from ..errors import InputError

if TYPE_CHECKING:
    from mpi4py import MPI


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
