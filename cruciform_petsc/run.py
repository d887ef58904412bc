# SPDX-License-Identifier: MIT
"""From a case to its results: what `cruciform-petsc run` and `check` do, in order."""

from __future__ import annotations

import logging
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
from mpi4py import MPI

from .calibration.curve import MeasuredCurve, read_curve
from .case.schema import Case
from .compare import against_measured, check_measured, load_line
from .continuum.compare import Reference
from .equilibrium.newton import EquilibriumError
from .errors import InputError, SolverError
from .experiments.limits import warnings
from .experiments.registry import KINDS, kind_class
from .experiments.result import TestResult
from .net.network import Network
from .output import figures, paraview, tables
from .output import log as logs
from .output.checkpoint import Checkpoint, resume_command
from .output.exports import export
from .output.folder import OF_RUN, locked, remove_results
from .output.log import Stages
from .output.progress import Progress
from .output.provenance import file_notes
from .output.report import write_report
from .output.summary import summarize, summarize_nothing
from .parallel import on_root


def check_case(comm: MPI.Intracomm, case: Case, log: logging.Logger) -> None:
    """Make the network of a case and tell its sizes; solves and writes nothing. Collective."""
    _check_comparison(case)
    _read_measured(comm, case)
    log.info("%s", case.title)
    network, _ = _make_network(comm, case, Stages(log))
    if not case.test.finite:
        per_node = 3 if case.test.bending else 2
        log.info("           %d unknowns", per_node * network.num_nodes_global)
    experiment = case.experiment(network)
    for sentence in experiment.check():
        log.info("           %s", sentence)


def run_case(
    comm: MPI.Intracomm,
    case: Case,
    directory: Path,
    log: logging.Logger,
    checkpoint: Checkpoint | None = None,
) -> dict:
    """Run a case and write its results into a folder. Collective; returns the summary.

    A finite test keeps a checkpoint until all results are there. A test that ends early, or a
    membrane that cannot be solved, raises its SolverError on every rank after all that was reached
    is on disk.

    Parameters
    ----------
    comm : mpi4py communicator
    case : Case
    directory : Path
    log : logging.Logger
    checkpoint : Checkpoint, optional
        To go on from; by default the test begins at rest.
    """
    with locked(comm, directory, OF_RUN, log):
        return _run_case(comm, case, directory, log, checkpoint)


def _run_case(
    comm: MPI.Intracomm,
    case: Case,
    directory: Path,
    log: logging.Logger,
    checkpoint: Checkpoint | None,
) -> dict:
    _check_comparison(case)
    measured = _read_measured(comm, case)
    stages = Stages(log)
    log.info("%s", case.title)
    logs.tell_program(log, comm.size)
    network, statistics = _make_network(comm, case, stages)
    experiment = case.experiment(network)
    progress = Progress(experiment, directory / "increments.csv", log)
    checkpoint = _take_folder(comm, case, directory, log, checkpoint)
    if checkpoint is not None:
        progress.go_on_from(checkpoint.increments)
        command = resume_command(directory, comm.size)
        log.info("           if interrupted, continue with: %s", command)

    failure: SolverError | None = None
    size = "finite deformation" if case.test.finite else f"{experiment.model} model"
    with stages.stage("solve", f"{case.test.kind}, {size}, solved"):
        try:
            with _telling_how_to_resume(checkpoint), progress.bar():
                result = experiment.solve(progress, checkpoint)
        except EquilibriumError as error:
            failure, result = error, error.result
    if failure is not None and result is None:
        nothing = summarize_nothing(comm, case, str(failure), progress.increments)
        _write_summary(comm, directory, nothing, stages)
        raise failure
    logs.tell_solver(log, result)
    hanging = comm.allreduce(result.supports.num_hanging)
    if hanging:
        log.info("           %d crossovers hang on by one arm end and carry no load", hanging)

    summary = summarize(case, result, statistics, hanging)
    if checkpoint is not None and checkpoint.increments:
        summary["resumed_after_increments"] = len(checkpoint.increments)
    summary["warnings"] = warnings(result)
    for sentence in summary["warnings"]:
        log.warning("warning       %s", sentence)
    if failure is not None:
        summary["ended_early"] = str(failure)
    with stages.stage("write", "results written"), _telling_how_to_resume(checkpoint):
        _write_files(case, result, directory)
        if measured is not None:
            summary["measured"] = _compare_with_measured(case, result, measured, directory)
    without = _solve_without_bending(case, stages, result, summary)

    membranes: list = []
    if failure is None and (case.continuum.compare or case.continuum.ladder):
        try:
            reference = _solve_reference(case, stages, result, without, summary, directory)
            membranes = reference.membranes
            _climb_ladder(case, stages, reference, summary, directory)
        except SolverError as error:
            failure = error
            summary.setdefault("continuum", {})["failed"] = str(error)

    drawn: list[str] = []
    if case.output.pictures:
        with stages.stage("pictures", "pictures drawn"):
            drawn = figures.draw_all(directory, result, without, membranes, summary, measured)
    if case.output.scene:
        with stages.stage("scene", "yarns drawn in space"):
            try:
                figures.scene(result, directory / "scene.png", case.title)
                drawn.append("scene.png")
            except InputError as error:  # the results are worth more than this picture of them
                log.warning("no scene.png: %s", error)
    _write_summary(comm, directory, summary, stages)
    if case.output.wants_report:
        write_report(directory, case, result, summary, drawn)
    logs.tell_outcome(log, summary, result, directory)
    if failure is not None:
        raise failure
    if checkpoint is not None:
        checkpoint.remove()
    return summary


