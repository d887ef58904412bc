# SPDX-License-Identifier: MIT
"""Biaxial tension at a ratio of forces: rectangles, and crosses measured in the middle."""

from __future__ import annotations

import math
from typing import Annotated, Any, ClassVar, Literal

import numpy as np
from pydantic import Field

from ..cloth.fabric import Fabric
from ..cloth.preform import Preform
from ..errors import InputError, Problems
from ..fields import Number, Of, Quantities
from ..net.edges import Constraints
from ..net.network import Network
from ..quantities import declare
from ..units import format_si
from .experiment import DrawnCurves, Experiment, Grip
from .result import TestResult
from .table import TensionedTable

SIDES = ("lower", "upper", "left", "right")
GAUGE = 0.5  # of the narrower edge: sides of the square in the middle where strains are read
Tensions = Annotated[
    Quantities,
    Of("N/m", many=True, good=lambda n: n >= 0.0, wanted="zero or positive", example="10 N/cm"),
]


class BiaxialLoadTable(TensionedTable):
    """A rectangle or a cross pulled along both yarns, at a ratio of the tensions."""

    controls: ClassVar = {"tension": "N/m"}
    edges: ClassVar = SIDES
    template: ClassVar = {
        "title": '"Biaxial tension by load, 2 : 1"',
        "outline": '{ cross = ["300 mm", "100 mm"], arm_slits = 4 }',
        "bias_angle": '"0 deg"',
        "test": """
            tension = ["5 N/cm", "10 N/cm"]  # Of the warp, per width, one value or a list
            ratio = 0.5  # Tension of the weft over the warp's
            # pretension = "1 N/cm"  # Of both yarns before it, or of each
        """,
    }

    kind: Literal["biaxial-load"]
    tension: Tensions
    """Of the warp, per width of the edges that it ends at, one value or a list. Each yarn end
    carries its share."""
    ratio: Annotated[Number, Field(ge=0.0, le=1000.0)] = 1.0
    """Tension of the weft over the warp's."""

    def check(self, preform: Preform, fabric: Fabric) -> None:
        """See KindTable.check."""
        problems = Problems()
        with problems.caught():
            super().check(preform, fabric)
        if abs(math.sin(2.0 * preform.bias_angle)) > 1e-9:
            problems.append(
                'test.kind = "biaxial-load" needs yarns along the edges: preform.bias_angle = '
                f'"0 deg" or "90 deg", got "{format_si(preform.bias_angle, "rad")}"'
            )
        for edge in self.edges:
            with problems.caught():
                try:
                    preform.edge(edge)
                except InputError as error:
                    raise InputError(f'test.kind = "biaxial-load": {error}') from None
        problems.tell()


declare("tension_warp_N_per_cm", "warp tension", "tension of the warp")
declare("tension_weft_N_per_cm", "weft tension", "tension of the weft")
declare("strain_centre_warp_percent", "warp strain, in the middle")
declare("strain_centre_weft_percent", "weft strain, in the middle")
declare("tension_centre_warp_N_per_cm", "warp tension, in the middle")
declare("tension_centre_weft_N_per_cm", "weft tension, in the middle")


