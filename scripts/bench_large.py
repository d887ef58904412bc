# SPDX-License-Identifier: MIT
"""A large preform from case file to written results: where time and memory go.

    ./scripts/fenicsx mpirun -n 2 python3 -m mpi4py scripts/bench_large.py [--crossovers 1e6]
        [--profile] [--pictures]

Does what `cruciform-petsc run` does with a case file that it writes first, and prints what each
stage took and the memory of each rank. Results are written to results/bench_large.
"""

import argparse
import cProfile
import logging
import pstats
from math import sqrt
from pathlib import Path

import benchlib
from benchlib import COMM, TABLE_1, Table, clock

from cruciform_petsc.case.schema import Case
from cruciform_petsc.run import run_case

CASE = """\
title = "A preform of {crossovers:.0f} crossovers"
[fabric]
use = "e-glass-plain-2.4"
[preform]
outline = {{ rectangle = ["{width:.4f} m", "{length:.4f} m"] }}
bias_angle = "45 deg"
[test]
kind = "bias-extension"
finite = false
extension = "{extension:.4f} mm"
[continuum]
compare = false
[output]
directory = "results/bench_large"
pictures = {pictures}
"""


def main() -> None:
    """Run the case and print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--crossovers", type=float, default=1e6)
    parser.add_argument("--profile", action="store_true", help="what Python functions took, rank 0")
    parser.add_argument("--pictures", action="store_true", help="draw, and solve without bending")
    arguments, _ = parser.parse_known_args()
    benchlib.say_machine()
    width = sqrt(arguments.crossovers * TABLE_1.warp.spacing * TABLE_1.weft.spacing / 1.05)
    directory = Path("results/bench_large")
    if COMM.rank == 0:
        directory.mkdir(parents=True, exist_ok=True)
        (directory / "case.toml").write_text(
            CASE.format(
                crossovers=arguments.crossovers,
                width=width,
                length=1.05 * width,
                extension=10 * width,
                pictures=str(arguments.pictures).lower(),
            )
        )
    COMM.barrier()
    log = logging.getLogger("bench_large")
    profile = cProfile.Profile()
    if arguments.profile and COMM.rank == 0:
        profile.enable()
    with clock() as total:
        case = Case.load_collective(COMM, directory / "case.toml", [])
        summary = run_case(COMM, case, directory, log)
    profile.disable()
    solver = summary["solver"]
    inside = solver["setup_s"] + solver["solution_s"]
    table = Table(
        f"{summary['crossovers']} crossovers, {summary['dofs']} unknowns, {COMM.size} rank(s): "
        "from case file to written results",
        "stage", "s",
    )  # fmt: skip
    stages = dict(summary["wall_s"])
    stages.pop("total")
    table.row("network", f"{stages.pop('network'):.1f}")
    table.row("solver: set-up", f"{solver['setup_s']:.1f}")
    table.row(f"solver: {solver['iterations']} iterations", f"{solver['solution_s']:.1f}")
    table.row("assembly, crossover fields", f"{stages.pop('solve') - inside:.1f}")
    for name, seconds in stages.items():
        table.row(name.replace("_", " "), f"{seconds:.1f}")
    table.row("all", f"{total.wall:.1f}")
    table.row("outside set-up and solution", f"{total.wall - inside:.1f}")
    peak = summary["peak_mib_per_rank"]
    if COMM.rank == 0:
        print(f"\nmemory {', '.join(f'{mib:.0f}' for mib in peak)} MiB on the ranks, "
              f"{1024 * sum(peak) / summary['crossovers']:.2f} KiB per crossover")  # fmt: skip
        if arguments.profile:
            pstats.Stats(profile).sort_stats("tottime").print_stats(40)
    benchlib.save(
        Path(f"results/bench_large_{COMM.size}.json"), table=table.rows, peak_mib=list(peak)
    )


if __name__ == "__main__":
    main()
