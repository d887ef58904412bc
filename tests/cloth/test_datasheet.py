# SPDX-License-Identifier: MIT
"""What follows from a data sheet: closed forms, what replaces it, and what is said of it."""

import json
import re
import textwrap
import tomllib
from pathlib import Path

import numpy as np
import pytest
from scipy.optimize import brentq

from cruciform_petsc import Case, Fabric, InputError
from cruciform_petsc.cli import main
from cruciform_petsc.cloth.datasheet import DatasheetTable, YarnSheet, assumed_shear
from cruciform_petsc.cloth.fabric import FabricTable
from cruciform_petsc.cloth.weave import Weave
from cruciform_petsc.units import Quantity

YARN = {"linear_density": "1200 tex", "yarns": "2.4 /cm", "crimp": "0 %"}
# The yarn of the library's E glass: 2000 filaments of 17 um.
GLASS = {
    "warp": YARN, "weft": YARN,
    "fibre_modulus": "72 GPa", "fibre_density": "2.5 g/cm^3", "fibre_diameter": "17 um",
}  # fmt: skip
FINE = {"linear_density": "1140 den", "yarns": "17 epi"}


def sheet(**changes):
    return DatasheetTable.from_data(GLASS | changes, "fabric.from_datasheet")


def fabric_table(**keys):
    return FabricTable.from_data({"from_datasheet": GLASS} | keys, "fabric")


def test_straight_yarns():
    """Areas of fibres, added up by hand."""
    estimate = sheet().estimate(Weave.named("plain"))
    area = 1200e-6 / 2500.0
    assert estimate.sides["warp"]["modulus"] == pytest.approx(240.0 * area * 72e9, rel=1e-12)
    assert estimate.cloth["areal_density"] == pytest.approx(2 * 240.0 * 1200e-6, rel=1e-12)
    assert estimate.cloth["fibre_density"] == pytest.approx(2500.0)
    # Half of a cloth of unknown thickness is fibre.
    assert estimate.cloth["thickness"] == pytest.approx(2 * 240.0 * area / 0.5, rel=1e-12)
    # One filament's E pi d^4/64, as many times as there are filaments; published: 0.6 N mm^2.
    filaments = area / (np.pi * 17e-6**2 / 4)
    assert filaments == pytest.approx(2000, rel=0.1)
    one = 72e9 * np.pi * 17e-6**4 / 64
    rigidity = estimate.sides["weft"]["yarn_bending"]
    assert rigidity == pytest.approx(filaments * one, rel=1e-12)
    assert rigidity == pytest.approx(0.6e-6, rel=0.05)


def test_commingled_yarns():
    """Only a share bears, all of it weighs; the yarn's density is unknown, and so is thickness."""
    pure, mixed = (sheet(fibre_share=s).estimate(Weave.named("plain")) for s in (1.0, 0.6))
    for key, value in mixed.sides["warp"].items():
        assert value == pytest.approx(0.6 * pure.sides["warp"][key], rel=1e-12)
    assert mixed.cloth == {"areal_density": pytest.approx(pure.cloth["areal_density"])}


@pytest.mark.parametrize("crimp", ["0.5 %", "8 %"])
def test_crimped_yarns_do_not_straighten(crimp):
    """A sawtooth whose height stays, pulled a little: by differences, from its lengths alone."""
    c = float(crimp.split()[0]) / 100
    crimped = {**YARN, "crimp": crimp}
    stiff = [
        sheet(warp=yarn, weft=yarn).estimate(Weave.named("plain"))
        for yarn in (YARN, crimped)
    ]  # fmt: skip
    ratio = stiff[1].sides["warp"]["modulus"] / stiff[0].sides["warp"]["modulus"]
    pitch, step = 1.0, 1e-6
    height = np.sqrt((1 + c) ** 2 - 1) * pitch
    length = np.hypot(pitch, height)
    energy = [  # of a yarn of EA = 1, per length of cloth
        0.5 * ((np.hypot(pitch * (1 + e), height) - length) / length) ** 2 * length / pitch
        for e in (-step, 0.0, step)
    ]
    assert ratio == pytest.approx(np.diff(energy, 2).item() / step**2, rel=1e-4)
    mass = [one.cloth["areal_density"] for one in stiff]
    assert mass[1] == pytest.approx(mass[0] * (1 + c), rel=1e-12)


