# SPDX-License-Identifier: MIT
"""Cases of the kinds that people who test fabrics write, and what is right to make of them."""

import numpy as np
import pytest
from mpi4py import MPI

from cruciform_petsc import BiasExtension, Network, Preform
from cruciform_petsc.case.schema import Case
from tests.support.helpers import TABLE_1, UNEVEN

YARNS = 'modulus = "520 N/cm", poisson = 0, yarns = "2.4 /cm", yarn_bending = "0.6 N mm^2"'
CASE = f"""
title = "t"
[fabric]
warp = {{ {YARNS} }}
weft = {{ {YARNS} }}
shear = SHEAR
[preform]
outline = {{ rectangle = [SIDES] }}
bias_angle = "45 deg"
[test]
kind = "bias-extension"
finite = true
extension = ["2 mm", "5 mm"]
[output]
pictures = false
paraview = false
"""


def case_file(folder, shear='{ modulus = "0.96 N/cm" }', sides='"50 mm", "120 mm"', more=()):
    """Write a case with the given shear, sides and further replacements; its path."""
    text = CASE.replace("SHEAR", shear).replace("SIDES", sides)
    for old, new in more:
        assert old in text
        text = text.replace(old, new)
    path = folder / "case.toml"
    path.write_text(text)
    return path


# -- far from x = y = 0 ----------------------------------------------------------------------------


def loads(preform, fabric=UNEVEN, **keys):
    """Loads of a bias test, small or finite, and its Newton iterations."""
    network = Network(MPI.COMM_SELF, preform, fabric)
    result = BiasExtension(network, extension=["1 mm", "4 mm"], **keys).solve()
    return result.loads, sum(increment.iterations for increment in result.increments)


@pytest.mark.parametrize("finite", [True, False])
def test_origin_moved_by_whole_pitches(finite):
    """The same lattice, so the same result, 30 m away as in the specimen; and with refine."""
    near, turn = np.array([1e-3, 2e-3]), Preform.rectangle(1, 1, "45 deg").rotation
    for refine in (1, 2):
        pitch = np.array([UNEVEN.weft.spacing, UNEVEN.warp.spacing]) / refine
        expected = None
        for pitches in ((0, 0), (8000, -5000), (-7001, 3)):
            origin = tuple(near + (pitches * pitch) @ turn)
            preform = Preform.rectangle(0.03, 0.07, "45 deg", origin=origin, refine=refine)
            found, _ = loads(preform, finite=finite)
            expected = found if expected is None else expected
            # CG at small displacements stops at a residual of 1e-10 of the load's.
            np.testing.assert_allclose(found, expected, rtol=1e-10 if finite else 1e-9)


@pytest.mark.parametrize("finite", [True, False])
@pytest.mark.parametrize("far", [(0.0, 30.0), (-1000.0, 20.0)])
def test_outline_far_away(far, finite):
    """A polygon's corners may be anywhere; coordinates are rounded to what they are there."""
    corners = np.array([(0.0, 0.0), (0.03, 0.0), (0.03, 0.07), (0.0, 0.07)])
    here, steps = loads(Preform.polygon(corners.tolist()), TABLE_1, finite=finite)
    there, more = loads(Preform.polygon((corners + far).tolist()), TABLE_1, finite=finite)
    np.testing.assert_allclose(there, here, rtol=1e-6)
    assert more <= 2 * steps


def test_origin_far_in_a_case(tmp_path):
    """It was "no equilibrium" from 12.5 m on."""
    table = '{ law = "table", angle = "deg", force = "N/mm", points = [[5, 0.01], [60, 1]] }'
    origin = ("bias_angle", 'origin = ["0 mm", "30 m"]\nbias_angle')
    case = Case.load(case_file(tmp_path, table, more=[origin]))
    network = Network(MPI.COMM_SELF, case.preform(), case.fabric())
    assert abs(network.crossover_ij).max() < 40
    assert case.experiment(network).solve().load > 0
