# SPDX-License-Identifier: MIT
"""Least squares for the shear law on the network itself.

Unknown are the rises of a table psi'(gamma) from one angle to the next, none of them negative.
The sum that is made small is

    1/n sum ((F_i - f_i)/f_i)^2 + smoothing^2/m sum s_k^2
    s_k = second difference of ln psi' over ln gamma at the inner knot k, of m:
          (slope after - slope before)(mean of the neighbouring steps)

F_i being the load of the whole network at the measured displacement, f_i the measured force. The
second term is none for a straight line, for a plateau and for any power of the angle, and little
for a law that climbs steeply towards locking.

Its derivatives are exact. At equilibrium the energy W(c, p) under the extension c has the
derivative dW/dp = sum of A d psi/dp(gamma) over the quadrants, because places give nothing to
first order (envelope theorem). The load is dW/dc, hence

    dF/dp = d/dc dW/dp = sum over crossovers of (gradient of A d psi/dp by places) . dx/dc

with dx/dc, the answer of the places to the clamp, from one linear solve with the tangent.
"""

from __future__ import annotations

import logging
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Any

import numpy as np

from ..cloth.fabric import Fabric
from ..elements import cruciform as kernels
from ..elements.cruciform import ENERGY, FORCE, Cloth
from ..elements.kinematics import net_reach
from ..equilibrium.finite import FiniteNetwork
from ..equilibrium.newton import Equilibrium, EquilibriumError, follow
from ..errors import CruciformError, InputError
from ..experiments.bias_extension import BiasExtension
from ..experiments.experiment import Experiment
from ..experiments.picture_frame import PictureFrame
from ..laws import LINEAR, TABLE, Potential, linear
from ..laws import table as table_law
from ..net.edges import Constraints
from ..net.network import Network
from ..units import format_si
from .curve import MeasuredCurve
from .formula import frame_angle, torque_from_frame, torque_from_loads

KINDS = ("bias-extension", "picture-frame")
OFF_RECTANGLE = 1e-6  # of its area, that a rectangle given as a polygon may be
# Angles of the table, degrees: close where friction makes the first rise, then six degrees apart.
LADDER = (2.0, 4.0, 7.0, 11.0, 16.0, 22.0, *np.arange(28.0, 89.0, 6.0))
SMOOTHING = 0.3
LARGEST_FRAME_ANGLE = np.deg2rad(85.0)
# A law may not fall, and must rise at least by this part of its mean slope, for a stable cloth.
LEAST_SLOPE = 0.02
# A value whose standard error is larger than this part of it counts as not determined.
LARGEST_ERROR = 0.2
# Relative; loads are not measured better than that, however well a curve may fit.
LEAST_NOISE = 0.01
POOR_FIT = 0.1  # RMS of the relative error that a remark is made on
# What the law depends on without being identified, worth a look each time.
ASSUMED = ("tension modulus", "yarn bending", "compression")
PLACE = "place of the yarns"
TURN = 1e-5  # rad, of a frame, for differences
TOLERANCE = 1e-4  # relative change of the sum that ends the iterations
EXACT = 1e-10  # a sum so small is none: loads are equilibria to about the root of it
MOST_ITERATIONS = 30

_LOG = logging.getLogger(__name__)