def _make_network(
    comm: MPI.Intracomm, case: Case, stages: Stages
) -> tuple[Network, Mapping[str, Any]]:
    """The network of a case and its sizes, told on the log. Collective."""
    fabric, preform = case.fabric(), case.preform()
    stages.log.info("           %r", fabric)
    stages.log.info("           %r", preform)
    with stages.stage("network", "network"):
        network = Network(comm, preform, fabric)
        statistics = network.statistics()
    logs.tell_network(stages.log, statistics)
    return network, statistics


def _take_folder(
    comm: MPI.Intracomm,
    case: Case,
    directory: Path,
    log: logging.Logger,
    checkpoint: Checkpoint | None,
) -> Checkpoint | None:
    """Make the folder this run's alone; returns the checkpoint of a finite test. Collective."""
    resumed = checkpoint is not None
    if case.test.finite:
        checkpoint = checkpoint or Checkpoint.begin(comm, directory, case)
        for note in checkpoint.notes:
            log.warning("warning       %s", note)
    if not resumed:
        replaced = remove_results(comm, directory)
        if replaced:
            log.info("           replaces the results of %s", replaced)
    return checkpoint


@contextmanager
def _telling_how_to_resume(checkpoint: Checkpoint | None) -> Iterator[None]:
    """Add it to a problem with files, a full disk mostly. Collective if there is one."""
    try:
        yield
    except InputError as error:
        if checkpoint is None or "cruciform-petsc resume" in str(error):
            raise
        told = checkpoint.hint()
        raise InputError(f"{error}{'; ' if told else ''}{told}") from None


def _solve_without_bending(
    case: Case, stages: Stages, result: TestResult, summary: dict[str, Any]
) -> TestResult | None:
    """The last state of a small test without yarn bending, where that is compared. Collective."""
    wanted = case.output.pictures or case.continuum.compare
    comparable = result.experiment.has_zones and result.experiment.model == "coupled"
    moved = result.extension != 0.0  # a list may end at rest
    if case.test.finite or not (moved and case.test.bending and comparable and wanted):
        return None
    with stages.stage("solve_without_bending", "the same without yarn bending, to compare"):
        extension = float(result.extension)
        experiment = case.experiment(result.network, bending=False, controls=extension)
        without = experiment.solve()
    summary["without_bending"] = {
        "load_n": without.load,
        "shear_centre_deg": float(np.rad2deg(without.shear_angle_centre)),
        "shear_max_deg": float(np.rad2deg(without.shear_angle_max)),
    }
    return without


