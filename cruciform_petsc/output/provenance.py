# SPDX-License-Identifier: MIT
"""Where a result comes from: program, commit, versions, date, ranks."""

from __future__ import annotations

import json
import platform
from contextlib import suppress
from datetime import UTC, datetime
from importlib import metadata
from pathlib import Path
from typing import TYPE_CHECKING, Any

from .. import __version__
from ..parallel import on_root
from ..reading import read_bytes

if TYPE_CHECKING:
    from mpi4py import MPI

    from ..experiments.result import TestResult
    from ..net.network import Network

LIBRARIES = ("numpy", "scipy", "numba", "mpi4py", "petsc4py", "h5py", "fenics-dolfinx")
LONGEST_NOTE = 60_000  # bytes; HDF5 takes attributes up to 64 KiB


def versions() -> dict[str, str]:
    """Versions of this program and of what it stands on, as far as they are installed."""
    from petsc4py import PETSc  # starts PETSc

    found = {
        "cruciform_petsc": __version__,
        "python": platform.python_version(),
        "petsc": ".".join(map(str, PETSc.Sys.getVersion())),
    }
    for name in LIBRARIES:
        with suppress(metadata.PackageNotFoundError):
            found[name] = metadata.version(name)
    return found


def commit() -> str | None:
    """Git commit of the program, if it runs from a clone; read without running git."""
    git = Path(__file__).resolve().parents[2] / ".git"
    try:
        if git.is_file():  # of a further work tree
            git = git.parent / _line(git).removeprefix("gitdir: ")
        head = _line(git / "HEAD")
        if not head.startswith("ref: "):
            return head or None
        name = head.removeprefix("ref: ")
        common = git / "commondir"
        if common.is_file():
            git = git / _line(common)
        if (git / name).is_file():
            return _line(git / name)
        packed = read_bytes(git / "packed-refs").decode().splitlines()
        return next((line.split()[0] for line in packed if line.endswith(f" {name}")), None)
    except (OSError, ValueError):
        return None


def _line(path: Path) -> str:
    """What a small file holds."""
    return read_bytes(path).decode().strip()


def provenance(comm: MPI.Intracomm) -> dict[str, Any]:
    """What a summary says: ranks, versions, date and commit; the same on every rank. Collective."""

    def origin() -> dict[str, Any]:
        date = datetime.now(UTC).isoformat(timespec="seconds")
        return {"ranks": comm.size, "versions": versions(), "date": date, "commit": commit()}

    return on_root(comm, origin)


def file_notes(result: TestResult, case: dict[str, Any] | None = None) -> dict[str, str | int]:
    """The same as attributes of a data file, with what was tested. Collective."""
    return notes_on(result.network, result.experiment.kind, case)


def notes_on(
    network: Network, kind: str, case: dict[str, Any] | None = None
) -> dict[str, str | int]:
    """Attributes of a data file about a kind of test of a network. Collective.

    So is the case file's content, if it is not too long for an attribute.
    """
    origin = provenance(network.comm)
    notes = {
        "program": f"cruciform_petsc {__version__}",
        "commit": origin["commit"] or "",
        "versions": json.dumps(origin["versions"]),
        "date": origin["date"],
        "ranks": origin["ranks"],
        "test": kind,
        "fabric": repr(network.fabric),
        "preform": repr(network.preform),
    }
    text = json.dumps(case, ensure_ascii=False)
    if case is not None and len(text.encode()) <= LONGEST_NOTE:
        notes["case"] = text
    return notes