class LoadCurve:
    """Loads of a specimen at given displacements, for one shear law after the other. Collective.

    Each equilibrium starts from that of the last accepted law at the same displacement, which takes
    two or three Newton steps. Call destroy when done.

    Parameters
    ----------
    network : Network
    displacement : float (n,)
        Ascending [m]: extensions, or growths of the diagonal of a picture frame.
    kind : "bias-extension" or "picture-frame"
    upper, bending, options
        See BiasExtension; ``upper`` is not looked at for a picture frame.
    """

    def __init__(
        self,
        network: Network,
        displacement: np.ndarray,
        *,
        kind: str = "bias-extension",
        upper: str = "grip",
        bending: bool = True,
        options: dict | None = None,
    ):
        self.network, self.displacement = network, np.asarray(displacement, float)
        self.kind, self.upper = kind, upper
        self.experiment: Experiment
        # Of the experiment: extensions, m, or angles of the frame, rad.
        self.controls = self.displacement
        if kind == "picture-frame":
            self.controls = frame_angle(self.displacement, _frame(network))
            self.experiment = PictureFrame(
                network, self.controls.tolist(), finite=True, bending=bending
            )
        else:
            self.experiment = BiasExtension(
                network, self.controls.tolist(), upper=upper, finite=True, bending=bending
            )
        constraints = Constraints(network, bending)
        self._grips = self.experiment.grip(constraints)
        self.model = FiniteNetwork(constraints)
        self._cloth = self.model.cloth
        self._options = options
        self._equilibrium = Equilibrium(self.model, options)
        self._places: list[np.ndarray] | None = None
        self._trial: list[np.ndarray] = []
        self.newton_steps = 0

    def destroy(self) -> None:
        """Free what PETSc holds. Collective."""
        self._equilibrium.destroy()

    def _drive(self, control: float):
        return self.experiment._motions(self._grips, control), 0.0

    def solve(self, law: Potential) -> np.ndarray:
        """Load at each displacement, N; (n,). Collective.

        Raises EquilibriumError on every rank if there is no equilibrium.
        """
        self.model.cloth = replace(self._cloth, shear=law.packed)
        try:
            if self._places is None:
                raise EquilibriumError("no states to start from", "", [])
            return self._restart(self._places)
        except EquilibriumError:
            return self._from_rest()

    def solve_doubled(self, law: Potential, what: str) -> np.ndarray | None:
        """Load at each displacement with twice something that was assumed, N; (n,). Collective.

        States, and the cloth, are as they were afterwards.

        Parameters
        ----------
        law : Potential
            Of the last `solve`.
        what : str
            One of ASSUMED.

        Returns
        -------
        float (n,) or None
            None if that cannot be, or has no equilibrium.
        """
        cloth, rigidity, trial = self._cloth, self.model.turns.rigidity, self._trial
        try:
            if what == "tension modulus":
                self._cloth = replace(
                    cloth, warp=_doubled(cloth.warp), weft=_doubled(cloth.weft), c12=2.0 * cloth.c12
                )
            elif what == "yarn bending":
                if not self.model.bending:
                    return None
                self.model.turns.rigidity = 2.0 * rigidity
            else:
                if cloth.compression > 0.5:
                    return None
                self._cloth = replace(cloth, compression=2.0 * cloth.compression)
            return self.solve(law)
        except EquilibriumError:
            return None
        finally:
            self._cloth, self.model.turns.rigidity, self._trial = cloth, rigidity, trial
            self.model.cloth = replace(cloth, shear=law.packed)

    def solve_shifted(self, law: Potential) -> np.ndarray | None:
        """Load at each displacement with crossovers where gaps between yarns are, N; (n,).

        Collective. Which yarns the clamps hold changes with that. None if there is no equilibrium.
        """
        network = self.network
        preform = network.preform
        shift = 0.5 * network.pitch @ preform.rotation
        x, y = map(float, preform.lattice_origin + shift)
        other = None
        try:
            other = LoadCurve(
                Network(network.comm, replace(preform, origin=(x, y)), network.fabric),
                self.displacement,
                kind=self.kind,
                upper=self.upper,
                bending=self.model.bending,
                options=self._options,
            )
            return other.solve(law)
        except CruciformError:  # on all ranks
            return None
        finally:
            if other is not None:
                self.newton_steps += other.newton_steps
                other.destroy()

    def accept(self) -> None:
        """Start from the states of the last `solve` from now on."""
        self._places = self._trial

    def _restart(self, places: list[np.ndarray]) -> np.ndarray:
        equilibrium, loads = self._equilibrium, []
        self._trial = []
        for control, x in zip(self.controls, places, strict=True):
            equilibrium.x = x.copy()
            self.model.prescribe(equilibrium.x, self._drive(control)[0])
            self.newton_steps += equilibrium.solve(control).iterations
            self._trial.append(equilibrium.x)
            loads.append(self._load(control))
        return np.array(loads)

    def _from_rest(self) -> np.ndarray:
        equilibrium, loads = self._equilibrium, []
        self._trial = []
        equilibrium.x = self.model.rest.copy()
        self.model.prescribe(equilibrium.x, self._drive(0.0)[0])

        def accepted(increment, x: np.ndarray) -> None:
            self.newton_steps += increment.iterations
            if increment.asked:
                self._trial.append(x.copy())
                loads.append(self._load(increment.control))

        step = self.experiment.default_step()
        follow(equilibrium, self._drive, list(map(float, self.controls)), step, accepted)
        return np.array(loads)

    def _load(self, control: float) -> float:
        network, experiment = self.network, self.experiment
        force = self._equilibrium.forces()[self.model.nodes.of_network_node]
        owned = slice(0, network.num_nodes_owned)
        velocity = experiment._velocity(self._grips, control)
        work = network.comm.allreduce(
            float(((force @ network.preform.rotation)[owned] * velocity[owned]).sum())
        )
        x = self._equilibrium.x
        work += experiment._work_of_turning(self.model, x, self._grips, control)
        return network.comm.bcast(experiment.load_of(work, control))

    def derivatives(self, law: Potential, changes: Sequence[np.ndarray]) -> np.ndarray:
        """Changes of the loads with changes of the law, at the states of the last `solve`.

        Collective.

        Parameters
        ----------
        law : Potential
            Of the last `solve`.
        changes : sequence of packed laws (Potential.packed)

        Returns
        -------
        float (n, number of changes), N per unit of the change
        """
        model, equilibrium, network = self.model, self._equilibrium, self.network
        model.cloth = replace(self._cloth, shear=law.packed)
        none = linear(0.0).packed
        cloths = [Cloth(none, none, change, 0.0) for change in changes]
        c = model.cruciforms

        def part(level: int, cloth: Cloth, x: np.ndarray):
            return kernels.cruciforms(
                x[c.nodes], c.arm_length, c.area, cloth, level,
                c.strain_source, c.turn_source, c.held,
            )  # fmt: skip

        result = np.zeros((len(self.controls), len(cloths)))
        for i, (control, x) in enumerate(zip(self.controls, self._trial, strict=True)):
            equilibrium.x = x
            model.prescribe(x.copy(), self._drive(control)[0])
            moved = self._moved(control)[c.nodes]
            for k, cloth in enumerate(cloths):
                result[i, k] = (part(FORCE, cloth, x)[1] * moved).sum()
            if self.kind == "picture-frame":  # its clamps turn the directions that they hold
                for sign in (1, -1):
                    model.prescribe(x.copy(), self._drive(control + sign * TURN)[0])
                    for k, cloth in enumerate(cloths):
                        result[i, k] += sign * part(ENERGY, cloth, x)[0].sum() / (2.0 * TURN)
            result[i] = [self.experiment.load_of(work, control) for work in result[i]]
        return network.comm.bcast(network.comm.allreduce(result))

    def _moved(self, control: float) -> np.ndarray:
        """Change of all places per change of the control, yarn frame, (n, 2). Collective."""
        model, rotation = self.model, self.network.preform.rotation
        if self.kind == "picture-frame":  # uniform
            ahead, behind = (
                self.experiment.motion("lower", control + s * TURN)[0] for s in (1, -1)
            )
            return model.rest @ (rotation @ (ahead - behind) @ rotation.T).T / (2.0 * TURN)
        pull = np.zeros_like(model.rest)
        velocity = self.experiment._velocity(self._grips, control)
        pull[model.nodes.of_network_node] = velocity @ rotation.T
        return self._equilibrium.tangent_step(model.nodes.halo.forward(pull))[0]

    def angles(self) -> np.ndarray:
        """Largest shear angle of a crossover in the states of the last `solve`, rad; (n,).

        Collective.
        """
        own = np.zeros(len(self.controls))
        for i, (control, x) in enumerate(zip(self.controls, self._trial, strict=True)):
            self.model.prescribe(x.copy(), self._drive(control)[0])
            fields = self.model.crossover_fields(x)
            own[i] = np.abs(fields["shear_angle"][fields["carrying"]]).max(initial=0.0)
        return np.max(self.network.comm.allgather(own), axis=0)


