# SPDX-License-Identifier: MIT
"""The cloth: constitutive numbers, checks, library."""

import re
from dataclasses import replace

import numpy as np
import pytest

from cruciform_petsc.cloth.fabric import (
    Fabric,
    FabricTable,
    ShearTable,
    YarnFamily,
    fabric_names,
)
from cruciform_petsc.errors import InputError
from cruciform_petsc.laws import linear, odd_polynomial, sin_powers, table

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
    assert (UNEQUAL.warp.spacing, UNEQUAL.weft.spacing) == (1 / 240.0, 1 / 190.0)


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
        ({"shear": {}}, "fabric.shear needs modulus or law"),
        (
            {"weft": None},
            "fabric needs use, from_datasheet, or warp, weft and shear (weft missing)",
        ),
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
    assert repr(UNEQUAL.with_shear_law(sin_powers([48.0]))).endswith(
        "shear 0.96 N/cm at rest by a sin-potential)"
    )
    table = Fabric.from_library("e-glass-plain-2.4", {"shear": SHEAR_TABLE})
    angles = [point[0] for point in SHEAR_TABLE["points"] if point[0]]
    assert repr(table).endswith(f"by a table of {len(angles)} points up to {angles[-1]:g} deg)")


def test_pantographic_sheet():
    """Published values are per area: a beam's rigidity is that times the beams' distance."""
    fabric = Fabric.from_library("pantographic-sheet-2016")
    for family in (fabric.warp, fabric.weft):
        assert family.modulus == pytest.approx(1.34e5, rel=1e-14)
        assert family.spacing == pytest.approx(4.8e-3, rel=1e-14)
        assert family.yarn_bending * family.yarns == pytest.approx(1.92e-2, rel=1e-14)
    assert fabric.shear_modulus == pytest.approx(159.0, rel=1e-14)


def test_glass_pp_says_what_is_assumed():
    """Values that nobody published are marked as such."""
    fabric = Fabric.from_library("glass-pp-plain-1.93")
    assert fabric.warp.yarns == pytest.approx(193.0, rel=1e-14)
    assert fabric.warp.poisson == fabric.weft.poisson == 0.0
    assert fabric.compression == 0.01
    assert "assumed" in fabric.source


# What case files write, reduced to the least.
FAMILY = {"modulus": "400 N/mm", "poisson": 0, "yarns": "2 /cm"}
PLAIN = {"warp": FAMILY, "weft": FAMILY, "shear": {"modulus": "0.1 N/mm"}}
SHEAR_TABLE = {
    "law": "table",
    "angle": "deg",
    "force": "N/mm",
    "points": [[0, 0], [10, 0.01], [40, 0.2]],
}
TENSION_TABLE = {"law": "table", "strain": "%", "force": "N/cm", "points": [[0.5, 10], [1, 50]]}


def test_without_laws_everything_is_linear():
    """The laws of a cloth without laws are its moduli: C11, C22 and G."""
    assert UNEQUAL.warp_tension == linear(UNEQUAL.c11)
    assert UNEQUAL.weft_tension == linear(UNEQUAL.c22)
    assert UNEQUAL.shear == linear(96.0)
    assert (UNEQUAL.log_strain, UNEQUAL.compression, UNEQUAL.compression_width) == (False, 1, 1e-4)
    plain = Fabric.from_table("f", PLAIN)
    assert (plain.shear_law, plain.warp_law, plain.weft_law) == (None, None, None)


