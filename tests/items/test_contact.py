# SPDX-License-Identifier: MIT
"""Cloth against tools: contact and friction by differences, belts, grips and slopes."""

from types import SimpleNamespace

import numpy as np
import pytest
from mpi4py import MPI
from support.kernels import rotation

from cruciform_petsc.cloth.fabric import Fabric
from cruciform_petsc.cloth.preform import Preform
from cruciform_petsc.elements.level import ENERGY, FORCE, STIFFNESS
from cruciform_petsc.equilibrium.follow import follow
from cruciform_petsc.equilibrium.model import Model
from cruciform_petsc.equilibrium.newton import Equilibrium
from cruciform_petsc.equilibrium.stages import Stage
from cruciform_petsc.equilibrium.state import Hold, State
from cruciform_petsc.items.contact import Contact, compaction
from cruciform_petsc.items.loads import DeadLoads
from cruciform_petsc.items.part import OfPart
from cruciform_petsc.items.ply import Ply
from cruciform_petsc.items.viscous import Viscous
from cruciform_petsc.net.edges import Constraints
from cruciform_petsc.net.joined import JoinedNodes, ToolNodes
from cruciform_petsc.net.network import Network
from cruciform_petsc.tools import shapes
from cruciform_petsc.tools.sampled import height_field
from cruciform_petsc.tools.sector import Sector

THICKNESS, STIFFNESS_K, WIDTH, SLIP = 1e-3, 2e7, 2e-4, 1e-5
YARN = {
    "modulus": "520 N/cm",
    "poisson": 0,
    "yarns": "2.4 /cm",
    "yarn_bending": "0.001 N mm^2",
    "out_of_plane_bending": "1e-4 N mm",
}
CLOTH = Fabric.from_table("soft", {"warp": YARN, "weft": YARN, "shear": {"modulus": "50 N/m"}})


def test_compaction_is_smooth():
    """A pressure q costs q/k + w/2, or sqrt(2 q w/k) where that is below w; derivatives agree."""
    k, w = STIFFNESS_K, WIDTH
    for q in (0.1 * k * w, 0.4 * k * w, 3.0 * k * w):
        depth = q / k + w / 2 if q > k * w / 2 else np.sqrt(2 * q * w / k)
        assert compaction(np.array([depth]), k, w)[1][0] == pytest.approx(q, rel=1e-12)
    p, step = np.linspace(-w, 3 * w, 41) + 1e-7, 1e-9
    q, s = compaction(p, k, w)[1:]
    ahead, behind = compaction(p + step, k, w), compaction(p - step, k, w)
    # Differences of 1e-9 m: right to 1e-6 of the largest.
    np.testing.assert_allclose((ahead[0] - behind[0]) / (2 * step), q, atol=1e-6 * q.max())
    np.testing.assert_allclose((ahead[1] - behind[1]) / (2 * step), s, atol=1e-6 * s.max())


@pytest.mark.parametrize("slipped", [0.3e-5, 0.9e-5, 4e-5], ids=["sticks", "nearly", "slides"])
def test_contact_and_friction_by_differences(slipped):
    """Energy -> force -> stiffness of cloth and tool, the tool turned, on a sphere: 1e-6."""
    rng = np.random.default_rng(5)
    n, radius = 12, 0.05
    direction = rng.normal(size=(n, 3))
    direction /= np.linalg.norm(direction, axis=1)[:, None]
    depth = rng.uniform(-1e-4, 5e-4, n)
    turn, place = rotation(0.7, (1, 2, 3)), np.array([0.1, -0.2, 0.3])
    x = np.vstack([place + (radius + THICKNESS / 2 - depth)[:, None] * direction, place])
    contact = Contact(
        "ball", shapes.sphere(radius), np.arange(n), n, rng.uniform(1, 2, n) * 1e-5,
        THICKNESS / 2, STIFFNESS_K, WIDTH, 0.3, SLIP,
    )  # fmt: skip
    hold = SimpleNamespace(rotations={"ball": turn})
    state = SimpleNamespace(x=x, hold=hold, factors={}, memory={})
    memory = contact.lagged(state)[0]
    aside = np.cross(memory["normal"], rng.normal(size=(n, 3)))
    aside *= slipped / np.linalg.norm(aside, axis=1)[:, None]
    memory["anchor"] = np.nan_to_num(memory["anchor"]) + aside
    state.memory = {"ball": memory}

    def at(move, level):
        moved = SimpleNamespace(**{**vars(state), "x": x + move.reshape(x.shape)})
        energy, force, stiffness = contact.work(moved, level)
        total = np.zeros_like(x)
        if level:
            np.add.at(total, contact.nodes, force)
        matrix = np.zeros((n + 1, 3, n + 1, 3))
        if level == STIFFNESS:
            for e, (a, b) in enumerate(contact.nodes):
                for p, i in enumerate((a, b)):
                    for q, j in enumerate((a, b)):
                        matrix[i, :, j] += stiffness[e, p, :, q]
        return energy.sum(), total.ravel(), matrix.reshape(x.size, x.size)

    zero, step = np.zeros(x.size), 1e-9
    _, force, matrix = at(zero, STIFFNESS)
    assert abs(matrix - matrix.T).max() <= 1e-12 * abs(matrix).max()
    for _ in range(4):
        way = rng.normal(size=x.size)
        ahead, behind = at(step * way, FORCE), at(-step * way, FORCE)
        slope = (ahead[0] - behind[0]) / (2 * step)
        assert slope == pytest.approx(force @ way, abs=1e-5 * np.linalg.norm(force))
        bend = (ahead[1] - behind[1]) / (2 * step)
        np.testing.assert_allclose(bend, matrix @ way, atol=1e-5 * abs(matrix @ way).max())
    assert len(contact.work(state, ENERGY)[1]) == 0
    # The moment on the cloth is the energy's slope as the cloth turns about the tool's origin.
    for axis in np.eye(3):
        spin = np.vstack([np.cross(axis, x[:-1] - place), np.zeros(3)]).ravel()
        ahead, behind = at(step * spin, FORCE)[0], at(-step * spin, FORCE)[0]
        slope = (ahead - behind) / (2 * step)
        size = np.linalg.norm(force) * radius
        assert contact.moment(state) @ axis == pytest.approx(-slope, abs=1e-5 * size)


