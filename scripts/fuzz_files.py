# SPDX-License-Identifier: MIT
"""Give the program random measured data, summaries, manifests and checkpoints; count the ends.

    scripts/fenicsx python3 scripts/fuzz_files.py [N] [--seed S] [--workers W] [--limit SECONDS]

Half of the files are measured data, for `check` with output.measured or `calibrate`. Others lie in
a folder of results: summary.json and curve.csv, for `compare`; the manifest of a folder that `run`
writes to; parts of checkpoints, for `resume`. Some are good, most are good but for a few changes,
with checksums that are right; some are no files at all, see fuzz_cases.py. Each fiftieth goes
through a process of its own. Beside the results lie a user's files, in the folder too; none may
change. Ends, output and exit code are those of fuzz_cases.py.
"""

from __future__ import annotations

import faulthandler
import json
import multiprocessing
import os
import shutil
import subprocess
import sys
from hashlib import sha256
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any

from fuzz_cases import (
    FAULT,
    LENGTHS,
    MEMORY,
    PLACES,
    Maker,
    end_of,
    judged,
    listing,
    options,
    place,
    run,
    user,
)

SORTS = ("data", "summary", "manifest", "checkpoint")
CASE = """
[fabric]
use = "glass-pp-plain-1.93"
[preform]
outline = { rectangle = ["22 mm", "40 mm"] }
bias_angle = "45 deg"
[test]
finite = true
extension = ["0.2 mm", "0.4 mm", "0.6 mm"]
increments = 4
[output]
pictures = false
paraview = false
"""
NUMBERS = (
    "0", "-1", "1e308", "-1e308", "1e999", "1e-320", "nan", "inf", "-inf", "1,5", "1.2.3", "0x10",
    "1_000", "", " ", '"', "'", "#", "1e", "--", "½", "\x1b[2J", "\0", "\ufeff1", "9" * 5000,
    "x" * 200_000,
)  # fmt: skip
UNITS = (
    *LENGTHS, "N", "kN", "lbf", "N/mm", "mm^9^9^9^9", "mm**9**9", "((((mm", "mm*" * 500, "", "%",
    "[", "\x1b[31m", "mm" * 50_000, "deg", "µm", "N·mm²",
)  # fmt: skip


