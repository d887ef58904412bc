# SPDX-License-Identifier: MIT
"""The schema of summary.json is true of every kind of test."""

import json
import re

import pytest
from support.forming import CASE, written

from cruciform_petsc.case.template import new_case
from cruciform_petsc.cli import main
from cruciform_petsc.experiments.registry import KINDS, in_space
from cruciform_petsc.output.summary_keys import OTHERS, Summary

FLAT = [kind for kind in KINDS if not in_space(kind)]


def check(summary):
    """All keys are told of, with their types; those of the kind itself have units."""
    found = Summary.model_validate(summary)
    others = set(found.model_extra)
    assert {key for key in others if not re.search(OTHERS, key)} == set()
    for key in others:
        values = summary[key] if isinstance(summary[key], list) else [summary[key]]
        assert all(value is None or isinstance(value, float) for value in values), key
    for part in (found.network, found.closed_form, found.yarn_tension_max):
        assert part is None or part.model_dump().keys() >= part.__class__.model_fields.keys()


@pytest.mark.parametrize("kind", FLAT)
@pytest.mark.parametrize("finite", ["true", "false"])
def test_flat(kind, finite, tmp_path):
    if (kind, finite) == ("pull-out", "false"):
        return  # friction is not linear
    case = tmp_path / "case.toml"
    case.write_text(new_case(kind))
    more = [f"test.finite={finite}", "output.pictures=false", "output.paraview=false"]
    more += ["preform.yarns_per_cruciform=4"] if kind not in ("pantograph", "pull-out") else []
    words = [word for each in more for word in ("--set", each)]
    assert main(["run", str(case), *words, "--output", str(tmp_path), "--quiet"]) == 0
    check(json.loads((tmp_path / "summary.json").read_text()))


def test_forming(tmp_path):
    case = written(tmp_path)
    case.write_text(f"{CASE}[output]\npictures = false\n")
    assert main(["run", str(case), "--output", str(tmp_path / "out"), "--quiet"]) == 0
    check(json.loads((tmp_path / "out" / "summary.json").read_text()))


def test_fishnet(tmp_path):
    case = tmp_path / "case.toml"
    case.write_text(new_case("fishnet"))
    words = ["--set", "output.pictures=false", "--output", str(tmp_path / "out"), "--quiet"]
    assert main(["run", str(case), *words]) == 0
    check(json.loads((tmp_path / "out" / "summary.json").read_text()))


def test_a_run_that_reached_nothing_and_wrong_types():
    least = {"title": "", "kind": "biaxial", "finite": True, "ended_early": "it tore", "case": {}}
    least |= {"ranks": 1, "versions": {}, "date": "", "commit": None}
    least |= {"wall_s": {}, "peak_mib_per_rank": [1.0], "increments": []}
    check(least)
    for wrong in ({"finite": 1}, {"case": []}, {"closed_form": {"load_n": 1.0}}, {"kind": None}):
        with pytest.raises(ValueError, match=next(iter(wrong))):
            check(least | wrong)
    with pytest.raises(AssertionError):
        check(least | {"colour": 1.0})
