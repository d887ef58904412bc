# SPDX-License-Identifier: MIT
"""Yarns, cells and quadrants of outlines against slow readings of them with shapely."""

import numpy as np
import pytest
import shapely
from support.helpers import random_polygon

from cruciform_petsc.net.lattice import (
    ARM_STEP,
    OPPOSITE,
    QUADRANTS,
    SNAP,
    areas_within,
    boundary_segments,
    cells_cut,
    quadrant_areas,
    snapped,
    union_of_intervals,
    yarn_lines,
)

# A snapped end of a yarn may be off by SNAP; sums of a few of them.
NEAR = 3 * SNAP


def star(rng, size=6.0, hole=False):
    """A random polygon, maybe with a hole, in lattice coordinates, off the lattice."""
    while True:
        shift = rng.uniform(-3, 3, 2)
        holes = [random_polygon(rng, 0.35 * size) + shift] if hole else []
        outline = shapely.Polygon(random_polygon(rng, size) + shift, holes)
        if outline.is_valid:
            return outline


def on_grid(rng, hole=False):
    """The same with corners on quarter pitches: lines through corners and along edges abound."""
    while True:
        outline = star(rng, 6.0, hole)
        rings = [
            np.round(4 * np.asarray(r.coords)) / 4 for r in (outline.exterior, *outline.interiors)
        ]
        outline = shapely.Polygon(rings[0], rings[1:])
        if outline.is_valid and outline.area > 1:
            return outline


def slow_lines(outline, family):
    """{yarn: [(start, end), ...]}: each line cut with the closed outline by shapely."""
    low, high = np.array(outline.bounds).reshape(2, 2)
    result = {}
    for line in range(int(np.ceil(low[1 - family])), int(np.floor(high[1 - family])) + 1):
        ends = np.array([[low[family] - 1, line], [high[family] + 1, line]])
        cut = shapely.LineString(ends[:, ::-1] if family else ends).intersection(outline)
        parts = sorted(
            (piece.bounds[family], piece.bounds[family + 2])
            for piece in getattr(cut, "geoms", [cut])
            if not piece.is_empty
        )
        merged = []
        for start, end in parts:
            if merged and start <= merged[-1][1] + 1e-9:
                merged[-1][1] = max(merged[-1][1], end)
            else:
                merged.append([start, end])
        if merged:
            result[line] = merged
    return result


def check_lines(outline):
    """Both families against slow_lines."""
    segments = snapped(boundary_segments(outline))
    for family in (0, 1):
        yarns = yarn_lines(segments, family)
        slow = slow_lines(outline, family)
        assert sorted(slow) == sorted(set(yarns.line.tolist()))
        assert (np.diff(yarns.line) >= 0).all()
        for line, parts in slow.items():
            here = yarns.line == line
            found = np.stack([yarns.start[here], yarns.end[here]], axis=1)
            np.testing.assert_allclose(found, parts, atol=NEAR)
            np.testing.assert_array_equal(yarns.first[here], np.ceil(found[:, 0]))
            np.testing.assert_array_equal(yarns.last[here], np.floor(found[:, 1]))


@pytest.mark.parametrize("seed", range(15))
def test_yarns_of_random_outlines(seed):
    """Any polygon with a hole."""
    check_lines(star(np.random.default_rng(seed), hole=seed % 2 == 1))


@pytest.mark.parametrize("seed", range(40))
def test_yarns_through_corners_and_along_edges(seed):
    """Corners on quarter pitches: the closed outline is what counts as inside."""
    check_lines(on_grid(np.random.default_rng(seed), hole=seed % 2 == 1))


def intervals(outline, family):
    """(yarn, start, end) of all parts."""
    yarns = yarn_lines(snapped(boundary_segments(outline)), family)
    return list(zip(yarns.line.tolist(), yarns.start.tolist(), yarns.end.tolist(), strict=True))


def test_yarns_along_edges_of_a_rectangle():
    """The lines of all four edges are inside."""
    assert intervals(shapely.box(0, 0, 3, 2), 0) == [(0, 0, 3), (1, 0, 3), (2, 0, 3)]
    assert intervals(shapely.box(0, 0, 3, 2), 1) == [(0, 0, 2), (1, 0, 2), (2, 0, 2), (3, 0, 2)]


