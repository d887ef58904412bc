# SPDX-License-Identifier: MIT
"""The pin-jointed net on surfaces: closed forms, order, limits, given generators."""

import math
import time
from itertools import pairwise

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.interpolate import RegularGridInterpolator

from cruciform_petsc.forming.fishnet import LAID, LOCKS, OFF, WAITS, Fishnet, march, walk
from cruciform_petsc.tools import shapes
from cruciform_petsc.tools.profile import Profile
from cruciform_petsc.tools.sampled import height_field


def laid(surface, start, warp, link, counts, gap=0.0, locking=1.55, between=90.0):
    """A net from a point and the direction of its warp; the surface lies below it."""
    link, counts = np.broadcast_to(link, 2), np.broadcast_to(counts, 2)
    normal = surface.look(np.array([start]))[1][0]
    warp = np.array(warp, float) - np.dot(warp, normal) * normal
    warp /= np.linalg.norm(warp)
    turn = math.radians(between)
    weft = math.cos(turn) * warp + math.sin(turn) * np.cross(normal, warp)
    along = np.array([warp, weft, -warp, -weft])
    net = Fishnet(surface, gap, link, -counts - 1, 2 * counts + 3, True, locking)
    needed = [*(counts + 1), *(counts + 1)]
    lines = march(surface, gap, np.array(start, float), along, np.tile(link, 2), needed)
    for k, line in enumerate(lines):
        net.place(k % 2, 1 if k < 2 else -1, line, needed[k])
    net.sweep(np.ones(net.shape, bool))
    return net


def at_joints(net):
    """Shear of the joints inside, deg: means of the four cells around."""
    s = np.rad2deg(net.shear())
    return 0.25 * (s[1:, 1:] + s[:-1, 1:] + s[1:, :-1] + s[:-1, :-1])


def chebyshev(s):
    """Shear angle (deg) of a net on a sphere at s = u v/R^2: s g'' + g' = cos g."""

    def rate(s, y):
        return [y[1], (math.cos(y[0]) - y[1]) / s]

    end = solve_ivp(rate, (1e-9, s), [1e-9, 1.0], rtol=1e-11, atol=1e-13)
    return math.degrees(end.y[0, -1])


def test_sphere():
    """The Chebyshev net through the pole: u = v = 0.2 to 0.8 R; published to a thousandth."""
    radius, told = 75e-3, (2.292, 9.154, 20.479, 35.858)
    sphere, errors = shapes.sphere(radius), []
    for n in (4, 8, 16):
        net = laid(sphere, [0, 0, radius], [1, 0, 0], 0.2 * radius / n, 4 * n)
        assert (net.status == LAID).all()
        joints = at_joints(net)
        found = [joints[4 * n + k * n, 4 * n + k * n] for k in (1, 2, 3, 4)]
        exact = [chebyshev((0.2 * k) ** 2) for k in (1, 2, 3, 4)]
        np.testing.assert_allclose(exact, told, atol=6e-4)  # forming.md, to its digits
        errors.append(np.array(found) - exact)
    assert abs(errors[0]).max() < 0.2  # asked for; at the coarsest it is 0.004
    assert abs(errors[0]).max() < 5e-3
    # Second order: a quarter with half the links. The two largest errors, above rounding.
    for coarse, fine in pairwise(errors):
        np.testing.assert_allclose(coarse[2:] / fine[2:], 4.0, rtol=0.05)
    # The same in the other quadrants, of the other sign in two of them, where the cells' other
    # diagonal tells it: links squared apart.
    n = len(joints) // 2
    np.testing.assert_allclose(joints[n - 20, n + 20], -joints[n + 20, n + 20], atol=1e-4)
    np.testing.assert_allclose(joints[n - 20, n - 20], joints[n + 20, n + 20], atol=1e-9)


def test_links_and_distance():
    """Every link has its length, every joint its distance: warp and weft of different pitch."""
    radius, gap, link = 50e-3, 0.6e-3, np.array([4e-3, 6e-3])
    net = laid(shapes.sphere(radius), [0, 0, radius + gap], [1, 0.3, 0], link, [8, 6], gap)
    for axis in (0, 1):
        length = np.linalg.norm(np.diff(net.x, axis=axis), axis=2)
        np.testing.assert_allclose(length, link[axis], rtol=1e-12)
    np.testing.assert_allclose(np.linalg.norm(net.x, axis=2), radius + gap, rtol=1e-12)


