# SPDX-License-Identifier: MIT
"""[test] kind = "forming" and [[stage]] of a case file. [[tool]] is in tools.tool."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Iterator, Sequence
from functools import partial
from typing import Annotated, Any, ClassVar, Literal

import numpy as np
import shapely
from pydantic import AfterValidator, Field, model_validator

from ..cloth.fabric import Fabric
from ..cloth.preform import Preform
from ..errors import InputError, Problems, unknown
from ..experiments.table import KindTable, check_viscosity
from ..fields import (
    Count,
    Length,
    Name,
    Number,
    Of,
    Quantities,
    Ring,
    Sides,
    Size,
    Table,
    si_values,
)
from ..items.clamps import Clamp, clamp_name
from ..items.cruciforms import Course
from ..items.nodes import PlyNodes
from ..tools.motion import Motion, Pose
from ..tools.tool import Curve, Place, ToolTable, TurnTable, motion
from ..units import Quantity, format_si
from .fishnet_table import StartTable
from .press import LARGEST_STEP, StagePlan, stage_number

STILL_STEP = 0.25  # of a stage without travel: cloth may sag far, and work is added up by steps
# Names of what else acts on the cloth.
PRESSURES = ("pressure", "suction")
TAKEN = (
    "bends",
    "cruciforms",
    "gravity",
    "imperfection",
    "loads",
    *PRESSURES,
    "twist",
    "viscosity",
)


def _a_force(force: Quantities) -> Quantities:
    values = si_values(force)
    if isinstance(force, list):
        if len(values) != 3:
            raise ValueError(f"must be one force, or a list of 3 for x, y and z, got {len(values)}")
    elif values[0] < 0.0:
        raise ValueError(f'must be positive, towards the cloth, got "{force}"')
    if not any(values):
        raise ValueError("is zero: a tool that is not pushed stays where it is")
    return force


def _a_share(step: float) -> float:
    if not 1e-4 <= step <= 1.0:
        raise ValueError(f"must be a share of the stage from 0.0001 to 1, got {step:g}")
    return step


Height = Annotated[Quantity, Of("m", good=lambda h: h >= 0.0, wanted="zero or positive")]
Stiffness = Annotated[Quantity, Of("N/m**3", good=lambda k: k > 0.0, wanted="positive")]
Viscosity = Annotated[Quantity, Of("N*s/m**3", good=lambda c: c >= 0.0, wanted="zero or positive")]
Force = Annotated[Quantities, Of("N", many=True, example="100 N"), AfterValidator(_a_force)]
Step = Annotated[Number, AfterValidator(_a_share)]
Pressure = Annotated[Quantity, Of("Pa")]
SideName = Literal["left", "right", "lower", "upper"]
_NORMAL = {"left": 0, "right": 0, "lower": 1, "upper": 1}
_POSITIVE: dict[str, Any] = {"good": lambda value: value > 0.0, "wanted": "positive"}


class WavesTable(Table):
    """[test] imperfection of forming: what the blank is not flat by, which seeds wrinkles."""

    height: Height | None = None
    """Greatest height of waves over the blank. The default is 1 % of the cloth's thickness; with
    "0 mm" wrinkles start from rounding, if at all. Example: `"0.05 mm"`"""
    seed: Annotated[int, Field(ge=0)] = 1
    """Another number, other waves; the same ones on any number of processes and for any pitch."""


class ContactTable(Table):
    """[test] contact: how cloth touches tools; what is left out follows from the fabric."""

    stiffness: Stiffness | None = None
    """Pressure over compaction, of the cloth between its middle and a tool.
    Example: `"20 kPa/mm"`"""
    elastic_slip: Size | None = None
    """Up to which friction gives like a spring. Example: `"0.01 mm"`"""
    viscosity: Viscosity | None = None
    """Pressure over speed, with a second for each stage: chooses one way through wrinkling.
    Example: `"20 N s/m^3"`"""


class ClampTable(Table):
    """[[clamp]]: an edge whose yarn ends are held in place, or by springs; they may turn there."""

    edge: Name
    """Which edge: "left", "right", "lower", "upper", or a piece of the outline, "outline-3"."""
    stiffness: Annotated[Quantity, Of("N*m/m**2", other="N/m/m", **_POSITIVE)] | None = None
    """Of springs between yarn ends and the ground, the same in all directions: of the whole clamp,
    or per width, told apart by the unit. By default nothing gives. Example: `"2 N/mm"`"""
    preload: Annotated[Quantity, Of("N", other="N/m", **_POSITIVE)] | None = None
    """By which the springs pull outwards in the end, all else at rest: it grows over the first
    stage. Of the whole clamp, or per width. Example: `"10 N"`"""
    friction_limit: Annotated[Quantity, Of("N", other="N/m", **_POSITIVE)] | None = None
    """Beyond which yarn ends slip. Of the whole clamp, or per width. Example: `"50 N"`"""
    slides: bool = False
    """Held in height only: the seam of a cushion of which this is one half."""
    lift: Annotated[list[Length], Field(min_length=2, max_length=2)] | None = None
    """By which the edge's ends are raised over the first stage, straight between them: its first
    and its last corner, with the cloth on the left. Example: `["0 mm", "200 mm"]`"""

    @model_validator(mode="after")
    def _a_spring(self) -> ClampTable:
        if self.preload is not None and self.stiffness is None:
            raise ValueError(".preload is of springs: give their stiffness, too")
        told = [key for key in ("stiffness", "preload", "friction_limit") if getattr(self, key)]
        if self.slides and told:
            raise ValueError(f".slides = true holds in height only, without {told[0]}")
        return self

    @property
    def holds(self) -> bool:
        """Whether the edge stays where it is, or slides in its plane."""
        return self.stiffness is None and self.friction_limit is None

    def build(self, ply: PlyNodes) -> Clamp:
        """Make it of a ply. Collective."""
        stiffness, preload, limit = (
            None if told is None else (told.si, told.unit == per_width)
            for told, per_width in (
                (self.stiffness, "N/m/m"), (self.preload, "N/m"), (self.friction_limit, "N/m")
            )
        )  # fmt: skip
        lift = None if self.lift is None else si_values(self.lift)
        return Clamp(ply, self.edge, stiffness, preload, limit, slides=self.slides, lift=lift)


class SoftestTable(Table):
    """[test] stability of a forming (docs/stability.md)."""

    modes: Annotated[Count, Field(le=20)] = 1
    """How many shapes are looked for, of the last step."""


class FormingTable(KindTable):
    """A blank of cloth laid on tools, held and pressed by them, stage by stage."""

    edges: ClassVar = ()
    finite: ClassVar[bool] = True
    space: ClassVar[bool] = True

    kind: Literal["forming"]
    gravity: bool = False
    """Weight of the cloth, along -z."""
    imperfection: WavesTable = WavesTable()
    """What the blank is not flat by. Example: `{ height = "0.05 mm", seed = 2 }`"""
    symmetry: list[SideName] = Field(default=[])
    """Straight sides that lie in planes of symmetry, so that a half or a quarter does for the
    whole: x = 0 or y = 0 is there. Forces and energies are those of this part. Yarns must run along
    and across them. Example: `["left", "lower"]`"""
    fishnet: StartTable | None = None
    """Begin with the cloth laid on a tool as a net of yarns that keep their lengths.
    Example: `{ seed = ["0 mm", "0 mm"] }`"""
    temperature: Annotated[Quantity, Of("K")] | None = None
    """Of the cloth, for fabric.shear_viscosity; by default that of its measurement. Stages may have
    their own."""
    stability: SoftestTable | None = None
    """Tell the lowest stiffness of each step, and the softest shape at the end.
    Example: `{ modes = 1 }`"""
    contact: ContactTable = ContactTable()
    """Compaction, elastic slip and viscosity, where they shall be others than the program's.
    Example: `{ stiffness = "20 kPa/mm" }`"""

    @classmethod
    def own_keys(cls) -> list[str]:
        """Keys that only this kind has."""
        return [key for key in cls.model_fields if key not in KindTable.model_fields]

    def placed(self, preform: Preform) -> Preform:
        """See KindTable.placed: centre or planes of symmetry at x = y = 0."""
        return preform.centred([side for side in self.symmetry if side in preform.edges])

    @property
    def axes(self) -> list[int]:
        """Axes, 0 or 1, that are normals of planes of symmetry."""
        return sorted({_NORMAL[side] for side in self.symmetry})

    def check(self, preform: Preform, fabric: Fabric) -> None:
        """See KindTable.check."""
        problems = Problems()
        for side in dict.fromkeys(self.symmetry):
            with problems.caught():
                try:
                    preform.edge(side)
                except InputError as error:
                    raise InputError(f"test.symmetry: {error}") from None
        if self.symmetry and abs(np.sin(2.0 * preform.bias_angle)) > 1e-9:
            problems.append(
                "test.symmetry needs yarns along and across the planes: preform.bias_angle = "
                f'"0 deg" or "90 deg", got "{format_si(preform.bias_angle, "rad")}"'
            )
        with problems.caught():
            super().check(preform, fabric)
        by = f'test.kind = "{self.kind}"'
        with problems.caught():
            fabric.needed("thickness", by)
        with problems.caught():
            fabric.out_of_plane(by)
        problems += check_viscosity(fabric, self.temperature, "test.temperature")
        if self.gravity:
            with problems.caught():
                fabric.needed("areal_density", "test.gravity = true")
        if laying_stages(self) and fabric.shear_viscosity is not None:
            problems.append(
                "test.fishnet.pieces are laid in no time, which fabric.shear_viscosity needs: "
                "leave one of them out"
            )
        if self.model == "truss" and self.fishnet is not None and self.fishnet.press is not None:
            problems.append(
                'test.fishnet.press is not for test.model = "truss", whose surface it would not '
                "follow"
            )
        problems.tell()


class ArrangedTable(FormingTable):
    """A forming whose tools, clamps and stages follow from keys of its own."""

    def arranged(self) -> tuple[list[ToolTable], list[ClampTable], list[StageTable]]:
        """Make them."""
        raise NotImplementedError


class TrimTable(Table):
    """[[stage]] trim: what stays of the blank, on the flat, about the origin."""

    radius: Size | None = None
    """Of a circle. Example: `"60 mm"`"""
    rectangle: Sides | None = None
    """Width and length. Example: `["100 mm", "80 mm"]`"""
    polygon: Ring | None = None
    """Corners. Example: `[["0 mm", "0 mm"], ["80 mm", "0 mm"], ["80 mm", "90 mm"]]`"""

    @model_validator(mode="after")
    def _one_shape(self) -> TrimTable:
        if (self.radius, self.rectangle, self.polygon).count(None) != 2:
            raise ValueError("needs exactly one of radius, rectangle and polygon")
        if self.polygon is not None and not self.build().is_valid:
            raise ValueError(".polygon crosses or touches itself")
        return self

    def build(self) -> shapely.Polygon:
        """Make it, in metres."""
        if self.radius is not None:
            return shapely.Point(0.0, 0.0).buffer(self.radius.si, quad_segs=64)
        if self.rectangle is not None:
            x, y = 0.5 * np.array(si_values(self.rectangle))
            return shapely.box(-x, -y, x, y)
        return shapely.Polygon([si_values(point) for point in self.polygon or ()])


class StageTable(Table):
    """[[stage]]: what tools do next; what is not named stays as it was."""

    name: Name
    """What log and results call it."""
    travel: dict[str, Place] = Field(default={})
    """How far tools go, x, y, z, from where they are. Zeros stop a tool that a force has pushed.
    Example: `{ punch = ["0 mm", "0 mm", "-50 mm"] }`"""
    turn: dict[str, TurnTable] = Field(default={})
    """How tools turn. Example: `{ punch = { angle = "10 deg", axis = [0.0, 1.0, 0.0] } }`"""
    curve: dict[str, Curve] = Field(default={})
    """Share of a tool's way over share of the stage, for those that travel or turn.
    Example: `{ punch = [[0.0, 0.0], [0.5, 0.8], [1.0, 1.0]] }`"""
    force: dict[str, Force] = Field(default={})
    """Force on tools at the stage's end, from then on; they move along it. One force: towards the
    cloth. Example: `{ holder = "100 N" }`"""
    remove: list[Name] = Field(default=[])
    """Tools that are taken away. Example: `["holder"]`"""
    trim: TrimTable | None = None
    """What stays of the blank: cloth beyond is cut off. Example: `{ radius = "60 mm" }`"""
    release: list[Name] = Field(default=[])
    """Edges whose clamps let go. Example: `["left"]`"""
    pressure: Pressure | None = None
    """On the cloth's upper face at the stage's end, from then on; it follows the cloth. Negative:
    on the lower face. For cloth whose edges are all held, or lie in planes of symmetry.
    Example: `"-5 kPa"`"""
    suction: Pressure | None = None
    """Alike, right at free edges, too: what a vacuum under the cloth pulls it down by. Negative:
    upwards. Example: `"80 kPa"`"""
    duration: Annotated[Quantity, Of("s", good=lambda s: s > 0.0, wanted="positive")] | None = None
    """How long the stage takes, for cloth with fabric.shear_viscosity. Example: `"2 s"`"""
    temperature: Annotated[Quantity, Of("K")] | None = None
    """Of the cloth from this stage on, in place of test.temperature. Example: `"120 degC"`"""
    results: Annotated[Count, Field(le=10_000)] = 1
    """States that are written, evenly over the stage."""
    step: Step | None = None
    """Largest step, as a share of the stage; the default is 0.1 where tools travel or turn, else
    0.25. Steps are cut further where needed. Example: `0.05`"""

    @property
    def moved(self) -> set[str]:
        """Tools that travel or turn."""
        return self.travel.keys() | self.turn.keys()

    @property
    def largest_step(self) -> float:
        """As a share of the stage."""
        return self.step or (LARGEST_STEP if self.moved else STILL_STEP)

    @property
    def steps(self) -> int:
        """How many there are at least."""
        return max(self.results, int(np.ceil(1.0 / self.largest_step)))

    def plan(self, below: set[str]) -> StagePlan:
        """What the press does; tools in ``below`` lie below the cloth, the others above."""
        motions: dict[str, Callable[[Pose], Motion]] = {
            name: partial(
                motion,
                travel=self.travel.get(name),
                turn=self.turn.get(name),
                curve=self.curve.get(name),
            )
            for name in sorted(self.moved)
        }
        motions |= dict.fromkeys(self.remove, Motion)  # it stays while contact fades
        forces = {}
        for name, force in self.force.items():
            values = np.array(si_values(force))
            up = 1.0 if name in below else -1.0
            forces[name] = values if len(values) == 3 else np.array([0.0, 0.0, up * values[0]])
        factors = dict.fromkeys((*self.remove, *map(clamp_name, self.release)), 0.0)
        factors |= {key: told.si for key in PRESSURES if (told := getattr(self, key)) is not None}
        return StagePlan(self.name, motions, forces, factors, self.results, self.largest_step)


def laying_stages(test: FormingTable) -> list[StageTable]:
    """Stages in which pieces of the cloth are laid, before those of the case."""
    table = test.fishnet
    if table is None or table.pieces is None:
        return []
    names = [f"lay {number}" for number in range(1, table.pieces + 1)]
    return [StageTable(name=name) for name in names]


def check_course(test: FormingTable, fabric: Fabric, stages: Sequence[StageTable]) -> None:
    """Raise InputError if the time or the temperature of stages is missing, or is for nothing."""
    problems, flows = Problems(), fabric.shear_viscosity is not None
    if flows and isinstance(test, ArrangedTable):
        raise InputError(
            f'test.kind = "{test.kind}" runs at no speed that fabric.shear_viscosity could act by, '
            "leave that out"
        )
    for i, stage in enumerate(stages):
        if flows and stage.duration is None:
            problems.append(
                f"stage[{i}].duration is missing, which fabric.shear_viscosity needs: for example "
                '"2 s"'
            )
        elif stage.duration is not None and not flows:
            problems.append(
                f"stage[{i}].duration matters with fabric.shear_viscosity only, leave it out"
            )
        problems += check_viscosity(fabric, stage.temperature, f"stage[{i}].temperature")
    problems.tell()


def course_of(test: FormingTable, stages: Sequence[StageTable]) -> Course:
    """How stages run in time and temperature."""
    ends = np.cumsum([0.0, *(0.0 if s.duration is None else s.duration.si for s in stages)])
    told, temperatures = test.temperature, []
    for stage in stages:
        told = stage.temperature or told
        temperatures.append(None if told is None else told.si)
    begins = np.arange(len(ends), dtype=float)

    def seconds(before: float, now: float) -> float:
        return float(np.interp(now, begins, ends) - np.interp(before, begins, ends))

    return Course(seconds, lambda now: temperatures[stage_number(now)])


def check_stages(
    test: FormingTable,
    tools: Sequence[ToolTable],
    stages: Sequence[StageTable],
    clamps: Sequence[ClampTable] = (),
) -> None:
    """Raise InputError if stages do not fit tools and clamps, or there are none."""
    problems = Problems()
    names, held = [tool.name for tool in tools], [clamp.edge for clamp in clamps]
    if not tools and not clamps:
        problems.append('test.kind = "forming" needs at least one [[tool]] or [[clamp]]')
    if not stages:
        problems.append('test.kind = "forming" needs at least one [[stage]]')
    for i, name in enumerate(names):
        key = f'tool[{i}].name = "{name}"'
        if not re.fullmatch(r"\w(?:[\w -]{0,38}\w)?", name):
            problems.append(f'{key} must be of up to 40 letters, digits, "_", "-" and blanks')
        elif name in TAKEN or name.startswith(("clamp ", "preload ", "rows ", "trim ")):
            problems.append(f"{key} is what the program calls something else, choose another")
        elif name in names[:i]:
            problems.append(f"{key} is another tool's name, too")
    for i, edge in enumerate(held):
        if edge in test.symmetry:
            problems.append(f'clamp[{i}].edge = "{edge}" lies in a plane of symmetry')
        elif edge in held[:i]:
            problems.append(f'clamp[{i}].edge = "{edge}" has another clamp, too')
    problems += _laid_on(test, tools, stages, clamps)
    gone: set[str] = set()
    let_go: set[str] = set()
    for i, stage in enumerate(stages):
        pushed = [key for key in PRESSURES if getattr(stage, key) is not None]
        if pushed and test.model == "truss":
            problems.append(
                f'stage[{i}].{pushed[0]} is not for test.model = "truss", whose surface it would '
                "not follow"
            )
        problems += _across_planes(test, f"stage[{i}]", stage)
        for edge in stage.release:
            if edge not in held:
                problems.append(f'stage[{i}].release: there is no [[clamp]] of the edge "{edge}"')
            elif edge in let_go:
                problems.append(f'stage[{i}].release: "{edge}" was released in an earlier stage')
        let_go |= set(stage.release)
        told: dict[str, Iterable[str]] = {
            "travel": stage.travel, "turn": stage.turn, "curve": stage.curve,
            "force": stage.force, "remove": stage.remove,
        }  # fmt: skip
        for key, tools_named in told.items():
            for name in tools_named:
                where = f"stage[{i}].{key}"
                if name not in names:
                    if names:
                        problems.append(f"{where}: {unknown(f'tool {name!r}', name, names)}")
                elif name in gone:
                    problems.append(f'{where}: tool "{name}" was removed in an earlier stage')
                elif key == "curve" and name not in stage.moved:
                    problems.append(f'{where}: tool "{name}" does not travel or turn in this stage')
                elif key == "force" and name in stage.moved:
                    problems.append(
                        f'{where}: tool "{name}" travels or turns in this stage, it cannot be '
                        "pushed by a force, too"
                    )
                elif key == "remove" and name in stage.moved | stage.force.keys():
                    problems.append(
                        f'{where}: tool "{name}" moves in this stage, remove it in a later one'
                    )
        gone |= set(stage.remove)
        if test.gravity and names and gone >= set(names) and let_go >= set(held):
            problems.append(f"stage[{i}].remove: without any tool nothing holds the cloth's weight")
            break
    problems.tell()


def _laid_on(
    test: FormingTable,
    tools: Sequence[ToolTable],
    stages: Sequence[StageTable],
    clamps: Sequence[ClampTable],
) -> Iterator[str]:
    """What does not go with a blank that begins laid on a tool, in sentences."""
    if test.fishnet is None:
        return
    names, name = [tool.name for tool in tools], test.fishnet.tool
    if clamps:
        yield "test.fishnet: [[clamp]] holds edges of a flat blank, leave one of them out"
    if test.symmetry and test.fishnet.least_energy is not None:
        yield "test.fishnet.least_energy moves the seed, which test.symmetry holds: leave one out"
    if not names:
        yield "test.fishnet needs a [[tool]] to lay the cloth on"
    elif name is not None and name not in names:
        yield f"test.fishnet.tool: {unknown(f'tool {name!r}', name, names)}"
    elif name is None and len(below_cloth(tools, stages)) != 1:
        yield (
            "test.fishnet.tool is missing, which tells what the cloth is laid on: one of "
            f"{', '.join(names)}"
        )


def _across_planes(test: FormingTable, key: str, stage: StageTable) -> Iterator[str]:
    """What of a stage goes through planes of symmetry, in sentences."""
    for axis in test.axes:
        plane = f"the plane of symmetry {'xy'[axis]} = 0"
        forces = {name: f for name, f in stage.force.items() if isinstance(f, list)}
        for word, ways in (("travel", stage.travel), ("force", forces)):
            for name, way in ways.items():
                if way[axis].si != 0.0:
                    yield f'{key}.{word}: tool "{name}" would leave {plane}'
        for name, turn in stage.turn.items():
            if any(value for k, value in enumerate(turn.axis) if k != axis):
                yield f'{key}.turn: tool "{name}" would turn out of {plane}'


def check_several(
    test: FormingTable, stages: Sequence[StageTable], clamps: Sequence[ClampTable] = ()
) -> None:
    """Raise InputError for what a forming of several plies does not know."""
    problems = Problems()
    for what, there in (
        ('test.model = "truss"', test.model == "truss"),
        ("test.fishnet", test.fishnet is not None),
        ("test.stability", test.stability is not None),
        ("[[clamp]]", bool(clamps)),
        *(
            (f"stage[{i}].{key}", getattr(stage, key) is not None)
            for i, stage in enumerate(stages)
            for key in PRESSURES
        ),
    ):
        if there:
            problems.append(f"{what} is not for several plies yet, leave it or [[ply]] out")
    problems.tell()


def check_pressure(
    test: FormingTable,
    preform: Preform,
    stages: Sequence[StageTable],
    clamps: Sequence[ClampTable] = (),
) -> None:
    """Raise InputError if there is pressure, as other than suction, on cloth with a free edge."""
    problems, on, holds = Problems(), False, {clamp.edge for clamp in clamps if clamp.holds}
    advice = (
        "which follows the cloth and is right only where all edges are held ([[clamp]] without "
        "springs) or lie in planes of symmetry; suction is right there"
    )
    for clamp in clamps:
        with problems.caught():
            preform.edge(clamp.edge)
    problems.tell()
    edges = preform.edges
    pieces = {name: edges[name] for name in edges if name.startswith(("outline-", "hole-"))}
    for i, stage in enumerate(stages):
        holds -= set(stage.release)
        before, on = on, on if stage.pressure is None else stage.pressure.si != 0.0
        if not before and not on:
            continue
        known = [piece for name in (*test.symmetry, *sorted(holds)) for piece in preform.edge(name)]
        sure = {piece.tobytes() for piece in known}
        free = [name for name, e in pieces.items() if any(s.tobytes() not in sure for s in e)]
        if any(earlier.trim is not None for earlier in stages[: i + 1]):
            problems.append(
                f"stage[{i}]: cloth is trimmed, so that its edge is free under pressure, {advice}"
            )
            break
        if free:
            problems.append(f'stage[{i}]: the edge "{free[0]}" is free under pressure, {advice}')
            break
    problems.tell()


def below_cloth(tools: Sequence[ToolTable], stages: Sequence[StageTable]) -> set[str]:
    """Names of the tools that the cloth lies on; the others come from above.

    What looks up (side = "+z") is below, what looks down ("-z") above, as it lies once it has been
    turned: a skin of which the cloth lies at "+z" in its file looks down when it is turned over. Of
    the others, those that look aside too, those are
    above that travel downwards first or are pushed downwards, or by a force "towards the cloth";
    those that go up, or never move, are below.
    """
    below = set()
    for tool in tools:
        up = float(np.sign(np.round(tool.looks[2], 6)))
        for stage in stages:
            if up == 0.0 and tool.name in stage.travel:
                up = float(np.sign(stage.travel[tool.name][2].si))
            elif up == 0.0 and tool.name in stage.force:
                force = stage.force[tool.name]
                up = float(np.sign(force[2].si)) if isinstance(force, list) else -1.0
        if up >= 0.0:
            below.add(tool.name)
    return below
