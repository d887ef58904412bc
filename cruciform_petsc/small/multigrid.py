# SPDX-License-Identifier: MIT
"""The yarn multigrid on matrices of small displacements: what their unknowns are to it."""

from __future__ import annotations

import numpy as np
from petsc4py import PETSc

from ..solvers.multigrid import Hierarchy, Unknowns, hierarchy
from ..solvers.yarns import OnYarns
from .network import LinearNetwork


def yarn_multigrid(linear: LinearNetwork, matrix: PETSc.Mat) -> Hierarchy:
    """Coarse levels and smoother for a LinearNetwork's stiffness. Collective."""
    return hierarchy(matrix, unknowns_of(linear))


def unknowns_of(linear: LinearNetwork) -> Unknowns:
    """Points, coarse fields and yarns of the unknowns of a LinearNetwork that this rank owns."""
    network, d = linear.network, linear.unknowns_per_node
    owned = slice(0, network.num_nodes_owned)
    frame, pitch = linear.constraints.frame[owned], network.pitch
    place = network.node_position[owned] - network.preform.lattice_origin
    lattice = network.to_yarn(place) / pitch
    warp = network.node_family[owned] == 0
    values, slopes = np.zeros((len(warp), d, 3)), np.zeros((len(warp), d, 2))
    values[:, :2, :2] = frame
    if d == 3:
        # Rotation of a warp yarn: d u_weft/d warp; of a weft yarn: -d u_warp/d weft.
        slopes[warp, 2, 0] = linear.length_scale / pitch[0]
        slopes[~warp, 2, 1] = -linear.length_scale / pitch[1]
    else:
        values[:, :, 2] = linear.turning_squares()[owned] / (0.5 * pitch.mean())
    values[~linear.free[owned]] = 0.0
    slopes[~linear.free[owned]] = 0.0

    line = np.full((len(warp), 2), -1, np.int32)
    low = network.partition.box[:, 0].min(axis=0)  # numbers of yarns from 0 up
    number = np.round(lattice).astype(np.int32) - low
    line[warp, 0], line[~warp, 1] = number[warp, 1], number[~warp, 0]
    # Ends on the outline lie on the crossing yarn, too, at its crossover.
    edge = network.boundary_crossovers
    for arm in range(4):
        ends = edge[~network.arm_is_shared[edge, arm]]
        line[network.arm_node[ends, arm]] = (network.crossover_ij[ends] - low)[:, ::-1]
    return Unknowns(
        np.repeat(lattice, d, axis=0),
        values.reshape(-1, 3),
        slopes.reshape(-1, 2),
        network.partition.owner,
        OnYarns(np.repeat(line, d, axis=0), np.repeat(lattice, d, axis=0)),
    )
