# SPDX-License-Identifier: MIT
"""Pictures of tests, as PNG files. Every function here is collective and draws on rank 0.

Lengths come in metres with the samples and in millimetres where a name says so. Matplotlib is
imported when the first picture is drawn.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ..parallel import on_root
from .sample import MapSample, YarnSample
from .tables import written_whole

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.colors import Colormap, Normalize
    from matplotlib.figure import Figure
    from mpi4py import MPI

Curves = Mapping[str, tuple[Sequence[float] | np.ndarray, Sequence[float] | np.ndarray]]
# Segments of an edge (n, 2, 2) with the cloth on their left (Preform.edge), and its motion:
# (2,), or of each end (n, 2, 2).
Clamp = tuple[np.ndarray, Sequence[float] | np.ndarray]

STYLE: dict[str, Any] = {
    "font.family": "DejaVu Sans",
    "font.size": 10.5,
    "axes.titlesize": 11,
    "axes.labelsize": 10.5,
    "legend.fontsize": 9.5,
    "axes.linewidth": 0.7,
    "xtick.major.width": 0.7,
    "ytick.major.width": 0.7,
    "lines.linewidth": 1.6,
    "hatch.linewidth": 0.5,
    "savefig.dpi": 180,
    "axes.axisbelow": True,
}
# Okabe and Ito: told apart by colour-blind readers, too.
COLOURS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#56B4E9", "#E69F00")
MARKERS = ("o", "s", "^", "D", "v", "P")
DASHES = ("-", (0, (5, 2)), (0, (1.5, 1.5)), (0, (5, 2, 1, 2)))
MANY_POINTS = 40  # curves with more points have dashes instead of markers
ANGLE_LABEL = "shear angle (°)"
ROUNDING_DEG = 1e-6  # angles below are none


# -- the specimen -------------------------------------------------------------------------------


def yarns_before_and_after(
    comm: MPI.Intracomm,
    path: str | Path,
    sample: YarnSample | None,
    title: str = "",
    *,
    clamps: Sequence[Clamp] = (),
    scale: float = 1.0,
    label: str = ANGLE_LABEL,
) -> None:
    """Draw yarns before (thin, grey) and after, coloured by shear angle: the paper's figure 9b.

    Parameters
    ----------
    comm : mpi4py communicator
    path : str or Path
    sample : YarnSample
        Needed on rank 0 only.
    title : str
    clamps : sequence of (segments (n, 2, 2), motion (2,)), metres
        Edges to draw as hatched bars, and how far each has moved.
    scale : float
        Exaggerates the displacement; said in the picture unless it is 1.
    label : str
        What the sample has for its shear angle.
    """
    _draw_yarns(comm, path, [(title, sample, clamps)], scale, label=label)


def with_and_without_bending(
    comm: MPI.Intracomm,
    path: str | Path,
    without: YarnSample | None,
    with_bending: YarnSample | None,
    *,
    clamps: Sequence[Clamp] = (),
    scale: float = 1.0,
) -> None:
    """Draw both side by side with one colour scale: the paper's figure 6. See above."""
    samples = [("no yarn bending", without, clamps), ("with yarn bending", with_bending, clamps)]
    _draw_yarns(comm, path, samples, scale)


def stages(
    comm: MPI.Intracomm,
    path: str | Path,
    panels: Sequence[tuple[str, YarnSample | None, Sequence[Clamp]]],
    title: str = "",
) -> None:
    """Draw states of one test side by side in true scale, with one colour scale.

    Parameters
    ----------
    comm : mpi4py communicator
    path : str or Path
    panels : sequence of (title, sample, clamps)
        See `yarns_before_and_after`; samples are needed on rank 0 only.
    title : str
        Above all of them.
    """
    _draw_yarns(comm, path, panels, 1.0, before=False, heading=title)


