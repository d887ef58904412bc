# SPDX-License-Identifier: MIT
"""The network's fields against the membrane's."""

from __future__ import annotations

from dataclasses import asdict, dataclass

import numpy as np
from mpi4py import MPI

from .membrane import MembraneResult


@dataclass(frozen=True)
class Comparison:
    """Differences network - membrane at the crossovers, and ratios network / membrane.

    Attributes
    ----------
    points : int
        Number of crossovers compared, on all ranks together.
    relative_l2_displacement : float
        Norm of the difference over the norm of the membrane's displacement.
    relative_l2_shear : float
        The same for the shear angle.
    mean_abs_shear_deg : float
        Mean absolute difference of the shear angle in degrees.
    load_ratio, energy_ratio : float
    """

    points: int
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
    membrane_result: MembraneResult,
) -> Comparison:
    """Compare the network's fields with the membrane's at the crossovers. Collective.

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
    membrane_result : MembraneResult

    Returns
    -------
    Comparison
        The same on every rank.

    Raises
    ------
    InputError
        On every rank, if a point lies outside of the membrane.
    """
    field = membrane_result.evaluate(points)
    u, gamma = field["displacement"], field["shear_angle"]
    has_shear = np.isfinite(gamma_net)
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
        relative_l2_displacement=_ratio(u_off, u_all) ** 0.5,
        relative_l2_shear=_ratio(shear_off, shear_all) ** 0.5,
        mean_abs_shear_deg=float(np.degrees(_ratio(shear_abs, count_shear))),
        load_ratio=_ratio(load_net, membrane_result.load),
        energy_ratio=_ratio(energy_net, membrane_result.energy),
    )


def _ratio(a: float, b: float) -> float:
    """The quotient a / b, nan where there is nothing to compare with."""
    return float(a / b) if b else float("nan")
