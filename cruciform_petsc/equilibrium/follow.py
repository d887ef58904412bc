# SPDX-License-Identifier: MIT
"""Following equilibrium through a stage, by place or by load."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from ..errors import EquilibriumError
from ..parallel import most
from ..units import format_si
from .lagged import settle
from .model import Model
from .newton import Equilibrium
from .stages import Stage, Step
from .state import Found, State

MOST_CUTS = 10
MOST_TRIES = 40  # solutions for one load
FAR = 1.0  # times the way of three states: too far for a parabola through them
PATIENT = 8  # of them after which a load is as good as its equilibrium
UNEXACT = 3  # after which the tangent misses something: time that passes, where cloth is viscous
JUMP = 1e-6  # of the longest step: controls that are one place


@dataclass
class Path:
    """How far a stage has come.

    Attributes
    ----------
    states : list of State
        Accepted, the last three at most.
    target : int
        Number of the value asked for that is being made for.
    allowed : float or None
        Largest step of the control, where steps were cut.
    load : float
        Reached, N; where loads are asked for.
    begin : float
        Control at which the stage began.
    """

    states: list[State]
    target: int = 0
    allowed: float | None = None
    load: float = 0.0
    begin: float = 0.0

    @property
    def state(self) -> State:
        """The last accepted one."""
        return self.states[-1]

    def append(self, state: State) -> None:
        """Go on to a state. Of two at one control the newer one counts, and of a turn one side."""
        kept = [old for old in self.states if old.time != state.time]
        if len(kept) > 1:
            way = kept[-1].time - kept[-2].time
            kept = kept[-1:] if (state.time - kept[-1].time) * way < 0.0 else kept
        self.states = [*kept[-2:], state]


def follow(
    equilibrium: Equilibrium,
    stage: Stage,
    start: State | Path,
    accepted: Callable[[Step, Path], None] | None = None,
) -> list[Step]:
    """Follow equilibrium from a state through the values asked for, in order. Collective.

    Each step starts from the last ones carried on (a parabola through three states, a straight line
    through two, the tangent where there is but one), or as `foreseen`; one that fails is halved,
    from the last state that was found, and steps grow again when all goes well. A load is reached
    by Newton's method on the control, kept between controls whose loads are above and below.

    Parameters
    ----------
    equilibrium : Equilibrium
    stage : Stage
        Its controls may turn back.
    start : State or Path
        In equilibrium; or how far an earlier call had come.
    accepted : callable, optional
        Called with each accepted step, and how far the stage has come with it.

    Returns
    -------
    list of Step
        All that were accepted here.

    Raises
    ------
    EquilibriumError
        On every rank, with the reason and the place.
    """
    path = start if isinstance(start, Path) else Path([start], begin=start.time)
    done: list[Step] = []
    cuts = 0

    def take(solved: list[Found], reached: bool) -> State:
        """Accept the last of several solutions; returns its state."""
        # The step keeps what its equilibrium was found with; the next one begins with the rest.
        last = solved[-1].state
        last = replace(last, memory=equilibrium.model.accepted(last))
        # What friction and viscosity have dissipated by now is none of the energy stored.
        if any(last.memory.values()):
            solved[-1] = replace(solved[-1], energies=equilibrium.model.energies(last))
        path.append(last)
        if reached:
            path.target += 1
            path.allowed = None if stage.carry_on else path.allowed
        step = Step.of(solved, stage.measure(solved[-1]), reached, cuts)
        done.append(step)
        if accepted is not None:
            accepted(step, path)
        return last

    while path.target < len(stage.targets):
        aim = (_Load if stage.by_load else _Place)(equilibrium, stage, path)
        solved: list[Found] = []
        cuts, last = 0, path.state
        while True:
            control, guess = aim.next(last, min(aim.most, path.allowed or aim.most))
            change = abs(control - last.time)
            try:
                guess = guess.at(*_held(stage, control))
                if not stage.carry_on:
                    guess = foreseen(equilibrium, last, guess)
                found = settle(equilibrium, guess)
                *passed, found = stage.watch(path.state, found) if stage.watch else [found]
            except EquilibriumError:
                cuts += 1
                path.allowed = 0.5 * change
                if path.allowed <= aim.most * 0.5**MOST_CUTS:
                    raise
                continue
            for critical in passed:  # what comes after is no continuation of what came before
                path.states = []
                take([critical], False)
                cuts = 0
            if path.allowed is not None and found.iterations <= stage.easy:
                path.allowed = min(aim.most, 2.0 * path.allowed)
            solved.append(found)
            last = found.state
            if not aim.accepts(found):
                continue
            last = take(solved, aim.reached)
            if aim.reached:
                break
            solved, cuts = [], 0
    return done


def _held(stage: Stage, control: float):
    hold, factors = stage.drive(control)
    return hold, control, factors


def foreseen(equilibrium: Equilibrium, last: State, guess: State) -> State:
    """A guess, or what has less energy: cloth carried by tools, the tangent's answer. Collective.

    The tangent is that at the last state, in equilibrium, where it is definite as a rule; that of
    the guess, whose tools have moved into cloth that has not, seldom is.
    """
    model = equilibrium.model
    there = replace(last, time=guess.time, factors=guess.factors)
    moved, _ = equilibrium.tangent_step(there, guess.x - last.x, out_of_balance=True)
    # Where the tangent is nearly singular the answer is much too long, but often of the right kind.
    limit = max(equilibrium.longest_step, _farthest(model, guess.x - last.x))
    share = min(1.0, limit / max(_farthest(model, moved), 1e-300))
    along = there.moved(share * moved).at(guess.hold, guess.time, guess.factors)
    guess = model.carried(last, guess)
    energy, other = (sum(model.energies(state).values()) for state in (guess, along))
    return along if other < energy else guess


def _farthest(model: Model, moved: np.ndarray) -> float:
    """Largest way of a node, m, of moves (n_local, dim). Collective."""
    return most(model.comm, np.linalg.norm(moved, axis=1), 0.0)


def extrapolated(equilibrium: Equilibrium, stage: Stage, states: Sequence[State], control: float):
    """Lagrange's polynomial through states, or the tangent at a single one, at a control.

    A parabola goes astray far beyond them: a straight line then.
    """
    last = states[-1]
    if abs(control - last.time) > FAR * abs(last.time - states[0].time):
        states = states[-2:]
    if len(states) == 1:
        # The clamps' turn belongs to the new state; the tangent is that of the old one.
        change = last.at(*_held(stage, control)).x - last.x
        return last.moved(equilibrium.tangent_step(last, change)[0])
    at = [state.time for state in states]
    x = np.zeros_like(last.x)
    for i, state in enumerate(states):
        weight = np.prod([(control - o) / (at[i] - o) for j, o in enumerate(at) if j != i])
        x += weight * state.x
    return replace(last, x=x)


class _Place:
    """A control that is asked for."""

    def __init__(self, equilibrium: Equilibrium, stage: Stage, path: Path):
        self.equilibrium, self.stage, self.path = equilibrium, stage, path
        self.target = float(stage.targets[path.target])
        before = stage.targets[path.target - 1] if path.target else path.begin
        self.most = abs(self.target - before) if stage.step is None else stage.step
        self.reached = False

    def next(self, last: State, allowed: float) -> tuple[float, State]:
        """Where to solve next, and from what."""
        gap = self.target - last.time
        pieces = int(np.ceil(abs(gap) / allowed * (1 - 1e-9))) if gap else 1
        control = self.target if pieces <= 1 else last.time + gap / pieces
        if not self.stage.carry_on:
            return control, last
        return control, extrapolated(self.equilibrium, self.stage, self.path.states, control)

    def accepts(self, found: Found) -> bool:
        """Each state that is found is one of the stage."""
        self.reached = found.state.time == self.target
        return True


class _Load:
    """A load that is asked for, or one on the way to it."""

    def __init__(self, equilibrium: Equilibrium, stage: Stage, path: Path):
        self.equilibrium, self.stage, self.path = equilibrium, stage, path
        self.target = float(stage.targets[path.target])
        assert stage.step is not None
        self.most, self.load = stage.step, path.load
        self.reached = False
        self._begin()

    def _begin(self) -> None:
        """Choose the next goal."""
        gap, limit = self.target - self.load, self.stage.load_step or np.inf
        short = abs(gap) > limit * (1 + 1e-9)
        self.goal = self.load + np.sign(gap) * limit if short else self.target
        # Last controls whose load is above and below, and these loads; those solved last.
        self.ends: dict[bool, float] = {}
        self.loads: dict[bool, float] = {}
        self.solved: list[tuple[float, float]] = []
        self.tries = 0

    def next(self, last: State, allowed: float) -> tuple[float, State]:
        """Newton's step on the control, with the slope of the load by the tangent."""
        above = bool(self.load > self.goal)
        self.ends[above], self.loads[above] = last.time, self.load
        velocity = self.stage.rate(last.time)
        moved, force = self.equilibrium.tangent_step(last, velocity)
        owned = self.equilibrium.model.nodes.num_nodes_owned
        slope = float((force[:owned] * velocity[:owned]).sum())
        slope = self.equilibrium.model.comm.allreduce(slope)
        here = last.time, self.load
        if here not in self.solved:  # as it is after a step that failed
            self.solved = [*self.solved[-1:], here]
        if self.tries >= UNEXACT and len(self.solved) == 2:
            (one, low), (other, high) = self.solved
            slope = (high - low) / (other - one)
        gap = self.goal - self.load
        wanted = gap / slope if slope > 0.0 else np.sign(gap) * allowed
        change = float(np.clip(wanted, -allowed, allowed))
        if len(self.ends) == 2:  # a load between two others lies between their controls
            low, high = sorted(self.ends.values())
            if not low < last.time + change < high:
                change = 0.5 * (low + high) - last.time
        self.is_short = abs(change) < abs(wanted)
        return last.time + change, last.moved(moved * change)

    def accepts(self, found: Found) -> bool:
        """A state with the load of the goal; or one on the way, as far as a step may go."""
        before, self.load = self.load, self.stage.load(found)
        off = abs(self.load - self.goal)
        # Closer than to what equilibrium was found, it is by chance.
        known = found.tolerance if self.tries >= PATIENT else 0.0
        if off <= max(self.stage.load_tolerance, known):
            self.load = self.path.load = self.goal
            self.reached = self.goal == self.target
            self._begin()
            return True
        # What was past the goal would be remembered by what resists by its history.
        on_the_way = (self.load > self.goal) == (before > self.goal)
        if len(self.ends) == 1 and self.is_short and on_the_way:
            self.path.load = self.load
            return True
        self.tries += 1
        if self.tries > MOST_TRIES:
            text = f"the load {format_si(self.goal, 'N')} is not reached"
            if len(self.ends) == 2 and np.ptp(list(self.ends.values())) < JUMP * self.most:
                low, high = (format_si(load, "N") for load in sorted(self.loads.values()))
                text += f", at one place it jumps from {low} to {high}"
            raise EquilibriumError(text, "MAX_IT", [])
        return False
