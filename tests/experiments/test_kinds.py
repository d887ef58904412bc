# SPDX-License-Identifier: MIT
"""All kinds of test, small and finite, through one interface; bad input in one sentence."""

from dataclasses import replace

import numpy as np
import pytest
from mpi4py import MPI
from support.helpers import DIAGONAL, PITCH, TABLE_1, diagonals

from cruciform_petsc.cloth.preform import Preform
from cruciform_petsc.errors import InputError
from cruciform_petsc.experiments.bias_extension import BiasExtension
from cruciform_petsc.experiments.biaxial import Biaxial
from cruciform_petsc.experiments.cantilever import Cantilever
from cruciform_petsc.experiments.off_axis import OffAxisTension
from cruciform_petsc.experiments.pantograph import Pantograph
from cruciform_petsc.experiments.picture_frame import PictureFrame
from cruciform_petsc.experiments.result import EFFORT
from cruciform_petsc.net.network import Network
from cruciform_petsc.output.summary import solver_figures

DEGREE = np.pi / 180


def network(preform, fabric=TABLE_1):
    return Network(MPI.COMM_SELF, preform, fabric)


ALONG = Preform.rectangle(6 * PITCH, 6 * PITCH, 0.0)
BIAS = diagonals(3, 6)
EVERY = {"load_N", "shear_centre_deg", "shear_max_deg", "shear_99_deg"}
EVERY |= {f"energy_{mode}_J" for mode in ("tension", "shear", "bending")}
ZONES = {f"shear_{zone}_deg" for zone in ("middle", "side", "clamp")}
# Of finite tests for which there is a closed form.
CLOSED = {"load_net_N", "shear_net_deg", "shear_force_N_per_mm"}
CLOSED_FORM = {"bias-extension": CLOSED, "pantograph": CLOSED, "picture-frame": {"load_net_N"}}
# kind: class, preform, two values as written and in SI, what else is asked for, columns, what the
# first column is in and in what of SI
KINDS = {
    "bias-extension": (
        BiasExtension, BIAS, ["0.1 mm", "0.2 mm"], [1e-4, 2e-4], {}, EVERY | ZONES,
        ("extension_mm", 1e-3),
    ),
    "bias-extension, half": (
        BiasExtension, diagonals(3, 3), ["0.1 mm", "0.2 mm"], [1e-4, 2e-4],
        {"upper": "centre-line"}, EVERY | ZONES, ("extension_mm", 1e-3),
    ),
    "pantograph": (
        Pantograph, BIAS, ["0.1 mm", "0.2 mm"], [1e-4, 2e-4], {}, EVERY | ZONES,
        ("extension_mm", 1e-3),
    ),
    "off-axis-tension": (
        OffAxisTension, Preform.rectangle(0.02, 0.04, "30 deg"), ["0.1 mm", "0.2 mm"],
        [1e-4, 2e-4], {"ends": "free"}, EVERY | {"strain_percent", "stress_N_per_cm"},
        ("extension_mm", 1e-3),
    ),
    "picture-frame": (
        PictureFrame, ALONG, ["1 deg", "2 deg"], [DEGREE, 2 * DEGREE], {},
        EVERY | {"crosshead_mm", "shear_force_N_per_mm"}, ("angle_deg", DEGREE),
    ),
    "biaxial": (
        Biaxial, ALONG, ["0.1 %", "0.2 %"], [1e-3, 2e-3], {"ratio": 0.5},
        EVERY - {"load_N"} | {"strain_weft_percent", "tension_warp_N_per_cm",
                              "tension_weft_N_per_cm", "force_warp_N", "force_weft_N"},
        ("strain_warp_percent", 0.01),
    ),
    "cantilever": (
        Cantilever, ALONG, ["0.001 N", "0.002 N"], [1e-3, 2e-3], {},
        EVERY | {"tip_across_mm", "tip_along_mm"}, ("load_N", 1.0),
    ),
}  # fmt: skip
EVERY_KIND = pytest.mark.parametrize("name", KINDS)
FINITE = pytest.mark.parametrize("finite", [False, True], ids=["small", "finite"])


def made(name, values=None, **options):
    """An experiment, with bending."""
    kind, preform, written, _, more, _, _ = KINDS[name]
    return kind(network(preform), written if values is None else values, **more, **options)


