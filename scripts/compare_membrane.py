# SPDX-License-Identifier: MIT
"""Networks and membranes on one hemisphere, finer and finer: how their difference falls.

A quarter of a square blank of 233 mm between planes of symmetry, yarns along its edges, is pressed
into an opening of 52.5 mm radius by a hemisphere of 50 mm, under a holder that keeps it free of
wrinkles. Rungs are networks of 4, 2 and 1 yarns to a cruciform, and membranes whose triangles are
half as wide as those pitches. Each is compared with the finest membrane at the crossovers of the
coarsest network, which all of them have. With --equal triangles are such that a membrane has about
as many nodes as the network, to compare what they take.

    scripts/fenicsx python3 scripts/compare_membrane.py --depth 40 --bending 1
    scripts/fenicsx python3 scripts/compare_membrane.py --depth 40 --bending 1 --equal
"""

from __future__ import annotations

import argparse
import time

import numpy as np
from mpi4py import MPI

from cruciform_petsc import Fabric, Network, Preform
from cruciform_petsc.continuum.sheet import MembraneBlank
from cruciform_petsc.forming.blank import Blank, ContactSettings
from cruciform_petsc.forming.forming import form
from cruciform_petsc.forming.measures import DrawIn
from cruciform_petsc.forming.press import StagePlan
from cruciform_petsc.tools import shapes
from cruciform_petsc.tools.motion import Motion, Pose
from cruciform_petsc.tools.tool import Tool

SIDE = 28 / 240  # m, of the quarter: 28 yarns
RADIUS, THICKNESS = 50e-3, 1e-3


def cloth(bending: float) -> Fabric:
    """The cloth of demos/hemisphere.toml with a rigidity out of the plane in N mm."""
    yarns = {
        "modulus": "520 N/cm",
        "poisson": 0,
        "yarns": "2.4 /cm",
        "yarn_bending": "0.6 N mm^2",
        "out_of_plane_bending": f"{bending} N mm",
    }
    shear = {"law": "sin-potential", "coefficients": ["18.5 N/m", "46.4 N/m", "60 N/m"]}
    return Fabric.from_table(
        "hemisphere",
        {
            "warp": yarns,
            "weft": yarns,
            "thickness": "1 mm",
            "shear": shear,
            "tension": {"strain": "log", "compression": 0.02},
        },
    )


def main() -> list[dict[str, float]]:
    """Print a row for each rung as it is done; returns them."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--depth", type=float, default=40.0, help="of the punch, mm")
    parser.add_argument("--holder", type=float, default=100.0, help="force on the whole blank, N")
    parser.add_argument("--bending", type=float, default=1.0, help="out of the plane, N mm")
    parser.add_argument("--step", type=float, default=0.1, help="largest, as a share of the stroke")
    parser.add_argument("--in-plane", action="store_true", help="yarns bend in the plane, too")
    parser.add_argument("--equal", action="store_true", help="as many nodes in a membrane")
    parser.add_argument("--yarns", type=int, nargs="+", default=[4, 2, 1], help="to a cruciform")
    told = parser.parse_args()
    comm, fabric = MPI.COMM_WORLD, cloth(told.bending)
    over = np.diag([1.0, -1.0, -1.0])
    above, high = (Pose(np.array([0.0, 0.0, z]), over) for z in (THICKNESS, THICKNESS + RADIUS))
    tools = [
        Tool("die", shapes.opening(52.5e-3, 8e-3, 200e-3), 0.2),
        Tool("holder", shapes.ring(64.5e-3, 200e-3, 1e-3), 0.2, above),
        Tool("punch", shapes.sphere(RADIUS, shaft=True), 0.2, high),
    ]
    down = np.array([0.0, 0.0, -1e-3 * told.depth])
    plans = [
        StagePlan("close", forces={"holder": np.array([0, 0, -told.holder / 4])}, step=0.25),
        StagePlan("draw", {"punch": lambda pose: Motion(pose, down)}, step=told.step),
    ]
    corners = (SIDE * np.array([[0, 0], [1, 0], [1, 1], [0, 1]])).tolist()
    options = {
        "settings": ContactSettings(1e8, 2e-4, 1e-5, 20.0),
        "symmetry": ("left", "lower"),
        "bending": told.in_plane,
    }
    networks = [
        Network(
            comm,
            Preform.polygon(corners, bias_angle=0.0, origin=(0, 0), yarns_per_cruciform=yarns),
            fabric,
        )
        for yarns in told.yarns
    ]
    points = networks[0].crossover_position
    rows, fields = [], []
    rungs: list[tuple[str, float, Blank]] = []
    for network in networks[::-1]:
        # A network has three nodes to a crossover, a mesh one to a square of its size.
        size = float(network.pitch.min()) / (np.sqrt(3) if told.equal else 2.0)
        rungs.append(("membrane", size, MembraneBlank(network, tools, size, **options)))
    for network in networks[::-1]:
        rungs.append(("network", float(network.pitch.min()), Blank(network, tools, **options)))
    for name, size, blank in rungs:
        begin = time.process_time()
        formed = form(blank, plans)
        state, last = formed.states[-1], formed.steps[-1]
        cloth_state = blank.of_cloth(state)
        if isinstance(blank, MembraneBlank):
            u, gamma = blank.ply.at(cloth_state, points)
        else:
            found, place = blank.ply.fields(cloth_state), blank.network.crossover_position
            here = {tuple(np.round(1e6 * p).astype(int)): i for i, p in enumerate(place)}
            at = [here[tuple(np.round(1e6 * p).astype(int))] for p in points]  # one rank
            u, gamma = found["displacement"][at], found["shear_angle"][at]
        fields.append((u, gamma))
        off_u, off_gamma = u - fields[0][0], np.degrees(abs(gamma - fields[0][1]))
        inside = (points < (1 - 1e-6) * SIDE).all(axis=1)  # shear at free edges is one-sided
        newton = sum(step.increment.iterations for step in formed.steps)
        rows.append(
            {
                "size_mm": 1e3 * size,
                "nodes": blank.ply.nodes.num_nodes_global,
                "steps": len(formed.steps),
                "newton": newton,
                "mended": sum(step.increment.shifted for step in formed.steps),
                "punch_N": 4 * abs(last.tool_force["punch"][2]),
                "draw_in_mm": 1e3 * max(DrawIn(blank).largest(state).values()),
                "shear_max_deg": np.degrees(last.increment.shear_max),
                "shear_off_deg": off_gamma[inside].mean(),
                "shear_off_l2": np.linalg.norm(np.radians(off_gamma[inside]))
                / np.linalg.norm(fields[0][1][inside]),
                "moved_off_mm": 1e3 * np.linalg.norm(off_u, axis=1).mean(),
                "seconds": time.process_time() - begin,
                "ms_a_newton": 1e3 * (time.process_time() - begin) / newton,
            }
        )
        if len(rows) == 1:
            print(f"{'':9}", *(f"{key:>13}" for key in rows[0]))
        print(f"{name:9}", *(f"{value:13.4g}" for value in rows[-1].values()), flush=True)
    return rows


if __name__ == "__main__":
    main()
