# SPDX-License-Identifier: MIT
"""Kilby's relation: from three strips to all angles and back, against cloth and nets; bad input."""

from dataclasses import asdict, replace

import numpy as np
import pytest
from mpi4py import MPI
from support.helpers import TABLE_1

from cruciform_petsc.calibration import Kilby
from cruciform_petsc.cloth.preform import Preform
from cruciform_petsc.errors import InputError
from cruciform_petsc.experiments.off_axis import OffAxisTension
from cruciform_petsc.net.network import Network

UNEVEN = replace(
    TABLE_1,
    warp=replace(TABLE_1.warp, modulus=60e3, poisson=0.6),
    weft=replace(TABLE_1.weft, modulus=25e3, poisson=0.25),
    shear_modulus=6000.0,
)


@pytest.mark.parametrize("degrees", [10.0, 30.0, 45.0, 70.0, 135.0])
def test_there_and_back(degrees):
    """Three strips of a cloth give its moduli at every angle and its shear modulus back."""
    three = (UNEVEN.off_axis_modulus(np.deg2rad(at)) for at in (0.0, 90.0, degrees))
    found = Kilby.from_strips(*three, f"{degrees} deg", 0.6)
    every = np.deg2rad(np.arange(0.0, 180.0, 7.0))
    np.testing.assert_allclose(found.modulus(every), UNEVEN.off_axis_modulus(every), rtol=1e-11)
    assert found.shear_modulus == pytest.approx(6000.0, rel=1e-11)
    assert asdict(found) == pytest.approx(asdict(Kilby.of(UNEVEN)), rel=1e-10)


def test_an_isotropic_sheet():
    """The same at all angles, and G = E/(2 (1 + nu)): what no woven cloth is."""
    found = Kilby.from_strips(7e3, 7e3, 7e3, poisson=0.3)
    assert found.shear_modulus == pytest.approx(7e3 / 2.6, rel=1e-12)
    np.testing.assert_allclose(found.modulus(np.linspace(0.0, np.pi, 9)), 7e3, rtol=1e-12)


def test_error_of_the_shear_modulus():
    """It is the derivative of what is found by what is measured."""
    at, step = np.deg2rad(30.0), 1e-5
    found = Kilby.from_strips(60e3, 25e3, 15e3, at, 0.6)
    more = Kilby.from_strips(60e3, 25e3, 15e3 * (1.0 + step), at, 0.6)
    slope = (more.shear_modulus / found.shear_modulus - 1.0) / step
    assert slope == pytest.approx(found.error_of_shear(at, 1.0), rel=1e-4)  # of first order in it


def test_strips_of_nets():
    """Three nets as strips with free ends foretell a fourth, and give their cloth's shear modulus.

    To 4 %: a band along the sides that were cut across yarns, a pitch wide, is too soft
    (test_finite.test_off_axis_modulus); half the pitch leaves half of it.
    """
    errors = []
    for refine in (1, 2):
        measured = {}
        for degrees in (0, 90, 45, 60):
            strip = Preform.rectangle(0.03, 0.09, f"{degrees} deg", refine=refine)
            net = Network(MPI.COMM_SELF, strip, UNEVEN)
            test = OffAxisTension(net, 1e-6, ends="free", finite=True, bending=False)
            measured[degrees] = 100.0 * test.figures(test.solve())["modulus_n_per_cm"]
        found = Kilby.from_strips(measured[0], measured[90], measured[45], poisson=0.6)
        errors.append(found.shear_modulus / 6000.0 - 1.0)
        fourth = found.modulus(np.deg2rad(60.0)) / measured[60] - 1.0
    assert abs(errors[1]) < 0.04  # 8.3, 3.6 %
    assert errors[0] / errors[1] == pytest.approx(2.0, abs=0.4)
    assert abs(fourth) < 0.05  # 4.1 %: the fourth strip's own softness
    assert found.warp == pytest.approx(60e3, rel=1e-6)
    assert found.weft == pytest.approx(25e3, rel=1e-6)


@pytest.mark.parametrize(
    ("three", "options", "message"),
    [
        ((1.0, 1.0, "3 m"), {}, 'modulus of the third strip = "3 m" has the unit'),
        ((0.0, 1.0, 1.0), {}, "modulus of the warp must be positive"),
        ((1e4, 1e4, 1e3), {"angle": "3 deg"}, "at least 5 deg from warp and weft, got 3 deg"),
        ((1e4, 1e4, 1e3), {"angle": float("nan")}, "must be finite, got nan"),
        ((1e4, 4e4, 1e3), {"poisson": 0.6}, "must be below E_warp/E_weft = 0.25"),
        ((1e4, 1e4, 3e4), {}, r"is stiffer than these yarns .* \(200 N/cm at most\)"),
    ],
)
def test_bad_input(three, options, message):
    with pytest.raises(InputError, match=message):
        Kilby.from_strips(*three, **options)