@EVERY_KIND
@FINITE
def test_every_kind(name, finite):
    """The curve's columns and their units, the states, energies against the load's work."""
    _, _, _, values, _, columns, (column, size) = KINDS[name]
    result = made(name, finite=finite).solve()
    assert result.experiment.kind == name.split(",")[0]
    np.testing.assert_allclose(result.controls, values, rtol=1e-14)
    loads = np.array([state.load for state in result.states])  # a biaxial test's: of both forces
    assert len(result.states) == 2
    curve = result.curve(states=True)
    columns = columns | {column} | (CLOSED_FORM.get(name, set()) if finite else set())
    assert set(curve) == columns == set(result.curve()) - set(EFFORT)
    assert next(iter(curve)) == column
    assert all(values.shape == (2,) and values.dtype == float for values in curve.values())
    np.testing.assert_allclose(curve[column] * size, values, rtol=1e-14)
    if name != "biaxial":
        assert result.load == result.loads[-1]
        np.testing.assert_allclose(curve["load_N"], result.loads)
        np.testing.assert_allclose(loads, result.loads)
    assert (loads > 0).all()
    np.testing.assert_allclose(
        curve["shear_max_deg"], np.rad2deg(result.shear_angles_max), rtol=1e-14
    )
    energy = sum(curve[f"energy_{mode}_J"] for mode in ("tension", "shear", "bending"))
    for i, state in enumerate(result.states):
        fields = state.fields
        total = sum(fields[f"{mode}_energy"].sum() for mode in ("tension", "shear", "bending"))
        assert total == pytest.approx(energy[i], rel=1e-12)
        assert state.node_displacement.shape == (result.network.num_nodes_local, 2)
        assert fields["displacement"].shape == (result.network.num_crossovers_owned, 2)
    # Small as these are, work is half of load times path: for the path of each kind of test.
    if name == "picture-frame":
        path = 1e-3 * curve["crosshead_mm"]
    elif name == "cantilever":
        path = 1e-3 * curve["tip_across_mm"]
    elif name == "biaxial":
        path = result.controls * 6 * PITCH
    else:
        path = result.controls
    np.testing.assert_allclose(0.5 * loads * path, energy, rtol=0.02)
    # Forces on the grips are in balance (moments are not asked for here).
    forces = sum(result.states[-1].forces.values())
    size = max(abs(force).max() for force in result.states[-1].forces.values())
    if name == "cantilever":
        np.testing.assert_allclose(forces, [-result.load, 0.0], atol=1e-6 * size)
    elif "half" not in name:
        np.testing.assert_allclose(forces, 0.0, atol=1e-6 * size)
    if finite:
        asked = [increment for increment in result.increments if increment.asked]
        np.testing.assert_allclose([increment.load for increment in asked], loads)
        np.testing.assert_allclose([increment.control for increment in asked], values)
        np.testing.assert_allclose(
            [sum(increment.energies.values()) for increment in asked], energy
        )
    else:
        np.testing.assert_allclose(loads[1], 2 * loads[0], rtol=1e-9)
    assert isinstance(repr(result), str)


@EVERY_KIND
def test_finite_begins_as_small(name):
    """At a hundredth of the values above: what is not linear is a thousandth there."""
    _, _, _, values, _, _, _ = KINDS[name]
    value = values[0] / 100
    small, finite = (made(name, value, finite=finite).solve() for finite in (False, True))
    # Kinked bars for beams: 4 % in the load of a strip three diagonals wide, half of it bending's.
    tolerance = 1e-3 if name in ("picture-frame", "biaxial") else 0.08
    for force, values in finite.forces.items():
        assert values == pytest.approx(small.forces[force], rel=tolerance)
    assert finite.shear_angle_max == pytest.approx(small.shear_angle_max, rel=0.15, abs=1e-9)


@EVERY_KIND
def test_one_value_or_several(name):
    """A number in SI, a string with a unit, lists of both; one value is no curve."""
    _, _, written, values, _, _, _ = KINDS[name]
    for given in (written[0], values[0], [written[0]], [values[0], written[1]]):
        test = made(name, given)
        assert test.is_curve == isinstance(given, list)
        np.testing.assert_allclose(test.values, values[: len(test.values)], rtol=1e-14)


@EVERY_KIND
def test_check_tells_of_the_edges(name):
    """Without solving: how many yarn ends each grip has."""
    test = made(name)
    told = " ".join(test.check())
    edge = "lower" if name == "cantilever" else "upper"
    assert f"yarn ends on the {edge} edge" in told


def test_more_increments():
    """At least so many; the values asked for are met, and nothing else changes."""
    few, many = (made("bias-extension", finite=True, increments=n).solve() for n in (1, 6))
    assert len(few.increments) == 2  # one for each value
    assert len(many.increments) >= 6
    assert sum(increment.asked for increment in many.increments) == 2
    np.testing.assert_allclose(many.loads, few.loads, rtol=1e-7)


def test_bending_can_be_off():
    """Softer, and no energy in it."""
    stiff, soft = (made("bias-extension", finite=True, bending=b).solve() for b in (True, False))
    assert soft.load < stiff.load
    assert soft.energies()["bending"][-1] == 0 < stiff.energies()["bending"][-1]


def test_pantograph_sheet_of_the_library():
    """The sheet of 2016: its shear is the pivots', and a good part of its energy is bending."""
    from cruciform_petsc.cloth.fabric import Fabric

    sheet = Fabric.from_library("pantographic-sheet-2016")
    side = np.sqrt(2) * sheet.warp.spacing
    preform = Preform.rectangle(6 * side, 12 * side, "45 deg")
    test = Pantograph(network(preform, sheet), 0.1 * 12 * side, finite=True)
    result = test.solve()
    energies = result.energies()
    assert energies["bending"][-1] > 0.02 * sum(value[-1] for value in energies.values())
    assert result.shear_angle_max > 10 * DEGREE


