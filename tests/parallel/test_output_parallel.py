# SPDX-License-Identifier: MIT
"""Files of a network that lies on several ranks."""

import resource
from types import SimpleNamespace

import numpy as np
import pytest
import shapely
from mpi4py import MPI
from support.vtkhdf import read_vtkhdf, times_of

from cruciform_petsc import BiasExtension, Fabric, Network, Preform
from cruciform_petsc.errors import InputError
from cruciform_petsc.experiments.result import State, TestResult
from cruciform_petsc.output import figures, pictures
from cruciform_petsc.output.paraview import ENERGIES, write, write_series, write_state
from cruciform_petsc.output.sample import sample_map, sample_yarns
from cruciform_petsc.output.tables import write_csv, write_json
from cruciform_petsc.quantities import EXTENSION

COMM = MPI.COMM_WORLD
TABLE_1 = Fabric.from_library("e-glass-plain-2.4")
pytestmark = pytest.mark.three_ranks


def solved(comm):
    """A strip with a hole, pulled by 1 mm."""
    hole = np.asarray(shapely.Point(0.0, 0.04).buffer(0.0101).exterior.coords)[:-1]
    preform = Preform.rectangle("40 mm", "80 mm", "40 deg", holes=[hole])
    return BiasExtension(Network(comm, preform, TABLE_1), extension="1 mm", finite=False).solve()


@pytest.fixture(scope="module")
def result():
    return solved(COMM)


@pytest.fixture(scope="module")
def alone():
    """The same on each rank by itself."""
    return solved(MPI.COMM_SELF)


def test_vtk_reads_what_the_ranks_wrote(tmp_path, result, alone):
    """The network is there once, whoever wrote it; only ends on borders are doubled."""
    path = tmp_path / "network.vtkhdf"
    network = result.network
    write_state(path, result, {"ranks": COMM.size})
    ghosts = network.comm.allreduce(network.num_nodes_local - network.num_nodes_owned)
    if COMM.rank > 0:
        return
    assert [p.name for p in tmp_path.iterdir() if p.name.startswith(".")] == []
    points, lines, point, cell = read_vtkhdf(path)

    one, fields = alone.network, alone.fields
    n = one.num_crossovers_global
    has_arm = one.arm_length > 0
    hinge = point["crossover"] >= 0
    assert np.sort(point["crossover"][hinge]).tolist() == list(range(n))
    assert len(points) == n + (~one.node_is_hinge).sum() + ghosts
    assert len(lines) == has_arm.sum()
    assert (np.unique(cell["rank"]) == np.arange(COMM.size)).all()
    assert hinge[lines[:, 0]].all()
    assert not hinge[lines[:, 1]].any()

    # Every arm end between two crossovers is shared, also where they are on two ranks.
    name = point["node"][lines[:, 1]]
    assert (np.bincount(name) == 2).sum() == one.arm_is_shared.sum() / 2
    assert np.bincount(name).max() == 2
    # Copies of an end agree: the same place, the same values.
    _, first, copy = np.unique(point["node"][~hinge], return_index=True, return_inverse=True)
    for values in (points, point["displacement_m"], point["shear_angle_deg"]):
        np.testing.assert_array_equal(values[~hinge][first][copy], values[~hinge])

    # Fields as on one rank, by the crossovers' numbers.
    scale = abs(alone.node_displacement).max()
    at = point["crossover"][hinge]
    moved = points[hinge, :2] - one.crossover_position[at]
    np.testing.assert_allclose(moved, fields["displacement"][at], atol=1e-8 * scale)
    shear = np.rad2deg(fields["shear_angle"])
    np.testing.assert_allclose(point["shear_angle_deg"][hinge], shear[at], atol=1e-5)
    for energy in ENERGIES:
        by_crossover = np.bincount(cell["crossover"], weights=cell[f"{energy}_J"], minlength=n)
        tolerance = 1e-5 * fields[energy].max()
        np.testing.assert_allclose(by_crossover, fields[energy], atol=tolerance, err_msg=energy)


def test_vtk_reads_a_series_of_the_ranks(tmp_path):
    """Step by step what the ranks write for a state alone; no rank gathers."""
    network = Network(COMM, Preform.rectangle("40 mm", "80 mm", "45 deg"), TABLE_1)
    result = BiasExtension(network, ["2 mm", "6 mm"], finite=True).solve()
    path = COMM.bcast(tmp_path) / "series.vtkhdf"
    write(result, path)
    single = path.with_name("single.vtkhdf")
    for index, time in enumerate((2.0, 6.0)):
        write_state(single, result, index=index)
        if COMM.rank == 0:
            steps = [1e3 * increment.control for increment in result.increments]
            assert times_of(path) == pytest.approx((0.0, *steps))
            of_series, of_single = read_vtkhdf(path, time), read_vtkhdf(single)
            for a, b in zip(of_series[:2], of_single[:2], strict=True):
                np.testing.assert_array_equal(a, b)
            for a, b in zip(of_series[2:], of_single[2:], strict=True):
                assert a.keys() == b.keys()
                for name in a:
                    np.testing.assert_array_equal(a[name], b[name], err_msg=name)
            assert len(np.unique(of_series[3]["rank"])) == COMM.size
        COMM.Barrier()


