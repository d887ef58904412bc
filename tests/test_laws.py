# SPDX-License-Identifier: MIT
"""Scalar laws: each against its formula, its own derivatives, and what people may get wrong."""

import numpy as np
import pytest
from scipy.interpolate import PchipInterpolator

from cruciform_petsc.errors import InputError
from cruciform_petsc.laws import (
    Potential,
    effective_strains,
    linear,
    odd_polynomial,
    sin_powers,
    table,
)

# Shear force over angle like that of a plain weave: a stiff start, a plateau, locking.
ANGLES = np.radians([0.0, 2.0, 10.0, 25.0, 40.0, 50.0])
FORCES = np.array([0.0, 0.8, 1.0, 2.5, 12.0, 40.0])

LAWS = {
    "linear": linear(96.0),
    "polynomial": odd_polynomial([100.0, -30.0, 300.0]),
    "sin-potential": sin_powers([18.5, 46.4, -21.3]),
    "table": table(ANGLES, FORCES),
    "table of one point": table([0.4], [8.0]),
    "table of two points": table([0.1, 0.4], [8.0, 9.0]),
    "table that falls": table([0.1, 0.3, 0.6], [8.0, 9.0, 7.0]),
}


@pytest.fixture(params=list(LAWS))
def law(request) -> Potential:
    return LAWS[request.param]


def random_points(law: Potential, step: float) -> np.ndarray:
    """Angles up to 80 degrees, beyond every table's end, not within two steps of a knot."""
    x = np.random.default_rng(3).uniform(-1.4, 1.4, 400)
    n = int(law.data[1]) if law.name == "table" else 0
    knots = np.array(law.data[2 : 3 + n])
    return x[(np.abs(np.abs(x)[:, None] - knots) > 2 * step).all(axis=1)]


def test_derivatives(law):
    """w' and w'' are the derivatives of w and w', also beyond the last point of a table."""
    step = 1e-5  # error of central differences: step^2 of the third derivative, rounding 1e-11
    x = random_points(law, step)
    _, slope, curvature = law.evaluate(x)
    up, down = law.evaluate(x + step), law.evaluate(x - step)
    for exact, of in ((slope, 0), (curvature, 1)):
        difference = (up[of] - down[of]) / (2 * step)
        assert np.abs(difference - exact).max() < 1e-7 * np.abs(exact).max()


def test_even_energy_odd_force(law):
    """Shear has no preferred direction: w even, w' odd, both zero at zero."""
    x = np.linspace(0.0, 1.5, 200)
    for value, mirrored, sign in zip(law.evaluate(x), law.evaluate(-x), (1, -1, 1), strict=True):
        assert np.array_equal(value, sign * mirrored)
    assert [float(value) for value in law.evaluate(0.0)][:2] == [0.0, 0.0]


def test_shape_and_stiffness_at_rest(law):
    """Arrays keep their shape; stiffness0 is the slope of the force."""
    values = law.evaluate(np.full((2, 3), 0.2))
    assert [value.shape for value in values] == [(2, 3)] * 3
    assert law.stiffness0 == pytest.approx(law.evaluate(1e-7)[1] / 1e-7, rel=1e-5)


def test_formulas():
    """Linear, polynomial and sine powers against what the documentation writes."""
    x = np.linspace(-1.5, 1.5, 31)
    w, d, dd = LAWS["linear"].evaluate(x)
    assert np.allclose(w, 48 * x**2, rtol=1e-14)
    assert np.allclose(d, 96 * x, rtol=1e-14)
    assert np.array_equal(dd, np.full_like(x, 96.0))
    w, d, _ = LAWS["polynomial"].evaluate(x)
    assert np.allclose(d, 100 * x - 30 * x**3 + 300 * x**5, rtol=1e-13)
    assert np.allclose(w, 50 * x**2 - 7.5 * x**4 + 50 * x**6, rtol=1e-13)
    s = np.sin(x)
    w = LAWS["sin-potential"].evaluate(x)[0]
    assert np.allclose(w, 18.5 * s**2 + 46.4 * s**4 - 21.3 * s**6, rtol=1e-13)
    assert LAWS["sin-potential"].stiffness0 == 2 * 18.5
    assert LAWS["polynomial"].stiffness0 == 100.0