def _check_comparison(case: Case) -> None:
    """Refuse what no membrane is there to compare with."""
    asked = [key for key in ("compare", "ladder") if getattr(case.continuum, key)]
    if not asked:
        return
    kind = case.test.kind
    compared = [name for name in KINDS if kind_class(name).reference]
    if kind not in compared:
        raise InputError(
            f'continuum.{asked[0]}: there is no membrane to compare test.kind = "{kind}" with '
            f"(there is for {', '.join(compared)}), leave it out"
        )
    if getattr(case.test, "ends", "grip") == "free":
        raise InputError(
            f'continuum.{asked[0]} needs gripped ends, leave it out or set test.ends = "grip"'
        )


def _read_measured(comm: MPI.Intracomm, case: Case) -> MeasuredCurve | None:
    """Read what was measured, before hours of work. Collective."""
    path = case.output.measured
    if path is None:
        return None
    check_measured(case.test.kind)
    return on_root(comm, lambda: read_curve(path))


def _compare_with_measured(
    case: Case, result: TestResult, measured: MeasuredCurve, directory: Path
) -> dict[str, Any]:
    """Compare the load and write load_and_measured.csv; returns the summary's part. Collective."""
    told = {"file": case.output.measured, **against_measured(load_line(result), measured)}
    tables.write_csv(
        result.network.comm,
        directory / "load_and_measured.csv",
        {
            "displacement_mm": told["displacement_mm"],
            "measured_N": told["measured_n"],
            "load_N": told["load_n"],
        },
    )
    return told


def _write_files(case: Case, result: TestResult, directory: Path) -> None:
    """Tables and files for other programs. Collective."""
    comm = result.network.comm
    tables.write_csv(comm, directory / "curve.csv", result.curve())
    if result.experiment.has_zones:
        line = result.centre_line()
        columns = {
            "distance_mm": 1e3 * line.distance,
            "shear_angle_deg": np.rad2deg(line.shear_angle),
        }
        tables.write_csv(comm, directory / "centre_line.csv", columns)
    if case.output.paraview:
        notes = file_notes(result, case.model_dump())
        paraview.write_state(directory / "network.vtkhdf", result, notes)
        if len(result.states) > 1:
            paraview.write_series(directory / "series.vtkhdf", result, notes)
    if case.output.exports:
        export(result, directory)


def _write_summary(
    comm: MPI.Intracomm, directory: Path, summary: dict[str, Any], stages: Stages
) -> None:
    """Add times and memory, and write summary.json. Collective."""
    summary["wall_s"] = stages.wall_times()
    summary["peak_mib_per_rank"] = logs.peak_mib(comm)
    tables.write_json(comm, directory / "summary.json", summary)


def _solve_reference(case: Case, stages: Stages, result, without, summary, directory) -> Reference:
    """Solve the membranes beside a test and compare. Collective."""
    which = "dolfinx membrane"
    if case.test.finite:
        order = "second-gradient" if case.second_gradient else "hyperelastic"
        which = f"{order} membrane in dolfinx"
    with stages.stage("continuum", f"{which} solved and compared"):
        reference = Reference.solve(result, case.continuum.mesh_size_si, case.second_gradient)
        summary["continuum"] = reference.summary(without)
        table = reference.table()
        if table:
            tables.write_csv(result.network.comm, directory / "continuum.csv", table)
    return reference


def _climb_ladder(case: Case, stages: Stages, reference: Reference, summary, directory) -> None:
    """Compare networks of the same fabric, finer and finer, with one membrane. Collective.

    With yarn bending only where the membrane has it, so that the difference can vanish.
    """
    result = reference.result
    comm = result.network.comm
    controls: Any = result.controls.tolist() if case.test.finite else float(result.extension)
    rungs = []
    for refine in case.continuum.ladder or ():
        with stages.stage("ladder", f"refine = {refine} compared with the membrane"):
            network = Network(comm, case.preform(refine=refine), case.fabric())
            finer = case.experiment(network, bending=case.second_gradient, controls=controls)
            rungs.append({"refine": refine} | reference.rung(finer))
    if rungs:
        summary["continuum"]["ladder"] = rungs
        columns = {key: [rung[key] for rung in rungs] for key in rungs[0]}
        tables.write_csv(comm, directory / "ladder.csv", columns)
