# SPDX-License-Identifier: MIT
"""What a user should know before trusting a result: where laws and assumptions end."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from ..parallel import least, most
from ..quantities import si_text
from .net_kinematics import net_reach

if TYPE_CHECKING:
    from .result import TestResult

SMALL_DEG = 5.0  # shear angle to which small displacements hold, as a rule
BREAKING = 0.1  # strain; glass and carbon break at a few hundredths


def warnings(result: TestResult) -> list[str]:
    """Sentences about a result. Collective."""
    largest = float(result.shear_angles_max.max())
    return _finite(result, largest) if result.experiment.finite else _small(result, largest)


def beyond_small(angle: float, cure: str) -> str:
    """What there is to say of small displacements with a shear angle (rad) beyond SMALL_DEG."""
    return (
        f"the shear angle reaches {np.rad2deg(angle):.1f} deg; small displacements hold to some "
        f"{SMALL_DEG:g} deg ({cure})"
    )


def _small(result: TestResult, largest: float) -> list[str]:
    fabric, sentences = result.network.fabric, []
    if largest > np.deg2rad(SMALL_DEG):
        sentences.append(beyond_small(largest, "set test.finite = true"))
    laws = {
        "shear law": fabric.shear_law,
        "warp's law of tension": fabric.warp_law,
        "weft's law of tension": fabric.weft_law,
    }
    left_out = [what for what, law in laws.items() if law is not None and law.name != "linear"]
    left_out += ["softening in compression"] if fabric.compression < 1.0 else []
    if left_out:
        sentences.append(
            "at small displacements only the moduli at rest act, not the "
            f"{' and the '.join(left_out)} (test.finite = true takes the laws)"
        )
    return sentences


def _finite(result: TestResult, largest: float) -> list[str]:
    experiment, fabric, comm = result.experiment, result.network.fabric, result.network.comm
    sentences = []
    last = fabric.shear.last_point
    if largest > last:
        sentences.append(
            f"the shear angle reaches {np.rad2deg(largest):.1f} deg, beyond the last point of the "
            f"shear law's table at {np.rad2deg(last):.1f} deg, where the law goes straight on"
        )
    gauge = experiment.net_gauge()
    if gauge is not None and result.controls.max() > net_reach(gauge):
        sentences.append(
            f"beyond an extension of {si_text(net_reach(gauge), 'm')}, where yarns that do not "
            "stretch lie along the pull, the load is that of stretched yarns"
        )
    strains = [state.fields["arm_strain"] for state in result.states]
    shortest = least(comm, [strain.min(initial=0.0) for strain in strains], 0.0)
    longest = most(comm, [strain.max(initial=0.0) for strain in strains], 0.0)
    # The strain at which yarns of cloth give way, as a rule (docs/laws.md).
    if fabric.compression == 1.0 and shortest < -fabric.compression_width:
        sentences.append(
            f"yarns are compressed by up to {-100 * shortest:.2g} % and carry that like tension; "
            "those of a cloth buckle (fabric.tension.compression = 0.01 softens them)"
        )
    cuts = [increment for increment in result.increments if increment.cuts]
    if cuts:
        sentences.append(
            f"steps were cut in half {sum(increment.cuts for increment in cuts)} times where no "
            f"equilibrium was found, first before {experiment.column.text(cuts[0].control)}; "
            "what follows may be another branch than that of smaller steps"
        )
    if longest > BREAKING:
        sentences.append(
            f"yarns are stretched by up to {100 * longest:.3g} %, which hardly any yarn stands; "
            "the laws of tension know no rupture"
        )
    return sentences
