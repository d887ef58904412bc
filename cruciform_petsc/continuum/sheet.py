# SPDX-License-Identifier: MIT
"""A hyperelastic membrane in space: cloth of no bending rigidity, to be laid among tools.

Its energy is that of fibres.py without bending, here with F = grad x of positions x in space. The
laws, which act on scalars, are worked out by NumPy; forms compiled by dolfinx do the rest, as in
balance.py. Triangles are linear and have two edges along the yarns: others could not shear without
stretching yarns, and would lock. Forces and matrices of triangles are those of a space of functions
that jump between them, in which no two triangles share an unknown.
"""

from __future__ import annotations

from typing import Any

import dolfinx.fem
import dolfinx.la
import dolfinx.mesh
import numpy as np
import shapely
import ufl
from petsc4py import PETSc

from ..elements.level import FORCE, STIFFNESS, room
from ..forming.blank import Blank
from ..items.item import Item, Placed, Work
from ..items.loads import facets
from ..net.network import Network
from ..parallel import DistributedNodes, most
from .fibres import fibre_measures, resultants
from .mesh import yarn_mesh
from .points import evaluate

SAME = 1e-9  # of the outline's size: how far off an edge its nodes may lie


class Stretching(Item):
    """Triangles of a membrane in space that stretch and shear.

    Parameters
    ----------
    mesh : dolfinx.mesh.Mesh
        Of triangles in the plane, at rest; collective.
    nodes : int32 (m, 3)
        Local nodes of the triangles that this rank owns.
    directions : float (2, 2)
        Of warp and weft at rest.
    fabric : Fabric

    Attributes
    ----------
    area : float (m,)
        At rest, m^2.
    """

    name = "membrane"
    modes = ("tension", "shear")

    def __init__(self, mesh: dolfinx.mesh.Mesh, nodes: np.ndarray, directions, fabric):
        self.mesh, self.nodes, self.fabric = mesh, nodes, fabric
        self._cells = np.arange(len(nodes), dtype=np.int32)
        space = dolfinx.fem.functionspace(mesh, ("DG", 1, (3,)))
        self._place, self._stress, self._moduli = (
            dolfinx.fem.Function(dolfinx.fem.functionspace(mesh, ("DG", degree, (size,))))
            for degree, size in ((1, 3), (0, 3), (0, 4))
        )
        assert np.array_equal(space.dofmap.list[: len(nodes)].ravel(), np.arange(nodes.size))
        v, dx = ufl.TestFunction(space), ufl.TrialFunction(space)
        x, s, c = self._place, self._stress, self._moduli
        along = (dolfinx.fem.Constant(mesh, np.asarray(d, PETSc.ScalarType)) for d in directions)
        q = fibre_measures(*(ufl.grad(x) * d for d in along))
        dq, q_dx = ufl.derivative(q, x, v), ufl.derivative(q, x, dx)
        moduli = ufl.as_matrix([[c[0], c[3], 0], [c[3], c[1], 0], [0, 0, c[2]]])
        tangent = ufl.dot(dq, moduli * q_dx) + ufl.dot(s, ufl.derivative(dq, x, dx))
        measure = ufl.dx(domain=mesh, metadata={"quadrature_degree": 0})
        self._force = dolfinx.fem.form(ufl.dot(s, dq) * measure)
        self._tangent = dolfinx.fem.form(tangent * measure)
        self._measures = dolfinx.fem.Expression(q, np.array([[1 / 3, 1 / 3]]))
        corners = mesh.geometry.x[mesh.geometry.dofmap[: len(nodes)]][..., :2]
        self.area = 0.5 * abs(np.linalg.det(np.diff(corners, axis=1)))

    def chunks(self):
        """See Item.chunks: dolfinx works on all triangles at once."""
        yield slice(None)

    def measures(self, state: Placed) -> np.ndarray:
        """Stretches of warp and weft, and shear angle, of the triangles, (m, 3)."""
        if not len(self.nodes):
            return np.zeros((0, 3))
        self._place.x.array[:] = state.x[self.nodes].ravel()
        return np.reshape(self._measures.eval(self.mesh, self._cells), (-1, 3))

    def work(self, state: Placed, level: int, rows=slice(None), before=None) -> Work:
        """See Item.work."""
        with np.errstate(all="ignore"):  # Newton goes no way that leads to no number
            per_area, stress, moduli = resultants(self.fabric, self.measures(state))
        energy, force, stiffness = room(len(self.nodes), 2, 3, 3, level)
        energy[:] = self.area[:, None] * per_area
        self._stress.x.array[:] = stress.ravel()
        self._moduli.x.array[:] = moduli.ravel()
        if level >= FORCE:
            force[:] = dolfinx.fem.assemble_vector(self._force).array.reshape(force.shape)
        if level >= STIFFNESS:
            whole = dolfinx.la.BlockMode.expanded
            matrix = dolfinx.fem.assemble_matrix(self._tangent, block_mode=whole)
            stiffness[:] = matrix.data.reshape(stiffness.shape)
        return energy[rows], force[rows], stiffness[rows]


