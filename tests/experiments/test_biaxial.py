# SPDX-License-Identifier: MIT
"""Biaxial tension of networks whose tensions depend on both strains, against the law itself."""

import numpy as np
import pytest
from mpi4py import MPI
from scipy.optimize import brentq
from support.biaxial import CRIMP, SURFACE
from support.helpers import UNEVEN

from cruciform_petsc.cloth.preform import Preform
from cruciform_petsc.experiments.biaxial import Biaxial
from cruciform_petsc.experiments.limits import warnings
from cruciform_petsc.experiments.off_axis import OffAxisTension
from cruciform_petsc.net.network import Network

COMM = MPI.COMM_SELF
LAWS = {"crimp": CRIMP.law, "surface": SURFACE}
EVERY = pytest.mark.parametrize("law", LAWS.values(), ids=LAWS)


def network(law, width=0.03, length=0.02, bias="0 deg"):
    """A net whose yarns do not lie evenly in its rectangle."""
    return Network(COMM, Preform.rectangle(width, length, bias), UNEVEN.with_biaxial_law(law))


@EVERY
@pytest.mark.parametrize("ratio", [1.0, 0.5, 2.0, 0.0])
@pytest.mark.parametrize("bias", ["0 deg", "90 deg"])
def test_ratios_give_the_law_back(law, ratio, bias):
    """1:1, 2:1, 1:2 and a held weft: both tensions of the law, per width at rest, to rounding."""
    result = Biaxial(network(law, bias=bias), ["0.5 %", "1 %"], ratio=ratio, bending=False).solve()
    curve = result.curve()
    for k, name in enumerate(("warp", "weft")):
        expected = law.evaluate([0.005, 0.01], [0.005 * ratio, 0.01 * ratio])[1][:, k]
        found = 100.0 * curve[f"tension_{name}_N_per_cm"]
        np.testing.assert_allclose(found, expected, rtol=1e-9)
        np.testing.assert_allclose(result.fields[f"{name}_tension"], expected[-1], rtol=1e-9)
    energy = law.evaluate(0.01, 0.01 * ratio)[0] * 6e-4
    assert curve["energy_tension_J"][-1] == pytest.approx(energy, rel=1e-9)


@EVERY
def test_small_displacements(law):
    """The law's stiffness at rest; with bending, which keeps crossovers from turning."""
    result = Biaxial(network(law), "0.1 %", ratio=0.5, finite=False).solve()
    warp, weft, both = law.stiffness0
    found = [100.0 * result.curve()[f"tension_{name}_N_per_cm"][0] for name in ("warp", "weft")]
    assert found == pytest.approx([1e-3 * warp + 5e-4 * both, 1e-3 * both + 5e-4 * weft], rel=1e-7)


@EVERY
def test_free_sides(law):
    """A strip along the warp with free sides: its weft contracts until nothing pulls it."""
    test = OffAxisTension(network(law, 0.02, 0.04), "0.2 mm", ends="free", bending=False)
    result = test.solve()
    weft = brentq(lambda e: law.evaluate(0.005, e)[1][1], -0.02, 0.01, xtol=1e-14)
    assert weft < -1e-4
    tension = law.evaluate(0.005, weft)[1][0]
    assert result.load == pytest.approx(0.02 * tension, rel=1e-6)
    np.testing.assert_allclose(result.fields["weft_strain"], weft, atol=1e-6 * abs(weft))


def test_beyond_the_points():
    """A run that leaves the surface's points says so; within them nothing is said."""
    for strain, said in (("1.9 %", 0), ("2.5 %", 1)):
        told = warnings(Biaxial(network(SURFACE), strain, bending=False).solve())
        assert (
            len([text for text in told if "fabric.tension.surface, which has 0 to 2 %" in text])
            == said
        )
    # A weft that contracts is no yarn in compression.
    result = OffAxisTension(network(CRIMP.law), "0.2 mm", ends="free", bending=False).solve()
    assert not any("compressed" in text for text in warnings(result))


def test_uncoupled_is_the_elastic_law():
    """Surfaces without coupling are the two laws that a fabric had before."""
    from support.biaxial import linear_law

    law = linear_law(60e3, 25e3, 0.0)
    found, expected = (
        Biaxial(network(law), "2 %", ratio=-0.25, bending=False).solve().curve(),
        {"tension_warp_N_per_cm": [12.0], "tension_weft_N_per_cm": [-1.25]},
    )
    for name, values in expected.items():
        assert found[name] == pytest.approx(values, rel=1e-9)
