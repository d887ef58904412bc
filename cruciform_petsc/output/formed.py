# SPDX-License-Identifier: MIT
"""What a forming leaves: tables, files for ParaView, figures for the summary."""

from __future__ import annotations

import logging
from collections.abc import Mapping, Sequence
from functools import partial
from itertools import chain
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import shapely

from ..equilibrium.state import State
from ..errors import InputError
from ..experiments.limits import beyond_laws
from ..experiments.result import State as Fields
from ..forming.blank import Blank
from ..forming.drape import Drape
from ..forming.forming import Formed, FormingStep
from ..forming.kind import Forming
from ..forming.measures import (
    DrawIn,
    between_plies,
    contact_fields,
    penetration,
    shear_figures,
    yarn_directions,
)
from ..forming.press import stage_number
from ..forming.waves import NOTICED, Waves
from ..parallel import most, on_root
from ..quantities import energy_unit, quantity
from ..tools.motion import Pose
from ..tools.surface import Facets
from ..units import format_si
from . import paraview, pictures, scene
from .cells import area_ratio
from .log import tell_assumed
from .provenance import provenance
from .sample import node_means, sample_map, sample_surface, together
from .tables import write_crossovers, write_csv
from .view import View, steps_shown

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from ..case.schema import Case

ENERGIES = ("tension", "shear", "bending", "out_of_plane_bending", "contact")
VTK_TRIANGLE = 5
FRAMES, MOST_FRAMES = 4, 40  # of stages.png, of animation.gif
NAMED_STAGES = 4  # that an axis has room for
MUCH = 0.25  # of the thickness: compaction on one side that is remarked on
VISCOUS = 0.1  # of all energy, stored and dissipated: viscosity that is remarked on
KPA, MM = 1e-3, 1e3  # in SI units
WRINKLES = "height of wrinkles (mm)"
VIEWED = (  # columns of fields.csv that the view in space may show
    "shear_deg", "wrinkle_height_mm", "bridging_mm", "contact_pressure_kPa",
    "warp_tension_N_per_mm", "weft_tension_N_per_mm", "warp_strain_percent", "weft_strain_percent",
    "thickness_mm",
)  # fmt: skip
_OF_CONTACT = ("contact_pressure", "distance_to", "slip_on")


class Record:
    """Tells the log about each accepted step, and keeps a table of all of them on disk.

    Parameters
    ----------
    forming : Forming
    path : Path
        Of forces.csv.
    log : logging.Logger
    earlier : int
        Steps of a former run, which come first.
    """

    def __init__(self, forming: Forming, path: Path, log: logging.Logger, earlier: int = 0):
        self.forming, self.path, self.log, self.earlier = forming, path, log, earlier
        self.draw_in = [DrawIn(one) for one in forming.blank.each]
        self.drawn: list[dict[str, float]] = []
        self.steps: list[FormingStep] = []

    def __call__(self, step: FormingStep, state: State) -> None:
        """Take note of a step. Collective."""
        self.steps.append(step)
        drawn = zip(self.draw_in, forming_edges(self.draw_in), strict=True)
        self.drawn.append(
            {
                name: value
                for of, names in drawn
                for name, value in zip(names, of.largest(state).values(), strict=True)
            }
        )
        if len(self.steps) >= self.earlier:
            self._tell(step)
            write_csv(self.forming.network.comm, self.path, self.table())

    @property
    def edges(self) -> list[str]:
        """Edges whose draw-in is told, of several plies with the ply's name before."""
        return [name for names in forming_edges(self.draw_in) for name in names]

    def _tell(self, step: FormingStep) -> None:
        if len(self.steps) > self.earlier:
            self.tell(step)
            return
        share = step.increment.control - stage_number(step.increment.control)
        text = '           going on from %.4g %% of stage "%s", %d steps'
        self.log.info(text, 100.0 * share, step.stage, len(self.steps))

    def tell(self, step: FormingStep) -> None:
        """A line on a step, of the network or of a membrane beside it."""
        last = step.increment
        stages = [stage.name for stage in self.forming.stages]
        share = last.control - stage_number(last.control)
        moving = [
            f"{name} {abs(step.tool_force[name][2]):.4g} N, "
            for name in step.tool_force
            if name not in self.forming.below or len(step.tool_force) == 1
        ]
        mended = f", {last.shifted} of them mended" if last.shifted else ""
        self.log.info(
            "%8.2f s    %-*s %5.1f %%, %sshear %4.1f deg, %2d Newton iterations%s",
            last.seconds,
            max(map(len, stages)),
            step.stage,
            100.0 * share,
            "".join(moving),
            np.rad2deg(last.shear_max),
            last.iterations,
            mended,
        )

    def table(self) -> dict[str, list]:
        """Columns of forces.csv: a row for each accepted step."""
        return table_of(self.forming, self.steps, self.drawn)


