# SPDX-License-Identifier: MIT
"""Formings that begin with the cloth laid on a tool: equilibrium from there, planes, restart."""

import numpy as np
import pytest
from support.forming import formed, kept, same_end
from support.laid import COMM, made, shear_of, written

from cruciform_petsc.case.schema import Case
from cruciform_petsc.cli import main
from cruciform_petsc.errors import InputError
from cruciform_petsc.output.checkpoint import Checkpoint


@pytest.fixture(scope="module")
def vacuum(tmp_path_factory):
    return formed(COMM, written(tmp_path_factory.mktemp("laid")))


def test_begins_on_the_tool_and_comes_to_rest_there(vacuum):
    """Soft shear, sucked on: the net of rigid yarns is near what equilibrium is."""
    forming, result = vacuum
    start, last = forming.blank.start(), result.states[-1]
    cloth = start.x[forming.blank.cloth_at]
    distance = np.linalg.norm(cloth - [0, 0, -40e-3], axis=1) - 40e-3
    np.testing.assert_allclose(distance, 0.5e-3, atol=1e-12)
    assert forming.blank.ply.fields(forming.blank.of_cloth(start))["arm_strain"] == pytest.approx(
        0.0, abs=1e-12
    )
    assert result.steps[0].increment.control <= 0.01  # it lets go in small steps
    moved = np.linalg.norm(last.x - start.x, axis=1)[forming.blank.cloth_at].max()
    assert moved < 3e-3
    laid, now = (np.rad2deg(abs(shear_of(forming, state)).max()) for state in (start, last))
    assert now == pytest.approx(laid, abs=3.0)
    assert 15.0 < laid < 40.0
    # What pushes is what the tool carries: the vacuum over the area in plan.
    area = forming.network.covered_area()
    assert 0.6 * 40e3 * area < result.steps[-1].tool_force["mould"][2] < 40e3 * area


def test_energies_balance(vacuum):
    """Shear that laying has stored is let go of, and dissipated; nothing is gained."""
    forming, result = vacuum
    first = sum(forming.blank.model.energies(forming.blank.start()).values())
    last = result.steps[-1]
    spent = sum(last.spent.values())
    assert all(value >= 0.0 for value in last.spent.values())
    spends = [sum(step.spent.values()) for step in result.steps]
    assert (np.diff(spends) >= -1e-12).all()
    stored = sum(last.increment.energies[m] for m in ("tension", "shear", "bending", "contact"))
    stored += last.increment.energies["out_of_plane_bending"]
    given = first + last.work + sum(last.load_work.values())
    assert stored + spent == pytest.approx(given, rel=0.3)  # work by trapezia, in few steps


def test_what_laying_has_taken_is_not_counted(tmp_path):
    """Friction of shear holds laid cloth as it lies, and has dissipated nothing so far."""
    friction = 'shear = { modulus = "0.02 N/cm" }\nshear_friction = { torque = "0.01 N/mm" }'
    forming = made(written(tmp_path, ('shear = { modulus = "0.02 N/cm" }', friction)))
    start = forming.blank.start()
    assert np.rad2deg(abs(shear_of(forming, start)).max()) > 10.0
    assert set(forming.blank.spent(start).values()) == {0.0}
    assert abs(start.memory["cruciforms"]["anchor"]).max() > 0.1


def test_no_shear_on_a_cylinder(tmp_path):
    """Cloth that is laid on a cylinder at an angle stays as it is, but for its bending."""
    path = written(
        tmp_path,
        ('sphere = { radius = "40 mm", shaft = true }', 'cylinder = { radius = "40 mm" }'),
        ('bias_angle = "0 deg"', 'bias_angle = "30 deg"'),
    )
    forming, result = formed(COMM, path)
    assert np.rad2deg(abs(shear_of(forming, forming.blank.start())).max()) < 0.2
    assert np.rad2deg(abs(shear_of(forming, result.states[-1])).max()) < 2.5  # at corners, of 49


