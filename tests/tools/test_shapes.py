# SPDX-License-Identifier: MIT
"""Exact shapes: distance, normal and curvature by closed forms, differences and dense points."""

import time

import numpy as np
import pytest
import shapely
from scipy.spatial import cKDTree

from cruciform_petsc.errors import InputError
from cruciform_petsc.tools.profile import Profile
from cruciform_petsc.tools.sector import Sector
from cruciform_petsc.tools.shapes import Box, cylinder, opening, plane, ring, sphere
from cruciform_petsc.tools.surface import touch

T = np.linspace(0.0, 1.0, 80)
# Beside the spine, the smooth stand-in of the double dome: z = 60 mm (1 + cos(pi t)).
DOME = np.c_[np.r_[0.0, 0.027 + 0.1026 * T, 0.2], np.r_[0.12, 0.06 * (1 + np.cos(np.pi * T)), 0.0]]
SHAPES = {
    "plane": plane(),
    "plate": plane((0.3, 0.2)),
    "sphere": sphere(0.075),
    "punch": sphere(0.05, shaft=True),
    "cylinder": cylinder(0.05),
    "cylinder with ends": cylinder(0.05, 0.2, 0.01),
    "box": Box((0.1, 0.2, 0.05), 0.01),
    "ring": ring(0.09, 0.225),
    "sector": Sector(0.09, 0.225, 0.2, 1.5),
    "half ring": Sector(0.09, 0.225, -1.0, np.pi - 1.0, 0.01),
    "disc": ring(0.0, 0.09, 0.01),
    "die": opening(0.08, 0.0075, 0.225),
    "oblong die": opening(0.08, 0.0075, 0.225, 0.3),
    "cone": Profile([[0.0, 0.1], [0.05, 0.02], [0.1, 0.0], [0.2, 0.0]], [0.02, 0.01, 0.01, 0.005]),
    "step": Profile(
        [[-0.1, 0.0], [-0.02, 0.0], [0.0, 0.04], [0.03, 0.04], [0.1, 0.0]], 0.005, turned=False
    ),
    "dome": Profile(DOME, None, spine=0.61),
}
EACH = pytest.mark.parametrize("shape", SHAPES.values(), ids=SHAPES)


def near(shape, count=20000, seed=1, room=0.05):
    """Points around a shape's picture, and the size of that."""
    low, high = shape.box
    size = float(np.ptp(shape.box, axis=0).max())
    points = np.random.default_rng(seed).uniform(low - room * size, high + room * size, (count, 3))
    return points, size


@EACH
def test_derivatives_are_those_of_the_distance(shape):
    points, size = near(shape)
    step = 1e-6 * size
    _, normal, curvature = shape.look(points)
    ahead = [shape.look(points + step * axis) for axis in np.eye(3)]
    behind = [shape.look(points - step * axis) for axis in np.eye(3)]
    by_distance = np.stack([a[0] - b[0] for a, b in zip(ahead, behind, strict=True)], -1)
    by_normal = np.stack([a[1] - b[1] for a, b in zip(ahead, behind, strict=True)], -1)
    off = np.abs(by_distance / (2.0 * step) - normal).max(axis=1)
    wrong = np.abs(by_normal / (2.0 * step) - curvature).max(axis=(1, 2))
    wrong /= 1.0 / size + np.abs(curvature).max(axis=(1, 2))
    # A few of the points lie where the distance has a kink (far away), or the curvature a jump.
    assert (off > 1e-6).mean() < 1e-3
    assert (wrong > 1e-3).mean() < 1e-3
    np.testing.assert_allclose(np.linalg.norm(normal, axis=1), 1.0, rtol=0, atol=1e-12)
    np.testing.assert_allclose(curvature, curvature.transpose(0, 2, 1), atol=1e-9 / size)
    # grad d has length 1 everywhere, so it does not change along itself
    along = np.einsum("nij,nj->ni", curvature, normal)
    assert np.abs(along).max() < 1e-9 * (1.0 / size + np.abs(curvature).max())


@EACH
def test_facets_lie_on_the_surface_and_look_outwards(shape):
    points, facets = shape.facets()
    size = float(np.ptp(shape.box, axis=0).max())
    assert np.abs(shape.look(points)[0]).max() < 1e-12 * size
    corners = points[facets]
    middle = corners.mean(axis=1)
    outwards = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    distance, normal, _ = shape.look(middle)
    assert np.abs(distance).max() < 2e-3 * size
    assert (np.einsum("ij,ij->i", outwards, normal) > 0.0).all()
    assert points.min(axis=0) == pytest.approx(shape.box[0], abs=1e-3 * size)
    assert points.max(axis=0) == pytest.approx(shape.box[1], abs=1e-3 * size)


