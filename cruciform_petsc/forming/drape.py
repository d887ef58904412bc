# SPDX-License-Identifier: MIT
"""Cusick's drape test: a round of cloth on a smaller disc, its rim hanging in folds.

Cusick 1968, J. Text. Inst. 59:T253: the drape coefficient is the share of the overhang that its
shadow covers, seen from above. Computed with shells of measured rigidity by Collier et al. 1991,
J. Text. Inst. 82:96. How many folds there are varies from specimen to specimen; here a seeded
imperfection chooses.
"""

from __future__ import annotations

from itertools import pairwise
from typing import Annotated, Any, ClassVar, Literal, NamedTuple

import numpy as np
import shapely
from pydantic import Field, model_validator

from ..cloth.fabric import Fabric
from ..cloth.preform import Preform
from ..equilibrium.state import State
from ..errors import Problems
from ..fields import Count, Number, Of, Size
from ..items.loads import facets
from ..parallel import least
from ..tools.tool import ToolTable
from ..units import Quantity
from .forming import Formed
from .kind import Arranged
from .table import ArrangedTable, ClampTable, StageTable, Step

NAMES = ("disc", "plate")
RAYS = 720  # from the middle, along which the shadow's radius is measured
PROMINENT = 0.02  # of the support's radius: a wave of the shadow's rim that is a fold
EdgeRadius = Annotated[Quantity, Of("m", good=lambda r: r > 0.0, wanted="positive")]


class DrapeTable(ArrangedTable):
    """Cusick's drape test: cloth on a disc, its rim hanging in folds."""

    template: ClassVar = {
        "title": '"Drape over a disc"',
        "outline": '{ circle = "300 mm" }',
        "bias_angle": '"0 deg"',
        "yarns_per_cruciform": "6",
        "gravity": "true",
        "test": """
            support_radius = "90 mm"  # Of the disc
            edge_radius = "2 mm"  # Of its rim
            plate = true  # A second disc holds the cloth down
            friction = 0.3  # Coulomb's coefficient between discs and cloth
            results = 4  # States that are written while the cloth falls
            # step = 0.1  # Largest step, as a share of a stage
        """,
    }

    kind: Literal["drape"]  # type: ignore[assignment]
    gravity: Literal[True] = True
    """Weight of the cloth, along -z: what it is about."""
    support_radius: Size = Quantity.read("90 mm", "m")
    """Of the disc that the cloth lies on; preform.outline is the cloth, a circle of 300 mm as a
    rule."""
    edge_radius: EdgeRadius = Quantity.read("2 mm", "m")
    """Of the disc's rim."""
    plate: bool = True
    """A second disc holds the cloth down, as in the instrument; false: it only lies there."""
    friction: Annotated[Number, Field(ge=0.0, le=10.0)] = 0.3
    """Coulomb's coefficient between discs and cloth."""
    results: Annotated[Count, Field(le=10_000)] = 4
    """States that are written while the cloth falls; one more is when it has come to rest."""
    step: Step | None = None
    """Largest step, as a share of a stage; the default is 0.25. Example: `0.1`"""

    @model_validator(mode="after")
    def _bends(self) -> DrapeTable:
        if self.model == "truss":
            raise ValueError('has model = "truss", whose yarns do not bend: nothing makes folds')
        return self

    def check(self, preform: Preform, fabric: Fabric) -> None:
        """See KindTable.check."""
        problems = Problems()
        with problems.caught():
            super().check(preform, fabric)
        placed = self.placed(preform)
        disc = shapely.Point(0.0, 0.0).buffer(self.support_radius.si)
        for axis, side in enumerate((("left", "right"), ("lower", "upper"))):
            if set(side) & set(self.symmetry):  # the part of it that is on this side
                box = np.array([[-1.0, -1.0], [1.0, 1.0]]) * 2.0 * self.support_radius.si
                low = side[0] in self.symmetry
                box[0 if low else 1, axis] = 0.0
                disc = disc.intersection(shapely.box(*box.ravel()))
        if not placed.outline.buffer(1e-9 * self.support_radius.si).contains(disc):
            problems.append(
                f"preform.outline does not cover the disc of test.support_radius = "
                f'"{self.support_radius}", so that nothing could hang over all around'
            )
        if self.edge_radius.si >= 0.5 * self.support_radius.si:
            problems.append(
                f'test.edge_radius = "{self.edge_radius}" must be less than half of '
                f'test.support_radius = "{self.support_radius}"'
            )
        problems.tell()

    def arranged(self) -> tuple[list[ToolTable], list[ClampTable], list[StageTable]]:
        """See ArrangedTable."""
        ring = {"outer_radius": str(self.support_radius), "edge_radius": str(self.edge_radius)}
        tools = [{"name": NAMES[0], "shape": {"ring": ring}, "friction": self.friction}]
        if self.plate:
            shape = {"ring": ring, "side": "-z"}
            tools.append({"name": NAMES[1], "shape": shape, "friction": self.friction})
        more = {} if self.step is None else {"step": self.step}
        stages = [{"name": "fall", "results": self.results, **more}, {"name": "rest", **more}]
        return (
            [ToolTable.from_data(tool, "test") for tool in tools],
            [],
            [StageTable.from_data(stage, "test") for stage in stages],
        )


