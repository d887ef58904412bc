# SPDX-License-Identifier: MIT
"""PETSc's errors are told as what they are, and never as a want of equilibrium."""

import re

import pytest
from mpi4py import MPI
from petsc4py import PETSc
from support.helpers import TABLE_1, diagonals

from cruciform_petsc.equilibrium.model import Model
from cruciform_petsc.equilibrium.tangents import TangentMultigrid
from cruciform_petsc.errors import EquilibriumError, InputError, LibraryError, SolverError
from cruciform_petsc.experiments.bias_extension import BiasExtension
from cruciform_petsc.experiments.limits import warnings
from cruciform_petsc.net.network import Network
from cruciform_petsc.solvers import failures
from cruciform_petsc.solvers.callbacks import callback, calling_back

NETWORK = Network(MPI.COMM_SELF, diagonals(6, 8), TABLE_1)
FINITE = {"finite": True, "increments": 1}


def solve(options, finite):
    return BiasExtension(NETWORK, "0.5 mm", options=options, **(FINITE if finite else {})).solve()


@pytest.fixture
def database():
    """PETSc's options, as those of the command line; what a test adds is gone afterwards."""
    options = PETSc.Options()
    before = options.getAll()
    yield options
    for name in set(options.getAll()) - set(before):
        options.delValue(name)


# -- what a user asks for and PETSc does not have -----------------------------------------------


@pytest.mark.parametrize("finite", [False, True])
@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"pc_factor_mat_solver_type": "mump"}, "not have a factorisation .*solver type mump for"),
        ({"pc_type": "nonsense"}, "-cruciform_pc_type .* is 'nonsense', which this PETSc does not"),
        ({"pc_type": "gamg", "pc_gamg_type": "x"}, "not have a type .*Unknown GAMG type x given"),
        ({"pc_type": "mg", "mg_levels_pc_type": "x"}, "not have a type .*requested PC type x"),
        ({"pc_type": "gamg", "mg_levels_pc_type": "x"}, "not have a type .*requested PC type x"),
        ({"pc_type": "python"}, "cannot do what the options .*Python context not set"),
        ({"ksp_view": ":/no/such/x"}, "cannot open a file that the options .*/no/such/x"),
        ({"pc_factor_mat_ordering_type": "x"}, "cannot do what .* -cruciform_... ask .*type: x"),
        ({"pc_type": "jacobi", "ksp_rtol": "x"}, "cannot do what .* x has no numeric value"),
    ],
    ids=str,
)
def test_what_petsc_does_not_have(options, message, finite):
    with pytest.raises(InputError, match=message) as caught:
        solve(options, finite)
    assert "equilibrium" not in str(caught.value)


@pytest.mark.parametrize("finite", [False, True])
def test_too_little_room_for_the_factor(finite):
    """MUMPS' work arrays; once called a mechanism, or no equilibrium."""
    with pytest.raises(LibraryError, match="not enough memory .*by mumps; .*mumps_icntl_14"):
        solve({"mat_mumps_icntl_14": -(10**8)}, finite)


@pytest.mark.parametrize(
    ("code", "kind", "message"),
    [
        (55, LibraryError, "there is not enough memory .PETSc error 55.: choose a coarser net"),
        (76, LibraryError, "a library that PETSc calls has failed"),
        (86, InputError, "does not have a type that the options -x_"),
        (92, InputError, "does not have a factorisation"),
        (65, InputError, "cannot open a file"),
        (67, InputError, "cannot write a file"),
        (71, LibraryError, "a pivot is zero"),
        (60, type(None), "None"),
    ],
)
def test_by_code(code, kind, message):
    ours = failures.in_words(PETSc.Error(code), "x_")
    assert type(ours) is kind
    assert re.search(message, str(ours))


# -- in a callback, on all ranks -----------------------------------------------------------------


