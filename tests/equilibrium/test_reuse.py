# SPDX-License-Identifier: MIT
"""Steps with a factor that is at hand: taken while they help, and never uphill."""

import numpy as np
import pytest
from mpi4py import MPI
from petsc4py import PETSc

from cruciform_petsc.equilibrium.reuse import MOST, go_on, is_reusable

COMM = MPI.COMM_SELF


def energy(x):
    """Of two springs of 1 and 4 N/m that stiffen; its gradient is x + x^3 and 4 x."""
    return 0.5 * x[0] ** 2 + 0.25 * x[0] ** 4 + 2.0 * x[1] ** 2


def gone_on(stiffness, start, near=100.0, longest=1.0):
    """Where it ends with a factor of diagonal stiffnesses, steps taken, energies looked at."""
    matrix = PETSc.Mat().createAIJ((2, 2), nnz=1, comm=COMM)
    matrix.setDiagonal(PETSc.Vec().createWithArray(np.array(stiffness, float), comm=COMM))
    matrix.assemble()
    ksp = PETSc.KSP().create(COMM)
    ksp.setType("preonly")
    ksp.getPC().setType("cholesky")
    ksp.setOperators(matrix)
    ksp.setUp()
    assert is_reusable(ksp)
    seen = []

    def at(vector):
        x = vector.getArray().copy()
        seen.append(energy(x))
        return seen[-1], np.array([x[0] + x[0] ** 3, 4.0 * x[1]])

    vector = PETSc.Vec().createWithArray(np.array(start, float), comm=COMM)
    taken = go_on(ksp, at, vector, 1e-6, near, longest, 0.0)
    return vector.getArray(), taken, seen


def test_it_goes_on_to_the_tolerance():
    """Each step leaves what the factor is wrong by, a tenth here; so six or seven do."""
    x, taken, seen = gone_on([1.1, 4.4], [0.1, 0.1])
    assert np.linalg.norm([x[0] + x[0] ** 3, 4.0 * x[1]]) <= 1e-6
    assert 5 <= taken == len(seen) - 1 < MOST
    assert (np.diff(seen) < 0.0).all()


@pytest.mark.parametrize(("stiffness", "looks"), [(0.4, 2), (-4.0, 1)])
def test_it_does_not_go_where_that_does_not_help(stiffness, looks):
    """Steps too long raise energy and residual; those of a negative factor lead uphill."""
    x, taken, seen = gone_on([stiffness, 4.0], [0.3, 0.0])
    assert taken == 0
    assert x.tolist() == [0.3, 0.0]
    assert len(seen) == looks


def test_slow_steps_are_few():
    """One that leaves more than half is taken, and is the last."""
    x, taken, seen = gone_on([3.0, 4.0], [0.1, 0.0])
    assert (taken, len(seen)) == (1, 2)
    assert 0.05 < x[0] < 0.1


@pytest.mark.parametrize("limits", [{"near": 0.1}, {"longest": 0.05}])
def test_it_stays_where_equilibrium_is_far(limits):
    """A large residual, or a step longer than Newton's may be."""
    assert gone_on([1.1, 4.4], [0.1, 0.1], **limits)[1] == 0
