# SPDX-License-Identifier: MIT
"""Measured load curves: columns of a text file, as test machines write them, to SI numbers."""

from __future__ import annotations

import csv
import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ..errors import InputError
from ..reading import MIB, read_given
from ..units import LIMITS, MEASURES, format_si, parse_unit

# More points than this are averaged, because each costs an equilibrium of the network.
MOST_POINTS = 40
LARGEST_CURVE, MOST_LINES, LONGEST_LINE = 64 * MIB, 300_000, 10_000
FEWEST_POINTS = 4
# Fall of the displacement, over its range, that is a turn of the machine and no noise.
TURN = 0.02
_COLUMNS = (("displacement", "m"), ("force", "N"))
_EXAMPLE = 'write for example "displacement [mm], force [N]"'


@dataclass(frozen=True, eq=False)
class MeasuredCurve:
    """Force over displacement, in order of displacement."""

    displacement: np.ndarray  # (n,) positive and ascending, m
    force: np.ndarray  # (n,) positive, N
    rows: int  # measured; more than n if neighbours have been averaged

    @classmethod
    def from_points(cls, displacement, force, most: int = MOST_POINTS) -> MeasuredCurve:
        """Sort, average and check points, in m and N.

        Points at rest (zero displacement) say nothing and are left out. Equal displacements are
        averaged, and so are all within each of ``most`` equal steps, if there are more points.
        InputError for numbers that are not finite or negative, a displacement that turns back, too
        few points, a force that is not positive.
        """
        d, f = np.array(displacement, float), np.array(force, float)
        if d.shape != f.shape or d.ndim != 1:
            raise InputError(f"displacement and force differ in length, {d.size} and {f.size}")
        if not (np.isfinite(d).all() and np.isfinite(f).all()):
            raise InputError("the measured curve has numbers that are not finite")
        for values, unit in ((d, "m"), (f, "N")):
            if np.abs(values).max(initial=0.0) > LIMITS[unit][1]:
                raise InputError(
                    f"the measured curve goes up to {format_si(np.abs(values).max(), unit)}, "
                    f"{MEASURES[unit][0]} is at most {format_si(LIMITS[unit][1], unit)}"
                )
        if (d < 0.0).any():
            raise InputError(
                f"the measured curve has the negative displacement {format_si(d.min(), 'm')}, it "
                "must begin at rest"
            )
        rows = len(d)
        largest = np.maximum.accumulate(d) if rows else d
        if rows and (largest - d).max() > TURN * np.ptp(d):
            turn = largest[(largest - d).argmax()]
            raise InputError(
                f"the displacement of the measured curve turns back after {format_si(turn, 'm')}, "
                "give the loading branch only"
            )
        d, f = d[d > 0.0], f[d > 0.0]
        step = np.unique(d, return_inverse=True)[1]
        if step.size and step.max() >= most:
            step = np.minimum((d - d.min()) / np.ptp(d) * most, most - 1).astype(int)
            step = np.unique(step, return_inverse=True)[1]
        count = np.bincount(step)
        d, f = np.bincount(step, weights=d) / count, np.bincount(step, weights=f) / count
        if len(d) < FEWEST_POINTS:
            raise InputError(
                f"the measured curve has {len(d)} points with a displacement, at least "
                f"{FEWEST_POINTS} are needed"
            )
        if (f <= 0.0).any():
            first = (f <= 0.0).argmax()
            raise InputError(
                f"the force of the measured curve must be positive, it is "
                f"{format_si(f[first], 'N')} at {format_si(d[first], 'm')}; take the slack out"
            )
        return cls(d, f, rows)

    @classmethod
    def joined(cls, curves: Sequence[MeasuredCurve]) -> MeasuredCurve:
        """The points of several curves, one curve after the other."""
        d, f = np.hstack([[curve.displacement, curve.force] for curve in curves])
        return cls(d, f, sum(curve.rows for curve in curves))


