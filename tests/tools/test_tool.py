# SPDX-License-Identifier: MIT
"""[[tool]] of a case: what is built of it, one sentence for each mistake, where tools touch."""

import tomllib

import numpy as np
import pytest
from support.kernels import DEGREE, rotation
from support.toolfiles import write_stl

from cruciform_petsc.errors import InputError
from cruciform_petsc.tools.motion import Pose
from cruciform_petsc.tools.shapes import sphere
from cruciform_petsc.tools.tool import SHAPES, ShapeTable, ToolTable, TurnTable, motion

FORM = """
name = "die"
shape = { revolve = { opening_radius = "80 mm", fillet = "7.5 mm", outer_radius = "225 mm" } }
friction = 0.2
"""


def table(text):
    return ToolTable.from_data(tomllib.loads(text), "tool[0]")


def shaped(shape):
    return table(f'name = "a"\nshape = {{ {shape} }}')


def test_the_form_of_the_issue():
    die = table(FORM).build()
    assert (die.name, die.friction, die.placed) == ("die", 0.2, False)
    assert die.surface.closest_radius == (0.0075, np.inf)
    distance, normal, curvature = die.look(np.array([[0.1, 0.0, 0.003]]), die.start)
    assert distance == pytest.approx(0.003)
    np.testing.assert_allclose(normal, [[0, 0, 1]])
    assert not curvature.any()
    holder = shaped('ring = { inner_radius = "90 mm", outer_radius = "225 mm" }')
    down = holder.build(facing="-z")
    np.testing.assert_allclose(down.look(np.array([[0.1, 0.0, -0.003]]), down.start)[0], 0.003)
    again = ToolTable.from_data(holder.model_dump(mode="json"))  # as a resumed run reads it
    assert again == holder
    assert again.shape.ring.outer_radius.si == 0.225


@pytest.mark.parametrize(
    ("shape", "at", "distance"),
    [
        ("plane = {}", [5, 7, 2], 2),
        ('plane = { size = ["100 mm", "80 mm"], edge_radius = "2 mm" }', [60, 0, -10], 10),
        ('sphere = { radius = "75 mm" }', [0, 0, 80], 5),
        ('sphere = { radius = "75 mm", shaft = true }', [0, 85, -90], 10),
        ('cylinder = { radius = "10 mm" }', [15, 999, 0], 5),
        ('cylinder = { radius = "10 mm", length = "50 mm" }', [0, 30, 0], 5),
        ('box = { size = ["20 mm", "30 mm", "40 mm"] }', [0, 0, -25], 5),
        ('ring = { outer_radius = "90 mm" }', [0, 0, 3], 3),
        ('revolve = { profile = [["0 mm", "5 mm"], ["40 mm", "5 mm"]], fillets = "2 mm" }',
         [0, 0, 6], 1),
        ('revolve = { profile = [["0 mm", "5 mm"], ["9 mm", "5 mm"], ["40 mm", "0 mm"]], '
         'smooth = true, spine = "40 mm" }', [0, 0, 6], 1),
        ('extrude = { profile = [["-9 mm", "5 mm"], ["9 mm", "5 mm"]], '
         'fillets = ["1 mm", "2 mm"] }', [0, 99, 6], 1),
        ('plane = {}, side = "-z"', [5, 7, -2], 2),
    ],
)  # fmt: skip
def test_every_shape(shape, at, distance):
    tool = shaped(shape).build()
    found = tool.look(np.array([at]) * 1e-3, tool.start)[0]
    assert found == pytest.approx(distance * 1e-3, abs=1e-12)


def test_place_and_turn():
    text = FORM + 'place = ["1 mm", "2 mm", "3 mm"]\nturn = ["10 deg", "20 deg", "30 deg"]\n'
    die = table(text).build()
    assert die.placed
    np.testing.assert_allclose(die.start.place, [0.001, 0.002, 0.003])
    x, y, z = np.eye(3)
    about = rotation(30 * DEGREE, z) @ rotation(20 * DEGREE, y) @ rotation(10 * DEGREE, x)
    np.testing.assert_allclose(die.start.turn, about, atol=1e-14)
    at = die.start.to_lab(np.array([[0.1, 0.0, 0.003]]))
    distance, normal, _ = die.look(at, die.start)
    assert distance == pytest.approx(0.003)
    np.testing.assert_allclose(normal[0], about @ z, atol=1e-14)


