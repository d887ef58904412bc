# SPDX-License-Identifier: MIT
"""The yarn multigrid at finite deformation: the same answers in few iterations, also deformed."""

import numpy as np
import pytest
from mpi4py import MPI
from support.finite import Cloth
from support.helpers import TABLE_1

from cruciform_petsc.cloth.preform import Preform
from cruciform_petsc.experiments.bias_extension import BiasExtension
from cruciform_petsc.net.edges import Constraints
from cruciform_petsc.net.network import Network
from cruciform_petsc.solvers.linear import LinearSolver

COMM = MPI.COMM_WORLD
SPECIMEN = Preform.rectangle("8 cm", "16 cm")


@pytest.mark.three_ranks
@pytest.mark.parametrize("bending", [False, True])
def test_same_as_direct(bending):
    """Loads to the tolerance of equilibrium, 1e-8 of the forces and better."""
    network = Network(COMM, SPECIMEN, TABLE_1)
    direct, multigrid = (
        BiasExtension(
            network, ["5 mm", "15 mm"], finite=True, bending=bending, options={"pc_type": pc}
        ).solve()
        for pc in ("cholesky", "mg")
    )
    np.testing.assert_allclose(multigrid.loads, direct.loads, rtol=1e-7)
    for name in ("shear_angle", "displacement"):
        np.testing.assert_allclose(multigrid.fields[name], direct.fields[name], atol=1e-7)
    assert any(increment.linear_iterations > 20 for increment in multigrid.increments)


def iterations(cloth, state):
    """CG with the multigrid on the tangent at x, to 1e-8 of a random right side in its range."""
    model = cloth.model
    matrix, _ = model.stiffness(state)
    solver = LinearSolver(
        matrix,
        extra={"pc_type": "mg", "ksp_rtol": 1e-8},
        multigrid=model.multigrid,
    )
    owned = model.nodes.num_nodes_owned
    # The same on any number of ranks: made from the nodes' keys.
    wave = np.cos(model.nodes.node_key[:owned, None] % 100_003 * np.array([1.0, 2.0]))
    right, image = matrix.createVecs()
    right.setArray(np.where(cloth.free()[:owned], wave, 0.0).ravel())
    matrix.mult(right, image)
    answer, info = solver.solve(image)
    right.axpy(-1.0, answer)
    # A residual of 1e-8 is an error a thousand times as large in the softest waves (1.2e-5 here).
    assert right.norm() < 5e-5 * answer.norm()
    solver.destroy()
    for thing in (matrix, right, image, answer):
        thing.destroy()
    return info.iterations


@pytest.mark.three_ranks
def test_tangent_at_45_degrees_of_shear():
    """At most 1.5 times the iterations of the flat cloth (measured: 8 or 9, then 9 to 11)."""
    network = Network(COMM, SPECIMEN, TABLE_1)
    test = BiasExtension(network, 0.0285, finite=True)
    result = test.solve()
    angle = np.rad2deg(result.shear_angle_centre)
    assert 43 < angle < 55
    constraints = Constraints(network, True)
    grips = test.grip(constraints)
    cloth = Cloth(constraints)
    flat = iterations(cloth, cloth.state())
    x, nodes = cloth.rest.copy(), cloth.nodes
    x[nodes.of_network_node] += result.node_displacement
    x[nodes.of_hinge] = network.crossover_position + result.fields["displacement"]
    nodes.halo.forward(x)
    sheared = iterations(cloth, cloth.state(x, test.motions(grips, result.extension)))
    if COMM.rank == 0:
        print(f"{flat} iterations flat, {sheared} at {angle:.1f} degrees")
    assert sheared <= 1.5 * flat
