# SPDX-License-Identifier: MIT
"""From a case to its results: what `cruciform-petsc run` and `check` do, in order."""

from __future__ import annotations

import logging
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any
from warnings import catch_warnings, simplefilter

import numpy as np
from mpi4py import MPI

from .calibration.curve import MeasuredCurve, read_curve
from .calibration.specimen import KINDS as SPECIMENS
from .calibration.specimen import Specimen, unit_question
from .case.schema import Case
from .cloth.fabric import Fabric
from .cloth.preform import Preform
from .compare import against_measured, load_line
from .continuum.compare import Reference
from .continuum.formed import FormedReference
from .errors import EquilibriumError, InputError, InputWarning, SolverError
from .estimate import check_work
from .experiments.experiment import Experiment
from .experiments.limits import warnings
from .experiments.registry import KINDS, kind_class
from .experiments.result import TestResult
from .forming.draping import Draping
from .forming.fishnet_table import FishnetTable
from .forming.forming import Formed
from .forming.kind import Forming
from .forming.table import FormingTable
from .net.network import Network
from .output import draped, figures, formed, paraview, tables
from .output import log as logs
from .output.checkpoint import Checkpoint, resume_command
from .output.exports import export, export_formed
from .output.folder import LOG, OF_RUN, locked, remove_results
from .output.log import INDENT, Stages
from .output.pattern import write_pattern
from .output.progress import Progress, sign_of_life
from .output.provenance import file_notes, notes_on
from .output.report import write_fishnet_report, write_forming_report, write_report
from .output.summary import summarize, summarize_nothing
from .parallel import on_root
from .solvers.options import unused_options


def check_case(comm: MPI.Intracomm, case: Case, log: logging.Logger) -> None:
    """Make the network of a case and tell its sizes; solves and writes nothing. Collective."""
    measured = _check_comparison(comm, case)
    log.info("%s", case.title)
    _tell_model(case, log)
    for sentence in check_work(comm, case):
        log.info("%s%s", INDENT, sentence)
    networks, _ = _make_networks(comm, case, Stages(log))
    network = networks[0]
    log.info("%s%s, %s", INDENT, case.test.kind, _size(case))
    for sentence in _remarks(case, networks, measured):
        log.warning("warning       %s", sentence)
    if not case.test.finite:
        per_node = 3 if case.test.bending else 2
        log.info("%s%d unknowns", INDENT, per_node * network.num_nodes_global)
    forms = isinstance(case.test, FormingTable | FishnetTable)
    experiment = case.forming(networks) if forms else case.experiment(network)
    for sentence in experiment.check():
        log.info("%s%s", INDENT, sentence)
    for sentence in experiment.remarks:
        log.warning("warning       %s", sentence)


def run_case(
    comm: MPI.Intracomm,
    case: Case,
    directory: Path,
    log: logging.Logger,
    checkpoint: Checkpoint | None = None,
) -> dict:
    """Run a case and write its results into a folder. Collective; returns the summary.

    A finite test begins at rest or goes on from a checkpoint, and keeps one until all results are
    there. A test that ends early, or a membrane that cannot be solved, raises its SolverError on
    every rank after all that was reached is on disk.
    """
    kind: type[_Run] = _FormingRun if isinstance(case.test, FormingTable) else _Run
    if isinstance(case.test, FishnetTable):
        kind = _FishnetRun
    with locked(comm, directory, (*OF_RUN, LOG), log), catch_warnings():
        simplefilter("ignore", InputWarning)  # the log and the summary tell it
        with logs.kept(comm, directory, log, more=checkpoint is not None) as keep_log:
            return kind(comm, case, directory, log, checkpoint, keep_log).run()


def _tell_model(case: Case, log: logging.Logger) -> None:
    """What else than cruciforms the cloth is made of."""
    if getattr(case.test, "model", "") == "truss":
        log.info('%smodel "truss": pin-jointed bars with soft diagonals, no cruciforms', INDENT)


def _size(case: Case) -> str:
    return "finite deformation" if case.test.finite else "small displacements"


