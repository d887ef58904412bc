# SPDX-License-Identifier: MIT
"""What a weaver's data sheet tells of a cloth: tex, yarns per length, fibre; and what follows.

None of it is measured on the cloth, so each value comes with a sentence that says so
(docs/datasheet.md). With n yarns per length of linear density T, of which a share s of the mass
bears, of fibres of density rho, modulus E and diameter d, and a crimp c (yarn length over cloth
length less 1):

    area of a yarn's fibres           A = s T / rho
    modulus of the cloth              n A E / (1 + c)^3        yarns that do not straighten
    mass per area                     n_w T_w (1 + c_w) + n_e T_e (1 + c_e)
    bending of a yarn                 E A d^2 / 16             fibres that slide on each other
    crimp, where it is not given      9/16 (h/p)^2 / f         h half the thickness, p the distance
                                                               of the crossing yarns, f the float

The first holds for a sawtooth whose height stays: a piece of yarn l over p, l^2 = p^2 + h^2, is
stretched by (p/l)^2 of the cloth's strain, and of its force p/l is along the cloth (sawtooth of
Kawabata, Niwa and Kawai 1973, J. Text. Inst. 64:21, without crimp interchange). The crimp is
Peirce's h = 4/3 p sqrt(c) (1937, J. Text. Inst. 28:T45) for each change of side. The rigidity is
that of A / (pi d^2/4) round fibres of E pi d^4/64.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Annotated

from pydantic import field_validator

from ..fields import Number, Of, Table
from ..units import Quantity, format_si
from .weave import Weave

PACKING = 0.5  # volume of fibres over that of a dry cloth whose thickness is not known
SHEAR = 50.0  # N/m; dry reinforcements before they lock: 100 at 2 degrees, 25 at 40
COMPRESSION = 0.01  # stiffness of yarns in compression: they buckle between the crossings
MUCH = 0.1  # relative, from which on masses per area contradict each other


def _positive(unit: str, example: str = "") -> Of:
    return Of(unit, good=lambda value: value > 0.0, wanted="positive", example=example)


class YarnSheet(Table):
    """[fabric] from_datasheet.warp and weft: yarns as a data sheet has them."""

    linear_density: Annotated[Quantity, _positive("kg/m")]
    """Of one yarn: tex, dtex or den."""
    yarns: Annotated[Quantity, _positive("1/m")]
    """Yarns per length across them: ends of the warp, picks of the weft."""
    crimp: (
        Annotated[Quantity, Of("1", good=lambda c: 0.0 <= c <= 1.0, wanted="from 0 to 100 %")]
        | None
    ) = None
    """Length of a yarn over that of the cloth, less 1. The default follows from thickness and
    weave. Example: `"0.5 %"`"""


@dataclass(frozen=True)
class Estimate:
    """What follows from a data sheet, in SI.

    Attributes
    ----------
    sides : dict
        Of warp and weft each: modulus [N/m], and yarn_bending and out_of_plane_bending [N m^2],
        both of a yarn, where the fibres' diameter is known.
    cloth : dict
        areal_density [kg/m^2], thickness [m], fibre_density [kg/m^3], as far as they are known.
    crimp : dict
        Of warp and weft.
    """

    sides: Mapping[str, Mapping[str, float]]
    cloth: Mapping[str, float]
    crimp: Mapping[str, float]


class DatasheetTable(Table):
    """[fabric] from_datasheet: yarns and fibres, from which the rest is estimated."""

    warp: YarnSheet
    """Its yarns. Example: `{ linear_density = "200 tex", yarns = "4.9 /cm" }`"""
    weft: YarnSheet
    """Its yarns, alike."""
    fibre_modulus: Annotated[Quantity, _positive("N/m**2")]
    """Along the fibres, by their own sheet: E glass about 72 GPa, carbon 230, aramid 70 to 130."""
    fibre_density: Annotated[Quantity, _positive("kg/m**3")]
    """Of the fibres that bear."""
    fibre_diameter: Annotated[Quantity, _positive("m", "7 um")] | None = None
    """Of one filament: for the bending of yarns, which is not estimated without."""
    fibre_share: Number = 1.0
    """Mass of the fibres that bear over that of the yarn; below 1 for commingled yarns."""

    @field_validator("fibre_share")
    @classmethod
    def _is_a_share(cls, share: float) -> float:
        if not 0.0 < share <= 1.0:
            raise ValueError(f"must be above 0 and at most 1, got {share:g}")
        return share

    def estimate(self, weave: Weave, thickness: float | None = None) -> Estimate:
        """What follows for a cloth of this weave, and of this thickness [m] if it is known."""
        sheets = {"warp": self.warp, "weft": self.weft}
        density = self.fibre_density.si
        straight = sum(side.yarns.si * side.linear_density.si for side in sheets.values())
        cloth = {}
        if self.fibre_share == 1.0:
            cloth["fibre_density"] = density
            thickness = thickness or straight / (PACKING * density)
        if thickness is not None:
            cloth["thickness"] = thickness
        crimp = {
            "warp": _crimp(self.warp, self.weft, thickness, weave),
            "weft": _crimp(self.weft, self.warp, thickness, weave),
        }
        cloth["areal_density"] = sum(
            side.yarns.si * side.linear_density.si * (1.0 + crimp[name])
            for name, side in sheets.items()
        )
        sides: dict[str, dict[str, float]] = {}
        for name, side in sheets.items():
            stiffness = self.fibre_modulus.si * self.fibre_share * side.linear_density.si / density
            sides[name] = {"modulus": side.yarns.si * stiffness / (1.0 + crimp[name]) ** 3}
            if self.fibre_diameter is not None:
                rigidity = stiffness * self.fibre_diameter.si**2 / 16.0
                sides[name] |= {"yarn_bending": rigidity, "out_of_plane_bending": rigidity}
        return Estimate(sides, cloth, crimp)


def _crimp(own: YarnSheet, other: YarnSheet, thickness: float | None, weave: Weave) -> float:
    if own.crimp is not None:
        return own.crimp.si
    height = 0.5 * (thickness or 0.0)  # each family waves by half of it
    return 9.0 / 16.0 * (height * other.yarns.si) ** 2 / weave.float_length


# From half to three times what is assumed: the glass/PP of the library has 25 to 120 N/m.
SPREAD = "fabric.shear.modulus=25,50,150N/m"
# How estimates are made and what they are worth, by key; units of values that stand before it.
HOW = {
    "modulus": (
        "N/m",
        "estimated from the fibres alone: an upper bound, the cloth is softer until its crimp is "
        "pulled out",
    ),
    "crimp": ("1", "estimated from thickness and weave"),
    "yarn_bending": (
        "N*m**2",
        "estimated for fibres that slide on each other: a lower bound, friction adds to it",
    ),
    "out_of_plane_bending": (
        "N*m**2",
        "estimated for fibres that slide on each other: a lower bound, measure it with a "
        "cantilever",
    ),
    "areal_density": ("kg/m**2", "estimated from linear density, yarns and crimp"),
    "thickness": ("m", f"estimated with {PACKING:.0%} of fibres by volume, which is assumed"),
    "fibre_density": ("kg/m**3", "of the fibres that bear"),
    "shear": (
        "N/m/rad",
        "assumed, no data sheet tells it, and it rules forming: measure it (docs/laws.md)",
    ),
    "compression": ("1", "of the stiffness in tension is assumed, yarns buckle"),
}


def sentence(key: str, values: Mapping[str, float]) -> str:
    """Say of a value, by its place in a case, that it is an estimate; several in one sentence."""
    unit, how = HOW[key]
    shown = {place: format_si(float(f"{value:.3g}"), unit) for place, value in values.items()}
    if len(set(shown.values())) == 1:
        return f"{' = '.join(shown)} = {next(iter(shown.values()))}, {how}"
    return f"{', '.join(f'{place} = {text}' for place, text in shown.items())}, {how}"


def assumed_shear(sentences: Iterable[str]) -> str:
    """What to know of a result for which shear was assumed; "" where it was not.

    ``sentences`` are those of FabricTable.filled_in.
    """
    found = [text for text in sentences if text.startswith("fabric.shear") and "assumed" in text]
    if not found:
        return ""
    return (
        f"{found[0].partition(',')[0].partition(':')[0]} is assumed, not measured: where cloth "
        "shears, loads go with it about in proportion, angles of a bias test hardly, angles and "
        f"wrinkles of a part do; sweep CASE --vary {SPREAD} shows how far"
    )


def contradiction(estimated: float, given: float) -> str | None:
    """Ask where masses per area [kg/m^2] of tex and yarns, and of the cloth, do not fit."""
    if math.isclose(estimated, given, rel_tol=MUCH):
        return None
    return (
        f"fabric.from_datasheet is a cloth of {format_si(float(f'{estimated:.3g}'), 'kg/m**2')}, "
        f"fabric.areal_density = {format_si(given, 'kg/m**2')}: are linear_density, yarns and "
        "their units right?"
    )
