# SPDX-License-Identifier: MIT
"""Runs of one case with some of its keys varied: `cruciform-petsc sweep CASE --vary KEY=VALUES`.

Each run is a process of its own, with a folder of its own that is called by its values, so that a
run that fails takes no other along. A second sweep into the same folder runs what is not there yet.
"""

from __future__ import annotations

import hashlib
import json
import logging
import math
import os
import re
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from decimal import Decimal
from functools import partial
from itertools import product
from pathlib import Path
from typing import TYPE_CHECKING, Any, Self

import numpy as np

from . import process
from .case.schema import KEY, Case
from .errors import InputError, cut, harmless
from .experiments.registry import KINDS, kind_class
from .experiments.result import EFFORT
from .output import pictures
from .output.checkpoint import hint
from .output.folder import OF_SWEEP, locked
from .output.tables import read_csv, write_csv
from .quantities import quantity
from .reading import read_json

if TYPE_CHECKING:
    from mpi4py import MPI

MOST_RUNS = 1000
PATIENCE = 10.0  # s, for runs that were told to end: they write what they have reached
POLL = 0.05  # s
PROGRAM = [sys.executable, "-m", "cruciform_petsc"]
_NUMBER = r"[+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d{1,3})?"
_QUANTITY = re.compile(rf"({_NUMBER})\s*([^\d\s:,.+-][^:,]*)?")
# An MPI job must not take itself for a part of the one that this process may belong to.
_OF_THIS_JOB = re.compile(r"PMIX_(?!MCA_)|OMPI_COMM_|PMI_|OMPI_MCA_ess|PRTE_LAUNCHED")
FORM = "write --vary preform.bias_angle=30:60:5deg (start:stop:step), or =30deg,45deg (a list)"


# -- what is varied --------------------------------------------------------------------------------


@dataclass(frozen=True)
class Varied:
    """A key of the case file and the values that it takes, as `--set` has them.

    ``numbers``: their numbers, if all are in the one ``unit`` ("" without one); else None.
    """

    key: str
    values: tuple[str, ...]
    unit: str = ""
    numbers: tuple[float, ...] | None = None

    @classmethod
    def read(cls, key: str, given: str | Iterable[Any]) -> Self:
        """Read "30:60:5 deg", "30,45 deg" or "grip,centre-line"; or values one by one.

        Raises InputError for what is neither a key nor values.
        """
        if not re.fullmatch(KEY, key):
            raise InputError(f'--vary "{cut(key)}" names no key of a case file, {FORM}')
        if isinstance(given, str):
            values = _between(key, given) or _listed(key, given)
        else:
            values = [v if isinstance(v, str) else json.dumps(v) for v in _plain(given)]
        if not values or not all(values):
            raise InputError(f'--vary "{key}" has a value that is empty, {FORM}')
        parts = [_QUANTITY.fullmatch(value.strip("\"'")) for value in values]
        for n, part in enumerate(parts):
            if part and part[2]:
                values[n] = f"{part[1]} {part[2]}"  # "30deg" as well
        units = {part[2] or "" for part in parts if part}
        if None in parts or len(units) > 1:
            return cls(key, tuple(dict.fromkeys(values)))
        numbers = {value: float(part[1]) for value, part in zip(values, parts, strict=True) if part}
        return cls(key, tuple(numbers), units.pop(), tuple(numbers.values()))

    @property
    def label(self) -> str:
        """Name of its column and axis, with the unit."""
        return f"{self.key} ({self.unit})" if self.unit else self.key

    def column(self, which: int) -> float | str:
        """What stands in the table for one of the values."""
        return self.values[which] if self.numbers is None else self.numbers[which]


def _plain(values: Iterable[Any]) -> list[Any]:
    return list(values.tolist() if isinstance(values, np.ndarray) else values)


