# SPDX-License-Identifier: MIT
"""What the outline and the clamps make of each cruciform: tails, held arms, hanging crossovers."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from mpi4py import MPI
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from ..errors import InputError
from .edges import Constraints
from .lattice import HELD, OPPOSITE, QUADRANTS


@dataclass
class Supports:
    """How the cruciforms of a rank carry load. Boundary arrays follow network.boundary_crossovers.

    Attributes
    ----------
    carrying : bool (n_owned,)
        False for crossovers that carry no load and are left out of equilibrium: those that hang on
        by one arm end without yarn bending (nothing keeps them from turning about it), and tips of
        free corners.
    round_ : int32 (n_owned,)
        In which round of removal a crossover was left out; 0 for carrying ones.
    strain_source, rotation_source : int (n_boundary, 4)
        See elements.kinematics.arm_rows.
    quadrant_area : float (n_boundary, 4)
        Areas that carry: without quadrants of a yarn that has no arm at its crossover.
    slaved : bool (n_boundary, 4)
        Tails that follow their yarn: their transverse displacement is no unknown.
    active : bool (n_local, d)
        Unknowns that exist.
    """

    carrying: np.ndarray
    round_: np.ndarray
    strain_source: np.ndarray
    rotation_source: np.ndarray
    quadrant_area: np.ndarray
    slaved: np.ndarray
    active: np.ndarray

    @property
    def num_hanging(self) -> int:
        """Crossovers of this rank that are left out of equilibrium."""
        return int((~self.carrying).sum())


def find_supports(constraints: Constraints) -> Supports:
    """Work out what each cut cruciform is held by. Collective.

    - A missing arm (its crossover lies on the outline) is held at a clamp: no strain, no rotation.
      At a free edge it has the strain and the rotation of the other arm of its yarn.
    - Without yarn bending a tail (an arm that ends free on the outline) is straight with the other
      arm of its yarn; its strain is its own. With bending it is a beam, and gives way a little to
      the shear of its quadrants: the softer the yarn, the more.
    - Without yarn bending a crossover that hangs on by a single arm end turns freely about it and
      is left out; this is repeated until none is left.
    - A yarn that has neither arm at its crossover (the tip of a corner) carries nothing in the
      quadrants beside a free edge. At a free corner these are all quadrants, and the crossover is
      left out, with yarn bending too. Where the corner is the end of a clamp, just the half of the
      other yarn that ends on the clamp is held by it, then.
    - Crossovers in an acute corner that no yarn joins to the rest, one or a few in a row without a
      mesh between them, fall out of the cloth: they are left out.

    Raises InputError on every rank if a part of the network hangs on no clamp.
    """
    network, bending = constraints.network, constraints.bending
    carrying, round_, joined = _leave_out_hanging(constraints)
    scrap = _check_held(constraints, carrying)
    carrying[scrap], round_[scrap] = False, 1

    boundary = network.boundary_crossovers
    nodes = network.arm_node[boundary]
    missing = network.arm_length[boundary] == 0
    held = constraints.held_arm[nodes, np.arange(4)]
    own = np.broadcast_to(np.arange(4), nodes.shape)
    other = np.broadcast_to(OPPOSITE, nodes.shape)
    other_missing, other_held = missing[:, OPPOSITE], held[:, OPPOSITE]

    nothing = missing & other_missing & ~held
    source = np.where(missing, np.where(held | nothing, HELD, other), own)
    slaved = np.zeros_like(missing)
    if not bending:
        tail = ~missing & ~joined[boundary]
        # Of two tails of one yarn the first keeps its own rotation, or the yarn would have none.
        slaved = tail & ~(other_missing & ~other_held) & ~(tail[:, OPPOSITE] & (own < other))
    rotation_source = np.where(slaved, other, source)
    # The other arm may itself be missing and held.
    rotation_source = np.where(
        slaved & (source[np.arange(len(source))[:, None], other] == HELD), HELD, rotation_source
    )
    area = network.quadrant_area[boundary].copy()
    for q, (i, j) in enumerate(QUADRANTS):
        area[nothing[:, i] | nothing[:, j], q] = 0.0

    active = np.zeros((network.num_nodes_local, 3 if bending else 2), bool)
    active[network.arm_node[carrying].ravel()] = True
    if bending:
        active[network.node_is_hinge, 2] = False
    rows, arms = np.nonzero(slaved & carrying[boundary][:, None])
    active[nodes[rows, arms], (arms + 1) % 2] = False
    network.halo.reverse(active, np.logical_or)
    network.halo.forward(active)
    return Supports(carrying, round_, source, rotation_source, area, slaved, active)


def pass_on_loads(constraints: Constraints, supports: Supports) -> np.ndarray:
    """Loads with those on crossovers that carry nothing moved to the arm ends they hang on.

    Collective. Returns float (n_local, 2), yarn frame, N; complete on every rank that has the node.
    """
    network, round_ = constraints.network, supports.round_
    force = constraints.force.copy()
    for number in range(1, network.comm.allreduce(int(round_.max(initial=0)), MPI.MAX) + 1):
        onward = np.zeros(network.num_nodes_local, bool)
        onward[network.arm_node[(round_ == 0) | (round_ > number)]] = True
        network.halo.share(onward, np.logical_or)
        change = np.zeros_like(force)
        for e in np.flatnonzero(round_ == number):  # a handful, at sharp corners
            nodes = np.unique(network.arm_node[e])
            joint, loose = nodes[onward[nodes]], nodes[~onward[nodes]]
            if len(joint):
                change[joint[0]] += force[loose].sum(axis=0)
                change[loose] -= force[loose]
        force += network.halo.share(change)
    return force


def _leave_out_hanging(constraints: Constraints):
    """Carrying crossovers, round of removal, and which arms are joined to something."""
    network, bending = constraints.network, constraints.bending
    n = network.num_crossovers_owned
    carrying, round_ = np.ones(n, bool), np.zeros(n, np.int32)
    fixed = constraints.fixed.any(axis=1) | constraints.tied
    missing = network.arm_length == 0
    on_clamp = (missing & constraints.held[network.arm_node]).any(axis=1)
    tip = (missing & missing[:, OPPOSITE]).any(axis=1) & ~on_clamp
    number = 0
    while True:
        users = np.zeros(network.num_nodes_local, np.int32)
        np.add.at(users, network.arm_node[carrying].ravel(), 1)
        network.halo.reverse(users)
        network.halo.forward(users)
        joined = network.arm_is_shared & (users[network.arm_node] > 1)
        joined |= fixed[network.arm_node] & ~missing
        hanging = tip if bending else tip | (~on_clamp & (joined.sum(axis=1) <= 1))
        hanging = hanging & carrying
        if not network.comm.allreduce(int(hanging.sum())):
            return carrying, round_, joined
        number += 1
        carrying[hanging] = False
        round_[hanging] = number


def _check_held(constraints: Constraints, carrying: np.ndarray) -> np.ndarray:
    """Raise if a connected part of the network has fewer than three prescribed unknowns.

    Returns
    -------
    int (n,)
        Crossovers of parts that are not held, but have no closed mesh either.
    """
    network = constraints.network
    nodes = network.arm_node[carrying]
    n, m = network.num_nodes_local, len(nodes)
    graph = coo_array(
        (np.ones(4 * m, np.int8), (np.repeat(np.arange(m), 4), nodes.ravel() + m)), (m + n, m + n)
    )
    _, piece = connected_components(graph, directed=False)
    num = piece.max(initial=-1) + 1
    label = network.node_number_global.copy()
    while True:  # smallest node number of a connected part spreads over the ranks
        before = label.copy()
        smallest = np.full(num, np.iinfo(np.int64).max)
        np.minimum.at(smallest, piece[m:], label)
        label = smallest[piece[m:]]
        network.halo.share(label, np.minimum)
        if not network.comm.allreduce(int((label != before).any())):
            break
    users = np.zeros(n, np.int32)
    np.add.at(users, nodes.ravel(), 1)
    joint = np.zeros(n, bool)
    joint[nodes[network.arm_is_shared[carrying]]] = True
    network.halo.reverse(users)
    network.halo.reverse(joint, np.logical_or)
    of_crossover = label[nodes[:, 0]]
    owned = np.flatnonzero(users[: network.num_nodes_owned])
    labels = np.unique(np.concatenate([label[owned], of_crossover]))
    at, at_crossover = np.searchsorted(labels, label[owned]), np.searchsorted(labels, of_crossover)
    size = len(labels)
    # For each part: prescribed unknowns, arm ends, crossovers, joints between them.
    counts = np.stack([
        np.bincount(at, constraints.fixed[owned].sum(axis=1), size),
        np.bincount(at, minlength=size),
        np.bincount(at_crossover, minlength=size),
        np.bincount(at, joint[owned] & (users[owned] == 2), size),
    ], axis=1)  # fmt: skip
    total: dict[int, np.ndarray] = {}
    for part in network.comm.allgather(list(zip(labels, counts, strict=True))):
        for name, here in part:
            total[name] = total.get(name, 0) + here
    if not total:
        raise InputError(
            "nothing carries load: without yarn bending every crossover turns freely; switch "
            "bending on, choose a finer pitch (refine) or clamp an edge that more yarns reach"
        )
    loose = {name: part for name, part in total.items() if part[0] < 3}
    scrap = [name for name, part in loose.items() if part[3] == part[2] - 1]
    if len(loose) == len(total) or len(scrap) < len(loose):
        ends = int(max(part[1] for part in loose.values()))
        raise InputError(
            f"{'the body' if len(total) == 1 else f'a part of {ends} arm ends'} can float: "
            "no clamp holds it; clamp an edge that its yarns reach"
        )
    return np.flatnonzero(carrying)[np.isin(of_crossover, scrap)]
