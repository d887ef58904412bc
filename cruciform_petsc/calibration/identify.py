# SPDX-License-Identifier: MIT
"""Least squares for the shear law on the network itself.

Unknown are the rises of a table psi'(gamma) from one angle to the next, none of them negative.
The sum that is made small is

    1/n sum ((F_i - f_i)/f_i)^2 + smoothing^2/m sum s_k^2
    s_k = second difference of ln psi' over ln gamma at the inner angle k, of m:
          (slope after - slope before)(mean of the neighbouring steps)

F_i being the load of the whole network at the measured displacement, f_i the measured force. The
second term is none for a straight line, for a plateau and for any power of the angle, and little
for a law that climbs steeply towards locking.
"""

from __future__ import annotations

import logging
import time
from collections.abc import Callable, Sequence
from contextlib import ExitStack, suppress
from functools import partial
from typing import Any

import numpy as np

from ..errors import CruciformError, EquilibriumError, InputError
from ..laws import Potential, linear, table
from ..net.network import Network
from .curve import MeasuredCurve
from .load_curve import DOUBLED, PLACE, LoadCurve, Loads
from .result import (
    Assumption,
    Calibration,
    Estimate,
    Prediction,
    estimate,
    rms,
    ruling_index,
)
from .rising import Bounds, RisingTable, rising_law, table_angles, value_changes
from .specimen import Specimen, formula_gap

SMOOTHING = 0.3
NO_WORSE = 1.001  # times the start's error: a start that is a formula is not quite a table
LEAST_NOISE = 0.01  # relative; loads are not measured better, however well a curve may fit
# What ends the iterations: relative changes of the sum and of the parameters, the sum's slope.
ENDS: dict[str, Any] = {"ftol": 1e-5, "xtol": 1e-10, "gtol": 1e-7, "max_nfev": 40}
_LEAST = "the sum of squares is at its least"
_ENDED = {
    0: "the iterations were as many as are allowed",
    3: "no step makes the sum of squares smaller",
}
_LOG = logging.getLogger(__name__)
Stepped = Callable[[np.ndarray, np.ndarray, str], None]


def calibrate(
    network: Network, displacement: Any, force: Any = None, **settings: Any
) -> Calibration:
    """Identify the shear law of a network's fabric from a measured load curve. Collective.

    All else is taken from the fabric as it is: tension, compression, yarn bending.

    Parameters
    ----------
    network : Network
        Of the specimen, any outline and size.
    displacement, force : sequence of float
        Measured [m, N]; or a MeasuredCurve instead of the two.
    **settings
        ``kind``, ``upper``, ``bending``: see Specimen. The others, and errors raised: see
        calibrate_together.
    """
    test = {key: settings.pop(key) for key in ("kind", "upper", "bending") if key in settings}
    curve = _curve(displacement, force, "calibrate")
    return calibrate_together([Specimen(network, curve, **test)], **settings)


