# SPDX-License-Identifier: MIT
"""From case files: planes of symmetry, clamps, pressure and suction."""

import json

import numpy as np
import pytest
from mpi4py import MPI
from support.forming import CASE, formed, written

from cruciform_petsc.case.schema import Case
from cruciform_petsc.cli import main
from cruciform_petsc.equilibrium import lagged
from cruciform_petsc.forming import forming as steps_of
from cruciform_petsc.forming.measures import DrawIn, yarn_directions
from cruciform_petsc.net.network import Network

COMM = MPI.COMM_SELF
HEAD = CASE[: CASE.index("[[tool]]")]
SHEET = ('["56 mm", "56 mm"]', '["28 mm", "28 mm"]')
PLANES = ('kind = "forming"', 'kind = "forming"\nsymmetry = ["left", "lower"]')
QUARTER = (SHEET, PLANES, ('"5 N"', '"1.25 N"'))
PRESSURE = 5e3
AREA = 0.056**2
# Half a pitch of 1/240 m from the planes, as outlines are drawn: 56 x 56 mm, 28 x 28 mm.
BETWEEN = ('["2.083333333333 mm", "30.083333333333 mm"]',
           '["-11.916666666667 mm", "2.083333333333 mm"]')  # fmt: skip
ALL_ROUND = "".join(f'[[clamp]]\nedge = "{e}"\n' for e in ("left", "right", "lower", "upper"))


def shape(forming, result):
    """Places at rest, displacements, shear and warp's directions in x, y > 0, in one order."""
    blank, state = forming.blank, result.states[-1]
    at, fields = blank.network.crossover_position, blank.ply.fields(blank.of_cloth(state))
    mine = np.flatnonzero((at > -1e-9).all(axis=1))
    mine = mine[np.lexsort(np.round(at[mine], 9).T)]
    warp = yarn_directions(blank, state)[0]
    return at[mine], fields["displacement"][mine], fields["shear_angle"][mine], warp[mine]


@pytest.mark.parametrize("between", [False, True], ids=["on a yarn", "between yarns"])
def test_a_quarter_is_a_quarter(tmp_path, monkeypatch, between):
    """Forces a quarter, fields and steps those of the whole, on the planes too, to rounding."""
    monkeypatch.setattr(steps_of, "RESIDUAL", 1e-9)
    monkeypatch.setattr(lagged, "SETTLED", 1e-7)
    found = []
    for changes, origin in zip(((), QUARTER), BETWEEN, strict=True):
        more = [('bias_angle = "0 deg"', f'bias_angle = "0 deg"\norigin = {origin}')]
        found.append(formed(COMM, written(tmp_path, *changes, *(more if between else []))))
    (whole, result), (quarter, part) = found
    for step, other in zip(result.steps, part.steps, strict=True):
        for name, force in step.tool_force.items():
            assert 4 * other.tool_force[name][2] == pytest.approx(force[2], abs=1e-6)
        assert 4 * other.work == pytest.approx(step.work, rel=1e-6)
    for one, same in zip(shape(whole, result), shape(quarter, part), strict=True):
        np.testing.assert_allclose(same, one, atol=1e-6 * 6e-3)
    assert list(DrawIn(quarter.blank).edges) == ["upper", "right"]
    assert not [remark for remark in quarter.remarks if "symmetry" in remark]


def test_where_planes_lie(tmp_path):
    """At x = 0 and y = 0, with a crossover there; between two that face each other the centre."""
    for symmetry, bounds in (
        ('["left"]', [0, -14, 28, 14]),
        ('["right", "upper"]', [-28, -28, 0, 0]),
        ('["left", "right", "upper"]', [-14, -28, 14, 0]),
    ):
        planes = ('kind = "forming"', f'kind = "forming"\nsymmetry = {symmetry}')
        preform = Case.load(written(tmp_path, SHEET, planes)).preform()
        np.testing.assert_allclose(preform.outline.bounds, 1e-3 * np.array(bounds), atol=1e-15)
        np.testing.assert_allclose(preform.lattice_origin, 0.0, atol=1e-15)


