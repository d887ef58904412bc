# SPDX-License-Identifier: MIT
"""Cloth on cylinders and spheres, and drawn into a die: closed forms of geometry."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.integrate import solve_bvp
from support.formed import OVER, Gripped, cloth, formed, load, network, travel

from cruciform_petsc.forming.blank import ContactSettings
from cruciform_petsc.forming.press import StagePlan
from cruciform_petsc.items.loads import Suction
from cruciform_petsc.tools import shapes
from cruciform_petsc.tools.motion import Pose
from cruciform_petsc.tools.surface import Surface
from cruciform_petsc.tools.tool import Tool

THIN = ContactSettings(2e9, 1e-5, 1e-5, 1.0)  # so that compaction does not count


@pytest.mark.parametrize("angle", [0, 30, 45])
def test_a_net_on_a_cylinder(angle):
    """No shear; bending energy per area (B1 cos^4 a + B2 sin^4 a)/(2 R^2) within 1 %."""
    radius, rigidity = 50e-3, (1e-3, 3e-3)
    fabric = cloth(bending=("1 N mm", "3 N mm"), shear="5 kN/m")
    # y is the cylinder's axis, x its hoop: the warp runs at 90 deg - a from y.
    net = network((60, 60), fabric, f"{90 - angle} deg", yarns_per_cruciform=2)
    around = radius + 0.5e-3

    def shape(rest):
        phi = rest[:, 0] / around
        return np.stack([around * np.sin(phi), rest[:, 1], around * np.cos(phi)], axis=1)

    tools = [Tool("core", shapes.cylinder(radius), 0.3)]
    # Onto the core, against B/R^3, 24 Pa at most. Viscosity, as only what has touched is rubbed:
    # the stiffer yarns would turn away from the hoop.
    blank = Gripped(
        net, tools, shape=shape, settings=replace(THIN, viscosity=1e6),
        further=[lambda ply: Suction(ply, -2e3)],
    )  # fmt: skip
    _, states = formed(blank, StagePlan("press", step=1.0))
    fields = blank.ply.fields(blank.of_cloth(states[-1]))
    middle = abs(net.crossover_position).max(axis=1) < 15e-3
    assert np.degrees(abs(fields["shear_angle"][middle]).max()) < 0.05
    cos4, sin4 = np.cos(np.deg2rad(angle)) ** 4, np.sin(np.deg2rad(angle)) ** 4
    wanted = (rigidity[0] * cos4 + rigidity[1] * sin4) / (2 * around**2)
    got = fields["out_of_plane_bending_energy"][middle].mean() / net.pitch.prod()
    assert got == pytest.approx(wanted, rel=1e-2)


DRAWN = {20: 2.443, 40: 10.259, 60: 23.516}  # pole's depth -> draw-in, mm


def drawn_in(yarns_per_cruciform):
    """Draw-in [mm] of a narrow strip by a punch of 75 mm and a fillet of 7.5 mm, by depth."""
    thickness = 1e-3
    width = 5 * yarns_per_cruciform
    net = network(
        (246, width),
        cloth(bending=("1e-4 N mm", "1 N mm")),
        "90 deg",
        yarns_per_cruciform=yarns_per_cruciform,
    )
    radius, fillet = 75e-3 - thickness / 2, 7.5e-3 - thickness / 2
    tools = [
        Tool("die", shapes.opening(87.5e-3 - fillet, fillet, 0.3)),
        Tool(
            "punch", shapes.sphere(radius, shaft=True), 0.0,
            Pose(np.array([0.0, 0.0, thickness + radius]), OVER),
        ),
    ]  # fmt: skip

    def at_end(side):
        return lambda rest: side * rest[:, 0] > abs(rest[:, 0]).max() - 1e-6  # on the warp

    pull = 0.01 * width  # N: taut
    ends = [
        load(at_end(side), (side * pull, 0.0, 0.0), f"pull {side}", factor=1.0) for side in (-1, 1)
    ]
    blank = Gripped(net, tools, settings=ContactSettings(2e8, 2e-5, 1e-5, 100.0), further=ends)
    draw = StagePlan("draw", {"punch": travel(0, 0, -60e-3)}, step=1 / 12, results=12)
    _, states = formed(blank, StagePlan("stretch", step=1.0), draw)
    taut = states.pop(0).x[blank.cloth_at]
    found = {}
    for number, state in enumerate(states, 1):
        moved = state.x[blank.cloth_at] - taut
        left, right = (moved[at_end(side)(blank.ply.nodes.rest), 0].mean() for side in (-1, 1))
        found[5 * number] = 500.0 * (left - right)
    return found


def test_a_strip_is_drawn_in():
    """Its draw-in is that of arcs and a tangent: within 0.5 %, or 0.05 mm where it is small."""
    coarse, fine = drawn_in(2), drawn_in(1)
    for depth, wanted in DRAWN.items():
        assert fine[depth] == pytest.approx(wanted, rel=5e-3, abs=0.05 if depth == 20 else 0)
        assert abs(fine[depth] - wanted) < 0.5 * abs(coarse[depth] - wanted)


def chebyshev(u, v):
    """Shear [rad] of the net on a sphere with two yarns through the pole, at u v/R^2 = s."""
    s = np.asarray(u) * np.asarray(v)

    def slope(x, y):
        return np.stack([y[1], np.where(x > 0, (np.cos(y[0]) - y[1]) / np.maximum(x, 1e-12), 0.0)])

    mesh = np.linspace(1e-8, max(s.max(), 1e-3), 200)
    start = np.stack([mesh, np.ones_like(mesh)])
    found = solve_bvp(
        slope, lambda a, b: np.array([a[0] - mesh[0], a[1] - 1.0]), mesh, start, tol=1e-8
    )
    return found.sol(s)[0]


def test_the_chebyshev_net():
    """The closed form itself: 2.292, 9.154, 20.479, 35.858 deg."""
    u = np.array([0.2, 0.4, 0.6, 0.8])
    wanted = [2.292, 9.154, 20.479, 35.858]
    np.testing.assert_allclose(np.degrees(chebyshev(u, u)), wanted, atol=2e-3)


class Shell(Surface):
    """The inside of a sphere."""

    box = np.zeros((2, 3))

    def __init__(self, radius):
        self.radius = radius

    def look(self, points):
        """See Surface.look."""
        size = np.linalg.norm(points, axis=1)
        n = -points / size[:, None]
        plane = np.eye(3) - n[:, :, None] * n[:, None, :]
        return self.radius - size, n, -plane / size[:, None, None]

    def facets(self, chord=None):
        """Not drawn."""
        raise NotImplementedError


def laid_on_sphere(yarns_per_cruciform):
    """Distances u, v from the yarns through the pole over R, and error of the shear [deg]."""
    radius = 50e-3
    # Yarns stiff enough in the plane not to zigzag, which would spare the cloth its shear.
    fabric = cloth(bending="1 N mm", yarn_bending="5 N mm^2")
    net = network((109, 109), fabric, yarns_per_cruciform=yarns_per_cruciform)
    around = radius + 0.5e-3

    def shape(rest):  # along great circles: hoops are much too short
        r = np.hypot(rest[:, 0], rest[:, 1])
        inward = around * np.sin(r / around) / np.maximum(r, 1e-12)
        return np.column_stack(
            [inward * rest[:, 0], inward * rest[:, 1], around * np.cos(r / around)]
        )

    tools = [Tool("ball", shapes.sphere(radius)), Tool("shell", Shell(radius + 1e-3))]
    blank = Gripped(net, tools, shape=shape, settings=replace(THIN, viscosity=1e3))
    let_go = StagePlan("let go", step=1.0)
    _, states = formed(blank, let_go, options={"snes_max_it": 100})
    shear = abs(blank.ply.fields(blank.of_cloth(states[-1]))["shear_angle"])
    uv = abs(net.crossover_position) / around
    return uv, np.degrees(shear - chebyshev(*uv.T))


def test_a_net_on_a_sphere():
    """Stiff yarns, little shear stiffness: the shear of the Chebyshev net, within 0.5 deg."""
    (at, coarse), (uv, fine) = laid_on_sphere(3), laid_on_sphere(2)
    inside = uv.max(axis=1) < 0.7  # 25 deg; two yarns from the edge, where tails bend aside
    assert abs(fine[inside]).max() < 0.5
    assert abs(fine[uv.max(axis=1) < 0.55]).max() < 0.5 * abs(coarse[at.max(axis=1) < 0.55]).max()
