# SPDX-License-Identifier: MIT
"""Memory that there is, and a sentence where a network would need more."""

from __future__ import annotations

import re
from pathlib import Path

from mpi4py import MPI

from .errors import InputError

USABLE = 0.9  # of the machine's memory; the system and other programs have the rest

_MEMINFO = Path("/proc/meminfo")
_CGROUP = Path("/proc/self/cgroup")
_CGROUPS = Path("/sys/fs/cgroup")


def machine_memory() -> int | None:
    """Memory of this machine, or of the container it is lent to us in [bytes]; None: not known."""
    limits = []
    try:
        match = re.search(r"^MemTotal:\s*(\d+) kB", _MEMINFO.read_text(), re.MULTILINE)
    except OSError:
        match = None
    if match is not None:
        limits.append(1024 * int(match[1]))
    limits += _cgroup_limits()
    return min(limits, default=None)


def _cgroup_limits() -> list[int]:
    """Limits of our control group and of those around it, of either version."""
    found = []
    try:
        lines = _CGROUP.read_text().splitlines()
    except OSError:
        return []
    for line in lines:
        _, controllers, path = [*line.split(":", 2), "", ""][:3]
        if controllers == "":
            top, name = _CGROUPS, "memory.max"
        elif "memory" in controllers.split(","):
            top, name = _CGROUPS / "memory", "memory.limit_in_bytes"
        else:
            continue
        folder = top / path.strip("/")
        # Inside a container the path may be that of the host, of which only the top is seen.
        for place in (folder, *folder.parents):
            try:
                limit = (place / name).read_text().strip()
            except OSError:
                limit = "max"
            if limit.isdigit():  # else "max"; the old version writes a huge number
                found.append(int(limit))
            if place == top:
                break
    return found


def check_memory(comm: MPI.Intracomm, needed: float, what: str, cure: str) -> None:
    """Raise InputError if ``needed`` bytes, dealt out over the ranks, exceed a machine's memory.

    Collective.

    Parameters
    ----------
    comm : mpi4py communicator
    needed : float
        Bytes on all ranks together; may be infinite.
    what, cure : str
        What would need them, and what to do instead, for the sentence.
    """
    node = comm.Split_type(MPI.COMM_TYPE_SHARED)
    share = node.size / comm.size  # of what is needed; the ranks of one machine
    node.Free()
    memory = machine_memory()
    over = memory is not None and needed * share > USABLE * memory
    here = f"{_size(needed * share)} of memory where there are {_size(memory)}" if memory else ""
    told = next((text for text in comm.allgather(here if over else "") if text), "")
    if told:
        raise InputError(f"{what}, which would need about {told}, {cure}")


def _size(count: float) -> str:
    """Write a number of bytes for people."""
    for unit in ("MB", "GB", "TB"):
        count /= 1e6 if unit == "MB" else 1e3
        if count < 1000.0:
            break
    return f"{count:.3g} {unit}"
