# SPDX-License-Identifier: MIT
"""Critical loads, modes and branches are the same on any number of ranks."""

import sys

import numpy as np
import pytest
from mpi4py import MPI
from support.helpers import gathered

from cruciform_petsc import Fabric, Network, OffAxisTension, PictureFrame, Preform, YarnFamily

COMM = MPI.COMM_WORLD
pytestmark = pytest.mark.three_ranks
YARNS = YarnFamily(4e5, 0.0, 100.0, 1e-4, 1e-3), YarnFamily(4e5, 0.0, 80.0, 1e-4, 2e-3)
CLOTH = Fabric("cloth", *YARNS, 1e3)
TESTS = {
    # Bends and twists at one load: the modes are a choice.
    "strut": (OffAxisTension, Preform.rectangle(0.025, 0.1, 0.0), "-3 um"),
    "panel": (PictureFrame, Preform.rectangle(0.1, 0.1, 0.0), "3 deg"),
}


@pytest.mark.parametrize("backend", ["slepc", "subspace"])
@pytest.mark.parametrize("name", TESTS)
def test_modes_and_branches(monkeypatch, name, backend):
    """Loads to 1e-6, modes to 1e-4 of the largest displacement, the branch to 1e-5 of its height.

    Eigenvalues are good to 1e-9, vectors to the root of that over their distance to the next ones.
    """
    if backend == "subspace":
        monkeypatch.setitem(sys.modules, "slepc4py", None)
    else:
        pytest.importorskip("slepc4py")
    kind, preform, value = TESTS[name]
    keys = {"space": True, "stability": {"modes": 2, "step": 1e-4}}
    one, two = (
        kind(Network(c, preform, CLOTH), value, **keys).solve() for c in (MPI.COMM_SELF, COMM)
    )
    for which in ("linear", "passed"):
        for a, b in zip(getattr(one.buckling, which), getattr(two.buckling, which), strict=True):
            assert b.load == pytest.approx(a.load, rel=1e-6)
            assert b.control == pytest.approx(a.control, rel=1e-6)
    assert len(two.buckling.passed) == 1
    number = two.network.crossover_number_global
    for a, b in zip(one.buckling.modes, two.buckling.modes, strict=True):
        found = gathered(COMM, number, b.fields["displacement"])
        np.testing.assert_allclose(found, a.fields["displacement"], atol=1e-4)
    height = one.heights_max[-1]
    assert height > 1e-5
    found = gathered(COMM, number, two.fields["displacement"])
    np.testing.assert_allclose(found, one.fields["displacement"], atol=1e-5 * height)
    softest = "lowest_stiffness_Pa_per_mm"
    rest = abs(one.curve()[softest]).max()
    np.testing.assert_allclose(two.curve()[softest], one.curve()[softest], atol=1e-4 * rest)
