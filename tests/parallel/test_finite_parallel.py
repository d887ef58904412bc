# SPDX-License-Identifier: MIT
"""Finite deformation on several ranks against one rank alone: curves, fields, errors."""

import numpy as np
import pytest
from mpi4py import MPI
from support.biaxial import CRIMP, SURFACE
from support.finite import Cloth
from support.helpers import DIAGONAL, PITCH, TABLE_1, UNEVEN, dense, diagonals, gathered, l_shape

from cruciform_petsc import laws
from cruciform_petsc.cloth.preform import Preform
from cruciform_petsc.equilibrium import newton
from cruciform_petsc.errors import EquilibriumError, InputError
from cruciform_petsc.experiments.bias_extension import BiasExtension
from cruciform_petsc.experiments.biaxial import Biaxial
from cruciform_petsc.experiments.cantilever import Cantilever
from cruciform_petsc.experiments.off_axis import OffAxisTension
from cruciform_petsc.experiments.pantograph import Pantograph
from cruciform_petsc.experiments.picture_frame import PictureFrame
from cruciform_petsc.experiments.result import EFFORT
from cruciform_petsc.net.edges import Constraints
from cruciform_petsc.net.network import Network
from cruciform_petsc.small.network import MODES
from cruciform_petsc.solvers.options import ITERATIVE

COMM = MPI.COMM_WORLD
pytestmark = pytest.mark.three_ranks

BENDING = pytest.mark.parametrize("bending", [False, True], ids=["flat", "bending"])
SIN_POWERS = TABLE_1.with_shear_law(laws.sin_powers([18.5, 46.4, -21.3]))
SPIKE = [(-3, 0), (3, 0), (3, 3), (0.4, 3), (0.4, 27.3), (-0.4, 27.3), (-0.4, 3), (-3, 3)]
FRAME = Preform.rectangle(8 * PITCH, 8 * PITCH, 0.0)
# kind of test, outline, cloth, values, what else is asked for
TESTS = {
    "table-1": (BiasExtension, diagonals(4, 8), TABLE_1, ["4 mm", "8 mm"], {}),
    "sin-potential": (BiasExtension, diagonals(4, 8), SIN_POWERS, ["4 mm", "8 mm"], {}),
    # Crossovers hang on; tails that are straight with their yarns.
    "30-degrees": (BiasExtension, Preform.rectangle(0.024, 0.036, 0.5), UNEVEN, ["4 mm"], {}),
    "L": (BiasExtension, l_shape(0.06, 1.2), UNEVEN, ["3 mm", "5 mm"], {}),
    "half": (BiasExtension, diagonals(4, 4), TABLE_1, ["3 mm"], {"upper": "centre-line"}),
    "free ends": (
        OffAxisTension, Preform.rectangle(0.024, 0.048, "30 deg"), UNEVEN, ["3 mm"],
        {"ends": "free"},
    ),
    "frame": (PictureFrame, FRAME, TABLE_1, ["10 deg", "20 deg"], {}),
    "biaxial": (Biaxial, FRAME, UNEVEN, ["1 %", "2 %"], {"ratio": 0.5}),
    "surface": (
        OffAxisTension, Preform.rectangle(0.024, 0.048, "20 deg"), UNEVEN.with_biaxial_law(SURFACE),
        ["1 mm"], {"ends": "free"},
    ),
    "crimp": (Biaxial, FRAME, UNEVEN.with_biaxial_law(CRIMP.law), ["1 %"], {"ratio": 0.5}),
    "pantograph": (Pantograph, diagonals(4, 12), TABLE_1, ["2 mm", "6 mm"], {}),
}  # fmt: skip


def solved(comm, name, bending, finite=True, **more):
    """A test, in three increments if it is a finite one."""
    kind, preform, fabric, values, options = TESTS[name]
    test = kind(
        Network(comm, preform, fabric), values, finite=finite, bending=bending,
        increments=3 if finite else None, **options, **more,
    )  # fmt: skip
    return test, test.solve()


