# SPDX-License-Identifier: MIT
"""Bending rigidity from cantilever tests: the tabulated elastica, limits, bad numbers."""

import numpy as np
import pytest

from cruciform_petsc.calibration import bending_rigidity, bending_rigidity_peirce
from cruciform_petsc.errors import InputError


@pytest.mark.parametrize(
    ("number", "deflection"), [(1, 0.30172), (2, 0.49346), (5, 0.71379), (10, 0.81061)]
)
def test_tabulated_elastica(number, deflection):
    """Mattiasson 1981: five digits of w/L, and the rigidity back from them."""
    low, high = (bending_rigidity(0.02, 0.3, 0.3 * (deflection + s)) for s in (0.6e-5, -0.6e-5))
    assert low < 0.02 * 0.3**2 / number < high


@pytest.mark.parametrize("number", [0.03, 3.0, 60.0])
def test_elastica_by_integration(number):
    """The differential equation itself, shot from the tip, whose angle to the load is found."""
    from scipy.integrate import solve_ivp
    from scipy.optimize import brentq

    def shoot(logarithm):
        """Angle at the clamp, its slope, and w/L."""

        def change(_, y):
            return [y[1], number * np.sin(y[0]), np.cos(y[0])]

        tip = np.exp(logarithm)  # nears nothing as the load grows
        return solve_ivp(change, (0, 1), [tip, 0, 0], rtol=1e-11, atol=1e-11 * tip).y[:, -1]

    largest = min(np.pi / 2, 8.0 * np.exp(-np.sqrt(number)))  # the first of its bent shapes
    tip = brentq(lambda v: shoot(v)[0] - np.pi / 2, np.log(1e-5), np.log(largest), xtol=1e-12)
    rigidity = bending_rigidity(1.0, 1.0, shoot(tip)[2])
    assert rigidity == pytest.approx(1.0 / number, rel=1e-7)


@pytest.mark.parametrize("share", [1e-6, 1e-5, 1.001e-5, 1e-4, 1e-3])
def test_small_deflections(share):
    """P L^3/(3 w); also where the formula gives way to that limit."""
    rigidity = bending_rigidity(1.0, 1.0, share)
    # The next term is of second order.
    assert rigidity == pytest.approx(1.0 / (3.0 * share), rel=1e-6 + 5 * share**2)


@pytest.mark.parametrize("share", [0.9, 0.98])
def test_large_deflections(share):
    """Straight along the load but near the clamp: w/L = 1 - (2 - sqrt 2)/sqrt(P L^2/EI)."""
    number = ((2.0 - np.sqrt(2.0)) / (1.0 - share)) ** 2
    rest = np.exp(-2.0 * np.sqrt(number))  # of the load beside the strip's free end
    rigidity = bending_rigidity(1.0, 1.0, share)
    assert rigidity == pytest.approx(1.0 / number, rel=1e-12 + 100.0 * rest)


def test_peirce():
    """The bending length is half of what hangs over at 43 degrees; q L^4/(8 w) if small."""
    # cos(21.5 deg)/tan(43 deg) = 0.998.
    angle = np.deg2rad(43.0)
    assert bending_rigidity_peirce(0.4, 0.2, angle) == pytest.approx(0.4 * 0.1**3, rel=3e-3)
    assert bending_rigidity_peirce(0.4, 0.2, 1e-4) == pytest.approx(0.4 * 0.2**3 / 8e-4, rel=1e-6)


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ((0.0, 1.0, 0.1), "load must be positive"),
        ((1.0, float("nan"), 0.1), "length must be finite"),
        ((1.0, 1.0, -0.1), "deflection must be positive"),
        ((1.0, 1.0, 0.99), "0.99 of the length does not tell the rigidity"),
        (("1 N", "10", 0.1), 'length = "10" has no unit'),
        (("1 m", "10 m", 0.1), "load"),
        ((1.0, 1.0, 1e-7), "does not tell the rigidity"),
    ],
)
def test_bad_numbers(given, message):
    with pytest.raises(InputError, match=message):
        bending_rigidity(*given)
    with pytest.raises(InputError, match="below 90 deg"):
        bending_rigidity_peirce(1.0, 1.0, 1.6)
