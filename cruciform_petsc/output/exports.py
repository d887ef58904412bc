# SPDX-License-Identifier: MIT
"""The deformed cloth for other programs: a table of crossovers and an input file for Abaqus.

docs/exports.md tells what the numbers mean. Every rank writes its part; none gathers.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from ..errors import InputError
from ..net.lattice import ARM_STEP, QUADRANTS
from .abaqus import Shells, input_file
from .cells import lattice_cells
from .folder import prepare_directory
from .tables import in_order, lines, write_pieces

if TYPE_CHECKING:
    from ..cloth.fabric import Fabric
    from ..experiments.result import State, TestResult

CROSSOVERS, PREFORM = "crossovers.csv", "preform.inp"
# What stays as it is while the cloth deforms.
HELD = ("fibre volume fraction", "thickness")
_MM = 1e3


def export(
    result: TestResult,
    folder: str | Path,
    index: int = -1,
    hold: str = "fibre volume fraction",
) -> list[Path]:
    """Write ``crossovers.csv`` and ``preform.inp`` of one state. Collective.

    Parameters
    ----------
    result : TestResult
    folder : str or Path
        Made if need be.
    index : int
        Which of the result's states.
    hold : str
        What stays as it is while the cloth deforms: "fibre volume fraction" (the thickness grows
        where the area shrinks) or "thickness" (a mould's gap; the fraction grows).

    Returns
    -------
    list of Path
        The files.

    Raises
    ------
    InputError
        On every rank: no such state, another word for ``hold``, the place cannot be written to.
    """
    if hold not in HELD:
        raise InputError(f'hold must be "{HELD[0]}" or "{HELD[1]}", got {hold!r}')
    if not -len(result.states) <= index < len(result.states):
        raise InputError(f"there are {len(result.states)} states, index {index} is not one of them")
    directory = prepare_directory(result.network.comm, folder)
    write_crossovers(directory / CROSSOVERS, result, index, hold)
    write_preform(directory / PREFORM, result, index, hold)
    return [directory / CROSSOVERS, directory / PREFORM]


# -- thickness and fibre volume fraction --------------------------------------------------------


def thickness(fabric: Fabric, area_ratio: np.ndarray, hold: str) -> np.ndarray:
    """Thickness where the cloth has ``area_ratio`` times its area at rest, m; NaN if not known."""
    rest = np.nan if fabric.thickness is None else fabric.thickness
    return rest / area_ratio if hold == HELD[0] else np.full(np.shape(area_ratio), rest)


def fibre_volume_fraction(fabric: Fabric, area_ratio: np.ndarray, hold: str) -> np.ndarray:
    """Volume of the fibres over that of the cloth; NaN if the fabric's data do not give it."""
    rest = fabric.fibre_volume_fraction
    rest = np.nan if rest is None else rest
    return np.full(np.shape(area_ratio), rest) if hold == HELD[0] else rest / area_ratio


# -- crossovers ---------------------------------------------------------------------------------


def yarn_rotations(result: TestResult, state: State) -> np.ndarray:
    """Rotations of warp and weft from rest at this rank's crossovers, radians; (n_owned, 2).

    Collective when the state's fields are first asked for. Means over the quadrants as those of
    the fields: their difference is the shear angle. Crossovers whose fields are none, because they
    carry nothing, turn with their arms.
    """
    network, supports, fields = result.network, result.supports, state.fields
    area = network.quadrant_area.copy()
    area[network.boundary_crossovers] = supports.quadrant_area
    share = area / np.maximum(area.sum(axis=1, keepdims=True), 1e-300)
    rotation = np.einsum("nq,nqf->nf", share, fields["arm_rotation"][:, QUADRANTS])
    loose = np.flatnonzero(~supports.carrying | (area.sum(axis=1) == 0.0))
    if len(loose):
        frame = network.preform.rotation
        moved = state.node_displacement[network.arm_node[loose]]
        arm = (moved - fields["displacement"][loose, None]) @ frame.T
        rest = network.arm_length[loose][..., None] * ARM_STEP
        arm += rest
        turned = rest[..., 0] * arm[..., 1] - rest[..., 1] * arm[..., 0]
        rotation[loose] = np.arctan2(turned.sum(axis=1), (rest * arm).sum(axis=(1, 2)))[:, None]
    return rotation


def crossover_columns(
    result: TestResult, index: int = -1, hold: str = "fibre volume fraction"
) -> dict[str, np.ndarray]:
    """What the table of crossovers says, with units in the names; (n_owned,) each. Collective.

    NaN where the fabric's data do not give a value.
    """
    network, fabric, state = result.network, result.network.fabric, result.states[index]
    fields = state.fields
    rotation = yarn_rotations(result, state)
    # The axes of the yarns at rest are the rows of the frame.
    axis, across = network.preform.rotation, np.array([[0.0, 1.0], [-1.0, 0.0]])
    warp, weft = (
        np.cos(rotation[:, [f]]) * axis[f] + np.sin(rotation[:, [f]]) * (axis[f] @ across)
        for f in (0, 1)
    )
    shear = rotation[:, 0] - rotation[:, 1]
    stretched = (1.0 + fields["warp_strain"]) * (1.0 + fields["weft_strain"])
    area_ratio = stretched * np.cos(shear)
    rest, now = network.crossover_position, network.crossover_position + fields["displacement"]
    mass = np.nan if fabric.areal_density is None else fabric.areal_density
    return {
        "crossover": network.crossover_number_global,
        "x_rest_mm": _MM * rest[:, 0],
        "y_rest_mm": _MM * rest[:, 1],
        "x_mm": _MM * now[:, 0],
        "y_mm": _MM * now[:, 1],
        "warp_x": warp[:, 0],
        "warp_y": warp[:, 1],
        "weft_x": weft[:, 0],
        "weft_y": weft[:, 1],
        "shear_deg": np.rad2deg(shear),
        "area_ratio": area_ratio,
        "areal_density_g_per_m2": 1e3 * mass / area_ratio,
        "thickness_mm": _MM * thickness(fabric, area_ratio, hold),
        "fibre_volume_fraction": fibre_volume_fraction(fabric, area_ratio, hold),
        "warp_tension_N_per_mm": fields["warp_tension"] / _MM,
        "weft_tension_N_per_mm": fields["weft_tension"] / _MM,
        "carrying": fields["carrying"],
    }


def write_crossovers(
    path: str | Path, result: TestResult, index: int = -1, hold: str = "fibre volume fraction"
) -> None:
    """Write the table of crossovers, ordered by their numbers; see `export`. Collective.

    Ten digits of each value; an empty field where the fabric's data do not give one.
    """
    network = result.network
    columns = crossover_columns(result, index, hold)
    names = list(columns)
    rows = np.column_stack([columns[name] for name in names[1:]]).astype(float)
    number, rows = in_order(network.comm, columns["crossover"], network.num_crossovers_global, rows)
    head = ",".join(names) + "\n" if network.comm.rank == 0 else ""
    template = ",".join(["%d", *["%.10g"] * (len(names) - 2), "%d"])
    table = lines(template, number, rows).replace(b"nan", b"")
    write_pieces(network.comm, path, [head.encode(), table])


# -- cells --------------------------------------------------------------------------------------


def write_preform(
    path: str | Path, result: TestResult, index: int = -1, hold: str = "fibre volume fraction"
) -> None:
    """Write the cloth as shells for Abaqus; see `export` and docs/exports.md. Collective."""
    network, fabric = result.network, result.network.fabric
    comm, total = network.comm, network.num_crossovers_global
    columns = crossover_columns(result, index, hold)
    place = np.column_stack([columns["x_mm"], columns["y_mm"]])
    data = [place, columns["shear_deg"], columns["fibre_volume_fraction"]]
    number, nodes = in_order(comm, columns["crossover"], total, np.column_stack(data))

    has_zones = result.experiment.has_zones
    zones = result.zones if has_zones else np.zeros(network.num_crossovers_owned, np.int8)
    carrying = result.states[index].fields["carrying"]
    cells = lattice_cells(network, place / _MM, carrying, zones)
    values = [cells.corner, cells.warp, cells.weft, thickness(fabric, cells.area_ratio, hold)]
    key, rows = in_order(comm, cells.key, 2 * total, np.column_stack([*values, cells.zone]))
    shells = Shells(
        node=number,
        position_mm=nodes[:, :2],
        shear_deg=nodes[:, 2],
        fibre_volume_fraction=None if fabric.fibre_volume_fraction is None else nodes[:, 3],
        element=(comm.exscan(len(key)) or 0) + np.arange(len(key)),
        corner=rows[:, :4].astype(np.int64),
        warp=rows[:, 4:6],
        weft=rows[:, 6:8],
        thickness_mm=_MM * rows[:, 8],
        zone=rows[:, 9].astype(np.int8) if has_zones else None,
    )
    write_pieces(comm, path, _by_rank(comm.rank, input_file(result, index, hold, shells)))


def _by_rank(rank: int, pieces: Iterator[tuple[str, bytes]]) -> Iterator[bytes]:
    """Keyword lines, which rank 0 writes, before data lines, which all do."""
    for keyword, data in pieces:
        yield (keyword.encode() if rank == 0 else b"") + data
