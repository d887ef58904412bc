# SPDX-License-Identifier: MIT
"""What is drawn does not depend on the number of ranks; rank 0 draws it."""

import matplotlib as mpl

mpl.use("Agg")

import numpy as np
import pytest
from matplotlib import pyplot
from mpi4py import MPI

from cruciform_petsc import BiasExtension, Fabric, InputError, Network, Preform

COMM = MPI.COMM_WORLD


def solved(comm):
    preform = Preform.rectangle("40 mm", "90 mm", bias_angle="45 deg")
    network = Network(comm, preform, Fabric.from_library("e-glass-plain-2.4"))
    return BiasExtension(network, ["2 mm", "6 mm"], finite=True, increments=2).solve()


def test_axes_and_tables():
    result, alone = solved(COMM), solved(MPI.COMM_SELF)
    curve, shear, html = result.plot(), result.map("shear"), result._repr_html_()
    want, want_shear, want_html = alone.plot(), alone.map("shear"), alone._repr_html_()
    assert html.startswith("<div")
    if COMM.rank:
        assert curve is shear is None
    else:
        for a, b in zip(curve.get_lines(), want.get_lines(), strict=True):
            np.testing.assert_allclose(a.get_data(), b.get_data(), rtol=1e-6, atol=1e-9)
        ours, theirs = (axes.collections[-1].get_array() for axes in (shear, want_shear))
        np.testing.assert_allclose(ours, theirs, rtol=1e-6, atol=1e-6)
        assert ("<img" in html) == ("<img" in want_html)
    with pytest.raises(InputError, match="no map"):
        result.map("nothing")
    with pytest.raises(InputError, match="needs 1 axes"):
        result.plot(pyplot.subplots(1, 2)[1])
