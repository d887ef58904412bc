# SPDX-License-Identifier: MIT
"""The two yarns that a fishnet is laid from: through a seed, straight, in planes or along lines."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import shapely

from ..errors import InputError
from ..quantities import length
from ..tools.surface import touch
from ..tools.tool import Tool
from .fishnet import march, unit, walk

STEEP = 0.05  # of a normal along z: beyond, a place in plan is no place on the tool
FINE = 64  # points of a line to a link
DROPS = 2000  # steps of points that fall onto a tool
FLAT = 1e-9  # of a tool's size: how near a point comes to where it falls


@dataclass(frozen=True)
class Seed:
    """Where a fishnet begins on a tool, and how its two generators go from there.

    Attributes
    ----------
    tool : Tool
        Where it starts, with its place.
    below : bool
        Whether it lies below the cloth.
    gap : float
        Of the cloth's middle from its surface, m.
    place : float (2,)
        In plan, m.
    heading : float
        Of the warp there, in plan, from x towards y, rad.
    between : float
        From warp to weft on the surface, rad.
    upright : bool
        Generators lie in upright planes; else they are geodesics.
    lines : pair of float (n, 2) or None
        Of warp and weft: a line in plan that they follow instead, m.
    """

    tool: Tool
    below: bool
    gap: float
    place: np.ndarray
    heading: float
    between: float = 0.5 * math.pi
    upright: bool = False
    lines: tuple[np.ndarray | None, np.ndarray | None] = (None, None)

    @property
    def upward(self) -> np.ndarray:
        """+z in the tool's frame."""
        return self.tool.start.vector_to_tool(np.array([0.0, 0.0, 1.0]))

    def on_tool(self) -> np.ndarray:
        """The place on the tool, in its frame, (3,), m; InputError if there is none."""
        tool, way = self.tool, -self.upward if self.below else self.upward
        there = tool.start.to_tool(np.append(self.place, 0.0))
        met = touch(tool.surface, there, way, self.gap)
        x, y = map(length, self.place)
        if met is None:
            raise InputError(f'tool "{tool.name}" is not met at x = {x}, y = {y}')
        point = there + met[0] * way
        if abs(float(tool.surface.look(point[None])[1][0] @ self.upward)) < STEEP:
            raise InputError(f'tool "{tool.name}" is too steep at x = {x}, y = {y}')
        return point

    def directions(self, point: np.ndarray) -> np.ndarray:
        """Of warp and weft, unit vectors in the tool's frame, (2, 3)."""
        normal, up = unit(self.tool.surface.look(point[None])[1][0]), self.upward
        plan = np.array([math.cos(self.heading), math.sin(self.heading), 0.0])
        warp = self.tool.start.vector_to_tool(plan)
        warp = unit(warp - (warp @ normal) / (up @ normal) * up)
        across = np.cross(normal if self.below else -normal, warp)
        return np.array([warp, math.cos(self.between) * warp + math.sin(self.between) * across])

    def generators(self, link: np.ndarray, counts: Sequence[int]) -> list[np.ndarray]:
        """Joints along warp and weft, and back along both: four float (n, 3) in the tool's frame.

        ``counts`` of them at most, besides the seed, with which each begins; ``link`` (2,), m.
        Raises InputError as of `on_tool`, or if a line does not lead through the place.
        """
        point = self.on_tool()
        forward = self.directions(point)
        lines: list[np.ndarray] = march(
            self.tool.surface,
            self.gap,
            point,
            np.concatenate([forward, -forward]),
            np.tile(link, 2),
            [0 if self.lines[k % 2] is not None else count for k, count in enumerate(counts)],
            self.upward if self.upright else None,
        )
        for k, count in enumerate(counts):
            if self.lines[k % 2] is not None:
                lines[k] = self._along(k, float(link[k % 2]), count, point)
        return lines

    def _along(self, k: int, link: float, count: int, point: np.ndarray) -> np.ndarray:
        """One half of the generator that follows a line in plan."""
        given = self.lines[k % 2]
        assert given is not None
        name, here = ("warp_line", "weft_line")[k % 2], shapely.Point(*self.place)
        apart = np.linalg.norm(np.diff(given, axis=0), axis=1) > 1e-6 * link
        corners = given[np.append(True, apart)]
        if len(corners) < 2:
            raise InputError(f"{name} is a point, and has no direction")
        line = shapely.LineString(corners)
        if line.distance(here) > link:
            x, y = map(length, self.place)
            raise InputError(
                f"{name} does not lead through the place "
                f"x = {x}, y = {y}, where the cloth is laid first: it is "
                f"{length(line.distance(here))} off"
            )
        at = line.project(here)
        coords = np.asarray(line.coords)
        along = np.append(0.0, np.cumsum(np.linalg.norm(np.diff(coords, axis=0), axis=1)))
        near = 1e-6 * link
        sides = coords[along > at + near], coords[along < at - near][::-1]
        ahead, behind = sides if k < 2 else sides[::-1]
        if not len(ahead):  # it ends here, and goes on straight
            ahead = 2.0 * self.place - behind[:1]
        if not len(ahead):
            raise InputError(
                f"{('warp_line', 'weft_line')[k % 2]} is a point, and has no direction"
            )
        points = np.concatenate([self.place[None], ahead])
        far = points[-1] + count * link * unit(points[-1] - points[-2])  # it goes on straight
        points = np.concatenate([points, far[None]])
        plan = shapely.get_coordinates(shapely.segmentize(shapely.LineString(points), link / FINE))
        dropped = self._dropped(np.pad(plan, ((0, 0), (0, 1))))
        dropped[0] = point
        end = np.flatnonzero(np.isnan(dropped[:, 0]))
        joints = walk(dropped[: end[0] if len(end) else None], link, count)
        for _ in range(3):  # chords between points lie a little off
            distance, normal, _curvature = self.tool.surface.look(joints[1:])
            joints[1:] -= (distance - self.gap)[:, None] * normal
        return joints

    def _dropped(self, points: np.ndarray) -> np.ndarray:
        """Points (n, 3) of the lab where they fall on the tool, in its frame; else NaN."""
        surface, way = self.tool.surface, -self.upward if self.below else self.upward
        low, high = surface.box
        size, middle = float(np.linalg.norm(high - low)), 0.5 * (low + high)
        points = self.tool.start.to_tool(points)
        points += ((middle - points) @ way - size - self.gap)[:, None] * way
        gone, left = np.zeros(len(points)), np.arange(len(points))
        for _ in range(DROPS):
            distance = surface.look(points[left])[0] - self.gap
            points[left] += distance[:, None] * way
            gone[left] += distance
            left = left[(abs(distance) > FLAT * size) & (gone[left] < 3.0 * size)]
            if not len(left):
                break
        points[left] = np.nan
        points[gone >= 3.0 * size] = np.nan
        return points

    def turned(self, place: np.ndarray, heading: float, between: float) -> Seed:
        """The same at another place, and other directions."""
        return replace(self, place=np.asarray(place, float), heading=heading, between=between)