def _check_comparison(comm: MPI.Intracomm, case: Case) -> MeasuredCurve | None:
    """Refuse what there is no membrane for, and read measured data, before hours of work."""
    asked = [key for key in ("compare", "ladder") if getattr(case.continuum, key)]
    kind = case.test.kind
    compared = [name for name in KINDS if kind_class(name).reference]
    if asked and kind not in compared:
        raise InputError(
            f'continuum.{asked[0]}: there is no membrane to compare test.kind = "{kind}" with '
            f"(there is for {', '.join(compared)}), leave it out"
        )
    if asked and getattr(case.test, "ends", "grip") == "free":
        raise InputError(
            f'continuum.{asked[0]} needs gripped ends, leave it out or set test.ends = "grip"'
        )
    path = case.output.measured
    if path is None:
        return None
    if kind.startswith("biaxial"):
        raise InputError(
            "output.measured is a force over a displacement, which a biaxial test does not have, "
            "leave it out"
        )
    return on_root(comm, lambda: read_curve(path, case.output.measured_columns))


def _remarks(
    case: Case, networks: Sequence[Network], measured: MeasuredCurve | None = None
) -> list[str]:
    """What may be meant otherwise in a case, and what was left out of its measured data."""
    questions: list[str | None] = [*case.fabric_table.questions()]
    for network in networks:
        questions += network.preform.questions(network.fabric)
    if measured is not None:
        questions += [f"measured data: {note}" for note in measured.notes]
        if case.test.kind in SPECIMENS:
            upper = getattr(case.test, "upper", "grip")
            specimen = Specimen(networks[0], measured, case.test.kind, upper)
            questions.append(specimen.unit_question())
    return [question for question in questions if question]


def _make_network(
    comm: MPI.Intracomm, case: Case, stages: Stages
) -> tuple[Network, Mapping[str, Any]]:
    """The network of a case and its sizes, told on the log. Collective."""
    for sentence in case.fabric_table.filled_in():
        stages.log.info("%s%s", INDENT, sentence)
    return _network_of(comm, case.fabric(), case.preform(), stages)


def _network_of(
    comm: MPI.Intracomm, fabric: Fabric, preform: Preform, stages: Stages
) -> tuple[Network, Mapping[str, Any]]:
    stages.log.info("%s%r", INDENT, fabric)
    stages.log.info("%s%r", INDENT, preform)
    with stages.stage("network", "network"):
        network = Network(comm, preform, fabric)
        statistics = network.statistics()
    logs.tell_network(stages.log, statistics)
    return network, statistics


def _make_networks(
    comm: MPI.Intracomm, case: Case, stages: Stages
) -> tuple[list[Network], list[Mapping[str, Any]]]:
    """Networks of all plies of a forming, from the lowest up, and their sizes. Collective."""
    if not case.plies:
        network, statistics = _make_network(comm, case, stages)
        return [network], [statistics]
    networks, sizes = [], []
    for ply in case.stack():
        stages.log.info('ply           "%s"', ply.name)
        network, statistics = _network_of(comm, ply.fabric, ply.preform, stages)
        networks.append(network)
        sizes.append(statistics)
    return networks, sizes


