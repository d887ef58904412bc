# SPDX-License-Identifier: MIT
"""Outlines: usual shapes, drawings, and edges by names of one's own."""

import json
import pickle
import re
import textwrap
import tomllib
from pathlib import Path

import numpy as np
import pytest
import shapely
from mpi4py import MPI

from cruciform_petsc import Case, InputError, Preform
from cruciform_petsc.case.schema import OutputTable
from cruciform_petsc.cloth.drawing import outline_of, read_drawing
from cruciform_petsc.cloth.fabric import Fabric
from cruciform_petsc.cloth.preform import OutlineTable, PreformTable
from cruciform_petsc.net.network import Network
from cruciform_petsc.output.checkpoint import determines

PI = np.pi


def length(segments):
    return np.linalg.norm(segments[:, 1] - segments[:, 0], axis=1).sum()


def table(outline, **more):
    return PreformTable.from_data({"outline": outline, "bias_angle": "0 deg", **more}, "preform")


@pytest.mark.parametrize(
    ("outline", "area", "edges"),
    [
        ({"circle": "300 mm"}, PI * 0.15**2, {"rim": PI * 0.3}),
        ({"ellipse": ["200 mm", "300 mm"]}, PI * 0.1 * 0.15, {"rim": 0.7932720}),
        ({"slot": ["40 mm", "120 mm"]}, PI * 0.02**2 + 0.04 * 0.08,
         {"arc-1": PI * 0.02, "arc-2": PI * 0.02, "left": 0.08, "right": 0.08}),
        ({"slot": ["120 mm", "40 mm"]}, PI * 0.02**2 + 0.04 * 0.08,
         {"arc-1": PI * 0.02, "arc-2": PI * 0.02, "lower": 0.08, "upper": 0.08}),
        ({"rectangle": ["100 mm", "60 mm"], "corner_radius": "10 mm"},
         0.1 * 0.06 - (4 - PI) * 0.01**2,
         {"corner-1": PI * 0.005, "corner-4": PI * 0.005, "lower": 0.08, "left": 0.04}),
        ({"rectangle": ["40 mm", "40 mm"], "corner_radius": "20 mm"}, PI * 0.02**2,
         {"corner-2": PI * 0.01}),
    ],
)  # fmt: skip
def test_shapes(outline, area, edges):
    """Areas and lengths of the curves, to some 1e-4; x about 0, y from 0; also in Python."""
    preform = table(outline).build()
    assert preform.outline.area == pytest.approx(area, rel=3e-4)
    x_min, y_min, x_max, y_max = preform.outline.bounds
    assert (x_min + x_max, y_min) == pytest.approx((0.0, 0.0), abs=1e-12)
    size = next(value for key, value in outline.items() if key != "corner_radius")
    sides = size if isinstance(size, list) else [size, size]
    assert [f"{1e3 * side:.6g} mm" for side in (x_max - x_min, y_max - y_min)] == sides
    for name, long in edges.items():
        assert length(preform.edge(name)) == pytest.approx(long, rel=3e-4), name
    same = Preform.shape(outline, "0 deg")
    assert same.outline.equals(preform.outline)
    assert list(same.edges) == list(preform.edges)


def test_corners_are_where_they_are_said_to_be():
    """corner-1 upper right, then counter-clockwise; arc-1 of a slot above."""
    rounded = table({"rectangle": ["100 mm", "60 mm"], "corner_radius": "10 mm"}).build()
    for i, (x, y) in enumerate([(1, 1), (-1, 1), (-1, -1), (1, -1)]):
        middle = rounded.edge(f"corner-{i + 1}").mean(axis=(0, 1)) - (0.0, 0.03)
        assert (np.sign(middle) == (x, y)).all()
    slot = table({"slot": ["40 mm", "120 mm"]}).build()
    assert slot.edge("arc-1").mean(axis=(0, 1))[1] > 0.1


