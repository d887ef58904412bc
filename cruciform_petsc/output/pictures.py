# SPDX-License-Identifier: MIT
"""Pictures of tests: figures made of data, and `save`, which writes one as a PNG file.

Lengths of samples and clamps are in metres, those of curves in what their labels say. Each draws
into the axes ``ax`` if these are given, as many as it has panels, and leaves the rest of their
figure alone; else into a figure of its own. Matplotlib is imported when the first picture is drawn.
"""

from __future__ import annotations

import textwrap
from collections.abc import Callable, Iterable, Mapping, Sequence
from contextvars import ContextVar
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, Any

import numpy as np

from ..errors import InputError, shown
from ..parallel import on_root
from .sample import MapSample, YarnSample
from .tables import written_whole

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.cm import ScalarMappable
    from matplotlib.figure import Figure
    from mpi4py import MPI

    from ..tension import BiaxialLaw

    Given = Axes | Sequence[Axes] | None  # to draw into

Values = Sequence[float] | np.ndarray
Rings = Sequence[np.ndarray]  # corners (n, 2) of each
Curves = Mapping[str, tuple[Values, Values]]  # (x, y) by label

STYLE: dict[str, Any] = {
    "font.family": "DejaVu Sans",
    "font.size": 10.5,
    "axes.titlesize": 11,
    "axes.labelsize": 10.5,
    "figure.titlesize": 11,
    "legend.fontsize": 9.5,
    "legend.frameon": False,
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
MOST_LABELS = 12  # of curves in a legend
UNSEEN = 2e-3  # of a whole
MANY_POINTS = 40  # curves with more points have dashes instead of markers
ANGLE_LABEL = "shear angle (°)"
SIZE_LABEL = "shear angle, absolute (°)"
ROUNDING_DEG = 1e-6  # angles below are none
MILLISECONDS, DPI_ANIMATED = 400, 80  # of each picture of an animation
FLAT = 3.0  # width over height of specimens that are drawn one below the other
_new_figure: ContextVar[Callable[..., Any] | None] = ContextVar("_new_figure", default=None)
HEIGHT, WIDEST = 5.2, 6.4  # inches: of a specimen, and of all side by side over the root of them


def save(
    comm: MPI.Intracomm, path: str | Path, draw: Callable[..., Figure], *data: Any, **options: Any
) -> None:
    """Save the figure ``draw(*data, **options)`` as PNG. Collective; drawn on rank 0.

    Data are needed there only. InputError on all ranks if it cannot be drawn or written.
    """

    def write() -> None:
        from matplotlib import rc_context

        with rc_context(STYLE), written_whole(path) as temporary:
            figure = draw(*data, **options)
            wrap_titles(figure)
            figure.savefig(temporary, format="png", bbox_inches="tight", pad_inches=0.08)

    on_root(comm, write)


def draw(comm: MPI.Intracomm, make: Callable[..., Any], ax: Given = None) -> Any:
    """Draw by ``make(ax=...)`` into axes, or into a new figure of pyplot's. Collective.

    Returns the axes, an array of several, on rank 0; None on the other ranks, which draw nothing.
    """
    drawn: list[Any] = []

    def into() -> None:
        from matplotlib import pyplot, rc_context

        if ax is not None:
            every = np.ravel(np.array(ax, dtype=object))
            if any(not hasattr(one, "transAxes") for one in every):
                raise InputError(
                    f"ax must be axes of matplotlib's, got {shown(ax)}: to have a file, save the "
                    'figure of what is returned, as in result.map().figure.savefig("map.png")'
                )
            make(ax=ax)
            wrap_titles(every[0].figure, every)
            drawn.append(ax)
            return
        token = _new_figure.set(pyplot.figure)
        try:
            with rc_context(STYLE):
                figure = make()
                wrap_titles(figure)
        finally:
            _new_figure.reset(token)
        axes = [axes for axes in figure.axes if axes.get_label() != "<colorbar>"]
        drawn.append(axes[0] if len(axes) == 1 else np.array(axes, dtype=object))

    on_root(comm, into)
    return drawn[0] if drawn else None


def figure_of(**options: Any) -> Figure:
    """A figure, as `save` or `draw` needs it."""
    from matplotlib.figure import Figure

    return (_new_figure.get() or Figure)(**options)


def save_animation(path: str | Path, figures: Iterable[Figure]) -> None:
    """Write figures of one size, the last of which has all colours, as a GIF that repeats.

    Not collective; to be called, as figures are drawn, in rc_context(STYLE).
    """
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from PIL import Image

    pages = []
    for figure in figures:
        canvas = FigureCanvasAgg(figure)
        figure.set_dpi(DPI_ANIMATED)
        wrap_titles(figure)
        canvas.draw()
        pages.append(Image.fromarray(np.asarray(canvas.buffer_rgba())[..., :3]))
    palette = pages[-1].quantize()  # one for all: each has the colour bar
    pages = [page.quantize(palette=palette) for page in pages]
    pause = [MILLISECONDS] * (len(pages) - 1) + [3 * MILLISECONDS]
    with written_whole(path) as temporary:
        pages[0].save(
            temporary, format="GIF", save_all=True, append_images=pages[1:], duration=pause, loop=0
        )


def wrap_titles(figure: Figure, of: Iterable[Axes] | None = None) -> None:
    """Break titles that are wider than what they stand over: axes, or the whole figure.

    Those ``of`` some of its axes, or all.
    """
    whole = figure.bbox.width
    titles = [axes.title for axes in (figure.axes if of is None else of)]
    if of is None:
        titles += [text for text in figure.texts if text.get_text() == figure.get_suptitle()]
    if all(title.get_window_extent().width < 0.6 * whole for title in titles):
        return
    figure.draw_without_rendering()
    for title in titles:
        room = whole if title.axes is None else title.axes.get_window_extent().width
        width = title.get_window_extent().width
        if width > room:
            lines = title.get_text().split("\n")
            letters = max(10, int(max(map(len, lines)) * room / width))
            title.set_text("\n".join(textwrap.fill(line, letters) for line in lines))


# -- the specimen -------------------------------------------------------------------------------


def yarns(
    panels: Sequence[tuple[str, YarnSample, np.ndarray]],
    title: str = "",
    *,
    before: bool = True,
    label: str = ANGLE_LABEL,
    ax: Given = None,
    among: Sequence[tuple[str, YarnSample, np.ndarray]] | None = None,
) -> Figure:
    """Draw yarns in the colours of their values, side by side in true scale: figures 6 and 9b.

    Each panel has its title and clamps: segments (n, 2, 2) with the cloth on their left, drawn as
    hatched bars. ``before``: the yarns at rest too, thin and grey. ``label`` tells what the values
    are; they have one colour scale. ``among``: panels that have it, and their place, in common.
    """
    from matplotlib.collections import LineCollection, PolyCollection

    every = panels if among is None else among
    samples = [sample for _, sample, _ in every]
    points = [s.after for s in samples] + [s.before for s in samples if before]
    thickness = bar_width(*bounds(points))
    points += [bar_corners(clamps, thickness).reshape(-1, 2) for _, _, clamps in every]
    bars = [bar_corners(clamps, thickness) for _, _, clamps in panels]
    figure, axes, points_per_metre = _panels(*bounds(points), [name for name, _, _ in panels], ax)
    colours = colour_scale([sample.values for sample in samples])
    for panel, (_, sample, clamps), corners in zip(axes, panels, bars, strict=True):
        if before:
            lines = np.split(1e3 * sample.before, sample.first[1:])
            panel.add_collection(LineCollection(lines, colors="0.62", linewidths=0.5, zorder=1))
        # A piece of yarn has the mean of its ends, or the value of the one that has any.
        after = LineCollection(
            list(1e3 * sample.after[sample.segment]),
            array=np.ma.masked_invalid(sample.values[sample.segment]).mean(axis=1),
            norm=colours.norm,
            cmap=colours.cmap,
            linewidths=np.clip(0.2 * points_per_metre * sample.spacing, 0.4, 2.6),
            capstyle="round",
            zorder=2,
        )
        panel.add_collection(after)
        if len(clamps):
            hatched = PolyCollection(list(1e3 * corners), hatch="/////", facecolor="0.93", zorder=3)
            hatched.set(edgecolor="0.35", linewidth=0, clip_on=False)
            panel.add_collection(hatched)
            edges = LineCollection(list(1e3 * clamps), colors="0.1", linewidths=1.4, zorder=4)
            panel.add_collection(edges)
    colour_bar(axes, colours, label)
    head(axes, title, ax)
    drawn = max(sample.every for sample in samples)
    if drawn > 1:
        note = f"1 in {drawn} yarns drawn"
        own: dict[str, Any] = {"transform": axes[0].transAxes} if ax is not None else {}
        (figure if ax is None else axes[0]).text(
            0.01, -0.01, note, fontsize=9, color="0.4", va="top", **own
        )
    return figure


def bar_width(low: np.ndarray, high: np.ndarray) -> float:
    """Width of a clamp's bar on a specimen between two corners, m."""
    return 0.03 * float((high - low).max())


def bar_corners(segments: np.ndarray, thickness: float) -> np.ndarray:
    """Corners (n, 4, 2) of bars on the right of segments (n, 2, 2), where there is no cloth."""
    along = segments[:, 1] - segments[:, 0]
    out = np.column_stack([along[:, 1], -along[:, 0]])
    out *= thickness / np.linalg.norm(along, axis=1, keepdims=True)
    return np.concatenate([segments, segments[:, ::-1] + out[:, None]], axis=1)


def maps(
    sample: MapSample,
    label: str = ANGLE_LABEL,
    title: str = "",
    *,
    difference: str = "",
    ax: Given = None,
) -> Figure:
    """Draw maps of a sample's values side by side, with one colour scale.

    ``label`` is what they are; ``difference`` that of a third map, first less second value, with a
    scale of its own.
    """
    values = list(sample.values.values())
    names = [name.capitalize() for name in sample.values]
    if difference:
        names.append(f"{names[0]} minus {names[1].lower()}")
    figure, axes, _ = _panels(*bounds(sample.outline), names if len(names) > 1 else [""], ax)
    groups = [(axes[: len(values)], values, colour_scale(values), label)]
    if difference:
        less = values[0] - values[1]
        groups.append((axes[-1:], [less], colour_scale([less], centred=True), difference))
    for panels, of, colours, what in groups:
        for panel, value in zip(panels, of, strict=True):
            _add_map(panel, sample, value, colours)
        colour_bar(panels, colours, what)
    head(axes, title, ax)
    return figure


def _add_map(axes: Axes, sample: MapSample, values: np.ndarray, colours: ScalarMappable) -> None:
    """Fill each crossover's cell, cut by the outline.

    Bits of the outline in cells without a crossover belong to the nearest ones: cells at the
    outline are first drawn twice as large, underneath the others.
    """
    from matplotlib.collections import PolyCollection
    from matplotlib.patches import PathPatch
    from matplotlib.path import Path as Outline

    rings = (Outline(1e3 * ring, closed=True) for ring in sample.outline)
    outline = Outline.make_compound_path(*rings)
    border = PathPatch(outline, facecolor="none", edgecolor="0.2", linewidth=0.8, zorder=3)
    axes.add_patch(border)
    values = np.ma.masked_invalid(values)
    for size, rows, order in ((2.6, sample.at_outline, 1.0), (1.0, slice(None), 2.0)):
        corners = list(1e3 * sample.cells(size)[rows])
        cells = PolyCollection(corners, array=values[rows], zorder=order)
        cells.set(norm=colours.norm, cmap=colours.cmap, edgecolor="face", linewidth=0.3)
        axes.add_collection(cells)
        cells.set_clip_path(border)


def _panels(
    low: np.ndarray, high: np.ndarray, titles: Sequence[str], ax: Given = None
) -> tuple[Figure, list[Axes], float]:
    """Axes in mm in true scale, and how many points a metre is in them.

    Side by side; those that are much wider than high one below the other.
    """
    middle, size = 0.5 * (low + high), 1.04 * (high - low)
    flat = size[0] > FLAT * size[1]
    figure: Any
    if ax is None:
        rows, columns = (len(titles), 1) if flat else (1, len(titles))
        inches_per_metre = min(HEIGHT / size[1], WIDEST / columns**0.5 / size[0])
        width, height = size * inches_per_metre
        figure = figure_of(
            figsize=(columns * width, rows * (height + 0.7 * flat) + 1.0 + 0.7 * flat)
        )
        axes = list(figure.subplots(rows, columns, sharex=True, sharey=True, squeeze=False).ravel())
    else:
        axes = given(ax, len(titles))
        figure = axes[0].figure
        room = np.array(axes[0].get_window_extent().size) / figure.dpi
        inches_per_metre = float((room / size).min())
        width, height = size * inches_per_metre
    x_limits, y_limits = 1e3 * (middle + 0.5 * size * np.array([[-1], [1]])).T
    for panel, title in zip(axes, titles, strict=True):
        panel.set_title(title)
        panel.set(aspect="equal", xlim=x_limits, ylim=y_limits)
        for axis, inches, label in (("x", width, 0.45), ("y", height, 0.3)):
            fit = int(inches / label)  # labels of ticks without touching
            panel.locator_params(axis, nbins=np.clip(fit, 1, 6), min_n_ticks=min(2, max(1, fit)))
        panel.tick_params(direction="out", length=3, color="0.5")
        panel.spines[:].set_color("0.75")
    for panel in axes[-1:] if flat else axes:
        panel.set_xlabel("x (mm)")
    for panel in axes if flat else axes[:1]:
        panel.set_ylabel("y (mm)")
    if ax is None:
        # The layout leaves no room for titles that are wider than their panels.
        widest = max(panel.title.get_window_extent().width for panel in axes) / figure.dpi
        beside = max(0.5 * (widest + 0.15 - width), 0.08)  # inches
        figure.set_layout_engine("compressed", w_pad=beside)
        figure.set_figwidth(columns * max(width + 2.0 * beside + 0.27, 1.15) + 1.6)
    return figure, axes, 72.0 * inches_per_metre


def given(ax: Given, count: int) -> list[Axes]:
    """Axes to draw into; InputError if they are not as many as are needed."""
    axes = list(np.ravel(np.asarray(ax, dtype=object)))
    if len(axes) != count:
        raise InputError(f"this picture needs {count} axes to be drawn into, got {len(axes)}")
    return axes


def head(axes: Sequence[Axes], title: str, ax: Given = None) -> None:
    """Write a title over all axes, or (where they were given) over the first if it has none."""
    if ax is None:
        axes[0].figure.suptitle(title)
    elif title and not axes[0].get_title():
        axes[0].set_title(title)


def bounds(points: Sequence[np.ndarray]) -> tuple[np.ndarray, np.ndarray]:
    """Lowest and highest coordinates of arrays of points (n, d), NaN left out."""
    together = np.concatenate(list(points))
    return np.nanmin(together, axis=0), np.nanmax(together, axis=0)


# -- colours ------------------------------------------------------------------------------------


def colour_scale(
    values: Sequence[np.ndarray], share: float = 0.99, *, centred: bool = False
) -> ScalarMappable:
    """One scale for values, NaN grey.

    From zero up (or down) if they have one sign, bar a little scatter; else, or if it is to be
    ``centred``, white at zero. The largest few of each array, beyond ``share`` of its values that
    are not zero, do not stretch it: its colour bar has an arrow there.
    """
    from matplotlib import colormaps
    from matplotlib.cm import ScalarMappable
    from matplotlib.colors import ListedColormap, Normalize

    found = [value[np.isfinite(value) & (value != 0.0)] for value in map(np.asarray, values)]
    found = [value for value in found if len(value)] or [np.zeros(1)]
    low = min(0.0, *(float(np.quantile(v, 1.0 - share, method="lower")) for v in found))
    high = max(0.0, *(float(np.quantile(v, share, method="higher")) for v in found))
    if centred or min(-low, high) > max(0.15 * max(-low, high), ROUNDING_DEG):
        high = max(float(np.quantile(np.abs(v), share, method="higher")) for v in found) or 1.0
        low, shades = -high, colormaps["RdBu_r"].copy()
    else:
        # The light end of plasma would be lost on white paper.
        shades = ListedColormap(colormaps["plasma"](np.linspace(0.0, 0.9, 256)))
        if max(-low, high) < ROUNDING_DEG:
            low, high = 0.0, 1.0
        elif high < -low:
            high, shades = 0.0, shades.reversed()  # dark is none
        low = low if high == 0.0 else 0.0
    shades.set_bad("0.75")
    slack = 0.03 * (high - low)
    every = np.concatenate(found)
    passed = 1 * (every.min() < low - slack) + 2 * (every.max() > high + slack)
    shades.colorbar_extend = ("neither", "min", "max", "both")[passed]  # type: ignore[assignment]
    return ScalarMappable(Normalize(low, high), shades)


def colour_bar(axes: list[Axes], colours: ScalarMappable, label: str, **options: Any) -> None:
    """Draw the scale to the right of axes, zero below; by default below flat ones."""
    width, height = (np.ptp(limits) for limits in (axes[0].get_xlim(), axes[0].get_ylim()))
    if not options and width > FLAT * height:
        options = {"location": "bottom"}
    elif height > FLAT * width and len(axes) == 1:  # a share of the axes' width
        options["pad"] = 0.02 * height / width
    bar = axes[0].figure.colorbar(colours, ax=axes, label=label, aspect=30, **options)
    if colours.norm.vmax == 0.0 and bar.orientation == "vertical":
        bar.ax.invert_yaxis()


# -- curves -------------------------------------------------------------------------------------


def curves(
    lines: Curves,
    labels: tuple[str, str],
    title: str = "",
    *,
    points: Curves | None = None,
    marks: tuple[Values, Values] | None = None,
    guides: Curves | None = None,
    ax: Given = None,
) -> Figure:
    """Draw lines (x, y), to be told apart also where they lie on one another; labels of the axes.

    In axes that have lines already, they look as the next ones.

    ``points`` get no lines. ``marks`` are the points of the first line to mark: by default all of
    each, if they are few. ``guides`` are thin and grey, those without a label not in the legend;
    lines are thin beside them, as a straight one between few points says nothing there.
    """
    figure, (axes,) = _curve_axes([labels], title, ax=ax)
    points = points or {}
    before = sum(not str(line.get_label()).startswith("_") for line in axes.get_lines())
    for label, (x, y) in (guides or {}).items():
        axes.plot(x, y, color="0.4", linewidth=0.9, label=label or None, zorder=2)
    for i, (label, (x, y)) in enumerate(lines.items(), before):
        style = _line_style(i, len(x))
        if guides is not None:
            style["linewidth"] = 0.7
        if i == before and marks is not None:
            style.pop("marker", None)
            axes.plot(*marks, "o", color=style["color"], markersize=4, clip_on=False, zorder=3)
        axes.plot(x, y, label=label, **style)
    for i, (label, (x, y)) in enumerate(points.items(), before + len(lines)):
        axes.plot(x, y, label=label, **_point_style(i))
    _include_zero(axes)
    if guides is not None or before + len(lines) + len(points) > 1:
        axes.legend()
    return figure


def shadow(
    parts: Sequence[Rings], flat: Rings, disc: float, warp: float, title: str, ax: Given = None
) -> Figure:
    """Draw a draped cloth's shadow as the instrument shows it, mm.

    Parameters
    ----------
    parts : sequence of rings
        Of each piece its outline and holes, float (n, 2).
    flat : rings
        Of the flat cloth.
    disc : float
        Radius of what it lies on.
    warp : float
        Angle of the warp from x, radians.
    """
    from matplotlib.patches import PathPatch
    from matplotlib.path import Path as Outline

    def patch(rings: Rings, **style: Any) -> PathPatch:
        return PathPatch(Outline.make_compound_path(*map(Outline, rings)), **style)

    figure, (axes,) = _curve_axes([("x (mm)", "y (mm)")], title, (5.2, 5.0), ax)
    axes.grid(False)
    for rings in parts:
        axes.add_patch(patch(rings, facecolor="0.25", edgecolor="none"))
    axes.add_patch(patch(flat, fill=False, edgecolor="0.5", linestyle="--", linewidth=0.9))
    around = np.linspace(0.0, 2.0 * np.pi, 181)
    axes.plot(disc * np.cos(around), disc * np.sin(around), color="white", linewidth=1.0)
    size = 1.05 * max(np.abs(ring).max() for ring in flat)
    x, y = 0.6 * disc * np.cos(warp), 0.6 * disc * np.sin(warp)
    axes.annotate("", (x, y), (-x, -y), arrowprops={"arrowstyle": "->", "color": "white"})
    axes.annotate("warp", (x, y), color="white", xytext=(4, 0), textcoords="offset points")
    axes.set(xlim=(-size, size), ylim=(-size, size), aspect="equal")
    return figure


def overlaid(
    panels: Sequence[tuple[tuple[str, str], Mapping[str, tuple[Any, bool]]]], ax: Given = None
) -> Figure:
    """Draw curves over each other, in panels side by side: (labels of the axes, curves).

    Curves by label: ((x, y), whether it is drawn as points). Labels are taken literally.
    """
    size = (4.6 * len(panels) + 0.6, 4.1)
    figure, every = _curve_axes([labels for labels, _ in panels], "", size, ax)
    for axes, (_, lines) in zip(every, panels, strict=True):
        for i, (label, ((x, y), as_points)) in enumerate(lines.items()):
            style = _point_style(i) if as_points else _line_style(i, MANY_POINTS + 1)
            # A leading underscore would keep it out of the legend.
            style |= {"label": plain_text(label).lstrip("_"), "zorder": 4 - i}
            axes.plot(x, y, **style)
        _include_zero(axes)
    if ax is None:
        figure.legend(*every[0].get_legend_handles_labels(), loc="outside upper left")
    else:
        every[0].legend()
    return figure


def swept(
    key: str,
    labels: tuple[str, str],
    lines: Sequence[tuple[float | str, str, Values, Values]],
    ends: Sequence[tuple[str, Mapping[str, tuple[list, list]]]],
    title: str = "",
    ax: Given = None,
) -> Figure:
    """Draw a sweep: curves in the colours of the varied key's values, and results over that key.

    Each curve has its value (a number, or words), what else was varied ("" without), x and y, with
    ``labels`` of the axes; each of the ``ends`` its label and, by what else was varied, values of
    the key and results. Words are taken literally.
    """
    from matplotlib import colormaps
    from matplotlib.cm import ScalarMappable
    from matplotlib.colors import ListedColormap, Normalize

    panels = [labels] * bool(lines) + [(key, label) for label, _ in ends]
    figure, every = _curve_axes(panels, "", (4.4 * len(panels) + 0.6, 3.7), ax)
    numbers = [value for value, _, _, _ in lines if isinstance(value, float)]
    others = list(dict.fromkeys(other for _, other, _, _ in lines))
    if lines and len(numbers) == len(lines):
        shades = ListedColormap(colormaps["plasma"](np.linspace(0.0, 0.9, 256)))
        scale = ScalarMappable(Normalize(min(numbers), max(numbers)), shades)
        for number, (_, other, x, y) in zip(numbers, lines, strict=True):
            dashes = DASHES[others.index(other) % len(DASHES)]
            every[0].plot(x, y, color=scale.to_rgba(np.array(number)), linestyle=dashes)
        figure.colorbar(scale, ax=every[0], label=key, aspect=30)
    elif lines:
        for i, (value, other, x, y) in enumerate(lines):
            label = plain_text(", ".join(filter(None, (str(value), other)))).lstrip("_")
            style = _line_style(i, MANY_POINTS + 1)
            every[0].plot(x, y, label=label if i < MOST_LABELS else None, **style)
        every[0].legend()
    for axes, (_, series) in zip(every[bool(lines) :], ends, strict=True):
        for i, (other, (x, y)) in enumerate(series.items()):
            label = plain_text(other).lstrip("_")
            style = _line_style(i, 0) | ({"linestyle": ""} if isinstance(x[0], str) else {})
            axes.plot(x, y, label=label if i < MOST_LABELS else None, **style)
        if len(series) > 1:
            axes.legend()
        axes.margins(y=0.1)
        axes.set_ylim(min(0.0, axes.get_ylim()[0]), max(0.0, axes.get_ylim()[1]))
    head(every, title, ax)
    return figure


def stacked(
    x: np.ndarray,
    parts: Mapping[str, np.ndarray],
    labels: tuple[str, str],
    title: str = "",
    ax: Given = None,
    start: Mapping[str, float] = MappingProxyType({}),
) -> Figure:
    """Draw parts (n,) of a whole, not negative, one upon the other, against x (n,).

    From x = 0, where they are none or what ``start`` says, to the largest |x|; ``labels`` of the
    axes. Parts that are never seen, below `UNSEEN` of the whole, are left out.
    """
    whole = np.sum([*parts.values()], axis=0).max()
    parts = {name: part for name, part in parts.items() if part.max() > UNSEEN * whole} or parts
    figure, (axes,) = _curve_axes([labels], title, ax=ax)
    until = 1 + int(np.abs(x).argmax())
    along = np.append(0.0, x[:until])
    heights = [np.append(start.get(name, 0.0), part[:until]) for name, part in parts.items()]
    axes.stackplot(along, heights, labels=list(parts), colors=COLOURS, alpha=0.85, linewidth=0)
    axes.plot(along, np.sum(heights, axis=0), color="0.15", linewidth=1.0)
    axes.set(xlim=(min(along), max(along)), ylim=(0.0, None))
    # Beside them, as they lie upon each other.
    beside = {"loc": "center left", "bbox_to_anchor": (1.0, 0.5)} if ax is None else {}
    axes.legend(reverse=True, **beside)
    return figure


def tension_surface(law: BiaxialLaw, way: np.ndarray, title: str = "") -> Figure:
    """Draw tensions of warp and weft by both strains, and a way (n, 2) of strains over them.

    Over the range of the points that the law was found from, drawn as discs, or else of the way.
    """
    from matplotlib.cm import ScalarMappable
    from matplotlib.colors import Normalize

    ends = law.strains
    if not np.isfinite(ends).all():
        seen = way if law.points is None else np.concatenate([way, law.points[:, :2]])
        least = max(float(seen.max()), 1e-3)
        ends = np.array([[min(column.min(), 0.0), max(column.max(), least)] for column in seen.T])
    warp, weft = np.meshgrid(*(np.linspace(low, high, 101) for low, high in ends), indexing="ij")
    names = ("warp", "weft")
    labels = [("warp strain (%)", "weft strain (%)")] * 2
    figure, every = _curve_axes(labels, "", (9.2, 4.2))
    figure.suptitle(title)
    tension = 1e-2 * law.evaluate(warp, weft)[1]  # N/cm
    for k, (name, axes) in enumerate(zip(names, every, strict=True)):
        values, points = tension[..., k], law.points
        measured = np.zeros(0) if points is None else 1e-2 * points[:, 2 + k]
        low = min(values.min(), measured.min(initial=0.0))
        high = max(values.max(), measured.max(initial=0.0))
        colours = ScalarMappable(Normalize(low, high), "viridis")
        on = (100 * warp, 100 * weft, values, 12)
        axes.contourf(*on, cmap=colours.cmap, norm=colours.norm)
        lines = axes.contour(*on, colors="w", linewidths=0.5)
        axes.clabel(lines, fontsize=7.5)
        if points is not None:
            axes.scatter(
                100 * points[:, 0], 100 * points[:, 1], 26, colours.to_rgba(measured),
                edgecolors="k", linewidths=0.6, clip_on=False, zorder=4,
            )  # fmt: skip
        axes.plot(*(100 * way.T), color="#D55E00", linewidth=2.0, zorder=5)
        axes.set(xlim=100 * ends[0], ylim=100 * ends[1])
        axes.grid(visible=False)
        figure.colorbar(colours, ax=axes, label=f"tension of the {name} (N/cm)", aspect=30)
    return figure


def convergence(
    crossovers: Values,
    differences: Mapping[str, Values],
    ylabel: str,
    title: str,
    ax: Given = None,
) -> Figure:
    """Draw differences (n,) against the number of crossovers (n,), both on logarithmic axes.

    A guide below them has the slope of the pitch, which goes with crossovers^(-1/2).
    """
    from matplotlib.ticker import LogLocator

    figure, (axes,) = _curve_axes([("crossovers", ylabel)], title, ax=ax)
    count = np.asarray(crossovers, float)
    axes.set(xscale="log", yscale="log")
    for i, (label, values) in enumerate(differences.items()):
        axes.plot(count, values, label=label, **_line_style(i, len(count)))
    slope = (count / count[0]) ** -0.5
    guide = slope * 0.6 * np.nanmin(np.array(list(differences.values()), float) / slope)
    axes.plot(count, guide, color="0.45", linewidth=0.9, linestyle=(0, (4, 3)))
    beside = axes.annotate("∝ pitch", (count[-1], guide[-1]), (4, 0), textcoords="offset points")
    beside.set(va="center", fontsize=8, color="0.35")
    # Numbers as people write them: 1,000 and 0.02, not 10^3 and 2 x 10^-2.
    for axis, (low, high) in ((axes.xaxis, axes.get_xlim()), (axes.yaxis, axes.get_ylim())):
        axis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0) if high < 2e3 * low else (1.0,)))
        axis.set_major_formatter("{x:,.6g}")
        axis.set_minor_formatter("")
    axes.legend()
    return figure


