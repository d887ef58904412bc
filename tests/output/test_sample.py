# SPDX-License-Identifier: MIT
"""What pictures are drawn from: yarns and maps that one rank can hold."""

import numpy as np
import pytest
import shapely
from mpi4py import MPI

from cruciform_petsc import BiasExtension, Fabric, Network, Preform
from cruciform_petsc.output.sample import sample_map, sample_yarns

CIRCLE = np.asarray(shapely.Point(0.0, 0.04).buffer(0.0101).exterior.coords)


@pytest.fixture(scope="module")
def result():
    """A strip with a hole, pulled by 1 mm: some yarns are cut in two by the hole."""
    preform = Preform.rectangle("40 mm", "80 mm", holes=[CIRCLE[:-1]], refine=2)
    network = Network(MPI.COMM_SELF, preform, Fabric.from_library("e-glass-plain-2.4"))
    return BiasExtension(network, extension="1 mm", finite=False).solve()


@pytest.fixture
def sample(result):
    return sample_yarns(result.network, result.node_displacement, result.fields)


def lengths(sample):
    """Length of each polyline before the deformation."""
    lines = np.split(sample.before, sample.first[1:])
    return np.array([np.linalg.norm(np.diff(line, axis=0), axis=1).sum() for line in lines])


def test_whole_yarns(result, sample):
    """All arms of a small network, as straight yarns, in two pieces where the hole cuts them."""
    network = result.network
    assert sample.every == 1
    assert lengths(sample).sum() == pytest.approx(network.arm_length.sum(), rel=1e-12)
    parts = [(y.last >= y.first).sum() for y in (network.warp_yarns, network.weft_yarns)]
    assert np.bincount(sample.family[sample.first]).tolist() == parts
    assert sum(parts) > len(np.unique(network.warp_yarns.line)) + len(
        np.unique(network.weft_yarns.line)
    )
    step = np.diff(sample.before[sample.segment], axis=1)[:, 0]
    axes = network.preform.rotation[sample.family[sample.segment[:, 0]]]
    along = np.einsum("si,si->s", step, axes)
    np.testing.assert_allclose(along, np.linalg.norm(step, axis=1), rtol=1e-9)
    inner = (np.abs(sample.lattice - np.round(sample.lattice)) < 1e-9).all(axis=1)
    known = {tuple(ij) for ij in network.crossover_ij}
    assert {tuple(ij) for ij in np.round(sample.lattice[inner]).astype(int)} >= known
    assert sample.after[:, 1].max() == pytest.approx(0.081)
    assert np.nanmax(sample.values) == pytest.approx(np.rad2deg(result.shear_angle_max))


def test_every_kth_yarn(result):
    """Of a larger network some yarns are taken, from end to end, within the limit."""
    network = result.network
    sample = sample_yarns(network, result.node_displacement, result.fields, limit=60)
    assert sample.every > 2
    assert sample.spacing == pytest.approx(sample.every * network.pitch[0])
    for family, yarns in enumerate((network.warp_yarns, network.weft_yarns)):
        mine = sample.family[sample.first] == family
        taken = (yarns.line % sample.every == 0) & (yarns.last >= yarns.first)
        expected = (yarns.end - yarns.start)[taken] * network.pitch[family]
        np.testing.assert_allclose(np.sort(lengths(sample)[mine]), np.sort(expected), rtol=1e-9)
        points = (sample.family == family).sum()
        assert 30 < points <= 60 + 4 * mine.sum()


def test_what_carries_nothing_has_no_angle(result):
    """Nor does it spoil the means of its neighbours."""
    fields = dict(result.fields, carrying=result.fields["carrying"].copy())
    regular = np.delete(np.arange(len(fields["carrying"])), result.network.boundary_crossovers)
    fields["carrying"][regular[50]] = False
    sample = sample_yarns(result.network, result.node_displacement, fields)
    assert np.isnan(sample.values).sum() == 2  # once on each of its yarns


def test_map_of_all_cells(result):
    network = result.network
    shear = np.rad2deg(result.fields["shear_angle"])
    sample = sample_map(network, {"shear": shear, "y": network.crossover_position[:, 1]})
    np.testing.assert_allclose(sample.centre, network.crossover_position, atol=1e-12)
    np.testing.assert_allclose(sample.values["y"], sample.centre[:, 1], atol=1e-12)
    np.testing.assert_allclose(sample.values["shear"], shear)
    assert sample.at_outline.sum() == len(network.boundary_crossovers)
    area = shapely.area(shapely.polygons(sample.cells()))
    np.testing.assert_allclose(area, network.pitch.prod())
    assert len(sample.outline) == 2


def test_map_of_blocks(result):
    """Means over blocks: a linear field has its value at the centre of a full block."""
    network = result.network
    x = network.crossover_position[:, 0].copy()
    x[5] = np.nan
    sample = sample_map(network, {"x": x, "none": np.full(len(x), np.nan)}, limit=80)
    assert 40 < len(sample.centre) <= 120
    inner = ~sample.at_outline
    assert inner.sum() > 5
    np.testing.assert_allclose(sample.values["x"][inner], sample.centre[inner, 0], atol=1e-12)
    assert np.isfinite(sample.values["x"]).all()
    assert np.isnan(sample.values["none"]).all()
    side = np.linalg.norm(sample.sides, axis=1) / network.pitch
    assert side == pytest.approx(round(side[0]))
