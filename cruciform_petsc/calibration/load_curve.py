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

from ..equilibrium.finite import FiniteNetwork
from ..equilibrium.newton import Equilibrium, EquilibriumError, follow
from ..errors import CruciformError, InputError
from ..experiments.bias_extension import BiasExtension
from ..experiments.experiment import Experiment
from ..experiments.picture_frame import PictureFrame
from ..laws import LINEAR, TABLE, Potential
from ..net.edges import Constraints
from ..net.lattice import QUADRANTS
from ..net.network import Network
from .formula import frame_angle

KINDS = (BiasExtension.kind, PictureFrame.kind)
# What the law depends on without being identified, worth a look each time.
DOUBLED = ("tension modulus", "yarn bending", "compression")
PLACE = "place of the yarns"
OFF_RECTANGLE = 1e-6  # of its area, that a rectangle given as a polygon may be
STEP = 1e-5  # of the control, for differences


@dataclass(frozen=True, eq=False)
class Loads:
    """Equilibria of a specimen with one law.

    Attributes
    ----------
    law : Potential
    loads : float (n,)
        At each displacement [N].
    angles : float (n,)
        Largest shear angle of a crossover [rad].
    places : list of float (n_local, 2)
        Positions of the network's nodes, of this rank.
    """

    law: Potential
    loads: np.ndarray
    angles: np.ndarray
    places: list[np.ndarray]


