# SPDX-License-Identifier: MIT
"""Nets of given force densities as an item: the form that a net between given edges takes.

Schek 1974, Comput. Methods Appl. Mech. Eng. 3:115, after Linkwitz: with the ratio q of force to
length given for each piece of yarn, equilibrium is linear in the places, and so is this energy's
gradient: sum of q l^2/2. The forces are q times the lengths in the form that is found.
"""

from __future__ import annotations

import numpy as np

from ..elements.level import FORCE, STIFFNESS, room
from .item import Item, Placed, Work
from .nodes import PlyNodes


class ForceDensity(Item):
    """Arms of a ply that pull with forces in proportion to their lengths.

    Parameters
    ----------
    ply : PlyNodes
    tension : pair of float
        Of warp and weft, per width, N/m, where the cloth lies at rest.
    """

    name = "force density"
    modes = ("tension",)

    def __init__(self, ply: PlyNodes, tension: tuple[float, float]):
        network, nodes = ply.network, ply.nodes
        rows, arm = np.nonzero((network.arm_length > 0) & ply.supports.carrying[:, None])
        length = network.arm_length[rows, arm]
        # Quadrants beside an arm, half of each; a yarn's force is then the same all along it.
        width = network.pitch[1 - arm % 2]
        self.density = np.asarray(tension, float)[arm % 2] * width / length
        hinge = nodes.of_hinge[rows]
        end = nodes.of_network_node[network.arm_node[rows, arm]]
        self.nodes = np.column_stack([hinge, end]).astype(np.int32)

    def work(self, state: Placed, level: int, rows=slice(None), before=None) -> Work:
        """See Item.work."""
        x, q = state.x[self.nodes[rows]], self.density[rows]
        along = x[:, 1] - x[:, 0]
        dim = x.shape[2]
        energy, force, stiffness = room(len(x), 1, 2, dim, level)
        energy[:, 0] = 0.5 * q * (along**2).sum(axis=1)
        if level >= FORCE:
            force[:, 1] = q[:, None] * along
            force[:, 0] = -force[:, 1]
        if level >= STIFFNESS:
            block = q[:, None, None] * np.eye(dim)
            for p in (0, 1):
                for r in (0, 1):
                    stiffness[:, p, :, r] = block if p == r else -block
        return energy, force, stiffness

    def forces(self, state: Placed) -> np.ndarray:
        """Force of each arm, N, (m,)."""
        ends = state.x[self.nodes]
        return self.density * np.linalg.norm(ends[:, 1] - ends[:, 0], axis=1)
