# SPDX-License-Identifier: MIT
"""Measured load curves: the loading branch of what a test machine wrote."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ..errors import InputError
from ..quantities import force_text
from ..reading import MIB, read_given
from ..units import LIMITS, MEASURES, format_si
from .columns import read_columns

# More points than one and a half times this are averaged, each costs an equilibrium.
MOST_POINTS = 40
LARGEST_CURVE = 64 * MIB
FEWEST_POINTS = 4
# Fall of the displacement, over its range, that is a turn of the machine and no noise.
TURN = 0.02
NOISE = 1e-3  # of the range: a displacement or a force as small is none
SLACK = 0.02  # of the range: what a specimen may give before it carries a load
FALL = 0.1  # behind the largest force, that is a rupture or a slip and no noise
AT_REST = 0.02  # of the median force: a force at rest that is told


@dataclass(frozen=True, eq=False)
class MeasuredCurve:
    """Force over displacement, in order of displacement."""

    displacement: np.ndarray  # (n,) positive and ascending, m
    force: np.ndarray  # (n,) positive, N
    rows: int  # measured; more than n if some were left out, or neighbours averaged
    notes: tuple[str, ...] = ()  # sentences: what was left out, a force at rest

    @classmethod
    def from_points(cls, displacement, force, most: int = MOST_POINTS) -> MeasuredCurve:
        """The loading branch of measured points, in m and N.

        Left out are points at rest (within NOISE of the range), slack (forces within NOISE of the
        largest, no further than SLACK), what comes behind the turn of the machine, and what stays
        FALL below the largest force behind it: `notes` tells. Equal displacements are averaged, and
        so are all within each of ``most`` equal steps, if there are half as many points again.
        InputError for numbers that are not finite or negative, a displacement that turns back and
        goes on, more slack, too few points, a force that is not positive.
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
        rows = len(d)
        d, f, notes = _loading_branch(d, f) if rows else (d, f, [])
        step = np.unique(d, return_inverse=True)[1]
        if step.size and step.max() >= 1.5 * most:
            step = np.minimum((d - d.min()) / np.ptp(d) * most, most - 1).astype(int)
            step = np.unique(step, return_inverse=True)[1]
        count = np.bincount(step)
        d, f = np.bincount(step, weights=d) / count, np.bincount(step, weights=f) / count
        if len(d) < FEWEST_POINTS:
            why = f" ({' '.join(notes)})" if notes else ""
            raise InputError(
                f"the measured curve has {len(d)} points with a displacement, at least "
                f"{FEWEST_POINTS} are needed{why}"
            )
        if (f <= 0.0).any():
            first = (f <= 0.0).argmax()
            raise InputError(
                f"the force of the measured curve must be positive, it is "
                f"{format_si(f[first], 'N')} at {format_si(d[first], 'm')}; take the slack out"
            )
        return cls(d, f, rows, tuple(notes))

    @classmethod
    def joined(cls, curves: Sequence[MeasuredCurve]) -> MeasuredCurve:
        """The points of several curves, one curve after the other."""
        d, f = np.hstack([[curve.displacement, curve.force] for curve in curves])
        which = [f"Curve {i}: " if len(curves) > 1 else "" for i in range(1, len(curves) + 1)]
        notes = [
            start + note for start, curve in zip(which, curves, strict=True) for note in curve.notes
        ]
        return cls(d, f, sum(curve.rows for curve in curves), tuple(notes))

    def where(self, kept: np.ndarray, note: str) -> MeasuredCurve:
        """The points that are ``kept``, bool (n,), with a sentence about the others."""
        notes = (*self.notes, note)
        return MeasuredCurve(self.displacement[kept], self.force[kept], self.rows, notes)


