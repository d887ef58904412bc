# SPDX-License-Identifier: MIT
"""From case files to results: every kind of test, its summary, and tests that end early."""

import csv
import json
import logging
import re
import subprocess
from contextlib import contextmanager
from datetime import UTC, datetime
from warnings import catch_warnings, simplefilter

import h5py
import numpy as np
import pytest
from mpi4py import MPI
from support.runs import CASE

from cruciform_petsc import __version__
from cruciform_petsc.case.schema import Case
from cruciform_petsc.cli import main
from cruciform_petsc.errors import EquilibriumError, InputError, InputWarning, harmless
from cruciform_petsc.experiments.limits import warnings
from cruciform_petsc.experiments.net_kinematics import net_angle
from cruciform_petsc.experiments.result import EFFORT
from cruciform_petsc.net.network import Network
from cruciform_petsc.output.figures import figures
from cruciform_petsc.output.folder import LOG as LOG_FILE
from cruciform_petsc.output.folder import MANIFEST, OF_RUN
from cruciform_petsc.output.report import CAPTIONS
from cruciform_petsc.quantities import quantity
from cruciform_petsc.run import check_case, run_case

LOG = logging.getLogger("test_run")
SHEAR = {"law": "polynomial", "coefficients": ["0.1 N/mm", "0.2 N/mm"]}


def case(kind="bias-extension", size=("2.4 cm", "3.6 cm"), bias="45 deg", **test):
    """A small specimen of Table 1's fabric without pictures; further tables under their names."""
    data = {
        "fabric": {"use": "e-glass-plain-2.4"},
        "preform": {"outline": {"rectangle": list(size)}, "bias_angle": bias},
        "output": {"pictures": False},
    }
    data |= {name: test.pop(name) for name in ("fabric", "continuum", "output") if name in test}
    return Case.from_data(data | {"test": {"kind": kind, "finite": False, **test}})


def run(comm, tmp_path, made):
    """The summary as it is on disk."""
    run_case(comm, made, tmp_path, LOG)
    return json.loads((tmp_path / "summary.json").read_text())


def table(path):
    """Columns of a CSV file; NaN where a field is empty."""
    with path.open(newline="") as file:
        header, *rows = csv.reader(file)
    rows = [[field or "nan" for field in row] for row in rows]
    return dict(zip(header, np.array(rows, float).T, strict=True))


SQUARE = {"size": ("3 cm", "3 cm"), "bias": "0 deg"}
KINDS = {
    "bias-extension": {"extension": ["0.02 mm", "0.04 mm"], "bending": False},
    "off-axis-tension": {
        "extension": ["0.02 mm", "0.04 mm"],
        "bending": False,
        "bias": "30 deg",
        "ends": "free",
    },
    "pantograph": {"extension": ["0.02 mm", "0.04 mm"], "bending": False},
    "picture-frame": {"angle": ["0.1 deg", "0.2 deg"], **SQUARE},
    "biaxial": {"strain": ["0.01 %", "0.02 %"], "ratio": 0.5, **SQUARE},
    "cantilever": {"load": ["1 mN", "2 mN"], **SQUARE},
}
CLAMPED = ("bias-extension", "pantograph")


