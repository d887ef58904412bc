# SPDX-License-Identifier: MIT
"""Woven fabrics as parallel networks of cruciform elements.

- The cloth: `Fabric`, `YarnFamily`, `Preform`; `Network(comm, preform, fabric)` puts it together.
- Tests: `BiasExtension`, `PictureFrame`, `OffAxisTension`, `Biaxial`, `BiaxialLoad`, `Cantilever`,
  `Pantograph`, `PullOut`; their `solve()` gives a `TestResult`. A blank among tools: `Forming`,
  whose `solve()` gives a `Formed`.
- To look at one: `result.plot()` the load, `result.plot(ax, "zones")` another picture, into axes of
  yours; `result.map("shear")`, `result.scene()`; `plot_comparison(one, other)`.
- What is made of a result: `plot`, `scene`, `write`, `export`, `compare_with_membrane`.
- Case files: `Case`; `run_sweep` runs one for many values; `Result.load(folder)` reads what a run
  has left, and draws the same.
- Errors: `CruciformError` and its kinds `InputError`, `SolverError`; what is hardly meant is an
  `InputWarning`.

A script to begin with, which runs under ``mpirun -n 4 python3 script.py``, too::

    from mpi4py import MPI
    from cruciform_petsc import (
        BiasExtension,
        Fabric,
        Network,
        Preform,
        compare_with_membrane,
        plot,
        write,
    )

    fabric = Fabric.from_library("e-glass-plain-2.4")
    preform = Preform.rectangle("75 mm", "220 mm", bias_angle="45 deg")
    network = Network(MPI.COMM_WORLD, preform, fabric)
    result = BiasExtension(network, extension="20 mm").solve()  # finite=False: small displacements
    print(result.load, result.shear_angle_max)  # N, radians
    print(compare_with_membrane(result))  # load_ratio: network over membrane
    plot(result, "bias.png")
    write(result, "bias.vtkhdf")

`help(cruciform_petsc.Network)` tells more of each, and docs/ of what is computed. Names are loaded
when they are first used, so that the command line can hand its options to PETSc before anything
starts it.
"""

from __future__ import annotations

from importlib import import_module
from types import ModuleType
from typing import TYPE_CHECKING, Any

__version__ = "0.2.0"

if TYPE_CHECKING:
    from .case.schema import Case as Case
    from .cloth.fabric import Fabric as Fabric
    from .cloth.fabric import YarnFamily as YarnFamily
    from .cloth.preform import Preform as Preform
    from .compare import plot_comparison as plot_comparison
    from .continuum.compare import compare_with_membrane as compare_with_membrane
    from .errors import CruciformError as CruciformError
    from .errors import InputError as InputError
    from .errors import InputWarning as InputWarning
    from .errors import SolverError as SolverError
    from .experiments.bias_extension import BiasExtension as BiasExtension
    from .experiments.biaxial import Biaxial as Biaxial
    from .experiments.biaxial_load import BiaxialLoad as BiaxialLoad
    from .experiments.cantilever import Cantilever as Cantilever
    from .experiments.off_axis import OffAxisTension as OffAxisTension
    from .experiments.pantograph import Pantograph as Pantograph
    from .experiments.picture_frame import PictureFrame as PictureFrame
    from .experiments.pull_out import PullOut as PullOut
    from .experiments.result import TestResult as TestResult
    from .forming.forming import Formed as Formed
    from .forming.kind import Forming as Forming
    from .net.network import Network as Network
    from .output.exports import export as export
    from .output.figures import plot as plot
    from .output.figures import scene as scene
    from .output.paraview import write as write
    from .output.saved import Result as Result
    from .sweep import run_sweep as run_sweep

_NAMES = {
    "case.schema": ("Case",),
    "cloth.fabric": ("Fabric", "YarnFamily"),
    "cloth.preform": ("Preform",),
    "compare": ("plot_comparison",),
    "continuum.compare": ("compare_with_membrane",),
    "errors": ("CruciformError", "InputError", "InputWarning", "SolverError"),
    "experiments.bias_extension": ("BiasExtension",),
    "experiments.biaxial": ("Biaxial",),
    "experiments.biaxial_load": ("BiaxialLoad",),
    "experiments.cantilever": ("Cantilever",),
    "experiments.off_axis": ("OffAxisTension",),
    "experiments.pantograph": ("Pantograph",),
    "experiments.pull_out": ("PullOut",),
    "experiments.picture_frame": ("PictureFrame",),
    "experiments.result": ("TestResult",),
    "forming.forming": ("Formed",),
    "forming.kind": ("Forming",),
    "net.network": ("Network",),
    "output.exports": ("export",),
    "output.figures": ("plot", "scene"),
    "output.paraview": ("write",),
    "output.saved": ("Result",),
    "sweep": ("run_sweep",),
}
_HOME = {name: module for module, names in _NAMES.items() for name in names}
__all__ = list(_HOME)


def __dir__() -> list[str]:
    ours = [name for name, value in globals().items() if isinstance(value, ModuleType)]
    return sorted({*__all__, *ours, *(name for name in globals() if name.startswith("__"))})


def __getattr__(name: str) -> Any:
    if name not in _HOME:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(f".{_HOME[name]}", __name__), name)
