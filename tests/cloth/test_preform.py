# SPDX-License-Identifier: MIT
"""The outline, its edges and the directions."""

import math
import pickle
import time

import numpy as np
import pytest
import shapely

from cruciform_petsc.cloth.fabric import Fabric, YarnFamily
from cruciform_petsc.cloth.preform import Preform
from cruciform_petsc.errors import InputError

TABLE_1 = Fabric.from_library("e-glass-plain-2.4")
UNEVEN = Fabric("f", YarnFamily(1e4, 0.0, 200.0), YarnFamily(1e4, 0.0, 500.0), 50.0)
L_SHAPE = [(0, 0), (4, 0), (4, 1), (1, 1), (1, 3), (0, 3)]


def square(x, y, side=1.0):
    """Corners, counter-clockwise."""
    return [(x, y), (x + side, y), (x + side, y + side), (x, y + side)]


def test_rectangle():
    """Lower edge on y = 0, centred on x = 0, with units or in metres."""
    for preform in (Preform.rectangle("75 mm", "22 cm"), Preform.rectangle(0.075, 0.22)):
        assert preform.outline.bounds == pytest.approx((-0.0375, 0.0, 0.0375, 0.22))
        assert preform.outline.area == pytest.approx(0.075 * 0.22)
        assert preform.bias_angle == pytest.approx(math.pi / 4)
        assert preform.lattice_origin == pytest.approx([0.0, 0.11])


@pytest.mark.parametrize("degrees", [0.0, 30.0, 45.0, 90.0, -20.0, 200.0])
def test_directions(degrees):
    """The warp lies at the bias angle from y; the weft is the warp turned by +90 degrees."""
    b = math.radians(degrees)
    preform = Preform.rectangle(1, 1, f"{degrees} deg")
    assert preform.warp_direction == pytest.approx([math.sin(b), math.cos(b)])
    turn = np.array([[0.0, -1.0], [1.0, 0.0]])
    assert preform.weft_direction == pytest.approx(turn @ preform.warp_direction)
    assert preform.rotation @ preform.warp_direction == pytest.approx([1.0, 0.0])
    assert preform.rotation @ preform.weft_direction == pytest.approx([0.0, 1.0])
    assert np.linalg.det(preform.rotation) == pytest.approx(1.0)


def test_origin():
    """A given origin is kept, with units or in metres."""
    preform = Preform.rectangle(1, 1, origin=["5 mm", 0.25])
    assert preform.lattice_origin == pytest.approx([5e-3, 0.25])


def test_pitch():
    """Along a warp yarn crossovers are as far apart as the weft yarns."""
    assert Preform.rectangle(1, 1).pitch(UNEVEN) == pytest.approx((1 / 500, 1 / 200))
    assert Preform.rectangle(1, 1, refine=4).pitch(UNEVEN) == pytest.approx((1 / 2000, 1 / 800))
    coarse = Preform.rectangle(1, 1, yarns_per_cruciform=3)
    assert coarse.pitch(UNEVEN) == pytest.approx((3 / 500, 3 / 200))


def test_rectangle_edges():
    """Each named edge is one segment with the cloth on its left."""
    preform = Preform.rectangle(2, 3)
    assert preform.edge("lower").tolist() == [[[-1, 0], [1, 0]]]
    assert preform.edge("right").tolist() == [[[1, 0], [1, 3]]]
    assert preform.edge("upper").tolist() == [[[1, 3], [-1, 3]]]
    assert preform.edge("left").tolist() == [[[-1, 3], [-1, 0]]]
    for i, name in enumerate(("lower", "right", "upper", "left")):
        assert np.array_equal(preform.edge(f"outline-{i + 1}"), preform.edge(name))


@pytest.mark.parametrize("points", [L_SHAPE, [L_SHAPE[0], *L_SHAPE[:0:-1]], [*L_SHAPE, (0, 0)]])
def test_polygon_edges(points):
    """Numbered counter-clockwise from the first point, however the corners came."""
    preform = Preform.polygon(points, [square(0.2, 0.2, 0.5)])
    ends = np.array([*L_SHAPE, L_SHAPE[0]], float)
    for i in range(len(L_SHAPE)):
        assert preform.edge(f"outline-{i + 1}").tolist() == [ends[i : i + 2].tolist()]
    assert "outline-7" not in preform.edges
    assert preform.edge("upper").tolist() == [[[1, 3], [0, 3]]]
    assert preform.edge("right").tolist() == [[[4, 0], [4, 1]]]
    assert preform.edge("hole-1").shape == (4, 2, 2)


