# SPDX-License-Identifier: MIT
"""Settings of PETSc's solvers, and the options database that overrules them."""

from __future__ import annotations

import ctypes
import re
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
from mpi4py import MPI
from petsc4py import PETSc

from ..errors import CruciformError, InputError
from ..parallel import end_unless_all
from .failures import in_words
from .settings import closest, setting_of

PREFIX, MEMBRANE = "cruciform_", "membrane_"
# Up to here a sparse Cholesky factorisation is the default: planar graphs fill in little, and it
# finds mechanisms, which an iteration cannot. At 363,000 unknowns it takes 2.4 times as long as the
# yarn multigrid (1.6 s, with OpenBLAS) and half a GiB; no general iteration is faster.
DIRECT_LIMIT = 400_000
# In space iterations take far longer; a factor of 521,000 unknowns is 2.1 GiB (docs/benchmarks.md).
DIRECT_LIMIT_IN_SPACE = 1_000_000

DIRECT = {
    "ksp_type": "preonly",
    "pc_type": "cholesky",
    "pc_factor_mat_solver_type": "mumps",
}
# Of an indefinite matrix: LDL^T, whose negative pivots tell.
COUNTING = DIRECT | {
    "mat_mumps_icntl_13": 1,  # no ScaLAPACK at the root: it would not count negative pivots
    "mat_mumps_icntl_14": 100,  # small systems on several ranks need more room than is foreseen
}
ITERATIVE = {
    "ksp_type": "cg",
    "ksp_rtol": 1e-9,
    "ksp_max_it": 2000,
    "ksp_norm_type": "unpreconditioned",
    "pc_type": "gamg",
    # Smoothers for GAMG and for the yarn multigrid: stiff yarns (E/G of hundreds and more) need
    # more than Jacobi, and the ordering by yarn makes ICC a good one.
    "mg_levels_ksp_type": "chebyshev",
    "mg_levels_ksp_max_it": 2,
    "mg_levels_pc_type": "bjacobi",
    "mg_levels_sub_pc_type": "icc",
    "mg_levels_sub_pc_factor_shift_type": "positive_definite",
}
STEPS, CYCLE = "mg_levels_ksp_max_it", "pc_mg_cycle_type"
YARN_MULTIGRID = {key: value for key, value in ITERATIVE.items() if key != STEPS} | {
    "pc_type": "mg",
    # Chebyshev's bound on the coarse levels, which takes but one or two steps between ranks: CG
    # finds it in five steps to a tenth, which PETSc adds.
    "mg_levels_esteig_ksp_max_it": 5,
    "mg_coarse_ksp_type": "preonly",
    "mg_coarse_pc_type": "cholesky",
    "mg_coarse_pc_factor_mat_solver_type": "mumps",
    # Room for MUMPS' work arrays, per cent: in parallel it sometimes needs more than it foresees.
    "mg_coarse_mat_mumps_icntl_14": 300,
}
# What the paper's separate systems need: singular matrices and loads that they cannot carry whole.
# LSQR from zero gives the solution of least squares with the smallest norm.
LEAST_NORM = {
    "ksp_type": "lsqr",
    "ksp_rtol": 1e-10,
    "ksp_max_it": 100_000,
    "pc_type": "none",
}
_TOLD = r"(?:view|monitor|monitor_true_residual|converged_reason)$"  # what PETSc is to tell
_PETSC = ctypes.CDLL(PETSc.__file__)  # for what petsc4py does not have before 3.23
_used: set[str] = set()  # options that PETSc has asked for, of those that were there for a while
_KINDS = {  # of what a type is an option, and one that every PETSc has
    "snes_type": (PETSc.SNES, "newtonls"),
    "ksp_type": (PETSc.KSP, "cg"),
    "pc_type": (PETSc.PC, "cholesky"),
}


@contextmanager
def petsc_options(prefix: str, options: Mapping[str, object]) -> Iterator[None]:
    """Options under a prefix for a while; what the user has set on the command line wins."""
    database = PETSc.Options()
    there = database.getAll()  # hasName would note that they are asked for
    names = {f"{prefix}{name}": value for name, value in options.items()}
    names = {name: value for name, value in names.items() if name not in there}
    for name, value in names.items():
        if value is not False or not re.search(_TOLD, name):
            # True is an option without a value: where to, for what PETSc is to tell.
            database[name] = "" if value is True else value
    try:
        yield
    finally:
        for name in names:
            if _is_used(name):
                _used.add(name)
            database.delValue(name)


def _is_used(name: str) -> bool:
    """Whether PETSc has asked for an option of the database since it was put there."""
    used = ctypes.c_int()
    _PETSC.PetscOptionsUsed(None, name.encode(), ctypes.byref(used))
    return bool(used.value)


