# SPDX-License-Identifier: MIT
"""The hyperelastic membrane on several ranks against one rank alone."""

from __future__ import annotations

import numpy as np
import pytest
from mpi4py import MPI

from cruciform_petsc.cloth.fabric import Fabric, YarnFamily
from cruciform_petsc.cloth.preform import Preform
from cruciform_petsc.continuum.hyperelastic import HyperelasticMembrane
from cruciform_petsc.errors import SolverError

COMM = MPI.COMM_WORLD
FABRIC = Fabric(
    "uneven", YarnFamily(50e3, 0.4, 240.0, 5e-6), YarnFamily(20e3, 0.16, 310.0, 9e-6), 100.0
)
L_SHAPE = [(-0.01, 0), (0.01, 0), (0.01, 0.012), (0, 0.012), (0, 0.03), (-0.01, 0.03)]
PREFORMS = {
    "rectangle": Preform.rectangle(0.02, 0.04, "40 deg"),
    "L": Preform.polygon(L_SHAPE, (), "30 deg"),
}


@pytest.mark.parametrize("bending", [False, True], ids=["", "bending"])
@pytest.mark.parametrize("preform", PREFORMS.values(), ids=PREFORMS.keys())
def test_results_are_the_same_on_any_number_of_ranks(preform, bending):
    points = np.array([[-0.004, 0.008], [-0.002, 0.02], [-0.006, 0.024]])
    mine = points[COMM.rank :: COMM.size]
    together, alone = (
        HyperelasticMembrane(
            comm, preform, FABRIC, 5e-3, degree=2, grading=0, bending=bending
        ).solve_bias_extension([2e-3, 5e-3])
        for comm in (COMM, MPI.COMM_SELF)
    )
    for ours, expected in zip(together, alone, strict=True):
        assert ours.dofs == expected.dofs
        assert ours.stable == expected.stable
        for name in ("load", "energy", "energy_tension", "energy_shear", "energy_bending"):
            assert getattr(ours, name) == pytest.approx(getattr(expected, name), rel=1e-8), name
        field = expected.evaluate(mine)
        for name, value in ours.evaluate(mine).items():
            largest = COMM.allreduce(abs(field[name]).max(initial=0.0), MPI.MAX)
            assert np.allclose(value, field[name], rtol=0, atol=1e-8 * largest), name
    assert (together[-1].energy_bending > 0) == bending
    assert together[-1].evaluate(mine)["shear_angle"].max(initial=0.0) < np.pi / 2


def test_bending_on_a_graded_mesh():
    """The triangles beside a rank's own come with the last refinement."""
    together, alone = (
        HyperelasticMembrane(
            comm, PREFORMS["L"], FABRIC, 5e-3, 2, grading=2, bending=True
        ).solve_bias_extension([2e-3])[0]
        for comm in (COMM, MPI.COMM_SELF)
    )
    assert together.load == pytest.approx(alone.load, rel=1e-3)
    assert together.energy_bending == pytest.approx(alone.energy_bending, rel=1e-3)


def test_failure_reaches_every_rank():
    membrane = HyperelasticMembrane(COMM, PREFORMS["rectangle"], FABRIC, 0.02, 2, grading=0)
    with pytest.raises(SolverError, match="no equilibrium beyond"):
        membrane.solve_bias_extension([-0.1])
