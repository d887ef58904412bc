# SPDX-License-Identifier: MIT
"""Measured curves as machines and spreadsheets write them: read, or refused with the line."""

import time
from pathlib import Path

import numpy as np
import pytest

from cruciform_petsc.calibration import MeasuredCurve, read_curve
from cruciform_petsc.errors import InputError

DATA = Path(__file__).parent / "data"


@pytest.mark.parametrize(
    "text",
    [
        "displacement [mm], force [N]\n1, 0.5\n2, 1\n4, 2\n5.5, 2.5\n",
        "extension_mm,load_N\n1,0.5\n2,1\n4,2\n5.5,2.5\n",
        "displacement (mm);force (N)\n1;0,5\n2;1\n4;2\n5,5;2,5\n",
        "\ufeffWeg [mm]\tKraft [N]\n1\t0,5\n2\t1\n4\t2,0\n5,5\t2,5\n",
        "# a comment\n\nForce / N, Travel / m\n0.5, 1e-3\n# more\n1, 2e-3\n2, 4e-3\n2.5, .0055\n",
        "crosshead cm,load kN\n.1,.0005\n.2,.001\n.4,.002\n.55,.0025\n",
        '"Displacement","Load"\n"(mm)","(N)"\n"0","0"\n"1","0.5"\n"2","1"\n"4","2"\n"5.5","2.5"\n',
        # The curve that this program writes: further columns are not looked at.
        "extension_mm,load_N,shear_max_deg,energy_shear_J\n1,.5,3,0\n2,1,5,0\n4,2,,\n5.5,2.5,9,1\n",
    ],
)
def test_reads_what_machines_write(tmp_path, text):
    path = tmp_path / "curve.csv"
    path.write_text(text, encoding="utf-8")
    curve = read_curve(path)
    np.testing.assert_allclose(curve.displacement, [1e-3, 2e-3, 4e-3, 5.5e-3], rtol=1e-14)
    np.testing.assert_allclose(curve.force, [0.5, 1.0, 2.0, 2.5], rtol=1e-14)


HEAD = "displacement [mm], force [N]\n"


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "is empty"),
        ("1, 2\n2, 3\n", "has no header with units, write for example"),
        (
            "displacement, force\n1, 2\n",
            'no column with a unit of displacement in its header "disp',
        ),
        ("displacement [mm], force [kg]\n1, 2\n", "no column with a unit of force"),
        ("d [mm], e [mm], F [N]\n1, 2, 3\n", "2 columns with a unit of displacement"),
        (HEAD + "1, 2\n2, x\n", 'line 3: force must be a finite number, got "x"'),
        (HEAD + "1, 2\n2,\n", 'line 3: force must be a finite number, got ""'),
        (HEAD + "1, 2\n2, nan\n", "line 3: force must be a finite number"),
        (HEAD + "1, 2\n2\n", 'line 3: force must be a finite number, got ""'),
        (HEAD + "1,5, 2,5\n", "line 2, has 4 columns instead of 2, decimal commas need semicolons"),
        (HEAD + "1, 2\n2, 3\n3, 4\n", "has 3 points with a displacement, at least 4"),
        (HEAD + "1, 2\n2, -3\n3, 4\n4, 5\n", "must be positive, it is -3 N at 2 mm"),
        (HEAD + "-1, 2\n2, 3\n3, 4\n4, 5\n", "negative displacement -1 mm"),
        (HEAD + "1, 2\n2, 3\n3, 4\n4, 5\n2, 1\n5, 6\n", "turns back after 4 mm and goes on"),
        ("\0\0", "is not a text file"),
    ],
)
def test_bad_curves_are_one_sentence(tmp_path, text, message):
    path = tmp_path / "curve.csv"
    path.write_text(text)
    with pytest.raises(InputError) as error:
        read_curve(path)
    assert message in str(error.value)
    assert str(path) in str(error.value)
    assert "\n" not in str(error.value)