def same(result, alone):
    """Curves, increments and all fields, gathered by number, against those of one rank.

    Curves and energies to the issue's 1e-8 of the largest of their kind (angles of 10 degrees,
    energies of all modes). Equilibrium is found to 1e-8 of the forces, so that fields, which are
    of the first order in what is left, get 1e-7: of a radian, a strain of 1, the largest energy.
    """
    np.testing.assert_allclose(result.controls, alone.controls, rtol=1e-9)
    for force, values in result.forces.items():
        np.testing.assert_allclose(values, alone.forces[force], rtol=1e-8)
    curve, expected = result.curve(), alone.curve()
    assert list(curve) == list(expected)
    for name in EFFORT.keys() & curve.keys():  # it may take other iterations
        del curve[name], expected[name]
    energy = sum(value for name, value in expected.items() if name.startswith("energy")).max()
    for name, values in curve.items():
        unit = name.rpartition("_")[2]
        alike = [expected[n] for n in expected if n.rpartition("_")[2] == unit]
        size = np.nanmax(np.abs(alike))  # an L has no centre
        if unit == "deg":
            size = max(size, 10.0)
        elif name.startswith("energy"):
            size = energy
        np.testing.assert_allclose(values, expected[name], rtol=0, atol=1e-8 * size, err_msg=name)
    assert len(set(COMM.allgather(str({k: v.tolist() for k, v in curve.items()})))) == 1
    assert len(result.increments) == len(alone.increments)
    for one, other in zip(result.increments, alone.increments, strict=True):
        assert one.control == pytest.approx(other.control, rel=1e-9)
        for mode in MODES:
            assert one.energies[mode] == pytest.approx(other.energies[mode], abs=1e-8 * energy)
    network = result.network
    number = network.crossover_number_global
    owned = network.num_nodes_owned
    for state, other in zip(result.states, alone.states, strict=True):
        for edge, force in state.forces.items():
            size = abs(other.forces[edge]).max()
            np.testing.assert_allclose(force, other.forces[edge], atol=1e-7 * size)
        energy = max(other.fields[f"{mode}_energy"].max() for mode in MODES)
        for name, values in state.fields.items():
            every, wanted = gathered(COMM, number, values), other.fields[name]
            if name == "carrying":
                np.testing.assert_array_equal(every, wanted)
                continue
            size = 1.0
            if name == "displacement":
                size = abs(wanted).max()
            elif name.endswith("energy"):
                size = energy
            elif name.endswith("tension"):
                size = 1e-2 * network.fabric.c11
            np.testing.assert_allclose(every, wanted, rtol=0, atol=1e-7 * size, err_msg=name)
        moved = gathered(COMM, network.node_key[:owned], state.node_displacement[:owned])
        wanted = other.node_displacement
        np.testing.assert_allclose(moved, wanted, rtol=0, atol=1e-7 * abs(wanted).max())
    zones = gathered(COMM, number, result.zones)
    np.testing.assert_array_equal(zones, alone.zones)
    told, wanted = (r.experiment.figures(r).get("closed_form", {}) for r in (result, alone))
    assert told.keys() == wanted.keys()
    assert told.pop("sentence", "")[:40] == wanted.pop("sentence", "")[:40]
    assert told == pytest.approx(wanted, rel=1e-6)


@BENDING
@pytest.mark.parametrize("name", TESTS)
def test_every_kind(name, bending):
    """Hanging crossovers, tails, turned frames, clamps that turn: each kind has its own."""
    _, alone = solved(MPI.COMM_SELF, name, bending)
    _, result = solved(COMM, name, bending)
    same(result, alone)


@pytest.mark.parametrize(
    ("name", "bending"),
    # A law is not asked at small displacements; without bending no clamp keeps the biaxial net
    # from turning its crossovers to and fro.
    [
        (n, b)
        for n in TESTS
        for b in (False, True)
        if n != "sin-potential" and (b or n not in ("biaxial", "crimp"))
    ],
)
def test_every_kind_at_small_displacements(name, bending):
    """Edges that turn, are guided, or whose clamps hold directions; one system each."""
    _, alone = solved(MPI.COMM_SELF, name, bending, finite=False)
    _, result = solved(COMM, name, bending, finite=False)
    same(result, alone)


