# SPDX-License-Identifier: MIT
"""Matrices, loads, fields and errors on several ranks against one rank alone."""

import numpy as np
import pytest
from mpi4py import MPI
from petsc4py import PETSc
from support.helpers import (
    DIAGONAL,
    PITCH,
    TABLE_1,
    UNEVEN,
    bias_extension,
    dense,
    diagonals,
    gathered,
    holed,
    l_shape,
    solve,
)

from cruciform_petsc.cloth.preform import Preform
from cruciform_petsc.errors import InputError, SolverError
from cruciform_petsc.net.edges import Constraints
from cruciform_petsc.net.network import Network
from cruciform_petsc.small.network import LinearNetwork
from cruciform_petsc.solvers.options import ITERATIVE, PREFIX

COMM = MPI.COMM_WORLD
pytestmark = pytest.mark.three_ranks

BENDING = pytest.mark.parametrize("bending", [False, True], ids=["flat", "bending"])
SPIKE = [(-3, 0), (3, 0), (3, 3), (0.4, 3), (0.4, 27.3), (-0.4, 27.3), (-0.4, 3), (-3, 3)]
PREFORMS = {
    "table-1": (diagonals(4, 6, refine=2), TABLE_1),
    "30-degrees": (Preform.rectangle(0.024, 0.036, "30 deg", refine=2), TABLE_1),
    "hole": (holed(0.05, 0.07, 0.011, 0.4), UNEVEN),
    "L": (l_shape(0.06, 1.2), UNEVEN),
    "spike": (
        Preform.polygon((np.array(SPIKE) * PITCH).tolist(), [], 0.0, origin=(0.0, 0.5 * PITCH)),
        TABLE_1,
    ),
}


def everywhere(flag):
    """Whether something holds on every rank."""
    return COMM.allreduce(bool(flag), MPI.LAND)


def same(solved, alone, extension=1e-3):
    """Compare all fields of a solution, gathered, with those of one rank alone."""
    network = solved.network
    number = network.crossover_number_global
    for name, values in solved.fields.items():
        every, expected = gathered(COMM, number, values), alone.fields[name]
        if name == "carrying":
            np.testing.assert_array_equal(every, expected)
        elif name == "displacement":
            assert abs(every - expected).max() < 1e-8 * abs(expected).max()
        else:
            # Strains and rotations are differences over an arm, which may be a hundredth of a
            # pitch; the largest of each kind takes the place of the largest displacement. Energies
            # are u K u: rounding of what a whole crossover's motion adds to it is left over.
            size = abs(alone.fields["displacement"]).max()
            rounding = 1e-15 * alone.model.typical_stiffness * size**2 * name.endswith("_energy")
            assert abs(every - expected).max() <= 1e-6 * abs(expected).max() + rounding
    owned = network.num_nodes_owned
    moved = gathered(COMM, network.node_key[:owned], solved.node_displacement())
    assert abs(moved - alone.node_displacement()).max() < 1e-8 * extension


@BENDING
@pytest.mark.parametrize("name", ["table-1", "30-degrees", "hole"])
def test_bias_extension(name, bending):
    """Every field at every crossover and node, to 1e-8 of the largest displacement."""
    preform, fabric = PREFORMS[name]
    alone = bias_extension(preform, bending, fabric)
    solved = bias_extension(preform, bending, fabric, COMM)
    same(solved, alone)
    np.testing.assert_allclose(
        solved.force_on("upper"), alone.force_on("upper"), atol=1e-8 * alone.force_on("upper")[1]
    )
    assert solved.energy == pytest.approx(alone.energy, rel=1e-9)


def loaded(comm, preform, fabric, bending):
    """Clamp below, another edge guided, load on a third: turned frames, tails, passed on loads."""
    constraints = Constraints(Network(comm, preform, fabric), bending)
    constraints.clamp("lower", (1e-4, 2e-4))
    constraints.guide("right", (0.6, 0.8), 1e-4)
    for edge in ("upper", "left", *(name for name in preform.edges if name.startswith("hole"))):
        constraints.line_load(edge, (30.0, 100.0))
    return constraints


