# SPDX-License-Identifier: MIT
"""Shear laws from load curves: laws that are known come back; what is not known is told."""

import io
import json
import logging
import tomllib
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
import pytest
from matplotlib.figure import Figure
from mpi4py import MPI

from cruciform_petsc.calibrate import calibrate_case
from cruciform_petsc.calibration import (
    MeasuredCurve,
    Specimen,
    calibrate,
    calibrate_together,
    predict,
    read_curve,
)
from cruciform_petsc.calibration.formula import (
    frame_angle,
    torque_from_frame,
    torque_from_loads,
)
from cruciform_petsc.calibration.load_curve import LoadCurve
from cruciform_petsc.calibration.rising import value_changes
from cruciform_petsc.calibration.specimen import formula_gap
from cruciform_petsc.case.schema import Case
from cruciform_petsc.cloth.fabric import Fabric
from cruciform_petsc.cloth.preform import Preform
from cruciform_petsc.errors import EquilibriumError, InputError
from cruciform_petsc.experiments import net_kinematics
from cruciform_petsc.experiments.net_kinematics import net_angle
from cruciform_petsc.laws import linear, odd_polynomial, table
from cruciform_petsc.net.network import Network
from cruciform_petsc.output.calibration import figure, write_so_far

DEMOS = Path(__file__).parents[2] / "demos"
GLASS_PP = Fabric.from_library("glass-pp-plain-1.93")
# The cloth before anything is known of its shear.
UNKNOWN = replace(GLASS_PP, shear_law=None, shear_modulus=7.5)
DISPLACEMENT = 1e-3 * np.array([1.5, 3, 6, 9, 12, 15, 18, 21, 24, 27, 30, 33])
RISING = odd_polynomial([5.0, 20.0])
LOG = logging.getLogger("test_calibrate")


def net_load(angle: np.ndarray, law, width: float, length: float) -> np.ndarray:
    """Force of a net that follows `law` (Potential), N."""
    return net_kinematics.net_load(angle, lambda g: law.evaluate(g)[1], width, length)


def specimen(lumped=3, size=("100 mm", "200 mm"), angle="45 deg", fabric=UNKNOWN):
    """A small network, so that a load curve takes a fraction of a second."""
    preform = Preform.rectangle(*size, angle, yarns_per_cruciform=lumped)
    return Network(MPI.COMM_SELF, preform, fabric)


def curve_of(network, displacement, **test):
    """Loads that a network would have."""
    measured = MeasuredCurve(np.asarray(displacement), np.ones(len(displacement)), 0)
    return LoadCurve(Specimen(network, measured, **test))


def loads_of(network, law, displacement=DISPLACEMENT, **test):
    curve = curve_of(network, displacement, **test)
    try:
        return curve.solve(law).loads
    finally:
        curve.destroy()


HEAD = "displacement [mm], force [N]\n"


# -- the closed formula ------------------------------------------------------------------------


@pytest.mark.parametrize("ratio", [2.0, 3.0])
@pytest.mark.parametrize("law", [linear(20.0), RISING], ids=["linear", "polynomial"])
def test_formula_is_the_work_of_the_zones(ratio, law):
    """Force from differences of the zones' energy, with their areas from geometry."""
    width = 0.1
    length = ratio * width
    middle, side = width * (2 * length - 3 * width) / 2, width**2
    # Areas: two triangles at each clamp make up the rest.
    assert middle + side + width**2 / 2 == pytest.approx(width * length, rel=1e-14)

    def energy(d):
        g = net_angle(d, length - width)
        return middle * law.evaluate(g)[0] + side * law.evaluate(0.5 * g)[0]

    d = np.linspace(0.001, 0.35 * (length - width), 7)
    force = (energy(d + 1e-7) - energy(d - 1e-7)) / 2e-7
    np.testing.assert_allclose(
        net_load(net_angle(d, length - width), law, width, length), force, 1e-6
    )


def test_formula_backwards():
    """Exact for a straight line; for a curved law to its bend between measured points."""
    d = np.linspace(0.0005, 0.038, 60)
    g = net_angle(d, 0.1)
    for law, tolerance in ((linear(20.0), 1e-10), (RISING, 1e-3)):
        angle, torque = torque_from_loads(d, net_load(g, law, 0.1, 0.2), 0.1, 0.2)
        inside = g < np.deg2rad(75)
        np.testing.assert_allclose(angle, g[inside], rtol=1e-14)
        np.testing.assert_allclose(torque, law.evaluate(angle)[1], rtol=tolerance)


# -- derivatives -------------------------------------------------------------------------------


def test_derivatives_of_the_loads():
    """Against differences of loads of two laws, by each value of the table."""
    angles, values = np.deg2rad([3.0, 10.0, 20.0, 35.0]), np.array([3.0, 4.0, 7.0, 12.0])
    displacement = [0.004, 0.012, 0.022]
    network = specimen()
    curve = curve_of(network, displacement)
    try:
        found = curve.solve(table(angles, values))
        exact = curve.derivatives(found, partial(value_changes, angles, values))
        for k in range(4):
            h = 1e-4 * np.eye(4)[k] * values[k]
            up, down = (
                curve.solve(table(angles, values + h), found).loads,
                curve.solve(table(angles, values - h), found).loads,
            )
            # Newton stops at 1e-8 of the clamps' forces, differences are 1e-4 of them.
            np.testing.assert_allclose(
                (up - down) / (2 * h[k]), exact[:, k], atol=1e-3 * abs(exact).max() * 0.1
            )
    finally:
        curve.destroy()


# -- known laws --------------------------------------------------------------------------------


