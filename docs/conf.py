# SPDX-License-Identifier: MIT
"""How Sphinx makes a site of these pages; scripts/docs runs it."""

import re
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


def classic_script(app, page, template, context, doctree):
    """Have furo's script loaded as browsers allow it for files on disk: not as a module."""
    for script in context["script_files"]:
        if getattr(script, "attributes", {}).get("type") == "module":
            del script.attributes["type"]


def for_files_on_disk(app, error):
    """Mend scripts that browsers stop in pages from the disk. Other pages stay as they are."""
    if error is not None or app.builder.name != "html":
        return
    static = Path(app.outdir, "_static")
    # Debian has furo's script in two files, one of which imports the other.
    folder = static / "scripts"
    script = (folder / "furo.js").read_text()
    imported = 'import * as Gumshoe from "./gumshoe-patched.js";\n'
    if imported in script:
        script = re.sub(r"(?m)^ *console\.log\(.*\);\n", "", script.replace(imported, ""))
        script = (folder / "gumshoe-patched.js").read_text() + script  # sets window.Gumshoe
        (folder / "furo.js").write_text(script)
    # Excerpts of what a search finds are fetched from the pages.
    options = static / "documentation_options.js"
    told = "SHOW_SEARCH_SUMMARY: "
    text = options.read_text().replace(f"{told}true", f'{told}location.protocol !== "file:"')
    options.write_text(text)


def setup(app):
    """Connect the above."""
    app.connect("autodoc-process-docstring", numpy_style)
    app.connect("html-page-context", classic_script, priority=900)  # after furo has added it
    app.connect("build-finished", for_files_on_disk)
