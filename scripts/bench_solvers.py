# SPDX-License-Identifier: MIT
"""Solvers of the network side by side, in one run.

    ./scripts/fenicsx python3 scripts/bench_solvers.py [--crossovers 240000]
    ./scripts/fenicsx python3 scripts/bench_solvers.py --limit [--largest 120000]
    ./scripts/fenicsx mpirun -n 2 python3 -m mpi4py scripts/bench_solvers.py --robustness
    ./scripts/fenicsx mpirun -n 2 python3 -m mpi4py scripts/bench_solvers.py --space

The first prints set-up, solution, iterations, cost in products with the matrix and memory of the
yarn multigrid, GAMG, BoomerAMG, MUMPS and CHOLMOD, to a true residual of 1e-8, and draws them; the
second MUMPS beside the yarn multigrid from size to size, for DIRECT_LIMIT; the third the iterations
of the yarn multigrid for many preforms and fabrics; the fourth what solves a tangent in space:
MUMPS in its own order and in the nested dissection's, and the multigrid in space. All print
Markdown and write results/*.json.
"""

import argparse
import gc
from dataclasses import replace
from functools import partial
from itertools import product
from pathlib import Path

import benchlib
import numpy as np
from benchlib import COMM, System, Table, clock, cloth, matvec_seconds, system
from petsc4py import PETSc

from cruciform_petsc.errors import SolverError
from cruciform_petsc.solvers.linear import LinearSolver
from cruciform_petsc.solvers.options import DIRECT, DIRECT_LIMIT, YARN_MULTIGRID

TOLERANCE = 1e-8
CG = {
    "ksp_type": "cg",
    "ksp_rtol": TOLERANCE,
    "ksp_norm_type": "unpreconditioned",
    "ksp_max_it": 1000,
}
GAMG = CG | {"pc_type": "gamg"}
ICC = {
    "mg_levels_pc_type": "bjacobi",
    "mg_levels_sub_pc_type": "icc",
    "mg_levels_sub_pc_factor_shift_type": "positive_definite",
}
HYPRE = CG | {"pc_type": "hypre"}
CHOLMOD = DIRECT | {"pc_factor_mat_solver_type": "cholmod"}
# What GAMG is tuned over: each entry is tried, the fastest is its best setting found.
GAMG_TUNED = {
    "ICC": ICC,
    "ICC, 1 step": ICC | {"mg_levels_ksp_max_it": 1},
    "ICC, 1 step, W cycle": ICC | {"mg_levels_ksp_max_it": 1, "pc_mg_cycle_type": "w"},
    "ICC, 1 step, threshold 0.01": ICC | {"mg_levels_ksp_max_it": 1, "pc_gamg_threshold": 0.01},
    "ICC, 1 step, no aggressive coarsening": ICC
    | {"mg_levels_ksp_max_it": 1, "pc_gamg_aggressive_coarsening": 0},
}


def measure(case: System, options: dict, check: bool = False, fresh: bool = True) -> dict | None:
    """Set-up and solution times, iterations, residual and memory of one solver. Collective.

    check: with a direct solver's search for mechanisms, as a run has it.
    fresh: what others have freed is given back to the system first.
    """
    gc.collect()
    before = benchlib.resident_mib() if fresh else 0.0
    benchlib.reset_peak()
    near_null = case.near_null if options["pc_type"] == "gamg" else None
    solver = None
    try:
        with clock() as setup:
            solver = LinearSolver(case.matrix, near_null, options, multigrid=case.linear.multigrid)
        with clock() as solution:
            x, info = solver.solve(case.rhs, singular=not check)
        x.destroy()
    except SolverError as error:
        if COMM.rank == 0:
            print(f"<!-- {error} -->")
        return None
    finally:
        memory = COMM.allreduce(benchlib.peak_mib() - before)
        if solver is not None:
            # petsc4py lets go of collectively made objects at once, C's allocator of memory not.
            solver.destroy()
            del solver
            PETSc.garbage_cleanup(case.matrix.comm)
    return {
        "setup": setup.cpu,
        "solution": solution.cpu,
        "total": setup.cpu + solution.cpu,
        "wall": setup.wall + solution.wall,
        "iterations": info.iterations,
        "residual": info.relative_residual,
        "memory": memory,
    }


