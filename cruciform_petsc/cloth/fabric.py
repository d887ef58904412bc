# SPDX-License-Identifier: MIT
"""What the cloth is: moduli, laws, yarn counts, yarn bending; a small library of published fabrics.

Stress is force per unit width [N/m]. Which Poisson's ratio is which follows the paper's [1]:
nu_w is the warp's, it contracts the weft when the warp is pulled,

    eps_w = sigma_w / E_w - nu_e sigma_e / E_e
    eps_e = sigma_e / E_e - nu_w sigma_w / E_w

At finite deformation tension and shear may follow laws (docs/laws.md); the moduli are then the
laws' slopes at rest, so that small deformations are those of the same cloth.
"""

from __future__ import annotations

import math
import tomllib
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from functools import lru_cache
from importlib.resources import files
from typing import Annotated, Any, ClassVar, Literal

import numpy as np
from pydantic import AfterValidator, Field, ValidationInfo, field_validator, model_validator

from ..drawn import Shown
from ..errors import InputError, Problems, unknown
from ..fields import Number, Of, Pairs, Quantities, Read, Table, si_values
from ..laws import Potential, effective_strains, linear, odd_polynomial, sin_powers
from ..tension import BiaxialLaw
from ..units import MEASURES, Quantity, format_si
from .biaxial import CrimpTable, SurfaceTable, law_through
from .checks import number_problems, size_problems
from .datasheet import (
    COMPRESSION,
    HOW,
    SHEAR,
    DatasheetTable,
    Estimate,
    contradiction,
    sentence,
)  # fmt: skip
from .resistance import FrictionTable, ShearFriction, ShearViscosity, ViscosityTable
from .weave import Weave

_RECIPROCITY = 1e-6  # relative; room for the digits people write, not for another material
_SAME_SLOPE = 1e-9  # relative; room for rounding only, the modulus is taken from the law
# What the second column of a table of shear may be.
TORQUE, SHEAR_FORCE = "torque per area", "shear force per length"
DIFFERENCE = 0.05  # between the two, from which on it matters which one is meant
# Keys that a law of shear takes.
_SHEAR_LAWS = {
    None: ("modulus",),
    "table": ("angle", "force", "points", "quantity"),
    "polynomial": ("coefficients",),
    "sin-potential": ("coefficients",),
}
# Laws in place of rigidities and moduli.
_INSTEAD = {"modulus": "tension", "out_of_plane_bending": "out_of_plane_moment"}
MOST_STRETCHED = 0.2  # by a pretension
# What not every test needs, with its SI unit.
_PLY_DATA = {"areal_density": "kg/m**2", "thickness": "m", "fibre_density": "kg/m**3"}


@dataclass(frozen=True)
class YarnFamily:
    """One family of yarns, warp or weft, in SI."""

    modulus: float
    """Extensional modulus of the cloth along these yarns [N/m]."""
    poisson: float
    """Contraction of the other family per stretch of this one when only this one is pulled."""
    yarns: float
    """Yarns per length across them [1/m]."""
    yarn_bending: float = 0.0
    """In-plane flexural rigidity of one yarn [N m^2]."""
    out_of_plane_bending: float | Potential | None = None
    """Flexural rigidity of the cloth along these yarns for bending out of its plane, per width
    [N m]; or a law of the moment per width [N] over the curvature [1/m]."""

    @property
    def out_of_plane_law(self) -> Potential | None:
        """Moment per width [N] over the curvature [1/m] out of the plane."""
        law = self.out_of_plane_bending
        return law if law is None or isinstance(law, Potential) else linear(law)

    @property
    def spacing(self) -> float:
        """Distance between neighbouring yarns of the family [m]."""
        return 1.0 / self.yarns


