# SPDX-License-Identifier: MIT
"""docs/files.md names every column and array that runs write, with its unit."""

import csv
import json
import re
import textwrap
from pathlib import Path

import h5py
import pytest
from support.forming import CASE, written

from cruciform_petsc.cli import main

PAGE = (Path(__file__).parents[2] / "docs" / "files.md").read_text()
FORMING = PAGE[PAGE.index("## Forming") : PAGE.index("## Flat and buckling specimens")]
NETWORK = PAGE[PAGE.index("### network.vtkhdf") :]
FLAT = """
[fabric]
use = "glass-pp-plain-1.93"
[preform]
outline = { rectangle = ["40 mm", "90 mm"] }
bias_angle = "45 deg"
[test]
extension = ["0.5 mm", "1 mm"]
space = true
[output]
pictures = false
"""


def told(page):
    return {
        name.strip("`")
        for row in re.findall(r"^\| (`.*?) \|", page, re.MULTILINE)
        for name in row.split(", ")
    } | set(re.findall(r"`(\w+)`", page))


def plain(name, tools=(), edges=()):
    for word, names in {"TOOL": tools, "EDGE": edges}.items():
        for each in names:
            name = re.sub(rf"(^|_){each}(_|$)", rf"\1{word}\2", name)
    return name


def header(path):
    with path.open() as file:
        return next(csv.reader(file))


def arrays(path):
    with h5py.File(path) as file:
        return [n for kind in ("PointData", "CellData") for n in file["VTKHDF"].get(kind, ())]


@pytest.fixture(scope="module")
def folders(tmp_path_factory):
    folder = tmp_path_factory.mktemp("runs")
    forming, flat = written(folder), folder / "flat.toml"
    part = 'part_outline = { rectangle = ["32 mm", "24 mm"] }'
    beside = '[continuum]\nladder = [1]\nmesh_size = "8 mm"\n'
    forming.write_text(f"{CASE}{beside}[output]\npictures = false\n{part}\n")
    flat.write_text(FLAT)
    for case in (forming, flat):
        assert main(["run", str(case), "--output", str(folder / case.stem), "--quiet"]) == 0
    return folder / "cup", folder / "flat"


def test_forming(folders):
    cup, page = folders[0], told(FORMING)
    tools, edges = ("die", "punch", "holder"), ("lower", "upper", "left", "right")
    files = ("fields.csv", "forces.csv", "outline.csv", "net_pattern.csv")
    for name in (*files, "continuum.csv", "ladder.csv"):
        missing = {plain(column, tools, edges) for column in header(cup / name)} - page
        assert not missing, name
    for name in ("series.vtkhdf", "tools.vtkhdf"):
        missing = {plain(array, tools) for array in arrays(cup / name)} - page - told(NETWORK)
        assert not missing, name
    summary = json.loads((cup / "summary.json").read_text())
    assert not {*summary["wrinkles"], *summary["bridging"]} - page


def test_flat(folders):
    page = told(PAGE[PAGE.index("## Flat and") :])
    columns = {re.sub("energy_.*_J", "energy_MODE_J", c) for c in header(folders[1] / "curve.csv")}
    assert not columns - page
    for name in ("network.vtkhdf", "series.vtkhdf"):
        assert not set(arrays(folders[1] / name)) - told(NETWORK), name


def test_units_stand_in_names(folders):
    """What has none is a share, a ratio, a number or a unit vector."""
    bare = r"(warp|weft|normal)_[xyz]|yarn_direction|yarn_family|strain|tool|rank|node|crossover"
    bare += r"|carrying|area_ratio|fibre_volume_fraction.*"
    unit = r".*_(mm|m|m2|deg|N|J|kPa|percent|per_m|per_mm)"
    for name in arrays(folders[0] / "series.vtkhdf") + header(folders[0] / "fields.csv"):
        assert re.fullmatch(f"{unit}|{bare}", name), name


def test_recipe_for_pyvista(folders, tmp_path, monkeypatch, capsys):
    """As it stands in the page."""
    pytest.importorskip("pyvista")
    (tmp_path / "results").mkdir()
    (tmp_path / "results" / "hemisphere").symlink_to(folders[0])
    monkeypatch.chdir(tmp_path)
    exec(textwrap.dedent(PAGE[PAGE.index("    import pyvista") :]), {})
    assert 0.0 < float(capsys.readouterr().out) < 1e4
