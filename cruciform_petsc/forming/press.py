# SPDX-License-Identifier: MIT
"""Stages of a forming: how tools travel, turn and are pushed, as equilibrium follows it.

Time is the number of stages that are done, and the share of the one that runs.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from ..equilibrium.stages import Measured, Stage
from ..equilibrium.state import Found, Hold
from ..tools.motion import Motion, Pose
from .blank import Blank, push_name

LARGEST_STEP = 1 / 10  # of a stage, if nothing else is said
EASY = 20  # Newton steps, of all rounds of friction together


def stage_number(time: float) -> int:
    """Number of the stage, from 0, that a time lies in; its end belongs to it."""
    return max(int(np.ceil(time - 1e-9)) - 1, 0)


def targets(number: int, results: int) -> list[float]:
    """Times of the results of a stage, by its number from 0."""
    return [number + (k + 1) / results for k in range(results)]


@dataclass(frozen=True)
class StagePlan:
    """What happens in a stage; what is not named stays as it was.

    Attributes
    ----------
    name : str
    motions : mapping
        By tool: Pose at the stage's beginning -> Motion.
    forces : mapping
        By tool: force on it at the stage's end, (3,), N; it moves along the axes that have one.
    factors : mapping
        Sizes of loads and of contacts at the stage's end, by name of their items: a contact that
        goes to 0 is a tool that is taken away.
    results : int
        Steps asked for, evenly.
    step : float
        Largest step, as a share of the stage.
    """

    name: str
    motions: Mapping[str, Callable[[Pose], Motion]] = field(default_factory=dict)
    forces: Mapping[str, np.ndarray] = field(default_factory=dict)
    factors: Mapping[str, float] = field(default_factory=dict)
    results: int = 1
    step: float = LARGEST_STEP


@dataclass(frozen=True)
class Posture:
    """How tools stand and what pushes them between two stages.

    Attributes
    ----------
    poses : list of Pose
        By tool.
    forces : float (n tools, 3), N
    free : bool (n tools, 3)
    factors : mapping
        See StagePlan.
    """

    poses: list[Pose]
    forces: np.ndarray
    free: np.ndarray
    factors: Mapping[str, float]

    @classmethod
    def at_the_start(cls, blank: Blank) -> Posture:
        """Before the first stage."""
        shape, poses = (len(blank.tools), 3), [tool.start for tool in blank.tools]
        return cls(poses, np.zeros(shape), np.zeros(shape, bool), blank.factors)


class Press:
    """One stage on a blank: drives its tools.

    Parameters
    ----------
    blank : Blank
    plan : StagePlan
    before : Posture
    begin : float
        Time at which it begins.
    """

    def __init__(self, blank: Blank, plan: StagePlan, before: Posture, begin: float):
        self.blank, self.plan, self.before, self.begin = blank, plan, before, begin
        names = [tool.name for tool in blank.tools]
        self.forces, self.free = before.forces.copy(), before.free.copy()
        self.motions = [Motion(pose) for pose in before.poses]
        for name, force in plan.forces.items():
            i = names.index(name)
            self.forces[i], self.free[i] = force, np.asarray(force) != 0.0
        for name, make in plan.motions.items():
            i = names.index(name)
            self.motions[i] = make(before.poses[i])
            self.forces[i], self.free[i] = 0.0, False
        self.factors = {**before.factors, **plan.factors}

    def drive(self, time: float) -> tuple[Hold, dict[str, float]]:
        """See Stage.drive."""
        s = time - self.begin
        tools = self.blank.tools
        poses = [motion.at(s) for motion in self.motions]
        rotations = {tool.name: pose.turn for tool, pose in zip(tools, poses, strict=True)}
        place = np.array([pose.place for pose in poses]).reshape(-1, 3)
        hold = self.blank.hold(place, self.free, rotations)
        factors = {
            name: (1.0 - s) * self.before.factors.get(name, 1.0) + s * value
            for name, value in self.factors.items()
        }
        for tool, force in zip(tools, self.push(time), strict=True):
            factors |= {push_name(tool.name, axis): force[axis] for axis in range(3)}
        return hold, factors

    def push(self, time: float) -> np.ndarray:
        """Forces that push the tools, (n tools, 3), N."""
        s = time - self.begin
        return (1.0 - s) * self.before.forces + s * self.forces

    def stage(self, measure: Callable[[Found], Measured]) -> Stage:
        """As equilibrium follows it."""
        return Stage(
            self.plan.name,
            self.drive,
            targets(int(self.begin), self.plan.results),
            self.plan.step,
            measure=measure,
            carry_on=False,
            easy=EASY,
        )

    def after(self, places: np.ndarray) -> Posture:
        """How tools stand at its end, which has brought them to places (n tools, 3), m."""
        poses = [
            replace(motion.at(1.0), place=place)
            for motion, place in zip(self.motions, places, strict=True)
        ]
        return Posture(poses, self.forces, self.free, self.factors)
