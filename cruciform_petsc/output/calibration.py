# SPDX-License-Identifier: MIT
"""Files of a calibration: the law to paste, the curves, the figures and the picture."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ..calibration.load_curve import PLACE
from ..calibration.result import LARGEST_ERROR, Calibration, Prediction
from ..parallel import on_root
from .pictures import COLOURS, DASHES, STYLE
from .tables import write_csv, write_json, written_whole

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from mpi4py import MPI

DIGITS = 4  # of the law; loads are not measured to more


def points(calibration: Calibration) -> list[list[float]]:
    """The table as pairs of degrees and N/mm, rounded, beginning with [0, 0]."""
    return [[0.0, 0.0]] + [
        [float(f"{np.rad2deg(angle):.6g}"), float(f"{1e-3 * value:.{DIGITS}g}")]
        for angle, value in zip(calibration.angles, calibration.values, strict=True)
    ]


def law_line(calibration: Calibration) -> str:
    """The line ``shear = { law = "table", ... }`` for a case file."""
    pairs = ", ".join(f"[{angle:g}, {value:.{DIGITS}g}]" for angle, value in points(calibration))
    return f'shear = {{ law = "table", angle = "deg", force = "N/mm", points = [{pairs}] }}'


def law_file(calibration: Calibration) -> str:
    """The text of law.toml."""
    d = calibration.curve.displacement
    remarks = [
        f"Identified from {len(d)} loads between {1e3 * d.min():.4g} and {1e3 * d.max():.4g} mm, "
        f"RMS of the relative error {100 * calibration.rms:.2f} %.",
        *calibration.remarks(),
    ]
    comments = [f"# {text}" for remark in remarks for text in _wrapped(remark)]
    return "\n".join([*comments, "[fabric]", law_line(calibration), ""])


def summary(calibration: Calibration) -> dict[str, Any]:
    """Plain numbers for calibration.json."""
    c = calibration
    return {
        "rms_relative_error": c.rms,
        "rms_relative_error_start": c.start_rms,
        "largest_relative_error": float(np.abs(c.residuals).max()),
        "points": len(c.curve.force),
        "rows_measured": c.curve.rows,
        "displacement_m": c.curve.displacement,
        "measured_n": c.curve.force,
        "start_n": c.start_loads,
        "load_n": c.loads,
        "start_from": c.start_from,
        "curves": [
            {
                "kind": s.kind,
                "weight": s.weight,
                "points": len(s.curve.force),
                "rms_relative_error": float(np.sqrt(np.mean(c.residuals[part] ** 2))),
            }
            for s, part in zip(c.specimens, c.parts, strict=False)
        ],
        "parameters": [
            {
                "angle_deg": float(np.rad2deg(angle)),
                "force_n_per_mm": 1e-3 * value,
                "standard_error_n_per_mm": 1e-3 * error,
                "relative_standard_error": error / value,
                "determined": bool(known),
                "depends_on_assumptions": bool(depends),
            }
            for angle, value, error, known, depends in zip(
                c.angles, c.values, c.standard_errors, c.determined, c.dependent, strict=True
            )
        ],
        "undetermined_deg": [
            [float(np.rad2deg(low)), float(np.rad2deg(high)) if np.isfinite(high) else None]
            for low, high in c.uncertain_ranges()
        ],
        "largest_relative_standard_error_allowed": LARGEST_ERROR,
        "shear_reached_deg": np.rad2deg(c.reached),
        "noise_assumed": c.noise,
        "other_assumptions": {
            name.replace(" ", "_"): {
                "relative_change_of_loads": a.loads,
                "relative_change_of_law": a.values,
            }
            for name, a in c.assumptions.items()
        },
        "singular_values": c.singular_values,
        "effective_parameters": c.effective_parameters,
        "smoothing": c.smoothing,
        "iterations": c.iterations,
        "evaluations": c.evaluations,
        "newton_steps": c.newton_steps,
        "ended_because": c.message,
        "seconds": c.seconds,
        "remarks": c.remarks(),
        "law": law_line(c),
    }


def write(
    comm: MPI.Intracomm, directory: Path, calibration: Calibration, more: dict[str, Any],
    picture: bool = True,
) -> dict[str, Any]:  # fmt: skip
    """Write law.toml, calibration.csv, calibration.json and calibration.png. Collective.

    Parameters
    ----------
    comm : mpi4py communicator
    directory : Path
        Is there.
    calibration : Calibration
        The same on every rank.
    more : dict
        Entries for the front of the summary.
    picture : bool

    Returns
    -------
    dict
        The summary.
    """
    c = calibration
    number = np.concatenate([
        np.full(part.stop - part.start, i + 1) for i, part in enumerate(c.parts)
    ])  # fmt: skip
    write_csv(
        comm, directory / "calibration.csv",
        ({"curve": number} if len(c.parts) > 1 else {}) | {
            "displacement_mm": 1e3 * c.curve.displacement,
            "measured_N": c.curve.force,
            "start_N": c.start_loads,
            "fit_N": c.loads,
            "relative_residual": c.residuals,
            "shear_max_deg": np.rad2deg(c.reached),
        },
    )  # fmt: skip

    def law() -> None:
        with written_whole(directory / "law.toml") as temporary:
            temporary.write_text(law_file(c), encoding="utf-8")

    on_root(comm, law)
    told = more | summary(c)
    write_json(comm, directory / "calibration.json", told)
    if picture:
        draw(comm, directory / "calibration.png", c, str(more.get("title", "")))
    return told


def hold_out_summary(prediction: Prediction) -> dict[str, Any]:
    """Plain numbers of a prediction for calibration.json."""
    p = prediction
    return {
        "rms_relative_error": p.rms,
        "largest_relative_error": float(np.abs(p.residuals).max()),
        "mean_relative_error": float(p.residuals.mean()),
        "points": len(p.loads),
        "points_extrapolated": int(p.extrapolated.sum()),
        "rms_relative_error_not_extrapolated": None if np.isnan(p.rms_known) else p.rms_known,
        "law_known_to_deg": float(np.rad2deg(p.known_to)),
        "displacement_m": p.curve.displacement,
        "measured_n": p.curve.force,
        "load_n": p.loads,
        "shear_reached_deg": np.rad2deg(p.angles),
    }


def write_hold_out(comm: MPI.Intracomm, directory: Path, prediction: Prediction) -> None:
    """Write hold_out.csv: measured and predicted curve of the other specimen. Collective."""
    p = prediction
    write_csv(
        comm, directory / "hold_out.csv",
        {
            "displacement_mm": 1e3 * p.curve.displacement,
            "measured_N": p.curve.force,
            "predicted_N": p.loads,
            "relative_residual": p.residuals,
            "shear_max_deg": np.rad2deg(p.angles),
        },
    )  # fmt: skip


def draw(comm: MPI.Intracomm, path: str | Path, calibration: Calibration, title: str = "") -> None:
    """Draw data, start, fit and residual, and the law with its uncertain parts. Collective."""

    def save() -> None:
        from matplotlib import rc_context

        with rc_context(STYLE), written_whole(path) as temporary:
            figure = _figure(calibration, title)
            figure.savefig(temporary, format="png", bbox_inches="tight", pad_inches=0.08)

    on_root(comm, save)


def _figure(c: Calibration, title: str) -> Figure:
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(9.6, 4.4), layout="constrained")
    FigureCanvasAgg(figure)
    grid = figure.add_gridspec(2, 2, height_ratios=(2.6, 1.0))
    curves = figure.add_subplot(grid[0, 0])
    residual = figure.add_subplot(grid[1, 0], sharex=curves)
    law = figure.add_subplot(grid[:, 1])
    _draw_curves(curves, residual, c)
    _draw_law(law, c)
    if title:
        figure.suptitle(title, fontsize=10.5)
    return figure


def _draw_curves(curves: Axes, residual: Axes, c: Calibration) -> None:
    d = 1e3 * c.curve.displacement
    many = len(d) < c.curve.rows
    labels = (
        f"start from the {c.start_from} (RMS error {100 * c.start_rms:.1f} %)",
        f"network with the identified law ({100 * c.rms:.1f} %)",
        f"measured (averages of {c.curve.rows} rows)" if many else "measured",
    )
    for part in c.parts:
        through = np.append(0.0, d[part])
        curves.plot(
            through, np.append(0.0, c.start_loads[part]), color="0.55", linestyle=(0, (5, 2)),
            linewidth=1.2, label=labels[0],
        )  # fmt: skip
        curves.plot(through, np.append(0.0, c.loads[part]), color=COLOURS[0], label=labels[1])
        curves.plot(
            d[part], c.curve.force[part], "o", color=COLOURS[1], markersize=4.2,
            markerfacecolor="white", label=labels[2], zorder=5,
        )  # fmt: skip
        labels = ("_", "_", "_")
    curves.set(ylabel="load (N)", xlim=(0.0, 1.03 * d.max()), ylim=(0.0, None))
    curves.tick_params(labelbottom=False)
    curves.legend(frameon=False, loc="upper left")
    curves.set_title("Load curve", loc="left")
    error = 100.0 * c.residuals
    residual.axhspan(-100 * c.rms, 100 * c.rms, color="0.9", linewidth=0)
    residual.axhline(0.0, color="0.5", linewidth=0.7)
    residual.vlines(d, 0.0, error, color=COLOURS[0], linewidth=1.2)
    residual.plot(d, error, "o", color=COLOURS[0], markersize=3.5)
    most = 1.25 * max(float(np.abs(error).max()), 100.0 * c.rms)
    residual.set(xlabel="displacement (mm)", ylabel="error (%)", ylim=(-most, most))
    residual.text(
        0.99, 0.06, "grey: RMS", transform=residual.transAxes, ha="right", color="0.4", fontsize=8
    )


def _draw_law(axes: Axes, c: Calibration) -> None:
    degrees = np.rad2deg
    reached, end = float(c.reached.max()), 1.08 * max(float(c.reached.max()), float(c.angles[-1]))
    angle = np.linspace(0.0, end, 400)
    values = 1e-3 * c.law.evaluate(angle)[1]
    knots = np.concatenate([[0.0], c.angles])
    error = 1e-3 * np.interp(angle, knots, np.concatenate([[0.0], c.standard_errors]))
    inside = angle <= c.angles[-1]
    axes.fill_between(
        degrees(angle[inside]), (values - error)[inside], (values + error)[inside],
        color=COLOURS[0], alpha=0.22, linewidth=0, label="± standard error",
    )  # fmt: skip
    start = 1e-3 * c.start_law.evaluate(angle)[1]
    top = 1.22 * max((values + error)[inside].max(), start[angle <= reached].max())
    axes.plot(
        degrees(angle), start, color="0.55", linestyle=(0, (5, 2)), linewidth=1.2,
        label=f"start: {c.start_from}",
    )  # fmt: skip
    axes.plot(degrees(angle[inside]), values[inside], color=COLOURS[0], label="identified law")
    if PLACE in c.assumptions:
        moved = 1e-3 * c.values * (1.0 + c.assumptions[PLACE].values)
        top = max(top, 1.25 * moved.max())
        axes.plot(
            degrees(knots), np.append(0.0, moved), color=COLOURS[2], linestyle=DASHES[2],
            linewidth=1.2, label="if the yarns lay half a cell away",
        )  # fmt: skip
    beyond = angle >= c.angles[-1]
    axes.plot(degrees(angle[beyond]), values[beyond], color=COLOURS[0], linestyle=":")
    known = c.determined
    axes.plot(degrees(c.angles[known]), 1e-3 * c.values[known], "o", color=COLOURS[0], markersize=4)
    axes.plot(
        degrees(c.angles[~known]), 1e-3 * c.values[~known], "o", color=COLOURS[0], markersize=4,
        markerfacecolor="white",
    )  # fmt: skip
    label = f"depends on assumptions by over {100 * LARGEST_ERROR:.0f} %"
    for low, high in c.ranges(c.dependent):
        axes.axvspan(
            degrees(low), degrees(min(high, end)), color=COLOURS[5], alpha=0.12, linewidth=0,
            zorder=0, label=label,
        )  # fmt: skip
        label = "_"
    label = f"not determined (standard error above {100 * LARGEST_ERROR:.0f} %)"
    label = label if not known.all() else "extrapolated"
    for low, high in c.uncertain_ranges():
        axes.axvspan(
            degrees(low), degrees(min(high, end)), facecolor="none", edgecolor="0.8", hatch="////",
            linewidth=0, zorder=0, label=label,
        )  # fmt: skip
        label = "_"
    axes.axvline(degrees(reached), color="0.4", linewidth=0.8)
    axes.text(
        degrees(reached) - 0.008 * degrees(end), 0.02 * top, "reached", rotation=90, ha="right",
        va="bottom", color="0.35", fontsize=8,
    )  # fmt: skip
    axes.set(
        xlabel="shear angle (°)", ylabel="torque per area $\\psi'$ (N/mm)",
        xlim=(0.0, degrees(end)),
        ylim=(0.0, top),
    )  # fmt: skip
    axes.legend(frameon=False, loc="upper left")
    axes.set_title("Shear law", loc="left")


def _wrapped(text: str) -> list[str]:
    from textwrap import wrap

    return wrap(text, 98)
