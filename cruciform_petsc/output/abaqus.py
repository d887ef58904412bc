# SPDX-License-Identifier: MIT
"""The text of an Abaqus input file: nodes, shells, yarn directions, thickness.

Model data only, without materials' properties, boundary conditions and steps. In mm, N, MPa.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from textwrap import shorten
from typing import TYPE_CHECKING

import numpy as np

from .. import __version__
from ..experiments.result import ZONES
from .cells import lattice_cells, thickening
from .provenance import commit
from .tables import in_order, lines

if TYPE_CHECKING:
    from ..experiments.result import TestResult

_PER_LINE = 16  # numbers that a data line of *ELSET may hold
Piece = tuple[str, bytes]  # lines that are the same on every rank, then this rank's


def input_file(
    result: TestResult, index: int, hold: str, number: np.ndarray, columns: Mapping[str, np.ndarray]
) -> Iterator[Piece]:
    """Pieces of the file for a state. Collective.

    ``number`` and ``columns`` (n,): crossovers as `ordered.in_order` has dealt them out, and what
    exports.crossover_columns tells of them. ``hold``: see exports.export. Numbers in the file are
    one higher.
    """
    network, state, column = result.network, result.states[index], result.experiment.column
    fabric, fields, total = network.fabric, state.fields, network.num_crossovers_global
    has_zones = result.experiment.has_zones
    zones = result.zones if has_zones else np.zeros(network.num_crossovers_owned)
    place = network.crossover_position + fields["displacement"]
    cells = lattice_cells(network, place, fields["carrying"], zones)
    values = [cells.corner, cells.warp, cells.weft, cells.area_ratio, cells.zone]
    key, rows = in_order(network.comm, cells.key, 2 * total, np.column_stack(values))
    corner, warp, weft, area_ratio, zone = np.split(rows, [4, 6, 8, 9], axis=1)
    node = number + 1
    element = (network.comm.exscan(len(key)) or 0) + np.arange(len(key)) + 1
    # A title is anything that people write; it must stay one line, of letters that Abaqus knows.
    title = shorten(fabric.name, 100).encode("ascii", "replace").decode()
    yield (
        "*HEADING\n"
        f"cruciform_petsc {__version__}, commit {commit() or 'unknown'}, {result.experiment.kind}\n"
        f"** {title}, {column.column} = {state.control / column.scale:.9g}\n"
        "** Units: mm, N, MPa. Nodes are crossovers; the node's number is the crossover's plus 1.\n"
        "*NODE, NSET=CROSSOVERS\n",
        lines("%d, %.9g, %.9g, 0.", node, columns["x_mm"], columns["y_mm"]),
    )
    yield from _elements(network.comm, element, corner.astype(np.int64) + 1)
    if has_zones:
        yield from _zone_sets(network.comm, element, zone[:, 0])
    yield _distribution(
        "** Local 1-direction: warp. The second point of each line is the weft's own direction,\n"
        "** not at a right angle to the warp where the cloth is sheared.\n",
        *("YARN_AXES", "AXES", "COORD3D, COORD3D", "1., 0., 0., 0., 1., 0."),
        lines("%d, %.9g, %.9g, 0., %.9g, %.9g, 0.", element, warp, weft),
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
            f"** Thickness in mm, at a constant {hold}.\n",
            *("THICKNESS", "LENGTHS", "LENGTH", f"{rest:.9g}"),
            lines("%d, %.9g", element, rest * thickening(area_ratio, hold)),
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
    variables = {"shear_deg": "shear angle, degrees"}
    if fabric.fibre_volume_fraction is not None:
        variables["fibre_volume_fraction"] = "fibre volume fraction"
    for i, (name, what) in enumerate(variables.items(), 1):
        yield (
            f"** Field variable {i}: {what}.\n*INITIAL CONDITIONS, TYPE=FIELD, VARIABLE={i}\n",
            lines("%d, %.9g", node, columns[name]),
        )


def weft_angle_deg(warp: np.ndarray, weft: np.ndarray) -> np.ndarray:
    """Angle from the warp to the weft (m, 2) as axes, in (-90, 90] degrees; (m,)."""
    sine = warp[:, 0] * weft[:, 1] - warp[:, 1] * weft[:, 0]
    angle = np.rad2deg(np.arctan2(sine, (warp * weft).sum(axis=1)))
    return angle - 180.0 * np.ceil((angle - 90.0) / 180.0)


def _elements(comm, element: np.ndarray, corner: np.ndarray) -> Iterator[Piece]:
    """Elements by their types, with corners (m, 4), 0 where a triangle has none. Collective."""
    size = (corner > 0).sum(axis=1)
    for kind, corners in (("S4R", 4), ("S3R", 3)):
        chosen = size == corners
        if comm.allreduce(int(chosen.sum())):
            nodes = corner[chosen][corner[chosen] > 0].reshape(-1, corners)
            template = ", ".join(["%d"] * (1 + corners))
            data = lines(template, element[chosen], nodes)
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
