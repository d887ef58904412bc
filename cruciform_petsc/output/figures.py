# SPDX-License-Identifier: MIT
"""Which pictures a run makes of its result; pictures.py draws them."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ..errors import InputError
from ..experiments.net_kinematics import net_angle
from ..parallel import least, most, on_root
from ..quantities import EXTENSION, LOAD, energy_unit, force_unit, quantity
from . import pictures
from .sample import sample_map, sample_yarns
from .scene import woven
from .summary import ROUNDING_N

if TYPE_CHECKING:
    from matplotlib.figure import Figure
    from mpi4py import MPI

    from ..calibration.curve import MeasuredCurve
    from ..experiments.experiment import Experiment
    from ..experiments.result import State, TestResult
    from .pictures import Given

ZONES = {"middle": "middle zone", "side": "side zones", "clamp": "at the clamps"}
CLOSED_FORM = "closed form, yarns neither stretch nor bend"
HEIGHT_LABEL = "height out of the plane (mm)"
ROUNDING_MM = 1e-6  # heights below are none
STAGES = 4  # states side by side
MOST_FRAMES = 40  # of an animation

Drawn = dict[str, "partial[Figure]"]  # what draws a picture, by the name of its file


def draw_all(
    directory: Path,
    result: TestResult,
    without: TestResult | None,
    membranes: Sequence[Any],
    summary: dict[str, Any],
    measured: MeasuredCurve | None = None,
) -> list[str]:
    """Write every picture of a run (see `figures`) into a folder; returns their names. Collective.

    Title and ladder are those of the summary, which learns of uniform maps.
    """
    title = pictures.plain_text(summary["title"])
    ladder = summary.get("continuum", {}).get("ladder")
    drawn, uniform = figures(result, title, without, membranes, ladder, measured)
    for name, draw in drawn.items():
        pictures.save(result.network.comm, directory / name, draw)
    summary.setdefault("uniform_maps", {}).update(uniform)
    return list(drawn)


def plot(
    result: TestResult, path: str | Path | None = None, title: str = "", *, ax: Given = None
) -> Any:
    """Draw the yarns before and after, coloured by shear angle. Collective.

    By the yarns' tension where the cloth does not shear. The title is taken literally. With a
    ``path`` as a PNG; else into ``ax``, or into those of a new figure of pyplot's.

    Returns
    -------
    Axes or None
        Those drawn into, on rank 0; None of a file.
    """
    return _drawn(result.network.comm, path, _yarns(result, pictures.plain_text(title)), ax)


def scene(
    result: TestResult,
    path: str | Path | None = None,
    title: str = "",
    *,
    ax: Given = None,
    state: State | None = None,
) -> Any:
    """Draw the woven yarns in space, coloured by shear angle. Collective.

    Of a ``state``, by default the last; else as `plot`.

    Raises
    ------
    InputError
        On every rank: nothing here can draw in space, or the place cannot be written to.
    """
    network = result.network
    text = _told(pictures.plain_text(title), f"at {when(result, state)}")
    _, sample, clamps = _panel("", result, state)
    draw = partial(woven, sample, clamps, network.fabric, text)
    return _drawn(network.comm, path, draw, ax)


def _drawn(
    comm: MPI.Intracomm, path: str | Path | None, draw: Callable[..., Figure], ax: Given
) -> Any:
    """Axes, or a file."""
    if path is None:
        return pictures.draw(comm, draw, ax)
    if ax is not None:
        raise InputError("a picture goes into a file or into axes: give path or ax, not both")
    pictures.save(comm, path, draw)
    return None


def figures(
    result: TestResult,
    title: str = "",
    without: TestResult | None = None,
    membranes: Sequence[Any] = (),
    ladder: Sequence[dict[str, Any]] | None = None,
    measured: MeasuredCurve | None = None,
) -> tuple[Drawn, dict[str, str]]:
    """Gather what every picture of a run shows. Collective.

    ``without`` is the same without yarn bending; ``membranes``, a MembraneResult or
    HyperelasticResult for each state or (small displacements) for the last one; ``ladder``,
    differences to the membrane for finer and finer networks; ``measured`` is drawn over the load.

    Returns
    -------
    drawn : dict of callables
        What draws each picture, on rank 0 only, by the name of its file; in an order to read them.
    uniform : dict of str
        By the same names: a sentence in place of a map that is the same all over.
    """
    experiment, membrane = result.experiment, None
    if membranes:
        membrane = membranes[-1].evaluate(result.network.crossover_position)["shear_angle"]
    drawn: Drawn = {"yarns.png": _yarns(result, title)}
    # Of a cloth that does not shear there is nothing to see but its curve.
    moves = experiment.colour == "shear angle" or experiment.slip is not None
    if len(result.states) > 1 and experiment.finite and moves:
        drawn["stages.png"] = _stages(result, title)
    if result.buckling is not None:
        drawn |= _stability(result, title)
    drawn |= curves_of(experiment, result.curve(), title, membranes, measured)
    if experiment.finite and result.network.fabric.biaxial_law is not None:
        drawn["tension_surface.png"] = _surface(result, title)
    shears = not experiment.finite or _shears(result.curve())
    if experiment.has_zones and shears:
        drawn["centre_line.png"] = _centre_line(result, without, membrane, title)
    maps, uniform = _maps(result, membrane, title)
    drawn |= maps
    if without is not None:
        panels = [_panel("no yarn bending", without), _panel("with yarn bending", result)]
        text = _told(title, f"at {when(result)}")
        drawn["with_and_without_bending.png"] = partial(pictures.yarns, panels, text)
    if ladder:
        differences = {
            "displacement at the crossovers": [rung["relative_l2_displacement"] for rung in ladder],
            "load": [abs(rung["load_ratio"] - 1.0) for rung in ladder],
        }
        crossovers = [rung["crossovers"] for rung in ladder]
        label = "relative difference to the membrane"
        drawn["ladder.png"] = partial(pictures.convergence, crossovers, differences, label, title)
    return drawn, uniform


# -- the specimen -------------------------------------------------------------------------------


def _panel(
    title: str, result: TestResult, state: State | None = None, values=None
) -> tuple[str, Any, np.ndarray]:
    """A title, the yarns (on rank 0) and the clamps (n, 2, 2) of a state, the last. Collective."""
    network, experiment, state = result.network, result.experiment, state or result.states[-1]
    sample = sample_yarns(network, state.node_displacement, state.fields, values=values)
    clamps = [np.empty((0, 2, 2))]
    for edge in experiment.clamps:
        segments = network.preform.edge(edge)
        # Small displacements go along the tangent at rest.
        step, factor = (state.control, 1.0) if experiment.finite else (1e-6, 1e6 * state.control)
        gradient, shift = experiment.motion(edge, step)
        clamps.append(segments + factor * (segments @ gradient.T + shift - segments))
    return title, sample, np.concatenate(clamps)


def when(result: TestResult, state: State | None = None) -> str:
    """What a state, the last, is at: "extension 40 mm"."""
    control = (state or result.states[-1]).control
    return result.experiment.column.text(control).replace(" deg", "°")


def _told(title: str, what: str) -> str:
    """A title, and below it what the picture shows."""
    return f"{title}\n{what}".strip()


def _yarns(result: TestResult, title: str) -> partial[Figure]:
    values, label = _colours(result)
    text = _told(title, f"yarns at rest, grey, and at {when(result)}")
    return partial(pictures.yarns, [_panel("", result, values=values)], text, label=label)


def _colours(result: TestResult, state: State | None = None) -> tuple[list | None, str]:
    """What yarns of a state, the last, are coloured by, as sample_yarns takes it, and its label."""
    colour = colour_of(result)
    if colour == "tension":
        return list(_tensions(result, state).values()), "tension (N per yarn)"
    if colour == "height":
        return 2 * [_heights(result, state)], HEIGHT_LABEL
    return None, pictures.ANGLE_LABEL


def colour_of(result: TestResult) -> str:
    """What yarns are coloured by: as the kind of test has it, or where cloth does not shear."""
    experiment = result.experiment
    if experiment.space and experiment.colour == "shear angle" and not _shears(result.curve()):
        return "height"
    return experiment.colour


def _heights(result: TestResult, state: State | None = None) -> np.ndarray:
    """Height of the crossovers out of the plane in a state, the last, mm; (n,)."""
    fields = (state or result.states[-1]).fields
    return np.where(fields["carrying"], 1e3 * fields["displacement"][:, 2], np.nan)


def _stages(result: TestResult, title: str) -> partial[Figure]:
    """Up to four states side by side."""
    count = min(STAGES, len(result.states))
    panels = []
    for i in np.linspace(0, len(result.states) - 1, count).round().astype(int):
        state = result.states[i]
        name = when(result, state)
        load = "" if result.experiment.control == "load" else f"\n{state.load:.3g} N"
        values, label = _colours(result, state)
        panels.append(_panel(name + load, result, state, values))
    return partial(pictures.yarns, panels, title, before=False, label=label)


def draw_animation(result: TestResult, path: str | Path, title: str = "") -> None:
    """Write the yarns of a finite test, all its increments or so many evenly, as a GIF. Collective.

    InputError on every rank if it cannot be written.
    """
    count = max(len(result.increments), len(result.states))
    chosen = set(np.linspace(0, count - 1, min(count, MOST_FRAMES)).round().astype(int).tolist())
    label, panels = "", []
    for number, state in enumerate(result.every_state()):
        if number not in chosen:
            continue
        values, label = _colours(result, state)
        panels.append(_panel(when(result, state), result, state, values))
    title = pictures.plain_text(title)

    def draw() -> None:
        from matplotlib import rc_context

        with rc_context(pictures.STYLE):
            pages = (
                pictures.yarns([panel], title, before=False, label=label, among=panels)
                for panel in panels
            )
            pictures.save_animation(path, pages)

    on_root(result.network.comm, draw)


# -- curves -------------------------------------------------------------------------------------


def curves_of(
    experiment: Experiment,
    curve: Mapping[str, np.ndarray],
    title: str = "",
    membranes: Sequence[Any] = (),
    measured: MeasuredCurve | None = None,
) -> Drawn:
    """What draws the curves of a test, see `figures`: the load, or what stands for it, first."""
    drawn = _loads(experiment, curve, membranes, title, measured)
    if experiment.finite:
        if np.isfinite(curve.get("shear_force_N_per_mm", np.nan)).any():
            drawn["shear_force.png"] = _shear_force(experiment, curve, title)
        drawn["energy.png"] = _energies(experiment, curve, title)
    if experiment.has_zones and experiment.finite:
        if _shears(curve):
            drawn["zones.png"] = _zones(experiment, curve, title)
    elif experiment.has_zones:
        drawn["shear_against_load.png"] = _shear_against_load(curve, title)
    return drawn


def _shears(curve: Mapping[str, np.ndarray]) -> bool:
    """Whether there is more than rounding in the shear angles."""
    return bool((np.abs(curve["shear_max_deg"]) > pictures.ROUNDING_DEG).any())


def _loads(
    experiment: Experiment,
    curve: Mapping[str, np.ndarray],
    membranes: Sequence[Any],
    title: str,
    measured: MeasuredCurve | None,
) -> Drawn:
    """The load, or what stands for it, against the control."""
    in_newton = LOAD.sized_for([curve[column] for column in experiment.forces])
    newton = in_newton.scale
    draw = partial(pictures.curves, title=title)
    test = None
    if measured is not None:
        test = 1e3 * measured.displacement, measured.force / newton
    own = experiment.drawn_curves(dict(curve))
    if own is not None:
        name, (x_label, y_label), lines = own
        if y_label == LOAD.axis:
            y_label = in_newton.axis
            lines = {key: (x, y / newton) for key, (x, y) in lines.items()}
        if test is not None:
            lines[f"measured, {next(iter(lines))}"] = test
        lines = {key: pictures.from_origin(*line) for key, line in lines.items()}
        return {f"{name}.png": partial(draw, lines, (x_label, y_label))}
    control = experiment.column.scale * curve[experiment.column.column]
    column = experiment.column.sized_for(control)
    asked = np.append(curve["asked"][:-1] > 0, True)  # the last one also if it was not
    states, points = control[asked] / column.scale, {}
    if len(membranes) == len(states):
        points["membrane"] = states, np.array([m.load for m in membranes]) / newton
    if test is not None and experiment.unit == "m":
        points["measured"] = test
    lines = {"network": pictures.from_origin(control / column.scale, curve["load_N"] / newton)}
    if "load_net_N" in curve:
        closed = pictures.from_origin(control / column.scale, curve["load_net_N"] / newton)
        lines[CLOSED_FORM] = closed
    marks = None if curve["asked"].all() else (states, curve["load_N"][asked] / newton)
    labels = column.axis, in_newton.axis
    name = f"load_against_{column.column.partition('_')[0]}.png"
    drawn: Drawn = {name: partial(draw, lines, labels, points=points, marks=marks)}
    if test is not None and experiment.unit != "m":
        lines = {"network": pictures.from_origin(curve["crosshead_mm"], curve["load_N"] / newton)}
        labels, points = (quantity("crosshead_mm").axis, in_newton.axis), {"measured": test}
        drawn["load_against_crosshead.png"] = partial(draw, lines, labels, points=points)
    return drawn


def _shear_force(
    experiment: Experiment, curve: Mapping[str, np.ndarray], title: str
) -> partial[Figure]:
    """The normalised shear force over the angles it may be drawn over, beside the law's."""
    force = quantity("shear_force_N_per_mm")
    lines = {
        label: pictures.from_origin(curve[column], curve[force.column])
        for label, column in experiment.shear_angles.items()
    }
    ends = np.concatenate([x[np.isfinite(x) & np.isfinite(y)] for x, y in lines.values()])
    end = float(ends[np.abs(ends).argmax()])
    angle = np.deg2rad(np.linspace(0.0, np.clip(end, -85.0, 85.0), 200))
    fabric = experiment.network.fabric
    law = 1e-3 * fabric.shear.evaluate(angle)[1] / np.cos(angle)
    name = f"the fabric's {'elastic ' if fabric.remembers else ''}law"
    guides = {name: (np.rad2deg(angle), law)}
    labels = pictures.ANGLE_LABEL, force.axis
    return partial(pictures.curves, lines, labels, title, guides=guides)


