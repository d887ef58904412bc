# SPDX-License-Identifier: MIT
"""Cloth that is held: between flat plates, on a slope, on plates that turn and move."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from support.formed import HARD, OVER, THICKNESS, Gripped, cloth, formed, load, network, travel

from cruciform_petsc.forming.blank import Blank, ContactSettings
from cruciform_petsc.forming.press import StagePlan
from cruciform_petsc.items.contact import Contact
from cruciform_petsc.tools import shapes
from cruciform_petsc.tools.motion import Motion, Pose
from cruciform_petsc.tools.tool import Tool

FORCE, MU = 4.0, 0.2  # of a holder, N
CLOSE = StagePlan("close", forces={"holder": np.array([0.0, 0.0, -FORCE])}, step=1.0)

STIFF = cloth(shear="20 kN/m")  # so that all of it slips after a little way
PULL = StagePlan("pull", factors={"pull": 1.0}, step=0.25)


def plates(friction=MU):
    """A bed and a holder upon it."""
    above = Pose(np.array([0.0, 0.0, THICKNESS]), OVER)
    return [
        Tool("bed", shapes.plane(), friction),
        Tool("holder", shapes.plane(), friction, above),
    ]


def right(rest):
    """The right-hand end of a strip."""
    return rest[:, 0] > rest[:, 0].max() - 1e-6


@pytest.mark.parametrize("pitches", [2, 1])
def test_a_ply_is_pulled_from_between_plates(pitches):
    """2 mu N within 0.2 % at any time, whatever the pitch; the holder's force is exact."""
    net = network((50, 16), STIFF, yarns_per_cruciform=pitches)
    strip = Gripped(net, plates(), held=right, axes=(True, True, False), settings=HARD)
    pull = StagePlan("pull", {"grip": travel(4e-3, 0, 0)}, step=0.1)
    steps, states = formed(strip, CLOSE, pull)
    for step, state in list(zip(steps, states, strict=True))[-7:]:
        assert strip.on_grip(state)[0] == pytest.approx(2 * MU * FORCE, rel=2e-3)
        assert strip.on_grip(state)[1] == pytest.approx(0.0, abs=1e-3)
        force = strip.model.force(state)[0][strip.tool_node]
        # What is left of a free tool's force is what is not balanced.
        assert abs(force[1, 2]) < 1e-3 * FORCE
        assert step.tool_force["bed"][2] == pytest.approx(FORCE, rel=1e-3)


@pytest.mark.parametrize(("share", "slides"), [(0.9, False), (1.1, True)])
def test_a_ply_held_between_plates_does_not_creep(share, slides):
    """Below 2 mu N it stays for 200 steps; above it slides, as fast as viscosity lets it."""
    net = network((25, 8.4), STIFF, yarns_per_cruciform=2)
    settings = replace(HARD, viscosity=1e5)
    pull = share * 2 * MU * FORCE
    blank = Blank(
        net,
        plates(),
        settings=settings,
        further=[load(right, (pull, 0.0, 0.0))],
        factors={"pull": 0.0},
    )
    wait = StagePlan("wait", step=1.0, results=200)
    _, states = formed(blank, CLOSE, PULL, wait)
    last = [state.x[blank.cloth_at[blank.ply.active], 0] for state in states]
    moved = last[-1] - last[-100]
    if slides:
        # The pull is out of balance by a tenth of what friction bears; the cloth flows by it.
        speed = 0.1 * 2 * MU * FORCE / (settings.viscosity * blank.area.sum())
        assert moved.mean() == pytest.approx(speed * 99 / 200, rel=1e-2)
    else:
        assert last[-200].max() > 1e-5 + last[0].max()  # it has slipped to get there
        assert abs(moved).max() < 1e-4 * HARD.slip


@pytest.mark.parametrize("slope", [0.9, 1.1])
def test_a_slope(slope):
    """Cloth on a plate that tilts goes with it; it holds while tan(slope) < mu, else slides."""
    tilt = np.arctan(slope * MU)
    settings = ContactSettings(2e7, 2e-4, 1e-6, 20.0)
    blank = Blank(
        network((25, 17), yarns_per_cruciform=2), plates()[:1], weight=True, settings=settings
    )
    lay = StagePlan("lay", step=1.0)
    turn = StagePlan("tilt", {"bed": lambda p: Motion(p, axis=[0, 1, 0], angle=tilt)}, step=0.05)
    wait = StagePlan("wait", step=1.0, results=100)
    _, states = formed(blank, lay, turn, wait)
    down = Rotation.from_rotvec([0.0, tilt, 0.0]).as_matrix()
    at = blank.cloth_at[blank.ply.active]
    # Along the plate over the last 90 steps of rest.
    moved = ((states[-1].x[at] - states[-91].x[at]) @ down)[:, :2]
    weight = 9.80665 * 0.5  # N/m^2
    if slope < 1.0:
        np.testing.assert_allclose(states[-1].x[at], states[0].x[at] @ down.T, atol=2e-6)
        assert abs(moved).max() < 1e-4 * settings.slip
    else:
        speed = 0.9 * weight * (np.sin(tilt) - MU * np.cos(tilt)) / settings.viscosity
        assert moved[:, 0].mean() == pytest.approx(speed, rel=5e-3)
        assert np.ptp(moved[:, 0]) < 1e-2 * speed