def test_yarns_at_the_tips_of_a_diamond():
    """A yarn that touches a corner is there with a part of no length and one crossover."""
    diamond = shapely.Polygon([(2, 0), (0, 2), (-2, 0), (0, -2)])
    for family in (0, 1):
        assert intervals(diamond, family) == [
            (-2, 0, 0), (-1, -1, 1), (0, -2, 2), (1, -1, 1), (2, 0, 0)
        ]  # fmt: skip
        yarns = yarn_lines(boundary_segments(diamond), family)
        assert (yarns.last - yarns.first + 1).tolist() == [1, 3, 5, 3, 1]


def test_yarn_along_the_edge_of_a_hole_runs_through():
    """The edges of a hole belong to the cloth, the lines between them do not."""
    outline = shapely.box(0, 0, 5, 5).difference(shapely.box(1, 1, 4, 4))
    assert [part for part in intervals(outline, 0) if part[0] in (1, 2, 4)] == [
        (1, 0, 5), (2, 0, 1), (2, 4, 5), (4, 0, 5)
    ]  # fmt: skip


def test_yarns_snap_to_the_lattice():
    """Rounding of the outline's coordinates makes no tails of 1e-12 pitches."""
    nudge = 1e-9
    outline = shapely.box(nudge, -nudge, 3 - nudge, 2 + nudge)
    assert intervals(outline, 0) == [(0, 0, 3), (1, 0, 3), (2, 0, 3)]


@pytest.mark.parametrize("factor", [0.9, 1.0, 1.0000001, 1.1])
def test_both_families_snap_alike(factor):
    """Edges at about SNAP from a lattice line: it is there for both families or for neither."""
    gap = factor * SNAP
    segments = snapped(boundary_segments(shapely.box(-4 + gap, -2 + gap, 4 - gap, 2 - gap)))
    warp, weft = yarn_lines(segments, 0), yarn_lines(segments, 1)
    assert set(range(warp.first.min(), warp.last.max() + 1)) == set(weft.line.tolist())
    assert set(range(weft.first.min(), weft.last.max() + 1)) == set(warp.line.tolist())


def test_part_without_a_crossover():
    """A yarn may pass between two crossovers: it has no first one, and find knows of none."""
    yarns = yarn_lines(boundary_segments(shapely.box(0.2, -0.5, 0.8, 1.5)), 0)
    assert yarns.line.tolist() == [0, 1]
    assert (yarns.first > yarns.last).all()
    assert (yarns.find(np.array([0, 0, 1]), np.array([0, 1, 0])) == -1).all()


def test_find():
    """The part that holds a position on a yarn, -1 where there is none; any shape."""
    outline = shapely.box(0, 0, 9, 3).difference(shapely.box(2.5, 0.5, 5.5, 1.5))
    yarns = yarn_lines(boundary_segments(outline), 0)
    line = np.array([[1, 1, 1, 1], [1, 2, 7, -1]])
    position = np.array([[0, 2, 3, 6], [10, 4, 0, 0]])
    found = yarns.find(line, position)
    assert found.tolist()[0][2] == -1
    assert found.tolist()[1][0] == found.tolist()[1][2] == found.tolist()[1][3] == -1
    assert found[0, 0] == found[0, 1]
    assert found[0, 3] == found[0, 0] + 1
    assert yarns.line[found[1, 1]] == 2


def test_find_on_no_yarns():
    """An outline between all lines."""
    yarns = yarn_lines(boundary_segments(shapely.box(0.2, 0.2, 0.8, 0.8)), 0)
    assert len(yarns.line) == 0
    assert yarns.find(np.array([0, 1]), np.array([0, 0])).tolist() == [-1, -1]


