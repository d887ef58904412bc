# SPDX-License-Identifier: MIT
"""Equilibrium of a model: PETSc's SNES, kept going downhill.

Newton's step solves the exact tangent. Where that is indefinite (yarns that buckle, cloth that
wrinkles) or the step does not lead downhill, a multiple of the diagonal is added until it does.
The energy of all items decides how far to go along a step. What is called converged is a force: the
residual against the forces of what holds and loads.
"""

from __future__ import annotations

import time
from collections.abc import Mapping
from contextlib import AbstractContextManager
from dataclasses import dataclass

import numpy as np
from petsc4py import PETSc

from ..errors import EquilibriumError, InputError, LibraryError, SolverError
from ..solvers.callbacks import callback, calling_back
from ..solvers.options import PREFIX, petsc_options, reason_name, set_from_options
from .mending import Mending, is_definite
from .model import Model
from .reuse import FINER, NEAR, go_on, is_reusable
from .search import step_length
from .state import Found, State
from .tangents import check_solved, fitting, prepare, tangent_settings

# Residual over the forces that clamps and loads exert (norms over all unknowns). The load is then
# right to the square of it, near enough: Newton's last step is quadratic.
RELATIVE_RESIDUAL = 1e-8
# Rounding of the residual in units of (stiffness x size of the body): positions have 16 digits.
ROUNDING = 1e-16
MAX_ITERATIONS = 30
MEMORY = 2  # earlier steps whose energies may be reached again


@dataclass
class _Evaluated:
    """A state and what is known of it; arrays of this rank's unknowns, 0 where not free."""

    key: np.ndarray  # the unknowns
    state: State
    force: np.ndarray  # (n_local, dim), lab frame
    energies: dict[str, float]
    energy: float  # all of them: what goes down
    gradient: np.ndarray
    support: float  # norm of the forces of what holds and loads, N