@pytest.mark.parametrize(
    ("shear", "law"),
    [
        (SHEAR_TABLE, table(np.radians([0, 10, 40]), [0.0, 10.0, 200.0])),
        (
            {"law": "polynomial", "coefficients": ["0.1 N/mm", "0.3 N/mm"]},
            odd_polynomial([100.0, 300.0]),
        ),
        (
            {
                "law": "sin-potential",
                "coefficients": ["0.0185 N/mm", "0.0464 N/mm", "-0.0213 N/mm"],
            },
            sin_powers([18.5, 46.4, -21.3]),
        ),
    ],
)
def test_shear_laws_from_a_table(shear, law):
    """Units of columns and coefficients; the modulus is the slope at rest."""
    fabric = Fabric.from_table("f", PLAIN | {"shear": shear})
    x = np.linspace(-1.2, 1.2, 25)
    assert np.allclose(fabric.shear.evaluate(x), law.evaluate(x), rtol=1e-12)
    assert fabric.shear_modulus == fabric.shear.stiffness0
    assert fabric.shear_modulus == pytest.approx(law.stiffness0, rel=1e-12)


def test_quantity_of_a_shear_table():
    """F_s/L of a picture frame times cos(gamma) is psi'; a table that names neither is asked."""
    torque = SHEAR_TABLE | {"quantity": "torque per area"}
    named = [
        Fabric.from_table("f", PLAIN | {"shear": shear}).shear
        for shear in (SHEAR_TABLE, torque, torque | {"quantity": "shear force per length"})
    ]
    assert named[0] == named[1]
    x, y = np.radians([10, 40]), np.array([10.0, 200.0])
    assert np.allclose(named[2].evaluate(x)[1], y * np.cos(x), rtol=1e-12)
    asked = ShearTable.from_data(SHEAR_TABLE).question()
    assert asked.startswith("fabric.shear does not name its quantity")
    assert 'at 40 deg, a picture frame\'s "shear force per length" is 31 % more' in asked
    assert ShearTable.from_data(torque).question() is None
    small = SHEAR_TABLE | {"points": [[5, 0.01], [15, 0.02]]}
    assert ShearTable.from_data(small).question() is None
    assert ShearTable.from_data({"modulus": "1 N/cm"}).question() is None
    with pytest.raises(InputError, match="takes modulus without law, not quantity"):
        ShearTable.from_data({"modulus": "1 N/cm", "quantity": "torque per area"})
    with pytest.raises(InputError, match='must be "torque per area" or "shear force per length"'):
        ShearTable.from_data(SHEAR_TABLE | {"quantity": "force"})


def test_tension_law_from_a_table():
    """It stands for the modulus of its family only."""
    warp = {"tension": TENSION_TABLE, "poisson": 0, "yarns": "2 /cm"}
    fabric = Fabric.from_table("f", PLAIN | {"warp": warp})
    force = fabric.warp_tension.evaluate([0.005, 0.01])[1]
    assert force == pytest.approx([1000.0, 5000.0], rel=1e-12)
    assert fabric.warp.modulus == pytest.approx(1000.0 / 0.005, rel=1e-12) == fabric.c11
    assert fabric.weft_tension == linear(4e5)
    assert fabric.weft_law is None


def test_tension_options():
    """Kind of strain and compression."""
    options = {"strain": "log", "compression": 0.01, "compression_width": 1e-3}
    fabric = Fabric.from_table("f", PLAIN | {"tension": options})
    assert (fabric.log_strain, fabric.compression, fabric.compression_width) == (True, 0.01, 1e-3)
    strain = fabric.effective_strain(np.array([1.1, 0.9]))[0]
    assert strain[0] == pytest.approx(np.log(1.1), rel=1e-14)
    # Well below the width the energy is that of 1 % of the stiffness and a constant buckling force.
    s = np.log(0.9)
    assert strain[1] == pytest.approx(-np.sqrt(0.01 * s**2 - 2 * 0.99 * 1e-3 * (s + 1e-3)))
    fabric = Fabric.from_table("f", PLAIN | {"tension": {"strain": "engineering"}})
    assert (fabric.log_strain, fabric.compression, fabric.compression_width) == (False, 1, 1e-4)


