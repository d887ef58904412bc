# SPDX-License-Identifier: MIT
"""Formed cloth for other programs, read back: Abaqus, CalculiX, OpenRadioss, a table of cells."""

from types import SimpleNamespace

import numpy as np
import pytest
from mpi4py import MPI
from support.exported import read_input_file, read_table
from support.formed import Gripped, cloth, network
from support.forming import CASE, written

from cruciform_petsc.cli import main
from cruciform_petsc.errors import InputError
from cruciform_petsc.output.exports import export_formed
from cruciform_petsc.tools import shapes
from cruciform_petsc.tools.tool import Tool

RADIUS = 50e-3
HEAVY = cloth(fibre_density="2.5 g/cm^3")
SHEARED = np.array([[1.0, np.sin(0.4)], [0.0, np.cos(0.4)]])  # by 0.4 rad, along warp at 0 deg


def on_cylinder(rest):
    """Sheared, and around a cylinder about y, up to walls that stand upright."""
    flat = rest[:, :2] @ SHEARED.T
    phi = flat[:, 0] / RADIUS
    return np.stack([RADIUS * np.sin(phi), flat[:, 1], RADIUS * np.cos(phi)], axis=1)


def exported(folder, comm=MPI.COMM_SELF, fabric=HEAVY, hold=None, **options):
    tools = [Tool("plate", shapes.plane(), 0.0)]
    net = network((150, 60), fabric, "90 deg", comm=comm, yarns_per_cruciform=2, **options)
    blank = Gripped(net, tools, shape=on_cylinder)
    forming = SimpleNamespace(network=net, blank=blank, kind="forming", suffix="")
    folder.mkdir(exist_ok=True)
    more = {} if hold is None else {"hold": hold}
    return export_formed(folder, forming, blank.start(), **more), net


@pytest.fixture(scope="module")
def files(tmp_path_factory):
    (table, shells, ccx, rad), net = exported(tmp_path_factory.mktemp("exports"))
    return SimpleNamespace(
        table=read_table(table), shells=read_input_file(shells), ccx=read_input_file(ccx),
        rad=rad, net=net,
    )  # fmt: skip


def vectors(table, name):
    return np.column_stack([table[f"{name}_{axis}"] for axis in "xyz"])


def test_table_of_cells(files):
    """Directions in the surface, shear of 0.4 rad, thickness 1/cos of it, normals outwards."""
    table = files.table
    np.testing.assert_allclose(table["shear_deg"], np.rad2deg(0.4), rtol=5e-3)
    np.testing.assert_allclose(table["thickness_mm"], 1.0 / np.cos(0.4), rtol=5e-3)
    np.testing.assert_allclose(table["fibre_volume_fraction"], 0.2, rtol=1e-9)
    normal = vectors(table, "normal")
    place = np.column_stack([table[f"{axis}_mm"] for axis in "xyz"])
    outwards = place * [1, 0, 1] / np.hypot(place[:, 0], place[:, 2])[:, None]
    np.testing.assert_allclose(normal, outwards, atol=2e-2)
    hoop = np.cross([0.0, 1.0, 0.0], outwards)
    # The warp ran along x, which is the hoop now.
    np.testing.assert_allclose(vectors(table, "warp"), hoop, atol=2e-2)
    weft = np.sin(0.4) * hoop + [0.0, np.cos(0.4), 0.0]
    np.testing.assert_allclose(vectors(table, "weft"), weft, atol=2e-2)


def test_abaqus_shells(files):
    """Elements, directions and thickness are those of the table; corners go round the normal."""
    deck, table = files.shells, files.table
    assert list(deck.element) == table["cell"].tolist()
    axes = np.array([deck.distribution["YARN_AXES"][e] for e in deck.element])
    np.testing.assert_allclose(axes[:, :3], vectors(table, "warp"), atol=1e-8)
    np.testing.assert_allclose(axes[:, 3:], vectors(table, "weft"), atol=1e-8)
    angle = np.array([deck.distribution["WEFT_ANGLE"][e][0] for e in deck.element])
    np.testing.assert_allclose(angle, 90.0 - table["shear_deg"], atol=1e-6)
    thickness = np.array([deck.distribution["THICKNESS"][e][0] for e in deck.element])
    np.testing.assert_allclose(thickness, table["thickness_mm"], rtol=1e-8)
    for row, corner in enumerate(deck.element.values()):
        place = np.array([deck.node[n] for n in corner])
        round_ = np.cross(place[2] - place[0], place[-1] - place[1 % len(place)])
        assert round_ @ vectors(table, "normal")[row] > 0.0
    assert set(deck.field) == {1, 2}


