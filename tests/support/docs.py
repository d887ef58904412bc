# SPDX-License-Identifier: MIT
"""The code that stands in README.md, CONTRIBUTING.md and docs/, block by block."""

import ast
import re
import shlex
import tomllib
from pathlib import Path
from typing import NamedTuple

from markdown_it import MarkdownIt

ROOT = Path(__file__).parents[2]
PAGES = [ROOT / "README.md", ROOT / "CONTRIBUTING.md", *sorted((ROOT / "docs").glob("*.md"))]
COMMAND = re.compile(
    r"(\./scripts/|(\./scripts/fenicsx )?(mpirun|srun|cruciform-petsc|python3|git clone) "
    r"|#!/bin/bash|LAW=|\./configure)"
)


class Block(NamedTuple):
    """Code, and where it stands."""

    page: str
    line: int
    language: str
    text: str


def language(text):
    """What an indented block is: "sh", "toml", "python" or "formula"."""
    if COMMAND.match(text):
        return "sh"
    for name, read in (("toml", tomllib.loads), ("python", ast.parse)):
        try:
            read(text)
        except (ValueError, SyntaxError):
            continue
        # A formula may look like an assignment; what is not one calls something.
        if name == "toml" or "import " in text or re.search(r"^\w+\(\S", text, re.M):
            return name
    return "formula"


def blocks(kind):
    """All blocks of a language, without the directives of Sphinx."""
    for path in PAGES:
        for token in MarkdownIt().parse(path.read_text(encoding="utf-8")):
            info = token.info.strip()
            if token.type not in ("fence", "code_block") or info.startswith("{"):
                continue
            block = Block(
                path.name, token.map[0] + 1, info or language(token.content), token.content
            )
            if block.language == kind:
                yield block


def commands():
    """Each command of a block, or in a sentence: page, line, words."""
    for block in blocks("sh"):
        text = block.text.replace("\\\n", " ")
        text = re.sub(r'python3 -c ".*?"', "python3 -c", text, flags=re.DOTALL)
        for number, line in enumerate(text.splitlines()):
            yield block.page, block.line + number, words(line)
    for path in PAGES:
        for token in MarkdownIt().enable("table").parse(path.read_text(encoding="utf-8")):
            for child in token.children or ():
                if child.type == "code_inline" and COMMAND.match(child.content):
                    yield path.name, token.map[0] + 1, words(child.content)


def words(line):
    """Those of a command, without what a usage has around them."""
    line = re.split(r" {3,}| \| | > ", line)[0]  # a description, a pipe, a file
    return shlex.split(re.sub(r" \[|\](?= |$)|\.\.\.", " ", line), comments=True)
