# SPDX-License-Identifier: MIT
"""Forming from a case file to results: where tools start, forces, files, what ends it early."""

import csv
import json
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from mpi4py import MPI
from support.forming import CASE, formed, written

from cruciform_petsc.case.schema import Case
from cruciform_petsc.cli import main
from cruciform_petsc.cloth.fabric import Fabric
from cruciform_petsc.cloth.preform import PreformTable
from cruciform_petsc.errors import InputError
from cruciform_petsc.forming.measures import DrawIn, penetration
from cruciform_petsc.forming.press import stage_number
from cruciform_petsc.net.network import Network
from cruciform_petsc.output.formed import frame_of

COMM = MPI.COMM_SELF
SYRUP = 'gravity = true\ncontact = { viscosity = "1e6 N s/m^3" }'
KEYS = {
    "stages", "tool_force_n", "shear_max_deg", "shear_p99_deg", "draw_in_mm", "penetration_max_mm",
    "energy_j", "contact", "crossovers", "dofs", "wall_s", "peak_mib_per_rank", "warnings",
}  # fmt: skip


@pytest.fixture(scope="module")
def cup(tmp_path_factory):
    return formed(COMM, written(tmp_path_factory.mktemp("cup")))


def test_tools_start_where_they_touch(cup):
    """The die's flat at z = 0, punch and holder a thickness above it."""
    forming, _ = cup
    places = {tool.name: tool.start.place for tool in forming.tools}
    np.testing.assert_allclose(places["die"], [0, 0, 0], atol=1e-12)
    np.testing.assert_allclose(places["holder"], [0, 0, 1e-3], atol=1e-12)
    # A crossover lies at the centre, where the pole of the punch is.
    np.testing.assert_allclose(places["punch"], [0, 0, 13e-3], atol=1e-9)
    assert max(map(abs, forming.gaps.values())) < 1e-9


def test_forces_balance_and_the_work_is_there(cup):
    """Tools' forces add up to none; the holder has its force; work is energy, roughly."""
    forming, result = cup
    last = result.steps[-1]
    assert np.linalg.norm(sum(last.tool_force.values())) < 1e-2
    assert last.tool_force["holder"][2] == pytest.approx(-5.0)
    assert last.tool_force["punch"][2] < -0.1
    assert [step.increment.asked for step in result.steps] == [True] * 3
    energies = last.increment.energies
    stored = sum(energies[mode] for mode in ("tension", "shear", "bending", "contact"))
    stored += energies["out_of_plane_bending"] + sum(last.spent.values())
    assert last.work == pytest.approx(stored, rel=0.5)
    drawn = DrawIn(forming.blank).largest(result.states[-1])
    assert list(drawn) == ["lower", "upper", "left", "right"]
    assert min(drawn.values()) > 0.3e-3
    assert max(drawn.values()) == pytest.approx(min(drawn.values()), rel=1e-3)  # symmetric
    assert 0.0 < penetration(forming.blank, result.states[-1]) < 0.6e-3


def test_draw_in_is_inwards_by_edge(cup):
    """Of a blank moved and squeezed by hand; a round outline is one edge."""
    forming, _ = cup
    blank = forming.blank
    state = blank.start()
    x = state.x.copy()
    x[blank.cloth_at] *= [0.9, 1.0, 1.0]
    x[blank.cloth_at] += [0.0, 1e-3, 0.0]
    drawn = DrawIn(blank).largest(state.moved(x - state.x))
    expected = {"lower": 1e-3, "upper": -1e-3, "left": 2.8e-3, "right": 2.8e-3}
    assert drawn == pytest.approx(expected, abs=1e-9)


@pytest.mark.parametrize(
    ("outline", "own", "told"),
    [
        ({"circle": "60 mm"}, {}, ["rim"]),
        ({"rectangle": ["60 mm", "80 mm"]}, {"grip": {"of": ["lower", "left"]}},
         ["lower", "upper", "left", "right", "grip"]),
        ({"slot": ["60 mm", "120 mm"]}, {}, ["left", "right", "arc-1", "arc-2"]),
        ({"ellipse": ["60 mm", "80 mm"]},
         {"a": {"start": ["0 mm", "0 mm"], "end": ["30 mm", "40 mm"]}}, ["rim", "a"]),
    ],
)  # fmt: skip
def test_edges_whose_draw_in_is_told(outline, own, told):
    """Arcs and edges of the user's by their names, each piece of the outline once more at most."""
    table = {"outline": outline, "bias_angle": "0 deg", "edges": own}
    preform = PreformTable.from_data(table, "preform").build().centred()
    network = Network(COMM, preform, Fabric.from_library("glass-pp-plain-1.93"))
    assert DrawIn(SimpleNamespace(network=network, symmetry=())).edges == told


