# SPDX-License-Identifier: MIT
"""What notebooks show of objects: a small table, and a picture where that is cheap; see drawn.py.

Text has the notebook's own colours, and pictures a white ground: legible on light and on dark.
"""

from __future__ import annotations

import base64
import io
from collections.abc import Mapping, Sequence
from functools import singledispatch
from html import escape
from typing import TYPE_CHECKING, Any

import numpy as np
import shapely

from ..cloth.fabric import Fabric
from ..cloth.preform import Preform
from ..experiments.registry import forms, in_space
from ..experiments.result import EFFORT, TestResult
from ..forming.forming import Formed
from ..quantities import quantity, si_text
from ..units import format_si
from . import formed, pictures, report
from .saved import Result

if TYPE_CHECKING:
    from matplotlib.axes import Axes

HEIGHT = 150  # pixels of the outline
YARNS = 12  # of each family that are drawn across it
DPI = 65
PLY = {"areal_density": "kg/m**2", "thickness": "m", "fibre_density": "kg/m**3"}


@singledispatch
def html_of(shown: Any) -> str:
    """See Shown."""
    raise TypeError(f"there is no table of {shown!r}")


@html_of.register
def _(shown: Fabric) -> str:
    table = report.yarns(shown)
    given = {key.replace("_", " "): (getattr(shown, key), unit) for key, unit in PLY.items()}
    told = [f"{key} {si_text(value, unit)}" for key, (value, unit) in given.items() if value]
    text = [report.shear(shown), f"Weave: {shown.weave}{''.join(f', {t}' for t in told)}."]
    text += [f"Source: {shown.source}"] if shown.source else []
    return _page(table.heads, table.rows, text)


@html_of.register
def _(shown: Preform) -> str:
    x, y = (si_text(size, "m") for size in shown.size)
    rows = [
        ("size", f"{x} x {y}"),
        ("area", f"{1e4 * shown.outline.area:.4g} cm²"),
        ("warp", f"{format_si(shown.bias_angle, 'rad').replace(' deg', '°')} from y (blue)"),
        ("holes", f"{len(shown.outline.interiors)}"),
        ("refine, yarns per cruciform", f"{shown.refine}, {shown.yarns_per_cruciform}"),
        ("edges", shown.edge_list()),
    ]
    return _page(["Preform", ""], rows, picture=outline(shown))


@html_of.register
def _(shown: TestResult) -> str:
    curve, test = shown.curve(states=True), shown.experiment
    title = f"{test.kind}, {'finite deformation' if test.finite else 'small displacements'}"
    rows = [("crossovers", f"{shown.network.num_crossovers_global:,}"), *_last(curve)]
    return _page([title, ""], rows, picture=_plotted(shown))


@html_of.register
def _(shown: Formed) -> str:
    network = shown.blank.network
    rows = [("crossovers", f"{network.num_crossovers_global:,}")]
    rows.append(("steps, results", f"{len(shown.steps)}, {len(shown.states)}"))
    if shown.of is None or not shown.steps:
        return _page(["forming", ""], rows)
    rows += _of_forming(formed.table_of(shown.of, shown.steps))
    return _page(["forming", ""], rows, picture=_plotted(shown))


@html_of.register
def _(shown: Result) -> str:
    curve, summary = shown.curve(), shown.summary
    rows = [("kind", shown.kind), ("folder", str(shown.folder))]
    rows += _of_forming(curve) if forms(shown.kind) else _last(shown.curve(states=True))
    warnings = [str(sentence) for sentence in summary.get("warnings", [])]
    text = [f"Ended early: {shown.ended_early}"] if shown.ended_early else []
    title = str(summary.get("title", "")) or shown.folder.name
    curved = forms(shown.kind) or not in_space(shown.kind)
    return _page([title, ""], rows, text + warnings, _plotted(shown) if curved else "")


def _last(curve: Mapping[str, np.ndarray]) -> list[tuple[str, str]]:
    """The last row of a test's curve: names with units, and values; energies as their sum."""
    last: dict[str, Any] = {name: v[-1:] for name, v in curve.items() if name not in EFFORT}
    energy = sum(last.pop(name) for name in list(last) if name.startswith("energy_"))
    table = report.curve_table(last | {"energy_J": energy})
    return list(zip(table.heads, *table.rows, strict=True))


