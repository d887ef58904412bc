# SPDX-License-Identifier: MIT
"""Critical loads and modes against closed forms and an independent series; the branches beyond."""

from dataclasses import replace

import numpy as np
import pytest
from mpi4py import MPI
from numpy.polynomial import Polynomial, legendre
from scipy.linalg import eigh
from scipy.optimize import minimize_scalar
from support.finite import Cloth

from cruciform_petsc import Fabric, Network, OffAxisTension, PictureFrame, Preform, YarnFamily
from cruciform_petsc.equilibrium.newton import Equilibrium
from cruciform_petsc.equilibrium.stability import Stability
from cruciform_petsc.experiments.finite import FiniteTest
from cruciform_petsc.items.loads import PressureAbove
from cruciform_petsc.net.edges import Constraints
from cruciform_petsc.solvers.eigen import Factor, largest

RIGIDITY, LENGTH, STIFF = 1e-3, 0.1, 4e5


def cloth_of(pitch, out_of_plane=(RIGIDITY, RIGIDITY), shear=1e3, twisting=0.0):
    """Stiff in tension, no Poisson; yarns stiff enough in the plane not to kink there first."""
    warp, weft = (YarnFamily(STIFF, 0.0, 1 / pitch, 1e-4, b) for b in out_of_plane)
    return Fabric("cloth", warp, weft, shear, out_of_plane_twisting=twisting)


def strip(n, **keys):
    """A strip two pitches wide, n long."""
    pitch = LENGTH / n
    return Network(
        MPI.COMM_SELF, Preform.rectangle(2 * pitch, LENGTH, 0.0), cloth_of(pitch, **keys)
    )


def euler(n):
    """Critical loads of a clamped strut over Euler's, linearised and on the way; and the result."""
    test = OffAxisTension(
        strip(n), ["-0.5 um", "-2 um"], space=True, stability={"step": "0.05 mm", "modes": 2}
    )
    result = test.solve()
    load = 4 * np.pi**2 * RIGIDITY / LENGTH**2 * test.size[0]
    found = result.buckling
    return -found.linear[0].load / load, -found.passed[0].load / load, result


def test_clamped_strut():
    """P = 4 pi^2 B/L^2 per width (Euler), to second order in the pitch: 0.82, 0.20 %."""
    coarse, fine = euler(10), euler(20)
    for i in (0, 1):
        assert abs(fine[i] - 1) < 2.5e-3
        assert abs(fine[i] - 1) < 0.27 * abs(coarse[i] - 1)
    # Compressed yarns are shorter by 1e-5: the linearised load is that on the way but for this.
    assert fine[0] == pytest.approx(fine[1], rel=2e-5)
    assert len(fine[2].buckling.passed) == 1


def test_branch_of_the_strut():
    """Beyond, the load hardly rises, and the height is what the strip has been shortened by.

    w = h/2 (1 - cos(2 pi y/L)): the shortening is pi^2 h^2/(4 L), to order h^2/L^2 = 4e-6.
    """
    _, _, result = euler(20)
    curve, critical = result.curve(), result.buckling.passed[0]
    assert curve["critical"].tolist() == [0, 1, 0]
    assert curve["asked"].tolist() == [1, 0, 1]
    assert curve["lowest_stiffness_Pa_per_mm"][2] > 1.0
    shortened = critical.control - result.controls[-1]
    height = np.sqrt(4 * LENGTH * shortened) / np.pi
    assert result.heights_max[-1] == pytest.approx(height, rel=5e-3)
    assert result.heights_max[0] == 0.0
    assert curve["load_N"][2] == pytest.approx(critical.load, rel=1e-4)


@pytest.mark.parametrize("step", [2e-5, -5e-4])
def test_step_along_the_mode(step):
    """Its sign is the side, its size does not matter."""
    test = OffAxisTension(strip(10), "-2 um", space=True, stability={"step": step})
    moved = test.solve().fields["displacement"][:, 2]
    assert np.sign(moved[abs(moved).argmax()]) == np.sign(step)
    assert abs(moved).max() == pytest.approx(2.043e-4, rel=1e-3)


