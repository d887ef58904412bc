# SPDX-License-Identifier: MIT
"""Two plies that lie on each other: compaction, and friction that remembers where on the cloth.

Each crossover of one ply touches the smooth surface of the other (net.patches), and those of the
other touch the one's: each with half of its area, so that neither is master. They touch at a
distance of the mean of their thicknesses, and are compacted, and rub, as by a tool (items.contact).
Which side is which is known from the order of the plies.

Which patch a crossover lies on, and how much of its area lies within the other's outline, is taken
as given while equilibrium is sought, and brought up to date until it no longer matters (`lagged`).
Patches go on smoothly beyond their rims. (Distances along the normals of the last look, in place of
least distances, lack the stiffness q d against tilting: equilibria went to and fro.) Anchors of
friction are places on the other cloth, as the numbers p, q of its patches: they go with it however
it deforms.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from ..elements.level import FORCE, STIFFNESS
from ..elements.rigid import rubbed
from ..elements.touch import closest, shares, touch
from ..net.patches import Patches
from .contact import along, compaction
from .item import Item, Placed, Work
from .nodes import PlyNodes

NOWHERE = -(2**40)  # number of no patch
HOPS = 8  # from patch to patch, to the one that a place lies on
LIKE = 0.1  # coefficient of friction: forces on wrong patches count as those of friction would


class Face:
    """A ply as others see it. Collective.

    Parameters
    ----------
    ply : PlyNodes
        In space.
    at : int32 (n_local of the ply,)
        The model's local numbers of its local nodes.

    Attributes
    ----------
    patches : Patches
    rows : int (m,)
        This rank's crossovers that touch: those that carry.
    area : float (m,)
        Of cloth at rest that each stands for, m^2.
    """

    def __init__(self, ply: PlyNodes, at: np.ndarray):
        self.ply, self.at = ply, at
        self.patches = Patches(ply.network, ply.nodes)
        self.rows = np.flatnonzero(ply.supports.carrying)
        self.area = ply.network.quadrant_area[self.rows].sum(axis=1)
        self._tree: tuple[np.ndarray | None, cKDTree | None] = (None, None)

    def tree(self, x: np.ndarray) -> cKDTree:
        """Middles of its patches, as a tree to look for the nearest in; x is the model's."""
        if self._tree[0] is not x:
            self._tree = (x, cKDTree(self.patches.middles(x[self.at])))
        return self._tree[1]


@dataclass(frozen=True)
class _Seen:
    """What crossovers (m,) see of the other ply; NaN where they see none.

    number: of the patch; place: p, q; distance: on the right side, m; normal: to that side, in the
    lab; share: of the area, that lies within the other's outline.
    """

    number: np.ndarray
    place: np.ndarray
    distance: np.ndarray
    normal: np.ndarray
    share: np.ndarray


@dataclass(frozen=True)
class _Elements:
    """Crossovers that have a patch: rows, nodes and shares of what they are made of."""

    rows: np.ndarray
    nodes: np.ndarray
    weight: np.ndarray  # (m, 9, k)
    anchored: np.ndarray  # (m, 5 + 2 k), of friction's gap to the anchor; (m, 0) without friction


