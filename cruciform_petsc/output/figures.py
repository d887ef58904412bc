# SPDX-License-Identifier: MIT
"""Which pictures a run makes of its result; pictures.py draws them."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ..experiments.net_kinematics import net_angle
from ..parallel import least, most
from ..quantities import EXTENSION, LOAD, force_unit, quantity
from ..small.network import MODES
from . import pictures
from .sample import sample_map, sample_yarns
from .scene import woven
from .summary import ROUNDING_N

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from ..calibration.curve import MeasuredCurve
    from ..experiments.result import State, TestResult

ZONES = {"middle": "middle zone", "side": "side zones", "clamp": "at the clamps"}
STAGES = 4  # states side by side

Drawn = dict[str, "partial[Figure]"]  # what draws a picture, by the name of its file


def draw_all(
    directory: Path,
    result: TestResult,
    without: TestResult | None,
    membranes: Sequence[Any],
    summary: dict[str, Any],
    measured: MeasuredCurve | None = None,
) -> list[str]:
    """Write every picture of a run into a folder; returns their names. Collective.

    See `figures`; title and ladder are those of the summary, which learns of uniform maps.
    """
    title = pictures.plain_text(summary["title"])
    ladder = summary.get("continuum", {}).get("ladder")
    drawn, uniform = figures(result, title, without, membranes, ladder, measured)
    for name, draw in drawn.items():
        pictures.save(result.network.comm, directory / name, draw)
    summary.setdefault("uniform_maps", {}).update(uniform)
    return list(drawn)


def plot(result: TestResult, path: str | Path, title: str = "") -> None:
    """Draw the yarns before and after as a PNG, coloured by shear angle. Collective.

    By the yarns' tension where the cloth does not shear. The title is taken literally.
    """
    pictures.save(result.network.comm, path, _yarns(result, pictures.plain_text(title)))


def scene(result: TestResult, path: str | Path, title: str = "") -> None:
    """Draw the woven yarns in space as a PNG, coloured by shear angle. Collective.

    The title is taken literally.

    Raises
    ------
    InputError
        On every rank: nothing here can draw in space, or the place cannot be written to.
    """
    network, text = result.network, pictures.plain_text(title)
    _, sample, clamps = _panel("", result, result.states[-1])
    pictures.save(network.comm, path, woven, sample, network.fabric.thickness, text, clamps)


def figures(
    result: TestResult,
    title: str = "",
    without: TestResult | None = None,
    membranes: Sequence[Any] = (),
    ladder: Sequence[dict[str, Any]] | None = None,
    measured: MeasuredCurve | None = None,
) -> tuple[Drawn, dict[str, str]]:
    """Gather what every picture of a run shows. Collective.

    Parameters
    ----------
    result : TestResult
    title : str
    without : TestResult, optional
        The same without yarn bending.
    membranes : sequence of MembraneResult or HyperelasticResult
        For each state, or (small displacements) for the last one; may be empty.
    ladder : sequence of dict, optional
        Differences to the membrane for finer and finer networks.
    measured : MeasuredCurve, optional
        To be drawn over the load curve.

    Returns
    -------
    drawn : dict of callables
        What draws each picture, by the name of its file, in an order to read them in. To be called
        on rank 0 only.
    uniform : dict of str
        By the same names: a sentence in place of a map that is the same all over.
    """
    experiment, angle = result.experiment, None
    if membranes:
        places = result.network.crossover_position
        angle = membranes[-1].evaluate(places)["shear_angle"]
    drawn: Drawn = {"yarns.png": _yarns(result, title)}
    # Of a cloth that does not shear there is nothing to see but its curve.
    if len(result.states) > 1 and experiment.finite and experiment.colour == "shear angle":
        drawn["stages.png"] = _stages(result, title)
    drawn |= _loads(result, membranes, title, measured)
    if experiment.finite:
        drawn["energy.png"] = _energies(result, title)
    if experiment.has_zones and experiment.finite:
        drawn["zones.png"] = _zones(result, title)
    elif experiment.has_zones:
        drawn["shear_against_load.png"] = _shear_against_load(result, title)
    if experiment.has_zones:
        drawn["centre_line.png"] = _centre_line(result, without, angle, title)
    maps, uniform = _maps(result, angle, title)
    drawn |= maps
    if without is not None:
        panels = [
            _panel("no yarn bending", without, without.states[-1]),
            _panel("with yarn bending", result, result.states[-1]),
        ]
        drawn["with_and_without_bending.png"] = partial(pictures.yarns, panels)
    if ladder:
        drawn["ladder.png"] = _ladder(ladder, title)
    return drawn, uniform


# -- the specimen -------------------------------------------------------------------------------


def _panel(title: str, result: TestResult, state: State, values=None) -> tuple[str, Any, list]:
    """A state's title, its yarns (on rank 0) and its clamps. Collective."""
    network = result.network
    sample = sample_yarns(network, state.node_displacement, state.fields, values=values)
    return title, sample, _clamps(result, state)