@EACH
def test_distance_is_that_to_the_closest_of_many_points(shape):
    """Of what is drawn: where the tool goes on beyond that, points farther away are left out."""
    corners, facets = shape.facets(5e-5)
    random = np.random.default_rng(0)
    mix = random.dirichlet((1.0, 1.0, 1.0), max(1, 60_000 // len(facets)) * len(facets))
    cloud = np.einsum("nc,nci->ni", mix, np.resize(corners[facets], (len(mix), 3, 3)))
    cloud = np.vstack([corners, cloud])
    points, size = near(shape, 2000, seed=2)
    found = shape.look(points)[0]
    normal = shape.look(points)[1]
    foot = points - found[:, None] * normal
    drawn = ((foot > shape.box[0] - 1e-9) & (foot < shape.box[1] + 1e-9)).all(axis=1)
    closest = cKDTree(cloud).query(points[drawn])[0]
    assert drawn.sum() > 100
    assert (closest > np.abs(found[drawn]) - 1.5e-4).all()  # nothing lies nearer
    np.testing.assert_allclose(shape.look(foot)[0], 0.0, atol=1e-12 * size)  # and that is on it


def test_closed_forms():
    x = np.random.default_rng(3).uniform(-0.2, 0.2, (1000, 3))
    away = np.linalg.norm(x, axis=1)
    distance, normal, curvature = sphere(0.075).look(x)
    np.testing.assert_allclose(distance, away - 0.075, atol=1e-15)
    np.testing.assert_allclose(normal, x / away[:, None], atol=1e-12)
    n = x / away[:, None]
    exact = (np.eye(3) - n[:, :, None] * n[:, None, :]) / away[:, None, None]
    np.testing.assert_allclose(curvature, exact, atol=1e-9)
    np.testing.assert_allclose(cylinder(0.05).look(x)[0], np.hypot(x[:, 0], x[:, 2]) - 0.05)
    distance, normal, curvature = plane().look(x)
    np.testing.assert_array_equal(distance, x[:, 2])
    assert (normal == [0.0, 0.0, 1.0]).all()
    assert not curvature.any()
    # The die of forming.md: on the flat, on the fillet under 45 degrees, on the wall.
    die = opening(0.08, 0.0075, 0.225)
    c = np.sqrt(0.5)
    at = [[0.1, 0, 2e-3], [0.0875 - (0.0075 + 1e-3) * c, 0, -0.0075 + (0.0075 + 1e-3) * c]]
    distance, normal, curvature = die.look(np.array([*at, [0.0, 0.079, -0.05]]))
    np.testing.assert_allclose(distance, [2e-3, 1e-3, 1e-3], atol=1e-15)
    np.testing.assert_allclose(normal, [[0, 0, 1], [-c, 0, c], [0, -1, 0]], atol=1e-12)
    # curvatures: of the fillet 1/(r + 1 mm), around the axis n_r/r
    np.testing.assert_allclose(
        np.linalg.eigvalsh(curvature[1]),
        np.sort([-c / at[1][0], 0.0, 1.0 / 0.0085]),
        atol=1e-9,
    )


def test_normals_are_continuous_along_every_profile():
    for name in ("die", "cone", "step", "dome", "punch", "ring"):
        shape = SHAPES[name]
        outline = shape.outline(1e-7)
        along = np.diff(outline, axis=0)
        points = np.insert(outline[:-1] + 0.5 * along, 1, 0.0, axis=1)
        normal = shape.look(points)[1]
        turn = np.linalg.norm(np.diff(normal, axis=0), axis=1)
        step = np.linalg.norm(np.diff(points, axis=0), axis=1)
        sharpest = min(shape.closest_radius)
        assert (turn < 1.01 * step / sharpest + 1e-9).all(), name


def test_on_the_axis_and_in_the_centre():
    for shape in (sphere(0.05), sphere(0.05, shaft=True)):
        distance, normal, curvature = shape.look(np.array([[0.0, 0.0, 0.06]]))
        assert distance[0] == pytest.approx(0.01, abs=1e-15)
        np.testing.assert_allclose(normal[0], [0.0, 0.0, 1.0], atol=1e-12)
        np.testing.assert_allclose(curvature[0], np.diag([1, 1, 0]) / 0.06, atol=1e-9)
    for shape in SHAPES.values():
        for part in shape.look(np.zeros((1, 3))):
            assert np.isfinite(part).all()


@EACH
def test_what_is_no_point_shows(shape):
    for i in (1,) if shape is SHAPES["cylinder with ends"] else (0, 2):
        point = np.zeros((1, 3))
        point[0, i] = np.nan
        assert np.isnan(shape.look(point)[0]).all()


def test_radii_are_told():
    assert SHAPES["cone"].closest_radius == (0.005, 0.01)  # of corners that bulge, and hollow ones
    assert sphere(0.075).closest_radius == (0.075, np.inf)
    assert plane().closest_radius == (np.inf, np.inf)
    bulging, hollow = SHAPES["dome"].closest_radius  # 1/(A k^2) of A cos(k x), and rims of 2 %
    assert hollow == pytest.approx(0.1026**2 / (0.06 * np.pi**2), rel=0.02)
    assert bulging == pytest.approx(0.004, rel=1e-6)


def test_fast_enough():
    points = near(SHAPES["dome"], 100_000)[0]
    SHAPES["dome"].look(points[:1])
    begin = time.process_time()
    SHAPES["dome"].look(points)
    assert time.process_time() - begin < 0.2


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda: Profile([[0, 0]]), "at least two points"),
        (lambda: Profile([[0, 0], [np.nan, 1]], 1), "not finite"),
        (lambda: Profile([[-1, 0], [1, 0]], 0.1), "r below 0"),
        (lambda: Profile([[0, 0], [1, 0], [1, 0], [2, 0]], 0.1), "point 3 of a profile repeats"),
        (lambda: Profile([[1, 0], [2, 1], [3, 0]], [0.1, 0.0, 0.1]), "point 2 .* sharp corner"),
        (lambda: Profile([[1, 0], [2, 0]], 0.6), "take 1200 mm of the 1000 mm between them"),
        (lambda: Profile([[1, 0], [2, 0]], [1, 2, 3]), "needs one fillet, or 2, got 3"),
        (lambda: Profile([[1, 0], [3, 0], [2, 0]], 0.1), "turns back on itself"),
        (lambda: ring(0.2, 0.1), "must be larger than inner_radius"),
        (lambda: Sector(0.2, 0.1, 0, 1), "must be larger than inner_radius"),
        (lambda: Sector(0.0, 0.1, 0, 1), "which a sector needs"),
        (lambda: Sector(0.1, 0.2, 1, 0.5), "from an angle to a larger one, .* 57.29.* to 28.6"),
        (lambda: Sector(0.1, 0.2, 0, 3.2), "by half a turn at most"),
        (lambda: Sector(0.1, 0.2, 0, 1, 0.06), "leave a flat between the sides of the sector"),
        (lambda: Sector(0.1, 0.2, 0, 0.1, 0.01), "leave a flat between the sides of the sector"),
        (lambda: opening(0.08, 0.02, 0.1), "must leave room"),
        (lambda: Box((1, 2, 3), 0.6), "at most half of 1000 mm, got 600 mm"),
        (lambda: Box((1, 2, 3), 0.0), "must be positive"),
    ],
)
def test_what_is_no_shape(make, words):
    with pytest.raises(InputError, match=words):
        make()


