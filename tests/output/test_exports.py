# SPDX-License-Identifier: MIT
"""Yarn directions, thickness and fibre volume fraction for other programs, read back."""

import csv
import logging
from dataclasses import replace

import numpy as np
import pytest
from mpi4py import MPI
from support.exported import WEIGHED, moved, read_input_file, read_table
from support.helpers import PITCH, UNEVEN, l_shape

from cruciform_petsc import BiasExtension, Case, Fabric, InputError, Network, PictureFrame, Preform
from cruciform_petsc.output.abaqus import weft_angle_deg
from cruciform_petsc.output.exports import export
from cruciform_petsc.run import run_case

COMM = MPI.COMM_SELF
HEAVY_UNEVEN = replace(UNEVEN, areal_density=0.3, fibre_density=1780.0, thickness=0.4e-3)
# Ten digits are written, of numbers around 1 or 100.
DIGITS = {"rtol": 1e-9, "atol": 1e-9}
GRADIENT = np.array([[1.05, 0.35], [-0.1, 0.93]])


def square(cells: float, holes=(), fabric=WEIGHED) -> Network:
    """Yarns of Table 1 along the sides, the outermost ones a quarter of a pitch inside."""
    side = (cells + 0.5) * PITCH
    origin = ((0.25 + np.floor(cells / 2)) * PITCH - 0.5 * side, 0.25 * PITCH)
    preform = Preform.rectangle(side, side, "90 deg", origin=origin, holes=holes)
    return Network(COMM, preform, fabric)


def between(weft: float, warp: float, across: float, along: float) -> list:
    """A rectangular hole of a square(...) around a place on the lattice, sizes in pitches."""
    x = (weft - 1) * PITCH + np.array([-0.5, 0.5, 0.5, -0.5]) * across * PITCH
    y = (warp + 0.25) * PITCH + np.array([-0.5, -0.5, 0.5, 0.5]) * along * PITCH
    return np.column_stack([x, y]).tolist()


@pytest.mark.parametrize("hold", ["fibre volume fraction", "thickness"])
def test_affine_motion(tmp_path, hold):
    """With x = F X everything is known: area ratio det F, directions F e/|F e|, everywhere."""
    preform = Preform.polygon(list(l_shape(0.06, 0.0).outline.exterior.coords)[:-1], [], "30 deg")
    network = Network(COMM, preform, HEAVY_UNEVEN)
    result = moved(network, GRADIENT)
    table, deck = (
        read(path)
        for read, path in zip(
            (read_table, read_input_file), export(result, tmp_path, hold=hold), strict=True
        )
    )
    n = network.num_crossovers_owned
    assert table["crossover"].tolist() == list(range(n))
    rest = 1e3 * network.crossover_position
    np.testing.assert_allclose(np.column_stack([table["x_rest_mm"], table["y_rest_mm"]]), rest,
                               **DIGITS)  # fmt: skip
    now = rest @ GRADIENT.T
    np.testing.assert_allclose(np.column_stack([table["x_mm"], table["y_mm"]]), now, **DIGITS)

    determinant = np.linalg.det(GRADIENT)
    warp, weft = (GRADIENT @ axis for axis in network.preform.rotation)
    angle = np.arctan2(weft[1], weft[0]) - np.arctan2(warp[1], warp[0])
    thick, fraction = 0.4, 0.3 / (1780.0 * 0.4e-3)
    if hold == "thickness":
        fraction /= determinant
    else:
        thick /= determinant
    for name, value in {
        "warp_x": warp[0] / np.hypot(*warp),
        "warp_y": warp[1] / np.hypot(*warp),
        "weft_x": weft[0] / np.hypot(*weft),
        "weft_y": weft[1] / np.hypot(*weft),
        "shear_deg": 90.0 - np.rad2deg(angle),
        "area_ratio": determinant,
        "areal_density_g_per_m2": 300.0 / determinant,
        "thickness_mm": thick,
        "fibre_volume_fraction": fraction,
        "warp_tension_N_per_mm": np.hypot(*warp) - 1.0,
        "weft_tension_N_per_mm": np.hypot(*weft) - 1.0,
        "carrying": 1.0,
    }.items():
        np.testing.assert_allclose(table[name], value, **DIGITS, err_msg=name)
    # Whatever is held, the fibres' volume per area at rest is the same.
    volume = table["fibre_volume_fraction"] * table["thickness_mm"] * table["area_ratio"]
    np.testing.assert_allclose(volume, 0.3 / 1.780, **DIGITS)

    assert list(deck.node) == list(range(1, n + 1))
    np.testing.assert_allclose(list(deck.node.values()), np.pad(now, ((0, 0), (0, 1))), atol=1e-6)
    assert list(deck.element) != []
    size = np.array([*warp / np.hypot(*warp), 0.0, *weft / np.hypot(*weft), 0.0])
    degrees = np.rad2deg(angle)
    for name, value, default in (
        ("YARN_AXES", size, [1, 0, 0, 0, 1, 0]),
        ("WEFT_ANGLE", [degrees if degrees <= 90.0 else degrees - 180.0], [90]),
        ("THICKNESS", [thick], [0.4]),
    ):
        values = deck.distribution[name]
        assert values.pop(None).tolist() == default
        assert sorted(values) == sorted(deck.element)
        np.testing.assert_allclose(list(values.values()), np.tile(value, (len(values), 1)),
                                   rtol=1e-7, atol=1e-8, err_msg=name)  # fmt: skip
    assert deck.field[1] == pytest.approx(dict.fromkeys(deck.node, 90.0 - degrees), rel=1e-7)
    assert deck.field[2] == pytest.approx(dict.fromkeys(deck.node, fraction), rel=1e-7)


