# SPDX-License-Identifier: MIT
"""Curves over each other and their differences in figures: `cruciform-petsc compare A B ...`.

A run with measured data (``output.measured``) compares its load with them in the same way.
"""

from __future__ import annotations

import logging
import os
from collections.abc import Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from .calibration.curve import columns_of_files, read_curve
from .cloth.datasheet import assumed_shear
from .cloth.preform import PreformTable
from .errors import InputError, cut, harmless, unknown
from .experiments.registry import KINDS, kind_class
from .experiments.result import EFFORT, TestResult
from .output import pictures
from .output.folder import OF_COMPARISON, locked
from .output.saved import Result
from .output.tables import read_csv, write_json
from .parallel import on_root
from .quantities import EXTENSION, LOAD, Quantity, declare, displacement, quantity
from .reading import read_json

if TYPE_CHECKING:
    from mpi4py import MPI

    from .calibration.curve import MeasuredCurve

# A value this small beside the largest of its curve has no relative difference.
NOTHING = 1e-9
_MOST = 1e30  # in a table of ours, whose squares are numbers, too

# What curves of specimens of different sizes are compared by.
BY = ("displacement", "strain", "shear")
STRAIN = declare("strain_percent", "strain", "strain (extension over length)")
SHEAR = declare("shear_angle_deg", "shear angle")
PER_WIDTH = declare("load_per_width_N_per_mm", "load per width")
SHEAR_FORCE = "shear_force_N_per_mm"  # normalised: per length of a frame's side

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


# -- curves ----------------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class Side:
    """One of those that are compared; names of columns carry the units."""

    path: str
    title: str
    kind: str  # of test, or "measured"
    columns: dict[str, np.ndarray]  # of all increments (n,), the control first
    asked: np.ndarray  # which of them have values that were asked for, bool (n,)
    notes: tuple[str, ...] = ()  # of measured data, see MeasuredCurve
    size: tuple[float, float] | None = None  # width and length of the specimen, m, if known
    shear_assumed: bool = False  # whether its fabric's law of shear was not measured

    @property
    def is_measured(self) -> bool:
        """Whether it is no result of ours."""
        return self.kind == "measured"

    def line(self, x: str, y: str) -> Line:
        """The loading branch of a column over another."""
        return loading(self.columns[x], self.columns[y])

    def by(self, what: str) -> Side:
        """The same over one of BY: columns that are apart from the size of the specimen.

        Over the displacement all columns; over the strain the load per width and shear angles; over
        the shear angle (of a frame, of a bias test's middle zone, or at the centre) the load per
        width and the normalised shear force. InputError where there is none.
        """
        old, problem = self.columns, ""
        moved = displacement(old)
        new: dict[str, np.ndarray] = {}
        if what == "displacement":
            new = {} if moved is None else {"displacement_mm": old[moved.column]} | old
            problem = "has no displacement"
        elif self.size is None:
            problem = f"tells no sizes of its specimen, compare by {BY[0]}"
        elif what == "strain" and EXTENSION.column in old:
            new = {STRAIN.column: 0.1 * old[EXTENSION.column] / self.size[1]}
            new |= {name: value for name, value in old.items() if name.startswith("shear_")}
            new.pop(SHEAR_FORCE, None)
        elif what == "shear":
            angles = ("angle_deg", "shear_middle_deg", "shear_centre_deg")
            known = [name for name in angles if np.isfinite(old.get(name, np.nan)).any()]
            new = {SHEAR.column: old[known[0]]} if known else {}
            new |= {SHEAR_FORCE: old[SHEAR_FORCE]} if known and SHEAR_FORCE in old else {}
        if what != "displacement" and new and LOAD.column in old and self.size is not None:
            new[PER_WIDTH.column] = 1e-3 * old[LOAD.column] / self.size[0]
        if len(new) < 2:
            problem = problem or f"has no load over a {'strain' if what == 'strain' else 'shear'}"
            raise InputError(f'"{self.path}" ({self.kind}) {problem}')
        return replace(self, columns=new)


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
        problem = "has no curve.csv, so it does not hold the results of a run"
        if os.path.exists(path / "forces.csv"):
            problem = "is of a forming, which has no curve over one thing to compare"
        raise InputError(f'the folder "{path}" {problem}')
    columns = _table(path / "curve.csv")
    asked = columns.get("asked", np.ones(1)) > 0
    asked = np.broadcast_to(asked if asked.any() else True, next(iter(columns.values())).shape)
    summary = read_json(path / "summary.json", follow=True)
    title, kind = (
        harmless(cut(str(summary.get(key, other))))
        for key, other in (("title", path.name), ("kind", "unknown"))
    )
    size = None
    with suppress(InputError, LookupError, TypeError):
        preform = PreformTable.from_data(summary["case"]["preform"], "preform").build()
        size = float(preform.size[0]), float(preform.size[1])
    assumed = False
    with suppress(LookupError, TypeError, AttributeError):
        assumed = bool(assumed_shear(summary["fabric"]["assumed"]))
    energies = _with_energy(columns)
    return Side(str(path), title, kind, energies, asked, size=size, shear_assumed=assumed)


