# SPDX-License-Identifier: MIT
"""The command line as a user meets it: separate processes, one and two ranks.

mpi4py must not be imported here: this process starts mpirun and is no rank itself.
"""

import json
import os
import re
import subprocess
import sys
import textwrap

import pytest

from cruciform_petsc.cli import split_arguments
from cruciform_petsc.errors import InputError

SPECIMEN = """
[fabric]
warp = { modulus = "520 N/cm", poisson = 0.45, yarns = "2.4 /cm", yarn_bending = "0.6 N mm^2" }
weft = { modulus = "520 N/cm", poisson = 0.45, yarns = "2.4 /cm", yarn_bending = "0.6 N mm^2" }
shear = { modulus = "0.96 N/cm" }
[preform]
outline = { rectangle = ["2.4 cm", "3.6 cm"] }
bias_angle = "45 deg"
[test]
extension = "1 mm"
"""

LAUNCHER = {  # mpirun as root in a container, more ranks than cores
    "OMPI_ALLOW_RUN_AS_ROOT": "1",
    "OMPI_ALLOW_RUN_AS_ROOT_CONFIRM": "1",
    "PRTE_MCA_rmaps_default_mapping_policy": ":oversubscribe",
    "OMP_NUM_THREADS": "1",
}


def launch(ranks, *command, timeout=60.0):
    """Run python3 with these arguments on so many ranks; 0 ranks: without mpirun."""
    # An MPI job must not think it is part of the one that this process may belong to.
    mpi_job = re.compile(r"PMIX_(?!MCA_)|OMPI_COMM_|PMI_")
    env = {key: value for key, value in os.environ.items() if not mpi_job.match(key)}
    launcher = ["mpirun", "-n", str(ranks)] if ranks else []
    return subprocess.run(
        [*launcher, sys.executable, *map(str, command)],
        env=env | LAUNCHER,
        capture_output=True,
        text=True,
        timeout=timeout,
        check=False,
    )


def cruciform_petsc(ranks, *arguments):
    """Run the command line."""
    return launch(ranks, "-m", "cruciform_petsc", *arguments)


def sentences(result):
    """Return what the program itself said on stderr; the launcher has its own words."""
    # One launcher glues the ranks' lines to its own, so look for the name, not for line starts.
    return re.findall(r"cruciform-petsc: (.*?)(?:-{40,})?$", result.stderr, re.MULTILINE)


def assert_refused(result, message):
    """Exit code 2, one sentence, nothing else from the program."""
    assert result.returncode == 2, result.stderr
    assert sentences(result) == [message]
    assert "Traceback" not in result.stderr
    assert result.stdout == ""


@pytest.fixture
def case(tmp_path):
    """Write a good case file."""
    path = tmp_path / "case.toml"
    path.write_text(SPECIMEN)
    return path


BAD_INPUT = {
    "unknown key": (
        ["--set", "preform.refin=4"],
        '[preform] has the unknown key "refin" (did you mean "refine"?)',
    ),
    "wrong unit": (
        ["--set", "test.extension=1 N"],
        'test.extension = "1 N" has the unit "N", which is not that of a length like "1 mm"',
    ),
    "negative modulus": (
        ["--set", "fabric.warp.modulus=-1 N/cm"],
        "fabric.warp.modulus must be positive and finite, got -1 N/cm",
    ),
    "broken reciprocity": (
        ["--set", "fabric.weft.poisson=0.3"],
        "fabric.weft.poisson = 0.3 breaks reciprocity (nu_weft E_warp must equal nu_warp E_weft), "
        "with the other values it would have to be 0.45",
    ),
    "self-crossing outline": (
        [
            "--set",
            'preform.outline={polygon=[["0 m", "0 m"], ["1 m", "1 m"], '
            '["1 m", "0 m"], ["0 m", "1 m"]]}',
        ],
        "preform.outline crosses or touches itself at x = 500 mm, y = 500 mm, "
        "it must be a simple polygon",
    ),
    "outline too small": (
        ["--set", 'preform.outline={rectangle=["1 mm", "2 mm"]}'],
        "preform.outline (1 mm x 2 mm) is smaller than one cruciform (4.16667 mm x 4.16667 mm "
        "along the yarns), make it larger or raise preform.refine",
    ),
    "no clamp": (
        [
            "--set",
            'preform.outline={polygon=[["0 cm", "5 cm"], ["2 cm", "0 cm"], ["5 cm", "5 cm"]]}',
        ],
        '"CASE", line 9: test.kind = "bias-extension": preform has no edge "lower" '
        "(no straight piece of the outline lies at its smallest y, known: upper, outline-1 to "
        "outline-3)",
    ),
    "unwritable folder": (
        ["--output", "/proc/no/folder"],
        'output folder "/proc/no/folder" cannot be written: No such file or directory',
    ),
    "unwritable folder that exists": (
        ["--output", "/proc"],
        'output folder "/proc" cannot be written: No such file or directory',
    ),
    "mistyped option": (["--outptu=x"], 'there is no option "--outptu", did you mean "--output"?'),
    "argparse": (["--set"], "argument --set: expected one argument"),
}


