# SPDX-License-Identifier: MIT
"""Reading exported files back, and results of any affine motion, for tests on one rank and more."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np

from cruciform_petsc.experiments.result import State, TestResult
from cruciform_petsc.net.lattice import OPPOSITE
from cruciform_petsc.quantities import EXTENSION
from support.helpers import TABLE_1

# 0.4608 of the volume is fibres.
WEIGHED = replace(TABLE_1, areal_density=0.576, fibre_density=2500.0, thickness=0.5e-3)


def read_table(path) -> dict[str, np.ndarray]:
    """Columns of a CSV file by their names; NaN for an empty field."""
    names = path.read_text().split("\n", 1)[0].split(",")
    values = np.genfromtxt(path, delimiter=",", skip_header=1, ndmin=2)
    return dict(zip(names, values.T, strict=True))


def read_input_file(path) -> SimpleNamespace:
    """What an Abaqus input file says, read without the code that has written it.

    node, element, distribution: dicts by number (of a distribution, None is the default); sets:
    lists of elements by name; field: dicts by number of the field variable; keywords: (name,
    options, data lines) of all.
    """
    keywords = []
    for line in path.read_text().splitlines():
        assert len(line) <= 256
        if line.startswith("**"):
            continue
        if line.startswith("*"):
            name, *options = [part.strip() for part in line[1:].split(",")]
            keywords.append((name.upper(), dict((o + "=").split("=")[:2] for o in options), []))
        else:
            keywords[-1][2].append([part.strip() for part in line.split(",")])
    deck = SimpleNamespace(
        node={}, element={}, kind={}, sets={}, distribution={}, field={}, keywords=keywords
    )
    for name, options, data in keywords:
        if name == "NODE":
            deck.node |= {int(row[0]): np.array(row[1:], float) for row in data}
        elif name == "ELEMENT":
            assert len({len(row) for row in data}) == 1
            deck.element |= {int(row[0]): [int(n) for n in row[1:]] for row in data}
            deck.kind |= {int(row[0]): options["TYPE"] for row in data}
        elif name == "ELSET":
            assert max(map(len, data)) <= 16
            deck.sets[options["ELSET"]] = [int(n) for row in data for n in row]
        elif name == "DISTRIBUTION":
            deck.distribution[options["NAME"]] = {
                int(row[0]) if row[0] else None: np.array(row[1:], float) for row in data
            }
        elif name == "INITIAL CONDITIONS":
            deck.field[int(options["VARIABLE"])] = {int(row[0]): float(row[1]) for row in data}
    return deck


def moved(network, gradient, loose=()) -> TestResult:
    """A result in which all places x have gone to gradient x; crossovers ``loose`` carry nothing.

    Tensions are the strains.
    """
    frame = network.preform.rotation
    axes = frame @ gradient.T  # of the yarns, now
    stretch = np.hypot(*axes.T)
    turn = np.arctan2(frame[:, 0] * axes[:, 1] - frame[:, 1] * axes[:, 0], (frame * axes).sum(1))
    on = ~np.isin(network.crossover_number_global, loose)
    leads = network.arm_length[network.boundary_crossovers] > 0
    supports = SimpleNamespace(
        carrying=on, hinge_share=leads / np.maximum(1.0 * leads + leads[:, OPPOSITE], 1.0)
    )
    rotation = np.where(on[:, None], turn[[0, 1, 0, 1]], 0.0)
    fields = {
        "displacement": network.crossover_position @ (gradient - np.eye(2)).T,
        "arm_rotation": rotation,
        "arm_strain": np.where(on[:, None], stretch[[0, 1, 0, 1]] - 1.0, 0.0),
        "warp_strain": np.where(on, stretch[0] - 1.0, 0.0),
        "weft_strain": np.where(on, stretch[1] - 1.0, 0.0),
        "shear_angle": np.where(on, turn[0] - turn[1], 0.0),
        "carrying": on,
    }
    fields |= {f"{f}_tension": 1e3 * fields[f"{f}_strain"] for f in ("warp", "weft")}
    state = State(1e-3, 0.0, fields, network.node_position @ (gradient - np.eye(2)).T)
    experiment = SimpleNamespace(
        network=network, kind="affine", column=EXTENSION, has_zones=False, space=False
    )
    return TestResult(experiment, supports, 2, [state])
