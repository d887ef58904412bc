# SPDX-License-Identifier: MIT
"""Crossovers, arms, nodes and the partition of networks on one rank."""

import time

import numpy as np
import pytest
import shapely
from mpi4py import MPI
from support.helpers import (
    DIAGONAL,
    PITCH,
    TABLE_1,
    UNEVEN,
    diagonals,
    holed,
    l_shape,
    random_polygon,
    random_preform,
)

from cruciform_petsc.cloth.fabric import Fabric, YarnFamily
from cruciform_petsc.cloth.preform import Preform
from cruciform_petsc.errors import InputError
from cruciform_petsc.experiments.off_axis import OffAxisTension
from cruciform_petsc.net.lattice import (
    ARM_STEP,
    OPPOSITE,
    SHORTEST_ARM,
    SNAP,
    pack_key,
    quadrant_areas,
    snapped,
)
from cruciform_petsc.net.network import Network
from cruciform_petsc.net.partition import Partition


def serial(preform, fabric=TABLE_1):
    """The network on one rank."""
    return Network(MPI.COMM_SELF, preform, fabric)


def on_half_pitches(rng):
    """An outline with corners on half pitches: edges run along the borders of lattice cells."""
    while True:
        corners = np.round(2 * random_polygon(rng, 5.0)) / 2
        outline = shapely.Polygon(corners)
        if outline.is_valid and outline.area > 4:
            return Preform.polygon(PITCH * corners, [], np.pi / 2, origin=(0.0, 0.0))


def various():
    """Networks with cut arms of all kinds: cloth, angle, hole, corners."""
    rng = np.random.default_rng(7)
    yield pytest.param(diagonals(4, 6), TABLE_1, id="table-1")
    yield pytest.param(Preform.rectangle(0.024, 0.036, "30 deg"), TABLE_1, id="30-degrees")
    yield pytest.param(holed(0.05, 0.07, 0.011, 0.4), UNEVEN, id="hole")
    yield pytest.param(l_shape(0.06, 1.2), UNEVEN, id="L")
    for k in range(6):
        preform = random_preform(rng, UNEVEN, 5.0, hole=k % 2 == 0)
        yield pytest.param(preform, UNEVEN, id=f"random-{k}")
    for k in range(12):
        yield pytest.param(on_half_pitches(rng), TABLE_1, id=f"half-pitches-{k}")
    stairs = PITCH * np.array([(0, 0), (3.5, 0), (3.5, 1.5), (1.5, 1.5), (1.5, 3.5), (0, 3.5)])
    preform = Preform.polygon(stairs, [], np.pi / 2, origin=(0.0, 0.0))
    yield pytest.param(preform, TABLE_1, id="cell-borders")


VARIOUS = list(various())


# -- how many ----------------------------------------------------------------------------------


def test_table_1_has_59_crossovers():
    """The paper's specimen, and the exact 4 x 6 diagonals it stands for: 13 rows of 5 and 4."""
    for preform in (diagonals(4, 6), Preform.rectangle("2.4 cm", "3.6 cm")):
        network = serial(preform)
        assert network.num_crossovers_global == network.num_crossovers_owned == 59
        row = np.round(network.crossover_position[:, 1] / (0.5 * DIAGONAL), 6)
        assert np.unique(row - row.min(), return_counts=True)[1].tolist() == [5, 4] * 6 + [5]


@pytest.mark.parametrize(("refine", "expected"), [(2, 213), (4, 809), (8, 3153)])
def test_refined_table_1(refine, expected):
    """(4 r + 1)(6 r + 1) on the diagonals' crossings and 4 r x 6 r between."""
    assert expected == (4 * refine + 1) * (6 * refine + 1) + 24 * refine**2
    network = serial(diagonals(4, 6, refine=refine))
    assert network.num_crossovers_global == expected
    np.testing.assert_allclose(network.pitch, PITCH / refine)


def test_crossovers_of_a_rectangle_along_the_yarns():
    """Warp along y: weft yarns are counted along it, one for each weft spacing."""
    warp, weft = UNEVEN.warp.spacing, UNEVEN.weft.spacing
    network = serial(Preform.rectangle(4 * warp, 7 * weft, "0 deg"), UNEVEN)
    # Centred on a crossover: 2 on either side across, 3 along.
    assert network.num_crossovers_global == 5 * 7
    np.testing.assert_allclose(network.pitch, [weft, warp])
    assert np.ptp(network.crossover_ij, axis=0).tolist() == [6, 4]


