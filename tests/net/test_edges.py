# SPDX-License-Identifier: MIT
"""Clamps, guides, ties, pins, loads by edge; what they and the outline make of cut cruciforms."""

import numpy as np
import pytest
from mpi4py import MPI
from support.helpers import (
    DIAGONAL,
    PITCH,
    TABLE_1,
    UNEVEN,
    affine_motion,
    diagonals,
    floating,
    holed,
    l_shape,
    pins,
)

from cruciform_petsc.cloth.preform import Preform
from cruciform_petsc.errors import InputError
from cruciform_petsc.net.edges import (
    Constraints,
    chains,
    keep_moment,
    lumped_lengths,
)
from cruciform_petsc.net.lattice import HELD
from cruciform_petsc.net.network import Network
from cruciform_petsc.net.supports import find_supports
from cruciform_petsc.small.network import LinearNetwork


def constrained(preform, bending=False, fabric=TABLE_1):
    """Constraints of a network on one rank."""
    return Constraints(Network(MPI.COMM_SELF, preform, fabric), bending)


# -- who lies on an edge -----------------------------------------------------------------------


@pytest.mark.parametrize("degrees", [0, 20, 45, 77, 90])
def test_nodes_on_edges(degrees):
    """Nodes within a hundredth of a pitch of the edge's segments, corners of both edges twice."""
    constraints = constrained(Preform.rectangle(0.03, 0.05, np.deg2rad(degrees)))
    place = constraints.network.node_position
    near = 0.01 * PITCH
    for edge, off in (
        ("lower", place[:, 1]),
        ("upper", 0.05 - place[:, 1]),
        ("left", place[:, 0] + 0.015),
        ("right", 0.015 - place[:, 0]),
    ):
        np.testing.assert_array_equal(constraints.nodes_on(edge), np.flatnonzero(off <= near))


def test_nodes_on_a_hole():
    """Every yarn that the hole cuts ends on it twice."""
    constraints = constrained(holed(0.05, 0.07, 0.011, 0.4))
    nodes = constraints.nodes_on("hole-1")
    network = constraints.network
    radius = np.hypot(*(network.node_position[nodes] - [0, 0.035]).T)
    # Between the polygon's inscribed and circumscribed circles.
    assert radius.min() > 0.011 * np.cos(np.pi / 24) - 0.01 * PITCH
    assert radius.max() < 0.011 + 0.01 * PITCH
    assert len(nodes) == pytest.approx(4 * 2 * 0.011 / PITCH, abs=4)


def test_edge_without_yarns():
    """A short edge between two yarns: a sentence, not an empty clamp."""
    points = [
        (-0.02, 0),
        (0.02, 0),
        (0.02, 0.04),
        (0.0015, 0.0415),
        (0.0005, 0.0415),
        (-0.02, 0.04),
    ]
    constraints = constrained(Preform.polygon(points, [], 0.0, origin=(0.0, 0.0)))
    with pytest.raises(InputError, match="no yarn reaches the edge 'upper': choose a finer pitch"):
        constraints.clamp("upper")
    with pytest.raises(InputError, match='no edge "uper" \\(did you mean "upper"'):
        constraints.clamp("uper")


# -- what is prescribed ------------------------------------------------------------------------


@pytest.mark.parametrize("bending", [False, True])
def test_clamp(bending):
    """All unknowns of the edge's nodes, the displacement in yarn axes, nothing else."""
    constraints = constrained(Preform.rectangle(0.03, 0.05, 0.6), bending)
    nodes = constraints.clamp("upper", (0.001, 0.002))
    rotation = constraints.network.preform.rotation
    others = np.setdiff1d(np.arange(constraints.network.num_nodes_local), nodes)
    assert constraints.fixed[nodes].all()
    assert constraints.held[nodes].all()
    assert not constraints.fixed[others].any()
    assert not constraints.held[others].any()
    np.testing.assert_allclose(
        constraints.value[nodes, :2] @ rotation, np.tile([0.001, 0.002], (len(nodes), 1))
    )
    assert not constraints.value[nodes, 2:].any()


