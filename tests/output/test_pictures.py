# SPDX-License-Identifier: MIT
"""Pictures by what is drawn in them: the data handed to the axes, not the size of a file."""

from itertools import combinations
from types import SimpleNamespace

import numpy as np
import pytest
import shapely
from matplotlib import rc_context
from matplotlib.collections import LineCollection, PolyCollection
from matplotlib.colors import to_rgb
from matplotlib.image import imread
from mpi4py import MPI

from cruciform_petsc import (
    BiasExtension,
    Biaxial,
    Cantilever,
    Fabric,
    Network,
    OffAxisTension,
    PictureFrame,
    Preform,
)
from cruciform_petsc.cloth.fabric import YarnFamily
from cruciform_petsc.experiments.biaxial_load import BiaxialLoad
from cruciform_petsc.output import figures, pictures
from cruciform_petsc.output.sample import sample_map, sample_yarns

COMM = MPI.COMM_SELF
GLASS = Fabric.from_library("e-glass-plain-2.4")
CIRCLE = np.asarray(shapely.Point(0.0, 0.04).buffer(0.0101).exterior.coords)
MEASURED = SimpleNamespace(displacement=np.array([0.001, 0.002]), force=np.array([0.5, 1.5]))
LADDER = [
    {"crossovers": 50, "relative_l2_displacement": 0.04, "load_ratio": 1.03},
    {"crossovers": 200, "relative_l2_displacement": 0.03, "load_ratio": 0.98},
    {"crossovers": 5000, "relative_l2_displacement": 0.002, "load_ratio": 1.01},
]


class Membrane:
    """Stands for a continuum: a load, and an angle that grows with height."""

    def __init__(self, load):
        self.load = load

    def evaluate(self, points):
        return {"shear_angle": 2.0 * points[:, 1]}


def strip(**options):
    """A strip of 4 cm x 8 cm with a hole, cut at 45 degrees."""
    return Network(COMM, Preform.rectangle("40 mm", "80 mm", holes=[CIRCLE[:-1]], **options), GLASS)


def square():
    return Network(COMM, Preform.rectangle("40 mm", "40 mm", bias_angle="0 deg"), GLASS)


@pytest.fixture(scope="module")
def small():
    """Small displacements, with what it is compared with."""
    network = strip(refine=2)
    return BiasExtension(network, ["0.5 mm", "1 mm"], finite=False).solve()


@pytest.fixture(scope="module")
def finite():
    network = Network(COMM, Preform.rectangle("40 mm", "90 mm", bias_angle="45 deg"), GLASS)
    return BiasExtension(network, ["2 mm", "6 mm"], finite=True, increments=5).solve()


def drawn(result, name, *args, **options):
    """The figure of one of a result's pictures."""
    return made(figures.figures(result, *args, **options)[0][name])


def made(draw):
    with rc_context(pictures.STYLE):
        return draw()


def lines_of(axes):
    """Data (x, y) of the axes' lines by their labels."""
    return {line.get_label(): np.array(line.get_data()) for line in axes.get_lines()}


def labels_of(axes):
    return axes.get_xlabel(), axes.get_ylabel()


def legend_of(axes):
    return [text.get_text() for text in axes.get_legend().get_texts()]


def check(axes, name, x, y):
    """Compare a line with what it should show; it must be in the legend if there is one."""
    np.testing.assert_allclose(lines_of(axes)[name], [x, y], rtol=1e-12, atol=1e-15)
    assert axes.get_legend() is None or name in legend_of(axes)


def collections(axes, kind):
    return [artist for artist in axes.collections if type(artist) is kind]


def check_in_sight(axes, points):
    """All points are within the axes, which have one scale in both directions."""
    assert axes.get_aspect() == 1.0
    low, high = np.transpose([axes.get_xlim(), axes.get_ylim()])
    assert (points >= low).all()
    assert (points <= high).all()
    assert np.ptp(points, axis=0) == pytest.approx(high - low, rel=0.25)


# -- the specimen ----------------------------------------------------------------------------------


def check_yarns(axes, result, state, before=True, values=None, clamps=2):
    """Lines of all yarns where they are, in the colours of their values, between their clamps."""
    sample = sample_yarns(
        result.network, state.node_displacement, state.fields, values=values
    )  # fmt: skip
    rest, now = collections(axes, LineCollection)[: 1 + before] if before else (None, None)
    if before:
        expected = np.split(1e3 * sample.before, sample.first[1:])
        for segment, yarn in zip(rest.get_segments(), expected, strict=True):
            np.testing.assert_allclose(segment, yarn)
    else:
        now = collections(axes, LineCollection)[0]
    np.testing.assert_allclose(now.get_segments(), 1e3 * sample.after[sample.segment])
    with np.errstate(invalid="ignore"):
        expected = np.nanmean(sample.values[sample.segment], axis=1)
    np.testing.assert_allclose(now.get_array().filled(np.nan), expected)
    assert now.norm.vmin < now.norm.vmax
    check_in_sight(axes, 1e3 * sample.after)
    bars = collections(axes, PolyCollection)
    assert len(bars) == (clamps > 0)
    if clamps:
        assert len(bars[0].get_paths()) == clamps
        assert bars[0].get_hatch()
    return now


