# SPDX-License-Identifier: MIT
"""How far a test is: a line and a row of the curve for each increment, and a bar on a terminal."""

from __future__ import annotations

import logging
import os
import stat
import sys
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import IO, TYPE_CHECKING, Any

import numpy as np

from ..experiments.result import curve_of
from ..quantities import quantity, si_text
from .tables import write_csv

if TYPE_CHECKING:
    from ..equilibrium.stages import Increment
    from ..experiments.experiment import Experiment

NARROWEST = 40  # columns; what claims less does not know
QUIET, QUIETEST = 30.0, 600.0  # s without a line: after the first, then each time twice as long


class Progress:
    """Tells the log about each accepted increment and keeps the curve on disk."""

    def __init__(self, experiment: Experiment, path: Path, log: logging.Logger):
        self.experiment, self.path, self.log = experiment, path, log
        self.increments: list[Increment] = []
        self._route = Route(experiment.values)
        self._tell_bar: Callable[[float, str], None] | None = None

    @contextmanager
    def bar(self) -> Iterator[None]:
        """Show a bar while a finite test is solved, if there is a terminal to show it on."""
        if not self.experiment.finite:
            yield
            return
        with progress_bar(self.log, self._route.length, self._done()) as self._tell_bar:
            yield
        self._tell_bar = None

    def go_on_from(self, increments: list[Increment]) -> None:
        """Take note of the increments of a former run. Collective."""
        self.increments = list(increments)
        if increments:
            self._write()
            reached = self.experiment.column.text(increments[-1].control)
            self.log.info("           going on from %s, %d increments", reached, len(increments))

    def __call__(self, increment: Increment) -> None:
        """Take note of an increment. Collective."""
        self.increments.append(increment)
        if self._tell_bar is not None:
            self._tell_bar(self._done(), self._text())
        mended = f", {increment.shifted} of them mended" if increment.shifted else ""
        self.log.info(
            "%8.2f s    %-22s%s shear %4.1f deg, %2d Newton iterations%s",
            increment.seconds,
            self.experiment.column.text(increment.control),
            self._forces(increment),
            np.rad2deg(increment.shear_max),
            increment.iterations,
            mended,
        )
        self._write()

    def _forces(self, increment: Increment) -> str:
        """What they are in the log, where the control is none of them."""
        if self.experiment.control == "load":
            return ""
        forces = ((column, increment.columns[column]) for column in self.experiment.forces)
        return "".join(f" {quantity(column).short} {force:<8.5g} N," for column, force in forces)

    def _done(self) -> float:
        """How much of the way through the values asked for lies behind."""
        if not self.increments:
            return 0.0
        last = self.increments[-1]
        value = last.load if self.experiment.by_load else last.control
        return self._route.done(sum(step.asked for step in self.increments), value)

    def _text(self) -> str:
        """What stands before the bar."""
        last, experiment = self.increments[-1], self.experiment
        now = experiment.column.value_text(last.control)
        if experiment.by_load:
            now = si_text(last.load, "N")
        return (
            f"increment {len(self.increments)}, {now}, {np.rad2deg(last.shear_max):.1f} deg of "
            f"shear, {last.iterations} Newton step{'s' if last.iterations != 1 else ''}"
        )

    def _write(self) -> None:
        """Write the curve as far as it is known."""
        curve = curve_of(self.increments, self.experiment)
        write_csv(self.experiment.network.comm, self.path, curve)


class Route:
    """The way from rest through the values (n,) that a test is asked for, and what of it is done.

    It may turn back.
    """

    def __init__(self, values: Sequence[float] | np.ndarray):
        self.values = np.concatenate([[0.0], np.asarray(values, float)])
        self.steps = np.abs(np.diff(self.values))
        self.length = float(self.steps.sum())

    def done(self, asked: int, at: float) -> float:
        """Length that lies behind, with so many of the values reached, and now at some value."""
        behind = float(self.steps[:asked].sum())
        if asked >= len(self.steps):
            return behind
        return behind + min(abs(at - self.values[asked]), self.steps[asked])


def is_terminal(stream: IO[str]) -> bool:
    """Whether somebody looks at what is written to a stream.

    Open MPI gives every rank a terminal of its own, whatever mpirun's output is; what counts is
    mpirun's, which is the parent of ranks on the same machine.
    """
    if not stream.isatty():
        return False
    return "OMPI_COMM_WORLD_SIZE" not in os.environ or parents_terminal() is not None


