# SPDX-License-Identifier: MIT
"""What the keys of a case file may be, and one sentence about each mistake in a table of them."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from difflib import get_close_matches
from typing import Annotated, Any, Self, get_args

import numpy as np
from pydantic import AfterValidator, BaseModel, ConfigDict, Field, ValidationError
from pydantic_core import core_schema

from .errors import InputError, cut, harmless, shown
from .units import LIMITS, MEASURES, Quantity, format_si

_DEEPEST, _MOST_KEYS, _MOST_VALUES = 16, 200, 300_000  # of a case: nesting, of a table, of all
_MOST_ROWS = 10_000  # of a list
_LONGEST = 4096  # of a text: the longest path that Linux takes
_MOST_PROBLEMS = 20  # of one table; a further one is better told after these are mended


class Read:
    """Annotates a field that a function of ours reads; what is wrong is a ValueError in words."""

    def __get_pydantic_core_schema__(self, source: Any, handler: Any) -> core_schema.CoreSchema:
        return core_schema.with_info_plain_validator_function(self.read)

    def __get_pydantic_json_schema__(self, schema: Any, handler: Any) -> dict[str, Any]:
        return self.json_schema(handler)

    def read(self, value: Any, info: Any) -> Any:
        """Check a value and return what is kept of it; `info` is pydantic's."""
        raise NotImplementedError

    def json_schema(self, handler: Any) -> dict[str, Any]:
        """What an editor may know of it, by default nothing; `handler` is pydantic's."""
        return {}


@dataclass(frozen=True)
class Of(Read):
    """Annotates quantities: kept as they are written, with their value beside it."""

    unit: str
    """SI, as for `units.parse`."""
    least: bool = True
    """Whether what is not zero may not be smaller than anything of its kind is."""
    column: bool = False
    """The unit by itself, as it stands over a column of numbers."""
    many: bool = False
    """One quantity or a list of them."""
    other: str = ""
    """SI unit of another dimension that may stand as well; the quantity's `unit` tells which."""
    good: Callable[[float], bool] | None = None
    """Whether a value may be; ``wanted`` tells which may."""
    wanted: str = ""
    example: str = ""
    """For the page of keys; by default the usual one of the unit."""

    def read(self, value: Any, info: Any) -> Any:
        """Check one quantity, or a list of them if there may be `many`."""
        if not (self.many and isinstance(value, list)):
            return self._one(value, info)
        if not value:
            raise ValueError("is an empty list, give at least one value")
        if len(value) > _MOST_ROWS:
            raise ValueError(f"has {len(value)} values, at most {_MOST_ROWS} are possible")
        return [self._one(item, info, f"(value {i + 1}) ") for i, item in enumerate(value)]

    def json_schema(self, handler: Any) -> dict[str, Any]:
        """See _Read: a text, with an example."""
        example = self.example or MEASURES[self.unit][2 if self.column else 1]
        one = {"type": "string", "examples": [example]}
        several = {"type": "array", "items": one, "minItems": 1}
        return {"anyOf": [one, several]} if self.many else one

    def _one(self, value: Any, info: Any, which: str = "") -> Quantity:
        bare = bool(info.context)
        try:
            quantity = Quantity.read(value, self.unit, column=self.column, bare=bare)
        except ValueError as error:
            try:
                quantity = Quantity.read(value, self.other or self.unit, column=self.column)
            except ValueError:
                also = ""
                if self.other:
                    kind, example, _ = MEASURES[self.other]
                    also = f', nor {kind} like "{example}"'
                raise ValueError(f"{which}{error}{also}") from None
        if self.good is not None and not self.good(quantity.si):
            raise ValueError(f'{which}must be {self.wanted}, got "{cut(quantity)}"')
        unit = quantity.unit
        least = LIMITS[unit][0]
        if self.least and 0.0 < abs(quantity.si) < least:
            what = f"{MEASURES[unit][0]} is 0 or at least {format_si(least, unit)}"
            raise ValueError(f'{which}= "{cut(quantity)}" is too small, {what}')
        return quantity


@dataclass(frozen=True)
class OneOf(Read):
    """Annotates a table that is one of several: `pick` tells the type, or raises a ValueError."""

    pick: Callable[[Any], type[Table]]
    every: Callable[[], Iterable[type[Table]]] = tuple
    """All types that there are, for editors."""

    def read(self, value: Any, info: Any) -> Table:
        """Read it as what it is."""
        if isinstance(value, Table):
            return value
        return self.pick(value).model_validate(value, context=info.context)

    def json_schema(self, handler: Any) -> dict[str, Any]:
        """See _Read."""
        tables = [handler(table.__pydantic_core_schema__) for table in self.every()]
        return {"anyOf": tables or [{"type": "object"}]}