def _between(key: str, text: str) -> list[str]:
    """Values of "start:stop:step unit"; none if it is no range."""
    parts = [part.strip() for part in text.split(":")]
    if len(parts) < 2 or not re.match(_NUMBER, parts[0]):
        return []
    found = [_QUANTITY.fullmatch(part) for part in parts]
    start, stop, step = (Decimal(f[1]) if f else Decimal(0) for f in (*found, None, None)[:3])
    units = {f[2] for f in found if f and f[2]}
    if len(parts) != 3 or None in found or len(units) > 1:
        raise InputError(f'--vary {key}="{cut(text)}" is no range like 30:60:5 deg, {FORM}')
    if step == 0 or (stop - start) * step < 0:
        raise InputError(f'--vary {key}="{cut(text)}": such steps do not lead from start to stop')
    count = (stop - start) / step + 1
    if count > MOST_RUNS or not all(map(math.isfinite, map(float, (start, stop, step)))):
        raise InputError(f'--vary {key}="{cut(text)}" has more than {MOST_RUNS} values')
    unit = units.pop() if units else ""
    return [f"{float(start + n * step):.12g} {unit}".strip() for n in range(int(count))]


def _listed(key: str, text: str) -> list[str]:
    """Values between commas outside of brackets and quotes; a last unit goes for bare numbers."""
    parts, depth, quote = [""], 0, ""
    for letter in text:
        if quote:
            quote = "" if letter == quote else quote
        elif letter in "\"'":
            quote = letter
        depth += (not quote) * ((letter in "[{") - (letter in "]}"))
        if letter == "," and not (depth or quote):
            parts.append("")
        else:
            parts[-1] += letter
    if depth or quote:
        raise InputError(f'--vary {key}="{cut(text)}" has a bracket or a quote that is not closed')
    parts = [part.strip() for part in parts]
    last = _QUANTITY.fullmatch(parts[-1])
    if last and last[2] and all(re.fullmatch(_NUMBER, part) for part in parts[:-1]):
        parts[:-1] = [f"{part} {last[2]}" for part in parts[:-1]]
    return parts


def read_vary(arguments: Sequence[str]) -> list[Varied]:
    """Read all of a command line: "KEY=VALUES" each."""
    pairs = [argument.partition("=") for argument in arguments]
    for argument, (_, equals, _) in zip(arguments, pairs, strict=True):
        if not equals:
            raise InputError(f'--vary "{cut(argument)}" has no values, {FORM}')
    keys = [key.strip() for key, _, _ in pairs]
    twice = next((key for key in keys if keys.count(key) > 1), None)
    if twice:
        raise InputError(f"--vary {twice} is given twice, give all its values at once")
    return [Varied.read(key, text) for key, (_, _, text) in zip(keys, pairs, strict=True)]


# -- a run -----------------------------------------------------------------------------------------


@dataclass
class Run:
    """One run of a sweep: its values, its folder, and what became of it."""

    chosen: tuple[int, ...]  # which value of each varied key
    name: str  # values for people
    overrides: list[str]  # as for --set
    folder: Path
    case: dict[str, Any]  # as its summary has to have it
    status: str = "waiting"  # then "done", "ended early" or "failed"
    message: str = ""
    figures: dict[str, float] = field(default_factory=dict)  # of the last state, by column

    def look(self) -> bool:
        """Take note of results of this very case, if they are there."""
        summary = read_json(self.folder / "summary.json")
        if _without_folder(summary.get("case")) != self.case:
            return False
        self.message = harmless(str(summary.get("ended_early", "")))
        self.status = "ended early" if self.message else "done"
        self.figures = last_row(self.folder)
        return True


def _without_folder(case: Any) -> Any:
    """A case without the folder of its results, in which alone two runs of it differ."""
    if not isinstance(case, dict) or not isinstance(case.get("output"), dict):
        return None
    return case | {"output": {k: v for k, v in case["output"].items() if k != "directory"}}


def _columns(folder: Path) -> dict[str, np.ndarray]:
    """Numbers of the table of a finished run; nothing if there is none."""
    name = next((n for n in ("curve.csv", "forces.csv") if (folder / n).is_file()), None)
    columns = {} if name is None else read_csv(folder / name)
    return {name: column for name, column in columns.items() if column.dtype == float}


