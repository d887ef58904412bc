# SPDX-License-Identifier: MIT
"""A tool is made on one rank and the same on all."""

import numpy as np
import pytest
from mpi4py import MPI
from support.toolfiles import write_stl

from cruciform_petsc.errors import InputError
from cruciform_petsc.tools.shapes import sphere
from cruciform_petsc.tools.tool import ToolTable, load

COMM = MPI.COMM_WORLD


def test_a_file_is_read_on_one_rank(tmp_path):
    shared = COMM.bcast(tmp_path)
    if COMM.rank == 0:
        points, facets = sphere(0.02).facets(1e-4)
        write_stl(shared / "ball.stl", points / 1e-3, facets)
    shape = {"file": "ball.stl", "unit": "mm", "cell": "2 mm"}
    table = ToolTable.from_data({"name": "ball", "shape": shape, "friction": 0.2})
    tool = load(COMM, table, folder=shared)
    distance = tool.look(np.array([[0.021, 0.0, 0.0]]), tool.start)[0]
    assert distance == pytest.approx(1e-3, abs=2e-5)
    assert len(set(COMM.allgather(tool.look(np.eye(3) * 0.02, tool.start)[0].tobytes()))) == 1


def test_a_mistake_is_told_on_all(tmp_path):
    shared = COMM.bcast(tmp_path)
    table = ToolTable.from_data({"name": "a", "shape": {"file": "none.stl", "unit": "mm"}})
    with pytest.raises(InputError, match='tool "a": .*does not exist'):
        load(COMM, table, folder=shared)
