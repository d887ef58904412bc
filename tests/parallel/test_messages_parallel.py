# SPDX-License-Identifier: MIT
"""Messages between ranks: halos, records, errors that all ranks share."""

import numpy as np
import pytest
from mpi4py import MPI
from support.helpers import UNEVEN, holed

from cruciform_petsc.errors import InputError
from cruciform_petsc.net.network import Network
from cruciform_petsc.parallel import (
    DistributedNodes,
    ask,
    least,
    most,
    on_all,
    on_root,
    quantile,
    send_by_rank,
)

COMM = MPI.COMM_WORLD
pytestmark = pytest.mark.three_ranks


# -- values on shared nodes ---------------------------------------------------------------------


@pytest.fixture
def network():
    """One with many ghosts."""
    return Network(COMM, holed(0.05, 0.07, 0.011, 0.4), UNEVEN)


def mixed(key, rank=0):
    """Values (n, 2) that a key and a rank determine."""
    seed = (key % 1_000_003).astype(float)[:, None] + 0.37 * rank
    return np.sin(seed * [1.0, 2.0])


def test_forward(network):
    """Ghosts get what their owners have; owners keep it; in place."""
    values = mixed(network.node_key)
    values[network.num_nodes_owned :] = np.nan
    result = network.halo.forward(values)
    assert result is values
    np.testing.assert_array_equal(values, mixed(network.node_key))


@pytest.mark.parametrize(
    ("combine", "slow"), [(np.add, np.sum), (np.minimum, np.min), (np.maximum, np.max)]
)
def test_reverse(network, combine, slow):
    """Owners get what all ranks hold together; ghosts keep theirs."""
    values = mixed(network.node_key, COMM.rank)
    held = {}
    for rank, keys in enumerate(COMM.allgather(network.node_key)):
        for key, value in zip(keys.tolist(), mixed(keys, rank), strict=True):
            held.setdefault(key, []).append(value)
    network.halo.reverse(values, combine)
    owned = network.num_nodes_owned
    expected = [slow(held[key], axis=0) for key in network.node_key[:owned].tolist()]
    np.testing.assert_allclose(values[:owned], expected, rtol=1e-14)
    np.testing.assert_array_equal(values[owned:], mixed(network.node_key[owned:], COMM.rank))


@pytest.mark.parametrize("dtype", [bool, np.int8, np.int32, np.int64, float])
def test_any_type_and_shape(network, dtype):
    """Flags, numbers, vectors, matrices for each node."""
    shape = {bool: (), np.int8: (2,), np.int32: (), np.int64: (1,), float: (2, 3)}[dtype]
    base = (network.node_key % 7).astype(dtype)
    values = np.broadcast_to(base.reshape(-1, *[1] * len(shape)), (len(base), *shape)).copy()
    expected = values.copy()
    values[network.num_nodes_owned :] = 0
    network.halo.forward(values)
    np.testing.assert_array_equal(values, expected)
    if dtype is bool:
        marked = np.zeros(len(base), bool)
        marked[network.num_nodes_owned :] = True  # by those that have the ghosts
        network.halo.share(marked, np.logical_or)
        keys = np.concatenate(COMM.allgather(network.node_key[network.num_nodes_owned :]))
        np.testing.assert_array_equal(marked, np.isin(network.node_key, keys))


def test_share(network):
    """Every rank that has a value ends with what all of them hold together."""
    values = np.ones(network.num_nodes_local)
    assert network.halo.share(values) is values
    keys = np.concatenate(COMM.allgather(network.node_key))
    every, count = np.unique(keys, return_counts=True)
    np.testing.assert_array_equal(values, count[np.searchsorted(every, network.node_key)])


def test_every_rank_has_copies_of_all():
    """Ghosts whose owners take turns, as neighbours on a yarn hardly do, and several copies."""
    keys = np.arange(4 * COMM.size)
    owned = keys[keys % COMM.size == COMM.rank]
    ghost = np.setdiff1d(keys, owned)
    nodes = DistributedNodes(COMM, owned, ghost[::-1], (ghost % COMM.size)[::-1])
    local = np.where(np.arange(len(keys)) < 4, nodes.node_key, -1)
    np.testing.assert_array_equal(nodes.halo.forward(local), nodes.node_key)
    shared = nodes.halo.share((COMM.rank + 1) * nodes.node_key)
    np.testing.assert_array_equal(shared, nodes.node_key * sum(range(COMM.size + 1)))


def test_nodes_are_found_by_name(network):
    """Owned ones and ghosts; -1 for those of others."""
    local = network.find(network.node_key[::-1])
    assert local.dtype == np.int32
    np.testing.assert_array_equal(local, np.arange(network.num_nodes_local)[::-1])
    elsewhere = np.setdiff1d(np.concatenate(COMM.allgather(network.node_key)), network.node_key)
    assert (network.find(elsewhere) == -1).all()


