# SPDX-License-Identifier: MIT
"""Crosses of bars: differences, rigid motions, and what diagonals have in common with a law."""

import numpy as np
import pytest
from support.kernels import DEGREE, is_gradient, rotation

from cruciform_petsc.elements.cruciform import Cloth, cruciforms
from cruciform_petsc.elements.level import ENERGY, FORCE
from cruciform_petsc.elements.truss import by_sine, crosses
from cruciform_petsc.laws import effective_strains, linear, odd_polynomial, sin_powers
from cruciform_petsc.net.lattice import QUADRANTS

LAWS = linear(3e4), odd_polynomial([2e4, 1e6]), sin_powers([18.5, 46.4, 60.0])


def strain(stretch):
    return effective_strains(stretch, True, 0.1, 1e-2)


def bent(n=30, dim=3, seed=2):
    """Crosses far from rest, bars of uneven lengths; one bar in ten is missing."""
    rng = np.random.default_rng(seed)
    length = rng.uniform(0.5, 2.0, (n, 4))
    x = np.zeros((n, 5, dim))
    x[:, [0, 2], 0], x[:, [1, 3], 1] = length[:, ::2] * [1, -1], length[:, 1::2] * [1, -1]
    x += rng.normal(scale=0.15, size=x.shape)
    gone = rng.random((n, 4)) < 0.1
    gone[:, :2] = False  # a quadrant is left
    length[gone] = 0.0
    return x, length, 0.25 * length[:, QUADRANTS].prod(axis=2)


@pytest.mark.parametrize("dim", [2, 3])
def test_gradients(dim):
    x, length, area = bent(dim=dim)

    def at(y, level=2):
        return crosses(y, length, area, *LAWS, strain, level)

    _, force, stiffness = at(x)
    is_gradient(lambda y: at(y, ENERGY)[0].sum(axis=1), force, x, 1e-6, 1e-6)
    is_gradient(lambda y: at(y, FORCE)[1], stiffness, x, 1e-6, 1e-6)
    np.testing.assert_array_equal(at(x, FORCE)[1], force)


def test_rigid_motions():
    """Neither place nor direction costs energy, and forces turn along."""
    x, length, area = bent()
    energy, force, _ = crosses(x, length, area, *LAWS, strain, FORCE)
    turn = rotation(77 * DEGREE, [1, 2, 3])
    moved = crosses(x @ turn.T + 3.0, length, area, *LAWS, strain, FORCE)
    np.testing.assert_allclose(moved[0], energy, rtol=1e-9)
    size = abs(force).max()
    np.testing.assert_allclose(moved[1], force @ turn.T, atol=1e-9 * size)
    np.testing.assert_allclose(force.sum(axis=1), 0.0, atol=1e-12 * size)


@pytest.mark.parametrize("angle", [-50.0, -10.0, 5.0, 30.0, 70.0])
def test_diagonals_have_the_energy_of_the_law(angle):
    """As a cruciform's, in a cell sheared along its yarns, at any angle and uneven pitch."""
    a, b = 0.004, 0.007
    half = 0.5 * angle * DEGREE
    warp, weft = np.array([np.cos(half), np.sin(half)]), np.array([np.sin(half), np.cos(half)])
    x = np.array([[a * warp, b * weft, -a * warp, -b * weft, [0, 0]]])
    area = np.full((1, 4), a * b / 4)
    energy = crosses(x, np.array([[a, b, a, b]]), area, *LAWS, strain)[0]
    assert energy[0, 1] == pytest.approx(a * b * LAWS[2].evaluate(angle * DEGREE)[0], rel=1e-12)
    assert energy[0, 0] < 1e-20
    laws = Cloth(LAWS[0].packed, LAWS[1].packed, LAWS[2].packed, 0.0)
    short = np.concatenate([0.5 * x[:, :4], x[:, 4:]], axis=1)
    whole = cruciforms(short, 0.5 * np.array([[a, b, a, b]]), area, laws, ENERGY)[0]
    assert energy[0, 1] == pytest.approx(whole[0, 1], rel=1e-12)


def test_springs_of_small_shear():
    """A whole diagonal, two quadrants, is a spring of G d^2/(2 a b); both give G gamma^2/2 a b."""
    a, b, g = 0.004, 0.007, 50.0
    x = np.array([[[a, 0], [0, b], [-a, 0], [0, -b], [0, 0]]], float)
    area = np.array([[a * b / 4, 0, 0, 0]])
    no = linear(0.0)
    stiffness = crosses(x, np.array([[a, b, a, b]]), area, no, no, linear(g), strain)[2][0]
    along = np.array([-a, b]) / np.hypot(a, b)
    spring = along @ stiffness[1, :, 1] @ along
    assert 2 * spring == pytest.approx(g * (a * a + b * b) / (2 * a * b), rel=1e-12)
    across = np.array([b, a]) / np.hypot(a, b)
    assert abs(across @ stiffness[1, :, 1] @ across) < 1e-12 * spring


def test_beyond_all_angles():
    """Smooth to the second derivative where the law ends, and of a number beyond right angles."""
    law = LAWS[2]
    edge = np.sin(85 * DEGREE)
    below, above = (np.array(by_sine(law, np.array([edge + d]))) for d in (-1e-9, 1e-9))
    np.testing.assert_allclose(below, above, rtol=1e-5)
    assert np.isfinite(by_sine(law, np.array([-1.5, 1.5]))).all()