def last_row(folder: Path) -> dict[str, float]:
    """What the table of a run tells of the last state that was asked for, energies as their sum."""
    columns = _columns(folder)
    rows = np.flatnonzero(columns.get("asked", np.ones(1)))
    if not columns or not len(next(iter(columns.values()))):
        return {}
    last = {name: float(column[rows[-1] if len(rows) else -1]) for name, column in columns.items()}
    parts = {name for name in last if name.startswith("energy_")}
    kept = {k: v for k, v in last.items() if k not in (*parts, *EFFORT, "share_percent")}
    return kept | ({"energy_J": float(np.nansum([last[p] for p in parts]))} if parts else {})


def _runs(
    path: str | Path, varied: Sequence[Varied], overrides: Sequence[str], output: str | Path | None
) -> tuple[Path, list[Run]]:
    """The folder of a sweep and its runs, all cases checked; InputError for one that is none."""
    count = math.prod(len(one.values) for one in varied)
    if count > MOST_RUNS:
        raise InputError(f"--vary makes {count} runs, at most {MOST_RUNS} are possible")
    if any(one.key.startswith("output.directory") for one in varied):
        raise InputError("--vary output.directory: runs have folders of their own, see --output")
    directory: Path | None = None if output is None else Path(output)
    runs: list[Run] = []
    for chosen in product(*(range(len(one.values)) for one in varied)):
        picked = list(zip(varied, chosen, strict=True))
        values = [f"{one.key}={one.values[which]}" for one, which in picked]
        try:
            case = Case.load(path, [*overrides, *values])
        except InputError as error:
            raise InputError(f"--vary {', '.join(values)}:", *error.args) from None
        if directory is None:
            given = Path(case.output.directory)
            directory = given.with_name(f"{given.name}_sweep")
        name = ", ".join(f"{one.key} = {one.values[which]}" for one, which in picked)
        told = _without_folder(case.model_dump())
        folder = directory / _folder_name(values)
        runs.append(Run(chosen, name, [*overrides, *values], folder, told))
    assert directory is not None
    return directory, runs


def _folder_name(values: Sequence[str]) -> str:
    """Name of a run's folder, by its values whatever the others are."""
    text = ",".join(values).replace("[", ".").replace("]", "")
    name = re.sub(r"[^\w.,=+-]+", "_", text).strip("_.")
    if len(name) > 100 or len(name.replace("_", "")) < len(re.sub(r"[\s_]", "", text)):
        name = f"{name[:90]}-{hashlib.sha256(text.encode()).hexdigest()[:8]}"
    return name


# -- all of them -----------------------------------------------------------------------------------


