# SPDX-License-Identifier: MIT
"""Whatever is put in: a valid object, or one InputError in one sentence.

Random inputs from a fixed seed, so that every run tests the same ones.
"""

import math
from contextlib import contextmanager

import numpy as np
import pytest
from hypothesis import assume, example, given, settings
from hypothesis import strategies as st
from mpi4py import MPI
from support.helpers import TABLE_1

from cruciform_petsc.case.schema import Case
from cruciform_petsc.cloth.fabric import Fabric, YarnFamily
from cruciform_petsc.cloth.preform import Preform
from cruciform_petsc.errors import InputError
from cruciform_petsc.laws import odd_polynomial, sin_powers, table
from cruciform_petsc.net.lattice import SNAP
from cruciform_petsc.net.network import Network
from cruciform_petsc.units import LIMITS, MEASURES, format_si, parse_unit, to_si

UNITS = ("N/m", "1/m", "N*m**2", "rad", "m", "N", "1", "kg/m**2", "kg/m**3")

fixed = settings(derandomize=True, deadline=None, max_examples=150, database=None)


class Refused(Exception):
    """Raised within `one_sentence`, to tell that the input was refused properly."""


@contextmanager
def one_sentence(begins=""):
    """Let an InputError pass as Refused if it is one sentence; anything else is a failure."""
    try:
        yield
    except InputError as error:
        text = str(error)
        assert text.startswith(begins)
        assert text
        assert len(text) < 2000
        raise Refused from None


def attempt(make, *args, begins="", **kwargs):
    """Result of a call, or None if it was refused properly."""
    try:
        with one_sentence(begins):
            return make(*args, **kwargs)
    except Refused:
        return None


# Numbers of all sizes and sorts, NaN and infinities among them, and whole ones beyond floats.
numbers = st.one_of(
    st.floats(),
    st.integers(),
    st.sampled_from([0.0, -0.0, 5e-324, 1e308, -1e308, 10**400, math.nan, math.inf, True]),
)
unit_texts = st.sampled_from(
    ["mm", "cm", "m", "deg", "rad", "N", "N/mm", "N/cm", "/cm", "1/m", "%", "N mm^2", "g/m^2",
     "g/cm^3", "ends/cm", "furlong", "m**99", "/", "(", "m/", "°", "", "kN/m", "mm mm", "1/4.8 mm"]
)  # fmt: skip
quantity_texts = st.one_of(
    st.builds(lambda number, unit: f"{number} {unit}", numbers, unit_texts), st.text(max_size=20)
)
anything = st.recursive(
    st.one_of(st.none(), st.booleans(), numbers, quantity_texts),
    lambda inner: (
        st.lists(inner, max_size=4) | st.dictionaries(st.text(max_size=8), inner, max_size=3)
    ),
    max_leaves=8,
)


# -- units ------------------------------------------------------------------------------------


@fixed
@given(anything, st.sampled_from(UNITS), st.booleans())
@example(10**400, "m", True)
@example("1e400 mm", "m", False)
@example("1/0 mm", "1/m", False)
@example("9" * 5000 + " mm", "m", False)
@example("1 " + "(" * 500 + "mm", "m", False)
@example("1 m**1e9", "m", False)
@example("1 m**m", "m", False)
@example(np.float64("nan"), "m", True)
def test_quantities(value, unit, bare):
    """A finite number, or a list of them, or one sentence that begins with the key."""
    number = attempt(to_si, value, unit, "the.key", bare=bare, begins="the.key")
    assert number is None or np.isfinite(number).all()


@fixed
@given(st.floats(-1.0, 1.0), st.sampled_from(UNITS))
def test_quantities_go_round(share, unit):
    """What logs write is read as the same, to the six digits that they write."""
    value = share * LIMITS[unit][1]
    assume(value == 0.0 or abs(value) > 1e-30)
    assert to_si(format_si(value, unit), unit, "key") == pytest.approx(value, rel=1e-5, abs=0)


@fixed
@given(anything, st.sampled_from(UNITS))
def test_units_alone(value, unit):
    """A positive factor or a ValueError, which callers turn into a sentence with a key."""
    try:
        factor = parse_unit(value, unit)
    except ValueError:
        return
    assert 0.0 < factor < math.inf
    assert MEASURES[unit][0]


# -- laws -------------------------------------------------------------------------------------


@fixed
@given(st.lists(st.tuples(st.floats(), st.floats()), max_size=6))
@example([(1e-320, 1.0), (1.0, 2.0)])
@example([(1e-300, 1e300)])
@example([(1e300, 1e300), (1e308, 1e308)])
def test_tables_are_finite(points):
    """A table that is taken has finite energy, force and stiffness in its range."""
    x, y = [p[0] for p in points], [p[1] for p in points]
    law = attempt(table, x, y)
    if law is None:
        return
    at = np.linspace(-1, 1, 9) * law.last_point
    assert all(np.isfinite(part).all() for part in law.evaluate(at))