def test_a_straight_line_comes_back():
    """It costs no smoothing and is within the tables, so nothing but iterations errs."""
    network = specimen()
    found = calibrate(network, DISPLACEMENT, loads_of(network, linear(20.0)))
    assert found.start_from == "closed formula"
    assert found.rms < 1e-4
    np.testing.assert_allclose(found.values, 20.0 * found.angles, rtol=1e-3)
    assert found.determined.all()
    assert found.fabric.shear == found.law


def test_a_stiffening_law_comes_back():
    """A polynomial is no table, and smoothing bends it: 2 % inside, more at the open end."""
    network = specimen()
    found = calibrate(network, DISPLACEMENT, loads_of(network, RISING))
    true = RISING.evaluate(found.angles)[1]
    np.testing.assert_allclose(found.values[:-1], true[:-1], rtol=0.02)
    assert found.rms < 0.005 < found.start_rms


def test_friction_and_locking():
    """A steep beginning, a plateau and a climb, with less smoothing as the data are exact."""
    law = table(np.deg2rad([3, 10, 20, 30, 40, 50]), [4.0, 5.0, 7.0, 12.0, 25.0, 60.0])
    network = specimen()
    found = calibrate(network, DISPLACEMENT, loads_of(network, law), smoothing=0.05)
    true = law.evaluate(found.angles)[1]
    # The kinks at 3 and 10 degrees fall between knots at 2, 4, 7, 11.
    np.testing.assert_allclose(found.values[:-1], true[:-1], rtol=0.1)
    np.testing.assert_allclose(found.values[3:-1], true[3:-1], rtol=0.02)
    assert found.rms < 0.015


def test_noise():
    """With 3 % of noise the law is off by a few per cent, as the standard errors say."""
    network = specimen()
    noise = 1.0 + 0.03 * np.random.default_rng(5).standard_normal(len(DISPLACEMENT))
    found = calibrate(network, DISPLACEMENT, noise * loads_of(network, RISING))
    off = found.values - RISING.evaluate(found.angles)[1]
    assert 0.01 < found.estimate.noise < 0.06
    assert found.rms < 0.045
    assert (np.abs(off) < 4.0 * found.standard_errors).all()
    assert (found.standard_errors[found.determined] < 0.2 * found.values[found.determined]).all()


def test_another_cut_starts_from_a_straight_line():
    """At 40 degrees there is no closed formula."""
    network = specimen(angle="40 deg")
    found = calibrate(network, DISPLACEMENT[:9], loads_of(network, RISING, DISPLACEMENT[:9]))
    assert found.start_from == "straight line"
    np.testing.assert_allclose(found.values[:-1], RISING.evaluate(found.angles[:-1])[1], rtol=0.03)


def test_half_a_specimen():
    """Its clamp moves half as far under the same load, and it starts from the same law."""
    d = DISPLACEMENT[:9]
    half = specimen(size=("100 mm", "100 mm"))
    loads = loads_of(half, RISING, 0.5 * d, upper="centre-line")
    found = calibrate(half, 0.5 * d, loads, upper="centre-line")
    assert found.start_from == "closed formula"
    np.testing.assert_allclose(found.values[:-1], RISING.evaluate(found.angles[:-1])[1], rtol=0.03)


def test_standard_error_in_closed_form():
    """Two curves of one frame, 5 % above and below a law: each value stands by itself.

    A frame gives the law at its angle, so with f = F0/a and F0/b the least sum is at F/F0 =
    (a + b)/(a^2 + b^2); the relative variance of a value is SSR/(n - m) over the sum of (F/f)^2.
    """
    square, m = frame(), len(FRAME)
    loads = loads_of(square, RISING, FRAME, kind="picture-frame")
    curves = [MeasuredCurve.from_points(FRAME, factor * loads) for factor in (1.05, 0.95)]
    found = calibrate_together(
        [Specimen(square, curve, "picture-frame") for curve in curves],
        angles=frame_angle(FRAME, (0.1, 0.1)),
        smoothing=1e-4,
    )
    a, b = 1 / 1.05, 1 / 0.95
    level = (a + b) / (a**2 + b**2)
    true = RISING.evaluate(found.angles)[1]
    np.testing.assert_allclose(found.values, level * true, rtol=1e-4)
    squares = m * ((level * a - 1.0) ** 2 + (level * b - 1.0) ** 2)
    noise = np.sqrt(squares / (2 * m - m))
    assert found.estimate.settled == pytest.approx(m, rel=1e-4)
    assert found.estimate.noise == pytest.approx(noise, rel=1e-3)
    error = noise / np.sqrt((level * a) ** 2 + (level * b) ** 2)
    np.testing.assert_allclose(found.standard_errors, error * found.values, rtol=1e-3)


@pytest.mark.parametrize("lost", [{2}, {2, 3}, set(range(2, 99))])
def test_steps_without_equilibrium(lost, monkeypatch):
    """A trial law that has none makes the step shorter; the fit is never worse than its start."""
    calls = []
    solve = LoadCurve.solve

    def failing(self, law, start=None):
        calls.append(law)
        if start is not None and len(calls) - 1 in lost:
            raise EquilibriumError("no equilibrium found", "MAX_IT", [])
        return solve(self, law, start)

    network = specimen()
    loads = loads_of(network, RISING)
    monkeypatch.setattr(LoadCurve, "solve", failing)
    found = calibrate(network, DISPLACEMENT, loads)
    if len(lost) < 10:
        assert found.rms < 0.005
    else:
        assert found.iterations == 0
        assert found.message == "the iterations were as many as are allowed"
        np.testing.assert_allclose(
            found.law.evaluate(found.angles)[1], calls[1].evaluate(found.angles)[1]
        )
    assert found.rms <= 1.001 * found.start_rms


