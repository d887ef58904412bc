# SPDX-License-Identifier: MIT
"""A hemisphere pressed into cloth: steps, rounds of friction, Newton steps, time, punch force.

    ./scripts/fenicsx python3 scripts/bench_forming.py
    ./scripts/fenicsx python3 scripts/bench_forming.py --case wrinkled --vary
    ./scripts/fenicsx python3 scripts/bench_forming.py --case all

A blank of 240 mm x 240 mm, yarns along its edges, is held by a ring with a force and pressed 60 mm
deep into an opening of radius 52.5 mm (fillet 8 mm) by a hemisphere of radius 50 mm; friction 0.2.

    hemisphere  58 x 58 crossovers (the pitch of the yarns), 50 N on the holder: no wrinkles
    wrinkled    24 x 24 crossovers, 2 N
    pleats      40 x 40 crossovers, 0.5 N, a fifth of the bending rigidity out of the plane

With --vary also: half the step, half the viscosity, twice the stiffness of contact, and with --fine
half the pitch. Prints what changed; writes results/bench_forming.json. The tries of steps that
failed and were halved are in the processor time, not in the counts, nor is the one factorisation
that foresees each step. Evaluations are of forces. ``Balance`` is the work of the
tools, by trapezia over the steps, over what is stored and dissipated, less one.
"""

import argparse
import sys
from dataclasses import dataclass, field, replace
from pathlib import Path

import benchlib
import numpy as np
from benchlib import COMM, Table, clock

from cruciform_petsc import Fabric, Network, Preform
from cruciform_petsc.errors import EquilibriumError
from cruciform_petsc.forming.blank import Blank, ContactSettings
from cruciform_petsc.forming.forming import Formed, form
from cruciform_petsc.forming.press import StagePlan
from cruciform_petsc.tools import shapes
from cruciform_petsc.tools.motion import Motion, Pose
from cruciform_petsc.tools.tool import Tool

SIDE, DEPTH, RADIUS, THICKNESS = 0.24, 0.06, 0.05, 1e-3
CONTACT = ContactSettings(2e7, 0.2e-3, 1e-5, 20.0)


@dataclass(frozen=True)
class Run:
    """What is pressed, and how."""

    crossovers: int  # along a side
    holder: float  # N
    bending: float = 1e-3  # out of the plane, N m
    step: float = 0.1  # of the stroke
    friction: float = 0.2
    contact: ContactSettings = field(default=CONTACT)

    def blank(self, own_contact: bool = False) -> Blank:
        """The cloth among its tools, with the program's contact if asked."""
        yarns = self.crossovers / SIDE
        yarn = {
            "modulus": "520 N/cm",
            "poisson": 0,
            "yarns": f"{yarns!r} /m",
            "yarn_bending": f"{0.6 * 240.0 / yarns!r} N mm^2",
            "out_of_plane_bending": f"{self.bending} N m",
        }
        fabric = Fabric.from_table(
            "hemisphere",
            {
                "warp": yarn,
                "weft": yarn,
                "thickness": f"{THICKNESS} m",
                "shear": {
                    "law": "sin-potential",
                    "coefficients": ["18.5 N/m", "46.4 N/m", "60 N/m"],
                },
                "tension": {"strain": "log", "compression": 0.02},
            },
        )
        preform = Preform.rectangle(SIDE, SIDE, bias_angle=0.0).centred()
        down = np.diag([1.0, -1.0, -1.0])
        holder, punch = (Pose(np.array([0, 0, z]), down) for z in (THICKNESS, THICKNESS + RADIUS))
        mu = self.friction
        tools = [
            Tool("die", shapes.opening(52.5e-3, 8e-3, 0.2), mu),
            Tool("holder", shapes.ring(64.5e-3, 0.2, 1e-3), mu, holder),
            Tool("punch", shapes.sphere(RADIUS, shaft=True), mu, punch),
        ]
        network = Network(COMM, preform, fabric)
        settings = None if own_contact else self.contact
        return Blank(network, tools, settings=settings, waves=(0.01 * THICKNESS, 1))

    def plans(self) -> list[StagePlan]:
        """Close, draw."""
        force, travel = np.array([0.0, 0.0, -self.holder]), np.array([0.0, 0.0, -DEPTH])
        return [
            StagePlan("close", forces={"holder": force}, step=0.25),
            StagePlan("draw", {"punch": lambda pose: Motion(pose, travel)}, step=self.step),
        ]


CASES = {
    "hemisphere": Run(58, 50.0),
    "wrinkled": Run(24, 2.0),
    "pleats": Run(40, 0.5, 0.2e-3),
}


def variants(run: Run, fine: bool) -> dict[str, Run]:
    """What a result should hardly depend on."""
    contact = run.contact
    runs = {
        "half the step": replace(run, step=0.5 * run.step),
        "half the viscosity": replace(
            run, contact=replace(contact, viscosity=0.5 * contact.viscosity)
        ),
        "twice the stiffness": replace(
            run, contact=replace(contact, stiffness=2.0 * contact.stiffness)
        ),
    }
    if fine:
        runs["half the pitch"] = replace(run, crossovers=2 * run.crossovers)
    return runs


