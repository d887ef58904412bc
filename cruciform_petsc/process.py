# SPDX-License-Identifier: MIT
"""The program as a process: signals that end it, streams that fail, folders that are missing.

Imports neither MPI nor PETSc: it sets up the process before these start.
"""

from __future__ import annotations

import atexit
import contextlib
import ctypes
import faulthandler
import io
import logging
import os
import shutil
import signal
import sys
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from types import FrameType
from typing import IO, Any

from .errors import InputError, harmless

# What people, terminals and queues send to end a program; where it is ignored (nohup) it stays so.
ENDING: tuple[int, ...] = (
    signal.SIGINT, signal.SIGTERM, signal.SIGHUP, signal.SIGQUIT,
    signal.SIGUSR1, signal.SIGUSR2, signal.SIGXCPU,
)  # fmt: skip
AGAIN = 0.25  # s
_M_TRIM_THRESHOLD, _M_MMAP_THRESHOLD = -1, -3  # of malloc.h

# Signals that ask this process to end, the first one first; SIGPIPE: nobody reads its output.
came: list[int] = []


# -- signals -----------------------------------------------------------------------------------


def _stop(number: int, _frame: FrameType | None) -> None:
    """Raise KeyboardInterrupt, again and again: it may get lost on its way (in __del__)."""
    if number != signal.SIGALRM:
        came.append(number)
        if len(came) > 1:
            return
        signal.setitimer(signal.ITIMER_REAL, AGAIN, AGAIN)
    if came:
        raise KeyboardInterrupt


def _lost(error: Any) -> None:
    """Tell what is raised where nobody can catch it, but for an interrupt, which comes again."""
    if not issubclass(error.exc_type, KeyboardInterrupt):
        sys.__unraisablehook__(error)


def ignore_signals() -> None:
    """Obey no further signal: the process is about to end."""
    signal.setitimer(signal.ITIMER_REAL, 0.0)
    for number in (*ENDING, signal.SIGALRM):
        with suppress(ValueError):  # not in the main thread
            signal.signal(number, signal.SIG_IGN)


def take_signals() -> None:
    """Have signals obeyed, or ignored, as they were: libraries take some for themselves."""
    for number in (*ENDING, signal.SIGALRM):
        handler = signal.getsignal(number)
        if handler in (_stop, signal.SIG_IGN):
            with suppress(ValueError):  # not in the main thread
                signal.signal(number, handler)


@contextmanager
def obeying_signals(*, to_the_end: bool = False) -> Iterator[None]:
    """Have all signals of ENDING raise KeyboardInterrupt in the block, noted in `came`.

    ``to_the_end``: the process ends after the block, at once when a signal comes then.
    """
    came.clear()
    before: dict[int, Any] = {}
    tell, sys.unraisablehook = sys.unraisablehook, _lost
    try:
        for number in (*ENDING, signal.SIGALRM):
            if signal.getsignal(number) not in (signal.SIG_IGN, None):
                with suppress(ValueError):  # not in the main thread
                    before[number] = signal.signal(number, _stop)
        yield
    finally:
        sys.unraisablehook = tell
        signal.setitimer(signal.ITIMER_REAL, 0.0)
        for number, handler in before.items():
            signal.signal(number, signal.SIG_DFL if to_the_end else handler)


class LogLines(logging.Formatter):
    """Lines of the log; titles and names in them neither end a line nor command a terminal."""

    def format(self, record: logging.LogRecord) -> str:
        """One line."""
        return harmless(super().format(record)).replace("\n", "\\n")


# -- standard streams --------------------------------------------------------------------------


