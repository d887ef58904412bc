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

import numpy as np

from ..cloth.fabric import Fabric
from ..equilibrium.finite import FiniteNetwork
from ..equilibrium.newton import Equilibrium, EquilibriumError, follow
from ..errors import CruciformError
from ..experiments.bias_extension import BiasExtension
from ..experiments.experiment import Experiment
from ..experiments.picture_frame import PictureFrame
from ..laws import LINEAR, TABLE, Potential
from ..net.edges import Constraints
from ..net.lattice import QUADRANTS
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
    places: list[np.ndarray]  # positions of this rank's nodes, (n_local, 2) each


class LoadCurve:
    """Loads at a specimen's measured displacements, as functions of the shear law. Collective.

    Call destroy when done. ``options`` are PETSc's for the solver.
    """

    def __init__(self, specimen: Specimen, options: dict | None = None):
        self.specimen, self._options = specimen, options
        self.newton_steps = 0
        network, bending = specimen.network, specimen.bending
        controls = specimen.curve.displacement
        self._experiment: Experiment
        if specimen.is_frame:
            controls = frame_angle(controls, specimen.sides)
            self._experiment = PictureFrame(network, controls, finite=True, bending=bending)
        else:
            self._experiment = BiasExtension(
                network, controls, upper=specimen.upper, finite=True, bending=bending
            )
        self._controls = [float(control) for control in controls]
        constraints = Constraints(network, bending)
        self._grips = self._experiment.grip(constraints)
        self._model = FiniteNetwork(constraints)
        self._equilibrium = Equilibrium(self._model, options)

    def destroy(self) -> None:
        """Free what PETSc holds. Collective."""
        self._equilibrium.destroy()

    def solve(self, law: Potential, start: Loads | None = None) -> Loads:
        """Find equilibrium at each displacement. Collective.

        From ``start``, of another law, it takes two or three Newton steps each; without, or where
        that fails, it is followed from rest. EquilibriumError on every rank if there is none.
        """
        experiment, model, equilibrium = self._experiment, self._model, self._equilibrium
        model.cloth = replace(model.cloth, shear=law.packed)
        found: list[tuple[float, float]] = []  # load, angle
        places: list[np.ndarray] = []

        def accepted(increment, x: np.ndarray) -> None:
            self.newton_steps += increment.iterations
            if increment.asked:
                state = experiment._state(model, equilibrium, self._grips, increment.control)
                found.append((state.load, model.shear_angle_max(x)))
                places.append(x.copy())

        try:
            for control, x in zip(self._controls, start.places if start else [], strict=False):
                equilibrium.x = self._place(control, x)
                accepted(replace(equilibrium.solve(control), asked=True), equilibrium.x)
        except EquilibriumError:
            found, places = [], []
        if not found:
            equilibrium.x = self._place(0.0, model.rest)
            step = experiment.default_step()
            follow(equilibrium, self._drive, self._controls, step, accepted)
        loads, angles = self.specimen.network.comm.bcast(np.transpose(found))
        return Loads(law, loads, angles, places)

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
                x, y = preform.lattice_origin + network.to_lab(0.5 * network.pitch)
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
        model = self._model
        model.cloth = replace(model.cloth, shear=at.law.packed)
        rows, area = model.cruciforms.rows, model.cruciforms.area
        result = []
        for control, x in zip(self._controls, at.places, strict=True):
            moved, step = self._moved(control, x), STEP * control
            behind, ahead = (
                self._quadrants(control + s, x + s * moved)[rows] for s in (-step, step)
            )
            rate = area * (ahead - behind) / (2.0 * step) * self._experiment.load_of(1.0, control)
            result.append(changes(0.5 * (behind + ahead).ravel()) @ rate.ravel())
        return self.specimen.network.comm.allreduce(np.array(result))

    def _drive(self, control: float):
        return self._experiment._motions(self._grips, control), 0.0

    def _place(self, control: float, x: np.ndarray) -> np.ndarray:
        """Positions with the clamps, and what these hold, where they are at a control."""
        x = x.copy()
        self._model.prescribe(x, self._drive(control)[0])
        return x

    def _moved(self, control: float, x: np.ndarray) -> np.ndarray:
        """Change of all places per change of the control, yarn frame, (n_local, 2)."""
        experiment, network, model = self._experiment, self.specimen.network, self._model
        if self.specimen.is_frame:  # uniform; its clamps turn what they hold, too
            behind, ahead = (experiment.motion("lower", control + s)[0] for s in (-STEP, STEP))
            return network.to_yarn(network.to_lab(model.rest) @ (ahead - behind).T) / (2.0 * STEP)
        self._equilibrium.x = self._place(control, x)
        return experiment._load_slope(model, self._equilibrium, self._grips, control)[1]

    def _quadrants(self, control: float, x: np.ndarray) -> np.ndarray:
        """Shear angle of each quadrant, rad; (crossovers owned, 4)."""
        rotation = self._model.crossover_fields(self._place(control, x))["arm_rotation"]
        return rotation[:, QUADRANTS[:, 0]] - rotation[:, QUADRANTS[:, 1]]


def _with_twice(fabric: Fabric, what: str) -> Fabric:
    """The cloth with twice one of DOUBLED; InputError if that cannot be."""
    if what == "compression":
        return replace(fabric, compression=2.0 * fabric.compression)
    name, times = ("yarn_bending", 1.0) if what == "yarn bending" else ("modulus", 2.0)
    changes = {}
    for side in ("warp", "weft"):
        family, law = getattr(fabric, side), getattr(fabric, f"{side}_law")
        changes[side] = replace(family, **{name: 2.0 * getattr(family, name)})
        changes[f"{side}_law"] = law and _times(times, law)
    return replace(fabric, **changes)


def _times(factor: float, law: Potential) -> Potential:
    """A law times a number; what is linear in the force follows the kind, numbers and knots."""
    kind, number = law.data[:2]
    first = 1 if kind == LINEAR else 3 + int(number) if kind == TABLE else 2
    return Potential((*law.data[:first], *(factor * value for value in law.data[first:])))
