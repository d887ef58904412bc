# SPDX-License-Identifier: MIT
"""[test] of a case file: what all kinds of test share. Each kind's own table is in its file."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Annotated, Any, ClassVar, Literal

import numpy as np
import shapely
from pydantic import AfterValidator, Field, model_validator

from ..cloth.fabric import Fabric
from ..cloth.preform import Preform
from ..errors import InputError, Problems
from ..fields import Count, Number, Of, Quantities, Ring, Size, Table, si_values
from ..items.nodes import Slip
from ..units import Quantity, format_si

TOO_FAR = 10.0  # times its length: what no specimen is pulled by

MOST_INCREMENTS = 100_000

PRETENSION = Of(
    "N/m", many=True, good=lambda n: n >= 0.0, wanted="zero or positive", example="10 N/cm"
)


def _of_both(told: Quantities) -> Quantities:
    if isinstance(told, list) and len(told) != 2:
        raise ValueError(f"must be one tension, or a list of 2 for warp and weft, got {len(told)}")
    return told


Pretension = Annotated[Quantities, PRETENSION, AfterValidator(_of_both)]


def prestretch(
    pretension: Quantities | None, fabric: Fabric, model: str = "coupled"
) -> tuple[float, float]:
    """Stretches of warp and weft under a pretension of both, or of each; (1, 1) without."""
    if pretension is None or not any(si_values(pretension)):
        return 1.0, 1.0
    if model == "truss":
        raise InputError('test.model = "truss" takes no test.pretension, leave one of them out')
    warp, weft = (si_values(pretension) * 2)[:2]
    try:
        return fabric.prestretch(warp, weft)
    except InputError as error:
        raise InputError(f"test.pretension: {error}") from None


Lengths = Annotated[Quantities, Of("m", many=True, example="10 mm")]
Way = Annotated[Quantity, Of("m", good=lambda way: way != 0.0, wanted="other than 0")]
Forces = Annotated[Quantities, Of("N", many=True, example="0.5 N")]


class ImperfectionTable(Table):
    """[test] imperfection: what the cloth is not flat by, so that it knows which way to buckle."""

    height: Size
    """Greatest height of waves over the cloth, which it has where nothing loads or holds it.
    Example: `"0.1 mm"`"""
    seed: Annotated[int, Field(ge=0)] = 1
    """Another number, other waves; the same ones on any number of processes and for any pitch."""


def _is_crimp(angle: float) -> bool:
    return 0.0 <= angle < 0.5 * np.pi


class SlipTable(Table):
    """[test] slip: yarns slide through crossovers, against friction (docs/slip.md)."""

    force: Annotated[Quantity, Of("N", good=lambda f: f > 0.0, wanted="positive")]
    """Pull-out force of one crossing: at which a yarn slides across one crossing yarn.
    Example: `"0.05 N"`"""
    friction: Annotated[Number, Field(ge=0.0, le=10.0)] = 0.0
    """Of yarn on yarn: with `crimp_angle`, what their tension adds to the force."""
    crimp_angle: (
        Annotated[
            Quantity, Of("rad", example="20 deg", good=_is_crimp, wanted="from 0 to below 90 deg")
        ]
        | None
    ) = None
    """Of yarns to the cloth's plane, where they cross. Example: `"15 deg"`"""
    yarns: Literal["both", "warp", "weft"] = "both"
    """Which slide."""
    region: Ring | None = None
    """Corners of the part of the cloth in which they slide, x and y; by default in all of it.
    Example: `[["0 mm", "0 mm"], ["80 mm", "0 mm"], ["80 mm", "90 mm"]]`"""
    closest: Annotated[Number, Field(ge=0.01, le=0.95)] = 0.2
    """How close crossing yarns come to each other, over their distance at rest."""
    elastic_slip: Size | None = None
    """Up to which friction gives like a spring; by default a thousandth of the pitch.
    Example: `"0.005 mm"`"""

    @model_validator(mode="after")
    def _fits(self) -> SlipTable:
        if (self.friction > 0.0) != (self.crimp_angle is not None):
            given, lacks = ("friction", "crimp_angle")[:: 1 if self.friction > 0.0 else -1]
            raise ValueError(f".{given} needs {lacks}, too: both make a normal force of a tension")
        if self.region is not None and not self._polygon().is_valid:
            raise ValueError(".region crosses or touches itself")
        return self

    def _polygon(self) -> shapely.Polygon:
        return shapely.Polygon([si_values(point) for point in self.region or ()])

    def build(self) -> Slip:
        """What a ply takes."""
        angle = 0.0 if self.crimp_angle is None else self.crimp_angle.si
        return Slip(
            self.force.si,
            2.0 * self.friction * float(np.sin(angle)),  # a yarn presses from both sides
            (self.yarns != "weft", self.yarns != "warp"),
            None if self.region is None else self._polygon(),
            None if self.elastic_slip is None else self.elastic_slip.si,
            self.closest,
        )


