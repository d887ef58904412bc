# SPDX-License-Identifier: MIT
"""Small displacements: the paper's linear systems."""
