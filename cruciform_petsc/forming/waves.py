# SPDX-License-Identifier: MIT
"""Waves of formed cloth that its tools do not have: wrinkles, and yarns that bridge hollows.

Shear alone tells no wrinkles (forming.md section 3), so their height is measured on the shape. With
x -> Gx a mean over neighbours, Gaussian, of standard deviation s = 0.39 L,

    u = (x - Gx) . n        the cloth over its own mean, n its normal
    w = (g - Gg)/|n . m|    the same of its gap g to a tool, m the tool's normal there

Neighbours are met along yarns, and an end of a yarn keeps its place: so a linear function is its
own mean, and that of a convex one lies above it everywhere. What bends one way only, a cloth on a
sphere, over a fillet, or leaving a tool, has therefore u, or w, of one sign. A wave goes both ways;
its height is

    h = least of |w|, the largest w and the largest -w around

and no more than cloth that waves itself: u - Gu, taken alike. Where several tools lie along the
cloth the least counts, where none does, w is u. A sine of amplitude a and wavelength l has
h = a (1 - exp(-2 (pi s/l)^2))^2, that is 0.9 a for l = L and 0.3 a for l = 2 L.

Yarns bridge a hollow of the closest tool where they do not touch it, it is hollow over the length
s, w - u > 0, and the yarn is bent neither away from it nor by half as much as it. Its gap is told.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass

import numpy as np

from ..equilibrium.state import State
from ..parallel import least, most
from .blank import Blank
from .measures import across, yarn_directions

LONGEST = 0.04  # m: wavelength L up to which waves are measured whole,
LARGE = 0.5  # of the blank's smaller side at most,
COARSE = 4.0  # pitches at least
SPREAD = 0.39  # s/L: leaves 5 % of a wave as long as L in the mean
AROUND = 0.75  # of L: how far a crest looks for a trough, along the yarns
ALONG = 0.5  # n . m of a tool that lies along the cloth,
NEAR = 0.25  # and its gap, of L
NOTICED = 0.25  # of the thickness: from which height on cloth counts as wrinkled
TOUCHING = 0.1  # of the thickness: a gap that is none


class Neighbours:
    """Crossovers that carry, and those joined to them along the yarns. Collective.

    Values are over a ply's local nodes, (n_local, ...); only those at hinges are looked at.
    """

    def __init__(self, blank: Blank, carrying: np.ndarray):
        nodes = blank.ply.nodes
        self.halo, self.pitch = nodes.halo, blank.network.pitch
        after = nodes.after_hinge
        carries = np.zeros(nodes.num_nodes_local, bool)
        carries[nodes.of_hinge] = carrying
        self.halo.forward(carries)
        joined = (after >= 0) & carrying[:, None] & carries[after]
        self._pairs = [(nodes.of_hinge[j], a[j]) for j, a in zip(joined.T, after.T, strict=True)]
        ones = np.ones(nodes.num_nodes_local)
        self.inner = [self.beside(ones, family)[0] == 2.0 for family in (0, 1)]

    def beside(self, values: np.ndarray, family: int) -> tuple[np.ndarray, np.ndarray]:
        """Sum of the values before and after along a family of yarns, and after less before."""
        here, after = self._pairs[family]
        parts = np.zeros((2, *values.shape))  # of before, and of after
        parts[0, after], parts[1, here] = values[here], values[after]
        both = np.moveaxis(parts, 0, 1).copy()
        self.halo.share(both)
        return both[:, 0] + both[:, 1], both[:, 1] - both[:, 0]

    def mean(self, values: np.ndarray, deviation: float) -> np.ndarray:
        """Gaussian mean of values (n_local, k) with a standard deviation, m."""
        values = values.copy()
        steps = np.ceil(2.0 * (deviation / self.pitch) ** 2).astype(int)
        share = 0.5 * (deviation / self.pitch) ** 2 / steps  # (1/4, 1/2, 1/4) at most
        for step in range(steps.max()):
            for family in np.flatnonzero(step < steps):
                at = self.inner[family]
                change = self.beside(values, family)[0] - 2.0 * values
                values[at] += share[family] * change[at]
        return values

    def largest(self, values: np.ndarray, length: float) -> np.ndarray:
        """Largest values (n_local, k) within a length along yarns, m."""
        values = values.copy()
        steps = np.ceil(length / self.pitch).astype(int)
        for step in range(steps.max()):
            for family in np.flatnonzero(step < steps):
                here, after = self._pairs[family]
                wider = values.copy()
                wider[after] = np.maximum(wider[after], values[here])
                wider[here] = np.maximum(wider[here], values[after])
                values = self.halo.share(wider, np.maximum)
        return values


@dataclass(frozen=True)
class Waves:
    """What is found at this rank's crossovers, (n_owned, ...); NaN where they carry nothing.

    Attributes
    ----------
    normal : float (n, 3)
        Warp times weft.
    curvature : float (n, 2)
        Of warp and weft, along the normal, 1/m; NaN at a yarn's end.
    beyond_tool : float (n, 2)
        By how much that is more than the closest tool's, 1/m.
    height : float (n,)
        Of wrinkles, m.
    bridging : float (n,)
        Gap to a hollow that yarns bridge, m; 0 where they do not.
    longest : float
        L, m.
    """

    normal: np.ndarray
    curvature: np.ndarray
    beyond_tool: np.ndarray
    height: np.ndarray
    bridging: np.ndarray
    longest: float

    @classmethod
    def of(cls, blank: Blank, state: State) -> Waves:
        """Measure a state. Collective."""
        cloth, hinge = blank.of_cloth(state), blank.ply.nodes.of_hinge
        carrying = blank.ply.carrying(cloth)
        neighbours = Neighbours(blank, carrying)
        longest = min(LONGEST, LARGE * float(blank.network.preform.size.min()))
        longest = max(longest, COARSE * float(blank.network.pitch.max()))
        s, x = SPREAD * longest, cloth.x
        direction = np.stack(yarn_directions(blank, state))
        curvature_vector = _bent(neighbours, x)[:, hinge]
        curvature_vector -= (curvature_vector * direction).sum(axis=2)[..., None] * direction
        normal = across(direction[0], direction[1])
        tools = list(_tools(blank, state, x[hinge]))

        def wide(columns: np.ndarray) -> np.ndarray:
            values = np.zeros((len(x), columns.shape[1]))
            values[hinge] = columns
            return blank.ply.nodes.halo.forward(np.nan_to_num(values))

        gaps = [tool.gap for tool in tools]
        columns = wide(np.column_stack([x[hinge], *gaps]))
        off = (columns - neighbours.mean(columns, s))[hinge]
        u = (off[:, :3] * np.nan_to_num(normal)).sum(axis=1)
        along = [(tool.normal * normal).sum(axis=1) for tool in tools]
        near = [
            tool.known & (abs(a) >= ALONG) & (tool.gap < NEAR * longest)
            for tool, a in zip(tools, along, strict=True)
        ]
        w = [
            np.where(n, o / np.where(n, abs(a), 1.0), 0.0)
            for n, o, a in zip(near, off[:, 3:].T, along, strict=True)
        ]
        again = wide(u[:, None])
        again = (again - neighbours.mean(again, s))[hinge, 0]
        bridging = np.zeros(len(u))
        touching = TOUCHING * blank.thickness
        nearest = np.min([*gaps, np.full(len(u), np.inf)], axis=0)
        tools_curvature = np.zeros((len(u), 2))
        for k, tool in enumerate(tools):
            hollow = w[k] - np.sign(along[k]) * u
            closest = tool.gap == nearest
            free = near[k] & closest & (np.minimum(tool.gap, hollow) > touching)
            for family in (0, 1):
                bent = (curvature_vector[family] * tool.normal).sum(axis=1)
                spans = free & (bent < hollow / s**2) & (bent > -0.5 * hollow / s**2)
                bridging = np.maximum(bridging, np.where(spans, tool.gap, 0.0))
                curved = np.einsum(
                    "na,nab,nb->n", direction[family], tool.curvature, direction[family]
                )
                tools_curvature[closest, family] = -(curved * np.sign(along[k]))[closest]

        waves = np.column_stack([u, again, *w])
        both = wide(np.column_stack([waves, -waves]))
        both = neighbours.largest(both, AROUND * longest)[hinge]
        goes_both_ways = np.maximum(np.minimum(*np.split(both, 2, axis=1)), 0.0)
        heights = np.minimum(abs(waves), goes_both_ways)
        height = heights[:, 0]
        if tools:
            of_tools = np.where(np.column_stack(near), heights[:, 2:], np.inf).min(axis=1)
            height = np.where(np.isinf(of_tools), height, of_tools)
        height = np.minimum(height, goes_both_ways[:, 1])
        nothing = ~carrying | np.isnan(normal[:, 0])
        height[nothing], bridging[nothing] = np.nan, np.nan
        curvature = (curvature_vector * normal).sum(axis=2).T
        return cls(normal, curvature, curvature - tools_curvature, height, bridging, longest)

    def figures(self, blank: Blank, fields: Mapping[str, np.ndarray]) -> dict[str, dict]:
        """``wrinkles`` and ``bridging`` of a summary. Collective."""
        comm, network = blank.comm, blank.network
        area = network.quadrant_area.sum(axis=1)
        wrinkled = self.height > NOTICED * blank.thickness
        bridged = self.bridging > 0.0
        total = comm.allreduce(np.array([area.sum(), area[wrinkled].sum(), area[bridged].sum()]))
        height, at = max(comm.allgather(_largest(self.height, network.crossover_position)))
        gap, where = max(comm.allgather(_largest(self.bridging, network.crossover_position)))
        strain = np.minimum(fields["warp_strain"], fields["weft_strain"])
        pitch = float(network.pitch.max())
        return {
            "wrinkles": {
                "largest_height_mm": 1e3 * height,
                "at_rest_mm": [1e3 * v for v in at] if height > 0.0 else None,
                "area_share": float(total[1] / total[0]),
                "counted_from_mm": 1e3 * NOTICED * blank.thickness,
                "wavelengths_mm": [4e3 * pitch, 1e3 * self.longest],
                "curvature_beyond_tools_per_m": most(
                    comm, np.nan_to_num(abs(self.beyond_tool[wrinkled])).ravel(), 0.0
                ),
                "yarn_compression_percent": -100.0 * least(comm, strain[wrinkled], 0.0) + 0.0,
            },
            "bridging": {
                "largest_gap_mm": 1e3 * gap,
                "at_rest_mm": [1e3 * v for v in where] if gap > 0.0 else None,
                "area_share": float(total[2] / total[0]),
            },
        }


def _largest(values: np.ndarray, place: np.ndarray) -> tuple[float, list[float]]:
    """The largest of this rank's values (n,), 0 at least, and where it is."""
    if np.isnan(values).all():
        return 0.0, []
    at = int(np.nanargmax(values))
    return float(values[at]), place[at].tolist()


