# SPDX-License-Identifier: MIT
"""[fabric] tension.surface and tension.crimp: units, files, yarn counts, mistakes in a sentence."""

from pathlib import Path

import numpy as np
import pytest
from support.biaxial import CRIMP, grid, points_of

from cruciform_petsc import Fabric, InputError
from cruciform_petsc.case.schema import Case
from cruciform_petsc.cloth.biaxial import points_of_file
from cruciform_petsc.cloth.fabric import FabricTable

DEMOS = Path(__file__).parents[2] / "demos"
YARNS = {"warp": {"yarns": "4 /cm"}, "weft": {"yarns": "5 /cm"}, "shear": {"modulus": "1 N/cm"}}
HEIGHTS = {
    "warp_height": "0.2 mm", "weft_height": "0.15 mm", "warp_stiffness": "3 kN",
    "weft_stiffness": "2.5 kN", "warp_bending": "0.001 N mm^2", "weft_bending": "0.002 N mm^2",
}  # fmt: skip
CRIMPED = {**HEIGHTS, "crossover_stiffness": "8000 N/mm"}
POINTS = points_of(CRIMP.law, grid(0.0, 0.02, 6)) * [100.0, 100.0, 1e-2, 1e-2]  # %, N/cm
INLINE = {"strain": "%", "force": "N/cm", "points": POINTS.tolist()}
TITLES = "warp strain (%), weft strain (%), warp tension (N/cm), weft tension [N/cm]"


def cloth(tension, **more):
    """A fabric of these yarns."""
    return Fabric.from_table("mine", {**YARNS, "tension": tension, **more})


def write(folder, titles=TITLES, points=POINTS):
    """A file of points."""
    rows = [", ".join(f"{value:.9g}" for value in row) for row in points]
    path = folder / "biaxial.csv"
    path.write_text("\n".join(["# measured by nobody", titles, "", *rows]) + "\n")
    return str(path)


def test_crimp():
    """Its numbers in SI; a crossover that stiffens is a table."""
    assert cloth({"crimp": CRIMPED}).biaxial_law == CRIMP.law
    table = {"law": "table", "distance": "mm", "force": "N", "points": [[0.01, 1], [0.02, 20]]}
    stiffer = cloth({"crimp": {**HEIGHTS, "crossover": table}, "compression": 0.1})
    assert stiffer.biaxial_law.data[9] == 3.0
    assert stiffer.compression == 0.1
    told = FabricTable.from_data({**YARNS, "tension": {"crimp": CRIMPED}}, "fabric").filled_in()
    assert told == [
        "fabric.tension.crimp: the warp is crimped by 0.499 %, the weft by 0.18 %"
    ]  # fmt: skip


@pytest.mark.parametrize("size", [0.05, 0.1, 0.5, 2.0, 50.0])
def test_tension_of_limp_crimped_cloth(size):
    """Stretches at a pretension, where stiffness is a hundred times that at rest, or not yet."""
    fabric = Case.load(DEMOS / "calibrate_crimp.toml").fabric()
    for share in (1.0, 0.5, 0.0):
        wanted = 100.0 * size * np.array([1.0, share])
        stretch = fabric.prestretch(*wanted)
        np.testing.assert_allclose(fabric.tensions(stretch), wanted, atol=1e-6 * wanted[0])


@pytest.mark.parametrize("how", ["inline", "file", "per yarn", "file, one per yarn"])
def test_surface(how, tmp_path):
    """The same law from points, from a file, and from forces per yarn, to the digits written."""
    points, tension = POINTS.copy(), INLINE
    if how == "per yarn":
        points[:, 2:] *= [0.25, 0.2]  # 4 and 5 yarns a centimetre
        tension = {"strain": "%", "force": "N", "points": points.tolist()}
    elif how == "file":
        tension = {"file": write(tmp_path)}
    elif how == "file, one per yarn":
        points[:, 3] *= 0.2
        tension = {"file": write(tmp_path, TITLES.replace("[N/cm]", "(N)"), points)}
    law = cloth({"surface": tension}).biaxial_law
    e = grid(0.0, 0.02, 11)
    found, expected = (given.evaluate(*e.T)[1] for given in (law, CRIMP.law))
    np.testing.assert_allclose(found, expected, atol=5e-3 * expected.max())


