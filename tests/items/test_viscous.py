# SPDX-License-Identifier: MIT
"""Viscosity: energy, force and stiffness; what it dissipates."""

from types import SimpleNamespace

import numpy as np
import pytest

from cruciform_petsc.elements.level import ENERGY, STIFFNESS
from cruciform_petsc.items.viscous import Viscous

REST = np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 2.0, 0.0]])
WEIGHT = np.array([3.0, 5.0])


def state(moved, time, memory=None):
    """The last two of three nodes are viscous."""
    return SimpleNamespace(x=REST + moved, time=time, memory={"viscosity": memory or {}})


def test_energy_and_derivatives():
    """c A |x - x_n|^2/(2 h), by differences; nothing at the time of the last step itself."""
    item = Viscous(np.array([1, 2]), REST[1:], WEIGHT)
    rng = np.random.default_rng(2)
    moved = rng.normal(size=(3, 3))
    energy, force, stiffness = item.work(state(moved, 0.5), STIFFNESS)
    wanted = WEIGHT * (moved[1:] ** 2).sum(axis=1) / (2 * 0.5)
    np.testing.assert_allclose(energy[:, 0], wanted)
    step = 1e-6
    for node in (1, 2):
        for axis in range(3):
            aside = np.zeros((3, 3))
            aside[node, axis] = step
            ahead = item.work(state(moved + aside, 0.5), STIFFNESS)
            behind = item.work(state(moved - aside, 0.5), STIFFNESS)
            slope = (ahead[0] - behind[0]).sum() / (2 * step)
            assert slope == pytest.approx(force[node - 1, 0, axis], rel=1e-6)
            bend = (ahead[1] - behind[1])[node - 1, 0] / (2 * step)
            np.testing.assert_allclose(bend, stiffness[node - 1, 0, :, 0, axis], atol=1e-6)
    assert item.work(state(moved, 0.0), STIFFNESS)[1].any() == np.False_
    assert len(item.work(state(moved, 0.5), ENERGY)[1]) == 0


def test_what_it_dissipates():
    """At a speed v for a time t: c A v^2 t, in however many steps."""
    item = Viscous(np.array([1, 2]), REST[1:], WEIGHT)
    speed, whole = np.array([0.1, -0.2, 0.3]), 2.0
    for steps in (1, 7):
        memory = {}
        for time in np.linspace(0.0, whole, steps + 1):
            memory = item.accepted(state(time * speed, time, memory))
        np.testing.assert_allclose(memory["spent"], WEIGHT * (speed @ speed) * whole)
