# SPDX-License-Identifier: MIT
"""Case files that `new` writes, and the page of keys: both are the schema's."""

import runpy
import tomllib
from pathlib import Path

import pytest

from cruciform_petsc.case.schema import Case
from cruciform_petsc.case.template import new_case, write_new_case
from cruciform_petsc.cli import main
from cruciform_petsc.errors import InputError
from cruciform_petsc.experiments.registry import KINDS, in_space, kind_class
from cruciform_petsc.fields import tables_in

NOT_FOR_FORMING = {"scene", "measured", "measured_columns"}
NOT_FOR_FISHNET = {*NOT_FOR_FORMING, "animation"}
NOT_FOR_FLAT = {"part_outline"}
SCRIPT = Path(__file__).parents[2] / "scripts" / "case_keys.py"


@pytest.mark.parametrize("kind", KINDS)
def test_new_case_checks(kind, tmp_path, capfd):
    """What is written is a good case of its kind, network and edges included."""
    path = tmp_path / "new.toml"
    assert main(["new", kind, str(path)]) == 0
    assert Case.load(path).test.kind == kind
    assert main(["check", str(path)]) == 0
    assert capfd.readouterr().err == ""


@pytest.mark.parametrize("kind", KINDS)
def test_suggestions_are_right(kind, tmp_path):
    """Each key that stands in a comment can be taken in, where no other one excludes it."""
    excluded = {"load": "extension", "imperfection": "space = false"}
    excluded |= dict.fromkeys(("warp", "weft", "from_datasheet"), "use")
    excluded |= {"fishnet": "a tool below"} if kind == "inflation" else {}
    excluded |= {"release": "no [[clamp]]", "pressure": "free edges", "corners": "no pretension"}
    excluded |= {"symmetry": "a circle"} if kind == "drape" else {}
    excluded |= {"shear_viscosity": "no speed, no duration"}
    excluded |= dict.fromkeys(("speed", "duration", "temperature"), "no fabric.shear_viscosity")
    excluded |= {"stability": "no slip"} if kind == "pull-out" else {}
    excluded |= {"slip": "Poisson's ratios"} if kind == "cantilever" else {}
    lines = new_case(kind).splitlines()
    tried = 0
    for i, line in enumerate(lines):
        key, equals, _ = line.removeprefix("# ").partition(" = ")
        if not line.startswith("# ") or not equals or not key.isidentifier() or key in excluded:
            continue
        text = "\n".join([*lines[:i], line.removeprefix("# "), *lines[i + 1 :]])
        (tmp_path / "case.toml").write_text(text)
        Case.load(tmp_path / "case.toml")
        tried += 1
    assert tried >= 8


@pytest.mark.parametrize("kind", KINDS)
def test_all_keys_are_there(kind):
    """No key of the schema is left out, defaults are those of the schema, and nothing else."""
    sections = new_case(kind).replace("\n[[", "\n[").replace("]]\n", "]\n").split("\n[")
    assert sections[0].splitlines()[2].startswith("title = ")
    told = {}
    for section in sections[1:]:
        name = section.partition("]")[0]
        model = kind_class(kind).table
        if name != "test":
            (model,) = tables_in(next(
                field.annotation for key, field in Case.model_fields.items()
                if name in (key, field.alias)
            ))  # fmt: skip
        told.setdefault(name, (model, []))[1].extend(
            line.removeprefix("# ").partition(" = ")[0]
            for line in section.splitlines()[1:]
            if line.removeprefix("# ").partition(" = ")[0].isidentifier()
        )
    for name, (model, keys) in told.items():
        left_out = NOT_FOR_FORMING if in_space(kind) else NOT_FOR_FLAT
        left_out = NOT_FOR_FISHNET if kind == "fishnet" else left_out
        left_out = left_out if name == "output" else set()
        several = set if name in ("tool", "stage") else sorted
        assert several(key for key in model.keys() if key not in left_out) == several(keys)  # noqa: SIM118
    case = Case.from_data(tomllib.loads(new_case(kind)))
    own = {"directory", "finite", *kind_class(kind).table.own_keys()}  # these are the kind's
    for table in (case.preform_table, case.continuum, case.output, case.test):
        for key, field in type(table).model_fields.items():
            if in_space(kind) and (
                key in {*NOT_FOR_FISHNET, "yarns_per_cruciform"} or table is case.continuum
            ):
                continue
            if not in_space(kind) and key in NOT_FOR_FLAT:
                continue
            if key not in own and not field.is_required():
                assert getattr(table, key) == field.default, key
                assert (key in table.model_fields_set) == (field.default is not None), key


def test_new_prints(capfd):
    """Without a file the case goes to the screen, ready for a pipe."""
    assert main(["new", "biaxial"]) == 0
    assert capfd.readouterr().out == new_case("biaxial")


def test_results_go_by_the_name_of_the_file(tmp_path):
    """Two cases of a kind do not share a folder, and none is a demo's."""
    for file, folder in (("strip.toml", "strip"), ("my strip, 2.toml", "my_strip_2")):
        write_new_case("biaxial", tmp_path / file)
        assert Case.load(tmp_path / file).output.directory == f"results/{folder}"
    demos = Path(__file__).parents[2] / "demos"
    taken = {Case.load(path).output.directory for path in demos.glob("*.toml")}
    assert not taken & {tomllib.loads(new_case(kind))["output"]["directory"] for kind in KINDS}


def test_new_refuses(tmp_path, capfd):
    """A file that is there stays as it is; unknown kinds and folders are one sentence each."""
    path = tmp_path / "mine.toml"
    path.write_text("mine")
    assert main(["new", "biaxial", str(path)]) == 2
    assert path.read_text() == "mine"
    assert capfd.readouterr().err == (
        f'cruciform-petsc: "{path}" is there already, name another file\n'
    )
    with pytest.raises(InputError, match='no kind of test "biaxal" .did you mean "biaxial"'):
        new_case("biaxal")
    with pytest.raises(InputError, match="cannot be written: No such file or directory"):
        write_new_case("biaxial", tmp_path / "no" / "case.toml")
    with pytest.raises(InputError, match="cannot be written: embedded null byte"):
        write_new_case("biaxial", "a\0b")


def test_page_is_fresh():
    """docs/case-file.md is what the schema says: else run scripts/case_keys.py."""
    script = runpy.run_path(str(SCRIPT))
    assert script["PAGE"].read_text(encoding="utf-8") == script["page"]()


def test_every_table_is_on_the_page():
    """Those that the schema reaches, from the case or a kind of test, each below its own title."""
    script = runpy.run_path(str(SCRIPT))
    shown = {model for _, model in script["_TABLES"]}
    reached = {Case, *(kind_class(kind).table for kind in KINDS)}
    for _ in range(5):  # as deep as tables lie
        fields = [field for model in reached for field in model.model_fields.values()]
        reached |= {table for field in fields for table in tables_in(field.annotation)}
    # Kinds have titles of their own; some tables differ from a shown one by what they leave out.
    kinds = {kind_class(kind).table for kind in KINDS}
    lacking = [
        model.__name__
        for model in reached - kinds
        if not any(issubclass(other, model) or issubclass(model, other) for other in shown)
    ]
    assert not lacking
    assert '`"True"`' not in script["page"]()
    assert "`corners` | a list of lengths |" in script["page"]()


def test_every_key_is_described():
    """The page has no empty cell."""
    page = runpy.run_path(str(SCRIPT))["page"]()
    assert "|  |" not in page
    assert page.count("\n| `") > 50