def test_edges_keep_their_names_where_a_blank_is_centred():
    """Also such as begin like those that are given automatically."""
    edges = {"left-grip": {"start": ["-50 mm", "60 mm"], "end": ["-50 mm", "0 mm"]},
             "outline": {"of": ["outline-1", "outline-2"]}, "right": {"of": ["upper"]}}  # fmt: skip
    preform = table({"rectangle": ["100 mm", "60 mm"]}, edges=edges).build()
    centred = preform.centred()
    assert preform.edge("right").tolist() == preform.edge("upper").tolist()
    for name in ("left-grip", "outline", "left", "upper", "right"):
        moved = preform.edge(name) - (0.0, 0.03)
        np.testing.assert_allclose(centred.edge(name), moved, atol=1e-15)
    assert length(table({"circle": "1 cm"}).build().centred().edge("rim")) > 0.031


def test_what_is_left_of_a_curve_that_is_cut():
    """A dart takes a piece out of a rim, a slit next to nothing; a dart over an arc, it all."""
    dart = [["90 mm", "80 mm"], ["160 mm", "100 mm"], ["160 mm", "200 mm"]]
    slit = [["0 mm", "-10 mm"], ["0 mm", "100 mm"]]
    whole = PI * 0.3
    rim = table({"circle": "300 mm", "darts": [dart]}).build().edge("rim")
    assert 0.7 * whole < length(rim) < 0.97 * whole
    rim = table({"circle": "300 mm", "slits": [slit]}).build().edge("rim")
    assert 0.98 * whole < length(rim) < whole
    corner = [["60 mm", "50 mm"], ["60 mm", "70 mm"], ["20 mm", "70 mm"], ["20 mm", "20 mm"]]
    outline = {"rectangle": ["100 mm", "60 mm"], "corner_radius": "10 mm", "darts": [corner]}
    edges = table(outline).build().edges
    assert "corner-1" not in edges
    assert "corner-3" in edges


def test_slits_along_yarns_are_asked_about():
    """They take crossovers away; where the question says, they take none, at any pitch."""
    yarn = {"modulus": "200 N/cm", "poisson": 0, "yarns": "2 /cm", "yarn_bending": "0.1 N mm^2"}
    fabric = Fabric.from_table("f", {"warp": yarn, "weft": yarn, "shear": {"modulus": "1 N/cm"}})

    def crossovers(preform):
        return Network(MPI.COMM_SELF, preform, fabric).num_crossovers_global

    def cut(**more):
        return Preform.shape({"cross": ["90 mm", "30 mm"], **more}, "0 deg", origin=origin)

    origin = None
    assert cut().questions(fabric) == []
    on = cut(arm_slits=5)
    assert crossovers(on) < crossovers(cut())
    (question,) = on.questions(fabric)
    assert question == (
        "10 yarns lie on slits of the outline and end there, as if cut away: "
        "moving preform.origin by -2.5 mm in x and 2.5 mm in y puts the slits between yarns"
    )
    origin = (-0.0025, 0.0475)
    assert cut(arm_slits=5).questions(fabric) == []
    assert crossovers(cut(arm_slits=5)) == crossovers(cut())
    (question,) = cut(arm_slits=11).questions(fabric)  # 2.5 mm apart
    assert question.endswith("as if cut away: choose slits that fit between the yarns")
    # One slit along one yarn, a side along another.
    origin = (0.0, 0.0)
    one = {"rectangle": ["30 mm", "40 mm"], "slits": [[["5 mm", "10 mm"], ["5 mm", "40 mm"]]]}
    (question,) = Preform.shape(one, "0 deg", origin=origin).questions(fabric)
    assert question.startswith("1 yarn lies on a slit of the outline and ends there")


