# SPDX-License-Identifier: MIT
"""Strong and weak scaling of the yarn multigrid, a cost model, and what it predicts for clusters.

    ./scripts/fenicsx mpirun -n 2 python3 -m mpi4py scripts/bench_scaling.py [--crossovers 120000]
        [--latency 2e-6] [--network 5e9] [--bandwidth 5e9]

Measures on 1, 2, 4 ... of the ranks it is given: memory bandwidth as STREAM's triad does, the
product with the matrix, one iteration, the whole solution. Fits

    t(N, P) = a N/P + b sqrt(N/P) + c messages(N, P)

to the times of an iteration (N crossovers on P ranks: work, surface, latency; b and c are for more
than one rank) and prints what it gives for 10^7 and 10^8 crossovers, with this machine's a scaled
by memory bandwidth per rank, and with the latency and the bandwidth of a cluster's network. Writes
results/bench_scaling.json and a picture.
"""

import argparse
import time
from math import ceil, log, log2, sqrt
from pathlib import Path

import benchlib
import numpy as np
from benchlib import COMM, Table
from mpi4py import MPI
from scipy.optimize import nnls

from cruciform_petsc.solvers.linear import LinearSolver
from cruciform_petsc.solvers.multigrid import COARSEST, SWEEPS
from cruciform_petsc.solvers.options import YARN_MULTIGRID

OPTIONS = YARN_MULTIGRID | {"ksp_rtol": 1e-8}
UNKNOWNS = 6.05  # per crossover, with bending
# Neighbours of a rank that holds a box; unknowns on a border, per crossover of it; bytes of one.
NEIGHBOURS, BORDER, BYTES = 4, 9, 8


def levels(crossovers: float) -> int:
    """Levels: the first coarse one has a twelfth of the unknowns, each further a quarter."""
    first = UNKNOWNS * crossovers / 12
    return 2 + max(0, ceil(log(first / COARSEST, 4)))


def messages(crossovers: float, ranks: float) -> float:
    """Messages one after the other in an iteration."""
    if ranks == 1:
        return 0.0
    families = 2 * 2 * SWEEPS  # families solved before and after the coarse grids
    # Each sends joints' loads, joints' displacements, then its own border; three residuals or
    # products beside; a coarse level has two of these, its two transfers and their sums.
    fine, coarse = 3 * families + 3, 6 * (levels(crossovers) - 1)
    reductions = 3 + 2  # of CG, and to the ranks that solve the coarsest level
    return NEIGHBOURS * (fine + coarse) + reductions * 2 * log2(ranks)


def border_bytes(crossovers: float, ranks: float) -> float:
    """What a rank sends in an iteration."""
    if ranks == 1:
        return 0.0
    exchanges = 2 * 2 * 2 * SWEEPS + 3 + 4  # the coarse levels together double one exchange
    return exchanges * 4 * sqrt(crossovers / ranks) * BORDER * BYTES


def triad(comm: MPI.Intracomm, size: int = 8_000_000) -> float:
    """Bytes per second of a = b + s c on all ranks together. Collective."""
    a, b, c = np.zeros(size), np.ones(size), np.ones(size)

    def call():
        np.multiply(c, 3.0, out=a)
        np.add(a, b, out=a)

    seconds = shortest(comm, call, 5)
    return comm.size * 5 * 8 * size / seconds  # 2 + 3 arrays moved


def shortest(comm: MPI.Intracomm, call, repeat: int) -> float:
    """Shortest processor time of a call, the slowest rank's. Collective.

    Ranks that wait for each other spin, so that waiting counts, but not what others do meanwhile.
    """
    call()
    times = []
    for _ in range(repeat):
        comm.barrier()
        begin = time.process_time()
        call()
        times.append(comm.allreduce(time.process_time() - begin, MPI.MAX))
    return min(times)


def measure(comm: MPI.Intracomm, crossovers: float, repeat: int) -> dict:
    """Times on the ranks of a communicator. Collective."""
    case = benchlib.system(crossovers, comm=comm)
    before = comm.allgather(benchlib.resident_mib())
    x, y = case.matrix.createVecs()
    x.set(1.0)
    product = shortest(comm, lambda: [case.matrix.mult(x, y) for _ in range(5)], repeat) / 5
    made = []

    def make():
        for solver in made:
            solver.destroy()
        made[:] = [LinearSolver(case.matrix, options=OPTIONS, multigrid=case.linear.multigrid)]

    setup = shortest(comm, make, 2)
    solver = made[0]
    found = []
    solution = shortest(comm, lambda: found.append(solver.solve(case.rhs)), repeat)
    info = found[-1][1]
    for vector, _ in found:
        vector.destroy()
    solver.destroy()
    case.destroy()
    return {
        "ranks": comm.size,
        "crossovers": case.linear.network.num_crossovers_global,
        "product": product,
        "setup": setup,
        "solution": solution,
        "iterations": info.iterations,
        "iteration": solution / info.iterations,
        "mib": max(before),
    }


