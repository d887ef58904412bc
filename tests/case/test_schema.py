# SPDX-License-Identifier: MIT
"""The case file: what it gives, and what it says about mistakes."""

import json
import math
import re
import tomllib
from pathlib import Path

import pytest
from support.jsonschema import problems

from cruciform_petsc.case.schema import Case
from cruciform_petsc.case.template import new_case
from cruciform_petsc.cloth.fabric import fabric_names
from cruciform_petsc.errors import InputError
from cruciform_petsc.experiments.registry import KINDS
from cruciform_petsc.solvers import options as petsc

KNOWN = "known: " + ", ".join(f'"{kind}"' for kind in KINDS)

DEMOS = Path(__file__).parents[2] / "demos"
SPECIMEN = """
title = "the paper's specimen"
[fabric]
use = "e-glass-plain-2.4"
[preform]
outline = { rectangle = ["2.4 cm", "3.6 cm"] }
bias_angle = "45 deg"
[test]
extension = "1 mm"
"""

OWN_FABRIC_KEYS = (
    'fabric={warp={modulus="1 N/cm", poisson=0, yarns="1 /cm", yarn_bending="1 N mm^2"}, '
    'weft={modulus="1 N/cm", poisson=0, yarns="1 /cm", yarn_bending="1 N mm^2"}, '
    'shear={modulus="1 N/cm"}}'
)
OWN_FABRIC = """
[fabric]
warp = { modulus = "520 N/cm", poisson = 0.45, yarns = "2.4 /cm", yarn_bending = "0.6 N mm^2" }
weft = { modulus = "260 N/cm", poisson = 0.225, yarns = "1.9 /cm", yarn_bending = "0.2 N mm^2" }
shear = { modulus = "0.96 N/cm" }
[preform]
outline = { polygon = [["0 mm", "0 mm"], ["40 mm", "0 mm"], ["40 mm", "60 mm"], ["0 mm", "60 mm"]],
            holes = [[["10 mm", "10 mm"], ["20 mm", "10 mm"], ["15 mm", "20 mm"]]] }
bias_angle = "30 deg"
refine = 4
origin = ["1 mm", "2 mm"]
[test]
kind = "bias-extension"
upper = "centre-line"
load = ["1 N", "2 N"]
model = "separate"
bending = false
[continuum]
compare = true
mesh_size = "0.5 mm"
ladder = [1, 2, 4]
[solver]
options = { ksp_type = "cg", ksp_rtol = 1e-9, ksp_max_it = 50, ksp_view = true }
[output]
directory = "results/own"
pictures = false
paraview = false
""".replace('"60 mm"]],\n            ', '"60 mm"]], ')  # an inline table is one line


FAMILY = '{modulus="400 N/mm", poisson=0, yarns="2 /cm", yarn_bending="1 N mm^2"}'
TENSION = '{law="table", strain="%", force="N/cm", points=[[0, 0], [0.5, 10], [1, 50]]}'


def sentences(error):
    """Problems of a case, without its name and lines."""
    problems = error.args[len(error.args) > 1 :]
    return [re.sub(r'^(".*", )?line \d+: ', "", problem) for problem in problems]


@pytest.fixture
def write(tmp_path):
    """Write a case file and return its path."""

    def writer(text: str):
        path = tmp_path / "case.toml"
        path.write_text(text, encoding="utf-8")
        return path

    return writer


def test_defaults(write):
    """Only fabric, outline, angle and one of extension and load are asked for."""
    case = Case.load(write(SPECIMEN))
    assert case.title == "the paper's specimen"
    assert case.fabric().warp.modulus == pytest.approx(52000.0)
    preform = case.preform()
    assert preform.outline.bounds == pytest.approx((-0.012, 0.0, 0.012, 0.036))
    assert (preform.refine, preform.yarns_per_cruciform, preform.origin) == (1, 1, None)
    test = case.test
    assert (test.kind, test.upper, test.model) == ("bias-extension", "grip", "coupled")
    assert (test.bending, test.is_curve) == (True, False)
    assert (test.control, test.values_si) == ("extension", [1e-3])
    assert (test.finite, test.increments, test.control, test.values_si) == (
        True,
        None,
        "extension",
        [1e-3],
    )
    assert (case.continuum.compare, case.continuum.mesh_size_si) == (False, None)
    assert (case.continuum.second_gradient, case.second_gradient) == (None, True)
    assert case.solver.options == {}
    assert (case.output.directory, case.output.pictures, case.output.paraview) == (
        "results/case",
        True,
        True,
    )
    assert Case.load(write(OWN_FABRIC), ["output.directory=here"]).output.directory == "here"