def _draw_yarns(
    comm,
    path,
    panels,
    scale: float,
    before: bool = True,
    heading: str = "",
    label: str = ANGLE_LABEL,
) -> None:
    def draw() -> Figure:
        drawn = [panel for panel in panels if panel[1] is not None]
        samples = [sample for _, sample, _ in drawn]
        colours = _angle_colours([sample.shear_angle_deg for sample in samples])
        points = [s.after(scale) for s in samples] + [s.before for s in samples if before]
        low, high = _bounds(points)
        bar = 0.03 * float((high - low).max())
        edges = [
            [segments + scale * np.asarray(motion) for segments, motion in clamps]
            for _, _, clamps in drawn
        ]
        # Bars lie outside of the cloth, on whichever side that is.
        low, high = _bounds(
            [
                low[None],
                high[None],
                *(_bar(a, b, bar) for edge in edges for e in edge for a, b in e),
            ]
        )
        figure = _Panels(low, high, len(drawn))
        for axes, (title, sample, _), clamped in zip(figure.axes, drawn, edges, strict=True):
            _add_yarns(axes, sample, scale, colours, figure.points_per_metre, before)
            for edge in clamped:
                _add_clamp(axes, edge, bar)
            axes.set_title(title)
        figure.colour_bar(-1, colours, label)
        if heading:
            figure.heading(heading)
        every = max(sample.every for sample in samples)
        notes = [f"1 in {every} yarns drawn"] if every > 1 else []
        notes += [f"displacement drawn {scale:g} times"] if scale != 1.0 else []
        figure.note("\n".join(notes))
        return figure.figure

    _save(comm, path, draw)


def _add_yarns(
    axes: Axes, sample: YarnSample, scale: float, colours, points_per_metre, before: bool = True
) -> None:
    from matplotlib.collections import LineCollection

    lines = np.split(1e3 * sample.before, sample.first[1:])
    if before:
        axes.add_collection(LineCollection(lines, colors="0.62", linewidths=0.5, zorder=1))
    width = np.clip(0.2 * points_per_metre * sample.spacing, 0.4, 2.6)
    norm, colour_map, _ = colours
    segment = sample.segment
    after = LineCollection(
        1e3 * sample.after(scale)[segment],
        array=_mean_of_ends(sample.shear_angle_deg[segment]),
        norm=norm,
        cmap=colour_map,
        linewidths=width,
        capstyle="round",
        zorder=2,
    )
    axes.add_collection(after)


def _mean_of_ends(values: np.ndarray) -> np.ndarray:
    """Mean of pairs (s, 2), of the one that is a number if the other is not."""
    good = np.isfinite(values)
    total = np.where(good, values, 0.0).sum(axis=1)
    return np.ma.masked_invalid(total / np.where(good.any(axis=1), good.sum(axis=1), np.nan))


def _add_clamp(axes: Axes, segments: np.ndarray, thickness: float) -> None:
    """Hatched bars on the side of an edge where there is no cloth."""
    from matplotlib.patches import Polygon

    for a, b in segments:
        corners = 1e3 * _bar(a, b, thickness)
        a, b = 1e3 * a, 1e3 * b
        bar = Polygon(corners, facecolor="0.93", edgecolor="0.35", hatch="/////")
        bar.set(linewidth=0, zorder=3, clip_on=False)
        axes.add_patch(bar)
        axes.plot(*np.array([a, b]).T, color="0.1", linewidth=1.4, zorder=4, clip_on=False)


def _bar(a: np.ndarray, b: np.ndarray, thickness: float) -> np.ndarray:
    """Corners (4, 2) of a bar to the right of the way from a to b."""
    along = (b - a) / np.linalg.norm(b - a)
    out = thickness * np.array([along[1], -along[0]])
    return np.array([a, b, b + out, a + out])


# -- maps ---------------------------------------------------------------------------------------