def test_coarse_network():
    """yarns_per_cruciform multiplies the pitch."""
    network = serial(Preform.rectangle("12 cm", "18 cm", yarns_per_cruciform=3))
    np.testing.assert_allclose(network.pitch, 3 * PITCH)
    fine = serial(Preform.rectangle("12 cm", "18 cm"))
    ratio = fine.num_crossovers_global / network.num_crossovers_global
    assert ratio == pytest.approx(9, rel=0.1)


@pytest.mark.parametrize("degrees", range(0, 180, 15))
def test_any_bias_angle(degrees):
    """About one crossover for each cell of the outline's area; warp at the angle from y."""
    network = serial(Preform.rectangle(0.06, 0.08, np.deg2rad(degrees)))
    assert network.num_crossovers_global == pytest.approx(0.06 * 0.08 / PITCH**2, rel=0.1)
    along = network.arm_is_shared[:, 0] & (network.crossover_ij[:, 1] == 0)
    start = network.crossover_position[along]
    step = network.node_position[network.arm_node[along, 0]] - start
    warp = [np.sin(np.deg2rad(degrees)), np.cos(np.deg2rad(degrees))]
    np.testing.assert_allclose(
        step, np.tile(0.5 * PITCH * np.array(warp), (len(step), 1)), atol=1e-12
    )


def test_origin():
    """Crossover (0, 0) lies at the origin, by default the middle of the outline."""
    for origin in (None, (0.003, 0.011)):
        network = serial(Preform.rectangle(0.06, 0.08, 0.7, origin=origin))
        (zero,) = np.flatnonzero((network.crossover_ij == 0).all(axis=1))
        np.testing.assert_allclose(
            network.crossover_position[zero], origin or (0.0, 0.04), atol=1e-15
        )


def test_far_origin():
    """Crossover (0, 0) is then the one nearest the middle, whole pitches from the origin."""
    for origin in ((-300.0, 4.0), (0.0, 0.13), ("1 km", "1 km")):
        preform = Preform.rectangle(0.06, 0.08, 0.7, origin=origin)
        network = serial(preform, UNEVEN)
        (zero,) = np.flatnonzero((network.crossover_ij == 0).all(axis=1))
        np.testing.assert_array_equal(network.crossover_position[zero], network.origin)
        off = network.to_yarn(network.origin - preform.middle) / network.pitch
        assert (abs(off) < 0.5 + 1e-9).all()
        away = network.to_yarn(network.origin - preform.lattice_origin) / network.pitch
        np.testing.assert_allclose(away, np.round(away), atol=1e-9)


def test_no_crossover_inside():
    """An outline larger than a cruciform that slips between all lattice points."""
    band = [(0.0, 0.3), (8.0, 8.3), (8.0, 8.7), (0.0, 0.7)]
    points = [(PITCH * x, PITCH * y) for x, y in band]
    with pytest.raises(InputError, match="holds no crossover") as caught:
        serial(Preform.polygon(points, [], np.pi / 2, origin=(0.0, 0.0)))
    assert "refine" in str(caught.value)


# -- crossovers and arms -----------------------------------------------------------------------


@pytest.mark.parametrize(("preform", "fabric"), VARIOUS)
def test_crossovers_are_the_lattice_points_inside(preform, fabric):
    """Brute force over the bounding box; numbers run along each warp yarn in turn."""
    network = serial(preform, fabric)
    reach = int(0.2 / network.pitch.min())
    i, j = np.meshgrid(np.arange(-reach, reach), np.arange(-reach, reach), indexing="ij")
    lattice = np.stack([i.ravel(), j.ravel()], axis=1)
    xy = (lattice * network.pitch) @ preform.rotation + network.origin
    grown = preform.outline.buffer(2 * SNAP * network.pitch.min())
    inside = shapely.contains_xy(grown, xy[:, 0], xy[:, 1])
    order = np.lexsort((lattice[inside, 0], lattice[inside, 1]))
    np.testing.assert_array_equal(network.crossover_ij, lattice[inside][order])
    np.testing.assert_allclose(network.crossover_position, xy[inside][order], atol=1e-15)
    np.testing.assert_array_equal(
        network.crossover_number_global, np.arange(network.num_crossovers_global)
    )


