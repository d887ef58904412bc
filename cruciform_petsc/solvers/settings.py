# SPDX-License-Identifier: MIT
"""What a case file may ask of PETSc: names of options, and values that each may have.

Case files come from elsewhere, and PETSc would load code (pc_python_type, lists of types), write
files (viewers, matrix dumps, MUMPS' streams and out-of-core files) or work without end if it were
told to. What is not named here is for the command line, which is its owner's own affair.
"""

from __future__ import annotations

import re
from difflib import get_close_matches
from typing import Any

from ..errors import cut, shown

MOST = 100  # options in a case
# Parts of a solver, before a setting.
_PART = r"(?:(?:mg_levels|mg_coarse)_(?:\d{1,2}_)?|sub_|esteig_){0,3}"

_KSP = "preonly cg fcg cr minres gmres fgmres bcgs tfqmr lsqr richardson chebyshev"
_PC = "none jacobi pbjacobi bjacobi sor ilu icc lu cholesky asm gamg mg hypre redundant"
_SMOOTHERS = (
    "Jacobi SOR/Jacobi symmetric-SOR/Jacobi l1scaled-Jacobi l1-Gauss-Seidel "
    "l1scaled-SOR/Jacobi Chebyshev"
)
# Words in a text; a range of whole numbers; least and largest of numbers; bool for true and false.
Values = str | range | tuple[float, float] | type[bool]
SETTINGS: dict[str, Values] = {
    "snes_type": "newtonls",
    "snes_max_it": range(1, 1001),
    "snes_linesearch_type": "basic bt l2 cp",
    "snes_linesearch_damping": (1e-3, 1.0),
    "snes_monitor": bool,
    "snes_converged_reason": bool,
    "ksp_type": _KSP,
    "ksp_rtol": (1e-16, 1.0),
    "ksp_atol": (0.0, 1e300),
    "ksp_divtol": (1.0, 1e300),
    "ksp_max_it": range(1, 1_000_001),
    "ksp_norm_type": "none preconditioned unpreconditioned natural",
    "ksp_pc_side": "left right",
    "ksp_gmres_restart": range(1, 1001),
    "ksp_richardson_scale": (1e-6, 10.0),
    "ksp_chebyshev_kind": "first fourth opt_fourth",
    "ksp_chebyshev_esteig_steps": range(1, 1001),
    "ksp_view": bool,
    "ksp_monitor": bool,
    "ksp_monitor_true_residual": bool,
    "ksp_converged_reason": bool,
    "pc_type": _PC,
    "pc_mg_type": "multiplicative additive full kaskade",
    "pc_mg_cycle_type": "v w",
    "pc_mg_multiplicative_cycles": range(1, 101),
    "pc_gamg_type": "agg classical",
    "pc_gamg_agg_nsmooths": range(11),
    "pc_gamg_threshold": (-1.0, 1.0),
    "pc_gamg_threshold_scale": (0.0, 1.0),
    "pc_gamg_coarse_eq_limit": range(1, 100_001),
    "pc_gamg_repartition": bool,
    "pc_gamg_process_eq_limit": range(1, 1_000_001),
    "pc_gamg_aggressive_coarsening": range(101),
    "pc_gamg_reuse_interpolation": bool,
    "pc_gamg_esteig_ksp_max_it": range(1, 1001),
    "pc_hypre_type": "boomeramg",
    "pc_hypre_boomeramg_cycle_type": "V W",
    "pc_hypre_boomeramg_max_levels": range(2, 101),
    "pc_hypre_boomeramg_max_iter": range(1, 101),
    "pc_hypre_boomeramg_tol": (0.0, 1.0),
    "pc_hypre_boomeramg_strong_threshold": (0.0, 1.0),
    "pc_hypre_boomeramg_interp_type": "classical direct multipass ext+i standard FF FF1 ext",
    "pc_hypre_boomeramg_coarsen_type": "CLJP Ruge-Stueben Falgout PMIS HMIS",
    "pc_hypre_boomeramg_agg_nl": range(101),
    "pc_hypre_boomeramg_nodal_coarsen": range(7),
    "pc_hypre_boomeramg_relax_type_all": _SMOOTHERS,
    "pc_hypre_boomeramg_P_max": range(101),
    "pc_hypre_boomeramg_grid_sweeps_all": range(1, 101),
    "pc_hypre_boomeramg_truncfactor": (0.0, 0.99),
    "pc_factor_levels": range(11),
    "pc_factor_fill": (1.0, 1000.0),
    "pc_factor_shift_type": "none nonzero positive_definite inblocks",
    "pc_factor_shift_amount": (0.0, 1e300),
    "pc_factor_mat_solver_type": "mumps petsc superlu superlu_dist umfpack cholmod klu",
    "pc_factor_mat_ordering_type": "natural nd 1wd rcm qmd",
    "pc_factor_zeropivot": (0.0, 1.0),
    "pc_sor_omega": (1e-3, 1.999),
    "pc_sor_its": range(1, 101),
    "pc_sor_lits": range(1, 101),
    "pc_sor_symmetric": bool,
    "pc_jacobi_type": "diagonal rowl1 rowmax",
    "pc_bjacobi_blocks": range(1, 100_001),
    "pc_asm_overlap": range(11),
    "pc_asm_type": "none restrict interpolate basic",
    # MUMPS: not its streams (1 to 3), a permutation of one's own (7 = 1), files (22).
    "mat_mumps_icntl_6": range(8),
    "mat_mumps_icntl_7": "0 2 3 4 5 6 7",
    "mat_mumps_icntl_8": "0 1 3 4 7 8 77",
    "mat_mumps_icntl_10": range(-10, 11),
    "mat_mumps_icntl_12": range(4),
    "mat_mumps_icntl_13": range(2),
    "mat_mumps_icntl_14": range(1001),
    "mat_mumps_icntl_23": range(10_000_001),
    "mat_mumps_icntl_24": range(2),
    "mat_mumps_icntl_27": range(-1024, 1025),
    "mat_mumps_icntl_28": range(3),
    "mat_mumps_icntl_29": range(3),
    "mat_mumps_icntl_35": range(4),
    "mat_mumps_icntl_36": range(2),
    "mat_mumps_icntl_38": range(1001),
    "mat_mumps_cntl_1": (0.0, 1.0),
    "mat_mumps_cntl_2": (0.0, 1.0),
    "mat_mumps_cntl_3": (-1.0, 1.0),
    "mat_mumps_cntl_4": (-1.0, 1.0),
    "mat_mumps_cntl_5": (0.0, 1e30),
    "mat_mumps_cntl_7": (0.0, 1.0),
    "mg_yarn_sweeps": range(101),
}


