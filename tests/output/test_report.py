# SPDX-License-Identifier: MIT
"""The page about a run, measured data beside it, two curves over each other, and the bar."""

import html.parser
import io
import json
import logging
import re
import sys
import threading
import time
from pathlib import Path

import numpy as np
import pytest
from mpi4py import MPI

from cruciform_petsc.calibration.curve import MeasuredCurve
from cruciform_petsc.case.schema import Case
from cruciform_petsc.cli import main
from cruciform_petsc.cloth.fabric import Fabric
from cruciform_petsc.compare import (
    against_measured,
    compare,
    difference,
    drawn,
    loading,
    read_side,
    value_at,
)
from cruciform_petsc.errors import InputError
from cruciform_petsc.experiments.net_kinematics import net_angle
from cruciform_petsc.output.progress import (
    Route,
    duration,
    is_terminal,
    progress_bar,
    sign_of_life,
)
from cruciform_petsc.output.report import CAPTIONS, curve_table, fabric, gallery, numbers
from cruciform_petsc.quantities import force_text
from cruciform_petsc.run import check_case, run_case

COMM = MPI.COMM_SELF
LOG = logging.getLogger("test_report")
EVIL = '<script>alert("1")</script> & $x_ <b>"\'</b>'
VOID = {"meta", "img", "br", "hr", "link", "input"}


class Page(html.parser.HTMLParser):
    """What is on a page; fails if its elements are not nested as they should be."""

    def __init__(self, text):
        super().__init__()
        self.open, self.tags, self.texts, self.values = [], [], [], []
        self.feed(text)
        self.close()
        assert self.open == []

    def handle_starttag(self, tag, attributes):
        self.tags.append((tag, dict(attributes)))
        if tag not in VOID:
            self.open.append(tag)
        if tag == "data":
            self.values.append(float(dict(attributes)["value"]))

    def handle_endtag(self, tag):
        assert self.open.pop() == tag

    def handle_data(self, text):
        if "style" not in self.open:
            self.texts.append(text)

    def text(self):
        """All that is read."""
        return " ".join(" ".join(self.texts).split())

    def attributes(self):
        """Names and values of all attributes."""
        return [pair for _, pairs in self.tags for pair in pairs.items()]


def made(measured=None, **changes):
    """A small case at finite deformation."""
    data = {
        "title": EVIL,
        "fabric": {"use": "e-glass-plain-2.4"},
        "preform": {"outline": {"rectangle": ["2.4 cm", "3.6 cm"]}, "bias_angle": "45 deg"},
        "test": {"finite": True, "extension": ["1 mm", "2 mm"], "increments": 4},
        "output": {"paraview": False},
    }
    data["output"] |= {} if measured is None else {"measured": str(measured)}
    for table, values in changes.items():
        data[table] = data[table] | values
    return Case.from_data(data)


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """A run with measured data, one point of which lies beyond it."""
    folder = tmp_path_factory.mktemp("run")
    measured = folder / "measured.csv"  # where a user may well put it
    measured.write_text("displacement [mm], force [N]\n0.5, 1\n1, 2\n1.5, 3\n2, 4\n3, 6\n")
    run_case(COMM, made(measured), folder, LOG)
    return folder


@pytest.fixture(scope="module")
def summary(folder):
    return json.loads((folder / "summary.json").read_text(encoding="utf-8"))


@pytest.fixture(scope="module")
def report(folder):
    return Page((folder / "report.html").read_text(encoding="utf-8"))


# -- the page --------------------------------------------------------------------------------------


def test_page_loads_and_runs_nothing(report):
    tags = {tag for tag, _ in report.tags}
    assert not tags & {"script", "link", "iframe", "object", "embed", "base", "form", "a", "b"}
    for name, value in report.attributes():
        assert not name.startswith("on")
        assert name != "href"
        if name == "src":
            assert value.startswith("data:image/png;base64,")
        elif value:
            assert "://" not in value
    policy = [value for name, value in report.attributes() if name == "content"]
    assert any("default-src 'none'" in value for value in policy)


