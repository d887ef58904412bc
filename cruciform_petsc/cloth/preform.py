# SPDX-License-Identifier: MIT
"""What was cut: outline and holes, the way the yarns run, and the edges by name.

y is the direction of pull. The warp runs at the bias angle b from y, and the weft is the warp
turned by +90 degrees:

    e_w = (sin b, cos b)      e_e = (-cos b, sin b)
"""

from __future__ import annotations

import math
import re
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace
from difflib import get_close_matches
from typing import Annotated, Any, Self

import numpy as np
import shapely
from pydantic import Field, PrivateAttr, field_validator, model_validator
from shapely.geometry.polygon import orient
from shapely.ops import substring
from shapely.validation import explain_validity

from ..drawn import Shown
from ..errors import InputError, shown
from ..fields import Count, Lines, Name, Of, Point, Ring, Rings, Sides, Size, Table, si_values
from ..units import Quantity, format_si
from . import rings
from .drawing import read_drawing
from .fabric import Fabric

_SMALLEST = 1e-18  # m^2, of an area, beyond which shapely takes points for one
_LARGEST = 1e9  # m, of a coordinate; squares of areas must not overflow
LARGE = 10.0  # m, of a specimen: larger ones are hardly meant
_ALONG = 1e-6  # of the outline's size: how far a side may turn from a yarn
_NEAR = 1e-3  # of the outline's size: how far off it a point may lie that is meant to be on it
_SLIT = 2e-5  # of the outline's size: width of a slit, less than a yarn's, more than lattice.SNAP
_ROUNDING = 1e-9  # relative to the outline's size: what counts as rounding

# Straight pieces of the outline with names of their own: axis, and which end of it.
_SIDES = {"lower": (1, 0), "upper": (1, 1), "left": (0, 0), "right": (0, 1)}

Length = str | float