def test_changes_to_a_fabric_of_the_library():
    """Shear and tension are replaced, the rest stays."""
    name = "glass-pp-plain-1.93"
    fabric = Fabric.from_library(name, {"shear": SHEAR_TABLE, "tension": {"strain": "log"}})
    assert fabric.name == f"{name}, tension and shear replaced"
    assert fabric.warp == Fabric.from_library(name).warp
    assert fabric.shear.name == "table"
    assert (fabric.log_strain, fabric.compression) == (True, 1.0)
    assert Fabric.from_library(name).shear != fabric.shear


def test_masses_and_thickness():
    """For exports only: a layer of 0.3 mm of glass in 0.75 mm of cloth."""
    data = {"areal_density": "750 g/m^2", "thickness": "0.75 mm", "fibre_density": "2.5 g/cm^3"}
    fabric = Fabric.from_table("f", PLAIN | data)
    values = (fabric.areal_density, fabric.thickness, fabric.fibre_density)
    assert values == pytest.approx((0.75, 0.75e-3, 2500.0), rel=1e-14)
    assert fabric.fibre_volume_fraction == pytest.approx(0.4, rel=1e-14)
    for name in data:
        assert replace(fabric, **{name: None}).fibre_volume_fraction is None
    assert Fabric.from_table("f", PLAIN).areal_density is None


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"areal_density": 576}, "fabric.areal_density is the bare number 576, give it a unit"),
        ({"fibre_density": "2.5 g/cm^2"}, 'fabric.fibre_density = "2.5 g/cm^2" has the unit'),
        ({"thickness": "0 mm"}, "fabric.thickness must be positive and finite, got 0 mm"),
        ({"areal_density": "-1 g/m^2"}, "fabric.areal_density must be positive and finite, got -1"),
        (
            {"areal_density": "750 g/m^2", "thickness": "0.2 mm", "fibre_density": "2.5 g/cm^3"},
            "fabric.areal_density over fabric.fibre_density is a layer of 0.3 mm without any gaps, "
            "which is more than fabric.thickness = 0.2 mm",
        ),
    ],
)
def test_masses_that_cannot_be(changes, message):
    with pytest.raises(InputError, match=re.escape(message)):
        Fabric.from_table("f", PLAIN | changes)


def test_with_shear_law():
    """A calibrator's way: modulus and law stay together."""
    law = table([0.1, 0.5], [3.0, 30.0])
    fabric = UNEQUAL.with_shear_law(law)
    assert fabric.shear is law
    assert fabric.shear_modulus == law.stiffness0
    assert replace(fabric, shear_law=None, shear_modulus=96.0) == UNEQUAL


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (
            {"shear_law": linear(95.0)},
            "fabric.shear_modulus must be the slope of its law at zero, 0.95 N/cm, got 0.96 N/cm",
        ),
        (
            {"shear_law": odd_polynomial([-1.0, 5.0])},
            "fabric.shear is a law whose slope at zero must be positive and finite, got -0.01 N/cm",
        ),
        (
            {"warp_law": linear(UNEQUAL.warp.modulus)},
            "fabric.warp.tension is a law, which needs fabric.warp.poisson = 0, got 0.45",
        ),
        (
            {"weft_law": linear(1.0)},
            "fabric.weft.modulus must be the slope of its law at zero, 0.01 N/cm, got 130 N/cm\n"
            "fabric.weft.tension is a law, which needs fabric.weft.poisson = 0, got 0.1125",
        ),
        ({"compression": 0.0}, "fabric.tension.compression must be above 0 and at most 1, got 0"),
        ({"compression": 2.0}, "fabric.tension.compression must be above 0 and at most 1, got 2"),
        (
            {"compression": np.nan},
            "fabric.tension.compression must be above 0 and at most 1, got nan",
        ),
        (
            {"compression_width": 0.0},
            "fabric.tension.compression_width must be positive and finite, got 0",
        ),
    ],
)
def test_bad_laws(change, message):
    """Laws and moduli that contradict each other."""
    with pytest.raises(InputError) as caught:
        replace(UNEQUAL, **change)
    assert str(caught.value) == message


