# SPDX-License-Identifier: MIT
"""Networks laid on tools: outlines, holes, tails, seeds, generators, what ends it early."""

import re

import numpy as np
import pytest
from mpi4py import MPI
from support.formed import cloth, network

from cruciform_petsc.cloth.preform import Preform
from cruciform_petsc.errors import InputError
from cruciform_petsc.forming.fishnet_table import LayTable
from cruciform_petsc.forming.lay import lay
from cruciform_petsc.net.network import Network
from cruciform_petsc.net.nodes import Nodes
from cruciform_petsc.tools import shapes
from cruciform_petsc.tools.motion import Pose
from cruciform_petsc.tools.sampled import height_field
from cruciform_petsc.tools.tool import Tool

COMM = MPI.COMM_SELF
RADIUS, GAP = 50e-3, 0.5e-3


def ball(radius=RADIUS):
    """A sphere whose pole is at z = 0."""
    return Tool("ball", shapes.sphere(radius), 0.0, Pose(np.array([0.0, 0.0, -radius])))


def draped(net, tool=None, below=True, **keys):
    return LayTable.from_data(keys, "test", bare=True).lay(net, tool or ball(), below, GAP)


def distances(laid, radius=RADIUS):
    return np.linalg.norm(laid.points - [0.0, 0.0, -radius], axis=1) - radius


@pytest.mark.parametrize("angle", ["0 deg", "30 deg", "45 deg"])
def test_arms_keep_their_lengths_and_lie_on_the_tool(angle):
    """Of tails at the outline, too, whatever the angle of the yarns."""
    net = network((60.0, 70.0), angle=angle)
    laid = draped(net).laid
    assert laid.laid.all()
    assert not laid.limit
    assert not laid.beyond
    np.testing.assert_allclose(distances(laid), GAP, rtol=0, atol=1e-14)
    length = np.linalg.norm(laid.ends - laid.crossovers[:, None], axis=2)
    has = net.arm_length > 0.0
    np.testing.assert_allclose(length[has], net.arm_length[has], rtol=1e-11)
    assert np.isnan(length[~has]).all()
    # On nodes ends that two crossovers share have one place.
    x = laid.on_nodes(net, Nodes(net, 3))
    assert len(x) == len(Nodes(net, 3).rest)
    np.testing.assert_allclose(
        np.linalg.norm(x + np.array([0, 0, RADIUS]), axis=1), RADIUS + GAP, rtol=1e-12
    )


def test_yarns_run_as_they_did_and_the_seed_lies_where_it_should():
    """The warp heads along its direction in plan, the weft 90 degrees to its left."""
    net = network((40.0, 40.0), angle="30 deg")
    laid = draped(net, seed=[5e-3, 8e-3]).laid
    k = int(np.argmin(np.linalg.norm(net.crossover_position - [5e-3, 8e-3], axis=1)))
    np.testing.assert_allclose(laid.seed[0], net.crossover_position[k], atol=1e-15)
    np.testing.assert_allclose(laid.crossovers[k, :2], net.crossover_position[k], atol=1e-9)
    along = laid.ends[k, 0] - laid.ends[k, 2]
    np.testing.assert_allclose(
        along[:2] / np.linalg.norm(along[:2]), net.preform.warp_direction, atol=1e-3
    )
    across = laid.ends[k, 1] - laid.ends[k, 3]
    assert np.cross(along, across) @ (laid.crossovers[k] + [0, 0, RADIUS]) > 0.0


def test_turned_and_sheared_at_the_seed():
    net = network((40.0, 40.0))
    found = draped(net, seed=[0.0, 0.0], turn="10 deg", between="80 deg")
    k = int(np.argmin(np.linalg.norm(net.crossover_position, axis=1)))
    along, across = (found.laid.ends[k, a] - found.laid.ends[k, a + 2] for a in (0, 1))
    for vector, angle in ((along, 100.0), (across, 180.0)):
        assert np.degrees(np.arctan2(vector[1], vector[0])) % 360 == pytest.approx(angle, abs=0.01)
    assert found.figures()["between_deg"] == pytest.approx(80.0)


