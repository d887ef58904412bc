# SPDX-License-Identifier: MIT
"""Pull-out: one yarn pulled out of a cloth that is held beside it."""

from __future__ import annotations

from typing import ClassVar, Literal

import numpy as np

from ..cloth.fabric import Fabric
from ..cloth.preform import Preform
from ..errors import Problems
from ..net.edges import Constraints
from ..quantities import force_text
from .experiment import Experiment, Grip
from .table import Lengths, SlipTable, TestTable


class PullOutTable(TestTable):
    """A yarn pulled out of a rectangle that is clamped on both sides along it."""

    controls: ClassVar = {"extension": "m"}
    along_the_yarns: ClassVar = True
    template: ClassVar = {
        "title": '"Pull-out of a yarn from 60 mm x 40 mm"',
        "outline": '{ rectangle = ["60 mm", "40 mm"] }',
        "bias_angle": '"0 deg"',
        "test": """
            extension = ["0.2 mm", "2 mm", "20 mm"]  # By which the end is pulled, one or a list
        """,
        "slip": '{ force = "0.05 N" }',
    }

    kind: Literal["pull-out"]
    extension: Lengths
    """By which the yarn's end at the upper edge is pulled, one value or a list."""
    slip: SlipTable
    """How yarns slide through crossovers. Example: `{ force = "0.05 N" }`"""

    def check(self, preform: Preform, fabric: Fabric) -> None:
        """Raise InputError if the preform or the fabric is none for such a test."""
        problems = Problems()
        with problems.caught():
            super().check(preform, fabric)
        if preform.refine != 1 or preform.yarns_per_cruciform != 1:
            problems.append(
                'test.kind = "pull-out" pulls one yarn: preform.refine and '
                "preform.yarns_per_cruciform must be 1"
            )
        problems.tell()


class PullOut(Experiment):
    """Pull-out of a yarn: the one nearest to the middle, by its end at the upper edge, along y.

    The edges left and right are clamped, as in Sebastian, Bailey, Briscoe and Tabor 1986, Text.
    Res. J. 56:604; the others are free. Arguments: see Experiment and `PullOutTable`.
    """

    table = PullOutTable
    kind = "pull-out"
    colour = "tension"
    clamps = ("left", "right")
    captions: ClassVar = {
        "load_against_extension.png": "Force on the yarn's end. Friction at all crossings makes "
        "the peak; then the yarn's other end leaves one crossing after the other."
    }

    def grip(self, constraints: Constraints) -> list[Grip]:
        """Clamp both sides, hold the yarn's end. Collective."""
        grips = [Grip(edge, constraints.clamp(edge)) for edge in self.clamps]
        network, family = self.network, self._family
        nodes = constraints.nodes_on("upper")
        nodes = nodes[(nodes < network.num_nodes_owned) & (network.node_family[nodes] == family)]
        nodes = nodes[~constraints.held[nodes]]
        off = np.abs(network.node_position[nodes, 0] - self.middle[0]).round(12).tolist()
        nearest = min(zip(off, network.node_key[nodes].tolist(), strict=True), default=(np.inf, -1))
        _, key = min(network.comm.allgather(nearest))
        constraints.pin(key, (0, 1))
        return [*grips, Grip("yarn", np.flatnonzero(network.node_key == key))]

    def check(self) -> list[str]:
        """See Experiment.check; and what it takes to pull the yarn. Collective."""
        clamps, *told = super().check()
        told = [clamps.rpartition(", ")[0], *told]
        if self.slip is not None:
            crossings = float(self.size[1] / self.network.pitch[self._family])
            force = force_text(crossings * self.slip.force)
            told.append(f"{force} pull the yarn, over {crossings:.3g} crossings")
        return told

    @property
    def _family(self) -> int:
        """Family of yarns along y."""
        return int(abs(self.network.preform.rotation[0, 1]) < 0.5)

    def motion(self, edge: str, control: float) -> tuple[np.ndarray, np.ndarray]:
        """The yarn's end moves along y."""
        return np.eye(2), np.array([0.0, control if edge == "yarn" else 0.0])

    def default_step(self) -> float:
        """Half a pitch: a yarn's end leaves a crossing in two steps."""
        return 0.5 * float(self.network.pitch[self._family])

    def curve_columns(self, curve: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
        """Load of a yarn that does not stretch, in cloth that does not give.

        As many times the pull-out force of a crossing as it has pitches of its length in the cloth.
        """
        if self.slip is None or self.slip.coefficient:
            return {}
        left = np.maximum(self.size[1] - 1e-3 * np.abs(curve["extension_mm"]), 0.0)
        return {"load_net_N": self.slip.force * left / self.network.pitch[self._family]}
