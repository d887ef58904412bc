# SPDX-License-Identifier: MIT
"""What a case may ask of PETSc: bounded, and each of it is understood and has an effect."""

import re

import pytest
from mpi4py import MPI
from support.helpers import TABLE_1, diagonals

from cruciform_petsc.experiments.bias_extension import BiasExtension
from cruciform_petsc.experiments.limits import warnings
from cruciform_petsc.net.network import Network
from cruciform_petsc.solvers import options as petsc
from cruciform_petsc.solvers.settings import SETTINGS, check_settings

NETWORK = Network(MPI.COMM_SELF, diagonals(6, 8), TABLE_1)
HYPRE = {"ksp_type": "cg", "pc_type": "hypre"}
GAMG = {"ksp_type": "cg", "pc_type": "gamg"}
ICC = {"ksp_type": "cg", "pc_type": "icc"}
# What an option needs beside it to be asked for, by how its name begins; the longest counts.
BESIDE = {
    "ksp_": GAMG,
    "ksp_type": {"pc_type": "cholesky"},
    "ksp_gmres": GAMG | {"ksp_type": "gmres"},
    "ksp_richardson": {"ksp_type": "richardson"},
    "ksp_chebyshev": GAMG,
    "ksp_pc_side-right": GAMG | {"ksp_type": "gmres"},
    "ksp_pc_side": GAMG | {"ksp_type": "gmres", "ksp_norm_type": "preconditioned"},
    "pc_type": {"ksp_type": "gmres", "ksp_norm_type": "preconditioned", "ksp_gmres_restart": 500},
    "pc_mg_": {"ksp_type": "cg", "pc_type": "mg"},
    "pc_gamg": GAMG,
    "pc_hypre": HYPRE,
    "pc_factor": ICC,
    "pc_factor_mat_solver": {"pc_type": "lu"},
    "pc_factor_mat_solver_type-cholmod": {},
    "pc_factor_mat_ordering": {"pc_factor_mat_solver_type": "petsc"},
    "pc_sor": {"ksp_type": "gmres", "ksp_norm_type": "preconditioned", "pc_type": "sor"},
    "pc_jacobi": {"ksp_type": "cg", "pc_type": "jacobi"},
    "pc_bjacobi": {"ksp_type": "cg", "pc_type": "bjacobi"},
    "pc_asm": {"ksp_type": "cg", "pc_type": "asm"},
    "mg_yarn": {"ksp_type": "cg", "pc_type": "mg"},
}
# The first or smallest value is none with which a system is solved, or is no equilibrium's.
VALUES = {
    "snes_max_it": 30,
    "ksp_rtol": 1e-8,
    "ksp_atol": 1e-12,
    "ksp_divtol": 1e5,
    "ksp_max_it": 500,
    "ksp_gmres_restart": 50,
    "ksp_richardson_scale": 0.5,
    "snes_linesearch_damping": 1.0,
    "ksp_chebyshev_esteig_steps": 10,
    "mat_mumps_cntl_3": 0.0,
    "mat_mumps_cntl_4": -1.0,
    "mat_mumps_cntl_5": 0.0,
    "pc_factor_shift_amount": 1e-10,
    "pc_factor_zeropivot": 1e-14,
    "pc_sor_omega": 1.0,
    "mat_mumps_icntl_14": 50,
    "mat_mumps_icntl_23": 500,
}


def solved(options, finite):
    """A tiny test of the network; no warning that an option was left unused."""
    petsc._used.clear()
    load = {"increments": 1, "finite": True} if finite else {}
    result = BiasExtension(NETWORK, "0.5 mm", options=options, **load).solve()
    assert not [sentence for sentence in warnings(result) if "was not used" in sentence]
    return result


def every_value(name):
    values = SETTINGS[name]
    if isinstance(values, str):
        return values.split()
    if values is bool:
        return [True, False]
    if isinstance(values, range):
        return [VALUES.get(name, values[min(1, len(values) - 1)])]
    return [VALUES.get(name, values[1] if values[1] <= 1 else 0.5 * sum(values))]


@pytest.mark.parametrize(
    ("name", "value"), [(name, value) for name in SETTINGS for value in every_value(name)]
)
def test_each_setting_is_understood_and_asked_for(name, value, capfd):
    """On a tiny problem: PETSc takes it, looks at it, and still finds the solution."""
    part = "mg_levels_" if name.startswith("ksp_chebyshev") else ""
    beside = next(
        (BESIDE[k] for k in sorted(BESIDE, key=len)[::-1] if f"{name}-{value}".startswith(k)), {}
    )
    options = beside | {part + name: value}
    check_settings(options)
    capfd.readouterr()
    result = solved(options, name.startswith("snes_"))
    if SETTINGS[name] is bool and re.search(petsc._TOLD, name):
        assert bool(capfd.readouterr().out) == value
    assert result.load == pytest.approx(solved({}, name.startswith("snes_")).load, rel=1e-2)
