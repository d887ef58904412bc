# SPDX-License-Identifier: MIT
"""What all tests of a cloth have in common: edges that are moved or loaded, small or large.

An experiment says which edges are gripped and where they are for a *control*: an extension, an
angle, a strain or a load. The same experiment is solved at small displacements (one linear system,
everything else by proportion) or at finite deformation (finite.py).
"""

from __future__ import annotations

import warnings
from collections.abc import Callable
from typing import Any, ClassVar, NamedTuple

import numpy as np

from ..equilibrium.stages import Increment
from ..errors import EquilibriumError, InputError, InputWarning
from ..memory import check_memory
from ..net.edges import Constraints
from ..net.network import Network
from ..net.supports import find_supports
from ..quantities import EXTENSION, LOAD, Quantity, quantity
from ..small.network import MODES, LinearNetwork
from ..solvers.linear import LinearSolver, SolverInfo
from ..units import format_si
from .finite import Keeper, solve_finite
from .limits import SMALL_DEG, beyond_small, remarks
from .result import State, TestResult
from .table import TestTable, prestretch

# A picture's name, the labels of its axes (LOAD.axis for newtons), and its lines by label.
DrawnCurves = tuple[str, tuple[str, str], dict[str, tuple[np.ndarray, np.ndarray]]]

PULL = np.array([0.0, 1.0])
# Bytes per crossover while a system is solved, by whether yarns bend. Measured with CG at small
# displacements: 6400 and 9000; other ways take more. These are lower, so that nothing is refused
# that another preconditioner might do.
BYTES = {False: 4e3, True: 6e3}


class Grip(NamedTuple):
    """An edge in a grip, and the network's local nodes on it."""

    edge: str
    nodes: np.ndarray


