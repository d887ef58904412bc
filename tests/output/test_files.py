# SPDX-License-Identifier: MIT
"""Files that a run leaves behind, read back by other programs."""

import csv
import json
from dataclasses import replace

import h5py
import numpy as np
import pytest
import shapely
from matplotlib.text import Text
from mpi4py import MPI
from support.vtkhdf import read_vtkhdf, times_of

from cruciform_petsc import BiasExtension, Fabric, Network, Preform
from cruciform_petsc.errors import InputError
from cruciform_petsc.output import figures, pictures
from cruciform_petsc.output.paraview import ENERGIES, write, write_series, write_state
from cruciform_petsc.output.sample import sample_map, sample_yarns
from cruciform_petsc.output.tables import write_csv, write_json, written_whole

COMM = MPI.COMM_SELF
TABLE_1 = Fabric.from_library("e-glass-plain-2.4")
CIRCLE = np.asarray(shapely.Point(0.0, 0.04).buffer(0.0101).exterior.coords)


@pytest.fixture(scope="module")
def result():
    """A strip with a hole, pulled by 1 mm: some yarns are cut in two by the hole."""
    preform = Preform.rectangle("40 mm", "80 mm", holes=[CIRCLE[:-1]], refine=2)
    return BiasExtension(Network(COMM, preform, TABLE_1), extension="1 mm").solve()


@pytest.fixture
def sample(result):
    return sample_yarns(result.network, result.node_displacement, result.fields)


# -- tables ----------------------------------------------------------------------------------------


def test_csv_reads_back_exactly(tmp_path):
    """Numbers to the last bit; what is not finite is an empty field."""
    path = tmp_path / "curve.csv"
    load = np.array([0.1, 1 / 3, np.nan])
    write_csv(COMM, path, {"extension_mm": [1, 2.5, 3], "load_N": load})
    with path.open(newline="") as file:
        header, *rows = csv.reader(file)
    assert header == ["extension_mm", "load_N"]
    assert [float(row[1]) for row in rows[:2]] == load[:2].tolist()
    assert rows[0][0] == "1"
    assert rows[2] == ["3", ""]
    with pytest.raises(ValueError, match="shorter"):
        write_csv(COMM, path, {"a": [1, 2], "b": [1]})
    assert path.read_text().startswith("extension_mm"), "a failed write must leave the old file"


def test_json_of_numpy_values(tmp_path):
    """Numpy numbers and arrays become plain ones; not finite becomes null; paths become text."""
    path = tmp_path / "summary.json"
    data = {
        "crossovers": np.int64(59),
        "load_n": np.array([0.5, np.inf]),
        "energy_j": {"tension": np.float32(0.25), "shear": float("nan")},
        "ok": np.bool_(True),
        "folder": tmp_path,
        "title": "45° specimen",
        "pair": (1, None),
    }
    write_json(COMM, path, data)
    assert json.loads(path.read_text(encoding="utf-8")) == {
        "crossovers": 59,
        "load_n": [0.5, None],
        "energy_j": {"tension": 0.25, "shear": None},
        "ok": True,
        "folder": str(tmp_path),
        "title": "45° specimen",
        "pair": [1, None],
    }
    assert [p.name for p in tmp_path.iterdir()] == ["summary.json"]


def test_places_that_cannot_be_written(tmp_path, result):
    """One sentence that names the file, whatever is written; nothing is left behind."""
    write_json(COMM, tmp_path / "file", {})
    (tmp_path / "folder").mkdir()
    for place in ("none/x", "file/x", "folder"):
        path = tmp_path / place
        for attempt in (
            lambda path=path: write_json(COMM, path, {}),
            lambda path=path: write_csv(COMM, path, {"a": [1]}),
            lambda path=path: pictures.load_against_extension(COMM, path, [1.0], [1.0]),
            lambda path=path: write_state(path, result),
            lambda path=path: write_series(path, result),
        ):
            with pytest.raises(InputError, match=f'"{path}" cannot be written: .'):
                attempt()
    assert {p.name for p in tmp_path.iterdir()} == {"file", "folder"}


