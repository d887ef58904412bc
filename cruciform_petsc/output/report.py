# SPDX-License-Identifier: MIT
"""One self-contained page about a run: report.html, for people who did not make it.

Pictures are embedded, nothing is loaded from anywhere and nothing is executed: every text of the
case is escaped, and a content security policy in the page forbids scripts besides.
"""

from __future__ import annotations

import base64
from collections.abc import Iterable, Mapping, Sequence
from html import escape
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ..parallel import on_root
from ..units import format_si
from .figures import SMALL_LOAD
from .tables import written_whole

if TYPE_CHECKING:
    from mpi4py import MPI

    from ..case.schema import Case

CAPTIONS = {  # {at}: the last value asked for
    "yarns.png": "Yarns before and after the test, coloured by {colour}.",
    "scene.png": "The yarns in space {at}, coloured by shear angle; "
    "yarn cross-sections are illustrative.",
    "stages.png": "Stages of the test in true scale, with one colour scale.",
    "shear_map.png": "Shear angle {at}, drawn on the undeformed specimen.",
    "tension_map.png": "Tension of the yarns {at}, drawn on the undeformed specimen.",
    "energy.png": "Strain energy: tension, shear, yarn bending.",
    "zones.png": "Shear angle of the zones, with the kinematics of an inextensible net.",
    "centre_line.png": "Shear angle along the specimen's long axis.",
    "shear_against_load.png": "Shear angle against the load.",
    "with_and_without_bending.png": "The same with and without yarns that resist bending.",
    "ladder.png": "Difference to the membrane as the network is refined.",
    "tension_against_strain.png": "Tension of the cloth against its strain.",
    "load_against_deflection.png": "Load against the deflection of the loaded edge.",
    "load_against_extension.png": "Load against extension.",
    "load_against_angle.png": "Load against the shear angle of the frame.",
    "load_against_crosshead.png": "Load against the displacement of the crosshead.",
}
MAPS = (
    "scene.png",
    "stages.png",
    "yarns.png",
    "shear_map.png",
    "tension_map.png",
    "with_and_without_bending.png",
)
WIDE = 1.6  # pictures wider than this, by their height, have a line to themselves; stages.png has
CUT = ("bias-extension", "off-axis-tension", "pantograph")  # across the yarns
LEAST = 420  # pixels of width of a picture, two of which go into a row
NOISE = 1e-9  # of the total (energies), or degrees: rounding, told as 0

# Columns of the curve, by what is left of their name without the unit.
COLUMNS = {
    "strain_warp": "warp strain",
    "strain_weft": "weft strain",
    "angle": "angle of the frame",
    "shear_centre": "shear, at the centre point",
    "shear_max": "shear, largest (absolute)",
    "shear_middle": "shear, middle zone (median)",
    "shear_side": "shear, side zones (median)",
    "shear_clamp": "shear, at the clamps (median)",
    "force_warp": "warp force",
    "force_weft": "weft force",
    "tip_across": "deflection across",
    "tip_along": "deflection along",
    "crosshead": "crosshead",
}
UNITS = (
    ("_N_per_cm", "N/cm"),
    ("_N_per_mm", "N/mm"),
    ("_mm", "mm"),
    ("_deg", "°"),
    ("_percent", "%"),
    ("_N", "N"),
    ("_J", "J"),
)
STAGES = {
    "network": "network made",
    "solve": "solved",
    "solve_without_bending": "solved without yarn bending, to compare",
    "write": "results written",
    "continuum": "membrane solved and compared",
    "ladder": "finer networks compared with the membrane",
    "pictures": "pictures drawn",
    "scene": "yarns drawn in space",
    "total": "in all",
}