@pytest.mark.parametrize("finite", [False, True])
def test_cantilever(finite):
    """Dead loads, and the tip's mean over the ranks that have a part of the edge."""
    preform = Preform.rectangle(4 * PITCH, 10 * PITCH, 0.0)
    tests = [
        Cantilever(Network(comm, preform, TABLE_1), ["0.01 N", "0.05 N"], finite=finite)
        for comm in (MPI.COMM_SELF, COMM)
    ]
    alone, result = (test.solve() for test in tests)
    same(result, alone)
    tip = tests[0].tip(alone)
    np.testing.assert_allclose(tests[1].tip(result), tip, atol=1e-8 * abs(tip).max())


@BENDING
def test_iterative_solver(bending):
    """CG with algebraic multigrid on several ranks against Cholesky on one."""
    _, alone = solved(MPI.COMM_SELF, "table-1", bending)
    _, result = solved(COMM, "table-1", bending, options=ITERATIVE)
    np.testing.assert_allclose(result.loads, alone.loads, rtol=1e-8)
    assert all(i.linear_iterations > 5 * i.iterations for i in result.increments)


@BENDING
def test_load_control(bending):
    """Extensions of given loads."""
    alone, result = (
        BiasExtension(
            Network(comm, diagonals(4, 8), TABLE_1), load=["1 N", "3 N"], finite=True,
            bending=bending,
        ).solve()
        for comm in (MPI.COMM_SELF, COMM)
    )  # fmt: skip
    np.testing.assert_allclose(result.loads, alone.loads, rtol=1e-8)
    np.testing.assert_allclose(result.controls, alone.controls, rtol=1e-7)


@BENDING
def test_spike(bending):
    """Hanging crossovers in a chain across ranks follow, flat; with bending they carry."""
    preform = Preform.polygon((np.array(SPIKE) * PITCH).tolist(), [], 0.0, origin=(0, 0.5 * PITCH))

    def motion(comm):
        constraints = Constraints(Network(comm, preform, TABLE_1), bending)
        nodes = constraints.clamp("lower")
        cloth = Cloth(constraints)
        # A rotation that grows along the yarns: whatever is known, the rest follows it straight.
        angle = 20 * cloth.rest[:, :1]
        x = np.hstack([
            cloth.rest[:, :1] * np.cos(angle) - cloth.rest[:, 1:] * np.sin(angle),
            cloth.rest[:, :1] * np.sin(angle) + cloth.rest[:, 1:] * np.cos(angle),
        ])  # fmt: skip
        state = cloth.state(x, [(nodes, np.eye(2), np.array([1e-3, 0.0]))])
        return cloth.ply, cloth.ply.displacement(state)

    few, (hinges, ends) = motion(MPI.COMM_SELF)
    many, (hinges_2, ends_2) = motion(COMM)
    network = many.network
    assert COMM.allreduce(many.supports.num_hanging) == few.supports.num_hanging
    found = gathered(COMM, network.crossover_number_global, hinges_2)
    np.testing.assert_allclose(found, hinges, atol=1e-12)
    owned = network.num_nodes_owned
    found = gathered(COMM, network.node_key[:owned], ends_2[:owned])
    np.testing.assert_allclose(found, ends, atol=1e-12)


