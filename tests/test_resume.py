# SPDX-License-Identifier: MIT
"""Interrupting and resuming as a user does it: separate processes, one and two ranks.

mpi4py must not be imported here: this process starts mpirun and is no rank itself.
"""

import csv
import fcntl
import json
import os
import signal
import subprocess
import sys
import time

import pytest
from support.runs import CASE
from test_cli_input import assert_refused, cruciform_petsc, launch, sentences

EFFORT = ("newton_iterations", "residual_N", "tolerance_N", "cuts", "seconds")


@pytest.fixture
def case(tmp_path):
    path = tmp_path / "case.toml"
    path.write_text(CASE)
    return path


def curve(folder):
    with (folder / "curve.csv").open() as file:
        rows = [row for row in csv.DictReader(file) if row["asked"] == "1"]
    told = [{name: value for name, value in row.items() if name not in EFFORT} for row in rows]
    return [[float(value) for value in row.values() if value] for row in told]


@pytest.fixture(scope="module")
def wanted(tmp_path_factory):
    folder = tmp_path_factory.mktemp("alone")
    (folder / "case.toml").write_text(CASE)
    result = cruciform_petsc(0, "run", folder / "case.toml", "--output", folder / "out")
    assert result.returncode == 0, result.stderr
    assert (
        f"if interrupted, continue with: cruciform-petsc resume {folder / 'out'}" in result.stdout
    )
    assert not (folder / "out" / "checkpoint").exists()
    return curve(folder / "out")


def interrupted(case, out, number, increments=5):
    """Start a run, and send it a signal after some increments."""
    process = subprocess.Popen(
        [sys.executable, "-u", "-m", "cruciform_petsc", "run", str(case), "--output", str(out)],
        stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
    )  # fmt: skip
    told = 0
    for line in process.stdout:
        told += "Newton" in line
        if told == increments:
            break
    process.send_signal(number)
    _, stderr = process.communicate(timeout=60)
    return subprocess.CompletedProcess([], process.returncode, "", stderr)


@pytest.mark.parametrize(
    ("number", "code"), [(signal.SIGINT, 130), (signal.SIGTERM, 143)], ids=["Ctrl-C", "SIGTERM"]
)
def test_interrupt_says_how_to_go_on(case, tmp_path, number, code):
    """Wherever it hits: in PETSc, between increments, in files."""
    out = tmp_path / "my out"
    for increments in (1, 12) if number == signal.SIGINT else (7,):
        result = interrupted(case, out, number, increments)
        assert result.returncode == code
        assert sentences(result) == [
            f"interrupted; what was reached is kept, continue with: cruciform-petsc resume '{out}'"
        ]
        assert "Traceback" not in result.stderr


def test_interrupt_of_some_thousand_crossovers(tmp_path):
    """Most of the time is PETSc's then: obeyed there, and the curve after it is the same."""
    path = tmp_path / "case.toml"
    path.write_text(CASE.replace('"22 mm", "40 mm"', '"110 mm", "220 mm"').replace("40\n", "8\n"))
    assert cruciform_petsc(0, "run", path, "--output", tmp_path / "whole").returncode == 0
    for number, code, increments in ((signal.SIGINT, 130, 2), (signal.SIGTERM, 143, 4)):
        out = tmp_path / number.name
        result = interrupted(path, out, number, increments)
        assert result.returncode == code
        assert sentences(result) == [
            f"interrupted; what was reached is kept, continue with: cruciform-petsc resume {out}"
        ]
        with (out / "curve.csv").open() as file:
            reached = list(csv.DictReader(file))
        assert len(reached) < 8
        assert cruciform_petsc(0, "resume", out).returncode == 0
        for row, row_wanted in zip(curve(out), curve(tmp_path / "whole"), strict=True):
            assert row == pytest.approx(row_wanted, rel=1e-6, abs=1e-15)


