# SPDX-License-Identifier: MIT
"""From a case and measured data to a law: `cruciform-petsc calibrate CASE --data FILE`.

The shear law from load curves, or the crimp model from biaxial tensions (kind = "biaxial").

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

from .calibration import (
    Calibration,
    Prediction,
    Specimen,
    calibrate_together,
    predict,
    read_curve,
)
from .calibration.crimp import fit_crimp
from .calibration.curve import columns_of_files
from .calibration.result import rms
from .calibration.specimen import KINDS
from .case.schema import Case
from .cloth.biaxial import points_of_file
from .errors import InputError
from .net.network import Network
from .output.calibration import hold_out_summary, write, write_so_far
from .output.crimp_fit import write_crimp
from .parallel import on_root
from .units import format_si


def calibrate_case(
    comm: MPI.Intracomm,
    case: Case,
    data_path: str | Path,
    directory: Path,
    log: logging.Logger,
    hold_out: tuple[Case, str | Path] | None = None,
    also: Sequence[tuple[Case, str | Path]] = (),
    weights: Sequence[float] | None = None,
    columns: Sequence[str] = (),
) -> dict[str, Any]:
    """Identify the shear law of a case's fabric and write the results into a folder. Collective.

    Of a case's [test] only ``kind`` (bias-extension or picture-frame), ``upper`` and ``bending``
    count: the displacements are those measured, the deformation is finite. Curves are read on rank
    0, see calibration.read_curve.

    Parameters
    ----------
    comm : mpi4py communicator
    case : Case
    data_path : str or Path
        Of the measured curve.
    directory : Path
        Is there; gets law.toml, calibration.csv, calibration.png and calibration.json.
    log : logging.Logger
    hold_out : (Case, path), optional
        Another specimen of the same cloth and its measured curve, to be predicted with the law
        found; hold_out.csv is written.
    also : sequence of (Case, path)
        Further specimens of the cloth and their curves that the law is to follow, too.
    weights : sequence of float, optional
        Of the curves, the first one's first; default: all alike.
    columns : sequence of str
        Of displacement and force, see calibration.read_curve: one for all files, or one for each,
        that of the hold-out last.

    Returns the summary; raises InputError or SolverError on every rank.
    """
    if case.test.kind == "biaxial":
        if hold_out is not None or also or weights is not None or columns:
            raise InputError(
                "a crimp model is found from one file of biaxial data, whose titles name its "
                "columns: leave out --also, --hold-out, --weights and --columns"
            )
        return calibrate_crimp(comm, case, data_path, directory, log)
    fitted = [(case, data_path), *also]
    tests = [_test(case, "the case"), *(_test(each, "the case beside it") for each, _ in also)]
    weights = [1.0] * len(fitted) if weights is None else weights
    if len(weights) != len(fitted):
        raise InputError(f"there are {len(weights)} weights for {len(fitted)} curves")
    # What is wrong with any of the curves is told before the work begins.
    paths = [path for _, path in (*fitted, *([hold_out] if hold_out else []))]
    named = columns_of_files(columns, len(paths))
    curves = [
        on_root(comm, partial(read_curve, path, which))
        for path, which in zip(paths, named, strict=True)
    ]
    if hold_out is not None:
        held_out_test = _test(hold_out[0], "the hold-out case")
        held_out = curves.pop()
    fabric = case.fabric()
    log.info("%s", case.title)
    log.info("           %r", fabric)
    for sentence in case.fabric_table.filled_in():
        log.info("           %s", sentence)
    log.info("           %r", case.preform())
    specimens = [
        Specimen(Network(comm, each.preform(), fabric), curve, weight=weight, **test).checked()
        for (each, _), curve, weight, test in zip(fitted, curves, weights, tests, strict=True)
    ]
    crossovers = specimens[0].network.statistics()["crossovers"]
    curves = [specimen.curve for specimen in specimens]
    d, f = curves[0].displacement, curves[0].force
    log.info("           %d crossovers", crossovers)
    log.info(
        "           %d measured rows, %d points from %s to %s, %s to %s",
        *(curves[0].rows, len(d), format_si(d[0], "m"), format_si(d[-1], "m")),
        *(format_si(f.min(), "N"), format_si(f.max(), "N")),
    )
    for specimen in specimens:
        if question := specimen.unit_question():
            log.warning("warning       %s", question)
    for (other, path), curve in zip(also, curves[1:], strict=True):
        points = len(curve.force)
        log.info('           beside it %s, %d points of "%s"', other.title, points, path)
    found = calibrate_together(
        specimens,
        options=case.solver.options,
        told=lambda text: log.info("           %s", text),
        stepped=partial(write_so_far, comm, directory),
    )
    more: dict[str, Any] = {"title": case.title, "data": str(data_path)}
    if also:
        more["data_beside"] = [str(path) for _, path in also]
    more |= {"crossovers": crossovers, "ranks": comm.size}
    prediction = None
    if hold_out is not None:
        other, path = hold_out
        network = Network(comm, other.preform(), found.fabric)
        options = other.solver.options
        prediction = predict(found, network, held_out, options=options, **held_out_test)
        more["hold_out"] = {"title": other.title, "data": str(path)} | hold_out_summary(prediction)
    summary = write(comm, directory, found, more, prediction, case.output.pictures)
    _log_law(log, found)
    if prediction is not None:
        _log_prediction(log, prediction)
    log.info("may be used   %s", summary["verdict"])
    log.info("results in    %s, the law for a case file in law.toml", directory)
    return summary


def calibrate_crimp(
    comm: MPI.Intracomm, case: Case, data_path: str | Path, directory: Path, log: logging.Logger
) -> dict[str, Any]:
    """Identify the crimp model of a case's fabric from biaxial data. Collective.

    Of the case count the fabric's yarns per length and its tension.crimp, from which the search
    starts and whose heights and yarn bending stay; the file is as for tension.surface. Writes and
    returns the same files and summary as calibrate_case, with no hold-out.
    """
    tension = case.fabric_table.tension
    if tension is None or tension.crimp is None:
        raise InputError(
            'with test.kind = "biaxial" calibrate finds a crimp model: fabric.tension.crimp is '
            "missing, which has the crimp heights and where to start from (measured tensions "
            "themselves are a law by fabric.tension.surface, without calibration)"
        )
    fabric = case.fabric()
    yarns = fabric.warp.yarns, fabric.weft.yarns
    start = tension.crimp.crimp(*yarns)
    found = on_root(comm, lambda: fit_crimp(points_of_file(data_path, *yarns), start))
    log.info("%s", case.title)
    log.info("           %r", fabric)
    told = 100.0 * found.misfit, 100.0 * found.start_misfit, len(found.points)
    log.info("fit           RMS of the relative error %.2f %% (start %.2f %%), %d points", *told)
    for name, error in found.errors.items():
        remark = "  not settled by the points" if name in found.unknown else ""
        log.info("              %-15s standard error %5.1f %%%s", name, 100.0 * error, remark)
    more = {"title": case.title, "data": str(data_path), "ranks": comm.size}
    summary = write_crimp(comm, directory, found, more, case.output.pictures)
    log.info("results in    %s, the law for a case file in law.toml", directory)
    return summary


def _test(case: Case, name: str) -> dict[str, Any]:
    """What a case's [test] says of a Specimen."""
    test = case.test
    if test.kind not in KINDS:
        raise InputError(
            f'test.kind of {name} is "{test.kind}", a shear law is identified from and compared '
            f'with kind = "{KINDS[0]}" or "{KINDS[1]}" only'
        )
    for key in ("slip", "pretension"):
        if getattr(test, key, None) is not None:
            raise InputError(
                f"test.{key} of {name} is nothing that a shear law is found with, leave it out"
            )
    if test.model == "truss":
        raise InputError(
            f'test.model of {name} is "truss", a shear law is found for cruciforms, leave it out'
        )
    if case.fabric().shear_viscosity is not None:
        raise InputError(
            f"fabric.shear_viscosity of {name} is nothing that a shear law is found with: leave it "
            "out, and take a curve of a slow test"
        )
    upper = getattr(test, "upper", "grip")
    return {"kind": test.kind, "upper": upper, "bending": test.bending}


