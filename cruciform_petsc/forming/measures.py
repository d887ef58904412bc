# SPDX-License-Identifier: MIT
"""What is measured on a formed blank: draw-in, shear, contact, yarns in space."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import shapely

from ..equilibrium.state import State
from ..net.lattice import SHORTEST_ARM
from ..parallel import least, most, quantile
from .blank import Blank

MOST_EDGES = 8  # of an outline with more, all are told as one
DEEPEST = 2.0  # times the thickness: no cloth yields as much on one side
SIDES = ("lower", "upper", "left", "right")


class DrawIn:
    """How far the blank's edges have moved inwards in plan, by edge. Collective.

    Parameters
    ----------
    blank : Blank

    Attributes
    ----------
    edges : list of str
        Straight sides by their names, other pieces of the outline by number; none in planes of
        symmetry.
    """

    def __init__(self, blank: Blank):
        self.blank, network = blank, blank.network
        edges = network.preform.edges
        sides = {name: edges[name] for name in SIDES if name in edges}
        known = {segment.tobytes() for segments in sides.values() for segment in segments}
        sides = {name: sides[name] for name in sides if name not in blank.symmetry}
        pieces = {
            name: segments
            for name, segments in edges.items()
            if name.startswith("outline-") and segments.tobytes() not in known
        }
        told = sides | pieces
        if len(told) > MOST_EDGES:
            told = {"outline": np.concatenate(list(told.values()))}
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
        place = np.pad(rest[near], ((0, 0), (0, 1)), constant_values=0.5 * blank.thickness)
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
        negative where the cloth is compacted.
    """
    nodes, fields = blank.ply.nodes, {}
    pressure = np.zeros(len(blank.touching))
    for contact in blank.contacts:
        found = contact.fields(state)
        pressure += found["pressure"]
        fields[f"distance to {contact.name}"] = found["distance"]
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


def pierced(blank: Blank, state: State) -> tuple[str, float, np.ndarray] | None:
    """Which tool lies deeper in the cloth than any cloth could yield, by what, and where at rest.

    A tool, a depth in m and a place (3,), of the deepest; None if there is none. Not of tools on
    their way out, through which cloth springs back. Collective.
    """
    found = []
    for contact in blank.contacts:
        if state.factors.get(contact.name, 1.0) == 1.0 and len(contact.nodes):
            distance = contact.fields(state)["distance"]
            at = int(distance.argmin())
            if distance[at] < -DEEPEST * blank.thickness:
                place = blank.ply.nodes.rest[blank.touching[at]].tolist()
                found.append((float(-distance[at]), contact.name, place))
    everywhere = [one for ours in blank.comm.allgather(found) for one in ours]
    if not everywhere:
        return None
    depth, name, place = max(everywhere)
    return name, depth, np.array(place)


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
