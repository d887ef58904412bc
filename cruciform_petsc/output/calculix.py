# SPDX-License-Identifier: MIT
"""The text of a CalculiX input file: two layers of bricks, each with the direction of its yarns.

CalculiX takes directions element by element of solids only (*DISTRIBUTION), so the cloth has its
thickness: below its middle surface the warp, above the weft. Model data in mm, N, MPa.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from .abaqus import Piece
from .cells import thickening
from .mesh import Mesh
from .tables import lines

LAYERS = ("WARP", "WEFT")


def bricks(mesh: Mesh) -> Iterator[Piece]:
    """Pieces of the file of a mesh. Collective."""
    if mesh.fabric.thickness is None:
        yield "** Nothing here: the fabric's thickness at rest was not given.\n", b""
        return
    thickness = 1e3 * mesh.fabric.thickness * thickening(mesh.node_area_ratio, mesh.hold)
    half = 0.5 * thickness[:, None] * mesh.normal
    node = 3 * mesh.node[:, None] + np.array([-2, -1, 0])  # below, in the middle, above
    place = np.stack([mesh.place - half, mesh.place, mesh.place + half], axis=1)
    first, _, second = mesh.heading.partition("\n")
    yield (
        f"*HEADING\n{first}\n** {second}\n"
        "** Units: mm, N, MPa. Crossover k has the nodes 3 k + 1 below, 3 k + 2 in the middle and\n"
        "** 3 k + 3 above; cell e the elements 2 e - 1 (warp, below) and 2 e (weft, above).\n"
        f"** Thickness at a constant {mesh.hold}.\n"
        "*NODE, NSET=CLOTH\n",
        lines("%d, %.9g, %.9g, %.9g", node.reshape(-1), place.reshape(-1, 3)),
    )
    for layer, name in enumerate(LAYERS):
        for kind, corners in (("C3D8I", 4), ("C3D6", 3)):
            chosen, corner = mesh.with_corners(corners)
            if mesh.comm.allreduce(int(chosen.sum())):
                nodes = np.column_stack([3 * corner - 2 + layer, 3 * corner - 1 + layer])
                data = lines(
                    ", ".join(["%d"] * (1 + 2 * corners)),
                    2 * mesh.element[chosen] - 1 + layer,
                    nodes,
                )
                yield f"*ELEMENT, TYPE={kind}, ELSET={name}\n", data
    along = np.stack([mesh.warp, mesh.weft], axis=1)
    aside = np.stack([mesh.weft, -mesh.warp], axis=1)
    element = 2 * mesh.element[:, None] + np.array([-1, 0])
    yield (
        "** Local 1-direction: along the yarns of the layer; 3: the cloth's normal.\n"
        "*DISTRIBUTION, NAME=YARN_AXES\n, 1., 0., 0., 0., 1., 0.\n",
        lines("%d" + ", %.9g" * 6, element.reshape(-1), along.reshape(-1, 3), aside.reshape(-1, 3)),
    )
    yield (
        "*ORIENTATION, NAME=YARNS, SYSTEM=RECTANGULAR\nYARN_AXES\n"
        "** To be filled in: the properties of one layer, 1 along its fibres, below each name.\n"
        + "".join(f"*MATERIAL, NAME={name}_LAYER\n" for name in LAYERS)
        + "".join(
            f"*SOLID SECTION, ELSET={name}, MATERIAL={name}_LAYER, ORIENTATION=YARNS\n"
            for name in LAYERS
        ),
        b"",
    )
