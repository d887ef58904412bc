# SPDX-License-Identifier: MIT
"""A test that was interrupted goes on as if it had not been, and never from damaged files."""

import io
import json
import operator
import os
import pickle
import pkgutil
import resource
import shutil
from contextlib import suppress
from functools import partialmethod, reduce
from hashlib import sha256
from pathlib import Path

import numpy as np
import pytest
from mpi4py import MPI

from cruciform_petsc import __version__
from cruciform_petsc.case.schema import Case
from cruciform_petsc.elements.level import FORCE, STIFFNESS, room
from cruciform_petsc.equilibrium import cloth
from cruciform_petsc.equilibrium.model import Model
from cruciform_petsc.errors import InputError
from cruciform_petsc.experiments import finite
from cruciform_petsc.experiments.result import EFFORT
from cruciform_petsc.items.item import Item
from cruciform_petsc.net.network import Network
from cruciform_petsc.net.nodes import Nodes
from cruciform_petsc.output.checkpoint import Checkpoint
from cruciform_petsc.output.folder import MANIFEST as NAMES

COMM = MPI.COMM_SELF
BIAS = {"kind": "bias-extension", "extension": ["1 mm", "3 mm", "4 mm"], "increments": 8}
# From the same states the same steps follow, but for rounding; by other steps (ANY) Newton's method
# stops elsewhere within its tolerance of 1e-8 of the forces, to which columns other than the load,
# in which the error is squared, are right.
SAME, ANY = 1e-10, 1e-7


