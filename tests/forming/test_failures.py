# SPDX-License-Identifier: MIT
"""What cannot be formed: which tools, which nodes, why; all that was reached is there."""

import csv
import json
from dataclasses import replace

import numpy as np
import pytest
from mpi4py import MPI
from support.forming import CASE, formed, kept, written

from cruciform_petsc.case.schema import Case
from cruciform_petsc.cli import main
from cruciform_petsc.errors import EquilibriumError
from cruciform_petsc.forming.failures import _pressing, explain
from cruciform_petsc.forming.forming import Formed
from cruciform_petsc.forming.measures import narrowest, squeezed
from cruciform_petsc.net.network import Network
from cruciform_petsc.output.checkpoint import Checkpoint
from cruciform_petsc.output.folder import unlock_directory

COMM = MPI.COMM_SELF
TOOLS = CASE[CASE.index("[[tool]]") : CASE.index("[[stage]]")]
STAGES = CASE[CASE.index("[[stage]]") :]
PLATES = """[[tool]]
name = "table"
shape = { plane = {} }
[[tool]]
name = "stamp"
shape = { plane = { size = ["20 mm", "20 mm"] } }
"""
CLOSE = """[[stage]]
name = "close"
travel = { stamp = ["0 mm", "0 mm", "-1.05 mm"] }
step = 0.2
"""


def ended(folder, capfd, path, command="run", *more):
    """What is told of a run that ends early, and its summary."""
    path.write_text(path.read_text() + "[output]\npictures = false\nreport = true\n")
    capfd.readouterr()
    assert main([command, str(path), "--output", str(folder), "--quiet", *more]) == 2
    told = capfd.readouterr().err
    assert "Traceback" not in told
    assert len(told.splitlines()) == 1
    summary = json.loads((folder / "summary.json").read_text())
    assert summary["ended_early"] in told
    with (folder / "forces.csv").open() as file:
        assert len(list(csv.DictReader(file))) == sum(stage["steps"] for stage in summary["stages"])
    for name in ("fields.csv", "outline.csv", "series.vtkhdf", "tools.vtkhdf", "report.html"):
        assert (folder / name).exists(), name
    return told, summary


def test_plates_that_leave_no_room(tmp_path, capfd):
    """Both tools are named, and the nodes under the plate counted; smaller steps are no help."""
    path = written(tmp_path, (TOOLS, PLATES), (STAGES, CLOSE))
    told, summary = ended(tmp_path / "out", capfd, path)
    assert 'forming: no equilibrium beyond 80 % of stage "close"' in told
    assert 'tools "table" and "stamp" leave no room for the cloth, which is 1 mm thick' in told
    # 5 x 5 crossovers and the ends of their yarns between and around them, but for the outermost.
    assert "at 65 nodes of the flat blank, most at x = " in told
    assert "They have to stop earlier, or the cloth has to be thinner" in told
    assert "resume" not in told
    assert summary["stages"][0]["steps"] == 4
    assert len(Checkpoint.resume(COMM, tmp_path / "out").steps) == 4


def test_a_pushed_plate_may_press_the_cloth_flat(tmp_path):
    """A force finds its height, whatever room is left."""
    push = CLOSE.replace(
        'travel = { stamp = ["0 mm", "0 mm", "-1.05 mm"] }', 'force.stamp = "45 N"'
    )
    case = Case.load(written(tmp_path, (TOOLS, PLATES), (STAGES, push)))
    step = kept(COMM, case).steps[-1]
    assert step.tool_place["stamp"][2] < 0.0
    assert step.tool_force["stamp"][2] == pytest.approx(-45.0)


def test_a_tool_deep_in_the_cloth(tmp_path):
    """A punch that has jumped 3 mm on: how deep it lies, where, at how many nodes."""
    forming, result = formed(COMM, written(tmp_path))
    blank, state = forming.blank, result.states[-1]
    assert squeezed(blank, state) is None
    x = state.x.copy()
    x[blank.tool_node[1], 2] -= 3e-3
    moved = replace(state, x=x)
    what, reason, place, count = squeezed(blank, moved)
    depth = -blank.contacts[1].fields(moved)["distance"]
    deep = f"{1e3 * depth.max():.4g} mm"
    assert what == f'tool "punch" lies {deep} deep in the cloth, which is 1 mm thick'
    assert reason == "PIERCED"
    np.testing.assert_array_equal(place, blank.ply.nodes.rest[blank.touching[depth.argmax()]])
    assert count == (depth > 2e-3).sum() > 1


