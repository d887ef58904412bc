# SPDX-License-Identifier: MIT
"""Cloth among tools for tests: soft strips, grips that pull them, plates, a small hemisphere."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from mpi4py import MPI

from cruciform_petsc.cloth.fabric import Fabric
from cruciform_petsc.cloth.preform import Preform
from cruciform_petsc.forming.blank import Blank, ContactSettings
from cruciform_petsc.forming.forming import form
from cruciform_petsc.forming.press import StagePlan
from cruciform_petsc.items.loads import DeadLoads
from cruciform_petsc.net.network import Network
from cruciform_petsc.tools import shapes
from cruciform_petsc.tools.motion import Motion, Pose
from cruciform_petsc.tools.tool import Tool

THICKNESS = 1e-3
HARD = ContactSettings(2e7, 2e-4, 1e-5, 20.0)
OVER = np.diag([1.0, -1.0, -1.0])  # turns a tool that looks up upside down


def cloth(
    modulus="520 N/cm", bending="1e-4 N mm", shear="50 N/m", yarn_bending="0.001 N mm^2", **further
) -> Fabric:
    """A cloth of one kind of yarns, 2.4 to the centimetre; ``bending``: of one or both families."""
    warp, weft = (bending, bending) if isinstance(bending, str) else bending
    yarn = {"modulus": modulus, "poisson": 0, "yarns": "2.4 /cm", "yarn_bending": yarn_bending}
    table = {
        "warp": {**yarn, "out_of_plane_bending": warp},
        "weft": {**yarn, "out_of_plane_bending": weft},
        "thickness": "1 mm",
        "areal_density": "500 g/m^2",
        "shear": {"modulus": shear} if isinstance(shear, str) else shear,
    }
    return Fabric.from_table("cloth", table | further)


def network(size, fabric=None, angle="0 deg", comm=MPI.COMM_SELF, **options) -> Network:
    """A rectangle (x, y) in mm around the origin."""
    x, y = 0.5e-3 * np.array(size)
    corners = [[-x, -y], [x, -y], [x, y], [-x, y]]
    preform = Preform.polygon(corners, bias_angle=angle, **options)
    return Network(comm, preform, fabric or cloth())


def load(where, force, name="pull", factor=0.0):
    """Makes a load [N] on the nodes of a ply that lie ``where`` at rest, evenly."""

    def make(ply):
        at = ply.active & where(ply.nodes.rest)
        own = ply.nodes.num_nodes_owned
        each = np.zeros_like(ply.nodes.rest)
        each[at] = np.asarray(force, float) / ply.comm.allreduce(int(at[:own].sum()))
        return DeadLoads(each, ply.nodes.rest, own, name, factor)

    return make


class Gripped(Blank):
    """A blank that starts in a shape, with nodes along some axes held by a grip.

    The grip is one more tool, "grip", that touches nothing: held nodes move as its place does. Of
    several plies ``ply`` is held.
    """

    def __init__(
        self, net, tools, *, shape=None, held=None, axes=(True, True, True), ply=0, **options
    ):
        self.grip = held is not None
        if self.grip:
            far = Pose(np.array([0.0, 0.0, -1e3]))
            tools = [*tools, Tool("grip", shapes.plane(), 0.0, far)]
        super().__init__(net, tools, **options)
        one = self.each[ply]
        rest = one.ply.nodes.rest
        self.shaped = self.nodes.rest.copy()
        if shape is not None:
            self.shaped[one.cloth_at] = shape(rest)
        at = held(rest) & one.ply.active if self.grip else np.zeros(len(rest), bool)
        self.held, self.held_axes = one.cloth_at[at], np.array(axes)

    def hold(self, place, free, rotations):
        """See Blank.hold."""
        hold = super().hold(place, free, rotations)
        moved = place[-1] - self.tools[-1].start.place if self.grip else np.zeros(3)
        n = len(self.held)
        return replace(
            hold,
            nodes=np.concatenate([hold.nodes, self.held]),
            axes=np.concatenate([hold.axes, self.nodes.frame[self.held]]),
            fixed=np.concatenate([hold.fixed, np.tile(self.held_axes, (n, 1))]),
            place=np.concatenate([hold.place, self.shaped[self.held] + moved]),
        )

    def start(self):
        """See Blank.start."""
        state = super().start()
        state = replace(state, x=self.shaped, memory={})
        return replace(state, memory=self.model.accepted(state))

    def on_grip(self, state) -> np.ndarray:
        """Force of the grip on the cloth, N."""
        return self.model.force(state)[0][self.held].sum(axis=0)


def travel(*way, curve=None):
    """A motion for StagePlan.motions."""
    return lambda pose: Motion(pose, np.array(way), curve=curve)


def formed(blank, *plans, **options):
    """Its steps and all of its states."""
    states = []
    result = form(blank, plans, accepted=lambda step, state: states.append(state), **options)
    return result.steps, states


def hemisphere(comm=MPI.COMM_SELF, steps=10, close=1, settings=HARD, quarter=False, **options):
    """A small hemisphere, 20 mm deep, and the plans that form it; 121 crossovers, or a quarter."""
    law = {"law": "sin-potential", "coefficients": ["18.5 N/m", "46.4 N/m", "60 N/m"]}
    fabric, force = cloth(bending="1 N mm", shear=law), np.array([0.0, 0.0, -20.0])
    options = {"yarns_per_cruciform": 2, **options}
    net = network((92.0, 92.0), fabric, comm=comm, **options)
    if quarter:  # planes of symmetry along yarns
        corners = 46e-3 * np.array([[0, 0], [1, 0], [1, 1], [0, 1]])
        preform = Preform.polygon(corners.tolist(), bias_angle=0.0, origin=(0, 0), **options)
        net, force = Network(comm, preform, fabric), force / 4
    radius = 20e-3
    above, high = (Pose(np.array([0, 0, z]), OVER) for z in (1e-3, 1e-3 + radius))
    tools = [
        Tool("die", shapes.opening(22.5e-3, 5e-3, 90e-3), 0.2),
        Tool("holder", shapes.ring(29e-3, 90e-3, 1e-3), 0.2, above),
        Tool("punch", shapes.sphere(radius, shaft=True), 0.2, high),
    ]
    planes = ("left", "lower") if quarter else ()
    blank = Blank(net, tools, settings=settings, symmetry=planes)
    plans = [
        StagePlan("close", forces={"holder": force}, step=1 / close),
        StagePlan("draw", {"punch": travel(0, 0, -20e-3)}, step=1 / steps),
    ]
    return blank, plans


def two_plies(comm=MPI.COMM_SELF, steps=5, friction=0.2, depth=15e-3, angle="45 deg", **options):
    """The small hemisphere with two plies, the upper one at an angle, and without a holder."""
    law = {"law": "sin-potential", "coefficients": ["18.5 N/m", "46.4 N/m", "60 N/m"]}
    fabric = cloth(bending="1 N mm", shear=law)
    nets = [
        network((92.0, 92.0), fabric, angle, comm, **{"yarns_per_cruciform": 2, **options})
        for angle in ("0 deg", angle)
    ]
    high = Pose(np.array([0, 0, 2 * THICKNESS + 20e-3]), OVER)
    tools = [
        Tool("die", shapes.opening(25e-3, 5e-3, 90e-3), friction),
        Tool("punch", shapes.sphere(20e-3, shaft=True), friction, high),
    ]
    blank = Blank(nets, tools, settings=HARD, names=["low", "high"], rub=[0.0, friction])
    return blank, [StagePlan("draw", {"punch": travel(0, 0, -depth)}, step=1 / steps)]