def test_held_arms():
    """Those that would leave through the clamp; at a corner through both clamped edges."""
    constraints = constrained(diagonals(4, 6))
    constraints.clamp("lower")
    place = constraints.network.node_position
    # Warp up and right, weft up and left: arms 3 and 4 leave through the lower edge.
    low = np.abs(place[:, 1]) < 1e-9
    assert (constraints.held_arm[low] == [False, False, True, True]).all()
    assert not constraints.held_arm[~low].any()
    constraints.clamp("right")
    corner = low & (np.abs(place[:, 0] - 2 * DIAGONAL) < 1e-9)
    assert constraints.held_arm[corner].tolist() == [[True, False, True, True]]


def test_guide_turns_the_frame():
    """One unknown of each node is the motion along the direction; it alone is prescribed."""
    constraints = constrained(Preform.rectangle(0.03, 0.05, 0.6))
    nodes = constraints.guide("upper", (0.0, 2.0), 0.003)
    frame = constraints.frame[nodes]
    rotation = constraints.network.preform.rotation
    np.testing.assert_allclose(
        frame[:, 0] @ rotation, np.tile([0.0, 1.0], (len(nodes), 1)), atol=1e-15
    )
    np.testing.assert_allclose(np.linalg.det(frame), 1.0)
    assert constraints.fixed[nodes].tolist() == [[True, False]] * len(nodes)
    assert (constraints.value[nodes, 0] == 0.003).all()
    assert not constraints.held.any()


def test_clamped_nodes_stay_clamped():
    """A corner belongs to both edges: neither guide nor tie loosens it."""
    constraints = constrained(diagonals(4, 6))
    clamped = constraints.clamp("lower")
    guided = constraints.guide("left", (1.0, 0.0), 0.001)
    tied = constraints.tie("right", (1.0, 0.0), gripped=False)
    assert not np.intersect1d(clamped, guided).size
    assert not np.intersect1d(clamped, tied).size
    assert (constraints.value[clamped] == 0).all()
    assert constraints.tied[tied].all()
    assert constraints.tied.sum() == len(tied)


def moved(constraints, nodes):
    """Prescribed displacement of nodes along x and y, m."""
    yarn = np.einsum("nji,nj->ni", constraints.frame[nodes], constraints.value[nodes, :2])
    return yarn @ constraints.network.preform.rotation


def test_clamp_after_guide():
    """A corner that is guided before it is clamped moves with the clamp, as the other way round."""
    constraints = constrained(diagonals(4, 6))
    constraints.guide("left", (1.0, 0.3), 0.001)
    nodes = constraints.clamp("lower", (0.002, -0.003))
    np.testing.assert_allclose(moved(constraints, nodes), [[0.002, -0.003]] * len(nodes))
    assert constraints.fixed[nodes].all()


@pytest.mark.parametrize("second", [(1.0, 0.0), (0.6, 0.8)])
@pytest.mark.parametrize("turned", [False, True])
def test_guides_that_meet(second, turned):
    """A corner obeys both, in whatever order; the rest of an edge its own only."""
    constraints = constrained(diagonals(4, 6))
    guides = [("lower", (0.0, 1.0), 0.002), ("left", second, 0.001)]
    nodes = [constraints.guide(*guide) for guide in (guides[::-1] if turned else guides)]
    corner = np.intersect1d(*nodes)
    assert len(corner)
    assert constraints.fixed[corner].all()
    for _, direction, displacement in guides:
        along = moved(constraints, corner) @ direction
        np.testing.assert_allclose(along, displacement, rtol=1e-12)
    for of_edge in nodes:
        rest = np.setdiff1d(of_edge, corner)
        assert constraints.fixed[rest, :2].tolist() == [[True, False]] * len(rest)