@pytest.mark.parametrize("ranks", [0, 2])
@pytest.mark.parametrize("name", BAD_INPUT)
def test_bad_input(case, name, ranks):
    """One sentence and exit code 2, on any number of ranks."""
    arguments, message = BAD_INPUT[name]
    message = message.replace("CASE", str(case))
    assert_refused(cruciform_petsc(ranks, "run", case, *arguments), message)


def test_every_problem_has_a_line_of_its_own(case):
    """With the line of the file that it is about; once, however many ranks there are."""
    case.write_text(SPECIMEN.replace("bias_angle", "bais_angle").replace("1 mm", "1 N"))
    result = cruciform_petsc(2, "check", case)
    assert result.returncode == 2
    _, _, told = result.stderr.partition("cruciform-petsc: ")
    assert told.splitlines()[:4] == [
        f'case file "{case}" has 3 problems:',
        "  line 6: preform.bias_angle is missing",
        '  line 8: [preform] has the unknown key "bais_angle" (did you mean "bias_angle"?)',
        '  line 10: test.extension = "1 N" has the unit "N", which is not that of a length like '
        '"1 mm"',
    ]


def test_commands_in_messages_begin_as_the_user_s(tmp_path, monkeypatch):
    """scripts/fenicsx as it was typed stands before them, else nothing."""
    from cruciform_petsc.errors import typed_before

    monkeypatch.setenv("CRUCIFORM_PETSC_BY", "./scripts/fenicsx")
    result = cruciform_petsc(0, "resume", tmp_path)
    assert "; start with ./scripts/fenicsx cruciform-petsc run CASE" in result.stderr
    monkeypatch.setenv("CRUCIFORM_PETSC_BY", "a folder/fenicsx")
    assert typed_before() == "'a folder/fenicsx' "
    monkeypatch.delenv("CRUCIFORM_PETSC_BY")
    assert typed_before() == ""
    result = cruciform_petsc(0, "new", "biaxial", tmp_path / "case.toml")
    assert f"; try: cruciform-petsc check {tmp_path}" in result.stdout


@pytest.mark.parametrize("ranks", [0, 2])
def test_bad_files(tmp_path, ranks):
    """A missing file, a folder, and a file that is not TOML."""
    missing = tmp_path / "missing.toml"
    message = f'case file "{missing}" does not exist'
    assert_refused(cruciform_petsc(ranks, "check", missing), message)
    message = f'case file "{tmp_path}" is a folder, name a TOML file in it'
    assert_refused(cruciform_petsc(ranks, "check", tmp_path), message)
    text = tmp_path / "text"
    text.write_text("no TOML")
    result = cruciform_petsc(ranks, "check", text)
    assert result.returncode == 2
    assert len(sentences(result)) == 1
    assert sentences(result)[0].startswith(f'case file "{text}" is not TOML: ')


def test_file_in_the_way_of_the_folder(case):
    """A file where the folder, or one above it, should be."""
    for folder in (case, case / "results"):
        assert_refused(
            cruciform_petsc(2, "run", case, "--output", folder),
            f'output folder "{folder}" cannot be made because a file is in its way',
        )


