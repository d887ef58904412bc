# SPDX-License-Identifier: MIT
"""Files of a calibration: the law to paste, the curves, the figures and the picture."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from textwrap import wrap
from typing import TYPE_CHECKING, Any

import numpy as np

from ..calibration.load_curve import PLACE
from ..calibration.result import LARGEST_ERROR, Calibration, Comparison, Prediction, rms
from ..cloth.fabric import TORQUE
from ..parallel import on_root
from .pictures import COLOURS, DASHES, figure_of, given, plain_text, save
from .tables import write_csv, write_json, written_whole

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from mpi4py import MPI

    from .pictures import Given

PARTS = ("loads", "residuals", "law")  # of the picture
DIGITS = 4  # of the law; loads are not measured to more
# How matplotlib draws things.
DASHED: dict[str, Any] = {"linestyle": DASHES[1], "linewidth": 1.2, "color": "0.55"}
OTHERWISE: dict[str, Any] = {"linestyle": DASHES[2], "linewidth": 1.2, "color": COLOURS[2]}
MEASURED: dict[str, Any] = {"color": COLOURS[1], "markersize": 4.2, "markerfacecolor": "white"}
NOTE: dict[str, Any] = {"color": "0.38", "fontsize": 8, "ha": "right", "va": "bottom"}


def write(
    comm: MPI.Intracomm,
    directory: Path,
    calibration: Calibration,
    more: dict[str, Any],
    prediction: Prediction | None = None,
    picture: bool = True,
) -> dict[str, Any]:
    """Write law.toml, calibration.csv, .json and .png, and hold_out.csv. Collective.

    Of a calibration, and of the prediction of a specimen held out, into a folder that is there.
    Returns the summary, with the entries of ``more`` in front.
    """
    c = calibration
    number = [i + 1 for i, part in enumerate(c.parts) for _ in c.loads[part]]
    columns = {"curve": number} if len(c.parts) > 1 else {}
    columns |= _columns(c, start_N=c.start_loads, fit_N=c.loads)
    write_csv(comm, directory / "calibration.csv", columns)
    if prediction is not None:
        columns = _columns(prediction, predicted_N=prediction.loads)
        write_csv(comm, directory / "hold_out.csv", columns)

    verdict = c.verdict(prediction)

    def law() -> None:
        with written_whole(directory / "law.toml") as temporary:
            temporary.write_text(law_file(c, verdict), encoding="utf-8")

    on_root(comm, law)
    summary = more | {"verdict": verdict} | _summary(c)
    write_json(comm, directory / "calibration.json", summary)
    if picture:
        save(comm, directory / "calibration.png", figure, c, str(more.get("title", "")))
    return summary


def _columns(c: Comparison, **loads: np.ndarray) -> dict[str, Any]:
    return {
        "displacement_mm": 1e3 * c.curve.displacement,
        "measured_N": c.curve.force,
        **loads,
        "relative_residual": c.residuals,
        "shear_max_deg": np.rad2deg(c.reached),
    }


def write_so_far(
    comm: MPI.Intracomm, directory: Path, angles: np.ndarray, values: np.ndarray, step: str
) -> None:
    """Write law.toml after a step, for whom it is interrupted. Collective."""

    def law() -> None:
        with written_whole(directory / "law.toml") as temporary:
            comment = f"# Not finished: the law after {step}."
            lines = [comment, "[fabric]", law_line(angles, values), ""]
            temporary.write_text("\n".join(lines), encoding="utf-8")

    on_root(comm, law)


def law_line(angles: np.ndarray, values: np.ndarray) -> str:
    """The line ``shear = { law = "table", ... }`` for a case file, of rad and N/m."""
    points = zip(np.rad2deg(angles), 1e-3 * values, strict=True)
    pairs = [f"[{angle:.6g}, {value:.{DIGITS}g}]" for angle, value in ((0.0, 0.0), *points)]
    return (
        f'shear = {{ law = "table", quantity = "{TORQUE}", angle = "deg", force = "N/mm", '
        f"points = [{', '.join(pairs)}] }}"
    )


def law_file(calibration: Calibration, verdict: str) -> str:
    """The text of law.toml."""
    d = calibration.curve.displacement
    remarks = [
        f"May be used: {verdict}.",
        f"Identified from {len(d)} loads between {1e3 * d.min():.4g} and {1e3 * d.max():.4g} mm, "
        f"RMS of the relative error {100 * calibration.rms:.2f} %.",
        *calibration.remarks(),
    ]
    comments = [f"# {line}" for remark in remarks for line in wrap(remark, 98)]
    return "\n".join([*comments, "[fabric]", law_line(calibration.angles, calibration.values), ""])


def _compared(c: Comparison) -> dict[str, Any]:
    """Plain numbers that a calibration and a prediction have in common."""
    return {
        "rms_relative_error": c.rms,
        "largest_relative_error": float(np.abs(c.residuals).max()),
        "points": len(c.loads),
        "displacement_m": c.curve.displacement,
        "measured_n": c.curve.force,
        "load_n": c.loads,
        "shear_reached_deg": np.rad2deg(c.reached),
    }


def _summary(c: Calibration) -> dict[str, Any]:
    """Plain numbers for calibration.json."""
    parameters = {
        "angle_deg": np.rad2deg(c.angles),
        "force_n_per_mm": 1e-3 * c.values,
        "standard_error_n_per_mm": 1e-3 * c.standard_errors,
        "relative_standard_error": c.estimate.errors,
        "determined": c.determined,
        "depends_on_assumptions": c.dependent,
    }
    rows = zip(*(column.tolist() for column in parameters.values()), strict=True)
    return {
        **_compared(c),
        "rms_relative_error_start": c.start_rms,
        "rows_measured": c.curve.rows,
        "start_n": c.start_loads,
        "start_from": c.start_from,
        "curves": [
            {
                "kind": s.kind,
                "weight": s.weight,
                "points": len(s.curve.force),
                "rms_relative_error": rms(c.residuals[part]),
            }
            for s, part in zip(c.specimens, c.parts, strict=True)
        ],
        "parameters": [dict(zip(parameters, row, strict=True)) for row in rows],
        "undetermined_deg": np.rad2deg(c.uncertain_ranges()),
        "largest_relative_standard_error_allowed": LARGEST_ERROR,
        "noise_assumed": c.estimate.noise,
        "other_assumptions": {
            name.replace(" ", "_"): {
                "relative_change_of_loads": a.loads,
                "relative_change_of_law": a.values,
            }
            for name, a in c.assumptions.items()
        },
        "singular_values": c.estimate.singular_values,
        "effective_parameters": c.estimate.settled,
        "smoothing": c.smoothing,
        "iterations": c.iterations,
        "evaluations": c.evaluations,
        "newton_steps": c.newton_steps,
        "ended_because": c.message,
        "seconds": c.seconds,
        "remarks": c.remarks(),
        "law": law_line(c.angles, c.values),
    }


def hold_out_summary(prediction: Prediction) -> dict[str, Any]:
    """Plain numbers of a prediction for calibration.json."""
    return {
        **_compared(prediction),
        "mean_relative_error": float(prediction.residuals.mean()),
        "points_extrapolated": int(prediction.extrapolated.sum()),
        "rms_relative_error_not_extrapolated": prediction.rms_known,
        "law_known_to_deg": float(np.rad2deg(prediction.known_to)),
        "remarks": prediction.remarks(),
    }


def figure(
    calibration: Calibration,
    title: str = "",
    parts: Sequence[str] = PARTS,
    ax: Given = None,
) -> Figure:
    """Draw the load curves, the residuals, the law, or those of them that are ``parts``.

    See pictures.py of ``ax``.
    """
    chart: Any
    if ax is not None:
        every = given(ax, len(parts))
        chart = every[0].figure
    elif len(parts) == 1:
        chart = figure_of(figsize=(5.4, 3.7), layout="constrained")
        every = [chart.add_subplot()]
    else:
        chart = figure_of(figsize=(9.6, 4.4), layout="constrained")
        grid = chart.add_gridspec(2, 2, height_ratios=(2.6, 1.0))
        curves = chart.add_subplot(grid[0, 0])
        every = [
            curves,
            chart.add_subplot(grid[1, 0], sharex=curves),
            chart.add_subplot(grid[:, 1]),
        ]
    draw = {"loads": _draw_curves, "residuals": _draw_residuals, "law": _draw_law}
    for axes, part in zip(every, parts, strict=True):
        draw[part](axes, calibration)
    if ax is None and len(parts) > 1:
        every[0].label_outer()  # the residuals are below the loads
    if title and ax is None:
        chart.suptitle(plain_text(title), fontsize=10.5)
    return chart


def _draw_curves(axes: Axes, c: Calibration) -> None:
    d, f = 1e3 * c.curve.displacement, c.curve.force
    start = f"start from the {c.start_from} (RMS error {100 * c.start_rms:.1f} %)"
    fit = f"network with the identified law ({100 * c.rms:.1f} %)"
    data = f"measured (averages of {c.curve.rows} rows)" if len(d) < c.curve.rows else "measured"
    for part in c.parts:
        line, fitted = (np.append(0.0, loads[part]) for loads in (c.start_loads, c.loads))
        axes.plot(np.append(0.0, d[part]), line, label=start, **DASHED)
        axes.plot(np.append(0.0, d[part]), fitted, color=COLOURS[0], label=fit)
        axes.plot(d[part], f[part], "o", label=data, zorder=5, **MEASURED)
        start = fit = data = "_"  # in the legend once
    axes.set(xlabel="displacement (mm)", ylabel="load (N)")
    axes.set(xlim=(0.0, 1.03 * d.max()), ylim=(0.0, None))
    axes.legend(loc="upper left")
    axes.set_title("Load curve", loc="left")


def _draw_residuals(axes: Axes, c: Calibration) -> None:
    d, error, band = 1e3 * c.curve.displacement, 100.0 * c.residuals, 100.0 * c.rms
    axes.axhspan(-band, band, color="0.9", linewidth=0)
    axes.axhline(0.0, color="0.5", linewidth=0.7)
    axes.vlines(d, 0.0, error, color=COLOURS[0], linewidth=1.2)
    axes.plot(d, error, "o", color=COLOURS[0], markersize=3.5)
    most = 1.25 * max(float(np.abs(error).max()), band)
    axes.set(xlabel="displacement (mm)", ylabel="error (%)", ylim=(-most, most))
    axes.text(0.99, 0.06, "grey: RMS", transform=axes.transAxes, **NOTE)


def _draw_law(axes: Axes, c: Calibration) -> None:
    """In degrees and N/mm."""
    knots, values = np.append(0.0, np.rad2deg(c.angles)), np.append(0.0, 1e-3 * c.values)
    errors = np.append(0.0, 1e-3 * c.standard_errors)
    reached = float(np.rad2deg(c.reached.max()))
    end = 1.08 * max(reached, knots[-1])
    angle = np.linspace(0.0, end, 400)
    law, start = (1e-3 * each.evaluate(np.deg2rad(angle))[1] for each in (c.law, c.start_law))
    inside, blue = angle <= knots[-1], COLOURS[0]
    error = np.interp(angle, knots, errors)
    band = angle[inside], (law - error)[inside], (law + error)[inside]
    axes.fill_between(*band, color=blue, alpha=0.22, linewidth=0, label="± standard error")
    top = 1.22 * max(band[2].max(), start[angle <= reached].max())
    axes.plot(angle, start, label=f"start: {c.start_from}", **DASHED)
    axes.plot(angle[inside], law[inside], color=blue, label="identified law")
    axes.plot(angle[~inside], law[~inside], color=blue, linestyle=":")
    if PLACE in c.assumptions:
        moved = values * np.append(1.0, 1.0 + c.assumptions[PLACE].values)
        top = max(top, 1.25 * moved.max())
        axes.plot(knots, moved, label="if the yarns lay half a cell away", **OTHERWISE)
    for which, face in ((c.determined, blue), (~c.determined, "white")):
        dots = knots[1:][which], values[1:][which]
        axes.plot(*dots, "o", color=blue, markersize=4, markerfacecolor=face)
    dependent = f"depends on assumptions by over {100 * LARGEST_ERROR:.0f} %"
    _shade(axes, c.ranges(c.dependent), end, dependent, color=COLOURS[5], alpha=0.12)
    unknown = f"not determined (standard error above {100 * LARGEST_ERROR:.0f} %)"
    unknown = "extrapolated" if c.determined.all() else unknown
    hatch = {"facecolor": "none", "edgecolor": "0.8", "hatch": "////"}
    _shade(axes, c.uncertain_ranges(), end, unknown, **hatch)
    axes.axvline(reached, color="0.4", linewidth=0.8)
    axes.text(reached - 0.008 * end, 0.02 * top, "reached", rotation=90, **NOTE)
    axes.set(xlabel="shear angle (°)", ylabel="torque per area $\\psi'$ (N/mm)")
    axes.set(xlim=(0.0, end), ylim=(0.0, top))
    axes.legend(loc="upper left")
    axes.set_title("Shear law", loc="left")


def _shade(axes: Axes, ranges: list, end: float, label: str, **style: Any) -> None:
    """Shade ranges of angles, rad, up to ``end``, degrees."""
    for low, high in np.rad2deg(ranges):
        axes.axvspan(low, min(high, end), linewidth=0, zorder=0, label=label, **style)
        label = "_"