def test_guided_twice_along_one_direction():
    """Nothing across it is held."""
    constraints = constrained(diagonals(4, 6))
    lower = constraints.guide("lower", (0.0, 1.0), 0.002)
    left = constraints.guide("left", (0.0, -1.0), -0.002)
    assert len(np.intersect1d(lower, left))
    assert constraints.fixed.sum() == len(np.union1d(lower, left))


def test_pin():
    """Single components of one node by its key; a key of no node here does nothing."""
    constraints = constrained(diagonals(4, 6), bending=True)
    key = constraints.network.node_key
    constraints.pin(key[7], (1,))
    constraints.pin(key[9], (0, 1))
    constraints.pin(-5, (0,))
    assert np.argwhere(constraints.fixed).tolist() == [[7, 1], [9, 0], [9, 1]]


# -- line loads --------------------------------------------------------------------------------


LOADED = [
    *(Preform.rectangle(0.03, 0.05, np.deg2rad(d)) for d in (0, 7, 15, 30, 45, 61, 90, 130)),
    Preform.rectangle(0.0337, 0.0471, 0.0, origin=(0.001, 0.002)),
    diagonals(4, 6),
    l_shape(0.05, 0.3),
]


@pytest.mark.parametrize("fabric", [TABLE_1, UNEVEN], ids=["even", "uneven"])
@pytest.mark.parametrize("preform", LOADED)
def test_line_load_keeps_force_and_moment(preform, fabric):
    """On each edge: traction times length, acting at its middle, to rounding."""
    for edge in ("lower", "upper", "left", "right"):
        constraints = constrained(preform, fabric=fabric)
        traction = np.array([30.0, -70.0])
        constraints.line_load(edge, traction)
        force = constraints.force @ preform.rotation
        segments = preform.edge(edge)
        length = np.hypot(*(segments[:, 1] - segments[:, 0]).T).sum()
        np.testing.assert_allclose(force.sum(axis=0), traction * length, rtol=1e-12)
        x, y = constraints.network.node_position.T
        moment = (x * force[:, 1] - y * force[:, 0]).sum()
        mx, my = segments.mean(axis=(0, 1))
        expected = (mx * traction[1] - my * traction[0]) * length
        # Nodes lie within a hundredth of a pitch of the edge.
        slack = 0.01 * PITCH * abs(traction).sum() * length
        assert moment == pytest.approx(
            expected, abs=1e-12 + (slack if edge_is_near(constraints, edge) else 0)
        )


def edge_is_near(constraints, edge):
    """Whether some yarn ends just beside the edge, not on it."""
    network = constraints.network
    nodes = constraints.nodes_on(edge)
    begin, end = network.preform.edge(edge)[0]
    along = (end - begin) / np.hypot(*(end - begin))
    off = (network.node_position[nodes] - begin) @ [-along[1], along[0]]
    return abs(off).max() > 1e-12


def test_line_load_on_a_broken_edge():
    """A hole's edge is a closed line: uniform traction adds up to the circumference."""
    preform = holed(0.05, 0.07, 0.011, 0.4)
    constraints = constrained(preform)
    constraints.line_load("hole-1", (0.0, 10.0))
    around = 24 * 2 * 0.011 * np.sin(np.pi / 24)
    force = constraints.force @ preform.rotation
    np.testing.assert_allclose(force.sum(axis=0), [0.0, 10 * around], atol=1e-12)


def test_line_loads_add_up():
    """Two calls, two loads."""
    constraints = constrained(diagonals(4, 6))
    constraints.line_load("upper", (1.0, 2.0))
    once = constraints.force.copy()
    constraints.line_load("upper", (1.0, 2.0))
    np.testing.assert_allclose(constraints.force, 2 * once)


