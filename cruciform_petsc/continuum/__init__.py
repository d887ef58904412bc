# SPDX-License-Identifier: MIT
"""The continuum reference in dolfinx: an orthotropic membrane of the same cut."""

from .compare import Comparison, compare_fields
from .membrane import Membrane, MembraneResult
from .mesh import outline_mesh
from .points import evaluate

__all__ = [
    "Comparison",
    "Membrane",
    "MembraneResult",
    "compare_fields",
    "evaluate",
    "outline_mesh",
]
