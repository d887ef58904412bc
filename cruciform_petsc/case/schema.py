# SPDX-License-Identifier: MIT
"""The case file: what it may hold, and one clear sentence about what it may not.

Quantities are checked when the file is read and kept as written ("2.4 cm"), so that the dump of a
case is a case file again; `Case.fabric`, `Case.preform` and the ``*_si`` properties give SI.
"""

from __future__ import annotations

import math
import re
import tomllib
import types
from collections.abc import Callable, Sequence
from difflib import get_close_matches
from pathlib import Path
from typing import (
    TYPE_CHECKING,
    Annotated,
    Any,
    ClassVar,
    Literal,
    Union,
    get_args,
    get_origin,
)

import shapely
from pydantic import (
    AfterValidator,
    BaseModel,
    ConfigDict,
    Discriminator,
    Field,
    PlainValidator,
    Tag,
    ValidationError,
    ValidationInfo,
    field_validator,
    model_validator,
)

from ..cloth.fabric import Fabric
from ..cloth.preform import Preform
from ..errors import InputError, cut, shown
from ..parallel import on_root
from ..units import format_si, parse, parse_unit, to_si

if TYPE_CHECKING:
    from mpi4py import MPI

_MOST_PROBLEMS = 3  # in one sentence; a fourth is better told after these are mended


class Checked:
    """A validator that keeps what it has checked and remembers the unit, for the page of keys."""

    def __init__(self, check: Callable[[Any], object], unit: str, bare: bool = False):
        self.check, self.unit, self.bare = check, unit, bare

    def __call__(self, value: Any) -> Any:
        """Check a value, which is a ValueError in words or nothing."""
        self.check(value)
        return value


def _quantity(unit: str) -> PlainValidator:
    """Accept a string with a unit of this dimension, and keep the string."""
    return PlainValidator(Checked(lambda value: parse(value, unit), unit))


def _quantities(
    unit: str, good: Callable[[float], bool] | None = None, wanted: str = ""
) -> PlainValidator:
    """Accept one such string or a list of them; each must be `good`, which `wanted` tells."""

    def check_one(value: Any) -> None:
        number = parse(value, unit)
        if good is not None and not good(number):
            raise ValueError(f'must be {wanted}, got "{cut(value)}"')

    def check(value: Any) -> None:
        if not isinstance(value, list):
            check_one(value)
        elif not value:
            raise ValueError("is an empty list, give at least one value")
        else:
            for i, item in enumerate(value):
                try:
                    check_one(item)
                except ValueError as error:
                    raise ValueError(f"(value {i + 1}) {error}") from None

    return PlainValidator(Checked(check, unit))


def _unit(si: str) -> PlainValidator:
    """Accept a unit by itself, as it stands over a column of numbers."""
    return PlainValidator(Checked(lambda value: parse_unit(value, si), si, bare=True))


def _positive_length(value: str) -> str:
    if parse(value, "m") <= 0.0:
        raise ValueError(f'must be positive, got "{cut(value)}"')
    return value


# What a case file may set of PETSc: parts of a solver, then a setting. Files come from elsewhere,
# and PETSc would load code (pc_python_type, lists of types) or write files (viewers, matrix dumps,
# MUMPS' streams and out-of-core files) if it were told to. What is not named here is for the
# command line, which is its owner's own affair.
_PETSC_PART = r"(?:mg_(?:levels|coarse|fine|yarn)_(?:\d+_)?|sub_|npc_|esteig_)*"
_PETSC_TOLD = r"ksp_view|(?:ksp|snes)_(?:monitor|converged_reason)|ksp_monitor_true_residual"
_PETSC_SETTING = "|".join((
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
))  # fmt: skip


def _petsc_options(value: Any) -> Any:
    """Accept settings of PETSc's solvers, without the leading dash and with plain values."""
    if not isinstance(value, dict):
        raise ValueError('must be a table like { ksp_type = "cg" }')
    for name, setting in value.items():
        if not re.fullmatch(r"[A-Za-z]\w*", name, re.ASCII):
            raise ValueError(f'has the option "{name}", write it like "ksp_type", without a dash')
        if not isinstance(setting, str | int | float):
            raise ValueError(
                f'"{name}" must be a string, a number or true/false, got {shown(setting)}'
            )
        if re.fullmatch(_PETSC_PART + f"(?:{_PETSC_TOLD})", name, re.ASCII):
            if not isinstance(setting, bool):
                raise ValueError(f'"{name}" must be true or false, got {shown(setting)}')
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
            raise ValueError(
                f'"{name}" must be a number or one of PETSc\'s words that run no code, got '
                f"{shown(setting)}"
            )
    return value