def test_page_shows_the_case_as_it_was_written(report):
    assert EVIL in "".join(report.texts)
    text = report.text()
    for expected in ("outline.rectangle [2.4 cm, 3.6 cm]", "[1 mm, 2 mm]", "520 N/cm", "45 deg"):
        assert expected in text


def test_page_says_what_of_a_library_fabric_was_changed(report):
    changed = made(fabric={"shear": {"modulus": "5 N/cm"}})
    shown = fabric(changed)
    assert shown["table"].heads[0] == "e-glass-plain-2.4, shear replaced"
    assert "Changed in the case file: shear." in shown["text"]
    assert "Changed" not in report.text()


def test_page_tells_what_else_resists_shear():
    """Viscosity and friction, as the log does in the fabric's own words."""
    fluid = {"viscosity": "200 N s/m", "temperature": "200 degC", "activation_energy": "40 kJ/mol"}
    changed = made(
        fabric={"shear_viscosity": fluid, "shear_friction": {"torque": "5 N/m", "slip": "1 deg"}}
    )
    for text in (fabric(changed)["text"], repr(changed.fabric())):
        assert "200 N s/m, exponent 1, at 200 degC, 40 kJ/mol" in text
        assert "0.05 N/cm beyond 1 deg" in text


def test_page_has_the_figures_of_the_summary(report, summary):
    shown = report.values
    energy = sum(values[-1] for values in summary["energy_j"].values())
    expected = [summary[key][-1] for key in ("load_n", "extension_m")]
    expected += [summary[f"shear_{which}_deg"][-1] for which in ("centre", "middle", "max", "99")]
    assert shown[:6] == expected
    assert shown[6] == pytest.approx(energy, rel=1e-14)  # sums in another order
    measured = summary["measured"]
    keys = ("rms_relative", "end_relative", "largest_relative")
    assert shown[7:] == [measured[key] for key in keys]
    text = report.text()
    assert f"{summary['load_n'][0]:.3f}" in text
    most = summary["yarn_tension_max"]
    assert f"At 2 mm extension. Largest yarn tension: {force_text(most['n'])} per" in text
    assert "At 2 mm extension" in text
    assert "shear angle, median of the middle zone" in text
    assert summary["date"] in text
    assert f"petsc {summary['versions']['petsc']}" in text
    for step in summary["increments"]:
        assert f"{step['residual_n']:.1e}" in text
    assert text.count("asked for") == 2


def test_page_has_all_pictures(report, folder):
    images = [dict(pairs) for tag, pairs in report.tags if tag == "img"]
    assert len(images) == len(list(folder.glob("*.png")))
    assert (folder / "tension_map.png").exists()
    assert all(image["alt"] for image in images)


def test_only_when_wanted(tmp_path):
    """Without pictures there is no page unless it is asked for; then it has no pictures."""
    run_case(COMM, made(output={"pictures": False, "paraview": False}), tmp_path, LOG)
    assert not (tmp_path / "report.html").exists()
    output = {"pictures": False, "paraview": False, "report": True}
    run_case(COMM, made(output=output, test={"finite": False, "extension": "1 mm"}), tmp_path, LOG)
    page = Page((tmp_path / "report.html").read_text(encoding="utf-8"))
    assert "img" not in {tag for tag, _ in page.tags}
    assert "small displacements" in page.text()
    assert "Increments" not in page.text()


