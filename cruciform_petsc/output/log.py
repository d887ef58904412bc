# SPDX-License-Identifier: MIT
"""What a run tells on its log: stages with their times, sizes, solvers, and the outcome."""

from __future__ import annotations

import logging
import os
import platform
import resource
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, suppress
from logging.handlers import MemoryHandler
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from .. import __version__, process
from ..cloth.datasheet import assumed_shear
from ..errors import CruciformError
from ..parallel import on_root
from ..quantities import (
    Quantity,
    angle_text,
    energy_unit,
    force_text,
    quantity,
    tension_text,
)
from ..solvers.options import blas_in_use
from ..units import format_si
from .folder import LOG, claim, explaining
from .provenance import versions

if TYPE_CHECKING:
    from mpi4py import MPI

    from ..experiments.result import TestResult

INDENT = " " * 11  # below the times of stages


class Stages:
    """Named stages of a run with their wall times, told on the log as they end."""

    def __init__(self, log: logging.Logger):
        self.log = log
        self.seconds: dict[str, float] = {}
        self._begin = time.perf_counter()

    @contextmanager
    def stage(self, name: str, what: str) -> Iterator[None]:
        """Time what is done inside."""
        begin = time.perf_counter()
        yield
        self.seconds[name] = self.seconds.get(name, 0.0) + time.perf_counter() - begin
        self.log.info("%8.2f s  %s", self.seconds[name], what)

    def wall_times(self) -> dict[str, float]:
        """Seconds of each stage, and since the beginning."""
        return {**self.seconds, "total": time.perf_counter() - self._begin}


@contextmanager
def kept(
    comm: MPI.Intracomm, directory: Path, log: logging.Logger, more: bool = False
) -> Iterator[Callable[[], None]]:
    """Have the log written to a file of a locked folder, too, while the block runs. Collective.

    From when the block calls what it gets: the file then has all lines since its beginning, with
    their times, and what ends the block early; before, nothing is touched. ``more``: behind what is
    there. A line that cannot be written is lost. Calling is collective, an InputError on every rank
    if the file cannot be made.
    """
    path, lines = directory / LOG, MemoryHandler(1, flushLevel=logging.CRITICAL + 1)
    lines.handleError = lambda record: None  # type: ignore[method-assign]

    @explaining(f'"{path}" cannot be written')
    def make() -> None:
        claim(path)
        file = logging.FileHandler(path, "a" if more else "w", "utf-8", errors="replace")
        file.setFormatter(process.LogLines("%(asctime)s  %(message)s", "%Y-%m-%d %H:%M:%S"))
        file.handleError = lines.handleError  # type: ignore[method-assign]
        lines.setTarget(file)
        lines.flush()

    if comm.rank == 0:
        log.addHandler(lines)
    try:
        yield lambda: on_root(comm, make)
    except BaseException as error:
        words = str(error) if isinstance(error, CruciformError) else type(error).__name__
        # Those who look at the log are told elsewhere.
        lines.handle(logging.LogRecord(log.name, logging.ERROR, "", 0, words, None, None))
        raise
    finally:
        log.removeHandler(lines)
        if lines.target is not None:
            with suppress(OSError):  # the disk is full
                lines.target.close()


def peak_mib(comm: MPI.Intracomm) -> list[float]:
    """Largest resident memory of each rank so far, MiB. Collective."""
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return comm.allgather(round(peak / (2**20 if platform.system() == "Darwin" else 1024), 1))


def tell_program(log: logging.Logger, ranks: int) -> None:
    """Program, versions, BLAS and ranks; and that kernels will be compiled, where none are kept."""
    package = Path(__file__).parents[1]
    if os.access(package, os.W_OK) and not any(package.glob("solvers/__pycache__/pattern.*.nbi")):
        log.info("%sfirst run here: kernels are compiled, once, which takes some 10 s", INDENT)
    libraries = f"PETSc {versions()['petsc']}, {blas_in_use()}"
    text = f"cruciform_petsc {__version__}, {libraries}, {ranks} rank{'s' if ranks > 1 else ''}"
    log.info("%s%s", INDENT, text)


def tell_network(log: logging.Logger, statistics: Mapping[str, Any]) -> None:
    """Sizes of a network."""
    texts = [
        "{crossovers} crossovers, {nodes} arm ends, {warp_yarns} warp and {weft_yarns} weft yarns"
    ]
    if statistics["crossovers_per_rank_min"] != statistics["crossovers"]:
        texts.append(
            "ranks hold {crossovers_per_rank_min} to {crossovers_per_rank_max} crossovers "
            "(imbalance {imbalance:.3f}), {cut_yarns} yarns cut between ranks"
        )
    for text in texts:
        log.info("%s%s", INDENT, text.format_map(statistics))


def tell_solver(log: logging.Logger, result: TestResult) -> None:
    """Unknowns, and what it took to find them."""
    solver, iterations = result.solver, [step.iterations for step in result.increments]
    if solver is not None:
        text = (
            f"{solver.unknowns} unknowns, {solver.ksp} with {solver.pc}, {solver.iterations} "
            f"iterations, relative residual {solver.relative_residual:.1e}"
        )
    elif iterations:
        text = (
            f"{result.unknowns} unknowns, {len(iterations)} increments, {np.mean(iterations):.1f} "
            f"Newton iterations each ({max(iterations)} at most)"
        )
    else:  # a picture frame at small displacements, by one small finite step
        text = f"{result.unknowns} unknowns"
    log.info("%s%s", INDENT, text)


