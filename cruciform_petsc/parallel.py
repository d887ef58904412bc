# SPDX-License-Identifier: MIT
"""All messages between ranks: values on shared nodes, records by rank, what one rank does for all.

Only here are arrays sent; elsewhere ranks at most agree on a few numbers (allreduce, allgather).
"""

from __future__ import annotations

import math
import sys
import time
from collections.abc import Callable
from typing import TypeVar

import numpy as np
from mpi4py import MPI

from .errors import CruciformError

T = TypeVar("T")
_PATIENCE = 5.0  # s, with ranks that fail apart
_TAG = 20117  # of the messages of all halos: every rank posts them in the same order


# -- what one rank finds out, all know ---------------------------------------------------------


def on_all(comm: MPI.Intracomm, function: Callable[[], T]) -> T:
    """Call a function on every rank; returns this rank's result. Collective.

    If it fails on any rank, the error of the lowest such rank is raised on all.
    """
    result: T | None = None
    problem: Exception | None = None
    try:
        result = function()
    except Exception as error:
        problem = error
    message = problem
    if problem is not None and not isinstance(problem, CruciformError):
        # Not every exception survives pickling; its text does.
        message = RuntimeError(f"on rank {comm.rank}: {type(problem).__name__}: {problem}")
    for rank, error_there in enumerate(comm.allgather(message)):
        if error_there is not None:
            raise problem if problem is not None and rank == comm.rank else error_there
    return result  # type: ignore[return-value]


def on_root(comm: MPI.Intracomm, function: Callable[[], T]) -> T:
    """Call a function on rank 0 and return its result, or raise its error, on every rank.

    Collective. The result must be picklable.
    """
    return comm.bcast(on_all(comm, lambda: function() if comm.rank == 0 else None))


def end_unless_all(comm: MPI.Intracomm, sentence: str) -> None:
    """Go on if all ranks come here within a few seconds; else print the sentence and end them all.

    For an error that may be this rank's alone, while others wait for it in some other call; a rank
    without one (no sentence) waits for them. Ranks wait a little longer each, so that one speaks
    and takes the others with it.
    """
    request = comm.Ibarrier()
    deadline = time.monotonic() + _PATIENCE + min(0.2 * comm.rank, _PATIENCE)
    while not request.Test():
        if sentence and time.monotonic() > deadline:
            sys.stdout.flush()
            print(f"cruciform-petsc: on rank {comm.rank}, {sentence}", file=sys.stderr, flush=True)
            comm.Abort(2)
        time.sleep(0.001)


def least(comm: MPI.Intracomm, values, initial=np.inf):
    """Smallest of a number, or of an array of any size, of each rank, and ``initial``. Collective.

    Whole numbers stay exact.
    """
    return min(*comm.allgather(np.min(values).item() if np.size(values) else initial), initial)


def most(comm: MPI.Intracomm, values, initial=-np.inf):
    """Largest of what least finds the smallest of. Collective."""
    return max(*comm.allgather(np.max(values).item() if np.size(values) else initial), initial)


def quantile(
    comm: MPI.Intracomm, values: np.ndarray, share: float, weight: np.ndarray | None = None
) -> float:
    """Smallest of all ranks' values (n,) that has, with those below it, a share of all weight.

    Collective; NaN without any weight. Weights are whole numbers (1 each by default), so that the
    result is the same on any number of ranks. Halving the range finds it, to 1e-15 of the range.
    """
    weight = np.ones(len(values), np.int64) if weight is None else weight
    values, weight = values[weight > 0], weight[weight > 0]
    total = comm.allreduce(int(weight.sum()))
    if not total:
        return math.nan

    def reaches(value: float) -> bool:
        return comm.allreduce(int(weight[values <= value].sum())) >= share * total

    low, high = least(comm, values), most(comm, values)
    if reaches(low):
        return low
    for _ in range(50):
        middle = 0.5 * (low + high)
        low, high = (low, middle) if reaches(middle) else (middle, high)
    return most(comm, values[values <= high])


# -- records -----------------------------------------------------------------------------------