@dataclass(frozen=True, eq=False, repr=False)
class Preform(Shown):
    """A piece of cloth before it is loaded.

    Parameters
    ----------
    outline : shapely.Polygon
        In metres, holes allowed. It is kept with its exterior counter-clockwise and its holes
        clockwise, so that the cloth lies on the left of every boundary segment.
    bias_angle : float or str
        From y to the warp [rad], or with a unit: "45 deg".
    refine, yarns_per_cruciform : int
        Divides or multiplies the pitch: a finer or coarser network of the same fabric.
    origin : pair of float or str, optional
        A crossover of the lattice, or whole pitches from one [m]; default: the centre of the
        outline's bounding box.
    edges : dict, optional
        More edges by name, each an array (n, 2, 2) of segments on the outline [m]. In the
        finished object: all edges, the automatic ones first.

    Notes
    -----
    Automatic names: ``lower``, ``upper``, ``left``, ``right`` (the segments at the smallest and
    largest y and x, where there are any), ``outline-1``, ``outline-2`` ... (the exterior,
    counter-clockwise from its first point), ``hole-1`` ... (each hole as a whole).

    Raises
    ------
    InputError
        An outline that crosses itself, has no area, or holes that touch; numbers out of range; of
        `rectangle` and `polygon`, more than 10 m in bare numbers.

    Examples
    --------
    >>> preform = Preform.rectangle("75 mm", "220 mm", "45 deg")
    >>> preform
    Preform(75 mm x 220 mm, area 165 cm^2, 0 holes, bias 45 deg, refine 1, yarns_per_cruciform 1)
    >>> list(preform.edges)[:4]
    ['lower', 'upper', 'left', 'right']
    >>> preform.pitch(Fabric.from_library("e-glass-plain-2.4")) == (1 / 240, 1 / 240)  # m
    True
    """

    outline: shapely.Polygon
    bias_angle: float
    refine: int = field(default=1, kw_only=True)
    yarns_per_cruciform: int = field(default=1, kw_only=True)
    origin: tuple[float, float] | None = field(default=None, kw_only=True)
    edges: Mapping[str, np.ndarray] = field(default_factory=dict, kw_only=True)

    def __post_init__(self) -> None:
        """Turn units into SI, check everything, name the edges."""
        given = {key: getattr(self, key) for key in LatticeTable.model_fields}
        lattice = LatticeTable.from_data(given, "preform", bare=True)
        angle = lattice.bias_angle.si
        if not isinstance(self.bias_angle, str) and abs(angle) > 2.0 * math.pi:
            raise InputError(
                f"preform.bias_angle = {angle:g} rad is more than a full turn, "
                f'did you mean "{angle:g} deg"?'
            )
        origin = None if lattice.origin is None else tuple(si_values(lattice.origin))
        if origin is not None and max(map(abs, origin)) > _LARGEST:
            raise InputError(f"preform.origin must be within {_LARGEST:g} m of x = y = 0")
        outline = _checked(self.outline)
        own = {name: _segments_on(outline, name, e) for name, e in (self.edges or {}).items()}
        # Frozen from here on.
        vars(self).update(
            bias_angle=angle,
            refine=lattice.refine,
            yarns_per_cruciform=lattice.yarns_per_cruciform,
            origin=origin,
            outline=outline,
            edges=_named_edges(outline) | own,
        )

    @property
    def size(self) -> np.ndarray:
        """Width and length of the outline's bounding box, float (2,) [m]."""
        return np.ptp(np.reshape(self.outline.bounds, (2, 2)), axis=0)

    @property
    def middle(self) -> np.ndarray:
        """Centre of the outline's bounding box, float (2,) [m]."""
        return np.mean(np.reshape(self.outline.bounds, (2, 2)), axis=0)

    def centred(self, planes: Collection[str] = ()) -> Preform:
        """The same with the centre of its bounding box at x = y = 0.

        Of a part between planes of symmetry, ``planes`` names its sides there: "left" or "right" is
        put at x = 0, "lower" or "upper" at y = 0, and a crossover where they meet by default. Of
        two that face each other the centre is between them.
        """
        shift = self.middle
        for axis, sides in enumerate((("left", "right"), ("lower", "upper"))):
            there = [side for side in sides if side in planes]
            if len(there) == 1:
                shift[axis] = self.edge(there[0])[0, 0, axis]
        if self.origin is None:
            origin = (0.0, 0.0) if planes else None
        else:
            origin = (self.origin[0] - shift[0], self.origin[1] - shift[1])
        automatic = _named_edges(self.outline)
        edges = {
            name: segments - shift
            for name, segments in self.edges.items()
            if not np.array_equal(segments, automatic.get(name, ()))
        }
        outline = shapely.transform(self.outline, lambda xy: xy - shift)
        return replace(self, outline=outline, origin=origin, edges=edges)

    def sides(self, tolerance: float = 1e-9) -> tuple[float, float] | None:
        """Width and length of a rectangle along x and y, m; None for any other area, relatively."""
        width, length = map(float, self.size)
        off = abs(self.outline.area - width * length)
        return (width, length) if off <= tolerance * width * length else None

    @classmethod
    def rectangle(
        cls,
        width: Length,
        length: Length,
        bias_angle: Length = "45 deg",
        *,
        holes: Sequence[Sequence[Sequence[Length]]] = (),
        **options: Any,
    ) -> Preform:
        """Cut a rectangle: x in [-width/2, width/2], y in [0, length].

        Lengths and the angle have a unit ("75 mm", "45 deg") or are in SI. ``holes`` are lists of
        corners; options are ``slits`` and ``darts``, lists of points (see OutlineTable),
        ``refine``, ``yarns_per_cruciform``, ``origin`` and ``edges``.
        """
        outline = {"rectangle": [width, length], "holes": holes}
        return cls._cut(outline, bias_angle, options)

    @classmethod
    def polygon(
        cls,
        points: Sequence[Sequence[Length]],
        holes: Sequence[Sequence[Sequence[Length]]] = (),
        bias_angle: Length = "45 deg",
        **options: Any,
    ) -> Preform:
        """Cut any simple polygon by its corners in order; all else as for `rectangle`."""
        return cls._cut({"polygon": points, "holes": holes}, bias_angle, options)

    @classmethod
    def shape(
        cls,
        outline: Mapping[str, Any],
        bias_angle: Length = "45 deg",
        **options: Any,
    ) -> Preform:
        """Cut what ``[preform] outline`` of a case file can be (docs/case-file.md).

        Drawings are looked for from the working folder. Options as for `rectangle`.

        >>> blank = Preform.shape({"circle": "300 mm"}, "0 deg")
        >>> blank.edge("rim").shape
        (240, 2, 2)
        """
        return cls._cut(dict(outline), bias_angle, options)

    @classmethod
    def _cut(cls, outline: dict, bias_angle: Length, options: dict) -> Preform:
        outline |= {key: options.pop(key) for key in ("slits", "darts") if key in options}
        table = OutlineTable.from_data(outline, "preform.outline", bare=True)
        shape, edges = table.build()
        given = next(outline[name] for name in SHAPES if name in outline)
        given = given if isinstance(given, list | tuple | np.ndarray) else [given]
        size = np.ptp(shape.bounds[::2])
        size = max(size, np.ptp(shape.bounds[1::2]))
        if size > LARGE and all(np.asarray(row).dtype.kind in "fiu" for row in given):
            raise InputError(
                f"preform.outline is {size:g} m large, as lengths without unit are metres, "
                f'did you mean "{size:g} mm"?'
            )
        own = dict(options.pop("edges", None) or {})
        return cls(shape, bias_angle, edges=edges | own, **options)  # type: ignore[arg-type]

    @property
    def warp_direction(self) -> np.ndarray:
        """Unit vector along the warp, e_w, float (2,)."""
        return np.array([math.sin(self.bias_angle), math.cos(self.bias_angle)])

    @property
    def weft_direction(self) -> np.ndarray:
        """Unit vector along the weft, e_e, float (2,)."""
        return np.array([-math.cos(self.bias_angle), math.sin(self.bias_angle)])

    @property
    def rotation(self) -> np.ndarray:
        """Rows e_w and e_e, float (2, 2): components along the yarns = rotation @ (x, y)."""
        return np.array([self.warp_direction, self.weft_direction])

    @property
    def lattice_origin(self) -> np.ndarray:
        """Where a crossover lies, given or the centre of the bounding box, float (2,) [m]."""
        return self.middle if self.origin is None else np.array(self.origin)

    def check_along_the_yarns(self, whose: str) -> None:
        """Raise InputError, which names `whose` need it is, if yarns do not follow its sides."""
        if shapely.Polygon(self.outline.exterior).area < (1.0 - 1e-9) * self.size.prod():
            raise InputError(f"{whose} needs preform.outline to be a rectangle with upright sides")
        if abs(math.sin(2.0 * self.bias_angle)) > 1e-9:
            raise InputError(
                f'{whose} needs yarns along the edges: preform.bias_angle = "0 deg" or "90 deg", '
                f'got "{format_si(self.bias_angle, "rad")}"'
            )

    def along_yarns(self, whose: str) -> shapely.Polygon:
        """Outline along warp and weft [m]; InputError unless its sides follow yarns, without slits.

        ``whose``: need it is, for the InputError.
        """
        outline = shapely.transform(self.outline, lambda x: x @ self.rotation.T)
        rings = [shapely.get_coordinates(r) for r in (outline.exterior, *outline.interiors)]
        sides = abs(np.concatenate([np.diff(ring, axis=0) for ring in rings]))
        if not (sides.min(axis=1) <= _ALONG * self.size.max()).all():
            raise InputError(f"{whose} needs an outline whose sides run along the yarns")
        if sides.max(axis=1).min() < 2.0 * _SLIT * self.size.max():
            raise InputError(f"{whose} needs an outline without slits")
        return outline

    def pitch(self, fabric: Fabric) -> tuple[float, float]:
        """Distance of crossovers along a warp yarn (between wefts) and along a weft yarn [m]."""
        factor = self.yarns_per_cruciform / self.refine
        return fabric.weft.spacing * factor, fabric.warp.spacing * factor

    def questions(self, fabric: Fabric) -> list[str]:
        """What is hardly meant: slits that run along yarns, and take them away."""
        families = np.array(self._yarns_on_slits(fabric))
        if not families.any():
            return []
        pitch = np.array(self.pitch(fabric))
        # Slits along the warp are moved across it, along the second axis of the lattice.
        shift = np.where(families[::-1] > 0, 0.5 * pitch, 0.0) @ self.rotation
        moved = replace(self, origin=tuple(self.lattice_origin + shift))
        x, y = (format_si(float(f"{step:.6g}") + 0.0, "m") for step in shift)
        cure = f"moving preform.origin by {x} in x and {y} in y puts the slits between yarns"
        if any(moved._yarns_on_slits(fabric)):
            cure = "choose slits that fit between the yarns"
        count = int(families.sum())
        which = "1 yarn lies on a slit of the outline and ends" if count == 1 else (
            f"{count} yarns lie on slits of the outline and end"
        )  # fmt: skip
        return [f"{which} there, as if cut away: {cure}"]

    def _yarns_on_slits(self, fabric: Fabric) -> tuple[int, int]:
        """How many yarns of the net, warp and weft, run within slits of the outline."""
        pitch = np.array(self.pitch(fabric))
        gap = 1.01 * _SLIT * self.size.max()
        rings = [
            np.asarray(r.coords)[:, :2] for r in (self.outline.exterior, *self.outline.interiors)
        ]
        ends = np.concatenate([np.stack([r[:-1], r[1:]], axis=1) for r in rings])
        ends = (ends - self.lattice_origin) @ self.rotation.T
        found = []
        for family in (0, 1):
            along, across = (
                np.sort(ends[..., family], axis=1),
                ends[..., 1 - family] / pitch[1 - family],
            )
            line = np.round(across.mean(axis=1))
            off = (across - line[:, None]) * pitch[1 - family]
            near = (abs(off) < gap).all(axis=1) & (np.ptp(along, axis=1) > gap)
            yarns = {
                line[i]
                for i in np.flatnonzero(near & (off > 0.0).all(axis=1))
                for j in np.flatnonzero(near & (off < 0.0).all(axis=1) & (line == line[i]))
                if min(along[i, 1], along[j, 1]) > max(along[i, 0], along[j, 0])
            }
            found.append(len(yarns))
        return found[0], found[1]

    def check_size(self, fabric: Fabric) -> None:
        """Raise InputError if the outline is smaller than one cruciform of this fabric."""
        pitch = self.pitch(fabric)
        along = np.asarray(self.outline.exterior.coords)[:, :2] @ self.rotation.T
        room = 1.0 + _ROUNDING  # exactly one cruciform is enough, rounding or not
        if (
            self.outline.area * room < math.prod(pitch)
            or self.size.min() * room < min(pitch)
            or (np.ptp(along, axis=0) * room < pitch).any()
        ):
            coarse = self.yarns_per_cruciform > 1
            cure = "lower preform.yarns_per_cruciform" if coarse else "raise preform.refine"
            raise InputError(
                f"preform.outline ({_size(*self.size)}) is smaller than one cruciform "
                f"({_size(*pitch)} along the yarns), make it larger or {cure}"
            )

    def edge(self, name: str) -> np.ndarray:
        """Segments of a named edge, float (n, 2, 2): segment, end, x or y [m].

        The cloth lies on the left of each. An unknown name is an InputError that lists the known.
        """
        if name in self.edges:
            return self.edges[name]
        close = get_close_matches(str(name), self.edges, 1)
        hint = f'did you mean "{close[0]}"? ' if close else ""
        if name in _SIDES:
            axis, end = _SIDES[name]
            extreme = f"{('smallest', 'largest')[end]} {'xy'[axis]}"
            hint = f"no straight piece of the outline lies at its {extreme}, "
        raise InputError(f'preform has no edge "{name}" ({hint}known: {self.edge_list()})')

    def edge_list(self) -> str:
        """The known names, numbered ones as a range."""
        names = [name for name in self.edges if not re.fullmatch(r"(outline|hole)-\d+", name)]
        for kind in ("outline", "hole"):
            group = [name for name in self.edges if re.fullmatch(rf"{kind}-\d+", name)]
            names += group if len(group) < 3 else [f"{group[0]} to {group[-1]}"]
        return ", ".join(names)

    def __repr__(self) -> str:
        """Size, area and direction."""
        return (
            f"Preform({_size(*self.size)}, area {self.outline.area * 1e4:.6g} cm^2, "
            f"{len(self.outline.interiors)} holes, bias {format_si(self.bias_angle, 'rad')}, "
            f"refine {self.refine}, yarns_per_cruciform {self.yarns_per_cruciform})"
        )


