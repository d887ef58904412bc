# SPDX-License-Identifier: MIT
"""Plies on each other: rest, differences, compaction, friction that holds and slides."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from support.formed import HARD, OVER, Gripped, cloth, formed, load, network, travel

from cruciform_petsc.elements.level import ENERGY, FORCE, STIFFNESS
from cruciform_petsc.forming.blank import Blank
from cruciform_petsc.forming.press import StagePlan
from cruciform_petsc.tools import shapes
from cruciform_petsc.tools.motion import Pose
from cruciform_petsc.tools.tool import Tool

T, MU = 1e-3, 0.2
STIFF = cloth(shear="20 kN/m", bending="1 N mm")  # so that all of it slips after a little way


def plates(z, friction):
    """A bed and a holder at some height."""
    above = Pose(np.array([0.0, 0.0, z]), OVER)
    return [Tool("bed", shapes.plane(), friction), Tool("holder", shapes.plane(), friction, above)]


def closed(force):
    return StagePlan("close", forces={"holder": np.array([0.0, 0.0, -force])}, step=1.0)


SOFT = cloth(bending="0.1 N mm")


def stack(angles, tools=(), size=(50, 42), **options):
    nets = [network(size, SOFT, angle, yarns_per_cruciform=2) for angle in angles]
    return Blank(nets, list(tools), **{"settings": HARD, **options})


@pytest.mark.parametrize("angles", [("0 deg", "0 deg"), ("0 deg", "45 deg", "0 deg", "30 deg")])
def test_a_stack_under_no_load_rests(angles):
    """Flat, aligned or not: no force, all crossovers on their neighbours, none farther off."""
    blank = stack(angles, rub=[MU] * len(angles))
    state = blank.start()
    # Rounding of places, 1e-17 m, times stiffness.
    assert abs(blank.model.force(state)[0]).max() < 1e-10
    for item in blank.between:
        next_to = abs(item.one.ply.nodes.rest[0, 2] - item.other.ply.nodes.rest[0, 2]) < 1.5 * T
        assert len(item.joined(state)) == (len(item.nodes) if next_to else 0)
    assert len(blank.between) == len(angles) * (len(angles) - 1)


@pytest.mark.parametrize("upper", [True, False])
def test_by_differences(upper):
    """Energy -> force -> stiffness, curved, pressed and rubbing: 1e-6; nothing of rigid motions."""
    rng = np.random.default_rng(3)
    blank = stack(("0 deg", "45 deg"), rub=[0.0, 0.3])
    item, state = blank.between[0 if upper else 1], blank.start()
    x = state.x + 1e-4 * rng.normal(size=state.x.shape)
    x[:, 2] += 0.02 * np.sin(60.0 * x[:, 0]) * np.cos(50.0 * x[:, 1])
    x[blank.each[1].cloth_at, 2] -= 3e-4
    memory = item.lagged(replace(state, x=x, memory={}))[0]
    memory["anchor"] = memory["anchor"] + rng.uniform(-1, 1, memory["anchor"].shape) * 2e-3
    assert (memory["pressed"] > 0.0).sum() > 20
    state = replace(state, x=x, memory={item.name: memory})
    nodes = item.joined(state)

    def at(moved, level):
        energy, force, stiffness = item.work(state.moved(moved), level)
        total = np.zeros_like(x)
        if level:
            np.add.at(total, nodes, force)
        return energy.sum(axis=0), total, stiffness

    _, force, stiffness = at(0.0 * x, STIFFNESS)
    step = 1e-9
    for _ in range(3):
        way = rng.normal(size=x.shape)
        ahead, behind = at(step * way, FORCE), at(-step * way, FORCE)
        slope = (ahead[0] - behind[0]).sum() / (2 * step)
        assert slope == pytest.approx((force * way).sum(), abs=1e-6 * np.linalg.norm(force))
        bend = np.zeros_like(x)
        np.add.at(bend, nodes, np.einsum("mjikl,mkl->mji", stiffness, way[nodes]))
        difference = (ahead[1] - behind[1]) / (2 * step)
        np.testing.assert_allclose(difference, bend, atol=1e-6 * abs(bend).max())
    assert abs(force.sum(axis=0)).max() < 1e-12 * abs(force).sum()
    turn = Rotation.from_rotvec([0.3, 0.5, -0.2]).as_matrix()
    turned = {**memory, "normal": memory["normal"] @ turn.T}
    state = replace(state, x=x @ turn.T + [0.1, 0.2, 0.3], memory={item.name: turned})
    before = at_rest = item.work(replace(state, x=x, memory={item.name: memory}), ENERGY)[0]
    np.testing.assert_allclose(item.work(state, ENERGY)[0], at_rest, atol=1e-9 * before.max())


@pytest.mark.parametrize("force", [1.0, 5.0], ids=["softly", "hard"])
@pytest.mark.parametrize("angles", [("0 deg", "45 deg"), ("0 deg",) * 3])
def test_a_stack_is_pressed_between_plates(force, angles):
    """Each ply yields by twice what one side does under the pressure, of n plies n times: 2 %.

    Rims are loaded otherwise by patches that end than by plates: they make up most of the 2 %.
    """
    n, q, k, w = len(angles), force / (50e-3 * 42e-3), HARD.stiffness, HARD.width
    blank = stack(angles, plates(n * T, 0.0))
    steps, states = formed(blank, closed(force))
    side = q / k + w / 2 if q > k * w / 2 else np.sqrt(2.0 * q * w / k)
    closing = n * T - steps[-1].tool_place["holder"][2]
    assert closing == pytest.approx(2 * n * side, rel=0.02)
    pressures = [item.fields(states[-1])["pressure"] for item in blank.between]
    inner = [p for p in pressures if p.max() > 0.0]
    assert len(inner) == 2 * (n - 1)
    # Of all items together the whole force goes through each of the interfaces.
    total = [(item.area * p).sum() for item, p in zip(blank.between, pressures, strict=True)]
    assert sum(total) == pytest.approx((n - 1) * force, rel=0.01)


def pulled(held=None, size=(50, 16), **options):
    """Three plies between rough plates; the middle one to be pulled."""
    nets = [network(size, STIFF, yarns_per_cruciform=2) for _ in range(3)]
    settings = replace(HARD, stiffness=2e8, **options.pop("further", {}))
    return Gripped(
        nets, plates(3 * T, 1.0), held=held, axes=(True, True, False), ply=1,
        settings=settings, rub=[0.0, MU, MU], **options,
    )  # fmt: skip


def right(rest):
    """The right-hand end of a strip."""
    return rest[:, 0] > rest[:, 0].max() - 1e-6


def test_a_ply_is_pulled_from_between_two_others():
    """2 mu N, constant, within 0.5 %, and the way slid; what it dissipates is force times way."""
    force = 4.0
    blank = pulled(right)
    pull = StagePlan("pull", {"grip": travel(4e-3, 0, 0)}, step=0.125)
    steps, states = formed(blank, closed(force), pull)
    felt = np.array([blank.on_grip(state) for state in states[3:]])
    # Rims that are bent by what lies there no more pass some of the force on beside the ply.
    np.testing.assert_allclose(felt[:, 0], 2 * MU * force, rtol=5e-3)
    assert abs(felt[:, 1]).max() < 1e-3
    assert np.ptp(felt[:, 0]) < 5e-3 * felt[0, 0]
    way = steps[-1].increment.control - steps[3].increment.control
    spent = steps[-1].spent["friction"] - steps[3].spent["friction"]
    assert spent == pytest.approx(2 * MU * force * 4e-3 * way, rel=0.01)
    spent = [step.spent["friction"] for step in steps]
    assert (np.diff(spent) >= 0.0).all()


@pytest.mark.parametrize(("share", "slides"), [(0.8, False), (1.1, True)])
def test_a_ply_that_is_held_does_not_creep(share, slides):
    """Below 2 mu N the middle ply stays for 10 steps; above it slides as viscosity lets it."""
    force = 2.0

    def make(ply):
        return load(right, (share * 2 * MU * force, 0, 0))(ply)

    blank = pulled(size=(25, 16.7), further={"viscosity": 1e5})
    item = make(blank.each[1].ply)
    item.nodes = blank.each[1].cloth_at[item.nodes]
    item.rest = blank.nodes.rest[item.nodes[:, 0]]
    blank.model = type(blank.model)(
        blank.nodes, [*blank.model.items, item], blank.model.active, blank.model.stiffness_scale
    )
    plans = [
        closed(force),
        StagePlan("pull", factors={"pull": 1.0}, step=0.25),
        StagePlan("wait", step=1 / 10),
    ]
    steps, states = formed(blank, *plans)
    began = next(k for k, step in enumerate(steps) if step.stage == "wait")
    at = blank.each[1].cloth_at
    crept = states[-1].x[at, 0] - states[began].x[at, 0]
    if slides:
        assert crept.min() > 1e-5
    else:
        # A hundredth of the elastic slip, 1e-5 m.
        assert abs(crept).max() < 1e-7
