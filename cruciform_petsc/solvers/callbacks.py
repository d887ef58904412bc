# SPDX-License-Identifier: MIT
"""Python that PETSc calls back: what it raises comes out whole, and signals wait for it.

An exception on its way through PETSc's C code comes out as PETSc.Error -1, without kind or words.
So callbacks note what they raise. They could not note what the handler of a signal raises
(KeyboardInterrupt), as that may be before their first line: while PETSc runs handlers wait, and the
next callback, or the end of the call, lets them do what they do.
"""

from __future__ import annotations

import gc
import signal
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import wraps
from typing import Any

from petsc4py import PETSc

from ..parallel import end_unless_all
from .failures import in_words

_noted: list[BaseException] = []  # by callbacks, the first one first
_came: list[int] = []  # signals that wait
_handlers: dict[int, Callable] = {}  # what they wait for
_waiting = False


def callback(function: Callable) -> Callable:
    """Make a function one that PETSc calls, within `calling_back`."""

    @wraps(function)
    def noting(*arguments: Any) -> Any:
        try:
            _obey()
            return function(*arguments)
        except BaseException as error:
            # Collected garbage may call Python, which crashes with an error pending in PETSc's C.
            gc.disable()
            _noted.append(error)
            raise

    return noting


@contextmanager
def calling_back(solver: PETSc.Object) -> Iterator[None]:
    """Call PETSc, and raise what a callback has raised in place of PETSc's word of it.

    On the rank where it was raised; others may be left within PETSc. An error of PETSc's own is one
    of ours (see failures.in_words) on all ranks, or, if some do not come, the end of all. After an
    error the solver is never freed, whoever destroys it: PCMG, for one, takes vectors for its own
    while it is applied.
    """
    _noted.clear()
    with _signals_wait():
        try:
            yield
        except PETSc.Error as raised:
            solver.incRef()
            error = _noted[0] if _noted else raised
            _noted.clear()
            if isinstance(error, PETSc.Error):
                ours = in_words(error, solver.getOptionsPrefix() or "") or error
                end_unless_all(solver.comm.tompi4py(), str(ours))
                error = ours
            raise error from None
        finally:
            gc.enable()


@contextmanager
def _signals_wait() -> Iterator[None]:
    global _waiting
    if _waiting or threading.current_thread() is not threading.main_thread():
        yield
        return
    try:
        _waiting = True
        for each in signal.valid_signals():
            handler = signal.getsignal(each)
            if callable(handler) and handler is not _wait:
                _handlers[each] = handler
                signal.signal(each, _wait)
        yield
    finally:
        _waiting = False
        _obey()  # should it raise, _wait stays and does what the handlers do
        for number, handler in _handlers.items():
            signal.signal(number, handler)


def _wait(number: int, frame: Any) -> None:
    if _waiting:
        _came.append(number)
    else:
        _handlers[number](number, frame)


def _obey() -> None:
    while _came:
        number = _came.pop(0)
        _handlers[number](number, None)
