# SPDX-License-Identifier: MIT
"""Woven fabrics as parallel networks of cruciform elements.

Names are loaded when they are first used, so that the command line can hand its options to PETSc
before anything starts it.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

__version__ = "0.1.0"

if TYPE_CHECKING:
    from .case.schema import Case
    from .cloth.fabric import Fabric, YarnFamily
    from .cloth.preform import Preform
    from .errors import CruciformError, InputError, SolverError
    from .experiments.bias_extension import BiasExtension
    from .experiments.biaxial import Biaxial
    from .experiments.cantilever import Cantilever
    from .experiments.off_axis import OffAxisTension
    from .experiments.pantograph import Pantograph
    from .experiments.picture_frame import PictureFrame
    from .experiments.result import TestResult
    from .net.network import Network

_HOME = {
    "BiasExtension": "experiments.bias_extension",
    "Biaxial": "experiments.biaxial",
    "Cantilever": "experiments.cantilever",
    "Case": "case.schema",
    "CruciformError": "errors",
    "Fabric": "cloth.fabric",
    "InputError": "errors",
    "Network": "net.network",
    "OffAxisTension": "experiments.off_axis",
    "Pantograph": "experiments.pantograph",
    "PictureFrame": "experiments.picture_frame",
    "Preform": "cloth.preform",
    "SolverError": "errors",
    "TestResult": "experiments.result",
    "YarnFamily": "cloth.fabric",
}
__all__ = [
    "BiasExtension",
    "Biaxial",
    "Cantilever",
    "Case",
    "CruciformError",
    "Fabric",
    "InputError",
    "Network",
    "OffAxisTension",
    "Pantograph",
    "PictureFrame",
    "Preform",
    "SolverError",
    "TestResult",
    "YarnFamily",
]


def __getattr__(name: str) -> Any:
    if name not in _HOME:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(f".{_HOME[name]}", __name__), name)