def send_by_rank(comm: MPI.Intracomm, rank: np.ndarray, *records: np.ndarray) -> list[np.ndarray]:
    """Send row k of each array (n, ...) to rank[k]. Collective.

    Types and shapes (but for n) are the same on every rank. Returns arrays (m, ...) of the rows
    received, by sender, those of one sender in its order.
    """
    order = np.argsort(rank, kind="stable")
    send = np.bincount(rank, minlength=comm.size)
    receive = np.empty_like(send)
    comm.Alltoall(send, receive)
    received = []
    for rows in records:
        width = math.prod(rows.shape[1:])
        incoming = np.empty((int(receive.sum()), *rows.shape[1:]), rows.dtype)
        comm.Alltoallv(
            [np.ascontiguousarray(rows[order]), send * width], [incoming, receive * width]
        )
        received.append(incoming)
    return received


def ask(
    comm: MPI.Intracomm,
    rank: np.ndarray,
    questions: np.ndarray,
    answer: Callable[[np.ndarray], np.ndarray],
) -> np.ndarray:
    """Have question k answered by rank[k]; returns the answers in the order asked. Collective.

    ``answer`` makes an array (m, ...) of the questions (m, ...) that came to this rank.
    """
    asker, asked = send_by_rank(comm, rank, np.full(len(rank), comm.rank), questions)
    (answers,) = send_by_rank(comm, asker, answer(asked))
    result = np.empty_like(answers)
    result[np.argsort(rank, kind="stable")] = answers
    return result


# -- values on shared nodes --------------------------------------------------------------------


class Halo:
    """Copies on this rank (*ghosts*) of values that other ranks own. Collective.

    Local arrays (n_local, ...) hold the owned values first, then the ghosts. Only neighbours
    exchange messages; nothing has to be freed.

    Parameters
    ----------
    ghost_owner : int (n_ghost,)
        Rank that owns each ghost.
    ghost_key : int64 (n_ghost, ...)
        Names of the ghosts.
    find : callable
        Local indices of the owned values of some names, -1 where there is none.

    Attributes
    ----------
    exported : int (n_out,)
        Owned values that other ranks have copies of, one entry a copy, by rank.
    """

    def __init__(
        self,
        comm: MPI.Intracomm,
        num_owned: int,
        ghost_owner: np.ndarray,
        ghost_key: np.ndarray,
        find: Callable[[np.ndarray], np.ndarray],
    ):
        self.comm, self.num_owned, self.ghost_owner = comm, num_owned, ghost_owner
        rank, key = send_by_rank(comm, ghost_owner, np.full(len(ghost_owner), comm.rank), ghost_key)
        self.exported = find(key)
        if not comm.allreduce(bool((self.exported >= 0).all()), MPI.LAND):
            raise AssertionError("two ranks disagree on who owns a value")
        self._by_owner = np.argsort(ghost_owner, kind="stable")
        self._owners = _runs(ghost_owner[self._by_owner])
        self._holders = _runs(rank)

    @classmethod
    def of_numbers(cls, comm: MPI.Intracomm, num_owned: int, ghost: np.ndarray) -> Halo:
        """Halo of ghosts with global numbers, where each rank owns a range of these. Collective."""
        ends = np.cumsum(comm.allgather(num_owned))
        begin = ends[comm.rank] - num_owned
        owner = np.searchsorted(ends, ghost, side="right")
        return cls(comm, num_owned, owner, ghost, lambda number: number - begin)

    def forward(self, values: np.ndarray) -> np.ndarray:
        """Copy owned values to the ghosts, in place; returns values (n_local, ...)."""
        values[self.num_owned :] = self.to_ghosts(values[self.exported])
        return values

    def reverse(self, values: np.ndarray, combine: np.ufunc = np.add) -> np.ndarray:
        """Combine what the ghosts hold with their owners' values, in place; returns values.

        Ghosts keep what they had.
        """
        combine.at(values, self.exported, self.to_owners(values[self.num_owned :]))
        return values

    def share(self, values: np.ndarray, combine: np.ufunc = np.add) -> np.ndarray:
        """Give all ranks what they hold of each value together, in place; returns values."""
        return self.forward(self.reverse(values, combine))

    def to_owners(self, records: np.ndarray) -> np.ndarray:
        """Send a record for each ghost; returns one for each entry of ``exported``."""
        return self._send(records[self._by_owner], self._owners, self._holders, len(self.exported))

    def to_ghosts(self, records: np.ndarray) -> np.ndarray:
        """Send a record for each entry of ``exported``; returns the ghosts' (n_ghost, ...)."""
        received = self._send(records, self._holders, self._owners, len(self._by_owner))
        result = np.empty_like(received)
        result[self._by_owner] = received
        return result

    def _send(self, records: np.ndarray, targets, sources, size: int) -> np.ndarray:
        records = np.ascontiguousarray(records)
        received = np.empty((size, *records.shape[1:]), records.dtype)
        requests = [self.comm.Irecv(received[rows], rank, _TAG) for rank, rows in sources]
        requests += [self.comm.Isend(records[rows], rank, _TAG) for rank, rows in targets]
        MPI.Request.Waitall(requests)
        return received


