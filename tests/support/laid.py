# SPDX-License-Identifier: MIT
"""A small blank that begins laid on a hemisphere and is sucked onto it."""

from mpi4py import MPI

from cruciform_petsc.case.schema import Case
from cruciform_petsc.net.network import Network

from . import forming

COMM = MPI.COMM_SELF
YARN = (
    '{ modulus = "520 N/cm", poisson = 0, yarns = "2.4 /cm", yarn_bending = "0.6 N mm^2", '
    'out_of_plane_bending = "0.1 N mm" }'
)
CASE = f"""
title = "Laid"
[fabric]
warp = {YARN}
weft = {YARN}
shear = {{ modulus = "0.02 N/cm" }}
tension = {{ strain = "log", compression = 0.02 }}
thickness = "1 mm"
areal_density = "576 g/m^2"
[preform]
outline = {{ rectangle = ["60 mm", "60 mm"] }}
bias_angle = "0 deg"
origin = ["0 mm", "30 mm"]
yarns_per_cruciform = 2
[test]
kind = "forming"
imperfection = {{ height = "0 mm" }}
fishnet = {{}}
[[tool]]
name = "mould"
shape = {{ sphere = {{ radius = "40 mm", shaft = true }} }}
friction = 0.5
[[stage]]
name = "vacuum"
suction = "40 kPa"
step = 0.5
[output]
pictures = false
"""


def written(folder, *changes, text=CASE):
    """The case as a file, see support.forming."""
    return forming.written(folder, *changes, text=text, name="case.toml")


def made(path):
    case = Case.load(path)
    return case.forming(Network(COMM, case.preform(), case.fabric()))


def shear_of(forming, state):
    return forming.blank.ply.fields(forming.blank.of_cloth(state))["shear_angle"]
