# SPDX-License-Identifier: MIT
"""What is measured on a formed blank: draw-in, shear, contact, yarns in space."""

from __future__ import annotations

import re
from collections.abc import Mapping
from itertools import combinations, product

import numpy as np
import shapely

from ..equilibrium.state import State
from ..net.lattice import SHORTEST_ARM
from ..parallel import least, most, quantile
from ..quantities import length
from .blank import Blank, push_name

MOST_EDGES = 8  # of an outline with more, all are told as one
DEEPEST = 2.0  # times the thickness: no cloth yields as much on one side
OPPOSED = -0.5  # product of the normals of two tools with the cloth between them
SIDES = ("lower", "upper", "left", "right")


class DrawIn:
    """How far the blank's edges have moved inwards in plan, by edge. Collective.

    Parameters
    ----------
    blank : Blank

    Attributes
    ----------
    edges : list of str
        Straight sides and a user's edges by their names, other pieces of the outline by number;
        none in planes of symmetry.
    """

    def __init__(self, blank: Blank):
        self.blank, network = blank, blank.network
        edges = network.preform.edges
        sides = {name: edges[name] for name in SIDES if name in edges}
        named = sides | {
            name: segments
            for name, segments in edges.items()
            if name not in SIDES and not re.fullmatch(r"(outline|hole)-\d+", name)
        }
        known = {segment.tobytes() for segments in named.values() for segment in segments}
        sides = {name: sides[name] for name in sides if name not in blank.symmetry}
        named = {name: named[name] for name in named if name not in blank.symmetry}
        pieces = {
            name: segments
            for name, segments in edges.items()
            if name.startswith("outline-") and segments.tobytes() not in known
        }
        told = named | pieces
        if len(told) > MOST_EDGES:
            own = {name: segments for name, segments in named.items() if name not in sides}
            told = own | {"outline": np.concatenate([*sides.values(), *pieces.values()])}
        ends = np.flatnonzero(network.node_is_boundary[: network.num_nodes_owned])
        points = shapely.points(network.node_position[ends])
        self._nodes: dict[str, tuple[np.ndarray, np.ndarray]] = {}
        for name, segments in told.items():
            # (nodes, segments): a handful of segments, and the nodes along the outline.
            distance = shapely.distance(points[:, None], shapely.linestrings(segments))
            near = distance.min(axis=1, initial=np.inf) <= SHORTEST_ARM * network.pitch.max()
            along = segments[:, 1] - segments[:, 0]
            inward = along[:, ::-1] * (-1.0, 1.0) / np.linalg.norm(along, axis=1)[:, None]
            self._nodes[name] = ends[near], inward[distance[near].argmin(axis=1)]
        self.edges = list(told)

    def largest(self, state: State) -> dict[str, float]:
        """Of each edge's yarn ends the largest draw-in, m. Collective."""
        blank = self.blank
        moved = blank.ply.displacement(blank.of_cloth(state))[1]
        return {
            name: most(blank.comm, (moved[nodes, :2] * inward).sum(axis=1))
            for name, (nodes, inward) in self._nodes.items()
        }


def outline(blank: Blank, state: State) -> np.ndarray:
    """Yarn ends along the outline, on rank 0; none on other ranks. Collective.

    Returns
    -------
    float (n, 6)
        Number of the ring (0 the exterior, then the holes), x and y of the flat blank, and x, y, z
        now, m; along each ring, the cloth on the left.
    """
    network = blank.network
    moved = blank.ply.displacement(blank.of_cloth(state))[1]
    ends = np.flatnonzero(network.node_is_boundary[: network.num_nodes_owned])
    rest, polygon = network.node_position[ends], network.preform.outline
    points, rows = shapely.points(rest), []
    for number, ring in enumerate((polygon.exterior, *polygon.interiors)):
        near = shapely.distance(ring, points) <= SHORTEST_ARM * network.pitch.max()
        place = np.pad(rest[near], ((0, 0), (0, 1)), constant_values=blank.height)
        along = shapely.line_locate_point(ring, points[near])
        kind = np.full(len(along), number)
        rows.append(np.column_stack([kind, along, rest[near], place + moved[ends[near]]]))
    gathered = blank.comm.gather(np.concatenate(rows))
    table = np.zeros((0, 7)) if gathered is None else np.concatenate(gathered)
    return table[np.lexsort(table[:, 1::-1].T)][:, [0, 2, 3, 4, 5, 6]]


def contact_fields(blank: Blank, state: State) -> dict[str, np.ndarray]:
    """Pressure and distances at the cloth's local nodes; NaN where nothing can touch. Collective.

    Returns
    -------
    dict of float (n_local,)
        "pressure" of all tools, Pa; "distance to TOOL", m, between the cloth's face and the tool,
        negative where the cloth is compacted; "slip on TOOL", m, the way slid along it.
    """
    nodes = blank.ply.nodes
    fields: dict[str, np.ndarray] = {}
    pressure = np.zeros(len(blank.touching))
    for contact in blank.contacts:
        found = contact.fields(state)
        pressure += found["pressure"]
        fields[f"distance to {contact.name}"] = found["distance"]
        fields[f"slip on {contact.name}"] = found["slip"]
    spread = {}
    for name, values in {"pressure": pressure, **fields}.items():
        wide = np.full(nodes.num_nodes_local, np.nan)
        wide[blank.touching] = values
        spread[name] = nodes.halo.forward(wide)
    return spread


def penetration(blank: Blank, state: State) -> float:
    """How deep the cloth is compacted by a tool at most, m: 0 if nothing touches. Collective."""
    depths = [
        -least(blank.comm, contact.fields(state)["distance"], 0.0)
        for contact in blank.contacts
        if state.factors.get(contact.name, 1.0) == 1.0
    ]
    return max(depths, default=0.0)


