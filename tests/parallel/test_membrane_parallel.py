# SPDX-License-Identifier: MIT
"""The membrane on several ranks: mpirun -n 2 python3 -m mpi4py -m pytest tests/parallel."""

from __future__ import annotations

import sys

import dolfinx
import numpy as np
import pytest
import shapely
from mpi4py import MPI
from petsc4py import PETSc

from cruciform_petsc.cloth.fabric import Fabric
from cruciform_petsc.cloth.preform import Preform
from cruciform_petsc.continuum.compare import compare_fields
from cruciform_petsc.continuum.membrane import Membrane
from cruciform_petsc.continuum.mesh import outline_mesh
from cruciform_petsc.continuum.points import evaluate
from cruciform_petsc.errors import InputError, SolverError

COMM = MPI.COMM_WORLD
TABLE_1 = Fabric.from_library("e-glass-plain-2.4")
L_SHAPE = [(-0.01, 0), (0.01, 0), (0.01, 0.012), (0, 0.012), (0, 0.03), (-0.01, 0.03)]
PREFORMS = {
    "rectangle": Preform.rectangle(0.023570226, 0.035355339),
    "L": Preform.polygon(L_SHAPE, (), "30 deg"),
}
CASES = pytest.mark.parametrize("preform", PREFORMS.values(), ids=PREFORMS.keys())


def my_points(outline: shapely.Polygon) -> np.ndarray:
    """Points on and inside the outline, on mesh lines too; uneven over the ranks, rank 0 has none.

    On one rank alone it has them all.
    """
    (x0, y0), (x1, y1) = np.reshape(outline.bounds, (2, 2))
    x, y = np.meshgrid(np.linspace(x0, x1, 17), np.linspace(y0, y1, 25))
    every = np.column_stack([x.ravel(), y.ravel()])
    every = every[shapely.intersects_xy(outline, *every.T)]
    if COMM.size == 1:
        return every
    return np.array_split(every[:: COMM.rank], 2)[0] if COMM.rank else every[:0]


@CASES
def test_mesh_covers_the_outline_once(preform):
    for levels in (0, 2):
        mesh = outline_mesh(COMM, preform.outline, 1e-3, levels)
        owned = mesh.topology.index_map(2).size_local
        corners = mesh.geometry.x[mesh.geometry.dofmap[:owned]][..., :2]
        a, b = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
        area = COMM.allreduce(abs(a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]).sum() / 2)
        assert area == pytest.approx(preform.outline.area, rel=1e-12)
        assert owned < 0.8 * COMM.allreduce(owned) or COMM.size == 1


@CASES
def test_evaluate_is_the_same_on_any_number_of_ranks(preform):
    """A function that jumps between triangles, against the same on a mesh of this rank alone."""

    def values(comm: MPI.Intracomm) -> list[np.ndarray]:
        mesh = outline_mesh(comm, preform.outline, 2e-3)
        smooth = dolfinx.fem.Function(dolfinx.fem.functionspace(mesh, ("Lagrange", 2, (2,))))
        smooth.interpolate(lambda x: np.array([np.sin(300 * x[0]), np.cos(200 * x[1])]))
        jumps = dolfinx.fem.Function(dolfinx.fem.functionspace(mesh, ("DG", 0)))
        jumps.interpolate(lambda x: 1e3 * x[0] + x[1])
        return evaluate(mesh, [smooth, jumps], my_points(preform.outline))

    for distributed, alone in zip(values(COMM), values(MPI.COMM_SELF), strict=True):
        assert distributed.shape == alone.shape
        assert np.allclose(distributed, alone, rtol=0, atol=1e-12)


@CASES
def test_fields_are_the_same_on_any_number_of_ranks(preform):
    points = my_points(preform.outline)
    together, alone = (
        Membrane(comm, preform, TABLE_1, size=1.5e-3, grading=0).solve_bias_extension(1e-3)
        for comm in (COMM, MPI.COMM_SELF)
    )
    assert together.cells == alone.cells
    assert together.dofs == alone.dofs
    for name in ("load", "energy", "energy_shear", "extension"):
        assert getattr(together, name) == pytest.approx(getattr(alone, name), rel=1e-8)
    ours, expected = together.evaluate(points), alone.evaluate(points)
    for name, value in expected.items():
        largest = COMM.allreduce(abs(value).max(initial=0.0), MPI.MAX)
        assert np.allclose(ours[name], value, rtol=0, atol=1e-8 * largest), name


