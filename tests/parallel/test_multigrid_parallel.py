# SPDX-License-Identifier: MIT
"""The yarn multigrid: what it interpolates, how fast it converges, on any number of ranks."""

from dataclasses import replace
from math import radians

import pytest
import shapely
from mpi4py import MPI

from cruciform_petsc import BiasExtension, Fabric, Network, Preform
from cruciform_petsc.assembly import LinearNetwork
from cruciform_petsc.constraints import Constraints
from cruciform_petsc.solvers.multigrid import interpolations

COMM = MPI.COMM_WORLD
TABLE_1 = Fabric.from_library("e-glass-plain-2.4")
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
    result = BiasExtension(
        network, extension=3e-3, bending=bending, options=YARN_MULTIGRID
    ).solve()
    assert (result.solver.pc, direct.solver.pc) == ("mg", "cholesky")
    # Measured: 6 to 13 on one rank, up to 17 where ICC is cut at rank borders.
    assert result.solver.iterations <= (15 if COMM.size == 1 else 20)
    difference = abs(result.fields["displacement"] - direct.fields["displacement"]).max(initial=0.0)
    # Residual 1e-8 times a condition number whose smooth part is some hundreds.
    assert COMM.allreduce(float(difference), MPI.MAX) < 1e-5 * 3e-3
    assert result.load == pytest.approx(direct.load, rel=1e-7)


def test_very_stiff_yarns():
    """E/G = 10^5, as in carbon: the smoother keeps the stiff chains whole."""
    yarns = replace(TABLE_1.warp, modulus=96e5)
    fabric = replace(TABLE_1, warp=yarns, weft=yarns)
    network = Network(COMM, Preform(OUTLINES["rectangle"], radians(45)), fabric)
    result = BiasExtension(network, extension=3e-3, options=YARN_MULTIGRID).solve()
    assert result.solver.iterations <= 40
