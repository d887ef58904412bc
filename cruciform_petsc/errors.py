# SPDX-License-Identifier: MIT
"""Errors that a user can act on: one sentence each, raised on every rank alike."""

import os
import re
import shlex
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from difflib import get_close_matches
from typing import Any

# What a terminal obeys, or does not show: control characters but for tab and line feed, ends of
# line of Unicode, changes of the direction of writing, halves of characters (of file names that
# are not UTF-8).
_COMMANDS = re.compile(
    "[\0-\b\v-\x1f\x7f-\x9f\xad\u061c\u200b\u200e\u200f\u2028-\u202e\u2060-\u206f\ud800-\udfff\ufeff]"
)


def harmless(text: str) -> str:
    r"""A text with what a terminal would obey written out.

    >>> harmless("red \x1b[31m")
    'red \\x1b[31m'
    """
    return _COMMANDS.sub(lambda match: match[0].encode("unicode_escape").decode(), text)


class CruciformError(Exception):
    """A problem that is told in one sentence, without a traceback; the program ends with 2."""

    def __str__(self) -> str:
        """The sentence; what it quotes does nothing to a terminal."""
        return harmless(super().__str__())


class InputError(CruciformError):
    """Something in the case, the fabric, the outline or the file system is wrong.

    ``args`` are the problems, if there are several: one sentence each, lines of the message.
    """

    def __str__(self) -> str:
        return "\n".join(harmless(" ".join(str(problem).splitlines())) for problem in self.args)


class Problems(list[str]):
    """Sentences about input, gathered so that all of them are told at once."""

    @contextmanager
    def caught(self) -> Iterator[None]:
        """Add the problems of an InputError raised inside."""
        try:
            yield
        except InputError as error:
            self.extend(map(str, error.args))

    def tell(self) -> None:
        """Raise them, each once, as one InputError if there are any."""
        if self:
            raise InputError(*dict.fromkeys(self))


class InputWarning(UserWarning):
    """Something in the fabric, the outline or the test is hardly meant, but can be."""


class SolverError(CruciformError):
    """An equation system could not be solved: PETSc's `reason`, residual norms by iteration."""

    def __init__(self, message: str, reason: str = "", history: list[float] | None = None):
        super().__init__(message)
        self.reason = reason
        self.history = history or []


class LibraryError(SolverError):
    """PETSc, or a library that it calls, gave up for want of memory or the like.

    What was solved may well have a solution, but the solver cannot go on: no smaller step is tried.
    """


class EquilibriumError(SolverError):
    """No equilibrium was found.

    ``place``, float (dim,) or None: where the forces are farthest from balance, at rest, m;
    ``count``: at how many nodes they are by a tenth of that, or more, 0 if that is not known;
    ``result``, a TestResult, Formed or None: what an experiment had reached.
    """

    def __init__(self, message, reason, history, place=None, count=0):
        super().__init__(message, reason, history)
        self.place, self.count = place, count
        self.result: Any = None


def typed_before() -> str:
    """What stands before commands that a message proposes: "scripts/fenicsx " as it was typed."""
    by = os.environ.get("CRUCIFORM_PETSC_BY", "")
    return f"{shlex.quote(by)} " if by else ""


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
    """There is no such thing; what begins so or is closest of those that there are, and all."""
    known = list(known)
    begun = [one for one in known if str(name) and one.startswith(str(name))]
    close = begun or get_close_matches(str(name), known, 1, 0.5)
    hint = f'did you mean "{close[0]}"? ' if close else ""
    quoted = ", ".join(f'"{one}"' for one in known)
    return InputError(f"there is no {what} ({hint}known: {quoted})")