def test_everything_given(write):
    """Own fabric, polygon with a hole, a list of loads, all options."""
    case = Case.load(write(OWN_FABRIC))
    fabric = case.fabric()
    assert fabric.weft.poisson == 0.225
    assert fabric.weft.yarn_bending == pytest.approx(0.2e-6)
    preform = case.preform()
    assert preform.outline.area == pytest.approx(40e-3 * 60e-3 - 50e-6)
    assert preform.bias_angle == pytest.approx(math.radians(30))
    assert preform.lattice_origin == pytest.approx([1e-3, 2e-3])
    assert (preform.refine, case.preform(refine=8).refine) == (4, 8)
    assert (case.test.control, case.test.values_si, case.test.is_curve) == ("load", [1, 2], True)
    assert case.test.upper == "centre-line"
    assert case.continuum.mesh_size_si == pytest.approx(0.5e-3)
    assert case.continuum.ladder == [1, 2, 4]
    assert case.solver.options == {
        "ksp_type": "cg",
        "ksp_rtol": 1e-9,
        "ksp_max_it": 50,
        "ksp_view": True,
    }


@pytest.mark.parametrize("text", [SPECIMEN, OWN_FABRIC])
def test_dump_is_json_and_a_case_again(write, text):
    """What was run can be stored with the results and run again."""
    case = Case.load(write(text))
    dump = json.loads(json.dumps(case.model_dump()))
    assert set(dump) == {"title", "fabric", "preform", "test", "continuum", "solver", "output"}
    assert Case.from_data(dump) == case


ALONG = 'preform.bias_angle="0 deg"'


@pytest.mark.parametrize(
    ("overrides", "finite"),
    [
        (["test.model=separate"], False),
        (["continuum.ladder=[1, 2]"], False),
        (["continuum.ladder=[1, 2]", "continuum.compare=true"], False),
        (["continuum.ladder=[1, 2]", "test.finite=true"], True),
        (["continuum.ladder=[1]", "continuum.second_gradient=true"], True),
        (["test.model=coupled", "continuum.compare=true"], True),
    ],
)
def test_finite_unless_something_asks_for_small(write, overrides, finite):
    case = Case.load(write(SPECIMEN), overrides)
    assert case.test.finite is finite
    assert Case.from_data(case.model_dump()) == case


@pytest.mark.parametrize("finite", [False, True])
@pytest.mark.parametrize(
    ("overrides", "control", "values", "is_curve"),
    [
        (['test={extension="1 mm"}'], "extension", [1e-3], False),
        (['test={kind="bias-extension", load=["1 N"]}'], "load", [1.0], True),
        (['test={kind="pantograph", extension=["1 mm", "2 mm"]}'], "extension", [1e-3, 2e-3], True),
        (['test={kind="off-axis-tension", load="2 N", ends="free"}'], "load", [2.0], False),
        (
            ['test={kind="picture-frame", angle=["45 deg", "60 deg"]}', ALONG],
            "angle",
            [math.pi / 4, math.pi / 3],
            True,
        ),
        (
            ['test={kind="biaxial", strain="1 %", ratio=0.5}', 'preform.bias_angle="90 deg"'],
            "strain",
            [0.01],
            False,
        ),
        (['test={kind="cantilever", load="0.01 N", increments=5}', ALONG], "load", [0.01], False),
    ],
)
def test_kinds(write, overrides, control, values, is_curve, finite):
    """Every kind: what is prescribed, in SI; small or finite; the dump is the case again."""
    case = Case.load(write(SPECIMEN), [*overrides, f"test.finite={str(finite).lower()}"])
    test = case.test
    assert (test.control, test.is_curve, test.finite) == (control, is_curve, finite)
    assert test.values_si == pytest.approx(values)
    assert case.second_gradient is finite
    assert Case.from_data(json.loads(json.dumps(case.model_dump()))) == case


def test_biaxial_strains(write):
    """The ratio is that of weft over warp."""
    case = Case.load(
        write(SPECIMEN), ['test={kind="biaxial", strain=["1 %", "2 %"], ratio=-0.5}', ALONG]
    )
    assert (case.test.values_si, case.test.ratio) == (pytest.approx([0.01, 0.02]), -0.5)


def test_second_gradient_can_be_left_out(write):
    """On where the yarns bend at finite deformation, unless told otherwise."""
    finite = "test.finite=true"
    assert Case.load(write(SPECIMEN), [finite]).second_gradient is True
    assert Case.load(write(SPECIMEN), [finite, "test.bending=false"]).second_gradient is False
    off = Case.load(write(SPECIMEN), [finite, "continuum.second_gradient=false"])
    assert off.second_gradient is False


