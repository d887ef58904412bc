# SPDX-License-Identifier: MIT
"""A membrane among tools on several ranks against one rank alone."""

from types import SimpleNamespace

import numpy as np
import pytest
from mpi4py import MPI
from support.formed import HARD, formed, hemisphere, network

from cruciform_petsc.continuum.sheet import MembraneBlank, Sheet
from cruciform_petsc.elements.level import STIFFNESS
from cruciform_petsc.forming.measures import DrawIn

pytestmark = pytest.mark.three_ranks


def test_a_hemisphere():
    """The same mesh, steps, forces, draw-in, places and shear angles."""
    points = np.stack(np.meshgrid(*2 * [np.linspace(-0.045, 0.045, 9)]), axis=-1).reshape(-1, 2)
    results = []
    for comm in (MPI.COMM_WORLD, MPI.COMM_SELF):
        of_net, plans = hemisphere(comm, steps=5)
        blank = MembraneBlank(of_net.network, of_net.tools, 1 / 120, settings=HARD)
        steps, states = formed(blank, *plans)
        shape = blank.ply.at(blank.of_cloth(states[-1]), points)
        total = comm.allreduce(float(blank.area.sum()))
        results.append((blank, steps, DrawIn(blank).largest(states[-1]), *shape, total))
    (blank, steps, drawn, u, gamma, area), (alone, expected, *fields) = results
    assert blank.nodes.num_nodes_global == alone.nodes.num_nodes_global
    assert area == pytest.approx(fields[-1], rel=1e-12)
    assert len(steps) == len(expected)
    for tool, force in expected[-1].tool_force.items():
        np.testing.assert_allclose(steps[-1].tool_force[tool], force, atol=1e-3)
    assert drawn == pytest.approx(fields[0], abs=1e-6)
    np.testing.assert_allclose(u, fields[1], atol=2e-6)
    np.testing.assert_allclose(gamma, fields[2], atol=1e-4)


def test_eight_triangles():
    """Ranks with few triangles and perhaps no node: energy, area and places are right."""
    comm = MPI.COMM_WORLD
    sheet = Sheet(network((50.0, 35.0), comm=comm), 1.0)
    stretched = SimpleNamespace(x=1.01 * sheet.nodes.rest)
    energy, force, _ = sheet.stretching.work(stretched, STIFFNESS)
    assert force.shape == (sheet.cells, 3, 3)
    whole = 50e-3 * 35e-3
    assert comm.allreduce(float(energy.sum())) == pytest.approx(52e3 * 1e-4 * whole, rel=1e-9)
    areas = sheet.areas()[: sheet.nodes.num_nodes_owned]
    assert comm.allreduce(float(areas.sum())) == pytest.approx(whole, rel=1e-12)
    points = sheet.network.crossover_position
    u, gamma = sheet.at(stretched, points)
    np.testing.assert_allclose(u, np.pad(0.01 * points, ((0, 0), (0, 1))), atol=1e-15)
    np.testing.assert_allclose(gamma, 0.0, atol=1e-12)