def squeezed(blank: Blank, state: State) -> tuple[str, str, np.ndarray, int] | None:
    """Of the plies the first that no cloth could bear, see `_squeezed`. Collective."""
    return next(filter(None, (_squeezed(one, state) for one in blank.each)), None)


def between_plies(blank: Blank, state: State) -> dict[str, dict[str, float]]:
    """Largest compaction [m] and pressure [Pa] between plies that touch, and the way slid [m].

    By which crossovers are looked at, "UPPER on LOWER" and the other way; of their middles, so that
    both plies' faces have a half of it. Collective.
    """
    figures = {}
    for item in blank.between:
        found, comm = item.fields(state), blank.comm
        deep = -least(comm, np.nan_to_num(found["distance"], nan=1.0), 0.0)
        if deep > 0.0:
            figures[item.name] = {
                "compaction": deep,
                "pressure": most(comm, found["pressure"], 0.0),
                "slip": most(comm, found["slip"], 0.0),
            }
    return figures


def _squeezed(blank: Blank, state: State) -> tuple[str, str, np.ndarray, int] | None:
    """What of tools no cloth could bear: words, reason, place (3,) at rest, number of nodes.

    A tool lies deeper in it than any would yield ("PIERCED"), or two that no force has moved there
    leave no room between them ("CLOSED"); the worst of them, or None. Not of tools on their way
    out, through which cloth springs back. Collective.
    """
    looks, rest = _looks(blank, state), blank.ply.nodes.rest[blank.touching]
    deepest = (DEEPEST - 0.5) * blank.thickness  # of the middle of the cloth in a tool
    beyond: dict[tuple[str, ...], np.ndarray] = {
        (name,): -distance - deepest for name, (distance, _) in looks.items()
    }
    for pair, room in _rooms(looks, blank.thickness).items():
        if not any(state.factors.get(push_name(*push)) for push in product(pair, range(3))):
            beyond[pair] = -room
    found = []
    for names, depth in beyond.items():
        if len(depth) and depth.max() > 0.0:
            at = int(depth.argmax())
            found.append((float(depth[at]), names, rest[at].tolist(), int((depth > 0.0).sum())))
    everywhere = [one for ours in blank.comm.allgather(found) for one in ours]
    if not everywhere:
        return None
    depth, names, place, _ = max(everywhere)
    count = sum(number for _, others, _, number in everywhere if others == names)
    thick = f"the cloth, which is {length(blank.thickness)} thick"
    if len(names) == 2:
        words = f'tools "{names[0]}" and "{names[1]}" leave no room for {thick}'
        return words, "CLOSED", np.array(place), count
    deep = length(float(depth + DEEPEST * blank.thickness))
    return f'tool "{names[0]}" lies {deep} deep in {thick}', "PIERCED", np.array(place), count


def narrowest(blank: Blank, state: State, near: np.ndarray) -> tuple[float, tuple[str, str]] | None:
    """Least room between two tools at nodes ``near`` (n touching,) that both press [m], and which.

    Collective.
    """
    rooms = _rooms(_looks(blank, state), blank.thickness)
    found = {names: least(blank.comm, room[near]) for names, room in rooms.items()}
    names = min(found, key=lambda names: found[names], default=None)
    return None if names is None or np.isinf(found[names]) else (found[names], names)


def _looks(blank: Blank, state: State) -> dict[str, tuple[np.ndarray, np.ndarray]]:
    """Distance from the middle of the cloth and normal in the lab, of each tool that is there."""
    looks = {}
    for contact in blank.contacts:
        if state.factors.get(contact.name, 1.0) == 1.0:  # one on its way out bears nothing for long
            distance, normal, _ = contact.surface.look(contact.local(state))
            looks[contact.name] = distance, normal @ contact.turn(state).T
    return looks


def _rooms(looks: Mapping, thickness: float) -> dict[tuple[str, str], np.ndarray]:
    """Room between two tools at nodes that both touch from opposite sides, m; else infinite."""
    rooms = {}
    for one, other in combinations(looks, 2):
        (d, n), (e, m) = looks[one], looks[other]
        between = ((n * m).sum(axis=1) < OPPOSED) & (np.maximum(d, e) < 0.5 * thickness)
        rooms[one, other] = np.where(between, d + e, np.inf)
    return rooms


def shear_figures(blank: Blank, fields: Mapping[str, np.ndarray]) -> dict[str, float]:
    """Largest shear angle of the crossovers that carry load, and the one 99 % of them keep to, deg.

    Collective.
    """
    angle = np.rad2deg(abs(fields["shear_angle"][fields["carrying"]]))
    return {
        "shear_max_deg": most(blank.comm, angle, 0.0),
        "shear_p99_deg": quantile(blank.comm, angle, 0.99),
    }


def yarn_directions(blank: Blank, state: State) -> tuple[np.ndarray, np.ndarray]:
    """Unit vectors along warp and weft in space at this rank's crossovers, two (n_owned, 3).

    Means of the two arms of a yarn; NaN where a crossover carries nothing.
    """
    cruciforms = blank.ply.cruciforms
    t = cruciforms.arms(blank.of_cloth(state))[1]
    wide = np.full((2, blank.network.num_crossovers_owned, 3), np.nan)
    for family in (0, 1):
        along = t[:, family] - t[:, family + 2]
        wide[family, cruciforms.rows] = along / np.linalg.norm(along, axis=1)[:, None]
    return wide[0], wide[1]


def across(warp: np.ndarray, weft: np.ndarray) -> np.ndarray:
    """Unit vectors across yarns (n, 3), along warp times weft; NaN where there are none."""
    normal = np.cross(warp, weft)
    return normal / np.linalg.norm(normal, axis=1)[:, None]
