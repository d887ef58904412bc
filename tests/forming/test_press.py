# SPDX-License-Identifier: MIT
"""Stages: how tools travel, turn and are pushed; what goes on from one stage to the next."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from support.formed import HARD, OVER, cloth, load, network

from cruciform_petsc.errors import InputError
from cruciform_petsc.forming.blank import Blank, ContactSettings, push_name
from cruciform_petsc.forming.press import Posture, Press, StagePlan
from cruciform_petsc.tools import shapes
from cruciform_petsc.tools.motion import Motion, Pose
from cruciform_petsc.tools.tool import Tool

TILTED = Pose(np.array([0.1, 0.2, 0.3]), OVER)


@pytest.fixture(scope="module")
def blank():
    """A small cloth, a bed and a holder that starts upside down."""
    tools = [Tool("bed", shapes.plane(), 0.2), Tool("holder", shapes.plane(), 0.1, TILTED)]
    pull = load(lambda rest: rest[:, 0] > 0.01, (1.0, 0.0, 0.0), factor=1.0)
    return Blank(network((25, 17)), tools, settings=HARD, further=[pull], weight=True)


def after(press, blank):
    """The posture at a stage's end, with tools where they are held."""
    hold, factors = press.drive(press.begin + 1.0)
    end = blank.start().at(hold, press.begin + 1.0, factors)
    return press.after(end.x[blank.tool_node])


def test_a_stage_drives_its_tools(blank):
    """Travel and turn by the share of the stage; a tool that is not named stays."""
    way, axis = np.array([0.0, 0.0, -0.05]), np.array([0.0, 0.0, 1.0])
    plan = StagePlan("draw", {"holder": lambda pose: Motion(pose, way, axis, angle=0.4)})
    press = Press(blank, plan, Posture.at_the_start(blank), 3.0)
    for share in (0.0, 0.25, 1.0):
        hold, factors = press.drive(3.0 + share)
        bed, holder = hold.place
        turn = Rotation.from_rotvec(0.4 * share * axis).as_matrix()
        np.testing.assert_allclose(bed, np.zeros(3))
        np.testing.assert_allclose(holder, turn @ TILTED.place + share * way, atol=1e-15)
        np.testing.assert_allclose(hold.rotations["holder"], turn @ OVER, atol=1e-15)
        assert hold.fixed.all()
        assert set(factors.values()) == {0.0}
    posture = after(press, blank)
    np.testing.assert_allclose(posture.poses[1].place, holder, atol=1e-15)
    np.testing.assert_allclose(posture.poses[1].turn, turn @ OVER, atol=1e-15)
    stage = press.stage(None)
    assert stage.targets == [4.0]
    assert (stage.carry_on, stage.step) == (False, 0.1)
    assert Press(blank, StagePlan("a", results=4), posture, 0.0).stage(None).targets == [
        0.25, 0.5, 0.75, 1.0,
    ]  # fmt: skip


def test_forces_and_factors_go_on(blank):
    """From what they were to what they shall be, along the axes that have a force; then they stay.

    A motion takes a tool back from its force.
    """
    start = Posture.at_the_start(blank)
    name = push_name("holder", 2)
    plan = StagePlan("close", forces={"holder": np.array([0.0, 0.0, -8.0])}, factors={"pull": 3.0})
    press = Press(blank, plan, start, 0.0)
    hold, factors = press.drive(0.25)
    assert hold.fixed.tolist() == [[True] * 3, [True, True, False]]
    assert (factors[name], factors["pull"]) == (-2.0, 1.5)  # loads are whole before
    np.testing.assert_array_equal(press.push(0.25), [[0, 0, 0], [0, 0, -2.0]])
    posture = after(press, blank)
    second = Press(blank, StagePlan("wait"), posture, 1.0)
    for time in (1.0, 1.5, 2.0):
        hold, factors = second.drive(time)
        assert (factors[name], factors["pull"]) == (-8.0, 3.0)
        assert not hold.fixed[1, 2]
    more = StagePlan("more", forces={"holder": np.array([0.0, 1.0, -2.0])}, factors={"holder": 0})
    third = Press(blank, more, after(second, blank), 2.0)
    assert third.drive(2.5)[1][name] == -5.0
    assert third.drive(2.5)[1][push_name("holder", 1)] == 0.5
    assert third.drive(2.5)[1]["holder"] == 0.5
    assert third.drive(2.5)[0].fixed[1].tolist() == [True, False, False]
    lift = StagePlan("lift", {"holder": lambda pose: Motion(pose, np.array([0.0, 0.0, 0.1]))})
    last = Press(blank, lift, after(third, blank), 3.0)
    hold, factors = last.drive(3.5)
    assert hold.fixed.all()
    # The holder's force fades with its stage, and moves nothing, as the tool is held.
    assert last.push(4.0).any() == np.False_
    assert last.drive(4.0)[1]["holder"] == 0.0


