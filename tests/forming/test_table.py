# SPDX-License-Identifier: MIT
"""Forming in a case file: each key's mistakes are one sentence each, with its line."""

import numpy as np
import pytest
from mpi4py import MPI
from support.forming import CASE, written

from cruciform_petsc.case.schema import Case
from cruciform_petsc.errors import InputError
from cruciform_petsc.forming.table import below_cloth
from cruciform_petsc.net.network import Network

DRAW = 'travel = { punch = ["0 mm", "0 mm", "-6 mm"] }'
CLOSE = 'force = { holder = "5 N" }'
HOLDER = CASE[CASE.index('[[tool]]\nname = "holder"') : CASE.index("[[stage]]")]
TOOLS = CASE[CASE.index("[[tool]]") : CASE.index("[[stage]]")]
STAGES = CASE[CASE.index("[[stage]]") :]
TEST = 'imperfection = { height = "0 mm" }'


@pytest.mark.parametrize(
    ("old", "new", "sentence"),
    [
        ('thickness = "1 mm"\n', "", "fabric.thickness is missing, which test.kind"),
        (
            'warp = { modulus = "520 N/cm", poisson = 0, yarns = "2.4 /cm", '
            'yarn_bending = "0.6 N mm^2", out_of_plane_bending = "1 N mm" }',
            'warp = { modulus = "520 N/cm", poisson = 0, yarns = "2.4 /cm", '
            'yarn_bending = "0.6 N mm^2" }',
            "line 4: fabric.warp.out_of_plane_bending is missing",
        ),
        (TEST, "finite = true", 'line 15: [test] has the unknown key "finite"'),
        (TEST, "gravity = 1", "line 15: test.gravity must be true or false, got 1"),
        (TEST, 'imperfection = { height = "-1 mm" }', "test.imperfection.height must be zero or"),
        (TEST, "imperfection = { seed = -1 }", "test.imperfection.seed must be at least 0, got -1"),
        (TEST, 'contact = { stiffness = "20 N/mm" }', 'test.contact.stiffness = "20 N/mm" has the'),
        (TEST, 'contact = { elastic_slip = "0 mm" }', "test.contact.elastic_slip must be positive"),
        (TEST, 'contact = { viscosity = "-1 N s/m^3" }', "test.contact.viscosity must be zero or"),
        (TOOLS, "", 'test.kind = "forming" needs at least one [[tool]]'),
        (STAGES, "", 'test.kind = "forming" needs at least one [[stage]]'),
        ('name = "die"', 'name = "bends"', 'line 17: tool[0].name = "bends" is what the program'),
        ('name = "die"', 'name = "punch"', 'tool[1].name = "punch" is another tool\'s name, too'),
        ('name = "die"', 'name = "die\\n"', "must be of up to 40 letters, digits"),
        (HOLDER, "[[tool]]\nname='holder'\n", "line 24: tool[2].shape is missing"),
        (
            'ring = { inner_radius = "20 mm"',
            'ring = { iner_radius = "20 mm"',
            '[tool[2].shape.ring] has the unknown key "iner_radius" (did you mean "inner_radius"?)',
        ),
        (
            'ring = { inner_radius = "20 mm"',
            'ring = { from = "20 deg", inner_radius = "20 mm"',
            "tool[2].shape.ring needs both from and to, or none of them",
        ),
        (CLOSE, 'force = { holdr = "5 N" }', "there is no tool 'holdr' (did you mean \"holder\"?"),
        (CLOSE, 'force = { holder = "5 mm" }', "line 30: stage[0].force.holder = \"5 mm\" has the"),
        (CLOSE, 'force = { holder = "-5 N" }', "stage[0].force.holder must be positive, towards"),
        (CLOSE, 'force = { holder = "0 N" }', "stage[0].force.holder is zero: a tool that is not"),
        (CLOSE, 'force = { holder = ["0 N", "5 N"] }', "must be one force, or a list of 3 for x,"),
        (DRAW, 'travel = { punch = "5 mm" }', "line 34: stage[1].travel.punch must be a"),
        (DRAW, 'travel = { punch = ["5 mm"] }', "stage[1].travel.punch must be a list of 3"),
        (DRAW, "turn = { punch = { angle = 3 } }", "turn.punch.angle is the bare number 3"),
        (
            DRAW,
            'turn = { punch = { angel = "3 deg", axis = [0.0, 0.0, 1.0] } }',
            'has the unknown key "angel" (did you mean "angle"?)',
        ),
        (DRAW, "curve = { punch = [[0.0, 0.0]] }", "stage[1].curve.punch must be a list of"),
        (
            DRAW,
            "curve = { punch = [[0.0, 0.0], [1.0, 1.0]] }",
            'stage[1].curve: tool "punch" does not travel or turn in this stage',
        ),
        (
            DRAW,
            DRAW + '\nforce = { punch = "1 N" }',
            'stage[1].force: tool "punch" travels or turns in this stage',
        ),
        (DRAW, DRAW + '\nremove = ["punch"]', 'stage[1].remove: tool "punch" moves in this stage'),
        (CLOSE, 'remove = ["punch"]', 'stage[1].travel: tool "punch" was removed in an earlier'),
        (TEST, 'symmetry = ["front"]', 'test.symmetry[0] must be "left", "right", "lower" or'),
        (TEST, 'symmetry = "left"', "line 15: test.symmetry must be a list"),
        (DRAW, "trim = {}", "stage[1].trim needs exactly one of radius, rectangle and polygon"),
        (DRAW, 'trim = { radius = "0 mm" }', "stage[1].trim.radius must be positive"),
        (
            DRAW,
            'trim = { polygon = [["0 m", "0 m"], ["1 m", "1 m"], ["1 m", "0 m"], ["0 m", "1 m"]] }',
            "stage[1].trim.polygon crosses or touches itself",
        ),
        (DRAW, 'release = ["left"]', 'stage[1].release: there is no [[clamp]] of the edge "left"'),
        (DRAW, 'suction = "5 N"', 'line 34: stage[1].suction = "5 N" has the'),
        (DRAW, 'pressure = 5', "stage[1].pressure is the bare number 5"),
        (DRAW, 'pressure = "5 kPa"', 'stage[1]: the edge "outline-1" is free under pressure'),
        ("results = 2", "results = 0", "stage[1].results must be a whole number from 1 up, got 0"),
        ("step = 0.5", "step = 2.0", "stage[1].step must be a share of the stage from 0.0001 to 1"),
        ("step = 0.5", "steps = 0.5", '[stage[1]] has the unknown key "steps" (did you mean'),
        (
            'title = "Cup"',
            "continuum = { second_gradient = true }",
            "continuum.second_gradient is not for forming",
        ),
        (
            f'kind = "forming"\n{TEST}',
            'extension = "1 mm"',
            'tool is for test.kind = "forming", not "bias-extension"',
        ),
        ('kind = "forming"', 'kind = "forning"', 'test "forning" (did you mean "forming"?'),
    ],
)  # fmt: skip
def test_refused(tmp_path, old, new, sentence):
    with pytest.raises(InputError) as caught:
        Case.load(written(tmp_path, (old, new)))
    assert sentence in str(caught.value)


