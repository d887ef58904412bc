# SPDX-License-Identifier: MIT
"""Cloth that touches a tool: compaction, and friction with a memory of where it stuck.

Contact (forming.md section 1): a node that stands for an area A of cloth and lies p deep, its gap
g = d - t/2 below zero, has the energy A e(p), e' = q, with the pressure

    q = k p^2 / (2 w)  for p < w,  k (p - w/2)  beyond

so that the energy is twice continuously differentiable.

Friction is an incremental potential mu N psi(s) of the distance s, along the tool, from the place
on it where the node stuck (its *anchor*), with the normal force N and the tool's normal there taken
from the state before and brought up to date until it no longer matters (`lagged`):

    psi' = 2 r - r^2  for r = s / s_0 < 1,  1 beyond

with the elastic slip s_0. A node that touches anew is anchored where, on a straight way in the
tool's frame from the last accepted state, it has come to touch. When a state is accepted anchors
follow nodes that lie farther away than s_0, to that distance (return mapping): what sticks does not
creep.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from copy import copy
from typing import Protocol

import numpy as np

from ..elements.level import FORCE, STIFFNESS, room
from .item import Item, Placed, Work

CHUNK = 16384


class Surface(Protocol):
    """What contact knows of a tool, see tools."""

    def look(self, points: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Distance (n,), its gradient (n, 3) and Hessian (n, 3, 3) at points in its frame."""


def compaction(depth: np.ndarray, stiffness: float, width: float):
    """Energy per area, pressure and stiffness at depths (n,): see the module's text."""
    p = np.maximum(depth, 0.0)
    soft = p < width
    over = p - width
    energy = np.where(soft, p**3 / (6 * width), width**2 / 6 + over * width / 2 + over**2 / 2)
    pressure = np.where(soft, p**2 / (2 * width), p - width / 2)
    return stiffness * energy, stiffness * pressure, stiffness * np.where(soft, p / width, 1.0)