def test_folder_without_permission(case, tmp_path):
    """A folder that exists but cannot be written to is found before the work."""
    if os.geteuid() == 0:
        pytest.skip("root may write anywhere")
    tmp_path.chmod(0o500)
    result = cruciform_petsc(0, "run", case, "--output", tmp_path)
    tmp_path.chmod(0o700)
    message = f'output folder "{tmp_path}" cannot be written: Permission denied'
    assert_refused(result, message)


def test_fabrics_are_printed_once():
    """Two ranks print one table, with units and sources."""
    result = cruciform_petsc(2, "fabrics")
    assert result.returncode == 0
    assert result.stdout.count("e-glass-plain-2.4") == 1
    for part in ("520 N/cm", "2.4 /cm", "0.6 N mm^2", "0.96 N/cm", "Table 1"):
        assert part in result.stdout


@pytest.mark.parametrize("option", ["--version", "--help"])
def test_words_are_printed_once(option):
    """Version and help come from one rank."""
    result = cruciform_petsc(2, option)
    assert result.returncode == 0
    assert result.stdout.count("cruciform-petsc") == 1


# -- what run_case raises, and what it is given, with another run_case in its place ------------

DRIVER = """
import sys, time, types
from pathlib import Path
from mpi4py import MPI
from cruciform_petsc.errors import InputError, SolverError
comm = MPI.COMM_WORLD

def run_case(comm, case, directory, log):
{body}

def check_case(comm, case, log):
    print("checked", comm.rank, case.preform().refine)

run = types.ModuleType("cruciform_petsc.run")
run.run_case, run.check_case = run_case, check_case
sys.modules["cruciform_petsc.run"] = run
assert "petsc4py.PETSc" not in sys.modules
from cruciform_petsc.cli import main
assert "petsc4py.PETSc" not in sys.modules, "cli imports PETSc before it has the options"
sys.exit(main(sys.argv[1:]))
"""


@pytest.fixture
def drive(tmp_path, case):
    """Run the command line with the given body of run_case."""

    def driver(ranks, body, *options, command="run"):
        script = tmp_path / "driver.py"
        script.write_text(DRIVER.format(body=textwrap.indent(textwrap.dedent(body), "    ")))
        output = ["--output", tmp_path / "out" / "deep"] if command == "run" else []
        return launch(ranks, script, command, case, *output, *options)

    return driver


def test_run_gets_case_folder_and_options(drive, tmp_path):
    """Case, folder, log and PETSc options arrive; rank 0 alone logs."""
    body = """
    from petsc4py import PETSc
    options = PETSc.Options().getAll()
    assert options["ksp_type"] == "cg" and options["shift"] == "-1e-3" and "ksp_view" in options
    assert directory == Path(case.output.directory) and directory.is_dir()
    assert case.preform().refine == 4 and case.fabric().shear_modulus == 96.0
    log.info("only once")
    log.debug("never")
    """
    options = ["--set", "preform.refine=4", "-ksp_type", "cg", "-ksp_view", "-shift", "-1e-3"]
    result = drive(2, body, *options)
    assert result.returncode == 0, result.stderr
    assert result.stdout.count("only once") == 1
    assert "never" not in result.stdout
    assert (tmp_path / "out" / "deep").is_dir()
    assert list((tmp_path / "out" / "deep").iterdir()) == []


@pytest.mark.parametrize(
    ("option", "lines"), [("--quiet", ["loud"]), ("--verbose", ["soft", "plain", "loud"])]
)
def test_loudness(drive, option, lines):
    """--quiet leaves warnings, --verbose adds details."""
    body = "log.debug('soft'); log.info('plain'); log.warning('loud')"
    assert drive(0, body, option).stdout.split() == lines


