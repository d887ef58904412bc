# SPDX-License-Identifier: MIT
"""From a case to its results: what `cruciform-petsc run` and `check` do, in order."""

from __future__ import annotations

import logging
import os
import platform
import resource
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
from mpi4py import MPI

from . import __version__
from .calibration.curve import MeasuredCurve, read_curve
from .case.schema import Case
from .compare import against_measured, check_measured, load_line
from .elements.kinematics import net_reach
from .equilibrium.newton import EquilibriumError, Increment
from .errors import InputError, SolverError
from .experiments.experiment import Experiment
from .experiments.result import TestResult
from .net.network import Network
from .output import figures, paraview, tables
from .output.checkpoint import Checkpoint, resume_command
from .output.figures import ROUNDING_N, control_text
from .output.folder import locked, remove_results
from .output.progress import Route, progress_bar
from .output.provenance import file_notes, provenance, versions
from .output.report import force_text, tension_text, write_report
from .parallel import on_root
from .small.network import MODES
from .units import format_si

SMALL_DEG = 10.0  # shear angle to which small displacements hold, as a rule
BREAKING = 0.1  # strain; glass and carbon break at a few hundredths
# Kinds whose edges do what the membrane's can be told to, and whose load it knows.
COMPARED = ("bias-extension", "off-axis-tension", "pantograph")


class Stages:
    """Named stages of a run with their wall times, told on the log as they end."""

    def __init__(self, comm: MPI.Intracomm, log: logging.Logger):
        self.comm, self.log = comm, log
        self.seconds: dict[str, float] = {}
        self._begin = time.perf_counter()

    @contextmanager
    def stage(self, name: str, what: str) -> Iterator[None]:
        """Time what is done inside."""
        begin = time.perf_counter()
        yield
        self.seconds[name] = self.seconds.get(name, 0.0) + time.perf_counter() - begin
        self.log.info("%8.2f s  %s", self.seconds[name], what)

    def total(self) -> float:
        """Seconds since the beginning."""
        return time.perf_counter() - self._begin


def peak_mib(comm: MPI.Intracomm) -> list[float]:
    """Largest resident memory of each rank so far, MiB. Collective."""
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return comm.allgather(round(peak / (2**20 if platform.system() == "Darwin" else 1024), 1))


def log_compilation(log: logging.Logger) -> None:
    """Tell that kernels will be compiled, where there is no cache of compiled ones beside them."""
    here = Path(__file__).parent
    if os.access(here, os.W_OK) and not any(here.glob("solvers/__pycache__/pattern.*.nbi")):
        log.info("           first run here: kernels are compiled, once, which takes some 10 s")


def log_network(log: logging.Logger, statistics: dict) -> None:
    """Tell the sizes of a network."""
    log.info(
        "           %d crossovers, %d arm ends, %d warp and %d weft yarns",
        *(statistics[key] for key in ("crossovers", "nodes", "warp_yarns", "weft_yarns")),
    )
    if statistics["crossovers_per_rank_min"] == statistics["crossovers"]:  # one rank
        return
    log.info(
        "           ranks hold %d to %d crossovers (imbalance %.3f), %d yarns cut between ranks",
        statistics["crossovers_per_rank_min"],
        statistics["crossovers_per_rank_max"],
        statistics["imbalance"],
        statistics["cut_yarns"],
    )


def check_case(comm: MPI.Intracomm, case: Case, log: logging.Logger) -> None:
    """Make the network of a case and tell its sizes; solves and writes nothing. Collective."""
    _check_comparison(case)
    _read_measured(comm, case)
    stages = Stages(comm, log)
    fabric, preform = case.fabric(), case.preform()
    log.info("%s", case.title)
    log.info("           %r", fabric)
    log.info("           %r", preform)
    with stages.stage("network", "network"):
        network = Network(comm, preform, fabric)
    log_network(log, network.statistics())
    if not case.test.finite:
        per_node = 3 if case.test.bending else 2
        log.info("           %d unknowns", per_node * network.num_nodes_global)
    experiment = case.experiment(network)
    for value in experiment.check():
        log.info("           %s", value)


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
    if case.test.finite:
        return _run_case(comm, case, directory, log, checkpoint)  # checkpoints lock the folder
    with locked(comm, directory):
        return _run_case(comm, case, directory, log, None)