def test_yarns(finite):
    """Before in grey, after in colour, and the bars of the clamps outside of the cloth."""
    figure = drawn(finite, "yarns.png", "a test")
    axes, bar = figure.axes
    now = check_yarns(axes, finite, finite.states[-1])
    assert labels_of(axes) == ("x (mm)", "y (mm)")
    told = "a test\nyarns at rest, grey, and at extension "
    assert figure.get_suptitle().startswith(told)
    assert bar.get_ylabel() == "shear angle (°)"
    assert bar.get_ylim() == (now.norm.vmin, now.norm.vmax) == (0.0, now.norm.vmax)
    lower, upper = (path.vertices for path in collections(axes, PolyCollection)[0].get_paths())
    assert lower[:, 1].max() == pytest.approx(0.0)
    assert upper[:, 1].min() == pytest.approx(96.0)


def test_stages(finite):
    """Each state in its place; colours and scale are shared."""
    figure = drawn(finite, "stages.png", "two stages")
    *axes, bar = figure.axes
    found = [
        check_yarns(panel, finite, state, before=False)
        for panel, state in zip(axes, finite.states, strict=True)
    ]
    assert found[0].norm is found[1].norm
    assert axes[0].get_ylim() == axes[1].get_ylim()
    texts = [
        f"extension {x} mm\n{s.load:.3g} N" for x, s in zip((2, 6), finite.states, strict=True)
    ]
    assert [panel.get_title() for panel in axes] == texts
    assert figure.get_suptitle() == "two stages"
    assert bar.get_ylabel() == "shear angle (°)"
    tops = [
        max(path.vertices[:, 1].min() for path in collections(panel, PolyCollection)[0].get_paths())
        for panel in axes
    ]
    assert tops == pytest.approx([92.0, 96.0])


def test_titles_wider_than_their_panels(finite):
    """They do not touch."""
    state = finite.states[-1]
    sample = sample_yarns(finite.network, state.node_displacement, state.fields)
    title = "a specimen at an extension of 100 mm"
    figure = made(lambda: pictures.yarns([(title, sample, np.zeros((0, 2, 2)))] * 3))
    *axes, _ = figure.axes
    figure.draw_without_rendering()
    spans = [panel.title.get_window_extent().intervalx for panel in axes]
    assert spans[0][1] < spans[1][0]
    assert spans[1][1] < spans[2][0]


STRIPS = {"tall": (30, 600, 100), "wide": (600, 30, 1), "thread": (12, 600, 20)}  # mm


@pytest.mark.parametrize("shape", STRIPS)
def test_texts_of_thin_strips_do_not_touch(shape):
    """Headings, ticks, labels of axes and bars: none lies on another, or on a bar."""
    width, length, extension = STRIPS[shape]
    preform = Preform.rectangle(width / 1000, length / 1000)
    network = Network(COMM, preform, Fabric.from_library("glass-pp-plain-1.93"))
    result = BiasExtension(network, f"{extension} mm").solve()
    panels = [figures._panel(f"extension {k}0 mm\n0.292 N", result) for k in range(4)]
    draws = [lambda: pictures.yarns(panels, "a strip", before=False)]
    draws += [figures.figures(result, "strip")[0][f"{n}.png"] for n in ("yarns", "tension_map")]
    for draw in draws:
        figure = made(draw)
        figure.draw_without_rendering()
        texts = list(figure.texts)
        for axes in figure.axes:
            texts += [axes.title, axes.xaxis.label, axes.yaxis.label]
            for tick in (*axes.xaxis._update_ticks(), *axes.yaxis._update_ticks()):  # those in view
                texts += [tick.label1, tick.label2]
        texts = [text for text in texts if text.get_visible() and text.get_text()]
        for one, other in combinations(texts, 2):
            assert not one.get_window_extent().overlaps(other.get_window_extent()), (one, other)
        *axes, bar = figure.axes
        for panel in axes:
            assert not panel.get_window_extent().overlaps(bar.get_window_extent())


def test_with_and_without_bending(small):
    """In this order, with one colour scale."""
    without = BiasExtension(small.network, "1 mm", bending=False, finite=False).solve()
    figure = drawn(small, "with_and_without_bending.png", "", without)
    left, right, _ = figure.axes
    assert [left.get_title(), right.get_title()] == ["no yarn bending", "with yarn bending"]
    first = check_yarns(left, without, without.states[-1])
    second = check_yarns(right, small, small.states[-1])
    assert first.norm is second.norm


def test_clamps_of_kinds(small):
    """One bar for half a specimen, none for free ends."""
    half = BiasExtension(small.network, "1 mm", upper="centre-line", finite=False).solve()
    free = OffAxisTension(small.network, "1 mm", ends="free", finite=False).solve()
    for result, clamps in ((half, 1), (free, 0)):
        axes, _ = drawn(result, "yarns.png").axes
        check_yarns(axes, result, result.states[-1], clamps=clamps)


