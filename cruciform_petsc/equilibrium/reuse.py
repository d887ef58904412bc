# SPDX-License-Identifier: MIT
"""Steps with the factor of a tangent nearby, which cost a tenth of one with a factor of its own."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from petsc4py import PETSc

from .mending import is_definite

NEAR = 100.0  # times the tolerance: with larger residuals most such steps help little
# Newton's last step ends far below the tolerance, these just below where they may: then forces of
# a hemisphere differ by 0.3 % from those with tighter tolerances.
FINER = 0.1  # of the tolerance
MOST = 10  # with one factor
HALF = 0.5  # what a step has to leave of the residual at most, for another one to follow


def is_reusable(ksp: PETSc.KSP) -> bool:
    """Whether it has the factor of a definite matrix, as an iterative solver has not."""
    return ksp.getType() == "preonly" and is_definite(ksp)


def go_on(
    ksp: PETSc.KSP,
    at: Callable[[PETSc.Vec], tuple[float, np.ndarray]],
    vector: PETSc.Vec,
    tolerance: float,
    near: float,
    longest: float,
    noise: float,
) -> int:
    """Improve a vector near equilibrium with the factor at hand, as long as that helps. Collective.

    The chord method (Kelley 1995, Iterative Methods for Linear and Nonlinear Equations, section
    5.4). A step is taken if the residual falls and the energy does not rise. Returns how many
    were taken.

    Parameters
    ----------
    ksp : PETSc.KSP
        Its operator is that of its factor, and definite.
    at : callable
        Vector -> energy, and this rank's part of its gradient.
    vector : PETSc.Vec
        Changed in place.
    tolerance, near : float
        Residuals at which to stop, and up to which it is tried.
    longest : float
        Steps with larger entries are not taken.
    noise : float
        Energies that differ by less are the same.
    """
    gradient, step, trial = vector.duplicate(), vector.duplicate(), vector.duplicate()
    energy, values = at(vector)
    gradient.setArray(values)
    residual, before = gradient.norm(), np.inf
    taken = 0
    while taken < MOST:
        if not tolerance < residual <= min(near, HALF * before):
            break
        ksp.solve(gradient, step)
        slope = gradient.dot(step)
        if not (slope > 0.0 and step.norm(PETSc.NormType.INFINITY) <= longest):
            break
        trial.waxpy(-1.0, step, vector)
        there, values = at(trial)
        gradient.setArray(values)
        before, residual = residual, gradient.norm()
        if not (there <= energy + noise and residual < before):
            break
        trial.copy(vector)
        energy, taken = there, taken + 1
    for each in (gradient, step, trial):
        each.destroy()
    return taken
