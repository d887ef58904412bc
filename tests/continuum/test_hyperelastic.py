# SPDX-License-Identifier: MIT
"""The hyperelastic membrane: derivatives, closed forms, large shear, yarn bending."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from mpi4py import MPI
from support.biaxial import COARSE, WIDE

from cruciform_petsc.cloth.fabric import Fabric, YarnFamily
from cruciform_petsc.cloth.preform import Preform
from cruciform_petsc.continuum.balance import Balance
from cruciform_petsc.continuum.compare import compare_fields
from cruciform_petsc.continuum.hyperelastic import HyperelasticMembrane
from cruciform_petsc.continuum.membrane import Membrane
from cruciform_petsc.errors import InputError, SolverError
from cruciform_petsc.laws import odd_polynomial, sin_powers, table

COMM = MPI.COMM_SELF
TABLE_1 = Fabric.from_library("e-glass-plain-2.4")
# No two numbers alike, so that no warp can pass for a weft.
UNEVEN = Fabric(
    "uneven", YarnFamily(50e3, 0.4, 240.0, 5e-6), YarnFamily(20e3, 0.16, 310.0, 9e-6), 700.0
)
# Laws of tension go without Poisson's ratios.
UNCOUPLED = replace(
    UNEVEN,
    warp=replace(UNEVEN.warp, poisson=0.0),
    weft=replace(UNEVEN.weft, poisson=0.0),
)
LOCKING = table(np.radians([5, 20, 35, 50, 70]), [60.0, 120.0, 220.0, 600.0, 3000.0])
FABRICS = {
    "linear": UNEVEN,
    "tables": replace(
        UNCOUPLED,
        shear_law=LOCKING,
        shear_modulus=LOCKING.stiffness0,
        warp_law=table([0.05, 0.2, 0.5], [50e3 * 0.05, 50e3 * 0.25, 50e3 * 0.9]),
    ),
    "log-compression": replace(UNEVEN, log_strain=True, compression=0.1, compression_width=0.02),
    "sine-polynomial": replace(
        UNCOUPLED,
        shear_law=sin_powers([350.0, 200.0, -50.0]),
        weft_law=odd_polynomial([20e3, 60e3]),
        log_strain=True,
    ),
    "surface": UNEVEN.with_biaxial_law(WIDE),
    "crimp-compression": replace(
        UNEVEN.with_biaxial_law(COARSE.law), compression=0.1, compression_width=0.02
    ),
}
EVERY_LAW = pytest.mark.parametrize("fabric", FABRICS.values(), ids=FABRICS.keys())
SQUARE = Preform.rectangle(0.03, 0.03, "25 deg")


def rotation(degrees: float) -> np.ndarray:
    c, s = np.cos(np.radians(degrees)), np.sin(np.radians(degrees))
    return np.array([[c, -s], [s, c]])


def stiff(ratio: float, bending: float = 0.0) -> Fabric:
    """No Poisson's ratio, E/G as given; sqrt(D/G) is `bending` metres."""
    g = 100.0
    yarns = YarnFamily(ratio * g, 0.0, 240.0, g * bending**2 / 240.0)
    return Fabric("stiff", yarns, yarns, g)


def net_extension(length: float, degrees: np.ndarray) -> np.ndarray:
    """Extension at which the middle of an inextensible net is sheared, length = H - W."""
    return np.sqrt(2) * length * np.cos(np.radians(90 - np.asarray(degrees)) / 2) - length


# -- derivatives --------------------------------------------------------------------------------


