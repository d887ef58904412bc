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
from collections.abc import Mapping
from dataclasses import dataclass, replace
from difflib import get_close_matches
from functools import lru_cache
from importlib.resources import files
from typing import Any

import numpy as np

from ..errors import InputError, shown
from ..laws import Potential, effective_strains, linear, odd_polynomial, sin_powers
from ..laws import table as table_law
from ..units import format_si, parse_unit, to_si

_RECIPROCITY = 1e-6  # relative; room for the digits people write, not for another material
_SAME_SLOPE = 1e-9  # relative; room for rounding only, the modulus is taken from the law

# The laws of case files, and the keys that each takes.
_SHEAR_LAWS = {
    "table": ("angle", "force", "points"),
    "polynomial": ("coefficients",),
    "sin-potential": ("coefficients",),
}
_TENSION_LAWS = {"table": ("strain", "force", "points")}
_STRAINS = ("engineering", "log")
# What only exports need, with its SI unit.
_PLY_DATA = {"areal_density": "kg/m**2", "thickness": "m", "fibre_density": "kg/m**3"}


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
    """A woven cloth, elastic in the plane.

    Attributes
    ----------
    name : str
    warp, weft : YarnFamily
    shear_modulus : float
        G [N/m]; with a shear law its slope at rest.
    source : str
        Where the values come from.
    shear_law : Potential, optional
        Energy per area [N/m] over the shear angle [rad]; default: linear, G.
    warp_law, weft_law : Potential, optional
        Energy per area [N/m] over the strain of the family at no strain of the other; default:
        linear, C11 and C22. The modulus is its slope at rest.
    log_strain : bool
        Strain is the logarithm of the stretch, not the stretch less 1.
    compression : float
        Stiffness of yarns in compression over that in tension.
    compression_width : float
        Strain over which the stiffness falls when a yarn goes from tension into compression.
    areal_density : float, optional
        Mass of the yarns per area of the cloth at rest [kg/m^2]; for exports (docs/exports.md).
    thickness : float, optional
        Of the cloth at rest [m]; for exports and pictures in space.
    fibre_density : float, optional
        Mass per volume of what the yarns consist of [kg/m^3]; for exports.

    Raises
    ------
    InputError
        Moduli, yarn counts, masses or thickness not positive, fibres of more volume than the cloth;
        yarn bending negative, no reciprocity, nu_w nu_e >= 1; a law with another slope at rest than
        its modulus, a tension law with Poisson's ratios; compression not in (0, 1], its width not
        positive.
    """

    name: str
    warp: YarnFamily
    weft: YarnFamily
    shear_modulus: float
    source: str = ""
    shear_law: Potential | None = None
    warp_law: Potential | None = None
    weft_law: Potential | None = None
    log_strain: bool = False
    compression: float = 1.0
    compression_width: float = 1e-4
    areal_density: float | None = None
    thickness: float | None = None
    fibre_density: float | None = None

    def __post_init__(self) -> None:
        """Check that such a cloth can exist."""
        for side in ("warp", "weft"):
            family = getattr(self, side)
            for name in ("modulus", "poisson", "yarns", "yarn_bending"):
                _check_float(f"fabric.{side}.{name}", getattr(family, name))
        _check_float("fabric.shear.modulus", self.shear_modulus)
        _check_float("fabric.tension.compression", self.compression)
        _check_float("fabric.tension.compression_width", self.compression_width)
        _check_slope("fabric.shear", self.shear_law, self.shear_modulus, "shear_modulus")
        for side, law in (("warp", self.warp_law), ("weft", self.weft_law)):
            family = getattr(self, side)
            _check_slope(f"fabric.{side}.tension", law, family.modulus, f"{side}.modulus")
            if law is not None and family.poisson != 0.0:
                raise InputError(
                    f"fabric.{side}.tension is a law, which needs fabric.{side}.poisson = 0, "
                    f"got {family.poisson:g}"
                )
        if not 0.0 < self.compression <= 1.0:
            raise InputError(
                "fabric.tension.compression must be above 0 and at most 1, "
                f"got {self.compression:g}"
            )
        if not 0.0 < self.compression_width < math.inf:
            raise InputError(
                "fabric.tension.compression_width must be positive and finite, "
                f"got {self.compression_width:g}"
            )
        for side, family in (("warp", self.warp), ("weft", self.weft)):
            _check(f"fabric.{side}.modulus", family.modulus, "N/m")
            _check(f"fabric.{side}.yarns", family.yarns, "1/m")
            _check(f"fabric.{side}.yarn_bending", family.yarn_bending, "N*m**2", zero=True)
            if not math.isfinite(family.poisson):
                raise InputError(f"fabric.{side}.poisson must be finite, got {family.poisson}")
        _check("fabric.shear.modulus", self.shear_modulus, "N/m")
        for name, unit in _PLY_DATA.items():
            if getattr(self, name) is not None:
                _check(f"fabric.{name}", getattr(self, name), unit)
        fraction = self.fibre_volume_fraction
        if self.thickness is not None and fraction is not None and fraction > 1.0:
            raise InputError(
                "fabric.areal_density over fabric.fibre_density is a layer of "
                f"{format_si(fraction * self.thickness, 'm')} without any gaps, which is more "
                f"than fabric.thickness = {format_si(self.thickness, 'm')}"
            )
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
            ``warp`` and ``weft``, each with ``modulus`` (or ``tension``, a law), ``poisson``,
            ``yarns`` and maybe ``yarn_bending``; ``shear`` with ``modulus`` or a law; maybe
            ``tension`` with ``strain, compression, compression_width``; maybe ``areal_density``,
            ``thickness``, ``fibre_density``; maybe ``source``. docs/laws.md and docs/exports.md
            show all of them. What is None counts as missing.
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
            return _plain_number(entry(*path), f"{key}.{'.'.join(path)}")

        def quantity(unit: str, *path: str, default: Any = None) -> float:
            return to_si(entry(*path, default=default), unit, f"{key}.{'.'.join(path)}")

        def family(side: str) -> tuple[YarnFamily, Potential | None]:
            given = table.get(side)
            law = None
            if isinstance(given, Mapping) and given.get("tension") is not None:
                if given.get("modulus") is not None:
                    raise InputError(f"{key}.{side} needs either modulus or tension, not both")
                law = _tension_law(given["tension"], f"{key}.{side}.tension")
            yarns = YarnFamily(
                modulus=quantity("N/m", side, "modulus") if law is None else law.stiffness0,
                poisson=number(side, "poisson"),
                yarns=quantity("1/m", side, "yarns"),
                yarn_bending=quantity("N*m**2", side, "yarn_bending", default="0 N mm^2"),
            )
            return yarns, law

        (warp, warp_law), (weft, weft_law) = family("warp"), family("weft")
        ply_data: dict[str, Any] = {
            name: quantity(unit, name)
            for name, unit in _PLY_DATA.items()
            if table.get(name) is not None
        }
        shear = _shear_law(entry("shear"), f"{key}.shear")
        return cls(
            name,
            warp,
            weft,
            shear_modulus=shear.stiffness0,
            source=str(table.get("source", "")),
            shear_law=None if shear.name == "linear" else shear,
            warp_law=warp_law,
            weft_law=weft_law,
            **_tension_options(table.get("tension"), f"{key}.tension"),
            **ply_data,
        )

    @classmethod
    def from_library(cls, name: str, changes: Mapping[str, Any] | None = None) -> Fabric:
        """Return a published fabric; `fabric_names` lists them.

        Parameters
        ----------
        name : str
        changes : mapping, optional
            What replaces the library's: ``shear`` and ``tension`` as a whole, ``areal_density``,
            ``thickness``, ``fibre_density``; as for `from_table`.

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
        library = _library()
        if name not in library:
            close = get_close_matches(str(name), library, 1, 0.4)
            hint = f'did you mean "{close[0]}"? ' if close else ""
            known = ", ".join(f'"{known}"' for known in library)
            raise InputError(f'there is no fabric "{name}" in the library ({hint}known: {known})')
        changes = dict(changes or {})
        replaced = f", {' and '.join(changes)} replaced" if changes else ""
        return cls.from_table(name + replaced, library[name] | changes)

    def with_shear_law(self, law: Potential) -> Fabric:
        """The same cloth with another law of shear; its modulus becomes the law's slope at rest."""
        return replace(self, shear_law=law, shear_modulus=law.stiffness0)

    @property
    def shear(self) -> Potential:
        """Energy per area over the shear angle, psi(gamma) [N/m over rad]."""
        return linear(self.shear_modulus) if self.shear_law is None else self.shear_law

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

    def effective_strain(self, stretch: Any) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Strain of a yarn as its law of tension takes it, and its derivatives by the stretch.

        Returns
        -------
        e, de/dstretch, d2e/dstretch2 : arrays shaped like `stretch`
        """
        return effective_strains(stretch, self.log_strain, self.compression, self.compression_width)

    def off_axis_modulus(self, angle: Any) -> Any:
        """Modulus of a strip with free sides cut at an angle to the warp.

        Kilby 1963, J. Text. Inst. 54:T9:

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
        """Name and numbers with units; which laws are not straight lines, and where tables end."""

        def modulus(value: float, law: Potential | None, unit: str = "%") -> str:
            if law is None:
                return format_si(value, "N/m")
            told = f"{format_si(value, 'N/m')} at rest by a {law.name}"
            if not math.isfinite(law.last_point):
                return told
            last = math.degrees(law.last_point) if unit == "deg" else 100.0 * law.last_point
            return f"{told} of {int(law.data[1])} points up to {last:.4g} {unit}"

        def family(yarns: YarnFamily, law: Potential | None) -> str:
            return (
                f"({modulus(yarns.modulus, law)}, nu {yarns.poisson:g}, "
                f"{format_si(yarns.yarns, '1/m')}, yarn {format_si(yarns.yarn_bending, 'N*m**2')})"
            )

        return (
            f'Fabric("{self.name}", warp {family(self.warp, self.warp_law)}, '
            f"weft {family(self.weft, self.weft_law)}, "
            f"shear {modulus(self.shear_modulus, self.shear_law, 'deg')})"
        )