def _size(a: float, b: float) -> str:
    return f"{format_si(a, 'm')} x {format_si(b, 'm')}"


def _extent(piece: shapely.Polygon) -> str:
    return _size(*np.ptp(np.reshape(piece.bounds, (2, 2)), axis=0))


def _checked(outline: Any) -> shapely.Polygon:
    """Return the outline with the cloth on its left and no repeated points."""
    if not isinstance(outline, shapely.Polygon) or outline.is_empty:
        raise InputError(f"preform.outline must be one polygon, got {shown(outline)}")
    coordinates = shapely.get_coordinates(outline)
    if not np.isfinite(coordinates).all():
        raise InputError("preform.outline has a corner that is not finite")
    if np.abs(coordinates).max() > _LARGEST:
        raise InputError(f"preform.outline has a corner more than {_LARGEST:g} m from x = y = 0")
    shell, *holes = (shapely.Polygon(ring) for ring in (outline.exterior, *outline.interiors))
    _check_ring("preform.outline", shell)
    for i, hole in enumerate(holes):
        _check_ring(f"hole-{i + 1}", hole)
    shapely.prepare(shell)
    for i in np.flatnonzero(~shapely.contains_properly(shell, holes)):
        raise InputError(
            f"hole-{i + 1} of preform.outline ({_extent(holes[i])}) touches or leaves the outline "
            f"({_extent(shell)}), it must lie wholly inside"
        )
    tree = shapely.STRtree(holes)
    pairs = tree.query(tree.geometries, predicate="intersects").T
    for i, j in sorted(pairs[pairs[:, 0] > pairs[:, 1]].tolist()):
        raise InputError(
            f"hole-{j + 1} and hole-{i + 1} of preform.outline touch or overlap, "
            "make one hole of them or move them apart"
        )
    return orient(shapely.remove_repeated_points(shapely.force_2d(outline)))


