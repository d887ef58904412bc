# SPDX-License-Identifier: MIT
"""Yarns that slide through crossovers: derivatives, limits, staircases of tension, energy."""

from dataclasses import replace

import numpy as np
import pytest
from mpi4py import MPI

from cruciform_petsc.cloth.fabric import Fabric
from cruciform_petsc.cloth.preform import Preform
from cruciform_petsc.elements.level import ENERGY, FORCE, STIFFNESS
from cruciform_petsc.equilibrium.cloth import holder, model_of
from cruciform_petsc.equilibrium.lagged import settle
from cruciform_petsc.equilibrium.newton import Equilibrium
from cruciform_petsc.equilibrium.state import Hold, State
from cruciform_petsc.items.nodes import Slip
from cruciform_petsc.items.ply import Ply
from cruciform_petsc.net.edges import Constraints
from cruciform_petsc.net.network import Network

CLOTH = Fabric.from_library("glass-pp-plain-1.93")
PITCH = 1 / 193
DIAGONAL = np.sqrt(2) * PITCH
BIAS = Preform.rectangle(4 * DIAGONAL, 5 * DIAGONAL, "45 deg")
E = CLOTH.c11


class Sliding:
    """A ply whose lower edge is clamped, and states of it."""

    def __init__(self, slip, preform=BIAS, out_of_plane=None, fabric=CLOTH, guided=False):
        constraints = Constraints(Network(MPI.COMM_SELF, preform, fabric), True)
        constraints.clamp("lower")
        if guided:
            constraints.guide("upper", (0.0, 1.0), 0.0)
        self.ply = Ply(constraints, out_of_plane, False, slip=slip)
        self.model, self.rest = model_of(self.ply), self.ply.nodes.rest
        self.start = State(self.rest, holder(self.ply)([]))

    def moved(self, seed=1, places=0.03, slides=0.1):
        """Places moved by chance, and slides; by shares of the pitch."""
        way = np.random.default_rng(seed).uniform(-1, 1, self.rest.shape) * PITCH
        slide = np.zeros(len(way), bool)
        slide[self.ply.nodes.of_slide] = True
        return self.start.moved(np.where(slide[:, None], slides, places) * way)


def is_derivative(item, state, seed=2):
    """Central differences of energy and force along a way of all nodes, in two lengths."""

    def energy(state):
        return item.work(state, ENERGY)[0].sum()

    def force(state):
        total = np.zeros_like(state.x)
        np.add.at(total, item.nodes, item.work(state, FORCE)[1])
        return total

    way = np.random.default_rng(seed).normal(size=state.x.shape)
    stiffness = item.work(state, STIFFNESS)[2]
    np.testing.assert_allclose(
        stiffness, stiffness.transpose(0, 3, 4, 1, 2), atol=1e-12 * abs(stiffness).max()
    )
    product = np.zeros_like(way)
    np.add.at(product, item.nodes, np.einsum("mpiqj,mqj->mpi", stiffness, way[item.nodes]))
    slope = (force(state) * way).sum()
    errors = []
    for step in (1e-7, 3e-8):
        ahead, behind = state.moved(step * way), state.moved(-step * way)
        errors.append((
            abs((energy(ahead) - energy(behind)) / (2 * step) / slope - 1.0),
            abs((force(ahead) - force(behind)) / (2 * step) - product).max() / abs(product).max(),
        ))  # fmt: skip
    # Yarns soften over a strain of 1e-4, some 1e-7 m of an arm: differences see that, and less of
    # it, with the square of the step. A wrong term is wrong by its share, whatever the step.
    assert errors[1][0] < 1e-5
    assert errors[1][1] < max(0.2 * errors[0][1], 1e-6)


@pytest.mark.parametrize("out_of_plane", [None, (1e-3, 4e-4)], ids=["in the plane", "in space"])
@pytest.mark.parametrize("closest", [0.01, 0.95], ids=["far", "crowded"])
def test_force_and_stiffness_are_derivatives(out_of_plane, closest):
    cloth = Sliding(
        Slip(0.05, 0.2, closest=closest, elastic=0.05 * PITCH), out_of_plane=out_of_plane
    )
    before = cloth.moved()
    state = cloth.moved(3)
    state = replace(state, memory=cloth.model.accepted(before))
    arms, friction = cloth.ply.cruciforms.sliding, cloth.ply.slides
    crowded = arms.work(state, ENERGY)[0][:, 1]
    assert (crowded > 0).any() == (closest > 0.5)
    gap = abs(friction.slid(state) - state.memory["slip"]["anchor"]).max(axis=1)
    assert gap.min() < friction.elastic < gap.max()  # some stick, some slide
    is_derivative(arms, state)
    is_derivative(friction, state)