def _curve_axes(
    labels: Sequence[tuple[str, str]],
    title: str,
    size: tuple[float, float] = (5.4, 3.7),
    ax: Given = None,
) -> tuple[Figure, list[Axes]]:
    """Axes side by side, each with its (x, y) labels."""
    figure: Any
    if ax is None:
        figure = figure_of(figsize=size, layout="constrained")
        every = list(figure.subplots(1, len(labels), squeeze=False)[0])
    else:
        every = given(ax, len(labels))
        figure = every[0].figure
    for axes, (x_label, y_label) in zip(every, labels, strict=True):
        axes.set(xlabel=x_label, ylabel=y_label)
        if title or ax is None:
            axes.set_title(title)
        axes.spines[["top", "right"]].set_visible(False)
        axes.grid(color="0.9", linewidth=0.6)
    return figure, every


def _line_style(i: int, points: int) -> dict[str, Any]:
    """Style of the i-th curve of so many points."""
    style = {"color": COLOURS[i % len(COLOURS)], "clip_on": False, "zorder": 3}
    if points > MANY_POINTS:
        return style | {"linestyle": DASHES[i % len(DASHES)]}
    # Later ones are smaller, and dashed: what lies below them is still seen.
    size, dashes = max(5.5 - 1.2 * i, 3.0), DASHES[i % len(DASHES)] if points else "-"
    return style | {"marker": MARKERS[i % len(MARKERS)], "markersize": size, "linestyle": dashes}


