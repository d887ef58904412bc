# SPDX-License-Identifier: MIT
"""The yarn multigrid: what it interpolates, how fast it converges, on any number of ranks."""

from dataclasses import replace
from math import radians

import numpy as np
import pytest
import shapely
from mpi4py import MPI
from petsc4py import PETSc

from cruciform_petsc import BiasExtension, Fabric, Network, Preform
from cruciform_petsc.errors import SolverError
from cruciform_petsc.net.edges import Constraints
from cruciform_petsc.parallel import Halo
from cruciform_petsc.small.network import LinearNetwork
from cruciform_petsc.solvers.csr import local_rows, write_values
from cruciform_petsc.solvers.multigrid import _contrast, hierarchy, interpolations, unknowns_of
from cruciform_petsc.solvers.yarns import OnYarns, YarnSmoother

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


@pytest.mark.parametrize("bending", [True, False])
def test_interpolates_constants_and_straight_lines(bending):
    """A rigid motion of the coarse lattice is one of the network, rotations of yarns included."""
    network = Network(COMM, Preform(OUTLINES["rectangle"], radians(20)), TABLE_1)
    constraints = Constraints(network, bending)
    constraints.clamp("lower")
    linear = LinearNetwork(constraints)
    matrices = interpolations(linear, coarsest=1000)
    assert len(matrices) >= 2
    first = matrices[0]
    free = linear.free[: network.num_nodes_owned].ravel()
    motions = linear.rigid_motions()[: network.num_nodes_owned].reshape(-1, 3)
    columns = first.createVecRight()
    begin, end = first.getOwnershipRangeColumn()
    # Which coarse unknowns are which component shows in what they do to the rigid translations.
    ones = first.createVecRight()
    ones.set(1.0)
    image = first.createVecLeft()
    first.mult(ones, image)
    if bending:
        both = motions[:, 0] + motions[:, 1]  # u = (1, 1) in the yarn frame, no rotation
        difference = abs(image.array - both)[free]
        # Corners that do not exist at the outline are made up for, up to rounding.
        assert difference.max() < 1e-12
    assert end - begin == columns.getLocalSize()
    for matrix in matrices:
        assert matrix.getSize()[1] < 0.7 * matrix.getSize()[0]
        matrix.destroy()
    for thing in (ones, image, columns):
        thing.destroy()


@pytest.mark.three_ranks
@pytest.mark.parametrize("bending", [True, False])
@pytest.mark.parametrize("outline", OUTLINES)
@pytest.mark.parametrize("angle", [0, 20, 45])
def test_agrees_with_direct_solution_in_few_iterations(outline, angle, bending):
    network = Network(COMM, Preform(OUTLINES[outline], radians(angle)), TABLE_1)
    direct = BiasExtension(network, extension=3e-3, bending=bending).solve()
    result = BiasExtension(network, extension=3e-3, bending=bending, options=YARN_MULTIGRID).solve()
    assert (result.solver.pc, direct.solver.pc) == ("mg", "cholesky")
    # Measured: 7 to 12 on one rank and on two; three ranks leave something out where a yarn
    # runs over all of them.
    assert result.solver.iterations <= (15 if COMM.size < 3 else 20)
    difference = abs(result.fields["displacement"] - direct.fields["displacement"]).max(initial=0.0)
    # Residual 1e-8 times a condition number whose smooth part is some hundreds.
    assert COMM.allreduce(float(difference), MPI.MAX) < 1e-5 * 3e-3
    assert result.load == pytest.approx(direct.load, rel=1e-7)


@pytest.mark.parametrize("bending", [True, False])
@pytest.mark.parametrize("outline", OUTLINES)
def test_very_stiff_yarns(outline, bending):
    """E/G = 10^5, as in carbon: whole yarns are solved, and swept more often."""
    network = Network(COMM, Preform(OUTLINES[outline], radians(45)), STIFF)
    result = BiasExtension(network, extension=3e-3, bending=bending, options=YARN_MULTIGRID).solve()
    assert result.solver.iterations <= 25


@pytest.mark.parametrize("bending", [True, False])
def test_iterations_hardly_grow(bending):
    """Four and sixteen times the cloth."""
    counts = []
    for size in (0.12, 0.24, 0.48):
        network = Network(COMM, Preform(shapely.box(0, 0, size, 1.05 * size), 0.7), TABLE_1)
        test = BiasExtension(network, extension=1e-3, bending=bending, options=YARN_MULTIGRID)
        counts.append(test.solve().solver.iterations)
    assert max(counts) <= 15
    assert max(counts) - min(counts) < 4


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
    unknowns = unknowns_of(linear)
    smoother = YarnSmoother(matrix, unknowns.lines)
    force = random_vector(matrix, 1)
    x = smoother.apply(force, (family,)).copy()
    member = unknowns.lines.line[:, family] >= 0
    assert not x[~member].any()
    left = (force - times(matrix, x))[member]
    # Factors are kept in single precision, 6e-8; a yarn's condition is E/G or its length.
    size = COMM.allreduce(float(abs(x).max()), MPI.MAX) * COMM.allreduce(matrix.norm(), MPI.MAX)
    assert abs(left).max(initial=0.0) < (1e-6 * size if COMM.size < 3 else np.inf)
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
        assert _contrast(matrix) == np.inf
    matrix.destroy()


@pytest.mark.three_ranks
@pytest.mark.parametrize("bending", [True, False])
def test_sweeps_up_are_the_transpose_of_sweeps_down(bending):
    """Else the preconditioner of CG would not be symmetric."""
    linear, matrix = clamped("l-shape", bending)
    smoother = YarnSmoother(matrix, unknowns_of(linear).lines)
    a, b = random_vector(matrix, 2), random_vector(matrix, 3)
    down = dot(b, smoother.apply(a, (0, 1, 0, 1)))
    up = dot(a, smoother.apply(b, (1, 0, 1, 0)))
    norm = np.sqrt(
        dot(a, smoother.apply(a, (0, 1, 0, 1))) * dot(b, smoother.apply(b, (0, 1, 0, 1)))
    )
    assert down == pytest.approx(up, abs=1e-6 * norm)
    matrix.destroy()


@pytest.mark.three_ranks
@pytest.mark.parametrize("bending", [True, False])
@pytest.mark.parametrize("outline", OUTLINES)
def test_galerkin_products_are_petscs(outline, bending):
    """All levels, against PETSc's triple product."""
    linear, matrix = clamped(outline, bending)
    levels = hierarchy(matrix, linear.network.partition, unknowns_of(linear), coarsest=300)
    assert len(levels.matrices) >= 3
    fine = matrix
    for interpolation, product in zip(levels.interpolations, levels.matrices, strict=True):
        expected = fine.ptap(interpolation)
        norm = expected.norm()
        expected.axpy(-1.0, product)
        assert expected.norm() < 1e-13 * norm
        expected.destroy()
        fine = product
    for thing in (*levels.matrices, *levels.interpolations, matrix):
        thing.destroy()


def test_couplings_that_reach_too_far_are_left_to_petsc():
    """A matrix that couples unknowns of distant crossovers is multiplied by PETSc."""
    linear, matrix = clamped("rectangle", True)
    square = matrix.matMult(matrix)
    square = square.matMult(matrix)
    levels = hierarchy(square, linear.network.partition, unknowns_of(linear))
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
    write_values(matrix, value[::-1].copy(), column, np.arange(len(value)))
    np.testing.assert_array_equal(matrix.getValuesCSR()[2], value[::-1])
    matrix.destroy()
