# SPDX-License-Identifier: MIT
"""Loads: dead ones (an edge's, gravity, an imperfection's), and pressures that follow the cloth."""

from __future__ import annotations

from functools import singledispatch
from types import SimpleNamespace
from typing import Any

import numpy as np

from ..elements.level import FORCE, STIFFNESS, room
from ..net.lattice import ARM_STEP, BETWEEN, QUADRANTS, pack_key
from ..parallel import most
from .cruciforms import SIGN
from .item import Item, Placed, Work
from .nodes import PlyNodes


class DeadLoads(Item):
    """Energy - f F . (x - X), f the factor of the state for this item.

    Parameters
    ----------
    force : float (n_local, dim)
        F, lab frame, N; looked at on owned nodes.
    rest : float (n_local, dim)
        X.
    num_owned : int
    name : str
        Of the item, and of its energy.
    factor : float
        f of states that say nothing of this item.
    """

    is_load = True

    def __init__(self, force, rest, num_owned: int, name: str = "loads", factor: float = 0.0):
        self.name, self.modes, self.factor = name, (name,), factor
        at = np.flatnonzero(force[:num_owned].any(axis=1))
        self.nodes = at[:, None].astype(np.int32)
        self.force, self.rest = force[at], rest[at]

    def work(self, state: Placed, level: int, rows=slice(None), before=None) -> Work:
        """See Item.work."""
        pull = state.factors.get(self.name, self.factor) * self.force[rows]
        energy, force, stiffness = room(len(pull), 1, 1, pull.shape[1], level)
        moved = state.x[self.nodes[rows, 0]] - self.rest[rows]
        energy[:, 0] = -(pull * moved).sum(axis=1)
        if level >= FORCE:
            force[:, 0] = -pull
        stiffness[:] = 0.0
        return energy, force, stiffness


G = 9.80665  # m/s^2, standard gravity


def gravity(
    ply: PlyNodes, by: str, direction=(0.0, 0.0, -1.0), stretched: float = 1.0
) -> DeadLoads:
    """Weight of a ply: areal density times the area of each node. Collective.

    ``by``: what wants it, for the InputError that is raised if the fabric has no areal density.
    ``stretched``: area as the cloth is drawn over that without tension, of which the density is.
    """
    weight = G * ply.network.fabric.needed("areal_density", by) / stretched
    force = weight * ply.areas()[:, None] * np.asarray(direction, float)[: ply.dim]
    return DeadLoads(force, ply.nodes.rest, ply.nodes.num_nodes_owned, "gravity", 1.0)


class Pressure(Item):
    """Follower pressure on a ply in space: energy -f p V, f the factor of the state for this item.

    V is the volume between the cloth and a point, the *origin*: the sum over triangles (a, b, c) of
    weight det(a - o, b - o, c - o)/6, positive where warp x weft points away from the origin. The
    pressure pushes along warp x weft. The triangles are those of the surface through the arm ends
    (`facets`): it is closed, so that moving the origin changes forces at the cloth's edge only.

    Right where the edge is held, or slides in planes of symmetry through the origin, or where caps
    that are counted elsewhere close the volume. At a free edge it adds forces that depend on the
    origin; `Suction` does not.

    Parameters
    ----------
    ply : PlyNodes
        In space.
    pressure : float
        p, Pa.
    origin : float (3,), optional
        m; by default the middle of the outline's bounding box, at z = 0.
    """

    name = "pressure"
    modes = ("pressure",)
    is_load = True

    def __init__(self, ply: PlyNodes, pressure: float, origin=None):
        self.nodes, self.weight = facets(ply)
        self.pressure = pressure
        self.origin = np.append(ply.network.preform.middle, 0.0) if origin is None else origin

    def work(self, state: Placed, level: int, rows=slice(None), before=None) -> Work:
        """See Item.work."""
        a, b, c = np.moveaxis(state.x[self.nodes[rows]] - self.origin, 1, 0)
        size = -state.factors.get(self.name, 1.0) * self.pressure / 6.0 * self.weight[rows]
        energy, force, stiffness = room(len(a), 1, 3, 3, level)
        across = np.cross(b, c)
        energy[:, 0] = size * (a * across).sum(axis=1)
        if level >= FORCE:
            force[:, 0] = size[:, None] * across
            force[:, 1] = size[:, None] * np.cross(c, a)
            force[:, 2] = size[:, None] * np.cross(a, b)
        if level >= STIFFNESS:
            stiffness[:] = 0.0
            for p, q, other, sign in ((0, 1, c, -1), (1, 2, a, -1), (2, 0, b, -1)):
                block = sign * size[:, None, None] * cross_matrix(other)
                stiffness[:, p, :, q] = block
                stiffness[:, q, :, p] = block.swapaxes(1, 2)
        return energy, force, stiffness


