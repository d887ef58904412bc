# SPDX-License-Identifier: MIT
"""[[tool]] of a case file, and the tool that is made of it."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import numpy as np
from pydantic import AfterValidator, Field, model_validator
from scipy.spatial.transform import Rotation

from ..errors import InputError
from ..fields import Length, Name, Number, Of, Pair, Point, Sides, Size, Table, si_values
from ..parallel import least, on_root
from ..units import Quantity, format_si
from . import shapes
from .motion import Motion, Pose
from .profile import Profile
from .sampled import REACH, from_file
from .sector import Sector
from .surface import Look, Surface, touch

if TYPE_CHECKING:
    from mpi4py import MPI

Side = Literal["+x", "-x", "+y", "-y", "+z", "-z", "outside", "inside"]
_HALF_TURN = np.diag([1.0, -1.0, -1.0])  # about x: what looked up looks down


@dataclass(frozen=True, eq=False)
class Tool:
    """A rigid tool: a surface, where it starts, how it rubs.

    Attributes
    ----------
    name : str
    surface : Surface
    friction : float
        Coulomb's coefficient.
    start : Pose
        At the beginning of the first stage.
    placed : bool
        Whether that is where it was put; else it still has to be moved to where it just touches.
    """

    name: str
    surface: Surface
    friction: float = 0.0
    start: Pose = field(default_factory=Pose)
    placed: bool = True

    def look(self, points: np.ndarray, pose: Pose) -> Look:
        """Distance, normal and curvature as of Surface.look, of points and in axes of the lab."""
        distance, normal, curvature = self.surface.look(pose.to_tool(points))
        return distance, pose.vector_to_lab(normal), pose.matrix_to_lab(curvature)

    def remarks(self, thickness: float) -> list[str]:
        """What the surface's user should know, for cloth of some thickness [m]; sentences."""
        remarks = [f'tool "{self.name}": {remark}' for remark in self.surface.remarks]
        smallest = min(self.surface.closest_radius)
        if smallest < thickness:
            remarks.append(
                f'tool "{self.name}" has radii down to {format_si(smallest, "m")}, less than the '
                f"cloth's thickness, {format_si(thickness, 'm')}"
            )
        return remarks

    def touching(
        self,
        points: np.ndarray,
        axis: np.ndarray,
        gap: float,
        comm: MPI.Intracomm | None = None,
    ) -> Tool:
        """The tool, moved along an axis to where it just touches.

        Parameters
        ----------
        points : float (n, 3), m, in the lab
        axis : float (3,)
            Towards the cloth.
        gap : float
            Distance of the surface from the points where it touches, m: half the cloth's thickness.
        comm : communicator, optional
            Of ranks that have points each. Collective then.

        Raises InputError if the tool never meets the points.
        """
        axis = np.asarray(axis, float) / np.linalg.norm(axis)
        inner = self.start.to_tool(points)
        met = touch(self.surface, inner, -self.start.vector_to_tool(axis), gap)
        way = np.inf if met is None else met[0]
        if comm is not None:
            way = least(comm, way)
        if not np.isfinite(way):
            raise InputError(
                f'tool "{self.name}" does not meet the cloth along '
                f"({', '.join(f'{x:.3g}' for x in axis)}): give it a place"
            )
        return replace(self, start=self.start.moved(way * axis), placed=True)


def load(comm: MPI.Intracomm, table: ToolTable, **options: Any) -> Tool:
    """Make a tool on rank 0, which alone reads files, and give it to all. Collective.

    Arguments and errors as of ToolTable.build.
    """
    return on_root(comm, lambda: table.build(**options))


# -- tables of case files --------------------------------------------------------------------------


def _three(values: list[Any]) -> list[Any]:
    if len(values) != 3:
        raise ValueError(f"must be a list of 3, for x, y and z, got {len(values)}")
    return values


def _two_or_three(values: list[Any]) -> list[Any]:
    if len(values) not in (2, 3):
        raise ValueError(
            f"must be a list of 3, for x, y and z, or of 2, to touch there, got {len(values)}"
        )
    return values


def _not_zero(axis: list[float]) -> list[float]:
    if not any(axis):
        raise ValueError("must have a direction, got 0, 0, 0")
    return axis


def _not_negative(value: float) -> float:
    if value < 0.0:
        raise ValueError(f"must be zero or positive, got {value:g}")
    return value


def _rising(curve: list[list[float]]) -> list[list[float]]:
    if curve[0] != [0.0, 0.0] or curve[-1] != [1.0, 1.0]:
        raise ValueError("must go from [0, 0] to [1, 1], share of the way over share of the stage")
    if any(b[0] <= a[0] for a, b in pairwise(curve)):
        raise ValueError("must have rising shares of the stage")
    return curve