@pytest.mark.parametrize("kind", KINDS)
def test_every_kind(tmp_path, kind):
    """Small and finite deformation leave the same figures, alike where deformation is small."""
    both = []
    for finite in (False, True):
        folder = tmp_path / str(finite)
        folder.mkdir()
        both.append(run(MPI.COMM_SELF, folder, case(kind, finite=finite, **KINDS[kind])))
        curve = table(folder / "curve.csv")
        asked = curve["asked"] == 1
        assert (asked.sum(), asked[-1]) == (2, True)
        assert all(quantity(name).unit for name in curve.keys() - EFFORT.keys())
        assert (EFFORT.keys() <= curve.keys()) == finite
        summary = both[-1]
        if kind == "biaxial":  # what does the work of both forces is told nowhere
            assert "load" not in " ".join((*summary, *summary.get("increments", [{}])[0], *curve))
            weft = 0.5 * np.array(summary["force_weft_n"])  # on half of the warp's extension
            summary["load_n"] = (np.array(summary["force_warp_n"]) + weft).tolist()
            curve["load_N"] = curve["force_warp_N"] + 0.5 * curve["force_weft_N"]
        assert summary["load_n"] == pytest.approx(curve["load_N"][asked])
        for name in ("series.vtkhdf", "network.vtkhdf"):
            assert (folder / name).exists()
        # Zones are where yarns end in clamps; this off-axis test has free ends.
        assert (folder / "centre_line.csv").exists() == (kind in CLAMPED)
    small, large = both
    assert (small["kind"], small["finite"], large["finite"]) == (kind, False, True)
    assert {"increments", "newton_iterations_per_increment"} <= set(large)
    # They differ by the extension over the length that shears, a third of a hundredth; in bending
    # by the elements, whose yarns bend at crossovers only at finite deformation.
    rel = 3e-2 if kind == "cantilever" else 1e-2
    for key in ("load_n", "extension_m"):
        assert large[key] == pytest.approx(small[key], rel=rel), key
    energies = [sum(energy[1] for energy in s["energy_j"].values()) for s in both]
    assert energies[1] == pytest.approx(energies[0], rel=rel)
    assert energies[0] > 0.0
    # Work of the load on its way; a cantilever's is told by the mean displacement of its end, over
    # which the load is spread by yarns (0.1 %).
    work = 0.5 * small["load_n"][1] * small["extension_m"][1]
    assert energies[0] == pytest.approx(work, rel=2e-3 if kind == "cantilever" else 1e-5)


def test_picture_frame_against_its_closed_form(tmp_path):
    """F = L psi'/sin(45 deg - gamma/2), without bending; the columns that engineers ask for."""
    fabric = {"use": "e-glass-plain-2.4", "shear": SHEAR}
    made = case("picture-frame", finite=True, angle=["20 deg", "45 deg"], fabric=fabric, **SQUARE)
    summary = run(MPI.COMM_SELF, tmp_path, made)
    gamma = np.deg2rad([20.0, 45.0])
    torque = 1e3 * (0.1 * gamma + 0.2 * gamma**3)
    force = 0.03 * torque / np.sin(0.25 * np.pi - 0.5 * gamma)
    # Crossovers do not reach into the frame's corners: the cloth covers a little less (0.1 %).
    assert summary["load_n"] == pytest.approx(force, rel=1e-2)
    assert summary["angle_deg"] == pytest.approx([20.0, 45.0])
    diagonal = 0.06 * np.cos(0.25 * np.pi - 0.5 * gamma)
    assert summary["crosshead_mm"] == pytest.approx(1e3 * (diagonal - 0.03 * np.sqrt(2.0)))
    assert summary["shear_force_n_per_mm"] == pytest.approx(1e-3 * force / diagonal, rel=1e-2)


def test_results_say_where_they_come_from(tmp_path):
    """Program, commit, versions, date, ranks and case: in the summary and in ParaView's files."""
    made = case(finite=True, extension=["1 mm", "2 mm"])
    summary = run(MPI.COMM_SELF, tmp_path, made)
    commit = subprocess.run(["git", "rev-parse", "HEAD"], capture_output=True, text=True)
    if commit.returncode == 0:  # else it is no clone
        assert summary["commit"] == commit.stdout.strip()
    assert {"cruciform_petsc", "python", "petsc", "numpy", "numba"} <= summary["versions"].keys()
    for name in ("network.vtkhdf", "series.vtkhdf"):
        with h5py.File(tmp_path / name) as file:
            notes = {
                key: value.decode() if isinstance(value, bytes) else value
                for key, value in file["VTKHDF"].attrs.items()
            }
        assert notes["program"] == f"cruciform_petsc {__version__}"
        assert notes["commit"] == (summary["commit"] or "")
        assert notes["ranks"] == summary["ranks"] == 1
        assert json.loads(notes["versions"]) == summary["versions"]
        assert Case.from_data(json.loads(notes["case"])) == made
        written = datetime.fromisoformat(notes["date"])
        assert abs((datetime.now(UTC) - written).total_seconds()) < 600.0


