# SPDX-License-Identifier: MIT
"""Cases with several plies: results of each, restart, what is refused."""

import json
import logging

import numpy as np
import pytest
from mpi4py import MPI
from support.forming import CASE, PLIES, TWO_PLIES, same_end, written

from cruciform_petsc.case.schema import Case
from cruciform_petsc.errors import InputError
from cruciform_petsc.net.network import Network
from cruciform_petsc.output.checkpoint import Checkpoint
from cruciform_petsc.run import run_case

COMM = MPI.COMM_SELF


def networks(case, comm=COMM):
    return [Network(comm, ply.preform, ply.fabric) for ply in case.stack()]


@pytest.fixture(scope="module")
def case(tmp_path_factory):
    folder = tmp_path_factory.mktemp("plies")
    return Case.load(written(folder, ("results = 2\n", ""), text=TWO_PLIES))


def test_tools_start_on_the_stack(case):
    forming = case.forming(networks(case))
    assert forming.thickness == pytest.approx(2e-3)
    place = {tool.name: tool.start.place[2] for tool in forming.tools}
    assert place == pytest.approx({"die": 0.0, "punch": 14e-3, "holder": 2e-3}, abs=1e-9)
    assert [one.blank.height for one in forming.each] == pytest.approx([0.5e-3, 1.5e-3])
    assert [one.blank.name for one in forming.each] == ["low", "high"]


def test_outlines_places_and_fabrics_of_their_own(tmp_path):
    own = PLIES + (
        'outline = { rectangle = ["30 mm", "20 mm"] }\nplace = ["5 mm", "-3 mm"]\n'
        'fabric = { use = "glass-pp-plain-1.93", thickness = "0.5 mm", '
        'out_of_plane_bending = "1 N mm" }\n'
    )
    case = Case.load(written(tmp_path, text=CASE.replace("[[tool]]", own + "[[tool]]", 1)))
    low, high = case.stack()
    np.testing.assert_allclose(high.preform.middle, [5e-3, -3e-3], atol=1e-12)
    np.testing.assert_allclose(high.preform.size, [30e-3, 20e-3])
    np.testing.assert_allclose(low.preform.size, [56e-3, 56e-3])
    assert (low.friction, high.friction) == (0.0, 0.3)
    assert high.fabric.thickness == pytest.approx(0.5e-3)
    assert low.fabric.thickness == pytest.approx(1e-3)


def test_killed_and_resumed(case, tmp_path):
    """To the same end, exactly: with what friction between plies remembers."""

    def make(keeper, stop=None):
        told = []

        def accepted(step, state):
            told.append(step)
            if len(told) == stop:
                raise KeyboardInterrupt

        return case.forming(networks(case)).solve(accepted, keeper)

    whole = make(None)
    with pytest.raises(KeyboardInterrupt):
        make(Checkpoint.begin(COMM, tmp_path, case), 2)
    resumed = make(Checkpoint.resume(COMM, tmp_path))
    same_end(resumed, whole, 1e-12)
    state, other = whole.states[-1], resumed.states[-1]
    np.testing.assert_array_equal(state.x, other.x)
    spent = [state.memory[item.name]["spent"].sum() for item in whole.blank.between]
    assert min(spent) > 0.0
    # What tools and plies push balances, but for viscosity.
    force = sum(whole.steps[-1].tool_force.values())
    assert abs(force).max() < 0.02 * whole.steps[-1].tool_force["die"][2]


def test_results_of_each_ply(case, tmp_path):
    case = Case.from_data(case.model_dump() | {
        "output": {"pictures": False, "exports": True, "report": False},
    })  # fmt: skip
    summary = run_case(COMM, case, tmp_path, logging.getLogger("plies"))
    assert [of["name"] for of in summary["plies"]] == ["low", "high"]
    assert summary["shear_max_deg"] == max(of["shear_max_deg"] for of in summary["plies"])
    assert set(summary["between_plies"]) == {"high on low", "low on high"}
    assert 0.0 < summary["between_plies"]["high on low"]["compaction_max_mm"] < 1.0
    assert "high left" in summary["draw_in_mm"]
    names = {path.name for path in tmp_path.iterdir()}
    for stem in (
        "fields_ply{}.csv", "series_ply{}.vtkhdf", "outline_ply{}.csv", "cells_ply{}.csv",
        "preform_ply{}.inp", "preform_ply{}_ccx.inp", "preform_ply{}_0000.rad",
    ):  # fmt: skip
        assert {stem.format(1), stem.format(2)} <= names
    assert "fields.csv" not in names
    assert json.loads((tmp_path / "summary.json").read_text())["plies"][1]["files"] == "_ply2"


@pytest.mark.parametrize(
    ("old", "new", "sentence"),
    [
        ('name = "high"', 'name = "low"', 'ply[1].name = "low" is another ply\'s name, too'),
        ('name = "high"', 'name = "h/g"', "must be of up to 20 letters"),
        ('name = "low"\n', 'name = "low"\nfriction = 0.1\n', "ply[0].friction is with plies below"),
        ("friction = 0.3", "friction = -0.3", "ply[1].friction"),
        ("friction = 0.3", 'fabric = { use = "no-such" }', "ply[1].fabric"),
        ('[[ply]]\nname = "low"\n', "", "is 1 [[ply]]"),
        ("step = 1.0", 'step = 1.0\nsuction = "1 kPa"', "stage[0].suction is not for several"),
        ("[[stage]]\nname = \"close\"", "[[clamp]]\nedge = \"left\"\n[[stage]]\nname = \"close\"",
         "[[clamp]] is not for several plies yet"),
    ],
)  # fmt: skip
def test_refused(tmp_path, old, new, sentence):
    with pytest.raises(InputError) as error:
        Case.load(written(tmp_path, (old, new), text=TWO_PLIES))
    assert sentence in "\n".join(map(str, error.value.args))


def test_plies_are_for_forming(tmp_path):
    text = (
        '[fabric]\nuse = "e-glass-plain-2.4"\n'
        '[preform]\noutline = { rectangle = ["75 mm", "220 mm"] }\n'
        'bias_angle = "45 deg"\n[test]\nkind = "bias-extension"\nextension = "2 mm"\n'
    )  # fmt: skip
    with pytest.raises(InputError, match='ply is for test.kind = "forming"'):
        Case.load(written(tmp_path, text=text + PLIES))