def test_calculix_bricks(files):
    """Two layers: their volume is the cloth's, the first direction their yarns', bricks upright."""
    deck, table = files.ccx, files.table
    names = [name for name, _, _ in deck.keywords]
    assert "DISTRIBUTION TABLE" not in names  # CalculiX has none
    assert names.count("SOLID SECTION") == 2
    assert set(deck.kind.values()) == {"C3D8I"}
    axes = deck.distribution["YARN_AXES"]
    for row, cell in enumerate(table["cell"].astype(int)):
        for element, name in ((2 * cell - 1, "warp"), (2 * cell, "weft")):
            np.testing.assert_allclose(axes[element][:3], vectors(table, name)[row], atol=1e-8)
            across = np.cross(axes[element][:3], axes[element][3:])
            assert across @ vectors(table, "normal")[row] > 0.5
    volume = 0.0
    for corner in deck.element.values():
        place = np.array([deck.node[n] for n in corner])
        below, above = place[:4], place[4:]
        side = np.cross(below[1] - below[0], below[3] - below[0])
        height = (above - below).mean(axis=0)
        assert side @ height > 0.0
        volume += (
            0.5
            * np.linalg.norm(np.cross(below[2] - below[0], below[3] - below[1]))
            * (np.linalg.norm(height))
        )
    assert volume == pytest.approx(len(table["cell"]) * 1.0 * (2e3 / 240) ** 2, rel=2e-2)


def drapes(path):
    """Of each ply: element -> kind, thinning, angle in degrees; the vector V; nodes, shells."""
    plies, nodes, shells, block, vector, lines = {}, {}, {}, "", None, path.read_text().splitlines()
    for k, line in enumerate(lines):
        if line.startswith("/"):
            block = line
            vector = lines[k + 5] if line.startswith("/PROP/TYPE51") else vector
        elif line.startswith("#"):
            continue
        elif block == "/NODE":
            nodes[int(line[:10])] = [float(line[10 + 20 * i : 30 + 20 * i]) for i in range(3)]
        elif block.startswith(("/SHELL", "/SH3N")):
            numbers = [int(line[i : i + 10]) for i in range(0, len(line), 10)]
            shells[numbers[0]] = numbers[1:]
        elif block.startswith("/DRAPE") and line[:5].strip() in ("SHELL", "SH3N"):
            values = float(line[20:40]), float(line[40:60])
            plies.setdefault(block, {})[int(line[10:20])] = (line[:10].strip(), *values)
    return plies, np.array([float(vector[i : i + 20]) for i in (0, 20, 40)]), nodes, shells


def test_openradioss_drape(files):
    """V laid into the shell and turned about its normal by the angle is the yarn; thinning."""
    plies, vector, nodes, shells = drapes(files.rad)
    table = files.table
    assert list(plies) == ["/DRAPE/1", "/DRAPE/2"]
    assert abs(vector).max() == 1.0
    for ply, name in zip(plies.values(), ("warp", "weft"), strict=True):
        for row, cell in enumerate(table["cell"].astype(int)):
            kind, thinning, angle = ply[cell]
            assert kind == "SHELL"
            assert thinning == pytest.approx(table["thickness_mm"][row], rel=1e-8)
            place = np.array([nodes[n] for n in shells[cell]])
            normal = np.cross(place[2] - place[0], place[3] - place[1])
            normal /= np.linalg.norm(normal)
            laid = vector - (vector @ normal) * normal
            laid /= np.linalg.norm(laid)
            c, s = np.cos(np.deg2rad(angle)), np.sin(np.deg2rad(angle))
            turned = c * laid + s * np.cross(normal, laid)
            np.testing.assert_allclose(turned, vectors(table, name)[row], atol=1e-6)


def test_constant_thickness_and_missing_data(tmp_path):
    (table, *_), _ = exported(tmp_path / "held", hold="thickness")
    columns = read_table(table)
    np.testing.assert_allclose(columns["thickness_mm"], 1.0)
    np.testing.assert_allclose(columns["fibre_volume_fraction"], 0.2 / np.cos(0.4), rtol=5e-3)
    (table, deck, *_), _ = exported(tmp_path / "light", fabric=cloth())
    assert np.isnan(read_table(table)["fibre_volume_fraction"]).all()
    assert set(read_input_file(deck).field) == {1}
    with pytest.raises(InputError, match="hold must be"):
        exported(tmp_path / "held", hold="mass")


def test_other_readers_find_the_mesh(files, tmp_path):
    meshio = pytest.importorskip("meshio")
    for path, kind in (("preform.inp", "quad"), ("preform_ccx.inp", "hexahedron")):
        mesh = meshio.read(files.rad.parent / path)
        cells = len(files.table["cell"])
        found = sum(len(block.data) for block in mesh.cells if block.type == kind)
        assert found == (cells if kind == "quad" else 2 * cells)


def test_case_file(tmp_path):
    """`[output] exports = true` of a forming."""
    path = written(tmp_path)
    path.write_text(f"{CASE}[output]\npictures = false\nparaview = false\nexports = true\n")
    assert main(["run", str(path), "--output", str(tmp_path / "out"), "--quiet"]) == 0
    table = read_table(tmp_path / "out" / "cells.csv")
    assert len(table["cell"]) == 12 * 12
    fields = read_table(tmp_path / "out" / "fields.csv")
    largest = abs(fields["shear_deg"]).max()
    assert 0.7 * largest < abs(table["shear_deg"]).max() < largest + 1.0
    names = {p.name for p in (tmp_path / "out").iterdir()}
    assert {"preform.inp", "preform_ccx.inp", "preform_0000.rad"} < names
