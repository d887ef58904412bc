# SPDX-License-Identifier: MIT
"""The deformed cloth for other programs: a table of crossovers and an input file for Abaqus.

docs/exports.md tells what the numbers mean. Every rank writes its part; none gathers.
"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from ..errors import InputError
from ..net.lattice import ARM_STEP
from .abaqus import input_file
from .cells import thickening
from .folder import prepare_directory
from .tables import in_order, lines, write_pieces

if TYPE_CHECKING:
    from ..experiments.result import State, TestResult

# What stays as it is while the cloth deforms.
HELD = ("fibre volume fraction", "thickness")


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
    network, comm = result.network, result.network.comm
    directory = prepare_directory(comm, folder)
    table, deck = paths = [directory / "crossovers.csv", directory / "preform.inp"]
    own = _crossover_columns(result, result.states[index], hold)
    number, rows = in_order(
        comm,
        network.crossover_number_global,
        network.num_crossovers_global,
        np.column_stack(list(own.values())),
    )
    head = ",".join(["crossover", *own]) + "\n" if comm.rank == 0 else ""
    template = ",".join(["%d", *["%.10g"] * (len(own) - 1), "%d"])
    # An empty field where the fabric's data do not give a value.
    text = lines(template, number, rows).replace(b"nan", b"")
    write_pieces(comm, table, [head.encode(), text])
    pieces = input_file(result, index, hold, number, dict(zip(own, rows.T, strict=True)))
    # Rank 0 writes the keyword lines before its own data lines.
    write_pieces(
        comm, deck, ((b"" if comm.rank else keyword.encode()) + data for keyword, data in pieces)
    )
    return paths


def _crossover_columns(result: TestResult, state: State, hold: str) -> dict[str, np.ndarray]:
    """What is told of this rank's crossovers (n_owned,), NaN where it is not known. Collective."""
    network, fabric, fields = result.network, result.network.fabric, state.fields
    rotation = _yarn_rotations(result, state)
    cosine, sine = np.cos(rotation), np.sin(rotation)
    warp = network.to_lab(np.column_stack([cosine[:, 0], sine[:, 0]]))
    weft = network.to_lab(np.column_stack([-sine[:, 1], cosine[:, 1]]))
    shear = rotation[:, 0] - rotation[:, 1]
    stretched = (1.0 + fields["warp_strain"]) * (1.0 + fields["weft_strain"])
    area_ratio = stretched * np.cos(shear)
    thicker = thickening(area_ratio, hold)
    rest = 1e3 * network.crossover_position
    now = rest + 1e3 * fields["displacement"]
    mass, thickness, fraction = (
        np.nan if value is None else value
        for value in (fabric.areal_density, fabric.thickness, fabric.fibre_volume_fraction)
    )
    return {
        "x_rest_mm": rest[:, 0],
        "y_rest_mm": rest[:, 1],
        "x_mm": now[:, 0],
        "y_mm": now[:, 1],
        "warp_x": warp[:, 0],
        "warp_y": warp[:, 1],
        "weft_x": weft[:, 0],
        "weft_y": weft[:, 1],
        "shear_deg": np.rad2deg(shear),
        "area_ratio": area_ratio,
        "areal_density_g_per_m2": 1e3 * mass / area_ratio,
        "thickness_mm": 1e3 * thickness * thicker,
        "fibre_volume_fraction": fraction / (area_ratio * thicker),
        "warp_tension_N_per_mm": 1e-3 * fields["warp_tension"],
        "weft_tension_N_per_mm": 1e-3 * fields["weft_tension"],
        "carrying": fields["carrying"],
    }


def _yarn_rotations(result: TestResult, state: State) -> np.ndarray:
    """Rotations of warp and weft from rest at this rank's crossovers, radians; (n_owned, 2).

    Collective when the state's fields are first asked for. Those at the hinge, as of the fields:
    their difference is the shear angle. Crossovers whose fields are none, because they carry
    nothing, turn with their arms.
    """
    network, supports, fields = result.network, result.supports, state.fields
    share = np.full(network.arm_length.shape, 0.5)
    share[network.boundary_crossovers] = supports.hinge_share
    turned = share * fields["arm_rotation"]
    rotation = np.stack([turned[:, ::2].sum(axis=1), turned[:, 1::2].sum(axis=1)], axis=1)
    loose = np.flatnonzero(~supports.carrying | (share.sum(axis=1) == 0.0))
    moved = state.node_displacement[network.arm_node[loose]]
    moved = network.to_yarn(moved - fields["displacement"][loose, None])
    rest = network.arm_length[loose][..., None] * ARM_STEP
    arm = rest + moved
    turned = rest[..., 0] * arm[..., 1] - rest[..., 1] * arm[..., 0]
    rotation[loose] = np.arctan2(turned.sum(axis=1), (rest * arm).sum(axis=(1, 2)))[:, None]
    return rotation