def test_calibrate_gets_its_data(tmp_path, case):
    """Case, data, folder and PETSc options arrive; without data one sentence."""
    script = tmp_path / "calibrate.py"
    script.write_text(CALIBRATE)
    folder = tmp_path / "law"
    given = ("--data", "curve.csv", "--output", folder, "-ksp_type", "cg")
    result = launch(2, script, "calibrate", case, *given)
    assert result.returncode == 0, result.stderr
    assert sorted(re.findall(r"calibrate (\d) (\S+) (\S+)", result.stdout)) == [
        ("0", "curve.csv", str(folder)),
        ("1", "curve.csv", str(folder)),
    ]
    # --set reaches every case, --columns every file.
    beside = (
        "--also",
        case,
        "--also-data",
        "b.csv",
        "--hold-out",
        case,
        "--hold-out-data",
        "c.csv",
    )
    more = ("--set", "preform.refine=3", "--columns", "d [mm],F [N]")
    result = launch(0, script, "calibrate", case, *given[:4], *beside, *more, *given[4:])
    assert result.returncode == 0, result.stderr
    assert "refined 3 3 3 ['d [mm],F [N]']" in result.stdout
    message = "the following arguments are required: --data"
    assert_refused(cruciform_petsc(0, "calibrate", case), message)
    result = cruciform_petsc(0, "calibrate", case, "--data", "curve.csv", "--hold-out", case)
    message = "--hold-out CASE and --hold-out-data FILE belong together, give both or neither"
    assert_refused(result, message)
    result = cruciform_petsc(0, "calibrate", case, "--data", "curve.csv", "--also", case)
    assert_refused(result, "each --also CASE needs an --also-data FILE, in the same order")
    result = cruciform_petsc(0, "run", case, "--data", "curve.csv")
    assert_refused(result, "unrecognized arguments: --data curve.csv")


CALIBRATE = """
import sys, types
from petsc4py import PETSc

def calibrate_case(comm, case, data_path, directory, log, **more):
    assert PETSc.Options().getAll()["ksp_type"] == "cg" and directory.is_dir()
    print(f"calibrate {comm.rank} {data_path} {directory}\\n", end="", flush=True)
    if more:
        cases = [case, more["also"][0][0], more["hold_out"][0]]
        print("refined", *(each.preform().refine for each in cases), more["columns"])

module = types.ModuleType("cruciform_petsc.calibrate")
module.calibrate_case = calibrate_case
sys.modules["cruciform_petsc.calibrate"] = module
from cruciform_petsc.cli import main
sys.exit(main(sys.argv[1:]))
"""


def test_help_has_examples():
    for command in ("run", "check", "calibrate", "fabrics"):
        result = cruciform_petsc(0, command, "--help")
        assert result.returncode == 0
        assert re.search(rf"Example: .*cruciform-petsc {command}", result.stdout)


def test_check(drive):
    """`check` runs on every rank and makes no folder."""
    result = drive(2, "pass", "--set", "preform.refine=2", command="check")
    assert result.returncode == 0, result.stderr
    assert sorted(re.findall(r"checked (\d) 2", result.stdout)) == ["0", "1"]


RAISES = {
    "all": "raise SolverError('did not\\n  converge', 'DIVERGED_ITS', [1.0])",
    "only rank 1, rank 0 ends well": "if comm.rank == 1: raise InputError('did not converge')",
    "only rank 1, rank 0 waits for it": """
        if comm.rank == 1: raise InputError('did not converge')
        comm.Barrier()
        """,
    "only rank 0, rank 1 waits for it": """
        if comm.rank == 0: raise InputError('did not converge')
        comm.Barrier()
        """,
    "one late": """
        time.sleep(2 * comm.rank)
        raise InputError('did not converge')
        """,
}


@pytest.mark.parametrize("name", RAISES)
def test_errors_on_some_ranks(drive, name):
    """Whoever raises, one sentence is printed and all ranks end with 2."""
    assert_refused(drive(2, RAISES[name]), "did not converge")


def test_two_of_three_ranks_raise(drive):
    """Two ranks raise and a third waits: still one sentence."""
    body = "if comm.rank: raise InputError('did not converge')\ncomm.Barrier()"
    assert_refused(drive(3, body), "did not converge")


@pytest.mark.parametrize("ranks", [0, 2])
def test_internal_error(drive, ranks):
    """A fault of the program comes with its traceback and rank, and ends all."""
    last = max(ranks - 1, 0)
    result = drive(ranks, f"if comm.rank == {last}: raise ZeroDivisionError('why')\ncomm.Barrier()")
    assert result.returncode == 1
    assert f"cruciform-petsc: internal error on rank {last}" in result.stderr
    assert "ZeroDivisionError: why" in result.stderr