STYLE = """
:root { color-scheme: light; }
* { box-sizing: border-box; }
body { margin: 0; background: #fff; color: #1c2329; line-height: 1.45;
  font-family: "Segoe UI", "Helvetica Neue", Arial, "DejaVu Sans", sans-serif; font-size: 15px; }
main { max-width: 1080px; margin: 0 auto; padding: 28px 24px 48px; }
header { border-bottom: 2px solid #0b4f7d; padding-bottom: 12px; margin-bottom: 20px; }
h1 { font-size: 26px; line-height: 1.2; margin: 0 0 4px; overflow-wrap: anywhere; }
h2 { font-size: 18px; color: #0b4f7d; margin: 34px 0 10px; padding-bottom: 4px;
  border-bottom: 1px solid #d5dde3; break-after: avoid; }
h3 { font-size: 14px; margin: 18px 0 6px; break-after: avoid; }
p { margin: 6px 0; }
.small, figcaption { color: #56616a; font-size: 13px; }
.key { display: grid; grid-template-columns: repeat(auto-fit, minmax(150px, 1fr)); gap: 12px;
  margin: 0; }
.key div { border: 1px solid #d5dde3; border-radius: 4px; padding: 8px 12px; }
.key dt { color: #56616a; font-size: 13px; }
.key dd { margin: 0; font-size: 21px; font-variant-numeric: tabular-nums; white-space: nowrap; }
.warnings { border-left: 4px solid #b45309; background: #fff8eb; padding: 8px 14px; margin: 18px 0;
  break-inside: avoid; }
.warnings h2 { border: 0; color: #8a3f06; margin: 0; padding: 0; font-size: 16px; }
.warnings ul { margin: 4px 0; padding-left: 20px; }
.scroll { overflow-x: auto; }
table { border-collapse: collapse; font-size: 13.5px; font-variant-numeric: tabular-nums;
  margin: 4px 0; }
th, td { padding: 3px 12px 3px 0; text-align: left; vertical-align: top;
  border-bottom: 1px solid #e6ebef; }
tr { break-inside: avoid; }
th { font-weight: 600; }
thead th { border-bottom: 1px solid #8796a1; vertical-align: bottom; }
.number { text-align: right; white-space: nowrap; padding-left: 12px; padding-right: 6px; }
thead th.number { white-space: normal; max-width: 110px; }
td code { font-family: "DejaVu Sans Mono", Consolas, monospace; font-size: 12px;
  overflow-wrap: anywhere; }
td.path { white-space: nowrap; width: 1%; padding-right: 24px; }
.columns { display: grid; grid-template-columns: repeat(auto-fit, minmax(min(100%, 420px), 1fr));
  gap: 4px 36px; align-items: start; }
.columns table { width: 100%; }
.pictures { display: flex; flex-wrap: wrap; gap: 22px; align-items: flex-end; }
figure { margin: 0; break-inside: avoid; text-align: center; }
img { max-width: 100%; max-height: 640px; width: auto; height: auto; }
footer { margin-top: 36px; padding-top: 8px; border-top: 1px solid #d5dde3; }
@page { margin: 14mm; }
@media print {
  main { max-width: none; padding: 0; }
  body { font-size: 10.5pt; }
  .scroll { overflow: visible; }
  .warnings { background: #fff; }
  img { max-height: 150mm; }
}
"""


def write_report(
    comm: MPI.Intracomm,
    directory: Path,
    case: Case,
    summary: Mapping[str, Any],
    curve: Mapping[str, np.ndarray],
    pictures: Sequence[str] = (),
) -> None:
    """Write report.html into a folder of results. Collective; rank 0 writes.

    Parameters
    ----------
    comm : mpi4py communicator
    directory : Path
    case : Case
    summary : dict
        As it goes into summary.json.
    curve : dict of float (n,)
        Columns of the curve at the values asked for.
    pictures : sequence of str
        Files in the folder, embedded in this order.
    """

    def write() -> None:
        text = page(case, summary, curve, [(name, directory / name) for name in pictures])
        with written_whole(directory / "report.html") as temporary:
            temporary.write_text(text, encoding="utf-8")

    on_root(comm, write)


