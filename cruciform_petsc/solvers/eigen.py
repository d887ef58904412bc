# SPDX-License-Identifier: MIT
"""Extreme eigenvalues of symmetric matrices, by SLEPc, or by subspace iteration where it is not.

All that stability asks for has one form, A v = r S v with A symmetric and S positive definite, of
which the largest r are wanted: S is factored once, and each step solves with it.
"""

from __future__ import annotations

import numpy as np
from petsc4py import PETSc

from ..errors import SolverError
from .failures import check_factor
from .options import COUNTING, PREFIX, petsc_options, set_from_options

EIGEN = f"{PREFIX}eigen_"
TOLERANCE = 1e-9  # relative, of what an eigenvector leaves over
MOST_STEPS = 500
SMALLEST_SHIFT = 1e-10  # of the largest quotient of diagonals
MORE = 8  # vectors besides those wanted, of subspace iteration


class Factor:
    """L D L^T of a symmetric matrix. Collective; the matrix is the caller's.

    Attributes
    ----------
    ksp : PETSc.KSP
        Solves with it.
    negative : int
        Number of the matrix's negative eigenvalues (Sylvester's law of inertia).
    """

    def __init__(self, matrix: PETSc.Mat, prefix: str = EIGEN):
        self.ksp = PETSc.KSP().create(matrix.comm)
        self.ksp.setOptionsPrefix(prefix)
        self.ksp.setOperators(matrix)
        with petsc_options(prefix, COUNTING):
            set_from_options(self.ksp, prefix, COUNTING)
            self.ksp.setUp()
        check_factor(self.ksp.getPC())
        self.negative = int(self.ksp.getPC().getFactorMatrix().getMumpsInfog(12))

    def destroy(self) -> None:
        """Free it."""
        self.ksp.destroy()


def largest(a: PETSc.Mat, s: PETSc.Mat, factor: Factor, count: int) -> tuple[np.ndarray, ...]:
    """Largest r of A v = r S v, S positive definite. Collective.

    Parameters
    ----------
    a, s : PETSc.Mat
        Symmetric.
    factor : Factor
        Of S.
    count : int

    Returns
    -------
    values : float (count,)
        Falling.
    vectors : float (count, n_owned)
        This rank's part of each.

    Raises
    ------
    SolverError
        On every rank.
    """
    count = min(count, s.getSize()[0])
    if a.norm() == 0.0:
        return np.zeros(count), np.zeros((count, s.getLocalSize()[0]))
    try:
        from slepc4py import SLEPc  # type: ignore[import-untyped]
    except ImportError:
        return _by_subspace(a, s, factor, count)
    eps = SLEPc.EPS().create(s.comm)
    eps.setOptionsPrefix(EIGEN)
    eps.setOperators(a, s)
    eps.setProblemType(SLEPc.EPS.ProblemType.GHEP)
    eps.setWhichEigenpairs(SLEPc.EPS.Which.LARGEST_REAL)
    eps.setTolerances(TOLERANCE, MOST_STEPS)
    eps.setDimensions(count)
    eps.getST().setKSP(factor.ksp)
    # The same start on any number of ranks: what converges then does so alike.
    start = s.createVecRight()
    begin, end = start.getOwnershipRange()
    start.setArray(1.0 + np.sin(np.arange(begin, end)))
    eps.setInitialSpace([start])
    eps.setFromOptions()
    eps.solve()
    found = eps.getConverged()
    values, vectors = [], []
    for i in range(min(found, count)):
        values.append(eps.getEigenpair(i, start).real)
        vectors.append(start.getArray().copy())
    eps.destroy()
    start.destroy()
    if len(values) < count:
        raise SolverError(f"{len(values)} of {count} eigenvalues were found", "EIGENVALUES", [])
    return np.array(values), np.array(vectors)


def _by_subspace(a: PETSc.Mat, s: PETSc.Mat, factor: Factor, count: int) -> tuple[np.ndarray, ...]:
    """The same by subspace iteration (Bathe 1971) with the operator S^-1 A + shift. Collective.

    It finds what is largest in size: the shift takes ratios below zero out of the way.
    """
    comm, size = s.comm.tompi4py(), s.getSize()[0]
    x, y = s.createVecRight(), s.createVecRight()
    begin, end = x.getOwnershipRange()
    number = np.arange(begin, end)
    block = np.sin(np.outer(1.0 + np.arange(min(size, 2 * count + MORE)), 1.0 + number))

    def times(matrix: PETSc.Mat, rows: np.ndarray) -> np.ndarray:
        product = np.empty_like(rows)
        for row, into in zip(rows, product, strict=True):
            x.setArray(row)
            matrix.mult(x, y)
            into[:] = y.getArray(readonly=True)
        return product

    def solved(rows: np.ndarray) -> np.ndarray:
        answer = np.empty_like(rows)
        for row, into in zip(rows, answer, strict=True):
            x.setArray(row)
            factor.ksp.solve(x, y)
            into[:] = y.getArray(readonly=True)
        return answer

    values: np.ndarray = np.zeros(count)
    shift = 0.0
    for _ in range(MOST_STEPS):
        block = solved(times(a, block)) + shift * block
        block /= np.sqrt(comm.allreduce((block**2).sum(axis=1)))[:, None]
        of_a, of_s = (comm.allreduce(block @ times(m, block).T) for m in (a, s))
        # Vectors that have become the same ones are left out.
        size_s, basis = np.linalg.eigh(0.5 * (of_s + of_s.T))
        kept = basis[:, size_s > 1e-12 * size_s[-1]] / np.sqrt(size_s[size_s > 1e-12 * size_s[-1]])
        ratios, mixed = np.linalg.eigh(kept.T @ (0.5 * (of_a + of_a.T)) @ kept)
        block = (kept @ mixed).T @ block
        shift = max(shift, -float(ratios[0]))
        before, values = values, ratios[::-1][:count]
        if len(values) == count and (abs(values - before) <= TOLERANCE * abs(values)).all():
            x.destroy()
            y.destroy()
            return values, block[::-1][:count]
        if len(block) < count + MORE:  # in place of those left out
            fresh = np.sin(np.outer(1.5 + np.arange(count + MORE), 2.0 + number))
            block = np.concatenate([block, fresh[len(block) :]])
    raise SolverError("subspace iteration found no eigenvalues", "EIGENVALUES", [])


def lowest(k: PETSc.Mat, mass: PETSc.Vec, count: int) -> tuple[np.ndarray, np.ndarray]:
    """Lowest eigenvalues m of K v = m M v, M diagonal and positive. Collective.

    K, which may be indefinite, is shifted until it is positive definite.

    Returns
    -------
    values : float (count,)
        Rising.
    vectors : float (count, n_owned)
    """
    diagonal, weights = k.createVecRight(), k.duplicate(copy=False)
    weights.zeroEntries()
    weights.setDiagonal(mass)
    k.getDiagonal(diagonal)
    diagonal.abs()
    diagonal.pointwiseDivide(diagonal, mass)
    shift, added = SMALLEST_SHIFT * diagonal.max()[1], 0.0
    shifted = k.copy()
    try:
        while True:
            diagonal.axpby(shift - added, 0.0, mass)
            shifted.setDiagonal(diagonal, PETSc.InsertMode.ADD_VALUES)
            shifted.assemble()
            added = shift
            factor = Factor(shifted)
            if factor.negative == 0:
                break
            factor.destroy()
            shift *= 16.0
        values, vectors = largest(weights, shifted, factor, count)
        factor.destroy()
    finally:
        for thing in (diagonal, weights, shifted):
            thing.destroy()
    return 1.0 / values - added, vectors
