# SPDX-License-Identifier: MIT
"""From a case and a measured load curve to the shear law: `cruciform-petsc calibrate CASE --data`.

docs/calibration.md tells how to use it and what it assumes.
"""

from __future__ import annotations

import logging
from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from mpi4py import MPI

from .calibration import MeasuredCurve, read_curve
from .calibration import Calibration, Prediction, Specimen, calibrate, calibrate_together, predict
from .calibration.load_curve import KINDS
from .case.schema import Case
from .errors import InputError
from .net.network import Network
from .output.calibration import hold_out_summary, write, write_hold_out
from .parallel import on_root
from .units import format_si

__all__ = ["calibrate", "calibrate_case", "predict"]


def calibrate_case(
    comm: MPI.Intracomm,
    case: Case,
    data_path: str | Path,
    directory: Path,
    log: logging.Logger,
    hold_out: tuple[Case, str | Path] | None = None,
    also: Sequence[tuple[Case, str | Path]] = (),
    weights: Sequence[float] | None = None,
) -> dict[str, Any]:
    """Identify the shear law of a case's fabric and write the results into a folder. Collective.

    Of the case's [test] only ``kind`` (bias-extension or picture-frame), ``upper`` and ``bending``
    count: the displacements are those measured, the deformation is finite.

    Parameters
    ----------
    comm : mpi4py communicator
    case : Case
    data_path : str or Path
        Of the measured curve, see calibration.read_curve; read on rank 0.
    directory : Path
        Is there; gets law.toml, calibration.csv, calibration.png and calibration.json.
    log : logging.Logger
    hold_out : (Case, path), optional
        Another specimen of the same cloth and its measured curve, to be predicted with the law
        found: of this case the preform and ``upper`` and ``bending`` of [test] count, and
        hold_out.csv is written.
    also : sequence of (Case, path)
        Further specimens of the cloth and their curves that the law is to follow, too.
    weights : sequence of float, optional
        Of the curves, the first one's first; default: all alike.

    Returns
    -------
    dict
        The summary.

    Raises
    ------
    InputError, SolverError
        On every rank.
    """
    _options_of(case, "the case")
    if hold_out is not None:
        _options_of(hold_out[0], "the hold-out case")
    for other, _ in also:
        _options_of(other, "the case beside it")
    weights = [1.0] * (1 + len(also)) if weights is None else weights
    if len(weights) != 1 + len(also):
        raise InputError(f"there are {len(weights)} weights for {1 + len(also)} curves")
    curve = on_root(comm, lambda: read_curve(data_path))
    if hold_out is not None:  # what is wrong with the second curve is told before the work begins
        other_curve = on_root(comm, lambda: read_curve(hold_out[1]))
    also_curves = [on_root(comm, partial(read_curve, path)) for _, path in also]
    fabric, preform = case.fabric(), case.preform()
    log.info("%s", case.title)
    log.info("           %r", fabric)
    log.info("           %r", preform)
    network = Network(comm, preform, fabric)
    d, f = curve.displacement, curve.force
    statistics = network.statistics()
    log.info("           %d crossovers", statistics["crossovers"])
    log.info(
        "           %d measured rows, %d points from %s to %s, %s to %s",
        curve.rows, len(d), format_si(d[0], "m"), format_si(d[-1], "m"),
        format_si(f.min(), "N"), format_si(f.max(), "N"),
    )  # fmt: skip
    specimens = [_specimen(network, curve, case, weights[0])]
    for (other, path), measured, weight in zip(also, also_curves, weights[1:], strict=True):
        log.info(
            '           beside it %s, %d points of "%s"', other.title, len(measured.force), path
        )
        specimen = Network(comm, other.preform(), fabric)
        specimens.append(_specimen(specimen, measured, other, weight))
    found = calibrate_together(
        specimens, options=case.solver.options, told=lambda text: log.info("           %s", text)
    )
    more = {
        "title": case.title,
        "data": str(data_path),
        **({"data_beside": [str(path) for _, path in also]} if also else {}),
        "crossovers": statistics["crossovers"],
        "ranks": comm.size,
    }
    prediction = None
    if hold_out is not None:
        prediction = _predict(comm, found, hold_out[0], other_curve)
        write_hold_out(comm, directory, prediction)
        more["hold_out"] = {
            "title": hold_out[0].title, "data": str(hold_out[1]), **hold_out_summary(prediction)
        }  # fmt: skip
    summary = write(comm, directory, found, more, case.output.pictures)
    log.info("")
    log.info(
        "fit           RMS of the relative error %.2f %% (start %.2f %%), at most %.2f %%",
        *(100.0 * v for v in (found.rms, found.start_rms, np.abs(found.residuals).max())),
    )
    log.info(
        "              %d steps, %d load curves, %d Newton steps, %.1f s: %s",
        found.iterations, found.evaluations, found.newton_steps, found.seconds, found.message,
    )  # fmt: skip
    for s, part in zip(found.specimens, found.parts, strict=True) if also else ():
        log.info(
            "              %s, weight %g: RMS %.2f %%",
            s.kind, s.weight, 100.0 * np.sqrt(np.mean(found.residuals[part] ** 2)),
        )  # fmt: skip
    log.info("law           angle      psi'           standard error")
    for angle, value, error, known, depends in zip(
        found.angles, found.values, found.standard_errors, found.determined, found.dependent,
        strict=True,
    ):  # fmt: skip
        log.info(
            "              %5.1f deg  %.4g N/mm  %5.1f %%%s",
            np.rad2deg(angle), 1e-3 * value, 100.0 * error / value,
            "  not determined" if not known else "  depends on what was assumed" if depends else "",
        )  # fmt: skip
    for remark in found.remarks():
        log.info("              %s", remark)
    if prediction is not None:
        _log_prediction(log, prediction)
    log.info("results in    %s, the law for a case file in law.toml", directory)
    return summary


