# SPDX-License-Identifier: MIT
"""How fine a membrane's mesh is where nobody says so; without dolfinx, for estimates."""

from __future__ import annotations

from typing import Any

import numpy as np
import shapely


def outline_width(outline: shapely.Polygon) -> float:
    """How wide an outline is in metres: its narrower side, less if it is slender or has holes."""
    low, high = np.reshape(outline.bounds, (2, 2))
    return float(min((high - low).min(), 4 * outline.area / outline.length))


def default_size(outline: shapely.Polygon, fabric: Any, degree: int) -> float:
    """Mesh size in metres that leaves load and displacement within about 0.1 %.

    A part, by measurement, of the width of the layers that follow the yarns from the ends of
    clamps, which goes with the root of the shear modulus over the yarns' modulus; within limits.
    """
    layer = (fabric.shear_modulus / max(fabric.c11, fabric.c22)) ** 0.5
    part = {1: 0.05, 2: 0.35}.get(degree, 0.67)
    return outline_width(outline) * float(np.clip(part * layer, 1 / 96, 1 / 24))


def rigidity(fabric: Any) -> np.ndarray:
    """Of warp and weft in bending, per width, float (2,) [N m]."""
    return np.array([family.yarn_bending * family.yarns for family in (fabric.warp, fabric.weft)])


def finite_size(outline: shapely.Polygon, fabric: Any, degree: int, bending: bool) -> float:
    """Mesh size in metres at finite deformation.

    Coarser than for the linear membrane: a solution takes dozens of its steps.
    """
    width, layer = outline_width(outline), default_size(outline, fabric, degree)
    bends = rigidity(fabric) * bending
    if bends.any():  # yarns that bend spread whatever is sharper
        layer = (bends[bends > 0].min() / fabric.shear_modulus) ** 0.5
    return float(np.clip(layer, width / 40, width / 15))


def formed_size(preform: Any, fabric: Any) -> float:
    """Mesh size in metres among tools: half the network's pitch, which has arm ends there."""
    return 0.5 * float(min(preform.pitch(fabric)))
