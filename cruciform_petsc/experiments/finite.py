# SPDX-License-Identifier: MIT
"""A test at finite deformation: its stage, what is measured on its states, its result."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from copy import copy
from dataclasses import replace
from typing import Any, Protocol

import numpy as np

from ..equilibrium.cloth import holder, model_of
from ..equilibrium.follow import Path, follow
from ..equilibrium.model import Model
from ..equilibrium.newton import Equilibrium
from ..equilibrium.stages import Increment, Measured, Stage, Step
from ..equilibrium.state import Found, Hold, State
from ..errors import CruciformError, EquilibriumError
from ..items.cruciforms import Course
from ..items.loads import imperfection
from ..items.ply import Ply
from ..items.truss import TrussPly
from ..laws import Potential
from ..net.edges import Constraints
from . import result
from .stability import Watch

EASY = 20  # Newton steps, of all rounds of friction together
LOAD_TOLERANCE = 1e-9  # relative, where a load is prescribed on an edge that moves as one


class Keeper(Protocol):
    """What keeps a test's states on disk, see output.checkpoint. Collective."""

    @property
    def steps(self) -> Sequence[Any]:
        """Increments, or steps of a forming, of former runs."""

    def restore(
        self, model: Model, state_at: Callable[[float, np.ndarray], State]
    ) -> tuple[Path, Iterable[State]] | None:
        """Where to go on, and the states after each step, in order; None without a past.

        ``state_at`` makes a state of a control and positions.
        """

    def write(self, model: Model, path: Path, steps: Sequence[Any], state: State) -> None:
        """Keep what has been reached; ``state``: the last one as it was found."""

    def state(
        self,
        model: Model,
        number: int,
        control: float,
        state_at: Callable[[float, np.ndarray], State],
    ) -> State:
        """The state after a step, as it was found, by its number; ``state_at`` as above."""


class FiniteTest:
    """An experiment's ply, model, grips and stage. Collective, as are its methods."""

    def __init__(self, experiment: Any):
        self.experiment, self.network = experiment, experiment.network
        constraints = Constraints(self.network, experiment.bending)
        self.grips = experiment.grip(constraints)
        out_of_plane, waves = None, experiment.imperfection
        if experiment.space:
            out_of_plane = self.network.fabric.out_of_plane("test.space = true")
        drawn = experiment.flat, experiment.prestretch
        self.ply: Ply
        if experiment.model == "truss":
            self.ply = TrussPly(constraints, out_of_plane, *drawn)
        else:
            self.ply = Ply(constraints, out_of_plane, *drawn, experiment.slip)
        if waves is not None:
            self.ply.further.append(imperfection(self.ply, waves.height.si, waves.seed))
        self.ply.cruciforms.course = Course(self.seconds, self.temperature)
        self.model = model_of(self.ply)
        self._hold = holder(self.ply)

    def with_shear_law(self, law: Potential) -> FiniteTest:
        """The same test of a cloth with another shear law; all else is shared."""
        test = copy(self)
        test.ply = self.ply.with_shear_law(law)
        test.model = self.model.with_items(test.ply.items)
        return test

    def at(self, control: float, x: np.ndarray | None = None) -> State:
        """State at a control; at rest (control 0), or with known positions."""
        hold, factors = self.drive(control)
        return State(self.ply.nodes.rest if x is None else x, hold, control, factors)

    def drive(self, control: float) -> tuple[Hold, dict[str, float]]:
        """See Stage."""
        hold = self._hold(self.experiment.motions(self.grips, control))
        return hold, {self.ply.loads.name: self.experiment.load_factor(control)}

    def seconds(self, before: float, now: float) -> float:
        """See Course."""
        speed = self.experiment.test.speed
        if speed is None:
            return 0.0
        return abs(self.experiment.travel(now) - self.experiment.travel(before)) / speed.si

    def temperature(self, now: float) -> float | None:
        """See Course."""
        told = self.experiment.test.temperature
        return None if told is None else told.si

    def rate(self, control: float) -> np.ndarray:
        """See Stage."""
        nodes = self.ply.nodes
        rate = np.zeros_like(nodes.rest)
        rate[nodes.of_network_node, :2] = self.experiment.velocity(self.grips, control)
        return nodes.halo.forward(rate)

    def work(self, found: Found) -> float:
        """Work of the edges per change of the control."""
        control, nodes = found.state.time, self.ply.nodes
        # Arm ends on edges are of the network's nodes; its own are all there is to sum over.
        at = nodes.of_network_node[: self.network.num_nodes_owned]
        work = float((found.force[at] * self.rate(control)[at]).sum())
        return self.network.comm.allreduce(work) + self._work_of_turning(found.state)

    def _work_of_turning(self, state: State) -> float:
        """Work per change of the control that clamps do on the directions they hold."""
        experiment, control = self.experiment, state.time
        step = 1e-5 * max(abs(control), abs(experiment.reference_control()))
        ahead, behind = (experiment.motions(self.grips, control + sign * step) for sign in (1, -1))
        if all((a[1] == b[1]).all() for a, b in zip(ahead, behind, strict=True)):
            return 0.0
        energy = []
        for motions in (ahead, behind):
            turned = replace(state, hold=replace(state.hold, turn=self._hold(motions).turn))
            energy.append(sum(self.model.energies(turned).values()))
        return (energy[0] - energy[1]) / (2.0 * step)

    def measure(self, found: Found) -> Measured:
        """See Stage."""
        at = self.ply.nodes.of_network_node
        return Measured(
            self.experiment.load_of(self.work(found), found.state.time),
            self.experiment.edge_forces(self.grips, found.force[at]),
            self.ply.shear_angle_max(found.state),
        )

    def stage(self) -> Stage:
        """All values asked for, as a stage."""
        test = self.experiment
        largest = float(np.abs(test.values).max())
        step, control_step = test.increments and largest / test.increments, test.default_step()
        if test.by_load:
            control_step = control_step or test.reference_control()
        else:
            control_step = step or control_step
        stage = Stage(
            test.kind,
            self.drive,
            test.values.tolist(),
            control_step,
            test.by_load,
            step,
            LOAD_TOLERANCE * largest,
            self.work,
            self.rate,
            self.measure,
        )
        # Friction sticks and slides: what has been says little of what comes.
        return stage if test.slip is None else replace(stage, carry_on=False, easy=EASY)

    def result_state(self, state: State, measured: Measured) -> result.State:
        """What a result keeps of a state, of which all is remembered that is past then."""
        ply = self.ply
        return result.State(
            state.time,
            measured.load,
            lambda: ply.fields(state),
            lambda: ply.displacement(state)[1],
            dict(measured.forces),
        )

    def measured_anew(self, state: State) -> result.State:
        """The same of a state that was found before. Collective."""
        force, _, energies = self.model.force(state)
        found = Found(state, energies, force, 0, 0.0, 0.0, [], 0, 0, 0.0)  # not solved again
        after = replace(state, memory=self.model.accepted(state))
        return self.result_state(after, self.measure(found))