def table_of(
    forming: Forming, steps: Sequence[FormingStep], drawn: Sequence[Mapping[str, float]] = ()
) -> dict[str, list]:
    """Columns of forces.csv; ``drawn`` is the draw-in [m] of each edge after each step, if known.

    A row for each accepted step.
    """
    columns: dict[str, list] = {
        "stage": [step.stage for step in steps],
        "share_percent": [
            100.0 * (step.increment.control - stage_number(step.increment.control))
            for step in steps
        ],
        "asked": [int(step.increment.asked) for step in steps],
    }
    of_tools = (
        ("force_{}_N", 1.0, "tool_force"),
        ("moment_{}_N_m", 1.0, "tool_moment"),
        ("{}_mm", MM, "tool_place"),
    )
    for head, size, vectors in of_tools:
        for tool in forming.tools:
            for axis, letter in enumerate("xyz"):
                columns[f"{tool.name}_{head.format(letter)}"] = [
                    size * getattr(step, vectors)[tool.name][axis] for step in steps
                ]
    columns["shear_max_deg"] = [np.rad2deg(step.increment.shear_max) for step in steps]
    for mode in ENERGIES:
        columns[f"energy_{mode}_J"] = [step.increment.energies.get(mode, 0.0) for step in steps]
    for mode in steps[-1].spent if steps else ():
        columns[f"dissipated_{mode}_J"] = [step.spent[mode] for step in steps]
    columns["work_of_tools_J"] = [step.work for step in steps]
    for name in steps[-1].load_work if steps else ():
        key = f"work_of_{name.replace(' ', '_')}_J"
        columns[key] = [step.load_work[name] for step in steps]
    for clamp in forming.clamps:
        for axis, letter in enumerate("xyz"):
            columns[f"clamp_{clamp.edge}_force_{letter}_N"] = [
                step.clamp_force[clamp.edge][axis] for step in steps
            ]
    for edge in drawn[-1] if drawn else ():
        columns[f"draw_in_{edge}_mm"] = [MM * of[edge] for of in drawn]
    if any(step.softest is not None for step in steps):
        column = quantity("lowest_stiffness_Pa_per_mm")
        columns[column.column] = [
            np.nan if step.softest is None else step.softest / column.scale for step in steps
        ]
    columns["newton_iterations"] = [step.increment.iterations for step in steps]
    columns["seconds"] = [step.increment.seconds for step in steps]
    return columns


def forming_edges(drawn: Sequence[DrawIn]) -> list[list[str]]:
    """Names of the edges of each ply."""
    return [[f"{of.blank.name} {edge}".strip() for edge in of.edges] for of in drawn]


