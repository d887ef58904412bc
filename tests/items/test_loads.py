# SPDX-License-Identifier: MIT
"""Gravity, pressures and imperfections; closed forms of cloth in space and how errors fall."""

from dataclasses import replace

import numpy as np
import pytest
import shapely
from mpi4py import MPI
from support.finite import Cloth
from support.helpers import PITCH, TABLE_1, UNEVEN, diagonals, holed, l_shape
from support.kernels import differences

from cruciform_petsc.cloth.fabric import Fabric, YarnFamily
from cruciform_petsc.cloth.preform import Preform
from cruciform_petsc.elements.level import room
from cruciform_petsc.equilibrium.model import Model
from cruciform_petsc.equilibrium.newton import Equilibrium
from cruciform_petsc.equilibrium.state import Hold
from cruciform_petsc.errors import InputError
from cruciform_petsc.items.item import Item
from cruciform_petsc.items.loads import (
    G,
    Pressure,
    PressureAbove,
    Suction,
    facets,
    gravity,
    imperfection,
)
from cruciform_petsc.net.edges import Constraints
from cruciform_petsc.net.network import Network


def cloth_of(yarns, modulus, shear=50.0, weight=1.0, yarn_bending=1e-6):
    """Balanced, without Poisson's effect; ``weight`` in N/m^2."""
    family = YarnFamily(modulus, 0.0, yarns, yarn_bending)
    return Fabric("balanced", family, family, shear, areal_density=weight / G)


def constrained(preform, fabric):
    return Constraints(Network(MPI.COMM_SELF, preform, fabric), True)


def solved(cloth, state, model=None, options=None):
    """Equilibrium near a state."""
    equilibrium = Equilibrium(model or cloth.model, state, options)
    try:
        return equilibrium.solve(state)
    finally:
        equilibrium.destroy()


def wavy(*loads):
    """An L with cut yarns, bent into space."""
    constraints = constrained(l_shape(0.045, 1.2), replace(UNEVEN, areal_density=0.5))
    cloth = Cloth(constraints, {"lower": constraints.clamp("lower")}, (1e-3, 4e-4), False, loads)
    x, y = cloth.rest[:, 0] / 0.02, cloth.rest[:, 1] / 0.03
    wave = np.stack([np.cos(x + y), np.sin(x - 2 * y), 3 * np.sin(x) * np.cos(y) + x * y], axis=1)
    return cloth, cloth.state(cloth.rest + 2e-3 * wave)


PREFORMS = {
    "bias": diagonals(4, 6),
    "along": Preform.rectangle(5 * PITCH, 4 * PITCH, 0.0),
    "between": Preform.rectangle(5 * PITCH, 4 * PITCH, 0.0, origin=(0.2 * PITCH, 0.6 * PITCH)),
    "oblique": Preform.rectangle(5 * PITCH, 4 * PITCH, 0.3),
    "L": l_shape(0.045, 1.2),
    "hole": holed(0.05, 0.06, 0.01, 0.5),
}


@pytest.mark.parametrize("name", PREFORMS)
def test_surface_of_the_cloth(name):
    """Triangles meet but at the outline, and cover it up to its corners; so do nodes' areas."""
    preform = PREFORMS[name]
    constraints = constrained(preform, TABLE_1)
    constraints.clamp("lower")
    cloth = Cloth(constraints, {}, (1e-3, 1e-3), flat=False)
    nodes, weight = facets(cloth.ply)
    a, b, c = np.moveaxis(cloth.rest[nodes], 1, 0)
    area = float(weight @ np.cross(b - a, c - a)[:, 2]) / 2
    whole = {"oblique": 0.02, "L": 2e-3, "hole": 2e-3}.get(name, 1e-12)
    assert area == pytest.approx(preform.outline.area, rel=whole)
    open_ = np.zeros((len(cloth.rest),) * 2)
    for p, q in ((0, 1), (1, 2), (2, 0)):
        np.add.at(open_, (nodes[:, p], nodes[:, q]), weight)
        np.add.at(open_, (nodes[:, q], nodes[:, p]), -weight)
    ends = np.unique(np.argwhere(abs(open_) > 1e-9))
    points = shapely.points(cloth.rest[ends, :2])
    corners = shapely.MultiPoint(shapely.get_coordinates(preform.outline))
    away = shapely.distance(preform.outline.boundary, points)
    away = away[
        shapely.distance(corners, points) > 1.2 * PITCH
    ]  # a triangle there has its corner inside
    assert len(away) > 5
    assert away.max() < 1e-9
    for at_hinge in (0.0, 1 / 3):
        areas = cloth.ply.areas(at_hinge)
        covered = cloth.network.covered_area()
        assert areas.sum() == pytest.approx(covered, rel=1e-12)
        assert areas.min() >= 0.0
        assert at_hinge == 0.0 or (areas[cloth.nodes.of_hinge] > 0).mean() > 0.9
    # Quadrants whose arms are there have their weight where it is.
    moment = cloth.ply.areas() @ cloth.rest[:, :2]
    centre = np.array(preform.outline.centroid.coords[0])
    np.testing.assert_allclose(moment / covered, centre, atol=0.1 * PITCH)