def test_removed_tools_press_no_more(tmp_path):
    """Punch and holder are taken away: what is left is the die, and no force."""
    path = written(
        tmp_path, ('travel = { punch = ["0 mm", "0 mm", "-6 mm"] }', 'remove = ["punch", "holder"]')
    )
    forming, result = formed(COMM, path)
    for name in ("punch", "holder"):
        assert abs(result.steps[-1].tool_force[name]).max() < 1e-6
    assert penetration(forming.blank, result.states[-1]) < 0.1e-3


def test_a_tool_in_the_cloth_is_refused(tmp_path):
    place = 'shaft = true } }\nplace = ["0 mm", "0 mm", "10 mm"]'
    case = Case.load(written(tmp_path, ("shaft = true } }", place)))
    network = Network(COMM, case.preform(), case.fabric())
    deep = 'tool "punch" starts 3 mm deep in the cloth, at x = 0 mm, y = 0 mm: give it a place'
    with pytest.raises(InputError, match=deep):
        case.forming(network)
    aside = 'place = ["0 mm", "0 mm", "20 mm"]\nfriction = 0.2\n[[tool]]\nname = "holder"'
    case = Case.load(written(tmp_path, ('friction = 0.2\n[[tool]]\nname = "holder"', aside)))
    forming = case.forming(network)
    assert forming.gaps["punch"] == pytest.approx(7e-3, abs=1e-6)
    assert 'tool "punch", above the cloth, starts at 0 mm, 0 mm, 20 mm, 7 mm' in forming.check()[1]


def test_clearance_and_radii_are_remarked_on(tmp_path):
    """A punch of 13.5 mm in an opening of 14 mm leaves less than the cloth; a rim of 0.8 mm."""
    path = written(tmp_path, ('radius = "12 mm"', 'radius = "13.5 mm"'), ("-6 mm", "-20 mm"))
    case = Case.load(path)
    remarks = case.forming(Network(COMM, case.preform(), case.fabric())).remarks
    assert any('tool "punch" leaves 0.5 mm to tool "die", less than' in r for r in remarks)
    assert any('tool "holder" has radii down to' in remark for remark in remarks)
    assert any("wrinkles start from rounding" in remark for remark in remarks)


