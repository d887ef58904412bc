# SPDX-License-Identifier: MIT
"""Yarns that bend: a slow energy, differences, rigid motions, in the plane and in space."""

from math import atan2, tan

import numpy as np
import pytest
from support.kernels import DEGREE, is_gradient, rotation

from cruciform_petsc.elements.bend import bends
from cruciform_petsc.elements.level import ENERGY, FORCE
from cruciform_petsc.laws import linear, odd_polynomial, table


def bent(n=40, seed=6, dim=2):
    """Three points of yarns: turns up to 140 degrees, pieces of unequal lengths, not at rest."""
    rng = np.random.default_rng(seed)
    x = np.zeros((n, 3, dim))
    for m in range(n):
        first = rng.uniform(0, 2 * np.pi)
        turn = rng.uniform(-140, 140) * DEGREE
        d = [rotation(first) @ [1, 0], rotation(first + turn) @ [1, 0]]
        if dim == 3:
            any_turn = rotation(rng.uniform(0, 3), rng.normal(size=3))
            d = [any_turn @ np.append(piece, 0.0) for piece in d]
        x[m, 1] = rng.normal(size=dim)
        x[m, 0] = x[m, 1] - rng.uniform(0.5, 2) * d[0]
        x[m, 2] = x[m, 1] + rng.uniform(0.5, 2) * d[1]
    return x, rng.uniform(0.5, 2, n), rng.uniform(0.5, 2, n)


def test_bends_slow_energy():
    """B (2 tan(theta/2)/l)^2 l/2 with theta from atan2."""
    x, length, rigidity = bent()
    energy = bends(x, length, rigidity, level=ENERGY)[0]
    for m in range(len(x)):
        (x1, y1), (x2, y2) = x[m, 1] - x[m, 0], x[m, 2] - x[m, 1]
        theta = atan2(x1 * y2 - y1 * x2, x1 * x2 + y1 * y2)
        kappa = 2 * tan(theta / 2) / length[m]
        expected = 0.5 * rigidity[m] * kappa**2 * length[m]
        assert energy[m, 0] == pytest.approx(expected, rel=1e-12)


def test_bends_gradients():
    """As for cruciforms; pieces are of unit size here, so the step is 1e-5."""
    x, length, rigidity = bent()
    energy, force, stiffness = bends(x, length, rigidity)
    is_gradient(lambda y: bends(y, length, rigidity, level=ENERGY)[0][:, 0], force, x, 1e-5, 1e-6)
    is_gradient(lambda y: bends(y, length, rigidity, level=FORCE)[1], stiffness, x, 1e-5, 1e-6)
    np.testing.assert_array_equal(bends(x, length, rigidity, level=FORCE)[1], force)
    np.testing.assert_array_equal(bends(x, length, rigidity, level=ENERGY)[0], energy)


def test_bends_rigid_motions_and_mirror():
    """Nothing but the turn costs energy: not place, direction, nor stretch of the pieces."""
    x, length, rigidity = bent()
    energy, force, _ = bends(x, length, rigidity)
    turn = rotation(77 * DEGREE)
    found = bends(x @ turn.T + 3.0, length, rigidity)
    np.testing.assert_allclose(found[0], energy, rtol=1e-11)
    np.testing.assert_allclose(found[1], force @ turn.T, atol=1e-11 * abs(force).max())
    np.testing.assert_allclose(force.sum(axis=1), 0.0, atol=1e-13 * abs(force).max())
    moment = (x[..., 0] * force[..., 1] - x[..., 1] * force[..., 0]).sum(axis=1)
    np.testing.assert_allclose(moment, 0.0, atol=1e-12 * abs(force).max())
    longer = x.copy()
    longer[:, 2] = x[:, 1] + 1.7 * (x[:, 2] - x[:, 1])
    np.testing.assert_allclose(bends(longer, length, rigidity)[0], energy, rtol=1e-12)
    backwards = np.ascontiguousarray(x[:, ::-1])
    np.testing.assert_allclose(bends(backwards, length, rigidity)[0], energy, rtol=1e-12)
    mirrored = bends(x * [1, -1], length, rigidity)
    np.testing.assert_allclose(mirrored[0], energy, rtol=1e-12)
    np.testing.assert_allclose(mirrored[1] * [1, -1], force, atol=1e-12 * abs(force).max())


def test_straight_yarn_has_the_beams_stiffness():
    """At rest: B/l^3-like rows of a bar-chain, u_0 - 2 u_1 + u_2 across, nothing along."""
    x = np.array([[[0.0, 0.0], [0.5, 0.0], [1.0, 0.0]]])
    length, rigidity = np.array([0.5]), np.array([3.0])
    _, force, stiffness = bends(x, length, rigidity)
    assert abs(force).max() == 0.0
    row = np.array([1.0, -2.0, 1.0]) / 0.5  # turn of the yarn
    np.testing.assert_allclose(stiffness[0, :, 1, :, 1], np.outer(row, row) * 3.0 / 0.5, rtol=1e-14)
    assert abs(stiffness[0, :, 0]).max() == 0.0


