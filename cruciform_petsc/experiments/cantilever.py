# SPDX-License-Identifier: MIT
"""Cantilever: a strip along its yarns, clamped at one end, bent in its plane by a load."""

from __future__ import annotations

from typing import ClassVar, Literal

import numpy as np
from pydantic import model_validator

from ..net.edges import Constraints
from ..quantities import LOAD, declare, quantity
from .experiment import DrawnCurves, Experiment, Grip
from .result import TestResult
from .table import Forces, TestTable


class CantileverTable(TestTable):
    """A strip clamped at its lower edge, bent in its plane by a load across its upper one."""

    controls: ClassVar = {"load": "N"}
    along_the_yarns: ClassVar = True
    template: ClassVar = {
        "title": '"Cantilever, 25 mm x 100 mm"',
        "use": '"e-glass-plain-2.4"',
        "shear": '{ modulus = "0.001 N/cm" }',
        "outline": '{ rectangle = ["25 mm", "100 mm"] }',
        "bias_angle": '"0 deg"',
        "test": """
            load = ["0.2 mN", "0.5 mN"]  # Across the upper edge, one value or a list
        """,
    }

    kind: Literal["cantilever"]
    load: Forces
    """Across the upper edge, one value or a list."""

    @model_validator(mode="after")
    def _bends(self) -> CantileverTable:
        if not self.bending:
            raise ValueError('has kind = "cantilever", which needs bending = true')
        return self


declare("tip_across_mm", "deflection across", "deflection of the loaded edge", is_displacement=True)
declare("tip_along_mm", "deflection along")


class Cantilever(Experiment):
    """In-plane bending of a strip: lower edge clamped, a dead load along x on the upper edge."""

    table = CantileverTable
    kind = "cantilever"
    column = LOAD
    clamps = ("lower",)
    movement = "tip deflection"
    captions: ClassVar = {
        "load_against_deflection.png": "Load against the deflection of the loaded edge."
    }

    def grip(self, constraints: Constraints) -> list[Grip]:
        """Clamp the lower edge, put a load of 1 N along x on the upper one. Collective."""
        segments = self.network.preform.edge("upper")
        length = np.hypot(*(segments[:, 1] - segments[:, 0]).T).sum()
        constraints.line_load("upper", (1.0 / length, 0.0))
        self._tip = constraints.nodes_on("upper")
        return [Grip("lower", constraints.clamp("lower"))]

    def motion(self, edge: str, control: float) -> tuple[np.ndarray, np.ndarray]:
        """The clamp stays."""
        return np.eye(2), np.zeros(2)

    def load_factor(self, control: float) -> float:
        """The control is the load."""
        return control

    def load_of(self, work: float, control: float) -> float:
        """The control is the load."""
        return control

    def tip(self, result: TestResult) -> np.ndarray:
        """Mean displacement (x, y) of the loaded edge in each state, m; (n, 2). Collective."""
        comm, owned = self.network.comm, self.network.num_nodes_owned
        nodes = self._tip[self._tip < owned]
        count = comm.allreduce(len(nodes))
        sums = np.array([state.node_displacement[nodes].sum(axis=0) for state in result.states])
        return comm.allreduce(sums) / count

    def extensions(self, result: TestResult) -> np.ndarray:
        """Across the strip."""
        return 1e-3 * result.curve(states=True)["tip_across_mm"]

    def extra_columns(self, result: TestResult) -> dict[str, np.ndarray]:
        """Where the loaded edge has gone."""
        tip = 1e3 * self.tip(result)
        return {"tip_across_mm": tip[:, 0], "tip_along_mm": tip[:, 1]}

    def drawn_curves(self, columns: dict[str, np.ndarray]) -> DrawnCurves:
        """The load against where its edge has gone."""
        lines = {
            "across": (columns["tip_across_mm"], columns["load_N"]),
            "along, towards the clamp": (-columns["tip_along_mm"], columns["load_N"]),
        }
        labels = quantity("tip_across_mm").axis, LOAD.axis
        return "load_against_deflection", labels, lines
