# SPDX-License-Identifier: MIT
"""Biaxial tension at a ratio of forces: closed forms, crosses with slits, bad input."""

from dataclasses import replace

import numpy as np
import pytest
from mpi4py import MPI
from support.helpers import UNEVEN

from cruciform_petsc import Fabric, InputError, Network, Preform
from cruciform_petsc.experiments.biaxial_load import BiaxialLoad

CLOTH = replace(UNEVEN, shear_modulus=2000.0)


def pulled(preform, fabric=CLOTH, **keys):
    test = BiaxialLoad(Network(MPI.COMM_SELF, preform, fabric), **keys)
    return test, test.solve().curve(states=True)


@pytest.mark.parametrize("ratio", [1.0, 0.5, 2.0, 0.2])
@pytest.mark.parametrize("bias", ["0 deg", "90 deg"])
def test_a_rectangle_strains_alike(ratio, bias):
    """The law's tensions, per width at rest, at the strains read are those put on, in the ratio."""
    strip = Preform.rectangle("50 mm", "40 mm", bias)
    _, curve = pulled(strip, tension=["1 N/cm", "20 N/cm"], ratio=ratio)
    for i, n in enumerate((100.0, 2000.0)):
        strain = [0.01 * curve[f"strain_centre_{side}_percent"][i] for side in ("warp", "weft")]
        found = CLOTH.tension(1.0 + np.array(strain))[1]
        np.testing.assert_allclose(found, [n, ratio * n], rtol=1e-6)  # solved to 1e-8 of the loads
        for side, wanted in (("warp", n), ("weft", ratio * n)):
            centre = 100.0 * curve[f"tension_centre_{side}_N_per_cm"][i]
            assert centre == pytest.approx(wanted, rel=1e-6)
    across = (0.05, 0.04) if bias == "0 deg" else (0.04, 0.05)
    np.testing.assert_allclose(curve["force_warp_N"], np.array([100.0, 2000.0]) * across[0])
    weft = np.array([100.0, 2000.0]) * ratio * across[1]
    np.testing.assert_allclose(curve["force_weft_N"], weft)
    assert curve["shear_max_deg"].max() < 1e-4


def test_small_displacements():
    """In proportion: e_w = n_w/E_w - nu_w n_e/E_w."""
    strip = Preform.rectangle("50 mm", "40 mm", "0 deg")
    _, curve = pulled(strip, tension=["1 N/cm", "2 N/cm"], ratio=0.5, finite=False)
    warp, weft = CLOTH.warp, CLOTH.weft
    expected = np.array([100.0, 200.0]) * (1.0 - 0.5 * warp.poisson) / warp.modulus
    np.testing.assert_allclose(0.01 * curve["strain_centre_warp_percent"], expected, rtol=1e-6)
    expected = np.array([100.0, 200.0]) * (0.5 / weft.modulus - warp.poisson / warp.modulus)
    np.testing.assert_allclose(0.01 * curve["strain_centre_weft_percent"], expected, rtol=1e-6)


def test_in_space():
    """Edges stay in the plane, so that cloth that is not quite flat neither drifts nor tumbles."""
    rigid = (replace(yarns, out_of_plane_bending=1e-3) for yarns in (CLOTH.warp, CLOTH.weft))
    cloth = replace(CLOTH, **dict(zip(("warp", "weft"), rigid, strict=True)), thickness=1e-3)
    network = Network(MPI.COMM_SELF, Preform.shape({"cross": ["60 mm", "20 mm"]}, "0 deg"), cloth)
    keys = {"space": True, "imperfection": {"height": "0.1 mm"}}
    result = BiaxialLoad(network, ["2 N/cm", "20 N/cm"], **keys).solve()
    low, high = (abs(state.fields["displacement"][:, 2]).max() for state in result.states)
    assert 1e-6 < low < 1e-4  # pulled flat in part, from heights of 0.1 mm
    assert high < 1e-4
    flat = BiaxialLoad(network, "2 N/cm").solve().curve(states=True)
    for side in ("warp", "weft"):
        name = f"strain_centre_{side}_percent"
        assert result.curve(states=True)[name][0] == pytest.approx(flat[name][0], rel=1e-2)
    BiaxialLoad(network, "2 N/cm", space=True, stability={}).solve()


