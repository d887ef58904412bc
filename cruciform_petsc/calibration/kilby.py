# SPDX-License-Identifier: MIT
"""Moduli of a cloth at every angle from those of three strips, and its shear modulus.

Kilby 1963, J. Text. Inst. 54:T9, of a strip with free sides pulled at the angle a to the warp:

    1/E(a) = cos^4 a / E_w + sin^4 a / E_e + M sin^2 a cos^2 a,   M = 1/G - 2 nu_w / E_w

Three strips, along the warp, along the weft and at some angle between, give E_w, E_e and M, and so
E at all angles; G besides only with Poisson's ratio, which hardly matters where cloth shears
easily. The longer a strip is between its clamps the truer: clamped ends make it stiffer.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from ..cloth.fabric import Fabric
from ..errors import InputError
from ..units import format_si, to_si

LEAST_ANGLE = math.radians(5.0)  # from either yarn: nearer, the strip hardly shears


@dataclass(frozen=True)
class Kilby:
    """Moduli by Kilby's relation, per width, N/m.

    Attributes
    ----------
    warp, weft : float
        E_w and E_e, N/m.
    mixed : float
        M, m/N; positive or not.
    poisson : float
        nu_w, of a pull along the warp.
    """

    warp: float
    weft: float
    mixed: float
    poisson: float = 0.0

    @classmethod
    def from_strips(
        cls,
        warp: float | str,
        weft: float | str,
        between: float | str,
        angle: float | str = "45 deg",
        poisson: float = 0.0,
    ) -> Kilby:
        """From three measured moduli.

        Parameters
        ----------
        warp, weft, between : float or str
            Of strips pulled along the warp, along the weft, and at the angle: force per width over
            strain, N/m or with its unit ("520 N/cm").
        angle : float or str
            From the pull to the warp, rad or with its unit.
        poisson : float
            Of a pull along the warp; only the shear modulus depends on it.

        InputError for numbers that are not positive, an angle within 5 degrees of a yarn, Poisson's
        ratios that no cloth has, and moduli that no shear modulus explains.

        >>> found = Kilby.from_strips("520 N/cm", "520 N/cm", "3.8258737 N/cm")
        >>> round(found.shear_modulus, 4)  # N/m
        96.0
        """
        strips = {"warp": warp, "weft": weft, "third strip": between}
        told = [
            to_si(value, "N/m", f"modulus of the {n}", bare=True) for n, value in strips.items()
        ]
        for name, value in zip(strips, told, strict=True):
            if not (math.isfinite(value) and value > 0.0):
                raise InputError(f"the modulus of the {name} must be positive, got {value:g} N/m")
        one, other, modulus = told
        turned = to_si(angle, "rad", "angle of the third strip", bare=True)
        c2, s2 = math.cos(turned) ** 2, math.sin(turned) ** 2
        if c2 * s2 < 0.25 * math.sin(2.0 * LEAST_ANGLE) ** 2:
            raise InputError(
                "the third strip must be cut at least 5 deg from warp and weft, got "
                f"{format_si(turned, 'rad')}: along a yarn it does not tell of shear"
            )
        if not (math.isfinite(poisson) and poisson**2 * other < one):
            raise InputError(
                f"Poisson's ratio {poisson:g} is none of a cloth with these moduli, its square "
                f"must be below E_warp/E_weft = {one / other:.4g}"
            )
        mixed = (1.0 / modulus - c2**2 / one - s2**2 / other) / (c2 * s2)
        found = cls(one, other, mixed, float(poisson))
        if found._shear_compliance <= 0.0:
            largest = 1.0 / (c2**2 / one + s2**2 / other - 2.0 * poisson / one * c2 * s2)
            raise InputError(
                f"a strip at {format_si(turned, 'rad')} of {format_si(modulus, 'N/m')} is stiffer "
                f"than these yarns make it however little they shear ({format_si(largest, 'N/m')} "
                "at most): yarns that run from clamp to clamp, another unit, or another angle?"
            )
        return found

    @classmethod
    def of(cls, fabric: Fabric) -> Kilby:
        """That of a fabric: its moduli at rest."""
        warp, poisson = fabric.warp.modulus, fabric.warp.poisson
        mixed = 1.0 / fabric.shear_modulus - 2.0 * poisson / warp
        return cls(warp, fabric.weft.modulus, mixed, poisson)

    @property
    def _shear_compliance(self) -> float:
        return self.mixed + 2.0 * self.poisson / self.warp

    @property
    def shear_modulus(self) -> float:
        """G, N/m."""
        return 1.0 / self._shear_compliance

    def modulus(self, angle: Any) -> Any:
        """E(a), N/m, at an angle or array of angles from the pull to the warp, rad."""
        c2, s2 = np.cos(angle) ** 2, np.sin(angle) ** 2
        return 1.0 / (c2**2 / self.warp + s2**2 / self.weft + self.mixed * c2 * s2)

    def error_of_shear(self, angle: float, error: float) -> float:
        """Relative error of the shear modulus that one of the third strip's modulus makes.

        dG/G = G/(E(a) sin^2 a cos^2 a) dE/E: near 1 for a cloth that shears easily, at 45 degrees
        4 G/E(45). ``angle`` in rad; ``error`` dE/E.
        """
        share = math.sin(angle) ** 2 * math.cos(angle) ** 2
        return error * self.shear_modulus / (float(self.modulus(angle)) * share)

    def lines(self) -> list[str]:
        """What a case file's ``[fabric]`` says of it; yarns' number and bending are to be added."""
        warp, weft = format_si(self.warp, "N/m"), format_si(self.weft, "N/m")
        reverse = self.poisson * self.weft / self.warp
        return [
            f'warp  = {{ modulus = "{warp}", poisson = {self.poisson:.6g} }}',
            f'weft  = {{ modulus = "{weft}", poisson = {reverse:.6g} }}',
            f'shear = {{ modulus = "{format_si(self.shear_modulus, "N/m")}" }}',
        ]