def test_run_and_check(tmp_path, capfd):
    """What a user types, and all that it leaves."""
    path, folder = written(tmp_path), tmp_path / "out"
    assert main(["check", str(path)]) == 0
    told = capfd.readouterr().out
    assert "crossovers and" in told
    assert 'tool "holder", above the cloth, starts at 0 mm, 0 mm, 1 mm, 0 mm from it' in told
    path.write_text(f"{CASE}[output]\npictures = false\n")
    assert main(["run", str(path), "--output", str(folder)]) == 0
    log = capfd.readouterr()
    assert log.err == ""
    assert f"if interrupted, continue with: cruciform-petsc resume {folder}" in log.out
    assert not (folder / "checkpoint").exists()
    assert "draw  100.0 %, punch" in log.out
    summary = json.loads((folder / "summary.json").read_text())
    assert set(summary) >= KEYS
    assert [stage["name"] for stage in summary["stages"]] == ["close", "draw"]
    assert [stage["steps"] for stage in summary["stages"]] == [1, 2]
    with (folder / "forces.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert [row["stage"] for row in rows] == ["close", "draw", "draw"]
    assert float(rows[-1]["punch_z_mm"]) == pytest.approx(7.0)
    assert float(rows[-1]["punch_force_z_N"]) == summary["tool_force_n"]["punch"][2]
    with (folder / "fields.csv").open() as file:
        fields = list(csv.DictReader(file))
    assert len(fields) == summary["crossovers"]
    shear = [abs(float(row["shear_deg"])) for row in fields if row["carrying"] == "1"]
    assert max(shear) == pytest.approx(summary["shear_max_deg"])
    warp = np.array([[float(row[f"warp_{a}"]) for a in "xyz"] for row in fields])
    np.testing.assert_allclose(np.linalg.norm(warp, axis=1), 1.0, atol=1e-9)
    middle = fields[len(fields) // 2]  # under the pole of the punch, where the cloth is a bowl
    value = {key: float(text) for key, text in middle.items() if text}
    assert value["x_rest_mm"] == value["y_rest_mm"] == pytest.approx(0.0, abs=1e-9)
    assert value["normal_z"] == pytest.approx(1.0, abs=1e-6)
    assert value["warp_curvature_per_m"] == pytest.approx(1 / 12.5e-3, rel=0.1)
    assert value["areal_density_g_per_m2"] == pytest.approx(576 / value["area_ratio"], rel=1e-8)
    assert "fibre_volume_fraction_at_constant_thickness" not in value  # without fibre_density
    assert 0.0 < max(float(row["slip_on_holder_mm"]) for row in fields) < 2.0
    # The net is too coarse for a fillet of one pitch: some crossovers there look like waves.
    assert 0.0 <= summary["wrinkles"]["area_share"] < 0.1
    assert summary["bridging"]["largest_gap_mm"] == 0.0
    assert np.linalg.norm(summary["tool_moment_n_m"]["punch"]) < 1e-3  # by symmetry
    with (folder / "outline.csv").open() as file:
        ends = list(csv.DictReader(file))
    assert len(ends) == 4 * 13  # of 13 warp and 13 weft yarns
    place = np.array([[float(row[key]) for key in ("x_rest_mm", "y_rest_mm")] for row in ends])
    assert np.isclose(abs(place).max(axis=1), 28.0).all()
    steps = np.linalg.norm(np.diff(place, axis=0), axis=1)
    assert steps.max() < 5.0  # in order along the outline, 4.17 mm apart
    drawn = 28.0 - min(abs(float(row["x_mm"])) for row in ends if float(row["x_rest_mm"]) > 27.9)
    assert drawn == pytest.approx(summary["draw_in_mm"]["right"])
    assert (folder / "outline.svg").read_text().count("<polyline") == 3  # blank, draw-in, warp
    assert {path.name for path in folder.iterdir() if path.suffix == ".vtkhdf"} == {
        "series.vtkhdf", "tools.vtkhdf",
    }  # fmt: skip


def test_pictures_and_report(tmp_path):
    """The page has what was formed, forces and draw-in; the picture in space where VTK can draw."""
    path, folder = written(tmp_path), tmp_path / "out"
    assert main(["run", str(path), "--output", str(folder), "--quiet"]) == 0
    drawn = {path.name for path in folder.glob("*.png")}
    assert drawn >= {"tool_forces.png", "draw_in.png", "energy.png"}
    assert drawn >= {"shear_map.png", "wrinkle_map.png"}  # flat, so without VTK too
    page = (folder / "report.html").read_text()
    words = ("Forming", "<h2>Part</h2>", "punch, force along z", "[[tool]]", "[[stage]]")
    for text in (*words, "Wrinkles start from"):
        assert text.lower() in page.lower()
    assert page.count("<img") == len(drawn)
    assert ("wrinkles.png" in drawn) == ("formed.png" in drawn)
    assert "largest height of wrinkles" in page


def test_series_of_cloth_and_tools(tmp_path):
    """The same times in both files; the punch moves, the die does not; units stand in names."""
    import h5py

    path, folder = written(tmp_path), tmp_path / "out"
    path.write_text(f"{CASE}[output]\npictures = false\n")
    assert main(["run", str(path), "--output", str(folder), "--quiet"]) == 0
    with h5py.File(folder / "series.vtkhdf") as cloth, h5py.File(folder / "tools.vtkhdf") as tools:
        cloth, tools = cloth["VTKHDF"], tools["VTKHDF"]
        for file in (cloth, tools):
            np.testing.assert_allclose(file["Steps/Values"], [0.0, 1.0, 1.5, 2.0])
        points = cloth["Points"][:].reshape(4, -1, 3)
        np.testing.assert_allclose(points[0, :, 2], 0.5e-3, atol=1e-12)  # flat, on the die
        assert points[3, :, 2].min() == pytest.approx(-5.5e-3, abs=0.7e-3)
        pressure = cloth["PointData/contact_pressure_kPa"][:].reshape(4, -1)
        assert np.nanmax(pressure[3]) > np.nanmax(pressure[1]) > 0.0
        assert {f"distance_to_{name}_mm" for name in ("die", "punch", "holder")} < set(
            cloth["PointData"]
        )
        assert cloth["CellData/yarn_direction"].shape[1] == 3
        corners = tools["Points"][:].reshape(4, -1, 3)
        moved = corners[3] - corners[1]
        number = tools["CellData/tool"][:]
        cells = tools["Connectivity"][:].reshape(-1, 3)
        for tool, way in ((0, 0.0), (1, -6e-3)):
            np.testing.assert_allclose(moved[cells[number == tool]][..., 2], way, atol=1e-9)


def test_removed_tools_are_not_drawn(tmp_path):
    """Neither in tools.vtkhdf, where all of one is in a point, nor in pictures."""
    import h5py

    more = '[[stage]]\nname = "open"\nremove = ["holder"]\nstep = 1.0\n'
    path, folder = written(tmp_path, ("step = 0.5\n", f"step = 0.5\n{more}")), tmp_path / "out"
    path.write_text(f"{path.read_text()}[output]\npictures = false\n")
    assert main(["run", str(path), "--output", str(folder), "--quiet"]) == 0
    with h5py.File(folder / "tools.vtkhdf") as file:
        tools = file["VTKHDF"]
        corners = tools["Points"][:].reshape(5, -1, 3)
        cells = tools["Connectivity"][:].reshape(-1, 3)
        holder = cells[tools["CellData/tool"][:] == 2]
    assert np.ptp(corners[3][holder], axis=(0, 1)).min() > 1e-3
    np.testing.assert_allclose(np.ptp(corners[4][holder], axis=(0, 1)), 0.0, atol=1e-12)
    assert np.ptp(corners[4][cells], axis=(0, 1)).min() > 1e-3  # the others are there
    forming, result = formed(COMM, path)
    before, after = (frame_of(forming, state) for state in result.states[-2:])
    assert len(before.above[1]) > len(after.above[1]) > 0
    assert len(before.below[1]) == len(after.below[1])
    assert [before.caption, after.caption] == ["draw, 100 %", "open, 100 %"]


PUNCH = 'shape = { sphere = { radius = "12 mm", shaft = true } }\n'
PLACE = 'place = ["{} mm", "{} mm", "40 mm"]\nturn = ["180 deg", "0 deg", "0 deg"]'


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ([(PUNCH, "FILE unit = 'mm' }\n")], "is it upside down?"),
        ([(PUNCH, "FILE unit = 'mm' }\nturn = ['180 deg', '0 deg', '0 deg']\n")], ""),
        ([(PUNCH, "FILE unit = 'cm' }\n")], "is the unit of its file right?"),
        ([(PUNCH, f"FILE unit = 'mm' }}\n{PLACE.format(20, 0)}\n")], ""),
        (
            [(PUNCH, f"FILE unit = 'mm' }}\n{PLACE.format(45, -40)}\n")],
            "mostly beside the blank, whose centre is x = y = 0: a file keeps its own",
        ),
        (
            [('fillet = "4 mm"', 'fillet = "1 mm"')],
            'tool "die" has radii down to 1 mm, and the net',
        ),
        (
            [('bias_angle = "0 deg"', 'bias_angle = "0 deg"\nyarns_per_cruciform = 4')],
            "cut its corn",
        ),
    ],
)
def test_what_hardly_fits_is_remarked_on(tmp_path, changes, words):
    """A punch that presses with its base; centimetres; one beside the blank; arms over radii."""
    tool = Path(__file__).parents[2] / "demos" / "tools" / "tetrahedron.stl"
    (tmp_path / "tip.stl").write_bytes(tool.read_bytes())
    file = "shape = { file = 'tip.stl', cell = '4 mm',"
    path = written(tmp_path, *((old, new.replace("FILE", file)) for old, new in changes))
    case = Case.load(path)
    forming = case.forming(Network(COMM, case.preform(), case.fabric()))
    told = " ".join(forming.remarks)
    assert (words in told) if words else ("upside down" not in told and "beside" not in told)


