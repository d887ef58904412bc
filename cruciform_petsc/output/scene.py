# SPDX-License-Identifier: MIT
"""A picture of woven yarns in space: tubes that pass over and under each other.

The network is plane; the waves of its yarns are added here, those of a plain weave. Needs neither a
display nor an X server, see render.py.
"""

from __future__ import annotations

import subprocess
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from ..errors import InputError
from . import pictures
from .sample import YarnSample

if TYPE_CHECKING:
    from matplotlib.figure import Figure
    from mpi4py import MPI

AROUND = 14  # points around a yarn
ALONG = 8  # pieces of tube per crossover
WIDTH = 0.42  # half the width of a yarn over the distance of two: a little light comes through
THICKNESS = 0.4  # of a cloth of unknown thickness, over that distance
LEAST_COSINE = 0.3  # yarns that have closed further are not drawn any thinner
PIXELS = 1500  # of the larger side of the picture
ELEVATION, TURN = np.deg2rad(52.0), np.deg2rad(18.0)  # of the camera, from across the long axis
STEEL = (176, 181, 188)
SECONDS = 300.0  # until rendering has failed

Mesh = tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]  # points, normals, quads, colours


def woven(
    comm: MPI.Intracomm,
    path: str | Path,
    sample: YarnSample | None,
    lattice: np.ndarray,
    thickness: float | None = None,
    title: str = "",
    *,
    clamps: Sequence[pictures.Clamp] = (),
) -> None:
    """Draw the deformed yarns as tubes coloured by shear angle, as a PNG. Collective.

    Yarns get narrower and thicker where the cloth shears, as they have less room there. Of a large
    network the yarns of the sample stand for several each, and are so much thicker.

    Parameters
    ----------
    comm : mpi4py communicator
    path : str or Path
    sample : YarnSample
        Needed on rank 0 only.
    lattice : float (2, 3)
        (i, j) of a point at rest [m] is ``lattice[:, :2] @ point + lattice[:, 2]``.
    thickness : float, optional
        Of the cloth, m.
    title : str
    clamps : sequence of (segments (n, 2, 2), motion), metres
        Edges to draw as bars.

    Raises
    ------
    InputError
        On every rank: nothing here can render, or the place cannot be written to.
    """

    def draw() -> Figure:
        assert sample is not None
        spacing = 1e3 * sample.spacing
        height = 1e3 * thickness * sample.every if thickness else THICKNESS * spacing
        colours = pictures._angle_colours([sample.shear_angle_deg])
        meshes = _yarns(sample, lattice, spacing, height, colours)
        points = np.concatenate([mesh[0] for mesh in meshes])
        bar = 0.03 * float(np.ptp(points[:, :2], axis=0).max())
        for segments, motion in clamps:
            for a, b in 1e3 * (segments + np.asarray(motion)):
                meshes.append(_box(pictures._bar(a, b, bar), max(height, 0.35 * bar), STEEL))
        view = _View(np.concatenate([mesh[0] for mesh in meshes]))
        return _page(_render(view, meshes), view, colours, title, sample.every)

    pictures._save(comm, path, draw)


# -- meshes -------------------------------------------------------------------------------------


def _yarns(sample: YarnSample, lattice, spacing: float, height: float, colours) -> list[Mesh]:
    """Return tubes of all yarns, lengths in mm."""
    place = (sample.before @ lattice[:, :2].T + lattice[:, 2]) / sample.every
    after = 1e3 * sample.after()
    norm, colour_map, _ = colours
    meshes = []
    for rows in np.split(np.arange(len(after)), sample.first[1:]):
        if len(rows) < 2:
            continue
        family = int(sample.family[rows[0]])
        along, line = place[rows, family], np.round(place[rows[0], 1 - family])
        fine = np.linspace(along[0], along[-1], 1 + int(np.ceil(ALONG * np.ptp(along))))
        centre = np.column_stack([_smooth(fine, along, after[rows, axis]) for axis in (0, 1)])
        shear = sample.shear_angle_deg[rows]
        good = np.isfinite(shear)
        angle = np.interp(fine, along[good], shear[good]) if good.any() else 0.0 * fine
        # Half as thick as the cloth each, and the room of one yarn stays that of one yarn.
        cosine = np.maximum(np.cos(np.deg2rad(angle)), LEAST_COSINE)
        wave = (1 - 2 * family) * np.cos(np.pi * (fine + line))
        centre = np.column_stack([centre, 0.25 * height * wave / cosine])
        shown = angle if good.any() else np.full(len(fine), np.nan)
        shades = colour_map(norm(np.ma.masked_invalid(shown)), bytes=True)[:, :3]
        half = np.column_stack([WIDTH * spacing * cosine, 0.25 * height / cosine])
        meshes.append(_tube(centre, half, shades))
    return meshes


