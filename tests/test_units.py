# SPDX-License-Identifier: MIT
"""Quantities with units."""

import math
import pickle
import time

import pytest

from cruciform_petsc.errors import InputError
from cruciform_petsc.units import LIMITS, MEASURES, Quantity, format_si, parse, parse_unit, to_si


@pytest.mark.parametrize(
    ("text", "unit", "si"),
    [
        ("520 N/cm", "N/m", 52000.0),
        ("0.96 N/cm", "N/m", 96.0),
        ("52 kN/m", "N/m", 52000.0),
        ("2.4 /cm", "1/m", 240.0),
        ("2.4 1/cm", "1/m", 240.0),
        ("2.4 ends/cm", "1/m", 240.0),
        ("2.4 picks/cm", "1/m", 240.0),
        ("2.4yarns/cm", "1/m", 240.0),
        ("6.096 /inch", "1/m", 240.0),
        ("0.6 N mm^2", "N*m**2", 0.6e-6),
        ("0.6 N*mm**2", "N*m**2", 0.6e-6),
        ("0.6 N·mm²", "N*m**2", 0.6e-6),
        ("45 deg", "rad", math.pi / 4),
        ("-45°", "rad", -math.pi / 4),
        ("0.5 rad", "rad", 0.5),
        ("1 mm", "m", 1e-3),
        (" +1.e0 mm ", "m", 1e-3),
        ("0 mm", "m", 0.0),
        ("2 N", "N", 2.0),
        ("2e3 mN", "N", 2.0),
        ("1/4.8 mm", "1/m", 1 / 4.8e-3),
        ("2 yarns / 4.8 mm", "1/m", 2 / 4.8e-3),
        ("2.4 1/1 cm", "1/m", 240.0),
        ("900 N/5 cm", "N/m", 18000.0),
        ("0.01 N/mm", "N/m", 10.0),
        ("1 %", "1", 0.01),
        ("-0.2%", "1", -0.002),
        ("0.01 mm/mm", "1", 0.01),
        ("576 g/m^2", "kg/m**2", 0.576),
        ("0.743 kg/m²", "kg/m**2", 0.743),
        ("2.5 g/cm^3", "kg/m**3", 2500.0),
        ("1780 kg/m^3", "kg/m**3", 1780.0),
        # as machines, spreadsheets and tables of KES write them
        ("0.6 N mm2", "N*m**2", 0.6e-6),
        ("0.6 N*mm^2", "N*m**2", 0.6e-6),
        ("0.6 N·mm2", "N*m**2", 0.6e-6),
        ("0.6 N-mm2", "N*m**2", 0.6e-6),
        ("1 gf cm2", "N*m**2", 9.80665e-7),
        ("2 gf cm/cm", "N", 2 * 9.80665e-3),
        ("1 lbf", "N", 4.4482216152605),
        ("3 cN", "N", 0.03),
        ("3 kN", "N", 3000.0),
        ("3 kgf", "N", 3 * 9.80665),
        ("0.5 N/mm^1", "N/m", 500.0),
        ("1 gf/cm", "N/m", 0.980665),
        ("1 MPa mm", "N/m", 1000.0),
        ("1 N/(mm)", "N/m", 1000.0),
        ("0.5 gf/cm/deg", "N/m/rad", 0.5 * 0.980665 * 180 / math.pi),
        ("0.5 gf/(cm·deg)", "N/m/rad", 0.5 * 0.980665 * 180 / math.pi),
        ("0.5 gf/(cm degrees)", "N/m/rad", 0.5 * 0.980665 * 180 / math.pi),
        ("2 N/mm/rad", "N/m/rad", 2000.0),
        ("2 N/mm per radian", "N/m/rad", 2000.0),
        ("2 N/mm", "N/m/rad", 2000.0),
        ("30 degrees", "rad", math.pi / 6),
        ("1 degree", "rad", math.pi / 180),
        ("3 µm", "m", 3e-6),
        ("3 μm", "m", 3e-6),
        ("3 um", "m", 3e-6),
        ("3 in", "m", 0.0762),
        ("3 inch", "m", 0.0762),
        ("12 epi", "1/m", 12 / 0.0254),
        ("12 ppi", "1/m", 12 / 0.0254),
        ("2.4 per cm", "1/m", 240.0),
        ("2.4 cm-1", "1/m", 240.0),
        ("2.4 cm⁻¹", "1/m", 240.0),
        ("2.4 threads/cm", "1/m", 240.0),
        ("600 gsm", "kg/m**2", 0.6),
        ("600 g m-2", "kg/m**2", 0.6),
        ("600 g/m2", "kg/m**2", 0.6),
        ("17 oz/yd2", "kg/m**2", 17 * 0.028349523125 / 0.9144**2),
    ],
)
def test_accepted(text, unit, si):
    """Everything people write for one quantity gives the same SI number."""
    assert to_si(text, unit, "key") == pytest.approx(si, rel=1e-14, abs=0.0)


