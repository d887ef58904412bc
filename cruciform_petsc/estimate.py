# SPDX-License-Identifier: MIT
"""What a case will take, before anything of it is made: memory and time of each part.

Numbers are those of one core of 2020 or so, for networks and membranes of some 10^4 to 10^6
unknowns with the default solvers; others may take half or three times as much. What is refused
would take several times more than there is by any solver.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from .continuum.sizes import default_size, finite_size, formed_size
from .errors import InputError
from .experiments.experiment import BYTES
from .forming.fishnet_table import FishnetTable
from .forming.least_energy import BEST, TRIES
from .memory import check_memory, size_text

if TYPE_CHECKING:
    from mpi4py import MPI

    from .case.schema import Case

LONGEST = 1e7  # s; some four months
NEWTON = 4.0  # steps of an increment
FORMING = 4  # times that, of a step of forming: contacts switch, friction settles
# Of a crossover: bytes and seconds of a linear system at small displacements, of a tangent, of one
# in space; of a state that is kept.
_SMALL, _FINITE, _SPACE, _STATE = (11e3, 40e-6), (17e3, 50e-6), (56e3, 170e-6), 250.0
_LAID = (3e3, 20e-6)  # of a crossover of a fishnet
# Of an unknown of a membrane: bytes and seconds, and times that with bending yarns.
_MEMBRANE, _SECOND_GRADIENT = (1.9e3, 10e-6), (3.0, 6.0)
_UNKNOWNS_PER_TRIANGLE = 9.0  # of degree 3


@dataclass
class Part:
    """A part of a case: a network that is solved, or a membrane; on all ranks together.

    ``least``: bytes that it takes at least, however it is solved.
    """

    name: str
    size: str
    cure: str
    bytes: float
    least: float
    seconds: float


def estimate(case: Case) -> list[Part]:
    """Parts of a case, the test first. Nothing is made for it; numbers may be infinite."""
    test, continuum = case.test, case.continuum
    if isinstance(test, FishnetTable):
        return [_fishnet(case, test)]
    if case.stages:
        values = sum(stage.results for stage in case.all_stages)
        steps = FORMING * sum(stage.steps for stage in case.all_stages)
    else:
        values = len(test.values_si)
        steps = max(values, test.increments or 1) if test.finite else 1
    parts = [_network(case, None, steps, values)]
    if not (continuum.compare or continuum.ladder):
        return parts
    preform, fabric = case.preform(), case.fabric()
    if case.stages:
        size = formed_size(preform, fabric)
    elif test.finite:
        size = finite_size(preform.outline, fabric, 3, case.second_gradient)
    else:
        size = default_size(preform.outline, fabric, 3)
    size = continuum.mesh_size_si or size
    with np.errstate(over="ignore", divide="ignore"):
        triangles = float(4.0 * preform.outline.area / np.float64(size) ** 2)
    unknowns = _UNKNOWNS_PER_TRIANGLE * triangles
    more_bytes, more_seconds = _SECOND_GRADIENT if case.second_gradient else (1.0, 1.0)
    solved = values * NEWTON if test.finite else 1.0
    if case.stages:  # linear triangles, half as many nodes; as a network costs in space
        triangles = 0.5 * triangles
        unknowns, solved = 1.5 * triangles, steps * NEWTON
        more_bytes, more_seconds = (_SPACE[i] / (9.0 * _MEMBRANE[i]) for i in (0, 1))
    needed = _MEMBRANE[0] * more_bytes * unknowns
    parts.append(
        Part(
            "the membrane",
            f"about {_count(triangles)} triangles and {_count(unknowns)} unknowns",
            "choose a larger continuum.mesh_size",
            needed,
            0.5 * needed,
            _MEMBRANE[1] * more_seconds * unknowns * solved,
        )
    )
    return parts + [_network(case, refine, steps, values) for refine in continuum.ladder or ()]


def _fishnet(case: Case, test: FishnetTable) -> Part:
    """The net, laid once, and coarse ones before it where the least energy is sought."""
    preform = case.preform()
    with np.errstate(over="ignore", divide="ignore"):
        crossovers = float(np.float64(preform.outline.area) / np.prod(preform.pitch(case.fabric())))
    wanted = test.least_energy
    nets = 0 if wanted is None else 9 * (wanted.places**2 + 1) + BEST * TRIES
    return Part(
        "the fishnet",
        f"about {_count(crossovers)} crossovers",
        "choose a coarser pitch (refine, yarns_per_cruciform)",
        _LAID[0] * crossovers,
        0.5 * _LAID[0] * crossovers,
        _LAID[1] * crossovers + 0.05 * nets,
    )


def _network(case: Case, refine: int | None, steps: int, values: int) -> Part:
    """The test on the case's network, or on one of the ladder."""
    preform, finite = case.preform(refine), case.test.finite
    plies = [(preform, case.fabric())]
    if case.plies and refine is None:
        plies = [(ply.preform, ply.fabric) for ply in case.stack()]
    with np.errstate(over="ignore", divide="ignore"):
        crossovers = sum(
            float(np.float64(cut.outline.area) / np.prod(cut.pitch(cloth))) for cut, cloth in plies
        )
    space = case.test.space
    each, seconds = _SPACE if space else _FINITE if finite else _SMALL
    # Two arm ends; at finite deformation hinges, too; rotations at small displacements.
    unknowns = crossovers * (9 if space else 6 if finite or case.test.bending else 4)
    if getattr(case.test, "slip", None) is not None:
        unknowns += crossovers * (3 if space else 2)
    kept = _STATE * (1 + len(case.tools)) * values * crossovers
    name, cure = "the test", "choose a coarser pitch (refine, yarns_per_cruciform)"
    if refine is not None:
        name, cure = f"refine = {refine} of continuum.ladder", "leave it out"
    elif steps > values and steps > 100:
        cure += " or larger steps" if case.stages else " or fewer increments"
    return Part(
        name,
        f"about {_count(crossovers)} crossovers and {_count(unknowns)} unknowns",
        cure,
        each * crossovers + kept,
        BYTES[case.test.bending] * crossovers + kept,
        seconds * crossovers * (steps * NEWTON if finite else 1.0),
    )


def check_work(comm: MPI.Intracomm, case: Case) -> list[str]:
    """Refuse in a sentence what cannot be done here; else tell what each part takes. Collective.

    Raises InputError on every rank.
    """
    told = []
    for part in estimate(case):
        what = f"{part.name} has {part.size}"
        check_memory(comm, part.least, what, part.cure)
        seconds = part.seconds / comm.size
        if not seconds <= LONGEST:
            raise InputError(
                f"{what}, which would take about {time_text(seconds)} on {comm.size} "
                f"rank{'s' if comm.size > 1 else ''}: {part.cure} or more ranks"
            )
        rank = "" if comm.size == 1 else " on each rank"
        told.append(f"{what}: some {size_text(part.bytes / comm.size)}{rank}, {time_text(seconds)}")
    return told


def _count(number: float) -> str:
    """A number of many, to three digits."""
    return f"{float(f'{number:.3g}'):,.0f}" if number < 1e9 else f"{number:.3g}"


def time_text(seconds: float) -> str:
    """A time for people, to about a tenth."""
    for unit, length in (("years", 3.2e7), ("days", 86400.0), ("h", 3600.0), ("min", 60.0)):
        if seconds >= 1.5 * length:
            return f"{seconds / length:.2g} {unit}"
    return f"{seconds:.2g} s" if seconds >= 1.0 else "less than a second"