def summarize(
    case: Case,
    forming: Forming,
    formed: Formed,
    record: Record,
    statistics: Sequence[Mapping[str, Any]],
) -> dict[str, Any]:
    """All figures of a forming, of the last state that was reached. Collective."""
    blank, comm = forming.blank, forming.network.comm
    by_stage = [
        {
            "name": stage.name,
            "steps": len(of),
            "newton": sum(step.increment.iterations for step in of),
            "seconds": sum(step.increment.seconds for step in of),
        }
        for number, stage in enumerate(forming.stages)
        for of in [[s for s in formed.steps if stage_number(s.increment.control) == number]]
    ]
    summary: dict[str, Any] = {
        "title": case.title,
        "kind": forming.kind,
        "finite": True,
        "crossovers": sum(of["crossovers"] for of in statistics),
        "dofs": 3 * blank.nodes.num_nodes_global,
        "stages": by_stage,
        "contact": {
            "stiffness_n_per_m3": blank.settings.stiffness,
            "width_m": blank.settings.width,
            "elastic_slip_m": blank.settings.slip,
            "viscosity_n_s_per_m3": blank.settings.viscosity,
        },
        "network": dict(statistics[0]),
        "case": case.model_dump(),
        **provenance(comm),
    }
    if not formed.steps:
        return summary
    last, state = formed.steps[-1], formed.states[-1]
    of_plies = [_of_ply(one, state) for one in forming.each]
    warnings = [sentence for of in of_plies for sentence in of.pop("warnings")]
    figures = of_plies[0]
    if len(of_plies) > 1:
        figures = {
            key: max(of[key] for of in of_plies)
            for key in ("shear_max_deg", "shear_p99_deg", "penetration_max_mm")
        }
        worst = max(of_plies, key=lambda of: of["wrinkles"]["largest_height_mm"])
        bridging = max(of_plies, key=lambda of: of["bridging"]["largest_gap_mm"])
        figures |= {"wrinkles": worst["wrinkles"], "bridging": bridging["bridging"]}
        for number, (of, sizes) in enumerate(zip(of_plies, statistics, strict=True), 1):
            of |= {"files": f"_ply{number}", "network": dict(sizes)}
        figures |= {"plies": of_plies, "between_plies": _between(blank, state, warnings)}
    energy = {**{mode: last.increment.energies.get(mode, 0.0) for mode in ENERGIES}, **last.spent}
    share = energy["viscous"] / max(sum(energy.values()), 1e-300)
    before = formed.steps[-2] if len(formed.steps) > 1 else None
    began = before.increment.control if before else 0.0
    spent = energy["viscous"] - (before.spent["viscous"] if before else 0.0)
    flows = spent / (last.increment.control - began) > VISCOUS * sum(energy.values())  # per stage
    if share > VISCOUS and flows:
        warnings.append(
            f"viscosity has taken {100.0 * share:.0f} % of the energy, so results depend on it: "
            "a smaller test.contact.viscosity, or a last stage in which nothing moves, may help"
        )
    summary |= {
        "warnings": warnings,
        "tool_force_n": {name: force.tolist() for name, force in last.tool_force.items()},
        "tool_place_mm": {name: (MM * p).tolist() for name, p in last.tool_place.items()},
        "tool_moment_n_m": {name: m.tolist() for name, m in last.tool_moment.items()},
        "draw_in_mm": {edge: MM * drawn for edge, drawn in record.drawn[-1].items()},
        **figures,
        "energy_j": energy,
        **({} if last.softest is None else {"lowest_stiffness_pa_per_mm": 1e-3 * last.softest}),
        "work_of_tools_j": last.work,
        "work_of_loads_j": dict(last.load_work),
        **forming.figures(formed),
    }
    if forming.draped is not None:
        summary["fishnet"] = forming.draped.figures()
    if forming.test.symmetry:
        summary["symmetry"] = {
            "planes": list(forming.test.symmetry),
            "forces_and_energies_are_of": "the part that is modelled",
        }
    if forming.clamps:
        slipped, rubbed = blank.slipped(state)
        summary["clamps"] = {
            edge: {
                "force_n": last.clamp_force[edge].tolist(),
                "slipped_max_mm": MM * slipped[edge],
                "dissipated_j": rubbed[edge],
            }
            for edge in slipped
        }
    return summary


def _of_ply(forming: Forming, state: State) -> dict[str, Any]:
    """Figures of a ply, or of a single blank, and warnings. Collective."""
    blank = forming.blank
    fields, deepest = blank.ply.fields(blank.of_cloth(state)), penetration(blank, state)
    shear, warnings = shear_figures(blank, fields), []
    most_sheared = np.deg2rad(shear["shear_max_deg"])
    warnings += beyond_laws(blank.network, most_sheared, fields["arm_strain"])
    if deepest > MUCH * forming.thickness:
        warnings.append(
            f"tools compact the cloth by {format_si(float(f'{deepest:.3g}'), 'm')} on a side, "
            f"which is {format_si(forming.thickness, 'm')} thick: a larger "
            "test.contact.stiffness, or a finer net, brings it nearer to them"
        )
    if blank.name:
        warnings = [f'ply "{blank.name}": {sentence}' for sentence in warnings]
    return {
        **({"name": blank.name} if blank.name else {}),
        **shear,
        "penetration_max_mm": MM * deepest,
        **Waves.of(blank, state).figures(blank, fields),
        "warnings": warnings,
    }


def _between(blank: Blank, state: State, warnings: list[str]) -> dict[str, dict[str, float]]:
    """Figures of what acts between plies, and a warning where they are compacted much."""
    found = between_plies(blank, state)
    thickness = min(one.thickness for one in blank.each)
    for name, of in found.items():
        if of["compaction"] > 2.0 * MUCH * thickness:
            deep = format_si(float(f"{of['compaction']:.3g}"), "m")
            warnings.append(
                f'plies, "{name}", are compacted by {deep}, half of it each: a larger '
                "test.contact.stiffness, or a finer net, helps"
            )
            break
    return {
        name: {
            "compaction_max_mm": MM * of["compaction"],
            "pressure_max_kpa": KPA * of["pressure"],
            "slip_max_mm": MM * of["slip"],
        }
        for name, of in found.items()
    }