@BENDING
@pytest.mark.parametrize("name", PREFORMS)
def test_loads_guides_and_hanging_crossovers(name, bending):
    """Line loads are shared alike, hanging crossovers go along across borders of ranks."""
    preform, fabric = PREFORMS[name]
    alone = solve(loaded(MPI.COMM_SELF, preform, fabric, bending))
    solved = solve(loaded(COMM, preform, fabric, bending))
    owned = solved.network.num_nodes_owned
    key = solved.network.node_key[:owned]
    for force, expected in (
        (solved.constraints.force, alone.constraints.force),
        (solved.model.force, alone.model.force),
        (solved.model.loads(), alone.model.loads()),
    ):
        size = abs(expected).max()
        np.testing.assert_allclose(gathered(COMM, key, force[:owned]), expected, atol=1e-12 * size)
    round_ = gathered(COMM, solved.network.crossover_number_global, solved.model.supports.round_)
    np.testing.assert_array_equal(round_, alone.model.supports.round_)
    same(solved, alone, abs(alone.fields["displacement"]).max())


def test_spike_crosses_ranks():
    """What the spike is there for: a chain of hanging crossovers that is cut by a rank's border."""
    preform, fabric = PREFORMS["spike"]
    constraints = Constraints(Network(COMM, preform, fabric), False)
    constraints.clamp("lower")
    hanging = LinearNetwork(constraints).supports.num_hanging
    assert COMM.allreduce(hanging) == 24
    assert COMM.allreduce(int(hanging > 0)) >= min(COMM.size, 2)


@BENDING
@pytest.mark.parametrize("name", PREFORMS)
def test_matrix(name, bending):
    """Products of the matrix with a vector, of all modes and one, filled anew and again."""
    preform, fabric = PREFORMS[name]
    few = LinearNetwork(loaded(MPI.COMM_SELF, preform, fabric, bending))
    many = LinearNetwork(loaded(COMM, preform, fabric, bending))
    owned = many.network.num_nodes_owned
    key = many.network.node_key
    x = np.random.default_rng(3).normal(size=(few.network.num_nodes_owned, few.unknowns_per_node))
    mine = x[np.searchsorted(few.network.node_key, key)]
    matrix = many.matrix()
    for modes in ((), ("tension",), ()):
        matrix = many.matrix(*modes, reuse=matrix)
        vector = many.vector(mine)
        product = vector.duplicate()
        matrix.mult(vector, product)
        found = gathered(COMM, key[:owned], product.getArray().reshape(owned, -1))
        expected = (dense(few.matrix(*modes)) @ x.ravel()).reshape(x.shape)
        np.testing.assert_allclose(found, expected, atol=1e-12 * abs(expected).max())
        force = gathered(COMM, key[:owned], many.element_forces(mine, *modes)[:owned])
        expected = few.element_forces(x, *modes)
        np.testing.assert_allclose(force, expected, atol=1e-12 * abs(expected).max())
    np.testing.assert_array_equal(
        matrix.getOwnershipRange()[0], many.network.node_offset * x.shape[1]
    )
    matrix.destroy()


@BENDING
def test_soft_motions(bending):
    """All of them are the same on any number of ranks, ghosts included."""
    preform, fabric = PREFORMS["hole"]
    few = LinearNetwork(loaded(MPI.COMM_SELF, preform, fabric, bending))
    many = LinearNetwork(loaded(COMM, preform, fabric, bending))
    at = np.searchsorted(few.network.node_key, many.network.node_key)
    np.testing.assert_allclose(many.soft_motions(), few.soft_motions()[at], atol=1e-12)
    np.testing.assert_allclose(many.rigid_motions(), few.rigid_motions()[at], atol=1e-12)


