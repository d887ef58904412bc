# SPDX-License-Identifier: MIT
"""What the benchmarks share: preforms of a given number of crossovers, systems, timing, tables."""

from __future__ import annotations

import ctypes
import json
import os
import platform
import re
import resource
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass, replace
from math import pi, radians, sqrt
from pathlib import Path

import numba
import numpy as np
import shapely
from mpi4py import MPI
from petsc4py import PETSc

from cruciform_petsc import Fabric, Network, Preform
from cruciform_petsc.net.edges import Constraints
from cruciform_petsc.process import keep_freed
from cruciform_petsc.small.network import LinearNetwork
from cruciform_petsc.solvers.options import blas_in_use

keep_freed()  # as the program does
COMM = MPI.COMM_WORLD
TABLE_1 = Fabric.from_library("e-glass-plain-2.4")
EXTENSION = 0.01  # of the preform's length
BIAS = radians(45)
IDLE = 0.5  # load of a machine that has nothing else to do


# -- output ------------------------------------------------------------------------------------


class Table:
    """Rows of Markdown, printed as they come, kept for pictures and files."""

    def __init__(self, title: str, *columns: str):
        self.title, self.columns, self.rows = title, columns, []
        if COMM.rank == 0:
            print(f"\n{title}\n")
        self._say(columns)
        self._say(["---"] * len(columns))

    def _say(self, cells) -> None:
        if COMM.rank == 0:
            print("| " + " | ".join(str(cell) for cell in cells) + " |", flush=True)

    def row(self, *cells) -> None:
        """Add a row."""
        self.rows.append(cells)
        self._say(cells)


def save(path: Path, **results) -> None:
    """Write results as JSON, on rank 0."""
    if COMM.rank == 0:
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(json.dumps({"machine": machine(), **results}, indent=1, default=float))


def machine() -> dict[str, str]:
    """Processor, cores, versions, and how busy the machine is."""
    name = platform.processor() or platform.machine()
    try:
        found = re.search(r"model name\s*:\s*(.*)", Path("/proc/cpuinfo").read_text())
        name = found[1] if found else name
    except OSError:
        pass
    return {
        "processor": name,
        "cores": str(os.cpu_count()),
        "ranks": str(COMM.size),
        "python": platform.python_version(),
        "numpy": np.__version__,
        "petsc": ".".join(map(str, PETSc.Sys.getVersion())),
        "numba": numba.__version__,
        "blas": blas_in_use(),
        "mpi": MPI.Get_library_version().split(",")[0].strip("\0 \n"),
        "load": " ".join(f"{load:.1f}" for load in os.getloadavg()),
    }


def say_machine() -> None:
    """Print the machine in one line, and a remark if others use it. Call it first."""
    if COMM.rank == 0:
        print(", ".join(f"{key} {value}" for key, value in machine().items()), flush=True)
        load = os.getloadavg()[0]
        if load > IDLE:
            print(
                f"REMARK: the machine is busy, {load:.1f} processes wanted to run in the last "
                "minute before this one: wall-clock times are not to be trusted, processor times "
                "are too long"
            )


# -- measuring ---------------------------------------------------------------------------------


@dataclass
class Seconds:
    """Wall-clock and processor time of a block, the largest of all ranks."""

    wall: float = 0.0
    cpu: float = 0.0


@contextmanager
def clock() -> Iterator[Seconds]:
    """Time a block, ranks starting together. Collective.

    On a machine that others use too, wall-clock times of one thing and the next do not compare;
    processor times do, but for what the others do to caches and memory. Ranks that wait for each
    other burn processor time.
    """
    taken = Seconds()
    COMM.barrier()
    wall, cpu = time.perf_counter(), time.process_time()
    yield taken
    taken.cpu = COMM.allreduce(time.process_time() - cpu, MPI.MAX)
    taken.wall = COMM.allreduce(time.perf_counter() - wall, MPI.MAX)


def best(call: Callable[[], object], repeat: int = 5, inner: int = 1) -> Seconds:
    """Shortest of some times that a call takes. Collective."""
    call()
    times = []
    for _ in range(repeat):
        with clock() as seconds:
            for _ in range(inner):
                call()
        times.append(Seconds(seconds.wall / inner, seconds.cpu / inner))
    return Seconds(min(one.wall for one in times), min(one.cpu for one in times))


