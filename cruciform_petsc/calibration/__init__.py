# SPDX-License-Identifier: MIT
"""Inverse identification of the shear law from a measured load curve; see calibrate.py."""

from .bending import bending_rigidity, bending_rigidity_peirce
from .curve import MeasuredCurve, read_curve
from .identify import calibrate, calibrate_together, predict
from .result import Calibration, Prediction
from .specimen import Specimen

__all__ = [
    "Calibration",
    "MeasuredCurve",
    "Prediction",
    "Specimen",
    "bending_rigidity",
    "bending_rigidity_peirce",
    "calibrate",
    "calibrate_together",
    "predict",
    "read_curve",
]
