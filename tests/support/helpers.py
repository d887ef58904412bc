# SPDX-License-Identifier: MIT
"""What several tests need: cloths, floating networks, affine motion, a solved test, gathering."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from mpi4py import MPI

from cruciform_petsc.cloth.fabric import Fabric, YarnFamily
from cruciform_petsc.cloth.preform import Preform
from cruciform_petsc.errors import InputError
from cruciform_petsc.net.edges import Constraints
from cruciform_petsc.net.network import Network
from cruciform_petsc.small.network import LinearNetwork
from cruciform_petsc.solvers.linear import LinearSolver

TABLE_1 = Fabric.from_library("e-glass-plain-2.4")
PITCH = 1 / 240  # of TABLE_1, m
DIAGONAL = np.sqrt(2) * PITCH  # of its lattice's cell
# No two numbers alike, so that no warp can pass for a weft; reciprocal: 0.25 * 60e3 = 0.6 * 25e3.
UNEVEN = Fabric(
    "uneven",
    YarnFamily(60e3, 0.6, 200.0, 5e-7),
    YarnFamily(25e3, 0.25, 310.0, 9e-7),
    140.0,
)


def diagonals(across: int, along: int, **options) -> Preform:
    """Rectangle of TABLE_1 that fits the lattice turned by 45 degrees, in cell diagonals."""
    return Preform.rectangle(across * DIAGONAL, along * DIAGONAL, np.pi / 4, **options)


def l_shape(size: float, bias_angle: float, **options) -> Preform:
    """An L with sides of one size and legs of 0.45 of it."""
    leg = 0.45 * size
    points = [(0, 0), (size, 0), (size, leg), (leg, leg), (leg, size), (0, size)]
    return Preform.polygon(points, [], bias_angle, **options)


def holed(width: float, length: float, radius: float, bias_angle: float, **options) -> Preform:
    """A rectangle with a round hole (24 corners) in the middle."""
    angle = np.linspace(0, 2 * np.pi, 24, endpoint=False)
    hole = np.stack([radius * np.cos(angle), 0.5 * length + radius * np.sin(angle)], axis=1)
    return Preform.rectangle(width, length, bias_angle, holes=[hole.tolist()], **options)


def random_polygon(rng, size: float, corners: int | None = None) -> np.ndarray:
    """Corners (n, 2) of a star-shaped polygon around the origin, of about a radius."""
    n = corners or int(rng.integers(3, 10))
    angle = np.sort(2 * np.pi * (np.arange(n) + rng.uniform(0.1, 0.9, n)) / n)
    radius = size * rng.uniform(0.5, 1.0, n)
    return np.stack([radius * np.cos(angle), radius * np.sin(angle)], axis=1)


def random_preform(rng, fabric: Fabric, cells: float, hole: bool = False, **options) -> Preform:
    """A random polygon some cells large at a random angle, the lattice anywhere."""
    size = cells / fabric.warp.yarns
    while True:
        points = random_polygon(rng, size)
        holes = [random_polygon(rng, 0.3 * size).tolist()] if hole else []
        origin = tuple(rng.uniform(-0.5, 0.5, 2) * size)
        angle = rng.uniform(0, np.pi)
        try:
            return Preform.polygon(points.tolist(), holes, angle, origin=origin, **options)
        except InputError:  # the hole leaves the outline
            continue


def energy_density(fabric: Fabric, gradient: np.ndarray) -> float:
    """Orthotropic membrane, J/m^2; gradient[i, j] = d u_i / d x_j in yarn axes, from [1]."""
    compliance = np.array(
        [
            [1 / fabric.warp.modulus, -fabric.weft.poisson / fabric.weft.modulus],
            [-fabric.warp.poisson / fabric.warp.modulus, 1 / fabric.weft.modulus],
        ]
    )
    strain = np.diag(gradient)
    gamma = gradient[0, 1] + gradient[1, 0]
    stress = np.linalg.solve(compliance, strain)
    return float(0.5 * strain @ stress + 0.5 * fabric.shear_modulus * gamma**2)


def pins(constraints: Constraints) -> None:
    """Take away all motions without deformation, by components of arm ends that join crossovers.

    Three for the rigid motions, at two ends far apart; without bending a fourth beside the first,
    for the turning squares (LinearNetwork.soft_motions).
    """
    network = constraints.network
    assert network.comm.size == 1
    users = np.bincount(network.arm_node[network.arm_is_shared], minlength=network.num_nodes_local)
    joints = np.flatnonzero(users == 2)
    key = network.node_key
    # The first that has a neighbour on its yarn, one pitch (four quarters) on.
    first = joints[np.isin(key[joints] + 4, key[joints]).argmax()]
    away = (network.node_position[joints] - network.node_position[first]) @ (
        network.preform.rotation.T
    )
    far = np.argmax(np.hypot(away[:, 0], away[:, 1]))
    constraints.pin(network.node_key[first], (0, 1))
    constraints.pin(network.node_key[joints[far]], (int(abs(away[far, 0]) > abs(away[far, 1])),))
    if not constraints.bending:
        across = 1 - int(network.node_family[first])
        constraints.pin(key[first] + 4, (across,))


def floating(network: Network, bending: bool) -> LinearNetwork:
    """A network that nothing holds. It is made with three pins, which then are taken away."""
    constraints = Constraints(network, bending)
    pins(constraints)
    model = LinearNetwork(constraints)
    constraints.fixed[:] = False
    model.free = model.supports.active.copy()
    return model


def affine_motion(model: LinearNetwork, gradient, shift=(0.0, 0.0)) -> np.ndarray:
    """Node values (n_local, d) of u = shift + gradient x in the yarn frame; yarns stay straight."""
    network = model.network
    gradient = np.asarray(gradient, float)
    x = (network.node_position - network.origin) @ network.preform.rotation.T
    values = np.zeros((network.num_nodes_local, model.unknowns_per_node))
    values[:, :2] = np.asarray(shift) + x @ gradient.T
    if model.bending:
        turn = np.where(network.node_family == 0, gradient[1, 0], -gradient[0, 1])
        values[:, 2] = turn * model.length_scale
    return values


def dense(matrix) -> np.ndarray:
    """All of a PETSc matrix of one rank."""
    begin, column, value = matrix.getValuesCSR()
    size = matrix.getSize()[0]
    result = np.zeros((size, size))
    result[np.repeat(np.arange(size), np.diff(begin)), column] = value
    return result


@dataclass
class Solved:
    """A solved network."""

    network: Network
    constraints: Constraints
    model: LinearNetwork
    values: np.ndarray
    fields: dict
    info: object

    @property
    def energy(self) -> float:
        """Of all modes and ranks, J."""
        modes = (self.fields[f"{mode}_energy"].sum() for mode in ("tension", "shear", "bending"))
        return self.network.comm.allreduce(float(sum(modes)))

    def force_on(self, edge: str) -> np.ndarray:
        """Force (x, y) of the cloth's ends on an edge, N."""
        network = self.network
        force = self.model.element_forces(self.values)
        nodes = self.constraints.nodes_on(edge)
        nodes = nodes[nodes < network.num_nodes_owned]
        yarn = np.einsum("nji,nj->ni", self.constraints.frame[nodes], force[nodes, :2])
        return network.comm.allreduce((yarn @ network.preform.rotation).sum(axis=0))

    def node_displacement(self) -> np.ndarray:
        """Displacement (x, y) of owned nodes."""
        values = self.model.node_displacement(self.values, self.fields)
        return values[: self.network.num_nodes_owned]


