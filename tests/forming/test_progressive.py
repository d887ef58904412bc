# SPDX-License-Identifier: MIT
"""Cloth laid piece by piece: rows anew from where equilibrium has brought those before them."""

from dataclasses import replace

import numpy as np
import pytest
import shapely
from scipy.spatial.transform import Rotation
from support.forming import formed, kept, same_end
from support.laid import COMM, made, shear_of, written

from cruciform_petsc.case.schema import Case
from cruciform_petsc.cli import main
from cruciform_petsc.errors import EquilibriumError, InputError
from cruciform_petsc.forming.forming import form
from cruciform_petsc.output.checkpoint import Checkpoint

PIECES = ("fishnet = {}", 'fishnet = { pieces = 3, press = "10 kPa" }')
FINE = ("yarns_per_cruciform = 2\n", "")


@pytest.fixture(scope="module")
def pieces(tmp_path_factory):
    return formed(COMM, written(tmp_path_factory.mktemp("pieces"), PIECES))


def turned(blank, state, degrees, inner=None):
    """The cloth turned about the pole, on the sphere; or some of its nodes alone."""
    turn = Rotation.from_euler("z", degrees, degrees=True)
    x = state.x.copy()
    at = blank.cloth_at if inner is None else blank.cloth_at[inner]
    x[at] = turn.apply(x[at])
    return x


def test_stages_and_what_is_held_back(pieces):
    """Three stages before the case's; pieces are rings around the seed, in even steps."""
    forming, result = pieces
    assert [stage.name for stage in forming.stages] == ["lay 1", "lay 2", "lay 3", "vacuum"]
    assert forming.rows.last == [1, 2, 3]
    reach = np.abs(forming.network.crossover_ij - forming.draped.first).max(axis=1)
    for name, keep in forming.rows.cuts().items():
        ring = forming.rows.last[int(name.removeprefix("rows ")) - 1]
        inside = shapely.contains_xy(keep, *forming.network.crossover_position.T)
        np.testing.assert_array_equal(inside, reach <= ring)
    blank = forming.blank
    assert blank.ply.carrying(blank.start()).sum() == (reach <= 1).sum()
    assert blank.ply.carrying(result.states[-1]).all()
    assert [state.time for state in result.states] == [1.0, 2.0, 3.0, 4.0]


def test_rows_follow_their_edge(tmp_path):
    """A piece that has turned on a sphere has all beyond laid as if it had been laid so."""
    forming = made(written(tmp_path, PIECES, FINE))
    blank, rows = forming.blank, forming.rows
    state = blank.start()
    for number in (1, 2):
        inner = rows._laid(blank, rows.last[number - 1])
        assert 0 < inner.sum() < len(inner)
        x = turned(blank, state, 7.0, inner)
        new = rows.next(blank, state.moved(x - state.x), number)
        np.testing.assert_allclose(new.x, turned(blank, state, 7.0), rtol=0, atol=1e-12)
    # What is laid stays as it is, to the bit.
    assert (new.x[blank.cloth_at[inner]] == x[blank.cloth_at[inner]]).all()


def test_generators_go_on_as_they_run(tmp_path):
    """Of a net that has not moved all is laid where it was; on a cylinder yarns turn as they go."""
    tube = ('sphere = { radius = "40 mm", shaft = true }', 'cylinder = { radius = "40 mm" }')
    angle = ('bias_angle = "0 deg"', 'bias_angle = "30 deg"')
    forming = made(written(tmp_path, PIECES, tube, angle))
    state = forming.blank.start()
    for number in (1, 2):
        new = forming.rows.next(forming.blank, state, number)
        np.testing.assert_allclose(new.x, state.x, rtol=0, atol=1e-12)


def test_laying_does_no_work(tmp_path):
    """What moves between stages is not the loads' doing: cloth lifted off is sucked on again."""
    rest = ("[output]", '[[stage]]\nname = "rest"\nstep = 1.0\n[output]')
    forming = made(written(tmp_path, rest, ('rectangle = ["60 mm"', 'rectangle = ["40 mm"')))
    blank, lift, works = forming.blank, 0.3e-3, []

    def lifted(state, number):
        x = state.x.copy()
        x[blank.cloth_at, 2] += lift
        return blank.placed_anew(replace(state, x=x), np.ones(len(x), bool))

    for between in (None, lifted):
        works.append(form(blank, forming.plans, between=between).steps[-1].load_work["suction"])
    force = blank.pulls(blank.start())["suction"]
    assert not force.any()  # it is of the stage
    carried = form(blank, forming.plans).steps[-1].tool_force["mould"][2]
    assert works[1] - works[0] == pytest.approx(carried * lift, rel=0.15)


