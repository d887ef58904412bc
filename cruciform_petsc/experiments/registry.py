# SPDX-License-Identifier: MIT
"""The kinds of test by the names that case files give them: the one list of them."""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

from pydantic_core import PydanticKnownError

from ..errors import InputError, shown, unknown

if TYPE_CHECKING:
    from .table import KindTable

# A class, or where it stands, from this folder: kinds are imported when they are needed, and PETSc
# with them, so that the command line can hand PETSc its options first.
KINDS: dict[str, str | type] = {
    "bias-extension": "bias_extension.BiasExtension",
    "picture-frame": "picture_frame.PictureFrame",
    "off-axis-tension": "off_axis.OffAxisTension",
    "biaxial": "biaxial.Biaxial",
    "biaxial-load": "biaxial_load.BiaxialLoad",
    "cantilever": "cantilever.Cantilever",
    "pantograph": "pantograph.Pantograph",
    "pull-out": "pull_out.PullOut",
    "forming": ".forming.kind.Forming",
    "fishnet": ".forming.draping.Draping",
    "drape": ".forming.drape.Drape",
    "inflation": ".forming.inflation.Inflation",
}
DEFAULT = "bias-extension"


def in_space(kind: object) -> bool:
    """Whether a kind of test is a forming, or a fishnet: cloth that lies in space."""
    entry = KINDS.get(kind) if isinstance(kind, str) else None
    return isinstance(entry, str) and entry.startswith(".forming.")


def forms(kind: object) -> bool:
    """Whether a kind of test is a forming: one in space, in stages, from tools or loads."""
    return in_space(kind) and kind != "fishnet"


def kind_class(kind: str) -> Any:
    """The class of a kind of test, with its `table`; an InputError if there is none."""
    if kind not in KINDS:
        raise unknown(f'kind of test "{kind}"', kind, KINDS)
    entry = KINDS[kind]
    if not isinstance(entry, str):
        return entry
    module, _, name = entry.rpartition(".")
    return getattr(import_module(f".{module}", __package__), name)


def every_table() -> list[type[KindTable]]:
    """All that [test] can be."""
    return [kind_class(kind).table for kind in KINDS]


def pick_table(data: Any) -> type[KindTable]:
    """The type of table that [test] is, for `fields.OneOf`."""
    if not isinstance(data, dict):
        raise PydanticKnownError("model_type", {"class_name": "test"})
    kind = data.get("kind", DEFAULT)
    try:
        return kind_class(kind if isinstance(kind, str) else shown(kind)).table
    except InputError as error:
        raise ValueError(f".kind: {error}") from None