@pytest.mark.parametrize("kind", ["picture-frame", "biaxial", "cantilever"])
def test_every_other_kind(tmp_path, kind):
    """Each has its own columns; warnings are told."""
    control = {
        "picture-frame": {"angle": ["5 deg", "10 deg"]},
        "biaxial": {"strain": ["12 %"]},
        "cantilever": {"load": ["1 mN", "2 mN"]},
    }[kind]
    case = Case.from_data(
        {
            "fabric": {"use": "e-glass-plain-2.4"},
            "preform": {"outline": {"rectangle": ["2 cm", "2 cm"]}, "bias_angle": "0 deg"},
            "test": {"kind": kind, "finite": True, **control},
            "output": {"paraview": False},
        }
    )
    summary = run_case(COMM, case, tmp_path, LOG)
    text = Page((tmp_path / "report.html").read_text(encoding="utf-8")).text()
    words = {
        "picture-frame": ("shear force (N/mm)", "Tension: uniform, warp 0 N per yarn"),
        "biaxial": (
            "warp tension (N/cm)", "weft force", "warp force (N)",
            "Shear angle: uniform, 0\N{DEGREE SIGN}.", "coloured by tension",
        ),
        "cantilever": ("deflection across (mm)", "tip deflection", "load (mN)", "load 2 mN"),
    }  # fmt: skip
    for word in words[kind]:
        assert word in text
    assert summary["yarn_tension_max"]["at_mm"] is None or kind == "cantilever"
    assert ("To know before use" in text) == bool(summary["warnings"])
    assert kind != "biaxial" or "stretched by up to 12 %" in text
    assert ("load" in text.lower()) == (kind != "biaxial")


def test_pictures_are_two_in_a_row(tmp_path):
    """Stages, four specimens side by side, have a row to themselves however high they are."""
    for name in ("stages.png", "yarns.png"):
        size = (900).to_bytes(4, "big")
        (tmp_path / name).write_bytes(bytes(16) + size + size)
    pictures = gallery([tmp_path / name for name in ("yarns.png", "stages.png")], CAPTIONS)
    assert [picture["basis"] for picture in pictures] == ["100%", "min(100%, 420px)"]


def test_rounding_is_told_as_zero():
    """Shear of a biaxial test is none, whatever the last bits say; so is its energy."""
    curve = {
        "strain_warp_percent": np.array([1.0, 2.0]),
        "shear_centre_deg": np.array([-6.7e-16, 3e-12]),
        "energy_tension_J": np.array([1.0, 2.0]),
        "energy_shear_J": np.array([1.8e-28, 1e-10]),
    }
    assert [list(row) for row in curve_table(curve).rows] == [
        ["1", "0", "1000", "0"],
        ["2", "0", "2000", "0"],
    ]


def test_columns_have_the_same_decimals():
    assert numbers([1.29123, 10.0, -0.5]) == ["1.29", "10.00", "\N{MINUS SIGN}0.50"]
    assert numbers([1.0, 2.0, None]) == ["1", "2", ""]
    assert numbers([1e-7]) == ["1e\N{MINUS SIGN}07"]


def test_cut_steps_are_told(tmp_path, monkeypatch):
    """A step that fails once is halved, and the summary and the page say so."""
    from cruciform_petsc.equilibrium import newton

    solve, calls = newton.Equilibrium.solve, []

    def fails_once(self, guess, *more):
        calls.append(guess.time)
        if len(calls) == 2:
            raise newton.EquilibriumError("no", "MAX_IT", [])
        return solve(self, guess, *more)

    monkeypatch.setattr(newton.Equilibrium, "solve", fails_once)
    summary = run_case(COMM, made(), tmp_path, LOG)
    assert sum(step["cuts"] for step in summary["increments"]) == 1
    assert any("cut in half 1 times" in sentence for sentence in summary["warnings"])
    page = Page((tmp_path / "report.html").read_text(encoding="utf-8"))
    assert "Steps were cut in half 1 times" in page.text()


# -- measured data ---------------------------------------------------------------------------------


def test_measured_by_hand():
    """A straight line of 2 N/mm to 2 mm against 1.6, 4.4 and one point beyond."""
    line = loading(np.array([1.0, 2.0]), np.array([2.0, 4.0]))
    curve = MeasuredCurve(np.array([1e-3, 2e-3, 3e-3]), np.array([1.6, 4.4, 6.0]), 3)
    told = against_measured(line, curve)
    assert told["points"] == 2
    assert told["points_measured"] == 3
    off = np.array([2.0 / 1.6 - 1.0, 4.0 / 4.4 - 1.0])
    assert told["rms_relative"] == pytest.approx(np.sqrt((off**2).mean()))
    assert told["end_relative"] == pytest.approx(off[1])
    assert (told["largest_relative"], told["largest_at"]) == pytest.approx((0.25, 1.0))
    np.testing.assert_allclose(told["load_n"], [2.0, 4.0, np.nan])


