# SPDX-License-Identifier: MIT
"""The continuum membrane against closed forms, and the evaluation of fields at points."""

from __future__ import annotations

import sys

import dolfinx
import numpy as np
import pytest
import shapely
from mpi4py import MPI
from petsc4py import PETSc

from cruciform_petsc.cloth.fabric import Fabric, YarnFamily
from cruciform_petsc.cloth.preform import Preform
from cruciform_petsc.continuum.compare import compare_fields
from cruciform_petsc.continuum.domain import default_size
from cruciform_petsc.continuum.membrane import Membrane
from cruciform_petsc.continuum.mesh import outline_mesh
from cruciform_petsc.continuum.points import evaluate
from cruciform_petsc.errors import InputError, SolverError

COMM = MPI.COMM_SELF
WIDTH, LENGTH = 0.023570226, 0.035355339
TABLE_1 = Fabric.from_library("e-glass-plain-2.4")
UNEVEN = Fabric("uneven", YarnFamily(50e3, 0.4, 240.0), YarnFamily(20e3, 0.16, 240.0), 700.0)
L_SHAPE = [(-0.01, 0), (0.01, 0), (0.01, 0.012), (0, 0.012), (0, 0.03), (-0.01, 0.03)]
CIRCLE = [(5e-3 * np.cos(a), 0.015 + 5e-3 * np.sin(a)) for a in np.linspace(0, 2 * np.pi, 201)[:-1]]


def area(mesh: dolfinx.mesh.Mesh) -> float:
    corners = mesh.geometry.x[mesh.geometry.dofmap][..., :2]
    a, b = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    return float(abs(a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]).sum() / 2)


def edge_lengths(mesh: dolfinx.mesh.Mesh) -> np.ndarray:
    corners = mesh.geometry.x[mesh.geometry.dofmap][..., :2]
    return np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=-1)


def points_inside(outline: shapely.Polygon, number: int = 50) -> np.ndarray:
    x = np.random.default_rng(1).uniform(*np.reshape(outline.bounds, (2, 2)), (20 * number, 2))
    return x[shapely.contains_xy(outline, *x.T)][:number]


# -- meshes -------------------------------------------------------------------------------------


def test_rectangle_mesh_is_symmetric():
    mesh = outline_mesh(COMM, shapely.box(-1, 0, 1, 3), 0.5)
    x = mesh.geometry.x[:, :2]
    mirrored = x * (-1, 1)
    assert np.allclose(np.sort(x @ (1, 1e3)), np.sort(mirrored @ (1, 1e3)))
    assert mesh.topology.index_map(2).size_local == 4 * 4 * 6
    assert edge_lengths(mesh).max() == pytest.approx(0.5)


@pytest.mark.parametrize("levels", [0, 2])
@pytest.mark.parametrize("holes", [[], [CIRCLE]], ids=["L", "hole"])
def test_mesh_fills_the_outline(holes, levels):
    box = [(-0.01, 0), (0.01, 0), (0.01, 0.03), (-0.01, 0.03)]
    outline = shapely.Polygon(box if holes else L_SHAPE, holes)
    mesh = outline_mesh(COMM, outline, 1e-3, levels)
    assert area(mesh) == pytest.approx(outline.area, rel=1e-12)
    corners = shapely.get_coordinates(outline)
    nodes = shapely.STRtree(shapely.points(mesh.geometry.x[:, :2]))
    _, distance = nodes.query_nearest(shapely.points(corners), return_distance=True)
    assert distance.max() < 1e-12
    assert edge_lengths(mesh).max() < 2e-3
    if not (holes and levels):  # refined short edges are refined all the same
        ideal = outline.area / (1e-3**2 * 3**0.5 / 4)
        assert mesh.topology.index_map(2).size_local < (4 if holes else 1.5) * ideal


def test_short_edges_do_not_refine_the_whole_mesh():
    fine_hole = [(1e-3 * np.cos(a), 1e-3 * np.sin(a)) for a in np.linspace(0, 2 * np.pi, 65)[:-1]]
    outline = shapely.box(-0.05, -0.05, 0.05, 0.05) - shapely.Polygon(fine_hole)
    mesh = outline_mesh(COMM, outline, 2e-3)
    assert edge_lengths(mesh).min() < 1.1e-4
    assert mesh.topology.index_map(2).size_local < 2 * outline.area / (2e-3**2 * 3**0.5 / 4)
    a, b, c = edge_lengths(mesh).T
    angles = [(x**2 + y**2 - z**2) / (2 * x * y) for x, y, z in ((a, b, c), (b, c, a), (c, a, b))]
    assert np.degrees(np.arccos(angles)).min() > 20  # no slivers beside them either


