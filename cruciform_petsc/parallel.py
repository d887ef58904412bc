# SPDX-License-Identifier: MIT
"""All messages between ranks: values on shared nodes, records by rank, what rank 0 does for all."""

from __future__ import annotations

from collections.abc import Callable
from typing import TypeVar

import numpy as np
from mpi4py import MPI

from .errors import CruciformError

T = TypeVar("T")


def on_root(comm: MPI.Intracomm, function: Callable[[], T]) -> T:
    """Call a function on rank 0 and return its result, or raise its error, on every rank.

    Collective. The result must be picklable.
    """
    result: T | None = None
    problem: Exception | None = None
    if comm.rank == 0:
        try:
            result = function()
        except Exception as error:
            problem = error
    told = problem
    if problem is not None and not isinstance(problem, CruciformError):
        # Not every exception survives pickling; its text does.
        told = RuntimeError(f"on rank 0: {type(problem).__name__}: {problem}")
    result, told = comm.bcast((result, told), root=0)
    if told is not None:
        raise told if problem is None else problem
    return result  # type: ignore[return-value]


class GhostExchange:
    """Sends values between the owned nodes of each rank and their ghosts on others. Collective.

    Local arrays hold the owned nodes first, then the ghosts.

    Parameters
    ----------
    comm : mpi4py communicator
    owned_key : int64 (n_owned,), ascending
    ghost_key : int64 (n_ghost,)
    ghost_owner : int (n_ghost,)
        Rank that owns each ghost.
    """

    def __init__(self, comm: MPI.Intracomm, owned_key, ghost_key, ghost_owner):
        self.comm = comm
        self.num_owned = len(owned_key)
        order = np.argsort(ghost_owner, kind="stable")
        # A rank's ghosts are its incoming values, in the order in which it asks for them.
        self._in_ghost = self.num_owned + order
        self._in_count = np.bincount(ghost_owner, minlength=comm.size).astype(np.int32)
        self._ghost_owner = np.asarray(ghost_owner)
        self._out_count = self.counts(self._in_count)
        asked = self.alltoall(ghost_key[order], self._in_count, self._out_count)
        self._out_owned = np.searchsorted(owned_key, asked)
        found = self._out_owned < len(owned_key)
        found[found] = owned_key[self._out_owned[found]] == asked[found]
        if not comm.allreduce(bool(found.all()), MPI.LAND):
            raise AssertionError("two ranks disagree on who owns an arm end")

    def route(self, ghost_node: np.ndarray, number_global: np.ndarray):
        """Plan for sending one record for each entry of ``ghost_node`` (local ghost numbers).

        Returns
        -------
        count : int32 (size,), records per receiving rank
        order : int (n,), the records in sending order
        number : int64 (n,), their nodes' global numbers in that order
        """
        owner = self._ghost_owner[ghost_node - self.num_owned]
        order = np.argsort(owner, kind="stable")
        count = np.bincount(owner, minlength=self.comm.size).astype(np.int32)
        return count, order, number_global[order]

    def counts(self, send_count: np.ndarray) -> np.ndarray:
        """What each rank will send to this one. Collective."""
        receive_count = np.empty_like(send_count)
        self.comm.Alltoall(send_count, receive_count)
        return receive_count

    def alltoall(self, out: np.ndarray, send_count, receive_count) -> np.ndarray:
        """Send records (n, ...) in rank order; returns those received. Collective."""
        width = int(np.prod(out.shape[1:]))
        incoming = np.empty((int(receive_count.sum()), *out.shape[1:]), out.dtype)
        self.comm.Alltoallv(
            [np.ascontiguousarray(out), send_count * width], [incoming, receive_count * width]
        )
        return incoming

    def forward(self, values: np.ndarray) -> np.ndarray:
        """Copy owned values to the ghosts, in place; values (n_local, ...); returns values."""
        out = values[self._out_owned]
        values[self._in_ghost] = self.alltoall(out, self._out_count, self._in_count)
        return values

    def reverse(self, values: np.ndarray, combine: np.ufunc = np.add) -> np.ndarray:
        """Combine what the ghosts hold with their owners' values, in place; returns values.

        Ghosts keep what they had: call forward to give them the result.
        """
        incoming = self.alltoall(values[self._in_ghost], self._in_count, self._out_count)
        combine.at(values, self._out_owned, incoming)
        return values
