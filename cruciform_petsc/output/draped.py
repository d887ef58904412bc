# SPDX-License-Identifier: MIT
"""What a fishnet leaves: tables, files for ParaView, pictures, figures for the summary."""

from __future__ import annotations

import logging
from collections.abc import Mapping
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ..equilibrium.state import State
from ..errors import InputError
from ..experiments.result import State as Fields
from ..forming.draping import Draping
from ..forming.measures import across, yarn_directions
from ..quantities import energy_unit, quantity
from . import paraview, pictures, scene
from .formed import MM, tool_arrays
from .provenance import provenance
from .sample import sample_map, sample_surface
from .tables import write_crossovers
from .view import View

if TYPE_CHECKING:
    from ..case.schema import Case

# What a net without forces has nothing to say of.
_MECHANICAL = (
    "CellData/strain", "CellData/tension", "CellData/bending", "CellData/out_of_plane",
)  # fmt: skip
VIEWED = ("shear_deg", "thickness_mm")  # columns that the view in space may show


def summarize(case: Case, draping: Draping, statistics: Mapping[str, Any]) -> dict[str, Any]:
    """All figures of a fishnet. Collective."""
    return {
        "title": case.title,
        "kind": draping.kind,
        "finite": True,
        "crossovers": statistics["crossovers"],
        "dofs": 3 * draping.draped.laid.joints,
        "network": dict(statistics),
        "case": case.model_dump(),
        **provenance(draping.network.comm),
        **draping.results(),
    }


def tell_outcome(log: logging.Logger, summary: Mapping[str, Any], directory: Path) -> None:
    """The result in a few lines."""
    log.info("")
    text = "{shear_max_deg:.2f} deg at most, 99 % of crossovers up to {shear_p99_deg:.2f} deg"
    log.info("shear angle   %s", text.format_map(summary))
    at, net = summary["shear_max_at_mm"], summary["fishnet"]
    places = [", ".join(f"{v + 0.0:.4g}" for v in at[key]) for key in ("flat", "in_space")]
    log.info("              largest at %s mm of the flat blank, %s mm in space", *places)
    x, y = net["seed_mm"]
    log.info(
        "seed          %.4g, %.4g mm of the flat blank, at %s mm; warp %.4g deg from x in plan, "
        "%.4g deg to the weft", x, y, ", ".join(f"{v + 0.0:.4g}" for v in net["place_mm"]),
        net["warp_heading_deg"], net["between_deg"],
    )  # fmt: skip
    unit, size = energy_unit(net["shear_energy_j"])
    log.info("energy        shear %.4g %s", net["shear_energy_j"] / size, unit)
    if "least_energy" in net:
        text = "              the least of {nets} coarse nets, {coarse_energy_j:.4g} J; begun with "
        text += "{coarse_energy_before_j:.4g} J"
        log.info("%s", text.format_map(net["least_energy"]))
    log.info("memory        %.0f MiB on the largest rank", max(summary["peak_mib_per_rank"]))
    log.info("results in    %s", directory)


def crossover_columns(draping: Draping) -> dict[str, np.ndarray]:
    """Columns of fields.csv at this rank's crossovers, (n_owned,) each. Collective.

    Those of a forming that geometry tells (docs/files.md); NaN where nothing is laid.
    """
    network, laid = draping.network, draping.draped.laid
    fields = draping.fields()
    place = np.where(laid.laid[:, None], laid.crossovers, np.nan)
    along = np.stack(yarn_directions(draping.blank, draping.state))
    along[:, ~laid.laid] = np.nan
    normal = across(*along)
    area = np.cos(fields["shear_angle"])
    mass, fraction = (
        np.nan if value is None else value
        for value in (network.fabric.areal_density, network.fabric.fibre_volume_fraction)
    )
    return {
        "x_rest_mm": MM * network.crossover_position[:, 0],
        "y_rest_mm": MM * network.crossover_position[:, 1],
        **{f"{letter}_mm": MM * place[:, axis] for axis, letter in enumerate("xyz")},
        **{f"warp_{letter}": along[0, :, axis] for axis, letter in enumerate("xyz")},
        **{f"weft_{letter}": along[1, :, axis] for axis, letter in enumerate("xyz")},
        **{f"normal_{letter}": normal[:, axis] for axis, letter in enumerate("xyz")},
        "shear_deg": np.rad2deg(fields["shear_angle"]),
        "area_ratio": area,
        "areal_density_g_per_m2": 1e3 * mass / area,
        "thickness_mm": MM * draping.thickness / area,
        "fibre_volume_fraction_at_constant_thickness": fraction / area,
        "carrying": fields["carrying"],
    }


def write_fields(path: Path, draping: Draping) -> None:
    """Write fields.csv, a row for each crossover, in one order on any ranks. Collective."""
    write_crossovers(draping.network, path, crossover_columns(draping))


def curve(summary: Mapping[str, Any]) -> dict[str, list[float]]:
    """Columns of curve.csv: one row of what sweeps and scripts read of a fishnet."""
    net, at = summary["fishnet"], summary["shear_max_at_mm"]
    row = {
        "shear_max_deg": summary["shear_max_deg"],
        "shear_p99_deg": summary["shear_p99_deg"],
        "energy_shear_J": net["shear_energy_j"],
        "warp_heading_deg": net["warp_heading_deg"],
        "between_deg": net["between_deg"],
        **{f"seed_{letter}_mm": v for letter, v in zip("xy", net["seed_mm"], strict=True)},
        **{f"place_{letter}_mm": v for letter, v in zip("xyz", net["place_mm"], strict=True)},
        **{f"shear_max_{letter}_rest_mm": v for letter, v in zip("xy", at["flat"], strict=False)},
    }
    return {name: [value] for name, value in row.items()}


