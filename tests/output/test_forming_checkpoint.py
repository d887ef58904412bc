# SPDX-License-Identifier: MIT
"""A forming that was interrupted goes on as if it had not been."""

import csv
import json
import operator
import shutil

import h5py
import numpy as np
import pytest
from mpi4py import MPI
from output.test_checkpoint import case_of, forge, forge_both, setting
from support.forming import CASE, LONG, kept, same_end, written

from cruciform_petsc.case.schema import Case
from cruciform_petsc.cli import main
from cruciform_petsc.equilibrium import follow
from cruciform_petsc.errors import EquilibriumError, InputError
from cruciform_petsc.output.checkpoint import Checkpoint, _differences, determines
from cruciform_petsc.output.folder import unlock_directory

COMM = MPI.COMM_SELF


@pytest.fixture(scope="module")
def long_case(tmp_path_factory):
    return Case.load(written(tmp_path_factory.mktemp("long"), text=LONG))


@pytest.fixture(scope="module")
def whole(long_case):
    """It touches all that has to be kept: tools pushed and stopped, a contact that fades."""
    return kept(COMM, long_case)


@pytest.fixture(scope="module")
def count(whole):
    """Steps up to the first one within the third stage of four, where the run is killed."""
    times = [step.increment.control for step in whole.steps]
    found = 1 + next(number for number, time in enumerate(times) if time > 2.0)
    assert times[found - 1] < 3.0
    return found


@pytest.fixture(scope="module")
def killed(long_case, count, tmp_path_factory):
    folder = tmp_path_factory.mktemp("killed")
    assert kept(COMM, long_case, Checkpoint.begin(COMM, folder, long_case), count) is None
    return folder


@pytest.fixture
def copy(killed, tmp_path):
    """The same to do harm to."""
    shutil.copytree(killed / "checkpoint", tmp_path / "checkpoint")
    return tmp_path


def states_agree(one, other):
    for mine, theirs in zip(one.states, other.states, strict=True):
        np.testing.assert_array_equal(mine.x, theirs.x)
        for item, memory in theirs.memory.items():
            for name, array in memory.items():
                np.testing.assert_array_equal(mine.memory[item][name], array, f"{item} {name}")
        assert mine.factors == theirs.factors
        for tool, turn in theirs.hold.rotations.items():
            np.testing.assert_array_equal(mine.hold.rotations[tool], turn)


@pytest.mark.parametrize("time", [1.0, 2.0, 2.9, 4.0])
def test_goes_on_from_each_stage(tmp_path, long_case, whole, time):
    """To the last bit: within stages and at their ends, and where all is done."""
    stop = sum(step.increment.control <= time for step in whole.steps)
    assert kept(COMM, long_case, Checkpoint.begin(COMM, tmp_path, long_case), stop) is None
    checkpoint = Checkpoint.resume(COMM, tmp_path)
    assert len(checkpoint.steps) == stop
    assert checkpoint.notes == []
    result = kept(COMM, long_case, checkpoint)
    same_end(result, whole)
    states_agree(result, whole)


HELD = """[[clamp]]
edge = "right"
stiffness = "20 N/mm"
preload = "0.2 N"
friction_limit = "0.3 N"
[[clamp]]
edge = "upper"
"""


def test_clamps_suction_and_symmetry(tmp_path):
    """Whatever else there is: clamps that slip, loads that are lagged, planes of symmetry."""
    changes = (
        ('["56 mm", "56 mm"]', '["28 mm", "28 mm"]'),
        ('kind = "forming"', 'kind = "forming"\ngravity = true\nsymmetry = ["left", "lower"]'),
        ('name = "draw"', 'name = "draw"\nsuction = "50 Pa"'),
    )
    case = Case.load(written(tmp_path, *changes, text=CASE + HELD))
    alone = kept(COMM, case)
    clamp = next(name for name in alone.states[-1].memory if "right" in name)
    assert alone.states[-1].memory[clamp]["slipped"].max() > 0.0
    for stop in range(1, len(alone.steps)):
        folder = tmp_path / str(stop)
        assert kept(COMM, case, Checkpoint.begin(COMM, folder, case), stop) is None
        result = kept(COMM, case, Checkpoint.resume(COMM, folder))
        same_end(result, alone)
        states_agree(result, alone)
        assert result.steps[-1].load_work == alone.steps[-1].load_work
        for edge, force in alone.steps[-1].clamp_force.items():
            np.testing.assert_array_equal(result.steps[-1].clamp_force[edge], force)