def test_a_plate_carries_cloth_along():
    """Cloth that lies on a plate by friction turns and moves with it, as one body, at no cost."""
    way, through = np.array([0.05, -0.02, 0.03]), [0.1, 0.0, 0.0]
    plan = StagePlan("carry", {"bed": lambda p: Motion(p, way, [0, 0, 1], through, 1.2)}, step=0.05)
    settings = replace(HARD, viscosity=0.2)  # its drag, 0.2 N s/m^3 x 0.1 m/s, is below mu g m
    net = network((25, 17), yarns_per_cruciform=2)
    blank = Blank(net, plates()[:1], weight=True, settings=settings)
    steps, states = formed(blank, StagePlan("lay", step=1.0), plan)
    end = plan.motions["bed"](Pose()).at(1.0)
    at = blank.cloth_at[blank.ply.active]
    np.testing.assert_allclose(states[-1].x[at], end.to_lab(states[0].x[at]), atol=1e-5)
    np.testing.assert_allclose(steps[-1].tool_place["bed"], end.place, atol=1e-12)
    # From where it lay Newton's method takes 25 steps or more each time.
    assert len(steps) == 21
    assert sum(step.increment.iterations for step in steps) < 60


def test_a_tool_is_pushed_by_a_force_and_taken_away():
    """A free holder comes down on the cloth and bears its force; without contact it is no more."""
    net = network((50, 17), yarns_per_cruciform=2)
    tools = plates()
    blank = Blank(net, tools, settings=HARD)
    lift = StagePlan("lift", factors={"holder": 0.0}, forces={"holder": np.zeros(3)}, step=0.2)
    steps, states = formed(blank, CLOSE, lift)
    pressed = [state.memory["bed"]["pressed"].sum() for state in states]
    assert pressed[0] == pytest.approx(FORCE, rel=1e-3)
    assert states[0].memory["holder"]["pressed"].sum() == pytest.approx(FORCE, rel=1e-3)
    assert pressed[-1] == pytest.approx(0.0, abs=1e-3 * FORCE)
    assert states[-1].memory["holder"]["pressed"].sum() == 0.0
    assert np.isnan(states[-1].memory["holder"]["anchor"]).all()
    # It stays where it was left, free of all force.
    assert steps[-1].tool_force["holder"] == pytest.approx(np.zeros(3), abs=1e-9)


def test_cloth_touches_and_is_pulled_at_once():
    """A holder closes while a pull below 2 mu N grows, in a single step: cloth slips elastically.

    Friction that holds what touches anew only from where it lies by then let it slide for
    millimetres, as nothing but viscosity kept it back till then.
    """
    net = network((25, 8.4), STIFF, yarns_per_cruciform=2)
    pull = load(right, (0.9 * 2 * MU * FORCE, 0.0, 0.0))
    blank = Blank(net, plates(), settings=HARD, further=[pull], factors={"pull": 0.0})
    at_once = replace(CLOSE, factors={"pull": 1.0})
    _, states = formed(blank, at_once)
    at = blank.cloth_at[blank.ply.active]
    moved = abs(states[-1].x[at] - blank.nodes.rest[at])[:, :2]
    assert moved.max() < 6 * HARD.slip  # the slip, what the strip stretches by and shears
    assert states[-1].memory["bed"]["spent"].sum() < 2e-5 * 2 * MU * FORCE


def test_cloth_touches_on_its_way():
    """A node that comes to a plate within a step is anchored where its way met the plate."""
    contact = Contact(
        "bed", shapes.plane(), np.array([0]), 1, np.array([1e-5]), 0.0, 2e7, 2e-4, MU, 1e-5
    )
    hold = SimpleNamespace(rotations={})

    def at(place, memory):
        x = np.array([place, [0.0, 0.0, 0.0]])
        return SimpleNamespace(x=x, hold=hold, factors={}, memory=memory)

    above = contact.accepted(at([0.0, 0.0, 3e-3], {}))
    assert np.isnan(above["anchor"]).all()
    below = at([4e-3, 8e-3, -1e-3], {"bed": above})
    for _ in range(2):  # as often as it is asked
        memory = contact.lagged(below)[0]
        np.testing.assert_allclose(memory["anchor"], [[3e-3, 6e-3, 0.0]], atol=1e-12)
        below.memory = {"bed": memory}
    # It slides on from there, all but the elastic slip; lifted, it forgets.
    slid = contact.accepted(below)
    np.testing.assert_allclose(slid["anchor"][0, :2], [4e-3, 8e-3], atol=1.01e-5)
    assert slid["spent"].sum() == pytest.approx(
        MU * memory["pressed"][0] * (np.hypot(1e-3, 2e-3) - 1e-5)
    )
    lifted = contact.accepted(at([4e-3, 8e-3, 1e-3], {"bed": slid}))
    assert np.isnan(lifted["anchor"]).all()
    assert lifted["fresh"].all()
