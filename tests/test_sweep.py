# SPDX-License-Identifier: MIT
"""Sweeps: what --vary may say, the table, runs that fail or were interrupted, signals.

mpi4py must not be imported here: this process starts others and is no rank itself.
"""

import csv
import json
import os
import signal
import subprocess
import sys
import time

import numpy as np
import pytest
from matplotlib.figure import Figure
from support.runs import CASE
from test_cli_input import LAUNCHER, launch

from cruciform_petsc import sweep
from cruciform_petsc.cli import main
from cruciform_petsc.errors import InputError
from cruciform_petsc.sweep import Varied, read_vary, run_sweep

SMALL = CASE.replace("finite = true", "finite = false").replace("increments = 40\n", "")


@pytest.fixture
def case(tmp_path):
    path = tmp_path / "case.toml"
    path.write_text(SMALL)
    return path


# -- values ----------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("text", "values", "unit"),
    [
        ("30:60:10deg", ["30 deg", "40 deg", "50 deg", "60 deg"], "deg"),
        ("30 deg : 50 deg : 10 deg", ["30 deg", "40 deg", "50 deg"], "deg"),
        ("0.1:0.35:0.1 N/cm", ["0.1 N/cm", "0.2 N/cm", "0.3 N/cm"], "N/cm"),
        ("5:-5:-5 mm", ["5 mm", "0 mm", "-5 mm"], "mm"),
        ("1:3:1", ["1", "2", "3"], ""),
        ("30,45.5 deg", ["30 deg", "45.5 deg"], "deg"),
        ("'2 mm', 2 mm,3mm", ["2 mm", "3 mm"], "mm"),
        ("1,2,4", ["1", "2", "4"], ""),
        ("1e-3,2e-3 N", ["1e-3 N", "2e-3 N"], "N"),
    ],
)
def test_numbers(text, values, unit):
    found = Varied.read("a.b", text)
    assert list(found.values) == values
    assert found.unit == unit
    assert found.label == (f"a.b ({unit})" if unit else "a.b")
    assert list(found.numbers) == [float(value.split()[0]) for value in values]


@pytest.mark.parametrize(
    ("text", "values"),
    [
        ("grip,centre-line", ["grip", "centre-line"]),
        ("true,false", ["true", "false"]),
        ("5 mm,1 cm", ["5 mm", "1 cm"]),
        (
            '{ rectangle = ["1 mm", "2 mm"] }, {rectangle=["1 mm","3 mm"]}',
            ['{ rectangle = ["1 mm", "2 mm"] }', '{rectangle=["1 mm","3 mm"]}'],
        ),
        (["grip", "centre-line"], ["grip", "centre-line"]),
        ([["1 mm", "2 mm"], ["3 mm"]], ['["1 mm", "2 mm"]', '["3 mm"]']),
    ],
)
def test_words(text, values):
    found = Varied.read("a.b", text)
    assert list(found.values) == values
    assert found.numbers is None


def test_numbers_from_a_script():
    np = pytest.importorskip("numpy")
    assert Varied.read("a.b", np.array([1, 2])).values == ("1", "2")
    assert Varied.read("a.b", [True, 2.5]).values == ("true", "2.5")


@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        (["a.b"], "has no values"),
        (["a b=1"], "names no key"),
        (["a.b=1", "a.b=2"], "given twice"),
        (["a.b="], "is empty"),
        (["a.b=1,,2"], "is empty"),
        (["a.b=30:60deg"], "is no range like"),
        (["a.b=30:60 deg:5 rad"], "is no range like"),
        (["a.b=30:60:x"], "is no range like"),
        (["a.b=30:60:-5deg"], "do not lead from start to stop"),
        (["a.b=30:60:0deg"], "do not lead from start to stop"),
        (["a.b=0:1:1e-9"], "more than 1000 values"),
        (["a.b=0:1e999:1e998"], "more than 1000 values"),
        (["a.b=[1,2"], "not closed"),
    ],
)
def test_what_is_no_range_and_no_list(arguments, sentence):
    with pytest.raises(InputError, match=sentence) as error:
        read_vary(arguments)
    assert len(str(error.value).splitlines()) == 1


def test_folders_are_called_by_values():
    """Whatever else is in the sweep; unusual letters are told apart."""
    assert sweep._folder_name(["a.b=5 deg", "c=grip"]) == "a.b=5_deg,c=grip"
    assert sweep._folder_name(["tool[0].friction=0.1"]) == "tool.0.friction=0.1"
    odd = [sweep._folder_name([f"a={letter}"]) for letter in ("/", "*", "..")]
    assert len(set(odd)) == 3
    assert not any(set("/*") & set(name) or name.startswith(".") for name in odd)
    assert len(sweep._folder_name(["a=" + 200 * "b"])) < 110