class Counted:
    """A surface that counts the points it is asked for."""

    def __init__(self, surface):
        self.surface, self.asked = surface, 0
        self.cell, self.reach = surface.cell, surface.reach

    def look(self, points):
        """See Surface.look."""
        self.asked += len(points)
        return self.surface.look(points)


@pytest.mark.parametrize(
    "make",
    [
        lambda: shapes.sphere(0.03),
        lambda: shapes.opening(0.03, 5e-3, 0.1),
        lambda: Sector(0.02, 0.05, -0.5, 1.0, 2e-3),
        lambda: height_field(
            lambda x, y: 0.01 * np.cos(80 * x), np.linspace(-0.05, 0.05, 41), [-0.05, 0.05], 1e-3
        ),
    ],
    ids=["sphere", "opening", "sector", "grid"],
)
def test_nodes_that_cannot_have_come_to_touch_are_not_looked_at(make):
    """On a random way, in and out: as if all were looked at anew, to the last digit; NaN shows."""
    rng = np.random.default_rng(3)
    n, surface = 300, Counted(make())
    arguments = n, np.full(n, 1e-5), THICKNESS / 2, STIFFNESS_K, WIDTH, 0.0, SLIP
    contact = Contact("tool", surface, np.arange(n), *arguments)
    x = np.vstack([rng.uniform([-0.05, -0.05, -0.01], [0.05, 0.05, 0.04], (n, 3)), np.zeros(3)])
    touched, hold = np.zeros(n, bool), SimpleNamespace(rotations={"tool": rotation(0.4, (3, 1, 2))})
    for step in range(60):
        x += rng.normal(size=3) * 1e-3 + rng.normal(size=x.shape) * 2e-4
        state = SimpleNamespace(x=x, hold=hold, factors={}, memory={})
        fresh = Contact("tool", surface.surface, np.arange(n), *arguments)
        for rows in (slice(0, 100), slice(100, n)):
            found = contact.work(state, step % 3, rows)
            for one, other in zip(found, fresh.work(state, step % 3, rows), strict=True):
                np.testing.assert_array_equal(one, other)
            touched[rows] |= found[0][:, 0] > 0.0
    assert touched.sum() > 10
    assert surface.asked < 0.7 * 60 * n or surface.reach < 0.01  # a grid's, which is short
    x[7] = np.nan
    assert np.isnan(contact.work(state, ENERGY)[0][7, 0])


def test_the_way_slid_adds_up():
    """Along a plate there and back, beyond the elastic slip; nothing while a node hangs free."""
    contact = Contact(
        "plate", shapes.plane(), np.array([0, 1]), 2, np.full(2, 1e-5),
        THICKNESS / 2, STIFFNESS_K, WIDTH, 0.0, SLIP,
    )  # fmt: skip
    state = SimpleNamespace(hold=SimpleNamespace(rotations={}), factors={}, memory={})
    for x in (0.0, 3e-3, 1e-3):
        state.x = np.array([[x, 0, 4e-4], [x, 0, 6e-4], [0, 0, 0]])
        state.memory = {"plate": contact.accepted(state)}
    # Back: as far as to the anchor, which stayed behind by the elastic slip, and beyond it.
    expected = (3e-3 - SLIP) + (2e-3 - 2 * SLIP)
    np.testing.assert_allclose(contact.fields(state)["slip"], [expected, 0.0], atol=1e-12)


