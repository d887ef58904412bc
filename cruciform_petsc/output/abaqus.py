# SPDX-License-Identifier: MIT
"""The text of an Abaqus input file: nodes, shells, yarn directions, thickness.

Model data only, without materials' properties, boundary conditions and steps. In mm, N, MPa.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from textwrap import shorten
from typing import TYPE_CHECKING

import numpy as np

from .. import __version__
from ..experiments.result import ZONES
from .provenance import commit
from .tables import lines

if TYPE_CHECKING:
    from ..experiments.result import TestResult

_PER_LINE = 16  # numbers that a data line of *ELSET may hold


@dataclass
class Shells:
    """Nodes and elements of this rank, whole blocks of their numbers, ascending over the ranks.

    Attributes
    ----------
    node : int64 (n,)
        Crossovers; the file's numbers are one higher.
    position_mm : float (n, 2)
    shear_deg, fibre_volume_fraction : float (n,)
        At the nodes; the fraction None if it is not known.
    element : int64 (m,)
        The file's numbers are one higher.
    corner : int64 (m, 4)
        Crossovers, -1 for a triangle's missing one.
    warp, weft : float (m, 2)
        Unit vectors.
    thickness_mm : float (m,)
        NaN if it is not known.
    zone : int8 (m,)
        See TestResult.zones; -1 across zones. None if the test has none.
    """

    node: np.ndarray
    position_mm: np.ndarray
    shear_deg: np.ndarray
    fibre_volume_fraction: np.ndarray | None
    element: np.ndarray
    corner: np.ndarray
    warp: np.ndarray
    weft: np.ndarray
    thickness_mm: np.ndarray
    zone: np.ndarray | None


def input_file(
    result: TestResult, index: int, hold: str, shells: Shells
) -> Iterator[tuple[str, bytes]]:
    """Pieces of the file: lines that are the same on every rank, then this rank's. Collective."""
    fabric, comm = result.network.fabric, result.network.comm
    column = result.experiment.column
    node, element = shells.node + 1, shells.element + 1
    # A title is anything that people write; it must stay one line, of letters that Abaqus knows.
    title = shorten(fabric.name, 100).encode("ascii", "replace").decode()
    yield (
        "*HEADING\n"
        f"cruciform_petsc {__version__}, commit {commit() or 'unknown'}, {result.experiment.kind}\n"
        f"** {title}, {column.column} = {result.states[index].control / column.scale:.9g}\n"
        "** Units: mm, N, MPa. Nodes are crossovers; the node's number is the crossover's plus 1.\n"
        "*NODE, NSET=CROSSOVERS\n",
        lines("%d, %.9g, %.9g, 0.", node, shells.position_mm),
    )
    yield from _elements(comm, shells, element)
    yield (
        "** Local 1-direction: warp. The second point of each line is the weft's own direction,\n"
        "** not at a right angle to the warp where the cloth is sheared.\n"
        "*DISTRIBUTION TABLE, NAME=AXES\n"
        "COORD3D, COORD3D\n"
        "*DISTRIBUTION, NAME=YARN_AXES, LOCATION=ELEMENT, TABLE=AXES\n"
        ", 1., 0., 0., 0., 1., 0.\n",
        lines("%d, %.9g, %.9g, 0., %.9g, %.9g, 0.", element, shells.warp, shells.weft),
    )
    yield "*ORIENTATION, NAME=YARNS, SYSTEM=RECTANGULAR\nYARN_AXES\n3, 0.\n", b""
    yield (
        "** From the warp to the weft, degrees, as an axis: above -90 to 90.\n"
        "*DISTRIBUTION TABLE, NAME=ANGLES\n"
        "ANGLE\n"
        "*DISTRIBUTION, NAME=WEFT_ANGLE, LOCATION=ELEMENT, TABLE=ANGLES\n"
        ", 90.\n",
        lines("%d, %.9g", element, weft_angle_deg(shells.warp, shells.weft)),
    )
    if fabric.thickness is None:
        yield (
            "** No *SHELL SECTION: the fabric's thickness at rest was not given.\n",
            b"",
        )
    else:
        yield from _section(fabric.thickness, hold, element, shells.thickness_mm)
    yield (
        "** Field variable 1: shear angle, degrees.\n*INITIAL CONDITIONS, TYPE=FIELD, VARIABLE=1\n",
        lines("%d, %.9g", node, shells.shear_deg),
    )
    if shells.fibre_volume_fraction is not None:
        yield (
            "** Field variable 2: fibre volume fraction.\n"
            "*INITIAL CONDITIONS, TYPE=FIELD, VARIABLE=2\n",
            lines("%d, %.9g", node, shells.fibre_volume_fraction),
        )


def weft_angle_deg(warp: np.ndarray, weft: np.ndarray) -> np.ndarray:
    """Angle from the warp to the weft as axes, in (-90, 90] degrees; (m,)."""
    sine = warp[:, 0] * weft[:, 1] - warp[:, 1] * weft[:, 0]
    angle = np.rad2deg(np.arctan2(sine, (warp * weft).sum(axis=1)))
    return angle - 180.0 * np.ceil((angle - 90.0) / 180.0)


def _elements(comm, shells: Shells, element: np.ndarray) -> Iterator[tuple[str, bytes]]:
    """Elements by their types and sets of them by zones. Collective."""
    triangle = (shells.corner < 0).any(axis=1)
    corner = shells.corner + 1
    for kind, chosen in (("S4R", ~triangle), ("S3R", triangle)):
        if not comm.allreduce(int(chosen.sum())):
            continue
        # What a triangle lacks has become 0.
        size = 3 if kind == "S3R" else 4
        nodes = corner[chosen][corner[chosen] > 0].reshape(-1, size)
        template = ", ".join(["%d"] * (1 + size))
        yield (
            f"*ELEMENT, TYPE={kind}, ELSET=CLOTH\n",
            lines(template, element[chosen], nodes),
        )
    if shells.zone is None:
        return
    for number, name in enumerate(ZONES):
        members = element[shells.zone == number]
        if not comm.allreduce(len(members)):
            continue
        rows = [members[i : i + _PER_LINE] for i in range(0, len(members), _PER_LINE)]
        text = "".join(", ".join(map(str, row.tolist())) + "\n" for row in rows)
        yield f"*ELSET, ELSET={name.upper()}\n", text.encode()


def _section(rest: float, hold: str, element, thickness_mm) -> Iterator[tuple[str, bytes]]:
    yield (
        f"** Thickness in mm, at a constant {hold}.\n"
        "*DISTRIBUTION TABLE, NAME=LENGTHS\n"
        "LENGTH\n"
        "*DISTRIBUTION, NAME=THICKNESS, LOCATION=ELEMENT, TABLE=LENGTHS\n"
        f", {1e3 * rest:.9g}\n",
        lines("%d, %.9g", element, thickness_mm),
    )
    half = f"{0.5e3 * rest:.9g}"
    yield (
        "** Two layers of half the thickness, each with its fibres along one family of yarns.\n"
        "*SHELL SECTION, ELSET=CLOTH, COMPOSITE, ORIENTATION=YARNS, SHELL THICKNESS=THICKNESS\n"
        f"{half}, 3, WARP_LAYER, 0., WARP\n"
        f"{half}, 3, WEFT_LAYER, WEFT_ANGLE, WEFT\n"
        "** To be filled in: the properties of one layer, 1 along its fibres.\n"
        "*MATERIAL, NAME=WARP_LAYER\n"
        "*MATERIAL, NAME=WEFT_LAYER\n",
        b"",
    )