def test_the_log_is_kept(tmp_path):
    """With times, also what --quiet leaves out; a resumed run goes on; and why one ended early."""
    path = tmp_path / "case.toml"
    path.write_text(CASE.replace("increments = 40", "increments = 2"))
    words = ["run", str(path), "--output", str(tmp_path / "out")]
    log = tmp_path / "out" / LOG_FILE
    assert main([*words, "--quiet"]) == 0
    told = log.read_text().splitlines()
    assert all(re.match(r"\d{4}-\d\d-\d\d \d\d:\d\d:\d\d  ", line) for line in told)
    assert sum("Newton iterations" in line and "extension" in line for line in told) == 2
    log.write_text("of old\n")
    assert main([*words, "--set", "test.extension=90 mm", "--set", "preform.bias_angle=0 deg"]) == 2
    told = log.read_text()
    assert "of old" not in told
    assert "a yarn is stretched to more than twice its length" in told.splitlines()[-1]


def test_nothing_stays_of_an_earlier_run(tmp_path, caplog):
    """All that a run can write is removed by the next one; other people's files are not."""
    everything = {"pictures": True, "exports": True}
    run(MPI.COMM_SELF, tmp_path, case(finite=True, extension=["1 mm", "2 mm"], output=everything))
    (tmp_path / "notes.txt").write_text("mine")
    there = {path.name for path in tmp_path.iterdir()} - {"notes.txt", MANIFEST}
    assert len(there) > 10
    assert there - {LOG_FILE} | CAPTIONS.keys() <= set(OF_RUN)
    with caplog.at_level(logging.INFO, LOG.name):
        run(MPI.COMM_SELF, tmp_path, case(extension="1 mm"))
    assert 'replaces the results of "' in caplog.text
    left = {path.name for path in tmp_path.iterdir()}
    assert "notes.txt" in left
    assert not left & {"series.vtkhdf", "stages.png", "preform.inp", "zones.png"}


def test_single_values_are_no_lists(tmp_path):
    summary = run(MPI.COMM_SELF, tmp_path, case(finite=True, extension="2 mm"))
    for key in ("load_n", "extension_m", "shear_max_deg", "shear_middle_deg"):
        assert isinstance(summary[key], float)


def test_loads_at_finite_deformation(tmp_path):
    """A case may ask for loads; the summary has the extensions."""
    made = case(finite=True, load=["1 N", "3 N"])
    summary = run(MPI.COMM_SELF, tmp_path, made)
    assert summary["load_n"] == pytest.approx([1.0, 3.0], rel=1e-8)
    assert 0.0 < summary["extension_m"][0] < summary["extension_m"][1]
    again = case(finite=True, extension=[f"{x} m" for x in summary["extension_m"]])
    assert run(MPI.COMM_SELF, tmp_path, again)["load_n"] == pytest.approx([1.0, 3.0], rel=1e-6)