def test_no_equilibrium_with_the_start(monkeypatch):
    """Told in a sentence, also if it is the rising table of the start that has none."""
    solve = LoadCurve.solve

    def failing(self, law, start=None):
        if start is not None:
            raise EquilibriumError("no equilibrium found", "MAX_IT", [])
        return solve(self, law, start)

    network = specimen()
    loads = loads_of(network, RISING)
    monkeypatch.setattr(LoadCurve, "solve", failing)
    with pytest.raises(InputError, match="has no equilibrium with the start for the law"):
        calibrate(network, DISPLACEMENT, loads)


# -- what the data do not determine ------------------------------------------------------------


def test_undetermined_part_is_told():
    """Beyond what the cloth reaches, and where no point was measured, no value is vouched for."""
    network = specimen()
    d = DISPLACEMENT[5:9]  # 15 to 24 mm
    angles = np.deg2rad([0.5, 1, 5, 10, 15, 20, 25, 35, 50, 70])
    found = calibrate(network, d, loads_of(network, RISING, d), angles=angles)
    reached = np.rad2deg(found.reached.max())
    assert 20 < reached < 35
    assert not found.determined[-2:].any()  # 50 and 70 degrees
    assert found.determined[5:7].all()  # 20 and 25, the middle of the specimen
    # Their singular values are next to nothing.
    assert (found.estimate.singular_values[-2:] < 1e-3 * found.estimate.singular_values[0]).all()
    assert found.estimate.settled < 5
    low, high = found.uncertain_ranges()[-1]
    assert np.rad2deg(low) <= reached + 1e-9
    assert high == np.inf
    assert any("extrapolated" in remark for remark in found.remarks())


def test_what_was_assumed_is_told():
    """Twice the yarn bending, and what that does to the law, against identifying it anew."""
    stiff = replace(UNKNOWN.warp, yarn_bending=2e-5), replace(UNKNOWN.weft, yarn_bending=2e-5)
    fabric = replace(UNKNOWN, warp=stiff[0], weft=stiff[1])
    network = specimen(fabric=fabric)
    loads = loads_of(network, RISING)
    found = calibrate(network, DISPLACEMENT, loads)
    twice = [replace(family, yarn_bending=4e-5) for family in stiff]
    other = specimen(fabric=replace(fabric, warp=twice[0], weft=twice[1]))
    told = found.assumptions["yarn bending"]
    np.testing.assert_allclose(
        loads_of(other, found.law) / found.loads - 1.0, told.loads, atol=1e-6
    )
    anew = calibrate(other, DISPLACEMENT, loads, angles=found.angles)
    # First order against all orders: half as much again.
    change = anew.values / found.values - 1.0
    np.testing.assert_allclose(told.values[:-1], change[:-1], atol=0.5 * abs(change).max())
    assert abs(change).max() > 0.05
    assert any("Twice the yarn bending" in remark for remark in found.remarks())


def test_place_of_the_yarns_is_told():
    """Loads of a network whose crossovers lie half a cell away, in another specimen's file."""
    network = specimen()
    found = calibrate(network, DISPLACEMENT[:8], loads_of(network, RISING, DISPLACEMENT[:8]))
    # At 45 degrees half a cell along both yarns is half a diagonal along the pull.
    origin = (0.0, 0.1 + network.pitch[0] / np.sqrt(2))
    preform = Preform.rectangle("100 mm", "200 mm", "45 deg", yarns_per_cruciform=3, origin=origin)
    moved = loads_of(Network(MPI.COMM_SELF, preform, UNKNOWN), found.law, DISPLACEMENT[:8])
    told = found.assumptions["place of the yarns"]
    np.testing.assert_allclose(moved / found.loads - 1.0, told.loads, atol=1e-6)
    assert abs(told.loads).max() > 0.02
    assert (found.dependent == (abs(told.values) > 0.2)).all()


# -- picture frame -----------------------------------------------------------------------------

FRAME = 1e-3 * np.array([3, 8, 14, 20, 26, 31, 35])  # of 100 mm sides: 5 to 67 degrees


def frame(size=("100 mm", "100 mm"), fabric=UNKNOWN):
    return specimen(4, size, "0 deg", fabric)


def test_formula_of_the_frame():
    """psi' = F sin(theta)/L of a square; of a rectangle from differences of the energy."""
    g, torque = torque_from_frame(FRAME, np.ones(len(FRAME)), (0.1, 0.1))
    np.testing.assert_allclose(torque, np.sin(0.5 * (0.5 * np.pi - g)) / 0.1, rtol=1e-12)
    sides = 0.1, 0.15
    step = [RISING.evaluate(frame_angle(FRAME + s * 1e-7, sides))[0] for s in (1, -1)]
    force = 0.1 * 0.15 * (step[0] - step[1]) / 2e-7
    g, torque = torque_from_frame(FRAME, force, sides)
    np.testing.assert_allclose(torque, RISING.evaluate(g)[1], rtol=1e-6)
    assert np.isnan(frame_angle([0.2], sides)).all()


@pytest.mark.parametrize("size", [("100 mm", "100 mm"), ("80 mm", "120 mm")])
def test_network_in_a_frame(size):
    """Shears uniformly, so the formula is the network's load; derivatives against differences."""
    network = frame(size)
    curve = curve_of(network, FRAME[::2], kind="picture-frame")
    try:
        angles, values = np.deg2rad([5.0, 20.0, 45.0, 70.0]), np.array([3.0, 5.0, 9.0, 20.0])
        law = table(angles, values)
        found = curve.solve(law)
        low_x, low_y, high_x, high_y = network.preform.outline.bounds
        g, torque = torque_from_frame(FRAME[::2], found.loads, (high_x - low_x, high_y - low_y))
        # Work of turning is a difference over 1e-5 of the angle.
        np.testing.assert_allclose(torque, law.evaluate(g)[1], rtol=1e-4)
        np.testing.assert_allclose(found.angles, g, rtol=1e-4)
        exact = curve.derivatives(found, partial(value_changes, angles, values))
        for k in range(4):
            h = 1e-3 * np.eye(4)[k] * values[k]
            up, down = (curve.solve(table(angles, values + s * h), found).loads for s in (1, -1))
            np.testing.assert_allclose(
                (up - down) / (2 * h[k]), exact[:, k], atol=1e-3 * abs(exact).max()
            )
    finally:
        curve.destroy()