class FileMaker(Maker):
    """Makes jobs: a sort, which file of the folder it is, and what stands there."""

    def job(self) -> tuple[str, tuple[str, Any, bool]]:
        """A sort; a file's name, its bytes, the changes to it or its kind; whether a process."""
        own_process = self.random.random() < 0.02
        sort = self.random.choice(("data", "data", "data", *SORTS[1:]))
        if self.random.random() < 0.15:
            name = {
                "data": "data.csv",
                "summary": self.random.choice(("summary.json", "curve.csv")),
                "manifest": ".cruciform-petsc.json",
                "checkpoint": self.random.choice(
                    [f"{part}/{file}" for part in ("newest", "previous", "state-1")
                     for file in ("manifest.json", "rank-0.npy")]
                    + ["newest", "previous", "state-1", "."]
                ),
            }[sort]  # fmt: skip
            return sort, (name, self.random.choice(PLACES), own_process)
        if sort == "data":
            return sort, ("data.csv", self.data(), own_process)
        if sort == "summary" and self.random.random() < 0.5:
            return sort, ("curve.csv", self.data(ours=True), own_process)
        if sort == "summary":
            return sort, ("summary.json", self.json({"title": "x", "kind": "biaxial"}), own_process)
        if sort == "manifest":
            files = ["curve.csv", "summary.json", "checkpoint"]
            files += self.random.sample(["../home/thesis", "/etc/passwd", "", "a\0b", "x" * 300], 2)
            manifest = {"program": "cruciform_petsc", "files": files}
            is_good = self.random.random() < 0.4
            text = json.dumps(manifest).encode() if is_good else self.json(manifest)
            return sort, (".cruciform-petsc.json", text, own_process)
        part = self.random.choice(("newest", "newest", "newest", "state-1"))
        if self.random.random() < 0.2:
            return sort, (f"{part}/rank-0.npy", self.random.randrange(2**32), own_process)
        return sort, (f"{part}/manifest.json", self.random.randrange(2**32), own_process)

    def data(self, *, ours: bool = False) -> bytes:
        """Measured data, or a table of ours; good, or not."""
        comma = "," if ours else self.random.choice((",", ";", "\t"))
        titles = ["extension_mm", "load_N", "energy_tension_J"]
        if not ours:
            length, force = self.random.choice(LENGTHS), self.random.choice(("N", "kN", "lbf"))
            titles = [f"displacement [{length}]", f"force ({force})", "time [s]"]
        rows = [
            [str(i), *(str(self.random.uniform(0.9, 1.1) * i) for _ in titles[1:])]
            for i in range(1, self.random.randint(2, 60))
        ]
        table = [titles, *rows]
        for _ in range(self.random.choice((0, 0, 0, 1, 1, 3))):
            row = self.random.choice(table)
            how = self.random.randrange(6)
            if how == 0:
                row[self.random.randrange(len(row))] = self.random.choice(NUMBERS)
            elif how == 1:
                titles[self.random.randrange(len(titles))] += self.random.choice(UNITS)
            elif how == 2 and len(row) > 1:
                row.pop()
            elif how == 3:
                row.append(self.random.choice(NUMBERS))
            elif how == 4:
                table.insert(self.random.randrange(len(table)), ["#" * self.random.randint(0, 3)])
            elif len(table) < 100:
                table *= self.random.choice((2, 50, 8000))
        lines, size = [], 0
        for row in table:
            lines.append(comma.join(row))
            size += len(lines[-1])
            if size > 80 << 20:
                break
        text = "\n".join(lines)
        data = text.encode(self.random.choice(("utf-8", "utf-8", "utf-8-sig", "utf-16", "cp437")),
                           "replace")  # fmt: skip
        return self.garbage(data) if data and self.random.random() < 0.2 else data

    def json(self, data: dict[str, Any]) -> bytes:
        """A JSON file, good or not."""
        n = self.random.choice((10, 1_000, 100_000))
        if self.random.random() < 0.2:
            return self.random.choice(
                (
                    b"[" * n, b'{"a":' * n, b"9" * n, b"", b"null", b"[1]", b"\xff", b"\0" * n,
                    json.dumps("x" * n).encode(), b'{"title":"\\ud800"}',
                )
            )  # fmt: skip
        self.spoil(data)
        text = json.dumps(data).encode()
        return self.garbage(text) if self.random.random() < 0.2 else text


def forge(path: Path, seed: int) -> None:
    """Change a file of a checkpoint; mostly with the right checksums."""
    maker = FileMaker(seed)
    if maker.random.random() < 0.1:
        return
    if path.suffix == ".npy" or maker.random.random() < 0.2:
        path.write_bytes(maker.garbage(path.read_bytes()))
    if maker.random.random() < 0.1:
        return
    manifest = path.with_name("manifest.json")
    try:
        data = json.loads(manifest.read_bytes())
        data.pop("sha256", None)
    except ValueError:
        return
    data["hashes"] = [sha256(path.with_name("rank-0.npy").read_bytes()).hexdigest()]
    if path.suffix != ".npy":
        for _ in range(maker.random.randint(1, 2)):
            parts = [*(data.get("run") or {}).values(), data.get("run"), data]
            maker.spoil(
                maker.random.choice([part for part in parts if isinstance(part, dict | list)])
            )
    text = json.dumps(data, separators=(",", ":"), default=repr).encode()
    sealed = b'{"sha256":"' + sha256(text).hexdigest().encode() + b'",' + text[1:]
    manifest.write_bytes(sealed)