def tell_outcome(log: logging.Logger, summary: Mapping[str, Any], directory: Path) -> None:
    """The result in a few lines."""
    log.info("")
    of_clamps = {f"clamp {e}": c["force_n"] for e, c in summary.get("clamps", {}).items()}
    for name, (x, y, z) in (summary["tool_force_n"] | of_clamps).items():
        log.info("%-13s force on the cloth %.4g, %.4g, %.4g N", name, x + 0.0, y + 0.0, z + 0.0)
    if "symmetry" in summary:
        log.info("%-13s forces and energies are those of the part that is modelled", "symmetry")
    text = "{shear_max_deg:.2f} deg at most, 99 % of crossovers up to {shear_p99_deg:.2f} deg"
    log.info("shear angle   %s", text.format_map(summary))
    if "drape" in summary:
        log.info("drape         %s", _drape_text(summary["drape"]))
    if "inflation" in summary:
        log.info("inflation     %s", _inflation_text(summary["inflation"]))
    drawn = ", ".join(f"{edge} {mm:.4g} mm" for edge, mm in summary["draw_in_mm"].items())
    log.info("draw-in       %s", drawn)
    told = "%s%.3g mm high at most, %.3g %% of the cloth"
    wrinkles, bridging = summary["wrinkles"], summary["bridging"]
    for what, size, of in (
        ("wrinkles      ", wrinkles["largest_height_mm"], wrinkles["area_share"]),
        ("bridging      ", bridging["largest_gap_mm"], bridging["area_share"]),
    ):
        log.info(told, what, size, 100.0 * of)
    log.info("compaction    %.3g mm at most, on each side", summary["penetration_max_mm"])
    for name, of in summary.get("between_plies", {}).items():
        text = "%-13s compacted by %.3g mm at most, pressed with up to %.3g kPa"
        log.info(text, name, of["compaction_max_mm"], of["pressure_max_kpa"])
    unit, size = energy_unit(list(summary["energy_j"].values()))
    energies = {mode: round(e / size, 3) + 0.0 for mode, e in summary["energy_j"].items()}
    texts = [f"{mode.replace('_', ' ')} {e:.4g} {unit}" for mode, e in energies.items()]
    log.info("energy        %s", ", ".join(texts))
    continuum = summary.get("continuum", {})
    if "force_ratio" in continuum:
        ratios = {n: ratio for n, ratio in continuum["force_ratio"].items() if np.isfinite(ratio)}
        forces = ", ".join(f"{name} {ratio:.4f}" for name, ratio in ratios.items())
        log.info("membrane      forces along z, network / membrane: %s", forces)
        text = "              shear angle differs by {mean_abs_shear_deg:.2f} deg in the mean"
        text += ", after {time:.4g} stages"
        log.info("%s", text.format_map(continuum))
    tell_assumed(log, summary)
    log.info("memory        %.0f MiB on the largest rank", max(summary["peak_mib_per_rank"]))
    log.info("results in    %s", directory)


def _drape_text(told: Mapping[str, Any]) -> str:
    text = f"coefficient {told['coefficient_percent']:.1f} %"
    if "folds" in told:
        text += f", {told['folds']} folds, {told['fold_depth_mm']:.3g} mm deep in the mean"
    if told["change_while_at_rest"] is not None:
        text += f"; {told['change_while_at_rest']:+.2g} points while it came to rest"
    return text


def _inflation_text(told: Mapping[str, Any]) -> str:
    tension = max(told[f"{family}_tension_max_n_per_cm"][-1] for family in ("warp", "weft"))
    text = f"at {format_si(told['pressure_pa'][-1], 'Pa')} the net rises by "
    text += f"{told['rise_mm'][-1]:.4g} mm, over {told['volume_m3'][-1]:.4g} m^3, tension up to "
    text += f"{tension:.4g} N/cm"
    if "force_densities" in told:
        text += f"; the form of force densities {told['force_densities']['rise_mm']:.4g} mm"
    return text


# -- fields ----------------------------------------------------------------------------------------


def write_fields(path: Path, forming: Forming, state: State) -> None:
    """Write fields.csv: a row for each crossover, in one order on any number of ranks. Collective.

    docs/files.md tells what the columns are.
    """
    write_crossovers(forming.network, path, crossover_columns(forming, state))