class PressureAbove(Item):
    """Follower pressure on a ply over a level plane: energy -f p V, f the state's factor for it.

    V is the volume between the cloth and z = ``base``, the sum over triangles (`facets`) of weight
    times area in plan times mean height. Right, reactions too, where the edge is held in the plane,
    slides in it, or slides in planes of symmetry that stand on it: walls there add nothing to V. It
    pushes along warp x weft.

    Parameters
    ----------
    ply : PlyNodes
        In space.
    pressure : float
        p, Pa.
    base : float
        m.
    """

    name = "pressure"
    modes = ("pressure",)
    is_load = True

    def __init__(self, ply: PlyNodes, pressure: float, base: float = 0.0):
        self.nodes, self.weight = facets(ply)
        self.pressure, self.base = pressure, base

    def work(self, state: Placed, level: int, rows=slice(None), before=None) -> Work:
        """See Item.work."""
        x = state.x[self.nodes[rows]]
        size = -state.factors.get(self.name, 1.0) * self.pressure / 6.0 * self.weight[rows]
        energy, force, stiffness = room(len(x), 1, 3, 3, level)
        side = np.roll(x, -2, axis=1) - np.roll(x, -1, axis=1)  # from the next corner to the last
        slope = np.stack([-side[..., 1], side[..., 0]], axis=2)  # of twice the area, by corners
        area = side[:, 2, 0] * side[:, 0, 1] - side[:, 2, 1] * side[:, 0, 0]
        height = x[..., 2].sum(axis=1) - 3.0 * self.base
        energy[:, 0] = size * area * height
        if level >= FORCE:
            force[..., :2] = (size * height)[:, None, None] * slope
            force[..., 2] = (size * area)[:, None]
        if level >= STIFFNESS:
            stiffness[:] = 0.0
            for p in range(3):
                across = size[:, None] * slope[:, p]
                stiffness[:, p, :2, :, 2] = across[:, :, None]
                stiffness[:, :, 2, p, :2] = across[:, None]
                for q, sign in (((p + 1) % 3, 1.0), ((p + 2) % 3, -1.0)):
                    stiffness[:, p, 0, q, 1] = sign * size * height
                    stiffness[:, p, 1, q, 0] = -sign * size * height
        return energy, force, stiffness


class Suction(Item):
    """One-sided pressure with the area and normal of a state before: right at free edges, too.

    Energy -f p sum of (n A) . x over nodes, n A the vector of area that a node stands for in the
    state before, brought up to date until it no longer matters (``lagged``), as friction's normal
    forces are: forces p n A then, on no side but the pressed one. It pushes along warp x weft.

    Parameters
    ----------
    ply : PlyNodes
        In space.
    pressure : float
        p, Pa.
    """

    name = "suction"
    modes = ("suction",)
    is_load = True
    lags = True

    def __init__(self, ply: PlyNodes, pressure: float):
        self._facets, self._weight = facets(ply)
        self._ply, self.pressure = ply, pressure
        self.nodes = np.arange(ply.nodes.num_nodes_owned, dtype=np.int32)[:, None]
        self._at_rest = self._areas(ply.nodes.rest)

    def _areas(self, x: np.ndarray) -> np.ndarray:
        """Vectors of area (n_owned, 3), m^2, of nodes at positions x (n_local, 3). Collective."""
        a, b, c = np.moveaxis(x[self._facets], 1, 0)
        share = self._weight[:, None] / 6.0 * np.cross(b - a, c - a)
        vectors = np.zeros_like(x)
        np.add.at(vectors, self._facets, share[:, None])
        vectors = self._ply.nodes.halo.reverse(vectors)
        vectors[~self._ply.active] = 0.0
        return vectors[: len(self.nodes)]

    def work(self, state: Placed, level: int, rows=slice(None), before=None) -> Work:
        """See Item.work."""
        area = state.memory.get(self.name, {}).get("area", self._at_rest)[rows]
        push = -state.factors.get(self.name, 1.0) * self.pressure * area
        energy, force, stiffness = room(len(push), 1, 1, 3, level)
        energy[:, 0] = (push * state.x[self.nodes[rows, 0]]).sum(axis=1)
        if level >= FORCE:
            force[:, 0] = push
        stiffness[:] = 0.0
        return energy, force, stiffness

    def lagged(self, state: Placed) -> tuple[dict[str, np.ndarray], float, float]:
        """Areas of a state to remember; how much force they change, and all of it on this rank, N.

        Collective.
        """
        area = self._areas(state.x)
        old = state.memory.get(self.name, {}).get("area", self._at_rest)
        push = abs(state.factors.get(self.name, 1.0) * self.pressure)
        change, size = (push * np.linalg.norm(v, axis=1).sum() for v in (area - old, area))
        return {"area": area}, float(change), float(size)

    def accepted(self, state: Placed) -> dict[str, np.ndarray]:
        """See Item.accepted. Collective."""
        return self.lagged(state)[0]