Length = Annotated[str, _quantity("m")]
Point = Annotated[list[Length], Field(min_length=2, max_length=2)]
Ring = Annotated[list[Point], Field(min_length=3)]
Count = Annotated[int, Field(ge=1)]
Counts = Annotated[list[Count], Field(min_length=1)]
Number = Annotated[float, Field(allow_inf_nan=False)]
Pairs = list[Annotated[list[Number], Field(min_length=2, max_length=2)]]


class _Table(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True, strict=True)


class TensionLawTable(_Table):
    """[fabric] warp.tension and weft.tension: a law in place of the modulus."""

    law: Literal["table"] = Field(description="Points, joined without bumps.")
    strain: Annotated[str, _unit("1")] = Field(
        description="Unit of the first column.", examples=["%"]
    )
    force: Annotated[str, _unit("N/m")] = Field(
        description="Unit of the second column.", examples=["N/cm"]
    )
    points: Pairs = Field(
        description="Strain and tension, rising; beyond the last point the last slope goes on.",
        examples=[[[0.5, 5], [1, 30]]],
    )


class YarnTable(_Table):
    """[fabric] warp and weft."""

    # before modulus, whose check asks for it
    tension: TensionLawTable | None = Field(
        default=None, description="A law in place of the modulus; needs poisson = 0 (docs/laws.md)."
    )
    modulus: Annotated[str, _quantity("N/m")] | None = Field(
        default=None,
        validate_default=True,
        description="Tension per width over strain. Needed without tension.",
        examples=["520 N/cm"],
    )
    poisson: float = Field(
        description="Contraction of the other family when this one is pulled. "
        "Reciprocity: poisson of the weft times modulus of the warp is the reverse.",
        examples=[0.0],
    )
    yarns: Annotated[str, _quantity("1/m")] = Field(
        description="Yarns per length across them.", examples=["2.4 /cm"]
    )
    yarn_bending: Annotated[str, _quantity("N*m**2")] = Field(
        default="0 N mm^2",
        description="In-plane flexural rigidity of one yarn. Above zero for test.bending = true.",
        examples=["0.6 N mm^2"],
    )

    @field_validator("modulus")
    @classmethod
    def _or_tension(cls, modulus: str | None, info: ValidationInfo) -> str | None:
        if "tension" not in info.data:  # given, and wrong in itself
            return modulus
        if modulus is None and info.data["tension"] is None:
            raise ValueError("is missing")
        if modulus is not None and info.data["tension"] is not None:
            raise ValueError("cannot stand beside tension, a law in its place")
        return modulus


class ShearTable(_Table):
    """[fabric] shear: a modulus, or a law with its own keys, which `Fabric.from_table` checks."""

    modulus: Annotated[str, _quantity("N/m")] | None = Field(
        default=None, description="Of a linear law. Either this or law.", examples=["0.96 N/cm"]
    )
    law: Literal["table", "polynomial", "sin-potential"] | None = Field(
        default=None, description="A law in place of the modulus (docs/laws.md)."
    )
    angle: Annotated[str, _unit("rad")] | None = Field(
        default=None, description='Unit of the first column, with law = "table".', examples=["deg"]
    )
    force: Annotated[str, _unit("N/m")] | None = Field(
        default=None,
        description='Unit of the second column, with law = "table".',
        examples=["N/mm"],
    )
    points: Pairs | None = Field(
        default=None,
        description='Shear angle and psi\', rising, with law = "table".',
        examples=[[[10, 0.01], [40, 0.2]]],
    )
    coefficients: Annotated[str | list[str], _quantities("N/m")] | None = Field(
        default=None,
        description='Of the other laws: k1 gamma + k2 gamma^3 + ... with law = "polynomial", '
        'k1 sin^2 gamma + k2 sin^4 gamma + ... (an energy) with law = "sin-potential".',
        examples=[["0.1 N/mm", "0.3 N/mm"]],
    )


