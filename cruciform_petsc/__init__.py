# SPDX-License-Identifier: MIT
"""Woven fabrics as parallel networks of cruciform elements.

- The cloth: `Fabric`, `YarnFamily`, `Preform`; `Network(comm, preform, fabric)` puts it together.
- Tests: `BiasExtension`, `PictureFrame`, `OffAxisTension`, `Biaxial`, `Cantilever`, `Pantograph`;
  their `solve()` gives a `TestResult`.
- What is made of a result: `plot`, `scene`, `write`, `export`, `compare_with_membrane`.
- Case files: `Case`. Errors: `CruciformError` and its kinds `InputError`, `SolverError`.

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
    "compare_with_membrane": "continuum.compare",
    "export": "output.exports",
    "plot": "output.figures",
    "scene": "output.figures",
    "write": "output.paraview",
}
__all__ = list(_HOME)


def __getattr__(name: str) -> Any:
    if name not in _HOME:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(f".{_HOME[name]}", __name__), name)
