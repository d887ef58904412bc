# SPDX-License-Identifier: MIT
# %% [markdown]
# Biaxial tension of crimped yarns, the weft stretched half as much as the warp: first the crimp
# straightens, then the glass is pulled.

# %%
from pathlib import Path

from mpi4py import MPI

from cruciform_petsc import Biaxial, Fabric, Network, Preform

folder = Path("results/scripts")  # of the pictures
folder.mkdir(parents=True, exist_ok=True)

# %% The warp's tension is a table, the weft's a straight line.
points = [[0.5, 5.0], [1.0, 30.0], [1.5, 80.0]]
table = {"law": "table", "strain": "%", "force": "N/cm", "points": points}
fabric = Fabric.from_table(
    "crimped",
    {
        "warp": {"tension": table, "poisson": 0.0, "yarns": "2.4 /cm"},
        "weft": {"modulus": "520 N/cm", "poisson": 0.0, "yarns": "2.4 /cm"},
        "shear": {"modulus": "0.96 N/cm"},
    },
)

# %% Warp along y.
preform = Preform.rectangle("50 mm", "50 mm", bias_angle="0 deg")
network = Network(MPI.COMM_WORLD, preform, fabric)
strains = ["0.25 %", "0.5 %", "0.75 %", "1 %"]
result = Biaxial(network, strains, ratio=0.5, finite=True, bending=False).solve()

# %% Tension against strain; every column has its unit in its name.
curve = result.curve()
if network.comm.rank == 0:
    import matplotlib.pyplot as plt

    figure, axes = plt.subplots()
    for family in ("warp", "weft"):
        tension = curve[f"tension_{family}_N_per_cm"]
        axes.plot(curve["strain_warp_percent"], tension, "o-", label=family)
    axes.set(xlabel="warp strain (%)", ylabel="tension (N/cm)")
    axes.legend()
    figure.savefig(f"{folder}/biaxial.png", dpi=150)

# %%
numbers = {
    "warp_N_per_cm": float(curve["tension_warp_N_per_cm"][-1]),
    "weft_N_per_cm": float(curve["tension_weft_N_per_cm"][-1]),
}
print(numbers)