@pytest.mark.parametrize("bending", [False, True], ids=["", "bending"])
@EVERY_LAW
def test_force_and_tangent_are_derivatives(fabric, bending):
    """In a random state far from rest, clamps turned; central differences."""
    membrane = HyperelasticMembrane(COMM, SQUARE, fabric, 0.015, 3, grading=0, bending=bending)
    state = Balance(membrane, membrane.rigidity, {"lower": None, "upper": None}, "membrane_")
    rng = np.random.default_rng(5)
    stretch = rotation(40) @ np.array([[1.1, 0.45], [0.1, 0.9]])
    x = membrane.nodes
    u = (x @ (stretch - np.eye(2)).T + 4e-4 * rng.standard_normal(x.shape)).ravel()
    turn = np.eye(3)
    turn[:2, :2] = rotation(55)
    state.turn_clamps({"lower": turn, "upper": turn})
    way = np.where(state.fixed, 0.0, rng.standard_normal(state.fixed.shape)).ravel()

    def at(shift: float) -> tuple[float, np.ndarray]:
        state.u.x.array[:] = u + shift * way
        assert state.update()
        return state.energies.sum(), state.force().ravel()

    at(0.0)
    spread = np.ptp(state.measures.reshape(-1, 3), axis=0)
    assert (spread[:2] > 0.15).all()
    assert spread[2] > 0.3
    force = state.force().ravel()
    matrix = state.assemble()
    along, y = matrix.createVecs()
    along.array[:] = way
    matrix.mult(along, y)
    product = y.array.copy()
    symmetric = matrix.isSymmetric(1e-8 * matrix.norm())
    step = 1e-9
    (e0, f0), (e1, f1) = at(-step), at(step)
    assert force @ way == pytest.approx((e1 - e0) / (2 * step), rel=1e-6)
    difference = np.where(state.fixed.ravel(), 0.0, (f1 - f0) / (2 * step))
    assert np.linalg.norm(product - difference) < 1e-6 * np.linalg.norm(difference)
    assert symmetric
    if bending:
        assert state.energies[2] > 1e-3 * state.energies.sum()


# -- homogeneous states -------------------------------------------------------------------------


def density(fabric: Fabric, preform: Preform, gradient: np.ndarray) -> float:
    """Energy per area of a homogeneous state, J/m^2, with the angle by its cosine."""
    a, b = gradient @ preform.warp_direction, gradient @ preform.weft_direction
    size = np.array([np.linalg.norm(a), np.linalg.norm(b)])
    gamma = np.pi / 2 - np.arccos(a @ b / size.prod())
    if fabric.biaxial_law is not None:
        e = np.log(size) if fabric.log_strain else size - 1.0
        soft = (fabric.compression, fabric.compression_width)
        tension = fabric.biaxial_law.evaluate(*e, *soft)[0]
        return float(tension + fabric.shear.evaluate(gamma)[0])
    e = fabric.effective_strain(size)[0]
    laws = (fabric.warp_tension, fabric.weft_tension, fabric.shear)
    w = [float(law.evaluate(x)[0]) for law, x in zip(laws, (*e, gamma), strict=True)]
    return sum(w) + fabric.c12 * e[0] * e[1]


@EVERY_LAW
def test_homogeneous_states(fabric):
    """Edges moved by one affine motion: energy and the forces on the edges in closed form."""
    preform = Preform.rectangle(0.02, 0.03, "25 deg")
    membrane = HyperelasticMembrane(COMM, preform, fabric, 0.01, 2, grading=0)
    edges = ("lower", "right", "upper", "left")
    gradient = rotation(30) @ np.array([[1.05, 0.5], [0.15, 0.97]])
    (result,) = membrane.solve_motions([dict.fromkeys(edges, (gradient, (0.01, -0.02)))])
    assert result.energy == pytest.approx(6e-4 * density(fabric, preform, gradient), rel=1e-9)
    stress = np.zeros((2, 2))
    for i in range(2):
        for j in range(2):
            step = np.zeros((2, 2))
            step[i, j] = 1e-6
            two = [density(fabric, preform, gradient + s * step) for s in (1, -1)]
            stress[i, j] = (two[0] - two[1]) / 2e-6
    nodal = result.nodal_force
    assert np.allclose(nodal.sum(axis=0), 0, rtol=0, atol=1e-9 * abs(stress).max() * 0.02)
    x = membrane.nodes[: len(nodal)]
    moment = nodal.T @ x  # is the stress times the area, by the divergence theorem
    assert np.allclose(moment, 6e-4 * stress, rtol=0, atol=1e-6 * 6e-4 * abs(stress).max())
    points = np.array([[0.003, 0.011], [-0.007, 0.02]])
    field = result.evaluate(points)
    a, b = gradient @ preform.warp_direction, gradient @ preform.weft_direction
    assert np.allclose(field["warp_strain"], np.linalg.norm(a) - 1, rtol=1e-8)
    assert np.allclose(field["weft_strain"], np.linalg.norm(b) - 1, rtol=1e-8)
    assert np.allclose(
        field["shear_angle"], np.arcsin(a @ b / np.linalg.norm(a) / np.linalg.norm(b)), rtol=1e-8
    )
    moved = points @ gradient.T + (0.01, -0.02) - points
    assert np.allclose(field["displacement"], moved, rtol=0, atol=1e-12)


