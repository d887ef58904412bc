# SPDX-License-Identifier: MIT
"""A bar that tells how far a test is, on terminals; elsewhere the log's lines must do."""

from __future__ import annotations

import logging
import os
import stat
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import IO, Any

import numpy as np

NARROWEST = 40  # columns; what claims less does not know


class Route:
    """The way through the values that a test is asked for, from rest, and what of it is done.

    Parameters
    ----------
    values : sequence of float (n,)
        May turn back.
    """

    def __init__(self, values: Sequence[float] | np.ndarray):
        self.values = np.concatenate([[0.0], np.asarray(values, float)])
        self.reached = np.concatenate([[0.0], np.cumsum(np.abs(np.diff(self.values)))])

    @property
    def length(self) -> float:
        """Of the whole way."""
        return float(self.reached[-1])

    def done(self, asked: int, at: float) -> float:
        """Length that lies behind, with so many of the values reached, and now at some value."""
        asked = min(asked, len(self.values) - 1)
        if asked == len(self.values) - 1:
            return self.length
        return min(
            float(self.reached[asked] + abs(at - self.values[asked])),
            float(self.reached[asked + 1]),
        )


def is_terminal(stream: IO[str]) -> bool:
    """Whether somebody looks at what is written to a stream.

    Open MPI gives every rank a terminal of its own, whatever mpirun's output is; what counts is
    mpirun's, which is the parent of ranks on the same machine.
    """
    if not stream.isatty():
        return False
    return "OMPI_COMM_WORLD_SIZE" not in os.environ or _parents_terminal() is not None


def _parents_terminal() -> Path | None:
    """The standard output of the process that started this one, if it is a terminal (Linux)."""
    path = Path(f"/proc/{os.getppid()}/fd/1")
    with suppress(OSError):
        if stat.S_ISCHR(path.stat().st_mode) and path.resolve().name != "null":
            return path
    return None


def _columns() -> int:
    """Width of the terminal; ranks do not know mpirun's."""
    for place in (None, _parents_terminal()):
        with suppress(OSError, ValueError):
            if place is None:
                columns = os.get_terminal_size(sys.stdout.fileno()).columns
            else:
                descriptor = os.open(place, os.O_WRONLY | os.O_NOCTTY)
                try:
                    columns = os.get_terminal_size(descriptor).columns
                finally:
                    os.close(descriptor)
            if columns >= NARROWEST:
                return columns
    return 80


@contextmanager
def progress_bar(
    log: logging.Logger, length: float, begin: float = 0.0
) -> Iterator[Callable[[float, str], None] | None]:
    """Show a bar below the log while the block runs; not collective.

    Parameters
    ----------
    log : logging.Logger
        Its lines to stdout go above the bar. One that tells warnings only (or nothing, as on ranks
        other than 0) has no bar.
    length, begin : float
        Of the whole way, and what of it is done before.

    Yields
    ------
    callable or None
        Told what is done, and a text; None where there is no bar.
    """
    stdout = sys.stdout
    if not (log.isEnabledFor(logging.INFO) and log.handlers and is_terminal(stdout)):
        yield None
        return
    try:
        from rich.console import Console
        from rich.progress import BarColumn, Progress, TextColumn
    except ImportError:  # an ornament only
        yield None
        return
    console = Console(file=stdout, width=_columns(), force_terminal=True, highlight=False)
    bar = Progress(
        TextColumn("{task.description}", markup=False),
        BarColumn(bar_width=None),
        TextColumn("{task.percentage:>3.0f} %"),
        TextColumn("{task.fields[left]}", markup=False),
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

    mine: list[Any] = [
        handler
        for handler in log.handlers
        if isinstance(handler, logging.StreamHandler) and handler.stream is stdout
    ]
    with bar:  # sys.stdout writes above the bar in here
        console.show_cursor(True)  # a rank that is killed cannot put it back
        for handler in mine:
            handler.setStream(sys.stdout)
        try:
            yield tell
        finally:
            for handler in mine:
                handler.setStream(stdout)


def duration(seconds: float) -> str:
    """Write a duration for people: "42 s", "3 min", "2.5 h"."""
    if seconds < 99.5:
        return f"{seconds:.0f} s"
    return f"{seconds / 60:.0f} min" if seconds < 5970 else f"{seconds / 3600:.1f} h"
