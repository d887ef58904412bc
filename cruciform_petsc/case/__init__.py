# SPDX-License-Identifier: MIT
"""Case files: what a user writes, checked once."""
