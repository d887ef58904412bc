# SPDX-License-Identifier: MIT
"""Two columns of a text file, as test machines and spreadsheets write it, to SI numbers."""

from __future__ import annotations

import csv
import re
from collections.abc import Iterator, Sequence
from itertools import islice
from typing import NamedTuple

import numpy as np

from ..errors import InputError, cut
from ..units import parse_unit

WANTED = (("displacement", "m"), ("force", "N"))
EXAMPLE = 'write for example "displacement [mm], force [N]"'
DELIMITERS = ("\t", ";", "|", ",", " ")  # the last one is any blanks
MOST_LINES_BEFORE = 500  # the titles
MOST_LINES, LONGEST_LINE = 300_000, 10_000
_COMMENT = re.compile(r"\s*(?:#|%|//|!)+\s*")
_PAIRS = (("[", "]"), ("(", ")"), ("{", "}"))
_BRACKETS = "[](){}<>"
_LAST_BRACKET = r"[\[({<][^\[\](){}<>]*[\])}>]\s*$"
# What may stand in a unit beside lengths and forces; "N s" is no force, "J/mm" no length.
_OTHER_UNITS = frozenset(re.findall(r"\S+", "s sec min g kg J kJ Pa kPa MPa GPa V mV rad deg %"))
_OPERATORS = frozenset(["/", "*", "·", "1/", "per", "pro"])
_SPREADSHEETS = (b"PK\x03\x04", b"\xd0\xcf\x11\xe0")


class _Line(NamedTuple):
    number: int
    text: str
    comment: bool


class _Header(NamedTuple):
    """Titles of the columns, how many m or N one of each is (0: no such unit), the rows' lines."""

    number: int  # of the line
    titles: list[str]
    factors: list[tuple[float, float]]
    delimiter: str
    lines: list[_Line]  # of the whole file
    start: int  # of the rows

    @property
    def rows(self) -> Iterator[_Line]:
        """Lines below the titles that are no comments."""
        return (line for line in islice(self.lines, self.start, None) if not line.comment)

    def of(self, which: int) -> list[int]:
        """Columns with a unit of WANTED[which]."""
        return [i for i, pair in enumerate(self.factors) if pair[which]]


def read_columns(data: bytes, columns: str | None = None) -> np.ndarray:
    """Displacement [m] and force [N] of each row; float (2, rows).

    The titles are in the first line that, with units of its own or of the line below, gives one
    length and one force, and has numbers behind. ``columns`` are the titles of the two, or their
    numbers from 1, with a comma between. An InputError, mostly with the line, is the end of a
    sentence that begins with the file.
    """
    lines = _lines(_decoded(data))
    if not lines:
        raise InputError("is empty")
    delimiters: Sequence[str] = DELIMITERS
    if told := re.fullmatch(r'"?sep=([;,|:\t ])"?', lines[0].text, re.IGNORECASE):
        delimiters, lines = [told[1]], lines[1:]
    headers = [header for mark in delimiters for header in _headers(lines, mark)]
    header, pair = _pick(headers, columns)
    return _numbers(header, pair)


# -- text ------------------------------------------------------------------------------------------


def _decoded(data: bytes) -> str:
    """Text in UTF-8, UTF-16 or -32, else in what Windows writes in western Europe."""
    if data.startswith(_SPREADSHEETS):
        raise InputError("is a spreadsheet's own file, save the sheet as CSV")
    encodings = ["utf-8-sig", "cp1252", "latin-1"]
    if data.startswith((b"\xff\xfe\0\0", b"\0\0\xfe\xff")):
        encodings = ["utf-32"]
    elif data.startswith((b"\xff\xfe", b"\xfe\xff")):
        encodings = ["utf-16"]
    else:  # without a mark, from the zeros of every other byte
        halves = data[1:200:2], data[:200:2]
        for half, encoding in zip(halves, ("utf-16-le", "utf-16-be"), strict=True):
            if 2 * half.count(0) > len(half):
                encodings = [encoding]
    for encoding in encodings:
        try:
            text = data.decode(encoding)
        except UnicodeDecodeError:
            continue
        if "\0" not in text:
            return text
    zero = f" (byte {data.index(0) + 1} is zero)" if 0 in data else ""
    raise InputError(f"is not a text file{zero}")