@pytest.mark.parametrize("ranks", [0, 2])
def test_interrupt(drive, ranks):
    """An interrupt ends all ranks with 130 and without a traceback."""
    result = drive(ranks, "if comm.rank == 0: raise KeyboardInterrupt\ncomm.Barrier()")
    assert result.returncode == 130
    assert "Traceback" not in result.stderr


IN_NEWTON = """
import os, signal
from cruciform_petsc import BiasExtension, Network
from cruciform_petsc.equilibrium.model import Model
whole, calls = Model.{method}, []

def stopped(*arguments, **options):
    calls.append(0)
    if len(calls) == 4 and comm.rank == {rank}:
        {do}
    return whole(*arguments, **options)

Model.{method} = stopped
network = Network(comm, case.preform(refine=3), case.fabric())
BiasExtension(network, ["1 mm", "2 mm"], finite=True).solve()
"""


@pytest.mark.parametrize("ranks", [0, 2])
@pytest.mark.parametrize(
    ("method", "do", "code"),
    [
        ("force", "raise KeyboardInterrupt", 130),
        ("stiffness", "os.kill(os.getpid(), signal.SIGINT)", 130),
        ("force", "os.kill(os.getpid(), signal.SIGTERM)", 143),
        ("stiffness", "raise ZeroDivisionError('why')", 1),
    ],
    ids=["raised", "SIGINT", "SIGTERM", "fault"],
)
def test_interrupt_in_newton(drive, ranks, method, do, code):
    """In what PETSc calls, on the last rank, while the others go on with it: all end."""
    body = IN_NEWTON.format(method=method, rank=max(ranks - 1, 0), do=do)
    result = drive(ranks, body)
    assert result.returncode == code, result.stderr
    assert ("Traceback" in result.stderr) == (code == 1)
    said = "ZeroDivisionError: why" if code == 1 else "cruciform-petsc: interrupted"
    assert said in result.stderr


NO_MEMORY = """
from petsc4py import PETSc
from cruciform_petsc import BiasExtension, Network
from cruciform_petsc.equilibrium.model import Model
from cruciform_petsc.small.network import LinearNetwork
from cruciform_petsc.solvers.callbacks import callback
from cruciform_petsc.solvers.yarns import YarnSmoother
from cruciform_petsc.output.folder import OF_RUN, locked
from cruciform_petsc import parallel
whole, calls = {kind}.{method}, []
parallel._PATIENCE = 2.5

def failing(*arguments, **options):
    calls.append(0)
    if len(calls) == {number} and comm.rank == {rank}:
        raise {error}
    return whole(*arguments, **options)

{kind}.{method} = callback(failing) if hasattr(whole, "__wrapped__") else failing
with locked(comm, directory, OF_RUN, log):
    network = Network(comm, case.preform(refine=6), case.fabric())
    BiasExtension(network, ["1 mm", "2 mm"], {keys}).solve()
"""
MULTIGRID = "options={'pc_type': 'mg', 'ksp_type': 'cg'}"


@pytest.mark.parametrize(
    ("ranks", "kind", "method", "number", "keys"),
    [
        (0, "Model", "force", 4, "finite=True"),
        (2, "Model", "force", 4, "finite=True"),
        (2, "Model", "stiffness", 1, "finite=True"),
        (2, "YarnSmoother", "apply", 3, f"finite=True, {MULTIGRID}"),
        (2, "YarnSmoother", "apply", 3, f"finite=False, {MULTIGRID}"),
        (2, "LinearNetwork", "matrix", 1, "finite=False"),
    ],
)
def test_no_memory_on_one_rank(drive, ranks, kind, method, number, keys):
    """PETSc finds none on the last rank, while the others wait for it: one sentence, all end."""
    rank, error = max(ranks - 1, 0), "PETSc.Error(55)"
    fields = {"kind": kind, "method": method, "number": number, "keys": keys}
    result = drive(ranks, NO_MEMORY.format(**fields, rank=rank, error=error))
    assert result.returncode == 2, result.stderr
    # The launcher ends the other rank by SIGTERM, which may have time to say so.
    said = [sentence for sentence in sentences(result) if sentence != "interrupted"]
    assert len(said) == 1, result.stderr
    (sentence,) = said
    assert "there is not enough memory (PETSc error 55): choose a coarser net" in sentence
    assert "Traceback" not in result.stderr