class TensionTable(_Table):
    """[fabric] tension: which strain, and what becomes of yarns in compression."""

    strain: Literal["engineering", "log"] = Field(
        default="engineering", description="Stretch less 1, or its logarithm."
    )
    compression: Number = Field(
        default=1.0,
        description="Stiffness of yarns in compression over that in tension. Above 0, at most 1.",
    )
    compression_width: Number = Field(
        default=1e-4,
        description="Strain over which the stiffness falls. About buckling stress over modulus.",
    )


class FabricTable(_Table):
    """[fabric]: a name from the library, maybe with laws of one's own, or the values."""

    use: str | None = Field(
        default=None,
        description="A fabric of the library (cruciform-petsc fabrics). Or warp, weft and shear.",
        examples=["glass-pp-plain-1.93"],
    )
    warp: YarnTable | None = Field(
        default=None,
        description="Values of one's own, in place of use.",
        examples=[
            {
                "modulus": "520 N/cm",
                "poisson": 0.45,
                "yarns": "2.4 /cm",
                "yarn_bending": "0.6 N mm^2",
            }
        ],
    )
    weft: YarnTable | None = Field(
        default=None,
        description="Beside warp, alike.",
        examples=[
            {
                "modulus": "520 N/cm",
                "poisson": 0.45,
                "yarns": "2.4 /cm",
                "yarn_bending": "0.6 N mm^2",
            }
        ],
    )
    shear: ShearTable | None = Field(
        default=None,
        description="Beside warp and weft, or in place of the library's.",
        examples=[{"modulus": "0.96 N/cm"}],
    )
    tension: TensionTable | None = Field(
        default=None,
        description="Which strain, and yarns in compression; in place of the library's.",
        examples=[{"strain": "log", "compression": 0.01}],
    )
    areal_density: Annotated[str, _quantity("kg/m**2")] | None = Field(
        default=None,
        description="Mass of the yarns per area. For exports (docs/exports.md).",
        examples=["576 g/m^2"],
    )
    thickness: Annotated[str, _quantity("m")] | None = Field(
        default=None,
        description="Of the cloth at rest. For exports and scene.png.",
        examples=["0.5 mm"],
    )
    fibre_density: Annotated[str, _quantity("kg/m**3")] | None = Field(
        default=None,
        description="Of what the yarns consist of. For exports.",
        examples=["2.5 g/cm^3"],
    )

    @model_validator(mode="after")
    def _one_way(self) -> FabricTable:
        given = [key for key in ("warp", "weft") if getattr(self, key) is not None]
        if self.use is not None and given:
            raise ValueError(
                f"needs either use or warp, weft and shear, not use and {' and '.join(given)} "
                "(beside use only shear, tension, areal_density, thickness and fibre_density may "
                "stand)"
            )
        missing = [key for key in ("warp", "weft", "shear") if getattr(self, key) is None]
        if self.use is None and missing:
            raise ValueError(
                f"needs use, or warp, weft and shear ({' and '.join(missing)} missing)"
            )
        return self


class OutlineTable(_Table):
    """[preform] outline: a rectangle (width, length), or a polygon with holes."""

    rectangle: Point | None = Field(
        default=None,
        description="Width and length. x from -width/2 to width/2, y from 0 to the length.",
        examples=[["100 mm", "200 mm"]],
    )
    polygon: Ring | None = Field(
        default=None,
        description="Corners in order, in place of a rectangle. The body is pulled along y.",
        examples=[[["0 mm", "0 mm"], ["80 mm", "0 mm"], ["80 mm", "90 mm"], ["0 mm", "90 mm"]]],
    )
    holes: list[Ring] = Field(
        default=[],
        description="Corners of each hole.",
        examples=[[[["20 mm", "30 mm"], ["40 mm", "30 mm"], ["30 mm", "50 mm"]]]],
    )

    @model_validator(mode="after")
    def _one_shape(self) -> OutlineTable:
        if (self.rectangle is None) == (self.polygon is None):
            raise ValueError("needs exactly one of rectangle and polygon")
        return self