def test_picture_frame():
    """Hinged square, yarns along its sides, to 50 degrees: shear force tau, cross-head force."""
    side, fabric = 0.1, FABRICS["tables"]
    corners = side / np.sqrt(2) * np.array([(0, -1), (1, 0), (0, 1), (-1, 0)])
    preform = Preform.polygon(corners, (), "45 deg")
    edges = [f"outline-{i}" for i in range(1, 5)]
    membrane = HyperelasticMembrane(COMM, preform, fabric, side / 3, 2, grading=0)
    angles = np.radians([10, 30, 50])

    def frame(gamma: float) -> np.ndarray:
        half = (np.pi / 2 - gamma) / 2  # of the angle of the sides at the ends of the pull
        return np.diag(np.sqrt(2) * np.array([np.sin(half), np.cos(half)]))

    motions = [dict.fromkeys(edges, (frame(g), np.zeros(2))) for g in angles]
    for gamma, result in zip(angles, membrane.solve_motions(motions), strict=True):
        energy, tau = (float(v) for v in fabric.shear.evaluate(gamma)[:2])
        assert result.energy_tension < 1e-12 * result.energy
        assert result.energy_shear == pytest.approx(side**2 * energy, rel=1e-10)
        # The frame's work F d(2 L cos(half)) = F L sin(half) d(gamma) is that of the nodes.
        rate = (frame(gamma + 1e-5) - frame(gamma - 1e-5)) / 2e-5
        nodal = result.nodal_force
        x = membrane.nodes[: len(nodal)]
        half = (np.pi / 2 - gamma) / 2
        force = (nodal * (x @ rate.T)).sum() / (side * np.sin(half))
        # F_s = F/(2 cos half) acts along a side, its power F_s L cos(gamma) is that of tau L^2.
        assert force == pytest.approx(2 * np.cos(half) * side * tau / np.cos(gamma), rel=1e-8)


# -- bias extension -----------------------------------------------------------------------------


@pytest.mark.parametrize("upper", ["grip", "centre-line"])
def test_small_extension_is_the_linear_membrane(upper):
    """Differences are of the order of the strains, 1e-5, and 1e-4 at the ends of the clamps."""
    preform = Preform.rectangle(0.02, 0.03, "45 deg")
    linear = Membrane(COMM, preform, UNEVEN, 2e-3, 3, 3).solve_bias_extension(3e-7, upper)
    membrane = HyperelasticMembrane(COMM, preform, UNEVEN, 2e-3, 3, 3)
    (finite,) = membrane.solve_bias_extension([3e-7], upper)
    assert finite.load == pytest.approx(linear.load, rel=1e-4)
    assert finite.energy_shear == pytest.approx(linear.energy_shear, rel=1e-4)
    assert finite.extension == pytest.approx(3e-7, rel=1e-9)
    points = np.array([[0.004, 0.008], [0.0, 0.015], [-0.006, 0.021]])
    ours, theirs = finite.evaluate(points), linear.evaluate(points)
    for name, value in theirs.items():
        assert np.allclose(ours[name], value, rtol=0, atol=2e-4 * abs(value).max()), name