def crossover_columns(forming: Forming, state: State) -> dict[str, np.ndarray]:
    """Columns of fields.csv at this rank's crossovers, (n_owned,) each. Collective."""
    network, blank = forming.network, forming.blank
    fields = blank.ply.fields(blank.of_cloth(state))
    warp, weft = yarn_directions(blank, state)
    hinge = blank.ply.nodes.of_hinge
    touch = {name: values[hinge] for name, values in contact_fields(blank, state).items()}
    now = blank.ply.nodes.rest[hinge] + fields["displacement"]
    area = area_ratio(fields)
    mass, fraction = (
        np.nan if value is None else value
        for value in (network.fabric.areal_density, network.fabric.fibre_volume_fraction)
    )
    waves = Waves.of(blank, state)
    return {
        "x_rest_mm": MM * network.crossover_position[:, 0],
        "y_rest_mm": MM * network.crossover_position[:, 1],
        **{f"{letter}_mm": MM * now[:, axis] for axis, letter in enumerate("xyz")},
        **{f"warp_{letter}": warp[:, axis] for axis, letter in enumerate("xyz")},
        **{f"weft_{letter}": weft[:, axis] for axis, letter in enumerate("xyz")},
        **{f"normal_{letter}": waves.normal[:, axis] for axis, letter in enumerate("xyz")},
        "shear_deg": np.rad2deg(fields["shear_angle"]),
        "warp_strain_percent": 100.0 * fields["warp_strain"],
        "weft_strain_percent": 100.0 * fields["weft_strain"],
        "warp_tension_N_per_mm": fields["warp_tension"] / MM,
        "weft_tension_N_per_mm": fields["weft_tension"] / MM,
        "warp_curvature_per_m": waves.curvature[:, 0],
        "weft_curvature_per_m": waves.curvature[:, 1],
        "wrinkle_height_mm": MM * waves.height,
        "bridging_mm": MM * waves.bridging,
        "area_ratio": area,
        "areal_density_g_per_m2": 1e3 * mass / area,
        "thickness_mm": MM * forming.thickness / area,
        "fibre_volume_fraction_at_constant_thickness": fraction / area,
        "contact_pressure_kPa": KPA * touch.pop("pressure"),
        **{f"{name.replace(' ', '_')}_mm": MM * values for name, values in touch.items()},
        "carrying": fields["carrying"],
    }


def write_series(
    directory: Path, forming: Forming, formed: Formed, notes: Mapping[str, Any]
) -> None:
    """Write series.vtkhdf, the cloth, and tools.vtkhdf over the same times. Collective.

    Time is the number of stages that are done, and the share of the one that runs; it begins with
    the flat blank. All points of a tool that has been removed are one. Cells of the cloth are its
    arms, as in `paraview.write_state`; besides, point data: ``contact_pressure_kPa``,
    ``distance_to_TOOL_mm``, ``slip_on_TOOL_mm``, and at crossovers, between them means of two,
    ``wrinkle_height_mm`` and ``bridging_mm``; cell data: ``yarn_direction`` and
    ``curvature_per_m``.
    """
    comm = forming.network.comm
    states = [forming.blank.start(), *formed.states]
    first = _cloth(forming, states[0])
    times = np.array([state.time for state in states])
    notes = {**notes, "time_is": "stages done"}
    cloth = chain([first], (_cloth(forming, state) for state in states[1:]))
    own = (*_OF_CONTACT, "wrinkle_height", "bridging", "yarn_direction", "curvature")
    changing = {name for name in first if name.split("/")[-1].startswith(own)}
    paraview.write_by_rank(
        comm,
        directory / f"series{forming.suffix}.vtkhdf",
        cloth,
        notes,
        times,
        paraview.CHANGING | changing,
    )
    if not forming.tools or forming.suffix not in ("", "_ply1"):
        return
    facets = [tool.surface.facets() for tool in forming.tools]
    tools = (_tools(forming, facets, state) for state in states)
    paraview.write_by_rank(comm, directory / "tools.vtkhdf", tools, notes, times, {"Points"})


# -- pictures --------------------------------------------------------------------------------------


def draw_all(
    directory: Path, forming: Forming, formed: Formed, record: Record, summary: dict[str, Any]
) -> list[str]:
    """Draw the formed blank and the curves; returns the pictures' names. Collective.

    One in space that cannot be drawn here is left out, with a word in the log.
    """
    comm, title = forming.network.comm, pictures.plain_text(summary["title"])
    drawn = figures_of(forming, formed, record.table(), title)
    written = []
    for name, draw in drawn.items():
        try:
            pictures.save(comm, directory / name, draw)
        except InputError as error:  # the results are worth more than a picture of them
            record.log.warning("no %s: %s", name, error)
        else:
            written.append(name)
    return written


