# SPDX-License-Identifier: MIT
"""On which line of a case file a key stands: Python's reader of TOML does not tell."""

from __future__ import annotations

import re
import tomllib
from collections.abc import Iterator, Sequence
from typing import Any

# What may begin a statement: a key before "=", or a table's name in brackets. Within a list or a
# text of several lines it may also be part of a value, and the statement is read on then.
_BEGIN = re.compile(r"""\s*(?:[\w"'][^=\[{]*=|\[\[?\s*[A-Za-z_"'][^,=]*\]\s*(?:#.*)?$)""")
# A key in a sentence about a case: tables' names, in the order of the sentence.
_KEY = re.compile(
    r"\b(?:title|fabric|preform|test|tool|ply|clamp|stage|continuum|solver|output)\b"
    r"(?:\[\d+\]|\.\w+)*"
)
_UNKNOWN = re.compile(r'(?:\[([\w.[\]]+)\]|the case file) has the unknown key "(.*?)" \(')

# Letters that are read to find lines, with what is read again: keys farther on get none.
_MOST_READ = 2_000_000

Path = tuple[str, ...]


def key_lines(text: str) -> dict[Path, int]:
    """Number of the line, from 1, on which each key of a TOML text is first named.

    >>> key_lines(chr(10).join(["[a]", "b = { c = 1, d = [", "  2] }", "e = 3"]))
    {('a',): 1, ('a', 'b'): 2, ('a', 'b', 'c'): 2, ('a', 'b', 'd'): 2, ('a', 'e'): 4}
    """
    lines = text.splitlines()
    begins = [n for n, line in enumerate(lines) if _BEGIN.match(line)]
    found: dict[Path, int] = {}
    table: Path = ()
    count: dict[str, int] = {}  # of arrays of tables, [[tool]]
    left, at = _MOST_READ, 0
    while at < len(begins):
        begin = begins[at]
        while at < len(begins):
            at += 1
            end = begins[at] if at < len(begins) else len(lines)
            left -= sum(map(len, lines[begin:end])) + end - begin
            if left < 0:
                return found
            try:
                data = tomllib.loads("\n".join(lines[begin:end]))
            except tomllib.TOMLDecodeError:
                continue
            header = lines[begin].lstrip().startswith("[")
            paths = list(_paths(data))
            if header and lines[begin].lstrip().startswith("[["):
                name = paths[-1][0]
                count[name] = count.get(name, -1) + 1
            if header and paths[-1][0] in count:  # [[tool]], or [tool.shape] below one
                name = paths[-1][0]
                paths = [(name,), *((name, str(count[name]), *p[1:]) for p in paths)]
            for path in paths:
                found.setdefault(path if header else table + path, begin + 1)
            table = max(paths, key=len, default=()) if header else table
            break
    return found


def _paths(data: Any, above: Path = ()) -> Iterator[Path]:
    """Paths of all keys in nested tables, those in a list as if they stood in its place."""
    for item in data if isinstance(data, list) else [data]:
        for key, value in item.items() if isinstance(item, dict) else ():
            yield (*above, key)
            yield from _paths(value, (*above, key))


def with_lines(name: str, text: str, problems: Sequence[str], others: Sequence[Path]) -> list[str]:
    """Sentences about a case file, with the lines of their keys, in order of these.

    ``name`` is the file's, ``text`` what stands in it, but for keys that come from ``others``.
    """
    lines = key_lines(text)
    told = []
    for problem in problems:
        number = _line(problem, lines, others)
        told.append((number or 0, f"line {number}: {problem}" if number else problem))
    told.sort(key=lambda pair: pair[0])
    if len(told) > 1:
        return [f'case file "{name}" has {len(told)} problems:', *(text for _, text in told)]
    return [f'"{name}", {text}' if number else text for number, text in told]


def _line(problem: str, lines: dict[Path, int], others: Sequence[Path]) -> int | None:
    """The line of the first key that a sentence names, or of the table it should stand in."""
    unknown, key = _UNKNOWN.match(problem), _KEY.search(problem)
    if unknown is not None:
        path: Path = (*(_path(unknown[1]) if unknown[1] else ()), unknown[2])
    elif key is not None:
        path = _path(key[0])
    else:
        return None
    if any(path[: len(other)] == other for other in others):
        return None
    return next((lines[path[:n]] for n in range(len(path), 0, -1) if path[:n] in lines), None)


def _path(key: str) -> Path:
    """The parts of a key as sentences have it: of "tool[1].friction" they are three."""
    return tuple(re.findall(r"\w+", key))
