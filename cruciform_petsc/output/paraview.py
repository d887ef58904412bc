# SPDX-License-Identifier: MIT
"""The deformed yarns as a VTKHDF file, for ParaView 5.12 and later.

Every rank writes its own crossovers as one partition of an unstructured grid; no rank gathers.
A series of states is one file with a time axis, of which ParaView makes an animation. Values
are in SI units except for angles, which are in degrees, as their names say. Errors are those of
tables.py.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping
from functools import partial
from itertools import chain
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ..experiments.result import State
from ..net.network import Network
from .provenance import file_notes
from .sample import node_means
from .tables import written_by_all

if TYPE_CHECKING:
    from mpi4py import MPI

    from ..experiments.result import TestResult

VTK_LINE = 3
ENERGIES = ("tension_energy", "shear_energy", "bending_energy")
IN_SPACE = "out_of_plane_bending_energy"
# What the deformation changes.
CHANGING = {"Points", "PointData/displacement", "PointData/shear_angle_deg"}
CHANGING |= {
    f"CellData/{name}" for name in ("strain", "tension", "shear_angle_deg", *ENERGIES, IN_SPACE)
}
Notes = Mapping[str, Any]
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
    ``bending_energy``, in space ``out_of_plane_bending_energy`` (J; the crossover's, shared out by
    arm length, so that sums over cells are the network's), ``crossover``, ``carrying`` (0: hangs on
    by one arm) and ``rank``.

    Parameters
    ----------
    path : str or Path
    result : TestResult
    notes : dict, optional
        Where the file comes from; kept as attributes of the file's group ``VTKHDF``.
    index : int
        Which of the result's states.
    """
    network = result.network
    only = arrays(network, result.states[index])
    write_by_rank(network.comm, path, iter([only]), notes or {})


def write_series(path: str | Path, result: TestResult, notes: Notes | None = None) -> None:
    """Write all states, after the one at rest, to one ``.vtkhdf`` file with time. Collective.

    Time is the control of the test in the curve's unit, or the number of the state where controls
    do not ascend: the attribute ``time_is`` tells which; ``controls`` always holds them. Cells and
    what does not change with time are in the file once; data as in `write_state`.
    """
    network, column, first = result.network, result.experiment.column, result.states[0]
    fields = {
        name: value if value.dtype == bool else np.zeros_like(value)
        for name, value in first.fields.items()
    }
    states = [State(0.0, 0.0, fields, np.zeros_like(first.node_displacement)), *result.states]
    controls = np.array([state.control / column.scale for state in states])
    ascending = (np.diff(controls) > 0).all()
    time_is = column.column if ascending else "state"
    notes = {**(notes or {}), "time_is": time_is, "controls": controls}
    times = controls if ascending else np.arange(len(states), dtype=float)
    steps = (arrays(network, state) for state in states)
    write_by_rank(network.comm, path, steps, notes, times)


