# SPDX-License-Identifier: MIT
"""[fabric] tension.surface and tension.crimp of case files, and laws through points."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal, cast

import numpy as np
from pydantic import Field, PrivateAttr, model_validator

from ..errors import InputError
from ..fields import Name, Number, Of, Pairs, Table
from ..laws import Potential, linear
from ..laws import table as table_law
from ..reading import MIB, read_given
from ..tension import BiaxialLaw
from ..units import Quantity, format_si
from .crimp import Crimp
from .surface import Surface, check_points, fit_surface

LARGEST_SURFACE = 4 * MIB
_MOST_POINTS = 5000
NOTED, REFUSED = 0.05, 0.30  # misfit of a surface: from where it is asked after, and no law
UNMEASURED = 0.2  # share of the rectangle of strains without points nearby, from which it is told
_TITLES = ("warp strain", "weft strain", "warp tension", "weft tension")
_EXAMPLE = "warp strain (%), weft strain (%), warp tension (N/cm), weft tension (N/cm)"
Four = Annotated[list[Number], Field(min_length=4, max_length=4)]
Fours = Annotated[list[Four], Field(min_length=1, max_length=_MOST_POINTS)]


def largest_is_meant(x: Quantity, largest: float, most: str) -> None:
    """Refuse points in a column of unit `x` that end where nobody measures; ValueError.

    ``most`` is the largest x in the usual unit.
    """
    limit = Quantity.read(most, x.unit)
    over, unit, plain = {
        "rad": ("angle", "deg", "rad"), "1": ("strain", "%", "1"), "1/m": ("curvature", "1/m", ""),
        "m": ("distance", "mm", ""),
    }[x.unit]  # fmt: skip
    meant = unit if largest > limit.si * (1.0 + 1e-9) else ""  # 90 degrees are 90 degrees
    # Laws of cloth go beyond 3 degrees, those of yarns beyond 0.05 %.
    least = {"rad": "3 deg", "1": "0.05 %"}.get(plain)
    if least is not None and x.si < 1.0 and largest < Quantity.read(least, x.unit).si:
        meant = plain
    if meant:
        raise ValueError(
            f'.points go up to {format_si(largest, x.unit)}, is {over} = "{meant}" meant?'
        )


def law_through(x: Quantity, y: Quantity, points: list[list[float]], most: str) -> Potential:
    """A law through points in the units `x` and `y`; `most` is the largest x in the usual unit."""
    columns = [[a * x.si for a, _ in points], [b * y.si for _, b in points]]
    largest_is_meant(x, max(columns[0]), most)
    try:
        return table_law(*columns)
    except InputError as error:
        raise ValueError(f".points: {error}") from None


class SurfaceTable(Table):
    """[fabric] tension.surface: tensions of warp and weft at pairs of their strains."""

    file: Name | None = None
    """CSV file of four columns, strain of the warp, of the weft, tension of the warp, of the weft,
    with a line of titles and units; relative to the case file. Or strain, force and points.
    Example: `"biaxial.csv"`"""
    strain: Annotated[Quantity, Of("1", column=True)] | None = None
    """Unit of the first two columns of points."""
    force: Annotated[Quantity, Of("N/m", column=True, other="N")] | None = None
    """Unit of the last two columns: force per width of the cloth, or per yarn ("N")."""
    points: Fours | None = None
    """Strains and tensions of warp and weft, in any order, at two ratios of the strains or more.
    Example: `[[1, 0, 20, 5], [0, 1, 5, 20], [1, 1, 40, 40]]`"""
    _points: np.ndarray = PrivateAttr()
    _per_yarn: tuple[bool, bool] = PrivateAttr()
    # By yarns per length; found once, and on one rank, from which all others have the case.
    _fitted: dict[tuple[float, float], Surface] = PrivateAttr(default_factory=dict)

    @model_validator(mode="after")
    def _read(self) -> SurfaceTable:
        inline = [key for key in ("strain", "force", "points") if getattr(self, key) is not None]
        if self.file is not None:
            if inline:
                raise ValueError(
                    f"needs either file or strain, force and points, not {inline[0]} too"
                )
            try:
                units, rows = read_surface(self.file)
            except InputError as error:
                raise ValueError(f".file: {error}") from None
        else:
            if len(inline) < 3:
                raise ValueError("needs file, or strain, force and points")
            strain, force = cast(Quantity, self.strain), cast(Quantity, self.force)
            units, rows = (strain, strain, force, force), np.array(self.points)
        for k in (0, 1):
            largest = float(np.max(rows[:, k])) * units[k].si
            if largest > 0.0:
                largest_is_meant(units[k], largest, "100 %")
        self._points = rows * [unit.si for unit in units]
        self._per_yarn = (units[2].unit == "N", units[3].unit == "N")
        try:
            check_points(self._points)
        except InputError as error:
            raise ValueError(f": {error}") from None
        return self

    def surface(self, warp_yarns: float, weft_yarns: float) -> Surface:
        """The nearest potential to the points, of a cloth of so many yarns per length [1/m].

        They turn forces per yarn into those per width.
        """
        of_yarns = zip((warp_yarns, weft_yarns), self._per_yarn, strict=True)
        warp, weft = (yarns if per_yarn else 1.0 for yarns, per_yarn in of_yarns)
        if (warp, weft) not in self._fitted:
            self._fitted[warp, weft] = fit_surface(self._points * [1.0, 1.0, warp, weft])
        return self._fitted[warp, weft]

    def law(self, warp_yarns: float, weft_yarns: float) -> BiaxialLaw:
        """The law; InputError if the points are too far from any."""
        surface = self.surface(warp_yarns, weft_yarns)
        if surface.misfit > REFUSED:
            row, off = surface.worst
            raise InputError(
                f"fabric.tension.surface is no elastic cloth's: the nearest tensions that have an "
                f"energy, dT_warp/de_weft = dT_weft/de_warp, are {100.0 * surface.misfit:.0f} % "
                f"(RMS) off its points, most at point {row} ({100.0 * off:.0f} %); are columns in "
                "another order, or tensions of one family per yarn?"
            )
        return surface.law

    def told(self, warp_yarns: float, weft_yarns: float) -> list[str]:
        """How near the law is to the points, in sentences."""
        surface = self.surface(warp_yarns, weft_yarns)
        row, off = surface.worst
        sentence = (
            f"fabric.tension.surface: the nearest convex energy's tensions are "
            f"{100.0 * surface.misfit:.2g} % (RMS) off its {len(surface.points)} points, at most "
            f"{100.0 * off:.2g} % of the largest, at point {row}"
        )
        if surface.misfit > 1.5 * surface.no_potential + 1e-3:
            sentence += (
                f"; {100.0 * surface.no_potential:.2g} % is how far they are from any energy, the "
                "rest from a convex one"
            )
        sentences = [sentence]
        if surface.unmeasured > UNMEASURED:
            sentences.append(
                "fabric.tension.surface has no points nearby in "
                f"{100.0 * surface.unmeasured:.0f} % of its range of strains, where it is only the "
                "smoothest continuation"
            )
        return sentences

    def question(self, warp_yarns: float, weft_yarns: float) -> str | None:
        """Ask after a surface that is far from its points."""
        misfit = self.surface(warp_yarns, weft_yarns).misfit
        if misfit < NOTED:
            return None
        return (
            f"fabric.tension.surface is {100.0 * misfit:.0f} % (RMS) off its points, which no "
            "elastic cloth can follow: were they measured while loading, and are the columns in "
            "order?"
        )


def points_of_file(path: str | Path, warp_yarns: float, weft_yarns: float) -> np.ndarray:
    """Points (n, 4) of a CSV file in SI, of a cloth of so many yarns per length [1/m]."""
    units, rows = read_surface(str(path))
    of_yarns = zip(units[2:], (warp_yarns, weft_yarns), strict=True)
    count = [yarns if unit.unit == "N" else 1.0 for unit, yarns in of_yarns]
    return rows * [unit.si for unit in units] * [1.0, 1.0, *count]


def read_surface(path: str) -> tuple[tuple[Quantity, ...], np.ndarray]:
    """Units and rows (n, 4) of a CSV file of a surface; InputErrors name the file and the line."""
    name = f'surface of tension "{path}"'
    text = read_given(path, "surface of tension", "CSV", LARGEST_SURFACE).decode(
        "utf-8-sig", "replace"
    )
    lines = [
        (number, line.split("#")[0].strip()) for number, line in enumerate(text.splitlines(), 1)
    ]
    lines = [(number, line) for number, line in lines if line]
    if len(lines) < 2:
        raise InputError(f"{name} needs a line of titles like {_EXAMPLE}, and points below it")
    number, titles = lines[0]
    parts = [part.strip() for part in titles.split(",")]
    if len(parts) != 4:
        raise InputError(
            f"{name}, line {number}: needs four titles like {_EXAMPLE}, got {len(parts)}"
        )
    units = []
    for part, title in zip(parts, _TITLES, strict=True):
        words, _, unit = part.rstrip(")]").replace("[", "(").rpartition("(")
        if not words:
            raise InputError(f'{name}, line {number}: the title "{part}" has no unit in brackets')
        if title.split()[0] not in words.lower():
            raise InputError(f'{name}, line {number}: the titles must be {_EXAMPLE}, got "{part}"')
        kind, other = ("1", "1") if "strain" in title else ("N/m", "N")
        try:
            units.append(Quantity.read(unit.strip(), kind, column=True))
        except ValueError as error:
            try:
                units.append(Quantity.read(unit.strip(), other, column=True))
            except ValueError:
                raise InputError(f'{name}, line {number}: the title "{part}" {error}') from None
    rows: list[list[float]] = []
    for number, line in lines[1:]:
        try:
            row = [float(part) for part in line.split(",")]
        except ValueError:
            row = []
        if len(row) != 4 or not np.isfinite(row).all():
            raise InputError(f"{name}, line {number}: needs four numbers with commas between them")
        rows.append(row)
        if len(rows) > _MOST_POINTS:
            raise InputError(f"{name} has more than {_MOST_POINTS} points")
    return tuple(units), np.array(rows)


class ContactTable(Table):
    """[fabric] tension.crimp.crossover: a law of the yarns' flattening."""

    law: Literal["table"]
    """Points, joined without bumps."""
    distance: Annotated[Quantity, Of("m", column=True)]
    """Unit of the first column."""
    force: Annotated[Quantity, Of("N", column=True)]
    """Unit of the second column."""
    points: Pairs
    """Approach of the two yarns' axes and the force between them, rising; beyond the last point the
    last slope goes on. Example: `[[0.02, 0.5], [0.05, 5]]`"""

    def build(self) -> Potential:
        """Make the law."""
        return law_through(self.distance, self.force, self.points, "100 mm")

    @model_validator(mode="after")
    def _can_be(self) -> ContactTable:
        if not self.build().stiffness0 > 0.0:
            raise ValueError(".points must rise from zero on")
        return self