@dataclass(frozen=True, repr=False)
class Fabric(Shown):
    """A woven cloth, elastic in the plane.

    Raises
    ------
    InputError
        Moduli, yarn counts, masses or thickness not positive, fibres of more volume than the cloth;
        yarn bending negative, bending out of the plane not positive, no reciprocity,
        nu_w nu_e >= 1; a law with another slope at rest than its modulus, a tension law with
        Poisson's ratios; compression not in (0, 1], its width not positive.
    """

    name: str
    warp: YarnFamily
    weft: YarnFamily
    shear_modulus: float
    """G [N/m]; with a shear law its slope at rest."""
    source: str = ""
    """Where the values come from."""
    shear_law: Potential | None = None
    """Energy per area [N/m] over the shear angle [rad]; None: linear, G."""
    warp_law: Potential | None = None
    """Energy per area [N/m] over the strain of the warp at no strain of the weft; None: linear,
    C11. The modulus is its slope at rest."""
    weft_law: Potential | None = None
    """The same of the weft; None: linear, C22."""
    biaxial_law: BiaxialLaw | None = None
    """Energy per area [N/m] over both strains, in place of both laws and of c12; moduli
    and Poisson's ratios are those of its stiffness at rest (`with_biaxial_law`)."""
    log_strain: bool = False
    """Strain is the logarithm of the stretch, not the stretch less 1."""
    compression: float = 1.0
    """Stiffness of yarns in compression over that in tension."""
    compression_width: float = 1e-4
    """Strain over which the stiffness falls when a yarn goes from tension into compression."""
    shear_viscosity: ShearViscosity | None = None
    """Of cloth in a melt or a resin, beside the law of shear."""
    shear_friction: ShearFriction | None = None
    """Between warp and weft, beside the law of shear."""
    areal_density: float | None = None
    """Mass of the yarns per area of the cloth at rest [kg/m^2]; for gravity and exports."""
    thickness: float | None = None
    """Of the cloth at rest [m]; for contact, exports and pictures in space."""
    fibre_density: float | None = None
    """Mass per volume of what the yarns consist of [kg/m^3]; for exports."""
    out_of_plane_twisting: float = 0.0
    """How hard it twists, over a sheet that bends alike in all directions, see items.twist."""
    weave: str = "plain"
    """Or "twill 2/2", "satin 5" (`Weave.named`); for pictures of yarns in space."""

    def __post_init__(self) -> None:
        """Check that such a cloth can exist."""
        problems = Problems()
        problems += _slope("shear", self.shear_law, self.shear_modulus, "shear_modulus")
        for side, law in (("warp", self.warp_law), ("weft", self.weft_law)):
            family = getattr(self, side)
            problems += _slope(f"{side}.tension", law, family.modulus, f"{side}.modulus")
            if law is not None and family.poisson != 0.0:
                problems.append(
                    f"fabric.{side}.tension is a law, which needs fabric.{side}.poisson = 0, "
                    f"got {family.poisson:g}"
                )
            if law is None:
                problems += number_problems(f"{side}.modulus", family.modulus, "N/m")
            problems += number_problems(f"{side}.poisson", family.poisson, wanted="finite")
            problems += number_problems(f"{side}.yarns", family.yarns, "1/m")
            wanted = "zero or positive and finite"
            problems += number_problems(
                f"{side}.yarn_bending", family.yarn_bending, "N*m**2", wanted
            )
            bend = family.out_of_plane_bending
            if bend is not None:
                rigidity = bend.stiffness0 if isinstance(bend, Potential) else bend
                problems += number_problems(f"{side}.out_of_plane_bending", rigidity, "N*m")
        if math.inf > self.shear.last_point > 0.5 * math.pi * (1.0 + 1e-9):
            last = self.shear.last_point
            problems.append(
                f"fabric.shear_law has points up to {last:g} rad, is {last:g} deg meant?"
            )
        if self.shear_law is None:
            problems += number_problems("shear.modulus", self.shear_modulus, "N/m")
        for key, wanted in (
            ("compression", "above 0 and at most 1"), ("compression_width", "positive and finite")
        ):  # fmt: skip
            found = list(number_problems(f"tension.{key}", getattr(self, key), wanted=wanted))
            problems += found or size_problems(f"tension.{key}", getattr(self, key), "1")
        for name, unit in _PLY_DATA.items():
            if getattr(self, name) is not None:
                problems += number_problems(name, getattr(self, name), unit)
        try:
            Weave.named(self.weave)
        except InputError as error:
            problems.append(f"fabric.weave {error}")
        problems.tell()
        fraction = self.fibre_volume_fraction
        if self.thickness is not None and fraction is not None and fraction > 1.0:
            problems.append(
                "fabric.areal_density over fabric.fibre_density is a layer of "
                f"{format_si(fraction * self.thickness, 'm')} without any gaps, which is more "
                f"than fabric.thickness = {format_si(self.thickness, 'm')}"
            )
        problems += self._at_rest()
        problems.tell()
        nu_w, nu_e = self.warp.poisson, self.weft.poisson
        # Compliance [1] has an energy only if it is symmetric.
        left, right = nu_e * self.warp.modulus, nu_w * self.weft.modulus
        if not math.isclose(left, right, rel_tol=_RECIPROCITY):
            problems.append(
                f"fabric.weft.poisson = {nu_e:g} breaks reciprocity (nu_weft E_warp must equal "
                "nu_warp E_weft), with the other values it would have to be "
                f"{right / self.warp.modulus:.9g}"
            )
        # With reciprocity the product is a square times E_e/E_w: negative ratios (a cloth that
        # widens when pulled) are as admissible as positive ones, only the product counts.
        if nu_w * nu_e >= 1.0:
            problems.append(
                f"fabric.warp.poisson times fabric.weft.poisson must be less than 1, "
                f"got {nu_w * nu_e:g}"
            )
        problems.tell()

    @classmethod
    def from_table(cls, name: str, table: Mapping[str, Any]) -> Fabric:
        """Make a fabric from values with units, as in ``[fabric]`` of a case file.

        See docs/case-file.md; there may also be a ``source``. What is None counts as missing.
        """
        return LibraryTable.from_data(dict(table), "fabric").build(name)

    @classmethod
    def from_library(cls, name: str, changes: Mapping[str, Any] | None = None) -> Fabric:
        """Return a published fabric; `fabric_names` lists them.

        ``changes`` replace the library's ``shear``, ``shear_viscosity``, ``shear_friction`` and
        ``tension`` as a whole, ``out_of_plane_bending``, ``out_of_plane_twisting``,
        ``areal_density``, ``thickness``, ``fibre_density``; as for `from_table`.

        Examples
        --------
        >>> fabric = Fabric.from_library("e-glass-plain-2.4", {"shear": {"modulus": "2 N/cm"}})
        >>> fabric.name, round(fabric.shear_modulus, 9), fabric.shear.name  # N/m
        ('e-glass-plain-2.4, shear replaced', 200.0, 'linear')
        >>> fabric.warp.spacing == 1 / 240  # m
        True
        >>> Fabric.from_library("e-glas-plain-2.4")
        Traceback (most recent call last):
        cruciform_petsc.errors.InputError: there is no fabric "e-glas-plain-2.4" in the library ...
        """
        _published(name)
        return FabricTable.from_data({"use": name, **(changes or {})}, "fabric").build(name)

    def with_shear_law(self, law: Potential) -> Fabric:
        """The same cloth with another law of shear; its modulus becomes the law's slope at rest."""
        return replace(self, shear_law=law, shear_modulus=law.stiffness0)

    def with_biaxial_law(self, law: BiaxialLaw) -> Fabric:
        """The same cloth with a law of both tensions in place of its moduli, ratios and laws.

        Raises InputError if at rest the law is not stiff against every pair of strains.
        """
        warp, weft, both = (float(value) for value in law.stiffness0)
        if not (warp > 0.0 and weft > 0.0 and both**2 < warp * weft):
            stiffness = ", ".join(format_si(value, "N/m") for value in (warp, weft, both))
            raise InputError(
                f"the {law.name} of fabric.tension must resist every strain at rest, its stiffness "
                f"there is {stiffness} (warp, weft, both)"
            )
        ratio = 1.0 - both**2 / (warp * weft)
        return replace(
            self,
            warp=replace(self.warp, modulus=warp * ratio, poisson=both / weft),
            weft=replace(self.weft, modulus=weft * ratio, poisson=both / warp),
            warp_law=None,
            weft_law=None,
            biaxial_law=law,
        )

    def _at_rest(self) -> Iterator[str]:
        """Problems of a biaxial law beside others, or with other moduli than its own."""
        if self.biaxial_law is None:
            return
        found = np.array([self.c11, self.c22, self.c12])
        wanted = self.biaxial_law.stiffness0
        single = (self.warp_law, self.weft_law) != (None, None)
        if single or not np.allclose(found, wanted, rtol=_RECIPROCITY):
            yield "fabric.biaxial_law is to be set by Fabric.with_biaxial_law"

    @property
    def shear(self) -> Potential:
        """Energy per area over the shear angle, psi(gamma) [N/m over rad]."""
        return linear(self.shear_modulus) if self.shear_law is None else self.shear_law

    @property
    def remembers(self) -> bool:
        """Whether shear resists by more than its law, which only finite deformation knows."""
        return self.shear_viscosity is not None or self.shear_friction is not None

    @property
    def warp_tension(self) -> Potential:
        """Energy per area over the effective warp strain, at no strain of the weft [N/m]."""
        return linear(self.c11) if self.warp_law is None else self.warp_law

    @property
    def weft_tension(self) -> Potential:
        """Energy per area over the effective weft strain, at no strain of the warp [N/m]."""
        return linear(self.c22) if self.weft_law is None else self.weft_law

    @property
    def c11(self) -> float:
        """Warp stress per warp strain at fixed weft strain [N/m].

        [1] inverted; the printed [2] and [5] lack the factor 1/(1 - nu_w nu_e) here.
        """
        return self.warp.modulus / (1.0 - self.warp.poisson * self.weft.poisson)

    @property
    def c22(self) -> float:
        """Weft stress per weft strain at fixed warp strain [N/m]."""
        return self.weft.modulus / (1.0 - self.warp.poisson * self.weft.poisson)

    @property
    def c12(self) -> float:
        """Warp stress per weft strain, and the reverse: nu_e C11 = nu_w C22 [N/m], [2]-[4]."""
        return self.weft.poisson * self.c11

    @property
    def fibre_volume_fraction(self) -> float | None:
        """Volume of the fibres over that of the cloth, at rest; None without the data for it."""
        if self.areal_density is None or self.thickness is None or self.fibre_density is None:
            return None
        return self.areal_density / (self.fibre_density * self.thickness)

    def needed(self, key: str, by: str) -> float:
        """areal_density, thickness or fibre_density; if missing an InputError says ``by`` what."""
        value = getattr(self, key)
        if value is None:
            example = MEASURES[_PLY_DATA[key]][1]
            raise InputError(f'fabric.{key} is missing, which {by} needs: for example "{example}"')
        return value

    def out_of_plane(self, by: str) -> tuple[Potential, Potential]:
        """Moment per width [N] of warp and weft over the curvature [1/m] out of the plane.

        Raises InputError, with ``by`` what it is missed.
        """
        laws = []
        for side in ("warp", "weft"):
            law = getattr(self, side).out_of_plane_law
            if law is None:
                raise InputError(
                    f"fabric.{side}.out_of_plane_bending is missing, which {by} needs: per width, "
                    'as measured with a cantilever or KES, for example "0.2 N mm", or per yarn, '
                    'for example "0.6 N mm^2"'
                )
            laws.append(law)
        return laws[0], laws[1]

    def tensions(self, stretch: Any) -> np.ndarray:
        """Tension of both families over the width as it is, N/m, at their stretches; (2,).

        Of cloth that is stretched along both yarns and not sheared.
        """
        stretch = np.asarray(stretch, float)
        return self.tension(stretch)[1] / stretch[::-1]

    def prestretch(self, warp: float, weft: float) -> tuple[float, float]:
        """Stretches at which both families have tensions over the width as it is then, N/m.

        InputError where there are none up to MOST_STRETCHED, or yarns would be compressed.
        """
        from scipy.optimize import root

        wanted = np.array([warp, weft])
        if not wanted.any():
            return 1.0, 1.0
        size = wanted.max()
        start = np.clip(wanted / [self.warp.modulus, self.weft.modulus], 0.0, 0.1)
        for share in (1.0, 0.3, 0.1, 0.03):  # crimped cloth stiffens a hundredfold on the way
            found = root(
                lambda stretch: (self.tensions(stretch) - wanted) / size,
                1.0 + share * start,
                tol=1e-12,
            )
            left = abs(self.tensions(found.x) - wanted).max() / size
            met = left < 1e-9 and (abs(found.x - 1.0) < MOST_STRETCHED).all()
            if met:
                break
        if not met:
            raise InputError(
                f"a pretension of {format_si(warp, 'N/m')} of the warp and "
                f"{format_si(weft, 'N/m')} of the weft stretches the cloth by more than "
                f"{100.0 * MOST_STRETCHED:g} %, which unit is meant?"
            )
        return float(found.x[0]), float(found.x[1])

    def effective_strain(self, stretch: Any) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Strain e as a law of tension takes it, de/dstretch, d2e/dstretch2: as `stretch`."""
        return effective_strains(stretch, self.log_strain, self.compression, self.compression_width)

    def tension(self, stretch: Any) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Energy, tensions and stiffness of the cloth at stretches of warp and weft (..., 2).

        Returns
        -------
        energy per area (...), J/m^2
        tensions (..., 2) of warp and weft: its derivatives by the stretches, per width at rest, N/m
        stiffness (..., 3): second derivatives ww, ee, we, N/m
        """
        stretch = np.asarray(stretch, float)
        if self.biaxial_law is not None:
            strain, rate, change = effective_strains(stretch, self.log_strain)
            energy, first, second = self.biaxial_law.evaluate(
                strain[..., 0], strain[..., 1], self.compression, self.compression_width
            )
            second = second.copy()
        else:
            strain, rate, change = self.effective_strain(stretch)
            values = [
                law.evaluate(strain[..., k])
                for k, law in enumerate((self.warp_tension, self.weft_tension))
            ]
            energy = values[0][0] + values[1][0] + self.c12 * strain.prod(axis=-1)
            first = np.stack([value[1] for value in values], axis=-1)
            first = first + self.c12 * strain[..., ::-1]
            second = np.stack(
                [values[0][2], values[1][2], np.full(strain.shape[:-1], self.c12)], axis=-1
            )
        second[..., :2] = second[..., :2] * rate**2 + first * change
        second[..., 2] *= rate.prod(axis=-1)
        return energy, first * rate, second

    def off_axis_modulus(self, angle: Any) -> Any:
        """Modulus [N/m] of a strip with free sides, by the angle [rad] from its pull to the warp.

        Kilby 1963, J. Text. Inst. 54:T9:

        1/E_t = cos^4 t / E_w + sin^4 t / E_e + (1/G - 2 nu_w / E_w) sin^2 t cos^2 t
        """
        c2, s2 = np.cos(angle) ** 2, np.sin(angle) ** 2
        mixed = 1.0 / self.shear_modulus - 2.0 * self.warp.poisson / self.warp.modulus
        return 1.0 / (c2**2 / self.warp.modulus + s2**2 / self.weft.modulus + mixed * c2 * s2)

    def __repr__(self) -> str:
        """Name and numbers with units; which laws are not straight lines, and where tables end."""

        def modulus(value: float, law: Potential | None, unit: str, scale: float) -> str:
            text = format_si(value, "N/m")
            if law is not None:
                text += f" at rest by a {law.name}"
                if math.isfinite(last := law.last_point):
                    text += f" of {int(law.data[1])} points up to {last * scale:.4g} {unit}"
            return text

        def family(yarns: YarnFamily, law: Potential | None) -> str:
            own, density = modulus(yarns.modulus, law, "%", 100.0), format_si(yarns.yarns, "1/m")
            bending = format_si(yarns.yarn_bending, "N*m**2")
            out = yarns.out_of_plane_law
            across = "" if out is None else f", out of plane {format_si(out.stiffness0, 'N*m')}"
            return f"({own}, nu {yarns.poisson:g}, {density}, yarn {bending}{across})"

        warp, weft = family(self.warp, self.warp_law), family(self.weft, self.weft_law)
        shear = modulus(self.shear_modulus, self.shear_law, "deg", math.degrees(1.0))
        if self.shear_viscosity is not None:
            shear += f", viscosity {self.shear_viscosity}"
        if self.shear_friction is not None:
            shear += f", friction {self.shear_friction}"
        if self.biaxial_law is not None:
            shear += f", tension by a {self.biaxial_law.name}"
        return f'Fabric("{self.name}", warp {warp}, weft {weft}, shear {shear})'


