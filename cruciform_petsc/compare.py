# SPDX-License-Identifier: MIT
"""Curves over each other and their differences in figures: `cruciform-petsc compare A B`.

A run with measured data (``output.measured``) compares its load with them in the same way.
"""

from __future__ import annotations

import csv
import logging
import os
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from .calibration.curve import columns_of_files, read_curve
from .errors import InputError, cut, harmless
from .experiments.registry import KINDS, kind_class
from .experiments.result import EFFORT
from .output import pictures
from .output.folder import OF_COMPARISON, locked
from .output.tables import write_json
from .parallel import on_root
from .quantities import Quantity, displacement, quantity
from .reading import LARGEST, read_given, read_json

if TYPE_CHECKING:
    from mpi4py import MPI

    from .calibration.curve import MeasuredCurve
    from .experiments.result import TestResult

# A value this small beside the largest of its curve has no relative difference.
NOTHING = 1e-9
_MOST = 1e30  # in a table of ours, whose squares are numbers, too

Line = tuple[np.ndarray, np.ndarray]


@dataclass(frozen=True)
class Difference:
    """How far one curve is from another at some points: (a - b)/b if relative, else a - b."""

    points: int
    rms: float  # root of the mean square
    end: float  # at the last point
    largest: float  # in size, with its sign
    largest_at: float  # on the axis
    relative: bool

    def as_dict(self) -> dict[str, float | int]:
        """Plain numbers; names tell which are relative."""
        tail = "_relative" if self.relative else ""
        sizes = {f"{key}{tail}": getattr(self, key) for key in ("rms", "end", "largest")}
        return {"points": self.points, **sizes, "largest_at": self.largest_at}

    def text(self) -> str:
        """The figures for people."""
        size, unit, form = (100.0, " %", "+.2f") if self.relative else (1.0, " deg", "+.3f")
        return (
            f"RMS {size * self.rms:{form[1:]}}{unit}, at the end {size * self.end:{form}}{unit}, "
            f"at most {size * self.largest:{form}}{unit} at {self.largest_at:.4g}"
        )


def loading(x: np.ndarray, y: np.ndarray) -> Line:
    """The loading branch of a curve (n,), from the origin on: what lies beyond all before it; (m,).

    Of points in the order of the test, those that are not finite are left out, as are those on the
    other side than the largest x in size. The branch ascends in size.
    """
    good = np.isfinite(x) & np.isfinite(y)
    x, y = np.asarray(x, float)[good], np.asarray(y, float)[good]
    if not x.size:
        return np.zeros(1), np.zeros(1)
    size = x * (np.sign(x[np.abs(x).argmax()]) or 1.0)
    before = np.concatenate([[0.0], np.maximum.accumulate(size)[:-1]])
    beyond = size > np.maximum(before, 0.0)
    return np.insert(x[beyond], 0, 0.0), np.insert(y[beyond], 0, 0.0)


def value_at(curve: Line, at: np.ndarray) -> np.ndarray:
    """Values of a loading branch at points within it, by monotone cubics (PCHIP); (n,)."""
    from scipy.interpolate import PchipInterpolator

    x, y = curve
    if len(x) == 2:  # proportional
        return y[1] * at / x[1]
    sign = np.sign(x[-1])
    return PchipInterpolator(sign * x, y)(sign * at)


def drawn(curve: Line) -> Line:
    """The same branch in many points: straight lines between them are what `value_at` gives."""
    if len(curve[0]) < 3:
        return curve
    x = np.union1d(np.linspace(curve[0][0], curve[0][-1], 300), curve[0])
    return x, value_at(curve, x)


def difference(a: Line, b: Line, at: np.ndarray, relative: bool = True) -> Difference | None:
    """Difference of two loading branches (see `loading`) at some points (n,), relative to b.

    Points beyond one of the curves, and at rest, do not count; None if no point is left.
    """
    if len(a[0]) < 2 or len(b[0]) < 2 or a[0][-1] * b[0][-1] <= 0.0:
        return None
    end = min(abs(a[0][-1]), abs(b[0][-1])) * (1 + 1e-9)
    at = np.unique(at[(at * b[0][-1] > 0.0) & (np.abs(at) <= end)])
    at = at[np.argsort(np.abs(at))]
    other = value_at(b, at)
    off = value_at(a, at) - other
    if relative:
        good = np.abs(other) > NOTHING * np.abs(b[1]).max()
        at, off = at[good], off[good] / other[good]
    if not at.size:
        return None
    rms = float(np.sqrt(np.mean(off**2)))
    i = int(np.abs(off).argmax())
    return Difference(len(at), rms, float(off[-1]), float(off[i]), float(at[i]), relative)