def figures_of(
    forming: Forming, formed: Formed, table: Mapping[str, Any], title: str = ""
) -> dict[str, partial[Figure]]:
    """What draws each picture of a forming, on rank 0, by the name of its file. Collective."""
    frames = [frame_of(forming, state) for state in _of_the_way(formed.states)]
    last = formed.states[-1]
    return {
        "formed.png": partial(scene.formed, frames[-1:], title),
        **({"stages.png": partial(scene.formed, frames, title)} if len(frames) > 1 else {}),
        **_of_plies(forming, last, title),
        **_modes(forming, formed, title),
        **(_shadow(forming, formed, title) if isinstance(forming, Drape) else {}),
        **curves_of(table, [stage.name for stage in forming.stages], title),
    }


def _modes(forming: Forming, formed: Formed, title: str) -> dict[str, partial[Figure]]:
    """The softest shapes of the last state, on the flat blank. Collective."""
    if formed.modes is None:
        return {}
    at = forming.blank.cloth_at[forming.blank.ply.nodes.of_hinge]
    sizes = {
        f"mode {i}": np.linalg.norm(shape[at], axis=1)
        for i, shape in enumerate(formed.modes.shapes, 1)
    }
    sample: Any = sample_map(forming.network, sizes)  # on rank 0, which draws it
    label, text = "displacement, size (largest: 1)", f"{title}\nsoftest shapes at the end".strip()
    return {"mode.png": partial(pictures.maps, sample, label, text)}


def curves_of(
    table: Mapping[str, Any], stages: Sequence[str], title: str = ""
) -> dict[str, partial[Figure]]:
    """What draws the curves of a forming: of columns of forces.csv, and the names of its stages."""
    name, share = np.array(table["stage"]), np.array(table["share_percent"], float)
    number = np.cumsum([0, *((name[1:] != name[:-1]) | (np.diff(share) <= 0.0))])
    time = np.append(0.0, number + 0.01 * share)

    def over_time(begin: str, end: str) -> dict[str, np.ndarray]:
        """Columns by what stands between in their names, from zero on."""
        found = {name.removeprefix(begin).removesuffix(end): np.array(values, float)
                 for name, values in table.items()
                 if name.startswith(begin) and name.endswith(end)}  # fmt: skip
        return {name: np.append(0.0, values) for name, values in found.items()}

    numbered = [f"{k} {name}" for k, name in enumerate(stages, 1)]
    axis = "stages done" if len(stages) > NAMED_STAGES else f"stages done ({', '.join(numbered)})"
    forces = over_time("", "_force_z_N")
    lines = {
        "tool_forces.png": (
            {name: force for name, force in forces.items() if f"{name}_x_mm" in table},
            "force on the cloth, along z (N)",
        ),
        "draw_in.png": (over_time("draw_in_", "_mm"), "largest draw-in (mm)"),
    }
    drawn = {
        name: partial(
            pictures.curves, {key: (time, y) for key, y in of.items()}, (axis, label), title
        )
        for name, (of, label) in lines.items()
        if of
    }
    energies = over_time("energy_", "_J")
    energies["bending"] += energies.pop("out_of_plane_bending")
    spent = over_time("dissipated_", "_J")
    energies |= {name.replace("in_", "dissipated in "): values for name, values in spent.items()}
    unit, joule = energy_unit(sum(energies.values()))
    energies = {name: energy / joule for name, energy in energies.items()}
    labels = axis, f"energy ({unit})"
    return drawn | {"energy.png": partial(pictures.stacked, time, energies, labels, title)}


def _shadow(forming: Drape, formed: Formed, title: str) -> dict[str, Any]:
    """The picture of what a drape test's instrument shows. Collective."""

    def rings(shape: shapely.Geometry | None) -> list[list[np.ndarray]]:
        pieces = [] if shape is None else shapely.get_parts(shape)
        return [
            [MM * shapely.get_coordinates(ring) for ring in (piece.exterior, *piece.interiors)]
            for piece in pieces
        ]

    shadow, flat = (rings(forming.shadow(s)) for s in (formed.states[-1], forming.blank.start()))
    told = forming.figures(formed)["drape"]
    words = f"{title}: drape coefficient {told['coefficient_percent']:.1f} %"
    if "folds" in told:
        words += f", {told['folds']} folds"
    disc = MM * forming.test.support_radius.si
    warp = float(np.arctan2(*forming.network.preform.warp_direction[::-1]))
    draw = partial(pictures.shadow, shadow, flat[0] if flat else [], disc, warp, words)
    return {"shadow.png": draw}


