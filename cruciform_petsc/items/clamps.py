# SPDX-License-Identifier: MIT
"""Clamps along edges: yarn ends tied to the ground by springs, which may slip."""

from __future__ import annotations

import numpy as np
import shapely

from ..elements.level import FORCE, STIFFNESS, room
from .item import Item, Placed, Work
from .nodes import PlyNodes

HELD = 1e3  # times as stiff as its yarn's last arm is what holds a yarn end that has no spring


class Clamp(Item):
    """Yarn ends of an edge tied to points of the ground, in place but free to turn.

    A node at the distance s from its point, its *anchor*, is pulled there by k s, at most F:

        psi = k s^2 / 2  for k s < F,  F (s - F / (2 k)) beyond

    When a state is accepted anchors follow nodes that are farther away than F/k, to that distance,
    as those of friction do (items.contact). A preload P moves anchors outwards by P/k. The factor
    of `clamp_name` is what of it still holds, that of `preload_name` how much of the preload is
    there; with it grows the lift of the points, between heights of the edge's ends.

    Parameters
    ----------
    ply : PlyNodes
        In space.
    edge : str
    stiffness, preload, limit : (float, bool), optional
        k, P, F: of the whole edge, N/m or N, or with True per length of it. Without a stiffness it
        is HELD.
    slides : bool
        Held in height only.
    lift : pair of float, optional
        m, at the beginning and the end of the edge, the cloth on its left.

    Attributes
    ----------
    form : float (n_owned, 3) or None
        How far the cloth's nodes may be guessed to go from rest as the edge is raised, m.
    """

    is_load = True
    modes = ("clamps",)

    def __init__(self, ply: PlyNodes, edge: str, stiffness=None, preload=None, limit=None, *,
                 slides: bool = False, lift=None):  # fmt: skip
        self.edge, self.name, self._preload = edge, clamp_name(edge), preload_name(edge)
        network, of_node = ply.network, ply.nodes.of_network_node
        length = ply.constraints.lengths(edge)
        # Springs are those of yarns that leave through the edge; what is held, is held all along.
        ends = ply.constraints.nodes_on(edge) if stiffness is None else np.flatnonzero(length)
        ends = ends[(ends < network.num_nodes_owned) & ply.active[of_node[ends]]]
        at, length, normal = of_node[ends], length[ends], np.zeros((len(ends), 3))
        normal[:, :2] = ply.constraints.outwards(edge, ends)
        whole = ply.comm.allreduce(float(length.sum()))

        def shared(told: tuple[float, bool] | None, default: float) -> np.ndarray:
            if told is None:
                return np.full(len(at), default)
            return told[0] * (length if told[1] else length / whole)

        fabric = network.fabric
        self.stiffness = shared(stiffness, HELD * (fabric.c11 + fabric.c22))
        self.limit = shared(limit, np.inf)
        self.nodes = at[:, None].astype(np.int32)
        self._rest = ply.nodes.rest[at]
        self._outwards = (shared(preload, 0.0) / self.stiffness)[:, None] * normal
        self.form: np.ndarray | None = None
        self._axes = np.array([not slides, not slides, True])
        if lift is not None:
            line = shapely.linestrings(_joined(network.preform.edge(edge)))
            points = shapely.points(network.node_position[ends])
            share = shapely.line_locate_point(line, points, normalized=True)
            self._outwards[:, 2] += lift[0] + (lift[1] - lift[0]) * share

    def _gap(self, state: Placed, rows=slice(None)) -> tuple[np.ndarray, np.ndarray]:
        """From anchors to nodes along what is held, (m, 3), and its length (m,)."""
        anchor = state.memory.get(self.name, {}).get("anchor", self._rest)[rows]
        loaded = state.factors.get(self._preload, 1.0)
        gap = state.x[self.nodes[rows, 0]] - anchor - loaded * self._outwards[rows]
        gap = gap * self._axes
        return gap, np.linalg.norm(gap, axis=1)

    def work(self, state: Placed, level: int, rows=slice(None), before=None) -> Work:
        """See Item.work."""
        held = state.factors.get(self.name, 1.0)
        gap, s = self._gap(state, rows)
        k, limit = self.stiffness[rows], self.limit[rows]
        energy, force, stiffness = room(len(s), 1, 1, 3, level)
        pull = np.minimum(k * s, limit)
        energy[:, 0] = held * pull * (s - 0.5 * pull / k)
        per_s = held * np.where(k * s > limit, pull / np.maximum(s, 1e-300), k)
        if level >= FORCE:
            force[:, 0] = per_s[:, None] * gap
        if level >= STIFFNESS:
            second = held * np.where(k * s > limit, 0.0, k)
            along = gap / np.maximum(s, 1e-300)[:, None]
            stiffness[:, 0, :, 0] = per_s[:, None, None] * np.diag(self._axes.astype(float))
            stiffness[:, 0, :, 0] += (second - per_s)[:, None, None] * (
                along[:, :, None] * along[:, None, :]
            )
        return energy, force, stiffness

    def carried(self, before: Placed, after: Placed) -> tuple[np.ndarray, np.ndarray] | None:
        """See Item.carried: where a form that was found beforehand puts the cloth."""
        grown = after.factors.get(self._preload, 1.0) - before.factors.get(self._preload, 1.0)
        if self.form is None or grown == 0.0:
            return None
        nodes = np.arange(len(self.form))
        return nodes, before.x[nodes] + grown * self.form

    def accepted(self, state: Placed) -> dict[str, np.ndarray]:
        """See Item.accepted: anchors, how far each node has slipped [m], what that took [J]."""
        memory, none = state.memory.get(self.name, {}), np.zeros(len(self.nodes))
        gap, s = self._gap(state)
        held = state.factors.get(self.name, 1.0)
        slid = np.maximum(s - self.limit / self.stiffness, 0.0) * (held > 0.0)
        anchor = memory.get("anchor", self._rest) + (slid / np.maximum(s, 1e-300))[:, None] * gap
        rubbed = held * slid * np.where(slid > 0.0, self.limit, 0.0)
        return {
            "anchor": anchor,
            "slipped": memory.get("slipped", none) + slid,
            "spent": memory.get("spent", none) + rubbed,
        }


def _joined(segments: np.ndarray) -> np.ndarray:
    """Corners (n + 1, 2) of an edge's segments, one after the other."""
    return np.concatenate([segments[:1, 0], segments[:, 1]])


def clamp_name(edge: str) -> str:
    """Name of the clamp of an edge among items and loads."""
    return f"clamp {edge}"


def preload_name(edge: str) -> str:
    """Name of the size of its preload."""
    return f"preload {edge}"
