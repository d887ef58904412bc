# SPDX-License-Identifier: MIT
"""How Sphinx makes a site of these pages; scripts/docs runs it."""

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[1]))

from sphinx.ext.napoleon import Config, NumpyDocstring

import cruciform_petsc

project = "cruciform_petsc"
author = "cruciform_petsc contributors"
copyright = author
version = release = cruciform_petsc.__version__

extensions = ["myst_parser", "sphinx.ext.autodoc"]
exclude_patterns = ["_build"]
html_theme = "furo"
html_title = "cruciform_petsc"
html_copy_source = False
html_show_sphinx = False
highlight_language = "none"  # of indented blocks; fenced ones name their own

myst_heading_anchors = 3  # as forges make them, so that links work there, too

default_role = "py:obj"  # `Network` in a docstring: a link where the page of names has it
autodoc_member_order = "bysource"
autodoc_typehints = "none"  # docstrings tell types, with shapes and units
autodoc_default_options = {"members": True, "exclude-members": "model_config, check_together"}


def numpy_style(app, what, name, obj, options, lines):
    """Sections of docstrings, as numpydoc has them."""
    # of an attribute, what stands before a colon would be a type
    what = "function" if what in ("attribute", "property") else what
    lines[:] = NumpyDocstring(lines, Config(napoleon_use_rtype=False), app, what, name, obj).lines()


def setup(app):
    """Connect the above."""
    app.connect("autodoc-process-docstring", numpy_style)