@pytest.mark.parametrize("bending", [False, True])
@pytest.mark.parametrize(
    ("preform", "fabric"),
    [
        (diagonals(4, 6), TABLE_1),
        (diagonals(3, 2, refine=2), TABLE_1),
        (Preform.rectangle(0.0337, 0.0471, "0 deg"), UNEVEN),
        (Preform.rectangle(0.0337, 0.0471, "90 deg"), UNEVEN),
    ],
)
def test_uniform_stress_is_in_equilibrium_with_line_loads(preform, fabric, bending):
    """Outlines that fit: the affine motion of a uniaxial stress balances the load at each node.

    It proves areas, arms, quadrants, loads, tips, and that no edge is stiffer than it should be.
    """
    traction = 100.0
    constraints = constrained(preform, bending, fabric)
    pins(constraints)
    constraints.line_load("upper", (0.0, traction))
    constraints.line_load("lower", (0.0, -traction))
    model = LinearNetwork(constraints)
    pull = preform.rotation @ [0.0, 1.0]
    stress = traction * np.outer(pull, pull)
    warp, weft = fabric.warp, fabric.weft
    gamma = stress[0, 1] / fabric.shear_modulus
    gradient = [
        [stress[0, 0] / warp.modulus - weft.poisson / weft.modulus * stress[1, 1], 0.3 * gamma],
        [0.7 * gamma, stress[1, 1] / weft.modulus - warp.poisson / warp.modulus * stress[0, 0]],
    ]
    force, load = model.element_forces(affine_motion(model, gradient)), model.loads()
    active = model.supports.active
    # Rounding of E/G times the load.
    np.testing.assert_allclose(force[active], load[active], atol=1e-11 * abs(load).max())


def test_lumped_lengths():
    """Each point up to halfway to the next, the outer ones to the ends; coinciding points share."""

    def lumped(where, knots=(0.0, 6.0), share=(1.0,)):
        return lumped_lengths(np.array(where), np.array(knots), np.array(share))

    np.testing.assert_allclose(lumped([3.0, 1.0, 4.0]), [1.5, 2.0, 2.5])
    np.testing.assert_allclose(lumped([1.0, 4.0, 1.0]), [1.25, 3.5, 1.25])
    np.testing.assert_allclose(lumped([1.0]), [6.0])
    np.testing.assert_allclose(lumped([1.0, 4.0], (0, 2, 6), (0.5, 0.1)), [1.05, 0.35])
    assert lumped([]).shape == (0,)


def test_keep_moment():
    """What one end alone gets wrong, the other family makes up for; a single end stays."""
    where = [np.array([2.0]), np.array([0.5, 3.5, 5.0])]
    lengths = [np.array([1.8]), np.array([1.4, 1.6, 1.2])]
    keep_moment(lengths, where, 18.0)
    assert lengths[0].tolist() == [1.8]
    assert lengths[1].sum() == pytest.approx(4.2)
    assert sum(a @ b for a, b in zip(lengths, where, strict=True)) == pytest.approx(18.0)
    alone = [np.array([6.0]), np.array([])]
    keep_moment(alone, [np.array([2.0]), np.array([])], 18.0)
    assert alone[0].tolist() == [6.0]


def test_chains():
    """Segments that follow on one another are one line."""
    line = np.array([[0, 0], [1, 0], [1, 1], [3, 1], [4, 1], [4, 4]], float)
    segments = np.stack([line[:-1], line[1:]], axis=1)
    assert [len(part) for part in chains(segments)] == [5]
    assert [len(part) for part in chains(segments[[0, 1, 3, 4]])] == [2, 2]


# -- supports: what holds a cruciform ------------------------------------------------------------


def test_nothing_clamped():
    """A body that can float is refused."""
    with pytest.raises(InputError, match="the body can float: no clamp holds it"):
        find_supports(constrained(diagonals(4, 6)))


def test_two_pins_are_not_enough():
    """Three prescribed unknowns are the least."""
    constraints = constrained(diagonals(4, 6))
    constraints.pin(constraints.network.node_key[20], (0, 1))
    with pytest.raises(InputError, match="can float"):
        find_supports(constraints)
    constraints.pin(constraints.network.node_key[30], (0,))
    find_supports(constraints)


