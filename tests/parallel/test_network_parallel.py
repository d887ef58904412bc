# SPDX-License-Identifier: MIT
"""The network on several ranks is the one that a single rank makes, dealt out."""

import numpy as np
import pytest
from mpi4py import MPI
from support.helpers import (
    PITCH,
    TABLE_1,
    UNEVEN,
    diagonals,
    gathered,
    holed,
    l_shape,
    random_preform,
)

from cruciform_petsc.cloth.preform import Preform
from cruciform_petsc.errors import InputError
from cruciform_petsc.net.network import Network

COMM = MPI.COMM_WORLD
pytestmark = pytest.mark.three_ranks

RNG = np.random.default_rng(11)
NETWORKS = [
    pytest.param(diagonals(4, 6), TABLE_1, id="table-1"),
    pytest.param(Preform.rectangle(0.024, 0.036, "30 deg", refine=3), TABLE_1, id="30-degrees"),
    pytest.param(holed(0.05, 0.07, 0.011, 0.4), UNEVEN, id="hole"),
    pytest.param(l_shape(0.06, 1.2), UNEVEN, id="L"),
    pytest.param(Preform.rectangle(1.4 * PITCH, 1.4 * PITCH, 0.0), TABLE_1, id="one-crossover"),
    pytest.param(Preform.rectangle(1.4 * PITCH, 2.4 * PITCH, 0.0), TABLE_1, id="chain-of-three"),
    *(
        pytest.param(random_preform(RNG, UNEVEN, 5.0, hole=k % 2 == 0), UNEVEN, id=f"random-{k}")
        for k in range(4)
    ),
]


def pair(preform, fabric):
    """The network on all ranks, and the same on this rank alone."""
    return Network(COMM, preform, fabric), Network(MPI.COMM_SELF, preform, fabric)


@pytest.mark.parametrize(("preform", "fabric"), NETWORKS)
def test_same_crossovers(preform, fabric):
    """Gathered by number: positions, arms, areas, joints."""
    network, alone = pair(preform, fabric)
    number = network.crossover_number_global
    assert network.num_crossovers_global == alone.num_crossovers_global
    assert COMM.allreduce(network.num_crossovers_owned) == network.num_crossovers_global
    every = gathered(COMM, number, number)
    np.testing.assert_array_equal(every, np.arange(network.num_crossovers_global))
    for name in ("crossover_ij", "crossover_position", "arm_is_shared"):
        values = gathered(COMM, number, getattr(network, name))
        np.testing.assert_array_equal(values, getattr(alone, name))
    for name in ("arm_length", "quadrant_area"):
        values = gathered(COMM, number, getattr(network, name))
        np.testing.assert_allclose(values, getattr(alone, name), rtol=1e-13, atol=1e-18)
    boundary = np.zeros(network.num_crossovers_owned, bool)
    boundary[network.boundary_crossovers] = True
    np.testing.assert_array_equal(
        np.flatnonzero(gathered(COMM, number, boundary)), alone.boundary_crossovers
    )
    assert network.covered_area() == pytest.approx(alone.covered_area(), rel=1e-13)


@pytest.mark.parametrize(("preform", "fabric"), NETWORKS)
def test_same_nodes(preform, fabric):
    """Gathered by key: each node owned once, at its place; arms end at the same keys."""
    network, alone = pair(preform, fabric)
    owned = network.num_nodes_owned
    key = network.node_key
    assert (np.diff(key[:owned]) > 0).all()
    assert len(np.unique(key)) == len(key)
    np.testing.assert_array_equal(gathered(COMM, key[:owned], key[:owned]), alone.node_key)
    assert network.num_nodes_global == alone.num_nodes_global
    # A joint's place is reckoned from either crossover: rounding.
    for name, near in (
        ("node_position", 1e-15),
        ("node_is_boundary", 0),
        ("node_family", 0),
        ("node_is_hinge", 0),
    ):
        values = getattr(network, name)
        every = gathered(COMM, key[:owned], values[:owned])
        np.testing.assert_allclose(every, getattr(alone, name), rtol=0, atol=near)
        # Ghosts, too, know what their owners know.
        np.testing.assert_array_equal(values, every[np.searchsorted(alone.node_key, key)])
    ends = gathered(COMM, network.crossover_number_global, key[network.arm_node])
    np.testing.assert_array_equal(ends, alone.node_key[alone.arm_node])


