# SPDX-License-Identifier: MIT
"""A specimen, the test done on it, and what was measured."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from ..errors import InputError
from ..experiments.bias_extension import BiasExtension
from ..experiments.net_kinematics import net_angle, net_reach
from ..experiments.picture_frame import PictureFrame
from ..net.network import Network
from ..quantities import si_text
from ..units import format_si
from .curve import FEWEST_POINTS, MeasuredCurve
from .formula import frame_angle, torque_from_frame, torque_from_loads

KINDS = (BiasExtension.kind, PictureFrame.kind)
OFF_RECTANGLE = 1e-6  # of its area, that a rectangle given as a polygon may be
LARGEST_FRAME_ANGLE = np.deg2rad(85.0)
# Of an inextensible net: a thousandth of the length more or less is a degree there.
LARGEST_STRIP_ANGLE = np.deg2rad(80.0)
FORMULA_ENDS = np.deg2rad(35.0)  # for strips, whose net's kinematics end there
FAR_OFF = 100.0  # measured loads over those expected, or the reverse, that a unit explains


@dataclass(frozen=True, eq=False)
class Specimen:
    """A network of any outline and size, and the load curve measured of it.

    The displacement is the extension, for ``upper = "centre-line"`` that of half a specimen (see
    BiasExtension); or the growth of the longer diagonal of a picture frame, which the network fills
    from hinge to hinge.
    """

    network: Network
    curve: MeasuredCurve
    kind: str = BiasExtension.kind  # or PictureFrame's
    upper: str = "grip"  # or "centre-line"; not looked at for a picture frame
    bending: bool = True  # whether yarns resist it
    weight: float = 1.0  # of this curve's mean square relative error among those of others

    @property
    def is_frame(self) -> bool:
        """Whether it is a picture frame."""
        return self.kind == PictureFrame.kind

    @property
    def sides(self) -> tuple[float, float]:
        """Sides of a picture frame, m."""
        if size := self.network.preform.sides(OFF_RECTANGLE):
            return size
        raise InputError("a picture frame's specimen must be a rectangle, from hinge to hinge")

    @property
    def strip(self) -> tuple[float, float, float] | None:
        """Width and length of a whole strip cut at 45 degrees, m, and how many of these it is.

        None for anything else.
        """
        preform = self.network.preform
        size = preform.sides(OFF_RECTANGLE)
        if size is None or abs(np.cos(2.0 * preform.bias_angle)) > 0.05:
            return None
        halves = 2.0 if self.upper == "centre-line" else 1.0
        return size[0], halves * size[1], halves

    def checked(self) -> Specimen:
        """The specimen without the points at which its yarns would have to stretch.

        That is past where a strip's yarns lie along the pull, or where a frame is all but closed:
        no law of shear gives these loads. InputError for a kind or a weight that is none, and where
        most points are such.
        """
        if not 1e-12 <= self.weight <= 1e12:
            raise InputError(
                f"the weight of a curve must be positive, from 1e-12 to 1e12, got {self.weight:g}"
            )
        if self.kind not in KINDS:
            raise InputError(f"kind is '{self.kind}'; it can be '{KINDS[0]}' or '{KINDS[1]}'")
        d = self.curve.displacement
        if self.is_frame:
            a, b = self.sides
            kept = frame_angle(d, self.sides) < LARGEST_FRAME_ANGLE  # NaN is not
            size, limit = (a, b), a + b - float(np.hypot(a, b))
            what = "a frame of {} x {} is closed at {}"
            hint = "frame's size, the unit of the displacement and that it is that of the corner "
            hint += "along the diagonal"
        elif self.strip is not None and self.strip[1] > self.strip[0]:
            width, length, halves = self.strip
            size, limit = (width, length / halves), net_reach(length - width) / halves
            kept = net_angle(halves * d, length - width) < LARGEST_STRIP_ANGLE  # nor here
            what = "the yarns of a specimen of {} x {} lie along the pull at {}"
            hint = "specimen's size and the unit of the displacement"
        else:
            return self
        if kept.all():
            return self
        what = what.format(*(format_si(value, "m") for value in (*size, limit)))
        if kept.sum() < max(FEWEST_POINTS, len(d) / 2):
            raise InputError(
                f"the data go to {format_si(d[-1], 'm')}, but {what}: check the {hint}"
            )
        number = int((~kept).sum())
        note = (
            f"{what[0].upper()}{what[1:]}; near and past that no law of shear gives the loads: "
            f"{number} {'point' if number == 1 else 'points'} from {si_text(d[~kept][0], 'm')} on "
            "left out."
        )
        return replace(self, curve=self.curve.where(kept, note))

    def closed_formula(self) -> tuple[np.ndarray, np.ndarray] | None:
        """Angles, rad, and torques, N/m, by the closed formula; None where it does not hold."""
        d, f = self.curve.displacement, self.curve.force
        if self.is_frame:
            return torque_from_frame(d, f, self.sides)
        if self.strip is None:
            return None
        width, length, halves = self.strip
        if length < 2.0 * width * (1.0 - 1e-6):
            return None
        angle, torque = torque_from_loads(halves * d, f, width, length)
        return (angle, torque) if len(angle) >= 2 and (torque > 0.0).any() else None

    def unit_question(self) -> str | None:
        """Ask for the unit where the loads are far off those of the fabric's own law of shear.

        By the closed formula; None where it does not hold.
        """
        points = self.closed_formula()
        if points is None:
            return None
        law = self.network.fabric.shear.evaluate(points[0])[1]
        return unit_question(float(np.median(points[1] / law)))


class FormulaGap(NamedTuple):
    """How far the closed formula's laws of two data sets are apart: b/a - 1 over a range."""

    mean: float
    rms: float
    low: float  # rad
    high: float


def formula_gap(specimens: Sequence[Specimen], other: Specimen) -> FormulaGap | None:
    """The gap from the first of several that the formula holds for; None without common angles."""
    ends = [np.inf if s.is_frame else FORMULA_ENDS for s in (*specimens, other)]
    points = [s.closed_formula() for s in (*specimens, other)]
    for end, known in zip(ends, points[:-1], strict=False):
        if known is None or points[-1] is None:
            continue
        (a, torque_a), (b, torque_b) = known, points[-1]
        low, high = max(a[0], b[0]), min(a[-1], b[-1], end, ends[-1])
        if low < high:
            at = np.linspace(low, high, 50)
            off = np.interp(at, b, torque_b) / np.interp(at, a, torque_a) - 1.0
            return FormulaGap(float(off.mean()), float(np.sqrt(np.mean(off**2))), low, high)
    return None


def unit_question(ratio: float, those: str = "of the fabric's own shear law") -> str | None:
    """What to ask if measured loads are ``ratio`` times ``those``; None if that may be."""
    if 1.0 / FAR_OFF < ratio < FAR_OFF or not ratio > 0.0:
        return None
    times = f"{float(f'{max(ratio, 1.0 / ratio):.2g}'):.0f} times"
    size, meant, written = ("larger", "N", "kN") if ratio > 1.0 else ("smaller", "kN", "N")
    return (
        f"the measured loads are {times} {size} than those {those}: is {meant} meant in place of "
        f"{written} in the data?"
    )