def test_who_does_not_slide_is_the_elastic_cloth():
    """At any places: tension, its force, and the energies of each crossover."""
    plain, sliding = Sliding(None), Sliding(Slip(0.05))
    hinges = plain.ply.nodes.of_hinge, sliding.ply.nodes.of_hinge
    ends = plain.ply.nodes.of_network_node, sliding.ply.nodes.of_network_node
    one = plain.moved()
    x = sliding.rest.copy()
    for at, there in (hinges, ends):
        x[there] = one.x[at]
    other = replace(sliding.start, x=x)
    for name, energy in plain.model.energies(one).items():
        assert sliding.model.energies(other)[name] == pytest.approx(energy, rel=1e-13)
    force, there = plain.model.force(one)[0], sliding.model.force(other)[0]
    for at, to in (hinges, ends):
        np.testing.assert_allclose(there[to], force[at], rtol=0, atol=1e-12 * abs(force).max())
    fields, expected = sliding.ply.fields(other), plain.ply.fields(one)
    for name, values in expected.items():
        np.testing.assert_allclose(fields[name], values, rtol=1e-10, atol=1e-13, err_msg=name)


def test_turned_and_moved_as_a_whole():
    """Slides are no places: energies stay, forces turn with the cloth."""
    cloth = Sliding(Slip(0.05, 0.2))
    state = cloth.moved()
    slides = cloth.ply.nodes.of_slide
    turn, x = np.array([[0.6, -0.8], [0.8, 0.6]]), state.x.copy()
    x = x @ turn.T + [0.1, -0.2]
    x[slides] = state.x[slides]
    turned = replace(state, x=x)
    for item in (cloth.ply.cruciforms.sliding, cloth.ply.slides):
        one, other = item.work(state, FORCE), item.work(turned, FORCE)
        np.testing.assert_allclose(other[0], one[0], rtol=1e-9, atol=1e-16)
        if item.nodes.shape[1] == 4:
            at, size = one[1], abs(one[1]).max()
            np.testing.assert_allclose(other[1][:, :2], at[:, :2] @ turn.T, atol=1e-10 * size)
            np.testing.assert_allclose(other[1][:, 2:], at[:, 2:], atol=1e-10 * size)
    one, other = (cloth.ply.slides.limits(s) for s in (state, turned))
    np.testing.assert_allclose(other, one, rtol=1e-10)


def test_how_far_yarns_slide_over_each_other():
    """The way of the warp's place at a crossing from the weft's, each along its own yarn."""
    cloth = Sliding(Slip(0.05, elastic=1e-3 * PITCH))
    friction = cloth.ply.slides
    gradient = np.array([[1.1, 0.25], [0.1, 0.9]])
    state = cloth.start.moved(cloth.rest @ (gradient - np.eye(2)).T)
    moved = state.x.copy()
    slide = np.array([0.3, 0.2]) * PITCH  # along warp and weft
    axes = cloth.ply.arm_directions[:2]
    moved[cloth.ply.nodes.of_slide] = cloth.rest[cloth.ply.nodes.of_slide] + slide @ axes
    state = replace(state, x=moved)
    memory = friction.lagged(state)[0]
    inside = friction.rows[~np.isin(friction.rows, cloth.ply.network.boundary_crossovers)]
    yarns = axes @ gradient.T
    yarns /= np.linalg.norm(yarns, axis=1, keepdims=True)
    way = np.linalg.norm(slide[0] * yarns[0] - slide[1] * yarns[1])
    energy = friction.work(replace(state, memory={"slip": memory}), ENERGY)[0][:, 0]
    # All slid: F (d - d_0/3), see docs/slip.md.
    expected = memory["limit"] * (way - friction.elastic / 3.0)
    at = np.isin(friction.rows, inside)
    assert at.any()
    np.testing.assert_allclose(energy[at], expected[at], rtol=1e-9)


def test_what_edges_hold_does_not_slide():
    """Neither a yarn that ends on a clamp, nor the crossing one that lies in it."""
    preform = Preform.rectangle(4 * PITCH, 4 * PITCH, "0 deg")  # crossovers on its edges
    ply = Sliding(Slip(0.05), preform).ply
    held = ply.fixed[ply.nodes.of_slide] | ~ply.active[ply.nodes.of_slide][:, None]
    lowest = ply.network.crossover_position[:, 1] < 0.5 * PITCH
    assert held[lowest].all()
    assert not held[~lowest & ply.supports.carrying].any()
    # Where an edge is guided both yarns of a bias specimen end, and go along with it.
    ply = Sliding(Slip(0.05), guided=True).ply
    held = ply.fixed[ply.nodes.of_slide]
    top = ply.network.crossover_position[:, 1] > 5 * DIAGONAL - 0.1 * PITCH
    assert top.sum() == 4
    assert held[top].all()