@pytest.mark.parametrize("seed", range(20))
def test_union_of_intervals(seed):
    """Against merging one interval after the other."""
    rng = np.random.default_rng(seed)
    n = int(rng.integers(0, 40))
    line, start = rng.integers(-2, 3, n), rng.integers(0, 20, n) / 4
    end = start + rng.integers(0, 8, n) / 4
    slow = []
    for k in sorted(range(n), key=lambda k: (line[k], start[k])):
        if slow and slow[-1][0] == line[k] and start[k] <= slow[-1][2]:
            slow[-1][2] = max(slow[-1][2], end[k])
        else:
            slow.append([line[k], start[k], end[k]])
    fast = union_of_intervals(line, start, end)
    assert [list(row) for row in zip(*fast, strict=True)] == slow


@pytest.mark.parametrize("seed", range(30))
def test_cells_cut(seed):
    """All cells that the boundary truly enters, and none that it stays away from."""
    rng = np.random.default_rng(seed)
    outline = star(rng, hole=True) if seed < 15 else on_grid(rng, hole=True)
    found = {tuple(cell) for cell in cells_cut(snapped(boundary_segments(outline))).tolist()}
    x0, y0, x1, y1 = np.round(outline.bounds).astype(int)
    boundary = outline.boundary
    for i in range(x0 - 2, x1 + 3):
        for j in range(y0 - 2, y1 + 3):
            cell = shapely.box(i - 0.5, j - 0.5, i + 0.5, j + 0.5)
            if boundary.intersects(cell.buffer(-10 * SNAP)):
                assert (i, j) in found
            if not boundary.intersects(cell.buffer(10 * SNAP)):
                assert (i, j) not in found


def present_in(outline):
    """Presence as the network has it."""
    yarns = yarn_lines(snapped(boundary_segments(outline)), 0)
    return lambda ij: yarns.find(ij[..., 1], ij[..., 0]) >= 0


def around(outline):
    """All lattice points in and near an outline."""
    x0, y0, x1, y1 = np.round(outline.bounds).astype(int)
    i, j = np.meshgrid(np.arange(x0 - 2, x1 + 3), np.arange(y0 - 2, y1 + 3), indexing="ij")
    return np.stack([i.ravel(), j.ravel()], axis=1)


@pytest.mark.parametrize("seed", range(30))
def test_presence(seed):
    """A crossover is a lattice point that the closed outline covers."""
    rng = np.random.default_rng(seed)
    outline = star(rng, hole=True) if seed < 15 else on_grid(rng, hole=True)
    ij = around(outline)
    points = shapely.points(ij.astype(float))
    doubtful = (shapely.distance(outline.boundary, points) < NEAR) & (seed < 15)
    np.testing.assert_array_equal(
        present_in(outline)(ij)[~doubtful], shapely.covers(outline, points)[~doubtful]
    )


def slow_quadrant_areas(outline, ij, present):
    """Deal out each quarter of each cell: to its own crossover, else across its borders."""
    area = {tuple(point): np.zeros(4) for point in ij.tolist()}
    lost = 0.0
    for i, j in ij.tolist():
        for q, (warp_arm, weft_arm) in enumerate(QUADRANTS.tolist()):
            dw, de = ARM_STEP[warp_arm][0], ARM_STEP[weft_arm][1]
            quarter = shapely.box(
                *np.sort([i, i + 0.5 * dw])[:1], *np.sort([j, j + 0.5 * de])[:1],
                *np.sort([i, i + 0.5 * dw])[1:], *np.sort([j, j + 0.5 * de])[1:],
            )  # fmt: skip
            piece = outline.intersection(quarter).area
            # Which quadrant of a crossover across the warp border, the weft border, the corner.
            mirror_warp, mirror_weft = [1, 0, 3, 2][q], [3, 2, 1, 0][q]
            takers = [(i, j, q)] if present[i, j] else []
            if not takers:
                takers = [
                    (i + dw * a, j + de * b, to)
                    for a, b, to in ((1, 0, mirror_warp), (0, 1, mirror_weft))
                    if present.get((i + dw * a, j + de * b))
                ]
            if not takers and present.get((i + dw, j + de)):
                takers = [(i + dw, j + de, OPPOSITE_QUADRANT[q])]
            for a, b, to in takers:
                area[a, b][to] += piece / len(takers)
            lost += 0.0 if takers else piece
    return area, lost