def _run_case(
    comm: MPI.Intracomm,
    case: Case,
    directory: Path,
    log: logging.Logger,
    checkpoint: Checkpoint | None,
) -> dict:
    _check_comparison(case)
    measured = _read_measured(comm, case)
    stages = Stages(comm, log)
    log.info("%s", case.title)
    log_compilation(log)
    log.info(
        "           cruciform_petsc %s, PETSc %s, %d rank%s",
        __version__,
        versions()["petsc"],
        comm.size,
        "s" if comm.size > 1 else "",
    )
    fabric, preform = case.fabric(), case.preform()
    log.info("           %r", fabric)
    log.info("           %r", preform)
    with stages.stage("network", "network"):
        network = Network(comm, preform, fabric)
        statistics = network.statistics()
    log_network(log, statistics)

    experiment = case.experiment(network)
    resumed = checkpoint is not None
    failure: SolverError | None = None
    progress = Progress(experiment, directory / "increments.csv", log)
    if case.test.finite:
        checkpoint = checkpoint or Checkpoint.begin(comm, directory, case)
        for note in checkpoint.notes:
            log.warning("warning       %s", note)
    if not resumed:  # the folder is this run's alone by now
        replaced = remove_results(comm, directory)
        if replaced:
            log.info("           replaces the results of %s", replaced)
    if checkpoint is not None:
        progress.go_on_from(checkpoint.increments)
        log.info(
            "           if interrupted, continue with: %s", resume_command(directory, comm.size)
        )
    size = "finite deformation" if case.test.finite else f"{experiment.model} model"
    with stages.stage("solve", f"{case.test.kind}, {size}, solved"):
        try:
            with _telling_how_to_resume(checkpoint), progress.bar():
                result = experiment.solve(progress, checkpoint)
        except EquilibriumError as error:
            failure, result = error, error.result
    if result is None:
        _write_nothing_but_increments(comm, case, directory, stages, progress, failure)
        assert failure is not None
        raise failure
    _log_solver(log, result)
    hanging = comm.allreduce(result.supports.num_hanging)
    if hanging:
        log.info("           %d crossovers hang on by one arm end and carry no load", hanging)

    summary = _summary(case, result, statistics, hanging)
    if checkpoint is not None and checkpoint.increments:
        summary["resumed_after_increments"] = len(checkpoint.increments)
    summary["warnings"] = warnings(result)
    for sentence in summary["warnings"]:
        log.warning("warning       %s", sentence)
    if failure is not None:
        summary["ended_early"] = str(failure)
    with stages.stage("write", "results written"), _telling_how_to_resume(checkpoint):
        _write(case, result, directory)
        if measured is not None:
            summary["measured"] = _compare_with_measured(case, result, measured, directory)

    without = None
    wanted = case.output.pictures or case.continuum.compare
    comparable = experiment.has_zones and experiment.model == "coupled"
    moved = result.extension != 0.0  # a list may end at rest
    if moved and case.test.bending and comparable and wanted and not case.test.finite:
        with stages.stage("solve_without_bending", "the same without yarn bending, to compare"):
            without = case.experiment(
                network, bending=False, controls=float(result.extension)
            ).solve()
        summary["without_bending"] = {
            "load_n": without.load,
            "shear_centre_deg": float(np.rad2deg(without.shear_angle_centre)),
            "shear_max_deg": float(np.rad2deg(without.shear_angle_max)),
        }

    membranes: list = []
    if failure is None and (case.continuum.compare or case.continuum.ladder):
        try:
            membranes = _compare(case, stages, result, without, summary, directory)
            if case.continuum.ladder:
                rungs = _ladder(comm, case, stages, result, membranes[-1])
                summary["continuum"]["ladder"] = rungs
                tables.write_csv(
                    comm,
                    directory / "ladder.csv",
                    {key: [rung[key] for rung in rungs] for key in rungs[0]},
                )
        except SolverError as error:
            failure = error
            summary.setdefault("continuum", {})["failed"] = str(error)

    drawn: list[str] = []
    if case.output.pictures:
        with stages.stage("pictures", "pictures drawn"):
            drawn = figures.draw_all(directory, result, without, membranes, summary, measured)
    if case.output.scene:
        with stages.stage("scene", "yarns drawn in space"):
            title = figures.plain_text(case.title)
            try:
                figures.draw_scene(directory / "scene.png", result, title)
                drawn.append("scene.png")
            except InputError as error:  # the results are worth more than this picture of them
                log.warning("no scene.png: %s", error)
    summary["wall_s"] = {**stages.seconds, "total": stages.total()}
    summary["peak_mib_per_rank"] = peak_mib(comm)
    tables.write_json(comm, directory / "summary.json", summary)
    if case.output.wants_report:
        write_report(comm, directory, case, summary, result.curve(), drawn)
    _tell(log, summary, result, directory)
    if failure is not None:
        raise failure
    if checkpoint is not None:
        checkpoint.remove()
    return summary


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


