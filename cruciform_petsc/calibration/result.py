# SPDX-License-Identifier: MIT
"""What a calibration found, what it does not know, and how well loads are followed."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from ..cloth.fabric import Fabric
from ..drawn import Plotted
from ..laws import Potential, table
from ..quantities import force_text, si_text
from .curve import MeasuredCurve
from .load_curve import PLACE
from .specimen import FormulaGap, Specimen

LARGEST_ERROR = 0.2  # relative; a value whose standard error is larger counts as not determined
POOR_FIT = 0.1  # RMS of the relative error that a remark is made on
RULING = 0.5  # share of the sum of squares of one point that is told
GOOD_POINT = 0.02  # relative error of a point that rules nothing


@dataclass(frozen=True, eq=False)
class Comparison:
    """Loads of a network beside those measured."""

    curve: MeasuredCurve
    loads: np.ndarray  # (n,) of the network with the law, N
    reached: np.ndarray  # (n,) largest shear angle of a crossover at each point, rad

    @property
    def residuals(self) -> np.ndarray:
        """Relative error of each load, (n,)."""
        return self.loads / self.curve.force - 1.0

    @property
    def rms(self) -> float:
        """Root of the mean square of the relative errors."""
        return rms(self.residuals)

    def ruling_point(self) -> str | None:
        """Name a point that makes up most of the sum of squares, if there is one."""
        k = ruling_index(self.residuals)
        if k is None:
            return None
        squares = self.residuals**2
        d, f = self.curve.displacement[k], self.curve.force[k]
        beside = f"(network {force_text(self.loads[k])})"
        return (
            f"The point at {si_text(d, 'm')}, {force_text(f)} {beside}, "
            f"makes up {100 * squares[k] / squares.sum():.0f} % of the sum of squares; the RMS of "
            f"the others is {100 * rms(np.delete(self.residuals, k)):.2f} %."
        )


@dataclass(frozen=True, eq=False)
class Prediction(Comparison):
    """Loads foretold for a specimen that the law was not identified on."""

    known_to: float  # shear angle from which on the law is extrapolated, rad
    gap: FormulaGap | None = None  # of the closed formula, between the two data sets

    def remarks(self) -> list[str]:
        """Say in sentences what speaks for or against the law, and what for or against the data."""
        texts = list(self.curve.notes)
        if point := self.ruling_point():
            texts.append(point)
        if self.gap is None:
            return [*texts, "There is no closed formula to compare the two data sets by."]
        low, high = np.rad2deg([self.gap.low, self.gap.high])
        apart = f"{100 * self.gap.rms:.0f} % (mean {100 * self.gap.mean:+.0f} %)"
        where = f"from {low:.1f} to {high:.1f} deg"
        if self.gap.rms > POOR_FIT:
            text = (
                f"The closed formula itself, without a network, gives laws that differ by {apart} "
                f"{where}: the two data sets disagree, and no law follows both."
            )
        else:
            text = f"By the closed formula the two data sets agree to {apart} {where}."
        return [*texts, text]

    @property
    def extrapolated(self) -> np.ndarray:
        """Points at which some of the cloth shears further than the law is known, bool (n,)."""
        return self.reached > self.known_to * (1.0 + 1e-9)

    @property
    def rms_known(self) -> float:
        """RMS over the other points; NaN if there are none."""
        return rms(self.residuals[~self.extrapolated])


class Assumption(NamedTuple):
    """Relative changes with another value of something assumed."""

    loads: np.ndarray  # (n,) with the law as it is
    values: np.ndarray  # (m,) identified, to first order


@dataclass(frozen=True, eq=False)
class Estimate:
    """Errors of the parameters at the least of |r|^2 + |B p|^2."""

    noise: float  # standard deviation of the data
    errors: np.ndarray  # (m,) standard errors of the parameters
    settled: float  # how many parameters the data settle; the others come from the second term
    singular_values: np.ndarray  # (m,) of the data's derivatives, the largest first


def estimate(
    residuals: np.ndarray, data: np.ndarray, prior: np.ndarray, least_noise: float = 0.0
) -> Estimate:
    """Errors of parameters, from the covariance noise^2 (J'J + B'B)^-1.

    noise^2 = |r|^2/(n - settled) with settled = trace(J (J'J + B'B)^-1 J'), the effective number of
    parameters (Hastie, Tibshirani and Friedman 2009, The Elements of Statistical Learning, sections
    3.2 and 3.4.1); without B that is the m of ordinary least squares.

    Parameters
    ----------
    residuals : float (n,)
        r, all of one standard deviation.
    data, prior : float (n, m), (k, m)
        J, derivatives of the residuals; and B.
    least_noise : float
        Data are no better than that, however well they are met.
    """
    inverse = np.linalg.pinv(data.T @ data + prior.T @ prior, hermitian=True)
    settled = float(np.trace(inverse @ data.T @ data))
    free = max(len(data) - settled, 1.0)
    noise = max(float(np.sqrt(residuals @ residuals / free)), least_noise)
    found = np.linalg.svd(data, compute_uv=False)
    singular = np.pad(found, (0, data.shape[1] - len(found)))
    errors = noise * np.sqrt(np.maximum(np.diag(inverse), 0.0))
    return Estimate(noise, errors, settled, singular)


@dataclass(frozen=True, eq=False)
class Calibration(Comparison, Plotted):
    """A shear law identified from load curves, all their points one after the other.

    ``estimate`` is for relative changes of the values and of the loads, d ln F_i/d ln psi'_k.
    ``assumptions``: what twice the tension modulus, the yarn bending, the stiffness in compression
    would change, and another place of the yarns in the specimen, half a cell of the lattice away.
    """

    specimens: tuple[Specimen, ...]
    start_law: Potential
    start_from: str  # what start_law is, "closed formula" or "straight line"
    start_loads: np.ndarray  # (n,) of the network with the start, N
    angles: np.ndarray  # (m,) of the law's table, rad
    values: np.ndarray  # (m,) of the law's table, N/m
    estimate: Estimate
    assumptions: dict[str, Assumption]
    smoothing: float
    iterations: int  # least-squares steps
    evaluations: int  # curves of loads computed
    newton_steps: int  # in all
    seconds: float
    message: str  # why the iterations ended

    @property
    def law(self) -> Potential:
        """Psi over the shear angle [N/m over rad]."""
        return table(self.angles, self.values)

    @property
    def fabric(self) -> Fabric:
        """The cloth with this law."""
        return self.specimens[0].network.fabric.with_shear_law(self.law)

    @property
    def standard_errors(self) -> np.ndarray:
        """Of the values, (m,) N/m."""
        return self.estimate.errors * self.values

    @property
    def determined(self) -> np.ndarray:
        """Whether the data determine each value, bool (m,).

        Cloth sheared beyond the angle before, and the standard error is at most LARGEST_ERROR.
        """
        visited = np.append(0.0, self.angles[:-1]) < self.reached.max()
        return visited & (self.estimate.errors <= LARGEST_ERROR)

    @property
    def parts(self) -> list[slice]:
        """Which points belong to which specimen's curve."""
        ends = np.cumsum([0] + [len(s.curve.force) for s in self.specimens])
        return [slice(int(low), int(high)) for low, high in pairwise(ends)]

    @property
    def start_rms(self) -> float:
        """Root of the mean square of the relative errors of the start."""
        return rms(self.start_loads / self.curve.force - 1.0)

    @property
    def dependent(self) -> np.ndarray:
        """Where the law depends on something assumed by more than LARGEST_ERROR, bool (m,)."""
        changes = [np.abs(assumption.values) for assumption in self.assumptions.values()]
        return np.max([np.zeros(len(self.angles)), *changes], axis=0) > LARGEST_ERROR

    @property
    def known_to(self) -> float:
        """Shear angle from which on the law is extrapolated, rad."""
        return min(float(self.reached.max()), float(self.angles[-1]))

    def uncertain_ranges(self) -> list[tuple[float, float]]:
        """Ranges of angles, rad, that the data do not determine; the last one has no end."""
        ranges = self.ranges(~self.determined)
        if not ranges or ranges[-1][1] < np.inf:
            ranges.append((self.known_to, np.inf))
        ranges[-1] = (min(ranges[-1][0], self.known_to), np.inf)
        return ranges

    def ranges(self, marked: np.ndarray) -> list[tuple[float, float]]:
        """Ranges of angles, rad, from before each marked one of the table to after it."""
        knots = [0.0, *map(float, self.angles), np.inf]
        ranges: list[tuple[float, float]] = []
        for k in np.flatnonzero(marked):
            low = ranges.pop()[0] if ranges and knots[k] <= ranges[-1][1] else knots[k]
            ranges.append((low, knots[k + 2]))
        return ranges

    def usable_ranges(self) -> list[tuple[float, float]]:
        """Ranges of angles, rad, that may be used: determined, and by the data, not assumptions."""
        low, ranges = float(self.reached.min()), []
        bad = self.ranges(~self.determined | self.dependent)
        for start, end in [*bad, (self.known_to, np.inf)]:
            if start > low:
                ranges.append((low, min(start, self.known_to)))
            low = max(low, end)
        return ranges

    def verdict(self, prediction: Prediction | None = None) -> str:
        """In one line, what of the law may be used."""
        usable = ", ".join(
            f"{low:.1f} to {high:.1f} deg" for low, high in np.rad2deg(self.usable_ranges())
        )
        percent = f"{100 * LARGEST_ERROR:.0f} %"
        if self.rms > POOR_FIT:
            text = (
                f"none of the law: the network does not follow the curve ({100 * self.rms:.0f} %)"
            )
        elif usable:
            text = f"the law from {usable} (standard error and what was assumed: below {percent})"
        else:
            text = f"none of the law: no part is known to {percent}"
        error = float("nan") if prediction is None else prediction.rms_known
        if error > POOR_FIT:
            text += f"; it does not foretell the second specimen (RMS {100 * error:.0f} %)"
        return text

    def remarks(self) -> list[str]:
        """Say in sentences what was left out, and what the data do not tell."""
        first, last = np.rad2deg([self.reached.min(), self.reached.max()])
        texts = list(self.curve.notes)
        if self.rms > self.start_rms * 1.001:
            texts.append(
                f"The fit follows the curve worse than its start ({100 * self.rms:.2f} for "
                f"{100 * self.start_rms:.2f} % RMS)."
            )
        if point := self.ruling_point():
            texts.append(point)
        *gaps, (beyond, _) = np.rad2deg(self.uncertain_ranges())
        percent = f"{100 * LARGEST_ERROR:.0f} %"
        texts += [
            f"The specimen sheared by up to {first:.1f} deg at its first point and {last:.1f} deg "
            "at its last: before, the law is a curve from zero; past that it is extrapolated along "
            "its last slope."
        ]
        texts += [
            f"Between {low:.1f} and {high:.1f} deg the data do not determine the law to {percent}: "
            "it follows from smoothness there."
            for low, high in gaps
        ]
        if beyond < last * (1 - 1e-9) and not self.determined[-1]:
            texts.append(
                f"From {beyond:.1f} deg on the data do not determine the law to {percent}, though "
                "some of the cloth sheared more."
            )
        if self.rms > POOR_FIT:
            texts.append(
                f"The network does not follow the curve (RMS of the relative error "
                f"{100 * self.rms:.0f} %): check the specimen's size, the units and the yarns."
            )
        for name, assumption in self.assumptions.items():
            load, value = 100 * abs(assumption.loads).max(), 100 * abs(assumption.values).max()
            other, fixed = f"Twice the {name}", f"the fabric's {name}"
            if name == PLACE:
                other, fixed = "Yarns half a cell away", "the place of the yarns in the specimen"
            if value > 5.0:
                texts.append(
                    f"{other} would change loads by up to {load:.0f} % and the law by up to "
                    f"{value:.0f} %: the law holds together with {fixed}."
                )
        return texts


def ruling_index(residuals: np.ndarray) -> int | None:
    """Which of the relative errors (n,) makes up most of their sum of squares, if one does."""
    squares = residuals**2
    k = int(squares.argmax())
    return None if squares[k] < max(RULING * squares.sum(), GOOD_POINT**2) else k


def rms(values: np.ndarray) -> float:
    """Root of the mean square; NaN of nothing."""
    return float(np.sqrt(np.mean(np.square(values)))) if len(values) else float("nan")