def test_a_place_in_plan_alone_touches_there(tmp_path):
    """The punch comes down beside the axis to where it meets the blank, as it does on it."""
    starts = []
    for place in ("", "place = ['3 mm', '-2 mm']\n", "place = ['3 mm', '-2 mm', '90 mm']\n"):
        case = Case.load(written(tmp_path, (PUNCH, PUNCH + place)))
        forming = case.forming(Network(COMM, case.preform(), case.fabric()))
        starts.append(forming.tools[1].start.place)
    np.testing.assert_allclose(starts[1] - starts[0], [3e-3, -2e-3, 0.0], atol=2e-4)
    np.testing.assert_allclose(starts[2], [3e-3, -2e-3, 0.09], atol=1e-15)
    with pytest.raises(InputError, match=r"tool\[1\].place must be a list of 3, for x, y"):
        Case.load(written(tmp_path, (PUNCH, PUNCH + "place = ['3 mm']\n")))


def test_blank_in_the_opening(tmp_path):
    """A blank that fits into the die's opening meets no die."""
    path = written(tmp_path, ('["56 mm", "56 mm"]', '["16 mm", "16 mm"]'))
    case = Case.load(path)
    with pytest.raises(InputError, match="16 mm x 16 mm may fit into an opening of a tool of 120"):
        case.forming(Network(COMM, case.preform(), case.fabric()))