def parents_terminal() -> Path | None:
    """The standard output of the process that started this one, if it is a terminal (Linux)."""
    path = Path(f"/proc/{os.getppid()}/fd/1")
    with suppress(OSError):
        if stat.S_ISCHR(path.stat().st_mode) and path.resolve().name != "null":
            return path
    return None


def _columns() -> int:
    """Width of the terminal; ranks do not know mpirun's."""
    widths = [80]
    place = parents_terminal()
    with suppress(OSError):
        if place is not None:
            with os.fdopen(os.open(place, os.O_WRONLY | os.O_NOCTTY), "w") as terminal:
                widths.insert(0, os.get_terminal_size(terminal.fileno()).columns)
    with suppress(OSError, ValueError):
        widths.insert(0, os.get_terminal_size(sys.stdout.fileno()).columns)
    return next(width for width in widths if width >= NARROWEST)


@contextmanager
def progress_bar(
    log: logging.Logger, length: float, begin: float = 0.0
) -> Iterator[Callable[[float, str], None] | None]:
    """Show a bar below the log while the block runs; not collective.

    Of the whole length, ``begin`` is done before. Yields what is told how much is done, and a text;
    None where there is no bar: no terminal, or a log of warnings only (or nothing, as on ranks
    other than 0). Lines of the log to stdout go above the bar.
    """
    stdout = sys.stdout
    mine: list[Any] = [
        handler
        for handler in log.handlers
        if isinstance(handler, logging.StreamHandler) and handler.stream is stdout
    ]
    shown = log.isEnabledFor(logging.INFO) and any(h.level <= logging.INFO for h in mine)
    if not (shown and is_terminal(stdout)):
        yield None
        return
    from rich import progress
    from rich.console import Console

    console = Console(file=stdout, width=_columns(), force_terminal=True, highlight=False)
    bar = progress.Progress(
        progress.TextColumn("{task.description}", markup=False),
        progress.BarColumn(bar_width=None),
        progress.TextColumn("{task.percentage:>3.0f} %"),
        progress.TextColumn("{task.fields[left]}", markup=False),
        console=console,
        expand=True,
        transient=True,
        refresh_per_second=2,
    )
    started = time.monotonic()
    task = bar.add_task("next increment" if begin else "first increment", total=length, left="")
    bar.update(task, completed=begin)

    def tell(done: float, text: str) -> None:
        left = ""
        if done > begin:
            seconds = (time.monotonic() - started) * (length - done) / (done - begin)
            left = f"{duration(seconds)} left"
        bar.update(task, completed=done, description=text, left=left)

    try:
        bar.start()  # sys.stdout writes above the bar now
        console.show_cursor(True)  # a rank that is killed cannot put it back
        for handler in mine:
            handler.setStream(sys.stdout)
        yield tell
    finally:
        with suppress(IndexError):  # rich's: it was interrupted after it had hidden the cursor
            bar.stop()
        console.show_cursor(True)
        for handler in mine:
            handler.setStream(stdout)


class _Last(logging.Filter):
    """Notes when something was told, signs of life not counted; lets all through."""

    def __init__(self) -> None:
        super().__init__()
        self.at = time.monotonic()

    def filter(self, record: logging.LogRecord) -> bool:
        """Note it."""
        if not getattr(record, "still", False):
            self.at = time.monotonic()
        return True


@contextmanager
def sign_of_life(log: logging.Logger, quiet: float = QUIET) -> Iterator[None]:
    """Have the log say that the block still runs where it tells nothing for a while (s).

    Then after twice as long each time, QUIETEST at most. Not collective; where the log tells
    warnings only (or nothing, as on ranks other than 0) nothing is told. A step on the way through
    wrinkles may take hundreds of Newton steps, and smaller steps after them.
    """
    if not log.isEnabledFor(logging.INFO):
        yield
        return
    last, over = _Last(), threading.Event()

    def tell() -> None:
        due = quiet
        while not over.wait(min(0.25 * quiet, 1.0)):
            silent = time.monotonic() - last.at
            if silent < quiet:
                due = quiet
            elif silent >= due:
                text = "           still looking for the next equilibrium, for %s by now"
                log.info(text, duration(silent), extra={"still": True})
                due += min(due, QUIETEST)

    log.addFilter(last)
    thread = threading.Thread(target=tell, daemon=True)
    thread.start()
    try:
        yield
    finally:
        over.set()
        thread.join()
        log.removeFilter(last)


def duration(seconds: float) -> str:
    """Write a duration for people: "42 s", "3 min", "2.5 h"."""
    if seconds < 99.5:
        return f"{seconds:.0f} s"
    return f"{seconds / 60:.0f} min" if seconds < 5970 else f"{seconds / 3600:.1f} h"