def test_an_edge_in_two_pieces():
    """All segments at the largest y belong to the upper edge."""
    fork = [(0, 0), (3, 0), (3, 2), (2, 2), (2, 1), (1, 1), (1, 2), (0, 2)]
    assert Preform.polygon(fork).edge("upper").tolist() == [[[3, 2], [2, 2]], [[1, 2], [0, 2]]]


def test_cloth_lies_on_the_left_of_every_segment():
    """Outward normals follow from the order of the ends, on holes too."""
    preform = Preform.polygon(square(0, 0, 10)[::-1], [square(2, 2), square(6, 6)[::-1]])
    for segments in preform.edges.values():
        along = segments[:, 1] - segments[:, 0]
        left = np.stack([-along[:, 1], along[:, 0]], axis=1)
        inside = shapely.contains_xy(preform.outline, segments.mean(axis=1) + 1e-3 * left)
        assert inside.all()


def test_repeated_points_make_no_segments():
    """A corner given twice is one corner."""
    preform = Preform.polygon([(0, 0), (1, 0), (1, 0), (1, 1), (0, 1)])
    assert [name for name in preform.edges if "-" in name] == [f"outline-{i}" for i in range(1, 5)]


def test_pointed_end():
    """Where nothing straight lies at the top there is no upper edge, and the message says so."""
    preform = Preform.polygon([(0, 0), (1, 0), (0.5, 1)])
    with pytest.raises(InputError) as caught:
        preform.edge("upper")
    assert str(caught.value) == (
        'preform has no edge "upper" (no straight piece of the outline lies at its largest y, '
        "known: lower, outline-1 to outline-3)"
    )


def test_unknown_edge():
    """The closest and all known names are told."""
    with pytest.raises(InputError) as caught:
        Preform.polygon(square(0, 0, 9), [square(1, 1)]).edge("uper")
    assert str(caught.value) == (
        'preform has no edge "uper" (did you mean "upper"? '
        "known: lower, upper, left, right, outline-1 to outline-4, hole-1)"
    )


def test_own_edges():
    """A user's edge lies on the outline and is turned to have the cloth on its left."""
    preform = Preform.rectangle(2, 1, edges={"half": [[[0, 0], [-1, 0]]]})
    assert preform.edge("half").tolist() == [[[-1, 0], [0, 0]]]
    assert preform.edge("upper").tolist() == [[[1, 1], [-1, 1]]]
    for segments, message in [
        ([[[0, 0], [0, 0.5]]], 'edge "half" does not lie on preform.outline'),
        ([[0, 0], [1, 0]], r'edge "half" must have the shape \(n, 2, 2\), got \(2, 2\)'),
        ([[[0, 0], [0, 0]]], 'edge "half" has a segment without length'),
    ]:
        with pytest.raises(InputError, match=message):
            Preform.rectangle(2, 1, edges={"half": segments})


