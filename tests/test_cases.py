# SPDX-License-Identifier: MIT
"""Cases of the kinds that people who test fabrics write, and what is right to make of them."""

import json
import logging
import re
import warnings
from pathlib import Path

import numpy as np
import pytest
from mpi4py import MPI

from cruciform_petsc import BiasExtension, InputError, InputWarning, Network, Preform, laws
from cruciform_petsc.case.schema import Case
from cruciform_petsc.experiments import limits
from cruciform_petsc.run import check_case, run_case
from tests.support.helpers import TABLE_1, UNEVEN

DEMOS = Path(__file__).parents[1] / "demos"
YARNS = 'modulus = "520 N/cm", poisson = 0, yarns = "2.4 /cm", yarn_bending = "0.6 N mm^2"'
CASE = f"""
title = "t"
[fabric]
warp = {{ {YARNS} }}
weft = {{ {YARNS} }}
shear = SHEAR
[preform]
outline = {{ rectangle = [SIDES] }}
bias_angle = "45 deg"
[test]
kind = "bias-extension"
finite = true
extension = ["2 mm", "5 mm"]
[output]
pictures = false
paraview = false
"""


def case_file(folder, shear='{ modulus = "0.96 N/cm" }', sides='"50 mm", "120 mm"', more=()):
    """Write a case with the given shear, sides and further replacements; its path."""
    text = CASE.replace("SHEAR", shear).replace("SIDES", sides)
    for old, new in more:
        assert old in text
        text = text.replace(old, new)
    path = folder / "case.toml"
    path.write_text(text)
    return path


# -- far from x = y = 0 ----------------------------------------------------------------------------


def loads(preform, fabric=UNEVEN, **keys):
    """Loads of a bias test, small or finite, and its Newton iterations."""
    network = Network(MPI.COMM_SELF, preform, fabric)
    result = BiasExtension(network, extension=["1 mm", "4 mm"], **keys).solve()
    return result.loads, sum(increment.iterations for increment in result.increments)


@pytest.mark.parametrize("finite", [True, False])
def test_origin_moved_by_whole_pitches(finite):
    """The same lattice, so the same result, 30 m away as in the specimen; and with refine."""
    near, turn = np.array([1e-3, 2e-3]), Preform.rectangle(1, 1, "45 deg").rotation
    for refine in (1, 2):
        pitch = np.array([UNEVEN.weft.spacing, UNEVEN.warp.spacing]) / refine
        expected = None
        for pitches in ((0, 0), (8000, -5000), (-7001, 3)):
            origin = tuple(near + (pitches * pitch) @ turn)
            preform = Preform.rectangle(0.03, 0.07, "45 deg", origin=origin, refine=refine)
            found, _ = loads(preform, finite=finite)
            expected = found if expected is None else expected
            # CG at small displacements stops at a residual of 1e-10 of the load's.
            np.testing.assert_allclose(found, expected, rtol=1e-10 if finite else 1e-9)


@pytest.mark.parametrize("finite", [True, False])
@pytest.mark.parametrize("far", [(0.0, 30.0), (-1000.0, 20.0)])
def test_outline_far_away(far, finite):
    """A polygon's corners may be anywhere; coordinates are rounded to what they are there."""
    corners = np.array([(0.0, 0.0), (0.03, 0.0), (0.03, 0.07), (0.0, 0.07)])
    here, steps = loads(Preform.polygon(corners.tolist()), TABLE_1, finite=finite)
    there, more = loads(Preform.polygon((corners + far).tolist()), TABLE_1, finite=finite)
    np.testing.assert_allclose(there, here, rtol=1e-6)
    assert more <= 2 * steps


def test_origin_far_in_a_case(tmp_path):
    """It was "no equilibrium" from 12.5 m on."""
    table = '{ law = "table", angle = "deg", force = "N/mm", points = [[5, 0.01], [60, 1]] }'
    origin = ("bias_angle", 'origin = ["0 mm", "30 m"]\nbias_angle')
    case = Case.load(case_file(tmp_path, table, more=[origin]))
    network = Network(MPI.COMM_SELF, case.preform(), case.fabric())
    assert abs(network.crossover_ij).max() < 40
    assert case.experiment(network).solve().load > 0


# -- what is hardly meant --------------------------------------------------------------------------

POINTS = 'law = "table", angle = "deg", force = "N/mm", points ='
STRAINS = 'law = "table", strain = "%", force = "N/cm", points ='