# -- a run and measured data -----------------------------------------------------------------------


def load_line(result: TestResult) -> Line:
    """Load (N) over displacement (mm) of a result, as a test machine sees it. Collective.

    The loading branch, with all increments.
    """
    curve = result.curve()
    column = _displacement(curve, result.experiment.kind)
    return loading(curve[column.column], curve["load_N"])


def against_measured(line: Line, measured: MeasuredCurve) -> dict[str, Any]:
    """Figures of a computed load (mm, N; see `load_line`) against a measured one, for a summary."""
    x, force = 1e3 * measured.displacement, measured.force
    end = line[0][-1]
    load = value_at(line, np.minimum(x, max(end, 0.0))) if len(line[0]) > 1 else 0.0 * x
    found = difference(line, loading(x, force), x)
    return {
        "points_measured": len(x),
        "displacement_mm": x,
        "measured_n": force,
        "load_n": np.where(x <= end * (1 + 1e-9), load, np.nan),
        **({"points": 0} if found is None else found.as_dict()),
    }


# -- two curves ------------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class Side:
    """One of the two that are compared; names of columns carry the units."""

    path: str
    title: str
    kind: str  # of test, or "measured"
    columns: dict[str, np.ndarray]  # of all increments (n,), the control first
    asked: np.ndarray  # which of them have values that were asked for, bool (n,)
    notes: tuple[str, ...] = ()  # of measured data, see MeasuredCurve

    @property
    def is_measured(self) -> bool:
        """Whether it is no result of ours."""
        return self.kind == "measured"

    def line(self, x: str, y: str) -> Line:
        """The loading branch of a column over another."""
        return loading(self.columns[x], self.columns[y])


def read_side(path: str | Path, which: str | None = None) -> Side:
    """Read a folder of results, or a CSV file of a measured curve; ``which`` see read_curve."""
    path = Path(path)
    if not os.path.exists(path):
        raise InputError(
            f'"{path}" does not exist, name a folder of results or a CSV file of a measured curve'
        )
    if not os.path.isdir(path):
        measured = read_curve(path, which)
        columns = {"displacement_mm": 1e3 * measured.displacement, "load_N": measured.force}
        every = np.ones(len(measured.force), bool)
        return Side(str(path), path.name, "measured", columns, every, measured.notes)
    if not os.path.exists(path / "curve.csv"):
        raise InputError(
            f'the folder "{path}" has no curve.csv, so it does not hold the results of a run'
        )
    columns = _table(path / "curve.csv")
    asked = columns.get("asked", np.ones(1)) > 0
    asked = np.broadcast_to(asked if asked.any() else True, next(iter(columns.values())).shape)
    summary = read_json(path / "summary.json", follow=True)
    title, kind = (
        harmless(cut(str(summary.get(key, other))))
        for key, other in (("title", path.name), ("kind", "unknown"))
    )
    return Side(str(path), title, kind, _with_energy(columns), asked)


def _table(path: Path) -> dict[str, np.ndarray]:
    """Columns of a CSV file of ours; an empty field is NaN."""
    data = read_given(path, "table", "CSV", LARGEST)
    try:
        header, *rows = list(csv.reader(data.decode("utf-8-sig").splitlines()))
        values = np.array([[float(cell or "nan") for cell in row] for row in rows], float)
        values = values.reshape(len(rows), len(header))
        if (np.abs(values) > _MOST).any():
            raise ValueError
    except (ValueError, csv.Error):
        raise InputError(f'"{path}" is not a table that cruciform-petsc has written') from None
    forces = [name for name in header if quantity(name).unit == "N" and name not in EFFORT]
    if not rows or not forces:
        raise InputError(f'"{path}" has no forces')
    return dict(zip(header, values.T, strict=True))