def page(
    case: Case,
    summary: Mapping[str, Any],
    curve: Mapping[str, np.ndarray],
    pictures: Sequence[tuple[str, Path]],
) -> str:
    """The whole page; see `write_report`."""
    maps = sorted((pair for pair in pictures if pair[0] in MAPS), key=lambda p: MAPS.index(p[0]))
    curves = [pair for pair in pictures if pair[0] not in MAPS]
    title = escape(case.title)
    parts = [
        _header(summary, title),
        _key_figures(summary, curve),
        _warnings(summary),
        _section("Specimen", _specimen(maps, summary, curve)),
        _section("Curves", _pictures(curves, "")),
        _section("Results", _curve_table(curve)),
        _section("Measured data", _measured(summary.get("measured"))),
        _section("Comparison with the continuum", _continuum(summary, curve)),
        _section("Fabric", _fabric(case)),
        _section("Case", _case(case)),
        _section("Sizes and times", _sizes(summary)),
        _section("Increments", _increments(summary, curve)),
        _provenance(summary),
    ]
    return f"""<!DOCTYPE html>
<html lang="en">
<head>
<meta charset="utf-8">
<meta http-equiv="Content-Security-Policy"
  content="default-src 'none'; img-src data:; style-src 'unsafe-inline'">
<meta name="viewport" content="width=device-width, initial-scale=1">
<title>{title}</title>
<style>{STYLE}</style>
</head>
<body>
<main>
{"".join(parts)}</main>
</body>
</html>
"""


# -- sections --------------------------------------------------------------------------------------


def _section(name: str, content: str) -> str:
    return f"<section>\n<h2>{escape(name)}</h2>\n{content}</section>\n" if content else ""


def _header(summary: Mapping[str, Any], title: str) -> str:
    kind = str(summary["kind"]).replace("-", " ").replace("off axis", "off-axis").capitalize()
    size = "finite deformation" if summary["finite"] else "small displacements"
    date = str(summary.get("date", ""))[:10]
    words = [kind, size, *([date] if date else [])]
    return (
        f'<header>\n<h1>{title}</h1>\n<p class="small">{escape(" · ".join(words))}</p>\n</header>\n'
    )


def _key_figures(summary: Mapping[str, Any], curve: Mapping[str, np.ndarray]) -> str:
    total = sum(_last(value) for value in summary["energy_j"].values())
    rows = [("load", "load_n", "N")]
    if summary["kind"] == "biaxial":  # whose load does the work of both directions
        rows = [("warp force", "force_warp_n", "N"), ("weft force", "force_weft_n", "N")]
    moved = "tip deflection" if summary["kind"] == "cantilever" else "extension"
    rows += [
        (moved, "extension_m", "m"),
        ("shear angle at the centre point", "shear_centre_deg", "°"),
        ("shear angle, median of the middle zone", "shear_middle_deg", "°"),
        ("largest shear angle (absolute)", "shear_max_deg", "°"),
    ]
    figures = [
        (name, _last(summary[key]), unit)
        for name, key, unit in rows
        if np.isfinite(_last(summary.get(key, np.nan)))
    ]
    figures.append(("strain energy", total, "J"))
    cells = []
    for name, value, unit in figures:
        if unit == "°":
            shown = f"{round(value, 2) + 0.0:.2f}°"  # no -0.00
        else:
            tell = {"J": _energy, "N": force_text}.get(unit)
            shown = tell(value) if tell else _si(value, unit)
        cells.append(f"<div><dt>{escape(name)}</dt><dd>{_data(value, shown)}</dd></div>\n")
    note = f"{_at(curve)}. Largest yarn tension: {tension_text(summary['yarn_tension_max'])}."
    note = f'<p class="small">{escape(note[:1].upper() + note[1:])}</p>\n'
    return f'<dl class="key">\n{"".join(cells)}</dl>\n{note}'


def _at(curve: Mapping[str, np.ndarray]) -> str:
    """The last value asked for, in words."""
    name, values = next(iter(curve.items()))
    head, unit = _named(name)
    size, unit = _size(values, unit)
    space = "" if unit == "°" else " "
    return f"at {float(np.asarray(values)[-1]) * size:.4g}{space}{unit} {head}"


def tension_text(largest: Mapping[str, Any]) -> str:
    """The summary's yarn_tension_max in words."""
    value, at = force_text(largest["n"]), largest["at_mm"]
    where = "" if at is None else ", at x = {:.4g} mm, y = {:.4g} mm (at rest)".format(*at)
    return f"{value} per {largest['family']} yarn{where}"