def _check_ring(name: str, piece: shapely.Polygon) -> None:
    if shapely.convex_hull(piece).area < _SMALLEST:  # of a line it is 0
        raise InputError(f"{name} has no area, its corners lie on one line")
    if not piece.is_valid:
        place = re.search(r"\[(\S+) ([^]\s]+)", explain_validity(piece))
        where = ""
        if place is not None:
            x, y = (format_si(float(part), "m") for part in place.groups())
            where = f" at x = {x}, y = {y}"
        raise InputError(f"{name} crosses or touches itself{where}, it must be a simple polygon")


def _named_edges(outline: shapely.Polygon) -> dict[str, np.ndarray]:
    def segments(ring: shapely.LinearRing) -> np.ndarray:
        points = np.asarray(ring.coords)[:, :2]
        return np.stack([points[:-1], points[1:]], axis=1)

    exterior = segments(outline.exterior)
    box = np.reshape(outline.bounds, (2, 2))
    near = _ROUNDING * np.ptp(box, axis=0).max()
    edges = {}
    for name, (axis, end) in _SIDES.items():
        lies_there = (np.abs(exterior[:, :, axis] - box[end, axis]) <= near).all(axis=1)
        if lies_there.any():
            edges[name] = exterior[lies_there]
    edges |= {f"outline-{i + 1}": exterior[i : i + 1] for i in range(len(exterior))}
    edges |= {f"hole-{i + 1}": segments(ring) for i, ring in enumerate(outline.interiors)}
    return edges


