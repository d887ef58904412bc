# SPDX-License-Identifier: MIT
"""demos/notebook.ipynb and docs/jupyter.md do what they say."""

import json
import shutil

import matplotlib as mpl

mpl.use("Agg")

import numpy as np
import pytest
from matplotlib import pyplot
from support.docs import ROOT, blocks

from cruciform_petsc.output import scene

NOTEBOOK = ROOT / "demos" / "notebook.ipynb"


def cells():
    return json.loads(NOTEBOOK.read_text())["cells"]


def test_it_is_kept_without_results():
    """What a run leaves in it would go stale."""
    code = [cell for cell in cells() if cell["cell_type"] == "code"]
    assert len(code) > 5
    assert all(cell["outputs"] == [] and cell["execution_count"] is None for cell in code)


def test_cell_by_cell(tmp_path, monkeypatch):
    """In one namespace, where Jupyter would run it; nothing is written."""
    monkeypatch.chdir(tmp_path)
    shutil.copy(ROOT / "demos" / "glass_pp_bias.csv", tmp_path)
    blank = np.full((60, 100, 3), 255, np.uint8)  # test_scene.py looks at such images
    monkeypatch.setattr(scene, "_render", lambda scenes: ([blank], np.array([0.1, 0.06])))
    pyplot.close("all")  # of other tests
    names = {}
    for cell in cells():
        if cell["cell_type"] == "code":
            exec("".join(cell["source"]), names)
    assert len(pyplot.get_fignums()) == 4
    # one page of docs/jupyter.md has the same names
    for block in blocks("python"):
        if block.page == "jupyter.md":
            exec(block.text, names | {"other": names["without"]})
    pyplot.close("all")
    assert names["result"].load == pytest.approx(8.19, abs=0.01)
    assert len(names["formed"].states) == 3
    assert {path.name for path in tmp_path.iterdir()} == {"glass_pp_bias.csv", "both.png"}


def test_by_a_kernel(tmp_path):
    """As Jupyter runs it, where that is installed: ./scripts/fenicsx jupyter."""
    nbclient = pytest.importorskip("nbclient", reason="Jupyter is beside the root")
    nbformat = pytest.importorskip("nbformat")
    book = nbformat.read(NOTEBOOK, 4)
    resources = {"metadata": {"path": str(NOTEBOOK.parent)}}
    nbclient.NotebookClient(book, timeout=300, resources=resources).execute()
    shown = {kind for c in book.cells for o in c.get("outputs", []) for kind in o.get("data", {})}
    assert {"text/html", "image/png"} <= shown
