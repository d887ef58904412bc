# SPDX-License-Identifier: MIT
"""Put random case files through `cruciform-petsc check` and count what becomes of them.

    scripts/fenicsx python3 scripts/fuzz_cases.py [N] [--seed S] [--workers W] [--limit SECONDS]

Three tenths of the files are meant to be good, three good but for one to three changes (keys taken
out, put in, swapped, absurd values, numbers larger or smaller by orders of magnitude), three are
barely case files: bytes changed, lines mixed, noise. The last tenth are no files (pipes, devices,
folders, links), or without measure (nested, long, many, huge). The machine is said to have 0.2 GB,
so that no network takes long. Each goes through the command line in a worker process, with a time
limit. Four ends are possible: ok; refused with one sentence; a traceback, a crash, more than a
sentence, or a file of the user's that has changed; no end within the limit. Exit code 1 if there
is any of the last two; such files are kept.
"""

from __future__ import annotations

import argparse
import contextlib
import faulthandler
import hashlib
import io
import json
import math
import multiprocessing
import os
import random
import re
import socket
import stat
import subprocess
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Callable, Sequence
from functools import lru_cache
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any

# The parent starts processes and is no rank itself: what needs MPI is imported in the workers.
from cruciform_petsc.errors import harmless
from cruciform_petsc.experiments.registry import KINDS