@pytest.mark.parametrize(("preform", "fabric"), VARIOUS)
def test_arms_end_on_the_outline_or_midway(preform, fabric):
    """Shared ends lie midway between two crossovers, others on the outline; none leaves it."""
    network = serial(preform, fabric)
    half = 0.5 * np.tile(network.pitch, 2)
    end = network.node_position[network.arm_node]
    direction = ARM_STEP @ preform.rotation
    place = network.crossover_position[:, None] + network.arm_length[..., None] * direction
    np.testing.assert_allclose(end, place, atol=1e-12)
    shared, missing = network.arm_is_shared, network.arm_length == 0
    np.testing.assert_allclose(
        network.arm_length[shared], np.broadcast_to(half, shared.shape)[shared]
    )
    boundary = preform.outline.boundary
    off = shapely.distance(boundary, shapely.points(end))
    tail = ~shared & ~missing
    assert off[tail].max(initial=0.0) < 1e-12 + SNAP * network.pitch.max()
    assert (network.arm_length[tail] >= SHORTEST_ARM * half.min()).all()
    # A missing arm is one whose yarn ends within SHORTEST_ARM of the crossover.
    probe = (
        place[missing]
        + 2
        * SHORTEST_ARM
        * network.pitch.max()
        * np.broadcast_to(direction, (*shared.shape, 2))[missing]
    )
    path = shapely.linestrings(np.stack([place[missing], probe], axis=1))
    assert (shapely.distance(boundary, path) < 1e-9).all()
    arms = shapely.linestrings(
        np.stack([np.broadcast_to(network.crossover_position[:, None], end.shape), end], axis=2)
    )
    assert shapely.covers(preform.outline.buffer(1e-8), arms).all()


@pytest.mark.parametrize(("preform", "fabric"), VARIOUS)
def test_each_shared_arm_end_has_two_crossovers(preform, fabric):
    """And they are neighbours that meet with opposite arms; other ends have one."""
    network = serial(preform, fabric)
    users = {}
    for (e, arm), node in np.ndenumerate(network.arm_node):
        users.setdefault(int(node), []).append((e, arm))
    assert sorted(users) == list(range(network.num_nodes_owned))
    for node, who in users.items():
        shared = {bool(network.arm_is_shared[e, arm]) for e, arm in who}
        assert len(shared) == 1
        if shared == {True}:
            (e, arm), (f, brm) = who
            assert brm == OPPOSITE[arm]
            np.testing.assert_array_equal(
                network.crossover_ij[e] + ARM_STEP[arm], network.crossover_ij[f]
            )
            assert network.node_family[node] == arm % 2
        else:
            assert len({e for e, _ in who}) == 1
            missing = [network.arm_length[e, arm] == 0 for e, arm in who]
            assert all(missing) or len(who) == 1
            assert network.node_is_hinge[node] == missing[0]


@pytest.mark.parametrize(("preform", "fabric"), VARIOUS)
def test_neighbours_on_one_yarn_are_joined(preform, fabric):
    """Two crossovers side by side share an end just if the outline leaves the yarn whole."""
    network = serial(preform, fabric)
    number = {tuple(ij): e for e, ij in enumerate(network.crossover_ij.tolist())}
    grown = preform.outline.buffer(1e-9)
    for (i, j), e in number.items():
        for arm, (di, dj) in enumerate(ARM_STEP.tolist()):
            other = number.get((i + di, j + dj))
            joined = other is not None and grown.covers(
                shapely.LineString(network.crossover_position[[e, other]])
            )
            assert network.arm_is_shared[e, arm] == joined


