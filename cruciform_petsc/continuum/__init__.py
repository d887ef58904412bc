# SPDX-License-Identifier: MIT
"""The continuum reference: membranes of the same cut in dolfinx, linear and hyperelastic."""