@pytest.mark.parametrize("bending", [False, True], ids=["", "bending"])
def test_objectivity(bending):
    """A specimen pulled to 25 degrees and turned by 77 degrees: same energy, forces turned."""
    preform = Preform.rectangle(0.1, 0.2, "40 deg")
    membrane = HyperelasticMembrane(
        COMM, preform, stiff(1e3, 3e-3), 0.04, 3, grading=0, bending=bending
    )
    rest, pull = (np.eye(2), np.zeros(2)), (np.eye(2), np.array([0.0, 0.018]))
    turn = rotation(77)
    centre = np.array([0.3, -0.1])  # far off
    shift = centre - turn @ centre
    turned = {"lower": (turn, shift), "upper": (turn, shift + turn @ pull[1])}
    straight, oblique = membrane.solve_motions([{"lower": rest, "upper": pull}, turned])
    (at_once,) = membrane.solve_motions([turned])
    points = np.array([[0.02, 0.06], [0.0, 0.1], [-0.03, 0.13]])
    for result in (oblique, at_once):
        assert result.energy == pytest.approx(straight.energy, rel=1e-9)
        assert result.energy_bending == pytest.approx(straight.energy_bending, rel=1e-8)
        force = turn @ straight.edge_force("upper")
        assert np.allclose(result.edge_force("upper"), force, rtol=0, atol=1e-8 * straight.load)
        gamma = result.evaluate(points)["shear_angle"]
        assert np.allclose(gamma, straight.evaluate(points)["shear_angle"], rtol=0, atol=1e-8)


@pytest.mark.parametrize(("ratio", "middle"), [(1e3, 35.42), (1e4, 38.46), (1e6, 39.94)])
def test_stiff_yarns_to_40_degrees(ratio, middle):
    """Steps of 10 degrees of the inextensible net, of which the yarns' stiffness takes its share.

    The middle is that of a mesh of twice as many triangles across, the tolerance this mesh's.
    """
    preform = Preform.rectangle(0.1, 0.2, "45 deg")
    membrane = HyperelasticMembrane(COMM, preform, stiff(ratio), 0.01, 3, grading=1)
    results = membrane.solve_bias_extension(net_extension(0.1, [10, 20, 30, 40]).tolist())
    assert sum(result.newton_iterations for result in results) <= 7 * len(results)
    assert not any(result.cuts for result in results)
    points = np.array([[0.0, 0.1], [0.0, 0.025], [0.04, 0.06]])
    gamma = np.degrees(results[-1].evaluate(points)["shear_angle"])
    assert gamma[0] == pytest.approx(middle, abs=0.3)
    if ratio == 1e6:  # the zones of the net: all, nothing, half
        assert np.allclose(gamma, [40, 0, 20], rtol=0, atol=0.3)
    for result in results:
        below, above = (result.edge_force(name) for name in ("lower", "upper"))
        assert np.allclose(below, -above, rtol=0, atol=1e-7 * result.load)


@pytest.mark.parametrize("bending", [False, True], ids=["", "bending"])
def test_load_is_the_derivative_of_the_energy(bending):
    """With every part of the laws, by central differences."""
    preform = Preform.rectangle(0.02, 0.04, "35 deg")
    fabric = replace(FABRICS["tables"], log_strain=True, compression=0.1, compression_width=1e-3)
    membrane = HyperelasticMembrane(COMM, preform, fabric, 5e-3, 2, grading=0, bending=bending)
    h = 1e-6
    low, middle, high = membrane.solve_bias_extension([3e-3 - h, 3e-3, 3e-3 + h])
    assert middle.load == pytest.approx((high.energy - low.energy) / (2 * h), rel=1e-6)
    parts = middle.energy_tension + middle.energy_shear + middle.energy_bending
    assert middle.energy == pytest.approx(parts)
    assert (middle.energy_bending > 0) == bending


def test_newton_converges_quadratically():
    """In one step to 30 degrees: the order of the last reductions above rounding is two."""
    preform = Preform.rectangle(0.1, 0.2, "45 deg")
    membrane = HyperelasticMembrane(COMM, preform, stiff(1e2), 0.02, 3, grading=0)
    (result,) = membrane.solve_bias_extension([float(net_extension(0.1, 30))])
    assert result.cuts == 0
    assert result.newton_iterations <= 7
    r = np.array(result.history)
    r = r[r > 1e-11]  # below is rounding
    assert np.log(r[-1] / r[-2]) / np.log(r[-2] / r[-3]) > 1.7


