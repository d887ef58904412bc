# SPDX-License-Identifier: MIT
"""Put random case files through `cruciform-petsc check` and count what becomes of them.

    scripts/fenicsx python3 scripts/fuzz_cases.py [N] [--seed S] [--workers W] [--limit SECONDS]

A third of the files are meant to be good, a third good but for one to three changes (keys taken
out, put in, swapped, absurd values, numbers larger or smaller by orders of magnitude), a third are
barely case files: bytes changed, lines mixed, noise. The machine is said to have 0.5 GB, so that no
network takes long. Each goes through the command line in a worker process, with a time limit. Four
ends are possible: ok; refused in sentences, one a problem; a traceback, a crash or other words; no
end within the limit. Exit code 1 if there is any of the last two; such files are kept.
"""

from __future__ import annotations

import argparse
import contextlib
import faulthandler
import io
import json
import math
import multiprocessing
import random
import re
import subprocess
import sys
import tempfile
import time
from collections import Counter
from functools import lru_cache
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any

# The parent starts processes and is no rank itself: what needs MPI is imported in the workers.
from cruciform_petsc.experiments.registry import KINDS

MEMORY = 500_000_000  # bytes
OK, REFUSED, FAULT, HANG = "ok", "refused", "traceback", "hang"

LENGTHS = ("mm", "cm", "m", "in", "um")
ABSURD: tuple[Any, ...] = (
    0, -1, 1, 10**9, 10**30, -(2**63), 1e308, -1e308, 5e-324, math.nan, math.inf, -math.inf,
    True, False, "", " ", "0 mm", "-1 mm", "1e308 m", "1e-308 m", "1e400 m", "nan mm", "inf deg",
    "1 deg", "1e6 deg", "1 N", "-5 N", "1e300 N", "1 %", "-100 %", "1e9 %", "1 mm mm", "1 mm^99",
    "1 mm^-1", "1 / mm", "10 /mm", "1e12 /mm", "1e-12 /mm", "1 N/mm", "1e-300 N/mm", "1e300 N/mm",
    "1 furlong", "1,5 mm", "½ mm", "1 \u0000mm", "9" * 400 + " mm", "1 mm" * 50, "1 m**1e9",
    "((((1 mm", "1 (mm", "mm", "\N{PILE OF POO}", [], [[]], [[[]]], {}, {"a": {}}, ["1 mm"],
    ["1 mm", "2 mm"], ["0 mm", "0 mm", "0 mm"], [1, 2], [math.nan, math.nan], ["1 mm"] * 100,
    [["0 mm", "0 mm"]] * 3, "off", "bias-extension", "picture-frame", "log", "table", "__class__",
)  # fmt: skip


