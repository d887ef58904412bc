# SPDX-License-Identifier: MIT
"""How all that comes from outside is read: regular files of bounded size, and plain text.

A pipe, a device or a file without end would be waited for, or take all memory.
"""

from __future__ import annotations

import errno
import io
import json
import os
import re
import stat
import tomllib
from difflib import get_close_matches
from pathlib import Path
from typing import Any

from .errors import InputError

MIB = 1 << 20
LARGEST = 64 * MIB  # of what the program has written: summaries, manifests, tables
LARGEST_CASE = 4 * MIB
_PARTS = 32
# A key of many parts takes tomllib longer than their number, squared.
_LONG_KEY = re.compile(
    rf"""(?<![\w"'\\-])(?>(?>[\w-]+|"(?:[^"\\\n]|\\.)*"|'[^'\n]*')[ \t]*\.[ \t]*){{{_PARTS}}}"""
)


def open_regular(path: Path, *, follow: bool = False) -> io.BufferedReader:
    """Open a regular file for reading, without ever waiting; OSError for a pipe, a device ...

    ``follow``: it may be a link to one.
    """
    flags = os.O_NONBLOCK | (0 if follow else os.O_NOFOLLOW)
    if stat.S_ISREG((os.stat if follow else os.lstat)(path).st_mode):
        handle = os.open(path, os.O_RDONLY | flags)
        if stat.S_ISREG(os.fstat(handle).st_mode):  # it may have been replaced
            return os.fdopen(handle, "rb")
        os.close(handle)
    elif os.path.isdir(path):
        raise IsADirectoryError(errno.EISDIR, os.strerror(errno.EISDIR))
    raise OSError(errno.EINVAL, "it is no regular file")


def read_bytes(path: Path, most: int = LARGEST, *, follow: bool = False) -> bytes:
    """Read a regular file of at most ``most`` bytes; OSError if it is another.

    Files of the kernel (/proc), whose size is told as 0, are taken for empty.
    """
    with open_regular(path, follow=follow) as file:
        size = os.fstat(file.fileno()).st_size
        data = file.read(most + 1) if 0 < size <= most else b""
    if max(size, len(data)) > most:
        raise OSError(errno.EFBIG, f"it is larger than {most / MIB:g} MiB")
    return data


def read_given(path: str | Path, what: str, kind: str, most: int, *, zeros: bool = False) -> bytes:
    """Read a file that the user has named; an InputError tells what is wrong with it.

    ``what``: what it is called in the sentence; ``kind``: of file, as its name ends, "CSV";
    ``zeros``: there may be bytes of zero, which the caller sees to.
    """
    path = Path(path)
    try:
        data = read_bytes(path, most, follow=True)
        if zeros or b"\0" not in data or data[:2] in (b"\xff\xfe", b"\xfe\xff"):  # UTF-16
            return data
        problem = f"is not a text file (byte {data.index(0) + 1} is zero)"
    except FileNotFoundError:
        near = [other.name for other in path.parent.glob(f"*.{kind.lower()}")]
        close = get_close_matches(path.name, near, 1)
        problem = "does not exist"
        problem += f', did you mean "{path.parent / close[0]}"?' if close else ""
    except IsADirectoryError:
        problem = f"is a folder, name a {kind} file in it"
    except OSError as error:
        problem = f"cannot be read: {error.strerror}"
    except ValueError as error:  # a null byte in the path
        problem = f"cannot be read: {error}"
    raise InputError(f'{what} "{path}" {problem}')


def read_toml(path: str | Path, what: str) -> tuple[str, dict[str, Any]]:
    """Text of a TOML file that the user has named, and its data; all that fails is one sentence."""
    data = read_given(path, what, "TOML", LARGEST_CASE)
    problem = "is empty"
    try:
        if data.strip():
            text = data.decode("utf-8-sig")
            return text, parse_toml(text)
    except UnicodeDecodeError as error:
        problem = f"is not UTF-8 text (byte {error.start + 1}), save it as UTF-8"
    except ValueError as error:
        problem = f"is not TOML: {error}"
    raise InputError(f'{what} "{path}" {problem}')


def parse_toml(text: str) -> dict[str, Any]:
    """Read TOML; a ValueError says in words why it is none."""
    long = _LONG_KEY.search(text)
    if long is not None:
        line = text.count("\n", 0, long.start()) + 1
        raise ValueError(f"a key of more than {_PARTS} parts (at line {line})")
    try:
        return tomllib.loads(text)
    except RecursionError:
        raise ValueError("lists or tables are nested too deeply") from None
    except tomllib.TOMLDecodeError:
        raise
    except ValueError:  # Python's limit to whole numbers
        digits = re.search(r"\d[\d_]{4000}", text)
        line = text.count("\n", 0, digits.start()) + 1 if digits else 1
        raise ValueError(f"a whole number of thousands of digits (at line {line})") from None


def read_json(path: Path, *, follow: bool = False) -> dict[str, Any]:
    """Read an object from a JSON file; empty if there is none, or something else."""
    try:
        data = json.loads(read_bytes(path, follow=follow))
    except (OSError, ValueError, RecursionError):
        return {}
    return data if isinstance(data, dict) else {}