def test_states_do_not_depend_on_the_steps():
    preform = Preform.rectangle(0.1, 0.2, "45 deg")
    membrane = HyperelasticMembrane(COMM, preform, stiff(1e3), 0.03, 3, grading=0)
    end = float(net_extension(0.1, 30))
    *_, many, back = membrane.solve_bias_extension([0.3 * end, 1.1 * end, 0.8 * end, end, 0.0])
    (once,) = membrane.solve_bias_extension([end])
    assert once.load == pytest.approx(many.load, rel=1e-7)
    assert abs(back.load) < 1e-6 * once.load
    assert back.energy < 1e-10 * once.energy


def test_comparison():
    preform = Preform.rectangle(0.1, 0.2, "45 deg")
    membrane = HyperelasticMembrane(COMM, preform, stiff(1e3), 0.03, 3, grading=0)
    (result,) = membrane.solve_bias_extension([0.02])
    points = np.array([[0.02, 0.06], [0.0, 0.1], [-0.03, 0.13]])
    field = result.evaluate(points)
    gamma = field["shear_angle"] + np.radians([1, -1, 0.5])
    comparison = compare_fields(
        COMM, points, field["displacement"], gamma, 1.01 * result.load, result.energy, result
    )
    assert comparison.mean_abs_shear_deg == pytest.approx(2.5 / 3)
    assert comparison.load_ratio == pytest.approx(1.01)


# -- yarn bending -------------------------------------------------------------------------------


def sheared_layer(size: float, degree: int, length: float, ell: float, slip: float = 1e-6):
    """A block between clamps that slip past each other, one yarn family across: u_x = f(y) alone.

    Its solution, with G f' - D f''' the shear force per length and f' = 0 at the clamps:
    f' = rate (1 - cosh((y - L/2)/l) / cosh(L/2l)), l = sqrt(D/G), and the load G rate W.
    """
    preform = Preform.rectangle(0.02, length, "90 deg")
    fabric = stiff(1e3, ell)
    membrane = HyperelasticMembrane(COMM, preform, fabric, size, degree, grading=0, bending=True)
    still, moved = (np.eye(2), np.zeros(2)), (np.eye(2), np.array([slip, 0.0]))
    sides = (*still, 1)
    (result,) = membrane.solve_motions(
        [{"left": sides, "right": sides, "lower": still, "upper": moved}]
    )
    rate = slip / (length - 2 * ell * np.tanh(length / 2 / ell))
    return result, rate, fabric.shear_modulus * rate * 0.02


@pytest.mark.parametrize("degree", [2, 3])
def test_layer_beside_a_clamp(degree):
    """Load, bending energy and the exponential layer, sqrt(D/G) wide, under refinement."""
    length, ell = 0.02, 1.5e-3
    y = np.linspace(0.0, length, 41)[1:-1]
    errors = []
    for size in (2.5e-3, 1.25e-3, 0.625e-3):
        result, rate, load = sheared_layer(size, degree, length, ell)
        gamma = result.evaluate(np.column_stack([np.full(len(y), 1.3e-3), y]))["shear_angle"]
        exact = rate * (1 - np.cosh((y - length / 2) / ell) / np.cosh(length / 2 / ell))
        exact *= np.sign(gamma[20])
        off_load = abs(result.edge_force("upper")[0] / load - 1)
        errors.append([off_load, np.linalg.norm(gamma - exact) / np.linalg.norm(exact)])
    orders = np.log2(np.array(errors[:-1]) / errors[1:])
    # In the norm of the energy, with f'' in it, order p - 1; the load has twice that.
    assert (orders[:, 0] > 2 * (degree - 1) - 0.6).all()
    assert (orders[:, 1] > degree - 0.6).all()
    assert errors[-1][0] < (3e-3, 1e-4)[degree - 2]
    s = np.linspace(0, length, 4001)
    curvature = rate / ell * np.sinh((s - length / 2) / ell) / np.cosh(length / 2 / ell)
    bending = 0.02 * 0.5 * 100.0 * ell**2 * np.trapezoid(curvature**2, s)
    assert result.energy_bending == pytest.approx(bending, rel=(2e-2, 1e-3)[degree - 2])


