# SPDX-License-Identifier: MIT
"""Several results over each other, and results of specimens of different sizes."""

import json

import numpy as np
import pytest

from cruciform_petsc.cli import main
from cruciform_petsc.compare import BY, compare, read_side
from cruciform_petsc.errors import InputError


def results(folder, columns, size=None, kind="bias-extension"):
    """A folder with a table of results, and a case of that size."""
    folder.mkdir()
    rows = [
        ",".join(columns),
        *(",".join(map(str, row)) for row in zip(*columns.values(), strict=True)),
    ]
    (folder / "curve.csv").write_text("\n".join(rows) + "\n")
    summary = {"title": folder.name, "kind": kind}
    if size is not None:
        outline = {"rectangle": [f"{side} mm" for side in size]}
        summary["case"] = {"preform": {"outline": outline, "bias_angle": "45 deg"}}
    (folder / "summary.json").write_text(json.dumps(summary))
    return folder


def similar(folder, factor, **more):
    """A specimen of 100 mm x 200 mm, or one that is so many times as large in all."""
    strain, load = np.array([0.05, 0.1, 0.2]), np.array([1.0, 2.0, 8.0])
    columns = {
        "extension_mm": 200 * factor * strain,
        "load_N": factor * load,
        "shear_middle_deg": 100 * strain,
        "shear_centre_deg": 200 * strain,
        "shear_force_N_per_mm": load / 50.0,
    }
    return results(folder, columns | more, size=(100 * factor, 200 * factor))


def test_loads_of_assumed_shear_are_not_compared_without_a_word(tmp_path, capsys):
    """Two data sheets have the same shear, whatever their cloths."""
    sheet, given = similar(tmp_path / "sheet", 1), similar(tmp_path / "given", 1)
    for folder, told in (
        (sheet, ["fabric.shear.modulus = 0.5 N/cm, assumed, by no data"]),
        (given, []),
    ):
        summary = json.loads((folder / "summary.json").read_text())
        summary["fabric"] = {"assumed": told}
        (folder / "summary.json").write_text(json.dumps(summary))
    out = tmp_path / "out"
    for sides, letters in (
        ((sheet, given), ["a"]),
        ((sheet, sheet), ["a", "b"]),
        ((given,) * 2, []),
    ):
        assert main(["compare", *map(str, sides), "--output", str(out)]) == 0
        said = capsys.readouterr().out
        assert ("is assumed, not measured" in said) == bool(letters)
        assert json.loads((out / "comparison.json").read_text())["shear_assumed"] == letters


@pytest.mark.parametrize("by", ["strain", "shear"])
def test_similar_specimens_are_the_same_apart_from_size(tmp_path, by):
    """Over the extension they are not."""
    sides = [read_side(similar(tmp_path / f"s{factor}", factor)) for factor in (1, 2, 0.5)]
    told, figures, lines = compare(sides, by)
    assert told["relative_to"] == "c"
    assert list(told["differences"]) == ["a", "b"]
    assert told["over"] == {"strain": "strain_percent", "shear": "shear_angle_deg"}[by]
    for each in figures:
        assert {"load_per_width_N_per_mm"} < each.keys()
        assert all(abs(value.largest) < 1e-12 for value in each.values())
    assert ("shear_force_N_per_mm" in figures[0]) == (by == "shear")
    x, y = lines["load_per_width_N_per_mm"][2]
    assert y[-1] == pytest.approx(8.0 / 100.0)  # N/mm
    assert x[-1] == pytest.approx(20.0)  # %, or degrees of the middle zone
    with_size = compare(sides)[1][0]["load_N"]
    assert abs(with_size.largest) > 0.4


def test_a_frame_beside_a_bias_test(tmp_path):
    """By shear angle: the frame's own, and the same normalised shear force."""
    frame = {"angle_deg": [5, 10, 20], "load_N": [2, 5, 20], "crosshead_mm": [3, 7, 14]}
    frame |= {"shear_centre_deg": [1, 1, 1], "shear_force_N_per_mm": [0.022, 0.044, 0.176]}
    one = read_side(results(tmp_path / "f", frame, (50, 50), "picture-frame"))
    other = read_side(similar(tmp_path / "b", 1))
    _, (figures,), _ = compare([one, other], "shear")
    # The bias test has 0.02, 0.04 and 0.16 N/mm at these angles of its middle zone.
    force = figures["shear_force_N_per_mm"]
    assert force.largest == pytest.approx(0.1, rel=1e-9)
    assert compare([one, other], "displacement")[0]["over"] == "displacement_mm"
    with pytest.raises(InputError, match=r"\(--by\) they may be"):
        compare([one, other])
    with pytest.raises(InputError, match="has no load over a strain"):
        compare([other, one], "strain")


def test_three_on_the_command_line(tmp_path, capsys):
    """A measured curve last: all differences are to it; one picture, one table of each."""
    folders = [similar(tmp_path / f"s{factor}", factor) for factor in (1, 2)]
    csv, out = tmp_path / "measured.csv", tmp_path / "out"
    csv.write_text("displacement [mm], force [N]\n5, 0.5\n10, 1\n20, 2\n40, 8\n")
    paths = [*map(str, folders), str(csv)]
    assert main(["compare", *paths, "--output", str(out)]) == 0
    said = capsys.readouterr().out
    assert all(words in said for words in ("A less C", "B less C"))
    assert "specimens differ in size: --by strain" in said
    told = json.loads((out / "comparison.json").read_text())
    assert {letter: told[letter]["path"] for letter in "abc"} == dict(
        zip("abc", paths, strict=True)
    )
    assert told["differences"]["a"]["load_N"]["end_relative"] == pytest.approx(0.0, abs=1e-9)
    assert (out / "comparison.png").stat().st_size > 1000
    many = [str(similar(tmp_path / f"m{i}", 1 + 0.1 * i)) for i in range(9)]
    assert main(["compare", *many, str(csv), "--output", str(out), "--quiet"]) == 0


@pytest.mark.parametrize(
    ("by", "said"),
    [
        ("strian", 'there is no way to compare "strian" (did you mean "strain"?'),
        ("strain", "tells no sizes of its specimen, compare by displacement"),
    ],
)
def test_refused(tmp_path, capsys, by, said):
    csv = tmp_path / "measured.csv"
    csv.write_text("displacement [mm], force [N]\n5, 0.5\n10, 1\n20, 2\n40, 8\n")
    one = similar(tmp_path / "s", 1)
    assert main(["compare", str(one), str(csv), "--by", by, "--output", str(tmp_path / "o")]) == 2
    told = capsys.readouterr().err
    assert said in told
    assert len(told.splitlines()) == 1
    (tmp_path / "forming").mkdir()
    (tmp_path / "forming" / "forces.csv").write_text("stage,asked\n")
    assert main(["compare", str(one), str(tmp_path / "forming")]) == 2
    assert "is of a forming" in capsys.readouterr().err
    assert set(BY) == {"displacement", "strain", "shear"}
