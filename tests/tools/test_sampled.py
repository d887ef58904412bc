# SPDX-License-Identifier: MIT
"""Surfaces from files: how exact their grids are, what is refused, what is kept in the cache."""

import importlib.util
import itertools
import os
import sys
import time
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial import ConvexHull
from support.toolfiles import torus, torus_distance, write_obj, write_ply, write_stl

from cruciform_petsc.errors import InputError
from cruciform_petsc.tools import sampled
from cruciform_petsc.tools.facets import checked, height_facets
from cruciform_petsc.tools.sampled import Sampled, from_file, height_field
from cruciform_petsc.tools.shapes import Box, opening, sphere
from cruciform_petsc.tools.surface import touch

MM = 1e-3


def shell(shape, count, width, seed=0):
    """Points within a width of a shape's surface."""
    low, high = shape.box
    random = np.random.default_rng(seed)
    points = random.uniform(low - width, high + width, (40 * count, 3))
    return points[np.abs(shape.look(points)[0]) < width][:count]


@pytest.fixture(scope="module")
def ball():
    """Points (mm) and facets of a sphere of radius 20 mm."""
    points, facets = sphere(0.02).facets(2e-5)
    return points / MM, facets


def test_error_falls_with_facets_and_cell():
    """On a sphere and on a torus, with facets as large as the cells."""
    exact = sphere(0.02)
    points = shell(exact, 3000, 1.5e-3)
    truth = exact.look(points)
    errors = []
    for cell in (2e-3, 1e-3):
        facets = exact.facets(cell**2 / (8.0 * 0.02))  # sag of a facet of the cell's size
        grid = Sampled.of_body(checked("ball", *facets, None), cell)
        off = [np.abs(a - b) for a, b in zip(grid.look(points), truth, strict=True)]
        errors.append([off[0].max(), np.percentile(off[1], 98)])  # facets at the poles are slivers
    coarse, fine = np.array(errors)
    assert (fine < [0.4, 0.7] * coarse).all()  # distance, normal
    assert (fine < [2e-6, 1e-3]).all()  # m, 1

    points = np.random.default_rng(5).uniform(-0.03, 0.03, (20000, 3))
    truth = torus_distance(points, 0.02, 0.008)
    points, truth = points[np.abs(truth) < 1.5e-3], truth[np.abs(truth) < 1.5e-3]
    off = []
    for number in (30, 60):
        body = checked("torus", *torus(0.02, 0.008, 2 * number, number), None)
        look = Sampled.of_body(body, 0.04 / number).look(points)
        off.append(np.abs(look[0] - truth).max())
    assert off[1] < 0.35 * off[0]
    assert off[1] < 1e-5


def test_facets_do_not_show():
    """Curvature of a smooth surface of facets much larger than the cell: without the correction
    for their bulge the curvature is wrong by several times itself."""
    exact = sphere(0.02)
    body = checked("ball", *exact.facets(2e-5), None)  # facets of 1.8 mm
    points = shell(exact, 2000, 1e-3)
    truth, look = exact.look(points), Sampled.of_body(body, 5e-4).look(points)
    off = np.abs(look[2] - truth[2]).max(axis=(1, 2))
    assert np.percentile(off, 95) < 0.15 / 0.02
    assert np.abs(look[1] - truth[1]).max() < 0.02


def test_derivatives_are_those_of_the_spline():
    body = checked("torus", *torus(0.02, 0.008, 60, 30), None)
    grid = Sampled.of_body(body, 1e-3)
    points = np.random.default_rng(6).uniform(-0.03, 0.03, (2000, 3)) * (1, 1, 0.3)
    step = 1e-7
    _, normal, curvature = grid.look(points)
    for i, axis in enumerate(np.eye(3)):
        ahead, behind = grid.look(points + step * axis), grid.look(points - step * axis)
        np.testing.assert_allclose((ahead[0] - behind[0]) / (2 * step), normal[:, i], atol=1e-6)
        change = (ahead[1] - behind[1]) / (2 * step)
        np.testing.assert_allclose(change, curvature[:, :, i], atol=1e-3 * np.abs(curvature).max())


