# SPDX-License-Identifier: MIT
"""Forming a blank, stage by stage: steps, forces of tools, energies, work."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Annotated, Any

import numpy as np
from pydantic import ConfigDict, Field, PlainValidator, TypeAdapter

from ..drawn import InSpace, Mapped, Plotted, Shown
from ..equilibrium.follow import Path, follow
from ..equilibrium.newton import Equilibrium
from ..equilibrium.stability import Modes, Stability
from ..equilibrium.stages import Increment, Measured, Step
from ..equilibrium.state import Found, State
from ..errors import CruciformError, EquilibriumError
from ..experiments.finite import Keeper
from .blank import Blank
from .measures import squeezed
from .press import Posture, Press, StagePlan, stage_number

RESIDUAL = 1e-4  # of the forces that hold and load tools (forming.md section 1)
LONGEST = 0.5  # of a pitch, in a Newton step
FIRST_STEP = 1e-2  # of the largest, where the cloth begins laid on a tool
MOST_ITERATIONS = 400  # where cloth snaps the way is long, and shorter steps do not shorten it

_Three = Annotated[list[float], Field(min_length=3, max_length=3)]
_three = TypeAdapter(_Three, config=ConfigDict(strict=True, allow_inf_nan=False)).validate_python
Vector = Annotated[np.ndarray, PlainValidator(lambda values: np.array(_three(values)))]


@dataclass(frozen=True)
class FormingStep:
    """An accepted step.

    Attributes
    ----------
    stage : str
    increment : Increment
        Its control is the time: stages that are done, and the share of this one.
    tool_force : dict of float (3,)
        On the cloth by each tool, N.
    tool_place : dict of float (3,)
        m.
    tool_moment : dict of float (3,)
        On the cloth by each tool about its origin, where ``tool_place`` has it, N m.
    spent : dict
        What friction and viscosity have dissipated up to here, J.
    work : float
        What has been done on tools up to here, by trapezia over the steps, J.
    load_work : dict of float
        What gravity, pressures, clamps have done on the cloth up to here, likewise.
    clamp_force : dict of float (3,)
        On the cloth by the clamp of each edge, N.
    softest : float, optional
        Lowest stiffness, N/m^3, where it is looked at (equilibrium.stability): of cloth, tools and
        friction as it holds, without viscosity.
    """

    stage: str
    increment: Increment
    tool_force: Mapping[str, Vector]
    tool_place: Mapping[str, Vector]
    tool_moment: Mapping[str, Vector]
    spent: Mapping[str, float]
    work: float
    load_work: Mapping[str, float]
    clamp_force: Mapping[str, Vector]
    softest: float | None = None

    @property
    def of_tools(self) -> tuple[Mapping[str, Vector], ...]:
        """All vectors that there are by tool."""
        return self.tool_force, self.tool_place, self.tool_moment


@dataclass
class Formed(Shown, Plotted, Mapped, InSpace):
    """What a forming has come to.

    Attributes
    ----------
    blank : Blank
    steps : list of FormingStep
        All that were accepted.
    states : list of State
        Those asked for; the last one that was accepted is the last here.
    modes : Modes
        The softest shapes of the last state, where they are looked for; else None.
    of : Forming
        What was formed; None of a blank without one.
    """

    blank: Blank
    steps: list[FormingStep] = field(default_factory=list)
    states: list[State] = field(default_factory=list)
    modes: Modes | None = None
    of: Any = None  # its module imports this one

    def __repr__(self) -> str:
        done = f"{self.steps[-1].increment.control:.4g} stages done, " if self.steps else ""
        return f"Formed({len(self.steps)} steps, {done}{self.blank.network!r})"

    def add(self, step: FormingStep, state: State) -> None:
        """Add an accepted step."""
        if self.steps and not self.steps[-1].increment.asked:
            self.states.pop()
        self.steps.append(step)
        self.states.append(state)


def form(
    blank: Blank,
    plans: Sequence[StagePlan],
    *,
    options: Mapping[str, object] | None = None,
    accepted: Callable[[FormingStep, State], None] | None = None,
    keeper: Keeper | None = None,
    between: Callable[[State, int], State] | None = None,
    modes: int = 0,
) -> Formed:
    """Press a blank through stages. Collective.

    ``accepted`` is called with each step and its state; ``keeper`` keeps them, and if it has some
    of a former run these come first, and the forming goes on from there. ``between`` makes the
    state that a stage, by its number from 1 on, begins with, of that before: cloth laid then. With
    ``modes`` the lowest stiffness is looked at, and at the end so many of the softest shapes.

    Raises
    ------
    EquilibriumError
        On every rank; its ``result`` is what was formed up to there.
    """
    formed, model = Formed(blank), blank.model
    start, work = blank.start(), 0.0
    longest = LONGEST * min(one.pitch for one in blank.each)
    options = {"snes_max_it": MOST_ITERATIONS, **(options or {})}
    equilibrium = Equilibrium(
        model, start, options, relative_residual=RESIDUAL, longest_step=longest, foretell=False
    )
    stability = Stability(model, blank.area_of_nodes(), modes) if modes else None
    names = [tool.name for tool in blank.tools]
    place = start.x[blank.tool_node]  # of the tools after the last step, and what drove them
    driving = np.zeros_like(place)
    last, pulls = start, blank.pulls(start)
    load_work = dict.fromkeys(pulls, 0.0)
    presses = [Press(blank, plans[0], Posture.at_the_start(blank), 0.0)]
    earlier: list[FormingStep] = list(keeper.steps) if keeper is not None else []

    def press_at(number: int) -> Press:
        """The press of a stage; those before it have left tools where steps tell."""
        while len(presses) <= number:
            done, last = len(presses), presses[-1]
            ends = [s for s in earlier or formed.steps if s.increment.control <= done]
            posture = last.after(_rows(ends[-1].tool_place, names))
            presses.append(Press(blank, plans[done], posture, float(done)))
        return presses[number]

    def state_at(time: float, x: np.ndarray) -> State:
        hold, factors = press_at(stage_number(time)).drive(time)
        return State(x, hold, time, factors) if time else start

    def measure(found: Found) -> Measured:
        force = found.force[blank.tool_node]
        unbearable = squeezed(blank, found.state)
        if unbearable is not None:
            what, reason, there, count = unbearable
            raise EquilibriumError(what, reason, found.history, there, count)
        shear = max(one.ply.shear_angle_max(one.of_cloth(found.state)) for one in blank.each)
        return Measured(forces=dict(zip(names, force, strict=True)), shear_max=shear)

    def take(step: Step, path: Path) -> None:
        nonlocal work, place, driving, last, pulls, load_work
        state = path.state  # with anchors where they are now
        before, force, place = place, driving, state.x[blank.tool_node]
        # What drives a tool holds it against the cloth, or is the force that pushes it.
        held = np.array([step.forces[name] for name in names]).reshape(-1, 3)
        press = press_at(int(path.begin))
        driving = np.where(press.free, press.push(state.time), held)
        work += 0.5 * float(((force + driving) * (place - before)).sum())
        moved, pulled, last, pulls = state.x - last.x, pulls, state, blank.pulls(state)
        each = [0.5 * ((pulled[name] + pulls[name]) * moved).sum() for name in pulls]
        each = blank.comm.allreduce(np.array(each))
        load_work = {name: load_work[name] + float(e) for name, e in zip(pulls, each, strict=True)}
        by_clamp = {
            item.edge: blank.comm.allreduce(pulls[item.name].sum(axis=0)) for item in blank.clamps
        }
        done = FormingStep(
            press.plan.name,
            step.increment,
            dict(zip(names, driving, strict=True)),
            dict(zip(names, place, strict=True)),
            blank.tool_moments(step.state),
            blank.spent(state),
            work,
            load_work,
            by_clamp,
            float(stability.modes(state).values[0]) if stability else None,
        )
        formed.add(done, state)
        if keeper is not None:
            # The next step begins with the last state alone.
            keeper.write(model, replace(path, states=[state]), formed.steps, step.state)
        if accepted is not None:
            accepted(done, state)

    def begin(number: int, state: State) -> Path:
        """How a stage begins; what is laid then has done no work on its way there."""
        nonlocal last, pulls
        new = state if between is None or number == len(plans) else between(state, number)
        if new is state:
            return Path([state], begin=float(number))
        last, pulls = new, blank.pulls(new)
        return Path([new], begin=float(number), allowed=FIRST_STEP * plans[number].step)

    try:
        # Laid cloth is in no equilibrium: it lets go in small steps, which grow where easy.
        path = Path([start], allowed=FIRST_STEP * plans[0].step if blank.is_laid else None)
        if keeper is not None:
            restored = keeper.restore(model, state_at)
            if restored is None:
                keeper.write(model, path, [], start)
            else:
                path, states = restored
                for step, state in zip(earlier, states, strict=True):
                    state = replace(state, memory=model.accepted(state))
                    place = state.x[blank.tool_node]
                    places = dict(zip(names, place, strict=True))
                    step = replace(step, tool_place=places, spent=blank.spent(state))
                    formed.add(step, state)
                    driving, work = _rows(step.tool_force, names), step.work
                    last, load_work = state, dict(step.load_work)
                    if accepted is not None:
                        accepted(step, state)
                earlier, pulls = [], blank.pulls(last)
        for number in range(int(path.begin), len(plans)):
            follow(equilibrium, press_at(number).stage(measure), path, take)
            path = begin(number + 1, path.state)
        if stability is not None:
            formed.modes = stability.modes(path.state)
    except CruciformError as error:
        equilibrium.destroy()  # only these are raised on every rank alike, as this needs
        if isinstance(error, EquilibriumError):
            error.result = formed
        raise
    finally:
        if stability is not None:
            stability.destroy()
    equilibrium.destroy()
    return formed


def _rows(vectors: Mapping[str, np.ndarray], names: Sequence[str]) -> np.ndarray:
    """One vector for each tool, (n tools, 3)."""
    return np.array([vectors[name] for name in names]).reshape(-1, 3)
