# SPDX-License-Identifier: MIT
"""Files that a run leaves behind, read back by other programs."""

import csv
import json
import resource
from dataclasses import replace

import h5py
import numpy as np
import pytest
import shapely
from mpi4py import MPI
from support.vtkhdf import read_vtkhdf, times_of

from cruciform_petsc import BiasExtension, Biaxial, Fabric, Network, Preform
from cruciform_petsc.errors import InputError
from cruciform_petsc.output import pictures
from cruciform_petsc.output.paraview import ENERGIES, write, write_series, write_state
from cruciform_petsc.output.tables import write_csv, write_json, written_whole

COMM = MPI.COMM_SELF
LINE = {"line": ([1.0], [1.0])}
TABLE_1 = Fabric.from_library("e-glass-plain-2.4")
CIRCLE = np.asarray(shapely.Point(0.0, 0.04).buffer(0.0101).exterior.coords)


@pytest.fixture(scope="module")
def result():
    """A strip with a hole, pulled by 1 mm: some yarns are cut in two by the hole."""
    preform = Preform.rectangle("40 mm", "80 mm", holes=[CIRCLE[:-1]], refine=2)
    return BiasExtension(Network(COMM, preform, TABLE_1), extension="1 mm", finite=False).solve()


# -- tables ----------------------------------------------------------------------------------------


def test_csv_reads_back_exactly(tmp_path):
    """Numbers to the last bit; what is not finite is an empty field."""
    path = tmp_path / "curve.csv"
    load = np.array([0.1, 1 / 3, np.nan])
    write_csv(COMM, path, {"extension_mm": [1, 2.5, 3], "load_N": load})
    with path.open(newline="") as file:
        header, *rows = csv.reader(file)
    assert header == ["extension_mm", "load_N"]
    assert [float(row[1]) for row in rows[:2]] == load[:2].tolist()
    assert rows[0][0] == "1"
    assert rows[2] == ["3", ""]
    with pytest.raises(ValueError, match="shorter"):
        write_csv(COMM, path, {"a": [1, 2], "b": [1]})
    assert path.read_text().startswith("extension_mm"), "a failed write must leave the old file"


def test_json_of_numpy_values(tmp_path):
    """Numpy numbers and arrays become plain ones; not finite becomes null; paths become text."""
    path = tmp_path / "summary.json"
    data = {
        "crossovers": np.int64(59),
        "load_n": np.array([0.5, np.inf]),
        "energy_j": {"tension": np.float32(0.25), "shear": float("nan")},
        "ok": np.bool_(True),
        "folder": tmp_path,
        "title": "45° specimen",
        "pair": (1, None),
    }
    write_json(COMM, path, data)
    assert json.loads(path.read_text(encoding="utf-8")) == {
        "crossovers": 59,
        "load_n": [0.5, None],
        "energy_j": {"tension": 0.25, "shear": None},
        "ok": True,
        "folder": str(tmp_path),
        "title": "45° specimen",
        "pair": [1, None],
    }
    assert [p.name for p in tmp_path.iterdir()] == ["summary.json"]


def test_places_that_cannot_be_written(tmp_path, result):
    """One sentence that names the file, whatever is written; nothing is left behind."""
    write_json(COMM, tmp_path / "file", {})
    (tmp_path / "folder").mkdir()
    for place in ("none/x", "file/x", "folder"):
        path = tmp_path / place
        for attempt in (
            lambda path=path: write_json(COMM, path, {}),
            lambda path=path: write_csv(COMM, path, {"a": [1]}),
            lambda path=path: pictures.save(COMM, path, pictures.curves, LINE, ("x", "y")),
            lambda path=path: write_state(path, result),
            lambda path=path: write_series(path, result),
        ):
            with pytest.raises(InputError, match=f'"{path}" cannot be written: .'):
                attempt()
    assert {p.name for p in tmp_path.iterdir()} == {"file", "folder"}


