# SPDX-License-Identifier: MIT
"""The picture of woven yarns: its geometry, the file, and what is said where it cannot be drawn."""

import json
import logging
import os
import subprocess

import numpy as np
import pytest
from matplotlib.image import imread
from mpi4py import MPI
from support.forming import written

from cruciform_petsc import BiasExtension, Case, Fabric, InputError, Network, Preform
from cruciform_petsc.cli import main
from cruciform_petsc.cloth.weave import Weave
from cruciform_petsc.output import figures, pictures, scene
from cruciform_petsc.output.sample import sample_yarns
from cruciform_petsc.run import run_case

COMM = MPI.COMM_SELF


@pytest.fixture(scope="module")
def result():
    preform = Preform.rectangle("24 mm", "36 mm", bias_angle="45 deg")
    network = Network(COMM, preform, Fabric.from_library("e-glass-plain-2.4"))
    return BiasExtension(network, "4 mm", finite=True).solve()


def yarn_lines(result, limit, weave):
    """The sample, and its lines as drawn, of a cloth of 1 mm."""
    sample = sample_yarns(result.network, result.node_displacement, result.fields, limit)
    scale = pictures.colour_scale([sample.values])
    return sample, scene.yarn_lines(sample, 1e-3, scale, Weave.named(weave))


@pytest.mark.parametrize(
    ("limit", "weave", "warp_above"),
    [
        (3000, "plain", lambda i, j: (i + j) % 2 == 0),
        (20, "plain", lambda i, j: (i + j) % 2 == 0),
        (3000, "twill 2/2", lambda i, j: (i - j) % 4 in (0, 1)),
        (3000, "satin 5", lambda i, j: (i - 2 * j) % 5 != 0),
    ],
)
def test_weave(result, limit, weave, warp_above):
    """At every crossover one family is above, as it is woven; no yarn leaves the cloth."""
    sample, drawn = yarn_lines(result, limit, weave)
    place = sample.lattice / sample.every
    assert (sample.every > 1) == (limit == 20)
    # Half a cloth of 1 mm, more where it has sheared by up to 40 degrees.
    assert (abs(drawn["lines"][:, 2]) + drawn["half"][:, 1]).max() <= 0.5e-3 / np.cos(np.pi / 4)
    # Where the cloth shears, a yarn is as much thicker as it is narrower.
    area = drawn["half"].prod(axis=1)
    assert area == pytest.approx(np.full(len(area), area[0]))
    above = {}
    for rows, line in zip(
        np.split(np.arange(len(place)), sample.first[1:]),
        np.split(drawn["lines"], drawn["first"][1:]),
        strict=True,
    ):
        family = sample.family[rows[0]]
        for row in rows:
            i, j = place[row]
            if abs(i - round(i)) + abs(j - round(j)) > 1e-6:
                continue  # between two crossovers
            off = np.linalg.norm(line[:, :2] - sample.after[row], axis=1)
            assert off.min() < 0.1 * sample.spacing
            above[family, round(i), round(j)] = line[off.argmin(), 2] > 0.0
    crossed = [key[1:] for key in above if key[0] == 0 and (1, *key[1:]) in above]
    assert len(crossed) > 3
    for i, j in crossed:
        assert above[0, i, j] != above[1, i, j]
        assert above[0, i, j] == warp_above(i, j)


def test_tubes():
    """Two yarns along x: sections are ellipses about their lines, in the colours of these."""
    pytest.importorskip("pyvista")
    from cruciform_petsc.output import render

    x, wave, y = np.linspace(0.0, 1.0, 5), np.array([0.1, 0.0, -0.1, 0.0, 0.1]), (0.0, 3.0)
    half = np.column_stack([np.linspace(0.3, 0.2, 5), np.linspace(0.1, 0.15, 5)])
    lines = np.concatenate([np.column_stack([x, np.full(5, at), wave]) for at in y])
    shades = np.arange(30, dtype=np.uint8).reshape(10, 3)
    mesh = render.tubes(lines, np.array([0, 5]), np.tile(half, (2, 1)), shades)
    assert mesh.bounds[:2] == pytest.approx((0.0, 1.0))
    for row, (centre, (wide, high)) in enumerate(zip(lines, np.tile(half, (2, 1)), strict=True)):
        own = (abs(mesh.points[:, :2] - centre[:2]) < [1e-6, 1.0]).all(axis=1)
        assert own.sum() >= render.AROUND
        _, across, up = (mesh.points[own] - centre).T
        assert (across / wide) ** 2 + (up / high) ** 2 == pytest.approx(
            np.ones(own.sum()), rel=1e-5
        )
        assert np.ptp(across) == pytest.approx(2.0 * wide, rel=1e-5)
        assert (mesh["shades"][own] == shades[row]).all()


def test_bar():
    """A prism over its corners, half of it below the cloth."""
    pytest.importorskip("pyvista")
    from cruciform_petsc.output import render

    corners = np.array([[0.0, 0.0], [4.0, 3.0], [3.4, 3.8], [-0.6, 0.8]])
    prism = render.bar(corners, 0.5)
    assert prism.area == pytest.approx(2.0 * 5.0 + 2.0 * (5.0 + 1.0) * 0.5)
    assert prism.bounds == pytest.approx((-0.6, 4.0, 0.0, 3.8, -0.25, 0.25))


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


def test_no_display(result, tmp_path, monkeypatch):
    """None is needed, and the one that is made in memory is gone afterwards."""
    monkeypatch.delenv("DISPLAY", raising=False)
    started = []

    class Kept(subprocess.Popen):
        def __init__(self, command, **options):
            super().__init__(command, **options)
            started.append(self)

    monkeypatch.setattr(scene.subprocess, "Popen", Kept)
    figures.scene(result, tmp_path / "scene.png")
    assert (tmp_path / "scene.png").exists()
    assert started
    assert all(process.poll() is not None for process in started)
    assert "DISPLAY" not in os.environ