def test_law_from_a_frame_predicts_a_bias_test():
    """The law comes back from the frame; loads of a strip are foretold with it."""
    network = frame()
    loads = loads_of(network, RISING, FRAME, kind="picture-frame")
    found = calibrate(network, FRAME, loads, kind="picture-frame")
    assert found.start_from == "closed formula"
    assert found.rms < 0.005
    assert found.determined.all()
    # Smoothing bends the law a little: 2 %, as with a strip.
    inside = found.angles > frame_angle(FRAME[0], (0.1, 0.1))
    true = RISING.evaluate(found.angles)[1]
    np.testing.assert_allclose(found.values[inside], true[inside], rtol=0.02)
    strip, d = specimen(4), DISPLACEMENT[2::2]
    assert predict(found, strip, d, loads_of(strip, RISING, d)).rms < 0.02
    # And the other way: the frame is foretold.
    assert predict(found, network, FRAME, loads, kind="picture-frame").rms == pytest.approx(
        found.rms, rel=1e-3
    )


def test_frame_of_a_case(tmp_path):
    """A picture-frame case with the curve that this program writes of such a test."""
    settings = ["preform.yarns_per_cruciform=5", "output.pictures=false"]
    case = Case.load(DEMOS / "picture_frame.toml", settings)
    law = case.fabric().shear
    g = frame_angle(FRAME, (0.1, 0.1))
    f = law.evaluate(g)[1] * 0.1 / np.sin(0.25 * np.pi - 0.5 * g)
    head = "angle_deg,load_N,crosshead_mm,shear_force_N_per_mm\n"
    rows = zip(np.rad2deg(g), f, 1e3 * FRAME, f, strict=True)
    path = tmp_path / "frame.csv"
    path.write_text(head + "".join(",".join(map(repr, map(float, row))) + "\n" for row in rows))
    told = calibrate_case(MPI.COMM_SELF, case, path, tmp_path, LOG)
    assert told["rms_relative_error"] < 0.005

    # A strip beside it, of the same law; the curves' points follow each other in the file.
    data = case.model_dump(exclude_none=True, by_alias=True)
    data["preform"] |= {"outline": {"rectangle": ["100 mm", "200 mm"]}, "bias_angle": "45 deg"}
    data["test"] = {"kind": "bias-extension", "extension": "1 mm", "finite": True}
    data["output"]["pictures"] = True
    strip = Case.from_data(data)
    d = DISPLACEMENT[1::3]
    loads = loads_of(Network(MPI.COMM_SELF, strip.preform(), case.fabric()), law, d)
    other = tmp_path / "strip.csv"
    other.write_text(HEAD + "".join(f"{1e3 * a}, {b}\n" for a, b in zip(d, loads, strict=True)))
    told = calibrate_case(
        MPI.COMM_SELF, strip, other, tmp_path, LOG, also=[(case, path)], weights=[1.0, 0.5]
    )
    assert [curve["kind"] for curve in told["curves"]] == ["bias-extension", "picture-frame"]
    assert [curve["weight"] for curve in told["curves"]] == [1.0, 0.5]
    assert max(curve["rms_relative_error"] for curve in told["curves"]) < 0.02
    rows = np.genfromtxt(tmp_path / "calibration.csv", delimiter=",", names=True)
    assert rows["curve"].tolist() == [1] * len(d) + [2] * len(FRAME)
    assert (tmp_path / "calibration.png").stat().st_size > 10_000
    with pytest.raises(InputError, match="there are 1 weights for 2 curves"):
        calibrate_case(
            MPI.COMM_SELF, strip, other, tmp_path, LOG, also=[(case, path)], weights=[1.0]
        )


@pytest.mark.parametrize(
    ("where", "change", "said"),
    [
        ("test", {"pretension": "5 N/cm"}, "test.pretension of the case is nothing that a shear"),
        ("test", {"slip": {"force": "1 N"}}, "test.slip of the case is nothing that a shear law"),
        ("test", {"model": "truss"}, 'test.model of the case is "truss"'),
        (
            "fabric",
            {"shear_viscosity": {"viscosity": "1 N s/m"}},
            "fabric.shear_viscosity of the case is nothing that a shear law",
        ),
    ],
)
def test_what_a_law_is_not_found_with(tmp_path, where, change, said):
    data = {
        "title": "frame",
        "fabric": {"use": "glass-pp-plain-1.93"},
        "preform": {"outline": {"rectangle": ["50 mm", "50 mm"]}, "bias_angle": "0 deg"},
        "test": {"kind": "picture-frame", "angle": "1 deg"},
    }
    data[where] |= change
    with pytest.raises(InputError, match=said):
        calibrate_case(MPI.COMM_SELF, Case.from_data(data), "frame.csv", tmp_path, LOG)