def shear_maps(
    comm: MPI.Intracomm,
    path: str | Path,
    sample: MapSample | None,
    names: Sequence[str] = ("network", "membrane"),
    title: str = "",
) -> None:
    """Draw maps of the shear angle side by side: the network, the membrane, their difference.

    Parameters
    ----------
    comm : mpi4py communicator
    path : str or Path
    sample : MapSample
        With the named values in degrees; needed on rank 0 only.
    names : one or two names of values
        Two are drawn with one colour scale, and their difference with its own.
    title : str
    """

    def draw() -> Figure:
        assert sample is not None
        values = {name: sample.values[name] for name in names}
        shared = _angle_colours(list(values.values()))
        low, high = _bounds(sample.outline)
        panels = _Panels(low, high, 1 if len(values) == 1 else 3, bar_after=len(values) - 1)
        for axes, (name, value) in zip(panels.axes, values.items(), strict=False):
            _add_map(axes, sample, value, shared)
            axes.set_title(name[:1].upper() + name[1:] if len(values) > 1 else title)
        panels.colour_bar(len(values) - 1, shared, ANGLE_LABEL)
        if len(values) == 2:
            first, second = values.values()
            off = _difference_colours(first - second)
            _add_map(panels.axes[2], sample, first - second, off)
            panels.axes[2].set_title(f"{names[0].capitalize()} minus {names[1]}")
            panels.colour_bar(2, off, "difference (°)")
            panels.figure.suptitle(title, y=1.0, va="bottom", fontsize=11)
        return panels.figure

    _save(comm, path, draw)


def tension_maps(
    comm: MPI.Intracomm, path: str | Path, sample: MapSample | None, title: str = ""
) -> None:
    """Draw maps of the yarns' tension side by side, with one colour scale.

    Parameters
    ----------
    comm : mpi4py communicator
    path : str or Path
    sample : MapSample
        With the values "warp" and "weft", N per yarn; needed on rank 0 only.
    title : str
    """

    def draw() -> Figure:
        assert sample is not None
        every = np.abs(np.concatenate(list(sample.values.values())))
        largest = float(np.max(every[np.isfinite(every)], initial=0.0))
        unit, size = ("N", 1.0) if largest >= 0.1 else ("mN", 1e-3)
        values = {name: value / size for name, value in sample.values.items()}
        colours = _angle_colours(list(values.values()), 0.99)
        panels = _Panels(*_bounds(sample.outline), len(values))
        for axes, (name, value) in zip(panels.axes, values.items(), strict=True):
            _add_map(axes, sample, value, colours)
            axes.set_title(name[:1].upper() + name[1:])
        panels.colour_bar(len(values) - 1, colours, f"tension ({unit} per yarn)")
        if title:
            panels.figure.suptitle(title, y=1.0, va="bottom", fontsize=11)
        return panels.figure

    _save(comm, path, draw)


def _add_map(axes: Axes, sample: MapSample, values: np.ndarray, colours) -> None:
    """Fill each crossover's cell, cut by the outline.

    Bits of the outline in cells without a crossover belong to the nearest ones: cells at the
    outline are first drawn twice as large, underneath the others.
    """
    from matplotlib.collections import PolyCollection
    from matplotlib.patches import PathPatch
    from matplotlib.path import Path as Outline

    rings = [Outline(1e3 * ring, closed=True) for ring in sample.outline]
    outline = Outline.make_compound_path(*rings)
    border = PathPatch(outline, facecolor="none", edgecolor="0.2", linewidth=0.8, zorder=3)
    axes.add_patch(border)
    norm, colour_map, _ = colours
    values = np.ma.masked_invalid(values)
    every = np.ones(len(values), bool)
    for size, rows, order in ((2.6, sample.at_outline, 1.0), (1.0, every, 2.0)):
        cells = PolyCollection(1e3 * sample.cells(size)[rows], array=values[rows], norm=norm)
        cells.set(cmap=colour_map, edgecolor="face", linewidth=0.3, zorder=order)
        axes.add_collection(cells)
        cells.set_clip_path(border)


# -- curves -------------------------------------------------------------------------------------


