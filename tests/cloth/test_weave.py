# SPDX-License-Identifier: MIT
"""Weaves by name: who is above, how long yarns float, and names that are none."""

import numpy as np
import pytest

from cruciform_petsc import InputError
from cruciform_petsc.cloth.weave import Weave

WEAVES = ["plain", "twill 2/1", "twill 2/2", "twill 3/1", "twill 1/3", "satin 4", "satin 5",
          "satin 7", "satin 8", "satin 12"]  # fmt: skip


def printed(name):
    return ["".join("#" if above else "." for above in row) for row in Weave.named(name).warp_above]


def test_as_drawn_on_point_paper():
    """A row is a warp, from weft to weft; # is warp over weft."""
    assert printed("plain") == ["#.", ".#"]
    assert printed("twill 2/2") == ["##..", ".##.", "..##", "#..#"]
    assert printed("twill 3/1") == ["###.", ".###", "#.##", "##.#"]
    assert printed("satin 5") == [".####", "##.##", "####.", "#.###", "###.#"]
    assert printed("satin 4") == [".###", "#.##", "###.", "##.#"]
    assert printed("satin 8")[1] == "###.####"


@pytest.mark.parametrize("name", WEAVES)
def test_a_loom_can_weave_it(name):
    """Each warp and each weft is bound once a repeat; satins nowhere beside their neighbour's."""
    above = Weave.named(name).warp_above
    n = len(above)
    assert np.ptp(above.sum(axis=0)) == np.ptp(above.sum(axis=1)) == 0
    for one in (above, above.T):
        assert ((one != np.roll(one, 1, axis=1)).sum(axis=1) == 2).all()
    assert Weave.named(name).float_length == n / 2
    if name.startswith("satin") and n > 4:
        below = (~above).argmax(axis=1)
        step = (np.roll(below, -1) - below) % n
        assert not set(step) & {0, 1, n - 1}


@pytest.mark.parametrize("name", WEAVES)
def test_heights(name):
    """At each crossing one is above, the other below; between, never beyond; a plain one waves."""
    weave = Weave.named(name)
    n = len(weave.warp_above)
    fine = np.linspace(-3.0, 2.0 * n, 97)
    for j in range(-2, n + 2):
        for i in range(-2, n + 2):
            warp, weft = (weave.heights(f, line, np.array([float(at)])).item()
                          for f, line, at in ((0, j, i), (1, i, j)))  # fmt: skip
            assert warp == -weft == (1.0 if weave.warp_above[j % n, i % n] else -1.0)
        assert abs(weave.heights(0, j, fine)).max() <= 1.0
        if name == "plain":
            np.testing.assert_allclose(
                weave.heights(0, j, fine), np.cos(np.pi * (fine + j)), atol=1e-12
            )


@pytest.mark.parametrize(
    ("name", "words"),
    [
        ("twil 2/2", 'must be a weave, write "plain", "twill 2/2"'),
        ("twill 0/2", "must be a weave"),
        ("twill 2/-2", "must be a weave"),
        ("2x2 twill", "must be a weave"),
        ("satin", "must be a weave"),
        ("", "must be a weave"),
        ("satin 6", '= "satin 6" is no regular satin: 4, 5 and all from 7'),
        ("satin 3", '= "satin 3" is no regular satin'),
        ("satin 1", '= "satin 1" is no regular satin'),
        ("satin 0", '= "satin 0" is no regular satin'),
        ("satin 99", "has a repeat of 99 yarns, at most 32"),
        ("twill 30/30", "has a repeat of 60 yarns"),
    ],
)
def test_names_that_are_none(name, words):
    with pytest.raises(InputError) as caught:
        Weave.named(name)
    assert str(caught.value).startswith(words)
