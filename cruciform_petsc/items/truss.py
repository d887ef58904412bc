# SPDX-License-Identifier: MIT
"""A ply as a truss: pin-jointed bars along the yarns, soft diagonals in place of shear.

The model of Sharma and Sutcliffe (2004) for a cloth's drape, to compare the cruciforms with: joints
are the crossovers and the yarns' ends, yarns do not bend, and warp and weft do not couple.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from ..elements.level import ENERGY
from ..elements.truss import crosses
from ..errors import InputError
from ..laws import linear
from ..net.lattice import ARM_STEP, OPPOSITE, QUADRANTS
from ..net.nodes import Nodes
from .item import Item, Placed, Work
from .ply import Ply


class Truss(Item):
    """Crosses of bars (elements.truss), one at each crossover that carries load.

    Attributes
    ----------
    rows : int (m,)
        This rank's crossovers.
    length : float (m, 4), m
        Of bars, from a crossover to the next or to the yarn's end.
    area : float (m, 4), m^2
        Of quadrants between bars. Those at the outline where a yarn has no bar are counted with
        the quadrant of the same cell at the next crossover.
    """

    name = "truss"
    modes = ("tension", "shear")

    def __init__(self, ply: TrussPly):
        network, nodes = ply.network, ply.nodes
        fabric = network.fabric
        warp, weft = (
            fabric.c11 - fabric.c12**2 / fabric.c22,
            fabric.c22 - fabric.c12**2 / fabric.c11,
        )
        self._laws = (
            fabric.warp_law or linear(warp),
            fabric.weft_law or linear(weft),
            fabric.shear,
            fabric.effective_strain,
        )
        self.rows = rows = np.flatnonzero(ply.supports.carrying)
        ends, self.length = ply.joints(rows)
        area = network.quadrant_area.copy()
        here = nodes.of_hinge[rows]
        # Quadrants without both bars, to the next crossover along the one that there is.
        away = np.zeros((nodes.num_nodes_local, 4))
        has = self.length > 0
        for quadrant, pair in enumerate(QUADRANTS):
            for along, lacking in (pair, pair[::-1]):
                at = np.flatnonzero(has[:, along] & ~has[:, lacking])
                at = at[ply.carries[ends[at, along]]]
                back = {int(OPPOSITE[along]), int(lacking)}
                other = next(q for q, p in enumerate(QUADRANTS) if set(p.tolist()) == back)
                np.add.at(away[:, other], ends[at, along], area[rows[at], quadrant])
        nodes.halo.reverse(away)
        both = has[:, QUADRANTS].all(axis=2)
        self.area = np.where(both, area[rows] + away[here], 0.0)
        self.nodes = np.column_stack([np.where(has, ends, here[:, None]), here]).astype(np.int32)

    def work(self, state: Placed, level: int, rows=slice(None), before=None) -> Work:
        """See Item.work."""
        return crosses(
            state.x[self.nodes[rows]],
            self.length[rows],
            self.area[rows],
            *self._laws,
            level,
        )

    def broken(self, state: Placed) -> tuple[np.ndarray, str, str] | None:
        """See Item.broken: nothing is told of bars that pass each other."""
        return None


class TrussPly(Ply):
    """A Ply whose item is a Truss. Collective. Yarns may not bend, in the plane or out of it.

    Raises InputError on every rank for cloth that is stretched at rest.
    """

    def __init__(self, constraints, out_of_plane=None, flat=True, prestretch=(1.0, 1.0)):
        if tuple(prestretch) != (1.0, 1.0):
            raise InputError('test.model = "truss" takes no test.pretension, leave one of them out')
        super().__init__(constraints, out_of_plane, flat)
        network, nodes = self.network, self.nodes
        # Between crossovers there is no joint.
        between = np.zeros(nodes.num_nodes_local, bool)
        shared = network.arm_node[network.arm_is_shared]
        between[nodes.of_network_node[shared]] = True
        self.between = nodes.halo.share(between, np.logical_or)
        self.active &= ~self.between
        self.further = []  # cloth that twists does so by yarns that bend
        self.truss = Truss(self)

    def _nodes(self) -> Nodes:
        return Nodes(self.network, self.dim, around=True)

    def joints(self, rows: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Local nodes (m, 4) at the ends of the bars of crossovers, -1 for none, and lengths."""
        network, nodes = self.network, self.nodes
        ij = network.crossover_ij[rows].astype(np.int64)
        ends = np.full((len(rows), 4), -1)
        length = np.zeros((len(rows), 4))
        for arm in range(4):
            shared = network.arm_is_shared[rows, arm]
            tail = ~shared & (network.arm_length[rows, arm] > 0)
            following = nodes.find_hinges(ij + ARM_STEP[arm])
            following[~shared] = -1
            joined = (following >= 0) & self.carries[following]
            ends[joined, arm] = following[joined]
            length[joined, arm] = network.pitch[arm % 2]
            ends[tail, arm] = nodes.of_network_node[network.arm_node[rows[tail], arm]]
            length[tail, arm] = network.arm_length[rows[tail], arm]
        return ends, length

    @property
    def items(self) -> list[Item]:
        """What adds to equilibrium."""
        return [self.truss, self.loads, *self.further]

    def with_shear_law(self, law):
        """See Ply.with_shear_law."""
        raise NotImplementedError("a truss has the shear law of its fabric")

    def areas(self, at_hinge: float = 0.0) -> np.ndarray:
        """See PlyNodes.areas; what lies between two crossovers is shared by these. Collective."""
        network, nodes = self.network, self.nodes
        area = super().areas(at_hinge)
        for arm in range(4):
            at = np.flatnonzero(network.arm_is_shared[:, arm])
            node = nodes.of_network_node[network.arm_node[at, arm]]
            area[nodes.of_hinge[at]] += 0.5 * area[node]
        area[self.between] = 0.0
        return nodes.halo.forward(area)

    # -- results --------------------------------------------------------------------------------

    def _filled(self, state: Placed) -> Any:
        """The state with arm ends between crossovers halfway between these. Collective."""
        network, nodes = self.network, self.nodes
        total = np.zeros((nodes.num_nodes_local, self.dim + 1))
        for arm in range(4):
            at = np.flatnonzero(network.arm_is_shared[:, arm])
            node = nodes.of_network_node[network.arm_node[at, arm]]
            np.add.at(total[:, :-1], node, state.x[nodes.of_hinge[at]])
            np.add.at(total[:, -1], node, 1.0)
        nodes.halo.share(total)
        x, known = state.x.copy(), total[:, -1] > 0
        x[known] = total[known, :-1] / total[known, -1:]
        return replace(state, x=x)  # type: ignore[type-var]

    def shear_angle_max(self, state: Placed) -> float:
        """See Ply.shear_angle_max. Collective."""
        return super().shear_angle_max(self._filled(state))

    def displacement(self, state: Placed) -> tuple[np.ndarray, np.ndarray]:
        """See PlyNodes.displacement. Collective."""
        return super().displacement(self._filled(state))

    def fields(self, state: Placed) -> dict[str, np.ndarray]:
        """See Ply.fields; energies are those of the bars. Collective."""
        fields = super().fields(self._filled(state))
        truss = self.truss
        energy = np.concatenate([truss.work(state, ENERGY, rows)[0] for rows in truss.chunks()])
        for name in [name for name in fields if name.endswith("_energy")]:
            fields[name] = np.zeros_like(fields[name])
        for i, mode in enumerate(truss.modes):
            fields[f"{mode}_energy"][truss.rows] = energy[:, i]
        return fields