def measure_twice(case: System, options: dict) -> dict | None:
    """The faster of two times; memory and residual of the first. Collective.

    The first time touches new memory, which a program that goes on has from what came before.
    """
    first = measure(case, options)
    again = first and measure(case, options, fresh=False)
    if first is None or again is None:
        return first
    faster = min(first, again, key=lambda one: one["total"])
    return first | {key: faster[key] for key in ("setup", "solution", "total", "wall")}


def compare(crossovers: float, direct: bool) -> None:
    """All solvers on one system."""
    warm = system(3000)  # numba's kernels are compiled, or read, before the clock runs
    measure(warm, YARN_MULTIGRID | CG | {"pc_type": "mg"})
    warm.destroy()
    with clock() as making:
        case = system(crossovers)
    network = case.linear.network
    product_seconds = matvec_seconds(case.matrix).cpu
    unknowns = case.matrix.getSize()[0]
    entries = case.matrix.getInfo()["nz_used"]
    if COMM.rank == 0:
        print(
            f"\n{network.num_crossovers_global} crossovers, {unknowns} unknowns, "
            f"{entries / unknowns:.1f} entries per row, network and assembly {making.cpu:.2f} s, "
            f"one product with the matrix {1e3 * product_seconds:.2f} ms"
        )
    table = Table(
        f"Solvers at {network.num_crossovers_global} crossovers on {COMM.size} rank(s), "
        "processor time, the faster of two",
        "solver", "set-up, s", "solution, s", "together, s", "iterations", "true residual",
        "in products", "memory, MiB", "times the yarn multigrid's", "wall clock, s",
    )  # fmt: skip
    results: dict[str, dict] = {}

    def run(name: str, options: dict) -> None:
        # The product is timed before and after: other users slow down the memory by and by.
        before = matvec_seconds(case.matrix).cpu
        result = measure_twice(case, options)
        after = matvec_seconds(case.matrix).cpu
        if result is None:
            table.row(name, "failed", *[""] * 8)
            return
        result["products"] = result["total"] / (0.5 * (before + after))
        results[name] = result
        own = results.get("yarn multigrid", result)["total"]
        table.row(
            name,
            f"{result['setup']:.2f}",
            f"{result['solution']:.2f}",
            f"{result['total']:.2f}",
            result["iterations"],
            f"{result['residual']:.0e}",
            f"{result['products']:.0f}",
            f"{result['memory']:.0f}",
            f"{result['total'] / own:.1f}",
            f"{result['wall']:.2f}",
        )

    run("yarn multigrid", YARN_MULTIGRID | CG | {"pc_type": "mg"})
    run("GAMG, defaults", GAMG)
    for name, options in GAMG_TUNED.items():
        run(f"GAMG, {name}", GAMG | options)
    run("BoomerAMG", HYPRE)
    if direct:
        if COMM.size == 1:
            run("CHOLMOD", CHOLMOD)
        run("MUMPS", DIRECT)
    run("yarn multigrid, again", YARN_MULTIGRID | CG | {"pc_type": "mg"})
    name = f"bench_solvers_{COMM.size}"
    benchlib.save(
        Path(f"results/{name}.json"),
        crossovers=network.num_crossovers_global,
        unknowns=unknowns,
        product=product_seconds,
        solvers=results,
    )
    if COMM.rank == 0:
        picture(Path(f"results/{name}.png"), network.num_crossovers_global, results)
    case.destroy()