def test_soft_bending_tends_to_none():
    """The load falls with the rigidity towards that without."""
    preform = Preform.rectangle(0.1, 0.2, "45 deg")
    loads = []
    for ell in (4e-3, 1e-3, 2.5e-4):
        membrane = HyperelasticMembrane(
            COMM, preform, stiff(1e3, ell), 0.025, 3, grading=0, bending=True
        )
        loads.append(membrane.solve_bias_extension([0.02])[0].load)
    membrane = HyperelasticMembrane(COMM, preform, stiff(1e3), 0.025, 3, grading=0)
    plain = membrane.solve_bias_extension([0.02])[0].load
    assert loads[0] > loads[1] > loads[2] > plain
    assert loads[2] == pytest.approx(plain, rel=2e-3)


# -- what cannot be -----------------------------------------------------------------------------


def test_wrong_input():
    preform = Preform.rectangle(0.1, 0.2, "45 deg")
    membrane = HyperelasticMembrane(COMM, preform, stiff(1e3), 0.1, 2, grading=0)
    still = (np.eye(2), np.zeros(2))
    with pytest.raises(InputError, match="centre-line, grip"):
        membrane.solve_bias_extension([0.01], upper="loose")
    with pytest.raises(InputError, match="same edges"):
        membrane.solve_motions([{"lower": still, "upper": still}, {"lower": still}])
    with pytest.raises(InputError, match="rigid body"):
        membrane.solve_motions([{"lower": (*still, 1)}])
    with pytest.raises(InputError, match="motion of an edge"):
        membrane.solve_motions([{"lower": (np.eye(3), np.zeros(2))}])
    with pytest.raises(InputError, match="inside out"):
        membrane.solve_motions([{"lower": (np.diag([1.0, -1.0]), np.zeros(2))}])
    with pytest.raises(InputError, match='no edge "top"'):
        membrane.solve_motions([{"top": still}])
    with pytest.raises(InputError, match="degree 2"):
        HyperelasticMembrane(COMM, preform, stiff(1e3), 0.1, 1, bending=True)
    assert membrane.solve_motions([]) == []


def test_buckling_is_told():
    """Pressed along its yarns, cloth that does not bend buckles once the pressure exceeds G."""
    fabric = stiff(1e3)  # buckles at a strain of 1e-3
    membrane = HyperelasticMembrane(
        COMM, Preform.rectangle(0.02, 0.03, "0 deg"), fabric, 2e-3, 2, grading=0
    )
    below, above = membrane.solve_bias_extension([-0.8e-3 * 0.03, -1.5e-3 * 0.03], "centre-line")
    assert below.stable
    assert not above.stable


def test_yarns_whose_force_falls():
    """Descent needs the convex part of a tangent that is not definite: without it, no equilibrium.

    The state is one of least energy: its load is the slope of the energy.
    """
    falls = table([0.01, 0.02, 0.04], [1000.0, 900.0, 2000.0])
    preform = Preform.rectangle(0.02, 0.03, "20 deg")
    membrane = HyperelasticMembrane(
        COMM, preform, replace(stiff(1e3), warp_law=falls), 3e-3, 2, grading=1
    )
    low, middle, high = membrane.solve_bias_extension([1e-3 - 1e-6, 1e-3, 1e-3 + 1e-6])
    assert [low.stable, middle.stable, high.stable] == [True] * 3
    assert middle.load == pytest.approx((high.energy - low.energy) / 2e-6, rel=1e-3)


def test_equilibrium_beyond_buckling():
    """Mixed steps take the tangent as it is: with its convex part they end at the first buckle."""
    preform = Preform.rectangle(0.02, 0.03, "20 deg")
    membrane = HyperelasticMembrane(COMM, preform, stiff(1e3), 3e-3, 2, grading=1)
    (result,) = membrane.solve_bias_extension([-1e-4])
    assert result.stable is False
    assert result.cuts == 0
    assert result.newton_iterations < 10


def test_an_impossible_extension():
    """The upper clamp is pushed through the lower one: told, with the last residuals."""
    preform = Preform.rectangle(0.1, 0.2, "45 deg")
    membrane = HyperelasticMembrane(COMM, preform, stiff(1e2), 0.1, 2, grading=0)
    with pytest.raises(SolverError, match="no equilibrium beyond .* % of increment 2") as error:
        membrane.solve_bias_extension([0.01, -0.5])
    assert error.value.reason == "NO_EQUILIBRIUM"
    assert len(error.value.history) > 1
