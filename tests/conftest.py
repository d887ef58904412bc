# SPDX-License-Identifier: MIT
"""Messages are the same however the tests were started."""

import os

os.environ.pop("CRUCIFORM_PETSC_BY", None)  # scripts/fenicsx, which commands would begin with