# -- refused before anything is run ----------------------------------------------------------------


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["--vary", "preform.bias_angel=30deg"], 'unknown key "bias_angel" (did you mean "bias_an'),
        (["--vary", "preform.refine=1,0"], "preform.refine must be a whole number from 1 up"),
        (["--vary", "tool[0].friction=0.1"], "there is no tool[0]"),
        (["--vary", "output.directory=a,b"], "runs have folders of their own"),
        (["--vary", "preform.refine=1", "--jobs", "0"], "--jobs must be a whole number from 1 up"),
        (["--vary", "preform.refine=1:900:1", "--vary", "test.bending=true,false"], "1800 runs"),
        ([], "nothing is varied"),
    ],
)
def test_refused(case, capsys, tmp_path, arguments, said):
    out = tmp_path / "out"
    assert main(["sweep", str(case), *arguments, "--output", str(out)]) == 2
    told = capsys.readouterr().err
    assert said in told
    assert "Traceback" not in told
    assert not out.exists()


# -- runs that are made up: the real ones take seconds ---------------------------------------------

MADE_UP = """
import json, pathlib, sys, time
command, case, *words = sys.argv[1:]
folder = pathlib.Path(words[words.index("--output") + 1])
log = open(pathlib.Path(case).with_name("log"), "a")
print(command, folder.name, *(w for w in words if w.startswith("-p")), file=log, flush=True)
value = float(folder.name.partition("=")[2].split("_")[0])
folder.mkdir(parents=True, exist_ok=True)
if value == 3:
    sys.exit("cruciform-petsc: the third one\\n  is wrong")
if value == 4:
    time.sleep(600)
if value == 5:
    raise ValueError("fifth")
rows = ["extension_mm,load_N,shear_max_deg,energy_shear_J,energy_tension_J,asked,seconds",
        f"1,{value},2,3,4,0,9", f"2,{2 * value},4,,4,1,9", "3,9,9,9,9,0,9"]
(folder / "curve.csv").write_text("\\n".join(rows))
early = {"ended_early": "it tore"} if value == 2 else {}
(folder / "summary.json").write_text(json.dumps({"case": {"output": {}}} | early))
"""


@pytest.fixture
def made_up(monkeypatch, case):
    """Runs that only write; what was started, in order."""
    program = case.with_name("made_up.py")
    program.write_text(MADE_UP)
    monkeypatch.setattr(sweep, "PROGRAM", [sys.executable, str(program)])
    monkeypatch.setattr(sweep, "_without_folder", lambda case: case and {"title": "$t"})

    def started():
        log = case.with_name("log")
        lines = log.read_text().splitlines() if log.exists() else []
        log.unlink(missing_ok=True)
        return sorted(lines)

    return started


