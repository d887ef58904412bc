# SPDX-License-Identifier: MIT
"""Viscosity and friction of shear against closed forms of the picture frame, and their energies."""

import numpy as np
import pytest
from mpi4py import MPI

from cruciform_petsc import BiasExtension, Fabric, Network, PictureFrame, Preform
from cruciform_petsc.errors import InputError
from cruciform_petsc.experiments.finite import FiniteTest

SIDE = 40e-3
G = 100.0  # N/m
FRICTION = {"torque": "5 N/m", "slip": "0.5 deg"}
FLUID = {"viscosity": "1000 N s/m"}
SPEED = 50e-3 / 60.0  # m/s


def fabric(**resistance):
    changes = {"shear": {"modulus": f"{G} N/m"}, **resistance}
    return Fabric.from_library("glass-pp-plain-1.93", changes)


def frame(angles, comm=MPI.COMM_SELF, resistance=None, **keys):
    side = f"{1e3 * SIDE} mm"
    preform = Preform.rectangle(side, side, bias_angle="0 deg")
    network = Network(comm, preform, fabric(**(resistance or {})))
    return PictureFrame(network, angles, bending=False, **keys)


def torque(curve):
    """Angle [rad] and torque per area beyond the law's, N/m, as uniform shear has it."""
    angle = np.deg2rad(curve["angle_deg"])
    diagonal = np.sqrt(2.0) * SIDE * np.sqrt(1.0 + np.sin(abs(angle)))
    return angle, curve["load_N"] * np.cos(angle) / diagonal - G * angle


def test_friction_of_a_cycle():
    """+T while it slides one way, -T the other; the loop is 2 T wide at any angle.

    Yarns between hinges do not stretch, so that all is exact but for Newton's 1e-8.
    """
    result = frame(
        ["20 deg", "-10 deg", "20 deg"], resistance={"shear_friction": FRICTION}, increments=20
    ).solve()
    curve = result.curve()
    angle, more = torque(curve)
    way = np.diff(angle, prepend=0.0)
    turned = np.abs(way) < 0  # steps in which it turns back, and has not slid all the way
    for number in np.flatnonzero(np.diff(np.sign(way))) + 1:
        turned[number] = True
    np.testing.assert_allclose(more[~turned], 5.0 * np.sign(way[~turned]), atol=1e-6)
    # All that was dissipated: T times the way less the elastic slips, and per turn two of them.
    slip, area = np.deg2rad(0.5), SIDE**2
    slid = abs(way).sum() - slip - 2 * 2 * slip
    assert curve["dissipated_in_shear_J"][-1] == pytest.approx(5.0 * area * slid, rel=1e-9)
    assert (np.diff(curve["dissipated_in_shear_J"]) >= 0.0).all()
    # Stored: the law's, and of the slip 2/3 T s_0.
    stored = area * (0.5 * G * angle[-1] ** 2 + 2.0 / 3.0 * 5.0 * slip)
    assert curve["energy_shear_J"][-1] == pytest.approx(stored, rel=1e-9)


def test_viscosity_of_a_frame():
    """eta times the rate of each step; twice the speed, twice the torque."""
    found = []
    for speed in (SPEED, 2.0 * SPEED):
        curve = (
            frame("20 deg", resistance={"shear_viscosity": FLUID}, increments=10, speed=speed)
            .solve()
            .curve()
        )
        angle, more = torque(curve)
        seconds = np.diff(1e-3 * curve["crosshead_mm"], prepend=0.0) / speed
        np.testing.assert_allclose(curve["time_s"], np.cumsum(seconds), rtol=1e-9)
        rate = np.diff(angle, prepend=0.0) / seconds
        np.testing.assert_allclose(more, 1000.0 * rate, rtol=1e-6)
        spent = np.cumsum(1000.0 * rate**2 * seconds) * SIDE**2
        np.testing.assert_allclose(curve["dissipated_in_shear_J"], spent, rtol=1e-6)
        found.append(more)
    np.testing.assert_allclose(found[1], 2.0 * found[0], rtol=1e-6)


def test_thinning_and_temperature():
    """A power law's torque; 30 K hotter, after Arrhenius, exp(-E/R (1/T_0 - 1/T)) of it."""
    flow = {
        "viscosity": "1000 N s/m", "exponent": 0.5, "temperature": "180 degC",
        "activation_energy": "40 kJ/mol",
    }  # fmt: skip
    found = []
    for temperature in (None, "210 degC"):
        curve = (
            frame(
                "20 deg", resistance={"shear_viscosity": flow}, increments=10, speed=SPEED,
                temperature=temperature,
            )
            .solve()
            .curve()
        )  # fmt: skip
        angle, more = torque(curve)
        seconds = np.diff(1e-3 * curve["crosshead_mm"], prepend=0.0) / SPEED
        rate = np.diff(angle, prepend=0.0) / seconds
        found.append(more)
    np.testing.assert_allclose(found[0], 1000.0 * rate**0.5, rtol=1e-6)
    hotter = np.exp(-40e3 / 8.314462618 * (1 / 453.15 - 1 / 483.15))
    np.testing.assert_allclose(found[1], hotter * found[0], rtol=1e-6)