def test_a_file(tmp_path):
    points, facets = sphere(0.02).facets(5e-5)
    write_stl(tmp_path / "ball.stl", points / 1e-3, facets)
    text = 'file = "ball.stl", unit = "mm", cell = "2 mm"'
    tool = shaped(text).build(tmp_path)
    assert tool.look(np.array([[0, 0, 0.021]]), tool.start)[0] == pytest.approx(1e-3, abs=2e-5)
    with pytest.raises(InputError, match=r'^tool "a": .*none.stl" does not exist'):
        shaped('file = "none.stl", unit = "mm"').build(tmp_path)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ('shape = { plane = {} }', "tool[0].name is missing"),
        ('name = "a"', "tool[0].shape is missing"),
        ('name = ""\nshape = { plane = {} }', "tool[0].name must be a name that is not empty"),
        ('name = "a"\nshape = {}', "needs exactly one of plane, sphere"),
        ('name = "a"\nshape = { plane = {}, box = { size = ["1 m", "1 m", "1 m"] } }',
         "got plane and box"),
        ('name = "a"\nshape = { sfere = {} }', 'did you mean "sphere"'),
        ('name = "a"\nshape = { sphere = { radius = "75" } }',
         'tool[0].shape.sphere.radius = "75" has no unit'),
        ('name = "a"\nshape = { sphere = { radius = "-75 mm" } }', "must be positive"),
        ('name = "a"\nshape = { sphere = { radius = "75 deg" } }', "not that of a length"),
        ('name = "a"\nshape = { box = { size = ["1 m", "1 m"] } }',
         "must be a list of 3, for x, y and z, got 2"),
        ('name = "a"\nshape = { plane = { edge_radius = "1 mm" } }', "give its size, too"),
        ('name = "a"\nshape = { cylinder = { radius = "1 mm", edge_radius = "1 mm" } }',
         "give its length, too"),
        ('name = "a"\nshape = { ring = { outer_radius = "1 m", inner_radius = "-1 m" } }',
         "must be zero or positive"),
        ('name = "a"\nshape = { revolve = { fillet = "1 mm" } }', "or a profile"),
        ('name = "a"\nshape = { revolve = { fillet = "1 mm", profile = [["0 m", "0 m"], '
         '["1 m", "0 m"]], fillets = "1 mm" } }', "got both"),
        ('name = "a"\nshape = { extrude = { profile = [["0 m", "0 m"], ["1 m", "0 m"]] } }',
         "needs fillets of its corners, or smooth = true"),
        ('name = "a"\nshape = { plane = {}, unit = "mm" }', "unit is of a file, not of a plane"),
        ('name = "a"\nshape = { plane = {}, side = "+x" }', 'must be "+z" or "-z" of a plane'),
        ('name = "a"\nshape = { file = "a.stl", unit = "kg" }', "not that of a length"),
        ('name = "a"\nshape = { file = "a.stl", unit = "mm", side = "up" }', "got 'up'"),
        ('name = "a"\nshape = { plane = {} }\nfriction = -0.1', "must be zero or positive"),
        ('name = "a"\nshape = { plane = {} }\nfriction = "0.1"', "must be a number"),
        ('name = "a"\nshape = { plane = {} }\nplace = ["1 mm"]', "must be a list of 3"),
        ('name = "a"\nshape = { plane = {} }\nturn = ["1 mm", "0 deg", "0 deg"]',
         "not that of an angle"),
        ('name = "a"\nshape = { plane = {} }\nspeed = 3', 'the unknown key "speed"'),
    ],
)  # fmt: skip
def test_one_sentence_for_each_mistake(text, words):
    with pytest.raises(InputError) as error:
        table(text)
    assert words in str(error.value)
    assert "\n" not in str(error.value)