def test_note_of_what_is_left_out(finite):
    sample = sample_yarns(finite.network, finite.node_displacement, finite.fields, limit=20)
    figure = made(lambda: pictures.yarns([("", sample, np.empty((0, 2, 2)))]))
    assert f"1 in {sample.every} yarns drawn" in [text.get_text() for text in figure.texts]


def test_file_is_to_scale(tmp_path, finite):
    """The specimen is as much taller than wide in the file as in the test."""
    figures.plot(finite, tmp_path / "yarns.png")
    assert [path.name for path in tmp_path.iterdir()] == ["yarns.png"]
    image = imread(tmp_path / "yarns.png")[..., :3]
    colour = np.ptp(image, axis=2) > 0.25
    columns = np.flatnonzero(colour.any(axis=0))
    # Between the specimen and the colour bar.
    right = columns[np.flatnonzero(np.diff(columns) > 15)[0]]
    rows = np.flatnonzero(colour[:, columns[0] : right].any(axis=1))
    assert np.ptp(rows) / (right - columns[0]) == pytest.approx(96 / 40, rel=0.05)


# -- maps ------------------------------------------------------------------------------------------


def check_map(axes, network, values):
    """Each crossover's cell in the colour of its value, inside the outline."""
    under, cells = collections(axes, PolyCollection)
    sample = sample_map(network, {"": values})
    corners = [path.vertices[:4] for path in cells.get_paths()]
    np.testing.assert_allclose(corners, 1e3 * sample.cells())
    np.testing.assert_allclose(cells.get_array().filled(np.nan), values)
    np.testing.assert_allclose(under.get_array().filled(np.nan), values[sample.at_outline])
    assert under.get_zorder() < cells.get_zorder()
    assert under.norm is cells.norm
    (border,) = axes.patches
    assert len(border.get_path().to_polygons()) == len(sample.outline)
    assert cells.get_clip_path() is not None
    check_in_sight(axes, 1e3 * sample.outline[0])
    return cells


def test_shear_maps(small):
    """The network, the membrane with the same colours, their difference with its own."""
    network = small.network
    shear = np.rad2deg(small.fields["shear_angle"])
    shear[~small.fields["carrying"]] = np.nan
    other = np.rad2deg(2.0 * network.crossover_position[:, 1])
    figure = drawn(small, "shear_map.png", "maps", None, [Membrane(1.0)])
    left, middle, right, shared, off = figure.axes
    names = [axes.get_title() for axes in (left, middle, right)]
    assert names == ["Network", "Membrane", "Network minus membrane"]
    cells = [
        check_map(axes, network, values)
        for axes, values in ((left, shear), (middle, other), (right, shear - other))
    ]
    assert cells[0].norm is cells[1].norm
    assert cells[2].norm.vmin == -cells[2].norm.vmax
    assert (shared.get_ylabel(), off.get_ylabel()) == ("shear angle (°)", "difference (°)")
    told = "shear angle at extension 1 mm, on the cloth at rest"
    assert figure.get_suptitle() == f"maps\n{told}"


def test_map_by_itself(tmp_path, small):
    """Is headed by the title and what it shows; its hole is paper, the cloth around it is not."""
    figure = drawn(small, "shear_map.png", "a map")
    axes, _ = figure.axes
    told = "shear angle at extension 1 mm, on the cloth at rest"
    assert (axes.get_title(), figure.get_suptitle()) == ("", f"a map\n{told}")
    figure.savefig(tmp_path / "map.png", dpi=100)
    image = imread(tmp_path / "map.png")[..., :3]

    def colour(x, y):
        column, row = axes.transData.transform((x, y)) * 100 / figure.dpi
        return image[len(image) - 1 - int(row), int(column)]

    for y in (32.0, 40.0, 48.0):
        assert colour(0.0, y).min() == 1.0
    for x, y in ((16.0, 40.0), (-16.0, 40.0), (0.0, 60.0), (-12.0, 20.0), (19.0, 79.0)):
        assert colour(x, y).min() < 0.9, (x, y)


def test_tension_maps(small):
    """Of both families with one scale, in mN where they are small."""
    fields, network = small.fields, small.network
    figure = drawn(small, "tension_map.png")
    *axes, bar = figure.axes
    assert [panel.get_title() for panel in axes] == ["Warp", "Weft"]
    tensions = [
        np.where(fields["carrying"], fields[f"{name}_tension"] / family.yarns, np.nan)
        for name, family in (("warp", GLASS.warp), ("weft", GLASS.weft))
    ]
    unit, newton = ("N", 1.0) if np.nanmax(np.abs(tensions)) >= 0.1 else ("mN", 1e-3)
    cells = [
        check_map(panel, network, tension / newton)
        for panel, tension in zip(axes, tensions, strict=True)
    ]
    assert cells[0].norm is cells[1].norm
    assert bar.get_ylabel() == f"tension ({unit} per yarn)"


