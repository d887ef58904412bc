# SPDX-License-Identifier: MIT
"""The continuum reference in dolfinx: membranes of the same cut, linear and hyperelastic."""

from .compare import Comparison, compare_fields
from .hyperelastic import HyperelasticMembrane, HyperelasticResult
from .membrane import Membrane, MembraneResult
from .mesh import outline_mesh
from .points import evaluate

__all__ = [
    "Comparison",
    "HyperelasticMembrane",
    "HyperelasticResult",
    "Membrane",
    "MembraneResult",
    "compare_fields",
    "evaluate",
    "outline_mesh",
]