def _slope(key: str, law: Potential | None, modulus: Any, name: str) -> Iterator[str]:
    """Problems of a law that does not resist from the start, or has another modulus beside it."""
    if law is None:
        return
    slope = law.stiffness0
    if not 0.0 < slope < math.inf:
        yield (
            f"fabric.{key} is a law whose slope at zero must be positive and finite, "
            f"got {format_si(slope, 'N/m')}"
        )
        return
    yield from size_problems(key, slope, "N/m")
    if not abs(modulus - slope) <= _SAME_SLOPE * slope:
        yield (
            f"fabric.{name} must be the slope of its law at zero, {format_si(slope, 'N/m')}, "
            f"got {format_si(modulus, 'N/m')}"
        )


# -- tables of case files, from which fabrics are built --------------------------------------------


class TensionLawTable(Table):
    """[fabric] warp.tension and weft.tension: a law in place of the modulus."""

    law: Literal["table"]
    """Points, joined without bumps."""
    strain: Annotated[Quantity, Of("1", column=True)]
    """Unit of the first column."""
    force: Annotated[Quantity, Of("N/m", column=True)]
    """Unit of the second column."""
    points: Pairs
    """Strain and tension, rising; beyond the last point the last slope goes on.
    Example: `[[0.5, 5], [1, 30]]`"""

    @model_validator(mode="after")
    def _can_be(self) -> TensionLawTable:
        self.build()
        return self

    def build(self) -> Potential:
        """Make the law."""
        return law_through(self.strain, self.force, self.points, "100 %")