class Output:
    """A standard stream that may fail: what is written then is lost, and the work goes on.

    If nobody reads it any more (``| head``), the work is interrupted.
    """

    def __init__(self, stream: IO[str]):
        self.stream, self.problem = stream, ""
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="backslashreplace")  # letters that a terminal does not have

    def __getattr__(self, name: str) -> Any:
        return getattr(self.stream, name)

    def write(self, text: str) -> int:
        """See io.TextIOBase."""
        try:
            return self.stream.write(text)
        except OSError as error:
            self._fail(error)
        return len(text)

    def flush(self) -> None:
        """See io.TextIOBase."""
        try:
            self.stream.flush()
        except OSError as error:
            self._fail(error)

    def _fail(self, error: OSError) -> None:
        nowhere = os.open(os.devnull, os.O_WRONLY)
        os.dup2(nowhere, self.stream.fileno())  # or Python fails once more as it ends
        os.close(nowhere)
        if self.stream is not sys.__stdout__:
            return
        if isinstance(error, BrokenPipeError):
            came.append(signal.SIGPIPE)
            signal.setitimer(signal.ITIMER_REAL, 1e-6, AGAIN)
        elif not self.problem:
            self.problem = error.strerror or str(error)


def check_output() -> None:
    """Raise InputError if something that was told is lost, KeyboardInterrupt if nobody reads it."""
    sys.stdout.flush()
    if signal.SIGPIPE in came:
        raise KeyboardInterrupt
    problem = getattr(sys.stdout, "problem", "")
    if problem:
        raise InputError(f"standard output could not be written: {problem}; all else is done")


@contextmanager
def standard_streams() -> Iterator[None]:
    """Have standard streams that can be used, whatever the shell has closed or sent them to."""
    before = sys.stdin, sys.stdout, sys.stderr
    for name, mode in (("stdin", "r"), ("stdout", "w"), ("stderr", "w")):
        if getattr(sys, name) is None:
            nowhere = os.open(os.devnull, os.O_RDWR)  # takes the number that was closed
            os.set_inheritable(nowhere, True)
            setattr(sys, name, open(nowhere, mode, closefd=False))  # noqa: SIM115
    sys.stdout, sys.stderr = Output(sys.stdout), Output(sys.stderr)  # type: ignore[assignment]
    try:
        yield
    finally:
        sys.stdin, sys.stdout, sys.stderr = before


# -- surroundings ------------------------------------------------------------------------------


def prepare_surroundings() -> None:
    """Have libraries find what they need; InputError if there is no folder for temporary files."""
    with contextlib.suppress(OSError):  # no stderr of the system's
        faulthandler.enable()  # tells the place of a crash, as PETSc's handlers are left out
    os.environ.setdefault("UCX_DEBUG_SIGNO", "0")  # or SIGHUP makes UCX, below MPI, talk
    os.environ.pop("MPLBACKEND", None)  # a notebook's may not be there, and no window is opened
    try:
        os.environ["TMPDIR"] = tempfile.gettempdir()  # Open MPI crashes where it is missing
    except FileNotFoundError as error:
        raise InputError(f"{error.strerror}: set TMPDIR to a folder that can be written") from None
    keep_freed()


def keep_freed() -> None:
    """Have C's allocator keep for this process what it frees, where that is glibc's.

    Large arrays come and go with every matrix and factor. Given back to the system and asked for
    anew, each page is filled with zeros first: half of a first set-up of the yarn multigrid.
    """
    with contextlib.suppress(OSError, AttributeError):
        mallopt = ctypes.CDLL(None).mallopt
        mallopt(_M_MMAP_THRESHOLD, 32 << 20)  # the largest that it takes
        mallopt(_M_TRIM_THRESHOLD, (1 << 31) - 1)


def spare_cache() -> str:
    """Make a folder for what libraries keep, until the process ends, if there is no other.

    Empty if there is one: ``XDG_CACHE_HOME``, or ``~/.cache``.
    """
    usual = os.environ.get("XDG_CACHE_HOME") or os.path.expanduser("~/.cache")
    try:
        os.makedirs(usual, exist_ok=True)
        tempfile.TemporaryFile(dir=usual).close()
    except OSError:
        spare = tempfile.mkdtemp(prefix="cruciform-petsc-")
        atexit.register(shutil.rmtree, spare, ignore_errors=True)
        return spare
    return ""
