# SPDX-License-Identifier: MIT
"""Progressive drape: rows are laid, and brought to equilibrium, one piece after the other.

Sharma and Sutcliffe (2003). The pieces are rings of crossovers around the seed, as far along the
warp or the weft as one another. What lies beyond carries nothing yet (items.trimmed). When a piece
has come to equilibrium, the rows beyond it are laid anew as a fishnet, from where its edge is now.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import shapely

from ..equilibrium.state import State
from ..errors import EquilibriumError
from ..net.lattice import ARM_STEP
from ..net.network import Network
from .blank import Blank
from .fishnet import LAID, march
from .generators import Seed
from .lay import Block, place_of

ROWS = "rows "  # how names of what holds rows back begin


@dataclass(frozen=True)
class Rows:
    """Pieces of a blank, from the seed outwards.

    Parameters
    ----------
    network : Network
    first : int (2,)
        The seed's crossover.
    seed : Seed
    locking : float, rad
    pieces : int
        At most.

    Attributes
    ----------
    last : list of int
        Of each piece the last ring: crossovers from the seed, along either yarn.
    """

    network: Network
    first: np.ndarray
    seed: Seed
    locking: float
    last: list[int]

    @classmethod
    def of(cls, network: Network, first, seed: Seed, locking: float, pieces: int) -> Rows:
        """Divide a network evenly."""
        yarns, has = network.warp_yarns, network.warp_yarns.last >= network.warp_yarns.first
        along = [yarns.first[has] - first[0], yarns.last[has] - first[0]]
        far = int(np.abs(np.concatenate([*along, yarns.line[has] - first[1]])).max())
        ends = np.ceil(far * np.arange(1, pieces + 1) / pieces).astype(int)
        return cls(network, np.asarray(first), seed, locking, np.unique(ends).tolist())

    def cuts(self) -> dict[str, shapely.Polygon]:
        """What of the flat blank is laid before each piece but the first, by name."""
        found = {}
        for number, ring in enumerate(self.last[:-1], 1):
            corners = (ring + 0.25) * np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]])
            found[f"{ROWS}{number}"] = shapely.Polygon(
                [place_of(self.network, self.first + corner) for corner in corners]
            )
        return found

    def factors(self, number: int) -> dict[str, float]:
        """What the stage of a piece, counted from 0, brings to 1."""
        return {f"{ROWS}{number}": 1.0} if number else {}

    def next(self, blank: Blank, state: State, number: int) -> State:
        """The state in which a piece (from 1 on) begins: all beyond the one before laid anew.

        Collective. EquilibriumError, on every rank, where the net locks.
        """
        nodes, inner = blank.ply.nodes, self._laid(blank, self.last[number - 1])
        x = blank.of_cloth(state).x
        block = Block(self.network, self.first, self.seed, self.locking)
        joint, arms = self._joints(blank)
        place = self.seed.tool.start.to_tool(x)
        for at, node, good in ((joint, nodes.of_hinge, None), *arms):
            known = inner[node] if good is None else inner[node] & good
            where = block.net.at(at[known])
            block.net.x[where], block.net.status[where] = place[node[known]], LAID
        block.place(self._lines(blank, place, inner, block.counts))
        block.sweep()
        laid = block.result()
        if laid.limit:
            raise EquilibriumError(laid.limit, "LOCKED", [])
        new = state.x.copy()
        beyond = ~inner
        new[blank.cloth_at[beyond]] = laid.on_nodes(self.network, nodes)[beyond]
        moved = np.zeros(len(new), bool)
        moved[blank.cloth_at[beyond]] = True
        return blank.placed_anew(replace(state, x=new), moved)

    def _laid(self, blank: Blank, ring: int) -> np.ndarray:
        """Nodes of crossovers up to a ring, bool (n_local,). Collective.

        Without the arm ends that are free until the next rows are there: they have given way.
        """
        nodes, network = blank.ply.nodes, self.network
        count = np.zeros(nodes.num_nodes_local, np.int64)
        near = np.abs(network.crossover_ij.astype(np.int64) - self.first).max(axis=1) <= ring
        of_arm = nodes.of_network_node[network.arm_node[near]]
        np.add.at(count, of_arm, np.where(network.arm_is_shared[near], 1, 2))
        np.add.at(count, nodes.of_hinge[near], 2)
        return nodes.halo.share(count) >= 2

    def _joints(self, blank: Blank) -> tuple[np.ndarray, list[tuple]]:
        """Joints of crossovers (n, 2), and of their arms: these, their nodes, which are joints."""
        network, nodes = self.network, blank.ply.nodes
        joint = 2 * (network.crossover_ij.astype(np.int64) - self.first)
        of_arm = nodes.of_network_node[network.arm_node]
        return joint, [
            (joint + step, of_arm[:, arm], network.arm_is_shared[:, arm])
            for arm, step in enumerate(ARM_STEP)
        ]

    def _lines(self, blank, place, inner, counts: Sequence[int]) -> list[np.ndarray]:
        """Generators, as far as they are laid and on from there. Collective."""
        joint, arms = self._joints(blank)
        rows = []
        for at, node, good in ((joint, blank.ply.nodes.of_hinge, None), *arms):
            known = inner[node] if good is None else inner[node] & good
            known = known & (at == 0).any(axis=1)
            rows.append(np.column_stack([at[known], place[node[known]]]))
        gathered = np.concatenate(self.network.comm.allgather(np.concatenate(rows)))
        lines = []
        for k in range(4):
            axis, sign = k % 2, 1 if k < 2 else -1
            away = np.rint(sign * gathered[:, axis]).astype(int)
            mine = (gathered[:, 1 - axis] == 0.0) & (away >= 0)
            number, at = np.unique(away[mine], return_index=True)
            whole = number == np.arange(len(number))
            lines.append(gathered[mine][at[whole], 2:])
        ends = np.array([line[-1] for line in lines])
        along = np.array([line[-1] - line[-2] for line in lines])
        link = np.tile(0.5 * self.network.pitch, 2)
        more = [max(count + 1 - len(line), 0) for count, line in zip(counts, lines, strict=True)]
        surface, upright = self.seed.tool.surface, self.seed.upward if self.seed.upright else None
        further = march(surface, self.seed.gap, ends, along, link, more, upright)
        return [np.concatenate([line, on[1:]]) for line, on in zip(lines, further, strict=True)]
