# SPDX-License-Identifier: MIT
"""What results draw into axes: the data handed to them, and nothing beside."""

import matplotlib as mpl

mpl.use("Agg")

import numpy as np
import pytest
from matplotlib import pyplot
from matplotlib.collections import PolyCollection
from mpi4py import MPI
from support.forming import CASE, written
from support.runs import CASE as STRIP

from cruciform_petsc import (
    BiasExtension,
    Case,
    Fabric,
    InputError,
    Network,
    Preform,
    Result,
    plot,
    plot_comparison,
    scene,
)
from cruciform_petsc.cli import main
from cruciform_petsc.output import scene as in_space
from cruciform_petsc.output.exports import crossover_columns
from cruciform_petsc.output.formed import crossover_columns as formed_columns
from cruciform_petsc.output.sample import sample_map

COMM = MPI.COMM_SELF
GLASS = Fabric.from_library("e-glass-plain-2.4")


@pytest.fixture(autouse=True)
def _closed():
    yield
    pyplot.close("all")


@pytest.fixture(scope="module")
def strip():
    network = Network(COMM, Preform.rectangle("40 mm", "90 mm", bias_angle="45 deg"), GLASS)
    return BiasExtension(network, ["2 mm", "6 mm"], finite=True, increments=4).solve()


@pytest.fixture(scope="module")
def runs(tmp_path_factory):
    """Folders of a strip and of a forming."""
    folder = tmp_path_factory.mktemp("runs")
    (folder / "strip.toml").write_text(STRIP.replace("paraview = false", "").replace("40\n", "4\n"))
    cup = written(folder, text=f"{CASE}[output]\npictures = false\nparaview = false\n")
    for name, case in (("strip", folder / "strip.toml"), ("cup", cup)):
        assert main(["run", str(case), "--output", str(folder / name), "--quiet"]) == 0
    return folder


@pytest.fixture(scope="module")
def formed(runs):
    case = Case.load(runs / "cup.toml")
    return case.forming(Network(COMM, case.preform(), case.fabric())).solve()


def line(axes, label):
    (one,) = [line for line in axes.get_lines() if line.get_label() == label]
    return np.array(one.get_data())


def mapped(axes):
    """Values of the cells of a map."""
    cells = [c for c in axes.collections if type(c) is PolyCollection]
    return np.asarray(cells[-1].get_array().filled(np.nan))


def test_into_axes_of_the_caller(strip):
    """Those are drawn into and given back; their neighbour and its size are left alone."""
    figure, (left, right) = pyplot.subplots(1, 2, figsize=(7, 3))
    assert strip.plot(left) is left
    curve = strip.curve()
    np.testing.assert_array_equal(
        line(left, "network")[:, 1:], [curve["extension_mm"], curve["load_N"]]
    )
    assert left.get_xlabel() == "extension (mm)"
    assert not right.has_data()
    assert strip.map("shear", right) is right
    assert tuple(figure.get_size_inches()) == (7, 3)
    assert pyplot.get_fignums() == [figure.number]
    assert left.get_title() == ""


def test_a_figure_of_pyplots_without_axes(strip):
    """Which a notebook shows; of several panels an array of axes, without the colour bar."""
    axes = strip.plot(title="costs $5")
    assert pyplot.fignum_exists(axes.figure.number)
    assert axes.get_title() == r"costs \$5"
    panels = strip.plot(what="stages")
    assert panels.shape == (2,)
    assert "extension 6 mm" in panels[1].get_title()
    before = pyplot.get_fignums()
    assert plot(strip, ax=axes) is axes
    assert pyplot.get_fignums() == before


