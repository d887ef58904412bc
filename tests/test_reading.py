# SPDX-License-Identifier: MIT
"""Whatever a user names, or a folder from elsewhere holds: read or refused, never waited for."""

import json
import os
import signal
import socket
from pathlib import Path

import numpy as np
import pytest

from cruciform_petsc import reading
from cruciform_petsc.calibration import columns
from cruciform_petsc.calibration.curve import read_curve
from cruciform_petsc.case.schema import Case
from cruciform_petsc.compare import read_side
from cruciform_petsc.errors import InputError
from cruciform_petsc.output.checkpoint import hint
from cruciform_petsc.reading import open_regular, parse_toml, read_bytes, read_json

CASE = """
[fabric]
use = "e-glass-plain-2.4"
[preform]
outline = { rectangle = ["2.4 cm", "3.6 cm"] }
bias_angle = "45 deg"
[test]
extension = "1 mm"
"""
CURVE = "displacement [mm], force [N]\n" + "".join(f"{i},{2 * i}\n" for i in range(1, 6))


@pytest.fixture(autouse=True)
def soon():
    """A test that waits for something is stopped."""
    signal.alarm(20)
    yield
    signal.alarm(0)


def special(folder: Path, kind: str) -> Path:
    """A file that is no file."""
    path = folder / "special"
    if kind == "pipe":
        os.mkfifo(path)
    elif kind == "socket":
        bound = socket.socket(socket.AF_UNIX)
        here = os.open(".", os.O_RDONLY)
        os.chdir(folder)  # names of sockets are short
        try:
            bound.bind("special")
        finally:
            os.fchdir(here)
            os.close(here)
            bound.close()
    elif kind == "folder":
        path.mkdir()
    elif kind == "loop":
        path.symlink_to(path)
    elif kind == "nothing":
        path.symlink_to(folder / "nowhere")
    elif kind == "sparse":
        with path.open("wb") as file:
            file.truncate(1 << 40)
    else:
        path.symlink_to(kind)  # a device, a file of the kernel
    return path


SPECIAL = [
    "pipe", "socket", "folder", "loop", "nothing", "sparse", "/dev/zero", "/dev/stdin", "/dev/tty",
    "/proc/self/mem", "/proc/self/pagemap", "/proc/kmsg",
]  # fmt: skip


@pytest.mark.parametrize("kind", SPECIAL)
def test_special_files(tmp_path, kind):
    """As a case, as measured data, and in a folder of results."""
    path = special(tmp_path, kind)
    for read in (Case.load, read_curve):
        with pytest.raises(InputError) as caught:
            read(path)
        assert "\n" not in str(caught.value)
    results = tmp_path / "results"
    results.mkdir()
    (results / "curve.csv").write_text("extension_mm,load_N\n0,0\n1,2\n")
    (results / "summary.json").symlink_to(path)
    assert read_side(results).kind == "unknown"
    (results / "curve.csv").unlink()
    (results / "curve.csv").symlink_to(path)
    with pytest.raises(InputError):
        read_side(results)
    assert hint(results) == ""


def test_only_regular_files_are_opened(tmp_path):
    """And only behind a link where that may be."""
    (tmp_path / "file").write_text("x")
    (tmp_path / "link").symlink_to(tmp_path / "file")
    os.mkfifo(tmp_path / "pipe")
    with open_regular(tmp_path / "file") as file:
        assert file.read() == b"x"
    for path in (tmp_path / "link", tmp_path / "pipe", tmp_path, tmp_path / "none"):
        with pytest.raises(OSError):
            open_regular(path)
    with open_regular(tmp_path / "link", follow=True) as file:
        assert file.read() == b"x"


def test_a_file_replaced_by_a_pipe_is_not_waited_for(tmp_path, monkeypatch):
    """Between looking at it and opening it."""
    (tmp_path / "file").write_text("x")
    os.mkfifo(tmp_path / "pipe")
    look = os.lstat
    monkeypatch.setattr(os, "lstat", lambda path: look(tmp_path / "file"))
    with pytest.raises(OSError, match="no regular file"):
        open_regular(tmp_path / "pipe")


