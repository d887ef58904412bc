# SPDX-License-Identifier: MIT
"""Bias extension: a strip clamped at its lower edge and pulled at its upper one (paper, section 6).

Small displacements: everything follows from one solution by proportion, so a list of loads or
extensions costs no more than one value.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np

from ..assembly import MODES, LinearNetwork
from ..constraints import Constraints
from ..errors import InputError
from ..network import Network
from ..solvers.linear import LinearSolver, SolverInfo
from ..solvers.multigrid import yarn_multigrid
from ..solvers.separate import solve_separately
from ..supports import find_supports
from ..units import to_si

if TYPE_CHECKING:
    from ..continuum.compare import Comparison
    from ..continuum.membrane import MembraneResult

PULL = (0.0, 1.0)


class BiasExtension:
    """Bias-extension test of a network, y being the direction of pull.

    Parameters
    ----------
    network : Network
    extension : str, float or sequence of them, optional
        Displacement of the upper edge, with units or in metres.
    load : str, float or sequence of them, optional
        Force on the upper edge, with units or in newtons. Just one of the two is given.
    upper : "grip" or "centre-line"
        Gripped like the lower edge; or the paper's half specimen, whose upper edge is the middle of
        the whole one: it moves as one along the pull and is free across it.
    model : "coupled" or "separate"
        All modes of deformation in one system; or the paper's three systems, one after the other
        (see solvers.separate).
    bending : bool
        Whether yarns resist bending in the plane.
    options : dict, optional
        PETSc options for the solver, without the prefix.
    """

    def __init__(
        self,
        network: Network,
        extension: Any = None,
        load: Any = None,
        *,
        upper: str = "grip",
        model: str = "coupled",
        bending: bool = True,
        options: dict | None = None,
    ):
        if (extension is None) == (load is None):
            raise InputError("give either an extension or a load")
        if upper not in ("grip", "centre-line"):
            raise InputError(f"upper is '{upper}'; it can be 'grip' or 'centre-line'")
        if model not in ("coupled", "separate"):
            raise InputError(f"model is '{model}'; it can be 'coupled' or 'separate'")
        given = extension if load is None else load
        self.by_load = extension is None
        self.is_curve = isinstance(given, Sequence) and not isinstance(given, str)
        unit, key = ("N", "load") if self.by_load else ("m", "extension")
        values = to_si(list(given) if self.is_curve else [given], unit, key, bare=True)
        self.values = np.array(values, float)
        if not self.values.size or not self.values.any():
            raise InputError(f"{key} has no value other than zero, so nothing would happen")
        for family in ("warp", "weft"):
            if bending and getattr(network.fabric, family).yarn_bending == 0.0:
                raise InputError(
                    f"bending is on but the fabric's {family} yarns have no bending rigidity: give "
                    "them one or set bending = false"
                )
        self.network, self.upper, self.model, self.bending = network, upper, model, bending
        self.options = options or {}

    def solve(self) -> BiasExtensionResult:
        """Solve and measure. Collective; raises SolverError on every rank if a solver fails."""
        return self._solve_separately() if self.model == "separate" else self._solve_coupled()

    def _reference_extension(self) -> float:
        """Some extension of a sensible size to solve for, m."""
        if not self.by_load:
            return float(self.values[np.abs(self.values).argmax()])
        low, high = self.network.preform.outline.bounds[1::2]
        return 0.01 * (high - low)

    def check(self) -> list[str]:
        """Apply the clamps without solving; what there is to say about them. Collective.

        Raises InputError on every rank if yarns miss an edge or a part is held by no clamp.
        """
        constraints, upper = self._grip(self._reference_extension())
        lower = constraints.nodes_on("lower")
        network = self.network
        owned = network.num_nodes_owned
        counts = network.comm.allreduce(
            np.array([(nodes < owned).sum() for nodes in (lower, upper)])
        )
        supports = find_supports(constraints)
        hanging = network.comm.allreduce(supports.num_hanging)
        told = [f"{counts[0]} yarn ends in the lower clamp, {counts[1]} on the upper edge"]
        if hanging:
            told.append(f"{hanging} crossovers hang on by one arm end and will carry no load")
        return told

    def _grip(self, extension: float) -> tuple[Constraints, np.ndarray]:
        """The network with both edges constrained, and the local nodes of the upper one."""
        constraints = Constraints(self.network, self.bending)
        constraints.clamp("lower")
        if self.upper == "grip":
            upper = constraints.clamp("upper", (0.0, extension))
        else:
            upper = constraints.guide("upper", PULL, extension)
        return constraints, upper

    def _solve_coupled(self) -> BiasExtensionResult:
        network = self.network
        reference = self._reference_extension()
        constraints, upper = self._grip(reference)
        linear = LinearNetwork(constraints)
        matrix = linear.matrix()
        prescribed = np.where(constraints.fixed, constraints.value, 0.0)
        right = -linear.element_forces(prescribed)
        right[~linear.free] = 0.0
        rhs = linear.vector(right)
        near_null = linear.rigid_motions()
        near_null[~linear.free] = 0.0
        owned = near_null[: network.num_nodes_owned].reshape(-1, 3)
        solver = LinearSolver(
            matrix, owned, extra=self.options, multigrid=partial(yarn_multigrid, linear)
        )
        x, info = solver.solve(rhs)
        local = linear.local(x)
        force = linear.element_forces(local)[:, :2]
        force = np.einsum("nji,nj->ni", constraints.frame, force) @ network.preform.rotation
        upper = upper[upper < network.num_nodes_owned]
        load = network.comm.allreduce(float(force[upper, 1].sum()))
        fields = linear.crossover_fields(local)
        moved = linear.node_displacement(local, fields)
        solver.destroy()
        for thing in (matrix, rhs, x):
            thing.destroy()
        return BiasExtensionResult(self, linear, info, reference, load, fields, moved)

    def _solve_separately(self) -> BiasExtensionResult:
        network = self.network
        constraints = Constraints(network, self.bending)
        constraints.clamp("lower")
        constraints.tie("upper", PULL, gripped=self.upper == "grip")
        linear = LinearNetwork(constraints)
        load = 1.0
        modes = solve_separately(linear, load, self.options)
        total = None
        extension, moved = 0.0, np.zeros((network.num_nodes_local, 2))
        for mode, solution in modes.items():
            fields = linear.crossover_fields(solution.displacement, mode)
            moved = moved + linear.node_displacement(solution.displacement, fields)
            extension += solution.tied_displacement
            if total is None:
                total = fields
            else:
                # Each mode's own measure from its own system; displacements add up.
                total["displacement"] = total["displacement"] + fields["displacement"]
                total[f"{mode}_energy"] = fields[f"{mode}_energy"]
                if mode == "shear":
                    for name in ("shear_angle", "arm_rotation"):
                        total[name] = fields[name]
        if extension == 0.0:
            raise InputError("no mode by itself lets the upper edge move; use model = 'coupled'")
        info = modes["shear"].solver
        result = BiasExtensionResult(self, linear, info, extension, load, total, moved)
        result.uncarried = {mode: solution.uncarried for mode, solution in modes.items()}
        return result


@dataclass
class CentreLine:
    """Shear angle at the crossovers next to the specimen's long axis, on every rank.

    distance : float (n,) from the lower edge in m, ascending; shear_angle : float (n,) in radians.
    """

    distance: np.ndarray
    shear_angle: np.ndarray


class BiasExtensionResult:
    """What a bias-extension test gives. Plain attributes are for the last value asked for.

    Attributes
    ----------
    extensions, loads : float (n,)
        m and N, one for each value asked for.
    fields : dict of arrays over this rank's crossovers
        See LinearNetwork.crossover_fields.
    node_displacement : float (n_local nodes, 2), m
    solver : SolverInfo
    uncarried : dict or None
        For the separate model: share of the load that each mode cannot carry.
    """

    def __init__(self, experiment, linear, solver, extension, load, fields, node_displacement):
        self.experiment: BiasExtension = experiment
        self.network: Network = experiment.network
        self.linear: LinearNetwork = linear
        self.solver: SolverInfo = solver
        self.uncarried: dict[str, float] | None = None
        self.stiffness = load / extension
        values = experiment.values
        self.extensions = values / self.stiffness if experiment.by_load else values
        self.loads = values if experiment.by_load else values * self.stiffness
        factor = float(self.extensions[-1] / extension)
        self._factors = self.extensions / extension
        self.fields = {
            name: value * (factor**2 if name.endswith("energy") else factor)
            if value.dtype != bool else value
            for name, value in fields.items()
        }  # fmt: skip
        self.node_displacement = node_displacement * factor
        self._relative = self._factors / factor if factor else np.zeros_like(self._factors)

    def __repr__(self) -> str:
        return (
            f"BiasExtensionResult({1e3 * self.extension:.4g} mm, {self.load:.4g} N, "
            f"{self.network!r})"
        )

    @property
    def extension(self) -> float:
        """Last extension, m."""
        return float(self.extensions[-1])

    @property
    def load(self) -> float:
        """Last load, N."""
        return float(self.loads[-1])

    def energies(self) -> dict[str, np.ndarray]:
        """Strain energy of each mode for each value, J. Collective."""
        comm = self.network.comm
        return {
            mode: comm.allreduce(float(self.fields[f"{mode}_energy"].sum())) * self._relative**2
            for mode in MODES
        }

    @property
    def shear_angle_max(self) -> float:
        """Largest shear angle of a crossover, radians, last value. Collective."""
        own = np.abs(self.fields["shear_angle"][self.fields["carrying"]]).max(initial=0.0)
        return max(self.network.comm.allgather(float(own)))

    @property
    def shear_angle_centre(self) -> float:
        """Shear angle in the middle of the specimen, radians, last value. Collective.

        The mean of the crossovers nearest to the middle (of the upper edge for a half specimen).
        """
        low_x, low_y, high_x, high_y = self.network.preform.outline.bounds
        half = self.experiment.upper == "centre-line"
        middle = np.array([0.5 * (low_x + high_x), high_y if half else 0.5 * (low_y + high_y)])
        carrying = self.fields["carrying"]
        distance = np.hypot(*(self.network.crossover_position - middle).T)
        distance = np.where(carrying, distance, np.inf)
        comm = self.network.comm
        nearest = min(comm.allgather(float(distance.min(initial=np.inf))))
        near = distance <= nearest + 1e-3 * self.network.pitch.min()
        total, count = comm.allreduce(
            np.array([self.fields["shear_angle"][near].sum(), near.sum()], float)
        )
        return float(total / count)

    def curve(self) -> dict[str, np.ndarray]:
        """Columns of the test's curve, with units in their names. Collective."""
        energies = self.energies()
        centre, largest = self.shear_angle_centre, self.shear_angle_max
        return {
            "extension_mm": 1e3 * self.extensions,
            "load_N": self.loads,
            "shear_centre_deg": np.rad2deg(centre) * self._relative,
            "shear_max_deg": np.rad2deg(largest) * np.abs(self._relative),
            **{f"energy_{mode}_J": value for mode, value in energies.items()},
        }

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

    def membrane(self, size: float | None = None) -> MembraneResult:
        """The continuum with the same outline, edges and last extension (dolfinx). Collective."""
        from ..continuum.membrane import Membrane

        reference = Membrane(self.network.comm, self.network.preform, self.network.fabric, size)
        return reference.solve_bias_extension(self.extension, self.experiment.upper)

    def compare_with_membrane(self, membrane: MembraneResult | None = None) -> Comparison:
        """Differences to the continuum at the crossovers, last value. Collective."""
        from ..continuum.compare import compare_fields

        membrane = membrane or self.membrane()
        carrying = self.fields["carrying"]
        energy = sum(value[-1] for value in self.energies().values())
        return compare_fields(
            self.network.comm,
            self.network.crossover_position[carrying],
            self.fields["displacement"][carrying],
            self.fields["shear_angle"][carrying],
            self.load,
            energy,
            membrane,
        )

    def plot(self, path: str) -> None:
        """Draw the yarns before and after, coloured by shear angle, as a PNG. Collective."""
        from ..output.figures import draw_yarns

        draw_yarns(path, self)

    def write(self, path: str) -> None:
        """Write a file that ParaView opens: deformed yarns with their fields. Collective."""
        from ..output.paraview import write_network

        write_network(path, self.network, self.node_displacement, self.fields)