@dataclass
class _Run:
    """A case on the way to its results; all methods are collective."""

    comm: MPI.Intracomm
    case: Case
    directory: Path
    log: logging.Logger
    checkpoint: Checkpoint | None
    keep_log: Callable[[], None]
    measured: MeasuredCurve | None = None
    summary: dict[str, Any] = field(default_factory=dict)
    failure: SolverError | None = None

    def __post_init__(self) -> None:
        self.stages = Stages(self.log)
        self.summary["fabric"] = {
            "name": self.case.fabric().name,
            "source": self.case.fabric().source,
            "assumed": self.case.fabric_table.filled_in(),
        }

    def run(self) -> dict[str, Any]:
        """All that `run_case` does."""
        with self._telling_how_to_resume():
            return self._run()

    def _run(self) -> dict[str, Any]:
        case, log = self.case, self.log
        self.measured = _check_comparison(self.comm, case)
        check_work(self.comm, case)
        log.info("%s", case.title)
        logs.tell_program(log, self.comm.size)
        _tell_model(case, log)
        network, statistics = _make_network(self.comm, case, self.stages)
        experiment = case.experiment(network)
        self.summary["warnings"] = experiment.remarks
        for sentence in experiment.remarks:
            log.warning("warning       %s", sentence)
        result = self._solve(experiment)
        logs.tell_solver(log, result)
        hanging = self.comm.allreduce(result.supports.num_hanging)
        if hanging:
            text = "%s%d crossovers hang on by one arm end and carry no load"
            log.info(text, INDENT, hanging)

        summary = self.summary
        summary |= summarize(case, result, statistics, hanging)
        if self.checkpoint is not None and self.checkpoint.increments:
            summary["resumed_after_increments"] = len(self.checkpoint.increments)
        for sentence in [*warnings(result), *_remarks(case, [network], self.measured)]:
            summary["warnings"] = [*summary["warnings"], sentence]
            log.warning("warning       %s", sentence)
        if self.failure is not None:
            summary["ended_early"] = str(self.failure)
        with self.stages.stage("write", "results written"):
            self._write_files(result)
        without = self._solve_without_bending(result)
        membranes = self._compare_with_membranes(result, without)
        drawn = self._draw(result, without, membranes)
        self._write_summary()
        if case.output.wants_report:
            write_report(self.directory, case, result, summary, drawn)
        logs.tell_outcome(log, summary, result, self.directory)
        if self.failure is not None:
            raise self.failure
        if self.checkpoint is not None:
            self.checkpoint.remove()
        return summary

    def _solve(self, experiment: Experiment) -> TestResult:
        """Solve; what ends a test early is kept in ``failure`` if anything was reached."""
        case = self.case
        progress = Progress(experiment, self.directory / "curve.csv", self.log)
        self._open_checkpoint()
        if self.checkpoint is not None:
            progress.go_on_from(self.checkpoint.increments)
        model = "" if case.test.finite else f", {experiment.model} model"
        with self.stages.stage("solve", f"{case.test.kind}, {_size(case)}{model}, solved"):
            try:
                with progress.bar(), sign_of_life(self.log):
                    return experiment.solve(progress, self.checkpoint)
            except EquilibriumError as error:
                self.failure = error
        if self.failure.result is None:
            reason = str(self.failure)
            self.summary |= summarize_nothing(
                self.comm, case, reason, progress.increments, experiment.forces
            )
            self._write_summary()
            raise self.failure
        return self.failure.result

    def _open_checkpoint(self) -> None:
        """Begin one where there is none yet; what an earlier run has left is removed then."""
        resumed, log = self.checkpoint is not None, self.log
        if self.case.test.finite and not resumed:
            self.checkpoint = Checkpoint.begin(self.comm, self.directory, self.case)
        for note in self.checkpoint.notes if self.checkpoint is not None else ():
            log.warning("warning       %s", note)
        if not resumed:
            replaced = remove_results(self.comm, self.directory)
            if replaced:
                log.info("%sreplaces the results of %s", INDENT, replaced)
        self.keep_log()
        if self.checkpoint is not None:
            command = resume_command(self.directory, self.comm.size)
            log.info("%sif interrupted, continue with: %s", INDENT, command)

    @contextmanager
    def _telling_how_to_resume(self) -> Iterator[None]:
        """Add it to a problem with files, a full disk mostly."""
        try:
            yield
        except InputError as error:
            told = ("cruciform-petsc resume", "cruciform-petsc run")  # either is enough
            if self.checkpoint is None or any(words in str(error) for words in told):
                raise
            hint = self.checkpoint.hint()
            raise InputError(f"{error}{'; ' if hint else ''}{hint}") from None

    def _write_csv(self, name: str, columns: Mapping[str, Any]) -> None:
        tables.write_csv(self.comm, self.directory / name, columns)

    def _write_files(self, result: TestResult) -> None:
        """Tables and files for other programs."""
        output, directory = self.case.output, self.directory
        self._write_csv("curve.csv", result.curve())
        if result.experiment.has_zones:
            line = result.centre_line()
            columns = {
                "distance_mm": 1e3 * line.distance,
                "shear_angle_deg": np.rad2deg(line.shear_angle),
            }
            self._write_csv("centre_line.csv", columns)
        if output.paraview:
            notes = file_notes(result, self.case.model_dump())
            paraview.write_state(directory / "network.vtkhdf", result, notes)
            if max(len(result.states), len(result.increments)) > 1:
                paraview.write_series(directory / "series.vtkhdf", result, notes)
            if result.buckling is not None and result.buckling.modes:
                paraview.write_modes(directory / "mode.vtkhdf", result, notes)
        if output.exports:
            export(result, directory)
        if self.measured is not None:
            compared = against_measured(load_line(result), self.measured)
            self.summary["measured"] = {"file": output.measured, **compared}
            self._ask_for_unit(compared["measured_n"] / compared["load_n"])
            keys = ("displacement_mm", "measured_n", "load_n")
            columns = {key.replace("_n", "_N"): compared[key] for key in keys}
            self._write_csv("load_and_measured.csv", columns)

    def _ask_for_unit(self, ratios: np.ndarray) -> None:
        """Ask after loads that are far off those computed, if that was not asked before."""
        asked = self.summary["warnings"]
        known = ratios[np.isfinite(ratios)]
        question = unit_question(float(np.median(known)), "computed") if len(known) else None
        if question and not any("meant in place of" in sentence for sentence in asked):
            asked.append(question)
            self.log.warning("warning       %s", question)

    def _write_summary(self) -> None:
        """Add times and memory, and write summary.json."""
        self.summary["wall_s"] = self.stages.wall_times()
        self.summary["peak_mib_per_rank"] = logs.peak_mib(self.comm)
        tables.write_json(self.comm, self.directory / "summary.json", self.summary)

    def _solve_without_bending(self, result: TestResult) -> TestResult | None:
        """The last state of a small test without yarn bending, where that is compared."""
        case = self.case
        wanted = case.output.pictures or case.continuum.compare
        comparable = result.experiment.has_zones and result.experiment.model == "coupled"
        moved = result.extension != 0.0  # a list may end at rest
        if case.test.finite or not (moved and case.test.bending and comparable and wanted):
            return None
        text = "the same without yarn bending, to compare"
        with self.stages.stage("solve_without_bending", text):
            extension = float(result.extension)
            experiment = case.experiment(result.network, bending=False, controls=extension)
            without = experiment.solve()
        self.summary["without_bending"] = {
            "load_n": without.load,
            "shear_centre_deg": float(np.rad2deg(without.shear_angle_centre)),
            "shear_max_deg": float(np.rad2deg(without.shear_angle_max)),
        }
        return without

    def _compare_with_membranes(self, result: TestResult, without: TestResult | None) -> list:
        """Solve membranes beside a test that went well, where that is asked for; returns them."""
        case = self.case
        membranes: list = []
        if self.failure is not None or not (case.continuum.compare or case.continuum.ladder):
            return membranes
        which = "dolfinx membrane"
        if case.test.finite:
            order = "second-gradient" if case.second_gradient else "hyperelastic"
            which = f"{order} membrane in dolfinx"
        try:
            with self.stages.stage("continuum", f"{which} solved and compared"):
                size = case.continuum.mesh_size_si
                reference = Reference.solve(result, size, case.second_gradient)
                self.summary["continuum"] = reference.summary(without)
                table = reference.table()
                if table:
                    self._write_csv("continuum.csv", table)
            membranes = reference.membranes
            self._climb_ladder(reference)
        except SolverError as error:
            self.failure = error
            self.summary.setdefault("continuum", {})["failed"] = str(error)
        return membranes

    def _climb_ladder(self, reference: Reference) -> None:
        """Compare networks of the same fabric, finer and finer, with one membrane.

        With yarn bending only where the membrane has it, so that the difference can vanish.
        """
        case, result = self.case, reference.result
        controls: Any = result.controls.tolist() if case.test.finite else float(result.extension)

        def rung(refine: int) -> dict[str, Any]:
            network = Network(self.comm, case.preform(refine=refine), case.fabric())
            finer = case.experiment(network, bending=case.second_gradient, controls=controls)
            return reference.rung(finer)

        self._climb(rung)

    def _climb(self, rung: Callable[[int], dict[str, Any] | None]) -> None:
        """Compare a rung for each value of refine; to summary and ladder.csv."""
        rungs = []
        for refine in self.case.continuum.ladder or ():
            with self.stages.stage("ladder", f"refine = {refine} compared with the membrane"):
                rungs.append({"refine": refine} | (rung(refine) or {}))
        if rungs:
            self.summary["continuum"]["ladder"] = rungs
            self._write_csv("ladder.csv", {key: [rung[key] for rung in rungs] for key in rungs[0]})

    def _draw(self, result: TestResult, without: TestResult | None, membranes: list) -> list[str]:
        """Draw the pictures that are asked for; returns their names."""
        output, directory, drawn = self.case.output, self.directory, []
        if output.pictures:
            with self.stages.stage("pictures", "pictures drawn"):
                drawn = figures.draw_all(
                    directory, result, without, membranes, self.summary, self.measured
                )
        if output.animation:
            with self.stages.stage("animation", "animation drawn"):
                figures.draw_animation(result, directory / "animation.gif", self.case.title)
        if output.scene:
            with self.stages.stage("scene", "yarns drawn in space"):
                try:
                    figures.scene(result, directory / "scene.png", self.case.title)
                    drawn.append("scene.png")
                except InputError as error:  # the results are worth more than a picture of them
                    self.log.warning("no scene.png: %s", error)
        return drawn