def test_grading_halves_the_size_at_a_point_only():
    mesh = outline_mesh(COMM, shapely.box(0, 0, 1, 1), 0.1)
    corner = (np.array([[0.0, 0.0]]), 0.2, 5)
    graded = outline_mesh(COMM, shapely.box(0, 0, 1, 1), 0.1, singular=corner)
    assert area(graded) == pytest.approx(1.0, rel=1e-12)
    corners = graded.geometry.x[graded.geometry.dofmap][..., :2]
    size = edge_lengths(graded).max(axis=1)
    distance = np.linalg.norm(corners.mean(axis=1), axis=1)
    assert size[distance.argmin()] <= 0.1 / 2**5
    assert np.allclose(size[distance > 0.5], 0.1)
    assert graded.topology.index_map(2).size_local < 2 * mesh.topology.index_map(2).size_local


def test_without_gmsh_other_outlines_are_an_input_error(monkeypatch):
    monkeypatch.setitem(sys.modules, "gmsh", None)
    with pytest.raises(InputError, match="gmsh is not installed"):
        outline_mesh(COMM, shapely.Polygon(L_SHAPE), 1e-3)
    outline_mesh(COMM, shapely.box(0, 0, 1, 1), 0.5)


@pytest.mark.parametrize("size", [0.0, -1.0, float("nan")])
def test_mesh_size_must_be_positive(size):
    with pytest.raises(InputError, match="must be positive"):
        outline_mesh(COMM, shapely.box(0, 0, 1, 1), size)


# -- the membrane against closed forms ----------------------------------------------------------


@pytest.mark.parametrize("degree", [1, 2, 3])
@pytest.mark.parametrize(
    "preform",
    [
        Preform.rectangle(WIDTH, LENGTH, "45 deg"),
        Preform.polygon(L_SHAPE, (), "20 deg"),
        Preform.polygon([(-0.01, 0), (0.01, 0), (0.01, 0.03), (-0.01, 0.03)], [CIRCLE], "-65 deg"),
    ],
    ids=["rectangle", "L", "hole"],
)
def test_affine_patch(preform, degree):
    """Affine displacement of the whole boundary: uniform strains, energy of the closed form."""
    gradient = np.array([[3e-3, -8e-3], [2e-2, 5e-3]])
    membrane = Membrane(COMM, preform, UNEVEN, size=4e-3, degree=degree, grading=1)
    boundary = [name for name in preform.edges if name.startswith(("outline-", "hole-"))]
    result = membrane.solve([(name, None, lambda x: gradient @ x[:2]) for name in boundary])

    b = preform.bias_angle
    warp, weft = np.array([np.sin(b), np.cos(b)]), np.array([-np.cos(b), np.sin(b)])
    eps_w, eps_e = warp @ gradient @ warp, weft @ gradient @ weft
    gamma = weft @ gradient @ warp + warp @ gradient @ weft
    nu2 = UNEVEN.warp.poisson * UNEVEN.weft.poisson
    sigma_w = UNEVEN.warp.modulus / (1 - nu2) * (eps_w + UNEVEN.weft.poisson * eps_e)
    sigma_e = UNEVEN.weft.modulus / (1 - nu2) * (eps_e + UNEVEN.warp.poisson * eps_w)
    tension = preform.outline.area * 0.5 * (sigma_w * eps_w + sigma_e * eps_e)
    shear = preform.outline.area * 0.5 * UNEVEN.shear_modulus * gamma**2
    assert result.energy_tension == pytest.approx(tension, rel=1e-10)
    assert result.energy_shear == pytest.approx(shear, rel=1e-10)

    points = points_inside(preform.outline)
    field = result.evaluate(points)
    assert np.allclose(field["displacement"], points @ gradient.T, rtol=0, atol=1e-13)
    assert np.allclose(field["warp_strain"], eps_w, rtol=1e-8)
    assert np.allclose(field["weft_strain"], eps_e, rtol=1e-8)
    assert np.allclose(field["shear_angle"], gamma, rtol=1e-8)


