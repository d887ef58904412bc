# SPDX-License-Identifier: MIT
"""Case files to begin with: template.toml, and in it what each kind of test has of its own."""

from __future__ import annotations

import re
from importlib.resources import files
from inspect import cleandoc
from pathlib import Path

from ..errors import InputError
from ..experiments.registry import forms, kind_class

_COMMENT_AT = 36  # column of comments behind short values


def new_case(kind: str, name: str = "") -> str:
    """A commented case file of a kind of test, in TOML; an unknown kind is an InputError.

    Keys that may be left out and have no default stand in comments. ``name`` is that of the folder
    of its results in ``results/``, by default one that no demo has.
    """
    table, folder = kind_class(kind).table, files("cruciform_petsc.case")
    values = table.template | {
        "directory": f'"results/{name or "new_" + kind.replace("-", "_")}"',
    }
    own = folder / f"{kind}.toml"
    if own.is_file():  # a kind with tables of its own
        text = own.read_text(encoding="utf-8")
    elif forms(kind):  # one whose tools and stages follow from its keys
        text = (folder / "forming.toml").read_text(encoding="utf-8")
        text = text[: text.index("\n# Tools")] + text[text.index("\n[solver]") :]
        text = text[: text.index("# Plies")] + text[text.index("\n[fabric]") :]
        text = f"# {(table.__doc__ or '').splitlines()[0]}\n" + text.partition("\n")[2]
        text = text.replace('kind = "forming"', f'kind = "{kind}"\n{cleandoc(values["test"])}', 1)
    else:
        values["kind"] = f'"{kind}"'
        text = (folder / "template.toml").read_text(encoding="utf-8")
        text = text.replace("# WHAT", f"# {(table.__doc__ or '').splitlines()[0]}", 1)
        text = text.replace("# TEST", cleandoc(values["test"]), 1)
    lines = []
    for line in text.splitlines():
        match = re.fullmatch(r"((?:# )?(\w+) = )(.+?)(?:  +(#.*))?", line)
        if match is not None:
            start, key, value, comment = match.groups("")
            if key in values:
                start, value = f"{key} = ", values[key]
            line = start + value
            if comment:
                line = f"{line:<{_COMMENT_AT - 2}}  {comment}"
        lines.append(line)
    return "\n".join(lines) + "\n"


def write_new_case(kind: str, path: str | Path) -> None:
    """Write `new_case` into a file that must not be there yet; results go by the file's name.

    Raises InputError if there is no such kind, or the file is there or cannot be written.
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
