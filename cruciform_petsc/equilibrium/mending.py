# SPDX-License-Identifier: MIT
"""What is done where a tangent is indefinite, or its step does not lead downhill."""

from __future__ import annotations

import numpy as np
from petsc4py import PETSc

FIRST_SHIFT, LAST_SHIFT = 1e-7, 1e2  # of the diagonal
# Of what did last time is tried first. Wrinkled hemispheres of 24 and 20 yarns took 473 and 520
# factorisations with a tenth, 417 and 413 with a quarter, 410 and 315 with a half.
AGAIN = 0.5


def is_definite(ksp: PETSc.KSP) -> bool:
    """Whether the tangent last solved with had no negative eigenvalue, as far as is known."""
    if ksp.getConvergedReason() < 0:
        return False
    pc = ksp.getPC()
    if pc.getType() != "cholesky" or pc.getFactorSolverType() != "mumps":
        return True
    return pc.getFactorMatrix().getMumpsInfog(12) == 0  # negative pivots


class Mending:
    """A multiple of the diagonal that is added to tangents; neighbours need about the same.

    Attributes
    ----------
    shift : float
        What did last, of the diagonal.
    tries : int
        Factorisations that it took so far.
    """

    def __init__(self) -> None:
        self.shift, self.tries = FIRST_SHIFT, 0

    def mend(
        self, ksp: PETSc.KSP, matrix: PETSc.Mat, gradient: PETSc.Vec, step: PETSc.Vec
    ) -> float:
        """Solve with a multiple of the diagonal added, as small as will do. Collective.

        The step is what is to be subtracted; returns by how much the energy falls along it. The
        matrix is left with what was added.
        """
        diagonal = matrix.getDiagonal()
        diagonal.abs()
        floor = 1e-3 * diagonal.max()[1]
        owned = diagonal.getArray()
        np.maximum(owned, floor, out=owned)
        shift, added = max(FIRST_SHIFT, AGAIN * self.shift), 0.0
        scaled = diagonal.duplicate()
        while shift <= LAST_SHIFT:
            scaled.axpby(shift - added, 0.0, diagonal)
            matrix.setDiagonal(scaled, PETSc.InsertMode.ADD_VALUES)
            added = shift
            ksp.setOperators(matrix)
            ksp.solve(gradient, step)
            self.tries += 1
            slope = gradient.dot(step)
            if slope > 0.0 and is_definite(ksp):
                self.shift = shift
                break
            shift *= 4.0
        else:  # steepest descent in the measure of the diagonal
            step.pointwiseDivide(gradient, diagonal)
            slope = gradient.dot(step)
        scaled.destroy()
        diagonal.destroy()
        return slope