def _lines(text: str) -> list[_Line]:
    """Lines that are not empty; one ends where its quotes are closed (cells of two lines)."""
    lines: list[_Line] = []
    if max(map(text.count, "\n\r")) > MOST_LINES:
        raise InputError(f"has more than {MOST_LINES} lines")
    parts = re.split(r"\r\n|\r|\n", text)
    at = 0
    while at < len(parts):
        number, line = at + 1, parts[at]
        if len(line) > LONGEST_LINE:
            raise InputError(
                f"line {number}, has {len(line)} characters, at most {LONGEST_LINE} are read"
            )
        at += 1
        for more in range(at, min(at + 5, len(parts))):
            if line.count('"') % 2 == 0:
                break
            if " ".join(parts[at : more + 1]).count('"') % 2:
                line, at = " ".join([line, *parts[at : more + 1]]), more + 1
        line = line.strip(" ")
        mark = _COMMENT.match(line)
        line = line[mark.end() :] if mark else line
        if line.strip(" \t,;|"):
            lines.append(_Line(number, line, mark is not None))
    return lines


def _cells(line: _Line, delimiter: str, title: bool = False) -> list[str]:
    """Cells without those that are empty at the end."""
    if delimiter == " ":
        # Two blanks part titles of several words, one does where there are none.
        wide = re.split(r"\s{2,}|\t", line.text)
        cells = wide if len(wide) > 1 else re.split(r"\s+(?![\[({<])", line.text)
        cells = cells if title else line.text.split()
    else:
        try:
            cells = next(csv.reader([line.text], delimiter=delimiter, skipinitialspace=True))
        except csv.Error as error:
            raise InputError(f"line {line.number}, cannot be read: {error}") from None
    cells = [cell.strip() for cell in cells]
    while cells and not cells[-1]:
        cells.pop()
    return cells


# -- titles and units ------------------------------------------------------------------------------


def _headers(lines: list[_Line], delimiter: str) -> Iterator[_Header]:
    """Lines that may hold the titles."""
    for i, line in enumerate(lines[:MOST_LINES_BEFORE]):
        titles = _cells(line, delimiter, title=True)
        if len(titles) < 2 or all(_looks_like_a_number(cell) for cell in titles):
            continue
        header = _Header(line.number, titles, _factors(titles), delimiter, lines, i + 1)
        below = _cells(lines[i + 1], delimiter, title=True) if i + 1 < len(lines) else []
        if not any(_looks_like_a_number(cell) for cell in below):
            # A line of units. Where the titles have theirs, too, it only says so again.
            units = [(_is("m", cell), _is("N", cell)) for cell in below[: len(titles)]]
            units += [(0.0, 0.0)] * (len(titles) - len(units))
            second = header._replace(factors=units, start=i + 2)
            if header.of(0) and header.of(1):
                header = header._replace(start=i + 2) if any(map(any, units)) else header
            elif any(map(any, units)):
                below += [""] * (len(titles) - len(below))
                titles = [
                    f"{title} [{unit.strip(_BRACKETS)}]" if unit else title
                    for title, unit in zip(titles, below, strict=False)
                ]
                header = second._replace(titles=titles)
        yield header


def _factors(titles: list[str]) -> list[tuple[float, float]]:
    return [(_is("m", unit), _is("N", unit)) for unit in map(_unit_of, titles)]


def _unit_of(title: str) -> str:
    """The unit in a title: in brackets at its end, or else all that stands behind the name.

    >>> [_unit_of(title) for title in ("Weg in mm", "Force (N) [ch 2]", "F/N", "load_kN", "s / mm")]
    ['mm', 'N', 'N', 'kN', 'mm']
    >>> [_unit_of(title) for title in ("Stiffness N/mm", "Work N mm", "shear_force_N_per_mm")]
    ['N/mm', 'Nmm', 'Npermm']
    """
    if re.search(r"[\s_]per[\s_].*[\[({<]", title):
        return ""  # a force per length is none, whatever stands in brackets
    if any(title.count(first) != title.count(last) for first, last in _PAIRS):
        return ""
    while bracket := re.fullmatch(r"(.*)[\[({<]([^\[\](){}<>]*)[\])}>]", title.strip()):
        if _is_unit(bracket[2].strip()) or "/" in bracket[2]:
            return bracket[2].strip()
        title = bracket[1]
    pieces = re.findall(r"1/|[^\s_,;:=/*·]+|[/*·]", title)
    first = len(pieces)
    while first and (pieces[first - 1] in _OPERATORS or _is_unit(pieces[first - 1])):
        first -= 1
    unit = pieces[first:]
    if unit[:2] in (["s", "/"], ["S", "/"]):  # a way, s, in mm
        unit = unit[2:]
    if len(unit) > 1 and unit[0] in ("in", "/"):  # "Kraft in N", "force / N"
        unit = unit[1:]
    return "".join(unit)


