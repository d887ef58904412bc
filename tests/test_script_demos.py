# SPDX-License-Identifier: MIT
"""The scripts in demos/scripts: each runs, and says what its prose says."""

import ast
import re
import subprocess
import sys
from pathlib import Path

import pytest

import cruciform_petsc
from cruciform_petsc import calibration

SCRIPTS = Path(__file__).parents[1] / "demos" / "scripts"
# A number that a change in the physics would move, and two that the prose says are alike, within
# what: yarns that stretch a little, the pitch (of first order), rounding of the solver.
PINNED = {
    "bias_extension": ("load_N", 3.916370, ("shear_centre_deg", "shear_of_net_deg"), 0.02),
    "picture_frame": (
        "load_N", 3.076146, ("shear_measured_N_per_mm", "shear_law_N_per_mm"), 1e-6
    ),
    "kilby": ("shear_N_per_cm", 0.9360897, ("at_30_N_per_cm", "kilby_at_30_N_per_cm"), 0.01),
    "off_axis": ("gripped_N_per_cm", 6.721317, ("free_N_per_cm", "kilby_N_per_cm"), 0.02),
    "biaxial": ("warp_N_per_cm", 30.0, None, None),
    "cantilever": (
        "deflection_mm", 0.9495691, ("rigidity_read_N_mm2", "rigidity_given_N_mm2"), 0.01
    ),
    "pantograph": ("load_N", 70.61755, None, None),
}  # fmt: skip


def test_every_script_is_listed():
    assert {path.stem for path in SCRIPTS.glob("*.py")} == set(PINNED)


def cell_by_cell(name):
    """Run a script as a notebook does; the names it leaves."""
    names = {}
    cells = re.split(r"^(?=# %%)", (SCRIPTS / f"{name}.py").read_text(), flags=re.MULTILINE)
    assert len(cells) > 4
    for cell in cells:
        exec(cell, names)
    return names


@pytest.mark.parametrize("name", sorted(PINNED))
def test_script(name, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    drawn = []
    for function in ("plot", "scene"):
        monkeypatch.setattr(cruciform_petsc, function, lambda result, path: drawn.append(str(path)))
    numbers = cell_by_cell(name)["numbers"]
    key, value, alike, within = PINNED[name]
    assert numbers[key] == pytest.approx(value, rel=1e-5)
    if alike is not None:
        assert numbers[alike[0]] == pytest.approx(numbers[alike[1]], rel=within)
    assert all(type(number) is float for number in numbers.values())
    assert all(path.startswith(f"results/scripts/{name}") for path in drawn)


@pytest.mark.parametrize("name", ["biaxial", "cantilever"])
def test_script_draws(name, tmp_path):
    """As a whole; the others draw through the same two functions."""
    command = [sys.executable, str(SCRIPTS / f"{name}.py")]
    subprocess.run(command, cwd=tmp_path, capture_output=True, check=True)
    assert (tmp_path / "results" / "scripts" / f"{name}.png").exists()


@pytest.mark.parametrize("name", sorted(PINNED))
def test_public_names_only(name):
    tree = ast.parse((SCRIPTS / f"{name}.py").read_text())
    froms = [node for node in ast.walk(tree) if isinstance(node, ast.ImportFrom)]
    ours = [node for node in froms if node.module.startswith("cruciform_petsc")]
    public = {"cruciform_petsc": cruciform_petsc, "cruciform_petsc.calibration": calibration}
    for node in ours:
        assert {alias.name for alias in node.names} <= set(public[node.module].__all__)
    names = [n.attr for n in ast.walk(tree) if isinstance(n, ast.Attribute)]
    assert not [attribute for attribute in names if attribute.startswith("_")]
