# SPDX-License-Identifier: MIT
"""A network laid on a tool as a fishnet, each rank its own part.

The lattice of the fishnet is twice as fine as that of the network: its links are the cruciforms'
arms, so that crossovers and the arm ends between them lie at one distance from the tool. Joints
are dealt out as crossovers are. Each rank lays what it owns as soon as it knows the joints before
it, and gives what its neighbours wait for; all ranks know the two generators, which are lines.
A joint outside the outline (in a hole, in a corner) is laid where one of the cloth follows from it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ..errors import InputError
from ..net.lattice import ARM_STEP
from ..net.network import Network
from ..net.nodes import Nodes
from ..parallel import Halo, least
from ..quantities import length
from ..tools.tool import Tool
from .fishnet import LAID, LOCKS, WAITS, Fishnet, on_circles, unit
from .generators import Seed

PATCH = 1e-3  # size of cloth that is not laid, where all nodes need a place
FAR = np.iinfo(np.int64).max


@dataclass(frozen=True)
class Laid:
    """Cloth on a tool.

    Attributes
    ----------
    crossovers, ends : float (n_owned, 3), (n_owned, 4, 3)
        Of this rank's crossovers and the ends of their arms, lab frame, m; NaN where none is.
    laid : bool (n_owned,)
        Crossovers that are, with all of their arms.
    seed : float (2,), (3,)
        The crossover that was laid first, on the flat blank and in space, m.
    joints : int
        That were laid, on all ranks.
    beyond : int
        Crossovers that lie where the tool has ended.
    limit : str
        What ended it and where, in a sentence; empty if all is laid.
    """

    crossovers: np.ndarray
    ends: np.ndarray
    laid: np.ndarray
    seed: tuple[np.ndarray, np.ndarray]
    joints: int
    beyond: int
    limit: str

    @property
    def points(self) -> np.ndarray:
        """All that are laid on this rank, (m, 3), m."""
        points = np.concatenate([self.crossovers, self.ends.reshape(-1, 3)])
        return points[~np.isnan(points[:, 0])]

    def on_nodes(self, network: Network, nodes: Nodes) -> np.ndarray:
        """Places of nodes, (n_local, 3), m. Collective.

        Those that are not laid lie at the seed, as a patch of flat cloth too small to be seen.
        """
        x = np.full((nodes.num_nodes_local, 3), np.nan)
        x[nodes.of_hinge] = self.crossovers
        there = ~np.isnan(self.ends[..., 0])
        x[nodes.of_network_node[network.arm_node[there]]] = self.ends[there]
        patch = self.seed[1] + PATCH * (nodes.rest - np.append(self.seed[0], nodes.rest[:1, 2]))
        return nodes.halo.forward(np.where(np.isnan(x), patch, x))


def seed_crossover(network: Network, place: np.ndarray) -> np.ndarray:
    """Lattice position of the crossover nearest to a place (2,) on the flat blank, m; int64 (2,).

    InputError where the net does not reach.
    """
    ij = np.round(network.to_yarn(place - network.origin) / network.pitch).astype(np.int64)
    low, high = (np.array(f(network.partition.box, axis=0)) for f in (np.min, np.max))
    if (ij < low[0]).any() or (ij >= high[1]).any():
        x, y = map(length, place)
        raise InputError(f"the seed, x = {x}, y = {y}, does not lie on the blank")
    return ij


def place_of(network: Network, ij: np.ndarray) -> np.ndarray:
    """Where a lattice point (2,) lies on the flat blank, (2,), m."""
    return network.to_lab(ij * network.pitch) + network.origin


def lay(network: Network, first: np.ndarray, seed: Seed, locking: float) -> Laid:
    """Lay the network from a crossover ``first`` (2,), int, at a seed. Collective.

    Raises InputError on every rank as Seed does.
    """
    block = Block(network, first, seed, locking)
    block.place(seed.generators(block.net.link, block.counts))
    block.sweep()
    return block.result()


class Block:
    """The joints of this rank's part of a network. Collective, as are its methods.

    Attributes
    ----------
    net : Fishnet
    counts : list of int
        Joints that generators need along warp and weft, and back.
    """

    def __init__(self, network: Network, first: np.ndarray, seed: Seed, locking: float):
        self.network, self.first, self.seed = network, np.asarray(first, np.int64), seed
        reach = _reaches(network, first)
        low, high = network.partition.box[network.comm.rank]
        begin, shape = 2 * (low - first) - 1, 2 * (high - low) + 2
        surface, link = seed.tool.surface, 0.5 * network.pitch
        self.net = Fishnet(surface, seed.gap, link, begin, shape, seed.below, locking)
        self.counts = _counts(reach)
        wanted = _wanted(reach, begin, shape)
        self._ghosts, self._halo = _ghosts(network, first, begin, shape, wanted)
        self._mine = wanted.copy()
        self._mine.reshape(-1)[self._ghosts] = False

    def place(self, lines: Sequence[np.ndarray]) -> None:
        """Lay the generators, four float (n, 3), where nothing is laid yet. Not collective."""
        for k, line in enumerate(lines):
            self.net.place(k % 2, 1 if k < 2 else -1, line, self.counts[k])

    def sweep(self) -> None:
        """Lay all that can be."""
        x, status = self.net.x.reshape(-1, 3), self.net.status.reshape(-1)
        done = 1
        while done:
            for values in (x, status):
                values[self._ghosts] = self._halo.to_ghosts(values[self._halo.exported])
            done = self.network.comm.allreduce(self.net.sweep(self._mine))

    def result(self) -> Laid:
        """What was laid, on the crossovers of the network."""
        return _on_network(self.network, self.first, self.seed, self.net, self._mine)


def _reaches(network: Network, first: np.ndarray) -> dict[tuple[int, int], np.ndarray]:
    """How far along the warp crossovers go in rows at or beyond each, by quadrant; -1: none.

    The cloth's outline tells it, which every rank knows; of joints before a crossover none is left
    out then.
    """
    yarns, found = network.warp_yarns, {}
    has = yarns.last >= yarns.first
    for sign in (1, -1):
        far = yarns.last[has] - first[0] if sign > 0 else first[0] - yarns.first[has]
        for side in (1, -1):
            row = side * (yarns.line[has] - first[1])
            good = (row >= 0) & (far >= 0)
            reach = np.full(int(row[good].max(initial=-1)) + 1, -1)
            np.maximum.at(reach, row[good], far[good])
            found[sign, side] = np.maximum.accumulate(reach[::-1])[::-1]
    return found


def _counts(reach: dict[tuple[int, int], np.ndarray]) -> list[int]:
    """Joints that generators need along warp and weft, and back."""
    along = {s: max(2 * int(reach[s, t].max(initial=-1)) + 1 for t in (1, -1)) for s in (1, -1)}
    across = {t: max(2 * len(reach[s, t]) - 1 for s in (1, -1)) for t in (1, -1)}
    return [max(n, 0) for n in (along[1], across[1], along[-1], across[-1])]


def _wanted(reach, begin: np.ndarray, shape: np.ndarray) -> np.ndarray:
    """Joints of a block that are crossovers or arm ends, or before one; bool (n0, n1)."""
    i, j = (np.arange(n) + b for n, b in zip(shape, begin, strict=True))
    wanted = np.zeros(tuple(shape), bool)
    for (sign, side), rows in reach.items():
        if not len(rows):
            continue
        row = abs(j) // 2
        far = np.where(
            (side * j >= 0) & (row < len(rows)), rows[np.minimum(row, len(rows) - 1)], -1
        )
        wanted |= (sign * i[:, None] >= 0) & (abs(i[:, None]) <= 2 * far + 1) & (far >= 0)
    return wanted


def _ghosts(network: Network, first, begin, shape, wanted) -> tuple[np.ndarray, Halo]:
    """Wanted joints of a block that are other ranks', as flat indices, and who sends them."""
    comm = network.comm
    rim = np.ones(tuple(shape), bool)
    rim[1:-1, 1:-1] = False
    joints = np.argwhere(rim & wanted)
    owner = network.partition.owner((joints + begin + 2 * first) // 2)
    away = owner != comm.rank
    joints, owner = joints[away], owner[away]

    def find(absolute: np.ndarray) -> np.ndarray:
        i, j = (absolute - 2 * first - begin).T
        return i * shape[1] + j

    halo = Halo(comm, 0, owner, joints + begin + 2 * first, find)
    return joints[:, 0] * shape[1] + joints[:, 1], halo


def _on_network(network: Network, first, seed: Seed, net: Fishnet, mine: np.ndarray) -> Laid:
    """What was laid, on the crossovers of the network. Collective."""
    comm, tool = network.comm, seed.tool
    joint = 2 * (network.crossover_ij.astype(np.int64) - first)
    hinge, length_of = net.at(joint), network.arm_length
    here, laid = net.x[hinge], net.status[hinge] == LAID
    normal, ends = np.zeros_like(here), np.full((len(here), 4, 3), np.nan)
    normal[laid] = unit(tool.surface.look(here[laid])[1])
    for arm, step in enumerate(ARM_STEP):
        there = net.at(joint + step)
        end, reached = net.x[there], net.status[there] == LAID
        has = length_of[:, arm] > 0.0
        rows = np.flatnonzero(laid & reached & has & ~network.arm_is_shared[:, arm])
        # A free end goes on straight.
        ahead = end[rows] - here[rows]
        ahead = unit(ahead - (ahead * normal[rows]).sum(axis=1)[:, None] * normal[rows])
        far = length_of[rows, arm][:, None]
        end[rows], reached[rows] = on_circles(
            tool.surface, seed.gap, here[rows], far * ahead, far * normal[rows]
        )
        laid = laid & (reached | ~has)
        ends[reached & has, arm] = tool.start.to_lab(end[reached & has])
    place = tool.start.to_lab(seed.on_tool())
    beyond = comm.allreduce(int(_ended(tool, here[laid], seed.gap).sum()))
    joints = comm.allreduce(int(((net.status == LAID) & mine).sum()))
    limit = _limit(network, first, net, mine, comm.allreduce(int((~laid).sum())), tool)
    at = (place_of(network, first), place)
    return Laid(tool.start.to_lab(here), ends, laid, at, joints, beyond, limit)


def _ended(tool: Tool, points: np.ndarray, gap: float) -> np.ndarray:
    """Which points (n, 3), in the tool's frame, lie beyond what the tool has; bool (n,)."""
    surface = tool.surface
    low, high = surface.box
    room = np.full(3, 1.1 * gap + 1e-6)
    if surface.skin_axis >= 0:
        room[np.arange(3) != surface.skin_axis] = 0.5 * gap
    out = (points < low - room) | (points > high + room)
    return (out & ~np.array(surface.endless)).any(axis=1)


def _limit(network, first, net: Fishnet, mine, lost: int, tool: Tool) -> str:
    """Where the net comes to its limit first, seen from the seed. Collective."""
    if not lost:
        return ""
    comm, stuck = network.comm, np.argwhere(mine & (net.status != LAID) & (net.status != WAITS))
    away = abs(stuck + net.first).sum(axis=1)
    nearest = least(comm, away, FAR)
    told = None
    if len(stuck) and away.min() == nearest:
        i, j = stuck[int(away.argmin())] + net.first
        # The joint before it, towards the seed, along both yarns.
        before = net.x[net.at(np.array([[i - np.sign(i), j - np.sign(j)]]))][0]
        why = net.status[net.at(np.array([[i, j]]))][0]
        told = ((int(i), int(j)), int(why), before)
    every = [one for one in comm.allgather(told) if one is not None]
    total = network.num_crossovers_global
    head = f'{total - lost} of {total} crossovers are laid on tool "{tool.name}": '
    if not every:
        return f"{head}the rest lies beyond them"
    (i, j), why, before = min(every, key=lambda one: one[0])
    x, y = map(length, place_of(network, first + 0.5 * np.array([i, j])))
    where = f"at x = {x}, y = {y} of the flat blank"
    if not np.isnan(before).any():
        where += ", near " + ", ".join(map(length, tool.start.to_lab(before))) + " in space"
    if why == LOCKS:
        angle = np.rad2deg(np.arcsin(net.most))
        return f"{head}the net locks {where}, where it would shear by more than {angle:.3g} deg"
    return f"{head}yarns find no place on the tool {where}"
