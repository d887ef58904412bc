# SPDX-License-Identifier: MIT
"""States are values; stages start anywhere; the flat tests in space give the flat results."""

from dataclasses import replace

import numpy as np
import pytest
from mpi4py import MPI
from support.finite import Cloth
from support.helpers import DIAGONAL, PITCH, TABLE_1, UNEVEN, diagonals

from cruciform_petsc.cloth.preform import Preform
from cruciform_petsc.equilibrium.follow import follow
from cruciform_petsc.equilibrium.newton import Equilibrium
from cruciform_petsc.errors import EquilibriumError, InputError
from cruciform_petsc.experiments.bias_extension import BiasExtension
from cruciform_petsc.experiments.biaxial import Biaxial
from cruciform_petsc.experiments.cantilever import Cantilever
from cruciform_petsc.experiments.finite import FiniteTest
from cruciform_petsc.experiments.limits import warnings
from cruciform_petsc.experiments.off_axis import OffAxisTension
from cruciform_petsc.experiments.picture_frame import PictureFrame
from cruciform_petsc.laws import odd_polynomial
from cruciform_petsc.net.edges import Constraints
from cruciform_petsc.net.network import Network

DEGREE = np.pi / 180


def turned(angle):
    c, s = np.cos(angle), np.sin(angle)
    return np.array([[c, -s], [s, c]])


def network(preform, fabric=TABLE_1):
    return Network(MPI.COMM_SELF, preform, fabric)


def clamped():
    constraints = Constraints(network(diagonals(4, 6)), True)
    return Cloth(constraints, {edge: constraints.clamp(edge) for edge in ("lower", "upper")})


def pull(edge, control):
    """The upper edge is pulled, and turned as it goes."""
    if edge == "lower":
        return np.eye(2), np.zeros(2)
    return turned(20 * control), np.array([0.0, control])


def test_a_state_answers_in_any_order():
    """Energies, forces, fields, tangent of two states of one run: whatever was asked before."""
    cloth = clamped()
    cloth.solve(pull, [0.002, 0.005])
    early, late = (step.state for step in cloth.steps)

    def answers(state):
        fields = cloth.ply.fields(state)
        matrix, blocks = cloth.model.stiffness(state)
        matrix.destroy()
        force, _, energies = cloth.model.force(state)
        return fields, blocks, force, energies, cloth.ply.displacement(state)[1]

    def same(one, other):
        for name, values in one[0].items():
            np.testing.assert_array_equal(values, other[0][name], err_msg=name)
        np.testing.assert_array_equal(one[1], other[1])
        np.testing.assert_array_equal(one[2], other[2])
        assert one[3] == other[3]
        np.testing.assert_array_equal(one[4], other[4])

    first, second = answers(early), answers(late)
    assert abs(first[2] - second[2]).max() > 0.1 * abs(second[2]).max()
    same(answers(early), first)
    cloth.solve(pull, [-0.001])  # another run of the same model
    same(answers(late), second)
    same(answers(early), first)


def test_held_directions_belong_to_the_state():
    """The same positions under clamps turned otherwise: another energy, and the first one again."""
    cloth = clamped()
    state, _ = cloth.solve(pull, [0.004])
    energy = cloth.energies(state)
    motions = [(nodes, turned(0.3), np.zeros(2)) for nodes in cloth.edges.values()]
    other = replace(state, hold=replace(state.hold, turn=cloth.hold(motions).turn))
    assert cloth.energies(other).sum() > 1.01 * energy.sum()
    np.testing.assert_array_equal(cloth.energies(state), energy)


def test_another_law_is_another_model():
    """The answers of a test of another law are those of a test made with it; the old ones stay."""
    law = odd_polynomial([60.0, 20.0])
    made = [
        FiniteTest(BiasExtension(network(diagonals(4, 6), fabric), "3 mm", finite=True))
        for fabric in (TABLE_1, TABLE_1.with_shear_law(law))
    ]
    test, expected = made
    equilibrium = Equilibrium(test.model, test.at(0.0))
    state = follow(equilibrium, test.stage(), test.at(0.0))[-1].state
    equilibrium.destroy()
    force, _, energies = test.model.force(state)
    other = test.with_shear_law(law)
    for one, same in ((other, expected), (test, test)):
        for name, values in one.ply.fields(state).items():
            np.testing.assert_array_equal(values, same.ply.fields(state)[name], err_msg=name)
        assert one.model.energies(state) == same.model.energies(state)
    assert other.model.energies(state)["shear"] != energies["shear"]
    np.testing.assert_array_equal(test.model.force(state)[0], force)