@pytest.mark.parametrize(
    "load",
    [
        lambda ply: Pressure(ply, 3e3),
        lambda ply: Pressure(ply, -2e3, np.array([0.01, 0.3, -0.2])),
        lambda ply: PressureAbove(ply, 3e3, -0.01),
        lambda ply: Suction(ply, 3e3),
        lambda ply: gravity(ply, "this test"),
        lambda ply: imperfection(ply, 1e-3, 5),
    ],
    ids=["pressure", "from elsewhere", "above", "suction", "gravity", "imperfection"],
)
def test_gradients(load):
    """Energy -> force -> stiffness of each load by itself, 1e-6 of the largest."""
    cloth, state = wavy(load)
    (item,) = cloth.ply.further
    energy, force, stiffness = item.work(state, 2)
    x = state.x[item.nodes]

    def at(level, part):
        def of(places):
            rows = []
            for m in range(len(places)):  # elements share nodes
                moved = state.x.copy()
                moved[item.nodes[m]] = places[m]
                rows.append(item.work(replace(state, x=moved), level, slice(m, m + 1))[part][0])
            return np.array(rows)

        return of

    some = slice(None, None, max(len(x) // 40, 1))
    item.nodes, size = item.nodes[some], abs(force).max()
    for name in ("weight", "force", "rest", "_at_rest"):
        if isinstance(getattr(item, name, None), np.ndarray):
            setattr(item, name, getattr(item, name)[some])
    found = differences(at(0, 0), x[some], 1e-5)[:, 0]
    np.testing.assert_allclose(found, force[some], atol=1e-6 * size)
    slope = differences(at(1, 1), x[some], 1e-5)
    np.testing.assert_allclose(slope, stiffness[some], atol=1e-6 * size / 1e-3)
    assert energy.shape == (len(x), 1)
    if isinstance(item, Pressure | PressureAbove):  # cubic, whole stiffness: its own scale
        np.testing.assert_allclose(slope, stiffness[some], atol=1e-6 * abs(stiffness).max())


def test_pressure_pushes_along_the_normal():
    """On a flat cloth p times the area, towards warp x weft; on a bent one it follows."""
    constraints = constrained(Preform.rectangle(6 * PITCH, 8 * PITCH, 0.0), TABLE_1)
    constraints.clamp("lower")
    cloth = Cloth(constraints, {}, (1e-3, 1e-3), False, [lambda ply: Pressure(ply, 2e3)])
    (pressure,) = cloth.ply.further
    inside = np.ones(len(cloth.rest), bool)
    inside[cloth.nodes.of_network_node[cloth.network.node_is_boundary.nonzero()[0]]] = False
    area = cloth.ply.areas()

    def force(x):
        total = np.zeros_like(x)
        np.add.at(total, pressure.nodes, pressure.work(replace(cloth.state(), x=x), 1)[1])
        return total

    found = force(cloth.rest)
    np.testing.assert_allclose(found[inside, 2], -2e3 * area[inside], rtol=1e-12)
    assert abs(found[:, :2]).max() < 1e-12
    # Around a cylinder the forces point along its radius; the origin does not matter inside.
    radius = 0.05
    angle = cloth.rest[:, 0] / radius
    normal = np.column_stack([np.sin(angle), 0 * angle, np.cos(angle)])
    x = radius * normal + cloth.rest * [0, 1, 0]
    found = force(x)
    along = (found * normal).sum(axis=1)
    np.testing.assert_allclose(along[inside], -2e3 * area[inside], rtol=0.01)
    assert abs(found - along[:, None] * normal)[inside].max() < 1e-9
    pressure.origin = np.array([0.3, -0.2, 0.5])
    np.testing.assert_allclose(force(x)[inside], found[inside], atol=1e-9)


def test_suction_is_settled_by_looking_again():
    """At a free edge, too, p n A; brought up to date it is that of the state itself."""
    cloth, state = wavy(lambda ply: Suction(ply, 3e3))
    (suction,) = cloth.ply.further
    nodes, weight = facets(cloth.ply)
    rest = suction.work(cloth.state(), 1)[1][:, 0]
    a, b, c = np.moveaxis(cloth.rest[nodes], 1, 0)
    area = 0.5 * (weight[:, None] * np.cross(b - a, c - a)).sum(axis=0)
    np.testing.assert_allclose(rest.sum(axis=0), -3e3 * area, atol=1e-3 * 3e3 * area[2])
    memory, change, size = suction.lagged(state)
    assert 0.05 * size < change < size
    # Forces, whichever way it pushes, and no more than act.
    half = suction.lagged(replace(state, factors={"suction": -0.5}))[1:]
    assert half == pytest.approx((0.5 * change, 0.5 * size))
    suction.pressure *= -1.0
    assert suction.lagged(state)[1:] == pytest.approx((change, size))
    suction.pressure *= -1.0
    again = replace(state, memory={"suction": memory})
    assert suction.lagged(again)[1] < 1e-12 * size
    a, b, c = np.moveaxis(state.x[nodes], 1, 0)
    normal = 0.5 * (weight[:, None] * np.cross(b - a, c - a)).sum(axis=0)
    total = suction.work(again, 1)[1].sum(axis=(0, 1))
    np.testing.assert_allclose(total, -3e3 * normal, atol=0.01 * size)


def test_gravity_needs_a_mass():
    constraints = constrained(diagonals(3, 4), UNEVEN)
    constraints.clamp("lower")
    with pytest.raises(InputError, match="fabric.areal_density is missing, which gravity needs"):
        Cloth(constraints, {}, (1e-3, 1e-3), False, [lambda ply: gravity(ply, "gravity")])


# -- closed forms ----------------------------------------------------------------------------------

# Strip clamped level at one end under its weight w, bending rigidity B: w L^3/B -> x/L, drop/L of
# the tip (the heavy elastica, Bickley 1934, Phil. Mag. 17:603).
ELASTICA = {1.0: (0.99125, 0.12347), 5.0: (0.84666, 0.49591), 10.0: (0.65636, 0.70020)}
ELASTICA[50.0] = (0.24502, 0.90792)


def elastica(n):
    """Largest error of the tip's place over the length for n pieces of cloth."""
    rigidity, length = 1e-3, 0.1
    fabric = cloth_of(n / length, 1e5, weight=rigidity / length**3)
    constraints = constrained(Preform.rectangle(2 * length / n, length, 0.0), fabric)
    constraints.clamp("lower")
    load = [lambda ply: gravity(ply, "this test")]
    cloth = Cloth(constraints, {}, (rigidity, rigidity), False, load)
    tip = np.flatnonzero(cloth.rest[:, 1] > length - 1e-9)
    row, of_node = np.unique(np.round(cloth.rest[:, 1], 9), return_inverse=True)
    errors = []
    for size, expected in ELASTICA.items():
        # From a curve about as bent, of the right length.
        middle = 0.5 * (row[1:] + row[:-1]) / length
        turn = 0.5 * np.pi * (1 - np.exp(-size / 9)) * (1 - (1 - middle) ** 3)
        piece = np.diff(row)[:, None] * np.column_stack([np.cos(turn), -np.sin(turn)])
        x = cloth.rest.copy()
        x[:, 1:] = np.concatenate([[[0, 0]], np.cumsum(piece, axis=0)])[of_node]
        found = solved(cloth, replace(cloth.state(x), factors={"gravity": size}))
        place = found.state.x[tip].mean(axis=0)[1:] * [1, -1] / length
        errors.append(abs(place - expected).max())
    return np.array(errors)


def test_heavy_elastica():
    """0.3 % of the length, and second order."""
    coarse, fine = elastica(10), elastica(20)
    assert fine.max() < 1e-3
    assert (fine < 0.35 * coarse + 2e-5).all()


def catenary(n):
    """Errors of sag and pull of a strip 1.2 times as long as its span, relative."""
    span, length, weight = 1.0, 1.2, 2.0
    fabric = cloth_of(n / length, 1e5, weight=weight)
    constraints = constrained(Preform.rectangle(2 * length / n, length, 0.0), fabric)
    for edge in ("lower", "upper"):  # hinged: both components, not the direction
        constraints.guide(edge, (0, 1), 0.0)
        upper = constraints.guide(edge, (1, 0), 0.0)
    load = [lambda ply: gravity(ply, "this test")]
    # The weft's ends would hang down without bending.
    cloth = Cloth(constraints, {}, (1e-7, 1e-2), False, load)
    u = np.linspace(0.0, 1.0, 2001)
    z = -1.28 * u * (1 - u)  # a parabola to begin with
    arc = np.concatenate([[0.0], np.cumsum(np.hypot(np.diff(u), np.diff(z)))])
    x = cloth.rest.copy()
    along = np.interp(x[:, 1] / length * arc[-1], arc, u)
    x[:, 1], x[:, 2] = span * along, np.interp(along, u, z)
    motion = (upper, np.eye(2), np.array([0.0, span - length]))
    found = solved(cloth, cloth.state(x, [motion]))
    sag = -found.state.x[cloth.nodes.of_hinge, 2].min() / span
    pull = found.force[cloth.nodes.of_network_node[upper], 1].sum() / (2 * length / n)
    return abs(np.array([sag / 0.29234, pull / (weight * span) / 0.46954]) - 1)


def test_catenary():
    """Length 1.2 times the span: sag/span 0.29234, H/(w span) 0.46954, to 0.3 %."""
    coarse, fine = catenary(10), catenary(20)
    assert fine.max() < 1e-3
    assert (fine < 0.35 * coarse).all()


def square(n):
    """Error of the height in the middle of a net under prestress and pressure."""
    side, modulus, strain, pressure = 0.1, 1e5, 0.01, 1.0
    constraints = constrained(Preform.rectangle(side, side, 0.0), cloth_of(n / side, modulus))
    edges = {edge: constraints.clamp(edge) for edge in ("lower", "upper", "left", "right")}
    load = [lambda ply: Pressure(ply, pressure)]
    cloth = Cloth(constraints, edges, (1e-9, 1e-9), False, load)
    gradient = (1 + strain) * np.eye(2)
    motions = [(nodes, gradient, np.zeros(2)) for nodes in edges.values()]
    found = solved(cloth, cloth.state((1 + strain) * cloth.rest, motions))
    tension = modulus * strain / (1 + strain)
    expected = 0.07367 * pressure * (side * (1 + strain)) ** 2 / tension
    return found.state.x[:, 2].max() / expected - 1


def test_pressure_on_a_square_net():
    """Height 0.07367 p a^2/n (the membrane's series; Timoshenko); a net of 16 x 16 has less."""
    errors = np.array([square(n) for n in (8, 16)])
    assert abs(errors[1]) < 5e-3
    assert abs(errors[1]) < 0.35 * abs(errors[0])


def strut(n):
    """Error of the load at which a clamped strip buckles."""
    rigidity, length = 1e-3, 0.1
    fabric = cloth_of(n / length, 4e5)
    constraints = constrained(Preform.rectangle(2 * length / n, length, 0.0), fabric)
    edges = {edge: constraints.clamp(edge) for edge in ("lower", "upper")}
    waves = [lambda ply: imperfection(ply, 1e-6 * length, 1)]
    cloth = Cloth(constraints, edges, (rigidity, rigidity), False, waves)

    def motion(edge, control):
        return np.eye(2), np.array([0.0, -control * length * (edge == "upper")])

    # Euler's strain is 1e-5.
    state, force = cloth.solve(motion, [0.8e-5, 1.2e-5, 1e-4])
    pull = force[cloth.nodes.of_network_node[edges["upper"]], 1].sum() / (2 * length / n)
    assert abs(state.x[:, 2]).max() > 1e-4
    return -pull / (4 * np.pi**2 * rigidity / length**2) - 1


def test_clamped_strut():
    """P = 4 pi^2 B/L^2 per width (Euler) to 2 %; an imperfection tells it which way to go."""
    coarse, fine = strut(10), strut(20)
    assert abs(fine) < 0.01
    assert abs(fine) < 0.35 * abs(coarse)


class Cap(Item):
    """The end of a tube about y, which the pressure pushes along; nodes (m, 2) are its rim."""

    name, modes, is_load = "cap", ("cap",), True

    def __init__(self, rim, pressure):
        self.nodes, self.pressure = rim.astype(np.int32), pressure

    def work(self, state, level, rows=slice(None), before=None):
        a, b = state.x[self.nodes[rows]].swapaxes(0, 1)
        energy, force, stiffness = room(len(a), 1, 2, 3, level)
        size = -self.pressure * a[:, 1] / 6  # of the cone to the origin; y is prescribed
        energy[:, 0] = size * (a[:, 2] * b[:, 0] - a[:, 0] * b[:, 2])
        force[:], stiffness[:] = 0.0, 0.0
        for i, j, sign in ((2, 0, 1), (0, 2, -1)):
            if level > 0:
                force[:, 0, i] += sign * size * b[:, j]
                force[:, 1, j] += sign * size * a[:, i]
            if level > 1:
                stiffness[:, 0, i, 1, j] = stiffness[:, 1, j, 0, i] = sign * size
        return energy, force, stiffness


def tube(n):
    """Angle of the yarns to the axis of a quarter tube that pressure has pushed to rest, degrees.

    Sides and ends are planes of symmetry; the length is prescribed, and sought at which the ends
    carry just the pressure on the cap.
    """
    pressure, size = 5e3, 0.04
    pitch = size / n / np.sqrt(2)
    constraints = constrained(
        Preform.rectangle(size, size, np.pi / 4), cloth_of(1 / pitch, 1e5, 1e-3, yarn_bending=1e-9)
    )
    edges = {edge: constraints.symmetry(edge) for edge in ("left", "right", "lower", "upper")}
    load = [lambda ply: Pressure(ply, pressure, np.zeros(3))]
    cloth = Cloth(constraints, {}, (1e-9, 1e-9), False, load)
    nodes, start = cloth.nodes, cloth.state()
    edges = {edge: nodes.of_network_node[at] for edge, at in edges.items()}
    radius = size / (np.pi / 2)
    fixed = np.zeros((nodes.num_nodes_local, 3), bool)
    nodes.frame[:] = np.eye(3)
    for edge, angle in (("left", -np.pi / 4), ("right", np.pi / 4)):
        c, s = np.cos(angle), np.sin(angle)
        nodes.frame[edges[edge]], fixed[edges[edge], 0] = [[c, 0, -s], [0, 1, 0], [s, 0, c]], True
    fixed[edges["lower"], 1] = fixed[edges["upper"], 1] = True
    rim = edges["upper"][np.argsort(cloth.rest[edges["upper"], 0])]
    cap = Cap(np.column_stack([rim[:-1], rim[1:]]), pressure)
    model = Model(nodes, [*cloth.ply.items, cap], cloth.ply.active, 1e5)
    held = np.flatnonzero(fixed.any(axis=1)).astype(np.int32)

    def excess(wanted):
        """Pull on the end less that of the pressure, and the angle."""
        around = cloth.rest[:, 0] / radius
        wide, long = np.sqrt(2) * np.sin(wanted), np.sqrt(2) * np.cos(wanted)
        r = radius * wide
        x = np.column_stack([r * np.sin(around), long * cloth.rest[:, 1], r * np.cos(around)])
        hold = Hold(held, nodes.frame[held], fixed[held], x[held], start.hold.turn)
        found = solved(cloth, replace(start, x=x, hold=hold), model, {"snes_max_it": 100})
        x = found.state.x
        a, b = x[rim[:-1]], x[rim[1:]]
        area = 0.5 * (a[:, 2] * b[:, 0] - a[:, 0] * b[:, 2]).sum()
        mean = np.linalg.norm(x[:, [0, 2]], axis=1).mean()
        angle = np.rad2deg(np.arctan(mean * np.pi / 2 / x[rim[0], 1]))
        return found.force[rim, 1].sum() - pressure * area / 3, angle

    (low, first), (high, second) = (excess(np.deg2rad(angle)) for angle in (54.0, 55.5))
    return first - (second - first) * low / (high - low)


def test_tube_of_two_families():
    """Yarns of a closed tube under pressure lie at 54.7356 degrees, tan^2 = 2, to its axis."""
    coarse, fine = (tube(n) - 54.7356 for n in (4, 8))
    assert abs(fine) < 0.2
    assert abs(fine) < 0.35 * abs(coarse)


@pytest.mark.parametrize("on_a_yarn", [True, False])
def test_planes_of_symmetry(on_a_yarn):
    """A quarter between two planes is a quarter of the whole, whether yarns lie in them or not."""
    origin, half = (0.0, 0.0) if on_a_yarn else (PITCH / 2, PITCH / 2), 4 * PITCH
    heights, energies = [], []
    for low in (-half, 0.0):
        points = [(low, low), (half, low), (half, half), (low, half)]
        constraints = constrained(Preform.polygon(points, [], 0.0, origin=origin), TABLE_1)
        symmetric = ("left", "lower") if low == 0.0 else ()
        for edge in ("left", "lower", "right", "upper"):
            (constraints.symmetry if edge in symmetric else constraints.clamp)(edge)
        load = [lambda ply: gravity(ply, "this test")]
        cloth = Cloth(constraints, {}, (2e-3, 1e-3), False, load)
        found = solved(cloth, cloth.state())
        if symmetric:
            edge = cloth.rest[:, :2].min(axis=1) < 1e-9
            assert (abs(found.state.x - cloth.rest)[edge, :2].min(axis=1) < 1e-12).all()
        heights.append(-found.state.x[:, 2].min())
        energies.append(found.energies)
    assert 1e-6 < heights[0] < 1e-3
    assert heights[1] == pytest.approx(heights[0], rel=1e-4)
    for mode in ("out_of_plane_bending", "gravity"):
        assert 4 * energies[1][mode] == pytest.approx(energies[0][mode], rel=1e-4)


def test_what_is_no_plane_of_symmetry():
    constraints = constrained(holed(0.05, 0.06, 0.01, 0.5), TABLE_1)
    with pytest.raises(InputError, match="the edge 'hole-1' is not straight, so it cannot be"):
        constraints.symmetry("hole-1")


def test_imperfection_is_the_shape_at_rest():
    """Loads are balanced; clamped all round the cloth lies alike for any pitch."""
    heights = []
    for refine, seed in ((1, 1), (1, 2), (2, 1)):
        preform = Preform.rectangle(10 * PITCH, 12 * PITCH, 0.0, refine=refine)
        constraints = constrained(preform, TABLE_1)
        for edge in ("lower", "upper", "left", "right"):
            constraints.clamp(edge)
        waves = [lambda ply, seed=seed: imperfection(ply, 1e-5, seed)]
        cloth = Cloth(constraints, {}, (1e-3, 4e-4), False, waves)
        (item,) = cloth.ply.further
        place, size = cloth.rest[item.nodes[:, 0]], abs(item.force).sum()
        assert abs(item.force[:, :2]).max() == 0.0
        assert abs(item.force[:, 2] @ place).max() < 0.03 * 12 * PITCH * size
        found = solved(cloth, cloth.state())
        number = cloth.network.crossover_ij[:, None] == refine * np.array([[0, 0], [2, 2], [-2, 1]])
        at = cloth.nodes.of_hinge[number.all(axis=2).argmax(axis=0)]
        heights.append(found.state.x[at, 2])
    assert 1e-6 < abs(heights[0]).max() < 2e-5
    assert abs(heights[1] - heights[0]).max() > 0.3 * abs(heights[0]).max()
    np.testing.assert_allclose(heights[2], heights[0], atol=0.1 * abs(heights[0]).max())
