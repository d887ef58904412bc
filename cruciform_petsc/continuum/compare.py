# SPDX-License-Identifier: MIT
"""The membranes that stand beside a test of a network, and the differences to them."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
import shapely
from mpi4py import MPI

from ..errors import InputError
from ..experiments.experiment import Experiment
from ..experiments.result import TestResult

if TYPE_CHECKING:  # dolfinx is loaded when a membrane is solved
    from .domain import MembraneFields

# Part of the outline's width around singular points in which shear angles are not compared.
SINGULAR_RADIUS = 0.1


@dataclass(frozen=True)
class Comparison:
    """Differences network - membrane at the crossovers, and ratios network / membrane.

    Relative L2 differences are norms over that of the membrane's field.
    """

    points: int  # crossovers compared, on all ranks together
    points_shear: int  # those of them whose shear angles are compared
    relative_l2_displacement: float
    relative_l2_shear: float
    mean_abs_shear_deg: float  # mean absolute difference of the shear angle, degrees
    load_ratio: float
    energy_ratio: float

    def as_dict(self) -> dict[str, float]:
        """Plain numbers by name."""
        return asdict(self)


def solve_membranes(
    result: TestResult, size: float | None = None, bending: bool | None = None
) -> list[Any]:
    """Solve the continuum with a test's outline, edges and extensions in dolfinx. Collective.

    Parameters
    ----------
    result : TestResult
    size : float, optional
        Mesh size in metres.
    bending : bool, optional
        Of finite deformation: whether yarns resist bending; by default as in the network.

    Returns a HyperelasticResult for each state of a finite test; of small displacements, where
    states are in proportion, a MembraneResult for the last one. Raises InputError on every rank if
    there is no membrane of such a test.
    """
    experiment, network = result.experiment, result.network
    if experiment.reference == "free":
        raise InputError("there is no membrane with free ends to compare with: ends = 'grip'")
    if not experiment.reference:
        raise InputError(f"there is no continuum to compare a {experiment.kind} test with")
    cloth = (network.comm, network.preform, network.fabric, size)
    if not experiment.finite:
        from .membrane import Membrane

        return [Membrane(*cloth).solve_bias_extension(result.extension, experiment.upper)]
    from .hyperelastic import HyperelasticMembrane

    bending = experiment.bending if bending is None else bending
    membrane = HyperelasticMembrane(*cloth, bending=bending)
    extensions = [float(extension) for extension in result.extensions]
    return membrane.solve_bias_extension(extensions, experiment.upper)


def compare_with_membrane(
    result: TestResult, membrane: MembraneFields | None = None, state: int = -1
) -> Comparison:
    """Compare a state of a test, by default the last, with the continuum. Collective.

    ``membrane`` is a result at that state, by default the last of `solve_membranes`.
    """
    membrane = membrane or solve_membranes(result)[-1]
    fields, network = result.states[state].fields, result.network
    places = network.crossover_position, fields["displacement"], fields["shear_angle"]
    points, u, gamma = (values[fields["carrying"]] for values in places)
    energy = sum(energies[state] for energies in result.energies().values())
    return compare_fields(
        network.comm, points, u, gamma, result.states[state].load, energy, membrane
    )


@dataclass
class Reference:
    """A test beside its membranes, as plain data for files."""

    result: TestResult
    membranes: list[Any]  # see solve_membranes
    differences: list[Comparison]  # one for each of them

    @classmethod
    def solve(
        cls, result: TestResult, size: float | None = None, bending: bool | None = None
    ) -> Reference:
        """Solve the membranes and compare; see solve_membranes. Collective."""
        membranes = solve_membranes(result, size, bending)
        states = enumerate(membranes, len(result.states) - len(membranes))
        return cls(result, membranes, [compare_with_membrane(result, m, i) for i, m in states])

    def summary(self, without: TestResult | None = None) -> dict[str, Any]:
        """Differences and the membrane's figures by name. Collective.

        Lists where a finite test was asked for a list. `without`, the test without yarn bending,
        is compared with the last membrane, too.
        """
        experiment, last = self.result.experiment, self.membranes[-1]
        measured = {"load_n": "load", "energy_j": "energy"}
        summary: dict[str, Any] = {"dofs": last.dofs, "cells": last.cells, "mesh_size_m": last.size}
        if experiment.finite:
            measured["newton_iterations"] = "newton_iterations"
            summary |= {"second_gradient": last.membrane.bending, "stable": self.stable}
        rows = [
            difference.as_dict() | {key: getattr(membrane, name) for key, name in measured.items()}
            for difference, membrane in zip(self.differences, self.membranes, strict=True)
        ]
        if without is not None:
            summary["without_bending"] = compare_with_membrane(without, last).as_dict()
        if experiment.finite and experiment.is_curve:
            return {key: [row[key] for row in rows] for key in rows[0]} | summary
        return rows[-1] | summary

    @property
    def stable(self) -> bool | None:
        """Whether all states of a finite test are stable; None if that is not known of each."""
        stable = [membrane.stable for membrane in self.membranes]
        return None if None in stable else all(stable)

    def table(self) -> dict[str, Any]:
        """Columns over the states of a finite test; none of small displacements."""
        if not self.result.experiment.finite:
            return {}
        return {
            "extension_mm": 1e3 * self.result.extensions,
            "load_network_N": self.result.loads,
            "load_membrane_N": [membrane.load for membrane in self.membranes],
            "load_ratio": [row.load_ratio for row in self.differences],
            "mean_abs_shear_difference_deg": [row.mean_abs_shear_deg for row in self.differences],
        }

    def rung(self, finer: Experiment) -> dict[str, Any]:
        """Solve a finer network and compare its last state with the last membrane. Collective."""
        difference = compare_with_membrane(finer.solve(), self.membranes[-1])
        return {"crossovers": finer.network.num_crossovers_global} | difference.as_dict()


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

    Within a tenth of the outline's width of singular points, where the membrane's strains have no
    bound, shear angles are not compared: else mesh and pitch would decide on the difference.

    Parameters
    ----------
    comm : mpi4py communicator
    points, u_net : float (n, 2)
        Crossovers of this rank and their displacement, metres; n may be 0 and differ between ranks.
    gamma_net : float (n,)
        Their shear angle, radians; not finite where a crossover has none to compare.
    load_net, energy_net : float
        Newtons, joules; of the whole network, the same on every rank.
    membrane_result : MembraneResult, HyperelasticResult

    Raises InputError on every rank if a point lies outside of the membrane.
    """
    membrane = membrane_result.membrane
    field = membrane_result.evaluate(points)
    u, gamma = field["displacement"], field["shear_angle"]
    singular = shapely.multipoints(membrane.singular_points)
    far = ~(shapely.distance(singular, shapely.points(points)) < SINGULAR_RADIUS * membrane.width)
    has_shear = np.isfinite(gamma_net) & far
    gamma = np.where(has_shear, gamma, np.nan)
    return Comparison(
        **field_differences(comm, np.reshape(u_net, u.shape), u, gamma_net, gamma),
        load_ratio=ratio(load_net, membrane_result.load),
        energy_ratio=ratio(energy_net, membrane_result.energy),
    )


