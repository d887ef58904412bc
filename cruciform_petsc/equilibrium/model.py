# SPDX-License-Identifier: MIT
"""The sum of items on distributed nodes: energies, forces and stiffness of a state.

Positions and forces are in the lab frame. The unknowns of a node are its displacements along the
rows of its frame (warp, weft; along a guide, across it), which is what matrices are written in.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from copy import copy
from dataclasses import replace
from functools import lru_cache
from typing import Any

import numba
import numpy as np
from mpi4py import MPI
from petsc4py import PETSc

from ..elements.level import ENERGY, FORCE, STIFFNESS
from ..errors import InputError
from ..items.item import Item
from ..net.joined import JoinedNodes
from ..net.nodes import Nodes
from ..solvers.multigrid import Hierarchy
from ..solvers.pattern import BlockPattern
from ..solvers.splines import InSpace
from .state import Hold, State

PATTERN = "pattern"  # of a matrix: the one it was made with


class Model:
    """Items on nodes. Collective.

    Parameters
    ----------
    nodes : Nodes or JoinedNodes
        With ``rest`` (n_local, dim) and ``frame`` (n_local, dim, dim).
    items : sequence of Item
    active : bool (n_local,), optional
        Nodes that carry something; by default all.
    stiffness_scale : float
        Of the size of the largest diagonal entries, N/m: for idle entries, and for rounding.
    multigrid : callable or InSpace, optional
        In the plane: gives the hierarchy of a multigrid for a tangent. Or one in space.
    """

    def __init__(
        self,
        nodes: Nodes | JoinedNodes,
        items: Sequence[Item],
        active: np.ndarray | None = None,
        stiffness_scale: float = 1.0,
        multigrid: Callable[[PETSc.Mat], Hierarchy] | InSpace | None = None,
    ):
        self.nodes, self.items, self.comm = nodes, list(items), nodes.comm
        self.dim = nodes.rest.shape[1]
        if len({item.name for item in items}) < len(items):
            raise ValueError("each item needs a name of its own: loads and memory go by it")
        self.active = np.ones(nodes.num_nodes_local, bool) if active is None else active
        self.stiffness_scale, self.multigrid = stiffness_scale, multigrid
        low, high = nodes.rest.min(axis=0, initial=np.inf), nodes.rest.max(axis=0, initial=-np.inf)
        low = np.min(self.comm.allgather(low), axis=0)
        high = np.max(self.comm.allgather(high), axis=0)
        # What coordinates are rounded to goes with them, wherever the cloth lies.
        self.extent = float(np.max([high - low, abs(low), abs(high)]))
        unknowns = self.dim * nodes.num_nodes_global
        if unknowns > np.iinfo(PETSc.IntType).max:
            raise InputError(f"{unknowns} unknowns need a PETSc with 64-bit indices")
        self._lay([item.nodes for item in self.items])
        self._free: tuple[Any, Any, np.ndarray] = (None, None, np.zeros(0, bool))

    def _lay(self, parts: list[np.ndarray]) -> None:
        """Find the sparsity of elements with local nodes (m, k), by item. Collective."""
        nodes = self.nodes
        self._parts = parts
        self._pattern = pattern = BlockPattern(nodes, parts, self.dim)
        # Local nodes of each block that elements of this rank add to.
        size = len(pattern.empty_blocks())
        self._block_row = np.zeros(size, np.int32)
        self._block_column = np.zeros(size, np.int32)
        own = np.arange(nodes.num_nodes_owned)
        self._block_row[pattern.diagonal] = self._block_column[pattern.diagonal] = own
        for part, slots in zip(parts, pattern.slots, strict=True):
            self._block_row[slots] = part[:, :, None]
            self._block_column[slots] = part[:, None, :]

    def pattern(self, state: State) -> BlockPattern:
        """Sparsity of the tangent at a state: found anew where elements join others. Collective."""
        parts = [item.joined(state) for item in self.items]
        same = all(
            one is other or np.array_equal(one, other)
            for one, other in zip(parts, self._parts, strict=True)
        )
        if not self.comm.allreduce(same, MPI.LAND):
            self._lay(parts)
        return self._pattern

    def __repr__(self) -> str:
        names = ", ".join(item.name for item in self.items)
        return f"Model({self.nodes.num_nodes_global} nodes in {self.dim}-D; {names})"

    def with_items(self, items: Sequence[Item]) -> Model:
        """The same model with other items in the places of the old ones, on the same nodes."""
        model = copy(self)
        model.items = list(items)
        return model

    # -- energy, force, stiffness ---------------------------------------------------------------

    def energies(self, state: State) -> dict[str, float]:
        """Energies of all items by the names of their modes, J. Collective."""
        total = [
            sum(item.work(state, ENERGY, rows)[0].sum(axis=0) for rows in item.chunks())
            for item in self.items
        ]
        return self._by_mode(total)

    def _by_mode(self, totals: Sequence[Any]) -> dict[str, float]:
        """Energies (modes,) of this rank's part of each item -> those of all; items may share."""
        names = [mode for item in self.items for mode in item.modes]
        energies = dict.fromkeys(names, 0.0)
        for name, energy in zip(names, self.comm.allreduce(np.concatenate(totals)), strict=True):
            energies[name] += float(energy)
        return energies

    def force(self, state: State) -> tuple[np.ndarray, np.ndarray, dict[str, float]]:
        """Gradient of the energy, the loads' part of it, (n_local, dim), and the energies by name.

        Lab frame, N. Collective; complete on owned nodes, ghosts filled.
        """
        total = []
        force, loads = np.zeros_like(state.x), np.zeros_like(state.x)
        for item in self.items:
            total.append(np.zeros(len(item.modes)))
            for rows in item.chunks():
                energy, forces, _ = item.work(state, FORCE, rows)
                total[-1] += energy.sum(axis=0)
                _add_forces(loads if item.is_load else force, item.joined(state)[rows], forces)
        force, loads = self.nodes.halo.share(np.stack([force, loads], axis=1)).swapaxes(0, 1)
        return force + loads, loads, self._by_mode(total)

    def stiffness(
        self, state: State, reuse: PETSc.Mat | None = None, before: np.ndarray | None = None
    ) -> tuple[PETSc.Mat, np.ndarray]:
        """Tangent matrix on the free unknowns, and the whole tangent for `times`. Collective.

        Symmetric; unknowns that are not free have a diagonal entry only.

        Parameters
        ----------
        state : State
        reuse : PETSc.Mat, optional
            A matrix made here before, of which only the values change: for a state of the same
            pattern.
        before : float (n_local, dim), optional
            Positions before the step that led to the state, see Item.work.

        Returns
        -------
        PETSc.Mat
            The caller destroys it.
        blocks : float (m, dim, dim)
        """
        pattern, (add, to_axes) = self.pattern(state), _blocks(self.dim)
        blocks = pattern.empty_blocks()
        for item, slots in zip(self.items, pattern.slots, strict=True):
            for rows in item.chunks():
                add(blocks, slots[rows], item.work(state, STIFFNESS, rows, before)[2])
        free = self.free(state.hold)
        own = np.empty_like(blocks)
        to_axes(blocks, self._block_row, self._block_column, self.nodes.frame, free, own)
        idle = np.where(free[: self.nodes.num_nodes_owned], 0.0, self.stiffness_scale)
        for axis in range(self.dim):
            own[pattern.diagonal, axis, axis] += idle[:, axis]
        matrix = pattern.matrix(own, reuse)
        matrix.setAttr(PATTERN, pattern)
        matrix.setOption(PETSc.Mat.Option.SYMMETRIC, True)
        matrix.setOption(PETSc.Mat.Option.SYMMETRY_ETERNAL, True)
        return matrix, blocks

    def times(self, blocks: np.ndarray, values: np.ndarray) -> np.ndarray:
        """Whole tangent times changes of place (n_local, dim), lab frame. Collective.

        Complete on owned nodes, ghosts filled.
        """
        product = np.zeros_like(values)
        _multiply(blocks, self._block_row, self._block_column, values, product)
        return self.nodes.halo.share(product)

    def worst(self, gradient: np.ndarray) -> tuple[np.ndarray | None, int]:
        """Place at rest of the largest force (n_owned * dim,) out of balance. Collective.

        And at how many nodes there is a tenth of it, or more.
        """
        size = np.linalg.norm(gradient.reshape(-1, self.dim), axis=1)
        size = np.nan_to_num(size, nan=np.inf)
        at = int(size.argmax()) if len(size) else -1
        here = (float(size[at]), self.nodes.rest[at].tolist()) if len(size) else (-1.0, [])
        largest, place = max(self.comm.allgather(here))
        return np.array(place), self.comm.allreduce(int((size >= 0.1 * largest).sum()))

    def broken(self, state: State) -> tuple[np.ndarray, str, str] | None:
        """What an item says against a state, see Item.broken. Collective."""
        return next(filter(None, (item.broken(state) for item in self.items)), None)

    @property
    def lags(self) -> bool:
        """Whether an item takes something as given while equilibrium is sought."""
        return any(item.lags for item in self.items)

    def lagged(self, state: State) -> tuple[State, float, float]:
        """A state with what items take as given brought up to date, see Item.lagged. Collective.

        Also the sum over all ranks of the forces by which it was wrong, and of their sizes.
        """
        found = {item.name: item.lagged(state) for item in self.items}
        parts = np.array([[change, size] for _, change, size in found.values()]).reshape(-1, 2)
        change, size = self.comm.allreduce(parts.sum(axis=0))
        memory = {name: memory for name, (memory, _, _) in found.items()}
        return replace(state, memory=memory), float(change), float(size)

    def accepted(self, state: State) -> dict[str, Mapping[str, np.ndarray]]:
        """What all items remember of an accepted state, by item."""
        return {item.name: item.accepted(state) for item in self.items}

    def carried(self, before: State, guess: State) -> State:
        """A guess, or one that goes along with tools if its energy is lower. Collective.

        Cloth that lies on a tool goes with it; cloth between two yields to both.
        """
        found = [item.carried(before, guess) for item in self.items]
        if all(part is None for part in found):
            return guess
        x = guess.x.copy()
        for nodes, place in filter(None, found):
            x[nodes] = place
        along = replace(guess, x=self.nodes.halo.forward(x))
        along = along.at(guess.hold, guess.time, guess.factors)
        energy, other = (sum(self.energies(state).values()) for state in (guess, along))
        return along if other < energy else guess

    # -- unknowns -------------------------------------------------------------------------------

    def free(self, hold: Hold) -> np.ndarray:
        """Unknowns: neither prescribed nor of a node that carries nothing; bool (n_local, dim)."""
        nodes, fixed, _ = self._free
        if nodes is not hold.nodes or fixed is not hold.fixed:
            free = np.tile(self.active[:, None], self.dim)
            free[hold.nodes] &= ~hold.fixed
            self._free = (hold.nodes, hold.fixed, free)
        return self._free[2]

    def to_axes(self, vectors: np.ndarray) -> np.ndarray:
        """Lab frame -> the nodes' axes; float (n, dim) of the first n local nodes."""
        return np.einsum("nij,nj->ni", self.nodes.frame[: len(vectors)], vectors)

    def from_axes(self, values: np.ndarray) -> np.ndarray:
        """The nodes' axes -> lab frame; float (n, dim) of the first n local nodes."""
        return np.einsum("nji,nj->ni", self.nodes.frame[: len(values)], values)

    def local(self, vector: PETSc.Vec, hold: Hold) -> np.ndarray:
        """Vector on owned unknowns -> lab frame, (n_local, dim), else zero. Collective."""
        owned = self.nodes.num_nodes_owned
        values = vector.getArray(readonly=True).reshape(-1, self.dim)
        wide = np.zeros((self.nodes.num_nodes_local, self.dim))
        wide[:owned] = self.from_axes(np.where(self.free(hold)[:owned], values, 0.0))
        return self.nodes.halo.forward(wide)

    def rigid_motions(self) -> np.ndarray:
        """Translations and rotations of owned unknowns as columns, (n_owned dim, 3 or 6)."""
        owned = self.nodes.num_nodes_owned
        place = self.nodes.rest[:owned]
        motions = [np.broadcast_to(axis, place.shape) for axis in np.eye(self.dim)]
        for i, j in ((0, 1), (1, 2), (2, 0))[: 2 * self.dim - 3]:
            turn = np.zeros_like(place)
            turn[:, i], turn[:, j] = -place[:, j], place[:, i]
            motions.append(turn)
        return np.stack([self.to_axes(motion).ravel() for motion in motions], axis=1)


