# SPDX-License-Identifier: MIT
"""Element matrices: energies written out slowly, rigid motions, the paper's misprints."""

import numpy as np
import pytest
from support.helpers import UNEVEN, energy_density

from cruciform_petsc.elements import printed
from cruciform_petsc.elements.small import (
    DISPLACEMENTS,
    arm_rows,
    bending,
    condense,
    normals,
    shear,
    tension,
)
from cruciform_petsc.net.lattice import HELD, QUADRANTS

C11, C22, C12, G = UNEVEN.c11, UNEVEN.c22, UNEVEN.c12, UNEVEN.shear_modulus
SCALE = 0.7  # length that rotations are stored with; unlike every arm
ALONG_YARNS = np.array([[1.0, 0.0], [0.0, 1.0], [-1.0, 0.0], [0.0, -1.0]])
ROUNDING = 1e-12  # sums of some 100 products of numbers of one size


def arms(rng, n=5, straight=False):
    """Four arm lengths and directions of n cruciforms: in order around, otherwise at random."""
    a = rng.uniform(0.2, 1.5, (n, 4))
    angle = 0.5 * np.pi * np.arange(4) + (0.0 if straight else rng.uniform(-0.6, 0.6, (n, 4)))
    angle = np.broadcast_to(angle, (n, 4))
    return a, np.stack([np.cos(angle), np.sin(angle)], axis=2)


def full_areas(a):
    """a_i a_j of each quadrant."""
    return a[:, QUADRANTS[:, 0]] * a[:, QUADRANTS[:, 1]]


def matrices(a, t, area, rigidity=None):
    """Tension, shear and (on 16 unknowns, if a rigidity is given) bending."""
    strain, rotation = arm_rows(a, t)
    parts = [tension(strain, area, C11, C22, C12), shear(rotation, area, G)]
    if rigidity is not None:
        place = np.eye(16)[DISPLACEMENTS]
        parts = [place.T @ part @ place for part in parts]
        parts.append(bending(a, t, rigidity, SCALE))
    return parts


def slow_energies(a, t, area, rigidity, x):
    """Energy of tension, shear and bending of one cruciform: mechanics written out, arm by arm.

    x has the 16 unknowns.
    """
    ends = [np.array([x[3 * k], x[3 * k + 1]]) for k in range(4)]
    end_turn = [x[3 * k + 2] / SCALE for k in range(4)]
    hinge, hinge_turn = x[12:14], [x[14] / SCALE, x[15] / SCALE]
    eps, theta = [], []
    for k in range(4):
        moved = ends[k] - hinge
        along = t[k][0] * moved[0] + t[k][1] * moved[1]
        across = -t[k][1] * moved[0] + t[k][0] * moved[1]
        eps.append(along / a[k])
        theta.append(across / a[k])
    w_tension = w_shear = w_bending = 0.0
    for q, (i, j) in enumerate([(0, 1), (2, 1), (2, 3), (0, 3)]):
        w_tension += area[q] * (
            0.5 * C11 * eps[i] ** 2 + 0.5 * C22 * eps[j] ** 2 + C12 * eps[i] * eps[j]
        )
        w_shear += area[q] * 0.5 * G * (theta[i] - theta[j]) ** 2
    for k in range(4):
        # Cubic through the deflections and slopes at both ends: its curvature is linear, so that
        # Simpson's rule integrates the square exactly.
        chord, length = theta[k], a[k]
        s0, s1 = hinge_turn[k % 2], end_turn[k]
        curvature = [
            6 * (1 - 2 * xi) * chord / length + ((6 * xi - 4) * s0 + (6 * xi - 2) * s1) / length
            for xi in (0.0, 0.5, 1.0)
        ]
        simpson = (curvature[0] ** 2 + 4 * curvature[1] ** 2 + curvature[2] ** 2) / 6
        w_bending += 0.5 * rigidity[k] * simpson * length
    return np.array([w_tension, w_shear, w_bending])


def rigid_motions(a, t, n_unknowns):
    """Two translations and the rotation of each cruciform, (n, n_unknowns, 3)."""
    place = np.concatenate([a[..., None] * t, np.zeros((len(a), 1, 2))], axis=1)  # ends, hinge
    motion = np.zeros((len(a), 10, 3))
    motion[:, 0::2, 0] = motion[:, 1::2, 1] = 1.0
    motion[:, 0::2, 2], motion[:, 1::2, 2] = -place[..., 1], place[..., 0]
    if n_unknowns == 10:
        return motion
    wide = np.zeros((len(a), 16, 3))
    wide[:, DISPLACEMENTS] = motion
    wide[:, [2, 5, 8, 11, 14, 15], 2] = SCALE
    return wide


