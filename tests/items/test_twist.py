# SPDX-License-Identifier: MIT
"""Twisting out of the plane: derivatives, rigid motions, a saddle, strips at 45 degrees."""

from dataclasses import replace

import numpy as np
import pytest
from mpi4py import MPI
from support.helpers import PITCH, TABLE_1, diagonals, l_shape
from support.kernels import differences, rotation

from cruciform_petsc.cloth.preform import Preform
from cruciform_petsc.elements.level import FORCE, STIFFNESS
from cruciform_petsc.items.ply import Ply
from cruciform_petsc.items.twist import Twist
from cruciform_petsc.laws import table
from cruciform_petsc.net.edges import Constraints
from cruciform_petsc.net.network import Network

B = (1e-3, 4e-4)  # N m
SHARE = 0.6


def ply_of(preform, fabric=TABLE_1, out=None):
    network = Network(MPI.COMM_SELF, preform, fabric)
    return Ply(Constraints(network, True, floats=True), out or B, flat=False)


def wavy(ply):
    """Bent, twisted, sheared and stretched."""
    x, y, _ = (ply.nodes.rest / 0.02).T
    wave = np.stack([np.cos(x + y), np.sin(x - 2 * y), 3 * np.sin(x) * np.cos(y) + x * y], axis=1)
    return ply.nodes.rest + 2e-3 * wave


class At:
    """A state of positions alone."""

    def __init__(self, x):
        self.x = x


def test_derivatives():
    """Energy, force, stiffness by central differences, over a 4000th of an arm."""
    ply = ply_of(l_shape(0.03, 1.2))
    twist, x = Twist(ply, SHARE), wavy(ply)
    for element in range(0, len(twist.nodes), 9):
        rows = slice(element, element + 1)
        nodes, slot = np.unique(twist.nodes[element], return_inverse=True)  # hinges may be ends
        sums = np.zeros((len(nodes), 6))
        sums[slot, np.arange(6)] = 1.0

        def of(part, rows=rows, nodes=nodes, sums=sums):
            def work(places):
                moved = x.copy()
                moved[nodes] = places[0]
                values = twist.work(At(moved), FORCE, rows)[part]
                return values if part == 0 else np.einsum("ps,nsi->npi", sums, values)

            return work

        _, force, stiffness = twist.work(At(x), STIFFNESS, rows)
        force = np.einsum("ps,nsi->npi", sums, force)
        stiffness = np.einsum("ps,nsirj,qr->npiqj", sums, stiffness, sums)
        at, size = x[nodes][None], abs(force).max()
        found = differences(of(0), at, 5e-7)[:, 0]
        np.testing.assert_allclose(found, force, atol=3e-6 * size)
        found = differences(of(1), at, 5e-7)
        np.testing.assert_allclose(found, stiffness, atol=3e-6 * abs(stiffness).max())


@pytest.mark.parametrize("origin", [None, (0.5 * PITCH, 4.5 * PITCH)], ids=["on yarns", "between"])
def test_a_quarter_is_a_quarter(origin):
    """Between planes of symmetry, on yarns or between them: a quarter of the whole's energy.

    Forces there are half those of the whole on the planes, a quarter where they meet.
    """
    k = 1 / 0.05

    def surface(x):
        moved = x.copy()
        moved[:, 2] = 0.01 * np.cos(k * x[:, 0]) * np.cos(1.3 * k * x[:, 1])
        moved[:, :2] *= 1.0 + 0.05 * np.cos(k * x[:, 1::-1])
        return At(moved)

    found = []
    for size, edges, place in ((8, (), (0.0, 0.0)), (4, ("left", "lower"), (0.0, 0.0))):
        low = -size * PITCH / 2 if size == 8 else 0.0
        corners = np.array([[0, 0], [1, 0], [1, 1], [0, 1]]) * size * PITCH + low
        at = place if origin is None else (0.5 * PITCH, 0.5 * PITCH)
        preform = Preform.polygon(corners, bias_angle=0.0, origin=at)
        constraints = Constraints(Network(MPI.COMM_SELF, preform, TABLE_1), True, floats=True)
        for edge in edges:
            constraints.symmetry(edge)
        ply = Ply(constraints, B, flat=False)
        twist = Twist(ply, SHARE)
        energy, force, _ = twist.work(surface(ply.nodes.rest), FORCE)
        total = np.zeros_like(ply.nodes.rest)
        np.add.at(total, twist.nodes, force)
        found.append((energy.sum(), ply.nodes.rest[:, :2], total))
    (whole, places, forces), (quarter, mine, other) = found
    assert quarter == pytest.approx(0.25 * whole, rel=1e-9)
    for place, force in zip(mine, other, strict=True):
        at = np.flatnonzero(np.linalg.norm(places - place, axis=1) < 1e-9)
        if len(at) == 1:  # but for what is on a plane alone
            share = 0.5 ** np.count_nonzero(abs(place) < 1e-9)
            on = np.append(abs(place) > 1e-9, True)  # across a plane both halves cancel
            wanted = share * forces[at[0]] * on
            np.testing.assert_allclose(force * on, wanted, atol=1e-9 * abs(forces).max())


