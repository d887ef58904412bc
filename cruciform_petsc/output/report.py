# SPDX-License-Identifier: MIT
"""One self-contained page about a run: report.html, for people who did not make it.

Pictures are embedded and nothing is loaded from anywhere: the template escapes every text, and a
content security policy in the page forbids scripts, but for the one that turns a cloth in space.
"""

from __future__ import annotations

import base64
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ..cloth.datasheet import assumed_shear
from ..parallel import on_root
from ..quantities import (
    angle_text,
    force_text,
    force_unit,
    quantity,
    si_text,
    tension_text,
)
from ..units import format_si
from .figures import colour_of
from .log import last, stability_texts
from .tables import written_whole
from .view import View, packed, view_of_test
from .view import script as viewer

if TYPE_CHECKING:
    from mpi4py import MPI

    from ..case.schema import Case
    from ..cloth.fabric import Fabric
    from ..experiments.experiment import Experiment
    from ..experiments.result import TestResult

MAPS = {  # {at}: the last value asked for
    "scene.png": "The yarns in space {at}, coloured by shear angle; "
    "yarn cross-sections are illustrative.",
    "formed.png": "The formed blank {at}, coloured by the size of the shear angle, on its tools; "
    "those from above are cut open in front.",
    "stages.png": "Stages of the test in true scale, with one colour scale.",
    "wrinkle_map.png": "Height of wrinkles {at}, drawn on the flat blank.",
    "wrinkles.png": "Height of waves that no tool has, over and below their neighbourhood.",
    "yarns.png": "Yarns before and after the test, coloured by {colour}.",
    "shear_map.png": "Shear angle {at}, drawn on the undeformed specimen.",
    "height_map.png": "Height out of the plane {at}, drawn on the undeformed specimen.",
    "tension_map.png": "Tension of the yarns {at}, drawn on the undeformed specimen.",
    "with_and_without_bending.png": "The same with and without yarns that resist bending.",
}
CAPTIONS = MAPS | {  # and Experiment.captions
    "mode.png": "Shape of the cloth where it becomes unstable, or of the linearised problem, at "
    "rest; its size is arbitrary.",
    "lowest_stiffness.png": "Lowest stiffness: where it is zero the cloth becomes unstable, below "
    "it would leave its state.",
    "energy.png": "Strain energy: tension, shear, yarn bending.",
    "tension_surface.png": "Tensions of the cloth by both strains: colours are the law's, discs "
    "(of a surface) what was measured, the line where this test has been, in the mean.",
    "tool_forces.png": "Forces of the tools on the cloth, upwards.",
    "shadow.png": "Shadow of the draped cloth on the disc, and the flat cloth (dashed).",
    "draw_in.png": "How far the edges have moved inwards in plan, at most.",
    "zones.png": "Shear angle of the zones, with the kinematics of an inextensible net.",
    "centre_line.png": "Shear angle along the specimen's long axis.",
    "shear_against_load.png": "Shear angle against the load.",
    "ladder.png": "Difference to the membrane as the network is refined.",
}
FORMING_CAPTIONS = {
    "stages.png": "On the way there, in true scale and with one colour scale.",
    "shear_map.png": "Shear angle {at}, with its sign, drawn on the flat blank.",
    "energy.png": "Energy: stored in cloth and contact; dissipated by friction.",
    "mode.png": "Softest shapes of the cloth among its tools at the end; their size is arbitrary.",
}
FISHNET_CAPTIONS = {
    "formed.png": "The blank laid on the tool, coloured by the size of the shear angle.",
    "shear_map.png": "Size of the shear angle, drawn on the flat blank.",
}
WIDE = 1.6  # pictures wider than this, by their height, have a line to themselves; stages.png has
LEAST = 420  # pixels of width of a picture, two of which go into a row
NOISE = 1e-9  # of the total (energies), or degrees: rounding, told as 0
STAGES = {
    "network": "network made",
    "set_up": "tools and blank set up",
    "solve": "solved",
    "solve_without_bending": "solved without yarn bending, to compare",
    "write": "results written",
    "continuum": "membrane solved and compared",
    "ladder": "finer networks compared with the membrane",
    "pictures": "pictures drawn",
    "scene": "yarns drawn in space",
    "animation": "animation drawn",
    "total": "in all",
}


