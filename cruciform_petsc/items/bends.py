# SPDX-License-Identifier: MIT
"""Yarns that bend as an item: in the cloth's plane, and in space out of it."""

from __future__ import annotations

import numpy as np

from ..elements import bend
from .cruciforms import turns
from .item import Item, Placed, Work
from .nodes import PlyNodes, unit


class Bends(Item):
    """Points at which yarns bend: at crossovers, at arm ends between them, at clamps.

    At a clamp the direction that it holds stands for the point before: nodes before and at the bend
    are one, and `offset` leads from there to a point before. In space two pairs of arm ends of the
    crossing yarns follow (elements.bend): those of the crossovers on both sides.

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
        self._clamp, self._along, self._family = columns[5:]
        curved = any(law.name != "linear" for law in ply.out_of_plane)
        self._moment = ply.out_of_plane if curved else ()
        self.nodes = nodes.astype(np.int32)

    def work(self, state: Placed, level: int, rows=slice(None), before=None) -> Work:
        """See Item.work."""
        place = state.x[self.nodes[rows]]
        at = np.flatnonzero(self._clamp[rows] >= 0)
        if len(at):
            turn = turns(state)[self._clamp[rows][at]]
            place[at, 0] -= unit(np.einsum("mij,mj->mi", turn, self._along[rows][at]))
        return bend.bends(
            place, self.length[rows], self.in_plane[rows], self.out_of_plane[rows], level,
            moment=self._moment, family=self._family[rows],
        )  # fmt: skip


def _part(ply, rows, points, length, in_plane, out, following=None, clamp=None, along=None):
    """Bends that belong to crossovers ``rows``, as columns; ``following``: their second hinges.

    ``out`` (n_local,): rigidity out of the plane at hinges.
    """
    n = len(rows)
    hinge = ply.nodes.of_hinge[rows]
    out = 0.5 * (out[hinge] + out[hinge if following is None else following])
    crossover = np.column_stack([rows, rows])
    family, before, at, after = points
    nodes = [before, at, after]
    if following is not None:
        crossover[:, 1] = ply.crossover_of[following]
    if ply.dim == 3:
        nodes += [*ply.nodes.crossing[family, hinge].T]
        nodes += [*ply.nodes.crossing[family, hinge if following is None else following].T]
    return (
        np.column_stack(nodes),
        length,
        np.broadcast_to(np.asarray(in_plane, float), n),
        out,
        crossover,
        np.full(n, -1) if clamp is None else clamp,
        np.zeros((n, ply.dim)) if along is None else np.broadcast_to(along, (n, ply.dim)),
        np.full(n, family),
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
    # At a plane of symmetry, too, a direction is held: the plane's normal.
    held |= constraints.mirrored_arm[network.arm_node, np.arange(4)]
    parts = []

    rows = np.flatnonzero(wanted & (length[:, family] > 0) & (length[:, family + 2] > 0))
    points = family, ends[rows, family + 2], hinge[rows], ends[rows, family]
    mean = 0.5 * (length[rows, family] + length[rows, family + 2])
    parts.append(_part(ply, rows, points, mean, in_plane[rows], out))
    for arm, other in ((family, family + 2), (family + 2, family)):
        # The crossover lies on a clamp that holds the other arm's direction.
        rows = np.flatnonzero(
            wanted & (length[:, arm] > 0) & (length[:, other] == 0) & held[:, other]
        )
        points = family, hinge[rows], hinge[rows], ends[rows, arm]
        clamp = ply.clamp_of[network.arm_node[rows, other]]
        parts.append(
            _part(ply, rows, points, 0.5 * length[rows, arm], in_plane[rows], out, None, clamp,
                  ply.arm_directions[arm])
        )  # fmt: skip
        if not along_yarn:
            continue
        # The arm ends on a clamp.
        rows = np.flatnonzero(carrying & (length[:, arm] > 0) & held[:, arm])
        points = family, ends[rows, arm], ends[rows, arm], hinge[rows]
        clamp = ply.clamp_of[network.arm_node[rows, arm]]
        parts.append(
            _part(ply, rows, points, 0.5 * length[rows, arm], stiff * ply.bending, out, None,
                  clamp, ply.arm_directions[other])
        )  # fmt: skip
    if along_yarn:  # between a crossover and the next one, if that carries, too
        after = ply.nodes.after_hinge[:, family]
        rows = np.flatnonzero(carrying & (after >= 0) & ply.carries[after])
        points = family, hinge[rows], ends[rows, family], after[rows]
        mean = np.full(len(rows), 0.5 * network.pitch[family])
        parts.append(_part(ply, rows, points, mean, stiff * ply.bending, out, after[rows]))
    return parts
