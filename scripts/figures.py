# SPDX-License-Identifier: MIT
"""The figures of docs/verification.md, measured anew.

    ./scripts/fenicsx mpirun -n 2 python3 -m mpi4py scripts/figures.py [--large]

Prints Markdown. With --large also the preform of 240,000 crossovers.
"""

import argparse
import resource
import time
from math import pi, radians, sqrt

import numpy as np
import shapely
from mpi4py import MPI

from cruciform_petsc import (
    BiasExtension,
    Fabric,
    Network,
    Preform,
    YarnFamily,
    compare_with_membrane,
)
from cruciform_petsc.continuum.membrane import Membrane
from cruciform_petsc.net.edges import Constraints
from cruciform_petsc.small.network import LinearNetwork
from cruciform_petsc.solvers.linear import LinearSolver

COMM = MPI.COMM_WORLD
TABLE_1 = Fabric.from_library("e-glass-plain-2.4")
DIAGONAL = sqrt(2) / 240.0  # of the lattice of Table 1, m


def say(*columns):
    """One row of a table, on rank 0."""
    if COMM.rank == 0:
        print("| " + " | ".join(str(column) for column in columns) + " |", flush=True)


def head(title, *columns):
    """A title and the head of a table, on rank 0."""
    if COMM.rank == 0:
        print(f"\n{title}\n")
    say(*columns)
    say(*["---"] * len(columns))


def membrane_ladder(title, outline, angle, refines):
    """Network without bending against the membrane, 1 mm extension."""
    head(title, "refine", "crossovers", "displacement, relative L2", "load ratio", "energy ratio")
    membrane = Membrane(COMM, Preform(outline, angle), TABLE_1).solve_bias_extension(1e-3)
    for refine in refines:
        network = Network(COMM, Preform(outline, angle, refine=refine), TABLE_1)
        result = BiasExtension(network, extension=1e-3, finite=False, bending=False).solve()
        c = compare_with_membrane(result, membrane)
        say(
            refine,
            network.num_crossovers_global,
            f"{100 * c.relative_l2_displacement:.2f} %",
            f"{c.load_ratio:.4f}",
            f"{c.energy_ratio:.4f}",
        )


def off_axis_modulus(angle, refine, width=0.04, length=0.16):
    """Modulus of the middle third of a strip under uniform traction with free sides, N/m."""
    network = Network(
        COMM, Preform.rectangle(width, length, bias_angle=angle, refine=refine), TABLE_1
    )
    constraints = Constraints(network, bending=False)
    constraints.line_load("upper", (0.0, 1.0))
    constraints.line_load("lower", (0.0, -1.0))
    # Three unknowns near the middle take away the rigid motions. The fourth stops what else costs
    # no energy without bending: crossovers that turn to and fro in a chequerboard.
    owned = network.num_nodes_owned
    inner = network.node_position[:owned]
    shared = ~network.node_is_boundary[:owned] & (network.node_family[:owned] == 0)
    distance = np.where(shared, np.hypot(*(inner - [0.0, 0.5 * length]).T), np.inf)
    best = min(COMM.allgather((distance.min(), int(network.node_key[distance.argmin()]))))[1]
    constraints.pin(best, (0, 1))
    for crossovers in (1, 3):  # further along the same warp yarn
        constraints.pin(best + 4 * crossovers, (1,))
    linear = LinearNetwork(constraints)
    matrix = linear.matrix()
    load = linear.loads()
    load[~linear.free] = 0.0
    solver = LinearSolver(matrix)
    x, _ = solver.solve(linear.vector(load))
    u = linear.crossover_fields(linear.local(x))["displacement"]
    place = network.crossover_position
    middle = abs(place[:, 1] - 0.5 * length) < length / 6
    # Least squares of u_y = a + b x + c y over the middle: c is the strain.
    rows = np.column_stack([np.ones(middle.sum()), place[middle]])
    normal = COMM.allreduce(rows.T @ rows)
    right = COMM.allreduce(rows.T @ u[middle, 1])
    return 1.0 / np.linalg.solve(normal, right)[2]