def force_text(value: float) -> str:
    """A force for people, in mN if it is small."""
    return _si(value, "N") if abs(value) >= SMALL_LOAD else f"{1e3 * value:.4g} mN"


def _specimen(
    maps: Sequence[tuple[str, Path]], summary: Mapping[str, Any], curve: Mapping[str, np.ndarray]
) -> str:
    note = ""
    if summary["kind"] in CUT and any(name.endswith("_map.png") for name, _ in maps):
        note = (
            '<p class="small">Rims are jagged and maps striped because an edge holds whole yarns: '
            "which ones changes by one at a time, and their tails beyond it hang free.</p>\n"
        )
    uniform = "".join(
        f"<p>{escape(text)}</p>\n" for text in summary.get("uniform_maps", {}).values()
    )
    colour = "tension" if summary["kind"] == "biaxial" else "shear angle"
    return _pictures(maps, _at(curve), colour) + note + uniform


def _warnings(summary: Mapping[str, Any]) -> str:
    told = list(summary.get("warnings", []))
    if "ended_early" in summary:
        told.insert(0, f"The test ended early: {summary['ended_early']}")
    failed = summary.get("continuum", {}).get("failed")
    if failed:
        told.append(f"The membrane could not be solved: {failed}")
    if not told:
        return ""
    items = "".join(f"<li>{escape(_sentence(text))}</li>\n" for text in told)
    return f'<div class="warnings">\n<h2>To know before use</h2>\n<ul>\n{items}</ul>\n</div>\n'


def _sentence(text: str) -> str:
    text = " ".join(str(text).split())
    return text[:1].upper() + text[1:] + ("" if text.endswith(".") else ".")


def _pictures(pictures: Sequence[tuple[str, Path]], at: str, colour: str = "shear angle") -> str:
    """Pictures two in a row, wide ones first and by themselves."""
    figures: list[tuple[bool, str]] = []
    for name, path in pictures:
        data = path.read_bytes()
        width, height = (int.from_bytes(data[i : i + 4], "big") for i in (16, 20))  # PNG header
        caption = escape(CAPTIONS[name].format(at=at, colour=colour))
        ratio = width / height
        wide = ratio > WIDE or name == "stages.png"
        basis = "100%" if wide else f"min(100%, {LEAST}px)"
        text = (
            f'<figure style="flex: 1 1 {basis}">\n'
            f'<img alt="{caption}" width="{width}" height="{height}" '
            f'src="data:image/png;base64,{base64.b64encode(data).decode("ascii")}">\n'
            f"<figcaption>{caption}</figcaption>\n</figure>\n"
        )
        figures.append((not wide, text))
    figures.sort(key=lambda pair: pair[0])
    body = "".join(text for _, text in figures)
    return f'<div class="pictures">\n{body}</div>\n' if body else ""


def _curve_table(curve: Mapping[str, np.ndarray]) -> str:
    heads, columns = [], []
    total = sum(values for name, values in curve.items() if name.startswith("energy_"))
    for name, values in curve.items():
        head, unit = _named(name)
        noise = NOISE * total if unit == "J" else NOISE if unit == "°" else 0.0
        size, unit = _size(values, unit)
        heads.append(f"{head} ({unit})" if unit else head)
        columns.append(_numbers(np.where(np.abs(values) < noise, 0.0, values), size))
    if "strain_weft_percent" in curve:
        heads = [name.replace("load", "work-conjugate load") for name in heads]
    return _table(heads, zip(*columns, strict=True))


def _measured(measured: Mapping[str, Any] | None) -> str:
    if not measured:
        return ""
    if "rms_relative" not in measured:
        told = "The test does not reach any of the measured points."
        return f"<p>{told}</p>\n"
    told = (
        f"Load less measured force, relative to the measured force: RMS "
        f"{_data(measured['rms_relative'], _percent(measured['rms_relative']))}, at the end "
        f"{_data(measured['end_relative'], _percent(measured['end_relative'], True))}, at most "
        f"{_data(measured['largest_relative'], _percent(measured['largest_relative'], True))} at "
        f"{measured['largest_at']:.4g} mm; {measured['points']} of {measured['points_measured']} "
        f"points lie within the test. Measured: {escape(str(measured['file']))}"
    )
    columns = [measured[key] for key in ("displacement_mm", "measured_n", "load_n")]
    off = [
        "" if load is None or not np.isfinite(load) else _percent(load / force - 1.0, True)
        for _, force, load in zip(*columns, strict=True)
    ]
    rows = zip(*(_numbers(column) for column in columns), off, strict=True)
    heads = ["displacement (mm)", "measured (N)", "computed (N)", "difference"]
    return f"<p>{told}</p>\n{_table(heads, rows)}"