def _point_style(i: int) -> dict[str, Any]:
    style = {"color": COLOURS[i % len(COLOURS)], "clip_on": False, "zorder": 4, "linestyle": ""}
    return style | {"marker": MARKERS[i % len(MARKERS)], "markersize": 5.5, "fillstyle": "none"}


def _include_zero(axes: Axes) -> None:
    """Let both axes begin (or end) at zero where all values are on one side of it."""
    data = axes.dataLim
    for (low, high), put in ((data.intervalx, axes.set_xlim), (data.intervaly, axes.set_ylim)):
        rounding = 1e-3 * (high - low)
        if low >= -rounding:
            put(0.0, None)
        elif high <= rounding:
            put(None, 0.0)


def plain_text(text: str) -> str:
    """A text that matplotlib writes as it is: a dollar does not begin a formula."""
    return text.replace("$", r"\$")


def from_origin(x: Values, y: Values) -> tuple[np.ndarray, np.ndarray]:
    """Join the origin, which every test starts from, to a curve that lacks it."""
    x, y = np.atleast_1d(np.asarray(x, float)), np.atleast_1d(np.asarray(y, float))
    if (x > 0).all() or (x < 0).all():
        comes_back = len(x) > 1 and (np.diff(np.abs(x)) < 0).all()
        where = len(x) if comes_back else 0
        x, y = np.insert(x, where, 0.0), np.insert(y, where, 0.0)
    return x, y


def broken_at_gaps(x: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Put a NaN wherever a step along x is far larger than is usual: a line stops at a hole."""
    step = np.diff(x)
    gap = 1 + np.flatnonzero(step > 4.0 * np.median(step if len(step) else 0.0))
    return np.insert(x, gap, np.nan), np.insert(y, gap, np.nan)
