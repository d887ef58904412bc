# SPDX-License-Identifier: MIT
"""Every demo, run as a user would on 1 and 2 ranks, and what it leaves behind."""

import json
import subprocess
import sys
from pathlib import Path

import pytest

DEMOS = Path(__file__).parents[1] / "demos"

# One number of each that a change in the physics would move: (load in N, of the last value).
LOADS = {
    "bias_extension": 0.495036,
    "l_with_window": None,
    "ladder": None,
    "paper_procedure": 0.3,
    "real_specimen": 1.5,
}
KEYS = {
    "title", "ranks", "crossovers", "dofs", "load_n", "extension_m", "shear_centre_deg",
    "shear_max_deg", "energy_j", "solver", "wall_s", "peak_mib_per_rank",
}  # fmt: skip


def run(demo, ranks, folder):
    """Run a demo through mpirun; its summary."""
    command = ["mpirun", "-n", str(ranks), sys.executable, "-m", "cruciform_petsc", "run"]
    done = subprocess.run(
        [*command, str(DEMOS / f"{demo}.toml"), "--output", str(folder)],
        capture_output=True, text=True, timeout=300, check=False,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    return json.loads((folder / "summary.json").read_text())


def test_every_demo_is_listed():
    assert {path.stem for path in DEMOS.glob("*.toml")} == set(LOADS)


@pytest.mark.parametrize("demo", sorted(LOADS))
def test_demo(demo, tmp_path):
    alone, both = (run(demo, ranks, tmp_path / str(ranks)) for ranks in (1, 2))
    assert set(alone) >= KEYS
    assert (alone["ranks"], both["ranks"]) == (1, 2)
    assert set(alone["energy_j"]) == {"tension", "shear", "bending"}
    assert set(alone["solver"]) == {
        "ksp", "pc", "iterations", "reason", "relative_residual", "setup_s", "solution_s",
    }  # fmt: skip
    for key in ("load_n", "extension_m", "shear_centre_deg", "shear_max_deg"):
        # LSQR of the separate systems stops at 1e-10 of the normal residual, times its condition.
        rel = 1e-5 if alone["model"] == "separate" else 1e-8
        assert both[key] == pytest.approx(alone[key], rel=rel)
    last = alone["load_n"][-1] if isinstance(alone["load_n"], list) else alone["load_n"]
    if LOADS[demo] is not None:
        assert last == pytest.approx(LOADS[demo], rel=1e-5)
    if demo == "real_specimen":
        assert len(alone["load_n"]) == 6
        assert alone["shear_max_deg"][1] == pytest.approx(2 * alone["shear_max_deg"][0])
    if demo == "ladder":
        errors = [rung["relative_l2_displacement"] for rung in alone["continuum"]["ladder"]]
        assert len(errors) == 5
        assert errors == sorted(errors, reverse=True)
        assert (tmp_path / "1" / "ladder.csv").stat().st_size > 200
        assert (tmp_path / "1" / "ladder.png").stat().st_size > 10_000
    if "continuum" in alone:
        assert {"relative_l2_displacement", "energy_ratio", "load_ratio"} <= set(alone["continuum"])
    for folder in ("1", "2"):
        for name in ("yarns.png", "shear_map.png", "centre_line.png", "shear_against_load.png"):
            assert (tmp_path / folder / name).stat().st_size > 10_000
        for name in ("network.vtkhdf", "curve.csv", "centre_line.csv"):
            assert (tmp_path / folder / name).stat().st_size > 40


def test_ten_lines_of_python(tmp_path):
    """The README's script, as it stands there."""
    text = (DEMOS.parent / "README.md").read_text().split("```python\n")[1].split("```")[0]
    script = tmp_path / "script.py"
    script.write_text(text)
    done = subprocess.run(
        ["mpirun", "-n", "2", sys.executable, "script.py"],
        cwd=tmp_path, capture_output=True, text=True, timeout=300, check=False,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    assert done.stdout.count("Comparison(") == 2
    assert (tmp_path / "bias.png").stat().st_size > 10_000
    assert (tmp_path / "bias.vtkhdf").stat().st_size > 10_000
