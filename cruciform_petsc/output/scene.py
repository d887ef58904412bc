# SPDX-License-Identifier: MIT
"""A picture of woven yarns in space: tubes that pass over and under each other.

The network is plane; the waves of its yarns are added here, those of its weave. No display is
needed: Xvfb stands for one where it is there, and VTK's own wheel needs none.
"""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ..cloth.weave import Weave
from ..errors import InputError
from . import pictures
from .folder import explaining
from .sample import YarnSample

if TYPE_CHECKING:
    from matplotlib.cm import ScalarMappable
    from matplotlib.figure import Figure

    from ..cloth.fabric import Fabric
    from .pictures import Given

ALONG = 8  # pieces of tube per crossover
WIDTH = 0.42  # half the width of a yarn over the distance of two: a little light comes through
THICKNESS = 0.4  # of a cloth of unknown thickness, over that distance
LEAST_COSINE = 0.3  # yarns that have closed further are not drawn any thinner
HIGH, OBLIQUE = np.deg2rad(40.0), np.deg2rad(-62.0)  # of the camera on a formed blank
NEARER = 1.0  # of a piece of yarn: how far the cloth is moved towards it, tools twice as far
AROUND = 0.1  # of the blank's size: how far around it tools are shown
PIXELS = 1500  # of the larger side of the picture
ELEVATION, TURN = np.deg2rad(52.0), np.deg2rad(18.0)  # of the camera, from across the long axis
ANIMATED = 0.5  # share of PIXELS in an animation
STEEL = (176, 181, 188)
SECONDS = 300.0  # until rendering has failed


def woven(
    sample: YarnSample, clamps: np.ndarray, fabric: Fabric, title: str = "", ax: Given = None
) -> Figure:
    """Draw the deformed yarns as tubes in the colours of their values. Not collective.

    Yarns get narrower and thicker where the cloth shears, as they have less room there. Of a large
    network the yarns of the sample stand for several each, and are so much thicker. Values are in
    degrees; thickness and weave are the fabric's; ``clamps`` are segments (n, 2, 2) to draw as
    bars, the cloth on their left. InputError if nothing here can render.
    """
    thickness = fabric.thickness
    height = thickness * sample.every if thickness else THICKNESS * sample.spacing
    colours = pictures.colour_scale([sample.values])
    scene = yarn_lines(sample, height, colours, Weave.named(fabric.weave))
    width = pictures.bar_width(*pictures.bounds([scene["lines"][:, :2]]))
    scene["bars"] = pictures.bar_corners(clamps, width)
    scene["bar_height"] = np.array(max(height, 0.35 * width))
    scene["bar_colour"] = np.array(STEEL)
    images, extent = _render([scene | _view(scene)])
    figure = _page(images, 1e3 * extent, colours, title, ax=ax)
    if sample.every > 1 and ax is None:
        note = f"each yarn drawn stands for {sample.every}; heights {sample.every} times as large"
        figure.text(0.01, -0.01, note, va="top", fontsize=8, color="0.35")
    return figure


@dataclass
class Frame:
    """A formed blank at one time, for `formed`; lengths in metres, angles in degrees.

    Attributes
    ----------
    points, values : float (n, 3), (n,)
        Of the cloth; NaN where a crossover carries nothing.
    triangles, yarns : int (m, 3), (k, 2)
        Between its points; pieces of the yarns that are drawn as lines.
    below, above : (points, triangles)
        Of the tools that the cloth lies on, and of those that come from above.
    caption : str
    """

    points: np.ndarray
    values: np.ndarray
    triangles: np.ndarray
    yarns: np.ndarray
    below: tuple[np.ndarray, np.ndarray]
    above: tuple[np.ndarray, np.ndarray]
    caption: str = ""


def formed(
    frames: Sequence[Frame],
    title: str = "",
    label: str = pictures.SIZE_LABEL,
    ax: Given = None,
) -> Figure:
    """Draw a formed blank at some times, its yarns on it, among the tools. Not collective.

    Of tools what is near the cloth is shown; those from above are see-through, and cut open in
    front. In parallel projection nothing moves in the picture that is moved towards the camera: so
    cloth stays visible that has been pressed into a tool by less than its nets are coarse.
    InputError if nothing here can render.
    """
    images, extent, colours = _formed_images(frames, 1.0 if len(frames) == 1 else 0.6)
    captions = [frame.caption for frame in frames]
    if len(captions) == 1:
        title, captions = f"{title}\n{captions[0]}".strip(), [""]
    return _page(images, extent, colours, title, captions, label, ax)


def animate(frames: Sequence[Frame], path: str | Path, title: str = "") -> None:
    """Write the pictures of `formed` one after the other as a GIF that repeats. Not collective.

    InputError if nothing here can render.
    """
    from matplotlib import rc_context

    images, extent, colours = _formed_images(frames, ANIMATED)
    pages = (
        _page(
            [image], extent, colours, f"{title}\n{frame.caption}".strip(), [""], pictures.SIZE_LABEL
        )
        for image, frame in zip(images, frames, strict=True)
    )
    with rc_context(pictures.STYLE):
        pictures.save_animation(path, pages)