def _per_width(bending: Quantity, yarns: float) -> float:
    """Rigidity per width [N m] of one that may be that of a yarn, of so many per length [1/m]."""
    return bending.si * (yarns if bending.unit == "N*m**2" else 1.0)


class MomentLawTable(Table):
    """[fabric] warp.out_of_plane_moment and weft.out_of_plane_moment: a law of bending."""

    law: Literal["table"]
    """Points, joined without bumps."""
    curvature: Annotated[Quantity, Of("1/m", column=True)]
    """Unit of the first column."""
    moment: Annotated[Quantity, Of("N*m/m", column=True)]
    """Unit of the second column: moment per width."""
    points: Pairs
    """Curvature and moment, rising; beyond the last point the last slope goes on.
    Example: `[[0.5, 0.01], [2, 0.02]]`"""

    @model_validator(mode="after")
    def _can_be(self) -> MomentLawTable:
        self.build()
        return self

    def build(self) -> Potential:
        """Make the law."""
        # Nobody bends cloth to a tenth of a millimetre; metres over a column of 1/mm do.
        return law_through(self.curvature, self.moment, self.points, "100 /cm")


class YarnTable(Table):
    """[fabric] warp and weft."""

    _needs_modulus: ClassVar[bool] = True
    # before modulus, whose check asks for it
    tension: TensionLawTable | None = None
    """A law in place of the modulus; needs poisson = 0 (docs/laws.md)."""
    modulus: Annotated[Quantity, Of("N/m")] | None = None
    """Tension per width over strain. Needed without tension."""
    poisson: Number | None = None
    """Contraction of the other family when this one is pulled. By default 0, or what follows from
    the other family's by reciprocity: poisson of the weft times modulus of the warp is poisson of
    the warp times modulus of the weft. Example: `0.45`"""
    yarns: Annotated[Quantity, Of("1/m")]
    """Yarns per length across them."""
    yarn_bending: Annotated[Quantity, Of("N*m**2")] = Quantity("0 N mm^2")
    """In-plane flexural rigidity of one yarn. Above zero for test.bending = true."""
    out_of_plane_bending: Annotated[Quantity, Of("N*m", other="N*m**2")] | None = None
    """For bending out of the plane: per width (N m, as measured with a cantilever or KES) or of one
    yarn (N m^2), told apart by the unit. Needed in space."""
    out_of_plane_moment: MomentLawTable | None = None
    """A law in place of out_of_plane_bending."""

    @field_validator("modulus")
    @classmethod
    def _or_tension(cls, modulus: Quantity | None, info: ValidationInfo) -> Quantity | None:
        tension = info.data.get("tension", ...)  # not there: given, and wrong in itself
        if modulus is None and tension is None and cls._needs_modulus:
            raise ValueError("is missing")
        if modulus is not None and isinstance(tension, TensionLawTable):
            raise ValueError("cannot stand beside tension, a law in its place")
        return modulus

    @model_validator(mode="after")
    def _one_bending(self) -> YarnTable:
        if self.out_of_plane_bending is not None and self.out_of_plane_moment is not None:
            raise ValueError(
                ".out_of_plane_bending cannot stand beside out_of_plane_moment, a law in its place"
            )
        return self

    def build(self) -> tuple[YarnFamily, Potential | None]:
        """Make the family, and its law of tension if it has one."""
        out: float | Potential | None = None
        if self.out_of_plane_moment is not None:
            out = self.out_of_plane_moment.build()
        elif self.out_of_plane_bending is not None:
            out = _per_width(self.out_of_plane_bending, self.yarns.si)
        law = None if self.tension is None else self.tension.build()
        modulus = 1.0 if self.modulus is None else self.modulus.si  # that of a biaxial law to come
        modulus = modulus if law is None else law.stiffness0
        bending = self.yarn_bending.si
        return YarnFamily(modulus, self.poisson or 0.0, self.yarns.si, bending, out), law