def test_a_rectangle_may_be_given_by_its_corners_and_have_a_hole(write):
    """Kinds that need a rectangle look at the shape, not at how it was written."""
    shape = (
        'preform.outline={polygon=[["5 cm", "0 cm"], ["5 cm", "5 cm"], ["0 cm", "5 cm"], '
        '["0 cm", "3 cm"], ["0 cm", "0 cm"]], '
        'holes=[[["1 cm", "1 cm"], ["2 cm", "1 cm"], ["1 cm", "2 cm"]]]}'
    )
    Case.load(write(SPECIMEN), ['test={kind="biaxial", strain="1 %"}', ALONG, shape])


def test_laws_beside_a_fabric_of_the_library(write):
    """Shear and tension replace the library's; the dump is the case again."""
    law = 'fabric.shear={law="table", angle="deg", force="N/mm", points=[[0, 0], [10, 0.01]]}'
    case = Case.load(write(SPECIMEN), [law, 'fabric.tension={strain="log", compression=0.01}'])
    fabric = case.fabric()
    assert fabric.name == "e-glass-plain-2.4, tension and shear replaced"
    assert fabric.warp.poisson == 0.45
    assert fabric.shear.evaluate(math.radians(10))[1] == pytest.approx(10.0)
    assert (fabric.log_strain, fabric.compression, fabric.compression_width) == (True, 0.01, 1e-4)
    assert Case.from_data(json.loads(json.dumps(case.model_dump()))) == case
    linear = Case.load(write(SPECIMEN), ['fabric.shear.modulus="2 N/cm"']).fabric()
    assert (linear.shear_modulus, linear.shear_law) == (pytest.approx(200.0), None)


def test_masses_and_thickness(write):
    """What exports need may stand beside a library's fabric, and is kept as written."""
    case = Case.load(write(SPECIMEN), ["fabric.thickness=0.5 mm"])
    assert case.fabric_table.thickness == "0.5 mm"
    fabric = case.fabric()
    assert fabric.thickness == pytest.approx(5e-4, rel=1e-14)
    assert fabric.fibre_volume_fraction == pytest.approx(0.4608)  # the library's masses
    with pytest.raises(InputError, match="fabric.thickness is the bare number 0.5"):
        Case.load(write(SPECIMEN), ["fabric.thickness=0.5"])
    with pytest.raises(InputError, match="a layer of 0.2304 mm without any gaps"):
        Case.load(write(SPECIMEN), ["fabric.thickness=0.2 mm"])


def test_a_fabric_with_laws_of_its_own(write):
    """All of a fabric's laws in a case file."""
    family = FAMILY.replace('modulus="400 N/mm"', f"tension={TENSION}")
    shear = '{law="sin-potential", coefficients=["0.0185 N/mm", "0.0464 N/mm", "-0.0213 N/mm"]}'
    case = Case.load(write(SPECIMEN), [f"fabric={{warp={family}, weft={FAMILY}, shear={shear}}}"])
    fabric = case.fabric()
    assert fabric.shear_modulus == pytest.approx(37.0)
    assert fabric.warp_tension.evaluate(0.01)[1] == pytest.approx(5000.0)
    assert fabric.warp.modulus == fabric.warp_law.stiffness0
    assert (fabric.weft_law, fabric.weft.modulus) == (None, pytest.approx(4e5))
    assert Case.from_data(json.loads(json.dumps(case.model_dump()))) == case


def test_rectangle_with_a_hole(write):
    """A hole can be cut from a rectangle too."""
    hole = 'preform.outline.holes=[[["0 mm", "9 mm"], ["5 mm", "9 mm"], ["0 mm", "19 mm"]]]'
    preform = Case.load(write(SPECIMEN), [hole]).preform()
    assert preform.outline.area == pytest.approx(24e-3 * 36e-3 - 25e-6)


def test_overrides(write):
    """Values are read as TOML, or taken as text if they are none; tables are made when missing."""
    overrides = [
        "preform.refine=4",
        "preform.bias_angle=30 deg",
        'test.extension=["1 mm", "2 mm"]',
        "continuum.compare=true",
        "solver.options.pc_type=gamg",
        'title = "a = b"',
    ]
    case = Case.load(write(SPECIMEN), overrides)
    assert case.preform().refine == 4
    assert case.preform().bias_angle == pytest.approx(math.radians(30))
    assert case.test.values_si == pytest.approx([1e-3, 2e-3])
    assert case.continuum.compare is True
    assert case.solver.options == {"pc_type": "gamg"}
    assert case.title == "a = b"