def limit(largest: float) -> None:
    """MUMPS and the yarn multigrid by size, as a run uses them; least of three of each."""
    for bending in (True, False):
        warm = system(3000, bending=bending)
        measure(warm, YARN_MULTIGRID | CG)
        warm.destroy()
    table = Table(
        f"MUMPS beside the yarn multigrid on {COMM.size} rank(s), processor time, to 1e-9; "
        f"DIRECT_LIMIT is {DIRECT_LIMIT}",
        "crossovers", "bending", "unknowns", "MUMPS, s", "MiB", "yarn multigrid, s", "MiB",
        "MUMPS in multigrids",
    )  # fmt: skip
    for size in (n for n in (3e3, 1e4, 3e4, 6e4, 1.2e5, 2.4e5) if n <= largest):
        for bending in (True, False):
            case = system(size, bending=bending)
            seconds, memory = [], []
            for options in (DIRECT, YARN_MULTIGRID):
                runs = [measure(case, options, check=True) for _ in range(3)]
                seconds.append(min(run["total"] for run in runs))
                memory.append(runs[0]["memory"])
            table.row(
                case.linear.network.num_crossovers_global,
                "yes" if bending else "no",
                case.matrix.getSize()[0],
                f"{seconds[0]:.2f}",
                f"{memory[0]:.0f}",
                f"{seconds[1]:.2f}",
                f"{memory[1]:.0f}",
                f"{seconds[0] / seconds[1]:.1f}",
            )
            case.destroy()
    benchlib.save(Path(f"results/bench_limit_{COMM.size}.json"), table=table.rows)


def picture(path: Path, crossovers: int, results: dict[str, dict]) -> None:
    """Bars of set-up and solution."""
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot

    names = list(results)[::-1]
    figure, axes = pyplot.subplots(figsize=(7, 0.35 * len(names) + 1.2), layout="constrained")
    setup = [results[name]["setup"] for name in names]
    solution = [results[name]["solution"] for name in names]
    axes.barh(names, setup, color="0.6", label="set-up")
    axes.barh(names, solution, left=setup, color="tab:blue", label="solution")
    axes.set_xlabel(f"processor seconds, {crossovers} crossovers, {COMM.size} rank(s)")
    axes.legend(frameon=False)
    figure.savefig(path, dpi=150)
    pyplot.close(figure)


def robustness(largest: float) -> None:
    """Iterations of the yarn multigrid over sizes, angles, outlines and fabrics."""
    options = YARN_MULTIGRID | CG | {"pc_type": "mg"}
    counts: dict[str, object] = {}

    def iterations(*arguments, **keywords) -> str:
        case = system(*arguments, **keywords)
        result = measure(case, options)
        case.destroy()
        counts[f"{arguments} {keywords}"] = result and result["iterations"]
        return "-" if result is None else str(result["iterations"])

    sizes = [n for n in (1e4, 3e4, 1e5, 3e5, 1e6) if n <= largest]
    table = Table(
        f"Iterations by size, Table 1, rectangle at 45 deg, {COMM.size} rank(s)",
        "crossovers", *(f"{n:.0f}" for n in sizes),
    )  # fmt: skip
    for bending in (True, False):
        table.row(
            "bending" if bending else "no bending", *(iterations(n, bending=bending) for n in sizes)
        )
    fabrics = {
        "Table 1": cloth(),
        "E/G = 10^4": cloth(1e4),
        "E/G = 10^5": cloth(1e5),
        "50 : 1": cloth(ratio=50),
        "E/G = 10^5, 50 : 1": cloth(1e5, 50),
    }
    fabrics["1 : 50"] = swapped(cloth(ratio=50))
    for size in (n for n in (1e4, 6e4) if n <= largest):
        table = Table(
            f"Iterations at {size:.0f} crossovers, {COMM.size} rank(s): bending / no bending",
            "outline", "angle", *fabrics,
        )  # fmt: skip
        for shape, angle in product(("rectangle", "L", "hole"), (0.0, 20.0, 45.0)):
            table.row(
                shape,
                f"{angle:.0f}",
                *(
                    " / ".join(
                        iterations(size, shape, angle, bending, fabric) for bending in (True, False)
                    )
                    for fabric in fabrics.values()
                ),
            )
    known = [count for count in counts.values() if count is not None]
    if COMM.rank == 0:
        print(f"\nlargest {max(known)}, mean {np.mean(known):.1f}, failed "
              f"{len(counts) - len(known)} of {len(counts)}")  # fmt: skip
    benchlib.save(Path(f"results/bench_robustness_{COMM.size}.json"), iterations=counts)


