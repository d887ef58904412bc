# SPDX-License-Identifier: MIT
"""What the outline and the clamps make of each cruciform: tails, held arms, hanging crossovers."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import count

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from ..errors import InputError
from ..parallel import most
from .edges import Constraints
from .lattice import HELD, OPPOSITE, QUADRANTS


@dataclass
class Supports:
    """How the cruciforms of a rank carry load. n_boundary follows network.boundary_crossovers."""

    # int32 (n_owned,), 0 for crossovers that carry load. Others are left out of equilibrium, in
    # this round of removal: those that hang on by one arm end without yarn bending (nothing keeps
    # them from turning about it), and tips of free corners.
    round_: np.ndarray
    strain_source: np.ndarray  # int (n_boundary, 4), see elements.small.arm_rows
    rotation_source: np.ndarray
    # float (n_boundary, 4), what carries: without quadrants of a yarn that has no arm there.
    quadrant_area: np.ndarray
    # bool (n_boundary, 4), tails that follow their yarn: no unknown moves them across it.
    slaved: np.ndarray
    # float (n_boundary, 4), share of each arm in the direction of its yarn at the hinge.
    hinge_share: np.ndarray
    active: np.ndarray  # bool (n_local, d), unknowns that exist

    @property
    def carrying(self) -> np.ndarray:
        """Which crossovers carry load; bool (n_owned,)."""
        return self.round_ == 0

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

    Raises InputError on every rank if a part of the network hangs on no clamp, unless it may.
    """
    network, bending = constraints.network, constraints.bending
    round_, joined = _leave_out_hanging(constraints)
    round_[_check_held(constraints, round_ == 0)] = 1
    carrying = round_ == 0

    boundary = network.boundary_crossovers
    nodes = network.arm_node[boundary]
    missing = network.arm_length[boundary] == 0
    held = constraints.held_arm[nodes, np.arange(4)]
    nothing = missing & missing[:, OPPOSITE] & ~held
    source = np.where(missing, np.where(held | nothing, HELD, OPPOSITE), np.arange(4))
    slaved = np.zeros_like(missing)
    tail = ~missing & ~joined[boundary]
    if not bending:
        # Of two tails of one yarn the first keeps its own rotation, or the yarn would have none.
        follows = tail & ~(tail[:, OPPOSITE] & (np.arange(4) < OPPOSITE))
        slaved = follows & ~(missing & ~held)[:, OPPOSITE]
    # The other arm may itself be missing and held.
    of_other = np.where(source[:, OPPOSITE] == HELD, HELD, OPPOSITE)
    rotation_source = np.where(slaved, of_other, source)
    area = network.quadrant_area[boundary]
    area = np.where(nothing[:, QUADRANTS].any(axis=2), 0.0, area)
    # At the hinge a yarn runs as its arms do, but for tails, which give way to shear: of a yarn
    # that has nothing but tails, as they do.
    beside = np.array([[q for q in range(4) if k in QUADRANTS[q]] for k in range(4)])
    carries = (area > 0.0)[:, beside].any(axis=2)
    leads = carries & ~tail
    leads |= carries & ~(leads | leads[:, OPPOSITE])
    hinge_share = leads / np.maximum(1.0 * leads + leads[:, OPPOSITE], 1.0)

    active = np.zeros((network.num_nodes_local, 3 if bending else 2), bool)
    active[network.arm_node[carrying].ravel()] = True
    if bending:
        active[network.node_is_hinge, 2] = False
    rows, arms = np.nonzero(slaved & carrying[boundary][:, None])
    active[nodes[rows, arms], (arms + 1) % 2] = False
    network.halo.share(active, np.logical_or)
    return Supports(round_, source, rotation_source, area, slaved, hinge_share, active)


def pass_on_loads(
    constraints: Constraints, supports: Supports, loads: np.ndarray | None = None
) -> np.ndarray:
    """Loads with those on crossovers that carry nothing moved to the arm ends they hang on.

    Collective. By default those of the edges, (n_local, 2), yarn frame, N; ``loads`` (n_local, k)
    are others. Complete on every rank that has the node, as they must be before.
    """
    network, round_ = constraints.network, supports.round_
    force = (constraints.force if loads is None else loads).copy()
    for number in range(1, most(network.comm, round_, initial=0) + 1):
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


def _leave_out_hanging(constraints: Constraints) -> tuple[np.ndarray, np.ndarray]:
    """Round of removal of each crossover, and which arms are joined to something in the end."""
    network, bending = constraints.network, constraints.bending
    round_ = np.zeros(network.num_crossovers_owned, np.int32)
    fixed = constraints.fixed.any(axis=1) | constraints.tied
    missing = network.arm_length == 0
    on_clamp = (missing & constraints.held[network.arm_node]).any(axis=1)
    tip = (missing & missing[:, OPPOSITE]).any(axis=1) & ~on_clamp
    for number in count(1):
        nodes = network.arm_node[round_ == 0]
        users = network.halo.share(np.bincount(nodes.ravel(), minlength=network.num_nodes_local))
        joined = network.arm_is_shared & (users[network.arm_node] > 1)
        joined |= fixed[network.arm_node] & ~missing
        hanging = tip if bending else tip | (~on_clamp & (joined.sum(axis=1) <= 1))
        hanging = hanging & (round_ == 0)
        if not network.comm.allreduce(int(hanging.sum())):
            break
        round_[hanging] = number
    return round_, joined


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
    users = np.bincount(nodes.ravel(), minlength=n)
    joint = np.zeros(n, bool)
    joint[nodes[network.arm_is_shared[carrying]]] = True
    network.halo.reverse(users)
    network.halo.reverse(joint, np.logical_or)
    of_crossover = label[nodes[:, 0]]
    owned = np.flatnonzero(users[: network.num_nodes_owned])
    # Prescribed unknowns, arm ends, joints and crossovers of each part.
    counts = np.zeros((len(owned) + m, 4), np.int64)
    counts[: len(owned), 0] = constraints.fixed[owned].sum(axis=1)
    counts[: len(owned), 1] = 1
    counts[: len(owned), 2] = joint[owned] & (users[owned] == 2)
    counts[len(owned) :, 3] = 1
    here = _sums(np.concatenate([label[owned], of_crossover]), counts)
    parts, total = _sums(*map(np.concatenate, zip(*network.comm.allgather(here), strict=True)))
    fixed, ends, joints, crossovers = total.T
    if len(parts) == 0:
        raise InputError(
            "nothing carries load: without yarn bending every crossover turns freely; switch "
            "bending on, choose a finer pitch (refine) or clamp an edge that more yarns reach"
        )
    loose = fixed < 3
    scrap = loose & (joints == crossovers - 1)
    if constraints.floats:
        scrap &= crossovers < crossovers.max()
    if not constraints.floats and (loose.all() or (loose & ~scrap).any()):
        name = "the body" if len(parts) == 1 else f"a part of {ends[loose].max()} arm ends"
        raise InputError(f"{name} can float: no clamp holds it; clamp an edge that its yarns reach")
    return np.flatnonzero(carrying)[np.isin(of_crossover, parts[scrap])]


def _sums(names: np.ndarray, counts: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Different names, ascending, and the sum of the counts of each."""
    different, place = np.unique(names, return_inverse=True)
    total = [np.bincount(place, count, len(different)) for count in counts.T]
    return different, np.stack(total, axis=1).astype(np.int64)