def test_under_pretension():
    """The load is all that the cloth then carries; strains are from where it is drawn."""
    strip = Preform.rectangle("50 mm", "40 mm", "0 deg")
    test, curve = pulled(strip, tension=["5 N/cm", "8 N/cm"], pretension="5 N/cm")
    assert abs(curve["strain_centre_warp_percent"][0]) < 1e-6
    stretch = np.array(test.prestretch) * [
        1.0 + 0.01 * curve[f"strain_centre_{side}_percent"][1] for side in ("warp", "weft")
    ]
    found = CLOTH.tension(stretch)[1] / np.array(test.prestretch)[::-1]
    np.testing.assert_allclose(found, [800.0, 800.0], rtol=1e-6)
    for side in ("warp", "weft"):
        assert curve[f"tension_centre_{side}_N_per_cm"] == pytest.approx([5.0, 8.0], rel=1e-6)


YARN = {"yarns": "2 /cm", "yarn_bending": "0.1 N mm^2"}
SOFT = Fabric.from_table(
    "soft in shear",
    {
        "warp": YARN | {"modulus": "200 N/cm", "poisson": 0.1},
        "weft": YARN | {"modulus": "150 N/cm"},
        "shear": {"modulus": "10 N/cm"},
    },
)  # fmt: skip


def test_slits_keep_arms_out_of_it():
    """In a cross with slits the middle has what is put on the arms, without it less."""
    off = []
    for slits in ({}, {"arm_slits": 3}):
        cross = Preform.shape({"cross": ["150 mm", "50 mm"], **slits}, "0 deg",
                              origin=("1.25 mm", "76.25 mm"), refine=2)  # fmt: skip
        _, curve = pulled(cross, SOFT, tension="2 N/cm", ratio=0.5)
        off.append([
            curve[f"tension_centre_{side}_N_per_cm"][-1] / wanted - 1.0
            for side, wanted in (("warp", 2.0), ("weft", 1.0))
        ])  # fmt: skip
    without, slit = np.array(off)
    assert (without < -0.04).all()  # 4.4, 9.8 %
    assert abs(slit).max() < 0.005  # 0.1, 0.3 %


@pytest.mark.parametrize(
    ("outline", "keys", "message"),
    [
        ({"rectangle": ["50 mm", "40 mm"]}, {"tension": "1 N"}, 'test.tension = "1 N"'),
        ({"rectangle": ["50 mm", "40 mm"]}, {"tension": "-1 N/cm"}, "zero or positive"),
        ({"rectangle": ["50 mm", "40 mm"]}, {"tension": "1 N/cm", "ratio": -1.0}, "at least 0"),
        ({"rectangle": ["50 mm", "40 mm"]}, {"tension": "0 N/cm"}, "no value other than zero"),
        ({"circle": "50 mm"}, {"tension": "1 N/cm"}, 'needs|preform has no edge "lower"'),
    ],
)
def test_bad_input(outline, keys, message):
    with pytest.raises(InputError, match=message):
        BiaxialLoad(Network(MPI.COMM_SELF, Preform.shape(outline, "0 deg"), CLOTH), **keys)


@pytest.mark.parametrize(
    ("outline", "message"),
    [
        ({"cross": ["50 mm", "60 mm"]}, "arms must be narrower than the cross is long"),
        ({"rectangle": ["50 mm", "60 mm"], "arm_slits": 2}, "arm_slits is of a cross"),
    ],
)
def test_bad_crosses(outline, message):
    with pytest.raises(InputError, match=message):
        Preform.shape(outline, "0 deg")


def test_no_speed():
    """Tensions are prescribed, and no way that anything would move in some time."""
    fluid = {"shear_viscosity": {"viscosity": "1 N s/m"}}
    cloth = Fabric.from_library("glass-pp-plain-1.93", fluid)
    network = Network(MPI.COMM_SELF, Preform.rectangle("50 mm", "40 mm", "0 deg"), cloth)
    with pytest.raises(InputError, match='"biaxial-load" prescribes a load, at no speed'):
        BiaxialLoad(network, "1 N/cm", speed="1 mm/s")


def test_yarns_across():
    strip = Preform.rectangle("50 mm", "40 mm", "30 deg")
    with pytest.raises(InputError, match="needs yarns along the edges"):
        BiaxialLoad(Network(MPI.COMM_SELF, strip, CLOTH), "1 N/cm")