def test_increments_on_disk_and_in_the_log(tmp_path, caplog):
    """Every accepted increment, asked for or not: in curve.csv and in ParaView's series."""
    with caplog.at_level(logging.INFO, LOG.name):
        made = case(finite=True, extension=["1 mm", "3 mm"], increments=6)
        summary = run(MPI.COMM_SELF, tmp_path, made)
    steps = table(tmp_path / "curve.csv")
    assert steps["extension_mm"] == pytest.approx([0.5, 1.0, 1.5, 2.0, 2.5, 3.0])
    assert steps["asked"].tolist() == [0, 1, 0, 0, 0, 1]
    assert (steps["residual_N"] <= steps["tolerance_N"]).all()
    assert [step["load_n"] for step in summary["increments"]] == steps["load_N"].tolist()
    assert summary["newton_iterations_per_increment"] == steps["newton_iterations"].mean()
    lines = [r.getMessage() for r in caplog.records if "Newton iterations" in r.getMessage()]
    assert len(lines) == 6 + 1
    assert "extension 0.5 mm" in lines[0]
    said = " ".join(lines[0].split())
    assert f"load {steps['load_N'][0]:.5g}" in said.replace(" ,", ",")
    assert f"shear {steps['shear_max_deg'][0]:.1f} deg" in said
    asked = steps["asked"] == 1
    for name, key in (("shear_middle_deg",) * 2, ("load_N", "load_n")):
        assert steps[name][asked].tolist() == summary[key]
    with h5py.File(tmp_path / "series.vtkhdf") as file:
        root = file["VTKHDF"]
        assert root["Steps"].attrs["NSteps"] == 7
        assert root["Steps/Values"][1:] == pytest.approx(steps["extension_mm"])
        assert root.attrs["asked"][1:].tolist() == steps["asked"].tolist()
        moved = root["PointData/displacement_m"][:].reshape(7, -1, 3)[..., 1].max(axis=1)
    assert 1e3 * moved == pytest.approx([0.0, *steps["extension_mm"]], abs=1e-3)


def test_one_extension_is_a_whole_curve(tmp_path):
    """The steps on the way are in curve, series and zones, with a load asked for alike."""
    run(MPI.COMM_SELF, tmp_path, case(finite=True, extension="3 mm", increments=4))
    steps = table(tmp_path / "curve.csv")
    assert steps["asked"].tolist() == [0, 0, 0, 1]
    assert np.isfinite(steps["shear_middle_deg"]).all()
    assert (np.diff(steps["energy_tension_J"]) > 0.0).all()
    with h5py.File(tmp_path / "series.vtkhdf") as file:
        assert file["VTKHDF/Steps"].attrs["NSteps"] == 5
    made = case(finite=True, load=f"{steps['load_N'][-1]} N", increments=3)
    result = made.experiment(Network(MPI.COMM_SELF, made.preform(), made.fabric())).solve()
    curve = result.curve()
    assert len(curve["load_N"]) == len(list(result.every_state())) >= 3
    zones = result.curve(states=True)
    assert len(zones["load_N"]) == 1
    assert not EFFORT.keys() & zones.keys()
    for name in ("load_N", "shear_middle_deg", "extension_mm"):
        assert curve[name][-1] == zones[name][0] == pytest.approx(steps[name][-1], rel=1e-6)
    drawn, _ = figures(result)
    (lines, *_), options = drawn["zones.png"].args, drawn["zones.png"].keywords
    assert len(lines["middle zone (median)"][0]) == 1 + len(curve["load_N"])
    assert options["guides"] is not None


def test_what_the_bar_tells(tmp_path, monkeypatch):
    """Increment, control, shear angle and Newton steps; by load the load."""
    told: list[tuple[float, str]] = []

    @contextmanager
    def bar(log, length, begin=0.0):
        yield lambda done, text: told.append((done / length, text))

    monkeypatch.setattr("cruciform_petsc.output.progress.progress_bar", bar)
    run(MPI.COMM_SELF, tmp_path, case(finite=True, extension="3 mm", increments=2))
    run(MPI.COMM_SELF, tmp_path, case(finite=True, load=["0.2 N", "0.4 N"]))
    assert [share for share, _ in told] == pytest.approx([0.5, 1.0, 0.5, 1.0])
    shear = []
    for (_, text), begin in zip(
        told,
        ("increment 1, 1.5 mm", "increment 2, 3 mm", "increment 1, 0.2 N", "increment 2, 0.4 N"),
        strict=True,
    ):
        found = re.fullmatch(rf"{begin}, (\d+\.\d) deg of shear, \d+ Newton steps", text)
        shear.append(float(found[1]))
    assert shear[1] > 1.5 * shear[0] > 0.0
    assert shear[3] > 1.5 * shear[2] > 0.0


# -- tests that end early --------------------------------------------------------------------------