def _segments_on(outline: shapely.Polygon, name: str, segments: Any) -> np.ndarray:
    """Check that a user's edge lies on the outline, and put the cloth on its left."""
    array = np.array(segments, float)
    if array.ndim != 3 or array.shape[1:] != (2, 2) or not len(array):
        raise InputError(f'edge "{name}" must have the shape (n, 2, 2), got {array.shape}')
    size = np.ptp(np.reshape(outline.bounds, (2, 2)), axis=0).max()
    lines = shapely.linestrings(array)
    if not shapely.covers(outline.boundary.buffer(1e-6 * size), lines).all():
        raise InputError(f'edge "{name}" does not lie on preform.outline')
    along = array[:, 1] - array[:, 0]
    length = np.linalg.norm(along, axis=1, keepdims=True)
    if (length == 0.0).any():
        raise InputError(f'edge "{name}" has a segment without length')
    left = along[:, ::-1] * (-1.0, 1.0) / length
    probe = array.mean(axis=1) + 1e-5 * size * left
    turn = ~shapely.contains_xy(outline, probe)
    array[turn] = array[turn, ::-1]
    return array


# -- tables of case files, from which preforms are built -------------------------------------------


class OutlineTable(Table):
    """[preform] outline: one shape, or a drawing; with holes."""

    rectangle: Sides | None = None
    """Width and length. x from -width/2 to width/2, y from 0 to the length, as of all shapes.
    Example: `["100 mm", "200 mm"]`"""
    corner_radius: Size | None = None
    """Of a rectangle: its corners are arcs, the edges corner-1 (upper right) to corner-4,
    counter-clockwise. Example: `"20 mm"`"""
    circle: Size | None = None
    """Diameter; 240 corners, the edge rim. Example: `"300 mm"`"""
    ellipse: Sides | None = None
    """Width and length; the edge rim. Example: `["200 mm", "300 mm"]`"""
    slot: Sides | None = None
    """Width and length of a rectangle whose shorter sides are half circles, the edges arc-1 and
    arc-2. Example: `["40 mm", "120 mm"]`"""
    cross: Sides | None = None
    """Length from tip to tip, both ways, and width of the arms. Example: `["300 mm", "100 mm"]`"""
    arm_slits: Annotated[int, Field(ge=1, le=200)] | None = None
    """Of a cross: cuts along each arm, evenly, from its tip to where arms meet, so that the arms
    hardly take part in what crosses them. Yarns on a cut are cut away. Example: `4`"""
    polygon: Ring | None = None
    """Corners in order, in place of a rectangle. The body is pulled along y.
    Example: `[["0 mm", "0 mm"], ["80 mm", "0 mm"], ["80 mm", "90 mm"], ["0 mm", "90 mm"]]`"""
    file: Name | None = None
    """A drawing, DXF (ezdxf) or SVG (svgelements), relative to the case file's folder: the line
    around all others, those within it are holes. Layers of a DXF (not "0"), labels and ids of an
    SVG name edges. Example: `"blank.dxf"`"""
    unit: Annotated[Quantity, Of("m", column=True)] | None = None
    """Of the drawing's numbers; the default is its own. Example: `"mm"`"""
    holes: Rings = Field(default=[])
    """Corners of each hole. Example:
    `[[["20 mm", "30 mm"], ["40 mm", "30 mm"], ["30 mm", "50 mm"]]]`"""
    slits: Lines = Field(default=[])
    """Points of each cut, straight from one to the next; it may begin and end at the outline or
    beyond. Yarns that cross it are cut. Example: `[[["0 mm", "20 mm"], ["0 mm", "50 mm"]]]`"""
    darts: Rings = Field(default=[])
    """Corners of pieces that are cut out, at the outline mostly: triangles, notches. Example:
    `[[["-10 mm", "0 mm"], ["10 mm", "0 mm"], ["0 mm", "40 mm"]]]`"""
    _drawn: tuple[shapely.Polygon, dict[str, Any]] | None = PrivateAttr(default=None)

    @model_validator(mode="after")
    def _one_shape(self) -> OutlineTable:
        if sum(getattr(self, shape) is not None for shape in SHAPES) != 1:
            raise ValueError(f"needs exactly one of {', '.join(SHAPES[:-1])} and {SHAPES[-1]}")
        if self.corner_radius is not None:
            if self.rectangle is None:
                raise ValueError(".corner_radius is of a rectangle")
            most = 0.5 * min(si_values(self.rectangle))
            if self.corner_radius.si > most * (1.0 + _ROUNDING):
                raise ValueError(
                    f".corner_radius must be at most half the width and half the length, "
                    f'{format_si(most, "m")}, got "{self.corner_radius}"'
                )
        if self.arm_slits is not None and self.cross is None:
            raise ValueError(".arm_slits is of a cross")
        if self.cross is not None and self.cross[1].si >= self.cross[0].si:
            raise ValueError(
                f'.cross: arms must be narrower than the cross is long, "{self.cross[0]}", got '
                f'"{self.cross[1]}"'
            )
        if self.file is None:
            if self.unit is not None:
                raise ValueError(".unit is of a file's numbers, quantities have their own")
            return self
        try:  # once, where a case is read: of several ranks on the first
            outline, edges = read_drawing(self.file, self.unit.si if self.unit else None)
            self._drawn = outline, {name: pieces.tolist() for name, pieces in edges.items()}
        except InputError as error:
            raise ValueError(f".file: {error}") from None
        return self

    @property
    def drawn(self) -> str | None:
        """What the drawing showed when it was read, as text; None without one."""
        return None if self._drawn is None else str(self._drawn[0].wkt)

    def build(self) -> tuple[shapely.Polygon, dict[str, np.ndarray]]:
        """The outline, in metres, and edges that it names; `Preform` checks both."""
        holes, edges = _places(self.holes), {}
        if self._drawn is not None:
            outline, pieces = self._drawn
            edges = {name: np.array(piece) for name, piece in pieces.items()}
            holes += [shapely.get_coordinates(ring).tolist() for ring in outline.interiors]
            ring = shapely.get_coordinates(outline.exterior)
        elif self.polygon is not None:
            ring = np.array(_places([self.polygon])[0])
        elif self.slot is not None:
            ring, edges = _slot(*si_values(self.slot))
        elif self.cross is not None:
            ring = _cross(*si_values(self.cross))
        elif self.rectangle is not None:
            width, length = si_values(self.rectangle)
            if self.corner_radius is None:
                x = 0.5 * width
                ring = np.array([[-x, 0.0], [x, 0.0], [x, length], [-x, length]])
            else:
                ring, arcs = rings.rounded(width, length, self.corner_radius.si)
                edges = {f"corner-{i + 1}": arc for i, arc in enumerate(arcs)}
        else:
            round_ = [self.circle, self.circle] if self.ellipse is None else self.ellipse
            ring = rings.ellipse(*(size.si for size in round_ if size is not None))
            edges = {"rim": np.stack([ring, np.roll(ring, -1, axis=0)], axis=1)}
        slits = _places(self.slits)
        if self.cross is not None and self.arm_slits is not None:
            length, width = si_values(self.cross)
            slits += _arm_slits(length, width, self.arm_slits)
        whole, cuts = shapely.Polygon(ring, holes), (slits, _places(self.darts))
        if not any(cuts):
            return whole, edges
        cut = _cut_out(whole, *cuts)
        return cut, _left_of(edges, cut)


