"""Store the results of a sweep on disk or in memory, in the format of Zarr (arrays in files of chunks).

A sweep simulates a scene many times with varied parameters; a `SweepPlan` defines all its runs. The store
has one variable (an array with the runs as its first dimension) for each varied parameter and for each kept
output, a number or array that the sweep keeps of each run. Results are written in chunks of consecutive runs,
and read as an xarray Dataset. The status of the runs of a chunk is written last, and Zarr renames each file
into place when it is complete. A sweep can therefore be killed at any time: runs without a status are
repeated.

Every chunk ends with a checksum, which is verified whenever the chunk is read. If a chunk is damaged, its
runs are repeated when the sweep resumes.
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
from crosscheck.sweeps.plan import (
    CONDITION_DIFFERENCES,
    RUN_COMPLETED,
    RUN_FAILED,
    Chunk,
    SweepPlan,
    make_runs,
)
from crosscheck.sweeps.sampling import EXTENSIBLE_SAMPLINGS, NOT_EXTENSIBLE_REASONS
from crosscheck.sweeps.store_files import PARTIAL, check_files, chunk_file, stored_chunks
from newton_euler.folders import make_folder
from newton_euler.optional_packages import optional_package
from newton_euler.runs.variation import units_of
from newton_euler.scalars import Array

STORE_NAME = "sweep.zarr"
"""Name of the folder of a store."""

STATUS, ERROR = "status", "error"
"""Names of the variables with the status of each run (see `RUN_COMPLETED`) and the reason of its failure."""

STATUS_RUNS = 2**20
"""Number of runs whose status is read at a time, which takes 1 MB."""

SWEEP_EXTRA = "sweep"
"""Name of the optional dependencies (`pip install crosscheck-dynamics[sweep]`) that sweeps need."""

STORE_ID = "tasks"
"""Attribute with a random identifier of a store. By it, a worker process whose parent has ended does not
write into a later store at the same path, or into a store to which runs were added."""

NOT_COMPARED = ("chunk", "versions", "numbers", STORE_ID)
"""Attributes of a store that may differ from those of the plan; `numbers` are the numbers of the scene.

The attributes `samples` and `fingerprint`, hashes of the varied parameters' values and of the scene, are
compared. They change whenever package versions or the scene's numbers change the runs."""

CHOOSE_ANOTHER_FOLDER = "name another folder (--output), or remove this one"

REPEAT_COMMAND = "repeat the command to resume"

HOW_TO_RESUME = f"stored runs are kept, {REPEAT_COMMAND}"


def libraries() -> tuple[Any, Any]:
    """Import xarray and zarr.

    Raises:
        MissingPackageError: if a package is not installed.
    """
    return optional_package("xarray", SWEEP_EXTRA), optional_package("zarr", SWEEP_EXTRA)


