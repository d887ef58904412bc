# SPDX-License-Identifier: MIT
"""Columns of curves: names, units and sizes, and values as people read them."""

import numpy as np
import pytest

from cruciform_petsc.experiments.picture_frame import PictureFrame
from cruciform_petsc.quantities import (
    EXTENSION,
    LOAD,
    angle_text,
    displacement,
    force_text,
    force_unit,
    quantity,
    si_text,
    tension_text,
)


def test_what_a_kind_declares():
    """Words of a column that only a picture frame has, wherever it is told."""
    angle = quantity("angle_deg")
    assert angle == PictureFrame.column
    assert angle.scale == pytest.approx(np.pi / 180.0)
    assert (angle.name, angle.axis) == ("angle of the frame", "shear angle of the frame (°)")
    assert angle.text(0.0125) == "angle 0.7162 deg"


def test_what_nobody_has_declared():
    """The name says it; of two units that end alike the longer one counts."""
    column = quantity("some_force_N_per_mm")
    assert (column.name, column.unit, column.scale) == ("some force", "N/mm", 1e3)
    assert column.axis == "some force (N/mm)"
    assert quantity("energy_tension_J").unit == "J"
    assert quantity("number_of_things").unit == ""


def test_controls():
    assert EXTENSION.text(0.0125) == "extension 12.5 mm"
    assert LOAD.text(0.0125) == "load 12.5 mN"
    assert LOAD.value_text(3.0) == "3 N"


def test_what_a_machine_measures():
    """The cross-head of a picture frame, and none of a test without one."""
    assert displacement(["angle_deg", "load_N", "crosshead_mm"]) == quantity("crosshead_mm")
    assert displacement(["strain_warp_percent", "load_N"]) is None


def test_values():
    assert force_unit([0.05, -0.2]) == ("N", 1.0)
    assert force_unit([0.05, -0.09]) == ("mN", 1e-3)
    assert [force_text(value) for value in (1.23456, -0.05)] == ["1.235 N", "-50 mN"]
    assert si_text(0.0123456, "m") == "12.35 mm"
    assert [angle_text(-1e-9), angle_text(12.345, "°")] == ["0.00 deg", "12.35°"]
    most = {"n": 2.0, "n_99": 0.05, "family": "weft", "at_mm": [1.0, -2.5]}
    tail = ", on 99 % of the area up to 50 mN"
    assert tension_text(most) == "2 N per weft yarn, at x = 1 mm, y = -2.5 mm (at rest)" + tail
    assert tension_text(most | {"at_mm": None}) == "2 N per weft yarn" + tail
