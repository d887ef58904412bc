# SPDX-License-Identifier: MIT
"""A test that was interrupted on some ranks goes on on others, through its files."""

import resource
import shutil

import numpy as np
import pytest
from mpi4py import MPI
from output.test_checkpoint import (
    CYCLE,
    FRAME,
    LOADS,
    RESISTS,
    SAME,
    case_of,
    curves_agree,
    dragged,  # noqa: F401  a fixture
    harms,
    solve,
)

from cruciform_petsc.case.schema import Case
from cruciform_petsc.errors import InputError
from cruciform_petsc.experiments.finite import FiniteTest
from cruciform_petsc.net.network import Network
from cruciform_petsc.output.checkpoint import Checkpoint

COMM = MPI.COMM_WORLD
pytestmark = pytest.mark.three_ranks
# Sums over ranks round otherwise, and Newton's steps with them: see test_checkpoint.
OTHER_RANKS = 100 * SAME


def killed_run(folder, case, comm, stop=4):
    """Leave a checkpoint written on these ranks, known to all when this returns."""
    if comm == COMM or COMM.rank == 0:
        assert solve(case, Checkpoint.begin(comm, folder, case), stop, comm) is None
    COMM.barrier()


def on_one(function):
    """Do something on rank 0 by itself, the others wait."""
    result = function() if COMM.rank == 0 else None
    COMM.barrier()
    return result


@pytest.mark.parametrize("test", [None, LOADS, FRAME], ids=["bias", "load", "frame"])
def test_resumed_on_one_rank(tmp_path, test):
    case = case_of() if test is None else case_of(test, "0 deg" if test is FRAME else "45 deg")
    killed_run(tmp_path, case, COMM, 1 if test is FRAME else 4)

    def resume():
        checkpoint = Checkpoint.resume(MPI.COMM_SELF, tmp_path)
        assert len(checkpoint.increments) == (1 if test is FRAME else 4)
        curves_agree(solve(case, checkpoint), solve(case), OTHER_RANKS)

    on_one(resume)


@pytest.mark.parametrize("test", [None, LOADS, FRAME], ids=["bias", "load", "frame"])
def test_begun_on_one_rank(tmp_path, test):
    case = case_of() if test is None else case_of(test, "0 deg" if test is FRAME else "45 deg")
    killed_run(tmp_path, case, MPI.COMM_SELF, 1 if test is FRAME else 4)
    checkpoint = Checkpoint.resume(COMM, tmp_path)
    assert len(checkpoint.increments) == (1 if test is FRAME else 4)
    result = solve(case, checkpoint, comm=COMM)
    curves_agree(result, solve(case, comm=COMM), OTHER_RANKS)


def test_shear_remembers_on_other_ranks(tmp_path):
    """Angles, anchors, time and what was dissipated go with their hinges, from all to one rank."""
    case = case_of(CYCLE, "45 deg", RESISTS)
    killed_run(tmp_path, case, COMM, 7)
    whole = solve(case, comm=COMM)

    def resume():
        result = solve(case, Checkpoint.resume(MPI.COMM_SELF, tmp_path))
        curves_agree(result, solve(case), OTHER_RANKS)
        assert result.curve()["dissipated_in_shear_J"][-1] > 0.0
        found = whole.increments[-1].columns["dissipated_in_shear_J"]
        expected = result.increments[-1].columns["dissipated_in_shear_J"]
        assert found == pytest.approx(expected, rel=OTHER_RANKS)

    on_one(resume)


def test_positions_do_not_depend_on_the_ranks(tmp_path):
    """To the last bit, at owned nodes and ghosts, whatever the ranks that read."""
    case = case_of()
    killed_run(tmp_path, case, COMM)

    def kept(comm):
        network = Network(comm, case.preform(), case.fabric())
        test = FiniteTest(case.experiment(network))
        nodes = test.ply.nodes
        path, former = Checkpoint.resume(comm, tmp_path).restore(test.model, test.at)
        assert len(path.states) == 3
        return nodes.node_key, [(state.time, state.x) for state in (*path.states, *former)]

    key, many = kept(COMM)
    one_key, one = kept(MPI.COMM_SELF)
    at = np.searchsorted(one_key, key)
    assert (one_key[at] == key).all()
    for (control, x), (one_control, one_x) in zip(many, one, strict=True):
        assert control == one_control
        np.testing.assert_array_equal(x, one_x[at])