def test_one_cell_by_hand(tmp_path):
    """A square of Table 1's cloth, 2 x 2 crossovers, sheared by 30 degrees: numbers by hand."""
    shear = np.array([[1.0, 0.5], [0.0, np.sqrt(0.75)]])  # warp stays, weft turns to 60 degrees
    network = square(1)
    csv_file, inp = export(moved(network, shear), tmp_path)
    with csv_file.open() as file:
        rows = list(csv.DictReader(file))
    assert len(rows) == 4
    row = {name: float(value) for name, value in rows[3].items()}
    assert row["crossover"] == 3
    assert row["shear_deg"] == pytest.approx(30.0, rel=1e-9)
    assert row["area_ratio"] == pytest.approx(0.866025403784, rel=1e-9)
    assert row["areal_density_g_per_m2"] == pytest.approx(665.107510, rel=1e-8)  # 576/0.866
    assert row["thickness_mm"] == pytest.approx(0.577350269, rel=1e-8)  # 0.5/0.866
    assert row["fibre_volume_fraction"] == pytest.approx(0.4608, rel=1e-9)
    assert (row["warp_x"], row["warp_y"]) == pytest.approx((1.0, 0.0), abs=1e-9)
    assert (row["weft_x"], row["weft_y"]) == pytest.approx((0.5, 0.866025403784), rel=1e-9)
    deck = read_input_file(inp)
    assert deck.element == {1: [1, 2, 4, 3]}
    assert deck.kind == {1: "S4R"}
    assert deck.distribution["WEFT_ANGLE"][1] == pytest.approx([60.0], rel=1e-8)
    sections = [(options, data) for name, options, data in deck.keywords if name == "SHELL SECTION"]
    assert sections == [
        (
            {"ELSET": "CLOTH", "COMPOSITE": "", "ORIENTATION": "YARNS",
             "SHELL THICKNESS": "THICKNESS"},
            [["0.25", "3", "WARP_LAYER", "0.", "WARP"],
             ["0.25", "3", "WEFT_LAYER", "WEFT_ANGLE", "WEFT"]],
        )
    ]  # fmt: skip
    materials = [options["NAME"] for name, options, _ in deck.keywords if name == "MATERIAL"]
    assert materials == ["WARP_LAYER", "WEFT_LAYER"]


