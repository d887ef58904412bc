# SPDX-License-Identifier: MIT
"""Elements: arrays in, arrays out. They know nothing of ranks, PETSc or files."""