def with_chord(x, chord):
    """The three points of each yarn and a pair of points on a crossing one; (n, 5, 3)."""
    return np.concatenate([x, np.zeros((len(x), 1, 3)), chord[:, None]], axis=1)


def bent_in_space(n=40, seed=7):
    """Turns as `bent`, chords some 60 to 120 degrees from the yarn, of any length."""
    x, length, inner = bent(n, seed, dim=3)
    rng = np.random.default_rng(seed)
    chord = np.zeros((n, 3))
    for m in range(n):
        along = x[m, 2] - x[m, 0]
        along /= np.linalg.norm(along)
        across = np.cross(along, rng.normal(size=3))
        across /= np.linalg.norm(across)
        chord[m] = rng.uniform(0.5, 2) * (across + rng.uniform(-0.5, 0.5) * along)
    return x, chord, length, inner, rng.uniform(0.5, 2, n)


def test_in_space_slow_energy():
    """The vector of curvature, parted along the normal of the yarn's mean direction and the chord.

    1e-9: for turns of 140 degrees the bisector, from which the normal is, is a third of the pieces.
    """
    x, chord, length, inner, outer = bent_in_space()
    energy = bends(with_chord(x, chord), length, inner, outer, ENERGY)[0]
    for m in range(len(x)):
        d1, d2 = x[m, 1] - x[m, 0], x[m, 2] - x[m, 1]
        cross = np.cross(d1, d2)
        theta = atan2(np.linalg.norm(cross), d1 @ d2)
        kappa = 2 * tan(theta / 2) / length[m] * cross / np.linalg.norm(cross)
        normal = np.cross(d1 + d2, chord[m])
        normal /= np.linalg.norm(normal)
        flat = kappa @ normal
        expected = (
            inner[m] * flat**2 * length[m] / 2,
            outer[m] * (kappa - flat * normal) @ (kappa - flat * normal) * length[m] / 2,
        )
        np.testing.assert_allclose(energy[m], expected, rtol=1e-9)


@pytest.mark.parametrize("pairs", [1, 2])
def test_in_space_gradients(pairs):
    """By all points, those on the crossing yarns included, 1e-6 as in the plane."""
    x, chord, length, inner, outer = bent_in_space()
    places = with_chord(x, chord)
    if pairs == 2:  # half of the chord on each of two crossing yarns, somewhere
        rng = np.random.default_rng(8)
        half = rng.normal(size=(len(x), 2, 3))
        half[:, 1] = half[:, 0] + 0.5 * chord
        places[:, 4] -= 0.5 * chord
        places = np.concatenate([places, half], axis=1)
    expected = bends(with_chord(x, chord), length, inner, outer, ENERGY)[0]
    energy, force, stiffness = bends(places, length, inner, outer)
    np.testing.assert_allclose(energy, expected, rtol=1e-12, atol=1e-12 * expected.max())
    is_gradient(
        lambda y: bends(y, length, inner, outer, ENERGY)[0].sum(axis=1), force, places, 1e-5, 1e-6
    )
    is_gradient(lambda y: bends(y, length, inner, outer, FORCE)[1], stiffness, places, 1e-5, 1e-6)
    np.testing.assert_array_equal(bends(places, length, inner, outer, FORCE)[1], force)
    np.testing.assert_array_equal(bends(places, length, inner, outer, ENERGY)[0], energy)


def test_in_space_rigid_motions():
    """Turned as a whole, and the chord made longer, nothing changes; backwards, neither."""
    x, chord, length, inner, outer = bent_in_space()
    energy, force, _ = bends(with_chord(x, chord), length, inner, outer)
    turn = rotation(77 * DEGREE, [1.0, -2.0, 0.5])
    found = bends(with_chord(x @ turn.T + 3.0, chord @ turn.T), length, inner, outer)
    np.testing.assert_allclose(found[0], energy, rtol=1e-10, atol=1e-11 * energy.max())
    np.testing.assert_allclose(found[1], force @ turn.T, atol=1e-10 * abs(force).max())
    np.testing.assert_allclose(force.sum(axis=1), 0.0, atol=1e-12 * abs(force).max())
    longer = bends(with_chord(x, 3.0 * chord), length, inner, outer)
    np.testing.assert_allclose(longer[0], energy, rtol=1e-10, atol=1e-12 * energy.max())
    backwards = np.ascontiguousarray(x[:, ::-1])
    found = bends(with_chord(backwards, chord), length, inner, outer)[0]
    np.testing.assert_allclose(found, energy, rtol=1e-10, atol=1e-12 * energy.max())