class StabilityTable(Table):
    """[test] stability: critical loads and modes (docs/stability.md), with finite = true."""

    modes: Annotated[Count, Field(le=20)] = 1
    """How many shapes are told."""
    branch: bool = True
    """Go on along the branch that leaves where the cloth becomes unstable; false: along the
    unstable state."""
    step: Way | None = None
    """How far along its mode the cloth is moved there, negative: to the other side. The default is
    a tenth of the fabric's thickness, or a thousandth of the longer side. Example: `"0.05 mm"`"""


class KindTable(Table):
    """[test] of any kind: of an experiment on flat cloth, or of forming."""

    # Whether it needs a rectangle whose sides the yarns follow.
    along_the_yarns: ClassVar[bool] = False
    # Edges of the outline, straight ones, that it holds or moves.
    edges: ClassVar[tuple[str, ...]] = ("lower", "upper")
    # What `cruciform-petsc new` writes: the kind's own keys as `test`, with comments, and values,
    # as TOML, of keys of case/template.toml in place of those there.
    template: ClassVar[dict[str, str]] = {}

    kind: str
    """Which experiment."""
    bending: bool = True
    """Yarns bend in the plane; false: they are hinged, as always with model = "truss"."""
    model: Literal["coupled", "truss"] = "coupled"
    """Cruciforms; or a truss of pin-jointed bars along the yarns with soft diagonals, at finite
    deformation (docs/models.md)."""

    @model_validator(mode="before")
    @classmethod
    def _truss_is_hinged(cls, data: Any) -> Any:
        return data | {"bending": False} if data.get("model") == "truss" else data

    @model_validator(mode="after")
    def _truss(self) -> KindTable:
        if self.model == "truss" and not getattr(self, "finite", True):
            raise ValueError('has model = "truss", which is for finite deformation only')
        if self.model == "truss" and getattr(self, "pretension", None) is not None:
            raise ValueError('.pretension is not for model = "truss", leave one of them out')
        return self

    def placed(self, preform: Preform) -> Preform:
        """The preform where the test has it: as it is drawn."""
        return preform

    def check(self, preform: Preform, fabric: Fabric) -> None:
        """Raise InputError if the preform or the fabric is none for such a test."""
        problems = Problems()
        if self.along_the_yarns:
            with problems.caught():
                preform.check_along_the_yarns(f'test.kind = "{self.kind}"')
        for side in ("warp", "weft"):
            if self.bending and getattr(fabric, side).yarn_bending == 0.0:
                problems.append(
                    f"test.bending is true but fabric.{side}.yarn_bending is zero, "
                    "give it a value or set test.bending = false"
                )
        if self.model == "truss" and (fabric.remembers or fabric.biaxial_law is not None):
            problems.append(
                'test.model = "truss" has bars, which know neither viscosity and friction of shear '
                "nor tensions of both families together: leave those out of the fabric"
            )
        problems.tell()


