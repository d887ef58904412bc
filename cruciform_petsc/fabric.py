# SPDX-License-Identifier: MIT
"""What the cloth is: moduli, yarn counts, yarn bending; a small library of published fabrics.

Stress is force per unit width [N/m]. Which Poisson's ratio is which follows the paper's [1]:
nu_w is the warp's, it contracts the weft when the warp is pulled,

    eps_w = sigma_w / E_w - nu_e sigma_e / E_e
    eps_e = sigma_e / E_e - nu_w sigma_w / E_w
"""

from __future__ import annotations

import math
import tomllib
from collections.abc import Mapping
from dataclasses import dataclass
from difflib import get_close_matches
from functools import lru_cache
from importlib.resources import files
from typing import Any

import numpy as np

from .errors import InputError
from .units import format_si, to_si

_RECIPROCITY = 1e-6  # relative; room for the digits people write, not for another material


@dataclass(frozen=True)
class YarnFamily:
    """One family of yarns, warp or weft.

    Attributes
    ----------
    modulus : float
        Extensional modulus of the cloth along these yarns [N/m].
    poisson : float
        Contraction of the other family per stretch of this one when only this one is pulled.
    yarns : float
        Yarns per length across them [1/m].
    yarn_bending : float
        In-plane flexural rigidity of one yarn [N m^2].
    """

    modulus: float
    poisson: float
    yarns: float
    yarn_bending: float = 0.0

    @property
    def spacing(self) -> float:
        """Distance between neighbouring yarns of the family [m]."""
        return 1.0 / self.yarns