def _three_corners(ring: list[list[Quantity]]) -> list[list[Quantity]]:
    different = len({(x.si, y.si) for x, y in ring})
    if different < 3:
        raise ValueError(f"must have at least 3 different corners, got {different}")
    return ring


def _one_line(title: str) -> str:
    if harmless(title) != title or "\n" in title:
        raise ValueError(f"must be one line without control characters, got {shown(title)}")
    return title


def _name(name: str) -> str:
    if name and not name.strip():
        raise ValueError(f"must be a name that is not empty, got {shown(name)}")
    if "\0" in name:
        raise ValueError(f"must be a name without a zero character, got {shown(name)}")
    return name


Quantities = Quantity | list[Quantity]
Length = Annotated[Quantity, Of("m", least=False)]
Size = Annotated[Quantity, Of("m", good=lambda size: size > 0.0, wanted="positive")]
Sides = Annotated[list[Size], Field(min_length=2, max_length=2)]
Point = Annotated[list[Length], Field(min_length=2, max_length=2)]
Ring = Annotated[
    list[Point], Field(min_length=3, max_length=_MOST_ROWS), AfterValidator(_three_corners)
]
Rings = Annotated[list[Ring], Field(max_length=_MOST_ROWS)]
Line = Annotated[list[Point], Field(min_length=2, max_length=_MOST_ROWS)]
Lines = Annotated[list[Line], Field(max_length=_MOST_ROWS)]
Count = Annotated[int, Field(ge=1, le=10**9)]
Counts = Annotated[list[Count], Field(min_length=1, max_length=100)]
Number = Annotated[float, Field(allow_inf_nan=False, ge=-1e12, le=1e12)]
Pair = Annotated[list[Number], Field(min_length=2, max_length=2)]
Pairs = Annotated[list[Pair], Field(min_length=1, max_length=_MOST_ROWS)]
Title = Annotated[str, Field(max_length=500), AfterValidator(_one_line)]
Name = Annotated[str, Field(min_length=1, max_length=_LONGEST), AfterValidator(_name)]


def _plain(value: Any, above: str, loc: tuple = (), count: list[int] | None = None) -> Any:
    """What a case file could hold of a script's arrays, tuples and NumPy's numbers.

    Raises InputError for what is nested deeper, longer or larger than any case needs.
    """
    count = count or [0]
    if isinstance(value, np.ndarray | np.generic):
        value = value.tolist()
    is_table, problem = isinstance(value, dict), ""
    if is_table or isinstance(value, list | tuple):
        count[0] += len(value)
        if len(loc) > _DEEPEST:
            problem = f"is nested more than {_DEEPEST} deep"
        elif is_table and len(value) > _MOST_KEYS:
            problem = f"has {len(value)} keys, at most {_MOST_KEYS} are possible"
        elif count[0] > _MOST_VALUES:
            problem = f"is too long, a case has at most {_MOST_VALUES} values"
    elif isinstance(value, int) and not -(2**63) <= value < 2**63:
        problem = "is a whole number of more than 64 bits"
    elif isinstance(value, str) and len(value) > _LONGEST:
        problem = f"is a text of {len(value)} characters, at most {_LONGEST} are possible"
    elif isinstance(value, str) and re.search("[\ud800-\udfff]", value):
        problem = f"has characters that are not UTF-8, {shown(value)}"
    if problem:
        raise InputError(f"{cut(_joined(above, loc)) or 'the case'} {problem}")
    if is_table:
        return {key: _plain(entry, above, (*loc, key), count) for key, entry in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(entry, above, (*loc, i), count) for i, entry in enumerate(value)]
    return value


def _joined(above: str, loc: Sequence[Any]) -> str:
    """A place in a case as it is written: "test.extension[0]"."""
    key = above + "".join(f"[{part}]" if isinstance(part, int) else f".{part}" for part in loc)
    return key.removeprefix(".")


def si_values(quantities: Quantities) -> list[float]:
    """Values of one quantity or several."""
    return [q.si for q in (quantities if isinstance(quantities, list) else [quantities])]


