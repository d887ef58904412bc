# SPDX-License-Identifier: MIT
"""Off-axis tension: a strip pulled at any angle to its yarns; its modulus against Kilby's."""

from __future__ import annotations

from typing import Any, ClassVar, Literal

import numpy as np

from ..net.edges import Constraints
from ..net.network import Network
from .bias_extension import BiasExtension
from .experiment import PULL, Grip
from .result import TestResult
from .table import PullTable


class OffAxisTable(PullTable):
    """A strip pulled at some angle to its yarns; free ends may contract and shear."""

    template: ClassVar = {
        "title": '"Off-axis tension at 30 degrees"',
        "bias_angle": '"30 deg"',
        "test": """
            extension = ["1 mm", "5 mm"]  # By which the upper edge is pulled, one value or a list
            # load = "0.5 N"  # Force on the upper edge, one value or a list
            # or "grip": Clamped, or free to contract and to slide across the pull
            ends = "free"
        """,
    }

    kind: Literal["off-axis-tension"]
    ends: Literal["grip", "free"] = "grip"
    """Clamped, or free to contract and to slide across the pull."""


class OffAxisTension(BiasExtension):
    """Tension of a strip cut at any angle, y being the direction of pull.

    Arguments as for BiasExtension, and ``ends``: "grip"; or "free" to contract and to slide across
    the pull, as in a test on a long strip: only how far they move along it is prescribed.
    """

    table = OffAxisTable
    kind = "off-axis-tension"
    ends: str

    def __init__(self, network: Network, extension: Any = None, load: Any = None, **keys: Any):
        super().__init__(network, extension, load=load, **keys)
        if self.ends == "free":  # no clamp, no zones
            self.has_zones, self.reference, self.clamps = False, "free", ()

    def grip(self, constraints: Constraints) -> list[Grip]:
        """Clamp both ends; or guide both, and hold one point across the pull. Collective."""
        if self.ends == "grip":
            return super().grip(constraints)
        grips = [Grip(edge, constraints.guide(edge, PULL, 0.0)) for edge in ("lower", "upper")]
        # One yarn end in the middle of the lower edge keeps the strip from sliding off sideways.
        network, nodes = self.network, grips[0].nodes
        nodes = nodes[nodes < network.num_nodes_owned]
        off = np.abs(network.node_position[nodes, 0] - self.middle[0]).round(12).tolist()
        nearest = min(zip(off, network.node_key[nodes].tolist(), strict=True), default=(np.inf, -1))
        _, key = min(network.comm.allgather(nearest))
        constraints.pin(key, (1,))
        return grips

    def extra_columns(self, result: TestResult) -> dict[str, np.ndarray]:
        """Mean strain and stress over the strip: its curve apart from its size."""
        width, length = self.size
        return {
            "strain_percent": 100.0 * result.controls / length,
            "stress_N_per_cm": result.loads / width / 100.0,
        }

    def figures(self, result: TestResult) -> dict[str, Any]:
        """Modulus of the first state, and Kilby's for small displacements and free sides."""
        moved = np.flatnonzero(result.controls)
        figures = super().figures(result)
        if not len(moved):
            return figures
        curve = self.extra_columns(result)
        modulus = 100.0 * curve["stress_N_per_cm"][moved[0]] / curve["strain_percent"][moved[0]]
        kilby = self.network.fabric.off_axis_modulus(self.network.preform.bias_angle)
        return figures | {
            "modulus_n_per_cm": float(modulus),
            "kilby_n_per_cm": float(kilby) / 100.0,
        }
