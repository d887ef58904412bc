# SPDX-License-Identifier: MIT
"""The case file: its tables, how it is read, and what no single table can know.

Quantities are checked when the file is read and kept as written ("2.4 cm"), so that the dump of a
case is a case file again. Tables of the fabric, the preform and the kinds of test stand beside what
is built from them.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, get_origin

import shapely
import shapely.affinity
from pydantic import Field, PlainValidator, model_validator
from pydantic.json_schema import GenerateJsonSchema

from ..cloth.fabric import Fabric, FabricTable
from ..cloth.preform import OutlineTable, Preform, PreformTable
from ..errors import InputError, Problems
from ..experiments.experiment import Experiment  # starts PETSc: here, on all ranks at once
from ..experiments.registry import every_table, in_space, kind_class, pick_table
from ..experiments.table import small_unless_told
from ..fields import Counts, Name, OneOf, Size, Table, Title, tables_in
from ..forming.draping import Draping
from ..forming.fishnet_table import FishnetTable
from ..forming.kind import Forming
from ..forming.plies import PlyOf, PlyTable, check_plies, made
from ..forming.table import (
    ArrangedTable,
    ClampTable,
    FormingTable,
    StageTable,
    check_course,
    check_pressure,
    check_stages,
    laying_stages,
)
from ..parallel import on_root
from ..reading import parse_toml, read_toml
from ..solvers.settings import check_settings
from ..tools.tool import ToolTable
from .lines import with_lines

if TYPE_CHECKING:
    from mpi4py import MPI

    from ..net.network import Network

# A key as `--set` has it: tables' names, and numbers of those in a list, from zero as in sentences.
_PART = r"[\w-]+(?:\[\d{1,4}\])*"
KEY = rf"\s*{_PART}\s*(?:\.\s*{_PART}\s*)*"
_KEYS = re.compile(r"([\w-]+)|\[(\d+)\]")


class ContinuumTable(Table):
    """[continuum]: the membrane to compare with."""

    compare: bool = False
    """Solve a membrane in dolfinx, too, and compare."""
    second_gradient: bool | None = None
    """Whether the membrane resists the bending of yarns. The default: where the network does and
    test.finite = true. Example: `true`"""
    mesh_size: Size | None = None
    """Of the membrane. The default is the program's choice; of a forming half the net's pitch."""
    ladder: Counts | None = None
    """Compare finer and finer nets: values of refine, of a forming with its yarns_per_cruciform.
    Example: `[1, 2, 4]`"""

    @property
    def mesh_size_si(self) -> float | None:
        """Mesh size [m], or None for the program's choice."""
        return None if self.mesh_size is None else self.mesh_size.si


class SolverTable(Table):
    """[solver]: PETSc options, put under the solver's prefix."""

    options: Annotated[dict[str, str | int | float | bool], PlainValidator(check_settings)] = Field(
        default={}
    )
    """PETSc options of the network's solver. Without dash and prefix. Settings of solvers only, in
    bounds: nothing that could run code, write files or work without end.
    Example: `{ ksp_type = "cg", ksp_rtol = 1e-09 }`"""


class OutputTable(Table):
    """[output]: where results go, and which."""

    directory: Name = "results"
    """Folder of the results, made if it is not there. Where a case file NAME.toml tells none it is
    results/NAME."""
    pictures: bool = True
    """Figures of the result."""
    scene: bool = False
    """scene.png, the woven yarns in space, drawn with PyVista."""
    animation: bool = False
    """Write animation.gif: of a forming the blank among its tools at all results, of a finite test
    the yarns as it goes on."""
    paraview: bool = True
    """network.vtkhdf for ParaView."""
    exports: bool = False
    """Files for other codes (docs/exports.md): crossovers.csv and preform.inp, of a forming
    cells.csv and decks for Abaqus, CalculiX and OpenRadioss."""
    part_outline: OutlineTable | None = None
    """Of a forming: what the formed cloth is trimmed to, in plan, from the centre of the blank; all
    but polygons and drawings lie around it. Mapped back onto the flat blank it is the net pattern.
    Example: `{ rectangle = ["160 mm", "120 mm"] }`"""
    report: bool | None = None
    """report.html, one page with everything; by default if pictures are on. Example: `true`"""
    measured: Name | None = None
    """CSV file of a measured displacement and force to compare the load with; in a case file,
    relative to its folder. Example: `"measured.csv"`"""
    measured_columns: Name | None = None
    """Titles of its two columns, or their numbers, where units leave a choice.
    Example: `"Extension (mm),Load (N)"`"""

    @property
    def part(self) -> shapely.Polygon | None:
        """The part's outline in plan, m."""
        if self.part_outline is None:
            return None
        polygon, _ = self.part_outline.build()
        if self.part_outline.polygon is not None or self.part_outline.file is not None:
            return polygon
        low, high = polygon.bounds[1], polygon.bounds[3]
        return shapely.affinity.translate(polygon, 0.0, -0.5 * (low + high))

    @property
    def wants_report(self) -> bool:
        """Whether report.html is written."""
        return self.pictures if self.report is None else self.report


