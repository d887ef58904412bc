# SPDX-License-Identifier: MIT
"""Exceptions and signals within what PETSc calls back: they come out as what they are."""

import contextlib
import signal

import numpy as np
import pytest
from mpi4py import MPI
from petsc4py import PETSc
from support.finite import Cloth
from support.helpers import TABLE_1, diagonals

from cruciform_petsc.elements.level import FORCE, STIFFNESS, room
from cruciform_petsc.equilibrium.model import Model
from cruciform_petsc.equilibrium.newton import Equilibrium
from cruciform_petsc.errors import EquilibriumError, SolverError
from cruciform_petsc.experiments.bias_extension import BiasExtension
from cruciform_petsc.items.item import Item
from cruciform_petsc.net.edges import Constraints
from cruciform_petsc.net.network import Network
from cruciform_petsc.solvers.callbacks import callback, calling_back
from cruciform_petsc.solvers.yarns import YarnSmoother

MULTIGRID = {"pc_type": "mg", "ksp_type": "cg"}
LEVELS = 18  # diagonals across, of which there are levels
RAISED = pytest.mark.parametrize("kind", [KeyboardInterrupt, SystemExit, ZeroDivisionError])


class Nothing(Item):
    """Adds nothing, but does something when it is asked for the n-th time for something."""

    name, modes = "nothing", ("nothing",)

    def __init__(self, level, times, do):
        self.nodes = np.zeros((1, 1), np.int32)
        self.level, self.left, self.do = level, times, do

    def work(self, state, level, rows=slice(None), before=None):
        if level == self.level:
            self.left -= 1
            if self.left == 0:
                self.do()
        arrays = room(1, 1, 1, state.x.shape[1], level)
        for array in arrays:
            array[:] = 0.0
        return arrays


def raising(kind):
    def do(*_):
        raise kind("in the midst")

    return do


def equilibrium(item=None, multigrid=None, options=None, size=6):
    """A strip that is pulled; returns the solver and what to solve."""
    strip = diagonals(size, 2 * size)
    constraints = Constraints(Network(MPI.COMM_SELF, strip, TABLE_1), True)
    edges = {edge: constraints.clamp(edge) for edge in ("lower", "upper")}
    cloth = Cloth(constraints, edges)
    model, items = cloth.model, [*cloth.ply.items, *([item] if item else [])]
    multigrid = multigrid or model.multigrid
    model = Model(cloth.nodes, items, cloth.ply.active, model.stiffness_scale, multigrid)
    solver = Equilibrium(model, cloth.state(), options)
    return solver, cloth.state(motions=[(edges["upper"], np.eye(2), np.array([0.0, 0.003]))])


def assert_comes_out(solver, guess, kind):
    with pytest.raises(kind, match="in the midst"):
        solver.solve(guess)
    solver.destroy()


@RAISED
@pytest.mark.parametrize(
    ("level", "times"),
    [(FORCE, 1), (FORCE, 2), (FORCE, 4), (STIFFNESS, 2), (STIFFNESS, 3)],
    ids=["residual", "line search", "second step", "tangent", "second tangent"],
)
def test_raised_in_newton(kind, level, times):
    solver, guess = equilibrium(Nothing(level, times, raising(kind)))
    assert_comes_out(solver, guess, kind)


@RAISED
def test_raised_in_the_multigrid(kind, monkeypatch):
    """While it is made, and in a smoother, which is a callback of a callback."""
    solver, guess = equilibrium(None, raising(kind), MULTIGRID)
    assert_comes_out(solver, guess, kind)
    solver, guess = equilibrium(None, None, MULTIGRID, LEVELS)
    monkeypatch.setattr(YarnSmoother, "apply", raising(kind))
    assert_comes_out(solver, guess, kind)


