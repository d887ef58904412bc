# SPDX-License-Identifier: MIT
"""The network's fields against the membrane's."""

from __future__ import annotations

from dataclasses import asdict, dataclass

import numpy as np
from mpi4py import MPI

from .domain import MembraneFields, outline_width

# Part of the outline's width around singular points in which shear angles are not compared.
SINGULAR_RADIUS = 0.1


@dataclass(frozen=True)
class Comparison:
    """Differences network - membrane at the crossovers, and ratios network / membrane.

    Attributes
    ----------
    points, points_shear : int
        Number of crossovers compared, on all ranks together, and those of them whose shear angles
        are compared.
    relative_l2_displacement : float
        Norm of the difference over the norm of the membrane's displacement.
    relative_l2_shear : float
        The same for the shear angle.
    mean_abs_shear_deg : float
        Mean absolute difference of the shear angle in degrees.
    load_ratio, energy_ratio : float
    """

    points: int
    points_shear: int
    relative_l2_displacement: float
    relative_l2_shear: float
    mean_abs_shear_deg: float
    load_ratio: float
    energy_ratio: float

    def as_dict(self) -> dict[str, float]:
        """Plain numbers by name, for a summary."""
        return asdict(self)


def compare_fields(
    comm: MPI.Intracomm,
    points: np.ndarray,
    u_net: np.ndarray,
    gamma_net: np.ndarray,
    load_net: float,
    energy_net: float,
    membrane_result: MembraneFields,
) -> Comparison:
    """Compare the network's fields with the membrane's at the crossovers. Collective.

    The membrane's strains have no bound at the ends of its clamps and at re-entrant corners, so
    that crossovers within a tenth of the outline's width of those take no part in the comparison
    of the shear angle: neither the mesh nor the pitch then decides how large the difference is.

    Parameters
    ----------
    comm : mpi4py communicator
    points : float (n, 2)
        Crossovers of this rank, metres; n may be 0 and differ between the ranks.
    u_net : float (n, 2)
        Their displacement along x and y, metres.
    gamma_net : float (n,)
        Their shear angle, radians; not finite where a crossover has none, which leaves it out of
        the shear comparison.
    load_net, energy_net : float
        Newtons, joules; of the whole network, the same on every rank.
    membrane_result : MembraneResult, HyperelasticResult

    Returns
    -------
    Comparison
        The same on every rank.

    Raises
    ------
    InputError
        On every rank, if a point lies outside of the membrane.
    """
    membrane = membrane_result.membrane
    field = membrane_result.evaluate(points)
    u, gamma = field["displacement"], field["shear_angle"]
    has_shear = np.isfinite(gamma_net) & ~_is_near(
        points, membrane.singular_points, SINGULAR_RADIUS * outline_width(membrane.preform.outline)
    )
    off = (np.asarray(gamma_net) - gamma)[has_shear]
    local = [
        len(u),
        ((np.reshape(u_net, u.shape) - u) ** 2).sum(),
        (u**2).sum(),
        len(off),
        (off**2).sum(),
        (gamma[has_shear] ** 2).sum(),
        abs(off).sum(),
    ]
    count, u_off, u_all, count_shear, shear_off, shear_all, shear_abs = comm.allreduce(
        np.array(local, float)
    )
    return Comparison(
        points=int(count),
        points_shear=int(count_shear),
        relative_l2_displacement=_ratio(u_off, u_all) ** 0.5,
        relative_l2_shear=_ratio(shear_off, shear_all) ** 0.5,
        mean_abs_shear_deg=float(np.degrees(_ratio(shear_abs, count_shear))),
        load_ratio=_ratio(load_net, membrane_result.load),
        energy_ratio=_ratio(energy_net, membrane_result.energy),
    )


def _is_near(points: np.ndarray, centres: np.ndarray, radius: float) -> np.ndarray:
    """Whether points (n, 2) lie within a radius of any of the centres (m, 2)."""
    near = np.zeros(len(points), bool)
    for centre in centres:
        near |= np.linalg.norm(points - centre, axis=1) < radius
    return near


def _ratio(a: float, b: float) -> float:
    """Divide a by b, nan where there is nothing to compare with."""
    return float(a / b) if b else float("nan")
