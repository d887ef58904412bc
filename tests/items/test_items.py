# SPDX-License-Identifier: MIT
"""Items: what adds to equilibrium without the solver's knowing; a ply's items in space."""

from dataclasses import replace

import numpy as np
import pytest
from mpi4py import MPI
from support.finite import Cloth
from support.helpers import PITCH, TABLE_1, UNEVEN, diagonals, l_shape
from support.kernels import rotation

from cruciform_petsc.cloth.preform import Preform
from cruciform_petsc.elements.level import room
from cruciform_petsc.equilibrium.model import Model
from cruciform_petsc.equilibrium.newton import Equilibrium
from cruciform_petsc.items.item import Item
from cruciform_petsc.laws import odd_polynomial, table
from cruciform_petsc.net.edges import Constraints
from cruciform_petsc.net.network import Network

BENDING = pytest.mark.parametrize("bending", [False, True], ids=["hinged", "bending"])


class Spring(Item):
    """A spring of stiffness k from a node to a point in space, at rest when they meet."""

    modes = ("spring",)

    def __init__(self, node, point, k, name="spring"):
        self.name = name
        self.nodes, self.point, self.k = np.array([[node]], np.int32), np.array(point), k

    def work(self, state, level, rows=slice(None), before=None):
        gap = state.x[self.nodes[rows, 0]] - self.point
        energy, force, stiffness = room(len(gap), 1, 1, gap.shape[1], level)
        energy[:, 0] = 0.5 * self.k * (gap**2).sum(axis=1)
        if len(force):
            force[:, 0] = self.k * gap
        stiffness[:] = self.k * np.eye(gap.shape[1]).reshape(1, gap.shape[1], 1, -1)
        return energy, force, stiffness


def clamped(bending=True, **more):
    constraints = Constraints(Network(MPI.COMM_SELF, diagonals(4, 6), UNEVEN), bending)
    return Cloth(constraints, {"lower": constraints.clamp("lower")}, **more)


@pytest.mark.parametrize("out_of_plane", [None, (1e-3, 4e-4)], ids=["in the plane", "in space"])
def test_a_spring_is_an_item_like_any_other(out_of_plane):
    """It pulls a node of a clamped strip, in space out of the plane: Newton is quadratic still."""
    cloth = clamped(out_of_plane=out_of_plane, flat=False)
    ply = cloth.ply
    node = int(cloth.rest[:, 1].argmax())
    up = np.array([0.3, 0.4, 1.2][: cloth.model.dim])
    point = cloth.rest[node] + 2e-3 * up
    model = Model(cloth.nodes, [*ply.items, Spring(node, point, 50.0)], ply.active, 1e4)
    equilibrium = Equilibrium(model, cloth.state())
    found = equilibrium.solve(cloth.state())
    equilibrium.destroy()
    x = found.state.x
    assert np.linalg.norm(x[node] - cloth.rest[node]) > 1e-4
    # The cloth pulls as hard as the spring.
    pull = cloth.model.force(found.state)[0][node]
    np.testing.assert_allclose(pull, 50.0 * (point - x[node]), atol=1e-7 * np.linalg.norm(pull))
    assert found.energies["spring"] == pytest.approx(25.0 * ((point - x[node]) ** 2).sum())
    assert found.history[-2] < 1e-2 * found.history[-3]
    if out_of_plane:
        assert x[node, 2] > 1e-3


def test_items_of_one_kind():
    """Two springs are two items whose energies add up; as one twice as stiff."""
    cloth = clamped()
    ply, node = cloth.ply, int(cloth.rest[:, 1].argmax())
    point = cloth.rest[node] + 1e-3
    found = []
    for springs in (
        [Spring(node, point, 60.0)],
        [Spring(node, point, 20.0), Spring(node, point, 40.0, "other")],
    ):
        model = Model(cloth.nodes, [*ply.items, *springs], ply.active, 1e4)
        equilibrium = Equilibrium(model, cloth.state())
        found.append(equilibrium.solve(cloth.state()))
        equilibrium.destroy()
        assert model.energies(found[-1].state) == pytest.approx(found[-1].energies, rel=1e-12)
    one, two = found
    assert two.energies == pytest.approx(one.energies, rel=1e-9)
    assert two.history == pytest.approx(one.history, rel=1e-3)
    with pytest.raises(ValueError, match="a name of its own"):
        Model(cloth.nodes, [*ply.items, *springs, *springs], ply.active, 1e4)


def wavy(bending, flat=False):
    """An L with cut yarns and a clamp, bent into space, and its state."""
    constraints = Constraints(Network(MPI.COMM_SELF, l_shape(0.045, 1.2), UNEVEN), bending)
    nodes = constraints.clamp("lower")
    constraints.guide("left", (0.6, 0.8), 0.0)
    cloth = Cloth(constraints, {"lower": nodes}, (1e-3, 4e-4), flat)
    x, y = cloth.rest[:, 0] / 0.02, cloth.rest[:, 1] / 0.03
    wave = np.stack([np.cos(x + y), np.sin(x - 2 * y), 3 * np.sin(x) * np.cos(y) + x * y], axis=1)
    c, s = np.cos(0.2), np.sin(0.2)
    motions = [(nodes, np.array([[c, -s], [s, c]]), np.array([1e-3, 0.0]))]
    return cloth, cloth.state(cloth.rest + 1e-3 * wave, motions)


