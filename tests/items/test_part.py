# SPDX-License-Identifier: MIT
"""An item of one part within several."""

from dataclasses import dataclass, field

import numpy as np

from cruciform_petsc.elements.level import FORCE, room
from cruciform_petsc.items.item import Item
from cruciform_petsc.items.part import OfPart, part_of


@dataclass(frozen=True)
class Small:
    """A state."""

    x: np.ndarray
    memory: dict = field(default_factory=dict)


class Springs(Item):
    """From node to node, of a stiffness of 1 N/m and no length; notes what it was asked."""

    name, modes, is_load = "springs", ("spring",), True

    def __init__(self, nodes):
        self.nodes, self.seen = np.array(nodes, np.int32), []

    def work(self, state, level, rows=slice(None), before=None):
        self.seen.append((state, before))
        a, b = state.x[self.nodes[rows]].swapaxes(0, 1)
        energy, force, stiffness = room(len(a), 1, 2, 3, level)
        energy[:, 0] = 0.5 * ((b - a) ** 2).sum(axis=1)
        if level >= FORCE:
            force[:, 0], force[:, 1] = a - b, b - a
        return energy, force, stiffness

    def lagged(self, state):
        return {"x": state.x}, 1.0, 2.0

    def accepted(self, state):
        return {"x": state.x + 1.0}

    def broken(self, state):
        return state.x[0], "TORN", "a spring is torn"


def test_it_looks_at_its_own_nodes():
    """Whatever their numbers are in the whole; elements and memories are those of the part."""
    rng = np.random.default_rng(1)
    x, at = rng.normal(size=(7, 3)), np.array([5, 0, 3], np.int32)
    springs = Springs([[0, 1], [1, 2]])
    part = OfPart(springs, at)
    assert (part.name, part.modes, part.is_load) == ("springs", ("spring",), True)
    assert part.nodes.tolist() == [[5, 0], [0, 3]]
    before = rng.normal(size=(7, 3))
    whole, own = Small(x), Small(x[at])
    for got, wanted in zip(
        part.work(whole, FORCE, slice(1, 2), before),
        springs.work(own, FORCE, slice(1, 2)),
        strict=True,
    ):
        np.testing.assert_array_equal(got, wanted)
    np.testing.assert_array_equal(springs.seen[0][1], before[at])
    np.testing.assert_array_equal(part.lagged(whole)[0]["x"], x[at])
    np.testing.assert_array_equal(part.accepted(whole)["x"], x[at] + 1.0)
    assert part.broken(whole)[1:] == ("TORN", "a spring is torn")
    assert list(part.chunks()) == list(springs.chunks())


def test_it_sees_each_state_anew():
    """What is kept of a state is not taken for another's; memories come through."""
    springs = Springs([[0, 1]])
    part = OfPart(springs, np.array([2, 1], np.int32))
    first = Small(np.zeros((3, 3)), {"springs": {"a": np.ones(1)}})
    second = Small(np.ones((3, 3)) * np.arange(3)[:, None])
    assert part.work(first, FORCE)[0].sum() == 0.0
    assert part.work(second, FORCE)[0].sum() == 1.5
    assert part.work(first, FORCE)[0].sum() == 0.0
    assert part_of(first, np.array([0])).memory == first.memory
