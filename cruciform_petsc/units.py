# SPDX-License-Identifier: MIT
"""Quantities with units, as people write them, to plain SI numbers and back for logs.

The registry is our own and small: in it an angle is a dimension (so that "45 deg" cannot pass for
a count, nor "2.4 ends" for an angle), and a unit nobody uses for cloth is unknown rather than
something unexpected ("n" is no newton, "lambda" no litre).
"""

from __future__ import annotations

import math
import re
from functools import lru_cache
from numbers import Real
from typing import Any, Self

import pint

from .errors import InputError, cut, shown

_DEFINITIONS = """
giga- = 1e9 = G-
mega- = 1e6 = M-
kilo- = 1e3 = k-
hecto- = 1e2 = h-
deca- = 1e1 = da-
deci- = 1e-1 = d-
centi- = 1e-2 = c-
milli- = 1e-3 = m-
micro- = 1e-6 = µ- = μ- = u-
nano- = 1e-9 = n-
meter = [length] = m = metre
second = [time] = s
minute = 60 * second = min
hour = 3600 * second = h
gram = [mass] = g
radian = [angle] = rad
newton = kilogram * meter / second ** 2 = N
pascal = newton / meter ** 2 = Pa
joule = newton * meter = J
mole = [substance] = mol
kelvin = [temperature] = K
force_gram = 9.80665e-3 * newton = gf
force_kilogram = 9.80665 * newton = kgf
force_pound = 4.4482216152605 * newton = lbf
dyne = 1e-5 * newton = dyn
ounce = 28.349523125 * gram = oz
inch = 2.54e-2 * meter = in = inches
foot = 0.3048 * meter = ft = feet
yard = 0.9144 * meter = yd
gsm = gram / meter ** 2
tex = 1e-3 * gram / meter
denier = tex / 9 = den
degree = 0.017453292519943295 * radian = deg = °
turn = 6.283185307179586 * radian
count = []
end = count
pick = count
yarn = count
thread = count
epi = count / inch
ppi = count / inch
"""

# SI unit -> what it measures, an example, the unit that logs use.
MEASURES = {
    "N/m": ("a force per width", "520 N/cm", "N/cm"),
    "N/m/rad": ("a shear modulus", "0.96 N/cm", "N/cm"),
    "1/m": ("a number per length", "2.4 /cm", "/cm"),
    "N*m**2": ("a flexural rigidity", "0.6 N mm^2", "N mm^2"),
    "N*m": ("a flexural rigidity per width", "0.2 N mm", "N mm"),
    "N*m/m": ("a moment per width", "0.01 N mm/mm", "N mm/mm"),
    "rad": ("an angle", "45 deg", "deg"),
    "m": ("a length", "1 mm", "mm"),
    "N": ("a force", "2 N", "N"),
    "1": ("a strain", "1 %", "%"),
    "kg/m**2": ("a mass per area", "576 g/m^2", "g/m^2"),
    "kg/m**3": ("a density", "2.5 g/cm^3", "g/cm^3"),
    "kg/m": ("a linear density", "200 tex", "tex"),
    "Pa": ("a pressure", "20 kPa", "kPa"),
    "N/m**2": ("a modulus of elasticity", "230 GPa", "GPa"),
    "N*m/m**2": ("a stiffness", "2 N/mm", "N/mm"),
    "N/m/m": ("a stiffness per width", "0.1 N/mm/mm", "N/mm/mm"),
    "N/m**3": ("a stiffness of contact, per area", "20 kPa/mm", "kPa/mm"),
    "N*s/m**3": ("a viscosity, per area", "20 N s/m^3", "N s/m^3"),
    "N*s/m": ("a viscosity of shear", "50 N s/m", "N s/m"),
    "s": ("a time", "10 s", "s"),
    "m/s": ("a speed", "100 mm/min", "mm/min"),
    "K": ("a temperature", "180 degC", "degC"),
    "J/mol": ("an energy per amount", "40 kJ/mol", "kJ/mol"),
}

# Least (but for zero) and most that a number of an SI unit may be. Cloth is far from both; what is
# beyond is a slip, or would overflow where it is squared.
LIMITS = {
    "N/m": (1e-12, 1e12),
    "N/m/rad": (1e-12, 1e12),
    "1/m": (1e-6, 1e9),
    "N*m**2": (1e-24, 1e6),
    "N*m": (1e-18, 1e9),
    "N*m/m": (1e-18, 1e9),
    "rad": (0.0, 1e5),
    "m": (1e-12, 1e9),
    "N": (1e-15, 1e12),
    "1": (1e-12, 1e4),
    "kg/m**2": (1e-9, 1e6),
    "kg/m**3": (1e-6, 1e6),
    "kg/m": (1e-12, 1e3),
    "Pa": (1e-9, 1e12),
    "N/m**2": (1.0, 1e15),
    "N*m/m**2": (1e-12, 1e12),
    "N/m/m": (1e-12, 1e12),
    "N/m**3": (1e-6, 1e18),
    "N*s/m**3": (1e-9, 1e12),
    "N*s/m": (1e-12, 1e12),
    "s": (1e-9, 1e9),
    "m/s": (1e-12, 1e3),
    "K": (1.0, 5000.0),
    "J/mol": (1.0, 1e7),
}
_LONGEST = 100  # characters of a quantity