def test_heights_of_a_strut():
    """Cloth in space has a map of them; where it does not shear its yarns have their colours."""
    cloth = YarnFamily(4e5, 0.0, 100.0, 1e-4, 1e-3)
    network = Network(COMM, Preform.rectangle(0.02, 0.1, 0.0), Fabric("f", cloth, cloth, 1e3))
    result = OffAxisTension(network, "-10 um", space=True, stability={"modes": 1}).solve()
    heights = 1e3 * result.fields["displacement"][:, 2]
    assert abs(heights).max() > 0.1
    figure = drawn(result, "height_map.png", "a strut")
    axes, bar = figure.axes
    check_map(axes, network, heights)
    assert bar.get_ylabel() == "height out of the plane (mm)"
    assert figure.get_suptitle() == "a strut\nheight at extension -0.01 mm, on the cloth at rest"
    axes, bar = drawn(result, "yarns.png").axes
    check_yarns(axes, result, result.states[-1], values=[heights, heights])
    assert bar.get_ylabel() == "height out of the plane (mm)"
    assert "shear_map.png" not in figures.figures(result)[0]


def test_bars_have_zero_below(small):
    """Also where all values are negative."""
    shear = np.abs(np.rad2deg(small.fields["shear_angle"]))
    for sign in (1.0, -1.0):
        sample = sample_map(small.network, {"network": sign * shear})
        bar = made(lambda sample=sample: pictures.maps(sample)).axes[-1]
        assert bar.get_ylim()[0] == 0.0


def test_uniform_values_are_told():
    """To 1e-6 of their size; rounding is none."""
    angle, bent = np.full(5, 20.0), np.linspace(20.0, 20.1, 5)
    text = figures.uniform_text
    assert text(COMM, "Angle", {"a": angle}, 1e-6, " deg") == "Angle: uniform, 20 deg."
    assert text(COMM, "Angle", {"a": angle, "b": bent}, 1e-6, " deg") is None
    noise = {"warp": 1e-15 * bent, "weft": 3.0 + 0.0 * angle}
    assert text(COMM, "T", noise, 1e-9, " N") == "T: uniform, warp 0 N, weft 3 N."
    noise = {"warp": np.array([-5e-10, 9e-10])}
    assert text(COMM, "T", noise, 1e-9, " N") == "T: uniform, 0 N."


@pytest.mark.parametrize("kind", ["curves", "yarns"])
def test_long_titles_are_broken(tmp_path, small, kind):
    """No wider than the axes, or the figure of several, that they stand over; no letter is lost."""
    title = "Bias extension of a specimen whose title says what it is at some length, $5 each, 45°"
    text = pictures.plain_text(title)
    if kind == "curves":
        figure = pictures.curves({"a": ([0, 1], [0, 1])}, ("x", "y"), text)
    else:
        figure = drawn(small, "yarns.png", text)
    pictures.save(COMM, tmp_path / "picture.png", lambda: figure)
    figure.draw_without_rendering()
    (shown,) = [a.title for a in figure.axes if a.get_title()] or figure.texts
    room = figure.bbox if shown.axes is None else shown.axes.get_window_extent()
    assert "\n" in shown.get_text()
    assert shown.get_window_extent().width <= room.width
    assert " ".join(shown.get_text().split()).startswith(text)


def test_parts_that_are_not_seen_are_left_out():
    """Of energies; if there is none at all, they are named nevertheless."""
    x, one = np.array([1.0, 2.0]), np.array([1.0, 4.0])
    figure = pictures.stacked(x, {"a": one, "b": 1e-4 * one, "c": 0.1 * one}, ("x", "y"))
    assert legend_of(figure.axes[0]) == ["c", "a"]
    figure = pictures.stacked(x, {"a": 0.0 * one}, ("x", "y"))
    assert legend_of(figure.axes[0]) == ["a"]


@pytest.mark.parametrize("strain", [["0.5 %"], ["0.5 %", "1 %"]])
def test_under_pretension_curves_do_not_begin_at_nothing(strain):
    """But at the pretension, and its energy: 5 N/cm twice, of yarns of 1e4 N/m, over 15 cm^2."""
    yarns = {"modulus": "1e4 N/m", "yarns": "1 /cm", "yarn_bending": "1 N mm^2"}
    cloth = Fabric.from_table(
        "soft", {"warp": yarns, "weft": yarns, "shear": {"modulus": "1 N/cm"}}
    )
    network = Network(MPI.COMM_SELF, Preform.rectangle("30 mm", "50 mm", "0 deg"), cloth)
    for test in (
        Biaxial(network, strain, pretension="5 N/cm"),
        BiaxialLoad(network, ["6 N/cm"], pretension="5 N/cm"),
    ):
        result = test.solve()
        for line in drawn(result, "tension_against_strain.png").axes[0].get_lines():
            assert line.get_xdata()[0] == 0.0
            assert line.get_ydata()[0] == pytest.approx(5.0, rel=1e-9)
        (total,) = drawn(result, "energy.png").axes[0].get_lines()
        e = test.prestretch[0] - 1.0
        assert e * 1e4 / (1.0 + e) == pytest.approx(500.0)
        stored = 1e3 * 1e4 * e**2 * 1.5e-3 / (1.0 + e) ** 2
        assert total.get_data()[1][0] == pytest.approx(stored, rel=1e-9)


