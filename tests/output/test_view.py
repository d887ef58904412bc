# SPDX-License-Identifier: MIT
"""The view in space of a report: what is in the page, and what a browser makes of it."""

import base64
import csv
import hashlib
import json
import re
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from mpi4py import MPI
from support.forming import written

from cruciform_petsc import BiasExtension, Fabric, Network, Preform
from cruciform_petsc.cli import main
from cruciform_petsc.output import view as module
from cruciform_petsc.output.sample import Surface, sample_surface
from cruciform_petsc.output.view import View, packed, steps_shown, view_of_test
from cruciform_petsc.tools.motion import Pose

COMM = MPI.COMM_SELF
SHEAR = "shear angle, absolute (°)"
CHECK = Path(__file__).parents[2] / "scripts" / "check_view.py"


def array(text, kind):
    return np.frombuffer(base64.b64decode(text), kind)


def decoded(data):
    """Points (steps, n, 3) in mm and fields (steps, n), as view.js reads them."""
    steps, n = len(data["captions"]), data["points_per_step"]
    low, high = np.array(data["low"]), np.array(data["high"])
    points = low + array(data["points"], "<u2").reshape(steps, n, 3) * (high - low) / 65534
    fields = {}
    for field in data["fields"]:
        count = array(field["values"], "<u2").reshape(steps, n)
        value = field["low"] + count * (field["high"] - field["low"]) / 65534
        fields[field["label"]] = np.where(count == 65535, np.nan, value)
    return points, fields


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    path = written(tmp_path_factory.mktemp("view"))
    path.write_text(f"{path.read_text()}[output]\npictures = false\nreport = true\n")
    assert main(["run", str(path), "--output", str(path.parent / "out"), "--quiet"]) == 0
    return path.parent / "out"


@pytest.fixture(scope="module")
def page(folder):
    return (folder / "report.html").read_text(encoding="utf-8")


@pytest.fixture(scope="module")
def data(page):
    (text,) = re.findall(r'<script type="application/json" id="view-data">(.*?)</script>', page)
    return json.loads(text)


def test_policy_allows_the_one_script(page):
    """Its hash is that of the text between the tags; nothing else runs, and nothing is loaded."""
    (policy,) = re.findall(r'Content-Security-Policy"\s+content="([^"]*)"', page)
    every = re.findall(r"<script([^>]*)>(.*?)</script>", page, re.DOTALL)
    assert [attributes for attributes, _ in every] == [
        ' type="application/json" id="view-data"',
        "",
    ]
    digest = base64.b64encode(hashlib.sha256(every[1][1].encode()).digest()).decode()
    assert policy.endswith(f"; script-src 'sha256-{digest}'")
    assert "default-src 'none'" in policy
    assert "unsafe" not in policy.partition("script-src")[2]
    assert not re.findall(r"https?://|\b(?:fetch|import|eval)\(|XMLHttp", page)


def test_data_are_the_fields_of_the_run(folder, data):
    """The last step against fields.csv, crossover by crossover; the first is the flat blank."""
    points, fields = decoded(data)
    assert data["captions"] == ["flat blank", "close, 100 %", "draw, 50 %", "draw, 100 %"]
    with (folder / "fields.csv").open() as file:
        rows = [{k: float(v or "nan") for k, v in row.items()} for row in csv.DictReader(file)]
    assert len(rows) == data["points_per_step"]
    place = np.array([[row[f"{letter}_mm"] for letter in "xyz"] for row in rows])
    away = np.linalg.norm(points[-1][:, None] - place, axis=2)
    assert away.min(axis=1).max() < 2e-3
    order = away.argmin(axis=1)
    assert len(set(order)) == len(rows)
    for label, column in ((SHEAR, "shear_deg"), ("thickness (mm)", "thickness_mm")):
        expected = abs(np.array([row[column] for row in rows]))[order]
        np.testing.assert_allclose(fields[label][-1], expected, atol=1e-4 * expected.max())
    assert np.ptp(points[0][:, 2]) < 2e-3
    assert "contact pressure (kPa)" in fields
    assert all(np.nanmax(values) > np.nanmin(values) for values in fields.values())