def test_which_cells(tmp_path):
    """3 x 3 crossovers, numbered along the warp, with and without a hole."""

    def elements(*holes):
        folder = tmp_path / str(len(list(tmp_path.iterdir())))
        deck = read_input_file(export(moved(square(2, holes), np.eye(2)), folder)[1])
        assert all(deck.kind[e] == ("S4R" if len(c) == 4 else "S3R")
                   for e, c in deck.element.items())  # fmt: skip
        return [deck.element[e] for e in sorted(deck.element)]

    whole = [[1, 2, 5, 4], [2, 3, 6, 5], [4, 5, 8, 7], [5, 6, 9, 8]]
    assert elements() == whole
    # A hole within a cell cuts no yarn; one between crossovers cuts a piece of yarn, and both
    # cells beside it are none; one around the middle crossover leaves four triangles.
    assert elements(between(0.5, 0.5, 0.2, 0.2)) == whole
    assert elements(between(1.0, 0.5, 0.2, 0.2)) == whole[2:]
    assert elements(between(1.0, 1.0, 0.2, 0.2)) == [[1, 2, 4], [2, 3, 5], [4, 7, 6], [5, 8, 7]]
    # A triangle needs both legs.
    holes = between(1.0, 1.0, 0.2, 0.2), between(0.5, 0.0, 0.2, 0.2)
    assert elements(*holes) == [[2, 3, 5], [4, 7, 6], [5, 8, 7]]


def test_picture_frame(tmp_path):
    """A frame shears uniformly: thickness 1/cos of the shear angle, weft at 90 degrees less it."""
    network = square(6)
    result = PictureFrame(network, angle=["20 deg", "40 deg"], finite=True).solve()
    for index, degrees in ((0, 20.0), (-1, 40.0)):
        paths = export(result, tmp_path, index)
        table, deck = read_table(paths[0]), read_input_file(paths[1])
        # Newton stops at 1e-8 or so of the forces.
        np.testing.assert_allclose(table["shear_deg"], degrees, rtol=1e-6)
        np.testing.assert_allclose(
            table["thickness_mm"], 0.5 / np.cos(np.deg2rad(degrees)), rtol=1e-6
        )
        between_yarns = table["warp_x"] * table["weft_x"] + table["warp_y"] * table["weft_y"]
        np.testing.assert_allclose(between_yarns, np.sin(np.deg2rad(degrees)), rtol=1e-6)
        assert len(deck.element) == 36
        for element in deck.element:
            np.testing.assert_allclose(
                deck.distribution["WEFT_ANGLE"][element], 90.0 - degrees, rtol=1e-6
            )
            np.testing.assert_allclose(
                deck.distribution["THICKNESS"][element],
                0.5 / np.cos(np.deg2rad(degrees)),
                rtol=1e-6,
            )


@pytest.fixture(scope="module")
def pulled():
    """A strip at 45 degrees pulled by an eighth of its length."""
    preform = Preform.rectangle("24 mm", "48 mm", "45 deg")
    return BiasExtension(Network(COMM, preform, WEIGHED), extension="6 mm", finite=True).solve()


def test_bias_extension(tmp_path, pulled):
    """Elements fit what the crossovers say, lie in their zones, and conserve the cloth's volume."""
    paths = export(pulled, tmp_path)
    table, deck = read_table(paths[0]), read_input_file(paths[1])
    np.testing.assert_allclose(
        table["shear_deg"], np.rad2deg(pulled.fields["shear_angle"]), **DIGITS
    )
    np.testing.assert_allclose(
        table["warp_tension_N_per_mm"], 1e-3 * pulled.fields["warp_tension"], **DIGITS
    )
    unit = np.hypot(table["warp_x"], table["warp_y"])
    np.testing.assert_allclose(unit, 1.0, **DIGITS)

    volume = 0.0
    for element, corner in deck.element.items():
        place = np.array([deck.node[n][:2] for n in corner])
        x, y = place.T
        area = 0.5 * (x @ np.roll(y, -1) - y @ np.roll(x, -1))
        assert area > 0.0  # anticlockwise: the normal is z
        volume += area * deck.distribution["THICKNESS"][element][0]
        # The angle between the yarns of a cell: about the mean of its crossovers'.
        angle = 90.0 - deck.distribution["WEFT_ANGLE"][element][0]
        angles = [deck.field[1][n] for n in corner]
        assert min(angles) - 1.5 < angle < max(angles) + 1.5
    triangles = sum(len(corner) == 3 for corner in deck.element.values())
    cells = len(deck.element) - 0.5 * triangles
    # 9 digits are written of each.
    assert volume == pytest.approx(cells * 0.5 * (1e3 * PITCH) ** 2, rel=1e-7)

    zone = dict(enumerate(pulled.zones, 1))
    for number, name in enumerate(("MIDDLE", "SIDE", "CLAMP")):
        inside = [e for e, c in deck.element.items() if {zone[n] for n in c} == {number}]
        assert sorted(deck.sets[name]) == sorted(inside) != []
    # The middle is sheared most and thickest.
    thick = [deck.distribution["THICKNESS"][e][0] for e in deck.sets["MIDDLE"]]
    rest = [deck.distribution["THICKNESS"][e][0] for e in deck.sets["CLAMP"]]
    assert np.mean(thick) > 0.52 > np.mean(rest)