def test_in_space_of_flat_cloth():
    """In the cloth's plane it is that of the plane with that rigidity, across it with the other."""
    x, length, rigidity = bent()
    expected = bends(x, length, rigidity)
    n = len(x)
    flat = np.concatenate([x, np.zeros((n, 3, 1))], axis=2)
    along = flat[:, 2] - flat[:, 0]
    zero = np.zeros(n)
    chord = np.column_stack([-along[:, 1], along[:, 0], zero])
    energy, force, stiffness = bends(with_chord(flat, chord), length, rigidity, zero + 9.0)
    np.testing.assert_allclose(energy[:, :1], expected[0], rtol=1e-11)
    np.testing.assert_allclose(energy[:, 1], 0.0, atol=1e-12 * energy.max())
    np.testing.assert_allclose(force[:, :3, :2], expected[1], atol=1e-11 * abs(force).max())
    size = abs(expected[2]).max()
    np.testing.assert_allclose(stiffness[:, :3, :2, :3, :2], expected[2], atol=1e-11 * size)
    np.testing.assert_allclose(force[:, 3:], 0.0, atol=1e-11 * abs(force).max())
    # The crossing yarns stand on the plane in which this one bends: it bends out of the cloth.
    chord = np.column_stack([zero, zero, zero + 1.0])
    energy = bends(with_chord(flat, chord), length, zero + 9.0, rigidity, ENERGY)[0]
    np.testing.assert_allclose(energy[:, 1:], expected[0], rtol=1e-11)
    np.testing.assert_allclose(energy[:, 0], 0.0, atol=1e-12 * energy.max())


def test_straight_yarn_in_space():
    """At rest a beam's rows in both directions, each with its rigidity, and no force."""
    x = np.array([[[0.0, 0.0, 0.0], [0.5, 0.0, 0.0], [1.0, 0.0, 0.0]]])
    one = np.ones(1)
    chord = np.array([[0.2, 1.0, 0.0]])
    energy, force, stiffness = bends(with_chord(x, chord), 0.5 * one, 3 * one, 7 * one)
    assert abs(energy).max() == abs(force).max() == 0.0
    row = np.array([1.0, -2.0, 1.0]) / 0.5
    for axis, rigidity in ((1, 3.0), (2, 7.0)):
        np.testing.assert_allclose(
            stiffness[0, :3, axis, :3, axis], np.outer(row, row) * rigidity / 0.5, atol=1e-12
        )
    assert abs(stiffness[0, :, 0]).max() < 1e-12
    assert abs(stiffness[0, 3:]).max() < 1e-12


LAWS = [odd_polynomial([2.0, -0.1]), table([0.5, 2.0, 5.0], [3.0, 5.0, 6.0])]


def test_law_of_moment_slow_energy():
    """B_out/B_0 times the law's energy at the curvature out of the plane, times the length."""
    x, chord, length, inner, outer = bent_in_space()
    places, which = with_chord(x, chord), np.arange(len(x)) % 2
    plain = bends(places, length, inner, outer, ENERGY)[0]
    energy = bends(places, length, inner, outer, ENERGY, moment=LAWS, family=which)[0]
    np.testing.assert_array_equal(energy[:, 0], plain[:, 0])
    for m, law in enumerate(LAWS[i] for i in which):
        kappa = np.sqrt(2 * plain[m, 1] / outer[m] / length[m])
        expected = length[m] * outer[m] * law.evaluate(kappa)[0] / law.stiffness0
        assert energy[m, 1] == pytest.approx(expected, rel=1e-9)
    straight = bends(places, length, inner, outer, moment=[linear(7.0)], family=0 * which)
    for one, other in zip(straight, bends(places, length, inner, outer), strict=True):
        np.testing.assert_allclose(one, other, rtol=1e-9, atol=1e-9 * abs(other).max())


def test_law_of_moment_gradients():
    """Force and stiffness with a law, also of yarns that are straight."""
    x, chord, length, inner, outer = bent_in_space()
    places, which = with_chord(x, chord), np.arange(len(x)) % 2

    def at(y, level):
        return bends(y, length, inner, outer, level, moment=LAWS, family=which)

    force, stiffness = at(places, 2)[1:]
    is_gradient(lambda y: at(y, ENERGY)[0].sum(axis=1), force, places, 1e-6, 1e-6)
    is_gradient(lambda y: at(y, FORCE)[1], stiffness, places, 1e-6, 1e-5)
    places[:, 2] = 2 * places[:, 1] - places[:, 0]
    plain, law = bends(places, length, inner, outer), at(places, 2)
    np.testing.assert_allclose(law[1], plain[1], atol=1e-9)
    np.testing.assert_allclose(law[2], plain[2], atol=1e-6 * abs(plain[2]).max())