Radius = Annotated[Quantity, Of("m", good=lambda r: r >= 0.0, wanted="zero or positive")]
Place = Annotated[list[Length], AfterValidator(_three)]
Start = Annotated[list[Length], AfterValidator(_two_or_three)]
Sizes = Annotated[list[Size], AfterValidator(_three)]
Angles = Annotated[list[Annotated[Quantity, Of("rad")]], AfterValidator(_three)]
Axis = Annotated[list[Number], AfterValidator(_three), AfterValidator(_not_zero)]
Friction = Annotated[Number, AfterValidator(_not_negative)]
Curve = Annotated[list[Pair], Field(min_length=2), AfterValidator(_rising)]
Fillets = Annotated[
    Quantity | list[Quantity],
    Of("m", many=True, good=lambda r: r >= 0.0, wanted="zero or positive", example="5 mm"),
]
Profiles = Annotated[list[Point], Field(min_length=2)]


class PlaneTable(Table):
    """A plane, z = 0, or a plate."""

    size: Sides | None = None
    """Along x and y, of a plate; the default is a plane without an end.
    Example: `["300 mm", "300 mm"]`"""
    edge_radius: Size | None = None
    """Of a plate; the default is 2 % of its smaller side. Example: `"5 mm"`"""

    @model_validator(mode="after")
    def _edge_of_a_plate(self) -> PlaneTable:
        if self.edge_radius is not None and self.size is None:
            raise ValueError(".edge_radius is of a plate: give its size, too")
        return self

    def build(self) -> Surface:
        """Make it."""
        size = None if self.size is None else (self.size[0].si, self.size[1].si)
        return shapes.plane(size, _si(self.edge_radius))


class SphereTable(Table):
    """A sphere about the origin."""

    radius: Size
    """Of the sphere."""
    shaft: bool = False
    """Half a sphere on a shaft of the same radius."""

    def build(self) -> Surface:
        """Make it."""
        return shapes.sphere(self.radius.si, shaft=self.shaft)


class CylinderTable(Table):
    """A cylinder about y."""

    radius: Size
    """Of the cylinder."""
    length: Size | None = None
    """The default is a cylinder without ends. Example: `"200 mm"`"""
    edge_radius: Size | None = None
    """Of its ends' rims; the default is 2 % of the smaller of diameter and length.
    Example: `"2 mm"`"""

    @model_validator(mode="after")
    def _edge_of_an_end(self) -> CylinderTable:
        if self.edge_radius is not None and self.length is None:
            raise ValueError(".edge_radius is of its ends: give its length, too")
        return self

    def build(self) -> Surface:
        """Make it."""
        return shapes.cylinder(self.radius.si, _si(self.length), _si(self.edge_radius))


class BoxTable(Table):
    """A box about the origin."""

    size: Sizes
    """Along x, y and z."""
    edge_radius: Size | None = None
    """The default is 2 % of the smallest side. Example: `"5 mm"`"""

    def build(self) -> Surface:
        """Make it."""
        return shapes.Box(si_values(self.size), _si(self.edge_radius))  # type: ignore[arg-type]


class RingTable(Table):
    """A flat ring, z = 0, or a disc."""

    inner_radius: Radius = Quantity.read("0 mm", "m")
    """0 for a disc."""
    outer_radius: Size
    """Of the ring."""
    edge_radius: Size | None = None
    """Of its rims; the default is 2 % of the ring's width. Example: `"5 mm"`"""
    begin: Annotated[Quantity, Of("rad")] | None = Field(alias="from", default=None)
    """Of a sector, by half a turn at most: angle from x towards y where it begins; with to. Seen
    from above, also of a tool that looks down. A segment of a holder. Example: `"-45 deg"`"""
    end: Annotated[Quantity, Of("rad")] | None = Field(alias="to", default=None)
    """Where it ends. Example: `"45 deg"`"""

    @model_validator(mode="after")
    def _both_angles(self) -> RingTable:
        if (self.begin is None) != (self.end is None):
            raise ValueError("needs both from and to, or none of them")
        return self

    def build(self, turned_over: bool = False) -> Surface:
        """Make it; if it is then turned half around x, its angles are those seen from above."""
        if self.begin is not None and self.end is not None:
            edge, (begin, end) = _si(self.edge_radius), (self.begin.si, self.end.si)
            if turned_over:
                begin, end = -end, -begin
            return Sector(self.inner_radius.si, self.outer_radius.si, begin, end, edge)
        return shapes.ring(self.inner_radius.si, self.outer_radius.si, _si(self.edge_radius))


