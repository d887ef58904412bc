# SPDX-License-Identifier: MIT
"""Equilibrium at finite deformation: states, models, Newton, continuation."""