def _continuum(summary: Mapping[str, Any], curve: Mapping[str, np.ndarray]) -> str:
    continuum = summary.get("continuum", {})
    if "load_ratio" not in continuum:
        return ""
    names = (
        ("load_ratio", "load, network / membrane", _number),
        ("energy_ratio", "energy, network / membrane", _number),
        ("relative_l2_displacement", "difference of displacement", _percent),
        ("mean_abs_shear_deg", "mean difference of shear (°)", _number),
    )
    control = next(iter(curve))
    head, unit = _named(control)
    rows = []
    for what, told in (
        ("", continuum),
        (" without yarn bending", continuum.get("without_bending")),
    ):
        if told is None:
            continue
        columns = [[form(v) for v in _all(told[key])] for key, _, form in names if key in told]
        at = np.asarray(curve[control])[-len(columns[0]) :]
        at_text = [f"{value:.4g} {unit}{what}" for value in at]
        rows += list(zip(at_text, *columns, strict=True))
    which = "second-gradient membrane" if continuum.get("second_gradient") else "membrane"
    text = (
        f"A {which} of the same outline and edges in dolfinx: {continuum['cells']:,} cells, "
        f"{continuum['dofs']:,} unknowns, mesh size {_si(continuum['mesh_size_m'], 'm')}."
    )
    heads = [head, *(name for key, name, _ in names if key in continuum)]
    more = ""
    if continuum.get("ladder"):
        keys = [key for key, _, _ in names]
        ladder = [
            [f"{rung['refine']}", f"{rung['crossovers']:,}"]
            + [form(rung[key]) for key, _, form in names]
            for rung in continuum["ladder"]
        ]
        titles = [name for key, name, _ in names if key in keys]
        more = "<h3>Refined networks</h3>\n" + _table(["refine", "crossovers", *titles], ladder)
    return f"<p>{escape(text)}</p>\n{_table(heads, rows)}{more}"


def _fabric(case: Case) -> str:
    fabric = case.fabric()
    sides = (fabric.warp, fabric.weft)
    rows = [
        ["modulus", *(format_si(side.modulus, "N/m") for side in sides)],
        ["Poisson's ratio", *(f"{side.poisson:g}" for side in sides)],
        ["yarns", *(format_si(side.yarns, "1/m") for side in sides)],
        ["bending rigidity of a yarn", *(format_si(side.yarn_bending, "N*m**2") for side in sides)],
        ["law of tension", fabric.warp_tension.name, fabric.weft_tension.name],
    ]
    law = fabric.shear.name
    at_rest = _si(fabric.shear_modulus, "N/m")
    shear = f"{at_rest}, linear" if law == "linear" else f"{at_rest} at rest, {law}"
    words = [f"Shear: {shear}."]
    if np.isfinite(fabric.shear.last_point):
        words.append(f"Its data end at {np.rad2deg(fabric.shear.last_point):.1f}°.")
    words.append(
        "Yarns carry compression like tension."
        if fabric.compression == 1.0
        else f"Stiffness in compression: {fabric.compression:g} of that in tension."
    )
    words.append("Logarithmic strain of the yarns." if fabric.log_strain else "")
    given = case.fabric_table.model_dump(exclude_none=True)
    if given.pop("use", None) and given:
        words.append(f"Changed in the case file: {', '.join(given)}. Of the rest the source:")
        words.append(fabric.source)
    elif fabric.source:
        words.append(f"Source: {fabric.source}")
    text = " ".join(word for word in words if word)
    return f"{_table([fabric.name, 'warp', 'weft'], rows)}<p>{escape(text)}</p>\n"


