# SPDX-License-Identifier: MIT
"""Several sets of nodes as one, on any number of ranks."""

import numpy as np
import pytest
from mpi4py import MPI
from support.helpers import TABLE_1, UNEVEN, diagonals, holed

from cruciform_petsc.items.nodes import PlyNodes
from cruciform_petsc.net.edges import Constraints
from cruciform_petsc.net.joined import JoinedNodes, ToolNodes
from cruciform_petsc.net.network import Network

COMM = MPI.COMM_WORLD
PLACES = np.array([[0.0, 0.0, 1.0], [0.5, 0.0, 2.0]])
pytestmark = pytest.mark.three_ranks


def parts():
    """Two plies and two tools."""
    nodes = []
    for preform, fabric in ((diagonals(4, 6), TABLE_1), (holed(0.05, 0.07, 0.011, 0.4), UNEVEN)):
        constraints = Constraints(Network(COMM, preform, fabric), True, floats=True)
        nodes.append(PlyNodes(constraints, (1e-4, 1e-4), flat=False).nodes)
    return [*nodes, ToolNodes(COMM, PLACES)]


def test_tool_nodes():
    """A node a tool, on the first rank; all others have a copy."""
    tools = ToolNodes(COMM, PLACES)
    first = COMM.rank == 0
    assert (tools.num_nodes_owned, tools.num_nodes_local) == (2 * first, 2)
    assert tools.num_nodes_global == 2
    assert tools.node_number_global.tolist() == [0, 1]
    np.testing.assert_array_equal(tools.rest, PLACES)
    # What ranks push a tool by comes together on its owner.
    pushed = tools.halo.reverse(np.full((2, 3), 1.0 + COMM.rank))
    if first:
        assert (pushed == sum(range(1, COMM.size + 1))).all()


def test_joined_nodes():
    """Owned nodes part by part, then ghosts; numbers, copies and sums are those of the parts."""
    parts_ = parts()
    joined = JoinedNodes(parts_)
    assert joined.num_nodes_global == sum(part.num_nodes_global for part in parts_)
    assert joined.num_nodes_owned == sum(part.num_nodes_owned for part in parts_)
    every = np.concatenate(joined.maps)
    assert np.array_equal(np.sort(every), np.arange(joined.num_nodes_local))
    owned = joined.num_nodes_owned
    number = joined.node_number_global
    numbers = np.concatenate(COMM.allgather(number[:owned]))
    assert np.array_equal(numbers, np.arange(joined.num_nodes_global))
    begin = np.cumsum([0, *COMM.allgather(owned)])
    ghost_owner = np.searchsorted(begin, number[owned:], side="right") - 1
    np.testing.assert_array_equal(ghost_owner, joined.ghost_owner)
    for part, at in zip(parts_, joined.maps, strict=True):
        assert ((at < owned) == (np.arange(len(at)) < part.num_nodes_owned)).all()
        np.testing.assert_array_equal(joined.rest[at], part.rest)
        np.testing.assert_array_equal(joined.frame[at], part.frame)
    # Copies of owners' values, and sums of what all ranks have for a node.
    rng = np.random.default_rng(COMM.rank)
    values = [rng.normal(size=(part.num_nodes_local, 3)) for part in parts_]
    forward = joined.halo.forward(joined.join(values))
    back = joined.halo.reverse(joined.join(values))
    for part, at, value in zip(parts_, joined.maps, values, strict=True):
        np.testing.assert_array_equal(forward[at], part.halo.forward(value.copy()))
        n = part.num_nodes_owned
        np.testing.assert_allclose(back[at[:n]], part.halo.reverse(value.copy())[:n], atol=1e-14)
