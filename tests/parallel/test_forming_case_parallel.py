# SPDX-License-Identifier: MIT
"""Forming on several ranks: fields, forces and files as on one."""

import csv
import re

import numpy as np
import pytest
import shapely
from mpi4py import MPI
from support.exported import read_table
from support.forming import CASE, formed, written

from cruciform_petsc.case.schema import Case
from cruciform_petsc.cli import main
from cruciform_petsc.errors import InputError
from cruciform_petsc.forming.measures import shear_figures
from cruciform_petsc.forming.waves import Waves
from cruciform_petsc.net.network import Network
from cruciform_petsc.output.exports import export_formed
from cruciform_petsc.output.formed import view_of
from cruciform_petsc.output.pattern import mapped_back
from cruciform_petsc.output.view import packed

COMM = MPI.COMM_WORLD
STROKE = 6e-3
pytestmark = pytest.mark.three_ranks


def shared(folder, *changes):
    """The case's path on every rank, once it is written."""
    path = written(folder, *changes) if COMM.rank == 0 else folder / "cup.toml"
    COMM.barrier()
    return path


def test_view_is_that_of_one_rank(tmp_path):
    """All crossovers, joined as on one rank; rank 0 has them."""
    path = shared(tmp_path)
    forming, result = formed(COMM, path)
    view = view_of(forming, result)
    assert len(view.captions) == 4
    if COMM.rank == 0:
        one = view_of(*formed(MPI.COMM_SELF, path))
        ours, theirs = (
            np.array(sorted(map(tuple, v.surfaces[-1].points.round(6)))) for v in (view, one)
        )
        np.testing.assert_allclose(ours, theirs, atol=1e-5)
        assert len(view.surfaces[-1].triangles) == len(one.surfaces[-1].triangles)
        assert len(view.surfaces[-1].yarns) == len(one.surfaces[-1].yarns)
        packed(view)
    else:
        assert all(len(surface.points) == 0 for surface in view.surfaces)


def test_fields_are_those_of_one_rank(tmp_path):
    path = shared(tmp_path)
    forming, result = formed(COMM, path)
    alone, formed_alone = formed(MPI.COMM_SELF, path)
    expected = formed_alone
    assert [s.increment.control for s in result.steps] == [
        s.increment.control for s in expected.steps
    ]
    state, one = result.states[-1], expected.states[-1]
    fields = forming.blank.ply.fields(forming.blank.of_cloth(state))
    known = alone.blank.ply.fields(alone.blank.of_cloth(one))
    order = np.argsort(alone.network.crossover_number_global)
    number = forming.network.crossover_number_global
    moved = known["displacement"][order][number]
    np.testing.assert_allclose(fields["displacement"], moved, rtol=0, atol=1e-6 * STROKE)
    for name, force in expected.steps[-1].tool_force.items():
        np.testing.assert_allclose(result.steps[-1].tool_force[name], force, rtol=0, atol=1e-5)
    figures = shear_figures(forming.blank, fields)
    assert figures == pytest.approx(shear_figures(alone.blank, known), abs=1e-4)
    waves, expected = (Waves.of(f.blank, s) for f, s in ((forming, state), (alone, one)))
    for name in ("normal", "curvature", "height", "bridging"):
        values, all_values = getattr(waves, name), getattr(expected, name)[order][number]
        np.testing.assert_allclose(values, all_values, rtol=1e-3, atol=1e-6, err_msg=name)
    told = waves.figures(forming.blank, fields)["wrinkles"]
    wanted = expected.figures(alone.blank, known)["wrinkles"]
    assert told["largest_height_mm"] == pytest.approx(wanted["largest_height_mm"], abs=1e-3)
    assert told["area_share"] == pytest.approx(wanted["area_share"], abs=0.02)
    part = shapely.Point(0.0, 0.0).buffer(18e-3)
    (ours, _), (theirs, _) = (mapped_back(f, s, part) for f, s in ((forming, state), (alone, one)))
    if COMM.rank == 0:
        np.testing.assert_allclose(ours, theirs, rtol=0, atol=1e-6 * STROKE)
    else:
        assert len(ours) == 0
    for folder in ("many", "one"):
        (tmp_path / folder).mkdir(exist_ok=True)
    files = export_formed(tmp_path / "many", forming, state)
    if COMM.rank == 0:
        known = export_formed(tmp_path / "one", alone, one)
        table, all_table = read_table(files[0]), read_table(known[0])
        assert list(table) == list(all_table)
        for name, values in all_table.items():
            np.testing.assert_allclose(table[name], values, rtol=0, atol=1e-4, err_msg=name)
        for path, other in zip(files[1:], known[1:], strict=True):
            pieces = [re.split(r"[\d.e+ -]+", p.read_text()) for p in (path, other)]
            assert pieces[0] == pieces[1], path.name
    moments = (s.steps[-1].tool_moment["holder"] for s in (result, formed_alone))
    np.testing.assert_allclose(*moments, rtol=0, atol=1e-5)


