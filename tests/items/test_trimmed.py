# SPDX-License-Identifier: MIT
"""Cloth that is cut off: what is left bears, what is gone does not; parts let go spring back."""

from dataclasses import replace

import numpy as np
import pytest
import shapely
from mpi4py import MPI
from support.formed import HARD, Gripped, cloth, formed, network, travel

from cruciform_petsc.cloth.preform import Preform
from cruciform_petsc.forming.blank import Blank, ContactSettings
from cruciform_petsc.forming.press import StagePlan
from cruciform_petsc.items.clamps import Clamp
from cruciform_petsc.items.loads import Suction
from cruciform_petsc.items.trimmed import LEFT, Trimmed, kept
from cruciform_petsc.net.network import Network
from cruciform_petsc.tools import shapes
from cruciform_petsc.tools.tool import Tool

FABRIC = cloth(bending="1 N mm", shear="50 N/m")
LENGTH, WIDTH = 30e-3, 8.4e-3  # of a quarter strip
SOFT = replace(HARD, viscosity=1e-2)
TRIM = StagePlan("trim", factors={"trim 0": 0.0}, step=0.25)


def right(rest):
    """The right-hand end of a strip."""
    return rest[:, 0] > rest[:, 0].max() - 1e-6


@pytest.mark.parametrize(
    ("box", "left"),
    [((-1, -6.3e-3, 1, 6.3e-3), 3 / 7), ((-10e-3, -1, 10e-3, 1), 0.0), ((-1, -1, 1, 1), 1.0)],
    ids=["lengthwise", "across", "nothing"],
)
def test_what_is_left_bears(box, left):
    """A strip of seven yarns, pulled, trimmed to three: 3/7 of the force; cut across, none."""
    net = network((50, 29.1), FABRIC, "90 deg")
    strip = Gripped(net, [], held=right, settings=SOFT, cuts={"trim 0": shapely.box(*box)},
                    further=[lambda ply: Clamp(ply, "left")])  # fmt: skip
    pull = StagePlan("pull", {"grip": travel(1e-4, 0, 0)}, step=0.5)
    steps, states = formed(strip, pull, TRIM)
    whole, cut = (-steps[i].clamp_force["left"][0] for i in (1, -1))
    assert whole == pytest.approx(52e3 * 29.1e-3 * 1e-4 / 50e-3, rel=1e-2)
    assert cut == pytest.approx(left * whole, rel=1e-2, abs=2e-3 * whole)
    ply, state = strip.ply, strip.of_cloth(states[-1])
    x, y = np.abs(net.crossover_position).T
    gone = (x > box[2]) | (y > box[3])
    np.testing.assert_array_equal(ply.fields(state)["carrying"], ply.supports.carrying & ~gone)
    # Half-way all of it bears half as much.
    half = strip.model.energies(states[3])
    assert states[3].factors["trim 0"] == 0.5
    if left == 0.0:
        assert half["tension"] < strip.model.energies(states[1])["tension"]


def test_gradients():
    """Energy -> force -> stiffness of an item that is half gone."""
    blank = Blank(network((25, 17), FABRIC, "30 deg"), [], settings=SOFT)
    bends, rng = blank.ply.bends, np.random.default_rng(1)
    rest = blank.ply.nodes.rest
    item = Trimmed(bends, rest[:, :2], {"cut": shapely.box(-1, -1, 1e-6, 1)}, slice(0, 3))
    x = rest + rng.normal(scale=3e-4, size=rest.shape)
    state = replace(blank.of_cloth(blank.start()), x=x, factors={"cut": 0.25})
    energy, force, stiffness = item.work(state, 2)
    bare = bends.work(state, 2)
    share = energy[:, 1] / bare[0][:, 1]
    assert set(np.round(share, 12)) == {0.25, 1.0}
    np.testing.assert_array_equal(share < 1.0, (rest[bends.nodes[:, :3], 0] > 1e-6).any(axis=1))
    np.testing.assert_allclose(force, share[:, None, None] * bare[1])
    np.testing.assert_allclose(stiffness, share[:, None, None, None, None] * bare[2])
    gone = item.work(replace(state, factors={"cut": 0.0}), 0)[0]
    np.testing.assert_allclose(gone[share < 1], LEFT * bare[0][share < 1])


