# SPDX-License-Identifier: MIT
"""A test that was interrupted goes on as if it had not been, and never from damaged files."""

import json
import pickle
import pkgutil
import resource
import shutil
from hashlib import sha256
from types import SimpleNamespace

import numpy as np
import pytest
from mpi4py import MPI

from cruciform_petsc import __version__
from cruciform_petsc.case.schema import Case
from cruciform_petsc.errors import InputError
from cruciform_petsc.net.network import Network
from cruciform_petsc.net.nodes import Nodes
from cruciform_petsc.output.checkpoint import BLOCK, NAME, SEAL, Checkpoint, crossover_of

COMM = MPI.COMM_SELF
BIAS = {"kind": "bias-extension", "extension": ["1 mm", "3 mm", "4 mm"], "increments": 8}
# From the same states the same steps follow, but for rounding; by other steps (ANY) Newton's method
# stops elsewhere within its tolerance of 1e-8 of the forces, to which columns other than the load,
# in which the error is squared, are right.
SAME, ANY = 1e-10, 1e-7


def case_of(test=BIAS, angle="45 deg"):
    return Case.from_data({
        "fabric": {
            "use": "glass-pp-plain-1.93",
            "shear": {"law": "table", "angle": "deg", "force": "N/mm",
                      "points": [[5, 0.002], [20, 0.004], [35, 0.011], [50, 0.05]]},
        },
        "preform": {"outline": {"rectangle": ["22 mm", "40 mm"]}, "bias_angle": angle},
        "test": test | {"finite": True},
    })  # fmt: skip


class Stop(Exception):
    """What kills a run."""


def solve(case, checkpoint=None, stop=None, comm=COMM):
    """Solve; killed after `stop` increments (None: not)."""
    network = Network(comm, case.preform(), case.fabric())
    told = []

    def accepted(increment):
        told.append(increment)
        if len(told) == stop:
            raise Stop

    try:
        return case.experiment(network).solve(accepted, checkpoint)
    except Stop:
        return None


def curves_agree(one, other, within=SAME):
    assert one.controls.tolist() == pytest.approx(other.controls.tolist(), rel=within)
    found, wanted = one.curve(), other.curve()
    energy = sum(column for name, column in wanted.items() if name.startswith("energy"))
    for name, column in wanted.items():
        scale = abs(energy if name.startswith("energy") else column).max()
        np.testing.assert_allclose(found[name], column, rtol=0, atol=within * scale, err_msg=name)


@pytest.fixture(scope="module")
def undisturbed():
    return solve(case_of())


@pytest.fixture(scope="module")
def killed(tmp_path_factory):
    """Results of a run that was killed after six of its increments, one of them asked for."""
    folder = tmp_path_factory.mktemp("killed")
    assert solve(case_of(), Checkpoint.begin(COMM, folder, case_of()), stop=6) is None
    return folder


@pytest.fixture
def copy(killed, tmp_path):
    """The same to do harm to."""
    shutil.copytree(killed / "checkpoint", tmp_path / "checkpoint")
    return tmp_path


LOADS = {"kind": "bias-extension", "load": ["0.1 N", "0.2 N"], "increments": 5}
BACK = {"kind": "bias-extension", "extension": ["2 mm", "-1 mm", "2 mm"]}
FRAME = {"kind": "picture-frame", "angle": ["6 deg", "20 deg"]}
FREE = {"kind": "off-axis-tension", "ends": "free", "extension": "1 mm", "increments": 3}
DEAD = {"kind": "cantilever", "load": ["1e-4 N", "3e-4 N"], "increments": 4}
TWICE = {"kind": "bias-extension", "extension": ["1 mm", "1 mm", "2 mm"], "increments": 3}
TWICE_BY_LOAD = {"kind": "bias-extension", "load": ["0.1 N", "0.1 N", "0.15 N"]}
KINDS = {
    "bias by load": (LOADS, "45 deg"),
    "a value twice": (TWICE, "45 deg"),
    "a load twice": (TWICE_BY_LOAD, "45 deg"),
    "there and back": (BACK, "45 deg"),
    "turning grips": (FRAME, "0 deg"),
    "free ends": (FREE, "30 deg"),
    "dead load": (DEAD, "0 deg"),
}


