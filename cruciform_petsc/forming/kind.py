# SPDX-License-Identifier: MIT
"""Forming as a kind of test: from tables of tools and stages to a blank among tools."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, ClassVar

import numpy as np

from ..equilibrium.state import State
from ..errors import EquilibriumError, InputError
from ..experiments.limits import remarks
from ..net.network import Network
from ..parallel import least
from ..tools.sampled import REACH
from ..tools.tool import Tool, ToolTable, load
from ..units import format_si
from .blank import Blank, ContactSettings, length_of
from .forming import Formed, FormingStep, form
from .table import FormingTable, StageTable, below_cloth, check_stages

WAVES = 0.01  # of the cloth's thickness: height of an imperfection, if nothing else is said
DEEPEST = 0.5  # of the thickness: how deep in a tool the cloth may lie at the start


class Forming:
    """A blank pressed over tools. Collective.

    Parameters
    ----------
    network : Network
        The blank; where its preform is drawn it lies, so `Preform.centred` is for the caller.
    tools, stages : sequence of ToolTable, StageTable
        Or mappings, as ``[[tool]]`` and ``[[stage]]`` of a case file; numbers without units in SI.
    folder : Path
        From which the tools' files are looked for.
    options : mapping, optional
        PETSc options for the solver, without the prefix.
    **keys
        Those of FormingTable, as in ``[test]`` of a case file.

    Attributes
    ----------
    tools : list of Tool
        Where they start.
    blank : Blank
    plans : list of StagePlan
    remarks : list of str
        What of tools and blank is hardly meant.

    Raises
    ------
    InputError
        On every rank.
    """

    kind: ClassVar[str] = "forming"
    table: ClassVar[type[FormingTable]] = FormingTable
    reference: ClassVar[str] = ""  # there is no membrane beside it

    def __init__(
        self,
        network: Network,
        tools: Sequence[ToolTable | Mapping[str, Any]],
        stages: Sequence[StageTable | Mapping[str, Any]],
        *,
        folder: Path = Path(),
        options: Mapping[str, object] | None = None,
        **keys: Any,
    ):
        self.network, self.options, fabric = network, options or {}, network.fabric
        test = FormingTable.from_data({"kind": self.kind, **keys}, "test", bare=True)
        self.test = test
        tables = [
            tool
            if isinstance(tool, ToolTable)
            else ToolTable.from_data(tool, f"tool[{i}]", bare=True)
            for i, tool in enumerate(tools)
        ]
        self.stages = [
            s if isinstance(s, StageTable) else StageTable.from_data(s, f"stage[{i}]", bare=True)
            for i, s in enumerate(stages)
        ]
        test.check(network.preform, fabric)
        check_stages(tables, self.stages, test.gravity)
        self.below = below_cloth(tables, self.stages)
        self.thickness = fabric.needed("thickness", "forming")
        self.tools = [self._make(table, folder) for table in tables]
        self.gaps = self._first_gaps()
        self.plans = [stage.plan(self.below) for stage in self.stages]
        wave = test.imperfection
        height = WAVES * self.thickness if wave.height is None else wave.height.si
        self.remarks = remarks(network.preform, fabric, test)
        self.remarks += [r for tool in self.tools for r in tool.remarks(self.thickness)]
        self.remarks += self._clearances()
        if height == 0.0:
            self.remarks.append("without test.imperfection wrinkles start from rounding, if at all")
        told = {
            "stiffness": test.contact.stiffness,
            "slip": test.contact.elastic_slip,
            "viscosity": test.contact.viscosity,
        }
        settings = replace(
            ContactSettings.of(fabric, length_of(network)),
            **{key: q.si for key, q in told.items() if q is not None},
        )
        self.blank = Blank(
            network,
            self.tools,
            weight=test.gravity,
            settings=settings,
            waves=(height, wave.seed) if height else None,
            bending=test.bending,
        )

    # -- tools --------------------------------------------------------------------------------

    def _points(self) -> np.ndarray:
        """Crossovers and arm ends of this rank where the blank lies, (n, 3), m."""
        net = self.network
        flat = [net.crossover_position, net.node_position[: net.num_nodes_owned]]
        return np.pad(np.concatenate(flat), ((0, 0), (0, 1)), constant_values=0.5 * self.thickness)

    def _make(self, table: ToolTable, folder: Path) -> Tool:
        """A tool where it starts: placed, or where it just touches the blank."""
        lies_below = table.name in self.below
        tool = load(
            self.network.comm,
            table,
            folder=folder,
            facing="+z" if lies_below else "-z",
            reach=max(REACH, 2.0 * self.thickness),
        )
        if tool.placed:
            return tool
        axis = np.array([0.0, 0.0, 1.0 if lies_below else -1.0])
        return tool.touching(self._points(), axis, 0.5 * self.thickness, self.network.comm)

    def _first_gaps(self) -> dict[str, float]:
        """Between blank and each tool at the start, m; InputError where they overlap."""
        points, comm = self._points(), self.network.comm
        gaps = {}
        for tool in self.tools:
            gap = tool.look(points, tool.start)[0] - 0.5 * self.thickness
            gaps[tool.name] = least(comm, gap)
            if gaps[tool.name] < -DEEPEST * self.thickness:
                at = int(np.argmin(gap)) if len(gap) else -1
                mine = (float(gap[at]), points[at].tolist()) if len(gap) else (np.inf, [])
                deep, (x, y, _) = min(comm.allgather(mine))
                raise InputError(
                    f'tool "{tool.name}" starts {format_si(-deep, "m")} deep in the cloth, at '
                    f"x = {format_si(x, 'm')}, y = {format_si(y, 'm')}: give it a place farther "
                    "off, or none, to have it start where it just touches"
                )
        return gaps

    def _clearances(self) -> list[str]:
        """Remarks on tools from above that leave less than the cloth's thickness to one below.

        At the ends of stages, of tools whose way is known beforehand, at corners of their facets.
        """
        poses = {tool.name: tool.start for tool in self.tools}
        pushed: set[str] = set()
        remarks = []
        for stage, plan in zip(self.stages, self.plans, strict=True):
            pushed = (pushed | set(plan.forces)) - stage.moved
            poses |= {name: make(poses[name]).at(1.0) for name, make in plan.motions.items()}
            known = [tool for tool in self.tools if tool.name not in pushed | set(stage.remove)]
            for low in (tool for tool in known if tool.name in self.below):
                for high in (tool for tool in known if tool.name not in self.below):
                    corners = poses[high.name].to_lab(high.surface.facets()[0])
                    left = float(low.look(corners, poses[low.name])[0].min())
                    if left < (1.0 - 1e-3) * self.thickness:
                        remarks.append(
                            f'at the end of stage "{stage.name}" tool "{high.name}" leaves '
                            f"{format_si(float(f'{max(left, 0.0):.3g}'), 'm')} to tool "
                            f'"{low.name}", less than the cloth\'s thickness of '
                            f"{format_si(self.thickness, 'm')}"
                        )
        return remarks

    # -- what runs call ---------------------------------------------------------------------------

    def check(self) -> list[str]:
        """What there is to say before anything is solved: where tools start, and their gaps."""
        told = []
        for tool in self.tools:
            side = "below" if tool.name in self.below else "above"
            x, y, z = (format_si(float(f"{v + 0.0:.6g}"), "m") for v in tool.start.place)
            gap = format_si(float(f"{max(round(self.gaps[tool.name], 9), 0.0):.3g}"), "m")
            told.append(
                f'tool "{tool.name}", {side} the cloth, starts at {x}, {y}, {z}, {gap} from it'
            )
        return told

    def solve(self, accepted: Callable[[FormingStep, State], None] | None = None) -> Formed:
        """Form the blank; ``accepted`` is called with each step and its state. Collective.

        Raises
        ------
        EquilibriumError
            On every rank, with the stage and the place; its ``result`` is what was reached.
        """
        try:
            return form(self.blank, self.plans, options=self.options, accepted=accepted)
        except EquilibriumError as error:
            self._explain(error)
            raise

    def _explain(self, error: EquilibriumError) -> None:
        """Say in the error how far it came, where it stopped and which tool touches there."""
        formed: Formed = error.result
        done = formed.steps[-1].increment.control if formed.steps else 0.0
        number = min(int(done), len(self.stages) - 1)
        where = tool = ""
        if error.place is not None:
            x, y = (format_si(float(f"{v:.4g}"), "m") for v in error.place[:2])
            where = f" at x = {x}, y = {y} of the flat blank"
            if error.reason != "PIERCED":
                where = f"; forces are farthest from balance{where}"
                tool = self._nearest_tool(formed, error.place)
        error.args = (
            f"forming: no equilibrium beyond {100 * (done - number):.3g} % of stage "
            f'"{self.stages[number].name}" ({error}, {error.reason}){where}{tool}. Smaller steps '
            "(step), a softer contact or more viscosity (test.contact) may help; so does more room "
            "between tools that close on the cloth",
        )

    def _nearest_tool(self, formed: Formed, place: np.ndarray) -> str:
        """Which tool presses hardest on the cloth near a place, in words. Collective."""
        if not formed.states:
            return ""
        blank, state, comm = self.blank, formed.states[-1], self.network.comm
        rest = blank.ply.nodes.rest[blank.touching]
        near = np.linalg.norm(rest - place, axis=1) < 2.0 * self.network.pitch.max()
        most = {
            contact.name: -least(comm, -contact.fields(state)["pressure"][near], 0.0)
            for contact in blank.contacts
        }
        name = max(most, key=lambda key: most[key])
        return f', where tool "{name}" presses most' if most[name] > 0.0 else ""
