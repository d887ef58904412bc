# SPDX-License-Identifier: MIT
"""Clamps with springs: gradients, a line of springs, slip, preload, letting go."""

from dataclasses import replace

import numpy as np
import pytest
from mpi4py import MPI
from support.finite import Cloth
from support.formed import HARD, Gripped, cloth, formed, network, travel
from support.helpers import UNEVEN, l_shape
from support.kernels import differences

from cruciform_petsc.forming.blank import Blank
from cruciform_petsc.forming.press import StagePlan
from cruciform_petsc.items.clamps import Clamp
from cruciform_petsc.net.edges import Constraints
from cruciform_petsc.net.network import Network

SOFT = replace(HARD, viscosity=1e-3)
FABRIC = cloth(bending="1 N mm", shear="5 kN/m")  # no wrinkles
LENGTH, WIDTH = 50e-3, 16.5e-3
STRIP = (1e3 * LENGTH, 1e3 * WIDTH)
# All along x, without cross contraction: of cloth, N/m.
K_CLOTH = 52e3 * WIDTH / LENGTH


def right(rest):
    """The right-hand end of a strip."""
    return rest[:, 0] > rest[:, 0].max() - 1e-6


def clamped(*arguments, edge="left", **options):
    """Makes a clamp of a ply."""
    return lambda ply: Clamp(ply, edge, *arguments, **options)


@pytest.mark.parametrize(
    "options",
    [
        {"stiffness": (3e3, False)},
        {"stiffness": (2e5, True), "preload": (2.0, False)},
        {"stiffness": (3e3, False), "limit": (0.5, False)},
        {"slides": True},
    ],
    ids=["spring", "preload", "slip", "slides"],
)
def test_gradients(options):
    """Energy -> force -> stiffness of a clamp by itself, on an L with oblique yarns."""
    constraints = Constraints(Network(MPI.COMM_SELF, l_shape(0.045, 1.2), UNEVEN), True)
    ply = Cloth(constraints, {"lower": constraints.clamp("lower")}, (1e-3, 4e-4), False).ply
    item = Clamp(ply, "right", **options)
    assert len(item.nodes) > 4
    x = ply.nodes.rest[item.nodes[:, 0]] + np.random.default_rng(2).normal(
        scale=1e-3, size=(len(item.nodes), 3)
    )

    class At:
        factors, memory = {"clamp right": 0.7, "preload right": 0.4}, {}

        def __init__(self, x):
            self.x = ply.nodes.rest.copy()
            self.x[item.nodes[:, 0]] = x[:, 0]

    energy, force, stiffness = item.work(At(x[:, None]), 2)
    assert abs(energy).max() > 0.0
    found = differences(lambda x: item.work(At(x), 0)[0][:, 0], x[:, None], 1e-8)
    np.testing.assert_allclose(found, force, atol=1e-6 * abs(force).max())
    slope = differences(lambda x: item.work(At(x), 1)[1], x[:, None], 1e-8)
    np.testing.assert_allclose(slope, stiffness, atol=1e-5 * abs(stiffness).max())


@pytest.mark.parametrize("told", [(3e3, False), (3e3 / WIDTH, True)], ids=["whole", "per width"])
def test_a_line_of_springs(told):
    """Spring and cloth one after the other: F = d/(1/k + 1/K), the same at each yarn's share."""
    strip = Gripped(network(STRIP, FABRIC, "90 deg"), [], held=right, settings=SOFT,
                    further=[clamped(told)])  # fmt: skip
    way = 1e-4
    steps, states = formed(strip, StagePlan("pull", {"grip": travel(way, 0, 0)}, step=0.25))
    force = way / (1 / 3e3 + 1 / K_CLOTH)
    assert strip.on_grip(states[-1])[0] == pytest.approx(force, rel=2e-3)
    assert steps[-1].clamp_force["left"] == pytest.approx([-force, 0, 0], rel=2e-3, abs=1e-6)
    (item,) = strip.clamps
    pulls = strip.pulls(states[-1])["clamp left"][strip.cloth_at[item.nodes[:, 0]], 0]
    # Each yarn end has the share of the edge that it stands for.
    np.testing.assert_allclose(pulls / pulls.sum(), item.stiffness / 3e3, rtol=1e-2)
    assert item.stiffness.sum() == pytest.approx(3e3)