def solve_finite(
    experiment: Any,
    accepted: Callable[[Increment], None] | None,
    keeper: Keeper | None,
) -> result.TestResult:
    """See Experiment.solve. Collective."""
    test = FiniteTest(experiment)
    start = test.at(0.0)
    switches = experiment.slip is not None  # as friction does
    equilibrium = Equilibrium(test.model, start, experiment.options, foretell=not switches)
    types = equilibrium.types()
    path = Path([start], begin=start.time)
    done: list[Increment] = []
    kept: list[State] = []  # after each increment, where nothing keeps them on disk
    states: list[result.State] = []  # asked for
    last: list[result.State] = []  # whether asked for or not
    dim, nodes = test.model.dim, test.ply.nodes

    def placed(number: int) -> State:
        if keeper is None:
            return kept[number]
        return keeper.state(test.model, number, done[number].control, test.at)

    def state_after(number: int) -> result.State:
        return test.measured_anew(placed(number))

    watch = None
    found = result.TestResult(
        experiment,
        test.ply.supports,
        dim,
        states,
        increments=done,
        state_after=state_after,
        unknowns=dim * nodes.num_nodes_global,
        solver_types=types,
    )

    def take(step: Step, path: Path) -> None:
        loads = {mode for item in test.model.items if item.is_load for mode in item.modes}
        energies = step.increment.energies
        energies = {mode: energy for mode, energy in energies.items() if mode not in loads}
        state = test.result_state(path.state, Measured(step.increment.load, step.forces))
        spent = test.ply.dissipated(path.state)
        columns = found.row(state) | {f"dissipated_{how}_J": spent[how] for how in spent}
        if experiment.test.speed is not None:
            control, passed = start.time, 0.0
            if done:
                control, passed = done[-1].control, done[-1].columns["time_s"] or 0.0
            columns["time_s"] = passed + test.seconds(control, step.state.time)
        columns |= watch.columns(step.state) if watch else {}
        increment = replace(step.increment, energies=energies, columns=columns)
        done.append(increment)
        last[:] = [state]
        if increment.asked:
            states.append(state)
        if keeper is None:
            kept.append(step.state)
        else:
            keeper.write(test.model, path, done, step.state)
        if accepted is not None:
            accepted(increment)

    try:
        stage = test.stage()
        if experiment.stability is not None:
            watch = Watch(test, equilibrium, start)
            watch.foretell()
            stage = watch.stage(stage)
        if keeper is not None:
            earlier = keeper.restore(test.model, test.at)
            if earlier is None:
                keeper.write(test.model, path, done, start)
            else:
                path, former = earlier
                for increment, state in zip(keeper.steps, former, strict=True):
                    done.append(increment)
                    if increment.asked:
                        states.append(test.measured_anew(state))
        follow(equilibrium, stage, path, take)
        if watch is not None:
            found.buckling = watch.finish(done, placed)
    except CruciformError as error:
        # Only these are raised on every rank alike, as destroying needs it.
        equilibrium.destroy()
        if watch is not None:
            if done and isinstance(error, EquilibriumError):
                found.buckling = watch.finish(done, placed)
            watch.destroy()
        if isinstance(error, EquilibriumError):
            experiment.explain(error, done)
            if last and (not states or states[-1] is not last[0]):
                states.append(last[0])  # how far it came
            error.result = found if states else None
        raise
    equilibrium.destroy()
    if watch is not None:
        watch.destroy()
    return found