def test_several_results_in_the_same_axes(strip):
    """Told apart, by their labels, without the closed form of each."""
    other = BiasExtension(strip.network, "6 mm", finite=True, increments=4, bending=False).solve()
    _, axes = pyplot.subplots()
    strip.plot(axes, label="with")
    other.plot(axes, label="without $")
    labels = [text.get_text() for text in axes.get_legend().get_texts()]
    assert labels == ["with", r"without \$"]
    colours = {one.get_color() for one in axes.get_lines() if one.get_label() in labels}
    assert len(colours) == 2
    np.testing.assert_array_equal(line(axes, r"without \$")[1, 1:], other.curve()["load_N"])


@pytest.mark.parametrize("what", ["energy", "zones", "centre_line", "shear_force", "yarns"])
def test_every_picture_by_its_name(strip, what):
    _, axes = pyplot.subplots()
    assert strip.plot(axes, what) is axes
    assert axes.has_data()


def test_maps(strip):
    """Columns of crossovers.csv, of any state, with what they show as title."""
    columns = crossover_columns(strip, strip.states[0])
    axes = strip.map("warp_tension", state=0)
    sample = sample_map(strip.network, {"": columns["warp_tension_N_per_mm"]})
    np.testing.assert_allclose(mapped(axes), sample.values[""])
    told = "warp tension at extension 2 mm, on the cloth at rest"
    assert axes.get_title().replace("\n", " ") == told or axes.figure.get_suptitle() == told
    assert axes.figure.axes[-1].get_ylabel() == "warp tension (N/mm)"


def test_what_there_is_not(strip, runs):
    with pytest.raises(InputError, match=r'no picture "zone" \(did you mean "zones"\?'):
        strip.plot(what="zone")
    with pytest.raises(InputError, match=r'"tension", did you mean warp_tension_N\w+ or weft_t'):
        strip.map("tension")
    with pytest.raises(InputError, match=r'map "warp" may be any of warp_\w+, warp_'):
        Result.load(runs / "cup").map("warp")
    with pytest.raises(InputError, match=r'no map "height" \(.*known: .*"weft_tension_N_per_mm"'):
        strip.map("height")
    with pytest.raises(InputError, match=r"got 'x.png': to have a file, save the figure"):
        strip.map("shear", "x.png")
    with pytest.raises(InputError, match="2 states, index 2"):
        strip.map(state=2)
    with pytest.raises(InputError, match="needs 1 axes to be drawn into, got 2"):
        strip.plot(pyplot.subplots(1, 2)[1])
    with pytest.raises(InputError, match="path or ax"):
        plot(strip, "a.png", ax=pyplot.gca())
    with pytest.raises(InputError, match="last state, -1, got 0"):
        Result.load(runs / "strip").map(state=0)


def test_a_run_read_again_draws_the_same(runs):
    """As the result of a script that runs the same case."""
    saved = Result.load(runs / "strip")
    case = Case.load(runs / "strip.toml")
    result = case.experiment(Network(COMM, case.preform(), case.fabric())).solve()
    for what in ("", "zones"):
        ours, theirs = saved.plot(what=what), result.plot(what=what)
        for a, b in zip(ours.get_lines(), theirs.get_lines(), strict=True):
            np.testing.assert_allclose(a.get_data(), b.get_data(), rtol=1e-8, atol=1e-9)
    np.testing.assert_allclose(mapped(saved.map()), mapped(result.map()), rtol=1e-6, atol=1e-6)
    assert "shear angle at the end" in saved.map().figure.get_suptitle()


def test_rows_of_a_run_read_again(runs, monkeypatch):
    """Are put where their crossovers are, in whatever order, with points that are none."""
    saved = Result.load(runs / "strip")
    count = saved.network.num_crossovers_global
    number = np.random.default_rng(1).permutation(np.append(np.arange(count), [-1, -1]))
    state = {"crossover": number, "values_mm": np.where(number < 0, 1e9, 1.0 * number)}
    monkeypatch.setattr(Result, "last_state", lambda self: state)
    want = sample_map(saved.network, {"": 1.0 * saved.network.crossover_number_global})
    np.testing.assert_array_equal(mapped(saved.map("values")), want.values[""])