def test_what_is_held_stays():
    """Without a stiffness the edge stays, to a thousandth of what its cloth gives."""
    strip = Gripped(network(STRIP, FABRIC, "90 deg"), [], held=right, settings=SOFT,
                    further=[clamped()])  # fmt: skip
    steps, states = formed(strip, StagePlan("pull", {"grip": travel(1e-4, 0, 0)}, step=0.5))
    (item,) = strip.clamps
    at = strip.cloth_at[item.nodes[:, 0]]
    assert abs(states[-1].x[at] - strip.nodes.rest[at]).max() < 1e-3 * 1e-4
    assert steps[-1].clamp_force["left"][0] == pytest.approx(-K_CLOTH * 1e-4, rel=2e-3)


def test_slip_and_its_energy():
    """Beyond its limit a clamp slips at the limit; below it nothing creeps; the work adds up."""
    limit, stiffness = 2.0, 2e4
    strip = Gripped(
        network(STRIP, FABRIC, "90 deg"), [], held=right, settings=SOFT,
        further=[clamped((stiffness, False), limit=(limit, False))],
    )  # fmt: skip
    below = 0.9 * limit * (1 / stiffness + 1 / K_CLOTH)
    wait = StagePlan("wait", step=1.0, results=50)
    pull = StagePlan("pull", {"grip": travel(1e-3, 0, 0)}, step=0.05)
    steps, states = formed(
        strip, StagePlan("below", {"grip": travel(below, 0, 0)}, step=0.25), wait, pull
    )
    forces = np.array([step.clamp_force["left"][0] for step in steps])
    np.testing.assert_allclose(forces[3:54], -0.9 * limit, rtol=2e-3)
    assert np.ptp(forces[3:54]) < 1e-6 * limit
    assert forces[-1] == pytest.approx(-limit, rel=1e-6)
    last = steps[-1]
    slipped, rubbed = strip.slipped(states[-1])
    assert slipped["left"] == pytest.approx(1e-3 + below - limit * (1 / stiffness + 1 / K_CLOTH),
                                            rel=2e-3)  # fmt: skip
    assert rubbed["left"] == pytest.approx(limit * slipped["left"], rel=1e-2)
    energies = last.increment.energies
    # Of the grip, which is held: trapezia of its force over its way.
    grip = np.array([0.0, *(strip.on_grip(state)[0] for state in states)])
    place = np.array([0.0, *(step.tool_place["grip"][0] for step in steps)])
    work = (0.5 * (grip[1:] + grip[:-1]) * np.diff(place)).sum()
    stored = energies["tension"] + energies["bending"] + energies["clamps"]
    assert work == pytest.approx(stored + rubbed["left"], rel=1e-2)
    # The cloth's part of it: what the clamp has taken counts as negative work on it.
    assert last.load_work["clamp left"] == pytest.approx(-energies["clamps"] - rubbed["left"],
                                                         rel=1e-2)  # fmt: skip


def test_preload_and_release():
    """Two springs of k with a preload P on cloth of K: P/(1 + k/(2 K)); let go, all is at rest."""
    preload, stiffness = 5.0, 4e3
    springs = [clamped((stiffness, False), (preload, False), edge=e) for e in ("left", "right")]
    factors = {"preload left": 0.0, "preload right": 0.0}
    blank = Blank(network(STRIP, FABRIC, "90 deg"), [], settings=SOFT, further=springs,
                  factors=factors)  # fmt: skip
    on = StagePlan("on", factors=dict.fromkeys(factors, 1.0), step=0.25)
    off = StagePlan("off", factors={"clamp left": 0.0, "clamp right": 0.0}, step=0.25)
    steps, _ = formed(blank, on, off)
    tension = preload / (1 + stiffness / (2 * K_CLOTH))
    assert steps[3].clamp_force["right"][0] == pytest.approx(tension, rel=2e-3)
    assert steps[3].clamp_force["left"][0] == pytest.approx(-tension, rel=2e-3)
    assert abs(steps[-1].clamp_force["left"]).max() < 1e-9
    assert steps[-1].increment.energies["tension"] < 1e-3 * steps[3].increment.energies["tension"]