@dataclass
class Table:
    """Heads and rows of text; columns of numbers are aligned to the right."""

    heads: Sequence[str]
    rows: Sequence[Sequence[str]]

    @classmethod
    def of(cls, columns: Mapping[str, Sequence[str]]) -> Table:
        """Make it of columns by their heads."""
        return cls(list(columns), list(zip(*columns.values(), strict=True)))

    @cached_property
    def right(self) -> list[bool]:
        """Whether a column is one of numbers."""
        return [all(map(_is_number, column)) for column in zip(*self.rows, strict=True)]


def write_report(
    directory: Path,
    case: Case,
    result: TestResult,
    summary: Mapping[str, Any],
    pictures: Sequence[str] = (),
) -> None:
    """Write report.html into a folder of results. Collective; rank 0 writes.

    The summary is as it goes into summary.json; pictures are files in the folder, curves among them
    embedded in this order. A test in space has a view that can be turned.
    """
    view = view_of_test(result)
    curve, experiment = result.curve(states=True), result.experiment
    at, captions = last_control(curve), CAPTIONS | experiment.captions
    colour = colour_of(result)
    maps = [directory / name for name in MAPS if name in pictures]
    curves = [directory / name for name in pictures if name not in MAPS]

    def sections() -> dict[str, Any]:
        return {
            "key_figures": _key_figures(experiment, summary),
            "note": f"{_sentence(at)} Largest yarn tension: "
            f"{tension_text(summary['yarn_tension_max'])}.{_closed_form(summary)}",
            "maps": gallery(maps, captions, at, colour),
            "striped": experiment.cut_across and any(p.name.endswith("_map.png") for p in maps),
            "curves": gallery(curves, captions),
            "results": curve_table(curve),
            "measured_table": _measured(summary.get("measured", {})),
            "continuum": _continuum(summary, curve),
            "increments": _increments(summary, experiment),
        }

    _write(result.network.comm, directory, case, summary, sections, view)


def write_forming_report(
    comm: MPI.Intracomm,
    directory: Path,
    case: Case,
    summary: Mapping[str, Any],
    steps: Mapping[str, Sequence],
    pictures: Sequence[str] = (),
    view: View | None = None,
) -> None:
    """Write report.html of a forming; ``steps`` are the columns of forces.csv. Collective."""
    maps = [directory / name for name in pictures if name in MAPS]
    curves = [directory / name for name in pictures if name not in MAPS]
    asked = np.flatnonzero([*steps["asked"][:-1], True])  # the last one in any case
    at = f'at {steps["share_percent"][-1]:.4g} % of stage "{steps["stage"][-1]}"'

    def sections() -> dict[str, Any]:
        told = [name for name in steps if name.endswith(("_force_z_N", "shear_max_deg"))]
        told += [name for name in steps if name.startswith("draw_in_")]
        results = {"stage": steps["stage"], "share (%)": numbers(steps["share_percent"])}
        results |= {
            f"{quantity(name).name} ({quantity(name).unit})": numbers(steps[name]) for name in told
        }
        rows = Table.of(results).rows
        effort = results | {
            "Newton iterations": [f"{n}" for n in steps["newton_iterations"]],
            "time (s)": [f"{s:.2f}" for s in steps["seconds"]],
        }
        return {
            "key_figures": _forming_figures(summary),
            "note": _sentence(at),
            "maps": gallery(maps, CAPTIONS | FORMING_CAPTIONS, at),
            "striped": False,
            "curves": gallery(curves, CAPTIONS | FORMING_CAPTIONS),
            "results": Table(list(results), [rows[i] for i in asked]),
            "measured_table": None,
            "continuum": _formed_continuum(summary),
            "increments": Table.of({k: effort[k] for k in (*list(effort)[:2], *list(effort)[-2:])}),
        }

    _write(comm, directory, case, summary, sections, view)


