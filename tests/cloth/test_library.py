# SPDX-License-Identifier: MIT
"""The library of fabrics: each can be used, and says where it comes from and what is assumed."""

import runpy
import warnings
from pathlib import Path

import pytest
from mpi4py import MPI

from cruciform_petsc import BiasExtension, Fabric, Network, Preform
from cruciform_petsc.cli import main
from cruciform_petsc.cloth.fabric import FabricTable, fabric_names, library

SCRIPT = Path(__file__).parents[2] / "scripts" / "fabric_page.py"
NAMES = [
    "e-glass-plain-2.4", "pantographic-sheet-2016", "glass-pp-plain-1.93", "carbon-plain-3k-282",
    "carbon-twill-3k-284", "carbon-satin5-3k-433", "carbon-satin8-3k-584", "e-glass-satin8-7781",
    "e-glass-twill-7725", "glass-pp-twill-1485", "aramid-plain-281", "pvc-polyester-type-2",
]  # fmt: skip


def test_names():
    assert fabric_names() == NAMES


@pytest.mark.parametrize("name", NAMES)
def test_a_small_bias_test(name):
    """Each has what every kind of test needs, and is strained within what its data are for."""
    fabric = Fabric.from_library(name)
    assert fabric.source
    assert library()[name].notes
    fabric.out_of_plane("this")
    width, length = 6 * fabric.warp.spacing, 12 * fabric.warp.spacing
    network = Network(MPI.COMM_SELF, Preform.rectangle(width, length, "45 deg"), fabric)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        result = BiasExtension(network, 0.05 * length, finite=True).solve()
    assert result.load > 0.0
    assert 5.0 < result.shear_angle_max * 57.3 < 20.0


@pytest.mark.parametrize("name", NAMES)
def test_masses(name):
    """What tex and counts give is the mass that is published, but for crimp and finish."""
    entry = library()[name]
    if entry.from_datasheet is None:
        return
    assert entry.questions() == []
    estimate = entry._estimate(entry.from_datasheet)
    assert estimate.cloth["areal_density"] == pytest.approx(entry.areal_density.si, rel=0.06)
    fraction = Fabric.from_library(name).fibre_volume_fraction
    assert fraction is None or 0.4 < fraction < 0.6


@pytest.mark.parametrize("name", NAMES)
def test_what_is_not_published_is_said(name):
    """What nobody measures for a data sheet is never left without a word."""
    told = FabricTable(use=name).filled_in()
    assert told
    entry = library()[name]
    measured = {"e-glass-plain-2.4": 5, "pantographic-sheet-2016": 5, "glass-pp-plain-1.93": 1}
    unmeasured = [
        key for key in ("modulus", "poisson", "yarn_bending", "shear", "out_of_plane_bending")
        if any(f".{key}" in sentence for sentence in told)
    ]  # fmt: skip
    assert 5 - len(unmeasured) == min(measured.get(name, 0), 4)
    for place, why in entry.assumed.items():
        assert any(sentence.startswith(place) and why in sentence for sentence in told)
    # No longer said of what is replaced.
    shear = FabricTable.from_data({"use": name, "shear": {"modulus": "1 N/cm"}}).filled_in()
    assert not any("fabric.shear" in sentence for sentence in shear)


def test_replacing_a_value_of_a_sheet():
    """Thickness changes what is estimated from it, a rigidity its own estimate."""
    name = "carbon-satin5-3k-433"
    thick = Fabric.from_library(name, {"thickness": "0.8 mm", "out_of_plane_bending": "1 N mm"})
    assert thick.name == f"{name}, out_of_plane_bending and thickness replaced"
    assert thick.thickness == 8e-4
    assert thick.warp.out_of_plane_bending == pytest.approx(1e-3)
    assert thick.warp.modulus < Fabric.from_library(name).warp.modulus
    assert thick.source == Fabric.from_library(name).source


def test_page_is_fresh():
    """docs/fabrics.md is what the library says: else run scripts/fabric_page.py."""
    script = runpy.run_path(str(SCRIPT))
    page = script["page"]()
    assert script["PAGE"].read_text(encoding="utf-8") == page
    for name in NAMES:
        for sentence in FabricTable(use=name).filled_in():
            assert f"- {sentence}\n" in page


def test_all_of_one(capfd):
    """`fabrics NAME`: source, notes, and what is assumed; a name that is none is a sentence."""
    assert main(["fabrics", "aramid-plain-281"]) == 0
    out = capfd.readouterr().out
    told = FabricTable(use="aramid-plain-281").filled_in()
    for text in ("style 281", "Kevlar 49", "6.693 /cm", *told):
        assert text in out
    assert main(["fabrics", "aramid-plane-281"]) == 2
    assert 'there is no fabric "aramid-plane-281" in the library (did you mean "aramid-plain' in (
        capfd.readouterr().err
    )