def test_far_away_is_never_near():
    exact, facets = sphere(0.02), sphere(0.02).facets(1e-4)
    grid = Sampled.of_body(checked("ball", *facets, None), 1e-3, reach=3e-3)
    points = np.random.default_rng(7).uniform(-0.1, 0.1, (20000, 3))
    truth, found = exact.look(points)[0], grid.look(points)[0]
    near = truth <= grid.reach
    assert (
        np.abs(found[np.abs(truth) < grid.reach] - truth[np.abs(truth) < grid.reach]).max() < 3e-5
    )
    assert (found[near & (truth > -0.015)] < grid.reach + 1e-5).all()
    assert (found[~near] > grid.reach).all()
    assert (found[truth < -1e-3] < 0.0).all()


def test_what_is_no_point_shows():
    grid = Sampled.of_body(checked("ball", *sphere(0.02).facets(1e-4), None), 2e-3)
    distance, normal, _ = grid.look(np.array([[0.0, np.nan, 0.0], [0.01, 0.0, 0.0]]))
    assert np.isnan(distance).tolist() == [True, False]
    assert np.isnan(normal[0]).all()


def test_open_skin_goes_on_behind():
    """A die's skin with its hole: inside of the wall and far below the flat nothing is lost."""
    exact = opening(0.02, 0.004, 0.05)
    points, facets = exact.facets(2e-5)
    for side, turn in (("+z", [1, 1, 1]), ("-z", [1, -1, -1]), ("+x", None)):
        turned = points[:, [2, 0, 1]] if turn is None else points * turn
        grid = Sampled.of_body(checked("die", turned, facets, side), 1e-3)
        at = np.array([[0.03, 0, 1e-3], [0.03, 0, -0.1], [0, 0.019, -0.02], [0.0, 0.0, -0.1]])
        at = at[:, [2, 0, 1]] if turn is None else at * turn
        found = grid.look(at)[0]
        assert found[[0, 2]] == pytest.approx([1e-3, 1e-3], abs=2e-5)
        assert found[1] < 0.0 < found[3]
    upside_down = checked("die", points, facets[:, ::-1], "+z")
    assert Sampled.of_body(upside_down, 1e-3).look(np.array([[0.03, 0, 1e-3]]))[0] > 0.0


def test_height_field_is_the_double_dome():
    """The smooth stand-in of the double dome against the same as an exact oblong profile."""

    def dome(x, y):
        q = np.hypot(x, np.maximum(np.abs(y) - 0.03, 0.0))
        return 0.01 * (1.0 + np.cos(np.pi * np.clip((q - 0.01) / 0.03, 0.0, 1.0)))

    grid = height_field(dome, np.linspace(-0.06, 0.06, 121), np.linspace(-0.09, 0.09, 181), 1e-3)
    x, y = np.random.default_rng(8).uniform(-0.055, 0.055, (2, 3000))
    assert np.abs(grid.look(np.column_stack([x, y, dome(x, y)]))[0]).max() < 2e-5
    assert min(grid.closest_radius) == pytest.approx(0.03**2 / (0.01 * np.pi**2), rel=0.1)


def test_touch():
    """Points from far outside of the grid meet the ball at a slant; from inside they step back."""
    grid = Sampled.of_body(checked("ball", *sphere(0.02).facets(2e-5), None), 1e-3)
    for at in ([0.3, 0.0, 0.3], [0.005, 0.0, 0.005]):
        travel, _ = touch(grid, np.array([at, [0.5, 0.5, 0.5]]), np.array([-1.0, 0.0, -1.0]), 1e-3)
        assert travel == pytest.approx(np.linalg.norm(at) - 0.021, abs=2e-6)


def test_fast_enough():
    grid = Sampled.of_body(checked("ball", *sphere(0.02).facets(2e-5), None), 5e-4)
    points = shell(sphere(0.02), 1000, 1e-3)
    grid.look(points)
    points = np.repeat(points, 100, axis=0)
    begin = time.process_time()
    grid.look(points)
    assert time.process_time() - begin < 0.2