class Strip:
    """A strip of cloth along x and tools, with some nodes held and some loaded.

    ``shape`` puts rest positions in space; ``held`` of rest positions says which nodes are moved.
    """

    def __init__(self, length, width, tools, friction, shape, held, load, viscosity=20.0):
        preform = Preform.rectangle(f"{length} mm", f"{width} mm", bias_angle="0 deg")
        network = Network(MPI.COMM_SELF, preform, CLOTH)
        self.ply = ply = Ply(Constraints(network, True, floats=True), (1e-7, 1e-7), flat=False)
        own = ply.nodes.num_nodes_owned
        places = np.array([place for _, place in tools])
        self.nodes = nodes = JoinedNodes([ply.nodes, ToolNodes(MPI.COMM_SELF, places)])
        cloth, self.tools = nodes.maps
        area = ply.areas(1 / 3)[:own]
        self.contacts = [
            Contact(
                f"tool {i}", surface, cloth[:own], node, area,
                THICKNESS / 2, STIFFNESS_K, WIDTH, friction, SLIP,
            )
            for i, ((surface, _), node) in enumerate(zip(tools, self.tools, strict=True))
        ]  # fmt: skip
        self.x = nodes.rest.copy()
        self.x[cloth] = shape(ply.nodes.rest)
        self.held = cloth[held(ply.nodes.rest)]
        force = np.zeros_like(self.x)
        force[cloth[ply.active]] = load(ply.nodes.rest[ply.active])
        viscous = Viscous(cloth[:own], self.x[cloth[:own]], viscosity * area)
        self.items = [
            *(OfPart(item, cloth) for item in ply.items[:2]),
            *self.contacts,
            viscous,
            DeadLoads(force, self.x, nodes.num_nodes_owned, "pull", 1.0),
        ]
        active = nodes.join([ply.active, np.ones(len(tools), bool)])
        self.model = Model(nodes, self.items, active, stiffness_scale=1e5)

    def run(self, moves, targets, step, free=None):
        """Held nodes move by moves(control) (3,), tools by tool_moves; all accepted steps."""
        at = np.concatenate([self.held, self.tools])
        fixed = np.ones((len(at), 3), bool)
        if free is not None:
            fixed[len(self.held) :] = ~free

        def drive(control):
            place = self.x[at].copy()
            place[: len(self.held)] += moves(control)
            return Hold(
                at, np.tile(np.eye(3), (len(at), 1, 1)), fixed, place, np.zeros((0, 3, 3))
            ), {}

        hold, factors = drive(0.0)
        start = State(self.x, hold, 0.0, factors)
        start = State(self.x, hold, 0.0, factors, self.model.accepted(start))
        equilibrium = Equilibrium(
            self.model, start, relative_residual=1e-6, longest_step=2e-3, foretell=False
        )
        try:
            stage = Stage("pull", drive, targets, step, carry_on=False, easy=20)
            steps = follow(equilibrium, stage, start)
        finally:
            equilibrium.destroy()
        return steps

    def force(self, step, nodes):
        """What holds some nodes, N."""
        return self.model.force(step.state)[0][nodes].sum(axis=0)


@pytest.mark.parametrize(
    ("friction", "wrap", "ratio"), [(0.2, 90, 1.3691), (0.2, 180, 1.8745), (0.3, 180, 2.5663)]
)
def test_a_belt_over_a_cylinder(friction, wrap, ratio):
    """Capstan: T2/T1 = exp(mu phi) within 0.2 %, at each step once all of it slips."""
    radius = 50e-3
    angle, around = np.deg2rad(wrap), radius + THICKNESS / 2
    length = 1e3 * (around * angle + 0.06)

    def shape(rest):
        s = rest[:, 0]
        theta = np.clip(s / around, -angle / 2, angle / 2)
        beyond = s - around * theta
        x = around * np.sin(theta) + beyond * np.cos(theta)
        z = around * np.cos(theta) - beyond * np.sin(theta)
        return np.stack([x, rest[:, 1], z], axis=1)

    end = 0.5e-3 * length - 1e-6
    along = np.array([np.cos(angle / 2), 0.0, -np.sin(angle / 2)])
    other = np.array([-np.cos(angle / 2), 0.0, -np.sin(angle / 2)])
    pull = 1.0  # N, all of the strip's left end

    def load(rest):
        left = rest[:, 0] < -end
        return left[:, None] * other * pull / left.sum()

    strip = Strip(
        length, 8.0, [(shapes.cylinder(radius), np.zeros(3))], friction, shape,
        lambda rest: rest[:, 0] > end, load,
    )  # fmt: skip
    steps = strip.run(lambda u: 4e-3 * u * along, [0.25, 0.5, 0.75, 1.0], 0.25)
    for step in steps[-3:]:
        assert strip.force(step, strip.held) @ along / pull == pytest.approx(ratio, rel=2e-3)