def _is(unit: str, text: str) -> float:
    """How many ``unit`` one of the unit in a text is, or 0: lengths and forces are one word."""
    word = text.strip().strip(_BRACKETS).removesuffix(".").strip()
    if not re.fullmatch(r"[^\W\d_]{1,20}", word):
        return 0.0
    try:
        return parse_unit(word, unit)
    except ValueError:
        return 0.0


def _is_unit(text: str) -> bool:
    word = text.strip(_BRACKETS)
    return (
        word.lower() in _OTHER_UNITS
        or word in _OTHER_UNITS
        or any(_is(unit, word) for unit in ("m", "N"))
    )


def _pick(headers: list[_Header], columns: str | None) -> tuple[_Header, tuple[int, int]]:
    """The header, and which of its columns count; what is wrong is an InputError."""
    if columns is not None:
        named = [(header, both) for header in headers if (both := _named(header, columns))]
        good = [(header, both) for header, both in named if _has_numbers(header, both)] or named
        if good:
            return good[0]
    # Mostly it is the line before the numbers that was meant.
    found = [header for header in headers if header.of(0) and header.of(1)]
    whole = [header for header in found if _has_numbers(header, header.of(0) + header.of(1))]
    part = [header for header in headers if _has_numbers(header, range(len(header.titles)))]
    part.sort(key=lambda header: -bool(header.of(0)) - bool(header.of(1)))
    header = next(iter(whole or found or part or headers), None)
    if header is None:
        raise InputError(f"has no header with units, {EXAMPLE}")
    titles = cut(", ".join(f'"{title}"' for title in header.titles), 200)
    if columns is not None:
        raise InputError(
            f'has no two columns "{cut(columns)}", one with a unit of length and one of force; '
            f"line {header.number} has {titles}"
        )
    pair = []
    for which, (what, _) in enumerate(WANTED):
        found_here = header.of(which)
        if not found_here:
            raise InputError(
                f'has no column with a unit of {what} in its header "'
                f'{cut(", ".join(header.titles), 200)}" (line {header.number}), {EXAMPLE}'
            )
        pair.append(found_here[0])
    if len(header.of(0)) + len(header.of(1)) > 2:
        many = [f"{len(header.of(k))} columns with a unit of {WANTED[k][0]}" for k in (0, 1)]
        of_many = [
            f"{many[k]}, {' and '.join(_quoted(header, k))}"
            for k in (0, 1)
            if len(header.of(k)) > 1
        ]
        example = ",".join(header.titles[i] for i in pair)
        raise InputError(
            f"has {' and '.join(of_many)} (line {header.number}): say which counts, --columns "
            f'"{example}" (in a case file output.measured_columns = "{example}")'
        )
    return header, (pair[0], pair[1])


def _quoted(header: _Header, which: int) -> list[str]:
    return [f'"{header.titles[i]}"' for i in header.of(which)]


def _plain(text: str) -> str:
    """A title as it is compared: "Extension (mm)" is that of "Extension" over "mm"."""
    words = " ".join(re.sub(r"[\[\](){}<>\"]", " ", text).casefold().split())
    return re.sub(r"\s*,\s*", ",", words)


def _named(header: _Header, columns: str) -> tuple[int, int] | None:
    """Columns of displacement and force that were named, by titles or numbers, in any order."""
    if numbers := re.fullmatch(r"\s*(\d{1,4})\s*,\s*(\d{1,4})\s*", columns):
        i, j = int(numbers[1]) - 1, int(numbers[2]) - 1
        found = [(i, j)] if i in header.of(0) and j in header.of(1) else []
        found += [(j, i)] if j in header.of(0) and i in header.of(1) else []
    else:
        wanted, found = _plain(columns), []
        forces = [(name, j) for j in header.of(1) for name in _names(header.titles[j])]
        for i in header.of(0):
            for name in _names(header.titles[i]):
                if wanted.startswith(f"{name},"):
                    rest = wanted[len(name) + 1 :]
                    found += [(i, j) for other, j in forces if other == rest]
                elif wanted.endswith(f",{name}"):
                    rest = wanted[: -len(name) - 1]
                    found += [(i, j) for other, j in forces if other == rest]
    if len(found) > 1:
        two = " and ".join(f"{i + 1},{j + 1}" for i, j in found[:2])
        raise InputError(
            f'has several columns "{cut(columns)}" (line {header.number}): name them by their '
            f"numbers, {two}"
        )
    return found[0] if found else None