@pytest.mark.parametrize("weave", ["plain", "twill 2/2", "satin 8"])
def test_crimp_from_thickness(weave):
    """Peirce: h = 4/3 p sqrt(c) at each change of side, one in so many crossings."""
    warp, weft = {**YARN, "crimp": None}, {**YARN, "yarns": "4 /cm", "crimp": None}
    woven = Weave.named(weave)
    crimp = sheet(warp=warp, weft=weft).estimate(woven, thickness=1.2e-3).crimp
    for side, pitch in (("warp", 1 / 400), ("weft", 1 / 240)):  # of the yarns that cross it
        each = brentq(lambda c, p=pitch: 4 / 3 * p * np.sqrt(c) - 0.6e-3, 1e-9, 1.0)
        assert crimp[side] == pytest.approx(each / woven.float_length, rel=1e-9)


def test_near_published_masses():
    """Two cloths of the library that were not made of a sheet: tex and counts give their masses."""
    glass = Fabric.from_table("x", {"from_datasheet": GLASS})
    published = Fabric.from_library("e-glass-plain-2.4")
    assert glass.areal_density == pytest.approx(published.areal_density, rel=1e-9)
    yarn = {"linear_density": "1870 tex", "yarns": "1.93 /cm"}
    mixed = Fabric.from_table("x", {
        "thickness": "1.2 mm", "from_datasheet": GLASS | {"warp": yarn, "weft": yarn},
    })  # fmt: skip
    published = Fabric.from_library("glass-pp-plain-1.93")
    assert mixed.areal_density == pytest.approx(published.areal_density, rel=0.03)


def test_units_of_yarns():
    """Denier and decitex are tex; 9 den are 1 tex."""
    values = [
        YarnSheet.from_data(FINE | {"linear_density": text}).linear_density.si
        for text in ("1140 den", "1266.667 dtex", "126.6667 tex", "0.1266667 g/m")
    ]
    assert values == pytest.approx(4 * [1140 / 9 * 1e-6], rel=1e-6)


def test_all_is_said_and_nothing_else():
    """A sentence for each value that is not given, none for those that are."""
    table = fabric_table()
    told = table.filled_in()
    keys = (
        "warp.modulus", "warp.yarn_bending", "warp.out_of_plane_bending", "warp.poisson",
        "areal_density", "thickness", "shear.modulus", "tension.compression",
    )  # fmt: skip
    assert len(told) == len(keys)
    for key in keys:
        assert sum(f".{key}" in sentence for sentence in told) == 1, key
    assert all(re.search("estimated|assumed|taken as", sentence) for sentence in told)
    # Of the sheet's own crimp nothing is estimated.
    assert not any("crimp =" in sentence for sentence in told)
    uncertain = fabric_table(from_datasheet=GLASS | {"warp": FINE, "weft": FINE}).filled_in()
    assert any("warp.crimp = fabric.from_datasheet.weft.crimp = " in s for s in uncertain)
    side = {"modulus": "300 N/cm", "poisson": 0.1, "yarn_bending": "1 N mm^2",
            "out_of_plane_bending": "2 N mm^2"}  # fmt: skip
    given = fabric_table(
        warp=side, weft=side, shear={"modulus": "1 N/cm"}, tension={"compression": 0.5},
        areal_density="580 g/m^2", thickness="0.6 mm", fibre_density="2.6 g/cm^3",
    )  # fmt: skip
    assert given.filled_in() == []
    fabric = given.build("x")
    assert fabric.warp.modulus == 3e4
    assert fabric.warp.yarns == 240.0
    assert fabric.weft.out_of_plane_bending == pytest.approx(2e-6 * 240)
    assert (fabric.compression, fabric.thickness, fabric.fibre_density) == (0.5, 6e-4, 2600.0)