def without(mapping, key):
    return {name: value for name, value in mapping.items() if name != key}


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (
            {"shear": SHEAR_TABLE | {"modulus": "1 N/cm"}},
            "fabric.shear needs either modulus or law, not both",
        ),
        (
            {"shear": {"modulus": "1 N/cm", "points": [[1, 2]]}},
            "fabric.shear takes modulus without law, not points",
        ),
        (
            {"shear": {"law": "spline"}},
            'fabric.shear.law must be "table", "polynomial" or "sin-potential", got \'spline\'',
        ),
        ({"shear": without(SHEAR_TABLE, "angle")}, "fabric.shear.angle is missing"),
        (
            {"shear": {"law": "polynomial", "coefficients": ["1 N/m"], "angle": "deg"}},
            'fabric.shear takes law, coefficients with law = "polynomial", not angle',
        ),
        (
            {"shear": {"law": "polynomial", "coefficients": ["1 N"]}},
            'fabric.shear.coefficients (value 1) = "1 N" has the unit "N", which is not that of a '
            'force per width like "520 N/cm"',
        ),
        (
            {"shear": {"law": "sin-potential", "coefficients": ["-1 N/cm"]}},
            "fabric.shear is a law whose slope at zero must be positive and finite, got -2 N/cm",
        ),
        (
            {"shear": SHEAR_TABLE | {"points": [[10, 0], [20, 1]]}},
            "fabric.shear is a law whose slope at zero must be positive and finite, got 0 N/cm",
        ),
        (
            {"shear": SHEAR_TABLE | {"force": "N"}},
            'fabric.shear.force = "N" has the unit "N", which is not that of a force per width '
            'like "N/cm"',
        ),
        (
            {"shear": SHEAR_TABLE | {"angle": "rad"}},
            'fabric.shear.points go up to 2291.83 deg, is angle = "deg" meant?',
        ),
        (
            {"shear": SHEAR_TABLE | {"points": [[10, 1], [5, 2]]}},
            "fabric.shear.points: a law's table needs ascending, positive values in its first "
            "column",
        ),
        (
            {"shear": SHEAR_TABLE | {"points": [[10, 1], [5]]}},
            "fabric.shear.points[1] must be a list of 2, got 1",
        ),
        (
            {"shear": SHEAR_TABLE | {"points": [["10 deg", 1]]}},
            "fabric.shear.points[0][0] must be a number, got '10 deg'",
        ),
        (
            {"shear": SHEAR_TABLE | {"points": 3}},
            "fabric.shear.points must be a list, got 3",
        ),
        ({"shear": 3}, "fabric.shear must be a table, got 3"),
        (
            {"warp": FAMILY | {"tension": TENSION_TABLE}},
            "fabric.warp.modulus cannot stand beside tension, a law in its place",
        ),
        (
            {"warp": without(FAMILY, "modulus") | {"tension": TENSION_TABLE, "poisson": 0.3}},
            "fabric.warp.tension is a law, which needs fabric.warp.poisson = 0, got 0.3",
        ),
        (
            {"weft": without(FAMILY, "modulus") | {"tension": TENSION_TABLE | {"strain": "1"}}},
            None,
        ),
        (
            {
                "weft": without(FAMILY, "modulus")
                | {"tension": TENSION_TABLE | {"strain": "1", "points": [[2, 9]]}}
            },
            'fabric.weft.tension.points go up to 200 %, is strain = "%" meant?',
        ),
        (
            {"weft": without(FAMILY, "modulus") | {"tension": without(TENSION_TABLE, "law")}},
            "fabric.weft.tension.law is missing",
        ),
        (
            {"tension": {"strain": "true"}},
            'fabric.tension.strain must be "engineering" or "log", got \'true\'',
        ),
        (
            {"tension": {"compression": "1 %"}},
            "fabric.tension.compression must be a number, got '1 %'",
        ),
        (
            {"tension": {"compresion": 0.1}},
            '[fabric.tension] has the unknown key "compresion" (did you mean "compression"?)',
        ),
    ],
)
def test_bad_laws_in_a_table(change, message):
    """Each mistake is one sentence with its place; None: no mistake."""
    if message is None:
        Fabric.from_table("f", PLAIN | change)
        return
    with pytest.raises(InputError) as caught:
        Fabric.from_table("f", PLAIN | change)
    assert str(caught.value) == message