def test_memory_does_not_depend_on_the_ranks(tmp_path, dragged):  # noqa: F811
    """What items remember of nodes, at owned ones and ghosts, of several types."""
    case = case_of()
    killed_run(tmp_path, case, COMM)

    def kept(comm):
        test = FiniteTest(case.experiment(Network(comm, case.preform(), case.fabric())))
        nodes = test.ply.nodes
        checkpoint = Checkpoint.resume(comm, tmp_path)
        path, former = checkpoint.restore(test.model, test.at)
        steps = zip(checkpoint.increments, former, strict=True)
        (state,) = (state for increment, state in steps if increment.asked)
        own = nodes.num_nodes_owned
        assert (path.state.memory["drag"]["count"] == 4).all()
        memory = path.state.memory["drag"]
        np.testing.assert_array_equal(memory["place"], path.state.x[:own])
        went_up = path.state.x[:own, 1] > nodes.rest[:own, 1]
        np.testing.assert_array_equal(memory["went_up"], went_up)
        assert memory["went_up"].dtype == bool
        # The state asked for has that of the one before it.
        before = state.memory["drag"]
        assert (before["count"] == 1).all()
        assert abs(before["place"] - state.x[:own]).max() > 1e-5
        return path.state.memory["drag"]

    assert len(kept(COMM)["count"]) > 0
    assert kept(MPI.COMM_SELF)["went_up"].any()
    curves_agree(
        solve(case, Checkpoint.resume(COMM, tmp_path), comm=COMM), solve(case, comm=COMM), 1e-8
    )


def test_begun_on_one_rank_with_memory(tmp_path, dragged):  # noqa: F811
    case = case_of()
    killed_run(tmp_path, case, MPI.COMM_SELF)
    result = solve(case, Checkpoint.resume(COMM, tmp_path), comm=COMM)
    curves_agree(result, solve(case, comm=COMM), OTHER_RANKS)


def test_damage_is_refused_on_every_rank(tmp_path):
    killed_run(tmp_path, case_of(), COMM, 2)
    folder = tmp_path / "checkpoint"
    for name in ("manifest.json", f"rank-{COMM.size - 1}.npy"):
        path = folder / "newest" / name
        good = path.read_bytes()
        COMM.barrier()
        on_one(lambda: shutil.rmtree(folder / "previous", ignore_errors=True))
        for harm, data in harms(good, np.random.default_rng(4)):
            on_one(lambda data=data, path=path: path.write_bytes(data))
            with pytest.raises(InputError, match="newest.*; begin anew with") as caught:
                Checkpoint.resume(COMM, tmp_path)
            assert len(set(COMM.allgather(str(caught.value)))) == 1, harm
        on_one(lambda path=path, good=good: path.write_bytes(good))


def test_files_of_two_runs_are_not_mixed(tmp_path):
    case = case_of()
    killed_run(tmp_path / "a", case, COMM)
    killed_run(tmp_path / "b", case, MPI.COMM_SELF)
    if COMM.size == 1:
        pytest.skip("two runs on one rank write the same")
    at = "checkpoint/state-1"
    on_one(lambda: shutil.rmtree(tmp_path / "b" / at))
    on_one(lambda: shutil.copytree(tmp_path / "a" / at, tmp_path / "b" / at))
    checkpoint = Checkpoint.resume(COMM, tmp_path / "b")
    with pytest.raises(InputError, match='state-1" is of another run than its neighbours'):
        solve(case, checkpoint, comm=COMM)


@pytest.mark.parametrize("full", [0, -1], ids=["first", "last"])
def test_full_disk_of_one_rank(tmp_path, full):
    """Ranks may write to different machines' disks; all end with the same sentence."""
    case = case_of()
    killed_run(tmp_path, case, COMM)
    checkpoint = Checkpoint.resume(COMM, tmp_path)
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    if COMM.rank == full % COMM.size:
        resource.setrlimit(resource.RLIMIT_FSIZE, (1000, hard))
    try:
        with pytest.raises(InputError, match='state-5" cannot be written: File too large; what'):
            solve(case, checkpoint, comm=COMM)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))
    checkpoint = Checkpoint.resume(COMM, tmp_path)
    assert checkpoint.notes == []
    assert len(checkpoint.increments) == 4
    curves_agree(solve(case, checkpoint, comm=COMM), solve(case, comm=COMM))


def test_ranks_without_nodes(tmp_path):
    """They have no rows in the file, and read their share all the same."""
    data = case_of(angle="0 deg").model_dump()
    data["preform"]["outline"]["rectangle"] = ["5.2 mm", "5.2 mm"]
    data["test"] = {"kind": "biaxial", "strain": ["1 %", "2 %"], "ratio": 1.0, "finite": True}
    case = Case.from_data(data)
    network = Network(COMM, case.preform(), case.fabric())
    assert network.num_crossovers_global == 1
    killed_run(tmp_path, case, COMM, 1)
    result = solve(case, Checkpoint.resume(COMM, tmp_path), comm=COMM)
    for force, values in solve(case, comm=COMM).forces.items():
        assert result.forces[force].tolist() == pytest.approx(values.tolist())