def test_failure_half_way_keeps_the_old_file(tmp_path):
    """Also when the disk is full."""
    path = tmp_path / "x.txt"
    path.write_text("old")

    def write(problem):
        with written_whole(path) as temporary:
            temporary.write_text("half of the n")
            raise problem

    with pytest.raises(InputError, match="No space left"):
        write(OSError(28, "No space left on device"))
    with pytest.raises(KeyError):
        write(KeyError("x"))
    assert path.read_text() == "old"
    assert [p.name for p in tmp_path.iterdir()] == ["x.txt"]


@pytest.mark.parametrize("room", [0, 3000, 20_000])
def test_full_disk_within_a_vtkhdf_file(tmp_path, result, room):
    """A sentence, nothing is left, and HDF5 does not crash as the process ends."""
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    for write_any in (write_state, write_series):
        resource.setrlimit(resource.RLIMIT_FSIZE, (room, hard))
        try:
            with pytest.raises(InputError, match=r'x.vtkhdf" cannot be written: File too large'):
                write_any(tmp_path / "x.vtkhdf", result)
        finally:
            resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))
    assert list(tmp_path.iterdir()) == []


# -- ParaView --------------------------------------------------------------------------------------


def test_vtk_reads_the_network(tmp_path, result):
    """Counts, connectivity, bounds and values, against the network's own arrays."""
    network, fields, moved = result.network, result.fields, result.node_displacement
    path = tmp_path / "network.vtkhdf"
    write_state(path, result, {"title": "45° strip", "extension_m": 1e-3})
    points, lines, point, cell = read_vtkhdf(path)

    n = network.num_crossovers_owned
    ends = ~network.node_is_hinge
    has_arm = network.arm_length > 0
    assert len(points) == n + ends.sum()
    assert len(lines) == has_arm.sum()
    assert (lines[:, 0] < n).all()
    assert (lines[:, 1] >= n).all()
    assert point["crossover"].tolist() == list(range(n)) + [-1] * ends.sum()
    # An arm end joins two crossovers, or is where a yarn meets the outline.
    times = np.bincount(lines[:, 1], minlength=len(points))[n:]
    assert set(times) == {1, 2}
    assert (times == 2).sum() == network.arm_is_shared.sum() / 2
    shared = np.zeros(network.num_nodes_local, bool)
    shared[network.arm_node[network.arm_is_shared]] = True
    np.testing.assert_array_equal(times == 2, shared[point["node"][n:]])

    before = points - point["displacement_m"]
    length = np.linalg.norm(np.diff(before[lines], axis=1)[:, 0], axis=1)
    np.testing.assert_allclose(length, network.arm_length[has_arm], rtol=1e-9)
    np.testing.assert_allclose(before[:n, :2], network.crossover_position, atol=1e-15)
    np.testing.assert_allclose(points[:, 2], 0.0)
    x = np.concatenate([network.node_position + moved, before[:n, :2] + fields["displacement"]])
    np.testing.assert_allclose(points[:, :2].min(axis=0), x.min(axis=0), atol=1e-15)
    np.testing.assert_allclose(points[:, :2].max(axis=0), x.max(axis=0), atol=1e-15)
    assert points[:, 1].max() == pytest.approx(0.081)

    e, arm = np.nonzero(has_arm)
    family = arm % 2
    assert cell["yarn_family"].tolist() == family.tolist()
    tension = np.where(family == 0, fields["warp_tension"][e], fields["weft_tension"][e])
    shear = np.rad2deg(fields["shear_angle"])
    for name, expected in (
        ("tension_N_per_m", tension),
        ("strain", fields["arm_strain"][e, arm]),
        ("shear_angle_deg", shear[e]),
        ("crossover", e),
    ):
        np.testing.assert_allclose(cell[name], expected, rtol=1e-6, atol=1e-9, err_msg=name)
    np.testing.assert_allclose(point["shear_angle_deg"][:n], shear, rtol=1e-6, atol=1e-9)
    for name in ENERGIES:
        assert cell[f"{name}_J"].sum() == pytest.approx(fields[name].sum(), rel=1e-5), name
    # At an arm end: the mean of the crossovers whose arms end there.
    node = np.flatnonzero(times == 2)[7] + n
    expected = cell["shear_angle_deg"][lines[:, 1] == node].mean()
    assert point["shear_angle_deg"][node] == pytest.approx(expected, rel=1e-5)
    with h5py.File(path) as file:
        attributes = file["VTKHDF"].attrs
        assert attributes["title"].decode() == "45° strip"
        assert attributes["extension_m"] == 1e-3


