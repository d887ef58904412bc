# SPDX-License-Identifier: MIT
"""[[ply]] of a case file: plies of a forming's blank that lie upon each other."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Annotated, NamedTuple

import numpy as np
import shapely

from ..cloth.fabric import Fabric, FabricTable
from ..cloth.preform import OutlineTable, Preform
from ..errors import InputError, Problems
from ..fields import Name, Of, Point, Table, si_values
from ..tools.tool import Friction
from ..units import Quantity
from .table import FormingTable, StageTable, check_several

MOST = 8  # plies of a stack


class PlyTable(Table):
    """[[ply]]: one of the plies of a blank, in order from the lowest."""

    name: Name
    """What results call it."""
    fabric: FabricTable | None = None
    """Its cloth, as in [fabric], which is the default.
    Example: `{ use = "glass-pp-plain-1.93" }`"""
    bias_angle: Annotated[Quantity, Of("rad")] | None = None
    """From y to the warp. The default is the preform's. Example: `"45 deg"`"""
    outline: OutlineTable | None = None
    """A shape or a drawing, as in [preform], which is the default.
    Example: `{ rectangle = ["80 mm", "80 mm"] }`"""
    place: Point | None = None
    """Where the centre of its outline lies, x, y. The default is the origin.
    Example: `["10 mm", "0 mm"]`"""
    friction: Friction = 0.0
    """Coulomb's coefficient between it and the plies below it."""


class PlyOf(NamedTuple):
    """A ply as it is made: its cloth, where it lies, friction with those below."""

    name: str
    fabric: Fabric
    preform: Preform
    friction: float


def made(
    plies: Sequence[PlyTable], test: FormingTable, preform: Preform, fabric: Fabric
) -> list[PlyOf]:
    """Make plies of what the case's own preform, where it is drawn, and fabric leave open.

    Raises InputError with all that does not fit.
    """
    problems, found = Problems(), []
    for i, ply in enumerate(plies):
        with problems.caught(), _within(f"ply[{i}]"):
            cloth = fabric if ply.fabric is None else ply.fabric.build(f"ply[{i}].fabric")
            own = preform
            if ply.outline is not None:
                outline, edges = ply.outline.build()
                own = replace(own, outline=outline, edges=edges, origin=None)
            if ply.bias_angle is not None:
                own = replace(own, bias_angle=ply.bias_angle.si)
            own = test.placed(own)
            if ply.place is not None:
                own = _moved(own, np.array(si_values(ply.place)))
            test.check(own, cloth)
            found.append(PlyOf(ply.name, cloth, own, ply.friction))
    problems.tell()
    return found


class _within:
    """Puts the ply's key before a sentence that does not begin with it."""

    def __init__(self, key: str):
        self.key = key

    def __enter__(self) -> None:
        pass

    def __exit__(self, kind, error, _traceback) -> None:
        if isinstance(error, InputError):
            told = [str(s) for s in error.args]
            raise InputError(
                *(s if s.startswith(self.key) else f"{self.key}: {s}" for s in told)
            ) from None


def _moved(preform: Preform, way: np.ndarray) -> Preform:
    outline = shapely.transform(preform.outline, lambda xy: xy + way)
    origin = None if preform.origin is None else tuple(np.array(preform.origin) + way)
    return replace(preform, outline=outline, origin=origin, edges={})


def check_plies(
    plies: Sequence[PlyTable], test: FormingTable, stages: Sequence[StageTable], clamps: Sequence
) -> None:
    """Raise InputError for what of a case several plies cannot have."""
    problems, names = Problems(), [ply.name for ply in plies]
    if not plies:
        return
    if not 2 <= len(plies) <= MOST:
        problems.append(
            f"there {'is 1 [[ply]]' if len(plies) == 1 else f'are {len(plies)} [[ply]]'}, and a "
            f"stack has 2 to {MOST}: a single ply needs no [[ply]]"
        )
    for i, name in enumerate(names):
        if not name.replace("_", "").replace("-", "").isalnum() or len(name) > 20:
            problems.append(
                f'ply[{i}].name = "{name}" must be of up to 20 letters, digits, "_" and "-"'
            )
        elif name in names[:i]:
            problems.append(f'ply[{i}].name = "{name}" is another ply\'s name, too')
    if plies[0].friction:
        problems.append("ply[0].friction is with plies below it, and there is none")
    with problems.caught():
        check_several(test, stages, clamps)
    if test.symmetry and any(ply.place is not None for ply in plies):
        problems.append("ply.place and test.symmetry: planes of symmetry say where plies lie")
    problems.tell()
