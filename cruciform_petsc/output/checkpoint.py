# SPDX-License-Identifier: MIT
"""Checkpoints of a test at finite deformation: killed at any moment, it goes on from the last one.

In the folder ``checkpoint`` of the results lie the folders

- ``newest`` and ``previous``: after each of the last two accepted increments, what it takes to go
  on: the case, the histories of all increments, and positions of the last three states;
- ``state-N``: positions of the N-th state that was asked for, which the results need.

In each of them ``rank-R.npy`` holds the nodes that rank R owned, as records of a key and named
arrays, and ``manifest.json`` all else, with the SHA-256 of every file and of itself. A folder gets
its name when all this is on the disk and has been read back. A key is a place on a yarn
(`net.lattice`), whatever the ranks are: those that go on read equal shares of the records, and send
them to the ranks that own these places now. No rank ever holds all.
"""

from __future__ import annotations

import hashlib
import io
import json
import math
import os
import re
import shlex
import stat
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import asdict, dataclass
from functools import partial
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import numpy as np
from pydantic import BaseModel, ConfigDict, Field

from .. import __version__
from ..case.schema import Case
from ..equilibrium.stages import Increment
from ..errors import InputError
from ..parallel import ask, find_sorted, on_all, on_root, send_by_rank
from .folder import (
    CHECKPOINT,
    PUT_ASIDE,
    claim,
    foreign,
    lock_directory,
    open_regular,
    prepare_directory,
    read_small,
    unlock_directory,
)

if TYPE_CHECKING:
    from mpi4py import MPI

    from ..equilibrium.follow import Path as StagePath
    from ..net.nodes import Nodes

NEWEST, PREVIOUS, MANIFEST = "newest", "previous", "manifest.json"
FORMAT = 2  # 1: files, of version 0.1.0
PARTS, FILES = r"newest|previous|(state|new)-\d+", r"manifest\.json|rank-\d+\.npy"
ANEW = "begin anew with cruciform-petsc run"


class DamagedError(InputError):
    """A checkpoint is not what was written."""


# -- what a manifest says --------------------------------------------------------------------------

Count = Annotated[int, Field(ge=0)]
Hash = Annotated[str, Field(pattern="^[0-9a-f]{64}$")]


class _Table(BaseModel):
    model_config = ConfigDict(extra="forbid", strict=True)


class _Path(_Table):
    """Where the continuation has got to, but for positions; see `Kept`."""

    target: Count
    allowed: float | None
    load: float


class _Run(_Table):
    """What it takes to go on, but for positions."""

    case: dict[str, Any]
    determines: dict[str, Any]
    increments: list[dict[str, Any]]
    controls: Annotated[list[float], Field(min_length=1, max_length=3)]  # of the positions
    path: _Path
    states: list[Hash]  # of the manifests of states asked for


class _Manifest(_Table):
    """What there is in a folder."""

    program: str
    format: int
    arrays: dict[str, Annotated[list[Annotated[int, Field(ge=1, le=100)]], Field(max_length=3)]]
    rows: Annotated[list[Count], Field(min_length=1)]  # of each rank's file
    hashes: list[Hash]
    run: _Run | None  # not of a state asked for


def _record(shapes: Mapping[str, Sequence[int]]) -> np.dtype:
    """What a file holds of one node."""
    arrays = [(name, "<f8", tuple(shape)) for name, shape in shapes.items()]
    return np.dtype([("key", "<i8"), *arrays])


def _sealed(text: bytes) -> bytes:
    """A JSON object with its checksum in front."""
    return b'{"sha256":"%s",' % hashlib.sha256(text).hexdigest().encode() + text[1:]


