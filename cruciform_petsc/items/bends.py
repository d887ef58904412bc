# SPDX-License-Identifier: MIT
"""Yarns that bend as an item: in the cloth's plane, and in space out of it."""

from __future__ import annotations

import numpy as np

from ..elements import bend
from ..elements.level import FORCE, STIFFNESS
from .cruciforms import turns
from .item import Item, Placed, Work
from .nodes import PlyNodes, unit


class Bends(Item):
    """Points at which yarns bend: at crossovers, at arm ends between them, at clamps.

    At a clamp the direction that it holds stands for the point before: nodes before and at the bend
    are one. On a plane of symmetry the yarn's mirror image does: half of what the whole yarn has
    there. In space two pairs of arm ends of the crossing yarns follow (elements.bend): those of the
    crossovers on both sides.

    Attributes
    ----------
    length : float (m,), m
    in_plane, out_of_plane : float (m,), N m^2
    crossover : int (m, 2)
        This rank's crossovers that the energy belongs to, half each; -1 for another rank's.
    """

    name = "bends"

    def __init__(self, ply: PlyNodes):
        self.dim = ply.dim
        self.modes = ("bending", "out_of_plane_bending")[: ply.dim - 1]
        parts = [part for family in (0, 1) for part in _family(ply, family)]
        columns = [np.concatenate(part) for part in zip(*parts, strict=True)]
        nodes, self.length, self.in_plane, self.out_of_plane, self.crossover = columns[:5]
        # Of clamped nodes or -1; at rest, towards the bend; warp or weft
        self._clamp, self._along, self._family, self._mirrored, self._cut = columns[5:]
        self._across = ply.arm_directions[1 - self._family]
        self._at_plane = self._mirrored | self._cut.any(axis=1)
        curved = any(law.name != "linear" for law in ply.out_of_plane)
        self._moment = ply.out_of_plane if curved else ()
        self.nodes = nodes.astype(np.int32)

    def work(self, state: Placed, level: int, rows=slice(None), before=None) -> Work:
        """See Item.work."""
        place = state.x[self.nodes[rows]]
        beside = np.flatnonzero(self._at_plane[rows])
        if len(beside):
            whole = self._whole(rows, beside)
            place[beside] = np.einsum("mpiqj,mqj->mpi", whole, place[beside])
        at = np.flatnonzero((self._clamp[rows] >= 0) & ~self._mirrored[rows])
        if len(at):
            turn = turns(state)[self._clamp[rows][at]]
            place[at, 0] -= unit(np.einsum("mij,mj->mi", turn, self._along[rows][at]))
        energy, force, stiffness = bend.bends(
            place, self.length[rows], self.in_plane[rows], self.out_of_plane[rows], level,
            moment=self._moment, family=self._family[rows],
        )  # fmt: skip
        if len(beside) and level >= FORCE:
            force[beside] = np.einsum("mpiqj,mpi->mqj", whole, force[beside])
        if len(beside) and level >= STIFFNESS:
            stiffness[beside] = np.einsum(
                "mpiqj,mpirk,mrksl->mqjsl", whole, stiffness[beside], whole, optimize=True
            )
        return energy, force, stiffness

    def _whole(self, rows: slice, beside: np.ndarray) -> np.ndarray:
        """What mirror images make of bends at planes of symmetry.

        Positions (m, points, dim) -> those with the mirror image of the point after as the point
        before, and that of the first pair of points on the crossing yarn as the second (but for
        where it lies), where the yarn ends on the plane; where the crossing yarn does, that goes
        straight through it. A matrix (m, points, dim, points, dim).
        """
        along, across = self._along[rows][beside], self._across[rows][beside]
        mirrored, cut = self._mirrored[rows][beside], self._cut[rows][beside]
        points, unit_matrix = self.nodes.shape[1], np.eye(self.dim)
        image = unit_matrix - 2.0 * along[:, :, None] * along[:, None, :]
        whole = np.zeros((len(beside), points, self.dim, points, self.dim))
        for p in range(points):
            whole[:, p, :, p] = unit_matrix
        whole[mirrored, 0, :, 0] = 0.0
        whole[mirrored, 0, :, 1] = (unit_matrix - image)[mirrored]
        whole[mirrored, 0, :, 2] = image[mirrored]
        for pair, points_of in enumerate(((3, 4), (5, 6))[: points // 2 - 1]):
            through = np.where(
                cut[:, pair, None, None], across[:, :, None] * across[:, None, :], unit_matrix
            )
            for p in points_of:
                whole[:, p, :, p] = through
                if pair == 1:
                    whole[mirrored, p, :, p] = 0.0
                    whole[mirrored, p, :, p - 2] = (image @ through)[mirrored]
        return whole


def _part(
    ply, rows, points, length, in_plane, out, cut, following=None, clamp=None, along=None,
    mirrored=None,
):  # fmt: skip
    """Bends that belong to crossovers ``rows``, as columns; ``following``: their second hinges.

    Of hinges (n_local,): ``out``, rigidity out of the plane; ``cut``, whether the crossing yarn
    ends there on a plane of symmetry. Lengths are those on this side of a clamp or such a plane.
    """
    n = len(rows)
    mirrored = np.zeros(n, bool) if mirrored is None else mirrored
    half = np.where(mirrored, 0.5, 1.0)
    hinge = ply.nodes.of_hinge[rows]
    next_hinge = hinge if following is None else following
    out = 0.5 * (out[hinge] + out[next_hinge])
    crossover = np.column_stack([rows, rows])
    family, before, at, after = points
    nodes = [before, at, after]
    if following is not None:
        crossover[:, 1] = ply.crossover_of[following]
    if ply.dim == 3:
        nodes += [*ply.nodes.crossing[family, hinge].T]
        nodes += [*ply.nodes.crossing[family, next_hinge].T]
    return (
        np.column_stack(nodes),
        length / half,
        half * in_plane,
        half * out,
        crossover,
        np.full(n, -1) if clamp is None else clamp,
        np.zeros((n, ply.dim)) if along is None else np.broadcast_to(along, (n, ply.dim)),
        np.full(n, family),
        mirrored,
        cut[np.column_stack([hinge, next_hinge])],
    )


def _family(ply: PlyNodes, family: int) -> list[tuple]:
    """Bends of the yarns of one family.

    Without yarn bending tails that follow their yarn are straightened: at equilibrium they are at
    rest, whatever the rigidity.
    """
    network, supports, constraints = ply.network, ply.supports, ply.constraints
    hinge, ends = ply.nodes.of_hinge, ply.nodes.of_network_node[network.arm_node]
    length, carrying = network.arm_length, supports.carrying
    fabric, width = network.fabric, network.pitch[1 - family]  # [23]: yarns within the width
    yarn = fabric.warp if family == 0 else fabric.weft
    stiff = yarn.yarn_bending * yarn.yarns * width
    straightener = fabric.shear_modulus * network.pitch.prod() * network.pitch.mean()
    # Out of the plane per width: at an edge, and on a plane of symmetry, of what there is of it.
    along = length[:, family] + length[:, family + 2]
    wide = network.quadrant_area.sum(axis=1) / np.where(along > 0, along, np.inf)
    out = np.zeros(ply.nodes.num_nodes_local)
    out[hinge] = ply.out_of_plane[family].stiffness0 * np.minimum(wide, width)
    ply.nodes.halo.forward(out)
    slaved = np.zeros(length.shape, bool)
    slaved[network.boundary_crossovers] = supports.slaved
    slaved = slaved[:, family] | slaved[:, family + 2]
    in_plane = np.full(len(hinge), stiff) if ply.bending else np.where(slaved, straightener, 0.0)
    wanted, along_yarn = carrying & (in_plane > 0), ply.bending
    if ply.dim == 3:  # where yarns cross, so that the cloth has a normal
        crossing = ply.nodes.crossing[family, hinge]
        carrying = wanted = carrying & (crossing[:, 0] != crossing[:, 1])
        along_yarn = True
    held = constraints.held[network.arm_node]
    held = held & constraints.held_arm[network.arm_node, np.arange(4)]
    mirrored = constraints.mirrored_arm[network.arm_node, np.arange(4)]
    held |= mirrored
    ends_there = mirrored & (length == 0)
    cut = np.zeros(ply.nodes.num_nodes_local, bool)
    cut[hinge] = ends_there[:, 1 - family] | ends_there[:, 3 - family]
    ply.nodes.halo.forward(cut)
    parts = []

    rows = np.flatnonzero(wanted & (length[:, family] > 0) & (length[:, family + 2] > 0))
    points = family, ends[rows, family + 2], hinge[rows], ends[rows, family]
    mean = 0.5 * (length[rows, family] + length[rows, family + 2])
    parts.append(_part(ply, rows, points, mean, in_plane[rows], out, cut))
    for arm, other in ((family, family + 2), (family + 2, family)):
        # The crossover lies on a clamp that holds the other arm's direction.
        rows = np.flatnonzero(
            wanted & (length[:, arm] > 0) & (length[:, other] == 0) & held[:, other]
        )
        points = family, hinge[rows], hinge[rows], ends[rows, arm]
        clamp = ply.clamp_of[network.arm_node[rows, other]]
        parts.append(
            _part(ply, rows, points, 0.5 * length[rows, arm], in_plane[rows], out, cut, None, clamp,
                  ply.arm_directions[arm], mirrored[rows, other])
        )  # fmt: skip
        if not along_yarn:
            continue
        # The arm ends on a clamp.
        rows = np.flatnonzero(carrying & (length[:, arm] > 0) & held[:, arm])
        points = family, ends[rows, arm], ends[rows, arm], hinge[rows]
        clamp = ply.clamp_of[network.arm_node[rows, arm]]
        parts.append(
            _part(ply, rows, points, 0.5 * length[rows, arm], stiff * ply.bending, out, cut, None,
                  clamp, ply.arm_directions[other], mirrored[rows, arm])
        )  # fmt: skip
    if along_yarn:  # between a crossover and the next one, if that carries, too
        after = ply.nodes.after_hinge[:, family]
        rows = np.flatnonzero(carrying & (after >= 0) & ply.carries[after])
        points = family, hinge[rows], ends[rows, family], after[rows]
        mean = np.full(len(rows), 0.5 * network.pitch[family])
        parts.append(_part(ply, rows, points, mean, stiff * ply.bending, out, cut, after[rows]))
    return parts