@pytest.mark.parametrize(("preform", "fabric"), VARIOUS)
def test_boundary_crossovers(preform, fabric):
    """All others are regular; nodes close to the outline are marked."""
    network = serial(preform, fabric)
    regular = np.ones(network.num_crossovers_owned, bool)
    regular[network.boundary_crossovers] = False
    assert network.arm_is_shared[regular].all()
    half, quarter = 0.5 * np.tile(network.pitch, 2), 0.25 * network.pitch.prod()
    np.testing.assert_array_equal(network.arm_length[regular], np.tile(half, (regular.sum(), 1)))
    # As if all were looked at closely.
    outline = shapely.transform(
        preform.outline,
        lambda xy: snapped((xy - network.origin) @ preform.rotation.T / network.pitch),
    )
    every = quadrant_areas(network.crossover_ij, network.has_crossover, outline)
    np.testing.assert_allclose(network.quadrant_area, 4 * quarter * every, atol=1e-9 * quarter)
    off = shapely.distance(preform.outline.boundary, shapely.points(network.node_position))
    assert network.node_is_boundary[off < 0.4 * network.pitch.min()].all()


@pytest.mark.parametrize(("preform", "fabric"), VARIOUS)
def test_area_is_covered(preform, fabric):
    """Quadrants hold the outline, exactly if it fits, but for slivers at sharp corners else."""
    network = serial(preform, fabric)
    area = preform.outline.area
    assert (network.quadrant_area >= 0).all()
    assert network.covered_area() <= area * (1 + 1e-12)
    # A lost sliver is a part of one cell, and there are some three sharp corners.
    assert network.covered_area() > area - 0.5 * network.pitch.prod()
    assert network.statistics()["covered_area_m2"] == network.covered_area()


def test_area_of_outlines_that_fit():
    """Along yarns wherever they are cut, and along diagonals through crossovers."""
    for preform, fabric in (
        (diagonals(4, 6, refine=3), TABLE_1),
        (diagonals(5, 3), TABLE_1),
        (Preform.rectangle(0.0337, 0.0471, "90 deg", origin=(0.001, 0.002)), UNEVEN),
        (l_shape(0.0531, 0.0, origin=(0.0005, 0.0009)), UNEVEN),
    ):
        assert serial(preform, fabric).covered_area() == pytest.approx(
            preform.outline.area, rel=1e-12
        )


def test_edge_crossovers_of_a_fitting_bias_specimen():
    """They lie on the edge with two arms inside and half the area; corner tips have one arm."""
    network = serial(diagonals(4, 6))
    arms, cell = (network.arm_length > 0).sum(axis=1), network.pitch.prod()
    assert np.bincount(arms).tolist() == [0, 4, 2 * 3 + 2 * 5, 0, 39]
    area = network.quadrant_area.sum(axis=1) / cell
    np.testing.assert_allclose(area, np.array([0, 0.25, 0.5, 0, 1])[arms], rtol=1e-12)


def test_single_crossover():
    """The smallest network: four tails."""
    network = serial(Preform.rectangle(1.4 * PITCH, 1.4 * PITCH, 0.0))
    assert network.num_crossovers_global == 1
    assert network.num_nodes_global == 4
    np.testing.assert_allclose(network.arm_length, 0.7 * PITCH)
    assert not network.arm_is_shared.any()
    assert network.covered_area() == pytest.approx((1.4 * PITCH) ** 2, rel=1e-12)


def test_slot_cuts_a_yarn_between_two_crossovers():
    """Neighbours on either side of a slot have tails of their own, with nodes of their own."""
    slot = [(-1.2, 0.4), (1.2, 0.4), (1.2, 0.6), (-1.2, 0.6)]
    points = [(-3, -3), (3, -3), (3, 3), (-3, 3)]
    scale = np.array([PITCH, PITCH])
    preform = Preform.polygon(points * scale, [slot * scale], "0 deg", origin=(0.0, 0.0))
    network = serial(preform)
    assert network.num_crossovers_global == 49
    cut = (~network.arm_is_shared[:, 0]) & (network.arm_length[:, 0] > 0)
    assert network.crossover_ij[cut].tolist() == [[0, -1], [0, 0], [0, 1]]
    np.testing.assert_allclose(network.arm_length[cut, 0], 0.4 * PITCH)
    assert (
        network.num_nodes_global == 2 * 7 * 6 + 3 + 24
    )  # joints, doubled ones, hinges on the edge


# -- nodes -------------------------------------------------------------------------------------