class Case(Table):
    """A whole case file, checked; what its tables describe comes from `fabric` and `preform`."""

    title: Title = "untitled"
    """What the case is; heads log and figures."""
    fabric_table: FabricTable = Field(alias="fabric")
    """The cloth."""
    preform_table: PreformTable = Field(alias="preform")
    """What was cut from it."""
    test: Annotated[Any, OneOf(pick_table, every_table)]
    """What is done to it."""
    tools: list[ToolTable] = Field(alias="tool", default=[])
    """Rigid tools of a forming, `[[tool]]`."""
    plies: list[PlyTable] = Field(alias="ply", default=[])
    """Plies of its blank, from the lowest up, `[[ply]]`; a single one needs none."""
    clamps: list[ClampTable] = Field(alias="clamp", default=[])
    """Edges of its blank that are held, `[[clamp]]`."""
    stages: list[StageTable] = Field(alias="stage", default=[])
    """What they do, one after the other, `[[stage]]`."""
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
                if not others.get("second_gradient") and not in_space(test.get("kind")):
                    return data | {"test": small_unless_told(test)}
        return data

    @model_validator(mode="after")
    def _arranged(self) -> Case:
        """Tools, clamps and stages of a kind that has its own."""
        if not isinstance(self.test, ArrangedTable):
            return self
        for key, told in (("tool", self.tools), ("clamp", self.clamps), ("stage", self.stages)):
            if told:
                raise ValueError(f'{key} is for test.kind = "forming", not "{self.test.kind}"')
        tools, clamps, stages = self.test.arranged()
        vars(self).update(tools=tools, clamps=clamps, stages=stages)
        return self

    @classmethod
    def load(cls, path: str | Path, overrides: Sequence[str] = ()) -> Case:
        """Read and check a TOML file.

        ``overrides`` are like "preform.refine=4" or "tool[0].friction=0.2", with a value in TOML,
        or a bare text. Raises InputError for anything wrong with the file, its keys and values, the
        fabric, the outline, or the edges the test needs: all problems at once, with their lines in
        the file.
        """
        text, data = read_toml(path, "case file")
        # As paths that a resumed run, or one in another folder, still finds.
        paths = [(data.get("output"), "measured")]
        for name, key in (("preform", "outline"), ("output", "part_outline")):
            if isinstance(data.get(name), dict):
                paths.append((data[name].get(key), "file"))
        fabric = data.get("fabric")
        if isinstance(fabric, dict) and isinstance(fabric.get("tension"), dict):
            paths.append((fabric["tension"].get("surface"), "file"))
        if isinstance(data.get("ply"), list):
            paths += [(ply.get("outline"), "file") for ply in data["ply"] if isinstance(ply, dict)]
        if isinstance(data.get("tool"), list):
            paths += [(t.get("shape"), "file") for t in data["tool"] if isinstance(t, dict)]
        for table, key in paths:
            if isinstance(table, dict) and isinstance(table.get(key), str) and table[key]:
                table[key] = str((Path(path).parent / table[key]).absolute())
        # Two cases beside each other shall not replace each other's results.
        if isinstance(data.setdefault("output", {}), dict):
            data["output"].setdefault("directory", f"results/{Path(path).stem}")
        for override in overrides:
            _apply(data, override)
        problems = Problems()
        with problems.caught():
            case = cls.from_data(data)
            case.check_together()
            return case
        if {"fabric", "preform"} <= data.keys():
            with problems.caught():  # what only building tells, whatever else is wrong
                FabricTable.from_data(data["fabric"], "fabric").build("")
            with problems.caught():
                PreformTable.from_data(data["preform"], "preform").build()
        others = [tuple(re.findall(r"[\w-]+", o.partition("=")[0])) for o in overrides]
        raise InputError(*with_lines(str(path), text, list(dict.fromkeys(problems)), others))

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
        preform = self.preform_table.build(refine)
        return self.test.placed(preform)

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

    def stack(self) -> list[PlyOf]:
        """Make the cloth and preform of each ply; of a blank without [[ply]] there is one."""
        fabric, preform = self.fabric(), self.preform_table.build()
        if not self.plies:
            return [PlyOf("", fabric, self.test.placed(preform), 0.0)]
        return made(self.plies, self.test, preform, fabric)

    def forming(self, network: Network | Sequence[Network]) -> Forming:
        """Make the forming of the case's network, or networks by ply (`stack`). Collective.

        Or the fishnet, which is a Forming without stages.
        """
        given = {key: value for key, value in self.test if key != "kind"}
        first = next(iter(network)) if isinstance(network, Sequence) else network
        if isinstance(self.test, FishnetTable):
            return Draping(first, self.tools, **given, options=self.solver.options)
        if isinstance(self.test, ArrangedTable):
            return kind_class(self.test.kind)(first, **given, options=self.solver.options)
        if self.plies:
            given["names"] = [ply.name for ply in self.plies]
            given["rub"] = [ply.friction for ply in self.plies]
        return Forming(
            network, self.tools, self.stages, self.clamps, **given, options=self.solver.options
        )

    @property
    def all_stages(self) -> list[StageTable]:
        """Stages of a forming, those in which its cloth is laid first."""
        own = laying_stages(self.test) if isinstance(self.test, FormingTable) else []
        return [*own, *self.stages]

    @property
    def second_gradient(self) -> bool:
        """Whether the continuum resists the bending of yarns: as told, else as the network does."""
        told = self.continuum.second_gradient
        return self.test.finite and self.test.bending if told is None else told

    def model_dump(self, **options: Any) -> dict[str, Any]:
        """Return the case as plain data as JSON can hold it."""
        dump = super().model_dump(**{"mode": "json"} | options)
        own = ("tool", "clamp", "stage") if isinstance(self.test, ArrangedTable) else ()
        return {key: value for key, value in dump.items() if value != [] and key not in own}

    @classmethod
    def paths(cls) -> list[str]:
        """Keys of a case file as `--set` has them, those of every kind of test."""
        found: dict[str, None] = {}
        for name, field in cls.model_fields.items():
            key = field.alias or name
            below = list(every_table() if name == "test" else tables_in(field.annotation))
            several = get_origin(field.annotation) is list
            above = f"{key}[0]" if several else key
            paths = [f"{above}.{each}" for table in below for each in table.keys()]  # noqa: SIM118
            found |= dict.fromkeys(paths or [above])
        return list(found)

    @classmethod
    def json_schema(cls) -> dict[str, Any]:
        """JSON schema of a case file, for editors that know TOML: keys, texts about them, defaults.

        It says less than `load` checks: that a text is a quantity, but not of which unit.
        """
        head = {"$schema": "https://json-schema.org/draft/2020-12/schema"}
        schema = cls.model_json_schema(by_alias=True, schema_generator=_Schema)
        return head | _without_null(schema) | {"title": "case file"}

    def check_together(self) -> None:
        """Check what no single table can know."""
        problems = Problems()
        forming = isinstance(self.test, FormingTable)
        fishnet = isinstance(self.test, FishnetTable)
        if forming:
            with problems.caught():
                check_stages(self.test, self.tools, self.stages, self.clamps)
        else:
            for key, told in (
                ("tool", self.tools), ("clamp", self.clamps), ("stage", self.stages),
                ("ply", self.plies),
            ):  # fmt: skip
                if told and not (fishnet and key == "tool"):
                    problems.append(f'{key} is for test.kind = "forming", not "{self.test.kind}"')
        if isinstance(self.test, FishnetTable):
            with problems.caught():
                self.test.check_one(self.tools)
        for key in ("finite", "bending") if self.continuum.second_gradient else ():
            if not getattr(self.test, key):
                problems.append(f"continuum.second_gradient = true needs test.{key} = true")
        for key, on in (
            ("continuum.compare", self.continuum.compare and not forming),
            ("continuum.second_gradient", forming and self.continuum.second_gradient),
            ("output.exports", self.output.exports and not (forming or fishnet)),
            ("output.scene", (forming or fishnet) and self.output.scene),
            ("output.measured", (forming or fishnet) and self.output.measured is not None),
            ("continuum.ladder", fishnet and self.continuum.ladder),
            ("output.animation", fishnet and self.output.animation),
        ):
            if on and (forming or fishnet):
                problems.append(f"{key} is not for {self.test.kind}, leave it out")
            elif on and self.test.space:
                problems.append(f"{key} = true is for flat cloth, it needs test.space = false")
        coarse = self.preform_table.yarns_per_cruciform > 1 and not (forming or fishnet)
        if self.continuum.ladder is not None and coarse:
            problems.append(
                "continuum.ladder refines the network, so preform.yarns_per_cruciform must be 1, "
                f"got {self.preform_table.yarns_per_cruciform}"
            )
        if self.output.animation and not self.test.finite:
            problems.append("output.animation needs test.finite = true")
        part = self.output.part
        if part is not None:
            if not (forming or fishnet):
                problems.append("output.part_outline is for a forming, leave it out")
            elif not part.is_valid:
                problems.append("output.part_outline crosses itself, or its holes do not fit in it")
        beside = self.continuum.compare or self.continuum.ladder
        size, fabric, preform = self.continuum.mesh_size, None, None
        with problems.caught():
            fabric = self.fabric()
        with problems.caught():
            preform = self.preform()
        if preform and size is not None and size.si > preform.size.min():
            problems.append(
                f'continuum.mesh_size = "{size}" is more than the specimen is wide or long'
            )
        if preform and forming and self.plies:
            with problems.caught():
                check_plies(self.plies, self.test, self.stages, self.clamps)
            with problems.caught():
                self.stack()
            if beside:
                problems.append("continuum.compare and continuum.ladder are not for several plies")
            if part is not None:
                problems.append("output.part_outline is not for several plies yet, leave it out")
        if preform and forming:
            with problems.caught():
                check_pressure(self.test, preform, self.stages, self.clamps)
        if fabric and beside and fabric.remembers:
            problems.append(
                "the membrane of [continuum] knows no fabric.shear_viscosity and shear_friction"
            )
        if fabric and forming:
            with problems.caught():
                check_course(self.test, fabric, self.stages)
        if preform and forming and beside:
            if self.clamps:
                problems.append("[[clamp]] is not for a forming with a membrane beside it")
            if self.test.fishnet is not None:
                problems.append("test.fishnet is not for a forming with a membrane beside it")
            with problems.caught():
                preform.along_yarns("the membrane beside a forming")
        for edge in self.test.edges if preform else ():  # without a clamp it would float
            try:
                preform.edge(edge)
            except InputError as error:
                problems.append(f'test.kind = "{self.test.kind}": {error}')
        if preform and fabric:
            with problems.caught():
                preform.check_size(fabric)
            with problems.caught():
                self.test.check(preform, fabric)
        problems.tell()


