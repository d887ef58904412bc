# SPDX-License-Identifier: MIT
"""Exports of a network that lies on several ranks."""

import numpy as np
import pytest
from mpi4py import MPI
from support.exported import WEIGHED, moved, read_input_file, read_table
from support.helpers import holed

from cruciform_petsc import BiasExtension, InputError, Network, Preform
from cruciform_petsc.output.exports import export
from cruciform_petsc.output.tables import in_order, write_pieces

COMM = MPI.COMM_WORLD
pytestmark = pytest.mark.three_ranks
GRADIENT = np.array([[1.05, 0.35], [-0.1, 0.93]])


def solved(comm):
    """A strip with a hole and no symmetry, pulled so far that it shears by some 10 degrees."""
    preform = holed(0.03, 0.05, 0.006, np.deg2rad(40.0))
    return BiasExtension(Network(comm, preform, WEIGHED), extension="3 mm", finite=True).solve()


def test_rows_do_not_depend_on_the_ranks(tmp_path):
    """The same rows in the same order, and the same elements under the same numbers."""
    result = solved(COMM)
    files = export(result, tmp_path / "many")
    assert COMM.allgather(files) == [files] * COMM.size
    alone = solved(MPI.COMM_SELF)
    if COMM.rank > 0:
        return
    one = export(alone, tmp_path / "one")
    assert sorted(path.name for path in files[0].parent.iterdir()) == [
        "crossovers.csv", "preform.inp",
    ]  # fmt: skip
    many_table, table = read_table(files[0]), read_table(one[0])
    assert list(many_table) == list(table)
    n = alone.network.num_crossovers_global
    assert many_table["crossover"].tolist() == list(range(n))
    for name, values in table.items():
        # Equilibrium is found to 1e-8 of the forces or better, on any ranks.
        atol = 1e-6 * np.abs(values).max()
        np.testing.assert_allclose(many_table[name], values, atol=atol, rtol=0, err_msg=name)

    many_deck, deck = read_input_file(files[1]), read_input_file(one[1])
    assert many_deck.element == deck.element
    assert many_deck.kind == deck.kind
    assert set(deck.kind.values()) == {"S4R", "S3R"}
    assert many_deck.sets == deck.sets
    assert list(many_deck.node) == list(deck.node) == list(range(1, n + 1))
    for name, values in deck.distribution.items():
        assert list(many_deck.distribution[name]) == list(values)
        np.testing.assert_allclose(
            list(many_deck.distribution[name].values())[1:], list(values.values())[1:], atol=1e-4
        )
    assert list(many_deck.field) == [1, 2]
    # Sets of elements apart, which begin a line on each rank, keywords have the same lines.
    assert [(k[0], len(k[2])) for k in many_deck.keywords if k[0] != "ELSET"] == [
        (k[0], len(k[2])) for k in deck.keywords if k[0] != "ELSET"
    ]


def test_cells_across_ranks(tmp_path):
    """An affine motion is one on every element, also of those between ranks."""
    network = Network(COMM, holed(0.03, 0.05, 0.006, np.deg2rad(40.0)), WEIGHED)
    path = export(moved(network, GRADIENT), tmp_path)[1]
    if COMM.rank == 0:
        deck = read_input_file(path)
        thick = list(deck.distribution["THICKNESS"].values())[1:]
        np.testing.assert_allclose(thick, 0.5 / np.linalg.det(GRADIENT), rtol=1e-8)
        alone = Network(MPI.COMM_SELF, network.preform, WEIGHED)
        path = export(moved(alone, GRADIENT), tmp_path / "alone")[1]
        assert read_input_file(path).element == deck.element


def test_ranks_without_crossovers(tmp_path):
    network = Network(COMM, Preform.rectangle("4.2 mm", "4.2 mm", "0 deg"), WEIGHED)
    assert network.num_crossovers_global == 1
    files = export(moved(network, GRADIENT), tmp_path)
    if COMM.rank == 0:
        assert len(read_table(files[0])["crossover"]) == 1
        assert read_input_file(files[1]).element == {}


def test_in_order():
    """Rows dealt out at random come back in order, each rank its share of the numbers."""
    total = 101
    rng = np.random.default_rng(0)  # the same on every rank
    owner = rng.integers(0, COMM.size, total)
    number = rng.permutation(total)[owner == COMM.rank]
    number = number[number % 7 > 0]  # not all need be there
    got, rows = in_order(COMM, number, total, np.column_stack([number**2, -number]))
    np.testing.assert_array_equal(rows, np.column_stack([got**2, -got]))
    everything = np.concatenate(COMM.allgather(got))
    assert everything.tolist() == [k for k in range(total) if k % 7 > 0]
    assert len(got) <= -(-total // COMM.size)


def test_errors_reach_every_rank(tmp_path):
    """No rank waits for one that could not write, and no half of a file stays."""
    with pytest.raises(InputError, match="cannot be written: No such file"):
        write_pieces(COMM, tmp_path / "none" / "x", [b"a"])
    with pytest.raises(InputError, match="cannot be written: Is a directory"):
        # What the last rank writes to has gone and become a folder meanwhile.
        write_pieces(COMM, tmp_path / "x", spoiled(tmp_path))
    assert [p for p in tmp_path.iterdir() if p.is_file()] == []


def spoiled(folder):
    """Pieces of a file that cannot be written to after the first."""
    yield b"a"
    COMM.Barrier()
    if COMM.rank == 0:
        (temporary,) = folder.glob(".x.*.part")
        temporary.unlink()
        temporary.mkdir()
    COMM.Barrier()
    yield b"b"