# Temperatures [K] at which the units' own scales begin.
_ZEROS = {"K": 0.0, "degC": 273.15, "°C": 273.15}

# Strains are not left to the registry, in which "2 ends" is a plain number as well.
_STRAINS = {"%": 0.01, "percent": 0.01, "1": 1.0, "m/m": 1.0, "mm/mm": 1.0}

_UNSIGNED = r"(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?"
_NUMBER = re.compile(rf"\s*([+-]?{_UNSIGNED})(.*)", re.DOTALL)
# "1/4.8 mm", one yarn per 4.8 mm, and "900 N/5 cm", from a strip of that width.
_PER_SOME = re.compile(rf"([^/]*)/\s*({_UNSIGNED})\s*([^\W\d][^/]*)")

# A unit: names with powers, one after the other, "N*mm^2/deg" or "gf cm2/cm", perhaps in brackets
# behind a slash. Nothing else reaches pint, which would work out any power of powers.
_NAME = r"(?:[^\W\d_]{1,20}|°)(?:\s?\^\s?-?[1-4]|-?[1-4])?"
_TIMES = r"(?:\s?[*·⋅.-]\s?|\s)"
_SOME = rf"{_NAME}(?:{_TIMES}{_NAME}){{0,3}}"
_UNIT = re.compile(rf"(?:1?\s?/\s?)?{_SOME}(?:\s?/\s?(?:{_SOME}|\(\s?{_SOME}\s?\))){{0,3}}")
_POWERS = str.maketrans("¹²³⁴⁻", "1234-")


def _plain(text: str) -> str:
    """A unit as pint reads it; empty if it is none, "N mm2 per deg" is "N*mm**2/deg"."""
    text = " ".join(text.split()).replace("**", "^").translate(_POWERS)
    text = re.sub(r"(?:^|\s)per\s", "/", text)
    if len(text) > _LONGEST or not _UNIT.fullmatch(text):
        return ""
    text = re.sub(rf"(?<=[\w°]){_TIMES}(?=[^\W\d_]|°)", "*", text)
    text = re.sub(r"(?<=.)\s?\^?\s?(-?[1-4])", r"**\1", text)
    return f"1{text}" if text.startswith("/") else text


class Quantity(str):
    """A quantity as it was written ("2.4 cm"), and its value `si` in the SI `unit`: parsed once."""

    unit: str = ""
    si: float = math.nan

    @classmethod
    def read(cls, value: Any, unit: str, *, column: bool = False, bare: bool = False) -> Self:
        """Parse a quantity, or with `column` a unit by itself; see `parse` and `parse_unit`."""
        si = parse_unit(value, unit) if column else parse(value, unit, bare=bare)
        quantity = cls(value if isinstance(value, str) else f"{si!r} {unit}")
        quantity.unit, quantity.si = unit, si
        return quantity


@lru_cache(maxsize=1)
def _registry() -> pint.UnitRegistry:
    """Make the registry; once, because that takes a moment."""
    registry: pint.UnitRegistry = pint.UnitRegistry(None)
    registry.load_definitions(_DEFINITIONS.strip().splitlines())
    return registry


@lru_cache(maxsize=256)
def _factor(text: str, unit: str, example: str) -> float:
    """How many `unit` one `text` is; a ValueError says in words why it is none."""
    another = f'has the unit "{cut(text)}", which is not that of {MEASURES[unit][0]}'
    if unit == "K":
        if text not in _ZEROS:
            raise ValueError(f'{another} like "{example}"')
        return 1.0
    if unit == "1":
        if text not in _STRAINS:
            raise ValueError(f'{another} like "{example}"')
        return _STRAINS[text]
    registry, plain = _registry(), _plain(text)
    problem = "" if plain else f'unreadable unit "{cut(text)}"'
    try:
        parsed = registry.parse_units(plain)
    except pint.UndefinedUnitError as error:
        names = [error.unit_names] if isinstance(error.unit_names, str) else error.unit_names
        problem = f'unknown unit "{cut(", ".join(names))}"'
    except Exception:  # pint's parser fails with many types, from TypeError to AssertionError
        problem = f'unreadable unit "{cut(text)}"'
    if problem:
        raise ValueError(f'has the {problem}, write for example "{example}"')
    wanted = registry.parse_units(unit)
    if unit == "N/m/rad" and not parsed.is_compatible_with(wanted):
        wanted = registry.parse_units("N/m")  # per radian goes without saying
    if parsed.dimensionality != wanted.dimensionality:
        hint = ""
        if unit == "N*m**2" and parsed.is_compatible_with("N*m"):  # of KES, gf cm^2/cm
            hint = "; what is per width of cloth is to be divided by the yarns per width"
        raise ValueError(f'{another} like "{example}"{hint}')
    return float(registry.Quantity(1.0, parsed).to(wanted).magnitude)