@pytest.mark.parametrize(
    ("value", "unit", "message"),
    [
        (
            "3K",
            "kg/m",
            'key = "3K" is a number of filaments, and the linear density is needed that a sheet '
            'has beside it: of carbon some 67 tex per thousand, "200 tex" for 3K',
        ),
        (520, "N/m", 'key is the bare number 520, give it a unit like "520 N/cm"'),
        (0.0, "m", 'key is the bare number 0.0, give it a unit like "1 mm"'),
        ("520", "N/m", 'key = "520" has no unit, write for example "520 N/cm"'),
        ("45", "rad", 'key = "45" has no unit, write for example "45 deg"'),
        (
            "1 furlong",
            "m",
            'key = "1 furlong" has the unknown unit "furlong", write for example "1 mm"',
        ),
        (
            "520 n/cm",
            "N/m",
            'key = "520 n/cm" has the unknown unit "n", write for example "520 N/cm"',
        ),
        (
            "520 N/cm^2",
            "N/m",
            'key = "520 N/cm^2" has the unit "N/cm^2", which is not that of a force per width '
            'like "520 N/cm"',
        ),
        (
            "45 ends",
            "rad",
            'key = "45 ends" has the unit "ends", which is not that of an angle like "45 deg"',
        ),
        (
            "2.4 deg/cm",
            "1/m",
            'key = "2.4 deg/cm" has the unit "deg/cm", which is not that of a number per length '
            'like "2.4 /cm"',
        ),
        ("1 (mm", "m", 'key = "1 (mm" has the unreadable unit "(mm", write for example "1 mm"'),
        ("1 cm^0", "m", 'key = "1 cm^0" has the unreadable unit "cm^0", write for example "1 mm"'),
        ("nan mm", "m", 'key must be a finite number with a unit like "1 mm", got "nan mm"'),
        ("inf mm", "m", 'key must be a finite number with a unit like "1 mm", got "inf mm"'),
        ("1e999 mm", "m", 'key must be finite, got "1e999 mm"'),
        ("1,5 mm", "m", 'key must be one number and a unit like "1 mm", got "1,5 mm"'),
        ("2 10/cm", "1/m", 'key must be one number and a unit like "2.4 /cm", got "2 10/cm"'),
        (
            "1/0 mm",
            "1/m",
            'key = "1/0 mm" has the unreadable unit "/0 mm", write for example "2.4 /cm"',
        ),
        (
            "900 N/5/2 cm",
            "N/m",
            'key = "900 N/5/2 cm" has the unreadable unit "N/5/2 cm", write for example "520 N/cm"',
        ),
        (
            "1/4.8 mm",
            "m",
            'key = "1/4.8 mm" has the unit "/mm", which is not that of a length like "1 mm"',
        ),
        (
            "2 ends",
            "1",
            'key = "2 ends" has the unit "ends", which is not that of a strain like "1 %"',
        ),
        ("0.01", "1", 'key = "0.01" has no unit, write for example "1 %"'),
        ("", "m", 'key must be a finite number with a unit like "1 mm", got ""'),
        (None, "m", 'key must be a length in quotes like "1 mm", got None'),
        (True, "m", 'key must be a length in quotes like "1 mm", got True'),
        (["1 mm"], "m", "key must be a length in quotes like \"1 mm\", got ['1 mm']"),
    ],
)
def test_refused(value, unit, message):
    """The message names the key, what it got and what would be right."""
    with pytest.raises(InputError) as caught:
        to_si(value, unit, "key")
    assert str(caught.value) == message


HARD = [
    "mm^9^9^9^9", "mm**9**9**9", "mm^(9^9)", "((((mm", "(" * 90 + "mm", "mm^99", "mm^9", "mm²²",
    "mm^-1^-1", "mm**1e9", "mm*" * 30 + "mm", "mm/" * 15 + "mm", "mm " * 30, "k" * 90 + "m",
    "9" * 200 + "mm", "mm^0x9", "mm if 9**9**9 else mm", "__import__", "mm;mm", "²", "^2",
    "1", "()",    "mm" * 100_000, "mm^9" * 100_000,
]  # fmt: skip


