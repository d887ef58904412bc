# SPDX-License-Identifier: MIT
"""The deformed yarns as a VTKHDF file, for ParaView 5.12 and later.

Every rank writes its own crossovers as one partition of an unstructured grid; no rank gathers.
A series of states is one file with a time axis, of which ParaView makes an animation. Units
stand in the names (docs/files.md). Errors are those of
tables.py.
"""

from __future__ import annotations

import io
import os
from collections.abc import Collection, Iterator, Mapping
from functools import partial
from itertools import chain
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ..experiments.result import State
from ..net.network import Network
from ..parallel import on_root
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
CHANGING = {"Points", "PointData/displacement_m", "PointData/shear_angle_deg"}
CHANGING |= {f"CellData/{name}_J" for name in (*ENERGIES, IN_SPACE)}
CHANGING |= {f"CellData/{name}" for name in ("strain", "tension_N_per_m", "shear_angle_deg")}
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
    several = max(len(result.states), len(result.increments)) > 1
    write_any = write_series if several else write_state
    write_any(path, result, file_notes(result))


def write_state(
    path: str | Path, result: TestResult, notes: Notes | None = None, index: int = -1
) -> None:
    """Write the deformed yarns with their fields to one ``.vtkhdf`` file. Collective.

    A cell is an arm, from its crossover to its end. The points of a partition are the crossovers of
    a rank, then the arm ends it knows; an end between crossovers of two ranks is in both.

    Point data: ``displacement_m``, ``shear_angle_deg`` (at arm ends the mean of their
    crossovers), ``crossover`` and ``node`` (global numbers, -1 where it is not one).

    Cell data: ``yarn_family`` (0 warp, 1 weft), ``strain`` of the arm, ``tension_N_per_m`` of
    its yarn family at the crossover, ``shear_angle_deg``, ``tension_energy_J``,
    ``shear_energy_J``, ``bending_energy_J``, in space ``out_of_plane_bending_energy_J`` (the
    crossover's, shared out by arm length, so that sums over cells are the network's),
    ``crossover``, ``carrying`` (0: hangs on by one arm) and ``rank``.

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
    """Write the states after all increments to one ``.vtkhdf`` file with time. Collective.

    The state at rest is the first. Time is the control of the test in the curve's unit, or the
    number of the state where controls do not ascend: the attribute ``time_is`` tells which;
    ``controls`` always holds them, and ``asked`` is 1 where a value was asked for. Cells and what
    does not change with time are in the file once; data as in `write_state`.
    """
    network, column, first = result.network, result.experiment.column, result.states[0]
    fields = {
        name: value if value.dtype == bool else np.zeros_like(value)
        for name, value in first.fields.items()
    }
    rest = State(0.0, 0.0, fields, np.zeros_like(first.node_displacement))
    told = [(step.control, step.asked) for step in result.increments]
    told = told or [(state.control, True) for state in result.states]
    controls, asked = np.array([(0.0, False), *told]).T
    controls = controls / column.scale
    ascending = (np.diff(controls) > 0).all()
    time_is = column.column if ascending else "state"
    notes = {**(notes or {}), "time_is": time_is, "controls": controls, "asked": asked.astype(int)}
    times = controls if ascending else np.arange(len(controls), dtype=float)
    steps = (arrays(network, state) for state in chain([rest], result.every_state()))
    write_by_rank(network.comm, path, steps, notes, times)


MODE_SIZE = 0.1  # of the cloth's shorter side: the largest displacement of a mode that is drawn


def write_modes(path: str | Path, result: TestResult, notes: Notes | None = None) -> None:
    """Write the modes of a test's stability to one ``.vtkhdf`` file. Collective.

    As `write_series`, with the number of the mode, from 1 up, as time. Displacements are from rest,
    the largest is MODE_SIZE of the cloth's shorter side.
    """
    network, modes = result.network, result.buckling.modes if result.buckling else []
    size = MODE_SIZE * float(network.preform.size.min())
    shown = (mode.scaled(size) for mode in modes)
    times = np.arange(1.0, 1.0 + len(modes))
    notes = {**(notes or {}), "time_is": "mode"}
    write_by_rank(network.comm, path, (arrays(network, s) for s in shown), notes, times)


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
        "PointData/displacement_m": moved,
        "PointData/shear_angle_deg": np.concatenate([shear, shear_at_ends]).astype("f4"),
        "PointData/crossover": np.concatenate([number, none]),
        "PointData/node": np.concatenate([np.full(n, -1), network.node_number_global[node]]),
        "CellData/yarn_family": family.astype(np.uint8),
        "CellData/strain": fields["arm_strain"][crossover, arm].astype("f4"),
        "CellData/tension_N_per_m": tension[crossover, family].astype("f4"),
        "CellData/shear_angle_deg": shear[crossover].astype("f4"),
        **{
            f"CellData/{name}_J": (share * fields[name][crossover]).astype("f4")
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
    trailing shapes on every rank; only those in ``changing`` differ between times. HDF5 lays the
    file out in rank 0's memory; data go to their places in it by plain writes of all ranks: HDF5
    crashes as it ends where the disk is full.
    """
    first = next(steps)
    lengths = np.array(comm.allgather([len(array) for array in first.values()]))
    begin = dict(zip(first, lengths[: comm.rank].sum(axis=0), strict=True))
    total = dict(zip(first, lengths.sum(axis=0), strict=True))
    stride = {name: rows * (name in changing) for name, rows in total.items()}
    step = np.arange(1 if times is None else len(times))
    small = {}
    if times is not None:
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
        small = {f"Steps/{name}": array for name, array in axis.items()}
    large = {
        name: ((total[name] + step[-1] * stride[name], *array.shape[1:]), array.dtype)
        for name, array in first.items()
    }
    pieces, size, place = on_root(comm, lambda: _lay_out(large, small, notes))

    def fill(k: int, arrays: Arrays, temporary: Path) -> None:
        with temporary.open("r+b", buffering=0) as file:
            if k == comm.rank == 0:
                for at, piece in pieces:
                    _write_at(file, at, piece)
                file.truncate(size)
            for name, array in arrays.items():
                if len(array) and (k == 0 or name in changing):
                    row = array.nbytes // len(array)
                    at = place[name] + row * int(begin[name] + k * stride[name])
                    _write_at(file, at, array)

    with written_by_all(comm, path) as in_file:
        for k, arrays in enumerate(chain([first], steps)):
            in_file(partial(fill, k, arrays))