def test_table_is_scipys_pchip():
    """Force, slope and energy up to the last point, through the mirrored points."""
    oracle = PchipInterpolator(
        np.concatenate([-ANGLES[:0:-1], ANGLES]), np.concatenate([-FORCES[:0:-1], FORCES])
    )
    x = np.linspace(-ANGLES[-1], ANGLES[-1], 501)
    w, d, dd = LAWS["table"].evaluate(x)
    assert np.allclose(d, oracle(x), rtol=1e-12, atol=1e-12 * FORCES[-1])
    assert np.allclose(dd, oracle.derivative()(x), rtol=1e-10, atol=1e-12 * dd.max())
    energy = [oracle.integrate(0.0, value) for value in x]
    assert np.allclose(w, energy, rtol=1e-12, atol=1e-14 * w.max())


def test_table_is_monotone_through_its_points():
    """No bumps between points, and no bend at the first: what makes a table safe to shear with."""
    law = LAWS["table"]
    assert law.evaluate(ANGLES)[1] == pytest.approx(FORCES, rel=1e-13)
    assert law.evaluate(np.linspace(0.0, 1.5, 2000))[2].min() >= 0.0
    assert law.stiffness0 == pytest.approx(FORCES[1] / ANGLES[1], rel=1e-13)
    with_zero, without_zero = table(ANGLES, FORCES), table(ANGLES[1:], FORCES[1:])
    assert with_zero == without_zero


def test_table_goes_straight_on():
    """Past the last point: the tangent, force and slope without a jump."""
    law, end = LAWS["table"], ANGLES[-1]
    assert law.last_point == end
    _, force, slope = (float(value) for value in law.evaluate(end))
    w0 = float(law.evaluate(end)[0])
    over = np.array([0.1, 0.5])
    w, d, dd = law.evaluate(end + over)
    assert d == pytest.approx(force + slope * over, rel=1e-13)
    assert dd == pytest.approx([slope, slope], rel=1e-13)
    assert w == pytest.approx(w0 + force * over + 0.5 * slope * over**2, rel=1e-13)
    assert law.evaluate(end - 1e-12)[2] == pytest.approx(slope, rel=1e-9)
    assert linear(1.0).last_point == np.inf


def test_points_on_a_line_are_the_linear_law():
    """However many points: exactly the straight line, also beyond them."""
    for x in ([0.2], [0.1, 0.2], [0.05, 0.1, 0.4]):
        law = table(x, 96.0 * np.array(x))
        at = np.linspace(-1.0, 1.0, 51)
        for value, expected in zip(law.evaluate(at), LAWS["linear"].evaluate(at), strict=True):
            assert np.allclose(value, expected, rtol=1e-12, atol=1e-13)


def test_names():
    """A law tells its kind as case files write it."""
    assert [LAWS[kind].name for kind in ("linear", "polynomial", "sin-potential", "table")] == [
        "linear",
        "polynomial",
        "sin-potential",
        "table",
    ]


@pytest.mark.parametrize(
    ("x", "y", "message"),
    [
        ([], [], "a law's table needs points, all of them finite"),
        ([0.0], [0.0], "a law's table needs ascending, positive values in its first column"),
        ([0.0, 0.1, 0.1], [0, 1, 2], "a law's table needs ascending, positive values in its first"),
        ([-0.1, 0.1], [-1, 1], "a law's table needs ascending, positive values in its first"),
        ([0.0, 0.1], [0.5, 1.0], "a law's table must be zero at zero, got 0.5"),
        ([0.1, np.nan], [1.0, 2.0], "a law's table needs points, all of them finite"),
        ([0.1, 0.2], [1.0], "a law's table has 2 values in one column and 1 in the other"),
    ],
)
def test_bad_tables(x, y, message):
    """Each mistake in one sentence."""
    with pytest.raises(InputError) as caught:
        table(x, y)
    assert str(caught.value).startswith(message)


