# SPDX-License-Identifier: MIT
"""Two plies on several ranks against one rank alone, and from one to several by a checkpoint."""

import numpy as np
import pytest
from mpi4py import MPI
from support.forming import TWO_PLIES, same_end, written
from support.helpers import gathered

from cruciform_petsc.case.schema import Case
from cruciform_petsc.net.network import Network
from cruciform_petsc.output.checkpoint import Checkpoint

COMM = MPI.COMM_WORLD
pytestmark = pytest.mark.three_ranks


class Stop(Exception):
    """What kills a forming."""


def formed(case, comm, keeper=None, stop=None):
    """Form a case; killed after ``stop`` steps there is no result."""
    told = []

    def accepted(step, state):
        told.append(step)
        if len(told) == stop:
            raise Stop

    networks = [Network(comm, ply.preform, ply.fabric) for ply in case.stack()]
    try:
        return case.forming(networks).solve(accepted, keeper)
    except Stop:
        return None


def shown(result, comm):
    """Displacements of all crossovers, and the way slid on the other ply, by ply."""
    blank, state, fields = result.blank, result.states[-1], []
    for one, item in zip(blank.each, reversed(blank.between), strict=True):
        assert item.one.ply is one.ply
        net = one.network
        slid = np.zeros((net.num_crossovers_owned, 1))
        slid[item.one.rows, 0] = state.memory[item.name]["slid"]
        moved = one.ply.displacement(one.of_cloth(state))[0]
        number = net.crossover_number_global
        fields.append(gathered(comm, number, np.hstack([moved, slid])))
    return np.concatenate(fields)


def test_two_plies(tmp_path):
    """On all ranks, and begun on one and gone on with on all: as on one alone, to 1e-6."""
    if COMM.rank == 0:
        written(tmp_path, ("results = 2\n", ""), text=TWO_PLIES)
    COMM.barrier()
    case = Case.load(tmp_path / "cup.toml")
    alone = formed(case, MPI.COMM_SELF)
    wanted = shown(alone, MPI.COMM_SELF)
    # Places in metres of a stroke of 2 mm.
    together = formed(case, COMM)
    same_end(together, alone, 1e-6)
    np.testing.assert_allclose(shown(together, COMM), wanted, rtol=0, atol=2e-9)
    if COMM.rank == 0:
        begun = Checkpoint.begin(MPI.COMM_SELF, tmp_path / "out", case)
        assert formed(case, MPI.COMM_SELF, begun, 2) is None
    COMM.barrier()
    resumed = formed(case, COMM, Checkpoint.resume(COMM, tmp_path / "out"))
    same_end(resumed, alone, 1e-6)
    np.testing.assert_allclose(shown(resumed, COMM), wanted, rtol=0, atol=2e-9)
