# SPDX-License-Identifier: MIT
"""The case file: its tables, how it is read, and what no single table can know.

Quantities are checked when the file is read and kept as written ("2.4 cm"), so that the dump of a
case is a case file again. Tables of the fabric, the preform and the kinds of test stand beside what
is built from them.
"""

from __future__ import annotations

import re
import tomllib
from collections.abc import Sequence
from difflib import get_close_matches
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from pydantic import Field, PlainValidator, model_validator

from ..cloth.fabric import Fabric, FabricTable
from ..cloth.preform import Preform, PreformTable
from ..errors import InputError, shown
from ..experiments.experiment import Experiment  # starts PETSc: here, on all ranks at once
from ..experiments.registry import kind_class, pick_table
from ..experiments.table import TestTable, small_unless_told
from ..fields import Counts, Name, OneOf, Size, Table
from ..parallel import on_root

if TYPE_CHECKING:
    from mpi4py import MPI

    from ..net.network import Network

# What a case file may set of PETSc: parts of a solver, then a setting. Files come from elsewhere,
# and PETSc would load code (pc_python_type, lists of types) or write files (viewers, matrix dumps,
# MUMPS' streams and out-of-core files) if it were told to. What is not named here is for the
# command line, which is its owner's own affair.
_PETSC_PART = r"(?:mg_(?:levels|coarse|fine|yarn)_(?:\d+_)?|sub_|npc_|esteig_)*"
_PETSC_TOLD = r"ksp_view|(?:ksp|snes)_(?:monitor|converged_reason)|ksp_monitor_true_residual"
_PETSC_SETTING = "|".join(
    (
        r"(?:ksp|pc|snes)_type",
        r"(?:ksp|snes)_(?:rtol|atol|divtol|stol|max_it|max_funcs|error_if_not_converged)",
        r"ksp_(?:norm_type|pc_side|gmres_restart|richardson_scale)",
        r"ksp_chebyshev_(?:kind|eigenvalues|esteig|esteig_steps|esteig_noisy)",
        r"snes_linesearch_(?:type|damping|max_it|maxstep|minlambda|order|rtol|atol|ltol)",
        r"pc_mg_(?:type|cycle_type|levels|galerkin|multiplicative_cycles|distinct_smoothup)",
        r"pc_gamg_(?:type|agg_nsmooths|threshold|threshold_scale|coarse_eq_limit|repartition"
        r"|process_eq_limit|aggressive_coarsening|square_graph|reuse_interpolation|esteig_ksp_max_it)",
        r"pc_hypre_type",
        r"pc_hypre_boomeramg_(?:cycle_type|max_levels|max_iter|tol|strong_threshold|interp_type"
        r"|coarsen_type|agg_nl|numfunctions|nodal_coarsen|vec_interp_variant|relax_type_all|P_max"
        r"|grid_sweeps_all|truncfactor)",
        r"pc_factor_(?:levels|fill|shift_type|shift_amount|mat_solver_type|mat_ordering_type"
        r"|drop_tolerance|in_place|zeropivot)",
        r"pc_(?:sor_(?:omega|its|lits|symmetric)|jacobi_type|bjacobi_blocks|asm_overlap|asm_type)",
        # Not 1 to 3 (streams) and 22 (out of core).
        r"mat_mumps_(?:cntl_\d+|icntl_(?!(?:1|2|3|22)$)\d+)",
        r"mg_yarn_sweeps",
    )
)


def _petsc_options(value: Any) -> Any:
    """Accept settings of PETSc's solvers, without the leading dash and with plain values."""
    if not isinstance(value, dict):
        raise ValueError('must be a table like { ksp_type = "cg" }')
    for name, setting in value.items():
        if not re.fullmatch(r"[A-Za-z]\w*", name, re.ASCII):
            raise ValueError(f'has the option "{name}", write it like "ksp_type", without a dash')
        wanted = ""
        if not isinstance(setting, str | int | float):
            wanted = "a string, a number or true/false"
        elif re.fullmatch(_PETSC_PART + f"(?:{_PETSC_TOLD})", name, re.ASCII):
            wanted = "" if isinstance(setting, bool) else "true or false"
        elif not re.fullmatch(_PETSC_PART + f"(?:{_PETSC_SETTING})", name, re.ASCII):
            raise ValueError(
                f'has the option "{name}", which a case file may not set: it is none, or could '
                f"run code or write files. Whoever runs it can give -cruciform_{name} on the "
                "command line"
            )
        elif isinstance(setting, str) and (
            not re.fullmatch(r"[\w.,+-]*", setting, re.ASCII)
            or re.search("python|shell", setting, re.IGNORECASE)
        ):
            wanted = "a number or one of PETSc's words that run no code"
        if wanted:
            raise ValueError(f'"{name}" must be {wanted}, got {shown(setting)}')
    return value