def test_sizes(tmp_path, monkeypatch):
    """At the bound, and a byte beyond."""
    path = tmp_path / "file"
    path.write_bytes(b"x" * 100)
    assert len(read_bytes(path, 100)) == 100
    with pytest.raises(OSError, match="larger than"):
        read_bytes(path, 99)
    size = path.write_text(CASE)
    monkeypatch.setattr(reading, "LARGEST_CASE", size)
    assert Case.load(path).title == "untitled"
    path.write_text(CASE + "#")
    with pytest.raises(InputError, match="cannot be read: it is larger than"):
        Case.load(path)


@pytest.mark.parametrize("read", [Case.load, read_curve])
def test_texts(tmp_path, read):
    """A byte-order mark is none of the text; zeros and names that cannot be are told."""
    path = tmp_path / "file.csv"
    path.write_bytes(b"\xef\xbb\xbf" + (CASE if read == Case.load else CURVE).encode())
    read(path)
    path.write_bytes(b"a = 1\n\0")
    with pytest.raises(InputError, match=r"is not a text file \(byte 7 is zero\)"):
        read(path)
    path.write_bytes(b"")
    with pytest.raises(InputError):
        read(path)
    for name in ("x\0y", "x" * 300, "/".join(["x" * 200] * 30)):
        with pytest.raises(InputError, match='" (cannot be read|does not exist)'):
            read(name)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("a = " + "[" * 5000, "nested too deeply"),
        ("a = " + "{a=" * 5000, "nested too deeply"),
        ("x = 1\n" + ".".join("a" * 300_000) + " = 1", r"more than 32 parts \(at line 2\)"),
        ('"a b" . ' * 300_000 + "c = 1", "more than 32 parts"),
        ("[" + ".".join(["'x'"] * 33) + "]", "more than 32 parts"),
        ("a = 1\nb = " + "9" * 5000, r"thousands of digits \(at line 2\)"),
    ],
    ids=["lists", "tables", "dots", "quoted", "33", "digits"],
)
def test_texts_that_are_hard_to_read(text, message):
    with pytest.raises(ValueError, match=message):
        parse_toml(text)


def test_keys_of_32_parts_are_read():
    assert parse_toml(".".join(["x"] * 32) + " = '1.2.3 and a \"b\".c'")
    assert parse_toml("# " + "sentence. " * 31 + "\na = 'x.'")


def test_json_that_is_hard_to_read(tmp_path):
    path = tmp_path / "summary.json"
    for text in ("[" * 200_000, '{"a":' * 200_000, "9" * 10_000, "[1]", "\xff", "{"):
        path.write_bytes(text.encode("latin-1"))
        assert read_json(path) == {}
    path.write_text(json.dumps({"title": "x" * 100_000, "kind": ["a"]}))
    (tmp_path / "curve.csv").write_text("extension_mm,load_N\n0,0\n1,2\n")
    assert len(read_side(tmp_path).title) == 80
    path.write_text(r'{"title": "\ud800 \u001b[2J", "kind": "x"}')
    assert read_side(tmp_path).title == r"\ud800 \x1b[2J"


@pytest.mark.parametrize(
    "text",
    [
        "a,load_N\n1," + "9" * 200_000,
        "a,load_N\n1,1e300\n",
        '"',
        "a,load_N\n1\n",
        "",
        "\n\n",
        "load_N",
    ],
)
def test_tables_of_ours_that_are_not(tmp_path, text):
    (tmp_path / "curve.csv").write_text(text)
    with pytest.raises(InputError):
        read_side(tmp_path)


# -- measured data ---------------------------------------------------------------------------------


def test_measured_data_has_bounds(tmp_path, monkeypatch):
    path = tmp_path / "data.csv"

    def refused(text, message):
        path.write_text(text)
        with pytest.raises(InputError, match=message):
            read_curve(path)

    refused(CURVE + "6," + "1" * 200_000, "line 7, has 200002 characters")
    refused("x" * 200_000 + " [mm], force [N]\n" + CURVE, "line 1, has")
    refused(CURVE + "6,1e308\n", "goes up to .* N, a force is at most")
    refused(CURVE + "1e307,6\n", "goes up to .* mm, a length is at most")
    for unit in ("mm^9^9^9^9", "mm**9**9**9", "((((mm", "mm*" * 500):
        refused(CURVE.replace("mm", unit), "no column with a unit of displacement")
    monkeypatch.setattr(columns, "MOST_LINES", 6)
    path.write_text(CURVE)
    assert np.allclose(read_curve(path).force, [2, 4, 6, 8, 10])
    refused(CURVE + "6,12\n", "has more than 6 lines")