def test_forming(formed, runs):
    """Curves over the stages that are done, maps of fields.csv; the same of a run read again."""
    saved = Result.load(runs / "cup")
    assert "3 steps, 2 stages done" in repr(formed)
    axes = formed.plot()
    force = [step.tool_force["punch"][2] for step in formed.steps]
    np.testing.assert_allclose(line(axes, "punch"), [[0.0, 1.0, 1.5, 2.0], [0.0, *force]])
    again = saved.plot(label="run")
    np.testing.assert_allclose(line(again, "run: punch"), line(axes, "punch"), rtol=1e-6)
    columns = formed_columns(formed.of, formed.states[-1])
    want = sample_map(formed.of.network, {"": columns["shear_deg"]}).values[""]
    for axes in (formed.map("shear"), saved.map("shear")):
        np.testing.assert_allclose(mapped(axes), want, rtol=1e-6, atol=1e-7)
    assert saved.plot(what="draw_in").get_ylabel() == "largest draw-in (mm)"
    assert formed.plot(what="energy").get_ylabel().startswith("energy (")


def test_stages_of_one_name_follow_each_other():
    """Time goes on where a name comes again, or a share begins anew."""
    from cruciform_petsc.output.formed import curves_of

    table = {"stage": ["a", "a", "a", "b"], "share_percent": [50.0, 100.0, 100.0, 40.0]}
    zero = np.zeros(4)
    table |= {"energy_bending_J": zero, "energy_out_of_plane_bending_J": zero}
    time, *_ = curves_of(table, ["a", "a", "b"])["energy.png"].args
    assert time.tolist() == [0.0, 0.5, 1.0, 2.0, 2.4]


def test_scenes(strip, formed, monkeypatch):
    """Images in axes, under what they show; test_scene.py looks at the images themselves."""

    def blank(scenes):
        return [np.full((60, 100, 3), 255, np.uint8) for _ in scenes], np.array([0.1, 0.06])

    monkeypatch.setattr(in_space, "_render", blank)
    _, (left, right) = pyplot.subplots(1, 2)
    assert strip.scene(left, state=0) is left
    assert formed.scene(right) is right
    assert (left.get_title(), right.get_title()) == ("at extension 2 mm", "draw, 100 %")
    assert [len(axes.get_images()) for axes in (left, right)] == [1, 1]
    with pytest.raises(InputError, match="path or ax"):
        scene(strip, "a.png", ax=left)


def test_comparison(strip, runs, tmp_path):
    """Of results, runs read again, and measured data; the first axes have the loads."""
    (tmp_path / "measured.csv").write_text("mm,N\n0.5,0.2\n1,0.5\n1.5,0.9\n2,1.5\n")
    saved = Result.load(runs / "strip")
    _, axes = pyplot.subplots()
    everything = (strip, saved, str(runs / "strip"), tmp_path / "measured.csv")
    assert plot_comparison(*everything, ax=axes, labels=["a", "b", "c", "d"]) is axes
    assert line(axes, "d")[1].tolist() == [0.0, 0.2, 0.5, 0.9, 1.5]
    np.testing.assert_array_equal(line(axes, "b"), line(axes, "c"))
    load = strip.curve()["load_N"]
    assert line(axes, "a")[1, -1] == pytest.approx(load[-1])
    _, axes = pyplot.subplots()
    assert plot_comparison(strip, saved, ax=axes) is axes  # the load alone
    assert axes.get_ylabel() == "load (N)"
    panels = plot_comparison(strip, saved, by="strain")
    assert [one.get_ylabel() for one in panels] == [
        "load per width (N/mm)",
        "shear angle in the centre (°)",
    ]
    assert line(panels[0], "bias-extension")[1, -1] == pytest.approx(load[-1] / 40.0)
    with pytest.raises(InputError, match="at least, got 1"):
        plot_comparison(strip)
    with pytest.raises(InputError, match="2 results and 1 labels"):
        plot_comparison(strip, saved, labels=["a"])
