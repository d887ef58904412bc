# SPDX-License-Identifier: MIT
"""README.md and docs/: the site, its links, and the code that stands in them."""

import inspect
import itertools
import json
import re
import shutil
import subprocess
import sys
import tomllib

import pytest
import yaml

pytest.importorskip("furo", reason="the extra docs: Sphinx, furo and myst-parser")
pytest.importorskip("myst_parser")

from mpi4py import MPI
from support.docs import PAGES, ROOT, blocks, commands
from support.forming import CASE

import cruciform_petsc
from cruciform_petsc import BiasExtension, Case, Fabric, Network, Preform, calibration, cli, laws

NAMES = {path.name for path in PAGES if path.parent.name == "docs"}


# -- the site -------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def site(tmp_path_factory):
    """The site, made as a reader makes it; scripts/docs takes any warning for an error."""
    folder = tmp_path_factory.mktemp("site")
    done = subprocess.run(
        [str(ROOT / "scripts" / "docs"), str(folder)], capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
    assert done.stdout.strip() == f"{folder}/index.html"
    return folder


def index_of(site):
    text = (site / "searchindex.js").read_text()
    return json.loads(text.removeprefix("Search.setIndex(").removesuffix(")"))


def pages_with(index, *stems):
    """Pages that have all of these words, in titles or in the text."""
    found = []
    for stem in stems:
        numbers = [index[part].get(stem, []) for part in ("terms", "titleterms")]
        found.append({n for some in numbers for n in ([some] if isinstance(some, int) else some)})
    return {index["docnames"][number] for number in set.intersection(*found)}


def test_search(site):
    """Offline: the index, and the scripts that look into it, are there."""
    index = index_of(site)
    assert {"calibration", "flat-tests", "glossary"} <= pages_with(index, "pictur", "frame")
    assert {"forming", "glossary"} <= pages_with(index, "springback")
    for name in ("searchtools.js", "doctools.js", "language_data.js"):
        assert (site / "_static" / name).stat().st_size > 1000, name


@pytest.mark.skipif(shutil.which("chromium") is None, reason="there is no Chromium here")
def test_site_in_a_browser(site):
    """From the disk: each page without a message in the console, dark and light, searched."""
    done = subprocess.run(
        [sys.executable, str(ROOT / "scripts" / "check_site.py"), str(site)],
        capture_output=True, text=True, timeout=120, check=False,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr


def test_nothing_is_loaded_from_outside(site):
    loads = re.compile(r"<(?:script|img|link|iframe)\b[^>]*\b(?:src|href)=\"((?:https?:)?//[^\"]*)")
    pages = list(site.glob("*.html"))
    assert len(pages) > len(NAMES)
    for path in pages:
        assert not loads.findall(path.read_text()), path.name
    for path in (site / "_static").rglob("*.css"):
        assert not re.search(r"(url\(|@import)\s*[\"']?(https?:)?//", path.read_text()), path.name


def test_every_page_is_in_the_navigation(site):
    start = (site / "index.html").read_text()
    tree = start[start.index('class="sidebar-tree"') :]
    for name in NAMES - {"index.md"}:
        assert f'href="{name.removesuffix(".md")}.html"' in tree, name


def test_every_public_name_has_its_entry(site):
    page = (site / "api.html").read_text()
    for name in cruciform_petsc.__all__:
        assert f'id="cruciform_petsc.{name}"' in page, name
    assert 'id="cruciform_petsc.Preform.rectangle"' in page
    assert "Raises<span" in page
    assert "the shear angle [rad]; None: linear, G." in page  # its colon ends no type


@pytest.mark.parametrize("name", ["README.md", "CONTRIBUTING.md", "CHANGELOG.md"])
def test_links_of_other_pages(name):
    """Those of docs/ are Sphinx's to check."""
    links = re.findall(r"\]\((?!http)([^)#]+)\)", (ROOT / name).read_text())
    assert links
    for link in links:
        assert (ROOT / link).exists(), link


def test_glossary():
    """Its words are used, and it is linked from the pages for users."""
    text = (ROOT / "docs" / "glossary.md").read_text()
    terms = re.findall(r"^### (.*)$", text, re.MULTILINE)
    for term in ("Warp", "Weft", "Crossover", "Arm", "Bend", "Pitch", "Shear angle", "Preform"):
        assert term in terms
    assert {"Blank holder", "Draw-in"} <= set(terms)
    others = " ".join(path.read_text() for path in PAGES if path.name != "glossary.md")
    others = re.sub(r"[-_\s]+", " ", others.lower())
    assert [t for t in terms if re.sub("-", " ", t.lower()) not in others] == []
    for name in ("start", "tutorial", "tutorial-forming", "forming", "datasheet", "formulation"):
        assert "](glossary.md" in (ROOT / "docs" / f"{name}.md").read_text(), name


# -- code in the pages ----------------------------------------------------------------------------

# What is no command of ours.
SYSTEM = {"git", "./configure", "#!/bin/bash", "export", "srun"}


def test_commands():
    """Each one: the program takes it, scripts and demos are there, scripts know their options."""
    seen = []
    for page, line, words in commands():
        where = f"{page}:{line}"
        for word in words:
            if re.match(r"(demos|scripts)/[\w/]+\.\w+$|\./scripts/", word):
                assert (ROOT / word).is_file(), f"{where}: there is no {word}"
        names = [n for n, word in enumerate(words) if word == "cruciform-petsc"]
        if names and not words[-1].startswith("--help"):
            ours = words[names[0] + 1 :]
            seen.append(ours[0])
            if len(ours) > 1:  # else it is spoken of
                try:
                    cli._parser().parse_args(cli.split_arguments(ours)[0])
                except cruciform_petsc.InputError as error:
                    pytest.fail(f"{where}: {' '.join(words)}: {error}")
        for option, value in itertools.pairwise(words):
            if option in ("--set", "--vary") and "=" in value and "$" not in value:
                key = re.sub(r"\[\d+\]", "[0]", value.partition("=")[0])
                assert ".".join(key.split(".")[:2]) in Case.paths(), f"{where}: no case has {key}"
        for n, word in enumerate(words):
            if word.startswith("scripts/") and word.endswith(".py"):
                text = (ROOT / word).read_text()
                for option in words[n + 1 :]:
                    assert not option.startswith("--") or f'"{option}"' in text, (
                        f"{where}: {option}"
                    )
    assert set(seen) == set(cli._parser().commands.choices)


# Blocks that a test of another file takes whole.
ELSEWHERE = {"datasheet.md", "outlines.md", "tutorial.md", "tutorial-forming.md"}
OF_FORMING = {"forming.md", "tools.md", "fishnet.md"}
# Where keys stand that a block shows without their table.
TABLES = {
    "shape": lambda keys: {"tool": [{"name": "die", **keys}]},
    "tension": lambda keys: {"fabric": keys},
    "shear_viscosity": lambda keys: {"fabric": keys},
}


def merged(base, part):
    """A case with the tables of a block in place of its own; of tables in a list, by name."""
    if isinstance(base, dict) and isinstance(part, dict):
        return base | {key: merged(base.get(key), value) for key, value in part.items()}
    if isinstance(base, list) and part and isinstance(part[0], dict):
        names = {table.get("name") for table in part}
        return [*part, *(table for table in base if table["name"] not in names)]
    return part


def test_pieces_of_cases(tmp_path):
    """Each of them makes a case that can be read."""
    shutil.copy(ROOT / "demos" / "tools" / "tetrahedron.stl", tmp_path / "die.stl")
    pieces = [block for block in blocks("toml") if block.page not in ELSEWHERE]
    whole = {page: tomllib.loads(next(b.text for b in pieces if b.page == page))
             for page in ("flat-tests.md", "forming.md")}  # fmt: skip
    assert len(pieces) >= 8
    for page, line, _, text in pieces:
        part = tomllib.loads(text)
        if wrap := TABLES.get(next(iter(part))):
            part = wrap(part)
        base = whole["forming.md" if page in OF_FORMING else "flat-tests.md"]
        if page == "fishnet.md":  # each block says what [test] is
            base = {key: table for key, table in base.items() if key != "test"}
        try:
            Case.from_data(merged(base, part))
        except cruciform_petsc.InputError as error:
            pytest.fail(f"{page}:{line}: {error}")


def of_page(page, word=""):
    return next(b.text for b in blocks("python") if b.page == page and word in b.text)


def test_ten_lines_stand_twice():
    """Those of the README, which other tests run, are those of the site's first page."""
    assert of_page("start.md") == of_page("README.md")


def test_python_of_forming_tools_and_exports(tmp_path, monkeypatch, capsys):
    """With a small part in place of the demo."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "demos").mkdir()
    (tmp_path / "demos" / "hemisphere.toml").write_text(CASE)
    shutil.copy(ROOT / "demos" / "tools" / "tetrahedron.stl", "die.stl")
    preform = Preform.rectangle("20 mm", "40 mm")
    network = Network(MPI.COMM_SELF, preform, Fabric.from_library("glass-pp-plain-1.93"))
    names = {
        "result": BiasExtension(network, extension=1e-3).solve(),
        "export": cruciform_petsc.export,
    }
    exec("from cruciform_petsc.output.exports import export_formed", names)
    for page in ("forming.md", "exports.md", "tools.md"):
        exec(of_page(page), names)
    assert "[" in capsys.readouterr().out
    assert {"crossovers.csv", "preform.inp"} <= {
        path.name for path in (tmp_path / "folder").iterdir()
    }
    assert names["normal"].shape == (1, 3)


def test_python_of_calibration():
    """The names and keywords are there; test_specimens.py and others run such fits."""
    bind = inspect.signature(calibration.calibrate_together).bind
    names = dict.fromkeys(("strip", "frame", "curve1", "curve2")) | {
        "Specimen": calibration.Specimen, "calibrate_together": bind, "linear": laws.linear,
    }  # fmt: skip
    exec(of_page("calibration.md"), names)
    exec(of_page("tutorial.md"), {})


# -- files for people and other programs ----------------------------------------------------------


def test_citation():
    """The citation has what the format asks for, and the package's version."""
    data = yaml.safe_load((ROOT / "CITATION.cff").read_text())
    assert data["cff-version"] == "1.2.0"
    assert {"message", "title", "authors"} <= data.keys()
    assert data["version"] == cruciform_petsc.__version__
    assert data["license"] == "MIT"


def names_of(requirements):
    return {re.match(r"[\w-]+", text)[0].lower() for text in requirements}


def test_environments_have_what_the_package_needs():
    """Neither could be run here: at least they do not fall behind."""
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    extras = itertools.chain(*project["optional-dependencies"].values())
    needed = names_of([*project["dependencies"], *extras])
    conda = names_of(yaml.safe_load((ROOT / "environment.yml").read_text())["dependencies"])
    conda |= {"gmsh", "matplotlib"} if {"python-gmsh", "matplotlib-base"} <= conda else set()
    assert needed - {"cascadio"} - conda == set()  # STEP goes through gmsh there
    script = (ROOT / "scripts" / "fenicsx").read_text()
    packages = re.sub("#.*", "", re.search(r"\npackages=\((.*?)\n\)", script, re.DOTALL)[1]).split()
    dockerfile = (ROOT / "Dockerfile").read_text()
    assert re.search(r"recommends(.*?)&& rm", dockerfile.replace("\\\n", ""))[1].split() == packages
    for name in ("environment.yml", "Dockerfile"):
        assert "Not " in (ROOT / name).read_text().split("\n\n")[0]