def _doubled(packed: np.ndarray) -> np.ndarray:
    """Twice a packed law; what is linear in the force follows the kind, numbers and knots."""
    packed, kind = packed.copy(), packed[0]
    first = 1 if kind == LINEAR else 3 + int(packed[1]) if kind == TABLE else 2
    packed[first:] *= 2.0
    return packed


def table_changes(angles: np.ndarray, values: np.ndarray) -> list[np.ndarray]:
    """Derivatives of a table law by its values, as packed laws, one for each value.

    Energy and force of a packed table are linear in its coefficients, so a law made of the
    coefficients' derivatives gives the derivatives of energy and force.
    """
    changes = []
    base = _table(angles, values).packed
    for k in range(len(values)):
        # A hair: PCHIP's slopes are smooth in the values where these rise.
        h = 1e-5 * min(np.diff(np.concatenate([[0.0], values]))[k : k + 2])
        up, down = (_table(angles, values + s * h * np.eye(len(values))[k]).packed for s in (1, -1))
        change = base.copy()
        energies = 2 + len(angles) + 1  # kind, number and knots stay
        change[energies:] = ((up - down) / (2.0 * h))[energies:]
        changes.append(change)
    return changes


@dataclass(frozen=True, eq=False)
class Specimen:
    """A network and what was measured of it, for calibrate_together.

    Attributes
    ----------
    network : Network
    curve : MeasuredCurve
    kind, upper, bending
        See calibrate.
    weight : float
        Of this curve's mean square relative error among those of the others.
    """

    network: Network
    curve: MeasuredCurve
    kind: str = "bias-extension"
    upper: str = "grip"
    bending: bool = True
    weight: float = 1.0


class _Together:
    """Load curves of several specimens, one after the other. Collective; see LoadCurve."""

    def __init__(self, specimens: Sequence[Specimen], options: dict | None):
        self.parts: list[LoadCurve] = []
        try:
            for s in specimens:
                self.parts.append(
                    LoadCurve(
                        s.network, s.curve.displacement, kind=s.kind, upper=s.upper,
                        bending=s.bending, options=options,
                    )
                )  # fmt: skip
        except CruciformError:
            self.destroy()
            raise
        self.network = specimens[0].network

    @property
    def newton_steps(self) -> int:
        """Of all together."""
        return sum(part.newton_steps for part in self.parts)

    def solve(self, law: Potential) -> np.ndarray:
        """Loads, N."""
        return np.concatenate([part.solve(law) for part in self.parts])

    def solve_other(self, law: Potential, what: str) -> np.ndarray | None:
        """Loads with another value of something assumed, N; None if one cannot have it."""
        loads = [
            part.solve_shifted(law) if what == PLACE else part.solve_doubled(law, what)
            for part in self.parts
        ]
        found = [load for load in loads if load is not None]
        return np.concatenate(found) if len(found) == len(loads) else None

    def accept(self) -> None:
        """Start from the states of the last `solve` from now on."""
        for part in self.parts:
            part.accept()

    def derivatives(self, law: Potential, changes: Sequence[np.ndarray]) -> np.ndarray:
        """Changes of all loads with changes of the law."""
        return np.concatenate([part.derivatives(law, changes) for part in self.parts])

    def angles(self) -> np.ndarray:
        """Largest shear angle at each point, rad."""
        return np.concatenate([part.angles() for part in self.parts])

    def destroy(self) -> None:
        """Free what PETSc holds."""
        for part in self.parts:
            part.destroy()


