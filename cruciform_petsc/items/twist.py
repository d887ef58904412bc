# SPDX-License-Identifier: MIT
"""Cloth that twists as an item: out of its plane, between neighbouring crossovers.

Yarns that only bend leave a net free to twist: a strip cut at 45 degrees would have half of the
rigidity of one along the yarns, and measured strips have more (Cooper 1960, J. Text. Inst.
51:T317). A sheet that bends alike in all directions, by a law of energy psi of each principal
curvature, has 2 psi(kappa) in a saddle w = kappa x y; that much, or a share of it, is given here.
With a rigidity B and the share s, psi = B kappa^2/2, one at the angle a to the warp has

    1/B(a) = (cos^4 a + sin^4 a + 2 cos^2 a sin^2 a / s) / B
"""

from __future__ import annotations

import numpy as np

from ..elements.level import FORCE, STIFFNESS, room
from .item import Item, Placed, Work
from .loads import cross_matrix
from .nodes import PlyNodes

# Vectors of an element's six nodes: from hinge to hinge, and along the yarns that cross there.
_ENDS = ((1, 0), (2, 3), (4, 5))


class Twist(Item):
    """Twisting between neighbouring crossovers of a ply in space.

    Between two hinges a length L apart on a yarn, t from the first to the second, a and b along the
    yarns that cross there, of unit length at rest, the yarns' twist and the energy are

        kappa = 2 t . (a x b) / (L |t x (a + b)|),   W = s A [ psi_warp(kappa) + psi_weft(kappa) ]

    with the laws of both families' bending. Warp and weft both tell of the twist of the whole area,
    so each has half of that: A is what of half the hinges' area falls to this of their joints.

    Parameters
    ----------
    ply : PlyNodes
        In space.
    share : float
        s.

    Attributes
    ----------
    nodes : int32 (m, 6)
        The two hinges, then both ends of the yarn that crosses at the first, and at the second.
    """

    name = "twist"
    modes = ("out_of_plane_bending",)

    def __init__(self, ply: PlyNodes, share: float):
        network, nodes = ply.network, ply.nodes
        arms, carrying = network.arm_length, ply.supports.carrying
        hinge = nodes.of_hinge
        at_plane = ply.constraints.mirrored_arm[network.arm_node, np.arange(4)]
        parts = []
        for family in (0, 1):
            after = nodes.after_hinge[:, family]
            rows = np.flatnonzero(carrying & (after >= 0) & ply.carries[after])
            pair = np.stack([hinge[rows], after[rows]])
            crossing = nodes.crossing[family][pair]  # (2, n, 2)
            crosses = (crossing[..., 0] != crossing[..., 1]).all(axis=0)
            pair, crossing = pair[:, crosses], crossing[:, crosses]
            # Of a hinge's area what falls to each of its joints.
            joints = np.zeros(nodes.num_nodes_local)
            np.add.at(joints, pair, 1.0)
            # Across a plane of symmetry there is one to the mirror image, without any twist.
            across = at_plane & (arms > 0)
            joints[hinge] += across[:, family] + 1.0 * across[:, family + 2]
            nodes.halo.share(joints)
            area = np.zeros(nodes.num_nodes_local)
            area[hinge] = np.where(arms.any(axis=1), network.quadrant_area.sum(axis=1), 0.0)
            nodes.halo.forward(area)
            each = 0.5 * (area / np.maximum(joints, 1.0))[pair].sum(axis=0)
            along = np.concatenate([pair.T, crossing[0], crossing[1]], axis=1)
            length = np.linalg.norm(nodes.rest[pair[1]] - nodes.rest[pair[0]], axis=1)
            # On a plane of symmetry crossing yarns go on as their mirror images, straight through
            # it: along a yarn that lies there nothing twists.
            ends = at_plane & (arms == 0)
            cut = np.zeros(nodes.num_nodes_local, bool)
            cut[hinge] = ends[:, 1 - family] | ends[:, 3 - family]
            free = ~nodes.halo.forward(cut)[pair].any(axis=0)
            parts.append((along[free], each[free], length[free]))
        joined, each, length = (np.concatenate(part) for part in zip(*parts, strict=True))
        self.nodes = joined.astype(np.int32)
        across = [
            np.linalg.norm(nodes.rest[joined[:, p]] - nodes.rest[joined[:, q]], axis=1)
            for p, q in _ENDS[1:]
        ]
        self._area, self._length, self._laws = share * each, length, ply.out_of_plane
        self._scale = np.column_stack([np.ones(len(joined)), *(1.0 / size for size in across)])

    def work(self, state: Placed, level: int, rows=slice(None), before=None) -> Work:
        """See Item.work."""
        x, scale = state.x[self.nodes[rows]], self._scale[rows]
        area, length = self._area[rows], self._length[rows]
        t, a, b = (scale[:, k, None] * (x[:, p] - x[:, q]) for k, (p, q) in enumerate(_ENDS))
        energy, force, stiffness = room(len(x), 1, 6, 3, level)
        s, first, second = _twist(t, a, b, level)
        # By kappa = s/L; laws are of its size.
        kappa = s / length
        laws = [law.evaluate(abs(kappa)) for law in self._laws]
        psi, slope, curve = (area * sum(parts) for parts in zip(*laws, strict=True))
        slope, curve = slope * np.sign(kappa) / length, curve / length**2
        energy[:, 0] = psi
        if level >= FORCE:
            weighted = slope[:, None, None] * first * scale[..., None]
            force[:] = 0.0
            for k, (p, q) in enumerate(_ENDS):
                force[:, p] += weighted[:, k]
                force[:, q] -= weighted[:, k]
        if level >= STIFFNESS:
            block = curve[:, None, None, None, None] * (
                first[:, :, :, None, None] * first[:, None, None]
            )
            block += slope[:, None, None, None, None] * second
            block *= scale[:, :, None, None, None] * scale[:, None, None, :, None]
            stiffness[:] = 0.0
            for k, (p, q) in enumerate(_ENDS):
                for j, (r, o) in enumerate(_ENDS):
                    part = block[:, k, :, j]
                    stiffness[:, p, :, r] += part
                    stiffness[:, q, :, o] += part
                    stiffness[:, p, :, o] -= part
                    stiffness[:, q, :, r] -= part
        return energy, force, stiffness