def test_meshio_reads_it(tmp_path, pulled):
    """A reader that others have written finds the same mesh."""
    meshio = pytest.importorskip("meshio")
    path = export(pulled, tmp_path)[1]
    mesh, deck = meshio.read(path), read_input_file(path)
    np.testing.assert_array_equal(mesh.points, list(deck.node.values()))
    for kind, cells in mesh.cells_dict.items():
        size = {"quad": 4, "triangle": 3}[kind]
        mine = [corner for corner in deck.element.values() if len(corner) == size]
        np.testing.assert_array_equal(cells + 1, mine)
    assert {"CLOTH", "MIDDLE", "SIDE", "CLAMP"} <= set(mesh.cell_sets)


def test_fabric_without_the_data(tmp_path):
    """What is not known is an empty field, and no thickness is made up."""
    bare = replace(WEIGHED, areal_density=None, fibre_density=None, thickness=None,
                   name="two\nlines, ü")  # fmt: skip
    network = square(2, fabric=bare)
    paths = export(moved(network, GRADIENT), tmp_path)
    with paths[0].open() as file:
        for row in csv.DictReader(file):
            empty = [name for name, value in row.items() if value == ""]
            assert empty == ["areal_density_g_per_m2", "thickness_mm", "fibre_volume_fraction"]
    text, deck = paths[1].read_text(encoding="ascii"), read_input_file(paths[1])
    assert "two lines, ?" in text
    assert "thickness at rest was not given" in text
    names = {name for name, _, _ in deck.keywords}
    assert not names & {"SHELL SECTION", "MATERIAL"}
    assert set(deck.distribution) == {"YARN_AXES", "WEFT_ANGLE"}
    assert set(deck.field) == {1}
    assert "nan" not in text


def test_crossovers_that_carry_nothing(tmp_path):
    """They turn with their arms, and are in no element."""
    turn = np.array([[0.0, -1.0], [1.0, 0.0]])
    paths = export(moved(square(2), turn, loose=[8]), tmp_path)
    table, deck = read_table(paths[0]), read_input_file(paths[1])
    np.testing.assert_allclose(table["warp_y"], 1.0, **DIGITS)
    np.testing.assert_allclose(table["weft_x"], -1.0, **DIGITS)
    assert table["carrying"].tolist() == [1.0] * 8 + [0.0]
    assert all(9 not in corner for corner in deck.element.values())
    assert len(deck.element) == 3


def test_directions_are_those_at_the_hinge(tmp_path):
    """As the shear angle is; here but two arms lead there, 1 and 2, then 2 and 3."""
    network = square(2)
    result = moved(network, np.eye(2))
    turn = np.deg2rad([10.0, 2.0, 30.0, 4.0])
    for row, leads in ((0, [1, 1, 0, 0]), (1, [0, 1, 1, 0])):
        result.supports.hinge_share[row] = leads
        result.fields["arm_rotation"][network.boundary_crossovers[row]] = turn
    table = read_table(export(result, tmp_path)[0])
    for row, warp in ((0, 10.0), (1, 30.0)):
        k = network.boundary_crossovers[row]
        angle = np.rad2deg(np.arctan2(table["warp_y"][k], table["warp_x"][k]))
        assert angle == pytest.approx(warp, rel=1e-8)
        assert table["shear_deg"][k] == pytest.approx(warp - 2.0, rel=1e-8)