@BENDING
def test_iterative_solver(bending):
    """CG with GAMG on several ranks against the direct solver on one."""
    preform, fabric = PREFORMS["table-1"]
    alone = bias_extension(preform, bending, fabric)
    solved = bias_extension(preform, bending, fabric, COMM, options=ITERATIVE)
    assert solved.info.ksp == "cg"
    number = solved.network.crossover_number_global
    moved = gathered(COMM, number, solved.fields["displacement"])
    assert abs(moved - alone.fields["displacement"]).max() < 1e-6 * 1e-3


def test_idle_ranks():
    """A single crossover: the other ranks own nothing and take part in everything."""
    side = 1.4 * PITCH
    preform = Preform.rectangle(side, side, np.pi / 4)
    for bending in (False, True):
        alone = bias_extension(preform, bending)
        solved = bias_extension(preform, bending, comm=COMM)
        assert COMM.allreduce(int(solved.network.num_crossovers_owned == 0)) == COMM.size - 1
        same(solved, alone)


# -- errors: the same on every rank --------------------------------------------------------------


def test_too_few_iterations():
    """Reason and history everywhere, and the options database is clean again."""
    before = PETSc.Options().getAll()
    with pytest.raises(SolverError) as caught:
        bias_extension(diagonals(4, 6), True, comm=COMM, options={**ITERATIVE, "ksp_max_it": 2})
    told = COMM.allgather((str(caught.value), caught.value.reason, caught.value.history))
    assert all(one == told[0] for one in told)
    assert caught.value.reason == "DIVERGED_MAX_IT"
    assert len(caught.value.history) == 3
    assert PETSc.Options().getAll() == before
    assert not any(name.startswith(PREFIX) for name in before)


def test_mechanism():
    """A chain of crossovers without bending, cut between the ranks."""
    preform = Preform.rectangle(1.4 * PITCH, 12.4 * PITCH, 0.0)
    constraints = Constraints(Network(COMM, preform, TABLE_1), False)
    constraints.clamp("lower")
    constraints.clamp("upper", (0.0, 1e-4))
    with pytest.raises(SolverError) as caught:
        solve(constraints)
    assert everywhere(caught.value.reason in ("MECHANISM", "DIVERGED_PC_FAILED"))


@pytest.mark.parametrize(
    ("edges", "message"),
    [
        ([], "can float"),
        (["lower"], "a part of"),
        (["nowhere"], "no edge"),
        (["outline-3"], "no yarn reaches the edge"),
    ],
)
def test_bad_clamps(edges, message):
    """Floating bodies and parts, unknown edges, edges between yarns: one sentence, on all ranks."""
    points = np.array(
        [(0, 0), (5, 0), (5, 4.7), (4.9, 4.8), (4.8, 5), (2.3, 5), (2.3, 6), (5, 6), (5, 11),
         (0, 11), (0, 6), (1.7, 6), (1.7, 5), (0, 5)]
    )  # fmt: skip
    preform = Preform.polygon((points * PITCH).tolist(), [], 0.0, origin=(0.5 * PITCH, 0.5 * PITCH))
    constraints = Constraints(Network(COMM, preform, TABLE_1), True)

    def constrain():
        for edge in edges:
            constraints.clamp(edge)
        LinearNetwork(constraints)

    with pytest.raises(InputError, match=message) as caught:
        constrain()
    assert len(set(COMM.allgather(str(caught.value)))) == 1


def test_parts_held_by_several_ranks():
    """A long strip has three prescribed unknowns, each on another rank: it is held."""
    network = Network(COMM, Preform.rectangle(3 * DIAGONAL, 30 * DIAGONAL, 0.2), TABLE_1)
    joints = network.node_key[: network.num_nodes_owned][
        np.bincount(network.arm_node[network.arm_is_shared], minlength=network.num_nodes_local)[
            : network.num_nodes_owned
        ]
        == 2
    ]
    keys = np.sort(np.concatenate(COMM.allgather(joints)))
    constraints = Constraints(network, True)
    constraints.pin(keys[0], (0,))
    constraints.pin(keys[len(keys) // 2], (1,))
    with pytest.raises(InputError, match="the body can float"):
        LinearNetwork(constraints)
    constraints.pin(keys[-1], (0,))
    LinearNetwork(constraints)