def _stability(result: TestResult, title: str) -> Drawn:
    """Modes on the cloth at rest, and the lowest stiffness on the way."""
    experiment, buckling = result.experiment, result.buckling
    column, drawn = quantity("lowest_stiffness_Pa_per_mm"), Drawn()
    if buckling is not None and buckling.modes:
        shapes = [mode.fields["displacement"] for mode in buckling.modes]
        space = experiment.space
        values = {
            f"mode {i}": shape[:, 2] if space else np.linalg.norm(shape, axis=1)
            for i, shape in enumerate(shapes, 1)
        }
        what = "out of the plane" if space else "in the plane"
        sample: Any = sample_map(result.network, values)  # on rank 0, which draws it
        label = f"displacement {what} (largest: 1)"
        at = "where the cloth becomes unstable" if buckling.passed else "linearised, at rest"
        drawn["mode.png"] = partial(pictures.maps, sample, label, _told(title, at))
    curve, own = result.curve(), experiment.column
    control = own.scale * curve[own.column]
    sized = own.sized_for(control)
    line = {"lowest stiffness": (control / sized.scale, curve[column.column])}
    marks = curve["critical"] > 0.0
    draw = partial(pictures.curves, line, (sized.axis, f"lowest stiffness ({column.unit})"), title)
    points = {"critical": (control[marks] / sized.scale, curve[column.column][marks])}
    drawn["lowest_stiffness.png"] = partial(draw, points=points if marks.any() else {})
    return drawn


