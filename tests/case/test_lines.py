# SPDX-License-Identifier: MIT
"""Problems of a case file: all of them, each with its line."""

import time
import tomllib

import pytest

from cruciform_petsc.case.lines import key_lines, with_lines
from cruciform_petsc.case.schema import Case
from cruciform_petsc.errors import InputError

CASE = """\
titel = "t"
[fabric]
use = "e-glass-plain-2.4"
shear.law = "table"  # a dotted key
shear.angle = "deg"
shear.force = "N/mm"
shear.points = [
  [0, 0],
  [20, "x = 3"],  # no number
]

[preform]
outline = { rectangle = ["2.4 cm", "3.6"] }
bias_angle = "45 deg"
refin = 2
[test]
extension = '''
1 mm
bending = 3'''
bending = 1
[output]
pictures = "yes"
""".replace('"t"', '"""\n[preform]\nrefin = 2\n"""')  # a text that looks like keys


def test_every_problem_on_its_line(tmp_path):
    """Of several tables at once; keys within texts and lists of several lines are none."""
    path = tmp_path / "case.toml"
    path.write_text(CASE)
    with pytest.raises(InputError) as caught:
        Case.load(path, ["continuum.compare=7"])
    head, *problems = str(caught.value).splitlines()
    assert head == f'case file "{path}" has {len(problems)} problems:'
    starts = [
        "continuum.compare must be true or false, got 7",  # not of the file
        'line 1: the case file has the unknown key "titel" (did you mean "title"?)',
        "line 10: fabric.shear.points[1][1] must be a number, got 'x = 3'",
        'line 16: preform.outline.rectangle[1] = "3.6" has no unit',
        'line 18: [preform] has the unknown key "refin" (did you mean "refine"?)',
        'line 20: test.extension = "1 mm bending = 3" has the unreadable unit "mm bending = 3"',
        "line 23: test.bending must be true or false, got 1",
        "line 25: output.pictures must be true or false, got 'yes'",
    ]
    assert len(problems) == len(starts)
    for problem, start in zip(problems, starts, strict=True):
        assert problem.startswith(start)


def test_what_only_building_tells_has_its_line(tmp_path):
    """Fabric, outline and test together, all at once, beside a wrong key."""
    path = tmp_path / "case.toml"
    yarns = 'yarns = "2 /cm", yarn_bending = "0 N mm^2"'
    path.write_text(
        f"""
        [fabric]
        warp = {{ modulus = "-1 N/cm", poisson = 0, {yarns} }}
        weft = {{ modulus = "0 N/cm", poisson = 0, {yarns} }}
        shear.modulus = "-5 N/cm"
        [test]
        kind = "picture-frame"
        angle = "10 deg"
        [preform]
        bias_angle = "30 deg"
        outline.polygon = [["0 mm", "0 mm"], ["50 mm", "0 mm"], ["20 mm", "50 mm"]]
        """
    )
    with pytest.raises(InputError) as caught:
        Case.load(path)
    found = [problem.partition(" must")[0] for problem in caught.value.args[1:]]
    assert found[:2] == ["line 3: fabric.warp.modulus", "line 4: fabric.weft.modulus"]
    assert found[2] == "line 5: fabric.shear.modulus"
    assert found[3].startswith('line 7: test.kind = "picture-frame": preform has no edge "upper"')
    good = ['fabric={use="e-glass-plain-2.4"}', "output.picture=true"]
    with pytest.raises(InputError) as caught:
        Case.load(path, good[:1])
    lines = [problem.partition(":")[0] for problem in caught.value.args[1:]]
    assert lines == ["line 7", "line 7"]  # an edge that is not there; and no rectangle
    with pytest.raises(InputError, match='^.output. has the unknown key "picture"'):
        Case.load(path, [*good, "test={kind='bias-extension', extension='1 mm'}"])


@pytest.mark.parametrize("form", ["k{n} = 1", "[k{n}]", "k{n} = [\n\n\n1]"])
def test_lines_of_many_keys_take_no_time(form):
    """Of sixty thousand keys: each is looked at once, not each with all that follow."""
    text = "\n".join(form.format(n=n) for n in range(60_000))
    begin = time.perf_counter()
    found = key_lines(text)
    assert time.perf_counter() - begin < 4.0
    assert found["k2",] == 1 + 2 * (1 + form.count("\n"))


def test_one_problem_is_one_sentence(tmp_path):
    """With the file's name."""
    path = tmp_path / "case.toml"
    path.write_text("\n".join(line for line in CASE.splitlines()[4:] if "refin" not in line))
    good = ['preform.outline.rectangle=["2 cm","4 cm"]', "test.extension=1 mm", "test.bending=true"]
    with pytest.raises(InputError) as caught:
        Case.load(path, [*good, "output.pictures=true", 'test.extension="1 mm"', "title=t"])
    assert len(caught.value.args) == 1
    assert str(caught.value).startswith(f'"{path}", line 6: fabric.shear.points[1][1] must be')


def paths(data, above=()):
    for key, value in data.items():
        yield (*above, key)
        if isinstance(value, dict):
            yield from paths(value, (*above, key))


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("a.b.c = 1\n\n['d'.\"e f\"]\ng = 2", {("a", "b", "c"): 1, ("d", "e f"): 3}),
        ("x = [\n[1, 2],\n[3, 4]\n]\n[t]\ny = 1 # [z]", {("x",): 1, ("t",): 5, ("t", "y"): 6}),
        (
            "[[a]]\nb = 1\n[[a]]\nc = '''\n[d]\ne = 1\n'''\nf = 1",
            {("a", "1", "f"): 8, ("a", "0", "b"): 2},
        ),
        ("[[a]]\nb = 1\n[a.c]\nd = 1\n[[a]]\n[a.c]\nd = 2", {("a", "1", "c", "d"): 7}),
        ("a = { b = [1,\n 2], c = { d = 1 } }\r\ne = 1", {("a", "c", "d"): 1, ("e",): 3}),
    ],
)
def test_lines_of_keys(text, expected):
    found = key_lines(text)
    assert expected.items() <= found.items()
    assert set(paths(tomllib.loads(text))) <= set(found)


def test_long_tables_take_no_time():
    """Each statement is read about once."""
    rows = ",\n".join(f"[{n}, {n}]" for n in range(4000))
    assert key_lines(f"p = [\n{rows}\n]\nq = 1")[("q",)] == 4003


def test_every_table_is_known():
    """Sentences find the line of whatever stands at the top of a case file."""
    for name, field in Case.model_fields.items():
        key = field.alias or name
        assert with_lines("c", f"{key} = 1\n", [f"{key}[0].x is wrong"], []) == [
            f'"c", line 1: {key}[0].x is wrong'
        ]