def bias(resistance, values=("4 mm", "1 mm", "4 mm"), increments=12, **keys):
    preform = Preform.rectangle("20 mm", "40 mm", bias_angle="45 deg")
    network = Network(MPI.COMM_SELF, preform, fabric(**resistance))
    return BiasExtension(network, list(values) or None, increments=increments, **keys)


def work_of(curve):
    """By trapezia."""
    way = np.append(0.0, 1e-3 * curve["extension_mm"])
    load = np.append(0.0, curve["load_N"])
    return np.cumsum(0.5 * (load[1:] + load[:-1]) * np.diff(way))


def test_loads_below_that_of_the_fluid():
    """Yarns stretch by what the fluid takes at once; no step goes past its load and comes back."""
    first = bias({"shear_viscosity": FLUID}, ["0.01 mm"], 1, speed=SPEED).solve().load
    loads = [share * first for share in (0.1, 0.5, 0.9, 1.1)]
    curve = bias({"shear_viscosity": FLUID}, (), 4, speed=SPEED, load=loads).solve().curve()
    np.testing.assert_allclose(curve["load_N"][curve["asked"] > 0], loads, rtol=1e-7)
    for name in ("load_N", "extension_mm", "time_s", "dissipated_in_shear_J"):
        assert (np.diff(curve[name]) > 0.0).all(), name


@pytest.mark.parametrize(
    ("resistance", "speed", "order"),
    [({"shear_friction": FRICTION}, None, 1), ({"shear_viscosity": FLUID}, SPEED, 1)],
    ids=["friction", "viscosity"],
)
def test_balance_of_a_bias_test(resistance, speed, order):
    """Work is what is stored and dissipated; trapezia and steps come to it at first order."""
    off = []
    for increments in (8, 16, 32):
        curve = bias(resistance, increments=increments, speed=speed).solve().curve()
        stored = sum(curve[f"energy_{mode}_J"] for mode in ("tension", "shear", "bending"))
        spent = curve["dissipated_in_shear_J"]
        assert (np.diff(spent) >= 0.0).all()
        work = work_of(curve)
        assert spent[-1] > 0.3 * work[-1]
        off.append(abs(work[-1] - stored[-1] - spent[-1]) / work[-1])
    assert off[2] < 0.06
    assert off[2] < 0.7 * off[0] / 2.0**order


@pytest.mark.parametrize(
    ("resistance", "speed"),
    [
        ({"shear_friction": {"torque": "1e-6 N/m"}}, None),
        ({"shear_viscosity": FLUID}, 1e-11),
    ],
    ids=["no friction", "slow"],
)
def test_limits_are_elastic(resistance, speed):
    """Without friction, or infinitely slowly, unloading is the way back of loading."""
    loads = bias(resistance, speed=speed).solve().curve()["load_N"]
    elastic = bias({}).solve().curve()["load_N"]
    np.testing.assert_allclose(loads, elastic, rtol=2e-6, atol=1e-9)


def test_memory_is_of_hinges():
    """What is remembered has a row for each cruciform, kept by a node of its own."""
    test = FiniteTest(frame("5 deg", resistance={"shear_friction": FRICTION}))
    cruciforms = test.ply.cruciforms
    assert len(np.unique(cruciforms.keepers)) == len(cruciforms.rows)
    memory = cruciforms.accepted(test.at(0.0))
    assert {key: len(values) for key, values in memory.items()} == dict.fromkeys(
        ("angle", "anchor", "time", "spent"), len(cruciforms.rows)
    )
    elastic = FiniteTest(frame("5 deg"))
    assert elastic.ply.cruciforms.accepted(elastic.at(0.0)) == {}


@pytest.mark.parametrize(
    ("resistance", "keys", "said"),
    [
        ({"shear_viscosity": FLUID}, {}, "test.speed is missing, which fabric.shear_viscosity"),
        ({}, {"speed": "1 mm/min"}, "test.speed matters with fabric.shear_viscosity only"),
        ({"shear_friction": FRICTION}, {"finite": False}, "shear_friction needs test.finite"),
        (
            {"shear_viscosity": FLUID},
            {"speed": 1e-3, "stability": {}},
            "test.stability and fabric.shear_viscosity do not go together",
        ),
        (
            {"shear_viscosity": FLUID},
            {"speed": 1e-3, "temperature": "200 degC"},
            "test.temperature matters with fabric.shear_viscosity.activation_energy only",
        ),
        (
            {
                "shear_viscosity": FLUID
                | {"temperature": "200 degC", "activation_energy": "9 MJ/mol"}
            },
            {"speed": 1e-3, "temperature": "20 degC"},
            "would be e^",
        ),
    ],
)
def test_bad_input(resistance, keys, said):
    with pytest.raises(InputError, match=said.replace("^", r"\^")):
        frame("5 deg", resistance=resistance, **keys)
