# SPDX-License-Identifier: MIT
"""Pull-out of a yarn, and other tests of cloth whose yarns slide: limits, energy, words."""

import numpy as np
import pytest
from mpi4py import MPI

from cruciform_petsc.cloth.fabric import Fabric
from cruciform_petsc.cloth.preform import Preform
from cruciform_petsc.errors import InputError
from cruciform_petsc.experiments.bias_extension import BiasExtension
from cruciform_petsc.experiments.pull_out import PullOut
from cruciform_petsc.experiments.table import SlipTable
from cruciform_petsc.net.network import Network

CLOTH = Fabric.from_library("glass-pp-plain-1.93")
PITCH = 1 / 193
DIAGONAL = np.sqrt(2) * PITCH
BIAS = Preform.rectangle(4 * DIAGONAL, 8 * DIAGONAL, "45 deg")
STRIP = Preform.rectangle(5 * PITCH, 6 * PITCH, "0 deg", origin=(0.0, 0.5 * PITCH))


def network(preform, fabric=CLOTH):
    return Network(MPI.COMM_SELF, preform, fabric)


@pytest.mark.parametrize("angle", ["0 deg", "90 deg"])
def test_the_force_is_that_of_the_crossings_left(angle):
    """Of a warp or a weft yarn; the cloth beside it gives a little, by which the force is late."""
    preform = Preform.rectangle(5 * PITCH, 6 * PITCH, angle, origin=(0.0, 0.5 * PITCH))
    pulled = np.array([0.5, 1.0, 2.0, 4.0, 5.0, 6.0]) * PITCH
    result = PullOut(network(preform), pulled.tolist(), slip={"force": 0.02}).solve()
    curve = result.curve(states=True)
    expected = 0.02 * np.maximum(6.0 - pulled / PITCH, 0.0)
    np.testing.assert_allclose(curve["load_net_N"], expected)
    np.testing.assert_allclose(result.loads, expected, rtol=0, atol=0.02 * 0.12)
    family = int(angle == "90 deg")
    out = result.fields["slid_out"]
    assert out[:, family].sum() == 6
    assert not out[:, 1 - family].any()
    # Force on the clamps is that on the yarn's end.
    forces = result.states[2].forces
    assert forces["yarn"][1] == pytest.approx(result.loads[2])
    balance = forces["left"] + forces["right"] + forces["yarn"]
    np.testing.assert_allclose(balance, 0.0, atol=1e-6 * result.loads[2])


def test_tension_of_the_cloth_makes_a_yarn_harder_to_pull():
    """With friction of yarn on yarn and a crimp angle; then there is no closed form."""
    loads = []
    for more in ({}, {"friction": 0.3, "crimp_angle": "15 deg"}):
        slip = {"force": 0.02, **more}
        result = PullOut(network(STRIP), ["0.5 mm", "1 mm"], slip=slip).solve()
        assert ("load_net_N" in result.curve()) == (not more)
        loads.append(result.load)
    assert loads[1] > 1.05 * loads[0]


EXTENSIONS = (np.array([0.05, 0.12, 0.2]) * 4 * DIAGONAL).tolist()


def test_large_friction_is_the_elastic_cloth():
    """To Newton's tolerance of 1e-8 of the forces, in which loads and energies are of second order.

    What sticks gives by force over 2 F/d_0: some 0.1 N over 4e11 N/m.
    """
    keys = {"increments": 6}
    plain = BiasExtension(network(BIAS), EXTENSIONS, **keys).solve()
    stuck = BiasExtension(network(BIAS), EXTENSIONS, slip={"force": 1e6}, **keys).solve()
    np.testing.assert_allclose(stuck.loads, plain.loads, rtol=1e-9)
    for name, values in plain.fields.items():
        size = abs(values).max()
        np.testing.assert_allclose(stuck.fields[name], values, rtol=0, atol=1e-6 * size)
    assert abs(stuck.fields["slip"]).max() < 1e-12
    assert stuck.curve()["dissipated_in_slip_J"].max() == 0.0


def test_no_region_or_no_yarns_to_slide():
    """Where nothing slides the cloth is elastic, to rounding; one family slides less than both."""
    far = [["1 m", "1 m"], ["2 m", "1 m"], ["1 m", "2 m"]]
    slips = {
        "none": None,
        "elsewhere": {"force": 0.03, "region": far},
        "warp": {"force": 0.03, "yarns": "warp"},
        "both": {"force": 0.03},
    }
    load, slid = {}, {}
    for name, slip in slips.items():
        result = BiasExtension(network(BIAS), EXTENSIONS, slip=slip, increments=3).solve()
        load[name] = result.load
        slid[name] = abs(result.fields.get("slip", np.zeros((1, 2)))).max(axis=0)
    # Newton's method comes to the same state by other steps.
    assert load["elsewhere"] == pytest.approx(load["none"], rel=1e-9)
    assert load["none"] > load["warp"] > load["both"]
    assert slid["elsewhere"].max() == 0.0
    assert slid["warp"][0] > 1e-4
    assert slid["warp"][1] < 1e-16  # rounding of places
    assert slid["both"].min() > 1e-4


