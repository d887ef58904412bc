# SPDX-License-Identifier: MIT
"""Tables: what their keys may be, and what is said of mistakes, wherever the table stands."""

from typing import Annotated

import numpy as np
import pytest

from cruciform_petsc.errors import InputError
from cruciform_petsc.fields import (
    Count,
    Counts,
    Name,
    Number,
    Of,
    OneOf,
    Pairs,
    Point,
    Quantities,
    Ring,
    Rings,
    Size,
    Table,
    Title,
    si_values,
)
from cruciform_petsc.units import Quantity


class Inner(Table):
    """A table in a table."""

    size: Annotated[Quantities, Of("m", many=True, good=lambda x: x < 1.0, wanted="small")]
    """How large."""
    count: Count = 1
    """How many."""


class Outer(Table):
    """A table."""

    inner: Annotated[Table, OneOf(lambda data: Inner)]
    """Whichever it is."""
    ring: Ring | None = None
    """Corners."""
    place: Point | None = None
    """Where."""


GOOD = {"inner": {"size": "1 mm"}}


def test_texts_are_kept_and_have_values():
    table = Outer.from_data({"inner": {"size": ["1 mm", "2 cm"]}, "place": ["1 m", "0 mm"]})
    assert table.inner.size == ["1 mm", "2 cm"]
    assert si_values(table.inner.size) == pytest.approx([1e-3, 2e-2])
    assert si_values(table.place) == [1.0, 0.0]
    assert isinstance(table.place[0], Quantity)
    assert table.inner.count == 1
    assert Outer.from_data(table.model_dump()).model_dump(mode="json") == table.model_dump()


def test_scripts_may_give_numbers_arrays_and_tuples():
    """In SI; a case file may not."""
    ring = np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0]])
    data = {"inner": {"size": (0.1, "2 mm"), "count": np.int64(3)}, "ring": ring}
    table = Outer.from_data(data, bare=True)
    assert si_values(table.inner.size) == pytest.approx([0.1, 2e-3])
    assert [si_values(point) for point in table.ring] == ring.tolist()
    assert table.inner.count == 3
    with pytest.raises(InputError, match=r"^at\.inner\.size \(value 1\) is the bare number 0.1"):
        Outer.from_data(data, "at")


@pytest.mark.parametrize(
    ("data", "message"),
    [
        ({}, "at.inner is missing"),
        ({"inner": {"size": "1 m"}}, 'at.inner.size must be small, got "1 m"'),
        ({"inner": {"size": []}}, "at.inner.size is an empty list, give at least one value"),
        (
            {"inner": {"size": "1 mm", "cuont": 2}},
            '[at.inner] has the unknown key "cuont" (did you mean "count"?)',
        ),
        (GOOD | {"x": 1}, '[at] has the unknown key "x" (known: inner, ring, place)'),
        (GOOD | {"place": ["1 mm"]}, "at.place must be a list of 2, got 1"),
        (
            GOOD | {"ring": [["1 m", "2 m"], ["1 m", "2 m"], ["100 cm", "3 m"]]},
            "at.ring must have at least 3 different corners, got 2",
        ),
        (
            {"inner": {"size": 1, "count": 0}, "ring": 3, "place": 4},
            'at.inner.size is the bare number 1, give it a unit like "1 mm"\nat.inner.count must '
            "be a whole number from 1 up, got 0\nat.ring must be a list, got 3\n"
            "at.place must be a list, got 4",
        ),
        (
            {f"x{n:02d}": n for n in range(25)} | GOOD,
            "\n".join(
                f'[at] has the unknown key "x{n:02d}" (known: inner, ring, place)'
                for n in range(20)
            )
            + "\nand 5 more",
        ),
    ],
)
def test_mistakes(data, message):
    with pytest.raises(InputError) as caught:
        Outer.from_data(data, "at")
    assert str(caught.value) == message


# -- bounds ----------------------------------------------------------------------------------------


def nested(depth):
    """A list in a list ..."""
    value = 1
    for _ in range(depth):
        value = [value]
    return value


