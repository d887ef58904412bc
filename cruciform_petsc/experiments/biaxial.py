# SPDX-License-Identifier: MIT
"""Biaxial tension along the yarns, at a ratio of strains."""

from __future__ import annotations

from typing import Annotated, Any, ClassVar, Literal

import numpy as np
from pydantic import model_validator

from ..fields import Number, Of, Quantities
from ..net.edges import Constraints
from ..net.network import Network
from ..quantities import declare
from ..units import LIMITS, format_si
from .experiment import DrawnCurves, Experiment, Grip
from .result import TestResult
from .table import TensionedTable


def _leaves_cloth(strain: float) -> bool:
    return -1.0 < strain <= LIMITS["1"][1]


Strains = Annotated[Quantities, Of("1", many=True, good=_leaves_cloth, wanted="more than -100 %")]


class BiaxialTable(TensionedTable):
    """A rectangle stretched along both yarns."""

    controls: ClassVar = {"strain": "1"}
    along_the_yarns: ClassVar = True
    template: ClassVar = {
        "title": '"Biaxial tension, 2 : 1"',
        "outline": '{ rectangle = ["100 mm", "100 mm"] }',
        "bias_angle": '"0 deg"',
        "test": """
            strain = ["0.25 %", "0.5 %"]  # Of the warp, one value or a list
            ratio = 0.5  # Weft strain over warp strain
            # pretension = "10 N/cm"  # Of both yarns before it, or of each
        """,
    }

    kind: Literal["biaxial"]
    strain: Strains
    """Of the warp, one value or a list. More than -100 %."""
    ratio: Number = 1.0
    """Weft strain over warp strain."""

    @model_validator(mode="after")
    def _both_lengths_positive(self) -> BiaxialTable:
        for strain in (self.ratio * warp for warp in self.values_si):
            if not _leaves_cloth(strain):
                raise ValueError(
                    "prescribes a weft strain (strain times ratio) of "
                    f"{format_si(strain, '1')}, it must be more than -100 % and at most "
                    f"{format_si(LIMITS['1'][1], '1')}"
                )
        return self


declare("strain_weft_percent", "weft strain")
declare("force_warp_N", "warp force")
declare("force_weft_N", "weft force")


class Biaxial(Experiment):
    """A rectangle along the yarns, stretched in both directions; its edges slide along themselves.

    Arguments: see Experiment and `BiaxialTable`; strains are engineering ones, "1 %" or 0.01.
    """

    table = BiaxialTable
    kind = "biaxial"
    ratio: float
    column = declare("strain_warp_percent", "warp strain")
    clamps = ("lower", "upper", "left", "right")
    forces = ("force_warp_N", "force_weft_N")
    captions: ClassVar = {"tension_against_strain.png": "Tension of the cloth against its strain."}
    colour = "tension"

    def __init__(self, network: Network, strain: Any, **keys: Any):
        super().__init__(network, strain, **keys)
        # Warp along y for a bias angle of 0.
        self._warp_axis = int(abs(network.preform.rotation[0, 1]) > 0.5)

    def grip(self, constraints: Constraints) -> list[Grip]:
        """Guide all four edges across themselves; corners are then held. Collective."""
        across = dict(zip(self.clamps, ((0, 1), (0, 1), (1, 0), (1, 0)), strict=True))
        return [Grip(edge, constraints.guide(edge, d, 0.0)) for edge, d in across.items()]

    def motion(self, edge: str, control: float) -> tuple[np.ndarray, np.ndarray]:
        """Stretch about the middle."""
        stretch = np.full(2, 1.0 + control * self.ratio)
        stretch[self._warp_axis] = 1.0 + control
        return np.diag(stretch), self.middle - stretch * self.middle

    def _along(self, result: TestResult, axis: int) -> np.ndarray:
        """Mean force on the two edges across an axis, N; (n,)."""
        low, high = (("left", "right"), ("lower", "upper"))[axis]
        forces = [0.5 * (s.forces[high][axis] - s.forces[low][axis]) for s in result.states]
        return np.array(forces)

    def extra_columns(self, result: TestResult) -> dict[str, np.ndarray]:
        """Strain along the weft, and force and tension (per width at rest) of both families."""
        warp, weft = self._warp_axis, 1 - self._warp_axis
        along_warp, along_weft = self._along(result, warp), self._along(result, weft)
        return {
            "strain_weft_percent": 100.0 * result.controls * self.ratio,
            "force_warp_N": along_warp,
            "force_weft_N": along_weft,
            "tension_warp_N_per_cm": along_warp / self.size[weft] / 100.0,
            "tension_weft_N_per_cm": along_weft / self.size[warp] / 100.0,
        }

    def travel(self, control: Any) -> Any:
        """Along the warp."""
        return control * self.size[self._warp_axis]

    def extensions(self, result: TestResult) -> np.ndarray:
        """Along the warp."""
        return self.travel(result.controls)

    def load_of(self, work: float, control: float) -> float:
        """Force that does the work of both directions on the warp's own extension, N."""
        return work / float(self.size[self._warp_axis])

    def drawn_curves(self, columns: dict[str, np.ndarray]) -> DrawnCurves:
        """Tension of both families."""
        names = {"warp": "warp", "weft": f"weft, strain {self.ratio:.3g} of the warp's"}
        start = 1e-2 * self.network.fabric.tensions(self.prestretch)  # N/cm
        strain = np.append(0.0, columns["strain_warp_percent"])
        lines = {
            name: (strain, np.append(tension, columns[f"tension_{side}_N_per_cm"]))
            for (side, name), tension in zip(names.items(), start, strict=True)
        }
        return "tension_against_strain", (self.column.axis, "tension (N/cm)"), lines
