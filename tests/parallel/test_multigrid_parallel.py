# SPDX-License-Identifier: MIT
"""The yarn multigrid: what it interpolates, how fast it converges, on any number of ranks."""

from dataclasses import replace
from math import radians

import numpy as np
import pytest
import shapely
from mpi4py import MPI
from petsc4py import PETSc
from support.helpers import UNEVEN, affine_motion

from cruciform_petsc import BiasExtension, Fabric, Network, Preform
from cruciform_petsc.errors import SolverError
from cruciform_petsc.net.edges import Constraints
from cruciform_petsc.parallel import Halo
from cruciform_petsc.small.network import LinearNetwork
from cruciform_petsc.solvers.csr import local_rows, write_values
from cruciform_petsc.solvers.linear import LinearSolver
from cruciform_petsc.solvers.multigrid import contrast, hierarchy, interpolation
from cruciform_petsc.solvers.yarns import OnYarns, YarnSmoother, steps

COMM = MPI.COMM_WORLD
TABLE_1 = Fabric.from_library("e-glass-plain-2.4")
_STIFF = replace(TABLE_1.warp, modulus=96e5)
STIFF = replace(TABLE_1, warp=_STIFF, weft=_STIFF)
YARN_MULTIGRID = {"pc_type": "mg", "ksp_rtol": 1e-8}
BOX = shapely.box(0.0, 0.0, 0.3, 0.32)
OUTLINES = {
    "rectangle": BOX,
    "l-shape": BOX.difference(shapely.box(0.15, 0.15, 0.3, 0.32)),
    "hole": BOX.difference(shapely.Point(0.15, 0.16).buffer(0.06)),
}


def interpolated(matrices, levels, field):
    """Fine values of the coarsest level's displacement, a function of the lattice's points."""
    coarse = levels[-1]
    values = (coarse.values[:, :2] * field(coarse.point)).sum(axis=1)
    for matrix in reversed(matrices):
        x, y = matrix.createVecs()
        x.setArray(values)
        matrix.mult(x, y)
        values = y.getArray().copy()
    return values


@pytest.mark.parametrize("bending", [True, False])
def test_interpolates_affine_motions(bending):
    """Translations, both stretches, both rotations of yarns: in the coarse spaces, over two levels.

    Translations everywhere: corners that do not exist at the outline are made up for. The others
    where all corners exist. Warp yarns turn with d u_weft/d warp, weft yarns against d u_warp/d
    weft; a rigid rotation is both.
    """
    network = Network(COMM, Preform(OUTLINES["rectangle"], radians(20)), UNEVEN)
    constraints = Constraints(network, bending)
    constraints.clamp("lower")
    linear = LinearNetwork(constraints)
    owned = slice(0, network.num_nodes_owned)
    levels, matrices = [linear.unknowns()], []
    for step in (2, 4):
        matrix, coarse, _ = interpolation(COMM, levels[-1], step)
        assert coarse.point.shape == (matrix.getLocalSize()[1], 2)
        assert matrix.getSize()[1] < 0.5 * matrix.getSize()[0]
        levels.append(coarse)
        matrices.append(matrix)
    free = linear.free[owned]
    x, y = network.node_position[owned].T
    inside = (abs(x - 0.15) < 0.15 - 10 / 200) & (abs(y - 0.16) < 0.16 - 10 / 200)
    assert COMM.allreduce(int(inside.sum())) > 1000
    for gradient in np.eye(4).reshape(4, 2, 2), np.array([[[0.0, -1.0], [1.0, 0.0]]]):
        for one in gradient:
            found = interpolated(matrices, levels, lambda at, g=one: at * network.pitch @ g.T)
            expected = affine_motion(linear, one)[owned]
            wrong = abs(found.reshape(free.shape) - expected)[inside]
            assert wrong.max(initial=0.0) < 1e-12
    for shift in np.eye(2):
        found = interpolated(matrices, levels, lambda at, u=shift: np.tile(u, (len(at), 1)))
        expected = affine_motion(linear, np.zeros((2, 2)), shift)[owned]
        assert abs(found.reshape(free.shape) - expected)[free].max(initial=0.0) < 1e-12
    for matrix in matrices:
        matrix.destroy()