class Maker:
    """Makes case files from a seed."""

    def __init__(self, seed: int):
        self.random = random.Random(seed)

    def case(self) -> tuple[str, bytes]:
        """A sort and a file of it."""
        sort = self.random.choice(("good", "nearly", "garbage"))
        data = self.good()
        if sort == "nearly":
            for _ in range(self.random.randint(1, 3)):
                self.spoil(data)
        text = toml(data).encode("utf-8", "surrogatepass")
        return sort, self.garbage(text) if sort == "garbage" else text

    # -- good -------------------------------------------------------------------------------------

    def quantity(self, low: float, high: float, unit: str) -> str:
        """A number between two, spread evenly over its magnitudes."""
        value = math.exp(self.random.uniform(math.log(low), math.log(high)))
        return f"{value:.{self.random.randint(2, 17)}g} {unit}"

    def length(self, low: float = 0.02, high: float = 0.3) -> str:
        """A length [m] in some unit."""
        unit = self.random.choice(LENGTHS)
        size = {"mm": 1e-3, "cm": 1e-2, "m": 1.0, "in": 0.0254, "um": 1e-6}[unit]
        return self.quantity(low / size, high / size, unit)

    def maybe(self, table: dict[str, Any], key: str, value: Any, share: float = 0.3) -> None:
        """Put a key in, sometimes."""
        if self.random.random() < share:
            table[key] = value

    def some(self, low: float, high: float, unit: str) -> str | list[str]:
        """One quantity or several."""
        if self.random.random() < 0.5:
            return self.quantity(low, high, unit)
        return [self.quantity(low, high, unit) for _ in range(self.random.randint(1, 5))]

    def points(self, most: float) -> list[list[float]]:
        """Points of a rising table."""
        x = sorted(self.random.uniform(0.01, most) for _ in range(self.random.randint(1, 8)))
        y = sorted(self.random.uniform(0.001, 10) for _ in x)
        return [list(point) for point in zip(x, y, strict=True)]

    def shear(self) -> dict[str, Any]:
        """A law of shear."""
        k = [self.quantity(1e-3, 1, "N/mm") for _ in range(self.random.randint(1, 4))]
        return self.random.choice(
            (
                {"modulus": self.quantity(1e-3, 10, "N/cm")},
                {"law": "table", "angle": "deg", "force": "N/mm", "points": self.points(60)},
                {"law": "polynomial", "coefficients": k},
                {"law": "sin-potential", "coefficients": k},
            )
        )

    def fabric(self) -> dict[str, Any]:
        """A cloth of the library or one of its own."""
        table: dict[str, Any] = {}
        if self.random.random() < 0.5:
            table["use"] = self.random.choice(
                ("e-glass-plain-2.4", "glass-pp-plain-1.93", "pantographic-sheet-2016")
            )
            self.maybe(table, "shear", self.shear())
        else:
            for side in ("warp", "weft"):
                table[side] = {
                    "poisson": 0,
                    "yarns": self.quantity(1, 10, "/cm"),
                    "yarn_bending": self.quantity(1e-2, 10, "N mm^2"),
                }
                if self.random.random() < 0.7:
                    table[side]["modulus"] = self.quantity(10, 1e4, "N/cm")
                else:
                    law = {"law": "table", "strain": "%", "force": "N/cm"}
                    table[side]["tension"] = law | {"points": self.points(5)}
            table["shear"] = self.shear()
        self.maybe(
            table, "tension", {"strain": self.random.choice(("log", "engineering")),
                               "compression": self.random.uniform(1e-3, 1)}
        )  # fmt: skip
        return table

    def outline(self, upright: bool) -> dict[str, Any]:
        """A rectangle, or a star-shaped polygon with flat ends, perhaps with a hole."""
        if upright or self.random.random() < 0.6:
            table: dict[str, Any] = {"rectangle": [self.length(), self.length()]}
        else:
            size, n = self.random.uniform(0.03, 0.2), self.random.randint(0, 6)
            right = sorted(self.random.uniform(0.05, 0.95) for _ in range(n))
            left = sorted((self.random.uniform(0.05, 0.95) for _ in range(n)), reverse=True)
            corners = [(-0.5, 0.0), (0.5, 0.0)]
            corners += [(self.random.uniform(0.1, 0.9), y) for y in right]
            corners += [(0.5, 1.0), (-0.5, 1.0)]
            corners += [(-self.random.uniform(0.1, 0.9), y) for y in left]
            table = {"polygon": [[f"{size * x:.9g} m", f"{size * y:.9g} m"] for x, y in corners]}
        if self.random.random() < 0.3:
            y, r = self.random.uniform(0.01, 0.02), self.random.uniform(1e-4, 8e-3)
            corners = [(-r, y - r), (r, y - r), (r, y + r), (-r, y + r)]
            table["holes"] = [[[f"{a:.9g} m", f"{b:.9g} m"] for a, b in corners]]
        return table

    def good(self) -> dict[str, Any]:
        """A case that should be good, though its lattice may not fit its outline."""
        kind = self.random.choice(tuple(KINDS))
        upright = kind in ("picture-frame", "biaxial", "cantilever")
        test: dict[str, Any] = {"kind": kind, "finite": self.random.random() < 0.5}
        control = {
            "picture-frame": ("angle", self.some(1, 60, "deg")),
            "biaxial": ("strain", self.some(0.01, 2, "%")),
            "cantilever": ("load", self.some(1e-4, 1, "N")),
        }.get(kind, ("extension", self.some(0.1, 20, "mm")))
        test[control[0]] = control[1]
        if kind != "cantilever":
            self.maybe(test, "bending", self.random.random() < 0.5)
        self.maybe(test, "increments", self.random.randint(1, 50))
        angle = self.quantity(0.1, 180, "deg")
        preform: dict[str, Any] = {
            "outline": self.outline(upright),
            "bias_angle": self.random.choice(("0 deg", "90 deg")) if upright
            else self.random.choice(("45 deg", "30 deg", angle)),
        }  # fmt: skip
        self.maybe(preform, "refine", self.random.randint(1, 4))
        self.maybe(preform, "origin", [self.length(1e-3), self.length(1e-3)])
        data = {"title": "Grün \"'\\ §", "fabric": self.fabric(), "preform": preform, "test": test}
        self.maybe(data, "continuum", {"mesh_size": self.length(0.005)})
        self.maybe(data, "solver", {"options": {"ksp_type": "cg", "ksp_rtol": 1e-8}})
        self.maybe(data, "output", {"directory": "results/x", "pictures": False})
        return data

    # -- not good ---------------------------------------------------------------------------------

    def spoil(self, data: dict[str, Any]) -> None:
        """Change one thing somewhere."""
        places: list[tuple[Any, Any]] = []

        def walk(node: Any) -> None:
            for key in node if isinstance(node, dict) else range(len(node)):
                places.append((node, key))
                if isinstance(node[key], dict | list):
                    walk(node[key])

        walk(data)
        if not places:
            return
        node, key = self.random.choice(places)
        how = self.random.randrange(9)
        if how >= 5:
            self.rescale(places)
        elif how == 0:
            del node[key]
        elif how == 1 and isinstance(node, dict):
            other = self.random.choice(places)[1]
            node[str(other)] = self.random.choice(ABSURD)
        elif how == 2 and isinstance(node, list):
            node.extend(node[:] * self.random.randint(1, 3))
        elif how == 3:
            other, its = self.random.choice(places)
            node[key] = toml_copy(other[its])
        else:
            node[key] = self.random.choice(ABSURD)

    def rescale(self, places: list[tuple[Any, Any]]) -> None:
        """Change one number, with or without a unit, by some orders of magnitude."""
        numbers = [(node, key, *parts) for node, key in places if (parts := _number(node[key]))]
        if numbers:
            node, key, value, unit = self.random.choice(numbers)
            value *= self.random.choice((-1, 1, 1, 1, 1)) * 10 ** self.random.uniform(-8, 8)
            if unit is not None:
                node[key] = f"{value:.9g}{unit}"
            else:
                node[key] = round(value) if isinstance(node[key], int) else value

    def garbage(self, text: bytes) -> bytes:
        """Barely a case file."""
        how = self.random.randrange(6)
        if how == 0:
            return self.random.randbytes(self.random.randint(0, 400))
        if how == 1:
            lines = text.splitlines(keepends=True)
            self.random.shuffle(lines)
            return b"".join(lines)
        if how == 2:
            return text[: self.random.randint(0, len(text))]
        if how == 3:
            lines = self.random.choice(new_cases()).encode().splitlines(keepends=True)
            return b"".join(
                line[2:] if line.startswith(b"# ") and self.random.random() < 0.2 else line
                for line in lines
                if self.random.random() < 0.9
            )
        if how == 4:
            digits = [i for i, byte in enumerate(text) if byte in b"0123456789"]
            changed = bytearray(text)
            for i in self.random.sample(digits, min(len(digits), 5)):
                changed[i] = self.random.choice(b"0123456789.eE-+")
            return bytes(changed)
        changed = bytearray(text)
        for _ in range(self.random.randint(1, 6)):
            changed[self.random.randrange(len(changed))] = self.random.randrange(256)
        return bytes(changed)


