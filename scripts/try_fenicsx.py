# SPDX-License-Identifier: MIT
"""Try out what cruciform_petsc needs of its surroundings, on any number of ranks.

scripts/fenicsx runs this in every Debian root it makes.  By hand, for any surroundings:
scripts/fenicsx mpirun -n 2 python3 scripts/try_fenicsx.py
"""

import importlib
import tempfile

import h5py
import numpy as np
import ufl
from dolfinx import fem, mesh
from dolfinx.fem.petsc import assemble_matrix, assemble_vector
from mpi4py import MPI
from petsc4py import PETSc

comm = MPI.COMM_WORLD

MODULES = ("gmsh", "hypothesis", "matplotlib.pyplot", "numba", "pint", "pydantic", "pytest")
for name in (*MODULES, "pyvista", "rich", "scipy", "shapely", "vtk"):
    importlib.import_module(name)
for name in ("mumps", "hypre", "ptscotch"):
    if not PETSc.Sys.hasExternalPackage(name):
        raise SystemExit(f"PETSc has been built without {name}")

# u - div grad u = 1, whose solution is 1, by two solvers; the C compiler compiles the forms
domain = mesh.create_unit_square(comm, 8, 8)
space = fem.functionspace(domain, ("Lagrange", 1))
u, v = ufl.TrialFunction(space), ufl.TestFunction(space)
matrix = assemble_matrix(fem.form((ufl.inner(ufl.grad(u), ufl.grad(v)) + u * v) * ufl.dx))
matrix.assemble()
load = assemble_vector(fem.form(v * ufl.dx))
load.ghostUpdate(PETSc.InsertMode.ADD, PETSc.ScatterMode.REVERSE)
for method, preconditioner, package in (("preonly", "lu", "mumps"), ("cg", "hypre", None)):
    solver = PETSc.KSP().create(comm)
    solver.setOperators(matrix)
    solver.setType(method)
    solver.setTolerances(rtol=1e-10)
    solver.getPC().setType(preconditioner)
    if package:
        solver.getPC().setFactorSolverType(package)
    solution = matrix.createVecRight()
    solver.solve(load, solution)
    np.testing.assert_allclose(solution.array, 1, rtol=1e-6)

# One HDF5 file written by all ranks, if h5py can
if h5py.get_config().mpi:
    with tempfile.TemporaryDirectory() as folder:
        path = comm.bcast(f"{folder}/ranks.h5")
        with h5py.File(path, "w", driver="mpio", comm=comm) as file:
            file.create_dataset("rank", (comm.size,), dtype=int)[comm.rank] = comm.rank
        with h5py.File(path, driver="mpio", comm=comm) as file:
            np.testing.assert_array_equal(file["rank"][:], np.arange(comm.size))
        comm.barrier()

if comm.rank == 0:
    print(
        f"FEniCSx works on {comm.size} rank(s); h5py writes",
        "in parallel" if h5py.get_config().mpi else "from one rank only",
    )