def test_what_was_reached_is_kept(tmp_path):
    """Compressed beyond what it can be: the sentence, and all increments up to there on disk."""
    made = case(finite=True, extension=["-5 mm", "-40 mm"])
    with pytest.raises(EquilibriumError, match="no equilibrium beyond the last one found, at ext"):
        run_case(MPI.COMM_SELF, made, tmp_path, LOG)
    summary = json.loads((tmp_path / "summary.json").read_text())
    assert "at extension -" in summary["ended_early"]
    assert summary["extension_m"][0] == pytest.approx(-5e-3)
    assert (tmp_path / "network.vtkhdf").exists()
    steps = table(tmp_path / "curve.csv")
    assert steps["extension_mm"].min() < -10.0
    assert len(steps["load_N"]) == len(summary["increments"])
    assert steps["asked"].sum() == 1
    assert summary["load_n"] == [*steps["load_N"][steps["asked"] == 1], steps["load_N"][-1]]


def test_also_if_no_value_asked_for_was_reached(tmp_path):
    made = case(finite=True, extension="-40 mm")
    with pytest.raises(EquilibriumError):
        run_case(MPI.COMM_SELF, made, tmp_path, LOG)
    summary = json.loads((tmp_path / "summary.json").read_text())
    assert "at extension -" in summary["ended_early"]
    steps = table(tmp_path / "curve.csv")
    assert steps["extension_mm"].min() < -10.0
    assert not steps["asked"].any()
    assert summary["load_n"] == steps["load_N"][-1]


# -- warnings --------------------------------------------------------------------------------------


def warned(made):
    experiment = made.experiment(Network(MPI.COMM_SELF, made.preform(), made.fabric()))
    return warnings(experiment.solve())


def test_beyond_the_reach_of_the_net():
    """2.4 cm x 5.4 cm: (sqrt 2 - 1) 30 mm."""
    fabric = {"use": "e-glass-plain-2.4", "tension": {"compression": 0.1}}
    size = ("2.4 cm", "5.4 cm")
    assert not any(
        "along" in told
        for told in warned(case(size=size, finite=True, fabric=fabric, extension="12 mm"))
    )
    told = warned(case(size=size, finite=True, fabric=fabric, extension=["12 mm", "13 mm"]))
    assert any("beyond an extension of 12.43 mm, where yarns" in sentence for sentence in told)


def test_beyond_the_table():
    points = [[5.0, 0.01], [10.0, 0.03]]
    law = {"law": "table", "angle": "deg", "force": "N/mm", "points": points}
    fabric = {"use": "e-glass-plain-2.4", "shear": law, "tension": {"compression": 0.1}}
    (sentence,) = warned(case(finite=True, extension="4 mm", fabric=fabric))
    assert "beyond the last point of the shear law's table at 10.0 deg" in sentence
    assert warned(case(finite=True, extension="0.5 mm", fabric=fabric)) == []
    (sentence,) = warned(case(extension="0.2 mm", fabric=fabric))
    assert "only the moduli at rest act, not the shear law and the softening" in sentence


def test_yarns_under_strains_that_they_do_not_stand():
    first, second = warned(case(finite=True, extension="20 mm"))
    assert first.startswith("yarns are compressed by up to")
    assert second.startswith("yarns are stretched by up to")


def test_small_displacements_that_are_not_small(tmp_path):
    """Beyond some 5 degrees: in summary and log once, in Python as a warning."""
    for made in (case(extension="2 mm"), case("picture-frame", angle="6 deg", **SQUARE)):
        with pytest.warns(InputWarning, match="reaches .* hold to some 5 deg") as told:
            (sentence,) = warned(made)
        assert sum("hold to some" in str(one.message) for one in told) == 1
        assert re.match(r"the shear angle reaches [0-9.]+ deg; small displacements", sentence)
    with catch_warnings():
        simplefilter("error")
        simplefilter("ignore", InputWarning)  # H < 2 W
        assert warned(case(extension="0.2 mm")) == []
        simplefilter("error", InputWarning)
        summary = run(MPI.COMM_SELF, tmp_path, made)  # the log tells it
    assert len(summary["warnings"]) == 1


