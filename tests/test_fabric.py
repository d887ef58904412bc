# SPDX-License-Identifier: MIT
"""The cloth: constitutive numbers, checks, library."""

from dataclasses import replace

import numpy as np
import pytest

from cruciform_petsc.errors import InputError
from cruciform_petsc.fabric import Fabric, YarnFamily, fabric_names

UNEQUAL = Fabric(
    "unequal",
    warp=YarnFamily(52000.0, 0.45, 240.0, 0.6e-6),
    weft=YarnFamily(13000.0, 0.1125, 190.0, 0.2e-6),
    shear_modulus=96.0,
)


def compliance(fabric):
    """Compliance of the paper's [1], (3, 3): warp, weft, shear."""
    e_w, e_e = fabric.warp.modulus, fabric.weft.modulus
    return np.array(
        [
            [1 / e_w, -fabric.weft.poisson / e_e, 0],
            [-fabric.warp.poisson / e_w, 1 / e_e, 0],
            [0, 0, 1 / fabric.shear_modulus],
        ]
    )


def test_table_1():
    """The library has the paper's fabric with the paper's values, in SI."""
    fabric = Fabric.from_library("e-glass-plain-2.4")
    for family in (fabric.warp, fabric.weft):
        assert family.modulus == pytest.approx(52000.0, rel=1e-14)
        assert family.poisson == 0.45
        assert family.yarns == pytest.approx(240.0, rel=1e-14)
        assert family.yarn_bending == pytest.approx(0.6e-6, rel=1e-14)
    assert fabric.shear_modulus == pytest.approx(96.0, rel=1e-14)
    assert "Table 1" in fabric.source


def test_every_fabric_of_the_library_loads_and_has_a_source():
    """A fabric without a source does not belong there."""
    assert "e-glass-plain-2.4" in fabric_names()
    for name in fabric_names():
        assert Fabric.from_library(name).source


def test_stiffness_inverts_the_compliance():
    """C11, C22, C12 are [1] inverted, with different families, and C is symmetric."""
    stiffness = np.linalg.inv(compliance(UNEQUAL))
    assert pytest.approx(stiffness[0, 0], rel=1e-13) == UNEQUAL.c11
    assert pytest.approx(stiffness[1, 1], rel=1e-13) == UNEQUAL.c22
    assert pytest.approx(stiffness[0, 1], rel=1e-13) == UNEQUAL.c12
    assert UNEQUAL.warp.poisson * UNEQUAL.c22 == pytest.approx(UNEQUAL.c12, rel=1e-13)


def test_free_sides_give_the_modulus_back():
    """Pulled along the warp with free sides the cloth shows E_w; as printed in [2] it would not."""
    eps = np.array([1.0, -UNEQUAL.c12 / UNEQUAL.c22])
    stress = UNEQUAL.c11 * eps[0] + UNEQUAL.c12 * eps[1]
    assert stress == pytest.approx(UNEQUAL.warp.modulus, rel=1e-13)
    printed = UNEQUAL.warp.modulus * eps[0] + UNEQUAL.c12 * eps[1]
    assert abs(printed / UNEQUAL.warp.modulus - 1.0) > 0.05


@pytest.mark.parametrize("degrees", [0, 15, 30, 45, 60, 75, 90, 130, -20])
def test_off_axis_modulus(degrees):
    """Kilby's closed form is the compliance of [1] turned by the angle."""
    t = np.radians(degrees)
    c, s = np.cos(t), np.sin(t)
    to_yarns = np.array([c * c, s * s, -s * c])  # unit stress along t, in warp, weft, shear
    expected = 1.0 / (to_yarns @ compliance(UNEQUAL) @ to_yarns)
    assert UNEQUAL.off_axis_modulus(t) == pytest.approx(expected, rel=1e-12)


def test_off_axis_modulus_of_an_array():
    """Arrays of angles go through at once; along the yarns it is E."""
    values = UNEQUAL.off_axis_modulus(np.array([0.0, np.pi / 2]))
    assert values == pytest.approx([52000.0, 13000.0], rel=1e-12)


def test_spacing():
    """Spacing is the inverse of the count, by family."""
    assert UNEQUAL.spacing("warp") == 1 / 240.0
    assert UNEQUAL.weft.spacing == UNEQUAL.spacing("weft") == 1 / 190.0
    with pytest.raises(InputError, match='"warp" or "weft", not "fill"'):
        UNEQUAL.spacing("fill")