def test_missing_curve(tmp_path):
    with pytest.raises(InputError, match="does not exist"):
        read_curve(tmp_path / "no.csv")
    with pytest.raises(InputError, match="is a folder"):
        read_curve(tmp_path)


def test_many_rows_are_averaged():
    """Noise of neighbours averages out; a line stays a line."""
    rng = np.random.default_rng(1)
    d = np.sort(rng.uniform(0.0, 0.05, 3000))
    curve = MeasuredCurve.from_points(d, 100.0 * d + 1.0 + rng.normal(0, 0.1, 3000), most=30)
    assert (len(curve.force), curve.rows) == (30, 3000)
    # 0.1 over the root of 100 rows is 0.01; four times that.
    np.testing.assert_allclose(curve.force, 100.0 * curve.displacement + 1.0, atol=0.04)


# -- files of others ---------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("name", "points", "ends"),
    [
        ("preamble_tabs.dat", 20, (2.0, 0.75075, 40.0, 6.75)),
        ("stiffness_column.csv", 40, (1.0, 0.7501, 40.0, 6.75)),
        ("sep_line.csv", 20, (2.0, 0.7507, 40.0, 6.75)),
        ("bias_glass_plain_115x230.csv", 43, (0.3497, 0.3597, 47.42, 17.85)),
        ("noise_at_start.csv", 21, (0.5, 0.3, 40.0, 6.75)),
        ("rupture_tail.csv", 20, (2.0, 0.7507, 40.0, 6.75)),
    ],
)
def test_files_of_others(name, points, ends):
    curve = read_curve(DATA / name)
    assert len(curve.force) == points
    d, f = 1e3 * curve.displacement, curve.force
    assert (d[0], f[0], d[-1], f[-1]) == pytest.approx(ends, rel=1e-3)


def test_units_stand_whole():
    """N/mm is no mm, nor are the other units that end with one."""
    with pytest.raises(InputError, match="no column with a unit of displacement in its header"):
        read_curve(DATA / "unit_with_slash.csv")


@pytest.mark.parametrize(
    "title",
    [
        "Force/width N/mm",
        "k (N/mm)",
        "stiffness_N_per_mm",
        "Force (N)/mm",
        "N / mm",
        "Moment N mm",
        "Moment [N*mm]",
        "work_N_mm",
        "Area mm^2",
        "Area (mm2)",
        "Density 1/mm",
        "pressure N/mm²",
        "Force per width (mm)",
        "Way [((mm]",
    ],
)
def test_no_lengths_and_no_forces(tmp_path, title):
    """Beside a true pair they are left alone, by themselves they are no column."""
    path = tmp_path / "curve.csv"
    path.write_text(f"{title};Weg mm;Kraft N\n9;1;1\n9;2;2\n9;3;3\n9;4;4\n", encoding="utf-8")
    np.testing.assert_allclose(read_curve(path).force, [1, 2, 3, 4])
    path.write_text(f"{title};Kraft N\n9;1\n9;2\n9;3\n9;4\n", encoding="utf-8")
    with pytest.raises(InputError, match="no column with a unit of displacement"):
        read_curve(path)


ROWS = "1{0}0.5\n2{0}1\n4{0}2\n5.5{0}2.5\n"


