# SPDX-License-Identifier: MIT
"""A forming that was interrupted on some ranks goes on on others, to the same end."""

import numpy as np
import pytest
from mpi4py import MPI
from support.forming import LONG, STROKE, kept, same_end, written

from cruciform_petsc.case.schema import Case
from cruciform_petsc.output.checkpoint import Checkpoint

COMM = MPI.COMM_WORLD
pytestmark = pytest.mark.three_ranks
# Sums over ranks round otherwise: shares of the stroke and of the largest force.
WITHIN = 1e-9
# In mid-stroke, drawn with friction under a holder that a force pushes; nothing wrinkles.
DRAWN = LONG[: LONG.index('[[stage]]\nname = "push"')]


def case_in(folder):
    """The same on every rank."""
    if COMM.rank == 0:
        written(folder, text=DRAWN)
    COMM.barrier()
    return Case.load(folder / "cup.toml")


def killed(folder, case, comm, stop):
    if comm == COMM or COMM.rank == 0:
        assert kept(comm, case, Checkpoint.begin(comm, folder, case), stop) is None
    COMM.barrier()


def displacements(case, result, comm):
    """Of all crossovers, by their numbers, on every rank of a communicator."""
    blank = result.blank
    network = blank.network
    moved = [blank.ply.displacement(blank.of_cloth(state))[0] for state in result.states]
    rows = comm.allgather((network.crossover_number_global, np.stack(moved, axis=1)))
    order = np.argsort(np.concatenate([number for number, _ in rows]))
    return np.concatenate([values for _, values in rows])[order]


@pytest.mark.parametrize("step", [None, 2])
@pytest.mark.parametrize("begun", ["on one rank", "on all"])
def test_same_end_on_other_ranks(tmp_path, begun, step):
    """From one to several and back, in mid-stroke: steps, forces, places, energies, fields."""
    case = case_in(tmp_path)
    first, then = (MPI.COMM_SELF, COMM) if begun == "on one rank" else (COMM, MPI.COMM_SELF)
    killed(tmp_path / "out", case, first, 3)
    alone = kept(MPI.COMM_SELF, case)
    wanted = displacements(case, alone, MPI.COMM_SELF)
    if then == COMM or COMM.rank == 0:
        result = kept(then, case, Checkpoint.resume(then, tmp_path / "out", None, step))
        same_end(result, alone, WITHIN)
        found = displacements(case, result, then)
        np.testing.assert_allclose(found, wanted, rtol=0, atol=WITHIN * STROKE)
    COMM.barrier()