@dataclass(frozen=True, eq=False)
class Assumption:
    """What another value of something assumed would change.

    Attributes
    ----------
    loads : float (n,)
        Relative change of the loads with the law as it is.
    values : float (m,)
        Relative change of the law that would be identified, to first order.
    """

    loads: np.ndarray
    values: np.ndarray


@dataclass(frozen=True, eq=False)
class Calibration:
    """A shear law identified from a load curve.

    Attributes
    ----------
    fabric : Fabric
        The cloth with this law.
    law, start_law : Potential
        psi over the shear angle [N/m over rad]; the start is `start_from`.
    start_from : str
        "closed formula" or "straight line".
    curve : MeasuredCurve
    loads, start_loads : float (n,)
        Of the network with the law, and with the start [N].
    angles, values, standard_errors : float (m,)
        The table [rad, N/m], and the standard errors of its values [N/m].
    determined : bool (m,)
        Whether the data determine the value: cloth sheared beyond the knot before, and the relative
        standard error is at most LARGEST_ERROR.
    reached : float (n,)
        Largest shear angle of a crossover at each point [rad].
    noise : float
        Relative error of the loads that the standard errors go by.
    singular_values : float (m,)
        Of the relative derivatives d ln F_i/d ln psi'_k, the largest first.
    effective_parameters : float
        How many parameters the data settle; the others come from the smoothing.
    assumptions : dict of Assumption
        What twice the tension modulus, the yarn bending, the stiffness in compression would change,
        and another place of the yarns in the specimen, half a cell of the lattice away.
    smoothing : float
    iterations, evaluations, newton_steps : int
        Least squares steps, curves of loads computed, Newton steps in all.
    seconds : float
    message : str
        Why the iterations ended.
    """

    fabric: Fabric
    law: Potential
    start_law: Potential
    start_from: str
    curve: MeasuredCurve
    loads: np.ndarray
    start_loads: np.ndarray
    angles: np.ndarray
    values: np.ndarray
    standard_errors: np.ndarray
    determined: np.ndarray
    reached: np.ndarray
    noise: float
    singular_values: np.ndarray
    effective_parameters: float
    assumptions: dict[str, Assumption]
    smoothing: float
    iterations: int
    evaluations: int
    newton_steps: int
    seconds: float
    message: str
    specimens: tuple[Specimen, ...] = ()

    @property
    def parts(self) -> list[slice]:
        """Which points belong to which specimen's curve."""
        ends = np.cumsum([len(s.curve.force) for s in self.specimens] or [len(self.loads)])
        return [slice(int(low), int(high)) for low, high in pairwise([0, *ends])]

    @property
    def residuals(self) -> np.ndarray:
        """Relative error of each load, (n,)."""
        return self.loads / self.curve.force - 1.0

    @property
    def rms(self) -> float:
        """Root of the mean square of the relative errors."""
        return self.rms_between(0.0, np.inf)

    @property
    def start_rms(self) -> float:
        """The same for the start."""
        return _rms(self.start_loads / self.curve.force - 1.0)

    def rms_between(self, lowest: float, highest: float) -> float:
        """The same over the points with displacements in a range, m, ends included."""
        d = self.curve.displacement
        inside = (d >= lowest * (1 - 1e-9)) & (d <= highest * (1 + 1e-9))
        return _rms(self.residuals[inside])

    @property
    def dependent(self) -> np.ndarray:
        """Where the law depends on something assumed by more than LARGEST_ERROR, bool (m,)."""
        changes = [np.abs(assumption.values) for assumption in self.assumptions.values()]
        return np.max([np.zeros(len(self.angles)), *changes], axis=0) > LARGEST_ERROR

    def uncertain_ranges(self) -> list[tuple[float, float]]:
        """Ranges of angles, rad, that the data do not determine; the last one has no end."""
        ranges = self.ranges(~self.determined)
        last = min(float(self.reached.max()), float(self.angles[-1]))
        if not ranges or ranges[-1][1] < np.inf:
            ranges.append((last, np.inf))
        ranges[-1] = (min(ranges[-1][0], last), np.inf)
        return ranges

    def ranges(self, marked: np.ndarray) -> list[tuple[float, float]]:
        """Ranges of angles, rad, about marked knots, from the knot before to the knot after."""
        knots = np.concatenate([[0.0], self.angles, [np.inf]])
        ranges: list[tuple[float, float]] = []
        for k in np.flatnonzero(marked):
            low, high = float(knots[k]), float(knots[k + 2])
            if ranges and low <= ranges[-1][1]:
                ranges[-1] = (ranges[-1][0], high)
            else:
                ranges.append((low, high))
        return ranges

    def remarks(self) -> list[str]:
        """Say in sentences what the data do not tell."""
        degrees = np.rad2deg
        texts = [
            f"The specimen sheared by up to {degrees(self.reached.min()):.1f} deg at its first "
            f"point and {degrees(self.reached.max()):.1f} deg at its last: before, the law is a "
            "curve from zero; past that it is extrapolated along its last slope."
        ]
        for low, high in self.uncertain_ranges()[:-1]:
            texts.append(
                f"Between {degrees(low):.1f} and {degrees(high):.1f} deg the data do not determine "
                f"the law to {100 * LARGEST_ERROR:.0f} %: it follows from smoothness there."
            )
        low = self.uncertain_ranges()[-1][0]
        if low < self.reached.max() * (1 - 1e-9) and not self.determined[-1]:
            texts.append(
                f"From {degrees(low):.1f} deg on the data do not determine the law to "
                f"{100 * LARGEST_ERROR:.0f} %, though some of the cloth sheared more."
            )
        if self.rms > POOR_FIT:
            texts.append(
                f"The network does not follow the curve (RMS of the relative error "
                f"{100 * self.rms:.0f} %): check the specimen's size, the units and the yarns."
            )
        for name, assumption in self.assumptions.items():
            load, value = (
                100.0 * float(np.abs(part).max()) for part in (assumption.loads, assumption.values)
            )
            if value <= 5.0:
                continue
            other, with_ = f"Twice the {name}", f"the fabric's {name}"
            if name == PLACE:
                other, with_ = "Yarns half a cell away", "the place of the yarns in the specimen"
            texts.append(
                f"{other} would change loads by up to {load:.0f} % and the law by up to "
                f"{value:.0f} %: the law holds together with {with_}."
            )
        return texts


