# SPDX-License-Identifier: MIT
"""A ply with its model, and states of it, for tests of finite deformation."""

import numpy as np

from cruciform_petsc.equilibrium.cloth import holder, model_of
from cruciform_petsc.equilibrium.follow import follow
from cruciform_petsc.equilibrium.newton import Equilibrium
from cruciform_petsc.equilibrium.stages import Stage
from cruciform_petsc.equilibrium.state import State
from cruciform_petsc.items.ply import MODES, Ply


class Cloth:
    """A constrained network as a ply and a model.

    Parameters
    ----------
    constraints : Constraints
    edges : dict of int arrays, optional
        Network nodes of edges that `solve` moves.
    out_of_plane : (float, float), optional
    loads : sequence of callables, optional
        Make further items of the ply.
    """

    def __init__(self, constraints, edges=None, out_of_plane=None, flat=True, loads=()):
        self.edges = edges or {}
        self.network = constraints.network
        self.ply = Ply(constraints, out_of_plane, flat)
        self.ply.further += [make(self.ply) for make in loads]
        self.nodes, self.rest = self.ply.nodes, self.ply.nodes.rest
        self.model = model_of(self.ply)
        self.hold = holder(self.ply)

    def state(self, x=None, motions=(), load=0.0):
        """The state with positions x (by default at rest) and edges where motions put them."""
        hold = self.hold(list(motions))
        start = State(self.rest if x is None else x, hold)
        return start.at(hold, 0.0, {"loads": load})

    def affine(self, gradient, shift=(0.0, 0.0)):
        """Positions X -> gradient X + shift in the yarn frame, (n_local, 2)."""
        origin = self.network.origin
        yarn = self.network.to_yarn(self.rest - origin)
        return self.network.to_lab(yarn @ np.transpose(gradient) + shift) + origin

    def free(self):
        return self.model.free(self.state().hold)

    def energies(self, state):
        """Of tension, shear and bending, (3,)."""
        energies = self.model.energies(state)
        return np.array([energies[mode] for mode in MODES])

    def stage(self, motion, targets, step=None, load=lambda control: 0.0):
        """motion(edge, control) -> gradient, shift of the edges."""

        def drive(control):
            motions = [(self.edges[edge], *motion(edge, control)) for edge in self.edges]
            return self.hold(motions), {"loads": load(control)}

        return Stage("test", drive, targets, step)

    def solve(self, motion, targets=(1.0,), step=None):
        """Follow motions from rest; returns the last step's state and forces (n, dim)."""
        equilibrium = Equilibrium(self.model, self.state())
        try:
            self.steps = follow(equilibrium, self.stage(motion, targets, step), self.state())
        finally:
            equilibrium.destroy()
        state = self.steps[-1].state
        return state, self.model.force(state)[0]
