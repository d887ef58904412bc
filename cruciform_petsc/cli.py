# SPDX-License-Identifier: MIT
"""The command line: `cruciform-petsc COMMAND ...`; `--help` lists the commands.

Of the package only errors and the names of kinds are imported here: what imports MPI or PETSc waits
until `petsc4py.init` has had the PETSc options.
"""

from __future__ import annotations

import argparse
import contextlib
import io
import json
import logging
import os
import re
import signal
import sys
import time
import traceback
import warnings
from collections.abc import Callable, Mapping, Sequence
from difflib import get_close_matches
from functools import partial
from inspect import cleandoc
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING, Any, NoReturn

from . import __version__, process
from .errors import (
    CruciformError,
    InputError,
    InputWarning,
    cut,
    harmless,
    typed_before,
    unknown,
)
from .experiments.registry import KINDS

if TYPE_CHECKING:
    from mpi4py import MPI

    from .case.schema import Case

PROGRAM = "cruciform-petsc"

# Options of ours that take a value: what it is called, and what it does.
_WITH_VALUE = {
    "--set": ("KEY=VALUE", "replace a value of the case: --set preform.refine=4"),
    "--from-step": ("N", "go on from the N-th step instead of the last; those after it are lost"),
    "--output": ("DIR", "the folder for results, whatever a case says"),
    "--by": ("WHAT", "displacement, strain (load per width) or shear (normalised shear force)"),
    "--vary": (
        "KEY=VALUES",
        "a key of the case and its values: 30:60:5deg, or 30deg,45deg; once for each such key",
    ),
    "--jobs": ("N", "runs side by side; by default as many as there are cores for"),
    "--ranks": ("N", "processes of each run, by default 1"),
    "--data": ("FILE", "the measured curve: CSV of displacement and force, units in the header"),
    "--columns": (
        "TITLE,TITLE",
        "columns of measured data where units leave a choice, by titles or numbers; once for all "
        "files, or once for each",
    ),
    "--also": ("CASE", "a further specimen that the law shall follow, too; may be repeated"),
    "--also-data": ("FILE", "the measured curve of that specimen"),
    "--weights": ("W,W,...", "of the curves, the first one's first: 1,0.5"),
    "--hold-out": ("CASE", "a specimen of the same cloth, whose curve the law found shall predict"),
    "--hold-out-data": ("FILE", "the measured curve of that specimen"),
    "--angle": ("ANGLE", "from pull to warp of the third strip, by default 45deg"),
    "--poisson": ("NU", "Poisson's ratio of a pull along the warp, by default 0"),
}
_REPEATED = ("--set", "--vary", "--columns", "--also", "--also-data")
_OF_CALIBRATION = (
    *("--data", "--set", "--output", "--columns", "--also", "--also-data", "--weights"),
    *("--hold-out", "--hold-out-data"),
)
_OPTIONS = (*_WITH_VALUE, "--quiet", "--verbose", "--help", "--version", "-h")
_PETSC_TOO = ("-help", "-version")  # like ours, but with one dash they are PETSc's