def write_fishnet_report(
    comm: MPI.Intracomm,
    directory: Path,
    case: Case,
    summary: Mapping[str, Any],
    pictures: Sequence[str] = (),
    view: View | None = None,
) -> None:
    """Write report.html of a fishnet. Collective."""

    def sections() -> dict[str, Any]:
        net, at = summary["fishnet"], summary["shear_max_at_mm"]
        rows = {
            "seed on the flat blank (mm)": net["seed_mm"],
            "seed in space (mm)": net["place_mm"],
            "warp there, in plan, from x (°)": [net["warp_heading_deg"]],
            "from warp to weft there (°)": [net["between_deg"]],
            "largest shear angle, on the flat blank (mm)": at["flat"],
            "largest shear angle, in space (mm)": at["in_space"],
        }
        if "least_energy" in net:
            found = net["least_energy"]
            rows["coarse nets tried for the least energy"] = [found["nets"]]
            energies = [1e3 * found[key] for key in ("coarse_energy_before_j", "coarse_energy_j")]
            rows["energy of the first and of the best of them (mJ)"] = energies
        energy = 1e3 * net["shear_energy_j"]
        return {
            "key_figures": [
                (name, summary[key], angle_text(summary[key], "°"))
                for name, key in (
                    ("largest shear angle (absolute)", "shear_max_deg"),
                    ("shear angle that 99 % keep to", "shear_p99_deg"),
                )
            ] + [("energy of shear", energy, f"{energy:.4g} mJ")],
            "note": "Laid by geometry alone: yarns keep their lengths, no forces were asked for.",
            "maps": gallery([directory / name for name in pictures], FISHNET_CAPTIONS),
            "striped": False,
            "curves": [],
            "results": Table(["", "x, or it", "y", "z"], [
                [name, *numbers(values), *[""] * (3 - len(values))] for name, values in rows.items()
            ]),
            "measured_table": None,
            "continuum": None,
            "increments": None,
        }  # fmt: skip

    _write(comm, directory, case, summary, sections, view)


def _write(
    comm: MPI.Intracomm,
    directory: Path,
    case: Case,
    summary: Mapping[str, Any],
    sections: Callable[[], dict[str, Any]],
    view: View | None,
) -> None:
    """Put what all reports have, and sections of one kind, into the template. Collective."""

    def write() -> None:
        from jinja2 import Environment, PackageLoader, StrictUndefined

        environment = Environment(
            loader=PackageLoader("cruciform_petsc.output", "."),
            autoescape=True,
            undefined=StrictUndefined,
            trim_blocks=True,
            lstrip_blocks=True,
        )
        environment.filters |= {"sentence": _sentence, "percent": _percent}
        script, script_hash = viewer()
        text = environment.get_template("report.html.j2").render(
            view=None if view is None else packed(view),
            script=script,
            script_hash=script_hash,
            case=case,
            summary=summary,
            words=_words(summary),
            fabric=fabric(case),
            assumed_shear=assumed_shear(summary["fabric"]["assumed"]),
            case_tables=_case(case),
            sizes=_sizes(summary),
            times=[(STAGES.get(name, name), f"{s:.2f} s") for name, s in summary["wall_s"].items()],
            origin=_origin(summary),
            **sections(),
        )
        with written_whole(directory / "report.html") as temporary:
            temporary.write_text(text, encoding="utf-8")

    on_root(comm, write)


# -- sections --------------------------------------------------------------------------------------


def _words(summary: Mapping[str, Any]) -> list[str]:
    kind = summary["kind"].replace("-", " ").replace("off axis", "off-axis").capitalize()
    size = "finite deformation" if summary["finite"] else "small displacements"
    date = str(summary.get("date", ""))[:10]
    return [kind, size, *([date] if date else [])]


def _key_figures(
    experiment: Experiment, summary: Mapping[str, Any]
) -> Iterator[tuple[str, float, str]]:
    """Names of what counts, the values, and how they are shown."""
    for column in experiment.forces:
        force = last(summary[column.lower()])
        yield quantity(column).name, force, force_text(force)
    extension = last(summary["extension_m"])
    yield experiment.movement, extension, si_text(extension, "m")
    for name, key in (
        ("shear angle at the centre point", "shear_centre_deg"),
        ("shear angle, median of the middle zone", "shear_middle_deg"),
        ("largest shear angle (absolute)", "shear_max_deg"),
        ("shear angle, 99 % of the area (absolute)", "shear_99_deg"),
    ):
        angle = last(summary.get(key, np.nan))
        if np.isfinite(angle):
            yield name, angle, angle_text(angle, "°")
    for name, text in stability_texts(summary, experiment.column):
        yield name, 1.0, _signed(text)
    energy = sum(last(value) for value in summary["energy_j"].values())
    shown = f"{energy:.4g} J" if abs(energy) >= 1.0 else f"{1e3 * energy:.4g} mJ"
    yield "strain energy", energy, shown


