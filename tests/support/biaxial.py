# SPDX-License-Identifier: MIT
"""Cloths with laws of both tensions."""

import numpy as np

from cruciform_petsc.cloth.crimp import Crimp
from cruciform_petsc.cloth.surface import fit_surface
from cruciform_petsc.laws import linear
from cruciform_petsc.tension import SURFACE as KIND
from cruciform_petsc.tension import BiaxialLaw

# Glass yarns of some 300 tex: crimps of 0.50 and 0.18 %.
CRIMP = Crimp(
    (2e-3, 2.5e-3), (0.2e-3, 0.15e-3), (3000.0, 2500.0), (1e-9, 2e-9), linear(8e6)
)  # fmt: skip


def grid(low, high, n):
    """Pairs of strains, (n^2, 2)."""
    one = np.linspace(low, high, n)
    return np.stack(np.meshgrid(one, one, indexing="ij"), axis=-1).reshape(-1, 2)


def points_of(law, strains):
    """Strains and tensions, (n, 4)."""
    return np.column_stack([strains, law.evaluate(strains[:, 0], strains[:, 1])[1]])


def linear_law(warp, weft, both):
    """A surface of one patch: w = warp e_w^2/2 + weft e_e^2/2 + both e_w e_e from 0 to 0.1."""
    c = np.zeros((4, 4))  # powers 3 to 0
    c[1, 3], c[3, 1], c[2, 2] = warp / 2, weft / 2, both
    return BiaxialLaw((KIND, 1.0, 1.0, *[0.0, 0.1] * 4, *c.ravel().tolist()))


SURFACE = fit_surface(points_of(CRIMP.law, grid(0.0, 0.02, 6))).law
# For large strains: a coarse weave whose yarns bend so hard that they do not snap through.
COARSE = Crimp((1e-3, 1.2e-3), (0.4e-3, 0.3e-3), (60.0, 80.0), (1e-5, 2e-5), linear(2e5))
WIDE = fit_surface(points_of(COARSE.law, grid(-0.1, 0.25, 6))).law