def test_edges_between_points():
    """Counter-clockwise from start to end, over the beginning of the ring too, and of a hole."""
    hole = [["20 mm", "20 mm"], ["30 mm", "20 mm"], ["30 mm", "40 mm"], ["20 mm", "40 mm"]]
    preform = table(
        {"rectangle": ["100 mm", "60 mm"], "holes": [hole]},
        edges={
            "short": {"start": ["-30 mm", "0 mm"], "end": ["50 mm", "10 mm"]},
            "long": {"start": ["50 mm", "10 mm"], "end": ["-30 mm", "0 mm"]},
            "near": {"start": ["-30 mm", "0.02 mm"], "end": ["0 mm", "0 mm"]},
            "window": {"start": ["30 mm", "20 mm"], "end": ["20 mm", "20 mm"]},
            "both": {"of": ["left", "right"]},
        },
    ).build()
    lengths = {name: length(preform.edge(name)) for name in ("short", "long", "near", "window")}
    assert lengths == pytest.approx({"short": 0.09, "long": 0.23, "near": 0.03, "window": 0.01})
    assert length(preform.edge("both")) == pytest.approx(0.12)
    along = np.diff(preform.edge("short"), axis=1)[:, 0]
    assert (along >= -1e-12).all()  # right, then up: the cloth is on the left


@pytest.mark.parametrize(
    ("outline", "more", "message"),
    [
        ({"circle": "1 cm", "slot": ["1 cm", "2 cm"]}, {},
         "preform.outline needs exactly one of rectangle, circle, ellipse, slot, cross, "
         "polygon and file"),
        ({"circle": "0 mm"}, {}, 'preform.outline.circle must be positive, got "0 mm"'),
        ({"circle": 3}, {}, "preform.outline.circle is the bare number 3, give it a unit"),
        ({"ellipse": ["1 cm"]}, {}, "preform.outline.ellipse must be a list of 2, got 1"),
        ({"circle": "1 cm", "corner_radius": "1 mm"}, {},
         "preform.outline.corner_radius is of a rectangle"),
        ({"rectangle": ["4 cm", "2 cm"], "corner_radius": "11 mm"}, {},
         'preform.outline.corner_radius must be at most half the width and half the length, '
         '10 mm, got "11 mm"'),
        ({"circle": "1 cm", "unit": "mm"}, {}, "preform.outline.unit is of a file's numbers"),
        ({"file": "blank.pdf"}, {}, 'preform.outline.file: "blank.pdf" is no drawing that can be'),
        ({"circle": "1 cm"}, {"edges": {"a": {"of": ["rin"]}}},
         'preform.edges.a.of: preform has no edge "rin" (did you mean "rim"?'),
        ({"circle": "1 cm"}, {"edges": {"a, b": {"of": ["rim"]}}},
         "preform.edges has the name 'a, b', letters, digits, - and _ can be"),
        ({"circle": "1 cm"}, {"edges": {"a": {"of": []}}},
         "preform.edges.a.of must be a list of at least 1, got 0"),
        ({"circle": "1 cm"}, {"edges": {"a": {"of": ["rim"], "start": ["0 mm", "0 mm"]}}},
         "preform.edges.a needs either of, or start and end"),
        ({"circle": "1 cm"}, {"edges": {"a": {"end": ["0 mm", "0 mm"]}}},
         "preform.edges.a needs either of, or start and end"),
        ({"rectangle": ["1 cm", "1 cm"]},
         {"edges": {"a": {"start": ["0 mm", "0 mm"], "end": ["0 mm", "4 mm"]}}},
         "preform.edges.a.end lies 4 mm off the line of the outline on which start is"),
        ({"rectangle": ["1 cm", "1 cm"]},
         {"edges": {"a": {"start": ["0 mm", "0 mm"], "end": ["0 mm", "0 mm"]}}},
         "preform.edges.a has no length, its start and end are one point"),
    ],
)  # fmt: skip
def test_outlines_that_cannot_be(outline, more, message):
    with pytest.raises(InputError) as caught:
        table(outline, **more).build()
    assert str(caught.value).startswith(message)


# -- drawings: lines that meet ---------------------------------------------------------------------


def square(size, x=0.0, y=0.0, name=""):
    """Four lines in no order and direction, as a draughtsman leaves them."""
    corner = size * np.array([[0, 0], [1, 0], [1, 1], [0, 1]]) + (x, y)
    pairs = [(0, 1), (2, 1), (3, 2), (3, 0)]
    return [(f"{name}{k}" if name else "", corner[list(pair)]) for k, pair in enumerate(pairs)]