def kilby():
    """Off-axis modulus against the closed form."""
    head(
        "Off-axis modulus of a strip, 4 cm x 16 cm, over Kilby's formula",
        "angle",
        "refine = 1",
        "2",
        "4",
        "8",
    )
    for angle in (0, 15, 30, 45, 60, 75, 90):
        exact = TABLE_1.off_axis_modulus(radians(angle))
        ratios = [off_axis_modulus(radians(angle), refine) / exact for refine in (1, 2, 4, 8)]
        say(f"{angle} deg", *(f"{ratio:.4f}" for ratio in ratios))


def inextensible():
    """Stiff yarns against the energy of uniform zones and its minimum."""
    shear = 96.0
    yarns = YarnFamily(1e6 * shear, 0.0, 240.0, 0.0)
    fabric = Fabric("stiff", yarns, yarns, shear)
    head(
        "Inextensible yarns (E/G = 10^6), 16 diagonals across: energy over that of uniform zones",
        "H/W",
        "network",
        "one-dimensional minimum",
    )
    for slenderness, minimum in ((2, 1.0), (3, 0.988)):
        width = 16 * DIAGONAL
        height = slenderness * width
        network = Network(COMM, Preform.rectangle(width, height, bias_angle=pi / 4), fabric)
        result = BiasExtension(network, extension=1e-4, finite=False, bending=False).solve()
        gamma = 2e-4 / (height - width)
        area = 0.5 * width * (2 * height - 3 * width) + 0.25 * width**2
        energy = sum(value[-1] for value in result.energies().values())
        say(slenderness, f"{energy / (0.5 * shear * gamma**2 * area):.4f}", minimum)


def large():
    """A preform of 240,000 crossovers, assembled and solved."""
    begin = time.perf_counter()
    network = Network(COMM, Preform.rectangle("2 m", "2.1 m"), TABLE_1)
    made = time.perf_counter()
    result = BiasExtension(network, extension="20 mm", finite=False).solve()
    end = time.perf_counter()
    peak = COMM.allgather(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024)
    head(
        f"A preform of 2 m x 2.1 m at yarn pitch on {COMM.size} ranks, with yarn bending",
        "crossovers",
        "unknowns",
        "network",
        "assembly and solution",
        "solver",
        "memory per rank",
    )
    say(
        network.num_crossovers_global,
        result.solver.unknowns,
        f"{made - begin:.1f} s",
        f"{end - made:.1f} s",
        f"{result.solver.ksp} + {result.solver.pc}, {result.solver.iterations} iterations",
        f"{max(peak):.0f} MiB",
    )


def main():
    """Print all tables."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--large", action="store_true")
    arguments, _ = parser.parse_known_args()
    fits = shapely.box(-2 * DIAGONAL, 0, 2 * DIAGONAL, 6 * DIAGONAL)
    membrane_ladder(
        "Against the membrane: 4 x 6 lattice diagonals, crossovers on the edges, 45 deg",
        fits,
        pi / 4,
        (1, 2, 4, 8, 16),
    )
    box = shapely.box(-0.012, 0, 0.012, 0.036)
    hole = box.difference(shapely.Point(0, 0.018).buffer(0.005, quad_segs=16))
    corner = shapely.box(0, 0.018, 0.012, 0.036)
    others = {
        "2.4 cm x 3.6 cm, 45 deg": (box, 45),
        "2.4 cm x 3.6 cm, 30 deg": (box, 30),
        "2.4 cm x 3.6 cm with a round hole of 1 cm, 45 deg": (hole, 45),
        "L of 2.4 cm x 3.6 cm, 45 deg": (box.difference(corner), 45),
    }
    for title, (outline, angle) in others.items():
        membrane_ladder(f"Against the membrane: {title}", outline, radians(angle), (4, 8, 16, 24))
    kilby()
    inextensible()
    if arguments.large:
        large()


if __name__ == "__main__":
    main()
