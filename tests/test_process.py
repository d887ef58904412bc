# SPDX-License-Identifier: MIT
"""The program as a process: signals, terminals, streams that fail, folders that are missing.

mpi4py must not be imported here: this process starts mpirun and is no rank itself.
"""

import contextlib
import csv
import fcntl
import os
import pty
import resource
import select
import signal
import subprocess
import sys
import termios
import time
from pathlib import Path

import pytest
from support.runs import CASE
from test_cli_input import cruciform_petsc, launch, sentences

from cruciform_petsc import cli, process
from cruciform_petsc.errors import InputError

PROGRAM = [sys.executable, "-u", "-m", "cruciform_petsc"]
DEMOS = Path(__file__).parents[1] / "demos"


@pytest.fixture
def case(tmp_path):
    path = tmp_path / "case.toml"
    path.write_text(CASE)
    return path


def kept(out):
    return f"interrupted; what was reached is kept, continue with: cruciform-petsc resume {out}"


def is_clean(text):
    return not any(word in text for word in ("Traceback", "PETSC ERROR", "Exception ignored"))


def increments(out):
    """How many the curve has, which is written after the log's line."""
    if not (out / "curve.csv").exists():
        return 0
    with (out / "curve.csv").open() as file:
        return len(list(csv.DictReader(file)))


# -- signals ---------------------------------------------------------------------------------------


@pytest.fixture
def handled():
    """Handlers are put back."""
    before = {number: signal.getsignal(number) for number in process.ENDING}
    yield
    for number, handler in before.items():
        signal.signal(number, handler)


@pytest.mark.parametrize("number", process.ENDING)
def test_each_signal_interrupts(handled, number):
    """And what was there before is there again."""
    before = signal.getsignal(number)
    with pytest.raises(KeyboardInterrupt), process.obeying_signals():
        signal.raise_signal(number)
    assert process.came == [number]
    assert signal.getsignal(number) is before
    assert signal.getitimer(signal.ITIMER_REAL) == (0.0, 0.0)


def test_what_is_ignored_stays_ignored(handled):
    """As nohup has it."""
    signal.signal(signal.SIGHUP, signal.SIG_IGN)
    with process.obeying_signals():
        process.take_signals()
        signal.raise_signal(signal.SIGHUP)
    assert process.came == []
    assert signal.getsignal(signal.SIGHUP) is signal.SIG_IGN


class Swallows:
    """Python ignores what is raised while it frees something."""

    def __del__(self):
        signal.raise_signal(signal.SIGTERM)


@pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning")
def test_a_swallowed_signal_comes_again(handled, monkeypatch):
    monkeypatch.setattr(process, "AGAIN", 0.05)

    def work():
        Swallows()
        time.sleep(5.0)

    with pytest.raises(KeyboardInterrupt), process.obeying_signals():
        work()
    assert process.came == [signal.SIGTERM]


def test_a_swallowed_signal_is_obeyed_in_the_end(handled, monkeypatch, capfd):
    """It has no time to come again; nothing is told of where it was swallowed."""
    monkeypatch.setattr(cli, "_do", lambda *_: Swallows() and None)
    assert cli.main(["fabrics"]) == 128 + signal.SIGTERM
    assert capfd.readouterr().err == "cruciform-petsc: interrupted\n"


@pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning")
def test_an_impatient_second_one_disturbs_nothing(handled):
    """While the first one rises; it is noted, and the first one counts."""
    cleaned = []

    def work():
        try:
            signal.raise_signal(signal.SIGHUP)
        finally:
            signal.raise_signal(signal.SIGINT)
            cleaned.append(1)

    with pytest.raises(KeyboardInterrupt), process.obeying_signals():
        work()
    assert cleaned
    assert process.came == [signal.SIGHUP, signal.SIGINT]


@pytest.mark.parametrize("number", [signal.SIGHUP, signal.SIGQUIT, signal.SIGUSR1])
def test_hang_up_and_quit_say_how_to_go_on(case, tmp_path, number):
    """As Ctrl-C does; PETSc has handlers of its own for the first two."""
    out = tmp_path / "out"
    run = subprocess.Popen(
        [*PROGRAM, "run", case, "--output", out],
        stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
    )  # fmt: skip
    next(line for line in run.stdout if "Newton" in line)
    run.send_signal(number)
    _, stderr = run.communicate(timeout=60)
    assert run.returncode == 128 + number
    assert stderr == f"cruciform-petsc: {kept(out)}\n"
    assert increments(out) < 40


