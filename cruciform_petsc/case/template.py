# SPDX-License-Identifier: MIT
"""Case files to begin with, one for each kind of test, written from the case file's own schema.

Keys, defaults, examples and comments are those of `case`; only what a kind needs to be otherwise
stands here.
"""

from __future__ import annotations

import json
import re
from collections.abc import Mapping
from difflib import get_close_matches
from pathlib import Path
from typing import Any, Literal, get_args, get_origin

from pydantic import BaseModel
from pydantic.fields import FieldInfo

from ..errors import InputError
from .schema import (
    BiasExtensionTest,
    BiaxialTest,
    CantileverTest,
    Case,
    ContinuumTable,
    FabricTable,
    OffAxisTensionTest,
    OutputTable,
    PantographTest,
    PictureFrameTest,
    PreformTable,
    SolverTable,
    TestTable,
)

_WIDTH = 100  # of a line with its comment
_COMMENT_AT = 36  # column of comments behind short values

_SQUARE = {"preform.outline": {"rectangle": ["100 mm", "100 mm"]}, "preform.bias_angle": "0 deg"}
_LIBRARY: dict[str, Any] = {"fabric.use": "glass-pp-plain-1.93", "test.finite": True}

# Each kind's table, a title, and the keys whose value is neither the default nor the example.
_KINDS: dict[str, tuple[type[TestTable], str, dict[str, Any]]] = {
    "bias-extension": (
        BiasExtensionTest,
        "Bias extension, 100 mm x 200 mm",
        {**_LIBRARY, "test.extension": ["10 mm", "20 mm"]},
    ),
    "biaxial": (
        BiaxialTest,
        "Biaxial tension, 2 : 1",
        {**_LIBRARY, **_SQUARE, "test.strain": ["0.25 %", "0.5 %"], "test.ratio": 0.5},
    ),
    "cantilever": (
        CantileverTest,
        "Cantilever, 25 mm x 100 mm",
        {
            **_LIBRARY,
            "fabric.use": "e-glass-plain-2.4",
            "fabric.shear": {"modulus": "0.001 N/cm"},
            "preform.outline": {"rectangle": ["25 mm", "100 mm"]},
            "preform.bias_angle": "0 deg",
            "test.load": ["0.2 mN", "0.5 mN"],
        },
    ),
    "off-axis-tension": (
        OffAxisTensionTest,
        "Off-axis tension at 30 degrees",
        {
            **_LIBRARY,
            "preform.bias_angle": "30 deg",
            "test.ends": "free",
            "test.extension": ["1 mm", "5 mm"],
        },
    ),
    "pantograph": (
        PantographTest,
        "Pantographic sheet, 67.88 mm x 203.65 mm",
        {
            **_LIBRARY,
            "fabric.use": "pantographic-sheet-2016",
            "preform.outline": {"rectangle": ["67.88 mm", "203.65 mm"]},
            "test.extension": ["14 mm", "28 mm"],
        },
    ),
    "picture-frame": (
        PictureFrameTest,
        "Picture frame, 100 mm",
        {**_LIBRARY, **_SQUARE, "test.angle": ["10 deg", "20 deg"]},
    ),
}
KINDS = tuple(_KINDS)


