# SPDX-License-Identifier: MIT
"""A small forming: a blank of 13 x 13 yarns pressed into a die by a hemisphere."""

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


def written(folder, *changes):
    """The case as a file, with pieces of text replaced: (old, new), ..."""
    text = CASE
    for old, new in changes:
        assert text.count(old) == 1, old
        text = text.replace(old, new)
    path = folder / "cup.toml"
    path.write_text(text)
    return path


def formed(comm, path):
    """Form a case: what it was, and what came of it."""
    case = Case.load(path)
    forming = case.forming(Network(comm, case.preform(), case.fabric()))
    return forming, forming.solve()