def fabric_names() -> list[str]:
    """Names of the fabrics in the library."""
    return list(_library())


@lru_cache(maxsize=1)
def _library() -> dict[str, dict[str, Any]]:
    text = (files("cruciform_petsc.cloth") / "fabrics.toml").read_text(encoding="utf-8")
    return tomllib.loads(text)


def _check_float(key: str, value: Any) -> None:
    """Refuse what is no number, and whole numbers of hundreds of digits."""
    try:
        float(value)
    except (TypeError, ValueError, OverflowError):
        raise InputError(f"{key} must be a finite number") from None


def _check(key: str, value: float, unit: str, zero: bool = False) -> None:
    """Refuse what is not positive (or, with `zero`, negative) and what is not finite."""
    good = value >= 0.0 if zero else value > 0.0
    if not (good and math.isfinite(value)):
        wanted = "zero or positive" if zero else "positive"
        raise InputError(f"{key} must be {wanted} and finite, got {format_si(value, unit)}")


def _check_slope(key: str, law: Potential | None, modulus: float, name: str) -> None:
    """Refuse a law that does not resist from the start, or with another modulus beside it."""
    if law is None:
        return
    slope = law.stiffness0
    if not (slope > 0.0 and math.isfinite(slope)):
        raise InputError(
            f"{key} is a law whose slope at zero must be positive and finite, "
            f"got {format_si(slope, 'N/m')}"
        )
    if not abs(modulus - slope) <= _SAME_SLOPE * slope:
        raise InputError(
            f"fabric.{name} must be the slope of its law at zero, {format_si(slope, 'N/m')}, "
            f"got {format_si(modulus, 'N/m')}"
        )


