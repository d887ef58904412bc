# SPDX-License-Identifier: MIT
# %% [markdown]
# A strip bent in its plane. Cloth that hardly resists shear lets its yarns slide past each other,
# so that each bends by itself: the rigidity of a yarn can be read from the deflection.

# %%
from pathlib import Path

from mpi4py import MPI

from cruciform_petsc import Cantilever, Fabric, Network, Preform, plot

LENGTH, LOAD = 0.1, 1e-5  # m, N
RIGIDITY, SHEAR = 5e-7, 1e-4  # of a yarn, N m^2; of the cloth, N/m

folder = Path("results/scripts")  # of the pictures
folder.mkdir(parents=True, exist_ok=True)

# %%
yarns = {
    "modulus": "520 N/cm",
    "poisson": 0.0,
    "yarns": "2.4 /cm",
    "yarn_bending": f"{RIGIDITY} N m^2",
}
shear = {"modulus": f"{SHEAR} N/m"}
fabric = Fabric.from_table("limp", {"warp": yarns, "weft": yarns, "shear": shear})

# %% Seven yarns along y, clamped below, loaded across above.
preform = Preform.rectangle("27 mm", LENGTH, bias_angle="0 deg")
network = Network(MPI.COMM_WORLD, preform, fabric)
result = Cantilever(network, LOAD, finite=True).solve()
deflection = result.curve()["tip_across_mm"][-1]

# %% Seven beams side by side: 7 B = P L^3 / (3 w), at small deflection.
rigidity = LOAD * LENGTH**3 / (3.0 * 1e-3 * deflection) / 7.0

# %%
plot(result, f"{folder}/cantilever.png")

# %%
numbers = {
    "deflection_mm": float(deflection),
    "rigidity_read_N_mm2": float(1e6 * rigidity),
    "rigidity_given_N_mm2": 1e6 * RIGIDITY,
}
print(numbers)