def shear_against_load(
    comm: MPI.Intracomm,
    path: str | Path,
    load_N: Sequence[float] | np.ndarray,
    shear_centre_deg: Sequence[float] | np.ndarray,
    shear_max_deg: Sequence[float] | np.ndarray | None = None,
    *,
    others: Curves | None = None,
    xlabel: str = "load (N)",
    title: str = "",
) -> None:
    """Draw the shear angle against the load: the paper's figure 8.

    Parameters
    ----------
    comm : mpi4py communicator
    path : str or Path
    load_N, shear_centre_deg, shear_max_deg : float (n,)
        Needed on rank 0 only.
    others : dict of (load_N, shear_deg)
        More curves by label, e.g. measured ones.
    xlabel, title : str
    """
    curves = {"at the centre point": (load_N, shear_centre_deg)}
    if shear_max_deg is not None:
        curves["largest (absolute)"] = (load_N, shear_max_deg)
    curves = {label: from_origin(*curve) for label, curve in curves.items()}
    labels = (xlabel, ANGLE_LABEL)
    _draw_curves(comm, path, curves | dict(others or {}), labels, title)


def load_against_extension(
    comm: MPI.Intracomm,
    path: str | Path,
    extension_mm: Sequence[float] | np.ndarray,
    load_N: Sequence[float] | np.ndarray,
    *,
    others: Curves | None = None,
    points: Curves | None = None,
    marks: tuple[np.ndarray, np.ndarray] | None = None,
    xlabel: str = "extension (mm)",
    ylabel: str = "load (N)",
    title: str = "",
) -> None:
    """Draw the load against the extension, or whatever ``xlabel`` and ``ylabel`` say.

    Parameters
    ----------
    comm : mpi4py communicator
    path : str or Path
    extension_mm, load_N : float (n,)
        In the order of the test, which may turn back. Needed on rank 0 only.
    others, points : dict of (extension_mm, load_N)
        More curves by label, and what is drawn as points only.
    marks : (extension_mm, load_N), optional
        Points of the curve to mark; by default all of them, if they are few.
    xlabel, ylabel, title : str
    """
    mine = {"network": from_origin(extension_mm, load_N)}

    def draw() -> Figure:
        figure, axes = _curve_axes((xlabel, ylabel), title)
        for i, (label, (x, y)) in enumerate((mine | dict(others or {})).items()):
            style = _line(i, len(x))
            if i == 0 and marks is not None:
                style.pop("marker", None)
                axes.plot(x, y, label=label, **style)
                axes.plot(*marks, "o", color=COLOURS[0], markersize=4, clip_on=False, zorder=3)
            else:
                axes.plot(x, y, label=label, **style)
        count = len(mine) + len(others or {})
        for i, (label, (x, y)) in enumerate((points or {}).items(), count):
            style = {"color": COLOURS[i], "marker": MARKERS[i], "markersize": 6, "clip_on": False}
            axes.plot(x, y, label=label, linestyle="", fillstyle="none", zorder=4, **style)
        _include_zero(axes)
        _legend(axes, count + len(points or {}))
        return figure

    _save(comm, path, draw)


def curves(
    comm: MPI.Intracomm,
    path: str | Path,
    lines: Curves,
    labels: tuple[str, str],
    title: str = "",
) -> None:
    """Draw curves (x, y) by label from the origin on; ``labels`` of the axes."""
    _draw_curves(
        comm, path, {key: from_origin(*line) for key, line in lines.items()}, labels, title
    )