def test_remarks_on_small_radii():
    smooth = checked("box", *Box((0.04, 0.03, 0.02), 0.005).facets(2e-5), None)
    assert Sampled.of_body(smooth, 5e-4).remarks == ()
    assert Sampled.of_body(smooth, 5e-4).closest_radius[0] == pytest.approx(0.005, rel=0.05)
    (remark,) = Sampled.of_body(smooth, 3e-3).remarks
    assert "radii down to" in remark
    assert 'cell = "2.5 mm" resolves them' in remark
    tiny = checked("box", *Box((0.04, 0.03, 0.02), 1e-5).facets(1e-6), None)
    (remark,) = Sampled.of_body(tiny, 1e-3).remarks
    assert "rounds by about a cell" in remark
    cube = np.array([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)]) * 0.02
    facets = ConvexHull(cube)
    outwards = np.cross(
        *(cube[facets.simplices[:, k]] - cube[facets.simplices[:, 0]] for k in (1, 2))
    )
    turn = np.einsum("ij,ij->i", outwards, facets.equations[:, :3]) < 0.0
    triangles = np.where(turn[:, None], facets.simplices[:, ::-1], facets.simplices)
    (remark,) = Sampled.of_body(checked("cube", cube, triangles, None), 1e-3, name="cube").remarks
    assert remark.startswith("cube has sharp edges")


@pytest.mark.parametrize(
    ("name", "write"),
    [
        ("ball.stl", write_stl),
        ("ball.STL", lambda *body: write_stl(*body, text=True)),
        ("ball.obj", write_obj),
        ("ball.ply", write_ply),
        ("ball2.ply", lambda *body: write_ply(*body, text=False)),
    ],
)
def test_formats(tmp_path, ball, name, write):
    write(tmp_path / name, *ball)
    surface = from_file(tmp_path / name, MM, cell=2e-3, cache=False)
    at = np.array([[0.021, 0.0, 0.0], [0.0, 0.0, -0.019]])
    assert surface.look(at)[0] == pytest.approx([1e-3, -1e-3], abs=2e-5)
    assert len(surface.facets()[1]) == len(ball[1])


def balls_script():
    """scripts/make_tetrahedron.py as a module."""
    path = Path(__file__).parents[2] / "scripts" / "make_tetrahedron.py"
    spec = importlib.util.spec_from_file_location("make_tetrahedron", path)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.mark.parametrize("name", ["tetrahedron", "plate", "rod"])
def test_long_thin_facets_along_fillets(tmp_path, name):
    """As modellers write them: 80 mm by 1.6 mm, with others across at their ends.

    Exact is the hull of balls at the corners: planes between three, cylinders between two.
    """
    script = balls_script()
    radius, centres = script.RADIUS, script.corners()
    script.write(tmp_path / "a.stl")
    if name != "tetrahedron":
        centres = {"plate": centres[:3], "rod": centres[[0, 2]]}[name]
        write_stl(tmp_path / "a.stl", *script.hull_of_balls(centres, radius))
    surface = from_file(tmp_path / "a.stl", MM, cell=1.5e-3, cache=False)
    random = np.random.default_rng(2)
    normals = random.normal(size=(4000, 3))
    normals /= np.linalg.norm(normals, axis=1)[:, None]
    # Where a plane or a cylinder touches: any place between the corners that are farthest out.
    along = centres @ normals.T
    at = [centres[along.argmax(axis=0)] + radius * normals]
    for i, j in itertools.combinations(range(len(centres)), 2):
        edge = centres[j] - centres[i]
        across = np.cross(normals, edge)
        across /= np.linalg.norm(across, axis=1)[:, None]
        out = (centres @ across.T).max(axis=0) <= centres[i] @ across.T + 1e-9
        place = centres[i] + random.uniform(size=(len(across), 1)) * edge + radius * across
        at.append(place[out])
    off = surface.look(MM * np.concatenate(at))[0]
    assert abs(off).max() < 2e-4  # chords are off by 0.05 mm, and by 0.2 mm over the ball's poles
    assert np.sqrt((off**2).mean()) < 5e-5


def test_demo_tool_is_what_the_script_makes(tmp_path):
    script = balls_script()
    script.write(tmp_path / "a.stl")
    demo = Path(__file__).parents[2] / "demos" / "tools" / "tetrahedron.stl"
    assert demo.read_bytes() == (tmp_path / "a.stl").read_bytes()


def step_box(path):
    """A box with round edges as gmsh writes it."""
    gmsh = pytest.importorskip("gmsh")
    gmsh.initialize(interruptible=False)
    gmsh.option.setNumber("General.Terminal", 0)
    gmsh.option.setString("Geometry.OCCTargetUnit", "M")
    box = gmsh.model.occ.addBox(-0.02, -0.015, -0.01, 0.04, 0.03, 0.02)
    gmsh.model.occ.synchronize()
    gmsh.model.occ.fillet([box], [edge[1] for edge in gmsh.model.getEntities(1)], [0.005])
    gmsh.model.occ.synchronize()
    gmsh.write(str(path))
    gmsh.finalize()