def test_energy_of_a_test_that_goes_to_and_fro():
    """Over its increments, all of them: over the angle parts would lie upon each other."""
    cloth = Fabric.from_library(
        "glass-pp-plain-1.93",
        {"shear": {"modulus": "1 N/cm"}, "shear_friction": {"torque": "5 N/m"}},
    )
    network = Network(MPI.COMM_SELF, Preform.rectangle("20 mm", "20 mm", "0 deg"), cloth)
    result = PictureFrame(network, ["10 deg", "5 deg", "12 deg"], bending=False).solve()
    axes = drawn(result, "energy.png").axes[0]
    (total,) = axes.get_lines()
    count = len(result.increments)
    np.testing.assert_array_equal(total.get_xdata(), np.arange(count + 1))
    assert labels_of(axes) == ("increment", "energy (mJ)")


def test_shear_that_is_rounding_is_not_drawn():
    """A strip along its yarns has zones, but does not shear."""
    cloth = Fabric.from_library("glass-pp-plain-1.93")
    network = Network(MPI.COMM_SELF, Preform.rectangle("20 mm", "60 mm", "0 deg"), cloth)
    result = OffAxisTension(network, "0.1 mm").solve()
    assert result.experiment.has_zones
    assert not {"zones.png", "centre_line.png"} & set(figures.figures(result)[0])


def test_curves_that_agree_are_both_seen():
    """The later one is dashed, and its points are smaller."""
    x = [0.0, 1.0, 2.0]
    first, second = pictures.curves({"a": (x, x), "b": (x, x)}, ("x", "y")).axes[0].get_lines()
    assert (first.get_linestyle(), second.get_linestyle()) == ("-", "--")
    assert first.get_markersize() > second.get_markersize()


@pytest.mark.parametrize(
    ("values", "limits", "extend"),
    [
        ([[0.0, 2.0, 8.0]], (0, 8), "neither"),
        ([[-0.1, 8.0]], (0, 8), "neither"),
        ([[-8.0, 0.0], [-2.0]], (-8, 0), "neither"),
        ([[-4.0, 8.0]], (-8, 8), "neither"),
        ([[0.0, np.nan]], (0, 1), "neither"),
        ([[-2e-12, 1e-12]], (0, 1), "neither"),
        ([np.append(np.full(1000, 5.0), 9 * [90.0])], (0, 5), "max"),
        ([np.append(np.full(1000, 5.0), 20 * [90.0])], (0, 90), "neither"),
        ([np.full(1000, 5.0), np.full(10, 90.0)], (0, 90), "neither"),  # the last of many stages
        ([np.append(np.zeros(1000), [2.0, 3.0])], (0, 3), "neither"),  # wrinkles in one place
    ],
)
def test_colour_scales(values, limits, extend):
    """From zero, or about it; a single wild value does not stretch them."""
    scale = pictures.colour_scale([np.array(value) for value in values])
    assert (scale.norm.vmin, scale.norm.vmax) == limits
    assert scale.cmap.colorbar_extend == extend
    assert np.all(scale.to_rgba(np.ma.masked_invalid([np.nan]))[0, :3] == to_rgb("0.75"))


# -- curves ----------------------------------------------------------------------------------------


def test_load_against_extension(finite):
    """All increments as a line from the origin, states marked, others as points."""
    membranes = [Membrane(2.0), Membrane(5.0)]
    axes = drawn(
        finite, "load_against_extension.png", "a test", None, membranes, None, MEASURED
    ).axes[0]  # fmt: skip
    steps = finite.increments
    assert len(steps) > 2
    check(
        axes, "network", [0.0, *(1e3 * s.control for s in steps)], [0.0, *(s.load for s in steps)]
    )
    check(axes, "membrane", [2.0, 6.0], [2.0, 5.0])
    check(axes, "measured", [1.0, 2.0], [0.5, 1.5])
    (marks,) = (line for line in axes.get_lines() if line.get_label().startswith("_"))
    np.testing.assert_allclose(marks.get_data(), [[2.0, 6.0], finite.loads])
    closed = "closed form, yarns neither stretch nor bend"
    assert legend_of(axes) == ["network", closed, "membrane", "measured"]
    assert labels_of(axes) == ("extension (mm)", "load (N)")
    assert axes.get_title() == "a test"
    assert (axes.get_xlim()[0], axes.get_ylim()[0]) == (0.0, 0.0)


