# SPDX-License-Identifier: MIT
"""The crimp model against its energy written out, its limits in closed form, Leaf and Kandil."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import brentq, minimize
from support.biaxial import CRIMP
from support.helpers import UNEVEN

from cruciform_petsc.cloth.crimp import Crimp, interchange, uniaxial_modulus
from cruciform_petsc.laws import linear, table

(P1, P2), (H1, H2) = CRIMP.pitch, CRIMP.height
LIMP = (1e-16, 1e-16)  # N m^2, bending of no account
STIFF = (3e9, 2.5e9)  # N, yarns that do not stretch
RIGID = linear(2e12)  # N/m, that do not flatten
SHORTEST = np.sqrt(P2**2 + H2**2 - (H1 + H2) ** 2) / P2 - 1.0  # a weft that has all the crimp


def free_weft(law, warp):
    """Strain of a weft that nothing pulls, and tension of the warp then."""
    scan = np.linspace(0.02, 2.0 * SHORTEST, 1000)
    at = int(np.argmax(law.evaluate(warp, scan)[1][:, 1] <= 0.0))  # pressed further it may snap
    weft = brentq(lambda e: law.evaluate(warp, e)[1][1], scan[at], scan[at - 1], xtol=1e-15)
    return weft, law.evaluate(warp, weft)[1][0]


@pytest.mark.parametrize("contact", [linear(8e6), table([0.5e-5, 1.5e-5], [4.0, 80.0])])
def test_least_energy(contact):
    """w is the least energy over both heights, found by a general minimiser."""
    crimp = replace(CRIMP, contact=contact)
    length = np.hypot(crimp.pitch, crimp.height)
    spring = 12.0 * np.array(crimp.bending) / (length * np.array(crimp.pitch) ** 2)

    def energy(micrometres, strain):
        h = 1e-6 * micrometres
        now = np.hypot(np.array(crimp.pitch) * (1.0 + strain), h)
        yarns = 0.5 * np.array(crimp.stiffness) * length * (now / length - 1.0) ** 2
        bent = 0.5 * spring * (h - crimp.height) ** 2
        return 1e6 * float((yarns + bent).sum() + contact.evaluate(0.5 * (H1 + H2 - h.sum()))[0])

    for strain in ([0.001, 0.0], [0.01, 0.02], [0.012, -0.002], [-0.0005, 0.003]):
        found = minimize(
            energy, 1e6 * np.array(crimp.height), np.array(strain), tol=1e-14, method="Nelder-Mead"
        )
        w = crimp.law.evaluate(*strain)[0]
        assert w == pytest.approx(1e-6 * found.fun / (P1 * P2), rel=1e-8)


def test_what_presses_yarns_together():
    """Limp yarns press on each other by 2 F sin(theta), and flatten as far as their axes approach.

    Of the tensions alone: F and then the heights follow from T = F cos(theta)/p.
    """
    crimp = replace(CRIMP, bending=LIMP, contact=linear(3e5))
    strain = np.array([0.008, 0.004])
    tension = crimp.law.evaluate(*strain)[1]
    pressed, heights = [], []
    for k, other in ((0, P2), (1, P1)):
        along = crimp.pitch[k] * (1.0 + strain[k])
        rest = np.hypot(crimp.pitch[k], crimp.height[k])

        def misses(h, k=k, along=along, rest=rest, other=other):
            length = np.hypot(along, h)
            pull = crimp.stiffness[k] * (length / rest - 1.0) * along / length
            return pull - tension[k] * other

        h = brentq(misses, 0.0, H1 + H2, xtol=1e-18)
        force = tension[k] * other * np.hypot(along, h) / along
        pressed.append(2.0 * force * h / np.hypot(along, h))
        heights.append(h)
    # Heights follow from tensions to some 1e-9 of them.
    assert pressed[0] == pytest.approx(pressed[1], rel=1e-6)
    assert 3e5 * 0.5 * (H1 + H2 - sum(heights)) == pytest.approx(pressed[0], rel=1e-6)


def test_crimp_interchange():
    """Yarns that neither stretch nor flatten: the weft takes the crimp that the warp loses.

    1e-8: 1e-6 of the yarns' strain at these stiffnesses.
    """
    law = replace(CRIMP, stiffness=STIFF, contact=RIGID, bending=LIMP).law
    for warp in (0.0, 0.001, 0.003, 0.0045):
        weft, tension = free_weft(law, warp)
        assert weft == pytest.approx(interchange(CRIMP, warp), abs=1e-8)
        assert abs(tension) < 1e-3  # N/m; yarns that stretch by 1e-3 carry 1e9
    straight = interchange(CRIMP, CRIMP.crimp[0] * (1.0 - 1e-12))
    assert straight == pytest.approx(SHORTEST, abs=1e-7)
    assert np.isnan(interchange(CRIMP, 1.001 * CRIMP.crimp[0]))


def test_no_number_where_heights_are_not_found():
    """Yarns that hardly bend or flatten, half as long: 80 trials do not do it."""
    crimp = Crimp(
        (1.1165e-3, 3.9534e-4), (1.4223e-6, 6.397e-7), (63.925, 73352.0), (2.734e-12, 7.8104e-6),
        linear(1.6546e8),
    )  # fmt: skip
    assert np.isnan(crimp.law.evaluate(0.19191, -0.41137, 0.011586)[1]).all()
    assert np.isfinite(crimp.law.evaluate(0.01, -0.01, 0.011586)[1]).all()


def test_free_weft():
    """The warp uncrimps at no force to its full length, strain = crimp, then it stretches."""
    law = replace(CRIMP, bending=LIMP).law
    crimp, stiffness = CRIMP.crimp[0], CRIMP.stiffness[0] / P2
    for share in (0.3, 0.9):
        assert abs(free_weft(law, share * crimp)[1]) < 1e-4 * stiffness * crimp
    for warp in (1.5 * crimp, 4.0 * crimp):
        taut = stiffness * ((1.0 + warp) / (1.0 + crimp) - 1.0)
        assert free_weft(law, warp)[1] == pytest.approx(taut, rel=1e-6)


def test_locked():
    """Heights that cannot change: each family stretches along its own slope, uncoupled."""
    law = replace(CRIMP, bending=(1e3, 1e3)).law
    for k, other in ((0, P2), (1, P1)):
        for strain in (0.002, 0.01):
            along = CRIMP.pitch[k] * (1.0 + strain)
            length, rest = (
                np.hypot(along, CRIMP.height[k]),
                np.hypot(P1 if k == 0 else P2, CRIMP.height[k]),
            )
            force = CRIMP.stiffness[k] * (length / rest - 1.0)
            pair = np.eye(2)[k] * strain
            _, tension, stiffness = law.evaluate(*pair)
            assert tension[k] == pytest.approx(force * along / length / other, rel=1e-6)
            assert abs(tension[1 - k]) < 1e-6 * tension[k]
            assert abs(stiffness[2]) < 1e-6 * stiffness[k]


def test_held_weft_locks_the_warp():
    """A weft that is held and neither stretches nor flattens leaves the warp its height."""
    law = replace(CRIMP, stiffness=(3000.0, 2.5e9), contact=RIGID, bending=LIMP).law
    along = P1 * 1.01
    length, rest = np.hypot(along, H1), np.hypot(P1, H1)
    expected = 3000.0 * (length / rest - 1.0) * along / length / P2
    assert law.evaluate(0.01, 0.0)[1][0] == pytest.approx(expected, rel=1e-5)


def test_straight_yarns_are_the_linear_cloth():
    """Without crimp: EA over the distance of yarns, and no coupling."""
    law = replace(CRIMP, height=(0.0, 0.0)).law
    e = np.array([0.01, -0.003])
    _, tension, stiffness = law.evaluate(*e)
    moduli = np.array(CRIMP.stiffness) / [P2, P1]
    assert tension == pytest.approx(moduli * e, rel=1e-12)
    assert stiffness == pytest.approx([*moduli, 0.0], rel=1e-12)


def test_modulus_of_leaf_and_kandil():
    """Pulled in one direction at rest, with yarns that neither stretch nor flatten."""
    crimp = replace(CRIMP, stiffness=(3e6, 2.5e6), contact=linear(2e9), bending=(1e-11, 2e-11))
    fabric = UNEVEN.with_biaxial_law(crimp.law)
    found = (fabric.warp.modulus, fabric.weft.modulus)
    # 1e-4: these moduli are less than that of the yarns'
    assert found == pytest.approx(uniaxial_modulus(crimp), rel=1e-4)


def test_both_tensions_rise_together():
    """Crimp that the weft takes from the warp must be pulled out again: coupling is positive."""
    law = CRIMP.law
    e = np.random.default_rng(1).uniform(0.0, 0.03, (500, 2))
    _, tension, stiffness = law.evaluate(e[:, 0], e[:, 1])
    assert (tension > 0.0).all()
    assert (stiffness > 0.0).all()
    alone = law.evaluate(e[:, 0], 0.0)[1][:, 0]
    assert (tension[:, 0] >= alone).all()


def test_convex_where_yarns_pull():
    """Of cloths of all sorts, at strains of up to 5 %."""
    rng = np.random.default_rng(3)
    for _ in range(20):
        crimp = replace(
            CRIMP,
            height=tuple(CRIMP.height * rng.uniform(0.2, 3.0, 2)),
            stiffness=tuple(CRIMP.stiffness * 10.0 ** rng.uniform(-1, 1, 2)),
            bending=tuple(CRIMP.bending * 10.0 ** rng.uniform(-3, 1, 2)),
            contact=linear(10.0 ** rng.uniform(5, 8)),
        )
        e = rng.uniform(-0.01, 0.05, (300, 2))
        pulls = (crimp.law.evaluate(e[:, 0], e[:, 1])[1] > 0.0).all(axis=1)
        assert pulls.sum() > 50
        least = crimp.law.least_stiffness(*e[pulls].T)
        assert least.min() > -1e-12 * max(crimp.stiffness) / P1