def _number(value: Any) -> tuple[float, str | None] | None:
    """Number and unit of a quantity; the unit of a bare number is None."""
    if isinstance(value, str):
        match = re.match(r"([-+.\de]+)( .*)", value)
        with contextlib.suppress(ValueError):
            return (float(match[1]), match[2]) if match else None
    elif isinstance(value, int | float) and not isinstance(value, bool):
        with contextlib.suppress(OverflowError):
            return (float(value), None) if math.isfinite(value) else None
    return None


def toml_copy(value: Any) -> Any:
    """A copy that shares nothing."""
    if isinstance(value, dict):
        return {key: toml_copy(entry) for key, entry in value.items()}
    return [toml_copy(entry) for entry in value] if isinstance(value, list) else value


def toml(data: dict[str, Any]) -> str:
    """A case as TOML, each top-level table as a section."""
    values = {key: value for key, value in data.items() if not isinstance(value, dict)}
    lines = [f"{key} = {_value(value)}" for key, value in values.items()]
    for name, table in data.items():
        if isinstance(table, dict):
            lines += [f"[{name}]", *(f"{key} = {_value(value)}" for key, value in table.items())]
    return "\n".join(lines) + "\n"


@lru_cache(maxsize=1)
def new_cases() -> list[str]:
    """What `new` writes, from a process of its own."""
    code = (
        "import json\n"
        "from cruciform_petsc.case.template import new_case\n"
        "from cruciform_petsc.experiments.registry import KINDS\n"
        "print(json.dumps([new_case(kind) for kind in KINDS]))"
    )
    command = [sys.executable, "-c", code]
    return json.loads(subprocess.run(command, capture_output=True, text=True, check=True).stdout)


