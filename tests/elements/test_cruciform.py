# SPDX-License-Identifier: MIT
"""Kernels of finite deformation: a slow energy, differences, rigid motions, the membrane."""

from dataclasses import replace
from math import acos, log, sqrt

import numpy as np
import pytest
from support.biaxial import COARSE, WIDE
from support.kernels import DEGREE, is_gradient, rotation

from cruciform_petsc import laws
from cruciform_petsc.elements import cruciform as kernels
from cruciform_petsc.elements.cruciform import Cloth
from cruciform_petsc.elements.level import ENERGY, FORCE
from cruciform_petsc.net.lattice import ARM_STEP, HELD
from cruciform_petsc.tension import BiaxialLaw

SIGN = (1, -1, 1, -1)
PAIRS = ((0, 1), (2, 1), (2, 3), (0, 3))  # warp arm, weft arm: quadrants, anticlockwise

# N/m; coefficients of the two published laws with their sizes, tables with a lock.
SHEAR = {
    "linear": laws.linear(96.0),
    "polynomial": laws.odd_polynomial([37.0, 300.0, -20.0]),
    "sin-potential": laws.sin_powers([18.5, 46.4, -21.3]),
    "table": laws.table(np.array([5, 20, 35, 70, 89]) * DEGREE, [3, 10, 50, 300, 900]),
    "beyond the table": laws.table(np.array([0.5, 1.0, 1.5]) * DEGREE, [3, 5, 50]),
}
ENGINEERING = Cloth(
    laws.linear(70e3).packed, laws.linear(30e3).packed, SHEAR["linear"].packed, 12e3
)
TABLES = replace(
    ENGINEERING,
    warp=laws.table([0.05, 0.1, 0.3, 0.6], [2e3, 6e3, 30e3, 90e3]).packed,
    weft=laws.table([0.01, 0.03], [400, 700]).packed,  # these states go far beyond it
    c12=0.0,
)
CRIMP, SURFACE = COARSE.law, WIDE  # these states go beyond it on both sides
NONE = laws.linear(0.0).packed
BIAXIAL = replace(ENGINEERING, warp=NONE, weft=NONE, c12=0.0)
CLOTHS = {
    **{f"shear {name}": replace(ENGINEERING, shear=law.packed) for name, law in SHEAR.items()},
    "log": replace(ENGINEERING, log_strain=True),
    "tension tables": TABLES,
    "tension tables, log": replace(TABLES, log_strain=True),
    # Wide enough for differences to resolve the change, and as narrow as in use.
    "softening": replace(ENGINEERING, compression=0.01, compression_width=0.1),
    "narrow softening": replace(ENGINEERING, compression=0.05),
    "softening, log, tables": replace(
        TABLES, log_strain=True, compression=0.1, compression_width=0.05
    ),
    "crimp": replace(BIAXIAL, biaxial=CRIMP.packed),
    "crimp, softening": replace(
        BIAXIAL, biaxial=CRIMP.packed, compression=0.1, compression_width=0.1
    ),
    "surface": replace(BIAXIAL, biaxial=SURFACE.packed),
    "surface, softening, log": replace(
        BIAXIAL, biaxial=SURFACE.packed, log_strain=True, compression=0.1, compression_width=0.1
    ),
}
EVERY_CLOTH = pytest.mark.parametrize("cloth", CLOTHS.values(), ids=CLOTHS)
DIMENSIONS = pytest.mark.parametrize("dim", [2, 3])