@RAISED
def test_raised_at_small_displacements(kind, monkeypatch):
    network = Network(MPI.COMM_SELF, diagonals(LEVELS, 2 * LEVELS), TABLE_1)
    monkeypatch.setattr(YarnSmoother, "apply", raising(kind))
    with pytest.raises(kind, match="in the midst"):
        BiasExtension(network, "1 mm", options=MULTIGRID, finite=False).solve()


def test_no_linear_solution_is_no_equilibrium():
    """What the multigrid refuses in words is still an error of equilibrium, in these words."""

    def refuse(_):
        raise SolverError("yarns without stiffness")

    solver, guess = equilibrium(None, refuse, MULTIGRID)
    with pytest.raises(EquilibriumError, match="solver failed: yarns without stiffness"):
        solver.solve(guess)
    solver.destroy()


def test_errors_of_petsc_stay_what_they_are():
    """Faults of the program; also after a callback's exception that was dealt with."""
    one, two = (PETSc.Vec().createSeq(size) for size in (1, 2))
    for _ in range(2):
        with pytest.raises(PETSc.Error, match="error code 75"), calling_back(one):
            one.axpy(1.0, two)
        with pytest.raises(ValueError, match="first"):
            callback(lambda: int("first"))()
    one.destroy()
    two.destroy()


# -- signals -------------------------------------------------------------------------------------


@pytest.fixture
def handled():
    """Handlers of SIGINT and SIGTERM are put back."""
    before = {number: signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM)}
    yield
    for number, handler in before.items():
        signal.signal(number, handler)


def sending(*numbers):
    def do():
        for number in numbers:
            signal.raise_signal(number)

    return do


@pytest.mark.parametrize("level", [FORCE, STIFFNESS])
def test_interrupted(handled, level):
    """Python's own handler of Ctrl-C raises, and is there again afterwards."""
    signal.signal(signal.SIGINT, signal.default_int_handler)
    solver, guess = equilibrium(Nothing(level, 2, sending(signal.SIGINT)))
    with pytest.raises(KeyboardInterrupt):
        solver.solve(guess)
    assert signal.getsignal(signal.SIGINT) is signal.default_int_handler
    solver.destroy()


def test_a_signal_after_the_last_callback(handled):
    """It waits for the end of PETSc's call."""
    signal.signal(signal.SIGINT, signal.default_int_handler)
    reached, solver = [], PETSc.KSP()

    def call():
        with calling_back(solver):
            signal.raise_signal(signal.SIGINT)
            reached.append(1)

    with pytest.raises(KeyboardInterrupt):
        call()
    assert reached


def test_a_handler_may_do_as_it_likes(handled):
    """It leaves a mark: called once a signal, in order; the result is the same to the last bit."""
    solver, guess = equilibrium()
    expected = solver.solve(guess)
    solver.destroy()
    came = []
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda number, _: came.append(number))
    both = signal.SIGTERM, signal.SIGINT, signal.SIGTERM
    solver, guess = equilibrium(Nothing(FORCE, 2, sending(*both)))
    found = solver.solve(guess)
    solver.destroy()
    assert tuple(came) == both
    assert found.history == expected.history
    np.testing.assert_array_equal(found.state.x, expected.state.x)
    signal.raise_signal(signal.SIGINT)
    assert len(came) == 4


def test_two_interrupts(handled):
    """Both handlers raise; neither is lost, and later ones raise where they come."""
    signal.signal(signal.SIGINT, signal.default_int_handler)
    signal.signal(signal.SIGTERM, raising(SystemExit))
    solver = PETSc.KSP()

    def call():
        with calling_back(solver):
            sending(signal.SIGINT, signal.SIGTERM)()
            with contextlib.suppress(KeyboardInterrupt):
                callback(lambda: None)()

    with pytest.raises(SystemExit, match="in the midst"):
        call()
    with pytest.raises(KeyboardInterrupt):
        signal.raise_signal(signal.SIGINT)
    solver, guess = equilibrium()
    assert solver.solve(guess).iterations > 1
    solver.destroy()