def test_two_stages():
    """Pulled, then sheared from where the first stage ended, and back: as in one go, to 1e-7.

    Loads on the way are those of equilibrium, found to 1e-8 of the forces.
    """
    cloth = clamped()

    def sheared(edge, control):
        return np.eye(2), np.array([control, 0.004]) if edge == "upper" else np.zeros(2)

    def pulled(edge, control):
        return np.eye(2), np.array([0.0, control]) if edge == "upper" else np.zeros(2)

    equilibrium = Equilibrium(cloth.model, cloth.state())
    first = follow(equilibrium, cloth.stage(pulled, [0.004]), cloth.state())
    start = first[-1].state
    second = follow(equilibrium, cloth.stage(sheared, [0.003, 0.0]), replace(start, time=0.0))
    whole = follow(
        equilibrium,
        cloth.stage(
            lambda edge, c: (np.eye(2), c * np.array([0.003, 0.004]) * (edge == "upper")), [1.0]
        ),
        cloth.state(),
    )
    equilibrium.destroy()
    force = cloth.model.force(second[0].state)[0]
    expected = cloth.model.force(whole[0].state)[0]
    np.testing.assert_allclose(force, expected, atol=1e-7 * abs(expected).max())
    np.testing.assert_allclose(second[1].state.x, start.x, atol=1e-9)
    assert second[0].state.time == 0.003
    assert [step.increment.asked for step in second] == [True, True]


def test_a_stage_by_load_starts_anywhere_too():
    """From 2 mm on to a load: the path's load is taken from where it stands."""
    by_extension = BiasExtension(
        network(diagonals(4, 6)), ["2 mm", "3 mm"], finite=True, bending=True
    ).solve()
    by_load = BiasExtension(
        network(diagonals(4, 6)), load=by_extension.loads.tolist(), finite=True, bending=True
    ).solve()
    np.testing.assert_allclose(by_load.controls, [2e-3, 3e-3], rtol=1e-7)


def bent(fabric):
    """With rigidities out of the plane."""
    return replace(
        fabric,
        warp=replace(fabric.warp, out_of_plane_bending=1e-3),
        weft=replace(fabric.weft, out_of_plane_bending=4e-4),
    )


SIDE = 6 * PITCH
FLAT_TESTS = {
    "bias": (BiasExtension, diagonals(4, 8), TABLE_1, {"extension": ["3 mm", "8 mm"]}),
    "cut yarns": (
        BiasExtension, Preform.rectangle(0.024, 0.036, 0.5), UNEVEN, {"extension": ["4 mm"]}
    ),
    "half": (
        BiasExtension, diagonals(4, 4), TABLE_1, {"extension": ["3 mm"], "upper": "centre-line"}
    ),
    "by load": (BiasExtension, diagonals(4, 6), TABLE_1, {"load": ["1 N", "3 N"]}),
    "free ends": (
        OffAxisTension, Preform.rectangle(0.024, 0.048, "30 deg"), UNEVEN,
        {"extension": ["3 mm"], "ends": "free"},
    ),
    "frame": (
        PictureFrame, Preform.rectangle(SIDE, SIDE, 0.0), TABLE_1, {"angle": ["10 deg", "30 deg"]}
    ),
    "biaxial": (
        Biaxial, Preform.rectangle(SIDE, SIDE, 0.0), UNEVEN, {"strain": ["2 %"], "ratio": 0.5}
    ),
    "cantilever": (
        Cantilever, Preform.rectangle(4 * PITCH, 10 * PITCH, 0.0), TABLE_1, {"load": ["0.05 N"]}
    ),
}  # fmt: skip


