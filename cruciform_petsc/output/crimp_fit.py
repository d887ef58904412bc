# SPDX-License-Identifier: MIT
"""Files of a crimp model found from biaxial data: the law to paste, residuals, figures, picture."""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ..calibration.crimp import UNKNOWN, CrimpFit
from ..parallel import on_root
from .pictures import plain_text, save, tension_surface
from .tables import write_csv, write_json, written_whole

if TYPE_CHECKING:
    from mpi4py import MPI

MM = 1e-3
DIGITS = 4  # tensions are not measured to more


def write_crimp(
    comm: MPI.Intracomm, directory: Path, fit: CrimpFit, more: dict[str, Any], picture: bool = True
) -> dict[str, Any]:
    """Write law.toml, calibration.csv, .json and .png into a folder that is there. Collective.

    Returns the summary, with the entries of ``more`` in front.
    """
    columns: dict[str, Any] = {}
    for k, side in enumerate(("warp", "weft")):
        columns[f"{side}_strain_percent"] = 100.0 * fit.points[:, k]
    for k, side in enumerate(("warp", "weft")):
        measured, fitted = 1e-2 * fit.points[:, 2 + k], 1e-2 * fit.fitted[:, k]
        columns[f"{side}_tension_measured_N_per_cm"] = measured
        columns[f"{side}_tension_fit_N_per_cm"] = fitted
        columns[f"{side}_tension_residual_N_per_cm"] = fitted - measured
    write_csv(comm, directory / "calibration.csv", columns)

    def law() -> None:
        with written_whole(directory / "law.toml") as temporary:
            temporary.write_text(law_file(fit), encoding="utf-8")

    on_root(comm, law)
    summary = more | {
        "rms_relative_error": fit.misfit,
        "rms_relative_error_start": fit.start_misfit,
        "points": len(fit.points),
        "evaluations": fit.evaluations,
        "crimp": dict(zip(("warp", "weft"), fit.crimp.crimp.tolist(), strict=True)),
        "standard_errors": fit.errors,
        "not_settled": fit.unknown,
    }
    write_json(comm, directory / "calibration.json", summary)
    if picture:
        drawn = replace(fit.crimp.law, points=fit.points)
        title = plain_text(str(more.get("title", "")))
        way = np.zeros((1, 2))
        save(comm, directory / "calibration.png", partial(tension_surface, drawn, way, title))
    return summary


def law_file(fit: CrimpFit) -> str:
    """Lines for [fabric] of a case file, and what is not known of them."""
    crimp, errors = fit.crimp, fit.errors
    keys = {
        "warp_height": f'"{crimp.height[0] / MM:.{DIGITS}g} mm"',
        "weft_height": f'"{crimp.height[1] / MM:.{DIGITS}g} mm"',
        "warp_stiffness": f'"{crimp.stiffness[0]:.{DIGITS}g} N"',
        "weft_stiffness": f'"{crimp.stiffness[1]:.{DIGITS}g} N"',
        "warp_bending": f'"{1e6 * crimp.bending[0]:.{DIGITS}g} N mm^2"',
        "weft_bending": f'"{1e6 * crimp.bending[1]:.{DIGITS}g} N mm^2"',
    }
    contact = crimp.contact
    if contact.name == "linear":
        keys["crossover_stiffness"] = f'"{contact.stiffness0 * MM:.{DIGITS}g} N/mm"'
    else:
        x = contact.knots[1:]
        pairs = zip(x / MM, contact.evaluate(x)[1], strict=True)
        points = ", ".join(f"[{a:.{DIGITS}g}, {b:.{DIGITS}g}]" for a, b in pairs)
        keys["crossover"] = (
            f'{{ law = "table", distance = "mm", force = "N", points = [{points}] }}'
        )
    lines = [f"# Nearest to {len(fit.points)} points, {100.0 * fit.misfit:.2g} % off (RMS)."]
    for name, error in errors.items():
        told = f"standard error {100.0 * error:.2g} %" if error < UNKNOWN else "not settled"
        lines.append(f"# {name}: {told}")
    table = ", ".join(f"{key} = {value}" for key, value in keys.items())
    return "\n".join([*lines, "[fabric]", f"tension = {{ crimp = {{ {table} }} }}", ""])
