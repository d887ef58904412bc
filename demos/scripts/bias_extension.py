# SPDX-License-Identifier: MIT
# %% [markdown]
# Bias extension of a glass/PP plain weave, 115 mm x 230 mm, to 30 mm. What is the load, and how far
# is the middle from the angle of a net whose yarns do not stretch?

# %%
from pathlib import Path

import numpy as np
from mpi4py import MPI

from cruciform_petsc import BiasExtension, Fabric, Network, Preform, plot, scene

WIDTH, LENGTH = 0.115, 0.23  # m

folder = Path("results/scripts")  # of the pictures
folder.mkdir(parents=True, exist_ok=True)

# %% The cloth is in the library, its shear law identified from a measured curve.
fabric = Fabric.from_library("glass-pp-plain-1.93")

# %% The specimen is cut at 45 degrees: pulled, its yarns turn towards the pull.
preform = Preform.rectangle(WIDTH, LENGTH, bias_angle="45 deg")
network = Network(MPI.COMM_WORLD, preform, fabric)

# %% Large displacements, three points of the curve.
test = BiasExtension(network, ["10 mm", "20 mm", "30 mm"], finite=True)
result = test.solve()

# %% The net's kinematics: the diagonals of the middle zone give the angle.
free = LENGTH - WIDTH
cosine = (free + result.extension) / (np.sqrt(2.0) * free)
net = 90.0 - 2.0 * np.rad2deg(np.arccos(cosine))

# %% Before and after, flat and woven.
plot(result, f"{folder}/bias_extension.png")
scene(result, f"{folder}/bias_extension_woven.png")

# %%
numbers = {
    "load_N": result.load,
    "shear_centre_deg": float(np.rad2deg(result.shear_angle_centre)),
    "shear_of_net_deg": float(net),
}
print(numbers)
