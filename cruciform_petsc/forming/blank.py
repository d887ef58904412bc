# SPDX-License-Identifier: MIT
"""A blank among tools: the cloth's nodes and the tools' as one model."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import cast

import numpy as np
import shapely

from ..cloth.fabric import Fabric
from ..elements.level import FORCE
from ..equilibrium.cloth import holder
from ..equilibrium.model import Model
from ..equilibrium.state import Hold, State
from ..items.clamps import Clamp
from ..items.contact import Contact
from ..items.item import Item
from ..items.loads import DeadLoads, gravity, imperfection
from ..items.part import OfPart, part_of
from ..items.ply import Ply
from ..items.trimmed import Trimmed
from ..items.truss import TrussPly
from ..items.viscous import Viscous
from ..net.edges import Constraints
from ..net.joined import JoinedNodes, ToolNodes
from ..net.network import Network
from ..parallel import most
from ..tools.tool import Tool
from .lay import Laid

SUMS = ("spent", "slid")  # of what items remember: what only grows
REST = 0.1  # of a stage: how soon cloth comes to rest
AT_HINGE = 1 / 3  # a quadrant's corners, its hinge and two arm ends, share its area alike

# Of elements' nodes those that tell whether they are cut off: hinges, points of a bend; the first.
_POINTS = {
    "cruciforms": slice(4, 5), "truss": slice(4, 5), "bends": slice(0, 3), "twist": slice(0, 2),
}  # fmt: skip


@dataclass(frozen=True)
class ContactSettings:
    """How cloth touches tools, see items.contact and items.viscous.

    Attributes
    ----------
    stiffness : float
        k, N/m^3.
    width : float
        w, m.
    slip : float
        Elastic slip s_0, m.
    viscosity : float
        c, N s/m^3.
    """

    stiffness: float
    width: float
    slip: float
    viscosity: float

    @classmethod
    def of(cls, fabric: Fabric, length: float, load: float = 0.0) -> ContactSettings:
        """What suits a fabric, a blank of it of some length [m], and a load per area [Pa] on it.

        A pressure that strains its yarns by 1 % over a radius of ten thicknesses compacts it by
        half its thickness on either side; friction slips elastically by a hundredth of it.

        Viscosity is to choose a way, not to hold cloth up: a strip as long as the blank, held at
        one end and bent, comes to rest as exp(-t/T), T = c (length/1.875)^4 / B (a cantilever's
        first mode, which flows as B d^4w/dx^4 = -c dw/dt). T is a tenth of a stage. c length^2
        is 1e-8 s of the yarns' stiffness besides: a sheet that nothing holds must not float away.
        Nor may a load throw cloth about: alone it would move it by that length in that time.
        """
        thickness = fabric.needed("thickness", "contact")
        modulus = 0.5 * (fabric.c11 + fabric.c22)
        bending = 0.5 * sum(law.stiffness0 for law in fabric.out_of_plane("forming"))
        viscosity = REST * bending * (1.875 / length) ** 4 + 1e-8 * modulus / length**2
        viscosity += REST * load / length
        return cls(2e-3 * modulus / thickness**2, 0.2 * thickness, 0.01 * thickness, viscosity)


class Blank:
    """A network in space, rigid tools and all that acts between them. Collective.

    The blank lies flat, its middle at z = half its thickness: on a die whose flat is z = 0.

    Parameters
    ----------
    network : Network
    tools : sequence of Tool
        Where they start.
    weight : bool
        Whether gravity acts.
    settings : ContactSettings, optional
    waves : (float, int), optional
        Height [m] and seed of an imperfection.
    bending : bool
        Whether yarns bend in the plane, too.
    symmetry : sequence of str
        Edges that lie in planes of symmetry.
    further : sequence of callables
        Ply -> Item: what else acts on the cloth.
    factors : mapping, optional
        Sizes of loads and contacts before the first stage, by name of their items: else 1.
    cuts : mapping, optional
        What stays of the flat blank, by the name of the factor that goes to 0 when it is trimmed.
    laid : Laid, optional
        Where it begins, on a tool; by default it is flat.
    prestretch : pair of float
        See PlyNodes.

    Attributes
    ----------
    nodes : JoinedNodes
        The cloth's, then the tools'.
    tool_node : int32 (number of tools,)
        Their local nodes.
    contacts : list of Contact
        By tool.
    loads : list of Item
        What acts on the cloth besides tools, clamps too.
    clamps : list of Clamp
    model : Model
    is_laid : bool
        Whether it begins laid on a tool.
    """

    _ply: type[Ply] = Ply

    def __init__(
        self,
        network: Network,
        tools: Sequence[Tool],
        *,
        weight: bool = False,
        settings: ContactSettings | None = None,
        waves: tuple[float, int] | None = None,
        bending: bool = True,
        symmetry: Sequence[str] = (),
        further: Sequence = (),
        factors: Mapping[str, float] | None = None,
        cuts: Mapping[str, shapely.Polygon] | None = None,
        laid: Laid | None = None,
        prestretch: tuple[float, float] = (1.0, 1.0),
    ):
        fabric = network.fabric
        self.network, self.tools, self.comm = network, list(tools), network.comm
        self.thickness = fabric.needed("thickness", "contact with a tool")
        self.symmetry = frozenset(symmetry)
        self.settings = settings = settings or ContactSettings.of(
            fabric, length_of(network, self.symmetry)
        )
        self.factors = factors or {}
        self.prestretch = prestretch
        self.ply = ply = self._lay(bending)
        ply.nodes.rest[:, 2] = 0.5 * self.thickness
        if weight:
            ply.further.append(gravity(ply, "gravity", stretched=float(np.prod(prestretch))))
        ply.cuts = cuts = cuts or {}
        if waves is not None:
            ply.further.append(imperfection(ply, *waves))
        ply.further += [make(ply) for make in further]
        self.cloth_hold = holder(ply)([])  # where edges hold the cloth, at rest
        place = np.array([tool.start.place for tool in tools]).reshape(-1, 3)
        tool_nodes = ToolNodes(self.comm, place)
        self.nodes = JoinedNodes([ply.nodes, tool_nodes])
        self.cloth_at, self.tool_node = self.nodes.maps
        touching = np.flatnonzero(ply.active[: ply.nodes.num_nodes_owned])
        area, at = ply.areas(AT_HINGE)[touching], self.cloth_at[touching]
        self.area, self.touching = area, touching
        s, offset = settings, 0.5 * self.thickness
        self.contacts = [
            Contact(
                tool.name, tool.surface, at, node, area,
                offset, s.stiffness, s.width, tool.friction, s.slip,
            )
            for tool, node in zip(tools, self.tool_node, strict=True)
        ]  # fmt: skip
        # A tool that a force drives moves as if a whole blank's viscosity held it.
        mine = self.tool_node[: tool_nodes.num_nodes_owned]
        whole = np.full(len(mine), self.comm.allreduce(float(area.sum())))
        moving = np.concatenate([at, mine])
        rest, owned = self.nodes.rest, self.nodes.num_nodes_owned
        viscous = Viscous(moving, rest[moving], s.viscosity * np.concatenate([area, whole]))
        pushes = []
        for tool, node in zip(tools, self.tool_node, strict=True):
            for axis in range(3):
                force = np.zeros_like(rest)
                force[node, axis] = 1.0
                pushes.append(DeadLoads(force, rest, owned, push_name(tool.name, axis)))
        self.clamps = [item for item in ply.items if isinstance(item, Clamp)]

        def trimmed(item: Item) -> Item:
            points = _POINTS.get(item.name, slice(0, 1))
            return cast(Item, Trimmed(item, ply.nodes.rest[:, :2], cuts, points)) if cuts else item

        parts = [OfPart(trimmed(item), self.cloth_at) for item in ply.items]
        self.loads = [part for part in parts if part.is_load and part.name != ply.loads.name]
        items: list[Item] = [*parts, *self.contacts, viscous, *pushes]
        active = self.nodes.join([ply.active, np.ones(len(tools), bool)])
        self.model = Model(self.nodes, items, active, fabric.c11 + fabric.c22)
        self.is_laid, self._begin = laid is not None, self.nodes.rest.copy()
        if laid is not None:
            self._begin[self.cloth_at] = laid.on_nodes(network, ply.nodes)

    def _lay(self, bending: bool) -> Ply:
        """The cloth."""
        constraints = Constraints(self.network, bending, floats=True)
        for edge in sorted(self.symmetry):
            constraints.symmetry(edge)
        out = self.network.fabric.out_of_plane("forming")
        return self._ply(constraints, out, flat=False, prestretch=self.prestretch)

    @property
    def pitch(self) -> float:
        """Mean distance of nodes along a yarn, m, by which Newton's steps are limited."""
        return float(self.network.pitch.mean())

    def hold(
        self,
        place: np.ndarray,
        free: np.ndarray,
        rotations: Mapping[str, np.ndarray],
    ) -> Hold:
        """Tools held at places (n, 3), but for axes that are free (n, 3), and turned."""
        cloth = self.cloth_hold
        nodes = np.concatenate([self.cloth_at[cloth.nodes], self.tool_node])
        fixed = np.concatenate([cloth.fixed, ~free])
        place = np.concatenate([cloth.place, place])
        return Hold(nodes, self.nodes.frame[nodes], fixed, place, cloth.turn, rotations)

    def start(self) -> State:
        """At rest, or laid on a tool, the tools where they start."""
        place = self.nodes.rest[self.tool_node]
        rotations = {tool.name: tool.start.turn for tool in self.tools}
        hold = self.hold(place, np.zeros(place.shape, bool), rotations)
        state = State(self._begin, hold, factors=self.factors)
        # What laying it has taken is none of what is told.
        memory = {
            item: {n: np.zeros_like(v) if n in SUMS else v for n, v in kept.items()}
            for item, kept in self.model.accepted(state).items()
        }
        return replace(state, memory=memory)

    def placed_anew(self, state: State, moved: np.ndarray) -> State:
        """A state whose nodes ``moved``, bool (n_local,), remember but what they have spent.

        Rows of what items remember are by their keepers.
        """
        fresh, memory = self.model.accepted(replace(state, memory={})), {}
        for item in self.model.items:
            kept = dict(state.memory.get(item.name, {}))
            for name, new in fresh.get(item.name, {}).items():
                if name not in SUMS and name in kept:
                    rows = moved[item.keepers].reshape(-1, *[1] * (new.ndim - 1))
                    kept[name] = np.where(rows, new, kept[name])
            memory[item.name] = kept
        return replace(state, memory=memory)

    def area_of_nodes(self) -> np.ndarray:
        """Area that each node stands for, (n_local,), m^2; none of tools."""
        area = np.zeros(self.nodes.num_nodes_local)
        area[self.cloth_at[self.touching]] = self.area
        return area

    def of_cloth(self, state: State) -> State:
        """The state as the ply sees it."""
        return cast(State, part_of(state, self.cloth_at))

    def tool_moments(self, state: State) -> dict[str, np.ndarray]:
        """Moments on the cloth by tools about their origins, (3,), N m. Collective."""
        ours = np.array([contact.moment(state) for contact in self.contacts]).reshape(-1, 3)
        everywhere = self.comm.allreduce(ours)
        return dict(zip((contact.name for contact in self.contacts), everywhere, strict=True))

    def pulls(self, state: State) -> dict[str, np.ndarray]:
        """Forces on the cloth of each load, by its name, N: (n_local, 3), not complete on nodes.

        What the elements of this rank add; the sum over all ranks is all.
        """
        found = {}
        for item in self.loads:
            found[item.name] = pull = np.zeros_like(state.x)
            for rows in item.chunks():
                force = item.work(state, FORCE, rows)[1]
                np.subtract.at(pull, item.nodes[rows], force)
        return found

    def spent(self, state: State) -> dict[str, float]:
        """What friction and viscosity have dissipated up to an accepted state, J. Collective.

        On tools, by the blank's own viscosity, and in its shear if that remembers.
        """
        rubbed = sum(state.memory[item.name]["spent"].sum() for item in self.contacts)
        flowed = state.memory["viscosity"]["spent"].sum()
        total = self.comm.allreduce(np.array([rubbed, flowed]))
        spent = {"friction": float(total[0]), "viscous": float(total[1])}
        return spent | self.ply.dissipated(self.of_cloth(state))

    def slipped(self, state: State) -> tuple[dict[str, float], dict[str, float]]:
        """How far yarn ends have slipped in clamps at most [m], and what that took [J], by edge.

        Collective.
        """
        memory = {item.edge: state.memory[item.name] for item in self.clamps}
        far = {edge: most(self.comm, kept["slipped"], 0.0) for edge, kept in memory.items()}
        spent = {e: self.comm.allreduce(float(k["spent"].sum())) for e, k in memory.items()}
        return far, spent


class TrussBlank(Blank):
    """A blank whose cloth is a truss, see items.truss. Collective."""

    _ply = TrussPly


def push_name(tool: str, axis: int) -> str:
    """Name of the load that pushes a tool along x, y or z."""
    return f"force on {tool} along {'xyz'[axis]}"


def length_of(network: Network, symmetry: Collection[str] = ()) -> float:
    """The longer side of the whole blank's bounding box, m."""
    doubled = [1 + ("left" in symmetry or "right" in symmetry)]
    doubled += [1 + ("lower" in symmetry or "upper" in symmetry)]
    return float((network.preform.size * doubled).max())