def _names(title: str) -> set[str]:
    """What a column may be called: its title, with and without the unit in brackets."""
    return {_plain(title), _plain(re.sub(_LAST_BRACKET, "", title))}


# -- numbers ---------------------------------------------------------------------------------------


def _looks_like_a_number(cell: str) -> bool:
    return re.fullmatch(r"[+-]?[\d., ]*\d[\d.,]*([eE][+-]?\d+)?", _ascii(cell)) is not None


def _ascii(cell: str) -> str:
    """A number with a plain minus, its thousands parted by blanks, marks or apostrophes alike."""
    return re.sub(r"[\s'\u2019]", " ", cell.replace("\N{MINUS SIGN}", "-"))


def _has_numbers(header: _Header, columns: Sequence[int]) -> bool:
    """Whether the line below the titles has a number in some column of ``columns``, at least."""
    row = next(header.rows, None)
    cells = [] if row is None else _cells(row, header.delimiter)
    return any(i < len(cells) and _looks_like_a_number(cells[i]) for i in columns)


def _numbers(header: _Header, pair: tuple[int, int]) -> np.ndarray:
    """The numbers in two columns, in SI; (2, rows)."""
    texts: list[str] = []
    lines: list[int] = []
    for line in header.rows:
        plain = line._replace(text=re.sub(r"\s#.*", "", line.text))
        cells = _cells(plain, header.delimiter)
        if len(cells) > len(header.titles):
            hint = ", decimal commas need semicolons" if header.delimiter == "," else ""
            raise InputError(
                f"line {line.number}, has {len(cells)} columns instead of "
                f"{len(header.titles)}{hint}"
            )
        both = [cells[i] if i < len(cells) else "" for i in pair]
        if any(both):  # another instrument's row, or a column that is longer
            texts += both
            lines += [line.number] * 2
    if not texts:
        raise InputError(f"has no numbers below its titles (line {header.number})")
    texts = [_ascii(text) for text in texts]
    point = _decimal_mark(texts, lines, header.delimiter)
    thousands = re.escape(",.".replace(point, ""))
    number = re.compile(
        rf"[+-]?(?:(?:\d+|\d{{1,3}}(?:[{thousands} ]\d{{3}})+)(?:{re.escape(point)}\d*)?"
        rf"|{re.escape(point)}\d+)(?:[eE][+-]?\d{{1,4}})?"
    )
    values = np.empty(len(texts))
    for k, text in enumerate(texts):
        value = np.nan
        if number.fullmatch(text):
            value = float(re.sub(rf"[{thousands} ]", "", text).replace(point, "."))
        if not np.isfinite(value):
            what = WANTED[k % 2][0]
            raise InputError(f'line {lines[k]}: {what} must be a finite number, got "{cut(text)}"')
        values[k] = value
    factors = [header.factors[i][which] for which, i in enumerate(pair)]
    with np.errstate(over="ignore"):  # what is not finite is refused where curves are checked
        return (values.reshape(-1, 2) * factors).T


def _decimal_mark(texts: list[str], lines: list[int], delimiter: str) -> str:
    """What parts decimals in all numbers: a comma or a point, from those that leave no doubt."""
    sure: dict[str, int] = {}
    doubtful: dict[str, int] = {}
    for text, line in zip(texts, lines, strict=True):
        marks = re.findall(r"[.,]", text)
        if not marks:
            continue
        last, other = marks[-1], "." if marks[-1] == "," else ","
        if other in marks:
            sure.setdefault(last, line)
        elif len(marks) > 1:  # 1.234.567
            sure.setdefault(other, line)
        elif re.fullmatch(r"[+-]?[1-9]\d{0,2}[.,]\d{3}", text):
            doubtful.setdefault(last, line)
        else:
            sure.setdefault(last, line)
    if len(sure) == 2:
        raise InputError(
            f"has a decimal comma (line {sure[',']}) and a decimal point (line {sure['.']})"
        )
    if sure:
        return next(iter(sure))
    if len(doubtful) == 2 or ("," in doubtful and delimiter == ","):
        raise InputError(
            f"line {doubtful[',']}: the comma may part thousands or decimals, leave out that of "
            "thousands or write more decimals"
        )
    return next(iter(doubtful), ".")