def deformed(comm, name, bending):
    """A network in a random state that is the same on any number of ranks, and its keys."""
    _, preform, fabric, _, _ = TESTS[name]
    constraints = Constraints(Network(comm, preform, fabric), bending)
    nodes = constraints.clamp("lower")
    constraints.guide("right", (0.6, 0.8), 0.0)
    constraints.line_load("left", (30.0, 100.0))
    cloth = Cloth(constraints)
    key = cloth.nodes.node_key
    noise = np.stack([np.sin(key % 9973 + k) + np.cos(key % 7919 * (k + 1.0)) for k in (0, 1)], 1)
    c, s = np.cos(0.3), np.sin(0.3)
    motions = [(nodes, np.array([[c, -s], [s, c]]), np.array([1e-3, 0.0]))]
    return cloth, cloth.state(cloth.rest + 2e-4 * noise, motions, load=0.7), key


@BENDING
@pytest.mark.parametrize("name", ["table-1", "30-degrees", "L"])
def test_forces_and_matrix(name, bending):
    """Energies, forces, loads, and products of the tangent, filled anew and again."""
    few, state, key = deformed(MPI.COMM_SELF, name, bending)
    many, state_2, key_2 = deformed(COMM, name, bending)
    owned = many.nodes.num_nodes_owned
    at = np.searchsorted(key, key_2)
    np.testing.assert_array_equal(key[at], key_2)
    np.testing.assert_allclose(state_2.x, state.x[at], atol=1e-14)
    force, loads, energies = few.model.force(state)
    force_2, loads_2, energies_2 = many.model.force(state_2)
    assert abs(loads).max() > 0
    assert list(energies) == ["tension", "shear", "bending", "loads"]
    for mode, energy in energies.items():
        assert energies_2[mode] == pytest.approx(energy, rel=1e-12)
        assert many.model.energies(state_2)[mode] == pytest.approx(energy, rel=1e-12)
    size = abs(force).max()
    np.testing.assert_allclose(force_2, force[at], atol=1e-12 * size)  # ghosts, too
    np.testing.assert_allclose(loads_2, loads[at], atol=1e-12)
    np.testing.assert_array_equal(many.free(), few.free()[at])
    y = np.random.default_rng(3).normal(size=state.x.shape)
    one, blocks = few.model.stiffness(state)
    expected = (dense(one) @ y.ravel()).reshape(y.shape)
    matrix = None
    for place in (many.state(), state_2):
        matrix, blocks_2 = many.model.stiffness(place, reuse=matrix)
    vector = matrix.createVecRight()
    vector.setArray(y[at[:owned]].ravel())
    product = vector.duplicate()
    matrix.mult(vector, product)
    found = gathered(COMM, key_2[:owned], product.getArray().reshape(owned, 2))
    np.testing.assert_allclose(found, expected, atol=1e-12 * abs(expected).max())
    whole, whole_2 = few.model.times(blocks, y), many.model.times(blocks_2, y[at])
    np.testing.assert_allclose(whole_2, whole[at], atol=1e-12 * abs(whole).max())
    for thing in (one, matrix, vector, product):
        thing.destroy()


def in_space(comm, bending):
    """A wavy cloth in space; positions by place at rest, so that they do not depend on ranks."""
    constraints = Constraints(Network(comm, l_shape(0.06, 1.2), UNEVEN), bending)
    nodes = constraints.clamp("lower")
    cloth = Cloth(constraints, out_of_plane=(1e-3, 4e-4), flat=False)
    x, y = cloth.rest[:, 0] / 0.02, cloth.rest[:, 1] / 0.03
    wave = np.stack([np.cos(x + y), np.sin(x - 2 * y), 3 * np.sin(x) * np.cos(y) + x * y], axis=1)
    motions = [(nodes, np.eye(2), np.array([1e-3, 0.0]))]
    return cloth, cloth.state(cloth.rest + 1e-3 * wave, motions)