def _closed_form(summary: Mapping[str, Any]) -> str:
    """The sentence about it, behind another one."""
    return f" {_sentence(summary['closed_form']['sentence'])}" if "closed_form" in summary else ""


def _forming_figures(summary: Mapping[str, Any]) -> Iterator[tuple[str, float, str]]:
    """The same of a forming."""
    if "drape" in summary:
        share = summary["drape"]["coefficient_percent"]
        yield "drape coefficient", share, f"{share:.1f} %"
    if "inflation" in summary:
        rise = 1e-3 * summary["inflation"]["rise_mm"][-1]
        yield "rise", rise, si_text(rise, "m")
    for name, (_, _, force) in summary["tool_force_n"].items():
        yield f"{name}, force along z", force, _signed(force_text(force))
    for name, key in (
        ("largest shear angle (absolute)", "shear_max_deg"),
        ("shear angle that 99 % keep to", "shear_p99_deg"),
    ):
        yield name, summary[key], angle_text(summary[key], "°")
    drawn = 1e-3 * max(summary["draw_in_mm"].values(), default=0.0)
    yield "largest draw-in", drawn, si_text(drawn, "m")
    height = 1e-3 * summary["wrinkles"]["largest_height_mm"]
    yield "largest height of wrinkles", height, si_text(height, "m")


def last_control(curve: Mapping[str, np.ndarray]) -> str:
    """The last value asked for, in words: "at 2 mm extension"."""
    name, values = next(iter(curve.items()))
    scale, unit = _unit(name, values)
    space = "" if unit == "°" else " "
    return f"at {float(np.asarray(values)[-1]) * scale:.4g}{space}{unit} {quantity(name).name}"


def gallery(
    paths: Sequence[Path], captions: Mapping[str, str], at: str = "", colour: str = ""
) -> list[dict[str, Any]]:
    """Pictures with their captions, two in a row, wide ones first and by themselves.

    A picture without a caption has its name: load_against_extension.png is that.
    """
    pictures = []
    for path in paths:
        data = path.read_bytes()
        width, height = (int.from_bytes(data[i : i + 4], "big") for i in (16, 20))  # PNG header
        caption = captions.get(path.name, f"{path.stem.replace('_', ' ').capitalize()}.")
        wide = width / height > WIDE or path.name == "stages.png"
        pictures.append(
            {
                "caption": caption.format(at=at, colour=colour),
                "width": width,
                "height": height,
                "basis": "100%" if wide else f"min(100%, {LEAST}px)",
                "data": base64.b64encode(data).decode("ascii"),
            }
        )
    return sorted(pictures, key=lambda picture: picture["basis"] != "100%")


def curve_table(curve: Mapping[str, np.ndarray]) -> Table:
    """The curve with its columns' names and units; rounding is told as 0, empty columns not."""
    columns = {}
    total = sum(values for name, values in curve.items() if name.startswith("energy_"))
    for name, values in curve.items():
        if not np.isfinite(values).any():
            continue
        known = quantity(name)
        noise = {"J": NOISE * total, "°": NOISE}.get(known.unit, 0.0)
        scale, unit = _unit(name, values)
        quiet = np.where(np.abs(values) < noise, 0.0, values)
        columns[f"{known.name} ({unit})" if unit else known.name] = numbers(quiet, scale)
    return Table.of(columns)


def _measured(measured: Mapping[str, Any]) -> Table | None:
    """Measured and computed loads; none if the test does not reach any of them."""
    if "rms_relative" not in measured:
        return None
    force, load = np.asarray(measured["measured_n"]), np.asarray(measured["load_n"], float)
    off = [_percent(v, True) if np.isfinite(v) else "" for v in load / force - 1.0]
    return Table.of(
        {
            "displacement (mm)": numbers(measured["displacement_mm"]),
            "measured (N)": numbers(force),
            "computed (N)": numbers(load),
            "difference": off,
        }
    )


