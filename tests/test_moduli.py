# SPDX-License-Identifier: MIT
"""`cruciform-petsc kilby`: from moduli or folders to files; what is wrong in one sentence."""

import json
import logging

import numpy as np
import pytest
from mpi4py import MPI
from support.helpers import TABLE_1

from cruciform_petsc.errors import InputError
from cruciform_petsc.moduli import kilby_command

COMM, LOG = MPI.COMM_SELF, logging.getLogger("test")


def saved(folder, degrees, kind="off-axis-tension"):
    """A folder of results with what counts of them; its path."""
    folder.mkdir()
    preform = {
        "outline": {"rectangle": ["30 mm", "90 mm"]},
        "bias_angle": f"{degrees} deg",
    }
    test = {"kind": "off-axis-tension", "extension": "1 mm"}
    case = {"fabric": {"use": "e-glass-plain-2.4"}, "preform": preform, "test": test}
    modulus = float(TABLE_1.off_axis_modulus(np.deg2rad(degrees))) / 100.0
    summary = {"kind": kind, "case": case, "modulus_n_per_cm": modulus}
    (folder / "summary.json").write_text(json.dumps(summary))
    return str(folder)


def test_files(tmp_path):
    """The table is Kilby's at each degree; the lines of the log are read back by a case."""
    three = ("520 N/cm", "520 N/cm", "3.8258737 N/cm")
    told = kilby_command(COMM, three, LOG, directory=str(tmp_path))
    assert told["shear_n_per_cm"] == pytest.approx(0.96, rel=1e-6)
    table = np.genfromtxt(tmp_path / "kilby.csv", delimiter=",", names=True)
    at = np.deg2rad(table["angle_deg"])
    c2, s2 = np.cos(at) ** 2, np.sin(at) ** 2
    expected = 1.0 / ((c2**2 + s2**2) / 520.0 + c2 * s2 / 0.96)
    np.testing.assert_allclose(table["modulus_N_per_cm"], expected, rtol=1e-6)
    assert json.loads((tmp_path / "kilby.json").read_text()) == told
    assert (tmp_path / "kilby.png").stat().st_size > 5000


def test_folders_of_results(tmp_path):
    """They know their angles."""
    folders = [saved(tmp_path / str(degrees), degrees) for degrees in (0, 90, 30)]
    told = kilby_command(COMM, tuple(folders), LOG, poisson=str(TABLE_1.warp.poisson))
    assert told["third_deg"] == pytest.approx(30.0)
    assert told["shear_n_per_cm"] == pytest.approx(TABLE_1.shear_modulus / 100.0, rel=1e-9)
    with pytest.raises(InputError, match="strip of the weft was pulled at 30 deg"):
        kilby_command(COMM, (folders[0], folders[2], folders[1]), LOG)
    with pytest.raises(InputError, match="knows the angle of its strip, leave --angle out"):
        kilby_command(COMM, tuple(folders), LOG, angle="30 deg")
    other = saved(tmp_path / "other", 45, "bias-extension")
    with pytest.raises(InputError, match="is of a bias-extension test; a strip's modulus is"):
        kilby_command(COMM, (folders[0], folders[1], other), LOG)


@pytest.mark.parametrize(
    ("third", "options", "message"),
    [
        ("3", {}, 'modulus = "3" has no unit.*or the folder of an off-axis-tension test'),
        ("nowhere", {}, 'got "nowhere"; a strip.s modulus is'),
        ("3 N/cm", {"angle": "30"}, '--angle = "30" has no unit'),
        ("3 N/cm", {"poisson": "x"}, '--poisson must be a number, got "x"'),
    ],
)
def test_bad_input(third, options, message):
    with pytest.raises(InputError, match=message):
        kilby_command(COMM, ("520 N/cm", "520 N/cm", third), LOG, **options)