def test_pack_key_sorts_by_family_yarn_and_place():
    """Also across zero, and the quarter of a pitch can be read back."""
    places = [(f, line, place) for f in (0, 1) for line in (-7, 0, 3) for place in (-9, -1, 0, 6)]
    keys = [int(pack_key(f, np.int64(line), np.int64(place))) for f, line, place in places]
    assert keys == sorted(keys)
    assert min(keys) > 0
    assert [key & 3 for key in keys] == [place % 4 for *_, place in places]
    assert [key >> 62 for key in keys] == [f for f, *_ in places]


@pytest.mark.parametrize(("preform", "fabric"), VARIOUS)
def test_nodes_are_numbered_along_the_yarns(preform, fabric):
    """Keys ascend; along one yarn positions do, too."""
    network = serial(preform, fabric)
    assert (np.diff(network.node_key) > 0).all()
    assert network.num_nodes_owned == network.num_nodes_local == network.num_nodes_global
    np.testing.assert_array_equal(network.node_number_global, np.arange(network.num_nodes_global))
    yarn = network.node_key >> 32
    lattice = (network.node_position - network.origin) @ preform.rotation.T / network.pitch
    same = np.diff(yarn) == 0
    along = lattice[np.arange(len(lattice)), network.node_family]
    assert (np.diff(along)[same] > 0).all()
    across = lattice[np.arange(len(lattice)), 1 - network.node_family]
    np.testing.assert_allclose(np.diff(across)[same], 0, atol=1e-9)


def test_statistics_and_repr():
    """Sizes and balance, told once."""
    network = serial(diagonals(4, 6))
    told = network.statistics()
    assert (told["crossovers"], told["nodes"]) == (59, network.num_nodes_global)
    assert (told["warp_yarns"], told["weft_yarns"]) == (11, 11)
    assert told["outline_area_m2"] == pytest.approx(24 * DIAGONAL**2)
    assert (told["imbalance"], told["cut_yarns"]) == (1.0, 0)
    assert told["crossovers_per_rank_min"] == told["crossovers_per_rank_max"] == 59
    assert told["joined_by_one_arm"] == 4
    assert "59 crossovers" in repr(network)
    assert "1 rank)" in repr(network)


# -- partition: not collective, so that one rank can try any number ------------------------------


SIZES = range(1, 65)
PARTED = [
    pytest.param(Preform.rectangle(0.024, 0.036, "45 deg", refine=6), id="rectangle"),
    pytest.param(Preform.rectangle(0.01, 0.3, "10 deg", refine=2), id="strip"),
    pytest.param(holed(0.1, 0.12, 0.03, 0.5), id="hole"),
    pytest.param(l_shape(0.12, 0.9), id="L"),
]


@pytest.mark.parametrize("preform", PARTED)
def test_partition(preform):
    """Each crossover is on exactly one rank, which owner() and the boxes agree on."""
    network = serial(preform)
    everyone = network.crossover_ij.astype(np.int64)
    for size in SIZES:
        partition = Partition(network.warp_yarns, size)
        owner = partition.owner(everyone)
        for rank in range(size):
            mine = partition.crossovers(network.warp_yarns, rank)
            np.testing.assert_array_equal(mine, everyone[owner == rank])
            np.testing.assert_array_equal(partition.in_box(everyone, rank), owner == rank)


@pytest.mark.parametrize("preform", PARTED)
def test_partition_is_balanced(preform):
    """The largest part exceeds the mean by at most half a row for each cut on the way to it."""
    network = serial(preform)
    count, extent = network.num_crossovers_global, np.ptp(network.crossover_ij, axis=0) + 1
    for size in SIZES:
        owner = Partition(network.warp_yarns, size).owner(network.crossover_ij.astype(np.int64))
        largest = np.bincount(owner, minlength=size).max()
        cuts = np.ceil(np.log2(size))
        assert largest <= count / size + cuts * 0.5 * extent.max()
    assert size == 64


def test_partition_of_a_large_network():
    """A quarter of a million crossovers, up to 64 ranks: the busiest has 3 % more than the mean."""
    network = serial(Preform.rectangle(0.9, 1.2, "37 deg", refine=2))
    assert network.num_crossovers_global > 240_000
    for size in (2, 3, 7, 16, 64):
        owner = Partition(network.warp_yarns, size).owner(network.crossover_ij.astype(np.int64))
        assert np.bincount(owner, minlength=size).max() * size / len(owner) < 1.03


