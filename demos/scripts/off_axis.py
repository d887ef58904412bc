# SPDX-License-Identifier: MIT
# %% [markdown]
# Tension at 30 degrees to the warp. Between free ends a strip of many yarns has Kilby's modulus;
# grips keep it from shearing as it would, and make it stiffer.

# %%
from pathlib import Path

from mpi4py import MPI

from cruciform_petsc import Fabric, Network, OffAxisTension, Preform, plot

WIDTH, LENGTH = 0.04, 0.16  # m

folder = Path("results/scripts")  # of the pictures
folder.mkdir(parents=True, exist_ok=True)

# %%
fabric = Fabric.from_library("e-glass-plain-2.4")
preform = Preform.rectangle(WIDTH, LENGTH, bias_angle="30 deg", refine=4)
network = Network(MPI.COMM_WORLD, preform, fabric)

# %% Small displacements: stress over strain is the modulus.
modulus = {}
for ends in ("free", "grip"):
    test = OffAxisTension(network, "0.1 mm", finite=False, ends=ends, bending=False)
    result = test.solve()
    modulus[ends] = result.load / WIDTH / (result.extension / LENGTH)
    plot(result, f"{folder}/off_axis_{ends}.png")

# %% N/m to N/cm.
kilby = fabric.off_axis_modulus(preform.bias_angle)

# %%
numbers = {
    "free_N_per_cm": modulus["free"] / 100.0,
    "gripped_N_per_cm": modulus["grip"] / 100.0,
    "kilby_N_per_cm": float(kilby) / 100.0,
}
print(numbers)