@numba.njit(cache=True, error_model="numpy")
def _add_forces(total, nodes, forces):
    """Add element forces (m, k, dim) to nodes (m, k), in place."""
    for n in range(nodes.shape[0]):
        for p in range(nodes.shape[1]):
            for i in range(forces.shape[2]):
                total[nodes[n, p], i] += forces[n, p, i]


@lru_cache(maxsize=2)
def _blocks(dim: int) -> tuple[Callable, Callable]:
    """Compile loops over blocks of ``dim`` x ``dim``, a length known to the compiler."""

    @numba.njit(cache=True, error_model="numpy")
    def add(blocks, slots, matrices):
        """Add element matrices (m, k, dim, k, dim) to node blocks, in place."""
        for n in range(slots.shape[0]):
            for p in range(slots.shape[1]):
                for q in range(slots.shape[2]):
                    at = slots[n, p, q]
                    for i in range(dim):
                        for j in range(dim):
                            blocks[at, i, j] += matrices[n, p, i, q, j]

    @numba.njit(cache=True, error_model="numpy")
    def to_axes(blocks, row, column, frame, free, result):
        """Blocks in the lab frame -> in the axes of their nodes; nothing of what is not free."""
        half = np.zeros((dim, dim))
        for b in range(len(row)):
            r, c = row[b], column[b]
            for i in range(dim):
                for j in range(dim):
                    value = 0.0
                    for k in range(dim):
                        value += blocks[b, i, k] * frame[c, j, k]
                    half[i, j] = value
            for i in range(dim):
                for j in range(dim):
                    value = 0.0
                    for k in range(dim):
                        value += frame[r, i, k] * half[k, j]
                    result[b, i, j] = value if free[r, i] and free[c, j] else 0.0

    return add, to_axes


@numba.njit(cache=True, error_model="numpy")
def _multiply(blocks, row, column, values, product):
    """Add node blocks (m, dim, dim) times node values to ``product``, in place."""
    for b in range(len(row)):
        for i in range(blocks.shape[1]):
            for j in range(blocks.shape[2]):
                product[row[b], i] += blocks[b, i, j] * values[column[b], j]
