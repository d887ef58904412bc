# SPDX-License-Identifier: MIT
"""Which pictures a run makes, from its result and its kind of test; pictures.py draws them."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ..elements.kinematics import net_angle
from ..quantities import force_unit, quantity
from ..small.network import MODES
from . import pictures
from . import scene as scenes
from .pictures import ROUNDING_DEG
from .sample import YarnSample, sample_map, sample_yarns
from .summary import ROUNDING_N

if TYPE_CHECKING:
    from ..calibration.curve import MeasuredCurve
    from ..experiments.result import State, TestResult
    from ..net.network import Network

EDGES = {
    "biaxial": ("lower", "upper", "left", "right"),
    "picture-frame": ("lower", "upper", "left", "right"),
    "cantilever": ("lower",),
}
STAGES = 4  # states side by side


def draw_all(
    directory: Path,
    result: TestResult,
    without: TestResult | None,
    membranes: Sequence[Any],
    summary: dict[str, Any],
    measured: MeasuredCurve | None = None,
) -> list[str]:
    """Draw every picture of a run into a folder; returns their names. Collective.

    Parameters
    ----------
    directory : Path
    result : TestResult
    without : TestResult, optional
        The same without yarn bending.
    membranes : sequence of MembraneResult or HyperelasticResult
        For each state, or (small displacements) for the last one; may be empty.
    summary : dict
        The run's summary; its ladder is drawn if it has one.
    measured : MeasuredCurve, optional
        To be drawn over the load curve.

    Returns
    -------
    list of str
        Names of the files, in an order to read them in.
    """
    comm, title = result.network.comm, plain_text(summary["title"])
    experiment = result.experiment
    membrane = membranes[-1] if len(membranes) else None
    drawn: list[str] = []

    def file(name: str) -> Path:
        drawn.append(name)
        return directory / name

    sample = draw_yarns(file("yarns.png"), result, title)
    # A biaxial test is uniform: there is nothing to see but its curve.
    if len(result.states) > 1 and experiment.finite and experiment.kind != "biaxial":
        draw_stages(file("stages.png"), result, title)
    _draw_loads(file, result, membranes, title, measured)
    if experiment.finite:
        _draw_energies(file("energy.png"), result, title)
    if experiment.has_zones:
        curve = result.curve()
        if experiment.finite:
            _draw_zones(file("zones.png"), result, curve, title)
        else:
            pictures.shear_against_load(
                comm,
                file("shear_against_load.png"),
                curve["load_N"] / force_unit(result.loads)[1],
                curve["shear_centre_deg"],
                curve["shear_max_deg"],
                xlabel=f"load ({force_unit(result.loads)[0]})",
                title=title,
            )
        _draw_centre_line(file("centre_line.png"), result, without, membrane, title)
    shear, tensions = _shear_values(result, membrane), _tension_values(result)
    uniform = summary.setdefault("uniform_maps", {})
    told = _uniform(comm, "Shear angle", shear, ROUNDING_DEG, "\N{DEGREE SIGN}")
    if told is None:
        sample_ = sample_map(result.network, shear)
        pictures.shear_maps(comm, file("shear_map.png"), sample_, tuple(shear), title)
    else:
        uniform["shear_map.png"] = told
    told = _uniform(comm, "Tension", tensions, ROUNDING_N, " N per yarn")
    if told is None:
        sample_ = sample_map(result.network, tensions)
        pictures.tension_maps(comm, file("tension_map.png"), sample_, title)
    else:
        uniform["tension_map.png"] = told
    if without is not None:
        pictures.with_and_without_bending(
            comm,
            file("with_and_without_bending.png"),
            _yarns(without),
            sample,
            clamps=_clamps(result, result.states[-1]),
        )
    ladder = summary.get("continuum", {}).get("ladder")
    if ladder:
        pictures.convergence(
            comm,
            file("ladder.png"),
            [rung["crossovers"] for rung in ladder],
            {
                "displacement at the crossovers": [r["relative_l2_displacement"] for r in ladder],
                "load": [abs(rung["load_ratio"] - 1.0) for rung in ladder],
            },
            ylabel="relative difference to the membrane",
            title=title,
        )
    return drawn


def plain_text(text: str) -> str:
    """A text that matplotlib writes as it is: a dollar does not begin a formula."""
    return text.replace("$", r"\$")


def draw_yarns(path: str | Path, result: TestResult, title: str = "") -> YarnSample | None:
    """Draw the yarns before and after; returns what was drawn (rank 0). Collective.

    Coloured by shear angle, of which a biaxial test has none: by the yarns' tension there.
    """
    comm, clamps = result.network.comm, _clamps(result, result.states[-1])
    values, label = None, pictures.ANGLE_LABEL
    if result.experiment.kind == "biaxial":
        values, label = tuple(_tension_values(result).values()), "tension (N per yarn)"
    sample = _yarns(result, values)
    pictures.yarns_before_and_after(comm, path, sample, title, clamps=clamps, label=label)
    return sample


def plot(result: TestResult, path: str | Path) -> None:
    """Draw the yarns before and after, coloured by shear angle, as a PNG. Collective."""
    draw_yarns(path, result)


def scene(result: TestResult, path: str | Path) -> None:
    """Draw the woven yarns in space, coloured by shear angle, as a PNG. Collective."""
    draw_scene(path, result)


def draw_stages(path: str | Path, result: TestResult, title: str = "") -> None:
    """Draw up to four states side by side, in true scale and with one colour scale. Collective."""
    count = min(STAGES, len(result.states))
    chosen = np.unique(np.linspace(0, len(result.states) - 1, count).round().astype(int))
    panels = []
    for state in (result.states[i] for i in chosen):
        name = result.experiment.column.text(state.control).replace(" deg", "°")
        load = "" if result.experiment.control == "load" else f"\n{state.load:.3g} N"
        sample = sample_yarns(result.network, state.node_displacement, state.fields)
        panels.append((name + load, sample, _clamps(result, state)))
    pictures.stages(result.network.comm, path, panels, title)


def draw_scene(path: str | Path, result: TestResult, title: str = "") -> None:
    """Draw the yarns of the last state in space, woven. Collective."""
    network = result.network
    scenes.woven(
        network.comm,
        path,
        _yarns(result),
        to_lattice(network),
        network.fabric.thickness,
        title,
        clamps=_clamps(result, result.states[-1]),
    )


def to_lattice(network: Network) -> np.ndarray:
    """Return what takes a point at rest, (x, y, 1) in metres, to its place (i, j); (2, 3)."""
    turned = network.preform.rotation / network.pitch[:, None]
    return np.column_stack([turned, -turned @ network.preform.lattice_origin])


def _yarns(result: TestResult, values: Sequence[np.ndarray] | None = None) -> YarnSample | None:
    return sample_yarns(result.network, result.node_displacement, result.fields, values=values)


def _clamps(result: TestResult, state: State) -> list:
    """Gripped edges, each with how far its corners have moved in a state."""
    experiment, preform = result.experiment, result.network.preform
    edges = EDGES.get(experiment.kind, ("lower", "upper"))
    if getattr(experiment, "upper", "grip") == "centre-line":
        edges = ("lower",)
    if getattr(experiment, "ends", "grip") == "free":
        edges = ()
    clamps = []
    for edge in edges:
        segments = preform.edge(edge)
        if experiment.finite:
            gradient, shift = experiment.motion(edge, state.control)
            moved = segments @ gradient.T + shift - segments
        else:  # the tangent at rest
            ahead, behind = (experiment.motion(edge, sign * 1e-6) for sign in (1.0, -1.0))
            gradient, shift = (
                0.5e6 * state.control * (a - b) for a, b in zip(ahead, behind, strict=True)
            )
            moved = segments @ gradient.T + shift
        clamps.append((segments, moved))
    return clamps


def _path(result: TestResult) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Control (in the axis' unit), load (N) and energies (J; (n, 3)) all along the test."""
    size = result.experiment.column[1]
    if result.experiment.control == "load":
        size = force_unit(result.loads)[1]
    if result.experiment.finite and result.increments:
        control = [increment.control for increment in result.increments]
        load = [increment.load for increment in result.increments]
        energies = [increment.energies for increment in result.increments]
        return np.array(control) / size, np.array(load), np.array(energies)
    energies_ = np.column_stack([result.energies()[mode] for mode in MODES])
    return result.controls / size, result.loads, energies_