@pytest.mark.parametrize("bending", [False, True], ids=["hinged", "bending"])
@pytest.mark.parametrize("name", FLAT_TESTS)
def test_flat_tests_in_space(name, bending):
    """With z held each flat test in space is itself: loads, shear, energies, forces on edges.

    Equilibrium is found to 1e-8 of the forces: 1e-8 for loads, 1e-7 for what is of first order.
    """
    kind, preform, fabric, values = FLAT_TESTS[name]
    if kind is Cantilever and not bending:
        return
    flat, space = (
        kind(network(preform, bent(fabric)), finite=True, bending=bending, space=space, **values)
        for space in (False, True)
    )
    space.flat = True
    flat, space = flat.solve(), space.solve()
    for force, values in flat.forces.items():
        np.testing.assert_allclose(space.forces[force], values, rtol=1e-8)
    np.testing.assert_allclose(space.controls, flat.controls, rtol=1e-8)
    for one, other in zip(space.states, flat.states, strict=True):
        size = abs(other.fields["displacement"]).max()
        np.testing.assert_allclose(
            one.fields["displacement"][:, :2], other.fields["displacement"], atol=1e-7 * size
        )
        assert abs(one.fields["displacement"][:, 2]).max() == 0.0
        assert abs(one.fields["out_of_plane_bending_energy"]).max() < 1e-18
        np.testing.assert_allclose(
            one.fields["shear_angle"], other.fields["shear_angle"], atol=1e-7
        )
        for edge, force in other.forces.items():
            np.testing.assert_allclose(one.forces[edge][:2], force, atol=1e-7 * abs(force).max())
    energies = flat.energies()
    total = sum(value[-1] for value in energies.values())
    for mode, value in space.energies().items():
        np.testing.assert_allclose(value, energies.get(mode, 0.0), atol=1e-8 * total)


@pytest.mark.parametrize("name", FLAT_TESTS)
def test_tests_that_may_leave_the_plane(name):
    """Each kind also runs in space, and an imperfection takes it out of the plane a little."""
    kind, preform, fabric, values = FLAT_TESTS[name]
    test = kind(
        network(preform, bent(fabric)),
        finite=True,
        space=True,
        imperfection={"height": "0.1 mm", "seed": 1},
        **values,
    )
    result = test.solve()
    assert (result.heights_max > 5e-6).all()
    assert result.energies()["out_of_plane_bending"][-1] > 0.0
    held = [grip.nodes for grip in test.grip(Constraints(test.network, True))]
    lifted = abs(result.node_displacement[np.concatenate(held), 2])
    assert (lifted.max() == 0.0) != (values.get("upper") == "centre-line")
    assert not any("exactly flat" in sentence for sentence in warnings(result))


def test_without_an_imperfection_nothing_buckles():
    """Cloth that starts exactly flat stays so; a remark says it, and that it became unstable."""
    kind, preform, fabric, values = FLAT_TESTS["frame"]
    result = kind(network(preform, bent(fabric)), finite=True, space=True, **values).solve()
    assert result.heights_max.max() == 0.0
    (remark,) = (sentence for sentence in warnings(result) if "exactly flat" in sentence)
    assert "the flat cloth became unstable" in remark


def test_strip_over_an_edge():
    """Bent out of the plane about one line, the warp along it or across: B l/(2 R^2) per width.

    A cylinder of radius R: kappa = 2 tan(theta/2)/l with theta = l/R at every point; 1e-3 is l/R
    squared. The other family lies straight.
    """
    radius = 0.05
    for across, rigidity in ((0, 1e-3), (1, 4e-4)):
        constraints = Constraints(network(Preform.rectangle(0.02, 0.04, 0.0), UNEVEN), True)
        constraints.clamp("lower")
        cloth = Cloth(constraints, {}, (1e-3, 4e-4), flat=False)
        along = 1 - across  # the warp runs along y here
        x = cloth.rest.copy()
        angle = cloth.rest[:, along] / radius
        x[:, along], x[:, 2] = radius * np.sin(angle), radius * (1 - np.cos(angle))
        energies = cloth.model.energies(replace(cloth.state(), x=x))
        # At edges of what there is of the width; half a pitch is straight at free ends.
        bends = cloth.ply.bends
        ends = cloth.rest[bends.nodes[:, 2]] - cloth.rest[bends.nodes[:, 0]]
        curved = np.flatnonzero(abs(ends[:, along]) > abs(ends[:, 1 - along]))
        curved = (bends.out_of_plane * bends.length)[curved].sum()
        assert 0.8 * 0.02 * 0.04 < curved / rigidity < 0.02 * 0.04
        expected = curved / (2 * radius**2)
        assert energies["out_of_plane_bending"] == pytest.approx(expected, rel=3e-3)
        assert energies["bending"] < 1e-6 * expected