class Contact(Item):
    """Nodes of cloth against one rigid tool, which is a node, too: its origin.

    Parameters
    ----------
    name : str
        The tool's.
    surface : Surface
    nodes : int (m,)
        Local nodes of cloth that this rank owns.
    tool : int
        The tool's local node.
    area : float (m,)
        Of cloth at rest that each stands for, m^2.
    offset : float (m,), or of all
        Distance from the surface at which a node touches, m: half the cloth's thickness.
    stiffness : float
        k, N/m^3.
    width : float
        w, m.
    friction : float
        mu.
    slip : float
        s_0, m.
    """

    modes = ("contact", "friction")
    lags = True

    def __init__(self, name, surface, nodes, tool, area, offset, stiffness, width, friction, slip):
        self.name, self.surface = name, surface
        self.nodes = np.column_stack([nodes, np.full(len(nodes), tool)]).astype(np.int32)
        self.tool = tool
        self.area, self.offset = area, np.broadcast_to(offset, len(self.nodes))
        self.stiffness, self.width, self.friction, self.slip = stiffness, width, friction, slip
        self._of = slice(None)

    def of(self, rows: slice) -> Contact:
        """Some of its nodes, to look at their `fields`; what is remembered is of all."""
        part = copy(self)
        part.nodes, part.area, part.offset = self.nodes[rows], self.area[rows], self.offset[rows]
        part._of = rows
        return part

    def chunks(self) -> Iterator[slice]:
        """See Item.chunks."""
        for begin in range(0, max(len(self.nodes), 1), CHUNK):
            yield slice(begin, begin + CHUNK)

    # -- where and how hard ----------------------------------------------------------------------

    def turn(self, state: Placed) -> np.ndarray:
        """How the tool is turned, (3, 3): its frame -> lab."""
        return state.hold.rotations.get(self.name, np.eye(3))

    def local(self, state: Placed, rows=slice(None)) -> np.ndarray:
        """Positions of nodes in the tool's frame, (m, 3)."""
        nodes = self.nodes[rows]
        return (state.x[nodes[:, 0]] - state.x[nodes[:, 1]]) @ self.turn(state)

    def work(self, state: Placed, level: int, rows=slice(None), before=None) -> Work:
        """See Item.work."""
        y, area, memory = self.local(state, rows), self.area[rows], state.memory.get(self.name, {})
        energy, force, stiffness = room(len(y), 2, 2, 3, level)
        d, n, curvature = self.surface.look(y)
        depth = self.offset[rows] - d
        at = np.flatnonzero(depth > 0.0)
        e, q, k = self._compacted(state, depth[at])
        energy[:] = 0.0
        energy[at, 0] = area[at] * e
        f, h = np.zeros((len(y), 3)), np.zeros((len(y), 3, 3) if level >= STIFFNESS else 0)
        if level >= FORCE:
            n, pull = n[at], area[at] * q
            f[at] = -pull[:, None] * n
        if level >= STIFFNESS:
            h[at] = (area[at] * k)[:, None, None] * n[:, :, None] * n[:, None, :]
            h[at] -= pull[:, None, None] * curvature[at]
        if self.friction and memory:
            self._rub(y, {key: value[rows] for key, value in memory.items()}, level, energy, f, h)
        if level >= FORCE:
            force[:, 0] = f @ self.turn(state).T
            force[:, 1] = -force[:, 0]
        if level >= STIFFNESS:
            r = self.turn(state)
            block = r @ h @ r.T
            stiffness[:, 0, :, 0], stiffness[:, 1, :, 1] = block, block
            stiffness[:, 0, :, 1], stiffness[:, 1, :, 0] = -block, -block
        return energy, force, stiffness

    def _compacted(self, state: Placed, depth: np.ndarray):
        """See compaction, at depths (n,) in the tool, which may be on its way out."""
        return compaction(depth, self.stiffness * state.factors.get(self.name, 1.0), self.width)

    def _rub(self, y, memory: Mapping[str, np.ndarray], level, energy, f, h) -> None:
        """Add friction to energy (m, 2), force (m, 3) and stiffness (m, 3, 3), in place."""
        at = np.flatnonzero(memory["pressed"] > 0.0)
        n, limit = memory["normal"][at], self.friction * memory["pressed"][at]
        gap = y[at] - memory["anchor"][at]
        energy[at, 1], pull, plane = rubbed(gap, n, limit, self.slip, level)
        if level >= FORCE:
            f[at] += pull
        if level >= STIFFNESS:
            h[at] += plane

    # -- memory ------------------------------------------------------------------------------------

    def lagged(self, state: Placed) -> tuple[dict[str, np.ndarray], float, float]:
        """See Item.lagged: forces and normals; nodes that touch anew stick where they did."""
        y, old = self.local(state), state.memory.get(self.name)
        if not old:
            nowhere, nothing = np.full_like(y, np.nan), np.zeros(len(y))
            fresh = np.ones(len(y), bool)
            old = {"anchor": nowhere, "pressed": nothing, "spent": nothing, "slid": nothing}
            old |= {"place": y, "fresh": fresh}
        d, normal, _ = self.surface.look(y)
        pressed = self.area * self._compacted(state, self.offset - d)[1]
        change = self.friction * float(abs(pressed - old["pressed"]).sum())
        anchor = old["anchor"].copy()
        at = np.flatnonzero(old["fresh"] & (pressed > 0.0))
        anchor[at] = self._touched(old["place"][at], y[at], d[at], self.offset[at])
        memory = {**old, "anchor": anchor, "normal": normal, "pressed": pressed}
        return memory, change, self.friction * float(pressed.sum())

    def _touched(self, before, y, distance, offset) -> np.ndarray:
        """Where on straight ways to y, in the tool, (n, 3), nodes have come to touch it."""
        gap = np.maximum(self.surface.look(before)[0] - offset, 0.0)
        share = gap / np.maximum(gap + offset - distance, 1e-300)
        return before + share[:, None] * (y - before)

    def accepted(self, state: Placed) -> dict[str, np.ndarray]:
        """See Item.accepted: anchors follow what has slipped; what lets go forgets its anchor."""
        memory, y = self.lagged(state)[0], self.local(state)
        gap, s = along(np.nan_to_num(y - memory["anchor"]), memory["normal"])  # NaN: no anchor
        keep = np.minimum(1.0, self.slip / np.maximum(s, 1e-300))
        moved = y - keep[:, None] * gap
        slid = np.maximum(s - self.slip, 0.0)
        memory["spent"] = memory["spent"] + self.friction * memory["pressed"] * slid
        memory["slid"] = memory["slid"] + np.where(memory["pressed"] > 0.0, slid, 0.0)
        anchor = np.where((s > self.slip)[:, None], moved, memory["anchor"])
        touches = memory["pressed"] > 0.0
        memory["anchor"] = np.where(touches[:, None], anchor, np.nan)
        return memory | {"place": y, "fresh": ~touches}

    def carried(self, before: Placed, after: Placed) -> tuple[np.ndarray, np.ndarray] | None:
        """See Item.carried: nodes that were pressed."""
        tool, turn = self.tool, self.turn(after)
        same = (before.x[tool] == after.x[tool]).all() and (turn == self.turn(before)).all()
        memory = before.memory.get(self.name)
        if same or not memory:
            return None
        at = memory["pressed"] > 0.0
        return self.nodes[at, 0], after.x[tool] + self.local(before)[at] @ turn.T

    def fields(self, state: Placed) -> dict[str, np.ndarray]:
        """Distance of the cloth's face to the tool [m], pressure [Pa], the way slid [m]; (m,)."""
        distance = self.surface.look(self.local(state))[0]
        pressure = self._compacted(state, self.offset - distance)[1]
        slid = state.memory.get(self.name, {}).get("slid")
        slid = np.zeros(len(distance)) if slid is None else slid[self._of]
        return {"distance": distance - self.offset, "pressure": pressure, "slip": slid}

    def moment(self, state: Placed) -> np.ndarray:
        """Moment on the cloth about the tool's origin by this rank's nodes, (3,), N m."""
        moment = np.zeros(3)
        for rows in self.chunks():
            arm = state.x[self.nodes[rows, 0]] - state.x[self.tool]
            force = -self.work(state, FORCE, rows)[1][:, 0]  # the energy's gradient points back
            moment += np.cross(arm, force).sum(axis=0)
        return moment