def test_touch():
    """A sphere on a grid of points, a slanting way, hollow under convex, a miss, a way out."""
    x = np.linspace(-0.1, 0.1, 21)
    cloth = np.column_stack([*(a.ravel() for a in np.meshgrid(x, x)), np.zeros(21 * 21)])
    travel, index = touch(sphere(0.05), cloth, np.array([0.0, 0.0, 2.0]))
    assert travel == pytest.approx(-0.05, abs=1e-10)
    assert index == 220
    travel, _ = touch(sphere(0.05), cloth + np.array([0, 0, 0.3]), np.array([0.0, 0.0, -1.0]), 1e-3)
    assert travel == pytest.approx(0.3 - 0.051, abs=1e-10)
    travel, _ = touch(plane(), cloth + np.array([0, 0, 0.3]), np.array([3.0, 0.0, -4.0]))
    assert travel == pytest.approx(0.3 / 0.8, abs=1e-10)
    assert touch(sphere(0.05), cloth[:1], np.array([0.0, 0.0, 1.0])) is None
    # from under the flat of a die, which has no end there, back to it
    travel, _ = touch(SHAPES["die"], np.array([[0.15, 0, -1e-3]]), np.array([0, 0, -1.0]))
    assert travel == pytest.approx(-1e-3, abs=1e-10)


@pytest.mark.parametrize("turn", [1e-7, -1e-7, 1e-5, -1e-4])
def test_smooth_points_in_a_nearly_straight_line(turn):
    """Their arcs have radii of kilometres, and no point far beside one is near it."""
    slope = Profile([[0.0, 0.0], [0.1, 0.1], [0.2, 0.2 + turn], [0.3, 0.1]], None, turned=False)
    points = np.random.default_rng(0).uniform(-0.5, 0.8, (2000, 3))
    chain = shapely.linestrings(slope.outline(1e-6))
    truth = shapely.distance(chain, shapely.points(points[:, [0, 2]]))
    above = points[:, 2] > 0.25  # beside the walls, which the chain does not have to the end
    off = slope.look(points)[0][above] - truth[above]
    assert abs(off).max() < 1e-5
