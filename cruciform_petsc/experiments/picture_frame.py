# SPDX-License-Identifier: MIT
"""Picture frame: cloth in a frame of four hinged sides along its yarns, pulled at two corners."""

from __future__ import annotations

from dataclasses import replace
from typing import Annotated, Any, ClassVar, Literal

import numpy as np

from ..fields import Of, Quantities
from ..net.edges import Constraints
from ..quantities import declare
from .closed_form import CAPTION, beside_closed_form
from .experiment import Experiment, Grip
from .result import TestResult
from .table import TensionedTable

SMALL = 1e-5  # rad
EDGES = ("lower", "upper", "left", "right")
declare("crosshead_mm", "crosshead", "displacement of the crosshead", is_displacement=True)


def _can_close(angle: float) -> bool:
    return abs(angle) < 0.5 * np.pi


Angles = Annotated[
    Quantities,
    Of("rad", many=True, example="20 deg", good=_can_close, wanted="between -90 deg and 90 deg"),
]


class PictureFrameTable(TensionedTable):
    """A rectangle sheared by a hinged frame."""

    controls: ClassVar = {"angle": "rad"}
    along_the_yarns: ClassVar = True
    template: ClassVar = {
        "title": '"Picture frame, 100 mm"',
        "outline": '{ rectangle = ["100 mm", "100 mm"] }',
        "bias_angle": '"0 deg"',
        "test": """
            angle = ["10 deg", "20 deg"]  # Shear angle of the frame, one value or a list
            # pretension = "10 N/cm"  # Of both yarns in the frame before it shears, or of each
        """,
    }

    kind: Literal["picture-frame"]
    angle: Angles
    """Shear angle of the frame, one value or a list. Between -90 and 90 deg."""


class PictureFrame(Experiment):
    """Picture-frame test: the outline is a rectangle along the yarns, its corners the hinges.

    With ``pretension`` the yarns are under tension before it shears, as Launay et al. 2008 have it
    (Compos. Sci. Technol. 68:506).

    The frame turns the yarns it holds with its sides, so that the cloth shears uniformly as far as
    the clamps are concerned. Its shear angle is 90 degrees less the angle between its sides,
    positive where warp and weft close.
    """

    table = PictureFrameTable
    kind = "picture-frame"
    column = declare("angle_deg", "angle of the frame", "shear angle of the frame", "angle")
    captions: ClassVar = {
        "load_against_angle.png": "Load against the shear angle of the frame.",
        "load_against_crosshead.png": "Load against the displacement of the crosshead.",
        "shear_force.png": CAPTION,
    }
    shear_angles: ClassVar = {"over the angle of the frame": "angle_deg"}
    clamps = EDGES

    def grip(self, constraints: Constraints) -> list[Grip]:
        """Clamp all four sides. Collective."""
        return [Grip(edge, constraints.clamp(edge)) for edge in EDGES]

    def motion(self, edge: str, control: float) -> tuple[np.ndarray, np.ndarray]:
        """All sides follow one shear about the middle of the frame, without stretch along them."""
        c, s = np.cos(0.5 * control), np.sin(0.5 * control)
        along_yarns, to_lab = np.array([[c, s], [s, c]]), self.network.to_lab
        gradient = to_lab(to_lab(along_yarns).T)  # symmetric, as it is along the yarns
        return gradient, self.middle - gradient @ self.middle

    def default_step(self) -> float:
        """Ten degrees."""
        return np.pi / 18.0

    def _solve_small(self) -> TestResult:
        """Small displacements in proportion to a frame closed by a hundred-thousandth of a radian.

        The clamps turn the yarns that they hold, which only the finite network can express.
        """
        small = PictureFrame(
            self.network, SMALL, finite=True, bending=self.bending, options=self.options
        )
        result = small.solve()
        states = [result.states[0].scaled(angle / SMALL) for angle in self.values]
        return replace(result, experiment=self, states=states, increments=[], state_after=None)

    def diagonal(self, control: Any) -> Any:
        """Length of the frame's longer diagonal, between the pulled corners, m; as `control`."""
        a, b = self.size
        return np.sqrt(a * a + b * b + 2.0 * a * b * np.sin(np.abs(control)))

    def load_of(self, work: float, control: float) -> float:
        """Cross-head force: work per angle over diagonal per angle (2 L cos theta if square)."""
        a, b = self.size
        return float(work * self.diagonal(control) / (a * b * np.cos(control)))

    def travel(self, control: Any) -> Any:
        """Of the cross-head; for angles below zero of the other two corners, and below zero."""
        return np.sign(control) * (self.diagonal(control) - self.diagonal(0.0))

    def extensions(self, result: TestResult) -> np.ndarray:
        """Of the cross-head."""
        return 1e-3 * result.curve(states=True)["crosshead_mm"]

    def extra_columns(self, result: TestResult) -> dict[str, np.ndarray]:
        """Cross-head displacement, and the shear force per length of the usual evaluation."""
        rest = diagonal = self.diagonal(0.0)
        moved = result.controls * np.prod(self.size) / rest
        if self.finite:
            diagonal = self.diagonal(result.controls)
            moved = diagonal - rest
        # F/(2 L cos theta) of a square frame of side L, whose diagonal is 2 L cos(theta).
        force = result.loads / diagonal
        columns = {"crosshead_mm": 1e3 * moved, "shear_force_N_per_mm": 1e-3 * force}
        # Uniform shear: psi' = F cos(gamma)/diagonal, see calibration.formula.
        if self.finite and not self.network.fabric.remembers:
            torque = self.network.fabric.shear.evaluate(result.controls)[1]
            torque = torque / np.prod(self.prestretch)  # of the cloth that is in the frame
            columns["load_net_N"] = torque * diagonal / np.cos(result.controls)
            if getattr(self.test, "pretension", None) is not None:
                columns |= self._tensions(result, torque)
        return columns

    def _tensions(self, result: TestResult, torque: np.ndarray) -> dict[str, np.ndarray]:
        """Tension of the yarns at the frame's sides, and that of cloth sheared alike all over.

        What a side of length L pulls is n L along the yarns that it holds and psi'/cos(g) L along
        itself, in these two directions; with the yarns' lengths as they are, cloth that resists
        shear takes psi' tan(g) off the tension n that there was: they slacken beyond.
        """
        columns, net = {}, self.network
        turned = int(abs(net.preform.rotation[0, 1]) < 0.5)  # the warp runs along x
        for family, name in enumerate(("warp", "weft")):
            along = (family + turned + 1) % 2  # axis of its yarns
            low, high = (("left", "right"), ("lower", "upper"))[along]
            tension = []
            for state in result.states:
                gradient = self.motion(high, state.control)[0]
                axes = gradient / np.linalg.norm(gradient, axis=0)
                parts = [
                    np.linalg.solve(axes, sign * state.forces[edge][:2])[along]
                    for edge, sign in ((low, -1.0), (high, 1.0))
                ]
                tension.append(0.5 * sum(parts) / self.size[1 - along])
            columns[f"tension_{name}_N_per_cm"] = 0.01 * np.array(tension)
            start = net.fabric.tensions(self.prestretch)[family]
            closed = start - torque * np.tan(result.controls)
            columns[f"tension_{name}_net_N_per_cm"] = 0.01 * closed
        return columns

    def figures(self, result: TestResult) -> dict[str, Any]:
        """What the closed form says of the last state, and why it differs. Collective."""
        return beside_closed_form(result)