class Table(BaseModel):
    """A table of a case file: known keys only, each of its very type."""

    model_config = ConfigDict(
        extra="forbid",
        frozen=True,
        strict=True,
        validate_default=True,
        use_attribute_docstrings=True,
    )

    @classmethod
    def from_data(cls, data: Any, key: str = "", *, bare: bool = False) -> Self:
        """Check plain data as they stand in a case file, at `key` of it.

        ``bare``: numbers without unit are in SI already (scripts may give them, case files not).
        Raises InputError with all problems, a sentence each.
        """
        data = _plain(data, key)
        try:
            return cls.model_validate(data, context=bare)
        except ValidationError as error:
            sentences = (_sentence(cls, data, key, dict(e)) for e in error.errors())
            problems = list(dict.fromkeys(sentences))
        more = len(problems) - _MOST_PROBLEMS
        raise InputError(*problems[:_MOST_PROBLEMS], *([f"and {more} more"] if more > 0 else []))

    def model_dump(self, **options: Any) -> dict[str, Any]:
        """Return plain data, with the keys of a case file."""
        return super().model_dump(**{"by_alias": True} | options)

    @classmethod
    def keys(cls) -> list[str]:
        """Keys as they stand in a case file."""
        return [field.alias or name for name, field in cls.model_fields.items()]


def tables_in(annotation: Any) -> Iterator[type[Table]]:
    """The types of table in a field's type, through Optional and Annotated."""
    if isinstance(annotation, type) and issubclass(annotation, Table):
        yield annotation
    for part in get_args(annotation):
        yield from tables_in(part)


def _known_keys(model: type[Table], data: Any, path: Sequence[Any]) -> list[str]:
    """Keys of the table at a place in some data."""
    for part in path:
        fields = {field.alias or name: field for name, field in model.model_fields.items()}
        data = data[part]
        if part in fields:  # else a place in a list, or a name in a table of tables
            several = [item for item in fields[part].metadata if isinstance(item, OneOf)]
            found = next(tables_in(fields[part].annotation), model)
            model = several[0].pick(data) if several else found
    return model.keys()


# What pydantic's types of error mean, in plain words.
_WORDS = {
    "string_type": "must be a text in quotes, got {got}",
    "string_too_short": "must be a name that is not empty, got {got}",
    "bool_type": "must be true or false, got {got}",
    "int_type": "must be a whole number, got {got}",
    "string_too_long": "must be a text of at most {max_length} characters",
    "greater_than_equal": "must be at least {ge:.12g}, got {got}",
    "less_than_equal": "must be at most {le:.12g}, got {got}",
    "float_type": "must be a number, got {got}",
    "finite_number": "must be a finite number, got {got}",
    "list_type": "must be a list, got {got}",
    "model_type": "must be a table, got {got}",
    "missing": "is missing",
}


def _sentence(model: type[Table], data: Any, above: str, error: dict[str, Any]) -> str:
    """Turn one of pydantic's errors into plain words that name the key."""
    loc, kind, got = error["loc"], error["type"], shown(error["input"], 60)
    context = error.get("ctx", {})
    key = _joined(above, loc)
    if kind == "greater_than_equal" and context["ge"] == 1:
        return f"{key} must be a whole number from 1 up, got {got}"
    if kind in _WORDS:
        return f"{key} {_WORDS[kind].format(got=got, **context)}"
    if kind == "value_error":  # one of ours, which may go on with the key
        words = str(context["error"])
        return f"{key}{words}" if words[0] in ".:" else f"{key} {words}"
    if kind == "literal_error":
        expected = {"True": "true", "False": "false"}.get(context["expected"], context["expected"])
        return f"{key} must be {expected.replace(chr(39), chr(34))}, got {got}"
    if kind in ("too_short", "too_long"):
        limit = context.get("min_length", context.get("max_length"))
        which = "at least" if kind == "too_short" else "at most"
        length = f"{limit}" if limit == 2 else f"{which} {limit}"  # pairs are exact
        return f"{key} must be a list of {length}, got {context['actual_length']}"
    if kind == "extra_forbidden":
        table = key.rpartition(".")[0]
        known = _known_keys(model, data, loc[:-1])
        close = get_close_matches(str(loc[-1]), known, 1)
        hint = f'did you mean "{close[0]}"?' if close else f"known: {', '.join(known)}"
        where = f"[{table}] has" if table else "the case file has"
        return f'{where} the unknown key "{loc[-1]}" ({hint})'
    return f"{key}: {error['msg']}"