def _table(path: Path) -> dict[str, np.ndarray]:
    """Columns of a CSV file of ours, all of them numbers that can be squared."""
    columns = read_csv(path)
    if any(c.dtype != float or (np.abs(c) > _MOST).any() for c in columns.values()):
        raise InputError(f'"{path}" is not a table that cruciform-petsc has written')
    forces = [name for name in columns if quantity(name).unit == "N" and name not in EFFORT]
    if not forces or not len(columns[forces[0]]):
        raise InputError(f'"{path}" has no forces')
    return columns


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


Pairs = dict[str, tuple[Line, Line]]  # lines of two sides by column


def _pair(a: Side, b: Side) -> tuple[dict[str, Difference], Pairs, list[str]]:
    """Differences of all columns that two have in common, the lines, and over what each."""
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
                "cannot be compared so; by displacement, strain or shear (--by) they may be"
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
    return figures, {name: lines[name] for name in figures}, axes


def compare(
    sides: Sequence[Side], by: str | None = None
) -> tuple[dict[str, Any], list[dict[str, Difference]], dict[str, list[Line]]]:
    """Differences of two or more, of each to the last one; an InputError if there are none.

    ``by``: see Side.by. Returns what was compared, over what, and the figures as plain data; of
    each but the last the differences by column; and by column the lines of all that have it.
    """
    if by is not None:
        if by not in BY:
            raise unknown(f'way to compare "{cut(by)}"', by, BY)
        sides = [side.by(by) if not side.is_measured or by != BY[0] else side for side in sides]
    *others, last = sides
    pairs = [_pair(side, last) for side in others]
    axes = [axis for _, _, each in pairs for axis in each]
    letters = [chr(ord("a") + i) if i < 26 else str(i) for i in range(len(sides))]
    told: dict[str, Any] = {
        letter: {"path": side.path, "title": side.title, "kind": side.kind}
        for letter, side in zip(letters, sides, strict=True)
    }
    told["over"] = next((axis for axis in axes if axis != "displacement_mm"), axes[0])
    told["relative_to"] = letters[-1]
    told["differences"] = {
        letter: {name: value.as_dict() for name, value in figures.items()}
        for letter, (figures, _, _) in zip(letters, pairs, strict=False)
    }
    common = [name for name in pairs[0][1] if all(name in lines for _, lines, _ in pairs)]
    lines = {
        name: [*(pair[name][0] for _, pair, _ in pairs), pairs[0][1][name][1]] for name in common
    }
    return told, [figures for figures, _, _ in pairs], lines


def side_of(result: TestResult | Result | str | Path, title: str = "") -> Side:
    """What is compared of a result, or of a folder or file (see read_side). Collective."""
    if isinstance(result, str | Path):
        return read_side(result)
    if isinstance(result, Result):
        return read_side(result.folder)
    curve, test = result.curve(), result.experiment
    width, length = map(float, result.network.preform.size)
    columns, title = _with_energy(curve), title or test.kind
    return Side(title, title, test.kind, columns, curve["asked"] > 0, size=(width, length))


def plot_comparison(
    *results: TestResult | Result | str | Path,
    ax: Any = None,
    by: str | None = None,
    labels: Sequence[str] = (),
) -> Any:
    """Draw the curves of results over each other. Collective.

    Parameters
    ----------
    results : TestResult, Result, or path of a folder of results or of measured data (CSV)
        Two at least.
    ax : one or two matplotlib Axes, optional
        The first for the load, the second for what they also have in common, mostly a shear angle;
        by default those of a new figure of pyplot's.
    by : str, optional
        "displacement", "strain" or "shear": what specimens of different sizes are compared by.
    labels : sequence of str
        For the legend, one for each; by default titles or paths.

    Returns
    -------
    Axes or array of Axes
        On rank 0; None on other ranks.

    Raises
    ------
    InputError
        Fewer than two, or nothing to compare them by.
    """
    from mpi4py import MPI

    for kind in KINDS:
        kind_class(kind)  # declares its columns
    if len(results) < 2:
        raise InputError(f"a comparison needs two results at least, got {len(results)}")
    if labels and len(labels) != len(results):
        raise InputError(f"there are {len(results)} results and {len(labels)} labels")
    sides = [side_of(result) for result in results]
    told, _, lines = compare(sides, by)
    panels = _panels(quantity(told["over"]), sides, lines, list(labels) or _labels(sides))
    if ax is not None:
        panels = panels[: np.size(np.array(ax, dtype=object))]
    comms = [result.network.comm for result in results if isinstance(result, TestResult)]
    draw = partial(pictures.overlaid, panels)
    return pictures.draw(comms[0] if comms else MPI.COMM_SELF, draw, ax)