def test_measured_in_a_run(summary, folder):
    measured = summary["measured"]
    assert measured["points"] == 4  # the fifth lies beyond
    assert measured["load_n"][4] is None
    # At 1 and 2 mm, which were asked for, the load is that of the curve.
    assert [measured["load_n"][i] for i in (1, 3)] == pytest.approx(summary["load_n"], rel=1e-12)
    off = np.array(measured["load_n"][:4]) / [1, 2, 3, 4] - 1.0
    assert measured["rms_relative"] == pytest.approx(np.sqrt((off**2).mean()), rel=1e-12)
    assert (
        (folder / "load_and_measured.csv")
        .read_text()
        .startswith("displacement_mm,measured_N,load_N\n")
    )


def test_measured_file_is_beside_the_case(tmp_path, monkeypatch):
    """In a case file, relative to it; on the command line, to where one is."""
    (tmp_path / "sub").mkdir()
    case = tmp_path / "sub" / "case.toml"
    case.write_text(
        '[fabric]\nuse = "e-glass-plain-2.4"\n[preform]\noutline = { rectangle = ["2.4 cm", '
        '"3.6 cm"] }\nbias_angle = "45 deg"\n[test]\nextension = "1 mm"\n[output]\n'
        'measured = "m.csv"\n'
    )
    monkeypatch.chdir(tmp_path)
    assert Case.load("sub/case.toml").output.measured == str(tmp_path / "sub" / "m.csv")
    assert Case.load(case, ["output.measured=x.csv"]).output.measured == "x.csv"


def test_measured_data_that_are_not_there_stop_a_run_before_it_begins(tmp_path):
    with pytest.raises(InputError, match="does not exist"):
        run_case(COMM, made(tmp_path / "none.csv"), tmp_path, LOG)
    assert list(tmp_path.iterdir()) == []


DATA = Path(__file__).parents[1] / "calibration" / "data"


def checked(caplog, measured, **changes):
    """What check says of a case with measured data."""
    caplog.clear()
    with caplog.at_level("INFO"):
        check_case(COMM, made(measured, **changes), LOG)
    return caplog.text


def test_check_asks_for_the_unit(caplog, tmp_path):
    """Loads of the fabric's own law a thousand times too small or large, and as they should be."""
    d = np.linspace(0.2, 3.0, 8)
    length, width, law = 0.06, 0.024, Fabric.from_library("e-glass-plain-2.4").shear
    half = 0.5 * net_angle(1e-3 * d, length - width)
    torque = (2 * length - 3 * width) * law.evaluate(2 * half)[1] + width * law.evaluate(half)[1]
    f = torque / ((length / width - 1) * (np.cos(half) - np.sin(half)))
    pairs = list(zip(d, f, strict=True))
    path, long = tmp_path / "m.csv", {"outline": {"rectangle": ["2.4 cm", "6 cm"]}}
    for unit, question in {
        "N": None, "mN": "is N meant in place of kN", "kN": "is kN meant in place of N",
    }.items():  # fmt: skip
        scale = {"N": 1.0, "mN": 1e3, "kN": 1e-3}[unit]
        path.write_text("d [mm],F [N]\n" + "".join(f"{a},{scale * b}\n" for a, b in pairs))
        text = checked(caplog, path, preform=long)
        assert ("meant in place" in text) == (question is not None)
        assert question is None or "warning       the measured loads are 1000 times" in text
        assert question is None or question in text


def test_a_run_asks_for_the_unit(tmp_path):
    """Also where no closed formula holds: this specimen is shorter than twice its width."""
    path = tmp_path / "m.csv"
    path.write_text("d [mm],F [N]\n0.5,.001\n1,.002\n1.5,.003\n2,.004\n")
    summary = run_case(COMM, made(path, output={"pictures": False}), tmp_path, LOG)
    (question,) = [text for text in summary["warnings"] if "meant in place of" in text]
    assert "times smaller than those computed: is kN meant in place of N in the data?" in question