@pytest.mark.parametrize("number", [1, 4])
def test_no_memory_for_numpy(drive, number):
    fields = {"kind": "Model", "method": "force", "number": number, "keys": "finite=True"}
    result = drive(2, NO_MEMORY.format(**fields, rank=1, error="MemoryError"))
    assert result.returncode == 2, result.stderr
    assert sentences(result) == [
        "on rank 1, there is not enough memory: choose a coarser net or a smaller outline"
    ]


# -- PETSc's options -------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("how", "ranks"), [("argument", 2), ("environment", 0), ("a folder", 0), ("not text", 2)]
)
def test_files_of_petsc_options(case, tmp_path, monkeypatch, how, ranks):
    """One that PETSc cannot read: a sentence, before PETSc starts."""
    file, options = tmp_path / "options", ()
    if how == "a folder":
        file.mkdir()
    elif how == "not text":
        file.write_bytes(b"-ksp_view \xff\xfe")
    if how == "environment":
        monkeypatch.setenv("PETSC_OPTIONS", f"-options_file {file}")
    else:
        options = ("-options_file", file)
    result = cruciform_petsc(ranks, "check", case, *options)
    assert result.returncode == 2
    (sentence,) = sentences(result)
    assert sentence.startswith(f'"{file}", the file of PETSc options (-options_file), ')
    assert "PETSC ERROR" not in result.stderr


def test_a_file_that_petsc_could_not_write(case, tmp_path):
    """The log's, which it would open after all the work, and end with 0 all the same."""
    file = tmp_path / "none" / "log.txt"
    result = cruciform_petsc(0, "check", case, "-log_view", f":{file}:ascii_flamegraph")
    assert_refused(result, f'"{file}", the file of the PETSc option -log_view, cannot be written')


@pytest.mark.parametrize(("how", "ranks"), [("argument", 2), ("environment", 0), ("file", 0)])
def test_misspelt_petsc_options(case, tmp_path, monkeypatch, how, ranks):
    """They are named in the log and in the summary, wherever they came from."""
    options = ["--set", "output.pictures=false", "--output", tmp_path / "out"]
    slip = "-cruciform_ksp_rtl 1e-3"
    if how == "argument":
        options += slip.split()
    elif how == "environment":
        monkeypatch.setenv("PETSC_OPTIONS", slip)
    else:
        (tmp_path / "options").write_text(slip)
        options += ["-options_file", tmp_path / "options"]
    result = cruciform_petsc(ranks, "run", case, *options)
    assert result.returncode == 0, result.stderr
    told = 'option "-cruciform_ksp_rtl" was not used: did you mean "-cruciform_ksp_rtol"?'
    assert told in result.stdout
    warnings = json.loads((tmp_path / "out" / "summary.json").read_text())["warnings"]
    assert sum(told in warning for warning in warnings) == 1


@pytest.mark.parametrize(("finite", "ranks"), [("true", 2), ("false", 0)])
def test_factor_package_that_is_not_there(case, tmp_path, finite, ranks):
    """Not: no equilibrium, yarn bending may help."""
    options = ["--set", f"test.finite={finite}", "--output", tmp_path / "out"]
    slip = ("-cruciform_pc_factor_mat_solver_type", "mump")
    result = cruciform_petsc(ranks, "run", case, *options, *slip)
    assert result.returncode == 2
    (sentence,) = sentences(result)
    assert "does not have a factorisation that the options -cruciform_... name" in sentence
    assert "bending" not in sentence


def test_collective_loading(tmp_path, case):
    """Every rank gets the same case, and the same error; so do errors that are no InputError."""
    script = tmp_path / "collective.py"
    script.write_text(
        "import sys\n"
        "from mpi4py import MPI\n"
        "from cruciform_petsc import Case\n"
        "from cruciform_petsc.parallel import on_root\n"
        "comm = MPI.COMM_WORLD\n"
        "case = Case.load_collective(comm, sys.argv[1], ['preform.refine=3'])\n"
        "assert comm.allgather(case) == [case] * comm.size and case.preform().refine == 3\n"
        "try:\n"
        "    Case.load_collective(comm, sys.argv[1], ['preform.refine=0'])\n"
        "except Exception as error:\n"
        "    told = (type(error).__name__, str(error))\n"
        "assert comm.allgather(told) == [told] * comm.size and told[0] == 'InputError', told\n"
        "assert told[1].startswith('preform.refine must be'), told\n"
        "try:\n"
        "    on_root(comm, lambda: 1 / 0)\n"
        "except Exception as error:\n"
        "    kind = type(error).__name__\n"
        "    assert kind == ('RuntimeError' if comm.rank else 'ZeroDivisionError'), kind\n"
        "print('good\\n', end='')\n"
    )
    result = launch(3, script, case)
    assert result.returncode == 0, result.stderr
    assert result.stdout.count("good") == 3


