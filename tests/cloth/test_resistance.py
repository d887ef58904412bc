# SPDX-License-Identifier: MIT
"""Tables of [fabric] for viscosity and friction of shear."""

import math

import pytest

from cruciform_petsc import Fabric
from cruciform_petsc.cloth.resistance import ShearFriction, ShearViscosity
from cruciform_petsc.errors import InputError


def made(**changes):
    return Fabric.from_library("glass-pp-plain-1.93", changes)


def test_units_of_people():
    fabric = made(
        shear_viscosity={
            "viscosity": "0.05 N min/mm", "temperature": "453.15 K",
            "activation_energy": "40 kJ/mol",
        },
        shear_friction={"torque": "0.02 N/cm", "slip": "1 deg"},
    )  # fmt: skip
    flow, friction = fabric.shear_viscosity, fabric.shear_friction
    assert flow.viscosity == pytest.approx(3000.0)
    assert (flow.exponent, flow.temperature, flow.activation_energy) == (1.0, 453.15, 40e3)
    assert friction.torque == pytest.approx(2.0)
    assert friction.slip == pytest.approx(math.pi / 180)
    assert fabric.remembers
    assert not made().remembers
    assert "shear_viscosity and shear_friction replaced" in fabric.name


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"shear_viscosity": {"viscosity": "-1 N s/m"}},
         "shear_viscosity.viscosity must be positive"),
        ({"shear_viscosity": {"viscosity": "1 Pa s"}}, "is not that of a viscosity of shear"),
        ({"shear_viscosity": {"viscosity": "1 N s/m", "exponent": 1.2}},
         "shear_viscosity.exponent must be from 0.05 to 1, got 1.2"),
        ({"shear_viscosity": {"viscosity": "1 N s/m", "temperature": "180 degC"}},
         "needs both temperature and activation_energy, or neither"),
        ({"shear_viscosity": {"viscosity": "1 N s/m", "temperature": "-300 degC",
                              "activation_energy": "1 kJ/mol"}}, "not above absolute zero"),
        ({"shear_friction": {"torque": "0 N/m"}}, "shear_friction.torque must be positive"),
        ({"shear_friction": {"torque": "1 N/m", "slip": "40 deg"}},
         "shear_friction.slip must be from 0.001 to 28.6 deg, got 40 deg"),
    ],
)  # fmt: skip
def test_bad_values(changes, said):
    with pytest.raises(InputError, match=said):
        made(**changes)


def test_too_large_in_python():
    """As for other numbers of a fabric: within which bounds it has to be."""
    with pytest.raises(InputError, match=r"shear_viscosity.viscosity must be from .* to 1e\+12"):
        ShearViscosity(1e13)
    with pytest.raises(InputError, match=r"fabric.shear_friction.torque must be from .*1e\+10 N/c"):
        ShearFriction(1e13)
    with pytest.raises(InputError, match=r"viscosity must be positive and finite, got inf"):
        ShearViscosity(math.inf)


def test_arrhenius():
    """Hotter is thinner: by e for E/R = 1000 K from 500 K to 1000 K."""
    flow = ShearViscosity(3.0, 1.0, 500.0, 8.31446261815324e3)
    assert flow.at(1000.0) == pytest.approx(3.0 / math.e)
    assert flow.at(None) == flow.at(500.0) == 3.0
    assert ShearViscosity(3.0).at(300.0) == 3.0
    with pytest.raises(InputError, match="is fabric.shear_viscosity.activation_energy right"):
        ShearViscosity(3.0, 1.0, 500.0, 9e6).at(300.0)