STRIKE = """
import os, signal, sys
from pkgutil import resolve_name
from mpi4py import MPI
owner, attribute, times = resolve_name({owner!r}), {attribute!r}, {times}
whole, calls = getattr(owner, attribute), []

def struck(*arguments, **options):
    calls.append(0)
    if len(calls) == times and MPI.COMM_WORLD.rank == {rank}:
        os.kill(os.getpid(), signal.{number})
    return whole(*arguments, **options)

setattr(owner, attribute, struck)
from cruciform_petsc.cli import main
sys.exit(main())
"""
CALIBRATE = ("calibrate", DEMOS / "calibrate_glass_pp.toml", "--data", DEMOS / "glass_pp_bias.csv")
CURVE = DEMOS / "glass_pp_bias.csv"
SMALL = ("--set", "test.finite=false")
SMALL_WITH_MEMBRANE = (*SMALL, "--set", "continuum.compare=true")
WHERE = {
    "calibrate": (0, "cruciform_petsc.equilibrium.model:Model", "force", 9, "SIGINT", CALIBRATE),
    "calibrate, one of two": (
        2, "cruciform_petsc.equilibrium.model:Model", "stiffness", 9, "SIGTERM", CALIBRATE,
    ),
    "compare": (
        0, "cruciform_petsc.output.pictures", "save", 1, "SIGINT", ("compare", CURVE, CURVE),
    ),
    "small displacements": (
        0, "cruciform_petsc.solvers.linear:LinearSolver", "_apply", 1, "SIGTERM", ("run", *SMALL),
    ),
    "small displacements, one of two": (
        2, "cruciform_petsc.solvers.linear:LinearSolver", "_apply", 1, "SIGINT", ("run", *SMALL),
    ),
    "membrane": (
        0, "cruciform_petsc.continuum.domain:MembraneDomain", "solve_into", 1, "SIGINT",
        ("run", *SMALL_WITH_MEMBRANE),
    ),
    "results": (0, "cruciform_petsc.output.tables", "write_json", 1, "SIGHUP", ("run",)),
    "results, one of two": (
        2, "cruciform_petsc.output.log", "peak_mib", 1, "SIGINT", ("run",),
    ),
}  # fmt: skip


@pytest.mark.parametrize("what", WHERE)
def test_wherever_it_hits(case, tmp_path, what):
    """On the last rank, within what all commands do: one sentence, all ranks end."""
    ranks, owner, attribute, times, name, command = WHERE[what]
    number, out = signal.Signals[name], tmp_path / "out"
    script = tmp_path / "struck.py"
    values = {"owner": owner, "attribute": attribute, "times": times, "number": name}
    script.write_text(STRIKE.format(rank=max(ranks - 1, 0), **values))
    if command[0] == "run":
        command = ("run", case, "--set", "test.increments=3", *command[1:])
    result = launch(ranks, script, *command, "--output", out, timeout=200.0)
    assert result.returncode == 128 + number, result.stderr
    assert is_clean(result.stderr)
    hint = kept(out)
    if ranks:
        hint = hint.replace("cruciform-petsc resume", "mpirun -n 2 cruciform-petsc resume")
    (said,) = sentences(result)
    assert said == (hint if "results" in what else "interrupted")
    assert not (out / "summary.json").exists()
    assert not (out / "law.toml").exists()
    assert [path.name for path in out.glob("*.part")] == []


def test_after_the_last_word(case, tmp_path):
    """While the process ends: at once and in silence, with the signal's code."""
    script = tmp_path / "late.py"
    script.write_text(
        "import atexit, os, signal, sys, time\n"
        "atexit.register(lambda: (os.kill(os.getpid(), signal.SIGINT), time.sleep(9)))\n"
        "from cruciform_petsc.cli import main\n"
        "sys.exit(main())\n"
    )
    result = launch(0, script, "run", case, "--output", tmp_path / "out")
    assert result.returncode == -signal.SIGINT
    assert result.stderr == ""
    assert "results in" in result.stdout