def test_yarns_may_not_lie_on_each_other_in_space():
    """Within a degree of each other they are no cloth any more, and the place is told."""
    constraints = Constraints(network(diagonals(4, 6)), True)
    constraints.clamp("lower")
    cloth = Cloth(constraints, {}, (1e-3, 1e-3), flat=False)
    assert cloth.model.broken(cloth.state()) is None
    place, position = cloth.rest.copy(), cloth.network.crossover_position
    hinge = int(np.argmin(np.hypot(*(position - [0, 3 * DIAGONAL]).T)))
    ends = cloth.nodes.of_network_node[cloth.network.arm_node[hinge]]
    middle = place[cloth.nodes.of_hinge[hinge]]
    for arm, other in ((0, 1), (2, 3)):
        place[ends[other], :2] = middle[:2] + (place[ends[arm]] - middle)[:2] @ turned(0.01)
    found, reason, _ = cloth.model.broken(cloth.state(place))
    assert reason == "FOLDED"
    np.testing.assert_allclose(found, position[hinge])


def test_space_needs_finite_deformation():
    with pytest.raises(InputError, match="test.space = true needs finite = true"):
        BiasExtension(network(diagonals(4, 6)), "1 mm", finite=False, space=True)
    with pytest.raises(InputError, match="test.imperfection needs space = true"):
        BiasExtension(network(diagonals(4, 6)), "1 mm", imperfection={"height": 1e-4})
    bare = network(diagonals(4, 6), UNEVEN)
    with pytest.raises(InputError, match="fabric.warp.out_of_plane_bending is missing, which test"):
        BiasExtension(bare, "1 mm", finite=True, space=True)


def test_what_cannot_be_solved_in_space():
    """Said with the place in x and y, as in the plane."""
    fabric = TABLE_1.with_shear_law(odd_polynomial([96.0, -100.0]))
    said = []
    for space in (False, True):
        test = BiasExtension(
            network(diagonals(3, 6), fabric), ["2 mm", "10 mm"], finite=True, bending=False,
            space=space,
        )  # fmt: skip
        test.flat = True
        with pytest.raises(EquilibriumError, match=" at x = .* mm, y = .* mm") as caught:
            test.solve()
        said.append(str(caught.value).split("(")[0])
        assert len(caught.value.result.states) == 2
    assert said[0] == said[1]


@pytest.mark.parametrize("name", ["ksponly", "qn", "newtontr", "ngmres"])
def test_snes_of_other_types_is_refused(name):
    """They do without what keeps Newton's steps downhill, or without the matrix."""
    cloth = clamped()
    with pytest.raises(InputError, match=f"snes_type is '{name}'.* 'newtonls'"):
        Equilibrium(cloth.model, cloth.state(), {"snes_type": name})


def test_what_is_converged_is_no_option_of_petsc():
    cloth = clamped()
    found = []
    for options in ({}, {"snes_convergence_test": "skip", "snes_max_it": 20}):
        equilibrium = Equilibrium(cloth.model, cloth.state(), options)
        step = follow(equilibrium, cloth.stage(pull, [0.004]), cloth.state())[0]
        equilibrium.destroy()
        found.append(step.increment.history)
    assert found[0] == found[1]


def test_free_unknowns_belong_to_the_hold():
    """Of two holds with one table of components, on other nodes."""
    cloth = clamped()
    hold, active = cloth.state().hold, cloth.model.active
    half = len(hold.nodes) // 2
    fixed = hold.fixed[:half]
    one, two = (
        replace(hold, nodes=hold.nodes[rows], fixed=fixed)
        for rows in (slice(0, half), slice(half, 2 * half))
    )
    for each in (one, two, one):
        wanted = np.tile(active[:, None], 2)
        wanted[each.nodes] &= ~fixed
        np.testing.assert_array_equal(cloth.model.free(each), wanted)


def test_a_stage_that_fails_says_where():
    cloth = clamped()
    equilibrium = Equilibrium(cloth.model, cloth.state())
    equilibrium.snes.setTolerances(max_it=1)
    with pytest.raises(EquilibriumError) as caught:
        follow(equilibrium, cloth.stage(pull, [0.02]), cloth.state())
    equilibrium.destroy()
    low_x, low_y, high_x, high_y = cloth.network.preform.outline.bounds
    x, y = caught.value.place
    assert low_x <= x <= high_x
    assert low_y <= y <= high_y
