# SPDX-License-Identifier: MIT
# %% [markdown]
# Kilby's relation (1963): strips pulled along the warp, along the weft and at 45 degrees tell the
# modulus at every angle, and the shear modulus. Here nets stand for the strips, with free ends.

# %%
from math import radians

from mpi4py import MPI

from cruciform_petsc import Fabric, Network, OffAxisTension, Preform
from cruciform_petsc.calibration import Kilby

WIDTH, LENGTH = 0.04, 0.16  # m

fabric = Fabric.from_library("e-glass-plain-2.4")

# %% Small displacements: stress over strain is the modulus.
modulus = {}
for degrees in (0, 90, 45, 30):
    preform = Preform.rectangle(WIDTH, LENGTH, bias_angle=f"{degrees} deg", refine=2)
    network = Network(MPI.COMM_WORLD, preform, fabric)
    test = OffAxisTension(network, "0.1 mm", finite=False, ends="free")
    result = test.solve()
    modulus[degrees] = result.load / WIDTH / (result.extension / LENGTH)

# %% From three to the shear modulus and to the fourth; N/m to N/cm.
kilby = Kilby.from_strips(modulus[0], modulus[90], modulus[45], poisson=fabric.warp.poisson)

# %%
numbers = {
    "shear_N_per_cm": kilby.shear_modulus / 100.0,
    "at_30_N_per_cm": modulus[30] / 100.0,
    "kilby_at_30_N_per_cm": float(kilby.modulus(radians(30))) / 100.0,
}
print(numbers)