def calibrate_together(
    specimens: Sequence[Specimen],
    *,
    angles: Any = None,
    smoothing: float = SMOOTHING,
    bounds: Bounds = (None, None),
    options: dict | None = None,
    told: Callable[[str], None] | None = None,
    stepped: Stepped | None = None,
) -> Calibration:
    """Identify one shear law from measured curves of several specimens. Collective.

    The mean over a curve's points is what its weight multiplies, so that a curve with many points
    counts like one with few. The fabric is that of the first specimen.

    Parameters
    ----------
    specimens : sequence of Specimen
    angles : sequence of float, optional
        Of the law's table [rad]; default: a ladder as far as the specimens shear.
    smoothing : float
        Weight of the law's second differences: a bend of the size of the law itself counts like
        this relative error of a load.
    bounds : (Potential or None, Potential or None)
        Laws that psi' of the table may not be below, or above.
    options : dict, optional
        PETSc options for the solver.
    told : callable, optional
        Told a line for each step.
    stepped : callable, optional
        Called with angles [rad] and values [N/m] of the law after each step, and its error in
        words. Collective.

    InputError or SolverError on every rank: bad data; no equilibrium with the start, for instance
    because no network of this shape can be extended as far as the data go.
    """
    begin, told = time.perf_counter(), told or _LOG.info
    if not (np.isfinite(smoothing) and smoothing > 0.0):
        raise InputError(f"smoothing must be positive and finite, got {smoothing:g}")
    if not specimens:
        raise InputError("calibrate_together needs a specimen")
    specimens = [s.checked() for s in specimens]
    comm = specimens[0].network.comm
    with ExitStack() as stack:
        curves = []
        for s in specimens:
            curves.append(LoadCurve(s, options))
            stack.callback(curves[-1].destroy)
        try:
            start_from, first = _first_law(curves)
            start = [curve.solve(first) for curve in curves]
            reached = np.concatenate([part.angles for part in start])
            rising = RisingTable(table_angles(angles, reached), first, bounds)
            fit = _Fit(curves, start, rising, smoothing, told, stepped)
            start_loads, start_error = fit.loads, fit.error
            told(f"start from the {start_from}, RMS {fit.percent}")
            message = fit.minimise()
            if angles is None and comm.bcast(fit.ruled_by_its_beginning()):
                # Beside the middle of a strip cloth shears half as much.
                told("the first point rules: once more, with an angle at half its own")
                more = table_angles(None, np.append(reached, 0.5 * reached.min()))
                finer = _Fit(
                    curves, start, RisingTable(more, first, bounds), smoothing, told, stepped
                )
                with suppress(EquilibriumError):  # which leaves the fit as it is
                    other = finer.minimise()
                    finer.evaluations += fit.evaluations
                    if not finer.worse_than(fit.error):
                        fit, message = finer, other
            if angles is None and bounds == (None, None) and fit.worse_than(start_error):
                told("that is worse than the start: once more, with the start's own angles")
                with suppress(EquilibriumError):  # which leaves the fit as it is
                    fit, message = _no_worse(fit, start, first, start_error)
        except EquilibriumError as error:
            raise InputError(
                "the network of the specimen has no equilibrium with the start for the law "
                f"({error}): check the specimen's size against the displacements, or leave out the "
                "last"
            ) from error
        return Calibration(
            fit.curve,
            fit.loads,
            np.concatenate([part.angles for part in fit.solved]),
            tuple(specimens),
            first,
            start_from,
            start_loads,
            fit.angles,
            fit.values,
            comm.bcast(fit.estimate()),
            comm.bcast(fit.assumptions()),
            fit.smoothing,
            fit.steps,
            fit.evaluations,
            sum(curve.newton_steps for curve in curves),
            time.perf_counter() - begin,
            message,
        )


def predict(
    law: Calibration | Potential,
    network: Network,
    displacement: Any,
    force: Any = None,
    *,
    options: dict | None = None,
    **test: Any,
) -> Prediction:
    """Predict a measured load curve of another specimen. Collective.

    The ``law`` was identified elsewhere: of a Calibration the whole fabric is taken, else the
    network's fabric with this law of shear. The network is that of the specimen to predict; for the
    others see calibrate.

    InputError or SolverError on every rank: bad data, or no equilibrium at a displacement.
    """
    measured = _curve(displacement, force, "predict")
    known_to, fitted = np.inf, None
    if isinstance(law, Calibration):
        fitted = law.specimens
        network = Network(network.comm, network.preform, law.fabric)
        known_to, law = law.known_to, law.law
    specimen = Specimen(network, measured, **test).checked()
    curve = LoadCurve(specimen, options)
    try:
        found = curve.solve(law)
    except EquilibriumError as error:
        raise InputError(
            f"the specimen to be predicted has no equilibrium with the law ({error}): check its "
            "size against the displacements, or leave out the last"
        ) from error
    finally:
        curve.destroy()
    gap = None if fitted is None else formula_gap(fitted, specimen)
    return Prediction(specimen.curve, found.loads, found.angles, known_to, gap)


def _curve(displacement: Any, force: Any, user: str) -> MeasuredCurve:
    """The curve that ``user`` was given, or whose points it was given."""
    if isinstance(displacement, MeasuredCurve):
        return displacement
    if force is None:
        raise InputError(f"{user} needs the forces beside the displacements")
    return MeasuredCurve.from_points(displacement, force)