def _axis_label(result: TestResult) -> str:
    column = result.experiment.column
    if column.unit == "N":
        return f"{column.label} ({force_unit(result.loads)[0]})"
    return column.axis


def _draw_loads(file, result: TestResult, membranes, title: str, measured) -> None:
    """The load, or what stands for it, against the control."""
    comm, experiment = result.network.comm, result.experiment
    control, load, _ = _path(result)
    unit, newton = force_unit(load)
    asked = result.controls / experiment.column[1]
    if experiment.kind == "biaxial":
        curve = result.curve()
        curves = {
            f"{name}, strain {ratio:.3g} of the warp's" if name == "weft" else name: (
                asked, curve[f"tension_{name}_N_per_cm"]
            )
            for name, ratio in (("warp", 1.0), ("weft", experiment.ratio))  # type: ignore[attr-defined]
        }  # fmt: skip
        pictures.curves(
            comm, file("tension_against_strain.png"), curves,
            (experiment.column.axis, "tension (N/cm)"), title,
        )  # fmt: skip
    elif experiment.kind == "cantilever":
        curve = result.curve()
        curves = {
            "across": (curve["tip_across_mm"], curve["load_N"] / newton),
            "along, towards the clamp": (-curve["tip_along_mm"], curve["load_N"] / newton),
        }
        if measured is not None:
            curves["measured, across"] = (1e3 * measured.displacement, measured.force / newton)
        pictures.curves(
            comm, file("load_against_deflection.png"), curves,
            (quantity("tip_across_mm").axis, f"load ({unit})"), title,
        )  # fmt: skip
    else:
        others = {}
        if len(membranes) == len(asked):
            others["membrane"] = (asked, np.array([m.load for m in membranes]) / newton)
        if measured is not None and experiment.unit == "m":
            others["measured"] = (1e3 * measured.displacement, measured.force / newton)
        name = experiment.column[0].partition("_")[0]
        marks = None if len(control) == len(asked) else (asked, result.loads / newton)
        pictures.load_against_extension(
            comm, file(f"load_against_{name}.png"), control, load / newton,
            points=others, marks=marks, xlabel=_axis_label(result), ylabel=f"load ({unit})",
            title=title,
        )  # fmt: skip
        if measured is not None and experiment.unit != "m":
            curve = result.curve()
            pictures.load_against_extension(
                comm, file("load_against_crosshead.png"), curve["crosshead_mm"],
                curve["load_N"] / newton,
                points={"measured": (1e3 * measured.displacement, measured.force / newton)},
                xlabel=quantity("crosshead_mm").axis, ylabel=f"load ({unit})", title=title,
            )  # fmt: skip