def read_curve(path: str | Path) -> MeasuredCurve:
    """Read the columns of displacement and force of a CSV file.

    The first line names the columns and their units, as in "displacement [mm], force [N]",
    "extension_mm,load_N" or "Weg (mm);Kraft (kN)"; units may also have the second line to
    themselves. Which column is which follows from the units. Columns end with a tab, a semicolon
    (both allow decimal commas) or a comma. Lines that begin with # are comments. InputErrors name
    the file and mostly the line.
    """
    name = f'measured curve "{path}"'
    lines = _lines(Path(path), name)
    if not lines:
        raise InputError(f"{name} is empty")
    comma = next((mark for mark in "\t;" if mark in lines[0][1]), ",")
    (_, titles), *rows = [
        (number, [cell.strip() for cell in next(csv.reader([text], delimiter=comma))])
        for number, text in lines
    ]
    if all(_number(cell, comma) is not None for cell in titles):
        raise InputError(f"{name} has no header with units, {_EXAMPLE}")
    units = rows[0][1] if rows else []
    if len(units) == len(titles) and all(_number(cell, comma) is None for cell in units):
        # Some machines write the units into a line of their own.
        pairs = zip(titles, units, strict=True)
        titles, rows = [f"{title} [{unit.strip('()[]')}]" for title, unit in pairs], rows[1:]
    columns = []
    for what, unit in _COLUMNS:
        factors = ((i, _factor_in(title, unit)) for i, title in enumerate(titles))
        found = [(i, factor) for i, factor in factors if factor is not None]
        if len(found) != 1:
            raise InputError(
                f"{name} has {f'{len(found)} columns' if found else 'no column'} with a unit of "
                f'{what} in its header "{", ".join(titles)}", {_EXAMPLE}'
            )
        columns.append((what, *found[0]))
    values = []
    for line, cells in rows:
        if len(cells) != len(titles):
            hint = ", decimal commas need semicolons" if comma == "," else ""
            raise InputError(
                f"{name}, line {line}, has {len(cells)} columns instead of {len(titles)}{hint}"
            )
        for what, i, factor in columns:
            number = _number(cells[i], comma)
            if number is None or not np.isfinite(number):
                raise InputError(
                    f'{name}, line {line}: {what} must be a finite number, got "{cells[i]}"'
                )
            values.append(factor * number)
    displacement, force = np.reshape(values, (-1, len(columns))).T
    try:
        return MeasuredCurve.from_points(displacement, force)
    except InputError as error:
        raise InputError(f"{name}: {error}") from None


def _lines(path: Path, name: str) -> list[tuple[int, str]]:
    """Lines with their numbers, without comments and empty ones."""
    data = read_given(path, "measured curve", "CSV", LARGEST_CURVE)
    try:
        text = data.decode("utf-8-sig")
    except UnicodeDecodeError:
        text = data.decode("latin-1")  # a name with an umlaut; the numbers are ASCII
    if max(map(text.count, "\n\r")) > MOST_LINES:
        raise InputError(f"{name} has more than {MOST_LINES} lines")
    lines = [(i, line.strip(" ")) for i, line in enumerate(text.splitlines(), 1)]
    for i, line in lines:
        if len(line) > LONGEST_LINE:
            raise InputError(
                f"{name}, line {i}, has {len(line)} characters, at most {LONGEST_LINE} are read"
            )
    return [(i, line) for i, line in lines if line.strip() and not line.lstrip().startswith("#")]


def _number(cell: str, delimiter: str) -> float | None:
    """Read a number; a decimal comma only where commas do not part columns."""
    if delimiter != "," and cell.count(",") == 1 and "." not in cell:
        cell = cell.replace(",", ".")
    is_number = re.fullmatch(r"[+-]?(\d+\.?\d*|\.\d+)([eE][+-]?\d+)?", cell)
    return float(cell) if is_number else None


def _factor_in(title: str, unit: str) -> float | None:
    """Return how many `unit` one of the unit in a column's title is, or None if it has no such."""
    if re.search(r"[\s_]per[\s_]", title):
        return None  # N_per_mm is no mm
    # A unit in brackets is the unit; without, it is what the name ends with.
    in_brackets = re.findall(r"[\[(]([^\])]*)[\])]", title)
    part = in_brackets[-1] if in_brackets else re.split(r"[\s_/,]+", title.strip())[-1]
    try:
        return parse_unit(part, unit)
    except ValueError:
        return None
