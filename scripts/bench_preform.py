# SPDX-License-Identifier: MIT
"""Preforms of full size pressed over tools, from case file to written results.

    ./scripts/fenicsx mpirun -n 2 python3 -m mpi4py scripts/bench_preform.py [--case dome-2 ...]
        [--against-one] [--coarser 2]

    dome-2     a whole ply of 800 mm x 500 mm on the double dome of demos/, 2 yarns to a cruciform
    dome-1     the same, every yarn
    square     1 m x 1 m, every yarn, under the tools of demos/hemisphere.toml four times as large
    two-plies  demos/two_plies.toml, 38 x 38 crossovers a ply, the whole stroke of 50 mm

Does what `cruciform-petsc run` does with a case file that it writes first; prints a row for each
case, and for each step what it took, and draws time over the stroke. With --against-one rank 0 does
the same alone first, in the same run. The two plies stand beside what a research code is reported
to take for a quarter of them with as many triangles (1,550 s, explicit; another machine).
"""

from __future__ import annotations

import argparse
import csv
import json
import logging
import re
import time
from collections.abc import Callable
from pathlib import Path

import benchlib
import numpy as np
from benchlib import COMM, Table
from mpi4py import MPI

from cruciform_petsc.case.schema import Case
from cruciform_petsc.errors import SolverError
from cruciform_petsc.run import run_case

DEMOS = Path(__file__).parents[1] / "demos"
FOLDER = Path("results/bench_preform")
# A case: the demo it is made from, what is written in place of what, and what a peer takes, s.
WHOLE = {
    r'\["250 mm", "400 mm"\]': '["500 mm", "800 mm"]',
    r"symmetry = .*": "",
    '"25 N"': '"100 N"',
}
FOUR_TIMES = {
    '"240 mm", "240 mm"': '"1000 mm", "1000 mm"',
    "52.5 mm": "210 mm",
    '"8 mm"': '"32 mm"',
    '"200 mm"': '"800 mm"',
    '"50 mm"': '"200 mm"',
    "64.5 mm": "258 mm",
    '"1 mm" } }': '"4 mm" } }',
    '"50 N"': '"800 N"',
    '"-60 mm"': '"-240 mm"',
}
CASES: dict[str, tuple[str, dict[str, str], int, float | None]] = {
    "dome-2": ("double_dome", WHOLE, 2, None),
    "dome-1": ("double_dome", WHOLE, 1, None),
    "square": ("hemisphere", FOUR_TIMES, 1, None),
    "two-plies": ("two_plies", {'"-25 mm"': '"-50 mm"', "results = 2": "results = 10"}, 1, 1550.0),
}


def written(name: str, coarser: int) -> Path:
    """The case file of a case, with so many times the yarns to a cruciform; written by rank 0."""
    demo, changes, yarns, _ = CASES[name]
    path = FOLDER / f"{name}.toml"
    if COMM.rank == 0:
        text = (DEMOS / f"{demo}.toml").read_text()
        changes = changes | {
            r"yarns_per_cruciform = \d+": f"yarns_per_cruciform = {yarns * coarser}",
            'title = ".*"': f'title = "{name}, pressed"',
            'directory = ".*"': f'directory = "{FOLDER / name}"\npictures = false',
        }
        for old, new in changes.items():
            text, count = re.subn(old, new, text)
            if not count:
                raise ValueError(f"demos/{demo}.toml has no {old!r} any more")
        FOLDER.mkdir(parents=True, exist_ok=True)
        path.write_text(text)
    COMM.barrier()
    return path


