"""Results of sweeps on disk or in memory, in Zarr's format: written by chunks, read as an xarray Dataset.

A chunk counts when the status of its runs is there, which is written after all else; Zarr writes each file
beside its place. So a sweep may be killed anywhere, and what is not there is made again.

Every chunk ends with a checksum, which is compared whenever the chunk is read. Runs with a damaged chunk are
made again when the sweep resumes.
"""

from __future__ import annotations

import json
import os
import shutil
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import replace
from math import prod
from pathlib import Path
from typing import Any

import numpy as np

from crosscheck.support.errors import CrosscheckError, short_of_memory
from crosscheck.support.files import remove_abandoned
from crosscheck.sweeps.plan import CONDITIONS, DONE, STOPPED, Chunk, Plan, make_runs
from crosscheck.sweeps.sampling import EXTENDED, UNEXTENDED
from crosscheck.sweeps.store_files import PARTIAL, check_files, chunk_file, stored_chunks
from newton_euler.folders import make_folder
from newton_euler.optional_packages import optional_package
from newton_euler.runs.variation import units_of
from newton_euler.scalars import Array

NAME = "sweep.zarr"

STATUS, ERROR = "status", "error"
"""Variables beside those that vary and those that are kept."""

BLOCK = 2**20
"""Runs whose status is read at a time."""

SWEEP = "sweep"
"""The extra of this distribution that installs what sweeps need."""

OF_TASKS = "tasks"
"""Attribute by which tasks know the store that they are for: one of a worker that outlives its client does
not write into another store that has taken the place, nor into one to which runs were added."""

FREE = ("chunk", "versions", "numbers", OF_TASKS)
"""Attributes that are not compared: of packages samples are, and of scenes fingerprints."""

ELSEWHERE = "name another folder (--output), or remove this one"

GOES_ON = "the same command goes on from there"

KEPT_GOES_ON = f"what is stored is kept, {GOES_ON}"


def libraries() -> tuple[Any, Any]:
    """Import xarray and zarr.

    Raises:
        MissingPackageError: if they are not installed.
    """
    return optional_package("xarray", SWEEP), optional_package("zarr", SWEEP)