def test_failure_half_way_keeps_the_old_file(tmp_path):
    """Also when the disk is full."""
    path = tmp_path / "x.txt"
    path.write_text("old")

    def write(problem):
        with written_whole(path) as temporary:
            temporary.write_text("half of the n")
            raise problem

    with pytest.raises(InputError, match="No space left"):
        write(OSError(28, "No space left on device"))
    with pytest.raises(KeyError):
        write(KeyError("x"))
    assert path.read_text() == "old"
    assert [p.name for p in tmp_path.iterdir()] == ["x.txt"]


# -- ParaView --------------------------------------------------------------------------------------


def test_vtk_reads_the_network(tmp_path, result):
    """Counts, connectivity, bounds and values, against the network's own arrays."""
    network, fields, moved = result.network, result.fields, result.node_displacement
    path = tmp_path / "network.vtkhdf"
    write_state(path, result, {"title": "45° strip", "extension_m": 1e-3})
    points, lines, point, cell = read_vtkhdf(path)

    n = network.num_crossovers_owned
    ends = ~network.node_is_hinge
    has_arm = network.arm_length > 0
    assert len(points) == n + ends.sum()
    assert len(lines) == has_arm.sum()
    assert (lines[:, 0] < n).all()
    assert (lines[:, 1] >= n).all()
    assert point["crossover"].tolist() == list(range(n)) + [-1] * ends.sum()
    # An arm end joins two crossovers, or is where a yarn meets the outline.
    times = np.bincount(lines[:, 1], minlength=len(points))[n:]
    assert set(times) == {1, 2}
    assert (times == 2).sum() == network.arm_is_shared.sum() / 2
    shared = np.zeros(network.num_nodes_local, bool)
    shared[network.arm_node[network.arm_is_shared]] = True
    np.testing.assert_array_equal(times == 2, shared[point["node"][n:]])

    before = points - point["displacement"]
    length = np.linalg.norm(np.diff(before[lines], axis=1)[:, 0], axis=1)
    np.testing.assert_allclose(length, network.arm_length[has_arm], rtol=1e-9)
    np.testing.assert_allclose(before[:n, :2], network.crossover_position, atol=1e-15)
    np.testing.assert_allclose(points[:, 2], 0.0)
    x = np.concatenate([network.node_position + moved, before[:n, :2] + fields["displacement"]])
    np.testing.assert_allclose(points[:, :2].min(axis=0), x.min(axis=0), atol=1e-15)
    np.testing.assert_allclose(points[:, :2].max(axis=0), x.max(axis=0), atol=1e-15)
    assert points[:, 1].max() == pytest.approx(0.081)

    e, arm = np.nonzero(has_arm)
    family = arm % 2
    assert cell["yarn_family"].tolist() == family.tolist()
    tension = np.where(family == 0, fields["warp_tension"][e], fields["weft_tension"][e])
    shear = np.rad2deg(fields["shear_angle"])
    for name, expected in (
        ("tension", tension),
        ("strain", fields["arm_strain"][e, arm]),
        ("shear_angle_deg", shear[e]),
        ("crossover", e),
    ):
        np.testing.assert_allclose(cell[name], expected, rtol=1e-6, atol=1e-9, err_msg=name)
    np.testing.assert_allclose(point["shear_angle_deg"][:n], shear, rtol=1e-6, atol=1e-9)
    for name in ENERGIES:
        assert cell[name].sum() == pytest.approx(fields[name].sum(), rel=1e-5), name
    # At an arm end: the mean of the crossovers whose arms end there.
    node = np.flatnonzero(times == 2)[7] + n
    expected = cell["shear_angle_deg"][lines[:, 1] == node].mean()
    assert point["shear_angle_deg"][node] == pytest.approx(expected, rel=1e-5)
    with h5py.File(path) as file:
        attributes = file["VTKHDF"].attrs
        assert attributes["title"].decode() == "45° strip"
        assert attributes["extension_m"] == 1e-3