def test_ranks_without_crossovers(tmp_path):
    """They have no part in the file, but write it with the others."""
    preform = Preform.rectangle("4.2 mm", "4.2 mm", "0 deg")
    network = Network(COMM, preform, TABLE_1)
    assert network.num_crossovers_global == 1
    n = network.num_crossovers_owned
    names = ("shear_angle", "warp_tension", "weft_tension", *ENERGIES)
    fields = {name: np.full(n, 0.5) for name in names}
    fields |= {"displacement": np.zeros((n, 2)), "arm_strain": np.zeros((n, 4))}
    fields["carrying"] = np.ones(n, bool)
    moved = np.zeros((network.num_nodes_local, 2))
    path = tmp_path / "one.vtkhdf"
    experiment = SimpleNamespace(network=network, column=EXTENSION)
    states = [State(0.001 * i, 0.0, fields, moved + 0.001 * i) for i in (0, 1, 2)]
    write_state(path, TestResult(experiment, None, 2, states), index=0)
    series = tmp_path / "series.vtkhdf"
    write_series(series, TestResult(experiment, None, 2, states[1:]))
    yarns = sample_yarns(network, moved, fields)
    cells = sample_map(network, {"shear": fields["shear_angle"]})
    if COMM.rank == 0:
        points, lines, _, cell = read_vtkhdf(path)
        assert len(points) == 5
        assert len(lines) == 4
        assert cell["shear_energy_J"].sum() == pytest.approx(0.5)
        later, _, _, cell = read_vtkhdf(series, 2.0)
        assert np.ptp(later - points, axis=1) == pytest.approx([0.0] + [0.002] * 4)
        assert cell["shear_energy_J"].sum() == pytest.approx(0.5)
        assert len(yarns.first) == 2
        assert len(yarns.before) == 6
        assert cells.values["shear"].tolist() == [0.5]


@pytest.mark.parametrize("limit", [10_000, 60])
def test_samples_do_not_depend_on_the_ranks(result, alone, limit):
    """The same yarns and cells as from one rank, on rank 0, and None on the others."""
    samples, maps = [], []
    for r in (result, alone):
        samples.append(sample_yarns(r.network, r.node_displacement, r.fields, limit))
        height = r.network.crossover_position[:, 1]
        maps.append(sample_map(r.network, {"y": height, "shear": r.fields["shear_angle"]}, limit))
    if COMM.rank > 0:
        assert samples[0] is None
        assert maps[0] is None
        return
    many, one = samples
    assert many.every == one.every
    np.testing.assert_array_equal(many.first, one.first)
    np.testing.assert_array_equal(many.family, one.family)
    np.testing.assert_allclose(many.before, one.before, atol=1e-12)
    np.testing.assert_allclose(many.after, one.after, atol=1e-10)
    np.testing.assert_allclose(many.values, one.values, atol=1e-5)
    many, one = maps
    np.testing.assert_allclose(many.centre, one.centre, atol=1e-12)
    np.testing.assert_array_equal(many.at_outline, one.at_outline)
    for name in ("y", "shear"):
        np.testing.assert_allclose(many.values[name], one.values[name], atol=1e-7)


def test_errors_reach_every_rank(tmp_path, result):
    """No rank waits for one that could not write."""
    path = tmp_path / "none" / "x"
    for attempt in (
        lambda: write_state(path, result),
        lambda: write_csv(COMM, path, {"a": [1]}),
        lambda: write_json(COMM, path, {"a": 1}),
        lambda: pictures.save(COMM, path, pictures.curves, {"a": ([1.0], [1.0])}, ("x", "y")),
    ):
        with pytest.raises(InputError, match="cannot be written: No such file"):
            attempt()


@pytest.mark.parametrize("rank", [0, -1])
def test_full_disk_on_a_rank(tmp_path, result, rank):
    """Within a file that all write."""
    path = COMM.bcast(tmp_path) / "x.vtkhdf"
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    if COMM.rank == rank % COMM.size:
        resource.setrlimit(resource.RLIMIT_FSIZE, (3000, hard))
    try:
        with pytest.raises(InputError, match=r'x.vtkhdf" cannot be written: File too large'):
            write_state(path, result)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))
    COMM.Barrier()
    assert list(path.parent.iterdir()) == []


def test_pictures_need_their_data_on_rank_0_only(tmp_path, result):
    sample = sample_yarns(result.network, result.node_displacement, result.fields)
    shear = sample_map(result.network, {"network": result.fields["shear_angle"]})
    pictures.save(COMM, tmp_path / "yarns.png", pictures.yarns, [("", sample, np.empty((0, 2, 2)))])
    pictures.save(COMM, tmp_path / "map.png", pictures.maps, shear)
    figures.scene(result, tmp_path / "scene.png")
    for name in ("yarns.png", "map.png", "scene.png"):
        assert (tmp_path / name).exists()
