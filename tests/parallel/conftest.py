# SPDX-License-Identifier: MIT
"""On several ranks: one report, from rank 0, and no rank waits for ever.

After each step of a test (setup, call, teardown) the ranks tell each other how it went. A test that
failed on any rank, or was skipped on some only, has failed on all, so they go on in the same way.
If the others do not come (they wait for the failed rank in the middle of the test), the failed rank
says so and aborts them all. After TIMEOUT all ranks print where they are, and are aborted.
"""

from __future__ import annotations

import faulthandler
import os
import sys
import time

import pytest
from mpi4py import MPI

TIMEOUT = float(os.environ.get("CRUCIFORM_PETSC_TEST_TIMEOUT", "600"))
PATIENCE = min(30.0, TIMEOUT)  # of a rank that has failed, with the others
COMM = MPI.COMM_WORLD.Dup()  # whatever the tests leave unreceived on their own communicators
errors_in_collection: list[str] = []


def watch(stderr: int) -> None:
    """(Re)start the clock; faulthandler's works in the midst of C code, unlike Python threads.

    The last rank ends all, when the others have had the time to print where they are.
    """
    last = COMM.rank == COMM.size - 1
    faulthandler.dump_traceback_later(TIMEOUT + 3 * last, exit=last, file=stderr)


@pytest.hookimpl(trylast=True)
def pytest_configure(config):
    config.real_stderr = os.dup(2)  # pytest redirects 2 later
    watch(config.real_stderr)
    if COMM.rank > 0:
        config.get_terminal_writer()._file = open(os.devnull, "w")  # noqa: SIM115


def pytest_collectreport(report):
    if report.failed:
        errors_in_collection.append(report.longreprtext)


@pytest.hookimpl(tryfirst=True)
def pytest_runtestloop(session):
    """Go on only if all ranks have found the same tests."""
    found = COMM.allgather(([item.nodeid for item in session.items], errors_in_collection))
    for rank, (nodeids, errors) in enumerate(found):
        if (nodeids, bool(errors)) != (found[0][0], bool(found[0][1])):
            text = "\n".join(errors) or f"{len(nodeids)} tests"
            pytest.exit(f"rank {rank} has not collected what rank 0 has:\n{text}", returncode=2)


@pytest.hookimpl(wrapper=True, tryfirst=True)
def pytest_runtest_protocol(item):
    watch(item.config.real_stderr)
    return (yield)


@pytest.hookimpl(wrapper=True, tryfirst=True)
def pytest_runtest_makereport(item):
    report = yield
    watch(item.config.real_stderr)
    arrival = COMM.Ibarrier()
    start = time.monotonic()
    while not arrival.Test():
        if report.failed and time.monotonic() - start > PATIENCE:
            text = (
                f"\n{item.nodeid} has failed on rank {COMM.rank}, and other ranks wait for it in "
                f"the middle of the test:\n{report.longreprtext}\naborting all ranks\n"
            )
            os.write(item.config.real_stderr, text.encode())
            COMM.Abort(1)
        time.sleep(0.001)
    outcomes, texts = zip(*COMM.allgather((report.outcome, report.longreprtext)), strict=True)
    if "failed" in outcomes or len(set(outcomes)) > 1:
        report.sections.append(("outcome on each rank", ", ".join(outcomes)))
        if not report.failed:
            first = outcomes.index("failed") if "failed" in outcomes else outcomes.index("skipped")
            report.outcome = "failed"
            report.longrepr = f"{outcomes[first]} on rank {first}:\n{texts[first]}"
    return report


@pytest.hookimpl(trylast=True)
def pytest_unconfigure():
    """Let rank 0 finish its report before the first rank exits, which may abort all (mpi4py)."""
    sys.stdout.flush()
    COMM.barrier()


@pytest.fixture
def tmp_path(tmp_path):
    """Return the same folder on all ranks."""
    return COMM.bcast(tmp_path)