def test_overrides_of_tables_in_a_list(write):
    """By their numbers, from zero, as sentences have them."""
    forming = [
        'test = { kind = "forming" }',
        'tool = [{ name = "die", shape.plane = {} }, { name = "punch", shape.plane = {} }]',
        'stage = [{ name = "close", force = { punch = "50 N" } }]',
    ]
    path = write(SPECIMEN)
    for override, said in (
        ("tool[1].friction=much", "tool[1].friction "),
        ("stage[0].force.punch=3 m", "stage[0].force.punch "),
        ("tool[2].friction=1", "there is no tool[2]"),
        ("tool.friction=1", "tool is a list, write tool[0].friction"),
        ("preform[0].refine=1", "there is no preform[0]"),
        ("test.kind[0]=1", "there is no test.kind[0]"),
    ):
        with pytest.raises(InputError) as caught:
            Case.load(path, [*forming, override])
        assert said in str(caught.value)
    case = Case.load(path, ['test.extension=["1 mm", "2 mm"]', "test.extension[1]=5 mm"])
    assert case.test.values_si == pytest.approx([1e-3, 5e-3])


@pytest.mark.parametrize("override", ["preform.refine", "=4", "a..b=1", "a b=1", ""])
def test_bad_override(write, override):
    """An override that is none says how one looks."""
    with pytest.raises(InputError) as caught:
        Case.load(write(SPECIMEN), [override])
    assert str(caught.value) == f'--set "{override}" is not of the form preform.refine=4'