def _shear_law(value: Any, key: str) -> Potential:
    """Read ``shear``: a modulus or a law."""
    given = _entries(value, key)
    if given.get("law") is None:
        _only(given, ("modulus",), key, "without law")
        if "modulus" not in given:
            raise InputError(f"{key} needs modulus or law")
        return linear(to_si(given["modulus"], "N/m", f"{key}.modulus"))
    if "modulus" in given:
        raise InputError(f"{key} needs either modulus or law, not both")
    law = _law_name(given, _SHEAR_LAWS, key)
    if law == "table":
        # Nobody shears cloth by more than a right angle; radians over a column of degrees do.
        return _points(given, "angle", "rad", key, 0.5 * math.pi, "deg")
    values = given["coefficients"]
    values = values if isinstance(values, list) else [values]
    coefficients = to_si(values, "N/m", f"{key}.coefficients")
    return odd_polynomial(coefficients) if law == "polynomial" else sin_powers(coefficients)


def _tension_law(value: Any, key: str) -> Potential:
    """Read ``warp.tension`` or ``weft.tension``: a law."""
    given = _entries(value, key)
    _law_name(given, _TENSION_LAWS, key)
    return _points(given, "strain", "1", key, 1.0, "%")


def _tension_options(value: Any, key: str) -> dict[str, Any]:
    """Read ``tension``: which strain, and what becomes of yarns in compression."""
    given = {} if value is None else _entries(value, key)
    _only(given, ("strain", "compression", "compression_width"), key)
    options: dict[str, Any] = {}
    if "strain" in given:
        if given["strain"] not in _STRAINS:
            raise InputError(
                f"{key}.strain must be {_either(_STRAINS)}, got {shown(given['strain'])}"
            )
        options["log_strain"] = given["strain"] == "log"
    for name in ("compression", "compression_width"):
        if name in given:
            options[name] = _plain_number(given[name], f"{key}.{name}")
    return options