def woven(**warp):
    """A cloth as in a case file, with more keys of the warp."""
    side = {"modulus": "520 N/cm", "poisson": 0, "yarns": "2.4 /cm"}
    table = {"warp": side | warp, "weft": side, "shear": {"modulus": "1 N/cm"}}
    return Fabric.from_table("woven", table)


@pytest.mark.parametrize(
    "text",
    ["0.144 N mm", "0.6 N mm^2", "1.44e-4 N m", "6e-7 N m^2", "144 N mm^2/m", "1.4684 gf cm^2/cm"],
)
def test_bending_out_of_the_plane(text):
    """Per width, or per yarn times the yarns: the unit tells which (2.4 /cm)."""
    rigidity = woven(out_of_plane_bending=text).warp.out_of_plane_bending
    assert rigidity == pytest.approx(1.44e-4, rel=1e-4)


def test_moments_out_of_the_plane():
    """A table in place of the rigidity: moment per width over curvature; Peirce's units will do."""
    moment = {"law": "table", "curvature": "1/cm", "moment": "N mm/mm"}
    moment["points"] = [[0.1, 0.02], [1, 0.05]]
    law = woven(out_of_plane_moment=moment).warp.out_of_plane_bending
    np.testing.assert_allclose(law.evaluate([10.0, 100.0])[1], [0.02, 0.05])
    assert law.name == "table"


@pytest.mark.parametrize(
    ("keys", "message"),
    [
        ({"out_of_plane_bending": "1 N"}, '.out_of_plane_bending = "1 N" has the unit "N", which '
         'is not that of a flexural rigidity per width like "0.2 N mm", nor a flexural rigidity '
         'like "0.6 N mm^2"'),
        ({"out_of_plane_bending": 1e-3}, ".out_of_plane_bending is the bare number 0.001"),
        ({"out_of_plane_bending": "0 N mm"}, ".out_of_plane_bending must be positive and finite"),
        ({"out_of_plane_bending": "1 N mm", "out_of_plane_moment": {"law": "table",
          "curvature": "1/m", "moment": "N mm/m", "points": [[1, 1]]}},
         ".out_of_plane_bending cannot stand beside out_of_plane_moment"),
        ({"out_of_plane_moment": {"law": "table", "curvature": "1/mm", "moment": "N",
          "points": [[20, 1]]}}, '.points go up to 200 /cm, is curvature = "1/m" meant?'),
    ],
)  # fmt: skip
def test_bending_that_cannot_be(keys, message):
    with pytest.raises(InputError, match=re.escape(message)):
        woven(**keys)


def test_what_a_fabric_lacks():
    """Said by the key, with what wants it and an example; all fabrics of the library bend."""
    with pytest.raises(InputError, match="fabric.weft.out_of_plane_bending is missing, which this"):
        woven(out_of_plane_bending="1 N mm").out_of_plane("this")
    message = 'fabric.areal_density is missing, which gravity needs: for example "576 g/m^2"'
    with pytest.raises(InputError, match=re.escape(message)):
        woven().needed("areal_density", "gravity")
    for name in fabric_names():
        fabric = Fabric.from_library(name)
        assert all(1e-5 < law.stiffness0 < 0.1 for law in fabric.out_of_plane("this")), name
        assert "out of plane" in repr(fabric)