LEFT = '[[clamp]]\nedge = "left"\n'
PLANES = 'kind = "forming"\nsymmetry = ["left"]'


@pytest.mark.parametrize(
    ("changes", "clamps", "sentence"),
    [
        ([], '[[clamp]]\nedge = "front"\n', 'preform has no edge "front" (known: lower,'),
        ([], "[[clamp]]\n", "clamp[0].edge is missing"),
        ([], f"{LEFT}{LEFT}", 'clamp[1].edge = "left" has another clamp, too'),
        ([], f'{LEFT}stiffness = "2 N"\n', 'clamp[0].stiffness = "2 N" has the'),
        ([], f'{LEFT}stiffness = "-2 N/mm"\n', "clamp[0].stiffness must be positive"),
        ([], f'{LEFT}preload = "2 N"\n', "clamp[0].preload is of springs: give their stiffness"),
        ([], f'{LEFT}friction_limit = "0 N"\n', "clamp[0].friction_limit must be positive"),
        (
            [],
            f'{LEFT}slides = true\nstiffness = "2 N/mm"\n',
            "clamp[0].slides = true holds in height only, without stiffness",
        ),
        (
            [("[test]\n", "[test]\n"), ('kind = "forming"', PLANES)],
            LEFT,
            'clamp[0].edge = "left" lies in a plane of symmetry',
        ),
        (
            [(CLOSE, f'{CLOSE}\nrelease = ["left"]'), (DRAW, f'{DRAW}\nrelease = ["left"]')],
            LEFT,
            'stage[1].release: "left" was released in an earlier stage',
        ),
        (
            [('kind = "forming"', PLANES), ('"0 mm", "0 mm", "-6 mm"', '"1 mm", "0 mm", "-6 mm"')],
            "",
            'stage[1].travel: tool "punch" would leave the plane of symmetry x = 0',
        ),
        (
            [('kind = "forming"', PLANES), (CLOSE, 'force = { holder = ["1 N", "0 N", "-5 N"] }')],
            "",
            'stage[0].force: tool "holder" would leave the plane of symmetry x = 0',
        ),
        (
            [
                ('kind = "forming"', PLANES),
                (DRAW, 'turn = { punch = { angle = "3 deg", axis = [0.0, 0.0, 1.0] } }'),
            ],
            "",
            'stage[1].turn: tool "punch" would turn out of the plane of symmetry x = 0',
        ),
        (
            [('kind = "forming"', PLANES), ('bias_angle = "0 deg"', 'bias_angle = "30 deg"')],
            "",
            'test.symmetry needs yarns along and across the planes: preform.bias_angle = "0 deg"',
        ),
        (
            [
                ('kind = "forming"', PLANES),
                (
                    'rectangle = ["56 mm", "56 mm"]',
                    'polygon = [["0 mm", "5 mm"], ["9 mm", "0 mm"], ["9 mm", "9 mm"]]',
                ),
            ],
            "",
            'test.symmetry: preform has no edge "left" (no straight piece of the outline lies at',
        ),
        (
            [('name = "die"', 'name = "clamp 1"')],
            "",
            'tool[0].name = "clamp 1" is what the program',
        ),
        ([(DRAW, 'pressure = "5 kPa"')], LEFT, 'the edge "outline-1" is free under pressure'),
        (
            [(DRAW, 'pressure = "5 kPa"')],
            "".join(f"[[clamp]]\nedge = '{e}'\n" for e in ("left", "right", "upper", "lower"))
            + 'stiffness = "1 N/mm"\n',
            'stage[1]: the edge "outline-1" is free under pressure',
        ),
    ],
)
def test_refused_of_clamps_and_planes(tmp_path, changes, clamps, sentence):
    first = '[[stage]]\nname = "close"'
    with pytest.raises(InputError) as caught:
        Case.load(written(tmp_path, *changes, (first, clamps + first)))
    assert sentence in str(caught.value)