def test_keeps_to_its_side():
    """However much longer than before steps are: heights rise with the root of the control."""
    way = [f"-{2 * 4**k} um" for k in range(5)]
    test = OffAxisTension(strip(10), way, space=True, stability={"step": "0.05 mm"})
    result = test.solve()
    moved = [state.fields["displacement"][:, 2] for state in result.states]
    assert (np.array([z.min() for z in moved]) > -1e-9).all()
    assert (np.diff(result.heights_max) > 0.0).all()
    assert sum(step.iterations for step in result.increments) < 45


def test_unstable_branch():
    """With branch = false the strut stays straight, and the load goes on rising with it."""
    keys = {"space": True, "stability": {"branch": False}}
    result = OffAxisTension(strip(10), ["-2 um", "-4 um"], **keys).solve()
    curve = result.curve()
    assert curve["critical"].tolist() == [1, 0, 0]
    assert (curve["lowest_stiffness_Pa_per_mm"][1:] < -1.0).all()
    assert (result.heights_max == 0.0).all()
    assert curve["load_N"][2] == pytest.approx(2 * curve["load_N"][1], rel=1e-3)


def test_stiffness_at_rest():
    """m = B (4.7300/L)^4 of a clamped beam: the foundation's stiffness of its first mode."""
    test = OffAxisTension(strip(20), "-0.1 um", space=True, stability={"modes": 3})
    found = test.solve().buckling
    assert not found.passed
    wanted = RIGIDITY * (4.730041 / LENGTH) ** 4
    assert found.stiffness[0] == pytest.approx(wanted, rel=6e-3)
    # The control is 5 % of the critical one, by which the stiffness has gone down.
    first, *_ = (mode.fields["displacement"][:, 2] for mode in found.modes)
    assert first.max() == pytest.approx(1.0, abs=1e-6)
    assert first.min() > -1e-6


def test_without_torsional_rigidity_bending_comes_first():
    """A strip bends and twists at the same load; modes are told apart alike on any ranks."""
    _, _, result = euler(10)
    bent, twisted = (mode.fields["displacement"][:, 2] for mode in result.buckling.modes)
    x = result.network.crossover_position[:, 0]
    assert abs(bent @ (x - x.mean())) < 1e-6 * np.linalg.norm(bent) * np.linalg.norm(x)
    assert abs(twisted.sum()) < 1e-6 * abs(twisted).sum()


def test_modes_do_not_depend_on_how_they_come():
    """Eigenvectors have any sign and size, and any mixture of those of one eigenvalue will do."""
    test = FiniteTest(OffAxisTension(strip(10), "-2 um", space=True, stability={"modes": 2}))
    stability = Stability(test.model, test.ply.areas(1 / 3), 2)
    start = test.at(0.0)
    pushed = replace(start, x=start.x * [1.0, 1.0 - 1e-5, 1.0])
    matrices = [test.model.stiffness(state)[0] for state in (start, pushed)]
    factor = Factor(matrices[0])
    change = matrices[0] - matrices[1]
    ratios, vectors = largest(change, matrices[0], factor, 4)
    assert ratios[0] == pytest.approx(ratios[1], rel=1e-9)
    wanted = stability._modes(1 / ratios, vectors, 1e-5, start)
    mixed = vectors.copy()
    mixed[:2] = [[0.6, -3.0], [2.5, 0.5]] @ vectors[:2]
    for other in (-vectors, mixed):
        found = stability._modes(1 / ratios, other, 1e-5, start)
        np.testing.assert_allclose(found.shapes, wanted.shapes, atol=1e-9)
    alone = [stability._modes(np.arange(4.0), v, 1e-5, start).shapes for v in (vectors, -vectors)]
    np.testing.assert_allclose(*alone, atol=1e-9)
    assert wanted.shapes.max(axis=(1, 2)) == pytest.approx([1.0, 1.0], abs=1e-9)
    for thing in (factor, change, *matrices, stability):
        thing.destroy()


