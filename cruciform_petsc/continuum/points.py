# SPDX-License-Identifier: MIT
"""Values of finite element functions at points that may lie on any rank's part of the mesh."""

from __future__ import annotations

from collections.abc import Sequence

import dolfinx.fem
import dolfinx.geometry
import dolfinx.mesh
import numpy as np
from mpi4py import MPI

from ..errors import InputError
from ..parallel import ask

# A point belongs to every triangle that is as near as the nearest one, within this part of the
# mesh's diagonal; a point farther off than the padding belongs to none.
_SAME = 1e-10
PADDING = 1e-5
_CHUNK = 100_000


def evaluate(
    mesh: dolfinx.mesh.Mesh,
    functions: Sequence[dolfinx.fem.Function],
    points: np.ndarray,
    padding: float | None = None,
) -> list[np.ndarray]:
    """Evaluate functions at points. Collective; each rank asks for its own points, or for none.

    Points go to the ranks in whose bounding box they lie, are evaluated there and come back in the
    order asked; no rank gathers all of them. On an edge or a vertex of the mesh the result is the
    mean over the triangles that meet there, so that it does not depend on the partition, also for
    functions that jump. A point just outside takes the value of the nearest triangle.

    Parameters
    ----------
    mesh : dolfinx.mesh.Mesh
        Affine triangles in the plane.
    functions : sequence of dolfinx.fem.Function
        On this mesh, ghost values up to date.
    points : float (n, 2)
        Metres.
    padding : float, optional
        How far outside of the mesh a point may lie, in metres; 1e-5 of its diagonal by default.

    Returns
    -------
    list of float (n, value size), one for each function

    Raises
    ------
    InputError
        On every rank, if any point of any rank lies farther outside.
    """
    comm = mesh.comm
    points = np.ascontiguousarray(points, float).reshape(-1, 2)
    boxes, diagonal = _rank_boxes(mesh)
    padding = PADDING * diagonal if padding is None else padding
    tolerance = _SAME * diagonal

    rank, asked = _ranks_of_points(boxes, points, padding)
    answer = ask(
        comm,
        rank,
        points[asked],
        lambda places: _evaluate_here(mesh, functions, places, padding, tolerance),
    )
    # answer rows: distance, number of triangles, sum of values over them
    distance = np.full(len(points), np.inf)
    np.minimum.at(distance, asked, answer[:, 0])
    missing = ~(distance <= padding)
    _raise_if_missing(comm, points[missing], padding)
    nearest = answer[:, 0] <= distance[asked] + tolerance
    total = np.zeros((len(points), answer.shape[1] - 1))
    np.add.at(total, asked[nearest], answer[nearest, 1:])
    values = total[:, 1:] / total[:, :1]
    return np.split(values, np.cumsum([_value_size(f) for f in functions])[:-1], axis=1)


def _value_size(function: dolfinx.fem.Function) -> int:
    return int(np.prod(function.ufl_shape, initial=1))


def _rank_boxes(mesh: dolfinx.mesh.Mesh) -> tuple[np.ndarray, float]:
    """Bounding box of each rank's part, (ranks, 2, 2), empty as (inf, -inf), and the diagonal."""
    x = mesh.geometry.x[:, :2]
    mine = np.array([x.min(axis=0, initial=np.inf), x.max(axis=0, initial=-np.inf)])
    boxes = np.empty((mesh.comm.size, 2, 2))
    mesh.comm.Allgather(mine, boxes)
    return boxes, float(np.linalg.norm(boxes[:, 1].max(axis=0) - boxes[:, 0].min(axis=0)))


def _ranks_of_points(
    boxes: np.ndarray, points: np.ndarray, padding: float
) -> tuple[np.ndarray, np.ndarray]:
    """Ranks to ask, and the index of the point asked for."""
    asked = [
        np.flatnonzero(((points >= low - padding) & (points <= high + padding)).all(axis=1))
        for low, high in boxes
    ]
    return np.repeat(np.arange(len(boxes)), [len(a) for a in asked]), np.concatenate(asked)


def _evaluate_here(
    mesh: dolfinx.mesh.Mesh,
    functions: Sequence[dolfinx.fem.Function],
    points: np.ndarray,
    padding: float,
    tolerance: float,
) -> np.ndarray:
    """Rows (distance, number of nearest owned triangles, sums of the values over them)."""
    sizes = [_value_size(f) for f in functions]
    result = np.zeros((len(points), 2 + sum(sizes)))
    result[:, 0] = np.inf
    number_owned = mesh.topology.index_map(2).size_local
    if number_owned == 0:
        return result
    tree = dolfinx.geometry.bb_tree(
        mesh, 2, entities=np.arange(number_owned, dtype=np.int32), padding=padding
    )
    corners = mesh.geometry.x[:, :2]
    for start in range(0, len(points), _CHUNK):
        part = points[start : start + _CHUNK]
        part_3d = np.column_stack([part, np.zeros(len(part))])
        candidates = dolfinx.geometry.compute_collisions_points(tree, part_3d)
        cell = candidates.array
        point = np.repeat(np.arange(len(part)), np.diff(candidates.offsets))
        distance = triangle_distance(part[point], corners[mesh.geometry.dofmap[cell]])
        least = np.full(len(part), np.inf)
        np.minimum.at(least, point, distance)
        near = distance <= least[point] + tolerance
        cell, point = cell[near], point[near]
        rows = result[start : start + _CHUNK]
        rows[:, 0] = least
        rows[:, 1] = np.bincount(point, minlength=len(part))
        if len(cell) == 0:
            continue
        column = 2
        for function, size in zip(functions, sizes, strict=True):
            value = np.reshape(function.eval(part_3d[point], cell), (len(cell), size))
            np.add.at(rows[:, column : column + size], point, value)
            column += size
    return result


def triangle_distance(points: np.ndarray, corners: np.ndarray) -> np.ndarray:
    """Distance of points from triangles, 0 inside.

    Parameters
    ----------
    points : float (n, 2)
    corners : float (n, 3, 2)

    Returns
    -------
    float (n,)
    """
    edge = np.roll(corners, -1, axis=1) - corners
    to_point = points[:, None] - corners
    along = np.clip((edge * to_point).sum(-1) / (edge * edge).sum(-1), 0.0, 1.0)
    distance = np.linalg.norm(to_point - along[..., None] * edge, axis=-1).min(axis=1)
    side = edge[..., 0] * to_point[..., 1] - edge[..., 1] * to_point[..., 0]
    inside = (side >= 0).all(axis=1) | (side <= 0).all(axis=1)
    return np.where(inside, 0.0, distance)


def _raise_if_missing(comm: MPI.Intracomm, missing: np.ndarray, padding: float) -> None:
    number = comm.allreduce(len(missing))
    if number:
        first = comm.allreduce(
            tuple(missing[0].tolist()) if len(missing) else (np.inf, np.inf), MPI.MIN
        )
        raise InputError(
            f"{number} points lie outside of the mesh by more than {padding:.3g} m, "
            f"for example ({first[0]:.6g}, {first[1]:.6g}) m"
        )