@pytest.fixture(scope="module")
def curve():
    """The same strip at finite deformation, twice."""
    network = Network(COMM, Preform.rectangle("40 mm", "80 mm", holes=[CIRCLE[:-1]]), TABLE_1)
    return BiasExtension(network, extension=["2 mm", "6 mm"], finite=True).solve()


def test_vtk_reads_cloth_in_space(tmp_path):
    """Heights and the energy of bending out of the plane; a curve has the largest height."""
    preform = Preform.rectangle("30 mm", "40 mm", 0.0)
    result = Biaxial(
        Network(COMM, preform, TABLE_1), "0.5 %", ratio=-1, finite=True, space=True,
        imperfection={"height": "0.1 mm", "seed": 2},
    ).solve()  # fmt: skip
    write_state(tmp_path / "network.vtkhdf", result)
    points, _, point, cell = read_vtkhdf(tmp_path / "network.vtkhdf")
    assert abs(points[:, 2]).max() > 2e-5
    np.testing.assert_allclose(point["displacement_m"][:, 2], points[:, 2], atol=1e-15)
    energy = cell["out_of_plane_bending_energy_J"].sum()
    assert energy == pytest.approx(result.energies()["out_of_plane_bending"][-1], rel=1e-5)
    height = abs(result.fields["displacement"][:, 2]).max()
    assert result.curve()["height_max_mm"][-1] == pytest.approx(1e3 * height)


def test_vtk_reads_a_series(tmp_path, curve):
    """Each state, from rest on, is what a file of its own has; time is the extension in mm."""
    path = tmp_path / "series.vtkhdf"
    write(curve, path)
    steps = [1e3 * increment.control for increment in curve.increments]
    assert len(steps) > 2
    assert times_of(path) == pytest.approx((0.0, *steps))
    for index, time in enumerate((2.0, 6.0)):
        single = tmp_path / "single.vtkhdf"
        write_state(single, curve, index=index)
        of_series, of_single = read_vtkhdf(path, time), read_vtkhdf(single)
        for a, b in zip(of_series[:2], of_single[:2], strict=True):
            np.testing.assert_array_equal(a, b)
        for a, b in zip(of_series[2:], of_single[2:], strict=True):
            assert a.keys() == b.keys()
            for name in a:
                np.testing.assert_array_equal(a[name], b[name], err_msg=name)
    points, _, point, cell = read_vtkhdf(path, 0.0)
    network = curve.network
    n = network.num_crossovers_owned
    np.testing.assert_allclose(points[:n, :2], network.crossover_position, atol=1e-15)
    assert not point["displacement_m"].any()
    assert not any(
        cell[name].any()
        for name in (*(f"{e}_J" for e in ENERGIES), "shear_angle_deg", "tension_N_per_m")
    )
    assert cell["carrying"].all()
    with h5py.File(path) as file:
        assert file["VTKHDF"].attrs["time_is"].decode() == "extension_mm"
        # What does not change is there once.
        assert len(file["VTKHDF/CellData/yarn_family"]) == len(cell["yarn_family"])


def test_series_that_turns_back(tmp_path, curve):
    """VTK wants ascending times: then they are the numbers of the states."""
    path = tmp_path / "series.vtkhdf"
    back = replace(curve, states=curve.states[::-1], increments=[], state_after=None)
    write_series(path, back)
    assert times_of(path) == (0.0, 1.0, 2.0)
    points, *_ = read_vtkhdf(path, 2.0)
    assert points[:, 1].max() == pytest.approx(0.082)
    with h5py.File(path) as file:
        assert file["VTKHDF"].attrs["time_is"].decode() == "state"
        assert file["VTKHDF"].attrs["controls"].tolist() == pytest.approx([0.0, 6.0, 2.0])
