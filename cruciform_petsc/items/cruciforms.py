# SPDX-License-Identifier: MIT
"""Cruciforms of a network as an item: tension and shear of crossovers that carry load.

What resists shear beside its law has a memory (`State.memory`, see Cruciforms.accepted).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from ..elements import cruciform
from ..elements.cruciform import Cloth
from ..laws import linear, shear_resistances
from ..net.lattice import HELD, OPPOSITE, QUADRANTS
from .item import Item, Placed, Work
from .nodes import PlyNodes, unit

LARGEST_STRETCH = 2.0  # laws of tension do not end, yarns do
PARALLEL = np.deg2rad(1.0)  # in space: yarns this close to each other lie along each other
SIGN = np.array([1.0, -1.0, 1.0, -1.0])  # of the shear angle, order of QUADRANTS


@dataclass(frozen=True)
class Course:
    """How a test runs in time and temperature; by default in no time.

    Attributes
    ----------
    seconds : callable
        Two of the times that drive stages -> seconds between them.
    temperature : callable
        Such a time -> temperature, K; None: that of the fabric's measurements.
    """

    seconds: Callable[[float, float], float] = lambda before, now: 0.0
    temperature: Callable[[float], float | None] = lambda now: None


class Cruciforms(Item):
    """Crossovers of a rank that carry load, each with its four arms.

    Attributes
    ----------
    rows : int (m,)
        Their numbers among this rank's crossovers.
    arm_length : float (m, 4), m
    area : float (m, 4), m^2, of the quadrants; both without any tension
    strain_source, turn_source : int (m, 4)
        See elements.cruciform.cruciforms.
    course : Course
    """

    name = "cruciforms"
    modes = ("tension", "shear")

    def __init__(self, ply: PlyNodes):
        network, supports = ply.network, ply.supports
        self.network, self.cloth = network, cloth(network.fabric)
        self.directions = ply.arm_directions
        self.rows = rows = np.flatnonzero(supports.carrying)
        boundary = network.boundary_crossovers
        strain = np.tile(np.arange(4), (network.num_crossovers_owned, 1))
        turn, area = strain.copy(), network.quadrant_area.copy()
        share = np.full(strain.shape, 0.5)
        strain[boundary] = supports.strain_source
        turn[boundary] = supports.rotation_source
        area[boundary] = supports.quadrant_area
        share[boundary] = supports.hinge_share
        self.strain_source, self.turn_source = strain[rows], turn[rows]
        # Cloth that is drawn stretched is smaller at rest.
        stretch = np.tile(ply.prestretch, 2)
        self.area = area[rows] / np.prod(ply.prestretch)
        self.arm_length = network.arm_length[rows] / stretch
        self._along = share[rows] * [1.0, 1.0, -1.0, -1.0]  # arms, as their yarns run
        ends = ply.nodes.of_network_node[network.arm_node[rows]]
        self.nodes = np.column_stack([ends, ply.nodes.of_hinge[rows]]).astype(np.int32)
        # Elements with a held arm, and by which clamped node's motion each arm would turn: a tail
        # that follows a held arm takes its direction from that arm's clamp.
        self._held_rows = np.flatnonzero((self.turn_source == HELD).any(axis=1))
        crossing = network.arm_node[rows[self._held_rows]]
        missing = self.arm_length[self._held_rows] == 0
        self._clamp = ply.clamp_of[np.where(missing, crossing, crossing[:, OPPOSITE])]
        mirrored = ply.constraints.mirrored_arm[network.arm_node[rows], np.arange(4)]
        self._mirrored = at, arm = np.nonzero(mirrored & (self.arm_length == 0))
        for k, sign in ((arm, 1.0), (OPPOSITE[arm], -1.0)):  # both count at the hinge
            self._along[at, k] = np.where(arm < 2, 0.5 * sign, -0.5 * sign)
        self._at_rest = np.zeros((0, 4, ply.dim))
        self.course = Course()

    def held(self, state: Placed, rows: slice) -> np.ndarray:
        """Directions in which clamps hold the arms of elements, (m, 4, dim); else as at rest."""
        begin, stop, _ = rows.indices(len(self.rows))
        if stop - begin > len(self._at_rest):
            self._at_rest = np.tile(self.directions, (stop - begin, 1, 1))
        first, last = np.searchsorted(self._held_rows, (begin, stop))
        if first == last:
            return self._at_rest[: stop - begin]
        held = self._at_rest[: stop - begin].copy()
        turn = turns(state)[self._clamp[first:last]]
        held[self._held_rows[first:last] - begin] = unit(
            np.einsum("mkij,kj->mki", turn, self.directions)
        )
        return held

    def work(self, state: Placed, level: int, rows=slice(None), before=None) -> Work:
        """See Item.work."""
        nodes = self.nodes[rows]
        return cruciform.cruciforms(
            state.x[nodes],
            self.arm_length[rows],
            self.area[rows],
            self.cloth,
            level,
            self.strain_source[rows],
            self.turn_source[rows],
            self.held(state, rows),
            None if before is None else before[nodes],
            *self._resistance(state, rows),
        )

    # -- memory -----------------------------------------------------------------------------------

    @property
    def keepers(self) -> np.ndarray:
        """See Item.keepers: hinges; arm ends are shared."""
        return self.nodes[:, 4]

    def _memory(self, state: Placed) -> dict[str, np.ndarray]:
        """What is remembered at a state; before the first accepted one, of cloth at rest."""
        if memory := state.memory.get(self.name):
            return dict(memory)
        size, none = len(self.rows), np.zeros((len(self.rows), 4))
        return {"angle": none, "anchor": none, "time": np.zeros(size), "spent": np.zeros(size)}

    def _resistance(
        self, state: Placed, rows: slice = slice(None)
    ) -> tuple[np.ndarray | None, np.ndarray | None]:
        """Past (m, 4, 2) and numbers (5,) as the kernels take them; None for an elastic cloth."""
        fabric = self.network.fabric
        if not fabric.remembers:
            return None, None
        memory, numbers = self._memory(state), np.array([0.0, 1.0, 0.0, 0.0, 1.0])
        if fabric.shear_viscosity is not None and len(self.rows):
            flow = fabric.shear_viscosity
            numbers[0] = flow.at(self.course.temperature(state.time))
            numbers[1] = flow.exponent
            numbers[2] = self.course.seconds(float(memory["time"][0]), state.time)
        if fabric.shear_friction is not None:
            numbers[3:] = fabric.shear_friction.torque, fabric.shear_friction.slip
        return np.stack([memory["angle"][rows], memory["anchor"][rows]], axis=2), numbers

    def accepted(self, state: Placed) -> dict[str, np.ndarray]:
        """See Item.accepted: shear angles of the quadrants and what friction's are anchored at.

        Anchors follow what has slid (return mapping); ``spent``: what each cruciform's shear has
        dissipated, J.
        """
        past, numbers = self._resistance(state)
        if past is None or numbers is None:
            return {}
        memory, angle = self._memory(state), self.quadrant_angles(self.arms(state)[1])
        flow = numbers * [1.0, 1.0, 1.0, 0.0, 1.0]
        spent = shear_resistances(angle, past[..., 0], past[..., 1], flow)[1]
        spent = spent * (angle - past[..., 0])
        torque, slip = numbers[3:]
        anchor = np.clip(past[..., 1], angle - slip, angle + slip)
        spent = spent + torque * abs(anchor - past[..., 1])
        # No quadrant that is not there: angles of missing arms mean nothing.
        total = np.einsum("mq,mq->m", self.area, np.where(self.area > 0.0, spent, 0.0))
        return {
            "angle": angle,
            "anchor": anchor,
            "time": np.full(len(self.rows), state.time),
            "spent": memory["spent"] + total,
        }

    # -- what a state of cloth cannot be --------------------------------------------------------

    def broken(self, state: Placed) -> tuple[np.ndarray, str, str] | None:
        """See Item.broken: warp and weft that pass each other, yarns stretched beyond all bounds.

        Beyond 90 degrees of shear the kernels' angle would come back, which no cloth does.
        """
        turn = self._crossing(state.x)
        value, place = self._lowest(turn)
        if value <= 0.0:
            what = "the cloth folds onto itself: warp and weft pass each other"
            return place, "FOLDED", what
        arms = np.linalg.norm(state.x[self.nodes[:, :4]] - state.x[self.nodes[:, 4:]], axis=2)
        length = np.maximum(self.lengths(state), 1e-300)
        stretch = np.where(self.arm_length > 0, arms / length, 0.0)
        value, place = self._lowest(-stretch.max(axis=1, initial=0.0))
        if value < -LARGEST_STRETCH:
            what = "a yarn is stretched to more than twice its length, which none stands"
            return place, "TORN", what
        return None

    def _lowest(self, values: np.ndarray) -> tuple[float, np.ndarray]:
        """Smallest value (m,) over all ranks, and where at rest; of several the lowest place."""
        at = int(values.argmin()) if len(values) else -1
        place = self.network.crossover_position[self.rows[at]].tolist() if at >= 0 else [0.0, 0.0]
        found = self.network.comm.allgather((float(values[at]) if at >= 0 else np.inf, place))
        value, place = min(found)
        return value, np.array(place)

    def _crossing(self, x: np.ndarray) -> np.ndarray:
        """How warp and weft cross, from one arm end to the other; not positive where they pass.

        In the plane the product warp x weft; in space, where that has no sign, the angle between
        the yarns less PARALLEL.
        """
        hinge = x[self.nodes[:, 4]]
        warp, weft = (x[self.nodes[:, f]] - x[self.nodes[:, f + 2]] for f in (0, 1))
        for family, chord in ((0, warp), (1, weft)):  # where one arm is missing, the other counts
            for arm, sign in ((family, 1.0), (family + 2, -1.0)):
                gone = self.arm_length[:, (arm + 2) % 4] == 0
                chord[gone] = sign * (x[self.nodes[gone, arm]] - hinge[gone])
        if x.shape[1] == 2:
            turn = warp[:, 0] * weft[:, 1] - warp[:, 1] * weft[:, 0]
        else:
            sine = np.linalg.norm(np.cross(warp, weft), axis=1)
            turn = np.arctan2(sine, abs((warp * weft).sum(axis=1))) - PARALLEL
        both = (self.arm_length[:, :2] + self.arm_length[:, 2:] > 0).all(axis=1)
        return np.where(both, turn, np.inf)

    # -- fields -----------------------------------------------------------------------------------

    def lengths(self, state: Placed) -> np.ndarray:
        """Lengths of arms at rest, (m, 4), m; 0 for those that there are not."""
        return self.arm_length

    def arms(self, state: Placed) -> tuple[np.ndarray, np.ndarray]:
        """Stretch (m, 4) and direction (m, 4, dim) of arms.

        What has no arm of its own there takes its yarn's other one, or the clamp's.
        """
        place = state.x[self.nodes]
        arms = place[:, :4] - place[:, 4:]
        size = np.linalg.norm(arms, axis=2)
        present = self.arm_length > 0
        stretch = np.where(present, size / np.where(present, self.lengths(state), 1.0), 1.0)
        t = np.where(present[..., None], arms / np.where(present, size, 1.0)[..., None], 0.0)
        at = np.arange(len(self.rows))[:, None]
        source = np.maximum(self.strain_source, 0)
        stretch = np.where(self.strain_source == HELD, 1.0, stretch[at, source])
        source = np.maximum(self.turn_source, 0)
        reverse = np.where(source == np.arange(4), 1.0, -1.0)[..., None]
        held = self.held(state, slice(None))
        t = np.where((self.turn_source == HELD)[..., None], held, reverse * t[at, source])
        # Beyond a plane of symmetry a yarn goes on as its mirror image.
        n = self.directions[self._mirrored[1]]
        t[self._mirrored] = (
            2.0 * (t[self._mirrored] * n).sum(axis=1)[:, None] * n - t[self._mirrored]
        )
        return stretch, t

    def mean(self, arms: np.ndarray, axis: int) -> np.ndarray:
        """Mean over the quadrants of what their warp (axis 0) or weft (1) arms have; (m,)."""
        return np.einsum("mq,mq->m", self._shares(), arms[:, QUADRANTS[:, axis]])

    def _shares(self) -> np.ndarray:
        """Share of each quadrant in its cruciform's area, (m, 4)."""
        return self.area / np.maximum(self.area.sum(axis=1, keepdims=True), 1e-300)

    def quadrant_angles(self, t: np.ndarray) -> np.ndarray:
        """Shear angle of each quadrant (m, 4) from the arms' directions (m, 4, dim), radians.

        The kernels' gamma = s (90 deg - angle between the arms of a quadrant).
        """
        ti, tj = t[:, QUADRANTS[:, 0]], t[:, QUADRANTS[:, 1]]
        cosine = (ti * tj).sum(axis=2)
        sine = np.linalg.norm(tj - cosine[..., None] * ti, axis=2)
        return SIGN * np.arctan2(cosine, sine)

    def shear_angles(self, t: np.ndarray) -> np.ndarray:
        """Shear angle (m,) of the yarns at the hinges from the arms' directions, radians.

        90 degrees less the angle between warp and weft, see Supports.hinge_share.
        """
        along = self._along[..., None] * t
        warp, weft = along[:, 0] + along[:, 2], along[:, 1] + along[:, 3]
        product, square = (warp * weft).sum(axis=1), (warp**2).sum(axis=1)
        across = np.linalg.norm(square[:, None] * weft - product[:, None] * warp, axis=1)
        return np.arctan2(product, across / np.sqrt(np.maximum(square, 1e-300)))


def cloth(fabric) -> Cloth:
    """A Fabric in the kernels' terms."""
    biaxial, none = fabric.biaxial_law, linear(0.0)
    return Cloth(
        (fabric.warp_tension if biaxial is None else none).packed,
        (fabric.weft_tension if biaxial is None else none).packed,
        fabric.shear.packed,
        float(fabric.c12),
        bool(fabric.log_strain),
        float(fabric.compression),
        float(fabric.compression_width),
        np.zeros(0) if biaxial is None else biaxial.packed,
    )


def turns(state: Placed) -> np.ndarray:
    """Gradients of clamped nodes' motions, and at the end (index -1) that of what is at rest."""
    turn = state.hold.turn
    return np.concatenate([turn, np.eye(turn.shape[1])[None]])
