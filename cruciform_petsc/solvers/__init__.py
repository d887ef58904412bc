# SPDX-License-Identifier: MIT
"""Solvers of the assembled systems."""
