# SPDX-License-Identifier: MIT
"""The package as an interactive user meets it: its names and its page of help."""

import pydoc
import subprocess
import sys
from pathlib import Path

import pytest

import cruciform_petsc

README = Path(__file__).parents[1] / "README.md"


def test_names():
    """Those of __all__ and modules; no helper. Each can be had."""
    shown = {name for name in dir(cruciform_petsc) if not name.startswith("_")}
    assert set(cruciform_petsc.__all__) <= shown
    assert not {"Any", "import_module", "annotations", "TYPE_CHECKING", "ModuleType"} & shown
    assert all(hasattr(cruciform_petsc, name) for name in shown)
    with pytest.raises(AttributeError, match="no attribute 'Fabrik'"):
        _ = cruciform_petsc.Fabrik


def test_page_of_help():
    """The ten lines of the README, word by word; every public name is told of."""
    script = README.read_text().split("## Ten lines of Python")[1].split("```python\n")[1]
    lines = [f"    {line}".rstrip() for line in script.split("```")[0].splitlines()]
    assert "\n".join(lines) in cruciform_petsc.__doc__
    for name in cruciform_petsc.__all__:
        assert f"`{name}" in cruciform_petsc.__doc__, name
    page = pydoc.plain(pydoc.render_doc(cruciform_petsc))
    assert "BiasExtension(network, extension=" in page
    assert "class Preform(" in page


def test_nothing_is_loaded_before_it_is_used():
    """Neither by the import nor by dir()."""
    code = "import sys, cruciform_petsc; dir(cruciform_petsc); print(*sys.modules)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert not {"petsc4py", "mpi4py", "numpy"} & set(done.stdout.split())