@BENDING
def test_in_space(bending):
    """Bending out of the plane looks at yarns that cross on both sides of an arm end."""
    few, state = in_space(MPI.COMM_SELF, bending)
    many, state_2 = in_space(COMM, bending)
    force, _, energies = few.model.force(state)
    force_2, _, energies_2 = many.model.force(state_2)
    assert energies["out_of_plane_bending"] > 1e-6
    for mode, energy in energies.items():
        assert energies_2[mode] == pytest.approx(energy, rel=1e-12, abs=1e-20)
    at = np.searchsorted(few.nodes.node_key, many.nodes.node_key)
    np.testing.assert_allclose(force_2, force[at], atol=1e-12 * abs(force).max())
    one, two = few.ply.fields(state), many.ply.fields(state_2)
    for name in ("shear_angle", "out_of_plane_bending_energy", "displacement"):
        found = gathered(COMM, many.network.crossover_number_global, two[name])
        np.testing.assert_allclose(found, one[name], atol=1e-12 * abs(one[name]).max())


@BENDING
def test_idle_ranks(bending):
    """Five crossovers: on three ranks somebody has one or none, and takes part in everything."""
    preform = Preform.rectangle(DIAGONAL, DIAGONAL, np.pi / 4)
    results = [
        BiasExtension(
            Network(comm, preform, TABLE_1), ["0.1 mm", "0.3 mm"], finite=True, bending=bending
        ).solve()
        for comm in (MPI.COMM_SELF, COMM)
    ]  # fmt: skip
    same(results[1], results[0])


def test_a_rank_that_owns_nothing():
    """A single crossover between two clamps."""
    side = 1.4 * PITCH
    preform = Preform.rectangle(side, side, np.pi / 4)
    results = [
        BiasExtension(Network(comm, preform, TABLE_1), "0.1 mm", finite=True, bending=True).solve()
        for comm in (MPI.COMM_SELF, COMM)
    ]
    owned = results[1].network.num_crossovers_owned
    assert COMM.allreduce(int(owned == 0)) == COMM.size - 1
    same(results[1], results[0])


# -- errors: the same on every rank --------------------------------------------------------------


def test_what_cannot_be_solved(monkeypatch):
    """Message, reason, place and what was reached, on every rank and as on one."""
    monkeypatch.setattr(newton, "MAX_ITERATIONS", 6)  # to fail sooner
    fabric = TABLE_1.with_shear_law(laws.odd_polynomial([96.0, -100.0]))
    errors = []
    for comm in (MPI.COMM_SELF, COMM):
        with pytest.raises(EquilibriumError) as caught:
            BiasExtension(
                Network(comm, diagonals(3, 6), fabric), ["2 mm", "3.5 mm", "10 mm"], finite=True,
                bending=False,
            ).solve()  # fmt: skip
        errors.append(caught.value)
    alone, error = errors
    told = COMM.allgather((str(error), error.reason, error.place.tolist(), error.history))
    assert all(one == told[0] for one in told)
    np.testing.assert_allclose(error.result.controls[:2], [0.002, 0.0035])
    np.testing.assert_allclose(error.result.loads, alone.result.loads, rtol=1e-8)


def test_no_equilibrium_where_a_rank_owns_nothing(monkeypatch):
    """The place of the largest force is the one rank's that has any; told by all."""
    monkeypatch.setattr(newton, "RELATIVE_RESIDUAL", -1.0)
    side = 1.4 * PITCH
    network = Network(COMM, Preform.rectangle(side, side, np.pi / 4), TABLE_1)
    assert COMM.allreduce(int(network.num_nodes_local == 0)) == COMM.size - 1
    with pytest.raises(EquilibriumError, match="farthest from balance at x = ") as caught:
        BiasExtension(network, "3 mm", finite=True, bending=True).solve()
    assert len(set(COMM.allgather(str(caught.value)))) == 1


def test_edge_without_yarns():
    """Found by one rank only, told by all."""
    points = [(0, 0), (4, 0), (4, 4), (3.6, 4), (3.6, 4.5), (3.5, 4.5), (3.5, 4), (0, 4)]
    spike = Preform.polygon((np.array(points) * PITCH).tolist(), [], 0.0, origin=(0.0, 0.0))
    with pytest.raises(InputError, match="no yarn reaches the edge 'upper'"):
        BiasExtension(Network(COMM, spike, TABLE_1), "1 um", finite=True).solve()
