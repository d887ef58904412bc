# SPDX-License-Identifier: MIT
"""Loads beside closed forms: the frame's is exact, the bias test's that of stiff yarns, H = 2 W."""

from dataclasses import replace

import numpy as np
import pytest
from mpi4py import MPI
from support.helpers import TABLE_1, diagonals

from cruciform_petsc import (
    BiasExtension,
    Biaxial,
    InputError,
    Network,
    OffAxisTension,
    PictureFrame,
    Preform,
)
from cruciform_petsc.experiments.biaxial import BiaxialTable
from cruciform_petsc.experiments.net_kinematics import net_angle, net_load, net_torque
from cruciform_petsc.laws import odd_polynomial

LAW = odd_polynomial([5.0, 20.0])
CLOTH = TABLE_1.with_shear_law(LAW)
STIFF = replace(
    TABLE_1.with_shear_law(odd_polynomial([10.0])),
    warp=replace(TABLE_1.warp, modulus=1e7, poisson=0.0),
    weft=replace(TABLE_1.weft, modulus=1e7, poisson=0.0),
)


def test_torques_where_a_test_goes_back_and_beyond_the_net():
    """They are those of the way up; a straight law comes back exactly."""
    d = 1e-3 * np.array([0.0, 5, 10, 20, 15, 10, 25, 45])  # the last beyond the net's reach
    g = net_angle(d, 0.1)
    load = net_load(g, lambda angle: 20.0 * angle, 0.1, 0.2)
    found = net_torque(g, load, 0.1, 0.2)
    up = [1, 2, 3, 6]
    np.testing.assert_allclose(found[up], 20.0 * g[up], rtol=1e-12)
    assert np.isnan(np.delete(found, up)).all()


@pytest.mark.parametrize("size", [("40 mm", "40 mm"), ("30 mm", "50 mm")])
def test_a_uniform_frame_gives_the_law(size):
    """The shear force of a frame is psi'/cos(gamma), whatever its sides."""
    network = Network(MPI.COMM_SELF, Preform.rectangle(*size, "0 deg"), CLOTH)
    result = PictureFrame(network, ["20 deg", "50 deg"], bending=False).solve()
    curve = result.curve()
    angle = np.deg2rad(curve["angle_deg"])
    expected = 1e-3 * LAW.evaluate(angle)[1] / np.cos(angle)
    np.testing.assert_allclose(curve["shear_force_N_per_mm"], expected, rtol=1e-6)
    np.testing.assert_allclose(curve["load_N"], curve["load_net_N"], rtol=1e-6)
    told = result.experiment.figures(result)["closed_form"]
    assert told["load_ratio"] == pytest.approx(1.0, rel=1e-6)
    assert "shear_deg" not in told
    assert "+0.0 %" in told["sentence"]


def test_stiff_yarns_on_a_strip_of_two_to_one():
    """Load, angle and shear force of the closed form, to the pitch; the zone is uniform."""
    network = Network(MPI.COMM_SELF, diagonals(8, 16), STIFF)
    pull = 0.25 * float(network.preform.size[0])
    result = BiasExtension(network, extension=pull, bending=False, increments=6).solve()
    curve = result.curve()
    angle = np.deg2rad(curve["shear_net_deg"])
    assert curve["shear_net_deg"][-1] == pytest.approx(34.2, abs=0.1)
    np.testing.assert_allclose(curve["load_N"], curve["load_net_N"], rtol=5e-3)
    force = 1e-3 * 10.0 * angle / np.cos(angle)
    np.testing.assert_allclose(curve["shear_force_N_per_mm"], force, rtol=5e-3)
    told = result.experiment.figures(result)["closed_form"]
    assert told["middle_95_deg"] - told["middle_5_deg"] < 0.5
    assert told["shear_deg"] == curve["shear_net_deg"][-1]
    assert "not uniform" not in told["sentence"]


def test_a_long_strip_is_not_uniform():
    """And the sentence says so, with the angle at the centre."""
    network = Network(MPI.COMM_SELF, diagonals(6, 18), STIFF)
    pull = 0.5 * float(network.preform.size[0])
    result = BiasExtension(network, extension=pull, bending=False).solve()
    told = result.experiment.figures(result)["closed_form"]
    assert told["middle_95_deg"] - told["middle_5_deg"] > 5.0
    centre = f"{np.rad2deg(result.shear_angle_centre):.2f} deg where a camera looks"
    assert "as with H > 2 W, is not uniform" in told["sentence"]
    assert centre in told["sentence"]