def test_measured_columns_and_what_was_left_out(caplog, tmp_path):
    with pytest.raises(InputError, match='measured_columns = "Extension \\(mm\\),Load'):
        checked(caplog, DATA / "two_extensions.csv")
    named = {"measured_columns": "Extension (mm),Load (N)"}
    assert "measured data" not in checked(caplog, DATA / "two_extensions.csv", output=named)
    text = checked(caplog, DATA / "rupture_tail.csv")
    assert "warning       measured data: The force falls behind its largest, 6.75 N" in text
    summary = run_case(
        COMM, made(DATA / "rupture_tail.csv", output={"pictures": False}), tmp_path, LOG
    )
    assert any("force falls behind its largest" in sentence for sentence in summary["warnings"])
    assert summary["measured"]["points_measured"] == 20


def test_check_asks_what_a_shear_table_is(caplog):
    points = {"law": "table", "angle": "deg", "force": "N/mm", "points": [[5, 0.01], [40, 0.2]]}
    assert "does not name its quantity" in checked(caplog, None, fabric={"shear": points})
    points["quantity"] = "torque per area"
    assert "quantity" not in checked(caplog, None, fabric={"shear": points})


def test_check_tells_a_truss(caplog):
    """Of nothing else it would be known which model a result is of."""
    assert "pin-jointed bars" not in checked(caplog, None)
    assert 'model "truss": pin-jointed bars' in checked(caplog, None, test={"model": "truss"})


def test_log_tells_heights_and_what_was_dissipated(caplog, tmp_path):
    """Beside the energy, which is what the cloth gives back."""
    case = made(
        fabric={"shear_friction": {"torque": "5 N/m"}},
        test={"extension": "2 mm", "space": True, "imperfection": {"height": "0.1 mm"}},
        output={"pictures": False},
    )
    with caplog.at_level(logging.INFO):
        summary = run_case(COMM, case, tmp_path, logging.getLogger("outcome"))
    spent, height = summary["dissipated_in_shear_j"], summary["height_max_mm"]
    assert f"dissipated    {1e3 * spent:.4g} mJ in shear" in caplog.messages
    assert f"height        {height:.4g} mm out of the plane at most" in caplog.messages


# -- compare ---------------------------------------------------------------------------------------


def results(folder, load, shear, extension=(1.0, 2.0), kind="bias-extension", first="extension_mm"):
    """A folder as a run leaves it."""
    folder.mkdir()
    rows = [f"{first},load_N,shear_max_deg,energy_shear_J,energy_tension_J"]
    rows += [f"{x},{f},{s},{f},{f}" for x, f, s in zip(extension, load, shear, strict=True)]
    (folder / "curve.csv").write_text("\n".join(rows) + "\n")
    (folder / "summary.json").write_text(json.dumps({"title": folder.name, "kind": kind}))
    return folder


def test_compared_with_one_of_two_extensions(tmp_path, capsys):
    """--columns once for all files; the folder of a run needs none."""
    a = results(tmp_path / "a", [0.7, 0.8], [10.0, 21.0], extension=(2.0, 4.0))
    path, out = str(DATA / "two_extensions.csv"), str(tmp_path / "out")
    assert main(["compare", str(a), path, "--output", out]) == 2
    assert "say which counts, --columns" in capsys.readouterr().err
    named = ["--columns", "Extension (mm),Load (N)"]
    assert main(["compare", str(a), path, "--output", out, *named]) == 0
    assert main(["compare", str(a), path, "--output", out, *named, *named]) == 2
    assert "--columns was given 2 times for 1 files" in capsys.readouterr().err


def test_two_results_by_hand(tmp_path):
    """At the values asked for: 1, 2 mm and 4 mm beyond the shorter one, which does not count."""
    a = results(tmp_path / "a", [1.1, 1.7], [10.0, 21.0])
    b = results(tmp_path / "b", [1.0, 2.0, 4.0], [11.0, 20.5, 40.0], extension=(1.0, 2.0, 4.0))
    told, (figures,), _ = compare([read_side(a), read_side(b)])
    load, shear = figures["load_N"], figures["shear_max_deg"]
    assert (load.points, load.relative, shear.relative) == (2, True, False)
    assert load.rms == pytest.approx(np.sqrt((0.01 + 0.0225) / 2))
    assert (load.end, load.largest, load.largest_at) == pytest.approx((-0.15, -0.15, 2.0))
    assert shear.rms == pytest.approx(np.sqrt((1.0 + 0.25) / 2))
    assert (shear.end, shear.largest, shear.largest_at) == pytest.approx((0.5, -1.0, 1.0))
    assert figures["energy_J"].rms == pytest.approx(load.rms)
    assert told["differences"]["a"]["load_N"]["rms_relative"] == load.rms


