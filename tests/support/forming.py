# SPDX-License-Identifier: MIT
"""A small forming: a blank of 13 x 13 yarns pressed into a die by a hemisphere."""

import numpy as np
import pytest

from cruciform_petsc.case.schema import Case
from cruciform_petsc.net.network import Network

YARN = (
    '{ modulus = "520 N/cm", poisson = 0, yarns = "2.4 /cm", yarn_bending = "0.6 N mm^2", '
    'out_of_plane_bending = "1 N mm" }'
)
CASE = f"""
title = "Cup"
[fabric]
warp = {YARN}
weft = {YARN}
shear = {{ law = "sin-potential", coefficients = ["18.5 N/m", "46.4 N/m", "60 N/m"] }}
tension = {{ strain = "log", compression = 0.02 }}
thickness = "1 mm"
areal_density = "576 g/m^2"
[preform]
outline = {{ rectangle = ["56 mm", "56 mm"] }}
bias_angle = "0 deg"
[test]
kind = "forming"
imperfection = {{ height = "0 mm" }}
[[tool]]
name = "die"
shape = {{ revolve = {{ opening_radius = "14 mm", fillet = "4 mm", outer_radius = "60 mm" }} }}
friction = 0.2
[[tool]]
name = "punch"
shape = {{ sphere = {{ radius = "12 mm", shaft = true }} }}
friction = 0.2
[[tool]]
name = "holder"
shape = {{ ring = {{ inner_radius = "20 mm", outer_radius = "60 mm" }} }}
friction = 0.2
[[stage]]
name = "close"
force = {{ holder = "5 N" }}
step = 1.0
[[stage]]
name = "draw"
travel = {{ punch = ["0 mm", "0 mm", "-6 mm"] }}
results = 2
step = 0.5
"""
# A punch that is pulled, pushed by a force and pulled back, and a holder that is taken away then.
LONG = f"""{CASE.replace("step = 0.5", "step = 0.25")}
[[stage]]
name = "push"
force = {{ punch = "6 N" }}
step = 0.5
[[stage]]
name = "back"
travel = {{ punch = ["0 mm", "0 mm", "0.2 mm"] }}
remove = ["holder"]
step = 0.5
"""
# With two plies, 0/90 and +-45, and a shorter stroke.
PLIES = """
[[ply]]
name = "low"
[[ply]]
name = "high"
bias_angle = "45 deg"
friction = 0.3
"""
TWO_PLIES = CASE.replace("[[tool]]", PLIES + "[[tool]]", 1)
for old, new in (('"14 mm"', '"16 mm"'), ('"-6 mm"', '"-2 mm"')):
    TWO_PLIES = TWO_PLIES.replace(old, new)


STROKE = 6e-3


class Stop(Exception):
    """What kills a forming."""


def written(folder, *changes, text=CASE, name="cup.toml"):
    """The case as a file, with pieces of text replaced: (old, new), ..."""
    for old, new in changes:
        assert text.count(old) == 1, old
        text = text.replace(old, new)
    path = folder / name
    path.write_text(text)
    return path


def formed(comm, path):
    """Form a case: what it was, and what came of it."""
    case = Case.load(path)
    forming = case.forming(Network(comm, case.preform(), case.fabric()))
    return forming, forming.solve()


def kept(comm, case, keeper=None, stop=None):
    """Form a case with a checkpoint; killed after ``stop`` steps (None: not) there is no result."""
    told = []

    def accepted(step, state):
        told.append(step)
        if len(told) == stop:
            raise Stop

    try:
        network = Network(comm, case.preform(), case.fabric())
        return case.forming(network).solve(accepted, keeper)
    except Stop:
        return None


def same_end(one, other, within=0.0):
    """Two formings have the same steps and end alike, to a share of the stroke and of the force."""
    assert [s.increment.control for s in one.steps] == [s.increment.control for s in other.steps]
    assert [s.increment.asked for s in one.steps] == [s.increment.asked for s in other.steps]
    assert [s.stage for s in one.steps] == [s.stage for s in other.steps]
    most = max(np.abs(f).max() for s in other.steps for f in s.tool_force.values())
    for mine, theirs in zip(one.steps, other.steps, strict=True):
        for tool in theirs.tool_force:
            force, place = mine.tool_force[tool], mine.tool_place[tool]
            np.testing.assert_allclose(force, theirs.tool_force[tool], 0, within * most)
            np.testing.assert_allclose(place, theirs.tool_place[tool], 0, within * STROKE)
        assert mine.work == pytest.approx(theirs.work, abs=within * most * STROKE, rel=0)
        spent, energy = mine.spent | mine.increment.energies, within * most * STROKE
        wanted = theirs.spent | theirs.increment.energies
        assert spent == pytest.approx(wanted, abs=energy, rel=0)
    assert [state.time for state in one.states] == [state.time for state in other.states]