def _formed_images(
    frames: Sequence[Frame], share: float
) -> tuple[list[np.ndarray], np.ndarray, ScalarMappable]:
    """Pictures of one view, of that share of `PIXELS`; their (width, height) in mm; the colours."""
    colours = pictures.colour_scale([frame.values for frame in frames])
    cloth = np.concatenate([frame.points for frame in frames])
    size = np.ptp(cloth, axis=0).max()
    view = _looked_at(cloth, OBLIQUE, HIGH, 0.06)
    view["size"] = (view["size"] * share).astype(int)
    room = AROUND * size
    box = np.stack([cloth.min(axis=0) - room, cloth.max(axis=0) + room], axis=1).ravel()
    middle = 0.5 * (cloth.min(axis=0) + cloth.max(axis=0))
    front = np.array([np.cos(OBLIQUE), np.sin(OBLIQUE), 0.0])
    scenes = []
    for frame in frames:
        a, b = frame.points[frame.yarns].transpose(1, 0, 2)
        nearer = NEARER * np.linalg.norm(b - a, axis=1).max(initial=0.0) * view["towards"]
        shades = colours.to_rgba(np.ma.masked_invalid(frame.values), bytes=True)[:, :3]
        scenes.append(view | {
            "points": frame.points, "triangles": frame.triangles, "shades": shades,
            "yarns": frame.yarns, "nearer": nearer,
            "below_points": frame.below[0], "below_triangles": frame.below[1],
            "above_points": frame.above[0], "above_triangles": frame.above[1],
            "box": box, "middle": middle, "front": front,
        })  # fmt: skip
    images, extent = _render(scenes)
    return images, 1e3 * extent, colours


def _looked_at(
    points: np.ndarray, azimuth: float, elevation: float, margin: float
) -> dict[str, np.ndarray]:
    """Parallel projection that shows points (n, 3), and a margin of so much of their size."""
    flat = np.array([np.cos(azimuth), np.sin(azimuth)])
    towards = np.append(np.cos(elevation) * flat, np.sin(elevation))
    up = np.append(-np.sin(elevation) * flat, np.cos(elevation))
    right = np.cross(up, towards)
    low, high = pictures.bounds([points @ np.column_stack([right, up])])
    extent, middle = high - low + 2.0 * margin * (high - low).max(), 0.5 * (low + high)
    return {
        "size": np.round(PIXELS * extent / extent.max()).astype(int),
        "focus": middle[0] * right + middle[1] * up,
        "towards": towards,
        "up": up,
        "half_height": 0.5 * extent[1],
    }


def yarn_lines(
    sample: YarnSample, height: float, colours: ScalarMappable, weave: Weave
) -> dict[str, np.ndarray]:
    """Lines of all yarns with the waves of their weave, for `render.tubes`; lengths in metres.

    The cloth at rest is ``height`` thick.
    """
    from scipy.interpolate import make_interp_spline

    place, after = sample.lattice / sample.every, sample.after
    lines, halves, angles = [], [], []
    for rows in np.split(np.arange(len(after)), sample.first[1:]):
        if len(rows) < 2:
            continue
        family = int(sample.family[rows[0]])
        along, line = place[rows, family], round(place[rows[0], 1 - family])
        fine = np.linspace(along[0], along[-1], 1 + int(np.ceil(ALONG * np.ptp(along))))
        good = rows[np.isfinite(sample.values[rows])]
        angle = np.full(len(fine), np.nan)
        if len(good):
            angle = np.interp(fine, place[good, family], sample.values[good])
        # Half as thick as the cloth each, and the room of one yarn stays that of one yarn.
        cosine = np.maximum(np.cos(np.deg2rad(np.nan_to_num(angle))), LEAST_COSINE)
        wave = weave.heights(family, line, fine)
        curve = make_interp_spline(along, after[rows], k=min(3, len(rows) - 1))
        lines.append(np.column_stack([curve(fine), 0.25 * height * wave / cosine]))
        halves.append(np.column_stack([WIDTH * sample.spacing * cosine, 0.25 * height / cosine]))
        angles.append(angle)
    shown = np.ma.masked_invalid(np.concatenate(angles))
    return {
        "lines": np.concatenate(lines),
        "first": np.cumsum([0, *(len(line) for line in lines[:-1])]),
        "half": np.concatenate(halves),
        "shades": colours.to_rgba(shown, bytes=True)[:, :3],
    }