def test_in_space_as_in_the_plane():
    """Flat cloth that may leave its plane and has no reason to."""
    slip, loads = {"force": 0.03}, []
    for space in (False, True):
        result = BiasExtension(
            network(BIAS), EXTENSIONS[:2], slip=slip, increments=2, space=space
        ).solve()
        loads.append(result.loads)
        assert abs(result.fields["slip"]).max() > 1e-5
    # Equilibrium is found to 1e-8 of the forces.
    np.testing.assert_allclose(loads[1], loads[0], rtol=1e-6)


def test_work_is_energy_and_what_friction_takes():
    """Pulled and let back: work is what is stored and spent; nothing spent is given back."""
    there = np.linspace(0.0, 0.25, 17)[1:] * 4 * DIAGONAL
    ways = [*there, *there[:-1][::-1][:6]]
    result = BiasExtension(network(BIAS), ways, slip={"force": 0.03}).solve()
    curve = result.curve()
    load, way = (
        np.concatenate([[0.0], v]) for v in (curve["load_N"], 1e-3 * curve["extension_mm"])
    )
    work = np.cumsum(0.5 * (load[1:] + load[:-1]) * np.diff(way))
    spent = curve["dissipated_in_slip_J"]
    assert spent[-1] > 0.5 * work.max()
    assert (np.diff(spent, prepend=0.0) >= 0.0).all()
    stored = sum(curve[f"energy_{mode}_J"] for mode in result.experiment.modes)
    # Trapezia of the load, and friction as it is at a step's end, where a yarn's end has come
    # nearer: both are of first order in the step.
    np.testing.assert_allclose(stored + spent, work, rtol=0, atol=0.01 * work.max())


SLIP = {"force": "0.05 N"}


def test_what_a_table_makes():
    table = SlipTable.from_data(
        SLIP | {"friction": 0.4, "crimp_angle": "30 deg", "yarns": "weft", "elastic_slip": "2 um"}
    )
    slip = table.build()
    # 2 sin(30 deg): a yarn with the tension T presses on the one it crosses by 2 T sin, from both
    # sides.
    assert (slip.force, slip.coefficient) == pytest.approx((0.05, 0.4))
    assert (slip.families, slip.region, slip.closest) == ((False, True), None, 0.2)
    assert slip.elastic == pytest.approx(2e-6)


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (
            lambda: BiasExtension(network(BIAS), "1 mm", slip={"force": "0 N"}),
            'test.slip.force must be positive, got "0 N"',
        ),
        (
            lambda: BiasExtension(network(BIAS), "1 mm", slip={}),
            "test.slip.force is missing",
        ),
        (
            lambda: BiasExtension(network(BIAS), "1 mm", slip=SLIP | {"friction": 0.3}),
            "test.slip.friction needs crimp_angle, too: both make a normal force of a tension",
        ),
        (
            lambda: BiasExtension(network(BIAS), "1 mm", slip=SLIP | {"crimp_angle": "20 deg"}),
            "test.slip.crimp_angle needs friction, too: both make a normal force of a tension",
        ),
        (
            lambda: BiasExtension(network(BIAS), "1 mm", slip=SLIP | {"yarns": "all"}),
            'test.slip.yarns must be "both", "warp" or "weft", got \'all\'',
        ),
        (
            lambda: BiasExtension(network(BIAS), "1 mm", slip=SLIP, finite=False),
            "test.slip needs finite = true: friction is not linear",
        ),
        (
            lambda: BiasExtension(
                network(BIAS, Fabric.from_library("e-glass-plain-2.4")), "1 mm", slip=SLIP
            ),
            "test.slip needs fabric.warp.poisson = 0",
        ),
        (
            lambda: BiasExtension(network(BIAS), "1 mm", slip=SLIP, model="truss"),
            'test.slip is of crossovers with arms, which model = "truss" has not',
        ),
        (
            lambda: BiasExtension(network(BIAS), "1 mm", slip=SLIP, stability={}),
            "test.slip and .stability do not go together",
        ),
        (lambda: PullOut(network(STRIP), "1 mm"), "test.slip is missing"),
        (
            lambda: PullOut(network(BIAS), "1 mm", slip=SLIP),
            'test.kind = "pull-out" needs yarns along the edges',
        ),
        (
            lambda: PullOut(
                network(Preform.rectangle("50 mm", "60 mm", "0 deg", refine=2)), "1 mm", slip=SLIP
            ),
            "pulls one yarn: preform.refine and preform.yarns_per_cruciform must be 1",
        ),
        (
            lambda: BiasExtension(
                network(BIAS),
                "1 mm",
                slip=SLIP
                | {"region": [["0 m", "0 m"], ["1 m", "1 m"], ["1 m", "0 m"], ["0 m", "1 m"]]},
            ),
            "test.slip.region crosses or touches itself",
        ),
    ],
)
def test_mistakes_are_told(make, message):
    with pytest.raises(InputError) as caught:
        make()
    assert message in str(caught.value)