def test_a_quarter_is_a_quarter(tmp_path, vacuum):
    """Between planes of symmetry, the seed where they meet."""
    path = written(
        tmp_path,
        ('rectangle = ["60 mm", "60 mm"]', 'rectangle = ["30 mm", "30 mm"]'),
        ('origin = ["0 mm", "30 mm"]\n', ""),
        ("fishnet = {}", 'fishnet = { generators = "upright" }\nsymmetry = ["left", "lower"]'),
    )
    forming, result = formed(COMM, path)
    start = forming.blank.start()
    assert abs(start.at(start.hold, 0.0, {}).x - start.x).max() < 1e-12
    whole = vacuum[1].steps[-1].tool_force["mould"][2]
    assert 4.0 * result.steps[-1].tool_force["mould"][2] == pytest.approx(whole, rel=1e-3)


def test_other_tools_start_where_they_touch_the_laid_cloth(tmp_path):
    """A ring that comes down around the mould meets cloth far below the flat blank."""
    ring = (
        '[[tool]]\nname = "ring"\n'
        'shape = { ring = { inner_radius = "15 mm", outer_radius = "60 mm" } }\n'
        '[[stage]]\nname = "press"\ntravel = { ring = ["0 mm", "0 mm", "-1 mm"] }\n'
        '[[stage]]\nname = "vacuum"'
    )
    forming = made(written(tmp_path, ('[[stage]]\nname = "vacuum"', ring)))
    height = forming.tools[1].start.place[2]
    assert -8e-3 < height < -1e-3
    assert forming.gaps["ring"] == pytest.approx(0.0, abs=1e-9)
    assert 'is laid first, on tool "mould"' in forming.check()[0]


def test_resumed(tmp_path, vacuum):
    """Killed after the second step, it goes on to the same end; and so from the very start."""
    case = Case.load(written(tmp_path))
    for stop in (2, 1):
        folder = tmp_path / str(stop)
        folder.mkdir()
        assert kept(COMM, case, Checkpoint.begin(COMM, folder, case), stop=stop) is None
        again = kept(COMM, case, Checkpoint.resume(COMM, folder))
        same_end(again, vacuum[1], within=1e-9)


@pytest.mark.parametrize(
    ("changes", "told"),
    [
        ([("fishnet = {}", 'fishnet = { tool = "die" }')], "test.fishnet.tool: there is no tool"),
        ([("fishnet = {}", "fishnet = { angle = 1 }")], 'has the unknown key "angle"'),
        ([("[output]", '[[clamp]]\nedge = "left"\n[output]')], "test.fishnet: [[clamp]] holds"),
        ([("[output]", "[continuum]\ncompare = true\n[output]")], "test.fishnet is not for"),
        (
            [("fishnet = {}", 'fishnet = { least_energy = {} }\nsymmetry = ["left"]')],
            "test.fishnet.least_energy moves the seed",
        ),
        (
            [("[[stage]]", '[[tool]]\nname = "b"\nshape = { plane = {} }\n[[stage]]')],
            "test.fishnet.tool is missing",
        ),
        ([("fishnet = {}", 'fishnet = { locking_angle = "10 deg" }')], "all of the cloth only"),
        ([("fishnet = {}", 'fishnet = { seed = ["99 mm", "0 mm"] }')], "test.fishnet: the seed"),
        (
            [
                ("fishnet = {}", 'model = "truss"\nfishnet = { press = "2 kPa" }'),
                ('suction = "40 kPa"\n', ""),
            ],
            'test.fishnet.press is not for test.model = "truss"',
        ),
    ],
)  # fmt: skip
def test_mistakes(tmp_path, capfd, changes, told):
    """One sentence each, exit code 2."""
    path = written(tmp_path, *changes)
    assert main(["run", str(path), "--output", str(tmp_path / "out"), "--quiet"]) == 2
    error = capfd.readouterr().err
    assert told in error
    assert "Traceback" not in error


def test_planes_of_symmetry_are_kept(tmp_path):
    """A seed beside them, or a turn, is refused."""
    changes = [
        ('rectangle = ["60 mm", "60 mm"]', 'rectangle = ["30 mm", "30 mm"]'),
        ('origin = ["0 mm", "30 mm"]\n', ""),
        ("fishnet = {}", 'fishnet = { turn = "5 deg" }\nsymmetry = ["left", "lower"]'),
    ]
    with pytest.raises(InputError, match=r"leaves a plane of symmetry by \d"):
        made(written(tmp_path, *changes))