def _energies(
    experiment: Experiment, curve: Mapping[str, np.ndarray], title: str
) -> partial[Figure]:
    """Strain energies of the modes all along a finite test."""
    names = {mode: mode.replace("_", " ") for mode in experiment.modes}
    names["bending"] = "yarn bending"
    if not experiment.bending:
        del names["bending"]
    parts = {name: curve[f"energy_{mode}_J"] for mode, name in names.items()}
    what = "strain energy"
    for spent in ("dissipated_in_shear_J", "dissipated_in_slip_J"):
        if spent in curve:
            parts[quantity(spent).name], what = curve[spent], "energy"
    unit, joule = energy_unit(sum(parts.values()))
    parts = {name: part / joule for name, part in parts.items()}
    own = experiment.column
    control = own.scale * curve[own.column]
    column = own.sized_for(control)
    x, along = control / column.scale, column.axis
    if (np.diff(np.abs(x)) * np.diff(np.abs(x))[:1] < 0.0).any():  # to and fro: parts would overlap
        x, along = np.arange(1.0, len(x) + 1.0), "increment"
    start = {"tension": experiment.energy_at_start / joule}
    labels = along, f"{what} ({unit})"
    return partial(pictures.stacked, x, parts, labels, title, start=start)


def _surface(result: TestResult, title: str) -> partial[Figure]:
    """Both tensions of the law over both strains, and the way of the cloth's mean strains there."""
    comm, law = result.network.comm, result.network.fabric.biaxial_law
    assert law is not None
    way = [(0.0, 0.0)]
    for state in result.states:
        carrying = state.fields["carrying"]
        sums = [state.fields[f"{name}_strain"][carrying].sum() for name in ("warp", "weft")]
        warp, weft, count = comm.allreduce(np.array([*sums, carrying.sum()]))
        way.append((warp / max(count, 1), weft / max(count, 1)))
    return partial(pictures.tension_surface, law, np.array(way), title)


