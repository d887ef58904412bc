# SPDX-License-Identifier: MIT
"""What the command line prints for editors and shells."""

import json
import shutil
import subprocess

import pytest

from cruciform_petsc.case.schema import Case
from cruciform_petsc.cli import main
from cruciform_petsc.output.summary_keys import Summary


def test_schema(capsys):
    for words, schema in (([], Case), (["case"], Case), (["summary"], Summary)):
        assert main(["schema", *words]) == 0
        assert json.loads(capsys.readouterr().out) == schema.json_schema()
    assert main(["schema", "sumary"]) == 2
    assert 'did you mean "summary"?' in capsys.readouterr().err


@pytest.mark.skipif(shutil.which("bash") is None, reason="no bash")
@pytest.mark.parametrize(
    ("typed", "offered"),
    [
        (["sw"], {"sweep"}),
        (["c"], {"check", "calibrate", "compare", "completion"}),
        (["new", "pi"], {"picture-frame"}),
        (["sweep", "case.toml", "--v"], {"--vary", "--verbose"}),
        (["run", "case.toml", "--v"], {"--verbose"}),
        (["run", "case.toml", "--set", "preform.b"], {"preform.bias_angle="}),
        (["sweep", "case.toml", "--vary", "tool[0].f"], {"tool[0].friction="}),
        (["compare", "a", "b", "--by", "s"], {"strain", "shear"}),
        (["run", "dem"], set()),  # a file: bash's own
    ],
)
def test_completion(capsys, typed, offered):
    assert main(["completion"]) == 0
    script = capsys.readouterr().out
    words = " ".join(f'"{word}"' for word in ("cruciform-petsc", *typed))
    script += f"\nCOMP_WORDS=({words}); COMP_CWORD={len(typed)}; _cruciform_petsc"
    script += '\nprintf "%s\\n" "${COMPREPLY[@]}"'
    done = subprocess.run(["bash", "-uc", script], capture_output=True, text=True, check=True)
    assert set(done.stdout.split()) == offered
    assert done.stderr == ""