def test_half_a_specimen():
    """Half of it, its upper edge the middle, tends to the whole's load and angle.

    Crossovers on the cut have no arm above it; the one below, turned straight on, stands in.
    """
    error = []
    for refine in (1, 2, 4):
        whole, half = (
            BiasExtension(
                network(diagonals(4, along, refine=refine)), pull, upper=upper, finite=True,
                bending=False,
            ).solve()
            for along, pull, upper in ((8, "4 mm", "grip"), (4, "2 mm", "centre-line"))
        )  # fmt: skip
        error.append(1 - half.load / whole.load)
    assert half.shear_angle_centre == pytest.approx(whole.shear_angle_centre, rel=0.005)
    # 5.6, 1.2, 0.25 %
    assert 0 < error[2] < 0.004
    assert error[0] > 3 * error[1] > 9 * error[2]


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: BiasExtension(network(BIAS)), "exactly one of extension and load, got neither"),
        (lambda: BiasExtension(network(BIAS), "1 mm", "1 N"), "extension and load, got both"),
        (
            lambda: BiasExtension(network(BIAS), "1 mm", upper="free"),
            'upper must be "grip" or "cen',
        ),
        (
            lambda: BiasExtension(network(BIAS), "1 mm", model="paper"),
            'model must be "coupled", "truss" or',
        ),
        (
            lambda: BiasExtension(network(BIAS), "1 mm", model="separate", finite=True),
            "small displacements only",
        ),
        (lambda: BiasExtension(network(BIAS), "1 deg"), "extension"),
        (lambda: BiasExtension(network(BIAS), load="1 mm"), "load"),
        (lambda: BiasExtension(network(BIAS), "0 mm"), "nothing would happen"),
        (lambda: BiasExtension(network(BIAS), []), "at least one value"),
        (
            lambda: BiasExtension(network(BIAS), "1 mm", increments=0),
            "a whole number from 1 up, got 0",
        ),
        (lambda: BiasExtension(network(BIAS), "1 mm", increments=np.nan), "whole number, got nan"),
        (
            lambda: OffAxisTension(network(BIAS), "1 mm", ends="loose"),
            'ends must be "grip" or "free"',
        ),
        (lambda: PictureFrame(network(ALONG), "90 deg"), "between -90 deg and 90 deg"),
        (lambda: PictureFrame(network(BIAS), "10 deg"), "yarns along the edges"),
        (lambda: Biaxial(network(BIAS), "1 %"), "yarns along the edges"),
        (lambda: Biaxial(network(ALONG), "60 %", ratio=-2.0), "weft strain .* more than -100 %"),
        (lambda: Biaxial(network(ALONG), "1 mm"), "strain"),
        (lambda: Cantilever(network(ALONG), "1 N", bending=False), "needs bending = true"),
        (lambda: Cantilever(network(ALONG), "1 mm"), "load"),
        (
            lambda: Cantilever(network(ALONG, _unbent()), "1 N"),
            "test.bending is true but fabric.weft.yarn_bending is zero",
        ),
    ],
)
def test_bad_input_is_one_sentence(make, message):
    """It names what is wrong, and is no traceback of something else."""
    with pytest.raises(InputError, match=message) as caught:
        make()
    text = str(caught.value)
    assert "\n" not in text
    assert len(text) < 200


@pytest.mark.parametrize(
    ("options", "types"),
    [
        ({}, ("preonly", "cholesky")),
        ({"pc_type": "mg"}, ("cg", "mg")),
        ({"pc_type": "gamg", "ksp_type": "fgmres"}, ("fgmres", "gamg")),
    ],
)
def test_solver_types_are_told(options, types):
    """Those that were used, whatever the number of unknowns would have called for."""
    result = BiasExtension(network(BIAS), "0.1 mm", finite=True, options=options).solve()
    assert result.solver_types == {"snes": "newtonls", "ksp": types[0], "pc": types[1]}
    assert result.solver_types.items() <= solver_figures(result).items()


def _unbent():
    return replace(TABLE_1, weft=replace(TABLE_1.weft, yarn_bending=0.0))


@FINITE
def test_edges_that_no_yarn_reaches(finite):
    """A clamp on nothing."""
    low = Preform.rectangle(4 * DIAGONAL, 4.45 * PITCH, 0.0, origin=(0.0, 0.0))
    points = [(0, 0), (4, 0), (4, 4), (3.6, 4), (3.6, 4.5), (3.5, 4.5), (3.5, 4), (0, 4)]
    spike = Preform.polygon((np.array(points) * PITCH).tolist(), [], 0.0, origin=(0.0, 0.0))
    BiasExtension(network(low), "1 um", finite=finite).check()
    with pytest.raises(InputError, match="no yarn reaches the edge 'upper'"):
        BiasExtension(network(spike), "1 um", finite=finite).solve()
