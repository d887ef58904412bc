# SPDX-License-Identifier: MIT
"""Height of wrinkles and bridged hollows, of shapes that are known."""

from dataclasses import replace

import numpy as np
import pytest
import shapely
from mpi4py import MPI
from support.formed import OVER, THICKNESS, Gripped, network

from cruciform_petsc.forming.waves import Waves
from cruciform_petsc.tools import shapes
from cruciform_petsc.tools.motion import Pose
from cruciform_petsc.tools.profile import Profile
from cruciform_petsc.tools.tool import Tool

HALF = 0.5e-3  # of the thickness
RADIUS = 50e-3


def flat(rest, lift=0.0):
    return rest + np.column_stack([np.zeros((len(rest), 2)), lift + np.zeros(len(rest))])


def on_cylinder(rest, radius=RADIUS, lift=0.0):
    """The x direction around a cylinder about y, the cloth's face on it."""
    around = radius + HALF
    phi, r = rest[:, 0] / around, around + lift
    return np.stack([r * np.sin(phi), rest[:, 1], r * np.cos(phi) - radius], axis=1)


def on_sphere(rest, radius=RADIUS):
    """Along meridians: not inextensible, but a sphere."""
    around = radius + HALF
    rho = np.hypot(rest[:, 0], rest[:, 1])
    angle, unit = rho / around, rest[:, :2] / np.maximum(rho, 1e-12)[:, None]
    plane = around * np.sin(angle)[:, None] * unit
    return np.column_stack([plane, around * np.cos(angle) - radius])


def sine(amplitude, length, way=(1.0, 0.0)):
    return lambda rest: amplitude * (1.0 + np.sin(2 * np.pi * (rest[:, :2] @ way) / length))


def measured(shape, tools=(), size=(120, 120), comm=MPI.COMM_SELF, **options):
    """What is found of a cloth in a shape, and the blank."""
    blank = Gripped(network(size, comm=comm, **options), list(tools), shape=shape)
    state = blank.start()
    waves = Waves.of(blank, state)
    return waves, waves.figures(blank, blank.ply.fields(blank.of_cloth(state))), blank


def height(*arguments, **options):
    return measured(*arguments, **options)[1]["wrinkles"]["largest_height_mm"]


PLATE = Tool("plate", shapes.plane(), 0.0)
CORE = Tool("core", shapes.cylinder(RADIUS), 0.0, Pose(np.array([0, 0, -RADIUS])))
BALL = Tool("ball", shapes.sphere(RADIUS), 0.0, Pose(np.array([0, 0, -RADIUS])))


def test_flat_cloth_has_none():
    waves, figures, _ = measured(flat, [PLATE])
    assert abs(waves.height).max() < 1e-12
    assert figures["wrinkles"]["area_share"] == 0.0
    assert figures["wrinkles"]["at_rest_mm"] is None
    assert abs(np.nan_to_num(waves.curvature)).max() < 1e-9
    np.testing.assert_allclose(waves.normal, [[0.0, 0.0, 1.0]] * len(waves.normal), atol=1e-12)


@pytest.mark.parametrize("angle", [0, 30])
@pytest.mark.parametrize(("shape", "tool"), [(on_cylinder, CORE), (on_sphere, BALL)])
@pytest.mark.parametrize("with_tool", [True, False])
def test_cloth_that_is_bent_one_way_has_none(shape, tool, with_tool, angle):
    """On a cylinder and a sphere, and without the tool, too: below 2 % of the thickness."""
    waves, figures, _ = measured(
        shape, [tool] * with_tool, angle=f"{angle} deg", yarns_per_cruciform=1
    )
    assert figures["wrinkles"]["largest_height_mm"] < 0.02
    assert figures["bridging"]["largest_gap_mm"] == 0.0
    inner = np.isfinite(waves.curvature).all(axis=1)
    if shape is on_cylinder:
        turned = np.deg2rad(angle)
        wanted = -np.array([np.sin(turned) ** 2, np.cos(turned) ** 2]) / (RADIUS + HALF)
        np.testing.assert_allclose(waves.curvature[inner] - wanted, 0.0, atol=0.1)
        if with_tool:
            assert abs(waves.beyond_tool[inner]).max() < 0.1


@pytest.mark.parametrize(("base", "tool"), [(flat, PLATE), (on_cylinder, CORE)])
@pytest.mark.parametrize("way", [(0.0, 1.0), (0.7071, 0.7071)])
def test_a_sine_has_its_amplitude(base, tool, way):
    """Within 4 % up to 0.75 L, here 30 mm (10 % across a cylinder), whatever it is; 0.9 at L."""

    def waved(amplitude, length, **options):
        lift = sine(amplitude, length, way)

        def shape(rest):
            return base(rest, lift=lift(rest))

        return height(shape, [tool], **options)

    for amplitude in (0.2, 1.0, 3.0):
        got = waved(1e-3 * amplitude, 0.03)
        assert got == pytest.approx(amplitude, rel=0.1 if base is on_cylinder else 0.04)
    assert waved(1e-3, 0.04) == pytest.approx(0.9, abs=0.05)
    coarse = waved(1e-3, 0.03, yarns_per_cruciform=2)
    assert coarse == pytest.approx(waved(1e-3, 0.03), rel=0.05)


