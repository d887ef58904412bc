# SPDX-License-Identifier: MIT
"""What objects show of themselves: a table in a notebook, and pictures drawn into axes.

How they do it is known to the right of them, in output/, and loaded by name when it is first asked
for (as pandas loads its plotting): who computes without looking loads neither matplotlib nor a
page. Nothing here writes files.
"""

from __future__ import annotations

from importlib import import_module
from typing import Any


def _from_output(module: str, name: str) -> Any:
    return getattr(import_module(f".output.{module}", __package__), name)


class Shown:
    """What a notebook shows as a small table."""

    def _repr_html_(self) -> str:
        """Names, values, units; legible on light and on dark. Collective for results."""
        return _from_output("html", "html_of")(self)


class Plotted:
    """What has curves."""

    def plot(self, ax: Any = None, what: str = "", *, title: str = "", label: str = "") -> Any:
        """Draw the curve, or another picture, into axes. Collective.

        Parameters
        ----------
        ax : matplotlib Axes, or as many of them as the picture has panels
            By default those of a new figure of pyplot's, which notebooks show.
        what : str
            Which picture, by the name of its file: "energy", "zones", "tool_forces" ...; by default
            the first, of a test the load, of a forming the tools' forces. Any other word is an
            InputError that lists them.
        title : str
            Taken literally.
        label : str
            In the legend, where several results are drawn into the same axes; the closed form
            beside a load is left out then.

        Returns
        -------
        Axes or array of Axes
            On rank 0; None on other ranks, which draw nothing.
        """
        return _from_output("draw", "plot")(self, ax, what, title, label)


class Mapped:
    """What has values at crossovers."""

    def map(
        self, what: str = "shear", ax: Any = None, *, state: int = -1, title: str | None = None
    ) -> Any:
        """Draw values at the crossovers, on the cloth at rest, into axes. Collective.

        Parameters
        ----------
        what : str
            A column of `crossovers.csv`, of a forming of `fields.csv` (docs/files.md), or how its
            name begins: "shear", "warp_tension", "thickness", "wrinkle_height" ... Of results that
            were read again, what ``last_state()`` has. Any other word is an InputError that lists
            them.
        ax : matplotlib Axes, optional
            See `plot`.
        state : int
            Which of the states; of results that were read again there is the last alone.
        title : str, optional
            Taken literally; by default what the map shows, and when.

        Returns
        -------
        Axes
            On rank 0; None on other ranks.
        """
        return _from_output("draw", "map_of")(self, what, ax, state, title)


class InSpace:
    """What can be seen in space."""

    def scene(self, ax: Any = None, *, state: int = -1, title: str | None = None) -> Any:
        """Draw the woven yarns, or the formed blank among its tools, into axes. Collective.

        In the colours of the shear angle; see `map` for what is taken and returned. InputError on
        every rank if nothing here can draw in space.
        """
        return _from_output("draw", "scene_of")(self, ax, state, title)
