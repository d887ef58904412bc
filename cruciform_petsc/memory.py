# SPDX-License-Identifier: MIT
"""Memory that there is, and a sentence where a network would need more."""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path

from mpi4py import MPI

from .errors import InputError

USABLE = 0.9  # of the machine's memory; the system and other programs have the rest

_MEMINFO = Path("/proc/meminfo")
_CGROUP = Path("/proc/self/cgroup")
_CGROUPS = Path("/sys/fs/cgroup")


def machine_memory() -> int | None:
    """Memory of this machine, or of the container it is lent to us in [bytes]; None: not known."""
    total = re.findall(r"^MemTotal:\s*(\d+) kB", _text(_MEMINFO), re.MULTILINE)
    return min([*(1024 * int(kilobytes) for kilobytes in total), *_cgroup_limits()], default=None)


def _text(path: Path) -> str:
    """What stands in a file of the system; nothing if it is not there."""
    try:
        return path.read_text()
    except OSError:
        return ""


def _cgroup_limits() -> Iterator[int]:
    """Limits of our control group and of those around it, of either version."""
    for line in _text(_CGROUP).splitlines():
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
            limit = _text(place / name).strip()
            if limit.isdigit():  # else "max"; the old version writes a huge number
                yield int(limit)
            if place == top:
                break


def check_memory(comm: MPI.Intracomm, needed: float, what: str, cure: str) -> None:
    """Raise InputError if ``needed`` bytes, dealt out over the ranks, exceed a machine's memory.

    Collective. The bytes may be infinite; the sentence tells `what` would need them, and the
    `cure`.
    """
    node = comm.Split_type(MPI.COMM_TYPE_SHARED)
    share = node.size / comm.size  # of what is needed; the ranks of one machine
    node.Free()
    memory = machine_memory()
    over = memory is not None and needed * share > USABLE * memory
    here = (
        f"{size_text(needed * share)} of memory where there are {size_text(memory)}"
        if memory
        else ""
    )
    told = next((text for text in comm.allgather(here if over else "") if text), "")
    if told:
        raise InputError(f"{what}, which would need about {told}, {cure}")


def size_text(count: float) -> str:
    """A number of bytes for people."""
    for unit in ("MB", "GB", "TB"):
        count /= 1e6 if unit == "MB" else 1e3
        if count < 1000.0:
            break
    return f"{count:.3g} {unit}"