def view_of(forming: Forming, formed: Formed) -> View:
    """View in space for the report, from the flat blank on. Collective; empty but on rank 0."""
    every = [forming.blank.start(), *formed.states]
    view = View(tools={tool.name: tool.surface.facets() for tool in forming.tools})
    largest = max(forming.networks, key=lambda net: net.num_crossovers_global)
    each = len(forming.each)  # as many times as many values
    for k in steps_shown(largest, len(every), (3 + len(VIEWED)) * each - 3):
        state = every[k]
        surfaces = []
        for one in forming.each:
            columns = crossover_columns(one, state)
            place = 1e-3 * np.column_stack([columns[f"{letter}_mm"] for letter in "xyz"])
            values = {
                quantity(name).axis: np.where(columns["carrying"], columns[name], np.nan)
                for name in VIEWED
            }
            angle = values.pop(quantity("shear_deg").axis)
            values = {pictures.SIZE_LABEL: abs(angle), **values}
            surfaces.append(sample_surface(one.network, place, values))
        view.surfaces.append(together(surfaces))
        view.captions.append(when(forming, state) if k else "flat blank")
        for tool, node in zip(forming.tools, forming.blank.tool_node, strict=True):
            there = state.factors.get(tool.name, 1.0) > 0.0
            pose = Pose(state.x[node], state.hold.rotations[tool.name]) if there else None
            view.poses.setdefault(tool.name, []).append(pose)
    return view


def draw_animation(directory: Path, forming: Forming, formed: Formed, title: str) -> None:
    """Write animation.gif, the blank among its tools at all results, or so many evenly. Collective.

    InputError on every rank if nothing here can render.
    """
    frames = [frame_of(forming, state) for state in _of_the_way(formed.states, MOST_FRAMES)]

    def draw() -> None:
        scene.animate(frames, directory / "animation.gif", pictures.plain_text(title))

    on_root(forming.network.comm, draw)


def _of_plies(forming: Forming, state: State, title: str) -> dict[str, Any]:
    """Pictures of each ply: formed, if there are several; maps of it flat; wrinkles. Collective."""
    drawn: dict[str, Any] = {}
    for one in forming.each:
        name = f"{title}, ply {one.blank.name}" if one.blank.name else title
        if one.suffix:
            frame = frame_of(one, state)
            drawn[f"formed{one.suffix}.png"] = partial(scene.formed, [frame], name)
        height = _heights(one, state)
        drawn |= _flat_maps(one, state, height, name)
        if height is not None:
            frame = frame_of(one, state, MM * height)
            picture = partial(scene.formed, [frame], name, WRINKLES)
            drawn[f"wrinkles{one.suffix}.png"] = picture
    return drawn


def _flat_maps(
    forming: Forming, state: State, height: np.ndarray | None, title: str
) -> dict[str, Any]:
    """Maps of the flat blank, which no tool hides: shear, and wrinkles if there are. Collective."""
    fields = forming.blank.ply.fields(forming.blank.of_cloth(state))
    shear = np.where(fields["carrying"], np.rad2deg(fields["shear_angle"]), np.nan)
    shown = {f"shear_map{forming.suffix}.png": (shear, "shear angle (°)")}
    if height is not None:
        shown[f"wrinkle_map{forming.suffix}.png"] = (MM * height, WRINKLES)
    told = f"{title}\n{when(forming, state)}, on the flat blank"
    drawn: dict[str, Any] = {}
    for name, (values, label) in shown.items():
        sample: Any = sample_map(forming.network, {"": values})  # on rank 0, which draws it
        drawn[name] = partial(pictures.maps, sample, label, told)
    return drawn


def _heights(forming: Forming, state: State) -> np.ndarray | None:
    """Heights of wrinkles at this rank's crossovers, m; None, where there are none. Collective."""
    height, blank = Waves.of(forming.blank, state).height, forming.blank
    noticed = most(blank.comm, np.nan_to_num(height), 0.0) > NOTICED * blank.thickness
    return height if noticed else None


def _of_the_way(states: Sequence[State], most: int = FRAMES) -> list[State]:
    """Up to so many of the states, evenly, and the last."""
    taken = np.linspace(0, len(states) - 1, min(most, len(states)))
    return [states[round(k)] for k in taken]


