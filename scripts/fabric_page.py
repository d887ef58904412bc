# SPDX-License-Identifier: MIT
"""Write docs/fabrics.md, the page of the library's fabrics, from cloth/fabrics.toml.

scripts/fenicsx python3 scripts/fabric_page.py
"""

from __future__ import annotations

from pathlib import Path

from cruciform_petsc import Fabric
from cruciform_petsc.cloth.fabric import FabricTable, LibraryTable, library
from cruciform_petsc.units import format_si

PAGE = Path(__file__).parents[1] / "docs" / "fabrics.md"

_HEAD = """# The library of fabrics

Generated from `cruciform_petsc/cloth/fabrics.toml` by `scripts/fabric_page.py`; a test fails when
this page is stale. `[fabric] use = "NAME"` takes one, keys beside it replace what you have
measured; `cruciform-petsc fabrics NAME`, `check`, the log, `summary.json` (`fabric`) and the
report tell what of it is estimated or assumed.

**Only three have a measured or published stiffness**: the paper's E glass, the pantographic
sheet, and the glass/PP plain weave, whose shear was identified from a published bias test. Of the
others the construction is published, and all that rules their deformation is estimated from it
([datasheet.md](datasheet.md)) or assumed, shear above all: measure it before you rely on a
result. Constructions marked so were quoted without the source at hand; a test compares their
yarns with their mass, and nothing more.
"""


def page() -> str:
    """The whole page."""
    return "\n".join([_HEAD, *(_fabric(name, entry) for name, entry in library().items())])


def _fabric(name: str, entry: LibraryTable) -> str:
    fabric = Fabric.from_library(name)
    sides, laws = (fabric.warp, fabric.weft), fabric.out_of_plane("this page")
    rows = [
        ("modulus", [_short(side.modulus, "N/m") for side in sides]),
        ("Poisson's ratio", [f"{side.poisson:g}" for side in sides]),
        ("yarns", [_short(side.yarns, "1/m") for side in sides]),
        ("bending of a yarn", [_short(side.yarn_bending, "N*m**2") for side in sides]),
        ("bending out of the plane", [_short(law.stiffness0, "N*m") for law in laws]),
    ]
    whole = {
        "weave": fabric.weave,
        "shear": f"{_short(fabric.shear_modulus, 'N/m')}"
        + ("" if fabric.shear.name == "linear" else f" at rest, a {fabric.shear.name}"),
        "mass": _short(fabric.areal_density, "kg/m**2"),
        "thickness": _short(fabric.thickness, "m"),
    }
    assumed = FabricTable.from_data({"use": name}, "fabric").filled_in()
    return "\n".join([
        f"## {name}\n\n{' '.join(entry.notes.split())}\n\nSource: {entry.source}\n",
        "| | warp | weft |\n|---|---|---|",
        *(f"| {what} | {warp} | {weft} |" for what, (warp, weft) in rows),
        "",
        ", ".join(f"{what} {value}" for what, value in whole.items() if value) + ".\n",
        "Estimated or assumed:\n",
        *(f"- {sentence}" for sentence in assumed),
        "",
    ])  # fmt: skip


def _short(value: float | None, unit: str) -> str:
    return "" if value is None else format_si(float(f"{value:.4g}"), unit)


if __name__ == "__main__":
    PAGE.write_text(page(), encoding="utf-8")