def test_points_of_a_file_in_si(tmp_path):
    """Forces of warp yarns times their number, 400 a metre, tensions of the weft as they are."""
    points = POINTS * [1.0, 1.0, 0.25, 1.0]
    path = write(tmp_path, TITLES.replace("(N/cm)", "(N)"), points)
    np.testing.assert_allclose(
        points_of_file(path, 400.0, 500.0), POINTS * [0.01, 0.01, 100.0, 100.0], rtol=1e-8
    )


def test_what_is_told_of_a_surface():
    """How near it is to the points; a surface far from them is asked after, one further refused."""

    def table(curl):
        twisted = POINTS.copy()
        twisted[:, 2] += curl * POINTS[:, 1]
        twisted[:, 3] -= curl * POINTS[:, 0]
        surface = {**INLINE, "points": twisted.tolist()}
        return FabricTable.from_data({**YARNS, "tension": {"surface": surface}}, "fabric")

    good = table(0.0)
    assert good.questions() == []
    (told,) = good.filled_in()
    assert "convex energy's tensions are 0.048 % (RMS) off its 36 points, at most 0.14 %" in told
    (question,) = table(20.0).questions()
    assert question.startswith("fabric.tension.surface is ")
    with pytest.raises(InputError, match=r"dT_warp/de_weft = dT_weft/de_warp, are \d\d % \(RMS\)"):
        table(200.0).build("mine")
    line = np.linspace(0.0, 0.02, 10)[:, None]
    close = points_of(CRIMP.law, np.concatenate([line * (1.0, 0.9), line * (0.9, 1.0)]))
    surface = {"strain": "1", "force": "N/m", "points": close.tolist()}
    told = FabricTable.from_data({**YARNS, "tension": {"surface": surface}}, "fabric").filled_in()
    assert told[1].startswith("fabric.tension.surface has no points nearby in ")


def test_beside_the_library_and_a_data_sheet():
    """It takes the place of their moduli."""
    fabric = Fabric.from_library("glass-pp-plain-1.93", {"tension": {"crimp": CRIMPED}})
    assert fabric.biaxial_law.data[1] == pytest.approx(1 / 193.0)
    assert fabric.c11 == pytest.approx(fabric.biaxial_law.stiffness0[0])
    table = FabricTable.from_data(
        {"use": "glass-pp-plain-1.93", "tension": {"crimp": CRIMPED}}, "fabric"
    )
    told = table.filled_in()
    assert told[0].startswith("fabric.tension.crimp: the warp is crimped by 0.0745 %")
    assert not any("modulus" in sentence or "poisson" in sentence for sentence in told)
    yarn = {"linear_density": "300 tex", "yarns": "4 /cm", "crimp": "0 %"}
    sheet = {
        "warp": yarn, "weft": yarn, "fibre_modulus": "72 GPa", "fibre_density": "2.5 g/cm^3",
        "fibre_diameter": "17 um",
    }  # fmt: skip
    table = FabricTable.from_data(
        {"from_datasheet": sheet, "tension": {"crimp": CRIMPED}}, "fabric"
    )
    assert table.build("sheet").biaxial_law is not None
    assert not any("modulus" in sentence and "warp" in sentence for sentence in table.filled_in())


def test_files_stand_beside_the_case(tmp_path):
    """As those of tools and measured curves do."""
    write(tmp_path)
    (tmp_path / "case.toml").write_text(
        """
        [fabric]
        warp = { yarns = "4 /cm" }
        weft = { yarns = "5 /cm" }
        shear = { modulus = "1 N/cm" }
        tension = { surface = { file = "biaxial.csv" } }
        [preform]
        outline = { rectangle = ["20 mm", "20 mm"] }
        bias_angle = "0 deg"
        [test]
        kind = "biaxial"
        strain = "1 %"
        bending = false
        """
    )
    case = Case.load(tmp_path / "case.toml")
    assert case.fabric().biaxial_law.name == "surface"
    again = Case.from_data(case.model_dump(exclude_none=True))
    assert again.fabric() == case.fabric()