def _read_manifest(folder: Path) -> tuple[_Manifest, str]:
    """Read and check it; returns its checksum, too. Not collective."""
    path = folder / MANIFEST
    if folder.parent.is_symlink() or not stat.S_ISDIR(os.lstat(folder).st_mode):
        raise InputError(
            f'"{folder}" is a file or behind a link, which no checkpoint of this version of '
            f"cruciform_petsc ({__version__}) is: resume with the version that wrote it, or move "
            f'"{folder.parent}" away and {ANEW}'
        )
    text = read_small(path)
    body = b"{" + text[len(_sealed(b"{")) :]
    if _sealed(body) != text:
        raise DamagedError(f'"{path}" is damaged: its bytes do not match its checksum')
    try:
        data = json.loads(body)
        program, number = str(data["program"]), int(data["format"])
        if not (_is_bounded(data) and program.isprintable()):
            raise ValueError
    except (ValueError, KeyError, TypeError, OverflowError, RecursionError):
        raise _senseless(folder) from None
    if (program, number) != (__version__, FORMAT):
        raise InputError(
            f'"{folder}" was written by cruciform_petsc {program:.20} in format {number}, and this '
            f"is {__version__}, which reads format {FORMAT}: resume with the version that wrote "
            f"it, or {ANEW}"
        )
    try:
        manifest = _Manifest.model_validate(data)
        if len(manifest.rows) != len(manifest.hashes) or len(manifest.arrays) > 100:
            raise ValueError
    except ValueError:
        raise _senseless(folder) from None
    return manifest, hashlib.sha256(text).hexdigest()


def _is_bounded(value: Any, depth: int = 0) -> bool:
    """Whether nothing in JSON is too deep, not finite, too large a number, or an odd name."""
    if isinstance(value, dict | list):
        inner = value.values() if isinstance(value, dict) else value
        names = all(name.isprintable() for name in value) if isinstance(value, dict) else True
        return names and depth < 100 and all(_is_bounded(item, depth + 1) for item in inner)
    if isinstance(value, float):
        return math.isfinite(value)
    return not isinstance(value, int) or abs(value) < 2**53


def _senseless(folder: Path) -> DamagedError:
    return DamagedError(f'"{folder}" is damaged: its manifest makes no sense')


# -- increments and the way they went --------------------------------------------------------------


@dataclass
class Kept:
    """What a test goes on from; positions are those of local nodes (n_local, dim), ghosts filled.

    Attributes
    ----------
    states : list of (control, positions)
        The last three at most.
    path : dict
        ``target``, the number of the value asked for that is being made for; ``allowed``, the
        largest step (None: the usual one); ``load``, the one reached, N, where loads are asked for.
    asked : list of (control, positions)
        The states asked for that were reached.
    """

    states: list[tuple[float, np.ndarray]]
    path: dict[str, Any]
    asked: list[tuple[float, np.ndarray]]


def _plain(increment: Increment) -> dict[str, Any]:
    return {name: np.asarray(value).tolist() for name, value in asdict(increment).items()}


def _increment(data: dict[str, Any]) -> Increment:
    blank = _plain(Increment(0.0, 0.0, 0.0, {}, 0, 0, 0.0, 0.0, [0.0]))
    if [(k, type(v)) for k, v in data.items()] != [(k, type(v)) for k, v in blank.items()]:
        raise ValueError
    if not all(isinstance(v, float) for v in (*data["energies"].values(), *data["history"])):
        raise ValueError
    return Increment(**data)


def _is_way(case: Case, run: _Run, increments: list[Increment]) -> bool:
    """Whether increments lead through the values asked for to where the path is."""
    values = case.test.values_si
    by_load = case.test.control == "load" != next(iter(case.test.controls))
    before, asked = 0.0, 0
    for increment in increments:
        if asked == len(values):
            return False
        value, control = values[asked], increment.control
        if not (by_load or min(before, value) <= control <= max(before, value)):
            return False
        reached = increment.load if by_load else control
        if increment.asked and abs(reached - value) > 1e-6 * max(map(abs, values)):
            return False
        asked, before = asked + increment.asked, control
    controls = [increment.control for increment in increments]
    largest = max(map(abs, controls), default=math.inf)
    return (
        run.path.target == asked == len(run.states)
        and run.controls[-1] == before
        and (by_load or {0.0, *controls}.issuperset(run.controls))
        and len(set(run.controls)) == len(run.controls)
        and (run.path.allowed is None or run.path.allowed > 1e-12 * largest)
    )