def test_lines_become_an_outline():
    """A hole within; pieces by their names; ends that nearly meet."""
    lines = square(1.0, name="side-")
    lines[1] = (lines[1][0], lines[1][1] + 3e-5)
    outline, edges = outline_of(square(0.2, 0.3, 0.3) + lines)
    assert outline.area == pytest.approx(1.0 - 0.04, rel=1e-4)
    assert len(outline.interiors) == 1
    assert sorted(edges) == ["side-0", "side-1", "side-2", "side-3"]
    preform = Preform(outline, 0.0, edges=edges)
    assert length(preform.edge("side-1")) == pytest.approx(1.0, rel=1e-4)


@pytest.mark.parametrize(
    ("lines", "message"),
    [
        ([], "shows no lines"),
        (square(1.0)[:3], "has a loose end near x = "),
        ([*square(1.0), ("", np.array([[0.0, 0.5], [0.4, 0.5]]))], "has a loose end near x = "),
        (square(1.0) + square(0.5, 2.0), "shows several outlines, or a line across one"),
        ([*square(1.0), ("", np.array([[0.0, 0.5], [1.0, 0.5]]))], "shows several outlines"),
        (square(1.0) + square(1.0, 0.5, 0.5), "shows several outlines"),
    ],
)
def test_lines_that_are_no_outline(lines, message):
    with pytest.raises(InputError) as caught:
        outline_of(lines)
    assert str(caught.value).startswith(message)


@pytest.mark.parametrize("name", ["blank.dxf", "blank.svg"])
def test_packages_that_are_missing(name, tmp_path, monkeypatch):
    """One sentence says which."""
    import sys

    package = {"blank.dxf": "ezdxf", "blank.svg": "svgelements"}[name]
    monkeypatch.setitem(sys.modules, package, None)
    with pytest.raises(
        InputError, match=rf"{name}\" needs {package} .pip install {package}., which"
    ):
        read_drawing(tmp_path / name)


@pytest.mark.parametrize("kind", ["bias-extension", "forming"])
def test_a_changed_drawing_is_another_case(tmp_path, monkeypatch, kind):
    """Read where the case is read, from its folder; what a checkpoint compares is what it shows."""
    sides = [shapely.box(0.0, 0.0, 0.04, long) for long in (0.08, 0.08, 0.09)]
    read = []

    def drawn(path, unit):
        read.append((path, unit))
        side = sides[len(read) - 1]
        return side, {"top": np.array([[[0.04, side.bounds[3]], [0.0, side.bounds[3]]]])}

    monkeypatch.setattr("cruciform_petsc.cloth.preform.read_drawing", drawn)
    text = (
        '[fabric]\nuse = "glass-pp-plain-1.93"\n[preform]\nbias_angle = "45 deg"\n'
        'outline = { file = "blank.dxf", unit = "cm" }\nedges = { grip = { of = ["lower"] } }\n'
    )
    if kind == "forming":
        tool = '[[tool]]\nname = "die"\nshape = { sphere = { radius = "9 mm" } }\n'
        text += f'[test]\nkind = "forming"\ngravity = true\n{tool}[[stage]]\nname = "rest"\n'
    else:
        text += '[test]\nextension = "1 mm"\n'
    (tmp_path / "case.toml").write_text(text)
    cases = [Case.load(tmp_path / "case.toml") for _ in range(2)]
    assert read[0] == (str(tmp_path / "blank.dxf"), pytest.approx(0.01))
    assert len(read) == 2
    known = determines(cases[0])
    assert determines(cases[1]) == known
    assert len(read) == 2
    assert {"top", "grip"} <= cases[0].preform().edges.keys()
    assert determines(Case.load(tmp_path / "case.toml")) != known


# -- DXF -------------------------------------------------------------------------------------------


