# SPDX-License-Identifier: MIT
"""The page about a run, measured data and comparisons, made on several ranks."""

import json
import logging

import numpy as np
import pytest
from mpi4py import MPI

from cruciform_petsc.case.schema import Case
from cruciform_petsc.compare import compare_command
from cruciform_petsc.errors import InputError
from cruciform_petsc.run import run_case

COMM = MPI.COMM_WORLD
LOG = logging.getLogger("test_report_parallel")
MEASURED = "displacement [mm], force [N]\n0.5, 1\n1, 2\n1.5, 3\n2, 4\n"


def made(measured, **output):
    return Case.from_data(
        {
            "fabric": {"use": "e-glass-plain-2.4"},
            "preform": {"outline": {"rectangle": ["2.4 cm", "3.6 cm"]}, "bias_angle": "45 deg"},
            "test": {"finite": True, "extension": ["1 mm", "2 mm"]},
            "output": {"paraview": False, "measured": str(measured), **output},
        }
    )


def test_report_and_comparison(tmp_path):
    """All ranks make one page, and the figures are those of one rank."""
    folder = COMM.bcast(tmp_path)
    measured = folder / "measured.csv"
    if COMM.rank == 0:
        measured.write_text(MEASURED)
        (folder / "one").mkdir()
    COMM.Barrier()
    together = run_case(COMM, made(measured), folder, LOG)
    if COMM.rank == 0:
        one = run_case(MPI.COMM_SELF, made(measured, pictures=False), folder / "one", LOG)
        assert together["measured"]["rms_relative"] == pytest.approx(
            one["measured"]["rms_relative"], rel=1e-8
        )
        page = (folder / "report.html").read_text(encoding="utf-8")
        assert page.count('src="data:image/png') == len(list(folder.glob("*.png")))
        assert f'<data value="{float(together["load_n"][-1])!r}">' in page
        assert not list(folder.glob(".*.part"))
    COMM.Barrier()
    told = compare_command(COMM, [str(folder), str(folder / "one")], folder / "compared", LOG)
    assert all(
        np.abs([value for name, value in figures.items() if name.startswith("rms")]).max() < 1e-7
        for figures in told["differences"]["a"].values()
    )
    if COMM.rank == 0:
        assert json.loads((folder / "compared" / "comparison.json").read_text()) == told


def test_every_rank_is_told(tmp_path):
    """What rank 0 cannot read, all refuse."""
    folder = COMM.bcast(tmp_path)
    with pytest.raises(InputError, match="does not exist"):
        run_case(COMM, made(folder / "none.csv"), folder, LOG)
    with pytest.raises(InputError, match="does not exist"):
        compare_command(COMM, [str(folder / "a"), str(folder / "b")], folder, LOG)
