# SPDX-License-Identifier: MIT
"""From a case to its results: what `cruciform-petsc run` and `check` do, in order."""

from __future__ import annotations

import logging
import platform
import resource
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import petsc4py
from mpi4py import MPI

from . import __version__
from .assembly import MODES
from .case import Case
from .experiments.bias_extension import BiasExtension, BiasExtensionResult
from .network import Network
from .output import figures, paraview, tables
from .units import format_si


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


def log_network(log: logging.Logger, statistics: dict) -> None:
    """Tell the sizes of a network."""
    log.info(
        "           %d crossovers, %d arm ends, %d warp and %d weft yarns",
        *(statistics[key] for key in ("crossovers", "nodes", "warp_yarns", "weft_yarns")),
    )
    log.info(
        "           ranks hold %d to %d crossovers (imbalance %.3f), %d yarns cut between ranks",
        statistics["crossovers_per_rank_min"],
        statistics["crossovers_per_rank_max"],
        statistics["imbalance"],
        statistics["cut_yarns"],
    )


def check_case(comm: MPI.Intracomm, case: Case, log: logging.Logger) -> None:
    """Make the network of a case and tell its sizes; solves and writes nothing. Collective."""
    stages = Stages(comm, log)
    fabric, preform = case.fabric(), case.preform()
    log.info("%s", case.title)
    log.info("           %r", fabric)
    log.info("           %r", preform)
    with stages.stage("network", "network"):
        network = Network(comm, preform, fabric)
    log_network(log, network.statistics())
    per_node = 3 if case.test.bending else 2
    log.info("           %d unknowns", per_node * network.num_nodes_global)
    experiment = _experiment(case, network, case.test.bending)
    for value in experiment.check():
        log.info("           %s", value)


def _experiment(case: Case, network: Network, bending: bool, **changes: Any) -> BiasExtension:
    test = case.test
    given = {"extension": test.extension_si, "load": test.load_si} | changes
    if given["extension"] is not None and not isinstance(given["extension"], float):
        given["extension"] = list(given["extension"])
    return BiasExtension(
        network,
        **given,
        upper=test.upper,
        model=test.model,
        bending=bending,
        options=case.solver.options,
    )