def test_weight_rests_on_the_disc(tmp_path, capfd):
    """Cloth laid on a plate presses with its weight; viscosity that counts is told."""
    tools = CASE[CASE.index("[[tool]]") : CASE.index("[[stage]]")]
    stages = CASE[CASE.index("[[stage]]") :]
    plate = (
        "[[tool]]\nname = 'plate'\nshape = {{ ring = {{ outer_radius = '{} mm' }} }}\n"
        "place = ['5 mm', '0 mm', '0 mm']\n"
    )
    rest = "[[stage]]\nname = 'rest'\n"
    more = 'imperfection = { height = "0 mm" }\ngravity = true'
    old = 'imperfection = { height = "0 mm" }'
    path = written(tmp_path, (tools, plate.format(60)), (stages, rest), (old, more))
    _, result = formed(COMM, path)
    weight = 0.576 * 9.80665 * 0.056**2
    assert result.steps[-1].tool_force["plate"][2] == pytest.approx(weight, rel=1e-3)
    # About the plate's origin, from which the cloth's middle lies 5 mm towards -x.
    moment = result.steps[-1].tool_moment["plate"]
    np.testing.assert_allclose(moment, [0.0, 5e-3 * weight, 0.0], atol=2e-3 * 5e-3 * weight)
    text = path.read_text().replace("60 mm", "10 mm").replace("gravity = true", SYRUP)
    path.write_text(f"{text}[output]\npictures = false\n")
    assert main(["run", str(path), "--output", str(tmp_path / "out"), "--quiet"]) == 0
    assert "viscosity has taken" in capfd.readouterr().out


def test_shear_beyond_its_law_is_remarked_on(tmp_path, capfd):
    """A table that ends at 5 degrees, and yarns that carry compression like tension."""
    law = 'shear = { law = "sin-potential", coefficients = ["18.5 N/m", "46.4 N/m", "60 N/m"] }'
    table = 'shear = { law = "table", angle = "deg", force = "N/m", points = [[2, 1], [5, 3]] }'
    path = written(tmp_path, (law, table), ('tension = { strain = "log", compression = 0.02 }', ""))
    path.write_text(path.read_text() + "[output]\npictures = false\nparaview = false\n")
    assert main(["run", str(path), "--output", str(tmp_path / "out"), "--quiet"]) == 0
    warned = json.loads((tmp_path / "out" / "summary.json").read_text())["warnings"]
    assert any("beyond the last point of the shear law's table at 5.0 deg" in w for w in warned)


def test_stage_of_a_time():
    assert [stage_number(t) for t in (0.0, 0.3, 1.0, 1.2, 2.0)] == [0, 0, 0, 1, 1]