def test_each_can_be_replaced():
    """One side, a law in place of a modulus, of a rigidity, and one for both sides."""
    tension = {"law": "table", "strain": "%", "force": "N/cm", "points": [[0.5, 10], [1, 50]]}
    moment = {"law": "table", "curvature": "1/cm", "moment": "N mm/mm",
              "points": [[0.1, 0.02], [1, 0.05]]}  # fmt: skip
    table = fabric_table(weft={"tension": tension}, warp={"out_of_plane_moment": moment})
    fabric, plain = table.build("x"), fabric_table().build("x")
    assert fabric.warp.modulus == plain.warp.modulus
    assert fabric.weft_tension.name == "table"
    assert fabric.warp.out_of_plane_bending.name == "table"
    assert fabric.weft.out_of_plane_bending == plain.weft.out_of_plane_bending
    told = " ".join(table.filled_in())
    assert "fabric.warp.modulus = " in told
    assert "fabric.weft.modulus" not in told
    assert "fabric.warp.out_of_plane_bending" not in told
    both = fabric_table(out_of_plane_bending="0.5 N mm")
    assert [law.stiffness0 for law in both.build("x").out_of_plane("it")] == [5e-4, 5e-4]
    assert not any("out_of_plane" in sentence for sentence in both.filled_in())


def test_a_dump_is_the_same_case():
    """As a resumed run reads it."""
    table = fabric_table(weft={"modulus": "300 N/cm"}, weave="satin 5")
    again = FabricTable.from_data(json.loads(json.dumps(table.model_dump(mode="json"))), "fabric")
    assert again.build("x") == table.build("x")
    assert again.filled_in() == table.filled_in()


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"use": "e-glass-plain-2.4"}, "fabric needs either use or from_datasheet, not both"),
        ({"warp": {"yarns": "2 /cm"}},
         "fabric.warp.yarns stands in fabric.from_datasheet, leave it out here"),
        ({"warp": {"modulus": "2 N"}}, 'fabric.warp.modulus = "2 N" has the unit "N"'),
        ({"warp": {"moduls": "2 N/cm"}}, '[fabric.warp] has the unknown key "moduls" (did you'),
        ({"from_datasheet": {**GLASS, "warp": {"yarns": "2 /cm"}}},
         "fabric.from_datasheet.warp.linear_density is missing"),
        ({"from_datasheet": {**GLASS, "warp": FINE | {"linear_density": "200 g"}}},
         'fabric.from_datasheet.warp.linear_density = "200 g" has the unit "g", which is not that '
         'of a linear density like "200 tex"'),
        ({"from_datasheet": {**GLASS, "weft": FINE | {"linear_density": "0 tex"}}},
         'fabric.from_datasheet.weft.linear_density must be positive, got "0 tex"'),
        ({"from_datasheet": {**GLASS, "weft": FINE | {"crimp": "-1 %"}}},
         'fabric.from_datasheet.weft.crimp must be from 0 to 100 %, got "-1 %"'),
        ({"from_datasheet": {**GLASS, "fibre_share": 0}},
         "fabric.from_datasheet.fibre_share must be above 0 and at most 1, got 0"),
        ({"from_datasheet": {**GLASS, "fibre_modulus": 72}},
         'fabric.from_datasheet.fibre_modulus is the bare number 72, give it a unit like '
         '"230 GPa"'),
        ({"thickness": "0.1 mm"}, "fabric.areal_density over fabric.fibre_density is a layer of"),
    ],
)  # fmt: skip
def test_sheets_that_cannot_be(change, message):
    with pytest.raises(InputError) as caught:
        fabric_table(**change).build("x")
    assert str(caught.value).startswith(message)


