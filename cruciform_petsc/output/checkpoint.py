# SPDX-License-Identifier: MIT
"""Checkpoints of a finite test or a forming: killed at any moment, it goes on from the last one.

In the folder ``checkpoint`` of the results lie the folders

- ``newest`` and ``previous``: after each of the last two accepted increments (of a forming: steps),
  what it takes to go on: the case, the histories of all increments, positions of the last three
  states (of a forming the last one), and what items remember;
- ``state-N``: the state after the N-th increment as it was found, which the results need.

In each of them ``rank-R.npy`` holds the nodes that rank R owned, as records of a key and
values, and ``manifest.json`` all else, with the SHA-256 of every file and of itself. A folder
gets its name when all this is on the disk and has been read back. A key is a place on a yarn
of a ply, or a tool (`net.lattice`), whatever the ranks are: those that go on read equal shares of
the records, and send them to the ranks that own these nodes now. No rank ever holds all.
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
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import asdict, dataclass, replace
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import numpy as np
from pydantic import BaseModel, ConfigDict, Field

from .. import __version__
from ..case.schema import Case
from ..equilibrium.follow import Path as StagePath
from ..equilibrium.stages import Increment
from ..errors import InputError, cut, typed_before
from ..forming.forming import FormingStep
from ..forming.press import stage_number, targets
from ..forming.table import FormingTable
from ..parallel import ask, find_sorted, on_all, on_root, send_by_rank
from ..reading import open_regular, read_bytes
from .folder import (
    CHECKPOINT,
    PUT_ASIDE,
    claim,
    explaining,
    foreign,
    lock_directory,
    prepare_directory,
    unlock_directory,
)

if TYPE_CHECKING:
    from mpi4py import MPI

    from ..equilibrium.model import Model
    from ..equilibrium.state import State

NEWEST, PREVIOUS, MANIFEST = "newest", "previous", "manifest.json"
HEADER = 2**12  # bytes that NumPy puts before an array, at most
FORMAT = 4  # 1: files, of version 0.1.0; 2: of 0.2.0, states asked for only; 3: other keys
PARTS, FILES = r"newest|previous|(state|new)-\d+", r"manifest\.json|rank-\d+\.npy"
ANEW = f"begin anew with {typed_before()}cruciform-petsc run"


class DamagedError(InputError):
    """A checkpoint is not what was written."""


def _senseless(folder: Path) -> DamagedError:
    return DamagedError(f'"{folder}" is damaged: its manifest makes no sense')


# -- what a manifest says --------------------------------------------------------------------------

MOST = 1e30  # of what is no whole number
Count = Annotated[int, Field(ge=0, lt=2**53)]
Rows = Annotated[int, Field(ge=0, lt=2**31)]  # a rank counts its nodes in 32 bits
Name = Annotated[str, Field(pattern=r"^[\w .-]{1,60}$")]
Hash = Annotated[str, Field(pattern="^[0-9a-f]{64}$")]


class _Table(BaseModel):
    model_config = ConfigDict(extra="forbid", strict=True, allow_inf_nan=False)


class _Path(_Table):
    """See equilibrium.follow.Path."""

    target: Count
    allowed: float | None
    load: Annotated[float, Field(gt=-MOST, lt=MOST)]
    begin: float


class _Run(_Table):
    """What it takes to go on, but for positions."""

    case: dict[str, Any]
    determines: dict[str, Any]
    increments: list[Increment] | list[FormingStep]
    controls: Annotated[list[float], Field(min_length=1, max_length=3)]  # of the positions
    path: _Path
    states: list[Hash]  # of the manifests of the states after each increment

    def is_way_through(self, case: Case) -> bool:
        """Whether increments lead through the values asked for to where the path is."""
        stages, by_load, increments = _values(case), _is_by_load(case), bare(self.increments)
        if self.path.begin not in range(len(stages)) or not self._is_of_kind(case):
            return False
        stage = int(self.path.begin)
        values = [value for of_stage in stages for value in of_stage]
        before, asked = 0.0, 0
        for increment in increments:
            if asked == len(values) or not _has_numbers(asdict(increment)):
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
        allowed = self.path.allowed
        return (
            len({tuple(increment.energies) for increment in increments}) < 2
            and (len(stages) == 1 or stage == stage_number(before))
            and self.path.target == asked - sum(map(len, stages[:stage]))
            and len(self.states) == len(increments)
            and len({tuple(increment.columns) for increment in increments}) < 2
            and self.controls[-1] == before
            and (by_load or {0.0, *controls}.issuperset(self.controls))
            and len(set(self.controls)) == len(self.controls)
            and (allowed is None or allowed > 1e-12 * largest)
        )

    def _is_of_kind(self, case: Case) -> bool:
        """Whether there are steps of a forming with its stages and tools, or mere increments."""
        if not isinstance(case.test, FormingTable):
            return not any(isinstance(step, FormingStep) for step in self.increments)
        names, known = {tool.name for tool in case.tools}, set()
        for step in self.increments:
            if not isinstance(step, FormingStep):
                return False
            figures = asdict(step)
            known.add(tuple(tuple(part) for part in figures.values() if isinstance(part, dict)))
            if not (
                figures.pop("stage") == _stage_name(case, step.increment.control)
                and all(vectors.keys() == names for vectors in step.of_tools)
                and _has_numbers(figures)
            ):
                return False
        return len(known) < 2  # of loads, clamps and whatever else: the same ones in all steps

    def up_to(self, count: int, path: _Path) -> _Run:
        """What there was after so many increments, on the path kept with the last of them."""
        increments = self.increments[:count]
        now = {"path": path, "increments": increments, "states": self.states[:count]}
        return self.model_copy(update={"controls": [bare(increments)[-1].control], **now})


def bare(steps: Sequence[Increment | FormingStep]) -> list[Increment]:
    """The increments of steps, without what else there is of those of a forming."""
    return [step.increment if isinstance(step, FormingStep) else step for step in steps]


def _values(case: Case) -> list[list[float]]:
    """Values asked for, in each stage; all but a forming have one."""
    if isinstance(case.test, FormingTable):
        return [targets(number, stage.results) for number, stage in enumerate(case.all_stages)]
    return [case.test.values_si]


def _is_by_load(case: Case) -> bool:
    """Whether loads are asked for, and the controls that give them are found."""
    if isinstance(case.test, FormingTable):
        return False
    return case.test.control == "load" != next(iter(case.test.controls))


def _stage_name(case: Case, time: float) -> str | None:
    number = stage_number(time) if abs(time) < MOST else len(case.all_stages)
    return case.all_stages[number].name if number < len(case.all_stages) else None


def _has_numbers(figures: Any) -> bool:
    """Whether all that there is are numbers that can be summed up and squared."""
    if isinstance(figures, dict | list | np.ndarray):
        parts = figures.values() if isinstance(figures, dict) else figures
        return all(map(_has_numbers, parts))
    if figures is None:  # of a column that is not a number
        return True
    return abs(figures) < (2**53 if isinstance(figures, int) else MOST)


class _Head(BaseModel):
    """What a manifest of any format says."""

    model_config = ConfigDict(strict=True)
    program: Annotated[str, Field(pattern="^[ -~]{1,20}$")]
    format: Count


class _Array(_Table):
    """What an item remembers of a node."""

    type: Annotated[str, Field(pattern=r"^(\|b1|<[iuf][48])$")]
    shape: Annotated[list[Annotated[int, Field(ge=1, le=64)]], Field(max_length=2)]


class _Arrays(_Table):
    """What there is of a node: shape of its positions, and memory of the last of them."""

    positions: Annotated[list[Annotated[int, Field(ge=1, le=3)]], Field(max_length=2)]
    memory: Annotated[dict[Name, Annotated[dict[Name, _Array], Field(max_length=16)]],
                      Field(max_length=256)]  # fmt: skip

    @classmethod
    def of(cls, states: Sequence[State]) -> _Arrays:
        """Of states that are to be written."""
        memory = _layout(states[-1].memory)
        return cls(positions=[len(states), states[-1].x.shape[1]], memory=memory)

    def record(self) -> np.dtype:
        """What a file holds of one node."""
        fields: list[tuple] = [("key", "<i8"), ("positions", "<f8", tuple(self.positions))]
        for item, arrays in self.memory.items():
            for name, array in arrays.items():
                fields.append((f"{item}/{name}", array.type, tuple(array.shape)))
        return np.dtype(fields)


def _layout(memory: Mapping[str, Mapping[str, np.ndarray]]) -> dict[str, dict[str, _Array]]:
    """What items remember of each of their elements."""
    return {
        item: {
            name: _Array(type=array.dtype.str, shape=list(array.shape[1:]))
            for name, array in arrays.items()
        }
        for item, arrays in memory.items()
        if arrays
    }


class _Manifest(_Table, _Head):
    """What there is in a folder."""

    arrays: _Arrays
    rows: Annotated[list[Rows], Field(min_length=1)]  # of each rank's file
    hashes: list[Hash]
    run: _Run | _Path  # of a state after an increment the path that led to it


def _plain(value: np.generic | np.ndarray) -> Any:
    """What numpy has, in Python's numbers and lists."""
    return value.tolist()


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
    text = read_bytes(path)
    body = b"{" + text[len(_sealed(b"{")) :]
    if _sealed(body) != text:
        raise DamagedError(f'"{path}" is damaged: its bytes do not match its checksum')
    try:
        head = _Head.model_validate_json(body)
        if (head.program, head.format) != (__version__, FORMAT):
            raise InputError(
                f'"{folder}" was written by cruciform_petsc {head.program} in format '
                f"{head.format}, and this is {__version__}, which reads format {FORMAT}: resume "
                f"with the version that wrote it, or {ANEW}"
            )
        manifest = _Manifest.model_validate_json(body)
    except ValueError:
        raise _senseless(folder) from None
    if len(manifest.rows) != len(manifest.hashes):
        raise _senseless(folder)
    return manifest, hashlib.sha256(text).hexdigest()


