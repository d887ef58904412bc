# SPDX-License-Identifier: MIT
"""Equilibrium with what is taken as given: how long it is sought, what is said when it is not."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from cruciform_petsc.equilibrium import lagged
from cruciform_petsc.equilibrium.lagged import settle
from cruciform_petsc.equilibrium.state import Found, Hold, State
from cruciform_petsc.errors import EquilibriumError


class Pushed:
    """A spring of 1 N/m pushed by 10 N less ``back`` times where it is, as that was before."""

    def __init__(self, back):
        self.back, self.loose, self.few = back, [], []
        self.model = SimpleNamespace(lags=True, items=[], lagged=self.lagged)

    @property
    def solved(self):
        """How often equilibrium was sought."""
        return len(self.loose)

    def solve(self, guess, loose, few):
        """As well as is asked for, no better."""
        self.loose.append(loose)
        self.few.append(few)
        x = np.full((1, 3), guess.memory["push"]["force"])
        return Found(replace(guess, x=x), {}, x, 2, loose, 1.0, [1.0, loose], 1, 3, 0.5, 1, 2, 4)

    def lagged(self, state):
        force = 10.0 - self.back * state.x[0, 0]
        change = abs(force - state.memory["push"]["force"])
        return replace(state, memory={"push": {"force": force}}), change, abs(force)


def start():
    """At rest, nothing known of the push."""
    hold = Hold(*(np.zeros(0, int), *(np.zeros((0, 3, 3)),) * 4))
    return State(np.zeros((1, 3)), hold, memory={"push": {"force": 0.0}})


@pytest.mark.parametrize("back", [0.0, 0.25, 0.7])
def test_it_settles(back):
    """Until what is taken as given is right to a thousandth; rounds and steps are summed."""
    pushed = Pushed(back)
    found = settle(pushed, start())
    assert found.state.x[0, 0] == pytest.approx(10.0 / (1.0 + back), rel=1.1 * lagged.SETTLED)
    assert found.rounds == pushed.solved > 1
    assert found.iterations == 2 * found.rounds
    assert (found.shifted, found.linear_iterations) == (found.rounds, 3 * found.rounds)
    assert found.seconds == pytest.approx(0.5 * found.rounds)
    assert (found.factorisations, found.evaluations) == (2 * found.rounds, 4 * found.rounds)


@pytest.mark.parametrize("known", [0.0, 10.0])
def test_only_the_first_round_is_loose(known):
    """What is taken as given may be right at once: equilibrium is sought well all the same."""
    pushed, begin = Pushed(0.0), start()
    found = settle(pushed, replace(begin, memory={"push": {"force": known}}))
    assert pushed.loose == [lagged.FIRST, 1.0]
    assert found.residual <= found.tolerance
    # What has no memory lags behind nothing.
    pushed = SimpleNamespace(
        solve=lambda guess, loose, few: Found(guess, {}, guess.x, 1, loose, 1.0, [], 0, 0, 0.0),
        model=SimpleNamespace(lags=False, items=[], lagged=lambda state: (state, 0.0, 0.0)),
    )
    assert settle(pushed, replace(begin, memory={})).rounds == 1


def test_it_does_not_settle():
    """To and fro for ever: an error that says by how much, after MOST_ROUNDS."""
    pushed = Pushed(1.0)
    with pytest.raises(EquilibriumError, match=r"friction does not settle: .* 10 of (0|10) N"):
        settle(pushed, start())
    assert pushed.solved == lagged.MOST_ROUNDS


@pytest.mark.parametrize("pushes", [0.0, 10.0])
def test_a_first_round_is_short_where_nothing_presses(pushes):
    """What is far from equilibrium without friction goes a few steps before friction is known."""
    pushed = Pushed(0.0)
    known = pushed.lagged

    def silent(state):
        state, change, size = known(state)
        return state, change, size if pushed.few or pushes else 0.0

    pushed.model.lagged = silent
    settle(pushed, start())
    assert pushed.few[0] == (np.inf if pushes else lagged.FEW)
    assert set(pushed.few[1:]) == {np.inf}
