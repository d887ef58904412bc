#!/usr/bin/env python3
# SPDX-License-Identifier: MIT
"""Kill and interrupt a test again and again, resume it, and look whether its curve comes out.

    scripts/fenicsx python3 scripts/kill_test.py [--case bias|forming] [--kills N] [--signals N]
        [--jobs J] [--minutes M] [--seed S]

Each time a bias extension of 39 crossovers, or the forming of a hemisphere with 81, is started on
one to three ranks, and one of them, or all, are sent SIGKILL, or SIGINT, SIGTERM or SIGHUP, at a
random moment (nine times out of ten between the first checkpoint and the last result, else while
the ranks start). Then the test is resumed on one to three ranks; every tenth is hit once more
before. All must end in the curve of a run that was left alone. A signal must end the run, without a
traceback. Exit code 0 if all is well.
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
from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from dataclasses import dataclass
from itertools import count
from pathlib import Path

# Columns that tell how equilibrium was found, which need not be the same.
EFFORT = ("newton_iterations", "residual_N", "tolerance_N", "cuts", "seconds")
# No import of cruciform_petsc or mpi4py: this process starts mpirun and is no rank itself.

BIAS = """
title = "To be killed"
[fabric]
use = "glass-pp-plain-1.93"
[fabric.shear]
law = "table"
angle = "deg"
force = "N/mm"
points = [[5, 0.002], [20, 0.004], [35, 0.011], [45, 0.028], [50, 0.05]]
[preform]
outline = { rectangle = ["22 mm", "40 mm"] }
bias_angle = "45 deg"
[test]
kind = "bias-extension"
finite = true
extension = ["1 mm", "2 mm", "4 mm"]
increments = 12
[output]
pictures = false
paraview = false
"""
FORMING = """
title = "A cup to be killed"
[fabric]
use = "glass-pp-plain-1.93"
[preform]
outline = { rectangle = ["92 mm", "92 mm"] }
bias_angle = "0 deg"
yarns_per_cruciform = 2
[test]
kind = "forming"
[[tool]]
name = "die"
shape = { revolve = { opening_radius = "22.5 mm", fillet = "5 mm", outer_radius = "90 mm" } }
friction = 0.2
[[tool]]
name = "punch"
shape = { sphere = { radius = "20 mm", shaft = true } }
friction = 0.2
[[tool]]
name = "holder"
shape = { ring = { inner_radius = "29 mm", outer_radius = "90 mm" } }
friction = 0.2
[[stage]]
name = "close"
force = { holder = "20 N" }
[[stage]]
name = "draw"
travel = { punch = ["0 mm", "0 mm", "-12 mm"] }
results = 3
[output]
pictures = false
"""
CASES = {"bias": (BIAS, "curve.csv"), "forming": (FORMING, "forces.csv")}  # and their tables
HUNG = -1000  # in place of an exit code
WITHIN = 1e-6  # of the largest value in the same unit


def command(ranks: int, *arguments: object) -> list[str]:
    """What starts the program."""
    launcher = ["mpirun", "-n", str(ranks)] if ranks > 1 else []
    return [*launcher, sys.executable, "-u", "-m", "cruciform_petsc", *map(str, arguments)]


def environment() -> dict[str, str]:
    """Without traces of an MPI job that this process may belong to; idle ranks yield."""
    job = re.compile(r"PMIX_(?!MCA_)|OMPI_COMM_|PMI_")
    env = {name: value for name, value in os.environ.items() if not job.match(name)}
    return env | {"OMPI_ALLOW_RUN_AS_ROOT": "1", "OMPI_ALLOW_RUN_AS_ROOT_CONFIRM": "1",
                  "OMPI_MCA_mpi_yield_when_idle": "1", "OMP_NUM_THREADS": "1",
                  "PRTE_MCA_rmaps_default_mapping_policy": ":oversubscribe"}  # fmt: skip


def ranks_of(launcher: int) -> list[int]:
    """Process numbers of the ranks that a launcher has started; it may be the only one."""
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
        if b"cruciform_petsc" not in words:
            continue
        if process == launcher and b"-n" not in words:
            return [process]
        while parent in parents and parent != launcher:
            parent = parents[parent][0]
        if parent == launcher:
            ranks.append(process)
    return ranks


def read_curve(path: Path) -> dict[str, list[float]]:
    """Columns of a curve; names of stages are text."""
    with path.open() as file:
        rows = list(csv.DictReader(file))
    names = [name for name in rows[0] if name not in (*EFFORT, "stage")]
    return {name: [float(row[name] or "nan") for row in rows] for name in names}


def difference(one: dict[str, list[float]], other: dict[str, list[float]]) -> float:
    """Largest difference of two curves over the largest value of all columns in the same unit."""
    if one.keys() != other.keys() or any(len(one[name]) != len(other[name]) for name in one):
        return float("inf")
    scale: Counter[str] = Counter()
    for name, column in other.items():
        known = [abs(value) for value in column if value == value]
        scale[unit(name)] = max(scale[unit(name)], *known, 1e-300)
    largest = 0.0
    for name, column in other.items():
        for a, b in zip(one[name], column, strict=True):
            if a == a or b == b:
                largest = max(largest, abs(a - b) / scale[unit(name)])
    return largest


def unit(name: str) -> str:
    """How a column's name ends."""
    return name.rpartition("_")[2]