def write_series(directory: Path, draping: Draping, notes: Mapping[str, Any]) -> None:
    """Write series.vtkhdf, the cloth flat and laid, and tools.vtkhdf. Collective.

    Arrays are those of a forming that geometry tells; of a net that has locked, the laid state
    alone, with what is not laid in one point.
    """
    comm, blank, tool = draping.network.comm, draping.blank, draping.tools[0]
    whole = not draping.draped.laid.limit
    states = [blank.start(), draping.state] if whole else [draping.state]
    every = [_arrays(draping, state, draping.fields(state)) for state in states]
    times = np.array([state.time for state in states])
    notes = {**notes, "time_is": "0 flat, 1 laid"}
    changing = paraview.CHANGING | {"CellData/yarn_direction"}
    changing &= set(every[0])
    paraview.write_by_rank(comm, directory / "series.vtkhdf", iter(every), notes, times, changing)
    points, triangles = tool.surface.facets()
    facets = [(tool.start.to_lab(points), triangles)]
    tools = iter([tool_arrays(facets, comm.rank == 0)] * len(states))
    paraview.write_by_rank(comm, directory / "tools.vtkhdf", tools, notes, times, {"Points"})


def _arrays(draping: Draping, state: State, fields: Mapping[str, Any]) -> dict[str, np.ndarray]:
    """Arrays of this rank's partition of the cloth. Collective."""
    network, blank = draping.network, draping.blank
    moved = blank.ply.displacement(state)[1]
    arrays = paraview.arrays(network, Fields(state.time, 0.0, fields, moved))
    arrays["Points"][:, 2] += 0.5 * draping.thickness  # where the flat blank lies
    crossover, arm = np.nonzero(network.arm_length > 0)
    along = np.stack(yarn_directions(blank, state))[arm % 2, crossover]
    arrays["CellData/yarn_direction"] = along.astype("f4")
    return {name: array for name, array in arrays.items() if not name.startswith(_MECHANICAL)}


def frame_of(draping: Draping) -> scene.Frame:
    """The laid cloth for a picture in space, on rank 0. Collective."""
    columns = crossover_columns(draping)
    place = 1e-3 * np.column_stack([columns[f"{letter}_mm"] for letter in "xyz"])
    surface = sample_surface(draping.network, place, {"": abs(columns["shear_deg"])})
    tool = draping.tools[0]
    points, triangles = tool.surface.facets()
    placed, none = (tool.start.to_lab(points), triangles), (np.zeros((0, 3)), np.zeros((0, 3), int))
    below = bool(draping.below)
    return scene.Frame(
        surface.points, surface.values[""], surface.triangles, surface.yarns,
        placed if below else none, none if below else placed, "laid as a fishnet",
    )  # fmt: skip


def draw_all(directory: Path, draping: Draping, title: str, log: logging.Logger) -> list[str]:
    """Draw the laid cloth, and its shear on the flat blank; returns the pictures' names.

    Collective. One in space that cannot be drawn here is left out, with a word in the log.
    """
    comm, title = draping.network.comm, pictures.plain_text(title)
    shear = abs(crossover_columns(draping)["shear_deg"])
    sample: Any = sample_map(draping.network, {"shear": shear})
    told = f"{title}\nshear angle, on the flat blank".strip()
    drawn = {
        "formed.png": partial(scene.formed, [frame_of(draping)], title),
        "shear_map.png": partial(pictures.maps, sample, pictures.SIZE_LABEL, told),
    }
    written = []
    for name, draw in drawn.items():
        try:
            pictures.save(comm, directory / name, draw)
        except InputError as error:  # the results are worth more than a picture of them
            log.warning("no %s: %s", name, error)
        else:
            written.append(name)
    return written


def view_of(draping: Draping) -> View:
    """View in space for the report: flat, if all is laid, and laid. Empty but on rank 0."""
    network, tool = draping.network, draping.tools[0]
    columns = crossover_columns(draping)
    place = 1e-3 * np.column_stack([columns[f"{letter}_mm"] for letter in "xyz"])
    values = {quantity(name).axis: abs(columns[name]) for name in VIEWED}
    values = {pictures.SIZE_LABEL: values.pop(quantity("shear_deg").axis), **values}
    view = View(tools={tool.name: tool.surface.facets()}, poses={tool.name: []})
    if not draping.draped.laid.limit:
        flat = np.pad(network.crossover_position, ((0, 0), (0, 1)))
        flat[:, 2] = 0.5 * draping.thickness
        at_rest = {name: np.zeros_like(value) for name, value in values.items()}
        thickness = quantity("thickness_mm").axis
        at_rest[thickness] = np.full(len(flat), MM * draping.thickness)
        view.surfaces.append(sample_surface(network, flat, at_rest))
        view.captions.append("flat blank")
        view.poses[tool.name].append(tool.start)
    view.surfaces.append(sample_surface(network, place, values))
    view.captions.append("laid as a fishnet")
    view.poses[tool.name].append(tool.start)
    return view