# -- the consistent element --------------------------------------------------------------------


def test_energy_is_the_one_written_out():
    """1/2 x K x equals the slow energy of each mode, for any arms and any quadrant areas."""
    rng = np.random.default_rng(1)
    a, t = arms(rng)
    area, rigidity = rng.uniform(0.0, 1.0, (5, 4)), rng.uniform(1.0, 9.0, (5, 4))
    parts = matrices(a, t, area, rigidity)
    x = rng.normal(size=(5, 16))
    for e in range(5):
        slow = slow_energies(a[e], t[e], area[e], rigidity[e], x[e])
        fast = [0.5 * x[e] @ part[e] @ x[e] for part in parts]
        np.testing.assert_allclose(fast, slow, rtol=ROUNDING)


def test_force_and_stiffness_are_derivatives_of_the_energy():
    """Central differences of the slow energy; it is quadratic, so only rounding is left."""
    rng = np.random.default_rng(2)
    a, t = arms(rng, 1)
    area, rigidity = rng.uniform(0.1, 1.0, (1, 4)), rng.uniform(1e3, 9e4, (1, 4))
    x, h = rng.normal(size=16), 0.5

    def energy(y):
        return slow_energies(a[0], t[0], area[0], rigidity[0], y)

    step = h * np.eye(16)
    force = np.array([energy(x + s) - energy(x - s) for s in step]) / (2 * h)
    hessian = np.array(
        [
            [
                energy(x + s + r) - energy(x + s - r) - energy(x - s + r) + energy(x - s - r)
                for r in step
            ]
            for s in step
        ]
    ) / (4 * h**2)
    for mode, part in enumerate(matrices(a, t, area, rigidity)):
        size = abs(part).max()
        # Differences of energies some 100 times the result: 100 * 1e-16, and room.
        np.testing.assert_allclose(part[0] @ x, force[:, mode], atol=1e-11 * size)
        np.testing.assert_allclose(part[0], hessian[:, :, mode], atol=1e-11 * size)


@pytest.mark.parametrize("with_bending", [False, True])
def test_rigid_motions_are_free(with_bending):
    """Each mode alone, and the condensed sum, leave every rigid motion without force."""
    rng = np.random.default_rng(3)
    a, t = arms(rng, 20)
    rigidity = rng.uniform(1e3, 9e4, (20, 4)) if with_bending else None
    parts = matrices(a, t, full_areas(a), rigidity)
    total = sum(parts)
    motion, keep = rigid_motions(a, t, total.shape[1]), 4 * (3 if with_bending else 2)
    for matrix in (*parts, total, condense(total, keep)[0]):
        for k in range(3):
            force = np.einsum("nij,nj->ni", matrix, motion[:, : matrix.shape[1], k])
            assert abs(force).max() < ROUNDING * abs(matrix).max()


@pytest.mark.parametrize("with_bending", [False, True])
def test_nothing_but_rigid_motions_is_free(with_bending):
    """Symmetric, and exactly three eigenvalues are zero, before and after condensation."""
    rng = np.random.default_rng(4)
    a, t = arms(rng, 20)
    rigidity = rng.uniform(1e3, 9e4, (20, 4)) if with_bending else None
    total = sum(matrices(a, t, full_areas(a), rigidity))
    for matrix in (total, condense(total, 12 if with_bending else 8)[0]):
        np.testing.assert_allclose(
            matrix, np.swapaxes(matrix, 1, 2), atol=1e-13 * abs(matrix).max()
        )
        for values in np.linalg.eigvalsh(matrix):
            assert (abs(values[:3]) < 1e-13 * values[-1]).all()
            assert values[3] > 1e-6 * values[-1]  # G / C11 is 2e-3, arms differ by a factor of 7


def test_hinge_is_recovered():
    """Condensation: with the recovered hinge no force is left on it, and energies agree."""
    rng = np.random.default_rng(5)
    a, t = arms(rng)
    total = sum(matrices(a, t, full_areas(a), rng.uniform(1e3, 9e4, (5, 4))))
    small, recovery = condense(total, 12)
    kept = rng.normal(size=(5, 12))
    full = np.concatenate([kept, np.einsum("nij,nj->ni", recovery, kept)], axis=1)
    force = np.einsum("nij,nj->ni", total, full)
    assert abs(force[:, 12:]).max() < ROUNDING * abs(force).max()
    np.testing.assert_allclose(force[:, :12], np.einsum("nij,nj->ni", small, kept), rtol=1e-9)