@pytest.mark.parametrize("angle", [0.0, 20.0, 45.0, 70.0])
def test_no_shear_on_what_unrolls(angle):
    """Cylinder and cone: none at any angle but that chords are no arcs, which is second order."""
    turn = math.radians(angle)
    cone = Profile([[5e-3, 95e-3], [100e-3, 0.0]], 1e-3)  # 45 degrees
    up = np.array([1.0, 0.0, 1.0]) / math.sqrt(2.0)
    down, around = np.array([1.0, 0.0, -1.0]) / math.sqrt(2.0), np.array([0.0, 1.0, 0.0])
    start = np.array([60e-3, 0.0, 40e-3])
    assert abs(cone.look(start[None])[0][0]) < 1e-12
    np.testing.assert_allclose(cone.look(start[None])[1][0], up, atol=1e-12)
    warp = math.cos(turn) * around + math.sin(turn) * down
    cases = [
        (shapes.cylinder(50e-3), [0, 0, 50e-3], [math.cos(turn), math.sin(turn), 0]),
        (cone, start, warp),
    ]
    for surface, begin, direction in cases:
        largest = []
        for n in (8, 16):
            net = laid(surface, begin, direction, 24e-3 / n, n)
            assert (net.status == LAID).all()
            largest.append(np.rad2deg(abs(net.shear())).max())
        assert largest[0] < 0.02
        assert largest[1] < 0.3 * largest[0] + 1e-9


def test_plane_keeps_what_the_seed_has():
    """A sheared net stays as it is: 60 degrees between the yarns, 30 of shear all over."""
    net = laid(shapes.plane(), [0, 0, 0], [1, 0, 0], 5e-3, 6, between=60.0)
    np.testing.assert_allclose(np.rad2deg(net.shear()), 30.0, atol=1e-9)
    np.testing.assert_allclose(net.x[..., 2], 0.0, atol=1e-15)


def test_locks_where_the_closed_form_does():
    """On a sphere along u = v; what lies behind waits, all before it is laid."""
    radius, locking = 75e-3, math.radians(50.0)
    n, link = 40, 0.025 * radius
    net = laid(shapes.sphere(radius), [0, 0, radius], [1, 0, 0], link, n, locking=locking)
    middle = n + 1
    along = net.status[middle:, middle:].diagonal()
    first = int(np.flatnonzero(along != LAID)[0])
    # The cell before the joint reaches 50 degrees at s = (k - 1/2)^2 (link/R)^2.
    s = ((first - 0.5) * link / radius) ** 2
    step = ((first - 1.5) * link / radius) ** 2
    assert chebyshev(step) < 50.0 < chebyshev(s) + 0.2
    assert along[first] == LOCKS
    assert set(along[first + 1 :]) == {WAITS}
    shear = net.shear()
    assert np.nanmax(abs(shear)) <= locking


def test_near_locking():
    """Up to 88 degrees: links keep their lengths, no joint flips over."""
    radius = 75e-3
    net = laid(shapes.sphere(radius), [0, 0, radius], [1, 0, 0], 0.05 * radius, 40,
               locking=math.radians(88.9))  # fmt: skip
    good = net.status == LAID
    both = good[1:] & good[:-1]
    length = np.linalg.norm(np.diff(net.x, axis=0), axis=2)[both]
    np.testing.assert_allclose(length, 0.05 * radius, rtol=1e-10)
    assert np.rad2deg(np.nanmax(abs(net.shear()))) > 85.0
    # Whole cells are not turned over: their corners go around as at rest, seen from outside.
    a, b, c = net.x[1:, :-1], net.x[:-1, 1:], net.x[:-1, :-1]
    around = (np.cross(a - c, b - c) * c).sum(axis=2)
    assert (around[~np.isnan(net.shear()) & ~np.isnan(around)] > 0.0).all()


