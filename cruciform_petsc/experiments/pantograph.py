# SPDX-License-Identifier: MIT
"""Pantographic sheet: extension of a net of beams hinged at their crossovers."""

from __future__ import annotations

from typing import Any

from ..net.network import Network
from .bias_extension import BiasExtension


class Pantograph(BiasExtension):
    """Extension of a pantographic sheet: a bias test of yarns that bend, between two clamps.

    The sheet is a Fabric whose yarns are its fibres (dell'Isola et al. 2016; in the library:
    "pantographic-sheet-2016").

    Parameters
    ----------
    network : Network
    extension : str, float or sequence of them
    **options
        See Experiment.
    """

    kind = "pantograph"

    def __init__(self, network: Network, extension: Any, **options: Any):
        super().__init__(network, extension, **options)