def test_coarse_nets_look_for_waves_of_four_pitches():
    """On arms of 8 mm and more; finer ones for waves of 40 mm."""
    pitch = 4 * 10e-3 / 2.4
    waves, figures, _ = measured(
        lambda rest: flat(rest, sine(1e-3, 4 * pitch, (0.0, 1.0))(rest)),
        [PLATE],
        size=(200, 200),
        yarns_per_cruciform=4,
    )
    assert waves.longest == pytest.approx(4 * pitch)
    assert figures["wrinkles"]["wavelengths_mm"] == pytest.approx([4e3 * pitch] * 2)
    assert figures["wrinkles"]["largest_height_mm"] == pytest.approx(0.9, abs=0.05)


def test_what_is_told_of_wrinkled_cloth():
    """Compression of its yarns and their curvature, not those beside it."""

    def shape(rest):
        ramp = np.clip(rest[:, 0] / 30e-3, 0.0, 1.0)
        lift = ramp**2 * (3.0 - 2.0 * ramp) * sine(1e-3, 0.03, (0.0, 1.0))(rest)
        x = 0.98 * rest[:, 0] - 0.03 * np.minimum(rest[:, 0] + 30e-3, 0.0)
        return np.column_stack([x, rest[:, 1], rest[:, 2] + lift])

    told = measured(shape, [PLATE])[1]["wrinkles"]
    assert told["largest_height_mm"] > 0.5
    assert told["yarn_compression_percent"] == pytest.approx(2.0, abs=0.3)
    assert told["curvature_beyond_tools_per_m"] == pytest.approx(
        1e-3 * (2 * np.pi / 0.03) ** 2, rel=0.1
    )


@pytest.mark.parametrize("over", [False, True])
@pytest.mark.parametrize("turn", [0.0, 30.0])
def test_tools_are_seen_from_where_they_stand(over, turn):
    """A cylinder turned about z, cloth on it or under it; curvature is the tool's own."""
    c, s = np.cos(np.deg2rad(turn)), np.sin(np.deg2rad(turn))
    turned = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
    up = np.array([1.0, 1.0, -1.0 if over else 1.0])
    core = Tool("core", shapes.cylinder(RADIUS), 0.0, Pose(-RADIUS * up * [0, 0, 1], turned))
    waves, _, _ = measured(lambda rest: (on_cylinder(rest @ turned) * up) @ turned.T, [core])
    assert np.nanmax(abs(waves.curvature)) > 10.0
    assert np.nanmax(abs(waves.beyond_tool)) < 0.1


def test_waves_on_a_tool_that_lies_askew():
    """Heights are across the cloth, whatever the angle of the tool beside it."""
    angle = np.deg2rad(45.0)
    c, s = np.cos(angle), np.sin(angle)
    slant = np.array([[c, 0.0, s], [0.0, 1.0, 0.0], [-s, 0.0, c]])
    plate = Tool("plate", shapes.plane(), 0.0, Pose(np.array([0.0, 0.0, -1e-3]), slant))
    lift = sine(0.2e-3, 0.03, (0.0, 1.0))
    waves, _, blank = measured(lambda rest: flat(rest, lift(rest)), [plate])
    near = abs(blank.network.crossover_position[:, 0]) < 8e-3
    assert waves.height[near].max() == pytest.approx(0.2e-3, rel=0.1)


def test_what_is_cut_off_has_none():
    """Waves on cloth that was trimmed away do not count, nor do they beside the cut."""
    net = network((120, 120))

    def waved(rest):
        lift = np.where(rest[:, 0] > 20e-3, sine(1e-3, 0.03, (0.0, 1.0))(rest), 0.0)
        return flat(rest, lift)

    blank = Gripped(net, [PLATE], shape=waved, cuts={"trim 0": shapely.box(-1, -1, 15e-3, 1)})
    for factor, height in ((1.0, 0.96), (0.0, 0.0)):
        state = replace(blank.start(), factors={"trim 0": factor})
        waves = Waves.of(blank, state)
        told = waves.figures(blank, blank.ply.fields(blank.of_cloth(state)))["wrinkles"]
        assert told["largest_height_mm"] == pytest.approx(height, abs=0.05)
    assert np.isnan(waves.height[net.crossover_position[:, 0] > 15e-3]).all()


