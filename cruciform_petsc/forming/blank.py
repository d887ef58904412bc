# SPDX-License-Identifier: MIT
"""A blank among tools: the cloth's nodes and the tools' as one model."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from copy import copy
from dataclasses import dataclass, replace
from typing import cast

import numpy as np
import shapely

from ..cloth.fabric import Fabric
from ..elements.level import FORCE
from ..equilibrium.cloth import holder, in_space
from ..equilibrium.model import Model
from ..equilibrium.state import Hold, State
from ..items.clamps import Clamp
from ..items.contact import Contact
from ..items.item import Item
from ..items.loads import DeadLoads, gravity, imperfection
from ..items.part import OfPart, part_of
from ..items.plies import Between, Face
from ..items.ply import Ply
from ..items.trimmed import Trimmed
from ..items.truss import TrussPly
from ..items.viscous import Viscous
from ..net.edges import Constraints
from ..net.joined import JoinedNodes, ToolNodes
from ..net.network import Network
from ..net.patches import crossovers_near
from ..parallel import most
from ..tools.tool import Tool
from .lay import Laid

SUMS = ("spent", "slid")  # of what items remember: what only grows
REST = 0.1  # of a stage: how soon cloth comes to rest
AT_HINGE = 1 / 3  # a quadrant's corners, its hinge and two arm ends, share its area alike
SLIDE = 0.15  # of a blank's length: how far plies may slide over each other, on several ranks

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

    @classmethod
    def of_all(cls, cloths: Sequence[tuple[Fabric, float]], load: float = 0.0) -> ContactSettings:
        """What suits several plies, (fabric, length) each: none is compacted or slips by more."""
        each = [cls.of(fabric, length, load) for fabric, length in cloths]
        return cls(
            max(s.stiffness for s in each), min(s.width for s in each),
            min(s.slip for s in each), max(s.viscosity for s in each),
        )  # fmt: skip


class Blank:
    """Cloth in space, one ply or several upon each other, rigid tools, all that acts between them.

    Collective. It lies flat, its lower face at z = 0: on a die whose flat is there. Results are
    read off one ply after the other: see `each`.

    Parameters
    ----------
    network : Network or sequence of Network
        Of several plies from the lowest on.
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
        Ply -> Item: what else acts on each ply of the cloth.
    factors : mapping, optional
        Sizes of loads and contacts before the first stage, by name of their items: else 1.
    cuts : mapping, optional
        What stays of the flat blank, by the name of the factor that goes to 0 when it is trimmed.
    laid : Laid, optional
        Where it begins, on a tool; by default it is flat.
    prestretch : pair of float
        See PlyNodes.
    names : sequence of str, optional
        Of several plies.
    rub : sequence of float, optional
        Coefficient of friction of each ply with those below it; none by default.

    Attributes
    ----------
    each : list of Blank
        The blank as each of its plies: all that follows is of this ply, but for nodes, tool_node,
        loads, clamps, between and model. Of a single ply the blank itself; of several the blank
        itself is as the lowest.
    name : str
        Of the ply; "" for a single one.
    height : float
        z of its middle at rest, m.
    nodes : JoinedNodes
        The plies', then the tools'.
    cloth_at : int32 (n_local of the ply,)
        The model's local nodes of its local nodes.
    tool_node : int32 (number of tools,)
        Their local nodes.
    contacts : list of Contact
        By tool.
    between : list of Between
        What acts between plies.
    loads : list of Item
        What acts on the cloth besides tools, clamps too.
    clamps : list of Clamp
    model : Model
    is_laid : bool
        Whether it begins laid on a tool.
    """

    _ply: type[Ply] = Ply
    network: Network
    ply: Ply
    cloth_holds: list[Hold]
    name: str
    height: float
    thickness: float
    cloth_at: np.ndarray
    touching: np.ndarray
    area: np.ndarray
    contacts: list[Contact]
    _near: np.ndarray | None = None

    def __init__(
        self,
        network: Network | Sequence[Network],
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
        names: Sequence[str] = (),
        rub: Sequence[float] = (),
    ):
        networks = [network] if isinstance(network, Network) else list(network)
        several = len(networks) > 1
        names = names or ([f"ply {k + 1}" for k in range(len(networks))] if several else [""])
        self.tools, self.comm = list(tools), networks[0].comm
        self.symmetry = frozenset(symmetry)
        self.settings = settings = settings or ContactSettings.of_all(
            [(network.fabric, length_of(network, self.symmetry)) for network in networks]
        )
        self.factors, cuts = factors or {}, cuts or {}
        self.prestretch = prestretch
        self.each: list[Blank] = [copy(self) for _ in networks] if several else [self]
        top = 0.0
        for one, net, name in zip(self.each, networks, names, strict=True):
            one.network, one.name = net, name
            one.thickness = net.fabric.needed("thickness", "contact with a tool")
            one.height, top = top + 0.5 * one.thickness, top + one.thickness
            if several and self.comm.size > 1:
                # And what a patch is made of, with what lies beyond the ends of yarns.
                reach = SLIDE * length_of(net, self.symmetry) + 4.0 * float(net.pitch.max())
                others = [other for other in networks if other is not net]
                one._near = crossovers_near(net, others, reach)
            one.ply = ply = one._lay(bending)
            ply.nodes.rest[:, 2] = one.height
            if weight:
                ply.further.append(gravity(ply, "gravity", stretched=float(np.prod(prestretch))))
            ply.cuts = cuts
            if waves is not None:
                ply.further.append(imperfection(ply, *waves))
            ply.further += [make(ply) for make in further]
        plies = [one.ply for one in self.each]
        self.cloth_holds = [holder(ply)([]) for ply in plies]  # where edges hold the cloth, at rest
        place = np.array([tool.start.place for tool in tools]).reshape(-1, 3)
        tool_nodes = ToolNodes(self.comm, place)
        self.nodes = JoinedNodes([*(ply.nodes for ply in plies), tool_nodes])
        *cloth_at, self.tool_node = self.nodes.maps
        for one, at in zip(self.each, cloth_at, strict=True):
            ply = one.ply
            one.cloth_at = at
            one.touching = np.flatnonzero(ply.active[: ply.nodes.num_nodes_owned])
            one.area = ply.areas(AT_HINGE)[one.touching]
        at = np.concatenate([one.cloth_at[one.touching] for one in self.each])
        area = np.concatenate([one.area for one in self.each])
        offset = np.concatenate([
            np.full(len(one.area), 0.5 * one.thickness) for one in self.each
        ])  # fmt: skip
        s = settings
        whole = [
            Contact(
                tool.name, tool.surface, at, node, area,
                offset, s.stiffness, s.width, tool.friction, s.slip,
            )
            for tool, node in zip(tools, self.tool_node, strict=True)
        ]  # fmt: skip
        ends = np.cumsum([0, *(len(one.area) for one in self.each)])
        for one, begin, end in zip(self.each, ends, ends[1:], strict=False):
            one.contacts = [contact.of(slice(begin, end)) for contact in whole]
        self.between = self._between(rub) if several else []
        # A tool that a force drives moves as if a whole blank's viscosity held it.
        mine = self.tool_node[: tool_nodes.num_nodes_owned]
        all_of_it = np.full(len(mine), self.comm.allreduce(float(area.sum())))
        moving = np.concatenate([at, mine])
        rest, owned = self.nodes.rest, self.nodes.num_nodes_owned
        viscous = Viscous(moving, rest[moving], s.viscosity * np.concatenate([area, all_of_it]))
        pushes = []
        for tool, node in zip(tools, self.tool_node, strict=True):
            for axis in range(3):
                force = np.zeros_like(rest)
                force[node, axis] = 1.0
                pushes.append(DeadLoads(force, rest, owned, push_name(tool.name, axis)))
        self.clamps = [item for ply in plies for item in ply.items if isinstance(item, Clamp)]

        def trimmed(item: Item, ply: Ply) -> Item:
            points = _POINTS.get(item.name, slice(0, 1))
            return cast(Item, Trimmed(item, ply.nodes.rest[:, :2], cuts, points)) if cuts else item

        parts = [
            OfPart(trimmed(item, one.ply), one.cloth_at, of_ply(item.name, one.name))
            for one in self.each
            for item in one.ply.items
        ]
        # Loads on edges, of which a blank has none.
        none = [of_ply(o.ply.loads.name, o.name) for o in self.each if o.ply.loads is not None]
        self.loads = [part for part in parts if part.is_load and part.name not in none]
        items: list[Item] = [*parts, *whole, *self.between, viscous, *pushes]
        active = self.nodes.join([*(ply.active for ply in plies), np.ones(len(tools), bool)])
        scale = max(network.fabric.c11 + network.fabric.c22 for network in networks)
        multigrid = in_space(self.nodes, plies, cloth_at)
        self.model = Model(self.nodes, items, active, scale, multigrid)
        self._whole = whole
        self.is_laid, self._begin = laid is not None, self.nodes.rest.copy()
        if laid is not None:  # a single ply, see Forming
            self._begin[cloth_at[0]] = laid.on_nodes(networks[0], plies[0].nodes)
        shared = (
            "nodes", "tool_node", "between", "loads", "clamps", "model", "cloth_holds", "_whole",
            "is_laid", "_begin",
        )  # fmt: skip
        for one in self.each if several else ():
            vars(one).update({name: vars(self)[name] for name in shared}, each=[one])
        if several:
            vars(self).update({k: v for k, v in vars(self.each[0]).items() if k != "each"})

    def _between(self, rub: Sequence[float]) -> list[Between]:
        """Contact and friction of each ply with each other one, both ways. Collective."""
        faces = [Face(one.ply, one.cloth_at) for one in self.each]
        s, items = self.settings, []
        for k, (high, upper) in enumerate(zip(self.each, faces, strict=True)):
            for i, (low, lower) in enumerate(zip(self.each[:k], faces, strict=False)):
                offset = 0.5 * (high.thickness + low.thickness)
                # A ply looks out for the next one, as it may come near within a step.
                reach = max(high.pitch, low.pitch) if k == i + 1 else 0.5 * offset
                friction = rub[k] if rub else 0.0
                for one, other, names, side in (
                    (upper, lower, (high.name, low.name), 1.0),
                    (lower, upper, (low.name, high.name), -1.0),
                ):
                    # Half of each ply's thickness gives way as it does to a tool.
                    items.append(Between(
                        "{} on {}".format(*names), one, other, side, offset, reach,
                        0.5 * s.stiffness, 2.0 * s.width, friction, s.slip,
                    ))  # fmt: skip
        return items

    def _lay(self, bending: bool) -> Ply:
        """The cloth."""
        constraints = Constraints(self.network, bending, floats=True)
        for edge in sorted(self.symmetry):
            constraints.symmetry(edge)
        out = self.network.fabric.out_of_plane("forming")
        if self._near is not None:  # several plies, which are no trusses
            return Ply(constraints, out, flat=False, prestretch=self.prestretch, near=self._near)
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
        held, at = self.cloth_holds, self.nodes.maps
        ours = [here[cloth.nodes] for here, cloth in zip(at, held, strict=False)]
        nodes = np.concatenate([*ours, self.tool_node])
        fixed = np.concatenate([*(cloth.fixed for cloth in held), ~free])
        place = np.concatenate([*(cloth.place for cloth in held), place])
        turn = max((cloth.turn for cloth in held), key=len)  # none is turned: edges stay
        return Hold(nodes, self.nodes.frame[nodes], fixed, place, turn, rotations)

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
        """The state as the ply sees it, with what its items remember by their own names."""
        cloth = cast(State, part_of(state, self.cloth_at))
        if not self.name:
            return cloth
        named = {item.name: of_ply(item.name, self.name) for item in self.ply.items}
        memory = {name: state.memory[of] for name, of in named.items() if of in state.memory}
        return replace(cloth, memory={**state.memory, **memory})

    def tool_moments(self, state: State) -> dict[str, np.ndarray]:
        """Moments on the cloth by tools about their origins, (3,), N m. Collective."""
        ours = np.array([contact.moment(state) for contact in self._whole]).reshape(-1, 3)
        everywhere = self.comm.allreduce(ours)
        return dict(zip((contact.name for contact in self._whole), everywhere, strict=True))

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

        On tools and between plies, by the blank's own viscosity, and in shear if that remembers.
        """
        rub = [*self._whole, *(item for item in self.between if item.friction)]
        rubbed = sum(state.memory[item.name]["spent"].sum() for item in rub)
        flowed = state.memory["viscosity"]["spent"].sum()
        total = self.comm.allreduce(np.array([rubbed, flowed]))
        spent = {"friction": float(total[0]), "viscous": float(total[1])}
        for one in self.each:
            for how, lost in one.ply.dissipated(one.of_cloth(state)).items():
                spent[how] = spent.get(how, 0.0) + lost
        return spent

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


def of_ply(item: str, ply: str) -> str:
    """Name of an item of one of several plies; of a single one, which has no name, its own."""
    return f"{item} of {ply}" if ply else item


def push_name(tool: str, axis: int) -> str:
    """Name of the load that pushes a tool along x, y or z."""
    return f"force on {tool} along {'xyz'[axis]}"


def length_of(network: Network, symmetry: Collection[str] = ()) -> float:
    """The longer side of the whole blank's bounding box, m."""
    doubled = [1 + ("left" in symmetry or "right" in symmetry)]
    doubled += [1 + ("lower" in symmetry or "upper" in symmetry)]
    return float((network.preform.size * doubled).max())
