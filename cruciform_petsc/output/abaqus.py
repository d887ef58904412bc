# SPDX-License-Identifier: MIT
"""The text of an Abaqus input file: nodes, shells, yarn directions, thickness.

Model data only, without materials' properties, boundary conditions and steps. In mm, N, MPa.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from ..experiments.result import ZONES
from .cells import thickening
from .mesh import Mesh
from .tables import lines

_PER_LINE = 16  # numbers that a data line of *ELSET may hold
Piece = tuple[str, bytes]  # lines that are the same on every rank, then this rank's


def input_file(mesh: Mesh, has_zones: bool = False) -> Iterator[Piece]:
    """Pieces of the file of a mesh. Collective.

    ``has_zones``: write sets of the elements in zones.
    """
    fabric, node, element = mesh.fabric, mesh.node, mesh.element
    warp, weft = mesh.warp, mesh.weft
    first, _, second = mesh.heading.partition("\n")
    yield (
        f"*HEADING\n{first}\n** {second}\n"
        "** Units: mm, N, MPa. Nodes are crossovers; the node's number is the crossover's plus 1.\n"
        "*NODE, NSET=CROSSOVERS\n",
        lines("%d, %.9g, %.9g, %.9g", node, mesh.place),
    )
    yield from _elements(mesh)
    if has_zones:
        yield from _zone_sets(mesh.comm, element, mesh.zone)
    yield _distribution(
        "** Local 1-direction: warp. The second point of each line is the weft's own direction,\n"
        "** not at a right angle to the warp where the cloth is sheared.\n",
        *("YARN_AXES", "AXES", "COORD3D, COORD3D", "1., 0., 0., 0., 1., 0."),
        lines("%d, %.9g, %.9g, %.9g, %.9g, %.9g, %.9g", element, warp, weft),
    )
    yield "*ORIENTATION, NAME=YARNS, SYSTEM=RECTANGULAR\nYARN_AXES\n3, 0.\n", b""
    yield _distribution(
        "** From the warp to the weft, degrees, as an axis: above -90 to 90.\n",
        *("WEFT_ANGLE", "ANGLES", "ANGLE", "90."),
        lines("%d, %.9g", element, weft_angle_deg(warp, weft)),
    )
    if fabric.thickness is None:
        yield "** No *SHELL SECTION: the fabric's thickness at rest was not given.\n", b""
    else:
        rest = 1e3 * fabric.thickness
        yield _distribution(
            f"** Thickness in mm, at a constant {mesh.hold}.\n",
            *("THICKNESS", "LENGTHS", "LENGTH", f"{rest:.9g}"),
            lines("%d, %.9g", element, rest * thickening(mesh.area_ratio, mesh.hold)),
        )
        yield (
            "** Two layers of half the thickness, each with its fibres along one family of yarns.\n"
            "*SHELL SECTION, ELSET=CLOTH, COMPOSITE, ORIENTATION=YARNS, SHELL THICKNESS=THICKNESS\n"
            f"{0.5 * rest:.9g}, 3, WARP_LAYER, 0., WARP\n"
            f"{0.5 * rest:.9g}, 3, WEFT_LAYER, WEFT_ANGLE, WEFT\n"
            "** To be filled in: the properties of one layer, 1 along its fibres.\n"
            "*MATERIAL, NAME=WARP_LAYER\n"
            "*MATERIAL, NAME=WEFT_LAYER\n",
            b"",
        )
    variables = {"shear angle, degrees": mesh.shear_deg}
    if fabric.fibre_volume_fraction is not None:
        variables["fibre volume fraction"] = mesh.fraction(mesh.node_area_ratio)
    for i, (what, values) in enumerate(variables.items(), 1):
        yield (
            f"** Field variable {i}: {what}.\n*INITIAL CONDITIONS, TYPE=FIELD, VARIABLE={i}\n",
            lines("%d, %.9g", node, values),
        )


def weft_angle_deg(warp: np.ndarray, weft: np.ndarray) -> np.ndarray:
    """Angle from the warp to the weft (m, 3) as axes, in (-90, 90] degrees; (m,).

    About warp times weft, the normal of shells whose corners go that way.
    """
    sine = np.linalg.norm(np.cross(warp, weft), axis=1)
    angle = np.rad2deg(np.arctan2(sine, (warp * weft).sum(axis=1)))
    return angle - 180.0 * np.ceil((angle - 90.0) / 180.0)


def _elements(mesh: Mesh) -> Iterator[Piece]:
    """Elements by their types. Collective."""
    for kind, corners in (("S4R", 4), ("S3R", 3)):
        chosen, nodes = mesh.with_corners(corners)
        if mesh.comm.allreduce(int(chosen.sum())):
            template = ", ".join(["%d"] * (1 + corners))
            data = lines(template, mesh.element[chosen], nodes)
            yield f"*ELEMENT, TYPE={kind}, ELSET=CLOTH\n", data


def _zone_sets(comm, element: np.ndarray, zone: np.ndarray) -> Iterator[Piece]:
    """Sets of the elements that lie in one zone. Collective."""
    for number, name in enumerate(ZONES):
        members = element[zone == number].astype(str)
        if comm.allreduce(len(members)):
            rows = np.split(members, range(_PER_LINE, len(members), _PER_LINE))
            text = "".join(", ".join(row) + "\n" for row in rows if len(row))
            yield f"*ELSET, ELSET={name.upper()}\n", text.encode()


def _distribution(
    remark: str, name: str, table: str, kinds: str, default: str, data: bytes
) -> Piece:
    """Values of the elements, of ``kinds`` that Abaqus names."""
    return (
        f"{remark}*DISTRIBUTION TABLE, NAME={table}\n{kinds}\n"
        f"*DISTRIBUTION, NAME={name}, LOCATION=ELEMENT, TABLE={table}\n, {default}\n"
    ), data