def test_killed_again_and_again(tmp_path):
    """A forming that never gets farther than one step at a time."""
    case = Case.load(written(tmp_path))
    alone = kept(COMM, case)
    checkpoint = Checkpoint.begin(COMM, tmp_path, case)
    for number in range(len(alone.steps)):
        assert kept(COMM, case, checkpoint, number + 1) is None
        checkpoint = Checkpoint.resume(COMM, tmp_path)
    result = kept(COMM, case, checkpoint)
    same_end(result, alone)
    states_agree(result, alone)


def test_steps_that_were_cut_stay_short(tmp_path, monkeypatch):
    """One that failed twice is followed by those that it would have been followed by."""
    case, settle, times = Case.load(written(tmp_path)), follow.settle, [1.5, 1.25]

    def failing(equilibrium, guess):
        if guess.time in times:
            times.remove(guess.time)
            raise EquilibriumError("no", "NO", [])
        return settle(equilibrium, guess)

    monkeypatch.setattr(follow, "settle", failing)
    alone = kept(COMM, case)
    times[:] = [1.5, 1.25]
    assert [step.increment.control for step in alone.steps[1:3]] == [1.125, 1.3125]
    assert kept(COMM, case, Checkpoint.begin(COMM, tmp_path, case), 2) is None
    same_end(kept(COMM, case, Checkpoint.resume(COMM, tmp_path)), alone)


@pytest.mark.parametrize("back", [3, 0])
def test_from_an_earlier_step(copy, whole, long_case, count, back):
    """What came after it is given up, and the newest checkpoint is the one gone on from."""
    step = count - back
    checkpoint = Checkpoint.resume(COMM, copy, from_step=step)
    assert len(checkpoint.steps) == step
    assert kept(COMM, long_case, checkpoint, step + 1) is None
    again = Checkpoint.resume(COMM, copy)
    assert len(again.steps) == step + 1
    result = kept(COMM, long_case, again)
    same_end(result, whole)
    states_agree(result, whole)


def test_killed_as_an_earlier_step_is_gone_on_from(copy, whole, long_case, monkeypatch):
    """Its next state takes the place of the one of before, and the newest is not written yet."""
    put = Checkpoint._put

    def dying(checkpoint, model, name, *more):
        done = put(checkpoint, model, name, *more)
        if name == "state-4":
            raise KeyboardInterrupt
        return done

    # Other steps than before, so that the state is another one.
    case = changed(long_case, "stage", 1, "step", 0.2)
    stepping_back = Checkpoint.resume(COMM, copy, case, 3)
    monkeypatch.setattr(Checkpoint, "_put", dying)
    with pytest.raises(KeyboardInterrupt):
        kept(COMM, case, stepping_back)
    monkeypatch.undo()
    checkpoint = Checkpoint.resume(COMM, copy, case)
    assert len(checkpoint.steps) == 3
    result = kept(COMM, case, checkpoint)
    assert len(result.steps) > len(whole.steps)
    assert result.steps[-1].increment.control == 4.0


def test_steps_that_are_not_there(copy, count):
    for step in (0, count + 1, -1):
        told = f"no step {step} to go on from in .*, which has come to step {count}"
        with pytest.raises(InputError, match=told):
            Checkpoint.resume(COMM, copy, from_step=step)


def changed(case, *names_and_value):
    """Another case: changed(case, "stage", 1, "step", 0.2)."""
    data = case.model_dump()
    setting(*names_and_value)(data)
    return Case.from_data(data)


