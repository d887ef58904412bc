# SPDX-License-Identifier: MIT
"""The script of random case files runs, and tells ends apart."""

import runpy
import subprocess
import sys
from pathlib import Path

SCRIPT = Path(__file__).parents[1] / "scripts" / "fuzz_cases.py"


def test_random_cases(tmp_path):
    """A few dozen files: each ok or refused, and some of both."""
    command = [sys.executable, str(SCRIPT), "60", "--seed", "2", "--keep", str(tmp_path / "kept")]
    result = subprocess.run(command, capture_output=True, text=True, timeout=300, check=False)
    assert result.returncode == 0, result.stdout + result.stderr
    assert not (tmp_path / "kept").exists()
    rows = [line.split() for line in result.stdout.splitlines()[1:5]]
    assert [row[0] for row in rows] == ["good", "nearly", "garbage", "special"]
    good, *bad = ([int(number) for number in row[1:3]] for row in rows)
    assert sum(good) + sum(map(sum, bad)) == 60
    assert good[0] > 2 * good[1]  # most of those that are meant to be good are
    assert sum(refused for _, refused in bad) > 10


def test_random_files(tmp_path):
    """Measured data, summaries, manifests and checkpoints: the same, and nothing of a user's."""
    script = SCRIPT.with_name("fuzz_files.py")
    command = [sys.executable, str(script), "30", "--seed", "8", "--workers", "1"]
    command += ["--keep", str(tmp_path / "kept")]
    result = subprocess.run(command, capture_output=True, text=True, timeout=300, check=False)
    assert result.returncode == 0, result.stdout + result.stderr
    assert not (tmp_path / "kept").exists()
    rows = [line.split() for line in result.stdout.splitlines()[1:5]]
    assert [row[0] for row in rows] == ["data", "summary", "manifest", "checkpoint"]
    ok, refused = (sum(int(row[i]) for row in rows) for i in (1, 2))
    assert ok + refused == 30
    assert min(ok, refused) > 5


def test_same_seed_same_files():
    """Files follow from the seed, so that counts can be repeated."""
    maker = runpy.run_path(str(SCRIPT))["Maker"]
    first, second, other = maker(3), maker(3), maker(4)
    files = [first.case() for _ in range(50)]
    assert files == [second.case() for _ in range(50)]
    assert files != [other.case() for _ in range(50)]
