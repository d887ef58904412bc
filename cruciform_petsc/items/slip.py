# SPDX-License-Identifier: MIT
"""Yarns that slide through crossovers: arms whose length at rest is an unknown, and friction.

A crossover has a second node whose components along warp and weft are s, how far each of these
yarns has slid through the hinge, the way it runs (`Nodes`). Between crossovers k and k + 1 of a
yarn its two arms share what has come in and gone out: each has the length at rest

    R = a + (s_k - s_(k+1))/2                               a + s_k, a - s_k at a yarn's held ends

in place of a, so that a yarn may slide past many crossovers. An arm of width w (its quadrants' area
over a) has the strain energy per length at rest of all arms, with the stretch l/R of its length l:

    W = w R Phi(l/R)         dW/dl = w Phi' = T         dW/dR = w (Phi - l/R Phi') = -C

T is the tension and C the configurational one (Eshelby's energy-momentum of a bar; C = T for small
strains): at equilibrium friction holds C_1 - C_3 at a hinge. A tail that nothing holds has neither
and keeps its length: the quadrants' frame, not the yarn.

Crossing yarns do not come closer than m, a share of the pitch: below, an arm has the energy
E w (m/2 - R)^3 / (3 (m/2)^2) as well.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from ..elements.level import ENERGY, FORCE, STIFFNESS, room
from ..laws import linear
from ..net.lattice import QUADRANTS
from .cruciforms import Cruciforms
from .item import Item, Placed, Work
from .nodes import PlyNodes

ELASTIC = 1e-3  # pitches, up to which friction gives like a spring
TRACE = 1e-6  # of a crossing's friction stays when a yarn has left it, so that none floats


class SlidingArms(Item):
    """Arms of cruciforms whose yarns slide: their tension, in place of the cruciforms'.

    Attributes
    ----------
    row, arm : int (m,)
        Cruciform and arm of each element.
    width : float (m,), m
    """

    name = "sliding arms"
    modes = ("tension", "slip")

    def __init__(self, ply: PlyNodes, cruciforms: Cruciforms):
        assert ply.slip is not None
        network, nodes, rows = ply.network, ply.nodes, cruciforms.rows
        self.network, length = network, cruciforms.arm_length
        area, at = np.zeros(length.shape), np.arange(len(rows))
        for quadrant, arms in enumerate(QUADRANTS):
            for arm in arms:
                source = cruciforms.strain_source[:, arm]
                own = source >= 0
                area[at[own], source[own]] += cruciforms.area[own, quadrant]
        self.row, self.arm = np.nonzero((length > 0) & (area > 0))
        self.length = length[self.row, self.arm]
        self.width = area[self.row, self.arm] / self.length
        crossover, family = rows[self.row], self.arm % 2
        end = network.arm_node[crossover, self.arm]
        slide, other = nodes.of_slide[crossover], nodes.beside_slide[crossover, self.arm]
        shared = other >= 0
        hinge_and_end = cruciforms.nodes[self.row, 4], nodes.of_network_node[end]
        columns = [*hinge_and_end, slide, np.where(shared, other, slide)]
        self.nodes = np.column_stack(columns).astype(np.int32)
        # Change of the length at rest per slip, here and at the crossover that the arm leads to.
        sign = np.where(self.arm < 2, 1.0, -1.0)
        own = np.where(shared, 0.5, np.where(ply.gripped[end], 1.0, 0.0))
        self.share = sign[:, None] * np.column_stack([own, np.where(shared, -0.5, 0.0)])
        self.along = ply.arm_directions[family]
        self._rest = nodes.rest
        laws = network.fabric.warp_tension, network.fabric.weft_tension
        self._laws, self._stiffness = laws, np.array([law.stiffness0 for law in laws])[family]
        self._least = 0.5 * ply.slip.closest * network.pitch[family]

    def lengths(self, state: Placed, rows=slice(None)) -> np.ndarray:
        """Lengths at rest, (m,), m."""
        slides = self.nodes[rows, 2:]
        slid = np.einsum("mki,mi->mk", state.x[slides] - self._rest[slides], self.along[rows])
        return self.length[rows] + (self.share[rows] * slid).sum(axis=1)

    def _density(self, stretch: np.ndarray, rows: slice) -> np.ndarray:
        """Phi, N/m, and its two derivatives by the stretch, (3, m)."""
        result = np.empty((3, len(stretch)))
        e, e1, e2 = self.network.fabric.effective_strain(stretch)
        for family, law in enumerate(self._laws):
            of = self.arm[rows] % 2 == family
            w, w1, w2 = law.evaluate(e[of])
            result[:, of] = w, w1 * e1[of], w2 * e1[of] ** 2 + w1 * e2[of]
        return result

    def work(self, state: Placed, level: int, rows=slice(None), before=None) -> Work:
        """See Item.work. Nothing is foretold: where friction switches the energy has to fall."""
        nodes, width = self.nodes[rows], self.width[rows]
        hinge, end = state.x[nodes[:, 0]], state.x[nodes[:, 1]]
        d, rest = end - hinge, self.lengths(state, rows)
        size = np.linalg.norm(d, axis=1)
        energy, force, stiffness = room(len(nodes), 2, 4, d.shape[1], level)
        none = rest <= 0.0  # lengths that no yarn has; Newton's method turns back from them
        rest = np.where(none, size, rest)
        stretch = size / rest
        w, w1, w2 = self._density(stretch, rows)
        energy[:, 0] = np.where(none, np.inf, width * rest * w)
        least, stiff = self._least[rows], width * self._stiffness[rows]
        lacks = np.maximum(1.0 - rest / least, 0.0)
        energy[:, 1] = stiff * least * lacks**3 / 3.0
        if level < FORCE:
            return energy, force, stiffness
        t = d / size[:, None]
        by_rest = width * (w - stretch * w1) - stiff * lacks**2
        of_rest = self.share[rows][:, :, None] * self.along[rows][:, None, :]  # dR/dx
        force[:, 0], force[:, 1] = -(width * w1)[:, None] * t, (width * w1)[:, None] * t
        force[:, 2:] = by_rest[:, None, None] * of_rest
        if level < STIFFNESS:
            return energy, force, stiffness
        second = width * w2 / rest  # by l and l; by l and R and by R and R it is
        mixed, both = -stretch * second, stretch**2 * second + 2.0 * stiff * lacks / least
        across = width * w1 / size
        block = (second - across)[:, None, None] * t[:, :, None] * t[:, None, :]
        block += across[:, None, None] * np.eye(d.shape[1])
        coupling = mixed[:, None, None, None] * t[:, :, None, None] * of_rest[:, None]
        stiffness[:, 0, :, 0], stiffness[:, 1, :, 1] = block, block
        stiffness[:, 0, :, 1], stiffness[:, 1, :, 0] = -block, -block
        stiffness[:, 0, :, 2:], stiffness[:, 1, :, 2:] = -coupling, coupling
        turned = coupling.transpose(0, 2, 3, 1)
        stiffness[:, 2:, :, 0], stiffness[:, 2:, :, 1] = -turned, turned
        stiffness[:, 2:, :, 2:] = np.einsum("m,mpi,mqj->mpiqj", both, of_rest, of_rest)
        return energy, force, stiffness

    def tensions(self, state: Placed) -> np.ndarray:
        """Tensions, (m,), N."""
        size = np.linalg.norm(state.x[self.nodes[:, 1]] - state.x[self.nodes[:, 0]], axis=1)
        return self.width * self._density(size / self.lengths(state), slice(None))[1]

    def on(self, whole: np.ndarray, values: np.ndarray) -> np.ndarray:
        """Values of all cruciforms' arms (n, 4), with those of the elements (m,) in their place."""
        whole = whole.copy()
        whole[self.row, self.arm] = values
        return whole