@pytest.fixture
def dxf(tmp_path):
    """A blank 200 x 100 with a rounded end, a hole in a block, a text; layer "grip" at its left."""
    import ezdxf

    drawing = ezdxf.new(units=4)
    space = drawing.modelspace()
    space.add_line((200, 0), (0, 0))
    space.add_arc((200, 50), 50, -90, 90, dxfattribs={"layer": "round"})
    space.add_line((200, 100), (0, 100), dxfattribs={"layer": "Upper side, 2"})
    space.add_lwpolyline([(0, 100), (0, 50), (0, 0)], dxfattribs={"layer": "grip"})
    block = drawing.blocks.new("hole")
    block.add_circle((0, 0), 1.0)
    space.add_blockref("hole", (100, 50), dxfattribs={"xscale": 20, "yscale": 20})
    space.add_text("Blank 7, left")
    path = tmp_path / "blank.dxf"
    drawing.saveas(path)
    return path


def test_dxf(dxf):
    """Arcs, polylines, blocks; millimetres by its header, or as told."""
    outline, edges = read_drawing(dxf)
    area = 0.2 * 0.1 + 0.5 * PI * 0.05**2 - PI * 0.02**2
    assert outline.area == pytest.approx(area, rel=5e-4)
    assert sorted(edges) == ["Upper-side-2", "grip", "round"]
    preform = Preform(outline, 0.0, edges=edges)
    assert length(preform.edge("grip")) == pytest.approx(0.1)
    assert length(preform.edge("round")) == pytest.approx(PI * 0.05, rel=1e-3)
    assert preform.edge("grip")[0, 0, 1] > preform.edge("grip")[0, 1, 1]  # the cloth on its left
    assert read_drawing(dxf, 0.0254)[0].area == pytest.approx(area * 25.4**2, rel=5e-4)


def test_a_case_with_a_drawing(dxf, tmp_path):
    """Beside the case file; kept by copies that other ranks get, and by the dump."""
    (tmp_path / "case.toml").write_text(
        '[fabric]\nuse = "e-glass-plain-2.4"\n[preform]\noutline = { file = "blank.dxf" }\n'
        'bias_angle = "45 deg"\n[test]\nextension = "1 mm"\n'
    )
    assert Case.load(tmp_path / "case.toml").preform().size == pytest.approx((0.25, 0.1))
    given = table({"file": str(dxf)}, edges={"both": {"of": ["grip", "round"]}})
    preform = given.build()
    assert length(preform.edge("both")) == pytest.approx(0.1 + PI * 0.05, rel=1e-3)
    assert given.outline.drawn.startswith("POLYGON")
    dxf.unlink()
    assert pickle.loads(pickle.dumps(given)).build().outline.equals(preform.outline)
    assert json.loads(json.dumps(given.model_dump(mode="json")))["outline"]["file"] == str(dxf)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (b"", "is no DXF file"),
        (b"  0\nSECTION\n  2\nENTI", "is no DXF file"),
        (b"\x00\x01\xff" * 50, "is no DXF file"),
    ],
)
def test_damaged_dxf(tmp_path, text, message):
    path = tmp_path / "x.dxf"
    path.write_bytes(text)
    with pytest.raises(InputError, match=message):
        read_drawing(path)


def test_dxf_without_unit(dxf):
    """It is asked for."""
    import ezdxf

    drawing = ezdxf.readfile(dxf)
    drawing.units = 0
    drawing.saveas(dxf)
    with pytest.raises(InputError, match='does not tell its unit, write for example unit = "mm"'):
        read_drawing(dxf)
    assert read_drawing(dxf, 1e-3)[0].bounds == pytest.approx((0.0, 0.0, 0.25, 0.1))


# -- SVG -------------------------------------------------------------------------------------------

SVG = """<svg xmlns="http://www.w3.org/2000/svg" {head}
     xmlns:inkscape="http://www.inkscape.org/namespaces/inkscape">
  <g transform="translate(10,20)">
    <path d="M 0 0 L 100 0" inkscape:label="top" id="p1"/>
    <path d="M 100 0 A 25 25 0 0 1 100 50 L 0 50"/>
    <path d="M 0 50 V 0" id="grip"/>
    <circle cx="50" cy="25" r="10"/>
  </g>
</svg>
"""