SHAPES = ("rectangle", "circle", "ellipse", "slot", "cross", "polygon", "file")


def _cross(length: float, width: float) -> np.ndarray:
    """Corners (12, 2) of a cross with equal arms, x about 0, y from 0, anticlockwise."""
    tip, side = 0.5 * length, 0.5 * width
    arm = np.array([[side, -side], [tip, -side], [tip, side]])  # to the right; the others by turns
    turns = [np.array([[c, -s], [s, c]]) for c, s in ((1, 0), (0, 1), (-1, 0), (0, -1))]
    ring = np.concatenate([arm @ turn.T for turn in turns])
    return ring + np.array([0.0, tip])


def _arm_slits(length: float, width: float, count: int) -> list[list[list[float]]]:
    """Cuts along a cross's arms, from beyond their tips to where they meet."""
    tip, side = 0.5 * length, 0.5 * width
    slits = []
    for k in range(1, count + 1):
        at = -side + width * k / (count + 1)
        for sign in (-1.0, 1.0):
            slits.append([[sign * 1.1 * tip, at + tip], [sign * side, at + tip]])
            slits.append([[at, tip + sign * 1.1 * tip], [at, tip + sign * side]])
    return slits


def _slot(width: float, length: float) -> tuple[np.ndarray, dict[str, np.ndarray]]:
    """Half circles at the shorter sides, each of two quarters."""
    ring, arcs = rings.rounded(width, length, 0.5 * min(width, length))
    halves = [(0, 1), (2, 3)] if length >= width else [(1, 2), (3, 0)]
    return ring, {
        f"arc-{i + 1}": np.concatenate([arcs[one], arcs[other]])
        for i, (one, other) in enumerate(halves)
    }


