# SPDX-License-Identifier: MIT
"""Fishnet as a kind of test: cloth laid on a tool by geometry alone."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, ClassVar

import numpy as np

from ..equilibrium.cloth import holder
from ..equilibrium.state import State
from ..errors import EquilibriumError, InputError
from ..experiments.limits import beyond_laws, remarks
from ..items.item import Placed
from ..items.ply import Ply
from ..net.edges import Constraints
from ..net.network import Network
from ..parallel import most
from ..tools.tool import ToolTable
from .fishnet_table import Draped, FishnetTable
from .kind import Forming, tables_of
from .measures import shear_figures
from .table import below_cloth


class LaidPly(Ply):
    """A ply of which crossovers that are not laid carry nothing, see Ply."""

    def __init__(self, constraints: Constraints, laid: np.ndarray):
        super().__init__(constraints, (0.0, 0.0), flat=False)
        self._laid = laid

    def carrying(self, state: Placed) -> np.ndarray:
        """See Ply.carrying."""
        return super().carrying(state) & self._laid


class Cloth:
    """A ply in space that is flat or laid; what pictures and files need of a blank. Collective.

    Attributes
    ----------
    ply : LaidPly
    symmetry : empty
    """

    symmetry: frozenset[str] = frozenset()

    def __init__(self, network: Network, thickness: float, draped: Draped):
        self.network, self.comm, self.thickness = network, network.comm, thickness
        constraints = Constraints(network, bending=False, floats=True)
        self.ply = LaidPly(constraints, draped.laid.laid)
        self.height = 0.5 * thickness
        self.ply.nodes.rest[:, 2] = self.height
        self.hold = holder(self.ply)([])
        self.laid = State(draped.laid.on_nodes(network, self.ply.nodes), self.hold, 1.0)

    def start(self) -> State:
        """Flat."""
        return State(self.ply.nodes.rest, self.hold)

    def of_cloth(self, state: State) -> State:
        """The state as the ply sees it."""
        return state


class Draping(Forming):
    """Cloth laid on one tool as a fishnet. Collective.

    Parameters
    ----------
    network : Network
    tools : sequence of ToolTable
        One.
    folder : Path
        From which its file is looked for.
    **keys
        Those of FishnetTable.

    Attributes
    ----------
    tools : list of Tool
    draped : Draped
    blank : Cloth
    remarks : list of str

    Raises
    ------
    InputError
        On every rank.
    """

    kind: ClassVar[str] = "fishnet"
    table: ClassVar[type[FishnetTable]] = FishnetTable  # type: ignore[assignment]
    reference: ClassVar[str] = ""
    draped: Draped  # type: ignore[assignment]

    def __init__(
        self,
        network: Network,
        tools: Sequence[ToolTable | Mapping[str, Any]],
        *,
        folder: Path = Path(),
        options: Mapping[str, object] | None = None,
        **keys: Any,
    ):
        self.network, self.options, fabric = network, options or {}, network.fabric
        self.networks, self.each, self.suffix = [network], [self], ""
        test = FishnetTable.from_data({"kind": self.kind, **keys}, "test", bare=True)
        self.test = test  # type: ignore[assignment]
        tables = tables_of(ToolTable, "tool", tools)
        test.check_one(tables)
        test.check(network.preform, fabric)
        self.stages, self.clamps = [], []
        self.below = below_cloth(tables, [])
        self.thickness = fabric.needed("thickness", 'test.kind = "fishnet"')
        self._thick = [self.thickness]
        self.tools = [self._make(tables[0], folder)]
        self.remarks = remarks(network.preform, fabric, test)
        self.remarks += self.tools[0].remarks(self.thickness) + self._fit(tables[0], self.tools[0])
        try:
            below, gap = bool(self.below), 0.5 * self.thickness
            self.draped = test.lay(network, self.tools[0], below, gap)
        except InputError as error:
            raise InputError(f"test: {error}") from None
        self.remarks += self.draped.remarks()
        self.blank = Cloth(network, self.thickness, self.draped)  # type: ignore[assignment]
        self.state: State = self.blank.laid  # type: ignore[attr-defined]

    def check(self) -> list[str]:
        """What there is to say of the seed."""
        return [self.draped.told()]

    def fields(self, state: State | None = None) -> dict[str, np.ndarray]:
        """Of the laid cloth, or at a state, see Ply.fields. Collective.

        Without shear (NaN) and its energy where nothing is laid.
        """
        fields = self.blank.ply.fields(self.state if state is None else state)
        fields["shear_angle"][~fields["carrying"]] = np.nan
        fields["shear_energy"][~fields["carrying"]] = 0.0
        return fields

    def results(self) -> dict[str, Any]:
        """What a summary tells. Collective."""
        fields, network = self.fields(), self.network
        angle = abs(fields["shear_angle"])
        largest: tuple = (0.0, 0, [], [])
        if fields["carrying"].any():
            at = int(np.nanargmax(angle))
            hinge = self.blank.ply.nodes.of_hinge[at]
            flat, there = network.crossover_position[at], self.state.x[hinge]
            number = -int(network.crossover_number_global[at])
            largest = (float(f"{angle[at]:.9g}"), number, flat.tolist(), there.tolist())
        _, _, flat, there = max(network.comm.allgather(largest))
        energy = network.comm.allreduce(float(fields["shear_energy"].sum()))
        told = {
            **shear_figures(self.blank, fields),
            "shear_max_at_mm": {
                "flat": [1e3 * v for v in flat], "in_space": [1e3 * v for v in there],
            },
            "fishnet": self.draped.figures() | {"shear_energy_j": energy},
        }  # fmt: skip
        shear = most(network.comm, angle[~np.isnan(angle)], 0.0)
        return told | {"warnings": beyond_laws(network, shear, np.zeros(0))}

    def failure(self) -> EquilibriumError | None:
        """What ended the net early, if anything."""
        limit = self.draped.laid.limit
        return EquilibriumError(limit, "LOCKED", []) if limit else None