def killed(folder: Path) -> None:
    """Leave the results of a run that was killed after three of its increments."""
    from mpi4py import MPI

    from cruciform_petsc.case.schema import Case
    from cruciform_petsc.net.network import Network
    from cruciform_petsc.output.checkpoint import Checkpoint
    from cruciform_petsc.output.folder import unlock_directory

    path = folder.with_suffix(".toml")
    path.write_text(CASE)
    case, steps = Case.load(path), iter(range(2))
    network = Network(MPI.COMM_SELF, case.preform(), case.fabric())
    folder.mkdir()
    checkpoint = Checkpoint.begin(MPI.COMM_SELF, folder, case)
    try:
        case.experiment(network).solve(lambda step: next(steps), checkpoint)
    except StopIteration:
        unlock_directory(folder)


def commands(name: str, results: Path, path: Path, own_process: bool) -> list[str]:
    """What reads a file."""
    if name == "data.csv":
        case = results.with_suffix(".toml")
        if own_process:
            return [
                "calibrate",
                str(case),
                "--data",
                str(path),
                "--output",
                str(results),
                "--quiet",
            ]
        return ["check", str(case), "--quiet", "--set", f"output.measured={json.dumps(str(path))}"]
    if name in ("summary.json", "curve.csv"):
        return ["compare", str(results), str(results), "--output", str(results), "--quiet"]
    if name.startswith("."):
        small = ["--set", "test.finite=false", "--set", 'test.extension="1 mm"']
        case = results.with_suffix(".toml")
        return ["run", str(case), *small, "--output", str(results), "--quiet"]
    return ["resume", str(results), "--quiet"]


def work(connection: Connection, folder: str) -> None:
    """Do jobs as they come; answers (end, what was said)."""
    faulthandler.enable()
    from cruciform_petsc import memory

    memory.machine_memory = lambda: MEMORY
    here = Path(folder) / f"{multiprocessing.current_process().name}-{os.getpid()}"
    own = user(here / "home")
    good, results = here / "good", here / "results"
    killed(good)
    before = listing(own)
    while True:
        name, content, own_process = connection.recv()
        shutil.rmtree(results, ignore_errors=True)
        shutil.copytree(good, results)
        shutil.copy(good.with_suffix(".toml"), results.with_suffix(".toml"))
        (results / "notes.txt").write_text("mine")
        if len(str(content)) % 2:  # else `run` and `resume` go on
            (results / "scene.png").symlink_to(own / "thesis" / "chapter1.tex")
        if name.endswith((".json", ".csv")) and "/" not in name:
            (results / "curve.csv").write_text("extension_mm,load_N\n0,0\n1,2\n2,5\n")
            (results / "summary.json").write_text('{"title": "x", "kind": "bias-extension"}')
        path = results / name
        if "/" in name or name in ("newest", "previous", "state-1", "."):
            path = results / "checkpoint" / name
        if isinstance(content, int):
            forge(path, content)
        else:
            content = own / "thesis" if content == "folder" else content
            if path.is_dir():
                shutil.rmtree(path)
            if isinstance(content, Path):
                path.unlink(missing_ok=True)
                path.symlink_to(content)  # a link to a folder of the user's
            else:
                place(path, content)
        arguments = commands(name, results, path, own_process)
        if own_process:
            done = subprocess.run(
                [sys.executable, "-m", "cruciform_petsc", *arguments],
                capture_output=True, text=True, stdin=subprocess.DEVNULL, errors="replace",
            )  # fmt: skip
            end, text = judged(done.returncode, done.stderr), done.stderr
        else:
            end, text = end_of(arguments)
        if listing(own) != before or (results / "notes.txt").read_text() != "mine":
            end, text = FAULT, f"files of the user's have changed; {text}"
        connection.send((end, text))


if __name__ == "__main__":
    args = options(2000, 60.0).parse_args()
    sys.exit(run(args, FileMaker(args.seed).job, SORTS, work))
