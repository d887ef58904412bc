# SPDX-License-Identifier: MIT
"""What is the user's stays: a run touches only what the program has written itself."""

import errno
import fcntl
import json
import logging
import os

import pytest
from mpi4py import MPI

from cruciform_petsc.case.schema import Case
from cruciform_petsc.cli import main
from cruciform_petsc.errors import InputError
from cruciform_petsc.output.folder import (
    MANIFEST,
    OF_CALIBRATION,
    OF_RUN,
    locked,
    prepare_directory,
)
from cruciform_petsc.output.tables import write_csv, write_json
from cruciform_petsc.run import run_case

COMM = MPI.COMM_SELF
LOG = logging.getLogger("test_folder")
CASE = """
[fabric]
use = "glass-pp-plain-1.93"
[preform]
outline = { rectangle = ["16 mm", "24 mm"] }
bias_angle = "45 deg"
[test]
extension = "0.5 mm"
finite = %s
[output]
pictures = false
paraview = false
"""
BOTH = pytest.mark.parametrize("finite", [False, True], ids=["small", "finite"])


def made(finite=False, paraview=False):
    return Case.from_data({
        "fabric": {"use": "glass-pp-plain-1.93"},
        "preform": {"outline": {"rectangle": ["16 mm", "24 mm"]}, "bias_angle": "45 deg"},
        "test": {"extension": "0.5 mm", "finite": finite},
        "output": {"pictures": False, "paraview": paraview},
    })  # fmt: skip


def names(folder):
    return {path.name for path in folder.iterdir()}


def written(folder):
    """What a folder's manifest names."""
    return set(json.loads((folder / MANIFEST).read_text())["files"])


@BOTH
@pytest.mark.parametrize("name", ["curve.csv", "report.html", "scene.png", "summary.json"])
def test_a_file_of_the_users_is_refused(tmp_path, finite, name):
    """Before anything is solved; it and the folder are as they were."""
    (tmp_path / name).write_text("mine")
    with pytest.raises(InputError) as caught:
        run_case(COMM, made(finite), tmp_path, LOG)
    assert str(caught.value) == (
        f'"{tmp_path / name}" was not written by this version of cruciform-petsc, which therefore '
        "leaves it alone: move it elsewhere, or have the results go to another folder with --output"
    )
    assert names(tmp_path) == {name}
    assert (tmp_path / name).read_text() == "mine"


@BOTH
@pytest.mark.parametrize("kind", ["folder", "link", "pipe"])
def test_whatever_else_has_a_name_of_ours_is_refused(tmp_path, finite, kind):
    path, target = tmp_path / "out" / "curve.csv", tmp_path / "thesis"
    path.parent.mkdir()
    target.write_text("mine")
    {
        "folder": path.mkdir,
        "link": lambda: path.symlink_to(target),
        "pipe": lambda: os.mkfifo(path),
    }[kind]()
    with pytest.raises(InputError, match='curve.csv" was not written by'):
        run_case(COMM, made(finite), path.parent, LOG)
    assert target.read_text() == "mine"
    assert names(path.parent) == {"curve.csv"}


@BOTH
def test_other_files_stay(tmp_path, finite):
    """And a second run replaces what the first one wrote; the manifest tells all of it."""
    (tmp_path / "notes.txt").write_text("mine")
    (tmp_path / "law.toml").write_text("mine")  # a name of another command's
    for _ in range(2):
        run_case(COMM, made(finite), tmp_path, LOG)
        mine = {"notes.txt", "law.toml", MANIFEST}
        assert names(tmp_path) - mine == written(tmp_path) - {"checkpoint"}
        assert {"curve.csv", "summary.json"} <= written(tmp_path)
    assert (tmp_path / "notes.txt").read_text() == (tmp_path / "law.toml").read_text() == "mine"


def test_a_file_put_there_later_is_refused(tmp_path):
    """The first run did not write it; nothing of that run is gone."""
    run_case(COMM, made(), tmp_path, LOG)
    before = names(tmp_path)
    (tmp_path / "stages.png").write_text("mine")
    with pytest.raises(InputError, match='stages.png" was not written by'):
        run_case(COMM, made(), tmp_path, LOG)
    assert names(tmp_path) == before | {"stages.png"}


def test_a_name_is_the_users_again_when_a_run_has_not_written_it(tmp_path):
    run_case(COMM, made(finite=True, paraview=True), tmp_path, LOG)
    assert "series.vtkhdf" in written(tmp_path)
    run_case(COMM, made(), tmp_path, LOG)
    assert "series.vtkhdf" not in written(tmp_path)
    (tmp_path / "series.vtkhdf").write_text("mine")
    with pytest.raises(InputError, match='series.vtkhdf" was not written by'):
        run_case(COMM, made(), tmp_path, LOG)


