# SPDX-License-Identifier: MIT
"""Bending rigidity from a cantilever test, at any deflection.

The elastica: EI d2(theta)/ds2 + P cos(theta) = 0, clamped at one end, with a dead load P across its
first direction at the other. In elliptic integrals, whose values Mattiasson 1981, Int. J. Numer.
Meth. Engng 17:145, tabulated: with the slope t of the tip, p^2 = (1 + sin t)/2 and
phi_1 = arcsin(1/(p sqrt 2)),

    P L^2/EI = (K(p) - F(phi_1, p))^2
    w/L = 1 - 2 (E(p) - E(phi_1, p))/(K(p) - F(phi_1, p))

A strip that hangs by its own weight, theta being the angle of the line from its clamp to its tip,
follows Peirce 1930, J. Text. Inst. 21:T377, roughly: EI = q L^3 cos(theta/2)/(8 tan theta), with q
its weight per length.
"""

from __future__ import annotations

import math

from ..errors import InputError
from ..units import to_si

# Past this share of the length a tenth of a per cent of the deflection is a tenth of the rigidity.
LARGEST_DEFLECTION = 0.98
SMALLEST_DEFLECTION = 1e-6
STRAIGHT = 1e-5  # below, w/L is a third of P L^2/EI to second order, and the integrals lose digits


def bending_rigidity(load: float | str, length: float | str, deflection: float | str) -> float:
    """Bending rigidity EI of a strip from the deflection of its tip, N m^2.

    For the rigidity per width divide by the strip's, for that of a yarn by the number of yarns.

    Parameters
    ----------
    load : float or str
        Dead load on the tip, across the strip at rest, N or with its unit ("2 mN").
    length : float or str
        From the clamp to the load along the strip, m or with its unit.
    deflection : float or str
        Of the tip, along the load, m or with its unit; below 0.98 of the length.

    InputError for numbers that are not positive, units of something else, a deflection that is too
    small or too large to tell.

    >>> round(bending_rigidity(0.01, 0.1, 0.049346), 8)  # P L^2/EI = 2
    5e-05
    >>> round(bending_rigidity("10 mN", "10 cm", "49.346 mm"), 8)
    5e-05
    """
    from scipy.optimize import brentq

    force, along, moved = _positive(
        load=(load, "N"), length=(length, "m"), deflection=(deflection, "m")
    )
    share = moved / along
    if not SMALLEST_DEFLECTION <= share <= LARGEST_DEFLECTION:
        raise InputError(
            f"a deflection of {share:.3g} of the length does not tell the rigidity, it must be "
            f"between {SMALLEST_DEFLECTION:g} and {LARGEST_DEFLECTION:g}"
        )
    number = 3.0 * share
    if share > STRAIGHT:
        # 1 - p^2 over many decades, as the tip's direction nears that of the load.
        u = brentq(lambda v: _elastica(math.exp(-v))[1] - share, math.log(2.0), 80.0, xtol=1e-15)
        number = _elastica(math.exp(-u))[0]
    return force * along**2 / number


def bending_rigidity_peirce(weight: float | str, length: float | str, angle: float | str) -> float:
    """Bending rigidity EI of a strip that bends by its own weight, N m^2, by Peirce's formula.

    Parameters
    ----------
    weight : float or str
        Per length of the strip (mass per area x g x width), N/m or with its unit.
    length : float or str
        That hangs over, m or with its unit.
    angle : float or str
        From the horizontal down to the line from clamp to tip, rad or with its unit; 41.5 degrees
        in the usual test.

    InputError for numbers that are not positive, units of something else, 90 degrees or more.
    """
    q, along, theta = _positive(weight=(weight, "N/m"), length=(length, "m"), angle=(angle, "rad"))
    if theta >= 0.5 * math.pi:
        raise InputError("the angle of a cantilever test must be below 90 deg")
    return q * along**3 * math.cos(0.5 * theta) / (8.0 * math.tan(theta))


def _elastica(complement: float) -> tuple[float, float]:
    """P L^2/EI and w/L for 1 - p^2, at most a half."""
    from scipy.special import ellipe, ellipeinc, ellipkinc, ellipkm1

    square = 1.0 - complement
    first = math.asin(min(1.0 / math.sqrt(2.0 * square), 1.0))
    length = float(ellipkm1(complement) - ellipkinc(first, square))
    if length <= 0.0:  # no load
        return 0.0, 0.0
    across = 2.0 * float(ellipe(square) - ellipeinc(first, square))
    return length**2, 1.0 - across / length


def _positive(**given: tuple[float | str, str]) -> list[float]:
    """Quantities, each given with its SI unit, as numbers."""
    numbers = [to_si(value, unit, name, bare=True) for name, (value, unit) in given.items()]
    for name, number in zip(given, numbers, strict=True):
        if not (math.isfinite(number) and number > 0.0):
            raise InputError(f"the {name} must be positive and finite, got {number:g}")
    return numbers
