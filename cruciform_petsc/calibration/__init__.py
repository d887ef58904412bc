# SPDX-License-Identifier: MIT
"""From measurements to a cloth: shear law, bending, moduli of strips; see calibrate.py."""

from .bending import bending_rigidity, bending_rigidity_peirce
from .curve import MeasuredCurve, read_curve
from .identify import calibrate, calibrate_together, predict
from .kilby import Kilby
from .result import Calibration, Prediction
from .specimen import Specimen

__all__ = [
    "Calibration",
    "Kilby",
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