def calibrate(
    network: Network,
    displacement: Any,
    force: Any = None,
    *,
    kind: str = "bias-extension",
    upper: str = "grip",
    bending: bool = True,
    angles: Any = None,
    smoothing: float = SMOOTHING,
    bounds: tuple[Potential | None, Potential | None] = (None, None),
    options: dict | None = None,
    told: Callable[[str], None] | None = None,
) -> Calibration:
    """Identify the shear law of a network's fabric from a measured load curve. Collective.

    All else is taken from the fabric as it is: tension, compression, yarn bending.

    Parameters
    ----------
    network : Network
        Of the specimen, any outline and size.
    displacement, force : sequence of float
        Measured [m, N]; or a MeasuredCurve instead of the two.
    kind : "bias-extension" or "picture-frame"
        The test; in a picture frame the displacement is the growth of the longer diagonal, and the
        cloth fills the frame between its hinges.
    upper : "grip" or "centre-line"
        See BiasExtension; for "centre-line" the displacement is that of half a specimen.
    bending : bool
        Whether yarns resist bending.
    angles : sequence of float, optional
        Of the law's table [rad]; default: a ladder as far as the specimen shears.
    smoothing : float
        Weight of the law's second differences: a bend of the size of the law itself counts like
        this relative error of a load.
    bounds : (Potential or None, Potential or None)
        Laws that psi' of the table may not be below, or above.
    options : dict, optional
        PETSc options for the solver.
    told : callable, optional
        Told a line for each step.

    Raises
    ------
    InputError, SolverError
        On every rank: bad data; no equilibrium with the start, for instance because no network of
        this shape can be extended as far as the data go.
    """
    if isinstance(displacement, MeasuredCurve):
        curve = displacement
    elif force is None:
        raise InputError("calibrate needs the forces beside the displacements")
    else:
        curve = MeasuredCurve.from_points(displacement, force)
    return calibrate_together(
        [Specimen(network, curve, kind, upper, bending)],
        angles=angles, smoothing=smoothing, bounds=bounds, options=options, told=told,
    )  # fmt: skip


def calibrate_together(
    specimens: Sequence[Specimen],
    *,
    angles: Any = None,
    smoothing: float = SMOOTHING,
    bounds: tuple[Potential | None, Potential | None] = (None, None),
    options: dict | None = None,
    told: Callable[[str], None] | None = None,
) -> Calibration:
    """Identify one shear law from measured curves of several specimens. Collective.

    The mean over a curve's points is what its weight multiplies, so that a curve with many points
    counts like one with few. The fabric is that of the first specimen.

    Parameters
    ----------
    specimens : sequence of Specimen
    angles, smoothing, bounds, options, told
        See calibrate.

    Raises
    ------
    InputError, SolverError
        See calibrate.
    """
    begin = time.perf_counter()
    told = told or _LOG.info
    if not (np.isfinite(smoothing) and smoothing > 0.0):
        raise InputError(f"smoothing must be positive and finite, got {smoothing:g}")
    if not specimens:
        raise InputError("calibrate_together needs a specimen")
    for s in specimens:
        if not (np.isfinite(s.weight) and s.weight > 0.0):
            raise InputError(f"the weight of a curve must be positive and finite, got {s.weight:g}")
        _check_reach(s.network, float(np.max(s.curve.displacement)), s.kind, s.upper)
    curve = specimens[0].curve
    if len(specimens) > 1:
        curve = MeasuredCurve(
            np.concatenate([s.curve.displacement for s in specimens]),
            np.concatenate([s.curve.force for s in specimens]),
            sum(s.curve.rows for s in specimens),
        )
    together = _Together(specimens, options)
    try:
        # A frame gives the law point by point; from strips the first.
        best = next((i for i, s in enumerate(specimens) if s.kind == "picture-frame"), 0)
        start_from, first = _start(together.parts[best], specimens[best].curve)
        start_loads = together.solve(first)
        together.accept()
        told(f"start from the {start_from}, RMS {_percent(start_loads / curve.force - 1.0)}")
        knots = _knots(angles, float(together.angles().max()))
        weights = [np.full(len(s.curve.force), s.weight / len(s.curve.force)) for s in specimens]
        weight = np.concatenate(weights) / sum(s.weight for s in specimens)
        problem = _Problem(together, curve, weight, knots, first, smoothing, bounds)
        iterations, message = problem.minimise(told)
        found = _finished(problem, first, start_from, start_loads, iterations, message, begin)
        return replace(found, specimens=tuple(specimens))
    except EquilibriumError as error:
        raise InputError(
            "the network of the specimen has no equilibrium with the start for the law "
            f"({error}): check the specimen's size against the displacements, or leave out the last"
        ) from error
    finally:
        together.destroy()


