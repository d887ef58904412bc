# SPDX-License-Identifier: MIT
"""The bias-extension experiment: control, measures, the paper's procedure."""

from dataclasses import replace

import numpy as np
import pytest
from mpi4py import MPI

from cruciform_petsc import BiasExtension, Fabric, InputError, Network, Preform
from cruciform_petsc.net.edges import Constraints
from cruciform_petsc.small.network import LinearNetwork
from cruciform_petsc.small.separate import solve_separately

TABLE_1 = Fabric.from_library("e-glass-plain-2.4")


@pytest.fixture(scope="module")
def network():
    """The paper's specimen."""
    preform = Preform.rectangle("2.4 cm", "3.6 cm", bias_angle="45 deg")
    return Network(MPI.COMM_SELF, preform, TABLE_1)


@pytest.mark.parametrize("upper", ["grip", "centre-line"])
@pytest.mark.parametrize("bending", [True, False])
def test_work_is_energy(network, upper, bending):
    """Linear: load times extension is twice the energy of the crossovers."""
    result = BiasExtension(
        network, extension="1 mm", upper=upper, bending=bending, finite=False
    ).solve()
    energies = result.energies()
    total = sum(value[-1] for value in energies.values())
    assert result.load * result.extension == pytest.approx(2 * total, rel=1e-9)
    assert (energies["bending"][-1] > 0) == bending
    assert result.solver.relative_residual < 1e-10


def test_load_and_extension_control_agree(network):
    pulled = BiasExtension(network, extension="0.7 mm", finite=False).solve()
    loaded = BiasExtension(network, load=pulled.load, finite=False).solve()
    assert loaded.extension == pytest.approx(0.7e-3, rel=1e-12)
    for name in ("displacement", "shear_angle", "shear_energy"):
        np.testing.assert_allclose(
            loaded.fields[name], pulled.fields[name], rtol=1e-9, atol=1e-9 * 7e-4
        )


def test_list_gives_a_curve(network):
    result = BiasExtension(network, load=["0.1 N", "0.2 N", "0.4 N"], finite=False).solve()
    curve = result.curve()
    np.testing.assert_allclose(curve["load_N"], [0.1, 0.2, 0.4])
    for name, power in (("extension_mm", 1), ("shear_centre_deg", 1), ("energy_shear_J", 2)):
        np.testing.assert_allclose(curve[name] / curve[name][-1], np.array([0.25, 0.5, 1]) ** power)
    assert result.load == 0.4


def test_specimen_is_symmetric(network):
    """Left and right mirror each other; so do lower and upper half."""
    result = BiasExtension(network, extension="1 mm", finite=False).solve()
    x, u = network.crossover_position, result.fields["displacement"]
    for mirror, sign, shift in (([-1, 1], [-1, 1], [0, 0]), ([1, -1], [1, -1], [0, 1e-3])):
        centre = np.array([0.0, 0.036 * (np.array(mirror)[1] < 0)])
        image = x * mirror + centre
        partner = np.argmin(((x[None] - image[:, None]) ** 2).sum(axis=2), axis=1)
        np.testing.assert_allclose(u[partner], u * sign + shift, atol=1e-12)


def test_bending_makes_the_shear_fade_in(network):
    """Figure 6: with yarn bending the specimen is stiffer, and next to the clamp it shears less."""
    bent = BiasExtension(network, extension="1 mm", finite=False).solve()
    free = BiasExtension(network, extension="1 mm", bending=False, finite=False).solve()
    assert bent.load > 1.1 * free.load
    with_, without = bent.centre_line(), free.centre_line()
    np.testing.assert_allclose(with_.distance, without.distance)
    assert with_.shear_angle[0] < with_.shear_angle[len(with_.distance) // 2]
    assert bent.shear_angle_centre == pytest.approx(
        with_.shear_angle[np.argmin(abs(with_.distance - 0.018))], rel=1e-9
    )


@pytest.mark.parametrize("upper", ["grip", "centre-line"])
def test_separate_systems_by_dense_algebra(network, upper):
    """Each mode: the displacement of smallest norm in the range of its own matrix."""
    constraints = Constraints(network, bending=True)
    constraints.clamp("lower")
    tied = constraints.tie("upper", (0.0, 1.0), gripped=upper == "grip")
    linear = LinearNetwork(constraints)
    solutions = solve_separately(linear, 2.0)
    d = linear.unknowns_per_node
    master = d * int(tied.min())
    tie = np.eye(d * network.num_nodes_owned)
    for node in tied:
        tie[d * node, d * node] = 0.0
        tie[d * node, master] = 1.0
    for mode in ("tension", "shear", "bending"):
        matrix = linear.matrix(mode)
        dense = tie.T @ matrix[:, :] @ tie
        matrix.destroy()
        values, vectors = np.linalg.eigh(dense)
        kept = values > 1e-9 * values.max()  # a gap from 1e-16 to 4e-8 in all three
        load = np.zeros(len(dense))
        load[master] = 2.0
        x = vectors[:, kept] @ ((vectors[:, kept].T @ load) / values[kept])
        # LSQR stops at 1e-10 of the normal residual; bending has a condition number of 3e7.
        assert solutions[mode].tied_displacement == pytest.approx(x[master], rel=1e-5)
        uncarried = np.linalg.norm(load - dense @ x) / 2.0
        assert solutions[mode].uncarried == pytest.approx(uncarried, rel=1e-6)
        assert 0.1 < uncarried < 0.6  # none of the three can carry the load alone


def test_separate_model(network):
    result = BiasExtension(network, load="0.3 N", upper="centre-line", model="separate").solve()
    assert result.load == pytest.approx(0.3)
    assert set(result.uncarried) == {"tension", "shear", "bending"}
    coupled = BiasExtension(network, load="0.3 N", upper="centre-line", finite=False).solve()
    # Modes that all bear the whole load give way more than modes that share it.
    assert result.extension > coupled.extension


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({}, "exactly one of extension and load, got neither"),
        ({"extension": 1e-3, "load": 1.0}, "extension and load, got both"),
        ({"extension": "1 N"}, "extension"),
        ({"extension": 0.0}, "zero"),
        ({"extension": 1e-3, "upper": "top"}, '"grip" or "centre-line"'),
        ({"extension": 1e-3, "model": "both"}, '"coupled", "truss" or "separate"'),
    ],
)
def test_wrong_arguments(network, options, words):
    with pytest.raises(InputError, match=words):
        BiasExtension(network, **options)


def test_bending_needs_a_rigidity():
    soft = replace(TABLE_1, warp=replace(TABLE_1.warp, yarn_bending=0.0))
    network = Network(MPI.COMM_SELF, Preform.rectangle("2.4 cm", "3.6 cm"), soft)
    with pytest.raises(InputError, match="fabric.warp.yarn_bending is zero"):
        BiasExtension(network, extension=1e-3)