def test_energy(finite):
    """Parts upon each other, their sum on top."""
    axes = drawn(finite, "energy.png").axes[0]
    x = [0.0, *(1e3 * step.control for step in finite.increments)]
    parts = np.transpose(
        [
            [0.0, 0.0, 0.0],
            *([1e3 * e for e in step.energies.values()] for step in finite.increments),
        ]
    )
    (total,) = axes.get_lines()
    np.testing.assert_allclose(total.get_data(), [x, parts.sum(axis=0)])
    tops = np.cumsum(parts, axis=0)
    areas = axes.collections
    assert [area.get_label() for area in areas] == ["tension", "shear", "yarn bending"]
    for area, below, top in zip(areas, [0.0 * tops[0], *tops[:-1]], tops, strict=True):
        points = area.get_paths()[0].vertices
        for edge in (below, top):
            off = np.linalg.norm(points[:, None] - np.column_stack([x, edge]), axis=2)
            assert off.min(axis=0).max() < 1e-9 * parts.max()
    assert legend_of(axes) == ["yarn bending", "shear", "tension"]
    assert labels_of(axes) == ("extension (mm)", "strain energy (mJ)")


def test_zones(finite):
    """The zones' angles; and the net's: in the middle by its diagonals, at the sides half."""
    axes = drawn(finite, "zones.png").axes[0]
    curve = finite.curve()
    for zone, label in (
        ("middle", "middle zone"),
        ("side", "side zones"),
        ("clamp", "at the clamps"),
    ):
        angle = curve[f"shear_{zone}_deg"]
        assert len(angle) > 2
        check(axes, f"{label} (median)", [0.0, *curve["extension_mm"]], [0.0, *angle])
    guides = [np.array(line.get_data()) for line in axes.get_lines() if line.get_color() == "0.4"]
    free = 90.0 - 40.0
    x = np.linspace(0.0, 6.0, 200)
    middle = 90.0 - 2.0 * np.rad2deg(np.arccos((free + x) / (np.sqrt(2.0) * free)))
    assert middle[-1] > 12.0
    for guide, angle in zip(guides, (middle, 0.5 * middle), strict=True):
        np.testing.assert_allclose(guide, [x, angle], atol=1e-9)
    assert legend_of(axes)[0] == "inextensible net"
    assert len(legend_of(axes)) == 4
    assert labels_of(axes) == ("extension (mm)", "shear angle (°)")


def test_shear_against_load(small):
    axes = drawn(small, "shear_against_load.png").axes[0]
    curve = small.curve()
    load = np.append(0.0, small.loads)
    assert "at the centre point" not in lines_of(axes)  # where a hole is
    check(axes, "largest (absolute)", load, [0.0, *curve["shear_max_deg"]])
    assert labels_of(axes) == ("load (N)", "shear angle (°)")
    preform = Preform.rectangle("20 mm", "40 mm")
    whole = BiasExtension(Network(COMM, preform, GLASS), "0.1 mm", finite=False).solve()
    axes = drawn(whole, "shear_against_load.png").axes[0]
    mn = np.append(0.0, 1e3 * whole.loads)
    check(axes, "at the centre point", mn, [0.0, *whole.curve()["shear_centre_deg"]])


def test_centre_line(small):
    """With and without bending and of the membrane; lines stop at the hole."""
    without = BiasExtension(small.network, "1 mm", bending=False, finite=False).solve()
    axes = drawn(small, "centre_line.png", "", without, [Membrane(1.0)]).axes[0]
    angle = 2.0 * small.network.crossover_position[:, 1]
    for name, line in (
        ("network, with yarn bending", small.centre_line()),
        ("network, without yarn bending", without.centre_line()),
        ("membrane", small.centre_line(angle)),
    ):
        x, y = lines_of(axes)[name]
        hole = np.isnan(x)
        assert hole.sum() == 1
        assert np.isnan(y[hole]).all()
        assert 29.0 > x[: hole.argmax()].max() > 20.0
        np.testing.assert_allclose(x[~hole], 1e3 * line.distance)
        np.testing.assert_allclose(y[~hole], np.rad2deg(line.shear_angle))
        assert name in legend_of(axes)
    assert labels_of(axes) == ("distance from the clamp (mm)", "shear angle (°)")


def test_ladder(small):
    """On logarithmic axes a guide of the pitch's slope, below all differences."""
    axes = drawn(small, "ladder.png", "finer", None, (), LADDER).axes[0]
    crossovers = [50, 200, 5000]
    check(axes, "displacement at the crossovers", crossovers, [0.04, 0.03, 0.002])
    check(axes, "load", crossovers, [0.03, 0.02, 0.01])
    assert (axes.get_xscale(), axes.get_yscale()) == ("log", "log")
    assert labels_of(axes) == ("crossovers", "relative difference to the membrane")
    (guide,) = (line.get_data() for line in axes.get_lines() if line.get_label().startswith("_"))
    # Four times as many crossovers: half the pitch, half the difference.
    assert guide[1][1] / guide[1][0] == pytest.approx(0.5)
    assert guide[1][2] / guide[1][0] == pytest.approx(0.1)
    assert (guide[1] < 0.61 * np.array([0.03, 0.02, 0.002])).all()
    assert guide[1][2] == pytest.approx(0.6 * 0.002)
    assert "∝ pitch" in [text.get_text() for text in axes.texts]


