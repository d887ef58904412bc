# SPDX-License-Identifier: MIT
"""Forming on several ranks against one rank alone: fields, forces, what friction remembers."""

import numpy as np
import pytest
from mpi4py import MPI
from support.formed import HARD, formed, hemisphere, network, travel
from support.helpers import gathered

from cruciform_petsc.errors import EquilibriumError
from cruciform_petsc.forming.blank import Blank
from cruciform_petsc.forming.forming import form
from cruciform_petsc.forming.press import StagePlan
from cruciform_petsc.tools import shapes
from cruciform_petsc.tools.motion import Motion
from cruciform_petsc.tools.tool import Tool

COMM = MPI.COMM_WORLD
STROKE = 20e-3
pytestmark = pytest.mark.three_ranks


def by_place(comm, place, values):
    """Values of all ranks in the order of their places at rest, (n, 3), on every rank."""
    places = np.round(np.concatenate(comm.allgather(place[:, :2])), 9)
    assert len(np.unique(places, axis=0)) == len(places)
    return np.concatenate(comm.allgather(values))[np.lexsort(places.T)]


def shown(blank, state):
    """Displacements of crossovers, and what friction remembers by tool, on every rank."""
    net = blank.network
    moved = blank.ply.displacement(blank.of_cloth(state))[0]
    fields = {"moved": gathered(net.comm, net.crossover_number_global, moved)}
    place = blank.nodes.rest[blank.contacts[0].nodes[:, 0]]
    for contact in blank.contacts:
        for key, values in state.memory[contact.name].items():
            fields[f"{contact.name} {key}"] = by_place(net.comm, place, values)
    return fields


def test_a_hemisphere():
    """The same steps, forces, positions and anchors, to 1e-6 of the stroke."""
    results = []
    for comm in (COMM, MPI.COMM_SELF):
        blank, plans = hemisphere(comm, steps=5)
        steps, states = formed(blank, *plans)
        results.append((steps, shown(blank, states[-1])))
    (steps, fields), (steps_alone, alone) = results
    assert len(steps) == len(steps_alone)
    for step, other in zip(steps, steps_alone, strict=True):
        for tool, force in other.tool_force.items():
            np.testing.assert_allclose(step.tool_force[tool], force, atol=1e-4)
        np.testing.assert_allclose(step.work, other.work, atol=1e-6)
        assert step.spent == pytest.approx(other.spent, rel=1e-4, abs=1e-9)
        assert step.increment.shear_max == pytest.approx(other.increment.shear_max, abs=1e-5)
    assert abs(alone["moved"][:, 2]).max() > 0.9 * STROKE
    for name, values in alone.items():
        # Places in metres; forces in newton, of 20 N; energies in joule.
        place = name.endswith(("moved", "anchor", "place"))
        scale = STROKE if place else 1.0 if "normal" in name else 20.0
        off = np.nan_to_num(1.0 * fields[name]) - np.nan_to_num(values)
        if "normal" in name:  # on a tool's axis there is none
            off[alone[name.replace("normal", "pressed")] == 0.0] = 0.0
        assert (np.isnan(fields[name]) == np.isnan(values)).all(), name
        assert abs(off).max() <= 1e-6 * scale, name


def test_an_error_is_told_on_all():
    """No equilibrium, as Newton may take one step only: all ranks end with the same words."""
    ball = Tool("ball", shapes.sphere(20e-3), 0.2)
    blank = Blank(network((50, 50), comm=COMM), [ball], settings=HARD)
    plan = StagePlan("up", {"ball": travel(0, 0, 5e-3)}, step=0.5)
    with pytest.raises(EquilibriumError) as error:
        form(blank, [plan], options={"snes_max_it": 1})
    told = COMM.allgather((str(error.value), len(error.value.result.steps)))
    assert len(set(told)) == 1


def test_a_plate_that_turns():
    """Cloth that is carried along lies on the same places on any number of ranks."""
    turn = StagePlan(
        "turn", {"bed": lambda pose: Motion(pose, angle=0.5, through=np.array([0.05, 0, 0]))},
        step=0.25,
    )  # fmt: skip
    places = []
    for comm in (COMM, MPI.COMM_SELF):
        bed = Tool("bed", shapes.plane(), 0.3)
        blank = Blank(network((50, 42), comm=comm), [bed], weight=True, settings=HARD)
        steps, states = formed(blank, StagePlan("lay", step=1.0), turn)
        assert sum(step.increment.iterations for step in steps) < 40
        moved = blank.ply.displacement(blank.of_cloth(states[-1]))[0]
        places.append(gathered(comm, blank.network.crossover_number_global, moved))
    np.testing.assert_allclose(places[0], places[1], atol=1e-8)
    assert abs(places[1]).max() > 0.02