def rubbed(gap: np.ndarray, normal: np.ndarray, limit: np.ndarray, slip: float, level: int):
    """Friction's energy (n,), force (n, 3) and stiffness (n, 3, 3): see the module's text.

    Gaps (n, 3) to the anchors count across normals (n, 3); ``limit`` (n,) is mu N, ``slip`` s_0.
    """
    gap, s = along(gap, normal)
    r = s / slip
    energy = limit * slip * np.where(r < 1, r**2 - r**3 / 3, r - 1 / 3)
    none = np.zeros((0, 3))
    if level < FORCE:
        return energy, none, none
    # psi'/s, finite where s is zero
    per_s = np.where(r < 1, 2.0 - r, 1.0 / np.maximum(r, 1.0)) / slip * limit
    force = per_s[:, None] * gap
    if level < STIFFNESS:
        return energy, force, none
    second = limit * np.where(r < 1, 2.0 - 2.0 * r, 0.0) / slip
    way = gap / np.maximum(s, 1e-300)[:, None]
    stiffness = per_s[:, None, None] * (np.eye(3) - normal[:, :, None] * normal[:, None, :])
    stiffness += (second - per_s)[:, None, None] * way[:, :, None] * way[:, None, :]
    return energy, force, stiffness


def along(gap: np.ndarray, normal: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The part of vectors (m, 3) across normals (m, 3), along the tool, and its length (m,)."""
    gap = gap - (gap * normal).sum(axis=1)[:, None] * normal
    return gap, np.linalg.norm(gap, axis=1)