def overlaid(
    comm: MPI.Intracomm,
    path: str | Path,
    panels: Sequence[tuple[tuple[str, str], Mapping[str, tuple[Any, bool]]]],
) -> None:
    """Draw curves over each other, in panels side by side.

    Parameters
    ----------
    comm : mpi4py communicator
    path : str or Path
    panels : sequence of (labels of the axes, curves)
        Curves by label: ((x, y), whether it is drawn as points). Labels are taken literally.
    """

    def draw() -> Figure:
        from matplotlib.figure import Figure

        figure = Figure(figsize=(4.6 * len(panels) + 0.6, 4.1), layout="constrained")
        every = figure.subplots(1, len(panels), squeeze=False)[0]
        for axes, (names, lines) in zip(every, panels, strict=True):
            _plain_axes(axes, names, "")
            for i, (label, ((x, y), as_points)) in enumerate(lines.items()):
                style = {"color": COLOURS[i], "clip_on": False, "zorder": 4 - i}
                style |= (
                    {"linestyle": "", "marker": MARKERS[i], "fillstyle": "none", "markersize": 5}
                    if as_points
                    else {"linestyle": DASHES[i]}
                )
                # Without a dollar or a leading underscore that mean something to matplotlib.
                literal = label.replace("$", r"\$").lstrip("_")
                axes.plot(x, y, label=literal, **style)
            _include_zero(axes)
        handles, texts = every[0].get_legend_handles_labels()
        figure.legend(handles, texts, loc="outside upper left", frameon=False)
        return figure

    _save(comm, path, draw)


def zones(
    comm: MPI.Intracomm, path: str | Path, lines: Curves, thin: Curves, title: str = ""
) -> None:
    """Draw the shear angle of zones against the extension, with thin lines of a formula.

    Parameters
    ----------
    comm : mpi4py communicator
    path : str or Path
    lines, thin : dict of (extension_mm, shear_deg)
        By label (an empty one is not told); needed on rank 0 only.
    title : str
    """

    def draw() -> Figure:
        figure, axes = _curve_axes(("extension (mm)", ANGLE_LABEL), title)
        for label, (x, y) in thin.items():
            axes.plot(x, y, color="0.4", linewidth=0.9, label=label or None, zorder=2)
        for i, (label, (x, y)) in enumerate(lines.items()):
            x, y = from_origin(x, y)
            # Between few points a straight line says nothing.
            axes.plot(x, y, label=label, **_line(i, len(x)) | {"linewidth": 0.7})
        _include_zero(axes)
        axes.legend(frameon=False, loc="upper left")
        return figure

    _save(comm, path, draw)


def stacked(
    comm: MPI.Intracomm,
    path: str | Path,
    x: np.ndarray,
    parts: Mapping[str, np.ndarray],
    labels: tuple[str, str],
    title: str = "",
) -> None:
    """Draw parts of a whole, one upon the other, against x (n,), from the origin on.

    Parameters
    ----------
    comm : mpi4py communicator
    path : str or Path
    x : float (n,)
    parts : dict of float (n,)
        Not negative, by label; needed on rank 0 only. Drawn up to the largest |x| of a test that
        turns back.
    labels : (str, str)
        Of the axes.
    title : str
    """

    def draw() -> Figure:
        figure, axes = _curve_axes(labels, title)
        until = 1 + int(np.abs(x).argmax())
        along = np.concatenate([[0.0], x[:until]])
        heights = [np.concatenate([[0.0], part[:until]]) for part in parts.values()]
        axes.stackplot(along, heights, labels=list(parts), colors=COLOURS, alpha=0.85, linewidth=0)
        axes.plot(along, np.sum(heights, axis=0), color="0.15", linewidth=1.0)
        axes.set_xlim(min(along), max(along))
        axes.set_ylim(0.0, None)
        # As they lie upon each other.
        handles, names = axes.get_legend_handles_labels()
        axes.legend(handles[::-1], names[::-1], frameon=False, loc="upper left")
        return figure

    _save(comm, path, draw)


def shear_along_centre_line(
    comm: MPI.Intracomm, path: str | Path, curves: Curves, *, title: str = ""
) -> None:
    """Draw the shear angle from the clamp along the centre line.

    Parameters
    ----------
    comm : mpi4py communicator
    path : str or Path
    curves : dict of (distance_mm, shear_deg)
        By label, distances ascending; needed on rank 0 only. Curves stop at a hole.
    title : str
    """
    labels = ("distance from the clamp (mm)", ANGLE_LABEL)
    broken = {label: _broken_at_gaps(*curve) for label, curve in curves.items()}
    _draw_curves(comm, path, broken, labels, title)