def main() -> None:
    """Measure, fit, predict."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--crossovers", type=float, default=120_000, help="the largest size")
    parser.add_argument("--repeat", type=int, default=5)
    parser.add_argument("--latency", type=float, default=2e-6, help="of the cluster's network, s")
    parser.add_argument("--network", type=float, default=2e9, help="its bytes/s per rank")
    parser.add_argument("--bandwidth", type=float, default=5e9, help="memory bytes/s per rank")
    arguments, _ = parser.parse_known_args()
    benchlib.say_machine()
    found: list[dict] = []
    bandwidth = {}
    counts = [2**k for k in range(int(log2(COMM.size)) + 1)]
    sizes = [arguments.crossovers / 4, arguments.crossovers / 2, arguments.crossovers]
    for count in counts:
        part = COMM.Split(0 if COMM.rank < count else MPI.UNDEFINED, COMM.rank)
        rows, speed = [], 0.0
        if part != MPI.COMM_NULL:
            measure(part, 3000, 1)  # numba's kernels
            speed = triad(part)
            rows = [measure(part, size, arguments.repeat) for size in sizes]
            part.Free()
        rows, bandwidth[count] = COMM.bcast((rows, speed), 0)
        found += rows
    table = Table(
        "Scaling of the yarn multigrid, Table 1, 45 deg, bending, rtol 1e-8, shortest of "
        f"{arguments.repeat} processor times",
        "crossovers", "ranks", "product, ms", "set-up, s", "iterations", "solution, s",
        "speed-up of product", "of an iteration", "of the solution", "of set-up + solution",
    )  # fmt: skip
    for k in range(len(sizes)):
        one = found[k]
        for row in found[k :: len(sizes)]:
            table.row(
                row["crossovers"],
                row["ranks"],
                f"{1e3 * row['product']:.2f}",
                f"{row['setup']:.2f}",
                row["iterations"],
                f"{row['solution']:.2f}",
                *(f"{one[key] / row[key]:.2f}" for key in ("product", "iteration", "solution")),
                f"{(one['setup'] + one['solution']) / (row['setup'] + row['solution']):.2f}",
            )
    if COMM.rank == 0:
        for count, speed in bandwidth.items():
            print(f"\nmemory bandwidth on {count} rank(s): {speed / 1e9:.1f} GB/s")
        model(found, bandwidth, arguments)
    benchlib.save(
        Path("results/bench_scaling.json"),
        measured=found,
        bandwidth={str(count): speed for count, speed in bandwidth.items()},
    )


def model(found: list[dict], bandwidth: dict[int, float], arguments) -> None:
    """Fit the model on rank 0, print and draw what it predicts."""
    n = np.array([row["crossovers"] for row in found], float)
    p = np.array([row["ranks"] for row in found], float)
    t = np.array([row["iteration"] for row in found])
    several = p > 1
    columns = np.stack(
        [n / p, np.where(several, np.sqrt(n / p), 0.0),
         [messages(*pair) for pair in zip(n, p, strict=True)]], axis=1
    )  # fmt: skip
    (a, b, c), _ = nnls(columns / t[:, None], np.ones(len(t)))
    off = abs(columns @ [a, b, c] / t - 1).max()
    setup = float(np.mean([row["setup"] / row["iteration"] for row in found]))
    iterations = max(row["iterations"] for row in found)
    print(
        f"\nan iteration takes {1e9 * a:.0f} ns per crossover of a rank, {1e6 * b:.2f} us per "
        f"crossover on the side of its box, {1e6 * c:.2f} us per message (fit within "
        f"{100 * off:.0f} %); set-up is {setup:.1f} iterations"
    )
    work = a * bandwidth[1] / arguments.bandwidth
    table = Table(
        f"Predicted for a cluster: memory {arguments.bandwidth / 1e9:.0f} GB/s and network "
        f"{arguments.network / 1e9:.0f} GB/s per rank, latency {1e6 * arguments.latency:.0f} us",
        "crossovers", "ranks", "crossovers per rank", "levels", "messages per iteration",
        "iteration, ms", "of it messages", "set-up + solution, s", "efficiency",
    )  # fmt: skip
    curves = {}
    for size in (1e7, 1e8):
        curves[size] = []
        for ranks in (16, 64, 256, 1024, 4096):
            sent = messages(size, ranks) * arguments.latency
            surface = border_bytes(size, ranks) / arguments.network
            whole = work * size / ranks + sent + surface
            efficiency = work * size / ranks / whole
            curves[size].append((ranks, efficiency))
            table.row(
                f"{size:.0e}",
                ranks,
                f"{size / ranks:.0f}",
                levels(size),
                f"{messages(size, ranks):.0f}",
                f"{1e3 * whole:.2f}",
                f"{100 * (1 - efficiency):.0f} %",
                f"{(iterations + setup) * whole:.2f}",
                f"{efficiency:.2f}",
            )
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot

    figure, axes = pyplot.subplots(1, 2, figsize=(9, 3.5), layout="constrained")
    for count in bandwidth:
        rows = [row for row in found if row["ranks"] == count]
        x = [row["crossovers"] for row in rows]
        axes[0].loglog(x, [row["iteration"] for row in rows], "o-", label=f"{count} rank(s)")
    axes[0].set(xlabel="crossovers", ylabel="seconds per iteration")
    for size, points in curves.items():
        axes[1].semilogx(*zip(*points, strict=True), "o--", label=f"{size:.0e} crossovers")
    axes[1].set(xlabel="ranks", ylabel="predicted efficiency", ylim=(0, 1.05))
    for one in axes:
        one.legend(frameon=False)
    figure.savefig("results/bench_scaling.png", dpi=150)
    pyplot.close(figure)


if __name__ == "__main__":
    main()