def test_a_run_leaves_results_of_a_calibration(tmp_path):
    with locked(COMM, tmp_path, OF_CALIBRATION, LOG):
        write_json(COMM, tmp_path / "calibration.json", {"a": 1})
    assert written(tmp_path) == {"calibration.json"}
    run_case(COMM, made(), tmp_path, LOG)
    assert json.loads((tmp_path / "calibration.json").read_text()) == {"a": 1}
    with locked(COMM, tmp_path, OF_CALIBRATION, LOG):
        write_json(COMM, tmp_path / "calibration.json", {"a": 2})
    assert "curve.csv" in written(tmp_path)


def test_results_of_the_first_version_are_replaced(tmp_path, caplog):
    """They are known by their summary; what is none of a run's stays."""
    old = {"title": "old", "date": "2026", "versions": {"cruciform_petsc": "0.1.0"}}
    (tmp_path / "summary.json").write_text(json.dumps(old))
    for name in ("stages.png", "report.html", "law.toml"):
        (tmp_path / name).write_text("old")
    with caplog.at_level(logging.INFO, LOG.name):
        run_case(COMM, made(), tmp_path, LOG)
    assert 'replaces the results of "old" of 2026' in caplog.text
    assert not names(tmp_path) & {"stages.png", "report.html"}
    assert (tmp_path / "law.toml").read_text() == "old"


SUMMARIES = {
    "another program's": '{"title": "mine"}',
    "no table": "[1]",
    "text": "mine",
    "deep": "[" * 100_000,
    "deep table": '{"versions":' * 3_000 + "1" + "}" * 3_000,
    "digits": '{"versions": ' + "9" * 5_000 + "}",
    "bytes": "\udcff",
}


@pytest.mark.parametrize("what", SUMMARIES)
def test_summaries_that_are_none_of_ours(tmp_path, what):
    path = tmp_path / "summary.json"
    path.write_text(SUMMARIES[what], errors="surrogateescape")
    before = path.read_bytes()
    with pytest.raises(InputError, match='summary.json" was not written by'):
        run_case(COMM, made(), tmp_path, LOG)
    assert path.read_bytes() == before


MANIFESTS = {
    "paths": json.dumps(["../thesis", "/etc/passwd", "..", "checkpoint/../../thesis"]),
    "folders": json.dumps(["", ".", "thesis"]),
    "no names": json.dumps([1, None, {}, ["curve.csv"]]),
    "no list": '"curve.csv"',
    "nothing": "null",
    "deep": "[" * 100_000,
}


@pytest.mark.parametrize("what", MANIFESTS)
def test_manifests_that_somebody_has_made_up(tmp_path, what):
    """Nothing but results of a run is removed, and nothing outside the folder."""
    out, thesis = tmp_path / "out", tmp_path / "thesis"
    out.mkdir()
    thesis.write_text("mine")
    (out / "thesis").write_text("mine")
    (out / MANIFEST).write_text(f'{{"program": "cruciform_petsc", "files": {MANIFESTS[what]}}}')
    run_case(COMM, made(), out, LOG)
    assert thesis.read_text() == (out / "thesis").read_text() == "mine"
    assert "curve.csv" in written(out)


@pytest.mark.parametrize("kind", ["pipe", "link", "endless"])
def test_manifests_that_are_no_files(tmp_path, kind):
    """They are not waited for, read or written through."""
    out, target = tmp_path / "out", tmp_path / "target"
    out.mkdir()
    target.write_text('{"program": "cruciform_petsc", "files": ["curve.csv"]}')
    (out / "curve.csv").write_text("mine")
    {
        "pipe": lambda: os.mkfifo(out / MANIFEST),
        "link": lambda: (out / MANIFEST).symlink_to(target),
        "endless": lambda: (out / MANIFEST).symlink_to("/dev/zero"),
    }[kind]()
    with pytest.raises(InputError, match='curve.csv" was not written by'):
        run_case(COMM, made(), out, LOG)
    (out / "curve.csv").unlink()
    run_case(COMM, made(), out, LOG)
    assert target.read_text() == '{"program": "cruciform_petsc", "files": ["curve.csv"]}'


# -- links -----------------------------------------------------------------------------------------


def test_the_folder_itself_may_be_a_link(tmp_path):
    (tmp_path / "disk").mkdir()
    (tmp_path / "results").symlink_to(tmp_path / "disk")
    for _ in range(2):
        run_case(COMM, made(finite=True), tmp_path / "results", LOG)
    assert (tmp_path / "disk" / "curve.csv").exists()