# -- a folder that is read -------------------------------------------------------------------------


@dataclass(frozen=True)
class _Part:
    """A folder of which the manifest and all files have been checked."""

    comm: MPI.Intracomm
    folder: Path
    manifest: _Manifest
    seal: str  # checksum of the manifest

    @classmethod
    def open(cls, comm: MPI.Intracomm, folder: Path) -> _Part:
        """Check it; a DamagedError on every rank if it is not what was written. Collective."""

        @explaining(f'"{folder / MANIFEST}" cannot be read', DamagedError)
        def read() -> tuple[_Manifest, str]:
            return _read_manifest(folder)

        def check() -> None:
            for rank in range(comm.rank, len(part.manifest.hashes), comm.size):
                path = folder / f"rank-{rank}.npy"
                size = part.manifest.rows[rank] * part.manifest.arrays.record().itemsize
                with explaining(f'"{path}" cannot be read', DamagedError), open_regular(path) as f:
                    if (
                        os.fstat(f.fileno()).st_size > size + HEADER
                        or hashlib.file_digest(f, "sha256").hexdigest()
                        != part.manifest.hashes[rank]
                    ):
                        raise DamagedError(
                            f'"{path}" is damaged: its bytes do not match its checksum'
                        )
                part._nodes_of(rank)

        part = cls(comm, folder, *on_root(comm, read))
        on_all(comm, check)
        return part

    @property
    def run(self) -> _Run:
        """What it takes to go on; a DamagedError if it is but a state."""
        if not isinstance(self.manifest.run, _Run):
            raise _senseless(self.folder)
        return self.manifest.run

    def _nodes_of(self, rank: int) -> np.ndarray:
        """Records of a rank's nodes, which stay on the disk."""
        path = self.folder / f"rank-{rank}.npy"
        rows = (self.manifest.rows[rank],)
        with suppress(Exception):  # numpy's reader of headers has many for what it does not expect
            records = np.lib.format.open_memmap(path, mode="r")
            if records.dtype == self.manifest.arrays.record() and records.shape == rows:
                return records
        raise DamagedError(f'"{path}" is damaged: it does not hold what its manifest says')

    def _records(self, first: int, stop: int) -> np.ndarray:
        """Records first ... stop - 1 of those in all the files, one after the other."""
        ends = np.cumsum([0, *self.manifest.rows])
        share = [
            self._nodes_of(rank)[max(first - begin, 0) : max(stop - begin, 0)]
            for rank, (begin, end) in enumerate(pairwise(ends))
            if begin < stop and first < end
        ]
        return np.concatenate([np.empty(0, self.manifest.arrays.record()), *share])

    def states(
        self,
        model: Model,
        controls: Sequence[float],
        state_at: Callable[[float, np.ndarray], State],
    ) -> list[State]:
        """States at some controls; InputError if they are of other nodes. Collective."""
        comm, nodes, count = self.comm, model.nodes, len(controls)
        n, arrays = nodes.num_nodes_global, self.manifest.arrays
        known = _layout(model.accepted(state_at(0.0, nodes.rest)))
        fits = all(known.get(item) == of_item for item, of_item in arrays.memory.items())
        if sum(self.manifest.rows) != n or arrays.positions != [count, model.dim] or not fits:
            raise InputError(f'"{self.folder}" is of another network; {ANEW}')
        share = (n * comm.rank // comm.size, n * (comm.rank + 1) // comm.size)
        records = on_all(comm, lambda: self._records(*share))
        own = nodes.node_key[: nodes.num_nodes_owned]
        # Keys meet on ranks that follow from nothing but the key; records travel as bytes.
        data = records.view(np.uint8).reshape(len(records), records.itemsize)
        key, data = send_by_rank(comm, _meeting(records["key"], comm.size), records["key"], data)
        order = np.argsort(key)

        def answer(wanted: np.ndarray) -> np.ndarray:
            row = find_sorted(key[order], wanted)
            found = data[order][row] if len(key) else np.empty((len(row), data.shape[1]), np.uint8)
            found[row < 0] = 255  # a key of -1
            return found

        found = ask(comm, _meeting(own, comm.size), own, answer).view(records.dtype)[:, 0]
        good = (found["key"] == own).all() and (np.abs(found["positions"]) < MOST).all()
        if not all(comm.allgather(bool(good))):
            raise InputError(f'"{self.folder}" is of another network, or holds no numbers; {ANEW}')

        def local(owned: np.ndarray) -> np.ndarray:
            values = np.zeros((nodes.num_nodes_local, *owned.shape[1:]), owned.dtype)
            values[: len(own)] = owned
            return nodes.halo.forward(values)

        first = {item.name: item.keepers for item in model.items}
        memory = {
            item: {name: found[f"{item}/{name}"][first[item]] for name in of_item}
            for item, of_item in arrays.memory.items()
        }
        states = [
            state_at(control, local(found["positions"][:, k])) for k, control in enumerate(controls)
        ]
        return [*states[:-1], replace(states[-1], memory=memory)]


def _meeting(key: np.ndarray, size: int) -> np.ndarray:
    """Rank (n,) on which those who have a key and those who want it meet: all get equal shares."""
    mixed = key.astype(np.uint64) * np.uint64(0x9E3779B97F4A7C15)  # Knuth's: 2^64 / golden ratio
    return ((mixed >> np.uint64(32)) % np.uint64(size)).astype(int)


# -- the checkpoint --------------------------------------------------------------------------------


class Checkpoint:
    """The checkpoint of one run. Make it with `begin` or `resume`; all methods are collective.

    Attributes
    ----------
    case : Case
    steps : list of Increment or FormingStep
        Accepted before this run: those found in the files.
    notes : list of str
        What the user should know, in sentences.
    """

    def __init__(self, comm: MPI.Intracomm, directory: str | Path, case: Case):
        self.comm, self.directory, self.case = comm, Path(directory), case
        self.folder = self.directory / CHECKPOINT
        self.steps: Sequence[Increment | FormingStep] = []
        self.notes: list[str] = []
        self._data, self._determines = case.model_dump(), on_root(comm, lambda: determines(case))
        self._source: _Part | None = None  # what to go on from
        self._run: _Run | None = None  # what it says
        self._steps_back = False  # from an earlier increment than the last
        self._states: list[str] = []  # checksums of the states after each increment
        self._newest_is_good = False

    @property
    def increments(self) -> list[Increment]:
        """Those of the steps."""
        return bare(self.steps)

    @classmethod
    def begin(cls, comm: MPI.Intracomm, directory: str | Path, case: Case) -> Checkpoint:
        """Start without a past in a folder of results.

        A checkpoint that is there is put aside, not thrown away. An InputError on every rank if the
        folder cannot be made, if another run is writing to it, or if something that is not the
        program's is in the way.
        """
        checkpoint = cls(comm, directory, case)
        folder, old = checkpoint.folder, checkpoint.directory / PUT_ASIDE

        @explaining(f'"{folder}" cannot be made')
        def prepare() -> list[str]:
            checkpoint.directory.mkdir(parents=True, exist_ok=True)
            notes = [lock_directory(checkpoint.directory)]
            claim(folder)
            if any((folder / name / MANIFEST).exists() for name in (NEWEST, PREVIOUS)):
                claim(old)
                _remove(old)
                folder.rename(old)
                notes.append(
                    f'the checkpoint of a run that was not finished is now "{old}" '
                    f"({typed_before()}cruciform-petsc resume would have continued it)"
                )
            _remove(folder)
            folder.mkdir()
            return [note for note in notes if note]

        checkpoint.notes = on_root(comm, prepare)
        return checkpoint

    @classmethod
    def resume(
        cls,
        comm: MPI.Intracomm,
        directory: str | Path,
        case: Case | None = None,
        from_step: int | None = None,
    ) -> Checkpoint:
        """Open the newest good checkpoint in a folder of results, on any number of ranks.

        A case that is given must be the one the checkpoint is of, but for its title, ``output``,
        ``continuum``, ``solver``, ``test.increments`` and ``step`` of stages. With ``from_step``
        it goes on from an earlier increment, from 1; those after it are given up.

        An InputError on every rank if there is no checkpoint, if it is of another case or program,
        if it is damaged and so is the one before it, or if there is no such increment.
        """
        directory = Path(directory)
        problems: list[str] = []
        for folder in on_root(comm, lambda: _found(directory)):
            try:
                part = _Part.open(comm, folder)
                checkpoint = cls(comm, directory, case or _case_of(part))
                checkpoint._adopt(part, from_step)
            except DamagedError as error:
                problems.append(str(error))
                continue
            if problems:
                checkpoint.notes.append(f"{problems[0]}; going on from the one before it")
            checkpoint._newest_is_good = folder.name == NEWEST
            return checkpoint
        if problems:
            more = ", and so is the one before it" if len(problems) > 1 else ""
            raise InputError(f"{problems[0]}{more}; {ANEW}")
        raise InputError(_nothing_there(directory))

    def _adopt(self, part: _Part, from_step: int | None) -> None:
        """Take over what a manifest says, if it is of this case."""
        run = part.run
        differing = [cut(key) for key in _differences(run.determines, self._determines)]
        shown = ", ".join(differing[:3]) + (", ..." if len(differing) > 3 else "")
        if differing and shown.isprintable():
            raise InputError(
                f'"{part.folder}" belongs to another case ({shown} '
                f"differ{'s' if len(differing) == 1 else ''}): resume with the case as it was, or "
                f"{ANEW}"
            )
        if differing or not run.is_way_through(self.case):
            raise _senseless(part.folder)
        count = len(run.increments)
        if from_step is not None and not 0 < from_step <= count:
            raise InputError(
                f'there is no step {from_step} to go on from in "{self.directory}", which has come '
                f"to step {count}"
            )
        self._states = list(run.states)
        if from_step is not None:
            there = self._state(from_step - 1)
            path = there.manifest.run
            if not isinstance(path, _Path) or not run.up_to(from_step, path).is_way_through(
                self.case
            ):
                raise InputError(f"{_senseless(there.folder)}; {ANEW}")
            run, self._steps_back = run.up_to(from_step, path), True
        self._source, self._run, self._states = part, run, list(run.states)
        self.steps = run.increments

    def restore(
        self, model: Model, state_at: Callable[[float, np.ndarray], State]
    ) -> tuple[StagePath, Iterator[State]] | None:
        """Where to go on, and the states after all increments, in order; None without a past.

        ``state_at`` makes a state of a control and positions (n_local, dim). An InputError on every
        rank if a file is damaged, or is of another network; also when the states are looked at.
        """
        if self._source is None or self._run is None:
            return None
        run, model_modes = self._run, [(item.is_load, item.modes) for item in model.items]
        loads = {mode for is_load, modes in model_modes if is_load for mode in modes}
        needed = {mode for is_load, modes in model_modes if not is_load for mode in modes}
        if any(not needed <= one.energies.keys() <= needed | loads for one in self.increments):
            raise InputError(f"{_senseless(self._source.folder)}; {ANEW}")
        controls = [increment.control for increment in self.increments]
        former = (self.state(model, *step, state_at) for step in enumerate(controls))
        path = StagePath([], **run.path.model_dump())
        if self._steps_back:
            path.append(state_at(0.0, model.nodes.rest))
            for step in [*enumerate(controls)][-3:]:
                state = self.state(model, *step, state_at)
                path.append(replace(state, memory=model.accepted(state)))
            self.write(model, path, self.steps, path.state)
        else:
            path.states = self._source.states(model, run.controls, state_at)
        return path, former

    def state(
        self,
        model: Model,
        number: int,
        control: float,
        state_at: Callable[[float, np.ndarray], State],
    ) -> State:
        """The state after an increment, by its number; errors as of `restore`. Collective."""
        return self._state(number).states(model, [control], state_at)[0]

    def _state(self, number: int) -> _Part:
        try:
            part = _Part.open(self.comm, self.folder / f"state-{number + 1}")
        except DamagedError as error:
            raise InputError(f"{error}; {ANEW}") from None
        if part.seal != self._states[number]:
            raise InputError(f'"{part.folder}" is of another run than its neighbours; {ANEW}')
        return part

    def write(
        self,
        model: Model,
        path: StagePath,
        steps: Sequence[Increment | FormingStep],
        state: State,
    ) -> None:
        """Keep what has been reached by all increments that were accepted.

        ``state``: the last one as it was found, with what items remembered of those before it.
        An InputError on every rank if the place cannot be written to; the last good checkpoint is
        still there then.
        """
        count, way = len(steps), {name: getattr(path, name) for name in _Path.model_fields}
        if count > len(self._states):
            self._states.append(self._put(model, f"state-{count}", [state], way))
        run = {
            "case": self._data,
            "determines": self._determines,
            "increments": [asdict(step) for step in steps],
            "controls": [state.time for state in path.states],
            "path": way,
            "states": self._states,
        }
        self._put(model, NEWEST, path.states, run)
        self._newest_is_good = True

    def _put(self, model: Model, name: str, states: list[State], run: dict[str, Any]) -> str:
        """Write a folder and give it its name; returns the checksum of its manifest."""
        comm, nodes, own = self.comm, model.nodes, model.nodes.num_nodes_owned
        arrays = _Arrays.of(states)
        records = np.zeros(own, arrays.record())
        records["key"] = nodes.node_key[:own]
        records["positions"] = np.stack([state.x[:own] for state in states], axis=1)
        for item in model.items:
            for label in arrays.memory.get(item.name, {}):
                values = states[-1].memory[item.name][label]
                records[f"{item.name}/{label}"][item.keepers] = values
        data = io.BytesIO()
        np.save(data, records, allow_pickle=False)
        new = self.folder / comm.bcast(f"new-{os.getpid()}")
        explained = explaining(f'the checkpoint "{self.folder / name}" cannot be written')

        @explained
        def start() -> None:
            lock_directory(self.directory)
            claim(self.folder, adopt=True)
            _remove(new)
            new.mkdir()

        @explained
        def fill() -> tuple[int, str]:
            return own, _write_file(new / f"rank-{comm.rank}.npy", data.getvalue())

        @explained
        def finish() -> str:
            rows, hashes = zip(*files, strict=True)
            manifest = {
                "program": __version__, "format": FORMAT, "arrays": arrays.model_dump(),
                "rows": rows, "hashes": hashes, "run": run,
            }  # fmt: skip
            text = json.dumps(manifest, separators=(",", ":"), default=_plain)
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
            files = comm.allgather(on_all(comm, fill))
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
                # First what tells that there is something to go on from: it would need all else.
                for number, name in enumerate((PREVIOUS, NEWEST)):
                    part = self.folder / name
                    if part.exists() and all(re.fullmatch(FILES, f.name) for f in part.iterdir()):
                        part.rename(self.folder / f"new-{number}")
                _remove(self.folder)
            unlock_directory(self.directory)
        self.comm.barrier()


def reopen(
    comm: MPI.Intracomm,
    target: str | Path,
    overrides: Sequence[str] = (),
    output: str | None = None,
    from_step: int | None = None,
) -> Checkpoint:
    """Open what ``cruciform-petsc resume TARGET`` is to go on with. Collective.

    It is the folder of the results, or the case file that tells it, with overrides and output as
    for ``cruciform-petsc run``. ``from_step`` and errors are those of `Checkpoint.resume`.
    """
    case, directory = None, Path(target)
    exists, is_folder = on_root(comm, lambda: (os.path.exists(target), os.path.isdir(target)))
    if not exists:
        raise InputError(f'there is no "{target}", name a folder of results or a case file')
    if not is_folder:
        case = Case.load_collective(comm, target, overrides)
        if not case.test.finite:
            raise InputError(
                "a test at small displacements is one system of equations and has no checkpoints, "
                f"{ANEW} {target}"
            )
        directory = prepare_directory(comm, case.output.directory if output is None else output)
    elif not on_root(comm, lambda: _found(directory)):
        raise InputError(_nothing_there(directory))
    elif overrides or output is not None:
        raise InputError(
            f'the case comes from the checkpoint in "{target}"; --set and --output go with the '
            f"case file: {typed_before()}cruciform-petsc resume CASE"
        )
    warning = on_root(comm, lambda: lock_directory(directory))
    begun = on_root(comm, lambda: bool(_found(directory)) or _is_finished(directory))
    if case and not begun and from_step is None:
        checkpoint = Checkpoint.begin(comm, directory, case)
        checkpoint.notes.append(f'nothing was reached in "{directory}" yet, so it begins at rest')
    else:
        checkpoint = Checkpoint.resume(comm, directory, case, from_step)
    checkpoint.notes += [warning] if warning else []
    return checkpoint


def hint(directory: str | Path, ranks: int = 1) -> str:
    """How to go on with the run whose results are in a folder, a sentence; "" if it cannot be.

    Not collective.
    """
    if not _found(Path(directory)):
        return ""
    return f"what was reached is kept, continue with: {resume_command(directory, ranks)}"


def resume_command(directory: str | Path, ranks: int = 1) -> str:
    """What to type to go on with the run whose results are in a folder."""
    launcher = f"mpirun -n {ranks} " if ranks > 1 else ""
    return f"{typed_before()}{launcher}cruciform-petsc resume {shlex.quote(str(directory))}"


# -- what determines a run -------------------------------------------------------------------------


def determines(case: Case) -> dict[str, Any]:
    """What the equilibria of a case depend on, as plain data: fabric, preform, test, tools, stages.

    Not the number of increments of a test and the steps of stages, which, like the solver's
    options, only say how to get there. Of a file what is in it counts. InputError if that
    cannot be read; not collective.
    """
    fabric = asdict(case.fabric())
    for name in ("name", "source", "weave"):
        fabric.pop(name)
    if fabric["biaxial_law"] is not None:
        fabric["biaxial_law"].pop("points")  # the law that was found from them is there
    data = case.model_dump() | {"fabric": fabric}
    for name in ("title", "continuum", "solver", "output"):
        data.pop(name)
    for key in ("increments", "step"):
        data["test"].pop(key, None)
    for stage in data.get("stage", []):
        stage.pop("step")
    data["preform"]["outline"]["file"] = case.preform_table.outline.drawn
    for told, ply in zip(data.get("ply", []), case.plies, strict=True):
        if ply.outline is not None:
            told["outline"]["file"] = ply.outline.drawn
    for tool in data.get("tool", []):
        path = tool["shape"].get("file")
        if path is not None:
            told = explaining(f'tool "{tool["name"]}": "{path}" cannot be read')
            with told, open_regular(Path(path), follow=True) as file:
                tool["shape"]["file"] = hashlib.file_digest(file, "sha256").hexdigest()
    return json.loads(json.dumps(data))


def _differences(one: Any, other: Any, name: str = "") -> list[str]:
    """Keys whose values differ, "test.extension", "stage[1].travel"."""
    if _are_tables(one) and _are_tables(other) and len(one) == len(other):
        one, other = ({f"[{i}]": part for i, part in enumerate(parts)} for parts in (one, other))
    if not (isinstance(one, dict) and isinstance(other, dict)):
        return [] if one == other else [name]
    found = []
    for key in one | other:
        below = f"{name}.{key}".removeprefix(".").replace(".[", "[")
        found += _differences(one.get(key), other.get(key), below)
    return found


def _are_tables(parts: Any) -> bool:
    return isinstance(parts, list) and all(isinstance(part, dict) for part in parts)


def _case_of(part: _Part) -> Case:
    try:
        return Case.from_data(part.run.case)
    except InputError:
        raise _senseless(part.folder) from None


# -- files and folders -----------------------------------------------------------------------------


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


def _found(directory: Path) -> list[Path]:
    """What there is to go on from, the newest first; not collective."""
    parts = [directory / CHECKPOINT / name for name in (NEWEST, PREVIOUS)]
    return [part for part in parts if os.path.lexists(part)]


def _is_finished(directory: Path) -> bool:
    """Whether results are there; a summary may be of a run before the one that was interrupted."""
    return os.path.exists(directory / "summary.json") and not os.path.exists(directory / CHECKPOINT)


def _nothing_there(directory: Path) -> str:
    if _is_finished(directory):
        return f'the run in "{directory}" is finished, there is nothing to resume'
    return (
        f'there is no checkpoint in "{directory}": nothing was reached there yet, or it is not the '
        "folder of a test at finite deformation; start with "
        f"{typed_before()}cruciform-petsc run CASE"
    )