@pytest.mark.three_ranks
@pytest.mark.parametrize("bending", [True, False])
@pytest.mark.parametrize("outline", OUTLINES)
@pytest.mark.parametrize("angle", [0, 20, 45])
def test_agrees_with_direct_solution_in_few_iterations(outline, angle, bending):
    network = Network(COMM, Preform(OUTLINES[outline], radians(angle)), TABLE_1)
    direct = BiasExtension(network, extension=3e-3, bending=bending, finite=False).solve()
    result = BiasExtension(
        network, extension=3e-3, bending=bending, options=YARN_MULTIGRID, finite=False
    ).solve()
    assert (result.solver.pc, direct.solver.pc) == ("mg", "cholesky")
    # Measured: 7 to 12 on one rank and on two; three ranks leave something out where a yarn
    # runs over all of them.
    assert result.solver.iterations <= (15 if COMM.size < 3 else 20)
    difference = abs(result.fields["displacement"] - direct.fields["displacement"]).max(initial=0.0)
    # Residual 1e-8 times a condition number whose smooth part is some hundreds.
    assert COMM.allreduce(float(difference), MPI.MAX) < 1e-5 * 3e-3
    # The same for the load: 6e-7 on three ranks, 4e-8 with a residual of 1e-9, 8e-10 with 1e-10.
    assert result.load == pytest.approx(direct.load, rel=1e-6)


@pytest.mark.parametrize("bending", [True, False])
@pytest.mark.parametrize("outline", OUTLINES)
def test_very_stiff_yarns(outline, bending):
    """E/G = 10^5, as in carbon: whole yarns are solved, and swept more often."""
    network = Network(COMM, Preform(OUTLINES[outline], radians(45)), STIFF)
    result = BiasExtension(
        network, extension=3e-3, bending=bending, options=YARN_MULTIGRID, finite=False
    ).solve()
    assert result.solver.iterations <= 25


@pytest.mark.parametrize("bending", [True, False])
def test_iterations_hardly_grow(bending):
    """Four and sixteen times the cloth."""
    counts = []
    for size in (0.12, 0.24, 0.48):
        network = Network(COMM, Preform(shapely.box(0, 0, size, 1.05 * size), 0.7), TABLE_1)
        test = BiasExtension(
            network, extension=1e-3, bending=bending, options=YARN_MULTIGRID, finite=False
        )
        counts.append(test.solve().solver.iterations)
    assert max(counts) <= 15
    assert max(counts) - min(counts) < 4


@pytest.mark.three_ranks
@pytest.mark.parametrize("refine", [2, 4, 8])
def test_bending_further_than_a_pitch(refine):
    """At refine 4 yarns bend over more than a pitch, sqrt(D/G): the weft goes beyond equilibrium.

    With weights of 1 similar nets of 10^4 crossovers took 15, 18 and 19 iterations.
    """
    box = shapely.box(0, 0, 0.24 / refine, 0.25 / refine)
    network = Network(COMM, Preform(box, radians(45), refine=refine), TABLE_1)
    test = BiasExtension(network, extension=1e-3, options=YARN_MULTIGRID, finite=False)
    assert test.solve().solver.iterations <= {2: 11, 4: 14, 8: 15}[refine]


# -- parts -------------------------------------------------------------------------------------


def clamped(outline, bending, fabric=TABLE_1):
    """A network held at its lower edge, and its matrix."""
    network = Network(COMM, Preform(OUTLINES[outline], radians(20)), fabric)
    constraints = Constraints(network, bending)
    constraints.clamp("lower")
    linear = LinearNetwork(constraints)
    return linear, linear.matrix()


def random_vector(matrix, seed):
    """Values for this rank's rows."""
    rng = np.random.default_rng(100 * seed + COMM.rank)
    return rng.standard_normal(matrix.getLocalSize()[0])


def times(matrix, values):
    """This rank's part of matrix times vector."""
    x, y = matrix.createVecs()
    x.setArray(values)
    matrix.mult(x, y)
    return y.getArray().copy()


def dot(a, b):
    """Inner product of distributed vectors."""
    return COMM.allreduce(float(a @ b))


@pytest.mark.parametrize("fabric", [TABLE_1, STIFF], ids=["table-1", "stiff"])
@pytest.mark.parametrize("bending", [True, False])
@pytest.mark.parametrize("family", [0, 1])
def test_a_family_is_solved_whole(family, bending, fabric):
    """After its solve no force is left on the family's unknowns, on two ranks neither."""
    linear, matrix = clamped("hole", bending, fabric)
    unknowns = linear.unknowns()
    smoother = YarnSmoother(matrix, unknowns.lines)
    force = random_vector(matrix, 1)
    x = smoother.apply(force, [(family, 1.0)]).copy()
    member = unknowns.lines.line[:, family] >= 0
    assert not x[~member].any()
    left = (force - times(matrix, x))[member]
    # Factors are kept in single precision, 6e-8; a yarn's condition is E/G or its length.
    size = COMM.allreduce(float(abs(x).max()), MPI.MAX) * COMM.allreduce(matrix.norm(), MPI.MAX)
    assert abs(left).max(initial=0.0) < (1e-6 * size if COMM.size < 3 else np.inf)
    matrix.destroy()