@pytest.mark.parametrize(
    ("text", "encoding"),
    [
        ("Weg in mm;Kraft in N\n" + ROWS.format(";"), "utf-16"),
        ("Weg in mm;Kraft in N\n" + ROWS.format(";"), "utf-16-le"),
        ("Weg in mm;Kraft in N\n" + ROWS.format(";"), "utf-32"),
        ("Prüfweg (mm)\tStandardkraft (N)\n" + ROWS.format("\t"), "cp1252"),
        ("s / mm | F / N\n" + ROWS.format(" | "), "utf-8"),
        ("d/mm,F/N\r" + ROWS.format(",").replace("\n", "\r"), "utf-8"),
        ("Extension {mm},Load <N>\r\n" + ROWS.format(",").replace("\n", "\r\n"), "utf-8"),
        ("Displacement, mm;Load, N;\n" + ROWS.format(";").replace("\n", ";\n"), "utf-8"),
        ('"Extension\n(mm)","Load\n(N)"\n' + ROWS.format(","), "utf-8"),
        ("# displacement [mm] force [N]\n" + ROWS.format(" "), "utf-8"),
        ("% made by hand\n// units: see below\nDisp  Load\nmm    N\n" + ROWS.format("  "), "utf-8"),
        ("Crosshead travel [mm]   Load [N]\n" + ROWS.format("\t"), "utf-8"),
        ("Width: 115 mm, cell: 1 kN\nd_mm,f_N\n" + ROWS.format(","), "utf-8"),
        (",d_mm,f_N\n0,1,0.5\n1,2,1\n2,4,2\n3,5.5,2.5\n", "utf-8"),
        ("Weg (mm);Kraft (N)\n(mm);(N)\n" + ROWS.format(";"), "utf-8"),
        ("d [mm],F [N],remark\n1,0.5,slips\n2,1\n4,2,\n5.5,2.5,,\n,,\n", "utf-8"),
        ("d [mm],F [N]\n1,0.5 # first\n2,1\n\n# between\n4,2\n5.5,2.5\n", "utf-8"),
        ("d [um];F [mN]\n1.000;500\n2.000;1.000\n4.000;2.000\n5.500,0;2.500\n", "utf-8"),
        ('d [um],F [mN]\n"1,000.0",500\n"2,000","1,000"\n"4,000","2,000"\n5500,2500\n', "utf-8"),
        ("d [um]\tF [mN]\n1\u202f000\t500\n2 000\t1e3\n4'000\t2E+03\n5\u2019500\t2500\n", "utf-8"),
        ('"d [mm]","F [N]"\n"1,0","0,5"\n"2,0","1,0"\n"4,0","2,0"\n"5,5","2,5"\n', "utf-8"),
        ("d [mm],F [N]\n-0.0,0.0\n1,0.5\n2,1\n4,2\n5.5,2.5\n", "utf-8"),
        (
            "d [nm];F [mN]\n1.000.000;500\n2.000.000;1.000\n4.000.000;2.000\n5.500.000;2.500\n",
            "utf-8",
        ),
        ('"sep=,"\nd [mm],F [N]\n' + ROWS.format(","), "utf-8"),
        # A shorter column of another specimen beside it.
        ("d [mm],F [N],t [s]\n1,0.5,1\n2,1,2\n4,2,3\n5.5,2.5,4\n,,5\n", "utf-8"),
    ],
)
def test_spellings(tmp_path, text, encoding):
    path = tmp_path / "curve.csv"
    path.write_bytes(text.encode(encoding))
    curve = read_curve(path)
    np.testing.assert_allclose(curve.displacement, [1e-3, 2e-3, 4e-3, 5.5e-3], rtol=1e-14)
    np.testing.assert_allclose(curve.force, [0.5, 1.0, 2.0, 2.5], rtol=1e-14)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (HEAD + ROWS.format(",") + "end of test\n", "line 6: displacement must be a finite"),
        (HEAD + "1, 2\n2, 3\n" + HEAD, 'line 4: displacement must be a finite number, got "disp'),
        ("d [mm];F [N]\n1,5;2.5\n", "has a decimal comma (line 2) and a decimal point (line 2)"),
        ('d [mm],F [N]\n"1,234",2\n', "line 2: the comma may part thousands or decimals"),
        ("d [mm];F [N]\n1;2;3\n", "line 2, has 3 columns instead of 2"),
        ("d [mm];F [N]\n1;#DIV/0!\n", 'line 2: force must be a finite number, got "#DIV/0!"'),
        ("d [mm];F [N]\n1;1e999\n", "line 2: force must be a finite number"),
        ("d [mm];F [N]\n1;12.34,5\n", "line 2: force must be a finite number"),
        ("d [mm];F [N]\n", "has no numbers below its titles (line 1)"),
        ("PK\x03\x04 and so on", "is a spreadsheet's own file, save the sheet as CSV"),
        ("just a letter to somebody\n", "has no"),
    ],
)
def test_refused_with_the_line(tmp_path, text, message):
    path = tmp_path / "curve.csv"
    path.write_text(text)
    with pytest.raises(InputError) as error:
        read_curve(path)
    assert message in str(error.value)
    assert len(str(error.value)) < 600


