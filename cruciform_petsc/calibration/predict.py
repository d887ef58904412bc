# SPDX-License-Identifier: MIT
"""Hold-out: a law identified on one specimen predicts the load curve of another."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from ..equilibrium.newton import EquilibriumError
from ..errors import InputError
from ..laws import Potential
from ..net.network import Network
from .curve import MeasuredCurve
from .identify import Calibration, LoadCurve, _check_reach


@dataclass(frozen=True, eq=False)
class Prediction:
    """Loads foretold for a specimen that the law was not identified on.

    Attributes
    ----------
    curve : MeasuredCurve
        What was measured.
    loads : float (n,)
        Of the network with the law [N].
    angles : float (n,)
        Largest shear angle of a crossover at each point [rad].
    known_to : float
        Shear angle from which on the law is extrapolated [rad].
    """

    curve: MeasuredCurve
    loads: np.ndarray
    angles: np.ndarray
    known_to: float

    @property
    def residuals(self) -> np.ndarray:
        """Relative error of each load, (n,)."""
        return self.loads / self.curve.force - 1.0

    @property
    def rms(self) -> float:
        """Root of the mean square of the relative errors."""
        return float(np.sqrt(np.mean(self.residuals**2)))

    @property
    def extrapolated(self) -> np.ndarray:
        """Points at which some of the cloth shears further than the law is known, bool (n,)."""
        return self.angles > self.known_to * (1.0 + 1e-9)

    @property
    def rms_known(self) -> float:
        """RMS over the other points; NaN if there are none."""
        inside = self.residuals[~self.extrapolated]
        return float(np.sqrt(np.mean(inside**2))) if inside.size else float("nan")


def predict(
    law: Calibration | Potential,
    network: Network,
    displacement: Any,
    force: Any = None,
    *,
    kind: str = "bias-extension",
    upper: str = "grip",
    bending: bool = True,
    options: dict | None = None,
) -> Prediction:
    """Predict a measured load curve of another specimen. Collective.

    Parameters
    ----------
    law : Calibration or Potential
        What was identified elsewhere; of a Calibration the whole fabric is taken, else the
        network's fabric with this law of shear.
    network : Network
        Of the specimen to predict.
    displacement, force : sequence of float
        Measured [m, N]; or a MeasuredCurve instead of the two.
    kind, upper, bending, options
        See calibrate.

    Raises
    ------
    InputError, SolverError
        On every rank: bad data, or no equilibrium at a displacement.
    """
    if isinstance(displacement, MeasuredCurve):
        curve = displacement
    elif force is None:
        raise InputError("predict needs the forces beside the displacements")
    else:
        curve = MeasuredCurve.from_points(displacement, force)
    known_to = np.inf
    if isinstance(law, Calibration):
        known_to = min(float(law.reached.max()), float(law.angles[-1]))
        network = Network(network.comm, network.preform, law.fabric)
        law = law.law
    _check_reach(network, float(np.max(curve.displacement)), kind, upper)
    specimen = LoadCurve(
        network, curve.displacement, kind=kind, upper=upper, bending=bending, options=options
    )
    try:
        loads = specimen.solve(law)
        return Prediction(curve, loads, specimen.angles(), known_to)
    except EquilibriumError as error:
        raise InputError(
            f"the specimen to be predicted has no equilibrium with the law ({error}): check its "
            "size against the displacements, or leave out the last"
        ) from error
    finally:
        specimen.destroy()