def _case(case: Case) -> str:
    blocks = []
    for table, content in case.model_dump(exclude_none=True).items():
        if not isinstance(content, dict):
            continue
        rows = "".join(
            f'<tr><td class="path">{escape(key)}</td><td><code>{escape(value)}</code></td></tr>\n'
            for key, value in _flat(content)
        )
        if rows:
            blocks.append(f"<div>\n<h3>[{escape(table)}]</h3>\n<table>\n{rows}</table>\n</div>\n")
    return f'<div class="columns">\n{"".join(blocks)}</div>\n'


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
        return "true" if value else "false"
    if isinstance(value, list):
        return "[" + ", ".join(_as_written(item) for item in value) + "]"
    return (
        value
        if isinstance(value, str)
        else f"{value:.6g}"
        if isinstance(value, float)
        else str(value)
    )


def _sizes(summary: Mapping[str, Any]) -> str:
    network = summary["network"]
    peak = summary.get("peak_mib_per_rank", [])
    rows = [
        ("crossovers", f"{summary['crossovers']:,}"),
        ("warp yarns, weft yarns", f"{network['warp_yarns']:,}, {network['weft_yarns']:,}"),
        ("unknowns", f"{summary['dofs']:,}"),
        ("crossovers that carry nothing", f"{network.get('hanging_crossovers', 0):,}"),
        ("ranks", f"{summary['ranks']}"),
        ("crossovers on a rank", _range(network)),
        ("largest memory of a rank", f"{max(peak):,.0f} MiB" if peak else ""),
    ]
    solver = summary["solver"]
    if summary["finite"]:
        increments = summary["increments"]
        newton = solver["newton_iterations"]
        rows += [
            ("increments", f"{len(increments)}"),
            (
                "Newton iterations",
                f"{newton} ({summary['newton_iterations_per_increment']:.1f} each)",
            ),
        ]
    words = [str(solver[key]) for key in ("snes", "snes_type", "ksp", "pc") if key in solver]
    rows.append(("solvers (PETSc)", ", ".join(words)))
    times = [
        (STAGES.get(name, name), f"{seconds:.2f} s") for name, seconds in summary["wall_s"].items()
    ]
    return f'<div class="columns">\n{_pairs(rows)}{_pairs(times)}</div>\n'


def _range(network: Mapping[str, Any]) -> str:
    low, high = network["crossovers_per_rank_min"], network["crossovers_per_rank_max"]
    return f"{low:,}" if low == high else f"{low:,} to {high:,}"


def _increments(summary: Mapping[str, Any], curve: Mapping[str, np.ndarray]) -> str:
    increments = summary.get("increments")
    if not increments:
        return ""
    name = next(iter(curve))
    head, unit = _named(name)
    size = {"mm": 1e-3, "°": np.pi / 180.0, "%": 1e-2}.get(unit, 1.0)
    heads = [f"{head} ({unit})"]
    heads += ["load (N)"] if unit != "N" else []
    heads += ["Newton iterations", "mended", "cut", "residual (N)", "tolerance (N)", "time (s)", ""]
    rows = []
    controls = _numbers([step["control"] for step in increments], 1.0 / size)
    loads = _numbers([step["load_n"] for step in increments])
    for step, control, load in zip(increments, controls, loads, strict=True):
        rows.append(
            [
                control,
                *([load] if unit != "N" else []),
                f"{step['newton_iterations']}",
                f"{step['shifted']}",
                f"{step.get('cuts', 0)}",
                f"{step['residual_n']:.1e}",
                f"{step['tolerance_n']:.1e}",
                f"{step['seconds']:.2f}",
                "asked for" if step["asked"] else "",
            ]
        )
    note = (
        '<p class="small">Mended: Newton steps whose tangent was not positive or did not lead '
        "downhill. Cut: how often the step was halved because no equilibrium was found.</p>\n"
    )
    return _table(heads, rows) + note


def _provenance(summary: Mapping[str, Any]) -> str:
    versions = ", ".join(f"{name} {number}" for name, number in summary["versions"].items())
    ranks = f"{summary['ranks']} rank{'s' if summary['ranks'] > 1 else ''}"
    words = [f"Made with {versions}, on {ranks}"]
    words += [str(summary["date"])] if "date" in summary else []
    words += [f"commit {summary['commit']}"] if summary.get("commit") else []
    if "resumed_after_increments" in summary:
        words.append(f"resumed after {summary['resumed_after_increments']} increments")
    return f'<footer class="small">{escape("; ".join(words))}.</footer>\n'