def test_ghost_nodes_are_whole():
    """Of a node this rank's rows know one unknown only; the joint behind it is found all the same.

    Nodes of two unknowns: 0 on a yarn of its own, 1 and 2 on one yarn, cut between the ranks.
    """
    own = {1: (0, 6), 2: (0, 4) if COMM.rank == 0 else (4, 6)}[min(COMM.size, 2)]
    dense = np.diag(np.full(6, 4.0))
    for row, column, value in ((1, 4, 0.5), (2, 4, -1.0), (3, 5, -2.0), (2, 5, 0.3), (0, 1, 0.2)):
        dense[row, column] = dense[column, row] = value
    matrix = PETSc.Mat().createAIJ(((own[1] - own[0], 6),) * 2, nnz=6, bsize=2, comm=COMM)
    for row in range(*own):
        for column in np.flatnonzero(dense[row]):
            matrix.setValue(row, column, dense[row, column])
    matrix.assemble()
    node = np.arange(*own) // 2
    line = np.stack([np.where(node == 0, 0, 1), np.full(len(node), -1)], axis=1).astype(np.int32)
    lines = OnYarns(line, np.stack([node, node], axis=1).astype(float), None)
    force = np.arange(1.0, 7.0)
    x = YarnSmoother(matrix, lines).apply(force[slice(*own)], [(0, 1.0)]).copy()
    every = np.concatenate(COMM.allgather(x))
    # Couplings between different yarns are left out, and their size is added to the diagonal.
    dense[1, 1] += 0.5
    dense[4, 4] += 0.5
    dense[1, 4] = dense[4, 1] = 0.0
    np.testing.assert_allclose(every, np.linalg.solve(dense, force), rtol=1e-6)
    matrix.destroy()


@pytest.mark.three_ranks
def test_yarns_that_cannot_be_joined():
    """A singular joint is known on the lower of two ranks only: all raise, and none waits."""
    matrix = PETSc.Mat().createAIJ(((1, None), (1, None)), nnz=2, comm=COMM)
    matrix.setValue(COMM.rank, COMM.rank, 1.0)
    if COMM.rank < 2 <= COMM.size:
        matrix.setValue(COMM.rank, 1 - COMM.rank, 1.0)
    matrix.assemble()
    lines = OnYarns(np.array([[0, -1]], np.int32), np.array([[float(COMM.rank), 0.0]]), None)
    if COMM.size == 1:
        YarnSmoother(matrix, lines)
    else:
        with pytest.raises(SolverError, match="where ranks meet"):
            YarnSmoother(matrix, lines)
    matrix.destroy()


def test_contrast_of_a_diagonal_with_zeros():
    """Without a division by zero."""
    matrix = PETSc.Mat().createAIJ(((10, None), (10, None)), nnz=1, comm=COMM)
    for row in range(*matrix.getOwnershipRange()):
        matrix.setValue(row, row, float(row % 2))
    matrix.assemble()
    with np.errstate(all="raise"):
        assert contrast(matrix) == np.inf
    matrix.destroy()


@pytest.mark.three_ranks
@pytest.mark.parametrize("bending", [True, False])
def test_sweeps_up_are_the_transpose_of_sweeps_down(bending):
    """Else the preconditioner of CG would not be symmetric."""
    linear, matrix = clamped("l-shape", bending)
    smoother = YarnSmoother(matrix, linear.unknowns().lines)
    a, b = random_vector(matrix, 2), random_vector(matrix, 3)
    x = smoother.apply(a, steps(2)).copy()
    down = dot(b, x)
    up = dot(a, smoother.apply(b, steps(2)[::-1]))
    norm = np.sqrt(dot(b, b) * dot(x, x))  # single precision is 6e-8 of that
    assert down == pytest.approx(up, abs=1e-6 * norm)
    matrix.destroy()


@pytest.mark.parametrize("bending", [True, False])
@pytest.mark.parametrize("fabric", [TABLE_1, STIFF], ids=["table-1", "stiff"])
def test_cycle_is_symmetric(fabric, bending):
    """As it must be for CG, though sweeps up take no residual and down does with the matrix itself.

    What is left is rounding to single precision.
    """
    linear, matrix = clamped("hole", bending, fabric)
    solver = LinearSolver(matrix, extra=YARN_MULTIGRID, multigrid=linear.multigrid)
    vectors, images = [], []
    for seed in (4, 5):
        b, x = matrix.createVecs()
        b.setArray(random_vector(matrix, seed))
        solver.ksp.getPC().apply(b, x)
        vectors.append(b)
        images.append(x)
    (a, b), (x, y) = vectors, images
    assert a.dot(x) > 0
    assert b.dot(y) > 0
    assert a.dot(y) == pytest.approx(b.dot(x), abs=1e-5 * np.sqrt(a.dot(x) * b.dot(y)))
    solver.destroy()
    for thing in (*vectors, *images, matrix):
        thing.destroy()