def test_pressure_on_edges_let_go(tmp_path):
    """All edges held is right, until one is released; ended before, it is right again."""
    four = "".join(f"[[clamp]]\nedge = '{e}'\n" for e in ("left", "right", "upper", "lower"))
    first = '[[stage]]\nname = "close"'
    off = '[[stage]]\nname = "off"\nrelease = ["upper"]\n'
    on = (first, f'{four}[[stage]]\nname = "on"\npressure = "1 kPa"\n{first}')
    end = (CLOSE, f'{CLOSE}\npressure = "0 Pa"')
    path = written(tmp_path, on, end)
    path.write_text(path.read_text() + off)
    Case.load(path)
    path = written(tmp_path, on)
    path.write_text(path.read_text() + off.replace('release = ["upper"]', 'trim.radius="9 mm"'))
    with pytest.raises(InputError, match=r"stage\[3\]: cloth is trimmed, so that its edge is free"):
        Case.load(path)
    path = written(tmp_path, on)
    path.write_text(path.read_text() + off)
    with pytest.raises(
        InputError, match=r'stage\[3\]: the edge "outline-3" is free under pressure'
    ):
        Case.load(path)


def test_weight_needs_an_areal_density(tmp_path):
    path = written(tmp_path, ('areal_density = "576 g/m^2"\n', ""), (TEST, "gravity = true"))
    with pytest.raises(InputError, match=r"areal_density is missing, which test.gravity = true"):
        Case.load(path)
    last = 'name = "end"\nremove = ["die", "punch", "holder"]\n[[stage]]\nname = "draw"'
    path = written(tmp_path, (TEST, "gravity = true"), ('name = "draw"', last), (DRAW, ""))
    with pytest.raises(InputError, match="without any tool nothing holds the cloth's weight"):
        Case.load(path)


