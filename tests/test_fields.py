# SPDX-License-Identifier: MIT
"""Tables: what their keys may be, and what is said of mistakes, wherever the table stands."""

from typing import Annotated

import numpy as np
import pytest

from cruciform_petsc.errors import InputError
from cruciform_petsc.fields import Count, Of, OneOf, Point, Quantities, Ring, Table, si_values
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