def test_what_is_cut_off_dissipates_as_it_acts():
    """Friction of shear in cloth that is half gone takes half; what was spent before stays."""
    rubs = cloth(shear_friction={"torque": "5 N/m", "slip": "0.1 deg"})
    blank = Blank(network((25, 17), rubs, "30 deg"), [], settings=SOFT)
    shears, rest = blank.ply.cruciforms, blank.ply.nodes.rest
    item = Trimmed(shears, rest[:, :2], {"cut": shapely.box(-1, -1, 1e-6, 1)}, slice(4, 5))
    start = blank.of_cloth(blank.start())
    before = {"cruciforms": dict(start.memory["cruciforms"]) | {"spent": np.ones(len(shears.rows))}}
    x = rest.copy()
    x[:, 0] += 0.2 * rest[:, 1]
    state = replace(start, x=x, memory=before, factors={"cut": 0.25})
    bare, found = (of.accepted(state)["spent"] - 1.0 for of in (shears, item))
    assert (bare > 0.0).all()
    gone = rest[shears.nodes[:, 4], 0] > 1e-6
    np.testing.assert_allclose(found / bare, np.where(gone, 0.25, 1.0), rtol=1e-6)


def test_a_strip_springs_back():
    """A quarter, bent over a cylinder by suction, then let go: flat, its energy gone."""
    radius, pressure = 50e-3, 2e3
    around = radius + 0.5e-3
    corners = [(0.0, 0.0), (LENGTH, 0.0), (LENGTH, WIDTH), (0.0, WIDTH)]
    quarter = Preform.polygon(corners, bias_angle="90 deg", origin=(0, 0), yarns_per_cruciform=2)
    net = Network(MPI.COMM_SELF, quarter, FABRIC)

    def shape(rest):
        phi = rest[:, 0] / around
        return np.stack([around * np.sin(phi), rest[:, 1], around * np.cos(phi)], axis=1)

    core = Tool("core", shapes.cylinder(radius))
    blank = Gripped(net, [core], shape=shape, settings=ContactSettings(2e8, 1e-5, 1e-5, 2e3),
                    symmetry=("left", "lower"),
                    further=[lambda ply: Suction(ply, -pressure)])  # fmt: skip
    off = {"suction": 0.0, "core": 0.0}
    plans = [StagePlan("on", step=1.0), StagePlan("off", factors=off, step=0.2)]
    steps, states = formed(blank, *plans, StagePlan("rest", step=0.2))
    bent, last = (steps[i].increment.energies["out_of_plane_bending"] for i in (0, -1))
    # B/(2 R^2) over all but its ends, which are straight.
    assert bent == pytest.approx(1e-3 / (2 * around**2) * 0.9 * LENGTH * WIDTH, rel=0.1)
    assert last < 1e-5 * bent
    at = blank.cloth_at[blank.ply.active]
    assert np.ptp(states[0].x[at, 2]) > 7e-3
    assert np.ptp(states[-1].x[at, 2]) < 1e-4 * np.ptp(states[0].x[at, 2])
    assert abs(steps[-1].tool_force["core"]).max() < 1e-6


def test_what_is_being_cut_still_counts():
    """Only cuts that are done take cloth away."""
    places = np.array([[0.0, 0.0], [2.0, 0.0]])
    cuts = {"trim 0": shapely.box(-1, -1, 1, 1)}
    for factor, stays in ((1.0, True), (0.2, True), (0.0, False)):
        assert kept(places, cuts, {"trim 0": factor}).tolist() == [True, stays]