class PreformTable(_Table):
    """[preform]: see `Preform`."""

    outline: OutlineTable = Field(
        description="A rectangle, or a polygon with holes.",
        examples=[{"rectangle": ["100 mm", "200 mm"]}],
    )
    bias_angle: Annotated[str, _quantity("rad")] = Field(
        description="From the pull (y) to the warp.", examples=["45 deg"]
    )
    refine: Count = Field(
        default=1, description="A finer net of the same fabric: pitch divided by this."
    )
    yarns_per_cruciform: Count = Field(
        default=1, description="A coarser net: pitch times this. Not together with refine."
    )
    origin: Point | None = Field(
        default=None,
        description="A crossover's place. The default is the centre of the outline's bounding box.",
        examples=[["0 mm", "100 mm"]],
    )


class TestTable(_Table):
    """[test]: what all kinds of experiments share.

    Every kind prescribes one value or a list of them, of one of its `controls`.
    """

    __test__: ClassVar[bool] = False  # not a test for pytest
    controls: ClassVar[dict[str, str]] = {"extension": "m", "load": "N"}  # key -> SI unit
    along_the_yarns: ClassVar[bool] = False  # needs a rectangle whose sides the yarns follow

    kind: str = Field(description="Which experiment.")
    finite: bool = Field(
        default=False, description="Large displacements, rotations and shear angles."
    )
    bending: bool = Field(
        default=True, description="Yarns bend in the plane; false: they are hinged."
    )
    increments: Count | None = Field(
        default=None,
        description="Least number of steps to the last value, with finite = true. "
        "Steps are cut further where needed.",
        examples=[20],
    )

    @model_validator(mode="after")
    def _one_control(self) -> TestTable:
        given = [key for key in self.controls if getattr(self, key) is not None]
        if len(given) != 1:
            got = "both" if given else "neither"
            raise ValueError(f"needs exactly one of {' and '.join(self.controls)}, got {got}")
        return self

    @property
    def control(self) -> str:
        """Key of what is prescribed: "extension", "load", "angle" or "strain"."""
        return next(key for key in self.controls if getattr(self, key) is not None)

    @property
    def is_curve(self) -> bool:
        """Whether a list was given, so that results are lists."""
        return isinstance(getattr(self, self.control), list)

    @property
    def values_si(self) -> list[float]:
        """Prescribed values, one or more [m, N, rad or 1]."""
        value = getattr(self, self.control)
        values = value if isinstance(value, list) else [value]
        return to_si(values, self.controls[self.control], f"test.{self.control}")


_EXTENSION = Field(
    default=None,
    description="By which the upper edge is pulled, one value or a list. Either this or load.",
    examples=["10 mm"],
)
_LOAD = Field(
    default=None,
    description="Force on the upper edge, one value or a list. Either this or extension.",
    examples=["0.5 N"],
)


class BiasExtensionTest(TestTable):
    """A strip clamped at its lower edge and pulled at its upper one."""

    kind: Literal["bias-extension"] = "bias-extension"
    upper: Literal["grip", "centre-line"] = Field(
        default="grip",
        description="What the upper edge is: a clamp, or the middle of a whole specimen.",
    )
    extension: Annotated[str | list[str], _quantities("m")] | None = _EXTENSION
    load: Annotated[str | list[str], _quantities("N")] | None = _LOAD
    model: Literal["coupled", "separate"] = Field(
        default="coupled",
        description="One system, or the paper's three. Separate for small displacements only.",
    )

    @model_validator(mode="after")
    def _small(self) -> BiasExtensionTest:
        if self.finite and self.model == "separate":
            raise ValueError(
                'has model = "separate" and finite = true, but the separate systems are for small '
                "displacements only"
            )
        return self


class _OneSystemTest(TestTable):
    """Kinds without the choices of bias extension: one system, gripped edges."""

    @property
    def model(self) -> Literal["coupled"]:
        """All modes of deformation in one system."""
        return "coupled"

    @property
    def upper(self) -> Literal["grip"]:
        """The upper edge is gripped."""
        return "grip"