def arrays(network: Network, state: State) -> dict[str, np.ndarray]:
    """Arrays of this rank's partition by their names in the file. Collective.

    A rank without crossovers has no partition: its arrays are empty.
    """
    fields, n = state.fields, network.num_crossovers_owned
    node = np.flatnonzero(~network.node_is_hinge)
    point_of_node = np.full(network.num_nodes_local, -1)
    point_of_node[node] = n + np.arange(len(node))
    crossover, arm = np.nonzero(network.arm_length > 0)
    family = arm % 2
    ends = np.column_stack([crossover, point_of_node[network.arm_node[crossover, arm]]])

    rest = np.concatenate([network.crossover_position, network.node_position[node]])
    moved = np.concatenate([fields["displacement"], state.node_displacement[node]])
    rest = np.pad(rest, ((0, 0), (0, 1)))
    moved = np.pad(moved, ((0, 0), (0, 3 - moved.shape[1])))
    shear = np.rad2deg(fields["shear_angle"])
    shear_at_ends = node_means(network, shear)[node]
    tension = np.column_stack([fields["warp_tension"], fields["weft_tension"]])
    share = (network.arm_length / network.arm_length.sum(axis=1, keepdims=True))[crossover, arm]
    number, none = network.crossover_number_global, np.full(len(node), -1)
    parts = min(n, 1)
    return {
        "NumberOfPoints": np.full(parts, len(rest)),
        "NumberOfCells": np.full(parts, len(ends)),
        "NumberOfConnectivityIds": np.full(parts, ends.size),
        "Points": rest + moved,
        "Connectivity": ends.ravel(),
        "Offsets": 2 * np.arange(len(ends) + parts),
        "Types": np.full(len(ends), VTK_LINE, np.uint8),
        "PointData/displacement": moved,
        "PointData/shear_angle_deg": np.concatenate([shear, shear_at_ends]).astype("f4"),
        "PointData/crossover": np.concatenate([number, none]),
        "PointData/node": np.concatenate([np.full(n, -1), network.node_number_global[node]]),
        "CellData/yarn_family": family.astype(np.uint8),
        "CellData/strain": fields["arm_strain"][crossover, arm].astype("f4"),
        "CellData/tension": tension[crossover, family].astype("f4"),
        "CellData/shear_angle_deg": shear[crossover].astype("f4"),
        **{
            f"CellData/{name}": (share * fields[name][crossover]).astype("f4")
            for name in (*ENERGIES, IN_SPACE)
            if name in fields
        },
        "CellData/crossover": number[crossover],
        "CellData/carrying": fields["carrying"][crossover].astype(np.uint8),
        "CellData/rank": np.full(len(arm), network.comm.rank, np.int32),
    }


def write_by_rank(
    comm: MPI.Intracomm,
    path: str | Path,
    steps: Iterator[Arrays],
    notes: Notes,
    times: np.ndarray | None = None,
    changing: Collection[str] = CHANGING,
) -> None:
    """Write a file in which every dataset is the ranks' arrays one after the other. Collective.

    ``steps`` are made as they are needed, one for each of the ``times``: the same names, types and
    trailing shapes on every rank; only those in ``changing`` differ between times. Ranks write at
    the same time where h5py can, else in turn.
    """
    import h5py

    first = next(steps)
    lengths = np.array(comm.allgather([len(array) for array in first.values()]))
    begin = dict(zip(first, lengths[: comm.rank].sum(axis=0), strict=True))
    total = dict(zip(first, lengths.sum(axis=0), strict=True))
    stride = {name: rows * (name in changing) for name, rows in total.items()}
    step = np.arange(1 if times is None else len(times))
    together = comm.size > 1 and h5py.get_config().mpi
    options = {"driver": "mpio", "comm": comm} if together else {}

    def create(temporary: Path) -> None:
        with h5py.File(temporary, "w", **options) as file:
            root = file.create_group("VTKHDF")
            root.attrs["Version"] = np.array([2, 0])
            for name, note in {"Type": "UnstructuredGrid", **notes}.items():
                root.attrs[name] = np.bytes_(note.encode()) if isinstance(note, str) else note
            for name, array in first.items():
                rows = total[name] + step[-1] * stride[name]
                root.create_dataset(name, (rows, *array.shape[1:]), array.dtype)
            if times is None:
                return
            none = np.zeros_like(step)
            axis = {
                "Values": times,
                "NumberOfParts": none + total["NumberOfPoints"],
                "PartOffsets": none,
                "PointOffsets": step * stride["Points"],
                "CellOffsets": none[:, None],
                "ConnectivityIdOffsets": none[:, None],
            }
            data = {name: step * rows for name, rows in stride.items() if "/" in name}
            axis |= {name.replace("/", "Offsets/"): offset for name, offset in data.items()}
            for name, array in axis.items():
                root.create_dataset(f"Steps/{name}", data=array)
            root["Steps"].attrs["NSteps"] = len(times)

    def fill(k: int, arrays: Arrays, temporary: Path) -> None:
        with h5py.File(temporary, "r+", **options) as file:
            for name, array in arrays.items():
                if len(array) and (k == 0 or name in changing):
                    at = begin[name] + k * stride[name]
                    file[f"VTKHDF/{name}"][at : at + len(array)] = array

    with written_by_all(comm, path) as in_file:
        in_file(create if together or comm.rank == 0 else None)
        for k, arrays in enumerate(chain([first], steps)):
            for turn in range(1 if together else comm.size):
                mine = together or turn == comm.rank
                in_file(partial(fill, k, arrays) if mine else None)
