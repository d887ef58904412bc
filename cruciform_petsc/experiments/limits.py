# SPDX-License-Identifier: MIT
"""What a user should know: input that is hardly meant, and where laws and assumptions end."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING

import numpy as np

from ..cloth.fabric import Fabric
from ..cloth.preform import LARGE, Preform
from ..laws import Potential
from ..net.network import Network
from ..parallel import least, most
from ..quantities import si_text
from ..solvers.options import unused_options
from ..tension import BiaxialLaw
from .net_kinematics import net_reach
from .table import KindTable, TestTable

if TYPE_CHECKING:
    from .result import TestResult

SMALL_DEG = 5.0  # shear angle to which small displacements hold, as a rule
BREAKING = 0.1  # strain; glass and carbon break at a few hundredths
SLENDER = 50.0  # length over width, or the reverse


def remarks(preform: Preform, fabric: Fabric, test: KindTable) -> list[str]:
    """Sentences about input that can be, but is hardly meant; before anything is solved."""
    return [*_angles(preform, test), *_sizes(preform, fabric, test), *_laws(fabric)]


def _angles(preform: Preform, test: KindTable) -> Iterator[str]:
    """Degrees whose number is that of a usual angle in radians."""
    angles = {"preform.bias_angle": preform.bias_angle}
    if isinstance(test, TestTable) and test.controls[test.control] == "rad":
        angles[f"test.{test.control}"] = max(test.values_si, key=abs)
    for key, angle in angles.items():
        degrees = float(np.rad2deg(angle))
        meant = abs(float(np.rad2deg(degrees)))
        usual = 5.0 * round(meant / 5.0)
        if 10.0 <= usual <= 90.0 and abs(meant - usual) <= 0.01 * usual:
            yield f'{key} is {degrees:.4g} deg, is "{degrees:.4g} rad" ({usual:g} deg) meant?'


def _sizes(preform: Preform, fabric: Fabric, test: KindTable) -> Iterator[str]:
    """Lengths out of proportion, and a bias test's specimen that is wide for its length."""
    width, length = map(float, preform.size)
    size = f"{si_text(width, 'm')} wide and {si_text(length, 'm')} long"
    if max(width, length) > min(LARGE, SLENDER * min(width, length)):
        yield f"preform.outline is {size}, which unit is meant?"
    across = [np.ptp(np.asarray(h.coords), axis=0).max() for h in preform.outline.interiors]
    small = np.array(across) < 0.1 * min(fabric.warp.spacing, fabric.weft.spacing)
    if small.any():
        first, others = int(small.argmax()), np.count_nonzero(small) - 1
        yield (
            f"hole-{first + 1} of preform.outline is {si_text(across[first], 'm')} large, less "
            "than a tenth of the distance of yarns"
            + (f", and so are {others} others" if others else "")
            + ", which unit is meant?"
        )
    if fabric.thickness is not None and fabric.thickness > 10.0 * fabric.warp.spacing:
        yield (
            f"fabric.thickness = {si_text(fabric.thickness, 'm')} is more than ten times the "
            "distance of yarns, which unit is meant?"
        )
    if not isinstance(test, TestTable):
        return
    largest = max(map(abs, test.values_si))
    if test.controls[test.control] == "m" and largest > length:
        yield (
            f"test.{test.control} = {si_text(largest, 'm')} is more than the specimen's length of "
            f"{si_text(length, 'm')}, which unit is meant?"
        )
    slope = abs(np.tan(preform.bias_angle))
    if test.kind != "bias-extension" or not 0.5 < slope < 2.0 or preform.sides() is None:
        return
    between = length * (1.0 if getattr(test, "upper", "grip") == "grip" else 2.0)
    if between * min(slope, 1.0 / slope) < width * (1.0 - 1e-9):
        yield (
            f"the specimen is {size}, H < 2 W: yarns run from clamp to clamp and carry the load"
            + (", are width and length swapped?" if length < width else "")
        )
    elif between < 2.0 * width * (1.0 - 1e-9):
        yield (
            f"the specimen is {size}, H < 2 W: the usual zones of a bias test, with full shear in "
            "the middle, need H >= 2 W between the clamps"
        )


def _laws(fabric: Fabric) -> Iterator[str]:
    """Laws of shear and tension that fall, which few cloths do."""
    laws = {"shear": fabric.shear_law, "warp": fabric.warp_law, "weft": fabric.weft_law}
    for name, law in laws.items():
        if law is None:
            continue
        what = f"fabric.{name}" if name == "shear" else f"fabric.{name}.tension"
        scale, unit = (np.rad2deg(1.0), "deg") if name == "shear" else (100.0, "%")
        force = law.evaluate(law.knots)[1]
        falls = np.flatnonzero(np.diff(force) < -1e-3 * np.abs(force).max(initial=0.0))
        if len(falls):
            low, high = scale * law.knots[falls[0] : falls[0] + 2]
            yield (
                f"{what} is a law that falls from {low:.4g} to {high:.4g} {unit}, where cloth that "
                "gives way resists less: is that measured?"
            )
        angle = np.deg2rad(np.arange(61.0))
        below = np.flatnonzero(law.evaluate(angle)[1] < 0.0)
        if name == "shear" and len(below):
            yield (
                f"{what} is a law that goes below zero from {below[0]} deg on, where cloth would "
                "shear by itself"
            )


