# SPDX-License-Identifier: MIT
"""Imports go one way: each module imports only what stands left of it, and no circle is made."""

import ast
import re
from pathlib import Path

import pytest

import cruciform_petsc

ROOT = Path(cruciform_petsc.__file__).parent
# Left to right; what stands in one entry does not import its neighbours there.
ORDER = [
    {"errors"},
    {"drawn"},
    {"process"},
    {"reading"},
    {"units"},
    {"fields"},
    {"quantities"},
    {"laws"},
    {"tension"},
    {"parallel"},
    {"memory"},
    {"solvers", "cloth"},
    {"net"},  # not solvers, see ASIDE
    {"elements"},
    {"tools"},
    {"items"},
    {"equilibrium", "small"},
    {"experiments"},
    {"forming"},
    {"continuum", "calibration"},
    {"case"},
    {"output"},
    {"estimate"},
    {"compare", "calibrate", "moduli", "sweep"},
    {"run"},
    {"cli"},
    {"__main__"},
]
# The net and what is built on it know no solver.
ASIDE = {("net", "solvers"), ("elements", "solvers"), ("tools", "solvers"), ("items", "solvers")}
RANK = {name: rank for rank, names in enumerate(ORDER) for name in names}
DOLFINX = ("dolfinx", "ufl", "basix")


def modules():
    return sorted(path for path in ROOT.rglob("*.py") if path != ROOT / "__init__.py")


def name_of(path):
    parts = path.relative_to(ROOT).with_suffix("").parts
    return ".".join(part for part in parts if part != "__init__")


def imported(path):
    """Modules of this package that a file imports anywhere, and others: two sets of names."""
    package = ["cruciform_petsc", *path.relative_to(ROOT).parts[:-1]]
    own, others = set(), set()
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.Import):
            found = [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom):
            base = package[: len(package) - node.level + 1] if node.level else []
            base = ".".join([*base, *([node.module] if node.module else [])])
            found = [f"{base}.{alias.name}" for alias in node.names]
        else:
            continue
        for name in found:
            if not name.startswith("cruciform_petsc"):
                others.add(name.split(".")[0])
                continue
            parts = name.split(".")[1:]
            while parts and not (
                (ROOT / Path(*parts)).with_suffix(".py").exists()
                or (ROOT / Path(*parts) / "__init__.py").exists()
            ):
                parts.pop()
            if parts:  # what is left is the package's own __version__
                own.add(".".join(parts))
    return own, others


GRAPH = {name_of(path): imported(path) for path in modules()}


def test_every_module_has_its_place():
    assert {name.split(".")[0] for name in GRAPH} <= set(RANK)


@pytest.mark.parametrize("name", GRAPH)
def test_imports_go_to_the_left(name):
    folder = name.split(".")[0]
    for other in GRAPH[name][0]:
        target = other.split(".")[0]
        if target == folder:
            continue
        assert RANK[target] < RANK[folder], f"{name} imports {other}, which stands right of it"
        assert (folder, target) not in ASIDE, f"{name} imports {other}"


def test_no_circles():
    """Nor within a folder: modules can be put in order one after the other."""
    waiting = {name: set(own) - {name} for name, (own, _) in GRAPH.items()}
    # A folder's __init__ offers what its modules have; it is not what they need.
    folders = {name for name in GRAPH if (ROOT / Path(*name.split("."))).is_dir()}
    while waiting:
        ready = [name for name, needs in waiting.items() if not (needs & set(waiting)) - folders]
        assert ready, f"these import each other in a circle: {sorted(set(waiting) - folders)}"
        for name in ready:
            del waiting[name]


def test_who_knows_what():
    for name, (_, others) in GRAPH.items():
        folder = name.split(".")[0]
        if folder != "continuum":
            assert not others & set(DOLFINX), f"{name} imports dolfinx"
        if folder in ("elements", "cloth", "net", "tools", "items"):
            assert "petsc4py" not in others, f"{name} imports PETSc"
        if folder == "elements":
            assert "mpi4py" not in others, f"{name} knows of ranks"
    own, _ = GRAPH["equilibrium.newton"]
    assert not {name.split(".")[0] for name in own} & {"net", "items", "tools", "cloth"}
    assert len((ROOT / "equilibrium" / "newton.py").read_text().splitlines()) < 350


def test_what_is_loaded_by_name():
    """Of what stands right of it: what draws and shows objects, by one module alone."""
    text = {name_of(path): path.read_text() for path in modules()}
    assert {n for n, t in text.items() if "import_module(" in t} == {
        "drawn",
        "experiments.registry",
    }
    assert text["drawn"].count("import_module(") == 1


def test_frames_are_turned_in_one_place():
    """Vectors go between x, y and the yarns by Network.to_yarn and to_lab."""
    for path in modules():
        folder = path.relative_to(ROOT).parts[0]
        if folder in ("net", "small", "cloth"):
            continue
        by_hand = re.findall(
            r".*(?:@\s*\w*\.?(?:preform\.)?rotation\b|rotation(?:\.T)?\s*@).*", path.read_text()
        )
        assert not by_hand, f"{path.name}: {by_hand[0].strip()}"
