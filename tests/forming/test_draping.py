# SPDX-License-Identifier: MIT
"""Fishnet as a kind of test: results, what ends it early, mistakes in a case; in Python, too."""

import json
from functools import partial

import h5py
import numpy as np
import pytest
from mpi4py import MPI
from support import laid
from support.laid import made

from cruciform_petsc import Result
from cruciform_petsc.case.schema import Case
from cruciform_petsc.cli import main
from cruciform_petsc.errors import InputError
from cruciform_petsc.forming.draping import Draping
from cruciform_petsc.net.network import Network
from cruciform_petsc.output import draped

COMM = MPI.COMM_SELF
YARN = '{ modulus = "520 N/cm", poisson = 0, yarns = "2.4 /cm", yarn_bending = "0.6 N mm^2" }'
CASE = f"""
title = "Laid"
[fabric]
warp = {YARN}
weft = {YARN}
shear = {{ modulus = "0.5 N/cm" }}
thickness = "1 mm"
[preform]
outline = {{ rectangle = ["60 mm", "60 mm"] }}
bias_angle = "0 deg"
[test]
kind = "fishnet"
[[tool]]
name = "mould"
shape = {{ sphere = {{ radius = "50 mm", shaft = true }} }}
[output]
part_outline = {{ rectangle = ["30 mm", "30 mm"] }}
exports = true
pictures = false
report = true
"""


written = partial(laid.written, text=CASE)


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    """A folder of results; the fabric has no rigidity out of the plane, which is not needed."""
    folder = tmp_path_factory.mktemp("laid")
    assert main(["run", str(written(folder)), "--output", str(folder / "out"), "--quiet"]) == 0
    return folder / "out"


def test_what_it_leaves(run):
    names = {path.name for path in run.iterdir()}
    assert names >= {
        "summary.json", "fields.csv", "outline.csv", "outline.svg", "net_pattern.csv", "cells.csv",
        "preform.inp", "series.vtkhdf", "tools.vtkhdf", "report.html", "run.log",
    }  # fmt: skip
    assert not names & {"forces.csv", "checkpoint"}
    result = Result.load(run)
    assert len(result.last_state()["shear_deg"]) == result.summary["crossovers"]
    assert "shear" in result._repr_html_()
    (shear,) = result.curve()["shear_max_deg"]
    assert shear == pytest.approx(abs(result.last_state()["shear_deg"]).max())
    table = np.genfromtxt(run / "fields.csv", delimiter=",", names=True)
    place = np.column_stack([table[f"{letter}_mm"] for letter in "xyz"])
    np.testing.assert_allclose(
        np.linalg.norm(place + np.array([0, 0, 50.0]), axis=1), 50.5, rtol=1e-9
    )
    warp, weft = (
        np.column_stack([table[f"{name}_{letter}"] for letter in "xyz"])
        for name in ("warp", "weft")
    )
    sine = np.sin(np.deg2rad(table["shear_deg"]))
    np.testing.assert_allclose((warp * weft).sum(axis=1), sine, atol=2e-3)  # means of arms' angles
    np.testing.assert_allclose(table["thickness_mm"], 1.0 / table["area_ratio"], rtol=1e-8)
    assert not np.isnan(table["normal_z"]).any()