def test_room_between_plates(tmp_path):
    """What they leave where both press; nothing is told where only one does."""
    case = Case.load(written(tmp_path, (TOOLS, PLATES), (STAGES, CLOSE.replace("-1.05", "-0.6"))))
    result = kept(COMM, case)
    blank, state = result.blank, result.states[-1]
    rest = blank.ply.nodes.rest[blank.touching]
    under = (abs(rest[:, :2]) < 9e-3).all(axis=1)
    room, tools = narrowest(blank, state, under)
    assert tools == ("table", "stamp")
    assert room == pytest.approx(0.4e-3)
    assert narrowest(blank, state, abs(rest[:, 0]) > 20e-3) is None
    place = rest[under][0]
    told = _pressing(blank, result, place)
    assert told.startswith(', where tools "table" and "stamp" press: "table" and "stamp" leave 0.4')
    assert told.endswith(" mm, for cloth of 1 mm")


def test_without_equilibrium(tmp_path, capfd, monkeypatch):
    """Too few Newton steps: nodes out of balance, how to go on; then enough of them."""
    path, out = written(tmp_path), tmp_path / "out"
    case = Case.load(path)
    whole = kept(COMM, case)
    assert kept(COMM, case, Checkpoint.begin(COMM, out, case), 2) is None
    unlock_directory(out)
    with monkeypatch.context() as patch:
        patch.setattr("cruciform_petsc.equilibrium.follow.MOST_CUTS", 0)
        few = ["--set", "solver.options.snes_max_it=1"]
        told, summary = ended(out, capfd, path, "resume", *few)
    assert 'no equilibrium beyond 50 % of stage "draw" (no equilibrium found, DIVERGED_MAX' in told
    assert "; forces are out of balance at " in told
    assert "of the flat blank" in told
    assert 'resume CASE --from-step 1 --set "stage[1].step=0.25"' in told
    assert summary["stages"][1]["steps"] == 1
    hint = ["--from-step", "1", "--set", "stage[1].step=0.25"]
    more = [*hint, "--output", str(out), "--quiet"]
    assert main(["resume", str(path), *more]) == 0
    summary = json.loads((out / "summary.json").read_text())
    assert "ended_early" not in summary
    assert summary["stages"][1]["steps"] == 4
    force = whole.steps[-1].tool_force["punch"][2]
    assert summary["tool_force_n"]["punch"][2] == pytest.approx(force, rel=0.1)


def test_nothing_is_reached(tmp_path, capfd, monkeypatch):
    """In the first step: no fields, no step to go back to."""
    monkeypatch.setattr("cruciform_petsc.equilibrium.follow.MOST_CUTS", 0)
    path = written(tmp_path)
    path.write_text(path.read_text() + "[solver]\noptions = { snes_max_it = 2 }\n")
    out = tmp_path / "out"
    assert main(["run", str(path), "--output", str(out), "--quiet"]) == 2
    told = capfd.readouterr().err
    assert 'beyond 0 % of stage "close"' in told
    assert 'resume CASE --set "stage[0].step=0.5" (and --output, where the run had it)' in told
    assert "ended_early" in json.loads((out / "summary.json").read_text())
    assert Checkpoint.resume(COMM, out).steps == []


def test_tools_that_bear_when_they_are_removed(tmp_path):
    """Cloth springs free of them all at once: the way out is to draw them back first."""
    case = Case.load(written(tmp_path, ('force = { holder = "5 N" }', 'remove = ["holder"]')))
    forming = case.forming(Network(COMM, case.preform(), case.fabric()))
    error = EquilibriumError("no equilibrium found", "DIVERGED_MAX_IT", [])
    error.result = Formed(forming.blank)
    explain(forming.blank, forming.stages, error, False)
    assert "Tools that still bear should travel away in a stage before they are" in str(error)
    assert "Smaller steps" not in str(error)


def test_in_python_nothing_is_said_of_checkpoints(tmp_path, monkeypatch):
    """Where none is kept."""
    monkeypatch.setattr("cruciform_petsc.equilibrium.follow.MOST_CUTS", 0)
    path = written(tmp_path)
    path.write_text(path.read_text() + "[solver]\noptions = { snes_max_it = 2 }\n")
    with pytest.raises(EquilibriumError) as caught:
        kept(COMM, Case.load(path))
    assert "resume" not in str(caught.value)
    assert caught.value.count > 0
    assert caught.value.result.steps == []