def test_pull_out_force_of_a_crossover():
    """Of 2 x 2 yarns a cruciform and another count each way: per area, and by tension per yarn."""
    warp, weft = (replace(CLOTH.warp, yarns=y, modulus=e) for y, e in ((150.0, 3e5), (240.0, 5e5)))
    fabric = replace(CLOTH, warp=warp, weft=weft)
    preform = Preform.rectangle("60 mm", "60 mm", "0 deg", yarns_per_cruciform=2)
    cloth = Sliding(Slip(0.05, 0.2), preform, fabric=fabric)
    friction = cloth.ply.slides
    rest = friction.limits(cloth.start)
    stretched = cloth.start.moved(cloth.rest * [2e-3, 3e-3])  # weft along x, warp along y
    slides = cloth.ply.nodes.of_slide
    x = stretched.x.copy()
    x[slides] = cloth.rest[slides]
    inside = ~np.isin(friction.rows, cloth.ply.network.boundary_crossovers)
    assert inside.any()
    tension = 0.5 * (3e5 * 3e-3 / 150 + 5e5 * 2e-3 / 240)  # per yarn, their mean
    crossings = 4.0  # 2 x 2 yarns
    np.testing.assert_allclose(rest[inside], crossings * 0.05, rtol=1e-9)
    found = friction.limits(replace(stretched, x=x))[inside]
    np.testing.assert_allclose(found, crossings * (0.05 + 0.2 * tension), rtol=1e-6)


class Rail:
    """A warp yarn through crossings that do not move: hinges and arm ends are held.

    Nine crossings, half a pitch of yarn beyond the first and the last; the upper end is pulled.
    """

    def __init__(self, slip, rows=9):
        preform = Preform.rectangle(PITCH, rows * PITCH, "0 deg", origin=(0.0, 0.5 * PITCH))
        self.network = Network(MPI.COMM_SELF, preform, CLOTH)
        constraints = Constraints(self.network, True, floats=True)
        top = constraints.nodes_on("upper")
        constraints.pin(self.network.node_key[top[0]], (0, 1))
        self.ply = Ply(constraints, slip=slip)
        self.model, nodes = model_of(self.ply), self.ply.nodes
        self.top = nodes.of_network_node[top[0]]
        n = nodes.num_nodes_local
        self.fixed = np.ones((n, 2), bool)
        self.fixed[nodes.of_slide] = self.ply.fixed[nodes.of_slide]
        self.nodes, self.axes = np.arange(n, dtype=np.int32), nodes.frame
        self.turn = np.tile(np.eye(2), (len(self.ply.clamped), 1, 1))
        self.equilibrium = None
        self.order = np.argsort(self.network.crossover_ij[:, 0])

    def pull(self, ways):
        """States when the end has been pulled so far, m."""
        state, states = State(self.ply.nodes.rest, self._hold(0.0)), []
        equilibrium = Equilibrium(self.model, state)
        for way in ways:
            found = settle(equilibrium, state.at(self._hold(way), way, {}))
            states.append(found.state)
            state = replace(found.state, memory=self.model.accepted(found.state))
        equilibrium.destroy()
        self.last = state
        return states

    def _hold(self, way):
        place = self.ply.nodes.rest.copy()
        place[self.top, 1] += way
        return Hold(self.nodes, self.axes, self.fixed, place, self.turn)

    def configurational(self, state):
        """C behind and ahead of each crossing in order, (n, 2), N, by its formula for this law."""
        c = self.ply.cruciforms
        strain = c.arms(state)[0][:, [2, 0]] - 1.0
        width = PITCH * E  # of a straight line E e
        force = width * (strain * (1.0 + strain) - 0.5 * strain**2)
        tail = np.array([0, -1])
        force = force[self.order]
        assert abs(force[tail[0], 0]) < 1e-12  # the free end
        return force


