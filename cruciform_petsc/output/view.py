# SPDX-License-Identifier: MIT
"""The view in space of report.html: what view.js, which is inlined there, turns and colours.

Numbers go into the page as base64 of 16-bit counts between bounds, places to 1/65,534 of the size
of the cloth. The viewer is a file of its own and not three.js or vtk.js: neither comes with a
Python package that is had everywhere this one is, and all that is wanted of them is a mesh, a
camera and a scale.
"""

from __future__ import annotations

import base64
import hashlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from importlib.resources import files
from typing import TYPE_CHECKING, Any

import numpy as np

from ..quantities import quantity
from ..tools.motion import Pose
from . import pictures
from .sample import MAP_LIMIT, Surface, sample_surface
from .scene import HIGH, OBLIQUE

if TYPE_CHECKING:
    from ..experiments.result import TestResult
    from ..net.network import Network
    from ..tools.surface import Facets

NONE = 65535  # the count that stands for no number
MOST_BYTES = 10_000_000  # of places and fields, before base64
MOST_FACETS = 60_000  # of a tool, beyond which its points are merged
MM = 1e3
HINT = "Drag to turn, scroll to zoom, shift-drag to move; point at the cloth to read a value."


@dataclass
class View:
    """A cloth in space at several times, on rank 0; lengths in metres.

    Attributes
    ----------
    captions : list of str
        One a step.
    surfaces : list of Surface
        The cloth at each step; values are in the units of their names, NaN where there are none.
    tools : dict of (points, triangles)
        In the tools' own frames.
    poses : dict of list of Pose or None
        Where each tool is at each step; None where it has been removed.
    """

    captions: list[str] = field(default_factory=list)
    surfaces: list[Surface] = field(default_factory=list)
    tools: Mapping[str, Facets] = field(default_factory=dict)
    poses: dict[str, list[Pose | None]] = field(default_factory=dict)