def test_holes_do_not_change_what_is_around_them():
    """The net is laid across them, as if there were cloth."""
    hole = [[0.005, 0.004], [0.015, 0.004], [0.015, 0.018], [0.005, 0.018]]
    fabric, corners = cloth(), [[-0.03, -0.03], [0.03, -0.03], [0.03, 0.03], [-0.03, 0.03]]
    whole, holed = (
        Network(COMM, Preform.polygon(corners, holes, "20 deg", origin=(0, 0)), fabric)
        for holes in ((), (hole,))
    )
    one, other = (draped(net).laid for net in (whole, holed))
    assert other.laid.all()
    where = {tuple(ij): k for k, ij in enumerate(whole.crossover_ij)}
    rows = [where[tuple(ij)] for ij in holed.crossover_ij]
    assert len(rows) < len(where)
    np.testing.assert_allclose(other.crossovers, one.crossovers[rows], atol=1e-15)


def test_pitch_of_warp_and_weft():
    """On the sphere the shear depends on how far along both yarns, not on the pitch of either."""
    yarn = {"modulus": "520 N/cm", "poisson": 0, "yarn_bending": "0.001 N mm^2"}
    coarse = cloth(warp={**yarn, "yarns": "2 /cm"}, weft={**yarn, "yarns": "3 /cm"})
    net = network((60.0, 60.0), coarse, origin=(0, 0))
    assert net.pitch[0] != net.pitch[1]
    laid = draped(net).laid
    along, across = (laid.ends[:, a] - laid.ends[:, a + 2] for a in (0, 1))
    sine = (
        (along * across).sum(axis=1)
        / np.linalg.norm(along, axis=1)
        / np.linalg.norm(across, axis=1)
    )
    shear = np.degrees(np.arcsin(sine))
    k = int(np.flatnonzero((net.crossover_ij == [6, 4]).all(axis=1))[0])  # 20 mm along both
    u = 20e-3 / (RADIUS + GAP)
    # s g'' + g' = cos g by its series: g = s - s^3/18 + ...
    s = u * u
    assert shear[k] == pytest.approx(np.degrees(s - s**3 / 18.0), abs=0.1)


def test_above_and_turned_tools():
    """A tool that looks down, and one that is turned, carry the same net."""
    net = network((50.0, 50.0), angle="20 deg", origin=(0, 0))
    below = draped(net).laid
    over = Tool(
        "ball",
        shapes.sphere(RADIUS),
        0.0,
        Pose(np.array([0.0, 0.0, RADIUS]), np.diag([1.0, -1, -1])),
    )
    above = draped(net, over, below=False).laid
    np.testing.assert_allclose(above.crossovers * [1, 1, -1], below.crossovers, atol=1e-12)
    np.testing.assert_allclose(above.ends * [1, 1, -1], below.ends, atol=1e-12)
    turn = np.array([[0.0, -1, 0], [0, 0, -1], [1, 0, 0]])
    turned = Tool("ball", shapes.sphere(RADIUS), 0.0, Pose(np.array([0.0, 0.0, -RADIUS]), turn))
    np.testing.assert_allclose(draped(net, turned).laid.crossovers, below.crossovers, atol=1e-12)


def test_given_lines():
    """Generators along the circles in which upright planes cut, given as lines in plan."""
    net = network((40.0, 40.0), origin=(0, 0))
    straight = draped(net, seed=[0, 10e-3], generators="upright").laid
    lines = {"warp_line": [[0, -20e-3], [0, 40e-3]], "weft_line": [[20e-3, 10e-3], [-20e-3, 10e-3]]}
    given = draped(net, seed=[0, 10e-3], **lines).laid
    first = np.round(10e-3 / net.pitch[0]) * net.pitch[0]
    assert given.seed[0][1] == pytest.approx(first)
    np.testing.assert_allclose(distances(given), GAP, atol=1e-12)
    # Chords of points a 64th of a link apart, moved onto the tool.
    at = abs(net.crossover_position[:, 0]) < 1e-9
    np.testing.assert_allclose(given.crossovers[at], straight.crossovers[at], atol=2e-6)
    bent = draped(net, warp_line=[[0, -30e-3], [0, 0], [15e-3, 30e-3]]).laid
    assert bent.laid.all()
    up = at & (net.crossover_position[:, 1] > 5e-3)
    place = bent.crossovers[up]
    np.testing.assert_allclose(place[:, 0], 0.5 * place[:, 1], atol=1e-6)
    with pytest.raises(
        InputError, match="warp_line does not lead through the place x = 0 mm, y = 0"
    ):
        draped(net, warp_line=[[10e-3, -30e-3], [10e-3, 30e-3]])


