# SPDX-License-Identifier: MIT
"""The deformed yarns as a VTKHDF file, for ParaView 5.12 and later.

Every rank writes its own crossovers as one partition of an unstructured grid; no rank gathers.
Values are in SI units except for angles, which are in degrees, as their names say.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from ..case import on_root
from ..network import Network
from .sample import node_means
from .tables import finish_file, start_file

if TYPE_CHECKING:
    import h5py
    from mpi4py import MPI

VTK_LINE = 3
ENERGIES = ("tension_energy", "shear_energy", "bending_energy")


def write_network(
    path: str | Path,
    network: Network,
    node_displacement: np.ndarray,
    fields: Mapping[str, np.ndarray],
    notes: Mapping[str, str | float] | None = None,
) -> None:
    """Write the deformed yarns with their fields to one ``.vtkhdf`` file. Collective.

    A cell is an arm, from its crossover to its end. The points of a partition are the crossovers of
    a rank, then the arm ends it knows; an end between crossovers of two ranks is in both.

    Point data: ``displacement`` (m), ``shear_angle_deg`` (at arm ends the mean of their
    crossovers), ``crossover`` and ``node`` (global numbers, -1 where it is not one).

    Cell data: ``yarn_family`` (0 warp, 1 weft), ``strain`` of the arm, ``tension`` of its yarn
    family at the crossover (N/m), ``shear_angle_deg``, ``tension_energy``, ``shear_energy``,
    ``bending_energy`` (J; the crossover's, shared out by arm length, so that sums over cells are
    the network's), ``crossover``, ``carrying`` (0: hangs on by one arm) and ``rank``.

    Parameters
    ----------
    path : str or Path
    network : Network
    node_displacement : float (n_local, 2)
        In x and y, metres, ghosts filled.
    fields : dict
        See LinearNetwork.crossover_fields.
    notes : dict, optional
        Where the file comes from; kept as attributes of the file's group ``VTKHDF``.

    Raises
    ------
    InputError
        On every rank: the place cannot be written to. Nothing is left there then.
    """
    arrays = grid_arrays(network, node_displacement, fields)
    attributes: dict = {"Version": np.array([2, 0]), "Type": np.bytes_("UnstructuredGrid")}
    for name, note in (notes or {}).items():
        attributes[name] = np.bytes_(note.encode()) if isinstance(note, str) else note
    write_by_rank(network.comm, path, "VTKHDF", arrays, attributes)


def grid_arrays(
    network: Network, node_displacement: np.ndarray, fields: Mapping[str, np.ndarray]
) -> dict[str, np.ndarray]:
    """Arrays of this rank's partition by their names in the file. Collective.

    A rank without crossovers has no partition: its arrays are empty.
    """
    n = network.num_crossovers_owned
    node = np.flatnonzero(~network.node_is_hinge)
    point_of_node = np.full(network.num_nodes_local, -1)
    point_of_node[node] = n + np.arange(len(node))
    crossover, arm = np.nonzero(network.arm_length > 0)
    family = arm % 2
    ends = np.column_stack([crossover, point_of_node[network.arm_node[crossover, arm]]])

    shear = np.rad2deg(fields["shear_angle"])
    tension = np.column_stack([fields["warp_tension"], fields["weft_tension"]])
    length = network.arm_length[crossover, arm]
    share = length / network.arm_length.sum(axis=1)[crossover]
    number = network.crossover_number_global
    moved = np.concatenate([fields["displacement"], node_displacement[node]])
    position = np.concatenate([network.crossover_position, network.node_position[node]])
    none = np.full(len(node), -1)
    point_data = {
        "displacement": _in_space(moved),
        "shear_angle_deg": np.concatenate([shear, node_means(network, shear)[node]]).astype("f4"),
        "crossover": np.concatenate([number, none]),
        "node": np.concatenate([np.full(n, -1), network.node_number_global[node]]),
    }
    cell_data = {
        "yarn_family": family.astype(np.uint8),
        "strain": fields["arm_strain"][crossover, arm].astype("f4"),
        "tension": tension[crossover, family].astype("f4"),
        "shear_angle_deg": shear[crossover].astype("f4"),
        **{name: (share * fields[name][crossover]).astype("f4") for name in ENERGIES},
        "crossover": number[crossover],
        "carrying": fields["carrying"][crossover].astype(np.uint8),
        "rank": np.full(len(arm), network.comm.rank, np.int32),
    }
    partition = slice(0, 1 if n else 0)
    return {
        "NumberOfPoints": np.array([len(position)])[partition],
        "NumberOfCells": np.array([len(ends)])[partition],
        "NumberOfConnectivityIds": np.array([ends.size])[partition],
        "Points": _in_space(position + moved),
        "Connectivity": ends.ravel(),
        "Offsets": 2 * np.arange(len(ends) + 1 if n else 0),
        "Types": np.full(len(ends), VTK_LINE, np.uint8),
        **{f"PointData/{name}": value for name, value in point_data.items()},
        **{f"CellData/{name}": value for name, value in cell_data.items()},
    }


def _in_space(plane: np.ndarray) -> np.ndarray:
    """Append z = 0; (n, 2) -> (n, 3)."""
    return np.pad(plane, ((0, 0), (0, 1)))


def write_by_rank(
    comm: MPI.Intracomm,
    path: str | Path,
    group: str,
    arrays: Mapping[str, np.ndarray],
    attributes: Mapping[str, object],
) -> None:
    """Write an HDF5 file in which every dataset is the ranks' arrays one after the other.

    Collective. Ranks write at the same time where h5py can, else in turn. The file gets its name
    when it is whole.

    Parameters
    ----------
    comm : mpi4py communicator
    path : str or Path
    group : str
        Name of the one group at the root.
    arrays : dict of arrays (n, ...)
        The same names, types and trailing shapes on every rank; n may differ and be 0.
    attributes : dict
        Of the group; the same on every rank.

    Raises
    ------
    InputError
        On every rank: the place cannot be written to.
    """
    import h5py

    lengths = np.array(comm.allgather([len(array) for array in arrays.values()]))
    begin = dict(zip(arrays, lengths[: comm.rank].sum(axis=0), strict=True))
    total = dict(zip(arrays, lengths.sum(axis=0), strict=True))

    def create(file: h5py.File) -> None:
        root = file.create_group(group)
        for name, value in attributes.items():
            root.attrs[name] = value
        for name, array in arrays.items():
            root.create_dataset(name, (total[name], *array.shape[1:]), array.dtype)

    def fill(file: h5py.File) -> None:
        for name, array in arrays.items():
            if len(array):
                file[f"{group}/{name}"][begin[name] : begin[name] + len(array)] = array

    together = comm.size > 1 and h5py.get_config().mpi
    options = {"driver": "mpio", "comm": comm} if together else {}
    temporary = on_root(comm, lambda: start_file(path))
    problem = None
    for turn in range(1 if together else comm.size):
        try:
            if together or turn == comm.rank:
                with h5py.File(temporary, "r+" if turn else "w", **options) as file:
                    if turn == 0:
                        create(file)
                    fill(file)
        except (OSError, RuntimeError) as error:
            problem = str(error)
        problems = [told for told in comm.allgather(problem) if told]
        if problems:
            break
    on_root(comm, lambda: finish_file(path, temporary, *problems[:1]))
