# SPDX-License-Identifier: MIT
"""A law identified on several ranks against that of one rank alone; errors on every rank."""

import logging
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from mpi4py import MPI

from cruciform_petsc.calibrate import calibrate_case
from cruciform_petsc.calibration import calibrate
from cruciform_petsc.calibration.load_curve import LoadCurve
from cruciform_petsc.case.schema import Case
from cruciform_petsc.cloth.fabric import Fabric
from cruciform_petsc.cloth.preform import Preform
from cruciform_petsc.errors import EquilibriumError, InputError
from cruciform_petsc.net.network import Network

COMM = MPI.COMM_WORLD
DEMOS = Path(__file__).parents[2] / "demos"
DISPLACEMENT = 1e-3 * np.array([2, 4, 8, 12, 16, 20, 24, 28])
FORCE = [0.75, 1.06, 1.20, 1.36, 1.69, 2.33, 2.77, 3.42]


def test_same_law_on_all_ranks():
    """Loads agree to 1e-8, and the sum of squares is flat near its least: the law to 1e-5."""
    fabric = replace(Fabric.from_library("glass-pp-plain-1.93"), shear_law=None, shear_modulus=7.5)
    preform = Preform.rectangle("115 mm", "230 mm", "45 deg", yarns_per_cruciform=3)
    found = calibrate(Network(COMM, preform, fabric), DISPLACEMENT, FORCE)
    alone = calibrate(Network(MPI.COMM_SELF, preform, fabric), DISPLACEMENT, FORCE)
    np.testing.assert_allclose(found.values, alone.values, rtol=1e-5)
    np.testing.assert_allclose(found.loads, alone.loads, rtol=1e-6)
    np.testing.assert_allclose(found.standard_errors, alone.standard_errors, rtol=1e-3)
    assert found.iterations == alone.iterations
    for every in COMM.allgather(found.values):
        np.testing.assert_array_equal(every, found.values)


def small_network():
    preform = Preform.rectangle("100 mm", "200 mm", "45 deg", yarns_per_cruciform=4)
    return Network(COMM, preform, Fabric.from_library("glass-pp-plain-1.93"))


def test_a_failing_fit_ends_on_every_rank(monkeypatch):
    """SciPy runs on rank 0 only; what it raises there is told to the others, which wait for it."""

    def failing(residuals, start, *_, **__):
        residuals(start)
        raise ValueError("SVD did not converge")

    monkeypatch.setattr("scipy.optimize.least_squares", failing)
    with pytest.raises((ValueError, RuntimeError), match="SVD did not converge"):
        calibrate(small_network(), DISPLACEMENT, FORCE)
    assert COMM.allreduce(1) == COMM.size  # no message is left over


def test_a_start_without_equilibrium_is_told_on_every_rank(monkeypatch):
    solve = LoadCurve.solve

    def failing(self, law, start=None):
        if start is not None:
            raise EquilibriumError("no equilibrium found", "MAX_IT", [])
        return solve(self, law, start)

    monkeypatch.setattr(LoadCurve, "solve", failing)
    with pytest.raises(InputError, match="has no equilibrium with the start for the law"):
        calibrate(small_network(), DISPLACEMENT, FORCE)
    assert COMM.bcast(COMM.rank) == 0


def test_a_bad_curve_is_told_on_every_rank(tmp_path):
    case = Case.load(DEMOS / "calibrate_glass_pp.toml")
    with pytest.raises(InputError, match="does not exist"):
        calibrate_case(COMM, case, tmp_path / "no.csv", tmp_path, logging.getLogger("quiet"))


def test_no_worse_than_the_start_on_all_ranks():
    """The second search, at the start's own angles, is every rank's; its law is one rank's."""
    d = np.linspace(2e-3, 34e-3, 8)
    stairs = np.repeat([1.0, 4.0, 16.0, 64.0], 2)
    preform = Preform.rectangle("100 mm", "100 mm", "0 deg", yarns_per_cruciform=5)
    fabric = Fabric.from_library("glass-pp-plain-1.93")
    found, alone = (
        calibrate(Network(comm, preform, fabric), d, stairs, kind="picture-frame")
        for comm in (COMM, MPI.COMM_SELF)
    )
    assert found.rms <= 1.001 * found.start_rms
    assert len(found.angles) == len(d)
    np.testing.assert_allclose(found.values, alone.values, rtol=1e-4)
    assert found.message == alone.message
    assert COMM.allreduce(1) == COMM.size