def test_an_endless_cell(tmp_path):
    path = tmp_path / "curve.csv"
    path.write_text(HEAD + "1," + "9" * 200_000 + "\n")
    with pytest.raises(InputError, match="line 2, ") as error:
        read_curve(path)
    assert len(str(error.value)) < 600


@pytest.mark.parametrize("seed", range(4))
def test_mutilated_files_are_read_or_refused(tmp_path, seed):
    """Bytes lost, doubled, swapped or put in: points in order, or one sentence."""
    rng, path = np.random.default_rng(seed), tmp_path / "curve.csv"
    files = [file.read_bytes() for file in sorted(DATA.glob("*.*")) if file.suffix != ".md"]
    refused: list[str] = []
    bits = [b";", b",", b'"', b"\n", b"\0", b"\xff\xfe", b"\xe4", b"1e999", b"[", b")", b"mm", b"-"]
    for _ in range(60):
        data = bytearray(files[rng.integers(len(files))])
        for _ in range(rng.integers(1, 4)):
            at = int(rng.integers(len(data)))
            data[at : at + int(rng.integers(3))] = bits[rng.integers(len(bits))]
        path.write_bytes(data)
        try:
            curve = read_curve(path, None if rng.random() < 0.7 else "Extension (mm),Load (N)")
        except InputError as error:
            refused.append(str(error))
        else:
            assert (np.diff(curve.displacement) > 0.0).all()
            assert (curve.force > 0.0).all()
            assert np.isfinite(curve.force).all()
    assert refused
    assert all("\n" not in text and len(text) < 700 for text in refused)


# -- columns by name ---------------------------------------------------------------------------


def test_which_of_two_extensions(tmp_path):
    path = DATA / "two_extensions.csv"
    with pytest.raises(InputError) as error:
        read_curve(path)
    assert '"Extension (mm)" and "Tensile extension (mm)"' in str(error.value)
    assert '--columns "Extension (mm),Load (N)"' in str(error.value)
    text = path.read_text().replace('"2.0000"\n', '"7"\n')
    other = tmp_path / "other.csv"
    other.write_text(text.replace(',"2.0000","0.8696"', ',"2.5000","0.8696"'))
    for columns, first in {
        "Extension (mm),Load (N)": 2.0,
        "load (n) , tensile  Extension (mm)": 2.5,
        '"Tensile extension [mm]","Load (N)"': 2.5,
        "2,3": 2.0,
        "3, 4": 2.5,
    }.items():
        assert 1e3 * read_curve(other, columns).displacement[0] == pytest.approx(first)


def test_names_with_commas_and_a_line_of_units(tmp_path):
    path = tmp_path / "curve.dat"
    path.write_text("A, left\tA, right\tLoad\nmm\tmm\tN\n" + "1\t2\t3\n2\t4\t5\n3\t6\t7\n4\t8\t9\n")
    for columns in ("A, right,Load", "A, right [mm],Load [N]", "3,2"):
        np.testing.assert_allclose(
            read_curve(path, columns).displacement, 1e-3 * np.arange(2, 9, 2)
        )


def test_titles_that_are_alike(tmp_path):
    """Two instruments of one name, by number; of one name and two units, by the unit."""
    path = tmp_path / "curve.csv"
    rows = "1,9,3\n2,9,5\n3,9,7\n4,9,9\n"
    path.write_text("Way (mm),Way (mm),Load (N)\n" + rows)
    with pytest.raises(InputError, match="several columns .* numbers, 1,3 and 2,3"):
        read_curve(path, "Way (mm),Load (N)")
    assert read_curve(path, "1,3").force[0] == 3.0
    path.write_text("Way (mm),Way (%),Load (N)\n" + rows)
    assert read_curve(path, "Way,Load").force[0] == 3.0