def test_comes_off_where_the_surface_ends():
    """A net that reaches the hole of a die's flat follows its wall, and is told where it ends."""

    class Cut(Profile):
        """The plane, but none beyond x = 20 mm."""

        def look(self, points):
            distance, normal, curvature = super().look(points)
            return np.where(points[:, 0] > 20e-3, 1.0, distance), normal, curvature

    net = laid(Cut.level(), [0, 0, 0], [1, 0, 0], 3e-3, 10)
    middle = 11
    assert net.status[middle + 7, middle] == OFF
    assert net.status[middle + 6, middle] == LAID
    assert net.status[middle + 8, middle + 1] == WAITS
    assert (net.status[: middle + 1] == LAID).all()


def test_height_field_is_a_surface_too():
    """A paraboloid from points: the shear falls towards that of its Gauss curvature at the seed.

    sin s = K u v there, to the leading order: K of z = -(x^2 + y^2)/(2 R) at its top is 1/R^2.
    """
    radius, x = 60e-3, np.linspace(-40e-3, 40e-3, 81)
    bowl = height_field(lambda x, y: -(x**2 + y**2) / (2.0 * radius), x, x, cell=1e-3)
    net = laid(bowl, [0, 0, bowl_top(bowl)], [1, 0, 0], 1e-3, 12)
    s = np.deg2rad(at_joints(net))
    n = len(s) // 2
    grid = RegularGridInterpolator((np.arange(-n, n + 1),) * 2, s)
    u = 10.0
    assert grid([[u, u]])[0] == pytest.approx((u * 1e-3 / radius) ** 2, rel=0.05)


def bowl_top(surface):
    z = 0.0
    for _ in range(20):
        z -= surface.look(np.array([[0.0, 0.0, z]]))[0][0]
    return z


def test_geodesics_are_great_circles_and_helices():
    """Joints of a line stay in the great circle's plane; on a cylinder they climb evenly."""
    direction = np.array([[0.6, 0.8, 0.0]])
    (line,) = march(
        shapes.sphere(1.0), 0.0, np.array([0, 0, 1.0]), direction, np.array([0.1]), [30]
    )
    np.testing.assert_allclose(line @ [0.8, -0.6, 0.0], 0.0, atol=1e-12)
    (line,) = march(
        shapes.cylinder(1.0), 0.0, np.array([0, 0, 1.0]), direction, np.array([0.1]), [30]
    )
    np.testing.assert_allclose(np.diff(line[:, 1]), 0.08, rtol=2e-3)
    np.testing.assert_allclose(np.ptp(np.diff(line[:, 1])), 0.0, atol=1e-12)


def test_upright_planes():
    """A line in an upright plane stays there where a geodesic leaves it."""
    start, up = np.array([0.0, 0.6, 0.8]), np.array([0.0, 0.0, 1.0])
    along, link = np.array([[1.0, 0.0, 0.0]]), np.array([0.05])
    sphere = shapes.sphere(1.0)
    (line,) = march(sphere, 0.0, start, along, link, [12], up)
    np.testing.assert_allclose(line[:, 1], 0.6, atol=1e-12)
    (straight,) = march(sphere, 0.0, start, along, link, [12])
    assert abs(straight[-1, 1] - 0.6) > 0.05
    np.testing.assert_allclose(np.linalg.norm(np.diff(line, axis=0), axis=1), 0.05, rtol=1e-12)


def test_walk_on_a_line_of_points():
    """Chords of one length, around corners; it ends where the line does."""
    points = np.array([[0.0, 0, 0], [1.0, 0, 0], [1.0, 1.0, 0]])
    joints = walk(points, 0.3, 100)
    np.testing.assert_allclose(np.linalg.norm(np.diff(joints, axis=0), axis=1), 0.3, rtol=1e-12)
    assert len(joints) == 7
    assert len(walk(points, 0.3, 2)) == 3
    assert len(walk(points, 5.0, 2)) == 1


def test_a_hundred_thousand_joints_in_seconds():
    """10 s of processor time are asked for; it takes some tenths of a second."""
    n, radius = 158, 75e-3
    begin = time.process_time()
    net = laid(shapes.sphere(radius), [0, 0, radius], [1, 0, 0], 1.1 * radius / n, n)
    assert time.process_time() - begin < 5.0
    assert (net.status == LAID).sum() > 1e5
