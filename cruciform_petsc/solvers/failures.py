# SPDX-License-Identifier: MIT
"""PETSc's errors in words: whose they are, and what may help."""

from __future__ import annotations

import re

from petsc4py import PETSc

from ..errors import CruciformError, InputError, LibraryError, cut

# By PETSc's error codes (petscsystypes.h): what a user asked for, what numbers did, the rest.
_MEMORY, _LIBRARY = 55, 76
_ASKED = {
    **dict.fromkeys((56, 62, 63, 83, 95), "PETSc cannot do what {} ask for"),
    65: "PETSc cannot open a file that {} name",
    66: "PETSc cannot read a file that {} name",
    67: "PETSc cannot write a file that {} name",
    86: "PETSc does not have a type that {} name",
    92: "PETSc does not have a factorisation that {} name",
}
_NUMBERS = {
    71: "a pivot is zero",
    72: "a number is not finite",
    81: "a pivot is zero",
    82: "no convergence",
    91: "no convergence",
}
_MORE = "choose a coarser net (refine, yarns_per_cruciform), a smaller outline or more machines"


def out_of_memory(what: str) -> LibraryError:
    """There is too little memory."""
    return LibraryError(f"there is not enough memory ({what}): {_MORE}", "MEMORY")


def in_words(error: PETSc.Error, prefix: str) -> CruciformError | None:
    """An error of PETSc as one of ours; None if it is likely a fault of this program.

    ``prefix``: of the options of the solver that was called.
    """
    code, words = error.ierr, _last_words(error)
    if code == _MEMORY:
        return out_of_memory("PETSc error 55")
    if code == _LIBRARY:
        return LibraryError(
            f"a library that PETSc calls has failed ({words}): another preconditioner or package "
            "(-cruciform_pc_type, -cruciform_pc_factor_mat_solver_type) may do",
            "LIBRARY",
        )
    if code in _ASKED:
        asked = _ASKED[code].format(f"the options -{prefix}...")
        return InputError(f"{asked} ({words}): correct what is wrong, or leave it out")
    if code in _NUMBERS:
        return LibraryError(f"the linear solver failed: {_NUMBERS[code]} ({words})", "SETUP")
    return None


def _last_words(error: PETSc.Error) -> str:
    """What PETSc says of an error, and its number."""
    lines = getattr(error, "_traceback_", [])
    words = lines[-1] if lines else ""
    words = re.split(r"\. Perhaps|https?:", words)[0]
    words = " ".join(words.split()).rstrip(".:")
    return ", ".join(filter(None, (cut(words, 160), f"PETSc error {error.ierr}")))


def check_factor(pc: PETSc.PC) -> None:
    """Raise LibraryError if a factorisation that was tried had too little memory. Collective."""
    if pc.getFailedReason() == PETSc.PC.FailedReason.FACTOR_OUTMEMORY:
        raise out_of_memory(
            f"for the factor by {pc.getFactorSolverType()}; its room for more than it foresees is "
            "-cruciform_mat_mumps_icntl_14, in per cent"
        )