class YarnChanges(YarnTable):
    """[fabric] warp and weft beside from_datasheet: what replaces its estimates."""

    _needs_modulus: ClassVar[bool] = False
    yarns: Annotated[Quantity, Of("1/m")] | None = None  # type: ignore[assignment]
    yarn_bending: Annotated[Quantity, Of("N*m**2")] | None = None  # type: ignore[assignment]

    @field_validator("yarns")
    @classmethod
    def _in_the_sheet(cls, yarns: Quantity | None) -> None:
        if yarns is not None:
            raise ValueError("stands in fabric.from_datasheet, leave it out here")


class FreeYarnTable(YarnTable):
    """[fabric] warp and weft beside a tension that cannot be read: maybe it has the modulus."""

    _needs_modulus: ClassVar[bool] = False


class CoupledYarnTable(FreeYarnTable):
    """[fabric] warp and weft beside tension.surface or tension.crimp."""

    @field_validator("tension", "modulus", "poisson")
    @classmethod
    def _in_the_law(cls, value: Any) -> Any:
        if value is not None:
            raise ValueError("cannot stand beside tension.surface or tension.crimp, which have it")
        return value


class _Side(Read):
    """A `YarnTable`, or beside a data sheet what replaces values of it, or beside a biaxial law."""

    def read(self, value: Any, info: Any) -> YarnTable:
        """Read it as what it is."""
        if isinstance(value, YarnTable):
            return value
        sheet = info.data.get("from_datasheet", ...)  # not there: given, and wrong in itself
        model = YarnTable if sheet is None else YarnChanges
        tension = info.data.get("tension", ...)
        if sheet is None and tension is ...:
            model = FreeYarnTable
        elif sheet is None and tension is not None and tension.biaxial is not None:
            model = CoupledYarnTable
        return model.model_validate(value, context=info.context)

    def json_schema(self, handler: Any) -> dict[str, Any]:
        """See `Read`."""
        tables = (YarnTable, YarnChanges, CoupledYarnTable)
        return {"anyOf": [handler(table.__pydantic_core_schema__) for table in tables]}