class Between(Item):
    """Crossovers of one ply on the surface of another.

    Parameters
    ----------
    name : str
    one, other : Face
    side : float
        1 where the one lies on the side of warp times weft of the other, -1 on the other side.
    offset : float
        Distance of their middles at which they touch, m.
    reach : float
        So much farther away they are looked after, m.
    stiffness : float
        k of compaction between the two middles, N/m^3.
    width, friction, slip : float
        See items.contact.
    """

    modes = ("contact", "friction")
    lags = True
    patience = 60  # crossovers slide off the patches that they lay on

    def __init__(
        self, name, one: Face, other: Face, side, offset, reach, stiffness, width, friction, slip
    ):
        self.name, self.one, self.other, self.side = name, one, other, side
        self.offset, self.reach, self.stiffness, self.width = offset, reach, stiffness, width
        self.friction, self.slip = friction, slip
        rows = one.rows
        self.nodes = one.at[one.ply.nodes.of_hinge[rows]][:, None].astype(np.int32)
        self._points = one.at[one.patches.points[rows]].astype(np.int32)
        self._alpha = one.patches.shares
        self.area = 0.5 * one.area
        pitch = other.ply.network.pitch
        self._fade = 0.5 * float(pitch.min())
        self._far = float(np.hypot(*pitch)) + offset + reach  # of a nearest middle, loosely
        self._last: tuple = (None, None, None)

    # -- what is where ---------------------------------------------------------------------------

    def _look(self, state: Placed) -> _Seen:
        """What crossovers see at a state."""
        x, patches = state.x, self.other.patches
        m = len(self.nodes)
        point = np.einsum("j,mji->mi", self._alpha, x[self._points])
        number = np.full((m, 2), NOWHERE, np.int64)
        place, normal = np.full((m, 2), np.nan), np.full((m, 3), np.nan)
        distance, share = np.full(m, np.nan), np.zeros(m)
        if not m or not len(patches.number):
            return _Seen(number, place, distance, normal, share)
        near, nearest = self.other.tree(x).query(point, distance_upper_bound=self._far)
        rows = np.flatnonzero(np.isfinite(near))
        patch: np.ndarray = np.asarray(nearest[rows], np.int64)
        uv = np.zeros((len(rows), 2))
        todo: np.ndarray = np.arange(len(rows))
        for _ in range(HOPS):
            uv[todo], distance[rows[todo]], normal[rows[todo]] = self._closest(
                point[rows[todo]], x, patch[todo]
            )
            hop = np.nan_to_num(np.floor(uv[todo] + 0.5)).astype(np.int64)
            beyond = np.flatnonzero(hop.any(axis=1))
            there = patches.find(patches.number[patch[todo[beyond]]] + hop[beyond])
            todo, there = todo[beyond[there >= 0]], there[there >= 0]
            if not len(todo):
                break
            patch[todo] = there
        found = patches.number[patch]
        distance *= self.side
        normal *= self.side
        depth = self.offset - distance[rows]
        lost = np.isnan(uv[:, 0]) | (abs(uv) > 1.5).any(axis=1)
        lost |= (depth < -self.reach) | (depth > self.offset + self.reach)
        number[rows], place[rows] = found, found + uv
        outside = patches.covers(place[rows])
        share[rows] = np.clip(1.0 - outside / self._fade, 0.0, 1.0)
        gone = np.ones(m, bool)
        gone[rows[~(lost | (share[rows] == 0.0))]] = False
        number[gone], place[gone], share[gone] = NOWHERE, np.nan, 0.0
        distance[gone], normal[gone] = np.nan, np.nan
        return _Seen(number, place, distance, normal, share)

    def _closest(self, point: np.ndarray, x: np.ndarray, patch: np.ndarray):
        """Place on patches (m,), distance and normal, of points (m, 3)."""
        patches = self.other.patches
        uv, distance, normal = np.zeros((len(patch), 2)), np.zeros(len(patch)), np.zeros_like(point)
        nodes = self.other.at[patches.nodes[patch]]
        closest(point, x[nodes], patches.weight[patch], uv, distance, normal)
        return uv, distance, normal

    def _elements(self, state: Placed) -> _Elements:
        """What the memory of a state says there is."""
        memory = state.memory.get(self.name, {})
        number, anchor = memory.get("patch"), memory.get("anchor")
        if self._last[2] is None or number is not self._last[0] or anchor is not self._last[1]:
            self._last = (number, anchor, self._gathered(number, anchor))
        return self._last[2]

    def _gathered(self, number: np.ndarray | None, anchor: np.ndarray | None) -> _Elements:
        patches, at = self.other.patches, self.other.at
        k = patches.nodes.shape[1]
        known = np.full(len(self.nodes), -1) if number is None else patches.find(number)
        rows = np.flatnonzero(known >= 0)
        patch = known[rows]
        parts = [self._points[rows], at[patches.nodes[patch]]]
        weight, anchored = patches.weight[patch], np.zeros((len(rows), 0))
        if anchor is not None:
            held = ~np.isnan(anchor[rows, 0])
            place = np.where(held[:, None], anchor[rows], patches.number[patch])
            middle = np.floor(place + 0.5).astype(np.int64)
            under = patches.find(middle)
            away = under < 0  # beyond the rim, as the place itself: that patch goes on
            under[away], middle[away] = patch[away], patches.number[patch[away]]
            value = np.zeros((len(rows), k))
            shares(place - middle, patches.weight[under], value)
            parts.append(at[patches.nodes[under]])
            anchored = np.hstack(
                [np.tile(self._alpha, (len(rows), 1)), np.zeros((len(rows), k)), -value]
            )
        nodes = np.hstack(parts).astype(np.int32)
        return _Elements(rows, nodes, weight, anchored)

    def joined(self, state: Placed) -> np.ndarray:
        """See Item.joined."""
        return self._elements(state).nodes

    def work(self, state: Placed, level: int, rows=slice(None), before=None) -> Work:
        """See Item.work."""
        elements, memory = self._elements(state), state.memory.get(self.name, {})
        nodes, of = elements.nodes[rows], elements.rows[rows]
        m, p = nodes.shape
        known = 5 + elements.weight.shape[2]
        energy = np.zeros((m, 2))
        force = np.zeros((m if level >= FORCE else 0, p, 3))
        stiffness = np.zeros((m if level >= STIFFNESS else 0, p, 3, p, 3))
        if not m:
            return energy, force, stiffness
        x = state.x[nodes]
        area = (self.area * memory["share"])[of]
        touch(
            x[:, :known], self._alpha, elements.weight[rows], memory["uv"][of],
            self.side, area, self.offset, self.stiffness, self.width,
            level, energy[:, 0], force, stiffness,
        )  # fmt: skip
        if self.friction:
            at = np.flatnonzero((memory["pressed"][of] > 0.0) & ~np.isnan(memory["anchor"][of, 0]))
            c = elements.anchored[rows][at]
            gap = np.einsum("mj,mji->mi", c, x[at])
            limit = self.friction * memory["pressed"][of[at]]
            normal = memory["normal"][of[at]]
            energy[at, 1], pull, plane = rubbed(gap, normal, limit, self.slip, level)
            if level >= FORCE:
                force[at] += c[:, :, None] * pull[:, None]
            if level >= STIFFNESS:
                stiffness[at] += np.einsum("mj,mil,mk->mjikl", c, plane, c)
        return energy, force, stiffness

    # -- memory ----------------------------------------------------------------------------------

    def _pressed(self, distance: np.ndarray, share: np.ndarray) -> np.ndarray:
        """Normal forces at distances (m,), N."""
        depth = np.nan_to_num(self.offset - distance)
        return self.area * share * compaction(depth, self.stiffness, self.width)[1]

    def lagged(self, state: Placed) -> tuple[dict[str, np.ndarray], float, float]:
        """See Item.lagged: patches and shares, and of friction forces, normals, new anchors."""
        seen, old = self._look(state), state.memory.get(self.name)
        pressed = self._pressed(seen.distance, seen.share)
        change = LIKE * float(abs(pressed - self._as_given(state)).sum())
        size = max(self.friction, LIKE) * float(pressed.sum())
        memory = {
            "patch": seen.number, "uv": np.nan_to_num(seen.place - seen.number),
            "share": seen.share, "normal": np.nan_to_num(seen.normal),
        }  # fmt: skip
        if not self.friction:
            return memory, change, size
        m, nowhere = len(pressed), np.full((len(pressed), 2), np.nan)
        old = old or {
            "anchor": nowhere, "pressed": np.zeros(m), "spent": np.zeros(m), "slid": np.zeros(m),
            "place": nowhere, "gap": np.zeros(m), "fresh": np.ones(m, bool),
        }  # fmt: skip
        change += self.friction * float(abs(pressed - old["pressed"]).sum())
        anchor = old["anchor"].copy()
        anew = (old["fresh"] | np.isnan(anchor[:, 0])) & (pressed > 0.0)
        depth = np.maximum(self.offset - seen.distance, 0.0)
        way = old["gap"] / np.maximum(old["gap"] + depth, 1e-300)
        before = np.where(np.isnan(old["place"]), seen.place, old["place"])
        touched = before + way[:, None] * (seen.place - before)
        anchor[anew] = touched[anew]
        kept = {key: old[key] for key in ("spent", "slid", "place", "gap", "fresh")}
        return memory | {"anchor": anchor, "pressed": pressed} | kept, change, size

    def _as_given(self, state: Placed) -> np.ndarray:
        """Normal forces of crossovers (m,) on the patches that the state's memory names, N."""
        elements, forces = self._elements(state), np.zeros(len(self.nodes))
        if not len(elements.rows):
            return forces
        rows, memory = elements.rows, state.memory[self.name]
        x, known = state.x[elements.nodes], 5 + elements.weight.shape[2]
        area, energy = (self.area * memory["share"])[rows], np.zeros(len(rows))
        force = np.zeros((len(rows), known, 3))
        touch(
            x[:, :known], self._alpha, elements.weight, memory["uv"][rows],
            self.side, area, self.offset, self.stiffness, self.width,
            FORCE, energy, force, np.zeros((0, 1, 3, 1, 3)),
        )  # fmt: skip
        forces[rows] = np.linalg.norm(force[:, :5].sum(axis=1), axis=1)
        return forces

    def accepted(self, state: Placed) -> dict[str, np.ndarray]:
        """See Item.accepted: anchors follow what has slipped; what lets go forgets its anchor."""
        memory, seen = self.lagged(state)[0], self._look(state)
        if not self.friction:
            return memory
        gap = self._gap(state, memory)
        s = along(np.nan_to_num(gap), memory["normal"])[1]
        keep = np.minimum(1.0, self.slip / np.maximum(s, 1e-300))
        slid, touches = np.maximum(s - self.slip, 0.0), memory["pressed"] > 0.0
        memory["spent"] = memory["spent"] + self.friction * memory["pressed"] * slid
        memory["slid"] = memory["slid"] + np.where(touches, slid, 0.0)
        moved = seen.place - keep[:, None] * (seen.place - memory["anchor"])
        anchor = np.where((s > self.slip)[:, None], moved, memory["anchor"])
        memory["anchor"] = np.where(touches[:, None], anchor, np.nan)
        gap = np.maximum(np.nan_to_num(seen.distance - self.offset), 0.0)
        return memory | {"place": seen.place, "gap": gap, "fresh": ~touches}

    def _gap(self, state: Placed, memory: Mapping[str, np.ndarray]) -> np.ndarray:
        """Ways (m, 3) from anchors that a memory names to crossovers, NaN where there is none."""
        elements = self._gathered(memory["patch"], memory["anchor"])
        gap = np.full((len(self.nodes), 3), np.nan)
        value = np.einsum("mj,mji->mi", elements.anchored, state.x[elements.nodes])
        gap[elements.rows] = value
        gap[np.isnan(memory["anchor"][:, 0])] = np.nan
        return gap

    def broken(self, state: Placed) -> tuple[np.ndarray, str, str] | None:
        """See Item.broken: what has slid to where this rank does not know the other ply."""
        comm = self.one.ply.comm
        if comm.size == 1:
            return None
        place = self._look(state).place
        rows = np.flatnonzero(~np.isnan(place[:, 0]))
        lies = np.floor(place[rows] + 0.5).astype(np.int64)
        rows = rows[self.other.patches.elsewhere(lies)]
        found = self.one.ply.nodes.rest[self.one.ply.nodes.of_hinge[self.one.rows[rows[:1]]]]
        for there in comm.allgather(found.tolist()):
            if there:
                what = "plies have slid too far over each other for so many processes"
                return np.array(there[0]), "APART", what
        return None

    def fields(self, state: Placed) -> dict[str, np.ndarray]:
        """Distance between the faces [m], NaN where far, pressure [Pa], the way slid [m]; (m,)."""
        seen = self._look(state)
        depth = np.nan_to_num(self.offset - seen.distance)
        pressure = seen.share * compaction(depth, self.stiffness, self.width)[1]
        slid = state.memory.get(self.name, {}).get("slid", np.zeros(len(pressure)))
        return {"distance": seen.distance - self.offset, "pressure": pressure, "slip": slid}