def chances_of(seed: int, what: str) -> Iterator[random.Random]:
    """Chances of trial after trial, the same whoever does it."""
    for number in count():
        yield random.Random(f"{seed} {what} {number}")


@dataclass
class Trial:
    """What is done to a run, and what came of it."""

    ranks: int
    number: int  # of the signal
    everyone: bool  # or one rank
    starting: bool  # while it starts, or later
    share: float  # of the time that this takes


@dataclass
class Outcome:
    """Of a run that was hit."""

    code: int
    hit: bool
    finished: bool  # before it was hit
    seconds: float  # from there to its end
    output: str


class Runner:
    """Runs, hits and resumes one case in one folder."""

    def __init__(self, folder: Path, text: str, table: str):
        self.folder, self.results = folder, folder / "results"
        folder.mkdir()
        self.case, self.told = folder / "case.toml", folder / "output.txt"
        self.case.write_text(text)
        self.table = self.results / table
        self.env = environment()
        self.start = self.work = 0.0  # seconds to the first increment, and from there to the end

    def run(self, ranks: int, *arguments: object) -> subprocess.CompletedProcess[str]:
        """Run to the end."""
        return subprocess.run(
            command(ranks, *arguments), env=self.env, capture_output=True, text=True, timeout=300
        )

    def measure(self, *arguments: object) -> int:
        """Run to the end on one rank, taking the time; returns the exit code."""
        begin = time.monotonic()
        process = subprocess.Popen(
            command(1, *arguments), env=self.env, stdout=subprocess.PIPE, text=True
        )
        assert process.stdout is not None
        for line in process.stdout:
            if "Newton" in line and not self.start:
                self.start = time.monotonic() - begin
            elif line.startswith("results in"):
                self.work = time.monotonic() - begin - self.start
        return process.wait()

    def hit(self, trial: Trial, chance: random.Random, *arguments: object) -> Outcome:
        """Start, and send the signal."""
        begin = time.monotonic()
        with self.told.open("w") as output:
            process = subprocess.Popen(
                command(trial.ranks, *arguments), env=self.env, stdout=output, stderr=output
            )
            # Work has begun when a rank tells of an increment.
            while not trial.starting and process.poll() is None and "Newton" not in self.words():
                time.sleep(0.002)
            moment = (begin + trial.share * self.start) if trial.starting else (
                time.monotonic() + trial.share * self.work
            )  # fmt: skip
            while time.monotonic() < moment and process.poll() is None:
                time.sleep(0.001)
            victims = ranks_of(process.pid) if process.poll() is None else []
            if victims and not trial.everyone:
                victims = [chance.choice(victims)]
            finished, hit = "results in" in self.words(), False
            for victim in victims:
                with suppress(ProcessLookupError):
                    os.kill(victim, trial.number)
                    hit = True
            sent = time.monotonic()
            try:
                code = process.wait(timeout=90)
            except subprocess.TimeoutExpired:
                code = HUNG
                process.kill()
                process.wait()
        return Outcome(code, hit, finished, time.monotonic() - sent, self.words())

    def words(self) -> str:
        """What the run has told."""
        return self.told.read_text(errors="replace")

    def reached(self) -> int:
        """Accepted increments that the curve on the disk tells of."""
        path = self.table
        return max(len(path.read_text().splitlines()) - 1, 0) if path.exists() else 0


