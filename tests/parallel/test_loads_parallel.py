# SPDX-License-Identifier: MIT
"""Loads on cloth in space, and tests that buckle, are the same on any number of ranks."""

from dataclasses import replace

import numpy as np
from mpi4py import MPI
from support.finite import Cloth
from support.helpers import PITCH, TABLE_1, UNEVEN, gathered, l_shape

from cruciform_petsc import Biaxial
from cruciform_petsc.cloth.preform import Preform
from cruciform_petsc.equilibrium.newton import Equilibrium
from cruciform_petsc.items.loads import Pressure, Suction, gravity, imperfection
from cruciform_petsc.net.edges import Constraints
from cruciform_petsc.net.network import Network

COMM = MPI.COMM_WORLD
LOADS = [
    lambda ply: Pressure(ply, 3e3, np.array([0.01, 0.2, -0.1])),
    lambda ply: Suction(ply, 2e3),
    lambda ply: gravity(ply, "this test"),
    lambda ply: imperfection(ply, 1e-4, 3),
]


def wavy(comm):
    """Bent by place at rest, whatever the ranks; suction is brought up to date."""
    fabric = replace(UNEVEN, areal_density=0.5)
    constraints = Constraints(Network(comm, l_shape(0.06, 1.2), fabric), True)
    constraints.clamp("lower")
    cloth = Cloth(constraints, None, (1e-3, 4e-4), False, LOADS)
    x, y = cloth.rest[:, 0] / 0.02, cloth.rest[:, 1] / 0.03
    wave = np.stack([np.cos(x + y), np.sin(x - 2 * y), 3 * np.sin(x) * np.cos(y) + x * y], axis=1)
    state = cloth.state(cloth.rest + 2e-3 * wave)
    memory = {"suction": cloth.ply.further[1].accepted(state)}
    return cloth, replace(state, memory=memory)


def test_forces_of_loads():
    """Each load's energy to 1e-12, their force node by node; areas of nodes."""
    (few, state), (many, state_2) = wavy(MPI.COMM_SELF), wavy(COMM)
    energies, energies_2 = few.model.energies(state), many.model.energies(state_2)
    for item in few.ply.further:
        one, two = energies[item.name], energies_2[item.name]
        assert abs(one) > 1e-9
        assert abs(two - one) < 1e-12 * abs(one) + 1e-16
    at = np.searchsorted(few.nodes.node_key, many.nodes.node_key)
    for one, two in zip(few.model.force(state)[:2], many.model.force(state_2)[:2], strict=True):
        np.testing.assert_allclose(two, one[at], atol=1e-12 * abs(one).max())
    np.testing.assert_allclose(many.ply.areas(0.3), few.ply.areas(0.3)[at], atol=1e-18)


def quarter(comm):
    """A quarter between planes of symmetry, blown up a little."""
    points = [(0, 0), (0.03, 0), (0.03, 0.04), (0, 0.04)]
    preform = Preform.polygon(points, [], 0.0, origin=(PITCH / 2, 0.0))
    constraints = Constraints(Network(comm, preform, TABLE_1), True)
    for edge in ("left", "lower"):
        constraints.symmetry(edge)
    for edge in ("right", "upper"):
        constraints.clamp(edge)
    load = [lambda ply: Pressure(ply, 50.0, np.zeros(3))]
    cloth = Cloth(constraints, None, (2e-3, 1e-3), False, load)
    equilibrium = Equilibrium(cloth.model, cloth.state())
    found = equilibrium.solve(cloth.state())
    equilibrium.destroy()
    return cloth, found


def test_planes_of_symmetry_and_pressure():
    (few, one), (many, two) = quarter(MPI.COMM_SELF), quarter(COMM)
    at = np.searchsorted(few.nodes.node_key, many.nodes.node_key)
    height = one.state.x[:, 2].max()
    assert height > 1e-4
    np.testing.assert_allclose(two.state.x, one.state.x[at], atol=1e-6 * height)


def test_a_sheet_that_buckles():
    """The same waves at rest, the same buckles: displacements to 1e-6 of the stroke."""
    sides = 10 / np.array([UNEVEN.weft.yarns, UNEVEN.warp.yarns])
    bent = (replace(f, out_of_plane_bending=1e-4) for f in (UNEVEN.warp, UNEVEN.weft))
    fabric = replace(UNEVEN, **dict(zip(("warp", "weft"), bent, strict=True)))
    one, two = (
        Biaxial(
            Network(comm, Preform.rectangle(*sides, 0.0), fabric), ["0.2 %", "0.5 %"], ratio=-1,
            finite=True, space=True, imperfection={"height": 1e-4, "seed": 2},
        ).solve()
        for comm in (MPI.COMM_SELF, COMM)
    )  # fmt: skip
    assert one.heights_max[-1] > 2e-4
    number, stroke = two.network.crossover_number_global, 5e-3 * sides[0]
    found = gathered(COMM, number, two.fields["displacement"])
    np.testing.assert_allclose(found, one.fields["displacement"], atol=1e-6 * stroke)
    for name, force in one.forces.items():
        np.testing.assert_allclose(two.forces[name], force, rtol=1e-6)
    assert one.energies()["out_of_plane_bending"][-1] > 0.0