class Store:
    """Results of a sweep.

    Attributes:
        group: of Zarr.
        path: of its folder; None in memory.
    """

    def __init__(self, group: Any, path: Path | None) -> None:
        self.group, self.path = group, path

    @classmethod
    def in_memory(cls, plan: Plan) -> Store:
        """Make a store that is lost with the process."""
        _, zarr = libraries()
        store = cls(zarr.create_group(zarr.storage.MemoryStore()), None)
        store._create(plan, {})
        return store

    @classmethod
    def at(cls, path: Path) -> Store:
        """Open a store that is there, whose files have been checked.

        Raises:
            CrosscheckError: for a folder that holds no sweep.
        """
        _, zarr = libraries()
        try:
            group = zarr.open_group(path, mode="r+", use_consolidated=False)
            if "runs" not in group.attrs or STATUS not in group:
                raise ValueError("it has no number of runs or no status")
        except (OSError, ValueError, KeyError) as error:
            raise CrosscheckError(f"{path} holds no sweep: {error}"[:300]) from error
        return cls(group, path)

    @classmethod
    def checked(cls, path: Path) -> Store:
        """Open a store that is there, after its files were checked.

        Raises:
            CrosscheckError: for a folder that holds no sweep, or other files than those of a sweep.
        """
        try:
            check_files(path)
        except CrosscheckError as error:
            raise CrosscheckError(f"{path} holds no sweep of this version: {error}; {ELSEWHERE}") from error
        return cls.at(path)

    @classmethod
    def make(cls, plan: Plan, path: Path) -> Store:
        """Make a store on disk; it appears whole or not at all.

        Raises:
            CrosscheckError: naming the path that cannot be written.
        """
        _, zarr = libraries()
        record = plan.record()
        remove_abandoned(path.parent.glob(f".{path.stem}-????????{path.suffix}"))
        made = path.parent / f".{path.stem}-{os.urandom(4).hex()}{path.suffix}"
        try:
            with told(path):
                make_folder(path.parent)
                cls(zarr.create_group(made), made)._create(plan, record | {OF_TASKS: os.urandom(8).hex()})
                made.rename(path)
        finally:
            shutil.rmtree(made, ignore_errors=True)
        return cls.at(path)

    def _create(self, plan: Plan, attributes: Mapping[str, Any]) -> None:
        """Make all variables, without values, and the names along their dimensions."""
        from zarr.codecs import Crc32cCodec

        self.group.update_attributes(dict(attributes))
        of_runs = {"run": plan.samples.runs}

        def make(name: str, kind: Any, sizes: Mapping[str, int], unit: str = "", about: str = "") -> Any:
            said = {"units": unit, "long_name": about}
            return self.group.create_array(
                name,
                shape=tuple(sizes.values()),
                chunks=tuple(plan.chunk if each == "run" else n for each, n in sizes.items()),
                dtype=kind,
                dimension_names=tuple(sizes),
                attributes={key: text for key, text in said.items() if text},
                fill_value=np.nan if kind == "f8" else None,
                compressors=[Crc32cCodec()],
            )

        for name, unit in units_of(plan.scene, plan.samples.names).items():
            make(name, "f8", of_runs, unit, name)
        for each in plan.kept:
            sizes = {name: len(along) for name, along in each.dimensions.items()}
            make(each.name, "f8", of_runs | sizes, each.unit, each.text)
        for dimension, values in _coordinates(plan).items():
            kind, unit = (str, "") if values.dtype.kind == "O" else ("f8", "s")
            make(dimension, kind, {dimension: len(values)}, unit)[:] = values
        make(ERROR, str, of_runs, about="why a run could not go on")
        about = f"{DONE}: to its end, {STOPPED}: could not go on, 0: not made yet"
        make(STATUS, "u1", of_runs, about=about)

    def resumed(self, plan: Plan) -> Plan:
        """Return the plan with the chunks of the store, to which runs are added if the plan has more.

        Raises:
            CrosscheckError: if the store is of another scene or plan.
        """
        own, record, runs = dict(self.group.attrs), plan.record(), plan.samples.runs
        if (more := own["runs"] < runs) and plan.samples.sampling in EXTENDED:
            record |= {"runs": own["runs"], "samples": plan.samples.digest(own["runs"])}
        if what := _difference(own, record):
            raise CrosscheckError(f"{self.path} holds a sweep of {what}; {ELSEWHERE}")
        with intact(self.path), told(self.path):
            remove_abandoned(self.path.rglob(f"*{PARTIAL}") if self.path else ())
            if more:
                new = {"runs": runs, "samples": plan.samples.digest(runs), OF_TASKS: os.urandom(8).hex()}
                self.group.update_attributes(new)
            # after that, and looked at each time: a process that is killed here is called with as many again
            for _, array in self.group.arrays():
                if array.metadata.dimension_names[0] == "run" and array.shape[0] < runs:
                    array.resize((runs, *array.shape[1:]))
            resumed = replace(plan, chunk=int(own["chunk"]))
            self._check_metadata(resumed)
        return resumed

    def _check_metadata(self, plan: Plan) -> None:
        """Raise `ValueError` for variables that are not described as those of a new store of the plan."""
        own, new = (dict(group.arrays()) for group in (self.group, Store.in_memory(plan).group))
        for name in {**new, **own}:
            if name not in own:
                raise ValueError(f"{name} is missing")
            if name not in new:
                raise ValueError(f"{name} is no variable of this sweep")
            have, needed = (arrays[name].metadata.to_dict() for arrays in (own, new))
            for field in sorted(_changed(have, needed)):
                problem = f"{name}: {field} is {have.get(field)!s:.60}"
                raise ValueError(f"{problem}; needed: {needed.get(field)!s:.60}")

    def discard_damaged(self, plan: Plan) -> list[str]:
        """Mark runs whose chunks are damaged or lost as not made, so that they are made again.

        Returns:
            A line for each file: its path, its runs and what is done.
        """
        if self.path is None:
            return []
        lines = list[str]()
        with told(self.path):
            for name, values in _coordinates(plan).items():
                if _unreadable(self.group[name], 0, 1) or not np.array_equal(self.group[name][:], values):
                    lines.append(f"{self.path / name} was damaged and is written again")
                    self.group[name][:] = values
            count = -(-plan.samples.runs // plan.chunk)
            for number in self._discard(STATUS, _unreadable(self.group[STATUS], 0, count)):
                lines.append(self._line(STATUS, number, plan))
            made, stopped = set[int](), set[int]()
            for start, status in self._statuses(plan):
                chunks = np.arange(0, len(status), plan.chunk)
                for marked, found in ((status != 0, made), (status == STOPPED, stopped)):
                    of_chunks = np.logical_or.reduceat(marked, chunks)
                    found.update(((start + chunks[of_chunks]) // plan.chunk).tolist())
            for name in (*plan.samples.names, *(each.name for each in plan.kept), ERROR):
                array = self.group[name]
                lost = (stopped if name == ERROR else made) - stored_chunks(self.path / name, array.ndim)
                for number in self._discard(name, sorted(lost | {*_unreadable(array, 0, count)})):
                    first = number * plan.chunk
                    self.group[STATUS][first : first + plan.chunk] = 0
                    lines.append(self._line(name, number, plan))
        return lines

    def _discard(self, name: str, numbers: Iterable[int]) -> Iterator[int]:
        """Remove the files of damaged chunks of a variable: part of a chunk cannot be written into them."""
        assert self.path is not None
        for number in numbers:
            chunk_file(self.path / name, number, self.group[name].ndim).unlink(missing_ok=True)
            yield number

    def _line(self, name: str, number: int, plan: Plan) -> str:
        assert self.path is not None
        first, last = number * plan.chunk, min((number + 1) * plan.chunk, plan.samples.runs) - 1
        file = chunk_file(self.path / name, number, self.group[name].ndim)
        return f"{file} was damaged or lost: runs {first} to {last} are made again"

    def missing(self, plan: Plan) -> list[tuple[int, int]]:
        """Return the runs that are not there: of each chunk the first of them and the first after them.

        They are at its end, of the last chunk of a sweep to which runs were added.

        Raises:
            CrosscheckError: for files that are damaged.
        """
        runs, left = plan.samples.runs, list[tuple[int, int]]()
        with intact(self.path, STATUS):
            for start, status in self._statuses(plan):
                there = (status != 0).astype(int)
                chunks = np.arange(0, len(there), plan.chunk)
                firsts = start + chunks + np.add.reduceat(there, chunks)
                lasts = np.minimum(start + chunks + plan.chunk, runs)
                some = firsts < lasts
                left += zip(firsts[some].tolist(), lasts[some].tolist(), strict=True)
        return left

    def _statuses(self, plan: Plan) -> Iterator[tuple[int, Array]]:
        """Yield the status of all runs in parts of whole chunks, each with the number of its first run."""
        step = max(1, BLOCK // plan.chunk) * plan.chunk
        for start in range(0, plan.samples.runs, step):
            yield start, self.group[STATUS][start : start + step]

    def progress(self) -> str:
        """Word how many of all runs are there.

        Raises:
            CrosscheckError: for files that are damaged.
        """
        with intact(self.path, STATUS):
            status = self.group[STATUS]
            starts = range(0, status.shape[0], BLOCK)
            there = sum(int(np.count_nonzero(status[start : start + BLOCK])) for start in starts)
        return f"{there:,} of {status.shape[0]:,} runs"

    def write(self, first: int, chunk: Chunk) -> None:
        """Write consecutive runs, their status last.

        Raises:
            CrosscheckError: naming the path that cannot be written.
        """
        last, stopped = first + len(chunk.errors), chunk.errors != ""
        with intact(self.path), told(self.path):
            for name, values in chunk.values.items():
                # also where all are not a number: a chunk without a file counts as lost
                self.group[name].with_config({"write_empty_chunks": True})[first:last] = values
            if stopped.any():
                self.group[ERROR][first:last] = chunk.errors
            self.group[STATUS][first:last] = np.where(stopped, STOPPED, DONE).astype("u1")

    def dataset(self) -> Any:
        """Return an xarray Dataset of all that is there; variables are read when they are used."""
        xarray, _ = libraries()
        with intact(self.path):
            return xarray.open_zarr(self.group.store, consolidated=False, chunks=None)


def _coordinates(plan: Plan) -> dict[str, Any]:
    """The names or times along the dimensions of what is kept."""
    found = {name: along for each in plan.kept for name, along in each.dimensions.items()}
    return {name: along if along.dtype.kind == "f" else along.astype(object) for name, along in found.items()}


def _unreadable(array: Any, first: int, last: int) -> list[int]:
    """The numbers of the chunks, from the first to before the last, whose files cannot be read.

    Many chunks are read together, and halved where that fails.
    """
    chunk = array.chunks[0]
    if last - first > max(1, BLOCK // (chunk * prod(array.shape[1:]))):
        middle = (first + last) // 2
        return [*_unreadable(array, first, middle), *_unreadable(array, middle, last)]
    try:
        array[first * chunk : last * chunk]
    except Exception as error:  # whatever codecs make of damaged bytes
        if short_of_memory(error):
            raise
        if last - first == 1:
            return [first]
        middle = (first + last) // 2
        return [*_unreadable(array, first, middle), *_unreadable(array, middle, last)]
    return []


def _difference(own: Mapping[str, Any], record: Mapping[str, Any]) -> str:
    """Word the first difference of a store's attributes from the record of a plan; empty without one."""
    follows = {*record} - {*CONDITIONS} | {"samples"}  # other versions have other fingerprints and plans
    for name in sorted(_changed(own, record), key=follows.__contains__):
        if name in CONDITIONS:
            return CONDITIONS[name].rstrip(",")
        if name == "fingerprint":
            old, new = (json.loads(each.get("numbers", "{}")) for each in (own, record))
            changes = [_change(number, old, new) for number in _changed(old, new)]
            return f"another scene: {next(iter(changes), 'its start or structure differs')}"
        if name not in FREE:
            why = UNEXTENDED.get((record["sampling"], name.partition(" ")[0]), "")
            return f"another plan: {_change(name, own, record)}{why}"
    return ""


def _changed(old: Mapping[str, Any], new: Mapping[str, Any]) -> list[str]:
    return [name for name in {**new, **old} if old.get(name) != new.get(name)]


def _change(name: str, old: Mapping[str, Any], new: Mapping[str, Any]) -> str:
    """Word a part of a plan or a scene that differs: its name, what it was and what it is."""
    was, is_ = (
        f"{value:g}" if isinstance(value, float) else f"{value!s:.200}"
        for value in (old.get(name, "not given"), new.get(name, "not given"))
    )
    return f"{name} was {was}, is {is_}"


@contextmanager
def intact(path: Path | None, name: str = "") -> Iterator[None]:
    """A block in which files of a store that are damaged are one line; `name` is a variable to be read."""
    what_to_do = f"the same command makes its runs again; otherwise {ELSEWHERE}" if name else ELSEWHERE
    try:
        yield
    except (OSError, RuntimeError, ValueError, KeyError) as error:
        if short_of_memory(error):
            raise
        problem = f"{path} is damaged: {name and f'{name}: '}{error}"
        raise CrosscheckError(f"{problem:.300}; {what_to_do}") from error


@contextmanager
def told(path: Path | None) -> Iterator[None]:
    """A block in which a disk that is full, or cannot be written, is one line."""
    try:
        yield
    except OSError as error:
        reason = error.strerror or str(error)
        raise CrosscheckError(f"cannot write {path}: {reason}; {KEPT_GOES_ON}") from error


@contextmanager
def interruptible(path: Path) -> Iterator[None]:
    """A block whose interrupt says how many runs are in the store at a path, if it is there."""
    try:
        yield
    except KeyboardInterrupt:
        if not path.exists():
            raise
        raise KeyboardInterrupt(f"{Store.checked(path).progress()} are stored, {GOES_ON}") from None


def check_finished(folder: Path) -> None:
    """Raise `CrosscheckError` for a folder with a sweep alone that did not come to its tables."""
    if (folder / NAME).is_dir() and not any(folder.glob("*.json")):
        there = Store.checked(folder / NAME).progress()
        raise CrosscheckError(f"{folder} holds an unfinished sweep, {there}; {GOES_ON}")


def store_runs(plan: Plan, path: Path, tasks: str | None, runs: tuple[int, int]) -> None:
    """Make the runs from the first to before the second number, and write them where they are made.

    If the store there is that of the tasks by then.

    Raises:
        CrosscheckError: naming the path that cannot be written, and for a scene that cannot be run.
    """
    chunk = make_runs(plan, runs)
    store = Store.at(path)
    if store.group.attrs.get(OF_TASKS) == tasks:
        store.write(runs[0], chunk)
