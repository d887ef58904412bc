# SPDX-License-Identifier: MIT
"""Assembly of the network beside dolfinx's of a membrane with as many unknowns, in one run.

    ./scripts/fenicsx python3 scripts/bench_assembly.py [--crossovers 240000]
    ./scripts/fenicsx python3 scripts/bench_assembly.py --coo --crossovers 60000

Prints matrix entries per second of the first assembly (pattern included) and of re-assembly;
writes results/bench_assembly_RANKS.json and a picture. The membrane is plane
stress with linear and with quadratic displacements on triangles: the latter have about as many
entries per row as the network. All are assembled in turn, some times, and the least is told: memory
that a process touches for the first time costs whoever comes first more than the assembly.
With --coo PETSc's assembly from lists of (row, column, value) stands beside solvers/pattern.py.
"""

import argparse
import ctypes
from functools import partial
from pathlib import Path

import benchlib
import numpy as np
from benchlib import COMM, TABLE_1, Table, best, clock, outline
from petsc4py import PETSc

from cruciform_petsc import Network, Preform
from cruciform_petsc.net.edges import Constraints
from cruciform_petsc.small.network import LinearNetwork

ROUNDS = 4


def entries(matrix) -> int:
    """Entries of all ranks."""
    return int(matrix.getInfo()["nz_used"])


def membrane(unknowns: int, degree: int):
    """Bilinear form of an orthotropic membrane on a square with about some unknowns."""
    import ufl
    from dolfinx import fem, mesh

    n = max(2, round((unknowns / 2) ** 0.5 / degree))
    domain = mesh.create_unit_square(COMM, n, n)
    space = fem.functionspace(domain, ("Lagrange", degree, (2,)))
    u, v = ufl.TrialFunction(space), ufl.TestFunction(space)

    def strain(w):
        gradient = ufl.grad(w)
        return ufl.as_vector([gradient[0, 0], gradient[1, 1], gradient[0, 1] + gradient[1, 0]])

    c11, c22, c12 = TABLE_1.c11, TABLE_1.c22, TABLE_1.c12
    law = ufl.as_matrix(np.array([[c11, c12, 0], [c12, c22, 0], [0, 0, TABLE_1.shear_modulus]]))
    form = fem.form(ufl.inner(law * strain(u), strain(v)) * ufl.dx)
    return form, space.dofmap.index_map.size_global * 2


def ours(crossovers: float, bending: bool) -> dict:
    """Times of one network."""
    stages = {}

    def stage(name, call):
        with clock() as seconds:
            result = call()
        stages[name] = seconds.cpu
        return result

    cut = outline(crossovers, "rectangle")
    network = stage("network", lambda: Network(COMM, Preform(cut, benchlib.BIAS), TABLE_1))
    constraints = Constraints(network, bending)
    constraints.clamp("lower")
    constraints.clamp("upper", (0.0, 0.01))
    linear = stage("elements", lambda: LinearNetwork(constraints))
    matrix = stage("first", linear.matrix)
    again = best(lambda: linear.matrix(reuse=matrix), 3).cpu
    result = {
        "crossovers": network.num_crossovers_global,
        "unknowns": matrix.getSize()[0],
        "entries": entries(matrix),
        "first": stages["first"],
        "again": again,
        **{key: stages[key] for key in ("network", "elements")},
    }
    matrix.destroy()
    return result


def beside_coo(crossovers: float, bending: bool) -> tuple[dict, dict]:
    """Times of pattern.py, and of MatSetPreallocationCOO and MatSetValuesCOO. One rank.

    Element matrices are ready; the least of five. For COO it is known beforehand which entries are
    zero in the yarn frame; pattern.py finds out. petsc4py 3.22 has no names for the two: PETSc's
    own are called.
    """
    case = benchlib.system(crossovers, bending=bending)
    linear, size = case.linear, case.matrix.getSize()[0]
    d, nodes = linear.unknowns_per_node, linear.network.arm_node
    library = ctypes.CDLL(PETSc.__file__)

    def call(name, matrix, *arguments):
        given = [ctypes.c_void_p(a.ctypes.data) if isinstance(a, np.ndarray) else a
                 for a in arguments]  # fmt: skip
        assert getattr(library, name)(ctypes.c_void_p(matrix.handle), *given) == 0

    values = np.zeros((len(nodes), (4 * d) ** 2))
    for group, (matrix, _) in zip(linear.groups, linear._condense(()), strict=True):
        values[group.rows] = matrix.reshape(len(matrix), -1)
    keep = abs(values) > 1e-11 * abs(values).max(axis=1, keepdims=True)
    idle = np.arange(size, dtype=PETSc.IntType)

    def first():
        unknown = (nodes[:, :, None] * d + np.arange(d)).reshape(len(nodes), -1)
        row, column = np.repeat(unknown, 4 * d, axis=1)[keep], np.tile(unknown, 4 * d)[keep]
        coo = PETSc.Mat().create(comm=PETSc.COMM_SELF)
        coo.setSizes((size, size))
        coo.setType("aij")
        pairs = [np.concatenate([part, idle]).astype(PETSc.IntType) for part in (row, column)]
        call("MatSetPreallocationCOO", coo, ctypes.c_int64(len(pairs[0])), *pairs)
        return coo

    def again():
        listed = np.concatenate([values[keep], np.zeros(size)])
        call("MatSetValuesCOO", coo, listed, ctypes.c_int(PETSc.InsertMode.INSERT_VALUES))

    def our_first():
        for name in ("_pattern", "_layout"):
            vars(linear).pop(name, None)
        return linear.matrix()

    results = []
    for make in (our_first, first):
        seconds = []
        for _ in range(5):
            with clock() as one:
                coo = matrix = make()
                if make is first:
                    again()
            seconds.append(one.cpu)
        fill = again if make is first else partial(linear.matrix, reuse=matrix)
        count = {"unknowns": size, "entries": entries(matrix)}
        results.append(count | {"first": min(seconds), "again": best(fill, 5).cpu})
    return results[0], results[1]


