# SPDX-License-Identifier: MIT
"""Case files: what a user writes, checked once."""

from .schema import Case

__all__ = ["Case"]
