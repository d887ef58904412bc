# SPDX-License-Identifier: MIT
"""The text of an OpenRadioss starter file: shells of two plies with /DRAPE.

Written by the formats of Radioss 2022: fields of 10 and 20 letters. Model data in mm, Mg, s; no
materials, boundary conditions or engine file.
"""

from __future__ import annotations

from collections.abc import Iterator
from itertools import product

import numpy as np

from ..parallel import least
from .abaqus import Piece
from .cells import thickening
from .mesh import Mesh
from .tables import lines

PLIES = ("warp", "weft")
_AXES = np.array([a for a in product((0, 1, -1), repeat=3) if a > (0, 0, 0)], float)


def starter_file(mesh: Mesh) -> Iterator[Piece]:
    """Pieces of the file of a mesh. Collective."""
    if mesh.fabric.thickness is None:
        yield "# Nothing here: the fabric's thickness at rest was not given.\n", b""
        return
    reference = reference_axis(mesh)
    half = 0.5e3 * mesh.fabric.thickness
    first, _, second = mesh.heading.partition("\n")
    units = "".join(f"{unit:>20}" for unit in ("Mg", "mm", "s")) + "\n"
    yield (
        f"#RADIOSS STARTER\n# {first}\n# {second}\n"
        f"/BEGIN\npreform\n{_whole(2022, 0)}\n{units}{units}/NODE\n",
        lines("%10d%20.9g%20.9g%20.9g", mesh.node, mesh.place),
    )
    for kind, corners in (("SHELL", 4), ("SH3N", 3)):
        chosen, corner = mesh.with_corners(corners)
        if mesh.comm.allreduce(int(chosen.sum())):
            yield (
                f"/{kind}/{corners - 3 or 2}\n",
                lines("%10d" * (1 + corners), mesh.element[chosen], corner),
            )
    axis = "".join(f"{value:20g}" for value in reference) + _whole(0, 0, 0, 0) + "\n"
    blank = " " * 10
    shells = f"{_whole(24, 0, 2, 0)}{_zeros(2)}\n{_zeros(5)}\n"
    yield (
        "".join(
            f"/PART/{number}\n{name}\n{_whole(1, 1, 0)}\n"
            for number, name in ((1, "cells of four crossovers"), (2, "cells of three"))
        )
        + f"/GRSHEL/PART/1\ncells of four crossovers\n{_whole(1)}\n"
        f"/GRSH3N/PART/2\ncells of three\n{_whole(2)}\n"
        "# Two plies; angles in /DRAPE count about the shell's normal from the vector V of the\n"
        "# property, laid into the shell.\n"
        f"/PROP/TYPE51/1\ncloth\n{shells}"
        f"{blank}{_whole(0)}{_zeros(1)}{blank}{_whole(0)}{blank}{_whole(0)}{_zeros(1)}\n{axis}"
        f"/STACK/1\ncloth\n{shells}"
        f"{blank}{_whole(0)}{_zeros(1)}{blank}{_whole(0)}{blank}{_whole(0)}\n{axis}"
        + "".join(f"{_whole(ply)}{_zeros(3)}{1.0:20g}\n\n" for ply in (1, 2))
        + "".join(
            f"/PLY/{ply}\n{name}\n"
            f"{_whole(ply)}{half:20.9g}{_zeros(1)}{_whole(1, 2, 1)}{90.0:20g}\n{_whole(ply, 0)}\n"
            for ply, name in enumerate(PLIES, 1)
        )
        + "# To be filled in: materials 1, warp, and 2, weft, with 1 along the fibres.\n",
        b"",
    )
    thinning = thickening(mesh.area_ratio, mesh.hold)
    for ply, (name, along) in enumerate(zip(PLIES, (mesh.warp, mesh.weft), strict=True), 1):
        yield f"/DRAPE/{ply}\n{name}\n", b""
        angle = drape_angle_deg(mesh, reference, along)
        for kind, corners in (("SHELL", 4), ("SH3N", 3)):
            chosen, _ = mesh.with_corners(corners)
            rows = mesh.element[chosen], thinning[chosen], angle[chosen]
            yield "", lines(f"{kind:10}%10d%20.9g%20.9g", *rows)
    yield "/END\n", b""


def reference_axis(mesh: Mesh) -> np.ndarray:
    """The axis, or diagonal, that is farthest from all shells' normals, (3,). Collective."""
    axes = _AXES / np.linalg.norm(_AXES, axis=1)[:, None]
    in_shells = [least(mesh.comm, 1.0 - (mesh.across @ axis) ** 2, 1.0) for axis in axes]
    # The first of those that are about as good: x, where that will do.
    best = int(np.argmax(np.array(in_shells) > max(in_shells) - 0.2))
    return _AXES[best]


def drape_angle_deg(mesh: Mesh, reference: np.ndarray, along: np.ndarray) -> np.ndarray:
    """Angles about the shells' normals from an axis laid into them to directions (m, 3), (m,)."""
    normal = mesh.across
    laid = reference - (normal @ reference)[:, None] * normal
    sine = (np.cross(laid, along) * normal).sum(axis=1)
    return np.rad2deg(np.arctan2(sine, (laid * along).sum(axis=1)))


def _whole(*numbers: int) -> str:
    return "".join(f"{number:10d}" for number in numbers)


def _zeros(count: int) -> str:
    return f"{0.0:20g}" * count