def test_resumed_by_the_folder(case, tmp_path, wanted):
    """On two ranks what one had begun; once more there is nothing to do."""
    out = tmp_path / "out"
    assert interrupted(case, out, signal.SIGINT).returncode == 130
    result = cruciform_petsc(2, "resume", out)
    assert result.returncode == 0, result.stderr
    assert "going on from extension" in result.stdout
    assert not (out / "checkpoint").exists()
    assert json.loads((out / "summary.json").read_text())["resumed_after_increments"] >= 5
    found = curve(out)
    assert len(found) == len(wanted) == 2
    for row, row_wanted in zip(found, wanted, strict=True):
        assert row == pytest.approx(row_wanted, rel=1e-6, abs=1e-15)
    with (out / "curve.csv").open() as file:
        controls = [float(row["extension_mm"]) for row in csv.DictReader(file)]
    assert controls == pytest.approx([0.05 * i for i in range(1, 41)])

    result = cruciform_petsc(0, "resume", out)
    assert_refused(result, f'the run in "{out}" is finished, there is nothing to resume')


def test_killed_on_two_ranks_resumed_by_the_case_file(case, tmp_path, wanted):
    """No rank can say a word; the case file tells the folder, and its solver may change."""
    out = tmp_path / "out"
    process = subprocess.Popen(
        ["mpirun", "-n", "2", sys.executable, "-m", "cruciform_petsc", "run", str(case),
         "--output", str(out)],
        stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL, env=os.environ | {
            "OMPI_ALLOW_RUN_AS_ROOT": "1", "OMPI_ALLOW_RUN_AS_ROOT_CONFIRM": "1",
            "PRTE_MCA_rmaps_default_mapping_policy": ":oversubscribe", "OMP_NUM_THREADS": "1",
        },
    )  # fmt: skip
    table = out / "curve.csv"
    deadline = time.monotonic() + 60
    while not table.exists() or len(table.read_text().splitlines()) < 5:
        assert process.poll() is None
        assert time.monotonic() < deadline
        time.sleep(0.01)
    process.kill()
    process.wait()
    result = cruciform_petsc(
        0, "resume", case, "--output", out, "--set", "test.increments=20", "--quiet"
    )
    assert result.returncode == 0, result.stderr
    assert all(line.startswith("warning ") for line in result.stdout.splitlines())
    for row, row_wanted in zip(curve(out), wanted, strict=True):
        assert row == pytest.approx(row_wanted, rel=1e-6, abs=1e-15)


def test_refusals(case, tmp_path):
    out = tmp_path / "out"
    out.mkdir()
    result = cruciform_petsc(0, "resume", out)
    assert_refused(
        result,
        f'there is no checkpoint in "{out}": nothing was reached there yet, or it is not the '
        "folder of a test at finite deformation; start with cruciform-petsc run CASE",
    )
    (out / "checkpoint").mkdir()
    (out / "checkpoint" / "newest").touch()
    result = cruciform_petsc(0, "resume", out, "--set", "test.increments=3")
    assert_refused(
        result,
        f'the case comes from the checkpoint in "{out}"; --set and --output go with the case '
        "file: cruciform-petsc resume CASE",
    )
    result = cruciform_petsc(0, "resume", case, "--set", "test.finite=false")
    assert_refused(
        result,
        "a test at small displacements is one system of equations and has no checkpoints, begin "
        f"anew with cruciform-petsc run {case}",
    )


def test_nothing_reached_yet(case, tmp_path, wanted):
    """By the case file it is known what to do: what `run` does."""
    out = tmp_path / "out"
    result = cruciform_petsc(0, "resume", case, "--output", out)
    assert result.returncode == 0, result.stderr
    assert f'nothing was reached in "{out}" yet, so it begins at rest' in result.stdout
    for row, row_wanted in zip(curve(out), wanted, strict=True):
        assert row == pytest.approx(row_wanted, rel=1e-9, abs=1e-15)


def impatient(*arguments):
    """Run the command line with less patience with another run in its folder."""
    script = (
        "import sys; from cruciform_petsc.output import folder\n"
        "sys.argv[0], folder.PATIENCE = 'impatient', 0.1\n"
        "from cruciform_petsc.cli import main; sys.exit(main())"
    )
    return launch(0, "-c", script, *arguments)


def test_two_runs_in_one_folder(case, tmp_path):
    """The second is refused."""
    out = tmp_path / "out"
    out.mkdir()
    handle = os.open(out, os.O_RDONLY)
    fcntl.flock(handle, fcntl.LOCK_EX)
    told = (
        f'another run is writing to "{out}": wait for it to end, or give this one another folder '
        "with --output"
    )
    result = impatient("run", case, "--output", out, "--quiet")
    assert_refused(result, told)
    os.close(handle)


