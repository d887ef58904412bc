# SPDX-License-Identifier: MIT
"""Cost of energy, force and stiffness of 250,000 cruciforms against streaming their data once.

    ./scripts/fenicsx python3 scripts/bench_kernels.py

Streaming is a copy of all that a kernel reads and writes, from memory to memory. One thread; the
least of seven runs of each, alternately.
"""

import time

import numpy as np

from cruciform_petsc.elements import cruciform as kernels
from cruciform_petsc.laws import linear, table

NUMBER, RUNS = 250_000, 7
LINEAR = linear(600.0).packed
CLOTHS = {
    "linear laws": kernels.Cloth(LINEAR, LINEAR, linear(96.0).packed, 210.0),
    "tables, logarithmic strain, softening": kernels.Cloth(
        table([0.01, 0.1], [5.0, 90.0]).packed, LINEAR,
        table([0.1, 0.5, 1.0], [5.0, 40.0, 300.0]).packed, 0.0, True, 0.01,
    ),
}  # fmt: skip


def seconds(function, *arguments, **options) -> float:
    """Processor time of a call."""
    begin = time.process_time()
    function(*arguments, **options)
    return time.process_time() - begin


def copy(pairs) -> None:
    """Copy arrays onto others."""
    for source, target in pairs:
        np.copyto(target, source)


def main() -> dict[str, float]:
    """Print the table; returns ratios by row."""
    rng = np.random.default_rng(1)
    ratios = {}
    print("| dimensions | laws | kernel, s | streaming, s | ratio |\n|---|---|---|---|---|")
    for dim in (2, 3):
        x = np.zeros((NUMBER, 5, dim))
        x[:, [0, 1], [0, 1]], x[:, [2, 3], [0, 1]] = 1.0, -1.0
        x += rng.uniform(-0.05, 0.05, x.shape)
        length, area = np.ones((NUMBER, 4)), np.ones((NUMBER, 4))
        own = np.ascontiguousarray(np.broadcast_to(np.arange(4), (NUMBER, 4)), np.int64)
        held = np.zeros((NUMBER, 4, dim))
        for name, cloth in CLOTHS.items():
            given = (x, length, area, cloth, kernels.STIFFNESS, own, own, held)
            out = kernels.cruciforms(*given)
            arrays = (x, length, area, own, own, held, *out)
            pairs = [(array, array.copy()) for array in arrays]
            kernel, stream = np.min(
                [
                    (seconds(kernels.cruciforms, *given, out=out), seconds(copy, pairs))
                    for _ in range(RUNS)
                ],
                axis=0,
            )
            ratios[f"{dim}, {name}"] = kernel / stream
            row = f"{dim} | {name} | {kernel:.3f} | {stream:.3f} | {kernel / stream:.1f}"
            print(f"| {row} |", flush=True)
    return ratios


if __name__ == "__main__":
    main()