class ContinuumTable(Table):
    """[continuum]: the membrane to compare with."""

    compare: bool = False
    """Solve a membrane in dolfinx, too, and compare."""
    second_gradient: bool | None = None
    """Whether the membrane resists the bending of yarns. The default: where the network does and
    test.finite = true. Example: `true`"""
    mesh_size: Size | None = None
    """Of the membrane. The default is the program's choice."""
    ladder: Counts | None = None
    """Compare finer and finer nets: values of refine. Example: `[1, 2, 4]`"""

    @property
    def mesh_size_si(self) -> float | None:
        """Mesh size [m], or None for the program's choice."""
        return None if self.mesh_size is None else self.mesh_size.si


class SolverTable(Table):
    """[solver]: PETSc options, put under the solver's prefix."""

    options: Annotated[dict[str, str | int | float | bool], PlainValidator(_petsc_options)] = Field(
        default={}
    )
    """PETSc options of the network's solver. Without dash and prefix. Settings of solvers only:
    nothing that could run code or write files. Example: `{ ksp_type = "cg", ksp_rtol = 1e-09 }`"""


class OutputTable(Table):
    """[output]: where results go, and which."""

    directory: Name = "results"
    """Folder of the results, made if it is not there."""
    pictures: bool = True
    """Figures of the result."""
    scene: bool = False
    """scene.png, the woven yarns in space, drawn with PyVista."""
    paraview: bool = True
    """network.vtkhdf for ParaView."""
    exports: bool = False
    """crossovers.csv and preform.inp for other codes (docs/exports.md)."""
    report: bool | None = None
    """report.html, one page with everything; by default if pictures are on. Example: `true`"""
    measured: Name | None = None
    """CSV file of a measured displacement and force to compare the load with; in a case file,
    relative to its folder. Example: `"measured.csv"`"""

    @property
    def wants_report(self) -> bool:
        """Whether report.html is written."""
        return self.pictures if self.report is None else self.report