def convergence(
    comm: MPI.Intracomm,
    path: str | Path,
    crossovers: Sequence[float] | np.ndarray,
    curves: Mapping[str, Sequence[float] | np.ndarray],
    *,
    orders: Sequence[float] = (1,),
    ylabel: str = "relative difference",
    title: str = "",
) -> None:
    """Draw differences against the number of crossovers, both on logarithmic axes.

    Parameters
    ----------
    comm : mpi4py communicator
    path : str or Path
    crossovers : (n,)
    curves : dict of (n,)
        Positive values by label; needed on rank 0 only.
    orders : sequence
        Powers of the pitch to draw a slope guide for. The pitch goes with crossovers^(-1/2).
    ylabel, title : str
    """

    def draw() -> Figure:
        figure, axes = _curve_axes(("crossovers", ylabel), title)
        count = np.asarray(crossovers, float)
        axes.set(xscale="log", yscale="log")
        for i, (label, values) in enumerate(curves.items()):
            axes.plot(count, values, label=label, **_line(i, len(count)))
        for order in orders:
            slope = (count / count[0]) ** (-order / 2)
            below = 0.6 * min(np.nanmin(np.asarray(v, float) / slope) for v in curves.values())
            axes.plot(count, below * slope, color="0.45", linewidth=0.9, linestyle=(0, (4, 3)))
            power = "pitch" if order == 1 else f"pitch$^{{{order:g}}}$"
            axes.annotate(f"∝ {power}", (count[-1], below * slope[-1]), (4, 0), color="0.35",
                          textcoords="offset points", va="center", fontsize=8)  # fmt: skip
        _number_log_axes(axes)
        _legend(axes, len(curves))
        return figure

    _save(comm, path, draw)


def _draw_curves(comm, path, curves: Curves, labels, title: str) -> None:
    def draw() -> Figure:
        figure, axes = _curve_axes(labels, title)
        for i, (label, (x, y)) in enumerate(curves.items()):
            axes.plot(x, y, label=label, **_line(i, len(x)))
        _include_zero(axes)
        _legend(axes, len(curves))
        return figure

    _save(comm, path, draw)


def _curve_axes(labels: tuple[str, str], title: str) -> tuple[Figure, Axes]:
    from matplotlib.figure import Figure

    figure = Figure(figsize=(5.4, 3.7), layout="constrained")
    axes = figure.subplots()
    _plain_axes(axes, labels, title)
    return figure, axes


def _plain_axes(axes: Axes, labels: tuple[str, str], title: str) -> None:
    axes.set(xlabel=labels[0], ylabel=labels[1], title=title)
    axes.spines[["top", "right"]].set_visible(False)
    axes.grid(color="0.9", linewidth=0.6)


def _line(i: int, points: int) -> dict[str, Any]:
    """Style of the i-th curve, to be seen also where curves lie on one another."""
    line = {"color": COLOURS[i % len(COLOURS)], "clip_on": False, "zorder": 3}
    if points > MANY_POINTS:
        return line | {"linestyle": DASHES[i % len(DASHES)]}
    return line | {"marker": MARKERS[i % len(MARKERS)], "markersize": 4}


def _legend(axes: Axes, curves: int) -> None:
    if curves > 1:
        axes.legend(frameon=False)


def _include_zero(axes: Axes) -> None:
    """Let both axes begin (or end) at zero where all values are on one side of it."""
    for limits, put in ((axes.get_xlim(), axes.set_xlim), (axes.get_ylim(), axes.set_ylim)):
        data_low, data_high = limits
        margin = 0.05 * (data_high - data_low)
        if data_low >= -1.01 * margin:
            put(0.0, data_high)
        elif data_high <= 1.01 * margin:
            put(data_low, 0.0)