class _Problem:
    """The sum of squares, in rises of the table over their size in the start, ``z``."""

    def __init__(
        self, specimen: _Together, curve: MeasuredCurve, weight: np.ndarray, knots: np.ndarray,
        first: Potential, smoothing: float,
        bounds: tuple[Potential | None, Potential | None] = (None, None),
    ):  # fmt: skip
        self.specimen, self.curve, self.knots, self.smoothing = specimen, curve, knots, smoothing
        values = np.maximum.accumulate(first.evaluate(knots)[1])
        even = values[-1] * np.diff(knots, prepend=0.0) / knots[-1]
        rises = np.maximum(np.diff(values, prepend=0.0), 2.0 * LEAST_SLOPE * even)
        scale = np.maximum(rises, 0.2 * even)
        self.z, self.least = rises / scale, LEAST_SLOPE * even / scale
        self.values_of = np.tril(np.ones((len(knots), len(knots)))) * scale
        self.bends = _second_differences(np.log(knots))
        self.data_weight = np.sqrt(weight)
        self.bend_weight = smoothing / np.sqrt(max(len(self.bends), 1))
        self.evaluations = 0
        # Bounds of the law: rows @ z >= limits.
        self.rows: np.ndarray = np.zeros((0, len(knots)))
        self.limits: np.ndarray = np.zeros(0)
        for law, sign in zip(bounds, (1.0, -1.0), strict=True):
            if law is not None:
                self.rows = np.concatenate([self.rows, sign * self.values_of])
                self.limits = np.concatenate([self.limits, sign * law.evaluate(knots)[1]])
        if len(self.limits):
            self.z = self.z + self.best_step(self.values_of, np.zeros(len(knots)))

    @property
    def values(self) -> np.ndarray:
        """The table at z, N/m."""
        return self.values_of @ self.z

    def residuals(self, z: np.ndarray) -> np.ndarray:
        """Weighted relative errors and second differences. Collective."""
        self.evaluations += 1
        values = self.values_of @ z
        loads = self.specimen.solve(_table(self.knots, values))
        bend = self.bends @ np.log(values)
        return np.concatenate([
            self.data_weight * (loads / self.curve.force - 1.0), self.bend_weight * bend
        ])  # fmt: skip

    def data_jacobian(self) -> np.ndarray:
        """Derivatives of F_i/f_i by the values at z, (n, m). Collective."""
        law = _table(self.knots, self.values)
        changes = table_changes(self.knots, self.values)
        return self.specimen.derivatives(law, changes) / self.curve.force[:, None]

    def bend_jacobian(self) -> np.ndarray:
        """Derivatives of s_k by the values at z, (m - 2, m)."""
        return self.bends / self.values

    def best_step(self, jacobian: np.ndarray, r: np.ndarray, damping: float = 0.0) -> np.ndarray:
        """Change of z that makes the linearised sum least, within the bounds. Collective.

        All ranks do the same small problem; rank 0's step counts.
        """
        from scipy.optimize import lsq_linear

        damped = np.concatenate([jacobian, np.sqrt(damping) * np.eye(len(self.z))])
        right = np.concatenate([-r, np.zeros(len(self.z))])
        if len(self.limits):
            rows = np.concatenate([self.rows, np.eye(len(self.z))])
            room = np.concatenate([self.limits, self.least]) - rows @ self.z
            return self.specimen.network.comm.bcast(_least_squares(damped, right, rows, room))
        # The bounds must lie on both sides of zero for SciPy.
        step = lsq_linear(damped, right, (self.least - self.z - 1e-12, np.inf)).x
        return self.specimen.network.comm.bcast(step)

    def jacobian(self) -> np.ndarray:
        """Derivatives of the residuals by z. Collective."""
        return np.concatenate([
            self.data_weight[:, None] * self.data_jacobian(),
            self.bend_weight * self.bend_jacobian()
        ]) @ self.values_of  # fmt: skip

    def minimise(self, told: Callable[[str], None]) -> tuple[int, str]:
        """Levenberg and Marquardt's method with bounds; z is moved to the minimum. Collective.

        Nocedal and Wright 2006, Numerical Optimization, section 10.3.
        """
        n = len(self.curve.force)
        r, damping = self.residuals(self.z), 1e-4
        self.specimen.accept()
        for iteration in range(1, MOST_ITERATIONS + 1):
            jacobian = self.jacobian()
            while True:
                step = self.best_step(jacobian, r, damping)
                foretold = r @ r - np.sum((r + jacobian @ step) ** 2)
                if foretold <= TOLERANCE * (r @ r) or r @ r <= EXACT:
                    return iteration - 1, "the sum of squares is at its least"
                try:
                    trial = self.residuals(self.z + step)
                    gain = r @ r - trial @ trial
                except EquilibriumError:
                    gain = -np.inf
                if gain > 0.1 * foretold:
                    break
                damping *= 10.0
                if damping > 1e6:
                    return iteration - 1, "no step makes the sum of squares smaller"
            self.specimen.accept()
            self.z, r = self.z + step, trial
            damping *= 0.01 if gain > 0.9 * foretold else 0.5
            told(f"step {iteration}, RMS {_percent(r[:n] / self.data_weight)}")
        return MOST_ITERATIONS, "the iterations were as many as are allowed"