# -- a panel in shear -----------------------------------------------------------------------------


def ritz(rigidities, sides, n=12, twisting=0.0):
    """Critical shear flow of a clamped plate that bends along x and y, and may resist twist.

    Ritz's method with (1 - s^2)^2 P_i(s) in both directions: stationary values of
    int D_1 w_xx^2 + D_2 w_yy^2 + (D_1 + D_2) t w_xy^2 + 2 N w_x w_y.
    """
    s, weight = legendre.leggauss(n + 8)
    clamp = Polynomial([1, 0, -2, 0, 1])
    functions = [clamp * legendre.Legendre.basis(i).convert(kind=Polynomial) for i in range(n)]
    f, df, ddf = (np.array([p.deriv(k)(s) if k else p(s) for p in functions]) for k in range(3))
    m, c, k = f * weight @ f.T, df * weight @ f.T, ddf * weight @ ddf.T
    (a, b), (d1, d2) = 0.5 * np.array(sides), rigidities
    stiffness = d1 * b / a**3 * np.kron(k, m) + d2 * a / b**3 * np.kron(m, k)
    slope = df * weight @ df.T
    stiffness += twisting * (d1 + d2) / (a * b) * np.kron(slope, slope)
    geometric = np.kron(c, c.T)
    return 1.0 / eigh(-geometric - geometric.T, stiffness, eigvals_only=True)[-1]


def long_strip():
    """N b^2/(D_1 D_2^3)^(1/4) of a long clamped strip: w = f(y) e^(ikx), the least over k.

    D_2 f'''' + 2 i k N f' + D_1 k^4 f = 0 with f = f' = 0 at both edges.
    """

    def determinant(load, k):
        r = np.roots([1.0, 0.0, 0.0, 2j * k * load, k**4])
        e = np.exp(np.outer([-0.5, 0.5], r))
        matrix = np.concatenate([e, r * e])
        # Divided by what vanishes where two roots fall together; a phase is left.
        pairs = np.prod([r[i] - r[j] for i in range(4) for j in range(i)])
        return np.linalg.det(matrix) / pairs

    def lowest(k):
        loads = np.linspace(20.0, 120.0, 401)
        values = np.array([determinant(load, k) for load in loads])
        values = (values / np.exp(1j * np.angle(values[0]))).real
        at = np.flatnonzero(np.diff(np.sign(values)))[0]
        share = values[at] / (values[at] - values[at + 1])
        return loads[at] + share * (loads[1] - loads[0])

    return minimize_scalar(lowest, bounds=(2.0, 8.0), method="bounded").fun


def test_the_series_itself():
    """Long panels go to the strip, 4 x 15.07 (Seydel's strips, D_3 = 0, by Lekhnitskii's table)."""
    strip = long_strip()
    assert strip == pytest.approx(4 * 15.07, rel=1e-3)
    long = ritz((1.0, 1.0), (5.0, 1.0), 20)
    assert strip < long < 1.03 * strip
    # An isotropic square: 14.71 pi^2 D/b^2 (Timoshenko and Gere), from above, by fewer terms.
    square = ritz((1.0, 1.0), (1.0, 1.0), twisting=1.0)
    assert 0.99 * 14.71 * np.pi**2 < square < 14.71 * np.pi**2
    # Scaled along x, a panel is another one of another rigidity.
    assert ritz((16.0, 1.0), (2.0, 1.0)) == pytest.approx(2.0 * ritz((1.0, 1.0), (1.0, 1.0)))


