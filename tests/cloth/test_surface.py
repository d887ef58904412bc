# SPDX-License-Identifier: MIT
"""The nearest convex potential to points: what it meets, what no energy has, what is refused."""

import numpy as np
import pytest
from support.biaxial import CRIMP, grid, linear_law, points_of

from cruciform_petsc import InputError
from cruciform_petsc.cloth.surface import fit_surface

LAW = CRIMP.law
GRID = grid(0.0, 0.02, 6)
RATIOS = ((1.0, 1.0), (1.0, 0.5), (0.5, 1.0), (1.0, 0.0), (0.0, 1.0))
RAYS = np.concatenate([np.linspace(0.0, 0.02, 12)[:, None] * ratio for ratio in RATIOS])
UNEVEN_GRID = 0.02 * np.array(
    [(a, b) for a in (0, 0.1, 0.2, 0.4, 0.7, 1.0) for b in (0, 0.1, 0.2, 0.4, 0.7, 1.0)]
)


@pytest.mark.parametrize(
    "strains",
    [GRID, UNEVEN_GRID, RAYS, grid(-0.001, 0.02, 7), GRID * [1.0, 0.3]],
    ids=["grid", "uneven", "rays", "-", "oblong"],
)
def test_points_of_one_energy_are_met(strains):
    """And so are its tensions between them. 3e-3: the tensions' curvature at rest, which cubics of
    these patches follow to the fourth power of their size.
    """
    surface = fit_surface(points_of(LAW, strains))
    size = np.abs(surface.points[:, 2:]).max()
    assert surface.misfit < 2e-3
    assert surface.no_potential < 2e-3
    assert surface.unmeasured < 0.2
    fine = grid(0.0, 1.0, 31) * strains.max(axis=0)
    found = surface.law.evaluate(fine[:, 0], fine[:, 1])[1]
    expected = LAW.evaluate(fine[:, 0], fine[:, 1])[1]
    assert abs(found - expected).max() < 5e-3 * size


def test_straight_lines_are_met_exactly():
    """A linear cloth with Poisson coupling: its moduli come back, and no coupling is none."""
    for moduli in ((1e5, 5e4, 3e4), (1e5, 5e4, 0.0)):
        surface = fit_surface(points_of(linear_law(*moduli), GRID))
        assert surface.misfit < 1e-8
        assert surface.law.stiffness0 == pytest.approx(moduli, rel=1e-7, abs=1e-3)


def test_monotone_and_convex():
    """Between and beyond the points, with a bend as sharp as the points allow."""
    e = grid(0.0, 0.02, 9)
    tension = 1e3 * np.maximum(e - 0.01, 0.0) / 0.01 + 10.0 * e / 0.01  # straight, then steep
    surface = fit_surface(np.column_stack([e, tension]))
    fine = grid(-0.004, 0.024, 60)
    _, found, stiffness = surface.law.evaluate(fine[:, 0], fine[:, 1])
    assert stiffness[:, :2].min() > 0.0
    # Between the places that are looked at a sharp bend may be a little less than convex.
    least = surface.law.least_stiffness(fine[:, 0], fine[:, 1])
    assert least.min() > -1e-3 * stiffness.max()
    assert (np.diff(found[:, 0].reshape(60, 60), axis=0) > 0.0).all()
    assert surface.misfit < 0.02


def test_scatter_is_smoothed():
    """Measured with errors of 3 %, it is nearer to the truth than what was measured."""
    for seed, strains in ((0, RAYS), (1, GRID), (2, grid(0.0, 0.02, 10))):
        points = points_of(LAW, strains)
        rng = np.random.default_rng(seed)
        truth, error = points[:, 2:].copy(), 0.03 * rng.normal(size=(len(points), 2))
        points[:, 2:] *= 1.0 + error
        surface = fit_surface(points)
        off = [np.sqrt(np.mean((t - truth) ** 2)) for t in (surface.fitted, points[:, 2:])]
        assert off[0] < 0.9 * off[1]
        assert 0.003 < surface.misfit < 0.04


def test_tensions_without_an_energy():
    """dT_w/de_e = 1e4, dT_e/de_w = 5e4: how far that is, and what is used is their mean."""
    e = grid(0.0, 0.02, 8)
    surface = fit_surface(np.column_stack([e, e @ [[1e5, 5e4], [1e4, 5e4]]]))
    # A field (e_e, -e_w) of 2e4 has no energy at all; 9.8 % of the tensions' RMS.
    curl = np.sqrt(np.mean((2e4 * e) ** 2) / np.mean(surface.points[:, 2:] ** 2))
    assert 0.5 * curl < surface.no_potential < 1.05 * curl
    middle = surface.law.evaluate(0.01, 0.01)[2][2]
    assert middle == pytest.approx(3e4, rel=0.05)


def test_per_yarn_is_not_per_width():
    """Of forces per yarn only those times the yarns per width have an energy."""
    points = points_of(LAW, GRID)
    points[:, 2] *= 3.0  # another count in the warp
    assert fit_surface(points).misfit > 0.05


def test_not_convex():
    """Coupled more than stiff, T = [[1, 2], [2, 1]] e: the energy is met, a convex one is not."""
    e = GRID
    surface = fit_surface(np.column_stack([e, e @ [[1e4, 2e4], [2e4, 1e4]]]))
    assert surface.no_potential < 1e-6
    assert surface.misfit > 0.02
    fine = grid(0.0, 0.02, 40)
    assert surface.law.least_stiffness(fine[:, 0], fine[:, 1]).min() > 0.0


def test_unmeasured():
    """Points on two lines close to each other leave most of the square unknown."""
    line = np.linspace(0.0, 0.02, 10)[:, None]
    surface = fit_surface(points_of(LAW, np.concatenate([line * (1.0, 0.9), line * (0.9, 1.0)])))
    assert surface.unmeasured > 0.3


BAD = {
    "needs at least 6 points of four numbers": lambda p: p[:5],
    "needs finite numbers, those of point 3 are not": lambda p: np.where(
        np.arange(36)[:, None] == 2, np.nan, p
    ),
    "needs several strains of the weft, all points have 0 %": lambda p: p * [1, 0, 1, 1],
    "needs points at which the warp pulls": lambda p: p * [1, 1, 0, 1],
    "all points have weft strain = 0.5 warp strain": lambda p: p[:, [0, 0, 2, 3]] * [1, 0.5, 1, 1],
    "the tension of the weft must rise with its own strain, and falls from point 2 to point 3 "
    "while the other strain stays": lambda p: np.where(
        (np.arange(36)[:, None] == 2) & (np.arange(4) == 3), -1e3, p
    ),
}  # fmt: skip


@pytest.mark.parametrize("message", BAD)
def test_bad_points(message):
    """Each in a sentence."""
    points = BAD[message](points_of(LAW, GRID))
    with pytest.raises(InputError) as caught:
        fit_surface(points)
    assert message in str(caught.value)
