# SPDX-License-Identifier: MIT
"""Values of finite element functions at points that may lie on any rank's part of the mesh."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial

import dolfinx.fem
import dolfinx.mesh
import numpy as np
import shapely

from ..errors import InputError
from ..parallel import ask

# A point belongs to every triangle that is as near as the nearest one, within this part of the
# mesh's diagonal; a point farther off than the padding belongs to none.
SAME = 1e-10
PADDING = 1e-5


def evaluate(
    mesh: dolfinx.mesh.Mesh, functions: Sequence[dolfinx.fem.Function], points: np.ndarray
) -> list[np.ndarray]:
    """Evaluate functions at points. Collective; each rank asks for its own points, or for none.

    Points go to the ranks in whose bounding box they lie; no rank gathers all of them. On an edge
    or a vertex of the mesh the result is the mean over the triangles that meet there, so that it
    does not depend on the partition, also for functions that jump. A point just outside takes the
    value of the nearest triangle.

    Parameters
    ----------
    mesh : dolfinx.mesh.Mesh
        Affine triangles in the plane.
    functions : sequence of dolfinx.fem.Function
        On this mesh, ghost values up to date.
    points : float (n, 2)
        Metres.

    Returns float (n, value size) for each function; raises InputError on every rank if a point of
    any rank lies outside by more than 1e-5 of the diagonal.
    """
    points = np.reshape(np.asarray(points, float), (-1, 2))
    x = mesh.geometry.x[:, :2]
    box = [x.min(axis=0, initial=np.inf), x.max(axis=0, initial=-np.inf)]
    low, high = np.swapaxes(mesh.comm.allgather(box), 0, 1)  # (ranks, 2) each
    diagonal = float(np.linalg.norm(high.max(axis=0) - low.min(axis=0)))
    padding, tolerance = PADDING * diagonal, SAME * diagonal

    near = (points[:, None] >= low - padding) & (points[:, None] <= high + padding)
    point, rank = np.nonzero(near.all(axis=2))
    here = partial(_evaluate_here, mesh, functions, padding, tolerance)
    answers = ask(mesh.comm, rank, points[point], here)
    distance = np.full(len(points), np.inf)
    np.minimum.at(distance, point, answers[:, 0])
    _raise_if_outside(mesh.comm, points[~(distance <= padding)], padding)
    nearest = answers[:, 0] <= distance[point] + tolerance
    total = np.zeros((len(points), answers.shape[1] - 1))
    np.add.at(total, point[nearest], answers[nearest, 1:])
    values = total[:, 1:] / total[:, :1]
    return np.split(values, np.cumsum([_value_size(f) for f in functions])[:-1], axis=1)


def _value_size(function: dolfinx.fem.Function) -> int:
    return int(np.prod(function.ufl_shape, initial=1))


def _evaluate_here(mesh, functions, padding: float, tolerance: float, points) -> np.ndarray:
    """Rows (distance, number of this rank's nearest triangles, sums of the values over them)."""
    owned = mesh.topology.index_map(2).size_local
    triangles = shapely.polygons(mesh.geometry.x[mesh.geometry.dofmap[:owned], :2])
    where = shapely.points(points)
    point, cell = shapely.STRtree(triangles).query(where, "dwithin", padding)
    distance = shapely.distance(where[point], triangles[cell])
    rows = np.zeros((len(points), 2 + sum(_value_size(f) for f in functions)))
    rows[:, 0] = np.inf
    np.minimum.at(rows[:, 0], point, distance)
    nearest = distance <= rows[point, 0] + tolerance
    point, cell = point[nearest], cell[nearest].astype(np.int32)
    rows[:, 1] = np.bincount(point, minlength=len(points))
    if len(cell):
        x = np.column_stack([points[point], np.zeros(len(point))])
        values = [np.reshape(f.eval(x, cell), (len(cell), -1)) for f in functions]
        np.add.at(rows[:, 2:], point, np.hstack(values))
    return rows


def _raise_if_outside(comm, outside: np.ndarray, padding: float) -> None:
    number = comm.allreduce(len(outside))
    if number:
        x, y = min(comm.allgather(tuple(outside[0]) if len(outside) else (np.inf, np.inf)))
        raise InputError(
            f"{number} points lie outside of the mesh by more than {padding:.3g} m, "
            f"for example ({x:.6g}, {y:.6g}) m"
        )