def test_tension_falls_by_the_pull_out_force_at_each_crossing():
    """A staircase: where all slide, the pull is as many times that of one crossing."""
    limit = 0.08
    rail = Rail(Slip(limit, closest=0.01))
    states = rail.pull([2e-6, 1e-5, 4e-5, 1e-4, 2e-4])
    force = rail.configurational(states[-1])
    # Slid by 0.2 mm of a pitch's 5.2 the crossings hold less: those at both ends, by what has gone.
    np.testing.assert_allclose(np.diff(force, axis=1)[1:-1, 0], limit, rtol=1e-6)
    np.testing.assert_allclose(force[1:, 0], force[:-1, 1], rtol=1e-9)  # along each piece the same
    gone = rail.ply.slides.slid(states[-1])[rail.order][0, 0] / PITCH
    assert force[0, 1] == pytest.approx(limit * (1.0 - gone), rel=1e-3)
    # While it is pulled ever more, it lets go from the pulled end on; what sticks holds less.
    early = np.diff(rail.configurational(states[0]), axis=1)[:, 0]
    assert (np.diff(early) > 0.0).all()
    assert early[0] < 0.5 * early[-1] < 0.5 * limit


def test_a_yarn_leaves_one_crossing_after_the_other():
    """The pull is the friction of the pitches of yarn that are left; none when it is out."""
    limit = 0.08
    rail = Rail(Slip(limit, closest=0.01))
    ways = np.arange(0.5, 10.01, 0.5) * PITCH
    states = rail.pull(ways)
    pull = np.array([rail.configurational(state)[-1, 1] for state in states])
    left = np.maximum(9.0 - ways / PITCH, 0.0)
    # The yarn stretches by 9 crossings' force over their length at most, 1e-4 of it.
    np.testing.assert_allclose(pull[:-4], limit * left[:-4], rtol=3e-3)
    np.testing.assert_allclose(pull[-2:], 0.0, atol=1e-5 * limit)  # but for slip.TRACE
    assert rail.ply.slides.fields(states[-1])["slid_out"][:, 0].all()
    # Friction has taken what the pull has put in, step by step with the force at its end.
    whole = limit * (left * np.diff(ways, prepend=0.0)).sum()
    assert rail.last.memory["slip"]["spent"].sum() == pytest.approx(whole, rel=2e-3)


def test_without_friction_a_yarn_has_one_tension():
    """Held at its lower end, too: pulled by a strain e, all of it has the tension of e."""
    slip = Slip(1e-9, closest=0.01)
    rail = Rail(slip)
    # The tail at the lower end is as if held.
    arms = rail.ply.cruciforms.sliding
    tail = np.flatnonzero((arms.share == 0.0).all(axis=1) & (arms.arm == 2))
    assert len(tail) == 1
    arms.share[tail, 0] = -1.0
    way = 9 * PITCH * 1e-3
    state = rail.pull([way])[-1]
    strain = rail.ply.cruciforms.arms(state)[0][:, [0, 2]] - 1.0
    np.testing.assert_allclose(strain, 1e-3, rtol=1e-6)


@pytest.mark.parametrize("coefficient", [0.05, 0.3])
def test_friction_of_the_yarns_own_tension_grows_geometrically(coefficient):
    """F = F_0 + c (C_1 + C_3)/4 with no tension across: each crossing by (1 + c/4)/(1 - c/4).

    As a rope over many cylinders (Euler and Eytelwein) of an angle of c/2 in all.
    """
    limit = 0.05
    rail = Rail(Slip(limit, coefficient, closest=0.01))
    states = rail.pull(np.linspace(1e-5, 4e-4, 12))
    force = rail.configurational(states[-1])
    ratio = (1.0 + coefficient / 4.0) / (1.0 - coefficient / 4.0)
    step = limit / (1.0 - coefficient / 4.0)
    # Tension is the configurational one to the yarn's strain, below 1e-3 here; friction is taken
    # as settled at a thousandth.
    np.testing.assert_allclose(force[1:-1, 1], ratio * force[1:-1, 0] + step, rtol=2e-3)


def test_pulled_to_and_fro():
    """A loop of hysteresis: what is spent never falls; it is the work done but for what is kept."""
    rail = Rail(Slip(0.05, 0.1, closest=0.01))
    there = np.linspace(0.0, 4e-4, 21)[1:]
    ways = np.concatenate([there, there[::-1][1:], there[:12]])
    states = rail.pull(ways)
    spent = np.array(
        [state.memory.get("slip", {"spent": np.zeros(1)})["spent"].sum() for state in states]
    )
    assert (np.diff(spent) >= 0.0).all()
    pull = np.array([rail.model.force(state)[0][rail.top, 1] for state in states])
    assert pull.min() < -0.2 < 0.2 < pull.max()
    work = np.concatenate([[0.0], np.cumsum(0.5 * (pull[1:] + pull[:-1]) * np.diff(ways))])
    work += 0.5 * pull[0] * ways[0]
    after = sum(rail.model.energies(rail.last).values())
    spent = rail.last.memory["slip"]["spent"].sum()
    # Trapezia of a force that goes from one side to the other within some steps.
    assert work[-1] == pytest.approx(after + spent, rel=2e-2)
