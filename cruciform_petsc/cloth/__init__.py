# SPDX-License-Identifier: MIT
"""What is cut and from which fabric."""