class Case(Table):
    """A whole case file, checked; what its tables describe comes from `fabric` and `preform`."""

    title: str = "untitled"
    """What the case is; heads log and figures."""
    fabric_table: FabricTable = Field(alias="fabric")
    """The cloth."""
    preform_table: PreformTable = Field(alias="preform")
    """What was cut from it."""
    test: Annotated[TestTable, OneOf(pick_table)]
    """What is done to it."""
    continuum: ContinuumTable = ContinuumTable()
    """The membrane beside it."""
    solver: SolverTable = SolverTable()
    """Options of the solver."""
    output: OutputTable = OutputTable()
    """What is written, and where."""

    @model_validator(mode="before")
    @classmethod
    def _ladder_asks_for_small(cls, data: Any) -> Any:
        match data:
            case {"test": dict(test), "continuum": {"ladder": list(), **others}}:
                if not others.get("second_gradient"):  # which is finite
                    return data | {"test": small_unless_told(test)}
        return data

    @classmethod
    def load(cls, path: str | Path, overrides: Sequence[str] = ()) -> Case:
        """Read and check a TOML file.

        ``overrides`` are like "preform.refine=4", with a value in TOML, or a bare text. Raises
        InputError for anything wrong with the file, its keys and values, the fabric, the outline,
        or the edges the test needs.
        """
        data = _read(Path(path))
        match data:
            case {"output": {"measured": str(measured)}} if measured:
                # As a path that a resumed run, or one in another folder, still finds.
                data["output"]["measured"] = str((Path(path).parent / measured).absolute())
        for override in overrides:
            _apply(data, override)
        case = cls.from_data(data)
        case.check_together()
        return case

    @classmethod
    def load_collective(
        cls, comm: MPI.Intracomm, path: str | Path, overrides: Sequence[str] = ()
    ) -> Case:
        """Read on rank 0 only; every rank returns the same case or raises the same InputError."""
        return on_root(comm, lambda: cls.load(path, overrides))

    def fabric(self) -> Fabric:
        """Make the fabric."""
        return self.fabric_table.build(self.title)

    def preform(self, refine: int | None = None) -> Preform:
        """Make the preform; `refine` replaces the case's (for a ladder)."""
        return self.preform_table.build(refine)

    def experiment(
        self, network: Network, *, bending: bool | None = None, controls: Any = None
    ) -> Experiment:
        """Make the experiment on the case's network, or a finer one.

        ``bending`` and ``controls`` (extensions, angles, strains, a cantilever's loads, in SI) may
        be others than the case's.
        """
        given: dict[str, Any] = dict(iter(self.test))
        kind = kind_class(given.pop("kind"))
        if controls is not None:
            given |= dict.fromkeys(self.test.controls) | {next(iter(self.test.controls)): controls}
        if bending is not None:
            given["bending"] = bending
        return kind(network, **given, options=self.solver.options)

    @property
    def second_gradient(self) -> bool:
        """Whether the continuum resists the bending of yarns: as told, else as the network does."""
        told = self.continuum.second_gradient
        return self.test.finite and self.test.bending if told is None else told

    def model_dump(self, **options: Any) -> dict[str, Any]:
        """Return the case as plain data with the case file's own keys; JSON can hold it."""
        return super().model_dump(**dict[str, Any](by_alias=True, mode="json") | options)

    def check_together(self) -> None:
        """Check what no single table can know."""
        fabric, preform = self.fabric(), self.preform()
        preform.check_size(fabric)
        for edge in ("lower", "upper"):  # without a clamp the body would float
            try:
                preform.edge(edge)
            except InputError as error:
                raise InputError(f'test.kind = "{self.test.kind}": {error}') from None
        self.test.check(preform, fabric)
        for key in ("finite", "bending") if self.continuum.second_gradient else ():
            if not getattr(self.test, key):
                raise InputError(f"continuum.second_gradient = true needs test.{key} = true")
        if self.continuum.ladder is not None and preform.yarns_per_cruciform > 1:
            raise InputError(
                "continuum.ladder refines the network, so preform.yarns_per_cruciform must be 1, "
                f"got {preform.yarns_per_cruciform}"
            )


def _read(path: Path) -> dict[str, Any]:
    """Read TOML; every way this can fail is one sentence."""
    try:
        return tomllib.loads(path.read_bytes().decode("utf-8"))
    except FileNotFoundError:
        near = [other.name for other in path.parent.glob("*.toml")]
        close = get_close_matches(path.name, near, 1)
        problem = "does not exist"
        problem += f', did you mean "{path.parent / close[0]}"?' if close else ""
    except IsADirectoryError:
        problem = "is a folder, name a TOML file in it"
    except OSError as error:
        problem = f"cannot be read: {error.strerror}"
    except UnicodeDecodeError as error:
        problem = f"is not UTF-8 text (byte {error.start + 1}), save it as UTF-8"
    except ValueError as error:  # TOML errors, and a null byte in the path
        problem = f"is not TOML: {error}"
    raise InputError(f'case file "{path}" {problem}')


def _apply(data: dict[str, Any], override: str) -> None:
    """Put one "table.key=value" into the data."""
    name, equals, text = override.partition("=")
    keys = [key.strip() for key in name.split(".")]
    if not equals or not all(re.fullmatch(r"[\w-]+", key) for key in keys):
        raise InputError(f'--set "{override}" is not of the form preform.refine=4')
    try:
        value = tomllib.loads(f"value = {text}")
        setting = value["value"] if len(value) == 1 else text
    except tomllib.TOMLDecodeError:
        setting = text.strip()
    table: Any = data
    for i, key in enumerate(keys[:-1], 1):
        table = table.setdefault(key, {})
        if not isinstance(table, dict):
            raise InputError(f'--set "{override}": {".".join(keys[:i])} is a value, not a table')
    table[keys[-1]] = setting