def test_files_are_those_of_one_rank(tmp_path):
    """fields.csv in one order, whatever the ranks."""
    path = shared(tmp_path)
    if COMM.rank == 0:
        path.write_text(f"{CASE}[output]\npictures = false\n")
    COMM.barrier()
    assert main(["run", str(path), "--output", str(tmp_path / "out"), "--quiet"]) == 0
    if COMM.rank == 0:
        with (tmp_path / "out" / "fields.csv").open() as file:
            rows = list(csv.DictReader(file))
        assert [int(row["crossover"]) for row in rows] == list(range(len(rows)))
        assert (tmp_path / "out" / "tools.vtkhdf").stat().st_size > 10_000


def test_a_tool_in_the_cloth_is_refused_on_all(tmp_path):
    """One sentence, the same on every rank, though one rank only may own the place."""
    place = 'shaft = true } }\nplace = ["20 mm", "20 mm", "10 mm"]'
    case = Case.load_collective(COMM, shared(tmp_path, ("shaft = true } }", place)))
    network = Network(COMM, case.preform(), case.fabric())
    with pytest.raises(InputError, match='tool "punch" starts .* deep in the cloth') as caught:
        case.forming(network)
    assert len(set(COMM.allgather(str(caught.value)))) == 1


def test_a_quarter_with_clamps_under_suction(tmp_path):
    """Planes of symmetry, springs that slip, a held edge, suction, a cut: as on one rank."""
    first = '[[stage]]\nname = "close"'
    clamps = (
        '[[clamp]]\nedge = "right"\nstiffness = "0.1 N/mm/mm"\npreload = "0.5 N"\n'
        'friction_limit = "0.9 N"\n[[clamp]]\nedge = "upper"\n'
    )
    path = shared(
        tmp_path,
        ('["56 mm", "56 mm"]', '["28 mm", "28 mm"]'),
        ('kind = "forming"', 'kind = "forming"\nsymmetry = ["left", "lower"]'),
        ('"5 N"', '"1.25 N"'),
        (first, f'{clamps}[[stage]]\nname = "suck"\nsuction = "2 kPa"\n{first}'),
    )
    if COMM.rank == 0:
        trim = (
            '[[stage]]\nname = "trim"\nsuction = "0 Pa"\ntrim = { radius = "22 mm" }\nstep = 0.5\n'
        )
        path.write_text(path.read_text() + trim)
    COMM.barrier()
    (forming, result), (alone, expected) = formed(COMM, path), formed(MPI.COMM_SELF, path)
    for step, one in zip(result.steps, expected.steps, strict=True):
        for edge, force in one.clamp_force.items():
            np.testing.assert_allclose(step.clamp_force[edge], force, rtol=0, atol=1e-5)
        assert dict(step.load_work) == pytest.approx(dict(one.load_work), rel=1e-5, abs=1e-9)
    far = forming.blank.slipped(result.states[-1])[0]
    assert far["right"] > 1e-4
    assert far == pytest.approx(alone.blank.slipped(expected.states[-1])[0], abs=1e-8)
    state, one = result.states[-1], expected.states[-1]
    moved = forming.blank.ply.fields(forming.blank.of_cloth(state))["displacement"]
    known = alone.blank.ply.fields(alone.blank.of_cloth(one))["displacement"]
    order = np.argsort(alone.network.crossover_number_global)
    number = forming.network.crossover_number_global
    np.testing.assert_allclose(moved, known[order][number], rtol=0, atol=1e-6 * STROKE)