def test_bending_beside_a_fabric_of_the_library():
    """Measured rigidities in place of the assumed ones, of both families; per width or per yarn."""
    for text, rigidity in (("0.5 N mm", 5e-4), ("1 N mm^2", 2.4e-4)):
        fabric = Fabric.from_library("e-glass-plain-2.4", {"out_of_plane_bending": text})
        laws = fabric.out_of_plane("this")
        assert [law.stiffness0 for law in laws] == pytest.approx([rigidity, rigidity])
        assert fabric.name == "e-glass-plain-2.4, out_of_plane_bending replaced"


# -- what may be left out ---------------------------------------------------------------------


def of_poisson(warp, weft):
    """A cloth of unlike moduli, with these ratios; None: left out."""
    table = {"shear": {"modulus": "1 N/cm"}}
    for side, modulus, poisson in (("warp", "600 N/cm", warp), ("weft", "250 N/cm", weft)):
        table[side] = {"modulus": modulus, "yarns": "2 /cm"}
        table[side] |= {} if poisson is None else {"poisson": poisson}
    table = FabricTable.from_data(table, "fabric")
    return table.build("x"), table.filled_in()


def test_poisson_ratios_that_are_left_out():
    """Zero, or what reciprocity says: nu_weft E_warp = nu_warp E_weft."""
    fabric, said = of_poisson(None, None)
    assert (fabric.warp.poisson, fabric.weft.poisson) == (0.0, 0.0)
    assert said == ["fabric.warp.poisson and fabric.weft.poisson are taken as 0"]
    fabric, said = of_poisson(0.6, None)
    assert fabric.weft.poisson == pytest.approx(0.25)
    assert said == ["fabric.weft.poisson is taken as 0.25, by reciprocity"]
    fabric, said = of_poisson(None, 0.25)
    assert fabric.warp.poisson == pytest.approx(0.6)
    assert said == ["fabric.warp.poisson is taken as 0.6, by reciprocity"]
    fabric, said = of_poisson(0, None)
    assert fabric.weft.poisson == 0.0
    assert of_poisson(0.6, 0.25)[1] == []


def test_moduli_have_limits():
    """In Python, too; and so have the slopes that laws begin with."""
    family = YarnFamily(1e12, 0.0, 200.0)
    assert Fabric("x", family, family, 1e-12).shear_modulus == 1e-12
    with pytest.raises(InputError, match=r"fabric.shear.modulus must be from 1e-14 N/cm to"):
        Fabric("x", family, family, 1e-300)
    with pytest.raises(InputError, match=r"fabric.warp.modulus must be from .*got 1e\+298 N/cm"):
        Fabric("x", replace(family, modulus=1e300), family, 1.0)
    points = {"law": "table", "angle": "rad", "force": "N/m", "points": [[1e-300, 1e-3], [1, 1]]}
    with pytest.raises(InputError, match=r"fabric.shear"):
        Fabric.from_library("e-glass-plain-2.4", {"shear": points})


@pytest.mark.parametrize("log", [False, True])
def test_prestretch(log):
    """Stretches at which both families have the tensions over the width as it is, coupled ones."""
    fabric = replace(UNEQUAL, log_strain=log)
    warp, weft = fabric.prestretch(900.0, 400.0)
    e = np.log([warp, weft]) if log else np.array([warp, weft]) - 1.0
    slope = 1.0 / np.array([warp, weft]) if log else 1.0
    c11, c12, c22 = UNEQUAL.c11, UNEQUAL.c12, UNEQUAL.c22
    stress = slope * np.array([c11 * e[0] + c12 * e[1], c22 * e[1] + c12 * e[0]])
    np.testing.assert_allclose(stress / [weft, warp], [900.0, 400.0], rtol=1e-9)
    np.testing.assert_allclose(fabric.tensions([warp, weft]), [900.0, 400.0], rtol=1e-9)
    assert fabric.prestretch(0.0, 0.0) == (1.0, 1.0)
    with pytest.raises(InputError, match="stretches the cloth by more than 20 %"):
        fabric.prestretch(2e4, 400.0)
