# SPDX-License-Identifier: MIT
"""What a test gives: a state for each value asked for, and what is measured on it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np

from ..net.lattice import SHORTEST_ARM
from ..parallel import least, most
from ..small.network import MODES

if TYPE_CHECKING:
    from ..equilibrium.stages import Increment
    from ..net.network import Network
    from ..net.supports import Supports
    from ..solvers.linear import SolverInfo

Fields = dict[str, np.ndarray]
ZONES = ("middle", "side", "clamp")


class State:
    """A deformed state of a network.

    Parameters
    ----------
    control, load : float
        SI.
    fields : dict, or callable that gives it
        See LinearNetwork.crossover_fields.
    node_displacement : float (n_local network nodes, 2), or callable that gives it
        In x and y, m.
    forces : dict of float (2,)
        Force (x, y) that holds each gripped edge, N.
    """

    def __init__(self, control, load, fields, node_displacement, forces=None):
        self.control, self.load = float(control), float(load)
        self._fields: Fields | Callable[[], Fields] = fields
        self._node_displacement = node_displacement
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
        fields, moved = self.fields, self.node_displacement
        return State(
            self.control * factor,
            self.load * factor,
            lambda: {
                name: value if value.dtype == bool
                else value * (factor**2 if name.endswith("energy") else factor)
                for name, value in fields.items()
            },
            lambda: moved * factor,
            {edge: force * factor for edge, force in self.forces.items()},
        )  # fmt: skip


@dataclass
class CentreLine:
    """Shear angle at the crossovers next to the specimen's long axis, on every rank.

    distance : float (n,) from the lower edge in m, ascending; shear_angle : float (n,) in radians.
    """

    distance: np.ndarray
    shear_angle: np.ndarray


@dataclass
class TestResult:
    """What a test gives. Plain attributes are for the last value asked for.

    Attributes
    ----------
    experiment : Experiment
    supports : Supports
    unknowns_per_node : int
    states : list of State
        One for each value asked for (fewer if the test ended early).
    solver : SolverInfo or None
        Of small displacements.
    increments : list of Increment
        Of finite deformation: all that were accepted.
    unknowns : int
        Of finite deformation.
    solver_types : dict
        Of finite deformation: PETSc's types by "snes", "ksp" and "pc"; see Equilibrium.types.
    uncarried : dict or None
        For the paper's separate systems: share of the load that each mode cannot carry.
    """

    __test__ = False  # not a test for pytest

    experiment: Any  # an Experiment, whose module imports this one
    supports: Supports
    unknowns_per_node: int
    states: list[State]
    solver: SolverInfo | None = None
    increments: list[Increment] = field(default_factory=list)
    unknowns: int = 0
    solver_types: dict[str, str] = field(default_factory=dict)
    uncarried: dict[str, float] | None = None

    def __repr__(self) -> str:
        column = self.experiment.column
        return (
            f"TestResult({self.experiment.kind}, {column.column} "
            f"{self.states[-1].control / column.scale:.4g}, "
            f"{self.load:.4g} N, {self.network!r})"
        )

    @property
    def network(self) -> Network:
        """What was tested."""
        return self.experiment.network

    @property
    def controls(self) -> np.ndarray:
        """Extension (m), angle (rad), strain or load (N) of each state, float (n,)."""
        return np.array([state.control for state in self.states])

    @property
    def extensions(self) -> np.ndarray:
        """The controls of a test that is pulled, m."""
        return self.controls

    @property
    def loads(self) -> np.ndarray:
        """Load of each state, N; float (n,)."""
        return np.array([state.load for state in self.states])

    @property
    def extension(self) -> float:
        """Last extension, m."""
        return self.states[-1].control

    @property
    def load(self) -> float:
        """Last load, N."""
        return self.states[-1].load

    @property
    def fields(self) -> Fields:
        """Fields at this rank's crossovers, last state. Collective when first asked for."""
        return self.states[-1].fields

    @property
    def node_displacement(self) -> np.ndarray:
        """Displacement of the network's nodes, last state, m. Collective when first asked for."""
        return self.states[-1].node_displacement

    def energies(self) -> dict[str, np.ndarray]:
        """Strain energy of each mode for each state, J. Collective."""
        comm = self.network.comm
        table = np.array(
            [[state.fields[f"{mode}_energy"].sum() for mode in MODES] for state in self.states]
        )
        return dict(zip(MODES, comm.allreduce(table).T, strict=True))

    # -- shear angles -----------------------------------------------------------------------------

    @property
    def shear_angle_max(self) -> float:
        """Largest shear angle of a crossover, radians, last state. Collective."""
        return float(self.shear_angles_max[-1])

    @property
    def shear_angles_max(self) -> np.ndarray:
        """Largest shear angle of a crossover, radians, each state. Collective."""
        own = [
            float(np.abs(state.fields["shear_angle"][state.fields["carrying"]]).max(initial=0.0))
            for state in self.states
        ]
        return np.max(self.network.comm.allgather(own), axis=0)

    @property
    def shear_angle_centre(self) -> float:
        """Shear angle in the middle of the specimen, radians, last state. Collective.

        The mean of the crossovers nearest to the middle (of the upper edge for a half specimen).
        """
        return float(self.shear_angles_centre[-1])

    @property
    def shear_angles_centre(self) -> np.ndarray:
        """The same for each state. Collective."""
        low_x, low_y, high_x, high_y = self.network.preform.outline.bounds
        half = self.experiment.upper == "centre-line"
        middle = np.array([0.5 * (low_x + high_x), high_y if half else 0.5 * (low_y + high_y)])
        distance = np.hypot(*(self.network.crossover_position - middle).T)
        distance = np.where(self.supports.carrying, distance, np.inf)
        comm = self.network.comm
        near = distance <= least(comm, distance) + 1e-3 * self.network.pitch.min()
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
        network = self.network
        edges = [edge for edge in self.experiment.clamps if edge in network.preform.edges]
        clamped = [network.preform.edge(edge) for edge in edges]
        held = np.zeros(network.num_crossovers_owned, np.int8)
        for family, yarns in enumerate((network.warp_yarns, network.weft_yarns)):
            ends = np.zeros((len(yarns.line), 2, 2))
            ends[..., 1 - family] = yarns.line[:, None]
            ends[:, 0, family], ends[:, 1, family] = yarns.start, yarns.end
            ends = network.to_lab(ends * network.pitch) + network.preform.lattice_origin
            is_held = np.zeros(len(ends), bool)
            for segments in clamped:
                for begin, end in segments:
                    along = (end - begin) / np.hypot(*(end - begin))
                    gap = ends - begin
                    inside = np.clip(gap @ along, 0.0, np.hypot(*(end - begin)))
                    off = gap - inside[..., None] * along
                    near = np.hypot(off[..., 0], off[..., 1])
                    is_held |= (near <= SHORTEST_ARM * network.pitch.max()).any(axis=1)
            ij = network.crossover_ij
            part = yarns.find(ij[:, 1 - family], ij[:, family])
            held += is_held[part] & (part >= 0)
        return np.where(self.supports.carrying, held, -1).astype(np.int8)

    def zone_angles(self) -> dict[str, np.ndarray]:
        """Median shear angle of each zone for each state, radians; NaN where it is empty.

        Collective. By zone: ``middle``, ``side``, ``clamp``, see `zones`.
        """
        comm, zones = self.network.comm, self.zones
        angles = {name: np.full(len(self.states), np.nan) for name in ZONES}
        for number, name in enumerate(ZONES):
            at = zones == number
            for i, state in enumerate(self.states):
                angles[name][i] = _median(comm, state.fields["shear_angle"][at])
        return angles

    # -- curves -----------------------------------------------------------------------------------

    def curve(self) -> dict[str, np.ndarray]:
        """Columns of the test's curve, units in their names. Collective when first asked for."""
        return dict(self._curve)

    @cached_property
    def _curve(self) -> dict[str, np.ndarray]:
        control = self.experiment.column
        columns = {control.column: self.controls / control.scale}
        columns.setdefault("load_N", self.loads)
        columns["shear_centre_deg"] = np.rad2deg(self.shear_angles_centre)
        columns["shear_max_deg"] = np.rad2deg(self.shear_angles_max)
        if self.experiment.has_zones:
            for zone, angle in self.zone_angles().items():
                columns[f"shear_{zone}_deg"] = np.rad2deg(angle)
        columns |= {f"energy_{mode}_J": value for mode, value in self.energies().items()}
        return columns | self.experiment.extra_columns(self)

    def centre_line(self, angle: np.ndarray | None = None) -> CentreLine:
        """Shear angle along the long axis of the specimen, from the lower clamp. Collective.

        Takes the crossovers within half a lattice diagonal of the axis and averages those at one
        height. ``angle`` replaces the network's own shear angle (n,), e.g. by a membrane's.
        """
        network = self.network
        angle = self.fields["shear_angle"] if angle is None else angle
        low_x, low_y, high_x, _ = network.preform.outline.bounds
        near = np.abs(network.crossover_position[:, 0] - 0.5 * (low_x + high_x))
        near = (near < 0.51 * network.pitch.max()) & self.fields["carrying"]
        rows = np.column_stack([network.crossover_position[near, 1] - low_y, angle[near]])
        rows = np.concatenate(network.comm.allgather(rows))
        height = np.round(rows[:, 0] / (0.01 * network.pitch.min())).astype(np.int64)
        _, first, inverse = np.unique(height, return_index=True, return_inverse=True)
        count = np.bincount(inverse)
        return CentreLine(rows[first, 0], np.bincount(inverse, weights=rows[:, 1]) / count)


def _median(comm, values: np.ndarray) -> float:
    """Median of all ranks' values to 1e-12 of their range, found by halving it. Collective."""
    count = comm.allreduce(len(values))
    if not count:
        return float("nan")
    low, high = least(comm, values), most(comm, values)
    for _ in range(40):
        middle = 0.5 * (low + high)
        if 2 * comm.allreduce(int((values <= middle).sum())) >= count:
            high = middle
        else:
            low = middle
    return high
