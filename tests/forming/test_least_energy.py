# SPDX-License-Identifier: MIT
"""The seed of least energy of shear is found; the search is the same on any number of ranks."""

import numpy as np
import pytest
import shapely
from mpi4py import MPI
from support.formed import network

from cruciform_petsc.errors import InputError
from cruciform_petsc.forming.fishnet import Fishnet
from cruciform_petsc.forming.fishnet_table import LayTable
from cruciform_petsc.forming.least_energy import CoarseNet, _before, search
from cruciform_petsc.tools import shapes
from cruciform_petsc.tools.motion import Pose
from cruciform_petsc.tools.tool import Tool

COMM = MPI.COMM_SELF
RADIUS = 50e-3


def dome(x=0.0, y=0.0):
    """Half a sphere that rises from a disc, at a place."""
    return Tool("dome", shapes.sphere(RADIUS), 0.0, Pose(np.array([x, y, -RADIUS])))


def seed_of(net, **keys):
    return LayTable.from_data(keys, "test", bare=True)._start(net, dome(), True, 0.5e-3)[1]


def test_energy_of_a_coarse_net():
    """The law's energy of the closed form's shear, over the area: 0.5 G s^2 with s = u v/R^2."""
    net = network((30.0, 30.0), origin=(0, 0), yarns_per_cruciform=1)
    coarse = CoarseNet(net.preform, net.fabric, 1.5)
    energy = coarse.energy(np.zeros(2), seed_of(net))
    # Of cells whose middle is inside, over +-a: of G u^2 v^2/(2 R^4) it is (2 G/9) a^6/R^4.
    a = coarse.pitch[0] * np.round(15e-3 / coarse.pitch[0])
    exact = 2.0 / 9.0 * net.fabric.shear_modulus * a**6 / (RADIUS + 0.5e-3) ** 4
    assert energy == pytest.approx(exact, rel=0.1)


def test_refused_before_it_is_laid_counts_in_full():
    """Beyond a low limit all cells count as sheared by it."""
    net = network((60.0, 60.0), origin=(0, 0))
    low, high = (CoarseNet(net.preform, net.fabric, angle) for angle in (0.15, 1.5))
    seed = seed_of(net)
    assert low.energy(np.zeros(2), seed) < high.energy(np.zeros(2), seed)
    most = net.fabric.shear.evaluate(0.15)[0] * net.preform.outline.area
    assert 0.2 * most < low.energy(np.zeros(2), seed) < 1.2 * most


def test_joints_before_cells():
    """All that lie between them and the seed, in their quadrant, and no others."""
    inside = np.zeros((6, 5), bool)
    inside[4, 3] = inside[0, 1] = True
    wanted = _before(inside, np.array([-2, -2]))  # the seed is joint (2, 2)
    expected = np.zeros((7, 6), bool)
    expected[2:6, 2:5] = True
    expected[0:3, 1:3] = True
    np.testing.assert_array_equal(wanted, expected)


def test_the_pole_is_found():
    """Cloth centred over a sphere, begun at its side: from the pole it takes least."""
    net = network((70.0, 70.0), origin=(0, 0))
    table = {"seed": [20e-3, 12e-3], "least_energy": {"places": 3, "turn": 0.0, "shear": 0.0}}
    found = LayTable.from_data(table, "test", bare=True).lay(net, dome(), True, 0.5e-3)
    assert found.search.energy < 0.8 * found.search.before
    assert np.linalg.norm(found.laid.seed[0]) < 2.0 * net.pitch[0]
    assert np.linalg.norm(found.laid.seed[1][:2]) < 2.0 * net.pitch[0]
    # The crossover next to what was found lies above where it lies on the flat blank, as that does.
    np.testing.assert_allclose(found.laid.seed[1][:2], found.laid.seed[0], atol=1e-9)
    told = found.figures()
    assert told["least_energy"]["nets"] == found.search.nets > 10
    assert told["between_deg"] == pytest.approx(90.0)


def test_directions_are_found():
    """Begun with the yarns 8 degrees off square at the pole: the square ones are found again."""
    net = network((60.0, 60.0), origin=(0, 0))
    table = {"between": "98 deg", "least_energy": {"places": 1, "turn": 0.0}}
    found = LayTable.from_data(table, "test", bare=True).lay(net, dome(), True, 0.5e-3)
    assert np.degrees(found.seed.between) == pytest.approx(90.0, abs=1.0)
    assert np.degrees(found.seed.heading) == pytest.approx(90.0)


def test_nowhere():
    net = network((60.0, 60.0), origin=(0, 0))
    seed = seed_of(net).turned([1.0, 1.0], 0.0, 1.5)
    with pytest.raises(InputError, match="cannot be laid from any of the places"):
        search(COMM, CoarseNet(net.preform, net.fabric, 1.5), np.zeros(2), seed, 2, 0.0, 0.0)


def test_coarse_nets_are_coarse():
    """Some 1500 cells of any blank; a coarse one keeps its own pitch. What they hold is small."""
    fine = network((200.0, 200.0))
    net = CoarseNet(fine.preform, fine.fabric, 1.5)
    assert net.preform.outline.area / net.pitch.prod() == pytest.approx(1500.0)
    few = network((60.0, 60.0))
    np.testing.assert_allclose(CoarseNet(few.preform, few.fabric, 1.5).pitch, few.pitch)
    assert isinstance(net.preform.outline, shapely.Polygon)
    assert Fishnet(shapes.plane(), 0.0, (1.0, 1.0), (-1, -1), (3, 3)).shape == (3, 3)
