# SPDX-License-Identifier: MIT
# %% [markdown]
# A picture frame shears a cloth uniformly. The usual evaluation takes the shear force per length of
# a side from the load on the cross-head; times the cosine of the shear angle it is the shear law.

# %%
from pathlib import Path

import numpy as np
from mpi4py import MPI

from cruciform_petsc import Fabric, Network, PictureFrame, Preform, scene

folder = Path("results/scripts")  # of the pictures
folder.mkdir(parents=True, exist_ok=True)

# %% A cubic shear law, k1 gamma + k3 gamma^3, yarns without bending.
k1, k3 = 4.0, 30.0  # N/m
yarns = {"modulus": "35 N/mm", "poisson": 0.0, "yarns": "2 /cm"}
law = {"law": "polynomial", "coefficients": [f"{k1} N/m", f"{k3} N/m"]}
fabric = Fabric.from_table("cubic", {"warp": yarns, "weft": yarns, "shear": law})

# %% The sides of the frame follow the yarns.
preform = Preform.rectangle("100 mm", "100 mm", bias_angle="0 deg")
network = Network(MPI.COMM_WORLD, preform, fabric)

# %%
angles = ["10 deg", "20 deg", "30 deg", "40 deg"]
result = PictureFrame(network, angles, finite=True, bending=False).solve()

# %% What the evaluation gives, and what was put in. The work of the force per length f on an
# area at rest is f cos(gamma) d gamma.
gamma = result.controls[-1]
measured = result.curve()["shear_force_N_per_mm"][-1] * np.cos(gamma)

# %%
scene(result, f"{folder}/picture_frame.png")

# %%
numbers = {
    "load_N": result.load,
    "shear_measured_N_per_mm": float(measured),
    "shear_law_N_per_mm": float(1e-3 * (k1 * gamma + k3 * gamma**3)),
}
print(numbers)
