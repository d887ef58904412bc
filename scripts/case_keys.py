# SPDX-License-Identifier: MIT
"""Write docs/case-file.md, the page of every key of the case file, from the schema.

    scripts/fenicsx python3 scripts/case_keys.py [--check]

With --check nothing is written; exit code 1 if the page is not what the schema says.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any, Literal, get_args, get_origin

from pydantic import BaseModel
from pydantic.fields import FieldInfo

from cruciform_petsc import fields
from cruciform_petsc.case import schema as case
from cruciform_petsc.cloth import biaxial, datasheet, fabric, preform, resistance
from cruciform_petsc.experiments.registry import DEFAULT, KINDS, forms, kind_class
from cruciform_petsc.experiments.table import (
    ImperfectionTable,
    SlipTable,
    StabilityTable,
    TestTable,
)
from cruciform_petsc.fields import Of, Table
from cruciform_petsc.forming import fishnet_table as fishnet
from cruciform_petsc.forming import plies
from cruciform_petsc.forming import table as forming
from cruciform_petsc.tools import tool
from cruciform_petsc.units import MEASURES

PAGE = Path(__file__).parents[1] / "docs" / "case-file.md"

_HEAD = """# Every key of a case file

Generated from the schema by `scripts/case_keys.py`; a test fails when this page is stale. A case
file to begin with, for each kind of test: `cruciform-petsc new KIND FILE`.

