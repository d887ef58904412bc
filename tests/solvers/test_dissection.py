# SPDX-License-Identifier: MIT
"""Orderings of nets for MUMPS: what separates a net, where it goes, and what it saves."""

import ctypes

import numpy as np
import pytest
from petsc4py import PETSc
from support.formed import hemisphere

from cruciform_petsc.equilibrium import tangents
from cruciform_petsc.equilibrium.newton import Equilibrium
from cruciform_petsc.solvers import dissection


def grid(n):
    """Places and compressed rows of n x n nodes with their eight neighbours, and one of all."""
    x, y = (axis.ravel() for axis in np.mgrid[:n, :n])
    near = np.maximum(abs(x[:, None] - x), abs(y[:, None] - y)) <= 1
    near = np.pad(near, (0, 1), constant_values=True)
    place = np.pad(np.stack([x, y], axis=1).astype(float), ((0, 1), (0, 0)))
    rows, columns = np.nonzero(near)
    return place, np.searchsorted(rows, np.arange(len(place) + 1)), columns


def test_halves_do_not_touch():
    """Last goes the node that all touch, before it a line, before that two separate halves."""
    n = 30
    place, start, column = grid(n)
    number = dissection.dissected(place, start, column)
    assert np.array_equal(np.sort(number), np.arange(n * n + 1))
    assert number[-1] == n * n
    line = np.argsort(number)[-1 - n : -1]
    assert len(set(place[line, 0])) == 1
    assert place[line[0], 0] in (n // 2 - 1, n // 2)
    at = place[line[0], 0]
    low, high = number[:-1][place[:-1, 0] < at], number[:-1][place[:-1, 0] > at]
    assert low.max() < high.min() or high.max() < low.min()


def test_nodes_in_one_place():
    """They are not cut, and all are there; as is a net of none."""
    every = np.ones((20, 20), bool)
    start, column = 20 * np.arange(21), np.nonzero(every)[1]
    number = dissection.dissected(np.zeros((20, 3)), start, column)
    assert np.array_equal(np.sort(number), np.arange(20))
    assert len(dissection.dissected(np.zeros((0, 3)), np.zeros(1, int), np.zeros(0, int))) == 0


def known():
    """Whether this MUMPS is the one whose struct is known."""
    try:
        ctypes.CDLL("libdmumps-5.7.so")
    except OSError:
        return False
    return True


def answer(monkeypatch, smallest, **options):
    """Of a hemisphere's cloth to a push on the punch, and what MUMPS says of its factor."""
    monkeypatch.setattr(tangents, "SMALLEST", smallest)
    blank, _ = hemisphere()
    start = blank.start()
    change = np.zeros_like(start.x)
    change[blank.tool_node[2], 2] = -1e-4
    equilibrium = Equilibrium(blank.model, start, options)
    try:
        moved, _ = equilibrium.tangent_step(start, change)
        again, _ = equilibrium.tangent_step(start, change)
        np.testing.assert_array_equal(moved, again)
        factor = equilibrium.snes.ksp.getPC().getFactorMatrix()
        return moved, [factor.getMumpsInfog(i) for i in (7, 12)]
    finally:
        equilibrium.destroy()


@pytest.mark.skipif(not known(), reason="another MUMPS")
def test_mumps_takes_it(monkeypatch):
    """The same answer and as many negative pivots in our order; if another is asked for, that."""
    theirs, (ordering, negative) = answer(monkeypatch, 10**9)
    ours, told = answer(monkeypatch, 0)
    assert told == [1, negative]
    assert ordering != 1
    np.testing.assert_allclose(ours, theirs, atol=1e-9 * abs(theirs).max())
    _, told = answer(monkeypatch, 0, mat_mumps_icntl_7=0)
    assert told == [0, negative]


def test_another_mumps_keeps_its_own(monkeypatch):
    """What is not known is left alone, and solves as ever."""
    theirs, (ordering, _) = answer(monkeypatch, 10**9)
    monkeypatch.setattr(dissection, "_mumps", lambda factor: None)
    ours, told = answer(monkeypatch, 0)
    assert told[0] == ordering
    np.testing.assert_array_equal(ours, theirs)


@pytest.mark.skipif(not known(), reason="another MUMPS")
def test_struct_is_looked_at():
    """A factor that is none of MUMPS's, or one that says something else, is not taken for it."""
    matrix = PETSc.Mat().createAIJ((4, 4), nnz=1, comm=PETSc.COMM_SELF)
    for i in range(4):
        matrix[i, i] = 1.0
    matrix.assemble()
    pc = PETSc.PC().create(PETSc.COMM_SELF)
    pc.setOperators(matrix)
    pc.setType("cholesky")
    pc.setFactorSolverType("mumps")
    pc.setUp()
    factor = pc.getFactorMatrix()
    mumps = dissection._mumps(factor)
    assert (mumps.n, mumps.sym) == (4, 2)
    assert mumps.version.startswith(b"5.7")
    for name, other in (("version", b"5.8.0"), ("n", 5)):
        before = getattr(mumps, name)
        setattr(mumps, name, other)
        assert dissection._mumps(factor) is None
        setattr(mumps, name, before)
    pc.destroy()
    matrix.destroy()
