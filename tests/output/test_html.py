# SPDX-License-Identifier: MIT
"""What notebooks show: numbers with units, outlines with yarns, texts as they are."""

import base64
import re
import xml.etree.ElementTree as ET

import numpy as np
import pytest
from mpi4py import MPI
from support.forming import written

from cruciform_petsc import BiasExtension, Case, Fabric, Network, Preform, Result
from cruciform_petsc.output.tables import write_csv, write_json

COMM = MPI.COMM_SELF


def parsed(shown):
    """The page as XML, which is stricter than a browser; its cells as text by row."""
    html = shown._repr_html_()
    page = ET.fromstring(re.sub(r"(<img [^>]*)>", r"\1/>", html))
    rows = [["".join(cell.itertext()) for cell in row] for row in page.iter("tr")]
    return page, {row[0]: row[1:] for row in rows}


def picture(page):
    (image,) = page.iter("img")
    assert "background:white" in image.get("style")  # lines are dark
    data = base64.b64decode(image.get("src").removeprefix("data:image/png;base64,"))
    assert data[:4] == b"\x89PNG"
    return data


def test_fabric():
    page, rows = parsed(Fabric.from_library("glass-pp-plain-1.93"))
    assert rows["glass-pp-plain-1.93"] == ["warp", "weft"]
    assert rows["modulus"] == ["4000 N/cm", "4000 N/cm"]
    text = "".join(page.itertext())
    assert "thickness 1.2 mm" in text
    assert "Its data end at 68.0°." in text
    assert "Source: Cao et al. 2008" in text


def test_texts_are_escaped():
    """Names are anything that people write."""
    name = "<script>alert(1)</script> & co"
    cloth = Fabric.from_library("e-glass-plain-2.4").__dict__ | {"name": name}
    page, rows = parsed(Fabric(**cloth))
    assert name in rows
    assert not list(page.iter("script"))


@pytest.mark.parametrize("angle", [0.0, 30.0, 90.0, 120.0])
def test_preform(angle):
    """Yarns run as they do in the cloth and end at its outline; the hole is left out."""
    hole = [(0.02, 0.02), (0.03, 0.02), (0.03, 0.05), (0.02, 0.05)]
    corners = [(0, 0), (0.04, 0), (0.04, 0.08), (0, 0.08)]
    preform = Preform.polygon(corners, bias_angle=f"{angle} deg", holes=[hole])
    page, rows = parsed(preform)
    assert rows["size"] == ["40 mm x 80 mm"]
    assert rows["area"] == ["29 cm²"]
    assert rows["holes"] == ["1"]
    assert rows["warp"] == [f"{angle:g}° from y (blue)"]
    warp, weft, border = (path.get("d") for path in page.iter("{http://www.w3.org/2000/svg}path"))
    assert border.count("M") == 2
    for d, direction in ((warp, angle), (weft, angle - 90.0)):
        pieces = [np.array(re.findall(r"([\d.-]+) ([\d.-]+)", p), float) for p in d.split("M")[1:]]
        for (x0, y0), (x1, y1) in pieces:
            if np.hypot(x1 - x0, y1 - y0) > 20.0:  # of 0.1 in rounding
                found = np.rad2deg(np.arctan2(x1 - x0, -(y1 - y0)))  # from y, which is down
                assert (found - direction + 90.0) % 180.0 == pytest.approx(90.0, abs=0.6)
        points = np.concatenate(pieces)
        assert points.min() > -0.1
        assert (points.max(axis=0) <= [75.1, 150.1]).all()
        inside = ((points > [38.0, 57.0]) & (points < [55.0, 112.0])).all(axis=1)
        assert not inside.any()


@pytest.fixture(scope="module")
def strip():
    preform = Preform.rectangle("40 mm", "90 mm", bias_angle="45 deg")
    network = Network(COMM, preform, Fabric.from_library("e-glass-plain-2.4"))
    return BiasExtension(network, ["2 mm", "6 mm"], finite=True, increments=4).solve()


def test_result(strip, tmp_path):
    """The last state; energies as their sum, and the curve. The same of a run read again."""
    page, rows = parsed(strip)
    assert rows["bias-extension, finite deformation"] == [""]
    assert rows["extension (mm)"] == ["6"]
    assert float(rows["load (N)"][0]) == pytest.approx(strip.load, rel=1e-3)
    energy = sum(value[-1] for value in strip.energies().values())
    assert float(rows["energy (mJ)"][0]) == pytest.approx(1e3 * energy, rel=1e-3)
    picture(page)
    case = {
        "fabric": {"use": "e-glass-plain-2.4"},
        "preform": {"outline": {"rectangle": ["40 mm", "90 mm"]}, "bias_angle": "45 deg"},
        "test": {"extension": ["2 mm", "6 mm"], "finite": True},
    }
    summary = {"kind": "bias-extension", "title": "A <strip>", "case": case, "warnings": ["a < b"]}
    write_json(COMM, tmp_path / "summary.json", summary | {"ended_early": "it tore"})
    write_csv(COMM, tmp_path / "curve.csv", strip.curve())
    page, again = parsed(Result.load(tmp_path))
    assert again["A <strip>"] == [""]
    assert {name: again[name] for name in ("load (N)", "energy (mJ)")} == {
        name: rows[name] for name in ("load (N)", "energy (mJ)")
    }
    assert not any("asked" in name or "newton" in name for name in (*rows, *again))
    assert "Ended early: it tore" in "".join(page.itertext())
    assert "a < b" in "".join(page.itertext())
    picture(page)


def test_one_state_has_no_picture(strip):
    result = BiasExtension(strip.network, "1 mm", finite=False).solve()
    page, rows = parsed(result)
    assert "bias-extension, small displacements" in rows
    assert not list(page.iter("img"))


def test_formed(tmp_path):
    case = Case.load(written(tmp_path))
    formed = case.forming(Network(COMM, case.preform(), case.fabric())).solve()
    page, rows = parsed(formed)
    assert rows["stage"] == ["draw, 100 %"]
    assert rows["holder force z (N)"] == ["\N{MINUS SIGN}5"]
    assert rows["crossovers"] == ["169"]
    picture(page)