class Progress:
    """Tells the log about each accepted increment and keeps a table of all of them on disk."""

    def __init__(self, experiment: Experiment, path: Path, log: logging.Logger):
        self.experiment, self.path, self.log = experiment, path, log
        self.increments: list[Increment] = []
        self._route = Route(experiment.values)
        self._tell_bar: Callable[[float, str], None] | None = None

    @contextmanager
    def bar(self) -> Iterator[None]:
        """Show a bar while a finite test is solved, if there is a terminal to show it on."""
        if not self.experiment.finite:
            yield
            return
        with progress_bar(self.log, self._route.length, self._done()) as self._tell_bar:
            yield
        self._tell_bar = None

    def _done(self) -> float:
        """How much of the way through the values asked for lies behind."""
        if not self.increments:
            return 0.0
        last = self.increments[-1]
        at = last.load if self.experiment.by_load else last.control
        return self._route.done(sum(step.asked for step in self.increments), at)

    def _text(self) -> str:
        """What stands before the bar."""
        last = self.increments[-1]
        if self.experiment.by_load:
            now = format_si(float(f"{last.load:.4g}"), "N")
        else:
            now = " ".join(control_text(self.experiment, last.control).split()[-2:])
        return (
            f"increment {len(self.increments)}, {now}, {np.rad2deg(last.shear_max):.1f} deg of "
            f"shear, {last.iterations} Newton step{'s' if last.iterations != 1 else ''}"
        )

    def go_on_from(self, increments: list[Increment]) -> None:
        """Take note of the increments of a former run. Collective."""
        self.increments = list(increments)
        if increments:
            self._write()
            at = control_text(self.experiment, increments[-1].control)
            self.log.info("           going on from %s, %d increments", at, len(increments))

    def __call__(self, increment: Increment) -> None:
        """Take note of an increment. Collective."""
        self.increments.append(increment)
        if self._tell_bar is not None:
            self._tell_bar(self._done(), self._text())
        mended = f", {increment.shifted} of them mended" if increment.shifted else ""
        self.log.info(
            "%8.2f s    %-22s%s shear %4.1f deg, %2d Newton iterations%s",
            increment.seconds,
            control_text(self.experiment, increment.control),
            "" if self.experiment.control == "load" else f" load {increment.load:<8.5g} N,",
            np.rad2deg(increment.shear_max),
            increment.iterations,
            mended,
        )
        self._write()

    def _write(self) -> None:
        tables.write_csv(
            self.experiment.network.comm,
            self.path,
            increments_table(self.experiment, self.increments),
        )


def increments_table(
    experiment: Experiment, increments: list[Increment]
) -> dict[str, np.ndarray | list]:
    """Columns of all accepted increments, with units in their names; (n,) each."""
    name, size = experiment.column
    columns: dict[str, np.ndarray | list] = {
        name: np.array([increment.control for increment in increments]) / size
    }
    columns["load_N"] = [increment.load for increment in increments]
    columns["shear_max_deg"] = np.rad2deg([increment.shear_max for increment in increments])
    for i, mode in enumerate(MODES):
        columns[f"energy_{mode}_J"] = [increment.energies[i] for increment in increments]
    columns |= {
        "newton_iterations": [increment.iterations for increment in increments],
        "residual_N": [increment.residual for increment in increments],
        "tolerance_N": [increment.tolerance for increment in increments],
        "asked": [int(increment.asked) for increment in increments],
        "seconds": [increment.seconds for increment in increments],
    }
    return columns