def _continuum(
    summary: Mapping[str, Any], curve: Mapping[str, np.ndarray]
) -> dict[str, Any] | None:
    continuum = summary.get("continuum", {})
    if "load_ratio" not in continuum:
        return None
    shown: dict[str, tuple[str, Callable[[float], str]]] = {
        "load_ratio": ("load, network / membrane", _number),
        "energy_ratio": ("energy, network / membrane", _number),
        "relative_l2_displacement": ("difference of displacement", _percent),
        "mean_abs_shear_deg": ("mean difference of shear (°)", _number),
    }
    heads = [name for name, _ in shown.values()]
    control = quantity(next(iter(curve)))
    rows: list[Sequence[str]] = []
    without = continuum.get("without_bending")
    for what, figures in (("", continuum), (" without yarn bending", without)):
        if figures is not None:
            columns = [
                [form(v) for v in np.atleast_1d(figures[key])] for key, (_, form) in shown.items()
            ]
            at = np.asarray(curve[control.column])[-len(columns[0]) :]
            at_text = [f"{value:.4g} {control.unit}{what}" for value in at]
            rows += zip(at_text, *columns, strict=True)
    ladder = [
        [f"{rung['refine']}", f"{rung['crossovers']:,}"]
        + [form(rung[key]) for key, (_, form) in shown.items()]
        for rung in continuum.get("ladder") or []
    ]
    second = "second-gradient " if continuum.get("second_gradient") else ""
    return {
        "text": f"A {second}membrane of the same outline and edges in dolfinx: "
        f"{continuum['cells']:,} cells, {continuum['dofs']:,} unknowns, mesh size "
        f"{si_text(continuum['mesh_size_m'], 'm')}.",
        "table": Table([control.name, *heads], rows),
        "ladder": Table(["refine", "crossovers", *heads], ladder) if ladder else None,
    }


def _formed_continuum(summary: Mapping[str, Any]) -> dict[str, Any] | None:
    """The membrane beside a forming, in its last state."""
    continuum = summary.get("continuum", {})
    if "force_ratio" not in continuum:
        return None
    both = continuum["network"], continuum["membrane"]
    rows = [
        (f"{name}, force along z (N)", *(_number(of["tool_force_n"][name][2]) for of in both))
        for name in continuum["force_ratio"]
    ]
    for name, key in (("largest shear angle (°)", "shear_max_deg"), ("of 99 %", "shear_p99_deg")):
        rows.append((name, *(_number(of[key]) for of in both)))
    rows += [
        (f"largest draw-in, {edge} (mm)", *(_number(of["draw_in_mm"][edge]) for of in both))
        for edge in both[0]["draw_in_mm"]
    ]
    rungs = continuum.get("ladder") or []
    heads = {
        "refine": "refine",
        "crossovers": "crossovers",
        "draw_in_ratio": "draw-in, network / membrane",
        "relative_l2_displacement": "difference of displacement",
        "relative_l2_shear": "difference of shear",
        "mean_abs_shear_deg": "mean difference of shear (°)",
    }
    forces = {f"{n}_force_ratio": f"{n}, network / membrane" for n in continuum["force_ratio"]}
    heads |= forces
    ladder = [[_number(rung[key]) for key in heads] for rung in rungs]
    return {
        "text": f"The same cloth as a hyperelastic membrane in dolfinx among the same tools: "
        f"{continuum['cells']:,} linear triangles along the yarns, {continuum['dofs']:,} unknowns, "
        f"mesh size {si_text(continuum['mesh_size_m'], 'm')}. After {continuum['time']:.4g} stages "
        f"shear angles differ by {continuum['mean_abs_shear_deg']:.2f}° in the mean, displacements "
        f"by {_percent(continuum['relative_l2_displacement'])}. {continuum['note']}; here "
        f"{_percent(continuum['bending_share'])} of the network's strain energy are bending.",
        "table": Table(["", "network", "membrane"], rows),
        "ladder": Table(list(heads.values()), ladder) if ladder else None,
    }


