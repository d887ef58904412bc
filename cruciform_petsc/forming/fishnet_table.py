# SPDX-License-Identifier: MIT
"""[test] kind = "fishnet", and [test] fishnet of a forming that begins with one."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated, Any, ClassVar, Literal

import numpy as np
from pydantic import Field, model_validator

from ..cloth.fabric import Fabric
from ..cloth.preform import Preform
from ..errors import InputError
from ..experiments.table import KindTable
from ..fields import Line, Name, Of, Point, Table, si_values
from ..net.network import Network
from ..quantities import length
from ..tools.tool import Tool, ToolTable
from ..units import Quantity
from .fishnet import LOCKED
from .generators import Seed
from .lay import Laid, lay, place_of, seed_crossover
from .least_energy import CoarseNet, Search, search

Angle = Annotated[
    Quantity,
    Of("rad", good=lambda a: 0.0 <= a < 0.5 * math.pi, wanted="from 0 deg to less than 90 deg"),
]
Between = Annotated[
    Quantity, Of("rad", good=lambda a: 0.0 < a < math.pi, wanted="between 0 deg and 180 deg")
]
Locking = Annotated[
    Quantity, Of("rad", good=lambda a: 0.0 < a <= LOCKED, wanted="above 0 deg and at most 89 deg")
]
Pieces = Annotated[int, Field(ge=2, le=100)]
Places = Annotated[int, Field(ge=1, le=100)]


@dataclass(frozen=True)
class Draped:
    """What came of laying a network: it, from where, and what was sought for that, if anything.

    ``first`` is the seed's crossover, int64 (2,).
    """

    laid: Laid
    first: np.ndarray
    seed: Seed
    search: Search | None

    def figures(self) -> dict[str, Any]:
        """What a summary tells. Not collective."""
        told: dict[str, Any] = {
            "tool": self.seed.tool.name,
            "seed_mm": (1e3 * self.laid.seed[0]).tolist(),
            "place_mm": (1e3 * self.laid.seed[1]).tolist(),
            "warp_heading_deg": math.degrees(self.seed.heading),
            "between_deg": math.degrees(self.seed.between),
            "joints": self.laid.joints,
        }
        if self.search is not None:
            told["least_energy"] = {
                "nets": self.search.nets,
                "coarse_energy_j": self.search.energy,
                "coarse_energy_before_j": self.search.before,
            }
        return told

    def told(self) -> str:
        """Where the seed lies, in a sentence."""
        (x, y), there = (map(length, place) for place in self.laid.seed)
        return (
            f'the crossover at x = {x}, y = {y} is laid first, on tool "{self.seed.tool.name}" '
            f"at {', '.join(there)}"
        )

    def remarks(self) -> list[str]:
        """What a user should know."""
        if not self.laid.beyond:
            return []
        return [
            f'{self.laid.beyond} crossovers are laid where tool "{self.seed.tool.name}" has ended: '
            "on what the program takes it to go on as"
        ]


class LeastEnergyTable(Table):
    """least_energy of a fishnet: what is tried for the least energy of shear."""

    places: Places = 5
    """Seeds that are tried first, in each direction, evenly over the blank."""
    turn: Angle = Quantity.read("10 deg", "rad")
    """Up to which the warp may turn at the seed, to both sides."""
    shear: Angle = Quantity.read("10 deg", "rad")
    """Up to which the cloth may be sheared there, to both sides."""


class LayTable(Table):
    """What the two yarns are that a fishnet is laid from."""

    seed: Point | None = None
    """Place on the flat blank that is laid first, x and y: the crossover there. The default is its
    centre, of a part between planes of symmetry where they are. Example: `["0 mm", "20 mm"]`"""
    place: Point | None = None
    """Where on the tool it is laid, in plan. The default is where it lies on the flat blank.
    Example: `["0 mm", "25 mm"]`"""
    turn: Annotated[Quantity, Of("rad")] = Quantity.read("0 deg", "rad")
    """By which the warp is turned there, in plan, from x towards y."""
    between: Between = Quantity.read("90 deg", "rad")
    """From warp to weft there, on the tool."""
    generators: Literal["geodesic", "upright"] = "geodesic"
    """What the two yarns through the seed follow: straight lines on the tool, or upright planes,
    as planes of symmetry are."""
    warp_line: Line | None = None
    """Points in plan, x and y, through the place, that the warp through the seed follows instead.
    Example: `[["0 mm", "-50 mm"], ["0 mm", "0 mm"], ["10 mm", "50 mm"]]`"""
    weft_line: Line | None = None
    """The same of the weft. Example: `[["50 mm", "0 mm"], ["0 mm", "0 mm"], ["-50 mm", "0 mm"]]`"""
    locking_angle: Locking = Quantity.read("89 deg", "rad")
    """Shear angle beyond which the net locks."""
    least_energy: LeastEnergyTable | None = None
    """Choose place and directions at the seed for the least energy of shear, by the fabric's law of
    shear; what is told above is where it begins. Example: `{ places = 5, turn = "10 deg" }`"""

    def lay(self, network: Network, tool: Tool, below: bool, gap: float) -> Draped:
        """Lay a network on a tool, ``gap`` [m] from it. Collective.

        Raises InputError, on every rank, if the seed lies beside the blank or the tool.
        """
        first, seed = self._start(network, tool, below, gap)
        found, wanted = None, self.least_energy
        if wanted is not None:
            net = CoarseNet(network.preform, network.fabric, self.locking_angle.si)
            limits = wanted.places, wanted.turn.si, wanted.shear.si
            found = search(network.comm, net, place_of(network, first), seed, *limits)
            first, seed = found.nearest(network)
        return Draped(lay(network, first, seed, self.locking_angle.si), first, seed, found)

    def _start(
        self, network: Network, tool: Tool, below: bool, gap: float
    ) -> tuple[np.ndarray, Seed]:
        """Lattice position of the seed, (2,) int64, and the seed on a tool."""
        asked = np.array(si_values(self.seed)) if self.seed else np.zeros(2)
        first = seed_crossover(network, asked)
        there = place_of(network, first)
        place = np.array(si_values(self.place)) if self.place else there
        warp = network.preform.warp_direction
        lines = [
            None if line is None else np.array([si_values(point) for point in line])
            for line in (self.warp_line, self.weft_line)
        ]
        return first, Seed(
            tool, below, gap, place, math.atan2(warp[1], warp[0]) + self.turn.si, self.between.si,
            self.generators == "upright", (lines[0], lines[1]),
        )  # fmt: skip


class StartTable(LayTable):
    """[test] fishnet of a forming: cloth that begins laid on a tool."""

    tool: Name | None = None
    """On which; by default the only one that lies below the cloth. Example: `"die"`"""
    pieces: Pieces | None = None
    """Lay it row by row: so many pieces, from the seed outwards, each brought to equilibrium before
    the next one is laid. Stages of their own before the first one. Example: `5`"""
    press: Annotated[Quantity, Of("Pa")] | None = None
    """What presses the cloth onto the tool from the start, as suction does, until a stage has
    another suction; pieces need it. Example: `"5 kPa"`"""

    @model_validator(mode="after")
    def _both(self) -> StartTable:
        if self.pieces is not None and self.press is None:
            raise ValueError(".pieces need press, which holds those that are laid")
        if self.pieces is not None and (self.warp_line or self.weft_line):
            raise ValueError(".pieces go on straight: leave out warp_line and weft_line")
        return self


class FishnetTable(LayTable, KindTable):
    """A blank of cloth laid on a tool as a net of yarns that keep their lengths."""

    edges: ClassVar = ()
    finite: ClassVar[bool] = True
    space: ClassVar[bool] = True

    kind: Literal["fishnet"]
    model: Literal["coupled"] = "coupled"
    """Not of a fishnet, which has no forces."""
    bending: Literal[False] = False
    """Not of a fishnet: its yarns are hinged."""

    def placed(self, preform: Preform) -> Preform:
        """See KindTable.placed: its centre at x = y = 0."""
        return preform.centred()

    def check(self, preform: Preform, fabric: Fabric) -> None:
        """See KindTable.check."""
        fabric.needed("thickness", 'test.kind = "fishnet"')

    @staticmethod
    def check_one(tools: Sequence[ToolTable]) -> None:
        """Raise InputError unless there is one tool."""
        if len(tools) != 1:
            raise InputError(
                'test.kind = "fishnet" needs one [[tool]] to lay the cloth on, '
                f"got {len(tools) or 'none'}"
            )

    @classmethod
    def own_keys(cls) -> list[str]:
        """Keys that only this kind has."""
        return [key for key in cls.model_fields if key not in KindTable.model_fields]