@pytest.mark.parametrize("on_a_yarn", [True, False])
@pytest.mark.parametrize("dim", [2, 3])
def test_gradients_at_planes_of_symmetry(on_a_yarn, dim):
    """Energy -> force -> stiffness of yarns that bend with their mirror images."""
    origin, size = ((0, 0) if on_a_yarn else (PITCH / 2, PITCH / 2)), 3 * PITCH
    corners = [(0, 0), (size, 0), (size, size), (0, size)]
    preform = Preform.polygon(corners, bias_angle=0.0, origin=origin)
    constraints = Constraints(Network(MPI.COMM_SELF, preform, TABLE_1), True)
    for edge in ("left", "lower"):
        constraints.symmetry(edge)
    cloth = Cloth(constraints, {}, (1e-3, 4e-4) if dim == 3 else None, False)
    bends, rng = cloth.ply.bends, np.random.default_rng(1)
    x = cloth.rest + rng.normal(scale=0.1 * PITCH, size=cloth.rest.shape)
    state = replace(cloth.state(), x=x)
    assert bends._at_plane.any()
    size = len(x) * dim

    def total(x, level):
        energy, force, _ = bends.work(replace(state, x=x), level)
        wide = np.zeros_like(x)
        if level:
            np.add.at(wide, bends.nodes, force)
        return energy.sum(), wide.ravel()

    force, stiffness = total(x, 1)[1], np.zeros((size, size))
    at = (dim * bends.nodes[..., None] + np.arange(dim)).reshape(len(bends.nodes), -1)
    np.add.at(
        stiffness, (at[:, :, None], at[:, None]),
        bends.work(state, 2)[2].reshape(len(at), at.shape[1], -1),
    )  # fmt: skip
    for _ in range(4):
        change, step = rng.normal(size=x.shape), 1e-9
        (up, ahead), (down, behind) = (total(x + s * change, 1) for s in (step, -step))
        assert (up - down) / (2 * step) == pytest.approx(force @ change.ravel(), rel=1e-5)
        slope = stiffness @ change.ravel()
        np.testing.assert_allclose((ahead - behind) / (2 * step), slope,
                                   atol=1e-5 * abs(slope).max())  # fmt: skip


@BENDING
def test_gradients_in_space(bending):
    """Energy -> force -> tangent of a whole ply, along random changes: 1e-6 of the largest."""
    cloth, state = wavy(bending)
    model, rng = cloth.model, np.random.default_rng(3)
    force, _, energies = model.force(state)
    assert energies["out_of_plane_bending"] > 1e-6
    assert (energies["bending"] > 1e-6) == bending
    matrix, blocks = model.stiffness(state)
    matrix.destroy()
    step = 1e-9  # the shortest arms are a tenth of a millimetre
    for _ in range(5):
        change = rng.normal(size=state.x.shape)
        ahead, behind = state.moved(step * change), state.moved(-step * change)
        work = sum(model.energies(ahead).values()) - sum(model.energies(behind).values())
        size = np.linalg.norm(force) * np.linalg.norm(change)
        assert work / (2 * step) == pytest.approx((force * change).sum(), abs=1e-6 * size)
        slope = (model.force(ahead)[0] - model.force(behind)[0]) / (2 * step)
        product = model.times(blocks, change)
        np.testing.assert_allclose(product, slope, atol=1e-6 * abs(product).max())


@BENDING
def test_every_rigid_motion_in_space(bending):
    """Turned and shifted anyhow, with what clamps hold: no energy more, forces turned."""
    cloth, state = wavy(bending)
    force, _, energies = cloth.model.force(state)
    for axis in (*np.eye(3), np.array([1.0, -2.0, 0.5])):
        turn = rotation(1.3, axis)
        hold = replace(state.hold, turn=turn @ state.hold.turn)
        moved = replace(state, x=state.x @ turn.T + [0.3, -0.2, 0.1], hold=hold)
        found, _, same = cloth.model.force(moved)
        for mode, energy in energies.items():
            assert same[mode] == pytest.approx(energy, rel=1e-9, abs=1e-20), mode
        np.testing.assert_allclose(found, force @ turn.T, atol=1e-9 * abs(force).max())


