# SPDX-License-Identifier: MIT
"""Extreme eigenvalues against LAPACK, by SLEPc and by what stands in for it."""

import sys

import numpy as np
import pytest
from petsc4py import PETSc
from scipy.linalg import eigh

from cruciform_petsc.solvers.eigen import Factor, largest, lowest

SIZE = 60
RANDOM = np.random.default_rng(3)


@pytest.fixture(params=["slepc", "subspace"])
def backend(request, monkeypatch):
    if request.param == "subspace":
        monkeypatch.setitem(sys.modules, "slepc4py", None)
    else:
        pytest.importorskip("slepc4py")


def matrix(dense):
    """A sparse matrix with room for what a dense one has."""
    made = PETSc.Mat().createAIJ(dense.shape, nnz=len(dense), comm=PETSc.COMM_SELF)
    for i, row in enumerate(dense):
        made.setValues(i, np.arange(len(row), dtype=PETSc.IntType), row)
    made.assemble()
    return made


def symmetric(values):
    """A matrix with these eigenvalues."""
    vectors, _ = np.linalg.qr(RANDOM.standard_normal((len(values), len(values))))
    return vectors * values @ vectors.T


@pytest.mark.parametrize("low", [0.5, -3.0, -1e4])
def test_lowest(backend, low):
    """Of a matrix with one, or many, negative eigenvalues, too; three of them are one."""
    dense = symmetric(np.concatenate([[low, low + 0.25, 2.0, 2.0, 2.0], np.linspace(3, 1e5, 55)]))
    mass = RANDOM.uniform(0.5, 2.0, SIZE)
    wanted = eigh(dense, np.diag(mass), eigvals_only=True)[:4]
    stiffness = matrix(dense)
    values, vectors = lowest(stiffness, PETSc.Vec().createWithArray(mass), 4)
    # As well as 1e-9 of the shift is, which goes to less than 16 times the lowest one.
    np.testing.assert_allclose(values, wanted, rtol=1e-7, atol=1e-7 + 1.6e-8 * abs(low))
    left = dense @ vectors.T - values * (mass[:, None] * vectors.T)
    assert (np.linalg.norm(left, axis=0) < 1e-4 * 1e5 * np.linalg.norm(vectors, axis=1)).all()
    # It is not changed.
    np.testing.assert_array_equal(stiffness.getValues(range(SIZE), range(SIZE)), dense)


def test_largest(backend):
    """Ratios of both signs, as for a panel that shear of either sign makes buckle."""
    a = symmetric(np.concatenate([[-5.0, -4.9, 4.9, 5.0], np.linspace(-1, 1, SIZE - 4)]))
    s = symmetric(np.linspace(1.0, 3.0, SIZE))
    wanted = eigh(a, s, eigvals_only=True)[::-1][:3]
    divided = matrix(s)
    factor = Factor(divided)
    assert factor.negative == 0
    values, _ = largest(matrix(a), divided, factor, 3)
    factor.destroy()
    np.testing.assert_allclose(values, wanted, rtol=1e-7)


def test_largest_beside_many_of_the_other_sign(backend):
    """As for cloth that stiffens in nearly all ways and softens in a few."""
    a = symmetric(np.concatenate([np.linspace(-50.0, -10.0, SIZE - 4), [1.0, 2.0, 3.5, 5.0]]))
    s = symmetric(np.linspace(1.0, 3.0, SIZE))
    wanted = eigh(a, s, eigvals_only=True)[::-1][:3]
    divided = matrix(s)
    factor = Factor(divided)
    values, _ = largest(matrix(a), divided, factor, 3)
    factor.destroy()
    np.testing.assert_allclose(values, wanted, rtol=1e-6)


def test_of_nothing(backend):
    """No ratio but zero."""
    s = matrix(symmetric(np.linspace(1.0, 3.0, SIZE)))
    nothing = s.duplicate()
    nothing.zeroEntries()
    factor = Factor(s)
    values, vectors = largest(nothing, s, factor, 3)
    factor.destroy()
    assert (values == 0.0).all()
    assert vectors.shape == (3, SIZE)


def test_negative_eigenvalues_are_counted():
    """Sylvester's law of inertia."""
    factor = Factor(matrix(symmetric(np.linspace(-7.5, 52.5, SIZE + 1)[:SIZE])))
    assert factor.negative == 8
    factor.destroy()