class PantographTest(_OneSystemTest):
    """A sheet of beams and pivots, gripped at both ends and pulled."""

    controls: ClassVar[dict[str, str]] = {"extension": "m"}

    kind: Literal["pantograph"]
    extension: Annotated[str | list[str], _quantities("m")] = Field(
        description="By which the upper edge is pulled, one value or a list.", examples=["10 mm"]
    )


class OffAxisTensionTest(_OneSystemTest):
    """A strip pulled at some angle to its yarns; free ends may contract and shear."""

    kind: Literal["off-axis-tension"]
    extension: Annotated[str | list[str], _quantities("m")] | None = _EXTENSION
    load: Annotated[str | list[str], _quantities("N")] | None = _LOAD
    ends: Literal["grip", "free"] = Field(
        default="grip", description="Clamped, or free to contract and to slide across the pull."
    )


class PictureFrameTest(_OneSystemTest):
    """A rectangle sheared by a hinged frame."""

    controls: ClassVar[dict[str, str]] = {"angle": "rad"}
    along_the_yarns: ClassVar[bool] = True

    kind: Literal["picture-frame"]
    angle: Annotated[
        str | list[str],
        _quantities("rad", lambda a: abs(a) < 0.5 * math.pi, "between -90 deg and 90 deg"),
    ] = Field(
        description="Shear angle of the frame, one value or a list. Between -90 and 90 deg.",
        examples=["20 deg"],
    )


class BiaxialTest(_OneSystemTest):
    """A rectangle stretched along both yarns."""

    controls: ClassVar[dict[str, str]] = {"strain": "1"}
    along_the_yarns: ClassVar[bool] = True

    kind: Literal["biaxial"]
    strain: Annotated[str | list[str], _quantities("1", lambda e: e > -1.0, "more than -100 %")] = (
        Field(description="Of the warp, one value or a list. More than -100 %.", examples=["1 %"])
    )
    ratio: Number = Field(default=1.0, description="Weft strain over warp strain.")

    @model_validator(mode="after")
    def _both_lengths_positive(self) -> BiaxialTest:
        for strain in self.strain_weft_si:
            if not -1.0 < strain < math.inf:
                raise ValueError(
                    f"prescribes a weft strain (strain times ratio) of {format_si(strain, '1')}, "
                    "it must be finite and more than -100 %"
                )
        return self

    @property
    def strain_weft_si(self) -> list[float]:
        """Stretch of the weft less 1, one or more."""
        return [self.ratio * strain for strain in self.values_si]


class CantileverTest(_OneSystemTest):
    """A strip clamped at its lower edge, bent in its plane by a load across its upper one."""

    controls: ClassVar[dict[str, str]] = {"load": "N"}
    along_the_yarns: ClassVar[bool] = True

    kind: Literal["cantilever"]
    load: Annotated[str | list[str], _quantities("N")] = Field(
        description="Across the upper edge, one value or a list.", examples=["1 mN"]
    )

    @model_validator(mode="after")
    def _bends(self) -> CantileverTest:
        if not self.bending:
            raise ValueError('has kind = "cantilever", which needs bending = true')
        return self


def _kind(value: Any) -> str:
    """Tell which of the kinds a [test] table is."""
    if not isinstance(value, dict):
        return str(getattr(value, "kind", "bias-extension"))
    kind = value.get("kind", "bias-extension")
    return kind if isinstance(kind, str) else ""


AnyTest = Annotated[
    Annotated[BiasExtensionTest, Tag("bias-extension")]
    | Annotated[PictureFrameTest, Tag("picture-frame")]
    | Annotated[OffAxisTensionTest, Tag("off-axis-tension")]
    | Annotated[BiaxialTest, Tag("biaxial")]
    | Annotated[CantileverTest, Tag("cantilever")]
    | Annotated[PantographTest, Tag("pantograph")],
    Discriminator(_kind),
]