def test_what_is_not_there(tmp_path):
    """Neither folder nor case; a folder without a checkpoint, whatever else is asked for."""
    result = cruciform_petsc(0, "resume", tmp_path / "nothere")
    assert result.returncode == 2
    assert "name a folder of results or a case file" in result.stderr
    result = cruciform_petsc(0, "resume", tmp_path, "--set", "preform.refine=2")
    assert result.returncode == 2
    assert "there is no checkpoint in" in result.stderr


def test_a_folder_in_use_is_left_alone(case, tmp_path):
    """A run at small displacements, too, neither removes nor writes anything there."""
    out = tmp_path / "out"
    out.mkdir()
    (out / "curve.csv").write_text("of a run that goes on")
    handle = os.open(out, os.O_RDONLY)
    try:
        fcntl.flock(handle, fcntl.LOCK_EX)
        for finite in ("false", "true"):
            options = ("--set", f"test.finite={finite}", "--output", out)
            result = impatient("run", case, *options)
            assert result.returncode == 2, result.stderr
            assert "another run is writing to" in result.stderr
    finally:
        os.close(handle)
    assert {path.name for path in out.iterdir()} == {"curve.csv"}


def test_options_of_petsc_when_resumed(case, tmp_path):
    """PETSc is started with them, not by reading the checkpoint."""
    out = tmp_path / "out"
    assert interrupted(case, out, signal.SIGINT, 3).returncode == 130
    result = cruciform_petsc(0, "resume", out, "-log_view", f":{tmp_path}/log.txt")
    assert result.returncode == 0, result.stderr
    assert "PETSc Performance Summary" in (tmp_path / "log.txt").read_text()


def test_run_puts_an_unfinished_run_aside(case, tmp_path):
    out = tmp_path / "out"
    assert interrupted(case, out, signal.SIGINT, 3).returncode == 130
    result = interrupted(case, out, signal.SIGINT, 3)
    assert result.returncode == 130
    assert (out / "checkpoint.old" / "newest").exists()
    result = cruciform_petsc(0, "resume", out)
    assert result.returncode == 0
    assert (out / "checkpoint.old" / "newest").exists()  # the other run's


@pytest.mark.parametrize("finite", ["false", "true"])
@pytest.mark.parametrize("name", ["checkpoint/weights.bin", "curve.csv", "report.html"])
def test_what_is_the_users_is_left_alone(case, tmp_path, name, finite):
    """In a folder that no run has written to; a checkpoint only matters where one is made."""
    out = tmp_path / "out"
    mine = out / name
    mine.parent.mkdir(parents=True)
    mine.write_text("mine")
    result = cruciform_petsc(0, "run", case, "--output", out, "--set", f"test.finite={finite}")
    if finite == "false" and name.startswith("checkpoint"):
        assert result.returncode == 0
    else:
        path = out / name.split("/")[0]
        told = (
            f'"{path}" was not written by this version of cruciform-petsc, which therefore leaves '
            "it alone: move it elsewhere, or have the results go to another folder with --output"
        )
        assert result.returncode == 2
        assert sentences(result) == [told]
        assert {path.name for path in out.iterdir()} == {path.name}
    assert mine.read_text() == "mine"


def test_resuming_writes_through_no_link(case, tmp_path):
    """A folder that somebody has sent: links within it, and the checkpoint itself one."""
    out, home = tmp_path / "out", tmp_path / "home"
    assert interrupted(case, out, signal.SIGINT, 3).returncode == 130
    home.mkdir()
    (home / "bashrc").write_text("mine")
    for name in ("checkpoint/new", "checkpoint/new-1", ".curve.csv.1.part", "notes"):
        (out / name).symlink_to(home / "bashrc")
    (out / "checkpoint").rename(home / "thesis")
    (out / "checkpoint").symlink_to(home / "thesis")
    before = sorted(path.name for path in (home / "thesis").rglob("*"))
    result = cruciform_petsc(0, "resume", out)
    assert result.returncode == 2
    (told,) = sentences(result)
    assert f'"{out / "checkpoint" / "newest"}" is a file or behind a link' in told
    assert sorted(path.name for path in (home / "thesis").rglob("*")) == before
    (out / "checkpoint").unlink()
    (home / "thesis").rename(out / "checkpoint")
    assert cruciform_petsc(0, "resume", out).returncode == 0
    assert (home / "bashrc").read_text() == "mine"
    assert (out / "checkpoint" / "new").is_symlink()  # not the program's
