# SPDX-License-Identifier: MIT
"""Forming a blank, stage by stage: steps, forces of tools, energies, work."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from ..equilibrium.follow import Path, follow
from ..equilibrium.newton import Equilibrium
from ..equilibrium.stages import Increment, Measured, Step
from ..equilibrium.state import Found, State
from ..errors import CruciformError, EquilibriumError
from ..units import format_si
from .blank import Blank
from .measures import pierced
from .press import Posture, Press, StagePlan

RESIDUAL = 1e-4  # of the forces that hold and load tools (forming.md section 1)
LONGEST = 0.5  # of a pitch, in a Newton step
MOST_ITERATIONS = 100  # where cloth snaps the way is long, and shorter steps do not shorten it


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
    spent : dict
        What friction and viscosity have dissipated up to here, J.
    work : float
        What has been done on tools up to here, by trapezia over the steps, J.
    """

    stage: str
    increment: Increment
    tool_force: Mapping[str, np.ndarray]
    tool_place: Mapping[str, np.ndarray]
    spent: Mapping[str, float]
    work: float


@dataclass
class Formed:
    """What a forming has come to.

    Attributes
    ----------
    blank : Blank
    steps : list of FormingStep
        All that were accepted.
    states : list of State
        Those asked for; the last one that was accepted is the last here.
    """

    blank: Blank
    steps: list[FormingStep] = field(default_factory=list)
    states: list[State] = field(default_factory=list)


def form(
    blank: Blank,
    plans: Sequence[StagePlan],
    *,
    options: Mapping[str, object] | None = None,
    accepted: Callable[[FormingStep, State], None] | None = None,
) -> Formed:
    """Press a blank through stages. Collective.

    Raises
    ------
    EquilibriumError
        On every rank; its ``result`` is what was formed up to there.
    """
    formed, model = Formed(blank), blank.model
    state, posture, work = blank.start(), Posture.at_the_start(blank), 0.0
    longest = LONGEST * float(blank.network.pitch.mean())
    options = {"snes_max_it": MOST_ITERATIONS, **(options or {})}
    equilibrium = Equilibrium(
        model, state, options, relative_residual=RESIDUAL, longest_step=longest, foretell=False
    )
    names = [tool.name for tool in blank.tools]
    place = state.x[blank.tool_node]  # of the tools after the last step, and what drove them
    driving = np.zeros_like(place)

    def measure(found: Found) -> Measured:
        force = found.force[blank.tool_node]
        through = pierced(blank, found.state)
        if through is not None:
            name, depth, place = through
            raise EquilibriumError(
                f'tool "{name}" lies {format_si(float(f"{depth:.3g}"), "m")} deep in the cloth, '
                f"which is {format_si(blank.thickness, 'm')} thick",
                "PIERCED",
                found.history,
                place,
            )
        shear = blank.ply.shear_angle_max(blank.of_cloth(found.state))
        return Measured(forces=dict(zip(names, force, strict=True)), shear_max=shear)

    def take(step: Step, path: Path) -> None:
        nonlocal work, place, driving
        state = path.state  # with anchors where they are now
        before, force, place = place, driving, state.x[blank.tool_node]
        # What drives a tool holds it against the cloth, or is the force that pushes it.
        held = np.array([step.forces[name] for name in names]).reshape(-1, 3)
        driving = np.where(press.free, press.push(state.time), held)
        work += 0.5 * float(((force + driving) * (place - before)).sum())
        done = FormingStep(
            plan.name,
            step.increment,
            dict(zip(names, driving, strict=True)),
            dict(zip(names, place, strict=True)),
            blank.spent(state),
            work,
        )
        if formed.steps and not formed.steps[-1].increment.asked:
            formed.states.pop()
        formed.steps.append(done)
        formed.states.append(state)
        if accepted is not None:
            accepted(done, state)

    try:
        for number, plan in enumerate(plans):
            press = Press(blank, plan, posture, float(number))
            follow(equilibrium, press.stage(measure), state, take)
            state = formed.states[-1]
            posture = press.after(state)
    except CruciformError as error:
        equilibrium.destroy()  # only these are raised on every rank alike, as this needs
        if isinstance(error, EquilibriumError):
            error.result = formed
        raise
    equilibrium.destroy()
    return formed