def test_affine_energy_is_the_membranes():
    """Arms along the yarns, four lengths: energy density times area, and the hinge follows."""
    rng = np.random.default_rng(6)
    a, t = arms(rng, straight=True)
    whole = (a[:, 0] + a[:, 2]) * (a[:, 1] + a[:, 3])
    gradient = rng.normal(size=(2, 2))
    parts = matrices(a, t, full_areas(a))
    ends = a[..., None] * t
    u = (ends @ gradient.T).reshape(5, 8) + np.tile(rng.normal(size=2), 4)
    expected = energy_density(UNEVEN, gradient) * whole
    small, _ = condense(sum(parts), 8)
    np.testing.assert_allclose(0.5 * np.einsum("ni,nij,nj->n", u, small, u), expected, rtol=1e-12)


def test_bending_of_an_affine_motion_costs_nothing():
    """Straight yarns stay straight: each turns by its own angle."""
    rng = np.random.default_rng(7)
    a, t = arms(rng, straight=True)
    gradient = rng.normal(size=(2, 2))
    x = np.zeros((5, 16))
    x[:, DISPLACEMENTS[:8]] = (a[..., None] * t @ gradient.T).reshape(5, 8)
    x[:, [2, 8, 14]], x[:, [5, 11, 15]] = gradient[1, 0] * SCALE, -gradient[0, 1] * SCALE
    matrix = bending(a, t, np.ones((5, 4)), SCALE)
    force = np.einsum("nij,nj->ni", matrix, x)
    assert abs(force).max() < ROUNDING * abs(matrix).max()


def test_batched_is_one_at_a_time():
    """No cruciform knows of its neighbours in the arrays."""
    rng = np.random.default_rng(8)
    a, t = arms(rng)
    area, rigidity = rng.uniform(0.1, 1.0, (5, 4)), rng.uniform(1.0, 9.0, (5, 4))
    together = matrices(a, t, area, rigidity)
    for e in range(5):
        alone = matrices(a[e : e + 1], t[e : e + 1], area[e : e + 1], rigidity[e : e + 1])
        for one, all_ in zip(alone, together, strict=True):
            np.testing.assert_allclose(one[0], all_[e], rtol=1e-14, atol=1e-14 * abs(all_).max())


def test_shear_angle_has_one_sign():
    """A positive shear angle closes the angle between warp and weft, alike in all quadrants."""
    a, t = np.full((1, 4), 0.5), ALONG_YARNS[None]
    u = np.zeros((1, 5, 2))
    u[0, :4] = a[0, :, None] * ALONG_YARNS @ np.array([[0.0, 0.1], [0.2, 0.0]]).T
    _, rotation = arm_rows(a, t)
    theta = np.einsum("nkj,nj->nk", rotation, u.reshape(1, 10))
    np.testing.assert_allclose(theta, [[0.2, -0.1, 0.2, -0.1]])
    after = ALONG_YARNS[:2] + u[0, :2] / 0.5  # both moved towards each other
    assert after[0] @ after[1] > 0


def test_normals():
    """A quarter turn anticlockwise."""
    np.testing.assert_array_equal(normals(ALONG_YARNS), ALONG_YARNS[[1, 2, 3, 0]])


def test_sources_of_missing_arms():
    """A missing arm takes strain and rotation of the named arm, or has none if held."""
    a = np.array([[0.5, 0.4, 0.0, 0.0]])
    source = np.array([[0, 1, 0, HELD]])
    strain, rotation = arm_rows(a, ALONG_YARNS[None], source, source)
    for rows in (strain, rotation):
        np.testing.assert_array_equal(rows[0, 2], rows[0, 0])
        assert not rows[0, 3].any()
        assert rows[0, 0].any()
        assert rows[0, 1].any()
    plain, _ = arm_rows(a, ALONG_YARNS[None])
    assert not plain[0, 2:].any()