class RevolveTable(Table):
    """A profile turned about z: a die with a round opening, or any other."""

    opening_radius: Size | None = None
    """Of the wall of a die's opening in the flat z = 0. Example: `"80 mm"`"""
    fillet: Size | None = None
    """Of the opening's edge and of the outer rim. Example: `"7.5 mm"`"""
    outer_radius: Size | None = None
    """Where the flat ends. Example: `"225 mm"`"""
    profile: Profiles | None = None
    """Corners, each r and z, in place of the three above. The cloth lies above; at its ends it goes
    straight down. Example: `[["0 mm", "40 mm"], ["30 mm", "40 mm"], ["60 mm", "0 mm"]]`"""
    fillets: Fillets | None = None
    """Of all corners of a profile, or one each. Example: `"5 mm"`"""
    smooth: bool = False
    """The profile's points lie on a smooth curve; then without fillets."""
    spine: Size | None = None
    """Oblong: longer by this along y. Example: `"610 mm"`"""

    @model_validator(mode="after")
    def _one_way(self) -> RevolveTable:
        die = (self.opening_radius, self.fillet, self.outer_radius)
        if self.profile is None:
            if None in die or self.fillets is not None or self.smooth:
                raise ValueError("needs opening_radius, fillet and outer_radius, or a profile")
        elif any(value is not None for value in die):
            raise ValueError(
                "needs either a profile or opening_radius, fillet and outer_radius, got both"
            )
        else:
            _check_fillets(self.fillets, self.smooth)
        return self

    def build(self) -> Surface:
        """Make it."""
        spine = 0.0 if self.spine is None else self.spine.si
        if self.profile is not None:
            return Profile(_corners(self.profile), _radii(self.fillets), spine=spine)
        radius, fillet, outer = (
            _si(v) or 0.0 for v in (self.opening_radius, self.fillet, self.outer_radius)
        )
        return shapes.opening(radius, fillet, outer, spine)


class ExtrudeTable(Table):
    """A profile extruded along y, without an end."""

    profile: Profiles
    """Corners, each x and z. The cloth lies above; at its ends it goes straight down."""
    fillets: Fillets | None = None
    """Of all corners, or one each. Example: `"5 mm"`"""
    smooth: bool = False
    """The profile's points lie on a smooth curve; then without fillets."""

    @model_validator(mode="after")
    def _fillets(self) -> ExtrudeTable:
        _check_fillets(self.fillets, self.smooth)
        return self

    def build(self) -> Surface:
        """Make it."""
        return Profile(_corners(self.profile), _radii(self.fillets), turned=False)


def _check_fillets(fillets: Any, smooth: bool) -> None:
    if (fillets is None) != smooth:
        raise ValueError(
            "needs fillets of its corners, or smooth = true for points of a smooth curve"
        )


def _corners(profile: list[list[Quantity]]) -> list[list[float]]:
    return [si_values(point) for point in profile]


def _radii(fillets: Any) -> list[float] | None:
    return None if fillets is None else si_values(fillets)


def _si(quantity: Quantity | None) -> float | None:
    return None if quantity is None else quantity.si


class ShapeTable(Table):
    """[[tool]] shape: one of these, or a file."""

    plane: PlaneTable | None = None
    """A plane or a plate. Example: `{ size = ["300 mm", "300 mm"] }`"""
    sphere: SphereTable | None = None
    """About the origin. Example: `{ radius = "75 mm" }`"""
    cylinder: CylinderTable | None = None
    """About y. Example: `{ radius = "50 mm" }`"""
    box: BoxTable | None = None
    """About the origin. Example: `{ size = ["100 mm", "80 mm", "40 mm"], edge_radius = "5 mm" }`"""
    ring: RingTable | None = None
    """Flat, or a disc. Example: `{ inner_radius = "90 mm", outer_radius = "225 mm" }`"""
    revolve: RevolveTable | None = None
    """A profile turned about z.
    Example: `{ opening_radius = "80 mm", fillet = "7.5 mm", outer_radius = "225 mm" }`"""
    extrude: ExtrudeTable | None = None
    """A profile extruded along y.
    Example: `{ profile = [["-50 mm", "0 mm"], ["50 mm", "0 mm"]], fillets = "5 mm" }`"""
    file: Name | None = None
    """STL, OBJ, PLY or STEP, or CSV with points x, y, z of a height field; relative to the case
    file's folder. Example: `"die.stl"`"""
    unit: Annotated[Quantity, Of("m", column=True)] | None = None
    """Of a file's numbers; a STEP file has its own. Example: `"mm"`"""
    side: Side | None = None
    """Where the cloth lies. Of a flat or a profile: above, "+z", the default, or below, "-z", with
    the tool turned half around x. Of a file: necessary for an open skin, an axis; for a closed
    body "outside", the default, or "inside". Example: `"-z"`"""
    cell: Size | None = None
    """Of the grid that a file's surface is sampled on; the default is the longest side over 256.
    Example: `"1 mm"`"""

    @model_validator(mode="after")
    def _one_shape(self) -> ShapeTable:
        given = [name for name in SHAPES if getattr(self, name) is not None]
        if len(given) != 1:
            got = " and ".join(given) if given else "none"
            raise ValueError(f"needs exactly one of {', '.join(SHAPES)}, got {got}")
        if self.file is None:
            for key in ("unit", "cell"):
                if getattr(self, key) is not None:
                    raise ValueError(f".{key} is of a file, not of a {given[0]}")
            if self.side not in (None, "+z", "-z"):
                raise ValueError(f'.side must be "+z" or "-z" of a {given[0]}, got "{self.side}"')
        return self

    def build(
        self, folder: Path = Path(), reach: float = REACH, turned_over: bool = False
    ) -> Surface:
        """Make the surface in the tool's frame; a file is looked for from the folder."""
        if self.file is not None:
            path = folder / self.file
            return from_file(path, _si(self.unit), self.side, _si(self.cell), reach)
        if self.ring is not None:
            return self.ring.build(turned_over)
        return next(getattr(self, name) for name in SHAPES if getattr(self, name)).build()