def test_long_and_wide_files(tmp_path):
    """Twenty thousand rows and seven hundred columns take seconds at most."""
    path = tmp_path / "curve.csv"
    number = np.arange(1, 20_001)
    path.write_text("d [mm];F [N]\n" + "".join(f"{0.001 * k:.3f};{k}\n" for k in number))
    begin = time.perf_counter()
    assert read_curve(path).rows == 20_000
    path.write_text(",".join(f"way {k} [mm]" for k in range(700)) + ",F [N]\n" + "1," * 701)
    with pytest.raises(InputError, match="700 columns with a unit of displacement"):
        read_curve(path)
    path.write_text("a word, or two\n" * 20_000)
    with pytest.raises(InputError, match="no column"):
        read_curve(path)
    assert time.perf_counter() - begin < 8.0


@pytest.mark.parametrize(
    "columns", ["Time (s),Load (N)", "Extension (mm)", "9,1", "", "0,3", "a,b,c"]
)
def test_columns_that_are_none(columns):
    with pytest.raises(InputError, match='has no two columns ".*line 1 has "Time'):
        read_curve(DATA / "two_extensions.csv", columns)


# -- the loading branch ------------------------------------------------------------------------

D = 1e-3 * np.arange(1.0, 21.0)
F = 1.0 + (100.0 * D) ** 2


def test_noise_at_the_start():
    """Within a thousandth of the range is at rest; beyond is a displacement that is negative."""
    d, f = np.append([-1.9e-5, 1.9e-5], D), np.append([0.01, 0.01], F)
    curve = MeasuredCurve.from_points(d, f)
    np.testing.assert_array_equal(curve.displacement, D)
    assert "2 rows within 0.02" in curve.notes[0]
    with pytest.raises(InputError, match="negative displacement -0.05 mm"):
        MeasuredCurve.from_points(np.append(-5e-5, D), np.append(0.0, F))


def test_slack_at_the_start():
    d, f = np.append([1e-4, 2e-4], D), np.append([-0.004, 0.003], F)
    curve = MeasuredCurve.from_points(d, f)
    np.testing.assert_array_equal(curve.displacement, D)
    assert curve.notes == ("2 rows up to 0.2 mm without a force left out: the specimen was slack.",)
    with pytest.raises(InputError, match="take the slack out"):
        MeasuredCurve.from_points(D, np.append([0.0, 0.0], F[2:]))


def test_force_at_rest_is_told():
    curve = MeasuredCurve.from_points(np.append(0.0, D), np.append(0.3, F))
    np.testing.assert_array_equal(curve.force, F)
    assert "At rest the measured force is 0.3 N" in curve.notes[0]
    assert MeasuredCurve.from_points(np.append(0.0, D), np.append(0.01, F)).notes == ()


def test_the_loading_branch_ends():
    """At the peak before a rupture, at the turn of the machine; noise is neither."""
    rupture = MeasuredCurve.from_points(np.append(D, D[-1] + D[:3]), np.append(F, [0.5, 0.2, 0.1]))
    back = MeasuredCurve.from_points(np.append(D, D[::-1]), np.append(F, 0.95 * F[::-1]))
    for curve in (rupture, back):
        np.testing.assert_array_equal(curve.force, F)
        assert curve.rows > len(F)
    assert "behind its largest, 5 N at 20 mm" in rupture.notes[0]
    assert "3 rows from 21 mm on left out" in rupture.notes[0]
    assert "turns back after 20 mm: the loading branch ends there, 20 rows" in back.notes[0]
    wavy = F * (1.0 + 0.03 * np.cos(np.arange(20.0)))
    assert MeasuredCurve.from_points(D, wavy).notes == ()
    early = np.append(F[:3], np.full(17, 0.1))
    with pytest.raises(InputError, match="3 points .*largest, 1.09 N at 3 mm"):
        MeasuredCurve.from_points(D, early)
