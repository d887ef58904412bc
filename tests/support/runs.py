# SPDX-License-Identifier: MIT
"""A run that is long enough to be interrupted, for tests of processes."""

CASE = """
[fabric]
use = "glass-pp-plain-1.93"
[preform]
outline = { rectangle = ["22 mm", "40 mm"] }
bias_angle = "45 deg"
[test]
finite = true
extension = ["1 mm", "2 mm"]
increments = 40
[output]
pictures = false
paraview = false
"""