MEMORY = 200_000_000  # bytes
SORTS = ("good", "nearly", "garbage", "special")
# A file's bytes; or what is in its place: one of PLACES, or a name too long for it.
Payload = bytes | str
PLACES = (
    "pipe", "socket", "folder", "sparse", "nothing", "/dev/zero", "/dev/random", "/dev/full", ".",
    "/proc/self/mem", "/proc/self/pagemap", "/proc/kmsg", "/proc/self/maps", "special",
)  # fmt: skip
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

    def case(self) -> tuple[str, Payload]:
        """A sort and a file of it."""
        sort = self.random.choice(3 * SORTS[:3] + SORTS[3:])
        if sort == "special":
            return sort, self.special(toml(self.good()))
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

    def outline(self, upright: bool, least: float = 0.02) -> dict[str, Any]:
        """A rectangle, or a star-shaped polygon with flat ends, perhaps with a hole."""
        if upright or self.random.random() < 0.6:
            table: dict[str, Any] = {"rectangle": [self.length(least), self.length(least)]}
        else:
            size, n = self.random.uniform(max(0.03, least), 0.3), self.random.randint(0, 6)
            right = sorted(self.random.uniform(0.05, 0.95) for _ in range(n))
            left = sorted((self.random.uniform(0.05, 0.95) for _ in range(n)), reverse=True)
            corners = [(-0.5, 0.0), (0.5, 0.0)]
            corners += [(self.random.uniform(0.1, 0.9), y) for y in right]
            corners += [(0.5, 1.0), (-0.5, 1.0)]
            corners += [(-self.random.uniform(0.1, 0.9), y) for y in left]
            table = {"polygon": [[f"{size * x:.9g} m", f"{size * y:.9g} m"] for x, y in corners]}
        if self.random.random() < 0.3:
            y, r = self.random.uniform(0.008, 0.011), self.random.uniform(1e-4, 7e-3)
            corners = [(-r, y - r), (r, y - r), (r, y + r), (-r, y + r)]
            table["holes"] = [[[f"{a:.9g} m", f"{b:.9g} m"] for a, b in corners]]
        return table

    def good(self) -> dict[str, Any]:
        """A case that should be good, though its lattice may not fit its outline."""
        kind = self.random.choice((*KINDS, *2 * ("forming",)))
        if kind == "forming":
            return self.forming()
        others = {"fishnet": self.fishnet, "drape": self.drape, "inflation": self.inflation}
        if kind in others:
            return others[kind]()
        along = ("picture-frame", "biaxial", "biaxial-load", "cantilever", "pull-out")
        upright = kind in along
        test: dict[str, Any] = {"kind": kind, "finite": self.random.random() < 0.5}
        control = {
            "picture-frame": ("angle", self.some(1, 60, "deg")),
            "biaxial": ("strain", self.some(0.01, 2, "%")),
            "biaxial-load": ("tension", self.some(0.01, 10, "N/cm")),
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
        if kind == "biaxial-load" and self.random.random() < 0.7:
            width = self.random.uniform(0.02, 0.1)
            cross = {"cross": [f"{3 * width:.6g} m", f"{width:.6g} m"]}
            preform["outline"] = cross
            self.maybe(cross, "arm_slits", self.random.randint(1, 5), 0.5)
        if kind == "pull-out":  # of one yarn
            test |= {"slip": {"force": self.quantity(1e-3, 1, "N")}, "finite": True}
        else:
            self.maybe(preform, "refine", self.random.randint(1, 4))
        self.maybe(preform, "origin", [self.length(1e-3), self.length(1e-3)])
        fabric = self.fabric()
        if kind == "pull-out":  # whose warp and weft have no strain in common
            fabric |= {"use": "glass-pp-plain-1.93"} if "use" in fabric else {}
        if test["finite"]:
            self.maybe(test, "space", True, 0.1 if "use" in fabric else 0.0)
            self.maybe(fabric, "shear_friction", {"torque": self.quantity(0.1, 10, "N/m")}, 0.1)
        if (
            test["finite"]
            and kind in ("bias-extension", "picture-frame")
            and self.random.random() < 0.2
        ):
            fabric["shear_viscosity"] = {"viscosity": self.quantity(0.1, 100, "N s/m")}
            speed = {"picture-frame": self.quantity(1, 100, "deg/min")}
            test["speed"] = speed.get(kind, self.quantity(1, 1000, "mm/min"))
        data = {"title": "Grün \"'\\ §", "fabric": fabric, "preform": preform, "test": test}
        self.maybe(data, "continuum", {"mesh_size": self.length(0.002, 0.019)})
        self.maybe(data, "solver", {"options": {"ksp_type": "cg", "ksp_rtol": 1e-8}})
        self.maybe(data, "output", {"directory": "results/x", "pictures": False})
        return data

    def shape(self) -> dict[str, Any]:
        """Of a tool."""
        size, begin = self.random.uniform(0.01, 0.08), self.random.choice((-90, 0, 45))
        end = begin + self.random.uniform(10, 180)
        file = self.random.choice(
            (*8 * ("punch.stl",), "hole.stl", "noise.stl", "none.stl", "thesis")
        )
        radius, outer = f"{size:.6g} m", f"{2.5 * size:.6g} m"
        corners = [[f"{k * size:.6g} m", f"{(k % 2) * size / 4:.6g} m"] for k in range(4)]
        shapes: tuple[dict[str, Any], ...] = (
            {"plane": {}},
            {"plane": {"size": [radius, outer], "edge_radius": "1 mm"}},
            {"sphere": {"radius": radius, "shaft": self.random.random() < 0.5}},
            {"cylinder": {"radius": radius, "length": outer}},
            {"box": {"size": [radius, outer, radius], "edge_radius": f"{size / 9:.6g} m"}},
            {"ring": {"outer_radius": outer}},
            {"ring": {"inner_radius": radius, "outer_radius": outer,
                      "from": f"{begin} deg", "to": f"{end:.6g} deg"}},
            {"revolve": {"opening_radius": radius, "fillet": f"{size / 9:.6g} m",
                         "outer_radius": outer}},
            {"revolve": {"profile": corners, "fillets": f"{size / 20:.6g} m", "spine": radius}},
            {"extrude": {"profile": corners, "smooth": True}},
            {"file": file, "unit": self.random.choice(("mm", "in")),
             "cell": self.length(1e-3, 1e-2)},
        )  # fmt: skip
        shape = self.random.choice(shapes)
        self.maybe(shape, "side", self.random.choice(("+z", "-z")))
        return shape

    def place(self, most: float = 0.05) -> list[str]:
        """Three lengths of either sign, some of them zero."""
        return [f"{self.random.choice((0.0, 1.0)) * self.random.uniform(-most, most):.4g} m"
                for _ in range(3)]  # fmt: skip

    def stage(
        self, number: int, tools: list[str], clamps: list[str], whole: bool
    ) -> dict[str, Any]:
        """What some of the tools do next; up and down only, if the blank is no whole one."""
        table: dict[str, Any] = {"name": f"stage {number}"}
        doing = self.random.sample(tools, self.random.randint(0, len(tools)))
        for name in doing:
            force = self.random.choice((self.quantity(0.1, 1e3, "N"), ["0 N", "0 N", "-5 N"]))
            turn = {"angle": "5 deg", "axis": [0.0, 0.0, 1.0]}
            self.maybe(turn, "through", self.place())
            key, value = self.random.choice(
                (("travel", self.place() if whole else ["0 mm", "0 mm", "5 mm"]),
                 ("travel", ["0 mm", "0 mm", "-20 mm"]), ("force", force), ("remove", name),
                 ("turn", turn) if whole else ("force", force))
            )  # fmt: skip
            if key == "remove":
                table.setdefault("remove", []).append(name)
                tools.remove(name)
                continue
            table.setdefault(key, {})[name] = value
            if key != "force":
                curve = [[0.0, 0.0], [0.5, self.random.random()], [1.0, 1.0]]
                self.maybe(table, "curve", {name: curve}, 0.1)
        kept = {"radius": self.length()}, {"rectangle": [self.length(), self.length()]}
        self.maybe(table, "trim", self.random.choice(kept), 0.1)
        if clamps and self.random.random() < 0.2:
            table["release"] = [clamps.pop()]
        self.maybe(
            table, "pressure", self.quantity(1, 1e5, "Pa"), 0.3 if len(clamps) == 4 else 0.01
        )
        self.maybe(table, "suction", "-" + self.quantity(1, 1e2, "kPa"), 0.2)
        self.maybe(table, "results", self.random.randint(1, 20))
        self.maybe(table, "step", self.random.uniform(0.01, 1.0))
        return table

    def laid(self) -> dict[str, Any]:
        """How a fishnet is laid."""
        table: dict[str, Any] = {}
        self.maybe(table, "seed", self.place()[:2])
        self.maybe(table, "place", self.place()[:2], 0.1)
        self.maybe(table, "turn", self.quantity(0.1, 90, "deg"))
        self.maybe(table, "between", self.quantity(1, 170, "deg"), 0.1)
        self.maybe(table, "generators", self.random.choice(("geodesic", "upright")))
        self.maybe(table, "warp_line", [self.place()[:2], ["0 m", "0 m"], self.place()[:2]], 0.2)
        self.maybe(table, "locking_angle", self.quantity(1, 89, "deg"), 0.2)
        self.maybe(table, "least_energy", {"places": 1, "turn": "0 deg"}, 0.05)
        return table

    def thick(self) -> dict[str, Any]:
        """A cloth that can be formed: by the library, or by a data sheet."""
        fabric: dict[str, Any] = {"use": "glass-pp-plain-1.93"}
        if self.random.random() < 0.3:
            warp, weft = (
                {
                    "linear_density": self.quantity(50, 2000, "tex"),
                    "yarns": self.quantity(2, 8, "/cm"),
                }
                for _ in range(2)
            )
            sheet = {
                "warp": warp,
                "weft": weft,
                "fibre_modulus": self.quantity(50, 300, "GPa"),
                "fibre_density": self.quantity(1, 3, "g/cm^3"),
                "fibre_diameter": "7 um",
            }
            self.maybe(sheet, "fibre_share", self.random.uniform(0.1, 1.0))
            fabric = {"from_datasheet": sheet, "shear": self.shear()}
            fabric |= {"thickness": self.quantity(2, 9, "mm")}
            self.maybe(fabric, "weave", self.random.choice(("plain", "twill 2/2", "satin 5")))
        return fabric

    def fishnet(self) -> dict[str, Any]:
        """A blank on one tool, which it may not meet."""
        data = self.forming()
        data["test"] = {"kind": "fishnet"} | self.laid()
        data["tool"] = data["tool"][:1] or [{"name": "die", "shape": self.shape()}]
        data["preform"]["outline"].pop("slits", None)
        return {key: value for key, value in data.items() if key not in ("clamp", "stage")}

    def drape(self) -> dict[str, Any]:
        """A round of cloth on a disc."""
        radius = self.random.uniform(0.08, 0.2)
        test: dict[str, Any] = {"kind": "drape", "support_radius": f"{0.6 * radius:.6g} m"}
        self.maybe(test, "edge_radius", self.quantity(1, 10, "mm"))
        self.maybe(test, "plate", self.random.random() < 0.5)
        self.maybe(test, "friction", self.random.uniform(0, 1))
        self.maybe(test, "results", self.random.randint(1, 20))
        preform = {"outline": {"circle": f"{2 * radius:.6g} m"}, "bias_angle": "0 deg",
                   "yarns_per_cruciform": self.random.randint(2, 8)}  # fmt: skip
        return {"fabric": self.thick(), "preform": preform, "test": test}

    def inflation(self) -> dict[str, Any]:
        """A rectangle whose edges are held, under pressure or between raised corners."""
        test: dict[str, Any] = {"kind": "inflation", "pressure": self.some(0.01, 50, "kPa")}
        if self.random.random() < 0.3:
            test |= {"corners": ["0 mm", self.length(), "0 mm", self.length()],
                     "pretension": self.quantity(1, 10, "N/cm")}  # fmt: skip
        else:
            self.maybe(test, "slides", self.random.random() < 0.5)
            self.maybe(test, "symmetry", self.random.choice((["left"], ["left", "lower"])))
            self.maybe(test, "pretension", self.quantity(0.1, 10, "N/cm"))
        self.maybe(test, "results", self.random.randint(1, 20))
        outline = {"rectangle": [self.length(0.12), self.length(0.12)]}
        preform = {"outline": outline, "bias_angle": "0 deg",
                   "yarns_per_cruciform": self.random.randint(1, 6)}  # fmt: skip
        return {"fabric": self.thick(), "preform": preform, "test": test}

    def forming(self) -> dict[str, Any]:
        """A blank among tools that should be good, though what they do may make no sense."""
        sides = ("left", "right", "lower", "upper")
        test: dict[str, Any] = {"kind": "forming", "gravity": self.random.random() < 0.3}
        self.maybe(test, "symmetry", self.random.choice((["left"], ["left", "lower"])))
        self.maybe(test, "imperfection", {"height": self.length(1e-6, 1e-3), "seed": 3})
        contact = {"stiffness": self.quantity(1, 100, "kPa/mm"), "elastic_slip": "0.01 mm",
                   "viscosity": self.quantity(0.1, 100, "N s/m^3")}  # fmt: skip
        self.maybe(test, "contact", contact)
        if self.random.random() < 0.15:
            test["fishnet"] = self.laid() | {"tool": "die"}
            self.maybe(test["fishnet"], "press", self.quantity(1, 50, "kPa"))
            if "press" in test["fishnet"]:
                self.maybe(test["fishnet"], "pieces", self.random.randint(2, 4))
        fabric = self.thick()
        outline = self.outline(self.random.random() < 0.7, 0.12)
        if "symmetry" in test or self.random.random() < 0.5:
            outline = {"rectangle": [self.length(0.12), self.length(0.12)]}
            x, y = (self.random.uniform(0.03, 0.055) for _ in range(2))
            slit = [[f"{x:.6g} m", f"{y:.6g} m"], [f"{y:.6g} m", "0.09 m"]]
            self.maybe(outline, "slits", [slit])
            self.maybe(outline, "darts", [[*slit, ["0.1 m", "0.1 m"]]], 0.1)
        preform = {
            "outline": outline,
            "bias_angle": "0 deg"
            if "symmetry" in test
            else self.random.choice(("0 deg", "45 deg")),
            "yarns_per_cruciform": self.random.randint(4, 10),
        }
        tools: list[dict[str, Any]] = []
        for name in ("die", "punch", "holder", "Ring 2")[: self.random.choice((0, 1, 2, 2, 3, 4))]:
            tool: dict[str, Any] = {"name": name, "shape": self.shape()}
            self.maybe(tool, "friction", self.random.uniform(0, 1), 0.7)
            self.maybe(tool, "place", self.place()[: self.random.choice((2, 2, 2, 3))])
            self.maybe(tool, "turn", ["180 deg", "0 deg", "10 deg"], 0.1)
            tools.append(tool)
        clamps: list[dict[str, Any]] = []
        held = sides[: self.random.choice((0, 0, 2, 3, 4))] if tools else sides
        if not tools:
            test.pop("fishnet", None)
        if not outline.get("rectangle") or ("fishnet" in test and tools):
            held = ()
        for edge in (side for side in held if side not in test.get("symmetry", ())):
            clamp: dict[str, Any] = {"edge": edge}
            if self.random.random() < 0.5:
                clamp["stiffness"] = self.quantity(0.1, 10, "N/mm")
                self.maybe(clamp, "preload", self.quantity(0.1, 10, "N/m"))
                self.maybe(clamp, "friction_limit", self.quantity(0.1, 10, "N"))
            clamps.append(clamp)
        names, edges = [tool["name"] for tool in tools], [clamp["edge"] for clamp in clamps]
        data = {"fabric": fabric, "preform": preform, "test": test, "tool": tools, "clamp": clamps}
        whole, count = "symmetry" not in test, self.random.randint(1, 3)
        data["stage"] = [self.stage(i, names, edges, whole) for i in range(count)]
        self.maybe(data, "output", {"part_outline": {"rectangle": [self.length(), self.length()]}})
        return data

    # -- no files, or without measure --------------------------------------------------------------

    def special(self, text: str) -> Payload:
        """What stands in the place of a file: of which kind, or its bytes."""
        n = self.random.choice((10, 100, 1_000, 100_000))
        name, quote = f"k{n}", self.random.choice(("'", '"'))
        make: tuple[Callable[[], Payload], ...] = (
            lambda: "x" * self.random.randint(200, 6_000),
            lambda: f"{name} = {'[' * n}{text}".encode(),
            lambda: f"{name} = {'{a=' * n}1{'}' * n}\n{text}".encode(),
            lambda: f"{'.'.join([name] * n)} = 1\n{text}".encode(),
            lambda: f"{name} = {'9' * n}\n{text}".encode(),
            lambda: f"title = {quote}{'x' * n}{quote}\n{text}".encode(),
            lambda: f"{text}\n{'#' * 10 * n}".encode() * self.random.choice((1, 5)),
            lambda: "".join(f"k{i} = {i}\n" for i in range(3 * n)).encode() + text.encode(),
            lambda: f"title = {quote}\\u001b[2J{quote}\n{text}".encode(),
            lambda: text.replace("extension = ", f"extension = [{'1,' * n}]#").encode(),
            lambda: text.replace(' mm"', f' mm{"^9" * min(n, 1_000)}"').encode(),
            lambda: text.replace(' deg"', f' {"(" * min(n, 1_000)}deg"').encode(),
            lambda: text.replace("increments = ", f"increments = {'8' * n}").encode(),
            lambda: text.replace("refine = ", f"refine = 1{'0' * (n % 97)}").encode(),
            lambda: text.encode("utf-16"),
            lambda: b"\xef\xbb\xbf" + text.encode(),
            lambda: b"\0" * n,
            lambda: text.encode() + b"\0",
        )
        chosen = self.random.choice([*PLACES, *make])
        return chosen if isinstance(chosen, str) else chosen()

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
        keys = {
            key if re.fullmatch(r"[\w-]+", key, re.A) else json.dumps(key): key for key in value
        }
        return f"{{ {', '.join(f'{key} = {_value(value[own])}' for key, own in keys.items())} }}"
    if isinstance(value, list | tuple):
        return f"[{', '.join(_value(entry) for entry in value)}]"
    text = json.dumps(value, ensure_ascii=False)
    return text.replace("NaN", "nan").replace("Infinity", "inf").replace("\x7f", "")


def place(path: Path, payload: Payload) -> Path:
    """Put a file, or what stands for it, into its place; returns its name."""
    if path.is_dir() and not path.is_symlink():
        path.rmdir()
    path.unlink(missing_ok=True)
    if isinstance(payload, bytes):
        path.write_bytes(payload)
    elif payload == "pipe":
        os.mkfifo(path)
    elif payload == "socket":
        with socket.socket(socket.AF_UNIX) as bound:
            bound.bind(os.path.relpath(path))  # names of sockets are short
    elif payload == "folder":
        path.mkdir()
    elif payload == "sparse":
        with path.open("wb") as file:
            file.truncate(1 << 40)
    elif payload in PLACES:  # a link, "special" to itself
        path.symlink_to(path.name if payload == "special" else payload)
    else:
        return path.with_name(payload)
    return path


def listing(folder: Path) -> dict[str, tuple]:
    """What there is in a folder: kinds, sizes, contents or targets."""
    found = {}
    for path in sorted(folder.rglob("*")):
        look = path.lstat()
        what = hashlib.sha256(path.read_bytes()).hexdigest() if stat.S_ISREG(look.st_mode) else ""
        what = os.readlink(path) if path.is_symlink() else what
        found[str(path)] = look.st_mode, look.st_size, what
    return found


def user(folder: Path) -> Path:
    """Make what a user has of his own, and go there."""
    (folder / "thesis").mkdir(parents=True)
    (folder / "thesis" / "chapter1.tex").write_text("mine")
    (folder / "curve.csv").write_text("mine")
    (folder / "checkpoint").mkdir()
    (folder / "checkpoint" / "weights.bin").write_bytes(b"mine")
    (folder / "link").symlink_to("thesis")
    os.chdir(folder)
    return folder


def tools(folder: Path) -> Path:
    """Make a folder for cases with files of tools: a tetrahedron, one that is open, and noise."""
    folder.mkdir()
    corners = ((0, 0, 40), (40, 0, 0), (-20, 35, 0), (-20, -35, 0))
    sides = ((0, 1, 2), (0, 2, 3), (0, 3, 1), (1, 3, 2))
    for name, kept in (("punch", sides), ("hole", sides[:3])):
        facets = (
            "facet normal 0 0 0\nouter loop\n"
            + "".join("vertex {} {} {}\n".format(*corners[k]) for k in side)
            + "endloop\nendfacet\n"
            for side in kept
        )
        (folder / f"{name}.stl").write_text(f"solid {name}\n{''.join(facets)}endsolid {name}\n")
    (folder / "noise.stl").write_bytes(bytes(range(256)) * 2)
    return folder


def end_of(arguments: list[str]) -> tuple[str, str]:
    """What becomes of a command line in this process, and what was said."""
    from cruciform_petsc.cli import main

    said = io.StringIO()
    with contextlib.redirect_stdout(io.StringIO()), contextlib.redirect_stderr(said):
        code = main(arguments)
    text = said.getvalue()
    return judged(code, text), text


def judged(code: int, text: str) -> str:
    """An end, by exit code and stderr."""
    # A sentence, or one for each problem, on lines of their own below the first.
    first, *more = text.splitlines() or [""]
    told = first.startswith("cruciform-petsc: ") and all(line.startswith("  ") for line in more)
    told = told and all(harmless(line) == line for line in text.splitlines())
    return OK if code == 0 and not text else REFUSED if code == 2 and told else FAULT


def work(connection: Connection, folder: str) -> None:
    """Check files as they come; answers (end, what was said)."""
    faulthandler.enable()
    from cruciform_petsc import memory

    memory.machine_memory = lambda: MEMORY
    name = f"{multiprocessing.current_process().name}-{os.getpid()}"
    own = user(Path(folder) / name)
    before, cases = listing(own), tools(Path(folder) / f"{name}-cases")
    while True:
        path = place(cases / "case.toml", connection.recv())
        end, text = end_of(["check", str(path), "--quiet"])
        if listing(own) != before:
            end, text = FAULT, f"files of the user's have changed; {text}"
        connection.send((end, text))


class Worker:
    """A process that checks one file at a time, replaced when it crashes or takes too long."""

    def __init__(self, folder: str, limit: float, work: Callable[[Connection, str], None] = work):
        self.folder, self.limit, self.work = folder, limit, work
        self.start()

    def start(self) -> None:
        """Start a fresh process."""
        context = multiprocessing.get_context("spawn")
        self.connection, there = context.Pipe()
        self.process = context.Process(target=self.work, args=(there, self.folder), daemon=True)
        self.process.start()
        there.close()
        self.since: float | None = None
        self.file: tuple[str, Any] = ("", b"")

    def give(self, file: tuple[str, Any]) -> None:
        """Hand out a file of a sort."""
        self.file, self.since = file, time.monotonic()
        self.connection.send(file[1])

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


def options(number: int, limit: float) -> argparse.ArgumentParser:
    """Options of a script, with its defaults."""
    parser = argparse.ArgumentParser()
    parser.add_argument("number", nargs="?", type=int, default=number, metavar="N")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--limit", type=float, default=limit, help="seconds for one file")
    parser.add_argument("--keep", default="fuzz-failures", help="folder of files that failed")
    return parser


def run(
    args: argparse.Namespace,
    make: Callable[[], tuple[str, Any]],
    sorts: Sequence[str],
    work: Callable[[Connection, str], None],
) -> int:
    """Hand out as many files as asked for, and print what became of them; the exit code."""
    left = args.number
    counts: Counter[tuple[str, str]] = Counter()
    begin, slowest = time.monotonic(), dict.fromkeys(sorts, 0.0)
    with tempfile.TemporaryDirectory() as folder:
        workers = [Worker(folder, args.limit, work) for _ in range(max(1, args.workers))]
        while left or any(worker.since is not None for worker in workers):
            for worker in workers:
                since, file = worker.since, worker.file
                if since is None and left:
                    worker.give(make())
                    left -= 1
                elif since is not None:
                    end = worker.answer()
                    if end is not None:
                        slowest[file[0]] = max(slowest[file[0]], time.monotonic() - since)
                        counts[file[0], end[0]] += 1
                        if end[0] in (FAULT, HANG):
                            _keep(Path(args.keep), sum(counts.values()), file, end)
            time.sleep(0.001)
        for worker in workers:
            worker.process.kill()
    ends = (OK, REFUSED, FAULT, HANG)
    print(f"{'':10}" + "".join(f"{end:>11}" for end in ends) + "    slowest")
    for sort in sorts:
        row = "".join(f"{counts[sort, end]:11d}" for end in ends)
        print(f"{sort:10}{row}{slowest[sort]:9.1f} s")
    print(f"{args.number} files in {time.monotonic() - begin:.0f} s")
    return int(any(count and end in (FAULT, HANG) for (_, end), count in counts.items()))


def _keep(folder: Path, number: int, file: tuple[str, Any], end: tuple[str, str]) -> None:
    folder.mkdir(parents=True, exist_ok=True)
    path = folder / f"{end[0]}-{file[0]}-{number}"
    path.write_bytes(file[1] if isinstance(file[1], bytes) else repr(file[1]).encode())
    print(f"{end[0]}: {path}\n{end[1][-1500:]}", flush=True)


if __name__ == "__main__":
    args = options(2000, 60.0).parse_args()
    sys.exit(run(args, Maker(args.seed).case, SORTS, work))