class Campaign:
    """All trials of one kind, and their counts."""

    def __init__(self, signals: Sequence[int], wanted: dict[str, list[float]]):
        self.signals, self.wanted = signals, wanted
        self.counts: Counter[str] = Counter()
        self.problems: list[str] = []
        self.reached: list[int] = []
        self.seconds: list[float] = []
        self.worst = 0.0

    def problem(self, what: str, trial: Trial, more: str) -> None:
        """Count it, and print what was told."""
        self.counts[what] += 1
        self.problems.append(what)
        print(f"{what}: {trial}\n{more.strip()[-1500:]}", flush=True)

    def attempt(self, runner: Runner, chance: random.Random) -> None:
        """Hit a run that is not finished then, and resume it."""
        trial = Trial(
            chance.choice((1, 1, 1, 1, 1, 1, 2, 2, 3)), chance.choice(self.signals),
            chance.random() < 0.4, chance.random() < 0.1, chance.random(),
        )  # fmt: skip
        shutil.rmtree(runner.results, ignore_errors=True)
        outcome = runner.hit(trial, chance, "run", runner.case, "--output", runner.results)
        if outcome.finished or (outcome.code == 0 and not outcome.hit):
            self.counts["(had finished)"] += 1
            return
        name = signal.Signals(trial.number).name
        self.counts["hit"] += 1
        self.counts[f"{name} to {'all' if trial.everyone else 'one'} of {trial.ranks}"] += 1
        self.judge(trial, outcome)
        at = runner.reached()
        self.counts["before the first increment"] += at == 0
        self.reached.append(at)
        # By the folder if anything is there, and in any case now and then by the case file.
        ranks, resume = chance.choice((1, 1, 1, 1, 1, 1, 1, 1, 2, 3)), ("resume", runner.results)
        if not (runner.results / "checkpoint" / "newest").exists() or chance.random() < 0.25:
            resume = ("resume", runner.case, "--output", runner.results)
        if chance.random() < 0.1:
            again = Trial(ranks, trial.number, trial.everyone, False, chance.random())
            twice = runner.hit(again, chance, *resume)
            if twice.hit and not twice.finished:
                self.counts["hit once more while it was resumed"] += 1
                self.judge(again, twice)
        result = runner.run(ranks, *resume)
        # Hit after the last word had been written, or it was the second time that came late.
        finished = "is finished, there is nothing to resume" in result.stderr
        if result.returncode and not finished:
            self.problem("LOST", trial, f"after {at} increments: {result.stdout}{result.stderr}")
            return
        self.counts["was finished" if finished else f"resumed on {ranks}"] += 1
        gap = difference(read_curve(runner.table), self.wanted)
        self.worst = max(self.worst, gap)
        if not gap <= WITHIN:
            self.problem("ANOTHER CURVE", trial, f"by {gap:.1e}")

    def judge(self, trial: Trial, outcome: Outcome) -> None:
        """Look at how a run ended that was hit."""
        self.seconds.append(outcome.seconds)
        if outcome.code == HUNG:
            self.problem("HUNG", trial, outcome.output)
        elif outcome.code == 0:
            self.problem("SWALLOWED", trial, outcome.output)
        if trial.number == signal.SIGKILL:
            return
        self.counts[f"exit code {outcome.code}"] += 1
        self.counts["told how to go on"] += (
            "continue with" in outcome.output.split("interrupted;")[-1]
        )
        if "Traceback" in outcome.output or "PETSC ERROR" in outcome.output:
            begun = "crossovers" in outcome.output
            self.problem("TRACEBACK" if begun else "(traceback of Python's own start)", trial,
                         outcome.output)  # fmt: skip

    def tell(self, name: str) -> None:
        """Print the counts."""
        print(f"\n{name}: {self.counts['hit']}")
        for what, number in sorted(self.counts.items()):
            print(f"{number:6d} {what}")
        for of, values in (("increments before", self.reached), ("seconds after", self.seconds)):
            values = sorted(values) or [0]
            shares = [f"{values[min(int(len(values) * q), len(values) - 1)]:.3g}"
                      for q in (0.25, 0.5, 0.75, 0.99, 1.0)]  # fmt: skip
            print(f"{of} it: quartiles, 99 %, most: {', '.join(shares)}")
        print(f"curves agree to {self.worst:.1e} of their largest values", flush=True)

    def failures(self) -> list[str]:
        """What may not be."""
        return [problem for problem in self.problems if not problem.startswith("(")]


def main() -> int:
    """Do all trials and tell the counts."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--case", choices=CASES, default="bias")
    parser.add_argument("--kills", type=int, default=200)
    parser.add_argument("--signals", type=int, default=200)
    parser.add_argument("--jobs", type=int, default=2, help="trials at a time")
    parser.add_argument("--minutes", type=float, default=1e6, help="no new trial after these")
    parser.add_argument("--seed", type=int, default=1)
    arguments = parser.parse_args()
    for number in (signal.SIGHUP, signal.SIGINT):  # as nohup and & have it, runs ignored them, too
        signal.signal(number, signal.SIG_DFL)
    failures, deadline = [], time.monotonic() + 60.0 * arguments.minutes
    with tempfile.TemporaryDirectory(prefix="kill_test_") as name:
        runners = [
            Runner(Path(name) / str(job), *CASES[arguments.case]) for job in range(arguments.jobs)
        ]
        first = runners[0]
        run = ("run", first.case, "--output", first.results)
        first.run(1, *run)  # compiles, so that the next ones tell the time
        if first.measure(*run):
            return 1
        print(f"left alone: {first.start:.1f} s to the first of {first.reached()} increments, "
              f"{first.work:.1f} s from there", flush=True)  # fmt: skip
        wanted = read_curve(first.table)
        for runner in runners:
            runner.start, runner.work = first.start, first.work
        for what, number, signals in (
            ("kills", arguments.kills, (signal.SIGKILL,)),
            ("signals", arguments.signals, (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)),
        ):
            if not number:
                continue
            campaign, chances = Campaign(signals, wanted), chances_of(arguments.seed, what)
            with ThreadPoolExecutor(arguments.jobs) as pool:

                def work(runner: Runner, campaign=campaign, number=number, chances=chances) -> None:
                    while campaign.counts["hit"] < number and time.monotonic() < deadline:
                        campaign.attempt(runner, next(chances))
                        if campaign.counts["hit"] % 10 == 0:
                            print(f"{campaign.counts['hit']} ...", flush=True)

                list(pool.map(work, runners))
            campaign.tell(what)
            failures += campaign.failures()
    print(f"\n{len(failures)} failures {dict(Counter(failures))}")
    return 1 if failures else 0


if __name__ == "__main__":
    raise SystemExit(main())
