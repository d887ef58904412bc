# SPDX-License-Identifier: MIT
"""Pantographic sheet: extension of a net of beams hinged at their crossovers."""

from __future__ import annotations

from typing import ClassVar, Literal

from .bias_extension import BiasExtension
from .table import Lengths, TestTable


class PantographTable(TestTable):
    """A sheet of beams and pivots, gripped at both ends and pulled."""

    controls: ClassVar = {"extension": "m"}
    template: ClassVar = {
        "title": '"Pantographic sheet, 67.88 mm x 203.65 mm"',
        "use": '"pantographic-sheet-2016"',
        "outline": '{ rectangle = ["67.88 mm", "203.65 mm"] }',
        "test": """
            extension = ["14 mm", "28 mm"]  # By which the upper edge is pulled, one value or a list
        """,
    }

    kind: Literal["pantograph"]
    extension: Lengths
    """By which the upper edge is pulled, one value or a list."""


class Pantograph(BiasExtension):
    """Extension of a pantographic sheet: a bias test of yarns that bend, between two clamps.

    The sheet is a Fabric whose yarns are its fibres (dell'Isola et al. 2016; in the library:
    "pantographic-sheet-2016"). Arguments as for BiasExtension.
    """

    table = PantographTable
    kind = "pantograph"