def warnings(result: TestResult) -> list[str]:
    """What a user should know before trusting a result; sentences. Collective."""
    experiment, fabric = result.experiment, result.network.fabric
    comm = result.network.comm
    told = []
    largest, last = float(result.shear_angles_max.max()), fabric.shear.last_point
    if not experiment.finite:
        if np.rad2deg(largest) > SMALL_DEG:
            told.append(
                f"the shear angle reaches {np.rad2deg(largest):.1f} deg; small displacements hold "
                f"to some {SMALL_DEG:g} deg (set test.finite = true)"
            )
        laws = [
            what
            for what, law in (
                ("shear law", fabric.shear_law),
                ("warp's law of tension", fabric.warp_law),
                ("weft's law of tension", fabric.weft_law),
            )
            if law is not None and law.name != "linear"
        ]
        laws += ["softening in compression"] if fabric.compression < 1.0 else []
        if laws:
            told.append(
                "at small displacements only the moduli at rest act, not the "
                f"{' and the '.join(laws)} (test.finite = true takes the laws)"
            )
        return told
    if largest > last:
        told.append(
            f"the shear angle reaches {np.rad2deg(largest):.1f} deg, beyond the last point of the "
            f"shear law's table at {np.rad2deg(last):.1f} deg, where the law goes straight on"
        )
    gauge = experiment.net_gauge()
    if gauge is not None and result.controls.max() > net_reach(gauge):
        reach = format_si(float(f"{net_reach(gauge):.4g}"), "m")
        told.append(
            f"beyond an extension of {reach}, where yarns that do not stretch lie along the pull, "
            "the load is that of stretched yarns"
        )
    strains = [state.fields["arm_strain"] for state in result.states]
    least = min(comm.allgather(min(float(strain.min(initial=0.0)) for strain in strains)))
    most = max(comm.allgather(max(float(strain.max(initial=0.0)) for strain in strains)))
    # The strain at which yarns of cloth give way, as a rule (docs/laws.md).
    if fabric.compression == 1.0 and least < -fabric.compression_width:
        told.append(
            f"yarns are compressed by up to {-100 * least:.2g} % and carry that like tension; "
            "those of a cloth buckle (fabric.tension.compression = 0.01 softens them)"
        )
    cuts = [increment for increment in result.increments if increment.cuts]
    if cuts:
        told.append(
            f"steps were cut in half {sum(increment.cuts for increment in cuts)} times where no "
            f"equilibrium was found, first before {control_text(experiment, cuts[0].control)}; "
            "what follows may be another branch than that of smaller steps"
        )
    if most > BREAKING:
        told.append(
            f"yarns are stretched by up to {100 * most:.3g} %, which hardly any yarn stands; the "
            "laws of tension know no rupture"
        )
    return told