def _view(scene: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
    """Parallel projection that shows all yarns and bars, their longer side from left to right."""
    bars = np.pad(scene["bars"].reshape(-1, 2), ((0, 0), (0, 1)))
    points = np.concatenate([scene["lines"], bars])
    across = np.ptp(points[:, 1]) > np.ptp(points[:, 0])
    azimuth = -TURN if across else -0.5 * np.pi - TURN
    margin = scene["half"].max() / np.ptp(points, axis=0).max() + 0.015
    return _looked_at(points, azimuth, ELEVATION, margin)


@explaining("the yarns in space cannot be drawn", also=ValueError)  # half an image
def _render(scenes: Sequence[dict[str, np.ndarray]]) -> tuple[list[np.ndarray], np.ndarray]:
    """Have another process draw scenes of one view.

    Images, uint8 (height, width, 3) each, and their (width, height) in metres.
    """
    every = {
        f"{i}/{name}": array for i, scene in enumerate(scenes) for name, array in scene.items()
    }
    with tempfile.TemporaryDirectory() as folder, _display() as variables:
        source, target = Path(folder) / "scene.npz", Path(folder) / "images.npz"
        np.savez(source, **every)  # type: ignore[arg-type]
        command = [sys.executable, "-m", "cruciform_petsc.output.render", str(source), str(target)]
        try:
            done = subprocess.run(
                command, capture_output=True, text=True, errors="replace", timeout=SECONDS,
                check=False, cwd=Path(__file__).parents[2], env=os.environ | variables,
            )  # fmt: skip
            reason = (done.stderr.strip().splitlines() or ["no word why"])[-1]
        except subprocess.TimeoutExpired:
            reason = f"not done after {SECONDS:g} s"
        if not target.exists():
            raise InputError(
                "a 3-D picture needs PyVista and a VTK that draws without a display (EGL, OSMesa "
                f"or Xvfb), and here it does not: {reason}"
            )
        with np.load(target, allow_pickle=False) as data:
            images = [data[f"{i}"] for i in range(len(scenes))]
    height, width = images[0].shape[:2]
    return images, 2.0 * scenes[0]["half_height"] / height * np.array([width, height])


@contextmanager
def _display() -> Iterator[dict[str, str]]:
    """A display in memory while the block runs, as environment variables; none without Xvfb.

    Also where there is a display: one that comes through SSH may not do for VTK.
    """
    program = shutil.which("Xvfb")
    if program is None:
        yield {}
        return
    # -terminate: it ends with the process that draws, should this one be killed.
    command = [program, "-displayfd", "1", "-terminate", "-screen", "0", "1280x1024x24"]
    with subprocess.Popen(
        command, stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL
    ) as server:
        try:
            assert server.stdout is not None
            number = server.stdout.readline().decode().strip()
            yield {"DISPLAY": f":{number}"} if number else {}
        finally:
            server.terminate()


def _page(
    images: Sequence[np.ndarray],
    extent: np.ndarray,
    colours: ScalarMappable,
    title: str,
    captions: Sequence[str] = ("",),
    label: str = pictures.ANGLE_LABEL,
    ax: Given = None,
) -> Figure:
    """Put a colour bar, a ruler and titles around images of (2,) mm each."""
    figure: Any
    if ax is None:
        rows = 1 if len(images) == 1 else (len(images) + 1) // 2
        columns = -(-len(images) // rows)
        width, height = 7.5 / (1.0 if columns == 1 else 1.6) * extent / extent.max()
        figure = pictures.figure_of(
            figsize=(columns * width + 0.9, rows * (height + 0.25 * any(captions)) + 0.3),
            layout="constrained",
        )
        every = list(figure.subplots(rows, columns, squeeze=False).ravel())
        bar = {"shrink": min(0.7, 2.4 / (rows * height))}
    else:
        every, bar = pictures.given(ax, len(images)), {"shrink": 0.7}
        figure = every[0].figure
    for axes in every:
        axes.set_axis_off()
        axes.set(xlim=(0.0, extent[0]), ylim=(0.0, extent[1]), aspect="equal")
    for axes, image, caption in zip(every, images, captions, strict=False):
        axes.imshow(image, extent=(0.0, extent[0], 0.0, extent[1]), interpolation="antialiased")
        axes.set_title(caption or title, fontsize=10)
    # Level lines in the picture are level in the plane of the cloth, and not foreshortened.
    left, longest = 0.01 * extent[0], 0.2 * extent.max()
    lengths = np.array([1.0, 2.0, 5.0]) * 10.0 ** np.floor(np.log10(longest))
    length = lengths[lengths <= longest].max()
    first = every[0]
    first.plot([left, left + length], [0.0, 0.0], "k", linewidth=2.0, clip_on=False)
    first.annotate(f"{length:g} mm", (left, 0.0), (0, 4), textcoords="offset points", fontsize=9)
    pictures.colour_bar(every, colours, label, **bar)
    if any(captions) and ax is None:
        figure.suptitle(title, fontsize=11)
    return figure