@pytest.mark.parametrize(
    ("points", "holes", "message"),
    [
        (
            [(0, 0), (1, 1), (1, 0), (0, 1)],
            [],
            "preform.outline crosses or touches itself at x = 500 mm, y = 500 mm, "
            "it must be a simple polygon",
        ),
        (
            [(0, 0), (2, 0), (2, 2), (1, 0), (0, 2)],
            [],
            "preform.outline crosses or touches itself at x = 1000 mm, y = 0 mm, "
            "it must be a simple polygon",
        ),
        ([(0, 0), (1, 1), (2, 2)], [], "preform.outline has no area, its corners lie on one line"),
        (
            [(0, 0), (1, 0), (0, 0)],
            [],
            "preform.outline.polygon must have at least 3 different corners, got 2",
        ),
        (
            square(0, 0, 9),
            [square(1, 1), square(2, 2)],
            "hole-1 and hole-2 of preform.outline touch or overlap, "
            "make one hole of them or move them apart",
        ),
        (
            square(0, 0, 9),
            [square(1, 1, 5), square(2, 2)],
            "hole-1 and hole-2 of preform.outline touch or overlap, "
            "make one hole of them or move them apart",
        ),
        (
            square(0, 0, 9),
            [square(0, 2)],
            "hole-1 of preform.outline (1000 mm x 1000 mm) touches or leaves the outline "
            "(9000 mm x 9000 mm), it must lie wholly inside",
        ),
        (
            square(0, 0, 9),
            [square(1, 1), square(20, 2)],
            "hole-2 of preform.outline (1000 mm x 1000 mm) touches or leaves the outline "
            "(9000 mm x 9000 mm), it must lie wholly inside",
        ),
        (
            square(0, 0, 9),
            [[(1, 1), (2, 2), (2, 1), (1, 2)]],
            "hole-1 crosses or touches itself at x = 1500 mm, y = 1500 mm, "
            "it must be a simple polygon",
        ),
        (
            [(0, 0), (1, 0), ("1 mm",)],
            [],
            "preform.outline.polygon[2] must be a list of 2, got 1",
        ),
        (
            square(0, 0, 9),
            [[(1, 1), (2, "2 N"), (2, 1)]],
            'preform.outline.holes[0][1][1] = "2 N" has the unit "N", which is not that of a '
            'length like "1 mm"',
        ),
    ],
)
def test_bad_outlines(points, holes, message):
    """Each names the culprit, and where it can the place."""
    with pytest.raises(InputError) as caught:
        Preform.polygon(points, holes)
    assert str(caught.value) == message


def test_shapely_outlines():
    """A ready polygon is checked the same way; several are not one."""
    two = shapely.MultiPolygon([shapely.Polygon(square(0, 0)), shapely.Polygon(square(3, 3))])
    for outline in (two, shapely.Polygon()):
        with pytest.raises(InputError, match="preform.outline must be one polygon"):
            Preform(outline, "0 deg")
    with pytest.raises(InputError, match="preform.outline crosses"):
        Preform(shapely.Polygon([(0, 0), (1, 1), (1, 0), (0, 1)]), "0 deg")


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"refine": 0}, "preform.refine must be a whole number from 1 up, got 0"),
        ({"refine": 1.0}, "preform.refine must be a whole number, got 1.0"),
        ({"refine": True}, "preform.refine must be a whole number, got True"),
        (
            {"yarns_per_cruciform": -1},
            "preform.yarns_per_cruciform must be a whole number from 1 up, got -1",
        ),
        (
            {"refine": 2, "yarns_per_cruciform": 3},
            "preform.refine = 2 and preform.yarns_per_cruciform = 3 undo each other, "
            "leave one of them at 1",
        ),
        (
            {"bias_angle": 45.0},
            'preform.bias_angle = 45 rad is more than a full turn, did you mean "45 deg"?',
        ),
        (
            {"bias_angle": "45 mm"},
            'preform.bias_angle = "45 mm" has the unit "mm", which is not that of an angle '
            'like "45 deg"',
        ),
        (
            {"origin": ("1 mm",)},
            "preform.origin must be a list of 2, got 1",
        ),
    ],
)
def test_bad_options(options, message):
    """Counts, angle and origin."""
    with pytest.raises(InputError) as caught:
        Preform.rectangle(1, 1, **options)
    assert str(caught.value) == message


@pytest.mark.parametrize("sides", [("0 mm", "1 mm"), ("1 mm", "-1 mm")])
def test_bad_rectangle(sides):
    """Sides are positive."""
    with pytest.raises(InputError, match=r"^preform\.outline\.rectangle\[\d\] must be positive"):
        Preform.rectangle(*sides)


MM = 1e-3
SLIVER = [(0.0, 0.0), (20 * MM, 19 * MM), (20 * MM, 20 * MM)]
STRIP = [(0.0, 0.0), (2 * MM, -2 * MM), (42 * MM, 38 * MM), (40 * MM, 40 * MM)]  # along the warp


@pytest.mark.parametrize(
    ("outline", "bias"),
    [
        (SLIVER, "0 deg"),  # by its area only
        ([(0, 0), (3 * MM, 0), (3 * MM, 400 * MM), (0, 400 * MM)], "45 deg"),  # width only
        (STRIP, "45 deg"),  # its weft yarns only: shorter than a pitch
    ],
)
def test_smaller_than_a_cruciform(outline, bias):
    """Area, width and yarns can be too small; a finer network has room in each."""
    with pytest.raises(InputError, match=r"is smaller than one cruciform .* raise preform.refine$"):
        Preform.polygon(outline, (), bias).check_size(TABLE_1)
    Preform.polygon(outline, (), bias, refine=8).check_size(TABLE_1)