def steps_shown(network: Network, steps: int, fields: int) -> list[int]:
    """Which of so many steps are shown: all if they fit, else evenly, with first and last."""
    crossovers = min(network.num_crossovers_global, MAP_LIMIT)
    fit = max(2, MOST_BYTES // (2 * (3 + fields) * max(crossovers, 1)))
    return [round(k) for k in np.linspace(0, steps - 1, min(steps, fit))]


def view_of_test(result: TestResult) -> View | None:
    """View of a flat test in space, from the flat cloth on; None of one in the plane. Collective.

    On the other ranks than 0 it is empty.
    """
    test, network = result.experiment, result.network
    if not (test.finite and test.space):
        return None
    view = View()
    columns = ("shear_deg", "height_mm", "warp_tension_N_per_mm", "weft_tension_N_per_mm")
    for k in steps_shown(network, len(result.states) + 1, len(columns)):
        state = result.states[max(k - 1, 0)]
        fields = state.fields if k else {n: 0 * v for n, v in result.states[0].fields.items()}
        moved = fields["displacement"]
        place = np.column_stack([network.crossover_position, np.zeros(len(moved))])
        values = (
            np.rad2deg(fields["shear_angle"]), MM * moved[:, 2],
            fields["warp_tension"] / MM, fields["weft_tension"] / MM,
        )  # fmt: skip
        carrying = result.states[0].fields["carrying"]
        shown = {
            quantity(column).axis: np.where(carrying, value, np.nan)
            for column, value in zip(columns, values, strict=True)
        }
        view.surfaces.append(sample_surface(network, place + moved, shown))
        name = test.column.text(state.control).replace(" deg", "°") if k else "at rest"
        view.captions.append(name)
    return view


def packed(view: View) -> dict[str, Any]:
    """What view.js reads, as JSON can hold it. Not collective.

    Fields that are the same everywhere and at all times are left out, but for the first.
    """
    first = view.surfaces[0]
    points = MM * np.stack([surface.points for surface in view.surfaces])
    low, high = points.min(axis=(0, 1)), points.max(axis=(0, 1))
    a, b = points[:, first.yarns].transpose(2, 0, 1, 3)
    fields: list[dict[str, Any]] = []
    for label in first.values:
        values = [surface.values[label] for surface in view.surfaces]
        packed_field = _field(label, values)
        if not fields or packed_field["low"] < packed_field["high"]:
            fields.append(packed_field)
    return {
        "captions": view.captions,
        "points_per_step": len(first.points),
        "low": low.tolist(),
        "high": high.tolist(),
        "points": _counts(points, low, high),
        "triangles": _text(first.triangles, "<u4"),
        "yarns": _text(first.yarns, "<u4"),
        "fields": fields,
        "tools": [_tool(name, facets, view.poses[name]) for name, facets in view.tools.items()],
        "nearer": float(np.linalg.norm(b - a, axis=2).max(initial=0.0)),
        "azimuth": float(OBLIQUE),
        "elevation": float(HIGH),
        "hint": HINT,
    }


def script() -> tuple[str, str]:
    """The viewer's text, and its hash for a content security policy."""
    text = files("cruciform_petsc.output").joinpath("view.js").read_text(encoding="utf-8")
    digest = hashlib.sha256(text.encode()).digest()
    return text, f"sha256-{base64.b64encode(digest).decode()}"


def _field(label: str, values: Sequence[np.ndarray]) -> dict[str, Any]:
    """A field at all steps, and the scale that the pictures would give it."""
    every = np.stack(values)
    found = every[np.isfinite(every)]
    low, high = (float(found.min()), float(found.max())) if len(found) else (0.0, 0.0)
    colours = pictures.colour_scale(values)
    shades = colours.cmap(np.linspace(0.0, 1.0, 256), bytes=True)[:, :3]
    return {
        "label": label,
        "low": low,
        "high": high,
        "beyond": [colours.cmap.colorbar_extend in (side, "both") for side in ("min", "max")],
        "limits": list(colours.get_clim()),
        "colours": _text(shades, "u1"),
        "values": _counts(every[..., None], np.array([low]), np.array([high])),
    }


def _tool(name: str, facets: Facets, poses: Sequence[Pose | None]) -> dict[str, Any]:
    points, triangles = _merged(MM * facets[0], facets[1])
    low, high = points.min(axis=0), points.max(axis=0)
    return {
        "name": name,
        "low": low.tolist(),
        "high": high.tolist(),
        "points": _counts(points, low, high),
        "triangles": _text(triangles, "<u4"),
        "poses": [  # the turn column by column, as WebGL has it
            None if pose is None else np.append(pose.turn.T, MM * pose.place).tolist()
            for pose in poses
        ],
    }


def _merged(points: np.ndarray, triangles: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Facets as they are if they are few, else with all points in one cell of a grid as one."""
    cells = 256
    low, size = points.min(axis=0), max(float(np.ptp(points, axis=0).max()), 1e-300)
    while len(triangles) > MOST_FACETS:
        cell = np.rint((points - low) * (cells / size)).astype(np.int64)
        _, chosen, number = np.unique(cell, axis=0, return_index=True, return_inverse=True)
        points, triangles = points[chosen], number.ravel()[triangles]
        a, b, c = triangles.T
        triangles = triangles[(a != b) & (b != c) & (c != a)]
        cells //= 2
    return points, triangles


def _counts(values: np.ndarray, low: np.ndarray, high: np.ndarray) -> str:
    """Values (..., k) as counts from ``low`` (k,) to ``high``, NaN as `NONE`."""
    size = np.where(high > low, high - low, 1.0)
    share = np.nan_to_num((values - low) / size)
    return _text(np.where(np.isfinite(values), np.rint((NONE - 1) * share), NONE), "<u2")


def _text(array: np.ndarray, kind: str) -> str:
    return base64.b64encode(np.ascontiguousarray(array).astype(kind).tobytes()).decode("ascii")