def test_reciprocity():
    """The message says which nu_e would be right, and that one is accepted."""
    with pytest.raises(InputError) as caught:
        replace(UNEQUAL, weft=replace(UNEQUAL.weft, poisson=0.45))
    assert str(caught.value) == (
        "fabric.weft.poisson = 0.45 breaks reciprocity (nu_weft E_warp must equal "
        "nu_warp E_weft), with the other values it would have to be 0.1125"
    )
    replace(UNEQUAL, weft=replace(UNEQUAL.weft, poisson=0.1125 * (1 + 0.9e-6)))
    with pytest.raises(InputError, match="reciprocity"):
        replace(UNEQUAL, weft=replace(UNEQUAL.weft, poisson=0.1125 * (1 + 1.1e-6)))


def test_zero_and_negative_poisson_are_admissible():
    """Only the product counts: without coupling, or widening when pulled, a cloth has an energy."""
    for nu in (0.0, -0.3):
        fabric = Fabric("f", YarnFamily(1e4, nu, 200.0), YarnFamily(1e4, nu, 200.0), 50.0)
        assert np.linalg.eigvalsh(compliance(fabric)).min() > 0


@pytest.mark.parametrize(
    ("family", "change", "message"),
    [
        (
            "warp",
            {"modulus": -1e4},
            "fabric.warp.modulus must be positive and finite, got -100 N/cm",
        ),
        ("weft", {"modulus": 0.0}, "fabric.weft.modulus must be positive and finite, got 0 N/cm"),
        ("weft", {"yarns": 0.0}, "fabric.weft.yarns must be positive and finite, got 0 /cm"),
        ("warp", {"yarns": np.inf}, "fabric.warp.yarns must be positive and finite, got inf /cm"),
        (
            "weft",
            {"yarn_bending": -1e-6},
            "fabric.weft.yarn_bending must be zero or positive and finite, got -1 N mm^2",
        ),
        ("warp", {"poisson": np.nan}, "fabric.warp.poisson must be finite, got nan"),
    ],
)
def test_bad_families(family, change, message):
    """Signs and finiteness, each with its key and a unit."""
    with pytest.raises(InputError) as caught:
        replace(UNEQUAL, **{family: replace(getattr(UNEQUAL, family), **change)})
    assert str(caught.value) == message


@pytest.mark.parametrize("modulus", [0.0, -96.0, np.nan])
def test_bad_shear_modulus(modulus):
    """G is positive."""
    with pytest.raises(InputError, match=r"^fabric\.shear\.modulus must be positive and finite"):
        replace(UNEQUAL, shear_modulus=modulus)


@pytest.mark.parametrize("nu", [1.0, -1.2])
def test_product_of_poisson_ratios(nu):
    """nu_w nu_e = 1 is already too much."""
    with pytest.raises(InputError, match="times fabric.weft.poisson must be less than 1, got 1"):
        Fabric("f", YarnFamily(1e4, nu, 200.0), YarnFamily(1e4, nu, 200.0), 50.0)


def test_unknown_name():
    """The closest and all known names are told."""
    with pytest.raises(InputError) as caught:
        Fabric.from_library("eglass-plain")
    assert str(caught.value).startswith(
        'there is no fabric "eglass-plain" in the library (did you mean "e-glass-plain-2.4"? '
        'known: "e-glass-plain-2.4"'
    )


def test_from_table_names_the_key():
    """What is missing or wrong in a table is told with its place."""
    family = {"modulus": "520 N/cm", "poisson": 0.45, "yarns": "2.4 /cm"}
    table = {"warp": family, "weft": family, "shear": {"modulus": "0.96 N/cm"}}
    assert Fabric.from_table("f", table).warp.yarn_bending == 0.0
    for change, message in [
        ({"shear": {}}, "fabric.shear.modulus is missing"),
        ({"weft": None}, "fabric.weft.modulus is missing"),
        ({"warp": family | {"poisson": "0.4"}}, "fabric.warp.poisson must be a number, got '0.4'"),
        ({"warp": family | {"yarns": 2}}, "fabric.warp.yarns is the bare number 2, give"),
    ]:
        with pytest.raises(InputError) as caught:
            Fabric.from_table("f", table | change)
        assert str(caught.value).startswith(message)


def test_repr():
    """Name and main numbers with units."""
    assert repr(UNEQUAL) == (
        'Fabric("unequal", warp (520 N/cm, nu 0.45, 2.4 /cm, yarn 0.6 N mm^2), '
        "weft (130 N/cm, nu 0.1125, 1.9 /cm, yarn 0.2 N mm^2), shear 0.96 N/cm)"
    )