def test_tools_are_to_be_symmetric(tmp_path):
    """One that stands aside is told; a half in one plane may be moved along it."""
    place = 'shaft = true } }\nplace = ["3 mm", "0 mm", "20 mm"]'
    case = Case.load(written(tmp_path, *QUARTER, ("shaft = true } }", place)))
    remarks = case.forming(Network(COMM, case.preform(), case.fabric())).remarks
    assert any(
        'tool "punch" is not the same on both sides of the plane of symmetry x = 0' in remark
        for remark in remarks
    )
    # What lies on one side stands for its image, too.
    far = 'shaft = true } }\nplace = ["60 mm", "60 mm", "20 mm"]'
    case = Case.load(written(tmp_path, *QUARTER, ("shaft = true } }", far)))
    remarks = case.forming(Network(COMM, case.preform(), case.fabric())).remarks
    assert not any("not the same on both sides" in remark for remark in remarks)
    half = ('kind = "forming"', 'kind = "forming"\nsymmetry = ["left"]')
    Case.load(written(tmp_path, half, ('["0 mm", "0 mm", "-6 mm"]', '["0 mm", "1 mm", "-6 mm"]')))


def run(folder, text):
    """Run a case: its summary and its log."""
    (folder / "case.toml").write_text(f"{text}[output]\npictures = false\n")
    assert main(["run", str(folder / "case.toml"), "--output", str(folder / "out")]) == 0
    return json.loads((folder / "out" / "summary.json").read_text())


def test_pressure_on_held_cloth(tmp_path, capfd):
    """What clamps bear is the pressure over the flat area; work is energy; no tools are needed."""
    blow = '[[stage]]\nname = "blow"\npressure = "-5 kPa"\nstep = 0.02\n'
    rest = '[[stage]]\nname = "rest"\nstep = 0.5\n'  # no viscosity carries anything then
    summary = run(tmp_path, HEAD + ALL_ROUND + blow + rest)
    forces = np.array([clamp["force_n"] for clamp in summary["clamps"].values()])
    np.testing.assert_allclose(forces.sum(axis=0), [0, 0, -PRESSURE * AREA], atol=2e-3)
    # The clamps on yarns that bulge upwards pull outwards and down.
    assert forces[1, 0] == pytest.approx(-forces[0, 0], rel=1e-6)
    assert forces[1, 0] > 5.0
    energy, work = summary["energy_j"], summary["work_of_loads_j"]
    assert work["pressure"] == pytest.approx(sum(energy.values()), rel=1e-2)
    told = capfd.readouterr()
    assert told.err == ""
    assert "clamp right   force on the cloth" in told.out
    head = (tmp_path / "out" / "forces.csv").read_text().splitlines()[0]
    assert "work_of_pressure_J,clamp_left_force_x_N" in head


def test_suction_presses_on_a_tool(tmp_path):
    """p A on a plate, edges free; it stays in the next stage, and goes when it is told to."""
    plate = "[[tool]]\nname = 'plate'\nshape = { ring = { outer_radius = '60 mm' } }\n"
    told = {"on": 'suction = "5 kPa"\n', "wait": "", "off": 'suction = "0 Pa"\n'}
    stages = "".join(f'[[stage]]\nname = "{name}"\n{more}' for name, more in told.items())
    (tmp_path / "case.toml").write_text(HEAD + plate + stages)
    _, result = formed(COMM, tmp_path / "case.toml")
    forces = {step.stage: step.tool_force["plate"][2] for step in result.steps}
    assert forces["on"] == pytest.approx(PRESSURE * AREA, rel=1e-3)
    assert forces["wait"] == pytest.approx(PRESSURE * AREA, rel=1e-3)
    assert abs(forces["off"]) < 1e-3 * PRESSURE * AREA
    assert result.steps[-1].load_work["suction"] == pytest.approx(0.0, abs=2e-4)


def test_a_cushion(tmp_path):
    """Half of a quarter of a cushion: seams slide in the plane and are drawn in; work is energy."""
    seams = "".join(f'[[clamp]]\nedge = "{e}"\nslides = true\n' for e in ("right", "upper"))
    head = HEAD.replace(*PLANES).replace("56 mm", "28 mm")
    summary = run(
        tmp_path, head + seams + '[[stage]]\nname = "blow"\npressure = "-5 kPa"\nstep = 0.04\n'
    )
    for clamp in summary["clamps"].values():
        assert clamp["force_n"][:2] == [0.0, 0.0]
        assert clamp["force_n"][2] < 0.0
    assert min(summary["draw_in_mm"].values()) > 1.0
    assert summary["draw_in_mm"]["right"] == pytest.approx(summary["draw_in_mm"]["upper"], rel=1e-3)
    work = summary["work_of_loads_j"]["pressure"]
    assert work == pytest.approx(sum(summary["energy_j"].values()), rel=5e-2)
    assert summary["symmetry"]["planes"] == ["left", "lower"]