class States:
    """Random cruciforms far from rest: arms turned by up to 35 degrees, stretched 0.7 to 1.4.

    A quarter have all arms. The others lack some: taken from the opposite arm, or held; or have a
    tail that is present and takes the direction of the other arm. Points of missing arms are NaN:
    nobody is to look at them.
    """

    def __init__(self, dim, n=40, seed=1):
        rng = np.random.default_rng(seed)
        self.dim, self.n = dim, n
        self.a = rng.uniform(0.5, 2.0, (n, 4)) * 1e-3
        self.area = rng.uniform(0.5, 2.0, (n, 4)) * 1e-6
        self.area[::7, 1] = 0.0
        self.strain_source = np.tile(np.arange(4), (n, 1))
        self.turn_source = self.strain_source.copy()
        self.held = np.zeros((n, 4, dim))
        self.x = np.zeros((n, 5, dim))
        for m in range(n):
            hinge = rng.normal(size=dim) * 1e-2
            self.x[m, 4] = hinge
            for arm in range(4):
                t = self._turned(rng, ARM_STEP[arm])
                self.x[m, arm] = hinge + self.a[m, arm] * rng.uniform(0.7, 1.4) * t
                self.held[m, arm] = self._turned(rng, ARM_STEP[arm])
            kind, arm = m % 4, int(rng.integers(4))
            other = (arm + 2) % 4
            missing = [arm] if kind in (1, 2) else []
            if kind == 1:  # a free edge
                self.strain_source[m, arm] = self.turn_source[m, arm] = other
            elif kind == 2:  # a clamp; every other time in a corner of two
                missing = [arm, (arm + 1) % 4] if m % 8 == 2 else [arm]
                for a in missing:
                    self.strain_source[m, a] = self.turn_source[m, a] = HELD
            elif kind == 3:  # a tail; every other time of a yarn whose other arm is held
                if m % 8 == 3:
                    missing = [other]
                    self.strain_source[m, other] = HELD
                    self.turn_source[m, [arm, other]] = HELD
                else:
                    self.turn_source[m, arm] = other
            for a in missing:
                self.a[m, a] = 0.0
                self.x[m, a] = np.nan

    def _turned(self, rng, step):
        angle = rng.uniform(-35, 35) * DEGREE
        if self.dim == 2:
            return rotation(angle) @ step
        return rotation(angle, rng.normal(size=3)) @ np.append(step, 0.0)

    def __call__(self, cloth, level=2, x=None, before=None, past=None, resistance=None):
        return kernels.cruciforms(
            self.x if x is None else x, self.a, self.area, cloth, level, self.strain_source,
            self.turn_source, self.held, before, past, resistance,
        )  # fmt: skip


def law_energy(data, x):
    """Energy of a law by adding up its slope, Gauss's rule on 2000 pieces of [0, x]."""
    node, weight = np.polynomial.legendre.leggauss(4)
    piece = x / 2000
    at = ((np.arange(2000)[:, None] + 0.5 + 0.5 * node) * piece).ravel()
    slope = laws.Potential(tuple(data)).evaluate(at)[1]
    return float(slope.reshape(2000, 4) @ weight @ np.full(2000, 0.5 * piece))


def biaxial_energy(cloth, i, j):
    """Energy of a biaxial law by adding up its tensions along a straight way to two strains."""
    node, weight = np.polynomial.legendre.leggauss(4)
    s = (np.arange(2000)[:, None] + 0.5 + 0.5 * node).ravel() / 2000
    law = BiaxialLaw(tuple(cloth.biaxial))
    tension = law.evaluate(s * i, s * j, cloth.compression, cloth.compression_width)[1]
    return float((tension @ [i, j]).reshape(2000, 4) @ weight @ np.full(2000, 0.00025))


def slow_energy(states, cloth):
    """Mechanics of the crossovers as they are defined, one number at a time."""
    result = np.zeros((states.n, 2))
    for m in range(states.n):
        a, hinge = states.a[m], states.x[m, 4]
        strain, direction = [0.0] * 4, [None] * 4
        for k in range(4):
            if a[k] > 0:
                arm = states.x[m, k] - hinge
                length = sqrt(sum(c * c for c in arm))
                direction[k] = arm / length
                s = log(length / a[k]) if cloth.log_strain else length / a[k] - 1
                if s < 0 and cloth.compression < 1 and not len(cloth.biaxial):
                    c, d = cloth.compression, cloth.compression_width
                    g = c * s * s / 2 + (1 - c) * (d * d * (np.expm1(s / d)) - d * s)
                    s = -sqrt(2 * g)
                strain[k] = s
        own = list(strain), list(direction)
        for k in range(4):
            if states.strain_source[m, k] != k:
                source = states.strain_source[m, k]
                strain[k] = 0.0 if source == HELD else own[0][source]
            if states.turn_source[m, k] != k:
                source = states.turn_source[m, k]
                direction[k] = states.held[m, k] if source == HELD else -own[1][source]
        for q, (i, j) in enumerate(PAIRS):
            part = states.area[m, q]
            result[m, 0] += part * (
                law_energy(cloth.warp, strain[i]) + law_energy(cloth.weft, strain[j])
                + cloth.c12 * strain[i] * strain[j]
            )  # fmt: skip
            if len(cloth.biaxial):
                result[m, 0] += part * biaxial_energy(cloth, strain[i], strain[j])
            gamma = SIGN[q] * (np.pi / 2 - acos(direction[i] @ direction[j]))
            result[m, 1] += part * law_energy(cloth.shear, gamma)
    return result