class ShearTable(Table):
    """[fabric] shear: a modulus, or a law with its own keys."""

    modulus: Annotated[Quantity, Of("N/m/rad")] | None = None
    """Of a linear law. Either this or law."""
    law: Literal["table", "polynomial", "sin-potential"] | None = None
    """A law in place of the modulus (docs/laws.md)."""
    angle: Annotated[Quantity, Of("rad", column=True)] | None = None
    """Unit of the first column, with law = "table"."""
    force: Annotated[Quantity, Of("N/m", column=True)] | None = None
    """Unit of the second column, with law = "table"."""
    quantity: Literal["torque per area", "shear force per length"] | None = None
    """Of the second column, with law = "table": psi', or what a picture frame's force over
    2 cos(theta) gives per side, F_s/L = psi'/cos(gamma) (docs/laws.md). By default torque per area.
    Example: `"torque per area"`"""
    points: Pairs | None = None
    """Shear angle and the quantity, rising, with law = "table". Example:
    `[[10, 0.01], [40, 0.2]]`"""
    coefficients: Annotated[Quantities, Of("N/m", many=True)] | None = None
    """Of the other laws: k1 gamma + k2 gamma^3 + ... with law = "polynomial",
    k1 sin^2 gamma + k2 sin^4 gamma + ... (an energy) with law = "sin-potential"."""

    @model_validator(mode="after")
    def _can_be(self) -> ShearTable:
        given = [key for key, value in self if value is not None and key != "law"]
        takes, keys = _SHEAR_LAWS[self.law], "modulus without law"
        if self.law is not None:
            keys = f'{", ".join(("law", *takes))} with law = "{self.law}"'
            if self.modulus is not None:
                raise ValueError("needs either modulus or law, not both")
        elif not given:
            raise ValueError("needs modulus or law")
        for key in given:
            if key not in takes:
                raise ValueError(f"takes {keys}, not {key}")
        for key in takes:
            if key not in (*given, "quantity"):
                raise ValueError(f".{key} is missing")
        self.build()
        return self

    def question(self) -> str | None:
        """Ask what a table's second column is, where that makes a difference."""
        law = self.build()
        more = 1.0 / math.cos(law.last_point) - 1.0 if law.name == "table" else 0.0
        if self.quantity is not None or more < DIFFERENCE:
            return None
        return (
            f'fabric.shear does not name its quantity and is taken as "{TORQUE}": where the table '
            f'ends, at {format_si(law.last_point, "rad")}, a picture frame\'s "{SHEAR_FORCE}" is '
            f"{100.0 * more:.0f} % more; write which one it is"
        )

    def build(self) -> Potential:
        """Make the law."""
        if self.modulus is not None:
            return linear(self.modulus.si)
        if self.angle is not None and self.force is not None and self.points is not None:
            points = self.points
            if self.quantity == SHEAR_FORCE:  # F_s L cos(gamma) is the torque on a frame of side L
                points = [[angle, f * math.cos(angle * self.angle.si)] for angle, f in points]
            # Nobody shears cloth by more than a right angle; radians over a column of degrees do.
            return law_through(self.angle, self.force, points, "90 deg")
        assert self.coefficients is not None  # the check above has seen to it
        values = si_values(self.coefficients)
        return odd_polynomial(values) if self.law == "polynomial" else sin_powers(values)


class TensionTable(Table):
    """[fabric] tension: which strain, and what becomes of yarns in compression."""

    strain: Literal["engineering", "log"] = "engineering"
    """Stretch less 1, or its logarithm."""
    compression: Number = 1.0
    """Stiffness of yarns in compression over that in tension. Above 0, at most 1."""
    compression_width: Number = 1e-4
    """Strain over which the stiffness falls. About buckling stress over modulus."""
    surface: SurfaceTable | None = None
    """Measured tensions at pairs of strains, for both families; warp and weft then without modulus,
    poisson and tension (docs/laws.md).
    Example: `{ file = "biaxial.csv" }`"""
    crimp: CrimpTable | None = None
    """A crimp model of a plain weave in place of surface (docs/laws.md)."""

    @model_validator(mode="after")
    def _one_law(self) -> TensionTable:
        if self.surface is not None and self.crimp is not None:
            raise ValueError("takes either surface or crimp, not both")
        if self.crimp is not None and self.strain != "engineering":
            raise ValueError(
                '.strain must be "engineering" beside crimp, which stretches lengths as they are'
            )
        return self

    @property
    def biaxial(self) -> SurfaceTable | CrimpTable | None:
        """The law of both families, if there is one."""
        return self.crimp if self.surface is None else self.surface


def _woven(name: str) -> str:
    try:
        Weave.named(name)
    except InputError as error:
        raise ValueError(str(error)) from None
    return name