def test_sign_of_the_shear_angle():
    """Warp turned counter-clockwise by 1e-3, weft left as it is: +1e-3; a rotation: none."""
    preform = Preform.rectangle(WIDTH, LENGTH, "30 deg")
    membrane = Membrane(COMM, preform, TABLE_1, size=5e-3, grading=0)
    edges = ("lower", "right", "upper", "left")
    turned = np.outer(preform.weft_direction, preform.warp_direction) * 1e-3
    for gradient, expected in ((turned, 1e-3), (np.array([[0, -1e-3], [1e-3, 0]]), 0.0)):
        result = membrane.solve([(e, None, lambda x, g=gradient: g @ x[:2]) for e in edges])
        shear = result.evaluate(points_inside(preform.outline))["shear_angle"]
        assert np.allclose(shear, expected, rtol=0, atol=1e-12)


@pytest.mark.parametrize("fabric", [TABLE_1, UNEVEN], ids=["table-1", "uneven"])
@pytest.mark.parametrize("angle", [0, 15, 30, 45, 60, 75, 90])
def test_off_axis_modulus(fabric, angle):
    """Strip with uniform end traction and free sides: Kilby's modulus, at every angle."""
    membrane = Membrane(
        COMM, Preform.rectangle("1 cm", "3 cm", f"{angle} deg"), fabric, size=5e-3, grading=0
    )
    traction = 10.0
    result = membrane.solve(tractions=[("upper", (0, traction)), ("lower", (0, -traction))])
    c2, s2 = np.cos(np.radians(angle)) ** 2, np.sin(np.radians(angle)) ** 2
    e_w, e_e = fabric.warp.modulus, fabric.weft.modulus
    mixed = 1 / fabric.shear_modulus - 2 * fabric.warp.poisson / e_w
    kilby = 1 / (c2**2 / e_w + s2**2 / e_e + mixed * c2 * s2)
    assert traction * 0.03 / result.extension == pytest.approx(kilby, rel=1e-9)
    assert traction**2 * 0.01 * 0.03 / (2 * result.energy) == pytest.approx(kilby, rel=1e-9)
    assert result.load == pytest.approx(traction * 0.01, rel=1e-9)


def test_pressure_on_a_rhombus():
    """Equal tension in all directions: unknowns that rule out rigid motion wherever corners lie."""
    preform = Preform.polygon([(0, 0), (0.01, 0.015), (0, 0.03), (-0.01, 0.015)], (), "20 deg")
    membrane = Membrane(COMM, preform, UNEVEN, size=5e-3, grading=0)
    tractions = []
    for i in range(1, 5):
        (along,) = np.diff(preform.edge(f"outline-{i}")[0], axis=0)
        tractions.append((f"outline-{i}", 8.0 * np.array([along[1], -along[0]]) / np.hypot(*along)))
    result = membrane.solve(tractions=tractions)
    warp, weft = UNEVEN.warp, UNEVEN.weft
    compliance = 1 / warp.modulus + 1 / weft.modulus - 2 * warp.poisson / warp.modulus
    assert result.energy == pytest.approx(0.5 * 8.0**2 * compliance * 3e-4, rel=1e-9)
    assert result.energy_shear < 1e-9 * result.energy


@pytest.mark.parametrize("upper", ["grip", "centre-line"])
def test_load_is_the_derivative_of_the_energy(upper):
    """Linear: load = 2 energy / extension; and the clamps' forces are in balance."""
    for preform in (Preform.rectangle(WIDTH, LENGTH), Preform.polygon(L_SHAPE, (), "30 deg")):
        result = Membrane(COMM, preform, TABLE_1, size=2e-3).solve_bias_extension(1e-3, upper)
        assert result.extension == pytest.approx(1e-3, rel=1e-12)
        assert result.load == pytest.approx(2 * result.energy / 1e-3, rel=1e-9)
        assert np.allclose(
            result.edge_force("lower"), -result.edge_force("upper"), atol=1e-9 * result.load
        )


def test_centre_line_is_half_of_a_specimen():
    """Half of a specimen of twice the length, symmetric about its middle."""
    half = Membrane(COMM, Preform.rectangle(0.02, 0.03), TABLE_1, size=1e-3, grading=0)
    whole = Membrane(COMM, Preform.rectangle(0.02, 0.06), TABLE_1, size=1e-3, grading=0)
    a = half.solve_bias_extension(1e-3, "centre-line")
    b = whole.solve_bias_extension(2e-3)
    assert a.load == pytest.approx(b.load, rel=1e-8)
    points = points_inside(half.preform.outline)
    ua, ub = a.evaluate(points)["displacement"], b.evaluate(points)["displacement"]
    assert np.allclose(ua, ub, rtol=0, atol=1e-10)
    assert half.solve_bias_extension(1e-3, "grip").load > 1.1 * a.load


