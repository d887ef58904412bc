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
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

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

ALONG = 8  # pieces of tube per crossover
WIDTH = 0.42  # half the width of a yarn over the distance of two: a little light comes through
THICKNESS = 0.4  # of a cloth of unknown thickness, over that distance
LEAST_COSINE = 0.3  # yarns that have closed further are not drawn any thinner
LOW, OBLIQUE = np.deg2rad(28.0), np.deg2rad(-62.0)  # of the camera on a formed blank
AROUND = 0.1  # of the blank's size: how far around it tools are shown
PIXELS = 1500  # of the larger side of the picture
ELEVATION, TURN = np.deg2rad(52.0), np.deg2rad(18.0)  # of the camera, from across the long axis
STEEL = (176, 181, 188)
SECONDS = 300.0  # until rendering has failed


def woven(sample: YarnSample, clamps: np.ndarray, fabric: Fabric, title: str = "") -> Figure:
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
    image, extent = _render(scene | _view(scene))
    return _page(image, 1e3 * extent, colours, title, sample.every)


def formed(
    cloth: tuple[np.ndarray, np.ndarray, np.ndarray],
    tools: tuple[np.ndarray, np.ndarray],
    title: str = "",
) -> Figure:
    """Draw a formed blank in the colours of its values, between see-through tools. Not collective.

    The cloth's points (n, 3) m, triangles (m, 3) and values (n,), degrees; the tools' points and
    triangles, of which what is near the cloth is shown. InputError if nothing here can render.
    """
    points, triangles, values = cloth
    colours = pictures.colour_scale([values])
    shades = colours.to_rgba(np.ma.masked_invalid(values), bytes=True)[:, :3]
    room = AROUND * np.ptp(points, axis=0).max()
    box = np.stack([points.min(axis=0) - room, points.max(axis=0) + room], axis=1)
    scene = {
        "points": points, "triangles": triangles, "shades": shades,
        "tool_points": tools[0], "tool_triangles": tools[1], "tool_box": box.ravel(),
    }  # fmt: skip
    image, extent = _render(scene | _looked_at(points, OBLIQUE, LOW, 0.06))
    return _page(image, 1e3 * extent, colours, title, 1)


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
def _render(scene: dict[str, np.ndarray]) -> tuple[np.ndarray, np.ndarray]:
    """Have another process draw; uint8 (height, width, 3), and its (width, height) in metres."""
    with tempfile.TemporaryDirectory() as folder, _display() as variables:
        source, target = Path(folder) / "scene.npz", Path(folder) / "image.npy"
        np.savez(source, **scene)  # type: ignore[arg-type]
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
        image = np.load(target, allow_pickle=False)
    return image, 2.0 * scene["half_height"] / len(image) * np.array(image.shape[1::-1])


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
    image: np.ndarray, extent: np.ndarray, colours: ScalarMappable, title: str, every: int
) -> Figure:
    """Put a colour bar, the length of a ruler and a title around an image of (2,) mm."""
    from matplotlib.figure import Figure

    width, height = 7.5 * extent / extent.max()
    figure = Figure(figsize=(width + 0.9, height + 0.3), layout="constrained")
    axes = figure.subplots()
    axes.imshow(image, extent=(0.0, extent[0], 0.0, extent[1]), interpolation="antialiased")
    axes.set_axis_off()
    # Level lines in the picture are level in the plane of the cloth, and not foreshortened.
    left, longest = 0.01 * extent[0], 0.2 * extent.max()
    lengths = np.array([1.0, 2.0, 5.0]) * 10.0 ** np.floor(np.log10(longest))
    length = lengths[lengths <= longest].max()
    axes.plot([left, left + length], [0.0, 0.0], "k", linewidth=2.0, clip_on=False)
    axes.annotate(f"{length:g} mm", (left, 0.0), (0, 4), textcoords="offset points", fontsize=9)
    axes.set(xlim=(0.0, extent[0]), ylim=(0.0, extent[1]))
    pictures.colour_bar([axes], colours, pictures.ANGLE_LABEL, shrink=min(0.7, 2.4 / height))
    axes.set_title(title, fontsize=10)
    if every > 1:
        note = f"each yarn drawn stands for {every}; heights {every} times as large"
        figure.text(0.01, -0.01, note, va="top", fontsize=8, color="0.35")
    return figure
