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

from collections.abc import Iterator
from copy import copy
from typing import Protocol

import numpy as np

from ..elements.level import FORCE, room
from ..elements.rigid import nearby, press
from .item import Item, Placed, Work

CHUNK = 16384


class Surface(Protocol):
    """What contact knows of a tool, see tools."""

    cell: float
    reach: float

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
        # Where nodes were looked at, and how far they may move without being looked at again.
        self._seen: np.ndarray = np.zeros((len(self.nodes), 3))
        self._room: np.ndarray = np.zeros(len(self.nodes))

    def of(self, rows: slice) -> Contact:
        """Some of its nodes, to look at their `fields`; what is remembered is of all."""
        part: Contact = copy(self)
        part.nodes, part.area, part.offset = self.nodes[rows], self.area[rows], self.offset[rows]
        part._of = rows
        part._seen, part._room = self._seen[rows].copy(), self._room[rows].copy()
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
        nodes, turn, memory = self.nodes[rows], self.turn(state), state.memory.get(self.name, {})
        energy, force, stiffness = room(len(nodes), 2, 2, 3, level)
        y, number = np.empty((len(nodes), 3)), np.empty(len(nodes), np.int64)
        seen, free = self._seen[rows], self._room[rows]
        near = number[: nearby(state.x, nodes, turn, seen, free, y, number)]
        look = self.surface.look(y[near])
        seen[near], free[near] = y[near], self._free(look[0], self.offset[rows][near])
        rubs = self.friction > 0.0 and len(memory) > 0
        pressed, anchor, normal = (
            memory[key][rows] if rubs else np.zeros(shape)
            for key, shape in (("pressed", 0), ("anchor", (0, 3)), ("normal", (0, 3)))
        )
        press(
            y, turn, near, *look, self.area[rows], self.offset[rows],
            self.stiffness * state.factors.get(self.name, 1.0), self.width,
            pressed, anchor, normal, self.friction, self.slip, level, energy, force, stiffness,
        )  # fmt: skip
        return energy, force, stiffness

    def _free(self, distance: np.ndarray, offset: np.ndarray) -> np.ndarray:
        """How far nodes can move, whichever way, before they may touch, m; 0 of those that do.

        Distances never grow faster than the way. Those to a surface that is known on a grid are not
        that exact, and not known beyond its reach.
        """
        gap = np.minimum(distance, self.surface.reach) - offset - 2.0 * self.surface.cell
        return np.maximum((0.5 if self.surface.cell else 0.999) * gap, 0.0)

    def _compacted(self, state: Placed, depth: np.ndarray):
        """See compaction, at depths (n,) in the tool, which may be on its way out."""
        return compaction(depth, self.stiffness * state.factors.get(self.name, 1.0), self.width)

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


def along(gap: np.ndarray, normal: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The part of vectors (m, 3) across normals (m, 3), along the tool, and its length (m,)."""
    gap = gap - (gap * normal).sum(axis=1)[:, None] * normal
    return gap, np.linalg.norm(gap, axis=1)