OTHERS = {
    "stage[1].travel.punch": ("stage", 1, "travel", "punch", ["0 mm", "0 mm", "-7 mm"]),
    "stage[1].results": ("stage", 1, "results", 3),
    "tool[0].friction": ("tool", 0, "friction", 0.3),
    "test.contact.viscosity": ("test", "contact", {"viscosity": "2 N s/m^3"}),
    "fabric.thickness": ("fabric", "thickness", "1.1 mm"),
}


@pytest.mark.parametrize("key", OTHERS)
def test_other_cases_are_refused(killed, long_case, key):
    """What only says how to get there may be another, see below."""
    other = changed(long_case, *OTHERS[key])
    told = f"belongs to another case ({key} differs): resume with the case as it was, or begin anew"
    with pytest.raises(InputError) as caught:
        Checkpoint.resume(COMM, killed, other)
    assert told in str(caught.value)


def test_steps_output_and_solver_may_change(killed, long_case, count):
    other = changed(long_case, "stage", 3, "step", 0.1)
    other = changed(other, "solver", {"options": {"snes_max_it": 50}})
    other = changed(other, "title", "another")
    assert len(Checkpoint.resume(COMM, killed, other).steps) == count


def test_a_tools_file_may_move_but_not_change(tmp_path):
    """What is in it counts; without it nothing is begun."""
    path, other = tmp_path / "ring.stl", tmp_path / "other.stl"
    path.write_bytes(b"a ring")
    ring = '{ ring = { inner_radius = "20 mm", outer_radius = "60 mm" } }'
    case = Case.load(written(tmp_path, (ring, '{ file = "ring.stl", unit = "mm" }')))
    known = determines(case)
    path.rename(other)
    assert determines(changed(case, "tool", 2, "shape", "file", str(other))) == known
    with pytest.raises(InputError, match='tool "holder": .*ring.stl" cannot be read: No such file'):
        Checkpoint.begin(COMM, tmp_path / "out", case)
    path.write_bytes(b"another ring")
    assert _differences(determines(case), known) == ["tool[2].shape.file"]


STEP = ("run", "increments", 0)
FORGED = {
    "another tool": setting(*STEP, "tool_force", {"anvil": [0.0, 0.0, 1.0]}),
    "a tool less": lambda data: operator.delitem(
        data["run"]["increments"][0]["tool_place"], "holder"
    ),
    "a force in the plane": setting(*STEP, "tool_force", "die", [0.0, 1.0]),
    "a force without end": setting(*STEP, "tool_force", "die", [0.0, 0.0, 1e300]),
    "a force of text": setting(*STEP, "tool_force", "die", ["0", "0", "1"]),
    "a place that is no number": setting(*STEP, "tool_place", "die", [0.0, 0.0, float("nan")]),
    "work of a load that is not there": setting(*STEP, "load_work", {"gravity": 1.0}),
    "work of a load that overflows": setting(*STEP, "load_work", {"gravity": 1e300}),
    "dissipation that overflows": setting(*STEP, "spent", "friction", -1e300),
    "a clamp that is not there": setting(*STEP, "clamp_force", {"left": [0.0, 0.0, 1.0]}),
    "work that is no number": setting(*STEP, "work", float("inf")),
    "another stage": setting(*STEP, "stage", "draw"),
    "a stage of escapes": setting(*STEP, "stage", "\x1b[2J"),
    "a mere increment": lambda data: operator.setitem(
        data["run"]["increments"], 0, data["run"]["increments"][0]["increment"]
    ),
    "mere increments": lambda data: operator.setitem(
        data["run"], "increments", [step["increment"] for step in data["run"]["increments"]]
    ),
    "beyond the last stage": setting(*STEP, "increment", "control", 1e300),
    "energies of others": lambda data: [
        operator.setitem(step["increment"], "energies", {"heat": 1.0})
        for step in data["run"]["increments"]
    ][:0] or None,
    "begun in a stage that is not there": setting("run", "path", "begin", 4.0),
    "begun before its stage": setting("run", "path", "begin", 0.0),
    "begun within": setting("run", "path", "begin", 2.5),
    "memory of another item": setting(
        "arrays", "memory", {"anvil": {"spent": {"type": "<f8", "shape": []}}}
    ),
}  # fmt: skip