@pytest.mark.parametrize("reader", ["cascadio", "gmsh"])
def test_step(tmp_path, monkeypatch, reader):
    """Either program gives the box within its facets' error, in metres."""
    pytest.importorskip(reader)
    if reader == "gmsh":
        monkeypatch.setitem(sys.modules, "cascadio", None)
    step_box(tmp_path / "box.step")
    surface = from_file(tmp_path / "box.step", cell=1e-3, cache=False)
    exact = Box((0.04, 0.03, 0.02), 0.005)
    points = shell(exact, 1000, 1e-3)
    assert np.abs(surface.look(points)[0] - exact.look(points)[0]).max() < 5e-5
    with pytest.raises(InputError, match="must not have the key unit"):
        from_file(tmp_path / "box.step", MM)
    whole = (tmp_path / "box.step").read_bytes()
    (tmp_path / "half.stp").write_bytes(whole[: len(whole) // 2])
    with pytest.raises(InputError, match=r"half.stp\" (cannot be read as STEP|is no|has no)"):
        from_file(tmp_path / "half.stp")


def test_step_without_a_reader(tmp_path, monkeypatch):
    """Both readers missing are one sentence; what is no STEP file needs none."""
    for name in ("cascadio", "gmsh"):
        monkeypatch.setitem(sys.modules, name, None)
    (tmp_path / "box.step").write_text("ISO-10303-21;\n")
    with pytest.raises(InputError, match=r"needs cascadio \(pip install cascadio\) or gmsh"):
        from_file(tmp_path / "box.step")
    (tmp_path / "none.stp").write_text("nothing")
    with pytest.raises(InputError, match=r"none.stp\" is no STEP file: it does not begin"):
        from_file(tmp_path / "none.stp")


def test_heights_as_csv(tmp_path):
    x, y = np.mgrid[-20:21, -10:11]
    rows = np.column_stack([x.ravel(), y.ravel(), x.ravel() ** 2 / 200.0])
    np.savetxt(tmp_path / "a.csv", rows, delimiter=",", header="x,y,z", comments="")
    np.savetxt(tmp_path / "b.csv", rows, delimiter=",", encoding="utf-8-sig")  # as some editors do
    surface = from_file(tmp_path / "a.csv", MM, cell=1e-3, cache=False)
    same = from_file(tmp_path / "b.csv", MM, cell=1e-3, cache=False)
    np.testing.assert_array_equal(same.facets()[0], surface.facets()[0])
    assert surface.look(np.array([[0.0, 0.0, 1e-3]]))[0] == pytest.approx(1e-3, abs=1e-5)


@pytest.mark.parametrize(
    ("rows", "words"),
    [
        ("1,2\n3,4\n5,6\n", "three columns"),
        ("1,2,a\n3,4,5\n", "three columns"),
        ("0,0,1\n1,0,1\n2,0,2\n", "heights lie in one line"),
        ("0,0,1\n0,0,2\n2,0,2\n", "tell of one place twice"),
        ("0,0,1\n5,0,nan\n2,9,2\n", "must be finite"),
    ],
)
def test_what_is_no_table_of_heights(tmp_path, rows, words):
    (tmp_path / "a.csv").write_text(rows)
    with pytest.raises(InputError, match=words):
        from_file(tmp_path / "a.csv", MM)


def moebius(number=30):
    t = np.linspace(0.0, 2.0 * np.pi, number, endpoint=False)
    middle = 50.0 * np.stack([np.cos(t), np.sin(t), 0.0 * t], -1)
    half = np.cos(0.5 * t)
    half = 15.0 * np.stack([half * np.cos(t), half * np.sin(t), np.sin(0.5 * t)], -1)
    rows = []
    for i in range(number):
        a, b = i, i + number
        c, d = (i + 1, i + 1 + number) if i + 1 < number else (number, 0)
        rows += [[a, c, b], [c, d, b]]
    return np.vstack([middle + half, middle - half]), np.array(rows)


def two(ball, apart, turned=False):
    points, facets = ball
    second = facets[:, ::-1] if turned else facets
    return np.vstack([points, points + np.array([apart, 0, 0])]), np.vstack(
        [facets, second + len(points)]
    )


FIN = np.array([[0, 0, 0], [30, 0, 0], [0, 30, 0], [0, -30, 0], [0, 0, 30.0]])
BAD = {
    "inside out": (
        lambda p, f: (p, f[:, ::-1]),
        {},
        'inside out.*say side = "outside" or "inside"',
    ),
    "open": (lambda p, f: (p, f[:-1]), {}, r'is open: 3 edges .*say side = "\+z"'),
    "open, wrong word": (lambda p, f: (p, f[:-1]), {"side": "outside"}, "is open: 3 edges"),
    "faces away": (lambda p, f: (p, f[:-1]), {"side": "+x"}, "50 % faces away from side"),
    "crosses": (lambda p, f: two((p, f), 25.0), {}, "doubtful near .* cross each other"),
    "turned against each other": (
        lambda p, f: two((p * [[1.2, 1.2, 1.2]], f), 60.0, True),
        {"side": "outside"},
        "doubtful near|inside out",
    ),
    "three at an edge": (
        lambda p, f: (FIN, np.array([[0, 1, 2], [0, 1, 3], [0, 1, 4]])),
        {"side": "+z"},
        "not a surface: 3 facets meet",
    ),
    "one side": (lambda p, f: moebius(), {"side": "+z"}, "no two sides"),
    "150 km": (lambda p, f: (p * 3.75e6, f), {}, r"tool of 150 km, which must be between"),
    "in metres": (lambda p, f: (p * 1e-3, f), {}, r'tool of 0.04 mm.*"m" makes it 40 mm'),
    "no cell": (lambda p, f: (p, f), {"cell": 0.0}, "cell must be positive"),
    "too fine": (lambda p, f: (p, f), {"cell": 1e-6}, "grid of over 256 MB .*, take at least"),
}


@pytest.mark.parametrize(("change", "options", "words"), BAD.values(), ids=BAD)
def test_what_is_no_tool(tmp_path, ball, change, options, words):
    write_ply(tmp_path / "a.ply", *change(*ball))
    with pytest.raises(InputError, match=words):
        from_file(tmp_path / "a.ply", MM, **{"cell": 2e-3} | options)
    assert [path.name for path in tmp_path.iterdir()] == ["a.ply"]


@pytest.mark.parametrize("kind", ["stl", "text.stl", "ply", "text.ply", "obj"])
def test_damaged_files(tmp_path, ball, kind, capfd):
    """Cut off anywhere, or random: a sentence, no warning of VTK, no crash."""
    path = tmp_path / f"a.{kind}"
    write = {"stl": write_stl, "ply": write_ply, "obj": write_obj}[kind.rpartition(".")[2]]
    write(path, *ball, **({} if kind == "obj" else {"text": "text" in kind}))
    whole = path.read_bytes()
    random = np.random.default_rng(9)
    for content in (
        b"",
        whole[:10],
        whole[:200],
        whole[: len(whole) // 2],
        whole[: -len(whole) // 3],
        random.bytes(5000),
        whole[:300] + random.bytes(3000),
    ):
        path.write_bytes(content)
        with pytest.raises(InputError, match="a[.]"):
            from_file(path, MM, cell=2e-3)
    assert capfd.readouterr().err == ""


def test_other_things_than_tools(tmp_path, ball):
    write_obj(tmp_path / "corner.obj", *ball)
    with open(tmp_path / "corner.obj", "a") as file:
        file.write("f 1 2 99999\n")
    (tmp_path / "folder.stl").mkdir()
    os.mkfifo(tmp_path / "pipe.stl")
    for name, options, words in (
        ("corner.obj", {}, "a corner that is not in the file"),
        ("folder.stl", {}, "is a folder"),
        ("none.stl", {}, "does not exist"),
        ("pipe.stl", {}, "no regular file"),
        ("a\0.stl", {}, "cannot be read"),
        ("a.dwg", {}, "must be an STL, OBJ, PLY, STEP or CSV file"),
        ("corner.obj", {"unit": None}, "needs the key unit"),
        ("corner.obj", {"side": "up"}, "side must be one of"),
    ):
        with pytest.raises(InputError, match=words):
            from_file(tmp_path / name, **{"unit": MM} | options)


def test_sides_of_a_closed_body(tmp_path, ball):
    points, facets = ball
    write_stl(tmp_path / "a.stl", points, facets[:, ::-1])
    at = np.array([[0.021, 0.0, 0.0]])
    for side, sign in (("outside", 1.0), ("inside", -1.0), ("+z", 1.0)):
        surface = from_file(tmp_path / "a.stl", MM, side, 2e-3, cache=False)
        assert surface.look(at)[0] == pytest.approx(sign * 1e-3, abs=2e-5)
    mixed = np.where(np.arange(len(facets))[:, None] % 3 == 0, facets[:, ::-1], facets)
    write_stl(tmp_path / "b.stl", points, mixed)  # turned one way, as most are
    surface = from_file(tmp_path / "b.stl", MM, None, 2e-3, cache=False)
    assert surface.look(at)[0] == pytest.approx(1e-3, abs=2e-5)
    write_stl(tmp_path / "c.stl", *two(ball, 50.0))  # two bodies
    surface = from_file(tmp_path / "c.stl", MM, None, 2e-3, cache=False)
    assert surface.look(at + np.array([0.05, 0, 0]))[0] == pytest.approx(1e-3, abs=2e-5)


def test_facets_without_a_width(tmp_path):
    """As modellers write them, to close the crack beside a corner in the middle of an edge."""
    points, facets = sphere(0.02).facets(5e-5)
    a, b, c = facets[-1]
    points = np.vstack([points, 0.5 * (points[a] + points[b])])
    new = len(points) - 1
    facets = np.vstack([facets[:-1], [a, new, c], [new, b, c], [a, b, new]])
    write_ply(tmp_path / "a.ply", points / MM, facets)
    write_stl(tmp_path / "a.stl", points / MM, facets)
    for name in ("a.ply", "a.stl"):
        surface = from_file(tmp_path / name, MM, cell=1e-3, cache=False)
        at = shell(sphere(0.02), 3000, 1.5e-3)
        found, exact = surface.look(at), sphere(0.02).look(at)
        assert np.abs(found[0] - exact[0]).max() < 2e-5
        assert surface.closest_radius[0] == pytest.approx(0.02, rel=0.05)


def test_cache(tmp_path, ball, monkeypatch):
    home = tmp_path / "home"
    monkeypatch.setenv("XDG_CACHE_HOME", str(home))
    path = tmp_path / "a.stl"
    write_stl(path, *ball)
    made = []

    def body(*args, **options):
        made.append(1)
        return of_body(*args, **options)

    of_body = Sampled.of_body
    monkeypatch.setattr(Sampled, "of_body", body)
    points = shell(sphere(0.02), 100, 1e-3)

    def look(**options):
        surface = from_file(path, MM, cell=3e-3, **options)
        assert surface.remarks == of_body(checked("a", *sphere(0.02).facets(), None), 3e-3).remarks
        return surface.look(points)[0]

    first = look()
    (kept,) = tmp_path.glob(".a.stl.*.distance.npz")
    np.testing.assert_array_equal(look(), first)
    assert len(made) == 1
    look(side="inside")  # another grid, beside it
    assert len(made) == 2
    assert len(list(tmp_path.glob("*.npz")) + list(tmp_path.glob(".*.npz"))) >= 2
    # damaged: cut off, or a byte of it changed
    whole = kept.read_bytes()
    for damage in (whole[:1000], whole[:9000] + b"x" + whole[9001:], b""):
        kept.write_bytes(damage)
        np.testing.assert_array_equal(look(), first)
        assert kept.read_bytes()[:4] == b"PK\3\4"
    assert len(made) == 5
    # another file of the same name: made anew, the former's grids go
    write_stl(path, 1.1 * ball[0], ball[1])
    assert look() == pytest.approx(first - 2e-3, abs=2e-5)
    assert kept not in list(tmp_path.iterdir())
    assert not list(tmp_path.glob("*.part"))
    # a folder that cannot be written to
    monkeypatch.setattr(
        sampled, "_caches", lambda *args: [path / "no", home / "cruciform_petsc" / "grid.npz"]
    )
    look()
    assert (home / "cruciform_petsc" / "grid.npz").exists()


def test_heights_of_a_script_must_make_sense():
    with pytest.raises(InputError, match="finite"):
        height_facets(np.array([[0, 0, np.inf], [1, 0, 0], [0, 1, 0]]))