def _of_forming(table: Mapping[str, Any]) -> list[tuple[str, str]]:
    """What counts of the last row of forces.csv."""
    share = float(table["share_percent"][-1])
    names = [name for name in table if name.endswith(("_force_z_N", "shear_max_deg"))]
    names += [name for name in table if name.startswith("draw_in_")]
    rows = [("stage", f"{table['stage'][-1]}, {share:.4g} %")]
    for name in names:
        known = quantity(name)
        rows.append((f"{known.name} ({known.unit})", report.numbers([table[name][-1]])[0]))
    return rows


def outline(preform: Preform) -> str:
    """The outline as SVG, with some yarns across it: warp blue, weft orange."""
    size = preform.size
    scale = HEIGHT / max(float(size.max()), 1e-300)
    low = np.array(preform.outline.bounds[:2])

    def path(line: Any) -> str:
        points = scale * (np.asarray(line.coords)[:, :2] - low)
        points[:, 1] = scale * size[1] - points[:, 1]  # y is down there
        return "M" + "L".join(f"{x:.1f} {y:.1f}" for x, y in points)

    middle, reach = low + 0.5 * size, float(np.hypot(*size))
    b = preform.bias_angle
    families = {
        pictures.COLOURS[0]: (np.sin(b), np.cos(b)), pictures.COLOURS[1]: (-np.cos(b), np.sin(b))
    }  # fmt: skip
    parts = []
    for colour, along in families.items():
        e = np.array(along)
        across = reach * np.linspace(-0.5, 0.5, YARNS + 2)[1:-1, None] * [-e[1], e[0]]
        ends = np.stack([middle + across - reach * e, middle + across + reach * e], axis=1)
        cut = shapely.intersection(shapely.MultiLineString(list(ends)), preform.outline)
        pieces = [piece for piece in shapely.get_parts(cut) if piece.geom_type == "LineString"]
        lines = "".join(map(path, pieces))
        parts.append(f'<path d="{lines}" fill="none" stroke="{colour}" stroke-width="1.2"/>')
    rings = (preform.outline.exterior, *preform.outline.interiors)
    border = "".join(map(path, rings))
    parts.append(f'<path d="{border}" fill="none" stroke="currentColor" stroke-width="1.6"/>')
    width, height = scale * size
    return (
        f'<svg xmlns="http://www.w3.org/2000/svg" width="{width + 4:.0f}" '
        f'height="{height + 4:.0f}" viewBox="-2 -2 {width + 4:.1f} {height + 4:.1f}" '
        f'role="img" aria-label="outline and yarns">{"".join(parts)}</svg>'
    )


def _plotted(shown: Any) -> str:
    """Its curve as a picture on white, on rank 0; none of a single point. Collective."""
    from matplotlib import rc_context

    with rc_context(pictures.STYLE):
        figure = pictures.figure_of(figsize=(4.6, 3.0), layout="constrained")
        axes: Axes | None = shown.plot(figure.add_subplot())
        if axes is None or all(np.size(line.get_xdata()) < 3 for line in axes.get_lines()):
            return ""
        data = io.BytesIO()
        figure.savefig(data, format="png", dpi=DPI)
    encoded = base64.b64encode(data.getvalue()).decode("ascii")
    return f'<img alt="curve" style="background:white" src="data:image/png;base64,{encoded}">'


def _page(
    heads: Sequence[str],
    rows: Sequence[Sequence[str]],
    text: Sequence[str] = (),
    picture: str = "",
) -> str:
    """A table, sentences below it, a picture beside it; all texts are escaped."""

    def line(cells: Sequence[str], tag: str) -> str:
        style = 'style="text-align:left;padding:1px 12px 1px 0"'
        return "".join(f"<{tag} {style}>{escape(cell)}</{tag}>" for cell in cells)

    body = "".join(f"<tr>{line(row, 'td')}</tr>" for row in rows)
    table = f'<table style="color:inherit"><tr>{line(heads, "th")}</tr>{body}</table>'
    words = "".join(f'<div style="max-width:60em">{escape(one)}</div>' for one in text)
    return (
        '<div style="display:flex;flex-wrap:wrap;gap:16px;align-items:center">'
        f"<div>{table}{words}</div>{picture}</div>"
    )