@pytest.mark.parametrize("bending", [False, True])
def test_loose_part(bending):
    """A part that no yarn joins to the clamped one is told with its size."""
    # Two squares joined by a neck that no yarn runs through.
    points = np.array(
        [(0, 0), (5, 0), (5, 5), (2.3, 5), (2.3, 6), (5, 6), (5, 11), (0, 11), (0, 6), (1.7, 6),
         (1.7, 5), (0, 5)]
    )  # fmt: skip
    preform = Preform.polygon((points * PITCH).tolist(), [], 0.0, origin=(0.5 * PITCH, 0.5 * PITCH))
    constraints = constrained(preform, bending)
    constraints.clamp("lower")
    with pytest.raises(InputError, match=r"a part of \d+ arm ends can float"):
        find_supports(constraints)
    constraints.clamp("upper")
    find_supports(constraints)


def test_nothing_left_that_carries():
    """A single crossover held at one end, without bending: it turns about it, nothing is left."""
    preform = Preform.rectangle(1.4 * PITCH, 1.4 * PITCH, 0.0)
    constraints = constrained(preform)
    constraints.clamp("lower")
    with pytest.raises(InputError, match="nothing carries load: without yarn bending"):
        find_supports(constraints)
    bent = constrained(preform, bending=True)
    bent.clamp("lower")
    assert find_supports(bent).carrying.all()


def test_missing_arms_at_a_clamp_and_at_a_free_edge():
    """Held: no strain, no rotation. Free: those of the other arm of the yarn."""
    constraints = constrained(diagonals(4, 6))
    constraints.clamp("lower")
    supports, network = find_supports(constraints), constraints.network
    boundary = network.boundary_crossovers
    where = network.crossover_position[boundary]
    inner = np.abs(where[:, 0]) < 1.5 * DIAGONAL
    low = inner & (where[:, 1] < 1e-9)
    high = inner & (where[:, 1] > 6 * DIAGONAL - 1e-9)
    for source in (supports.strain_source, supports.rotation_source):
        assert (source[low] == [0, 1, HELD, HELD]).all()
        assert (source[high] == [2, 3, 2, 3]).all()


def test_corner_tip_of_a_clamp():
    """At the clamp's end one yarn is all there: the half that ends on the clamp is held."""
    constraints = constrained(diagonals(4, 6))
    constraints.clamp("lower")
    supports, network = find_supports(constraints), constraints.network
    boundary = network.boundary_crossovers
    where = network.crossover_position[boundary] / DIAGONAL
    (right,) = np.flatnonzero(np.hypot(*(where - [2, 0]).T) < 1e-9)
    assert supports.carrying[boundary[right]]
    # Its weft goes on up and left (arm 2) and is held beyond the clamp (arm 4); its warp has no
    # arm: arm 3 would leave through the clamp, arm 1 into the air.
    assert supports.strain_source[right].tolist() == [HELD, 1, HELD, HELD]
    area = supports.quadrant_area[right] / network.pitch.prod()
    # Quadrants (1, 2), (3, 2), (3, 4), (1, 4); those beside arm 1 carry nothing.
    np.testing.assert_allclose(area, [0, 0.125, 0, 0], atol=1e-12)


@pytest.mark.parametrize("bending", [False, True])
def test_free_corner_tips_are_left_out(bending):
    """Their one arm has no quadrant that carries: no stiffness along it, bending or not."""
    constraints = constrained(diagonals(4, 6), bending)
    constraints.clamp("lower")
    supports, network = find_supports(constraints), constraints.network
    gone = network.crossover_position[~supports.carrying] / DIAGONAL
    np.testing.assert_allclose(gone[np.argsort(gone[:, 0])], [[-2, 6], [2, 6]], atol=1e-9)
    assert supports.num_hanging == 2
    assert supports.round_[~supports.carrying].tolist() == [1, 1]