def _options_of(case: Case, name: str) -> dict[str, Any]:
    """Keyword arguments of calibrate and predict that a case's [test] tells."""
    test = case.test
    if test.kind not in KINDS:
        raise InputError(
            f'test.kind of {name} is "{test.kind}", a shear law is identified from and compared '
            f'with kind = "{KINDS[0]}" or "{KINDS[1]}" only'
        )
    upper = getattr(test, "upper", "grip")
    return {
        "kind": test.kind, "upper": upper, "bending": test.bending, "options": case.solver.options
    }  # fmt: skip


def _specimen(network: Network, curve: MeasuredCurve, case: Case, weight: float) -> Specimen:
    """Put together what a case and its curve say."""
    told = _options_of(case, "the case")
    return Specimen(network, curve, told["kind"], told["upper"], told["bending"], weight)


def _predict(
    comm: MPI.Intracomm, found: Calibration, case: Case, curve: MeasuredCurve
) -> Prediction:
    """Predict the hold-out specimen, made of the cloth that was identified. Collective."""
    network = Network(comm, case.preform(), found.fabric)
    return predict(found, network, curve, **_options_of(case, "the hold-out case"))


def _log_prediction(log: logging.Logger, prediction: Prediction) -> None:
    """Tell how well the hold-out specimen was predicted."""
    log.info(
        "hold-out      RMS of the relative error %.2f %%, at most %.2f %%, mean %+.2f %%",
        100.0 * prediction.rms, 100.0 * np.abs(prediction.residuals).max(),
        100.0 * prediction.residuals.mean(),
    )  # fmt: skip
    beyond = int(prediction.extrapolated.sum())
    if beyond:
        within = "" if np.isnan(prediction.rms_known) else (
            f"; RMS of the others {100.0 * prediction.rms_known:.2f} %"
        )  # fmt: skip
        log.info(
            "              at %d of %d points some cloth shears past the %.1f deg that the law is "
            "known to%s",
            beyond, len(prediction.loads), np.rad2deg(prediction.known_to), within,
        )  # fmt: skip