@pytest.mark.parametrize("name", ["pid", "token"])
def test_nothing_is_written_through_planted_links(tmp_path, name, monkeypatch):
    """Where unfinished files are made; not even where the name is guessed."""
    target = tmp_path / "bashrc"
    target.write_text("mine")
    out = tmp_path / "out"
    out.mkdir()
    monkeypatch.setattr("secrets.token_hex", lambda size: "0" * 2 * size)
    word = os.getpid() if name == "pid" else "00000000"
    for base in (".x.csv", ".curve.csv", f"{MANIFEST}"):
        for tail in (f".{word}.part", f".{word}"):
            (out / f"{base}{tail}").symlink_to(target)
    if name == "pid":
        write_csv(COMM, out / "x.csv", {"a": [1]})
        run_case(COMM, made(), out, LOG)
    else:
        with pytest.raises(InputError, match='x.csv" cannot be written: File exists'):
            write_csv(COMM, out / "x.csv", {"a": [1]})
        with pytest.raises(InputError, match='"(.*)" cannot be written: File exists'):
            run_case(COMM, made(), out, LOG)
    assert target.read_text() == "mine"


def test_a_result_that_has_become_a_link(tmp_path):
    """The link is replaced, and what it leads to stays."""
    run_case(COMM, made(), tmp_path, LOG)
    target = tmp_path / "mine.csv"
    (tmp_path / "curve.csv").rename(target)
    (tmp_path / "curve.csv").symlink_to(target)
    before = target.read_text()
    run_case(COMM, made(), tmp_path, LOG)
    assert target.read_text() == before
    assert not (tmp_path / "curve.csv").is_symlink()


# -- one at a time --------------------------------------------------------------------------------


def test_a_file_system_without_locks_is_warned_of(tmp_path, monkeypatch, caplog):
    def refuse(handle, operation):
        raise OSError(errno.ENOLCK, "No locks available")

    monkeypatch.setattr(fcntl, "flock", refuse)
    for finite in (False, True):
        caplog.clear()
        run_case(COMM, made(finite), tmp_path, LOG)
        (told,) = [text for text in caplog.messages if "locked" in text]
        assert f'"{tmp_path}" cannot be locked (No locks available), so see to it that' in told


@pytest.mark.parametrize("failing", [False, True])
def test_a_folder_is_given_back(tmp_path, failing):
    """At the end, however it comes; meanwhile it is locked for others."""

    def is_locked():
        handle = os.open(tmp_path, os.O_RDONLY)
        try:
            fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            return True
        finally:
            os.close(handle)
        return False

    try:
        with locked(COMM, tmp_path, OF_RUN, LOG):
            assert is_locked()
            if failing:
                raise InputError("x")
    except InputError:
        pass
    assert not is_locked()


def test_an_empty_name_is_no_folder(tmp_path, capsys, monkeypatch):
    """As in a case file; without a word the results would go to where one stands."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "case.toml").write_text(CASE % "true")
    (tmp_path / "data.csv").write_text("displacement (mm),force (N)\n1,2\n2,4\n3,7\n4,11\n")
    (tmp_path / "curve.csv").write_text("extension_mm,load_N\n1,2\n2,4\n")
    for words in (
        ["run", "case.toml"],
        ["resume", "case.toml"],
        ["calibrate", "case.toml", "--data", "data.csv"],
        ["compare", ".", "data.csv"],
    ):
        before = names(tmp_path)
        for blank in ("", " "):
            assert main([*words, "--output", blank]) == 2
            said = f"must be a name that is not empty, got {blank!r}"
            assert said in capsys.readouterr().err
        assert names(tmp_path) == before
    with pytest.raises(InputError):
        prepare_directory(COMM, "")


@pytest.mark.parametrize("command", ["calibrate", "compare", "run", "resume"])
def test_every_command_that_writes_takes_the_lock(tmp_path, command, capsys, monkeypatch):
    """A running run's folder is left alone."""
    monkeypatch.setattr("cruciform_petsc.output.folder.PATIENCE", 0.1)
    out = tmp_path / "out"
    out.mkdir()
    (tmp_path / "case.toml").write_text(CASE % "true")
    (tmp_path / "data.csv").write_text("displacement (mm),force (N)\n1,2\n2,4\n3,7\n4,11\n")
    words = {
        "calibrate": ["calibrate", tmp_path / "case.toml", "--data", tmp_path / "data.csv"],
        "compare": ["compare", tmp_path / "data.csv", tmp_path / "data.csv"],
    }.get(command, [command, tmp_path / "case.toml"])
    handle = os.open(out, os.O_RDONLY)
    try:
        fcntl.flock(handle, fcntl.LOCK_EX)
        assert main([*map(str, words), "--output", str(out)]) == 2
    finally:
        os.close(handle)
    assert f'another run is writing to "{out}"' in capsys.readouterr().err
    assert names(out) == set()