def test_biaxial():
    """Both tensions over the strain; yarns in the colours of their tension, no stages, no zones."""
    result = Biaxial(square(), ["0.5 %", "1 %"], ratio=0.5, finite=True).solve()
    found, uniform = figures.figures(result)
    assert list(found)[:3] == ["yarns.png", "tension_against_strain.png", "energy.png"]
    assert not {"stages.png", "zones.png", "centre_line.png"} & set(found)
    assert uniform["shear_map.png"] == "Shear angle: uniform, 0°."
    axes = made(found["tension_against_strain.png"]).axes[0]
    curve = result.curve()
    for label, name in (("warp", "warp"), ("weft, strain 0.5 of the warp's", "weft")):
        check(axes, label, [0.0, 0.5, 1.0], [0.0, *curve[f"tension_{name}_N_per_cm"]])
    assert labels_of(axes) == ("warp strain (%)", "tension (N/cm)")
    axes, bar = made(found["yarns.png"]).axes
    tensions = [
        result.fields[f"{name}_tension"] / getattr(GLASS, name).yarns for name in ("warp", "weft")
    ]
    check_yarns(axes, result, result.states[-1], values=tensions, clamps=4)
    assert bar.get_ylabel() == "tension (N per yarn)"


def test_cantilever():
    """The load over the deflection, in mN where it is small, with what was measured."""
    network = Network(COMM, Preform.rectangle("20 mm", "60 mm", bias_angle="0 deg"), GLASS)
    result = Cantilever(network, ["10 mN", "20 mN"], finite=False).solve()
    axes = drawn(result, "load_against_deflection.png", measured=MEASURED).axes[0]
    curve = result.curve()
    check(axes, "across", [0.0, *curve["tip_across_mm"]], [0.0, 10.0, 20.0])
    along = lines_of(axes)["along, towards the clamp"]
    assert -curve["tip_along_mm"] == pytest.approx(along[0][along[1] > 0.0])
    check(axes, "measured, across", [0.0, 1.0, 2.0], [0.0, 500.0, 1500.0])
    assert labels_of(axes) == ("deflection of the loaded edge (mm)", "load (mN)")


def test_picture_frame():
    """The load over the angle; measured loads over the crosshead."""
    result = PictureFrame(square(), ["10 deg", "20 deg"], finite=True).solve()
    found = figures.figures(result, measured=MEASURED)[0]
    axes = made(found["load_against_angle.png"]).axes[0]
    angles, loads = zip(*((s.control, s.load) for s in result.increments), strict=True)
    check(axes, "network", [0.0, *np.rad2deg(angles)], [0.0, *loads])
    assert labels_of(axes) == ("shear angle of the frame (°)", "load (N)")
    axes = made(found["load_against_crosshead.png"]).axes[0]
    curve = result.curve()
    check(axes, "network", [0.0, *curve["crosshead_mm"]], [0.0, *curve["load_N"]])
    check(axes, "measured", [1.0, 2.0], [0.5, 1.5])
    assert labels_of(axes) == ("displacement of the crosshead (mm)", "load (N)")
    axes, _ = made(found["yarns.png"]).axes
    check_yarns(axes, result, result.states[-1], clamps=4)


def test_overlaid():
    """Two curves in each panel; labels are taken literally, the legend is there once."""
    panels = [
        (("x", name), {"_a": (([0.0, 1.0], [0.0, k]), False), "b $": (([0.5], [k]), True)})
        for k, name in ((2.0, "load"), (3.0, "angle"))
    ]
    figure = made(lambda: pictures.overlaid(panels))
    for axes, k, name in zip(figure.axes, (2.0, 3.0), ("load", "angle"), strict=True):
        assert labels_of(axes) == ("x", name)
        line, points = axes.get_lines()
        np.testing.assert_allclose(line.get_data(), [[0.0, 1.0], [0.0, k]])
        np.testing.assert_allclose(points.get_data(), [[0.5], [k]])
        assert (line.get_marker(), points.get_linestyle()) == ("None", "None")
    (legend,) = figure.legends
    assert [text.get_text() for text in legend.get_texts()] == ["a", r"b \$"]


def test_many_points_have_dashes():
    x = np.linspace(0.0, 1.0, 50)
    curves = {"a": (x, x), "b": (x, 2 * x), "c": ([1.0], [1.0])}
    axes = made(lambda: pictures.curves(curves, ("x", "y"))).axes[0]
    first, second, point = axes.get_lines()
    assert first.get_linestyle() != second.get_linestyle()
    assert first.get_marker() == second.get_marker() == "None"
    assert point.get_marker() != "None"


@pytest.mark.parametrize(("sign", "limits"), [(1.0, (0.0, None)), (-1.0, (None, 0.0))])
def test_axes_include_zero(sign, limits):
    axes = made(lambda: pictures.curves({"a": ([0, sign], [sign, 2 * sign])}, ("x", "y"))).axes[0]
    for found in (axes.get_xlim(), axes.get_ylim()):
        assert all(a is None or a == b for a, b in zip(limits, found, strict=True))


