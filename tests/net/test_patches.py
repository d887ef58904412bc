# SPDX-License-Identifier: MIT
"""Smooth surfaces through the arm ends of a ply."""

import numpy as np
import pytest
from support.formed import network

from cruciform_petsc.elements.touch import closest
from cruciform_petsc.net.nodes import Nodes
from cruciform_petsc.net.patches import Patches


def made(angle, size=(60, 50), **options):
    net = network(size, angle=angle, **options)
    nodes = Nodes(net, 3)
    return net, nodes, Patches(net, nodes)


@pytest.mark.parametrize("angle", ["0 deg", "45 deg", "30 deg"])
def test_a_plane_is_one_up_to_its_rim(angle):
    """Control points lie where their numbers say, also those beyond the ends of yarns."""
    net, nodes, patches = made(angle)
    flat = patches.flat(patches.number.astype(float))
    np.testing.assert_allclose(patches.middles(nodes.rest)[:, :2], flat, atol=1e-15)
    np.testing.assert_allclose(patches.weight.sum(axis=2), 1.0, rtol=1e-12)
    # Inner ones are of nine arm ends alone; all crossovers, and the rim, lie on some patch.
    assert (np.count_nonzero(patches.weight, axis=(1, 2)) == 9).sum() > 40
    assert (patches.find(patches.number) == np.arange(len(patches.number))).all()
    at = np.concatenate([net.crossover_position, net.node_position])
    half = 2.0 * net.to_yarn(at - net.origin) / net.pitch
    place = np.column_stack([half.sum(axis=1) - 1.0, half[:, 1] - half[:, 0] - 1.0]) / 2.0
    assert (patches.find(np.floor(place + 0.5).astype(int)) >= 0).all()
    np.testing.assert_allclose(patches.flat(place), at, atol=1e-15)
    assert (patches.covers(place) < 1e-12).all()
    point = np.einsum("j,mji->mi", patches.shares, nodes.rest[patches.points])
    whole = net.arm_is_shared.all(axis=1)
    np.testing.assert_allclose(point[whole, :2], net.crossover_position[whole], atol=1e-15)


@pytest.mark.parametrize("pitches", [2, 1])
def test_how_far_it_lies_beside_bent_cloth(pitches):
    """h^2/16 times the sum of both curvatures, on the hollow side, as the text says: to 3 %."""
    radius = 0.15
    _, nodes, patches = made("0 deg", yarns_per_cruciform=pitches)
    net = patches._network
    x = nodes.rest.copy()
    x[:, 2] = -(x[:, 0] ** 2 + 0.5 * x[:, 1] ** 2) / (2.0 * radius)
    inner = np.count_nonzero(patches.weight, axis=(1, 2)) == 9
    number = patches.number[inner]
    uv, distance, normal = np.zeros((len(number), 2)), np.zeros(len(number)), np.zeros((3,))
    normal = np.zeros((len(number), 3))
    at = patches.flat(number.astype(float))
    point = np.column_stack([at, -(at[:, 0] ** 2 + 0.5 * at[:, 1] ** 2) / (2.0 * radius)])
    closest(point, x[patches.nodes[inner]], patches.weight[inner], uv, distance, normal)
    wanted = net.pitch[0] ** 2 / 16.0 * 1.5 / radius
    near = np.linalg.norm(at, axis=1) < 0.01
    assert near.any()
    np.testing.assert_allclose(distance[near], wanted, rtol=0.03)
