# SPDX-License-Identifier: MIT
"""A specimen, the test done on it, and what was measured."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..errors import InputError
from ..experiments.bias_extension import BiasExtension
from ..experiments.net_kinematics import net_reach
from ..experiments.picture_frame import PictureFrame
from ..net.network import Network
from ..units import format_si
from .curve import MeasuredCurve
from .formula import frame_angle, torque_from_frame, torque_from_loads

KINDS = (BiasExtension.kind, PictureFrame.kind)
OFF_RECTANGLE = 1e-6  # of its area, that a rectangle given as a polygon may be
LARGEST_FRAME_ANGLE = np.deg2rad(85.0)


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

    def check(self) -> None:
        """InputError for a kind or a weight that is none, and for data past what can be.

        That is far past where a strip's yarns lie along the pull, or where a frame is all but
        closed.
        """
        if not 1e-12 <= self.weight <= 1e12:
            raise InputError(
                f"the weight of a curve must be positive, from 1e-12 to 1e12, got {self.weight:g}"
            )
        if self.kind not in KINDS:
            raise InputError(f"kind is '{self.kind}'; it can be '{KINDS[0]}' or '{KINDS[1]}'")
        last = float(np.max(self.curve.displacement))
        start = f"the data go to {format_si(last, 'm')}, but"
        if self.is_frame:
            a, b = self.sides
            if not frame_angle(last, self.sides) < LARGEST_FRAME_ANGLE:
                raise InputError(
                    f"{start} a frame of {format_si(a, 'm')} x {format_si(b, 'm')} is closed at "
                    f"{format_si(a + b - float(np.hypot(a, b)), 'm')}: check the frame's size, the "
                    "unit of the displacement and that it is that of the corner along the diagonal"
                )
        elif self.strip is not None:
            width, length, halves = self.strip
            reach = net_reach(length - width) / halves
            if 0.0 < 1.5 * reach < last:
                raise InputError(
                    f"{start} the yarns of a specimen of {format_si(width, 'm')} x "
                    f"{format_si(length / halves, 'm')} lie along the pull at "
                    f"{format_si(reach, 'm')}: check the specimen's size and the unit of the "
                    "displacement"
                )

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
