# SPDX-License-Identifier: MIT
"""Memory that does not suffice on one rank's machine is refused on every rank."""

import pytest
from mpi4py import MPI

from cruciform_petsc import memory
from cruciform_petsc.errors import InputError
from cruciform_petsc.memory import check_memory

COMM = MPI.COMM_WORLD


def test_all_ranks_refuse(monkeypatch):
    """The same sentence everywhere, though only the last rank knows of a limit."""
    limit = 1_000_000 if COMM.rank == COMM.size - 1 else None
    monkeypatch.setattr(memory, "machine_memory", lambda: limit)
    check_memory(COMM, 0.8e6, "this", "do that")
    with pytest.raises(InputError) as caught:
        check_memory(COMM, 2e6, "this", "do that")
    assert COMM.allgather(str(caught.value)) == COMM.size * [
        "this, which would need about 2 MB of memory where there are 1 MB, do that"
    ]