def test_what_acts_before_the_first_stage():
    """A load that is not on yet stays off until a stage names it."""
    pull = load(lambda rest: rest[:, 0] > 0.01, (1.0, 0.0, 0.0), factor=1.0)
    later = Blank(network((25, 17)), [], settings=HARD, further=[pull], factors={"pull": 0.0})
    assert later.model.force(later.start())[1].any() == np.False_
    first = Press(later, StagePlan("wait"), Posture.at_the_start(later), 0.0)
    assert first.drive(0.5)[1] == {"pull": 0.0}
    second = Press(later, StagePlan("pull", factors={"pull": 2.0}), after(first, later), 1.0)
    assert second.drive(1.25)[1] == {"pull": 0.5}


def test_contact_that_suits_a_fabric():
    """1 % of strain over ten thicknesses compacts cloth by half its thickness on either side."""
    fabric = cloth()
    settings = ContactSettings.of(fabric, 0.02)
    t, stiffness = 1e-3, 52e3
    pressure = 0.01 * stiffness / (10 * t)
    assert settings.stiffness * 0.5 * t == pytest.approx(pressure)
    assert (settings.width, settings.slip) == pytest.approx((0.2 * t, 0.01 * t))
    # A tenth of the time of a cantilever's first mode, and so that the sheet does not float away.
    slowest = 1e-7 * (1.8751 / 0.02) ** 4
    assert settings.viscosity == pytest.approx(0.1 * slowest + 1e-8 * stiffness / 4e-4, rel=1e-3)
    # A load alone would move the blank by its length in a tenth of a stage.
    pushed = ContactSettings.of(fabric, 0.02, 300.0)
    assert pushed.viscosity - settings.viscosity == pytest.approx(0.1 * 300.0 / 0.02)
    net = network((25, 16), fabric)
    blank = Blank(net, [Tool("bed", shapes.plane())])
    assert blank.settings == ContactSettings.of(fabric, 25e-3)


def test_a_blank_among_tools(blank):
    """It lies on z = 0; its nodes stand for all of its area; its weight is its density's."""
    cloth_rest = blank.nodes.rest[blank.cloth_at]
    assert set(cloth_rest[:, 2]) == {0.5e-3}
    np.testing.assert_array_equal(blank.nodes.rest[blank.tool_node], [[0, 0, 0], TILTED.place])
    assert blank.area.sum() == pytest.approx(25e-3 * 17e-3, rel=1e-12)
    # Hinges and the ends of arms between them share it alike: a quadrant's third each.
    pitch = blank.network.pitch
    inner = (abs(cloth_rest[blank.touching, :2]) < [12.5e-3, 8.5e-3] - pitch).all(axis=1)
    assert inner.sum() > 20
    np.testing.assert_allclose(blank.area[inner], pitch[0] * pitch[1] / 3, rtol=1e-9)
    state = blank.start()
    loads = blank.model.force(state)[1]
    weight = 0.5 * 25e-3 * 17e-3 * 9.80665
    np.testing.assert_allclose(loads.sum(axis=0), [-1.0, 0.0, weight], rtol=1e-9)
    assert blank.spent(state) == {"friction": 0.0, "viscous": 0.0}


@pytest.mark.parametrize("lacks", ["thickness", "out_of_plane_bending", "areal_density"])
def test_what_a_blank_needs(lacks):
    """A sentence that says what is missing and what it would be."""
    fabric = (
        cloth(**{lacks: None}) if lacks != "out_of_plane_bending" else cloth(bending=(None,) * 2)
    )
    with pytest.raises(InputError, match=lacks):
        Blank(network((25, 17), fabric), [], weight=True)