def frame_of(forming: Forming, state: State, values: np.ndarray | None = None) -> scene.Frame:
    """A state for pictures in space, through crossovers or every k-th of them, on rank 0.

    ``values`` at this rank's crossovers, (n_owned,); by default the shear angle in degrees.
    Collective; nothing is in it on other ranks.
    """
    surfaces = []
    for one in forming.each:
        network, blank = one.network, one.blank
        fields = blank.ply.fields(blank.of_cloth(state))
        place = blank.ply.nodes.rest[blank.ply.nodes.of_hinge] + fields["displacement"]
        shown = values
        if shown is None:
            shown = np.where(fields["carrying"], np.rad2deg(fields["shear_angle"]), np.nan)
        surfaces.append(sample_surface(network, place, {"": abs(shown)}))
    surface = together(surfaces)
    facets = [tool.surface.facets() for tool in forming.tools]
    tools: dict[bool, list[Facets]] = {True: [], False: []}
    for tool, placed in zip(forming.tools, _tool_facets(forming, state, facets), strict=True):
        if state.factors.get(tool.name, 1.0) > 0.0:
            tools[tool.name in forming.below].append(placed)
    return scene.Frame(
        surface.points, surface.values[""], surface.triangles, surface.yarns,
        _joined(tools[True]), _joined(tools[False]), when(forming, state),
    )  # fmt: skip


def when(forming: Forming, state: State) -> str:
    """Stage and how far it is."""
    number = stage_number(state.time)
    return f"{forming.stages[number].name}, {100.0 * (state.time - number):.4g} %"


def _cloth(forming: Forming, state: State) -> dict[str, np.ndarray]:
    """Arrays of this rank's partition of the cloth. Collective."""
    network, blank, ply = forming.network, forming.blank, forming.blank.ply
    cloth = blank.of_cloth(state)
    moved = ply.displacement(cloth)[1]
    arrays = paraview.arrays(network, Fields(state.time, 0.0, ply.fields(cloth), moved))
    arrays["Points"][:, 2] += blank.height  # where the ply lies
    node = np.flatnonzero(~network.node_is_hinge)
    at = np.concatenate([ply.nodes.of_hinge, ply.nodes.of_network_node[node]])
    touch = contact_fields(blank, state)
    waves = Waves.of(blank, state)
    points = {f"{name.replace(' ', '_')}_mm": MM * values[at] for name, values in touch.items()}
    points["contact_pressure_kPa"] = KPA / MM * points.pop("pressure_mm")
    for name, values in {"wrinkle_height": waves.height, "bridging": waves.bridging}.items():
        both = np.concatenate([values, node_means(network, values)[node]])
        points[f"{name}_mm"] = MM * both
    arrays |= {f"PointData/{name}": values.astype("f4") for name, values in points.items()}
    crossover, arm = np.nonzero(network.arm_length > 0)
    along = np.stack(yarn_directions(blank, state))[arm % 2, crossover]
    arrays["CellData/yarn_direction"] = along.astype("f4")
    arrays["CellData/curvature_per_m"] = waves.curvature[crossover, arm % 2].astype("f4")
    return arrays


def _tools(forming: Forming, facets: list, state: State) -> dict[str, np.ndarray]:
    """Arrays of the tools' triangles, on rank 0; the other ranks have none."""
    return tool_arrays(_tool_facets(forming, state, facets), forming.network.comm.rank == 0)


def tool_arrays(every: Sequence[Facets], mine: bool) -> dict[str, np.ndarray]:
    """Arrays of tools' triangles where they stand; none on a rank that has none of them."""
    points, triangles = _joined(every)
    number = np.repeat(np.arange(len(every)), [len(cells) for _, cells in every])
    if not mine:
        points, triangles, number = points[:0], triangles[:0], number[:0]
    parts = int(mine)
    return {
        "NumberOfPoints": np.full(parts, len(points)),
        "NumberOfCells": np.full(parts, len(triangles)),
        "NumberOfConnectivityIds": np.full(parts, triangles.size),
        "Points": points,
        "Connectivity": triangles.ravel(),
        "Offsets": 3 * np.arange(len(triangles) + parts),
        "Types": np.full(len(triangles), VTK_TRIANGLE, np.uint8),
        "CellData/tool": number.astype(np.int32),
    }


def _tool_facets(forming: Forming, state: State, facets: Sequence[Facets]) -> list[Facets]:
    """Triangles of each tool as it stands; of one that has been removed, all in one point."""
    every = []
    for tool, node, (corners, triangles) in zip(
        forming.tools, forming.blank.tool_node, facets, strict=True
    ):
        points = Pose(state.x[node], state.hold.rotations[tool.name]).to_lab(corners)
        if state.factors.get(tool.name, 1.0) == 0.0:
            points[:] = points.mean(axis=0)
        every.append((points, triangles))
    return every


def _joined(every: Sequence[Facets]) -> Facets:
    """Triangles of several tools as one."""
    first = np.cumsum([0, *(len(points) for points, _ in every)])
    return (
        np.concatenate([np.zeros((0, 3)), *(points for points, _ in every)]),
        np.concatenate(
            [
                np.zeros((0, 3), np.int64),
                *(cells + n for (_, cells), n in zip(every, first, strict=False)),
            ]
        ),
    )
