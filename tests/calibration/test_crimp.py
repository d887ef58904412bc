# SPDX-License-Identifier: MIT
"""A crimp model from tensions: what made them is found again, what they do not tell is told."""

import json
import logging
import tomllib
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from mpi4py import MPI
from support.biaxial import CRIMP, grid, linear_law, points_of
from support.helpers import TABLE_1, UNEVEN

from cruciform_petsc import Case, InputError
from cruciform_petsc.calibrate import calibrate_case
from cruciform_petsc.calibration.crimp import fit_crimp
from cruciform_petsc.calibration.load_curve import _with_twice
from cruciform_petsc.cloth.crimp import Crimp
from cruciform_petsc.cloth.fabric import FabricTable
from cruciform_petsc.cloth.surface import fit_surface
from cruciform_petsc.laws import linear, table

DEMOS = Path(__file__).parents[2] / "demos"
RATIOS = ((1.0, 1.0), (1.0, 0.5), (0.5, 1.0), (1.0, 0.0), (0.0, 1.0))
RAYS = np.concatenate([np.linspace(0.001, 0.01, 10)[:, None] * ratio for ratio in RATIOS])
START = replace(CRIMP, stiffness=(2000.0, 4000.0), contact=linear(2e6))
LOG = logging.getLogger("quiet")


@pytest.mark.parametrize("heights", [False, True])
def test_what_made_the_tensions_is_found(heights):
    """From a start 36 or 20 % off."""
    start = replace(START, height=(0.15e-3, 0.2e-3)) if heights else START
    found = fit_crimp(points_of(CRIMP.law, RAYS), start, heights)
    assert found.start_misfit > 0.2
    assert found.misfit < 1e-6
    assert found.crimp.stiffness == pytest.approx(CRIMP.stiffness, rel=1e-5)
    assert found.crimp.height == pytest.approx(CRIMP.height, rel=1e-5)
    assert found.crimp.contact.stiffness0 == pytest.approx(8e6, rel=1e-3)
    assert found.unknown == []


def test_a_table_keeps_its_shape():
    """The force at a crossover is so many times the start's."""
    contact = table([0.5e-5, 1.5e-5], [4.0, 40.0])
    points = points_of(replace(CRIMP, contact=contact).law, RAYS)
    found = fit_crimp(points, replace(START, contact=contact.times(3.0)))
    x = np.array([0.25e-5, 1e-5, 2e-5])
    expected = contact.evaluate(x)[1]
    np.testing.assert_allclose(found.crimp.contact.evaluate(x)[1], expected, rtol=1e-3)


def test_scatter():
    """With 2 % of scatter the yarns are known to 1 %, within their standard errors; how they
    flatten, which is of little account here, is not.
    """
    points = points_of(CRIMP.law, RAYS)
    points[:, 2:] *= 1.0 + 0.02 * np.random.default_rng(0).normal(size=(len(points), 2))
    found = fit_crimp(points, START)
    assert 0.015 < found.misfit < 0.022
    for k, name in enumerate(("warp_stiffness", "weft_stiffness")):
        error = found.errors[name]
        assert error < 0.015
        assert found.crimp.stiffness[k] == pytest.approx(CRIMP.stiffness[k], rel=3 * error)
    assert found.unknown == ["crossover"]


def test_table_1_of_the_paper():
    """A published law of both tensions, [1] with Poisson's ratio 0.45, to 1 % of strain.

    A surface is that law; the crimp model, in which coupling goes with softness, comes within 5 %.
    """
    law = linear_law(TABLE_1.c11, TABLE_1.c22, TABLE_1.c12)
    points = points_of(law, grid(0.0, 0.01, 6))
    assert fit_surface(points).misfit < 1e-8
    pitch = (TABLE_1.weft.spacing, TABLE_1.warp.spacing)
    start = Crimp(pitch, (0.3e-3, 0.3e-3), (220.0, 220.0), (1e-9, 1e-9), linear(4e5))
    found = fit_crimp(points, start, heights=True)
    assert found.misfit == pytest.approx(0.042, abs=0.003)


def test_assumptions_of_a_shear_law():
    """That which a shear law is found with, twice: tensions of a cloth with a law of both."""
    fabric = UNEVEN.with_biaxial_law(CRIMP.law)
    twice = _with_twice(fabric, "tension modulus")
    assert twice.tension([1.01, 1.0])[1] == pytest.approx(2.0 * fabric.tension([1.01, 1.0])[1])
    assert (twice.c11, twice.c12) == pytest.approx((2.0 * fabric.c11, 2.0 * fabric.c12))
    for what in ("yarn bending", "compression"):
        assert _with_twice(replace(fabric, compression=0.1), what).biaxial_law == CRIMP.law


def test_too_few_points():
    """Three values from one test, or none."""
    with pytest.raises(InputError, match="at least two ratios"):
        fit_crimp(points_of(CRIMP.law, RAYS[:10]), START)
    with pytest.raises(InputError, match="at least 6 points"):
        fit_crimp(points_of(CRIMP.law, RAYS[:5]), START)


def test_the_demo(tmp_path):
    """Through the program: law, residuals, picture; the law is one for a case file."""
    case = Case.load(DEMOS / "calibrate_crimp.toml")
    data = DEMOS / "biaxial_surface.csv"
    told = calibrate_case(MPI.COMM_SELF, case, data, tmp_path, LOG)
    assert told["rms_relative_error"] == pytest.approx(0.0213, abs=1e-3)
    assert told == json.loads((tmp_path / "calibration.json").read_text())
    law = tomllib.loads((tmp_path / "law.toml").read_text())["fabric"]
    yarns = {"warp": {"yarns": "4 /cm"}, "weft": {"yarns": "5 /cm"}, "shear": {"modulus": "1 N/cm"}}
    fabric = FabricTable.from_data(yarns | law, "fabric").build("found")
    # 2600 N made the points, before they were scattered by 2 %.
    assert fabric.biaxial_law.data[5:7] == pytest.approx((2600.0, 2600.0), rel=0.02)
    columns = np.genfromtxt(tmp_path / "calibration.csv", delimiter=",", names=True)
    left = columns["warp_tension_fit_N_per_cm"] - columns["warp_tension_measured_N_per_cm"]
    np.testing.assert_allclose(columns["warp_tension_residual_N_per_cm"], left, atol=1e-6)
    assert (tmp_path / "calibration.png").stat().st_size > 20_000


def test_wrong_cases(tmp_path):
    """What there is nothing to start from, and options of the shear law."""
    case, data = Case.load(DEMOS / "biaxial.toml"), DEMOS / "biaxial_surface.csv"
    with pytest.raises(InputError, match=r"fabric\.tension\.crimp is missing, which has the crimp"):
        calibrate_case(MPI.COMM_SELF, case, data, tmp_path, LOG)
    case = Case.load(DEMOS / "calibrate_crimp.toml")
    with pytest.raises(InputError, match="leave out --also, --hold-out, --weights and --columns"):
        calibrate_case(MPI.COMM_SELF, case, data, tmp_path, LOG, weights=[1.0])
    with pytest.raises(InputError, match=r'surface of tension ".*nowhere\.csv" does not exist'):
        calibrate_case(MPI.COMM_SELF, case, tmp_path / "nowhere.csv", tmp_path, LOG)