def test_an_elastic_law_beside_friction():
    """Friction that is given stays beside the law: that has all of the torque but for it."""
    modulus, torque = 20.0, 4.0
    changes = {
        "shear": {"modulus": f"{modulus} N/m"}, "shear_friction": {"torque": f"{torque} N/m"}
    }  # fmt: skip
    cloth = Fabric.from_library("glass-pp-plain-1.93", changes)
    side = 4 / cloth.warp.yarns
    network = Network(MPI.COMM_SELF, Preform.rectangle(side, side, 0.0), cloth)
    angle = np.deg2rad(np.linspace(5.0, 40.0, 8))
    diagonal = np.sqrt(2.0) * side * np.sqrt(1.0 + np.sin(angle))
    load = (modulus * angle + torque) * diagonal / np.cos(angle)  # psi' = F cos(g)/diagonal
    found = calibrate(network, diagonal - np.sqrt(2.0) * side, load, kind="picture-frame")
    assert found.rms < 1e-4
    np.testing.assert_allclose(found.law.evaluate(angle)[1], modulus * angle, rtol=1e-3)


def test_frames_that_cannot_be():
    with pytest.raises(InputError, match="is closed at 58.57"):
        calibrate(frame(), [0.01, 0.02, 0.03, 0.07], [1.0, 2, 3, 4], kind="picture-frame")
    with pytest.raises(InputError, match="kind is 'biaxial'; it can be"):
        calibrate(frame(), FRAME, FRAME, kind="biaxial")


# -- several curves, bounds ---------------------------------------------------------------------


def test_two_curves_and_their_weights():
    """A strip and a frame of cloths that differ by 20 %: the law goes with the weights."""
    strip, square = specimen(5), frame()
    d = DISPLACEMENT[1::3]
    low = MeasuredCurve.from_points(d, loads_of(strip, RISING, d))
    high = MeasuredCurve.from_points(
        FRAME, 1.2 * loads_of(square, RISING, FRAME, kind="picture-frame")
    )
    true = RISING.evaluate(np.deg2rad(20.0))[1]
    ratio = []
    for weight in (0.01, 100.0):
        found = calibrate_together(
            [Specimen(strip, low, weight=weight), Specimen(square, high, "picture-frame")]
        )
        ratio.append(found.law.evaluate(np.deg2rad(20.0))[1] / true)
        assert [part.stop for part in found.parts] == [len(d), len(d) + len(FRAME)]
        assert len(found.residuals) == len(d) + len(FRAME)
    # Between the two, nearer to the heavier one; to smoothing.
    np.testing.assert_allclose(ratio, [1.2, 1.0], atol=0.03)
    alone = calibrate(square, high, kind="picture-frame", angles=found.angles)
    twice = calibrate_together([Specimen(square, high, "picture-frame")] * 2, angles=found.angles)
    np.testing.assert_allclose(twice.values, alone.values, rtol=1e-3)
    with pytest.raises(InputError, match="weight of a curve must be positive"):
        calibrate_together([Specimen(strip, low, weight=0.0)])


def test_bounds_of_the_law():
    """Bounds hold where the data would have it otherwise, and do nothing elsewhere."""
    square = frame()
    loads = loads_of(square, RISING, FRAME, kind="picture-frame")
    free = calibrate(square, FRAME, loads, kind="picture-frame")
    wide = calibrate(
        square, FRAME, loads, kind="picture-frame", bounds=(linear(1.0), linear(100.0))
    )
    np.testing.assert_allclose(wide.values, free.values, rtol=2e-3)
    cap = linear(9.0)
    capped = calibrate(square, FRAME, loads, kind="picture-frame", bounds=(None, cap))
    limit = cap.evaluate(capped.angles)[1]
    assert (free.values > 1.05 * limit).any()
    assert (capped.values <= limit * (1 + 1e-6)).all()
    np.testing.assert_allclose(capped.values[-1], limit[-1], rtol=1e-6)
    with pytest.raises(InputError, match="no rising law lies within the bounds"):
        calibrate(square, FRAME, loads, kind="picture-frame", bounds=(linear(9.0), linear(5.0)))


# -- data that mislead --------------------------------------------------------------------------


def frame_curve(factor=1.0, law=RISING, displacement=FRAME):
    """Loads of a frame by the formula; its network is the formula to a ten-thousandth."""
    g = frame_angle(displacement, (0.1, 0.1))
    diagonal = np.hypot(0.1, 0.1) + displacement
    return MeasuredCurve.from_points(
        displacement, factor * law.evaluate(g)[1] * diagonal / np.cos(g)
    )


def test_never_worse_than_the_start():
    """Stairs that the ladder of angles, and smoothing, would level."""
    d = np.linspace(2e-3, 34e-3, 10)
    g = frame_angle(d, (0.1, 0.1))
    stairs = table(g, 5.0 * 2.0 ** np.floor(np.arange(10) / 2.0) * (1.0 + 0.01 * np.arange(10)))
    told = []
    found = calibrate(frame(), frame_curve(1.0, stairs, d), kind="picture-frame", told=told.append)
    assert found.start_rms < 0.05
    assert found.rms <= 1.001 * found.start_rms
    assert any("worse than the start: once more" in line for line in told)
    # With angles of the user's own it says so.
    forced = calibrate(
        frame(), frame_curve(1.0, stairs, d), kind="picture-frame", angles=[0.2, 0.5, 1.0]
    )
    assert forced.rms > 1.001 * forced.start_rms
    assert any("worse than its start" in remark for remark in forced.remarks())


