# SPDX-License-Identifier: MIT
"""Why a forming cannot go on: which tools, at which nodes, what may help."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ..errors import EquilibriumError, typed_before
from ..parallel import least
from ..quantities import length
from .blank import Blank
from .forming import Formed
from .measures import narrowest
from .table import StageTable

BACK = 2  # steps before the last one: where smaller steps are proposed to begin
NEAR = 2.0  # pitches: around the node where forces are farthest from balance
CURES = {
    "PIERCED": "smaller steps (step), more room between tools, or a finer net may help",
    "APART": "fewer processes, of which each knows more of the plies, or one, will do",
    "CLOSED": "they have to stop earlier, or the cloth has to be thinner",
}


def explain(
    blank: Blank,
    stages: Sequence[StageTable],
    error: EquilibriumError,
    is_kept: bool,
    kind: str = "forming",
    laying: int = 0,
) -> None:
    """Say in the error how far it came, which tools press where it stopped, and why. Collective.

    Where there ``is_kept`` a checkpoint also how to go on with smaller steps, if they may help:
    those of a stage, of other kinds than forming of all. The first ``laying`` stages are the
    program's own.
    """
    formed: Formed = error.result
    done = formed.steps[-1].increment.control if formed.steps else 0.0
    number = min(int(done), len(stages) - 1)
    where, cure = "", CURES.get(error.reason, "")
    if error.place is not None:
        x, y = (length(value) for value in error.place[:2])
        nodes = "1 node" if error.count == 1 else f"{error.count} nodes"
        where = f" at {nodes} of the flat blank, {'' if error.count == 1 else 'most '}at "
        where += f"x = {x}, y = {y}"
        if error.reason not in CURES:
            where = f"; forces are out of balance{where}{_pressing(blank, formed, error.place)}"
    if not cure and stages[number].remove:
        cure = "tools that still bear should travel away in a stage before they are removed"
    cure = cure or (
        "smaller steps (step), a softer contact or more viscosity (test.contact) may help; so does "
        "more room between tools that close on the cloth"
    )
    going_on = ""
    if is_kept and error.reason != "CLOSED" and number >= laying:
        count = len(formed.steps)
        back = f" --from-step {max(count - BACK, 1)}" if count else ""
        key = f"stage[{number - laying}].step" if kind == "forming" else "test.step"
        step = f"{key}={0.5 * stages[number].largest_step:.3g}"
        going_on = f'. Go on with {typed_before()}cruciform-petsc resume CASE{back} --set "{step}"'
        going_on += " (and --output, where the run had it)"
    error.args = (
        f"{kind}: no equilibrium beyond {100 * (done - number):.3g} % of stage "
        f'"{stages[number].name}" ({error}, {error.reason}){where}. '
        f"{cure[0].upper()}{cure[1:]}{going_on}",
    )


def _pressing(blank: Blank, formed: Formed, place: np.ndarray) -> str:
    """Which tools press on the cloth near a place, and what room they leave. Collective."""
    if not formed.states:
        return ""
    state, rest = formed.states[-1], blank.ply.nodes.rest[blank.touching]
    away = np.linalg.norm(rest[:, :2] - place[:2], axis=1)  # at rest, which is flat
    near = away < NEAR * blank.network.pitch.max()
    names = [
        contact.name
        for contact in blank.contacts
        if least(blank.comm, -contact.fields(state)["pressure"][near], 0.0) < 0.0
    ]
    if not names:
        return ", where no tool presses"
    quoted = " and ".join(f'"{name}"' for name in names)
    told = f", where tool{'s' if len(names) > 1 else ''} {quoted} press{'es' * (len(names) == 1)}"
    between = narrowest(blank, state, near)
    if between is not None and between[0] < blank.thickness:
        one, other = between[1]
        told += (
            f': "{one}" and "{other}" leave {length(max(between[0], 0.0))}, for cloth of '
            f"{length(blank.thickness)}"
        )
    return told