# -- accuracy -----------------------------------------------------------------------------------


def test_grading_pays_and_the_load_falls_with_the_mesh_size():
    """A finer mesh is softer; the singular corners make uniform meshes converge slowly."""
    preform = Preform.rectangle(WIDTH, LENGTH)
    exact = 0.429940  # N: degree 4, graded ten times (twice as fine: the same)

    def error(n: int, grading: int) -> float:
        membrane = Membrane(COMM, preform, TABLE_1, WIDTH / n, degree=2, grading=grading)
        return membrane.solve_bias_extension(1e-3).load / exact - 1

    uniform = [error(n, 0) for n in (8, 16, 32)]
    assert uniform[0] > uniform[1] > uniform[2] > 4e-3
    assert uniform[1] / uniform[2] < 2.5  # first order only
    assert 0 < error(32, 6) < 0.1 * uniform[2]


def test_default_size_does_not_matter():
    """Load and displacement of the default mesh and of one half as coarse again: within 0.1 %."""
    preform = Preform.rectangle(WIDTH, LENGTH)
    size = default_size(preform.outline, TABLE_1, 3)
    points = points_inside(preform.outline, 200)
    fine, coarse = (
        Membrane(COMM, preform, TABLE_1, size=s).solve_bias_extension(1e-3)
        for s in (None, 1.5 * size)
    )
    assert fine.size == size
    assert coarse.load == pytest.approx(fine.load, rel=1e-3)
    assert fine.load == pytest.approx(0.429940, rel=1e-4)
    u, v = fine.evaluate(points)["displacement"], coarse.evaluate(points)["displacement"]
    assert np.linalg.norm(u - v) < 1e-3 * np.linalg.norm(u)


# -- edges and constraints ----------------------------------------------------------------------


def test_singular_points():
    """Ends of clamps and re-entrant corners, not the corners of a hole like a circle."""

    def found(preform: Preform) -> set[tuple[float, float]]:
        return {
            tuple(np.round(p, 9)) for p in Membrane(COMM, preform, TABLE_1, 1.0).singular_points
        }

    clamps = {(-0.01, 0), (0.01, 0), (-0.01, 0.03)}
    assert found(Preform.polygon(L_SHAPE)) == clamps | {(0, 0.03), (0, 0.012)}
    box = [(-0.01, 0), (0.01, 0), (0.01, 0.03), (-0.01, 0.03)]
    assert found(Preform.polygon(box, [CIRCLE])) == clamps | {(0.01, 0.03)}
    slit = [(-0.001, 0.01), (0.001, 0.01), (0.001, 0.02), (-0.001, 0.02)]
    assert found(Preform.polygon(box, [slit])) == clamps | {(0.01, 0.03)} | set(slit)


def test_an_edge_may_end_between_corners():
    """Clamp one half of the lower edge only: softer, and singular where the clamp ends."""
    part = np.array([[[-0.01, 0.0], [0.003, 0.0]]])
    preform = Preform.rectangle(0.02, 0.03, edges={"part": part})
    membrane = Membrane(COMM, preform, TABLE_1, size=2e-3)
    x = membrane.mesh.geometry.x
    assert (np.linalg.norm(x[:, :2] - (0.003, 0), axis=1) < 1e-9).any()
    assert (np.linalg.norm(membrane.singular_points - (0.003, 0), axis=1) < 1e-9).any()
    pulled = ("upper", None, (0.0, 1e-3))
    partly = membrane.solve([("part", None, (0.0, 0.0)), pulled])
    assert partly.edge_force("part")[1] == pytest.approx(-partly.load, rel=1e-8)
    assert partly.load < 0.9 * membrane.solve_bias_extension(1e-3).load