def _above(value: float) -> bool:
    return value > 0.0


class CrimpTable(Table):
    """[fabric] tension.crimp: yarns of a plain weave as a sawtooth that trades crimp for crimp."""

    warp_height: Annotated[Quantity, Of("m", good=_above, wanted="positive", example="0.15 mm")]
    """Crimp height of the warp: how far a yarn's axis rises from one crossover to the next."""
    weft_height: Annotated[Quantity, Of("m", good=_above, wanted="positive", example="0.15 mm")]
    """The same of the weft."""
    warp_stiffness: Annotated[Quantity, Of("N", good=_above, wanted="positive", example="3000 N")]
    """Force over strain of one warp yarn."""
    weft_stiffness: Annotated[Quantity, Of("N", good=_above, wanted="positive", example="3000 N")]
    """The same of the weft."""
    warp_bending: Annotated[Quantity, Of("N*m**2", good=_above, wanted="positive")]
    """Flexural rigidity of one warp yarn out of the cloth's plane."""
    weft_bending: Annotated[Quantity, Of("N*m**2", good=_above, wanted="positive")]
    """The same of the weft."""
    crossover_stiffness: (
        Annotated[Quantity, Of("N*m/m**2", good=_above, wanted="positive", example="500 N/mm")]
        | None
    ) = None
    """Force between the two yarns of a crossover over their approach, by which they flatten. Or
    crossover."""
    crossover: ContactTable | None = None
    """A law of the flattening in place of crossover_stiffness."""

    @model_validator(mode="after")
    def _one_contact(self) -> CrimpTable:
        if (self.crossover is None) == (self.crossover_stiffness is None):
            raise ValueError("needs either crossover_stiffness or crossover")
        return self

    def crimp(self, warp_yarns: float, weft_yarns: float) -> Crimp:
        """The model of a cloth of so many yarns per length [1/m]."""
        if self.crossover is not None:
            contact = self.crossover.build()
        else:
            assert self.crossover_stiffness is not None
            contact = linear(self.crossover_stiffness.si)
        return Crimp(
            (1.0 / weft_yarns, 1.0 / warp_yarns),
            (self.warp_height.si, self.weft_height.si),
            (self.warp_stiffness.si, self.weft_stiffness.si),
            (self.warp_bending.si, self.weft_bending.si),
            contact,
        )

    def law(self, warp_yarns: float, weft_yarns: float) -> BiaxialLaw:
        """The law of both tensions."""
        return self.crimp(warp_yarns, weft_yarns).law

    def told(self, warp_yarns: float, weft_yarns: float) -> list[str]:
        """The crimp that the heights mean, in a sentence."""
        warp, weft = 100.0 * self.crimp(warp_yarns, weft_yarns).crimp
        return [
            f"fabric.tension.crimp: the warp is crimped by {warp:.3g} %, the weft by {weft:.3g} %"
        ]

    def question(self, warp_yarns: float, weft_yarns: float) -> str | None:
        """Ask after a crimp that no weave has."""
        largest = float(self.crimp(warp_yarns, weft_yarns).crimp.max())
        if largest < 0.5:
            return None
        return f"fabric.tension.crimp is a crimp of {100.0 * largest:.0f} %, which unit is meant?"