def _log_law(log: logging.Logger, found: Calibration) -> None:
    """Tell how well the curves are followed, and the law."""
    log.info("")
    log.info(
        "fit           RMS of the relative error %.2f %% (start %.2f %%), at most %.2f %%",
        *(100.0 * v for v in (found.rms, found.start_rms, np.abs(found.residuals).max())),
    )
    log.info(
        "              %d steps, %d load curves, %d Newton steps, %.1f s: %s",
        *(found.iterations, found.evaluations, found.newton_steps, found.seconds, found.message),
    )
    if len(found.specimens) > 1:
        for s, part in zip(found.specimens, found.parts, strict=True):
            error = 100.0 * rms(found.residuals[part])
            log.info("              %s, weight %g: RMS %.2f %%", s.kind, s.weight, error)
    log.info("law           angle      psi'           standard error")
    for k, angle in enumerate(np.rad2deg(found.angles)):
        remark = "  depends on what was assumed" if found.dependent[k] else ""
        if not found.determined[k]:
            remark = "  not determined"
        value, error = 1e-3 * found.values[k], 100.0 * found.estimate.errors[k]
        log.info("              %5.1f deg  %.4g N/mm  %5.1f %%%s", angle, value, error, remark)
    for remark in found.remarks():
        log.info("              %s", remark)


def _log_prediction(log: logging.Logger, prediction: Prediction) -> None:
    """Tell how well the hold-out specimen was predicted."""
    errors = 100.0 * prediction.residuals
    log.info(
        "hold-out      RMS of the relative error %.2f %%, at most %.2f %%, mean %+.2f %%",
        *(100.0 * prediction.rms, np.abs(errors).max(), errors.mean()),
    )
    beyond = int(prediction.extrapolated.sum())
    if beyond:
        rest = f"; RMS of the others {100.0 * prediction.rms_known:.2f} %"
        log.info(
            "              at %d of %d points some cloth shears past the %.1f deg that the law is "
            "known to%s",
            *(beyond, len(errors), np.rad2deg(prediction.known_to)),
            rest if beyond < len(errors) else "",
        )
    for remark in prediction.remarks():
        log.info("              %s", remark)
