# SPDX-License-Identifier: MIT
"""Splines on lattices: what they reproduce, and which unknowns a strip takes."""

import numpy as np
from mpi4py import MPI
from petsc4py import PETSc

from cruciform_petsc.solvers.splines import Points, interpolation, strips


def points(place, owner=lambda ij: np.zeros(len(ij), int)):
    """Points on one lattice, and a body, all with unknowns along the axes."""
    place = np.vstack([np.asarray(place, float), [[0.0, 0.0]]])
    lattice = np.append(np.zeros(len(place) - 1, int), -1)
    return Points([owner], lattice, place, np.tile(np.eye(3), (len(place), 1, 1)))


def test_splines_reproduce_what_is_linear():
    """Of spline centres' places the points' places; at offsets that no rounding makes exact."""
    rng = np.random.default_rng(3)
    fine = points(rng.uniform(-7.0, 9.0, (40, 2)))
    free = np.ones((41, 3), bool)
    free[5, 1] = False
    matrix, coarse = interpolation(MPI.COMM_SELF, fine, free, 2)
    x, y = matrix.createVecs()
    for field in (lambda p: 0.0 * p[:, 0] + 1.0, lambda p: p[:, 0] - 3.0 * p[:, 1]):
        values = np.where(coarse.lattice < 0, 7.0, field(coarse.place))
        x.setArray(np.repeat(values, 3))
        matrix.mult(x, y)
        expected = np.where(fine.lattice < 0, 7.0, field(fine.place))[:, None] * free
        np.testing.assert_allclose(y.getArray().reshape(-1, 3), expected, atol=1e-13)
    # Slopes are continuous: across a line between splines they jump by what a step of 1e-4 makes.
    line = np.linspace(0.9, 1.1, 2001)
    matrix, coarse = interpolation(
        MPI.COMM_SELF, points(np.column_stack([line, 0 * line])), np.ones((2002, 3), bool), 2
    )
    x, y = matrix.createVecs()
    x.setArray(rng.standard_normal(3 * len(coarse.place)))
    matrix.mult(x, y)
    slope = np.diff(y.getArray()[:-3:3]) / 1e-4
    assert abs(np.diff(slope)).max() < 1e-3 * abs(slope).max()


def test_strips_take_two_yarns_and_what_lies_between():
    """Hinges lie in two strips of each family, ends between them in two of one; bodies alone."""
    ij = np.stack(np.meshgrid(np.arange(4.0), np.arange(5.0), indexing="ij"), -1).reshape(-1, 2)
    fine = points(np.concatenate([ij, ij + np.array([0.5, 0.0]), ij + np.array([0.0, 0.5])]))
    rows = 3 * len(fine.place)
    matrix = PETSc.Mat().createAIJ((rows, rows), nnz=1, bsize=3, comm=MPI.COMM_SELF)
    matrix.setUp()
    matrix.assemble()
    found = [part.getIndices() for part in strips(matrix, fine, 1)]
    inside = np.zeros(rows, int)
    for part in found:
        assert (np.diff(part) > 0).all()
        inside[part] += 1
        place = fine.place[part // 3]
        spread = np.ptp(place, axis=0).min()
        assert spread <= 1.0
    count = inside[::3]
    hinge = (fine.place[:-1] % 1 == 0).all(axis=1)
    assert set(count[:-1][hinge]) == {4}
    assert set(count[:-1][~hinge]) == {3}
    assert count[-1] == 1
    # Of five and of four yarns, the outermost with what lies beyond them.
    assert len(found) == 6 + 5 + 1
