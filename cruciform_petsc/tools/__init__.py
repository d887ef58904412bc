# SPDX-License-Identifier: MIT
"""Rigid tools that cloth is formed over: surfaces, motions, what a case says of them."""