class BiaxialLoad(Experiment):
    """Dead loads on all four edges, in a ratio; strains and tensions are those of the middle.

    Each yarn end carries its share of the load, as grips of single yarns, or slits in the arms of a
    cross, have it. Nothing but a crossover in the middle is held; in space edges stay in the plane.

    Arguments: see Experiment and `BiaxialLoadTable`.
    """

    table = BiaxialLoadTable
    kind = "biaxial-load"
    ratio: float
    column = declare("tension_warp_N_per_cm", "warp tension", "tension of the warp")
    clamps = ()
    forces = ("force_warp_N", "force_weft_N")
    movement = "extension in the middle"
    captions: ClassVar = {
        "tension_against_strain.png": "Tension at the edges against the strain in the middle."
    }
    colour = "tension"

    def __init__(self, network: Network, tension: Any, **keys: Any):
        super().__init__(network, tension, **keys)
        self._warp_axis = int(abs(network.preform.rotation[0, 1]) > 0.5)

    def _edges(self, axis: int) -> tuple[str, str]:
        """The edges that yarns along an axis end at."""
        return (("left", "right"), ("lower", "upper"))[axis]

    def _width(self, axis: int) -> float:
        """Of the two edges across an axis the mean length, m."""
        lengths = [
            np.hypot(*(piece[:, 1] - piece[:, 0]).T).sum()
            for piece in (self.network.preform.edge(edge) for edge in self._edges(axis))
        ]
        return float(np.mean(lengths))

    def grip(self, constraints: Constraints) -> list[Grip]:
        """Load all edges, by 1 N/m of the warp; hold the middle, and heights. Collective."""
        network = self.network
        for axis in (0, 1):
            size = 1.0 if axis == self._warp_axis else self.ratio
            for edge, sign in zip(self._edges(axis), (-1.0, 1.0), strict=True):
                constraints.line_load(edge, sign * size * np.eye(2)[axis])
                constraints.fixed_z[constraints.nodes_on(edge)] = True
        # A yarn's end in the middle, and one beside it that keeps the cloth from turning.
        own = slice(0, network.num_nodes_owned)
        along = network.to_yarn(network.node_position[own] - self.middle)
        keys, family = network.node_key[own], network.node_family[own]
        warp = family == 0
        order = np.round(np.hypot(*along.T), 9) + np.where(warp, 0.0, np.inf)
        first = self._nearest(order, keys)
        there = np.flatnonzero(keys == first)
        place = network.comm.allreduce(along[there].sum(axis=0))
        beside = warp & (np.abs(along[:, 1] - place[1]) < 1e-6 * network.pitch[1])
        far = np.where(
            beside & (keys != first), np.round(np.abs(along[:, 0] - place[0]), 9), np.inf
        )
        constraints.pin(first, (0, 1))
        constraints.pin(self._nearest(far, keys), (1,))
        return []

    def _nearest(self, distance: np.ndarray, keys: np.ndarray) -> int:
        """Key of the node of the least distance, of several the lowest. Collective."""
        first = np.lexsort((keys, distance))[:1]
        own = np.concatenate([distance[first], [np.inf]])[0], np.append(keys[first], -1)[0]
        return int(min(self.network.comm.allgather(own))[1])

    def motion(self, edge: str, control: float) -> tuple[np.ndarray, np.ndarray]:
        """Nothing is moved."""
        return np.eye(2), np.zeros(2)

    def load_factor(self, control: float) -> float:
        """The control is the load."""
        return control

    def load_of(self, work: float, control: float) -> float:
        """Force of the warp."""
        return control * self._width(self._warp_axis)

    def _middle(self, result: TestResult, name: str) -> np.ndarray:
        """Mean of a field over a square in the middle, by the area around crossovers; (n,)."""
        side = GAUGE * min(self._width(0), self._width(1))
        off = np.abs(self.network.crossover_position - self.middle).max(axis=1)
        inside = off <= 0.5 * side + 1e-9 * side
        inside |= off <= self._nearest_off(off)
        weight = self.network.quadrant_area.sum(axis=1) * inside * result.supports.carrying
        sums = np.array([(weight * state.fields[name]).sum() for state in result.states])
        total = self.network.comm.allreduce(np.append(sums, weight.sum()))
        return total[:-1] / total[-1]

    def _nearest_off(self, off: np.ndarray) -> float:
        comm = self.network.comm
        return min(comm.allgather(float(off.min(initial=np.inf)))) * (1.0 + 1e-9)

    def extra_columns(self, result: TestResult) -> dict[str, np.ndarray]:
        """Forces on the edges, tensions, and strains and tensions in the middle."""
        warp, weft = self._warp_axis, 1 - self._warp_axis
        n, columns = result.controls, {}
        columns["force_warp_N"] = n * self._width(warp)
        columns["force_weft_N"] = n * self.ratio * self._width(weft)
        columns["tension_weft_N_per_cm"] = 0.01 * n * self.ratio
        for family, side in enumerate(("warp", "weft")):
            stretch = 1.0 + self._middle(result, f"{side}_strain")
            strain = stretch / self.prestretch[family] - 1.0
            columns[f"strain_centre_{side}_percent"] = 100.0 * strain
            tension = self._middle(result, f"{side}_tension") / self.prestretch[1 - family]
            columns[f"tension_centre_{side}_N_per_cm"] = 0.01 * tension
        return columns

    def extensions(self, result: TestResult) -> np.ndarray:
        """Of the middle along the warp, as if all of the specimen stretched like it."""
        strain = 0.01 * result.curve(states=True)["strain_centre_warp_percent"]
        return strain * self.size[self._warp_axis]

    def drawn_curves(self, columns: dict[str, np.ndarray]) -> DrawnCurves:
        """Tension of both families against their strain in the middle."""
        names = {"warp": "warp", "weft": f"weft, tension {self.ratio:.3g} of the warp's"}
        start = 1e-2 * self.network.fabric.tensions(self.prestretch)  # N/cm
        lines = {
            name: (
                np.append(0.0, columns[f"strain_centre_{side}_percent"]),
                np.append(tension, columns[f"tension_{side}_N_per_cm"]),
            )
            for (side, name), tension in zip(names.items(), start, strict=True)
        }
        return "tension_against_strain", ("strain in the middle (%)", "tension (N/cm)"), lines
