# SPDX-License-Identifier: MIT
"""Drawings to cut by: draw-in, and a part's outline mapped back onto the flat blank."""

import csv
import logging
from types import SimpleNamespace
from xml.etree import ElementTree

import numpy as np
import pytest
import shapely
from mpi4py import MPI
from support.formed import Gripped, network
from support.forming import CASE, written

from cruciform_petsc.case.schema import Case
from cruciform_petsc.cli import main
from cruciform_petsc.cloth.preform import PreformTable
from cruciform_petsc.errors import InputError
from cruciform_petsc.output.pattern import DRAWN_IN, FLAT, PART, WARP, mapped_back, write_pattern
from cruciform_petsc.tools import shapes
from cruciform_petsc.tools.tool import Tool

RADIUS = 50e-3
LOG = logging.getLogger("test")
SVG = "{http://www.w3.org/2000/svg}"
CIRCLE = shapely.Point(2e-3, -3e-3).buffer(30e-3)


def around(rest):
    """The blank around a cylinder about y."""
    phi = rest[:, 0] / RADIUS
    return np.stack([RADIUS * np.sin(phi), rest[:, 1], RADIUS * np.cos(phi)], axis=1)


def shaped(shape, size=(120, 100), comm=MPI.COMM_SELF, **options):
    """A blank in a shape, as a forming that came to it, and the state."""
    tools = [Tool("plate", shapes.plane(), 0.0)]
    blank = Gripped(network(size, comm=comm, **options), tools, shape=shape)
    return SimpleNamespace(network=blank.network, blank=blank, suffix=""), blank.start()


@pytest.mark.parametrize("angle", ["0 deg", "30 deg"])
def test_a_circle_in_plan_on_a_cylinder(angle):
    """x = R sin(u/R): mapped back within a sixteenth of p^2/R, chords for arcs; heights, too."""
    forming, state = shaped(around, angle=angle)
    table, remarks = mapped_back(forming, state, CIRCLE)
    assert remarks == []
    ring, u, v, x, y, z = table.T
    assert not ring.any()
    np.testing.assert_allclose(np.hypot(x - 2e-3, y + 3e-3), 30e-3, rtol=5e-3)
    np.testing.assert_allclose(v, y, atol=1e-6)
    error = abs(u - RADIUS * np.arcsin(x / RADIUS)).max()
    assert error < 0.05e-3
    np.testing.assert_allclose(z, np.sqrt(RADIUS**2 - x**2), atol=0.1e-3)
    finer, state = shaped(around, angle=angle, refine=2)
    table, _ = mapped_back(finer, state, CIRCLE)
    assert abs(table[:, 1] - RADIUS * np.arcsin(table[:, 3] / RADIUS)).max() < 0.4 * error