def test_table_and_what_is_left(made_up, case, tmp_path):
    """Runs that fail are told of, the others go on; later only those left are run, and new ones."""
    out, key = tmp_path / "out", "preform.refine"
    table = run_sweep(case, {key: "1:3:1"}, out, jobs=2, petsc_options=["-pc_type", "lu"])
    assert made_up() == [f"run preform.refine={n} -pc_type" for n in (1, 2, 3)]
    assert table[key] == [1.0, 2.0, 3.0]
    assert table["status"] == ["done", "ended early", "failed"]
    assert table["message"] == ["", "it tore", "the third one is wrong"]
    assert table["folder"] == [f"preform.refine={n}" for n in (1, 2, 3)]
    assert table["extension_mm"][:2] == [2.0, 2.0]  # the last value asked for
    assert table["load_N"][:2] == [2.0, 4.0]
    assert not {"asked", "seconds", "energy_shear_J"} & table.keys()
    with (out / "sweep.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert [row["load_N"] for row in rows] == ["2.0", "4.0", ""]
    assert [row["status"] for row in rows] == table["status"]
    assert (out / "sweep.png").stat().st_size > 1000
    table = run_sweep(case, {key: [5, 1, 3]}, out)
    assert made_up() == ["run preform.refine=3", "run preform.refine=5"]
    assert table["status"] == ["failed", "done", "failed"]
    axes = np.array(Figure().subplots(1, 3))
    run_sweep(case, {key: [1]}, out, ax=axes)
    assert made_up() == []  # what is finished is drawn, and not run again
    assert [a.get_ylabel() for a in axes[:2]] == ["load (N)", "load (N)"]
    assert axes[1].get_xlabel() == key
    assert axes[1].get_lines()[0].get_ydata().tolist() == [2.0]
    assert table["message"][0].endswith("ValueError: fifth")


def test_words_and_one_rank_more(made_up, case, tmp_path, monkeypatch):
    """A picture of words, of one run, of several keys; mpirun where it is asked for."""
    out = tmp_path / "out"
    run_sweep(case, {"preform.refine": "1,6", "test.bending": "true,false"}, out)
    assert len(made_up()) == 4
    run_sweep(case, {"preform.refine": ["1 ", "6"], "title": ["$a", "_b"]}, tmp_path / "words")
    seen = []
    monkeypatch.setattr(sweep.shutil, "which", lambda name: name)
    monkeypatch.setattr(sweep._Sweep, "work_off", lambda *args: seen.append(args[2]))
    run_sweep(case, {"preform.refine": "1,6"}, tmp_path / "two", ranks=2)
    assert seen == [["mpirun", "-n", "2", *sweep.PROGRAM]]
    monkeypatch.setattr(sweep.shutil, "which", lambda name: None)
    with pytest.raises(InputError, match="no mpirun"):
        run_sweep(case, {"preform.refine": "1,6"}, tmp_path / "three", ranks=2)


def test_interrupted(made_up, case, tmp_path, monkeypatch):
    """What is running is ended; the table has what was done."""
    out, sleep = tmp_path / "out", time.sleep

    def interrupt(_):
        sleep(0.02)
        if (out / "preform.refine=4").exists() and (out / "preform.refine=1/summary.json").exists():
            sleep(0.3)
            raise KeyboardInterrupt

    monkeypatch.setattr(sweep.time, "sleep", interrupt)
    children = []
    popen = subprocess.Popen
    monkeypatch.setattr(
        sweep.subprocess, "Popen", lambda *a, **k: children.append(popen(*a, **k)) or children[-1]
    )
    with pytest.raises(KeyboardInterrupt):
        run_sweep(case, {"preform.refine": "1,4"}, out, jobs=2)
    assert [child.returncode for child in children] == [0, -signal.SIGTERM]


# -- real ones -------------------------------------------------------------------------------------


def test_real_runs(case, tmp_path, capsys):
    """Curves are those of the runs by themselves; one is refused and one folder is in its way."""
    out = tmp_path / "out"
    words = ["sweep", str(case), "--vary", "preform.bias_angle=30,45deg", "--output", str(out)]
    assert main(words) == 0
    assert "2 runs, 0 of them finished before" in capsys.readouterr().out
    with (out / "sweep.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert [row["preform.bias_angle (deg)"] for row in rows] == ["30.0", "45.0"]
    for row in rows:
        summary = json.loads((out / row["folder"] / "summary.json").read_text())
        assert float(row["load_N"]) == summary["load_n"][-1]
        assert summary["case"]["preform"]["bias_angle"] in row["folder"].replace("_", " ")
    assert main([*words, "--quiet"]) == 0
    varied = read_vary(["preform.bias_angle=45deg,60deg"])
    (same, further) = sweep._runs(case, varied, [], out)[1]
    (other, _) = sweep._runs(case, varied, ["test.extension=1 mm"], out)[1]
    assert [run.look() for run in (same, further, other)] == [True, False, False]


def test_signals_end_all_and_the_same_command_goes_on(tmp_path):
    case, out = tmp_path / "case.toml", tmp_path / "out"
    case.write_text(CASE.replace("increments = 40", "increments = 15"))
    words = ["-m", "cruciform_petsc", "sweep", str(case), "--vary", "test.bending=true"]
    command = [sys.executable, *words, "--output", str(out)]
    curve = out / "test.bending=true" / "curve.csv"
    child = subprocess.Popen(
        command, env=os.environ | LAUNCHER, stderr=subprocess.PIPE, stdout=subprocess.DEVNULL,
        text=True,
    )  # fmt: skip
    deadline = time.monotonic() + 60
    while not curve.exists() and time.monotonic() < deadline:
        time.sleep(0.02)
    child.send_signal(signal.SIGTERM)
    _, said = child.communicate(timeout=60)
    assert child.returncode == 128 + signal.SIGTERM
    assert said.endswith("interrupted; finished runs are kept, the same command goes on\n")
    assert (curve.parent / "checkpoint").is_dir()
    size = len(curve.read_text().splitlines())
    time.sleep(0.3)
    assert len(curve.read_text().splitlines()) == size  # nobody goes on
    assert not (curve.parent / "summary.json").exists()
    assert launch(0, *words, "--output", out).returncode == 0
    summary = json.loads((curve.parent / "summary.json").read_text())
    assert summary["resumed_after_increments"] >= size - 2