def case_of(test=BIAS, angle="45 deg", further=None):
    return Case.from_data({
        "fabric": (further or {}) | {
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


def curves_agree(one, other, within=SAME, states=False):
    """All increments, or with ``states`` what was asked for; how they were found does not count."""
    assert one.controls.tolist() == pytest.approx(other.controls.tolist(), rel=within)
    found, wanted = one.curve(states), other.curve(states)
    for name in EFFORT.keys() & wanted.keys():
        del wanted[name]
    energy = sum(column for name, column in wanted.items() if name.startswith("energy"))
    for name, column in wanted.items():
        scale = abs(energy if name.startswith("energy") else column).max()
        np.testing.assert_allclose(found[name], column, rtol=0, atol=within * scale, err_msg=name)


@pytest.fixture(scope="module")
def undisturbed():
    return solve(case_of())


@pytest.fixture(scope="module")
def killed(tmp_path_factory):
    """Results of a run that was killed after six of its increments, two of them asked for."""
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
TRUSS = {"kind": "bias-extension", "extension": "3 mm", "increments": 4, "model": "truss"}
TWICE = {"kind": "bias-extension", "extension": ["1 mm", "1 mm", "2 mm"], "increments": 3}
TWICE_BY_LOAD = {"kind": "bias-extension", "load": ["0.1 N", "0.1 N", "0.15 N"]}
SLIP = {"kind": "bias-extension", "extension": ["2 mm", "3 mm", "2.5 mm"], "increments": 4,
        "slip": {"force": "0.01 N"}}  # fmt: skip
# Shear that flows and rubs, and remembers.
CYCLE = {
    "kind": "bias-extension", "extension": ["2 mm", "0.5 mm", "2 mm"], "increments": 6,
    "speed": "10 mm/min",
}  # fmt: skip
RESISTS = {"shear_viscosity": {"viscosity": "100 N s/m"}, "shear_friction": {"torque": "1 N/m"}}
KINDS = {
    "bias by load": (LOADS, "45 deg"),
    "a value twice": (TWICE, "45 deg"),
    "a load twice": (TWICE_BY_LOAD, "45 deg"),
    "there and back": (BACK, "45 deg"),
    "turning grips": (FRAME, "0 deg"),
    "free ends": (FREE, "30 deg"),
    "dead load": (DEAD, "0 deg"),
    "yarns that slide": (SLIP, "45 deg"),
    "truss": (TRUSS, "45 deg"),
    "shear with a memory": (CYCLE, "45 deg", RESISTS),
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
        moved = [state.node_displacement for state in result.every_state()]
        for found, wanted in zip(moved, whole.every_state(), strict=True):
            np.testing.assert_allclose(found, wanted.node_displacement, rtol=0, atol=1e-12)


STRUT = {
    "kind": "off-axis-tension", "extension": ["-0.4 um", "-6 um"], "space": True,
    "stability": {"step": "0.05 mm"},
}  # fmt: skip


@pytest.mark.parametrize("stop", [1, 2, 3])
def test_a_strut_that_buckles(tmp_path, stop):
    """Killed before, at and behind its critical state, it goes along the same branch."""
    case = case_of(STRUT, "0 deg")
    whole = solve(case)
    assert whole.curve()["critical"].tolist() == [0, 1, 0]
    assert solve(case, Checkpoint.begin(COMM, tmp_path, case), stop) is None
    found = solve(case, Checkpoint.resume(COMM, tmp_path))
    # Newton begins elsewhere when the critical state is the last one known; nothing shears.
    one, other = found.curve(), whole.curve()
    for name in ("load_N", "height_max_mm", "lowest_stiffness_Pa_per_mm", "critical"):
        within = (ANY if stop == 2 else SAME) * abs(other[name]).max()
        np.testing.assert_allclose(one[name], other[name], atol=within, rtol=0, err_msg=name)
    assert found.heights_max[-1] > 1e-5
    for one, other in zip(found.buckling.modes, whole.buckling.modes, strict=True):
        np.testing.assert_allclose(one.node_displacement, other.node_displacement, atol=1e-6)
    assert found.buckling.linear[0].load == pytest.approx(whole.buckling.linear[0].load, rel=1e-9)


@pytest.mark.parametrize("kind", KINDS)
def test_every_kind_goes_on_from_an_earlier_increment(tmp_path, kind):
    """Other than the last one: the same increments once more, and the same curve."""
    case = case_of(*KINDS[kind])
    whole = solve(case)
    controls = [increment.control for increment in whole.increments]
    assert solve(case, Checkpoint.begin(COMM, tmp_path, case)) is not None
    for step in sorted({1, len(controls) // 2, len(controls) - 1}):
        checkpoint = Checkpoint.resume(COMM, tmp_path, case, step)
        assert len(checkpoint.increments) == step
        result = solve(case, checkpoint)
        found = [increment.control for increment in result.increments]
        assert found == pytest.approx(controls, rel=SAME)
        curves_agree(result, whole)


class Drag(Item):
    """Springs from each node to where it was in the state accepted last; counts these states."""

    name, modes, stiffness = "drag", ("shear",), 2.0  # N/m

    def __init__(self, nodes):
        self.of, self.nodes = nodes, np.arange(nodes.num_nodes_owned, dtype=np.int32)[:, None]

    def work(self, state, level, rows=slice(None), before=None):
        at = self.nodes[rows, 0]
        place = state.memory.get("drag", {}).get("place", self.of.rest[self.nodes[:, 0]])
        moved = state.x[at] - place[rows]
        energy, force, stiffness = room(len(at), 1, 1, moved.shape[1], level)
        energy[:, 0] = 0.5 * self.stiffness * (moved**2).sum(axis=1)
        if level >= FORCE:
            force[:, 0] = self.stiffness * moved
        if level >= STIFFNESS:
            stiffness[:, 0, :, 0] = self.stiffness * np.eye(moved.shape[1])
        return energy, force, stiffness

    def accepted(self, state):
        before, at = state.memory.get("drag", {}), self.nodes[:, 0]
        count = before.get("count", np.zeros(len(at), np.int32)) + np.int32(1)
        went_up = state.x[at, 1] > self.of.rest[at, 1]
        return {"place": state.x[at], "count": count, "went_up": went_up}


@pytest.fixture
def dragged(monkeypatch):
    """Tests have an item that remembers."""

    def model_of(ply):
        model = cloth.model_of(ply)
        items = [*ply.items, Drag(ply.nodes)]
        return Model(ply.nodes, items, ply.active, model.stiffness_scale, model.multigrid)

    monkeypatch.setattr(finite, "model_of", model_of)


def test_what_items_remember_is_kept(tmp_path, dragged, undisturbed):
    """The load depends on where the nodes were before; so does what follows."""
    whole = solve(case_of())
    assert whole.load > 1.01 * undisturbed.load
    for stop in (1, 4, 6, 7):
        folder = tmp_path / str(stop)
        assert solve(case_of(), Checkpoint.begin(COMM, folder, case_of()), stop) is None
        curves_agree(solve(case_of(), Checkpoint.resume(COMM, folder)), whole)


def test_what_items_remember_of_an_earlier_increment(tmp_path, dragged):
    """It is what they accepted then, not what the state was found with."""
    whole = solve(case_of())
    assert solve(case_of(), Checkpoint.begin(COMM, tmp_path, case_of()), 6) is None
    result = solve(case_of(), Checkpoint.resume(COMM, tmp_path, from_step=4))
    curves_agree(result, whole)


def test_killed_again_and_again(tmp_path, undisturbed):
    """A run that never gets farther than one increment at a time."""
    case = case_of()
    checkpoint = Checkpoint.begin(COMM, tmp_path, case)
    for _ in range(len(undisturbed.increments)):
        assert solve(case, checkpoint, stop=1) is None
        checkpoint = Checkpoint.resume(COMM, tmp_path)
    curves_agree(solve(case, checkpoint), undisturbed)


def test_killed_while_the_checkpoint_is_removed(tmp_path, undisturbed, monkeypatch):
    """At each file: what is left can be gone on with as a whole, or not at all."""
    case, ends = case_of(), set()
    made = tmp_path / "made"
    checkpoint = Checkpoint.begin(COMM, made, case)
    solve(case, checkpoint)
    for number in range(100):
        folder = tmp_path / str(number)
        shutil.copytree(made, folder)
        left = Checkpoint.resume(COMM, folder)
        calls = []

        def killed(path, *arguments, whole, calls=calls, number=number):
            calls.append(path)
            if len(calls) > number:
                raise Stop
            return whole(path, *arguments)

        with monkeypatch.context() as patch, suppress(Stop):
            for name in ("unlink", "rename", "rmdir"):
                patch.setattr(Path, name, partialmethod(killed, whole=getattr(Path, name)))
            left.remove()
            break  # all of it
        try:
            again = Checkpoint.resume(COMM, folder)
        except InputError as error:
            ends.add("nothing" if "there is no checkpoint" in str(error) else str(error))
        else:
            curves_agree(solve(case, again), undisturbed)
            ends.add("all")
    assert ends == {"all", "nothing"}
    assert not (folder / "checkpoint").exists()


def test_killed_before_the_first_increment(tmp_path, undisturbed, monkeypatch):
    case = case_of()
    checkpoint = Checkpoint.begin(COMM, tmp_path, case)

    def stop(*_, **__):
        raise Stop

    with monkeypatch.context() as patch:
        patch.setattr("cruciform_petsc.experiments.finite.follow", stop)
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
        assert one.energies == other.energies
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
    curves_agree(result, undisturbed, ANY, states=True)


# -- files that are not what was written ----------------------------------------------------------


def refused(folder, case=None):
    """The sentence with which a folder is refused."""
    with pytest.raises(InputError) as caught:
        solve(case_of(), Checkpoint.resume(COMM, folder, case))
    text = str(caught.value)
    assert str(folder) in text
    assert "\n" not in text
    return text


def parts(folder):
    """Content of all files of a checkpoint, by their names within it."""
    paths = [path for path in sorted(folder.rglob("*")) if path.is_file()]
    return {str(path.relative_to(folder)): path.read_bytes() for path in paths}


def harms(data, random):
    """Many ways to spoil a file."""
    n = len(data)
    yield "empty", b""
    for at in {0, 1, n - 1, *random.integers(0, n, 15)}:
        yield f"cut at {at}", data[:at]
    for at in {0, 80, n - 1, *random.integers(0, n, 30)}:
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


FILES = ["manifest.json", "rank-0.npy"]


@pytest.mark.parametrize("name", FILES)
def test_damage_to_the_newest_is_told_and_the_one_before_taken(copy, name):
    path = copy / "checkpoint" / "newest" / name
    spoiled = dict(harms(path.read_bytes(), np.random.default_rng(1)))
    spoiled["pickle"] = pickle.dumps(Bomb())
    spoiled["missing"] = None
    assert len(spoiled) > 50
    for harm, data in spoiled.items():
        path.unlink() if data is None else path.write_bytes(data)
        checkpoint = Checkpoint.resume(COMM, copy)
        assert len(checkpoint.increments) == 5, harm
        (note,) = checkpoint.notes
        assert str(path) in note
        assert "going on from the one before it" in note, harm


@pytest.mark.parametrize("name", FILES)
def test_damage_to_both_is_refused(copy, name):
    folder = copy / "checkpoint"
    (folder / "newest" / "manifest.json").write_bytes(b"")
    path = folder / "previous" / name
    for harm, data in harms(path.read_bytes(), np.random.default_rng(2)):
        path.write_bytes(data)
        text = refused(copy)
        assert "and so is the one before it; begin anew" in text, harm


@pytest.mark.parametrize("name", FILES)
def test_damage_to_a_state_is_refused(copy, name):
    """Results need it."""
    path = copy / "checkpoint" / "state-1" / name
    # The network is made for each of them, which takes its time.
    for harm, data in list(harms(path.read_bytes(), np.random.default_rng(3)))[::5]:
        path.write_bytes(data)
        assert "begin anew" in refused(copy), harm
    shutil.rmtree(path.parent)
    assert "cannot be read: No such file" in refused(copy)


def test_going_on_from_the_one_before_mends_the_newest(copy, undisturbed):
    """And does not put the damaged one in the place of the good one."""
    folder = copy / "checkpoint"
    (folder / "newest" / "rank-0.npy").write_bytes(b"damaged")
    good = parts(folder / "previous")
    assert solve(case_of(), Checkpoint.resume(COMM, copy), stop=1) is None
    assert parts(folder / "previous") == good
    checkpoint = Checkpoint.resume(COMM, copy)
    assert checkpoint.notes == []
    assert len(checkpoint.increments) == 6
    curves_agree(solve(case_of(), checkpoint), undisturbed)


def test_killed_between_the_renames(copy, undisturbed):
    """The newest has become the previous, and the new one has no name yet."""
    folder = copy / "checkpoint"
    shutil.rmtree(folder / "previous")
    (folder / "newest").rename(folder / "previous")
    new = folder / f"new-{os.getpid()}"
    new.mkdir()
    (new / "rank-0.npy").write_bytes(b"half")
    checkpoint = Checkpoint.resume(COMM, copy)
    assert len(checkpoint.increments) == 6
    curves_agree(solve(case_of(), checkpoint), undisturbed)
    assert not new.exists()


# -- checkpoints that somebody has made up --------------------------------------------------------


def seal(folder, text):
    """Write a manifest with the right checksum in front of a JSON object's text."""
    digest = sha256(text).hexdigest().encode()
    (folder / "manifest.json").write_bytes(b'{"sha256":"' + digest + b'",' + text[1:])


def forge(folder, change):
    """Change a manifest, and take the checksums of what lies beside it now."""
    data = json.loads((folder / "manifest.json").read_bytes())
    data.pop("sha256")
    files = sorted(folder.glob("rank-*.npy"), key=lambda path: int(path.stem[5:]))
    data["hashes"] = [sha256(path.read_bytes()).hexdigest() for path in files]
    data = change(data) or data
    seal(folder, json.dumps(data, separators=(",", ":")).encode())


def forge_both(folder, change):
    """In the newest and in the one before, so that none is left to go on from."""
    for name in ("newest", "previous"):
        forge(folder / "checkpoint" / name, change)


def test_foreign_checkpoints_are_refused(copy):
    """Whole, but of another program, format or case; the one before it is no help."""
    newest = copy / "checkpoint" / "newest"
    good = parts(newest)
    forge(newest, lambda data: None)
    assert parts(newest) == good
    forge(newest, lambda data: data | {"format": 7})
    assert f"in format 7, and this is {__version__}, which reads format 4" in refused(copy)
    forge(newest, lambda data: data | {"format": 4, "program": "9.9"})
    assert "was written by cruciform_petsc 9.9 in" in refused(copy)
    forge(newest, lambda data: data | {"program": __version__})
    text = refused(copy, case_of(BIAS | {"extension": ["1 mm", "3 mm", "5 mm"]}))
    assert "belongs to another case (test.extension differs)" in text
    other = case_of(FREE, "30 deg")
    assert "belongs to another case (preform.bias_angle, test.kind" in refused(copy, other)


def test_a_surface_of_tension(tmp_path):
    """Goes on exactly as it would have; with other points in its file it is another case."""
    path = tmp_path / "biaxial.csv"
    titles = "warp strain (%), weft strain (%), warp tension (N/cm), weft tension (N/cm)\n"
    rows = [(a, b, 40 * a + 9 * b, 30 * b + 9 * a) for a in (0, 0.5, 1) for b in (0, 0.5, 1)]
    path.write_text(titles + "\n".join(", ".join(map(str, row)) for row in rows))

    def case():
        data = case_of(FREE, "30 deg").model_dump(exclude_none=True)
        data["fabric"]["tension"] = {"surface": {"file": str(path)}, "compression": 0.1}
        return Case.from_data(data)

    whole, folder = solve(case()), tmp_path / "results"
    assert solve(case(), Checkpoint.begin(COMM, folder, case()), 1) is None
    curves_agree(solve(case(), Checkpoint.resume(COMM, folder, case())), whole)
    path.write_text(path.read_text().replace("49", "50"))
    with pytest.raises(InputError, match=r"belongs to another case \(fabric\.warp\.modulus"):
        Checkpoint.resume(COMM, folder, case())


def test_checkpoints_of_the_first_format_are_refused(copy):
    """They were files. What to do is said, and `run` does not take them for its own."""
    folder = copy / "checkpoint"
    shutil.rmtree(folder / "newest")
    (folder / "newest").write_bytes(b"cruciform_petsc checkpoint 1\n{}\n")
    assert f'resume with the version that wrote it, or move "{folder}" away' in refused(copy)
    with pytest.raises(InputError, match="checkpoint.* was not written by this version"):
        Checkpoint.begin(COMM, copy, case_of())
    assert (folder / "newest").is_file()


def test_a_state_is_no_checkpoint(copy):
    folder = copy / "checkpoint"
    shutil.rmtree(folder / "newest")
    shutil.copytree(folder / "state-1", folder / "newest")
    (note,) = Checkpoint.resume(COMM, copy).notes
    assert "is damaged: its manifest makes no sense; going on from the one before it" in note


TOP = ["format", "program", "arrays", "rows", "hashes"]
RUN = ["increments", "path", "controls", "states", "case", "determines"]


@pytest.mark.parametrize("key", [*TOP, *RUN])
@pytest.mark.parametrize(
    "value", [None, "text", [1], {"a": []}, True, -1, 10**30, [[]] * 3, "missing"]
)
def test_manifests_without_sense_are_refused(copy, key, value):
    """Nobody writes them; but whoever does gets a sentence, too."""

    def change(data):
        table = data["run"] if key in RUN else data
        table[key] = value
        if value == "missing":
            table.pop(key)

    forge_both(copy, change)
    refused(copy)


def setting(*names_and_value):
    """A change that sets a value within a manifest: setting("run", "path", "target", 3)."""
    *names, last, value = names_and_value

    def change(data):
        for name in names:
            data = data[name]
        data[last] = value

    return change


FORGED = {
    "control is not finite": setting("run", "controls", 0, float("nan")),
    "positions twice at a control": lambda data: operator.setitem(
        data["run"]["controls"], 0, data["run"]["controls"][-1]
    ),
    "positions of no increment": setting("run", "controls", 0, 1.234e-3),
    "increments end elsewhere": setting("run", "increments", -1, "control", 1.9e-3),
    "increments turn back": setting("run", "increments", 0, "control", 1.4e-3),
    "increments set out backwards": setting("run", "increments", 0, "control", -0.3e-3),
    "increments go too far": setting("run", "increments", -1, "control", 3.5e-3),
    "infinite load": setting("run", "increments", 0, "load", float("inf")),
    "load beyond numbers": setting("run", "increments", 0, "load", 10**400),
    "whole number that is none": setting("run", "increments", 0, "iterations", 2.5),
    "huge whole number": setting("run", "increments", 0, "iterations", 10**4000),
    "linear iterations beyond doubles": setting("run", "increments", 0, "linear_iterations", 2**53),
    "mended tangents beyond doubles": setting("run", "increments", 0, "shifted", 10**30),
    "cuts beyond doubles": setting("run", "increments", 0, "cuts", 2**53),
    "a load that overflows": setting("run", "increments", 0, "load", 1e300),
    "an energy that overflows": setting("run", "increments", 0, "energies", "tension", 1e300),
    "energies of other modes": setting("run", "increments", 0, "energies", {"heat": 1.0}),
    "energies with escapes": lambda data: (
        [step["energies"].update({"\x1b[2J": 1.0}) for step in data["run"]["increments"]] and None
    ),
    "a path's load that overflows": setting("run", "path", "load", 1e300),
    "rows beyond 32 bits": setting("rows", [2**31]),
    "a long name": setting("run", "determines", {"x" * 1_000_000: 1}),
    "a long case": setting("run", "case", "title", "x" * 1_000_000),
    "a case of large numbers": setting("run", "case", "test", "increments", 10**30),
    "yes and no": setting("run", "increments", 0, "asked", 1),
    "an increment's energies": setting("run", "increments", 0, "energies", [1.0]),
    "a nested history": setting("run", "increments", 0, "history", [[1.0]]),
    "an increment more than asked": setting("run", "increments", 0, "more", 1),
    "a state not reached": setting("run", "increments", 0, "asked", True),
    "target beyond the values": setting("run", "path", "target", 3),
    "target behind": setting("run", "path", "target", 0),
    "a step that never ends": setting("run", "path", "allowed", 1e-300),
    "a step of nothing": setting("run", "path", "allowed", 0.0),
    "a step back": setting("run", "path", "allowed", -1e-4),
    "a stage that began elsewhere": setting("run", "path", "begin", 1e-3),
    "load is not finite": setting("run", "path", "load", float("-inf")),
    "columns unlike its neighbours'": setting("run", "increments", 0, "columns", {}),
    "a column that is no number": setting("run", "increments", 0, "columns", {"load_N": "1"}),
    "states that are not told": setting("run", "states", []),
    "states that are no checksums": setting("run", "states", ["../../state"]),
    "no ranks": setting("rows", []),
    "more ranks than files": setting("rows", [100, 100]),
    "fewer rows": setting("rows", [17]),
    "rows beyond numbers": setting("rows", [10**400]),
    "wide arrays": setting("arrays", "positions", [100, 100]),
    "arrays without end": setting("arrays", "positions", [10**9, 10**9]),
    "another array": setting("arrays", {"velocity": [3, 2]}),
    "memory without a name": setting("arrays", "memory", {"": {}}),
    "memory of objects": setting("arrays", "memory", {"a": {"b": {"type": "|O", "shape": []}}}),
    "memory without end": setting(
        "arrays", "memory", {"a": {"b": {"type": "<f8", "shape": [10**9]}}}
    ),
    "memory that is not there": setting(
        "arrays", "memory", {"a": {"b": {"type": "<f8", "shape": [2]}}}
    ),
    "an array of keys": setting("arrays", {"key": [3, 2]}),
    "deep case": setting("run", "case", reduce(lambda inner, _: {"a": inner}, range(800), 1)),
    "control characters": setting("run", "determines", {"\x1b[2J": 1}),
}


@pytest.mark.parametrize("what", FORGED)
def test_forged_manifests_are_refused(copy, what):
    """When they are opened, in one sentence; all checksums are right."""
    forge_both(copy, FORGED[what])
    text = refused(copy)
    assert "begin anew" in text
    assert text.isprintable()
    assert len(text) < 1000


@pytest.mark.parametrize(
    "text",
    [
        b'{"a":' + b"[" * 100_000 + b"]" * 100_000 + b"}",
        b'{"a":' * 3_000 + b"1" + b"}" * 3_000,
        b'{"program":' + b"9" * 5_000 + b"}",
        b'{"program":"x","format":1e999}',
        b"{}",
        b'{"\xff":1}',
    ],
    ids=["deep list", "deep table", "digits", "infinite", "nothing", "not UTF-8"],
)
def test_texts_that_are_hard_to_read(copy, text):
    """No RecursionError, no other error than a sentence."""
    for name in ("newest", "previous"):
        seal(copy / "checkpoint" / name, text)
    assert "makes no sense, and so is the one before it; begin anew" in refused(copy)


def array(records, **options):
    """Bytes of an .npy file."""
    file = io.BytesIO()
    np.save(file, records, **options)
    return file.getvalue()


def record_files(good):
    """Files with the right checksum that do not hold what the manifest says."""
    records = np.load(io.BytesIO(good))
    yield "empty", b""
    yield "no array", b"PK\x03\x04 zip"
    yield "another type", array(records["positions"])
    yield "another name", good.replace(b"positions", b"velocitys")
    yield "a row less", array(records[:-1])
    yield "two dimensions", array(records[:, None])
    yield "objects", array(np.array([Bomb()], object), allow_pickle=True)
    yield "cut short", good[:-8]
    yield "nested head", good[:10] + b"(" * 118 + good[128:]
    yield "endless shape", good.replace(b"(%d,)" % len(records), b"(9999999999999,)")


def test_files_that_do_not_hold_what_the_manifest_says(copy):
    for name in ("newest", "previous"):
        path = copy / "checkpoint" / name / "rank-0.npy"
        for what, data in record_files(path.read_bytes()):
            path.write_bytes(data)
            forge(path.parent, lambda data: None)
            if name == "newest":
                (note,) = Checkpoint.resume(COMM, copy).notes
                assert "does not hold what its manifest says" in note, what
            else:
                assert "and so is the one before it" in refused(copy), what


@pytest.mark.parametrize("value", [np.nan, np.inf])
def test_positions_that_are_no_numbers(copy, value):
    path = copy / "checkpoint" / "newest" / "rank-0.npy"
    records = np.load(path)
    records["positions"][7, 1, 0] = value
    path.write_bytes(array(records))
    forge(path.parent, lambda data: None)
    assert "is of another network, or holds no numbers" in refused(copy)


@pytest.mark.parametrize("key", [-1, 0, 2**63 - 1, "twice"])
def test_keys_of_no_node(copy, key):
    path = copy / "checkpoint" / "newest" / "rank-0.npy"
    records = np.load(path)
    records["key"][3] = records["key"][4] if key == "twice" else key
    path.write_bytes(array(records))
    forge(path.parent, lambda data: None)
    assert "is of another network" in refused(copy)


def test_pipes_and_links_are_not_read(copy):
    """They would wait for ever, or lead elsewhere; so would a manifest without end."""
    folder = copy / "checkpoint"
    for name in FILES:
        path = folder / "newest" / name
        good = path.read_bytes()
        path.unlink()
        os.mkfifo(path)
        assert "it is no regular file; going on from" in Checkpoint.resume(COMM, copy).notes[0]
        path.unlink()
        path.symlink_to("/dev/zero")
        assert "it is no regular file; going on from" in Checkpoint.resume(COMM, copy).notes[0]
        path.unlink()
        path.write_bytes(good)
    manifest = folder / "newest" / "manifest.json"
    os.truncate(manifest, 2**40)  # takes no room on the disk
    assert "it is larger than 64 MiB; going on from" in Checkpoint.resume(COMM, copy).notes[0]


def test_folders_behind_links_are_refused(copy, tmp_path_factory):
    """Going on would write to where they lead."""
    elsewhere = tmp_path_factory.mktemp("elsewhere")
    folder = copy / "checkpoint"
    for path in (folder, folder / "newest"):
        path.rename(elsewhere / path.name)
        path.symlink_to(elsewhere / path.name)
        before = parts(elsewhere)
        assert "behind a link" in refused(copy)
        assert parts(elsewhere) == before
        path.unlink()
        (elsewhere / path.name).rename(path)


def test_positions_of_another_network_are_refused(copy):
    case = case_of()
    data = case.model_dump()
    data["preform"]["outline"]["rectangle"] = ["22 mm", "44 mm"]
    other = Case.from_data(data)
    text = refused(copy, other)
    assert "preform.outline.rectangle differs" in text

    # The manifest says it is of this case, and the nodes are others.
    def lie(manifest):
        manifest["run"]["determines"]["preform"] = data["preform"]
        manifest["run"]["case"] = data

    forge(copy / "checkpoint" / "newest", lie)
    checkpoint = Checkpoint.resume(COMM, copy, other)
    with pytest.raises(InputError, match="of another network; begin anew"):
        solve(other, checkpoint)


def test_nothing_there(tmp_path):
    assert "there is no checkpoint in" in refused(tmp_path)
    assert "there is no checkpoint in" in refused(tmp_path / "nowhere")
    (tmp_path / "summary.json").write_text("{}")
    assert "is finished, there is nothing to resume" in refused(tmp_path)


# -- writing --------------------------------------------------------------------------------------


def test_begin_puts_an_unfinished_run_aside(tmp_path):
    checkpoint = Checkpoint.begin(COMM, tmp_path, case_of())
    assert solve(case_of(), checkpoint, stop=2) is None
    good = parts(tmp_path / "checkpoint")
    checkpoint = Checkpoint.begin(COMM, tmp_path, case_of())
    assert "the checkpoint of a run that was not finished is now" in checkpoint.notes[0]
    assert list((tmp_path / "checkpoint").iterdir()) == []
    assert parts(tmp_path / "checkpoint.old") == good
    assert Checkpoint.begin(COMM, tmp_path, case_of()).notes == []  # nothing had been reached
    assert parts(tmp_path / "checkpoint.old") == good
    checkpoint.remove()  # results of the new run are there; the old one can still be resumed
    assert {path.name for path in tmp_path.iterdir()} == {"checkpoint.old", NAMES}
    (tmp_path / "checkpoint.old").rename(tmp_path / "checkpoint")
    assert Checkpoint.resume(COMM, tmp_path).increments


STEPS = [
    "cruciform_petsc.output.checkpoint._remove",
    "cruciform_petsc.output.checkpoint._sync",
    "cruciform_petsc.output.checkpoint._write_file",
    "os.fsync",
    "pathlib.Path.mkdir",
    "pathlib.Path.rename",
    "pathlib.Path.rmdir",
    "pathlib.Path.unlink",
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

            def dying(*arguments, calls=calls, call=call, after=after, **options):
                calls.append(arguments)
                if len(calls) == call and not after:
                    raise Stop
                result = do(*arguments, **options)
                if len(calls) == call:
                    raise Stop
                return result

            def restoring(*arguments, restore=restore, dying=dying):
                kept = restore(*arguments)  # reads, and is not what is looked at
                monkeypatch.setattr(step, dying)
                return kept

            monkeypatch.setattr(checkpoint, "restore", restoring)
            result = solve(case_of(), checkpoint)
            monkeypatch.undo()
            assert (result is None) == (len(calls) >= call), "killed"
            assert calls
            if result is not None:
                continue
            checkpoint = Checkpoint.resume(COMM, folder)
            assert checkpoint.notes == []
            assert len(checkpoint.increments) >= 6
            curves_agree(solve(case_of(), checkpoint), undisturbed)


@pytest.mark.parametrize("room", [0, 100, 3000, 6000])
def test_full_disk(copy, room, undisturbed):
    """One sentence that says how to go on, and the last good checkpoint is still there."""
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    folder = copy / "checkpoint"
    before = parts(folder)
    checkpoint = Checkpoint.resume(COMM, copy)
    resource.setrlimit(resource.RLIMIT_FSIZE, (room, hard))
    try:
        with pytest.raises(InputError) as caught:
            solve(case_of(), checkpoint)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))
    part = "newest" if room > 2000 else "state-7"
    assert str(caught.value) == (
        f'the checkpoint "{folder / part}" cannot be written: File too large; what was reached '
        f"is kept, continue with: cruciform-petsc resume {copy}"
    )
    if room < max(map(len, before.values())):
        there = parts(folder).items()
        assert {name: data for name, data in there if not name.startswith("state-7")} == before
    assert not list(folder.glob("new-*"))
    checkpoint = Checkpoint.resume(COMM, copy)
    assert checkpoint.notes == []
    assert len(checkpoint.increments) >= 6
    curves_agree(solve(case_of(), checkpoint), undisturbed)


def test_what_reads_otherwise_than_it_was_written_is_told(tmp_path, monkeypatch):
    checkpoint = Checkpoint.begin(COMM, tmp_path, case_of())
    with monkeypatch.context() as patch:
        patch.setattr("pathlib.Path.read_bytes", lambda path: b"")
        with pytest.raises(InputError, match='newest" cannot be written: it reads otherwise'):
            solve(case_of(), checkpoint)
    monkeypatch.setattr("os.fsync", lambda handle: (_ for _ in ()).throw(OSError(5, "I/O error")))
    with pytest.raises(InputError, match='newest" cannot be written: I/O error$'):
        solve(case_of(), checkpoint)
    assert list((tmp_path / "checkpoint").iterdir()) == []


def test_one_file_a_rank_and_records_for_anyone(killed):
    """What docs/restart.md tells of the files."""
    folder = killed / "checkpoint"
    assert {path.name for path in folder.iterdir()} == {
        "newest", "previous", *(f"state-{number}" for number in range(1, 7)),
    }  # fmt: skip
    records = np.load(folder / "newest" / "rank-0.npy")
    case = case_of()
    nodes = Nodes(Network(COMM, case.preform(), case.fabric()))
    assert records["key"].tolist() == nodes.node_key.tolist()
    assert records["positions"].shape == (len(records), 3, 2)


# -- what is not the program's --------------------------------------------------------------------


@pytest.mark.parametrize("inside", [".", "newest", "newest/new-1", "state-1"])
@pytest.mark.parametrize("name", ["weights.bin", "manifest.json", "rank-0.npy"])
def test_a_folder_of_the_users_is_refused(tmp_path, inside, name):
    """Whatever it is called; nothing is removed or renamed."""
    mine = tmp_path / "checkpoint" / inside / name
    mine.parent.mkdir(parents=True)
    mine.write_text("w")
    with pytest.raises(InputError, match='checkpoint" was not written by .*: move it elsewhere'):
        Checkpoint.begin(COMM, tmp_path, case_of())
    assert mine.read_text() == "w"
    assert {path.name for path in tmp_path.iterdir()} == {"checkpoint"}


@pytest.mark.parametrize("kind", ["file", "link", "dangling link", "pipe"])
def test_what_is_no_folder_is_refused(tmp_path, kind):
    """A link to a folder, too: what is in there is not the program's."""
    path, thesis = tmp_path / "out" / "checkpoint", tmp_path / "thesis"
    path.parent.mkdir()
    if kind == "link":
        thesis.mkdir()
        (thesis / "newest").write_text("mine")
    {"file": path.touch, "pipe": lambda: os.mkfifo(path)}.get(
        kind, lambda: path.symlink_to(thesis)
    )()
    with pytest.raises(InputError, match='checkpoint" was not written by .*: move it elsewhere'):
        Checkpoint.begin(COMM, path.parent, case_of())
    if kind == "link":
        assert (thesis / "newest").read_text() == "mine"


@pytest.mark.parametrize("where", ["weights.bin", "newest/notes.txt", "state-1/rank-0.npy.bak"])
def test_files_put_into_a_checkpoint_stay(tmp_path, where):
    """To the end of the run, and where a new one begins."""
    checkpoint = Checkpoint.begin(COMM, tmp_path, case_of())
    assert solve(case_of(), checkpoint, stop=6) is None
    mine = tmp_path / "checkpoint" / where
    mine.write_text("mine")
    checkpoint.remove()
    assert mine.read_text() == "mine"
    with pytest.raises(InputError, match=f'{mine.name}" was not written by'):
        Checkpoint.begin(COMM, tmp_path, case_of())
    assert mine.read_text() == "mine"


def test_nothing_is_written_through_links(copy, tmp_path_factory):
    """A checkpoint from elsewhere may have them where files are to be made."""
    target = tmp_path_factory.mktemp("home") / "bashrc"
    target.write_text("mine")
    (target.parent / "folder").mkdir()
    for link, to in (("new", target), (f"new-{os.getpid()}", target.parent / "folder")):
        (copy / "checkpoint" / link).symlink_to(to)
    with pytest.raises(InputError, match=f'new-{os.getpid()}" was not written by .*; what was rea'):
        solve(case_of(), Checkpoint.resume(COMM, copy))
    assert target.read_text() == "mine"
    assert list((target.parent / "folder").iterdir()) == []
    (copy / "checkpoint" / f"new-{os.getpid()}").unlink()
    assert solve(case_of(), Checkpoint.resume(COMM, copy), stop=1) is None
    assert target.read_text() == "mine"