def test_log_check_and_summary_say_which_deformation(tmp_path, caplog):
    for finite, words in ((True, "finite deformation"), (False, "small displacements")):
        made = case(extension="0.2 mm", finite=finite)
        for tell in (lambda: check_case(MPI.COMM_SELF, made, LOG),  # noqa: B023
                     lambda: run(MPI.COMM_SELF, tmp_path, made)):  # noqa: B023  # fmt: skip
            caplog.clear()
            with caplog.at_level(logging.INFO, LOG.name):
                summary = tell()
            assert f"bias-extension, {words}" in caplog.text
        assert summary["finite"] is finite


# -- the continuum ---------------------------------------------------------------------------------


def test_finite_membrane(tmp_path):
    """Loads and shear angles at each value asked for."""
    made = case(
        size=("4 cm", "8 cm"), finite=True, bending=False, extension=["2 mm", "8 mm"],
        continuum={"compare": True, "mesh_size": "10 mm"},
        output={"pictures": True},
    )  # fmt: skip
    summary = run(MPI.COMM_SELF, tmp_path, made)
    continuum = summary["continuum"]
    # 130 crossovers: bounds for slips in what is compared, not for how fine the network is.
    assert continuum["load_ratio"] == pytest.approx([1.0, 1.0], abs=0.15)
    assert max(continuum["mean_abs_shear_deg"]) < 3.0
    assert continuum["load_ratio"] == pytest.approx(
        np.divide(summary["load_n"], continuum["load_n"])
    )
    columns = table(tmp_path / "continuum.csv")
    assert columns["load_membrane_N"] == pytest.approx(continuum["load_n"])
    for name in ("load_against_extension", "zones", "stages", "shear_map", "centre_line"):
        assert (tmp_path / f"{name}.png").exists()


@pytest.mark.parametrize("kind", ["picture-frame", "biaxial", "cantilever"])
@pytest.mark.parametrize("key", ["compare", "ladder"])
def test_kinds_without_a_membrane(tmp_path, kind, key):
    continuum = {key: True if key == "compare" else [1, 2]}
    made = case(kind, **KINDS[kind], continuum=continuum)
    sentence = f'continuum.{key}: there is no membrane to compare test.kind = "{kind}" with'
    for call in (
        lambda: run_case(MPI.COMM_SELF, made, tmp_path, LOG),
        lambda: check_case(MPI.COMM_SELF, made, LOG),
    ):
        with pytest.raises(InputError, match=sentence):
            call()
    assert list(tmp_path.iterdir()) == []


def test_free_ends_have_no_membrane(tmp_path):
    kind = "off-axis-tension"
    made = case(kind, **KINDS[kind], continuum={"compare": True})
    with pytest.raises(InputError, match='needs gripped ends, leave it out or set test.ends = "g'):
        run_case(MPI.COMM_SELF, made, tmp_path, LOG)


# -- small parts -----------------------------------------------------------------------------------


def test_controls_for_people():
    texts = {
        "bias-extension": "extension 12.5 mm",
        "picture-frame": "angle 0.7162 deg",
        "biaxial": "warp strain 1.25 %",
        "cantilever": "load 12.5 mN",
    }
    for kind, text in texts.items():
        made = case(kind, **KINDS[kind])
        network = Network(MPI.COMM_SELF, made.preform(), made.fabric())
        assert made.experiment(network).column.text(0.0125) == text
    assert made.experiment(network).column.text(3.0) == "load 3 N"


