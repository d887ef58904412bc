# SPDX-License-Identifier: MIT
"""Equilibrium with what items take from the state before, until that no longer matters."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ..errors import EquilibriumError
from .newton import Equilibrium
from .state import Found, State

# Forces taken as given are right to this share of their sum.
SETTLED = 1e-3
MOST_ROUNDS = 30
# A first round seeks equilibrium only as well as what it takes as given is worth: what is brought
# up to date after it changes forces by some 50 times the tolerance.
FIRST = 100.0  # times the tolerance
# Before anything has pressed nothing rubs: equilibrium may be far away then, or nowhere.
FEW = 3  # Newton steps of a first round


def settle(equilibrium: Equilibrium, guess: State) -> Found:
    """Find equilibrium near a state, with friction's normal forces as they are there. Collective.

    Raises EquilibriumError on every rank.
    """
    rounds: list[Found] = []
    loose, few = 1.0, np.inf
    if equilibrium.model.lags and any(guess.memory.values()):
        loose, few = FIRST, np.inf if equilibrium.model.lagged(guess)[2] else FEW
    patience = min((item.patience for item in equilibrium.model.items), default=np.inf)
    while len(rounds) < MOST_ROUNDS:
        rounds.append(equilibrium.solve(guess, loose, min(few, patience)))
        guess, change, size = equilibrium.model.lagged(rounds[-1].state)
        loose, few = 1.0, np.inf
        if change <= SETTLED * size and rounds[-1].residual <= rounds[-1].tolerance:
            return replace(
                rounds[-1],
                iterations=sum(found.iterations for found in rounds),
                shifted=sum(found.shifted for found in rounds),
                linear_iterations=sum(found.linear_iterations for found in rounds),
                seconds=sum(found.seconds for found in rounds),
                rounds=len(rounds),
                factorisations=sum(found.factorisations for found in rounds),
                evaluations=sum(found.evaluations for found in rounds),
            )
    history = [force for found in rounds for force in found.history]
    raise EquilibriumError(
        f"friction does not settle: normal forces change by {change:.3g} of {size:.3g} N still",
        "LAGGED",
        history,
    )