class _FormingRun(_Run):
    """A forming on the way to its results; all methods are collective."""

    def _run(self) -> dict[str, Any]:
        case, log, comm = self.case, self.log, self.comm
        check_work(comm, case)
        log.info("%s", case.title)
        logs.tell_program(log, comm.size)
        _tell_model(case, log)
        networks, statistics = _make_networks(comm, case, self.stages)
        with self.stages.stage("set_up", "tools and blank set up"):
            forming = case.forming(networks)
        for sentence in forming.check():
            log.info("%s%s", INDENT, sentence)
        self.summary["warnings"] = [*forming.remarks, *_remarks(case, networks)]
        for sentence in self.summary["warnings"]:
            log.warning("warning       %s", sentence)
        self._open_checkpoint()
        former = self.checkpoint.steps if self.checkpoint is not None else []
        record = formed.Record(forming, self.directory / "forces.csv", log, len(former))
        if former:
            self.summary["resumed_after_steps"] = len(former)
        result = self._form(forming, record)
        told = formed.summarize(case, forming, result, record, statistics)
        unused = unused_options(comm, forming.options)
        for sentence in [*told.pop("warnings", []), *unused]:
            self.summary["warnings"].append(sentence)
            log.warning("warning       %s", sentence)
        self.summary |= told
        if self.failure is not None:
            self.summary["ended_early"] = str(self.failure)
        if result.steps:
            with self.stages.stage("write", "results written"):
                for one in forming.each:
                    self._write_ply(one, result)
                if case.output.paraview:
                    for one in forming.each:
                        notes = notes_on(one.network, forming.kind, case.model_dump())
                        formed.write_series(self.directory, one, result, notes)
            drawn = []
            if case.output.pictures:
                with self.stages.stage("pictures", "pictures drawn"):
                    drawn = formed.draw_all(self.directory, forming, result, record, self.summary)
            if case.output.animation:
                with self.stages.stage("animation", "animation drawn"):
                    try:
                        formed.draw_animation(self.directory, forming, result, case.title)
                    except InputError as error:  # results are worth more
                        log.warning("no animation.gif: %s", error)
            self._compare_with_membrane(forming, result, record)
        self._write_summary()
        if result.steps:
            if case.output.wants_report:
                table, view = record.table(), formed.view_of(forming, result)
                write_forming_report(comm, self.directory, case, self.summary, table, drawn, view)
            formed.tell_outcome(log, self.summary, self.directory)
        if self.failure is not None:
            raise self.failure
        if self.checkpoint is not None:
            self.checkpoint.remove()
        return self.summary

    def _write_ply(self, forming: Forming, result: Formed) -> None:
        """Tables and decks of a ply, or of a single blank."""
        case, state, log = self.case, result.states[-1], self.log
        path = self.directory / f"fields{forming.suffix}.csv"
        formed.write_fields(path, forming, state)
        for sentence in write_pattern(self.directory, forming, state, log, case.output.part):
            self.summary["warnings"].append(sentence)
            log.warning("warning       %s", sentence)
        if case.output.exports:
            export_formed(self.directory, forming, state)

    def _compare_with_membrane(
        self, forming: Forming, result: Formed, record: formed.Record
    ) -> None:
        """Form a membrane beside a forming that went well, where that is asked for."""
        continuum = self.case.continuum
        if self.failure is not None or not (continuum.compare or continuum.ladder):
            return
        told = []
        if self.summary["wrinkles"]["area_share"] > 0.0:
            told.append(
                "the cloth has wrinkles, and the membrane beside it no bending: they need not agree"
            )
        try:
            with self.stages.stage("continuum", "membrane in dolfinx formed and compared"):
                self.log.info("%sthe membrane beside it:", INDENT)
                reference = FormedReference(
                    forming, result, continuum.mesh_size_si, lambda step, _: record.tell(step)
                )
                self.summary["continuum"] = reference.summary()
                if reference.rows:
                    self._write_csv("continuum.csv", reference.table())

            def rung(refine: int) -> dict[str, Any] | None:
                network = Network(self.comm, self.case.preform(refine=refine), self.case.fabric())
                return reference.rung(self.case.forming(network))

            if reference.failed:
                told.append(f"the membrane beside it could not be formed: {reference.failed}")
            else:
                self._climb(rung)
        except EquilibriumError as error:
            told.append(f"a net of continuum.ladder could not be formed: {error}")
        except SolverError as error:
            self.failure = error
            self.summary.setdefault("continuum", {})["failed"] = str(error)
        for sentence in told:
            self.summary["warnings"].append(sentence)
            self.log.warning("warning       %s", sentence)

    def _form(self, forming: Forming, record: formed.Record) -> Formed:
        """Form; what ends it early is kept in ``failure``, with what was reached."""
        with self.stages.stage("solve", "formed"):
            try:
                with sign_of_life(self.log):
                    return forming.solve(record, self.checkpoint)
            except EquilibriumError as error:
                self.failure = error
                return error.result or Formed(forming.blank)