@DIMENSIONS
@EVERY_CLOTH
def test_slow_energy(cloth, dim):
    """5e-9: what adding up a law's slope loses where cubics meet, or a yarn begins to soften."""
    states = States(dim, 16)
    expected = slow_energy(states, cloth)
    assert (expected > 0).all()
    energy, force, stiffness = states(cloth, ENERGY)
    assert len(force) == len(stiffness) == 0
    np.testing.assert_allclose(energy, expected, rtol=5e-9)


@DIMENSIONS
@EVERY_CLOTH
def test_gradients(cloth, dim):
    """The issue's 1e-6. A step of 1e-9 m is 1e-6 of an arm, and a hundredth of what a yarn strains
    while it softens, where it does so narrowly: some 1e-7 is lost there, 1e-9 elsewhere.
    """
    states = States(dim)
    energy, force, stiffness = states(cloth)
    step = 1e-9
    is_gradient(lambda x: states(cloth, ENERGY, x)[0].sum(axis=1), force, states.x, step, 1e-6)
    is_gradient(lambda x: states(cloth, FORCE, x)[1], stiffness, states.x, step, 1e-6)
    # The levels agree; energies are those of the force alone, too.
    np.testing.assert_array_equal(states(cloth, FORCE)[1], force)
    np.testing.assert_array_equal(states(cloth, ENERGY)[0], energy)
    np.testing.assert_allclose(
        stiffness, stiffness.transpose(0, 3, 4, 1, 2), atol=1e-12 * abs(stiffness).max()
    )


# eta, exponent, seconds, torque of friction, elastic slip
RESISTANCES = {
    "fluid": [20.0, 1.0, 0.5, 0.0, 1.0],
    "thinning": [20.0, 0.4, 0.5, 0.0, 1.0],
    "friction": [0.0, 1.0, 0.0, 50.0, 1.5],  # some stick, some slide
    "both": [20.0, 0.7, 2.0, 50.0, 0.01],
}


@DIMENSIONS
@pytest.mark.parametrize("numbers", RESISTANCES.values(), ids=RESISTANCES)
def test_gradients_of_resistance(numbers, dim):
    """As above, with a past of each quadrant; rates from -5 to 5 rad/s."""
    states, rng = States(dim), np.random.default_rng(3)
    past, numbers = rng.uniform(-1.5, 1.5, (states.n, 4, 2)), np.array(numbers)

    def at(x, level):
        return states(ENGINEERING, level, x, None, past, numbers)

    energy, force, stiffness = at(states.x, 2)
    step = 1e-9
    is_gradient(lambda x: at(x, ENERGY)[0].sum(axis=1), force, states.x, step, 1e-6)
    is_gradient(lambda x: at(x, FORCE)[1], stiffness, states.x, step, 1e-6)
    assert (energy[:, 1] > states(ENGINEERING, ENERGY)[0][:, 1]).all()
    np.testing.assert_array_equal(energy[:, 0], states(ENGINEERING, ENERGY)[0][:, 0])


@DIMENSIONS
def test_gradients_where_softening_begins(dim):
    """Strains of a few ten-thousandths around rest, where the stiffness of a yarn changes."""
    cloth = replace(ENGINEERING, compression=0.01)
    states = States(dim)
    rng = np.random.default_rng(2)
    for m in range(states.n):
        arms = states.x[m, :4] - states.x[m, 4]
        size = np.linalg.norm(arms, axis=1, keepdims=True)
        strain = rng.uniform(-5e-4, 1e-4, (4, 1))
        # With Poisson coupling the stiffness jumps at rest; differences are not to straddle that.
        strain[abs(strain) < 1e-6] = -1e-6
        states.x[m, :4] = states.x[m, 4] + arms / size * states.a[m, :, None] * (1 + strain)
    _, force, stiffness = states(cloth)
    # The step is a thousandth of the width, 1e-4 of an arm. That cuts off 1e-7; positions of 1e-2 m
    # are rounded by 1e-18, so that 1e-6 is lost where the force is small.
    step = 1e-10
    is_gradient(lambda x: states(cloth, ENERGY, x)[0].sum(axis=1), force, states.x, step, 2e-6)
    is_gradient(lambda x: states(cloth, FORCE, x)[1], stiffness, states.x, step, 2e-6)