def _zones(experiment: Experiment, curve: Mapping[str, np.ndarray], title: str) -> partial[Figure]:
    """Shear angles of the zones, and of an inextensible net: half of its middle's in its sides."""
    extension = curve["extension_mm"]
    lines = {
        f"{label} (median)": pictures.from_origin(extension, curve[f"shear_{zone}_deg"])
        for zone, label in ZONES.items()
        if np.isfinite(curve[f"shear_{zone}_deg"]).all()
    }
    guides, gauge = {}, experiment.net_gauge()
    if gauge is not None:
        fine = np.linspace(0.0, extension[np.abs(extension).argmax()], 200)
        net = np.rad2deg(net_angle(1e-3 * fine, gauge))
        guides = {"inextensible net": (fine, net), "": (fine, 0.5 * net)}
    labels = EXTENSION.axis, pictures.ANGLE_LABEL
    return partial(pictures.curves, lines, labels, title, guides=guides)


def _shear_against_load(curve: Mapping[str, np.ndarray], title: str) -> partial[Figure]:
    """The paper's figure 8."""
    load = LOAD.sized_for(curve["load_N"])
    names = {"at the centre point": "shear_centre_deg", "largest (absolute)": "shear_max_deg"}
    lines = {
        label: pictures.from_origin(curve["load_N"] / load.scale, curve[name])
        for label, name in names.items()
        if np.isfinite(curve[name]).all()  # there may be a hole at the centre
    }
    return partial(pictures.curves, lines, (load.axis, pictures.ANGLE_LABEL), title)


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
    return partial(pictures.curves, lines, labels, _told(title, f"at {when(result)}"))


