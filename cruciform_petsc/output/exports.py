# SPDX-License-Identifier: MIT
"""The deformed cloth for other programs: a table of crossovers and an input file for Abaqus.

docs/exports.md tells what the numbers mean. Every rank writes its part; none gathers.
"""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from ..errors import InputError
from ..forming.measures import across, yarn_directions
from ..net.lattice import ARM_STEP
from .abaqus import input_file
from .calculix import bricks
from .cells import area_ratio, thickening
from .folder import prepare_directory
from .mesh import Mesh, mesh_of
from .openradioss import starter_file
from .tables import write_crossovers, write_pieces, write_rows

if TYPE_CHECKING:
    from mpi4py import MPI

    from ..equilibrium.state import State as Placed
    from ..experiments.result import State, TestResult
    from ..forming.kind import Forming

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
    _check_hold(hold)
    if not -len(result.states) <= index < len(result.states):
        raise InputError(f"there are {len(result.states)} states, index {index} is not one of them")
    network, comm = result.network, result.network.comm
    directory = prepare_directory(comm, folder)
    table, deck = paths = [directory / "crossovers.csv", directory / "preform.inp"]
    own = crossover_columns(result, result.states[index], hold)
    write_crossovers(network, table, own)
    column, experiment, state = result.experiment.column, result.experiment, result.states[index]
    mesh = mesh_of(
        network,
        experiment.kind,
        f"{column.column} = {state.control / column.scale:.9g}",
        hold,
        network.crossover_position + state.fields["displacement"],
        np.tile([0.0, 0.0, 1.0], (network.num_crossovers_owned, 1)),
        state.fields["carrying"],
        own["shear_deg"],
        own["area_ratio"],
        result.zones if experiment.has_zones else None,
    )
    write_deck(comm, deck, input_file(mesh, experiment.has_zones))
    return paths


def _check_hold(hold: str) -> None:
    if hold not in HELD:
        raise InputError(f'hold must be "{HELD[0]}" or "{HELD[1]}", got {hold!r}')


def write_deck(comm: MPI.Intracomm, path: Path, pieces: Iterable[tuple[str, bytes]]) -> None:
    """Write lines that are the same on every rank, and those of each, piece by piece. Collective.

    Rank 0 writes the common lines before its own.
    """
    write_pieces(
        comm, path, ((b"" if comm.rank else keyword.encode()) + data for keyword, data in pieces)
    )


def export_formed(
    folder: str | Path, forming: Forming, state: Placed, hold: str = HELD[0]
) -> list[Path]:
    """Write a formed cloth for other programs. Collective.

    ``cells.csv`` (yarn directions, shear, thickness, fibre volume fraction of each cell),
    ``preform.inp`` (Abaqus, layered shells), ``preform_ccx.inp`` (CalculiX, two layers of bricks),
    ``preform_0000.rad`` (OpenRadioss, shells and /DRAPE). ``hold``: see export.

    Returns
    -------
    list of Path
        The files.

    Raises
    ------
    InputError
        On every rank: another word for ``hold``, the place cannot be written to.
    """
    _check_hold(hold)
    network, blank, comm = forming.network, forming.blank, forming.network.comm
    directory, fields = Path(folder), blank.ply.fields(blank.of_cloth(state))
    warp, weft = yarn_directions(blank, state)
    mesh = mesh_of(
        network,
        forming.kind,
        f"stages done = {state.time:.9g}",
        hold,
        blank.ply.nodes.rest[blank.ply.nodes.of_hinge] + fields["displacement"],
        np.nan_to_num(across(warp, weft)),
        fields["carrying"],
        np.rad2deg(fields["shear_angle"]),
        area_ratio(fields),
    )
    ply = forming.suffix
    paths = [
        directory / name
        for name in (
            f"cells{ply}.csv", f"preform{ply}.inp", f"preform{ply}_ccx.inp",
            f"preform{ply}_0000.rad",
        )
    ]  # fmt: skip
    write_rows(comm, paths[0], "cell", mesh.element, _cell_columns(mesh))
    for path, pieces in zip(
        paths[1:], (input_file(mesh), bricks(mesh), starter_file(mesh)), strict=True
    ):
        write_deck(comm, path, pieces)
    return paths


def _cell_columns(mesh: Mesh) -> dict[str, np.ndarray]:
    """What is told of the elements, (m,), NaN where it is not known."""
    cosine = (mesh.warp * mesh.weft).sum(axis=1)
    thickness = np.nan if mesh.fabric.thickness is None else mesh.fabric.thickness
    vectors = {"warp": mesh.warp, "weft": mesh.weft, "normal": mesh.across}
    return {
        **{f"{letter}_mm": mesh.centre[:, axis] for axis, letter in enumerate("xyz")},
        **{
            f"{name}_{letter}": vector[:, axis]
            for name, vector in vectors.items()
            for axis, letter in enumerate("xyz")
        },
        "shear_deg": np.rad2deg(np.arcsin(np.clip(cosine, -1.0, 1.0))),
        "area_ratio": mesh.area_ratio,
        "thickness_mm": 1e3 * thickness * thickening(mesh.area_ratio, mesh.hold),
        "fibre_volume_fraction": mesh.fraction(mesh.area_ratio),
    }


def crossover_columns(
    result: TestResult, state: State, hold: str = HELD[0]
) -> dict[str, np.ndarray]:
    """What is told of this rank's crossovers (n_owned,), NaN where it is not known. Collective."""
    network, fabric, fields = result.network, result.network.fabric, state.fields
    rotation = _yarn_rotations(result, state)
    cosine, sine = np.cos(rotation), np.sin(rotation)
    warp = network.to_lab(np.column_stack([cosine[:, 0], sine[:, 0]]))
    weft = network.to_lab(np.column_stack([-sine[:, 1], cosine[:, 1]]))
    shear = rotation[:, 0] - rotation[:, 1]
    ratio = area_ratio(fields | {"shear_angle": shear})
    thicker = thickening(ratio, hold)
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
        "area_ratio": ratio,
        "areal_density_g_per_m2": 1e3 * mass / ratio,
        "thickness_mm": 1e3 * thickness * thicker,
        "fibre_volume_fraction": fraction / (ratio * thicker),
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
