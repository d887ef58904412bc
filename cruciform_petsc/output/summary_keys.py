# SPDX-License-Identifier: MIT
"""What summary.json may have, for those who read it with other programs.

`cruciform-petsc schema summary` prints it as a JSON schema. Keys are told in the texts below them;
columns of a test's curve, in small letters, have their words in docs/files.md.
"""

from __future__ import annotations

from typing import Any

from pydantic import BaseModel, ConfigDict

from ..quantities import UNITS

Number = float | None  # null: not a number
Values = Number | list[Number]  # a list where the case asked for a list
Vector = list[float]
# Columns and figures that depend on the kind of test: their names end with the unit.
_ENDS = sorted({tail.lower()[1:] for tail in UNITS} | {"m", "n", "j", "n_per_cm"}, key=len)
OTHERS = rf"_(?:{'|'.join(_ENDS)})$"
_NUMBER: Any = {"type": ["number", "null"]}
_VALUES: Any = {"anyOf": [_NUMBER, {"type": "array", "items": _NUMBER}]}


class Part(BaseModel):
    """A table in a summary; further figures may come."""

    model_config = ConfigDict(
        extra="allow", strict=True, allow_inf_nan=False, use_attribute_docstrings=True
    )


class Tension(Part):
    """Largest tension of a yarn in the last state."""

    n: float
    """N per yarn."""
    n_99: float
    """Up to which 99 % of the area goes."""
    family: str
    """warp or weft."""
    at_mm: Vector | None
    """Where, at rest; null if it is that large on more than half of the cloth."""


class ClosedForm(Part):
    """The last load beside that of yarns that neither stretch nor bend (docs/sweeps.md)."""

    load_n: float
    """In closed form."""
    load_ratio: float
    """Computed over that."""
    shear_deg: float | None = None
    """Of an inextensible net's middle zone, from the displacement."""
    middle_5_deg: float | None = None
    """Computed shear that 5 % of the middle zone stay below."""
    middle_95_deg: float | None = None
    """And 95 %."""
    sentence: str
    """Both in words, and why they differ."""


class Stability(Part):
    """Critical loads: the control of the test in its unit, and load_n, of each."""

    linear: list[dict[str, float]]
    """Of the linearised problem from rest, one for each mode."""
    critical: list[dict[str, float]]
    """Passed on the way, in order."""
    mode_stiffness_pa_per_mm: list[float]
    """What holds the modes at the first critical state; at rest where none was passed."""


class Network(Part):
    """Sizes of the network."""

    crossovers: int
    nodes: int
    """Arm ends."""
    warp_yarns: int
    weft_yarns: int
    covered_area_m2: float
    """Of cruciforms within the outline."""
    outline_area_m2: float
    imbalance: float
    """Largest share of a process over the mean."""
    cut_yarns: int
    """Between processes."""
    hanging_crossovers: int | None = None
    """That hang on by one arm end and carry nothing."""


class Summary(Part):
    """summary.json, of a run of any kind of test."""

    model_config = ConfigDict(json_schema_extra={"patternProperties": {OTHERS: _VALUES}})

    title: str
    kind: str
    """Of test, as in the case."""
    finite: bool
    """Finite deformation; false: small displacements."""
    ended_early: str | None = None
    """Why a test did not come to its end, in a sentence; what follows is of what was reached."""
    warnings: list[str] = []
    """What is to be known before the results are used."""
    case: dict[str, Any]
    """The case that was run, as a case file has it."""
    date: str
    """Of the end of the run, ISO 8601."""
    versions: dict[str, str]
    """Of the program and of what it stands on."""
    commit: str | None
    """Of the program, where it runs from a clone."""
    ranks: int
    """Processes."""
    wall_s: dict[str, float]
    """Seconds of the stages of the run, and in all."""
    peak_mib_per_rank: list[float]
    """Largest memory of each process, MiB."""
    crossovers: int | None = None
    dofs: int | None = None
    """Unknowns."""
    network: Network | None = None
    model: str | None = None
    """coupled, or separate: the paper's three systems."""
    bending: bool | None = None
    """Whether yarns resist bending in the plane."""
    energy_j: dict[str, Values] | None = None
    """By mode, J."""
    yarn_tension_max: Tension | None = None
    closed_form: ClosedForm | None = None
    stability: Stability | None = None
    """Where the cloth becomes unstable (docs/stability.md)."""
    solver: dict[str, Any] | None = None
    """PETSc's types, iterations, residuals."""
    increments: list[dict[str, Any]] | None = None
    """All that were accepted: control in SI, forces, effort."""
    newton_iterations_per_increment: float | None = None
    resumed_after_increments: int | None = None
    resumed_after_steps: int | None = None
    """How much was there when an interrupted run went on."""
    uncarried_share_of_load: dict[str, float] | None = None
    """Of the paper's separate systems: what each mode cannot carry by itself."""
    without_bending: dict[str, Number] | None = None
    """The last state of a test at small displacements without yarn bending."""
    measured: dict[str, Any] | None = None
    """Load against measured data: file, points, differences relative to what was measured."""
    continuum: dict[str, Any] | None = None
    """The membrane beside the network."""
    uniform_maps: dict[str, str] | None = None
    """Sentences in place of maps that are the same all over, by the name of the picture."""
    fabric: dict[str, Any] | None = None
    """What the cloth's data say, and what is assumed."""
    stages: list[dict[str, Any]] | None = None
    """Of a forming: name, steps, Newton steps, seconds."""
    fishnet: dict[str, Any] | None = None
    """Of a fishnet, or a forming that begins with one: tool, seed on the flat blank and in space,
    how its yarns run there, energy of shear, what was sought for the least of it."""
    shear_max_at_mm: dict[str, Vector] | None = None
    """Of a fishnet: where it shears most, on the flat blank and in space."""
    contact: dict[str, float] | None = None
    """Of a forming: what contact was computed with, SI units in the names."""
    tool_force_n: dict[str, Vector] | None = None
    """Force of each tool on the cloth: x, y, z."""
    tool_place_mm: dict[str, Vector] | None = None
    tool_moment_n_m: dict[str, Vector] | None = None
    work_of_loads_j: dict[str, float] | None = None
    """Of gravity and the like."""
    draw_in_mm: dict[str, float] | None = None
    """How far each edge has moved inwards, at most."""
    wrinkles: dict[str, Any] | None = None
    bridging: dict[str, Any] | None = None
    """See docs/files.md."""
    plies: list[dict[str, Any]] | None = None
    """Of several plies: shear, wrinkles, compaction of each, and what its files' names end with."""
    between_plies: dict[str, dict[str, float]] | None = None
    """Of plies that touch: largest compaction, pressure, way slid."""
    symmetry: dict[str, Any] | None = None
    clamps: dict[str, Any] | None = None
    """Of a forming: what planes of symmetry and clamps hold."""
    inflation: dict[str, Any] | None = None
    """Of an inflation: rise, volume, tensions by pressure (docs/forming.md)."""
    drape: dict[str, Any] | None = None
    """Of a drape test: coefficient, folds (docs/forming.md)."""

    @classmethod
    def json_schema(cls) -> dict[str, Any]:
        """JSON schema of summary.json."""
        head = {"$schema": "https://json-schema.org/draft/2020-12/schema"}
        return head | cls.model_json_schema() | {"title": "summary.json"}