def _smooth(x: np.ndarray, known: np.ndarray, values: np.ndarray) -> np.ndarray:
    """Smooth curve through points that may be two only."""
    from scipy.interpolate import CubicSpline

    return np.interp(x, known, values) if len(known) < 4 else CubicSpline(known, values)(x)


def _tube(centre: np.ndarray, half: np.ndarray, shades: np.ndarray) -> Mesh:
    """Tube of elliptic section about a line (n, 3), half axes (n, 2) in the plane and across."""
    tangent = np.gradient(centre, axis=0)
    tangent /= np.linalg.norm(tangent, axis=1)[:, None]
    side = np.cross([0.0, 0.0, 1.0], tangent)
    side /= np.linalg.norm(side, axis=1)[:, None]
    axes = np.stack([side, np.cross(tangent, side)], axis=1)  # (n, 2, 3)
    angle = 2.0 * np.pi * np.arange(AROUND) / AROUND
    circle = np.column_stack([np.cos(angle), np.sin(angle)])
    rim = np.einsum("kc,nc,ncx->nkx", circle, half, axes)
    normals = np.einsum("kc,nc,ncx->nkx", circle, 1.0 / half, axes)
    normals /= np.linalg.norm(normals, axis=2)[..., None]
    rings = np.arange(len(centre) * AROUND).reshape(len(centre), AROUND)
    turned = np.roll(rings, -1, axis=1)
    quads = np.stack([rings[:-1], turned[:-1], turned[1:], rings[1:]], axis=2).reshape(-1, 4)
    # Caps: strips between the two halves of the first and of the last ring, with their own normals.
    k = np.arange(AROUND // 2)
    strip = np.column_stack([k, (k + 1) % AROUND, (-k - 2) % AROUND, (-k - 1) % AROUND])
    points, count = centre[:, None] + rim, len(rings) * AROUND
    caps = np.concatenate([strip + count, strip + count + AROUND])
    ends = np.repeat([-tangent[0], tangent[-1]], AROUND, axis=0)
    return (
        np.concatenate([points.reshape(-1, 3), points[0], points[-1]]),
        np.concatenate([normals.reshape(-1, 3), ends]),
        np.concatenate([quads, caps]),
        np.repeat(np.concatenate([shades, shades[[0, -1]]]), AROUND, axis=0),
    )


def _box(corners: np.ndarray, height: float, colour: tuple[int, int, int]) -> Mesh:
    """Prism over a quadrangle (4, 2), half below the plane and half above."""
    bottom, top = (
        np.column_stack([corners, np.full(4, 0.5 * sign * height)]) for sign in (-1.0, 1.0)
    )
    faces = [top, bottom[::-1]]
    faces += [np.array([bottom[i - 1], bottom[i], top[i], top[i - 1]]) for i in range(4)]
    normals = np.array([np.cross(face[1] - face[0], face[2] - face[1]) for face in faces])
    normals /= np.linalg.norm(normals, axis=1)[:, None]
    middle = np.concatenate(faces).mean(axis=0)
    outward = np.array([(face.mean(axis=0) - middle) for face in faces])
    inward = (normals * outward).sum(axis=1) < 0.0
    normals[inward] *= -1.0
    quads = np.arange(24).reshape(6, 4)
    quads[inward] = quads[inward, ::-1]
    return (
        np.concatenate(faces),
        np.repeat(normals, 4, axis=0),
        quads,
        np.full((24, 3), colour, np.uint8),
    )


# -- the view -----------------------------------------------------------------------------------


class _View:
    """Parallel projection that shows points (n, 3), their longer side from left to right."""

    def __init__(self, points: np.ndarray):
        across = np.ptp(points[:, 1]) > np.ptp(points[:, 0])
        azimuth = -TURN if across else -0.5 * np.pi - TURN
        flat = np.array([np.cos(azimuth), np.sin(azimuth)])
        self.towards = np.append(np.cos(ELEVATION) * flat, np.sin(ELEVATION))
        self.up = np.append(-np.sin(ELEVATION) * flat, np.cos(ELEVATION))
        self.right = np.cross(self.up, self.towards)
        seen = points @ np.column_stack([self.right, self.up])
        low, high = seen.min(axis=0), seen.max(axis=0)
        margin = 0.015 * (high - low).max()
        self.low, self.high = low - margin, high + margin
        extent = self.high - self.low
        self.size = np.round(PIXELS * extent / extent.max()).astype(int)
        middle = 0.5 * (self.low + self.high)
        self.focus = middle[0] * self.right + middle[1] * self.up
        self.half_height = 0.5 * extent[1]


def _render(view: _View, meshes: list[Mesh]) -> np.ndarray:
    """Have another process draw meshes; uint8 (height, width, 3)."""
    scene = {
        "size": 2 * view.size,
        "focus": view.focus,
        "towards": view.towards,
        "up": view.up,
        "half_height": np.array(view.half_height),
    }
    start = np.cumsum([0, *(len(mesh[0]) for mesh in meshes)])
    for k, name in enumerate(("points", "normals", "quads", "colours")):
        parts = [mesh[k] for mesh in meshes]
        if name == "quads":
            parts = [part + first for part, first in zip(parts, start, strict=False)]
        scene[name] = np.concatenate(parts)
    with tempfile.TemporaryDirectory() as folder:
        source, target = Path(folder) / "scene.npz", Path(folder) / "image.npy"
        np.savez(source, **scene)  # type: ignore[arg-type]
        command = [sys.executable, "-m", "cruciform_petsc.output.render", str(source), str(target)]
        try:
            done = subprocess.run(
                command, capture_output=True, text=True, errors="replace", timeout=SECONDS,
                check=False, cwd=Path(__file__).parents[2],
            )  # fmt: skip
            told = (done.stderr.strip().splitlines() or ["no word why"])[-1]
        except subprocess.TimeoutExpired:
            told = f"not done after {SECONDS:g} s"
        if not target.exists():
            raise InputError(
                "a 3-D picture needs PyVista and a VTK that draws without a display (EGL or "
                f"OSMesa), and here it does not: {told}"
            )
        image = np.load(target, allow_pickle=False)
    rows, columns = (side // 2 for side in image.shape[:2])
    pairs = image[: 2 * rows, : 2 * columns].reshape(rows, 2, columns, 2, 3)
    return pairs.mean(axis=(1, 3)).astype(np.uint8)


def _page(image, view: _View, colours, title: str, every: int) -> Figure:
    """Put a colour bar, the length of the ruler and a title around the image."""
    from matplotlib.cm import ScalarMappable
    from matplotlib.figure import Figure

    width, height = view.size / 200.0
    figure = Figure(figsize=(width + 0.9, height + 0.1))
    axes = figure.add_axes((0.0, 0.0, width / (width + 0.9), height / (height + 0.1)))
    axes.imshow(image, extent=(0, view.size[0], view.size[1], 0), interpolation="antialiased")
    axes.set_axis_off()
    # Level lines in the picture are level in the plane of the cloth, and not foreshortened.
    scale = view.size[0] / (view.high - view.low)[0]
    length = _round_length(0.2 * view.size.max() / scale)
    left, low = 0.01 * view.size[0], 1.0 * view.size[1]
    axes.plot([left, left + scale * length], [low, low], "k", linewidth=2.0, clip_on=False)
    axes.text(left, low - 8, f"{length:g} mm", va="bottom", fontsize=9)
    axes.set(xlim=(0, view.size[0]), ylim=(view.size[1], 0))
    share = min(0.7, 2.4 / (height + 0.1))
    bar_axes = figure.add_axes(
        ((width + 0.15) / (width + 0.9), 0.5 - 0.5 * share, 0.11 / (width + 0.9), share)
    )
    norm, colour_map, extend = colours
    bar = figure.colorbar(ScalarMappable(norm, colour_map), cax=bar_axes, extend=extend)
    bar.set_label(pictures.ANGLE_LABEL)
    if title:
        figure.text(0.5, 1.01, title, ha="center", va="bottom", fontsize=10)
    if every > 1:
        note = f"each yarn drawn stands for {every}; heights {every} times as large"
        figure.text(0.01, -0.03, note, va="top", fontsize=8, color="0.35")
    return figure


def _round_length(most: float) -> float:
    """Largest of 1, 2, 5, 10, 20 ... that is not more."""
    power = 10.0 ** np.floor(np.log10(most))
    return float(power * max(step for step in (1, 2, 5) if step * power <= most))
