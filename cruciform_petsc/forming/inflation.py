# SPDX-License-Identifier: MIT
"""Inflated and pressure-loaded nets: cushions, sails, nets between raised corners.

Torbe 1975 (The cruciform finite element, for sails and the like) loads nets of cruciforms by
pressure; form finding by force densities is Schek's, 1974 (items.force_density).
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Any, ClassVar, Literal

import numpy as np
from pydantic import Field, model_validator

from ..cloth.fabric import Fabric
from ..cloth.preform import Preform
from ..equilibrium.model import Model
from ..equilibrium.newton import Equilibrium
from ..equilibrium.state import State
from ..errors import InputError, Problems
from ..experiments.table import Pretension, prestretch
from ..fields import Count, Length, Name, Of, Quantities, si_values
from ..items.clamps import preload_name
from ..items.force_density import ForceDensity
from ..items.loads import facets
from ..net.network import Network
from ..parallel import least, most
from ..tools.tool import ToolTable
from .forming import Formed
from .kind import Arranged
from .table import ArrangedTable, ClampTable, StageTable, Step, check_pressure

SIDES = ("lower", "right", "upper", "left")  # as the outline runs
Pressures = Annotated[Quantities, Of("Pa", many=True, example="5 kPa")]


class InflationTable(ArrangedTable):
    """A net whose edges are held, under pretension and pressure."""

    template: ClassVar = {
        "title": '"Inflated net, 300 mm"',
        "test": """
            pressure = ["2 kPa", "5 kPa"]  # From below, one value or a list, one after the other
            # pretension = "2 N/cm"  # Of both families before it, or of warp and weft
            # hold = ["lower", "right", "upper", "left"]  # Edges that are held
            # Heights of the corners, lower left, lower right, upper right, upper left
            # corners = ["0 mm", "60 mm", "0 mm", "60 mm"]
            slides = false  # Edges are held in height only: half of a cushion
            results = 1  # States that are written on the way to each pressure
            # step = 0.1  # Largest step, as a share of a pressure
        """,
    }

    kind: Literal["inflation"]  # type: ignore[assignment]
    pressure: Pressures | None = None
    """From below, one value or a list, one after the other; it follows the cloth. Without it the
    net is found between its `corners` only."""
    pretension: Pretension | None = None
    """Tension per width of both families where the net is drawn, or of warp and weft. Without it
    the net is without tension there. Example: `"10 N/cm"`"""
    hold: Annotated[list[Name], Field(max_length=1000)] | None = None
    """Edges that are held; by default lower, right, upper and left, but for those in planes of
    symmetry. Example: `["outline-1", "outline-2", "outline-3"]`"""
    corners: Annotated[list[Length], Field(min_length=4, max_length=4)] | None = None
    """Heights of a rectangle's corners, lower left, lower right, upper right, upper left, to which
    they are raised first, the edges straight between them; with a pretension. The form of force
    densities is where that begins. Example: `["0 mm", "60 mm", "0 mm", "60 mm"]`"""
    slides: bool = False
    """Edges are held in height only: a cushion of which this is one half."""
    results: Annotated[Count, Field(le=10_000)] = 1
    """States that are written on the way to each pressure; one more is when all is at rest."""
    step: Step | None = None
    """Largest step, as a share of the way to a pressure; the default is 0.25. Example: `0.1`"""

    @model_validator(mode="after")
    def _something_happens(self) -> InflationTable:
        if self.pressure is None and self.corners is None:
            raise ValueError("needs a pressure, corners or both")
        if self.fishnet is not None:
            raise ValueError(".fishnet lays cloth on a tool, which an inflated net has not")
        if self.corners is not None:
            if self.slides:
                raise ValueError(".corners hold edges in place, without slides")
            if self.hold is not None or self.symmetry:
                raise ValueError(".corners are of all four edges, without hold and symmetry")
            if self.pretension is None or not any(si_values(self.pretension)):
                raise ValueError(".corners need a pretension, which gives the form")
        return self

    def check(self, preform: Preform, fabric: Fabric) -> None:
        """See KindTable.check."""
        problems = Problems()
        with problems.caught():
            super().check(preform, fabric)
        if self.corners is not None and preform.sides() is None:
            problems.append("test.corners needs preform.outline to be a rectangle")
        for edge in self._held():
            with problems.caught():
                try:
                    preform.edge(edge)
                except InputError as error:
                    raise InputError(f"test.hold: {error}") from None
        if not problems:
            _, clamps, stages = self.arranged()
            with problems.caught():
                check_pressure(self, self.placed(preform), stages, clamps)
        with problems.caught():
            prestretch(self.pretension, fabric, self.model)
        problems.tell()

    def _held(self) -> list[str]:
        if self.hold is not None:
            return list(dict.fromkeys(self.hold))
        return [side for side in SIDES if side not in self.symmetry]

    def arranged(self) -> tuple[list[ToolTable], list[ClampTable], list[StageTable]]:
        """See ArrangedTable."""
        more = {} if self.step is None else {"step": self.step}
        clamps: list[dict[str, Any]] = [{"edge": e, "slides": self.slides} for e in self._held()]
        stages: list[dict[str, Any]] = []
        if self.corners is not None:
            raised = [str(height) for height in self.corners]
            for k, clamp in enumerate(clamps):
                clamp["lift"] = [raised[k], raised[(k + 1) % 4]]
            stages.append({"name": "raise", **more})
        given = [] if self.pressure is None else self.pressure
        for pressure in given if isinstance(given, list) else [given]:
            down = f"{-pressure.si:.17g} Pa"
            name = f"to {pressure}"
            stages.append({"name": name, "pressure": down, "results": self.results, **more})
        stages.append({"name": "rest", **more})
        return (
            [],
            [ClampTable.from_data(clamp, "test") for clamp in clamps],
            [StageTable.from_data(stage, "test") for stage in stages],
        )


class Inflation(Arranged):
    """A net whose edges are held, under pretension and pressure. Collective.

    Arguments: see Arranged and `InflationTable`.

    Attributes
    ----------
    form : dict or None
        Of force densities between raised corners: ``rise_mm``, the forces' largest and smallest
        share of the pretension.
    """

    table = InflationTable
    kind = "inflation"
    test: InflationTable

    def __init__(
        self, network: Network, *, options: Mapping[str, object] | None = None, **keys: Any
    ):
        super().__init__(network, options=options, **keys)
        self.form: dict[str, float] | None = None
        if self.test.corners is not None:
            self.form = self._find_form()

    def _find_form(self) -> dict[str, float]:
        """The net of force densities between the edges as they are raised; a linear solution."""
        blank, comm = self.blank, self.network.comm
        assert self.test.pretension is not None
        warp, weft = (si_values(self.test.pretension) * 2)[:2]
        density = ForceDensity(blank.ply, (warp, weft))
        clamps = blank.clamps
        model = Model(blank.ply.nodes, [density, *clamps], blank.ply.active, warp + weft)
        start = blank.of_cloth(blank.start())
        grown = {preload_name(clamp.edge): 1.0 for clamp in clamps}
        (hold,) = blank.cloth_holds
        state = State(start.x, hold, factors=grown, memory={})
        equilibrium = Equilibrium(model, state, self.options)
        try:
            found = equilibrium.solve(state).state
        finally:
            equilibrium.destroy()
        moved = found.x - start.x
        clamps[0].form = moved[: blank.ply.nodes.num_nodes_owned]
        ratio = density.forces(found) / density.forces(start)
        return {
            "rise_mm": 1e3 * most(comm, moved[:, 2], 0.0),
            "fall_mm": -1e3 * least(comm, moved[:, 2], 0.0),
            "force_over_pretension_max": most(comm, ratio, 0.0),
            "force_over_pretension_min": least(comm, ratio, np.inf),
        }

    def volume(self, state: State) -> float:
        """Between the net and the plane that it was drawn in, m^3. Collective."""
        nodes, weight = facets(self.blank.ply)
        x = self.blank.of_cloth(state).x[nodes] - [0.0, 0.0, 0.5 * self.thickness]
        a, b, c = np.moveaxis(x[..., :2], 1, 0)
        plan = (b - a)[:, 0] * (c - a)[:, 1] - (b - a)[:, 1] * (c - a)[:, 0]
        own = (weight * plan * x[..., 2].sum(axis=1)).sum() / 6.0
        return float(self.network.comm.allreduce(own))

    def figures(self, formed: Formed) -> dict[str, Any]:
        """Rise, volume and tensions at each state that was asked for. Collective."""
        comm, blank = self.network.comm, self.blank
        table: dict[str, list[float]] = {}
        for state in formed.states:
            fields = blank.ply.fields(blank.of_cloth(state))
            height = fields["displacement"][:, 2]
            carries = fields["carrying"]
            row = {
                "pressure_pa": 0.0 - state.factors.get("pressure", 0.0),
                "rise_mm": 1e3 * most(comm, height, 0.0),
                "fall_mm": -1e3 * least(comm, height, 0.0),
                "volume_m3": self.volume(state),
            }
            for family in ("warp", "weft"):
                tension = fields[f"{family}_tension"][carries] / 100.0
                row[f"{family}_tension_max_n_per_cm"] = most(comm, tension, -np.inf)
                row[f"{family}_tension_min_n_per_cm"] = least(comm, tension, np.inf)
            for key, value in row.items():
                table.setdefault(key, []).append(value)
        told: dict[str, Any] = dict(table)
        if self.form is not None:
            told["force_densities"] = self.form
        return {"inflation": told}