def without(*keys):
    """The crimp's table without some keys."""
    return {key: value for key, value in CRIMPED.items() if key not in keys}


BAD = {
    "fabric.tension takes either surface or crimp, not both": {"surface": INLINE, "crimp": CRIMPED},
    'fabric.tension.strain must be "engineering" beside crimp': {"crimp": CRIMPED, "strain": "log"},
    "fabric.tension.crimp.warp_height is missing": {"crimp": without("warp_height")},
    "fabric.tension.crimp needs either crossover_stiffness or crossover": {"crimp": HEIGHTS},
    'fabric.tension.crimp.weft_bending must be positive, got "0 N mm^2"': {
        "crimp": {**CRIMPED, "weft_bending": "0 N mm^2"}
    },
    "fabric.tension.crimp.warp_stiffness": {"crimp": {**CRIMPED, "warp_stiffness": "3 N/cm"}},
    "fabric.tension.surface needs file, or strain, force and points": {"surface": {"strain": "%"}},
    "fabric.tension.surface needs either file or strain, force and points, not strain too": {
        "surface": {**INLINE, "file": "x.csv"}
    },
    'fabric.tension.surface.points go up to 200 %, is strain = "%" meant?': {
        "surface": {**INLINE, "strain": "1"}
    },
    "fabric.tension.surface.points[2] must be a list of at least 4, got 3": {
        "surface": {**INLINE, "points": [[0, 0, 0, 0], [1, 0, 1, 0], [0, 1, 1]]}
    },
    "fabric.tension.surface: a surface of tension needs several strains of the weft": {
        "surface": {**INLINE, "points": (POINTS * [1, 0, 1, 1]).tolist()}
    },
    'fabric.tension.surface.file: surface of tension "nowhere.csv" does not exist': {
        "surface": {"file": "nowhere.csv"}
    },
}


@pytest.mark.parametrize("message", BAD)
def test_bad_tables(message):
    """One sentence each."""
    with pytest.raises(InputError) as caught:
        cloth(BAD[message])
    assert str(caught.value).startswith(message)
    assert "\n" not in str(caught.value)


def test_moduli_beside_a_law_of_both():
    """The law has them."""
    with pytest.raises(InputError, match=r"fabric\.warp\.modulus cannot stand beside tension\.sur"):
        cloth({"crimp": CRIMPED}, warp={"yarns": "4 /cm", "modulus": "1 N/cm"})
    with pytest.raises(InputError, match=r"fabric\.weft\.poisson cannot stand beside"):
        cloth({"crimp": CRIMPED}, weft={"yarns": "4 /cm", "poisson": 0.1})


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "needs a line of titles like warp strain (%)"),
        ("warp strain (%), weft strain (%)\n1, 2", "line 1: needs four titles like"),
        (TITLES.replace(" (%)", "", 1) + "\n0,0,0,0", 'the title "warp strain" has no unit'),
        (TITLES.replace("(N/cm)", "(N/cm^2)") + "\n0,0,0,0", "which is not that of a force per"),
        ("a (%), b (%), c (N), d (N)\n0,0,0,0", 'titles must be warp strain (%), weft strain'),
        (TITLES + "\n0,0,0,0\n1,x,2,3", "line 3: needs four numbers with commas between them"),
        (TITLES + "\n0,0,0,0\n1,nan,2,3", "line 3: needs four numbers with commas between them"),
    ],
)  # fmt: skip
def test_bad_files(text, message, tmp_path):
    """The file and the line are named."""
    path = tmp_path / "bad.csv"
    path.write_text(text)
    with pytest.raises(InputError) as caught:
        cloth({"surface": {"file": str(path)}})
    start = f'fabric.tension.surface.file: surface of tension "{path}"'
    assert str(caught.value).startswith(start)
    assert message in str(caught.value)
