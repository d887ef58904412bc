# SPDX-License-Identifier: MIT
"""What a test gives: a state for each value asked for, and what is measured on it."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from copy import copy
from dataclasses import dataclass, field
from functools import cached_property
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
import shapely

from ..drawn import InSpace, Mapped, Plotted, Shown
from ..net.lattice import SHORTEST_ARM
from ..parallel import least, most, quantile
from ..quantities import LOAD, Quantity, data_frame

if TYPE_CHECKING:
    from ..equilibrium.stages import Increment
    from ..net.network import Network
    from ..net.supports import Supports
    from ..solvers.linear import SolverInfo

Fields = dict[str, np.ndarray]
ZONES = ("middle", "side", "clamp")
SHARE = 0.99  # of the cloth's area, with values up to the quantiles that stand beside extremes
# Columns of a curve that tell of an increment how it was found, and its attributes.
EFFORT = {
    "asked": "asked",
    "newton_iterations": "iterations",
    "residual_N": "residual",
    "tolerance_N": "tolerance",
    "cuts": "cuts",
    "seconds": "seconds",
}


class State:
    """A deformed state of a network, in SI.

    ``load`` is that of the test, of a biaxial one what does the work of both its forces. ``fields``
    (see LinearNetwork.crossover_fields) and ``node_displacement`` (n_local network nodes, dim) in
    x, y (and z) may be callables that give them; ``forces`` (x, y) hold the gripped edges.
    """

    def __init__(self, control, load, fields, node_displacement, forces=None):
        self.control, self.load = float(control), float(load)
        self._fields, self._node_displacement = fields, node_displacement
        self.forces: dict[str, np.ndarray] = forces or {}

    @cached_property
    def fields(self) -> Fields:
        """Fields at this rank's crossovers. Collective when first asked for."""
        return self._fields() if callable(self._fields) else self._fields

    @cached_property
    def node_displacement(self) -> np.ndarray:
        """Displacement of the network's local nodes, m. Collective when first asked for."""
        given = self._node_displacement
        return given() if callable(given) else given

    def scaled(self, factor: float) -> State:
        """The state of small displacements that are ``factor`` times as large."""

        def size(name: str, values: np.ndarray) -> float | bool:
            if values.dtype == bool:
                return True
            return factor**2 if name.endswith("energy") else factor

        fields, moved = self.fields, self.node_displacement
        return State(
            self.control * factor,
            self.load * factor,
            lambda: {name: values * size(name, values) for name, values in fields.items()},
            lambda: moved * factor,
            {edge: force * factor for edge, force in self.forces.items()},
        )


class CentreLine(NamedTuple):
    """Shear angle (n,) in radians at ascending distances (n,) in m from the lower edge."""

    distance: np.ndarray
    shear_angle: np.ndarray


@dataclass
class Critical:
    """A critical state, or one that the linearised problem foretells.

    Attributes
    ----------
    control, load : float
        SI; the load as the test has it.
    """

    control: float
    load: float


@dataclass
class Buckling:
    """What is known of a test's stability.

    Attributes
    ----------
    linear : list of Critical
        Of the linearised problem, from rest: one for each mode that there is.
    passed : list of Critical
        Found on the way, in order.
    modes : list of State
        Shapes of the first critical state, else of the linearised problem: as displacements from
        rest whose largest is 1 m.
    stiffness : list of float
        What holds these shapes, N/m^3; of the linearised problem at rest.
    """

    linear: list[Critical]
    passed: list[Critical] = field(default_factory=list)
    modes: list[State] = field(default_factory=list)
    stiffness: list[float] = field(default_factory=list)

    def figures(self, column: Quantity) -> dict[str, Any]:
        """Plain data; ``column`` is the control's."""

        def told(states: Sequence[Critical]) -> list[dict[str, float]]:
            key = column.column.lower()
            return [{key: state.control / column.scale, "load_n": state.load} for state in states]

        return {
            "linear": told(self.linear),
            "critical": told(self.passed),
            "mode_stiffness_pa_per_mm": [1e-3 * value for value in self.stiffness],
        }