def run_sweep(
    case: str | Path,
    vary: Mapping[str, str | Sequence[Any]],
    output: str | Path | None = None,
    *,
    overrides: Sequence[str] = (),
    jobs: int | None = None,
    ranks: int = 1,
    petsc_options: Sequence[str] = (),
    log: logging.Logger | None = None,
    ax: Any = None,
) -> dict[str, list]:
    """Run a case file for all combinations of values, side by side. Not collective.

    Parameters
    ----------
    case : path of a case file
    vary : dict
        Values by keys of the case file: "30:60:5 deg" (start:stop:step), "30,45 deg", or a sequence
        of values as case files have them.
    output : path, optional
        Folder of sweep.csv, sweep.png and the runs' own folders; by default that of the case with
        ``_sweep`` behind it. Runs that are finished there are not run again; interrupted ones go
        on.
    overrides : sequence of str
        For all runs, like "preform.refine=4".
    jobs : int, optional
        Runs side by side; by default as many as there are cores for.
    ranks : int
        Processes of each run; more than one are started by ``mpirun -n``.
    petsc_options : sequence of str
        As behind CASE on the command line.
    ax : matplotlib Axes, optional
        Three of them, or two where there is no curve: sweep.png is drawn into them, too. Of a sweep
        that is finished nothing is run again.

    Returns
    -------
    dict of list
        Columns of sweep.csv: the varied keys, with units; figures of each run's last state, named
        as in its curve.csv; ``status`` ("done", "ended early", "failed"), ``message``, ``folder``.

    Raises
    ------
    InputError
        Before anything is run: a key or a value that no case file may have, a folder in use.
    """
    varied = [Varied.read(key, values) for key, values in vary.items()]
    if not varied:
        raise InputError(f"nothing is varied, {FORM}")
    for name, value in (("jobs", jobs), ("ranks", ranks)):
        if value is not None and not (isinstance(value, int) and value > 0):
            raise InputError(f"{name} must be a whole number from 1 up, got {value!r}")
    if ranks > 1 and shutil.which("mpirun") is None:
        raise InputError("there is no mpirun to start several processes of a run with")
    directory, runs = _runs(case, varied, overrides, output)
    from mpi4py import MPI

    log = log or logging.getLogger(__name__)
    cores = len(os.sched_getaffinity(0))
    side_by_side = min(jobs or max(1, cores // ranks), len(runs))
    with locked(MPI.COMM_SELF, directory, OF_SWEEP, log) as folder:
        sweep = _Sweep(MPI.COMM_SELF, folder, varied, runs, log)
        left = [run for run in runs if not run.look()]
        log.info("%d runs, %d of them finished before, %d at a time", *(
            len(runs), len(runs) - len(left), side_by_side
        ))  # fmt: skip
        sweep.write()
        command = ["mpirun", "-n", str(ranks)] if ranks > 1 else []
        command += PROGRAM
        sweep.work_off(left, command, [str(case), *petsc_options], side_by_side)
        sweep.draw(ax)
        log.info("table in      %s", folder / OF_SWEEP[0])
        return sweep.table()


@dataclass
class _Sweep:
    comm: MPI.Intracomm
    directory: Path
    varied: list[Varied]
    runs: list[Run]
    log: logging.Logger

    def table(self) -> dict[str, list]:
        """Columns of sweep.csv."""
        columns: dict[str, list] = {
            one.label: [one.column(run.chosen[i]) for run in self.runs]
            for i, one in enumerate(self.varied)
        }
        for name in dict.fromkeys(name for run in self.runs for name in run.figures):
            columns[name] = [run.figures.get(name, math.nan) for run in self.runs]
        for name in ("status", "message"):
            columns[name] = [getattr(run, name) for run in self.runs]
        return columns | {"folder": [run.folder.name for run in self.runs]}

    def write(self) -> None:
        """Write sweep.csv as far as it is known."""
        write_csv(self.comm, self.directory / OF_SWEEP[0], self.table())

    def work_off(
        self, left: Sequence[Run], program: list[str], arguments: list[str], jobs: int
    ) -> None:
        """Run all that is left; whatever ends this ends what is running."""
        waiting, running = list(left), dict[subprocess.Popen, tuple[Run, str, Any, float]]()

        def start(run: Run, command: str) -> None:
            words = [word for each in run.overrides for word in ("--set", each)]
            case, *options = arguments
            words = [*program, command, case, *words, "--output", str(run.folder), *options]
            told = tempfile.TemporaryFile()  # noqa: SIM115
            environment = {k: v for k, v in os.environ.items() if not _OF_THIS_JOB.match(k)}
            if jobs > 1:
                environment.setdefault("OMP_NUM_THREADS", "1")
            child = subprocess.Popen(
                words, stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL, stderr=told,
                env=environment, start_new_session=True,
            )  # fmt: skip
            running[child] = run, command, told, time.monotonic()

        try:
            while waiting or running:
                while waiting and len(running) < jobs:
                    run = waiting.pop(0)
                    start(run, "resume" if hint(run.folder) else "run")
                time.sleep(POLL)
                for child in [child for child in running if child.poll() is not None]:
                    run, command, told, begun = running.pop(child)
                    if not run.look() and command == "resume":  # of another case
                        start(run, "run")
                        continue
                    self._note(run, child.returncode, told, time.monotonic() - begun)
        except KeyboardInterrupt:
            if process.came:
                process.ignore_signals()  # which come again
            raise
        finally:
            _end(running)

    def _note(self, run: Run, code: int, told: Any, seconds: float) -> None:
        """Take note of a run that has ended."""
        if run.status == "waiting":
            run.status, run.message = "failed", _why(code, told)
        told.close()
        self.write()
        done = sum(one.status != "waiting" for one in self.runs)
        text = run.message
        if run.status == "done":
            text = ", ".join(
                f"{quantity(name).short} {run.figures[name]:.4g} {quantity(name).log_unit}"
                for name in _shown(run.figures)
            )
        level = logging.INFO if run.status == "done" else logging.WARNING
        template = "%8.2f s  %d of %d  %s: %s%s"
        status = "" if run.status == "done" else f"{run.status}, "
        self.log.log(level, template, seconds, done, len(self.runs), run.name, status, text)

    def draw(self, ax: Any = None) -> None:
        """Draw sweep.png, and into axes: curves, and results over the first varied key."""
        for kind in KINDS:
            kind_class(kind)  # declares its columns
        good = [run for run in self.runs if run.figures]
        if not good:
            return
        first, *others = self.varied

        def other(run: Run) -> str:
            return ", ".join(o.values[w] for o, w in zip(others, run.chosen[1:], strict=True))

        shown = _shown(good[0].figures)
        lines, labels = [], ("", "")
        for run in good:
            columns = _columns(run.folder)
            x, y = next(iter(run.figures)), shown[0]
            if (run.folder / "curve.csv").is_file() and y in columns and len(columns[y]) > 1:
                labels = quantity(x).axis, quantity(y).axis
                line = pictures.from_origin(columns[x], columns[y])
                lines.append((first.column(run.chosen[0]), other(run), *line))
        ends = []
        for name in shown[:2]:
            series: dict[str, tuple[list, list]] = {}
            for run in good:
                keys, results = series.setdefault(other(run), ([], []))
                keys.append(first.column(run.chosen[0]))
                results.append(run.figures.get(name, math.nan))
            ends.append((quantity(name).axis, series))
        path = self.directory / OF_SWEEP[1]
        title = pictures.plain_text(good[0].case["title"])
        draw = partial(pictures.swept, first.label, labels, lines, ends, title)
        pictures.save(self.comm, path, draw)
        if ax is not None:
            pictures.draw(self.comm, draw, ax)


def _shown(figures: Mapping[str, float]) -> list[str]:
    """The columns that tell most: the load, or the largest force, and a shear angle."""
    forces = [name for name in figures if quantity(name).unit == "N"]
    forces.sort(key=lambda name: -math.inf if name == "load_N" else -abs(figures[name]))
    known = ("shear_middle_deg", "shear_max_deg")
    angles = [name for name in known if math.isfinite(figures.get(name, math.nan))]
    return [*forces[:1], *angles[:1]] or list(figures)[-1:]


def _why(code: int, told: Any) -> str:
    """Why a run left no results, from what it said on stderr."""
    told.seek(0)
    text = told.read().decode(errors="replace")
    if code < 0:
        with suppress(ValueError):
            return f"ended by {signal.Signals(-code).name}"
    said = re.findall(r"cruciform-petsc: (.*(?:\n  .*)*)", text)
    if said:
        return harmless(" ".join(said[0].split()))
    last = (text.strip().splitlines() or ["no word why"])[-1]
    return harmless(f"ended with code {code}: {cut(last, 200)}")


def _end(running: Iterable[subprocess.Popen]) -> None:
    """End processes: as a user would, and at once those that do not obey."""
    running = list(running)
    for child in running:
        with suppress(ProcessLookupError):
            child.terminate()
    deadline = time.monotonic() + PATIENCE
    for child in running:
        try:
            child.wait(max(0.0, deadline - time.monotonic()))
        except subprocess.TimeoutExpired:
            with suppress(ProcessLookupError):
                os.killpg(child.pid, signal.SIGKILL)
            child.wait()
