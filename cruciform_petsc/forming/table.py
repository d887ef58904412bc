# SPDX-License-Identifier: MIT
"""[test] kind = "forming" and [[stage]] of a case file. [[tool]] is in tools.tool."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Sequence
from functools import partial
from typing import Annotated, ClassVar, Literal

import numpy as np
from pydantic import AfterValidator, Field

from ..cloth.fabric import Fabric
from ..cloth.preform import Preform
from ..errors import Problems, unknown
from ..experiments.table import KindTable
from ..fields import Count, Name, Number, Of, Quantities, Size, Table, si_values
from ..tools.motion import Motion, Pose
from ..tools.tool import Curve, Place, ToolTable, TurnTable, motion
from ..units import Quantity
from .press import LARGEST_STEP, StagePlan

STILL_STEP = 0.25  # of a stage without travel: cloth may sag far, and work is added up by steps
# Names of what else acts on the cloth.
TAKEN = ("bends", "cruciforms", "gravity", "imperfection", "loads", "viscosity")


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


class FormingTable(KindTable):
    """A blank of cloth laid on tools, held and pressed by them, stage by stage."""

    edges: ClassVar = ()
    centred: ClassVar = True
    finite: ClassVar[bool] = True
    space: ClassVar[bool] = True

    kind: Literal["forming"]
    gravity: bool = False
    """Weight of the cloth, along -z."""
    imperfection: WavesTable = WavesTable()
    """What the blank is not flat by. Example: `{ height = "0.05 mm", seed = 2 }`"""
    contact: ContactTable = ContactTable()
    """Compaction, elastic slip and viscosity, where they shall be others than the program's.
    Example: `{ stiffness = "20 kPa/mm" }`"""

    @classmethod
    def own_keys(cls) -> list[str]:
        """Keys that only this kind has."""
        return [key for key in cls.model_fields if key not in KindTable.model_fields]

    def check(self, preform: Preform, fabric: Fabric) -> None:
        """See KindTable.check."""
        problems = Problems()
        with problems.caught():
            super().check(preform, fabric)
        by = 'test.kind = "forming"'
        with problems.caught():
            fabric.needed("thickness", by)
        with problems.caught():
            fabric.out_of_plane(by)
        if self.gravity:
            with problems.caught():
                fabric.needed("areal_density", "test.gravity = true")
        problems.tell()


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
        factors = dict.fromkeys(self.remove, 0.0)
        return StagePlan(self.name, motions, forces, factors, self.results, self.largest_step)


def check_stages(tools: Sequence[ToolTable], stages: Sequence[StageTable], gravity: bool) -> None:
    """Raise InputError if stages do not fit the tools, or either are missing."""
    problems = Problems()
    names = [tool.name for tool in tools]
    for key, count in (("tool", len(tools)), ("stage", len(stages))):
        if not count:
            problems.append(f'test.kind = "forming" needs at least one [[{key}]]')
    for i, name in enumerate(names):
        key = f'tool[{i}].name = "{name}"'
        if not re.fullmatch(r"\w(?:[\w -]{0,38}\w)?", name):
            problems.append(f'{key} must be of up to 40 letters, digits, "_", "-" and blanks')
        elif name in TAKEN:
            problems.append(f"{key} is what the program calls something else, choose another")
        elif name in names[:i]:
            problems.append(f"{key} is another tool's name, too")
    gone: set[str] = set()
    for i, stage in enumerate(stages):
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
        if gravity and names and gone >= set(names):
            problems.append(f"stage[{i}].remove: without any tool nothing holds the cloth's weight")
            break
    problems.tell()


def below_cloth(tools: Sequence[ToolTable], stages: Sequence[StageTable]) -> set[str]:
    """Names of the tools that the cloth lies on; the others come from above.

    What looks up (side = "+z") is below, what looks down ("-z") above. Of the others those are
    above that travel downwards first or are pushed downwards, or by a force "towards the cloth";
    those that go up, or never move, are below.
    """
    below = set()
    for tool in tools:
        up = {"+z": 1.0, "-z": -1.0}.get(tool.shape.side or "", 0.0)
        for stage in stages:
            if up == 0.0 and tool.name in stage.travel:
                up = float(np.sign(stage.travel[tool.name][2].si))
            elif up == 0.0 and tool.name in stage.force:
                force = stage.force[tool.name]
                up = float(np.sign(force[2].si)) if isinstance(force, list) else -1.0
        if up >= 0.0:
            below.add(tool.name)
    return below