def test_tools_of_the_page_stand_where_they_stood(folder, data):
    with (folder / "forces.csv").open() as file:
        rows = [row for row in csv.DictReader(file) if row["asked"] == "1"]
    assert [tool["name"] for tool in data["tools"]] == ["die", "punch", "holder"]
    for tool in data["tools"]:
        for pose, row in zip(tool["poses"][1:], rows, strict=True):
            expected = [float(row[f"{tool['name']}_{letter}_mm"]) for letter in "xyz"]
            np.testing.assert_allclose(pose[9:], expected, atol=1e-9)
            upright = [1.0, 1.0, 1.0] if tool["name"] == "die" else [1.0, -1.0, -1.0]
            np.testing.assert_allclose(np.reshape(pose[:9], (3, 3)), np.diag(upright), atol=1e-9)


def made(n=5, steps=2, labels=("a (mm)",)):
    """A view of n x n crossovers that rise."""
    i, j = np.mgrid[0:n, 0:n].reshape(2, -1)
    at = np.arange((n - 1) * n).reshape(n - 1, n)[:, :-1].ravel()
    triangles = np.concatenate([np.column_stack([at, at + n, at + n + 1])] * 2)
    generator = np.random.default_rng(1)
    surfaces = [
        Surface(
            1e-3 * np.column_stack([i, j, k * i]),
            {label: generator.normal(size=n * n) for label in labels},
            triangles,
            triangles[:, :2],
        )
        for k in range(steps)
    ]
    return View([f"step {k}" for k in range(steps)], surfaces)


def test_missing_values_and_removed_tools():
    """None is none, at any step; a field that is 0 everywhere is not offered, but the first is."""
    view = made(labels=("a (mm)", "b (N)", "c (N)"))
    for surface in view.surfaces:
        surface.values["a (mm)"][:] = 0.0
        surface.values["b (N)"][:] = np.nan
    view.surfaces[1].values["c (N)"][3] = np.nan
    turn = np.array([[0.0, -1, 0], [1, 0, 0], [0, 0, 1]])
    view.tools = {"t": (1e-3 * np.eye(3), np.array([[0, 1, 2]]))}
    view.poses = {"t": [Pose(np.array([1e-3, 0, 0]), turn), None]}
    data = packed(view)
    _, fields = decoded(data)
    assert list(fields) == ["a (mm)", "c (N)"]
    assert np.argwhere(np.isnan(fields["c (N)"])).tolist() == [[1, 3]]
    assert (fields["a (mm)"] == 0.0).all()
    first, second = data["tools"][0]["poses"]
    assert second is None
    # as mat3 in WebGL, column by column: x goes to y
    assert first[:3] == [0.0, 1.0, 0.0]
    assert first[9:] == [1.0, 0.0, 0.0]


def test_page_stays_small():
    """3,364 crossovers in 11 states with nine fields, and a tool of 200,000 facets: below 20 MB."""
    view = made(58, 11, tuple("abcdefghi"))
    points = np.random.default_rng(2).normal(size=(100_000, 3))
    facets = np.arange(100_000)[:, None] + np.array([0, 1, 2])
    view.tools = {"t": (points, np.concatenate([facets % 100_000] * 2))}
    view.poses = {"t": [Pose()] * 11}
    assert len(json.dumps(packed(view))) < 4e6


