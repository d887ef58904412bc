# SPDX-License-Identifier: MIT
"""The membrane in space: derivatives, rigid motion, closed forms, the flat membrane, its mesh."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest
import shapely
from continuum.test_hyperelastic import EVERY_LAW, UNEVEN
from mpi4py import MPI
from support.formed import network
from support.kernels import rotation

from cruciform_petsc.cloth.preform import Preform
from cruciform_petsc.continuum.balance import Balance
from cruciform_petsc.continuum.hyperelastic import HyperelasticMembrane
from cruciform_petsc.continuum.sheet import Sheet, Stretching
from cruciform_petsc.elements.level import STIFFNESS
from cruciform_petsc.equilibrium.model import Model
from cruciform_petsc.equilibrium.state import Hold, State
from cruciform_petsc.errors import InputError
from cruciform_petsc.items.loads import PressureAbove, Suction, facets, gravity
from cruciform_petsc.items.ply import Ply
from cruciform_petsc.net.edges import Constraints
from cruciform_petsc.net.network import Network

TURN = rotation(0.9, [1.0, -2.0, 0.5])


def model_and_state(fabric, x):
    """Of a sheet of 50 x 35 mm, at positions x(rest)."""
    sheet = Sheet(network((50.0, 35.0), fabric), 1 / 60)
    nodes = sheet.nodes
    none = np.zeros((0, 3))
    hold = Hold(np.zeros(0, np.int32), np.zeros((0, 3, 3)), none.astype(bool), none, none[:, None])
    state = State(x(nodes.rest), hold)
    return Model(nodes, sheet.items, stiffness_scale=1e4), state


def bent(rest):
    """Far from rest: strains of some 10 %, shear of 20 degrees, out of the plane, uneven."""
    random = np.random.default_rng(4).normal(size=rest.shape)
    return (rest @ np.array([[1.05, 0.2, 0.1], [0.15, 0.97, -0.3], [0, 0, 1]]) + 4e-4 * random) @ (
        TURN.T
    )


@EVERY_LAW
def test_force_and_stiffness_are_derivatives(fabric):
    """Central differences of energy and force along random changes: 1e-7 of the largest."""
    model, state = model_and_state(fabric, bent)
    force = model.force(state)[0]
    matrix, blocks = model.stiffness(state)
    matrix.destroy()
    rng = np.random.default_rng(2)
    for _ in range(3):
        change = rng.normal(size=state.x.shape)
        ahead, behind = state.moved(1e-8 * change), state.moved(-1e-8 * change)
        slope = (sum(model.energies(ahead).values()) - sum(model.energies(behind).values())) / 2e-8
        assert slope == pytest.approx((force * change).sum(), rel=1e-6)
        forces = (model.force(ahead)[0] - model.force(behind)[0]) / 2e-8
        exact = model.times(blocks, change)
        np.testing.assert_allclose(forces, exact, atol=2e-7 * abs(exact).max())


def test_rigid_motion():
    """Costs nothing from rest; turns the forces of a bent sheet, whose energies stay."""
    model, rest = model_and_state(UNEVEN, lambda x: x @ TURN.T + [0.1, 0.2, -0.3])
    force, _, energies = model.force(rest)
    assert sum(energies.values()) < 1e-20
    assert abs(force).max() < 1e-9
    model, state = model_and_state(UNEVEN, bent)
    force, _, energies = model.force(state)
    turned = State(state.x @ TURN.T + [0.1, 0.2, -0.3], state.hold)
    again, _, same = model.force(turned)
    assert same == pytest.approx(energies, rel=1e-9)
    np.testing.assert_allclose(again, force @ TURN.T, atol=1e-9 * abs(force).max())
    # No force and no moment in all.
    np.testing.assert_allclose(force.sum(axis=0), 0.0, atol=1e-10)
    np.testing.assert_allclose(np.cross(state.x, force).sum(axis=0), 0.0, atol=1e-12)


@EVERY_LAW
@pytest.mark.parametrize("angle", [0.0, 30.0])
def test_uniform_strain_is_that_of_the_network(fabric, angle):
    """Stretch of warp and weft, and shear, turned into space: the laws times the area."""
    turn = rotation(-np.radians(angle))  # from y to the warp, clockwise
    corners = (0.5e-3 * np.array([[-50, -35], [50, -35], [50, 35], [-50, 35]]) @ turn.T).tolist()
    preform = Preform.polygon(corners, bias_angle=np.radians(angle), origin=corners[0])
    net = Network(MPI.COMM_SELF, preform, fabric)
    warp, weft, gamma = 1.04, 0.93, np.radians(23.0)
    fibres = np.array([[warp, 0.0, 0.0], weft * np.array([np.sin(gamma), np.cos(gamma), 0.0])])
    way = preform.rotation.T @ fibres @ TURN.T  # (2, 3): where directions in the plane go

    def energies(cloth):
        none = np.zeros((0, 3))
        hold = Hold(np.zeros(0, np.int32), none, none, none, np.zeros((0, 3, 3)))
        state = State(cloth.nodes.rest[:, :2] @ way, hold)
        return Model(cloth.nodes, cloth.items, stiffness_scale=1e4).energies(state)

    found = energies(Sheet(net, 1 / 60))
    if fabric.biaxial_law is None:
        e, _, _ = fabric.effective_strain(np.array([warp, weft]))
        tension = fabric.warp_tension.evaluate(e[0])[0] + fabric.weft_tension.evaluate(e[1])[0]
        tension = tension + fabric.c12 * e.prod()
    else:
        tension = fabric.tension(np.array([warp, weft]))[0]
    per_area = {
        "tension": tension,
        "shear": fabric.shear.evaluate(gamma)[0],
    }
    for mode, value in per_area.items():
        assert found[mode] == pytest.approx(value * 50e-3 * 35e-3, rel=1e-9)
    # The network covers the outline to rounding where crossovers lie on it, else nearly.
    of_net = energies(Ply(Constraints(net, False, floats=True), (0.0, 0.0), flat=False))
    for mode in per_area:
        assert of_net[mode] == pytest.approx(found[mode], rel=1e-6)


def test_in_its_plane_it_is_the_hyperelastic_membrane():
    """On the same triangles, pulled on the bias: energies and forces to rounding."""
    preform = Preform.rectangle(0.03, 0.03, "25 deg")
    flat = HyperelasticMembrane(MPI.COMM_SELF, preform, UNEVEN, 0.005, 1, grading=0)
    (pulled,) = flat.solve_bias_extension([2e-3])
    u, moved = pulled.displacement, np.zeros((len(flat.nodes), 3))
    moved[:, :2] = flat.nodes + u.x.array.reshape(-1, 2)
    directions = [d.value for d in flat.directions]
    nodes = flat.space.dofmap.list
    sheet = Stretching(flat.mesh, nodes, directions, UNEVEN)
    state = SimpleNamespace(x=moved @ TURN.T)
    energy, force, stiffness = sheet.work(state, STIFFNESS)
    parts = (pulled.energy_tension, pulled.energy_shear)
    np.testing.assert_allclose(energy.sum(axis=0), parts, rtol=1e-9)
    total = np.zeros_like(moved)
    np.add.at(total, nodes, force @ TURN)
    most = abs(pulled.nodal_force).max()
    np.testing.assert_allclose(total[:, :2], pulled.nodal_force, atol=1e-9 * most)
    np.testing.assert_allclose(total[:, 2], 0.0, atol=1e-9 * most)
    # Its tangent is the flat one within the plane.
    state = Balance(flat, flat.rigidity, {"lower": None}, "membrane_")
    state.u.x.array[:] = u.x.array
    state.update()
    matrix = state.assemble()
    change = np.random.default_rng(1).normal(size=moved.shape) * [1.0, 1.0, 0.0]
    change[flat.edge_nodes("lower")] = 0.0
    wanted, given = matrix.createVecs()
    given.setArray(change[:, :2].ravel())
    matrix.mult(given, wanted)
    turned = np.einsum("mpiqj,mqj->mpi", stiffness, change[nodes] @ TURN.T) @ TURN
    product = np.zeros_like(moved)
    np.add.at(product, nodes, turned)
    free = np.ones(len(moved), bool)
    free[flat.edge_nodes("lower")] = False
    found, wanted = product[free, :2], wanted.array.reshape(-1, 2)[free]
    np.testing.assert_allclose(found, wanted, atol=1e-9 * abs(wanted).max())
    state.destroy()


def test_mesh_along_yarns():
    """An L with yarns at 30 degrees: its area, edges along yarns, areas of nodes; as it says."""
    corners = np.array([[0, 0], [40, 0], [40, 15], [12, 15], [12, 30], [0, 30]]) * 1e-3
    turn = rotation(-np.radians(30.0))
    preform = Preform.polygon((corners @ turn.T).tolist(), bias_angle=np.radians(30.0))
    sheet = Sheet(Network(MPI.COMM_SELF, preform, UNEVEN), 4e-3)
    assert sheet.stretching.area.sum() == pytest.approx(preform.outline.area, rel=1e-12)
    corner = sheet.nodes.rest[sheet.stretching.nodes][..., :2]
    whole = shapely.union_all(shapely.polygons(corner))  # no two lie on each other
    assert whole.area == pytest.approx(preform.outline.area, rel=1e-9)
    areas = sheet.areas()
    assert areas.sum() == pytest.approx(preform.outline.area, rel=1e-12)
    assert areas.min() > 0.0
    x = corner @ turn  # as drawn
    sides = np.roll(x, -1, axis=1) - x
    along = (abs(sides) < 1e-12).any(axis=2)
    assert (along.sum(axis=1) == 2).all()
    assert abs(sides[along]).max() <= 4e-3 + 1e-12
    for problem in (
        Preform.rectangle("40 mm", "30 mm", "20 deg"),
        Preform.polygon([[0, 0], [0.04, 0], [0.04, 0.03], [0.01, 0.03]], bias_angle=0.0),
    ):
        with pytest.raises(InputError, match="outline whose sides run along the yarns"):
            Sheet(Network(MPI.COMM_SELF, problem, UNEVEN), 4e-3)


def test_pressure_and_weight():
    """Suction and weight of a sheet: area times pressure, and times weight, all downwards."""
    sheet = Sheet(network((50.0, 35.0)), 1 / 120)
    triangles, weight = facets(sheet)
    side = np.diff(sheet.nodes.rest[triangles][..., :2], axis=1)
    assert 0.5 * np.linalg.det(side) @ weight == pytest.approx(50e-3 * 35e-3, rel=1e-12)
    assert np.linalg.det(side).min() > 0.0
    state = SimpleNamespace(x=sheet.nodes.rest, factors={}, memory={})
    for load, whole in (
        (Suction(sheet, -200.0), 200.0 * 50e-3 * 35e-3),
        (PressureAbove(sheet, -200.0), 200.0 * 50e-3 * 35e-3),
        (gravity(sheet, "test"), 9.80665 * 0.5 * 50e-3 * 35e-3),
    ):
        force = -load.work(state, STIFFNESS)[1].reshape(-1, 3).sum(axis=0)
        np.testing.assert_allclose(force, [0.0, 0.0, -whole], atol=1e-12)
