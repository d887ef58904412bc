# SPDX-License-Identifier: MIT
"""Equilibrium at finite deformation: PETSc's SNES, kept going downhill, and increments of control.

Newton's step solves the exact tangent. Where that is indefinite (yarns that buckle, cloth that
wrinkles) or the step does not lead downhill, a multiple of the diagonal is added until it does.
The strain energy less the work of the loads decides how far to go along a step. What is called
converged is a force: the residual against the forces at the clamps.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from petsc4py import PETSc

from ..errors import SolverError
from ..solvers.options import (
    DIRECT_LIMIT,
    ITERATIVE,
    PREFIX,
    YARN_MULTIGRID,
    near_null_space,
    petsc_options,
    set_from_options,
)
from .finite import FiniteNetwork
from .tangent_multigrid import TangentMultigrid

# Residual over the forces that the clamps and loads exert (norms over all unknowns). The load is
# then right to the square of it, near enough: Newton's last step is quadratic.
RELATIVE_RESIDUAL = 1e-8
# Rounding of the residual in units of (stiffness x size of the preform): positions have 16 digits.
ROUNDING = 1e-16
MAX_ITERATIONS = 30
LARGEST_STRETCH = 2.0  # laws of tension do not end, yarns do
# Cholesky of an indefinite matrix: LDL^T, whose negative pivots tell.
DIRECT = {
    "ksp_type": "preonly",
    "pc_type": "cholesky",
    "pc_factor_mat_solver_type": "mumps",
    "mat_mumps_icntl_13": 1,  # no ScaLAPACK at the root: it would not count negative pivots
    "mat_mumps_icntl_14": 100,  # small systems on several ranks need more room than is foreseen
}
STEP = 1e-6  # relative residual of iterative solvers: Newton's last step is one
MEMORY = 2  # earlier steps whose energies may be reached again
FIRST_SHIFT, LAST_SHIFT = 1e-7, 1e2  # of the diagonal

Motions = list[tuple[np.ndarray, np.ndarray, np.ndarray]]
Drive = Callable[[float], tuple[Motions, float]]


@dataclass
class Increment:
    """One accepted state of equilibrium.

    Attributes
    ----------
    control : float
        Extension in m, angle in rad, strain or load factor.
    energies : float (3,)
        Tension, shear, bending, J.
    iterations : int
        Newton steps.
    residual, tolerance : float
        N.
    history : list of float
        Residual before each Newton step, and the last one.
    shifted : int
        Steps for which the tangent was indefinite, or did not lead downhill, and was mended.
    linear_iterations : int
    seconds : float
    load : float
        Of the test, N, once it has been measured.
    shear_max : float
        Largest shear angle of a crossover, radians, once it has been measured.
    asked : bool
        Whether the control is one that was asked for, rather than a step on the way.
    cuts : int
        How often the step failed and was halved before this one.
    """

    control: float
    energies: np.ndarray
    iterations: int
    residual: float
    tolerance: float
    history: list[float] = field(repr=False)
    shifted: int = 0
    linear_iterations: int = 0
    seconds: float = 0.0
    load: float = float("nan")
    shear_max: float = float("nan")
    asked: bool = False
    cuts: int = 0


class EquilibriumError(SolverError):
    """No equilibrium was found.

    Attributes
    ----------
    place : float (2,) or None
        Where the forces are farthest from balance, x and y in m.
    result : TestResult or None
        What an experiment had reached.
    """

    def __init__(self, message, reason, history, place=None):
        super().__init__(message, reason, history)
        self.place = place
        self.result: Any = None


class Equilibrium:
    """SNES on a FiniteNetwork. Collective; call destroy when done.

    Parameters
    ----------
    model : FiniteNetwork
    options : mapping, optional
        PETSc options under the prefix, which overrule the defaults; the command line overrules all.
    prefix : str
    """

    def __init__(
        self,
        model: FiniteNetwork,
        options: Mapping[str, object] | None = None,
        prefix: str = PREFIX,
    ):
        self.model = model
        comm = model.comm
        owned = 2 * model.nodes.num_nodes_owned
        self.x = model.rest.copy()
        self.load_factor = 0.0
        self._vector = PETSc.Vec().createMPI((owned, None), comm=comm)
        self._residual = self._vector.duplicate()
        self._matrix, self._blocks = model.stiffness(self.x)
        self._diagonal = self._vector.duplicate()
        bounds = np.reshape(model.network.preform.outline.bounds, (2, 2))
        self._extent = float(np.ptp(bounds, axis=0).max())
        # Of the last evaluation: unknowns, forces, energies, energy less the work of the loads.
        self._last: tuple[np.ndarray, np.ndarray, np.ndarray, float] | None = None
        self._before: np.ndarray | None = None  # positions of the last tangent
        self._merits: list[float] = []
        self._history: list[float] = []
        self._support = 0.0  # norm of the forces at clamps and of loads, N
        self.shifted = 0
        self._measure()
        options = dict(options or {})
        small = self._vector.getSize() <= DIRECT_LIMIT
        default = str(options.get("pc_type", "cholesky" if small else "mg"))
        kind = PETSc.Options(prefix).getString("pc_type", default)
        self.snes = PETSc.SNES().create(comm)
        self.snes.setOptionsPrefix(prefix)
        self.snes.setFunction(self._function, self._residual)
        self.snes.setJacobian(self._jacobian, self._matrix)
        self.snes.setLineSearchPreCheck(self._before_step)
        self.snes.setConvergenceTest(self._converged)
        self.snes.setMaxLinearSolveFailures(10**6)  # _before_step looks at each step
        self.snes.setTolerances(max_it=MAX_ITERATIONS)
        settings: dict[str, object] = {"snes_type": "newtonls", "snes_linesearch_type": "basic"}
        if kind in ("cholesky", "lu"):
            settings |= DIRECT
        else:
            settings |= (YARN_MULTIGRID if kind == "mg" else ITERATIVE) | {"ksp_rtol": STEP}
        self._prefix, self._settings = prefix, {**settings, **options}
        with self._options():
            set_from_options(self.snes, prefix, self._settings)
        self._multigrid: TangentMultigrid | None = None
        if kind == "mg":
            pc = self.snes.ksp.getPC()
            pc.setType(PETSc.PC.Type.PYTHON)
            self._multigrid = TangentMultigrid(model, prefix)
            pc.setPythonContext(self._multigrid)
        elif kind == "gamg":
            self._tell_rigid_motions()
        self.snes.ksp.setErrorIfNotConverged(False)

    def types(self) -> dict[str, str]:
        """PETSc's types of the solvers in use, by "snes", "ksp" and "pc"; the yarns' is an mg."""
        ksp = self.snes.ksp
        pc = "mg" if self._multigrid else ksp.getPC().getType()
        return {"snes": self.snes.getType(), "ksp": ksp.getType(), "pc": pc}

    def _options(self) -> AbstractContextManager[None]:
        """Put the options into PETSc's database: factors and levels ask when they are made."""
        return petsc_options(self._prefix, self._settings)

    def _tell_rigid_motions(self) -> None:
        """Give algebraic multigrid the motions that cost next to nothing."""
        model, owned = self.model, self.model.nodes.num_nodes_owned
        motions = np.zeros((3, model.nodes.num_nodes_local, 2))
        motions[0, :, 0] = motions[1, :, 1] = 1.0
        motions[2] = model.rest[:, ::-1] * (-1.0, 1.0)
        columns = [model.to_axes(motion)[:owned].ravel() for motion in motions]
        space = near_null_space(np.stack(columns, axis=1), model.comm)
        self._matrix.setNearNullSpace(space)
        space.destroy()

    def destroy(self) -> None:
        """Free what PETSc holds."""
        for thing in (self.snes, self._matrix, self._vector, self._residual, self._diagonal):
            thing.destroy()

    # -- what SNES calls --------------------------------------------------------------------------

    def _positions(self, vector: PETSc.Vec) -> np.ndarray:
        """Positions for a vector of changes from self.x."""
        return self.x + self.model.from_axes(self.model.local(vector))

    def _evaluate(self, vector: PETSc.Vec) -> tuple[np.ndarray, np.ndarray, float]:
        """Forces out of balance (n_local, 2), energies, and energy less the loads' work."""
        key, last = vector.getArray(readonly=True), self._last
        same = last is not None and np.array_equal(last[0], key)
        if not self.model.comm.allreduce(int(not same)) and last is not None:
            return last[1:]
        x = self._positions(vector)
        force, energies = self.model.force(x)
        merit = float(energies.sum())
        if self.load_factor:
            moved = self.model.to_axes(x - self.model.rest)[: self.model.nodes.num_nodes_owned]
            load = self.load_factor * self.model.load
            work = float((load[: len(moved)] * moved).sum())
            merit -= self.model.comm.allreduce(work)
            force = force - load
        self._last = (key.copy(), force, energies, merit)
        return force, energies, merit

    def _function(self, snes, vector, result) -> None:
        force, _, _ = self._evaluate(vector)
        owned = self.model.nodes.num_nodes_owned
        result.setArray(np.where(self.model.free[:owned], force[:owned], 0.0).ravel())

    def _jacobian(self, snes, vector, matrix, _preconditioner) -> None:
        x = self._positions(vector)
        _, self._blocks = self.model.stiffness(x, reuse=matrix, before=self._before)
        self._before = x
        self._measure()

    def _measure(self) -> None:
        """Note the size of the tangent, before anything is added to its diagonal."""
        self._matrix.getDiagonal(self._diagonal)
        self._size = self._diagonal.norm()

    def _tolerance(self) -> float:
        """What residual is called none, N."""
        return RELATIVE_RESIDUAL * self._support + ROUNDING * self._extent * self._size

    def _converged(self, snes, iteration, norms):
        assert self._last is not None  # SNES has evaluated the residual
        force = self._last[1]
        owned = self.model.nodes.num_nodes_owned
        bound = np.where(self.model.free[:owned], self.load_factor * self.model.load[:owned],
                         force[:owned])  # fmt: skip
        self._support = float(np.sqrt(self.model.comm.allreduce(float((bound**2).sum()))))
        residual = norms[2]
        self._history.append(float(residual))
        if not np.isfinite(residual):
            return PETSc.SNES.ConvergedReason.DIVERGED_FNORM_NAN
        if residual <= self._tolerance():
            return PETSc.SNES.ConvergedReason.CONVERGED_FNORM_ABS
        if iteration >= snes.max_it:
            return PETSc.SNES.ConvergedReason.DIVERGED_MAX_IT
        return PETSc.SNES.ConvergedReason.ITERATING

    def _before_step(self, vector, step) -> None:
        """Make SNES's step (which it subtracts) lead downhill and be of the right length."""
        force, _, merit = self._evaluate(vector)
        owned = self.model.nodes.num_nodes_owned
        gradient = self._vector.duplicate()
        gradient.setArray(np.where(self.model.free[:owned], force[:owned], 0.0).ravel())
        slope = gradient.dot(step)
        if not (slope > 0.0 and self._is_definite()):
            slope = self._mend(gradient, step)
        gradient.destroy()
        step.scale(self._length(vector, step, merit, slope))

    def _is_definite(self) -> bool:
        """Whether the tangent last solved with had no negative eigenvalue, as far as is known."""
        ksp = self.snes.ksp
        if ksp.getConvergedReason() < 0:
            return False
        pc = ksp.getPC()
        if pc.getType() != "cholesky" or pc.getFactorSolverType() != "mumps":
            return True
        return pc.getFactorMatrix().getMumpsInfog(12) == 0  # negative pivots

    def _mend(self, gradient: PETSc.Vec, step: PETSc.Vec) -> float:
        """Solve with a multiple of the diagonal added, as small as will do; returns the slope."""
        self.shifted += 1
        self._matrix.getDiagonal(self._diagonal)
        self._diagonal.abs()
        floor = 1e-3 * self._diagonal.max()[1]
        owned = self._diagonal.getArray()
        np.maximum(owned, floor, out=owned)
        ksp, shift, added = self.snes.ksp, FIRST_SHIFT, 0.0
        while shift <= LAST_SHIFT:
            self._add_to_diagonal(shift - added)
            added = shift
            ksp.setOperators(self._matrix)
            ksp.solve(gradient, step)
            slope = gradient.dot(step)
            if slope > 0.0 and self._is_definite():
                return slope
            shift *= 10.0
        # Steepest descent in the measure of the diagonal.
        step.pointwiseDivide(gradient, self._diagonal)
        return gradient.dot(step)

    def _add_to_diagonal(self, factor: float) -> None:
        scaled = self._diagonal.duplicate()
        self._diagonal.copy(scaled)
        scaled.scale(factor)
        self._matrix.setDiagonal(scaled, PETSc.InsertMode.ADD_VALUES)
        scaled.destroy()

    def _length(self, vector, step, merit: float, slope: float) -> float:
        """How much of the step to take: the energy falls, or forces along it do near the end."""
        trial = vector.duplicate()
        length = 1.0
        # The energy may rise to that of the last few steps (Grippo, Lampariello and Lucidi 1986):
        # tensions foretold run ahead of it while stiff yarns turn.
        self._merits = [*self._merits[-MEMORY:], merit]
        highest = max(self._merits)
        # Near equilibrium differences of energies are rounding; then the slope alone tells.
        noise = 1e-13 * (abs(merit) + self.model.typical_stiffness * self._extent**2 * 1e-8)
        for _ in range(25):
            trial.waxpy(-length, step, vector)
            force, _, there = self._evaluate(trial)
            owned = self.model.nodes.num_nodes_owned
            along = float(
                (np.where(self.model.free[:owned], force[:owned], 0.0).ravel()
                 * step.getArray(readonly=True)).sum()
            )  # fmt: skip
            along = self.model.comm.allreduce(along)  # minus the slope of the energy there
            if np.isfinite(there):
                if there <= highest - 1e-4 * length * slope:
                    break
                if there <= merit + noise and abs(along) <= 0.9 * slope:
                    break
                # Minimum of the cubic with the values and slopes at both ends (Nocedal and Wright
                # 2006, Numerical Optimization, eq. 3.59).
                d1 = -slope - along - 3.0 * (merit - there) / -length
                root = d1 * d1 - slope * along
                root = np.sqrt(root) if root > 0.0 else 0.0
                better = length - length * (-along + root - d1) / (-along + slope + 2.0 * root)
                if not np.isfinite(better):
                    better = 0.3 * length
                length = float(np.clip(better, 0.1 * length, 0.6 * length))
            else:
                length *= 0.2
        trial.destroy()
        return length

    # -- steps ------------------------------------------------------------------------------------

    def solve(self, control: float = 0.0) -> Increment:
        """Find equilibrium from self.x with what is prescribed in it. Collective.

        self.x is moved there. Raises EquilibriumError on every rank and leaves self.x otherwise.
        """
        begin = time.perf_counter()
        self._history = []
        self._last, self.shifted, self._support = None, 0, 0.0
        self._before, self._merits = None, []
        self._vector.set(0.0)
        try:
            with self._options():
                self.snes.solve(None, self._vector)
        except (PETSc.Error, SolverError) as error:
            raise self._failed(error) from error
        reason = self.snes.getConvergedReason()
        x = self._positions(self._vector)
        if reason <= 0:
            raise EquilibriumError(
                "no equilibrium found", _reason_name(reason), self._history, self._worst()
            )
        folded, torn = self.model.most_sheared(x), self.model.most_stretched(x, LARGEST_STRETCH)
        for place, reason, what in (
            (folded, "FOLDED", "the cloth folds onto itself: warp and weft pass each other"),
            (torn, "TORN", "a yarn is stretched to more than twice its length, which none stands"),
        ):
            if place is not None:
                raise EquilibriumError(what, reason, self._history, place)
        _, energies, _ = self._evaluate(self._vector)
        self.x = x
        return Increment(
            control,
            energies,
            self.snes.getIterationNumber(),
            self._history[-1],
            self._tolerance(),
            self._history,
            self.shifted,
            self.snes.getLinearSolveIterations(),
            time.perf_counter() - begin,
        )

    def forces(self) -> np.ndarray:
        """Forces on the nodes at self.x that hold them in place, (n_local, 2), yarn frame."""
        force, _ = self.model.force(self.x)
        return self.model.from_axes(force)

    def tangent_step(self, change: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Answer of the free unknowns to a change of prescribed ones, at self.x. Collective.

        Parameters
        ----------
        change : float (n_local, 2)
            In the yarn frame; its free part is not looked at.

        Returns
        -------
        moved : float (n_local, 2)
            The whole change in the yarn frame, ghosts filled.
        force : float (n_local, 2)
            Change of the nodes' forces, yarn frame.
        """
        model = self.model
        change = model.to_axes(change.copy())
        change[model.free] = 0.0
        self._last = None
        self._matrix, self._blocks = model.stiffness(self.x, reuse=self._matrix)
        right = self._vector.duplicate()
        owned = model.nodes.num_nodes_owned
        pushed = model.times(self._blocks, change)
        right.setArray(np.where(model.free, -pushed, 0.0)[:owned].ravel())
        self.snes.ksp.setOperators(self._matrix)
        answer = self._vector.duplicate()
        try:
            with self._options():
                self.snes.setUp()
                self.snes.ksp.solve(right, answer)
        except (PETSc.Error, SolverError) as error:
            raise self._failed(error) from error
        if self.snes.ksp.getConvergedReason() < 0 and not np.isfinite(answer.norm()):
            answer.set(0.0)  # a guess only
        moved = change + model.local(answer)
        force = model.times(self._blocks, moved)
        right.destroy()
        answer.destroy()
        return model.from_axes(moved), model.from_axes(force)

    def _failed(self, error: PETSc.Error | SolverError) -> EquilibriumError:
        """What is raised for an error within PETSc or within what it calls. Collective."""
        inner = self._multigrid and self._multigrid.error
        what = inner or error
        if isinstance(what, PETSc.Error):
            what = f"PETSc error {what.ierr}"
        return EquilibriumError(
            f"the linear solver failed: {what}", "SETUP", self._history, self._worst()
        )

    def _worst(self) -> np.ndarray | None:
        """Place at rest of the largest force out of balance, x and y. Collective."""
        if self._last is None:
            return None
        model = self.model
        owned = model.nodes.num_nodes_owned
        size = np.where(model.free[:owned], self._last[1][:owned], 0.0)
        size = np.nan_to_num(np.hypot(size[:, 0], size[:, 1]), nan=np.inf)
        at = int(size.argmax()) if owned else 0
        preform = model.network.preform
        place = model.rest[at] @ preform.rotation + preform.lattice_origin
        found = model.comm.allgather((float(size[at]) if owned else -1.0, place.tolist()))
        return np.array(max(found)[1])


def follow(
    equilibrium: Equilibrium,
    drive: Drive,
    targets: Sequence[float],
    step: float | None = None,
    accepted: Callable[[Increment, np.ndarray], None] | None = None,
    most_cuts: int = 10,
    path: Path | None = None,
) -> list[Increment]:
    """Follow equilibrium from rest through the controls asked for, in order. Collective.

    Each increment starts from the last ones carried on (a parabola through three states, a straight
    line through two, the tangent at rest); one that fails is cut in half from the last accepted
    state, and steps grow again when all goes well.

    Parameters
    ----------
    equilibrium : Equilibrium
    drive : callable
        Gives the edges' motions and the load factor for a control.
    targets : sequence of float
        From rest (control 0) on; may turn back.
    step : float, optional
        Largest step; by default from target to target.
    accepted : callable, optional
        Told each accepted increment and its positions.
    most_cuts : int
        How often a step is halved before giving up.
    path : Path, optional
        To go on along, maybe from where it was restored to; by default from rest.

    Returns
    -------
    list of Increment
        All that were accepted here.

    Raises
    ------
    EquilibriumError
        On every rank, with the control reached, the reason and the place.
    """
    path = path or Path(equilibrium, drive)
    done: list[Increment] = []
    while path.target < len(targets):
        target = targets[path.target]
        before = targets[path.target - 1] if path.target else 0.0
        most = abs(target - before) if step is None else step
        reached, cuts = False, 0
        while not reached:  # once at least: a value asked for twice is two states
            allowed = min(most, path.allowed or most)
            gap = target - path.control
            pieces = int(np.ceil(abs(gap) / allowed * (1 - 1e-9))) if gap else 1
            next_control = target if pieces <= 1 else path.control + gap / pieces
            try:
                increment = path.advance(next_control)
            except EquilibriumError:
                cuts += 1
                path.allowed = 0.5 * abs(next_control - path.control)
                if path.allowed <= most * 0.5**most_cuts:
                    raise
                continue
            path.allowed = min(most, 2.0 * allowed) if increment.iterations <= 8 else allowed
            reached = increment.asked = next_control == target
            increment.cuts, cuts = cuts, 0
            if reached:
                path.target, path.allowed = path.target + 1, None
            done.append(increment)
            if accepted is not None:
                accepted(increment, equilibrium.x)
    return done


class Path:
    """Accepted states along a control, and the guess for the next one.

    Attributes
    ----------
    states : list of (control, positions (n_local, 2))
        The last three at most.
    target : int
        Number of the value asked for that is being made for.
    allowed : float or None
        Largest step, if it is not the usual one.
    load : float
        The one reached, N, where loads are asked for.
    """

    def __init__(self, equilibrium: Equilibrium, drive: Drive):
        self.equilibrium, self.drive = equilibrium, drive
        self.states: list[tuple[float, np.ndarray]] = [(0.0, equilibrium.x.copy())]
        self.target = 0
        self.allowed: float | None = None
        self.load = 0.0

    def restore(
        self,
        states: list[tuple[float, np.ndarray]],
        target: int = 0,
        allowed: float | None = None,
        load: float = 0.0,
    ) -> None:
        """Put attributes, positions, clamps and dead loads as they were. Collective."""
        self.states, self.target, self.allowed, self.load = states, target, allowed, load
        motions, self.equilibrium.load_factor = self.drive(self.control)
        self.equilibrium.x = states[-1][1].copy()
        self.equilibrium.model.prescribe(self.equilibrium.x.copy(), motions)

    @property
    def control(self) -> float:
        """Of the last accepted state."""
        return self.states[-1][0]

    def advance(self, control: float, guess: np.ndarray | None = None) -> Increment:
        """Solve at a control; on failure everything is as it was. Collective.

        ``guess``: positions to start from, in place of those extrapolated.
        """
        equilibrium, model = self.equilibrium, self.equilibrium.model
        motions, factor = self.drive(control)
        before = (equilibrium.x, equilibrium.load_factor)
        try:
            if guess is None:
                guess = self._guess(control, motions)
            model.prescribe(guess, motions)
            equilibrium.x, equilibrium.load_factor = guess, factor
            increment = equilibrium.solve(control)
        except EquilibriumError:
            equilibrium.x, equilibrium.load_factor = before
            model.prescribe(equilibrium.x, self.drive(self.control)[0])
            raise
        # Where a path turns back, two states may have one control: the newer one counts.
        kept = [state for state in self.states if state[0] != control][-2:]
        self.states = [*kept, (control, equilibrium.x.copy())]
        return increment

    def _guess(self, control: float, motions: Motions) -> np.ndarray:
        equilibrium, model = self.equilibrium, self.equilibrium.model
        at = [state[0] for state in self.states]
        if len(self.states) == 1:
            target = equilibrium.x.copy()
            model.prescribe(target, motions)
            # The clamps' turn belongs to the new state; the tangent is that of the old one.
            change = target - equilibrium.x
            model.prescribe(equilibrium.x.copy(), self.drive(self.control)[0])
            moved, _ = equilibrium.tangent_step(change)
            return equilibrium.x + moved
        # Lagrange's polynomial through the last states.
        guess = np.zeros_like(equilibrium.x)
        for i, (c, x) in enumerate(self.states):
            weight = np.prod([(control - o) / (c - o) for j, o in enumerate(at) if j != i])
            guess += weight * x
        return guess


def _reason_name(reason: int) -> str:
    for name, value in vars(PETSc.SNES.ConvergedReason).items():
        if value == reason and name.isupper():
            return name
    return str(reason)