def test_missing_arm_at_a_free_edge_keeps_the_affine_energy():
    """Half a cruciform on an edge: its quadrants count with the strain of the arm that is left."""
    rng = np.random.default_rng(9)
    a = np.array([[0.5, 0.4, 0.0, 0.3]])
    source = np.array([[0, 1, 0, 3]])
    area = rng.uniform(0.1, 1.0, (1, 4))
    strain, rotation = arm_rows(a, ALONG_YARNS[None], source, source)
    gradient = rng.normal(size=(2, 2))
    u = np.concatenate([(a[0, :, None] * ALONG_YARNS @ gradient.T).ravel(), np.zeros(2)])
    total = tension(strain, area, C11, C22, C12) + shear(rotation, area, G)
    expected = energy_density(UNEVEN, gradient) * area.sum()
    assert 0.5 * u @ total[0] @ u == pytest.approx(expected, rel=1e-12)


def test_missing_arm_does_not_bend():
    """An arm without length has no beam, and no division by its length."""
    a = np.array([[0.5, 0.4, 0.0, 0.3]])
    matrix = bending(a, ALONG_YARNS[None], np.ones((1, 4)), SCALE)[0]
    assert np.isfinite(matrix).all()
    assert not matrix[6:9].any()
    shorter = bending(a, ALONG_YARNS[None], np.array([[1.0, 1.0, 9.0, 1.0]]), SCALE)[0]
    np.testing.assert_array_equal(matrix, shorter)


def test_condensing_a_free_unknown():
    """A hinge that one mode alone leaves free gets the value of smallest norm, and no force."""
    a, t = np.full((1, 4), 0.5), ALONG_YARNS[None]
    strain, _ = arm_rows(a, t)
    stiff = tension(strain, full_areas(a), C11, 0.0, 0.0)  # nothing along the weft
    small, recovery = condense(stiff, 8)
    assert not recovery[0, 1].any()
    np.testing.assert_allclose(recovery[0, 0], [0.5, 0, 0, 0, 0.5, 0, 0, 0], atol=1e-14)
    assert np.isfinite(small).all()


# -- the cantilever ----------------------------------------------------------------------------


@pytest.mark.parametrize("crossovers", [1, 3, 10])
def test_cantilevered_yarn(crossovers):
    """Clamped at one end, load across at the other: P L^3 / 3 EI, and the slope P L^2 / 2 EI.

    Uneven arms; the hinges' deflections and rotations are condensed. Cubic beams are exact for end
    loads: only rounding is left, times the condition of a beam of 2 n pieces, which is some n^4.
    """
    rng = np.random.default_rng(10)
    rigidity, load = 3.7, 0.9
    a = np.zeros((crossovers, 4))
    a[:, [0, 2]] = rng.uniform(0.2, 1.5, (crossovers, 2))
    t = np.broadcast_to(ALONG_YARNS, (crossovers, 4, 2))
    small, _ = condense(bending(a, t, np.full(a.shape, rigidity), SCALE), 12)
    stiffness = np.zeros((2 * crossovers + 2,) * 2)
    for e, matrix in enumerate(small):  # unknowns across the yarn: arm 3's end, then arm 1's
        local = [7, 8, 1, 2]
        place = slice(2 * e, 2 * e + 4)
        stiffness[place, place] += matrix[np.ix_(local, local)]
    free = stiffness[2:, 2:]
    right = np.zeros(len(free))
    right[-2] = load
    u = np.linalg.solve(free, right)
    length = a.sum()
    assert u[-2] == pytest.approx(load * length**3 / (3 * rigidity), rel=1e-9)
    assert u[-1] / SCALE == pytest.approx(load * length**2 / (2 * rigidity), rel=1e-9)


# -- the matrices as printed -------------------------------------------------------------------


def equal_arms(length=0.5):
    """A cruciform with four equal arms along the yarns."""
    return np.full((1, 4), length), ALONG_YARNS[None]


def pulled_along_warp(matrix, length=0.5):
    """Modulus of a square cruciform pulled along the warp, free across; matrix on 8 unknowns."""
    force = np.zeros(8)
    force[0], force[4] = 1.0, -1.0  # on the ends of arms 1 and 3, width 2 length
    u = np.linalg.lstsq(matrix, force, rcond=1e-10)[0]
    return (1.0 / (2 * length)) / ((u[0] - u[4]) / (2 * length))