@pytest.fixture(scope="module")
def curve():
    """The same strip at finite deformation, twice."""
    network = Network(COMM, Preform.rectangle("40 mm", "80 mm", holes=[CIRCLE[:-1]]), TABLE_1)
    return BiasExtension(network, extension=["2 mm", "6 mm"], finite=True).solve()


def test_vtk_reads_a_series(tmp_path, curve):
    """Each state, from rest on, is what a file of its own has; time is the extension in mm."""
    path = tmp_path / "series.vtkhdf"
    write(curve, path)
    assert times_of(path) == pytest.approx((0.0, 2.0, 6.0))
    for index, time in enumerate((2.0, 6.0)):
        single = tmp_path / "single.vtkhdf"
        write_state(single, curve, index=index)
        of_series, of_single = read_vtkhdf(path, time), read_vtkhdf(single)
        for a, b in zip(of_series[:2], of_single[:2], strict=True):
            np.testing.assert_array_equal(a, b)
        for a, b in zip(of_series[2:], of_single[2:], strict=True):
            assert a.keys() == b.keys()
            for name in a:
                np.testing.assert_array_equal(a[name], b[name], err_msg=name)
    points, _, point, cell = read_vtkhdf(path, 0.0)
    network = curve.network
    n = network.num_crossovers_owned
    np.testing.assert_allclose(points[:n, :2], network.crossover_position, atol=1e-15)
    assert not point["displacement"].any()
    assert not any(cell[name].any() for name in (*ENERGIES, "shear_angle_deg", "tension"))
    assert cell["carrying"].all()
    with h5py.File(path) as file:
        assert file["VTKHDF"].attrs["time_is"].decode() == "extension_mm"
        # What does not change is there once.
        assert len(file["VTKHDF/CellData/yarn_family"]) == len(cell["yarn_family"])


def test_series_that_turns_back(tmp_path, curve):
    """VTK wants ascending times: then they are the numbers of the states."""
    path = tmp_path / "series.vtkhdf"
    write_series(path, replace(curve, states=curve.states[::-1]))
    assert times_of(path) == (0.0, 1.0, 2.0)
    points, *_ = read_vtkhdf(path, 2.0)
    assert points[:, 1].max() == pytest.approx(0.082)
    with h5py.File(path) as file:
        assert file["VTKHDF"].attrs["time_is"].decode() == "state"
        assert file["VTKHDF"].attrs["controls"].tolist() == pytest.approx([0.0, 6.0, 2.0])


# -- samples ---------------------------------------------------------------------------------------


def lengths(sample):
    """Length of each polyline before the deformation."""
    lines = np.split(sample.before, sample.first[1:])
    return np.array([np.linalg.norm(np.diff(line, axis=0), axis=1).sum() for line in lines])


def test_whole_yarns(result, sample):
    """All arms of a small network, as straight yarns, in two pieces where the hole cuts them."""
    network = result.network
    assert sample.every == 1
    assert lengths(sample).sum() == pytest.approx(network.arm_length.sum(), rel=1e-12)
    parts = [(y.last >= y.first).sum() for y in (network.warp_yarns, network.weft_yarns)]
    assert np.bincount(sample.family[sample.first]).tolist() == parts
    assert sum(parts) > len(np.unique(network.warp_yarns.line)) + len(
        np.unique(network.weft_yarns.line)
    )
    step = np.diff(sample.before[sample.segment], axis=1)[:, 0]
    axes = network.preform.rotation[sample.family[sample.segment[:, 0]]]
    along = np.einsum("si,si->s", step, axes)
    np.testing.assert_allclose(along, np.linalg.norm(step, axis=1), rtol=1e-9)
    assert sample.after()[:, 1].max() == pytest.approx(0.081)
    np.testing.assert_allclose(
        sample.after(3.0) - sample.before, 3.0 * (sample.after() - sample.before), atol=1e-15
    )
    assert np.nanmax(sample.shear_angle_deg) == pytest.approx(np.rad2deg(result.shear_angle_max))