def test_what_lies_below(tmp_path):
    """What looks up, goes up first, or never moves is below; the rest comes from above.

    A skin looks where its side lies once it is turned: one turned over comes from above.
    """
    both, end = {"die", "punch"}, 'outer_radius = "60 mm" }'
    turned = 'turn = { punch = { angle = "3 deg", axis = [0.0, 0.0, 1.0] } }'
    next_tool = ' }\nfriction = 0.2\n[[tool]]\nname = "punch"'
    punch = 'shape = { sphere = { radius = "12 mm", shaft = true } }\n'
    skin = 'shape = { file = "skin.stl", unit = "mm", side = "+z" }\n'
    for changes, below in (
        ([], {"die"}),
        ([(DRAW, 'travel = { punch = ["0 mm", "0 mm", "6 mm"] }')], both),
        ([(DRAW, turned)], both),
        ([(CLOSE, 'force = { holder = ["0 N", "0 N", "5 N"] }')], {"die", "holder"}),
        ([("shaft = true } }", 'shaft = true }, side = "+z" }')], both),
        ([(end + next_tool, end + ', side = "-z"' + next_tool)], set()),
        ([(punch, skin + 'turn = ["180 deg", "0 deg", "30 deg"]\n')], {"die"}),
        ([(punch, skin.replace("+z", "-y") + 'turn = ["90 deg", "0 deg", "0 deg"]\n')], {"die"}),
        ([(punch, skin.replace("+z", "-y") + 'turn = ["-90 deg", "0 deg", "0 deg"]\n')], both),
    ):
        case = Case.load(written(tmp_path, *changes))
        assert below_cloth(case.tools, case.stages) == below


def test_the_origin_is_the_centre(tmp_path):
    """Wherever the outline is drawn, with its origin of the lattice."""
    polygon = (
        'polygon = [["10 mm", "5 mm"], ["66 mm", "5 mm"], ["66 mm", "61 mm"], ["10 mm", "61 mm"]]'
    )
    path = written(
        tmp_path,
        ('rectangle = ["56 mm", "56 mm"]', polygon),
        ('bias_angle = "0 deg"', 'bias_angle = "0 deg"\norigin = ["39 mm", "33 mm"]'),
    )
    preform = Case.load(path).preform()
    np.testing.assert_allclose(preform.outline.bounds, [-0.028, -0.028, 0.028, 0.028], atol=1e-15)
    np.testing.assert_allclose(preform.lattice_origin, [1e-3, 0.0], atol=1e-15)
    assert {"lower", "upper", "left", "right"} < set(preform.edges)


def test_files_of_tools_are_relative_to_the_case(tmp_path, monkeypatch):
    """Wherever the program is started, and with an empty or a missing name refused."""
    monkeypatch.chdir("/")
    shape = 'shape = { sphere = { radius = "12 mm", shaft = true } }'
    case = Case.load(written(tmp_path, (shape, 'shape = { file = "punch.stl", unit = "mm" }')))
    assert case.tools[1].shape.file == str(tmp_path / "punch.stl")
    assert Case.from_data(case.model_dump()) == case
    network = Network(MPI.COMM_SELF, case.preform(), case.fabric())
    with pytest.raises(InputError, match=r'tool "punch": .*punch.stl'):
        case.forming(network)
    path = written(tmp_path, (shape, 'shape = { file = "" }'))
    with pytest.raises(InputError, match=r"tool\[1\].shape.file must be a name that is not empty"):
        Case.load(path)
