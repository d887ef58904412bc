# SPDX-License-Identifier: MIT
"""What all tests of a cloth have in common: edges that are moved or loaded, small or large.

An experiment says which edges are gripped and where they are for a *control*: an extension, an
angle, a strain or a load. The same experiment is solved at small displacements (one linear system,
everything else by proportion) or at finite deformation (increments, solvers.nonlinear).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np

from ..equilibrium.finite import FiniteNetwork
from ..equilibrium.newton import Equilibrium, EquilibriumError, Increment, Path, follow
from ..errors import CruciformError, InputError
from ..memory import check_memory
from ..net.edges import Constraints
from ..net.network import Network
from ..net.supports import find_supports
from ..quantities import EXTENSION, Quantity
from ..small.multigrid import yarn_multigrid
from ..small.network import LinearNetwork
from ..solvers.linear import LinearSolver, SolverInfo
from ..units import format_si
from .result import State, TestResult
from .table import TestTable

if TYPE_CHECKING:
    from ..output.checkpoint import Checkpoint

# A picture's name, the labels of its axes (LOAD.axis for newtons), and its lines by label.
DrawnCurves = tuple[str, tuple[str, str], dict[str, tuple[np.ndarray, np.ndarray]]]

PULL = np.array([0.0, 1.0])
# Bytes per crossover while a system is solved. Measured with CG at small displacements: 6400 and,
# with yarns that bend, 9000; other ways take more. These are lower, so that nothing is refused that
# another preconditioner might do.
BYTES_HINGED, BYTES_BENDING = 4e3, 6e3
MOST_TRIES = 40
LOAD_TOLERANCE = 1e-9  # relative, where a load is prescribed on an edge that moves as one


@dataclass
class Grip:
    """An edge in a grip.

    Attributes
    ----------
    edge : str
    nodes : int array
        Local nodes of the network on the edge.
    """

    edge: str
    nodes: np.ndarray


def _columns(motions: np.ndarray) -> np.ndarray:
    """Motions (n, d, m) of n nodes as columns over their unknowns, (n d, m)."""
    return motions.reshape(-1, motions.shape[2])


class Experiment:
    """A test of a network; y is the direction of pull. Kinds of test derive from it.

    Parameters
    ----------
    network : Network
    options : dict, optional
        PETSc options for the solver, without the prefix.
    **keys
        Those of the kind's `table`, as in ``[test]`` of a case file: ``finite`` (finite
        deformation; else small displacements), ``bending`` (whether yarns resist it in the plane),
        ``increments`` (finite deformation: at least so many steps to the largest value), the
        controls asked for, and the kind's own, which become attributes. Numbers without unit are
        in SI.
    """

    table: ClassVar[type[TestTable]]  # of a case file
    kind = ""
    model = "coupled"  # all modes of deformation in one system
    # The curve's column of the control; further columns are declared in each kind's file.
    column: Quantity = EXTENSION
    # What is told of a state beside shear: columns of the curve that are forces, what the load is
    # called in the curve, and what the loaded end's movement is called.
    forces: tuple[str, ...] = ("load_N",)
    load_name, movement = "load", "extension"
    # What the yarns' picture is coloured by; whether the outline cuts across the yarns.
    colour, cut_across = "shear angle", False
    # Whether yarns that clamps hold, and those that they do not, make zones of their own.
    has_zones = False
    # How the continuum beside it is held (continuum.compare): "gripped", pulled at the upper edge
    # like a bias test; "free", of which there is none; "" where nothing compares.
    reference = ""
    upper = "grip"
    # What stands below the pictures that only this kind has.
    captions: ClassVar[dict[str, str]] = {}
    # Edges that are drawn as bars.
    clamps: tuple[str, ...] = ("lower", "upper")

    def __init__(self, network: Network, *, options: dict | None = None, **keys: Any):
        given = {key: value for key, value in keys.items() if value is not None}
        self.test = test = self.table.from_data({"kind": self.kind} | given, "test", bare=True)
        test.check(network.preform, network.fabric)
        # What the kind prescribes; `by_load`: a load in its place.
        self.control, self.unit = next(iter(test.controls.items()))
        self.is_curve, self.by_load = test.is_curve, test.control != self.control
        self.values = np.array(test.values_si)
        if not self.values.any():
            raise InputError(
                f"test.{test.control} has no value other than zero, so nothing would happen"
            )
        self.network, self.options = network, options or {}
        self.finite, self.bending, self.increments = test.finite, test.bending, test.increments
        for key in test.own_keys():
            if key not in test.controls:
                setattr(self, key, getattr(test, key))
        check_memory(
            network.comm,
            (BYTES_BENDING if test.bending else BYTES_HINGED) * network.num_crossovers_global,
            f"the network has {network.num_crossovers_global} crossovers",
            "choose a coarser pitch (refine, yarns_per_cruciform), a smaller outline or more "
            "machines",
        )

    # -- what a kind of test says ---------------------------------------------------------------

    def grip(self, constraints: Constraints) -> list[Grip]:
        """Constrain the edges. Collective."""
        raise NotImplementedError

    def motion(self, edge: str, control: float) -> tuple[np.ndarray, np.ndarray]:
        """Motion X -> A X + b of an edge in the axes x, y: A (2, 2) and b (2,), m."""
        raise NotImplementedError

    def load_factor(self, control: float) -> float:
        """Size of the dead loads that `grip` has put on, in units of what it has put on."""
        return 0.0

    def load_of(self, work: float, control: float) -> float:
        """The test's load from the work per change of the control; for an extension the same."""
        return work

    def extra_columns(self, result: TestResult) -> dict[str, np.ndarray]:
        """Further columns of the curve. Collective."""
        return {}

    def extensions(self, result: TestResult) -> np.ndarray:
        """How far the loaded end has moved along the load in each state, m; (n,). Collective."""
        return result.controls

    def figures(self, result: TestResult) -> dict[str, Any]:
        """Further figures for the summary. Collective."""
        return {}

    def drawn_curves(self, columns: dict[str, np.ndarray]) -> DrawnCurves | None:
        """What is drawn of the curve's columns in place of the load against the control."""
        return None

    def reference_control(self) -> float:
        """A control of a sensible size: for small displacements, and for first guesses."""
        if not self.by_load:
            return float(self.values[np.abs(self.values).argmax()])
        low, high = self.network.preform.outline.bounds[1::2]
        return 0.01 * (high - low)

    def default_step(self) -> float | None:
        """Largest step of the control at finite deformation; None: from value to value."""
        return None

    def net_gauge(self) -> float | None:
        """Gauge length, m, of a strip that an inextensible net would shear like a bias test.

        See net_kinematics.net_angle; None where the test is no such thing.
        """
        return None

    # -- common parts -----------------------------------------------------------------------------

    def check(self) -> list[str]:
        """Grip the edges without solving; what there is to say about them. Collective.

        Raises InputError on every rank if yarns miss an edge or a part is held by no clamp.
        """
        constraints = Constraints(self.network, self.bending)
        grips = self.grip(constraints)
        comm, owned = self.network.comm, self.network.num_nodes_owned
        counts = comm.allreduce(np.array([(grip.nodes < owned).sum() for grip in grips]))
        hanging = comm.allreduce(find_supports(constraints).num_hanging)
        told = [
            ", ".join(
                f"{count} yarn ends on the {grip.edge} edge"
                for count, grip in zip(counts, grips, strict=True)
            )
        ]
        if hanging:
            told.append(f"{hanging} crossovers hang on by one arm end and will carry no load")
        return told

    def solve(
        self,
        accepted: Callable[[Increment], None] | None = None,
        checkpoint: Checkpoint | None = None,
    ) -> TestResult:
        """Solve and measure. Collective.

        Parameters
        ----------
        accepted : callable, optional
            Finite deformation: told each accepted increment.
        checkpoint : Checkpoint, optional
            Finite deformation: kept up to date at every increment; if it was opened from files,
            the test goes on from there.

        Raises
        ------
        SolverError
            On every rank if a solver fails. At finite deformation it is an EquilibriumError whose
            attribute ``result`` holds what was reached (or None).
        """
        return self._solve_finite(accepted, checkpoint) if self.finite else self._solve_small()

    def _motions(self, grips: list[Grip], control: float):
        return [(grip.nodes, *self.motion(grip.edge, control)) for grip in grips]

    def _velocity(self, grips: list[Grip], control: float) -> np.ndarray:
        """Change of the gripped nodes' places per change of the control, (n network nodes, 2)."""
        step = 1e-6 * max(abs(control), abs(self.reference_control()))
        place = self.network.node_position
        velocity = np.zeros_like(place)
        ahead, behind = (self._motions(grips, control + sign * step) for sign in (1, -1))
        for (nodes, gradient, shift), (_, old_gradient, old_shift) in zip(
            ahead, behind, strict=True
        ):
            gradient, shift = gradient - old_gradient, shift - old_shift
            velocity[nodes] = (place[nodes] @ gradient.T + shift) / (2.0 * step)
        return velocity

    # -- small displacements ----------------------------------------------------------------------

    def _solve_small(self) -> TestResult:
        network = self.network
        reference = self.reference_control()
        constraints = Constraints(network, self.bending)
        grips = self.grip(constraints)
        velocity = self._velocity(grips, 0.0) * reference
        yarn = np.einsum("nij,nj->ni", constraints.frame, velocity @ network.preform.rotation.T)
        fixed = constraints.fixed[:, :2]
        constraints.value[:, :2][fixed] = yarn[fixed]
        constraints.force *= self.load_factor(reference)
        linear = LinearNetwork(constraints)
        matrix = linear.matrix()
        prescribed = np.where(constraints.fixed, constraints.value, 0.0)
        right = linear.loads() - linear.element_forces(prescribed)
        right[~linear.free] = 0.0
        rhs = linear.vector(right)
        owned = slice(0, network.num_nodes_owned)
        solver = LinearSolver(
            matrix,
            lambda: _columns(linear.soft_motions()[owned]),
            extra=self.options,
            multigrid=partial(yarn_multigrid, linear),
        )
        x, info = solver.solve(rhs)
        local = linear.local(x)
        fields = linear.crossover_fields(local)
        state = State(reference, 0.0, fields, linear.node_displacement(local, fields))
        force = linear.element_forces(local)[:, :2]
        force = np.einsum("nji,nj->ni", constraints.frame, force) @ network.preform.rotation
        # A load that is itself the control works on the nodes it acts on.
        work = float((force[owned] * velocity[owned]).sum()) / reference
        state.load = self.load_of(network.comm.allreduce(work), reference)
        state.forces = self._edge_forces(grips, force)
        solver.destroy()
        for thing in (matrix, rhs, x):
            thing.destroy()
        return self._in_proportion(state, linear, info)

    def _in_proportion(self, state: State, linear: LinearNetwork, info: SolverInfo) -> TestResult:
        """All values asked for from one state of small displacements."""
        per_control = state.load / state.control
        controls = self.values / per_control if self.by_load else self.values
        states = [state.scaled(control / state.control) for control in controls]
        if self.by_load:
            for scaled, load in zip(states, self.values, strict=True):
                scaled.load = float(load)  # not to the last digit by proportion
        return TestResult(self, linear.supports, linear.unknowns_per_node, states, solver=info)

    def _edge_forces(self, grips: list[Grip], force: np.ndarray) -> dict[str, np.ndarray]:
        """Force (x, y) that holds each gripped edge. Collective."""
        owned, comm = self.network.num_nodes_owned, self.network.comm
        return {
            grip.edge: comm.allreduce(force[grip.nodes[grip.nodes < owned]].sum(axis=0))
            for grip in grips
        }

    # -- finite deformation -----------------------------------------------------------------------

    def _solve_finite(
        self, told: Callable[[Increment], None] | None, checkpoint: Checkpoint | None
    ) -> TestResult:
        constraints = Constraints(self.network, self.bending)
        grips = self.grip(constraints)
        model = FiniteNetwork(constraints)
        equilibrium = Equilibrium(model, self.options)
        states: list[State] = []
        done: list[Increment] = []
        last: list[State] = []  # whether asked for or not

        def drive(control: float):
            return self._motions(grips, control), self.load_factor(control)

        path = Path(equilibrium, drive)
        types = equilibrium.types()

        def accepted(increment: Increment, x: np.ndarray) -> None:
            state = self._state(model, equilibrium, grips, increment.control)
            increment.load = state.load
            increment.shear_max = model.shear_angle_max(x)
            done.append(increment)
            last[:] = [state]
            if increment.asked:
                states.append(state)
            if checkpoint is not None:
                checkpoint.write(model, path, done)
            if told is not None:
                told(increment)

        def result() -> TestResult:
            return TestResult(
                self, model.supports, 2, states, increments=done,
                unknowns=2 * model.nodes.num_nodes_global, solver_types=types,
            )  # fmt: skip

        try:
            if checkpoint is not None:
                kept = checkpoint.restore(model)
                done += checkpoint.increments
                for control, x in kept.asked:
                    path.restore([(control, x)])
                    states.append(self._state(model, equilibrium, grips, control))
                path.restore(kept.states, **kept.path)
            if self.by_load:
                self._follow_loads(path, grips, accepted)
            else:
                step = self.default_step()
                if self.increments is not None:
                    step = float(np.abs(self.values).max()) / self.increments
                targets = [float(value) for value in self.values]
                follow(equilibrium, drive, targets, step, accepted, path=path)
        except CruciformError as error:
            # Only these are raised on every rank alike, as destroying needs it.
            equilibrium.destroy()
            if isinstance(error, EquilibriumError):
                self._explain(error, done)
                if last and (not states or states[-1] is not last[0]):
                    states.append(last[0])  # how far it came
                error.result = result() if states else None
            raise
        equilibrium.destroy()
        return result()

    def _state(self, model, equilibrium, grips: list[Grip], control: float) -> State:
        """Measure the accepted state. Collective."""
        network = self.network
        x = equilibrium.x.copy()
        at = model.nodes.of_network_node
        force = equilibrium.forces()[at] @ network.preform.rotation
        velocity = self._velocity(grips, control)
        mine = slice(0, network.num_nodes_owned)
        work = network.comm.allreduce(float((force[mine] * velocity[mine]).sum()))
        work += self._work_of_turning(model, x, grips, control)

        def fields():
            model.prescribe(x.copy(), self._motions(grips, control))  # as the clamps were then
            return model.crossover_fields(x)

        return State(
            control,
            self.load_of(work, control),
            fields,
            lambda: model.displacement(x)[1],
            forces=self._edge_forces(grips, force),
        )

    def _work_of_turning(self, model, x, grips: list[Grip], control: float) -> float:
        """Work per change of the control that clamps do on the directions they hold. Collective."""
        now = self._motions(grips, control)
        step = 1e-5 * max(abs(control), abs(self.reference_control()))
        ahead, behind = (self._motions(grips, control + sign * step) for sign in (1, -1))
        if all((a[1] == b[1]).all() for a, b in zip(ahead, behind, strict=True)):
            return 0.0
        energy = []
        for motions in (ahead, behind):
            model.prescribe(x.copy(), motions)
            energy.append(model.energies(x).sum())
        model.prescribe(x.copy(), now)
        return float(energy[0] - energy[1]) / (2.0 * step)

    def _follow_loads(self, path: Path, grips, accepted) -> None:
        """Find the extensions of the loads asked for, by Newton's method on each. Collective."""
        equilibrium, model = path.equilibrium, path.equilibrium.model
        control, load = path.control, path.load
        most = self.default_step() or self.reference_control()
        while path.target < len(self.values):
            target = float(self.values[path.target])
            step_limit = abs(target - load) if self.increments is None else (
                float(np.abs(self.values).max()) / self.increments
            )  # fmt: skip
            reached = False
            while not reached:  # once at least: a load asked for twice is two states
                gap = target - load
                goal = target if abs(gap) <= step_limit * (1 + 1e-9) else (
                    load + np.sign(gap) * step_limit
                )  # fmt: skip
                spent = Increment(control, np.zeros(3), 0, 0.0, 0.0, [])
                ends: dict[bool, float] = {}  # last controls whose load is above and below
                tries = 0
                while True:
                    ends[bool(load > goal)] = control
                    slope, moved = self._load_slope(model, equilibrium, grips, control)
                    wanted = (goal - load) / slope if slope > 0.0 else np.sign(goal - load) * most
                    change = float(np.clip(wanted, -most, most))
                    if len(ends) == 2:  # a load between two others lies between their controls
                        low, high = sorted(ends.values())
                        if not low < control + change < high:
                            change = 0.5 * (low + high) - control
                    increment = None
                    while increment is None:
                        try:
                            guess = equilibrium.x + moved * change
                            increment = path.advance(control + change, guess)
                        except EquilibriumError:
                            spent.cuts += 1
                            change *= 0.5
                            if abs(change) < 1e-4 * most:
                                raise
                    control += change
                    for name in ("iterations", "linear_iterations", "shifted", "seconds", "cuts"):
                        total = getattr(spent, name) + getattr(increment, name)
                        setattr(spent, name, total)
                        setattr(increment, name, total)
                    load = self._state(model, equilibrium, grips, control).load
                    if abs(load - goal) <= LOAD_TOLERANCE * np.abs(self.values).max():
                        break
                    if len(ends) == 1 and abs(change) < abs(wanted):  # a step on the way
                        path.load = load
                        accepted(increment, equilibrium.x)
                        spent = Increment(control, np.zeros(3), 0, 0.0, 0.0, [])
                        continue
                    tries += 1
                    if tries > MOST_TRIES:
                        raise EquilibriumError(
                            f"the load {format_si(goal, 'N')} is not reached", "MAX_IT", []
                        )
                load = path.load = float(goal)
                reached = increment.asked = bool(goal == target)
                path.target += int(reached)
                accepted(increment, equilibrium.x)

    def _load_slope(self, model, equilibrium, grips, control) -> tuple[float, np.ndarray]:
        """Change of the load, and of all places, per change of the control. Collective."""
        network, at = self.network, model.nodes.of_network_node
        velocity = self._velocity(grips, control)
        change = np.zeros_like(equilibrium.x)
        change[at] = velocity @ network.preform.rotation.T
        moved, force = equilibrium.tangent_step(model.nodes.halo.forward(change))
        mine = slice(0, network.num_nodes_owned)
        work = (force[at] @ network.preform.rotation)[mine] * velocity[mine]
        return network.comm.allreduce(float(work.sum())), moved

    def _explain(self, error: EquilibriumError, done: list[Increment]) -> None:
        """Say in the error at which load, why and where."""
        reached = "at rest"
        if done:
            name, size = self.column[0].rpartition("_")[0], self.unit
            reached = (
                f"at {name} {format_si(done[-1].control, size)}, load "
                f"{format_si(done[-1].load, 'N')}"
            )
        broken = error.reason in ("FOLDED", "TORN")  # at a place, and whatever the increments
        where = ""
        if error.place is not None:
            x, y = (format_si(float(value), "m") for value in error.place)
            where = f" at x = {x}, y = {y}"
            if not broken:
                where = f"; forces are farthest from balance{where}"
        hint = "" if broken else (
            ". Smaller increments, yarn bending or a shear law that stiffens may help"
        )  # fmt: skip
        error.args = (
            f"{self.kind}: no equilibrium beyond the last one found, {reached} ({error}, "
            f"{error.reason}){where}{hint}",
        )
