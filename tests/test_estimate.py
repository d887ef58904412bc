# SPDX-License-Identifier: MIT
"""What a case would take is told, or refused, before anything of it is made."""

import re
import time

import pytest
from mpi4py import MPI
from support.forming import written

from cruciform_petsc import memory
from cruciform_petsc.case.schema import Case
from cruciform_petsc.errors import InputError
from cruciform_petsc.estimate import check_work, estimate, time_text
from cruciform_petsc.net.network import Network

CASE = """
[fabric]
use = "e-glass-plain-2.4"
[preform]
outline = { rectangle = ["100 mm", "200 mm"] }
bias_angle = "45 deg"
[test]
kind = "bias-extension"
extension = ["1 mm", "2 mm"]
finite = false
"""


def case(tmp_path, *overrides):
    path = tmp_path / "case.toml"
    path.write_text(CASE)
    return Case.load(path, overrides)


@pytest.fixture(autouse=True)
def machine(monkeypatch):
    """One of 16 GB, wherever the tests run."""
    monkeypatch.setattr(memory, "machine_memory", lambda: 16e9)


@pytest.mark.parametrize(
    ("overrides", "message"),
    [
        (
            ["continuum.compare=true", 'continuum.mesh_size="1 um"'],
            r"the membrane has about 8e\+10 triangles and 7.2e\+11 unknowns, which "
            r"would need about \d+ TB of memory "
            r"where there are 16 GB, choose a larger continuum.mesh_size",
        ),
        (
            ["continuum.compare=true", 'continuum.mesh_size="1e-12 m"', "test.finite=true"],
            r"the membrane has about 8e\+22 triangles",
        ),
        (
            ["continuum.ladder=[1, 1000000000]"],
            r"refine = 1000000000 of continuum.ladder has about 1.15e\+21 cross.* leave it out",
        ),
        (["continuum.ladder=[1, 90]"], "refine = 90 of continuum.ladder has about 9,330,000 cross"),
        (["preform.refine=100000"], r"the test has about 1.15e\+13 crossovers.* coarser pitch"),
        (
            ["test.finite=true", "preform.refine=40", "test.increments=100000"],
            "the test has about .* which would take about .* days on 1 rank: "
            "choose a coarser pitch .* or fewer increments or more ranks",
        ),
    ],
    ids=str,
)
def test_refused_before_anything_is_made(tmp_path, overrides, message):
    made, begin = case(tmp_path, *overrides), time.perf_counter()
    with pytest.raises(InputError, match=message):
        check_work(MPI.COMM_SELF, made)
    assert time.perf_counter() - begin < 0.5


def test_states_that_are_kept(tmp_path, monkeypatch):
    """A list of 9,000 extensions is as many states in memory."""
    extensions = ", ".join(f'"{i} um"' for i in range(1, 9_001))
    made = case(tmp_path, f"test.extension=[{extensions}]", "preform.refine=6")
    with pytest.raises(InputError, match="the test has about .* crossovers .* GB of memory"):
        check_work(MPI.COMM_SELF, made)


def test_what_is_told(tmp_path):
    """Each part, by name; crossovers are those of the network but for its outline."""
    overrides = ["continuum.compare=true", "continuum.ladder=[2, 4]", "preform.refine=4"]
    made = case(tmp_path, *overrides)
    sentences = check_work(MPI.COMM_SELF, made)
    assert [re.split(" has about |: some", sentence)[0] for sentence in sentences] == [
        "the test",
        "the membrane",
        "refine = 2 of continuum.ladder",
        "refine = 4 of continuum.ladder",
    ]
    told = r"the test has about 18,400 crossovers and 111,000 unknowns: some 21\d MB, less than a s"
    assert re.match(told, sentences[0])
    network = Network(MPI.COMM_SELF, made.preform(), made.fabric())
    size = float(estimate(made)[0].size.split()[1].replace(",", ""))
    assert size == pytest.approx(network.num_crossovers_global, rel=0.02)


def test_estimate_of_a_membrane(tmp_path):
    """Unknowns by its size; the true number is larger where the mesh is graded."""
    from cruciform_petsc.continuum.membrane import Membrane

    made = case(tmp_path, "continuum.compare=true", 'continuum.mesh_size="4 mm"')
    part = estimate(made)[1]
    cells = Membrane(MPI.COMM_SELF, made.preform(), made.fabric(), 4e-3).cells
    assert 1.0 <= cells / float(part.size.split()[1].replace(",", "")) < 3.0


def test_estimate_of_a_membrane_among_tools(tmp_path):
    """Triangles and unknowns of linear elements, half as wide as the net's pitch."""
    from cruciform_petsc.continuum.sheet import Sheet

    path = written(tmp_path)
    made = Case.load(path, ["continuum.compare=true"])
    network = Network(MPI.COMM_SELF, made.preform(), made.fabric())
    sheet = Sheet(network, 0.5 * float(network.pitch.min()))
    words = estimate(made)[1].size.split()
    triangles, unknowns = (float(words[i].replace(",", "")) for i in (1, 4))
    assert triangles == pytest.approx(sheet.cells, rel=0.1)
    assert unknowns == pytest.approx(3 * sheet.nodes.num_nodes_global, rel=0.2)


@pytest.mark.parametrize(
    ("seconds", "text"),
    [
        (0.3, "less than a second"),
        (12.3, "12 s"),
        (600, "10 min"),
        (1e4, "2.8 h"),
        (4e5, "4.6 days"),
    ],
)
def test_times(seconds, text):
    assert time_text(seconds) == text


def test_estimate_of_cloth_in_space(tmp_path):
    """Three unknowns in place of two at each node, and more than three times the memory."""
    flat, space = (
        estimate(case(tmp_path, "test.finite=true", f"test.space={text}"))[0]
        for text in ("false", "true")
    )
    count, more = (float(part.size.split()[4].replace(",", "")) for part in (flat, space))
    assert more == pytest.approx(1.5 * count, rel=0.01)
    assert 3.0 < space.bytes / flat.bytes < 4.0
