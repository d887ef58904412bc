# SPDX-License-Identifier: MIT
"""The figures of a run, as they go into summary.json."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict
from typing import TYPE_CHECKING, Any

import numpy as np

from ..experiments.result import EFFORT, SHARE
from ..parallel import most, quantile
from ..quantities import EXTENSION, LOAD
from .provenance import provenance

if TYPE_CHECKING:
    from mpi4py import MPI

    from ..case.schema import Case
    from ..equilibrium.stages import Increment
    from ..experiments.result import TestResult

ROUNDING_N = 1e-9  # tensions of yarns below are none


def summarize(case: Case, result: TestResult, statistics: Mapping[str, Any], hanging: int) -> dict:
    """All figures of a test; lists where the case asked for a list. Collective.

    Statistics are those of the network; so many crossovers are hanging that carry nothing.
    """

    def values(column: Any) -> Any:
        plain = [float(value) for value in column]
        return plain if case.test.is_curve else plain[-1]

    curve, experiment = result.curve(states=True), result.experiment
    summary: dict[str, Any] = {
        "title": case.title,
        "kind": case.test.kind,
        "finite": case.test.finite,
        "crossovers": statistics["crossovers"],
        "dofs": result.unknowns or result.unknowns_per_node * statistics["nodes"],
        **{column.lower(): values(curve[column]) for column in experiment.forces},
        "extension_m": values(experiment.extensions(result)),
        "shear_centre_deg": values(curve["shear_centre_deg"]),
        "shear_max_deg": values(curve["shear_max_deg"]),
        "energy_j": {mode: values(curve[f"energy_{mode}_J"]) for mode in experiment.modes},
    }
    for name, column in curve.items():
        if name not in (LOAD.column, EXTENSION.column) and not name.startswith("energy_"):
            summary.setdefault(name.lower(), values(column))
    summary |= experiment.figures(result)
    summary["yarn_tension_max"] = largest_tension(result)
    summary["solver"] = solver_figures(result)
    if result.increments:
        summary["increments"] = increment_rows(result.increments, experiment.forces)
        iterations = [increment.iterations for increment in result.increments]
        summary["newton_iterations_per_increment"] = float(np.mean(iterations))
    if result.buckling is not None:
        summary["stability"] = result.buckling.figures(experiment.column)
    summary |= {
        "network": {**statistics, "hanging_crossovers": hanging},
        "model": experiment.model,
        "bending": case.test.bending,
        "case": case.model_dump(),
        **provenance(result.network.comm),
    }
    if result.uncarried is not None:
        summary["uncarried_share_of_load"] = result.uncarried
    return summary


def summarize_nothing(
    comm: MPI.Intracomm,
    case: Case,
    reason: str,
    increments: Sequence[Increment],
    forces: Sequence[str],
) -> dict[str, Any]:
    """What there is to say of a test that reached none of the values asked for. Collective."""
    return {
        "title": case.title,
        "kind": case.test.kind,
        "finite": case.test.finite,
        "ended_early": reason,
        "increments": increment_rows(increments, forces),
        "case": case.model_dump(),
        **provenance(comm),
    }


def largest_tension(result: TestResult) -> dict[str, Any]:
    """Largest tension of a yarn in the last state, and where (at rest). Collective.

    ``n_99``: on 99 % of the area this family has no larger one. No place if it is that large on
    more than half of the crossovers. Of several places the lowest, whatever the ranks.
    """
    network, fields = result.network, result.fields
    carrying = fields["carrying"]
    place = network.crossover_position[carrying]
    found: dict[str, Any] = {}
    for family in ("warp", "weft"):
        tension = fields[f"{family}_tension"][carrying] / getattr(network.fabric, family).yarns
        largest = most(network.comm, tension)
        if found and largest <= found["n"] * (1.0 + 1e-9):
            continue
        near = tension >= largest - 1e-6 * abs(largest)
        count, of = network.comm.allreduce(np.array([near.sum(), len(near)]))
        own = np.round(1e3 * place[near], 6)
        own = own[np.lexsort(own.T)[:1]]
        there = np.concatenate(network.comm.allgather(own))  # one of each rank
        lowest = there[np.lexsort(there.T)[0]].tolist() if len(there) else None
        on_most = quantile(network.comm, tension, SHARE, result.area_weight[carrying])
        at = lowest if 2 * count <= of else None
        found = {"n": largest, "n_99": on_most, "family": family, "at_mm": at}
    if found["n"] < ROUNDING_N:
        return {"n": 0.0, "n_99": 0.0, "family": "warp", "at_mm": None}
    return found


def solver_figures(result: TestResult) -> dict[str, Any]:
    """How the systems were solved: the linear one, or those of all Newton iterations together."""
    if result.solver is not None:
        figures = asdict(result.solver)
        return {key: figures[key] for key in figures if key not in ("unknowns", "history")}
    return {
        **result.solver_types,
        "newton_iterations": sum(increment.iterations for increment in result.increments),
        "iterations": sum(increment.linear_iterations for increment in result.increments),
    }


def increment_rows(increments: Sequence[Increment], forces: Sequence[str]) -> list[dict[str, Any]]:
    """All accepted increments as plain data, with columns that are forces."""
    return [
        {
            "control": increment.control,
            **{column.lower(): increment.columns[column] for column in forces},
            "shifted": increment.shifted,
            **{name.lower(): getattr(increment, key) for name, key in EFFORT.items()},
        }
        for increment in increments
    ]
