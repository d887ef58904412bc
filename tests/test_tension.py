# SPDX-License-Identifier: MIT
"""Laws of both tensions: derivatives, where they end, what softens, what a fabric makes of them."""

from dataclasses import replace

import numpy as np
import pytest
from support.biaxial import CRIMP, SURFACE, grid, linear_law
from support.helpers import UNEVEN

from cruciform_petsc import InputError
from cruciform_petsc.cloth.surface import MARGIN
from cruciform_petsc.laws import effective_strains

LAWS = {"crimp": CRIMP.law, "surface": SURFACE}
EVERY = pytest.mark.parametrize("law", LAWS.values(), ids=LAWS)
SOFT = pytest.mark.parametrize("soft", [(1.0, 1e-4), (0.1, 2e-3)], ids=["", "softening"])


@EVERY
@SOFT
def test_derivatives(law, soft):
    """Energy to tension to stiffness by differences, on and beyond a table, in contraction, too.

    1e-7: with steps of 1e-7 tensions are rounded by 1e-16/1e-7, and stiffness of the softening
    yarns, 2e-3 wide, is cut off by (1e-7/2e-3)^2 at most. A surface's stiffness jumps in slope.
    """
    rng = np.random.default_rng(1)
    e = rng.uniform([-0.003, -0.001], [0.03, 0.03], (2000, 2))
    step = 1e-7

    def at(e):
        return law.evaluate(e[:, 0], e[:, 1], *soft)

    _, tension, stiffness = at(e)
    for k, columns in ((0, (0, 2)), (1, (2, 1))):
        move = step * np.eye(2)[k]
        up, down = at(e + move), at(e - move)
        difference = (up[0] - down[0]) / (2 * step)
        np.testing.assert_allclose(difference, tension[:, k], atol=1e-7 * abs(tension).max())
        difference = (up[1] - down[1]) / (2 * step)
        limit = 1e-6 * abs(stiffness).max()
        np.testing.assert_allclose(difference, stiffness[:, columns], atol=limit)


@EVERY
def test_rest(law):
    """No energy, no tension; stiff against every strain."""
    w, tension, stiffness = law.evaluate(0.0, 0.0)
    assert abs(w) < 1e-12
    assert abs(tension).max() < 1e-6
    warp, weft, both = stiffness
    assert (stiffness == law.stiffness0).all()
    assert warp > 0.0 < weft
    assert both**2 < warp * weft


@EVERY
def test_a_multiple_of_a_law(law):
    """Energy, tensions and stiffness, in contraction and beyond, too."""
    e = np.random.default_rng(4).uniform(-0.002, 0.03, (200, 2)).T
    for found, once in zip(law.times(2.5).evaluate(*e), law.evaluate(*e), strict=True):
        np.testing.assert_allclose(found, 2.5 * once, rtol=1e-9, atol=1e-9 * abs(once).max())


def test_surface_beyond_its_table():
    """Beyond the splines stiffness stays; below the least strain it softens like yarns do."""
    (low, high), _ = SURFACE.strains
    assert (low, high) == (0.0, 0.02)
    high += MARGIN * (high - low)
    edge, beyond = (SURFACE.evaluate(e, 0.01) for e in (high, high + 0.02))
    assert beyond[1][0] == pytest.approx(edge[1][0] + 0.02 * edge[2][0], rel=1e-12)
    assert beyond[2][0] == pytest.approx(edge[2][0], rel=1e-9)
    inside = [SURFACE.evaluate(0.005, 0.01, *soft)[1] for soft in ((1.0, 1e-4), (0.1, 1e-3))]
    assert (inside[0] == inside[1]).all()
    s, width = 0.004, 1e-3
    e, e1, e2 = effective_strains(1.0 - s, compression=0.1, width=width)
    mapped, soft = SURFACE.evaluate(low + e, 0.01), SURFACE.evaluate(low - s, 0.01, 0.1, width)
    assert soft[0] == pytest.approx(mapped[0], rel=1e-12)
    assert soft[1] == pytest.approx(mapped[1] * [e1, 1.0], rel=1e-12)
    slope = mapped[2][0] * e1**2 + mapped[1][0] * e2
    assert soft[2] == pytest.approx([slope, mapped[2][1], mapped[2][2] * e1], rel=1e-12)


def test_crimp_softens_in_its_yarns():
    """Not where the cloth contracts: there a yarn may pull all the same."""
    contracted = CRIMP.law.evaluate(0.004, -5e-4)
    assert (contracted[1] > 0.0).all()
    assert CRIMP.law.evaluate(0.004, -5e-4, 0.1)[1] == pytest.approx(contracted[1], rel=1e-12)
    pressed = [CRIMP.law.evaluate(-0.002, -0.002, c, 1e-4)[1] for c in (1.0, 0.1)]
    assert (pressed[0] < pressed[1]).all()
    assert (pressed[1] < 0.0).all()


@pytest.mark.parametrize("log_strain", [False, True])
@pytest.mark.parametrize("name", ["none", "surface"])
def test_tension_of_a_fabric(name, log_strain):
    """By the stretches: derivatives of its energy, whatever the laws are."""
    fabric = replace(UNEVEN, log_strain=log_strain, compression=0.1, compression_width=2e-3)
    if name == "surface":
        fabric = fabric.with_biaxial_law(SURFACE)
    rng = np.random.default_rng(2)
    stretch = 1.0 + rng.uniform(-0.01, 0.03, (500, 2))
    _, tension, stiffness = fabric.tension(stretch)
    step = 1e-7
    for k, columns in ((0, (0, 2)), (1, (2, 1))):
        up, down = (fabric.tension(stretch + d * step * np.eye(2)[k]) for d in (1, -1))
        found = (up[0] - down[0]) / (2 * step)
        np.testing.assert_allclose(found, tension[:, k], atol=2e-7 * abs(tension).max())
        found = (up[1] - down[1]) / (2 * step)
        limit = 2e-6 * abs(stiffness).max()
        np.testing.assert_allclose(found, stiffness[:, columns], atol=limit)


def test_fabric_with_a_biaxial_law():
    """Its moduli are the law's at rest, so that small displacements are those of the same cloth."""
    fabric = UNEVEN.with_biaxial_law(CRIMP.law)
    found = (fabric.c11, fabric.c22, fabric.c12)
    assert found == pytest.approx(CRIMP.law.stiffness0, rel=1e-12)
    assert repr(fabric).endswith("tension by a crimp model)")
    with pytest.raises(InputError, match=r"fabric\.biaxial_law is to be set by Fabric\.with_bia"):
        replace(UNEVEN, biaxial_law=CRIMP.law)
    with pytest.raises(InputError, match="must resist every strain at rest, its stiffness"):
        UNEVEN.with_biaxial_law(linear_law(1e4, 1e4, 2e4))


def test_linear_surface_is_the_linear_cloth():
    """A surface of straight lines with Poisson coupling gives the tensions of the moduli."""
    law = linear_law(UNEVEN.c11, UNEVEN.c22, UNEVEN.c12)
    fabric, e = UNEVEN.with_biaxial_law(law), grid(-0.02, 0.05, 7)
    for found, expected in zip(fabric.tension(1.0 + e), UNEVEN.tension(1.0 + e), strict=True):
        np.testing.assert_allclose(found, expected, rtol=1e-9, atol=1e-9 * abs(expected).max())
