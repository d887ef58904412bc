# SPDX-License-Identifier: MIT
"""A membrane among tools beside a network: a hemisphere, finer and finer; files and sentences."""

from __future__ import annotations

import csv
import json
import re
from dataclasses import replace

import numpy as np
import pytest
from mpi4py import MPI
from support.formed import HARD, formed, hemisphere
from support.forming import CASE, written

from cruciform_petsc.case.schema import Case
from cruciform_petsc.cli import main
from cruciform_petsc.continuum.formed import NO_BENDING
from cruciform_petsc.continuum.sheet import MembraneBlank
from cruciform_petsc.errors import EquilibriumError, InputError
from cruciform_petsc.forming.forming import form
from cruciform_petsc.forming.measures import DrawIn

COMM = MPI.COMM_SELF
STIFF = replace(HARD, stiffness=1e8)
QUARTER = {"settings": STIFF, "symmetry": ("left", "lower")}


def firmly(**options):
    """A quarter of the small hemisphere under 100 N, which keeps it free of wrinkles."""
    blank, plans = hemisphere(quarter=True, settings=STIFF, steps=5, **options)
    force = {"holder": np.array([0.0, 0.0, -25.0])}
    return blank, [replace(plans[0], forces=force, step=0.25), plans[1]]


def test_networks_come_nearer_to_the_membrane():
    """Shear, draw-in and force on a quarter of a hemisphere: finer nets, smaller differences."""
    found = []
    for yarns in (2, 1):
        blank, plans = firmly(yarns_per_cruciform=yarns)
        steps, states = formed(blank, *plans)
        if yarns == 2:
            size = 0.25 * blank.pitch
            membrane = MembraneBlank(blank.network, blank.tools, size, **QUARTER)
            its, last = formed(membrane, *plans)
            it = membrane.of_cloth(last[-1])
            its_force = its[-1].tool_force["punch"][2]
            its_drawn = DrawIn(membrane).largest(last[-1])
        place = blank.network.crossover_position
        inside = (place < 45e-3).all(axis=1)  # at a free edge a crossover shears on one side only
        u, gamma = membrane.ply.at(it, place[inside])
        fields = blank.ply.fields(blank.of_cloth(states[-1]))
        found.append(
            (
                np.degrees(abs(fields["shear_angle"][inside] - gamma).mean()),
                abs(fields["displacement"][inside] - u).mean(),
                steps[-1].tool_force["punch"][2] / its_force,
                DrawIn(blank).largest(states[-1])["right"] / its_drawn["right"],
            )
        )
    coarse, fine = found
    for name, of_coarse, of_fine in zip(("shear", "place"), coarse, fine, strict=False):
        assert of_fine < 0.7 * of_coarse, name
    assert fine[0] < 1.5  # degrees, of 26 at most
    # A net of yarns that bend needs more force.
    assert fine[2] == pytest.approx(1.0, abs=0.1)
    assert fine[3] == pytest.approx(1.0, abs=0.015)
    assert abs(fine[3] - 1.0) < 0.6 * abs(coarse[3] - 1.0)


def test_planes_of_symmetry():
    """A quarter of the membrane's hemisphere: a quarter of the force, the same places."""
    whole, plans = hemisphere(settings=STIFF)
    whole = MembraneBlank(whole.network, whole.tools, 1 / 120, settings=STIFF)
    quarter, its_plans = hemisphere(quarter=True, settings=STIFF)
    quarter = MembraneBlank(quarter.network, quarter.tools, 1 / 120, **QUARTER)
    (steps, states), (its, last) = formed(whole, *plans), formed(quarter, *its_plans)
    force, quarter_force = (s[-1].tool_force["punch"][2] for s in (steps, its))
    assert 4 * quarter_force == pytest.approx(force, rel=1e-3)
    points = quarter.ply.nodes.rest[:, :2]
    (u, gamma), (v, sheared) = (
        b.ply.at(b.of_cloth(s[-1]), points) for b, s in ((whole, states), (quarter, last))
    )
    np.testing.assert_allclose(v, u, atol=2e-5)
    np.testing.assert_allclose(sheared, gamma, atol=5e-3)
    assert abs(gamma).max() > 0.3