def test_summary_and_where_it_shears_most(run):
    summary = json.loads((run / "summary.json").read_text())
    table = np.genfromtxt(run / "fields.csv", delimiter=",", names=True)
    at = int(np.argmax(abs(table["shear_deg"])))
    assert summary["shear_max_deg"] == pytest.approx(abs(table["shear_deg"][at]))
    flat, there = summary["shear_max_at_mm"]["flat"], summary["shear_max_at_mm"]["in_space"]
    assert np.abs(flat) == pytest.approx(np.abs([table["x_rest_mm"][at], table["y_rest_mm"][at]]))
    assert np.abs(there) == pytest.approx(np.abs([table[f"{c}_mm"][at] for c in "xyz"]))
    net = summary["fishnet"]
    assert net["tool"] == "mould"
    assert net["seed_mm"] == [0.0, 0.0]
    assert net["place_mm"] == pytest.approx([0.0, 0.0, 0.5], abs=1e-9)
    assert (net["warp_heading_deg"], net["between_deg"]) == (
        pytest.approx(90.0),
        pytest.approx(90.0),
    )
    # Of a linear law the energy is the area's mean of G s^2/2.
    shear = np.deg2rad(table["shear_deg"])
    assert net["shear_energy_j"] == pytest.approx(
        50.0 * 60e-3**2 * 0.5 * (shear**2).mean(), rel=0.15
    )
    assert "the largest" not in json.dumps(summary["warnings"])


def test_series_is_flat_then_laid(run):
    with h5py.File(run / "series.vtkhdf") as file:
        root = file["VTKHDF"]
        count = int(root["NumberOfPoints"][0])
        points = root["Points"][()]
        assert len(points) == 2 * count
        np.testing.assert_allclose(points[:count, 2], 0.5e-3, atol=1e-12)
        distance = np.linalg.norm(points[count:] + np.array([0, 0, 50e-3]), axis=1)
        np.testing.assert_allclose(distance, 50.5e-3, rtol=1e-6)
        assert "yarn_direction" in root["CellData"]
        assert not [name for name in root["CellData"] if "tension" in name or name == "strain"]


def test_net_pattern_maps_the_part_back(run):
    """Of a part of 30 x 30 mm more than that of flat cloth is needed."""
    table = np.genfromtxt(run / "net_pattern.csv", delimiter=",", names=True)
    x, y = table["x_rest_mm"], table["y_rest_mm"]
    area = 0.5 * abs((x[:-1] * y[1:] - x[1:] * y[:-1]).sum())
    assert 930.0 < area < 1000.0
    # In the middle of a side the arc: R asin(15/R).
    assert x.max() == pytest.approx(50.5 * np.arcsin(15.0 / 50.5), abs=0.4)


def test_limit_ends_it_early_and_all_else_is_written(tmp_path, capfd):
    path = written(
        tmp_path,
        ('kind = "fishnet"', 'kind = "fishnet"\nlocking_angle = "12 deg"'),
        ("exports = true\n", ""),
    )
    assert main(["run", str(path), "--output", str(tmp_path / "out"), "--quiet"]) == 2
    told = capfd.readouterr().err
    assert "the net locks at x = " in told
    assert "Traceback" not in told
    summary = json.loads((tmp_path / "out" / "summary.json").read_text())
    assert "more than 12 deg" in summary["ended_early"]
    assert 10.0 < summary["shear_max_deg"] < 14.0
    table = np.genfromtxt(tmp_path / "out" / "fields.csv", delimiter=",", names=True)
    lost = table["carrying"] == 0
    assert 0.05 < lost.mean() < 0.6
    assert np.isnan(table["x_mm"][lost]).all()
    assert np.isnan(table["shear_deg"][lost]).all()
    assert not np.isnan(table["x_mm"][~lost]).any()
    with h5py.File(tmp_path / "out" / "series.vtkhdf") as file:
        assert np.isfinite(file["VTKHDF/Points"][()]).all()
    assert (tmp_path / "out" / "report.html").stat().st_size > 10_000


def test_view_leaves_out_what_is_not_laid(tmp_path):
    whole = draped.view_of(made(written(tmp_path)))
    assert whole.captions == ["flat blank", "laid as a fishnet"]
    key = 'kind = "fishnet"\nlocking_angle = "12 deg"'
    part = draped.view_of(made(written(tmp_path, ('kind = "fishnet"', key))))
    assert part.captions == ["laid as a fishnet"]
    assert np.isfinite(part.surfaces[0].points).all()
    assert len(part.surfaces[0].points) < len(whole.surfaces[0].points)
    frame = draped.frame_of(made(written(tmp_path)))
    assert len(frame.points) == len(whole.surfaces[0].points)
    assert len(frame.above[0]) == 0 < len(frame.below[0])