def _finished(
    problem: _Problem, first: Potential, start_from: str, start_loads: np.ndarray,
    iterations: int, message: str, begin: float,
) -> Calibration:  # fmt: skip
    """Measure what was found. Collective."""
    specimen, curve, values = problem.specimen, problem.curve, problem.values
    law = _table(problem.knots, values)
    loads = specimen.solve(law)
    specimen.accept()
    # Covariance of regularised least squares, and the trace of the hat matrix as the number of
    # parameters that the data settle (Hastie, Tibshirani and Friedman 2009, eq. 3.50).
    # Relative in the values, too, so that singular values are plain numbers.
    # Points of a curve with twice the weight count as if they scattered by 1/sqrt(2).
    even = np.sqrt(len(loads)) * problem.data_weight
    data = even[:, None] * problem.data_jacobian() * values
    bends = problem.bend_jacobian() * values
    n, m = data.shape
    weight = problem.smoothing * np.sqrt(n / max(len(bends), 1))
    normal = data.T @ data + weight**2 * bends.T @ bends
    inverse = np.linalg.pinv(normal, hermitian=True)
    settled = float(np.trace(inverse @ data.T @ data))
    misfit = float(np.sum((even * (loads / curve.force - 1.0)) ** 2))
    noise = max(np.sqrt(misfit / max(n - settled, 1.0)), LEAST_NOISE)
    relative = noise * np.sqrt(np.maximum(np.diag(inverse), 0.0))
    reached = specimen.angles()
    visited = np.concatenate([[0.0], problem.knots[:-1]]) < reached.max()
    known = (relative <= LARGEST_ERROR) & visited
    assumptions = {}
    jacobian = problem.jacobian()
    r = np.concatenate([
        problem.data_weight * (loads / curve.force - 1.0),
        problem.bend_weight * problem.bends @ np.log(values),
    ])  # fmt: skip
    for what in (*ASSUMED, PLACE):
        other = specimen.solve_other(law, what)
        if other is not None:
            shifted = r.copy()
            shifted[:n] += problem.data_weight * (other - loads) / curve.force
            step = problem.best_step(jacobian, shifted)
            assumptions[what] = Assumption(other / loads - 1.0, problem.values_of @ step / values)
    singular = np.zeros(m)
    found = np.linalg.svd(data, compute_uv=False)
    singular[: len(found)] = found
    return Calibration(
        fabric=specimen.network.fabric.with_shear_law(law),
        law=law, start_law=first, start_from=start_from, curve=curve, loads=loads,
        start_loads=start_loads, angles=problem.knots, values=values,
        standard_errors=relative * values, determined=known, reached=reached, noise=float(noise),
        singular_values=singular, effective_parameters=settled, assumptions=assumptions,
        smoothing=problem.smoothing,
        iterations=iterations, evaluations=problem.evaluations,
        newton_steps=specimen.newton_steps, seconds=time.perf_counter() - begin, message=message,
    )  # fmt: skip


def _start(specimen: LoadCurve, curve: MeasuredCurve) -> tuple[str, Potential]:
    """Law to start from: of the closed formula, or else a straight line. Collective."""
    if specimen.kind == "picture-frame":
        sides = _frame(specimen.network)
        return "closed formula", _rising(*torque_from_frame(curve.displacement, curve.force, sides))
    size = _strip(specimen.network)
    if size is not None:
        width, length = size
        factor = 2.0 if specimen.upper == "centre-line" else 1.0
        length = factor * length
        if length >= 2.0 * width * (1.0 - 1e-6):
            angle, torque = torque_from_loads(
                factor * curve.displacement, curve.force, width, length
            )
            if len(angle) >= 2 and (torque > 0.0).any():
                # Past some 35 degrees the formula errs, mostly downwards; the law may not fall.
                return "closed formula", _rising(angle, torque)
    modulus = specimen.network.fabric.shear_modulus
    ratio = specimen.solve(linear(modulus)) / curve.force
    return "straight line", linear(modulus * float(ratio.sum() / (ratio**2).sum()))