@DIMENSIONS
@EVERY_CLOTH
def test_foretold_tensions(cloth, dim):
    """Positions of before change the stiffness only; the same positions change nothing."""
    states = States(dim)
    energy, force, stiffness = states(cloth)
    for before, is_same in ((states.x, True), (states.x + 1e-4 * np.sin(states.x * 1e5), False)):
        told = states(cloth, before=before)
        np.testing.assert_array_equal(told[0], energy)
        np.testing.assert_array_equal(told[1], force)
        off = abs(told[2] - stiffness).max() / abs(stiffness).max()
        assert off < 1e-12 if is_same else off > 1e-3
        np.testing.assert_allclose(
            told[2], told[2].transpose(0, 3, 4, 1, 2), atol=1e-12 * abs(stiffness).max()
        )


def test_foretold_tension_of_one_arm():
    """A stiff yarn that turns by 45 degrees in one step stretches, but not as was foretold.

    It steps across itself by its length: to first order without stretch, in truth by sqrt(2) - 1.
    Foretold, nothing pulls across it; exactly, the tension over the length does.
    """
    a, area = np.full((1, 4), 1e-3), np.full((1, 4), 1e-6)
    before = np.zeros((1, 5, 2))
    before[0, :4] = 1e-3 * ARM_STEP
    x = before.copy()
    x[0, 0, 1] = 1e-3
    cloth = replace(ENGINEERING, c12=0.0, shear=laws.linear(1e-9).packed)
    _, force, exact = kernels.cruciforms(x, a, area, cloth)
    _, _, told = kernels.cruciforms(x, a, area, cloth, before=before)
    along, across = np.array([1, 1]) / sqrt(2), np.array([-1, 1]) / sqrt(2)
    per_length = 2e-6 * 70e3 / 1e-3 / 1e-3  # two quadrants
    pull = per_length * 1e-3 * (sqrt(2) - 1)
    np.testing.assert_allclose(force[0, 0], pull * along, rtol=1e-12)
    for matrix, turning in ((exact, pull / (sqrt(2) * 1e-3)), (told, 0.0)):
        block = matrix[0, 0, :, 0]
        assert along @ block @ along == pytest.approx(per_length, rel=1e-12)
        assert across @ block @ across == pytest.approx(turning, rel=1e-9, abs=1e-9 * per_length)


@DIMENSIONS
@pytest.mark.parametrize(
    "name",
    [
        "shear linear", "log", "softening", "softening, log, tables", "crimp, softening",
        "surface, softening, log",
    ],
)  # fmt: skip
def test_foretold_stiffness(name, dim):
    """It is that of the arms' lengths as foretold, d.(x - x_0)/|d|, along where the arms point now.

    W's derivatives by the lengths are those of arms of these lengths in their directions at rest,
    where lengths and angles do not mix.
    """
    cloth = CLOTHS[name]
    rng = np.random.default_rng(8)
    n = 20
    states = States(dim, n)
    a, area = rng.uniform(1, 2, (n, 4)) * 1e-3, states.area
    step = np.zeros((4, dim))
    step[:, :2] = ARM_STEP
    x, before = np.zeros((n, 5, dim)), np.zeros((n, 5, dim))
    for place in (x, before):
        place[:, :4] = a[..., None] * (step + 0.2 * rng.normal(size=(n, 4, dim)))
    exact = kernels.cruciforms(x, a, area, cloth)[2]
    told = kernels.cruciforms(x, a, area, cloth, before=before)[2]

    def derivatives(length):
        """By lengths (n, 4) of the arms: (n, 4) and (n, 4, 4)."""
        straight = np.zeros((n, 5, dim))
        straight[:, :4] = length[..., None] * step
        _, force, stiffness = kernels.cruciforms(straight, a, area, cloth)
        first = np.einsum("nki,ki->nk", force[:, :4], step)
        return first, np.einsum("ki,nkiqj,qj->nkq", step, stiffness[:, :4, :, :4], step)

    old, now = before[:, :4] - before[:, 4:], x[:, :4] - x[:, 4:]
    unit = old / np.linalg.norm(old, axis=2, keepdims=True)
    length = np.linalg.norm(now, axis=2)
    t = now / length[..., None]
    (pull, slope), (pull_told, slope_told) = (
        derivatives(size) for size in (length, (unit * now).sum(axis=2))
    )
    across = np.einsum("nk,ij->nkij", np.ones((n, 4)), np.eye(dim)) - t[..., None] * t[..., None, :]
    expected = np.einsum("nkq,nki,nqj->nkiqj", slope_told - slope, t, t)
    for k in range(4):
        more = (pull_told - pull)[:, k] / length[:, k]
        expected[:, k, :, k] += more[:, None, None] * across[:, k]
    found = (told - exact)[:, :4, :, :4]
    np.testing.assert_allclose(found, expected, atol=1e-10 * abs(exact).max())
    # The hinge takes what is left.
    np.testing.assert_allclose(told.sum(axis=1), 0.0, atol=1e-12 * abs(told).max())