def _number_log_axes(axes: Axes) -> None:
    """Numbers as people write them: 1,000 and 0.02, not 10^3 and 2 x 10^-2."""
    from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter

    for axis, (low, high) in ((axes.xaxis, axes.get_xlim()), (axes.yaxis, axes.get_ylim())):
        steps = (1.0, 2.0, 5.0) if high < 2e3 * low else (1.0,)
        axis.set_major_locator(LogLocator(subs=steps))
        axis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:,.6g}"))
        axis.set_minor_formatter(NullFormatter())


def from_origin(x, y) -> tuple[np.ndarray, np.ndarray]:
    """Put the origin, which every test starts from, before a curve that lacks it.

    A curve that turns back stays in its order.
    """
    x, y = np.atleast_1d(np.asarray(x, float)), np.atleast_1d(np.asarray(y, float))
    step = np.diff(x)
    turns = (step > 0).any() and (step < 0).any()
    if not turns:
        order = np.argsort(x, kind="stable")
        x, y = x[order], y[order]
    if len(x) and ((x > 0).all() or (x < 0).all()):
        at = 0 if turns or x[0] > 0 else len(x)
        x, y = np.insert(x, at, 0.0), np.insert(y, at, 0.0)
    return x, y


def _broken_at_gaps(x, y) -> tuple[np.ndarray, np.ndarray]:
    """Put a NaN wherever a step along x is far larger than is usual."""
    x, y = np.asarray(x, float), np.asarray(y, float)
    if len(x) < 3:
        return x, y
    step = np.diff(x)
    gap = 1 + np.flatnonzero(step > 4.0 * np.median(step))
    return np.insert(x, gap, np.nan), np.insert(y, gap, np.nan)


# -- panels, colours, files ---------------------------------------------------------------------


class _Panels:
    """Equal-aspect axes in mm side by side, exactly as large as what is drawn in them.

    Everything is placed in inches, so that tall and wide specimens get tight pictures alike.
    """

    HEIGHT, WIDEST, GAP, BAR = 5.2, 6.4, 0.35, 0.95

    def __init__(self, low, high, columns: int, bar_after: int | None = None):
        from matplotlib.figure import Figure

        size = 1.04 * (high - low)
        middle = 0.5 * (low + high)
        inches_per_metre = min(self.HEIGHT / size[1], self.WIDEST / columns**0.5 / size[0])
        self.width, self.height = size * inches_per_metre
        self.points_per_metre = 72 * inches_per_metre
        gap = max(self.GAP, 1.15 - self.width)
        left = np.arange(columns) * (self.width + gap)
        if bar_after is not None:
            left[bar_after + 1 :] += self.BAR
        # savefig cuts the picture to what is drawn; the figure itself is just large enough.
        self.total = float(left[-1] + self.width) + self.BAR + 1.0, float(self.height) + 1.0
        self.figure = Figure(figsize=self.total)
        self.left = left + 0.7
        self.axes: list[Axes] = []
        for i in range(columns):
            axes = self._axes(self.left[i], self.width)
            axes.set_xlim(*1e3 * (middle[0] + 0.5 * size[0] * np.array([-1, 1])))
            axes.set_ylim(*1e3 * (middle[1] + 0.5 * size[1] * np.array([-1, 1])))
            axes.set_xlabel("x (mm)")
            room = max(2, min(6, int(self.width / 0.6)))
            axes.locator_params(axis="x", nbins=room, min_n_ticks=2)
            axes.tick_params(direction="out", length=3, color="0.5")
            axes.spines[:].set_color("0.75")
            if i == 0:
                axes.set_ylabel("y (mm)")
            else:
                axes.tick_params(labelleft=False)
            self.axes.append(axes)

    def _axes(self, left: float, width: float) -> Axes:
        x, y = self.total
        return self.figure.add_axes((left / x, 0.5 / y, width / x, self.height / y))

    def colour_bar(self, panel: int, colours, label: str) -> None:
        """Draw the colour scale to the right of a panel."""
        from matplotlib.cm import ScalarMappable

        norm, colour_map, extend = colours
        place = self._axes(self.left[panel] + self.width + 0.14, 0.14)
        bar = self.figure.colorbar(
            ScalarMappable(norm, colour_map), place, label=label, extend=extend
        )
        if norm.vmax == 0.0:
            bar.ax.invert_yaxis()  # zero below, like that of positive values

    def heading(self, text: str) -> None:
        """Write a title above all panels."""
        y = (0.5 + self.height + 0.55) / self.total[1]
        x = 0.5 * (self.left[0] + self.left[-1] + self.width) / self.total[0]
        self.figure.text(x, y, text, fontsize=11, ha="center", va="bottom")

    def note(self, text: str) -> None:
        """Write small print below the first panel."""
        left, low = self.left[0] / self.total[0], 0.02 / self.total[1]
        self.figure.text(left, low, text, fontsize=9, color="0.4", va="top")