def test_printed_15_lacks_the_factor():
    """Pulled with free sides, only C11 = E_w/(1 - nu_w nu_e) returns E_w; not the print."""
    a, t = equal_arms()
    warp, weft = UNEVEN.warp, UNEVEN.weft
    strain, _ = arm_rows(a, t)
    consistent, _ = condense(tension(strain, full_areas(a), C11, C22, C12), 8)
    assert pulled_along_warp(consistent[0]) == pytest.approx(warp.modulus, rel=1e-10)
    as_printed = -printed.tension(a, t, warp.modulus, weft.modulus, warp.poisson, weft.poisson)[0]
    product = warp.poisson * weft.poisson
    mu_mu = product / (1 - product) ** 2
    assert pulled_along_warp(as_printed) == pytest.approx(warp.modulus * (1 - mu_mu), rel=1e-10)
    # Its direct term alone is too small by the same 1 - nu_w nu_e: 15 % here, 20 % for Table 1.
    ratio = np.diagonal(as_printed)[[0, 3]] / np.diagonal(consistent[0])[[0, 3]]
    np.testing.assert_allclose(ratio, 1 - product, rtol=0.03)


@pytest.mark.parametrize("lengths", [(0.5, 0.5, 0.5, 0.5), (0.5, 0.8, 0.2, 0.3)])
def test_printed_15_is_right_for_straight_yarns_apart_from_the_factor(lengths):
    """With E/(1 - nu nu) for E on the direct term alone it is the consistent one.

    Also for four lengths: where the yarns are straight the hinge takes the strain to be the same in
    both arms of a yarn, and the arms' weights cancel.
    """
    a, t = np.array([lengths]), ALONG_YARNS[None]
    strain, _ = arm_rows(a, t)
    consistent, _ = condense(tension(strain, full_areas(a), C11, C22, C12), 8)
    # [3] divides the ratios by 1 - nu nu once more; ratios that it turns into the true ones:
    product = UNEVEN.warp.poisson * UNEVEN.weft.poisson
    scale = (np.sqrt(1 + 4 * product) - 1) / (2 * product)
    mended = -printed.tension(
        a, t, C11, C22, scale * UNEVEN.warp.poisson, scale * UNEVEN.weft.poisson
    )
    np.testing.assert_allclose(mended, consistent, atol=1e-12 * C11)


def test_printed_15_has_the_sign_of_the_elements_own_force():
    """The printed matrix is negative semidefinite: assemble its negative."""
    a, t = equal_arms()
    matrix = printed.tension(a, t, 60e3, 60e3, 0.3, 0.3)[0]
    values = np.linalg.eigvalsh(0.5 * (matrix + matrix.T))
    assert values[0] < -1e3
    assert values[-1] < 1e-9 * abs(values[0])


def test_printed_15_is_not_symmetric_for_unequal_kinked_arms():
    """[8] couples by the wrong lengths, which shows as soon as a yarn turns at the crossover."""
    modulus = (60e3, 25e3, 0.6, 0.25)
    a, t = arms(np.random.default_rng(11), 1)
    equal = printed.tension(np.full((1, 4), 0.5), t, *modulus)[0]
    assert abs(equal - equal.T).max() < 1e-12 * abs(equal).max()
    unequal = printed.tension(a, t, *modulus)[0]
    assert abs(unequal - unequal.T).max() > 0.01 * abs(unequal).max()
    strain, _ = arm_rows(a, t)
    consistent, _ = condense(tension(strain, full_areas(a), C11, C22, C12), 8)
    assert abs(consistent - np.swapaxes(consistent, 1, 2)).max() < 1e-12 * abs(consistent).max()


def test_printed_15_needs_reciprocity():
    """Equal arms, but nu_e E_w unlike nu_w E_e: no energy, hence no such fabric."""
    a, t = equal_arms()
    matrix = printed.tension(a, t, 60e3, 25e3, 0.3, 0.3)[0]
    assert abs(matrix - matrix.T).max() > 0.02 * abs(matrix).max()


def printed_shear_energy(u):
    """Energy [16] of both yarns of a square cruciform with end displacements (4, 2), G = A = 1."""
    half = np.array([0.5])
    warp = printed.shear(half, np.array([[1.0, 0.0]]), np.ones(1), 1.0)[0]
    weft = printed.shear(half, np.array([[0.0, 1.0]]), np.ones(1), 1.0)[0]
    along_warp = np.concatenate([u[2], u[0]])  # from the end at -L to the end at +L
    along_weft = np.concatenate([u[3], u[1]])
    return 0.5 * along_warp @ warp @ along_warp + 0.5 * along_weft @ weft @ along_weft


