# SPDX-License-Identifier: MIT
"""Cusick's test: folds of a shadow, weights, published coefficients, what is refused."""

import numpy as np
import pytest
import shapely
from mpi4py import MPI
from support.cloths import CLOTHS, fabric
from support.forming import formed

from cruciform_petsc.case.schema import Case
from cruciform_petsc.errors import InputError
from cruciform_petsc.forming.drape import folds, radii

COMM = MPI.COMM_SELF
ROUND = 'outline = { circle = "300 mm" }'
# A quarter of it: planes of symmetry to the left and below.
ARC = [[150 * np.cos(a), 150 * np.sin(a)] for a in np.linspace(0.0, np.pi / 2, 61)]
QUARTER = [["0 mm", "0 mm"], *([f"{x:.9g} mm", f"{y:.9g} mm"] for x, y in np.round(ARC, 9))]


def case(name="cotton broad", outline=ROUND, every=6, more=""):
    return f"""{fabric(name)}
[preform]
{outline}
bias_angle = "0 deg"
yarns_per_cruciform = {every}
[test]
kind = "drape"
{more}
"""


def written(tmp_path, text):
    path = tmp_path / "drape.toml"
    path.write_text(text)
    return path


def rim(radius):
    """A shadow by its radius over the angle."""
    angle = np.linspace(0.0, 2 * np.pi, 1441)[:-1]
    return shapely.Polygon(radius(angle)[:, None] * np.column_stack([np.cos(angle), np.sin(angle)]))


@pytest.mark.parametrize(("count", "phase"), [(5, 0.3), (4, 0.0), (7, 2.0)])
def test_folds(count, phase):
    """As many as waves of the rim, with their crests, hollows and angles; ripples are none."""
    shadow = rim(lambda a: 0.12 + 0.01 * np.cos(count * (a - phase)) + 2e-4 * np.cos(31 * a))
    found = folds(shadow, 0.09)
    assert len(found) == count
    step = 2 * np.pi / count
    off = [(fold.angle - phase + step / 2) % step - step / 2 for fold in found]
    np.testing.assert_allclose(off, 0.0, atol=0.05)  # ripples move the crest
    np.testing.assert_allclose([fold.crest for fold in found], 0.13, atol=3e-4)
    np.testing.assert_allclose([fold.hollow for fold in found], 0.11, atol=3e-4)


def test_a_disc_has_no_folds():
    shadow = rim(lambda a: np.full_like(a, 0.15))
    assert folds(shadow, 0.09) == []
    np.testing.assert_allclose(radii(shadow), 0.15, rtol=1e-5)


def test_published_coefficient(tmp_path):
    """Cotton whose rigidity, friction and weight were measured: 82.9 %, here within 3 points.

    A quarter of it, at a pitch of 20 mm; 81.5 % of the whole, 83.1 % at 15 mm (docs/forming.md).
    The disc carries it, and what the plate pushes.
    """
    outline = f"outline = {{ polygon = {QUARTER} }}".replace("'", '"')
    text = case("cotton broad", outline, 4, 'symmetry = ["left", "lower"]\nresults = 2')
    forming, result = formed(COMM, written(tmp_path, text))
    told = forming.figures(result)["drape"]
    assert told["coefficient_percent"] == pytest.approx(CLOTHS["cotton broad"].coefficient, abs=3.0)
    assert "folds" not in told
    force = {name: f[2] for name, f in result.steps[-1].tool_force.items()}
    weight = 0.1238 * 9.80665 * forming.network.preform.outline.area
    assert force["disc"] + force["plate"] == pytest.approx(weight, rel=1e-3)
    assert force["plate"] < 0.0  # cloth that hangs over lifts at the middle
    shadow, flat = forming.shadow(result.states[-1]), forming.shadow(forming.blank.start())
    # Straight from one yarn's end to the next.
    assert flat.area == pytest.approx(0.25 * np.pi * 0.15**2, rel=0.02)
    disc = 0.25 * np.pi * 0.09**2
    share = (shadow.area - disc) / (flat.area - disc)
    assert told["coefficient_percent"] == pytest.approx(100 * share, rel=1e-12)
    assert len(told["coefficients_percent"]) == 3
    assert told["coefficients_percent"] == sorted(told["coefficients_percent"])[::-1]
    assert abs(told["change_while_at_rest"]) < 2.0
    assert 20.0 < told["drop_mm"] < 61.0
    # By the places of yarns' ends and crossovers, as seen from above.
    x = result.states[-1].x[forming.blank.cloth_at][:, :2]
    inside = shapely.contains_xy(shadow.buffer(1e-9), x)
    assert inside[forming.blank.ply.active].all()


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (("[test]", "[[stage]]\nname = 'x'\n[test]"), 'stage is for test.kind = "forming"'),
        (('kind = "drape"', 'kind = "drape"\ngravity = false'), "test.gravity must be true"),
        (
            ('kind = "drape"', 'kind = "drape"\nsupport_radius = "160 mm"'),
            "does not cover the disc",
        ),
        (('kind = "drape"', 'kind = "drape"\nedge_radius = "50 mm"'), "less than half of"),
        (('kind = "drape"', 'kind = "drape"\nfriction = -1.0'), "test.friction must be at least 0"),
        (('kind = "drape"', 'kind = "drape"\nsupport = "1 mm"'), 'unknown key "support"'),
        (('kind = "drape"', 'kind = "drape"\nmodel = "truss"'), "whose yarns do not bend"),
        (
            ("[fabric]", '[fabric]\nshear_viscosity = { viscosity = "1 N s/m" }'),
            '^[^;]*test.kind = "drape" runs at no speed that fabric.shear_viscosity[^;]*$',
        ),
        (("areal_density", "# areal_density"), "fabric.areal_density is missing"),
        (("out_of_plane_twisting = 1.0", "out_of_plane_twisting = -1.0"), "must be at least 0"),
    ],
)
def test_bad_input(tmp_path, change, message):
    text = case()
    assert text.count(change[0]) == 1
    with pytest.raises(InputError, match=message):
        Case.load(written(tmp_path, text.replace(*change)))


def test_the_dump_is_a_case(tmp_path):
    """Tools and stages follow from the keys, so they are not in it."""
    read = Case.load(written(tmp_path, case()))
    assert [tool.name for tool in read.tools] == ["disc", "plate"]
    again = Case.from_data(read.model_dump())
    assert again == read
    assert not {"tool", "stage", "clamp"} & read.model_dump().keys()