# -- pieces ----------------------------------------------------------------------------------------


def _table(heads: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """A table with escaped cells; columns of numbers are aligned to the right."""
    body = [list(row) for row in rows]
    right = [bool(body) and all(_is_number(row[i]) for row in body) for i in range(len(heads))]
    kind = ['class="number"' if number else "" for number in right]

    def line(tag: str, cells: Sequence[str]) -> str:
        inner = "".join(
            f"<{tag}{' ' if style else ''}{style}>{escape(cell)}</{tag}>"
            for cell, style in zip(cells, kind, strict=True)
        )
        return f"<tr>{inner}</tr>\n"

    return (
        f'<div class="scroll">\n<table>\n<thead>\n{line("th", heads)}</thead>\n<tbody>\n'
        f"{''.join(line('td', row) for row in body)}</tbody>\n</table>\n</div>\n"
    )


def _is_number(cell: str) -> bool:
    text = cell.replace(",", "").removesuffix(" %").replace("\N{MINUS SIGN}", "-")
    try:
        float(text or "0")
    except ValueError:
        return False
    return True


def _pairs(rows: Iterable[tuple[str, str]]) -> str:
    cells = "".join(
        f'<tr><td>{escape(name)}</td><td class="number">{escape(value)}</td></tr>\n'
        for name, value in rows
        if value
    )
    return f"<table>\n{cells}</table>\n"


def _named(column: str) -> tuple[str, str]:
    """Name and unit of a curve's column."""
    for tail, unit in UNITS:
        if column.endswith(tail):
            name = column.removesuffix(tail)
            return COLUMNS.get(name, name.replace("_", " ")), unit
    return column.replace("_", " "), ""


def _data(value: float, shown: str) -> str:
    """A number with its digits for machines."""
    return f'<data value="{float(value)!r}">{escape(shown)}</data>'


def _si(value: float, unit: str) -> str:
    """With four digits, in a unit of a fitting size."""
    return format_si(float(f"{value:.4g}"), unit)


def _energy(value: float) -> str:
    return f"{value:.4g} J" if abs(value) >= 1.0 else f"{1e3 * value:.4g} mJ"


def _number(value: float | None, size: float = 1.0) -> str:
    if value is None or not np.isfinite(value):
        return ""
    return f"{size * value + 0.0:.4g}".replace("-", "\N{MINUS SIGN}")


def _numbers(values: Iterable[float | None], size: float = 1.0) -> list[str]:
    """A column, with as many decimals everywhere as its largest number has of four digits."""
    column = [np.nan if value is None else size * float(value) for value in values]
    largest = max((abs(value) for value in column if np.isfinite(value)), default=0.0)
    if not 1e-3 <= largest < 1e6:
        return [_number(value) for value in column]
    most = max(0, 3 - int(np.floor(np.log10(largest))))
    digits = max(len(f"{v:.{most}f}".rstrip("0").partition(".")[2]) for v in column)
    return [
        f"{round(value, digits) + 0.0:.{digits}f}".replace("-", "\N{MINUS SIGN}")
        if np.isfinite(value)
        else ""
        for value in column
    ]


def _size(values: Any, unit: str) -> tuple[float, str]:
    """What to multiply a column by, and the unit it then has: mJ, and mN for small loads."""
    if unit == "J" or (unit == "N" and np.abs(values).max(initial=0.0) < SMALL_LOAD):
        return 1e3, f"m{unit}"
    return 1.0, unit


def _percent(value: float, signed: bool = False) -> str:
    text = f"{100.0 * value:+.2f} %" if signed else f"{100.0 * value:.2f} %"
    return text.replace("-", "\N{MINUS SIGN}")


def _last(value: Any) -> float:
    return float(value[-1] if isinstance(value, list) else value)


def _all(value: Any) -> list[float]:
    return list(value) if isinstance(value, list) else [value]