def _rising(angle: np.ndarray, torque: np.ndarray) -> Potential:
    """Table through points of a formula, made to rise."""
    torque = np.maximum.accumulate(np.maximum(torque, 0.0))
    return _table(angle, torque + LEAST_SLOPE * torque[-1] * angle / angle[-1])


def _check_reach(network: Network, displacement: float, kind: str, upper: str) -> None:
    """Refuse a kind that is none, and data past what the specimen can do.

    Far past where the yarns of a strip lie along the pull, or where a frame is all but closed.
    """
    if kind not in KINDS:
        raise InputError(f"kind is '{kind}'; it can be '{KINDS[0]}' or '{KINDS[1]}'")
    if kind == "picture-frame":
        sides = _frame(network)
        if not frame_angle(displacement, sides) < LARGEST_FRAME_ANGLE:
            raise InputError(
                f"the data go to {format_si(displacement, 'm')}, but a frame of "
                f"{format_si(sides[0], 'm')} x {format_si(sides[1], 'm')} is closed at "
                f"{format_si(sum(sides) - float(np.hypot(*sides)), 'm')}: check the frame's size, "
                "the unit of the displacement and that it is that of the corner along the diagonal"
            )
        return
    size = _strip(network)
    if size is None:
        return
    factor = 2.0 if upper == "centre-line" else 1.0
    reach = net_reach(factor * size[1] - size[0]) / factor
    if 0.0 < 1.5 * reach < displacement:
        raise InputError(
            f"the data go to {format_si(displacement, 'm')}, but the yarns of a specimen of "
            f"{format_si(size[0], 'm')} x {format_si(size[1], 'm')} lie along the pull at "
            f"{format_si(reach, 'm')}: check the specimen's size and the unit of the displacement"
        )


def _strip(network: Network) -> tuple[float, float] | None:
    """Width and length of a rectangle cut at 45 degrees, or None for anything else."""
    size = network.preform.sides(OFF_RECTANGLE)
    if size is None or abs(np.cos(2.0 * network.preform.bias_angle)) > 0.05:
        return None
    return size


def _frame(network: Network) -> tuple[float, float]:
    """Sides of a picture frame, m."""
    size = network.preform.sides(OFF_RECTANGLE)
    if size is None:
        raise InputError("a picture frame's specimen must be a rectangle, from hinge to hinge")
    return size


def _knots(angles: Any, reached: float) -> np.ndarray:
    """Angles of the table, rad: those given, or the ladder up to what is reached."""
    if angles is None:
        degrees = np.rad2deg(reached)
        last = max(np.ceil(degrees - 1e-6), 1.0)
        inner = [rung for rung in LADDER if rung <= last - 2.0]
        knots = np.deg2rad([*inner, last]) if inner else np.deg2rad(last * np.array([0.25, 0.5, 1]))
        return np.minimum(knots, np.deg2rad(89.0))
    knots = np.array(angles, float)
    good = knots.ndim == 1 and len(knots) >= 2 and np.isfinite(knots).all()
    if not (good and knots[0] > 0.0 and (np.diff(knots) > 0.0).all() and knots[-1] < 0.5 * np.pi):
        raise InputError(
            "angles must be two or more, ascending from above zero to less than 90 degrees"
        )
    return knots


def _least_squares(
    matrix: np.ndarray, right: np.ndarray, rows: np.ndarray, limits: np.ndarray
) -> np.ndarray:
    """Find x with least |matrix x - right| and rows x >= limits; matrix has full column rank.

    Lawson & Hanson 1974, Solving Least Squares Problems, chapter 23: least distance by NNLS.
    """
    from scipy.linalg import solve_triangular
    from scipy.optimize import nnls

    q, r = np.linalg.qr(matrix)
    along = solve_triangular(r, rows.T, trans="T").T
    free = solve_triangular(r, q.T @ right)
    size = np.linalg.norm(along, axis=1)
    along, needed = along / size[:, None], (limits - rows @ free) / size
    unit = max(float(np.abs(needed).max()), 1e-300)
    system = np.vstack([along.T, needed / unit])
    target = np.append(np.zeros(along.shape[1]), 1.0)
    rest = system @ nnls(system, target)[0] - target
    if -rest[-1] < 1e-9:
        raise InputError("no rising law lies within the bounds: the lower must be below the upper")
    return free + solve_triangular(r, -unit * rest[:-1] / rest[-1])


def _second_differences(x: np.ndarray) -> np.ndarray:
    """Matrix (m - 2, m) from values at m places to (slope after - before)(mean of both steps)."""
    step = np.diff(x)
    result = np.zeros((len(x) - 2, len(x)))
    for k, (before, after) in enumerate(pairwise(step)):
        mean = 0.5 * (before + after)
        result[k, k : k + 3] = [mean / before, -mean / before - mean / after, mean / after]
    return result


def _table(angles: np.ndarray, values: np.ndarray) -> Potential:
    return table_law(list(map(float, angles)), list(map(float, values)))


def _rms(values: np.ndarray) -> float:
    return float(np.sqrt(np.mean(np.square(values)))) if len(values) else float("nan")


def _percent(values: np.ndarray) -> str:
    return f"{100.0 * _rms(values):.2f} %"
