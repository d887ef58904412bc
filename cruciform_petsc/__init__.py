# SPDX-License-Identifier: MIT
"""Woven fabrics as parallel networks of cruciform elements.

- The cloth: `Fabric`, `YarnFamily`, `Preform`; `Network(comm, preform, fabric)` puts it together.
- Tests: `BiasExtension`, `PictureFrame`, `OffAxisTension`, `Biaxial`, `Cantilever`, `Pantograph`;
  their `solve()` gives a `TestResult`.
- What is made of a result: `plot`, `scene`, `write`, `export`, `compare_with_membrane`.
- Case files: `Case`. Errors: `CruciformError` and its kinds `InputError`, `SolverError`; what is
  hardly meant is an `InputWarning`.

`help(cruciform_petsc.Network)` tells more of each, README.md has a script to begin with. Names
are loaded when they are first used, so that the command line can hand its options to PETSc before
anything starts it.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

__version__ = "0.2.0"

if TYPE_CHECKING:
    from .case.schema import Case as Case
    from .cloth.fabric import Fabric as Fabric
    from .cloth.fabric import YarnFamily as YarnFamily
    from .cloth.preform import Preform as Preform
    from .continuum.compare import compare_with_membrane as compare_with_membrane
    from .errors import CruciformError as CruciformError
    from .errors import InputError as InputError
    from .errors import InputWarning as InputWarning
    from .errors import SolverError as SolverError
    from .experiments.bias_extension import BiasExtension as BiasExtension
    from .experiments.biaxial import Biaxial as Biaxial
    from .experiments.cantilever import Cantilever as Cantilever
    from .experiments.off_axis import OffAxisTension as OffAxisTension
    from .experiments.pantograph import Pantograph as Pantograph
    from .experiments.picture_frame import PictureFrame as PictureFrame
    from .experiments.result import TestResult as TestResult
    from .net.network import Network as Network
    from .output.exports import export as export
    from .output.figures import plot as plot
    from .output.figures import scene as scene
    from .output.paraview import write as write

_NAMES = {
    "case.schema": ("Case",),
    "cloth.fabric": ("Fabric", "YarnFamily"),
    "cloth.preform": ("Preform",),
    "continuum.compare": ("compare_with_membrane",),
    "errors": ("CruciformError", "InputError", "InputWarning", "SolverError"),
    "experiments.bias_extension": ("BiasExtension",),
    "experiments.biaxial": ("Biaxial",),
    "experiments.cantilever": ("Cantilever",),
    "experiments.off_axis": ("OffAxisTension",),
    "experiments.pantograph": ("Pantograph",),
    "experiments.picture_frame": ("PictureFrame",),
    "experiments.result": ("TestResult",),
    "net.network": ("Network",),
    "output.exports": ("export",),
    "output.figures": ("plot", "scene"),
    "output.paraview": ("write",),
}
_HOME = {name: module for module, names in _NAMES.items() for name in names}
__all__ = list(_HOME)


def __getattr__(name: str) -> Any:
    if name not in _HOME:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(f".{_HOME[name]}", __name__), name)