# -- maps ---------------------------------------------------------------------------------------


def _maps(
    result: TestResult, membrane: np.ndarray | None, title: str
) -> tuple[Drawn, dict[str, str]]:
    """Maps of shear angle and tension, and sentences in place of those that are uniform."""
    network, fields = result.network, result.fields
    shear = {"network": np.where(fields["carrying"], np.rad2deg(fields["shear_angle"]), np.nan)}
    compared: dict[str, Any] = {}
    if membrane is not None:
        shear["membrane"], compared = np.rad2deg(membrane), {"difference": "difference (°)"}
    tensions = _tensions(result)
    largest = most(network.comm, np.abs(np.nan_to_num(list(tensions.values()))))
    unit, newton = force_unit(largest)
    drawn: Drawn = {}
    uniform: dict[str, str] = {}
    in_units: dict[str, Any] = {"label": f"tension ({unit} per yarn)"}
    maps: list[tuple[str, str, dict[str, Any], str, float, float, dict[str, Any]]] = [
        ("shear_map.png", "Shear angle", shear, "°", 1.0, pictures.ROUNDING_DEG, compared),
        ("tension_map.png", "Tension", tensions, " N per yarn", newton, ROUNDING_N, in_units),
    ]
    if result.experiment.space:
        heights, label = {"": _heights(result)}, {"label": HEIGHT_LABEL}
        maps.insert(0, ("height_map.png", "Height", heights, " mm", 1.0, ROUNDING_MM, label))
    for name, what, values, unit, size, rounding, options in maps:
        told = uniform_text(network.comm, what, values, rounding, unit)
        if told is None:
            scaled = {key: value / size for key, value in values.items()}
            sample: Any = sample_map(network, scaled)  # on rank 0, which draws it
            text = _told(title, f"{what.lower()} at {when(result)}, on the cloth at rest")
            drawn[name] = partial(pictures.maps, sample, title=text, **options)
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


def _tensions(result: TestResult, state: State | None = None) -> dict[str, np.ndarray]:
    """Tensions of the yarns at the crossovers in a state, the last, N, by family."""
    fields, fabric = (state or result.states[-1]).fields, result.network.fabric
    return {
        name: np.where(
            fields["carrying"], fields[f"{name}_tension"] / getattr(fabric, name).yarns, np.nan
        )
        for name in ("warp", "weft")
    }
