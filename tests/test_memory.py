# SPDX-License-Identifier: MIT
"""Memory is estimated before it is taken, and refused in words."""

import time
import tracemalloc

import pytest
from mpi4py import MPI
from support.helpers import TABLE_1

from cruciform_petsc import memory
from cruciform_petsc.cloth.preform import Preform
from cruciform_petsc.errors import InputError
from cruciform_petsc.experiments.bias_extension import BiasExtension
from cruciform_petsc.memory import check_memory, machine_memory
from cruciform_petsc.net.network import _BYTES, Network


@pytest.mark.parametrize(
    "options",
    [
        {"refine": 10**6},
        {"refine": 10**9},
        {"width": "1e9 m", "length": "1e9 m"},
        {"width": 0.1, "length": "1e9 m"},
    ],
)
def test_absurd_networks_are_refused_at_once(options):
    """1e12 crossovers and more: one sentence, no time and no memory."""
    options = {"width": 0.1, "length": 0.2} | options
    preform = Preform.rectangle(options.pop("width"), options.pop("length"), "45 deg", **options)
    begin = time.perf_counter()
    with pytest.raises(InputError, match=r"the outline holds about \S+ crossovers, which would"):
        Network(MPI.COMM_SELF, preform, TABLE_1)
    assert time.perf_counter() - begin < 1.0


def test_estimate_is_what_a_network_takes():
    """Peak of NumPy's arrays while a network is made, near the number that refuses it."""
    side = 150 / 240
    tracemalloc.start()
    network = Network(MPI.COMM_SELF, Preform.rectangle(side, side, "40 deg"), TABLE_1)
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    # Not above twice the estimate, nor far below it: it would refuse what fits. Both sides are
    # wide, because small networks have long outlines and allocators keep what is freed.
    assert 0.5 < peak / (_BYTES * network.num_crossovers_global) < 2.5


def test_network_fits_but_its_system_does_not(monkeypatch):
    """Making a network takes less than solving it; each is asked for where it is taken."""
    preform = Preform.rectangle("10 cm", "10 cm")
    network = Network(MPI.COMM_SELF, preform, TABLE_1)
    monkeypatch.setattr(memory, "machine_memory", lambda: 3_000_000)
    network = Network(MPI.COMM_SELF, preform, TABLE_1)
    with pytest.raises(InputError) as caught:
        BiasExtension(network, extension="1 mm", finite=False)
    number = network.num_crossovers_global
    assert str(caught.value) == (
        f"the network has {number} crossovers, which would need about {6e3 * number / 1e6:.3g} MB "
        "of memory where there are 3 MB, choose a coarser pitch (refine, yarns_per_cruciform), a "
        "smaller outline or more machines"
    )
    BiasExtension(network, extension="1 mm", bending=False, finite=False)  # takes less


def test_outline_of_more_yarns_than_can_be_counted_is_refused(monkeypatch):
    """They are counted from the middle in 30 bits; a machine of a terabyte would have the room."""
    monkeypatch.setattr("cruciform_petsc.net.network.check_memory", lambda *_: None)
    preform = Preform.rectangle("1e7 m", "10 cm")
    with pytest.raises(InputError, match="yarns from its middle"):
        Network(MPI.COMM_SELF, preform, TABLE_1)


@pytest.mark.parametrize(
    ("cgroup", "limits", "expected"),
    [
        ("0::/a/b\n", {"a/b/memory.max": "max", "a/memory.max": "2000000"}, 2_000_000),
        ("0::/of/the/host\n", {"memory.max": "3000000"}, 3_000_000),
        ("4:memory:/x\n0::/\n", {"memory/x/memory.limit_in_bytes": "1000"}, 1000),
        ("4:memory:/x\n", {"memory/memory.limit_in_bytes": str(2**63 - 4096)}, 8_192_000),
        ("", {}, 8_192_000),
        ("nonsense\n", {}, 8_192_000),
    ],
)
def test_containers(monkeypatch, tmp_path, cgroup, limits, expected):
    """The lowest limit counts: the machine's, or a container's of either kind."""
    (tmp_path / "meminfo").write_text("MemTotal:  8000 kB\nMemFree: 1 kB\n")
    (tmp_path / "cgroup").write_text(cgroup)
    for name, text in limits.items():
        path = tmp_path / "fs" / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text + "\n")
    monkeypatch.setattr(memory, "_MEMINFO", tmp_path / "meminfo")
    monkeypatch.setattr(memory, "_CGROUP", tmp_path / "cgroup")
    monkeypatch.setattr(memory, "_CGROUPS", tmp_path / "fs")
    assert machine_memory() == expected


def test_unknown_memory_refuses_nothing(monkeypatch, tmp_path):
    """Where the system tells nothing, nobody is kept from trying."""
    monkeypatch.setattr(memory, "_MEMINFO", tmp_path / "no")
    monkeypatch.setattr(memory, "_CGROUP", tmp_path / "no")
    assert machine_memory() is None
    check_memory(MPI.COMM_SELF, 1e30, "this", "do that")
