# SPDX-License-Identifier: MIT
"""What a test prescribes as it goes on, and what is kept of each accepted step."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from .state import Found, Hold, State


@dataclass(frozen=True)
class Measured:
    """What a test measures on a state.

    Attributes
    ----------
    load : float
        Of the test, N; 0 where there is none.
    forces : dict of float (dim,)
        Force that holds each edge, lab frame, N.
    shear_max : float
        Largest shear angle of a crossover, radians.
    """

    load: float = 0.0
    forces: Mapping[str, np.ndarray] = field(default_factory=dict)
    shear_max: float = float("nan")


@dataclass(frozen=True)
class Stage:
    """A part of a test with one control, which is the time of its states.

    Attributes
    ----------
    name : str
    drive : callable
        control -> Hold, and sizes of loads by item.
    targets : sequence of float
        Values asked for, in order: of the control, or with ``by_load`` of the load.
    step : float, optional
        Largest step of the control; by default from target to target.
    by_load : bool
        Loads are asked for; the controls that give them are found.
    load_step : float, optional
        With ``by_load``: largest step of the load; by default from target to target.
    load_tolerance : float
        With ``by_load``: how near is near enough, N.
    load : callable
        Found -> work per change of the control, N if the control is a length.
    rate : callable
        control -> change of what is prescribed per change of the control, (n_local, dim).
    measure : callable
        Found -> Measured, for accepted steps.
    carry_on : bool
        Start each step from the last ones carried on; else from the last one as it was, as where
        contacts switch, and keep to cut steps until they are easy again.
    easy : int
        Newton steps after which a step that was cut may grow again.
    watch : callable, optional
        (state accepted before, Found) -> list of Found to be accepted in place of the one found,
        the last one with its control: critical states that were passed come before it.
    """

    name: str
    drive: Callable[[float], tuple[Hold, Mapping[str, float]]]
    targets: Sequence[float]
    step: float | None = None
    by_load: bool = False
    load_step: float | None = None
    load_tolerance: float = 0.0
    load: Callable[[Found], float] = lambda found: float("nan")
    rate: Callable[[float], np.ndarray] = lambda control: np.zeros(0)
    measure: Callable[[Found], Measured] = lambda found: Measured()
    carry_on: bool = True
    easy: int = 8
    watch: Callable[[State, Found], list[Found]] | None = None


@dataclass(frozen=True)
class Increment:
    """Figures of an accepted step: all that tables tell of it.

    Attributes
    ----------
    control : float
        Extension in m, angle in rad, strain or load.
    load, shear_max
        See Measured.
    energies : dict
        Strain energies by mode, J.
    iterations, linear_iterations : int
        Newton's, and those of the linear systems in them, tries that failed not counted.
    residual, tolerance : float
        N.
    history : list of float
        Residual before each Newton step of the last solution, and the last one.
    shifted : int
        Newton steps for which the tangent was mended.
    rounds : int
        How often equilibrium was sought, see Found.
    seconds : float
    asked : bool
        Whether it is one that was asked for, rather than a step on the way.
    cuts : int
        How often a step failed and was halved before this one.
    factorisations, evaluations : int
        Tangents solved with, and how often forces were looked at, see Found.
    columns : dict of float or None
        What the test's curve tells of it, by column; None is for not a number.
    """

    control: float
    load: float
    shear_max: float
    energies: dict[str, float]
    iterations: int
    linear_iterations: int
    residual: float
    tolerance: float
    history: list[float] = field(repr=False)
    shifted: int = 0
    rounds: int = 1
    seconds: float = 0.0
    asked: bool = False
    cuts: int = 0
    factorisations: int = 0
    evaluations: int = 0
    columns: dict[str, float | None] = field(default_factory=dict, repr=False)


@dataclass(frozen=True)
class Step:
    """One accepted state, as it was found, with what was measured on it; forces as in Measured."""

    state: State
    forces: Mapping[str, np.ndarray]
    increment: Increment

    @classmethod
    def of(cls, solved: Sequence[Found], measured: Measured, asked: bool, cuts: int) -> Step:
        """The last of several solutions that it took, with what all took together."""
        last = solved[-1]
        increment = Increment(
            last.state.time,
            measured.load,
            measured.shear_max,
            last.energies,
            sum(found.iterations for found in solved),
            sum(found.linear_iterations for found in solved),
            last.residual,
            last.tolerance,
            last.history,
            sum(found.shifted for found in solved),
            sum(found.rounds for found in solved),
            sum(found.seconds for found in solved),
            asked,
            cuts,
            sum(found.factorisations for found in solved),
            sum(found.evaluations for found in solved),
        )
        return cls(last.state, measured.forces, increment)