def test_knots_where_the_data_begin():
    """A first point far below two degrees has a knot of its own, and is followed."""
    law = table(np.deg2rad([0.3, 1.5, 10, 40, 70]), [2.0, 3.5, 5.0, 12.0, 40.0])
    d = np.append([0.26e-3, 0.7e-3], FRAME)
    found = calibrate(frame(), frame_curve(1.0, law, d), kind="picture-frame")
    assert np.rad2deg(found.angles[0]) == pytest.approx(0.211, abs=0.001)
    assert found.rms < 0.02
    assert abs(found.residuals[0]) < 0.03
    assert found.usable_ranges()[0][0] == pytest.approx(found.angles[0])
    # A plateau from the first point of a strip on: half of its cloth shears half as much.
    plateau, d = table(np.deg2rad([0.4, 20, 50]), [3.0, 3.5, 30.0]), DISPLACEMENT[[0, 2, 4, 6, 8]]
    strip = specimen(5)
    found = calibrate(strip, d, loads_of(strip, plateau, d))
    assert found.angles[0] == pytest.approx(0.5 * found.reached[0], rel=0.2)
    assert abs(found.residuals[0]) < 0.05


def test_a_point_that_rules_is_named(tmp_path):
    """And the law after each step is a file, for whom the search is interrupted."""
    curve = frame_curve(displacement=np.linspace(3e-3, 34e-3, 16))
    curve.force[8] *= 1.5
    kept = partial(write_so_far, MPI.COMM_SELF, tmp_path)
    found = calibrate(frame(), curve, kind="picture-frame", stepped=kept)
    law = (tmp_path / "law.toml").read_text()
    assert law.startswith(f"# Not finished: the law after step {found.iterations}, RMS ")
    points = np.array(tomllib.loads(law)["fabric"]["shear"]["points"])
    np.testing.assert_allclose(points[1:, 1], 1e-3 * found.values, rtol=1e-3)
    text = next(remark for remark in found.remarks() if "makes up" in remark)
    assert text.startswith("The point at 19.53 mm, ")
    others = 100.0 * np.sqrt(np.mean(np.delete(found.residuals, 8) ** 2))
    assert f"RMS of the others is {others:.2f} %" in text
    assert others < 3.0 < 7.0 < 100.0 * found.rms
    even = replace(found, loads=found.curve.force * 1.05)
    assert even.ruling_point() is None


def test_points_that_no_law_gives_are_left_out():
    """Where the yarns of a strip lie along the pull (41.4 mm); refused if most points are there."""
    network, d = specimen(), 1e-3 * np.array([10.0, 20, 30, 38, 41.3, 42])
    strip = Specimen(network, MeasuredCurve.from_points(d, d)).checked()
    np.testing.assert_array_equal(strip.curve.displacement, d[:4])
    assert strip.curve.rows == 6
    assert "lie along the pull at 41.4214 mm" in strip.curve.notes[0]
    assert "2 points from 41.3 mm on left out" in strip.curve.notes[0]
    with pytest.raises(InputError, match="the data go to 420 mm, but the yarns"):
        Specimen(network, MeasuredCurve.from_points(10 * d, d)).checked()
    closed = MeasuredCurve.from_points(1e-3 * np.array([10.0, 20, 30, 40, 58.5, 59]), d)
    square = Specimen(frame(), closed, "picture-frame").checked()
    assert len(square.curve.force) == 4


def test_verdict():
    curve = frame_curve(displacement=np.linspace(3e-3, 34e-3, 9))
    found = calibrate(frame(), curve, kind="picture-frame")
    first, last = np.rad2deg([found.reached.min(), found.known_to])
    assert found.verdict().startswith(f"the law from {first:.1f} to {last:.1f} deg (")
    part = replace(
        found, estimate=replace(found.estimate, errors=np.arange(len(found.angles)) * 0.1)
    )
    low, high = np.rad2deg([found.reached.min(), found.angles[2]])
    assert part.verdict().startswith(f"the law from {low:.1f} to {high:.1f} deg (")
    wrong = replace(found, loads=1.5 * found.loads)
    assert wrong.verdict() == "none of the law: the network does not follow the curve (50 %)"
    unknown = replace(found, estimate=replace(found.estimate, errors=np.ones(len(found.angles))))
    assert unknown.verdict() == "none of the law: no part is known to 20 %"
    other = predict(found, frame(), frame_curve(2.0), kind="picture-frame")
    assert "does not foretell the second specimen (RMS 50 %)" in found.verdict(other)


def test_loads_a_thousand_times_off():
    """Asked by the closed formula and the fabric's own law; none where a cloth is just other."""
    law = UNKNOWN.shear
    for factor, question in {
        1e-3: "1000 times smaller than those of the fabric's own shear law: is kN meant",
        1e3: "1000 times larger than those of the fabric's own shear law: is N meant",
        5.0: None,
        0.1: None,
    }.items():
        square = Specimen(frame(), frame_curve(factor, law), "picture-frame")
        loads = factor * net_load(net_angle(DISPLACEMENT, 0.1), law, 0.1, 0.2)
        strip = Specimen(specimen(), MeasuredCurve.from_points(DISPLACEMENT, loads))
        for each in (square, strip):
            asked = each.unit_question()
            assert asked is None if question is None else question in asked
    other = specimen(angle="40 deg")  # without a closed formula nothing is asked
    assert Specimen(other, MeasuredCurve.from_points(DISPLACEMENT, loads)).unit_question() is None


def test_shear_force_of_a_frame():
    """F_s/L = F/(2 L cos(theta)) as entered comes back as the force of the cross-head."""
    shear = {
        "law": "table", "quantity": "shear force per length", "angle": "deg", "force": "N/m",
        "points": [[10, 4.0], [30, 9.0], [50, 30.0]],
    }  # fmt: skip
    fabric = Fabric.from_library("glass-pp-plain-1.93", {"shear": shear})
    g = np.deg2rad([10.0, 30.0, 50.0])
    d = np.sqrt(2.0 * 0.1**2 * (1.0 + np.sin(g))) - np.hypot(0.1, 0.1)
    loads = loads_of(frame(), fabric.shear, d, kind="picture-frame")
    half = 0.5 * (0.5 * np.pi - g)
    np.testing.assert_allclose(loads / (2.0 * np.cos(half) * 0.1), [4.0, 9.0, 30.0], rtol=1e-4)


