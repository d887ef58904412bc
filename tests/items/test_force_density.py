# SPDX-License-Identifier: MIT
"""Nets of force densities: derivatives, and equilibrium where the cloth lies flat."""

from types import SimpleNamespace

import numpy as np
import pytest
from mpi4py import MPI
from support.helpers import PITCH, UNEVEN, diagonals, l_shape
from support.kernels import differences

from cruciform_petsc.cloth.preform import Preform
from cruciform_petsc.elements.level import STIFFNESS
from cruciform_petsc.items.force_density import ForceDensity
from cruciform_petsc.items.ply import Ply
from cruciform_petsc.net.edges import Constraints
from cruciform_petsc.net.network import Network

TENSION = (700.0, 300.0)


def net_of(preform):
    network = Network(MPI.COMM_SELF, preform, UNEVEN)
    ply = Ply(Constraints(network, True, floats=True), (1e-3, 1e-3), flat=False)
    return ply, ForceDensity(ply, TENSION)


def test_derivatives():
    """Energy, force and stiffness, which does not depend on the places."""
    ply, item = net_of(l_shape(0.03, 1.2))
    x = ply.nodes.rest + 1e-3 * np.sin(300 * ply.nodes.rest[:, ::-1])
    rows, nodes = slice(5, 6), item.nodes[5]

    def of(part):
        def work(places):
            moved = x.copy()
            moved[nodes] = places[0]
            return item.work(SimpleNamespace(x=moved), STIFFNESS, rows)[part]

        return work

    _, force, stiffness = item.work(SimpleNamespace(x=x), STIFFNESS, rows)
    found = differences(of(0), x[nodes][None], 1e-5)[:, 0]
    np.testing.assert_allclose(found, force, atol=1e-7 * abs(force).max())
    found = differences(of(1), x[nodes][None], 1e-5)
    np.testing.assert_allclose(found, stiffness, atol=1e-7 * abs(stiffness).max())


@pytest.mark.parametrize(
    "preform", [Preform.rectangle(5.3 * PITCH, 4.6 * PITCH, 0.0), diagonals(3, 5)]
)
def test_flat_net(preform):
    """Where it is drawn each yarn has one force all along, so nothing pulls at a crossover."""
    ply, item = net_of(preform)
    at_rest = SimpleNamespace(x=ply.nodes.rest)
    force = np.zeros_like(ply.nodes.rest)
    for p in (0, 1):
        np.add.at(force, item.nodes[:, p], item.work(at_rest, STIFFNESS)[1][:, p])
    inner = np.ones(len(force), bool)
    inner[ply.nodes.of_network_node[ply.network.node_is_boundary]] = False
    assert abs(force[inner & ply.active]).max() < 1e-9 * max(TENSION) * PITCH
    families = np.unique(np.round(item.forces(at_rest), 9))
    np.testing.assert_allclose(families, np.sort(TENSION * ply.network.pitch[::-1]), rtol=1e-6)
