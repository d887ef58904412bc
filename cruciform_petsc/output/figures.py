# SPDX-License-Identifier: MIT
"""Which pictures a bias-extension run makes, from its result; pictures.py draws them."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from . import pictures
from .sample import YarnSample, sample_map, sample_yarns

if TYPE_CHECKING:
    from ..continuum.membrane import MembraneResult
    from ..experiments.result import TestResult


def draw_all(
    directory: Path,
    result: TestResult,
    without: TestResult | None,
    membrane: MembraneResult | None,
    summary: dict[str, Any],
) -> None:
    """Draw every picture of a run into a folder. Collective.

    Parameters
    ----------
    directory : Path
    result : TestResult
    without : TestResult, optional
        The same without yarn bending.
    membrane : MembraneResult, optional
    summary : dict
        The run's summary; its ladder is drawn if it has one.
    """
    comm, title = result.network.comm, summary["title"]
    curve = result.curve()
    sample = draw_yarns(directory / "yarns.png", result, title)
    pictures.shear_against_load(
        comm,
        directory / "shear_against_load.png",
        curve["load_N"],
        curve["shear_centre_deg"],
        curve["shear_max_deg"],
        title=title,
    )
    pictures.load_against_extension(
        comm,
        directory / "load_against_extension.png",
        curve["extension_mm"],
        curve["load_N"],
        title=title,
    )
    if without is not None:
        pictures.with_and_without_bending(
            comm,
            directory / "with_and_without_bending.png",
            _yarns(without),
            sample,
            clamps=_clamps(result),
        )
    _draw_centre_line(directory / "centre_line.png", result, without, membrane, title)
    _draw_maps(directory / "shear_map.png", result, membrane, title)
    ladder = summary.get("continuum", {}).get("ladder")
    if ladder:
        pictures.convergence(
            comm,
            directory / "ladder.png",
            [rung["crossovers"] for rung in ladder],
            {
                "displacement at the crossovers": [r["relative_l2_displacement"] for r in ladder],
                "load": [abs(rung["load_ratio"] - 1.0) for rung in ladder],
            },
            ylabel="relative difference to the membrane",
            title=title,
        )


def draw_yarns(path: str | Path, result: TestResult, title: str = "") -> YarnSample | None:
    """Draw the yarns before and after; returns what was drawn (rank 0). Collective."""
    sample = _yarns(result)
    pictures.yarns_before_and_after(
        result.network.comm, path, sample, title, clamps=_clamps(result)
    )
    return sample


def _yarns(result: TestResult) -> YarnSample | None:
    return sample_yarns(result.network, result.node_displacement, result.fields)


def _clamps(result: TestResult) -> list:
    """Edges with their motion: the lower one, and the upper one if it is gripped."""
    preform = result.network.preform
    clamps = [(preform.edge("lower"), (0.0, 0.0))]
    if result.experiment.upper == "grip":
        clamps.append((preform.edge("upper"), (0.0, result.extension)))
    return clamps


def _draw_centre_line(path, result, without, membrane, title) -> None:
    curves = {}
    name = "network, with yarn bending" if result.experiment.bending else "network"
    named = [(name, result, None), ("network, without yarn bending", without, None)]
    if membrane is not None:
        angle = membrane.evaluate(result.network.crossover_position)["shear_angle"]
        named.append(("membrane", result, angle))
    for label, source, angle in named:
        if source is not None:
            line = source.centre_line(angle)
            curves[label] = (1e3 * line.distance, np.rad2deg(line.shear_angle))
    pictures.shear_along_centre_line(result.network.comm, path, curves, title=title)


def _draw_maps(path, result, membrane, title) -> None:
    network = result.network
    shear = np.where(result.fields["carrying"], np.rad2deg(result.fields["shear_angle"]), np.nan)
    values = {"network": shear}
    if membrane is not None:
        angle = membrane.evaluate(network.crossover_position)["shear_angle"]
        values["membrane"] = np.rad2deg(angle)
    pictures.shear_maps(network.comm, path, sample_map(network, values), tuple(values), title)