@dataclass(frozen=True, repr=False)
class Fabric:
    """A woven cloth, linear elastic in the plane.

    Attributes
    ----------
    name : str
    warp, weft : YarnFamily
    shear_modulus : float
        G [N/m].
    source : str
        Where the values come from.

    Raises
    ------
    InputError
        Moduli or yarn counts not positive, yarn bending negative, no reciprocity,
        nu_w nu_e >= 1.
    """

    name: str
    warp: YarnFamily
    weft: YarnFamily
    shear_modulus: float
    source: str = ""

    def __post_init__(self) -> None:
        """Check that such a cloth can exist."""
        for side, family in (("warp", self.warp), ("weft", self.weft)):
            _check(f"fabric.{side}.modulus", family.modulus, "N/m")
            _check(f"fabric.{side}.yarns", family.yarns, "1/m")
            _check(f"fabric.{side}.yarn_bending", family.yarn_bending, "N*m**2", zero=True)
            if not math.isfinite(family.poisson):
                raise InputError(f"fabric.{side}.poisson must be finite, got {family.poisson}")
        _check("fabric.shear.modulus", self.shear_modulus, "N/m")
        nu_w, nu_e = self.warp.poisson, self.weft.poisson
        # Compliance [1] has an energy only if it is symmetric.
        left, right = nu_e * self.warp.modulus, nu_w * self.weft.modulus
        if abs(left - right) > _RECIPROCITY * max(abs(left), abs(right)):
            wanted = right / self.warp.modulus
            raise InputError(
                f"fabric.weft.poisson = {nu_e:g} breaks reciprocity (nu_weft E_warp must equal "
                f"nu_warp E_weft), with the other values it would have to be {wanted:.9g}"
            )
        # With reciprocity the product is a square times E_e/E_w: negative ratios (a cloth that
        # widens when pulled) are as admissible as positive ones, only the product counts.
        if nu_w * nu_e >= 1.0:
            raise InputError(
                f"fabric.warp.poisson times fabric.weft.poisson must be less than 1, "
                f"got {nu_w * nu_e:g}"
            )

    @classmethod
    def from_table(cls, name: str, table: Mapping[str, Any], key: str = "fabric") -> Fabric:
        """Make a fabric from values with units, laid out as in a case file.

        Parameters
        ----------
        name : str
        table : mapping
            ``warp`` and ``weft``, each with ``modulus, poisson, yarns`` and maybe
            ``yarn_bending``; ``shear`` with ``modulus``; maybe ``source``.
        key : str
            Where the table stands, for messages.
        """

        def entry(*path: str, default: Any = None) -> Any:
            value: Any = table
            for part in path:
                value = value.get(part, default) if isinstance(value, Mapping) else None
            if value is None:
                raise InputError(f"{key}.{'.'.join(path)} is missing")
            return value

        def number(*path: str) -> float:
            value = entry(*path)
            if isinstance(value, bool) or not isinstance(value, int | float):
                raise InputError(f"{key}.{'.'.join(path)} must be a number, got {value!r}")
            return float(value)

        def quantity(unit: str, *path: str, default: Any = None) -> float:
            return to_si(entry(*path, default=default), unit, f"{key}.{'.'.join(path)}")

        warp, weft = (
            YarnFamily(
                modulus=quantity("N/m", side, "modulus"),
                poisson=number(side, "poisson"),
                yarns=quantity("1/m", side, "yarns"),
                yarn_bending=quantity("N*m**2", side, "yarn_bending", default="0 N mm^2"),
            )
            for side in ("warp", "weft")
        )
        shear = quantity("N/m", "shear", "modulus")
        return cls(name, warp, weft, shear, source=str(table.get("source", "")))

    @classmethod
    def from_library(cls, name: str) -> Fabric:
        """Return a published fabric; `fabric_names` lists them."""
        library = _library()
        if name not in library:
            close = get_close_matches(str(name), library, 1, 0.4)
            hint = f'did you mean "{close[0]}"? ' if close else ""
            known = ", ".join(f'"{known}"' for known in library)
            raise InputError(f'there is no fabric "{name}" in the library ({hint}known: {known})')
        return cls.from_table(name, library[name])

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

    def spacing(self, family: str) -> float:
        """Distance between neighbouring yarns of "warp" or "weft" [m]."""
        if family not in ("warp", "weft"):
            raise InputError(f'a yarn family is "warp" or "weft", not "{family}"')
        yarns: YarnFamily = getattr(self, family)
        return yarns.spacing

    def off_axis_modulus(self, angle: Any) -> Any:
        """Modulus of a strip with free sides cut at an angle to the warp (Kilby 1963).

        1/E_t = cos^4 t / E_w + sin^4 t / E_e + (1/G - 2 nu_w / E_w) sin^2 t cos^2 t

        Parameters
        ----------
        angle : float or array
            Between the direction of pull and the warp [rad].

        Returns
        -------
        float or array, as `angle` [N/m]
        """
        c2, s2 = np.cos(angle) ** 2, np.sin(angle) ** 2
        mixed = 1.0 / self.shear_modulus - 2.0 * self.warp.poisson / self.warp.modulus
        return 1.0 / (c2**2 / self.warp.modulus + s2**2 / self.weft.modulus + mixed * c2 * s2)

    def __repr__(self) -> str:
        """Name and numbers with units."""

        def family(yarns: YarnFamily) -> str:
            return (
                f"({format_si(yarns.modulus, 'N/m')}, nu {yarns.poisson:g}, "
                f"{format_si(yarns.yarns, '1/m')}, yarn {format_si(yarns.yarn_bending, 'N*m**2')})"
            )

        return (
            f'Fabric("{self.name}", warp {family(self.warp)}, weft {family(self.weft)}, '
            f"shear {format_si(self.shear_modulus, 'N/m')})"
        )


def fabric_names() -> list[str]:
    """Names of the fabrics in the library."""
    return list(_library())


@lru_cache(maxsize=1)
def _library() -> dict[str, dict[str, Any]]:
    text = (files("cruciform_petsc") / "fabrics.toml").read_text(encoding="utf-8")
    return tomllib.loads(text)


def _check(key: str, value: float, unit: str, zero: bool = False) -> None:
    """Refuse what is not positive (or, with `zero`, negative) and what is not finite."""
    good = value >= 0.0 if zero else value > 0.0
    if not (good and math.isfinite(value)):
        wanted = "zero or positive" if zero else "positive"
        raise InputError(f"{key} must be {wanted} and finite, got {format_si(value, unit)}")