def parse(value: Any, unit: str, *, bare: bool = False) -> float:
    """Turn one quantity ("520 N/cm") into an SI `unit` of MEASURES.

    ``bare``: numbers without unit are in SI already (scripts may give them, case files not). What
    is wrong is a ValueError, the end of a sentence that begins with the key.
    """
    if isinstance(value, Quantity) and value.unit == unit:
        return value.si
    kind, example, _ = MEASURES[unit]
    if isinstance(value, Real) and not isinstance(value, bool):
        try:
            number = float(value)
        except OverflowError:  # a whole number of hundreds of digits
            number = math.inf
        if not bare:
            raise ValueError(f'is the bare number {shown(value)}, give it a unit like "{example}"')
        if not math.isfinite(number):
            raise ValueError(f"must be finite, got {number}")
        if unit == "K" and number <= 0.0:
            raise ValueError(f"= {shown(value)} is not above absolute zero")
        return _bounded(number, unit, f"= {shown(value)}")
    if not isinstance(value, str):
        raise ValueError(f'must be {kind} in quotes like "{example}", got {shown(value)}')
    if len(value) > _LONGEST:
        raise ValueError(f'must be {kind} like "{example}", got a text of {len(value)} characters')
    match = _NUMBER.fullmatch(value)
    if match is None:
        problem = f'must be a finite number with a unit like "{example}"'
        raise ValueError(f'{problem}, got "{cut(value)}"')
    digits, text = match[1], match[2].strip()
    if not text:
        raise ValueError(f'= "{cut(value)}" has no unit, write for example "{example}"')
    if re.match(r"[,.\d](?!\s*/)", text):  # a second number; only the 1 of "2.4 1/cm" may stand
        raise ValueError(f'must be one number and a unit like "{example}", got "{cut(value)}"')
    if unit == "kg/m" and text in ("K", "k"):
        raise ValueError(
            f'= "{cut(value)}" is a number of filaments, and the linear density is needed that a '
            'sheet has beside it: of carbon some 67 tex per thousand, "200 tex" for 3K'
        )
    number = float(digits)
    per = _PER_SOME.fullmatch(text)
    if per is not None and float(per[2]) > 0.0:
        number /= float(per[2])
        text = f"{per[1]}/{per[3]}"
    try:
        number *= _factor(text, unit, example)
    except ValueError as error:
        raise ValueError(f'= "{cut(value)}" {error}') from None
    if unit == "K":
        number += _ZEROS[text]
        if number <= 0.0:
            raise ValueError(f'= "{cut(value)}" is not above absolute zero, -273.15 degC')
    if not math.isfinite(number):
        raise ValueError(f'must be finite, got "{cut(value)}"')
    return _bounded(number, unit, f'= "{cut(value)}"')


def _bounded(number: float, unit: str, written: str) -> float:
    """The number, if it is not beyond what anything of its kind is."""
    most = LIMITS[unit][1]
    if abs(number) > (1.0 + 1e-5) * most:  # which may have been written with six digits
        raise ValueError(
            f"{written} is too large, {MEASURES[unit][0]} is at most {format_si(most, unit)}"
        )
    return number


def parse_unit(value: Any, unit: str) -> float:
    """How many SI units a unit by itself ("deg") is; `unit` and errors as for `parse`."""
    kind, _, usual = MEASURES[unit]
    if not isinstance(value, str) or not value.strip():
        raise ValueError(f'must be the unit of {kind} in quotes like "{usual}", got {shown(value)}')
    try:
        return _factor(value.strip(), unit, usual)
    except ValueError as error:
        raise ValueError(f'= "{cut(value)}" {error}') from None


def to_si(value: Any, unit: str, key: str, *, bare: bool = False) -> float:
    """Do what `parse` does, for scripts; what is wrong is an InputError that begins with the key.

    >>> to_si("520 N/cm", "N/m", "modulus")
    52000.0
    >>> to_si("45", "rad", "bias_angle")
    Traceback (most recent call last):
    cruciform_petsc.errors.InputError: bias_angle = "45" has no unit, write for example "45 deg"
    """
    try:
        return parse(value, unit, bare=bare)
    except ValueError as error:
        raise InputError(f"{key} {error}") from None


def format_si(value: float, unit: str) -> str:
    """Write an SI number for people.

    >>> format_si(52000.0, "N/m")
    '520 N/cm'
    """
    usual = MEASURES[unit][2]
    value -= _ZEROS.get(usual, 0.0)
    return f"{value / _factor(usual, unit, usual):.6g} {usual}"