@CASES
def test_graded_mesh_in_parallel(preform):
    """Equal sides may be split differently on other partitions: equal far below 0.1 %."""
    points = my_points(preform.outline)
    together, alone = (
        Membrane(comm, preform, TABLE_1, size=1e-3).solve_bias_extension(1e-3)
        for comm in (COMM, MPI.COMM_SELF)
    )
    assert together.load == pytest.approx(alone.load, rel=1e-4)
    same = compare_fields(
        COMM,
        points,
        alone.evaluate(points)["displacement"],
        alone.evaluate(points)["shear_angle"],
        alone.load,
        alone.energy,
        together,
    )
    assert same.relative_l2_displacement < 1e-4
    assert same.energy_ratio == pytest.approx(1, rel=1e-4)
    assert same.points == COMM.allreduce(len(points))
    assert len(set(COMM.allgather(same.relative_l2_shear))) == 1


def test_tractions_in_parallel():
    preform = Preform.rectangle(0.01, 0.03, "30 deg")
    membrane = Membrane(COMM, preform, TABLE_1, size=3e-3, grading=0)
    result = membrane.solve(tractions=[("upper", (0, 5.0)), ("lower", (0, -5.0))])
    kilby = TABLE_1.off_axis_modulus(np.radians(30))
    assert 5.0 * 0.03 / result.extension == pytest.approx(kilby, rel=1e-9)


def test_multigrid_in_parallel():
    membrane = Membrane(COMM, PREFORMS["rectangle"], TABLE_1, size=1.5e-3)
    direct = membrane.solve_bias_extension(1e-3)
    options = PETSc.Options()
    given = {"ksp_type": "cg", "pc_type": "gamg", "ksp_rtol": "1e-11"}
    for name, value in given.items():
        options.setValue("mg_test_" + name, value)
    try:
        iterative = membrane.solve_bias_extension(1e-3, prefix="mg_test_")
    finally:
        for name in given:
            options.delValue("mg_test_" + name)
    assert iterative.ksp.pc == "gamg"
    assert iterative.energy == pytest.approx(direct.energy, rel=1e-8)


def test_ranks_without_triangles(monkeypatch):
    """One triangle for all ranks."""
    corners = np.array([(0, 0), (0.01, 0), (0.003, 0.02)])
    preform = Preform.polygon(corners, (), "45 deg")
    one = (corners, np.array([[0, 1, 2]]))
    monkeypatch.setattr("cruciform_petsc.continuum.mesh.gmsh_triangles", lambda *_: one)
    energy = []
    for comm in (COMM, MPI.COMM_SELF):
        membrane = Membrane(comm, preform, TABLE_1, size=1.0, grading=0)
        assert membrane.cells == 1
        result = membrane.solve([("lower", None, (0, 0)), ("outline-2", 1, lambda x: x[1] / 10)])
        energy.append(result.energy)
        assert np.isnan(result.load)  # no edge at the top
        assert np.allclose(result.evaluate([[0.003, 0.02]])["displacement"][0, 1], 2e-3)
    assert energy[0] == pytest.approx(energy[1], rel=1e-10)


def test_errors_reach_every_rank(monkeypatch):
    if COMM.rank == 0:
        monkeypatch.setitem(sys.modules, "gmsh", None)
    with pytest.raises(InputError, match="gmsh is not installed"):
        outline_mesh(COMM, PREFORMS["L"].outline, 1e-3)
    monkeypatch.undo()

    membrane = Membrane(COMM, PREFORMS["L"], TABLE_1, size=3e-3)
    result = membrane.solve_bias_extension(1e-3)
    outside = [[0.005, 0.02]] if COMM.rank == COMM.size - 1 else []
    with pytest.raises(InputError, match=r"1 points lie outside .* \(0.005, 0.02\)"):
        result.evaluate(np.reshape(outside, (-1, 2)))
    with pytest.raises(InputError, match="rigid body"):
        membrane.solve([("lower", 1, 0.0)])

    options = PETSc.Options()
    given = {"ksp_type": "cg", "pc_type": "none", "ksp_max_it": "2"}
    for name, value in given.items():
        options.setValue("fail_test_" + name, value)
    try:
        with pytest.raises(SolverError) as error:
            membrane.solve_bias_extension(1e-3, prefix="fail_test_")
    finally:
        for name in given:
            options.delValue("fail_test_" + name)
    assert error.value.reason == "DIVERGED_MAX_IT"
    assert len(error.value.history) == 3