@fixed
@given(st.lists(st.tuples(st.floats(1e-3, 1.0), st.floats(0.0, 1e3)), min_size=1, max_size=8))
def test_rising_tables_rise(points):
    """Points in any order, sorted, with steps: force runs through them and never falls."""
    x = np.cumsum([p[0] for p in points])
    y = np.cumsum([p[1] for p in points])
    law = table(x.tolist(), y.tolist())
    w, force, stiffness = law.evaluate(np.linspace(0, 1.2 * x[-1], 50))
    scale = y[-1] + 1e-300
    assert (np.diff(force) >= -1e-9 * scale).all()
    assert (stiffness >= -1e-9 * scale / min(p[0] for p in points)).all()
    assert (np.diff(w) >= -1e-9 * scale * x[-1]).all()
    np.testing.assert_allclose(law.evaluate(x)[1], y, rtol=1e-9, atol=1e-9 * scale)


@fixed
@given(st.sampled_from([odd_polynomial, sin_powers]), st.lists(numbers, max_size=5))
@example(odd_polynomial, [10**400])
def test_coefficients(make, coefficients):
    """Formulas take finite coefficients, and no others."""
    law = attempt(make, coefficients)
    if law is not None:
        assert math.isfinite(law.stiffness0) or max(map(abs, coefficients)) > 1e300


# -- fabrics ----------------------------------------------------------------------------------

positive = st.floats(1e-6, 1e9)
angle = st.floats(-7, 7)


@fixed
@given(*[st.one_of(positive, numbers)] * 10)
def test_fabrics(e_w, e_e, nu_w, nu_e, n_w, n_e, b, g, compression, width):
    """Any numbers: a cloth with positive moduli, or a sentence."""

    def make():
        warp, weft = YarnFamily(e_w, nu_w, n_w, b), YarnFamily(e_e, nu_e, n_e, b)
        return Fabric("random", warp, weft, g, compression=compression, compression_width=width)

    fabric = attempt(make)
    if fabric is not None:
        assert min(fabric.c11, fabric.c22, fabric.shear_modulus) > 0.0
        assert fabric.warp.spacing > 0.0
        repr(fabric)


@fixed
@given(positive, positive, st.sampled_from([-0.9, -0.2, 0, 1e-9, 0.3, 0.99]), positive, angle)
def test_good_fabrics_are_stable(e_w, e_e, nu, g, angle):
    """With reciprocity and nu_w nu_e < 1 every strain costs energy and every strip is stiff."""
    nu_w = nu * math.sqrt(e_w / e_e)
    fabric = Fabric(
        "good", YarnFamily(e_w, nu_w, 200.0), YarnFamily(e_e, nu_w * e_e / e_w, 300.0), g
    )
    stiffness = np.array([[fabric.c11, fabric.c12], [fabric.c12, fabric.c22]])
    scale = np.sqrt(np.outer(stiffness.diagonal(), stiffness.diagonal()))
    assert np.linalg.eigvalsh(stiffness / scale).min() > 0.0
    assert fabric.off_axis_modulus(angle) > 0.0


@fixed
@given(anything, anything, anything, anything)
def test_tables_of_fabrics(warp, shear, tension, thickness):
    """Tables as of a case file, with anything in them."""
    good = {"modulus": "520 N/cm", "poisson": 0, "yarns": "2.4 /cm"}
    data = {"warp": good, "weft": good, "shear": {"modulus": "1 N/cm"}}
    for key, value in (
        ("warp", warp),
        ("shear", shear),
        ("tension", tension),
        ("thickness", thickness),
    ):
        attempt(Fabric.from_table, "random", data | {key: value})
    for key in good:
        attempt(Fabric.from_table, "random", data | {"warp": good | {key: warp}})
    for law in ("table", "polynomial", "sin-potential"):
        extra = {"angle": "deg", "force": "N/mm", "points": shear} if law == "table" else {}
        extra = extra or {"coefficients": shear}
        attempt(Fabric.from_table, "random", data | {"shear": {"law": law, **extra}})


# -- preforms ---------------------------------------------------------------------------------

lengths = st.one_of(st.floats(0.0, 0.2), numbers, quantity_texts)
angles = st.one_of(st.floats(-7, 7), numbers, quantity_texts)
points = st.lists(st.lists(lengths, min_size=2, max_size=2), max_size=7)


@fixed
@given(lengths, lengths, angles, numbers, st.lists(lengths, max_size=3))
@example(0.1, 0.1, 0.7, 10**400, [0.0, 0.0])
@example(0.1, 5e-324, 0.7, 1, [0.0, 0.0])
@example(1e-160, 1e-160, 0.7, 1, [0.0, 0.0])
def test_rectangles(width, length, angle, refine, origin):
    """Any sides, angles, pitches and origins."""
    preform = attempt(Preform.rectangle, width, length, angle, refine=refine, origin=origin)
    preform = preform or attempt(Preform.rectangle, width, length, angle)
    if preform is not None:
        assert preform.outline.is_valid
        assert {"lower", "upper", "left", "right"} <= set(preform.edges)
        np.testing.assert_allclose(preform.rotation @ preform.rotation.T, np.eye(2), atol=1e-12)
        repr(preform)
        attempt(preform.check_size, TABLE_1)


