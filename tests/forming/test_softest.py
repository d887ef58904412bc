# SPDX-License-Identifier: MIT
"""The lowest stiffness of a forming."""

import csv
import tomllib

import numpy as np
import pytest
from mpi4py import MPI
from scipy.linalg import eigh
from support.forming import CASE, written
from support.helpers import dense

from cruciform_petsc import Case, Network
from cruciform_petsc.cli import main


def formed(**keys):
    data = tomllib.loads(CASE)
    data["test"] |= {"stability": {"modes": 2}} | keys
    case = Case.from_data(data)
    forming = case.forming(Network(MPI.COMM_SELF, case.preform(), case.fabric()))
    return forming, forming.solve()


def test_softest_shape():
    """LAPACK's lowest eigenvalue of the tangent over the nodes' areas.

    Viscosity, which a step is held by while it is sought, is none of it: its energy is nothing at
    the time of the accepted state.
    """
    forming, found = formed()
    blank, state = forming.blank, found.states[-1]
    matrix, _ = blank.model.stiffness(state)
    area = blank.area_of_nodes()
    assert area.sum() == pytest.approx(0.056**2, rel=1e-9)
    np.testing.assert_allclose(area[blank.cloth_at], blank.ply.areas(1 / 3), rtol=1e-12)
    area = np.repeat(np.where(area > 0.0, area, area[area > 0.0].mean()), 3)
    values = eigh(dense(matrix), np.diag(area), eigvals_only=True)
    matrix.destroy()
    assert found.steps[-1].softest == pytest.approx(values[0], rel=1e-6)
    np.testing.assert_allclose(found.modes.values, values[:2], rtol=1e-6)
    held = blank.tool_node[:2]  # the holder, pushed by a force, goes up and down
    assert (found.modes.shapes[:, held] == 0.0).all()
    assert [step.softest is not None for step in found.steps] == [True] * 3


def test_softest_shape_of_a_run(tmp_path):
    """A column of forces.csv, empty where it is not asked for."""
    case = written(tmp_path)
    words = ["--set", "test.stability={}", "--set", "output.pictures=false", "--quiet"]
    assert main(["run", str(case), *words, "--output", str(tmp_path / "out")]) == 0
    with (tmp_path / "out" / "forces.csv").open() as file:
        column = [float(row["lowest_stiffness_Pa_per_mm"]) for row in csv.DictReader(file)]
    assert len(column) == 3
    assert min(column) > 0.0