SPACE = {
    "MUMPS, its own order": {"pc_type": "cholesky", "mat_mumps_icntl_7": 4},  # PORD
    "MUMPS, dissection": {"pc_type": "cholesky"},
    "multigrid in space": {"pc_type": "mg"},
}


def space(largest: float) -> None:
    """Tangents of cloth bent over a bump among the tools of bench_forming's hemisphere.

    The bump is 20 mm high and 50 mm wide, the cloth stretched by 1 %. Times are of a solution with
    what it takes to assemble the tangent, the first one and the least of two later ones.
    """
    import bench_forming

    from cruciform_petsc.equilibrium.newton import Equilibrium

    table = Table(
        f"Tangents in space on {COMM.size} rank(s), processor time",
        "crossovers", "unknowns", "solver", "assembly, s", "first, s", "again, s", "wall clock, s",
        "iterations", "10^9 operations", "MiB of factors", "memory, MiB",
    )  # fmt: skip
    run = bench_forming.CASES["hemisphere"]
    for side in (n for n in (24, 58, 77, 152, 240) if n == 24 or n**2 <= largest):
        blank = replace(run, crossovers=side).blank()
        state, model = blank.start(), blank.model
        x = state.x.copy()
        rest = x[blank.cloth_at]
        bump = -0.02 * np.exp(-(rest[:, :2] ** 2).sum(axis=1) / (2 * 0.05**2))
        x[blank.cloth_at] = np.column_stack([1.01 * rest[:, :2], rest[:, 2] + bump])
        state = replace(state, x=x)
        matrix, _ = model.stiffness(state)
        assembly = benchlib.best(partial(model.stiffness, state, reuse=matrix), 2)
        matrix.destroy()
        pushed = np.zeros_like(x)
        pushed[blank.tool_node[2], 2] = -1e-4
        for name, options in SPACE.items():
            gc.collect()
            before = benchlib.resident_mib()
            benchlib.reset_peak()
            equilibrium = Equilibrium(model, state, options)
            times = []
            for _ in range(3):
                with clock() as taken:
                    equilibrium.tangent_step(state, pushed, out_of_balance=True)
                times.append(taken)
            ksp = equilibrium.snes.ksp
            told = [ksp.getIterationNumber(), "", ""]
            if options["pc_type"] == "cholesky":
                factor = ksp.getPC().getFactorMatrix()
                told = ["", f"{factor.getMumpsRinfog(3) / 1e9:.1f}", factor.getMumpsInfog(22)]
            if side > 24:  # the first compiles numba's kernels
                table.row(
                    blank.network.num_crossovers_global, 3 * blank.nodes.num_nodes_global, name,
                    f"{assembly.cpu:.2f}", f"{times[0].cpu:.2f}",
                    f"{min(one.cpu for one in times[1:]):.2f}",
                    f"{min(one.wall for one in times[1:]):.2f}", *told,
                    f"{COMM.allreduce(benchlib.peak_mib() - before):.0f}",
                )  # fmt: skip
            equilibrium.destroy()
            del equilibrium, ksp
            PETSc.garbage_cleanup(PETSc.COMM_WORLD)
    benchlib.save(Path(f"results/bench_space_{COMM.size}.json"), table=table.rows)


def swapped(fabric):
    """The same cloth with warp and weft changed over."""
    return replace(fabric, warp=fabric.weft, weft=fabric.warp)


def main() -> None:
    """Print the tables asked for."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--crossovers", type=float, default=240_000)
    parser.add_argument("--no-direct", action="store_true", help="leave the direct solvers out")
    parser.add_argument("--robustness", action="store_true", help="iterations instead of times")
    parser.add_argument("--limit", action="store_true", help="MUMPS and multigrid by size")
    parser.add_argument("--space", action="store_true", help="tangents in space")
    parser.add_argument("--largest", type=float, help="crossovers, but for the first")
    arguments, _ = parser.parse_known_args()
    benchlib.say_machine()
    if arguments.robustness:
        robustness(arguments.largest or 1e6)
    elif arguments.limit:
        limit(arguments.largest or 1.2e5)
    elif arguments.space:
        space(arguments.largest or 6e4)
    else:
        compare(arguments.crossovers, not arguments.no_direct)


if __name__ == "__main__":
    main()