def new_case(kind: str, name: str = "") -> str:
    """Write a commented case file.

    Parameters
    ----------
    kind : str
        One of `KINDS`.
    name : str
        Of the folder of its results in ``results/``; by default one that no demo has.

    Returns
    -------
    str
        TOML. Keys that may be left out and have no default stand in comments.

    Raises
    ------
    InputError
        There is no such kind.
    """
    if kind not in _KINDS:
        close = get_close_matches(kind, KINDS, 1)
        hint = f'did you mean "{close[0]}"? ' if close else ""
        known = ", ".join(f'"{known}"' for known in KINDS)
        raise InputError(f'there is no kind of test "{kind}" ({hint}known: {known})')
    table, title, values = _KINDS[kind]
    values = values | {
        "title": title,
        "test.kind": kind,
        "output.directory": f"results/{name or 'new_' + kind.replace('-', '_')}",
    }
    what = (table.__doc__ or "").splitlines()[0]
    lines = [
        f"# {what}",
        "# Every quantity has its unit. Keys in comments are off. docs/case-file.md explains all.",
        *_line("title", Case.model_fields["title"], values, ""),
    ]
    sections: dict[str, type[BaseModel]] = {
        "fabric": FabricTable,
        "preform": PreformTable,
        "test": table,
        "continuum": ContinuumTable,
        "solver": SolverTable,
        "output": OutputTable,
    }
    for name, model in sections.items():
        lines += ["", f"[{name}]"]
        for key in own_keys_first(model):
            lines += _line(key, model.model_fields[key], values, f"{name}.")
    return "\n".join(lines) + "\n"


def write_new_case(kind: str, path: str | Path) -> None:
    """Write `new_case` into a file that must not be there yet; results go by the file's name.

    Raises
    ------
    InputError
        No such kind, or the file is there or cannot be written.
    """
    stem = re.sub(r"[^\w.+-]+", "_", Path(path).stem)
    text = new_case(kind, stem if stem.strip("._") else "")
    try:
        with open(path, "x", encoding="utf-8") as file:
            file.write(text)
    except FileExistsError:
        raise InputError(f'"{path}" is there already, name another file') from None
    except (OSError, ValueError) as error:  # ValueError: a null byte
        reason = getattr(error, "strerror", None) or error
        raise InputError(f'"{path}" cannot be written: {reason}') from None


def own_keys_first(model: type[BaseModel]) -> list[str]:
    """Keys of a table; of a test its kind, then what only its kind has, then what all have."""
    keys = list(model.model_fields)
    if not issubclass(model, TestTable):
        return keys
    shared = list(TestTable.model_fields)
    return ["kind", *(k for k in keys if k not in shared), *(k for k in shared if k != "kind")]


def _line(key: str, field: FieldInfo, values: Mapping[str, Any], prefix: str) -> list[str]:
    """One key with its value and what it does, in comments if it may be left out."""
    value = values.get(prefix + key)
    commented = False
    if value is None and not field.is_required() and field.default not in (None, {}):
        value = field.default
    if value is None:
        # Required: the example stands; optional: it is a suggestion.
        commented = not field.is_required()
        value = _example(field)
    text = f"{'# ' if commented else ''}{key} = {toml_value(value)}"
    what = (field.description or "").split(". ")[0].rstrip(".")
    others = [f'"{choice}"' for choice in choices(field.annotation) if choice != value]
    comment = f"# {'or ' if others else ''}{' or '.join(others)}{': ' if others else ''}{what}"
    if not what:
        return [text]
    beside = f"{text:<{_COMMENT_AT}}{comment}" if len(text) < _COMMENT_AT else f"{text}  {comment}"
    return [beside] if len(beside) <= _WIDTH else [comment, text]


def _example(field: FieldInfo) -> Any:
    if field.examples:
        return field.examples[0]
    return choices(field.annotation)[0]


def choices(annotation: Any) -> list[str]:
    """Texts that a key may have, if it is a choice between some; optional or not."""
    if get_origin(annotation) is Literal:
        return list(get_args(annotation))
    return [choice for part in get_args(annotation) for choice in choices(part)]


def toml_value(value: Any) -> str:
    """Write a value as TOML, on one line.

    >>> toml_value({"rectangle": ["1 mm", "2 mm"], "on": True})
    '{ rectangle = ["1 mm", "2 mm"], on = true }'
    """
    if isinstance(value, Mapping):
        entries = ", ".join(f"{key} = {toml_value(entry)}" for key, entry in value.items())
        return f"{{ {entries} }}" if entries else "{}"
    if isinstance(value, list | tuple):
        return f"[{', '.join(toml_value(entry) for entry in value)}]"
    return json.dumps(value, ensure_ascii=False)  # texts, numbers, true and false
