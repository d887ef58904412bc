# SPDX-License-Identifier: MIT
"""From a case and a measured load curve to the shear law: `cruciform-petsc calibrate CASE --data`.

docs/calibration.md tells how to use it and what it assumes.
"""

from __future__ import annotations

import logging
from pathlib import Path
from typing import Any

import numpy as np
from mpi4py import MPI

from .calibration import read_curve
from .calibration.identify import calibrate
from .calibration.report import write
from .case import Case, on_root
from .errors import InputError
from .network import Network
from .units import format_si

__all__ = ["calibrate", "calibrate_case"]


def calibrate_case(
    comm: MPI.Intracomm,
    case: Case,
    data_path: str | Path,
    directory: Path,
    log: logging.Logger,
) -> dict[str, Any]:
    """Identify the shear law of a case's fabric and write the results into a folder. Collective.

    Of the case's [test] only ``kind`` (bias-extension), ``upper`` and ``bending`` count: the
    displacements are those measured, the deformation is finite.

    Parameters
    ----------
    comm : mpi4py communicator
    case : Case
    data_path : str or Path
        Of the measured curve, see calibration.read_curve; read on rank 0.
    directory : Path
        Is there; gets law.toml, calibration.csv, calibration.png and summary.json.
    log : logging.Logger

    Returns
    -------
    dict
        The summary.

    Raises
    ------
    InputError, SolverError
        On every rank.
    """
    if case.test.kind != "bias-extension":
        raise InputError(
            f'test.kind is "{case.test.kind}", a shear law is identified from kind = '
            '"bias-extension" only'
        )
    curve = on_root(comm, lambda: read_curve(data_path))
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
    found = calibrate(
        network, curve,
        upper=case.test.upper, bending=case.test.bending, options=case.solver.options,
        told=lambda text: log.info("           %s", text),
    )  # fmt: skip
    more = {
        "title": case.title,
        "data": str(data_path),
        "crossovers": statistics["crossovers"],
        "ranks": comm.size,
    }
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
    log.info("results in    %s, the law for a case file in law.toml", directory)
    return summary