def test_folds_that_run_down_a_sphere():
    """Ten around, up to 31 mm apart and closer above: their height, 0.8 mm."""

    def folded(rest):
        rho, phi = np.hypot(rest[:, 0], rest[:, 1]), np.arctan2(rest[:, 1], rest[:, 0])
        lift = 0.8e-3 * (1.0 + np.sin(10.0 * phi)) * np.clip((rho - 20e-3) / 15e-3, 0.0, 1.0)
        centre = np.array([0.0, 0.0, -RADIUS])
        place = on_sphere(rest) - centre
        return place * (1.0 + lift / np.linalg.norm(place, axis=1))[:, None] + centre

    waves, figures, blank = measured(folded, [BALL], size=(104, 104))
    assert figures["wrinkles"]["largest_height_mm"] == pytest.approx(0.8, rel=0.1)
    assert figures["bridging"]["largest_gap_mm"] == 0.0
    pole = np.linalg.norm(blank.network.crossover_position, axis=1) < 12e-3
    assert waves.height[pole].max() < 0.1e-3


def over_an_edge(rest, radius=6e-3, angle=0.87):
    """Flat, then bent over a radius by 50 degrees, then straight."""
    around = radius + HALF
    s = np.clip(rest[:, 0], 0.0, around * angle)
    beyond = np.maximum(rest[:, 0] - around * angle, 0.0)
    phi = s / around
    x = np.minimum(rest[:, 0], 0.0) + around * np.sin(phi) + beyond * np.cos(angle)
    z = around * (np.cos(phi) - 1.0) - beyond * np.sin(angle) + HALF
    return np.column_stack([x, rest[:, 1], z])


def profile(corners, fillet):
    """A tool of corners x, z in mm."""
    surface = Profile(1e-3 * np.array(corners, float), 1e-3 * fillet, turned=False)
    return Tool("profile", surface, 0.0)


def test_a_free_span_beyond_an_edge_has_none():
    """Bent over a small radius and then straight, off the tool: no wave, no hollow."""
    edge = profile([[-100, 0], [6, 0], [6, -80]], 6.0)
    for tools in ([edge], []):
        _, figures, _ = measured(over_an_edge, tools)
        assert figures["wrinkles"]["largest_height_mm"] < 0.02
        assert figures["bridging"]["largest_gap_mm"] == 0.0


@pytest.mark.parametrize("turned", [False, True])
def test_cloth_over_a_groove_bridges_it(turned):
    """Flat over a groove 8 mm deep: no wrinkle, and a gap of 8 mm."""
    groove = profile([[-100, 0], [-10, 0], [-5, -8], [5, -8], [10, 0], [100, 0]], 2.0)
    angle = "45 deg" if turned else "0 deg"
    waves, figures, blank = measured(flat, [groove], angle=angle)
    assert figures["bridging"]["largest_gap_mm"] == pytest.approx(8.0, abs=0.1)
    assert figures["wrinkles"]["largest_height_mm"] < 0.05
    share = figures["bridging"]["area_share"]
    assert 10 / 120 < share < 22 / 120
    beside = abs(blank.network.crossover_position[:, 0]) > 12e-3
    assert not waves.bridging[beside].any()


def test_cloth_that_is_pressed_bridges_nothing():
    """The same groove, with a stamp on the cloth over it."""
    groove = profile([[-100, 0], [-10, 0], [-5, -8], [5, -8], [10, 0], [100, 0]], 2.0)
    over = Pose(np.array([0.0, 0.0, THICKNESS - 1e-5]), OVER)
    stamp = Tool("stamp", shapes.plane((0.4, 0.4)), 0.0, over)
    _, figures, _ = measured(flat, [groove, stamp])
    assert figures["bridging"]["largest_gap_mm"] == 0.0


def test_cloth_in_a_hollow_bridges_nothing():
    """Inside a cylinder, on it all over; and in the same with waves: wrinkles, hardly bridges."""
    hollow = RADIUS + 2 * HALF

    def inside(rest, lift=0.0):
        return on_cylinder(rest, RADIUS, lift) * [1, 1, -1]

    corners = np.linspace(np.pi, 2 * np.pi, 61)[3:-3]
    arc = 1e3 * hollow * np.column_stack([np.cos(corners), np.sin(corners)]) + [0, 50]
    trough = Tool("trough", Profile(1e-3 * arc, None, turned=False), 0.0)
    _, figures, _ = measured(inside, [trough], size=(90, 90))
    assert figures["bridging"]["largest_gap_mm"] == 0.0
    assert figures["wrinkles"]["largest_height_mm"] < 0.02
    lift = sine(-1e-3, 0.03, (0.0, 1.0))
    _, figures, _ = measured(lambda rest: inside(rest, lift(rest)), [trough], size=(90, 90))
    assert figures["wrinkles"]["largest_height_mm"] == pytest.approx(1.0, rel=0.1)
    assert figures["bridging"]["area_share"] < 0.1