@pytest.mark.parametrize(
    ("overrides", "message"),
    [
        (["preform.refin=4"], '[preform] has the unknown key "refin" (did you mean "refine"?)'),
        (
            ["prefrom.refine=4"],
            'the case file has the unknown key "prefrom" (did you mean "preform"?)',
        ),
        (
            ["preform.outline.polgon=1"],
            '[preform.outline] has the unknown key "polgon" (did you mean "polygon"?)',
        ),
        (
            ['fabric={warp={modulus="1 N/cm", poisson=0.1, yarns="1 /cm", colour=1}}'],
            '[fabric.warp] has the unknown key "colour" '
            "(known: tension, modulus, poisson, yarns, yarn_bending, out_of_plane_bending, "
            "out_of_plane_moment)",
        ),
        (["title.x=3"], '--set "title.x=3": title is a value, not a table'),
        (["preform.refine=4.5"], "preform.refine must be a whole number, got 4.5"),
        (["preform.refine=two"], "preform.refine must be a whole number, got 'two'"),
        (["preform.refine=true"], "preform.refine must be a whole number, got True"),
        (["preform.refine=0"], "preform.refine must be a whole number from 1 up, got 0"),
        (["test.bending=1"], "test.bending must be true or false, got 1"),
        (["test=3"], "test must be a table, got 3"),
        (["title=3"], "title must be a text in quotes, got 3"),
        (['output.directory=""'], "output.directory must be a name that is not empty, got ''"),
        (['output.directory=" "'], "output.directory must be a name that is not empty, got ' '"),
        (["test.upper=clamp"], 'test.upper must be "grip" or "centre-line", got \'clamp\''),
        (
            ["test.kind=bias"],  # nearer to "biaxial" by its letters
            f'test.kind: there is no kind of test "bias" (did you mean "bias-extension"? {KNOWN})',
        ),
        (
            ["test.kind=bias-extention"],
            'test.kind: there is no kind of test "bias-extention" (did you mean "bias-extension"? '
            f"{KNOWN})",
        ),
        (["test.kind=[1]"], f'test.kind: there is no kind of test "[1]" ({KNOWN})'),
        (["test=[1]"], "test must be a table, got [1]"),
        (
            ["preform.bias_angle=45"],
            'preform.bias_angle is the bare number 45, give it a unit like "45 deg"',
        ),
        (
            ["test.extension=1 N"],
            'test.extension = "1 N" has the unit "N", which is not that of a length like "1 mm"',
        ),
        (
            ['test.extension=["1 mm", 2]'],
            'test.extension (value 2) is the bare number 2, give it a unit like "1 mm"',
        ),
        (["test.extension=[]"], "test.extension is an empty list, give at least one value"),
        (["test.load=1 N"], "test needs exactly one of extension and load, got both"),
        (["test={}"], "test needs exactly one of extension and load, got neither"),
        (
            ["fabric={}"],
            "fabric needs use, from_datasheet, or warp, weft and shear (warp and weft and shear "
            "missing)",
        ),
        (
            ["fabric.warp=" + FAMILY],
            "fabric needs either use or warp, weft and shear, not use and warp (beside use only "
            "shear, shear_viscosity, shear_friction, tension, out_of_plane_bending, areal_density, "
            "thickness, fibre_density, out_of_plane_twisting and weave may stand)",
        ),
        (
            ["fabric.shear.law=spline"],
            'fabric.shear.law must be "table", "polynomial" or "sin-potential", got \'spline\'',
        ),
        (["fabric.shear={}"], "fabric.shear needs modulus or law"),
        (
            ['fabric.shear={law="table", angle="deg", force="N/mm"}'],
            "fabric.shear.points is missing",
        ),
        (
            ['fabric.shear={law="table", angle="deg", force="N", points=[[10, 1]]}'],
            'fabric.shear.force = "N" has the unit "N", which is not that of a force per width '
            'like "N/cm"',
        ),
        (
            ['fabric.shear={law="table", angle="deg", force="N/mm", points=[[0, 0], [1, 2, 3]]}'],
            "fabric.shear.points[1] must be a list of 2, got 3",
        ),
        (
            ['fabric.shear={law="polynomial", coefficients=["1 N/mm", 2]}'],
            "fabric.shear.coefficients (value 2) is the bare number 2, give it a unit like "
            '"520 N/cm"',
        ),
        (
            ['fabric.shear={law="sin-potential", coefficient=["1 N/mm"]}'],
            '[fabric.shear] has the unknown key "coefficient" (did you mean "coefficients"?)',
        ),
        (
            ['fabric.tension.strain="true"'],
            'fabric.tension.strain must be "engineering" or "log", got \'true\'',
        ),
        (
            ["fabric.tension.compression=0"],
            "fabric.tension.compression must be above 0 and at most 1, got 0",
        ),
        (
            ["fabric.tension.compression_width=nan"],
            "fabric.tension.compression_width must be a finite number, got nan",
        ),
        (
            ["fabric.warp={tension=3}"],
            "fabric.warp.tension must be a table, got 3; fabric.warp.yarns is missing",
        ),
        (
            [f"fabric={{warp={FAMILY}, weft={FAMILY}}}", f"fabric.warp.tension={TENSION}"],
            "fabric.warp.modulus cannot stand beside tension, a law in its place",
        ),
        (
            ["test.kind=pantograph", "test.load=1 N"],
            '[test] has the unknown key "load" (known: kind, bending, model, finite, space, '
            "imperfection, slip, stability, increments, speed, temperature, extension)",
        ),
        (['test={kind="picture-frame"}'], "test.angle is missing"),
        (
            ['test={kind="picture-frame", angle=["5 deg", "-95 deg"]}'],
            'test.angle (value 2) must be between -90 deg and 90 deg, got "-95 deg"',
        ),
        (
            ['test={kind="picture-frame", angle="5 deg"}'],
            'test.kind = "picture-frame" needs yarns along the edges: preform.bias_angle = '
            '"0 deg" or "90 deg", got "45 deg"',
        ),
        (
            ['test={kind="biaxial", strain="1 %"}', 'preform.bias_angle="89.9 deg"'],
            'test.kind = "biaxial" needs yarns along the edges: preform.bias_angle = "0 deg" or '
            '"90 deg", got "89.9 deg"',
        ),
        (
            [
                'test={kind="cantilever", load="1 N"}',
                'preform.outline={polygon=[["0 cm", "0 cm"], ["5 cm", "0 cm"], ["4 cm", "5 cm"], '
                '["0 cm", "5 cm"]]}',
            ],
            'test.kind = "cantilever" needs preform.outline to be a rectangle with upright sides',
        ),
        (
            ['test={kind="cantilever", load="1 N", bending=false}'],
            'test has kind = "cantilever", which needs bending = true',
        ),
        (
            ['test={kind="off-axis-tension"}'],
            "test needs exactly one of extension and load, got neither",
        ),
        (
            ['test={kind="off-axis-tension", load="1 N", ends="fre"}'],
            'test.ends must be "grip" or "free", got \'fre\'',
        ),
        (
            ['test={kind="biaxial", strain="1 mm"}'],
            'test.strain = "1 mm" has the unit "mm", which is not that of a strain like "1 %"',
        ),
        (
            ['test={kind="biaxial", strain=["1 %", "-100 %"]}'],
            'test.strain (value 2) must be more than -100 %, got "-100 %"',
        ),
        (
            ['test={kind="biaxial", strain="1 %", ratio=-200}'],
            "test prescribes a weft strain (strain times ratio) of -200 %, it must be more than "
            "-100 % and at most 1e+06 %",
        ),
        (
            ['test={kind="biaxial", strain="1e5 %", ratio=1e12}'],
            "test prescribes a weft strain (strain times ratio) of 1e+17 %, it must be more than "
            "-100 % and at most 1e+06 %",
        ),
        (
            ['test={kind="biaxial", strain="1 %", ratio=nan}'],
            "test.ratio must be a finite number, got nan",
        ),
        (
            ['test={kind="biaxial", strain="1 %", ration=2}'],
            '[test] has the unknown key "ration" (did you mean "ratio"?)',
        ),
        (["test.finite=1"], "test.finite must be true or false, got 1"),
        (["test.increments=0"], "test.increments must be a whole number from 1 up, got 0"),
        (
            ["test.finite=true", "test.model=separate"],
            'test has model = "separate" and finite = true, but the separate systems are for '
            "small displacements only",
        ),
        (
            ["continuum.second_gradient=true", "test.finite=false"],
            "continuum.second_gradient = true needs test.finite = true",
        ),
        (
            ["continuum.second_gradient=true", "test.finite=true", "test.bending=false"],
            "continuum.second_gradient = true needs test.bending = true",
        ),
        (
            ["fabric.warp={poisson=0.1}"],
            "fabric.warp.modulus is missing; fabric.warp.yarns is missing",
        ),
        (
            ["fabric.use=e-glas-plain"],
            'fabric.use: there is no fabric "e-glas-plain" in the library '
            '(did you mean "e-glass-plain-2.4"? known: "' + '", "'.join(fabric_names()) + '")',
        ),
        (
            ["preform.outline={}"],
            "preform.outline needs exactly one of rectangle, circle, ellipse, slot, cross, polygon "
            "and file",
        ),
        (
            ['preform.outline={rectangle=["1 mm"]}'],
            "preform.outline.rectangle must be a list of 2, got 1",
        ),
        (
            ['preform.outline={polygon=[["1 mm", "1 mm"], ["2 mm", "1 mm"]]}'],
            "preform.outline.polygon must be a list of at least 3, got 2",
        ),
        (
            ['preform.outline={rectangle=["1 mm", "1 mm"]}'],
            "preform.outline (1 mm x 1 mm) is smaller than one cruciform (4.16667 mm x "
            "4.16667 mm along the yarns), make it larger or raise preform.refine",
        ),
        (
            ['preform.outline={polygon=[["0 cm", "0 cm"], ["5 cm", "0 cm"], ["2 cm", "5 cm"]]}'],
            'test.kind = "bias-extension": preform has no edge "upper" (no straight piece of the '
            "outline lies at its largest y, known: lower, outline-1 to outline-3)",
        ),
        (["continuum.mesh_size=0 mm"], 'continuum.mesh_size must be positive, got "0 mm"'),
        (
            ["continuum.ladder=[1, 0]"],
            "continuum.ladder[1] must be a whole number from 1 up, got 0",
        ),
        (
            ["continuum.ladder=[1, 2]", "preform.yarns_per_cruciform=2"],
            "continuum.ladder refines the network, so preform.yarns_per_cruciform must be 1, got 2",
        ),
        (
            ["solver.options={'-ksp_type'='cg'}"],
            'solver.options has the option "-ksp_type", write it like "ksp_type", without a dash',
        ),
        (
            ["solver.options={ksp_rtol=[1]}"],
            'solver.options "ksp_rtol" must be a number from 1e-16 to 1, got [1]',
        ),
        (
            ["test.finite=false", "test.space=true"],
            "test.space = true needs finite = true: small displacements are flat",
        ),
        (
            ["test.finite=true", 'test.imperfection={height="1 mm"}'],
            "test.imperfection needs space = true: in the plane nothing can buckle",
        ),
        (
            ["test.finite=true", "test.space=true", 'test.imperfection={height="-1 mm"}'],
            'test.imperfection.height must be positive, got "-1 mm"',
        ),
        (
            ["test.model=truss", "test.finite=false"],
            'test has model = "truss", which is for finite deformation only',
        ),
        (
            ["test.model=truss", "test.space=true", 'test.imperfection={height="1 mm"}'],
            "test.imperfection is what yarns are bent by, and those of a truss do not",
        ),
        (
            ["test.finite=false", "test.stability={}"],
            "test.stability needs finite = true: small displacements are always stable",
        ),
        (
            ["test={load='1 N', stability={}}"],
            "test.stability follows the extension, give that in place of load",
        ),
        (
            ["test.finite=true", 'test.stability={step="0 mm"}'],
            'test.stability.step must be other than 0, got "0 mm"',
        ),
        (
            ["test.finite=true", "test.stability={modes=0}"],
            "test.stability.modes must be a whole number from 1 up, got 0",
        ),
        (
            ["test.finite=true", "test.space=true", "output.exports=true"],
            "output.exports = true is for flat cloth, it needs test.space = false",
        ),
        (
            [OWN_FABRIC_KEYS, "test.finite=true", "test.space=true"],
            "fabric.warp.out_of_plane_bending is missing, which test.space = true needs: per "
            'width, as measured with a cantilever or KES, for example "0.2 N mm", or per yarn, '
            'for example "0.6 N mm^2"',
        ),
        (
            ["a=1", "b=1", "c=1", "d=1"],
            "; ".join(
                f'the case file has the unknown key "{key}" '
                "(known: title, fabric, preform, test, tool, ply, clamp, stage, continuum, solver, "
                "output)"
                for key in "abcd"
            ),
        ),
    ],
)
def test_refused(write, overrides, message):
    """Each mistake is one sentence with its key."""
    with pytest.raises(InputError) as caught:
        Case.load(write(SPECIMEN), overrides)
    assert "; ".join(sentences(caught.value)) == message