@pytest.mark.parametrize("text", HARD)
def test_hard_units_are_refused_at_once(text):
    """Nothing that pint would work out for years reaches it."""
    begin = time.perf_counter()
    for unit in ("m", "N*m**2", "N/m/rad"):
        with pytest.raises(ValueError, match="unit|must be"):
            parse(f"1 {text}", unit)
        with pytest.raises(ValueError, match="unit"):
            parse_unit(text, unit)
    assert time.perf_counter() - begin < 0.5  # the registry, too


def test_a_rigidity_per_width_is_not_taken_for_that_of_a_yarn():
    """KES gives bending in gf cm^2/cm."""
    with pytest.raises(InputError, match="per width of cloth is to be divided by the yarns per"):
        to_si("0.1 gf cm^2/cm", "N*m**2", "yarn_bending")


@pytest.mark.parametrize("unit", LIMITS)
def test_limits(unit):
    """Each quantity up to its most, whether written or bare, and not beyond."""
    most = LIMITS[unit][1]
    for sign in (1,) if unit == "K" else (-1, 1):  # temperatures begin at zero
        assert to_si(format_si(sign * most, unit), unit, "key") == pytest.approx(sign * most)
        assert to_si(sign * most, unit, "key", bare=True) == sign * most
        for value in (f"{sign * 1.01 * most} {unit}", sign * 1.01 * most):
            if unit == "1" and isinstance(value, str):
                value = value.replace(" 1", " m/m")
            with pytest.raises(InputError, match=f"is too large, {MEASURES[unit][0]} is at most"):
                to_si(value, unit, "key", bare=True)


def test_bare_numbers_for_scripts():
    """Scripts may give SI numbers, but only finite ones."""
    assert to_si(0.075, "m", "key", bare=True) == 0.075
    assert to_si("1 mm", "m", "key", bare=True) == 1e-3
    with pytest.raises(InputError, match="key must be finite, got nan"):
        to_si(math.nan, "m", "key", bare=True)
    with pytest.raises(InputError, match="key must be a length"):
        to_si(True, "m", "key", bare=True)


@pytest.mark.parametrize(
    ("si", "unit", "text"),
    [
        (52000.0, "N/m", "520 N/cm"),
        (240.0, "1/m", "2.4 /cm"),
        (0.6e-6, "N*m**2", "0.6 N mm^2"),
        (math.pi / 4, "rad", "45 deg"),
        (1e-3, "m", "1 mm"),
        (2.0, "N", "2 N"),
        (0.01, "1", "1 %"),
    ],
)
def test_format(si, unit, text):
    """Logs use the units of the trade, and what they write can be read back."""
    assert format_si(si, unit) == text
    assert to_si(text, unit, "key") == pytest.approx(si, rel=1e-14)


def test_unit_of_a_column():
    """Tables of numbers carry one unit per column."""
    assert parse_unit("deg", "rad") == pytest.approx(math.pi / 180)
    assert parse_unit(" N/mm ", "N/m") == pytest.approx(1000.0)
    assert (parse_unit("%", "1"), parse_unit("1", "1")) == (0.01, 1.0)


@pytest.mark.parametrize(
    ("value", "unit", "message"),
    [
        ("N", "N/m", '= "N" has the unit "N", which is not that of a force per width like "N/cm"'),
        ("grad", "rad", '= "grad" has the unknown unit "grad", write for example "deg"'),
        ("0.1 N", "N/m", '= "0.1 N" has the unreadable unit "0.1 N", write for example "N/cm"'),
        ("", "rad", "must be the unit of an angle in quotes like \"deg\", got ''"),
        (1, "1", 'must be the unit of a strain in quotes like "%", got 1'),
    ],
)
def test_refused_units(value, unit, message):
    """A quantity, a wrong dimension, nothing."""
    with pytest.raises(ValueError) as caught:
        parse_unit(value, unit)
    assert str(caught.value) == message


def test_quantities_keep_what_was_written():
    """Text and value, through a pickle too; in place of the text they are not parsed again."""
    quantity = pickle.loads(pickle.dumps(Quantity.read("2.4 cm", "m")))
    assert (quantity, quantity.unit, quantity.si) == ("2.4 cm", "m", pytest.approx(0.024))
    assert parse(quantity, "m") == quantity.si
    with pytest.raises(ValueError, match="not that of a force"):
        parse(quantity, "N")
    assert Quantity.read("N/mm", "N/m", column=True).si == pytest.approx(1000.0)
    bare = Quantity.read(0.5, "rad", bare=True)
    assert (str(bare), bare.si) == ("0.5 rad", 0.5)
    with pytest.raises(ValueError, match="bare number 0.5"):
        Quantity.read(0.5, "rad")
