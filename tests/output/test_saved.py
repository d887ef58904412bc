# SPDX-License-Identifier: MIT
"""Results read again from their folder."""

import sys
from types import SimpleNamespace

import numpy as np
import pytest
from mpi4py import MPI
from support.runs import CASE

from cruciform_petsc import InputError, Network, Result
from cruciform_petsc.case.schema import Case
from cruciform_petsc.cli import main


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    """A run with --set, and its folder."""
    folder = tmp_path_factory.mktemp("run")
    case = folder / "case.toml"
    case.write_text(CASE.replace("paraview = false", ""))
    words = ["--set", "test.increments=3", "--output", str(folder / "out"), "--quiet"]
    assert main(["run", str(case), *words]) == 0
    return case, folder / "out"


def test_what_a_run_has_left_is_what_a_script_gets(run):
    case, folder = run
    saved = Result.load(folder)
    made = Case.load(case, ["test.increments=3"])
    result = made.experiment(Network(MPI.COMM_SELF, made.preform(), made.fabric())).solve()
    assert (saved.kind, saved.ended_early) == ("bias-extension", "")
    assert saved.case.test == made.test
    for states in (False, True):
        ours, theirs = saved.curve(states), result.curve(states)
        assert len(ours["load_N"]) == (2 if states else 4)
        for name in set(theirs) - {"seconds", "residual_N"}:
            np.testing.assert_allclose(ours[name], theirs[name], rtol=1e-9, atol=1e-12)
    last = saved.last_state()
    crossovers = last["crossover"] >= 0
    np.testing.assert_allclose(
        last["shear_angle_deg"][crossovers], np.rad2deg(result.fields["shear_angle"]), rtol=1e-6
    )
    assert last["points_m"].shape == (len(crossovers), 3)
    assert "bias-extension" not in repr(saved)
    assert str(folder) in repr(saved)


def test_of_a_forming(tmp_path):
    """Tables with texts in them."""
    (tmp_path / "summary.json").write_text('{"kind": "forming", "ended_early": "it tore"}')
    (tmp_path / "forces.csv").write_text("stage,asked,punch_force_z_N\nclose,0,\ndraw,1,-3\n")
    (tmp_path / "fields.csv").write_text("crossover,shear_deg\n0,1.5\n")
    saved = Result.load(tmp_path)
    assert saved.ended_early == "it tore"
    assert saved.curve()["stage"].tolist() == ["close", "draw"]
    assert np.isnan(saved.curve()["punch_force_z_N"][0])
    assert saved.curve(states=True)["punch_force_z_N"].tolist() == [-3.0]
    assert saved.last_state()["shear_deg"].tolist() == [1.5]


def test_frames(run, monkeypatch):
    """With pandas; without it a sentence."""
    saved = Result.load(run[1])
    monkeypatch.setitem(sys.modules, "pandas", SimpleNamespace(DataFrame=lambda data: ("df", data)))
    kind, data = saved.frame()
    assert kind == "df"
    assert data.keys() == saved.curve().keys()
    monkeypatch.setitem(sys.modules, "pandas", None)
    with pytest.raises(InputError, match="needs pandas"):
        saved.frame(states=True)


def test_what_is_no_result(tmp_path):
    with pytest.raises(InputError, match="is no folder"):
        Result.load(tmp_path / "none")
    with pytest.raises(InputError, match=r"has no summary.json"):
        Result.load(tmp_path)
    (tmp_path / "summary.json").write_text('{"kind": "biaxial"}')
    with pytest.raises(InputError, match="does not exist"):
        Result.load(tmp_path).curve()
    (tmp_path / "curve.csv").write_text("load_N,load_N\n1,2\n")
    with pytest.raises(InputError, match="is not a table"):
        Result.load(tmp_path).curve()
    with pytest.raises(InputError, match=r"output\.paraview = true"):
        Result.load(tmp_path).last_state()