@pytest.mark.parametrize(
    ("good", "bad", "message"),
    [
        (nested(16), nested(17), "is nested more than 16 deep"),
        (2**63 - 1, 2**63, "at.x is a whole number of more than 64 bits"),
        (-(2**63), -(10**400), "at.x is a whole number of more than 64 bits"),
        ("a" * 4096, "a" * 4097, "at.x is a text of 4097 characters, at most 4096 are possible"),
        (dict.fromkeys(map(str, range(200)), 1), dict.fromkeys(map(str, range(201)), 1),
         "at.x has 201 keys, at most 200 are possible"),
        ([1] * 299_997, [1] * 299_998, "at.x is too long, a case has at most 300000 values"),
        ("\u00ff", "\udcff", r"at.x has characters that are not UTF-8, '\udcff'"),
    ],
    ids=["depth", "64 bits", "-64 bits", "text", "keys", "values", "surrogate"],
)  # fmt: skip
def test_bounds_of_all_values(good, bad, message):
    """At the bound the key is only unknown; one beyond, it is told which bound that is."""
    with pytest.raises(InputError, match="unknown key"):
        Outer.from_data(GOOD | {"x": good}, "at")
    with pytest.raises(InputError) as caught:
        Outer.from_data(GOOD | {"x": bad}, "at")
    assert message in str(caught.value)


def test_a_value_that_holds_itself_is_refused():
    value = []
    value.append(value)
    with pytest.raises(InputError, match="nested more than"):
        Outer.from_data(GOOD | {"ring": value}, "at")


class Bounded(Table):
    """One of each bounded type."""

    title: Title = ""
    """Title."""
    name: Name = "x"
    """Name."""
    number: Number = 0.0
    """Number."""
    count: Count = 1
    """Count."""
    counts: Counts | None = None
    """Counts."""
    pairs: Pairs | None = None
    """Pairs."""
    rings: Rings | None = None
    """Rings."""
    size: Size = Quantity.read("1 m", "m")
    """Size."""
    sizes: Annotated[Quantities, Of("m", many=True)] = Quantity.read("1 m", "m")
    """Sizes."""
    corner: Point = [Quantity.read("1 m", "m")] * 2
    """Corner."""


TRIANGLE = [["0 m", "0 m"], ["1 m", "0 m"], ["0 m", "1 m"]]


@pytest.mark.parametrize(
    ("key", "good", "bad", "message"),
    [
        ("title", "a" * 500, "a" * 501, "title must be a text of at most 500 characters"),
        ("title", "Grün 织物", "a\x1b[2J", "title must be one line without control characters"),
        ("title", "a b", "a\nb", "title must be one line without control characters"),
        ("title", "", "\u202egnp", "title must be one line without control characters"),
        ("name", "a" * 4096, "", "name must be a name that is not empty"),
        ("name", "a\tb", "a\0b", r"name must be a name without a zero character, got 'a\x00b'"),
        ("number", 1e12, 1.1e12, "number must be at most 1e+12, got 1100000000000.0"),
        ("number", -1e12, -1e308, "number must be at least -1e+12, got -1e+308"),
        ("count", 10**9, 10**9 + 1, "count must be at most 1000000000, got 1000000001"),
        ("counts", [1] * 100, [1] * 101, "counts must be a list of at most 100, got 101"),
        ("pairs", [[0.0, 0.0]] * 10_000, [[0.0, 0.0]] * 10_001, "list of at most 10000, got 10001"),
        (
            "rings",
            [TRIANGLE] * 10_000,
            [TRIANGLE] * 10_001,
            "rings must be a list of at most 10000",
        ),
        ("size", "1e-12 m", "1e-300 m", 'size = "1e-300 m" is too small, a length is 0 or at'),
        ("sizes", ["0 m"] * 10_000, ["0 m"] * 10_001, "has 10001 values, at most 10000 are"),
        ("sizes", ["1e9 m", "-1e9 m"], ["1 m", "-1e10 m"], "sizes (value 2) = "),
        ("corner", ["1e-17 m", "-1e-300 m"], ["1e10 m", "0 m"], "corner[0] = "),
    ],
)
def test_bounds_of_types(key, good, bad, message):
    """Each at its bound, and one beyond."""
    Bounded.from_data({key: good})
    with pytest.raises(InputError) as caught:
        Bounded.from_data({key: bad})
    assert message in str(caught.value)
