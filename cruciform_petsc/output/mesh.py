# SPDX-License-Identifier: MIT
"""The cloth as a mesh for other programs, dealt out over ranks in one order; lengths in mm."""

from __future__ import annotations

from dataclasses import dataclass
from textwrap import shorten
from typing import TYPE_CHECKING

import numpy as np

from .. import __version__
from ..cloth.fabric import Fabric
from ..forming.measures import across
from ..net.network import Network
from .cells import lattice_cells, thickening
from .provenance import commit
from .tables import in_order

if TYPE_CHECKING:
    from mpi4py import MPI


@dataclass(frozen=True)
class Mesh:
    """Nodes at crossovers, shells between them; those of this rank.

    Attributes
    ----------
    comm : mpi4py communicator
    fabric : Fabric
    heading : str
        What it is, one line of ASCII.
    hold : str
        What stays as it is while the cloth deforms, see exports.export.
    node : int64 (n,), ascending
        The crossover's number plus 1.
    place, normal : float (n, 3)
        mm, and unit vectors.
    node_area_ratio, shear_deg : float (n,)
        At nodes: area now over area at rest, and the shear angle.
    element : int64 (m,), ascending
    corner : int64 (m, 4)
        Nodes, anticlockwise from the one that comes first along both yarns; 0 where there is none.
    centre : float (m, 3)
        Mean of the corners, mm.
    warp, weft : float (m, 3)
        Unit vectors along the yarns.
    area_ratio, zone : float (m,)
    """

    comm: MPI.Intracomm
    fabric: Fabric
    heading: str
    hold: str
    node: np.ndarray
    place: np.ndarray
    normal: np.ndarray
    node_area_ratio: np.ndarray
    shear_deg: np.ndarray
    element: np.ndarray
    corner: np.ndarray
    centre: np.ndarray
    warp: np.ndarray
    weft: np.ndarray
    area_ratio: np.ndarray
    zone: np.ndarray

    @property
    def across(self) -> np.ndarray:
        """Unit normals of elements, (m, 3): warp times weft."""
        return across(self.warp, self.weft)

    def with_corners(self, count: int) -> tuple[np.ndarray, np.ndarray]:
        """Which elements (m,) have so many corners, and these, (., count)."""
        chosen = (self.corner > 0).sum(axis=1) == count
        return chosen, self.corner[chosen][self.corner[chosen] > 0].reshape(-1, count)

    def fraction(self, area_ratio: np.ndarray) -> np.ndarray:
        """Fibre volume fraction where the area is so much that at rest, NaN if it is not known."""
        fraction = self.fabric.fibre_volume_fraction
        rest = np.nan if fraction is None else fraction
        return rest / (area_ratio * thickening(area_ratio, self.hold))


def mesh_of(
    network: Network,
    kind: str,
    what: str,
    hold: str,
    place: np.ndarray,
    normal: np.ndarray,
    carrying: np.ndarray,
    shear_deg: np.ndarray,
    area_ratio: np.ndarray,
    zone: np.ndarray | None = None,
) -> Mesh:
    """Make the mesh of this rank's crossovers (n_owned, ...). Collective.

    ``place`` (n_owned, 2 or 3), m; ``kind`` of test; ``what`` tells which state.
    """
    comm, total = network.comm, network.num_crossovers_global
    cells = lattice_cells(network, place, carrying, zone)

    def spatial(vectors: np.ndarray) -> np.ndarray:
        return np.pad(vectors, ((0, 0), (0, 3 - vectors.shape[1])))

    yarns = [spatial(cells.warp), spatial(cells.weft)]
    there = (cells.corner >= 0)[..., None]
    centre = spatial((cells.place * there).sum(axis=1) / there.sum(axis=1))
    rows = np.column_stack([cells.corner, 1e3 * centre, *yarns, cells.area_ratio, cells.zone])
    key, rows = in_order(comm, cells.key, 2 * total, rows)
    corner, centre, warp, weft, ratio, zones = np.split(rows, [4, 7, 10, 13, 14], axis=1)
    nodes = np.column_stack([1e3 * spatial(place), spatial(normal), area_ratio, shear_deg])
    number, nodes = in_order(comm, network.crossover_number_global, total, nodes)
    # A title is anything that people write; it must stay one line, of letters that all know.
    title = shorten(network.fabric.name, 100).encode("ascii", "replace").decode()
    heading = f"cruciform_petsc {__version__}, commit {commit() or 'unknown'}, {kind}"
    return Mesh(
        comm=comm,
        fabric=network.fabric,
        heading=f"{heading}\n{title}, {what}",
        hold=hold,
        node=number + 1,
        place=nodes[:, :3],
        normal=nodes[:, 3:6],
        node_area_ratio=nodes[:, 6],
        shear_deg=nodes[:, 7],
        element=(comm.exscan(len(key)) or 0) + np.arange(len(key)) + 1,
        corner=corner.astype(np.int64) + 1,
        centre=centre,
        warp=warp,
        weft=weft,
        area_ratio=ratio[:, 0],
        zone=zones[:, 0],
    )
