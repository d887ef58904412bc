# SPDX-License-Identifier: MIT
"""Pictures of results for whoever looks at them in Python: into axes, no file; see drawn.py."""

from __future__ import annotations

from collections.abc import Mapping
from functools import partial, singledispatch
from typing import TYPE_CHECKING, Any

import numpy as np

from ..calibration.result import Calibration
from ..errors import InputError, cut, unknown
from ..experiments.registry import forms, in_space
from ..experiments.result import TestResult
from ..forming.forming import Formed
from ..net.network import Network
from ..quantities import quantity
from . import calibration, figures, formed, pictures, scene
from .exports import crossover_columns
from .sample import sample_map
from .saved import Result

if TYPE_CHECKING:
    from matplotlib.figure import Figure
    from mpi4py import MPI

    from .pictures import Given

NO_MAPS = ("x_rest_mm", "y_rest_mm", "x_mm", "y_mm", "crossover", "carrying", "node")


@singledispatch
def plot(result: Any, ax: Given, what: str, title: str, label: str = "") -> Any:
    """See Plotted.plot."""
    raise TypeError(f"there is no curve of {result!r}")


@plot.register(TestResult)
def _(result: TestResult, ax: Given, what: str, title: str, label: str) -> Any:
    text = pictures.plain_text(title)
    curves = figures.curves_of(result.experiment, result.curve(), text)
    if what and f"{what}.png" not in curves:
        curves = figures.figures(result, text)[0]
    return _chosen(result.network.comm, curves, what, ax, label)


@plot.register(Formed)
def _(result: Formed, ax: Given, what: str, title: str, label: str) -> Any:
    forming, text = result.of, pictures.plain_text(title)
    table = formed.table_of(forming, result.steps)
    curves = formed.curves_of(table, [stage.name for stage in forming.stages], text)
    if what and f"{what}.png" not in curves:
        curves = formed.figures_of(forming, result, table, text)
    return _chosen(forming.network.comm, curves, what, ax, label)


@plot.register(Result)
def _(result: Result, ax: Given, what: str, title: str, label: str) -> Any:
    curve, network, text = result.curve(), result.network, pictures.plain_text(title)
    if forms(result.kind):
        curves = formed.curves_of(curve, [stage.name for stage in result.case.stages], text)
    elif in_space(result.kind):
        raise InputError("a fishnet has no curve: its pictures are in its folder")
    else:
        curves = figures.curves_of(result.case.experiment(network), curve, text)
    return _chosen(network.comm, curves, what, ax, label)


@plot.register(Calibration)
def _(result: Calibration, ax: Given, what: str, title: str, label: str) -> Any:
    comm = result.specimens[0].network.comm
    room = len(calibration.PARTS) if ax is None else np.size(np.array(ax, dtype=object))
    parts = [what] if what else list(calibration.PARTS[:room])
    if what and what not in calibration.PARTS:
        raise unknown(f'picture "{cut(what)}"', what, calibration.PARTS)
    return pictures.draw(comm, partial(calibration.figure, result, title, parts), ax)


def _chosen(
    comm: MPI.Intracomm,
    drawn: Mapping[str, partial[Figure]],
    what: str,
    ax: Given,
    label: str,
) -> Any:
    """Draw the picture of a name, by default the first.

    A ``label`` is that of its line, or stands before those of several; closed forms are left out.
    """
    names = [name.removesuffix(".png") for name in drawn]
    if what and what not in names:
        raise unknown(f'picture "{cut(what)}"', what, names)
    make = drawn[f"{what or names[0]}.png"]
    if label and make.func is pictures.curves:
        lines, *further = make.args
        lines = {name: line for name, line in lines.items() if name != figures.CLOSED_FORM}
        text = pictures.plain_text(label)
        several = len(lines) > 1
        lines = {f"{text}: {name}" if several else text: line for name, line in lines.items()}
        make = partial(make.func, lines, *further, **make.keywords)
    return pictures.draw(comm, make, ax)


# -- maps and scenes -------------------------------------------------------------------------------


@singledispatch
def _at_crossovers(result: Any, index: int) -> tuple[Network, dict[str, np.ndarray], str]:
    """The network, columns at its crossovers, and when that is. Collective."""
    raise TypeError(f"there is no map of {result!r}")


@_at_crossovers.register(TestResult)
def _(result: TestResult, index: int) -> tuple[Network, dict[str, np.ndarray], str]:
    state = _state(result.states, index)
    return result.network, crossover_columns(result, state), figures.when(result, state)


@_at_crossovers.register(Formed)
def _(result: Formed, index: int) -> tuple[Network, dict[str, np.ndarray], str]:
    state = _state(result.states, index)
    columns = formed.crossover_columns(result.of, state)
    return result.of.network, columns, formed.when(result.of, state)


@_at_crossovers.register(Result)
def _(result: Result, index: int) -> tuple[Network, dict[str, np.ndarray], str]:
    if index != -1:
        raise InputError(f"of a run that was read again there is the last state, -1, got {index}")
    saved, network = result.last_state(), result.network
    number = saved["crossover"].astype(np.int64)
    rows = np.full(network.num_crossovers_global, -1)
    rows[number[number >= 0]] = np.flatnonzero(number >= 0)
    own = rows[network.crossover_number_global]
    return network, {name: values[own] for name, values in saved.items()}, "the end"


def map_of(result: Any, what: str, ax: Given, state: int, title: str | None) -> Any:
    """See Mapped.map."""
    network, columns, when = _at_crossovers(result, state)
    carrying = columns.get("carrying", np.ones(network.num_crossovers_owned)) > 0
    known = {
        name: np.where(carrying, values, np.nan)
        for name, values in columns.items()
        if values.ndim == 1 and not (name in NO_MAPS or name.endswith(("_x", "_y", "_z")))
    }
    begun = [name for name in known if name.startswith(f"{what}_")]
    found = [what] if what in known else begun
    if len(begun) > 1 and what not in known:
        raise InputError(f'map "{cut(what)}" may be any of {", ".join(begun)}: give a whole name')
    within = [name for name in known if what and what in name]
    if not found and within:
        raise InputError(f'there is no map "{cut(what)}", did you mean {" or ".join(within)}?')
    if len(found) != 1:
        raise unknown(f'map "{cut(what)}"', what, known)
    column = quantity(found[0])
    sample: Any = sample_map(network, {"": known[column.column]})
    told = f"{column.label} at {when}, on the cloth at rest" if title is None else title
    label = column.axis if column.unit else column.label
    return pictures.draw(
        network.comm, lambda **given: pictures.maps(sample, label, told, **given), ax
    )


@singledispatch
def scene_of(result: Any, ax: Given, state: int, title: str | None) -> Any:
    """See InSpace.scene."""
    raise TypeError(f"there is no scene of {result!r}")


@scene_of.register(TestResult)
def _(result: TestResult, ax: Given, state: int, title: str | None) -> Any:
    return figures.scene(result, None, title or "", ax=ax, state=_state(result.states, state))


@scene_of.register(Formed)
def _(result: Formed, ax: Given, state: int, title: str | None) -> Any:
    frame = formed.frame_of(result.of, _state(result.states, state))
    frame.caption = frame.caption if title is None else pictures.plain_text(title)
    return pictures.draw(result.of.network.comm, lambda **given: scene.formed([frame], **given), ax)


def _state(states: list, index: int) -> Any:
    if not -len(states) <= index < len(states):
        raise InputError(f"there are {len(states)} states, index {index} is not one of them")
    return states[index]