@pytest.mark.parametrize(
    ("kind", "outline", "keys", "has"),
    [
        (BiasExtension, (4, 8), {"finite": True}, True),
        (OffAxisTension, (4, 8), {"finite": True}, True),
        (BiasExtension, (4, 8), {"finite": False}, False),
        (BiasExtension, (4, 6), {"finite": True}, False),
        (BiasExtension, (4, 8), {"upper": "centre-line"}, False),
        (OffAxisTension, (4, 8), {"ends": "free"}, False),
    ],
)
def test_where_it_holds(kind, outline, keys, has):
    network = Network(MPI.COMM_SELF, diagonals(*outline), CLOTH)
    experiment = kind(network, extension="0.5 mm", **keys)
    result = experiment.solve()
    for states in (True, False):
        assert ("load_net_N" in result.curve(states)) == has
    assert ("closed_form" in experiment.figures(result)) == has


@pytest.mark.parametrize("angles", [["20 deg", "40 deg"], ["-30 deg"]], ids=["closing", "opening"])
@pytest.mark.parametrize(
    ("bias", "more"),
    [("0 deg", {}), ("90 deg", {}), ("0 deg", {"space": True})],
    ids=["0", "90", "in space"],
)
def test_a_frame_under_tension(angles, bias, more):
    """Yarns have n - psi' tan(gamma), to the solver's tolerance; the load is as without tension.

    Of that of the cloth that is in the frame, which is smaller without tension.
    """
    warp, weft = (replace(yarns, out_of_plane_bending=1e-3) for yarns in (STIFF.warp, STIFF.weft))
    warp, weft = replace(warp, modulus=1e4), replace(weft, modulus=2e4)
    fabric = replace(CLOTH, warp=warp, weft=weft)
    network = Network(MPI.COMM_SELF, Preform.rectangle("30 mm", "50 mm", bias), fabric)
    test = PictureFrame(network, angles, pretension=["5 N/cm", "8 N/cm"], **more)
    curve = test.solve().curve(states=True)
    gamma = np.deg2rad(curve["angle_deg"])
    torque = LAW.evaluate(gamma)[1] / np.prod(test.prestretch)
    assert np.prod(test.prestretch) == pytest.approx(1.05 * 1.04, rel=0.01)
    for family, start in (("warp", 500.0), ("weft", 800.0)):
        tension = 100.0 * curve[f"tension_{family}_N_per_cm"]
        np.testing.assert_allclose(tension, start - torque * np.tan(gamma), rtol=1e-6)
        closed = 100.0 * curve[f"tension_{family}_net_N_per_cm"]
        np.testing.assert_allclose(closed, tension, rtol=1e-6)
    np.testing.assert_allclose(curve["load_N"], curve["load_net_N"], rtol=1e-6)


def test_biaxial_test_under_tension():
    """Tension begins at the pretension and goes on by the law, over the width as it is drawn."""
    fabric = replace(STIFF, warp=replace(STIFF.warp, modulus=1e4), weft=STIFF.weft)
    fabric = replace(fabric, weft=replace(STIFF.weft, modulus=2e4))
    network = Network(MPI.COMM_SELF, Preform.rectangle("30 mm", "50 mm", "0 deg"), fabric)
    test = Biaxial(network, ["1e-9 %", "2 %"], ratio=0.5, pretension="5 N/cm")
    curve = test.solve().curve(states=True)
    warp, weft = np.array(test.prestretch)[:, None] * [[1.0, 1.02], [1.0, 1.01]]
    expected = 1e4 * (warp - 1.0) / test.prestretch[1]
    np.testing.assert_allclose(100.0 * curve["tension_warp_N_per_cm"], expected, rtol=1e-6)
    expected = 2e4 * (weft - 1.0) / test.prestretch[0]
    np.testing.assert_allclose(100.0 * curve["tension_weft_N_per_cm"], expected, rtol=1e-6)
    assert curve["tension_warp_N_per_cm"][0] == pytest.approx(5.0, rel=1e-6)


def test_what_no_pretension_is():
    network = Network(MPI.COMM_SELF, Preform.rectangle("30 mm", "50 mm", "0 deg"), STIFF)
    with pytest.raises(InputError, match="pretension needs finite = true"):
        PictureFrame(network, "1 deg", pretension="5 N/cm", finite=False)
    with pytest.raises(InputError, match=r'test.pretension is not for model = "truss"'):
        PictureFrame(network, "1 deg", pretension="5 N/cm", model="truss")
    soft = replace(STIFF, warp=replace(STIFF.warp, modulus=1e3))
    network = Network(MPI.COMM_SELF, Preform.rectangle("30 mm", "50 mm", "0 deg"), soft)
    with pytest.raises(InputError, match="test.pretension: a pretension of 5 N/cm of the warp"):
        PictureFrame(network, "1 deg", pretension="5 N/cm")
    table = {"kind": "biaxial", "strain": "1 %", "pretension": "5 N/cm", "model": "truss"}
    with pytest.raises(InputError, match="truss.* takes no test.pretension"):  # before it is run
        BiaxialTable.model_validate(table).check(network.preform, STIFF)