@pytest.mark.parametrize("what", FORGED)
def test_forged_manifests_are_refused(copy, long_case, what):
    """All checksums are right, and nobody wrote it; in one sentence, before anything is solved."""
    forge_both(copy, FORGED[what])
    with pytest.raises(InputError, match="begin anew") as caught:
        kept(COMM, long_case, Checkpoint.resume(COMM, copy))
    text = str(caught.value)
    assert str(copy) in text
    assert text.isprintable()


def test_memory_of_other_shapes_is_refused(copy, long_case):
    """An array less, of an item that there is; the file has what the manifest says."""
    path = copy / "checkpoint" / "newest" / "rank-0.npy"
    records = np.load(path)
    names = [name for name in records.dtype.names if name != "die/pressed"]
    fewer = np.empty(len(records), [(name, *records.dtype.fields[name][:1]) for name in names])
    for name in names:
        fewer[name] = records[name]
    np.save(path, fewer)
    forge(path.parent, lambda data: data["arrays"]["memory"]["die"].pop("pressed") and None)
    checkpoint = Checkpoint.resume(COMM, copy)
    assert checkpoint.notes == []
    with pytest.raises(InputError, match="is of another network"):
        kept(COMM, long_case, checkpoint)


def test_checkpoints_of_flat_tests_are_no_help(copy):
    with pytest.raises(InputError, match="belongs to another case"):
        Checkpoint.resume(COMM, copy, case_of())


# -- as a user does it -----------------------------------------------------------------------------


def rows_of(folder, *effort):
    with (folder / "forces.csv").open() as file:
        rows = list(csv.DictReader(file))
    return [{key: row[key] for key in row if key != "seconds"} for row in rows]


def test_resumed_by_the_command(tmp_path, capfd):
    """Tables and series are those of a run left alone; once more there is nothing to do."""
    path = written(tmp_path, text=f"{CASE}[output]\npictures = false\n")
    case, alone, out = Case.load(path), tmp_path / "alone", tmp_path / "out"
    assert main(["run", str(path), "--output", str(alone), "--quiet"]) == 0
    for step, options in ((2, []), (3, ["--from-step", "1"])):
        assert kept(COMM, case, Checkpoint.begin(COMM, out, case), step) is None
        unlock_directory(out)
        capfd.readouterr()
        assert main(["resume", str(out), *options]) == 0
        former = 1 if options else 2
        assert f'going on from {100 if options else 50} % of stage "' in capfd.readouterr().out
        summary = json.loads((out / "summary.json").read_text())
        assert summary["resumed_after_steps"] == former
        assert [stage["steps"] for stage in summary["stages"]] == [1, 2]
        assert rows_of(out) == rows_of(alone)
        for name in ("fields.csv", "outline.csv"):
            assert (out / name).read_text() == (alone / name).read_text()
        with h5py.File(out / "series.vtkhdf") as mine, h5py.File(alone / "series.vtkhdf") as theirs:
            for name in ("VTKHDF/Steps/Values", "VTKHDF/Points"):
                np.testing.assert_array_equal(mine[name], theirs[name])
    assert main(["resume", str(out)]) == 2
    assert "is finished, there is nothing to resume" in capfd.readouterr().err


@pytest.mark.parametrize("text", ["0", "-2", "two", "1.5", "9" * 20])
def test_a_step_that_is_no_number(tmp_path, capfd, text):
    assert main(["resume", str(tmp_path), f"--from-step={text}"]) == 2
    told = capfd.readouterr().err
    assert f'--from-step must be the number of a step, from 1, got "{text}"' in told
