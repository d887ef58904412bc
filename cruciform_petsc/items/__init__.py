# SPDX-License-Identifier: MIT
"""What adds to equilibrium, one file each."""