def test_a_draw_from_clamps(tmp_path):
    """Springs with a limit instead of a holder: ends slip at it, and let go of when released."""
    tools = CASE[CASE.index("[[tool]]") : CASE.index('[[tool]]\nname = "holder"')]
    clamps = "".join(
        f'[[clamp]]\nedge = "{e}"\nstiffness = "20 N/mm"\npreload = "0.5 N"\n'
        'friction_limit = "0.02 N/mm"\n'
        for e in ("left", "right")
    )
    draw = CASE[CASE.index('[[stage]]\nname = "draw"') :]
    off = '[[stage]]\nname = "off"\nrelease = ["left", "right"]\n'
    (tmp_path / "case.toml").write_text(HEAD + tools + clamps + draw + off)
    forming, result = formed(COMM, tmp_path / "case.toml")
    drawn, released = result.states[-2], result.states[-1]
    slipped, rubbed = forming.blank.slipped(drawn)
    assert slipped["left"] > 0.3e-3
    assert rubbed["left"] > 1e-4
    assert result.steps[1].clamp_force["left"][0] < -0.5
    assert abs(result.steps[-1].clamp_force["left"]).max() < 1e-9
    assert forming.blank.slipped(released)[0]["left"] >= slipped["left"]
    edges = DrawIn(forming.blank)
    assert edges.largest(released)["left"] > edges.largest(drawn)["left"]


def test_a_cup_is_trimmed_and_springs_back(tmp_path):
    """The flange is cut off, tools are taken away: what is left has less shear and no force."""
    draw = 'travel = { punch = ["0 mm", "0 mm", "-6 mm"] }'
    off = (
        '[[stage]]\nname = "trim"\ntrim = { radius = "16 mm" }\nstep = 0.5\n'
        '[[stage]]\nname = "off"\nremove = ["punch", "holder"]\nstep = 0.5\n'
    )
    path = written(tmp_path, *QUARTER, (draw, draw))
    path.write_text(path.read_text() + off)
    forming, result = formed(COMM, path)
    blank, state = forming.blank, result.states[-1]
    fields = blank.ply.fields(blank.of_cloth(state))
    gone = np.hypot(*blank.network.crossover_position.T) > 16e-3
    assert gone.any()
    np.testing.assert_array_equal(fields["carrying"], ~gone)
    before = {step.stage: step.increment for step in result.steps}
    energy = {stage: sum(i.energies[m] for m in ("tension", "shear", "out_of_plane_bending"))
              for stage, i in before.items()}  # fmt: skip
    assert energy["trim"] < 0.9 * energy["draw"]
    assert energy["off"] < 0.5 * energy["trim"]
    assert before["off"].shear_max < before["draw"].shear_max
    for force in result.steps[-1].tool_force.values():
        assert abs(force[2]) < 1e-3


def test_a_holder_in_segments(tmp_path):
    """Four sectors, each with a force and a height of its own; the die bears them all."""
    die = CASE[CASE.index("[[tool]]") : CASE.index('[[tool]]\nname = "punch"')]
    names = ("east", "north", "west", "south")
    sectors = "".join(
        f'[[tool]]\nname = "{name}"\nshape.ring = {{ inner_radius = "16 mm", '
        f'outer_radius = "60 mm", from = "{90 * k - 44} deg", to = "{90 * k + 44} deg" }}\n'
        for k, name in enumerate(names)
    )
    forces = ", ".join(
        f'{name} = "{force} N"' for name, force in zip(names, (1, 2, 1, 4), strict=True)
    )
    close = f'[[stage]]\nname = "close"\nforce = {{ {forces} }}\n'
    (tmp_path / "case.toml").write_text(HEAD + die + sectors + close)
    last = formed(COMM, tmp_path / "case.toml")[1].steps[-1]
    assert [last.tool_force[name][2] for name in names] == [-1.0, -2.0, -1.0, -4.0]
    assert last.tool_force["die"][2] == pytest.approx(8.0, rel=1e-3)
    heights = [last.tool_place[name][2] for name in names]
    assert heights[0] == pytest.approx(heights[2], abs=1e-6)
    assert heights[3] < heights[1] - 1e-6 < heights[0] - 2e-6
