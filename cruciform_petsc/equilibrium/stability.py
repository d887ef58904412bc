# SPDX-License-Identifier: MIT
r"""Where equilibrium stops being stable, the shapes cloth takes there, and the branch beyond.

A state is stable while its tangent K is positive definite. How far it is from that tells the lowest
eigenvalue m of

    K v = m M v,  M the area that nodes stand for,

a foundation's stiffness [N/m^3] that does not depend on the pitch: by how much pressure per
displacement the softest shape v is held. Between a stable state a and another state b further on,

    K_a v = s (K_a - K_b) v

has as its least positive s the share of the way at which K is singular, if K changes in proportion:
from rest by a small load that is the critical load of the linearised problem (the geometric
stiffness is K_b - K_a), between states close to the critical one it is Newton's method on
det K = 0. Boubaker, Haussy and Ganghoffer (2002) have nets of bars and springs buckle so.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
from petsc4py import PETSc

from ..errors import EquilibriumError
from ..parallel import most
from ..solvers.eigen import Factor, largest, lowest
from .lagged import settle
from .model import Model
from .newton import Equilibrium
from .state import Found, Hold, State

Drive = Callable[[float], tuple[Hold, Mapping[str, float]]]

KEPT = 4  # states whose modes are kept
MOST_SOLVED = 20  # states to find a critical one
NOISE = 1e-5  # of the stiffness at rest: what is taken for zero, and loads are known as well
SAME = 1e-3  # of the largest displacement: places whose displacements are alike
TOGETHER = 1e-5  # of the stiffness at rest, or of a share: eigenvalues that are one
LEAST = 1e-2  # of a reference: what it has to have in common with shapes to choose among them
BESIDE = 3  # modes that are looked at, too, as they may belong to the same eigenvalue


@dataclass(frozen=True)
class Modes:
    """Shapes and what holds them.

    Attributes
    ----------
    values : float (n,)
        Eigenvalues, N/m^3, rising; or shares of a way.
    shapes : float (n, n_local, dim)
        Lab frame, ghosts filled; the largest displacement is 1, its largest component positive.
    """

    values: np.ndarray
    shapes: np.ndarray


class Stability:
    """Looks at tangents of a model. Collective, as are its methods.

    Parameters
    ----------
    model : Model
    area : float (n_local,)
        What nodes stand for, m^2; of those that stand for nothing the mean is taken.
    count : int
        How many modes are looked at.
    step : float
        How far along its mode a critical state is left, m; negative: to the other side.
    branch : bool
        Whether to go on along the branch that leaves there, or along the unstable one.

    Attributes
    ----------
    noise : float
        Of stiffness, N/m^3: what is taken for zero.
    """

    def __init__(
        self,
        model: Model,
        area: np.ndarray,
        count: int = 1,
        step: float = 0.0,
        branch: bool = True,
    ):
        self.model, self.count, self.step, self.branch = model, count, step, branch
        owned = model.nodes.num_nodes_owned
        area = area[:owned]
        count, total = model.comm.allreduce(np.array([(area > 0.0).sum(), area.sum()]))
        mass = np.repeat(np.where(area > 0.0, area, total / max(count, 1)), model.dim)
        self._mass = PETSc.Vec().createWithArray(mass, comm=model.comm)
        self.noise = 0.0
        self._known: deque[tuple[np.ndarray, Modes]] = deque(maxlen=KEPT)

    def destroy(self) -> None:
        """Free what PETSc holds."""
        self._mass.destroy()

    # -- modes ------------------------------------------------------------------------------------

    def modes(self, state: State) -> Modes:
        """Softest shapes of a state, and their stiffness, N/m^3.

        Raises SolverError on every rank.
        """
        for x, modes in self._known:
            if x is state.x:
                return modes
        matrix, _ = self.model.stiffness(state)
        try:
            values, vectors = lowest(matrix, self._mass, self.count + BESIDE)
        finally:
            matrix.destroy()
        together = TOGETHER * max(self.noise / NOISE, abs(values[0]))
        modes = self._modes(values, vectors, together, state)
        self._known.append((state.x, modes))
        return modes

    def shares(self, low: State, high: State) -> Modes:
        """Shares of the way from a stable state to another one at which the tangent is singular.

        Rising; those that there are: none where nothing softens. They are exact where the tangent
        changes in proportion to the way.
        """
        before, _ = self.model.stiffness(low)
        change, _ = self.model.stiffness(high)
        change.aypx(-1.0, before, structure=PETSc.Mat.Structure.SAME_NONZERO_PATTERN)
        factor = Factor(before)
        try:
            if factor.negative:
                raise EquilibriumError("the cloth is not stable where it begins", "UNSTABLE", [])
            values, vectors = largest(change, before, factor, self.count + BESIDE)
        finally:
            factor.destroy()
            before.destroy()
            change.destroy()
        good = values > 1e-12
        shares = 1.0 / values[good]
        together = TOGETHER * shares.min(initial=1.0)
        return self._modes(shares, vectors[good], together, low)

    def _modes(self, values, vectors, together: float, state: State) -> Modes:
        """The first modes as displacements, the same ones on any number of ranks."""
        model = self.model
        vectors = self._chosen(values, vectors, together)[: self.count]
        shapes = np.zeros((len(vectors), *state.x.shape))
        like = self._mass.duplicate()
        for vector, shape in zip(vectors, shapes, strict=True):
            like.setArray(vector)
            shape[:] = model.local(like, state.hold)
            shape /= self._largest(shape)
        like.destroy()
        return Modes(values[: self.count], shapes)

    def _chosen(self, values: np.ndarray, vectors: np.ndarray, together: float) -> np.ndarray:
        """Vectors (n, n_owned dim), chosen in the order of `_references` where they have one value.

        A strip without torsional rigidity, say, bends and twists at the same load.
        """
        model, mass = self.model, self._mass.getArray(readonly=True)
        begins = [0, *(1 + np.flatnonzero(np.diff(values) > together)), len(values)]
        chosen = vectors.copy()
        for begin, end in pairwise(begins):
            if end - begin < 2:
                continue
            gram = model.comm.allreduce(vectors[begin:end] * mass @ vectors[begin:end].T)
            basis = np.linalg.solve(np.linalg.cholesky(gram), vectors[begin:end])
            taken: list[np.ndarray] = []  # of the basis, orthonormal
            for reference in self._references():
                parts = model.comm.allreduce(basis * mass @ reference)
                size = np.sqrt(model.comm.allreduce(float((mass * reference**2).sum())))
                for other in taken:
                    parts -= (other @ parts) * other
                length = np.linalg.norm(parts)
                if length > LEAST * size and len(taken) < end - begin:
                    taken.append(parts / length)
            chosen[begin : begin + len(taken)] = np.array(taken).reshape(-1, end - begin) @ basis
        return chosen

    def _references(self) -> Iterator[np.ndarray]:
        """Fields (n_owned dim,) that do not depend on ranks or pitch: translations, then waves."""
        model, owned = self.model, self.model.nodes.num_nodes_owned
        place, axes = model.nodes.rest[:owned] / model.extent, np.eye(model.dim)[::-1]
        for axis in axes:
            yield model.to_axes(np.broadcast_to(axis, place.shape)).ravel()
        for number in range(12):
            wave = np.cos(place @ (1.0 + np.sin(number + np.arange(model.dim))) * (number + 1.0))
            yield model.to_axes(wave[:, None] * (axes[0] + 0.3 * axes[1])).ravel()

    def _largest(self, shape: np.ndarray) -> float:
        """Largest displacement, with the sign of its largest component.

        Of displacements as large as that the one at the lowest place at rest counts.
        """
        comm, owned = self.model.comm, self.model.nodes.num_nodes_owned
        size = np.linalg.norm(shape[:owned], axis=1)
        top = most(comm, size, 0.0)
        at = np.flatnonzero(size >= (1.0 - SAME) * top)
        place = np.round(self.model.nodes.rest[at, :2] / self.model.extent, 9)
        first = np.lexsort(place.T)[:1]
        own = np.concatenate([place[first, ::-1], shape[at[first]]], axis=1).tolist()
        there = min(row for rows in comm.allgather(own) for row in rows)[2:]
        return top * float(np.sign(max(there, key=abs)))

    # -- the critical state -----------------------------------------------------------------------

    def at_rest(self, state: State) -> None:
        """Take note of the state that a path begins at: what is small is so beside its stiffness.

        Raises EquilibriumError on every rank where it is not stable.
        """
        lowest_one = float(self.modes(state).values[0])
        if lowest_one <= 0.0:
            raise EquilibriumError("the cloth is not stable at rest", "UNSTABLE", [])
        self.noise = NOISE * lowest_one

    def watch(
        self, equilibrium: Equilibrium, drive: Drive, low: State, found: Found
    ) -> list[Found]:
        """What a step has led to: what was found, or with it the critical state that it has passed.

        Parameters
        ----------
        equilibrium : Equilibrium
        drive : callable
            Control -> hold and factors, see Stage.
        low : State
            The accepted one before.
        found : Found

        Returns
        -------
        list of Found
            The critical state first, if there is one between. The last one has the control of
            ``found``, and with ``branch`` it is on the branch.
        """
        softest, before = (float(self.modes(s).values[0]) for s in (found.state, low))
        if softest >= -self.noise or before < -self.noise:
            return [found]
        passed = []
        if before > self.noise:  # else a run was interrupted just there
            passed = [self._between(equilibrium, drive, low, found.state)]
            low = passed[0].state
        if self.branch:
            shape = self.modes(low).shapes[0]
            found = settle(equilibrium, found.state.moved(self.step * shape))
        return [*passed, found]

    def _between(self, equilibrium: Equilibrium, drive: Drive, low: State, high: State) -> Found:
        """The critical state between a stable one and an unstable one."""
        for _ in range(MOST_SOLVED):
            shares = self.shares(low, high).values
            # Where the path bends, or rounding rules, halve.
            share = shares[0] if len(shares) and shares[0] < 1.0 else 0.5
            control = low.time + share * (high.time - low.time)
            hold, factors = drive(control)
            guess = replace(low, x=low.x + share * (high.x - low.x)).at(hold, control, factors)
            found = settle(equilibrium, guess)
            softest = float(self.modes(found.state).values[0])
            if abs(softest) <= self.noise:
                return found
            low, high = (found.state, high) if softest > 0.0 else (low, found.state)
        raise EquilibriumError(
            f"the critical state is not found in {MOST_SOLVED} solutions", "MAX_IT", []
        )

    def linear(
        self, equilibrium: Equilibrium, drive: Drive, start: State, control: float
    ) -> tuple[Found, Modes]:
        """Critical states of the linearised problem, from rest and a small load.

        Returns
        -------
        found : Found
            At the small control.
        modes : Modes
            The values times the control are critical.
        """
        hold, factors = drive(control)
        found = settle(equilibrium, start.at(hold, control, factors))
        return found, self.shares(start, found.state)