def field_differences(
    comm: MPI.Intracomm,
    u_net: np.ndarray,
    u: np.ndarray,
    gamma_net: np.ndarray,
    gamma: np.ndarray,
) -> dict[str, Any]:
    """Differences network - membrane, as in Comparison, at this rank's points. Collective.

    Parameters
    ----------
    comm : mpi4py communicator
    u_net, u : float (n, dim)
        Displacements, m.
    gamma_net, gamma : float (n,)
        Shear angles, radians; where either is not finite they are not compared.
    """
    has_shear = np.isfinite(gamma_net) & np.isfinite(gamma)
    gamma, off = gamma[has_shear], (np.asarray(gamma_net) - gamma)[has_shear]
    squares = [(x**2).sum() for x in (u_net - u, u, off, gamma)]
    sums = comm.allreduce(np.array([len(u), len(off), abs(off).sum(), *squares], float))
    count, count_shear, shear_abs, u_off, u_all, shear_off, shear_all = sums
    return {
        "points": int(count),
        "points_shear": int(count_shear),
        "relative_l2_displacement": ratio(u_off, u_all) ** 0.5,
        "relative_l2_shear": ratio(shear_off, shear_all) ** 0.5,
        "mean_abs_shear_deg": float(np.degrees(ratio(shear_abs, count_shear))),
    }


def ratio(a: float, b: float) -> float:
    """Divide a by b, nan where there is nothing to compare with."""
    return float(a / b) if b else float("nan")
