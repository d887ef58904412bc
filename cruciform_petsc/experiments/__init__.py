# SPDX-License-Identifier: MIT
"""Tests on fabrics, one file each."""
