#!/usr/bin/env python3
# SPDX-License-Identifier: MIT
"""Kill a test again and again, resume it each time, and look whether its curve comes out.

    scripts/fenicsx python3 scripts/kill_test.py [--kills N] [--seed S]

Each time a bias extension of some 60 crossovers is started on two ranks, a random one of them is
sent SIGKILL at a random moment (nine times out of ten between the first checkpoint and the last
result, else while the ranks start), and the test is resumed, on one rank and on two in turn. Every
tenth is killed once more while it is being resumed. All must end in the curve of a run that was
left alone. Exit code 0 if all do.
"""

from __future__ import annotations

import argparse
import csv
import os
import random
import re
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections import Counter
from pathlib import Path

# Columns that tell how equilibrium was found, which need not be the same.
EFFORT = ("newton_iterations", "residual_N", "tolerance_N", "cuts", "seconds")
# No import of cruciform_petsc or mpi4py: this process starts mpirun and is no rank itself.

CASE = """
title = "To be killed"
[fabric]
use = "glass-pp-plain-1.93"
[fabric.shear]
law = "table"
angle = "deg"
force = "N/mm"
points = [[5, 0.002], [20, 0.004], [35, 0.011], [45, 0.028], [50, 0.05]]
[preform]
outline = { rectangle = ["26 mm", "52 mm"] }
bias_angle = "45 deg"
[test]
kind = "bias-extension"
finite = true
extension = ["2 mm", "4 mm", "6 mm", "8 mm"]
increments = 40
[output]
pictures = false
paraview = false
"""
WITHIN = 1e-6  # of each column's largest value


def command(ranks: int, *arguments: object) -> list[str]:
    """What starts the program."""
    return ["mpirun", "-n", str(ranks), sys.executable, "-u", "-m", "cruciform_petsc",
            *map(str, arguments)]  # fmt: skip


def environment() -> dict[str, str]:
    """Without traces of an MPI job that this process may belong to; idle ranks yield."""
    job = re.compile(r"PMIX_(?!MCA_)|OMPI_COMM_|PMI_")
    env = {name: value for name, value in os.environ.items() if not job.match(name)}
    return env | {"OMPI_ALLOW_RUN_AS_ROOT": "1", "OMPI_ALLOW_RUN_AS_ROOT_CONFIRM": "1",
                  "OMPI_MCA_mpi_yield_when_idle": "1", "OMP_NUM_THREADS": "1",
                  "PRTE_MCA_rmaps_default_mapping_policy": ":oversubscribe"}  # fmt: skip


def ranks_of(launcher: int) -> list[int]:
    """Process numbers of the ranks that a launcher has started."""
    parents = {}
    for path in Path("/proc").glob("[0-9]*/stat"):
        try:
            text = path.read_text()
            words = (path.parent / "cmdline").read_bytes().split(b"\0")
        except OSError:  # it has ended
            continue
        parents[int(path.parent.name)] = (int(text.rpartition(")")[2].split()[1]), words)
    ranks = []
    for process, (parent, words) in parents.items():
        if b"cruciform_petsc" not in words or process == launcher:
            continue
        while parent in parents and parent != launcher:
            parent = parents[parent][0]
        if parent == launcher:
            ranks.append(process)
    return ranks


def read_curve(folder: Path) -> dict[str, list[float]]:
    """Columns of a curve."""
    with (folder / "curve.csv").open() as file:
        rows = list(csv.DictReader(file))
    names = [name for name in rows[0] if name not in EFFORT]  # how long it took is no matter
    return {name: [float(row[name] or "nan") for row in rows] for name in names}


def difference(one: dict[str, list[float]], other: dict[str, list[float]]) -> float:
    """Largest difference of two curves over the largest value of the column; energies' of all."""
    if one.keys() != other.keys() or any(len(one[name]) != len(other[name]) for name in one):
        return float("inf")
    energies = [v for name in other if name.startswith("energy") for v in other[name]]
    largest = 0.0
    for name, column in other.items():
        scale = max(map(abs, energies if name.startswith("energy") else column))
        for a, b in zip(one[name], column, strict=True):
            if a == a or b == b:
                largest = max(largest, abs(a - b) / scale)
    return largest