def _runs(ranks: np.ndarray) -> list[tuple[int, slice]]:
    """Each rank among ascending ones, and where it stands."""
    rank, begin, count = np.unique(ranks, return_index=True, return_counts=True)
    return [(int(r), slice(b, b + n)) for r, b, n in zip(rank, begin, count, strict=True)]


def find_sorted(keys: np.ndarray, wanted: np.ndarray) -> np.ndarray:
    """Indices of some keys among ascending ones, -1 where there is none."""
    if len(keys) == 0:
        return np.full(np.shape(wanted), -1)
    index = np.asarray(np.searchsorted(keys, wanted))
    index[keys.take(index, mode="clip") != wanted] = -1
    return index


class DistributedNodes:
    """Nodes with names, dealt out over the ranks. Collective.

    Parameters
    ----------
    owned_key : int64 (n_owned,), ascending
        Names of this rank's nodes, the same on any number of ranks.
    ghost_key, ghost_owner : int64 (m,), int (m,)
        Names and owners of the nodes of other ranks that this one needs; they may repeat.

    Attributes
    ----------
    num_nodes_owned, num_nodes_local, num_nodes_global : int
        This rank's nodes, these and its ghosts, those of all ranks.
    node_key : int64 (n_local,)
        Names: owned ones ascending, then the ghosts', ascending too.
    node_number_global : int64 (n_local,)
        Owned: node_offset + 0, 1, 2 ...; ghosts: the owner's number.
    ghost_owner : int32 (n_ghost,)
    halo : Halo
    """

    def __init__(self, comm: MPI.Intracomm, owned_key, ghost_key, ghost_owner):
        self.comm = comm
        ghost_key, first = np.unique(ghost_key, return_index=True)
        self.ghost_owner = np.asarray(ghost_owner, np.int32)[first]
        self.node_key = np.concatenate([owned_key, ghost_key])
        self.num_nodes_owned, self.num_nodes_local = len(owned_key), len(self.node_key)
        self.node_offset = comm.exscan(self.num_nodes_owned) or 0
        self.num_nodes_global = comm.allreduce(self.num_nodes_owned)
        self.halo = Halo(
            comm,
            self.num_nodes_owned,
            self.ghost_owner,
            ghost_key,
            lambda keys: find_sorted(owned_key, keys),
        )
        number = self.node_offset + np.arange(self.num_nodes_local, dtype=np.int64)
        self.node_number_global = self.halo.forward(number)

    def find(self, keys: np.ndarray) -> np.ndarray:
        """Local numbers of the nodes with some names, int32; -1 for those not on this rank."""
        local = find_sorted(self.node_key[: self.num_nodes_owned], keys).astype(np.int32)
        elsewhere = local < 0
        ghost = find_sorted(self.node_key[self.num_nodes_owned :], keys[elsewhere])
        local[elsewhere] = np.where(ghost >= 0, ghost + self.num_nodes_owned, -1)
        return local