def _yarns(result: TestResult, title: str) -> partial[Figure]:
    values, label = None, pictures.ANGLE_LABEL
    if result.experiment.colour == "tension":
        values, label = list(_tensions(result).values()), "tension (N per yarn)"
    panel = _panel("", result, result.states[-1], values)
    return partial(pictures.yarns, [panel], title, label=label)


def _stages(result: TestResult, title: str) -> partial[Figure]:
    """Up to four states side by side."""
    count = min(STAGES, len(result.states))
    chosen = np.unique(np.linspace(0, len(result.states) - 1, count).round().astype(int))
    panels = []
    for state in (result.states[i] for i in chosen):
        name = result.experiment.column.text(state.control).replace(" deg", "°")
        load = "" if result.experiment.control == "load" else f"\n{state.load:.3g} N"
        panels.append(_panel(name + load, result, state))
    return partial(pictures.yarns, panels, title, before=False)


def _clamps(result: TestResult, state: State) -> list[pictures.Clamp]:
    """Gripped edges, each with how far its corners have moved in a state."""
    experiment, control = result.experiment, state.control
    clamps: list[pictures.Clamp] = []
    for edge in experiment.clamps:
        segments = result.network.preform.edge(edge)
        # Small displacements go along the tangent at rest.
        step, factor = (control, 1.0) if experiment.finite else (1e-6, 1e6 * control)
        gradient, shift = experiment.motion(edge, step)
        clamps.append((segments, factor * (segments @ gradient.T + shift - segments)))
    return clamps


# -- curves -------------------------------------------------------------------------------------


def _path(result: TestResult) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Control, load (N) and energies (J; (n, 3)) all along the test."""
    if result.experiment.finite and result.increments:
        path = [
            (step.control, step.load, [step.energies[mode] for mode in MODES])
            for step in result.increments
        ]
        control, load, energies = (np.array(column) for column in zip(*path, strict=True))
        return control, load, energies
    return result.controls, result.loads, np.column_stack([result.energies()[m] for m in MODES])


def _axis(result: TestResult) -> tuple[str, float]:
    """Label of the control's axis, and SI units in one of its."""
    column = result.experiment.column
    unit, newton = force_unit(result.loads)
    return (f"load ({unit})", newton) if column is LOAD else (column.axis, column.scale)


def _loads(
    result: TestResult, membranes: Sequence[Any], title: str, measured: MeasuredCurve | None
) -> Drawn:
    """The load, or what stands for it, against the control."""
    experiment, curve = result.experiment, result.curve()
    control, load, _ = _path(result)
    unit, newton = force_unit(load)
    load_label = f"load ({unit})"
    test = None
    if measured is not None:
        test = 1e3 * measured.displacement, measured.force / newton
    own = experiment.drawn_curves(curve)
    if own is not None:
        name, (x_label, y_label), lines = own
        if y_label == LOAD.axis:
            y_label, lines = load_label, {key: (x, y / newton) for key, (x, y) in lines.items()}
        if test is not None:
            lines[f"measured, {next(iter(lines))}"] = test
        lines = {key: pictures.from_origin(*line) for key, line in lines.items()}
        return {f"{name}.png": partial(pictures.curves, lines, (x_label, y_label), title)}
    x_label, size = _axis(result)
    states = result.controls / size
    points = {}
    if len(membranes) == len(states):
        points["membrane"] = states, np.array([m.load for m in membranes]) / newton
    if test is not None and experiment.unit == "m":
        points["measured"] = test
    lines = {"network": pictures.from_origin(control / size, load / newton)}
    marks = None if len(control) == len(states) else (states, result.loads / newton)
    name = experiment.column.column.partition("_")[0]
    draw = partial(pictures.curves, title=title)
    drawn = {
        f"load_against_{name}.png": partial(
            draw, lines, (x_label, load_label), points=points, marks=marks
        )
    }
    if test is not None and experiment.unit != "m":
        labels = quantity("crosshead_mm").axis, load_label
        lines = {"network": pictures.from_origin(curve["crosshead_mm"], curve["load_N"] / newton)}
        points = {"measured": test}
        drawn["load_against_crosshead.png"] = partial(draw, lines, labels, points=points)
    return drawn


def _energies(result: TestResult, title: str) -> partial[Figure]:
    control, _, energies = _path(result)
    label, size = _axis(result)
    parts = {
        "yarn bending" if mode == "bending" else mode: 1e3 * energy
        for mode, energy in zip(MODES, energies.T, strict=True)
        if mode != "bending" or result.experiment.bending
    }
    return partial(pictures.stacked, control / size, parts, (label, "strain energy (mJ)"), title)


