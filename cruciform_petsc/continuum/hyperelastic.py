# SPDX-License-Identifier: MIT
"""Membrane at finite deformation: the continuum that the finite network is a net of.

Its energy is told in fibres.py, how equilibrium is found in balance.py.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import pairwise
from typing import Any

import dolfinx.fem
import numpy as np
from mpi4py import MPI

from ..errors import InputError
from .balance import Balance
from .domain import MembraneDomain, MembraneFields, check_upper
from .fibres import measures
from .sizes import finite_size, rigidity

Motion = tuple[Any, Any] | tuple[Any, Any, int | None]


class HyperelasticMembrane(MembraneDomain):
    """Membrane of any strains and rotations, with a fabric's laws. Collective.

    Parameters and attributes as of MembraneDomain. ``bending`` tells whether yarns resist bending
    in the plane (a second-gradient membrane); that needs degree 2 or more. Without a given size the
    triangles are 1/40 to 1/15 of the width, as the layers along yarns or, with bending, beside
    clamps ask for.
    """

    def __init__(
        self,
        comm: MPI.Intracomm,
        preform: Any,
        fabric: Any,
        size: float | None = None,
        degree: int = 3,
        grading: int = 3,
        bending: bool = False,
    ):
        if bending and degree < 2:
            raise InputError("a membrane whose yarns bend needs elements of degree 2 or more")
        self.bending = bending
        self.rigidity = bending * rigidity(fabric)
        if size is None:
            size = finite_size(preform.outline, fabric, degree, bending)
        super().__init__(comm, preform, fabric, size, degree, grading, share_facets=bending)

    def strain(self, u: Any) -> tuple[Any, Any, Any]:
        """Warp strain, weft strain (stretch less one) and shear angle, as UFL expressions."""
        warp, weft, shear = measures(u, self.directions)
        return warp - 1.0, weft - 1.0, shear

    def solve_bias_extension(
        self, extensions: Sequence[float], upper: str = "grip", prefix: str = "membrane_"
    ) -> list[HyperelasticResult]:
        """Clamp the edge "lower" and pull the edge "upper" along y, step by step. Collective.

        See Membrane.solve_bias_extension; `extensions` in metres, in the order in which they are
        gone to. Intermediate steps are taken as needed.
        """
        component, still = check_upper(upper), (np.eye(2), np.zeros(2))
        motions: list[dict[str, Motion]] = [
            {"lower": still, "upper": (np.eye(2), (0.0, extension), component)}
            for extension in extensions
        ]
        return self.solve_motions(motions, prefix)

    def solve_motions(
        self, motions: Sequence[Mapping[str, Motion]], prefix: str = "membrane_"
    ) -> list[HyperelasticResult]:
        """Move edges like rigid or homogeneously deformed bodies, from rest. Collective.

        Parameters
        ----------
        motions : sequence of dict
            For each increment, and its result: edge name -> (A, b) for x = A X + b with A (2, 2),
            of positive determinant, and b (2,) in metres, or (A, b, component) where only that
            component is prescribed. The same edges and components in all increments; where edges
            meet, later ones win.
        prefix : str
            Of the PETSc options of the linear solver; defaults as in Membrane.solve.

        Raises
        ------
        InputError
            On every rank: unknown edge, edges that differ between increments, a membrane that can
            float.
        SolverError
            On every rank: no equilibrium was found, even in very small steps. Its `history` has
            the last relative residuals.
        """
        if not motions:
            return []
        targets = [{name: _affine(*m) for name, m in increment.items()} for increment in motions]
        held, *others = (
            {name: None if len(motion) == 2 else motion[2] for name, motion in increment.items()}
            for increment in motions
        )
        if any(other != held for other in others):
            raise InputError("every increment must move the same edges in the same components")
        balance, results = Balance(self, self.rigidity, held, prefix), []
        places = pairwise([dict.fromkeys(held, np.eye(3)), *targets])
        try:
            for number, (start, target) in enumerate(places, 1):
                balance.advance(start, target, number)
                results.append(HyperelasticResult(self, balance))
        finally:
            balance.destroy()
        return results


class HyperelasticResult(MembraneFields):
    """Equilibrium of a hyperelastic membrane; see MembraneFields. Collective when made.

    Attributes
    ----------
    energy_tension, energy_shear, energy_bending : float
        Parts of the energy, joules.
    folded_area : float
        Area at rest whose shear angle is beyond 90 degrees, m^2.
    stable : bool or None
        Whether the energy has a minimum here; an equilibrium without one is left by a real cloth
        (its yarns buckle, see `Fabric.compression`). None if the linear solver does not factorise.
    newton_iterations, cuts : int
        Linear systems solved from the increment before, and steps that failed on the way.
    history : list of float
        Forces out of balance over the reactions, at each iteration of the last step.
    """

    def __init__(self, membrane: HyperelasticMembrane, balance: Balance):
        displacement = dolfinx.fem.Function(membrane.space, name="displacement")
        displacement.x.array[:] = balance.u.x.array
        super().__init__(membrane, displacement, balance.force())
        self.energy_tension, self.energy_shear, self.energy_bending = map(float, balance.energies)
        self.energy = float(sum(balance.energies))
        self.folded_area, self.stable = balance.folded_area(), balance.is_stable()
        self.newton_iterations, self.cuts = balance.iterations, balance.cuts
        self.history = list(balance.history)


def _affine(gradient: Any, shift: Any, component: int | None = None) -> np.ndarray:
    """Matrix (3, 3) of the motion x = A X + b."""
    gradient, shift = np.array(gradient, float), np.array(shift, float)
    if gradient.shape != (2, 2) or shift.shape != (2,) or component not in (None, 0, 1):
        raise InputError("the motion of an edge is (A (2, 2), b (2,)) and perhaps a component")
    if not np.linalg.det(gradient) > 0.0:
        raise InputError("the motion of an edge turns it inside out: A has no positive determinant")
    return np.vstack([np.column_stack([gradient, shift]), [0.0, 0.0, 1.0]])