def _bounds(points: Sequence[np.ndarray]) -> tuple[np.ndarray, np.ndarray]:
    together = np.concatenate(list(points))
    return together.min(axis=0), together.max(axis=0)


def _angle_colours(
    angles: Sequence[np.ndarray], share: float = 0.998
) -> tuple[Normalize, Colormap, str]:
    """Colour scale, colour map and which ends of the scale are passed by some values.

    From zero up if the angles have one sign (bar a little scatter), else centred on zero. The
    largest few of many values, beyond ``share`` of them, do not stretch the scale.
    """
    from matplotlib import colormaps
    from matplotlib.colors import ListedColormap, Normalize

    every = np.concatenate([np.ravel(angle) for angle in angles])
    every = every[np.isfinite(every)] if np.isfinite(every).any() else np.zeros(1)
    low = np.quantile(every, 1.0 - share, method="lower")
    high = np.quantile(every, share, method="higher")
    if min(-low, high) > max(0.15 * max(-low, high), ROUNDING_DEG):
        return _difference_colours(every, share)
    # The light end of plasma would be lost on white paper.
    shades = ListedColormap(colormaps["plasma"](np.linspace(0.0, 0.9, 256)))
    shades.set_bad("0.75")
    if max(-low, high) < ROUNDING_DEG:
        low, high = 0.0, 1.0
    limits = (0.0, high) if high >= -low else (low, 0.0)
    if high < -low:
        shades = shades.reversed()  # dark is none
    return Normalize(*limits), shades, _extend(every, *limits)


def _difference_colours(
    differences: np.ndarray, share: float = 0.99
) -> tuple[Normalize, Colormap, str]:
    """The same for values of both signs: white, or nearly so, at zero."""
    from matplotlib import colormaps
    from matplotlib.colors import Normalize

    good = np.abs(differences[np.isfinite(differences)])
    largest = float(np.quantile(good, share, method="higher")) if good.size else 0.0
    shades = colormaps["RdBu_r"].copy()
    shades.set_bad("0.75")
    largest = largest or 1.0
    return Normalize(-largest, largest), shades, _extend(differences, -largest, largest)


def _extend(values: np.ndarray, low: float, high: float) -> str:
    slack = 0.03 * (high - low)
    below, above = np.nanmin(values) < low - slack, np.nanmax(values) > high + slack
    return {(0, 0): "neither", (1, 0): "min", (0, 1): "max", (1, 1): "both"}[below, above]


def _save(comm: MPI.Intracomm, path: str | Path, draw: Callable[[], Figure]) -> None:
    """Draw on rank 0 and save as PNG. Collective; InputError on all ranks if it cannot be."""

    def save() -> None:
        from matplotlib import rc_context

        with rc_context(STYLE), written_whole(path) as temporary:
            draw().savefig(temporary, format="png", bbox_inches="tight", pad_inches=0.08)

    on_root(comm, save)
