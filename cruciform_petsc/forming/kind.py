# SPDX-License-Identifier: MIT
"""Forming as a kind of test: from tables of tools and stages to a blank among tools."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from copy import copy
from dataclasses import replace
from pathlib import Path
from typing import Any, ClassVar, TypeVar

import numpy as np
import shapely

from ..equilibrium.state import State
from ..errors import EquilibriumError, InputError
from ..experiments.finite import Keeper
from ..experiments.limits import remarks
from ..experiments.table import prestretch
from ..fields import Table
from ..items.clamps import preload_name
from ..items.item import Item
from ..items.loads import G, PressureAbove, Suction
from ..items.ply import Ply
from ..net.network import Network
from ..parallel import least, most
from ..quantities import length
from ..tools.sampled import REACH
from ..tools.tool import Tool, ToolTable, load
from .blank import Blank, ContactSettings, TrussBlank, length_of
from .failures import explain
from .fishnet_table import Draped
from .forming import Formed, FormingStep, form
from .progressive import Rows
from .table import (
    PRESSURES,
    ArrangedTable,
    ClampTable,
    FormingTable,
    StageTable,
    below_cloth,
    check_course,
    check_pressure,
    check_several,
    check_stages,
    course_of,
    laying_stages,
)

WAVES = 0.01  # of the cloth's thickness: height of an imperfection, if nothing else is said
COARSE = 1.25  # arms over a radius: beyond, the net cuts the corner
FAR = 20.0  # times the blank: a tool's size beyond which its unit is doubted
DEEPEST = 0.5  # of the thickness: how deep in a tool the cloth may lie at the start
AnyTable = TypeVar("AnyTable", bound=Table)
OFF_PLANE = 1e-3  # of a pitch: by how much laid cloth may leave a plane of symmetry
BESIDE = 0.6  # of the smaller of both: how much of tool and blank lies over each other as a rule
ONE_SIDED = 0.1  # of the thickness: by how much both sides of a plane of symmetry may differ


def tables_of(kind: type[AnyTable], key: str, given: Sequence) -> list[AnyTable]:
    """Tables, of which scripts may give plain data with numbers in SI."""
    return [
        table if isinstance(table, kind) else kind.from_data(table, f"{key}[{i}]", bare=True)
        for i, table in enumerate(given)
    ]


class Forming:
    """A blank pressed over tools. Collective.

    Parameters
    ----------
    network : Network or sequence of Network
        The blank, or its plies from the lowest up; where a preform is drawn it lies, so
        `Preform.centred` is for the caller.
    tools, stages, clamps : sequence of ToolTable, StageTable, ClampTable
        Or mappings, as ``[[tool]]``, ``[[stage]]`` and ``[[clamp]]`` of a case file; numbers
        without units in SI.
    folder : Path
        From which the tools' files are looked for.
    options : mapping, optional
        PETSc options for the solver, without the prefix.
    names : sequence of str, optional
        Of several plies.
    rub : sequence of float, optional
        Coefficient of friction of each ply with those below it.
    **keys
        Those of FormingTable, as in ``[test]`` of a case file.

    Attributes
    ----------
    tools : list of Tool
        Where they start.
    blank : Blank
    draped : Draped or None
        What it begins as, if it begins laid on a tool.
    each : list of Forming
        The forming as each of its plies, to read results off: `network`, `blank`, `thickness` are
        the ply's, `suffix` goes with the names of its files. Of a single ply itself.
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
    reference: ClassVar[str] = "formed"
    draped: Draped | None = None
    # Items whose factors grow over the first stage, besides preloads.
    growing: ClassVar[tuple[str, ...]] = ()

    def __init__(
        self,
        network: Network | Sequence[Network],
        tools: Sequence[ToolTable | Mapping[str, Any]],
        stages: Sequence[StageTable | Mapping[str, Any]],
        clamps: Sequence[ClampTable | Mapping[str, Any]] = (),
        *,
        folder: Path = Path(),
        options: Mapping[str, object] | None = None,
        names: Sequence[str] = (),
        rub: Sequence[float] = (),
        **keys: Any,
    ):
        self.networks = [network] if isinstance(network, Network) else list(network)
        self.network, self.options = self.networks[0], options or {}
        self.suffix, self._named = "", {"names": names, "rub": rub}
        test = self.table.from_data({"kind": self.kind, **keys}, "test", bare=True)
        self.test = test
        tables = tables_of(ToolTable, "tool", tools)
        self.stages = tables_of(StageTable, "stage", stages)
        self.clamps = tables_of(ClampTable, "clamp", clamps)
        if len(self.networks) > 1:
            check_several(test, self.stages, self.clamps)
        for net in self.networks:
            test.check(net.preform, net.fabric)
            check_course(test, net.fabric, self.stages)
        check_stages(test, tables, self.stages, self.clamps)
        check_pressure(test, self.network.preform, self.stages, self.clamps)
        self.below = below_cloth(tables, self.stages)
        self._thick = [net.fabric.needed("thickness", "forming") for net in self.networks]
        self.thickness = sum(self._thick)
        self.tools = self._laid_on(tables, folder)
        self.rows = self._rows()
        self.gaps = self._first_gaps()
        self.plans = [stage.plan(self.below) for stage in self.stages]
        grown = dict.fromkeys(self._growing(), 1.0)
        for i in range(0 if self.rows is None else len(self.rows.last)):
            more = self.rows.factors(i) if self.rows else {}
            self.plans[i] = replace(self.plans[i], factors={**self.plans[i].factors, **more})
        self.plans[0] = replace(self.plans[0], factors={**self.plans[0].factors, **grown})
        wave = test.imperfection
        height = WAVES * min(self._thick) if wave.height is None else wave.height.si
        self.remarks: list[str] = []
        for net in self.networks:
            said = remarks(net.preform, net.fabric, test)
            self.remarks += [sentence for sentence in said if sentence not in self.remarks]
        self.remarks += [r for tool in self.tools for r in tool.remarks(self.thickness)]
        self.remarks += self._clearances() + self._one_sided()
        for table, tool in zip(tables, self.tools, strict=True):
            self.remarks += self._fit(table, tool)
        if height == 0.0:
            self.remarks.append("without test.imperfection wrinkles start from rounding, if at all")
        told = {
            "stiffness": test.contact.stiffness,
            "slip": test.contact.elastic_slip,
            "viscosity": test.contact.viscosity,
        }
        settings = replace(
            ContactSettings.of_all(
                [(net.fabric, length_of(net, test.symmetry)) for net in self.networks], self._load()
            ),
            **{key: q.si for key, q in told.items() if q is not None},
        )
        self.settings = settings
        truss = test.model == "truss"  # whose yarns bend by no waves
        waves = (height, wave.seed) if height and not truss else None
        laid = None if self.draped is None else self.draped.laid
        self.blank: Blank = self.lay(TrussBlank if truss else Blank, waves=waves, laid=laid)
        if self.draped is not None:
            self.remarks += self.draped.remarks()
            self._check_planes()
        several = len(self.networks) > 1
        self.each = [copy(self) for _ in self.networks] if several else [self]
        for number, (one, blank) in enumerate(zip(self.each, self.blank.each, strict=True), 1):
            one.network, one.blank, one.each = blank.network, blank, [one]
            one.thickness = blank.thickness
            one.suffix = f"_ply{number}" if several else ""
            blank.ply.cruciforms.course = course_of(test, self.stages)

    def _load(self) -> float:
        """What pushes the blank as a whole at most: its weight, pressures; Pa."""
        weight = 0.0
        if self.test.gravity:
            weight = G * sum(
                net.fabric.needed("areal_density", "test.gravity = true") for net in self.networks
            )
        pushes = [(stage.pressure, stage.suction) for stage in self.stages]
        largest = max((abs(push.si) for both in pushes for push in both if push), default=0.0)
        return max(largest, *map(abs, self._pressed().values()), 0.0) + weight

    def lay(self, kind: Callable[..., Any], **further: Any) -> Any:
        """A blank of a kind among the tools. Collective."""
        several = len(self.networks) > 1
        further |= self._named if several else {}
        return kind(
            self.networks if several else self.network,
            self.tools,
            weight=self.test.gravity,
            settings=self.settings,
            bending=self.test.bending,
            symmetry=self.test.symmetry,
            further=[*(clamp.build for clamp in self.clamps), *self._pressures()],
            cuts=self._cuts(),
            prestretch=prestretch(getattr(self.test, "pretension", None), self.network.fabric),
            factors=dict.fromkeys((*PRESSURES, *self._growing(), *self._held_back()), 0.0)
            | self._pressed(),
            **further,
        )

    def _pressed(self) -> dict[str, float]:
        """What presses laid cloth onto its tool from the start, Pa, by name of its item."""
        press = None if self.test.fishnet is None else self.test.fishnet.press
        return {} if press is None else {"suction": press.si}

    def _held_back(self) -> dict[str, shapely.Polygon]:
        """What of the flat blank is laid before other rows, by what holds these back."""
        return {} if self.rows is None else self.rows.cuts()

    def _cuts(self) -> dict[str, shapely.Polygon]:
        """What stays where stages trim the blank, by the factor that their plans send to 0."""
        cuts = self._held_back()
        blank = shapely.unary_union([net.preform.outline for net in self.networks])
        for i, stage in enumerate(self.stages):
            if stage.trim is None:
                continue
            keep, name = stage.trim.build(), f"trim {i}"
            blank = shapely.intersection(blank, keep)
            if blank.is_empty:
                raise InputError(f"stage[{i}].trim leaves nothing of the blank")
            cuts[name] = keep
            plan = self.plans[i]
            self.plans[i] = replace(plan, factors={**plan.factors, name: 0.0})
        return cuts

    # -- clamps and pressures -------------------------------------------------------------------

    def _growing(self) -> list[str]:
        """Names of the factors that grow over the first stage."""
        preloads = [
            preload_name(clamp.edge) for clamp in self.clamps if clamp.preload or clamp.lift
        ]
        return [*preloads, *self.growing]

    def _pressures(self) -> list[Callable[[Ply], Item]]:
        """What makes the pressures that stages name; their factors are in Pa, downwards."""
        make: dict[str, Callable[[Ply], Item]] = {
            "pressure": lambda ply: PressureAbove(ply, -1.0, 0.5 * self.thickness),
            "suction": lambda ply: Suction(ply, -1.0),
        }
        named = [key for key in make if any(getattr(s, key) is not None for s in self.stages)]
        named += [key for key in self._pressed() if key not in named]
        return [make[key] for key in named]

    # -- tools --------------------------------------------------------------------------------

    def _laid_on(self, tables: Sequence[ToolTable], folder: Path) -> list[Tool]:
        """The tools, after the cloth has been laid on one if it begins so."""
        if self.test.fishnet is None:
            return [self._make(table, folder) for table in tables]
        table = self.test.fishnet
        name = table.tool or next(iter(self.below))
        number = next(k for k, tool in enumerate(tables) if tool.name == name)
        first = self._make(tables[number], folder)
        try:
            below, gap = name in self.below, 0.5 * self.thickness
            self.draped = table.lay(self.network, first, below, gap)
        except InputError as error:
            raise InputError(f"test.fishnet: {error}") from None
        if self.draped.laid.limit:
            raise InputError(
                f"test.fishnet: {self.draped.laid.limit}; a forming can begin with all of the "
                "cloth only: choose another seed, or a smaller blank"
            )
        return [
            first if k == number else self._make(other, folder) for k, other in enumerate(tables)
        ]

    def _rows(self) -> Rows | None:
        """Pieces that are laid one after the other, if they are; with stages of their own."""
        table = self.test.fishnet
        if table is None or table.pieces is None or self.draped is None:
            return None
        at, limit = self.draped, table.locking_angle.si
        rows = Rows.of(self.network, at.first, at.seed, limit, table.pieces)
        if len(rows.last) < table.pieces:
            raise InputError(
                f"test.fishnet.pieces = {table.pieces} is more than the {len(rows.last)} rows "
                "that there are around the seed"
            )
        self.stages = [*laying_stages(self.test), *self.stages]
        return rows

    def _check_planes(self) -> None:
        """Refuse a laid cloth that leaves planes of symmetry. Collective."""
        state = self.blank.start()
        hold = state.hold
        gap = np.einsum("nij,nj->ni", hold.axes, hold.place - state.x[hold.nodes])
        off = most(self.network.comm, abs(gap[hold.fixed]), 0.0)
        if off > OFF_PLANE * float(self.network.pitch.min()):
            raise InputError(
                f"test.fishnet: the laid cloth leaves a plane of symmetry by {length(off)}: the "
                'seed must lie there, and its yarns along it (generators = "upright", no turn)'
            )

    def _points(self) -> tuple[np.ndarray, np.ndarray]:
        """Crossovers and arm ends of this rank where the blank lies, (n, 3), m.

        And half the thickness of their ply, (n,), m.
        """
        if self.draped is not None:
            at = self.draped.laid.points
            return at, np.full(len(at), 0.5 * self.thickness)
        points, halves, low = [], [], 0.0
        for net, thick in zip(self.networks, self._thick, strict=True):
            flat = [net.crossover_position, net.node_position[: net.num_nodes_owned]]
            flat = np.concatenate(flat)
            points.append(np.pad(flat, ((0, 0), (0, 1)), constant_values=low + 0.5 * thick))
            halves.append(np.full(len(flat), 0.5 * thick))
            low += thick
        return np.concatenate(points), np.concatenate(halves)

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
        try:
            return self._touching(tool, axis)
        except InputError as error:
            raise InputError(
                f"{error}, or a larger blank: {self._size_text(self._box())} may fit into an "
                f"opening of a tool of {self._size_text(tool.surface.box)}"
            ) from None

    def _touching(self, tool: Tool, axis: np.ndarray) -> Tool:
        """Where a tool that comes along an axis touches the first of the plies."""
        points, half = self._points()
        starts, problem = [], None
        for h in sorted({0.5 * thick for thick in self._thick}):
            try:
                at = points[half == h]
                starts.append(tool.touching(at, axis, h, self.network.comm))
            except InputError as error:
                problem = error
        if problem is not None and not starts:
            raise problem
        return min(starts, key=lambda start: float(start.start.place @ axis))

    def _box(self) -> np.ndarray:
        """Least and largest x and y of the blank, float (2, 2), m."""
        bounds = np.array([net.preform.outline.bounds for net in self.networks])
        return np.array([bounds[:, :2].min(axis=0), bounds[:, 2:].max(axis=0)])

    @staticmethod
    def _size_text(box: np.ndarray) -> str:
        x, y = map(length, np.ptp(box, axis=0)[:2])
        return f"{x} x {y}"

    def _fit(self, table: ToolTable, tool: Tool) -> list[str]:
        """Remarks on a tool that hardly fits the blank or its net: radii, unit, upside down."""
        remarks, arm = [], 0.5 * max(float(net.pitch.max()) for net in self.networks)
        driven = any(tool.name in stage.moved for stage in self.stages)
        pushed = any(tool.name in stage.force for stage in self.stages)
        radius = min(tool.surface.closest_radius)
        if arm > COARSE * radius and (driven or not pushed):
            remarks.append(
                f'tool "{tool.name}" has radii down to {length(radius)}, '
                f"and the net's arms, of {length(arm)}, cut its corners: a "
                "smaller preform.yarns_per_cruciform, or a larger preform.refine"
            )
        if table.shape.file is None:
            return remarks
        blank, box = self._box(), tool.surface.box
        ratio = np.ptp(box[:, :2], axis=0).max() / np.ptp(blank, axis=0).max()
        if not 1.0 / FAR <= ratio <= FAR:
            remarks.append(
                f'tool "{tool.name}" is {self._size_text(box)}, the blank '
                f"{self._size_text(blank)}: is the unit of its file right?"
            )
        else:
            remarks += self._beside(tool)
        if driven:
            points, triangles = tool.surface.facets()
            towards, away = self._flats(tool.start.to_lab(points), triangles)
            if tool.name in self.below:
                towards, away = away, towards
            if towards > 2.0 * away + 0.01 * np.prod(np.ptp(blank, axis=0)):
                remarks.append(
                    f'tool "{tool.name}" meets the cloth with a flat, its other end has less of '
                    'one: is it upside down? turn = ["180 deg", "0 deg", "0 deg"] turns it over'
                )
        return remarks

    def _beside(self, tool: Tool) -> list[str]:
        """A remark on a tool that lies beside the blank in plan, by its bounding box."""
        blank, points = self._box(), tool.start.to_lab(tool.surface.facets()[0])[:, :2]
        box = np.array([points.min(axis=0), points.max(axis=0)])
        both = np.minimum(box[1], blank[1]) - np.maximum(box[0], blank[0])
        smaller = min(float(np.prod(np.ptp(each, axis=0))) for each in (box, blank))
        if np.prod(np.maximum(both, 0.0)) >= BESIDE * smaller or self.test.symmetry:
            return []
        x, y = map(length, tool.start.place[:2] - box.mean(axis=0) + blank.mean(axis=0))
        spans = [" to ".join(map(length, ends)) for ends in box.T]
        return [
            f'tool "{tool.name}" lies at x = {spans[0]}, y = {spans[1]}, mostly beside the blank, '
            "whose centre is x = y = 0: a file keeps its own origin; "
            f'place = ["{x}", "{y}"] puts its middle there'
        ]

    @staticmethod
    def _flats(points: np.ndarray, triangles: np.ndarray) -> tuple[float, float]:
        """Areas [m^2] of the facets that lie flat at the lower and the upper end of a tool."""
        corners = points[triangles]
        low, high = points[:, 2].min(), points[:, 2].max()
        a, b = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
        area = 0.5 * np.linalg.norm(np.cross(a, b), axis=1)
        near = 0.01 * (high - low)
        lower = (corners[..., 2] < low + near).all(axis=1)
        upper = (corners[..., 2] > high - near).all(axis=1)
        return float(area[lower].sum()), float(area[upper].sum())

    def _first_gaps(self) -> dict[str, float]:
        """Between blank and each tool at the start, m; InputError where they overlap."""
        (points, half), comm = self._points(), self.network.comm
        gaps = {}
        for tool in self.tools:
            gap = tool.look(points, tool.start)[0] - half
            gaps[tool.name] = least(comm, gap)
            if gaps[tool.name] < -DEEPEST * min(self._thick):
                at = int(np.argmin(gap)) if len(gap) else -1
                mine = (float(gap[at]), points[at].tolist()) if len(gap) else (np.inf, [])
                deep, (x, y, _) = min(comm.allgather(mine))
                raise InputError(
                    f'tool "{tool.name}" starts {length(-deep)} deep in the cloth, at '
                    f"x = {length(x)}, y = {length(y)}: give it a place farther "
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
                            f"{length(max(left, 0.0))} to tool "
                            f'"{low.name}", less than the cloth\'s thickness of '
                            f"{length(self.thickness)}"
                        )
        return remarks

    def _one_sided(self) -> list[str]:
        """Remarks on tools that are not the same on both sides of a plane of symmetry.

        One that lies on the blank's side of it stands for its mirror image, too.
        """
        remarks, side = [], self._box().mean(axis=0)
        for axis in self.test.axes:
            for tool in self.tools:
                image = tool.start.to_lab(tool.surface.facets()[0])
                if (image[:, axis] * side[axis] >= 0.0).all():
                    continue
                image[:, axis] *= -1.0
                off = float(abs(tool.look(image, tool.start)[0]).max())
                if off > ONE_SIDED * self.thickness:
                    remarks.append(
                        f'tool "{tool.name}" is not the same on both sides of the plane of '
                        f"symmetry {'xy'[axis]} = 0: by {length(off)}"
                    )
        return remarks

    def figures(self, formed: Formed) -> dict[str, Any]:
        """What only this kind tells of a forming, by keys of the summary. Collective."""
        return {}

    # -- what runs call ---------------------------------------------------------------------------

    def check(self) -> list[str]:
        """What there is to say before anything is solved: where tools start, and their gaps."""
        told = [] if self.draped is None else [self.draped.told()]
        for tool in self.tools:
            side = "below" if tool.name in self.below else "above"
            x, y, z = map(length, tool.start.place)
            gap = length(max(self.gaps[tool.name], 0.0))
            told.append(
                f'tool "{tool.name}", {side} the cloth, starts at {x}, {y}, {z}, {gap} from it'
            )
        return told

    def _between(self, state: State, number: int) -> State:
        """What a stage, by its number, begins with: rows laid anew. Collective."""
        assert self.rows is not None
        begins = 0 < number < len(self.rows.last)
        return self.rows.next(self.blank, state, number) if begins else state

    def solve(
        self,
        accepted: Callable[[FormingStep, State], None] | None = None,
        keeper: Keeper | None = None,
    ) -> Formed:
        """Form the blank; ``accepted`` and ``keeper`` are as of `form`. Collective.

        Raises
        ------
        EquilibriumError
            On every rank, with the stage and the place; its ``result`` is what was reached.
        """
        try:
            formed = form(
                self.blank,
                self.plans,
                options=self.options,
                accepted=accepted,
                keeper=keeper,
                between=self._between if self.rows is not None else None,
                modes=self.test.stability.modes if self.test.stability else 0,
            )
            return replace(formed, of=self)
        except EquilibriumError as error:
            if error.result is not None:
                error.result.of = self
            laying = 0 if self.rows is None else len(self.rows.last)
            explain(self.blank, self.stages, error, keeper is not None, self.kind, laying)
            raise


class Arranged(Forming):
    """A forming whose tools, clamps and stages follow from its own keys. Collective.

    Parameters
    ----------
    network : Network
        See Forming.
    options : mapping, optional
        PETSc options for the solver, without the prefix.
    **keys
        Those of the kind's `table`, as in ``[test]`` of a case file.
    """

    table: ClassVar[type[ArrangedTable]]
    reference = ""

    def __init__(
        self, network: Network, *, options: Mapping[str, object] | None = None, **keys: Any
    ):
        test = self.table.from_data({"kind": self.kind, **keys}, "test", bare=True)
        tools, clamps, stages = test.arranged()
        super().__init__(network, tools, stages, clamps, options=options, **keys)