def test_one_cruciform_is_enough():
    """Exactly one pitch cell passes, and a coarse network is told to be less coarse."""
    h = 1 / 240.0
    Preform.rectangle(h * (1 - 1e-12), h, "0 deg").check_size(TABLE_1)
    coarse = Preform.rectangle(9 * h, 9 * h, "0 deg", yarns_per_cruciform=10)
    with pytest.raises(InputError, match="or lower preform.yarns_per_cruciform$"):
        coarse.check_size(TABLE_1)


def test_pickles_and_repr():
    """A preform travels between ranks; its repr gives the size."""
    preform = pickle.loads(pickle.dumps(Preform.rectangle("2.4 cm", "3.6 cm", refine=2)))
    assert repr(preform) == (
        "Preform(24 mm x 36 mm, area 8.64 cm^2, 0 holes, bias 45 deg, refine 2, "
        "yarns_per_cruciform 1)"
    )


def test_thousands_of_holes():
    """Not all pairs of them are looked at: 3,600 take under a second; two that touch are found."""
    begin = time.process_time()
    holes = [square(2 * i + 1, 2 * j + 1) for i in range(60) for j in range(60)]
    outline = [[f"{x} m" for x in corner] for corner in square(0, 0, 122)]
    assert len(Preform.polygon(outline, holes).edges) > 3600
    with pytest.raises(InputError, match="hole-1201 and hole-3601 of preform.outline touch"):
        Preform.polygon(outline, [*holes, square(2 * 20 + 2, 1)])
    assert time.process_time() - begin < 6.0


SHEET = ("20 mm", "30 mm", "0 deg")


@pytest.mark.parametrize(
    ("options", "sentence"),
    [
        (
            {"slits": [[["0 mm", "10 mm"]]]},
            r"preform.outline.slits\[0\] must be a list of 2, got 1",
        ),
        ({"slits": [[["0 mm", "10 mm"]] * 2]}, r"preform.outline.slits\[0\] has no length"),
        (
            {"slits": [[[0, 0.01], [0.005, 0.01], [0.005, 0.02], [0.002, 0.005]]]},
            r"preform.outline.slits\[0\] crosses itself",
        ),
        (
            {"slits": [[["0 mm", "40 mm"], ["9 mm", "50 mm"]]]},
            r"preform.outline.slits\[0\] lies beside the cloth, it cuts nothing",
        ),
        ({"slits": [[["-20 mm", "9 mm"], ["20 mm", "9 mm"]]]}, "leave 2 pieces of cloth"),
        (
            {"darts": [[["0 mm", "0 mm"], ["1 mm", "0 mm"], ["2 mm", "0 mm"]]]},
            r"preform.outline.darts\[0\] has no area",
        ),
        (
            {"darts": [[["-50 mm", "-50 mm"], ["50 mm", "-50 mm"], ["0 mm", "500 mm"]]]},
            "leave no pieces of cloth",
        ),
    ],
)
def test_cuts_refused(options, sentence):
    with pytest.raises(InputError, match=sentence):
        Preform.rectangle(*SHEET, **options)


def test_slits_and_darts():
    """A slit inside is a hole, behind those that are told; from the edge it is a notch."""
    hole = [["-2 mm", "5 mm"], ["2 mm", "5 mm"], ["0 mm", "8 mm"]]
    slit = [["-6 mm", "20 mm"], ["0 mm", "24 mm"], ["6 mm", "20 mm"]]
    preform = Preform.rectangle(*SHEET, holes=[hole], slits=[slit])
    assert [len(preform.edges[f"hole-{i}"]) for i in (1, 2)] == [3, 6]
    assert preform.outline.area == pytest.approx(594e-6, rel=1e-4)
    slit = [["-11 mm", "15 mm"], ["0 mm", "15 mm"]]
    dart = [["6 mm", "-1 mm"], ["8 mm", "-1 mm"], ["7 mm", "4 mm"]]
    preform = Preform.rectangle(*SHEET, slits=[slit], darts=[dart])
    assert not preform.outline.interiors
    assert len(preform.edges["left"]) == len(preform.edges["lower"]) == 2
    assert preform.outline.area == pytest.approx(600e-6 - 0.5 * 4e-3 * 1.6e-3, rel=1e-4)