def _entries(value: Any, key: str) -> dict[str, Any]:
    """Return what is given in a table; None is not."""
    if not isinstance(value, Mapping):
        raise InputError(f"{key} must be a table, got {shown(value)}")
    return {name: entry for name, entry in value.items() if entry is not None}


def _only(given: Mapping[str, Any], known: tuple[str, ...], key: str, when: str = "") -> None:
    """Refuse keys that would have no effect."""
    for name in given:
        if name not in known:
            takes = f"takes {', '.join(known)}" + (f" {when}" if when else "")
            raise InputError(f"{key} {takes}, not {name}")


def _law_name(given: Mapping[str, Any], laws: Mapping[str, tuple[str, ...]], key: str) -> str:
    """Return the law's name; its keys must be there, and no others."""
    if "law" not in given:
        raise InputError(f"{key}.law is missing")
    law = given["law"]
    if law not in laws:
        raise InputError(f"{key}.law must be {_either(tuple(laws))}, got {shown(law)}")
    _only(given, ("law", *laws[law]), key, f'with law = "{law}"')
    for name in laws[law]:
        if name not in given:
            raise InputError(f"{key}.{name} is missing")
    return law


def _either(names: tuple[str, ...]) -> str:
    quoted = [f'"{name}"' for name in names]
    return " or ".join([", ".join(quoted[:-1]), quoted[-1]]) if len(quoted) > 1 else quoted[0]


def _points(
    given: Mapping[str, Any], over: str, unit: str, key: str, most: float, meant: str
) -> Potential:
    """Read a table of points, columns ``over`` and force, with a unit for each column."""
    factors = []
    for name, si in ((over, unit), ("force", "N/m")):
        try:
            factors.append(parse_unit(given[name], si))
        except ValueError as error:
            raise InputError(f"{key}.{name} {error}") from None
    points = given["points"]
    if not isinstance(points, list | tuple) or not points:
        raise InputError(
            f"{key}.points must be a list like [[0, 0], [10, 0.01]], got {shown(points)}"
        )
    columns: list[list[float]] = [[], []]
    for i, point in enumerate(points):
        if not isinstance(point, list | tuple) or len(point) != 2:
            raise InputError(
                f"{key}.points[{i}] must be a pair like [10, 0.01], got {shown(point)}"
            )
        for j, value in enumerate(point):
            number = _plain_number(value, f"{key}.points[{i}][{j}]")
            columns[j].append(factors[j] * number)
    largest = max(columns[0])
    if largest > most * (1.0 + 1e-9):  # 90 degrees are 90 degrees
        raise InputError(
            f'{key}.points go up to {format_si(largest, unit)}, is {over} = "{meant}" meant?'
        )
    try:
        return table_law(*columns)
    except InputError as error:
        raise InputError(f"{key}.points: {error}") from None


def _plain_number(value: Any, key: str) -> float:
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise InputError(f"{key} must be a number, got {shown(value)}")
    _check_float(key, value)
    return float(value)
