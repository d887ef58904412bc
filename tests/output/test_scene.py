# SPDX-License-Identifier: MIT
"""The picture of woven yarns: its geometry, the file, and what is said where it cannot be drawn."""

import json
import logging

import numpy as np
import pytest
from matplotlib.image import imread
from mpi4py import MPI

from cruciform_petsc import BiasExtension, Case, Fabric, InputError, Network, Preform
from cruciform_petsc.output import figures, scene
from cruciform_petsc.output.figures import to_lattice
from cruciform_petsc.output.pictures import _angle_colours
from cruciform_petsc.output.sample import sample_yarns
from cruciform_petsc.run import run_case

COMM = MPI.COMM_SELF


@pytest.fixture(scope="module")
def result():
    preform = Preform.rectangle("24 mm", "36 mm", bias_angle="45 deg")
    network = Network(COMM, preform, Fabric.from_library("e-glass-plain-2.4"))
    return BiasExtension(network, "4 mm", finite=True).solve()


@pytest.mark.parametrize("limit", [3000, 20])
def test_plain_weave(result, limit):
    """At every crossover one family is above, neighbours alternate; no tube leaves the cloth."""
    sample = sample_yarns(result.network, result.node_displacement, result.fields, limit)
    assert (sample.every > 1) == (limit == 20)
    lattice = to_lattice(result.network)
    place = (sample.before @ lattice[:, :2].T + lattice[:, 2]) / sample.every
    colours = _angle_colours([sample.shear_angle_deg])
    tubes = scene._yarns(sample, lattice, 1e3 * sample.spacing, 1.0, colours)
    above = {}
    for rows, (points, normals, quads, shades) in zip(
        np.split(np.arange(len(place)), sample.first[1:]), tubes, strict=True
    ):
        assert len(points) == len(normals) == len(shades)
        assert quads.max() < len(points)
        assert np.linalg.norm(normals, axis=1) == pytest.approx(1.0)
        # Half a cloth of 1 mm, more where it has sheared by up to 40 degrees.
        assert abs(points[:, 2]).max() <= 0.5 / np.cos(np.deg2rad(45.0))
        family = sample.family[rows[0]]
        for row in rows:
            i, j = place[row]
            if abs(i - round(i)) + abs(j - round(j)) > 1e-6:
                continue  # between two crossovers
            off = np.linalg.norm(points[:, :2] - 1e3 * sample.after()[row], axis=1)
            height = points[off < 0.3 * scene.WIDTH * 1e3 * sample.spacing, 2].mean()
            above[family, round(i), round(j)] = height > 0.0
    crossed = [key[1:] for key in above if key[0] == 0 and (1, *key[1:]) in above]
    assert len(crossed) > 3
    for i, j in crossed:
        assert above[0, i, j] != above[1, i, j]
        assert above[0, i, j] == ((i + j) % 2 == 0)


def test_picture(result, tmp_path):
    """White margins, and yarns of all angles from dark blue to yellow."""
    figures.scene(result, tmp_path / "scene.png")
    image = imread(tmp_path / "scene.png")[..., :3]
    assert max(image.shape[:2]) > 1000
    assert image[0].min() == 1.0
    red, green, blue = np.moveaxis(image, 2, 0)
    blues, yellows = (blue > 0.3) & (red < 0.2), (red > 0.8) & (green > 0.6) & (blue < 0.4)
    assert 0.02 < blues.mean() < 0.3
    assert 0.002 < yellows.mean() < 0.1


@pytest.mark.parametrize("can", [True, False])
def test_case_file(tmp_path, monkeypatch, caplog, can):
    """`[output] scene = true`: it is in the report; where it fails, all else is still there."""
    if not can:
        monkeypatch.setattr(scene.sys, "executable", "/bin/false")
    case = Case.from_data({
        "fabric": {"use": "e-glass-plain-2.4"},
        "preform": {"outline": {"rectangle": ["24 mm", "36 mm"]}, "bias_angle": "45 deg"},
        "test": {"extension": "1 mm"},
        "output": {"pictures": False, "paraview": False, "report": True, "scene": True},
    })  # fmt: skip
    run_case(COMM, case, tmp_path, logging.getLogger("test"))
    assert (tmp_path / "scene.png").exists() == can
    assert ("no scene.png" in caplog.text) == (not can)
    assert ("The yarns in space" in (tmp_path / "report.html").read_text()) == can
    assert "scene" in json.loads((tmp_path / "summary.json").read_text())["wall_s"]


def test_nothing_can_render(result, tmp_path, monkeypatch):
    """One sentence, and no picture left behind."""
    monkeypatch.setattr(scene.sys, "executable", "/bin/false")
    with pytest.raises(InputError, match="needs PyVista and a VTK that draws without a display"):
        figures.scene(result, tmp_path / "scene.png")
    assert not list(tmp_path.iterdir())