def warnings(result: TestResult) -> list[str]:
    """Sentences about a result. Collective."""
    largest = float(result.shear_angles_max.max())
    experiment = result.experiment
    sentences = _finite(result, largest) if experiment.finite else _small(result, largest)
    return sentences + unused_options(experiment.network.comm, experiment.options)


def beyond_small(angle: float, cure: str) -> str:
    """What there is to say of small displacements with a shear angle (rad) beyond SMALL_DEG."""
    return (
        f"the shear angle reaches {np.rad2deg(angle):.1f} deg; small displacements hold to some "
        f"{SMALL_DEG:g} deg ({cure})"
    )


def _small(result: TestResult, largest: float) -> list[str]:
    fabric, sentences = result.network.fabric, []
    experiment, size = result.experiment, float(result.network.preform.size.max())
    moved = float(np.abs(experiment.extensions(result)).max())
    if moved > size and experiment.test.controls[experiment.test.control] == "N":
        sentences.append(
            f"the {experiment.movement} reaches {si_text(moved, 'm')}, more than the specimen's "
            f"size of {si_text(size, 'm')}: which unit of the load is meant?"
        )
    if largest > np.deg2rad(SMALL_DEG):
        sentences.append(beyond_small(largest, "set test.finite = true"))
    laws: dict[str, Potential | BiaxialLaw | None] = {
        "shear law": fabric.shear_law,
        "warp's law of tension": fabric.warp_law,
        "weft's law of tension": fabric.weft_law,
    }
    if fabric.biaxial_law is not None:
        laws["law of both tensions"] = fabric.biaxial_law
    left_out = [what for what, law in laws.items() if law is not None and law.name != "linear"]
    left_out += ["softening in compression"] if fabric.compression < 1.0 else []
    if left_out:
        sentences.append(
            "at small displacements only the moduli at rest act, not the "
            f"{' and the '.join(left_out)} (test.finite = true takes the laws)"
        )
    return sentences


def _finite(result: TestResult, largest: float) -> list[str]:
    experiment, sentences = result.experiment, []
    gauge = experiment.net_gauge()
    if gauge is not None and result.controls.max() > net_reach(gauge):
        sentences.append(
            f"beyond an extension of {si_text(net_reach(gauge), 'm')}, where yarns that do not "
            "stretch lie along the pull, the load is that of stretched yarns"
        )
    strains = [state.fields["arm_strain"] for state in result.states]
    extremes = np.array([[s.min(initial=0.0), s.max(initial=0.0)] for s in strains])
    sentences += beyond_laws(experiment.network, largest, extremes)
    if experiment.space and experiment.imperfection is None and result.buckling is None:
        mended = any(increment.shifted for increment in result.increments)
        sentences.append(
            "the cloth may leave its plane but starts exactly flat: wrinkles start from rounding, "
            f"if at all{', though the flat cloth became unstable' if mended else ''} "
            "(test.imperfection gives them a seed)"
        )
    cuts = [increment for increment in result.increments if increment.cuts]
    if cuts:
        sentences.append(
            f"steps were cut in half {sum(increment.cuts for increment in cuts)} times where no "
            f"equilibrium was found, first before {experiment.column.text(cuts[0].control)}; "
            "what follows may be another branch than that of smaller steps"
        )
    return sentences


def beyond_laws(network: Network, shear: float, strain: np.ndarray) -> list[str]:
    """Where cloth leaves what its laws were measured for. Collective.

    The largest shear angle, rad, of all ranks, and strains of yarns on this one.
    """
    fabric, comm, sentences = network.fabric, network.comm, []
    last = fabric.shear.last_point
    if shear > last:
        sentences.append(
            f"the shear angle reaches {np.rad2deg(shear):.1f} deg, beyond the last point of the "
            f"shear law's table at {np.rad2deg(last):.1f} deg, where the law goes straight on"
        )
    shortest, longest = least(comm, strain, 0.0), most(comm, strain, 0.0)
    # The strain at which yarns of cloth give way, as a rule (docs/laws.md).
    if fabric.biaxial_law is not None:
        (low, high) = fabric.biaxial_law.strains.T
        room = fabric.compression_width  # strain; and for rounding
        if shortest < low.min() - room or longest > high.max() + room:
            reached = f"{100 * shortest:.2g} to {100 * longest:.3g} %"
            sentences.append(
                f"yarns are strained from {reached}, beyond the points of fabric.tension.surface, "
                f"which has {100 * low.min():.2g} to {100 * high.max():.3g} %; there it is a guess"
            )
    elif fabric.compression == 1.0 and shortest < -fabric.compression_width:
        sentences.append(
            f"yarns are compressed by up to {-100 * shortest:.2g} % and carry that like tension; "
            "those of a cloth buckle (fabric.tension.compression = 0.01 softens them)"
        )
    if longest > BREAKING:
        sentences.append(
            f"yarns are stretched by up to {100 * longest:.3g} %, which hardly any yarn stands; "
            "the laws of tension know no rupture"
        )
    return sentences