class FabricTable(Table):
    """[fabric]: a name from the library, maybe with laws of one's own, a data sheet, or values."""

    use: str | None = None
    """A fabric of the library (cruciform-petsc fabrics). Or from_datasheet, or warp, weft and
    shear. Example: `"glass-pp-plain-1.93"`"""
    from_datasheet: DatasheetTable | None = None
    """Yarns and fibres, from which all else is estimated that does not stand beside it
    (docs/datasheet.md)."""
    # before warp and weft, which ask whether it has a law of both
    tension: TensionTable | None = None
    """Which strain, and yarns in compression; in place of the library's.
    Example: `{ strain = "log", compression = 0.01 }`"""
    warp: Annotated[YarnTable, _Side()] | None = None
    """Values of one's own, in place of use, or of the data sheet's estimates. Example:
    `{ modulus = "520 N/cm", poisson = 0.45, yarns = "2.4 /cm", yarn_bending = "0.6 N mm^2" }`"""
    weft: Annotated[YarnTable, _Side()] | None = None
    """Beside warp, alike."""
    shear: ShearTable | None = None
    """Beside warp and weft, or in place of the library's. Example: `{ modulus = "0.96 N/cm" }`"""
    shear_viscosity: ViscosityTable | None = None
    """Of cloth in a melt or a resin; its shear resists by its rate, too. Needs test.speed, or the
    duration of stages. Example: `{ viscosity = "50 N s/m" }`"""
    shear_friction: FrictionTable | None = None
    """Between warp and weft, so that unloading is another way than loading.
    Example: `{ torque = "5 N/m" }`"""
    out_of_plane_bending: Annotated[Quantity, Of("N*m", other="N*m**2")] | None = None
    """Of warp and weft alike, as for each of them; in place of theirs, and of the library's."""
    areal_density: Annotated[Quantity, Of("kg/m**2")] | None = None
    """Mass of the yarns per area. For gravity and exports (docs/exports.md)."""
    thickness: Annotated[Quantity, Of("m", example="0.5 mm")] | None = None
    """Of the cloth at rest. For contact, exports and scene.png."""
    fibre_density: Annotated[Quantity, Of("kg/m**3")] | None = None
    """Of what the yarns consist of. For exports."""
    out_of_plane_twisting: Annotated[Number, Field(ge=0.0, le=10.0)] | None = None
    """How hard the cloth twists out of its plane: 1 like a sheet that bends alike in all
    directions; 0, the default, freely, which bends half as hard at 45 degrees to its yarns as along
    them (docs/laws.md). Example: `1.0`"""
    weave: Annotated[str, AfterValidator(_woven)] | None = None
    """How the yarns cross, for scene.png. The default is plain, or the library's. "plain", "twill
    2/2" (warps over 2 wefts and under 2), "satin 5" (5 harnesses). Example: `"twill 2/2"`"""

    @field_validator("use")
    @classmethod
    def _is_published(cls, use: str | None) -> str | None:
        try:
            return use if use is None or _published(use) else None
        except InputError as error:
            raise ValueError(f": {error}") from None

    @model_validator(mode="after")
    def _one_way(self) -> FabricTable:
        missing = [key for key in ("warp", "weft", "shear") if getattr(self, key) is None]
        given = [key for key in ("warp", "weft") if key not in missing]
        if self.use is not None and given:
            raise ValueError(
                f"needs either use or warp, weft and shear, not use and {' and '.join(given)} "
                "(beside use only shear, shear_viscosity, shear_friction, tension, "
                "out_of_plane_bending, areal_density, thickness, fibre_density, "
                "out_of_plane_twisting and weave may stand)"
            )
        if self.use is not None and self.from_datasheet is not None:
            raise ValueError("needs either use or from_datasheet, not both")
        if self.use is None and self.from_datasheet is None and missing:
            raise ValueError(
                f"needs use, from_datasheet, or warp, weft and shear ({' and '.join(missing)} "
                "missing)"
            )
        return self

    def filled_in(self) -> list[str]:
        """What was left out and is assumed or estimated, in sentences."""
        biaxial = None if self.tension is None else self.tension.biaxial
        told = [] if biaxial is None else biaxial.told(*self._yarns())
        return [*told, *self._filled_in()]

    def _yarns(self) -> tuple[float, float]:
        """Yarns per length of warp and weft, 1/m."""
        if self.use is not None:
            return _published(self.use)._yarns()
        sides = self if self.from_datasheet is None else self.from_datasheet
        return sides.warp.yarns.si, sides.weft.yarns.si  # type: ignore[union-attr]

    def _filled_in(self) -> list[str]:
        if self.use is not None:
            given = self._given("use")
            entry, replaced = _published(self.use), {*given}
            if self.tension is not None and self.tension.biaxial is not None:
                replaced |= {"modulus", "poisson"}
            return [
                *(f"{key}: assumed, {why}" for key, why in entry.assumed.items()
                  if key.split(" ")[0].rpartition(".")[2] not in replaced),
                *entry.model_copy(update=given)._filled_in(),
            ]  # fmt: skip
        if self.from_datasheet is not None:
            table, sentences = self._with_estimates()
            return [*sentences, *table._filled_in()]
        yarns = {"warp": self.warp, "weft": self.weft}
        left_out = [side for side, table in yarns.items() if table and table.poisson is None]
        if not left_out or (self.tension is not None and self.tension.biaxial is not None):
            return []
        if len(left_out) == 2:
            return ["fabric.warp.poisson and fabric.weft.poisson are taken as 0"]
        value = getattr(self.build(""), left_out[0]).poisson
        return [f"fabric.{left_out[0]}.poisson is taken as {value:.6g}, by reciprocity"]

    def questions(self) -> list[str]:
        """What may be meant otherwise."""
        asked = [] if self.shear is None else [self.shear.question()]
        if self.tension is not None and self.tension.biaxial is not None:
            asked.append(self.tension.biaxial.question(*self._yarns()))
        if self.from_datasheet is not None and self.areal_density is not None:
            mass = self._estimate(self.from_datasheet).cloth["areal_density"]
            asked.append(contradiction(mass, self.areal_density.si))
        return [question for question in asked if question]

    def _given(self, *but: str) -> dict[str, Any]:
        """Keys that are there."""
        values = {key: getattr(self, key) for key in FabricTable.model_fields if key not in but}
        return {key: value for key, value in values.items() if value is not None}

    def _estimate(self, sheet: DatasheetTable) -> Estimate:
        thickness = None if self.thickness is None else self.thickness.si
        return sheet.estimate(Weave.named(self.weave or "plain"), thickness)

    def _with_estimates(self) -> tuple[FabricTable, list[str]]:
        """The same without the data sheet; and what of it is estimated or assumed, in sentences."""
        sheet, given = self.from_datasheet, self._given("from_datasheet")
        assert sheet is not None
        estimate = self._estimate(sheet)
        told: dict[str, dict[str, float]] = {}
        coupled = self.tension is not None and self.tension.biaxial is not None

        def fill_in(table: dict[str, Any], place: str, key: str, value: float) -> None:
            told.setdefault(key, {})[place] = value
            try:
                table[key] = Quantity.read(float(value), HOW[key][0], bare=True)
            except ValueError as error:
                raise InputError(
                    f"fabric.from_datasheet: the estimate of {place} {error}"
                ) from None

        for side in ("warp", "weft"):
            changes = given.get(side) or YarnChanges()
            own = {key: value for key, value in changes if value is not None}
            given[side] = own | {"yarns": getattr(sheet, side).yarns}
            if getattr(sheet, side).crimp is None:
                told.setdefault("crimp", {})[f"fabric.from_datasheet.{side}.crimp"] = (
                    estimate.crimp[side]
                )
            for key, value in estimate.sides[side].items():
                of_all = key == "out_of_plane_bending" and key in given
                of_all |= coupled and key in ("modulus", "poisson")
                if not of_all and not {key, _INSTEAD.get(key)} & own.keys():
                    fill_in(given[side], f"fabric.{side}.{key}", key, value)
        for key, value in estimate.cloth.items():
            if key not in given:
                fill_in(given, f"fabric.{key}", key, value)
        if "shear" not in given:
            given["shear"] = {"modulus": Quantity.read(SHEAR, "N/m/rad", bare=True)}
            told["shear"] = {"fabric.shear.modulus": SHEAR}
        if "tension" not in given:
            given["tension"] = {"compression": COMPRESSION}
            told["compression"] = {"fabric.tension.compression": COMPRESSION}
        told.pop("fibre_density", None)
        sentences = [sentence(key, values) for key, values in told.items()]
        return FabricTable.from_data(given, "fabric"), sentences

    def build(self, name: str) -> Fabric:
        """Make the fabric; one of the library keeps its name, with what is replaced."""
        source = getattr(self, "source", "")
        if self.from_datasheet is not None:
            return replace(self._with_estimates()[0].build(name), source=source)
        given = self._given("use")
        if self.use is not None:
            replaced = f", {' and '.join(given)} replaced" if given else ""
            return _published(self.use).model_copy(update=given).build(self.use + replaced)
        (warp, warp_law), (weft, weft_law) = given["warp"].build(), given["weft"].build()
        if self.out_of_plane_bending is not None:
            bend = self.out_of_plane_bending
            warp, weft = (
                replace(side, out_of_plane_bending=_per_width(bend, side.yarns))
                for side in (warp, weft)
            )
        if given["warp"].poisson is None:
            warp = replace(warp, poisson=weft.poisson * warp.modulus / weft.modulus)
        elif given["weft"].poisson is None:
            weft = replace(weft, poisson=warp.poisson * weft.modulus / warp.modulus)
        shear, tension = given["shear"].build(), self.tension or TensionTable()
        fabric = Fabric(
            name,
            warp,
            weft,
            shear_modulus=shear.stiffness0,
            source=source,
            shear_law=None if shear.name == "linear" else shear,
            warp_law=warp_law,
            weft_law=weft_law,
            log_strain=tension.strain == "log",
            compression=tension.compression,
            compression_width=tension.compression_width,
            shear_viscosity=None if self.shear_viscosity is None else self.shear_viscosity.build(),
            shear_friction=None if self.shear_friction is None else self.shear_friction.build(),
            **{key: given[key].si for key in _PLY_DATA if key in given},
            out_of_plane_twisting=self.out_of_plane_twisting or 0.0,
            weave=self.weave or "plain",
        )
        if tension.biaxial is None:
            return fabric
        return fabric.with_biaxial_law(tension.biaxial.law(warp.yarns, weft.yarns))


class LibraryTable(FabricTable):
    """A fabric of fabrics.toml."""

    source: str = ""
    """Where its values come from."""
    notes: str = ""
    """What was published, in words."""
    assumed: dict[str, str] = Field(default={})
    """What was not and is assumed, by place: "fabric.warp.modulus and fabric.weft.modulus"."""


@lru_cache(maxsize=1)
def library() -> dict[str, LibraryTable]:
    """The fabrics of the library, by name."""
    text = (files("cruciform_petsc.cloth") / "fabrics.toml").read_text(encoding="utf-8")
    entries = tomllib.loads(text).items()
    return {name: LibraryTable.from_data(entry, f'"{name}"') for name, entry in entries}


def _published(name: str) -> LibraryTable:
    if name not in library():
        raise unknown(f'fabric "{name}" in the library', name, library())
    return library()[name]


def fabric_names() -> list[str]:
    """Names of the fabrics in the library."""
    return list(library())