def test_an_edge_that_the_mesh_does_not_have():
    preform = Preform.rectangle(0.02, 0.03)
    membrane = Membrane(COMM, preform, TABLE_1, size=5e-3)
    membrane.preform.edges["inside"] = np.array([[[0.0, 0.001], [0.01, 0.001]]])
    with pytest.raises(InputError, match="'inside' is 0.01 m long, but the mesh has 0 m"):
        membrane.edge_facets("inside")
    with pytest.raises(InputError, match='no edge "top"'):
        membrane.solve([("top", None, (0.0, 0.0))])


def test_a_membrane_that_can_float():
    membrane = Membrane(COMM, Preform.rectangle(0.02, 0.03), TABLE_1, size=5e-3, grading=0)
    with pytest.raises(InputError, match="rigid body"):
        membrane.solve([("lower", 1, 0.0), ("upper", 1, 1e-3)])
    with pytest.raises(InputError, match="not in balance"):
        membrane.solve(tractions=[("upper", (0, 1.0))])
    with pytest.raises(InputError, match="not in balance"):  # a couple is no balance either
        membrane.solve(tractions=[("upper", (1.0, 0)), ("lower", (-1.0, 0))])
    with pytest.raises(InputError, match="centre-line, grip"):
        membrane.solve_bias_extension(1e-3, upper="loose")


def test_yarns_must_be_at_right_angles():
    preform = Preform.rectangle(0.02, 0.03)

    class Skewed:
        outline, warp_direction = preform.outline, preform.warp_direction
        weft_direction = -preform.weft_direction

    with pytest.raises(InputError, match="right angles"):
        Membrane(COMM, Skewed(), TABLE_1)


# -- linear solver ------------------------------------------------------------------------------


@pytest.fixture
def options():
    database = PETSc.Options()
    before = database.getAll()
    yield database
    for name in set(database.getAll()) - set(before):
        database.delValue(name)


def test_rigid_modes_cost_no_energy():
    membrane = Membrane(COMM, Preform.polygon(L_SHAPE, (), "30 deg"), UNEVEN, size=3e-3)
    modes = membrane.rigid_modes()
    u = dolfinx.fem.Function(membrane.space)
    for k in range(3):
        u.x.array[:] = modes[:, :, k].ravel()
        assert abs(u.x.array).max() > 0.4
        work = sum(membrane.energies(u))
        assert dolfinx.fem.assemble_scalar(dolfinx.fem.form(work)) < 1e-15 * UNEVEN.c11
    u.x.array[:] = modes[:, ::-1, 2].ravel()  # no rotation: this test can fail
    work = sum(membrane.energies(u))
    assert dolfinx.fem.assemble_scalar(dolfinx.fem.form(work)) > 1e-3 * UNEVEN.shear_modulus
    assert np.linalg.matrix_rank(modes.reshape(-1, 3)) == 3


def test_multigrid_agrees_with_the_factorisation(options):
    membrane = Membrane(COMM, Preform.rectangle(WIDTH, LENGTH), TABLE_1, size=1.5e-3)
    direct = membrane.solve_bias_extension(1e-3)
    options.setValue("membrane_pc_type", "gamg")
    options.setValue("membrane_ksp_type", "cg")
    options.setValue("membrane_ksp_rtol", "1e-11")
    before = options.getAll()
    iterative = membrane.solve_bias_extension(1e-3)
    assert options.getAll() == before
    assert (direct.ksp.pc, iterative.ksp.pc) == ("cholesky", "gamg")
    assert iterative.ksp.iterations > 5
    assert iterative.load == pytest.approx(direct.load, rel=1e-5)
    assert iterative.energy == pytest.approx(direct.energy, rel=1e-8)
    u, v = direct.displacement.x.array, iterative.displacement.x.array
    assert abs(u - v).max() < 1e-6 * abs(u).max()


def test_failure_to_converge_is_an_error(options):
    membrane = Membrane(COMM, Preform.rectangle(WIDTH, LENGTH), TABLE_1, size=3e-3)
    for name, value in (("pc_type", "none"), ("ksp_type", "cg"), ("ksp_max_it", "3")):
        options.setValue("other_" + name, value)
    with pytest.raises(SolverError, match="3 iterations") as error:
        membrane.solve_bias_extension(1e-3, prefix="other_")
    assert error.value.reason == "DIVERGED_MAX_IT"
    assert len(error.value.history) == 4
    assert membrane.solve_bias_extension(1e-3).load > 0


# -- fields at points ---------------------------------------------------------------------------