@pytest.mark.parametrize(
    ("changes", "told"),
    [
        ({"warp": YARN | {"yarns": "1e7 /cm"}}, "areal_density = "),
        ({"fibre_density": "1e-9 g/cm^3"}, "thickness = "),
    ],
)
def test_estimates_beyond_measure(changes, told):
    """Values that each may be, but not together: one sentence, of what follows from them."""
    with pytest.raises(InputError) as caught:
        fabric_table(from_datasheet=GLASS | changes).build("")
    assert str(caught.value).startswith("fabric.from_datasheet: the estimate of fabric.")
    assert "is too large" in str(caught.value)
    assert "np." not in str(caught.value)


def test_masses_that_contradict_each_other():
    """10 % are crimp and size; tex in place of den are not."""
    assert fabric_table(areal_density="600 g/m^2").questions() == []
    (question,) = fabric_table(areal_density="5.2 kg/m^2").questions()
    assert "is a cloth of 576 g/m^2, fabric.areal_density = 5200 g/m^2: are linear_d" in question


CASE = """
[fabric]
weave = "twill 2/2"
areal_density = "900 g/m^2"
[fabric.from_datasheet]
warp = { linear_density = "1200 tex", yarns = "2.4 /cm" }
weft = { linear_density = "1200 tex", yarns = "2.4 /cm" }
fibre_modulus = "72 GPa"
fibre_density = "2.5 g/cm^3"
fibre_diameter = "17 um"
[fabric.weft]
modulus = "600 N/cm"
[preform]
outline = { rectangle = ["24 mm", "48 mm"] }
bias_angle = "45 deg"
[test]
extension = "1 mm"
[output]
pictures = false
paraview = false
report = true
"""


def test_a_case(tmp_path, capfd):
    """Said by `check`, in the log, the summary and the report; a question is a warning there."""
    path = tmp_path / "case.toml"
    path.write_text(CASE)
    told = Case.load(path).fabric_table.filled_in()
    assert len(told) == 8
    assert main(["check", str(path)]) == 0
    checked = capfd.readouterr().out
    assert main(["run", str(path), "--output", str(tmp_path / "out")]) == 0
    log = capfd.readouterr().out
    summary = json.loads((tmp_path / "out" / "summary.json").read_text())
    report = " ".join((tmp_path / "out" / "report.html").read_text().split())
    assert summary["fabric"]["assumed"] == told
    assert "are linear_density, yarns and their units right?" in " ".join(summary["warnings"])
    for sentence in told:
        assert sentence in checked
        assert sentence in log
        assert sentence in report
    known = assumed_shear(told)
    assert "fabric.shear.modulus = 0.5 N/cm is assumed, not measured" in known
    assert known not in checked
    assert known in log
    assert f"<li>{known}.</li>" in report
    measured = [sentence for sentence in told if not sentence.startswith("fabric.shear")]
    assert assumed_shear(measured) == ""
    assert assumed_shear(FabricTable(use="glass-pp-plain-1.93").filled_in()) == ""
    assert assumed_shear(FabricTable(use="pvc-polyester-type-2").filled_in()) != ""


def test_the_example_of_the_docs():
    """docs/datasheet.md: the case in it can be read."""
    page = (Path(__file__).parents[2] / "docs" / "datasheet.md").read_text(encoding="utf-8")
    block = re.search(r"\n\n((?:    .*\n)+)", page)[1]
    table = FabricTable.from_data(tomllib.loads(textwrap.dedent(block))["fabric"], "fabric")
    assert table.questions() == []
    assert table.build("x").warp.yarns == pytest.approx(12.5 / 0.0254)
    assert Quantity.read("5.8 oz/yd^2", "kg/m**2").si == pytest.approx(0.197, rel=5e-3)


def test_a_misspelt_key_has_its_line(tmp_path):
    """As those of any other table."""
    path = tmp_path / "case.toml"
    path.write_text(CASE.replace('fibre_density = "2.5 g/cm^3"', 'fibre_density = "2.5 g"'))
    with pytest.raises(InputError, match=r'case.toml", line 9: .*fibre_density = "2.5 g" has the'):
        Case.load(path)
