# SPDX-License-Identifier: MIT
"""Cloth whose yarns slide, on several ranks against one; resumed on other numbers of ranks."""

import numpy as np
import pytest
from mpi4py import MPI
from support.helpers import gathered

from cruciform_petsc.case.schema import Case
from cruciform_petsc.net.network import Network
from cruciform_petsc.output.checkpoint import Checkpoint

COMM = MPI.COMM_WORLD
pytestmark = pytest.mark.three_ranks

CASES = {
    "bias": {
        "fabric": {"use": "glass-pp-plain-1.93"},
        "preform": {"outline": {"rectangle": ["22 mm", "44 mm"]}, "bias_angle": "41 deg"},
        "test": {
            "kind": "bias-extension",
            "extension": ["2 mm", "4 mm", "5 mm", "4 mm"],
            "slip": {"force": "0.06 N", "friction": 0.3, "crimp_angle": "15 deg"},
        },
    },
    "pull-out": {
        "fabric": {"use": "glass-pp-plain-1.93"},
        "preform": {"outline": {"rectangle": ["26 mm", "31 mm"]}, "bias_angle": "0 deg"},
        "test": {
            "kind": "pull-out",
            "extension": ["0.1 mm", "0.5 mm", "2 mm"],
            "slip": {"force": "0.05 N"},
        },
    },
}


class Stop(Exception):
    """What kills a run."""


def solve(comm, name, checkpoint=None, stop=None):
    case = Case.from_data(CASES[name])
    done = []

    def accepted(increment):
        done.append(increment)
        if len(done) == stop:
            raise Stop

    network = Network(comm, case.preform(), case.fabric())
    try:
        return case.experiment(network).solve(accepted, checkpoint)
    except Stop:
        return None


@pytest.fixture(scope="module", params=CASES)
def alone(request):
    """A case by its name, and its result on one rank."""
    return request.param, solve(MPI.COMM_SELF, request.param)


def same(result, alone):
    """Loads, slips and what they have taken, from state to state.

    Equilibrium is found to 1e-8 of the forces; places are softer than that by yarns that slide.
    (Much less friction lets yarns leave one after the other: of which one leaves first rounding may
    tell, in cloth with a mirror's symmetry.)
    """
    np.testing.assert_allclose(result.controls, alone.controls, rtol=1e-12)
    np.testing.assert_allclose(
        result.loads, alone.loads, rtol=0, atol=1e-6 * abs(alone.loads).max()
    )
    network = result.network
    for state, other in zip(result.states, alone.states, strict=True):
        for field in ("displacement", "slip", "slip_spent", "warp_tension"):
            every = gathered(COMM, network.crossover_number_global, state.fields[field])
            wanted = other.fields[field]
            size = abs(wanted).max()
            np.testing.assert_allclose(every, wanted, rtol=0, atol=1e-6 * size, err_msg=field)
    assert alone.fields["slip_spent"].sum() > 1e-5


def test_as_on_one_rank(alone):
    name, expected = alone
    same(solve(COMM, name), expected)


def test_goes_on_from_a_checkpoint(alone, tmp_path_factory):
    """Anchors and what they have taken go with their crossovers."""
    name, expected = alone
    folder = COMM.bcast(tmp_path_factory.mktemp("slip") if COMM.rank == 0 else None)
    case = Case.from_data(CASES[name])
    assert solve(COMM, name, Checkpoint.begin(COMM, folder, case), 2) is None
    checkpoint = Checkpoint.resume(COMM, folder, case)
    assert len(checkpoint.increments) == 2
    same(solve(COMM, name, checkpoint), expected)
