# SPDX-License-Identifier: MIT
"""Trusses are the same on any number of ranks, in the plane and pressed by tools."""

import tomllib

import numpy as np
import pytest
from mpi4py import MPI
from support.forming import CASE
from support.helpers import TABLE_1, UNEVEN, diagonals, gathered

from cruciform_petsc import BiasExtension, Case, Network, Preform

COMM = MPI.COMM_WORLD
pytestmark = pytest.mark.three_ranks


@pytest.mark.parametrize(
    ("preform", "fabric"),
    [(diagonals(4, 8), TABLE_1), (Preform.rectangle(0.024, 0.036, 0.5), UNEVEN)],
    ids=["diagonals", "askew"],
)
def test_bias_extension(preform, fabric):
    one, two = (
        BiasExtension(Network(comm, preform, fabric), "4 mm", model="truss").solve()
        for comm in (MPI.COMM_SELF, COMM)
    )
    assert two.load == pytest.approx(one.load, rel=1e-8)
    number = two.network.crossover_number_global
    for name, values in one.fields.items():
        found = gathered(COMM, number, two.fields[name])
        size = abs(values).max(initial=0.0) or 1.0
        np.testing.assert_allclose(found, values, atol=1e-7 * size, err_msg=name)


def test_forming():
    """Forces to 1e-4 of the holder's 5 N, which is what equilibrium is called by."""
    data = tomllib.loads(CASE)
    data["test"]["model"] = "truss"
    case = Case.from_data(data)
    one, two = (
        case.forming(Network(comm, case.preform(), case.fabric())).solve().steps[-1]
        for comm in (MPI.COMM_SELF, COMM)
    )
    for name, force in one.tool_force.items():
        np.testing.assert_allclose(two.tool_force[name], force, atol=1e-4 * 5.0)
    assert two.increment.shear_max == pytest.approx(one.increment.shear_max, rel=1e-3)
