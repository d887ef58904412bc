# SPDX-License-Identifier: MIT
"""What resists shear beside the elastic law: viscosity that temperature scales, and friction.

Viscosity is that of a fabric in a melt or a resin (Lamers 2001, "Modelling shape distortions in
composite products", the fabric-reinforced fluid): a torque per area of the rate of shear. Friction
between yarns at the crossovers makes unloading another way than loading.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Annotated

from pydantic import model_validator

from ..errors import InputError, Problems
from ..fields import Number, Of, Table
from ..units import Quantity, format_si
from .checks import number_problems

GAS = 8.31446261815324  # J/(mol K)
LEAST_EXPONENT = 0.05


@dataclass(frozen=True)
class ShearViscosity:
    """Torque per area ``viscosity`` (rate of shear)^``exponent``, the rate in rad/s.

    Raises InputError if one of the values cannot be.
    """

    viscosity: float
    """At a rate of 1 rad/s, and at ``temperature`` if that is given [N s/m]."""
    exponent: float = 1.0
    """1 for a Newtonian fluid, less for one that thins."""
    temperature: float | None = None
    """[K]"""
    activation_energy: float | None = None
    """[J/mol]; None: temperature does not matter."""

    def __post_init__(self) -> None:
        """Check that such a fluid can exist."""
        problems = Problems()
        problems += number_problems("shear_viscosity.viscosity", self.viscosity, "N*s/m")
        if not LEAST_EXPONENT <= self.exponent <= 1.0:
            problems.append(
                f"fabric.shear_viscosity.exponent must be from {LEAST_EXPONENT:g} to 1, "
                f"got {self.exponent:g}"
            )
        if (self.temperature is None) != (self.activation_energy is None):
            problems.append(
                "fabric.shear_viscosity needs both temperature and activation_energy, or neither"
            )
        problems.tell()

    def __str__(self) -> str:
        """Its values with units."""
        text = f"{format_si(self.viscosity, 'N*s/m')}, exponent {self.exponent:g}"
        if self.temperature is None or self.activation_energy is None:
            return text
        energy = format_si(self.activation_energy, "J/mol")
        return f"{text}, at {format_si(self.temperature, 'K')}, {energy}"

    def at(self, temperature: float | None) -> float:
        """Viscosity at a temperature [K], N s/m; None: at that of its measurement.

        Arrhenius: eta = eta_0 exp(E/R (1/T - 1/T_0)).
        """
        if temperature is None or self.temperature is None or self.activation_energy is None:
            return self.viscosity
        exponent = self.activation_energy / GAS * (1.0 / temperature - 1.0 / self.temperature)
        if abs(exponent) > 50.0:
            raise InputError(
                f"at {format_si(temperature, 'K')} the viscosity of the cloth's shear would be "
                f"e^{exponent:.0f} times that at {format_si(self.temperature, 'K')}: is "
                "fabric.shear_viscosity.activation_energy right?"
            )
        return self.viscosity * math.exp(exponent)


@dataclass(frozen=True)
class ShearFriction:
    """A torque per area that yarns rub by where they turn on each other.

    Raises InputError if one of the values cannot be.
    """

    torque: float
    """[N/m]"""
    slip: float = math.radians(0.5)
    """Shear by which it gives like a spring before it slides [rad]."""

    def __post_init__(self) -> None:
        """Check that such a friction can exist."""
        problems = Problems()
        problems += number_problems("shear_friction.torque", self.torque, "N/m")
        if not math.radians(1e-3) <= self.slip <= 0.5:
            got = format_si(self.slip, "rad")
            problems.append(f"fabric.shear_friction.slip must be from 0.001 to 28.6 deg, got {got}")
        problems.tell()

    def __str__(self) -> str:
        """Its values with units."""
        return f"{format_si(self.torque, 'N/m')} beyond {math.degrees(self.slip):.4g} deg"


class ViscosityTable(Table):
    """[fabric] shear_viscosity: of cloth in a melt or a resin."""

    viscosity: Annotated[Quantity, Of("N*s/m", good=lambda eta: eta > 0.0, wanted="positive")]
    """Torque per area over the rate of shear in rad/s: viscosity of the fluid times its thickness,
    and what yarns that squeeze it make of that (docs/laws.md)."""
    exponent: Number = 1.0
    """Of the rate: 1 for a Newtonian fluid, less for one that thins; the viscosity is that at 1
    rad/s then."""
    temperature: Annotated[Quantity, Of("K")] | None = None
    """At which the viscosity was measured."""
    activation_energy: Annotated[Quantity, Of("J/mol")] | None = None
    """By which other temperatures (test.temperature) scale it, after Arrhenius."""

    @model_validator(mode="after")
    def _can_be(self) -> ViscosityTable:
        _told(self.build)
        return self

    def build(self) -> ShearViscosity:
        """Make it."""
        temperature, energy = (
            None if told is None else told.si for told in (self.temperature, self.activation_energy)
        )
        return ShearViscosity(self.viscosity.si, self.exponent, temperature, energy)


class FrictionTable(Table):
    """[fabric] shear_friction: between warp and weft where they turn on each other."""

    torque: Annotated[Quantity, Of("N/m", good=lambda torque: torque > 0.0, wanted="positive")]
    """Torque per area: half the width of the loop that loading and unloading make, times cos of the
    shear angle if it is drawn as shear force per length."""
    slip: Annotated[Quantity, Of("rad")] = Quantity("0.5 deg")
    """Shear by which it gives like a spring before it slides. From 0.001 to 28.6 deg."""

    @model_validator(mode="after")
    def _can_be(self) -> FrictionTable:
        _told(self.build)
        return self

    def build(self) -> ShearFriction:
        """Make it."""
        return ShearFriction(self.torque.si, self.slip.si)


def _told(build) -> None:
    """What a dataclass says against its values, as of the table's key."""
    try:
        build()
    except InputError as error:
        sentence = str(error)
        for name in ("fabric.shear_viscosity", "fabric.shear_friction"):
            sentence = sentence.removeprefix(name)
        raise ValueError(sentence) from None