def run_case(comm: MPI.Intracomm, case: Case, directory: Path, log: logging.Logger) -> dict:
    """Run a case and write its results into a folder. Collective; returns the summary."""
    stages = Stages(comm, log)
    log.info("%s", case.title)
    log.info(
        "           cruciform_petsc %s, PETSc %s, %d rank%s",
        __version__,
        ".".join(map(str, _petsc_version())),
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

    with stages.stage("solve", f"{case.test.kind}, {case.test.model} model, solved"):
        result = _experiment(case, network, case.test.bending).solve()
    log.info(
        "           %d unknowns, %s with %s, %d iterations, relative residual %.1e",
        result.solver.unknowns,
        result.solver.ksp,
        result.solver.pc,
        result.solver.iterations,
        result.solver.relative_residual,
    )
    hanging = comm.allreduce(result.linear.supports.num_hanging)
    if hanging:
        log.info("           %d crossovers hang on by one arm end and carry no load", hanging)

    summary = _summary(case, result, statistics, hanging)
    curve = result.curve()
    without = None
    if case.test.bending and case.test.model == "coupled" and (
        case.output.pictures or case.continuum.compare
    ):  # fmt: skip
        with stages.stage("solve_without_bending", "the same without yarn bending, to compare"):
            without = _experiment(
                case, network, False, extension=float(result.extension), load=None
            ).solve()
        summary["without_bending"] = {
            "load_n": without.load,
            "shear_centre_deg": float(np.rad2deg(without.shear_angle_centre)),
            "shear_max_deg": float(np.rad2deg(without.shear_angle_max)),
        }

    membrane = None
    if case.continuum.compare or case.continuum.ladder:
        membrane = _compare(case, stages, result, without, summary)
    if case.continuum.ladder:
        rungs = _ladder(comm, case, stages, result, membrane)
        summary["continuum"]["ladder"] = rungs
        tables.write_csv(
            comm,
            directory / "ladder.csv",
            {key: [rung[key] for rung in rungs] for key in rungs[0]},
        )

    with stages.stage("write", "results written"):
        tables.write_csv(comm, directory / "curve.csv", curve)
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
            paraview.write_network(
                directory / "network.vtkhdf", network, result.node_displacement, result.fields
            )
    if case.output.pictures:
        with stages.stage("pictures", "pictures drawn"):
            figures.draw_all(directory, result, without, membrane, summary)
    summary["wall_s"] = {**stages.seconds, "total": stages.total()}
    summary["peak_mib_per_rank"] = peak_mib(comm)
    tables.write_json(comm, directory / "summary.json", summary)
    _tell(log, summary, directory)
    return summary


def _petsc_version() -> tuple[int, ...]:
    from petsc4py import PETSc

    return PETSc.Sys.getVersion()


def _summary(case: Case, result: BiasExtensionResult, statistics: dict, hanging: int) -> dict:
    """The figures of a run; lists where the case asked for a list. Collective."""
    curve = result.curve()

    def values(column: np.ndarray) -> Any:
        return [float(value) for value in column] if case.test.is_curve else float(column[-1])

    comm = result.network.comm
    summary: dict[str, Any] = {
        "title": case.title,
        "ranks": comm.size,
        "crossovers": statistics["crossovers"],
        "dofs": result.linear.unknowns_per_node * statistics["nodes"],
        "load_n": values(curve["load_N"]),
        "extension_m": values(1e-3 * curve["extension_mm"]),
        "shear_centre_deg": values(curve["shear_centre_deg"]),
        "shear_max_deg": values(curve["shear_max_deg"]),
        "energy_j": {mode: values(curve[f"energy_{mode}_J"]) for mode in MODES},
        "solver": {
            "ksp": result.solver.ksp,
            "pc": result.solver.pc,
            "iterations": result.solver.iterations,
            "reason": result.solver.reason,
            "relative_residual": result.solver.relative_residual,
            "setup_s": result.solver.setup_s,
            "solution_s": result.solver.solution_s,
        },
        "network": {**statistics, "hanging_crossovers": hanging},
        "model": case.test.model,
        "bending": case.test.bending,
        "case": case.model_dump(),
        "versions": {
            "cruciform_petsc": __version__,
            "python": platform.python_version(),
            "petsc": ".".join(map(str, _petsc_version())),
            "petsc4py": petsc4py.__version__,
            "numpy": np.__version__,
        },
    }
    if result.uncarried is not None:
        summary["uncarried_share_of_load"] = result.uncarried
    return summary


def _compare(case, stages: Stages, result, without, summary) -> Any:
    """Solve the membrane and compare; returns its result. Collective."""
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
    return membrane


def _ladder(comm, case: Case, stages: Stages, result, membrane) -> list[dict]:
    """Networks of the same fabric, finer and finer, against one membrane. Collective.

    Without yarn bending, which the membrane does not have, so that the difference can vanish.
    """
    rungs = []
    for refine in case.continuum.ladder or ():
        with stages.stage("ladder", f"refine = {refine} compared with the membrane"):
            network = Network(comm, case.preform(refine=refine), case.fabric())
            rung = _experiment(
                case, network, False, extension=float(result.extension), load=None
            ).solve()
            comparison = rung.compare_with_membrane(membrane)
        rungs.append(
            {"refine": refine, "crossovers": network.num_crossovers_global}
            | comparison.as_dict()
        )
    return rungs


def _tell(log: logging.Logger, summary: dict, directory: Path) -> None:
    """The result in a few lines."""

    def last(value: Any) -> float:
        return value[-1] if isinstance(value, list) else value

    log.info("")
    log.info("extension     %s", format_si(last(summary["extension_m"]), "m"))
    log.info("load          %s", format_si(last(summary["load_n"]), "N"))
    log.info(
        "shear angle   %.2f deg in the middle, %.2f deg at most",
        last(summary["shear_centre_deg"]),
        last(summary["shear_max_deg"]),
    )
    total = sum(last(value) for value in summary["energy_j"].values())
    log.info(
        "energy        %.4g mJ: %s",
        1e3 * total,
        ", ".join(
            f"{mode} {100 * last(value) / total:.1f} %"
            for mode, value in summary["energy_j"].items()
        ),
    )
    for mode, share in summary.get("uncarried_share_of_load", {}).items():
        log.info("%-9s     cannot carry %.1f %% of the load by itself", mode, 100 * share)
    continuum = summary.get("continuum")
    if continuum:
        pairs = [("with bending" if summary["bending"] else "without bending", continuum)]
        if "without_bending" in continuum:
            pairs.append(("without bending", continuum["without_bending"]))
        for name, figures_ in pairs:
            log.info(
                "membrane      network %s: displacement differs by %.2f %%, load ratio %.4f, "
                "energy ratio %.4f",
                name,
                100 * figures_["relative_l2_displacement"],
                figures_["load_ratio"],
                figures_["energy_ratio"],
            )
        for rung in continuum.get("ladder", []):
            log.info(
                "  refine %-4d %8d crossovers: displacement differs by %.2f %%, load ratio %.4f",
                rung["refine"],
                rung["crossovers"],
                100 * rung["relative_l2_displacement"],
                rung["load_ratio"],
            )
    peak = summary["peak_mib_per_rank"]
    log.info("memory        %.0f MiB on the largest rank", max(peak))
    log.info("results in    %s", directory)
