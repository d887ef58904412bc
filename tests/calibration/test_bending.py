# SPDX-License-Identifier: MIT
"""Bending rigidity from cantilever tests: the tabulated elastica, limits, bad numbers."""

import numpy as np
import pytest

from cruciform_petsc.calibration import bending_rigidity, bending_rigidity_peirce
from cruciform_petsc.calibration.bending import tip_deflection
from cruciform_petsc.errors import InputError


@pytest.mark.parametrize(
    ("number", "deflection"), [(1, 0.30172), (2, 0.49346), (5, 0.71379), (10, 0.81061)]
)
def test_tabulated_elastica(number, deflection):
    """Mattiasson 1981: five digits of w/L, and the rigidity back from them."""
    assert tip_deflection(number) == pytest.approx(deflection, abs=0.6e-5)
    # Half a unit of the fifth digit is up to 7e-5 of the load number.
    assert bending_rigidity(0.02, 0.3, 0.3 * deflection) == pytest.approx(
        0.02 * 0.3**2 / number, rel=3e-4
    )


def test_elastica_by_integration():
    """The differential equation itself, shot from the clamp."""
    from scipy.integrate import solve_ivp
    from scipy.optimize import brentq

    def shoot(curvature):
        def change(_, y):
            return [y[1], -3.0 * np.cos(y[0]), np.sin(y[0])]

        return solve_ivp(change, (0, 1), [0, curvature, 0], rtol=1e-11, atol=1e-13).y[:, -1]

    curvature = brentq(lambda k: shoot(k)[1], 0.5, 3.0, xtol=1e-13)
    assert tip_deflection(3.0) == pytest.approx(shoot(curvature)[2], rel=1e-8)


@pytest.mark.parametrize("share", [1e-6, 1e-5, 1e-3, 0.1, 0.5, 0.9, 0.98])
def test_there_and_back(share):
    """w/L to P L^2/EI to w/L, and P L^3/(3 w) where the deflection is small."""
    rigidity = bending_rigidity(1.0, 1.0, share)
    assert tip_deflection(1.0 / rigidity) == pytest.approx(share, rel=1e-6)
    if share <= 1e-3:  # the next term is of second order
        assert rigidity == pytest.approx(1.0 / (3.0 * share), rel=1e-5)


@pytest.mark.parametrize("number", [1e-5, 2500.0])
def test_limits_join(number):
    """Where the integrals give way to the limits."""
    below, above = tip_deflection(number * (1 - 1e-9)), tip_deflection(number * (1 + 1e-9))
    assert below == pytest.approx(above, rel=1e-7)


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
    with pytest.raises(InputError, match="finite and not negative"):
        tip_deflection(-1.0)