# -- which argument is whose -------------------------------------------------------------------


@pytest.mark.parametrize(
    ("line", "own", "petsc"),
    [
        ("run c --set a.b=1 -ksp_type cg", "run c --set a.b=1", "-ksp_type cg"),
        ("run c -ksp_view --quiet", "run c --quiet", "-ksp_view"),
        ("run --output -x c -y -1e-3 -z", "run --output -x c", "-y -1e-3 -z"),
        ("run c --set=a.b=-1 -options_left -help", "run c --set=a.b=-1", "-options_left -help"),
        ("run c -log_view :log.txt --output d", "run c --output d", "-log_view :log.txt"),
        ("fabrics", "fabrics", ""),
    ],
)
def test_split_arguments(line, own, petsc):
    """Ours have two dashes, PETSc's one, and PETSc's take at most one value."""
    assert split_arguments(line.split()) == (own.split(), petsc.split())


@pytest.mark.parametrize(
    ("line", "message"),
    [
        ("run c -output d", 'there is no option "-output", did you mean "--output"?'),
        ("run c -o d", 'there is no option "-o", did you mean "--output"?'),
        ("run c --Quiet", 'there is no option "--Quiet", did you mean "--quiet"?'),
        ("run c --sett a=1", 'there is no option "--sett", did you mean "--set"?'),
        ("run c --verbos", 'there is no option "--verbos", did you mean "--verbose"?'),
        (
            "run c --ksp_type cg",
            'there is no option "--ksp_type" (known: --set, --from-step, --output, --by, --vary, '
            "--jobs, --ranks, --data, --columns, "
            "--also, --also-data, --weights, --hold-out, --hold-out-data, --angle, --poisson, "
            "--quiet, --verbose, --help, --version; PETSc options begin with one dash)",
        ),
        (
            "run c -ksp_rtol=1e-3",
            'the PETSc option "-ksp_rtol=1e-3" must be written with a space for "="',
        ),
        ("run -ksp_view c", 'the PETSc option "-ksp_view" must come after run CASE'),
    ],
)
def test_slips_in_options(line, message):
    """Slips are told rather than handed to PETSc, where nobody would read them."""
    with pytest.raises(InputError) as caught:
        split_arguments(line.split())
    assert str(caught.value) == message


# -- a test that ends early ------------------------------------------------------------------------


def test_impossible_extension(case, tmp_path):
    """One sentence that says where it ended, exit code 2, and what was reached on disk."""
    given = {"finite": "true", "extension": '["-2 mm", "-40 mm"]'}
    options = [word for key, value in given.items() for word in ("--set", f"test.{key}={value}")]
    options += ["--set", "output.pictures=false", "--output", tmp_path / "out"]
    result = cruciform_petsc(2, "run", case, *options)
    assert result.returncode == 2, result.stderr
    (sentence,) = sentences(result)
    assert re.match(
        r"bias-extension: no equilibrium beyond the last one found, at extension -\d.* mm, load "
        r"-\d.* N .*; forces are farthest from balance at x = .* mm, y = .* mm\. ",
        sentence,
    )
    assert "Traceback" not in result.stderr
    summary = json.loads((tmp_path / "out" / "summary.json").read_text())
    assert summary["ended_early"] == sentence
    assert summary["extension_m"][0] == -2e-3
    rows = (tmp_path / "out" / "curve.csv").read_text().splitlines()
    assert len(rows) == 1 + len(summary["increments"])
    for name in ("curve.csv", "network.vtkhdf"):
        assert (tmp_path / "out" / name).stat().st_size > 40