def _loading_branch(d: np.ndarray, f: np.ndarray) -> tuple[np.ndarray, np.ndarray, list[str]]:
    """Points of the loading branch, and sentences about what was left out; see from_points."""
    notes, span = [], np.ptp(d)
    if d.min() < -NOISE * span:
        raise InputError(
            f"the measured curve has the negative displacement {format_si(d.min(), 'm')}, it "
            "must begin at rest"
        )
    largest = np.maximum.accumulate(d)
    turned = largest - d > TURN * span
    if turned.any():
        top = int(d[: turned.argmax()].argmax())
        if d[top:].max() > d[top] + TURN * span:
            raise InputError(
                f"the displacement of the measured curve turns back after {format_si(d[top], 'm')} "
                "and goes on, give one loading branch only"
            )
        notes.append(
            f"The displacement turns back after {format_si(d[top], 'm')}: the loading branch ends "
            f"there, {_rows(len(d) - top - 1)} behind it left out."
        )
        d, f = d[: top + 1], f[: top + 1]
    peak = int(f.argmax())
    end = int(np.flatnonzero(f >= (1.0 - FALL) * f[peak])[-1]) if f[peak] > 0.0 else len(d) - 1
    if end < len(d) - 1:
        notes.append(
            f"The force falls behind its largest, {force_text(f[peak])} at "
            f"{format_si(d[peak], 'm')}, as no law that rises can: the loading branch ends there, "
            f"{_rows(len(d) - end - 1)} from {format_si(d[end + 1], 'm')} on left out."
        )
        d, f = d[: end + 1], f[: end + 1]
    rest = d <= NOISE * span
    noise = int((rest & (d != 0.0)).sum())
    if noise:
        notes.append(
            f"{_rows(noise)} within {format_si(NOISE * span, 'm')} of rest "
            "(a thousandth of the range) left out."
        )
    at_rest, d, f = f[rest], d[~rest], f[~rest]
    if len(at_rest) and len(f) and abs(at_rest.mean()) > AT_REST * abs(np.median(f)):
        notes.append(
            f"At rest the measured force is {force_text(at_rest.mean())}: a preload, or the "
            "machine's zero. It was not taken off the others; do so if it is no load on the cloth."
        )
    loaded = f > NOISE * f.max(initial=0.0)
    slack = int(loaded.argmax()) if loaded.any() else 0
    if slack and (d[:slack] <= SLACK * span).all():
        notes.append(
            f"{_rows(slack)} up to {format_si(d[slack - 1], 'm')} without a force left out: the "
            "specimen was slack."
        )
        d, f = d[slack:], f[slack:]
    return d, f, notes


def _rows(number: int) -> str:
    return f"{number} row" if number == 1 else f"{number} rows"


def read_curve(path: str | Path, columns: str | None = None) -> MeasuredCurve:
    """Read the columns of displacement and force of a text file.

    The first line that gives a length and a force names the columns and their units, as in
    "displacement [mm], force [N]", "extension_mm,load_N" or "Weg (mm);Kraft (kN)"; units may also
    have the line below to themselves. Which column is which follows from the units; ``columns``,
    like "Extension (mm),Load (N)", says which where there are more. Columns end with a tab, a
    semicolon, a bar, a comma or blanks; decimals with a point or a comma. Lines that begin with #,
    %, // or ! are comments. Text is UTF-8, UTF-16 or cp1252. InputErrors name the file and mostly
    the line.
    """
    name = f'measured curve "{path}"'
    data = read_given(path, "measured curve", "CSV", LARGEST_CURVE, zeros=True)
    try:
        displacement, force = read_columns(data, columns)
    except InputError as error:
        comma = ", " if str(error).startswith("line ") else " "
        raise InputError(f"{name}{comma}{error}") from None
    try:
        return MeasuredCurve.from_points(displacement, force)
    except InputError as error:
        raise InputError(f"{name}: {error}") from None


def columns_of_files(columns: Sequence[str], files: int) -> list[str | None]:
    """The columns to read of each file: given once for all, once for each, or not at all."""
    if len(columns) not in (0, 1, files):
        raise InputError(
            f"--columns was given {len(columns)} times for {files} files of measured data, give it "
            "once for all or once for each"
        )
    return list(columns) if len(columns) == files else [columns[0] if columns else None] * files