OPPOSITE_QUADRANT = [2, 3, 0, 1]


def test_numbering_of_arms_and_quadrants():
    """Arms anticlockwise from the warp's; quadrants between them, anticlockwise from the first."""
    assert (ARM_STEP[OPPOSITE] == -ARM_STEP).all()
    middle = ARM_STEP[QUADRANTS].sum(axis=1)
    assert middle.tolist() == [[1, 1], [-1, 1], [-1, -1], [1, -1]]
    assert (QUADRANTS % 2 == [0, 1]).all()


@pytest.mark.parametrize("seed", range(16))
def test_quadrant_areas(seed):
    """Each piece of the outline goes where the rule says, and what is lost has no neighbour."""
    rng = np.random.default_rng(seed)
    outline = star(rng, 3.0, hole=True) if seed < 10 else on_grid(rng, hole=True)
    ij, present = around(outline), present_in(outline)
    have = {tuple(point): bool(here) for point, here in zip(ij.tolist(), present(ij), strict=True)}
    slow, lost = slow_quadrant_areas(outline, ij, have)
    mine = ij[present(ij)]
    area = quadrant_areas(mine, present, outline)
    np.testing.assert_allclose(area, [slow[tuple(point)] for point in mine.tolist()], atol=1e-12)
    assert area.sum() + lost == pytest.approx(outline.area, rel=1e-12)


def test_quadrants_fill_outlines_that_fit():
    """Edges along the lattice or along its diagonals: nothing is lost but rounding."""
    triangle = shapely.Polygon([(0, 0), (6, 0), (0, 6)])
    diamond = shapely.Polygon([(5, 0), (0, 5), (-5, 0), (0, -5)])
    framed = shapely.box(-6, -6, 6, 6).difference(shapely.box(-2, -2, 2, 2))
    for outline in (
        shapely.box(0, 0, 4, 3),
        shapely.box(-0.3, -0.4, 4.2, 3.1),
        triangle,
        diamond,
        framed,
    ):
        present = present_in(outline)
        ij = around(outline)
        area = quadrant_areas(ij[present(ij)], present, outline)
        assert area.sum() == pytest.approx(outline.area, rel=1e-14)


def test_lost_area_is_of_sharp_corners():
    """Random outlines lose slivers at corners only: nothing of blunt ones, little of any."""
    rng = np.random.default_rng(0)
    shares = []
    for _ in range(60):
        outline = star(rng, 8.0)
        present, ij = present_in(outline), around(outline)
        area = quadrant_areas(ij[present(ij)], present, outline)
        assert (area >= 0).all()
        assert area.max() <= 1.0  # its own quarter, two neighbours' and the corner's
        shares.append(1 - area.sum() / outline.area)
    assert min(shares) > -1e-12
    assert max(shares) < 0.02
    assert np.median(shares) < 1e-4


def test_no_crossovers_no_areas():
    """A rank may have none near the outline."""
    assert quadrant_areas(np.empty((0, 2), int), None, shapely.box(0, 0, 1, 1)).shape == (0, 4)


@pytest.mark.parametrize("seed", [1, 2])
def test_areas_within_many_boxes(seed):
    """Cut in halves or each by itself: the same areas, with holes, too."""
    rng = np.random.default_rng(seed)
    angle = np.linspace(0, 2 * np.pi, 100, endpoint=False)
    radius = 10 * (1 + 0.2 * np.sin(9 * angle))
    centres = [(x, y) for x in range(-5, 6, 2) for y in range(-5, 6, 2)]
    holes = [shapely.box(x - 0.5, y - 0.5, x + 0.5, y + 0.5).exterior.coords for x, y in centres]
    star = np.column_stack([radius * np.cos(angle), radius * np.sin(angle)])
    outline = shapely.Polygon(star, holes)
    low = np.unique(rng.integers(-26, 26, (800, 2)), axis=0) / 2
    boxes = shapely.box(*low.T, *(low.T + 0.5))
    expected = shapely.area(shapely.intersection(outline, boxes))
    np.testing.assert_allclose(areas_within(outline, boxes), expected, rtol=0, atol=1e-14)