class _FishnetRun(_Run):
    """A fishnet on the way to its results; all methods are collective."""

    def _run(self) -> dict[str, Any]:
        case, log, comm, directory = self.case, self.log, self.comm, self.directory
        check_work(comm, case)
        log.info("%s", case.title)
        logs.tell_program(log, comm.size)
        network, statistics = _make_network(comm, case, self.stages)
        with self.stages.stage("solve", "laid"):
            draping = case.forming(network)
            assert isinstance(draping, Draping)
            told = draped.summarize(case, draping, statistics)
        self.failure = draping.failure()
        given = [*draping.remarks, *_remarks(case, [network]), *told.pop("warnings")]
        for sentence in given:
            log.warning("warning       %s", sentence)
        self.summary |= told | {"warnings": given}
        if self.failure is not None:
            self.summary["ended_early"] = str(self.failure)
        self._open_checkpoint()
        with self.stages.stage("write", "results written"):
            self._write_csv("curve.csv", draped.curve(self.summary))
            draped.write_fields(directory / "fields.csv", draping)
            for sentence in write_pattern(directory, draping, draping.state, log, case.output.part):
                self.summary["warnings"].append(sentence)
                log.warning("warning       %s", sentence)
            if case.output.exports:
                export_formed(directory, draping, draping.state)
            if case.output.paraview:
                notes = notes_on(network, draping.kind, case.model_dump())
                draped.write_series(directory, draping, notes)
        drawn = []
        if case.output.pictures:
            with self.stages.stage("pictures", "pictures drawn"):
                drawn = draped.draw_all(directory, draping, case.title, log)
        self._write_summary()
        if case.output.wants_report:
            view = draped.view_of(draping)
            write_fishnet_report(comm, directory, case, self.summary, drawn, view)
        draped.tell_outcome(log, self.summary, directory)
        if self.failure is not None:
            raise self.failure
        return self.summary

    def _open_checkpoint(self) -> None:
        """Without one: it is done in seconds."""
        replaced = remove_results(self.comm, self.directory)
        if replaced:
            self.log.info("%sreplaces the results of %s", INDENT, replaced)
        self.keep_log()