def tell_outcome(
    log: logging.Logger, summary: Mapping[str, Any], result: TestResult, directory: Path
) -> None:
    """The result in a few lines."""
    log.info("")
    for name, text in (*_state(summary, result), *_comparisons(summary)):
        log.info("%-13s %s", name, text)
    tell_assumed(log, summary)
    log.info("memory        %.0f MiB on the largest rank", max(summary["peak_mib_per_rank"]))
    log.info("results in    %s", directory)


def tell_assumed(log: logging.Logger, summary: Mapping[str, Any]) -> None:
    """What the figures rest on, where shear was assumed."""
    text = assumed_shear(summary["fabric"]["assumed"])
    if text:
        log.info("assumed       %s", text)


def last(value: Any) -> Any:
    """The last value asked for: of a list, or the only one."""
    return value[-1] if isinstance(value, list) else value


def _state(summary: Mapping[str, Any], result: TestResult) -> Iterator[tuple[str, str]]:
    """Names and figures of the last state."""
    experiment = result.experiment
    control = experiment.column
    if experiment.control != "load":
        yield control.short, control.value_text(result.states[-1].control)
    if control.short != experiment.movement:
        yield experiment.movement, format_si(last(summary["extension_m"]), "m")
    for column in experiment.forces:
        yield quantity(column).name, force_text(last(summary[column.lower()]))
    angles = {
        "at the centre point": "shear_centre_deg",
        "median of the middle zone": "shear_middle_deg",
        "at most (absolute)": "shear_max_deg",
        "on 99 % of the area": "shear_99_deg",
    }
    found = {where: last(summary.get(key, np.nan)) for where, key in angles.items()}
    texts = [f"{angle_text(v)} {where}" for where, v in found.items() if np.isfinite(v)]
    yield "shear angle", ", ".join(texts)
    if "height_max_mm" in summary:
        yield "height", f"{last(summary['height_max_mm']):.4g} mm out of the plane at most"
    yield from stability_texts(summary, control)
    yield "yarn tension", tension_text(summary["yarn_tension_max"])
    energies = {mode: last(value) for mode, value in summary["energy_j"].items()}
    total = sum(energies.values())
    shares = {mode: round(100 * e / (total or 1.0), 1) + 0.0 for mode, e in energies.items()}
    texts = [f"{mode.replace('_', ' ')} {share:.1f} %" for mode, share in shares.items()]
    yield "energy", f"{_energy(total)}: {', '.join(texts)}"
    for column in ("dissipated_in_shear_J", "dissipated_in_slip_J"):
        if column.lower() in summary:
            name = quantity(column).name.removeprefix("dissipated ")
            yield "dissipated", f"{_energy(last(summary[column.lower()]))} {name}"


def _energy(joule: float) -> str:
    unit, size = energy_unit(joule)
    return f"{joule / size:.4g} {unit}"


def stability_texts(summary: Mapping[str, Any], control: Quantity) -> Iterator[tuple[str, str]]:
    """Names and words of critical states, and of what the linearised problem foretells."""
    found = summary.get("stability", {"critical": [], "linear": []})
    for key, name in (("critical", "unstable from"), ("linear", "linearised")):
        for state in found[key]:
            at = control.value_text(state[control.column.lower()] * control.scale)
            yield name, f"{control.short} {at}, load {force_text(state['load_n'])}"


def _comparisons(summary: Mapping[str, Any]) -> Iterator[tuple[str, str]]:
    """Names and figures of what the last state is compared with."""
    if "closed_form" in summary:
        yield "closed form", summary["closed_form"]["sentence"]
    measured = summary.get("measured", {})
    if "rms_relative" in measured:
        rms, end = 100 * measured["rms_relative"], 100 * measured["end_relative"]
        points = "({points} of {points_measured} points)".format_map(measured)
        yield "measured", f"load differs by {rms:.2f} % RMS, {end:+.2f} % at the end {points}"
    for mode, share in summary.get("uncarried_share_of_load", {}).items():
        yield mode, f"cannot carry {100 * share:.1f} % of the load by itself"
    continuum = summary.get("continuum", {})
    if "load_ratio" not in continuum:
        return
    bent = "with bending" if summary["bending"] else "without bending"
    for name, figures in ((bent, continuum), ("without bending", continuum.get("without_bending"))):
        if figures is not None:
            energy = last(figures["energy_ratio"])
            yield "membrane", f"network {name}: {_off(figures)}, energy ratio {energy:.4f}"
    for rung in continuum.get("ladder", []):
        name = f"  refine {rung['refine']:<4d}"
        yield name, f"{rung['crossovers']:8d} crossovers: {_off(rung)}"
    if summary["finite"]:
        mean = last(continuum["mean_abs_shear_deg"])
        yield "", f"shear angle differs by {mean:.2f} deg in the mean"


def _off(figures: Mapping[str, Any]) -> str:
    moved, ratio = last(figures["relative_l2_displacement"]), last(figures["load_ratio"])
    return f"displacement differs by {100 * moved:.2f} %, load ratio {ratio:.4f}"