class Killer:
    """Runs, kills and resumes one case in one folder."""

    def __init__(self, folder: Path, chance: random.Random):
        self.folder, self.results, self.chance = folder, folder / "results", chance
        self.case = folder / "case.toml"
        self.case.write_text(CASE)
        self.env = environment()
        self.start = self.work = 0.0  # seconds to the first increment, and from there to the end

    def run(self, ranks: int, *arguments: object) -> subprocess.CompletedProcess[str]:
        """Run to the end."""
        return subprocess.run(
            command(ranks, *arguments), env=self.env, capture_output=True, text=True, timeout=300
        )

    def kill(self, ranks: int, *arguments: object) -> str:
        """Start, and kill a random rank at a random moment; tells what had happened."""
        starting = self.chance.random() < 0.1
        share = self.chance.random()
        begin = time.monotonic()
        with (self.folder / "output.txt").open("w") as output:
            process = subprocess.Popen(
                command(ranks, *arguments), env=self.env, stdout=output, stderr=output
            )
            # Work has begun when a rank tells of an increment.
            told = self.folder / "output.txt"
            while not starting and process.poll() is None and "Newton" not in told.read_text():
                time.sleep(0.002)
            moment = (begin + share * self.start) if starting else (
                time.monotonic() + share * self.work
            )  # fmt: skip
            while time.monotonic() < moment and process.poll() is None:
                time.sleep(0.001)
            victims = ranks_of(process.pid) if process.poll() is None else []
            if victims:
                try:
                    os.kill(self.chance.choice(victims), signal.SIGKILL)
                except ProcessLookupError:
                    victims = []
            code = process.wait(timeout=120)
        if code == 0:
            return "had finished"
        return "killed" if victims else "failed by itself"

    def measure(self, ranks: int, *arguments: object) -> int:
        """Run to the end, taking the time; returns the exit code."""
        begin = time.monotonic()
        process = subprocess.Popen(
            command(ranks, *arguments), env=self.env, stdout=subprocess.PIPE, text=True
        )
        assert process.stdout is not None
        for line in process.stdout:
            if "Newton" in line and not self.start:
                self.start = time.monotonic() - begin
            elif line.startswith("results in"):
                self.work = time.monotonic() - begin - self.start
        return process.wait()

    def reached(self) -> int:
        """Accepted increments that the curve on the disk tells of."""
        path = self.results / "curve.csv"
        return max(len(path.read_text().splitlines()) - 1, 0) if path.exists() else 0


def main() -> int:
    """Run the kills and tell the counts."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--kills", type=int, default=200, help="that something is left to do after")
    parser.add_argument("--seed", type=int, default=1)
    arguments = parser.parse_args()
    chance = random.Random(arguments.seed)
    counts: Counter[str] = Counter()
    worst, lost = 0.0, 0
    reached: list[int] = []
    with tempfile.TemporaryDirectory(prefix="kill_test_") as name:
        killer = Killer(Path(name), chance)
        run = ("run", killer.case, "--output", killer.results)
        killer.run(2, *run)  # compiles, so that the next one tells the time
        if killer.measure(2, *run):
            return 1
        wanted = read_curve(killer.results)
        print(f"left alone: {killer.start:.1f} s to the first of {killer.reached()} increments, "
              f"{killer.work:.1f} s from there", flush=True)  # fmt: skip
        number = 0
        while counts["resumed on 1"] + counts["resumed on 2"] + lost < arguments.kills:
            number += 1
            shutil.rmtree(killer.results, ignore_errors=True)
            what = killer.kill(2, *run)
            counts[what] += 1
            if what == "failed by itself":
                print((killer.folder / "output.txt").read_text()[-2000:], file=sys.stderr)
                lost += 1
                break
            if what == "had finished":
                continue
            at = killer.reached()
            counts["killed before the first increment"] += at == 0
            counts["killed when results were being written"] += (
                killer.results / "curve.csv"
            ).exists()
            reached.append(at)
            ranks = 1 + counts["killed"] % 2
            # By the folder if anything is there, and in any case now and then by the case file.
            resume: tuple[object, ...] = ("resume", killer.results)
            if not (killer.results / "checkpoint" / "newest").exists() or number % 4 == 0:
                resume = ("resume", killer.case, "--output", killer.results)
            if counts["killed"] % 10 == 0:
                twice = killer.kill(ranks, *resume)
                counts["killed while it was resumed"] += twice == "killed"
            result = killer.run(ranks, *resume)
            # Killed after the last word had been written, or it was the second kill that failed.
            finished = "is finished, there is nothing to resume" in result.stderr
            if result.returncode and not finished:
                lost += 1
                print(f"kill {counts['killed']}: NOT RESUMED after {at} increments:"
                      f" {result.stderr.strip()}", flush=True)  # fmt: skip
                continue
            counts["were finished already" if finished else f"resumed on {ranks}"] += 1
            gap = difference(read_curve(killer.results), wanted)
            worst = max(worst, gap)
            if not gap <= WITHIN:
                lost += 1
                print(f"kill {counts['killed']}: ANOTHER CURVE, by {gap:.1e}", flush=True)
            if counts["killed"] % 10 == 0:
                print(f"{counts['killed']} kills, {lost} lost, curves agree to {worst:.1e}",
                      flush=True)  # fmt: skip
    for what, count in sorted(counts.items()):
        print(f"{count:6d} {what}")
    reached.sort()
    quarters = [reached[len(reached) * i // 4] for i in (1, 2, 3)]
    print(f"increments at the kill: quartiles {quarters}, {len(set(reached))} different numbers")
    print(f"{lost:6d} lost\ncurves agree to {worst:.1e} of their largest values")
    return 1 if lost else 0


if __name__ == "__main__":
    raise SystemExit(main())