@pytest.mark.parametrize(
    ("old", "new", "told"),
    [
        ('thickness = "1 mm"', "", "fabric.thickness is missing, which test.kind"),
        ('kind = "fishnet"', 'kind = "fishnet"\nbending = true', "test.bending must be false"),
        ('kind = "fishnet"', 'kind = "fishnet"\nbetween = "180 deg"', "between 0 deg and 180 deg"),
        ('kind = "fishnet"', 'kind = "fishnet"\nlocking_angle = "95 deg"', "at most 89 deg"),
        ('kind = "fishnet"', 'kind = "fishnet"\nleast_energy = { places = 0 }', "from 1 up"),
        ('kind = "fishnet"', 'kind = "fishnet"\nseed = "0 mm"', "test.seed must be a list"),
        ("[output]", '[[stage]]\nname = "draw"\n[output]', 'stage is for test.kind = "forming"'),
        ("[output]", '[[tool]]\nname = "b"\nshape = { plane = {} }\n[output]', "one [[tool]]"),
        (
            "[output]",
            "[continuum]\ncompare = true\n[output]",
            "continuum.compare is not for fishnet",
        ),
        ("[output]", "[continuum]\nladder = [1]\n[output]", "continuum.ladder is not for fishnet"),
        ("[output]", "[output]\nanimation = true", "output.animation is not for fishnet"),
        ("[output]", "[output]\nscene = true", "output.scene is not for fishnet"),
    ],
)
def test_mistakes(tmp_path, capfd, old, new, told):
    """One sentence each, exit code 2, nothing written."""
    path = written(tmp_path, (old, new))
    assert main(["run", str(path), "--output", str(tmp_path / "out"), "--quiet"]) == 2
    error = capfd.readouterr().err
    assert told in error
    assert "Traceback" not in error
    assert not list((tmp_path / "out").glob("*.csv")) if (tmp_path / "out").exists() else True


def test_seed_beside_the_blank(tmp_path, capfd):
    path = written(tmp_path, ('kind = "fishnet"', 'kind = "fishnet"\nseed = ["90 mm", "0 mm"]'))
    assert main(["run", str(path), "--output", str(tmp_path / "out"), "--quiet"]) == 2
    assert (
        "test: the seed, x = 90 mm, y = 0 mm, does not lie on the blank" in capfd.readouterr().err
    )


def test_check_tells_the_seed(tmp_path, capfd):
    assert main(["check", str(written(tmp_path))]) == 0
    told = capfd.readouterr().out
    assert 'x = 0 mm, y = 0 mm is laid first, on tool "mould" at 0 mm, 0 mm, 0.5 mm' in told


def test_in_python(tmp_path):
    """Plain numbers in SI; one tool is needed."""
    case = Case.load(written(tmp_path))
    network = Network(COMM, case.preform(), case.fabric())
    tool = {"name": "ball", "shape": {"sphere": {"radius": 50e-3}}}
    draping = Draping(network, [tool], seed=[10e-3, 0.0], turn=0.1)
    assert draping.failure() is None
    assert draping.results()["fishnet"]["warp_heading_deg"] == pytest.approx(90.0 + np.rad2deg(0.1))
    with pytest.raises(InputError, match="needs one .*, got none"):
        Draping(network, [])


def test_shear_beyond_the_law_is_told(tmp_path):
    law = (
        'shear = { law = "table", quantity = "torque per area", angle = "deg", force = "N/m", '
        "points = [[0, 0], [5, 1], [10, 3]] }"
    )
    draping = made(written(tmp_path, ('shear = { modulus = "0.5 N/cm" }', law)))
    assert (
        "beyond the last point of the shear law's table at 10.0 deg"
        in draping.results()["warnings"][0]
    )
