# SPDX-License-Identifier: MIT
"""Checkpoints of a test at finite deformation: killed at any moment, it goes on from the last one.

They lie in the folder ``checkpoint`` of the results:

- ``newest`` and ``previous``: after each of the last two accepted increments, what it takes to go
  on: the case, the histories of all increments, and positions of the last three states;
- ``state-N``: positions of the N-th state that was asked for, which the results need.

A file is a line that tells what it is, a line of JSON, the keys of all nodes (int64) and their
positions (float64, little-endian), and a seal: its length and a checksum of all its bytes. It gets
its name only when it is on the disk, sealed, and has been read back, so whatever has a name is
whole; what has been damaged later is told by the seal before anything is made of the bytes. (Not
HDF5: on a full disk its parallel driver hangs, and its serial one ends in a segmentation fault.)

Positions are stored with the keys of their nodes (`finite.FiniteNodes.node_key`), which are places
on yarns and do not depend on the ranks. Ranks write their own nodes. To read, each takes an equal
share of the rows, and sends them to the ranks that own these places now. No rank ever holds all.
"""

from __future__ import annotations

import errno
import hashlib
import json
import math
import os
import shlex
import shutil
import struct
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import MISSING, asdict, dataclass, fields
from pathlib import Path
from typing import TYPE_CHECKING, Any, BinaryIO, TypeVar

import numpy as np

from .. import __version__
from ..case.schema import Case
from ..errors import InputError
from ..parallel import on_root, send_by_rank
from .folder import lock_directory, prepare_directory, unlock_directory

if TYPE_CHECKING:
    from mpi4py import MPI

    from ..equilibrium.finite import FiniteNetwork
    from ..equilibrium.newton import Increment
    from ..equilibrium.newton import Path as SolutionPath

T = TypeVar("T")

FOLDER, NEWEST, PREVIOUS, PUT_ASIDE = "checkpoint", "newest", "previous", "checkpoint.old"
FORMAT = 1
NAME = b"cruciform_petsc checkpoint "
KEY, POSITION = np.dtype("<i8"), np.dtype("<f8")
SEAL = struct.Struct("<Q32s")  # length without the seal, SHA-256 of the SHA-256 of the blocks
BLOCK = 1 << 20  # bytes that are read and hashed at a time
ANEW = "begin anew with cruciform-petsc run"


class DamagedError(InputError):
    """A checkpoint's file is not what was written."""