@pytest.mark.parametrize(
    ("shape", "words"),
    [
        ('ring = { outer_radius = "1 mm", inner_radius = "2 mm" }', "must be larger than"),
        ('revolve = { opening_radius = "8 mm", fillet = "2 mm", outer_radius = "9 mm" }',
         "must leave room"),
        ('extrude = { profile = [["0 m", "0 m"], ["1 m", "0 m"]], fillets = "0 mm" }',
         "sharp corner"),
    ],
)  # fmt: skip
def test_shapes_that_cannot_be_name_their_tool(shape, words):
    with pytest.raises(InputError, match=f'^tool "a": .*{words}'):
        shaped(shape).build()


def test_remarks():
    die = table(FORM).build()
    assert die.remarks(5e-3) == []
    (remark,) = die.remarks(8e-3)
    assert remark == ('tool "die" has radii down to 7.5 mm, less than the cloth\'s thickness, 8 mm')


def test_every_shape_is_a_key():
    assert set(SHAPES) | {"unit", "side", "cell"} == set(ShapeTable.keys())


def test_where_tools_just_touch():
    """The issue's punch from above, its die from below, 0.5 mm from the middle of the cloth."""
    x = np.linspace(-0.15, 0.15, 51)
    cloth = np.column_stack([*(a.ravel() for a in np.meshgrid(x, x)), np.zeros(51 * 51)])
    punch = shaped('sphere = { radius = "75 mm" }').build().touching(cloth, [0, 0, -1], 5e-4)
    np.testing.assert_allclose(punch.start.place, [0, 0, 0.0755], atol=1e-10)
    assert punch.placed
    die = table(FORM).build().touching(cloth, [0, 0, 1], 5e-4)
    np.testing.assert_allclose(die.start.place, [0, 0, -5e-4], atol=1e-10)
    holder = shaped('ring = { inner_radius = "90 mm", outer_radius = "225 mm" }')
    down = holder.build(facing="-z").touching(cloth, [0, 0, -2], 5e-4)
    np.testing.assert_allclose(down.start.place, [0, 0, 5e-4], atol=1e-10)
    with pytest.raises(InputError, match='tool "a" does not meet the cloth'):
        shaped('sphere = { radius = "5 mm" }').build().touching(cloth + 1.0, [0, 0, 1], 0.0)


def test_motion_of_a_stage():
    from_data = TurnTable.from_data
    turn = from_data({"angle": "90 deg", "axis": [0.0, 0.0, 2.0], "through": ["1 m"] + 2 * ["0 m"]})
    pose = motion(Pose(), None, turn, [[0.0, 0.0], [0.5, 1.0], [1.0, 1.0]]).at(0.5)
    np.testing.assert_allclose(pose.place, [1.0, -1.0, 0.0], atol=1e-15)
    with pytest.raises(InputError, match="must have a direction"):
        from_data({"angle": "90 deg", "axis": [0.0, 0.0, 0.0]})


@pytest.mark.parametrize("facing", ["+z", "-z"])
def test_a_sector_lies_where_its_angles_are_seen_from_above(facing):
    """A tool that looks down is turned over, its sector is not; nor is a file's or a profile's."""
    radii = 'inner_radius = "90 mm", outer_radius = "225 mm"'
    north = shaped(f'ring = {{ {radii}, from = "20 deg", to = "110 deg" }}').build(facing=facing)
    up = 1.0 if facing == "+z" else -1.0
    angle = np.array([0.0, 30.0, 100.0, 120.0, 260.0, 330.0]) * DEGREE
    points = np.column_stack([0.15 * np.cos(angle), 0.15 * np.sin(angle), 0.001 * up + 0 * angle])
    on_it = north.look(points, north.start)[0] < 0.0011
    assert on_it.tolist() == [False, True, True, False, False, False]