def test_all_increments_are_used_between(tmp_path):
    """A result of one value only is its curve and no straight line; figures are where asked for."""
    a, b = tmp_path / "a", results(tmp_path / "b", [1.0, 4.0], [1.0, 1.0])
    results(a, [4.0], [1.0], extension=[2.0])
    rows = ["0.5,0.25,0,0.1", "1,1,0,0.1", "1.5,2.25,0,0.2", "2,4,1,0.1"]
    (a / "curve.csv").write_text("\n".join(["extension_mm,load_N,asked,seconds", *rows]) + "\n")
    for sides, points in (((a, b), 2), ((a, a), 1)):
        _, (figures,), _ = compare([*map(read_side, sides)])
        assert figures["load_N"].rms == pytest.approx(0.0, abs=1e-12)
        assert figures["load_N"].points == points
        assert figures.keys() == {"load_N"}


def test_what_is_drawn_is_what_is_compared():
    """Between increments the line goes where the figures come from, and through all increments."""
    for sign in (1.0, -1.0):
        line = loading(sign * np.array([1.0, 2.0, 4.0]), sign * np.array([3.0, 4.0, 4.5]))
        x, y = drawn(line)
        np.testing.assert_allclose(y, value_at(line, x), rtol=0, atol=1e-12)
        assert set(line[0]) <= set(x)
        assert len(x) > 100
    proportional = loading(np.array([2.0]), np.array([4.0]))
    assert drawn(proportional) is proportional


def test_loading_branch():
    """What turns back does not count; pushes and pulls have nothing in common."""
    x, y = loading(np.array([1.0, 2.0, 1.5, 3.0]), np.array([1.0, 2.0, 0.5, 3.0]))
    assert x.tolist() == [0.0, 1.0, 2.0, 3.0]
    assert y.tolist() == [0.0, 1.0, 2.0, 3.0]
    push = loading(np.array([-1.0, -2.0]), np.array([-3.0, -6.0]))
    assert push[0].tolist() == [0.0, -1.0, -2.0]
    assert difference(push, (x, y), x) is None
    same = difference(push, push, np.array([-1.5]))
    assert (same.points, same.rms) == (1, 0.0)


def test_command(tmp_path, capsys, folder, summary):
    """A result against its measured data tells what the run told; the picture is there."""
    out = tmp_path / "out"
    assert main(["compare", str(folder), str(folder / "measured.csv"), "--output", str(out)]) == 0
    told = json.loads((out / "comparison.json").read_text())
    found, measured = told["differences"]["a"]["load_N"], summary["measured"]
    assert found["rms_relative"] == pytest.approx(measured["rms_relative"], rel=1e-12)
    assert found["points"] == measured["points"]
    assert (out / "comparison.png").exists()
    assert f"RMS {100 * found['rms_relative']:.2f} %" in capsys.readouterr().out
    assert main(["compare", str(folder), str(folder), "--output", str(out), "--quiet"]) == 0
    assert capsys.readouterr().out == ""
    told = json.loads((out / "comparison.json").read_text())
    assert all(
        value in (0.0, figures["points"], figures["largest_at"])
        for figures in told["differences"]["a"].values()
        for value in figures.values()
    )