Names = Annotated[list[Name], Field(min_length=1, max_length=1000)]


class EdgeTable(Table):
    """[preform.edges]: an edge by a name of one's own."""

    of: Names | None = None
    """Edges that are there, together. Example: `["outline-3", "outline-4"]`"""
    start: Point | None = None
    """Or a point of the outline, or of a hole, from which the edge goes. Example:
    `["0 mm", "0 mm"]`"""
    end: Point | None = None
    """To which it goes, the cloth on its left: counter-clockwise around the outline. Example:
    `["80 mm", "0 mm"]`"""

    @model_validator(mode="after")
    def _one_way(self) -> EdgeTable:
        if (self.of is None) == (self.start is None) or (self.start is None) != (self.end is None):
            raise ValueError("needs either of, or start and end")
        return self

    def build(self, preform: Preform, key: str) -> np.ndarray:
        """Segments on the preform, float (n, 2, 2) [m]; ``key``: for an InputError."""
        if self.of is not None:
            try:
                return np.concatenate([preform.edge(name) for name in self.of])
            except InputError as error:
                raise InputError(f"{key}.of: {error}") from None
        outline, near = preform.outline, _NEAR * float(preform.size.max())
        ends = [shapely.Point(si_values(point)) for point in (self.start, self.end) if point]
        lines = [outline.exterior, *outline.interiors]
        line = lines[int(np.argmin([ring.distance(ends[0]) for ring in lines]))]
        for name, end in zip(("start", "end"), ends, strict=True):
            if line.distance(end) > near:
                raise InputError(
                    f"{key}.{name} lies {format_si(line.distance(end), 'm')} off the line of the "
                    f"outline{'' if name == 'start' else ' on which start is'}"
                )
        first, last = (line.project(end) for end in ends)
        if abs(last - first) <= near:
            raise InputError(f"{key} has no length, its start and end are one point")
        parts = [(first, last)] if first < last else [(first, line.length), (0.0, last)]
        segments = []
        for one, other in parts:
            if other > one:
                xy = shapely.get_coordinates(substring(line, one, other))
                segments.append(np.stack([xy[:-1], xy[1:]], axis=1))
        return np.concatenate(segments)


