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
from contextlib import ExitStack
from functools import partial
from typing import Any

import numpy as np
from mpi4py import MPI

from ..equilibrium.newton import EquilibriumError
from ..errors import CruciformError, InputError
from ..laws import Potential, linear
from ..net.network import Network
from .curve import MeasuredCurve
from .load_curve import DOUBLED, PLACE, LoadCurve, Loads
from .result import LARGEST_ERROR, Assumption, Calibration, Prediction, rms
from .rising import Bounds, RisingTable, law_of, rising_law, table_angles, value_changes
from .specimen import Specimen
from .statistics import estimate

SMOOTHING = 0.3
LEAST_NOISE = 0.01  # relative; loads are not measured better, however well a curve may fit
TOLERANCE = 1e-5  # relative change of the sum that ends the iterations
FLAT = 1e-7  # of the sum's slope
MOST_EVALUATIONS = 40
_LEAST = "the sum of squares is at its least"
_ENDED = {
    0: "the iterations were as many as are allowed",
    3: "no step makes the sum of squares smaller",
}
_LOG = logging.getLogger(__name__)


def calibrate(
    network: Network,
    displacement: Any,
    force: Any = None,
    *,
    angles: Any = None,
    smoothing: float = SMOOTHING,
    bounds: Bounds = (None, None),
    options: dict | None = None,
    told: Callable[[str], None] | None = None,
    **test: Any,
) -> Calibration:
    """Identify the shear law of a network's fabric from a measured load curve. Collective.

    All else is taken from the fabric as it is: tension, compression, yarn bending.

    Parameters
    ----------
    network : Network
        Of the specimen, any outline and size.
    displacement, force : sequence of float
        Measured [m, N]; or a MeasuredCurve instead of the two.
    angles : sequence of float, optional
        Of the law's table [rad]; default: a ladder as far as the specimen shears.
    smoothing : float
        Weight of the law's second differences: a bend of the size of the law itself counts like
        this relative error of a load.
    bounds : (Potential or None, Potential or None)
        Laws that psi' of the table may not be below, or above.
    options : dict, optional
        PETSc options for the solver.
    told : callable, optional
        Told a line for each step.
    **test
        ``kind``, ``upper`` and ``bending``: see Specimen.

    Raises
    ------
    InputError, SolverError
        On every rank: bad data; no equilibrium with the start, for instance because no network of
        this shape can be extended as far as the data go.
    """
    return calibrate_together(
        [Specimen.measured(network, displacement, force, "calibrate", **test)],
        angles=angles,
        smoothing=smoothing,
        bounds=bounds,
        options=options,
        told=told,
    )