SHAPES = ("plane", "sphere", "cylinder", "box", "ring", "revolve", "extrude", "file")


class ToolTable(Table):
    """[[tool]]: a rigid tool."""

    name: Name
    """What stages and results call it."""
    shape: ShapeTable
    """What it looks like. Example: `{ sphere = { radius = "75 mm" } }`"""
    place: Start | None = None
    """Of its frame's origin, x, y, z from the centre of the blank and the die's flat. The default
    is where it just touches; with x and y alone, where it does there.
    Example: `["0 mm", "0 mm", "10 mm"]`"""
    turn: Angles | None = None
    """About x, then y, then z, axes that stay where they are.
    Example: `["0 deg", "0 deg", "45 deg"]`"""
    friction: Friction = 0.0
    """Coulomb's coefficient between tool and cloth."""

    @property
    def looks(self) -> np.ndarray:
        """Where the cloth lies by `side` once the tool is turned, a unit vector (3,); else 0."""
        side = self.shape.side or ""
        axis = np.zeros(3)
        if side[1:] in ("x", "y", "z"):
            axis["xyz".index(side[1])] = 1.0 if side[0] == "+" else -1.0
        return self._turn() @ axis

    def _turn(self) -> np.ndarray:
        """What `turn` says, (3, 3)."""
        if self.turn is None:
            return np.eye(3)
        return Rotation.from_euler("xyz", si_values(self.turn)).as_matrix()

    def build(
        self,
        folder: Path = Path(),
        facing: Literal["+z", "-z"] = "+z",
        reach: float = REACH,
    ) -> Tool:
        """Make the tool.

        ``folder`` is the case file's. ``facing`` is the side of a flat or a profile that says none:
        "-z" for a tool that comes from above. ``reach``: how far from a file's surface distances
        are wanted exactly, m; more than the cloth's thickness.

        Raises InputError, which begins with the tool's name, as Profile, Box and from_file do.
        """
        turned_over = self.shape.file is None and (self.shape.side or facing) == "-z"
        try:
            surface = self.shape.build(folder, reach, turned_over)
        except InputError as error:
            raise InputError(f'tool "{self.name}": {error}') from None
        turn = self._turn()
        if turned_over:
            turn = turn @ _HALF_TURN
        told = [] if self.place is None else si_values(self.place)
        pose = Pose(np.array([*told, 0.0, 0.0, 0.0][:3]), turn)
        return Tool(self.name, surface, self.friction, pose, len(told) == 3)


class TurnTable(Table):
    """How a tool turns during a stage."""

    angle: Annotated[Quantity, Of("rad")]
    """By which it turns."""
    axis: Axis
    """Of the turn, by the right hand. Example: `[0.0, 1.0, 0.0]`"""
    through: Place | None = None
    """A point on the axis; the default is the tool's own origin.
    Example: `["0 mm", "0 mm", "0 mm"]`"""


def motion(
    start: Pose,
    travel: list[Quantity] | None = None,
    turn: TurnTable | None = None,
    curve: list[list[float]] | None = None,
) -> Motion:
    """What a stage says of a tool's motion, from its pose at the stage's beginning."""
    way = np.zeros(3) if travel is None else np.array(si_values(travel))
    speed = None if curve is None else np.array(curve)
    if turn is None:
        return Motion(start, way, curve=speed)
    through = start.place if turn.through is None else np.array(si_values(turn.through))
    return Motion(start, way, np.array(turn.axis), through, turn.angle.si, speed)
