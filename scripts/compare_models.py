# SPDX-License-Identifier: MIT
"""One cloth, three models: cruciforms, a truss with soft diagonals, a membrane; two cases.

    ./scripts/fenicsx python3 scripts/compare_models.py
    ./scripts/fenicsx python3 scripts/compare_models.py --case hemisphere --yarns 6

Prints a table in Markdown for each case, and draws results/compare_models.png: the bias extension
of demos/finite_bias_extension.toml, and the hemisphere of demos/hemisphere.toml with so many yarns
to a cruciform. Cruciforms are shown without yarn bending in the plane, too, as neither other model
has any, in the plane or out of it. The membrane is the orthotropic one of continuum/, whose
triangles have edges along the yarns on the hemisphere: linear ones of half the pitch; of the bias
extension they are quadratic, as large as the pitch. Times are processor times of all ranks, once
kernels are compiled; Newton steps those of accepted steps.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from mpi4py import MPI

from cruciform_petsc import Case, Network
from cruciform_petsc.continuum.compare import solve_membranes
from cruciform_petsc.continuum.sheet import MembraneBlank
from cruciform_petsc.continuum.sizes import formed_size
from cruciform_petsc.errors import EquilibriumError
from cruciform_petsc.experiments.result import TestResult
from cruciform_petsc.forming.blank import Blank
from cruciform_petsc.forming.forming import Formed, form

COMM = MPI.COMM_WORLD
DEMOS = Path(__file__).parents[1] / "demos"
MODELS = {
    "cruciforms": [],
    "cruciforms, hinged": ["test.bending=false"],
    "truss": ["test.model=truss"],
}
AT_DEG = (20.0, 40.0)  # shear angles that loads are told at
Rows = dict[str, dict[str, Any]]
Curves = dict[str, tuple[np.ndarray, np.ndarray]]


def timed(work: Callable[[], Any]) -> tuple[Any, float]:
    """Result, and processor time of all ranks."""
    begin = time.process_time()
    found = work()
    return found, COMM.allreduce(time.process_time() - begin)


def load(demo: str, *settings: str) -> Case:
    """A demo with other settings."""
    return Case.load_collective(COMM, DEMOS / f"{demo}.toml", settings)


def bias_extension(coarser: str) -> tuple[Rows, Curves]:
    """Loads at angles of the middle, angle of the middle and the largest at the end."""
    rows: Rows = {}
    curves: Curves = {}
    values = [f"{mm} mm" for mm in (5, 10, 15, 20, 25, 30, 35, 40)]
    reference: TestResult | None = None
    for name, settings in MODELS.items():
        case = load("finite_bias_extension", f"test.extension={values}", coarser, *settings)
        network = Network(COMM, case.preform(), case.fabric())
        result, seconds = timed(case.experiment(network).solve)
        steps = sum(step.iterations for step in result.increments)
        centre = result.shear_angles_centre
        rows[name] = _bias_row(result.loads, centre, result.shear_angle_max, steps, seconds)
        rows[name]["unknowns"] = result.unknowns
        curves[name] = 1e3 * result.controls, result.loads
        if name == "cruciforms, hinged":
            reference = result
    assert reference is not None
    size = float(reference.network.pitch.min())
    membranes, seconds = timed(partial(solve_membranes, reference, size, False))
    middle = np.array([reference.network.preform.middle])
    here = middle if COMM.rank == 0 else middle[:0]
    centre = COMM.bcast([m.evaluate(here)["shear_angle"] for m in membranes])
    points = reference.network.crossover_position
    ends = membranes[-1].evaluate(points)["shear_angle"]
    most = max(COMM.allgather(float(np.nanmax(abs(ends), initial=0.0))))
    loads = np.array([m.load for m in membranes])
    steps = sum(m.newton_iterations for m in membranes)
    rows["membrane"] = _bias_row(loads, np.ravel(centre), most, steps, seconds)
    rows["membrane"]["unknowns"] = membranes[-1].dofs
    curves["membrane"] = 1e3 * reference.controls, loads
    return rows, curves


def _bias_row(loads, centre, most: float, steps: int, seconds: float) -> dict[str, Any]:
    centre = np.rad2deg(np.ravel(centre))
    told = {
        f"load at {at:g} deg in the middle, N": np.interp(at, centre, loads, right=np.nan)
        for at in AT_DEG
    }
    return told | {
        "load at 40 mm, N": loads[-1],
        "shear in the middle at 40 mm, deg": centre[-1],
        "largest shear of a crossover, deg": np.rad2deg(most),
        "Newton steps": steps,
        "processor time, s": seconds,
    }


def hemisphere(yarns: int) -> tuple[Rows, Curves]:
    """Punch force, shear and draw-in at the end of the stroke."""
    rows: Rows = {}
    curves: Curves = {}
    for name, settings in MODELS.items():
        case = load("hemisphere", f"preform.yarns_per_cruciform={yarns}", *settings)
        network = Network(COMM, case.preform(), case.fabric())
        forming = case.forming(network)
        formed, seconds = timed(partial(_form, forming, forming.blank))
        rows[name], curves[name] = _formed_row(formed, seconds)
        if name == "cruciforms, hinged":
            reference = forming
    size = formed_size(reference.network.preform, reference.network.fabric)
    blank = reference.lay(partial(MembraneBlank, size=size))
    formed, seconds = timed(partial(_form, reference, blank))
    rows["membrane"], curves["membrane"] = _formed_row(formed, seconds)
    return rows, curves


def _form(forming: Any, blank: Blank) -> Formed:
    """As far as it goes."""
    try:
        return form(blank, forming.plans, options=forming.options)
    except EquilibriumError as error:
        return error.result or Formed(blank)


def _formed_row(formed: Formed, seconds: float) -> tuple[dict[str, Any], Any]:
    names = [tool.name for tool in formed.blank.tools]
    begin = formed.blank.start().x[formed.blank.tool_node][names.index("punch"), 2]
    depth = [1e3 * float(begin - step.tool_place["punch"][2]) for step in formed.steps]
    force = [-float(step.tool_force["punch"][2]) for step in formed.steps]
    blank, state = formed.blank, formed.states[-1]
    cloth = blank.of_cloth(state)
    if isinstance(blank, MembraneBlank):
        gamma = blank.ply.at(cloth, blank.network.crossover_position)[1]
    else:
        gamma = blank.ply.fields(cloth)["shear_angle"]
    every = np.concatenate(COMM.allgather(abs(gamma)))
    row = {
        "depth reached, mm": depth[-1],
        "punch force, N": force[-1],
        "shear of 99 % of the crossovers, deg": np.rad2deg(np.quantile(every, 0.99)),
        "mean shear, deg": np.rad2deg(every.mean()),
        "steps": len(formed.steps),
        "Newton steps": sum(step.increment.iterations for step in formed.steps),
        "of them mended": sum(step.increment.shifted for step in formed.steps),
        "processor time, s": seconds,
        "unknowns": blank.model.dim * blank.nodes.num_nodes_global,
    }
    return row, (np.array(depth), np.array(force))


def tell(title: str, rows: Rows) -> None:
    """A table in Markdown, models side by side."""
    if COMM.rank:
        return
    print(f"\n{title}\n\n| | {' | '.join(rows)} |\n|---|{'---|' * len(rows)}")
    for what in next(iter(rows.values())):
        print(f"| {what} | {' | '.join(f'{row[what]:.4g}' for row in rows.values())} |")


def draw(found: dict[str, Curves], path: Path) -> None:
    """Load over extension, punch force over depth."""
    if COMM.rank:
        return
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure((5.5 * len(found), 4.2), layout="constrained")
    FigureCanvasAgg(figure)
    axes = np.atleast_1d(figure.subplots(1, len(found)))
    labels = {
        "bias": ("extension (mm)", "load (N)"),
        "hemisphere": ("depth (mm)", "punch force (N)"),
    }
    for axis, (name, curves) in zip(axes, found.items(), strict=True):
        for (model, (x, y)), style in zip(curves.items(), ("-", "--", "o", "s"), strict=True):
            axis.plot(x, y, style, markersize=4, fillstyle="none", label=model)
        axis.set_xlabel(labels[name][0])
        axis.set_ylabel(labels[name][1])
        axis.legend()
    path.parent.mkdir(exist_ok=True)
    figure.savefig(path, dpi=120)


def main() -> dict[str, Rows]:
    """Print the tables; returns them."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--case", choices=["bias", "hemisphere"], help="by default both")
    parser.add_argument("--yarns", type=int, default=3, help="to a cruciform of the hemisphere")
    parser.add_argument("--bias-yarns", type=int, default=1, help="of the bias extension")
    told = parser.parse_args()
    run = {
        "bias": partial(bias_extension, f"preform.yarns_per_cruciform={told.bias_yarns}"),
        "hemisphere": partial(hemisphere, told.yarns),
    }
    tables: dict[str, Rows] = {}
    found: dict[str, Curves] = {}
    for name in [told.case] if told.case else list(run):
        tables[name], found[name] = run[name]()
        tell(name, tables[name])
    draw(found, Path("results") / "compare_models.png")
    return tables


if __name__ == "__main__":
    main()
