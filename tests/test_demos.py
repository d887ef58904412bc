# SPDX-License-Identifier: MIT
"""Every demo, run as a user would, and what it leaves behind; flat tests on two ranks, too."""

import json
import subprocess
import sys
import tomllib
from pathlib import Path

import numpy as np
import pytest
import shapely

from cruciform_petsc.calibration import bending_rigidity

DEMOS = Path(__file__).parents[1] / "demos"
README = DEMOS.parent / "README.md"

# One number of each that a change in the physics would move, of the last value; load in N.
SMALL = {
    "bias_extension": 0.495036,
    "l_with_window": None,
    "ladder": None,
    "paper_procedure": 0.3,
    "real_specimen": 1.5,
}
FINITE = {
    "biaxial": ("force_warp_n", 800.0),
    "biaxial_cross": ("force_warp_n", 99.982),
    "biaxial_surface": ("force_warp_n", 796.309404),
    "cantilever": ("tip_across_mm", 28.919694),
    "finite_bias_extension": ("load_n", 8.568834),
    "frame_under_tension": ("load_n", 6.832723),
    "off_axis": ("load_n", 2.433820),
    "pantograph": ("load_n", 70.61755),
    "picture_frame": ("load_n", 6.849837),
    "picture_frame_cycle": ("load_n", 9.209219),
    "prepreg_frame": ("load_n", 10.478631),
    "pull_out": ("load_n", 0.15852950),
    "sin_potential": ("load_n", 11.20169),
}
BIAXIAL = {"biaxial", "biaxial_cross", "biaxial_surface"}
FORMING = {
    "hemisphere", "capstan", "cushion", "double_dome", "double_dome_45", "drape", "sail",
    "fishnet", "three_corners", "two_plies",
}  # fmt: skip
# Load at which it becomes unstable, N, on the way and linearised; and the closed form's.
BUCKLING = {
    "strut_buckling": (-0.0788, -0.07881, -4 * np.pi**2 * 1e-3 / 0.1**2 * 0.02),
    "sheared_panel": (0.6626, 0.6788, 95.823 * 1e-3 / 0.2**2 * 0.2 * np.sqrt(2)),
}
ELSEWHERE = {"calibrate_glass_pp", "calibrate_crimp"}  # with the tests of calibration
WHOLE_ON_TWO = {"bias_extension", "sin_potential"}  # with membrane and pictures on two ranks, too
KEYS = {
    "title", "ranks", "crossovers", "dofs", "extension_m", "shear_centre_deg",
    "shear_max_deg", "energy_j", "solver", "wall_s", "peak_mib_per_rank",
}  # fmt: skip


