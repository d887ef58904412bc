# SPDX-License-Identifier: MIT
"""What is wrong with a number of a fabric that is built in Python, in words."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from typing import Any

from ..units import LIMITS, format_si

# What a number must be, beside finite.
_WANTED: dict[str, Callable[[float], bool]] = {
    "positive and finite": lambda number: number > 0.0,
    "zero or positive and finite": lambda number: number >= 0.0,
    "above 0 and at most 1": lambda number: 0.0 < number <= 1.0,
    "finite": lambda number: True,
}


def number_problems(
    key: str, value: Any, unit: str = "", wanted: str = "positive and finite"
) -> Iterator[str]:
    """Problems of what is not as `wanted`, one of _WANTED; of a key below [fabric]."""
    try:
        number = float(value)  # a whole number of hundreds of digits is none
    except (TypeError, ValueError, OverflowError):
        yield f"fabric.{key} must be a finite number"
        return
    if not (math.isfinite(number) and _WANTED[wanted](number)):
        got = format_si(number, unit) if unit else f"{number:g}"
        yield f"fabric.{key} must be {wanted}, got {got}"
    else:
        yield from size_problems(key, number, unit)


def size_problems(key: str, number: float, unit: str) -> Iterator[str]:
    """What is smaller, but for zero, or larger than anything of its kind is."""
    least, most = LIMITS.get(unit, (0.0, math.inf))
    if 0.0 < abs(number) < math.inf and not least <= abs(number) <= (1.0 + 1e-5) * most:
        ends = f"from {format_si(least, unit)} to {format_si(most, unit)}"
        yield f"fabric.{key} must be {ends}, got {format_si(number, unit)}"