def test_bending_needs_a_bending_rigidity(write):
    """Bending of yarns without rigidity would leave rotations without stiffness."""
    text = OWN_FABRIC.replace(', yarn_bending = "0.2 N mm^2"', "")
    Case.load(write(text))
    with pytest.raises(InputError) as caught:
        Case.load(write(text), ["test.bending=true"])
    assert "; ".join(sentences(caught.value)) == (
        "test.bending is true but fabric.weft.yarn_bending is zero, "
        "give it a value or set test.bending = false"
    )


def test_missing_keys(tmp_path):
    """A file that says nothing is told what it lacks; an empty one, that it is."""
    path = tmp_path / "empty.toml"
    path.write_text("# nothing\n")
    with pytest.raises(InputError) as caught:
        Case.load(path)
    assert str(caught.value) == (
        f'case file "{path}" has 3 problems:\nfabric is missing\npreform is missing\n'
        "test is missing"
    )
    path.write_text("\n")
    with pytest.raises(InputError, match="is empty$"):
        Case.load(path)


def test_files(tmp_path, write):
    """Whatever is wrong with the file itself is one sentence."""
    good = write(SPECIMEN)
    latin = tmp_path / "latin.toml"
    latin.write_bytes(b'title = "gr\xfcn"')
    text = tmp_path / "no.toml"
    text.write_text("title = 'a'\nthis is not TOML\n")
    for path, message in [
        (tmp_path / "cas.toml", f'"{tmp_path}/cas.toml" does not exist, did you mean "{good}"?'),
        (tmp_path / "no" / "x.toml", f'"{tmp_path}/no/x.toml" does not exist'),
        (tmp_path, f'"{tmp_path}" is a folder, name a TOML file in it'),
        (good / "x", f'"{good}/x" cannot be read: Not a directory'),
        (latin, f'"{latin}" is not UTF-8 text (byte 12), save it as UTF-8'),
    ]:
        with pytest.raises(InputError) as caught:
            Case.load(path)
        assert str(caught.value) == f"case file {message}"
    with pytest.raises(InputError, match=r"no\.toml\" is not TOML: .*at line 2, column"):
        Case.load(text)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        *(
            (f"{name}={value}", f'has the option "{name}", which a case file may not set')
            for name, value in (
                ("nonsense", "3"),
                ("pc_python_type", "'evil.py:Boom'"),
                ("mg_levels_pc_python_type", "'evil.Boom'"),
                ("sub_0_pc_PYTHON_type", "'evil.Boom'"),
                ("pc_composite_pcs", "'python,jacobi'"),
                ("PC_TYPE", "'cg'"),
                ("ksp_VIEW", "'binary'"),
                ("ksp_view_mat", "'binary'"),
                ("pc_mg_dump_binary", "true"),
                ("mat_mumps_ooc_tmpdir", "'/etc'"),
                ("mat_mumps_icntl_22", "1"),
                ("mat_mumps_icntl_1", "7"),
                ("options_file", "'x'"),
                ("snes_rtol", "1e-3"),
                ("mat_mumps_icntl_99", "1"),
                ("sub_sub_sub_sub_pc_type", "'lu'"),
            )
        ),
        *(
            (f"{name}={value}", f'"{name}" must be {what}')
            for name, value, what in (
                ("pc_type", "'python'", "one of none, jacobi, "),
                ("ksp_type", "'PYTHON'", "one of preonly, cg, "),
                ("pc_type", "'a/b'", "one of none, jacobi, "),
                ("pc_sor_its", "2_000_000_000", "a whole number from 1 to 100, got 2000000000"),
                ("mg_levels_pc_sor_lits", "-1", "a whole number from 1 to 100, got -1"),
                ("ksp_max_it", f"1{'0' * 12}", "a whole number from 1 to 1000000, got "),
                ("ksp_max_it", "30.0", "a whole number from 1 to 1000000, got 30.0"),
                ("ksp_max_it", "true", "a whole number from 1 to 1000000, got True"),
                ("ksp_rtol", "nan", "a number from 1e-16 to 1, got nan"),
                ("pc_sor_omega", "1e308", "a number from 0.001 to 1.999, got 1e+308"),
                ("snes_type", "'ksponly'", "one of newtonls, got 'ksponly'"),
                ("pc_gamg_repartition", "1", "true or false, got 1"),
                ("ksp_view", "':file.txt'", "true or false"),
                ("ksp_converged_reason", "'binary'", "true or false"),
                ("sub_ksp_monitor", "'ascii'", "true or false"),
            )
        ),
    ],
)
def test_options_neither_run_code_nor_write_files(write, options, message):
    """A case file, or a checkpoint, which holds one, may come from anybody."""
    overrides = [f"solver.options={{{options}}}"]
    with pytest.raises(InputError, match=re.escape(f"solver.options {message}")):
        Case.load(write(SPECIMEN), overrides)
    data = Case.load(write(SPECIMEN)).model_dump()
    data["solver"]["options"] = tomllib.loads(options)
    with pytest.raises(InputError, match=re.escape(message)):
        Case.from_data(data)