class _Schema(GenerateJsonSchema):
    """Without a word about defaults that are quantities, which the texts about keys tell."""

    ignored_warning_kinds: set[Any] = {"skipped-choice", "non-serializable-default"}  # noqa: RUF012


def _without_null(schema: Any) -> Any:
    """The same for TOML, which has no null: keys are left out."""
    if isinstance(schema, list):
        return [_without_null(part) for part in schema if part != {"type": "null"}]
    if not isinstance(schema, dict):
        return schema
    kept = {key: _without_null(value) for key, value in schema.items() if value is not None}
    if len(kept.get("anyOf", [])) == 1:
        kept |= kept.pop("anyOf")[0]
    return kept


def _apply(data: dict[str, Any], override: str) -> None:
    """Put one "table.key=value" into the data."""
    name, equals, text = override.partition("=")
    if not equals or not re.fullmatch(KEY, name):
        raise InputError(f'--set "{override}" is not of the form preform.refine=4')
    try:
        value = parse_toml(f"value = {text}")
        setting = value["value"] if len(value) == 1 else text
    except ValueError:
        setting = text.strip()
    table: Any = data
    place = ""
    keys = _KEYS.findall(name)
    for n, (key, index) in enumerate(keys, 1):
        problem = ""
        if index:
            if not isinstance(table, list) or int(index) >= len(table):
                problem = f"there is no {place}[{index}]"
        elif isinstance(table, list):
            problem = f"{place} is a list, write {place}[0].{key}"
        elif not isinstance(table, dict):
            problem = f"{place} is a value, not a table"
        if problem:
            raise InputError(f'--set "{override}": {problem}')
        place += f"[{index}]" if index else f".{key}" if place else key
        at = int(index) if index else key
        if n == len(keys):
            table[at] = setting
        else:
            table = table[at] if index else table.setdefault(at, {})
