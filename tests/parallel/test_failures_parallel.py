# SPDX-License-Identifier: MIT
"""PETSc's options, its errors and estimates are told alike on all ranks."""

import pytest
from mpi4py import MPI
from petsc4py import PETSc
from support.helpers import TABLE_1, diagonals

from cruciform_petsc import memory
from cruciform_petsc.case.schema import Case
from cruciform_petsc.cli import main
from cruciform_petsc.equilibrium.model import Model
from cruciform_petsc.errors import InputError, LibraryError
from cruciform_petsc.estimate import check_work
from cruciform_petsc.experiments.bias_extension import BiasExtension
from cruciform_petsc.experiments.limits import warnings
from cruciform_petsc.net.network import Network

COMM = MPI.COMM_WORLD
BLOCKS = {"ksp_type": "cg", "pc_type": "bjacobi", "sub_pc_type": "icc"}


@pytest.fixture(scope="module")
def network():
    return Network(COMM, diagonals(8, 12), TABLE_1)


def solve(network, options, finite):
    finite = {"finite": True, "increments": 1} if finite else {}
    return BiasExtension(network, "0.5 mm", options=options, **finite).solve()


def alike(error):
    """The sentence, the same on every rank."""
    sentences = COMM.allgather(str(error.value))
    assert len(set(sentences)) == 1
    return sentences[0]


@pytest.mark.parametrize("finite", [False, True])
@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"pc_factor_mat_solver_type": "mump"}, "does not have a factorisation"),
        ({"pc_type": "icc", "ksp_type": "cg"}, "does not have a factorisation"),
        (BLOCKS | {"sub_pc_type": "nonsense"}, "does not have a type"),
        ({"ksp_view": ":/no/such/file"}, "cannot open a file"),
    ],
)
def test_what_petsc_does_not_have(network, options, words, finite):
    """An incomplete factor of a matrix that is dealt out, for one."""
    if COMM.size == 1 and options.get("pc_type") == "icc":
        pytest.skip("one rank can")
    with pytest.raises(InputError) as caught:
        solve(network, options, finite)
    assert words in alike(caught)


@pytest.mark.parametrize("finite", [False, True])
def test_unused(network, finite):
    options = BLOCKS | {"sub_pc_factor_levels": 1, "pc_gamg_threshold": 0.1}
    (sentence,) = [s for s in warnings(solve(network, options, finite)) if "PETSc option" in s]
    assert COMM.allgather(sentence) == COMM.size * [
        'the PETSc option "-cruciform_pc_gamg_threshold" was not used: no solver in use asks for it'
    ]


def test_no_memory_on_all_ranks(network, monkeypatch):
    """Agreed on: an error to catch, and what comes next works."""
    whole, calls = Model.force, []

    def failing(*arguments, **keys):
        calls.append(1)
        if len(calls) == 3:
            raise PETSc.Error(55)
        return whole(*arguments, **keys)

    monkeypatch.setattr(Model, "force", failing)
    with pytest.raises(LibraryError) as caught:
        solve(network, {}, True)
    assert "there is not enough memory" in alike(caught)
    monkeypatch.undo()
    assert solve(network, {}, True).load > 0.0


def test_estimate(tmp_path, monkeypatch):
    """Refused on every rank; what is told is a rank's share."""
    monkeypatch.setattr(memory, "machine_memory", lambda: 16e9)
    data = {
        "fabric": {"use": "e-glass-plain-2.4"},
        "preform": {"outline": {"rectangle": ["10 cm", "20 cm"]}, "bias_angle": "45 deg"},
        "test": {"kind": "bias-extension", "extension": "1 mm", "finite": False},
    }
    (sentence,) = check_work(COMM, Case.from_data(data))
    assert (" on each rank" in sentence) == (COMM.size > 1)
    data["continuum"] = {"compare": True, "mesh_size": "1 um"}
    with pytest.raises(InputError) as caught:
        check_work(COMM, Case.from_data(data))
    assert "the membrane has about 8e+10 triangles" in alike(caught)


def test_a_sweep_is_no_job_of_several_ranks(capfd):
    """It starts its runs itself."""
    code = main(["sweep", "case.toml", "--vary", "preform.refine=1"])
    said = "".join(COMM.allgather(capfd.readouterr().err))
    assert (code, said.count("leave mpirun out")) == ((2, 1) if COMM.size > 1 else (2, 0))