class Fold(NamedTuple):
    """A fold of the rim.

    Where it points to [rad from x], how far out its crest and the mean of both hollows are [m].
    """

    angle: float
    crest: float
    hollow: float


class Drape(Arranged):
    """A drape test: cloth on a disc, its rim hanging in folds. Collective.

    Arguments: see Arranged and `DrapeTable`.
    """

    table = DrapeTable
    kind = "drape"
    test: DrapeTable
    growing = ("gravity",)  # all at once, cloth would fall into many more folds

    def shadow(self, state: State) -> shapely.Geometry | None:
        """What the cloth covers in plan, on rank 0 (else None), m. Collective.

        The union of all triangles of its surface through yarn ends and crossovers; each rank joins
        its own and sends the outline of that.
        """
        ply = self.blank.ply
        x = self.blank.of_cloth(state).x[:, :2]
        corners = x[facets(ply)[0]]
        turn = np.linalg.det(corners[:, 1:] - corners[:, :1])
        smallest = 1e-12 * float(np.prod(self.network.pitch))
        mine = shapely.union_all(shapely.polygons(corners[abs(turn) > smallest]))
        parts = self.network.comm.gather(mine)
        return None if parts is None else shapely.union_all(parts)

    def coefficient(self, shadow: shapely.Geometry, flat: shapely.Geometry) -> float:
        """Drape coefficient of a shadow beside that of the flat cloth: 1 if nothing hangs."""
        disc = np.pi * self.test.support_radius.si**2 * 0.5 ** len(self.test.axes)
        return float((shadow.area - disc) / (flat.area - disc))

    def figures(self, formed: Formed) -> dict[str, Any]:
        """Coefficient, folds and how it got there. Collective."""
        flat = self.shadow(self.blank.start())
        shadows = [self.shadow(state) for state in formed.states]
        last = formed.states[-1]
        moved = self.blank.ply.displacement(self.blank.of_cloth(last))[1]
        lowest = least(self.network.comm, moved[: self.network.num_nodes_owned, 2], 0.0)
        told = None
        if flat is not None:
            coefficients = [self.coefficient(shadow, flat) for shadow in shadows]
            told = {
                "coefficient_percent": 100.0 * coefficients[-1],
                "coefficients_percent": [100.0 * c for c in coefficients],
                "at_stages_done": [state.time for state in formed.states],
                "change_while_at_rest": 100.0 * (coefficients[-1] - coefficients[-2])
                if len(coefficients) > 1
                else None,
                "drop_mm": -1e3 * lowest,
                "seed": self.test.imperfection.seed,
            }
            if not self.test.axes:
                found = folds(shadows[-1], self.test.support_radius.si)
                told["folds"] = len(found)
                told["fold_depth_mm"] = 1e3 * float(
                    np.mean([f.crest - f.hollow for f in found]) if found else 0.0
                )
                told["fold_angles_deg"] = [float(np.rad2deg(fold.angle)) for fold in found]
                told["fold_crests_mm"] = [1e3 * fold.crest for fold in found]
                told["fold_hollows_mm"] = [1e3 * fold.hollow for fold in found]
        return {"drape": self.network.comm.bcast(told)}


def radii(shadow: shapely.Geometry, rays: int = RAYS) -> np.ndarray:
    """Largest distance of a shadow's rim from the origin, m, by angle from x: float (rays,)."""
    angle = 2.0 * np.pi * np.arange(rays) / rays
    far = 2.0 * np.hypot(*np.abs(np.reshape(shadow.bounds, (2, 2))).max(axis=0))
    ends = far * np.column_stack([np.cos(angle), np.sin(angle)])
    lines = shapely.linestrings(np.stack([np.zeros_like(ends), ends], axis=1))
    cut = shapely.intersection(lines, shadow)
    return np.array([np.hypot(*shapely.get_coordinates(part).T).max(initial=0.0) for part in cut])


def folds(shadow: shapely.Geometry, support: float) -> list[Fold]:
    """Folds of a shadow's rim, around a support of that radius [m].

    A fold is a crest of the rim that stands out from the hollows on both sides by PROMINENT of the
    support's radius.
    """
    from scipy.signal import find_peaks

    r = radii(shadow)
    start = int(r.argmin())  # a peak at the seam would be none
    rolled = np.append(np.roll(r, -start), r[start])
    # Of two crests as high as each other both stand out, however shallow the hollow between them.
    peaks: list[int] = []
    for at in find_peaks(rolled, prominence=PROMINENT * support)[0].tolist():
        last = peaks[-1] if peaks else 0
        if not peaks or rolled[at] - rolled[last:at].min() >= PROMINENT * support:
            peaks.append(at)
    if not peaks:
        return []
    ends = [0, *(a + int(rolled[a:b].argmin()) for a, b in pairwise(peaks)), len(rolled) - 1]
    found = []
    for k, at in enumerate(peaks):
        beside = 0.5 * (rolled[ends[k]] + rolled[ends[k + 1]])
        angle = 2.0 * np.pi * ((start + at) % len(r)) / len(r)
        found.append(Fold(angle, float(rolled[at]), float(beside)))
    return sorted(found)