def _with_energy(columns: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
    """What can be compared: energies as their sum, and not how equilibrium was found."""
    parts = [value for name, value in columns.items() if name.startswith("energy_")]
    left_out = ("energy_", *EFFORT)
    compared = {name: value for name, value in columns.items() if not name.startswith(left_out)}
    return compared | ({"energy_J": np.sum(parts, axis=0)} if parts else {})


def _displacement(columns: Iterable[str], kind: str) -> Quantity:
    column = displacement(columns)
    if column is None:
        raise InputError(
            f"a {kind} test has no force over a displacement to compare with measured data"
        )
    return column


def compare(
    a: Side, b: Side
) -> tuple[dict[str, Any], dict[str, Difference], dict[str, tuple[Line, Line]]]:
    """Differences of all columns that two have in common; an InputError if there are none.

    Returns what was compared, over what, and the figures as plain data; by column the differences;
    and by column the lines of a and b.
    """
    sides = (a, b)
    exact = [side for side in sides if side.is_measured] or sides  # where they have values
    if exact is not sides:
        axes = [_displacement(side.columns, side.kind).column for side in sides]
        names = ["load_N"]
    else:
        axes = [next(iter(side.columns)) for side in sides]
        if axes[0] != axes[1]:
            raise InputError(
                f'"{a.path}" is a curve over {axes[0]} and "{b.path}" one over {axes[1]}, which '
                "cannot be compared"
            )
        names = [name for name in a.columns if name in b.columns and name != axes[0]]
    lines = {name: (a.line(axes[0], name), b.line(axes[1], name)) for name in names}
    x = {side: side.columns[axis] for side, axis in zip(sides, axes, strict=True)}
    at = np.concatenate([x[side][side.asked] for side in exact])
    figures = {}
    for name, pair in lines.items():
        found = difference(*pair, at, relative=quantity(name).unit != "°")
        if found is not None:
            figures[name] = found
    if not figures:
        unit = quantity(axes[0]).log_unit
        ranges = [
            f'"{side.path}" ({x[side].min():.4g} to {x[side].max():.4g} {unit})' for side in sides
        ]
        raise InputError(f"{' and '.join(ranges)} have no range in common")
    axis = next((x for x in axes if x != "displacement_mm"), axes[0])
    told = {
        "a": {"path": a.path, "title": a.title, "kind": a.kind},
        "b": {"path": b.path, "title": b.title, "kind": b.kind},
        "over": axis,
        "relative_to": "b",
        "differences": {name: value.as_dict() for name, value in figures.items()},
    }
    return told, figures, {name: lines[name] for name in figures}


def compare_command(
    comm: MPI.Intracomm,
    a_path: str,
    b_path: str,
    directory: str | Path,
    log: logging.Logger,
    columns: Sequence[str] = (),
) -> dict[str, Any]:
    """Compare, tell, and write comparison.json and comparison.png into a folder. Collective."""
    for kind in KINDS:
        kind_class(kind)  # declares its columns
    paths = (a_path, b_path)
    files = [path for path in paths if not os.path.isdir(path)]
    named = dict(zip(files, columns_of_files(columns, len(files)), strict=True))
    a, b = on_root(comm, lambda: [read_side(path, named.get(path)) for path in paths])
    told, figures, lines = compare(a, b)
    with locked(comm, directory, OF_COMPARISON, log) as folder:
        log.info("A  %s (%s)", a.path, a.title if not a.is_measured else "measured")
        log.info("B  %s (%s)", b.path, b.title if not b.is_measured else "measured")
        for side in (a, b):
            for note in side.notes:
                log.info("   %s: %s", side.path, note)
        log.info("A less B, loads and energies relative to B, angles in degrees:")
        axis = quantity(told["over"])
        for name, value in figures.items():
            where = f"{axis.log_unit} ({value.points} points)"
            log.info("   %-32s %s %s", quantity(name).label, value.text(), where)
        write_json(comm, folder / "comparison.json", told)
        forces = [name for name in lines if quantity(name).unit == "N"]
        usual = [*forces, *(name for name in ("shear_centre_deg",) if name in lines)][:2]
        names = _labels(a, b)
        panels = []
        for column in usual or list(lines)[:2]:
            curves = {
                name: (line if side.is_measured else drawn(line), side.is_measured)
                for name, line, side in zip(names, lines[column], (a, b), strict=True)
            }
            panels.append(((axis.axis, quantity(column).axis), curves))
        pictures.save(comm, folder / "comparison.png", pictures.overlaid, panels)
        log.info("comparison in %s", folder)
    return told


def _labels(a: Side, b: Side) -> list[str]:
    """What a legend calls them: titles if they differ, else paths."""
    titles = [f"measured: {side.title}" if side.is_measured else side.title for side in (a, b)]
    titles = titles if titles[0] != titles[1] else [a.path, b.path]
    if titles[0] == titles[1]:
        titles = [f"A: {titles[0]}", f"B: {titles[1]}"]
    return titles