# -- motions -----------------------------------------------------------------------------------


@DIMENSIONS
@EVERY_CLOTH
def test_rigid_motions(cloth, dim):
    """Turned by any angle and shifted, clamps with it: the energy stays, forces turn along.

    1e-11: positions of 1e-2 m are rounded by 1e-16 of that, arms are 1e-3.
    """
    states = States(dim)
    energy, force, stiffness = states(cloth)
    turn = rotation(77 * DEGREE, None if dim == 2 else [1.0, -2.0, 0.5])
    x, held = states.x, states.held
    states.x = x @ turn.T + np.arange(dim) * 1e-2
    states.held = held @ turn.T
    turned = states(cloth)
    np.testing.assert_allclose(turned[0], energy, rtol=1e-10, atol=1e-11 * energy.max())
    np.testing.assert_allclose(turned[1], force @ turn.T, atol=1e-11 * abs(force).max())
    expected = np.einsum("ij,npjqk,lk->npiql", turn, stiffness, turn)
    np.testing.assert_allclose(turned[2], expected, atol=1e-11 * abs(stiffness).max())
    # Forces are in balance; so are moments where nothing is held.
    np.testing.assert_allclose(force.sum(axis=1), 0.0, atol=1e-13 * abs(force).max())
    loose = (states.turn_source != HELD).all(axis=1)
    arms = np.nan_to_num((x - x[:, 4:])[loose])
    moment = np.einsum("npi,npj->nij", arms, force[loose])
    moment = moment - moment.transpose(0, 2, 1)
    np.testing.assert_allclose(moment, 0.0, atol=1e-13 * abs(force).max() * 1e-3)


def test_flat_cruciforms_in_space():
    """In the plane z = 0 the kernel of space gives what that of the plane gives, and no force out.

    Out of it a taut net is stiff by its tension only.
    """
    flat = States(2)
    space = States(2)
    space.x = np.concatenate([flat.x, 0.0 * flat.x[..., :1]], axis=2)
    space.held = np.concatenate([flat.held, np.zeros((flat.n, 4, 1))], axis=2)
    energy, force, stiffness = flat(ENGINEERING)
    energy_3, force_3, stiffness_3 = space(ENGINEERING)
    np.testing.assert_allclose(energy_3, energy, rtol=1e-13)
    np.testing.assert_allclose(force_3[..., :2], force, atol=1e-13 * abs(force).max())
    np.testing.assert_array_equal(force_3[..., 2], 0.0)
    size = abs(stiffness).max()
    np.testing.assert_allclose(stiffness_3[:, :, :2, :, :2], stiffness, atol=1e-13 * size)
    np.testing.assert_allclose(stiffness_3[:, :, 2, :, :2], 0.0, atol=1e-13 * size)


@DIMENSIONS
def test_mirrored(dim):
    """A cruciform and its mirror image, arms 1 and 3 and the quadrants changed over."""
    rng = np.random.default_rng(5)
    n = 20
    a, area = rng.uniform(1, 2, (n, 4)), rng.uniform(1, 2, (n, 4))
    step = np.zeros((5, dim))
    step[:4, :2] = ARM_STEP
    x = step * np.append(a, np.ones((n, 1)), axis=1)[..., None] + 0.3 * rng.normal(size=(n, 5, dim))
    cloth = CLOTHS["shear sin-potential"]
    energy, force, _ = kernels.cruciforms(x, a, area, cloth)
    arms, quadrants = [2, 1, 0, 3, 4], [1, 0, 3, 2]
    image = x[:, arms].copy()
    image[..., 0] *= -1
    found, force_found, _ = kernels.cruciforms(
        image, np.ascontiguousarray(a[:, arms[:4]]), np.ascontiguousarray(area[:, quadrants]), cloth
    )
    np.testing.assert_allclose(found, energy, rtol=1e-13)
    force_found[..., 0] *= -1
    np.testing.assert_allclose(force_found[:, arms], force, atol=1e-12 * abs(force).max())