def calibrate_together(
    specimens: Sequence[Specimen],
    *,
    angles: Any = None,
    smoothing: float = SMOOTHING,
    bounds: Bounds = (None, None),
    options: dict | None = None,
    told: Callable[[str], None] | None = None,
) -> Calibration:
    """Identify one shear law from measured curves of several specimens. Collective.

    The mean over a curve's points is what its weight multiplies, so that a curve with many points
    counts like one with few. The fabric is that of the first specimen.

    Parameters
    ----------
    specimens : sequence of Specimen
    angles, smoothing, bounds, options, told
        See calibrate.

    Raises
    ------
    InputError, SolverError
        See calibrate.
    """
    begin = time.perf_counter()
    told = told or _LOG.info
    if not (np.isfinite(smoothing) and smoothing > 0.0):
        raise InputError(f"smoothing must be positive and finite, got {smoothing:g}")
    if not specimens:
        raise InputError("calibrate_together needs a specimen")
    for s in specimens:
        s.check()
    network = specimens[0].network
    with ExitStack() as stack:
        curves = []
        for s in specimens:
            curves.append(s.load_curve(options))
            stack.callback(curves[-1].destroy)
        try:
            start_from, first = _first_law(specimens, curves)
            start = [curve.solve(first) for curve in curves]
            table = RisingTable(
                table_angles(angles, float(_joined(start, "angles").max())), first, bounds
            )
            fit = _Fit(specimens, curves, start, table, smoothing, told)
            start_loads = _joined(start, "loads")
            told(f"start from the {start_from}, RMS {fit.percent(start_loads)}")
            message, evaluations = fit.minimise(network.comm)
        except EquilibriumError as error:
            raise InputError(
                "the network of the specimen has no equilibrium with the start for the law "
                f"({error}): check the specimen's size against the displacements, or leave out the "
                "last"
            ) from error
        loads, reached = _joined(fit.solved, "loads"), _joined(fit.solved, "angles")
        n = len(loads)
        # Relative in the values, so that singular values are plain numbers; a curve with twice the
        # weight counts as if it scattered by 1/sqrt(2).
        found = estimate(
            np.sqrt(n) * fit.sum_of[:n],
            np.sqrt(n) * fit.relative[:n],
            np.sqrt(n) * fit.relative[n:],
            LEAST_NOISE,
        )
        found = network.comm.bcast(found)
        visited = np.append(0.0, table.angles[:-1]) < reached.max()
        law = fit.solved[0].law
        return Calibration(
            curve=fit.measured,
            loads=loads,
            fabric=network.fabric.with_shear_law(law),
            specimens=tuple(specimens),
            law=law,
            start_law=first,
            start_from=start_from,
            start_loads=start_loads,
            angles=table.angles,
            values=fit.values,
            standard_errors=found.errors * fit.values,
            determined=(found.errors <= LARGEST_ERROR) & visited,
            reached=reached,
            noise=found.noise,
            singular_values=found.singular_values,
            effective_parameters=found.settled,
            assumptions=network.comm.bcast(fit.assumptions()),
            smoothing=smoothing,
            iterations=fit.steps,
            evaluations=evaluations,
            newton_steps=sum(curve.newton_steps for curve in curves),
            seconds=time.perf_counter() - begin,
            message=message,
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

    Parameters
    ----------
    law : Calibration or Potential
        What was identified elsewhere; of a Calibration the whole fabric is taken, else the
        network's fabric with this law of shear.
    network : Network
        Of the specimen to predict.
    displacement, force, options, **test
        See calibrate.

    Raises
    ------
    InputError, SolverError
        On every rank: bad data, or no equilibrium at a displacement.
    """
    known_to = np.inf
    if isinstance(law, Calibration):
        known_to, fabric, law = law.known_to, law.fabric, law.law
        network = Network(network.comm, network.preform, fabric)
    specimen = Specimen.measured(network, displacement, force, "predict", **test)
    specimen.check()
    curve = specimen.load_curve(options)
    try:
        found = curve.solve(law)
    except EquilibriumError as error:
        raise InputError(
            f"the specimen to be predicted has no equilibrium with the law ({error}): check its "
            "size against the displacements, or leave out the last"
        ) from error
    finally:
        curve.destroy()
    return Prediction(specimen.curve, found.loads, found.angles, known_to)


def _first_law(specimens: Sequence[Specimen], curves: Sequence[LoadCurve]) -> tuple[str, Potential]:
    """Law to start from: of the closed formula, or else a straight line. Collective."""
    # A frame gives the law point by point; from strips the first.
    best = next((i for i, s in enumerate(specimens) if s.kind == "picture-frame"), 0)
    points = specimens[best].closed_formula()
    if points is not None:
        # Past some 35 degrees the formula of strips errs, mostly downwards; the law may not fall.
        return "closed formula", rising_law(*points)
    modulus = specimens[best].network.fabric.shear_modulus
    ratio = curves[best].solve(linear(modulus)).loads / specimens[best].curve.force
    return "straight line", linear(modulus * float(ratio.sum() / (ratio**2).sum()))


def _joined(parts: Sequence[Loads], name: str) -> np.ndarray:
    return np.concatenate([getattr(part, name) for part in parts])


class _Fit:
    """The sum of squares, over the parameters z of a rising table. Collective.

    Attributes
    ----------
    measured : MeasuredCurve
        Of all specimens.
    z, values, solved
        Of the last accepted step: parameters, table, loads.
    sum_of : float (n + m - 2,)
        What is squared and summed there: weighted relative errors, then second differences.
    relative : float (n + m - 2, m)
        Its derivatives by the logarithms of the values.
    slopes : float (m, m)
        Those of the values by z.
    steps : int
    """

    def __init__(
        self,
        specimens: Sequence[Specimen],
        curves: list[LoadCurve],
        start: list[Loads],
        table: RisingTable,
        smoothing: float,
        told: Callable[[str], None],
    ):
        self.curves, self.solved, self.table, self._told = curves, start, table, told
        self.measured = specimens[0].curve
        if len(specimens) > 1:
            self.measured = MeasuredCurve(
                np.concatenate([s.curve.displacement for s in specimens]),
                np.concatenate([s.curve.force for s in specimens]),
                sum(s.curve.rows for s in specimens),
            )
        weights = [np.full(len(s.curve.force), s.weight / len(s.curve.force)) for s in specimens]
        self._weight = np.sqrt(np.concatenate(weights) / sum(s.weight for s in specimens))
        self._bends = smoothing / np.sqrt(max(len(table.bends), 1)) * table.bends
        self.steps = -1  # the start is none
        self._trial: list[Loads] = []

    def percent(self, loads: np.ndarray) -> str:
        """RMS of the relative errors of loads."""
        return f"{100.0 * rms(loads / self.measured.force - 1.0):.2f} %"

    def residuals(self, z: np.ndarray) -> np.ndarray:
        """What is squared and summed at z; not finite if there is no equilibrium."""
        values = self.table.values(z)[0]
        law = law_of(self.table.angles, values)
        try:
            self._trial = [
                c.solve(law, start) for c, start in zip(self.curves, self.solved, strict=True)
            ]
        except EquilibriumError:
            if self.steps < 0:
                raise
            return np.full(len(self._weight) + len(self._bends), np.nan)
        errors = _joined(self._trial, "loads") / self.measured.force - 1.0
        return np.concatenate([self._weight * errors, self._bends @ np.log(values)])

    def jacobian(self, z: np.ndarray) -> np.ndarray:
        """Accept z, where the residuals were just worked out, and return their derivatives."""
        self.z, self.solved, self.steps = z, self._trial, self.steps + 1
        self.values, self.slopes = self.table.values(z)
        loads = _joined(self.solved, "loads")
        errors = loads / self.measured.force - 1.0
        if self.steps:
            self._told(f"step {self.steps}, RMS {self.percent(loads)}")
        changes = partial(value_changes, self.table.angles, self.values)
        parts = [c.derivatives(at, changes) for c, at in zip(self.curves, self.solved, strict=True)]
        weight = self._weight / self.measured.force
        data = weight[:, None] * np.concatenate(parts) * self.values
        self.sum_of = np.concatenate([self._weight * errors, self._bends @ np.log(self.values)])
        self.relative = np.concatenate([data, self._bends])
        return self.relative / self.values @ self.slopes

    def minimise(self, comm: MPI.Intracomm) -> tuple[str, int]:
        """Go to the least sum; returns why it ended, and how many curves were computed.

        SciPy runs on rank 0 alone, so that no two ranks decide differently, and asks all of them
        for residuals and derivatives: Branch, Coleman and Li 1999, SIAM J. Sci. Comput. 21:1.
        """
        if comm.rank:
            while True:
                name, value = comm.bcast(None)
                if name == "end":
                    return value
                if name == "error":
                    raise RuntimeError(value)
                getattr(self, name)(value)

        def ask(name: str, z: np.ndarray) -> np.ndarray:
            comm.bcast((name, z))
            return getattr(self, name)(z)

        from scipy.optimize import least_squares

        try:
            found = least_squares(
                partial(ask, "residuals"),
                self.table.start,
                partial(ask, "jacobian"),
                bounds=self.table.box,
                ftol=TOLERANCE,
                xtol=1e-10,
                gtol=FLAT,
                max_nfev=MOST_EVALUATIONS,
            )
        except CruciformError:  # from what was asked, on all ranks
            raise
        except Exception as error:
            comm.bcast(("error", f"on rank 0: {type(error).__name__}: {error}"))
            raise
        return comm.bcast(("end", (_ENDED.get(found.status, _LEAST), found.nfev)))[1]

    def assumptions(self) -> dict[str, Assumption]:
        """What other values of what was assumed would change, the law to first order."""
        from scipy.optimize import lsq_linear

        loads, n = _joined(self.solved, "loads"), len(self._weight)
        room = self.table.box - self.z + 1e-12 * np.array([[-1.0], [1.0]])  # on both sides of zero
        result = {}
        for what in (*DOUBLED, PLACE):
            others = [
                c.solve_otherwise(what, at) for c, at in zip(self.curves, self.solved, strict=True)
            ]
            found = [other for other in others if other is not None]
            if len(found) < len(others):
                continue
            other = np.concatenate(found)
            shifted = self.sum_of.copy()
            shifted[:n] += self._weight * (other - loads) / self.measured.force
            step = lsq_linear(self.relative / self.values @ self.slopes, -shifted, room).x
            result[what] = Assumption(other / loads - 1.0, self.slopes @ step / self.values)
        return result