def test_raised_in_a_callback():
    """Memory that PETSc does not find for a tangent is not a want of equilibrium."""
    shell = PETSc.KSP().create(PETSc.COMM_SELF)

    @callback
    def fails(code):
        raise PETSc.Error(code)

    def call(code):
        with calling_back(shell):
            try:
                fails(code)
            except PETSc.Error:
                raise PETSc.Error(-1) from None

    with pytest.raises(LibraryError, match="not enough memory"):
        call(55)
    with pytest.raises(PETSc.Error, match="error code 60"):
        call(60)


@pytest.mark.parametrize(("code", "words"), [(55, "not enough memory"), (71, "a pivot is zero")])
@pytest.mark.parametrize("number", [1, 2, 3, 4])
def test_raised_in_newton(code, words, number, monkeypatch):
    """Where a tangent is made: told as it is, and no smaller step is tried."""
    test = BiasExtension(NETWORK, "0.5 mm", **FINITE)
    real, calls = Model.stiffness, []

    def failing(self, *arguments, **keys):
        calls.append(1)
        if len(calls) >= number:
            raise PETSc.Error(code)
        return real(self, *arguments, **keys)

    monkeypatch.setattr(Model, "stiffness", failing)
    with pytest.raises((LibraryError, PETSc.Error)) as caught:
        test.solve()
    if number > 1:  # before, no solver is there to be called
        assert words in str(caught.value)
    assert len(calls) == number


@pytest.mark.parametrize("number", [1, 2, 3])
def test_refused_by_the_multigrid(number, monkeypatch):
    """What is no fault of a library is tried again with a smaller step."""
    test = BiasExtension(NETWORK, "0.5 mm", options={"pc_type": "mg"}, **FINITE)
    real, calls = TangentMultigrid.setUp.__wrapped__, []

    def failing(self, pc):
        calls.append(1)
        if len(calls) == number:
            raise SolverError("yarns without stiffness")
        real(self, pc)

    monkeypatch.setattr(TangentMultigrid, "setUp", callback(failing))
    if number == 1:  # the tangent, to begin with
        with pytest.raises(EquilibriumError, match="yarns without stiffness"):
            test.solve()
    else:
        assert sum(step.cuts for step in test.solve().increments) == 1


# -- options that nobody asks for ----------------------------------------------------------------


def unused(options=None, finite=False):
    found = warnings(solve(options or {}, finite))
    return [sentence for sentence in found if "PETSc option" in sentence]


@pytest.mark.parametrize("finite", [False, True])
@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("cruciform_pc_typ", 'not used: did you mean "-cruciform_pc_type"?'),
        ("cruciform_mg_levels_ksp_maxit", 'did you mean "-cruciform_mg_levels_ksp_max_it"?'),
        ("membrane_ksp_rtl", 'did you mean "-membrane_ksp_rtol"?'),
        ("cruciform_pc_gamg_threshold", "not used: no solver in use asks for it"),
        ("cruciform_xyzzy", "not used: no solver in use asks for it"),
        ("ksp_rtol", 'not used: did you mean "-cruciform_ksp_rtol"?'),
    ],
)
def test_command_line_options_left_unused(database, name, message, finite):
    database[name] = "0.3"
    (sentence,) = unused(finite=finite)
    assert sentence.startswith(f'the PETSc option "-{name}" was')
    assert sentence.endswith(message)


@pytest.mark.parametrize("finite", [False, True])
def test_options_of_a_case_left_unused(finite):
    """A right name that this solver has no use for."""
    (sentence,) = unused({"pc_gamg_threshold": 0.01, "ksp_view": False}, finite)
    assert '"-cruciform_pc_gamg_threshold" was not used: no solver' in sentence


def test_options_in_use_and_of_others(database):
    database["cruciform_ksp_type"], database["log_something"] = "cg", "x"
    assert unused({"pc_type": "icc"}) == []
    assert unused({"pc_type": "icc"}, finite=True) == []