def test_small_displacements(tmp_path):
    """The same columns, to first order."""
    result = BiasExtension(square(6), extension="0.1 mm", finite=False).solve()
    table = read_table(export(result, tmp_path)[0])
    shear = result.fields["shear_angle"]
    np.testing.assert_allclose(table["shear_deg"], np.rad2deg(shear), **DIGITS)
    strain = result.fields["warp_strain"] + result.fields["weft_strain"]
    order = np.abs(result.fields["arm_strain"]).max() + np.abs(shear).max()
    np.testing.assert_allclose(table["area_ratio"], 1.0 + strain, atol=order**2)


def test_weft_angle_is_that_of_an_axis():
    """Abaqus takes angles of layers from -90 to 90 degrees; fibres have no sense."""
    angle = np.deg2rad([10.0, 60.0, 90.0, 100.0, 150.0])
    warp = np.tile([1.0, 0.0, 0.0], (5, 1))
    weft = np.column_stack([np.cos(angle), np.sin(angle), 0.0 * angle])
    weft[2] = 0.0, 1.0, 0.0
    np.testing.assert_allclose(weft_angle_deg(warp, weft), [10, 60, 90, -80, -30], rtol=1e-12)


def test_network_without_cells(tmp_path):
    """One crossover is no mesh; the files are there all the same."""
    preform = Preform.rectangle("4.2 mm", "4.2 mm", "0 deg")
    network = Network(COMM, preform, WEIGHED)
    assert network.num_crossovers_global == 1
    paths = export(moved(network, GRADIENT), tmp_path)
    assert len(read_table(paths[0])["crossover"]) == 1
    assert read_input_file(paths[1]).element == {}


@pytest.mark.parametrize("exports", [True, False])
def test_case_file(tmp_path, exports):
    """`[output] exports = true` puts both files beside the other results."""
    case = Case.from_data({
        "fabric": {"use": "e-glass-plain-2.4", "thickness": "0.5 mm"},
        "preform": {"outline": {"rectangle": ["24 mm", "36 mm"]}, "bias_angle": "45 deg"},
        "test": {"extension": ["0.5 mm", "1 mm"]},
        "output": {"pictures": False, "paraview": False, "exports": exports},
    })  # fmt: skip
    run_case(COMM, case, tmp_path, logging.getLogger("test"))
    files = {path.name for path in tmp_path.iterdir()} & {"crossovers.csv", "preform.inp"}
    assert len(files) == 2 * exports
    if exports:
        assert "extension_mm = 1\n" in (tmp_path / "preform.inp").read_text()
        assert read_table(tmp_path / "crossovers.csv")["thickness_mm"].min() > 0.4


def test_mistakes(tmp_path):
    result = moved(square(1), np.eye(2))
    with pytest.raises(InputError, match='hold must be "fibre volume fraction" or "thickness"'):
        export(result, tmp_path, hold="mass")
    for index in (1, -2):
        with pytest.raises(InputError, match=f"there are 1 states, index {index} is not one"):
            export(result, tmp_path, index)
    (tmp_path / "file").touch()
    with pytest.raises(InputError, match="a file is in its way"):
        export(result, tmp_path / "file")
    (tmp_path / "preform.inp").mkdir()
    with pytest.raises(InputError, match='preform.inp" cannot be written: a folder has that name'):
        export(result, tmp_path)
    assert sorted(path.name for path in tmp_path.iterdir()) == [
        "crossovers.csv", "file", "preform.inp",
    ]  # fmt: skip


def test_library_knows_what_was_published():
    """Table 1: 2 x 2.4 /cm x 1200 tex; its thickness was not published."""
    glass = Fabric.from_library("e-glass-plain-2.4")
    assert glass.areal_density == pytest.approx((glass.warp.yarns + glass.weft.yarns) * 1.2e-3)
    assert glass.fibre_density == pytest.approx(2500.0)
    assert glass.thickness is None
    mixed = Fabric.from_library("glass-pp-plain-1.93")
    assert (mixed.areal_density, mixed.thickness) == pytest.approx((0.743, 1.2e-3))
    assert mixed.fibre_volume_fraction is None
    given = Fabric.from_library("e-glass-plain-2.4", {"thickness": "0.5 mm"})
    assert given.fibre_volume_fraction == pytest.approx(0.4608)
