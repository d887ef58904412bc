# SPDX-License-Identifier: MIT
"""One ply of cloth: a constrained network's items, and what is read off its states."""

from __future__ import annotations

from collections.abc import Mapping
from copy import copy
from dataclasses import replace

import numpy as np
import shapely

from ..elements.level import ENERGY
from ..laws import Potential
from ..net.edges import Constraints
from ..net.supports import pass_on_loads
from ..parallel import most
from .bends import Bends
from .cruciforms import Cruciforms
from .item import Item, Placed
from .loads import DeadLoads
from .nodes import PlyNodes, Slip
from .slip import Slides, SlidingCruciforms
from .trimmed import kept
from .twist import Twist

MODES = ("tension", "shear", "bending")  # of the energy of a cloth in its plane


class Ply(PlyNodes):
    """A constrained network with its items, see PlyNodes. Collective.

    Attributes
    ----------
    cruciforms, bends, loads : items
    slides : Slides or None
        Friction of yarns that slide through crossovers.
    further : list of Item
        More that acts on this ply: an imperfection, gravity, a pressure.
    cuts : mapping
        What is cut off at some time, see items.trimmed: such crossovers carry nothing then.
    """

    def __init__(
        self,
        constraints: Constraints,
        out_of_plane: tuple[float | Potential, float | Potential] | None = None,
        flat: bool = True,
        prestretch: tuple[float, float] = (1.0, 1.0),
        slip: Slip | None = None,
        near: np.ndarray | None = None,
    ):
        super().__init__(constraints, out_of_plane, flat, prestretch, slip, near)
        self.cruciforms = Cruciforms(self) if slip is None else SlidingCruciforms(self)
        self.slides = None
        if isinstance(self.cruciforms, SlidingCruciforms):
            self.slides = Slides(self, self.cruciforms)
        self.bends = Bends(self)
        force = np.zeros_like(self.nodes.rest)
        force[self.nodes.of_network_node, :2] = self.network.to_lab(
            pass_on_loads(constraints, self.supports)
        )
        force[~self.active] = 0.0
        self.loads = DeadLoads(force, self.nodes.rest, self.nodes.num_nodes_owned)
        share = self.network.fabric.out_of_plane_twisting
        self.further: list[Item] = [Twist(self, share)] if share and self.dim == 3 else []
        self.cuts: Mapping[str, shapely.Polygon] = {}

    def with_shear_law(self, law: Potential) -> Ply:
        """The same ply of cloth with another shear law; all else is shared."""
        ply = copy(self)
        ply.cruciforms = copy(self.cruciforms)
        ply.cruciforms.cloth = replace(self.cruciforms.cloth, shear=law.packed)
        return ply

    @property
    def items(self) -> list[Item]:
        """What adds to equilibrium."""
        items: list[Item] = [self.cruciforms]
        if isinstance(self.cruciforms, SlidingCruciforms) and self.slides is not None:
            items += [self.cruciforms.sliding, self.slides]
        return [*items, self.bends, self.loads, *self.further]

    def shear_angle_max(self, state: Placed) -> float:
        """Largest shear angle of a crossover, radians. Collective."""
        angles = abs(self.cruciforms.shear_angles(self.cruciforms.arms(state)[1]))
        return most(self.comm, angles[self.carrying(state)[self.cruciforms.rows]], 0.0)

    def dissipated(self, state: Placed) -> dict[str, float]:
        """What shear and yarns that slide have dissipated up to an accepted state, J.

        By its name, "in_shear", "in_slip"; of an elastic cloth none. Collective.
        """
        items: dict[str, Item] = {}
        if self.network.fabric.remembers:
            items["in_shear"] = self.cruciforms
        if self.slides is not None:
            items["in_slip"] = self.slides
        spent = {how: state.memory.get(item.name, {}).get("spent") for how, item in items.items()}
        return {
            how: self.comm.allreduce(0.0 if of_items is None else float(of_items.sum()))
            for how, of_items in spent.items()
        }

    def carrying(self, state: Placed) -> np.ndarray:
        """Which of this rank's crossovers carry load, bool (n_owned,)."""
        stays = kept(self.network.crossover_position, self.cuts, state.factors)
        return self.supports.carrying & stays

    def fields(self, state: Placed) -> dict[str, np.ndarray]:
        """Fields at this rank's crossovers; the same as LinearNetwork.crossover_fields. Collective.

        Strains are engineering strains of the arms, rotations those of the arms in x, y from rest,
        tensions first Piola-Kirchhoff, N per metre of cloth at rest.
        """
        fabric, c, nodes = self.network.fabric, self.cruciforms, self.nodes
        n = self.network.num_crossovers_owned
        stretch, t = c.arms(state)
        t0 = self.arm_directions
        rotation = np.arctan2(
            t0[:, 0] * t[..., 1] - t0[:, 1] * t[..., 0], np.einsum("mki,ki->mk", t, t0)
        )
        warp, weft = c.mean(stretch - 1.0, 0), c.mean(stretch - 1.0, 1)
        tension = fabric.tension(1.0 + np.stack([warp, weft], axis=-1))[1]
        energy = np.concatenate([c.work(state, ENERGY, rows)[0] for rows in c.chunks()])
        if isinstance(c, SlidingCruciforms):
            energy[:, 0] = c.tension_energy(state)
        bent = np.zeros((nodes.num_nodes_local, len(self.bends.modes)))
        for rows in self.bends.chunks():
            values = self.bends.work(state, ENERGY, rows)[0]
            for of in self.bends.crossover[rows].T:
                # The second crossover of a joint may be another rank's: its hinge is a ghost here.
                hinge = np.where(of >= 0, nodes.of_hinge[of], self.bends.nodes[rows, 2])
                np.add.at(bent, hinge, 0.5 * values)
        bent = nodes.halo.reverse(bent)[nodes.of_hinge]

        def spread(values: np.ndarray) -> np.ndarray:
            wide = np.zeros((n, *values.shape[1:]))
            wide[c.rows] = values
            return wide

        fields = {
            "displacement": self.displacement(state)[0],
            "arm_strain": spread(stretch - 1.0),
            "arm_rotation": spread(rotation),
            "warp_strain": spread(warp),
            "weft_strain": spread(weft),
            "warp_tension": spread(tension[:, 0]),
            "weft_tension": spread(tension[:, 1]),
            "shear_angle": spread(c.shear_angles(t)),
            "tension_energy": spread(energy[:, 0]),
            "shear_energy": spread(energy[:, 1]),
            **{f"{mode}_energy": bent[:, i] for i, mode in enumerate(self.bends.modes)},
            "carrying": self.carrying(state),
        }
        if self.slides is not None:
            for name, values in self.slides.fields(state).items():
                fields[name] = np.zeros((n, *values.shape[1:]), values.dtype)
                fields[name][self.slides.rows] = values
        return fields
