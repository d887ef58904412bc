# SPDX-License-Identifier: MIT
"""Drape tests and inflated nets on several ranks against one alone."""

import numpy as np
import pytest
from forming.test_drape import case as draped
from forming.test_inflation import case as blown
from mpi4py import MPI

from cruciform_petsc import Fabric, Preform
from cruciform_petsc.case.schema import Case
from cruciform_petsc.experiments.biaxial_load import BiaxialLoad
from cruciform_petsc.net.network import Network
from cruciform_petsc.parallel import on_root

COMM = MPI.COMM_WORLD
YARN = {"modulus": "200 N/cm", "yarns": "2 /cm", "yarn_bending": "0.1 N mm^2"}
SMALL = 'outline = { circle = "240 mm" }'
pytestmark = pytest.mark.three_ranks


def figures(comm, path):
    case = Case.load_collective(comm, path)
    forming = case.forming(Network(comm, case.preform(), case.fabric()))
    return forming.figures(forming.solve())


def on_all_and_alone(shared_folder, text):
    path = shared_folder / "case.toml"
    on_root(COMM, lambda: path.write_text(text))
    return figures(COMM, path), figures(MPI.COMM_SELF, path)


def test_drape(tmp_path):
    """Coefficient and folds of a seeded run repeat to 1e-6 on any number of ranks."""
    folder = COMM.bcast(tmp_path)
    together, alone = on_all_and_alone(
        folder, draped(outline=SMALL, more="results = 1\nimperfection = { seed = 3 }")
    )
    one, other = together["drape"], alone["drape"]
    assert one["folds"] == other["folds"] > 0
    for key in ("coefficients_percent", "drop_mm", "fold_crests_mm", "fold_angles_deg"):
        np.testing.assert_allclose(one[key], other[key], rtol=1e-6)


def test_cross_under_load(tmp_path):
    """One crossover is held in the middle, wherever it is: strains and tensions agree."""
    cloth = {"warp": YARN | {"poisson": 0.1}, "weft": YARN, "shear": {"modulus": "5 N/cm"}}
    cross = Preform.shape({"cross": ["90 mm", "30 mm"], "arm_slits": 2}, "0 deg",
                          origin=("1.25 mm", "46.25 mm"), refine=2)  # fmt: skip
    curves = []
    for comm in (COMM, MPI.COMM_SELF):
        network = Network(comm, cross, Fabric.from_table("cloth", cloth))
        test = BiaxialLoad(network, "2 N/cm", ratio=0.5, pretension="0.5 N/cm")
        curves.append(test.solve().curve(states=True))
    for name, values in curves[1].items():
        np.testing.assert_allclose(curves[0][name], values, rtol=1e-6, atol=1e-6, err_msg=name)


def test_inflation(tmp_path):
    """Form, rise, volume and tensions, to what equilibrium is solved to."""
    folder = COMM.bcast(tmp_path)
    test = (
        'corners = ["0 mm", "30 mm", "0 mm", "30 mm"]\npretension = ["6 N/cm", "9 N/cm"]\n'
        'pressure = "1 kPa"'
    )
    together, alone = on_all_and_alone(folder, blown(test))
    one, other = together["inflation"], alone["inflation"]
    assert one["force_densities"] == pytest.approx(other["force_densities"], rel=1e-9)
    for key, values in other.items():
        if key not in ("force_densities", "fall_mm"):
            np.testing.assert_allclose(one[key], values, rtol=1e-6, err_msg=key)