def _check_comparison(case: Case) -> None:
    """Refuse what no membrane is there to compare with."""
    asked = [key for key in ("compare", "ladder") if getattr(case.continuum, key)]
    if not asked:
        return
    kind = case.test.kind
    if kind not in COMPARED:
        raise InputError(
            f'continuum.{asked[0]}: there is no membrane to compare test.kind = "{kind}" with '
            f"(there is for {', '.join(COMPARED)}), leave it out"
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
    _, line = load_line(result)
    told = {"file": case.output.measured, **against_measured(line, measured)}
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


def _log_solver(log: logging.Logger, result: TestResult) -> None:
    if result.solver is not None:
        log.info(
            "           %d unknowns, %s with %s, %d iterations, relative residual %.1e",
            result.solver.unknowns,
            result.solver.ksp,
            result.solver.pc,
            result.solver.iterations,
            result.solver.relative_residual,
        )
        return
    iterations = [increment.iterations for increment in result.increments]
    if not iterations:  # a picture frame at small displacements, by one small finite step
        log.info("           %d unknowns", result.unknowns)
        return
    log.info(
        "           %d unknowns, %d increments, %.1f Newton iterations each (%d at most)",
        result.unknowns,
        len(iterations),
        np.mean(iterations),
        max(iterations),
    )


def _values(case: Case, column: Any) -> Any:
    """A column as it is if the case asked for a list, else its last value."""
    plain = [float(value) for value in column]
    return plain if case.test.is_curve else plain[-1]


def _extensions(result: TestResult, curve: dict[str, np.ndarray]) -> np.ndarray:
    """How far the loaded end has moved along the load, m; of a biaxial test, along the warp."""
    if "crosshead_mm" in curve:
        return 1e-3 * curve["crosshead_mm"]
    if "tip_across_mm" in curve:
        return 1e-3 * curve["tip_across_mm"]
    if result.experiment.unit == "1":
        preform = result.network.preform
        sides = np.ptp(np.reshape(preform.outline.bounds, (2, 2)), axis=0)
        return result.controls * float(abs(preform.rotation[0]) @ sides)
    return result.controls


def _summary(case: Case, result: TestResult, statistics: dict, hanging: int) -> dict:
    """The figures of a run; lists where the case asked for a list. Collective."""
    curve = result.curve()
    experiment = result.experiment
    comm = result.network.comm
    summary: dict[str, Any] = {
        "title": case.title,
        "kind": case.test.kind,
        "finite": case.test.finite,
        "crossovers": statistics["crossovers"],
        "dofs": result.unknowns or result.unknowns_per_node * statistics["nodes"],
        "load_n": _values(case, curve["load_N"]),
        "extension_m": _values(case, _extensions(result, curve)),
        "shear_centre_deg": _values(case, curve["shear_centre_deg"]),
        "shear_max_deg": _values(case, curve["shear_max_deg"]),
        "energy_j": {mode: _values(case, curve[f"energy_{mode}_J"]) for mode in MODES},
    }
    for name, column in curve.items():
        if name not in ("load_N", "extension_mm") and not name.startswith("energy_"):
            summary.setdefault(name.lower(), _values(case, column))
    summary |= experiment.figures(result)
    summary["yarn_tension_max"] = _largest_tension(result)
    summary["solver"] = _solver(result)
    if result.increments:
        summary["increments"] = _told_increments(result.increments)
        summary["newton_iterations_per_increment"] = float(
            np.mean([increment.iterations for increment in result.increments])
        )
    summary |= {
        "network": {**statistics, "hanging_crossovers": hanging},
        "model": experiment.model,
        "bending": case.test.bending,
        "case": case.model_dump(),
        **provenance(comm),
    }
    if result.uncarried is not None:
        summary["uncarried_share_of_load"] = result.uncarried
    return summary


def _all_stable(found: list[bool | None]) -> bool | None:
    """Whether all states are stable; None if that is not known of each."""
    return None if None in found else all(found)


def _largest_tension(result: TestResult) -> dict[str, Any]:
    """Largest tension of a yarn in the last state, and where (at rest). Collective.

    No place if it is that large on more than half of the crossovers. Of several places the lowest,
    whatever the ranks.
    """
    network, fields = result.network, result.fields
    carrying = fields["carrying"]
    place = network.crossover_position[carrying]
    found: dict[str, Any] = {}
    for family in ("warp", "weft"):
        tension = fields[f"{family}_tension"][carrying] / getattr(network.fabric, family).yarns
        largest = max(network.comm.allgather(float(tension.max(initial=-np.inf))))
        if found and largest <= found["n"] * (1.0 + 1e-9):
            continue
        near = tension >= largest - 1e-6 * abs(largest)
        count, of = network.comm.allreduce(np.array([near.sum(), len(near)]))
        own = np.round(1e3 * place[near], 6)
        own = own[np.lexsort(own.T)[:1]]
        there = np.concatenate(network.comm.allgather(own))  # one of each rank
        lowest = there[np.lexsort(there.T)[0]].tolist() if len(there) else None
        found = {"n": largest, "family": family, "at_mm": lowest if 2 * count <= of else None}
    if found["n"] < ROUNDING_N:
        return {"n": 0.0, "family": "warp", "at_mm": None}
    return found


def _solver(result: TestResult) -> dict[str, Any]:
    """How the systems were solved: the linear one, or those of all Newton iterations together."""
    if result.solver is not None:
        return {
            "ksp": result.solver.ksp,
            "pc": result.solver.pc,
            "iterations": result.solver.iterations,
            "reason": result.solver.reason,
            "relative_residual": result.solver.relative_residual,
            "setup_s": result.solver.setup_s,
            "solution_s": result.solver.solution_s,
        }
    return {
        **result.solver_types,
        "newton_iterations": sum(increment.iterations for increment in result.increments),
        "iterations": sum(increment.linear_iterations for increment in result.increments),
    }


def _write(case: Case, result: TestResult, directory: Path) -> None:
    """Tables and ParaView files. Collective."""
    comm, network, experiment = result.network.comm, result.network, result.experiment
    tables.write_csv(comm, directory / "curve.csv", result.curve())
    if experiment.has_zones:
        line = result.centre_line()
        tables.write_csv(
            comm,
            directory / "centre_line.csv",
            {
                "distance_mm": 1e3 * line.distance,
                "shear_angle_deg": np.rad2deg(line.shear_angle),
            },
        )
    if case.output.paraview:
        notes = file_notes(result, case.model_dump())
        moved = result.node_displacement
        paraview.write_network(directory / "network.vtkhdf", network, moved, result.fields, notes)
        if len(result.states) > 1:
            states, column = result.states, experiment.column
            paraview.write_series(directory / "series.vtkhdf", network, states, column, notes)
    if case.output.exports:
        result.export(directory)


def _told_increments(increments: list) -> list[dict[str, Any]]:
    return [
        {
            "control": increment.control,
            "load_n": increment.load,
            "newton_iterations": increment.iterations,
            "residual_n": increment.residual,
            "tolerance_n": increment.tolerance,
            "shifted": increment.shifted,
            "cuts": increment.cuts,
            "asked": increment.asked,
            "seconds": increment.seconds,
        }
        for increment in increments
    ]


def _write_nothing_but_increments(comm, case, directory, stages, progress, failure) -> None:
    """Leave a summary of a test that reached none of the values asked for. Collective."""
    summary = {
        "title": case.title,
        "kind": case.test.kind,
        "finite": case.test.finite,
        "ended_early": str(failure),
        "increments": _told_increments(progress.increments),
        "case": case.model_dump(),
        **provenance(comm),
        "wall_s": {**stages.seconds, "total": stages.total()},
    }
    tables.write_json(comm, directory / "summary.json", summary)


def _compare(case, stages: Stages, result, without, summary, directory: Path) -> list:
    """Solve the membrane and compare; returns its result for each state. Collective.

    At small displacements, where all states are in proportion, only the last one's.
    """
    if case.test.finite:
        return _compare_finite(case, stages, result, summary, directory)
    with stages.stage("continuum", "dolfinx membrane solved and compared"):
        membrane = result.membrane(case.continuum.mesh_size_si)
        comparison = result.compare_with_membrane(membrane)
        summary["continuum"] = {
            **comparison.as_dict(),
            "load_n": membrane.load,
            "energy_j": membrane.energy,
            "dofs": membrane.dofs,
            "cells": membrane.cells,
            "mesh_size_m": membrane.size,
        }
        if without is not None:
            fair = without.compare_with_membrane(membrane)
            summary["continuum"]["without_bending"] = fair.as_dict()
    return [membrane]


def _compare_finite(case, stages: Stages, result, summary, directory: Path) -> list:
    from .continuum.hyperelastic import HyperelasticMembrane

    network, experiment = result.network, result.experiment
    which = "second-gradient membrane" if case.second_gradient else "hyperelastic membrane"
    with stages.stage("continuum", f"{which} in dolfinx solved and compared"):
        reference = HyperelasticMembrane(
            network.comm,
            network.preform,
            network.fabric,
            case.continuum.mesh_size_si,
            bending=case.second_gradient,
        )
        membranes = reference.solve_bias_extension(result.extensions.tolist(), experiment.upper)
        energy = sum(result.energies().values())
        compared = [
            _compare_state(result, i, float(energy[i]), membrane).as_dict()
            for i, membrane in enumerate(membranes)
        ]
        columns = {key: [row[key] for row in compared] for key in compared[0]}
        columns["load_n"] = [membrane.load for membrane in membranes]
        columns["energy_j"] = [membrane.energy for membrane in membranes]
        columns["newton_iterations"] = [membrane.newton_iterations for membrane in membranes]
        summary["continuum"] = {name: _values(case, column) for name, column in columns.items()} | {
            "second_gradient": case.second_gradient,
            "stable": _all_stable([membrane.stable for membrane in membranes]),
            "dofs": membranes[-1].dofs,
            "cells": membranes[-1].cells,
            "mesh_size_m": membranes[-1].size,
        }
        tables.write_csv(
            network.comm,
            directory / "continuum.csv",
            {
                "extension_mm": 1e3 * result.extensions,
                "load_network_N": result.loads,
                "load_membrane_N": columns["load_n"],
                "load_ratio": columns["load_ratio"],
                "mean_abs_shear_difference_deg": columns["mean_abs_shear_deg"],
            },
        )
    return membranes


def _compare_state(result: TestResult, i: int, energy: float, membrane: Any) -> Any:
    """Differences of one state to the membrane at the crossovers. Collective."""
    from .continuum.compare import compare_fields

    state, network = result.states[i], result.network
    carrying = state.fields["carrying"]
    return compare_fields(
        network.comm,
        network.crossover_position[carrying],
        state.fields["displacement"][carrying],
        state.fields["shear_angle"][carrying],
        state.load,
        energy,
        membrane,
    )


def _ladder(comm, case: Case, stages: Stages, result, membrane) -> list[dict]:
    """Networks of the same fabric, finer and finer, against one membrane. Collective.

    With yarn bending only where the membrane has it, so that the difference can vanish.
    """
    rungs = []
    controls: Any = result.controls.tolist() if case.test.finite else float(result.extension)
    for refine in case.continuum.ladder or ():
        with stages.stage("ladder", f"refine = {refine} compared with the membrane"):
            network = Network(comm, case.preform(refine=refine), case.fabric())
            rung = case.experiment(network, bending=case.second_gradient, controls=controls).solve()
            comparison = rung.compare_with_membrane(membrane)
        rungs.append(
            {"refine": refine, "crossovers": network.num_crossovers_global} | comparison.as_dict()
        )
    return rungs


def _tell(log: logging.Logger, summary: dict, result: TestResult, directory: Path) -> None:
    """The result in a few lines."""

    def last(value: Any) -> float:
        return value[-1] if isinstance(value, list) else value

    log.info("")
    experiment = result.experiment
    name, value, unit = control_text(experiment, result.states[-1].control).rsplit(" ", 2)
    if experiment.control != "load":
        log.info("%-13s %s %s", name, value, unit)
    if experiment.kind == "cantilever":
        log.info("tip deflection %s", format_si(last(summary["extension_m"]), "m"))
    elif name != "extension":
        log.info("extension     %s", format_si(last(summary["extension_m"]), "m"))
    if experiment.kind == "biaxial":  # its load is no force of the test but does the work of both
        for family in ("warp", "weft"):
            log.info("%s force    %s", family, force_text(last(summary[f"force_{family}_n"])))
    else:
        log.info("load          %s", force_text(last(summary["load_n"])))
    angles = [(last(summary["shear_centre_deg"]), "at the centre point")]
    if np.isfinite(last(summary.get("shear_middle_deg", np.nan))):
        angles.append((last(summary["shear_middle_deg"]), "median of the middle zone"))
    angles.append((last(summary["shear_max_deg"]), "at most (absolute)"))
    log.info(
        "shear angle   %s",
        ", ".join(
            f"{round(angle, 2) + 0.0:.2f} deg {where}" for angle, where in angles
        ),  # no -0.00
    )
    most = summary["yarn_tension_max"]
    log.info("yarn tension  %s", tension_text(most))
    total = sum(last(value) for value in summary["energy_j"].values())
    log.info(
        "energy        %.4g mJ: %s",
        1e3 * total,
        ", ".join(
            f"{mode} {round(100 * last(value) / (total or 1.0), 1) + 0.0:.1f} %"
            for mode, value in summary["energy_j"].items()
        ),
    )
    measured = summary.get("measured", {})
    if "rms_relative" in measured:
        log.info(
            "measured      load differs by %.2f %% RMS, %+.2f %% at the end (%d of %d points)",
            100 * measured["rms_relative"],
            100 * measured["end_relative"],
            measured["points"],
            measured["points_measured"],
        )
    for mode, share in summary.get("uncarried_share_of_load", {}).items():
        log.info("%-9s     cannot carry %.1f %% of the load by itself", mode, 100 * share)
    continuum = summary.get("continuum", {})
    if "load_ratio" in continuum:
        pairs = [("with bending" if summary["bending"] else "without bending", continuum)]
        if "without_bending" in continuum:
            pairs.append(("without bending", continuum["without_bending"]))
        for name, figures_ in pairs:
            log.info(
                "membrane      network %s: displacement differs by %.2f %%, load ratio %.4f, "
                "energy ratio %.4f",
                name,
                100 * last(figures_["relative_l2_displacement"]),
                last(figures_["load_ratio"]),
                last(figures_["energy_ratio"]),
            )
        for rung in continuum.get("ladder", []):
            log.info(
                "  refine %-4d %8d crossovers: displacement differs by %.2f %%, load ratio %.4f",
                rung["refine"],
                rung["crossovers"],
                100 * rung["relative_l2_displacement"],
                rung["load_ratio"],
            )
    if summary.get("finite") and "load_ratio" in continuum:
        log.info(
            "              shear angle differs by %.2f deg in the mean",
            last(continuum["mean_abs_shear_deg"]),
        )
    peak = summary["peak_mib_per_rank"]
    log.info("memory        %.0f MiB on the largest rank", max(peak))
    log.info("results in    %s", directory)
