# SPDX-License-Identifier: MIT
"""Messages between ranks: that parallel.py alone sends them. What it does: tests/parallel/."""

import re
from pathlib import Path

import numpy as np
from mpi4py import MPI

import cruciform_petsc
from cruciform_petsc.parallel import DistributedNodes, find_sorted

SENDING = re.compile(
    r"(?<!axes)\.(I?alltoall\w*|I?neighbor_\w+|create_dist_graph\w*|create_graph\w*|I?[bsr]?send(_init|recv\w*)?"
    r"|I?m?recv(_init)?|put|get_accumulate|I?scatterv?|I?gatherv|I?allgatherv)\(",
    re.IGNORECASE,
)


def test_messages_are_sent_in_one_place():
    """Elsewhere ranks agree on a few numbers, by allreduce, allgather or bcast."""
    package = Path(cruciform_petsc.__file__).parent
    senders = {
        path.relative_to(package).as_posix()
        for path in package.rglob("*.py")
        if SENDING.search(path.read_text())
    }
    assert senders == {"parallel.py"}


def test_what_counts_as_a_message():
    """Of mpi4py's names, in capitals and without."""
    for line in ("comm.Alltoallv([a], [b])", "comm.alltoall(x)", "graph.Neighbor_alltoallv(a, b)",
                 "comm.Isend(x, 1)", "comm.recv()", "comm.Create_dist_graph_adjacent(a, b)",
                 "comm.Sendrecv(a, 0)"):  # fmt: skip
        assert SENDING.search(line), line
    for line in ("comm.allreduce(1)", "comm.Allgather(a, b)", "halo.forward(x)", "comm.bcast(x)"):
        assert not SENDING.search(line), line


def test_find_sorted():
    """Where each is, -1 where it is not; among none, too."""
    keys = np.array([2, 3, 5, 8])
    found = find_sorted(keys, np.array([[8, 2], [4, 9], [0, 3]]))
    assert found.tolist() == [[3, 0], [-1, -1], [-1, 1]]
    assert find_sorted(keys[:0], keys).tolist() == [-1] * 4
    assert find_sorted(keys, keys[:0]).tolist() == []


def test_nodes_of_one_rank():
    """All are its own, and sharing changes nothing."""
    nodes = DistributedNodes(MPI.COMM_SELF, np.array([7, 9]), np.zeros(0, np.int64), np.zeros(0))
    assert (nodes.num_nodes_owned, nodes.num_nodes_local, nodes.num_nodes_global) == (2, 2, 2)
    assert nodes.node_number_global.tolist() == [0, 1]
    assert nodes.find(np.array([9, 8, 7])).tolist() == [1, -1, 0]
    assert nodes.halo.share(np.array([1.0, 2.0])).tolist() == [1.0, 2.0]