@pytest.mark.parametrize("kind", KINDS)
def test_every_kind_goes_on_from_each_increment(tmp_path, kind):
    """The same increments as without the interruption, and the same curve."""
    case = case_of(*KINDS[kind])
    whole = solve(case)
    controls = [increment.control for increment in whole.increments]
    assert len(controls) >= 2
    for stop in sorted({1, len(controls) // 2, len(controls) - 1, len(controls)}):
        folder = tmp_path / str(stop)
        assert solve(case, Checkpoint.begin(COMM, folder, case), stop) is None
        checkpoint = Checkpoint.resume(COMM, folder, case)
        assert len(checkpoint.increments) == stop
        assert checkpoint.notes == []
        result = solve(case, checkpoint)
        found = [increment.control for increment in result.increments]
        assert found == pytest.approx(controls, rel=SAME)
        asked = [increment.asked for increment in result.increments]
        assert asked == [increment.asked for increment in whole.increments]
        curves_agree(result, whole)


def test_killed_again_and_again(tmp_path, undisturbed):
    """A run that never gets farther than one increment at a time."""
    case = case_of()
    checkpoint = Checkpoint.begin(COMM, tmp_path, case)
    for _ in range(len(undisturbed.increments)):
        assert solve(case, checkpoint, stop=1) is None
        checkpoint = Checkpoint.resume(COMM, tmp_path)
    curves_agree(solve(case, checkpoint), undisturbed)


def test_killed_before_the_first_increment(tmp_path, undisturbed, monkeypatch):
    case = case_of()
    checkpoint = Checkpoint.begin(COMM, tmp_path, case)

    def stop(*_, **__):
        raise Stop

    with monkeypatch.context() as patch:
        patch.setattr("cruciform_petsc.experiments.experiment.follow", stop)
        assert solve(case, checkpoint) is None
    checkpoint = Checkpoint.resume(COMM, tmp_path)
    assert checkpoint.increments == []
    curves_agree(solve(case, checkpoint), undisturbed)


def test_histories_come_back_as_they_were(killed, undisturbed):
    """All that is told about an increment, not only its load."""
    found = Checkpoint.resume(COMM, killed).increments
    for one, other in zip(found, undisturbed.increments, strict=False):
        for name in ("control", "load", "iterations", "asked", "shifted", "history"):
            assert getattr(one, name) == getattr(other, name)
        assert one.energies.tolist() == other.energies.tolist()
    assert len(found) == 6


def test_case_comes_with_it(killed):
    case = Checkpoint.resume(COMM, killed).case
    assert case == case_of()


def test_smaller_increments_may_be_asked_for(copy, undisturbed):
    """The way there is no part of the case; title and output are not, either."""
    case = case_of(BIAS | {"increments": 20})
    case = case.model_copy(update={"title": "another"})
    result = solve(case, Checkpoint.resume(COMM, copy, case))
    assert len(result.increments) > len(undisturbed.increments)
    curves_agree(result, undisturbed, ANY)


# -- files that are not what was written ----------------------------------------------------------


def refused(folder, case=None):
    """The sentence with which a folder is refused."""
    with pytest.raises(InputError) as caught:
        solve(case_of(), Checkpoint.resume(COMM, folder, case))
    text = str(caught.value)
    assert str(folder) in text
    assert "\n" not in text
    return text


def harms(data, random):
    """Many ways to spoil a file."""
    n = len(data)
    yield "empty", b""
    for at in {0, 1, n - 1, n - SEAL.size, *random.integers(0, n, 30)}:
        yield f"cut at {at}", data[:at]
    for at in {0, n - 1, n - SEAL.size, *random.integers(0, n, 60)}:
        bit = 1 << int(random.integers(8))
        yield f"flipped at {at}", data[:at] + bytes([data[at] ^ bit]) + data[at + 1 :]
    yield "one byte more", data + b"x"
    yield "one byte less within", data[: n // 2] + data[n // 2 + 1 :]
    yield "zeros in the middle", data[: n // 2] + bytes(512) + data[n // 2 + 512 :]
    yield "zeros only", bytes(n)
    yield "noise", random.bytes(n)
    yield "HDF5", b"\x89HDF\r\n\x1a\n" + data
    yield "text", b"cruciform_petsc\n"
    yield "twice", data + data


class Bomb:
    """What a pickle can do."""

    def __reduce__(self):
        return pytest.fail, ("loading a file ran code",)


def test_damage_to_the_newest_is_told_and_the_one_before_taken(copy):
    newest = copy / "checkpoint" / "newest"
    good = newest.read_bytes()
    spoiled = dict(harms(good, np.random.default_rng(1)))
    spoiled["pickle"] = pickle.dumps(Bomb())
    assert len(spoiled) > 90
    for harm, data in spoiled.items():
        newest.write_bytes(data)
        checkpoint = Checkpoint.resume(COMM, copy)
        assert len(checkpoint.increments) == 5, harm
        (note,) = checkpoint.notes
        assert str(newest) in note
        assert "going on from the one before it" in note, harm


def test_damage_to_both_is_refused(copy):
    folder = copy / "checkpoint"
    (folder / "newest").write_bytes(b"")
    good = (folder / "previous").read_bytes()
    for harm, data in harms(good, np.random.default_rng(2)):
        (folder / "previous").write_bytes(data)
        text = refused(copy)
        assert "and so is the one before it; begin anew" in text, harm


def test_damage_to_a_state_is_refused(copy):
    """Results need it."""
    state = copy / "checkpoint" / "state-1"
    # The network is made for each of them, which takes its time.
    for harm, data in list(harms(state.read_bytes(), np.random.default_rng(3)))[::5]:
        state.write_bytes(data)
        assert "begin anew" in refused(copy), harm
    state.unlink()
    assert "is missing" in refused(copy)


def test_going_on_from_the_one_before_mends_the_newest(copy, undisturbed):
    """And does not put the damaged file in the place of the good one."""
    folder = copy / "checkpoint"
    (folder / "newest").write_bytes(b"damaged")
    good = (folder / "previous").read_bytes()
    assert solve(case_of(), Checkpoint.resume(COMM, copy), stop=1) is None
    assert (folder / "previous").read_bytes() == good
    checkpoint = Checkpoint.resume(COMM, copy)
    assert checkpoint.notes == []
    assert len(checkpoint.increments) == 6
    curves_agree(solve(case_of(), checkpoint), undisturbed)


def test_killed_between_the_renames(copy, undisturbed):
    """The newest has become the previous, and the new one has no name yet."""
    folder = copy / "checkpoint"
    (folder / "newest").replace(folder / "previous")
    (folder / "new").write_bytes(b"half")
    checkpoint = Checkpoint.resume(COMM, copy)
    assert len(checkpoint.increments) == 6
    curves_agree(solve(case_of(), checkpoint), undisturbed)
    assert not (folder / "new").exists()


def rewrite(path, change):
    """Change the header of a file and seal it again."""
    data = path.read_bytes()[: -SEAL.size]
    first, head, rest = data.split(b"\n", 2)
    header = json.loads(head)
    first, header = change(first, header)
    data = b"\n".join([first, json.dumps(header).encode(), rest])
    blocks = [sha256(data[at : at + BLOCK]).digest() for at in range(0, len(data), BLOCK)]
    path.write_bytes(data + SEAL.pack(len(data), sha256(b"".join(blocks)).digest()))


def test_foreign_checkpoints_are_refused(copy):
    """Whole, but of another program, format, case or network; the one before it is no help."""
    newest = copy / "checkpoint" / "newest"
    good = newest.read_bytes()
    rewrite(newest, lambda first, header: (first, header))
    assert newest.read_bytes() == good

    rewrite(newest, lambda first, header: (NAME + b"7", header))
    assert f"has format 7, and this version of cruciform_petsc ({__version__})" in refused(copy)
    newest.write_bytes(good)
    rewrite(newest, lambda first, header: (first, header | {"program": "9.9"}))
    assert f"was written by cruciform_petsc 9.9, and this is {__version__}" in refused(copy)

    newest.write_bytes(good)
    text = refused(copy, case_of(BIAS | {"extension": ["1 mm", "3 mm", "5 mm"]}))
    assert "belongs to another case (test.extension differs)" in text
    other = case_of(FREE, "30 deg")
    assert "belongs to another case (preform.bias_angle, test.kind" in refused(copy, other)


def test_a_state_is_no_checkpoint(copy):
    shutil.copy(copy / "checkpoint" / "state-1", copy / "checkpoint" / "newest")
    (note,) = Checkpoint.resume(COMM, copy).notes
    assert "is damaged: its header makes no sense; going on from the one before it" in note


@pytest.mark.parametrize("key", ["increments", "path", "states", "nodes", "case", "determines"])
@pytest.mark.parametrize("value", [None, "text", [1], {"a": []}, "missing"])
def test_headers_without_sense_are_refused(copy, key, value):
    """Nobody writes them; but whoever does gets a sentence, too."""
    for name in ("newest", "previous"):

        def change(first, header):
            if value == "missing":
                header.pop(key)
                return first, header
            return first, header | {key: value}

        rewrite(copy / "checkpoint" / name, change)
    refused(copy)


def test_positions_of_another_network_are_refused(copy):
    case = case_of()
    data = case.model_dump()
    data["preform"]["outline"]["rectangle"] = ["22 mm", "44 mm"]
    other = Case.from_data(data)
    text = refused(copy, other)
    assert "preform.outline.rectangle differs" in text

    # The header says it is of this case, and the nodes are others.
    def lie(first, header):
        header["determines"]["preform"] = data["preform"]
        return first, header | {"case": data}

    rewrite(copy / "checkpoint" / "newest", lie)
    checkpoint = Checkpoint.resume(COMM, copy, other)
    with pytest.raises(InputError, match="of another network; begin anew"):
        solve(other, checkpoint)


def test_nothing_there(tmp_path):
    assert "there is no checkpoint in" in refused(tmp_path)
    assert "there is no checkpoint in" in refused(tmp_path / "nowhere")
    (tmp_path / "summary.json").write_text("{}")
    assert "is finished, there is nothing to resume" in refused(tmp_path)


# -- writing --------------------------------------------------------------------------------------


def test_begin_puts_an_unfinished_run_aside(copy):
    good = (copy / "checkpoint" / "newest").read_bytes()
    checkpoint = Checkpoint.begin(COMM, copy, case_of())
    assert "the checkpoint of a run that was not finished is now" in checkpoint.notes[0]
    assert list((copy / "checkpoint").iterdir()) == []
    assert (copy / "checkpoint.old" / "newest").read_bytes() == good
    assert Checkpoint.begin(COMM, copy, case_of()).notes == []  # nothing had been reached
    assert (copy / "checkpoint.old" / "newest").read_bytes() == good
    checkpoint.remove()  # results of the new run are there; the old one can still be resumed
    assert [path.name for path in copy.iterdir()] == ["checkpoint.old"]
    (copy / "checkpoint.old").rename(copy / "checkpoint")
    assert Checkpoint.resume(COMM, copy).increments


STEPS = [
    "cruciform_petsc.output.checkpoint._allocate",
    "cruciform_petsc.output.checkpoint._digest",
    "cruciform_petsc.output.checkpoint._rows",
    "cruciform_petsc.output.checkpoint._sync_folder",
    "os.fsync",
    "pathlib.Path.replace",
]


@pytest.mark.parametrize("step", STEPS)
def test_killed_at_each_step_of_writing(killed, tmp_path, step, undisturbed, monkeypatch):
    """Before and after each thing that is done to a file, that of a state among them."""
    do = pkgutil.resolve_name(step)
    for call in (1, 2, 3):
        for after in (False, True):
            folder = tmp_path / f"{call}-{after}"
            shutil.copytree(killed, folder)
            checkpoint = Checkpoint.resume(COMM, folder)
            restore, calls = checkpoint.restore, []

            def dying(*arguments, calls=calls, call=call, after=after):
                calls.append(arguments)
                if len(calls) == call and not after:
                    raise Stop
                result = do(*arguments)
                if len(calls) == call:
                    raise Stop
                return result

            def restoring(model, restore=restore, dying=dying):
                kept = restore(model)  # reads, and is not what is looked at
                monkeypatch.setattr(step, dying)
                return kept

            monkeypatch.setattr(checkpoint, "restore", restoring)
            assert solve(case_of(), checkpoint) is None
            monkeypatch.undo()
            checkpoint = Checkpoint.resume(COMM, folder)
            assert checkpoint.notes == []
            assert len(checkpoint.increments) >= 6
            curves_agree(solve(case_of(), checkpoint), undisturbed)


@pytest.mark.parametrize("room", [0, 100, 3000, 12000])
def test_full_disk(copy, room, undisturbed):
    """One sentence that says how to go on, and the last good checkpoint is still there."""
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    folder = copy / "checkpoint"
    before = {path.name: path.read_bytes() for path in folder.iterdir()}
    checkpoint = Checkpoint.resume(COMM, copy)
    resource.setrlimit(resource.RLIMIT_FSIZE, (room, hard))
    try:
        with pytest.raises(InputError) as caught:
            solve(case_of(), checkpoint)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))
    assert str(caught.value) == (
        f'the checkpoint "{folder / "newest"}" cannot be written: File too large; what was reached '
        f"is kept, continue with: cruciform-petsc resume {copy}"
    )
    after = {path.name: path.read_bytes() for path in folder.iterdir()}
    if room < len(before["newest"]):
        assert {name: after[name] for name in before} == before
    assert "new" not in after
    checkpoint = Checkpoint.resume(COMM, copy)
    assert checkpoint.notes == []
    assert len(checkpoint.increments) >= 6
    curves_agree(solve(case_of(), checkpoint), undisturbed)


def test_failing_renames_and_reads_are_told(tmp_path, monkeypatch):
    case = case_of()
    checkpoint = Checkpoint.begin(COMM, tmp_path, case)
    monkeypatch.setattr("os.fsync", lambda handle: (_ for _ in ()).throw(OSError(5, "I/O error")))
    with pytest.raises(InputError, match='newest" cannot be written: I/O error$'):
        solve(case, checkpoint)
    assert list((tmp_path / "checkpoint").iterdir()) == []


def test_folder_in_the_way(tmp_path):
    (tmp_path / "checkpoint").write_text("a file")
    with pytest.raises(InputError, match='checkpoint" cannot be made: '):
        Checkpoint.begin(COMM, tmp_path, case_of())


@pytest.mark.parametrize("angle", ["45 deg", "0 deg", "17 deg"])
def test_keys_tell_the_crossover(angle):
    """Each node's key leads to a crossover of the rank that owns it: here, to one it touches."""
    case = case_of(angle=angle)
    network = Network(COMM, case.preform(), case.fabric())
    nodes = Nodes(network)
    found = crossover_of(nodes.node_key)
    assert network.has_crossover(found).all()
    touching = SimpleNamespace(sets=[set() for _ in nodes.node_key])
    for at, ij in zip(nodes.of_hinge, network.crossover_ij.tolist(), strict=True):
        touching.sets[at].add(tuple(ij))
    for ends, ij in zip(network.arm_node, network.crossover_ij.tolist(), strict=True):
        for end in nodes.of_network_node[ends]:
            touching.sets[end].add(tuple(ij))
    for crossover, near in zip(found.tolist(), touching.sets, strict=True):
        assert tuple(crossover) == min(near)
