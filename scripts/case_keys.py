# SPDX-License-Identifier: MIT
"""Write docs/case-file.md, the page of every key of the case file, from the schema.

    scripts/fenicsx python3 scripts/case_keys.py [--check]

With --check nothing is written; exit code 1 if the page is not what the schema says.
"""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Annotated, Any, get_args, get_origin

from pydantic import BaseModel, PlainValidator
from pydantic.fields import FieldInfo

from cruciform_petsc.case import schema as case
from cruciform_petsc.case.template import choices, own_keys_first, toml_value
from cruciform_petsc.units import describe

PAGE = Path(__file__).parents[1] / "docs" / "case-file.md"

_HEAD = """# Every key of a case file

Generated from the schema by `scripts/case_keys.py`; a test fails when this page is stale. A case
file to begin with, for each kind of test: `cruciform-petsc new KIND FILE`.

A case file is TOML. A quantity is a text of a number and a unit, `"2.4 cm"`; any unit of the right
dimension will do, the one given here is an example. Numbers without dimension stand bare. Unknown
keys are refused.
"""

# What is not one value, in words.
_SHAPES: dict[Any, str] = {
    case.Point: "a pair of lengths",
    case.Ring: "a list of 3 or more pairs of lengths",
    list[case.Ring]: "a list of lists of pairs of lengths",
    case.Pairs: "a list of pairs of numbers",
    case.Counts: "a list of whole numbers from 1 up",
}

# Tables by where they stand, in the order of the page.
_TABLES: tuple[tuple[str, type[BaseModel]], ...] = (
    ("Outside all tables", case.Case),
    ("`[fabric]`", case.FabricTable),
    ("`fabric.warp`, `fabric.weft`", case.YarnTable),
    ("`fabric.warp.tension`, `fabric.weft.tension`", case.TensionLawTable),
    ("`fabric.shear`", case.ShearTable),
    ("`fabric.tension`", case.TensionTable),
    ("`[preform]`", case.PreformTable),
    ("`preform.outline`", case.OutlineTable),
    ("`[test]`, every kind", case.TestTable),
    ("`[continuum]`", case.ContinuumTable),
    ("`[solver]`", case.SolverTable),
    ("`[output]`", case.OutputTable),
)


def page() -> str:
    """The whole page."""
    parts = [_HEAD]
    for title, model in _TABLES:
        parts.append(f"## {title}\n\n{_table(model, list(model.model_fields))}")
        if model is case.TestTable:
            parts += [_kind(kind) for kind in _kinds()]
    return "\n".join(parts)


def _kinds() -> list[type[case.TestTable]]:
    tagged = get_args(get_args(case.AnyTest)[0])
    return [get_args(kind)[0] for kind in tagged]


def _kind(model: type[case.TestTable]) -> str:
    name = choices(model.model_fields["kind"].annotation)[0]
    keys = [k for k in own_keys_first(model) if k not in case.TestTable.model_fields]
    doc = " ".join((model.__doc__ or "").split())
    more = " The yarns run along the edges of a rectangle." if model.along_the_yarns else ""
    default = " The default kind." if not model.model_fields["kind"].is_required() else ""
    return f'### `kind = "{name}"`\n\n{doc}{more}{default}\n\n{_table(model, keys)}'


def _table(model: type[BaseModel], keys: list[str]) -> str:
    rows = ["| key | what it is | default | what it does |", "|---|---|---|---|"]
    for key in keys:
        field = model.model_fields[key]
        what = field.description or ""
        if field.examples and not _is_quantity(field):
            what += f" Example: `{toml_value(field.examples[0])}`"
        cells = [f"`{field.alias or key}`", kind_of(field), _default(field), what]
        rows.append(f"| {' | '.join(cells)} |")
    return "\n".join(rows) + "\n"


def _default(field: FieldInfo) -> str:
    if field.is_required():
        return "must be given"
    if field.default is None or isinstance(field.default, BaseModel):
        return "optional"
    return f"`{toml_value(field.default)}`"


def _is_quantity(field: FieldInfo) -> bool:
    """Whether the first column of words shows the example already."""
    return _checked(_parts(field.annotation) + field.metadata) is not None


def _parts(annotation: Any) -> list[Any]:
    """What annotates an optional type."""
    inner = [arg for arg in get_args(annotation) if get_origin(arg) is Annotated]
    return list(get_args(inner[0])[1:]) if len(inner) == 1 else []


def _checked(metadata: list[Any]) -> case.Checked | None:
    for item in metadata:
        if isinstance(item, PlainValidator) and isinstance(item.func, case.Checked):
            return item.func
    return None


def kind_of(field: FieldInfo) -> str:
    """Type of a key, its unit and an example in words."""
    annotation, metadata = field.annotation, list(field.metadata)
    if type(None) in get_args(annotation):  # optional
        (annotation,) = (arg for arg in get_args(annotation) if arg is not type(None))
    if annotation in _SHAPES:
        return _SHAPES[annotation]
    if get_origin(annotation) is Annotated:
        annotation, *more = get_args(annotation)
        metadata += more
    checked = _checked(metadata)
    if checked is not None:
        what, example, unit = describe(checked.unit)
        if checked.bare:
            return f'the unit of {what}, `"{unit}"`'
        example = next((e for e in field.examples or () if isinstance(e, str)), example)
        return f'{what}, `"{example}"`' + (", or a list of them" * (annotation is not str))
    if choices(annotation):
        return " or ".join(f'`"{choice}"`' for choice in choices(annotation))
    limits = [m for item in metadata for m in getattr(item, "metadata", [item])]
    least = next((limit.ge for limit in limits if hasattr(limit, "ge")), None)
    names = {int: "whole number", str: "text", bool: "`true` or `false`", float: "number"}
    name = names.get(annotation, "table")
    return name if least is None else f"{name} from {least} up"


def main() -> int:
    """Write the page, or compare it."""
    text = page()
    if "--check" in sys.argv[1:]:
        return int(PAGE.read_text(encoding="utf-8") != text)
    PAGE.write_text(text, encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main())
