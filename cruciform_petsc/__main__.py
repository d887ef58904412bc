# SPDX-License-Identifier: MIT
"""``python3 -m cruciform_petsc`` is ``cruciform-petsc``."""

import sys

from .cli import main

if __name__ == "__main__":
    sys.exit(main())
