# SPDX-License-Identifier: MIT
"""Examples in docstrings do what they say."""

import doctest
from importlib import import_module

import pytest


@pytest.mark.parametrize(
    "name",
    ["units", "cloth.fabric", "cloth.preform", "laws", "calibration.bending"],
)
def test_examples(name):
    """Each module's examples run, and there are some."""
    module = import_module(f"cruciform_petsc.{name}")
    flags = doctest.ELLIPSIS | doctest.IGNORE_EXCEPTION_DETAIL
    failed, tried = doctest.testmod(module, optionflags=flags)
    assert tried > 0
    assert failed == 0