# How long a rank that stopped with a sentence waits for the others to stop with it.
_PATIENCE = 5.0


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command line and return the exit code. Collective over COMM_WORLD.

    0: done; 2: the user's doing, told in one sentence on stderr; 1: a fault of the program, told
    with a traceback; 130, 143 ...: ended by a signal (128 and its number). ``argv`` is what stands
    behind the program's name.
    """
    with process.standard_streams(), process.obeying_signals(to_the_end=argv is None):
        arguments = sys.argv[1:] if argv is None else list(argv)
        hints: list[Callable[[], str]] = []  # how to go on after an interrupt
        try:
            process.prepare_surroundings()
            from mpi4py import MPI

            process.take_signals()  # UCX, below MPI, has a use of its own for SIGHUP
            comm = MPI.COMM_WORLD

            def hint() -> str:
                return hints[-1]() if hints else ""

            return guarded(comm, lambda: _do(comm, arguments, hints), hint)
        except KeyboardInterrupt:
            return _interrupted(None, str)
        except CruciformError as error:
            _say(error)
            return 2


def guarded(comm: MPI.Intracomm, work: Callable[[], None], hint: Callable[[], str]) -> int:
    """Do collective work and turn what it raises into one message and an exit code.

    However the ranks fail, none is left waiting for another:

    - All raise a CruciformError, or some do and the others finish: the lowest that raised prints
      the sentence, all return 2.
    - Some raise a CruciformError while others wait for them: after a few seconds one prints the
      sentence and aborts all with 2.
    - An interrupt on any rank: a sentence, all aborted with 128 and the number of the signal.
    - Too little memory, or another error of PETSc's that can be told: the same, at once.
    - Any other exception on any rank: traceback, all aborted with 1.

    ``hint`` tells, on one rank, how to go on after an interrupt.
    """
    control = None
    try:
        control = comm.Dup()  # agreement must not mix with messages of the work
        failure: CruciformError | None = None
        try:
            work()
            process.check_output()
            if process.came:  # an interrupt that got lost on its way
                raise KeyboardInterrupt
        except CruciformError as error:
            if process.came:  # an interrupt that was taken for something else
                return _interrupted(control, hint)
            failure = error
        return _agree(control, failure)
    except KeyboardInterrupt:
        return _interrupted(control, hint)
    except SystemExit:
        raise
    except BaseException as error:  # pydantic's Rust panics with what is no Exception
        if process.came:  # an interrupt on its way through PETSc, or Rust
            return _interrupted(control, hint)
        told = _in_words(error)
        if told:
            _say(f"on rank {comm.rank}, {told}")
            return _abort(control, 2)
        text = f"{PROGRAM}: internal error on rank {comm.rank}\n{traceback.format_exc()}"
        print(harmless(text), file=sys.stderr, flush=True)
        return _abort(control, 1)


def _in_words(error: BaseException) -> object:
    """What is told of an error that is no fault of the program, though it has not been foreseen."""
    if isinstance(error, MemoryError):
        return "there is not enough memory: choose a coarser net or a smaller outline"
    if type(error).__module__ == "petsc4py.PETSc":
        from .solvers.failures import in_words

        return in_words(error, "cruciform_")  # type: ignore[arg-type]
    return None


def _interrupted(control: MPI.Intracomm | None, hint: Callable[[], str]) -> int:
    """Say how to go on, and end all ranks."""
    process.ignore_signals()
    number = process.came[0] if process.came else signal.SIGINT
    if control is not None and control.rank:
        time.sleep(0.5)  # rank 0 speaks if it is interrupted, too, and takes the others along
    _say("; ".join(filter(None, ("interrupted", hint()))))
    return _abort(control, 128 + number)


def _agree(control: MPI.Intracomm, failure: CruciformError | None) -> int:
    """Find out with the other ranks whether any failed, let one tell it, return the code."""
    import numpy as np
    from mpi4py import MPI

    rank, size = control.rank, control.size
    failed, first = np.array([size if failure is None else rank]), np.empty(1, int)
    request = control.Iallreduce(failed, first, MPI.MIN)
    if failure is None:
        request.Wait()
    else:
        # Ranks wait a little longer each, so that one speaks and takes the others with it.
        deadline = time.monotonic() + _PATIENCE + min(0.2 * rank, _PATIENCE)
        while not request.Test():
            if time.monotonic() > deadline:
                _say(failure)
                return _abort(control, 2)
            time.sleep(0.01)
        if first[0] == rank:
            _say(failure)
    control.Barrier()  # the sentence is out before any rank ends
    control.Free()
    return 2 if first[0] < size else 0


def _say(failure: CruciformError | str) -> None:
    sys.stdout.flush()
    problems = failure.args if isinstance(failure, InputError) else [failure]
    text = "\n  ".join(harmless(" ".join(str(problem).split())) for problem in problems)
    # In one piece with its end of line: a launcher puts its own words between two.
    print(f"{PROGRAM}: {text}\n", end="", file=sys.stderr, flush=True)


def _abort(control: MPI.Intracomm | None, code: int) -> int:
    """End all ranks; a single one simply returns."""
    sys.stdout.flush()
    sys.stderr.flush()
    if control is not None and control.size > 1:
        control.Abort(code)
    return code


def _do(comm: MPI.Intracomm, arguments: Sequence[str], hints: list[Callable[[], str]]) -> None:
    """Do what was typed; puts how to go on after an interrupt into ``hints``, once one can."""
    from .parallel import on_root

    own, petsc_options = split_arguments(arguments)
    try:
        with contextlib.redirect_stdout(io.StringIO() if comm.rank else sys.stdout):
            args = _parser().parse_args(own)
    except SystemExit:  # --help and --version; wrong arguments are InputErrors
        return
    args.log = _logger(comm, args)
    warnings.simplefilter("ignore", InputWarning)  # the log tells
    args.hints, args.petsc_options = hints, petsc_options
    cache = on_root(comm, process.spare_cache)
    if cache:
        os.environ["XDG_CACHE_HOME"] = os.environ["MPLCONFIGDIR"] = cache
    _start_petsc(comm, petsc_options)
    args.work(comm, args)


def _run(comm: MPI.Intracomm, args: argparse.Namespace) -> None:
    """Solve a case and write results.

    Example: mpirun -n 2 cruciform-petsc run demos/picture_frame.toml --set preform.refine=2
    """
    from .output.checkpoint import hint

    case, directory = _case_and_folder(comm, args)
    args.hints.append(partial(hint, directory, comm.size))
    from .run import run_case

    run_case(comm, case, directory, args.log)


def _resume(comm: MPI.Intracomm, args: argparse.Namespace) -> None:
    """Go on with a run that was interrupted, on as many ranks as you like.

    Example: cruciform-petsc resume results/picture_frame
    """
    from .output.checkpoint import hint, reopen
    from .output.folder import prepare_directory
    from .run import run_case

    if args.from_step is not None and not re.fullmatch(r"[1-9]\d{0,8}", args.from_step):
        raise InputError(
            f'--from-step must be the number of a step, from 1, got "{args.from_step}"'
        )
    step = None if args.from_step is None else int(args.from_step)
    checkpoint = reopen(comm, args.case, args.set, args.output, step)
    directory = prepare_directory(comm, checkpoint.directory)
    args.hints.append(partial(hint, directory, comm.size))
    run_case(comm, checkpoint.case, directory, args.log, checkpoint)


def _check(comm: MPI.Intracomm, args: argparse.Namespace) -> None:
    """Read a case and report sizes, solve nothing.

    Example: cruciform-petsc check demos/picture_frame.toml
    """
    case = _load(comm, args.case, args.set)
    from .run import check_case

    check_case(comm, case, args.log)


def _sweep(comm: MPI.Intracomm, args: argparse.Namespace) -> None:
    """Run a case for several values of its keys, side by side.

    A range is start:stop:step, a list has commas; of several keys all combinations are run. Results
    are in sweep.csv and sweep.png, and in a folder for each run. The same command goes on where it
    was stopped.

    Example: cruciform-petsc sweep demos/bias_extension.toml --vary preform.bias_angle=30:60:5deg
    """
    from .sweep import read_vary, run_sweep

    if comm.size > 1:
        raise InputError("sweep starts its runs itself: leave mpirun out, and give --ranks N")
    more: dict[str, Any] = {"overrides": args.set, "petsc_options": args.petsc_options}
    for name in ("jobs", "ranks"):
        text = getattr(args, name)
        if text is not None:
            if not re.fullmatch(r"0*[1-9]\d{0,4}", text):
                raise InputError(f'--{name} must be a whole number from 1 up, got "{text}"')
            more[name] = int(text)
    vary = {one.key: one.values for one in read_vary(args.vary)}
    args.hints.append(lambda: "finished runs are kept, the same command goes on")
    table = run_sweep(args.case, vary, args.output, log=args.log, **more)
    bad = [i for i, status in enumerate(table["status"]) if status != "done"]
    if bad:
        first = f'{table["status"][bad[0]]} in "{table["folder"][bad[0]]}"'
        raise InputError(
            f"{len(bad)} of {len(table['status'])} runs did not come to their end, sweep.csv tells "
            f"why of each; the first of them {first}: {table['message'][bad[0]]}"
        )


def _calibrate(comm: MPI.Intracomm, args: argparse.Namespace) -> None:
    """Find the shear law of a case's fabric from a load curve, or its crimp from biaxial data.

    Example: cruciform-petsc calibrate demos/calibrate_glass_pp.toml --data demos/glass_pp_bias.csv
    """
    if (args.hold_out is None) != (args.hold_out_data is None):
        pair = "--hold-out CASE and --hold-out-data FILE"
        raise InputError(f"{pair} belong together, give both or neither")
    if len(args.also) != len(args.also_data):
        raise InputError("each --also CASE needs an --also-data FILE, in the same order")
    more: dict[str, Any] = {"columns": args.columns} if args.columns else {}
    if args.hold_out is not None:
        more["hold_out"] = (_load(comm, args.hold_out, args.set), args.hold_out_data)
    if args.also:
        cases = [_load(comm, path, args.set) for path in args.also]
        more["also"] = list(zip(cases, args.also_data, strict=True))
    if args.weights is not None:
        try:
            more["weights"] = [float(weight) for weight in args.weights.split(",")]
        except ValueError:
            text = f'--weights must be numbers like 1,0.5, got "{args.weights}"'
            raise InputError(text) from None
    case, directory = _case_and_folder(comm, args)
    from .calibrate import calibrate_case
    from .output.folder import LOG, OF_CALIBRATION, locked
    from .output.log import kept

    names, law = (*OF_CALIBRATION, LOG), directory / "law.toml"
    begun = time.time()

    def hint() -> str:
        kept = law.exists() and law.stat().st_mtime >= begun
        return f'the law of the last step is kept in "{law}"' if kept else ""

    args.hints.append(hint)
    with locked(comm, directory, names, args.log), kept(comm, directory, args.log) as keep_log:
        calibrate_case(comm, case, args.data, directory, args.log, **more)
        keep_log()


def _compare(comm: MPI.Intracomm, args: argparse.Namespace) -> None:
    """Results and measured curves over each other: curves and differences.

    A, B ... are folders of results, or CSV files of a measured displacement and force. Their curves
    are laid over each other in the folder of --output, by default "comparison".

    Example: cruciform-petsc compare results/finite_bias_extension demos/glass_pp_bias.csv
    """
    from .compare import compare_command

    folder = "comparison" if args.output is None else args.output
    paths = [args.a, args.b, *args.more]
    compare_command(comm, paths, folder, args.log, args.columns, args.by)


def _kilby(comm: MPI.Intracomm, args: argparse.Namespace) -> None:
    """Moduli at every angle, and the shear modulus, from those of three strips.

    Each strip is a modulus, or the folder of an off-axis-tension test with free ends. Files are
    written with --output only.

    Example: cruciform-petsc kilby "520 N/cm" "520 N/cm" "3.8 N/cm" --output results/kilby
    """
    from .moduli import kilby_command

    kilby_command(
        comm,
        (args.warp, args.weft, args.between),
        args.log,
        angle=args.angle,
        poisson=args.poisson,
        directory=args.output,
    )


def _new(comm: MPI.Intracomm, args: argparse.Namespace) -> None:
    """Write a commented case file to begin with.

    Without FILE it goes onto the screen.

    Example: cruciform-petsc new picture-frame my_frame.toml
    """
    from .case.template import new_case, write_new_case
    from .parallel import on_root

    if args.file is None:
        text = new_case(args.kind).rstrip()
    else:
        on_root(comm, lambda: write_new_case(args.kind, args.file))
        text = f'wrote "{args.file}"; try: {typed_before()}{PROGRAM} check {args.file}'
    if comm.rank == 0:
        print(harmless(text))


def _schema(comm: MPI.Intracomm, args: argparse.Namespace) -> None:
    """Print the JSON schema of case files, for editors, or of summary.json.

    An editor that knows TOML (taplo, Even Better TOML) takes it from the first line of a case file,
    "#:schema case.schema.json", and completes keys and tells what they mean.

    Example: cruciform-petsc schema > case.schema.json
    """
    from .case.schema import Case
    from .output.summary_keys import Summary

    known = {"case": Case.json_schema, "summary": Summary.json_schema}
    if args.what not in known:
        raise unknown(f'schema of "{cut(args.what)}"', args.what, known)
    if comm.rank == 0:
        print(json.dumps(known[args.what](), indent=1, ensure_ascii=False))


_COMPLETION = """\
# Of {program} {version}; into ~/.bashrc: eval "$({program} completion)"
# zsh wants this before: autoload -U +X bashcompinit && bashcompinit
_cruciform_petsc() {{
    local word=${{COMP_WORDS[COMP_CWORD]}} before=${{COMP_WORDS[COMP_CWORD-1]}} words=
    if [ "$COMP_CWORD" = 1 ]; then
        words="{commands}"
    elif [ "$before" = --set ] || [ "$before" = --vary ]; then
        words="{keys}"
        compopt -o nospace 2> /dev/null
    elif [ "$before" = --by ]; then
        words="{ways}"
    elif [ "$before" = new ]; then
        words="{kinds}"
    else
        case ${{COMP_WORDS[1]}}:$word in
{options}
        esac
    fi
    COMPREPLY=($(compgen -W "$words" -- "$word"))
}}
complete -o bashdefault -o default -F _cruciform_petsc {program}"""


def _completion(comm: MPI.Intracomm, args: argparse.Namespace) -> None:
    """Print what makes bash complete commands, options and keys.

    For zsh, too, after: autoload -U +X bashcompinit && bashcompinit

    Example: eval "$(cruciform-petsc completion)"
    """
    from .case.schema import Case
    from .compare import BY

    if comm.rank:
        return
    parsers: Mapping[str, argparse.ArgumentParser] = _parser().commands.choices
    options = []
    for name, parser in parsers.items():
        words = (word for action in parser._actions for word in action.option_strings)
        options.append(f'            {name}:-*) words="{" ".join(words)}" ;;')
    print(
        _COMPLETION.format(
            program=PROGRAM,
            version=__version__,
            commands=" ".join(parsers),
            keys=" ".join(f"{key}=" for key in Case.paths()),
            ways=" ".join(BY),
            kinds=" ".join(KINDS),
            options="\n".join(options),
        )
    )


def _fabrics(comm: MPI.Intracomm, args: argparse.Namespace) -> None:
    """List the library of fabrics, or tell all of one.

    With NAME: what was published of this fabric, what is estimated or assumed, and its source.

    Example: cruciform-petsc fabrics carbon-twill-3k-284
    """
    from .cloth.fabric import Fabric, FabricTable, fabric_names, library
    from .units import format_si

    def short(value: float, unit: str) -> str:
        return format_si(float(f"{value:.4g}"), unit)

    names = fabric_names() if args.name is None else [args.name]
    fabrics = [Fabric.from_library(name) for name in names]
    if comm.rank:
        return
    rows = [
        ["fabric", "weave", "modulus", "Poisson", "yarns", "yarn bending", "out of plane", "shear",
         "mass", "thickness", "source"]
    ]  # fmt: skip
    for fabric in fabrics:
        columns = [
            [
                short(yarns.modulus, "N/m"),
                f"{yarns.poisson:g}",
                short(yarns.yarns, "1/m"),
                short(yarns.yarn_bending, "N*m**2"),
                short(law.stiffness0, "N*m"),
            ]
            for yarns, law in zip(
                (fabric.warp, fabric.weft), fabric.out_of_plane("this list"), strict=True
            )
        ]
        # Warp and weft apart where they differ.
        both = [a if a == b else f"{a} | {b}" for a, b in zip(*columns, strict=True)]
        shear = short(fabric.shear_modulus, "N/m")
        if fabric.shear.name != "linear":
            shear += f" at rest, {fabric.shear.name}"
        mass = short(fabric.areal_density, "kg/m**2") if fabric.areal_density else ""
        thickness = short(fabric.thickness, "m") if fabric.thickness else ""
        rows.append([fabric.name, fabric.weave, *both, shear, mass, thickness, fabric.source])
    if args.name is not None:
        told = [*zip(*rows, strict=True), ("notes", " ".join(library()[args.name].notes.split()))]
        for what, text in told:
            print(f"{what:<14}{text}")
        for sentence in FabricTable(use=args.name).filled_in():
            print(f"              {sentence}")
        return
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    for row in rows:
        print("  ".join(map(str.ljust, row, widths)).rstrip())


def _load(comm: MPI.Intracomm, path: str, overrides: Sequence[str] = ()) -> Case:
    from .case.schema import Case

    return Case.load_collective(comm, path, overrides)


def _case_and_folder(comm: MPI.Intracomm, args: argparse.Namespace) -> tuple[Case, Path]:
    """Read the case and make the folder of its results. Collective."""
    from .output.folder import prepare_directory

    case = _load(comm, args.case, args.set)
    if args.output is not None:
        prepare_directory(comm, args.output)
        told = dict(iter(case.output)) | {"directory": args.output}
        case = case.model_copy(update={"output": case.output.from_data(told, "output")})
    return case, prepare_directory(comm, case.output.directory)


def _start_petsc(comm: MPI.Intracomm, options: list[str]) -> None:
    """Start PETSc with options from the command line. Collective."""
    from .parallel import on_root

    words = [*os.environ.get("PETSC_OPTIONS", "").split(), *options]
    for name, file in pairwise([*words, ""]):
        if name in ("-options_file", "-options_file_yaml"):
            on_root(comm, partial(_check_options_file, file))
        elif viewer := re.match(r"(?:ascii|binary|hdf5)?:([^:]+)", file):
            on_root(comm, partial(_check_viewer_file, name, viewer[1]))
    started = "petsc4py.PETSc" in sys.modules  # by a script that calls main(); init is then void
    import petsc4py

    # Without its handlers of signals, which end all in words of its own.
    petsc4py.init([sys.argv[0], "-no_signal_handler", *options])
    if started and options:
        from petsc4py import PETSc

        PETSc.Options().insertString(" ".join(options))  # type: ignore[attr-defined]


def _check_options_file(path: str) -> None:
    """Refuse what PETSc would open on rank 0 only, and fail on the others or not at all."""
    problem = "" if Path(path).is_file() else "is not there, or is no file"
    if not problem:
        try:
            Path(path).read_text(encoding="utf-8")
        except (OSError, ValueError) as error:
            problem = f"cannot be read: {error}"
    if problem:
        raise InputError(f'"{path}", the file of PETSc options (-options_file), {problem}')


def _check_viewer_file(name: str, path: str) -> None:
    """Refuse a file that PETSc could not write at the end, after all the work."""
    folder = Path(path).parent
    if not folder.is_dir() or not os.access(folder, os.W_OK) or Path(path).is_dir():
        raise InputError(f'"{path}", the file of the PETSc option {name}, cannot be written')


def split_arguments(arguments: Sequence[str]) -> tuple[list[str], list[str]]:
    """Part arguments as typed into our own and PETSc's, which have one dash and follow CASE.

    Raises InputError for an option of neither, with the closest of ours, and for a PETSc option
    out of place.
    """
    own: list[str] = []
    petsc: list[str] = []
    words, rest = 0, list(arguments)  # words: command and CASE
    while rest:
        argument = rest.pop(0)
        name = argument.partition("=")[0]
        if name in _OPTIONS:
            own.append(argument)
            if argument in _WITH_VALUE and rest:
                own.append(rest.pop(0))
        elif not _is_option(argument):
            own.append(argument)
            words += 1
        else:
            _check_petsc_option(argument, name)
            if words < 2:
                raise InputError(f'the PETSc option "{argument}" must come after run CASE')
            petsc.append(argument)
            if rest and not _is_option(rest[0]):
                petsc.append(rest.pop(0))
    return own, petsc


def _is_option(argument: str) -> bool:
    return re.match(r"--?[A-Za-z]", argument) is not None  # "-1e-3" is a number


def _check_petsc_option(argument: str, name: str) -> None:
    """Refuse what is more likely a slip in one of our options than an option of PETSc."""
    meant = "--" + name.lstrip("-").lower()
    close = [ours for ours in _OPTIONS if ours.startswith(meant)]
    if len(meant) > len("--b"):  # a letter is no slip in a word
        close += get_close_matches(meant, _OPTIONS, 1, 0.75)
    if close and name not in _PETSC_TOO:
        raise InputError(f'there is no option "{name}", did you mean "{close[0]}"?')
    if name.startswith("--"):
        known = f"known: {', '.join(_OPTIONS[:-1])}; PETSc options begin with one dash"
        raise InputError(f'there is no option "{name}" ({known})')
    if "=" in argument:
        raise InputError(f'the PETSc option "{argument}" must be written with a space for "="')


class _Parser(argparse.ArgumentParser):
    """A parser whose complaints go the way of all input errors."""

    commands: Any  # the parsers of our commands

    def error(self, message: str) -> NoReturn:
        raise InputError(message)


def _parser() -> _Parser:
    parser = _Parser(
        prog=PROGRAM,
        description="Parallel mechanics of woven fabrics as nets of cruciform elements.",
        allow_abbrev=False,
    )
    parser.add_argument("--version", action="version", version=f"{PROGRAM} {__version__}")
    commands = parser.add_subparsers(dest="command", required=True, metavar="COMMAND")
    parser.commands = commands

    def command(
        work: Callable[[MPI.Intracomm, argparse.Namespace], None],
        *arguments: tuple[str, str],
        options: Sequence[str] = (),
    ) -> None:
        """Add a command by its function, whose docstring ends with an example; arguments likewise.

        Of each argument: what it is called, and what it does.
        """
        description, _, example = cleandoc(work.__doc__ or "").rpartition("\n\n")
        if "--set" in options:
            example += "\nOptions with one dash after CASE go to PETSc: "
            example += "-cruciform_ksp_monitor, -log_view ..."
        what = description.partition("\n")[0].rstrip(".")
        sub = commands.add_parser(
            work.__name__.strip("_"),
            help=what[:1].lower() + what[1:],
            description=description,
            epilog=example,
            formatter_class=argparse.RawDescriptionHelpFormatter,
            allow_abbrev=False,
        )
        sub.set_defaults(work=work)
        for name, text in arguments:
            sub.add_argument(
                name.rpartition("|")[2].strip("[.]").lower(),
                metavar=name.strip("[.]"),
                nargs=("*" if "..." in name else "?") if name.startswith("[") else None,  # type: ignore[arg-type]
                help=text,
            )
        for option in options:
            name, text = _WITH_VALUE[option]
            more: dict[str, Any] = {"required": option == "--data"}
            if option in _REPEATED:
                more |= {"action": "append", "default": []}
            sub.add_argument(option, metavar=name, help=text, **more)
        if options:  # of the others there is nothing to log
            loudness = sub.add_mutually_exclusive_group()
            loudness.add_argument("--quiet", action="store_true", help="log warnings only")
            loudness.add_argument("--verbose", action="store_true", help="log more")

    case = ("CASE", "the case file (TOML)")
    folder = ("DIR|CASE", "the folder of the results, or the case file that tells it")
    a = ("A", "a folder of results, or a measured curve (CSV)")
    b = ("B", "another; differences are relative to the last one")
    more = ("[MORE...]", "further ones")
    kind = ("KIND", f"the kind of test: {', '.join(KINDS)}")
    command(_run, case, options=("--set", "--output"))
    command(_check, case, options=("--set",))
    command(_calibrate, case, options=_OF_CALIBRATION)
    command(_sweep, case, options=("--vary", "--set", "--output", "--jobs", "--ranks"))
    command(_resume, folder, options=("--set", "--output", "--from-step"))
    command(_compare, a, b, more, options=("--by", "--columns", "--output"))
    strips = ("along the warp", "along the weft", "at an angle to both")
    each = zip(("WARP", "WEFT", "BETWEEN"), strips, strict=True)
    command(
        _kilby,
        *(
            (name, f'modulus of a strip {how}, "520 N/cm", or a folder of results')
            for name, how in each
        ),
        options=("--angle", "--poisson", "--output"),
    )
    command(_new, kind, ("[FILE]", "must not be there yet"))
    command(_fabrics, ("[NAME]", "one of them"))
    command(_schema, ("[WHAT]", "case (the default) or summary"))
    commands.choices["schema"].set_defaults(what="case")
    command(_completion)
    return parser


def _logger(comm: MPI.Intracomm, args: argparse.Namespace) -> logging.Logger:
    """Make the log: to stdout on rank 0, silent on the others.

    What --quiet leaves out still goes to the files that results have (output.log.kept).
    """
    log = logging.getLogger("cruciform_petsc")
    log.handlers.clear()
    log.propagate = False
    handler = logging.NullHandler() if comm.rank else logging.StreamHandler(sys.stdout)
    handler.setFormatter(process.LogLines())
    log.addHandler(handler)
    quiet, verbose = getattr(args, "quiet", False), getattr(args, "verbose", False)
    level = logging.WARNING if quiet else logging.DEBUG if verbose else logging.INFO
    handler.setLevel(level)
    log.setLevel(logging.CRITICAL + 1 if comm.rank else min(level, logging.INFO))
    return log