@pytest.mark.parametrize("angle", [-40.0, 10.0, 40.0])
def test_uniform_shear(angle):
    """Each quadrant alone, and all of them: the density at one and the same angle.

    Taken the wrong way round in two quadrants, a law that is not even would tell; laws are even, so
    that test_finite.py looks at the sign of the fields.
    """
    a = np.array([[1.0, 2.0, 1.5, 0.7]])
    gamma = angle * DEGREE
    warp, weft = rotation(0.3) @ [1, 0], rotation(0.3 + np.pi / 2 - gamma) @ [1, 0]
    x = np.zeros((1, 5, 2))
    for arm, t in enumerate((warp, weft, -warp, -weft)):
        x[0, arm] = a[0, arm] * t
    for name, law in SHEAR.items():
        density = law.evaluate(gamma)[0]
        for share in (*np.eye(4), np.array([0.3, 0.2, 0.4, 0.1])):
            energy, force, _ = kernels.cruciforms(x, a, share[None], CLOTHS[f"shear {name}"])
            assert energy[0, 0] == pytest.approx(0.0, abs=1e-20)
            assert energy[0, 1] == pytest.approx(density, rel=1e-12)
            # Closing the angle is resisted: the warp's end is driven back from the weft's.
            assert np.sign(force[0, 0] @ weft) * np.sign(share[[0, 3]].sum()) in (
                np.sign(angle), 0
            )  # fmt: skip


@EVERY_CLOTH
def test_affine_motion_is_the_membranes(cloth):
    """Energy is the membrane's density of stretches and angle on the area, at 40 degrees too."""
    rng = np.random.default_rng(3)
    n = 30
    a, area = rng.uniform(1, 2, (n, 4)), rng.uniform(1, 2, (n, 4))
    for gamma, warp, weft in ((0.0, 1.01, 0.99), (0.7, 1.2, 0.9), (-0.7, 0.8, 1.3)):
        t = np.array([rotation(1.0) @ [warp, 0], rotation(1.0 + np.pi / 2 - gamma) @ [weft, 0]])
        x = np.zeros((n, 5, 2))
        x[:, :4] = a[:, :, None] * (ARM_STEP @ t) + 5.0
        x[:, 4] = 5.0
        energy = kernels.cruciforms(x, a, area, cloth, ENERGY)[0]
        biaxial, soft = len(cloth.biaxial) > 0, (cloth.compression, cloth.compression_width)
        ratio = 1.0 if biaxial else soft[0]
        e = laws.effective_strains([warp, weft], cloth.log_strain, ratio, soft[1])[0]
        both = cloth.c12 * e[0] * e[1]
        if biaxial:
            both = BiaxialLaw(tuple(cloth.biaxial)).evaluate(*e, *soft)[0]
        packed = [laws.Potential(tuple(data)) for data in (cloth.warp, cloth.weft, cloth.shear)]
        w = [law.evaluate(value)[0] for law, value in zip(packed, (*e, gamma), strict=True)]
        expected = area.sum(axis=1, keepdims=True) * [[w[0] + w[1] + both, w[2]]]
        np.testing.assert_allclose(energy, expected, rtol=1e-11, atol=1e-20)


def test_at_rest():
    """No force, and the stiffness of small displacements (elements/small.py)."""
    from cruciform_petsc.elements.small import arm_rows, shear, tension

    rng = np.random.default_rng(4)
    a, area = rng.uniform(1, 2, (10, 4)), rng.uniform(1, 2, (10, 4))
    t = np.broadcast_to(ARM_STEP.astype(float), (10, 4, 2))
    strain, turn = arm_rows(a, t)
    x = np.concatenate([a[:, :, None] * t, np.zeros((10, 1, 2))], axis=1)
    moduli = dict.fromkeys(("shear linear", "log", "softening"), (70e3, 30e3, 12e3))
    moduli |= {"crimp": CRIMP.stiffness0, "surface": SURFACE.stiffness0}
    for name, (warp, weft, both) in moduli.items():
        expected = tension(strain, area, warp, weft, both) + shear(turn, area, 96.0)
        energy, force, stiffness = kernels.cruciforms(x, a, area, CLOTHS[name])
        # What rounding leaves of cubics whose knots are not at rest, of energies of 1e4.
        assert abs(energy).max() < (1e-12 if name == "surface" else 1e-20)
        assert abs(force).max() < 1e-10 * 70e3
        found = stiffness.reshape(10, 10, 10)
        np.testing.assert_allclose(found, expected, atol=1e-12 * abs(expected).max())
