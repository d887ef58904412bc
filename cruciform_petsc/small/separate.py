# SPDX-License-Identifier: MIT
"""The paper's procedure: one system for each mode of deformation, one after the other.

Each of the three matrices is singular on its own (section 6 of the paper does not say what its
Gauss elimination did about that). The rule here: each gets the whole load and is solved in
the range of its matrix, with the displacement of smallest norm. The part of the load outside
the range is what the mode cannot carry; it is reported, not hidden.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from petsc4py import PETSc

from ..parallel import least
from ..solvers.csr import aij
from ..solvers.linear import LinearSolver, SolverInfo
from ..solvers.options import LEAST_NORM, PREFIX
from .network import LinearNetwork


@dataclass
class ModeSolution:
    """One of the separate systems."""

    displacement: np.ndarray  # (n_local, d), node unknowns, ghosts filled
    uncarried: float  # norm of the part of the load that the mode cannot carry, over the load's
    tied_displacement: float  # of the tied edge, m
    solver: SolverInfo


def solve_separately(
    linear: LinearNetwork, load: float, options: dict | None = None
) -> dict[str, ModeSolution]:
    """Solve tension, shear and bending each by itself for a load on the tied edge. Collective.

    ``linear`` has an edge tied by Constraints.tie; ``load`` is the force along the tied direction,
    N; ``options`` are PETSc's, under the prefix. Raises SolverError on every rank if an iteration
    fails.
    """
    tie, master = _tie_matrix(linear)
    solutions = {}
    for mode in linear.modes:
        matrix = linear.matrix(mode)
        reduced = matrix.ptap(tie)
        # One scale for all modes, or the weak ones would lie below the stiff one's tolerance.
        scale = reduced.norm(PETSc.NormType.INFINITY)
        reduced.scale(1.0 / scale)
        rhs = reduced.createVecRight()
        begin, end = rhs.getOwnershipRange()
        if begin <= master < end:
            rhs.setValue(master, load / scale)
        rhs.assemble()
        solver = LinearSolver(reduced, options=LEAST_NORM, extra=options, prefix=PREFIX)
        x, info = solver.solve(rhs, singular=True)
        full = tie.createVecLeft()
        tie.mult(x, full)
        tied = float(x.getValue(master)) if begin <= master < end else 0.0
        tied = linear.network.comm.allreduce(tied)
        solutions[mode] = ModeSolution(linear.local(full), info.relative_residual, tied, info)
        solver.destroy()
        for thing in (matrix, reduced, rhs, x, full):
            thing.destroy()
    tie.destroy()
    return solutions


def _tie_matrix(linear: LinearNetwork) -> tuple[PETSc.Mat, int]:
    """Matrix that gives all unknowns from the independent ones; number of the common one."""
    network, d = linear.network, linear.unknowns_per_node
    owned = network.num_nodes_owned
    number = network.node_number_global[:owned, None] * d + np.arange(d)
    tied = linear.constraints.tied[:owned]
    master = least(network.comm, number[tied, 0], initial=np.iinfo(np.int64).max)
    column = number.copy()
    column[tied, 0] = master
    n = column.size
    return aij(network.comm, (n, n), np.arange(n + 1), column.ravel(), np.ones(n)), master
