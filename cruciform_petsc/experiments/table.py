# SPDX-License-Identifier: MIT
"""[test] of a case file: what all kinds of test share. Each kind's own table is in its file."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Annotated, Any, ClassVar

from pydantic import Field, model_validator

from ..cloth.fabric import Fabric
from ..cloth.preform import Preform
from ..errors import InputError, Problems
from ..fields import Count, Of, Quantities, Size, Table, si_values
from ..units import Quantity, format_si

TOO_FAR = 10.0  # times its length: what no specimen is pulled by

MOST_INCREMENTS = 100_000

Lengths = Annotated[Quantities, Of("m", many=True, example="10 mm")]
Forces = Annotated[Quantities, Of("N", many=True, example="0.5 N")]


class ImperfectionTable(Table):
    """[test] imperfection: what the cloth is not flat by, so that it knows which way to buckle."""

    height: Size
    """Greatest height of waves over the cloth, which it has where nothing loads or holds it.
    Example: `"0.1 mm"`"""
    seed: Annotated[int, Field(ge=0)] = 1
    """Another number, other waves; the same ones on any number of processes and for any pitch."""


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
    """Yarns bend in the plane; false: they are hinged."""

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
        if fabric.remembers and not self.finite:
            what = "shear_friction" if fabric.shear_viscosity is None else "shear_viscosity"
            problems.append(f"fabric.{what} needs test.finite = true")
        problems += check_viscosity(fabric, self.temperature, "test.temperature")
        flows = fabric.shear_viscosity is not None
        if flows and next(iter(self.controls.values())) == "N":
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


class PullTable(TestTable):
    """Kinds whose upper edge is pulled by an extension or a load."""

    extension: Lengths | None = None
    """By which the upper edge is pulled, one value or a list. Either this or load."""
    load: Forces | None = None
    """Force on the upper edge, one value or a list. Either this or extension."""


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