class Experiment:
    """A test of a network; y is the direction of pull. Kinds of test derive from it.

    Parameters
    ----------
    network : Network
    control : str, float or sequence of them, optional
        Of the kind's first control: extension, angle, strain or load; with units or in SI.
    options : dict, optional
        PETSc options for the solver, without the prefix.
    **keys
        Those of the kind's `table`, as in ``[test]`` of a case file: ``finite`` (False: small
        displacements; by default only where something asks for them), ``bending`` (whether yarns
        resist it in the plane), ``space`` (the cloth may leave the plane, but on clamps and guides)
        and ``imperfection``, ``slip`` (how yarns slide through crossovers), ``increments`` (finite
        deformation: at least so many steps to the largest value), the controls by name, and the
        kind's own, which become attributes.

    Attributes
    ----------
    values : float (n,)
        Values asked for, SI; loads if ``by_load``.
    size, middle : float (2,)
        Of the outline's bounding box, m.
    prestretch : (float, float)
        Of warp and weft as the cloth is drawn.
    remarks : list of str
        What of preform, fabric and test is hardly meant; each is also an InputWarning, on rank 0.
    """

    table: ClassVar[type[TestTable]]  # of a case file
    kind = ""
    model = "coupled"  # all modes of deformation in one system
    # The curve's column of the control; further columns are declared in each kind's file.
    column: Quantity = EXTENSION
    # What is told of a state beside shear: columns of the curve that are forces, and what the
    # loaded end's movement is called.
    forces: tuple[str, ...] = (LOAD.column,)
    movement = "extension"
    # What the yarns' picture is coloured by; whether the outline cuts across the yarns.
    colour, cut_across = "shear angle", False
    # Whether yarns that clamps hold, and those that they do not, make zones of their own.
    has_zones = False
    # How the continuum beside it is held (continuum.compare): "gripped", pulled at the upper edge
    # like a bias test; "free", of which there is none; "" where nothing compares.
    reference = ""
    upper = "grip"
    # Angles that a normalised shear force is drawn over: columns of the curve, by what they are.
    shear_angles: ClassVar[dict[str, str]] = {}
    # What stands below the pictures that only this kind has.
    captions: ClassVar[dict[str, str]] = {}
    # Edges that are drawn as bars.
    clamps: tuple[str, ...] = ("lower", "upper")
    # In space: hold z of all nodes all the same.
    flat = False

    def __init__(
        self,
        network: Network,
        control: Any = None,
        *,
        options: dict | None = None,
        **keys: Any,
    ):
        # What the kind prescribes; `by_load`: a load in its place.
        self.control, self.unit = next(iter(self.table.controls.items()))
        first = {} if control is None else {self.control: control}
        data = dict(kind=self.kind, **first, **keys)  # no key twice
        data = {key: value for key, value in data.items() if value is not None}
        self.test = test = self.table.from_data(data, "test", bare=True)
        test.check(network.preform, network.fabric)
        self.remarks = remarks(network.preform, network.fabric, test)
        own = type(self).__init__ is not Experiment.__init__  # one call more from the user's line
        for sentence in self.remarks if network.comm.rank == 0 else ():
            warnings.warn(sentence, InputWarning, stacklevel=2 + own)
        self.is_curve, self.by_load = test.is_curve, test.control != self.control
        self.values = np.array(test.values_si)
        if not self.values.any():
            raise InputError(
                f"test.{test.control} has no value other than zero, so nothing would happen"
            )
        self.network, self.options = network, options or {}
        self.size, self.middle = network.preform.size, network.preform.middle
        self.space, self.imperfection = test.space, test.imperfection
        self.slip = None if test.slip is None else test.slip.build()
        self.stability, self.model = test.stability, test.model
        self.prestretch = prestretch(getattr(test, "pretension", None), network.fabric)
        self.finite, self.bending, self.increments = test.finite, test.bending, test.increments
        for key in test.own_keys():
            if key not in test.controls:
                setattr(self, key, getattr(test, key))
        count, each = network.num_crossovers_global, BYTES[test.bending]
        cure = "choose a coarser pitch (refine, yarns_per_cruciform), a smaller outline or more"
        what = f"the network has {count} crossovers"
        check_memory(network.comm, each * count, what, f"{cure} machines")

    @property
    def modes(self) -> tuple[str, ...]:
        """Modes of deformation that have a strain energy."""
        out_of_plane = ("out_of_plane_bending",) if self.space else ()
        return (*MODES, *out_of_plane, *(("slip",) if self.slip else ()))

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

    def travel(self, control: Any) -> Any:
        """How far what is pulled at ``test.speed`` has moved, m; shaped like `control`."""
        return control

    def extra_columns(self, result: TestResult) -> dict[str, np.ndarray]:
        """Further columns of the curve. Collective."""
        return {}

    def curve_columns(self, curve: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
        """Further columns of a finite test that follow from a whole curve, of all increments."""
        return {}

    def extensions(self, result: TestResult) -> np.ndarray:
        """How far the loaded end has moved along the load in each state, m; (n,). Collective."""
        return result.controls

    def figures(self, result: TestResult) -> dict[str, Any]:
        """Further figures for the summary. Collective."""
        return {}

    @property
    def energy_at_start(self) -> float:
        """Strain energy of the yarns' pretension where the test begins, J."""
        fabric, area = self.network.fabric, self.network.preform.outline.area
        return float(fabric.tension(self.prestretch)[0] * area / np.prod(self.prestretch))

    def drawn_curves(self, columns: dict[str, np.ndarray]) -> DrawnCurves | None:
        """What is drawn of the curve's columns, if not the load against the control."""
        return None

    def reference_control(self) -> float:
        """A control of a sensible size: for small displacements, and for first guesses."""
        if not self.by_load:
            return float(self.values[np.abs(self.values).argmax()])
        return 0.01 * float(self.size[1])

    def default_step(self) -> float | None:
        """Largest step of the control at finite deformation; None: from value to value."""
        return None

    def net_gauge(self) -> float | None:
        """Gauge length, m, for net_kinematics.net_angle; None where that does not hold."""
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
        ends = zip(counts, grips, strict=True)
        told = [", ".join(f"{count} yarn ends on the {grip.edge} edge" for count, grip in ends)]
        told = told if grips else []
        if hanging:
            told.append(f"{hanging} crossovers hang on by one arm end and will carry no load")
        return told

    def solve(
        self, accepted: Callable[[Increment], None] | None = None, keeper: Keeper | None = None
    ) -> TestResult:
        """Solve and measure. Collective.

        Small displacements beyond limits.SMALL_DEG of shear are a InputWarning on rank 0.

        At finite deformation ``accepted`` is called with each accepted Increment, and ``keeper`` is
        a checkpoint, kept up to date at each; from one opened from files the test goes on. Without
        it the result holds positions after each increment in memory, 16 bytes a node in the plane.

        Raises
        ------
        SolverError
            On every rank. At finite deformation an EquilibriumError, whose ``result`` holds what
            was reached (or None).
        """
        if self.finite:
            return solve_finite(self, accepted, keeper)
        result = self._solve_small()
        largest = float(result.shear_angles_max.max())
        if largest > np.deg2rad(SMALL_DEG) and self.network.comm.rank == 0:
            warnings.warn(beyond_small(largest, "finite=True"), InputWarning, stacklevel=2)
        return result

    def motions(self, grips: list[Grip], control: float) -> list:
        """Motions of the gripped edges: (network nodes, gradient, shift), see Ply.prescribed."""
        return [(nodes, *self.motion(edge, control)) for edge, nodes in grips]

    def velocity(self, grips: list[Grip], control: float) -> np.ndarray:
        """Change of the gripped nodes' places per change of the control, (n network nodes, 2)."""
        step = 1e-6 * max(abs(control), abs(self.reference_control()))
        place = self.network.node_position
        velocity = np.zeros_like(place)
        for edge, nodes in grips:
            ahead, behind = (self.motion(edge, control + sign * step) for sign in (1, -1))
            gradient, shift = ((a - b) / (2.0 * step) for a, b in zip(ahead, behind, strict=True))
            velocity[nodes] = place[nodes] @ gradient.T + shift
        return velocity

    # -- small displacements ----------------------------------------------------------------------

    def _solve_small(self) -> TestResult:
        network = self.network
        reference = self.reference_control()
        constraints = Constraints(network, self.bending)
        grips = self.grip(constraints)
        rate = self.velocity(grips, 0.0)
        yarn = np.einsum("nij,nj->ni", constraints.frame, network.to_yarn(rate) * reference)
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

        def soft_columns() -> np.ndarray:
            motions = linear.soft_motions()[owned]
            return motions.reshape(-1, motions.shape[2])

        solver = LinearSolver(matrix, soft_columns, extra=self.options, multigrid=linear.multigrid)
        x, info = solver.solve(rhs)
        local = linear.local(x)
        fields = linear.crossover_fields(local)
        state = State(reference, 0.0, fields, linear.node_displacement(local, fields))
        force = linear.element_forces(local)[:, :2]
        force = network.to_lab(np.einsum("nji,nj->ni", constraints.frame, force))
        # A load that is itself the control works on the nodes it acts on.
        work = float((force[owned] * rate[owned]).sum())
        state.load = self.load_of(network.comm.allreduce(work), reference)
        state.forces = self.edge_forces(grips, force)
        for thing in (solver, matrix, rhs, x):
            thing.destroy()
        return self.in_proportion(state, linear, info)

    def in_proportion(self, state: State, linear: LinearNetwork, info: SolverInfo) -> TestResult:
        """All values asked for from one state of small displacements."""
        per_control = state.load / state.control
        controls = self.values / per_control if self.by_load else self.values
        states = [state.scaled(control / state.control) for control in controls]
        if self.by_load:
            for scaled, load in zip(states, self.values, strict=True):
                scaled.load = float(load)  # not to the last digit by proportion
        return TestResult(self, linear.supports, linear.unknowns_per_node, states, solver=info)

    def edge_forces(self, grips: list[Grip], force: np.ndarray) -> dict[str, np.ndarray]:
        """Force (x, y) that holds each gripped edge. Collective."""
        owned, comm = self.network.num_nodes_owned, self.network.comm
        return {
            edge: comm.allreduce(force[nodes[nodes < owned]].sum(axis=0)) for edge, nodes in grips
        }

    def explain(self, error: EquilibriumError, done: list[Increment]) -> None:
        """Say in the error at which load, why and where."""
        reached = "at rest"
        if done:
            name = self.column.column.rpartition("_")[0]
            told = [f"{name} {format_si(done[-1].control, self.unit)}"]
            for column in self.forces:
                force = format_si(done[-1].columns[column] or 0.0, "N")
                told.append(f"{quantity(column).short} {force}")
            reached = f"at {', '.join(told)}"
        where = hint = ""
        if error.place is not None:
            x, y = (format_si(float(value), "m") for value in error.place[:2])
            where = f" at x = {x}, y = {y}"
        if error.reason not in ("FOLDED", "TORN"):  # these are at a place, whatever the increments
            where = where and f"; forces are farthest from balance{where}"
            hint = ". Smaller increments, yarn bending or a shear law that stiffens may help"
        error.args = (
            f"{self.kind}: no equilibrium beyond the last one found, {reached} ({error}, "
            f"{error.reason}){where}{hint}",
        )
