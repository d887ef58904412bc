# SPDX-License-Identifier: MIT
"""A ply as a model: its items, what its edges hold, and its unknowns for the yarn multigrid."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial

import numpy as np
from petsc4py import PETSc

from ..items.ply import Ply
from ..net.joined import JoinedNodes
from ..net.nodes import Nodes
from ..solvers.multigrid import Hierarchy, Unknowns, hierarchy
from ..solvers.splines import InSpace, Points
from ..solvers.yarns import OnYarns
from .model import Model
from .state import Hold


def model_of(ply: Ply) -> Model:
    """The model of a single ply. Collective."""
    fabric = ply.network.fabric
    multigrid: InSpace | Callable[[PETSc.Mat], Hierarchy] | None = None
    if ply.dim == 3:
        multigrid = in_space(ply.nodes, [ply], [np.arange(ply.nodes.num_nodes_owned)])
    elif ply.slip is None:
        multigrid = partial(_hierarchy, ply)
    return Model(ply.nodes, ply.items, ply.active, fabric.c11 + fabric.c22, multigrid)


def holder(ply: Ply) -> Callable[[list], Hold]:
    """Makes a Hold of motions of a ply's edges, see Ply.prescribed; collective when called."""
    nodes = np.flatnonzero(ply.fixed.any(axis=1)).astype(np.int32)
    axes, fixed = ply.nodes.frame[nodes], ply.fixed[nodes]

    def hold(motions: list) -> Hold:
        place, turn = ply.prescribed(motions)
        return Hold(nodes, axes, fixed, place[nodes], turn)

    return hold


def _hierarchy(ply: Ply, matrix: PETSc.Mat) -> Hierarchy:
    return hierarchy(matrix, unknowns_of(ply))


def in_space(nodes: Nodes | JoinedNodes, plies: Sequence[Ply], at: Sequence[np.ndarray]) -> InSpace:
    """A multigrid of plies in space; ``at``: nodes here of each ply's (see JoinedNodes)."""
    return InSpace(partial(_points, nodes, plies, at))


def _points(nodes: Nodes | JoinedNodes, plies: Sequence[Ply], at: Sequence[np.ndarray]) -> Points:
    """Nodes in space as the multigrid's points.

    Coarse displacements go along warp and weft at rest, and across the cloth; nodes of no ply are
    bodies.
    """
    owned = nodes.num_nodes_owned
    lattice, place = np.full(owned, -1), np.zeros((owned, 2))
    axes, owners = nodes.frame[:owned].copy(), []
    for k, (ply, here) in enumerate(zip(plies, at, strict=True)):
        network, own = ply.network, here[: ply.nodes.num_nodes_owned]
        lattice[own] = k
        rest = ply.nodes.rest[: len(own), :2]
        place[own] = network.to_yarn(rest - network.origin) / network.pitch
        axes[own, :, :2] = network.to_yarn(axes[own, :, :2])
        owners.append(network.partition.owner)
    return Points(owners, lattice, place, axes)


def unknowns_of(ply: Ply) -> Unknowns:
    """Points, coarse fields and yarns of the unknowns of a Ply in its plane that this rank owns.

    Coarse fields are displacements along warp and weft at rest (along the yarns as they run now
    they took twice the iterations: translations were no longer among them) and, without yarn
    bending, the chequerboard: crossovers that turn to and fro, their hinges at rest. Hinges lie on
    two yarns.
    """
    network, nodes = ply.network, ply.nodes
    owned = nodes.num_nodes_owned
    origin = network.origin
    lattice = network.to_yarn(nodes.rest[:owned] - origin) / network.pitch
    frame = network.to_yarn(nodes.frame[:owned])
    hinge = (nodes.node_key[:owned] & 3) == 0
    warp = (nodes.node_key[:owned] >> 62) == 0
    values = np.zeros((owned, 2, 3))
    values[:, :, :2] = frame
    if not ply.bending:
        sign = 1.0 - 2.0 * (np.floor(lattice + 1e-9).sum(axis=1) % 2)
        length = 2 * abs(lattice - np.round(lattice)).max(axis=1) * network.pitch[1 - warp]
        turned = np.where(hinge, 0.0, sign * length / network.pitch.mean())
        across = np.where(warp[:, None], [0.0, 1.0], [-1.0, 0.0]) * turned[:, None]
        values[:, :, 2] = np.einsum("nij,nj->ni", frame, across)
    values[~(ply.active[:owned, None] & ~ply.fixed[:owned])] = 0.0
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
    return Unknowns(
        np.repeat(lattice, 2, axis=0),
        values.reshape(-1, 3),
        np.zeros((2 * owned, 2)),
        network.partition.owner,
        OnYarns(np.repeat(line, 2, axis=0), np.repeat(lattice, 2, axis=0), np.repeat(~hinge, 2)),
    )
