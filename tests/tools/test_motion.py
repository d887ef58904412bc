# SPDX-License-Identifier: MIT
"""Poses and motions."""

import numpy as np
import pytest
from support.kernels import DEGREE, rotation

from cruciform_petsc.tools.motion import Motion, Pose

AXIS = np.array([1.0, 2.0, -0.5])
POSE = Pose(np.array([0.1, -0.2, 0.3]), rotation(0.7, AXIS))


def test_there_and_back():
    x = np.random.default_rng(0).normal(size=(5, 3))
    np.testing.assert_allclose(POSE.to_tool(POSE.to_lab(x)), x, atol=1e-14)
    np.testing.assert_allclose(POSE.to_lab(x[0]), POSE.place + POSE.turn @ x[0])
    np.testing.assert_allclose(POSE.vector_to_lab(x[0]), POSE.turn @ x[0])
    np.testing.assert_allclose(POSE.vector_to_tool(POSE.vector_to_lab(x)), x, atol=1e-14)
    h = np.random.default_rng(1).normal(size=(5, 3, 3))
    by_hand = np.stack([POSE.turn @ one @ POSE.turn.T for one in h])
    np.testing.assert_allclose(POSE.matrix_to_lab(h), by_hand, atol=1e-14)


def test_travel_and_curve():
    travel = np.array([0.0, 0.0, -0.05])
    motion = Motion(POSE, travel)
    np.testing.assert_allclose(motion.at(0.25).place, POSE.place + 0.25 * travel)
    np.testing.assert_array_equal(motion.at(1.0).turn, POSE.turn)
    slow = Motion(POSE, travel, curve=np.array([[0, 0], [0.5, 0.1], [1, 1]]))
    assert [slow.share(s) for s in (0.0, 0.25, 0.75, 1.0)] == pytest.approx([0, 0.05, 0.55, 1.0])


def test_rotation_about_an_axis_through_a_point():
    through, angle = np.array([0.3, 0.0, 0.1]), 40 * DEGREE
    motion = Motion(POSE, np.array([0.1, 0, 0]), 3.0 * AXIS, through, angle)
    x = np.array([0.02, 0.03, 0.04])  # a point of the tool
    for s in (0.0, 0.5, 1.0):
        expected = through + rotation(s * angle, AXIS) @ (POSE.to_lab(x) - through)
        np.testing.assert_allclose(motion.at(s).to_lab(x), expected + s * motion.travel, atol=1e-14)