class ContinuumTable(_Table):
    """[continuum]: the membrane to compare with.

    ``second_gradient``: whether it resists the bending of yarns; None: if they do in the network
    (`Case.second_gradient`).
    """

    compare: bool = Field(
        default=False, description="Solve a membrane in dolfinx, too, and compare."
    )
    second_gradient: bool | None = Field(
        default=None,
        description="Whether the membrane resists the bending of yarns. "
        "The default: where the network does and test.finite = true.",
        examples=[True],
    )
    mesh_size: Annotated[Length, AfterValidator(_positive_length)] | None = Field(
        default=None,
        description="Of the membrane. The default is the program's choice.",
        examples=["5 mm"],
    )
    ladder: Counts | None = Field(
        default=None,
        description="Compare finer and finer nets: values of refine.",
        examples=[[1, 2, 4]],
    )

    @property
    def mesh_size_si(self) -> float | None:
        """Mesh size [m], or None for the program's choice."""
        return None if self.mesh_size is None else parse(self.mesh_size, "m")


class SolverTable(_Table):
    """[solver]: PETSc options, put under the solver's prefix."""

    options: Annotated[dict[str, str | int | float | bool], PlainValidator(_petsc_options)] = Field(
        default={},
        description="PETSc options of the network's solver. Without dash and prefix. Settings of "
        "solvers only: nothing that could run code or write files.",
        examples=[{"ksp_type": "cg", "ksp_rtol": 1e-9}],
    )


class OutputTable(_Table):
    """[output]: where results go, and which."""

    directory: Annotated[str, Field(min_length=1)] = Field(
        default="results", description="Folder of the results, made if it is not there."
    )
    pictures: bool = Field(default=True, description="Figures of the result.")
    scene: bool = Field(
        default=False, description="scene.png, the woven yarns in space, drawn with PyVista."
    )
    paraview: bool = Field(default=True, description="network.vtkhdf for ParaView.")
    exports: bool = Field(
        default=False,
        description="crossovers.csv and preform.inp for other codes (docs/exports.md).",
    )
    report: bool | None = Field(
        default=None,
        description="report.html, one page with everything; by default if pictures are on.",
        examples=[True],
    )
    measured: Annotated[str, Field(min_length=1)] | None = Field(
        default=None,
        description="CSV file of a measured displacement and force to compare the load with; in a "
        "case file, relative to its folder.",
        examples=["measured.csv"],
    )

    @property
    def wants_report(self) -> bool:
        """Whether report.html is written."""
        return self.pictures if self.report is None else self.report


