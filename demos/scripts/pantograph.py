# SPDX-License-Identifier: MIT
# %% [markdown]
# The pantographic sheet of dell'Isola et al. 2016: printed beams on pivots, pulled by 56.7 mm. It
# is a net of yarns that bend. How is the work shared out?

# %%
from pathlib import Path

from mpi4py import MPI

from cruciform_petsc import Fabric, Network, Pantograph, Preform, plot

folder = Path("results/scripts")  # of the pictures
folder.mkdir(parents=True, exist_ok=True)

# %%
fabric = Fabric.from_library("pantographic-sheet-2016")
preform = Preform.rectangle("67.88 mm", "203.65 mm", bias_angle="45 deg")
network = Network(MPI.COMM_WORLD, preform, fabric)

# %%
result = Pantograph(network, ["28 mm", "56.7 mm"], finite=True).solve()

# %% Pivots resist shear, beams stretch and bend.
energy = {mode: float(values[-1]) for mode, values in result.energies().items()}
total = sum(energy.values())

# %%
plot(result, f"{folder}/pantograph.png")

# %%
numbers = {
    "load_N": result.load,
    **{f"{mode}_share": value / total for mode, value in energy.items()},
}
print(numbers)