def sheared(n, rigidities=(RIGIDITY, RIGIDITY), across=1.0, twisting=0.0):
    """Critical shear flow of a panel in a picture frame over that of the series."""
    pitch = LENGTH / n
    preform = Preform.rectangle(across * LENGTH, LENGTH, 0.0)
    cloth = cloth_of(pitch, rigidities, twisting=twisting)
    network = Network(MPI.COMM_SELF, preform, cloth)
    test = PictureFrame(network, "0.1 deg", space=True, stability={})
    critical = test.solve().buckling.linear[0]
    flow = 1e3 * critical.control  # G gamma
    # The warp runs along y.
    return flow / ritz(rigidities[::-1], (across * LENGTH, LENGTH), twisting=twisting) - 1.0


def test_sheared_panel():
    """To second order in the pitch; 0.12 % with 20 pitches."""
    coarse, fine = sheared(8), sheared(16)
    assert abs(fine) < 4e-3
    assert abs(fine) < 0.4 * abs(coarse)


def test_sheared_panel_of_two_rigidities():
    """The warp four times as stiff, twice as long as wide: which is which shows."""
    assert abs(sheared(16, (4e-3, 1e-3), 0.5)) < 1e-2


def test_sheared_panel_that_resists_twist():
    """Like a sheet that bends alike in all directions: half as much again."""
    assert abs(sheared(16, twisting=1.0)) < 1.2e-2


# -- a tube under pressure from outside -----------------------------------------------------------


def tube(n):
    """Error of the pressure at which a long tube of cloth, rolled from flat, is crushed.

    A quarter of its circumference, x = R sin(t), z = R cos(t), between planes of symmetry.
    """
    radius, size = 0.05, 0.05 * np.pi / 2
    pitch = size / n
    network = Network(MPI.COMM_SELF, Preform.rectangle(size, 2 * pitch, 0.0), cloth_of(pitch))
    constraints = Constraints(network, True)
    edges = {edge: constraints.clamp(edge) for edge in ("left", "right")}
    pressure = [lambda ply: PressureAbove(ply, -1.0)]  # times the factor of a state
    cloth = Cloth(constraints, edges, (RIGIDITY, RIGIDITY), False, pressure)
    nodes, rest = cloth.nodes, cloth.rest
    angle = (rest[:, 0] - rest[:, 0].min()) / radius
    x = np.column_stack([radius * np.sin(angle), rest[:, 1], radius * np.cos(angle)])
    nodes.frame[:] = np.eye(3)
    fixed = np.zeros(x.shape, bool)
    fixed[:, 1] = True  # a slice of a long tube
    fixed[nodes.of_network_node[edges["left"]], 0] = True
    fixed[nodes.of_network_node[edges["right"]], 2] = True
    turn = np.tile(np.eye(3), (len(cloth.ply.clamped), 1, 1))
    turn[cloth.ply.clamp_of[edges["right"]]] = [[0, 0, 1], [0, 1, 0], [-1, 0, 0]]
    hold = replace(
        cloth.state().hold,
        nodes=np.arange(len(x), dtype=np.int32), axes=nodes.frame, fixed=fixed, place=x, turn=turn,
    )  # fmt: skip

    def drive(control):
        return hold, {"pressure": control}

    start = replace(cloth.state(), x=x, hold=hold, factors={"pressure": 0.0})
    equilibrium = Equilibrium(cloth.model, start)
    stability = Stability(cloth.model, cloth.ply.areas(1 / 3), step=1e-4)
    start = equilibrium.solve(start).state
    stability.at_rest(start)
    _, modes = stability.linear(equilibrium, drive, start, 1e-2)
    equilibrium.destroy()
    stability.destroy()
    oval = modes.shapes[0]
    radial = np.sin(angle) * oval[:, 0] + np.cos(angle) * oval[:, 2]
    assert abs(abs(radial) - abs(np.cos(2 * angle))).max() < 0.02
    return 1e-2 * modes.values[0] / (3 * RIGIDITY / radius**3) - 1.0


def test_tube_under_pressure():
    """p = 3 B/R^3 (Levy 1884), whatever moment the cloth was rolled by; to second order."""
    coarse, fine = tube(8), tube(16)
    assert abs(fine) < 5e-3
    assert abs(fine) < 0.33 * abs(coarse)