def test_every_kth_yarn(result):
    """Of a larger network some yarns are taken, from end to end, within the limit."""
    network = result.network
    sample = sample_yarns(network, result.node_displacement, result.fields, limit=60)
    assert sample.every > 2
    assert sample.spacing == pytest.approx(sample.every * network.pitch[0])
    for family, yarns in enumerate((network.warp_yarns, network.weft_yarns)):
        mine = sample.family[sample.first] == family
        taken = (yarns.line % sample.every == 0) & (yarns.last >= yarns.first)
        expected = (yarns.end - yarns.start)[taken] * network.pitch[family]
        np.testing.assert_allclose(np.sort(lengths(sample)[mine]), np.sort(expected), rtol=1e-9)
        points = (sample.family == family).sum()
        assert points <= 60 + 2 * mine.sum()


def test_what_carries_nothing_has_no_angle(result):
    """Nor does it spoil the means of its neighbours."""
    fields = dict(result.fields, carrying=result.fields["carrying"].copy())
    regular = np.delete(np.arange(len(fields["carrying"])), result.network.boundary_crossovers)
    fields["carrying"][regular[50]] = False
    sample = sample_yarns(result.network, result.node_displacement, fields)
    assert np.isnan(sample.shear_angle_deg).sum() == 2  # once on each of its yarns


def test_map_of_all_cells(result):
    network = result.network
    shear = np.rad2deg(result.fields["shear_angle"])
    sample = sample_map(network, {"shear": shear, "y": network.crossover_position[:, 1]})
    np.testing.assert_allclose(sample.centre, network.crossover_position, atol=1e-12)
    np.testing.assert_allclose(sample.values["y"], sample.centre[:, 1], atol=1e-12)
    np.testing.assert_allclose(sample.values["shear"], shear)
    assert sample.at_outline.sum() == len(network.boundary_crossovers)
    area = shapely.area(shapely.polygons(sample.cells()))
    np.testing.assert_allclose(area, network.pitch.prod())
    assert len(sample.outline) == 2


def test_map_of_blocks(result):
    """Means over blocks: a linear field has its value at the centre of a full block."""
    network = result.network
    x = network.crossover_position[:, 0].copy()
    x[5] = np.nan
    sample = sample_map(network, {"x": x, "none": np.full(len(x), np.nan)}, limit=80)
    assert 20 < len(sample.centre) <= 80
    inner = ~sample.at_outline
    assert inner.sum() > 5
    np.testing.assert_allclose(sample.values["x"][inner], sample.centre[inner, 0], atol=1e-12)
    assert np.isfinite(sample.values["x"]).all()
    assert np.isnan(sample.values["none"]).all()
    side = np.linalg.norm(sample.sides, axis=1) / network.pitch
    assert side == pytest.approx(round(side[0]))


# -- pictures --------------------------------------------------------------------------------------


def pixels(path):
    """Read a picture; float (height, width, 3) on white."""
    image = pytest.importorskip("matplotlib.image").imread(path)
    assert path.read_bytes()[:4] == b"\x89PNG"
    return image[..., :3]


def coloured(image):
    """Where a picture has colour, not black, white or grey."""
    return np.ptp(image, axis=2) > 0.25


def test_pictures_of_yarns(tmp_path, result, sample):
    """Drawn to scale: the specimen is twice as tall as it is wide, and coloured."""
    preform = result.network.preform
    clamps = [(preform.edge("lower"), (0.0, 0.0)), (preform.edge("upper"), (0.0, 1e-3))]
    path = tmp_path / "yarns.png"
    pictures.yarns_before_and_after(COMM, path, sample, "1 mm", clamps=clamps)
    colour = coloured(pixels(path))
    columns = np.flatnonzero(colour.any(axis=0))
    gap = np.flatnonzero(np.diff(columns) > 15)[0]  # between the specimen and the colour bar
    left, right = columns[0], columns[gap]
    rows = np.flatnonzero(colour[:, left:right].any(axis=1))
    assert np.ptp(rows) / (right - left) == pytest.approx(81 / 40, rel=0.05)

    both = tmp_path / "bending.png"
    pictures.with_and_without_bending(COMM, both, sample, sample, clamps=clamps, scale=2.0)
    assert pixels(both).shape[1] > 1.4 * pixels(path).shape[1]