class Case(_Table):
    """A whole case file, checked.

    The tables are the attributes ``title, fabric_table, preform_table, test, continuum, solver,
    output``; the objects they describe come from `fabric` and `preform`.
    """

    title: str = Field(default="untitled", description="What the case is; heads log and figures.")
    fabric_table: FabricTable = Field(alias="fabric", description="The cloth.")
    preform_table: PreformTable = Field(alias="preform", description="What was cut from it.")
    test: AnyTest = Field(description="What is done to it.")
    continuum: ContinuumTable = Field(
        default=ContinuumTable(), description="The membrane beside it."
    )
    solver: SolverTable = Field(default=SolverTable(), description="Options of the solver.")
    output: OutputTable = Field(default=OutputTable(), description="What is written, and where.")

    @classmethod
    def load(cls, path: str | Path, overrides: Sequence[str] = ()) -> Case:
        """Read and check a case file.

        Parameters
        ----------
        path : str or Path
            A TOML file.
        overrides : sequence of str
            "preform.refine=4": the value is read as TOML, or taken as a string if it is none.

        Returns
        -------
        Case

        Raises
        ------
        InputError
            Anything wrong with the file, its keys and values, the fabric, the outline, or the
            edges the test needs.
        """
        data = _read(Path(path))
        output = data.get("output")
        measured = output.get("measured") if isinstance(output, dict) else None
        if isinstance(output, dict) and measured and isinstance(measured, str):
            # As a path that a resumed run, or one in another folder, still finds.
            output["measured"] = str((Path(path).parent / measured).absolute())
        for override in overrides:
            _apply(data, override)
        case = cls.from_data(data)
        case._check_together()
        return case

    @classmethod
    def load_collective(
        cls, comm: MPI.Intracomm, path: str | Path, overrides: Sequence[str] = ()
    ) -> Case:
        """Read on rank 0 only; every rank returns the same case or raises the same InputError."""
        return on_root(comm, lambda: cls.load(path, overrides))

    @classmethod
    def from_data(cls, data: dict[str, Any]) -> Case:
        """Check plain data as it stands in a case file; InputError tells up to three problems."""
        try:
            return cls.model_validate(data)
        except ValidationError as error:
            problems = list(dict.fromkeys(_sentence(cls, dict(e)) for e in error.errors()))
            more = len(problems) - _MOST_PROBLEMS
            tail = f"; and {more} more" if more > 0 else ""
            raise InputError("; ".join(problems[:_MOST_PROBLEMS]) + tail) from None

    def fabric(self) -> Fabric:
        """Make the fabric."""
        data = self.fabric_table.model_dump(exclude_none=True)
        name = data.pop("use", None)
        if name is None:
            return Fabric.from_table(self.title, data)
        try:
            Fabric.from_library(name)
        except InputError as error:
            raise InputError(f"fabric.use: {error}") from None
        return Fabric.from_library(name, data)

    def preform(self, refine: int | None = None) -> Preform:
        """Make the preform; `refine` replaces the case's (for a ladder)."""
        table = self.preform_table
        outline = table.outline
        options: dict[str, Any] = {
            "refine": table.refine if refine is None else refine,
            "yarns_per_cruciform": table.yarns_per_cruciform,
            "origin": table.origin,
        }
        if outline.polygon is not None:
            return Preform.polygon(outline.polygon, outline.holes, table.bias_angle, **options)
        assert outline.rectangle is not None  # OutlineTable has seen to it
        width, length = outline.rectangle
        return Preform.rectangle(width, length, table.bias_angle, holes=outline.holes, **options)

    @property
    def second_gradient(self) -> bool:
        """Whether the continuum resists the bending of yarns: as told, else as the network does."""
        told = self.continuum.second_gradient
        return self.test.finite and self.test.bending if told is None else told

    def model_dump(self, **options: Any) -> dict[str, Any]:
        """Return the case as plain data with the case file's own keys; JSON can hold it."""
        plain: dict[str, Any] = {"by_alias": True, "mode": "json"}
        return super().model_dump(**(plain | options))

    def _check_together(self) -> None:
        """Check what no single table can know."""
        fabric, preform = self.fabric(), self.preform()
        preform.check_size(fabric)
        for edge in ("lower", "upper"):  # without a clamp the body would float
            try:
                preform.edge(edge)
            except InputError as error:
                raise InputError(f'test.kind = "{self.test.kind}": {error}') from None
        if self.test.along_the_yarns:
            self._check_along_the_yarns(preform)
        if self.test.bending:
            for side in ("warp", "weft"):
                if getattr(fabric, side).yarn_bending == 0.0:
                    raise InputError(
                        f"test.bending is true but fabric.{side}.yarn_bending is zero, "
                        "give it a value or set test.bending = false"
                    )
        if self.continuum.second_gradient:
            for key in ("finite", "bending"):
                if not getattr(self.test, key):
                    raise InputError(f"continuum.second_gradient = true needs test.{key} = true")
        if self.continuum.ladder is not None and preform.yarns_per_cruciform > 1:
            raise InputError(
                "continuum.ladder refines the network, so preform.yarns_per_cruciform must be 1, "
                f"got {preform.yarns_per_cruciform}"
            )

    def _check_along_the_yarns(self, preform: Preform) -> None:
        kind = f'test.kind = "{self.test.kind}"'
        exterior = shapely.Polygon(preform.outline.exterior)
        box = shapely.box(*exterior.bounds)
        if exterior.symmetric_difference(box).area > 1e-9 * box.area:
            raise InputError(f"{kind} needs preform.outline to be a rectangle with upright sides")
        if abs(math.sin(2.0 * preform.bias_angle)) > 1e-9:
            raise InputError(
                f'{kind} needs yarns along the edges: preform.bias_angle = "0 deg" or "90 deg", '
                f'got "{self.preform_table.bias_angle}"'
            )