def test_moved_nodes_forget_but_what_they_have_spent(tmp_path):
    forming = made(written(tmp_path, PIECES))
    blank, rows = forming.blank, forming.rows
    state = blank.start()
    pressed = state.moved(np.where(np.arange(len(state.x))[:, None] >= 0, [0.0, 0.0, -1e-5], 0.0))
    memory = {name: dict(kept) for name, kept in blank.model.accepted(pressed).items()}
    memory["mould"]["spent"] = np.full_like(memory["mould"]["spent"], 2.0)
    memory["viscosity"]["spent"] = np.full_like(memory["viscosity"]["spent"], 3.0)
    begun = rows.next(blank, replace(pressed, memory=memory), 1)
    inner = rows._laid(blank, rows.last[0])[blank.touching]
    for name, spent in (("mould", 2.0), ("viscosity", 3.0)):
        np.testing.assert_array_equal(begun.memory[name]["spent"], spent)
    anchors = begun.memory["mould"]["anchor"]
    np.testing.assert_array_equal(anchors[inner], memory["mould"]["anchor"][inner])
    assert begun.memory["mould"]["fresh"][~inner].all()
    place = begun.memory["viscosity"]["place"]
    at = next(i for i in blank.model.items if i.name == "viscosity").nodes[:, 0]
    np.testing.assert_array_equal(place, begun.x[at])


def test_comes_to_rest(pieces):
    """Without wrinkles, its yarns hardly strained, sheared less than the net of rigid yarns."""
    forming, result = pieces
    fields = forming.blank.ply.fields(forming.blank.of_cloth(result.states[-1]))
    assert abs(fields["arm_strain"]).max() < 5e-3
    spends = [sum(step.spent.values()) for step in result.steps]
    assert (np.diff(spends) >= -1e-12).all()
    now, laid = (
        np.rad2deg(abs(shear_of(forming, state))).mean()
        for state in (result.states[-1], forming.blank.start())
    )
    assert now < 1.05 * laid


def test_as_all_at_once_where_friction_holds(tmp_path, pieces):
    """Cloth that stays where it is laid does not know in how many pieces it was."""
    forming, result = formed(COMM, written(tmp_path))
    assert result.steps[-1].tool_force["mould"][2] == pytest.approx(
        pieces[1].steps[-1].tool_force["mould"][2], rel=5e-3
    )
    one, other = (np.rad2deg(shear_of(forming, of.states[-1])) for of in (result, pieces[1]))
    np.testing.assert_allclose(other, one, atol=0.6)  # of 19 at the corners


def test_resumed(tmp_path, pieces):
    """Killed just as a piece is done: the next one is laid anew as it was, to the same end."""
    case = Case.load(written(tmp_path, PIECES))
    stop = sum(step.stage == "lay 1" for step in pieces[1].steps)
    assert kept(COMM, case, Checkpoint.begin(COMM, tmp_path, case), stop=stop) is None
    same_end(kept(COMM, case, Checkpoint.resume(COMM, tmp_path)), pieces[1], within=1e-9)


def test_locking_ends_it_with_what_there_is(tmp_path):
    """Rows that lock when they are laid anew: the place, and the steps up to there."""
    forming = made(written(tmp_path, PIECES))
    rows, blank = forming.rows, forming.blank
    object.__setattr__(rows, "locking", 0.1)
    with pytest.raises(EquilibriumError, match="the net locks at x = "):
        rows.next(blank, blank.start(), 2)


@pytest.mark.parametrize(
    ("key", "told"),
    [
        ("pieces = 3", "test.fishnet.pieces need press, which holds those that are laid"),
        ('pieces = 1, press = "1 kPa"', "test.fishnet.pieces must be at least 2"),
        ('pieces = 9, press = "1 kPa"', "test.fishnet.pieces = 9 is more than the 3 rows"),
        (
            'pieces = 2, press = "1 kPa", warp_line = [["0 mm", "-9 mm"], ["0 mm", "9 mm"]]',
            "test.fishnet.pieces go on straight: leave out warp_line and weft_line",
        ),
    ],
)
def test_mistakes(tmp_path, capfd, key, told):
    path = written(tmp_path, ("fishnet = {}", f"fishnet = {{ {key} }}"))
    assert main(["run", str(path), "--output", str(tmp_path / "out"), "--quiet"]) == 2
    assert told in capfd.readouterr().err


def test_names_of_rows_are_taken(tmp_path):
    path = written(tmp_path, PIECES, ('name = "mould"', 'name = "rows 1"'))
    with pytest.raises(InputError, match="is what the program calls something else"):
        Case.load(path)