def balance(formed: Formed) -> float:
    """Work of the tools over what is stored and dissipated, less one."""
    last = formed.steps[-1]
    items = [item for item in formed.blank.model.items if not item.is_load]
    modes = {mode for item in items for mode in item.modes}  # tools share theirs
    stored = sum(last.increment.energies[mode] for mode in modes)
    return last.work / (stored + sum(last.spent.values())) - 1.0


def measure(name: str, run: Run, table: Table, base: dict | None, verbose: bool) -> dict:
    """Form a blank and put a row into the table, beside another's figures."""
    with clock() as setup:
        blank = run.blank()

    def told(step, _state) -> None:
        i = step.increment
        if verbose and COMM.rank == 0:
            print(
                f"  {i.control:.4f}: {i.rounds} rounds, {i.iterations} Newton steps, "
                f"{i.shifted} indefinite, {i.factorisations} factorisations, "
                f"{i.evaluations} evaluations, {i.cuts} cuts, "
                f"punch {step.tool_force['punch'][2]:.3f} N, shear {np.degrees(i.shear_max):.2f} deg, {i.seconds:.1f} s",
                file=sys.stderr,
                flush=True,
            )

    reached = "end"
    with clock() as seconds:
        try:
            formed = form(blank, run.plans(), accepted=told)
        except EquilibriumError as error:
            formed, reached = error.result, error.reason
            if COMM.rank == 0:
                print(f"  {name}: {error}, residuals {error.history[-5:]}", file=sys.stderr)
    steps = [step.increment for step in formed.steps]
    last = formed.steps[-1]
    depth = [
        max(0.0, -benchlib.COMM.allreduce(float(c.fields(formed.states[-1])["distance"].min()),
                                          op=benchlib.MPI.MIN))
        for c in blank.contacts
    ]  # fmt: skip
    result = {
        "crossovers": blank.network.num_crossovers_global,
        "unknowns": 3 * blank.nodes.num_nodes_global,
        "steps": len(steps),
        "rounds": sum(step.rounds for step in steps),
        "newton": sum(step.iterations for step in steps),
        "indefinite": sum(step.shifted for step in steps),
        "factorisations": sum(step.factorisations for step in steps),
        "evaluations": sum(step.evaluations for step in steps),
        "cuts": sum(step.cuts for step in steps),
        "setup_s": setup.cpu,
        "seconds": seconds.cpu,
        "punch_n": -float(last.tool_force["punch"][2]),
        "shear_deg": float(np.degrees(last.increment.shear_max)),
        "compaction_mm": 1e3 * max(depth),
        "balance": balance(formed),
        "reached": reached if reached == "end" else f"{last.increment.control:.4f} ({reached})",
    }
    change = ""
    if base is not None:
        change = ", ".join(
            f"{label} {100 * (result[key] / base[key] - 1):+.2f} %"
            for key, label in (("punch_n", "force"), ("shear_deg", "shear"))
        )
    table.row(
        name, result["crossovers"], result["unknowns"], result["steps"], result["rounds"],
        result["newton"], result["indefinite"], result["factorisations"], result["evaluations"],
        result["cuts"], f"{result['seconds']:.1f}",
        f"{result['punch_n']:.2f}", f"{result['shear_deg']:.2f}", f"{result['compaction_mm']:.2f}",
        f"{100 * result['balance']:+.2f} %", result["reached"], change,
    )  # fmt: skip
    return result


def main() -> None:
    """Print the tables."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--case", choices=[*CASES, "all"], default="hemisphere")
    parser.add_argument("--vary", action="store_true", help="also with other steps, contact, ...")
    parser.add_argument("--fine", action="store_true", help="with --vary: half the pitch, long")
    parser.add_argument("--crossovers", type=int, help="along a side, in place of the case's")
    parser.add_argument("--step", type=float, help="of the stroke, in place of 0.1")
    parser.add_argument("--stiffness", type=float, help="of contact, in place of 2e7 N/m^3")
    parser.add_argument("--viscosity", type=float, help="in place of 20 N s/m^3")
    parser.add_argument("--own-contact", action="store_true", help="the program's contact")
    parser.add_argument("--verbose", action="store_true", help="a line for each step")
    arguments = parser.parse_args()
    benchlib.say_machine()
    results = {}
    for name in CASES if arguments.case == "all" else [arguments.case]:
        run = CASES[name]
        if arguments.crossovers:
            run = replace(run, crossovers=arguments.crossovers)
        if arguments.step:
            run = replace(run, step=arguments.step)
        if arguments.own_contact:
            run = replace(run, contact=run.blank(own_contact=True).settings)
        given = {key: getattr(arguments, key) for key in ("stiffness", "viscosity")}
        given = {key: value for key, value in given.items() if value is not None}
        run = replace(run, contact=replace(run.contact, **given))
        table = Table(
            f"{name}: holder {run.holder:g} N, bending {run.bending:g} N m, {run.contact}",
            "run", "crossovers", "unknowns", "steps", "rounds", "Newton", "indefinite",
            "factorisations", "evaluations", "cuts",
            "processor s", "punch N", "shear deg", "compaction mm", "balance", "reached", "change",
        )  # fmt: skip
        base = measure(name, run, table, None, arguments.verbose)
        results[name] = {"as it is": base}
        if arguments.vary:
            for label, other in variants(run, arguments.fine).items():
                results[name][label] = measure(label, other, table, base, arguments.verbose)
    benchlib.save(Path("results/bench_forming.json"), cases=results)


if __name__ == "__main__":
    main()
