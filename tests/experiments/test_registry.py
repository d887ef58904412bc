# SPDX-License-Identifier: MIT
"""A kind of test is one class and one line of the registry; all else follows from them."""

import csv
import runpy
from pathlib import Path
from typing import ClassVar, Literal

import numpy as np
import pytest
from mpi4py import MPI

from cruciform_petsc.case.schema import Case
from cruciform_petsc.cli import main
from cruciform_petsc.errors import InputError
from cruciform_petsc.experiments.experiment import Experiment, Grip
from cruciform_petsc.experiments.registry import KINDS, kind_class
from cruciform_petsc.experiments.table import Lengths, TestTable
from cruciform_petsc.fields import Number
from cruciform_petsc.net.network import Network

SCRIPT = Path(__file__).parents[2] / "scripts" / "case_keys.py"


class LeaningPullTable(TestTable):
    """A strip between two clamps, of which the upper one goes up and to the side."""

    controls: ClassVar = {"extension": "m"}
    template: ClassVar = {
        "title": '"Leaning pull"',
        "outline": '{ rectangle = ["30 mm", "40 mm"] }',
        "test": """
            extension = ["0.1 mm", "0.3 mm"]  # How far up
            lean = 0.5  # How far to the side, over that
        """,
    }
    kind: Literal["leaning-pull"]
    extension: Lengths
    """How far up."""
    lean: Number = 0.0
    """How far to the side, over that."""


class LeaningPull(Experiment):
    """See its table."""

    kind, table = "leaning-pull", LeaningPullTable

    def grip(self, constraints):
        return [Grip(edge, constraints.clamp(edge)) for edge in ("lower", "upper")]

    def motion(self, edge, control):
        return np.eye(2), control * np.array([self.lean, 1.0]) * (edge == "upper")


@pytest.fixture
def kind(monkeypatch):
    """The line of the registry."""
    monkeypatch.setitem(KINDS, "leaning-pull", LeaningPull)
    return "leaning-pull"


@pytest.mark.parametrize("finite", ["true", "false"])
def test_from_a_new_case_to_its_curve(kind, finite, tmp_path, capfd):
    """`new` writes a case, `check` and `run` take it, and keys and control are in the results."""
    path, folder = tmp_path / "lean.toml", tmp_path / "out"
    assert main(["new", kind, str(path)]) == 0
    assert "\nextension = [" in path.read_text()
    assert main(["check", str(path)]) == 0
    changes = ["--set", "output.pictures=false", "--set", f"test.finite={finite}"]
    assert main(["run", str(path), "--output", str(folder), *changes]) == 0
    assert capfd.readouterr().err == ""
    with (folder / "curve.csv").open(newline="") as file:
        rows = [row for row in csv.DictReader(file) if row["asked"] == "1"]
    assert [float(row["extension_mm"]) for row in rows] == pytest.approx([0.1, 0.3])
    assert 0.0 < float(rows[0]["load_N"]) < float(rows[1]["load_N"])


def test_keys_are_arguments_and_mistakes_are_told(kind, tmp_path):
    """The table's keys reach the class; its rules are those of every table."""
    path = tmp_path / "lean.toml"
    assert main(["new", kind, str(path)]) == 0
    case = Case.load(path)
    assert case.test.lean == 0.5
    assert Case.from_data(case.model_dump()) == case
    network = Network(MPI.COMM_SELF, case.preform(), case.fabric())
    experiment = case.experiment(network)
    assert (experiment.lean, experiment.is_curve, experiment.finite) == (0.5, True, True)
    assert experiment.values == pytest.approx([1e-4, 3e-4])
    other = case.experiment(network, bending=False, controls=2e-4)
    assert (other.values.tolist(), other.is_curve, other.bending) == ([2e-4], False, False)
    for change, message in (
        ("test.lean=aside", "test.lean must be a number, got 'aside'"),
        ("test.leen=1", '[test] has the unknown key "leen" (did you mean "lean"?)'),
        ("test.extension=[]", "test.extension is an empty list, give at least one value"),
    ):
        with pytest.raises(InputError) as caught:
            Case.load(path, [change])
        assert str(caught.value) == message
    with pytest.raises(InputError, match=r'test "knot" .*"inflation", "leaning-pull"'):
        Case.load(path, ["test.kind=knot"])


def test_it_is_on_the_page_of_keys(kind):
    page = runpy.run_path(str(SCRIPT))["page"]()
    assert '### `kind = "leaning-pull"`' in page
    assert "| `lean` | number | `0.0` | How far to the side, over that. |" in page


@pytest.mark.parametrize("name", KINDS)
def test_registered_names_are_the_classes_own(name):
    assert kind_class(name).kind == name
    assert kind_class(name).table.model_fields["kind"].annotation == Literal[name]


def test_an_unknown_kind():
    with pytest.raises(InputError, match='no kind of test "knot" .known: "bias-extension"'):
        kind_class("knot")