def _left_of(edges: dict[str, np.ndarray], cut: shapely.Polygon) -> dict[str, np.ndarray]:
    """Segments that still bound the cloth where something was cut out of it."""
    boundary = cut.boundary.buffer(_ROUNDING * np.ptp(cut.bounds[::2]))
    there = {n: e[shapely.covers(boundary, shapely.linestrings(e))] for n, e in edges.items()}
    return {name: segments for name, segments in there.items() if len(segments)}


def _places(paths: Sequence[Sequence[Sequence[Quantity]]]) -> list[list[list[float]]]:
    return [[si_values(list(point)) for point in path] for path in paths]


def _cut_out(whole: shapely.Polygon, slits: list, darts: list) -> shapely.Polygon:
    """A polygon without darts, and slit along lines: with gaps much narrower than a yarn."""
    _check_ring("preform.outline", whole)
    gap = _SLIT * np.ptp(np.reshape(whole.bounds, (2, 2)), axis=0).max()
    cuts = {}
    for i, path in enumerate(slits):
        line = shapely.LineString(path)
        if line.length <= gap or not line.is_simple:
            raise InputError(
                f"preform.outline.slits[{i}] "
                + ("crosses itself" if line.length > gap else "has no length")
            )
        cuts[f"slits[{i}]"] = line.buffer(0.5 * gap, cap_style="flat", join_style="mitre")
    for i, corners in enumerate(darts):
        cuts[f"darts[{i}]"] = shapely.Polygon(corners)
        _check_ring(f"preform.outline.darts[{i}]", cuts[f"darts[{i}]"])
    for name, cut in cuts.items():
        if not shapely.intersection(whole, cut).area > 0.0:
            raise InputError(f"preform.outline.{name} lies beside the cloth, it cuts nothing")
    left = whole.difference(shapely.union_all(list(cuts.values())))
    if not isinstance(left, shapely.Polygon) or left.is_empty:
        pieces = len(getattr(left, "geoms", [])) or "no"
        raise InputError(
            f"preform.outline.slits and darts leave {pieces} pieces of cloth, there must be one"
        )
    before = [shapely.Polygon(hole) for hole in whole.interiors]
    kept = [[k for k, b in enumerate(before) if b.equals(shapely.Polygon(hole))]
            for hole in left.interiors]  # fmt: skip
    order = sorted(range(len(kept)), key=lambda i: (not kept[i], kept[i], i))
    return shapely.Polygon(left.exterior, [left.interiors[i] for i in order])


class LatticeTable(Table):
    """[preform] without its outline: where the yarns run."""

    bias_angle: Annotated[Quantity, Of("rad")]
    """From the pull (y) to the warp."""
    refine: Count = 1
    """A finer net of the same fabric: pitch divided by this."""
    yarns_per_cruciform: Count = 1
    """A coarser net: pitch times this. Not together with refine."""
    origin: Point | None = None
    """A crossover's place. The default is the centre of the outline's bounding box.
    Example: `["0 mm", "100 mm"]`"""

    @model_validator(mode="after")
    def _finer_or_coarser(self) -> Self:
        if self.refine > 1 and self.yarns_per_cruciform > 1:
            raise ValueError(
                f".refine = {self.refine} and preform.yarns_per_cruciform = "
                f"{self.yarns_per_cruciform} undo each other, leave one of them at 1"
            )
        return self


class PreformTable(LatticeTable):
    """[preform]: see `Preform`."""

    outline: OutlineTable
    """A shape or a drawing, with holes. Example: `{ rectangle = ["100 mm", "200 mm"] }`"""
    edges: dict[str, EdgeTable] | None = None
    """Edges by names of one's own. Example: `{ grip = { of = ["outline-3"] } }`"""

    @field_validator("edges")
    @classmethod
    def _names(cls, edges: dict[str, EdgeTable] | None) -> dict[str, EdgeTable] | None:
        for name in edges or ():
            if not re.fullmatch(r"[\w-]{1,50}", name):
                raise ValueError(f"has the name {shown(name)}, letters, digits, - and _ can be")
        return edges

    def build(self, refine: int | None = None) -> Preform:
        """Make the preform; `refine` replaces the table's."""
        outline, edges = self.outline.build()
        preform = Preform(
            outline,
            self.bias_angle,  # type: ignore[arg-type]
            refine=self.refine if refine is None else refine,
            yarns_per_cruciform=self.yarns_per_cruciform,
            origin=self.origin,  # type: ignore[arg-type]
            edges=edges,
        )
        for name, edge in (self.edges or {}).items():
            edges = edges | {name: edge.build(preform, f"preform.edges.{name}")}
        return replace(preform, edges=edges) if self.edges else preform