def test_mpi_takes_no_signal():
    """Not even while it starts, when nothing of ours could take it back."""
    script = (
        "import re\n"
        "from pathlib import Path\n"
        "from cruciform_petsc import process\n"
        "def caught():\n"
        "    status = Path('/proc/self/status').read_text()\n"
        "    mask = int(re.search(r'SigCgt:\\s*(\\w+)', status)[1], 16)\n"
        "    return {n for n in process.ENDING if mask >> (n - 1) & 1}\n"
        "process.prepare_surroundings()\n"
        "before = caught()\n"
        "from mpi4py import MPI\n"
        "assert caught() == before, caught()\n"
    )
    result = launch(0, "-c", script)
    assert result.returncode == 0, result.stderr


# -- terminals -------------------------------------------------------------------------------------


def on_terminal(case, out):
    """Start a run on a terminal of its own; returns it and the other end."""
    ours, its = pty.openpty()
    termios.tcsetwinsize(ours, (40, 120))

    def take():
        fcntl.ioctl(0, termios.TIOCSCTTY, 0)

    run = subprocess.Popen(
        [*PROGRAM, "run", case, "--output", out], stdin=its, stdout=its, stderr=its,
        start_new_session=True, preexec_fn=take,
    )  # fmt: skip
    os.close(its)
    return run, ours


def read_until(ours, words, seconds=60.0):
    """What the terminal shows, until some words are there, or all ends."""
    text, deadline = "", time.monotonic() + seconds
    while words not in text and time.monotonic() < deadline:
        if select.select([ours], [], [], 0.1)[0]:
            with contextlib.suppress(OSError):
                data = os.read(ours, 65536)
                text += data.decode(errors="replace")
                continue
            break
    return text


def test_interrupted_at_a_terminal(case, tmp_path):
    """Ctrl-C while the bar is shown."""
    out = tmp_path / "out"
    run, ours = on_terminal(case, out)
    shown = read_until(ours, "Newton")
    assert "%" in shown
    os.write(ours, b"\x03")
    shown += read_until(ours, "\0")
    os.close(ours)
    assert run.wait(timeout=60) == 130
    assert kept(out) in " ".join(shown.split())
    assert is_clean(shown)
    assert shown.rfind("\x1b[?25h") >= shown.rfind("\x1b[?25l")  # the cursor is back


def test_interrupted_while_the_bar_appears(case, tmp_path):
    """It goes away, and the cursor is back."""
    run, ours = on_terminal(case, tmp_path / "out")
    shown = read_until(ours, "\x1b[?25l")
    os.write(ours, b"\x03")
    shown += read_until(ours, "\0")
    os.close(ours)
    assert run.wait(timeout=60) == 130
    assert is_clean(shown)
    assert shown.rindex("\x1b[?25h") > shown.rindex("\x1b[?25l")
    assert "cruciform-petsc: interrupted" in shown[shown.rindex("\x1b[?25h") :]


def test_the_terminal_is_closed(case, tmp_path):
    """The run ends, its checkpoint is good, and nobody can be told."""
    out = tmp_path / "out"
    run, ours = on_terminal(case, out)
    assert "%" in read_until(ours, "Newton")
    os.close(ours)
    assert run.wait(timeout=60) == 129
    assert (out / "checkpoint" / "newest").exists()
    assert increments(out) < 40


# -- streams ---------------------------------------------------------------------------------------


def test_nobody_reads(case, tmp_path):
    """`| head`: as if it were interrupted."""
    out = tmp_path / "out"
    run = subprocess.Popen(
        [*PROGRAM, "run", case, "--output", out],
        stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
    )  # fmt: skip
    next(line for line in run.stdout if "Newton" in line)
    run.stdout.close()
    stderr = run.stderr.read()
    assert run.wait(timeout=60) == 141
    assert stderr == f"cruciform-petsc: {kept(out)}\n"
    assert increments(out) < 40


def shell(tmp_path, command, **variables):
    """Run a command line in a shell, where `program` is the program."""
    script = f'program() {{ {" ".join(PROGRAM)} "$@"; }}\ncd "{tmp_path}"\n{command}\n'
    return subprocess.run(
        ["bash", "-c", script], env=os.environ | variables, capture_output=True, text=True,
        timeout=100, check=False,
    )  # fmt: skip


LOST = "standard output could not be written: No space left on device; all else is done"