class TestTable(KindTable):
    """[test]: what all kinds of experiments share.

    Every kind prescribes one value or a list of them, of one of its `controls`. Further keys are
    arguments of the kind's class, by the same names.
    """

    __test__: ClassVar[bool] = False  # not a test for pytest
    # SI unit of each.
    controls: ClassVar[dict[str, str]] = {"extension": "m", "load": "N"}
    finite: bool = True
    """Large displacements, rotations and shear angles; false: small displacements. True, unless
    something asks for small displacements: model = "separate" or continuum.ladder."""
    space: bool = False
    """The cloth may leave its plane and buckle, with finite = true."""
    imperfection: ImperfectionTable | None = None
    """Waves by which the cloth is not flat at rest, with space = true. Without them wrinkles start
    from rounding, if at all. Example: `{ height = "0.1 mm", seed = 1 }`"""
    slip: SlipTable | None = None
    """How yarns slide through crossovers, with finite = true; by default they do not.
    Example: `{ force = "0.05 N" }`"""
    stability: StabilityTable | None = None
    """Where the cloth becomes unstable, what shape it takes there and beyond, with finite = true.
    Example: `{ modes = 2 }`"""
    increments: Annotated[Count, Field(le=MOST_INCREMENTS)] | None = None
    """Least number of steps to the last value, with finite = true. Steps are cut further where
    needed. Example: `20`"""

    speed: Annotated[Quantity, Of("m/s", good=lambda v: v > 0.0, wanted="positive")] | None = None
    """Of the edge that is pulled (of a picture frame its crosshead), for cloth whose shear is
    viscous: fabric.shear_viscosity. Example: `"100 mm/min"`"""
    temperature: Annotated[Quantity, Of("K")] | None = None
    """Of the cloth, for the same; by default that of fabric.shear_viscosity."""

    @model_validator(mode="after")
    def _one_control(self) -> TestTable:
        given = [key for key in self.controls if getattr(self, key) is not None]
        if len(given) != 1:
            got = "both" if given else "neither"
            raise ValueError(f"needs exactly one of {' and '.join(self.controls)}, got {got}")
        return self

    @model_validator(mode="after")
    def _in_space(self) -> TestTable:
        if self.space and not self.finite:
            raise ValueError(".space = true needs finite = true: small displacements are flat")
        if self.imperfection is not None and not self.space:
            raise ValueError(".imperfection needs space = true: in the plane nothing can buckle")
        if self.slip is not None and not self.finite:
            raise ValueError(".slip needs finite = true: friction is not linear")
        if self.slip is not None and self.model == "truss":
            raise ValueError('.slip is of crossovers with arms, which model = "truss" has not')
        if self.slip is not None and self.stability is not None:
            raise ValueError(
                ".slip and .stability do not go together: what rubs has no lowest mode"
            )
        if self.imperfection is not None and self.model == "truss":
            raise ValueError(".imperfection is what yarns are bent by, and those of a truss do not")
        if self.stability is not None and not self.finite:
            raise ValueError(
                ".stability needs finite = true: small displacements are always stable"
            )
        if self.stability is not None and self.control != next(iter(self.controls)):
            raise ValueError(
                f".stability follows the {next(iter(self.controls))}, give that in place of "
                f"{self.control}"
            )
        return self

    @classmethod
    def own_keys(cls) -> list[str]:
        """Keys that only this kind has."""
        return [key for key in cls.model_fields if key not in TestTable.model_fields]

    @property
    def control(self) -> str:
        """Key of what is prescribed: "extension", "load", "angle" or "strain"."""
        return next(key for key in self.controls if getattr(self, key) is not None)

    @property
    def is_curve(self) -> bool:
        """Whether a list was given, so that results are lists."""
        return isinstance(getattr(self, self.control), list)

    @property
    def values_si(self) -> list[float]:
        """Prescribed values, one or more [m, N, rad or 1]."""
        return si_values(getattr(self, self.control))

    def check(self, preform: Preform, fabric: Fabric) -> None:
        """Raise InputError if the preform or the fabric is none for such a test."""
        problems = Problems()
        with problems.caught():
            super().check(preform, fabric)
        if self.space:
            with problems.caught():
                fabric.out_of_plane("test.space = true")
        if self.slip is not None:
            problems += _check_slip(fabric)
        if fabric.remembers and not self.finite:
            what = "shear_friction" if fabric.shear_viscosity is None else "shear_viscosity"
            problems.append(f"fabric.{what} needs test.finite = true")
        problems += check_viscosity(fabric, self.temperature, "test.temperature")
        flows = fabric.shear_viscosity is not None
        if flows and self.stability is not None:
            problems.append(
                "test.stability and fabric.shear_viscosity do not go together: what flows is the "
                "stiffer the shorter a step is, leave one of them out"
            )
        if flows and next(iter(self.controls.values())).startswith("N"):
            problems.append(
                f'test.kind = "{self.kind}" prescribes a load, at no speed that '
                "fabric.shear_viscosity could act by, leave that out"
            )
        elif flows and self.speed is None:
            problems.append(
                "test.speed is missing, which fabric.shear_viscosity needs: for example "
                '"100 mm/min"'
            )
        elif self.speed is not None and not flows:
            problems.append("test.speed matters with fabric.shear_viscosity only, leave it out")
        largest, length = max(map(abs, self.values_si)), float(preform.size[1])
        if self.controls[self.control] == "m" and largest > TOO_FAR * length:
            problems.append(
                f"test.{self.control} = {format_si(largest, 'm')} is {largest / length:.3g} times "
                f"the specimen's length of {format_si(length, 'm')}, which unit is meant?"
            )
        problems.tell()