@pytest.mark.parametrize("make", [odd_polynomial, sin_powers])
@pytest.mark.parametrize("coefficients", [[], [1.0, np.inf]])
def test_bad_coefficients(make, coefficients):
    """None at all, or not finite."""
    with pytest.raises(InputError, match="at least one coefficient, all of them finite"):
        make(coefficients)


WIDTH = 1e-3


@pytest.mark.parametrize("compression", [1.0, 0.5, 0.1, 0.01, 1e-4])
def test_stiffness_in_compression(compression):
    """The energy e^2/2 has the stiffness that is asked for, everywhere, so it is never negative."""
    z = np.concatenate([np.linspace(-30, 30, 3001), [-1e-9, 0.0, 1e-9, -1.0, -1.0 - 1e-9]])
    e, e1, e2 = effective_strains(1.0 + WIDTH * z, compression=compression, width=WIDTH)
    stiffness = e1**2 + e * e2
    expected = np.where(z >= 0, 1.0, compression + (1 - compression) * np.exp(np.minimum(z, 0)))
    # 1 + strain is stored to 1e-16, a strain of 1e-3 to 1e-13
    assert np.abs(stiffness - expected).max() < 1e-11
    assert e[z >= 0] == pytest.approx(WIDTH * z[z >= 0], rel=1e-9, abs=1e-15)
    assert e1.min() >= np.sqrt(compression) * (1 - 1e-12)


@pytest.mark.parametrize("compression", [1.0, 0.1, 0.01])
@pytest.mark.parametrize("log_strain", [False, True])
def test_effective_strain_derivatives(compression, log_strain):
    """First and second derivative, on both sides of rest and of the series, by differences."""
    step = 1e-6 * WIDTH**0.5
    s = np.concatenate([np.linspace(-0.4, 0.4, 41)[::2], WIDTH * np.linspace(-9.7, 3.7, 300)])
    stretch = 1.0 + s[np.abs(s) > 2 * step]

    def at(x):
        return effective_strains(x, log_strain, compression, WIDTH)

    _, first, second = at(stretch)
    up, down = at(stretch + step), at(stretch - step)
    # Truncation: step^2/WIDTH^2 of the derivative; rounding: 1e-16/step.
    assert np.abs((up[0] - down[0]) / (2 * step) - first).max() < 1e-7
    assert np.abs((up[1] - down[1]) / (2 * step) - second).max() < 1e-6 * max(
        np.abs(second).max(), 1.0
    )


@pytest.mark.parametrize(
    "law",
    [linear(3.0), odd_polynomial([2.0, 1.0]), sin_powers([2.0, 1.0]), table([0.1, 0.3], [1, 5])],
)
def test_a_multiple_of_a_law(law):
    """Energy, force and stiffness; a table's points stay where they are."""
    x = np.linspace(-0.5, 0.5, 11)
    np.testing.assert_allclose(law.times(2.5).evaluate(x), 2.5 * np.array(law.evaluate(x)))
    assert (law.times(2.5).knots == law.knots).all()


def test_logarithmic_strain():
    """The logarithm of the stretch, exactly, where nothing softens."""
    stretch = np.array([0.5, 1.0, 2.0])
    e, first, second = effective_strains(stretch, log_strain=True)
    assert e == pytest.approx(np.log(stretch))
    assert first == pytest.approx(1 / stretch)
    assert second == pytest.approx(-1 / stretch**2)


def test_far_compression():
    """The coupling of the families, linear in e, keeps the root of the ratio."""
    _, first, _ = effective_strains([0.5], compression=0.01, width=1e-5)
    assert first == pytest.approx(0.1, rel=1e-3)
