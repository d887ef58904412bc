# SPDX-License-Identifier: MIT
"""What is told does nothing to a terminal."""

import logging
import sys

import pytest

from cruciform_petsc.cli import main
from cruciform_petsc.errors import InputError, harmless

NASTY = [
    "\x1b[31m", "\x1b]0;owned\x07", "\x9b2J", "\r", "\b", "\x7f", "\0", "\u202e", "\u2066",
    "\u2028", "\u200f", "\udcff", "\ufeff",
]  # fmt: skip


@pytest.mark.parametrize("text", NASTY)
def test_commands_are_written_out(text):
    assert harmless(f"a{text}b").isprintable()
    assert str(InputError(f"a{text}b")).isprintable()


def test_words_stay():
    text = 'Grün "織物" 12 µm², N·mm² \N{NO-BREAK SPACE}°\t½\n'
    assert harmless(text) == text


@pytest.mark.parametrize("text", [nasty for nasty in NASTY if nasty != "\0"])
def test_names_and_keys_reach_the_terminal_harmlessly(tmp_path, capfd, text):
    """File names, keys, values, kinds of test, and what --set says."""
    path = tmp_path / "case.toml"
    words = text.encode("utf-8", "surrogatepass").decode("utf-8", "replace")
    escaped = "".join(f"\\U{ord(c):08x}" for c in words)
    path.write_text(f'title = "{escaped}"\n[fabric]\n"{escaped}" = 1\n')
    for arguments in (
        ["check", f"{tmp_path}/{text}.toml"],
        ["check", str(path)],
        ["check", str(path), "--set", f"title='{text}'"],
        ["check", str(path), "--set", f"{text}=1"],
        ["run", str(path), f"--{text}"],
        ["new", text],
        ["compare", text, text],
        ["resume", text],
    ):
        assert main(arguments) == 2
        out = "".join(capfd.readouterr())
        assert out.replace("\n", "").isprintable(), arguments
        first, *more = out.splitlines()  # a line for each problem
        assert first.startswith("cruciform-petsc: ")
        assert all(line.startswith("  ") for line in more)


def test_lines_of_the_log_are_single(capfd):
    """A title, as the log tells it, can neither colour it nor add a line."""
    assert main(["check", "x"]) == 2  # makes the log
    log = logging.getLogger("cruciform_petsc")
    for handler in log.handlers:
        handler.setStream(sys.stdout)
    log.setLevel(logging.INFO)
    log.info("%s", "a\n\x1b[2Jwarning\rb")
    assert capfd.readouterr().out == r"a\n\x1b[2Jwarning\rb" + "\n"
