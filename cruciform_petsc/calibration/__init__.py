# SPDX-License-Identifier: MIT
"""Inverse identification of the shear law from a measured load curve; see calibrate.py."""

from .curve import MeasuredCurve, read_curve
from .identify import Calibration, calibrate
from .predict import Prediction, predict

__all__ = ["Calibration", "MeasuredCurve", "Prediction", "calibrate", "predict", "read_curve"]