def run(demo, ranks, folder, *options):
    """Run a demo through mpirun; its summary."""
    command = ["mpirun", "-n", str(ranks), sys.executable, "-m", "cruciform_petsc", "run"]
    done = subprocess.run(
        [*command, str(DEMOS / f"{demo}.toml"), "--output", str(folder), *options],
        capture_output=True, text=True, timeout=300, check=False,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    return json.loads((folder / "summary.json").read_text())


def whole(demo, tmp_path):
    """Run it on one rank with all that it shows; some also on two."""
    alone = run(demo, 1, tmp_path / "1")
    assert set(alone) >= KEYS
    assert set(alone["energy_j"]) - {"slip"} == {"tension", "shear", "bending"}
    if demo in WHOLE_ON_TWO:
        both = run(demo, 2, tmp_path / "2")
        same_on_both(demo, alone, both)
        names = [{path.name for path in (tmp_path / rank).glob("*.png")} for rank in ("1", "2")]
        assert names[1] == names[0]
        ratio = alone["continuum"]["load_ratio"]
        assert both["continuum"]["load_ratio"] == pytest.approx(ratio, rel=1e-6)
    return alone


def same_on_both(demo, alone, both):
    """Whether summaries of one rank and two tell the same."""
    assert (alone["ranks"], both["ranks"]) == (1, 2)
    force = "force_warp_n" if demo in BIAXIAL else "load_n"
    for key in (force, "extension_m", "shear_centre_deg", "shear_max_deg"):
        # LSQR of the separate systems stops at 1e-10 of the normal residual, times its condition.
        rel = 1e-5 if alone["model"] == "separate" else 1e-8
        assert both[key] == pytest.approx(alone[key], rel=rel, abs=1e-9), (demo, key)


# Networks alone of demos on two ranks, then each on one of them: as the command does it, but that
# Python and compiled kernels are loaded once, which takes longer than most demos.
MANY = """
import logging, sys
from pathlib import Path
from mpi4py import MPI
from cruciform_petsc.case.schema import Case
from cruciform_petsc.run import run_case

world, folder, demos = MPI.COMM_WORLD, Path(sys.argv[1]), [Path(demo) for demo in sys.argv[2:]]
bare = ["output.pictures=false", "continuum={}"]
log = logging.getLogger("demos")
for comm, those in ((world, demos), (MPI.COMM_SELF, demos[world.rank :: world.size])):
    for demo in those:
        case = Case.load_collective(comm, demo, bare)
        run_case(comm, case, folder / f"{comm.size}" / demo.stem, log)
"""


def on_two_ranks(demos, folder):
    """Summaries of demos on one rank and on two, by their names."""
    paths = [str(DEMOS / f"{demo}.toml") for demo in demos]
    done = subprocess.run(
        ["mpirun", "-n", "2", sys.executable, "-m", "mpi4py", "-c", MANY, str(folder), *paths],
        capture_output=True, text=True, timeout=600, check=False,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    for demo in demos:
        told = [json.loads((folder / r / demo / "summary.json").read_text()) for r in "12"]
        for name in ("network.vtkhdf", "curve.csv"):
            assert (folder / "2" / demo / name).stat().st_size > 40
        yield demo, *told


def last(values):
    """The last of a list, or a number that is none."""
    return values[-1] if isinstance(values, list) else values


def test_every_demo_is_listed():
    assert {path.stem for path in DEMOS.glob("*.toml")} == set(SMALL) | set(FINITE) | FORMING | set(
        BUCKLING
    ) | ELSEWHERE


@pytest.mark.parametrize("demo", sorted(SMALL))
def test_small(demo, tmp_path):
    """Displacements are small: everything is in proportion."""
    alone = whole(demo, tmp_path)
    told = {"ksp", "pc", "iterations", "reason", "relative_residual", "setup_s", "solution_s"}
    assert set(alone["solver"]) == told
    if SMALL[demo] is not None:
        assert last(alone["load_n"]) == pytest.approx(SMALL[demo], rel=1e-5)
    if demo == "real_specimen":
        assert len(alone["load_n"]) == 6
        assert alone["shear_max_deg"][1] == pytest.approx(2 * alone["shear_max_deg"][0])
    if demo == "ladder":
        errors = [rung["relative_l2_displacement"] for rung in alone["continuum"]["ladder"]]
        assert len(errors) == 5
        assert errors == sorted(errors, reverse=True)
        assert (tmp_path / "1" / "ladder.csv").stat().st_size > 200
        assert (tmp_path / "1" / "ladder.png").exists()
    if "continuum" in alone:
        assert {"relative_l2_displacement", "energy_ratio", "load_ratio"} <= set(alone["continuum"])
    for name in ("yarns.png", "shear_map.png", "centre_line.png", "shear_against_load.png"):
        assert (tmp_path / "1" / name).exists()
    assert (tmp_path / "1" / "centre_line.csv").stat().st_size > 40


@pytest.mark.parametrize("demo", sorted(FINITE))
def test_finite(demo, tmp_path):
    """Displacements are not: there are increments, a series over time, and stages to see."""
    alone = whole(demo, tmp_path)
    key, value = FINITE[demo]
    assert alone[key][-1] == pytest.approx(value, rel=1e-5)
    assert {"snes", "ksp", "pc", "newton_iterations"} <= set(alone["solver"])
    force = "force_warp_n" if demo in BIAXIAL else "load_n"
    asked = [step[force] for step in alone["increments"] if step["asked"]]
    assert asked == pytest.approx(alone[force], rel=1e-12)
    assert all(step["residual_n"] <= step["tolerance_n"] for step in alone["increments"])
    if demo == "cantilever":  # the demo's lesson; the cloth's shear takes the rest
        loads, tips = (np.array(alone[key]) for key in ("load_n", "tip_across_mm"))
        read = [
            bending_rigidity(p, "100 mm", 1e-3 * w) / 7 for p, w in zip(loads, tips, strict=True)
        ]
        assert read == pytest.approx(len(read) * [0.6e-6], rel=3e-3)
    if demo == "biaxial_surface":
        assert "tension_surface.png" in {path.name for path in (tmp_path / "1").glob("*.png")}
    if demo == "sin_potential":  # 561 crossovers: of first order in the pitch
        assert alone["continuum"]["load_ratio"] == pytest.approx([1.0] * 5, abs=0.05)
    pictures = {path.name for path in (tmp_path / "1").glob("*.png")}
    assert {"yarns.png", "energy.png"} < pictures
    assert len([name for name in pictures if "_against_" in name]) == 1
    assert ("stages.png" in pictures) == (demo not in BIAXIAL)
    for name in ("series.vtkhdf", "curve.csv"):
        assert (tmp_path / "1" / name).stat().st_size > 40


@pytest.mark.parametrize("demos", [SMALL, FINITE], ids=["small", "finite"])
def test_the_same_on_two_ranks(demos, tmp_path):
    """To 1e-8, but for those that are run whole on two anyway."""
    for demo, alone, both in on_two_ranks(sorted(set(demos) - WHOLE_ON_TWO), tmp_path):
        same_on_both(demo, alone, both)
        assert (tmp_path / "2" / demo / "series.vtkhdf").exists() == (
            alone["finite"] or len(np.atleast_1d(alone["load_n"])) > 1
        )


@pytest.mark.parametrize("demo", sorted(BUCKLING))
def test_buckling(demo, tmp_path):
    """Critical loads near the closed form's; the cloth goes on along its branch."""
    bare = ("--set", "output.pictures=false")
    alone, both = (run(demo, r, tmp_path / f"{r}", *bare * (r - 1)) for r in (1, 2))
    passed, linear, closed = BUCKLING[demo]
    for summary in (alone, both):
        found = summary["stability"]
        assert [state["load_n"] for state in found["critical"]] == pytest.approx([passed], rel=2e-4)
        assert found["linear"][0]["load_n"] == pytest.approx(linear, rel=2e-4)
        assert found["linear"][0]["load_n"] == pytest.approx(closed, rel=5e-3)
    assert both["height_max_mm"] == pytest.approx(alone["height_max_mm"], rel=1e-5)
    if demo == "strut_buckling":  # h = 2/pi sqrt(L d), d the shortening beyond the critical one
        height = 2 / np.pi * np.sqrt(100 * (1 - 0.0076))
        assert alone["height_max_mm"][-1] == pytest.approx(height, rel=5e-3)
    for name in ("mode.png", "lowest_stiffness.png", "mode.vtkhdf", "report.html"):
        assert (tmp_path / "1" / name).stat().st_size > 2000


def test_hemisphere(tmp_path):
    """The punch's force in so many steps on so coarse a net; the blank is drawn in evenly."""
    summary = run("hemisphere", 2, tmp_path, "--set", "output.pictures=false")
    assert summary["tool_force_n"]["punch"][2] == pytest.approx(-41.05, rel=5e-3)
    assert summary["tool_force_n"]["holder"][2] == pytest.approx(-50.0)
    assert np.linalg.norm(sum(map(np.array, summary["tool_force_n"].values()))) < 0.1
    assert summary["shear_max_deg"] == pytest.approx(41.35, abs=0.3)
    assert list(summary["draw_in_mm"].values()) == pytest.approx([37.045] * 4, rel=5e-3)
    stored = sum(summary["energy_j"].values())  # and dissipated; in steps of a tenth of the stroke
    assert summary["work_of_tools_j"] == pytest.approx(stored, rel=0.05)


def form(demo, ranks, folder, *coarser):
    """Run a forming without pictures, on a coarser net where that is asked for; its summary."""
    options = [word for change in coarser for word in ("--set", change)]
    return run(demo, ranks, folder, "--set", "output.pictures=false", *options)


def column(folder, name, file="fields.csv"):
    """A column of a table in a folder of results."""
    return np.genfromtxt(folder / file, delimiter=",", names=True)[name]


def test_capstan(tmp_path):
    """Tensions on both sides of the cylinder, by the angle between them: e^(mu phi)."""
    summary = form("capstan", 1, tmp_path)
    left, right = (np.array(summary["clamps"][edge]["force_n"]) for edge in ("left", "right"))
    slack, tight = sorted([np.linalg.norm(left), np.linalg.norm(right)])
    phi = np.pi - np.arccos(left @ right / (slack * tight))
    assert np.rad2deg(phi) == pytest.approx(61.1, abs=0.2)
    assert tight / slack == pytest.approx(np.exp(0.2 * phi), rel=2e-3)
    cylinder = np.array(summary["tool_force_n"]["cylinder"])
    assert np.linalg.norm(left + right + cylinder) < 1e-3 * tight


def test_cushion(tmp_path):
    """The centre rises as much as in the literature, 0.205 to 0.217 m; the seam carries p A."""
    summary = form("cushion", 1, tmp_path)
    height = column(tmp_path, "z_mm").max() - 0.3
    assert 205.0 < height < 219.0
    edge = column(tmp_path, "z_mm", "outline.csv")
    rest = np.genfromtxt(tmp_path / "outline.csv", delimiter=",", names=True)
    seam = (rest["x_rest_mm"] > 424.2) | (rest["y_rest_mm"] > 424.2)
    np.testing.assert_allclose(edge[seam], 0.3, atol=0.01)  # the film's middle
    up = sum(clamp["force_n"][2] for clamp in summary["clamps"].values())
    ring = np.column_stack([rest["x_mm"], rest["y_mm"]])[seam]
    corner = np.vstack([[0.0, 0.0], [ring[ring[:, 1].argmin()][0], 0.0]])
    order = np.argsort(np.arctan2(ring[:, 1], ring[:, 0]))
    area = shapely.Polygon([*corner[:1], *ring[order]]).area * 1e-6
    assert -up == pytest.approx(5e3 * area, rel=0.02)


def short_half_axis(folder):
    """Where the middle of the long side ends in plan, mm."""
    table = np.genfromtxt(folder / "outline.csv", delimiter=",", names=True)
    side = table[table["x_rest_mm"] > 249.9]
    return float(side["x_mm"][abs(side["y_rest_mm"]).argmin()])


def test_double_dome(tmp_path):
    """0/90: yarns across hardly stretch, so their half ends near 189.0 mm; published is 191."""
    summary = form("double_dome", 1, tmp_path, "preform.yarns_per_cruciform=8")
    assert short_half_axis(tmp_path) == pytest.approx(190.5, abs=2.5)
    assert summary["tool_force_n"]["holder"][2] == pytest.approx(-25.0)
    forces = [force[2] for force in summary["tool_force_n"].values()]
    assert abs(sum(forces)) < 0.02 * max(forces)  # viscosity takes part of it


def test_double_dome_at_45_degrees(tmp_path):
    """The whole is symmetric by half a turn."""
    form("double_dome_45", 1, tmp_path, "preform.yarns_per_cruciform=10")
    table = np.genfromtxt(tmp_path / "outline.csv", delimiter=",", names=True)
    low, high = (table[edge * table["x_rest_mm"] > 249.9] for edge in (-1, 1))
    np.testing.assert_allclose(sorted(low["x_mm"]), sorted(-high["x_mm"]), atol=1.0)
    assert 180.0 < short_half_axis(tmp_path) < 215.0


def test_drape(tmp_path):
    """Discs carry the cloth's weight; its rim hangs in folds, about as measured: 82.9 %."""
    summary = form("drape", 1, tmp_path, "preform.yarns_per_cruciform=6")
    weight = 0.1238 * 9.80665 * np.pi * 0.15**2
    up = sum(force[2] for force in summary["tool_force_n"].values())
    assert up == pytest.approx(weight, rel=2e-3)
    told = summary["drape"]
    # 74.6 % at a pitch of 30 mm, 81.5 % at the demo's 20 mm, 83.1 % at 15 mm
    assert told["coefficient_percent"] == pytest.approx(74.6, abs=2.0)
    assert told["folds"] >= 2
    # Of the outline in plan a little less: here and there cloth bulges out over its rim.
    table = np.genfromtxt(tmp_path / "outline.csv", delimiter=",", names=True)
    area = shapely.Polygon(np.column_stack([table["x_mm"], table["y_mm"]])).buffer(0).area
    flat = np.column_stack([table["x_rest_mm"], table["y_rest_mm"]])
    disc = np.pi * 90.0**2
    share = (area - disc) / (shapely.Polygon(flat).area - disc)
    assert told["coefficient_percent"] == pytest.approx(100 * share, abs=3.0)


def test_sail(tmp_path):
    """Edges carry what the wind pushes; the form of force densities is where it began."""
    summary = form("sail", 1, tmp_path, "preform.yarns_per_cruciform=2")
    up = sum(clamp["force_n"][2] for clamp in summary["clamps"].values())
    assert up == pytest.approx(-500 * 4.0, rel=1e-3)
    told = summary["inflation"]
    assert told["force_densities"]["rise_mm"] == pytest.approx(600.0, rel=1e-3)
    assert told["volume_m3"][0] == pytest.approx(0.3 * 4.0, rel=5e-3)  # of the saddle, on its way
    assert told["volume_m3"][0] < told["volume_m3"][1] < told["volume_m3"][2]


def test_fishnet(tmp_path):
    """Where the double dome shears most is told: at its ends, the same on one rank and two."""
    alone, both = run("fishnet", 1, tmp_path / "1"), form("fishnet", 2, tmp_path / "2")
    assert alone["shear_max_deg"] == pytest.approx(45.7, abs=0.1)
    assert both["shear_max_deg"] == pytest.approx(alone["shear_max_deg"], rel=1e-9)
    x, y = np.abs(alone["shear_max_at_mm"]["flat"])
    assert (x, y) == pytest.approx((91.67, 391.67), abs=0.1)
    assert alone["fishnet"]["seed_mm"] == [0.0, 0.0]
    # An inextensible yarn of 250 mm across it ends where that of a forming is held against.
    assert short_half_axis(tmp_path / "1") == pytest.approx(189.0, abs=0.5)
    for name in ("formed.png", "shear_map.png", "report.html", "outline.svg"):
        assert (tmp_path / "1" / name).stat().st_size > 1000


def test_three_corners(tmp_path):
    """From an STL: the forces balance, and cloth and punch are the same on both sides of x = 0."""
    summary = form("three_corners", 1, tmp_path, "preform.yarns_per_cruciform=5")
    forces = np.array(list(summary["tool_force_n"].values()))
    assert np.linalg.norm(forces.sum(axis=0)) < 5e-3 * forces[0, 2]
    drawn = summary["draw_in_mm"]
    assert drawn["left"] == pytest.approx(drawn["right"], abs=0.3)
    assert summary["shear_max_deg"] > 3.0


def follow(page, name, commands, folder):
    """Do what a page of the docs says, with its case as a file; returns what is printed."""
    text = (DEMOS.parent / "docs" / page).read_text()
    case = text.split("```toml\n")[1].split("```")[0]
    (folder / name).write_text(f"{case}[output]\npictures = false\n")  # others have
    (folder / "demos").symlink_to(DEMOS)
    lines = [line[4:] for line in text.splitlines() if line.startswith("    ")]
    assert sum(line.startswith("cruciform-petsc") for line in lines) == commands
    done = subprocess.run(
        ["bash", "-euc", "\n".join(lines)], cwd=folder, capture_output=True, text=True,
        timeout=600, check=False,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    return done.stdout


def test_tutorial(tmp_path):
    """The case and the commands of the page, as they stand there, one after the other."""
    follow("tutorial.md", "sheet.toml", 8, tmp_path)
    results = tmp_path / "results"
    summary = json.loads((results / "predicted" / "summary.json").read_text())
    assert summary["case"]["preform"]["outline"]["rectangle"] == ["150 mm", "450 mm"]
    assert 45.0 < summary["shear_max_deg"][-1] < 60.0
    # The law in use is the one that was found, not the assumed one.
    found = tomllib.loads((results / "law" / "law.toml").read_text())
    assert summary["case"]["fabric"]["shear"]["points"] == found["fabric"]["shear"]["points"]
    # What the page says of loads and angles.
    sheet = json.loads((results / "sheet" / "summary.json").read_text())
    assert sheet["load_n"][-1] == pytest.approx(17.4, abs=0.05)
    assert sheet["shear_max_deg"][-1] == pytest.approx(53.0, abs=0.5)
    law = json.loads((results / "law" / "calibration.json").read_text())
    assert law["rms_relative_error"] == pytest.approx(0.025, abs=5e-4)
    for name in ("sheet_compared", "fitted_compared", "by_strain"):
        assert (results / name / "comparison.json").exists()


def test_forming_tutorial(tmp_path):
    """The case and the commands of the page, as they stand there, one after the other."""
    said = follow("tutorial-forming.md", "tutorial.toml", 3, tmp_path)
    assert "shear" in said
    folder = tmp_path / "results" / "tutorial"
    told = {name: (folder / name).stat().st_size for name in ("fields.csv", "outline.svg")}
    assert min(told.values()) > 500
    columns = (folder / "fields.csv").read_text().splitlines()[0]
    assert {"warp_strain_percent", "shear_deg", "warp_x", "weft_x"} <= set(columns.split(","))
    finer = json.loads((tmp_path / "results/tutorial_finer/summary.json").read_text())
    assert finer["crossovers"] > 100


def script_of(document, heading, folder, ranks):
    """Run the Python below a heading of a document, as it stands there."""
    text = document.read_text().split(f"## {heading}")[1]
    (folder / "script.py").write_text(text.split("```python\n")[1].split("```")[0])
    done = subprocess.run(
        ["mpirun", "-n", str(ranks), sys.executable, "script.py"],
        cwd=folder, capture_output=True, text=True, timeout=300, check=False,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    return done.stdout


def test_ten_lines_of_python(tmp_path):
    assert script_of(README, "Ten lines of Python", tmp_path, 2).count("Comparison(") == 2
    assert (tmp_path / "bias.png").exists()
    assert (tmp_path / "bias.vtkhdf").stat().st_size > 10_000


def test_sweep_from_python(tmp_path):
    """Also where mpirun has started the script, on one rank."""
    (tmp_path / "demos").symlink_to(DEMOS)
    said = script_of(DEMOS.parent / "docs" / "sweeps.md", "Several values of a key", tmp_path, 1)
    assert said.startswith("[30.0, 45.0] [")
    assert said.endswith("['done', 'done']\n")


def test_checkpoint_from_python(tmp_path):
    (tmp_path / "case.toml").write_text((DEMOS / "picture_frame.toml").read_text())
    script_of(DEMOS.parent / "docs" / "restart.md", "From Python", tmp_path, 1)
    assert (tmp_path / "results" / "mine" / "checkpoint" / "newest").is_dir()