def cross_matrix(v: np.ndarray) -> np.ndarray:
    """Matrices (n, 3, 3) of the product v x, of vectors (n, 3)."""
    matrix = np.zeros((len(v), 3, 3))
    for i, j, k in ((0, 1, 2), (1, 2, 0), (2, 0, 1)):
        matrix[:, j, k], matrix[:, k, j] = -v[:, i], v[:, i]
    return matrix


@singledispatch
def facets(ply: Any) -> tuple[np.ndarray, np.ndarray]:
    """Triangles of the surface through a ply's arm ends, on the ranks that own their crossovers.

    Two kinds of quadrilaterals tile the cloth: around each crossover that of its four arm ends,
    and between four crossovers that of the arm ends on the four yarns; each is the mean of the two
    pairs of triangles that it falls into. At the outline what is left of the latter are polygons,
    which go straight from one yarn's end to the next: some corners of the outline stick out.

    Returns
    -------
    nodes : int32 (m, 3)
        Counter-clockwise seen from where warp x weft points to.
    weight : float (m,)
        How often each counts.
    """
    network, nodes = ply.network, ply.nodes
    ij = network.crossover_ij.astype(np.int64)
    ends = nodes.of_network_node[network.arm_node]
    # The cell beyond the first quadrant, whole if yarns join its four crossovers: the ends on it.
    i, j = ij.T
    keys = (pack_key(1, i + 1, 4 * j), pack_key(0, j + 1, 4 * i))
    right, top = (nodes.find(key + BETWEEN[0]) for key in keys)
    cells = np.column_stack([ends[:, 0], right, top, ends[:, 1]])
    cells = cells[network.arm_is_shared[:, :2].all(axis=1) & (right >= 0) & (top >= 0)]
    parts, weights = [], []
    for four in (ends, cells):
        for skip in range(4):
            parts.append(four[:, np.arange(4) != skip])
            weights.append(np.full(len(four), 0.5))
    for last in range(2, 8):
        fan = nodes.edge_cells[:, [0, last - 1, last]]
        parts.append(fan[fan[:, 2] >= 0])
        weights.append(np.ones(len(parts[-1])))
    # A corner of the outline with a single crossover: as if its quadrant were a parallelogram, the
    # triangle beyond the arms' ends is that on this side of them once more.
    edge = network.boundary_crossovers
    for quadrant, arms in enumerate(QUADRANTS):
        steps = ARM_STEP[arms]
        beside = [network.has_crossover(ij[edge] + step) for step in (*steps, steps.sum(axis=0))]
        half = 0.5 * network.arm_length[edge][:, arms].prod(axis=1)
        at = edge[~np.any(beside, axis=0) & (half > 0)]
        order = arms[:: int(SIGN[quadrant])]
        parts.append(np.column_stack([nodes.of_hinge[at], ends[at][:, order]]))
        area = network.quadrant_area[at, quadrant]
        weights.append(area / (0.5 * network.arm_length[at][:, arms].prod(axis=1)) - 1.0)
    return np.concatenate(parts).astype(np.int32), np.concatenate(weights)


WAVES = 16  # of an imperfection


def imperfection(ply, height: float, seed: int) -> DeadLoads:
    """Loads that bend a ply in space as if it were not flat at rest, but wavy. Collective.

    They are those that hold the waves against the bending alone: free of all else the cloth has
    them, however much it stretches or shears. Waves of random direction, phase and length (from a
    sixth of the cloth's largest side to all of it) depend on the place only, so that they are the
    same on any number of ranks and for any pitch.

    Parameters
    ----------
    ply : Ply
    height : float
        Of the highest wave, m.
    seed : int
    """
    nodes, rest = ply.nodes, ply.nodes.rest
    size = ply.network.preform.size.max()
    random = np.random.default_rng(seed)
    angle, phase = 2.0 * np.pi * random.random((2, WAVES))
    number = 2.0 * np.pi / size * 6.0 ** random.random(WAVES)
    place = rest[:, :2] - ply.network.preform.middle
    along = place @ np.stack([np.cos(angle), np.sin(angle)])
    waves = np.zeros_like(rest)
    waves[:, 2] = np.cos(number * along + phase).sum(axis=1)
    waves *= height / most(ply.comm, abs(waves), 0.0)
    force = np.zeros_like(rest)
    held = SimpleNamespace(turn=np.tile(np.eye(3), (len(ply.clamped), 1, 1)))
    at_rest: Any = SimpleNamespace(x=rest, hold=held)
    for rows in ply.bends.chunks():
        at = ply.bends.nodes[rows]
        tangent = ply.bends.work(at_rest, STIFFNESS, rows)[2]
        np.add.at(force, at, np.einsum("mkilj,mlj->mki", tangent, waves[at]))
    force = nodes.halo.share(force)
    force[~ply.active] = 0.0
    return DeadLoads(force, rest, nodes.num_nodes_owned, "imperfection", 1.0)
