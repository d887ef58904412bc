# SPDX-License-Identifier: MIT
"""Cups of cloth whose shear flows and rubs."""

from dataclasses import replace

import numpy as np
import pytest
from mpi4py import MPI
from support.formed import cloth, network
from support.forming import formed, kept, same_end, written

from cruciform_petsc.case.schema import Case
from cruciform_petsc.errors import InputError
from cruciform_petsc.forming.blank import Blank
from cruciform_petsc.output.checkpoint import Checkpoint

COMM = MPI.COMM_SELF
TENSION = 'tension = { strain = "log", compression = 0.02 }\n'
FLOWS = (
    'shear_viscosity = { viscosity = "200 N s/m", temperature = "200 degC", '
    'activation_energy = "40 kJ/mol" }\n'
)
RUBS = 'shear_friction = { torque = "20 N/m" }\n'


def changes(resistance, seconds=None, more=""):
    """Of the case: what resists shear, and how long each stage takes."""
    told = [(TENSION, TENSION + resistance)]
    if seconds is not None:
        told += [
            (f'name = "{name}"\n', f'name = "{name}"\nduration = "{seconds} s"\n{more}')
            for name in ("close", "draw")
        ]
    return told


@pytest.fixture(scope="module")
def cups(tmp_path_factory):
    """The last step of cups of several cloths."""
    found = {}
    for name, told in {
        "elastic": [],
        "fast": changes(FLOWS, 0.5),
        "fast and hot": changes(FLOWS, 0.5, 'temperature = "300 degC"\n'),
        "slow": changes(FLOWS, 1e6),
        "rubs": changes(RUBS),
    }.items():
        found[name] = formed(COMM, written(tmp_path_factory.mktemp("cup"), *told))[1].steps
    return found


def force(steps):
    return -steps[-1].tool_force["punch"][2]


def test_what_resists_is_felt_by_the_punch(cups):
    """Fast more than slow, hot less than cold; infinitely slowly the cup is the elastic one's."""
    assert force(cups["slow"]) == pytest.approx(force(cups["elastic"]), rel=1e-4)
    assert force(cups["fast"]) > 1.05 * force(cups["fast and hot"]) > 1.05 * force(cups["elastic"])
    assert force(cups["rubs"]) > 1.02 * force(cups["elastic"])


def test_what_is_dissipated(cups):
    """Never less; none of an elastic cloth, and hardly any of one that has time."""
    assert "in_shear" not in cups["elastic"][-1].spent
    spent = {
        name: [step.spent["in_shear"] for step in cups[name]] for name in ("fast", "slow", "rubs")
    }
    for values in spent.values():
        assert (np.diff(values, prepend=0.0) >= 0.0).all()
    assert spent["slow"][-1] < 1e-4 * spent["fast"][-1]
    assert spent["fast"][-1] > 0.01 * cups["fast"][-1].work
    assert spent["rubs"][-1] > 0.01 * cups["rubs"][-1].work


def test_goes_on_from_a_checkpoint(tmp_path):
    """To the same forces and the same dissipation."""
    case = Case.load(written(tmp_path, *changes(FLOWS + RUBS, 0.5)))
    whole = kept(COMM, case)
    assert kept(COMM, case, Checkpoint.begin(COMM, tmp_path, case), 2) is None
    again = kept(COMM, case, Checkpoint.resume(COMM, tmp_path, case))
    same_end(again, whole, within=1e-9)
    assert again.steps[-1].spent["in_shear"] > 0.0


@pytest.mark.parametrize(
    ("told", "said"),
    [
        (changes(FLOWS), r"stage\[0\].duration is missing, which fabric.shear_viscosity needs"),
        (changes(RUBS, 1), r"stage\[0\].duration matters with fabric.shear_viscosity only"),
        (
            changes('shear_viscosity = { viscosity = "1 N s/m" }\n', 1, 'temperature = "0 degC"\n'),
            r"stage\[0\].temperature matters with fabric.shear_viscosity.activation_energy only",
        ),
    ],
)
def test_time_and_temperature_that_do_not_fit(tmp_path, told, said):
    with pytest.raises(InputError, match=said):
        Case.load(written(tmp_path, *told))


def test_each_ply_of_a_stack_remembers():
    """Two plies sheared alike have lost twice what one has, and each ply by its own name."""
    fabric = cloth(shear_friction={"torque": "20 N/m"})
    lost = []
    for count in (1, 2):
        blank = Blank([network((20, 20), fabric) for _ in range(count)], [])
        state = blank.start()
        x = state.x + 0.3 * state.x[:, 1:2] * [1.0, 0.0, 0.0]
        state = replace(state, x=x, time=1.0)
        state = replace(state, memory=blank.model.accepted(state))
        lost.append(blank.spent(state)["in_shear"])
        for one in blank.each:
            own = one.ply.dissipated(one.of_cloth(state))["in_shear"]
            assert own == pytest.approx(lost[-1] / count)
    assert lost[1] == pytest.approx(2.0 * lost[0])
    assert lost[0] > 0.0