def _first_law(curves: Sequence[LoadCurve]) -> tuple[str, Potential]:
    """Law to start from: of the closed formula, or else a straight line. Collective."""
    # A frame gives the law point by point; from strips the first.
    best = next((curve for curve in curves if curve.specimen.is_frame), curves[0])
    points = best.specimen.closed_formula()
    if points is not None:
        # Past some 35 degrees the formula of strips errs, mostly downwards; the law may not fall.
        return "closed formula", rising_law(*points)
    modulus = best.specimen.network.fabric.shear_modulus
    ratio = best.solve(linear(modulus)).loads / best.specimen.curve.force
    return "straight line", linear(modulus * float(ratio.sum() / (ratio**2).sum()))


def _no_worse(fit: _Fit, start: list[Loads], first: Potential, error: float) -> tuple[_Fit, str]:
    """A fit at the start's own angles that follows the data no worse, or the start. Collective."""
    angles = fit.angles if first.name == "linear" else first.knots[1:]
    evaluations = fit.evaluations
    for less in (0.1, 0.01, 0.0):
        rising, smoothing = RisingTable(angles, first), max(less, 0.01) * fit.smoothing
        finer = _Fit(fit.curves, start, rising, smoothing, fit.told, fit.stepped)
        message = finer.minimise() if less else finer.stay()
        finer.evaluations = evaluations = evaluations + finer.evaluations
        if not finer.worse_than(error):
            break
    return finer, message