class Sheet:
    """A membrane in place of a Ply, for Blank. Collective.

    Parameters
    ----------
    network : Network
        Whose cloth it is, and at whose crossovers and nodes `displacement` and `fields` are.
    size : float
        Of its triangles, m.

    Raises
    ------
    InputError
        On every rank, where the outline does not run along yarns.
    """

    dim = 3

    def __init__(self, network: Network, size: float):
        self.network, self.comm = network, network.comm
        self.mesh = yarn_mesh(network, size)
        self._space = dolfinx.fem.functionspace(self.mesh, ("Lagrange", 1, (3,)))
        self._constant = dolfinx.fem.functionspace(self.mesh, ("DG", 0))
        owner = self._space.dofmap.index_map
        own = np.arange(*owner.local_range)
        self.nodes: Any = DistributedNodes(self.comm, own, owner.ghosts, owner.owners)
        # dolfinx's local numbers -> those of `nodes`, whose ghosts ascend
        self._number = self.nodes.find(np.append(own, owner.ghosts))
        count = self.nodes.num_nodes_local
        self.nodes.rest = np.zeros((count, 3))
        place = self._space.tabulate_dof_coordinates()[: len(self._number), :2]
        self.nodes.rest[self._number, :2] = place
        self.nodes.frame = np.tile(np.eye(3), (count, 1, 1))
        self.nodes.frame[:, :2, :2] = network.to_lab(np.eye(2))
        self.active, self.fixed = np.ones(count, bool), np.zeros((count, 3), bool)
        self.cells = self.mesh.topology.index_map(2).size_local
        triangles = self._number[self._space.dofmap.list[: self.cells]].astype(np.int32)
        self.stretching = Stretching(
            self.mesh, triangles, network.to_lab(np.eye(2)), network.fabric
        )
        self.further: list[Item] = []
        self.loads = None  # of edges
        self._planes: list[shapely.MultiLineString] = []

    @property
    def items(self) -> list[Item]:
        """What adds to equilibrium."""
        return [self.stretching, *self.further]

    def prescribed(self, motions: list) -> tuple[np.ndarray, np.ndarray]:
        """See PlyNodes.prescribed; no edge moves."""
        return self.nodes.rest, np.zeros((0, 3, 3))

    def symmetry(self, edge: str) -> None:
        """See Constraints.symmetry: nodes of an edge stay in the upright plane through it."""
        segments = self.network.preform.edge(edge)
        self._planes.append(shapely.multilinestrings(segments))
        along = abs(self.network.to_yarn(segments[0, 1] - segments[0, 0]))
        on = self._on(self._planes[-1], self.nodes.rest[:, :2])
        self.fixed[on, along.argmin()] = True

    def _on(self, line: shapely.MultiLineString, points: np.ndarray) -> np.ndarray:
        """Which of some points (n, 2) lie on a line."""
        near = SAME * self.network.preform.size.max()
        return shapely.distance(line, shapely.points(points)) <= near

    def areas(self, at_hinge: float = 0.0) -> np.ndarray:
        """Area at rest that each node stands for, (n_local,), m^2. Collective.

        A quarter of each rectangle between yarns: half a triangle at its right angle.
        """
        triangles = self.stretching.nodes
        corner = self.nodes.rest[triangles]
        sides = (np.roll(corner, -1, axis=1) - corner, np.roll(corner, 1, axis=1) - corner)
        square = abs((sides[0] * sides[1]).sum(axis=2)).argmin(axis=1)
        share = np.full(triangles.shape, 0.25)
        share[np.arange(len(share)), square] = 0.5
        area = np.zeros(self.nodes.num_nodes_local)
        np.add.at(area, triangles, share * self.stretching.area[:, None])
        return self.nodes.halo.share(area)

    # -- results --------------------------------------------------------------------------------

    def dissipated(self, state: Placed) -> dict[str, float]:
        """Nothing: see Ply.dissipated."""
        return {}

    def shear_angle_max(self, state: Placed) -> float:
        """Largest shear angle of a triangle, radians. Collective."""
        return most(self.comm, abs(self.stretching.measures(state)[:, 2]), 0.0)

    def at(self, state: Placed, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Displacement (n, 3) and shear angle (n,) at points (n, 2) at rest. Collective.

        Each rank asks for its own. The angle is the mean over triangles that meet there: none in a
        plane of symmetry, beyond which it is the opposite.
        """
        moved, shear = (dolfinx.fem.Function(space) for space in (self._space, self._constant))
        moved.x.array[:] = (state.x - self.nodes.rest)[self._number].ravel()
        shear.x.array[:] = self.stretching.measures(state)[:, 2]
        displacement, angle = evaluate(self.mesh, [moved, shear], points)
        for plane in self._planes:
            angle[self._on(plane, points)] = 0.0
        return displacement, angle[:, 0]

    def displacement(self, state: Placed) -> tuple[np.ndarray, np.ndarray]:
        """Displacements (., 3) at this rank's crossovers and at the network's nodes. Collective."""
        network = self.network
        points = np.concatenate([network.crossover_position, network.node_position])
        moved = self.at(state, points)[0]
        return moved[: network.num_crossovers_owned], moved[network.num_crossovers_owned :]


@facets.register
def _(sheet: Sheet) -> tuple[np.ndarray, np.ndarray]:
    """See facets: the membrane's own triangles."""
    triangles = sheet.stretching.nodes
    side = np.diff(sheet.nodes.rest[triangles][..., :2], axis=1)
    clockwise = np.linalg.det(side) < 0.0
    turned = np.where(clockwise[:, None], triangles[:, ::-1], triangles)
    return turned, np.ones(len(turned))


class MembraneBlank(Blank):
    """A blank whose cloth is a membrane with triangles of a size in m. Collective."""

    def __init__(self, network: Network, tools, size: float, **options: Any):
        self.size = size
        super().__init__(network, tools, **options)

    def _lay(self, bending):
        sheet = Sheet(self.network, self.size)
        for edge in self.symmetry:
            sheet.symmetry(edge)
        return sheet

    @property
    def pitch(self) -> float:
        """See Blank.pitch."""
        return self.size