@dataclass
class TestResult(Shown, Plotted, Mapped, InSpace):
    """What a test gives; one value is that of the last state."""

    __test__ = False  # not a test for pytest

    experiment: Any  # an Experiment, whose module imports this one
    supports: Supports
    unknowns_per_node: int
    states: list[State]
    """One for each value asked for (fewer if the test ended early)."""
    solver: SolverInfo | None = None
    """Of small displacements."""
    increments: list[Increment] = field(default_factory=list)
    """Of finite deformation: all that were accepted."""
    state_after: Callable[[int], State] | None = None
    """Of finite deformation: makes the state after an increment, by its number. Collective."""
    unknowns: int = 0
    solver_types: dict[str, str] = field(default_factory=dict)
    """Of finite deformation: PETSc's types by "snes", "ksp" and "pc"."""
    buckling: Buckling | None = None
    """Critical loads and modes, where the test was asked for them."""
    uncarried: dict[str, float] | None = None
    """For the paper's separate systems: share of the load that each mode cannot carry."""

    def __repr__(self) -> str:
        test, column = self.experiment, self.experiment.column
        control = f"{column.column} {self.extension / column.scale:.4g}"
        force = ", ".join(f"{values[-1]:.4g} N" for values in self.forces.values())
        return f"TestResult({test.kind}, {control}, {force}, {self.network!r})"

    @property
    def network(self) -> Network:
        """What was tested."""
        return self.experiment.network

    @property
    def controls(self) -> np.ndarray:
        """Extension (m), angle (rad), strain or load (N) of each state; float (n,)."""
        return np.array([state.control for state in self.states])

    @property
    def extensions(self) -> np.ndarray:
        """The controls of a test that is pulled, m."""
        return self.controls

    @property
    def forces(self) -> dict[str, np.ndarray]:
        """Forces of each state by the curve's columns, N; float (n,). Collective at first."""
        curve = self.curve(states=True)
        return {column: curve[column] for column in self.experiment.forces}

    @property
    def loads(self) -> np.ndarray:
        """Load of each state, N; float (n,). AttributeError of tests with several `forces`."""
        test = self.experiment
        if LOAD.column not in test.forces:
            names = " and ".join(test.forces)
            raise AttributeError(f"a {test.kind} test has no load, its forces are {names}")
        return np.array([state.load for state in self.states])

    @property
    def extension(self) -> float:
        """Last extension, m, or other control."""
        return self.states[-1].control

    @property
    def load(self) -> float:
        """Last load, N; see loads."""
        return float(self.loads[-1])

    @property
    def fields(self) -> Fields:
        """See State."""
        return self.states[-1].fields

    @property
    def node_displacement(self) -> np.ndarray:
        """See State."""
        return self.states[-1].node_displacement

    def every_state(self) -> Iterator[State]:
        """States after all increments, one at a time; else those asked for. Collective."""
        if self.state_after is None:
            yield from self.states
            return
        known = dict(zip(self._numbers, self.states, strict=True))
        for number in range(len(self.increments)):
            yield known.get(number) or self.state_after(number)

    @property
    def _numbers(self) -> list[int]:
        """Numbers of the increments that led to the states."""
        asked = [number for number, step in enumerate(self.increments) if step.asked]
        ended_early = len(asked) < len(self.states)
        return asked + ended_early * [len(self.increments) - 1]

    def energies(self) -> dict[str, np.ndarray]:
        """Strain energy of each mode for each state, J. Collective."""
        fields = [state.fields for state in self.states]
        modes = self.experiment.modes
        own = np.array([[at[f"{mode}_energy"].sum() for at in fields] for mode in modes])
        return dict(zip(modes, self.network.comm.allreduce(own), strict=True))

    @property
    def heights_max(self) -> np.ndarray:
        """In space, largest distance of a crossover from the plane in each state, m. Collective."""
        heights = [abs(state.fields["displacement"][:, 2:]) for state in self.states]
        return np.array([most(self.network.comm, z, 0.0) for z in heights])

    # -- shear angles -----------------------------------------------------------------------------

    @property
    def shear_angle_max(self) -> float:
        """Largest shear angle of a crossover, radians. Collective."""
        return float(self.shear_angles_max[-1])

    @property
    def shear_angles_max(self) -> np.ndarray:
        """Largest shear angle of a crossover, radians, each state. Collective."""
        own = [
            float(np.abs(state.fields["shear_angle"][state.fields["carrying"]]).max(initial=0.0))
            for state in self.states
        ]
        return np.max(self.network.comm.allgather(own), axis=0)

    @cached_property
    def area_weight(self) -> np.ndarray:
        """Area around each of this rank's crossovers that carry load, for `quantile`; int64 (n,).

        In millionths of a cell of the lattice.
        """
        area = self.network.quadrant_area.sum(axis=1) / self.network.pitch.prod()
        return np.rint(1e6 * np.where(self.supports.carrying, area, 0.0)).astype(np.int64)

    @property
    def shear_angle_centre(self) -> float:
        """Shear angle in the middle of the specimen, radians. Collective.

        The mean of the crossovers nearest to the middle (of the upper edge for a half specimen);
        NaN where there is no cloth.
        """
        return float(self.shear_angles_centre[-1])

    @property
    def shear_angles_centre(self) -> np.ndarray:
        """The same for each state. Collective."""
        middle = self.network.preform.middle
        if self.experiment.upper == "centre-line":
            middle[1] += 0.5 * self.network.preform.size[1]
        network, comm = self.network, self.network.comm
        distance = np.hypot(*(network.crossover_position - middle).T)
        distance = np.where(self.supports.carrying, distance, np.inf)
        nearest, rounding = least(comm, distance), 1e-3 * network.pitch.min()
        hole = network.preform.outline.distance(shapely.Point(middle)) > rounding
        if hole or nearest > np.hypot(*network.pitch):
            return np.full(len(self.states), np.nan)
        near = distance <= nearest + rounding
        sums = [state.fields["shear_angle"][near].sum() for state in self.states]
        total = comm.allreduce(np.array([*sums, near.sum()], float))
        return total[:-1] / total[-1]

    @cached_property
    def zones(self) -> np.ndarray:
        """Zone of each of this rank's crossovers, int8 (n,).

        0: neither of its yarns ends in a clamp (the middle of a bias test), 1: one does (the
        sides), 2: both do (the clamps' triangles); -1 for crossovers that carry nothing. In a bias
        test with H >= 2 W these are the zones of the usual kinematics.
        """
        network, edges = self.network, self.network.preform.edges
        clamped = [part for name in self.experiment.clamps for part in edges.get(name, ())]
        clamps, touch = shapely.MultiLineString(clamped), SHORTEST_ARM * network.pitch.max()
        held = np.zeros(network.num_crossovers_owned, np.int8)
        for family, yarns in enumerate((network.warp_yarns, network.weft_yarns)):
            ends = np.zeros((len(yarns.line), 2, 2))
            ends[..., 1 - family] = yarns.line[:, None]
            ends[:, 0, family], ends[:, 1, family] = yarns.start, yarns.end
            ends = network.to_lab(ends * network.pitch) + network.origin
            is_held = (shapely.distance(shapely.points(ends), clamps) <= touch).any(axis=1)
            ij = network.crossover_ij
            part = yarns.find(ij[:, 1 - family], ij[:, family])
            held += is_held[part] & (part >= 0)
        return np.where(self.supports.carrying, held, -1).astype(np.int8)

    def zone_angles(self) -> dict[str, np.ndarray]:
        """Median shear angle of each zone for each state, radians; NaN where it is empty.

        Collective. By zone: ``middle``, ``side``, ``clamp``, see `zones`.
        """
        comm, angles = self.network.comm, [state.fields["shear_angle"] for state in self.states]
        return {
            name: np.array([quantile(comm, angle[self.zones == number], 0.5) for angle in angles])
            for number, name in enumerate(ZONES)
        }

    # -- curves -----------------------------------------------------------------------------------

    def curve(self, states: bool = False) -> dict[str, np.ndarray]:
        """Columns of the test's curve, units in their names. Collective when first asked for.

        Rows are all accepted increments, ``asked`` is 1 where a value was asked for, and further
        columns tell how equilibrium was found (EFFORT); with ``states`` rows are the result's
        states, without these columns. At small displacements these are the same rows.
        """
        if not self.increments:
            return self._measured | ({} if states else {"asked": np.ones(len(self.states), int)})
        curve = curve_of(self.increments, self.experiment)
        if not states:
            return curve
        return {name: curve[name][self._numbers] for name in curve if name not in EFFORT}

    def frame(self, states: bool = False) -> Any:
        """The same as a pandas.DataFrame; InputError where pandas is not installed. Collective."""
        return data_frame(self.curve(states))

    def row(self, state: State) -> dict[str, float | None]:
        """What a curve tells of a state; None is for not a number. Collective."""
        alone = copy(self)
        for name in ("area_weight", "zones") if self.experiment.has_zones else ("area_weight",):
            alone.__dict__[name] = getattr(self, name)  # found once
        alone.states = [state]
        values = {name: float(value[0]) for name, value in alone._measure().items()}
        return {name: value if np.isfinite(value) else None for name, value in values.items()}

    @cached_property
    def _measured(self) -> dict[str, np.ndarray]:
        return self._measure()

    def _measure(self) -> dict[str, np.ndarray]:
        control = self.experiment.column
        columns = {control.column: self.controls / control.scale}
        if LOAD.column in self.experiment.forces:
            columns[LOAD.column] = self.loads
        columns["shear_centre_deg"] = np.rad2deg(self.shear_angles_centre)
        columns["shear_max_deg"] = np.rad2deg(self.shear_angles_max)
        sizes = (abs(state.fields["shear_angle"]) for state in self.states)
        quantiles = [quantile(self.network.comm, a, SHARE, self.area_weight) for a in sizes]
        columns["shear_99_deg"] = np.rad2deg(quantiles)
        if self.experiment.has_zones:
            for zone, angle in self.zone_angles().items():
                columns[f"shear_{zone}_deg"] = np.rad2deg(angle)
        if self.experiment.space:
            columns["height_max_mm"] = 1e3 * self.heights_max
        if self.experiment.slip is not None:
            slips = [abs(state.fields["slip"]) for state in self.states]
            columns["slip_max_mm"] = 1e3 * np.array(
                [most(self.network.comm, s, 0.0) for s in slips]
            )
        columns |= {f"energy_{mode}_J": value for mode, value in self.energies().items()}
        return columns | self.experiment.extra_columns(self)

    def centre_line(self, angle: np.ndarray | None = None) -> CentreLine:
        """Shear angle along the long axis of the specimen, from the lower clamp. Collective.

        Takes the crossovers within half a lattice diagonal of the axis and averages those at one
        height. ``angle`` replaces the network's own shear angle (n,), e.g. by a membrane's.
        """
        network = self.network
        angle = self.fields["shear_angle"] if angle is None else angle
        x, y = network.crossover_position.T
        near = np.abs(x - network.preform.middle[0]) < 0.51 * network.pitch.max()
        near &= self.fields["carrying"]
        rows = np.column_stack([y[near] - network.preform.outline.bounds[1], angle[near]])
        rows = np.concatenate(network.comm.allgather(rows))
        height = np.round(rows[:, 0] / (0.01 * network.pitch.min())).astype(np.int64)
        _, first, inverse = np.unique(height, return_index=True, return_inverse=True)
        count = np.bincount(inverse)
        return CentreLine(rows[first, 0], np.bincount(inverse, weights=rows[:, 1]) / count)


def curve_of(increments: Sequence[Increment], experiment: Any) -> dict[str, np.ndarray]:
    """Columns of an experiment's curve with a row for each increment."""
    columns = {
        name: np.array([step.columns[name] for step in increments], float)
        for name in (increments[0].columns if increments else {})
    }
    effort = {name: [getattr(step, key) for step in increments] for name, key in EFFORT.items()}
    columns |= experiment.curve_columns(columns) if columns else {}
    return columns | {name: 1 * np.array(values) for name, values in effort.items()}