def test_curves_start_at_the_origin():
    """Whichever way the test is driven, unless it goes through the origin anyway."""
    x, y = pictures.from_origin([2.0, 1.0], [20.0, 10.0])
    assert (x.tolist(), y.tolist()) == ([2, 1, 0], [20, 10, 0])
    x, y = pictures.from_origin(-1.0, -10.0)
    assert (x.tolist(), y.tolist()) == ([0, -1], [0, -10])
    x, y = pictures.from_origin([-1.0, -2.0], [-10.0, -20.0])
    assert (x.tolist(), y.tolist()) == ([0, -1, -2], [0, -10, -20])
    x, y = pictures.from_origin([1.0, 3.0, 2.0], [10.0, 30.0, 15.0])
    assert (x.tolist(), y.tolist()) == ([0, 1, 3, 2], [0, 10, 30, 15])
    x, y = pictures.from_origin([-1, 1], [-3, 3])
    assert len(x) == 2


def test_curves_stop_at_a_hole():
    x, y = pictures.broken_at_gaps([1.0, 2, 3, 9, 10], [5.0, 6, 7, 8, 9])
    np.testing.assert_array_equal(x, [1, 2, 3, np.nan, 9, 10])
    np.testing.assert_array_equal(y, [5, 6, 7, np.nan, 8, 9])


def test_files_of_a_run(tmp_path, small):
    """All pictures are written, and the summary learns of maps that are uniform."""
    summary = {"title": "5 $ and 6 $", "continuum": {"ladder": LADDER}}
    names = figures.draw_all(tmp_path, small, small, [Membrane(1.0)], summary, MEASURED)
    assert names == [
        "yarns.png", "load_against_extension.png", "shear_against_load.png", "centre_line.png",
        "shear_map.png", "tension_map.png", "with_and_without_bending.png", "ladder.png",
    ]  # fmt: skip
    assert sorted(names) == sorted(path.name for path in tmp_path.iterdir())
    assert summary["uniform_maps"] == {}
    for name in names:
        assert min(imread(tmp_path / name).shape[:2]) > 300


def test_swept_over_numbers():
    """Curves have a colour bar, dashes by what else was varied; results are over the key."""
    x = [0.0, 1.0]
    lines = [(value, other, x, [0.0, value]) for value in (30.0, 45.0) for other in ("a", "b")]
    ends = [("load (N)", {"a": ([30.0, 45.0], [3.0, 4.5]), "b": ([30.0, 45.0], [6.0, 9.0])})]
    figure = pictures.swept("angle (deg)", ("x (mm)", "load (N)"), lines, ends, "a title")
    curves, results, bar = figure.axes
    assert [line.get_ydata()[-1] for line in curves.get_lines()] == [30.0, 30.0, 45.0, 45.0]
    dashes = [line.get_linestyle() for line in curves.get_lines()]
    colours = [line.get_color() for line in curves.get_lines()]
    assert dashes[0] == dashes[2] != dashes[1]
    assert colours[0] == colours[1] != colours[2]
    assert bar.get_ylabel() == results.get_xlabel() == "angle (deg)"
    assert legend_of(results) == ["a", "b"]
    assert results.get_ylim()[0] == 0.0
    assert figure.get_suptitle() == "a title"


def test_swept_over_words():
    """They have names in place of a scale, and no lines from one to the next."""
    lines = [(word, "", [0.0, 1.0], [0.0, 1.0]) for word in ("grip", "_free")]
    ends = [("load (N)", {"": (["grip", "_free"], [3.0, 4.5])})]
    curves, results = pictures.swept("upper", ("x (mm)", "y (N)"), lines, ends).axes
    assert legend_of(curves) == ["grip", "free"]
    assert results.get_lines()[0].get_linestyle() == "None"
    (alone,) = pictures.swept("upper", ("", ""), [], ends).axes  # without curves
    assert alone.get_xlabel() == "upper"


@pytest.mark.parametrize("kind", ["bias", "biaxial"])
def test_animation_of_a_flat_test(tmp_path, monkeypatch, kind):
    """A picture for each increment, of one size; so many evenly where there are more."""
    from PIL import Image

    fabric = Fabric.from_library("e-glass-plain-2.4")
    bias = kind == "bias"
    preform = Preform.rectangle("40 mm", "90 mm", bias_angle="45 deg" if bias else "0 deg")
    network = Network(MPI.COMM_SELF, preform, fabric)
    if bias:
        result = BiasExtension(network, ["2 mm", "10 mm"], increments=6).solve()
    else:
        result = Biaxial(network, ["0.2 %", "0.5 %"]).solve()
    for most in (40, 3):
        monkeypatch.setattr(figures, "MOST_FRAMES", most)
        figures.draw_animation(result, tmp_path / "animation.gif", "A test")
        with Image.open(tmp_path / "animation.gif") as image:
            assert image.n_frames == min(most, len(result.increments))
            assert image.info["loop"] == 0
            first = np.asarray(image.convert("RGB"))
            image.seek(image.n_frames - 1)
            last = np.asarray(image.convert("RGB"))
        assert first.shape == last.shape
        assert (first != last).any()