def _write_at(file: io.FileIO, at: int, data: bytes | np.ndarray) -> None:
    """Write all of it."""
    file.seek(at)
    left = memoryview(data.tobytes() if isinstance(data, np.ndarray) else data)
    while left:
        left = left[file.write(left) :]


class _Layout(io.RawIOBase):
    """A file in memory, of which only what has been written is there."""

    def __init__(self) -> None:
        self.pieces: list[tuple[int, bytes]] = []
        self.size = self.at = 0

    def seek(self, offset: int, whence: int = os.SEEK_SET) -> int:
        self.at = offset + (0, self.at, self.size)[whence]
        return self.at

    def write(self, data: Any) -> int:
        self.pieces.append((self.at, bytes(data)))
        self.at += len(data)
        self.size = max(self.size, self.at)
        return len(data)

    def truncate(self, size: int | None = None) -> int:
        self.size = self.at if size is None else size
        return self.size

    def readinto(self, buffer: Any) -> int:
        view, end = memoryview(buffer).cast("B"), self.at + len(buffer)
        view[:] = bytes(len(view))
        for begin, piece in self.pieces:  # later ones lie over earlier ones
            first, last = max(begin, self.at), min(begin + len(piece), end)
            if first < last:
                view[first - self.at : last - self.at] = piece[first - begin : last - begin]
        self.at = end
        return len(view)


def _lay_out(
    large: Mapping[str, tuple[tuple[int, ...], np.dtype]], small: Arrays, notes: Notes
) -> tuple[list[tuple[int, bytes]], int, dict[str, int]]:
    """Lay a file out without data of the large arrays.

    Returns what is to be written where, its size, and where the large arrays begin.
    """
    import h5py

    layout, place = _Layout(), {}
    with h5py.File(layout, "w") as file:
        root = file.create_group("VTKHDF")
        root.attrs["Version"] = np.array([2, 0])
        for name, note in {"Type": "UnstructuredGrid", **notes}.items():
            root.attrs[name] = np.bytes_(note.encode()) if isinstance(note, str) else note
        at_once = h5py.h5p.create(h5py.h5p.DATASET_CREATE)
        at_once.set_alloc_time(h5py.h5d.ALLOC_TIME_EARLY)
        at_once.set_fill_time(h5py.h5d.FILL_TIME_NEVER)
        for name, (shape, dtype) in large.items():
            array = root.create_dataset(name, shape, dtype, dcpl=at_once)
            place[name] = array.id.get_offset()
        for name, values in small.items():
            root.create_dataset(name, data=values)
        if small:
            root["Steps"].attrs["NSteps"] = len(small["Steps/Values"])
    return layout.pieces, layout.size, place