# -- hold-out ----------------------------------------------------------------------------------


def test_another_specimen_is_predicted():
    """A law found on H = 2 W foretells H = 2.5 W; the law before does not."""
    network = specimen()
    found = calibrate(network, DISPLACEMENT, loads_of(network, RISING))
    other = specimen(size=("80 mm", "200 mm"))
    further = 1e-3 * np.array([5.0, 15.0, 25.0, 35.0, 44.0])
    told = predict(found, other, further, loads_of(other, RISING, further))
    # As far as the law is known: the errors of its table, 2 % each (see above).
    assert told.rms_known < 0.015
    assert told.extrapolated.tolist() == (told.reached > found.reached.max()).tolist()
    before = predict(UNKNOWN.shear, other, further, loads_of(other, RISING, further))
    assert before.rms > 10.0 * told.rms_known
    assert not before.extrapolated.any()


def test_whether_the_data_disagree():
    """By the closed formula alone: frames, and strips of two sizes."""
    found = calibrate(frame(), frame_curve(), kind="picture-frame")
    same = predict(found, frame(), frame_curve(1.02), kind="picture-frame")
    assert same.gap.mean == pytest.approx(0.02, abs=1e-6)
    assert any("two data sets agree to 2 % (mean +2 %)" in remark for remark in same.remarks())
    other = predict(found, frame(), frame_curve(0.7), kind="picture-frame")
    assert other.gap.rms == pytest.approx(0.3, abs=1e-6)
    low, high = np.rad2deg([other.gap.low, other.gap.high])
    text = f"differ by 30 % (mean -30 %) from {low:.1f} to {high:.1f} deg: the two data sets disag"
    assert any(text in remark for remark in other.remarks())
    # Another size of one cloth: the formula of strips knows no size, and ends at 35 degrees.
    wide, narrow = specimen(), specimen(size=("80 mm", "200 mm"))
    a, b = (
        MeasuredCurve.from_points(
            DISPLACEMENT, net_load(net_angle(DISPLACEMENT, 0.2 - w), RISING, w, 0.2)
        )
        for w in (0.1, 0.08)
    )
    gap = formula_gap([Specimen(wide, a)], Specimen(narrow, b))
    assert gap.rms < 0.02
    assert np.rad2deg(gap.high) == pytest.approx(35.0)
    other = specimen(angle="40 deg")
    assert formula_gap([Specimen(other, a)], Specimen(narrow, b)) is None


def test_hold_out_of_a_case(tmp_path):
    """A second case and its data: figures in the summary, the curve in a file."""
    settings = ["preform.yarns_per_cruciform=4", "output.pictures=false"]
    case = Case.load(DEMOS / "calibrate_glass_pp.toml", settings)
    data = case.model_dump(exclude_none=True, by_alias=True)
    data["preform"]["outline"] = {"rectangle": ["100 mm", "240 mm"]}
    other = Case.from_data(data)
    d = 1e-3 * np.array([6.0, 15.0, 30.0, 45.0])
    f = loads_of(Network(MPI.COMM_SELF, other.preform(), GLASS_PP), GLASS_PP.shear, d)
    path = tmp_path / "other.csv"
    path.write_text(HEAD + "".join(f"{1e3 * a}, {b}\n" for a, b in zip(d, f, strict=True)))
    curve = tmp_path / "curve.csv"
    measured = (DEMOS / "glass_pp_bias.csv").read_text().splitlines()
    curve.write_text("\n".join(measured[:-9]))
    told = calibrate_case(MPI.COMM_SELF, case, curve, tmp_path, LOG, (other, path))
    kept = json.loads((tmp_path / "calibration.json").read_text())["hold_out"]
    assert kept["rms_relative_error"] == told["hold_out"]["rms_relative_error"]
    assert kept["points"] == 4
    # The same law at another mesh: where the coarse yarns lie is 5 to 10 % of the loads.
    assert 0.0 < kept["rms_relative_error"] < 0.25
    rows = np.genfromtxt(tmp_path / "hold_out.csv", delimiter=",", names=True)
    np.testing.assert_allclose(rows["measured_N"], f, rtol=1e-6)
    np.testing.assert_allclose(
        np.sqrt(np.mean(rows["relative_residual"] ** 2)), kept["rms_relative_error"], rtol=1e-6
    )

    data["test"] = {"kind": "off-axis-tension", "extension": "1 mm"}
    with pytest.raises(InputError, match='of the hold-out case is "off-axis-tension"'):
        calibrate_case(MPI.COMM_SELF, case, curve, tmp_path, LOG, (Case.from_data(data), path))


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"smoothing": 0.0}, "smoothing must be positive"),
        ({"angles": [0.2, 0.1]}, "angles must be two or more, ascending"),
        ({"force": None}, "needs the forces"),
    ],
)
def test_bad_arguments(changes, message):
    given = {"displacement": DISPLACEMENT, "force": 1e3 * DISPLACEMENT} | changes
    with pytest.raises(InputError, match=message):
        calibrate(specimen(), **given)


# -- the published curve -----------------------------------------------------------------------


def test_library_law_gives_the_published_curve():
    """Glass/PP, 115 mm x 230 mm at yarn pitch: within 6 % (RMS) was asked for, 2 % are reached."""
    curve = read_curve(DEMOS / "glass_pp_bias.csv")
    assert len(curve.force) == 16
    network = specimen(1, ("115 mm", "230 mm"), fabric=GLASS_PP)
    error = loads_of(network, GLASS_PP.shear, curve.displacement) / curve.force - 1.0
    asked = curve.displacement > 3.9e-3
    assert np.sqrt(np.mean(error[asked] ** 2)) < 0.03


