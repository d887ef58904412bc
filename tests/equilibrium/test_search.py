# SPDX-License-Identifier: MIT
"""How far to go along a step that leads downhill."""

import numpy as np
import pytest

from cruciform_petsc.equilibrium.search import step_length


class Valley:
    """An energy along a line; counts how often it is asked for."""

    def __init__(self, energy, slope):
        self.energy, self.slope, self.tried = energy, slope, []

    def __call__(self, length):
        self.tried.append(length)
        return self.energy(length), -self.slope(length)

    def search(self, **options):
        """Step length from 0."""
        return step_length(self, self.energy(0.0), -self.slope(0.0), **options)


def parabola(minimum, height=1.0):
    """Height (t - m)^2."""
    return Valley(lambda t: height * (t - minimum) ** 2, lambda t: 2 * height * (t - minimum))


def test_newtons_step_is_taken_whole():
    """Where the first length is the minimum nothing else is tried."""
    valley = parabola(1.0)
    assert valley.search() == 1.0
    assert valley.tried == [1.0]


@pytest.mark.parametrize("minimum", [0.02, 0.2, 0.4])
def test_a_step_too_long_is_cut_to_the_minimum(minimum):
    """The cubic through both ends is the parabola; a tenth of the length at a time at most."""
    valley = parabola(minimum)
    length = valley.search()
    if minimum >= 0.1:
        assert length == pytest.approx(minimum, rel=1e-9)
        assert len(valley.tried) == 2
    assert (length - minimum) ** 2 < minimum**2
    # A tenth of the fall foreseen, 2 m t.
    assert (length - minimum) ** 2 <= minimum**2 - 0.1 * length * 2 * minimum


def test_it_does_not_rise_as_steeply_there():
    """Beyond a kink the energy may be lower than here and still lead to and fro for ever."""
    # Falls with slope 1 to t = 0.55, then rises with 0.95: lower at t = 1, but hardly flatter.
    kink = Valley(
        lambda t: 1.0 - t if t < 0.55 else 0.45 + 0.95 * (t - 0.55),
        lambda t: -1.0 if t < 0.55 else 0.95,
    )
    length = kink.search()
    assert kink.tried[0] == 1.0
    assert length < 0.6
    assert kink.search(highest=1.0) == 1.0  # where only the height counts


def test_energies_that_are_not_numbers():
    """Cut to a fifth until they are."""
    valley = Valley(lambda t: np.inf if t > 0.1 else (t - 0.05) ** 2, lambda t: 2 * (t - 0.05))
    length = valley.search()
    assert valley.tried[:3] == pytest.approx([1.0, 0.2, 0.04])
    assert length == pytest.approx(0.04)
    valley = Valley(lambda t: np.nan if t > 0.1 else -t, lambda t: -1.0)
    assert valley.search() < 0.1


def test_rounding():
    """Near equilibrium differences of energies are noise: then a flatter slope will do."""
    valley = Valley(lambda t: 1.0 + 1e-15 * t, lambda t: -1e-9 * (1 - t))
    assert valley.search(noise=1e-14) == 1.0
    assert valley.search(noise=0.0) < 1.0


def test_a_first_length():
    """Steps may be limited from the beginning."""
    valley = parabola(1.0)
    assert valley.search(first=0.25) == 0.25
    assert valley.tried == [0.25]


def test_it_ends():
    """Where the energy is never lower, or no number, it is given up next to the start."""
    assert Valley(lambda t: 1.0 + t, lambda t: -1.0).search() < 1e-4
    valley = Valley(lambda t: np.nan if t else 1.0, lambda t: -1.0)
    assert valley.search() < 1e-16
    assert len(valley.tried) == 25