def test_maps_leave_holes_empty(tmp_path, result):
    """One map, then two with their difference; the hole is paper, the cloth around it is not."""
    network = result.network
    shear = np.rad2deg(result.fields["shear_angle"])
    sample = sample_map(network, {"network": shear, "membrane": shear + 0.1})
    path = tmp_path / "map.png"
    pictures.shear_maps(COMM, path, sample, ("network",))
    image = pixels(path)
    columns = np.flatnonzero(coloured(image).any(axis=0))
    right = columns[np.flatnonzero(np.diff(columns) > 15)[0]]
    rows = np.flatnonzero(coloured(image)[:, columns[0] : right].any(axis=1))
    middle = (rows[0] + rows[-1]) // 2, (columns[0] + right) // 2
    width = right - columns[0]
    assert image[middle].min() == 1.0
    hole = image[middle[0] - width // 6 : middle[0] + width // 6, middle[1]]
    assert hole.min() == 1.0
    for up, across in ((0.0, 0.4), (0.0, -0.4), (0.5, 0.0), (-0.5, 0.3)):
        at = int(middle[0] - up * width), int(middle[1] + across * width)
        assert image[at].min() < 0.9, (up, across)
    pictures.shear_maps(COMM, path, sample, title="a title")
    assert pixels(path).shape[1] > 2 * image.shape[1]


def texts_of(draw, monkeypatch):
    """All texts of a picture, and its axes."""
    kept = []
    monkeypatch.setattr(pictures, "_save", lambda comm, path, make: kept.append(make()))
    draw()
    (figure,) = kept
    return [text.get_text() for text in figure.findobj(Text)], figure.axes


def test_bars_have_zero_below(tmp_path, result, monkeypatch):
    """Also where all values are negative; a map by itself is headed by the title."""
    shear = np.rad2deg(result.fields["shear_angle"])
    for sign in (1.0, -1.0):
        found = sample_map(result.network, {"network": sign * np.abs(shear)})
        texts, axes = texts_of(
            lambda found=found: pictures.shear_maps(COMM, "", found, ("network",), "a test"),
            monkeypatch,
        )
        assert axes[-1].get_ylim()[0] == 0.0
        assert "a test" in texts
        assert "Network" not in texts


def test_uniform_values_are_told():
    """To 1e-6 of their size; rounding is none."""
    angle, bent = np.full(5, 20.0), np.linspace(20.0, 20.1, 5)
    assert figures._uniform(COMM, "Angle", {"a": angle}, 1e-6, " deg") == "Angle: uniform, 20 deg."
    assert figures._uniform(COMM, "Angle", {"a": angle, "b": bent}, 1e-6, " deg") is None
    noise = {"warp": 1e-15 * bent, "weft": 3.0 + 0.0 * angle}
    assert figures._uniform(COMM, "T", noise, 1e-9, " N") == "T: uniform, warp 0 N, weft 3 N."


def test_stages(tmp_path, curve):
    """Side by side in true scale: the upper clamp stands higher in each, colours are shared."""
    clamps = figures._clamps(curve, curve.states[1])
    assert [round(1e3 * np.ptp(motion), 9) for _, motion in clamps] == [0.0, 6.0]
    figures.draw_stages(tmp_path / "stages.png", curve, "two stages")
    image = pixels(tmp_path / "stages.png")
    single = pixels_of(tmp_path, curve)
    assert image.shape[1] > 1.5 * single.shape[1]
    dark = image.min(axis=2) < 0.3
    # The clamps' lines: rows that are dark for a third of a panel; the upper ones differ.
    half = image.shape[1] // 2
    rows = [
        np.flatnonzero(part.sum(axis=1) > 0.2 * half) for part in np.hsplit(dark[:, : 2 * half], 2)
    ]
    assert rows[1].min() < rows[0].min()


def pixels_of(tmp_path, result):
    """A picture of the last state alone."""
    figures.plot(result, tmp_path / "one.png")
    return pixels(tmp_path / "one.png")


def test_curves(tmp_path):
    """Every kind of curve, also of a single value, and with gaps."""
    load = [0.1, 0.2, 0.3]
    pictures.shear_against_load(
        COMM, tmp_path / "a.png", load, [1.0, 2.0, 3.0], others={"measured": (load, [1, 2, 2.5])}
    )
    pictures.load_against_extension(COMM, tmp_path / "b.png", [1.0], [0.3], title="one value")
    curves = {"network": ([1.0, 2, 3, 9, 10], [0.0, 1, 2, 2, 1]), "membrane": ([5.0], [1.0])}
    pictures.shear_along_centre_line(COMM, tmp_path / "c.png", curves)
    pictures.convergence(
        COMM, tmp_path / "d.png", [59, 213, 809], {"load": [0.04, 0.02, 0.01]}, orders=(1, 2)
    )
    pictures.zones(
        COMM, tmp_path / "e.png", {"middle": ([1.0, 2], [5.0, 9])}, {"": ([0, 2], [0, 8])}
    )
    parts = {"shear": np.array([1.0, 4.0]), "tension": np.array([0.5, 1.0])}
    pictures.load_against_extension(
        COMM, tmp_path / "f.png", [1.0, 2.0], [0.3, 0.9],
        marks=([2.0], [0.9]), points={"membrane": ([2.0], [0.8])},
    )  # fmt: skip
    pictures.curves(COMM, tmp_path / "g.png", {"warp": ([1.0], [2.0])}, ("x", "y"))
    for name in "abcdefg":
        image = pixels(tmp_path / f"{name}.png")
        assert image.shape[0] > 500
        assert 500 < coloured(image).sum() < 0.1 * image.size, name
    assert len(list(tmp_path.iterdir())) == 7
    pictures.stacked(COMM, tmp_path / "h.png", np.array([1.0, 2.0]), parts, ("x (mm)", "mJ"))
    assert coloured(pixels(tmp_path / "h.png")).mean() > 0.1


def test_curves_start_at_the_origin():
    """Whichever way the test is driven, unless it goes through the origin anyway."""
    x, y = pictures.from_origin([2.0, 1.0], [20.0, 10.0])
    assert (x.tolist(), y.tolist()) == ([0, 1, 2], [0, 10, 20])
    x, y = pictures.from_origin(-1.0, -10.0)
    assert (x.tolist(), y.tolist()) == ([-1, 0], [-10, 0])
    x, y = pictures.from_origin([1.0, 3.0, 2.0], [10.0, 30.0, 15.0])
    assert (x.tolist(), y.tolist()) == ([0, 1, 3, 2], [0, 10, 30, 15])
    x, y = pictures.from_origin([-1, 1], [-3, 3])
    assert len(x) == 2


def test_curves_stop_at_a_hole():
    x, y = pictures._broken_at_gaps([1.0, 2, 3, 9, 10], [5.0, 6, 7, 8, 9])
    np.testing.assert_array_equal(x, [1, 2, 3, np.nan, 9, 10])
    np.testing.assert_array_equal(y, [5, 6, 7, np.nan, 8, 9])


@pytest.mark.parametrize(
    ("angles", "limits", "extend"),
    [
        ([[0.0, 2.0, 8.0]], (0, 8), "neither"),
        ([[-0.1, 8.0]], (0, 8), "neither"),
        ([[-8.0, 0.0], [-2.0]], (-8, 0), "neither"),
        ([[-4.0, 8.0]], (-8, 8), "neither"),
        ([[0.0, np.nan]], (0, 1), "neither"),
        ([[-2e-12, 1e-12]], (0, 1), "neither"),
        ([np.full(5000, 5.0), [90.0]], (0, 5), "max"),
    ],
)
def test_colour_scales(angles, limits, extend):
    """From zero, or about it; a single wild value does not stretch them."""
    norm, _, ends = pictures._angle_colours([np.array(a) for a in angles])
    assert (norm.vmin, norm.vmax) == limits
    assert ends == extend
