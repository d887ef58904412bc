# SPDX-License-Identifier: MIT
"""The yarn multigrid on tangents of finite deformation: what their unknowns are to it."""

from __future__ import annotations

import numpy as np
from petsc4py import PETSc

from ..errors import SolverError
from ..solvers.linear import LinearSolver
from ..solvers.multigrid import Unknowns, hierarchy
from ..solvers.yarns import OnYarns
from .finite import FiniteNetwork

ASIDE = 2e-4  # pitches


def unknowns_of(model: FiniteNetwork) -> Unknowns:
    """Points, coarse fields and yarns of the unknowns of a FiniteNetwork that this rank owns.

    Coarse fields are displacements along warp and weft at rest (along the yarns as they run now
    they took twice the iterations: translations were no longer among them) and, without yarn
    bending, the chequerboard: crossovers that turn to and fro, their hinges at rest. Hinges lie on
    two yarns.
    """
    network, nodes = model.network, model.nodes
    owned = nodes.num_nodes_owned
    lattice = model.rest[:owned] / network.pitch
    hinge = (nodes.node_key[:owned] & 3) == 0
    warp = (nodes.node_key[:owned] >> 62) == 0
    values = np.zeros((owned, 2, 3))
    values[:, :, :2] = model.frame[:owned]
    if not model.bending:
        sign = 1.0 - 2.0 * (np.floor(lattice + 1e-9).sum(axis=1) % 2)
        length = 2 * abs(lattice - np.round(lattice)).max(axis=1) * network.pitch[1 - warp]
        turned = np.where(hinge, 0.0, sign * length / network.pitch.mean())
        across = np.where(warp[:, None], [0.0, 1.0], [-1.0, 0.0]) * turned[:, None]
        values[:, :, 2] = np.einsum("nij,nj->ni", model.frame[:owned], across)
    values[~model.free[:owned]] = 0.0
    line = np.full((owned, 2), -1, np.int32)
    low = network.partition.box[:, 0].min(axis=0)  # numbers of yarns from 0 up
    number = np.round(lattice).astype(np.int32)
    line[warp | hinge, 0] = number[warp | hinge, 1] - low[1]
    line[~warp | hinge, 1] = number[~warp | hinge, 0] - low[0]
    # Ends on the outline lie on the crossing yarn, too, at its crossover.
    edge = network.boundary_crossovers
    for arm in range(4):
        ends = edge[~network.arm_is_shared[edge, arm]]
        at = nodes.of_network_node[network.arm_node[ends, arm]]
        mine = at < owned
        line[at[mine]] = (network.crossover_ij[ends[mine]] - low)[:, ::-1]
    # A hinge in the middle of a coarse cell is to call for one of its corners only: beside a clamp
    # it may be the only one that does, and corners with nothing but it in common would be alike.
    point = lattice + np.where(hinge, ASIDE, 0.0)[:, None]
    return Unknowns(
        np.repeat(point, 2, axis=0),
        values.reshape(-1, 3),
        np.zeros((2 * owned, 2)),
        OnYarns(np.repeat(line, 2, axis=0), np.repeat(lattice, 2, axis=0), np.repeat(~hinge, 2)),
    )


class TangentMultigrid:
    """Preconditioner of type python: a cycle of the yarn multigrid, made anew for each tangent.

    Levels are set up by what is in the options database then.

    Attributes
    ----------
    error : SolverError or None
        Why the last set-up failed; on its way through PETSc an exception may lose its words.
    """

    def __init__(self, model: FiniteNetwork, prefix: str):
        self.partition, self.prefix = model.network.partition, prefix
        self.unknowns = unknowns_of(model)
        self._solver: LinearSolver | None = None
        self.error: SolverError | None = None

    def setUp(self, pc: PETSc.PC) -> None:
        """Coarse levels and smoother for the matrix that the preconditioner has now."""
        self.free()
        matrix, _ = pc.getOperators()
        self.error = None
        try:
            self._solver = LinearSolver(
                matrix,
                extra={"pc_type": "mg"},
                prefix=self.prefix,
                multigrid=lambda of: hierarchy(of, self.partition, self.unknowns),
            )
        except SolverError as error:
            self.error = error
            raise

    def apply(self, _pc: PETSc.PC, x: PETSc.Vec, y: PETSc.Vec) -> None:
        """One cycle."""
        assert self._solver is not None
        self._solver.ksp.getPC().apply(x, y)

    def free(self) -> None:
        """Free the levels."""
        if self._solver is not None:
            self._solver.destroy()
            self._solver = None

    def destroy(self, _pc: PETSc.PC) -> None:
        """Free the levels."""
        self.free()