def _value(value: Any) -> str:
    """Write a value as TOML, on one line."""
    if isinstance(value, dict):
        return f"{{ {', '.join(f'{key} = {_value(entry)}' for key, entry in value.items())} }}"
    if isinstance(value, list | tuple):
        return f"[{', '.join(_value(entry) for entry in value)}]"
    text = json.dumps(value, ensure_ascii=False)
    return text.replace("NaN", "nan").replace("Infinity", "inf").replace("\x7f", "")


def work(connection: Connection, folder: str) -> None:
    """Check files as they come; answers (end, what was said)."""
    faulthandler.enable()
    from cruciform_petsc import memory
    from cruciform_petsc.cli import main

    memory.machine_memory = lambda: MEMORY
    path = Path(folder) / f"case-{multiprocessing.current_process().name}.toml"
    while True:
        path.write_bytes(connection.recv_bytes())
        said = io.StringIO()
        with contextlib.redirect_stdout(io.StringIO()), contextlib.redirect_stderr(said):
            code = main(["check", str(path), "--quiet"])
        text = said.getvalue()
        # A sentence, or one for each problem, on lines of their own below the first.
        first, *more = text.splitlines() or [""]
        told = first.startswith("cruciform-petsc: ") and all(line.startswith("  ") for line in more)
        end = OK if code == 0 and not text else REFUSED if code == 2 and told else FAULT
        connection.send((end, text))


class Worker:
    """A process that checks one file at a time, replaced when it crashes or takes too long."""

    def __init__(self, folder: str, limit: float):
        self.folder, self.limit = folder, limit
        self.start()

    def start(self) -> None:
        """Start a fresh process."""
        context = multiprocessing.get_context("spawn")
        self.connection, there = context.Pipe()
        self.process = context.Process(target=work, args=(there, self.folder), daemon=True)
        self.process.start()
        there.close()
        self.since: float | None = None
        self.file: tuple[str, bytes] = ("", b"")

    def give(self, file: tuple[str, bytes]) -> None:
        """Hand out a file."""
        self.file, self.since = file, time.monotonic()
        self.connection.send_bytes(file[1])

    def answer(self) -> tuple[str, str] | None:
        """What became of the file, or None if that is not known yet."""
        assert self.since is not None
        end = None
        try:
            if self.connection.poll():
                end = self.connection.recv()
        except (EOFError, ConnectionError):
            self.process.join()
            end = FAULT, f"the process ended with {self.process.exitcode}"
        if end is None and time.monotonic() - self.since > self.limit:
            end = HANG, f"no answer within {self.limit:g} s"
        if end is not None and not (self.process.is_alive() and end[0] != HANG):
            self.process.kill()
            self.start()
        elif end is not None:
            self.since = None
        return end


def main() -> int:
    """Run as many files as asked for."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("number", nargs="?", type=int, default=2000, metavar="N")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--limit", type=float, default=60.0, help="seconds for one file")
    parser.add_argument("--keep", default="fuzz-failures", help="folder of files that failed")
    args = parser.parse_args()
    maker, left = Maker(args.seed), args.number
    counts: Counter[tuple[str, str]] = Counter()
    begin, slowest = time.monotonic(), 0.0
    with tempfile.TemporaryDirectory() as folder:
        workers = [Worker(folder, args.limit) for _ in range(max(1, args.workers))]
        while left or any(worker.since is not None for worker in workers):
            for worker in workers:
                since, file = worker.since, worker.file
                if since is None and left:
                    worker.give(maker.case())
                    left -= 1
                elif since is not None:
                    end = worker.answer()
                    if end is not None:
                        slowest = max(slowest, time.monotonic() - since)
                        counts[file[0], end[0]] += 1
                        if end[0] in (FAULT, HANG):
                            _keep(Path(args.keep), sum(counts.values()), file[1], end)
            time.sleep(0.001)
        for worker in workers:
            worker.process.kill()
    ends = (OK, REFUSED, FAULT, HANG)
    print(f"{'':10}" + "".join(f"{end:>11}" for end in ends))
    for sort in ("good", "nearly", "garbage"):
        print(f"{sort:10}" + "".join(f"{counts[sort, end]:11d}" for end in ends))
    print(f"{args.number} files in {time.monotonic() - begin:.0f} s, slowest {slowest:.1f} s")
    return int(any(count and end in (FAULT, HANG) for (_, end), count in counts.items()))


def _keep(folder: Path, number: int, file: bytes, end: tuple[str, str]) -> None:
    folder.mkdir(parents=True, exist_ok=True)
    path = folder / f"{end[0]}-{number}.toml"
    path.write_bytes(file)
    print(f"{end[0]}: {path}\n{end[1][-1500:]}", flush=True)


if __name__ == "__main__":
    sys.exit(main())