def test_finely_meshed_tools_keep_their_shape():
    """Merged points lie on the tool, to a 1/256 of its size; few are left as they are."""
    n = 400
    u, v = np.mgrid[0:n, 0:n].reshape(2, -1) / (n - 1)
    points = np.column_stack([100 * u, 100 * v, 10 * np.sin(6 * u)])
    at = np.arange((n - 1) * n).reshape(n - 1, n)[:, :-1].ravel()
    triangles = np.concatenate([
        np.column_stack([at, at + n, at + n + 1]), np.column_stack([at, at + n + 1, at + 1]),
    ])  # fmt: skip
    merged, cells = module._merged(points, triangles)
    assert len(cells) <= module.MOST_FACETS
    a, b, c = merged[cells].transpose(1, 0, 2)[:, :, :2]
    (x, y), (p, q) = (b - a).T, (c - a).T
    assert 0.5 * abs(x * q - y * p).sum() == pytest.approx(1e4, rel=0.02)  # no holes
    assert abs(merged[:, 2] - 10 * np.sin(0.06 * merged[:, 0])).max() < 1e-9
    few = module._merged(points, triangles[:100])
    assert few[0] is points
    assert few[1].shape == (100, 3)


def test_steps_that_fit():
    class Net:
        num_crossovers_global = 3364

    assert steps_shown(Net(), 11, 9) == list(range(11))
    Net.num_crossovers_global = 10**9
    shown = steps_shown(Net(), 1000, 9)
    assert shown[0] == 0
    assert shown[-1] == 999
    assert 10 < len(shown) < 30


def test_flat_tests_in_space():
    """Cloth that buckles has a view from the flat cloth on; cloth in the plane has none."""
    preform = Preform.rectangle("24 mm", "36 mm", bias_angle="45 deg")
    network = Network(COMM, preform, Fabric.from_library("glass-pp-plain-1.93"))
    flat = BiasExtension(network, "1 mm", finite=True).solve()
    assert view_of_test(flat) is None
    result = BiasExtension(
        network, ["0.5 mm", "1 mm"], finite=True, space=True,
        imperfection={"height": "0.1 mm"},
    ).solve()  # fmt: skip
    view = view_of_test(result)
    assert view.captions == ["at rest", "extension 0.5 mm", "extension 1 mm"]
    points, fields = decoded(packed(view))
    assert np.ptp(points[0][:, 2]) < 1e-3
    assert points[-1][:, 1].max() - points[0][:, 1].max() > 0.5
    angle = np.rad2deg(result.fields["shear_angle"])
    assert np.nanmax(fields["shear angle (°)"][-1]) == pytest.approx(angle.max(), rel=1e-3)


def test_surface_is_joined_along_yarns():
    """Each piece of yarn is one pitch long; two triangles a cell of the lattice."""
    preform = Preform.rectangle("20 mm", "30 mm", bias_angle="0 deg")
    network = Network(COMM, preform, Fabric.from_library("e-glass-plain-2.4"))
    place = np.pad(network.crossover_position, ((0, 0), (0, 1)))
    surface = sample_surface(network, place, {"number": np.arange(float(len(place)))})
    a, b = surface.points[surface.yarns].transpose(1, 0, 2)
    pitch = 1e-2 / 2.4
    np.testing.assert_allclose(np.linalg.norm(b - a, axis=1), pitch)
    rows, columns = (len(np.unique(place[:, k].round(9))) for k in (0, 1))
    assert len(surface.triangles) == 2 * (rows - 1) * (columns - 1)
    np.testing.assert_array_equal(surface.values["number"], np.arange(len(place)))


@pytest.mark.skipif(shutil.which("chromium") is None, reason="there is no Chromium here")
@pytest.mark.parametrize("kind", ["formed", "flat"])
def test_report_in_a_browser(kind, request, tmp_path):
    """Turned, coloured and played in headless Chromium, without a message in its console."""
    if kind == "formed":
        page = request.getfixturevalue("folder") / "report.html"
        told = "turned, coloured and played"
    else:
        case = Path(__file__).parents[2] / "demos" / "bias_extension.toml"
        assert main(["run", str(case), "--output", str(tmp_path / "out"), "--quiet"]) == 0
        page = tmp_path / "out" / "report.html"
        told = "opened; it has no view in space"
    done = subprocess.run(
        [sys.executable, str(CHECK), str(page)],
        capture_output=True, text=True, timeout=120, check=False,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    assert told in done.stdout