class _Fit:
    """The sum of squares over the parameters z of a rising table, and the last accepted step.

    Of that step ``solved`` are the loads, ``values`` (m,) the table, ``relative`` and ``by_z``
    (n + m - 2, m) the derivatives, by the logarithms of the values and by z, of what is squared and
    summed: n weighted relative errors, then second differences.
    """

    def __init__(
        self,
        curves: Sequence[LoadCurve],
        start: list[Loads],
        rising: RisingTable,
        smoothing: float,
        told: Callable[[str], None],
        stepped: Stepped | None,
    ):
        self.curves, self.solved, self._rising, self.told = curves, start, rising, told
        self.stepped = stepped
        self.angles, self.smoothing, self.evaluations = rising.angles, smoothing, 0
        self.comm = curves[0].specimen.network.comm
        specimens = [curve.specimen for curve in curves]
        self.curve = MeasuredCurve.joined([s.curve for s in specimens])
        sizes = [len(s.curve.force) for s in specimens]
        weight = np.repeat([s.weight / n for s, n in zip(specimens, sizes, strict=True)], sizes)
        self._weight = np.sqrt(weight / weight.sum())
        self._bends = smoothing / np.sqrt(max(len(rising.bends), 1)) * rising.bends
        self.steps = -1  # the table to start from is none

    @property
    def loads(self) -> np.ndarray:
        """Of the last step, N."""
        return np.concatenate([part.loads for part in self.solved])

    @property
    def percent(self) -> str:
        """RMS of the relative errors of the last step."""
        return f"{100.0 * rms(self.loads / self.curve.force - 1.0):.2f} %"

    @property
    def error(self) -> float:
        """Root of the weighted mean square of the relative errors of the last step."""
        return float(np.linalg.norm(self._weight * (self.loads / self.curve.force - 1.0)))

    def ruled_by_its_beginning(self) -> bool:
        """Whether the first point of a strip's curve makes up most of the sum of squares."""
        first = np.cumsum([0, *(len(part.loads) for part in self.solved[:-1])])
        strips = [not curve.specimen.is_frame for curve in self.curves]
        return ruling_index(self.loads / self.curve.force - 1.0) in first[strips]

    def worse_than(self, error: float) -> bool:
        """Whether the data are followed worse than that; the same on every rank. Collective."""
        return self.comm.bcast(self.error > NO_WORSE * error)

    def _sum_of(self, loads: np.ndarray, values: np.ndarray) -> np.ndarray:
        errors = self._weight * (loads / self.curve.force - 1.0)
        return np.concatenate([errors, self._bends @ np.log(values)])

    def residuals(self, z: np.ndarray) -> np.ndarray:
        """What is squared and summed at z; not finite if there is no equilibrium. Collective."""
        values = self._rising.values(z)[0]
        law = table(self._rising.angles, values)
        pairs = zip(self.curves, self.solved, strict=True)
        try:
            self._trial = [curve.solve(law, start) for curve, start in pairs]
        except EquilibriumError:
            if self.steps < 0:
                raise
            return np.full(len(self._weight) + len(self._bends), np.nan)
        return self._sum_of(np.concatenate([part.loads for part in self._trial]), values)

    def jacobian(self, z: np.ndarray) -> np.ndarray:
        """Accept z, whose residuals were worked out last; their derivatives by z. Collective."""
        self.z, self.solved, self.steps = z, self._trial, self.steps + 1
        self.values, self._slopes = self._rising.values(z)
        if self.steps:
            self.told(f"step {self.steps}, RMS {self.percent}")
            if self.stepped is not None:
                self.stepped(self.angles, self.values, f"step {self.steps}, RMS {self.percent}")
        changes = partial(value_changes, self._rising.angles, self.values)
        pairs = zip(self.curves, self.solved, strict=True)
        rates = np.concatenate([curve.derivatives(at, changes) for curve, at in pairs])
        data = (self._weight / self.curve.force)[:, None] * rates * self.values
        self.relative = np.concatenate([data, self._bends])
        self.by_z = self.relative / self.values @ self._slopes
        return self.by_z

    def stay(self) -> str:
        """Accept the table to start from; returns why. Collective."""
        self.residuals(self._rising.start)
        self.jacobian(self._rising.start)
        self.evaluations = 1
        return "the start is kept, no smoother law follows the data as well"

    def minimise(self) -> str:
        """Go to the least sum; returns why it ended.

        Collective. SciPy runs on rank 0 alone, so that no two ranks decide differently, and asks
        all of them for residuals and derivatives. Its method: Branch, Coleman and Li 1999, SIAM J.
        Sci. Comput. 21:1.
        """
        comm = self.comm
        while comm.rank:
            what, value = comm.bcast(None)
            if what == "ended":
                message, self.evaluations = value
                return message
            if what == "failed":
                raise RuntimeError(value)
            getattr(self, what)(value)

        def ask(what: str, z: np.ndarray) -> np.ndarray:
            comm.bcast((what, z))
            return getattr(self, what)(z)

        from scipy.optimize import least_squares

        residuals, jacobian = partial(ask, "residuals"), partial(ask, "jacobian")
        start, box = self._rising.start, self._rising.box
        try:
            found = least_squares(residuals, start, jacobian, box, **ENDS)
        except CruciformError:  # by what was asked, on all ranks
            raise
        except Exception as error:
            comm.bcast(("failed", f"on rank 0: {type(error).__name__}: {error}"))
            raise
        message, self.evaluations = _ENDED.get(found.status, _LEAST), found.nfev
        comm.bcast(("ended", (message, found.nfev)))
        return message

    def estimate(self) -> Estimate:
        """Errors of the values, relative.

        A curve with twice the weight counts as if its points scattered by 1/sqrt(2).
        """
        n = len(self._weight)
        errors = self._sum_of(self.loads, self.values)[:n]
        rows = np.sqrt(n) * self.relative
        return estimate(np.sqrt(n) * errors, rows[:n], rows[n:], LEAST_NOISE)

    def assumptions(self) -> dict[str, Assumption]:
        """What other values of what was assumed would change. Collective."""
        from scipy.optimize import lsq_linear

        # With zero between the two sides.
        room = self._rising.box - self.z + [[-1e-12], [1e-12]]
        result = {}
        for what in (*DOUBLED, PLACE):
            pairs = zip(self.curves, self.solved, strict=True)
            parts = [curve.solve_otherwise(what, at) for curve, at in pairs]
            found = [part for part in parts if part is not None]
            if len(found) == len(parts):
                loads = np.concatenate(found)
                step = lsq_linear(self.by_z, -self._sum_of(loads, self.values), room).x
                change = self._slopes @ step / self.values
                result[what] = Assumption(loads / self.loads - 1.0, change)
        return result