@pytest.mark.parametrize(
    ("head", "unit", "scale"),
    [
        ('width="200mm" height="100mm" viewBox="0 0 200 100"', None, 1e-3),
        ('width="20cm" height="10cm" viewBox="0,0,100,50"', None, 2e-3),
        ('width="96mm"', None, 0.0254 / 96),
        ('width="200"', 1e-2, 1e-2),
        ("", 1e-3, 1e-3),
    ],
)
def test_svg(tmp_path, head, unit, scale):
    """Transforms, arcs, shapes; labels before ids; y upwards."""
    path = tmp_path / "blank.svg"
    path.write_text(SVG.format(head=head))
    outline, edges = read_drawing(path, unit)
    area = 100 * 50 + 0.5 * PI * 25**2 - PI * 10**2
    assert outline.area == pytest.approx(area * scale**2, rel=1e-3)
    assert sorted(edges) == ["grip", "top"]
    top = edges["top"][:, :, 1] / scale
    np.testing.assert_allclose(top, -20.0)
    assert outline.bounds[3] == pytest.approx(-20.0 * scale)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "is no SVG file, or is damaged"),
        (SVG.format(head='width="200"'), "does not tell its unit"),
        (SVG.format(head='width="2mm" viewBox="0 0 x 1"'), "damaged: could not convert .*x"),
        (
            SVG.replace("L 100 0", "L oops").format(head=""),
            "SVG file, or is damaged|loose end|unit",
        ),
    ],
)
def test_damaged_svg(tmp_path, text, message):
    path = tmp_path / "x.svg"
    path.write_text(text)
    with pytest.raises(InputError, match=message):
        read_drawing(path)


def test_files_that_are_not_there(tmp_path):
    for suffix in ("dxf", "svg"):
        with pytest.raises(InputError, match=r"cannot be read: No such file or directory"):
            OutlineTable.from_data({"file": str(tmp_path / f"none.{suffix}")}, "preform.outline")


def test_the_examples_of_the_docs():
    """docs/outlines.md: each shape in it, and the edges."""
    page = (Path(__file__).parents[2] / "docs" / "outlines.md").read_text(encoding="utf-8")
    blocks = [textwrap.dedent(block) for block in re.findall(r"\n\n((?:    .*\n)+)", page)]
    lines = [line for line in blocks[0].splitlines() if "file" not in line]
    assert len(lines) == 7
    for line in lines:
        assert table(tomllib.loads(line)["outline"]).build().outline.area > 0.0
    polygon = [["0 mm", "0 mm"], ["80 mm", "0 mm"], ["80 mm", "90 mm"], ["0 mm", "90 mm"]]
    edges = tomllib.loads(blocks[1])["preform"]["edges"]
    preform = table({"polygon": polygon}, edges=edges).build()
    assert length(preform.edge("grip")) == pytest.approx(0.17)


@pytest.mark.parametrize("outline", [{"circle": "40 mm"}, {"slot": ["40 mm", "40 mm"]}])
def test_parts_lie_around_the_centre(outline):
    """Of a forming: what the cloth is trimmed to, like a rectangle; polygons lie as they are."""
    part = OutputTable.from_data({"part_outline": outline}, "output").part
    assert part.bounds == pytest.approx((-0.02, -0.02, 0.02, 0.02))
    polygon = [["0 mm", "0 mm"], ["80 mm", "0 mm"], ["80 mm", "90 mm"]]
    part = OutputTable.from_data({"part_outline": {"polygon": polygon}}, "output").part
    assert part.bounds == pytest.approx((0.0, 0.0, 0.08, 0.09))


def test_shapes_are_simple():
    """Valid polygons, counter-clockwise, without repeated corners."""
    for outline in ({"slot": ["40 mm", "40 mm"]}, {"ellipse": ["1 mm", "10 m"]}):
        ring = table(outline).build().outline.exterior
        assert ring.is_ccw
        assert ring.is_valid
        assert shapely.remove_repeated_points(ring).equals_exact(ring, 0.0)