def _read(path: Path) -> dict[str, Any]:
    """Read TOML; every way this can fail is one sentence."""
    try:
        return tomllib.loads(path.read_bytes().decode("utf-8"))
    except FileNotFoundError:
        folder = path.parent
        near = [p.name for p in folder.glob("*.toml")] if folder.is_dir() else []
        close = get_close_matches(path.name, near, 1)
        hint = f', did you mean "{folder / close[0]}"?' if close else ""
        raise InputError(f'case file "{path}" does not exist{hint}') from None
    except IsADirectoryError:
        raise InputError(f'case file "{path}" is a folder, name a TOML file in it') from None
    except OSError as error:
        raise InputError(f'case file "{path}" cannot be read: {error.strerror}') from None
    except UnicodeDecodeError as error:
        raise InputError(
            f'case file "{path}" is not UTF-8 text (byte {error.start + 1}), save it as UTF-8'
        ) from None
    except ValueError as error:  # TOML errors, and a null byte in the path
        raise InputError(f'case file "{path}" is not TOML: {error}') from None


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
    for i, key in enumerate(keys[:-1]):
        table = table.setdefault(key, {})
        if not isinstance(table, dict):
            raise InputError(
                f'--set "{override}": {".".join(keys[: i + 1])} is a value, not a table'
            )
    table[keys[-1]] = setting


def _models(annotation: Any) -> list[type[BaseModel]]:
    """Find the tables in a field's type, through Optional and Annotated."""
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        return [annotation]
    if get_origin(annotation) in (Union, types.UnionType, Annotated, list):
        return [model for part in get_args(annotation) for model in _models(part)]
    return []


def _known_keys(model: type[BaseModel], path: Sequence[str | int]) -> list[str]:
    """Return the keys of the table at a place in the case, a kind of test included."""
    models = [model]
    for part in path:
        if len(models) > 1:
            models = [m for m in models if str(part) in get_args(m.model_fields["kind"].annotation)]
        else:
            fields = {f.alias or name: f for name, f in models[0].model_fields.items()}
            models = _models(fields[str(part)].annotation)
    return [f.alias or name for name, f in models[0].model_fields.items()]


# What pydantic's error types ask for, in plain words.
_WANTED = {
    "string_type": "a text in quotes",
    "string_too_short": "a name that is not empty",
    "bool_type": "true or false",
    "int_type": "a whole number",
    "greater_than_equal": "a whole number from 1 up",
    "float_type": "a number",
    "finite_number": "a finite number",
    "list_type": "a list",
    "model_type": "a table",
}


def _sentence(model: type[BaseModel], error: dict[str, Any]) -> str:
    """Turn one of pydantic's errors into plain words that name the key."""
    loc, kind, got = error["loc"], error["type"], error["input"]
    context = error.get("ctx", {})
    # pydantic puts the kind of test behind "test"
    parts = loc[:1] + loc[2:] if loc[:1] == ("test",) else loc
    key = "".join(f"[{part}]" if isinstance(part, int) else f".{part}" for part in parts)[1:]
    wanted = _WANTED.get(kind)
    if wanted is not None:
        text = f"{key} must be {wanted}, got {shown(got, 60)}"
    elif kind == "missing":
        text = f"{key} is missing"
    elif kind == "value_error":
        text = f"{key} {context['error']}"
    elif kind == "union_tag_invalid":
        *most, last = context["expected_tags"].replace("'", '"').split(", ")
        text = f"{key}.kind must be {', '.join(most)} or {last}, got {shown(got['kind'])}"
    elif kind == "literal_error":
        known_values = context["expected"].replace("'", '"')
        text = f"{key} must be {known_values}, got {shown(got, 60)}"
    elif kind in ("too_short", "too_long"):
        limit = context.get("min_length", context.get("max_length"))
        length = f"{limit}" if limit == 2 else f"at least {limit}"  # pairs are exact
        text = f"{key} must be a list of {length}, got {context['actual_length']}"
    elif kind == "extra_forbidden":
        table = key.rpartition(".")[0]
        known = _known_keys(model, loc[:-1])
        close = get_close_matches(str(loc[-1]), known, 1)
        hint = f'did you mean "{close[0]}"?' if close else f"known: {', '.join(known)}"
        where = f"[{table}] has" if table else "the case file has"
        text = f'{where} the unknown key "{loc[-1]}" ({hint})'
    else:
        text = f"{key}: {error['msg']}"
    return text