def theirs(unknowns: int, degree: int) -> dict:
    """Times of dolfinx."""
    from dolfinx.fem import petsc

    form, size = membrane(unknowns, degree)

    def first():
        matrix = petsc.create_matrix(form)
        petsc.assemble_matrix(matrix, form)
        matrix.assemble()
        return matrix

    with clock() as seconds:
        matrix = first()

    def again():
        matrix.zeroEntries()
        petsc.assemble_matrix(matrix, form)
        matrix.assemble()

    result = {
        "unknowns": size,
        "entries": entries(matrix),
        "first": seconds.cpu,
        "again": best(again, 3).cpu,
    }
    matrix.destroy()
    return result


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--crossovers", type=float, default=240_000)
    parser.add_argument("--coo", action="store_true", help="beside PETSc's COO assembly instead")
    arguments, _ = parser.parse_known_args()
    benchlib.say_machine()
    for bending in (True, False):  # compiled, or read, before the clock runs
        ours(3000, bending)
    if not arguments.coo:
        theirs(2000, 1), theirs(2000, 2)
    table = Table(
        f"Assembly on {COMM.size} rank(s), processor time",
        "what", "unknowns", "entries, 10^6", "first, s", "again, s", "first, 10^6 entries/s",
        "again, 10^6 entries/s",
    )  # fmt: skip
    results: dict[str, dict] = {}

    def least(name: str, one: dict) -> None:
        known = results.setdefault(name, one)
        known |= {key: min(one[key], known[key]) for key in one}

    for _ in range(1 if arguments.coo else ROUNDS):
        for bending in (True, False):
            name = f"network, {'bending' if bending else 'no bending'}"
            if arguments.coo:
                pair = beside_coo(arguments.crossovers, bending)
                results[f"{name}, pattern.py"], results[f"{name}, COO"] = pair
            else:
                least(name, ours(arguments.crossovers, bending))
        for degree in () if arguments.coo else (1, 2):
            unknowns = results["network, bending"]["unknowns"]
            least(f"dolfinx, degree {degree}", theirs(unknowns, degree))
    for name, one in results.items():
        table.row(
            name,
            one["unknowns"],
            f"{one['entries'] / 1e6:.1f}",
            f"{one['first']:.3f}",
            f"{one['again']:.3f}",
            f"{one['entries'] / one['first'] / 1e6:.1f}",
            f"{one['entries'] / one['again'] / 1e6:.1f}",
        )
    if COMM.rank == 0 and not arguments.coo:
        own = results["network, bending"]
        print(f"\nnetwork generated in {own['network']:.2f} s, elements and supports in "
              f"{own['elements']:.2f} s")  # fmt: skip
    name = f"results/bench_{'coo' if arguments.coo else 'assembly'}_{COMM.size}"
    benchlib.save(Path(f"{name}.json"), assembly=results)
    if COMM.rank == 0:
        picture(Path(f"{name}.png"), results)


def picture(path: Path, results: dict) -> None:
    """Bars of entries per second."""
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot

    names = list(results)[::-1]
    figure, axes = pyplot.subplots(figsize=(7, 3), layout="constrained")
    for shift, key in ((0.2, "first"), (-0.2, "again")):
        axes.barh(
            [k + shift for k in range(len(names))],
            [results[name]["entries"] / results[name][key] / 1e6 for name in names],
            0.4,
            label=key,
        )
    axes.set_yticks(range(len(names)), names)
    axes.set_xlabel(f"10^6 matrix entries per second, {COMM.size} rank(s)")
    axes.legend(frameon=False)
    figure.savefig(path, dpi=150)
    pyplot.close(figure)


if __name__ == "__main__":
    main()