@dataclass
class Kept:
    """What a test goes on from; positions are those of local nodes (n_local, 2), ghosts filled.

    Attributes
    ----------
    states : list of (control, positions)
        The last three at most.
    target : int
        Number of the value asked for that was being made for.
    allowed : float or None
        Largest step, if it is not the usual one.
    load : float
        Reached, N, where loads are asked for.
    asked : list of (control, positions)
        The states asked for that were reached.
    """

    states: list[tuple[float, np.ndarray]]
    target: int
    allowed: float | None
    load: float
    asked: list[tuple[float, np.ndarray]]


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
        self.folder = self.directory / FOLDER
        self.increments: list[Increment] = []
        self.notes: list[str] = []
        self._header: dict[str, Any] | None = None  # of the file to go on from
        self._source = self.folder / NEWEST
        self._states: list[str] = []  # seals of the files of states asked for
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
            On every rank: the folder cannot be made, or another run is writing to it.
        """
        checkpoint = cls(comm, directory, case)
        old = checkpoint.directory / PUT_ASIDE

        def prepare() -> bool:
            try:
                checkpoint.directory.mkdir(parents=True, exist_ok=True)
                lock_directory(checkpoint.directory)
                found = _is_there(checkpoint.directory)
                if found:
                    shutil.rmtree(old, ignore_errors=True)
                    checkpoint.folder.rename(old)
                checkpoint.folder.mkdir(exist_ok=True)
                for path in checkpoint.folder.iterdir():
                    path.unlink()
            except OSError as error:
                raise InputError(
                    f'"{checkpoint.folder}" cannot be made: {error.strerror}'
                ) from None
            return found

        if on_root(comm, prepare):
            checkpoint.notes.append(
                f'the checkpoint of a run that was not finished is now "{old}" (cruciform-petsc '
                "resume would have continued it)"
            )
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
        folder = Path(directory) / FOLDER
        problems: list[str] = []
        for name in (NEWEST, PREVIOUS):
            path = folder / name
            if not on_root(comm, path.exists):
                continue
            try:
                header, _ = _open(comm, path)
                checkpoint = cls(comm, directory, case or _case_of(path, header))
                checkpoint._adopt(path, header)
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

    def _adopt(self, path: Path, header: dict[str, Any]) -> None:
        """Take over what a file's header says, if it is of this case."""
        told = header.get("determines")
        if not isinstance(told, dict):
            raise _senseless(path)
        differing = _differences(told, determines(self.case))
        if differing:
            shown = ", ".join(differing[:3]) + (", ..." if len(differing) > 3 else "")
            raise InputError(
                f'"{path}" belongs to another case ({shown} {_differ(differing)}): resume with '
                f"the case as it was, or {ANEW}"
            )
        try:
            self.increments = [_increment(data) for data in header["increments"]]
            self._states = [str(seal) for seal in header["states"]]
            path_ = header["path"]
            controls = [float(control) for control in path_["controls"]]
            good = (
                1 <= len(controls) <= 3
                and len(self._states) == sum(increment.asked for increment in self.increments)
                and isinstance(path_["target"], int)
                and isinstance(path_["allowed"], float | None)
                and isinstance(path_["load"], float)
                and isinstance(header["nodes"], int)
            )
        except (KeyError, TypeError, ValueError):
            good = False
        if not good:
            raise _senseless(path)
        self._header, self._source = header, path

    # -- reading ----------------------------------------------------------------------------------

    def restore(self, model: FiniteNetwork) -> Kept:
        """Positions to go on from; those at rest, of which a checkpoint is made, without a past.

        Parameters
        ----------
        model : FiniteNetwork
            On the ranks of now.

        Raises
        ------
        InputError
            On every rank: a file is damaged, or is of another network.
        """
        if self._header is None:
            kept = Kept([(0.0, model.rest.copy())], 0, None, 0.0, [])
            self._write(model, kept, [])
            return kept
        path = self._header["path"]
        positions = self._read(model, self._source, len(path["controls"]))
        asked = []
        controls = [increment.control for increment in self.increments if increment.asked]
        for number, (seal, control) in enumerate(zip(self._states, controls, strict=True), 1):
            source = self.folder / f"state-{number}"
            try:
                _, found = _open(self.comm, source)
            except DamagedError as error:
                raise InputError(f"{error}; {ANEW}") from None
            if found != seal:
                raise InputError(f'"{source}" is of another run than its neighbours; {ANEW}')
            asked.append((control, self._read(model, source, 1)[0]))
        states = list(zip(map(float, path["controls"]), positions, strict=True))
        return Kept(states, path["target"], path["allowed"], path["load"], asked)

    def _read(self, model: FiniteNetwork, path: Path, count: int) -> list[np.ndarray]:
        """``count`` positions (n_local, 2) from a file whose seal is good."""
        comm, nodes = self.comm, model.nodes
        n = nodes.num_nodes_global
        mine = slice(n * comm.rank // comm.size, n * (comm.rank + 1) // comm.size)

        def rows() -> tuple[np.ndarray, np.ndarray]:
            with path.open("rb") as file:
                file.readline()
                file.readline()
                begin = file.tell()
                size = path.stat().st_size - SEAL.size - begin
                if size != n * (KEY.itemsize + 2 * count * POSITION.itemsize):
                    raise OSError("it is of another network")
                return (
                    _rows(file, begin, mine, KEY, ()),
                    _rows(file, begin + n * KEY.itemsize, mine, POSITION, (count, 2)),
                )

        def problem(told: str) -> InputError:
            return InputError(f'"{path}" cannot be used: {told}; {ANEW}')

        keys, positions = _on_all(comm, rows, problem)
        owner = model.network.partition.owner(crossover_of(keys))
        keys, positions = send_by_rank(comm, owner, keys, positions)
        own = nodes.node_key[: nodes.num_nodes_owned]
        order = np.argsort(keys)
        if not comm.allreduce(int(np.array_equal(keys[order], own))) == comm.size:
            raise InputError(f'"{path}" is of another network; {ANEW}')
        if not comm.allreduce(int(np.isfinite(positions).all())) == comm.size:
            raise InputError(f'"{path}" holds positions that are not numbers; {ANEW}')
        local = np.zeros((count, nodes.num_nodes_local, 2))
        local[:, : len(own)] = positions[order].swapaxes(0, 1)
        return [nodes.halo.forward(x) for x in local]

    # -- writing ----------------------------------------------------------------------------------

    def write(self, model: FiniteNetwork, path: SolutionPath, increments: list[Increment]) -> None:
        """Keep what has been reached.

        Parameters
        ----------
        model : FiniteNetwork
        path : solvers.nonlinear.Path
        increments : list of Increment
            All that were accepted, the last of which is where the path has got to.

        Raises
        ------
        InputError
            On every rank: the place cannot be written to. The last good checkpoint is still there.
        """
        asked = sum(bool(increment.asked) for increment in increments)
        if asked > len(self._states):
            name = f"state-{asked}"
            control, x = path.states[-1]
            header = {"state": asked, "control": control}
            self._states.append(self._put(model, name, header, [x]))
        kept = Kept(path.states, path.target, path.allowed, path.load, [])
        self._write(model, kept, increments)

    def _write(self, model: FiniteNetwork, kept: Kept, increments: list[Increment]) -> None:
        header = {
            "case": self.case.model_dump(),
            "determines": determines(self.case),
            "ranks": self.comm.size,
            "nodes": model.nodes.num_nodes_global,
            "increments": [_plain(increment) for increment in increments],
            "path": {
                "controls": [float(control) for control, _ in kept.states],
                "target": int(kept.target),
                "allowed": None if kept.allowed is None else float(kept.allowed),
                "load": float(kept.load),
            },
            "states": self._states,
        }
        self._put(model, NEWEST, header, [x for _, x in kept.states])
        self._newest_is_good = True

    def _put(
        self,
        model: FiniteNetwork,
        name: str,
        header: dict[str, Any],
        positions: list[np.ndarray],
    ) -> str:
        """Write a file, seal it, read it back, and only then give it its name; returns its seal."""
        comm, nodes = self.comm, model.nodes
        own, first, n = nodes.num_nodes_owned, nodes.node_offset, nodes.num_nodes_global
        mine = slice(first, first + own)
        keys = nodes.node_key[:own].astype(KEY)
        place = np.stack([x[:own] for x in positions], axis=1).astype(POSITION)
        head = NAME + f"{FORMAT}\n{json.dumps({'program': __version__, **header})}\n".encode()
        begin = comm.bcast(len(head))
        behind_keys = begin + n * KEY.itemsize
        size = behind_keys + n * len(positions) * 2 * POSITION.itemsize
        new, final = self.folder / "new", self.folder / name

        def start() -> None:
            with new.open("wb") as file:
                _allocate(file.fileno(), size + SEAL.size)
                file.write(head)

        def fill() -> None:
            with new.open("rb+") as file:
                file.seek(begin + first * KEY.itemsize)
                file.write(keys.data)
                file.seek(behind_keys + first * place[:1].nbytes)
                file.write(place.data)

        def seal_it() -> None:
            with new.open("rb+") as file:
                file.seek(size)
                file.write(SEAL.pack(size, digest))

        def settle() -> None:
            with new.open("rb+") as file:
                os.fsync(file.fileno())  # on each rank, as they may be on different machines
                read = (
                    _rows(file, begin, mine, KEY, keys.shape[1:]),
                    _rows(file, behind_keys, mine, POSITION, place.shape[1:]),
                )
            if not (np.array_equal(read[0], keys) and np.array_equal(read[1], place)):
                raise OSError("it reads otherwise than it was written")

        def name_it() -> None:
            if name == NEWEST and self._newest_is_good:
                final.replace(self.folder / PREVIOUS)
            new.replace(final)
            _sync_folder(self.folder)

        on_root(comm, lambda: lock_directory(self.directory))
        try:
            _on_root(comm, start)
            _on_all(comm, fill, InputError)
            digest = _digest(comm, new, size)
            _on_root(comm, seal_it)
            _on_all(comm, settle, InputError)
            _on_root(comm, name_it)
        except InputError as error:
            kept = on_root(comm, lambda: self._give_up(new))
            raise InputError(
                f'the checkpoint "{final}" cannot be written: {error}{"; " if kept else ""}{kept}'
            ) from None
        return digest.hex()

    def _give_up(self, new: Path) -> str:
        """Remove a file that is not whole; what to tell the user. Not collective."""
        with suppress(OSError):
            new.unlink(missing_ok=True)
        return hint(self.directory, self.comm.size)

    def hint(self) -> str:
        """How to go on with it, a sentence; "" if it cannot be."""
        return on_root(self.comm, lambda: hint(self.directory, self.comm.size))

    def remove(self) -> None:
        """Remove it, as the results are there. Problems are not worth a word then."""
        if self.comm.rank == 0:
            shutil.rmtree(self.folder, ignore_errors=True)
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
    if on_root(comm, lambda: Path(target).is_dir()):
        if on_root(comm, lambda: not _is_there(target)):
            raise InputError(_nothing_there(Path(target)))
        if overrides or output is not None:
            raise InputError(
                f'the case comes from the checkpoint in "{target}"; --set and --output go with the '
                "case file: cruciform-petsc resume CASE"
            )
        on_root(comm, lambda: lock_directory(Path(target)))
        return Checkpoint.resume(comm, target)
    case = Case.load_collective(comm, target, overrides)
    directory = Path(case.output.directory if output is None else output)
    if not case.test.finite:
        raise InputError(
            "a test at small displacements is one system of equations and has no checkpoints, "
            f"{ANEW} {target}"
        )
    prepare_directory(comm, directory)
    on_root(comm, lambda: lock_directory(directory))
    if on_root(comm, lambda: not _is_there(directory) and not _is_finished(directory)):
        checkpoint = Checkpoint.begin(comm, directory, case)
        checkpoint.notes.append(f'nothing was reached in "{directory}" yet, so it begins at rest')
        return checkpoint
    return Checkpoint.resume(comm, directory, case)


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


def _differ(names: list[str]) -> str:
    return "differ" if len(names) > 1 else "differs"


def crossover_of(key: np.ndarray) -> np.ndarray:
    """Lattice position (n, 2) of the crossover with whose owner a node is, by its key (n,).

    See Network: a tail belongs to its crossover, an end between two to the lower one.
    """
    family = key >> 62
    line = ((key >> 32) & ((1 << 30) - 1)) - (1 << 29)
    place = (key & ((1 << 32) - 1)) - (1 << 31)
    # 4 i - 1, 4 i, 4 i + 1 and 4 i + 2 are crossover i's.
    along = (place + 1) >> 2
    return np.where(family[:, None] == 0, np.stack([along, line], 1), np.stack([line, along], 1))


# -- headers --------------------------------------------------------------------------------------


def _plain(increment: Increment) -> dict[str, Any]:
    data = asdict(increment)
    return {name: np.asarray(value).tolist() for name, value in data.items()}


def _increment(data: dict[str, Any]) -> Increment:
    from ..equilibrium.newton import Increment  # starts PETSc

    kinds: dict[str, Callable] = {"float": float, "int": int, "bool": bool}
    values = {
        field.name: kinds[str(field.type)](data[field.name])
        for field in fields(Increment)
        # Older checkpoints lack what has a default.
        if str(field.type) in kinds and (field.name in data or field.default is MISSING)
    }
    return Increment(
        energies=np.array(data["energies"], float).reshape(3),
        history=[float(value) for value in data["history"]],
        **values,
    )


def _case_of(path: Path, header: dict[str, Any]) -> Case:
    try:
        return Case.from_data(header["case"])
    except (InputError, KeyError):
        raise _senseless(path) from None


def _senseless(path: Path) -> DamagedError:
    return DamagedError(f'"{path}" is damaged: its header makes no sense')


# -- sealed files ---------------------------------------------------------------------------------


def _on_all(
    comm: MPI.Intracomm, function: Callable[[], T], make_error: Callable[[str], Exception]
) -> T:
    """Call a function on every rank; an OSError on any is the error made of it on every rank."""
    result, problem = None, None
    try:
        result = function()
    except OSError as error:
        problem = error.strerror or str(error)
    problems = [told for told in comm.allgather(problem) if told]
    if problems:
        raise make_error(problems[0])
    return result  # type: ignore[return-value]


def _on_root(comm: MPI.Intracomm, function: Callable[[], None]) -> None:
    """Call a function on rank 0; an OSError there is an InputError on every rank."""
    _on_all(comm, function if comm.rank == 0 else lambda: None, InputError)


def _rows(
    file: BinaryIO, begin: int, rows: slice, kind: np.dtype, shape: tuple[int, ...]
) -> np.ndarray:
    """Rows of an array that begins somewhere in a file; (n, *shape)."""
    width = math.prod(shape)
    file.seek(begin + rows.start * width * kind.itemsize)
    data = file.read((rows.stop - rows.start) * width * kind.itemsize)
    return np.frombuffer(data, kind).reshape(-1, *shape)


def _open(comm: MPI.Intracomm, path: Path) -> tuple[dict[str, Any], str]:
    """Check a file's seal and version; returns its header and its seal. Collective."""
    size, digest = on_root(comm, lambda: _read_seal(path))
    if _digest(comm, path, size) != digest:
        raise DamagedError(f'"{path}" is damaged: its bytes do not match its checksum')
    return on_root(comm, lambda: _read_header(path)), digest.hex()


def _read_seal(path: Path) -> tuple[int, bytes]:
    """Length without the seal, and digest, as the seal says; not collective."""
    try:
        with path.open("rb") as file:
            first = file.readline(len(NAME) + 20)
            size = file.seek(0, os.SEEK_END) - SEAL.size
            file.seek(max(size, 0))
            end = file.read(SEAL.size)
    except FileNotFoundError:
        raise DamagedError(f'"{path}" is missing') from None
    except OSError as error:
        raise DamagedError(f'"{path}" cannot be read: {error.strerror}') from None
    if not first.startswith(NAME):
        raise DamagedError(f'"{path}" is damaged, or no checkpoint of cruciform_petsc')
    told, digest = SEAL.unpack(end) if size > 0 else (-1, b"")
    if told != size:
        raise DamagedError(f'"{path}" is damaged: it has been cut short or added to')
    return size, digest


def _read_header(path: Path) -> dict[str, Any]:
    """Header of a file whose seal is good; not collective."""
    with path.open("rb") as file:
        version = file.readline()[len(NAME) :].strip().decode("ascii", "replace")
        line = file.readline()
    if version != str(FORMAT):
        raise InputError(
            f'"{path}" has format {version}, and this version of cruciform_petsc '
            f"({__version__}) reads format {FORMAT}: resume with the version that wrote it, "
            f"or {ANEW}"
        )
    try:
        header = dict(json.loads(line))
        program = header["program"]
    except (ValueError, KeyError, TypeError, RecursionError):
        raise _senseless(path) from None
    if program != __version__:
        raise InputError(
            f'"{path}" was written by cruciform_petsc {program}, and this is {__version__}: '
            f"resume with the version that wrote it, or {ANEW}"
        )
    return header


def _digest(comm: MPI.Intracomm, path: Path, size: int) -> bytes:
    """SHA-256 of the SHA-256 of a file's blocks, of which each rank reads its share. Collective."""
    count = -(-size // BLOCK)
    mine = range(count * comm.rank // comm.size, count * (comm.rank + 1) // comm.size)

    def hashes() -> bytes:
        found = []
        with path.open("rb") as file:
            file.seek(mine.start * BLOCK)
            for block in mine:
                data = file.read(min(BLOCK, size - block * BLOCK))
                found.append(hashlib.sha256(data).digest())
        return b"".join(found)

    told = _on_all(comm, hashes, lambda why: DamagedError(f'"{path}" cannot be read: {why}'))
    return hashlib.sha256(b"".join(comm.allgather(told))).digest()


def _allocate(handle: int, size: int) -> None:
    """Take the room for a file at once, so that a full disk is known before anything is written."""
    try:
        os.posix_fallocate(handle, 0, size)
    except OSError as error:
        if error.errno not in (errno.EOPNOTSUPP, errno.EINVAL, errno.ENOSYS):
            raise


def _sync_folder(folder: Path) -> None:
    """Names of files are on the disk only when their folder is."""
    handle = os.open(folder, os.O_RDONLY)
    try:
        with suppress(OSError):  # some file systems cannot
            os.fsync(handle)
    finally:
        os.close(handle)


def _is_there(directory: str | Path) -> bool:
    return any((Path(directory) / FOLDER / name).exists() for name in (NEWEST, PREVIOUS))


def _is_finished(directory: Path) -> bool:
    """Whether results are there; a summary may be of a run before the one that was interrupted."""
    return (directory / "summary.json").exists() and not (directory / FOLDER).exists()


def _nothing_there(directory: Path) -> str:
    if _is_finished(directory):
        return f'the run in "{directory}" is finished, there is nothing to resume'
    return (
        f'there is no checkpoint in "{directory}": nothing was reached there yet, or it is not the '
        "folder of a test at finite deformation; start with cruciform-petsc run CASE"
    )