def test_printed_22_charges_a_rigid_rotation():
    """The turning of each yarn by itself costs energy: G A for a rotation of one."""
    rotation = 0.5 * normals(ALONG_YARNS)
    assert printed_shear_energy(rotation) == pytest.approx(1.0, rel=1e-12)
    a, t = equal_arms()
    _, rows = arm_rows(a, t)
    x = np.concatenate([rotation.ravel(), np.zeros(2)])
    assert x @ shear(rows, full_areas(a), 1.0)[0] @ x == pytest.approx(0, abs=1e-14)


def test_printed_22_halves_pure_shear():
    """A free element shares the angle evenly between its yarns: half of 1/2 G A gamma^2."""
    gamma = 0.1
    gradient = np.array([[0.0, 0.5 * gamma], [0.5 * gamma, 0.0]])
    u = 0.5 * ALONG_YARNS @ gradient.T
    right = 0.5 * gamma**2
    assert printed_shear_energy(u) == pytest.approx(0.5 * right, rel=1e-12)
    a, t = equal_arms()
    _, rows = arm_rows(a, t)
    x = np.concatenate([u.ravel(), np.zeros(2)])
    stiffness = shear(rows, full_areas(a), 1.0)[0]
    assert 0.5 * x @ stiffness @ x == pytest.approx(right, rel=1e-12)


YARN = np.array([[np.cos(0.4), np.sin(0.4)]])
L, EI = np.array([0.6]), np.array([2.5])


def corrected_26():
    """Matrix [26] with both faults of the print mended."""
    return printed.bending(L, YARN, EI, coupling=2.0, axial_block=False)


def yarn_motion(translation=(0.0, 0.0), turn=0.0):
    """(u_1, phi_1, phi_2, u_3, phi_3) of a rigid motion of the yarn about its hinge."""
    across = normals(YARN)[0] * L[0] * turn
    first, third = np.asarray(translation) - across, np.asarray(translation) + across
    return np.array([*first, turn, turn, *third, turn])


def test_printed_28_turns_moments_loose():
    """3 L^2 leaves a moment EI/L at node 1 and at the hinge in a rigid rotation; 2 L^2 none."""
    only_28 = printed.bending(L, YARN, EI, axial_block=False)[0]
    force = only_28 @ yarn_motion(turn=1.0)
    np.testing.assert_allclose(force[[2, 3]], EI[0] / L[0], rtol=1e-12)
    assert abs(corrected_26()[0] @ yarn_motion(turn=1.0)).max() < 1e-12


def test_printed_27_takes_along_for_across():
    """Its second block sees a yarn moved along itself as bent, and fails a rigid rotation."""
    only_27 = printed.bending(L, YARN, EI, coupling=2.0)[0]
    along = np.array([*YARN[0], 0.0, 0.0, *YARN[0], 0.0])
    good = corrected_26()[0]
    assert abs(good @ along).max() < 1e-12
    assert abs(only_27 @ along).max() > EI[0] / L[0] ** 3
    assert abs(only_27 @ yarn_motion(turn=1.0)).max() > EI[0] / L[0] ** 2
    to_the_letter = printed.bending(L, YARN, EI)[0]
    assert abs(to_the_letter @ yarn_motion(turn=1.0)).max() > EI[0] / L[0] ** 2


def test_suppressed_hinge_charges_a_translation():
    """[25] holds the hinge: a yarn that moves across as a whole is bent, corrected or not."""
    across = normals(YARN)[0]
    force = corrected_26()[0] @ yarn_motion(translation=across)
    assert force[[0, 1]] @ across == pytest.approx(12 * EI[0] / L[0] ** 3, rel=1e-12)


def test_corrected_26_is_the_consistent_one_with_the_hinge_held():
    """Equal straight arms: the consistent matrix without the rows of the hinge's deflection."""
    a, t = equal_arms(L[0])
    turn = np.array([[np.cos(0.4), -np.sin(0.4)], [np.sin(0.4), np.cos(0.4)]])
    t = t @ turn.T
    consistent = bending(a, t, np.full((1, 4), EI[0]), 1.0)[0]
    # The paper's nodes 1, 2, 3 run along the yarn: end of arm 3, hinge, end of arm 1.
    place = [6, 7, 8, 14, 0, 1, 2]
    np.testing.assert_allclose(
        corrected_26()[0],
        consistent[np.ix_(place, place)],
        atol=1e-12 * EI[0] / L[0] ** 3,
    )