def solve(constraints: Constraints, options=None) -> Solved:
    """Solve a constrained network; options as in LinearSolver."""
    network, model = constraints.network, LinearNetwork(constraints)
    matrix = model.matrix()
    given = np.where(constraints.fixed, constraints.value, 0.0)
    load = model.loads() - model.element_forces(given)
    load[~model.free] = 0.0
    rhs = model.vector(load)
    near_null = None
    if options is not None:
        near_null = model.rigid_motions()[: network.num_nodes_owned].reshape(-1, 3)
    solver = LinearSolver(matrix, near_null, options=options)
    try:
        solution, info = solver.solve(rhs)
        values = model.local(solution)
        solution.destroy()
    finally:
        for thing in (solver, rhs, matrix):
            thing.destroy()
    return Solved(network, constraints, model, values, model.crossover_fields(values), info)


def bias_extension(
    preform: Preform,
    bending: bool,
    fabric: Fabric = TABLE_1,
    comm=MPI.COMM_SELF,
    extension: float = 1e-3,
    options=None,
) -> Solved:
    """Lower edge clamped, upper edge clamped and moved."""
    constraints = Constraints(Network(comm, preform, fabric), bending)
    constraints.clamp("lower")
    constraints.clamp("upper", (0.0, extension))
    return solve(constraints, options)


def gathered(comm, number: np.ndarray, values: np.ndarray) -> np.ndarray:
    """Values of all ranks in the order of their numbers, on every rank."""
    numbers = np.concatenate(comm.allgather(number))
    assert len(np.unique(numbers)) == len(numbers)
    return np.concatenate(comm.allgather(values))[np.argsort(numbers)]