# -- the checkpoint --------------------------------------------------------------------------------


class Checkpoint:
    """The checkpoint of one run. Make it with `begin` or `resume`; all methods are collective.

    Attributes
    ----------
    case : Case
    increments : list of Increment
        Accepted before this run: those found in the files.
    notes : list of str
        What the user should know, in sentences.
    """

    def __init__(self, comm: MPI.Intracomm, directory: str | Path, case: Case):
        self.comm, self.directory, self.case = comm, Path(directory), case
        self.folder = self.directory / CHECKPOINT
        self.increments: list[Increment] = []
        self.notes: list[str] = []
        self._source: tuple[Path, _Manifest, _Run] | None = None  # what to go on from
        self._states: list[str] = []  # checksums of the states asked for
        self._newest_is_good = False

    @classmethod
    def begin(cls, comm: MPI.Intracomm, directory: str | Path, case: Case) -> Checkpoint:
        """Start without a past. A checkpoint that is there is put aside, not thrown away.

        Parameters
        ----------
        comm : mpi4py communicator
        directory : str or Path
            The folder of the results.
        case : Case

        Raises
        ------
        InputError
            On every rank: the folder cannot be made, another run is writing to it, or something
            that is not the program's is in the way.
        """
        checkpoint = cls(comm, directory, case)
        folder, old = checkpoint.folder, checkpoint.directory / PUT_ASIDE

        def prepare() -> list[str]:
            with _telling(f'"{folder}" cannot be made'):
                checkpoint.directory.mkdir(parents=True, exist_ok=True)
                notes = [lock_directory(checkpoint.directory)]
                claim(folder)
                if any((folder / name / MANIFEST).exists() for name in (NEWEST, PREVIOUS)):
                    claim(old)
                    _remove(old)
                    folder.rename(old)
                    notes.append(
                        f'the checkpoint of a run that was not finished is now "{old}" '
                        "(cruciform-petsc resume would have continued it)"
                    )
                _remove(folder)
                folder.mkdir()
            return [note for note in notes if note]

        checkpoint.notes = on_root(comm, prepare)
        return checkpoint

    @classmethod
    def resume(
        cls, comm: MPI.Intracomm, directory: str | Path, case: Case | None = None
    ) -> Checkpoint:
        """Open the newest good checkpoint.

        Parameters
        ----------
        comm : mpi4py communicator
            Its size may differ from that of the run before.
        directory : str or Path
            The folder of the results.
        case : Case, optional
            Must be the one the checkpoint is of, but for its title, ``output``, ``continuum``,
            ``solver`` and ``test.increments``. By default that one.

        Raises
        ------
        InputError
            On every rank: there is none, it is of another case or program, or it is damaged and
            so is the one before it.
        """
        problems: list[str] = []
        for name in (NEWEST, PREVIOUS):
            path = Path(directory) / CHECKPOINT / name
            if not on_root(comm, partial(os.path.lexists, path)):
                continue
            try:
                manifest, _ = _open(comm, path)
                if manifest.run is None:
                    raise _senseless(path)
                checkpoint = cls(comm, directory, case or _case_of(path, manifest.run))
                checkpoint._adopt(path, manifest.run)
                checkpoint._source = path, manifest, manifest.run
            except DamagedError as error:
                problems.append(str(error))
                continue
            if problems:
                checkpoint.notes.append(f"{problems[0]}; going on from the one before it")
            checkpoint._newest_is_good = name == NEWEST
            return checkpoint
        if problems:
            more = ", and so is the one before it" if len(problems) > 1 else ""
            raise InputError(f"{problems[0]}{more}; {ANEW}")
        raise InputError(_nothing_there(Path(directory)))

    def _adopt(self, path: Path, run: _Run) -> None:
        """Take over what a manifest says, if it is of this case."""
        differing = _differences(run.determines, determines(self.case))
        if differing:
            shown = ", ".join(differing[:3]) + (", ..." if len(differing) > 3 else "")
            raise InputError(
                f'"{path}" belongs to another case ({shown} '
                f"differ{'s' if len(differing) == 1 else ''}): resume with the case as it was, or "
                f"{ANEW}"
            )
        try:
            self.increments = [_increment(data) for data in run.increments]
            good = _is_way(self.case, run, self.increments)
        except (KeyError, TypeError, ValueError):
            good = False
        if not good:
            raise _senseless(path)
        self._states = list(run.states)

    # -- reading ----------------------------------------------------------------------------------

    def restore(self, nodes: Nodes) -> Kept:
        """Positions to go on from; those at rest, of which a checkpoint is made, without a past.

        Parameters
        ----------
        nodes : Nodes
            Those whose positions are kept, on the ranks of now.

        Raises
        ------
        InputError
            On every rank: a file is damaged, or is of another network.
        """
        if self._source is None:
            path_at_rest = {"target": 0, "allowed": None, "load": 0.0}
            kept = Kept([(0.0, nodes.rest)], path_at_rest, [])
            self._write(nodes, kept, [])
            return kept
        path, manifest, run = self._source
        positions = self._read(nodes, path, manifest, len(run.controls))
        asked = []
        reached = [increment.control for increment in self.increments if increment.asked]
        for number, (seal, control) in enumerate(zip(self._states, reached, strict=True), 1):
            source = self.folder / f"state-{number}"
            try:
                manifest, found = _open(self.comm, source)
            except DamagedError as error:
                raise InputError(f"{error}; {ANEW}") from None
            if found != seal:
                raise InputError(f'"{source}" is of another run than its neighbours; {ANEW}')
            asked.append((control, self._read(nodes, source, manifest, 1)[0]))
        return Kept([*zip(run.controls, positions, strict=True)], run.path.model_dump(), asked)

    def _read(
        self, nodes: Nodes, folder: Path, manifest: _Manifest, count: int
    ) -> list[np.ndarray]:
        """``count`` positions (n_local, dim) from a folder that has been opened."""
        comm, dim = self.comm, nodes.rest.shape[1]
        n = nodes.num_nodes_global
        if sum(manifest.rows) != n or manifest.arrays.get("positions") != [count, dim]:
            raise InputError(f'"{folder}" is of another network; {ANEW}')
        share = (n * comm.rank // comm.size, n * (comm.rank + 1) // comm.size)
        records = on_all(comm, lambda: _records(folder, manifest, *share))
        own = nodes.node_key[: nodes.num_nodes_owned]
        # Keys meet on ranks that follow from nothing but the key.
        key, x = send_by_rank(
            comm, _meeting(records["key"], comm.size), records["key"], records["positions"]
        )
        order = np.argsort(key)

        def answer(wanted: np.ndarray) -> np.ndarray:
            row = find_sorted(key[order], wanted)
            return np.where(row[:, None, None] < 0, np.nan, x[order][row])

        found = ask(comm, _meeting(own, comm.size), own, answer)
        if not all(comm.allgather(bool(np.isfinite(found).all()))):
            raise InputError(f'"{folder}" is of another network, or holds no numbers; {ANEW}')
        local = np.zeros((count, nodes.num_nodes_local, dim))
        local[:, : len(own)] = found.swapaxes(0, 1)
        return [nodes.halo.forward(x) for x in local]

    # -- writing ----------------------------------------------------------------------------------

    def write(self, nodes: Nodes, path: StagePath, increments: list[Increment]) -> None:
        """Keep what has been reached.

        Parameters
        ----------
        nodes : Nodes
        path : equilibrium.follow.Path
        increments : list of Increment
            All that were accepted, the last of which is where the path has got to.

        Raises
        ------
        InputError
            On every rank: the place cannot be written to. The last good checkpoint is still there.
        """
        asked = sum(bool(increment.asked) for increment in increments)
        if asked > len(self._states):
            self._states.append(self._put(nodes, f"state-{asked}", [path.state.x], None))
        way = {name: getattr(path, name) for name in ("target", "allowed", "load")}
        states = [(state.time, state.x) for state in path.states]
        self._write(nodes, Kept(states, way, []), increments)

    def _write(self, nodes: Nodes, kept: Kept, increments: list[Increment]) -> None:
        run = {
            "case": self.case.model_dump(),
            "determines": determines(self.case),
            "increments": [_plain(increment) for increment in increments],
            "controls": [float(control) for control, _ in kept.states],
            "path": kept.path,
            "states": self._states,
        }
        self._put(nodes, NEWEST, [x for _, x in kept.states], run)
        self._newest_is_good = True

    def _put(self, nodes: Nodes, name: str, positions: list[np.ndarray], run: dict | None) -> str:
        """Write a folder and give it its name; returns the checksum of its manifest."""
        comm = self.comm
        own = nodes.num_nodes_owned
        arrays = {"positions": np.stack([x[:own] for x in positions], axis=1)}
        shapes = {name: array.shape[1:] for name, array in arrays.items()}
        rows = comm.allgather(own)
        records = np.empty(own, _record(shapes))
        for key, array in ({"key": nodes.node_key[:own]} | arrays).items():
            records[key] = array
        data = io.BytesIO()
        np.save(data, records, allow_pickle=False)
        new = self.folder / comm.bcast(f"new-{os.getpid()}")
        problem = f'the checkpoint "{self.folder / name}" cannot be written'

        def start() -> None:
            with _telling(problem):
                lock_directory(self.directory)
                claim(self.folder, adopt=True)
                _remove(new)
                new.mkdir()

        def fill() -> str:
            with _telling(problem):
                return _write_file(new / f"rank-{comm.rank}.npy", data.getvalue())

        def finish() -> str:
            manifest = {
                "program": __version__, "format": FORMAT, "arrays": shapes, "rows": rows,
                "hashes": hashes, "run": run,
            }  # fmt: skip
            text = json.dumps(manifest, separators=(",", ":"))
            with _telling(problem):
                seal = _write_file(new / MANIFEST, _sealed(text.encode()))
                _sync(new)
                if name == NEWEST and self._newest_is_good:
                    _remove(self.folder / PREVIOUS)
                    (self.folder / NEWEST).rename(self.folder / PREVIOUS)
                _remove(self.folder / name)
                new.rename(self.folder / name)
                _sync(self.folder)
            return seal

        try:
            on_root(comm, start)
            hashes = comm.gather(on_all(comm, fill))
            return on_root(comm, finish)
        except InputError as error:
            if comm.rank == 0:
                with suppress(OSError, InputError):
                    _remove(new)
            kept = self.hint()
            raise InputError(f"{error}{'; ' if kept else ''}{kept}") from None

    def hint(self) -> str:
        """How to go on with it, a sentence; "" if it cannot be."""
        return on_root(self.comm, lambda: hint(self.directory, self.comm.size))

    def remove(self) -> None:
        """Remove it, as the results are there. Problems are not worth a word then."""
        if self.comm.rank == 0:
            with suppress(OSError, InputError):
                _remove(self.folder)
            unlock_directory(self.directory)
        self.comm.barrier()


def reopen(
    comm: MPI.Intracomm,
    target: str | Path,
    overrides: Sequence[str] = (),
    output: str | None = None,
) -> Checkpoint:
    """Open what ``cruciform-petsc resume TARGET`` is to go on with. Collective.

    Parameters
    ----------
    comm : mpi4py communicator
    target : str or Path
        The folder of the results, or the case file that tells it.
    overrides, output
        Of a case file, as for ``cruciform-petsc run``.

    Raises
    ------
    InputError
        On every rank: see `Checkpoint.resume`.
    """
    if not on_root(comm, lambda: Path(target).exists()):
        raise InputError(f'there is no "{target}", name a folder of results or a case file')
    case = None
    directory = Path(target)
    if on_root(comm, directory.is_dir):
        if on_root(comm, lambda: not _is_there(directory)):
            raise InputError(_nothing_there(directory))
        if overrides or output is not None:
            raise InputError(
                f'the case comes from the checkpoint in "{target}"; --set and --output go with the '
                "case file: cruciform-petsc resume CASE"
            )
    else:
        case = Case.load_collective(comm, target, overrides)
        if not case.test.finite:
            raise InputError(
                "a test at small displacements is one system of equations and has no checkpoints, "
                f"{ANEW} {target}"
            )
        directory = prepare_directory(comm, case.output.directory if output is None else output)
    warning = on_root(comm, lambda: lock_directory(directory))
    if case is not None and on_root(
        comm, lambda: not _is_there(directory) and not _is_finished(directory)
    ):
        checkpoint = Checkpoint.begin(comm, directory, case)
        checkpoint.notes.append(f'nothing was reached in "{directory}" yet, so it begins at rest')
    else:
        checkpoint = Checkpoint.resume(comm, directory, case)
    checkpoint.notes += [warning] if warning else []
    return checkpoint


def hint(directory: str | Path, ranks: int = 1) -> str:
    """How to go on with the run whose results are in a folder, a sentence; "" if it cannot be.

    Not collective.
    """
    if not _is_there(directory):
        return ""
    return f"what was reached is kept, continue with: {resume_command(directory, ranks)}"


def resume_command(directory: str | Path, ranks: int = 1) -> str:
    """What to type to go on with the run whose results are in a folder."""
    launcher = f"mpirun -n {ranks} " if ranks > 1 else ""
    return f"{launcher}cruciform-petsc resume {shlex.quote(str(directory))}"


# -- what determines a run ------------------------------------------------------------------------


def determines(case: Case) -> dict[str, Any]:
    """What the equilibria of a case depend on, as plain data: fabric, preform, test.

    Of the test all but the number of increments, which, like the solver's options, only says how to
    get there.
    """
    fabric = asdict(case.fabric())
    for name in ("name", "source"):
        fabric.pop(name)
    data = case.model_dump()
    test = {name: value for name, value in data["test"].items() if name != "increments"}
    return json.loads(json.dumps({"fabric": fabric, "preform": data["preform"], "test": test}))


def _differences(one: Any, other: Any, name: str = "") -> list[str]:
    """Keys whose values differ, "test.extension"."""
    if not (isinstance(one, dict) and isinstance(other, dict)):
        return [] if one == other else [name]
    found = []
    for key in [*one, *(key for key in other if key not in one)]:
        below = f"{name}.{key}" if name else str(key)
        found += _differences(one.get(key), other.get(key), below)
    return found


def _case_of(path: Path, run: _Run) -> Case:
    try:
        return Case.from_data(run.case)
    except InputError:
        raise _senseless(path) from None


# -- files and folders -----------------------------------------------------------------------------


@contextmanager
def _telling(problem: str, error: type[InputError] = InputError) -> Iterator[None]:
    """Make an OSError an error that tells what it prevents."""
    try:
        yield
    except OSError as reason:
        raise error(f"{problem}: {reason.strerror or reason}") from None


def _meeting(key: np.ndarray, size: int) -> np.ndarray:
    """Rank (n,) on which those who have a key and those who want it meet: all get equal shares."""
    mixed = key.astype(np.uint64) * np.uint64(0x9E3779B97F4A7C15)  # Knuth's: 2^64 / golden ratio
    return ((mixed >> np.uint64(32)) % np.uint64(size)).astype(int)


def _open(comm: MPI.Intracomm, folder: Path) -> tuple[_Manifest, str]:
    """Check a folder's manifest and all its files; returns its checksum, too. Collective."""

    def read() -> tuple[_Manifest, str]:
        with _telling(f'"{folder / MANIFEST}" cannot be read', DamagedError):
            return _read_manifest(folder)

    def check() -> None:
        for rank in range(comm.rank, len(manifest.hashes), comm.size):
            path = folder / f"rank-{rank}.npy"
            with _telling(f'"{path}" cannot be read', DamagedError), open_regular(path) as file:
                if hashlib.file_digest(file, "sha256").hexdigest() != manifest.hashes[rank]:
                    raise DamagedError(f'"{path}" is damaged: its bytes do not match its checksum')
            _nodes_of(folder, manifest, rank)

    manifest, seal = on_root(comm, read)
    on_all(comm, check)
    return manifest, seal


def _nodes_of(folder: Path, manifest: _Manifest, rank: int) -> np.ndarray:
    """Records of a rank's nodes, which stay on the disk."""
    path = folder / f"rank-{rank}.npy"
    with suppress(Exception):  # numpy's reader of headers has many for what it does not expect
        records = np.lib.format.open_memmap(path, mode="r")
        if records.dtype == _record(manifest.arrays) and records.shape == (manifest.rows[rank],):
            return records
    raise DamagedError(f'"{path}" is damaged: it does not hold what its manifest says')


def _records(folder: Path, manifest: _Manifest, first: int, stop: int) -> np.ndarray:
    """Records first ... stop - 1 of those in all the files, one after the other."""
    ends = np.cumsum([0, *manifest.rows])
    share = [
        _nodes_of(folder, manifest, rank)[max(first - begin, 0) : max(stop - begin, 0)]
        for rank, (begin, end) in enumerate(pairwise(ends))
        if begin < stop and first < end
    ]
    return np.concatenate([np.empty(0, _record(manifest.arrays)), *share])


def _write_file(path: Path, data: bytes) -> str:
    """Write a new file, see it onto the disk, and read it back; returns its checksum."""
    with path.open("xb") as file:
        file.write(data)
        file.flush()
        os.fsync(file.fileno())
    if path.read_bytes() != data:
        raise OSError("it reads otherwise than it was written")
    return hashlib.sha256(data).hexdigest()


def _sync(folder: Path) -> None:
    """Names of files are on the disk only when their folder is."""
    handle = os.open(folder, os.O_RDONLY)
    try:
        with suppress(OSError):  # some file systems cannot
            os.fsync(handle)
    finally:
        os.close(handle)


def _remove(folder: Path) -> None:
    """Remove a checkpoint or a part of it; raise what `foreign` makes if something else stays."""
    if not os.path.lexists(folder):
        return
    if folder.is_symlink() or not folder.is_dir():
        raise foreign(folder)
    for path in folder.iterdir():
        if re.fullmatch(PARTS, path.name):
            with suppress(InputError):
                _remove(path)
        elif re.fullmatch(FILES, path.name):
            path.unlink()
    for path in sorted(folder.rglob("*"), reverse=True):
        raise foreign(path)
    folder.rmdir()


def _is_there(directory: str | Path) -> bool:
    folder = Path(directory) / CHECKPOINT
    return any(os.path.lexists(folder / name) for name in (NEWEST, PREVIOUS))


def _is_finished(directory: Path) -> bool:
    """Whether results are there; a summary may be of a run before the one that was interrupted."""
    return (directory / "summary.json").exists() and not (directory / CHECKPOINT).exists()


def _nothing_there(directory: Path) -> str:
    if _is_finished(directory):
        return f'the run in "{directory}" is finished, there is nothing to resume'
    return (
        f'there is no checkpoint in "{directory}": nothing was reached there yet, or it is not the '
        "folder of a test at finite deformation; start with cruciform-petsc run CASE"
    )