def check_settings(value: Any) -> dict[str, Any]:
    """Accept options that a case may set, without dash and prefix; ValueError tells what is wrong.

    The words of the ValueError go on where the name of the table ends.
    """
    if not isinstance(value, dict):
        raise ValueError('must be a table like { ksp_type = "cg" }')
    if len(value) > MOST:
        raise ValueError(f"has {len(value)} options, at most {MOST} can be given")
    for name, setting in value.items():
        if not re.fullmatch(r"[A-Za-z]\w*", name, re.ASCII):
            raise ValueError(
                f'has the option "{cut(name)}", write it like "ksp_type", without a dash'
            )
        known = setting_of(name)
        if known is None:
            raise ValueError(
                f'has the option "{name}", which a case file may not set: it is none, has no '
                f"effect, or could run code, write files or work without end{_meant(name)}. "
                f"Whoever runs it can give -cruciform_{name} on the command line"
            )
        wanted = _wanted(SETTINGS[known], setting)
        if wanted:
            raise ValueError(f'"{name}" must be {wanted}, got {shown(setting)}')
    return value


def setting_of(name: str) -> str | None:
    """The setting that an option's name ends with, if it is one of a part of a solver."""
    setting = re.sub(f"^{_PART}", "", name)
    if setting not in SETTINGS:  # "mg_yarn_sweeps" begins like a part
        return None
    return setting


def closest(name: str) -> str:
    """The known option that a name is likely a slip of, "" if there is none."""
    setting = re.sub(f"^{_PART}", "", name)
    near = get_close_matches(setting, SETTINGS, 1, 0.8)
    return name.removesuffix(setting) + near[0] if near else ""


def _meant(name: str) -> str:
    near = closest(name)
    return f' (did you mean "{near}"?)' if near else ""


def _wanted(values: Values, setting: Any) -> str:
    """What a setting must be in place of what it is; nothing if it is good."""
    number = isinstance(setting, int | float) and not isinstance(setting, bool)
    if values is bool:
        return "" if isinstance(setting, bool) else "true or false"
    if isinstance(values, str):
        words = values.split()
        good = isinstance(setting, str | int) and str(setting) in words
        return "" if good else f"one of {', '.join(words)}"
    if isinstance(values, range):
        good = number and isinstance(setting, int) and setting in values
        return "" if good else f"a whole number from {values[0]} to {values[-1]}"
    assert isinstance(values, tuple)
    least, most = values
    good = number and least <= setting <= most
    return "" if good else f"a number from {least:g} to {most:g}"