class Equilibrium:
    """SNES on a Model. Collective; call destroy when done.

    Parameters
    ----------
    model : Model
    start : State
        Any; the pattern of the matrix is that of all states.
    options : mapping, optional
        PETSc options under the prefix, which overrule the defaults; the command line overrules all.
    prefix : str
    relative_residual : float, optional
        What is called none, over the forces that hold and load.
    longest_step : float
        No unknown changes by more in a Newton step, m.
    foretell : bool
        Tangents foresee tensions that turning yarns get (see Item.work), and the energy may rise
        for a few steps. Else, as where contact and friction switch, the energy has to fall, and
        factors are used again near equilibrium.
    """

    def __init__(
        self,
        model: Model,
        start: State,
        options: Mapping[str, object] | None = None,
        prefix: str = PREFIX,
        relative_residual: float | None = None,
        longest_step: float = np.inf,
        foretell: bool = True,
    ):
        self.model, self._start, self._prefix = model, start, prefix
        self.relative_residual = relative_residual or RELATIVE_RESIDUAL
        self.longest_step = longest_step
        self.foretell = foretell
        owned = model.dim * model.nodes.num_nodes_owned
        self._vector = PETSc.Vec().createMPI((owned, None), comm=model.comm)
        self._residual, self._diagonal = self._vector.duplicate(), self._vector.duplicate()
        self._matrix, _ = model.stiffness(start)
        self._last: _Evaluated | None = None
        self._before: np.ndarray | None = None  # positions of the last tangent
        self._recent: list[float] = []  # energies
        self._history: list[float] = []
        self._mending, self._shifted, self._evaluations = Mending(), 0, 0
        self._loose, self._few, self._reusable = 1.0, np.inf, False
        self._measure()
        self._settings, self._multigrid = tangent_settings(model, self._vector, options, prefix)
        self.snes = PETSc.SNES().create(model.comm)
        self.snes.setOptionsPrefix(prefix)
        self.snes.setFunction(self._function, self._residual)
        self.snes.setJacobian(self._jacobian, self._matrix)
        self.snes.setLineSearchPreCheck(self._before_step)
        self.snes.setMaxLinearSolveFailures(10**6)  # _before_step looks at each step
        self.snes.setTolerances(max_it=MAX_ITERATIONS)
        with self._options():
            set_from_options(self.snes, prefix, self._settings)
        self.snes.setConvergenceTest(self._converged)
        kind = self.snes.getType()
        if kind != PETSc.SNES.Type.NEWTONLS:
            raise InputError(
                f"-{prefix}snes_type is '{kind}', which cannot find equilibrium: 'newtonls' can"
            )
        prepare(self.snes.ksp, self._matrix, model, self._multigrid)

    def types(self) -> dict[str, str]:
        """PETSc's types of the solvers in use, by "snes", "ksp" and "pc"; the yarns' is an mg."""
        ksp = self.snes.ksp
        pc = "mg" if self._multigrid else ksp.getPC().getType()
        return {"snes": self.snes.getType(), "ksp": ksp.getType(), "pc": pc}

    def _options(self) -> AbstractContextManager[None]:
        """Put the options into PETSc's database: factors and levels ask when they are made."""
        return petsc_options(self._prefix, self._settings)

    def destroy(self) -> None:
        """Free what PETSc holds."""
        for thing in (self.snes, self._matrix, self._vector, self._residual, self._diagonal):
            thing.destroy()

    # -- what SNES calls --------------------------------------------------------------------------

    def _evaluate(self, vector: PETSc.Vec) -> _Evaluated:
        model, key, last = self.model, vector.getArray(readonly=True), self._last
        same = last is not None and np.array_equal(last.key, key)
        if not model.comm.allreduce(int(not same)) and last is not None:
            return last
        hold = self._start.hold
        state = self._start.moved(model.local(vector, hold))
        force, loads, energies = model.force(state)
        self._evaluations += 1
        owned = model.nodes.num_nodes_owned
        free, balance = model.free(hold)[:owned], model.to_axes(force[:owned])
        bound = np.where(free, model.to_axes(loads[:owned]), balance)
        support = float(np.sqrt(model.comm.allreduce(float((bound**2).sum()))))
        gradient = np.where(free, balance, 0.0).ravel()
        energy = sum(energies.values())
        self._last = _Evaluated(key.copy(), state, force, energies, energy, gradient, support)
        return self._last

    @callback
    def _function(self, snes, vector, result) -> None:
        result.setArray(self._evaluate(vector).gradient)

    @callback
    def _jacobian(self, snes, vector, matrix, _preconditioner) -> None:
        state = self._evaluate(vector).state
        before = self._before if self.foretell else None
        self.model.stiffness(state, reuse=matrix, before=before)
        self._before = state.x
        self._measure()

    def _measure(self) -> None:
        """Note the size of the tangent, before anything is added to its diagonal."""
        self._matrix.getDiagonal(self._diagonal)
        self._size = self._diagonal.norm()

    def _tolerance(self) -> float:
        """What residual is called none, N."""
        support = self._last.support if self._last else 0.0
        return self.relative_residual * support + ROUNDING * self.model.extent * self._size

    @callback
    def _converged(self, snes, iteration, norms):
        residual = norms[2]
        self._history.append(float(residual))
        if not np.isfinite(residual):
            return PETSc.SNES.ConvergedReason.DIVERGED_FNORM_NAN
        if residual <= self._loose * self._tolerance() or iteration >= self._few:
            return PETSc.SNES.ConvergedReason.CONVERGED_FNORM_ABS
        if iteration >= snes.max_it:
            return PETSc.SNES.ConvergedReason.DIVERGED_MAX_IT
        return PETSc.SNES.ConvergedReason.ITERATING

    @callback
    def _before_step(self, vector, step) -> None:
        """Make SNES's step (which it subtracts) lead downhill and be of the right length."""
        here = self._evaluate(vector)
        check_solved(self.snes.ksp, self._multigrid)
        gradient = PETSc.Vec().createWithArray(here.gradient, comm=self.model.comm)
        slope = gradient.dot(step)
        if not (slope > 0.0 and is_definite(self.snes.ksp)):
            self._shifted += 1
            slope = self._mending.mend(self.snes.ksp, self._matrix, gradient, step)
        gradient.destroy()
        self._reusable = not self.foretell and is_reusable(self.snes.ksp)
        step.scale(self._length(vector, step, here.energy, slope))
        there = vector.duplicate()
        there.waxpy(-1.0, step, vector)
        self._go_on(there)
        step.waxpy(-1.0, there, vector)
        there.destroy()

    def _go_on(self, vector: PETSc.Vec) -> None:
        """Improve a vector with the factor at hand, if there is one for that."""
        if not self._reusable:
            return

        seen: list[_Evaluated] = []

        def at(trial: PETSc.Vec) -> tuple[float, np.ndarray]:
            seen.append(self._evaluate(trial))
            return seen[-1].energy, seen[-1].gradient

        noise, tolerance = self._noise(at(vector)[0]), self._tolerance()
        seen.clear()
        end, longest = FINER * self._loose * tolerance, self.longest_step
        taken = go_on(self.snes.ksp, at, vector, end, NEAR * tolerance, longest, noise)
        self._last = seen[taken]

    def _length(self, vector, step, energy: float, slope: float) -> float:
        """How much of the step to take."""
        model, trial = self.model, vector.duplicate()
        down = step.getArray(readonly=True)

        def at(length: float) -> tuple[float, float]:
            trial.waxpy(-length, step, vector)
            there = self._evaluate(trial)
            return there.energy, model.comm.allreduce(float(there.gradient @ down))

        first = min(1.0, self.longest_step / max(step.norm(PETSc.NormType.INFINITY), 1e-300))
        self._recent = [*self._recent[-MEMORY:], energy]
        noise = self._noise(energy)  # there the slope alone tells
        highest = max(self._recent) if self.foretell else None
        length = step_length(at, energy, slope, first, noise, highest)
        trial.destroy()
        return length

    def _noise(self, energy: float) -> float:
        """Near equilibrium differences of energies are rounding."""
        model = self.model
        return 1e-13 * (abs(energy) + model.stiffness_scale * model.extent**2 * 1e-8)

    # -- steps ------------------------------------------------------------------------------------

    def solve(self, guess: State, loose: float = 1.0, few: float = np.inf) -> Found:
        """Find equilibrium near a state, under its hold and loads. Collective.

        ``loose``: the residual may be so many times the tolerance. After ``few`` steps any will do.

        Raises EquilibriumError on every rank.
        """
        begin, model = time.perf_counter(), self.model
        self._start, self._last, self._before = guess, None, None
        self._loose, self._few = loose, few
        self._history, self._recent, self._shifted = [], [], 0
        self._evaluations, self._mending.tries = 0, 0
        self._vector.set(0.0)
        try:
            with self._options(), calling_back(self.snes):
                before, self._matrix = self._matrix, fitting(self.snes, self._matrix, model, guess)
                self._reusable = self._reusable and before is self._matrix
                self._go_on(self._vector)
                self.snes.solve(None, self._vector)
        except SolverError as error:
            raise self._failed(error) from error
        reason = self.snes.getConvergedReason()
        if reason <= 0:
            name = reason_name(reason, PETSc.SNES)
            raise EquilibriumError("no equilibrium found", name, self._history, *self._worst())
        end = self._evaluate(self._vector)
        broken = model.broken(end.state)
        if broken is not None:
            place, name, what = broken
            raise EquilibriumError(what, name, self._history, place)
        return Found(
            end.state,
            end.energies,
            end.force,
            self.snes.getIterationNumber(),
            self._history[-1],
            self._tolerance(),
            self._history,
            self._shifted,
            self.snes.getLinearSolveIterations(),
            time.perf_counter() - begin,
            factorisations=self.snes.getIterationNumber() + self._mending.tries,
            evaluations=self._evaluations,
        )

    def tangent_step(
        self, state: State, change: np.ndarray, out_of_balance: bool = False
    ) -> tuple[np.ndarray, np.ndarray]:
        """Answer of the free unknowns to a change of prescribed ones, at a state. Collective.

        Parameters
        ----------
        state : State
        change : float (n_local, dim)
            Lab frame, m; its free part is not looked at.
        out_of_balance : bool
            Whether they also answer to what is out of balance there, as where loads have changed.

        Returns
        -------
        moved : float (n_local, dim)
            The whole change, ghosts filled.
        force : float (n_local, dim)
            Change of the nodes' forces.
        """
        model, owned = self.model, self.model.nodes.num_nodes_owned
        free, self._last = model.free(state.hold), None
        change = model.from_axes(np.where(free, 0.0, model.to_axes(change)))
        right, answer = self._vector.duplicate(), self._vector.duplicate()
        try:
            with self._options(), calling_back(self.snes):
                self._matrix = fitting(self.snes, self._matrix, self.model, state)
                _, blocks = model.stiffness(state, reuse=self._matrix)
                pushed = model.times(blocks, change)
                if out_of_balance:
                    pushed += model.force(state)[0]
                pushed = model.to_axes(pushed[:owned])
                right.setArray(np.where(free[:owned], -pushed, 0.0).ravel())
                self.snes.ksp.setOperators(self._matrix)
                self.snes.setUp()
                self.snes.ksp.solve(right, answer)
                self._reusable = not self.foretell and is_reusable(self.snes.ksp)
        except SolverError as error:
            raise self._failed(error) from error
        if self.snes.ksp.getConvergedReason() < 0 and not np.isfinite(answer.norm()):
            answer.set(0.0)  # a guess only
        moved = change + model.local(answer, state.hold)
        right.destroy()
        answer.destroy()
        return moved, model.times(blocks, moved)

    def _failed(self, error: SolverError) -> SolverError:
        """What is raised for an error within PETSc or within what it calls. Collective."""
        if isinstance(error, LibraryError):
            return error
        what = f"the linear solver failed: {error}"
        return EquilibriumError(what, "SETUP", self._history, *self._worst())

    def _worst(self) -> tuple[np.ndarray | None, int]:
        """See Model.worst. Collective."""
        return self.model.worst(self._last.gradient) if self._last else (None, 0)