@BENDING
@pytest.mark.parametrize("dim", [2, 3])
def test_tangent_knows_every_rigid_motion(bending, dim):
    """At rest and unclamped: each translation and each rotation costs no force; nothing else does.

    In space these are three and three, and one thing more: the net twisted like a hyperbolic
    paraboloid, where all yarns stay straight. A net of yarns has no stiffness against that.
    """
    constraints = Constraints(Network(MPI.COMM_SELF, diagonals(3, 4), UNEVEN), bending)
    nodes = constraints.nodes_on("lower")
    constraints.pin(constraints.network.node_key[nodes[0]], (0, 1))  # or it would float
    constraints.pin(constraints.network.node_key[nodes[-1]], (0, 1))
    cloth = Cloth(constraints, None, (1e-3, 4e-4) if dim == 3 else None, flat=False)
    model, state = cloth.model, cloth.state()
    matrix, blocks = model.stiffness(state)
    matrix.destroy()
    owned = cloth.nodes.num_nodes_owned
    motions = model.rigid_motions().T.reshape(-1, owned, dim)
    assert len(motions) == (3 if dim == 2 else 6)
    assert np.linalg.matrix_rank(motions.reshape(len(motions), -1)) == len(motions)
    if dim == 3:
        yarn = cloth.network.to_yarn(cloth.rest[:, :2] - cloth.network.origin)
        twist = np.zeros((owned, 3))
        twist[:, 2] = yarn.prod(axis=1) / 0.01
        motions = np.concatenate([motions, twist[None]])
        assert np.linalg.matrix_rank(motions.reshape(len(motions), -1)) == len(motions)
    size = abs(blocks).max()
    for motion in motions:
        moved = model.from_axes(motion)
        found = model.times(blocks, moved)
        assert abs(found).max() < 1e-12 * size * abs(moved).max()
    if not bending:
        return
    whole = np.zeros((owned * dim, owned * dim))
    for i in range(owned * dim):
        unit = np.zeros(owned * dim)
        unit[i] = 1.0
        whole[i] = model.times(blocks, unit.reshape(owned, dim)).ravel()
    carries = np.repeat(cloth.ply.active, dim)
    values = np.linalg.eigvalsh(whole[np.ix_(carries, carries)])
    assert (abs(values) < 1e-12 * values.max()).sum() == len(motions)
    assert values[len(motions)] > 1e-9 * values.max()


def test_mirrored_cloth():
    """A state and its image in the middle plane along the warp, or the weft, cost the same.

    The normal at an arm end is that of yarns crossing on both of its sides, or one way along the
    yarn would count for more than the other.
    """
    sides = 6 / np.array([UNEVEN.weft.yarns, UNEVEN.warp.yarns])  # x along the weft
    preform = Preform.rectangle(*sides, 0.0)
    constraints = Constraints(Network(MPI.COMM_SELF, preform, UNEVEN), True)
    for node in constraints.nodes_on("lower")[[0, -1]]:  # or it would float
        constraints.pin(constraints.network.node_key[node], (0, 1))
    cloth = Cloth(constraints, None, (1e-3, 4e-4), flat=False)
    middle = 0.5 * (cloth.rest.min(axis=0) + cloth.rest.max(axis=0))
    x, y = ((cloth.rest - middle)[:, :2] / 0.02).T

    def energies(way_x, way_y):
        u, v = way_x * x, way_y * y
        lift = 3 * np.sin(u + 0.3) * np.cos(v) + u * v + np.cos(2 * u - v)
        moved = np.column_stack([way_x * np.sin(v), way_y * np.cos(u + v), lift])
        return cloth.model.energies(replace(cloth.state(), x=cloth.rest + 1e-3 * moved))

    expected = energies(1, 1)
    assert expected["out_of_plane_bending"] > 1e-6
    for ways in ((-1, 1), (1, -1), (-1, -1)):
        for mode, energy in energies(*ways).items():
            assert energy == pytest.approx(expected[mode], rel=1e-10, abs=1e-18), (mode, ways)


def test_each_family_has_its_law_of_moment():
    """Bent to a cylinder about the weft, or the warp: that family's energy at its curvature."""
    radius, laws = 0.03, (table([10.0, 40.0], [0.02, 0.03]), odd_polynomial([4e-4, 3e-8]))
    sides = 6 / np.array([UNEVEN.weft.yarns, UNEVEN.warp.yarns])  # x along the weft
    constraints = Constraints(Network(MPI.COMM_SELF, Preform.rectangle(*sides, 0.0), UNEVEN), True)
    constraints.clamp("lower")
    cloth = Cloth(constraints, None, laws, flat=False)
    bends = cloth.ply.bends
    for family, law in enumerate(laws):
        along = 1 - family  # the warp runs along y
        angle, x = cloth.rest[:, along] / radius, cloth.rest.copy()
        x[:, along], x[:, 2] = radius * np.sin(angle), radius * (1 - np.cos(angle))
        energies = cloth.model.energies(replace(cloth.state(), x=x))
        own = np.flatnonzero(bends._family == family)
        area = (bends.out_of_plane * bends.length)[own].sum() / law.stiffness0
        expected = area * law.evaluate(1 / radius)[0]
        assert energies["out_of_plane_bending"] == pytest.approx(expected, rel=0.01)