def test_calibration_of_the_published_curve(tmp_path):
    """As it was digitised: within 3 % over 42 of its 43 points, of which the last is named.

    The whole way, on a coarser net, with all files; the law pasted into a case is the law.
    """
    case = Case.load(DEMOS / "calibrate_glass_pp.toml", ["preform.yarns_per_cruciform=4"])
    digitised = Path(__file__).parent / "data" / "bias_glass_plain_115x230.csv"
    told = calibrate_case(MPI.COMM_SELF, case, digitised, tmp_path, LOG)
    assert told["rms_relative_error"] < 0.03 < told["rms_relative_error_start"]
    assert told["largest_relative_error"] < 0.1
    assert (told["points"], told["rows_measured"]) == (42, 43)
    assert told["displacement_m"][0] == pytest.approx(0.35e-3, rel=0.01)
    assert "1 point from 47.42 mm on left out" in told["remarks"][0]
    assert not any("makes up" in remark for remark in told["remarks"])
    assert told["verdict"].startswith("the law from 0.3 to ")
    assert f"# May be used: {told['verdict']}"[:60] in (tmp_path / "law.toml").read_text()
    assert json.loads((tmp_path / "calibration.json").read_text())["law"] == told["law"]
    assert (tmp_path / "calibration.png").stat().st_size > 10_000

    rows = np.genfromtxt(tmp_path / "calibration.csv", delimiter=",", names=True)
    np.testing.assert_allclose(
        rows["fit_N"] / rows["measured_N"] - 1, rows["relative_residual"], 1e-9
    )

    pasted = tomllib.loads((tmp_path / "law.toml").read_text())["fabric"]
    law = Fabric.from_library("glass-pp-plain-1.93", pasted).shear
    parameters = told["parameters"]
    angle = np.deg2rad([row["angle_deg"] for row in parameters])
    values = 1e3 * np.array([row["force_n_per_mm"] for row in parameters])
    np.testing.assert_allclose(law.evaluate(angle)[1], values, rtol=1e-3)  # four digits
    again = loads_of(
        specimen(4, ("115 mm", "230 mm"), fabric=GLASS_PP), law, told["displacement_m"]
    )
    np.testing.assert_allclose(again, told["load_n"], rtol=2e-3)


def test_picture():
    """What is drawn: data, start and fit over the displacement; errors; the law over the angle."""
    square = frame()
    loads = loads_of(square, RISING, FRAME, kind="picture-frame")
    found = calibrate(square, FRAME, 1.02 * loads, kind="picture-frame")
    drawn = figure(found, r"Frame $\frac{$")  # which is no formula
    drawn.savefig(io.BytesIO())
    curves, residuals, law = drawn.axes
    other = Figure().subplots()
    assert found.plot(other, "law") is other
    assert other.get_ylabel() == law.get_ylabel()
    assert found.plot(other) is other  # as many parts as there are axes
    assert other.get_ylabel() == curves.get_ylabel() == "load (N)"
    with pytest.raises(InputError, match='no picture "lawn".*did you mean "law"'):
        found.plot(what="lawn")
    start, fit, data = (line.get_xydata().T for line in curves.lines)
    np.testing.assert_allclose(start, [[0.0, *1e3 * FRAME], [0.0, *found.start_loads]])
    np.testing.assert_allclose(fit, [[0.0, *1e3 * FRAME], [0.0, *found.loads]])
    np.testing.assert_allclose(data, [1e3 * FRAME, found.curve.force])
    labels = [text.get_text()[:8] for text in curves.get_legend().texts]
    assert labels == ["start fr", "network ", "measured"]
    np.testing.assert_allclose(residuals.lines[-1].get_ydata(), 100 * found.residuals)
    lines = {line.get_label(): line.get_xydata().T for line in law.lines}
    angle, value = lines["identified law"]
    np.testing.assert_allclose(value, 1e-3 * found.law.evaluate(np.deg2rad(angle))[1])
    angle, value = lines["if the yarns lay half a cell away"]
    moved = found.values * (1.0 + found.assumptions["place of the yarns"].values)
    np.testing.assert_allclose([angle[1:], value[1:]], [np.rad2deg(found.angles), 1e-3 * moved])
    dots = [line.get_xdata() for line in law.lines if line.get_marker() == "o"]
    np.testing.assert_allclose(np.sort(np.concatenate(dots)), np.rad2deg(found.angles))
    (reached,) = [line for line in law.lines if line.get_color() == "0.4"]
    assert reached.get_xdata()[0] == pytest.approx(np.rad2deg(found.reached.max()))


def test_other_tests_are_refused(tmp_path):
    case = Case.load(DEMOS / "calibrate_glass_pp.toml")
    data = case.model_dump(exclude_none=True)
    data["test"] = {"kind": "off-axis-tension", "extension": "1 mm"}
    with pytest.raises(InputError, match='with kind = "bias-extension" or "picture-frame" only'):
        calibrate_case(
            MPI.COMM_SELF, Case.from_data(data), DEMOS / "glass_pp_bias.csv", tmp_path, LOG
        )


def test_data_in_the_wrong_unit():
    """Further than the yarns of the strip could ever go: told before anything is solved."""
    fabric = Fabric.from_library("glass-pp-plain-1.93")
    specimen = Network(MPI.COMM_SELF, Preform.rectangle("115 mm", "230 mm"), fabric)
    with pytest.raises(InputError, match="lie along the pull at 47.6"):
        calibrate(specimen, [0.02, 0.05, 0.1, 0.15], [2.0, 4.0, 6.0, 9.0])