def test_where_the_cloth_does_not_reach(tmp_path):
    """A gap in the pattern, and a sentence with place and length; a hole of the part is a ring."""
    forming, state = shaped(around)
    part = shapely.Point(30e-3, 0.0).buffer(20e-3).difference(shapely.Point(20e-3, 0).buffer(4e-3))
    remarks = write_pattern(tmp_path, forming, state, LOG, part)
    assert len(remarks) == 1
    assert "too small there" in remarks[0]
    assert "x = 50 mm, y = 0 mm" in remarks[0]
    with (tmp_path / "net_pattern.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert {row["ring"] for row in rows} == {"0", "1"}
    assert any(row["x_rest_mm"] == "" for row in rows if row["ring"] == "0")
    assert all(row["x_rest_mm"] for row in rows if row["ring"] == "1")
    layers = ElementTree.parse(tmp_path / "outline.svg").getroot().findall(f"{SVG}g")
    assert [layer.get("id") for layer in layers] == [FLAT, DRAWN_IN, WARP, PART]


@pytest.mark.parametrize("height", [5e-3, -5e-3])
def test_cloth_over_itself(height):
    """Folded by 180 degrees, up or down: the upper layer is taken, with a word."""

    def folded(rest):
        x, over = rest[:, 0].copy(), rest[:, 0] > 20e-3
        x[over] = 40e-3 - x[over]
        return np.stack([x, rest[:, 1], np.where(over, height, 0.0)], axis=1)

    forming, state = shaped(folded)
    table, remarks = mapped_back(forming, state, shapely.box(-45e-3, -20e-3, 5e-3, 20e-3))
    assert "lies over itself" in remarks[0]
    upper = table[(table[:, 3] > -10e-3) & (table[:, 3] < 4e-3)]
    wanted = 40e-3 - upper[:, 3] if height > 0.0 else upper[:, 3]
    np.testing.assert_allclose(upper[:, 1], wanted, atol=1e-6)


def test_dxf_has_the_same_layers(tmp_path):
    import ezdxf

    forming, state = shaped(around)
    assert write_pattern(tmp_path, forming, state, LOG, CIRCLE) == []
    document = ezdxf.readfile(tmp_path / "outline.dxf")
    assert document.units == ezdxf.units.MM
    lines = {line.dxf.layer: line for line in document.modelspace()}
    assert list(lines) == [FLAT, DRAWN_IN, WARP, PART]
    assert all(line.closed == (name != WARP) for name, line in lines.items())
    begin, tip, *_ = np.array(lines[WARP].get_points("xy"))
    warp = forming.network.to_lab(np.eye(2))[0]
    np.testing.assert_allclose(tip - begin, 20.0 * warp, atol=1e-9)  # a fifth of 100 mm
    corners = np.array(lines[FLAT].get_points("xy"))
    np.testing.assert_allclose(abs(corners), [[60, 50]] * 4)
    with (tmp_path / "net_pattern.csv").open() as file:
        rows = [(float(r["x_rest_mm"]), float(r["y_rest_mm"])) for r in csv.DictReader(file)]
    np.testing.assert_allclose(lines[PART].get_points("xy"), rows[:-1], atol=1e-9)
    # The next blank can be read from what is cut.
    outline = {"file": str(tmp_path / "net_pattern.dxf")}
    blank = PreformTable.from_data({"outline": outline, "bias_angle": "0 deg"}, "preform").build()
    np.testing.assert_allclose(1e3 * blank.size, np.ptp(rows, axis=0), rtol=1e-6)


def test_without_ezdxf_it_is_said(tmp_path, monkeypatch, caplog):
    monkeypatch.setitem(__import__("sys").modules, "ezdxf", None)
    forming, state = shaped(around)
    with caplog.at_level(logging.INFO):
        write_pattern(tmp_path, forming, state, LOG)
    assert "no outline.dxf: it needs ezdxf" in caplog.text
    assert sorted(p.name for p in tmp_path.iterdir()) == ["outline.csv", "outline.svg"]


def test_in_a_case(tmp_path):
    """`[output] part_outline`: a rectangle lies around the centre; the net pattern is larger."""
    path = written(tmp_path)
    more = "[output]\npictures = false\nparaview = false\npart_outline = "
    path.write_text(f'{CASE}{more}{{ rectangle = ["32 mm", "24 mm"] }}\n')
    assert main(["run", str(path), "--output", str(tmp_path / "out"), "--quiet"]) == 0
    with (tmp_path / "out" / "net_pattern.csv").open() as file:
        rows = [{key: float(value) for key, value in row.items()} for row in csv.DictReader(file)]
    assert max(row["y_mm"] for row in rows) == pytest.approx(12.0)
    assert max(row["x_mm"] for row in rows) == pytest.approx(16.0)
    middle = max(row["x_rest_mm"] for row in rows if abs(row["y_mm"]) < 2.0)
    assert 16.3 < middle < 18.5  # cloth has been drawn in over the die's edge


@pytest.mark.parametrize(
    ("kind", "outline", "sentence"),
    [
        ("forming", "[[0,0],[1,1],[1,0],[0,1]]", "output.part_outline crosses itself"),
        ("flat", "[[0,0],[1,0],[1,1]]", "output.part_outline is for a forming"),
    ],
)
def test_mistakes(tmp_path, kind, outline, sentence):
    points = outline.replace("0", '"0 mm"').replace("1", '"9 mm"')
    if kind == "forming":
        path = written(tmp_path)
    else:
        path = tmp_path / "flat.toml"
        path.write_text(
            '[fabric]\nuse = "e-glass-plain-2.4"\n[preform]\nbias_angle = "45 deg"\n'
            'outline = { rectangle = ["40 mm", "90 mm"] }\n[test]\nextension = "1 mm"\n'
        )
    path.write_text(f"{path.read_text()}[output]\npart_outline = {{ polygon = {points} }}\n")
    with pytest.raises(InputError, match=sentence):
        Case.load(path)