def test_laws():
    """A curved law of bending is one of twisting, too: the saddle has the sum of both energies."""
    law = table([1.0, 5.0, 20.0], [3e-4, 8e-4, 2e-3])
    ply = ply_of(Preform.rectangle(6 * PITCH, 5 * PITCH, 0.0), out=(law, 1e-3))
    kappa, state = 2.0, ply.nodes.rest.copy()
    along = ply.network.to_yarn(state[:, :2])
    state[:, 2] = kappa * along.prod(axis=1)
    energy = Twist(ply, SHARE).work(At(state), FORCE)[0].sum()
    expected = SHARE * (law.evaluate(kappa)[0] + 0.5e-3 * kappa**2) * 30 * PITCH**2
    assert energy == pytest.approx(expected, rel=2e-3)  # slopes of 2 %


def test_rigid_motions_and_flat_cloth():
    """Neither a rotation of twisted cloth nor anything in the plane changes the energy."""
    ply = ply_of(diagonals(3, 5))
    twist, x = Twist(ply, SHARE), wavy(ply)
    turned = x @ rotation(2.1, [0.3, -0.8, 0.5]).T + [1.0, 2.0, -3.0]
    here, there = (twist.work(At(state), FORCE)[0].sum() for state in (x, turned))
    assert there == pytest.approx(here, rel=1e-9)  # coordinates of 3 m, cells of 4 mm
    flat = x * [1.0, 1.0, 0.0]
    assert twist.work(At(flat), FORCE)[0].sum() < 1e-25
    cylinder = ply.nodes.rest.copy()  # about y: no twist of warp and weft along and across it
    along = ply_of(Preform.rectangle(6 * PITCH, 5 * PITCH, 0.0))
    twist, rest = Twist(along, SHARE), along.nodes.rest
    cylinder = rest.copy()
    cylinder[:, 0], cylinder[:, 2] = (
        0.02 * np.sin(rest[:, 0] / 0.02),
        0.02 * np.cos(rest[:, 0] / 0.02),
    )
    assert twist.work(At(cylinder), FORCE)[0].sum() < 1e-15


@pytest.mark.parametrize("angle", [0.0, 0.4])
@pytest.mark.parametrize("origin", [None, (0.2 * PITCH, 0.6 * PITCH)])
def test_saddle(angle, origin):
    """w = kappa x y along the yarns: s (B_1 + B_2) kappa^2/2 of the area, however it is cut."""
    kappa = 1e-3
    preform = Preform.rectangle(9 * PITCH, 8 * PITCH, angle, origin=origin)
    ply = ply_of(preform)
    along = ply.network.to_yarn(ply.nodes.rest[:, :2])
    state = ply.nodes.rest.copy()
    state[:, 2] = kappa * along.prod(axis=1)
    energy = Twist(ply, SHARE).work(At(state), FORCE)[0].sum()
    area = preform.outline.area
    # Oblique edges leave out crossovers that only one yarn joins to the others.
    tolerance = 1e-9 if angle == 0.0 else 0.03
    assert energy == pytest.approx(SHARE * sum(B) * 0.5 * kappa**2 * area, rel=tolerance)


@pytest.mark.parametrize("twisting", [0.0, 0.5, 1.0])
def test_cylinder_at_45_degrees(twisting):
    """Bent along the bias: (1 + s)/2 of the rigidity along the yarns, all of it with s = 1.

    Curvatures of both yarns are half of the bias', and so is the twist.
    """
    bend, radius = 1e-3, 1.0
    fabric = replace(TABLE_1, out_of_plane_twisting=twisting)
    network = Network(MPI.COMM_SELF, Preform.rectangle(0.06, 0.08, "45 deg"), fabric)
    ply = Ply(Constraints(network, True, floats=True), (bend, bend), flat=False)
    rest = ply.nodes.rest
    state = rest.copy()
    state[:, 1], state[:, 2] = (
        radius * np.sin(rest[:, 1] / radius),
        radius * np.cos(rest[:, 1] / radius),
    )
    items = [ply.bends, *ply.further]
    assert len(items) == 1 + bool(twisting)
    out = sum(item.work(full(ply, state), FORCE)[0][:, -1].sum() for item in items)
    expected = 0.5 * (1.0 + twisting) * bend * 0.5 * network.preform.outline.area / radius**2
    # At oblique edges bends and joints stand for a little less than all of the cloth.
    assert out == pytest.approx(expected, rel=0.06)


def full(ply, x):
    """A state that yarns that bend can be asked at."""
    state = At(x)
    state.hold = At(x)
    state.hold.turn = np.zeros((0, 3, 3))
    return state
