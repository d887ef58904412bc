# SPDX-License-Identifier: MIT
"""Stability of a test on its way: critical loads, their modes, the branch beyond.

See equilibrium.stability for what is looked at. Of each accepted increment the curve tells the
lowest stiffness; where that passes zero, an increment of its own stands for the critical state.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np

from ..equilibrium.newton import Equilibrium
from ..equilibrium.stability import Modes, Stability
from ..equilibrium.stages import Increment, Stage
from ..equilibrium.state import State as Placed
from ..quantities import declare
from . import result

AT_HINGE = 1 / 3  # a quadrant's corners, its hinge and two arm ends, share its area alike
SMALL = 1e-3  # of the first value asked for: the load of the linearised problem
STEP = 1e-3  # of the cloth's longer side: how far along a mode, where there is no thickness,
OF_THICKNESS = 0.1  # else of that

SOFTEST = declare(
    "lowest_stiffness_Pa_per_mm", "lowest stiffness", "lowest stiffness, of the softest shape"
)
CRITICAL = "critical"  # column: 1 where the lowest stiffness is zero


class Watch:
    """Watches over a FiniteTest. Collective, as are its methods; call destroy when done.

    Raises EquilibriumError on every rank where the cloth is not stable at rest.
    """

    def __init__(self, test: Any, equilibrium: Equilibrium, start: Placed):
        self.test, self.table = test, test.experiment.stability
        self._start, self._equilibrium = start, equilibrium
        told, fabric = self.table.step, test.network.fabric
        step = STEP * float(test.network.preform.size.max())
        if told is not None:
            step = told.si
        elif fabric.thickness is not None:
            step = OF_THICKNESS * fabric.thickness
        area = test.ply.areas(AT_HINGE)
        self.stability = Stability(test.model, area, self.table.modes, step, self.table.branch)
        self.stability.at_rest(start)
        self._linear: Modes | None = None
        self.buckling = result.Buckling([])

    def destroy(self) -> None:
        """Free what PETSc holds."""
        self.stability.destroy()

    def stage(self, stage: Stage) -> Stage:
        """The stage with an eye on it."""
        return replace(stage, watch=partial(self.stability.watch, self._equilibrium, stage.drive))

    def foretell(self) -> None:
        """Solve the linearised problem: by a small share of the first value asked for."""
        values = self.test.experiment.values
        control = SMALL * float(values[np.flatnonzero(values)[0]])
        found, modes = self.stability.linear(
            self._equilibrium, self.test.drive, self._start, control
        )
        load = self.test.measure(found).load
        self._linear = modes
        self.buckling.linear = [
            result.Critical(control * share, load * share) for share in map(float, modes.values)
        ]

    def columns(self, state: Placed) -> dict[str, float]:
        """Of the curve."""
        softest = float(self.stability.modes(state).values[0])
        return {
            SOFTEST.column: softest / SOFTEST.scale,
            CRITICAL: float(abs(softest) <= self.stability.noise),
        }

    def finish(self, increments: Sequence[Increment], state_of: Any) -> result.Buckling:
        """Gather what was passed, and the modes; ``state_of``: number of an increment -> State."""
        numbers = [n for n, step in enumerate(increments) if step.columns[CRITICAL]]
        self.buckling.passed = [
            result.Critical(increments[n].control, increments[n].load) for n in numbers
        ]
        state, modes = self._start, self._linear
        if numbers:
            state = state_of(numbers[0])
            modes = self.stability.modes(state)
        if modes is None:
            return self.buckling
        self.buckling.modes = [self._as_displacement(shape) for shape in modes.shapes]
        if not numbers:
            modes = self.stability.modes(state)
        self.buckling.stiffness = [float(value) for value in modes.values]
        return self.buckling

    def _as_displacement(self, shape: np.ndarray) -> result.State:
        """What pictures and files are made of."""
        ply = self.test.ply
        at_rest = self._start
        fields = {
            name: value if value.dtype == bool else np.zeros_like(value)
            for name, value in ply.fields(at_rest).items()
        }
        crossovers, nodes = ply.displacement(replace(at_rest, x=at_rest.x + shape))
        return result.State(0.0, 0.0, fields | {"displacement": crossovers}, nodes)
