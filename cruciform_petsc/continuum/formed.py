# SPDX-License-Identifier: MIT
"""A forming of a membrane beside that of a network: the same tools, stages, contact, friction."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import partial
from typing import Any

from ..equilibrium.state import State
from ..errors import EquilibriumError
from ..forming.forming import Formed, FormingStep, form
from ..forming.kind import Forming
from ..forming.measures import DrawIn, shear_figures
from .compare import field_differences, ratio
from .sizes import formed_size

NO_BENDING = (
    "A membrane has no bending: where cloth wrinkles, or bends sharply, no agreement is to be "
    "expected, however fine the nets"
)
MM = 1e3


class FormedReference:
    """A forming beside that of a membrane in dolfinx. Collective when made.

    Where the membrane finds no equilibrium, what it has reached is compared.

    Parameters
    ----------
    forming : Forming
    formed : Formed
        What it has come to.
    size : float, optional
        Of the membrane's triangles, m; by default half the network's pitch.
    accepted : callable, optional
        Called with each step of the membrane and its state.

    Attributes
    ----------
    blank : MembraneBlank
    membrane : Formed
    failed : str
        Why it did not come to the end; else empty.
    rows : list of dict
        See `compare`, for each state that both have.
    """

    def __init__(
        self,
        forming: Forming,
        formed: Formed,
        size: float | None = None,
        accepted: Callable[[FormingStep, State], None] | None = None,
    ):
        from .sheet import MembraneBlank

        size = size or formed_size(forming.network.preform, forming.network.fabric)
        self.forming, self.failed = forming, ""
        self.blank = forming.lay(partial(MembraneBlank, size=size))
        try:
            self.membrane = form(
                self.blank, forming.plans, options=forming.options, accepted=accepted
            )
        except EquilibriumError as error:
            self.membrane = error.result
            done = self.membrane.steps[-1].increment.control if self.membrane.steps else 0.0
            stage = forming.stages[min(int(done), len(forming.stages) - 1)]
            share = 100.0 * (done - min(int(done), len(forming.stages) - 1))
            self.failed = (
                f'it has no equilibrium beyond {share:.3g} % of stage "{stage.name}" '
                f"({error}, {error.reason})"
            )
        self._draw_in = DrawIn(self.blank)
        rows = [self.compare(forming, formed, state) for state in formed.states]
        self.rows = [row for row in rows if row is not None]

    def compare(self, forming: Forming, formed: Formed, state: State) -> dict[str, Any] | None:
        """Compare a state of a forming with the membrane's at that time. Collective.

        Returns
        -------
        dict
            Of the network and of the membrane: "tool_force_n" (x, y, z), "draw_in_mm" by edge,
            "shear_max_deg", "shear_p99_deg"; "force_ratio" network / membrane along z by tool;
            "bending_share" of the network's strain energy; and differences of fields at crossovers,
            see field_differences. None where the membrane was not.
        """
        there = next((s for s in self.membrane.states if abs(s.time - state.time) < 1e-9), None)
        if there is None:
            return None
        blank, comm = forming.blank, forming.network.comm
        fields = blank.ply.fields(blank.of_cloth(state))
        u, gamma = self.blank.ply.at(self.blank.of_cloth(there), forming.network.crossover_position)
        c = fields["carrying"]
        energies = _step(formed, state.time).increment.energies
        bent = energies["bending"] + energies["out_of_plane_bending"]
        net = _figures(formed, state.time, DrawIn(blank).largest(state))
        it = _figures(self.membrane, state.time, self._draw_in.largest(there))
        return {
            "time": state.time,
            "bending_share": ratio(bent, bent + energies["tension"] + energies["shear"]),
            "network": net | shear_figures(blank, fields),
            "membrane": it | shear_figures(blank, {"shear_angle": gamma, "carrying": c}),
            "force_ratio": {
                name: ratio(net["tool_force_n"][name][2], force[2])
                for name, force in it["tool_force_n"].items()
            },
            **field_differences(
                comm, fields["displacement"][c], u[c], fields["shear_angle"][c], gamma[c]
            ),
        }

    def summary(self) -> dict[str, Any]:
        """Differences in the last state that both have, and the membrane's figures. Collective."""
        steps, ply = self.membrane.steps, self.blank.ply
        figures: dict[str, Any] = {
            "mesh_size_m": self.blank.size,
            "cells": ply.mesh.topology.index_map(2).size_global,
            "dofs": 3 * self.blank.nodes.num_nodes_global,
            "steps": len(steps),
            "newton_iterations": sum(step.increment.iterations for step in steps),
            "note": NO_BENDING,
        }
        if self.failed:
            figures["failed"] = self.failed
        if self.rows:
            figures |= self.rows[-1]
        return figures

    def table(self) -> dict[str, list]:
        """Columns over the states that both have."""
        columns: dict[str, list] = {"stages_done": [row["time"] for row in self.rows]}
        for which in ("network", "membrane"):
            figures = [row[which] for row in self.rows]
            for tool in self.forming.tools:
                column = f"{tool.name}_force_z_{which}_N"
                columns[column] = [row["tool_force_n"][tool.name][2] for row in figures]
            for edge in self._draw_in.edges:
                column = f"draw_in_{edge}_{which}_mm"
                columns[column] = [row["draw_in_mm"][edge] for row in figures]
            columns[f"shear_max_{which}_deg"] = [row["shear_max_deg"] for row in figures]
        for key in ("relative_l2_displacement", "relative_l2_shear"):
            columns[key] = [row[key] for row in self.rows]
        mean = [row["mean_abs_shear_deg"] for row in self.rows]
        columns["mean_abs_shear_difference_deg"] = mean
        return columns

    def rung(self, forming: Forming) -> dict[str, Any] | None:
        """Form a finer network, compare its last state with the membrane's. Collective.

        None where the membrane was not there. Raises EquilibriumError on every rank.
        """
        formed = forming.solve()
        row = self.compare(forming, formed, formed.states[-1])
        if row is None:
            return None
        drawn = (max(row[of]["draw_in_mm"].values()) for of in ("network", "membrane"))
        forces = {f"{name}_force_ratio": value for name, value in row["force_ratio"].items()}
        return {
            "crossovers": forming.network.num_crossovers_global,
            **forces,
            "draw_in_ratio": ratio(*drawn),
            **{k: row[k] for k in ("relative_l2_displacement", "relative_l2_shear")},
            "mean_abs_shear_deg": row["mean_abs_shear_deg"],
        }


def _step(formed: Formed, time: float) -> FormingStep:
    """The step at whose end a time lies."""
    return min(formed.steps, key=lambda step: abs(step.increment.control - time))


def _figures(formed: Formed, time: float, drawn: Mapping[str, float]) -> dict[str, Any]:
    """Forces at a time, and draw-in by edge."""
    forces = _step(formed, time).tool_force
    return {
        "tool_force_n": {name: force.tolist() for name, force in forces.items()},
        "draw_in_mm": {edge: MM * value for edge, value in drawn.items()},
    }
