# SPDX-License-Identifier: MIT
"""The net of yarns: lattice, who owns what, nodes, supports, edges."""