def _twist(t: np.ndarray, a: np.ndarray, b: np.ndarray, level: int):
    """Twist 2 t . (a x b) / |t x (a + b)| of vectors (n, 3), its first and second derivatives.

    By (t, a, b): float (n,), (n, 3, 3), (n, 3, 3, 3, 3).
    """
    m = a + b
    volume = 2.0 * np.einsum("ni,ni->n", t, np.cross(a, b))
    tt, mm, tm = ((p * q).sum(axis=1) for p, q in ((t, t), (m, m), (t, m)))
    size = np.sqrt(tt * mm - tm**2)
    s = volume / size
    if level < FORCE:
        return s, None, None
    by_volume = 2.0 * np.stack([np.cross(a, b), np.cross(b, t), np.cross(t, a)], axis=1)
    # Of half the square of the size.
    by_t = mm[:, None] * t - tm[:, None] * m
    by_m = tt[:, None] * m - tm[:, None] * t
    half = np.stack([by_t, by_m, by_m], axis=1)
    by_size = half / size[:, None, None]
    first = by_volume / size[:, None, None] - (s / size)[:, None, None] * by_size
    if level < STIFFNESS:
        return s, first, None
    n, one = len(t), np.eye(3)
    of_volume = np.zeros((n, 3, 3, 3, 3))
    for (k, j), (v, sign) in {
        (0, 1): (b, -1.0), (0, 2): (a, 1.0), (1, 2): (t, -1.0)
    }.items():  # fmt: skip
        block = 2.0 * sign * cross_matrix(v)
        of_volume[:, k, :, j], of_volume[:, j, :, k] = block, block.swapaxes(1, 2)
    outer = lambda p, q: p[:, :, None] * q[:, None, :]  # noqa: E731
    tt_block = mm[:, None, None] * one - outer(m, m)
    mm_block = tt[:, None, None] * one - outer(t, t)
    tm_block = 2.0 * outer(t, m) - outer(m, t) - tm[:, None, None] * one
    of_half = np.zeros_like(of_volume)
    of_half[:, 0, :, 0] = tt_block
    for k in (1, 2):
        of_half[:, 0, :, k], of_half[:, k, :, 0] = tm_block, tm_block.swapaxes(1, 2)
        for j in (1, 2):
            of_half[:, k, :, j] = mm_block
    wide = (slice(None), None, None, None, None)
    pairs = by_size[:, :, :, None, None] * by_size[:, None, None]
    of_size = (of_half - pairs) / size[wide]
    mixed = by_volume[:, :, :, None, None] * by_size[:, None, None]
    mixed = mixed + mixed.transpose(0, 3, 4, 1, 2)
    second = (
        of_volume / size[wide]
        - mixed / size[wide] ** 2
        - (s / size)[wide] * of_size
        + (2.0 * s / size**2)[wide] * pairs
    )
    return s, first, second