def test_from_a_case_file(tmp_path, capfd):
    """Figures of both, a table, sentences in log and report; the membrane has no bending."""
    path, folder = written(tmp_path), tmp_path / "out"
    told = '[continuum]\ncompare = true\nmesh_size = "5 mm"\nladder = [1]\n'
    path.write_text(f"{CASE}{told}[output]\npictures = false\nreport = true\nparaview = false\n")
    assert main(["run", str(path), "--output", str(folder)]) == 0
    log = capfd.readouterr().out
    beside = log[log.index("the membrane beside it:") : log.index("formed and compared")]
    assert "draw  100.0 %, punch " in beside  # its steps
    summary = json.loads((folder / "summary.json").read_text())
    continuum = summary["continuum"]
    net, it = continuum["network"], continuum["membrane"]
    for key, value in net.items():
        assert summary[key] == pytest.approx(value)
    for tool, (_, _, force) in it["tool_force_n"].items():
        ours = summary["tool_force_n"][tool][2]
        assert continuum["force_ratio"][tool] == pytest.approx(ours / force)
    # Bending takes most of this small cup's energy: what the membrane lacks shows.
    assert continuum["force_ratio"]["holder"] == pytest.approx(1.0)
    assert continuum["force_ratio"]["punch"] > 1.5
    energy = summary["energy_j"]
    bent = energy["bending"] + energy["out_of_plane_bending"]
    strain = bent + energy["tension"] + energy["shear"]
    assert continuum["bending_share"] == pytest.approx(bent / strain)
    assert continuum["relative_l2_displacement"] < 0.15
    assert continuum["points"] == summary["crossovers"]
    with (folder / "continuum.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert [float(row["stages_done"]) for row in rows] == [1.0, 1.5, 2.0]
    assert float(rows[-1]["punch_force_z_network_N"]) == summary["tool_force_n"]["punch"][2]
    assert float(rows[-1]["punch_force_z_membrane_N"]) == it["tool_force_n"]["punch"][2]
    (rung,) = continuum["ladder"]
    assert rung["punch_force_ratio"] == pytest.approx(continuum["force_ratio"]["punch"], rel=1e-6)
    assert rung["relative_l2_shear"] == pytest.approx(continuum["relative_l2_shear"], rel=1e-6)
    report = (folder / "report.html").read_text()
    assert NO_BENDING in report
    assert "Refined networks" in report


def test_a_membrane_that_cannot_be_formed(tmp_path, capfd, monkeypatch):
    """The network's results stay; what the membrane reached is compared, with a warning."""

    def stops(blank, plans, **options):
        error = EquilibriumError("no equilibrium found", "DIVERGED_MAX_IT", [1.0])
        error.result = form(blank, plans[:1], **options)
        raise error

    monkeypatch.setattr("cruciform_petsc.continuum.formed.form", stops)
    path, folder = written(tmp_path), tmp_path / "out"
    told = '[continuum]\nladder = [1]\nmesh_size = "8 mm"\n'
    path.write_text(f"{CASE}{told}[output]\npictures = false\nreport = true\nparaview = false\n")
    assert main(["run", str(path), "--output", str(folder)]) == 0
    sentence = 'no equilibrium beyond 0 % of stage "draw" (no equilibrium found, DIVERGED_MAX_IT)'
    assert sentence in capfd.readouterr().out
    summary = json.loads((folder / "summary.json").read_text())
    assert any(sentence in warning for warning in summary["warnings"])
    assert sentence in summary["continuum"]["failed"]
    # Both as they were then.
    assert summary["continuum"]["time"] == 1.0
    for which in ("network", "membrane"):
        assert abs(summary["continuum"][which]["tool_force_n"]["punch"][2]) < 0.01
    assert "ladder" not in summary["continuum"]
    assert summary["tool_force_n"]["punch"][2] < -0.1
    assert "DIVERGED_MAX_IT" in (folder / "report.html").read_text()


def test_outlines_and_keys_that_it_is_not_for(tmp_path):
    continuum = '[continuum]\ncompare = true\n[[stage]]\nname = "draw"'
    here = '[[stage]]\nname = "draw"'
    slit = '[[["12 mm", "28 mm"], ["40 mm", "28 mm"]]]'
    clamped = '[[clamp]]\nedge = "left"\n' + continuum
    for changes, sentence in (
        (
            [('bias_angle = "0 deg"', 'bias_angle = "30 deg"'), (here, continuum)],
            "the membrane beside a forming needs an outline whose sides run along the yarns",
        ),
        (
            [
                ("outline = { rectangle", f"outline = {{ slits = {slit}, rectangle"),
                (here, continuum),
            ],
            "the membrane beside a forming needs an outline without slits",
        ),
        (
            [(here, clamped)],
            "[[clamp]] is not for a forming with a membrane beside it",
        ),
        (
            [(here, continuum.replace("compare = true", "second_gradient = true"))],
            "continuum.second_gradient is not for forming, leave it out",
        ),
    ):
        with pytest.raises(InputError, match=re.escape(sentence)):
            Case.load(written(tmp_path, *changes))
