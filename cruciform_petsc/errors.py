# SPDX-License-Identifier: MIT
"""Errors that a user can act on: one sentence each, raised on every rank alike."""

from collections.abc import Iterable
from difflib import get_close_matches
from typing import Any


class CruciformError(Exception):
    """A problem that is told in one sentence, without a traceback; the program ends with 2."""


class InputError(CruciformError):
    """Something in the case, the fabric, the outline or the file system is wrong."""


class SolverError(CruciformError):
    """An equation system could not be solved: PETSc's `reason`, residual norms by iteration."""

    def __init__(self, message: str, reason: str = "", history: list[float] | None = None):
        super().__init__(message)
        self.reason = reason
        self.history = history or []


class EquilibriumError(SolverError):
    """No equilibrium was found.

    ``place``, float (dim,) or None: where the forces are farthest from balance, at rest, m;
    ``result``, a TestResult or None: what an experiment had reached.
    """

    def __init__(self, message, reason, history, place=None):
        super().__init__(message, reason, history)
        self.place = place
        self.result: Any = None


class CruciformWarning(UserWarning):
    """What should be known before a result is trusted, where no log tells it."""


def cut(text: str, most: int = 80) -> str:
    """The beginning of a text that is too long for a message."""
    return text if len(text) <= most else f"{text[: most - 3]}..."


def shown(value: object, most: int = 80) -> str:
    """What was given, for a message, or the beginning of it."""
    try:
        return cut(repr(value), most)
    except ValueError:  # Python does not write whole numbers of thousands of digits
        return "a number of thousands of digits"


def unknown(what: str, name: object, known: Iterable[str]) -> InputError:
    """There is no such thing; the closest of those that there are, and all of them."""
    known = list(known)
    close = get_close_matches(str(name), known, 1, 0.5)
    hint = f'did you mean "{close[0]}"? ' if close else ""
    quoted = ", ".join(f'"{one}"' for one in known)
    return InputError(f"there is no {what} ({hint}known: {quoted})")