def test_limit_is_told_with_its_place():
    """Shear on a sphere grows towards the corners: there the net stops, and says where."""
    net = network((90.0, 90.0), origin=(0, 0))
    found = draped(net, locking_angle="30 deg")
    laid = found.laid
    lost = int((~laid.laid).sum())
    assert 0 < lost < net.num_crossovers_global
    total = net.num_crossovers_global
    assert laid.limit.startswith(f'{total - lost} of {total} crossovers are laid on tool "ball": ')
    assert "the net locks at x = " in laid.limit
    assert laid.limit.endswith("where it would shear by more than 30 deg")
    told = re.search(r"x = (\S+) mm, y = (\S+) mm of the flat blank", laid.limit)
    x, y = (1e-3 * abs(float(number)) for number in told.groups())
    # 30 degrees are reached at s = u v/R^2 = 0.533, s g'' + g' = cos g; links are 2 mm.
    assert x * y / (RADIUS + GAP) ** 2 == pytest.approx(0.533, rel=0.1)
    product = abs(net.crossover_position.prod(axis=1)) / (RADIUS + GAP) ** 2
    assert product[~laid.laid].min() > 0.4


def test_where_tools_end():
    """Off a plate's edge cloth goes down its side; off a height field it is told."""
    x = np.linspace(-20e-3, 20e-3, 21)
    field = Tool("skin", height_field(lambda x, y: 0.0 * x, x, x, cell=1e-3))
    laid = draped(network((30.0, 30.0)), field)
    assert laid.laid.beyond == 0
    assert not laid.remarks()
    laid = draped(network((60.0, 30.0)), field)
    assert laid.laid.beyond > 20
    assert 'crossovers are laid where tool "skin" has ended' in laid.remarks()[0]
    # Within the height of the skin, too, where its own box goes on below.
    ridge = height_field(lambda x, y: -(x**2) / 40e-3, x, x, cell=1e-3)
    assert draped(network((8.0, 36.0)), Tool("ridge", ridge)).laid.beyond == 0
    hanging = draped(network((8.0, 54.0)), Tool("ridge", ridge)).laid
    assert hanging.beyond == (abs(hanging.crossovers[:, 1]) > 20.25e-3).sum() > 2
    endless = Tool("table", shapes.plane())
    assert draped(network((2000.0, 20.0), yarns_per_cruciform=4), endless).laid.beyond == 0
    tube = Tool("tube", shapes.cylinder(20e-3), 0.0, Pose(np.array([0, 0, -20e-3])))
    assert draped(network((20.0, 900.0), yarns_per_cruciform=4), tube).laid.beyond == 0


def test_bad_seeds():
    """One sentence: beside the blank, beside the tool, where it is steep."""
    net = network((40.0, 40.0))
    with pytest.raises(InputError, match="seed, x = 50 mm, y = 0 mm, does not lie on the blank"):
        draped(net, seed=[50e-3, 0.0])
    with pytest.raises(InputError, match='tool "ball" is not met at x = 80 mm, y = 0 mm'):
        draped(net, place=[80e-3, 0.0])
    with pytest.raises(InputError, match='tool "ball" is too steep at x = 50.48 mm'):
        draped(net, place=[50.48e-3, 0.0])


def test_lattice_of_joints_is_twice_as_fine():
    """Joints are counted, those of holes and corners too where others follow from them."""
    net = network((30.0, 30.0), origin=(0, 0))
    rows = np.ptp(net.crossover_ij, axis=0) + 1
    found = lay(net, np.zeros(2, np.int64), LayTable()._start(net, ball(), True, GAP)[1], 1.5)
    assert found.joints == (2 * rows + 1).prod()


def test_lines_that_end_at_the_place_go_on_straight():
    """Or have points twice; one that is a point only is refused."""
    net = network((30.0, 30.0), origin=(0, 0))
    straight = draped(net, generators="upright").laid
    for line in ([[0, 0], [0, 0], [0, 10e-3]], [[0, -10e-3], [0, 0]]):
        laid = draped(net, warp_line=line).laid
        np.testing.assert_allclose(laid.crossovers, straight.crossovers, atol=1e-6)
    with pytest.raises(InputError, match="warp_line is a point, and has no direction"):
        draped(net, warp_line=[[0, 0], [0, 0]])
