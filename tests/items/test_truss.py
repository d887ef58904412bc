# SPDX-License-Identifier: MIT
"""A ply as a truss: areas, and the same tests beside those of cruciforms."""

import tomllib

import numpy as np
import pytest
from mpi4py import MPI
from support.forming import CASE
from support.helpers import DIAGONAL, TABLE_1, UNEVEN, diagonals, l_shape

from cruciform_petsc import BiasExtension, Case, Network, OffAxisTension, PictureFrame, Preform
from cruciform_petsc.items.truss import TrussPly
from cruciform_petsc.net.edges import Constraints

COMM = MPI.COMM_SELF
OUTLINES = {
    "along": Preform.rectangle(0.05, 0.03, 0.0),
    "diagonals": diagonals(4, 8),
    "askew": Preform.rectangle(0.04, 0.06, 0.5),
    "L": l_shape(0.06, 0.0),
}


@pytest.mark.parametrize("name", OUTLINES)
def test_areas(name):
    """Bars and diagonals stand for the cloth's area, but for bits at corners."""
    network = Network(COMM, OUTLINES[name], UNEVEN)
    constraints = Constraints(network, False, floats=True)
    ply = TrussPly(constraints, (1e-3, 1e-3), False)
    whole = network.quadrant_area[ply.supports.carrying].sum()
    # At corners and along edges across the yarns some quadrant has neither bar.
    assert ply.truss.area.sum() == pytest.approx(whole, rel=0.02)
    for at_hinge in (0.0, 1 / 3):
        total = network.quadrant_area.sum()
        assert ply.areas(at_hinge).sum() == pytest.approx(total, rel=1e-9)
    assert not ply.active[ply.between].any()


def test_picture_frame():
    """Uniform shear, crossovers on the frame: the closed form's loads, as of cruciforms."""
    pitch = 1 / np.array([UNEVEN.warp.yarns, UNEVEN.weft.yarns])
    network = Network(COMM, Preform.rectangle(*(8 * pitch), 0.0), UNEVEN)
    one, two = (
        PictureFrame(network, ["10 deg", "40 deg"], model=model, bending=False).solve()
        for model in ("coupled", "truss")
    )
    np.testing.assert_allclose(two.loads, one.loads, rtol=1e-8)
    np.testing.assert_allclose(two.curve()["load_net_N"], two.curve()["load_N"], rtol=1e-8)
    for mode, energy in one.energies().items():
        np.testing.assert_allclose(two.energies()[mode], energy, atol=1e-8 * one.loads[-1])


def test_bias_extension():
    """Both are nets that shear and hardly stretch: the loads differ by 2 % at most."""
    network = Network(COMM, diagonals(8, 16), TABLE_1)
    far = 0.15 * 16 * DIAGONAL
    one, two = (
        BiasExtension(network, far, model=model, bending=False).solve()
        for model in ("coupled", "truss")
    )
    assert two.load == pytest.approx(one.load, rel=0.02)
    assert two.shear_angle_centre == pytest.approx(one.shear_angle_centre, rel=0.01)
    assert two.experiment.bending is False
    assert two.energies()["bending"][-1] == 0.0


def test_pulled_along_the_warp():
    """E_w per width, whatever Poisson's ratio is: bars do not couple.

    Diagonals are stretched, too, and take up to G/E, here 0.23 %, of the load.
    """
    pitch = 1 / np.array([UNEVEN.warp.yarns, UNEVEN.weft.yarns])
    width, length = 4 * pitch[0], 8 * pitch[1]
    network = Network(COMM, Preform.rectangle(width, length, 0.0), UNEVEN)
    result = OffAxisTension(network, 1e-3 * length, model="truss").solve()
    assert result.load == pytest.approx(60e3 * 1e-3 * width, rel=140 / 60e3)


def test_forming():
    """A cup: nearly the shear of cruciforms, forces in balance, and no bending."""
    found = []
    for model in ("coupled", "truss"):
        data = tomllib.loads(CASE)
        data["test"]["model"] = model
        case = Case.from_data(data)
        step = case.forming(Network(COMM, case.preform(), case.fabric())).solve().steps[-1]
        total = sum(step.tool_force.values())
        assert np.linalg.norm(total) < 1e-2 * abs(step.tool_force["punch"][2])
        found.append(step.increment)
    one, two = found
    assert two.shear_max == pytest.approx(one.shear_max, rel=0.2)
    assert "bending" in one.energies
    assert "bending" not in two.energies
