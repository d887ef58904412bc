# SPDX-License-Identifier: MIT
"""A fishnet on several ranks: the same joints, the same seed of least energy, the same files."""

import json

import numpy as np
import pytest
from mpi4py import MPI
from support.formed import cloth, network
from support.forming import kept, same_end
from support.laid import written

from cruciform_petsc.case.schema import Case
from cruciform_petsc.cli import main
from cruciform_petsc.forming.draping import Draping
from cruciform_petsc.forming.fishnet_table import LayTable
from cruciform_petsc.net.network import Network
from cruciform_petsc.output.checkpoint import Checkpoint
from cruciform_petsc.output.draped import crossover_columns
from cruciform_petsc.tools import shapes
from cruciform_petsc.tools.motion import Pose
from cruciform_petsc.tools.tool import Tool

COMM = MPI.COMM_WORLD
RADIUS = 50e-3


def ball():
    return Tool("ball", shapes.sphere(RADIUS), 0.0, Pose(np.array([0.0, 0.0, -RADIUS])))


def gathered(net, laid):
    """All crossovers and arm ends, in the order of the net, on every rank."""
    own = np.column_stack(
        [net.crossover_number_global, laid.laid, laid.crossovers, laid.ends.reshape(-1, 12)]
    )
    rows = np.concatenate(net.comm.allgather(own))
    return rows[np.argsort(rows[:, 0])]


@pytest.mark.parametrize(
    ("angle", "keys"),
    [
        ("0 deg", {}),
        ("30 deg", {"seed": [12e-3, -20e-3], "turn": "5 deg"}),
        ("45 deg", {"locking_angle": "20 deg"}),
    ],
)
def test_joints(angle, keys):
    """As on one rank, wherever the seed lies, and where the net locks."""
    table = LayTable.from_data(keys, "test", bare=True)
    rows, told = [], []
    for comm in (COMM, MPI.COMM_SELF):
        net = network((70.0, 90.0), cloth(), angle, comm)
        found = table.lay(net, ball(), True, 0.5e-3)
        rows.append(gathered(net, found.laid))
        told.append((found.laid.joints, found.laid.beyond, found.laid.limit))
    # Each joint follows from three others by the same operations in the same order.
    np.testing.assert_allclose(rows[0], rows[1], rtol=0, atol=1e-14)
    assert told[0] == told[1]
    assert bool(told[0][2]) == ("locking_angle" in keys)


def test_no_rank_lays_more_than_its_part():
    """Blocks are the partition's, a row of joints wider on each side."""
    net = network((120.0, 90.0), cloth(), "20 deg", COMM)
    low, high = net.partition.box[COMM.rank]
    block = int((2 * (high - low) + 2).prod())
    total = COMM.allreduce(int((2 * (high - low)).prod()))
    assert COMM.size == 1 or block < 0.8 * total


def test_search():
    """Shared out over the ranks; what is found does not depend on how many there are."""
    table = LayTable.from_data(
        {"seed": [10e-3, 5e-3], "least_energy": {"places": 1, "turn": 0.0, "shear": 0.0}},
        "test",
        bare=True,
    )
    found = [
        table.lay(network((50.0, 50.0), cloth(), "0 deg", comm), ball(), True, 0.5e-3)
        for comm in (COMM, MPI.COMM_SELF)
    ]
    assert found[0].search.energy == found[1].search.energy
    np.testing.assert_array_equal(found[0].search.flat, found[1].search.flat)
    assert found[0].search.nets == found[1].search.nets


CASE = """
[fabric]
use = "glass-pp-plain-1.93"
[preform]
outline = { rectangle = ["100 mm", "90 mm"] }
bias_angle = "30 deg"
[test]
kind = "fishnet"
[[tool]]
name = "mould"
shape = { sphere = { radius = "50 mm", shaft = true } }
[output]
pictures = false
"""


def test_files(tmp_path):
    """fields.csv, outline.csv and the summary's figures are those of one rank."""
    path = tmp_path / "case.toml"
    if COMM.rank == 0:
        path.write_text(CASE)
    COMM.Barrier()
    assert main(["run", str(path), "--output", str(tmp_path / "all")]) == 0
    if COMM.rank == 0:
        case = Case.load(path)
        alone = case.forming(Network(MPI.COMM_SELF, case.preform(), case.fabric()))
        assert isinstance(alone, Draping)
        table = np.genfromtxt(tmp_path / "all" / "fields.csv", delimiter=",", names=True)
        for name, values in crossover_columns(alone).items():
            np.testing.assert_allclose(table[name], values, rtol=1e-8, atol=1e-8, err_msg=name)
        summary = json.loads((tmp_path / "all" / "summary.json").read_text())
        told = alone.results()
        assert summary["shear_max_deg"] == pytest.approx(told["shear_max_deg"], rel=1e-12)
        assert summary["shear_max_at_mm"]["flat"] == pytest.approx(told["shear_max_at_mm"]["flat"])
        assert summary["ranks"] == COMM.size


def test_pieces(tmp_path):
    """Laid piece by piece, killed within the second one: the same end as on one rank."""
    path = tmp_path / "case.toml"
    pieces = ("fishnet = {}", 'fishnet = { pieces = 2, press = "10 kPa" }')
    if COMM.rank == 0:
        written(tmp_path, pieces)
    COMM.Barrier()
    case = Case.load(path)
    alone = kept(MPI.COMM_SELF, case)
    stop = sum(step.stage == "lay 1" for step in alone.steps) + 2
    assert kept(COMM, case, Checkpoint.begin(COMM, tmp_path, case), stop=stop) is None
    # Newton stops at 1e-4 of the forces, at other iterates on other ranks' sums.
    same_end(kept(COMM, case, Checkpoint.resume(COMM, tmp_path)), alone, within=1e-4)


def test_laid_blanks(tmp_path):
    """A blank begins at the same places on any ranks, other tools where they touch it there."""
    path = tmp_path / "case.toml"
    if COMM.rank == 0:
        written(tmp_path)
    COMM.Barrier()
    case = Case.load(path)
    found = []
    for comm in (COMM, MPI.COMM_SELF):
        forming = case.forming(Network(comm, case.preform(), case.fabric()))
        nodes = forming.blank.ply.nodes
        own = nodes.num_nodes_owned
        start = forming.blank.start().x[forming.blank.cloth_at[:own]]
        key = np.concatenate(comm.allgather(nodes.node_key[:own]))
        found.append(np.concatenate(comm.allgather(start))[np.argsort(key)])
    np.testing.assert_allclose(found[0], found[1], rtol=0, atol=1e-13)