def measure(comm: MPI.Intracomm, name: str, path: Path) -> dict:
    """Run a case on some ranks. Collective on them."""
    directory = FOLDER / f"{name}_{comm.size}"
    benchlib.reset_peak()
    begin, processor = time.perf_counter(), time.process_time()
    case = Case.load_collective(comm, path, [])
    reached = "end"
    try:
        run_case(comm, case, directory, logging.getLogger("bench_preform"))
    except SolverError as error:
        reached = error.reason
    wall = comm.allreduce(time.perf_counter() - begin, MPI.MAX)
    processor = comm.allreduce(time.process_time() - processor, MPI.MAX)
    mib = comm.allreduce(benchlib.peak_mib())
    found = None
    if comm.rank == 0:
        summary = json.loads((directory / "summary.json").read_text())
        with (directory / "forces.csv").open(newline="") as file:
            steps = list(csv.DictReader(file))
        found = {
            "ranks": comm.size,
            "crossovers": summary["crossovers"],
            "unknowns": summary["dofs"],
            "stroke": steps[-1]["share_percent"],
            "reached": reached,
            "steps": len(steps),
            "newton": sum(int(step["newton_iterations"]) for step in steps),
            "in_newton": sum(float(step["seconds"]) for step in steps),
            "wall": wall,
            "processor": processor,
            "kib": 1024 * mib / summary["crossovers"],
            "gib": mib / 1024,
            "penetration_mm": summary["penetration_max_mm"],
            "shear_deg": summary["shear_max_deg"],
            "punch_n": abs(float(steps[-1]["punch_force_z_N"])),
            "curve": [
                [step["stage"], float(step["share_percent"]), int(step["newton_iterations"]),
                 float(step["seconds"])]
                for step in steps
            ],
        }  # fmt: skip
    return comm.bcast(found, 0)


def alone(call: Callable[[], dict]) -> dict:
    """What rank 0 finds while the others sleep. Collective."""
    found = call() if COMM.rank == 0 else None
    done = COMM.Ibarrier()
    while not done.Test():  # a rank that waits in MPI spins, and takes bandwidth
        time.sleep(0.2)
    return COMM.bcast(found, 0)


def draw(results: list[dict]) -> None:
    """Seconds since the beginning over the stages."""
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot

    figure, axes = pyplot.subplots(figsize=(6, 4), layout="constrained")
    for result in results:
        names = list(dict.fromkeys(row[0] for row in result["curve"]))
        at = [names.index(row[0]) + row[1] / 100 for row in result["curve"]]
        label = f"{result['case']}, {result['crossovers']} crossovers, {result['ranks']} rank(s)"
        axes.plot(at, np.cumsum([row[3] for row in result["curve"]]), ".-", label=label)
    axes.set(xlabel="stages done", ylabel="seconds (wall clock)")
    axes.legend(frameon=False, fontsize="small")
    figure.savefig("results/bench_preform.png", dpi=150)
    pyplot.close(figure)


def main() -> None:
    """Print the tables."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--case", choices=list(CASES), nargs="+", default=["dome-2"])
    parser.add_argument("--coarser", type=int, default=1, help="times the yarns to a cruciform")
    parser.add_argument("--against-one", action="store_true", help="rank 0 alone first, too")
    parser.add_argument("--verbose", action="store_true", help="the runs' log")
    arguments, _ = parser.parse_known_args()
    benchlib.say_machine()
    if arguments.verbose and COMM.rank == 0:
        logging.basicConfig(level=logging.INFO, format="%(message)s")
    table = Table(
        "Preforms pressed over tools, from case file to written results",
        "case", "crossovers", "unknowns", "ranks", "steps", "Newton steps", "wall clock, s",
        "processor s of a rank", "a Newton step, s", "memory, GiB", "KiB per crossover",
        "punch, N", "shear, deg", "into the cloth, mm", "reached", "times as fast",
    )  # fmt: skip
    results = []
    for name in arguments.case:
        path, peer = written(name, arguments.coarser), CASES[name][3]
        found = []
        if arguments.against_one and COMM.size > 1:
            found.append(alone(lambda n=name, p=path: measure(MPI.COMM_SELF, n, p)))
        found.append(measure(COMM, name, path))
        for run in found:
            ratio = ""
            if run is not found[0]:
                ratio = f"{found[0]['wall'] / run['wall']:.2f} than one rank"
            elif peer is not None:
                ratio = f"{4 * peer / run['wall']:.0f} than four quarters of the peer's"
            end = run["reached"]
            reached = end if end == "end" else f"{run['stroke']} % ({end})"
            table.row(
                name, run["crossovers"], run["unknowns"], run["ranks"], run["steps"],
                run["newton"], f"{run['wall']:.1f}", f"{run['processor']:.1f}",
                f"{run['in_newton'] / max(run['newton'], 1):.3f}", f"{run['gib']:.2f}",
                f"{run['kib']:.1f}", f"{run['punch_n']:.2f}", f"{run['shear_deg']:.2f}",
                f"{run['penetration_mm']:.3f}", reached, ratio,
            )  # fmt: skip
        results += [{"case": name, **run} for run in found]
    if COMM.rank == 0:
        draw(results)
    benchlib.save(Path("results/bench_preform.json"), runs=results)


if __name__ == "__main__":
    main()
