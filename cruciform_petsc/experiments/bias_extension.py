# SPDX-License-Identifier: MIT
"""Bias extension: a strip clamped at its lower edge, pulled at its upper one (paper, section 6)."""

from __future__ import annotations

from typing import Any, ClassVar, Literal

import numpy as np
from pydantic import model_validator

from ..errors import InputError
from ..net.edges import Constraints
from ..net.network import Network
from ..quantities import si_text
from ..small.network import LinearNetwork
from ..small.separate import solve_separately
from .closed_form import CAPTION, beside_closed_form
from .experiment import PULL, Experiment, Grip
from .net_kinematics import net_angle, net_load, net_reach, net_torque
from .result import State, TestResult
from .table import PullTable, TestTable, small_unless_told


class BiasExtensionTable(PullTable):
    """A strip clamped at its lower edge and pulled at its upper one."""

    template: ClassVar = {
        "title": '"Bias extension, 100 mm x 200 mm"',
        "test": """
            # or "centre-line": What the upper edge is: a clamp, or the middle of a whole specimen
            upper = "grip"
            extension = ["10 mm", "20 mm"]  # By which the upper edge is pulled, one value or a list
            # load = "0.5 N"  # Force on the upper edge, one value or a list
        """,
    }

    kind: Literal["bias-extension"] = "bias-extension"
    upper: Literal["grip", "centre-line"] = "grip"
    """What the upper edge is: a clamp, or the middle of a whole specimen."""
    model: Literal["coupled", "truss", "separate"] = "coupled"  # type: ignore[assignment]
    """Cruciforms, all modes of deformation in one system, or with "separate" the paper's three, for
    small displacements; or a truss of pin-jointed bars along the yarns with soft diagonals, at
    finite deformation (docs/models.md)."""

    @model_validator(mode="before")
    @classmethod
    def _asks_for_small(cls, data: Any) -> Any:
        return small_unless_told(data) if data.get("model") == "separate" else data

    @model_validator(mode="after")
    def _small(self) -> BiasExtensionTable:
        if self.finite and self.model == "separate":
            raise ValueError(
                'has model = "separate" and finite = true, but the separate systems are for small '
                "displacements only"
            )
        return self


class BiasExtension(Experiment):
    """Bias-extension test of a network, y being the direction of pull.

    Parameters
    ----------
    network, extension, load, **keys
        See Experiment: a displacement of the upper edge, or a force on it, and further keys.
    upper : "grip" or "centre-line"
        Gripped like the lower edge; or the paper's half specimen, whose upper edge is the middle of
        the whole one: it moves as one along the pull and is free across it.
    model : "coupled", "truss" or "separate"
        All modes of deformation in one system; a truss in place of the cruciforms (items.truss); or
        the paper's three systems, one after the other (see small.separate; small displacements
        only).
    """

    table: ClassVar[type[TestTable]] = BiasExtensionTable
    kind = "bias-extension"
    has_zones = True
    cut_across = True
    reference = "gripped"
    captions: ClassVar = {"shear_force.png": CAPTION}
    shear_angles: ClassVar = {
        "over the angle of an inextensible net": "shear_net_deg",
        "over the computed angle of the middle zone": "shear_middle_deg",
    }
    upper = "grip"

    def __init__(self, network: Network, extension: Any = None, load: Any = None, **keys: Any):
        super().__init__(network, extension, load=load, **keys)
        self.clamps = ("lower", "upper") if self.upper == "grip" else ("lower",)

    def grip(self, constraints: Constraints) -> list[Grip]:
        """Clamp the lower edge; clamp or guide the upper one. Collective."""
        grips = [Grip(edge, constraints.clamp(edge)) for edge in self.clamps]
        if self.upper != "grip":
            grips.append(Grip("upper", constraints.guide("upper", PULL, 0.0, in_plane=False)))
        return grips

    def motion(self, edge: str, control: float) -> tuple[np.ndarray, np.ndarray]:
        """The upper edge moves along y."""
        return np.eye(2), control * PULL if edge == "upper" else np.zeros(2)

    def default_step(self) -> float:
        """A fiftieth of the length: some three degrees of shear."""
        return 0.02 * float(self.size[1])

    def check(self) -> list[str]:
        """See Experiment.check; and how far the net reaches. Collective."""
        told = super().check()
        gauge = self.net_gauge()
        if gauge is not None:
            told.append(
                "yarns that do not stretch lie along the pull at an extension of "
                f"{si_text(net_reach(gauge), 'm')}: beyond, they carry the load"
            )
        return told

    def net_gauge(self) -> float | None:
        """H - W of what `net_sides` holds for; else None."""
        sides = self.net_sides()
        return None if sides is None else sides[1] - sides[0]

    def net_sides(self) -> tuple[float, float] | None:
        """W, H of a rectangle cut at 45 degrees, H >= 2 W, with grips at both ends; else None."""
        preform = self.network.preform
        sides = preform.sides() if len(self.clamps) == 2 else None
        if sides is None or abs(np.cos(2.0 * preform.bias_angle)) >= 1e-9:
            return None
        width, length = sides
        return (width, length) if length >= 2.0 * width * (1 - 1e-9) else None

    def curve_columns(self, curve: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
        """Angle and load of an inextensible net of this cloth, and the normalised shear force.

        Cao et al. 2008, Composites A 39:1037, eqs. 12-18 (see net_kinematics); where they hold.
        """
        sides = self.net_sides()
        if sides is None:
            return {}
        angle = net_angle(1e-3 * curve["extension_mm"], sides[1] - sides[0])
        law = self.network.fabric.shear
        with np.errstate(divide="ignore", invalid="ignore"):  # yarns along the pull
            force = net_torque(angle, curve["load_N"], *sides) / np.cos(angle)
            load = net_load(angle, lambda g: law.evaluate(g)[1], *sides)
        elastic = {} if self.network.fabric.remembers else {"load_net_N": load}
        return {
            "shear_net_deg": np.rad2deg(angle),
            **elastic,
            "shear_force_N_per_mm": 1e-3 * force,
        }

    def figures(self, result: TestResult) -> dict[str, Any]:
        """What the closed form says of the last state, and why it differs. Collective."""
        return beside_closed_form(result)

    def _solve_small(self) -> TestResult:
        if self.model == "coupled":
            return super()._solve_small()
        network, load = self.network, 1.0
        constraints = Constraints(network, self.bending)
        constraints.clamp("lower")
        constraints.tie("upper", PULL, gripped=self.upper == "grip")
        linear = LinearNetwork(constraints)
        modes = solve_separately(linear, load, self.options)
        total = None
        moved = np.zeros((network.num_nodes_local, 2))
        for mode, solution in modes.items():
            fields = linear.crossover_fields(solution.displacement, mode)
            moved = moved + linear.node_displacement(solution.displacement, fields)
            if total is None:
                total = fields
                continue
            # Each mode's own measure from its own system; displacements add up.
            total["displacement"] = total["displacement"] + fields["displacement"]
            own = ("shear_angle", "arm_rotation") if mode == "shear" else ()
            total |= {name: fields[name] for name in (f"{mode}_energy", *own)}
        extension = sum(solution.tied_displacement for solution in modes.values())
        if extension == 0.0:
            raise InputError("no mode by itself lets the upper edge move; use model = 'coupled'")
        state = State(extension, load, total, moved)
        result = self.in_proportion(state, linear, modes["shear"].solver)
        result.uncarried = {mode: solution.uncarried for mode, solution in modes.items()}
        return result