def test_options_are_counted_and_slips_are_named(write):
    many = ", ".join(f"o{i}=1" for i in range(101))
    with pytest.raises(InputError, match="solver.options has 101 options, at most 100 can"):
        Case.load(write(SPECIMEN), [f"solver.options={{{many}}}"])
    with pytest.raises(InputError, match=r'without end \(did you mean "mg_levels_ksp_max_it"\?\)'):
        Case.load(write(SPECIMEN), ["solver.options={mg_levels_ksp_maxit=3}"])


def test_the_program_s_own_settings_may_be_set(write):
    """What it gives PETSc itself, and what the documentation names, a case may give, too."""
    own = petsc.DIRECT | petsc.ITERATIVE | petsc.YARN_MULTIGRID | petsc.LEAST_NORM
    own |= {"mg_yarn_sweeps": 3, "ksp_view": True, "mat_mumps_icntl_14": 300}
    own |= {"pc_hypre_type": "boomeramg", "pc_gamg_threshold": 0.01, "mg_levels_1_pc_type": "sor"}
    data = Case.load(write(SPECIMEN)).model_dump()
    data["solver"]["options"] = own
    assert Case.from_data(data).solver.options == own


# -- for editors -----------------------------------------------------------------------------------


def test_json_schema_takes_what_a_case_may_be():
    """All demos, and a new case of every kind."""
    schema = Case.json_schema()
    cases = [path.read_text() for path in DEMOS.glob("*.toml")]
    cases += [new_case(kind) for kind in KINDS]
    assert len(cases) > 15
    for text in cases:
        assert problems(schema, tomllib.loads(text)) == [], text
    assert "null" not in json.dumps(schema)