@pytest.mark.parametrize(
    ("shear", "message"),
    [
        # radians_as_degrees: 232 N in place of 1.4 N
        (f"{POINTS} [[0, 0], [0.35, 0.02], [0.7, 0.2]]", 'up to 0.7 deg, is angle = "rad" meant?'),
        (f"{POINTS} [[1.5, 0.2]]", 'go up to 1.5 deg, is angle = "rad" meant?'),
        (f"{POINTS} [[10, 0.2], [95, 1]]", 'go up to 95 deg, is angle = "deg" meant?'),
        (f"{POINTS} [[10, 0.2], [20, -0.1]]", "must not go below zero, as its point 2 does"),
        (f"{POINTS} [[0, 0], [9, 1], [20, -1], [30, 2]]", "below zero, as its point 3 does"),
    ],
)
def test_tables_that_cannot_be(tmp_path, shear, message):
    """Refused, with their line."""
    with pytest.raises(InputError) as caught:
        Case.load(case_file(tmp_path, f"{{ {shear} }}"))
    assert ", line 6: fabric.shear.points" in str(caught.value)
    assert message in str(caught.value)


@pytest.mark.parametrize(
    ("points", "message"),
    [
        ("[[0.01, 50], [0.03, 200]]", 'go up to 0.03 %, is strain = "1" meant?'),
        ("[[50, 50], [200, 90]]", 'go up to 200 %, is strain = "%" meant?'),
        ("[[0.5, 50], [2, -1]]", "must not go below zero, as its point 2 does"),
    ],
)
def test_tables_of_tension_that_cannot_be(tmp_path, points, message):
    law = ('modulus = "520 N/cm"', f"tension = {{ {STRAINS} {points} }}")
    with pytest.raises(InputError, match=re.escape(message)):
        Case.load(case_file(tmp_path, more=[law]))


def test_laws_in_python_that_cannot_be():
    """Points in degrees where they are radians; below zero."""
    with pytest.raises(InputError, match="points up to 60 rad, is 60 deg meant"):
        TABLE_1.with_shear_law(laws.table([10, 60], [20, 300]))
    TABLE_1.with_shear_law(laws.table(np.deg2rad([10, 90]), [20, 300]))
    with pytest.raises(InputError, match="below zero, as its point 1 does"):
        laws.table([0.1, 0.2], [-1.0, 2.0])


BIAS = 'kind = "bias-extension"\nfinite = true\nextension = ["2 mm", "5 mm"]'
HOLE = '], holes = [[["0 mm", "20 mm"], ["0.2 mm", "20 mm"], ["0 mm", "20.2 mm"]]] }'
_HOLES = [
    f'["{x} mm", "20 mm"], ["{x + w} mm", "20 mm"], ["{x} mm", "22 mm"]'
    for x, w in ((0, 9), (12, 0.2), (14, 0.2), (16, 0.2))
]
HOLES = f"], holes = [{', '.join(f'[{corners}]' for corners in _HOLES)}] }}".replace(
    "22 mm", "20.2 mm"
)
REMARKS = {
    "swapped": ({"sides": '"120 mm", "50 mm"'}, "H < 2 W: yarns run from clamp to clamp and carry"),
    "short": ({"sides": '"50 mm", "80 mm"'}, "H < 2 W: the usual zones of a bias test"),
    "half": (
        {"sides": '"50 mm", "40 mm"', "more": [("[test]", '[test]\nupper = "centre-line"')]},
        "H < 2 W: the usual zones",
    ),
    "bias in radians": (
        {"more": [("45 deg", "0.785 deg")]},
        'preform.bias_angle is 0.785 deg, is "0.785 rad" (45 deg) meant?',
    ),
    "minus 30 degrees in radians": (
        {"more": [("45 deg", "-0.524 deg")]},
        'preform.bias_angle is -0.524 deg, is "-0.524 rad" (30 deg) meant?',
    ),
    "frame in radians": (
        {
            "sides": '"50 mm", "50 mm"',
            "more": [
                ("45 deg", "0 deg"),
                (BIAS, 'kind = "picture-frame"\nangle = ["0.35 deg", "0.7 deg"]'),
            ],
        },
        'test.angle is 0.7 deg, is "0.7 rad" (40 deg) meant?',
    ),
    "cm for mm": (
        {"more": [('"5 mm"', '"50 cm"')]},
        "test.extension = 500 mm is more than the specimen's length of 120 mm",
    ),
    "m for mm": ({"sides": '"50 mm", "12 m"'}, "50 mm wide and 12000 mm long, which unit is meant"),
    "thread": ({"sides": '"10 mm", "550 mm"'}, "10 mm wide and 550 mm long, which unit is meant"),
    "hole in um": (
        {"more": [('"120 mm"] }', f'"120 mm"{HOLE}')]},
        "hole-1 of preform.outline is 0.2 mm large, less than a tenth",
    ),
    "holes in um": (
        {"more": [('"120 mm"] }', f'"120 mm"{HOLES}')]},
        "hole-2 of preform.outline is 0.2 mm large, less than a tenth of the distance of yarns, "
        "and so are 2 others, which",
    ),
    "thickness in cm": (
        {"more": [("[preform]", 'thickness = "5 cm"\n[preform]')]},
        "fabric.thickness = 50 mm is more than ten times the distance of yarns",
    ),
    "falling": (
        {"shear": f"{{ {POINTS} [[5, 0.1], [20, 0.3], [30, 0.2], [50, 1]] }}"},
        "fabric.shear is a law that falls from 20 to 30 deg",
    ),
    "falling yarn": (
        {
            "more": [
                ('modulus = "520 N/cm"', f"tension = {{ {STRAINS} [[1, 500], [2, 400]] }}"),
            ]
        },
        "fabric.warp.tension is a law that falls from 1 to 2 %",
    ),
    "formula below zero": (
        {"shear": '{ law = "polynomial", coefficients = ["1 N/mm", "-4 N/mm"] }'},
        "fabric.shear is a law that goes below zero from 29 deg on",
    ),
}