@dataclass(frozen=True)
class _Tool:
    """A tool as points (n,) see it: gap to it, its normal and curvature, whether these hold."""

    gap: np.ndarray
    normal: np.ndarray
    curvature: np.ndarray
    known: np.ndarray


def _tools(blank: Blank, state: State, points: np.ndarray) -> Iterator[_Tool]:
    for contact in blank.contacts:
        turn = contact.turn(state)
        distance, normal, curvature = contact.surface.look((points - state.x[contact.tool]) @ turn)
        reach = getattr(contact.surface, "reach", np.inf)
        yield _Tool(
            distance - 0.5 * blank.thickness,
            normal @ turn.T,
            np.einsum("ia,nab,jb->nij", turn, curvature, turn),
            distance < reach,
        )


def _bent(neighbours: Neighbours, x: np.ndarray) -> np.ndarray:
    """Second derivatives of places along warp and weft at hinges, (2, n_local, 3), 1/m.

    By the crossovers before and after; NaN at a yarn's end.
    """
    curvature = np.full((2, len(x), 3), np.nan)
    for family in (0, 1):
        inner = neighbours.inner[family]
        total, across = neighbours.beside(x, family)
        step_squared = 0.25 * (across[inner] ** 2).sum(axis=1)
        curvature[family, inner] = (total - 2.0 * x)[inner] / step_squared[:, None]
    return curvature