def yarns(fabric: Fabric) -> Table:
    """What is known of both families of yarns."""
    sides = (fabric.warp, fabric.weft)
    biaxial = fabric.biaxial_law
    single = (fabric.warp_tension, fabric.weft_tension)
    tension_laws = [law.name if biaxial is None else biaxial.name for law in single]
    laws = [side.out_of_plane_law for side in sides]
    rows = [
        ["modulus", *(format_si(side.modulus, "N/m") for side in sides)],
        ["Poisson's ratio", *(f"{side.poisson:g}" for side in sides)],
        ["yarns", *(format_si(side.yarns, "1/m") for side in sides)],
        ["bending rigidity of a yarn", *(format_si(side.yarn_bending, "N*m**2") for side in sides)],
        [
            "bending out of the plane, per width",
            *(format_si(law.stiffness0, "N*m") if law else "" for law in laws),
        ],
        ["law of tension", *tension_laws],
    ]
    return Table([fabric.name, "warp", "weft"], rows)


def shear(fabric: Fabric) -> str:
    """Its modulus and law in words."""
    law, at_rest = fabric.shear.name, si_text(fabric.shear_modulus, "N/m")
    words = f"Shear: {at_rest}{', linear' if law == 'linear' else f' at rest, {law}'}."
    if np.isfinite(fabric.shear.last_point):
        words += f" Its data end at {np.rad2deg(fabric.shear.last_point):.1f}°."
    if fabric.shear_viscosity is not None:
        words += f" Viscosity of shear: {fabric.shear_viscosity}."
    if fabric.shear_friction is not None:
        words += f" Friction of shear: {fabric.shear_friction}."
    return words


def fabric(case: Case) -> dict[str, Any]:
    """The fabric's yarns as a table, the rest in words."""
    fabric = case.fabric()
    words = [shear(fabric)]
    words.append(
        "Yarns carry compression like tension."
        if fabric.compression == 1.0
        else f"Stiffness in compression: {fabric.compression:g} of that in tension."
    )
    words += ["Logarithmic strain of the yarns."] if fabric.log_strain else []
    given = case.fabric_table.model_dump(exclude_none=True)
    if given.pop("use", None) and given:
        words.append(f"Changed in the case file: {', '.join(given)}. Of the rest the source:")
        words.append(fabric.source)
    elif fabric.source:
        words.append(f"Source: {fabric.source}")
    text = " ".join(word for word in words if word)
    return {"table": yarns(fabric), "text": text, "filled_in": case.fabric_table.filled_in()}


def _case(case: Case) -> list[tuple[str, list[tuple[str, str]]]]:
    """Tables of the case with their keys and values."""
    tables = case.model_dump(exclude_none=True).items()
    rows = [(name, list(_flat(content))) for name, content in tables if isinstance(content, dict)]
    rows += [
        (f"[{name}]", list(_flat(content)))
        for name in ("tool", "stage")
        for content in dict(tables).get(name, [])
    ]
    return [pair for pair in rows if pair[1]]


def _flat(content: Mapping[str, Any], above: str = "") -> Iterable[tuple[str, str]]:
    """Keys with their tables' names, and values as a case file has them."""
    for key, value in content.items():
        name = f"{above}{key}"
        if isinstance(value, dict):
            yield from _flat(value, f"{name}.")
        elif value != []:
            yield name, _as_written(value)


def _as_written(value: Any) -> str:
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, list):
        return f"[{', '.join(map(_as_written, value))}]"
    return f"{value:.6g}" if isinstance(value, float) else str(value)


def _sizes(summary: Mapping[str, Any]) -> list[tuple[str, str]]:
    network, solver = summary["network"], summary.get("solver", {})
    low, high = network["crossovers_per_rank_min"], network["crossovers_per_rank_max"]
    peak = summary.get("peak_mib_per_rank", [])
    rows = [
        ("crossovers", f"{summary['crossovers']:,}"),
        ("warp yarns, weft yarns", f"{network['warp_yarns']:,}, {network['weft_yarns']:,}"),
        ("unknowns", f"{summary['dofs']:,}"),
        ("crossovers that carry nothing", f"{network.get('hanging_crossovers', 0):,}"),
        ("ranks", f"{summary['ranks']}"),
        ("crossovers on a rank", f"{low:,}" if low == high else f"{low:,} to {high:,}"),
        ("largest memory of a rank", f"{max(peak):,.0f} MiB" if peak else ""),
    ]
    if summary.get("increments"):
        each = f"{summary['newton_iterations_per_increment']:.1f} each"
        rows += [
            ("increments", f"{len(summary['increments'])}"),
            ("Newton iterations", f"{solver['newton_iterations']} ({each})"),
        ]
    words = [str(solver[key]) for key in ("snes", "snes_type", "ksp", "pc") if key in solver]
    return [*rows, ("solvers (PETSc)", ", ".join(words))]