def test_records_by_rank():
    """By sender, those of one sender in its order; ranks that send nothing; several arrays."""
    number = 3 * COMM.rank  # rank 0 sends nothing
    rank = np.arange(number)[::-1] % COMM.size
    name = 100 * COMM.rank + np.arange(number)
    got, points, flags = send_by_rank(
        COMM, rank, name, np.stack([name, -name], axis=1).astype(float), name % 2 == 0
    )
    expected = np.concatenate([
        100 * sender + np.flatnonzero(np.arange(3 * sender)[::-1] % COMM.size == COMM.rank)
        for sender in range(COMM.size)
    ])  # fmt: skip
    np.testing.assert_array_equal(got, expected)
    np.testing.assert_array_equal(points, np.stack([expected, -expected], axis=1))
    np.testing.assert_array_equal(flags, expected % 2 == 0)


def test_answers_come_in_the_order_asked():
    """Each by the rank that was asked."""
    rng = np.random.default_rng(COMM.rank)
    rank = rng.integers(0, COMM.size, 20 * COMM.rank)
    question = rng.normal(size=(len(rank), 2))
    answer = ask(COMM, rank, question, lambda asked: asked.sum(axis=1) + 10.0 * COMM.rank)
    np.testing.assert_array_equal(answer, question.sum(axis=1) + 10.0 * rank)


def test_disagreement_is_noticed():
    """A ghost whose owner does not have it: all ranks stop."""
    key = np.array([10 * COMM.rank], np.int64)
    other = np.array([(COMM.rank + 1) % COMM.size])
    with pytest.raises(AssertionError, match="two ranks disagree"):
        DistributedNodes(COMM, key, np.array([5], np.int64), other)


# -- what one rank finds out, all know -----------------------------------------------------------


def test_least_and_most():
    """Of numbers, arrays, empty arrays; whole numbers stay exact; a value that counts too."""
    last = COMM.size - 1
    assert least(COMM, COMM.rank + 0.5) == 0.5
    assert most(COMM, np.array([[COMM.rank, -1]])) == last
    only = np.full(3 if COMM.rank == last else 0, 2**62 + 1)  # no float holds it
    assert least(COMM, only) == most(COMM, only) == 2**62 + 1
    assert isinstance(least(COMM, only), int)
    assert (least(COMM, []), most(COMM, [])) == (np.inf, -np.inf)
    assert (least(COMM, only, initial=3), most(COMM, [], initial=0.0)) == (3, 0.0)


@pytest.mark.parametrize("guilty", [0, COMM.size - 1])
@pytest.mark.parametrize("call", [on_all, on_root])
@pytest.mark.parametrize("error", [InputError("no such edge"), OSError("disk full")])
def test_an_error_on_one_rank_is_one_on_all(call, guilty, error):
    """None waits for the guilty rank; errors of the program come as they are, others as text."""

    def function():
        if COMM.rank == guilty:
            raise error
        return COMM.rank

    if call is on_root and guilty > 0:
        assert on_root(COMM, function) == 0
        return
    mine = InputError if isinstance(error, InputError) else (OSError, RuntimeError)
    with pytest.raises(mine, match=f"{error}$") as caught:
        call(COMM, function)
    if COMM.rank != guilty and isinstance(error, OSError):
        assert str(caught.value) == f"on rank {guilty}: OSError: disk full"


def test_each_rank_keeps_its_result():
    """on_all is no broadcast; on_root is one."""
    assert on_all(COMM, lambda: COMM.rank) == COMM.rank
    assert on_root(COMM, lambda: f"rank {COMM.rank}") == "rank 0"


# -- quantiles ------------------------------------------------------------------------------------


@pytest.mark.parametrize("share", [0.0, 0.2, 0.5, 0.99, 1.0])
@pytest.mark.parametrize("kind", ["any", "alike", "few", "of one rank"])
def test_quantile(share, kind):
    """Of values dealt out anyhow it is the same value, exactly, as of all in order."""
    random = np.random.default_rng(3)
    values = random.normal(size=400).round(1 if kind == "few" else 12) - (kind == "alike") * 1e3
    values = np.full(400, 7.25) if kind == "alike" else values
    weight = random.integers(0, 1000, 400)
    rank = random.integers(0, 1 if kind == "of one rank" else COMM.size, 400)
    own = rank == COMM.rank
    for mine, all_ in ((weight[own], weight), (None, np.ones(400, int))):
        order = np.argsort(values)
        order = order[all_[order] > 0]
        total = np.cumsum(all_[order])
        expected = values[order][np.searchsorted(total, share * total[-1])]
        assert quantile(COMM, values[own], share, mine) == expected
    assert np.isnan(quantile(COMM, values[own], share, 0 * weight[own]))
    assert np.isnan(quantile(COMM, values[:0], share))