def unused_options(comm: MPI.Intracomm, options: Mapping[str, object]) -> list[str]:
    """Sentences about options that no solver has asked for so far: slips, mostly. Collective.

    Of `options`, as they were given to solvers under PREFIX, and of the whole options database,
    names under our prefixes, and those that would be known there.
    """
    names = {PREFIX + name for name, value in options.items() if value is not False} - _used
    for name in PETSc.Options().getAll():
        ours = name.startswith((PREFIX, MEMBRANE))
        if (ours or setting_of(name) is not None) and not _is_used(name):
            names.add(name)
    sentences = []
    for name in sorted(set.intersection(*comm.allgather(names))):
        prefix = next((p for p in (PREFIX, MEMBRANE) if name.startswith(p)), "")
        near = closest(name.removeprefix(prefix))
        if (near and prefix + near not in (name, "")) or not prefix:
            hint = f'did you mean "-{prefix or PREFIX}{near}"?'
        else:
            hint = "no solver in use asks for it"
        sentences.append(f'the PETSc option "-{name}" was not used: {hint}')
    return sentences


def set_from_options(
    solver: PETSc.KSP | PETSc.SNES, prefix: str, options: Mapping[str, object]
) -> None:
    """Set a solver up from the options database, in which the options are by now. Collective.

    Raises InputError on every rank if PETSc does not know a type, or does not understand a value.
    """
    problem = None
    try:
        solver.setFromOptions()
    except PETSc.Error as error:
        problem = _refusal(solver, prefix, options, error)
    comm = solver.comm.tompi4py()
    end_unless_all(comm, str(problem or ""))  # files are opened, or not, by rank 0 alone
    for error_there in comm.allgather(problem):
        if error_there is not None:
            raise error_there


def _refusal(
    solver: PETSc.KSP | PETSc.SNES, prefix: str, options: Mapping[str, object], error: PETSc.Error
) -> CruciformError:
    """What is told of an error of PETSc while it reads options."""
    database = PETSc.Options(prefix)
    source = "solver.options or the command line" if prefix == PREFIX else "the command line"
    for name, (kind, known) in _KINDS.items():
        value = database.getString(name, str(options.get(name, "")))
        if not value or (kind is PETSc.SNES and not isinstance(solver, PETSc.SNES)):
            continue
        probe = kind().create(PETSc.COMM_SELF)
        try:
            probe.setType(value)
        except PETSc.Error:
            return InputError(
                f"-{prefix}{name} (from {source}) is '{value}', which this PETSc does not have: "
                f"'{known}' would do"
            )
        finally:
            probe.destroy()
    return in_words(error, prefix) or InputError(
        f"PETSc does not accept one of the options -{prefix}... (PETSc error {error.ierr})"
    )


def reason_name(reason: int, kind: Any = PETSc.KSP) -> str:
    """PETSc's name of the reason why a KSP (or SNES) has converged or not."""
    for name, value in vars(kind.ConvergedReason).items():
        if value == reason and name.isupper() and name not in ("ITERATING", "CONVERGED_ITERATING"):
            return name
    return str(reason)


def near_null_space(columns: np.ndarray, comm) -> PETSc.NullSpace:
    """Space of motions that cost (nearly) no energy, for algebraic multigrid. Collective.

    columns : float (n_owned_unknowns, m), of any size; the caller destroys the space.
    """
    scaled = columns / np.sqrt(comm.allreduce((columns**2).sum(axis=0)))
    gram = comm.allreduce(scaled.T @ scaled)
    orthonormal = np.linalg.solve(np.linalg.cholesky(gram), scaled.T)
    vectors = [PETSc.Vec().createWithArray(row.copy(), comm=comm) for row in orthonormal]
    space = PETSc.NullSpace().create(vectors=vectors, comm=comm)
    for vector in vectors:
        vector.destroy()
    return space


def blas_in_use() -> str:
    """The BLAS that this process has loaded, as "openblas 0.3.29"; the direct solvers' speed.

    "reference BLAS" where a plain libblas is all there is; "unknown" where no one tells.
    """
    try:
        loaded = Path("/proc/self/maps").read_text()
    except OSError:
        return "unknown"
    for pattern, name in (
        (r"/lib(openblas)[\w-]*?-?r?([\d.]*)\.so", "{} {}"),
        (r"/lib(mkl|blis|atlas|nvpl_blas|flexiblas)[\w-]*\.so", "{}"),
        (r"/libblas\.so", "reference BLAS"),
    ):
        found = re.search(pattern, loaded)
        if found:
            return name.format(*found.groups()).strip()
    return "unknown"
