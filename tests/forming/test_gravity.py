# SPDX-License-Identifier: MIT
"""Cloth that lies on a tool and hangs over its edge: friction holds it from the first step on."""

import numpy as np
from mpi4py import MPI
from support.forming import formed

YARN = (
    '{ modulus = "5200 N/cm", poisson = 0, yarns = "2 /cm", yarn_bending = "0.6 N mm^2", '
    'out_of_plane_bending = "0.5 N mm" }'
)
CASE = f"""
[fabric]
warp = {YARN}
weft = {YARN}
shear = {{ modulus = "0.3 N/cm" }}
tension = {{ strain = "log", compression = 0.02 }}
thickness = "0.5 mm"
areal_density = "400 g/m^2"
[preform]
outline = {{ rectangle = ["LENGTH", "WIDE"] }}
bias_angle = "0 deg"
yarns_per_cruciform = 2
[test]
kind = "forming"
gravity = true
[[tool]]
name = "table"
shape = {{ SHAPE }}
place = ["ASIDE", "0 mm", "BELOW"]
friction = 0.5
[[stage]]
name = "fall"
results = 2
[[stage]]
name = "rest"
"""
WEIGHT = 0.4 * 9.80665  # N/m^2


def fallen(tmp_path, **words):
    """Form the case with words put in; the places of crossovers, flat and at the end, and more."""
    text = CASE
    for word, value in words.items():
        text = text.replace(word, value)
    path = tmp_path / "case.toml"
    path.write_text(text)
    forming, result = formed(MPI.COMM_SELF, path)
    step, blank = result.steps[-1], forming.blank
    at = blank.cloth_at
    return blank.ply.nodes.rest, result.states[-1].x[at], step, result.steps


def test_strip_over_the_edge_of_a_table(tmp_path):
    """70 mm hang over: they bend down, the rest stays in its place, and the table carries it all.

    Without friction it would slide off.
    """
    box = 'box = { size = ["200 mm", "60 mm", "20 mm"], edge_radius = "3 mm" }'
    rest, x, step, steps = fallen(
        tmp_path, LENGTH="200 mm", WIDE="20 mm", SHAPE=box, ASIDE="-70 mm", BELOW="-10 mm"
    )
    assert abs(x - rest)[rest[:, 0] < 0.0, 0].max() < 0.5e-3
    assert -70e-3 < x[:, 2].min() < -20e-3
    assert np.isclose(step.tool_force["table"][2], WEIGHT * 0.2 * 0.02, rtol=2e-3)
    assert sum(step.increment.iterations for step in steps) < 300


def test_cloth_over_a_disc(tmp_path):
    """Another form: a square over a small disc hangs down all around, and does not slip off."""
    disc = 'ring = { outer_radius = "20 mm", edge_radius = "2 mm" }'
    rest, x, step, _ = fallen(
        tmp_path, LENGTH="80 mm", WIDE="80 mm", SHAPE=disc, ASIDE="0 mm", BELOW="0 mm"
    )
    centre = np.argmin(np.linalg.norm(rest, axis=1))
    assert abs(x - rest)[centre].max() < 0.5e-3
    assert -5e-3 < x[:, 2].min() < -1e-3
    assert np.isclose(step.tool_force["table"][2], WEIGHT * 0.08**2, rtol=2e-3)
