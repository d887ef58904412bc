# SPDX-License-Identifier: MIT
"""The yarn multigrid at finite deformation: the same answers in few iterations, also deformed."""

import numpy as np
import pytest
from mpi4py import MPI
from support.helpers import TABLE_1

from cruciform_petsc.cloth.preform import Preform
from cruciform_petsc.equilibrium.finite import FiniteNetwork
from cruciform_petsc.equilibrium.tangent_multigrid import unknowns_of
from cruciform_petsc.experiments.bias_extension import BiasExtension
from cruciform_petsc.net.edges import Constraints
from cruciform_petsc.net.network import Network
from cruciform_petsc.solvers.linear import LinearSolver
from cruciform_petsc.solvers.multigrid import hierarchy

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


def iterations(model, x):
    """CG with the multigrid on the tangent at x, to 1e-8 of a random right side in its range."""
    matrix, _ = model.stiffness(x)
    unknowns = unknowns_of(model)
    solver = LinearSolver(
        matrix,
        extra={"pc_type": "mg", "ksp_rtol": 1e-8},
        multigrid=lambda of: hierarchy(of, model.network.partition, unknowns),
    )
    owned = model.nodes.num_nodes_owned
    # The same on any number of ranks: made from the nodes' keys.
    wave = np.cos(model.nodes.node_key[:owned, None] % 100_003 * np.array([1.0, 2.0]))
    right, image = matrix.createVecs()
    right.setArray(np.where(model.free[:owned], wave, 0.0).ravel())
    matrix.mult(right, image)
    answer, info = solver.solve(image)
    right.axpy(-1.0, answer)
    assert right.norm() < 1e-5 * answer.norm()
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
    model = FiniteNetwork(constraints)
    flat = iterations(model, model.rest)
    x = model.rest.copy()
    moved = result.node_displacement @ network.preform.rotation.T
    x[model.nodes.of_network_node] += moved
    x[model.nodes.of_hinge] += result.fields["displacement"] @ network.preform.rotation.T
    model.nodes.halo.forward(x)
    model.prescribe(x, test._motions(grips, result.extension))
    sheared = iterations(model, x)
    if COMM.rank == 0:
        print(f"{flat} iterations flat, {sheared} at {angle:.1f} degrees")
    assert sheared <= 1.5 * flat