@fixed
@given(st.one_of(points, anything), st.one_of(st.lists(points, max_size=2), anything), angles)
@example([[0, 0], [1, 0], [1, 1e-200]], [], 0.0)
@example([[0, 0], [1e-170, 0], [0, 1e-170]], [], 0.0)
@example([], [], 0.0)
@example(None, [], 0.0)
@example([[0, 0], [1, 0], [1, 1]], None, 0.0)
def test_polygons(corners, holes, angle):
    """Any corners: a simple polygon with the cloth on the left of its edges, or a sentence."""
    preform = attempt(Preform.polygon, corners, holes, angle)
    if preform is not None:
        assert preform.outline.is_valid
        assert preform.outline.area > 0.0
        assert preform.outline.exterior.is_ccw
        attempt(preform.check_size, TABLE_1)


# Corners on a coarse grid: they coincide, lie on one line, cross and touch far more often.
grid_points = st.lists(
    st.tuples(st.integers(0, 4), st.integers(0, 4)).map(lambda p: [0.01 * p[0], 0.01 * p[1]]),
    min_size=3,
    max_size=7,
)


# Always simple, with corners sharp and blunt.
stars = st.lists(st.floats(0.003, 0.04), min_size=3, max_size=9).map(
    lambda radii: [
        [r * math.cos(2 * math.pi * k / len(radii)), r * math.sin(2 * math.pi * k / len(radii))]
        for k, r in enumerate(radii)
    ]
)


@fixed
@given(
    st.one_of(stars, stars, grid_points),
    st.floats(-7, 7),
    st.sampled_from([1, 2, 3]),
    st.one_of(st.none(), st.tuples(st.floats(-1, 1), st.floats(-1, 1))),
)
def test_networks_cover_their_outline(corners, angle, refine, origin):
    """Any simple outline, angle, pitch, origin: the quadrants cover its area, none is negative.

    Exactly, but for pieces that are smaller than a cell and hold no crossover themselves.
    """
    preform = attempt(Preform.polygon, corners, [], angle, refine=refine, origin=origin)
    network = preform and attempt(Network, MPI.COMM_SELF, preform, TABLE_1)
    if not network:
        return
    assert np.isfinite(network.node_position).all()
    assert (network.arm_length >= 0.0).all()
    assert (network.quadrant_area >= 0.0).all()
    area, cell = preform.outline.area, network.pitch.prod()
    snap = SNAP * network.pitch.max() * preform.outline.length  # corners moved onto yarns
    assert network.covered_area() <= area * (1 + 1e-9) + snap
    assert network.covered_area() >= area - 0.5 * preform.outline.length * math.sqrt(2 * cell)


# -- case files -------------------------------------------------------------------------------


@fixed
@given(st.dictionaries(st.text(max_size=6), anything, max_size=3))
@example({})
def test_any_data(data):
    """Data of any kind."""
    attempt(Case.from_data, data)


GOOD = {
    "fabric": {"use": "e-glass-plain-2.4", "shear": {"modulus": "1 N/cm"}},
    "preform": {"outline": {"rectangle": ["24 mm", "36 mm"]}, "bias_angle": "45 deg"},
    "test": {"kind": "bias-extension", "extension": ["1 mm", "2 mm"]},
    "continuum": {"ladder": [1, 2]},
    "solver": {"options": {"ksp_type": "cg"}},
}
PLACES = [
    ("title",),
    ("fabric",),
    ("fabric", "use"),
    ("fabric", "shear"),
    ("fabric", "tension"),
    ("fabric", "warp"),
    ("preform", "outline"),
    ("preform", "outline", "rectangle"),
    ("preform", "outline", "holes"),
    ("preform", "bias_angle"),
    ("preform", "refine"),
    ("preform", "origin"),
    ("test",),
    ("test", "kind"),
    ("test", "extension"),
    ("test", "increments"),
    ("continuum", "ladder"),
    ("continuum", "mesh_size"),
    ("solver", "options"),
    ("output",),
]


@settings(fixed, max_examples=300)
@given(st.sampled_from(PLACES), anything)
@example(("preform", "refine"), 10**400)
@example(("preform", "refine"), 10**5000)
@example(("preform", "refine"), -(10**5000))
@example(("title",), 10**5000)
@example(("fabric", "shear"), {"modulus": 10**5000})
@example(("preform", "bias_angle"), 10**5000)
@example(("test", "kind"), [])
@example(("solver", "options"), {"a": {}})
def test_one_place_of_a_case(place, value):
    """A good case with anything in one place: as a case file gives it, then all that it makes."""

    def put(node, path):
        head, *rest = path
        inner = put(node.get(head, {}), rest) if rest else value
        return {**node, head: inner}

    def everything():
        case = Case.from_data(put(GOOD, place))
        case.check_together()
        assert Case.from_data(case.model_dump(exclude_none=True)) == case
        return case.test.values_si

    values = attempt(everything)
    assert values is None or np.isfinite(values).all()
