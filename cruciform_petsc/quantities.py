# SPDX-License-Identifier: MIT
"""What a column of a curve is called, in what unit it is, and how large that unit is: once.

A column's name ends with its unit: ``extension_mm``, ``load_N``. Files, tables, axes and logs take
their words from here; kinds of test declare the columns that only they have.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from math import pi
from typing import Any, NamedTuple

import numpy as np

from .errors import InputError
from .units import format_si

# How a column's name ends: unit as people write it, and its size in SI units.
UNITS = {
    "_N_per_cm": ("N/cm", 1e2),
    "_N_per_mm": ("N/mm", 1e3),
    "_Pa_per_mm": ("Pa/mm", 1e3),
    "_mm": ("mm", 1e-3),
    "_deg": ("°", pi / 180.0),
    "_percent": ("%", 0.01),
    "_kPa": ("kPa", 1e3),
    "_N": ("N", 1.0),
    "_J": ("J", 1.0),
    "_s": ("s", 1.0),
}
SMALL_FORCE = 0.1  # N; forces below are told in mN


class Quantity(NamedTuple):
    """A column of a curve.

    Attributes
    ----------
    column : str
        Its name in files.
    scale : float
        SI units in one of its own.
    unit : str
        As people write it: "mm", "°".
    name, label, short : str
        What stands over it in a table; at an axis, or before a difference; in a log.
    is_displacement : bool
        Whether it is what a test machine measures beside the force.
    """

    column: str
    scale: float
    unit: str
    name: str
    label: str
    short: str
    is_displacement: bool = False

    @property
    def axis(self) -> str:
        """Label and unit: "extension (mm)"."""
        return f"{self.label} ({self.unit})"

    @property
    def log_unit(self) -> str:
        """Its unit in ASCII."""
        return self.unit.replace("°", "deg")

    def sized_for(self, values: Any) -> Quantity:
        """The same in a unit for values (SI) of their size: small forces are in mN."""
        unit, scale = force_unit(values) if self.unit == "N" else (self.unit, self.scale)
        return self._replace(unit=unit, scale=scale)

    def text(self, value: float) -> str:
        """Name, value (SI) and unit for a log: "extension 10 mm"."""
        return f"{self.short} {self.value_text(value)}"

    def value_text(self, value: float) -> str:
        """Value (SI) and unit for a log: "10 mm"."""
        sized = self.sized_for(value)
        return f"{value / sized.scale:.4g} {sized.log_unit}"


_KNOWN: dict[str, Quantity] = {}


def quantity(column: str) -> Quantity:
    """What is known of a column; of one that nobody has declared, what its name says."""
    if column in _KNOWN:
        return _KNOWN[column]
    tail = next((tail for tail in UNITS if column.endswith(tail)), "")
    unit, scale = UNITS.get(tail, ("", 1.0))
    name = column.removesuffix(tail).replace("_", " ")
    return Quantity(column, scale, unit, name, name, name)


def declare(
    column: str, name: str = "", label: str = "", short: str = "", is_displacement: bool = False
) -> Quantity:
    """Give a column its words, see Quantity: label and short are its name if they are not given."""
    plain = quantity(column)
    name = name or plain.name
    _KNOWN[column] = plain._replace(
        name=name, label=label or name, short=short or name, is_displacement=is_displacement
    )
    return _KNOWN[column]


EXTENSION = declare("extension_mm", is_displacement=True)
LOAD = declare("load_N")
declare("displacement_mm", is_displacement=True)  # measured
declare("shear_deg", "shear angle")
declare("shear_centre_deg", "shear, at the centre point", "shear angle in the centre")
declare("shear_max_deg", "shear, largest (absolute)", "largest shear angle")
declare("shear_99_deg", "shear, 99 % of the area (absolute)", "shear angle of 99 % of the area")
declare("shear_middle_deg", "shear, middle zone (median)", "shear angle of the middle zone")
declare("shear_side_deg", "shear, side zones (median)", "shear angle of the side zones")
declare("shear_clamp_deg", "shear, at the clamps (median)", "shear angle at the clamps")
declare("slip_max_mm", "slip at a crossover, largest", "largest slip at a crossover")
declare("height_max_mm", "height out of the plane, largest", "largest height out of the plane")


def displacement(columns: Iterable[str]) -> Quantity | None:
    """The first column that is what a test machine measures beside the force, if there is one."""
    return next((q for q in map(quantity, columns) if q.is_displacement), None)


def data_frame(columns: Mapping[str, Any]) -> Any:
    """Columns as a pandas.DataFrame; InputError where pandas is not installed."""
    try:
        import pandas  # type: ignore[import-untyped]
    except ImportError:
        raise InputError(
            "a DataFrame needs pandas, which is not installed here; without it the columns are a "
            "dict of arrays"
        ) from None
    return pandas.DataFrame(dict(columns))


# -- values for people -------------------------------------------------------------------------


def force_unit(values: Any) -> tuple[str, float]:
    """Unit that forces (N) are told in, and its size in N: mN if all are small."""
    return ("N", 1.0) if np.abs(values).max(initial=0.0) >= SMALL_FORCE else ("mN", 1e-3)


def energy_unit(values: Any) -> tuple[str, float]:
    """Unit that energies (J) are told in, and its size in J: mJ if all are below 1 J."""
    return ("J", 1.0) if np.abs(values).max(initial=0.0) >= 1.0 else ("mJ", 1e-3)


def si_text(value: float, unit: str) -> str:
    """An SI value with four digits, in a unit of a fitting size."""
    return format_si(float(f"{value:.4g}"), unit)


def length(value: float) -> str:
    """Write a length [m] for people: four digits of it, down to nanometres."""
    return si_text(round(value, 9) + 0.0, "m")


def force_text(value: float) -> str:
    """A force (N) for people, in mN if it is small."""
    return si_text(value, "N") if abs(value) >= SMALL_FORCE else f"{1e3 * value:.4g} mN"


def tension_text(largest: Mapping[str, Any]) -> str:
    """A summary's yarn_tension_max in words."""
    place = largest["at_mm"]
    where = "" if place is None else ", at x = {:.4g} mm, y = {:.4g} mm (at rest)".format(*place)
    on_most = f", on 99 % of the area up to {force_text(largest['n_99'])}"
    return f"{force_text(largest['n'])} per {largest['family']} yarn{where}{on_most}"


def angle_text(degrees: float, unit: str = " deg") -> str:
    """An angle for people; rounding makes no -0.00."""
    return f"{round(degrees, 2) + 0.0:.2f}{unit}"