class TensionedTable(TestTable):
    """Kinds whose cloth may be under tension along both yarns before the test."""

    pretension: Pretension | None = None
    """Tension per width along both yarns before the test, which the cloth is drawn with, with
    finite = true: of both, or of warp and weft. Example: `"10 N/cm"`"""

    @model_validator(mode="after")
    def _tensioned(self) -> TensionedTable:
        if self.pretension is not None and not self.finite:
            raise ValueError(".pretension needs finite = true: small displacements start at rest")
        return self

    def check(self, preform: Preform, fabric: Fabric) -> None:
        """See KindTable.check."""
        problems = Problems()
        with problems.caught():
            super().check(preform, fabric)
        with problems.caught():
            prestretch(self.pretension, fabric, self.model)
        problems.tell()


class PullTable(TestTable):
    """Kinds whose upper edge is pulled by an extension or a load."""

    extension: Lengths | None = None
    """By which the upper edge is pulled, one value or a list. Either this or load."""
    load: Forces | None = None
    """Force on the upper edge, one value or a list. Either this or extension."""


def _check_slip(fabric: Fabric) -> Iterator[str]:
    """Problems of a fabric whose yarns are to slide."""
    because = "the length of a yarn that slides has no strain in common with those it crosses"
    if fabric.biaxial_law is not None:
        yield f"test.slip needs a fabric without a biaxial law of tension: {because}"
        return
    for side in ("warp", "weft"):
        poisson = getattr(fabric, side).poisson
        if poisson != 0.0:
            yield f"test.slip needs fabric.{side}.poisson = 0, got {poisson:g}: {because}"


def check_viscosity(fabric: Fabric, temperature: Quantity | None, key: str) -> Iterator[str]:
    """Problems of a temperature that a test or a stage has, at a key."""
    if temperature is None:
        return
    flow = fabric.shear_viscosity
    if flow is None or flow.activation_energy is None:
        yield f"{key} matters with fabric.shear_viscosity.activation_energy only, leave it out"
        return
    try:
        flow.at(temperature.si)
    except InputError as error:
        yield f"{key}: {error}"


def small_unless_told(test: dict[str, Any]) -> dict[str, Any]:
    """[test] of a case where something else asks for small displacements."""
    return {"finite": False} | test