@pytest.mark.parametrize("name", REMARKS)
def test_remarks(tmp_path, name):
    """What can be, but is hardly meant, is asked about."""
    keys, message = REMARKS[name]
    case = Case.load(case_file(tmp_path, **keys))
    found = limits.remarks(case.preform(), case.fabric(), case.test)
    assert any(message in sentence for sentence in found), found
    assert len(found) == 1 + (name == "falling yarn")  # the weft has the same law


@pytest.mark.parametrize("demo", sorted(DEMOS.glob("*.toml")), ids=lambda path: path.stem)
def test_the_demos_are_meant(demo):
    """No remark but that the paper's specimen is a short one."""
    case = Case.load(demo)
    found = limits.remarks(case.preform(), case.fabric(), case.test)
    assert not [sentence for sentence in found if "the usual zones" not in sentence]


@pytest.mark.parametrize("key", ["extension = ", "extension = [", "load = "])
def test_lengths_that_no_specimen_is_pulled_by(tmp_path, key):
    """10 m on 120 mm is refused; a load that moves a specimen by more than it is long, told."""
    value = {"extension = ": '"10 m"', "extension = [": '"1 mm", "-10 m"]', "load = ": '"100 N"'}
    more = [(BIAS, f'kind = "off-axis-tension"\nfinite = false\n{key}{value[key]}')]
    path = case_file(tmp_path, more=more)
    if "load" not in key:
        with pytest.raises(InputError) as caught:
            Case.load(path)
        assert "test.extension = 10000 mm is 83.3 times the specimen's length" in str(caught.value)
        return
    case = Case.load(path)
    network = Network(MPI.COMM_SELF, case.preform(), case.fabric())
    (told,) = [s for s in limits.warnings(case.experiment(network).solve()) if "unit" in s]
    assert re.search(r"the extension reaches [\d.]+ mm, more than the specimen's size", told)


def test_bare_lengths_in_python():
    """Metres, as documented: a specimen of 120, or pulled by 20, is asked about."""
    for make in (
        lambda: Preform.rectangle(50, 120),
        lambda: Preform.polygon([[0, 0], [50, 0], [50, 120.0], [0, 120]]),
    ):
        with pytest.raises(InputError, match='120 m large, .*did you mean "120 mm"'):
            make()
    Preform.rectangle("50 m", "120 m")
    network = Network(MPI.COMM_SELF, Preform.rectangle(0.05, 0.12), TABLE_1)
    with pytest.raises(InputError, match="20000 mm is 167 times the specimen's length"):
        BiasExtension(network, extension=20)
    with pytest.warns(InputWarning, match=r"0\.5.* mm is more than|500 mm is more than"):
        BiasExtension(network, extension=0.5)


def test_remarks_warn_in_python():
    """Once for each, as an InputWarning; none where all is well."""
    network = Network(MPI.COMM_SELF, Preform.rectangle(0.12, 0.05), TABLE_1)
    with pytest.warns(InputWarning, match="width and length swapped") as caught:
        test = BiasExtension(network, extension="1 mm")
    assert [str(one.message) for one in caught] == test.remarks
    assert caught[0].filename == __file__  # the line to be mended, not one of the program
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        BiasExtension(Network(MPI.COMM_SELF, Preform.rectangle(0.05, 0.12), TABLE_1), "1 mm")


def test_remarks_everywhere(tmp_path):
    """In `check`, the log, summary.json and the report: width_and_length_swapped."""
    case = Case.load(
        case_file(tmp_path, sides='"60 mm", "25 mm"', more=[('["2 mm", "5 mm"]', '"1 mm"')])
    )
    lines = []
    log = logging.Logger("test")
    handler = logging.Handler()
    handler.emit = lambda record: lines.append((record.levelname, record.getMessage()))
    log.addHandler(handler)
    check_case(MPI.COMM_SELF, case, log)
    (told,) = [text for level, text in lines if level == "WARNING"]
    assert told.endswith("carry the load, are width and length swapped?")
    lines.clear()
    output = case.output.model_copy(update={"report": True})
    run_case(MPI.COMM_SELF, case.model_copy(update={"output": output}), tmp_path, log)
    assert next(text for level, text in lines if level == "WARNING") == told
    sentence = told.removeprefix("warning").strip()
    assert json.loads((tmp_path / "summary.json").read_text())["warnings"][0] == sentence
    assert sentence.replace("<", "&lt;")[1:] in (tmp_path / "report.html").read_text()