def _draw_energies(path: Path, result: TestResult, title: str) -> None:
    control, _, energies = _path(result)
    parts = {
        "yarn bending" if mode == "bending" else mode: 1e3 * energies[:, i]
        for i, mode in enumerate(MODES)
        if mode != "bending" or result.experiment.bending
    }
    pictures.stacked(
        result.network.comm,
        path,
        control,
        parts,
        (_axis_label(result), "strain energy (mJ)"),
        title,
    )


def net_kinematics(result: TestResult, extension: np.ndarray) -> np.ndarray | None:
    """Shear angle in the middle of an inextensible pin-jointed net, degrees; (n,).

    NaN beyond its reach; None where a test has no such kinematics (Experiment.net_gauge).
    """
    gauge = result.experiment.net_gauge()
    return None if gauge is None else np.rad2deg(net_angle(extension, gauge))


def _draw_zones(path: Path, result: TestResult, curve, title: str) -> None:
    extension = curve["extension_mm"]
    names = (("middle", "middle zone"), ("side", "side zones"), ("clamp", "at the clamps"))
    zones = {
        f"{label} (median)": (extension, curve[f"shear_{zone}_deg"])
        for zone, label in names
        if np.isfinite(curve[f"shear_{zone}_deg"]).all()
    }
    fine = np.linspace(0.0, extension[np.abs(extension).argmax()], 200)
    net = net_kinematics(result, 1e-3 * fine)
    thin = {}
    if net is not None:
        thin = {"inextensible net": (fine, net), "": (fine, 0.5 * net)}
    pictures.zones(result.network.comm, path, zones, thin, title)


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


def _uniform(comm, what: str, values: dict[str, np.ndarray], least: float, unit: str) -> str | None:
    """Tell the values of maps that are the same all over, None if one is not. Collective."""
    told = []
    for name, value in values.items():
        good = value[np.isfinite(value)]
        low = min(comm.allgather(float(good.min(initial=np.inf))))
        high = max(comm.allgather(float(good.max(initial=-np.inf))))
        if high - low > max(1e-6 * max(-low, high), least):
            return None
        middle = 0.5 * (low + high)
        shown = f"{0.0 if abs(middle) < least else middle:.4g}{unit}"
        told.append(shown if len(values) == 1 else f"{name} {shown}")
    return f"{what}: uniform, {', '.join(told)}."


def _shear_values(result, membrane) -> dict[str, np.ndarray]:
    """Shear angles at the crossovers, degrees, by what they are of. Collective."""
    network = result.network
    shear = np.where(result.fields["carrying"], np.rad2deg(result.fields["shear_angle"]), np.nan)
    values = {"network": shear}
    if membrane is not None:
        angle = membrane.evaluate(network.crossover_position)["shear_angle"]
        values["membrane"] = np.rad2deg(angle)
    return values


def _tension_values(result) -> dict[str, np.ndarray]:
    """Tensions of the yarns at the crossovers, N, by family. Collective."""
    network, fields = result.network, result.fields
    return {
        name: np.where(
            fields["carrying"],
            fields[f"{name}_tension"] / getattr(network.fabric, name).yarns,
            np.nan,
        )
        for name in ("warp", "weft")
    }