@pytest.mark.parametrize(
    ("override", "said"),
    [
        ({"preform": {"bias_angel": "3 deg"}}, ".preform: "),
        ({"test": {"kind": "bias"}}, ".test.kind"),
        ({"test": {"bending": 1}}, ".test.bending: no boolean"),
        ({"output": {"directory": ""}}, ".output.directory: not minLength 1"),
        ({"colour": 1}, ": unknown colour"),
        ({"fabric": {"use": 3}}, ".fabric.use: no string"),
        ({"preform": {"refine": 0}}, ".preform"),
    ],
)
def test_json_schema_refuses(override, said):
    data = tomllib.loads((DEMOS / "bias_extension.toml").read_text())
    for key, value in override.items():
        data[key] = data.get(key, {}) | value if isinstance(value, dict) else value
    assert any(said in problem for problem in problems(Case.json_schema(), data))


def test_paths_are_keys_that_set_takes(write):
    """Each of them is known, so the complaint is about its value or another key, never its name."""
    assert {"title", "preform.bias_angle", "tool[0].friction", "test.ratio"} <= set(Case.paths())
    for path in Case.paths():
        with pytest.raises(InputError) as caught:
            Case.load(write(SPECIMEN), ["tool = [{}]", "stage = [{}]", f"{path}={{ no_such = 1 }}"])
        assert f'unknown key "{path.rpartition(".")[2]}"' not in str(caught.value) or (
            path.startswith("test.")
        )