@pytest.mark.parametrize(("preform", "fabric"), NETWORKS)
def test_numbers_of_nodes(preform, fabric):
    """Contiguous on each rank; ghosts have their owners' numbers."""
    network, _ = pair(preform, fabric)
    owned, number = network.num_nodes_owned, network.node_number_global
    np.testing.assert_array_equal(number[:owned], network.node_offset + np.arange(owned))
    before = sum(COMM.allgather(owned)[: COMM.rank])
    assert network.node_offset == before
    keys = np.concatenate(COMM.allgather(network.node_key[:owned]))
    numbers = np.concatenate(COMM.allgather(number[:owned]))
    known = dict(zip(keys.tolist(), numbers.tolist(), strict=True))
    assert [known[key] for key in network.node_key.tolist()] == number.tolist()
    np.testing.assert_array_equal(np.sort(numbers), np.arange(network.num_nodes_global))


@pytest.mark.parametrize(("preform", "fabric"), NETWORKS)
def test_partition_deals_out_what_it_says(preform, fabric):
    """owner() names the rank that has a crossover."""
    network, alone = pair(preform, fabric)
    owner = network.partition.owner(alone.crossover_ij.astype(np.int64))
    np.testing.assert_array_equal(
        network.crossover_number_global, np.flatnonzero(owner == COMM.rank)
    )
    assert network.partition.in_box(network.crossover_ij, COMM.rank).all()


def test_no_rank_has_it_all():
    """A rank holds its share and the ends on its border."""
    network = Network(COMM, Preform.rectangle(0.3, 0.3, 0.4), TABLE_1)
    told = network.statistics()
    assert told["imbalance"] < 1.05
    share = network.num_crossovers_global / COMM.size
    assert network.num_crossovers_owned < 1.05 * share
    ghosts = network.num_nodes_local - network.num_nodes_owned
    assert ghosts < 4 * np.sqrt(network.num_crossovers_global)
    assert told["cut_yarns"] == COMM.allreduce(ghosts)
    assert (told["cut_yarns"] > 0) == (COMM.size > 1)


def test_cut_yarns_are_counted():
    """Once for each joint whose two crossovers are on different ranks."""
    network, alone = pair(holed(0.05, 0.07, 0.011, 0.4), UNEVEN)
    owner = network.partition.owner(alone.crossover_ij.astype(np.int64))
    ends = {}
    for e, arm in np.argwhere(alone.arm_is_shared):
        ends.setdefault(int(alone.arm_node[e, arm]), []).append(owner[e])
    cut = sum(first != second for first, second in ends.values())
    assert network.statistics()["cut_yarns"] == cut


def test_idle_ranks():
    """More ranks than crossovers: empty arrays of the right shapes, and nobody waits."""
    network = Network(COMM, Preform.rectangle(1.4 * PITCH, 1.4 * PITCH, 0.0), TABLE_1)
    counts = COMM.allgather(network.num_crossovers_owned)
    assert sorted(counts) == [0] * (COMM.size - 1) + [1]
    n = network.num_crossovers_owned
    assert network.arm_node.shape == network.arm_length.shape == (n, 4)
    assert network.quadrant_area.shape == (n, 4)
    assert network.node_position.shape == (network.num_nodes_local, 2)
    assert network.statistics()["imbalance"] == COMM.size
    assert network.covered_area() == pytest.approx((1.4 * PITCH) ** 2)


def test_no_crossover_is_an_error_everywhere():
    """The same sentence on every rank."""
    band = np.array([(0.0, 0.3), (8.0, 8.3), (8.0, 8.7), (0.0, 0.7)]) * PITCH
    preform = Preform.polygon(band.tolist(), [], np.pi / 2, origin=(0.0, 0.0))
    with pytest.raises(InputError) as caught:
        Network(COMM, preform, TABLE_1)
    assert len(set(COMM.allgather(str(caught.value)))) == 1