def test_what_cannot_be_compared(tmp_path, capsys):
    """One sentence and exit code 2."""
    a = results(tmp_path / "a", [1.0, 2.0], [1.0, 2.0])
    frame = results(tmp_path / "f", [1.0, 2.0], [1.0, 2.0], kind="picture-frame", first="angle_deg")
    biaxial = results(
        tmp_path / "x", [1.0, 2.0], [1.0, 2.0], kind="biaxial", first="strain_warp_percent"
    )
    push = results(tmp_path / "p", [-1.0], [1.0], extension=[-1.0])
    csv = tmp_path / "m.csv"
    csv.write_text("displacement [mm], force [N]\n1, 1\n2, 2\n3, 3\n4, 4\n")
    empty = tmp_path / "empty"
    empty.mkdir()
    broken = results(tmp_path / "broken", [1.0], [1.0], extension=[1.0])
    (broken / "curve.csv").write_text("extension_mm,load_N\n1,two\n")
    for one, other, sentence in (
        (a, tmp_path / "none", "does not exist"),
        (a, empty, "no curve.csv"),
        (a, broken, "not a table"),
        (a, frame, "over extension_mm .* over angle_deg"),
        (biaxial, csv, "no force over a displacement"),
        (a, push, "no range in common"),
    ):
        assert main(["compare", str(one), str(other), "--output", str(tmp_path / "o")]) == 2
        told = capsys.readouterr().err
        assert re.search(sentence, told), told
        assert len(told.strip().splitlines()) == 1
    assert not (tmp_path / "o").exists()
    assert main(["compare", str(a)]) == 2


# -- the bar ---------------------------------------------------------------------------------------


class Terminal(io.StringIO):
    """Somebody looks at it."""

    def isatty(self):
        return True


def test_route():
    """There, and back, and there again."""
    route = Route([2.0, -1.0, 4.0])
    assert route.length == 2.0 + 3.0 + 5.0
    assert route.done(0, 0.5) == 0.5
    assert route.done(1, 1.0) == 3.0
    assert route.done(2, 0.0) == 6.0
    assert route.done(3, 4.0) == route.length


def test_bar_on_a_terminal_only(monkeypatch):
    """The log's lines go above the bar; without a terminal, or quietly, there is none."""
    monkeypatch.delenv("OMPI_COMM_WORLD_SIZE", raising=False)
    for stream, level, shown in (
        (Terminal(), logging.INFO, True),
        (io.StringIO(), logging.INFO, False),
        (Terminal(), logging.WARNING, False),
    ):
        monkeypatch.setattr(sys, "stdout", stream)
        log = logging.Logger("bar", level)
        handler = logging.StreamHandler(stream)
        log.addHandler(handler)
        with progress_bar(log, 10.0, 2.0) as tell:
            assert (tell is not None) == shown
            log.info("a line")
            if tell is not None:
                tell(6.0, "increment 3, 6 mm, 10.0 deg of shear, 4 Newton steps")
        assert handler.stream is stream
        assert sys.stdout is stream
        written = stream.getvalue()
        assert ("a line" in written) == (level == logging.INFO)
        assert ("increment 3, 6 mm" in written) == shown
        assert ("60 %" in written and "left" in written) == shown


def test_terminals_of_open_mpi_are_not_taken_at_their_word(monkeypatch):
    from cruciform_petsc.output import progress

    monkeypatch.setenv("OMPI_COMM_WORLD_SIZE", "2")
    monkeypatch.setattr(progress, "parents_terminal", lambda: None)
    assert not is_terminal(Terminal())


def test_a_log_that_says_nothing_gives_a_sign_of_life():
    """After a while, then after twice as long; a line in between begins anew; quietly none."""
    for level, quiet, heard in ((logging.INFO, 0.05, True), (logging.WARNING, 0.05, False)):
        stream, log = io.StringIO(), logging.Logger("life", level)
        log.addHandler(logging.StreamHandler(stream))
        with sign_of_life(log, quiet):
            time.sleep(0.5)
            log.info("a step")
            told = stream.getvalue().count("still looking for the next equilibrium")
        assert bool(told) == heard
        assert told <= 4  # after 0.05, 0.1, 0.2 and 0.4 s
        assert not log.filters
    with sign_of_life(log):
        threads = threading.active_count()
    assert threading.active_count() == threads


def test_durations():
    assert [duration(s) for s in (4.4, 180.0, 9000.0)] == ["4 s", "3 min", "2.5 h"]