def _zones(result: TestResult, title: str) -> partial[Figure]:
    """Shear angles of the zones, and of an inextensible net: half of its middle's in its sides."""
    curve = result.curve()
    extension = curve["extension_mm"]
    lines = {
        f"{label} (median)": pictures.from_origin(extension, curve[f"shear_{zone}_deg"])
        for zone, label in ZONES.items()
        if np.isfinite(curve[f"shear_{zone}_deg"]).all()
    }
    guides, gauge = {}, result.experiment.net_gauge()
    if gauge is not None:
        fine = np.linspace(0.0, extension[np.abs(extension).argmax()], 200)
        net = np.rad2deg(net_angle(1e-3 * fine, gauge))
        guides = {"inextensible net": (fine, net), "": (fine, 0.5 * net)}
    labels = EXTENSION.axis, pictures.ANGLE_LABEL
    return partial(pictures.curves, lines, labels, title, guides=guides)


def _shear_against_load(result: TestResult, title: str) -> partial[Figure]:
    """The paper's figure 8."""
    curve, (unit, newton) = result.curve(), force_unit(result.loads)
    names = {"at the centre point": "shear_centre_deg", "largest (absolute)": "shear_max_deg"}
    lines = {
        label: pictures.from_origin(curve["load_N"] / newton, curve[name])
        for label, name in names.items()
    }
    return partial(pictures.curves, lines, (f"load ({unit})", pictures.ANGLE_LABEL), title)


def _centre_line(
    result: TestResult, without: TestResult | None, membrane: np.ndarray | None, title: str
) -> partial[Figure]:
    """Shear angle from the clamp along the centre line, without lines across a hole."""
    name = "network, with yarn bending" if result.experiment.bending else "network"
    found = {name: result.centre_line()}
    if without is not None:
        found["network, without yarn bending"] = without.centre_line()
    if membrane is not None:
        found["membrane"] = result.centre_line(membrane)
    lines = {
        label: pictures.broken_at_gaps(1e3 * line.distance, np.rad2deg(line.shear_angle))
        for label, line in found.items()
    }
    labels = "distance from the clamp (mm)", pictures.ANGLE_LABEL
    return partial(pictures.curves, lines, labels, title)


def _ladder(rungs: Sequence[dict[str, Any]], title: str) -> partial[Figure]:
    differences = {
        "displacement at the crossovers": [rung["relative_l2_displacement"] for rung in rungs],
        "load": [abs(rung["load_ratio"] - 1.0) for rung in rungs],
    }
    crossovers = [rung["crossovers"] for rung in rungs]
    label = "relative difference to the membrane"
    return partial(pictures.convergence, crossovers, differences, label, title)


# -- maps ---------------------------------------------------------------------------------------


def _maps(
    result: TestResult, membrane: np.ndarray | None, title: str
) -> tuple[Drawn, dict[str, str]]:
    """Maps of shear angle and tension, and sentences in place of those that are uniform."""
    network, fields = result.network, result.fields
    shear = {"network": np.where(fields["carrying"], np.rad2deg(fields["shear_angle"]), np.nan)}
    label, difference = pictures.ANGLE_LABEL, ""
    if membrane is not None:
        shear["membrane"], difference = np.rad2deg(membrane), "difference (°)"
    tensions = _tensions(result)
    largest = most(network.comm, np.abs(np.nan_to_num(list(tensions.values()))))
    unit, newton = force_unit(largest)
    draw_shear = partial(pictures.maps, label=label, title=title, difference=difference)
    tension_label = f"tension ({unit} per yarn)"
    draw_tension = partial(pictures.maps, label=tension_label, title=title, share=0.99)
    drawn: Drawn = {}
    uniform: dict[str, str] = {}
    for name, what, values, unit, size, rounding, draw in (
        ("shear_map.png", "Shear angle", shear, "°", 1.0, pictures.ROUNDING_DEG, draw_shear),
        ("tension_map.png", "Tension", tensions, " N per yarn", newton, ROUNDING_N, draw_tension),
    ):
        told = uniform_text(network.comm, what, values, rounding, unit)
        if told is None:
            sample = sample_map(network, {key: value / size for key, value in values.items()})
            drawn[name] = partial(draw, sample)
        else:
            uniform[name] = told
    return drawn, uniform


def uniform_text(
    comm, what: str, values: dict[str, np.ndarray], rounding: float, unit: str
) -> str | None:
    """Tell the values of maps that are the same all over, None if one is not. Collective.

    To 1e-6 of their size, or to ``rounding``, below which values are none.
    """
    told = []
    for name, value in values.items():
        good = value[np.isfinite(value)]
        low, high = least(comm, good), most(comm, good)
        size = max(-low, high)
        if size > rounding and high - low > max(1e-6 * size, rounding):
            return None
        middle = 0.5 * (low + high)
        shown = f"{0.0 if abs(middle) < rounding else middle:.4g}{unit}"
        told.append(shown if len(values) == 1 else f"{name} {shown}")
    return f"{what}: uniform, {', '.join(told)}."


def _tensions(result: TestResult) -> dict[str, np.ndarray]:
    """Tensions of the yarns at the crossovers, N, by family."""
    fields, fabric = result.fields, result.network.fabric
    return {
        name: np.where(
            fields["carrying"], fields[f"{name}_tension"] / getattr(fabric, name).yarns, np.nan
        )
        for name in ("warp", "weft")
    }