def compare_command(
    comm: MPI.Intracomm,
    paths: Sequence[str],
    directory: str | Path,
    log: logging.Logger,
    columns: Sequence[str] = (),
    by: str | None = None,
) -> dict[str, Any]:
    """Compare, tell, and write comparison.json and comparison.png into a folder. Collective."""
    for kind in KINDS:
        kind_class(kind)  # declares its columns
    files = [path for path in paths if not os.path.isdir(path)]
    named = dict(zip(files, columns_of_files(columns, len(files)), strict=True))
    sides = on_root(comm, lambda: [read_side(path, named.get(path)) for path in paths])
    told, figures, lines = compare(sides, by)
    letters = [letter.upper() for letter, _ in zip(told, sides, strict=False)]
    with locked(comm, directory, OF_COMPARISON, log) as folder:
        for letter, side in zip(letters, sides, strict=True):
            log.info(
                "%s  %s (%s)", letter, side.path, "measured" if side.is_measured else side.title
            )
            for note in side.notes:
                log.info("   %s: %s", side.path, note)
        if by is None and len({side.size for side in sides if side.size is not None}) > 1:
            log.info(
                "   specimens differ in size: --by strain or --by shear compares apart from it"
            )
        guessed = [letter for letter, s in zip(letters, sides, strict=True) if s.shear_assumed]
        if guessed:
            log.info(
                "   shear of %s is assumed, not measured: loads tell of what was assumed, not of "
                "the cloth",
                " and ".join(guessed),
            )
        told["shear_assumed"] = [letter.lower() for letter in guessed]
        axis = quantity(told["over"])
        for letter, differences in zip(letters, figures, strict=False):
            log.info(
                "%s less %s, relative to %s but for angles, in degrees:",
                *(letter, letters[-1], letters[-1]),
            )
            for name, value in differences.items():
                where = f"{axis.log_unit} ({value.points} points)"
                log.info("   %-32s %s %s", quantity(name).label, value.text(), where)
        write_json(comm, folder / "comparison.json", told)
        panels = _panels(axis, sides, lines, _labels(sides))
        pictures.save(comm, folder / "comparison.png", pictures.overlaid, panels)
        log.info("comparison in %s", folder)
    return told


def _panels(
    axis: Quantity, sides: Sequence[Side], lines: Mapping[str, list[Line]], names: Sequence[str]
) -> list[tuple[tuple[str, str], dict[str, tuple[Line, bool]]]]:
    """What pictures.overlaid draws."""
    return [
        (
            (axis.axis, quantity(column).axis),
            {
                name: (line if side.is_measured else drawn(line), side.is_measured)
                for name, line, side in zip(names, lines[column], sides, strict=True)
            },
        )
        for column in _drawn_columns(lines)
    ]


def _drawn_columns(lines: Iterable[str]) -> list[str]:
    """The two columns that tell most: forces, then a shear angle."""
    lines = list(lines)
    forces = [name for name in lines if quantity(name).unit == "N" and name != "load_net_N"]
    first = [name for name in (SHEAR_FORCE, PER_WIDTH.column) if PER_WIDTH.column in lines]
    usual = [*first, *forces, "shear_centre_deg"]
    return [name for name in usual if name in lines][:2] or lines[:2]


def _labels(sides: Sequence[Side]) -> list[str]:
    """What a legend calls them: titles if they differ, else paths."""
    titles = [f"measured: {side.title}" if side.is_measured else side.title for side in sides]
    titles = titles if len(set(titles)) == len(titles) else [side.path for side in sides]
    if len(set(titles)) < len(titles):
        titles = [f"{chr(ord('A') + i)}: {title}" for i, title in enumerate(titles)]
    return titles
