# SPDX-License-Identifier: MIT
"""Standard errors against closed forms; tables in a box."""

import numpy as np
import pytest

from cruciform_petsc.calibration.result import estimate
from cruciform_petsc.calibration.rising import RisingTable, value_changes
from cruciform_petsc.errors import InputError
from cruciform_petsc.laws import linear, odd_polynomial, table

ANGLES = np.deg2rad([2.0, 5.0, 10.0, 20.0, 35.0, 50.0])
NONE = np.zeros((0, 2))


def test_straight_line_through_points():
    """The textbook's errors of an offset and a slope: s^2 = SSR/(n - 2), s/sqrt(Sxx)."""
    rng = np.random.default_rng(3)
    x = rng.uniform(1.0, 4.0, 9)
    design = np.column_stack([np.ones(9), x])
    y = design @ [2.0, -1.0] + rng.normal(0.0, 0.3, 9)
    residuals = design @ np.linalg.lstsq(design, y, rcond=None)[0] - y
    found = estimate(residuals, design, NONE)
    s = np.sqrt((residuals**2).sum() / 7.0)
    spread = ((x - x.mean()) ** 2).sum()
    assert found.noise == pytest.approx(s, rel=1e-12)
    assert found.settled == pytest.approx(2.0, rel=1e-12)
    expected = [s * np.sqrt(1.0 / 9.0 + x.mean() ** 2 / spread), s / np.sqrt(spread)]
    np.testing.assert_allclose(found.errors, expected, rtol=1e-12)


def test_errors_are_the_scatter_of_fits():
    """Many fits of noisy data scatter as one of them says."""
    rng = np.random.default_rng(4)
    design = rng.normal(size=(12, 2))
    noise = rng.normal(0.0, 0.1, (12, 20_000))
    fits = np.linalg.lstsq(design, noise, rcond=None)[0]
    residuals = design @ fits - noise
    variances = np.mean([estimate(r, design, NONE).errors ** 2 for r in residuals.T[:5000]], axis=0)
    # Variances of 20,000 fits are known to 1 %, their mean estimate from 5000 to 0.6 %.
    np.testing.assert_allclose(variances, fits.var(axis=1), rtol=0.05)


def test_what_a_prior_settles():
    """One parameter, n equal data, one prior row b: shrinkage n/(n + b^2)."""
    found = estimate(np.full(8, 0.5), np.ones((8, 1)), np.array([[2.0]]))
    assert found.settled == pytest.approx(8.0 / 12.0)
    assert found.noise == pytest.approx(np.sqrt(8 * 0.25 / (8.0 - 8.0 / 12.0)))
    assert found.errors[0] == pytest.approx(found.noise / np.sqrt(12.0))
    assert found.singular_values[0] == pytest.approx(np.sqrt(8.0))
    assert estimate(np.zeros(8), np.ones((8, 1)), np.zeros((0, 1)), 0.01).noise == 0.01


@pytest.mark.parametrize("bounds", [(None, None), (linear(4.0), linear(12.0)), (None, linear(7.0))])
def test_tables_in_a_box(bounds):
    """Whatever the parameters in the box, the table rises within its bounds; slopes are right."""
    rising = RisingTable(ANGLES, odd_polynomial([5.0, 20.0]), bounds)
    low, high = rising.box
    assert (low <= rising.start).all()
    assert (rising.start <= high).all()
    rng = np.random.default_rng(1)
    for k in range(200):
        z = np.minimum(10.0 ** rng.uniform(-3, 2, len(ANGLES)), rng.choice([0.5, 1.0]) * high)
        z[k % 6] *= k % 2
        values, slopes = rising.values(z)
        assert (np.diff(values, prepend=0.0) > 0.0).all()
        for law, sign in zip(bounds, (1.0, -1.0), strict=True):
            if law is not None:
                limit = law.evaluate(ANGLES)[1]
                assert (sign * (values - limit) >= -1e-12 * limit).all()
        step = 1e-6
        for i, one in enumerate(step * np.eye(len(ANGLES))):
            up, down = rising.values(z + one)[0], rising.values(z - one)[0]
            kink = bounds[0] is not None  # of max(); looked at where it is not crossed
            good = np.abs((up + down) / 2 - values) < (1e-9 if kink else np.inf)
            difference = (up - down) / (2 * step)
            np.testing.assert_allclose(difference[good], slopes[good, i], rtol=1e-5, atol=1e-7)
            assert good.mean() > 0.5


def test_bounds_that_cannot_be():
    for bounds in ((linear(9.0), linear(5.0)), (table(ANGLES, 9.0 - ANGLES), linear(10.0))):
        with pytest.raises(InputError, match="no rising law lies within the bounds"):
            RisingTable(ANGLES, linear(7.0), bounds)


def test_changes_with_the_values():
    """Between the table's angles, too; linear in the values, as PCHIP is of degree one in them."""
    values = odd_polynomial([5.0, 20.0]).evaluate(ANGLES)[1]
    at = np.linspace(-1.0, 1.0, 41)
    changes = value_changes(ANGLES, values, at)
    np.testing.assert_allclose(
        values @ changes, table(ANGLES, values).evaluate(at)[1], rtol=1e-6, atol=1e-6
    )