A case file is TOML of at most 4 MiB. A quantity is a text of a number and a unit, `"2.4 cm"`; any
unit of the right dimension will do, the one given here is an example. Powers are written `mm^2`,
`mm**2`, `mm2` or `mm²`, products `N mm`, `N*mm` or `N·mm`, quotients `N/mm` or `gf/(cm deg)`; `gf`,
`kgf`, `lbf`, `in`, `gsm`, `epi` and `ppi` are known, too. A shear modulus may be per angle
(`gf/cm/deg`, as KES gives it). Numbers without dimension stand bare. Unknown keys are refused, and
numbers far beyond those of any cloth.
"""

# What is not one value, in words.
_SHAPES: dict[Any, str] = {
    fields.Point: "a pair of lengths",
    fields.Sides: "a pair of lengths",
    fields.Ring: "a list of 3 or more pairs of lengths",
    fields.Line: "a list of 2 or more pairs of lengths",
    list[fields.Line]: "a list of lists of pairs of lengths",
    list[fields.Ring]: "a list of lists of pairs of lengths",
    fields.Pairs: "a list of pairs of numbers",
    list[fields.Pair]: "a list of pairs of numbers",
    biaxial.Fours: "a list of lists of 4 numbers",
    fields.Counts: "a list of whole numbers from 1 up",
    tool.Place: "a list of 3 lengths",
    list[fields.Size]: "a list of 3 lengths",
    list[fields.Length]: "a list of lengths",
    list[fields.Number]: "a list of 3 numbers",
    tool.Angles: "a list of 3 angles",
    tool.Curve: "a list of pairs of numbers",
    tool.Profiles: "a list of 2 or more pairs of lengths",
    list[fields.Point]: "a list of 2 or more pairs of lengths",
    list[tool.ToolTable]: "tables",
    list[forming.ClampTable]: "tables",
    list[plies.PlyTable]: "tables",
    list[forming.StageTable]: "tables",
    list[forming.SideName]: 'a list of `"left"`, `"right"`, `"lower"`, `"upper"`',
    list[fields.Name]: "a list of texts",
    preform.Names: "a list of texts",
    forming.Force: 'a force, `"100 N"`, or a list of 3 forces',
}

# A tool's shape, by its key.
_SHAPES_OF_TOOLS = [
    (name, next(fields.tables_in(field.annotation)))
    for name, field in tool.ShapeTable.model_fields.items()
    if next(fields.tables_in(field.annotation), None)
]

# Tables by where they stand, in the order of the page.
_TABLES: tuple[tuple[str, type[Table]], ...] = (
    ("Outside all tables", case.Case),
    ("`[fabric]`", fabric.FabricTable),
    ("`fabric.from_datasheet`", datasheet.DatasheetTable),
    ("`fabric.from_datasheet.warp`, `fabric.from_datasheet.weft`", datasheet.YarnSheet),
    ("`fabric.warp`, `fabric.weft`", fabric.YarnTable),
    ("`fabric.warp.tension`, `fabric.weft.tension`", fabric.TensionLawTable),
    ("`fabric.warp.out_of_plane_moment`, `fabric.weft.out_of_plane_moment`", fabric.MomentLawTable),
    ("`fabric.shear`", fabric.ShearTable),
    ("`fabric.shear_viscosity`", resistance.ViscosityTable),
    ("`fabric.shear_friction`", resistance.FrictionTable),
    ("`fabric.tension`", fabric.TensionTable),
    ("`fabric.tension.surface`", biaxial.SurfaceTable),
    ("`fabric.tension.crimp`", biaxial.CrimpTable),
    ("`fabric.tension.crimp.crossover`", biaxial.ContactTable),
    ("`[preform]`", preform.PreformTable),
    ("`preform.outline`", preform.OutlineTable),
    ("`preform.edges`, by name", preform.EdgeTable),
    ("`[test]`, every kind but forming, drape, inflation, fishnet", TestTable),
    ("`test.imperfection`", ImperfectionTable),
    ("`test.slip`", SlipTable),
    ("`test.stability`", StabilityTable),
    ('`[test]`, `kind = "forming"`', forming.FormingTable),
    *(
        (f'`[test]`, `kind = "{kind}"`', kind_class(kind).table)
        for kind in KINDS
        if forms(kind) and kind != "forming"
    ),
    ("`test.imperfection` of forming", forming.WavesTable),
    ("`test.contact`", forming.ContactTable),
    ("`test.fishnet` of forming", fishnet.StartTable),
    ('`[test]`, `kind = "fishnet"`', fishnet.FishnetTable),
    ("`least_energy` of a fishnet", fishnet.LeastEnergyTable),
    ("`test.stability` of forming", forming.SoftestTable),
    ("`[[tool]]`", tool.ToolTable),
    ("`tool.shape`", tool.ShapeTable),
    *((f"`tool.shape.{name}`", table) for name, table in _SHAPES_OF_TOOLS),
    ("`[[ply]]`", plies.PlyTable),
    ("`[[clamp]]`", forming.ClampTable),
    ("`[[stage]]`", forming.StageTable),
    ("`stage.trim`", forming.TrimTable),
    ("`stage.turn`, by tool", tool.TurnTable),
    ("`[continuum]`", case.ContinuumTable),
    ("`[solver]`", case.SolverTable),
    ("`[output]`", case.OutputTable),
)


def page() -> str:
    """The whole page."""
    parts = [_HEAD]
    for title, model in _TABLES:
        keys = [key for key, field in model.model_fields.items() if field.description]
        parts.append(f"## {title}\n\n{_table(model, keys)}")
        if model is TestTable:
            tables = {kind: kind_class(kind).table for kind in KINDS}
            parts += [_kind(k, t) for k, t in tables.items() if issubclass(t, TestTable)]
    return "\n".join(parts)


def _kind(name: str, model: type[TestTable]) -> str:
    doc = " ".join((model.__doc__ or "").split())
    more = " The yarns run along the edges of a rectangle." if model.along_the_yarns else ""
    default = " The default kind." if name == DEFAULT else ""
    return f'### `kind = "{name}"`\n\n{doc}{more}{default}\n\n{_table(model, model.own_keys())}'


def _table(model: type[Table], keys: list[str]) -> str:
    rows = ["| key | what it is | default | what it does |", "|---|---|---|---|"]
    for key in keys:
        field = model.model_fields[key]
        what = " ".join((field.description or "").split())
        cells = [f"`{field.alias or key}`", kind_of(field), _default(field), what]
        rows.append(f"| {' | '.join(cells)} |")
    return "\n".join(rows) + "\n"


def _default(field: FieldInfo) -> str:
    if field.is_required():
        return "must be given"
    if field.default is None or isinstance(field.default, BaseModel):
        return "optional"
    return f"`{_toml(field.default)}`"


def _toml(value: Any) -> str:
    """Write a value as TOML."""
    return "{}" if isinstance(value, Mapping) else json.dumps(value, ensure_ascii=False)


def kind_of(field: FieldInfo) -> str:
    """Type of a key, its unit and an example in words."""
    annotation, metadata = field.annotation, list(field.metadata)
    if get_origin(annotation) is not Literal and type(None) in get_args(annotation):  # optional
        (annotation,) = (arg for arg in get_args(annotation) if arg is not type(None))
    if field in forming.StageTable.model_fields.values() and get_origin(annotation) is dict:
        return f"by tool, {_in_words(get_args(annotation)[1], [])}"
    return _in_words(annotation, metadata)


def _in_words(annotation: Any, metadata: list[Any]) -> str:
    """A type in words."""
    if annotation in _SHAPES:
        return _SHAPES[annotation]
    if get_origin(annotation) is Annotated:
        annotation, *metadata = get_args(annotation)
        if annotation in _SHAPES:
            return _SHAPES[annotation]
    for item in metadata:
        if isinstance(item, Of):
            what, example, unit = MEASURES[item.unit]
            if item.column:
                return f'the unit of {what}, `"{unit}"`'
            several = ", or a list of them" if item.many else ""
            if item.other:
                several = ', or {}, `"{}"`'.format(*MEASURES[item.other])
            return f'{what}, `"{item.example or example}"`{several}'
    if get_origin(annotation) is Literal:
        return " or ".join(f"`{_toml(choice)}`" for choice in get_args(annotation))
    limits = [limit for item in metadata for limit in getattr(item, "metadata", [item])]
    least = next((limit.ge for limit in limits if hasattr(limit, "ge")), None)
    names = {int: "whole number", str: "text", bool: "`true` or `false`", float: "number"}
    name = names.get(annotation, "table")
    return name if annotation is not int or least is None else f"{name} from {least} up"


def main() -> int:
    """Write the page, or compare it."""
    text = page()
    if "--check" in sys.argv[1:]:
        return int(PAGE.read_text(encoding="utf-8") != text)
    PAGE.write_text(text, encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main())