@pytest.mark.parametrize("can", [True, False])
def test_case_file(tmp_path, monkeypatch, caplog, can):
    """`[output] scene = true`: it is in the report; where it fails, all else is still there."""
    if not can:
        monkeypatch.setattr(scene.sys, "executable", "/bin/false")
    case = Case.from_data({
        "fabric": {"use": "e-glass-plain-2.4", "weave": "twill 2/2"},
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


def test_vtk_aborts(result, tmp_path, monkeypatch):
    """Nor does the run end where there is no Xvfb and VTK knows nothing but X."""
    pytest.importorskip("vtkmodules.vtkRenderingOpenGL2")
    from vtkmodules.vtkRenderingCore import vtkRenderWindow

    if "X" not in type(vtkRenderWindow()).__name__:
        pytest.skip("this VTK can do without X")
    monkeypatch.delenv("DISPLAY", raising=False)
    monkeypatch.setattr(scene.shutil, "which", lambda name: None)
    with pytest.raises(InputError, match="and here it does not: .*X"):
        figures.scene(result, tmp_path / "scene.png")


def pressed_plate(**options):
    """Cloth of 11 x 11 crossovers, 1 mm apart; a plate below, 0.3 mm into it, and one above."""
    i, j = np.mgrid[0:11, 0:11]
    points = np.column_stack([1e-3 * i.ravel(), 1e-3 * j.ravel(), np.zeros(121)])
    n = (11 * i + j)[:-1, :-1].ravel()
    triangles = np.column_stack([n, n + 11, n + 12, n, n + 12, n + 1]).reshape(-1, 3)
    corners = 1e-3 * np.array([[-2.0, -2, 0], [12, -2, 0], [12, 12, 0], [-2, 12, 0]])
    squares = np.array([[0, 1, 2], [0, 2, 3]])
    plates = [(corners + np.array([0.0, 0.0, z]), squares) for z in (0.3e-3, 0.8e-3)]
    given = {"below": plates[0], "above": plates[1], "caption": "draw, 50 %"} | options
    return scene.Frame(points, np.full(121, 30.0), triangles, np.array([[0, 1]]), **given)


def test_formed_blank_among_tools():
    """Cloth is seen where a tool has pressed it in; tools from above are cut off in front."""
    none = np.zeros((0, 3)), np.zeros((0, 3), int)
    frames = [pressed_plate(below=none, above=none, caption="bare"), pressed_plate(above=none)]
    frames += [pressed_plate(caption="both")] * 2
    figure = scene.formed(frames, "A plate")
    assert [axes.get_title() for axes in figure.axes[:4]] == ["bare", "draw, 50 %", "both", "both"]
    images = [np.asarray(axes.images[0].get_array(), float) for axes in figure.axes[:4]]
    high, wide = images[0].shape[:2]
    behind, front = (np.array([im[int(y * high), wide // 2] for im in images]) for y in (0.4, 0.6))
    np.testing.assert_allclose(front, front[[0] * 4], atol=12.0)
    np.testing.assert_allclose(behind[:2], behind[[0] * 2], atol=12.0)
    assert abs(behind[2] - behind[0]).max() > 25.0  # through a plate
    np.testing.assert_allclose(images[2], images[3], atol=2.0)  # also the light is the same


def test_one_formed_blank():
    """Its words stand below the title."""
    figure = scene.formed([pressed_plate()], "A plate")
    assert figure.axes[0].get_title() == "A plate\ndraw, 50 %"
    assert figure.axes[1].get_ylabel() == pictures.SIZE_LABEL


def test_animation(tmp_path):
    """A picture for each time, of one size and one palette, small; it repeats."""
    from PIL import Image

    frames = [pressed_plate(caption=f"draw, {k} %") for k in (0, 50, 100)]
    frames[0].values[:] = 0.0
    scene.animate(frames, tmp_path / "animation.gif", "A plate")
    assert (tmp_path / "animation.gif").stat().st_size < 300_000
    with Image.open(tmp_path / "animation.gif") as image:
        assert (image.n_frames, image.info["loop"]) == (3, 0)
        bars = []
        for k in range(3):
            image.seek(k)
            page = np.asarray(image.convert("RGB"), float)
            bars.append(page[page.shape[0] // 3 : 2 * page.shape[0] // 3, -90:])
    assert abs(bars[0] - bars[2]).mean() < 1.0  # the colour bar is the same


def test_animation_of_a_case(tmp_path, monkeypatch):
    """It is asked for by a key, for formings only; where it fails, results are still there."""
    path = written(tmp_path)
    more = "[output]\npictures = false\nparaview = false\nanimation = true\n"
    path.write_text(f"{path.read_text()}{more}")
    monkeypatch.setattr(scene.sys, "executable", "/bin/false")
    assert main(["run", str(path), "--output", str(tmp_path / "out"), "--quiet"]) == 0
    assert "no animation.gif: " in (tmp_path / "out" / "run.log").read_text()
    assert not (tmp_path / "out" / "animation.gif").exists()
    assert (tmp_path / "out" / "fields.csv").exists()
    flat = tmp_path / "flat.toml"
    flat.write_text(
        '[fabric]\nuse = "e-glass-plain-2.4"\n[preform]\nbias_angle = "45 deg"\n'
        'outline = { rectangle = ["40 mm", "90 mm"] }\n[test]\nextension = "1 mm"\nfinite = false\n'
        "[output]\nanimation = true\n"
    )
    with pytest.raises(InputError, match="output.animation needs test.finite = true"):
        Case.load(flat)
