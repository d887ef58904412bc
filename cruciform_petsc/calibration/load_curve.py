# SPDX-License-Identifier: MIT
"""Loads of a specimen's network for one shear law after the other, and their derivatives.

At equilibrium the energy W(c, p) under the control c has dW/dp = sum of A dpsi/dp(gamma) over the
quadrants, as places give nothing to first order (envelope theorem). The load is dW/dc, hence

    dF/dp = sum over quadrants of A dpsi'/dp(gamma) dgamma/dc

with dgamma/dc along dx/dc, the answer of the places to the clamps, from one solve with the tangent.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from ..cloth.fabric import Fabric
from ..equilibrium.follow import follow
from ..equilibrium.newton import Equilibrium
from ..equilibrium.stages import Step
from ..equilibrium.state import State
from ..errors import CruciformError, EquilibriumError
from ..experiments.bias_extension import BiasExtension
from ..experiments.experiment import Experiment
from ..experiments.finite import FiniteTest
from ..experiments.picture_frame import PictureFrame
from ..laws import Potential
from ..net.network import Network
from .formula import frame_angle
from .specimen import Specimen

# What the law depends on without being identified, worth a look each time.
DOUBLED = ("tension modulus", "yarn bending", "compression")
PLACE = "place of the yarns"
STEP = 1e-5  # of the control, for differences


@dataclass(frozen=True, eq=False)
class Loads:
    """Equilibria of a specimen with one law, at each of n displacements."""

    law: Potential
    loads: np.ndarray  # (n,) N
    angles: np.ndarray  # (n,) largest shear angle of a crossover, rad
    states: list[State]


class LoadCurve:
    """Loads at a specimen's measured displacements, as functions of the shear law. Collective.

    Call destroy when done. ``options`` are PETSc's for the solver.
    """

    def __init__(self, specimen: Specimen, options: dict | None = None):
        self.specimen, self._options = specimen, options
        self.newton_steps = 0
        network, controls = specimen.network, specimen.curve.displacement
        settings: dict[str, Any] = {"finite": True, "bending": specimen.bending}
        self._experiment: Experiment
        if specimen.is_frame:
            controls = frame_angle(controls, specimen.sides)
            self._experiment = PictureFrame(network, controls, **settings)
        else:
            self._experiment = BiasExtension(network, controls, upper=specimen.upper, **settings)
        self._test = FiniteTest(self._experiment)
        self._equilibrium = Equilibrium(self._test.model, self._test.at(0.0), options)

    def destroy(self) -> None:
        """Free what PETSc holds. Collective."""
        self._equilibrium.destroy()

    def solve(self, law: Potential, start: Loads | None = None) -> Loads:
        """Find equilibrium at each displacement. Collective.

        From ``start``, of another law, it takes two or three Newton steps each; without, or where
        that fails, it is followed from rest. EquilibriumError on every rank if there is none.
        """
        self._take(law)
        steps: list[Step] = []
        try:
            for state in start.states if start else []:
                solved = self._equilibrium.solve(state)
                self.newton_steps += solved.iterations
                steps.append(Step.of([solved], self._test.measure(solved), True, 0))
        except EquilibriumError:
            steps = []
        if not steps:
            way = follow(self._equilibrium, self._test.stage(), self._test.at(0.0))
            self.newton_steps += sum(step.increment.iterations for step in way)
            steps = [step for step in way if step.increment.asked]
        found = [(step.increment.load, step.increment.shear_max) for step in steps]
        loads, angles = self.specimen.network.comm.bcast(np.transpose(found))
        return Loads(law, loads, angles, [step.state for step in steps])

    def _take(self, law: Potential) -> None:
        """Go on with the specimen of cloth with a law; tests of others stay what they are."""
        self._test = self._test.with_shear_law(law)
        self._equilibrium.model = self._test.model

    def solve_otherwise(self, what: str, start: Loads) -> np.ndarray | None:
        """Loads with another value of something assumed and the law of ``start``, N; (n,).

        Collective. ``what`` is one of DOUBLED, or PLACE: the yarns half a cell of the lattice away,
        which changes what yarns the clamps hold. None if that cannot be or has no equilibrium.
        """
        network, other = self.specimen.network, None
        fabric, preform = network.fabric, network.preform
        if what == "yarn bending" and not self.specimen.bending:
            return None
        try:
            if what == PLACE:
                x, y = network.origin + network.to_lab(0.5 * network.pitch)
                preform = replace(preform, origin=(float(x), float(y)))
            else:
                fabric = _with_twice(fabric, what)
            network = Network(network.comm, preform, fabric)
            other = LoadCurve(replace(self.specimen, network=network), self._options)
            return other.solve(start.law, None if what == PLACE else start).loads
        except CruciformError:  # on all ranks
            return None
        finally:
            if other is not None:
                self.newton_steps += other.newton_steps
                other.destroy()

    def derivatives(self, at: Loads, changes: Callable[[np.ndarray], np.ndarray]) -> np.ndarray:
        """Derivatives of the loads by parameters of the law, (n, m) N per unit. Collective.

        ``changes`` gives dpsi'/dp at shear angles (k,) rad, as (m, k) N/m per unit.
        """
        self._take(at.law)
        cruciforms, result = self._test.ply.cruciforms, []
        for state in at.states:
            moved, step = self._moved(state), STEP * state.time
            near = (self._test.at(state.time + s, state.x + s * moved) for s in (-step, step))
            behind, ahead = (cruciforms.quadrant_angles(cruciforms.arms(each)[1]) for each in near)
            load = self._experiment.load_of(1.0, state.time)
            rate = cruciforms.area * (ahead - behind) / (2.0 * step) * load
            result.append(changes(0.5 * (behind + ahead).ravel()) @ rate.ravel())
        return self.specimen.network.comm.allreduce(np.array(result))

    def _moved(self, state: State) -> np.ndarray:
        """Change of all places per change of the control, (n_local, 2)."""
        test, control = self._test, state.time
        if self.specimen.is_frame:  # uniform; its clamps turn what they hold, too
            behind, ahead = (
                self._experiment.motion("lower", control + s)[0] for s in (-STEP, STEP)
            )
            return test.ply.nodes.rest @ (ahead - behind).T / (2.0 * STEP)
        return self._equilibrium.tangent_step(state, test.rate(control))[0]


def _with_twice(fabric: Fabric, what: str) -> Fabric:
    """The cloth with twice one of DOUBLED; InputError if that cannot be."""
    if what == "compression":
        return replace(fabric, compression=2.0 * fabric.compression)
    if what == "tension modulus" and fabric.biaxial_law is not None:
        return fabric.with_biaxial_law(fabric.biaxial_law.times(2.0))
    name, times = ("yarn_bending", 1.0) if what == "yarn bending" else ("modulus", 2.0)
    changes = {}
    for side in ("warp", "weft"):
        family, law = getattr(fabric, side), getattr(fabric, f"{side}_law")
        changes[side] = replace(family, **{name: 2.0 * getattr(family, name)})
        changes[f"{side}_law"] = law and law.times(times)
    return replace(fabric, **changes)