def test_evaluate_takes_the_mean_of_the_triangles_that_meet():
    """A piecewise constant function against a loop over all triangles."""
    mesh = outline_mesh(COMM, shapely.box(0, 0, 3, 2), 1.0)
    space = dolfinx.fem.functionspace(mesh, ("DG", 0))
    number = dolfinx.fem.Function(space)
    number.x.array[:] = np.arange(len(number.x.array)) ** 2
    ticks = np.linspace(0, 1, 13)
    points = np.array([(3 * x, 2 * y) for x in ticks for y in ticks])
    (value,) = evaluate(mesh, [number], points)
    off = np.random.default_rng(3).uniform(-1e-13, 1e-13, points.shape)
    assert np.array_equal(evaluate(mesh, [number], points + off)[0], value)
    corners = mesh.geometry.x[mesh.geometry.dofmap][..., :2]
    for point, found in zip(points, value, strict=True):
        touching = [
            number.x.array[space.dofmap.cell_dofs(cell)[0]]
            for cell, triangle in enumerate(corners)
            if shapely.Polygon(triangle).distance(shapely.Point(point)) < 1e-9
        ]
        assert found[0] == pytest.approx(np.mean(touching))


def test_evaluate_on_the_outline_and_just_outside():
    mesh = outline_mesh(COMM, shapely.Polygon(L_SHAPE), 3e-3)
    space = dolfinx.fem.functionspace(mesh, ("Lagrange", 2, (2,)))
    function = dolfinx.fem.Function(space)
    function.interpolate(lambda x: np.array([x[0] ** 2, x[0] * x[1]]))
    ring = shapely.Polygon(L_SHAPE).exterior
    on = shapely.get_coordinates(shapely.line_interpolate_point(ring, np.linspace(0, 0.1, 300)))
    beside = on + np.random.default_rng(0).uniform(-1e-8, 1e-8, on.shape)
    for points in (on, beside):
        (value,) = evaluate(mesh, [function], points)
        exact = np.column_stack([points[:, 0] ** 2, points[:, 0] * points[:, 1]])
        assert np.allclose(value, exact, rtol=0, atol=1e-12)
    assert evaluate(mesh, [function], np.empty((0, 2)))[0].shape == (0, 2)


def test_points_outside_are_an_error():
    mesh = outline_mesh(COMM, shapely.Polygon(L_SHAPE), 3e-3)
    function = dolfinx.fem.Function(dolfinx.fem.functionspace(mesh, ("DG", 0)))
    points = np.array([[0.0, 0.01], [0.005, 0.02], [7.0, 7.0]])
    with pytest.raises(InputError, match=r"2 points lie outside .* \(0.005, 0.02\)"):
        evaluate(mesh, [function], points)


def test_comparison():
    preform = Preform.rectangle(WIDTH, LENGTH)
    result = Membrane(COMM, preform, TABLE_1, size=2e-3).solve_bias_extension(1e-3)
    corner = [[-WIDTH / 2, 0.0]]
    points = np.concatenate([points_inside(preform.outline), corner])
    field = result.evaluate(points)
    u, gamma = field["displacement"], field["shear_angle"].copy()
    gamma[-1] = 1e9  # where the membrane's strain has no bound, nothing is compared
    same = compare_fields(COMM, points, u, gamma, result.load, result.energy, result)
    assert same.relative_l2_displacement == same.relative_l2_shear == 0
    assert same.load_ratio == same.energy_ratio == 1
    assert same.points == len(points)
    assert same.points_shear <= len(points) - 1

    gamma[0] = np.nan
    more = compare_fields(
        COMM, points, 1.1 * u, gamma + 0.02, 2 * result.load, 3 * result.energy, result
    )
    assert more.relative_l2_displacement == pytest.approx(0.1)
    assert more.mean_abs_shear_deg == pytest.approx(np.degrees(0.02))
    kept = np.linalg.norm(points[:, None] - result.membrane.singular_points, axis=2).min(axis=1)
    kept = (kept >= 0.1 * WIDTH) & np.isfinite(gamma)
    assert more.points_shear == kept.sum()
    expected = 0.02 * kept.sum() ** 0.5 / np.linalg.norm(field["shear_angle"][kept])
    assert more.relative_l2_shear == pytest.approx(expected)
    assert more.load_ratio == pytest.approx(2)
    assert more.energy_ratio == pytest.approx(3)
    assert set(more.as_dict()) >= {"relative_l2_displacement", "load_ratio", "energy_ratio"}