def test_kinematics_of_an_inextensible_net():
    """90 deg - 2 arccos((L0 + d)/(sqrt(2) L0)), to where the net locks; only where it holds."""

    def angle(extension, **changes):
        made = case(**({"size": ("2 cm", "6 cm"), "extension": "1 mm"} | changes))
        network = Network(MPI.COMM_SELF, made.preform(), made.fabric())
        gauge = made.experiment(network).net_gauge()
        return None if gauge is None else np.rad2deg(net_angle(np.array(extension), gauge))

    locked = 0.04 * (np.sqrt(2.0) - 1.0)
    np.testing.assert_allclose(angle([0.0, locked * (1 - 1e-12)]), [0.0, 90.0], atol=1e-4)
    # Of d = L0 (sqrt(2) cos(45 deg - gamma/2) - 1):
    d = 0.04 * (np.sqrt(2.0) * np.cos(np.deg2rad(45.0 - 15.0)) - 1.0)
    np.testing.assert_allclose(angle([d]), [30.0])
    assert np.isnan(angle([0.02])[0])
    made = case(size=("2 cm", "6 cm"), extension="1 mm")
    told = made.experiment(Network(MPI.COMM_SELF, made.preform(), made.fabric())).check()
    assert "lie along the pull at an extension of 16.57 mm" in told[-1]
    for changes in ({"size": ("2 cm", "3.9 cm")}, {"bias": "40 deg"}, {"upper": "centre-line"}):
        assert angle([0.0], **changes) is None


@pytest.mark.parametrize("command", [["check"], ["run", "--output", "out"]])
def test_what_is_filled_in_is_told(tmp_path, capfd, monkeypatch, command):
    """Poisson's ratios that the case leaves out."""
    monkeypatch.chdir(tmp_path)
    yarns = 'modulus = "520 N/cm", yarns = "2.4 /cm", yarn_bending = "0.6 N mm2"'
    (tmp_path / "case.toml").write_text(
        f"[fabric]\nwarp = {{ {yarns}, poisson = 0.3 }}\nweft = {{ {yarns} }}\n"
        'shear = { modulus = "0.5 gf/cm/deg" }\n[output]\npictures = false\nparaview = false\n'
        '[preform]\noutline = { rectangle = ["24 mm", "36 mm"] }\nbias_angle = "45 degrees"\n'
        '[test]\nextension = "1 mm"\n'
    )
    assert main([command[0], "case.toml", *command[1:]]) == 0
    out = capfd.readouterr().out
    assert "fabric.weft.poisson is taken as 0.3, by reciprocity" in out
    assert "shear 0.28094 N/cm" in out  # 0.5 * 0.980665 N/m * 180 / pi


@pytest.mark.parametrize(
    "output",
    ["", "a\0b", "x" * 300, "/".join(["y" * 200] * 30), "\udcff\0"],
    ids=["empty", "zero", "long", "long path", "not UTF-8"],
)
def test_folders_that_cannot_be(tmp_path, capfd, monkeypatch, output):
    """Whichever command is to write there, or to read from there."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "case.toml").write_text(
        '[fabric]\nuse = "e-glass-plain-2.4"\n[preform]\nbias_angle = "45 deg"\n'
        'outline = { rectangle = ["24 mm", "36 mm"] }\n[test]\nextension = "1 mm"\n'
    )
    (tmp_path / "curve.csv").write_text("extension [mm],load [N]\n1,1\n2,2\n3,3\n4,4\n")
    for arguments in (
        ["run", "case.toml", "--output", output],
        ["calibrate", "case.toml", "--data", "curve.csv", "--output", output],
        ["compare", "curve.csv", "curve.csv", "--output", output],
        ["resume", "case.toml", "--output", output],
        ["resume", output],
        ["run", "case.toml", "--set", f"output.directory='{output}'"],
        ["check", "case.toml", "--set", f"output.measured='{output}'"],
        ["calibrate", "case.toml", "--data", output],
        ["compare", output, "curve.csv"],
        ["check", output],
    ):
        assert main(arguments) == 2, arguments
        said = capfd.readouterr()
        assert said.err.count("\n") == 1
        assert said.err.startswith("cruciform-petsc: ")
        assert harmless(said.err) == said.err
    assert {path.name for path in tmp_path.iterdir()} <= {"case.toml", "curve.csv", "results"}