def _increments(summary: Mapping[str, Any], experiment: Experiment) -> Table | None:
    steps, control = summary.get("increments"), experiment.column
    if not steps:
        return None
    forces = {column: [step[column.lower()] for step in steps] for column in experiment.forces}
    columns = {
        f"{control.name} ({control.unit})": numbers(
            [step["control"] for step in steps], 1.0 / control.scale
        ),
        **{f"{quantity(name).name} (N)": numbers(values) for name, values in forces.items()},
        "Newton iterations": [f"{step['newton_iterations']}" for step in steps],
        "mended": [f"{step['shifted']}" for step in steps],
        "cut": [f"{step.get('cuts', 0)}" for step in steps],
        "residual (N)": [f"{step['residual_n']:.1e}" for step in steps],
        "tolerance (N)": [f"{step['tolerance_n']:.1e}" for step in steps],
        "time (s)": [f"{step['seconds']:.2f}" for step in steps],
        "": ["asked for" if step["asked"] else "" for step in steps],
    }
    return Table.of(columns)


def _origin(summary: Mapping[str, Any]) -> list[str]:
    versions = ", ".join(f"{name} {number}" for name, number in summary["versions"].items())
    ranks = f"{summary['ranks']} rank{'s' if summary['ranks'] > 1 else ''}"
    words = [f"Made with {versions}, on {ranks}"]
    words += [str(summary["date"])] if "date" in summary else []
    words += [f"commit {summary['commit']}"] if summary.get("commit") else []
    if "resumed_after_increments" in summary:
        words.append(f"resumed after {summary['resumed_after_increments']} increments")
    return words


# -- numbers as text -------------------------------------------------------------------------------


def numbers(values: Iterable[float | None], scale: float = 1.0) -> list[str]:
    """A column, with as many decimals everywhere as its largest number has of four digits."""
    column = [np.nan if value is None else scale * float(value) for value in values]
    largest = max((abs(value) for value in column if np.isfinite(value)), default=0.0)
    if not 1e-3 <= largest < 1e6:
        return [_number(value) for value in column]
    most = max(0, 3 - int(np.floor(np.log10(largest))))
    digits = max(len(f"{v:.{most}f}".rstrip("0").partition(".")[2]) for v in column)
    return [
        _signed(f"{round(v, digits) + 0.0:.{digits}f}") if np.isfinite(v) else "" for v in column
    ]


def _number(value: float) -> str:
    return _signed(f"{value + 0.0:.4g}") if np.isfinite(value) else ""


def _percent(value: float, signed: bool = False) -> str:
    return _signed(f"{100.0 * value:{'+' if signed else ''}.2f} %")


def _signed(text: str) -> str:
    """With a minus sign in place of a hyphen."""
    return text.replace("-", "\N{MINUS SIGN}")


def _is_number(cell: str) -> bool:
    text = cell.replace(",", "").removesuffix(" %").replace("\N{MINUS SIGN}", "-")
    try:
        float(text or "0")
    except ValueError:
        return False
    return True


def _unit(column: str, values: Any) -> tuple[float, str]:
    """What to multiply a column by, and the unit it then has: mJ, and mN for small loads."""
    unit = quantity(column).unit
    if unit == "J" or (unit == "N" and force_unit(values)[0] == "mN"):
        return 1e3, f"m{unit}"
    return 1.0, unit


def _sentence(text: str) -> str:
    """On one line, from a capital to a full stop."""
    text = " ".join(str(text).split())
    return text[:1].upper() + text[1:] + ("" if text.endswith(".") else ".")