@pytest.mark.parametrize("size", [60, 64, 200])
def test_more_ranks_than_crossovers(size):
    """Some ranks own nothing; every crossover still has its owner."""
    network = serial(diagonals(4, 6))
    partition = Partition(network.warp_yarns, size)
    counts = [len(partition.crossovers(network.warp_yarns, rank)) for rank in range(size)]
    assert sum(counts) == 59
    assert min(counts) == 0
    owner = partition.owner(network.crossover_ij.astype(np.int64))
    np.testing.assert_array_equal(np.bincount(owner, minlength=size), counts)


def test_partition_of_one_crossover():
    """All but one of the ranks are idle."""
    network = serial(Preform.rectangle(1.4 * PITCH, 1.4 * PITCH, 0.0))
    for size in (2, 3, 8):
        partition = Partition(network.warp_yarns, size)
        counts = [len(partition.crossovers(network.warp_yarns, rank)) for rank in range(size)]
        assert sorted(counts) == [0] * (size - 1) + [1]


def test_hundreds_of_holes():
    """Quarters of cells at the outline do not each look at all of it: a second, once a minute."""
    side = 0.2
    begin = time.process_time()
    corner = np.array([(0, 0), (1, 0), (1, 1), (0, 1)]) * 0.3 * side / 16
    grid = (np.indices((16, 16)).reshape(2, -1).T + 0.3) * side / 16 - [0.5 * side, 0.0]
    holes = (grid[:, None] + corner).tolist()
    preform = Preform.rectangle(side, side, "45 deg", holes=holes, refine=2)
    network = Network(MPI.COMM_SELF, preform, TABLE_1)
    assert network.covered_area() == pytest.approx(preform.outline.area, rel=1e-9)
    assert time.process_time() - begin < 8.0


def pulled(**options):
    """Load [N] and largest warp tension beside each yarn of 21, of a sheet pulled along its warp.

    Without shear stiffness yarns bear their own strain only: 0.2 N from end to end without cuts.
    """
    yarn = YarnFamily(1e4, 0.0, 1000.0, 1e-9)
    preform = Preform.rectangle("20 mm", "30 mm", "0 deg", **options)
    network = Network(MPI.COMM_SELF, preform, Fabric("soft", yarn, yarn, 1e-3))
    result = OffAxisTension(network, extension="0.03 mm", finite=False).solve()
    return network, result


def test_yarns_across_a_slit_are_cut():
    """Their tension is gone, the load is that of the others; along the yarns nothing changes."""
    network, result = pulled(slits=[[["0.5 mm", "10.5 mm"], ["0.5 mm", "20 mm"]]])
    assert network.num_crossovers_global == 21 * 31
    assert result.load == pytest.approx(0.2, rel=1e-4)  # a patch: 10 N/m all over
    np.testing.assert_allclose(result.fields["warp_tension"], 10.0, rtol=5e-4)
    for slit, cut in (
        ([["-4.5 mm", "15.4 mm"], ["4.5 mm", "15.4 mm"]], 9),
        ([["-3 mm", "13 mm"], ["0 mm", "16.4 mm"], ["3.4 mm", "12.7 mm"]], 7),
        ([["-4.5 mm", "15.4 mm"], ["14.5 mm", "15.4 mm"]], 14.5),  # from the edge, half a yarn
    ):
        network, result = pulled(slits=[slit])
        assert result.load == pytest.approx(0.2 * (1 - cut / 20), rel=2e-2)
        x, y = 1e3 * network.crossover_position.T
        across = (abs(x) < 2.5) & (y > 11.5) & (y < 17.5)
        assert across.sum() > 20
        assert abs(result.fields["warp_tension"][across]).max() < 0.2
    # A dart at the side takes out what it is wide.
    dart = [["11 mm", "10 mm"], ["11 mm", "20 mm"], ["4.5 mm", "15 mm"]]
    assert pulled(darts=[dart])[1].load == pytest.approx(0.2 * (1 - 5.5 / 20), rel=2e-2)