@pytest.mark.parametrize("sweeps", [1, 2, 4])
def test_sweeps_are_chebyshevs(sweeps):
    """Pairs of a warp and a weft unknown, [1 c; c 1]: what is left of the weft's is known.

    With the warp in equilibrium 1 - c^2 is the eigenvalue, and Chebyshev's polynomial, scaled to 1
    at 0, the least on 0.3 to 1.
    """
    eigenvalue = np.linspace(0.01, 0.99, 50)
    coupling = np.sqrt(1.0 - eigenvalue)
    matrix = PETSc.Mat().createAIJ((100, 100), nnz=2, comm=MPI.COMM_SELF)
    for k, c in enumerate(coupling):
        matrix.setValues([2 * k, 2 * k + 1], [2 * k, 2 * k + 1], [[1.0, c], [c, 1.0]])
    matrix.assemble()
    line = np.full((100, 2), -1, np.int32)
    line[::2, 0] = line[1::2, 1] = np.arange(50)
    smoother = YarnSmoother(matrix, OnYarns(line, np.zeros((100, 2))))
    left = smoother.apply(np.zeros(100), steps(sweeps), np.ones(100))
    chebyshev = np.polynomial.Chebyshev.basis(sweeps)
    expected = chebyshev((1.3 - 2 * eigenvalue) / 0.7) / chebyshev(1.3 / 0.7)
    np.testing.assert_allclose(left[1::2], expected, atol=1e-5)
    np.testing.assert_allclose(left[::2], -coupling * left[1::2], atol=1e-6)  # in equilibrium
    matrix.destroy()


@pytest.mark.three_ranks
@pytest.mark.parametrize("bending", [True, False])
@pytest.mark.parametrize("outline", OUTLINES)
def test_galerkin_products_are_petscs(outline, bending):
    """All levels, against PETSc's triple product."""
    linear, matrix = clamped(outline, bending)
    levels = hierarchy(matrix, linear.unknowns(), coarsest=300)
    assert len(levels.matrices) >= 3
    fine = matrix
    for prolongation, product in zip(levels.interpolations, levels.matrices, strict=True):
        expected = fine.ptap(prolongation)
        norm = expected.norm()
        expected.axpy(-1.0, product)
        assert expected.norm() < 1e-13 * norm
        assert product.isSymmetric(0.0)  # to the last bit: of the fine matrix one half is read
        expected.destroy()
        fine = product
    for thing in (*levels.matrices, *levels.interpolations, matrix):
        thing.destroy()


def test_couplings_that_reach_too_far_are_left_to_petsc():
    """A matrix that couples unknowns of distant crossovers is multiplied by PETSc."""
    linear, matrix = clamped("rectangle", True)
    square = matrix.matMult(matrix)
    square = square.matMult(matrix)
    levels = hierarchy(square, linear.unknowns())
    expected = square.ptap(levels.interpolations[0])
    norm = expected.norm()
    expected.axpy(-1.0, levels.matrices[0])
    assert expected.norm() < 1e-13 * norm


@pytest.mark.three_ranks
def test_local_rows_and_values():
    """Arrays seen in place are those that PETSc copies; values written are there."""
    _, matrix = clamped("hole", True)
    begin, end = matrix.getOwnershipRange()
    pointer, column, value = matrix.getValuesCSR()
    with local_rows(matrix) as rows:
        assert np.array_equal(np.diff(rows.pointer) + np.diff(rows.ghost_pointer), np.diff(pointer))
        own = (column >= begin) & (column < end)
        np.testing.assert_array_equal(rows.column + begin, column[own])
        np.testing.assert_array_equal(rows.value, value[own])
        np.testing.assert_array_equal(rows.ghost[rows.ghost_column], column[~own])
        np.testing.assert_array_equal(rows.ghost_value, value[~own])
        halo = Halo.of_numbers(COMM, end - begin, rows.ghost)
        ghost = rows.ghost.copy()
    numbers = np.concatenate([np.arange(begin, end), np.zeros(len(ghost), np.int64)])
    np.testing.assert_array_equal(halo.forward(numbers)[end - begin :], ghost)
    ones = np.concatenate([np.zeros(end - begin), np.ones(len(ghost))])
    halo.reverse(ones)
    assert COMM.allreduce(ones[: end - begin].sum()) == COMM.allreduce(len(ghost))
    write_values(matrix, lambda values: np.copyto(values, value[::-1]), column)
    np.testing.assert_array_equal(matrix.getValuesCSR()[2], value[::-1])
    matrix.destroy()
