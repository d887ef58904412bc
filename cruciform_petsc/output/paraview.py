# SPDX-License-Identifier: MIT
"""The deformed yarns as a VTKHDF file, for ParaView 5.12 and later.

Every rank writes its own crossovers as one partition of an unstructured grid; no rank gathers.
A series of states is one file with a time axis, of which ParaView makes an animation. Values
are in SI units except for angles, which are in degrees, as their names say. Errors are those of
tables.py.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Set
from functools import partial
from itertools import chain
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from ..net.network import Network
from .provenance import file_notes
from .sample import node_means
from .tables import written_by_all

if TYPE_CHECKING:
    import h5py
    from mpi4py import MPI

    from ..experiments.result import TestResult

VTK_LINE = 3
ENERGIES = ("tension_energy", "shear_energy", "bending_energy")
# Data that no deformation changes.
CONSTANT = {"PointData/crossover", "PointData/node"}
CONSTANT |= {f"CellData/{name}" for name in ("yarn_family", "crossover", "carrying", "rank")}
Notes = Mapping[str, str | float]
Arrays = Mapping[str, np.ndarray]


def write(result: TestResult, path: str | Path) -> None:
    """Write a file that ParaView opens: deformed yarns with their fields. Collective.

    Several states become a series over time, see `write_series`. The file's attributes say where
    it comes from (provenance.file_notes).

    Raises
    ------
    InputError
        On every rank: the place cannot be written to. Nothing is left there then.
    """
    write_any = write_series if len(result.states) > 1 else write_state
    write_any(path, result, file_notes(result))


def write_state(
    path: str | Path, result: TestResult, notes: Notes | None = None, index: int = -1
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
    result : TestResult
    notes : dict, optional
        Where the file comes from; kept as attributes of the file's group ``VTKHDF``.
    index : int
        Which of the result's states.
    """
    state, network = result.states[index], result.network
    arrays = grid_arrays(network, state.node_displacement, state.fields)
    write_by_rank(network.comm, path, arrays, _attributes(notes))


def write_series(path: str | Path, result: TestResult, notes: Notes | None = None) -> None:
    """Write all states, after the one at rest, to one ``.vtkhdf`` file with time. Collective.

    Time is the control of the test in the curve's unit, or the number of the state where controls
    do not ascend: the attribute ``time_is`` tells which; ``controls`` always holds them. Cells and
    what does not change with time are in the file once; data as in `write_state`.
    """
    network, column, states = result.network, result.experiment.column, result.states
    at_rest = {
        name: value if value.dtype == bool else np.zeros_like(value)
        for name, value in states[0].fields.items()
    }
    arrays = grid_arrays(network, np.zeros_like(states[0].node_displacement), at_rest)
    steps = (grid_arrays(network, s.node_displacement, s.fields) for s in states)
    changing = {name for name in arrays if name.startswith(("Points", "PointData/", "CellData/"))}
    changing -= CONSTANT
    total = {name: network.comm.allreduce(len(arrays[name])) for name in sorted(changing)}
    step = np.arange(1 + len(states))
    none = np.zeros_like(step)
    controls = np.array([0.0, *(state.control / column.scale for state in states)])
    ascending = bool((np.diff(controls) > 0).all())
    axis = {
        "Values": controls if ascending else step.astype(float),
        "NumberOfParts": none + network.comm.allreduce(len(arrays["NumberOfPoints"])),
        "PartOffsets": none,
        "PointOffsets": step * total["Points"],
        "CellOffsets": none[:, None],
        "ConnectivityIdOffsets": none[:, None],
    }
    for array in arrays:
        data, slash, field = array.partition("/")
        if slash:
            axis[f"{data}Offsets/{field}"] = step * total.get(array, 0)
    time_is = np.bytes_(column.column if ascending else "state")
    attributes = _attributes(notes) | {"time_is": time_is, "controls": controls}
    write_by_rank(network.comm, path, arrays, attributes, (changing, steps, axis))


def _attributes(notes: Notes | None) -> dict:
    attributes: dict = {"Version": np.array([2, 0]), "Type": np.bytes_("UnstructuredGrid")}
    for name, note in (notes or {}).items():
        attributes[name] = np.bytes_(note.encode()) if isinstance(note, str) else note
    return attributes


def grid_arrays(
    network: Network, node_displacement: np.ndarray, fields: Arrays
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
    arrays: Arrays,
    attributes: Mapping[str, object],
    series: tuple[Set[str], Iterable[Arrays], Arrays] | None = None,
) -> None:
    """Write an HDF5 file in which every dataset is the ranks' arrays one after the other.

    Collective. Ranks write at the same time where h5py can, else in turn. The file gets its name
    when it is whole.

    Parameters
    ----------
    comm : mpi4py communicator
    path : str or Path
    arrays : dict of arrays (n, ...)
        Of the group ``VTKHDF``: the same names, types and trailing shapes on every rank; n may
        differ and be 0.
    attributes : dict
        Of the group; the same on every rank.
    series : (names, steps, axis), optional
        Arrays that change, which are written one step after the other; the arrays of the further
        steps, made as they are needed; and the group ``Steps``, the same on every rank.
    """
    import h5py

    lengths = np.array(comm.allgather([len(array) for array in arrays.values()]))
    begin = dict(zip(arrays, lengths[: comm.rank].sum(axis=0), strict=True))
    total = dict(zip(arrays, lengths.sum(axis=0), strict=True))
    changing, steps, axis = series or (set(), (), {})
    count = len(axis["Values"]) if axis else 1

    def create(root: h5py.Group) -> None:
        root.attrs.update(attributes)
        for name, array in arrays.items():
            rows = total[name] * (count if name in changing else 1)
            root.create_dataset(name, (rows, *array.shape[1:]), array.dtype)
        for name, array in axis.items():
            root.create_dataset(f"Steps/{name}", array.shape, array.dtype)
        if axis:
            root["Steps"].attrs["NSteps"] = count

    def fill(root: h5py.Group, step: int, of_step: Arrays) -> None:
        for name, array in of_step.items():
            if len(array) and (step == 0 or name in changing):
                first = step * total[name] + begin[name]
                root[name][first : first + len(array)] = array
        if step == 0 and comm.rank == 0:
            for name, array in axis.items():
                root[f"Steps/{name}"][...] = array

    together = comm.size > 1 and h5py.get_config().mpi
    options = {"driver": "mpio", "comm": comm} if together else {}

    def write_step(turn: int, step: int, of_step: Arrays, temporary: Path) -> None:
        mode = "r+" if turn or step else "w"
        with h5py.File(temporary, mode, **options) as file:
            root = file.require_group("VTKHDF")
            if mode == "w":
                create(root)
            fill(root, step, of_step)

    with written_by_all(comm, path) as in_file:
        for step, of_step in enumerate(chain([arrays], steps)):
            for turn in range(1 if together else comm.size):
                mine = together or turn == comm.rank
                in_file(partial(write_step, turn, step, of_step) if mine else None)
