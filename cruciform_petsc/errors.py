# SPDX-License-Identifier: MIT
"""Errors that a user can act on: one sentence each, raised on every rank alike."""


class CruciformError(Exception):
    """A problem that is told in one sentence, without a traceback; the program ends with 2."""


class InputError(CruciformError):
    """Something in the case, the fabric, the outline or the file system is wrong."""


class SolverError(CruciformError):
    """An equation system could not be solved.

    Attributes
    ----------
    reason : str
        PETSc's name of the reason.
    history : list of float
        Residual norms, one per iteration.
    """

    def __init__(self, message: str, reason: str = "", history: list[float] | None = None):
        super().__init__(message)
        self.reason = reason
        self.history = history or []