@pytest.mark.parametrize(
    ("command", "code", "said"),
    [
        ("program run case.toml --output out >&-", 0, []),
        ("program run case.toml --output out >/dev/full", 2, [LOST]),
        ("program fabrics >/dev/full", 2, [LOST]),
        ("program --help >/dev/full", 2, [LOST]),
        ("program fabrics <&- >&- 2>&-", 0, []),
        ("program run nothere >&- 2>&-", 2, []),
        ("program run nothere 2>/dev/full", 2, []),
    ],
)
def test_streams_that_are_closed_or_full(case, tmp_path, command, code, said):
    """Nothing crashes; the work is done, and what is lost is told, where it can be."""
    result = shell(tmp_path, command)
    assert result.returncode == code, result.stderr
    assert sentences(result) == said
    assert is_clean(result.stderr)
    if "out" in command.split():
        assert (tmp_path / "out" / "summary.json").exists()


def test_nobody_reads_from_the_start(tmp_path):
    """Not a line of what is printed at the end of the work."""
    read, write = os.pipe()
    os.close(read)
    run = subprocess.Popen([*PROGRAM, "fabrics"], stdout=write, stderr=subprocess.PIPE, text=True)
    os.close(write)
    _, stderr = run.communicate(timeout=60)
    assert run.returncode == 141
    assert is_clean(stderr)


def test_letters_that_a_terminal_does_not_have(case, tmp_path):
    case.write_text('title = "Köper 45°"\n' + CASE)
    command = "program run case.toml --output out --set test.finite=false"
    result = shell(tmp_path, command, PYTHONIOENCODING="ascii")
    assert result.returncode == 0, result.stderr
    assert r"K\xf6per 45\xb0" in result.stdout


# -- surroundings ----------------------------------------------------------------------------------


def test_a_notebook_and_a_missing_folder(case, tmp_path):
    """What a notebook sets for its own pictures; TMPDIR of a job that has ended; no home."""
    command = (
        "program run case.toml --output out --set test.finite=false --set output.pictures=true"
    )
    result = shell(
        tmp_path, command, MPLBACKEND="module://matplotlib_inline.backend_inline",
        TMPDIR="/nothere", HOME="/proc/nothere",
    )  # fmt: skip
    assert result.returncode == 0, result.stderr
    assert is_clean(result.stderr)
    assert (tmp_path / "out" / "report.html").exists()


def test_nowhere_to_put_temporary_files(monkeypatch):
    def nowhere():
        raise FileNotFoundError(2, "No usable temporary directory found in ['/tmp']")

    monkeypatch.setattr(process.tempfile, "gettempdir", nowhere)
    with pytest.raises(InputError, match="No usable .*set TMPDIR to a folder that can be written"):
        process.prepare_surroundings()


def test_a_cache_where_there_is_none(monkeypatch, tmp_path):
    """A folder of its own, that nobody else may write to."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "deep" / "cache"))
    assert process.spare_cache() == ""
    for usual in ("/proc/nothere", str(tmp_path / "file" / "cache")):
        (tmp_path / "file").touch()
        monkeypatch.setenv("XDG_CACHE_HOME", usual)
        spare = process.spare_cache()
        assert os.stat(spare).st_mode & 0o077 == 0
        os.rmdir(spare)


# -- full disks ------------------------------------------------------------------------------------


def test_full_disk_while_pictures_are_drawn(case, tmp_path):
    """All before it is there, nothing half-written is; `resume` does the rest."""
    out = tmp_path / "out"
    result = subprocess.run(
        [*PROGRAM, "run", case, "--output", out, "--set", "output.pictures=true",
         "--set", "output.paraview=false"],
        capture_output=True, text=True, timeout=100, check=False,
        preexec_fn=lambda: resource.setrlimit(resource.RLIMIT_FSIZE, (60_000, -1)),
    )  # fmt: skip
    assert result.returncode == 2
    assert sentences(result) == [
        f'"{out / "yarns.png"}" cannot be written: File too large; '
        f"{kept(out).removeprefix('interrupted; ')}"
    ]
    names = {path.name for path in out.iterdir()}
    assert names == {
        ".cruciform-petsc.json", "checkpoint", "curve.csv", "centre_line.csv", "run.log",
    }  # fmt: skip
    result = cruciform_petsc(0, "resume", out)
    assert result.returncode == 0, result.stderr
    assert (out / "report.html").exists()
