# SPDX-License-Identifier: MIT
"""The results of a run, read again from their folder."""

from __future__ import annotations

import os
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any, Self

import numpy as np

from ..case.schema import Case
from ..drawn import Mapped, Plotted, Shown
from ..errors import InputError
from ..experiments.registry import forms, in_space
from ..net.network import Network
from ..quantities import data_frame
from ..reading import read_json
from .folder import OF_RUN
from .tables import read_csv


@dataclass(frozen=True)
class Result(Shown, Plotted, Mapped):
    """What a run has left in its folder, of whatever kind of test; made by `load`.

    >>> result = Result.load("results/picture_frame")  # doctest: +SKIP
    >>> result.curve()["load_N"][-1], result.summary["shear_max_deg"]  # doctest: +SKIP

    Attributes
    ----------
    folder : Path
    summary : dict
        summary.json.
    """

    folder: Path
    summary: dict[str, Any] = field(repr=False)

    @classmethod
    def load(cls, folder: str | Path) -> Self:
        """Read a folder of results; not collective.

        Raises
        ------
        InputError
            There is none, or no run has come to its end there.
        """
        folder = Path(folder)
        summary = read_json(folder / OF_RUN[0], follow=True)
        if "kind" not in summary:
            problem = f"has no {OF_RUN[0]}, so no run has come to its end there"
            if not os.path.isdir(folder):
                problem = "is no folder, name one of results"
            raise InputError(f'"{folder}" {problem}')
        return cls(folder, summary)

    @property
    def kind(self) -> str:
        """Of the test: "bias-extension", "forming" ..."""
        return str(self.summary["kind"])

    @property
    def ended_early(self) -> str:
        """Why the run did not come to its end, in a sentence; empty if it did."""
        return str(self.summary.get("ended_early", ""))

    @cached_property
    def case(self) -> Case:
        """The case that was run, with what --set said."""
        return Case.from_data(self.summary.get("case", {}))

    @cached_property
    def network(self) -> Network:
        """The network of the case, made again on this rank alone."""
        from mpi4py import MPI

        return Network(MPI.COMM_SELF, self.case.preform(), self.case.fabric())

    def curve(self, states: bool = False) -> dict[str, np.ndarray]:
        """Columns of curve.csv, of a forming forces.csv: units in their names, float or text (n,).

        Rows are all accepted increments; with ``states`` those that were asked for.
        """
        columns = read_csv(self.folder / ("forces.csv" if forms(self.kind) else "curve.csv"))
        rows = columns["asked"] > 0 if states and "asked" in columns else slice(None)
        return {name: column[rows] for name, column in columns.items()}

    def frame(self, states: bool = False) -> Any:
        """The same as a pandas.DataFrame; InputError where pandas is not installed."""
        return data_frame(self.curve(states))

    def last_state(self) -> dict[str, np.ndarray]:
        """Arrays of the last state, names and units as in docs/files.md.

        Of a forming, and a fishnet, the columns of fields.csv; else the points of network.vtkhdf,
        crossovers and then arm ends: ``points_m`` (n, 3) at rest, and all that is told of points.
        InputError if the case did not ask for that file (output.paraview).
        """
        if in_space(self.kind):
            return read_csv(self.folder / "fields.csv")
        import h5py

        path = self.folder / "network.vtkhdf"
        try:
            with h5py.File(path) as file:
                root = file["VTKHDF"]
                arrays = {name: array[()] for name, array in root["PointData"].items()}
                return {"points_m": root["Points"][()]} | arrays
        except (OSError, KeyError):
            raise InputError(
                f'"{path}" cannot be read, the last state is kept where output.paraview = true'
            ) from None