class Store:
    """Stored results of a sweep: an array of all runs for each parameter and kept output, status and error.

    Attributes:
        group: the Zarr group of these arrays. Its attributes are the record of the plan and `STORE_ID`.
        path: folder of the store; None for a store in memory.
    """

    def __init__(self, group: Any, path: Path | None) -> None:
        self.group, self.path = group, path

    @classmethod
    def in_memory(cls, plan: SweepPlan) -> Store:
        """Make a store in memory for the runs of a plan."""
        _, zarr = libraries()
        store = cls(zarr.create_group(zarr.storage.MemoryStore()), None)
        store._create(plan, {})
        return store

    @classmethod
    def at(cls, path: Path) -> Store:
        """Open an existing store whose files have been checked by `check_files`.

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
        """Check the files of an existing store, and open it.

        Raises:
            CrosscheckError: for a folder that holds no sweep, or files that do not belong to a sweep.
        """
        try:
            check_files(path)
        except CrosscheckError as error:
            raise CrosscheckError(
                f"{path} holds no sweep of this version: {error}; {CHOOSE_ANOTHER_FOLDER}"
            ) from error
        return cls.at(path)

    @classmethod
    def make(cls, plan: SweepPlan, path: Path) -> Store:
        """Make a store on disk. The store appears completely or not at all.

        Raises:
            CrosscheckError: for a path that cannot be written.
        """
        _, zarr = libraries()
        record = plan.record()
        # temporary folders of processes that were killed
        remove_abandoned(path.parent.glob(f".{path.stem}-????????{path.suffix}"))
        temporary = path.parent / f".{path.stem}-{os.urandom(4).hex()}{path.suffix}"
        try:
            with disk_errors(path):
                make_folder(path.parent)
                cls(zarr.create_group(temporary), temporary)._create(
                    plan, record | {STORE_ID: os.urandom(8).hex()}
                )
                temporary.rename(path)
        finally:
            shutil.rmtree(temporary, ignore_errors=True)
        return cls.at(path)

    def _create(self, plan: SweepPlan, attributes: Mapping[str, Any]) -> None:
        """Create all variables without values, the labels of their dimensions, and the attributes of the
        group."""
        from zarr.codecs import Crc32cCodec

        self.group.update_attributes(dict(attributes))
        of_runs = {"run": plan.samples.runs}

        def make(name: str, kind: Any, sizes: Mapping[str, int], unit: str = "", about: str = "") -> Any:
            """Create a variable of data type `kind`; only the dimension of the runs is divided into chunks.

            Args:
                name: name of the variable.
                kind: data type.
                sizes: size along each dimension, by name of the dimension.
                unit: unit of the values.
                about: description of the variable.
            """
            texts = {"units": unit, "long_name": about}
            return self.group.create_array(
                name,
                shape=tuple(sizes.values()),
                chunks=tuple(plan.chunk if each == "run" else n for each, n in sizes.items()),
                dtype=kind,
                dimension_names=tuple(sizes),
                attributes={key: text for key, text in texts.items() if text},
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
        make(ERROR, str, of_runs, about="reason of a failed run")
        about = f"{RUN_COMPLETED}: completed, {RUN_FAILED}: failed, 0: not executed yet"
        make(STATUS, "u1", of_runs, about=about)

    def resumed(self, plan: SweepPlan) -> SweepPlan:
        """Prepare the store for a plan, which may have more runs than the store.

        Returns:
            The plan with the chunk size of the store.

        Raises:
            CrosscheckError: if the store belongs to another scene or plan.
        """
        # Compare the attributes of the store with the plan, for the runs that the store already has
        stored, record, runs = dict(self.group.attrs), plan.record(), plan.samples.runs
        if (is_extended := stored["runs"] < runs) and plan.samples.sampling in EXTENSIBLE_SAMPLINGS:
            record |= {"runs": stored["runs"], "samples": plan.samples.digest(stored["runs"])}
        if what := _difference(stored, record):
            raise CrosscheckError(f"{self.path} holds a sweep of {what}; {CHOOSE_ANOTHER_FOLDER}")
        # Remove incomplete files, and add the runs that the store does not have
        with intact(self.path), disk_errors(self.path):
            remove_abandoned(self.path.rglob(f"*{PARTIAL}") if self.path else ())
            if is_extended:
                new = {"runs": runs, "samples": plan.samples.digest(runs), STORE_ID: os.urandom(8).hex()}
                self.group.update_attributes(new)
            # arrays are resized last and checked each time, since a process can be killed in between
            for _, array in self.group.arrays():
                if array.metadata.dimension_names[0] == "run" and array.shape[0] < runs:
                    array.resize((runs, *array.shape[1:]))
            resumed = replace(plan, chunk=int(stored["chunk"]))
            self._check_metadata(resumed)
        return resumed

    def _check_metadata(self, plan: SweepPlan) -> None:
        """Raise `ValueError` if the metadata of a variable differ from those of a new store of the plan."""
        stored, new = (dict(group.arrays()) for group in (self.group, Store.in_memory(plan).group))
        for name in {**new, **stored}:
            if name not in stored:
                raise ValueError(f"{name} is missing")
            if name not in new:
                raise ValueError(f"{name} is no variable of this sweep")
            given, needed = (arrays[name].metadata.to_dict() for arrays in (stored, new))
            for field in sorted(_changed(given, needed)):
                problem = f"{name}: {field} is {given.get(field)!s:.60}"
                raise ValueError(f"{problem}; needed: {needed.get(field)!s:.60}")

    def discard_damaged(self, plan: SweepPlan) -> list[str]:
        """Mark runs with damaged or lost chunks as not executed, so that they are repeated.

        Returns:
            A line for each damaged or lost file, with its path and the runs to repeat.
        """
        if self.path is None:
            return []
        lines = list[str]()
        with disk_errors(self.path):
            for name, values in _coordinates(plan).items():
                if _unreadable(self.group[name], 0, 1) or not np.array_equal(self.group[name][:], values):
                    lines.append(f"{self.path / name} was damaged and is written again")
                    self.group[name][:] = values
            # a chunk of the status that is removed reads as 0: not executed
            count = -(-plan.samples.runs // plan.chunk)  # number of chunks, rounded up
            for number in self._discard(STATUS, _unreadable(self.group[STATUS], 0, count)):
                lines.append(self._line(STATUS, number, plan))
            # indices of the chunks with executed runs, and of those with failed runs
            executed, failed = set[int](), set[int]()
            for start, status in self._statuses(plan):
                chunks = np.arange(0, len(status), plan.chunk)
                for marked, numbers in ((status != 0, executed), (status == RUN_FAILED, failed)):
                    has_marked = np.logical_or.reduceat(marked, chunks)
                    numbers.update(((start + chunks[has_marked]) // plan.chunk).tolist())
            # each of these chunks must have a readable file for every variable; `ERROR` only of failed runs
            for name in (*plan.samples.names, *(each.name for each in plan.kept), ERROR):
                array = self.group[name]
                lost = (failed if name == ERROR else executed) - stored_chunks(self.path / name, array.ndim)
                for number in self._discard(name, sorted(lost | {*_unreadable(array, 0, count)})):
                    first = number * plan.chunk
                    self.group[STATUS][first : first + plan.chunk] = 0
                    lines.append(self._line(name, number, plan))
        return lines

    def _discard(self, name: str, numbers: Iterable[int]) -> Iterator[int]:
        """Remove the files of damaged chunks of a variable, and yield the numbers of these chunks.

        Zarr reads the file of a chunk before it writes a part of the chunk, which fails for a damaged file.
        """
        assert self.path is not None
        for number in numbers:
            chunk_file(self.path / name, number, self.group[name].ndim).unlink(missing_ok=True)
            yield number

    def _line(self, name: str, number: int, plan: SweepPlan) -> str:
        """Report a damaged or lost chunk of a variable, and the runs that are repeated."""
        assert self.path is not None
        first, last = number * plan.chunk, min((number + 1) * plan.chunk, plan.samples.runs) - 1
        file = chunk_file(self.path / name, number, self.group[name].ndim)
        return f"{file} was damaged or lost: runs {first} to {last} are repeated"

    def missing(self, plan: SweepPlan) -> list[tuple[int, int]]:
        """Return the ranges of runs that are not stored, as index of the first and of the last run plus one.

        There is at most one range per chunk, at its end, since the first runs of a chunk are written first.

        Raises:
            CrosscheckError: for damaged files.
        """
        runs, ranges = plan.samples.runs, list[tuple[int, int]]()
        with intact(self.path, STATUS):
            for start, status in self._statuses(plan):
                is_stored = (status != 0).astype(int)
                chunks = np.arange(0, len(is_stored), plan.chunk)
                firsts = start + chunks + np.add.reduceat(is_stored, chunks)
                lasts = np.minimum(start + chunks + plan.chunk, runs)
                is_missing = firsts < lasts
                ranges += zip(firsts[is_missing].tolist(), lasts[is_missing].tolist(), strict=True)
        return ranges

    def _statuses(self, plan: SweepPlan) -> Iterator[tuple[int, Array]]:
        """Yield the status of all runs in parts of whole chunks, each with the index of its first run."""
        step = max(1, STATUS_RUNS // plan.chunk) * plan.chunk
        for start in range(0, plan.samples.runs, step):
            yield start, self.group[STATUS][start : start + step]

    def progress(self) -> str:
        """Report how many runs are stored.

        Raises:
            CrosscheckError: for damaged files.
        """
        with intact(self.path, STATUS):
            status = self.group[STATUS]
            starts = range(0, status.shape[0], STATUS_RUNS)
            stored = sum(int(np.count_nonzero(status[start : start + STATUS_RUNS])) for start in starts)
        return f"{stored:,} of {status.shape[0]:,} runs"

    def write(self, first: int, chunk: Chunk) -> None:
        """Write consecutive runs, and then their status.

        Args:
            first: index of the first run.
            chunk: results of the runs.

        Raises:
            CrosscheckError: for a path that cannot be written.
        """
        last, failed = first + len(chunk.errors), chunk.errors != ""
        with intact(self.path), disk_errors(self.path):
            for name, values in chunk.values.items():
                # chunks of NaN are written too, since a chunk without a file counts as lost
                self.group[name].with_config({"write_empty_chunks": True})[first:last] = values
            if failed.any():
                self.group[ERROR][first:last] = chunk.errors
            self.group[STATUS][first:last] = np.where(failed, RUN_FAILED, RUN_COMPLETED).astype("u1")

    def dataset(self) -> Any:
        """Return an xarray Dataset of all variables, which are read on access."""
        xarray, _ = libraries()
        with intact(self.path):
            return xarray.open_zarr(self.group.store, consolidated=False, chunks=None)


def _coordinates(plan: SweepPlan) -> dict[str, Any]:
    """Return the labels (names or times, s) along each dimension of the kept outputs, by name of the
    dimension."""
    found = {name: along for each in plan.kept for name, along in each.dimensions.items()}
    return {name: along if along.dtype.kind == "f" else along.astype(object) for name, along in found.items()}


def _unreadable(array: Any, first: int, last: int) -> list[int]:
    """Return the indices of the chunks that cannot be read, among chunks `first` to `last` - 1 of a variable.

    Many chunks are read together; if that fails, the range is bisected.
    """
    chunk = array.chunks[0]
    if last - first > max(1, STATUS_RUNS // (chunk * prod(array.shape[1:]))):
        middle = (first + last) // 2
        return [*_unreadable(array, first, middle), *_unreadable(array, middle, last)]
    try:
        array[first * chunk : last * chunk]
    except Exception as error:  # codecs raise many kinds of errors for damaged bytes
        if short_of_memory(error):
            raise
        if last - first == 1:
            return [first]
        middle = (first + last) // 2
        return [*_unreadable(array, first, middle), *_unreadable(array, middle, last)]
    return []


def _difference(stored: Mapping[str, Any], record: Mapping[str, Any]) -> str:
    """Describe the first difference between a store's attributes and the record of a plan.

    Args:
        stored: attributes of the store.
        record: what the attributes would be for the plan, see `SweepPlan.record`.

    Returns:
        The description, which completes "a sweep of ..."; empty if there is no difference.
    """
    # Other versions of packages also change fingerprints, plans and samples. Therefore compare conditions
    # (versions, processor) first: False sorts before True.
    compared_later = {*record} - {*CONDITION_DIFFERENCES} | {"samples"}
    for name in sorted(_changed(stored, record), key=compared_later.__contains__):
        if name in CONDITION_DIFFERENCES:
            return CONDITION_DIFFERENCES[name].rstrip(",")  # the texts are also used within a sentence
        if name == "fingerprint":
            old, new = (json.loads(each.get("numbers", "{}")) for each in (stored, record))
            changes = [_change(number, old, new) for number in _changed(old, new)]
            return f"another scene: {next(iter(changes), 'its start or structure differs')}"
        if name not in NOT_COMPARED:
            # attributes with distributions are named "vary PARAMETER"; reasons are found by the word "vary"
            why = NOT_EXTENSIBLE_REASONS.get((record["sampling"], name.partition(" ")[0]), "")
            return f"another plan: {_change(name, stored, record)}{why}"
    return ""


def _changed(old: Mapping[str, Any], new: Mapping[str, Any]) -> list[str]:
    """Return the names of the entries that differ between two mappings."""
    return [name for name in {**new, **old} if old.get(name) != new.get(name)]


def _change(name: str, old: Mapping[str, Any], new: Mapping[str, Any]) -> str:
    """Describe a changed entry by its name, old value and new value."""
    was, is_ = (
        f"{value:g}" if isinstance(value, float) else f"{value!s:.200}"
        for value in (old.get(name, "not given"), new.get(name, "not given"))
    )
    return f"{name} was {was}, is {is_}"


@contextmanager
def intact(path: Path | None, name: str = "") -> Iterator[None]:
    """Convert errors of damaged files of a store into `CrosscheckError`.

    Args:
        path: path of the store.
        name: name of the variable whose runs can be repeated if it is damaged; empty for other files.
    """
    what_to_do = (
        f"repeat the command to execute its runs again, or {CHOOSE_ANOTHER_FOLDER}"
        if name
        else CHOOSE_ANOTHER_FOLDER
    )
    try:
        yield
    except (OSError, RuntimeError, ValueError, KeyError) as error:
        if short_of_memory(error):
            raise
        problem = f"{path} is damaged: {name and f'{name}: '}{error}"
        raise CrosscheckError(f"{problem:.300}; {what_to_do}") from error


@contextmanager
def disk_errors(path: Path | None) -> Iterator[None]:
    """Convert errors of a full or read-only disk into `CrosscheckError`."""
    try:
        yield
    except OSError as error:
        reason = error.strerror or str(error)
        raise CrosscheckError(f"cannot write {path}: {reason}; {HOW_TO_RESUME}") from error


@contextmanager
def interruptible(path: Path) -> Iterator[None]:
    """Add the number of stored runs to the message of a `KeyboardInterrupt`, if the path has a store."""
    try:
        yield
    except KeyboardInterrupt:
        if not path.exists():
            raise
        raise KeyboardInterrupt(f"{Store.checked(path).progress()} are stored, {REPEAT_COMMAND}") from None


def check_finished(folder: Path) -> None:
    """Raise `CrosscheckError` for an unfinished sweep: a folder with a store, but without results (JSON)."""
    if (folder / STORE_NAME).is_dir() and not any(folder.glob("*.json")):
        stored = Store.checked(folder / STORE_NAME).progress()
        raise CrosscheckError(f"{folder} holds an unfinished sweep, {stored}; {REPEAT_COMMAND}")


def store_runs(plan: SweepPlan, path: Path, store_id: str | None, runs: tuple[int, int]) -> None:
    """Execute a range of runs and write them into the store at a path, unless another store has replaced it.

    Args:
        plan: the plan.
        path: path of the store.
        store_id: attribute `STORE_ID` that the store had when the task was submitted.
        runs: index of the first run, and one more than the index of the last run.

    Raises:
        CrosscheckError: naming a path that cannot be written, and for a scene that cannot be simulated.
    """
    chunk = make_runs(plan, runs)
    store = Store.at(path)
    if store.group.attrs.get(STORE_ID) == store_id:
        store.write(runs[0], chunk)