def matvec_seconds(matrix: PETSc.Mat) -> Seconds:
    """Time of one product with a matrix. Collective."""
    x, y = matrix.createVecs()
    x.set(1.0)
    size = max(COMM.allgather(matrix.getLocalSize()[0]))
    taken = best(lambda: matrix.mult(x, y), 5, max(1, 2_000_000 // max(size, 1)))
    x.destroy()
    y.destroy()
    return taken


def resident_mib() -> float:
    """Memory in use by this process now, MiB, freed memory given back first where that works."""
    with suppress(OSError, AttributeError):
        ctypes.CDLL(None).malloc_trim(0)
    try:
        pages = int(Path("/proc/self/statm").read_text().split()[1])
        return pages * os.sysconf("SC_PAGE_SIZE") / 2**20
    except OSError:
        return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024


def peak_mib() -> float:
    """Largest memory of this process since reset_peak (or its start), MiB."""
    try:
        found = re.search(r"VmHWM:\s*(\d+)", Path("/proc/self/status").read_text())
        return int(found[1]) / 1024 if found else 0.0
    except OSError:
        return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024


def reset_peak() -> None:
    """Forget the largest memory so far, where Linux allows it."""
    with suppress(OSError):
        Path("/proc/self/clear_refs").write_text("5")


# -- systems -----------------------------------------------------------------------------------


def outline(crossovers: float, shape: str) -> shapely.Polygon:
    """A rectangle, an L or a plate with a round hole of about some crossovers of Table 1."""
    area = crossovers * TABLE_1.warp.spacing * TABLE_1.weft.spacing
    if shape == "rectangle":
        width = sqrt(area / 1.05)
        return shapely.box(0, 0, width, 1.05 * width)
    if shape == "L":
        side = sqrt(area / 0.75)
        return shapely.box(0, 0, side, side).difference(
            shapely.box(0.5 * side, 0.5 * side, side, side)
        )
    side = sqrt(area / (1 - 0.04 * pi))
    hole = shapely.Point(0.5 * side, 0.5 * side).buffer(0.2 * side)
    return shapely.box(0, 0, side, side).difference(hole)


def cloth(stiffness: float | None = None, ratio: float = 1.0) -> Fabric:
    """Table 1, with another E/G and another ratio of the warp's modulus to the weft's."""
    warp, weft = TABLE_1.warp, TABLE_1.weft
    modulus = warp.modulus if stiffness is None else stiffness * TABLE_1.shear_modulus
    # Reciprocity: the soft side's Poisson ratio falls with its modulus.
    return replace(
        TABLE_1,
        warp=replace(warp, modulus=modulus * sqrt(ratio), poisson=warp.poisson),
        weft=replace(weft, modulus=modulus / sqrt(ratio), poisson=warp.poisson / ratio),
    )


@dataclass
class System:
    """A bias-extension test as a linear system."""

    linear: LinearNetwork
    matrix: PETSc.Mat
    rhs: PETSc.Vec

    @property
    def near_null(self) -> np.ndarray:
        """Motions that cost no energy, for algebraic multigrid."""
        owned = self.linear.network.num_nodes_owned
        motions = self.linear.soft_motions()[:owned]
        return motions.reshape(-1, motions.shape[2])

    def destroy(self) -> None:
        """Free the PETSc objects."""
        self.matrix.destroy()
        self.rhs.destroy()


def system(
    crossovers: float,
    shape: str = "rectangle",
    angle: float = 45.0,
    bending: bool = True,
    fabric: Fabric = TABLE_1,
    comm: MPI.Intracomm = COMM,
) -> System:
    """Lower edge clamped, upper edge clamped and pulled. Collective."""
    cut = outline(crossovers, shape)
    network = Network(comm, Preform(cut, radians(angle)), fabric)
    constraints = Constraints(network, bending)
    constraints.clamp("lower")
    constraints.clamp("upper", (0.0, EXTENSION * cut.bounds[3]))
    linear = LinearNetwork(constraints)
    matrix = linear.matrix()
    load = -linear.element_forces(np.where(constraints.fixed, constraints.value, 0.0))
    load[~linear.free] = 0.0
    return System(linear, matrix, linear.vector(load))
