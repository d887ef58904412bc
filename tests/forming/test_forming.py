# SPDX-License-Identifier: MIT
"""A whole forming: energies, forces, what is kept of its steps."""

from dataclasses import replace

import numpy as np
import pytest
from support.formed import HARD, formed, hemisphere, network, travel

from cruciform_petsc.equilibrium import lagged
from cruciform_petsc.errors import EquilibriumError
from cruciform_petsc.forming import forming as steps_of
from cruciform_petsc.forming.blank import Blank
from cruciform_petsc.forming.forming import form
from cruciform_petsc.forming.press import StagePlan
from cruciform_petsc.tools import shapes
from cruciform_petsc.tools.motion import Motion
from cruciform_petsc.tools.tool import Tool

STORED = ("tension", "shear", "bending", "out_of_plane_bending", "contact", "friction")


def test_energy_balance():
    """Work of the tools = stored + rubbed + flowed, within 1 %, over 50 steps of a hemisphere."""
    blank, plans = hemisphere(steps=40, close=10, settings=replace(HARD, viscosity=1000.0))
    steps, _ = formed(blank, *plans)
    assert len(steps) >= 50
    last = steps[-1]
    # What is stored, friction's elastic slip with it; none of viscosity's.
    stored = sum(last.increment.energies[mode] for mode in STORED)
    assert last.increment.energies["viscous"] == 0.0
    spent = last.spent
    assert last.work == pytest.approx(stored + sum(spent.values()), rel=1e-2)
    # Each of them counts: none is less than what the balance is right to.
    assert min(stored, *spent.values()) > 0.03 * last.work
    assert last.tool_force["holder"][2] == -20.0
    assert last.tool_place["punch"][2] == pytest.approx(1e-3, abs=1e-12)


def test_viscosity_and_steps_do_not_matter():
    """Half the viscosity, twice the steps: punch force within 1 %, shear within 0.3 deg."""
    found = []
    for steps, viscosity in ((10, 20.0), (10, 10.0), (20, 20.0)):
        blank, plans = hemisphere(steps=steps, settings=replace(HARD, viscosity=viscosity))
        done = formed(blank, *plans)[0]
        # A third more where each step begins with the cloth moved along with the punch.
        assert sum(step.increment.iterations for step in done) < 9 * len(done)
        last = done[-1]
        # What tools push, they push against each other, but for the viscosity of all the cloth.
        drag = viscosity * (2 * blank.area.sum()) * 20e-3
        assert sum(last.tool_force.values()) == pytest.approx(np.zeros(3), abs=drag + 0.01)
        found.append((last.tool_force["punch"][2], np.degrees(last.increment.shear_max)))
    assert found[0][0] < -3.0
    assert found[0][1] > 20.0
    for force, shear in found[1:]:
        assert force == pytest.approx(found[0][0], rel=1e-2)
        assert shear == pytest.approx(found[0][1], abs=0.3)


def test_it_does_not_matter_which_tool_moves():
    """A die that comes up with its holder does what a punch does that comes down."""
    found = []
    for mover, way in (("punch", -20e-3), ("die", 20e-3)):
        # All that moves drags a little, here the sheet, there the punched part.
        blank, plans = hemisphere(settings=replace(HARD, viscosity=0.2))
        move = {mover: travel(0.0, 0.0, way)}
        steps, states = formed(blank, plans[0], replace(plans[1], motions=move))
        place = states[-1].x[blank.cloth_at] - steps[-1].tool_place["die"]
        found.append((steps[-1], place))
    (step, place), (other, there) = found
    np.testing.assert_allclose(there, place, atol=2e-5)
    for tool, force in step.tool_force.items():
        np.testing.assert_allclose(other.tool_force[tool], force, atol=0.03)
    assert other.work == pytest.approx(step.work, rel=5e-3)


def test_a_quarter_between_planes_of_symmetry(monkeypatch):
    """A quarter of the force, the same shape and shear as the whole."""
    monkeypatch.setattr(steps_of, "RESIDUAL", 1e-9)
    monkeypatch.setattr(lagged, "SETTLED", 1e-7)
    found = []
    for quarter in (False, True):
        blank, plans = hemisphere(quarter=quarter)
        steps, states = formed(blank, *plans)
        moved = blank.ply.displacement(blank.of_cloth(states[-1]))[0]
        at = blank.network.crossover_position
        mine = (at > -1e-9).all(axis=1)
        order = np.lexsort(np.round(at[mine], 9).T)
        shear = blank.ply.fields(blank.of_cloth(states[-1]))["shear_angle"]
        found.append((steps[-1], moved[mine][order], shear[mine][order]))
    (whole, moved, shear), (part, quarter, sheared) = found
    assert len(quarter) == 36
    assert abs(shear).max() > 0.4
    np.testing.assert_allclose(quarter, moved, atol=1e-6 * 20e-3)
    np.testing.assert_allclose(sheared, shear, atol=1e-5)
    for tool, force in whole.tool_force.items():
        assert 4 * part.tool_force[tool][2] == pytest.approx(force[2], rel=1e-6)
    assert 4 * part.work == pytest.approx(whole.work, rel=1e-3)


def test_what_is_kept():
    """All steps; of the states those asked for and the last; after an error what there was."""
    blank = Blank(network((25, 17)), [Tool("bed", shapes.plane())], settings=HARD)
    way = {"bed": lambda pose: Motion(pose, np.array([0.0, 0.0, 1e-3]))}
    result = form(blank, [StagePlan("up", way, step=0.125, results=2)])
    assert [step.increment.control for step in result.steps] == pytest.approx(np.arange(1, 9) / 8)
    assert [state.time for state in result.states] == [0.5, 1.0]
    # A crossing of two rigid tools cannot be: the error keeps what was formed up to there.
    tools = [Tool("bed", shapes.plane(), 0.2), Tool("ball", shapes.sphere(20e-3), 0.2)]
    with pytest.raises(EquilibriumError) as error:
        form(Blank(network((25, 17)), tools, settings=HARD), [StagePlan("up", step=0.5)],
             options={"snes_max_it": 1})  # fmt: skip
    assert error.value.result.steps == []