class LoadCurve:
    """The load of a specimen at given displacements, as a function of the shear law. Collective.

    Call destroy when done.

    Parameters
    ----------
    network : Network
    displacement : float (n,)
        Ascending [m]: extensions, or growths of a picture frame's diagonal.
    kind, upper, bending
        See Specimen.
    options : dict, optional
        PETSc options for the solver.
    """

    def __init__(
        self,
        network: Network,
        displacement: np.ndarray,
        kind: str = KINDS[0],
        upper: str = "grip",
        bending: bool = True,
        options: dict | None = None,
    ):
        self.network, self.displacement = network, np.asarray(displacement, float)
        self._settings = kind, upper, bending, options
        self.experiment: Experiment
        if kind == PictureFrame.kind:
            angles = frame_angle(self.displacement, frame_sides(network))
            self.experiment = PictureFrame(network, angles, finite=True, bending=bending)
        else:
            self.experiment = BiasExtension(
                network, self.displacement, upper=upper, finite=True, bending=bending
            )
        constraints = Constraints(network, bending)
        self._grips = self.experiment.grip(constraints)
        self._model = FiniteNetwork(constraints)
        self._equilibrium = Equilibrium(self._model, options)
        self.newton_steps = 0

    def destroy(self) -> None:
        """Free what PETSc holds. Collective."""
        self._equilibrium.destroy()

    def solve(self, law: Potential, start: Loads | None = None) -> Loads:
        """Find equilibrium at each displacement. Collective.

        From ``start``, of another law, it takes two or three Newton steps each; without, and where
        that fails, from rest.

        Raises
        ------
        EquilibriumError
            On every rank: there is no equilibrium.
        """
        self._model.cloth = replace(self._model.cloth, shear=law.packed)
        if start is not None:
            try:
                return self._measured(law, lambda accept: self._restart(start.places, accept))
            except EquilibriumError:
                pass
        return self._measured(law, self._from_rest)

    def solve_otherwise(self, what: str, start: Loads) -> np.ndarray | None:
        """Loads with another value of something assumed, with the law of ``start``, N; (n,).

        Collective. ``what`` is one of DOUBLED, or PLACE: the yarns half a cell of the lattice away,
        which changes what yarns the clamps hold. None if that cannot be or has no equilibrium.
        """
        kind, upper, bending, options = self._settings
        fabric, preform = self.network.fabric, self.network.preform
        warp, weft = fabric.warp, fabric.weft
        try:
            if what == "tension modulus":
                fabric = replace(
                    fabric,
                    warp=replace(warp, modulus=2.0 * warp.modulus),
                    weft=replace(weft, modulus=2.0 * weft.modulus),
                    warp_law=_doubled(fabric.warp_law),
                    weft_law=_doubled(fabric.weft_law),
                )
            elif what == "yarn bending":
                if not bending:
                    return None
                fabric = replace(
                    fabric,
                    warp=replace(warp, yarn_bending=2.0 * warp.yarn_bending),
                    weft=replace(weft, yarn_bending=2.0 * weft.yarn_bending),
                )
            elif what == "compression":
                fabric = replace(fabric, compression=2.0 * fabric.compression)
            else:
                shift = self.network.to_lab(0.5 * self.network.pitch)
                x, y = map(float, preform.lattice_origin + shift)
                preform = replace(preform, origin=(x, y))
            network = Network(self.network.comm, preform, fabric)
            other = LoadCurve(network, self.displacement, kind, upper, bending, options)
        except CruciformError:  # on all ranks
            return None
        try:
            return other.solve(start.law, None if what == PLACE else start).loads
        except EquilibriumError:
            return None
        finally:
            self.newton_steps += other.newton_steps
            other.destroy()

    def derivatives(self, at: Loads, changes: Callable[[np.ndarray], np.ndarray]) -> np.ndarray:
        """Derivatives of the loads by parameters of the law, (n, m) N per unit. Collective.

        Parameters
        ----------
        at : Loads
        changes : callable
            Gives dpsi'/dp at shear angles (k,), as (m, k) N/m per unit.
        """
        model = self._model
        model.cloth = replace(model.cloth, shear=at.law.packed)
        rows, area = model.cruciforms.rows, model.cruciforms.area
        result = []
        for control, x in zip(self.experiment.values, at.places, strict=True):
            moved, step = self._moved(control, x), STEP * control
            behind, ahead = (self._quadrants(control + s, x + s * moved) for s in (-step, step))
            angle = 0.5 * (behind + ahead)[rows].ravel()
            rate = (area * (ahead - behind)[rows]).ravel() / (2.0 * step)
            result.append(changes(angle) @ rate * self.experiment.load_of(1.0, control))
        return self.network.comm.allreduce(np.array(result))

    # What knows how a network is driven, solved and measured is below.

    def _measured(self, law: Potential, run: Callable[[Callable[[float], None]], None]) -> Loads:
        """What `run` finds, which calls its argument at each equilibrium that counts."""
        loads, angles, places = [], [], []

        def accept(control: float) -> None:
            x = self._equilibrium.x.copy()
            angles.append(self._model.shear_angle_max(x))
            places.append(x)
            state = self.experiment._state(self._model, self._equilibrium, self._grips, control)
            loads.append(state.load)

        run(accept)
        return Loads(law, *self.network.comm.bcast((np.array(loads), np.array(angles))), places)

    def _restart(self, places: list[np.ndarray], accept: Callable[[float], None]) -> None:
        for control, x in zip(self.experiment.values, places, strict=True):
            self._place(control, x)
            self.newton_steps += self._equilibrium.solve(control).iterations
            accept(control)

    def _from_rest(self, accept: Callable[[float], None]) -> None:
        def accepted(increment, _x) -> None:
            self.newton_steps += increment.iterations
            if increment.asked:
                accept(increment.control)

        self._place(0.0, self._model.rest)
        targets = [float(value) for value in self.experiment.values]
        step = self.experiment.default_step()
        follow(self._equilibrium, self._drive, targets, step, accepted)

    def _drive(self, control: float):
        return self.experiment._motions(self._grips, control), 0.0

    def _place(self, control: float, x: np.ndarray) -> None:
        """Put the nodes, and what clamps hold, where they are at a control."""
        self._equilibrium.x = x.copy()
        self._model.prescribe(self._equilibrium.x, self._drive(control)[0])

    def _moved(self, control: float, x: np.ndarray) -> np.ndarray:
        """Change of all places per change of the control, yarn frame, (n_local, 2)."""
        experiment, network, model = self.experiment, self.network, self._model
        self._place(control, x)
        if experiment.kind == PictureFrame.kind:  # uniform; its clamps also turn what they hold
            behind, ahead = (experiment.motion("lower", control + s)[0] for s in (-STEP, STEP))
            return network.to_yarn(network.to_lab(model.rest) @ (ahead - behind).T) / (2.0 * STEP)
        return experiment._load_slope(model, self._equilibrium, self._grips, control)[1]

    def _quadrants(self, control: float, x: np.ndarray) -> np.ndarray:
        """Shear angle of each quadrant, rad; (crossovers owned, 4)."""
        self._model.prescribe(x.copy(), self._drive(control)[0])
        rotation = self._model.crossover_fields(x)["arm_rotation"]
        return rotation[:, QUADRANTS[:, 0]] - rotation[:, QUADRANTS[:, 1]]


def frame_sides(network: Network) -> tuple[float, float]:
    """Sides of a picture frame, m."""
    size = network.preform.sides(OFF_RECTANGLE)
    if size is None:
        raise InputError("a picture frame's specimen must be a rectangle, from hinge to hinge")
    return size


def _doubled(law: Potential | None) -> Potential | None:
    """Twice a law; what is linear in the force follows the kind, numbers and knots."""
    if law is None:
        return None
    kind = law.data[0]
    first = 1 if kind == LINEAR else 3 + int(law.data[1]) if kind == TABLE else 2
    return Potential((*law.data[:first], *(2.0 * value for value in law.data[first:])))