class SlidingCruciforms(Cruciforms):
    """Cruciforms whose yarns slide: their shear, and what is read off them.

    Attributes
    ----------
    sliding : SlidingArms
    """

    def __init__(self, ply: PlyNodes):
        super().__init__(ply)
        self.sliding = SlidingArms(ply, self)
        none = linear(0.0).packed
        self.cloth = replace(self.cloth, warp=none, weft=none, c12=0.0)

    def lengths(self, state: Placed) -> np.ndarray:
        """See Cruciforms.lengths."""
        return self.sliding.on(self.arm_length, self.sliding.lengths(state))

    def tension_energy(self, state: Placed) -> np.ndarray:
        """Of each cruciform, (n,), J."""
        energies = [self.sliding.work(state, ENERGY, r)[0][:, 0] for r in self.sliding.chunks()]
        return np.bincount(self.sliding.row, np.concatenate(energies), len(self.rows))


class Slides(Item):
    """Friction of yarns at crossovers through which they slide.

    Coulomb's, with an incremental potential as of contact with tools (items.contact): F psi(d) of
    the way d that warp and weft have slid over each other since they stuck, psi' = 2 r - r^2 for
    r = d/d_0 < 1, 1 beyond. Warp and weft have slid by the vector s_w t_w - s_f t_f,

        d^2 = s_w^2 + s_f^2 - 2 s_w s_f sin(shear angle)

    F, the pull-out force of a crossover, is that of one crossing of two yarns times their number in
    a cruciform, and coefficient times the mean tension of both yarns there,

        F = n_w n_f share (force + coefficient (T_w + T_f)/2),  T_w = (T_1 + T_3)/(2 n_w), ... >= 0

    as twice the sine of the crimp angle makes a normal force of a tension. ``share`` is that of its
    area in the cloth, and while an end of a yarn goes through the crossover, falls to nothing from
    half a pitch before to half a pitch behind: a yarn pulled out leaves one after the other. F and
    the angle are those of the state before, brought up to date until it no longer matters
    (`lagged`).
    """

    name = "slip"
    modes = ("slip",)
    lags = True

    def __init__(self, ply: PlyNodes, cruciforms: SlidingCruciforms):
        assert ply.slip is not None
        slip, network, nodes = ply.slip, ply.network, ply.nodes
        self._cruciforms, self._arms = cruciforms, cruciforms.sliding
        at = np.flatnonzero(ply.active[nodes.of_slide[cruciforms.rows]])
        rows = cruciforms.rows[at]
        self.at, self.rows = at, rows
        self.nodes = nodes.of_slide[rows][:, None].astype(np.int32)
        self._rest, self._axes = nodes.rest, ply.arm_directions[:2]
        pitch = network.pitch
        self.elastic = ELASTIC * pitch.mean() if slip.elastic is None else slip.elastic
        yarns = network.fabric.warp.yarns, network.fabric.weft.yarns
        self._yarns = pitch[::-1] * yarns  # warp and weft yarns of a cruciform
        self._share = network.quadrant_area[rows].sum(axis=1) / pitch.prod()
        self._force, self._coefficient = slip.force, slip.coefficient
        # From each crossover to the yarn's ends, in pitches, (m, warp and weft, behind and ahead).
        ij = network.crossover_ij[rows].astype(np.int64)
        self._to_ends, self._pitch = np.empty((len(rows), 2, 2)), pitch
        for family, parts in enumerate((network.warp_yarns, network.weft_yarns)):
            part = parts.find(ij[:, 1 - family], ij[:, family])
            self._to_ends[:, family, 0] = ij[:, family] - parts.start[part]
            self._to_ends[:, family, 1] = parts.end[part] - ij[:, family]

    def slid(self, state: Placed, rows=slice(None)) -> np.ndarray:
        """How far warp and weft have slid, (m, 2), m."""
        at = self.nodes[rows, 0]
        return (state.x[at] - self._rest[at]) @ self._axes.T

    def work(self, state: Placed, level: int, rows=slice(None), before=None) -> Work:
        """See Item.work."""
        memory = {key: value[rows] for key, value in self._memory(state).items()}
        gap = self.slid(state, rows) - memory["anchor"]
        energy, force, stiffness = room(len(gap), 1, 1, self._axes.shape[1], level)
        along, d = _across(gap, memory["sine"])
        limit, r = memory["limit"], d / self.elastic
        energy[:, 0] = limit * self.elastic * np.where(r < 1, r**2 - r**3 / 3, r - 1 / 3)
        if level >= FORCE:
            # psi'/d, finite where d is zero
            per_d = np.where(r < 1, 2.0 - r, 1.0 / np.maximum(r, 1.0)) / self.elastic * limit
            force[:, 0] = (per_d[:, None] * along) @ self._axes
        if level >= STIFFNESS:
            second = limit * np.where(r < 1, 2.0 - 2.0 * r, 0.0) / self.elastic
            along = along / np.maximum(d, 1e-300)[:, None]
            block = per_d[:, None, None] * _metric(memory["sine"])
            block += (second - per_d)[:, None, None] * along[:, :, None] * along[:, None, :]
            stiffness[:, 0, :, 0] = self._axes.T @ block @ self._axes
        return energy, force, stiffness

    # -- memory -----------------------------------------------------------------------------------

    def _memory(self, state: Placed) -> Mapping[str, np.ndarray]:
        memory = state.memory.get(self.name)
        if memory:
            return memory
        none = np.zeros(len(self.nodes))
        limit = self._share * self._yarns.prod() * self._force
        return {"anchor": np.zeros((len(none), 2)), "sine": none, "limit": limit, "spent": none}

    def _behind(self, state: Placed) -> np.ndarray:
        """What there is of warp and weft behind and ahead of crossovers, (m, 2, 2), in pitches."""
        slid = self.slid(state) / self._pitch
        return self._to_ends + slid[:, :, None] * [-1.0, 1.0]

    def limits(self, state: Placed) -> np.ndarray:
        """Pull-out forces, (m,), N."""
        left = np.clip(0.5 + self._behind(state), 0.0, 1.0)
        left /= np.clip(0.5 + self._to_ends, 0.0, 1.0)
        there = np.maximum(left.prod(axis=(1, 2)), TRACE)
        crossings = self._yarns.prod() * self._share * there
        if not self._coefficient:
            return crossings * self._force
        none = np.zeros(self._cruciforms.arm_length.shape)
        tension = self._arms.on(none, self._arms.tensions(state))[self.at]
        mean = np.maximum(0.5 * (tension[:, :2] + tension[:, 2:]), 0.0) / self._yarns
        return crossings * (self._force + self._coefficient * mean.mean(axis=1))

    def lagged(self, state: Placed) -> tuple[dict[str, np.ndarray], float, float]:
        """See Item.lagged."""
        old = self._memory(state)
        c = self._cruciforms
        sine = np.sin(c.shear_angles(c.arms(state)[1]))[self.at]
        limit = self.limits(state)
        change = abs(limit - old["limit"]) + limit * abs(sine - old["sine"])
        memory = {**old, "limit": limit, "sine": sine}
        return memory, float(change.sum()), float(limit.sum())

    def accepted(self, state: Placed) -> dict[str, np.ndarray]:
        """See Item.accepted: anchors follow what has slid; ``spent``: what that took, J."""
        memory = self.lagged(state)[0]
        slid = self.slid(state)
        gap = slid - memory["anchor"]
        d = _across(gap, memory["sine"])[1]
        keep = np.minimum(1.0, self.elastic / np.maximum(d, 1e-300))
        spent = memory["spent"] + memory["limit"] * np.maximum(d - self.elastic, 0.0)
        # To the last digit where nothing has slid.
        anchor = np.where((keep < 1.0)[:, None], slid - keep[:, None] * gap, memory["anchor"])
        return memory | {"anchor": anchor, "spent": spent}

    def fields(self, state: Placed) -> dict[str, np.ndarray]:
        """How far warp and weft have slid (m, 2) [m], energies stored and spent by then (m,) [J].

        And whether their ends have slid through, (m, 2). Of an accepted state.
        """
        energy = np.concatenate([self.work(state, ENERGY, r)[0][:, 0] for r in self.chunks()])
        arms = [self._arms.work(state, ENERGY, r)[0][:, 1] for r in self._arms.chunks()]
        crowded = np.bincount(self._arms.row, np.concatenate(arms), len(self._cruciforms.rows))
        return {
            "slip": self.slid(state),
            "slip_energy": energy + crowded[self.at],
            "slip_spent": self._memory(state)["spent"],
            "slid_out": np.any(self._behind(state) < 0.0, axis=2),
        }


def _metric(sine: np.ndarray) -> np.ndarray:
    """Of ways that warp and weft slide, (m, 2, 2)."""
    metric = np.tile(np.eye(2), (len(sine), 1, 1))
    metric[:, 0, 1] = metric[:, 1, 0] = -sine
    return metric


def _across(gap: np.ndarray, sine: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The metric times ways (m, 2) that warp and weft have slid, and how far over each other."""
    along = np.einsum("mij,mj->mi", _metric(sine), gap)
    return along, np.sqrt(np.maximum((gap * along).sum(axis=1), 0.0))
