# SPDX-License-Identifier: MIT
"""What is measured on states: headlines that mean what they say."""

import numpy as np
import pytest
from mpi4py import MPI
from support.helpers import DIAGONAL, PITCH, TABLE_1, UNEVEN, diagonals, holed, l_shape

from cruciform_petsc.cloth.preform import Preform
from cruciform_petsc.experiments.bias_extension import BiasExtension
from cruciform_petsc.experiments.biaxial import Biaxial
from cruciform_petsc.net.lattice import QUADRANTS
from cruciform_petsc.net.network import Network
from cruciform_petsc.parallel import quantile

BOTH = pytest.mark.parametrize("finite", [False, True], ids=["small", "finite"])


def network(preform, fabric=TABLE_1):
    return Network(MPI.COMM_SELF, preform, fabric)


@BOTH
@pytest.mark.parametrize(
    ("outline", "there"),
    [
        (holed(0.03, 0.05, 0.008, np.pi / 4), False),
        (l_shape(0.05, 0.5), False),  # the middle is beside both legs
        (holed(0.03, 0.05, 0.001, np.pi / 4), False),  # a hole that no crossover misses
        (diagonals(4, 8), True),
    ],
    ids=["hole", "L", "pinhole", "cloth"],
)
def test_no_angle_at_the_centre_of_a_hole(outline, there, finite):
    result = BiasExtension(network(outline), "0.05 mm", bending=False, finite=finite).solve()
    assert np.isfinite(result.shear_angle_centre) == there
    assert np.isfinite(result.curve()["shear_centre_deg"]).all() == there
    assert np.isfinite(result.shear_angle_max)


def test_a_half_specimen_has_its_centre_on_its_edge():
    half = BiasExtension(
        network(diagonals(4, 4)), "0.05 mm", upper="centre-line", finite=False
    ).solve()
    assert np.isfinite(half.shear_angle_centre)


@BOTH
@pytest.mark.parametrize("across", [5.5, 6.25])
def test_yarns_at_free_edges_shear_as_those_beside(across, finite):
    """Tails of soft yarns turn back; the yarns at the hinges there do not.

    In the band between the clamps' triangles the shear hardly changes from yarn to yarn; the mean
    over the quadrants at the edge is half of it.
    """
    net = network(diagonals(across, 18))
    result = BiasExtension(net, "4 mm", finite=finite).solve()
    x, y = net.crossover_position.T
    band = abs(y - y.mean()) < 0.6 * DIAGONAL
    edge = band & (abs(x) > abs(x[band]).max() - 0.1 * PITCH)
    inside = band & (abs(x) < 0.3 * np.ptp(x))
    angle, fields = result.fields["shear_angle"], result.fields
    quadrants = fields["arm_rotation"][:, QUADRANTS] @ [1.0, -1.0]
    mean = (net.quadrant_area * quadrants).sum(axis=1) / net.quadrant_area.sum(axis=1)
    assert mean[edge].max() < 0.9 * angle[inside].min()  # what was told
    np.testing.assert_allclose(angle[edge], angle[inside].mean(), rtol=0.2)
    # Where all arms lead on, the angle between the yarns is the mean.
    whole = np.ones(len(angle), bool)
    whole[net.boundary_crossovers] = False
    np.testing.assert_allclose(angle[whole], mean[whole], atol=1e-13)


def test_shares_of_arms_at_the_hinge():
    """Half and half where a yarn goes on; all of the arm that leads into the cloth at an edge."""
    net = network(diagonals(5.5, 9.3))
    result = BiasExtension(net, "1 mm", finite=False).solve()
    share = result.supports.hinge_share
    rows = net.boundary_crossovers
    length, shared = net.arm_length[rows], net.arm_is_shared[rows]
    carrying = result.supports.carrying[rows]
    np.testing.assert_allclose((share + share[:, [2, 3, 0, 1]])[carrying], 1.0)
    y = net.crossover_position[rows, 1]
    at_side = carrying & (abs(y - y.mean()) < 0.2 * np.ptp(y))
    tail = (length > 0) & ~shared & at_side[:, None]
    assert tail.any()
    assert (share[tail] == 0.0).all()
    clamped = (length > 0) & ~shared & (carrying & (y < 0.4 * DIAGONAL))[:, None]
    assert clamped.any()
    assert (share[clamped] == 0.5).any()


@pytest.mark.parametrize("fabric", [TABLE_1, UNEVEN], ids=["table-1", "uneven"])
def test_quantile_weighted_by_area(fabric):
    """Beside the largest angle that which 99 % of the cloth's area do not exceed."""
    net = network(Preform.rectangle("31 mm", "52 mm", "38 deg", refine=4), fabric)
    result = BiasExtension(net, ["0.1 mm", "0.2 mm"], finite=False).solve()
    area, angle = net.quadrant_area.sum(axis=1), abs(result.fields["shear_angle"])
    carrying = result.fields["carrying"]
    order = np.argsort(angle[carrying])
    share = np.cumsum(area[carrying][order]) / area[carrying].sum()
    expected = np.rad2deg(angle[carrying][order][np.searchsorted(share, 0.99)])
    curve = result.curve()
    assert curve["shear_99_deg"][-1] == pytest.approx(expected, rel=1e-12)
    assert curve["shear_99_deg"][0] < curve["shear_max_deg"][0]
    # A crossover cut by the edge is less than a whole one.
    shares = [0.2, 0.35, 0.5, 0.65, 0.8]
    by_area, by_number = (
        [quantile(net.comm, angle, s, weight) for s in shares]
        for weight in (result.area_weight, None)
    )
    expected = angle[carrying][order][np.searchsorted(share, shares)]
    assert by_area == pytest.approx(expected, rel=1e-12)
    assert by_area != by_number


@BOTH
def test_biaxial_tests_have_two_forces_and_no_load(finite):
    net = network(Preform.rectangle(6 * PITCH, 5 * PITCH, 0.0))
    result = Biaxial(net, ["0.1 %", "0.2 %"], ratio=0.5, finite=finite).solve()
    for curve in (result.curve(), result.curve(states=True)):
        assert not any("load" in name for name in curve)
    assert list(result.forces) == ["force_warp_N", "force_weft_N"]
    assert (result.forces["force_warp_N"] > result.forces["force_weft_N"]).all()
    with pytest.raises(AttributeError, match="has no load, its forces are force_warp_N and force_"):
        _ = result.load
    assert not hasattr(result, "loads")
    assert f"{result.forces['force_weft_N'][-1]:.4g} N" in repr(result)
