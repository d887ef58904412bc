# SPDX-License-Identifier: MIT
"""Matrices on a pattern are the sums of their elements' matrices."""

import numpy as np
import pytest
from mpi4py import MPI
from support.helpers import dense

from cruciform_petsc.parallel import DistributedNodes
from cruciform_petsc.solvers.pattern import BlockPattern


def ladder():
    """40 elements of four nodes between two lines of 41, and one node of no element."""
    nodes = DistributedNodes(MPI.COMM_SELF, np.arange(83), np.zeros(0, int), [])
    return nodes, np.arange(40)[:, None] + [0, 1, 41, 42]


def summed(elements, matrices, d, size):
    """Dense sum of matrices (m, k d, k d)."""
    total = np.zeros((size * d, size * d))
    for nodes, matrix in zip(elements, matrices, strict=True):
        at = (nodes[:, None] * d + np.arange(d)).ravel()
        total[np.ix_(at, at)] += matrix
    return total


@pytest.mark.parametrize("d", [2, 3])
def test_rows_of_elements_that_share_matrices(d):
    """Copied rows, others between them, elements of none, entries left out, values written anew.

    Rows are sums of at most three numbers here: what differs is their order.
    """
    rng = np.random.default_rng(d)
    nodes, elements = ladder()
    pattern = BlockPattern(nodes, [elements], d)
    which = np.zeros(40, np.int32)
    which[[7, 8, 21, 30]] = 1, 2, 1, -1
    idle = np.zeros((83, d))
    idle[[25, 82], 1] = 5.0
    matrices = rng.normal(size=(3, 4 * d, 4 * d))
    there = rng.random((3, 4 * d, 4 * d)) < 0.6
    there[1] = there[0]  # two that differ in values only
    matrices[~there] = 0.0
    layout = pattern.layout(which, there)
    assert 40 < layout.alike.sum() < 80  # most rows, not all
    matrix = None
    for factor in (1.0, -2.0):
        matrix = pattern.sum(layout, which, factor * matrices, idle, matrix)
        given = np.where((which >= 0)[:, None, None], factor * matrices[which], 0.0)
        expected = summed(elements, given, d, 83) + np.diag(idle.ravel())
        np.testing.assert_allclose(dense(matrix), expected, atol=1e-14 * abs(expected).max())
    held = summed(elements, np.where((which >= 0)[:, None, None], there[which], 0.0), d, 83)
    assert matrix.getInfo()["nz_used"] == ((held != 0) | np.eye(83 * d, dtype=bool)).sum()
    matrix.destroy()


def test_blocks_of_several_kinds():
    """Elements of four and of two nodes, one of which, like a tool's, is joined to many."""
    rng = np.random.default_rng(1)
    nodes, elements = ladder()
    joined = np.column_stack([np.arange(82), np.full(82, 82)])
    pattern = BlockPattern(nodes, [elements, joined], 3)
    blocks, expected = pattern.empty_blocks(), 0.0
    for part, slots in zip((elements, joined), pattern.slots, strict=True):
        k = part.shape[1]
        matrices = rng.normal(size=(len(part), k, 3, k, 3))
        np.add.at(blocks, slots, matrices.swapaxes(2, 3))
        expected = expected + summed(part, matrices.reshape(-1, 3 * k, 3 * k), 3, 83)
    matrix = pattern.matrix(blocks)
    np.testing.assert_allclose(dense(matrix), expected, atol=1e-14 * abs(expected).max())
    again = pattern.matrix(2.0 * blocks, matrix)
    np.testing.assert_allclose(dense(again), 2.0 * expected, atol=1e-14 * abs(expected).max())
    matrix.destroy()