def test_tails_are_straight_with_their_yarns():
    """Without bending a free tail has no transverse unknown; with bending it has."""
    for bending in (False, True):
        constraints = constrained(Preform.rectangle(0.03, 0.05, 0.4), bending)
        constraints.clamp("lower")
        supports, network = find_supports(constraints), constraints.network
        assert supports.carrying.all()
        if bending:
            assert not supports.slaved.any()
            continue
        boundary = network.boundary_crossovers
        nodes = network.arm_node[boundary]
        free = (~network.arm_is_shared & (network.arm_length > 0))[boundary]
        free &= ~constraints.fixed[nodes].any(axis=2)
        assert free.sum() > 20
        np.testing.assert_array_equal(supports.slaved, free)
        for row, arm in np.argwhere(free):
            assert supports.rotation_source[row, arm] == (arm + 2) % 4
            assert supports.strain_source[row, arm] == arm
            assert supports.active[nodes[row, arm]].tolist() == [arm % 2 == 0, arm % 2 == 1]


def test_yarn_with_two_tails_keeps_one_rotation():
    """A single row of crossovers: each weft has two tails; the second follows the first."""
    constraints = constrained(Preform.rectangle(1.4 * PITCH, 6.4 * PITCH, 0.0))
    constraints.clamp("lower")
    constraints.clamp("upper")
    supports = find_supports(constraints)
    assert supports.carrying.all()
    assert (supports.slaved == [False, False, False, True]).all()
    assert (supports.rotation_source == [0, 1, 2, 1]).all()


def test_hanging_crossovers_go_in_rounds():
    """A spike one crossover wide is taken off from its tip; with bending it stays."""
    points = [(-3, 0), (3, 0), (3, 3), (0.4, 3), (0.4, 7.3), (-0.4, 7.3), (-0.4, 3), (-3, 3)]
    preform = Preform.polygon(
        (np.array(points) * PITCH).tolist(), [], 0.0, origin=(0.0, 0.5 * PITCH)
    )
    constraints = constrained(preform)
    constraints.clamp("lower")
    supports, network = find_supports(constraints), constraints.network
    gone = ~supports.carrying
    np.testing.assert_allclose(network.crossover_position[gone, 0], 0.0, atol=1e-12)
    height = network.crossover_position[gone, 1] / PITCH
    np.testing.assert_allclose(np.sort(height), [3.5, 4.5, 5.5, 6.5])
    np.testing.assert_array_equal(supports.round_[gone], np.round(7.5 - height))
    bent = constrained(preform, bending=True)
    bent.clamp("lower")
    assert find_supports(bent).carrying.all()


@pytest.mark.parametrize("bending", [False, True])
def test_scraps_in_an_acute_corner(bending):
    """A crossover that no yarn joins to the rest falls out of the cloth; the rest is solved."""
    points = np.array([(-3, 0), (3, 0), (6, 10)]) * PITCH
    preform = Preform.polygon(points.tolist(), [], 0.0, origin=(0.3 * PITCH, 0.4 * PITCH))
    constraints = constrained(preform, bending)
    constraints.clamp("lower")
    supports, network = find_supports(constraints), constraints.network
    place = network.crossover_position[~supports.carrying] / PITCH
    scrap = np.flatnonzero(~supports.carrying)[np.hypot(*(place - [5.3, 8.4]).T) < 1e-9]
    assert len(scrap) == 1
    assert not network.arm_is_shared[scrap].any()
    assert not supports.active[network.arm_node[scrap]].any()
    if bending:
        assert len(place) == 1
        # Nothing but scrap: a body that can float.
        lonely = constrained(Preform.rectangle(1.4 * PITCH, 1.4 * PITCH, 0.0), True)
        with pytest.raises(InputError, match="the body can float"):
            find_supports(lonely)


def test_floating_network_has_no_held_arm():
    """What the other tests use to look at all motions at once."""
    model = floating(Network(MPI.COMM_SELF, diagonals(4, 6), TABLE_1), bending=True)
    assert not model.constraints.fixed.any()
    assert not (model.supports.rotation_source == HELD)[
        model.supports.carrying[model.network.boundary_crossovers]
    ].any()
